"""Writes the SQL of queries: for EXPLAIN, with the parts left to Python, and for other engines."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeAlias

import sqlglot
from sqlglot import exp
from sqlglot.errors import UnsupportedError as SqlglotError

from ssduck.errors import UnknownNameError, UnsupportedError, nearest
from ssduck.formatting import joined_names, short_repr
from ssduck.language import ast
from ssduck.sql.plan import Plan
from ssduck.sql.relations.registry import RELATIONS
from ssduck.sql.sql_values import with_values

# The entities whose boxes stand in for shapes, by world.
StandIns: TypeAlias = Mapping[str, Sequence[str]]
PlanOf: TypeAlias = Callable[[ast.Query], Plan | None]


def explained(text: str, statement: ast.Node, plan_of: PlanOf, stand_ins: StandIns) -> str:
    """Describes the SQL of the queries in a statement."""
    queries = outermost([statement])
    if not queries:
        return "-- no query, but an expression of single values"
    return "\n\n".join(
        _explained(text, query, plan, stand_ins) for query, plan in _plans(queries, plan_of)
    )


def outermost(nodes: Iterable[ast.Node]) -> list[ast.Query]:
    """Returns the queries in parts of a program that are in no other query."""
    result: list[ast.Query] = []
    for node in nodes:
        result.extend([node] if isinstance(node, ast.Query) else outermost(node.children()))
    return result


def _plans(
    queries: Iterable[ast.Query], plan_of: PlanOf
) -> Iterator[tuple[ast.Query, Plan | None]]:
    """Yields the queries with their plans, and those that are evaluated before them."""
    for query in queries:
        plan = plan_of(query)
        yield query, plan
        if plan is None:
            yield from _plans(outermost(query.children()), plan_of)
            continue
        evaluated = [
            source.value
            for source, source_type in zip(query.sources, plan.source_types, strict=True)
            if source_type.has_values
        ]
        yield from _plans(outermost([*evaluated, *plan.constants, *plan.python_constants]), plan_of)


def _explained(text: str, query: ast.Query, plan: Plan | None, stand_ins: StandIns) -> str:
    if plan is None:
        lines = [f"-- row by row in Python: {_source(text, query)}"]
    else:
        lines = [plan.select.sql(dialect="duckdb", pretty=True)]
        lines += [f"-- left to Python: {_source(text, node)}" for node in plan.python_parts]
        why = "" if plan.left_for is None else f", for {_source(text, plan.left_for)}"
        lines += [f"-- left to Python: {clause}{why}" for clause in plan.python_clauses.clauses]
        if plan.lookup is not None:
            lines.append("-- no statement runs: the rows of all pairs of the tick are looked up")
    return "\n".join([*lines, *_narrow_phase_lines(query), *_inexact_lines(query, stand_ins)])


def _narrow_phase_lines(query: ast.Query) -> list[str]:
    """Lists the pairs that the narrow phase compares, by relation."""
    names = dict.fromkeys(node.name for node in query.walk() if isinstance(node, ast.Call))
    queries = {name: RELATIONS[name].geometry for name in names if name in RELATIONS}
    return [
        f"-- the narrow phase: {name}, {geometry.pairs}"
        for name, geometry in queries.items()
        if geometry is not None and geometry.pairs
    ]


def _called_name(node: ast.Node) -> str:
    """Returns the function that a part may call; empty if it calls none."""
    match node:
        case (
            ast.Call(name=name)
            | ast.UnresolvedName(name=name)
            | ast.Name(name=name)
            | ast.QualifiedName(key=name)
        ):
            return name
    return ""


def _inexact_lines(query: ast.Query, stand_ins: StandIns) -> list[str]:
    """Lists the entities whose boxes stand in for the shapes that relations use."""
    calls = (_called_name(node) for node in query.walk())
    names = [n for n in dict.fromkeys(calls) if n in RELATIONS and RELATIONS[n].depends_on_shapes]
    if not names:
        return []
    return [
        f"-- not exact: {', '.join(names)} where boxes stand in for shapes: "
        f"{joined_names(entities)} of {world}"
        for world, entities in stand_ins.items()
        if entities
    ]


def _source(text: str, node: ast.Node) -> str:
    return " ".join(text[node.span.start : node.span.end].split())


# Expressions that sqlglot writes for every engine, but that few engines other than DuckDB support.
_DUCKDB_ONLY = (
    (exp.Array, "lists"),
    (exp.Unnest, "lists"),
    (exp.Explode, "lists"),
    (exp.List, "lists"),
    (exp.ArrayContains, "lists"),
    (exp.ArraySlice, "lists"),
    (exp.GenerateSeries, "lists"),
    (exp.Anonymous, "functions"),
)


def in_dialect(query: ast.Query, plan: Plan | None, values: dict[str, Any], dialect: str) -> str:
    """Returns the SQL of a query for an engine."""
    names = {name for name in sqlglot.Dialect.classes if name}
    if not isinstance(dialect, str) or dialect not in names:
        raise UnknownNameError(
            f"there is no SQL dialect {short_repr(dialect)}", suggestions=nearest(dialect, names)
        )
    select = select_for(query, plan, values, dialect)
    try:
        return select.sql(dialect=dialect, unsupported_level=sqlglot.ErrorLevel.RAISE, pretty=True)
    except SqlglotError as error:
        raise UnsupportedError(f"{dialect}: {error}", span=query.span) from error


def select_for(
    query: ast.Query, plan: Plan | None, values: dict[str, Any], dialect: str
) -> exp.Expr:
    """Returns the SQL of a query as sqlglot's tree, which has nothing that an engine lacks.

    The arguments are those of `in_dialect`.
    """
    if plan is None:
        raise UnsupportedError("this query runs row by row in Python", span=query.span)
    for node in plan.python_parts:
        raise UnsupportedError("this is left to Python", span=node.span)
    for clause in plan.python_clauses.clauses:
        raise UnsupportedError(f"{clause} is left to Python", span=query.span)
    if plan.tables or plan.signatures:
        feature = "a table of Python's" if plan.tables else "a Python function"
        raise UnsupportedError(f"{dialect} has no equivalent of {feature}", span=query.span)
    select = plan.select.transform(with_values(values))
    if dialect != "duckdb":
        select = select.transform(_without_infinity)
        _refuse(select, query)
    return select


def _without_infinity(part: exp.Expr) -> exp.Expr:
    """Replaces `x < infinity` by a comparison with the largest number, for engines without it."""
    match part:
        case exp.LT(this=value, expression=exp.Cast(this=exp.Literal(this="infinity"))):
            return exp.LTE(this=value, expression=exp.Literal.number(repr(sys.float_info.max)))
    return part


def _refuse(select: exp.Expr, query: ast.Query) -> None:
    for node in select.walk():
        for kind, words in _DUCKDB_ONLY:
            if isinstance(node, kind):
                raise UnsupportedError(
                    f"not every engine has {words} like DuckDB's: {node.sql('duckdb')[:60]}",
                    span=query.span,
                )
