"""Writes the SQL of a plan for other engines, with the values of variables."""

from __future__ import annotations

import sys
from typing import Any

import sqlglot
from sqlglot import exp
from sqlglot.errors import UnsupportedError as SqlglotError

from ssduck.errors import UnknownNameError, UnsupportedError, nearest
from ssduck.formatting import short_repr
from ssduck.language.tree import Query
from ssduck.sql.plan import Plan
from ssduck.sql.sql_values import with_values

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


def in_dialect(query: Query, plan: Plan | None, values: dict[str, Any], dialect: str) -> str:
    """Returns the SQL of a query for an engine.

    Args:
        query: the query.
        plan: its plan; None if it runs row by row.
        values: the values of the plan's parameters.
        dialect: sqlglot's name of the engine.

    Raises:
        UnknownNameError: sqlglot knows no such engine.
        UnsupportedError: Python evaluates a part, or the engine lacks it.
    """
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


def select_for(query: Query, plan: Plan | None, values: dict[str, Any], dialect: str) -> exp.Expr:
    """Returns the SQL of a query as sqlglot's tree, which has nothing that an engine lacks.

    The arguments are those of `in_dialect`.

    Raises:
        UnsupportedError: Python evaluates a part, or the engine lacks it.
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


def _refuse(select: exp.Expr, query: Query) -> None:
    for node in select.walk():
        for kind, words in _DUCKDB_ONLY:
            if isinstance(node, kind):
                raise UnsupportedError(
                    f"not every engine has {words} like DuckDB's: {node.sql('duckdb')[:60]}",
                    span=query.span,
                )
