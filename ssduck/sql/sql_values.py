"""SQL values: expressions with their types, domains and parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from itertools import islice
from typing import Any

from sqlglot import exp

from ssduck.language import ast
from ssduck.schema import TABLES, EntityTable
from ssduck.sql.plan import ParameterBinding, Plan, TypeEnvironment
from ssduck.sql.relations.relation import ValueType
from ssduck.sql.types import IDS, SqlType

_TABLES: tuple[EntityTable, ...] = "sites", "links", "entities"
_COLUMN_TYPES: dict[str, ValueType] = {
    column.name: column.type
    for table in _TABLES
    for column in TABLES[table].shown_columns
    if column.type in ("double", "integer", "string", "boolean")
}
ENTITY_COLUMNS = {
    table: tuple(column.name for column in TABLES[table].shown_columns) for table in _TABLES
}


# The largest number of nodes of a part that is written twice; longer ones would grow exponentially.
MAX_INLINE_LENGTH = 100


class NotSqlError(Exception):
    """An expression that is left to Python."""


class FloatDomain(IntEnum):
    """The reals that a value may be: finite ones; infinities as well; NaN as well.

    In DuckDB, NaN equals itself and is greater than all numbers; in Python it does neither. So NaN
    must not be compared in SQL.
    """

    FINITE = 0
    INFINITE = 1
    NAN = 2


@dataclass(frozen=True)
class SqlValue:
    """A node as SQL: its expression, its type, and its columns, elements or fields."""

    # The value; None for an entity stands for its id, or its key at a recorded tick.
    expression: exp.Expr | None
    sql_type: SqlType  # its type
    column: Callable[[str], exp.Expr] | None = None  # a function that returns a column of an entity
    elements: tuple[SqlValue, ...] | None = None  # the elements of a list literal
    fields: Mapping[str, SqlValue] = field(default_factory=dict)  # the values of a record, by key
    may_exceed_double: bool = False  # whether it may be an integer that a DOUBLE cannot represent
    is_non_negative: bool = False  # whether it is a number that is never below 0; it may be NaN
    domain: FloatDomain = FloatDomain.FINITE  # the reals that it, or the elements of a list, may be
    # Whether SQL may fail at it, so that it must be evaluated where Python does.
    may_fail: bool = False

    @property
    def sql(self) -> exp.Expr:
        """The value; of an entity its id, at a recorded tick its key."""
        if self.expression is not None:
            return self.expression
        if self.column is None:
            raise NotSqlError
        if not self.sql_type.past:
            return self.column("id")
        ticks = exp.Mul(this=self.column("tick"), expression=exp.Literal.number(IDS))
        return exp.paren(exp.Add(this=ticks, expression=self.column("id")))

    @property
    def identity(self) -> exp.Expr:
        """The expression to compare: of an entity its id, at whatever tick it is."""
        if self.sql_type.type == "entity" and self.sql_type.past and self.column is not None:
            return self.column("id")
        return self.sql


@dataclass
class StatementContext:
    """The state that the expressions of one statement share."""

    names: TypeEnvironment  # the variables, the functions, and the types of constants
    plan: Plan  # the plan, which notes what it depends on
    changing: frozenset[str] = frozenset()  # the variables that differ from row to row
    aliases: set[str] = field(default_factory=set)  # the aliases in SQL, in lower case
    possible_failures: int = 0  # the number of parts that may fail in SQL

    def note_possible_failure(self) -> None:
        """Notes that the expression may fail in SQL; a cautious plan leaves it to Python."""
        if self.plan.purpose == "cautious":
            raise NotSqlError
        self.possible_failures += 1

    def nan_checked(self, value: SqlValue) -> SqlValue:
        """Returns a value that fails where it is NaN, so that Python evaluates it."""
        if value.domain < FloatDomain.NAN:
            return value
        self.note_possible_failure()
        is_none = exp.func("isnan", copied(value.sql))
        case = exp.case().when(is_none, failure(value.sql_type)).else_(value.sql)
        return replace(value, expression=case, domain=FloatDomain.INFINITE)

    def alias(self, name: str) -> str:
        """Returns an alias of a source that is free in SQL, which ignores the case of letters."""
        candidates = (name if n == 1 else f"{name} {n}" for n in range(1, len(self.aliases) + 2))
        alias = next(alias for alias in candidates if alias.casefold() not in self.aliases)
        self.aliases.add(alias.casefold())
        return alias

    def parameter(self, stem: str, binding_key: ParameterBinding) -> exp.Expr:
        """Returns the parameter for a binding; equal bindings share one."""
        for binding in self.plan.bindings:
            if replace(binding, name="") == binding_key:
                return exp.Parameter(this=exp.var(binding.name))
        stem = stem if stem.isidentifier() else "value"
        names = {binding.name.lower() for binding in self.plan.bindings}
        candidates = (stem if n == 1 else f"{stem}_{n}" for n in range(1, len(names) + 2))
        name = next(name for name in candidates if name.lower() not in names)
        self.plan.bindings.append(replace(binding_key, name=name))
        return exp.Parameter(this=exp.var(name))

    def constant(self, stem: str, node: ast.Node, sql_type: SqlType) -> SqlValue:
        """Returns the value of a part that does not depend on rows, and is no entity."""
        parameter = self.parameter(stem, ParameterBinding("", node, sql_type=sql_type))
        if sql_type.type == "list":
            parameter = exp.cast(parameter, sql_type.duckdb_type, dialect="duckdb")
        return SqlValue(parameter, sql_type)

    def list_in(self, name: str) -> ast.Node | None:
        """Returns the list that a variable holds for this query."""
        if name not in self.plan.deferred:
            self.plan.deferred[name] = self.names.deferred(name)
        return self.plan.deferred[name]

    def constant_type(self, node: ast.Node) -> SqlType:
        """Returns the type of a part that does not depend on rows."""
        return self.plan.constants.setdefault(node, self.names.sql_type(node))


def literal(value: Any) -> exp.Expr:
    """Returns a value as it is written in DuckDB's SQL."""
    if isinstance(value, list):
        return exp.Array(expressions=[literal(element) for element in value])
    if isinstance(value, float) and not math.isfinite(value):
        return exp.cast(exp.Literal.string(str(value)), "DOUBLE")
    if isinstance(value, float):
        # A literal with an exponent is a DOUBLE in DuckDB, and not a DECIMAL.
        text = repr(float(value))
        return exp.Literal.number(text if "e" in text else f"{text}e0")
    return exp.convert(value)


