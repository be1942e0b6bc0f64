"""Joins for conditions on two entities that hold only for near ones.

The narrow phase is slow. So, if two sources are the same world, all candidate pairs of a tick are
found at once; and comparisons with a number, `clearance(a, b) < 0.1`, are evaluated only for boxes
that are near enough.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

from sqlglot import exp

from ssduck.language import ast
from ssduck.schema import EntityTable
from ssduck.sql.expressions import Expressions
from ssduck.sql.from_clause import pair_table
from ssduck.sql.pair_lookup import JoinedPairs
from ssduck.sql.relation_calls import expanded
from ssduck.sql.relations.geometry_query import PairKind
from ssduck.sql.relations.registry import BOXES_WITHIN, RELATIONS
from ssduck.sql.sql_values import NotSqlError

_LESS, _MORE = ("<", "<="), (">", ">=")


@dataclass(frozen=True)
class PairJoin:
    """A condition on two sources of one world."""

    table: exp.Expr  # the table of candidate pairs
    # The search for these pairs, and the condition on a row of the sources and of the table.
    pairs: JoinedPairs
    # The key of the order of the call's two arguments; None if there is none.
    position: exp.Ordered | None
    sides: tuple[ast.This, ast.This]  # the sources in that order


def sides_of(node: ast.Node) -> tuple[ast.This, ast.This] | None:
    """Returns the two sources of which a condition is whose pairs can be found at once."""
    match node:
        case ast.Call(name=name, arguments=(ast.This() as a, ast.This() as b, *_)) if (
            a.alias != b.alias
        ):
            relation = RELATIONS.get(name)
            return (a, b) if relation is not None and relation.candidate_pairs is not None else None
    return None


def pair_join(
    sql: Expressions, node: ast.Call, sides: tuple[ast.This, ast.This], schema: str
) -> PairJoin | None:
    """Returns the join that finds all pairs of `near(a.this, b.this, 0.1)`; None if SQL cannot."""
    relation, constants = RELATIONS[node.name], node.arguments[2:]
    assert relation.candidate_pairs is not None
    search = relation.candidate_pairs.search
    tables = {sql.value(side).sql_type.table for side in sides}
    if "sites" in tables:  # the searches compare what has shapes
        return None
    kind = _kind_of(tables)
    if not relation.is_symmetric:  # the search gives pairs in the order of its arguments
        sides = (node.arguments[0], node.arguments[1])  # type: ignore[assignment]
    if not all(map(sql.is_constant, constants)) or (kind != "entities" and not search.finds_links):
        return None
    try:
        holds = sql.condition(node)
        names = [parameter.name for parameter in relation.parameters[2 : len(node.arguments)]]
        values = dict(zip(names, map(sql.value, constants), strict=True))
    except NotSqlError:
        return None
    distance = expanded(relation.candidate_distance(len(node.arguments)), values)
    pairs = pair_table(search, distance, schema, sql.context.alias("pairs"), kind)
    result = [
        exp.EQ(this=sql.value(side).sql, expression=column.copy())
        for side, column in zip(sides, pairs.columns, strict=True)
    ]
    exact = () if search.is_exact else (holds,)
    condition = exp.and_(*result, *exact)
    joined = JoinedPairs(schema, search, distance, condition)
    # Links are in the order of their entities, not of their ids, and sensors are before bodies.
    position = pairs.position if kind == "entities" and not search.of_boxes else None
    return PairJoin(pairs.table, joined, position, sides)


def _kind_of(tables: Collection[EntityTable]) -> PairKind:
    """Returns what the sides of pairs are: rows of these tables."""
    if len(tables) > 1:
        return "links and entities"
    return "links" if "links" in tables else "entities"


def implied_condition(sql: Expressions, node: ast.Node) -> exp.Expr | None:
    """Returns the condition that the value of a relation of two implies; None for none.

    `clearance(a, b) < 0.1` implies near boxes, and `contactForce(a, b) > 1` a contact.
    """
    match node:
        case ast.Binary(operator=sign, left=ast.Call() as call, right=limit) if (
            sign in _LESS + _MORE
        ):
            is_less = sign in _LESS
        case ast.Binary(operator=sign, left=limit, right=ast.Call() as call) if (
            sign in _LESS + _MORE
        ):
            is_less = sign in _MORE
        case _:
            return None
    relation = RELATIONS.get(call.name)
    is_positive = not is_less and _is_positive(limit, or_zero=sign in ("<", ">"))
    if relation is None or not (is_less or is_positive) or not sql.is_constant(limit):
        return None
    if is_positive and relation.positive_only_if:
        is_of_pairs = all(isinstance(argument, ast.This) for argument in call.arguments)
        implied = replace(call, name=relation.positive_only_if)
        return sql.condition(implied) if is_of_pairs else None
    geometry = relation.geometry
    if geometry is None or not (
        geometry.is_at_least_box_distance if is_less else geometry.is_zero_beyond_boxes
    ):
        return None
    distance = limit if is_less else ast.Literal(limit.span, 0)
    values: Mapping[str, ast.Node] = dict(zip("abd", (*call.arguments[:2], distance), strict=True))
    try:
        return expanded(BOXES_WITHIN, {name: sql.value(value) for name, value in values.items()})
    except NotSqlError:
        return None


def _is_positive(limit: ast.Node, *, or_zero: bool) -> bool:
    match limit:
        case ast.Literal(value=int() | float() as number):
            return number > 0 or (or_zero and number == 0)
    return False
