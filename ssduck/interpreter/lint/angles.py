"""Finds angles that are compared with degrees: the language's angles are in radians."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache, partial
from typing import Any, TypeAlias

from sqlglot import exp

from ssduck import validation
from ssduck.errors import ArgumentError, SourceSpan
from ssduck.interpreter.lint.foregone import ANGLES
from ssduck.interpreter.lint.scope import Check, Scope
from ssduck.interpreter.lint.suspect_values import (
    Comparison,
    is_comparison,
    is_hidden,
    kind_of_relation,
    site_of,
)
from ssduck.language import ast
from ssduck.language.analysis import TEMPORAL_OPERATORS
from ssduck.language.builtins import BUILTINS
from ssduck.sql.user_sql import bound_value, parameter_of, span_of, statement_trees

# The functions whose values are angles if those of an argument are.
_KEEPING = frozenset(
    (
        *("min", "max", "avg", "median", "abs", "round", "previous", "at", "clip", "initially"),
        # The margin of a comparison of an angle is one.
        *("robustness", *(name for name, count in TEMPORAL_OPERATORS.items() if count == 1)),
    )
)
_OF_ANGLES = frozenset(("+", "-", "<", "<=", ">", ">="))
_KEEPING_IN_SQL = (exp.Max, exp.Min, exp.Avg, exp.Median, exp.Abs, exp.Round, exp.Paren)
_COMPARED_IN_SQL = (
    *(exp.GT, exp.GTE, exp.LT, exp.LTE, exp.EQ, exp.NEQ, exp.Between, exp.In),
    exp.Anonymous,  # upright
)
_CALL = re.compile(r"\b(tilt|upright)\s*\(", re.IGNORECASE)


# An angle that is compared with values, or that `upright` takes: the function whose value it is,
# the column that it is (None for the value of a call), the values, and its place.
_Site: TypeAlias = tuple[str, Comparison | None, tuple[ast.Node, ...], SourceSpan]


def angles(statement: ast.Node) -> Iterator[Check]:
    """Yields the check of a statement's angles."""
    sites = tuple(_sites(statement, None))
    if sites:
        yield partial(_degrees_in, sites)


def _sites(node: ast.Node, query: ast.Query | None) -> Iterator[_Site]:
    """Yields the comparisons of angles in a part of a statement; `query` is around it."""
    match node:
        case ast.Query():
            query = node
        case ast.Call(name="upright", arguments=(_, angle)):
            yield "upright", None, (angle,), node.span
        case ast.Binary(left=left, right=right) if is_comparison(node):
            for side, other in ((left, right), (right, left)):
                values = other.items if isinstance(other, ast.ListLiteral) else (other,)
                for part, name, column in _angles_in(side, query):
                    yield name, column, values, part.span
    for child in node.children():
        yield from _sites(child, query)


def _angles_in(
    node: ast.Node, query: ast.Query | None
) -> Iterator[tuple[ast.Node, str, Comparison | None]]:
    """Yields the angles that a value may be: each with its function, and the column that it is."""
    parts: tuple[ast.Node, ...] = ()
    match node:
        case ast.Name(name=name) | ast.QualifiedName(key=name) if (
            name in ANGLES and query is not None
        ):
            column = site_of(node, query, (), node.span)
            if column is not None:
                yield node, name, column
        case ast.Call(name=name) if name in ANGLES:
            yield node, name, None
        case ast.Index(
            base=ast.Call(name="least" | "greatest", arguments=extremes),
            indices=(ast.Literal(value=1),),
        ):
            parts = extremes[:1]
        case ast.Call(name=name, arguments=arguments) if name in _KEEPING:
            parts = arguments
        case ast.ListLiteral(items=items):
            parts = items
        case ast.Query(items=items):
            parts, query = items, node
        case ast.Binary(operator=sign, left=left, right=right) if sign in _OF_ANGLES:
            parts = left, right
    for part in parts:
        yield from _angles_in(part, query)


def _degrees_in(sites: Sequence[_Site], scope: Scope) -> Iterator[ArgumentError]:
    """Yields an error for each angle that is compared with degrees, of BETWEEN for one of two."""
    told: set[SourceSpan] = set()
    for name, column, values, span in sites:
        if column is not None:
            is_angle = not is_hidden(column, scope) and kind_of_relation(column, scope) is not None
        else:
            is_angle = name in BUILTINS or scope.is_relation(name)
        for value in map(partial(_number, scope), values if is_angle else ()):
            if abs(value) > math.pi and span not in told:
                told.add(span)
                yield ArgumentError(_in_degrees(name, value), span=span)


def _number(scope: Scope, node: ast.Node) -> float:
    """Returns a number that is a literal or a variable's value; 0 for another value."""
    value: Any = None
    match node:
        case ast.Unary(operator="-", operand=operand):
            return -_number(scope, operand)
        case ast.Literal(value=value):
            pass
        case ast.Name(name=name):
            value = scope.variable(name)
    return value if validation.is_number(value) else 0


def _in_degrees(name: str, value: float) -> str:
    low, high = ANGLES.get(name, ANGLES["tilt"])
    return (
        f"the angle of {name} is in radians, from {low:.3g} to {high:.3g}: {value} degrees are "
        f"{value} * 3.141592653589793 / 180"
    )


def degrees_in_sql(
    sql: str, parameters: Sequence[Any] | Mapping[str, Any] | None
) -> Iterator[ArgumentError]:
    """Yields an error for each angle of a relation in raw SQL that is compared with degrees."""
    for name, bounds, span in _angles_in_sql(sql):
        values = [bound_value(bound, parameters) for bound in bounds]
        degrees = [v for v in values if validation.is_number(v) and abs(v) > math.pi]
        for value in degrees[:1]:
            yield ArgumentError(_in_degrees(name, value), span=span)


@lru_cache(maxsize=256)
def _angles_in_sql(sql: str) -> tuple[tuple[str, tuple[Any, ...], SourceSpan], ...]:
    """Returns the relations of angles in raw SQL, with what each is compared with, and places."""
    found: list[tuple[str, tuple[Any, ...], SourceSpan]] = []
    for tree in statement_trees(sql) if _CALL.search(sql) else ():
        for node in tree.find_all(*_COMPARED_IN_SQL):
            parts = [node.this, node.args.get("expression"), *node.expressions]
            parts += [node.args.get("low"), node.args.get("high")]
            if isinstance(node, exp.Anonymous):
                parts = node.expressions[1:] if node.name.lower() == "upright" else []
                names = [node.name] * len(parts[:1])
            else:
                names = [name for part in parts if (name := _angle_in_sql(part))]
            values = tuple(map(partial(_bound, sql), parts))
            found += [(name, values, span_of(name, sql)) for name in names]
    return tuple(found)


def _angle_in_sql(part: exp.Expr | None) -> str:
    """Returns the relation whose value an angle in raw SQL is; "" for other parts."""
    while isinstance(part, _KEEPING_IN_SQL):
        part = part.this
    is_angle = isinstance(part, exp.Anonymous) and part.name.lower() == "tilt"
    return part.name if is_angle else ""  # type: ignore[union-attr]


def _bound(sql: str, part: exp.Expr | None) -> Any:
    """Returns a number, or the parameter for one; None for other parts."""
    if isinstance(part, exp.Literal) and not part.is_string:
        return float(part.name) if "." in part.name else int(part.name)
    return parameter_of(part, sql)