def copied(sql: exp.Expr) -> exp.Expr:
    """Copies an expression that is written a second time.

    Raises:
        NotSqlError: it is too long.
    """
    if next(islice(sql.walk(), MAX_INLINE_LENGTH, None), None) is not None:
        raise NotSqlError
    return sql.copy()


def with_values(values: Mapping[str, Any]) -> Callable[[exp.Expr], exp.Expr]:
    """Returns a transformation that replaces parameters by values; those without one stay."""

    def substitute(part: exp.Expr) -> exp.Expr:
        if isinstance(part, exp.Parameter) and part.name in values:
            return literal(values[part.name])
        return part

    return substitute


def column_type(name: str) -> SqlType:
    """Returns the type of a column of an entity."""
    return SqlType(_COLUMN_TYPES[name])


def failure(sql_type: SqlType) -> exp.Expr:
    """Returns an expression that makes the statement fail where it is evaluated."""
    failing = exp.Anonymous(this="error", expressions=[exp.Literal.string("left to Python")])
    return exp.cast(failing, sql_type.duckdb_type, dialect="duckdb")


def or_failure(sql: exp.Expr, sql_type: SqlType) -> exp.Expr:
    """Returns the value, or a failure of the statement where there is none."""
    return exp.Coalesce(this=sql, expressions=[failure(sql_type)])


def wrapped(sql: exp.Expr) -> exp.Expr:
    """Adds parentheses unless the expression is a single term."""
    return (
        exp.paren(sql)
        if isinstance(sql, exp.Binary | exp.Unary) and not isinstance(sql, exp.Paren)
        else sql
    )
