"""Translates lists: literals, concatenation, and elements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from sqlglot import exp

from ssduck.language import tree
from ssduck.language.tree import Node
from ssduck.sql.scope import ExpressionScope
from ssduck.sql.sql_values import (
    FloatDomain,
    NotSqlError,
    SqlValue,
    StatementContext,
    copied,
    or_failure,
    wrapped,
)
from ssduck.sql.types import ANY, EXACT, SqlType, merged


def list_literal(context: StatementContext, values: Sequence[SqlValue]) -> SqlValue:
    """Returns a list that is written out."""
    sql_type = merged(value.sql_type for value in values)
    if any(value.sql_type.nullable or value.may_exceed_double for value in values):
        raise NotSqlError
    elements = tuple(map(context.nan_checked, values))
    domain = max((value.domain for value in elements), default=FloatDomain.FINITE)
    if sql_type is None:
        return SqlValue(
            exp.cast(exp.Array(expressions=[]), "INTEGER[]"), SqlType("list"), elements=()
        )
    length = 3 if len(values) == 3 else None
    if not sql_type.is_sql or sql_type.type == "record":
        if all(value.sql_type.is_sql for value in values):  # its elements are available one by one
            return SqlValue(None, SqlType("list", ANY, length), elements=elements, domain=domain)
        raise NotSqlError
    sql: exp.Expr = exp.Array(expressions=[value.sql.copy() for value in elements])
    if sql_type.type == "list":
        sql = exp.cast(sql, f"{sql_type.duckdb_type}[]", dialect="duckdb")
    return SqlValue(sql, SqlType("list", sql_type, length), elements=elements, domain=domain)


def concatenation(left: SqlValue, right: SqlValue) -> SqlValue:
    """Returns one list behind the other."""
    sql_type = merged((left.sql_type, right.sql_type))
    if sql_type is None or not sql_type.comes_back:
        raise NotSqlError
    sql = exp.Anonymous(this="list_concat", expressions=[left.sql.copy(), right.sql.copy()])
    elements = None
    if left.elements is not None and right.elements is not None:
        elements = left.elements + right.elements
    domain = max(left.domain, right.domain)
    return SqlValue(sql, replace(sql_type, length=None), elements=elements, domain=domain)


def indexed(sql: ExpressionScope, value: SqlValue, index: Node) -> SqlValue:
    """Returns an element of a list, or what a key of a record holds."""
    match index:
        case tree.Literal(value=str() as key) if key in value.fields:
            return value.fields[key]
        case tree.Literal(value=number) if type(number) is int and value.elements is not None:
            if value.may_fail:
                raise NotSqlError  # SQL would not evaluate the other elements
            if -len(value.elements) <= number < len(value.elements):
                return value.elements[number]
    element = value.sql_type.element
    if value.sql_type.type != "list" or element is None or value.sql_type.nullable:
        raise NotSqlError
    if not element.is_sql:
        raise NotSqlError
    sql.context.note_possible_failure()
    result = exp.Anonymous(this="list_extract", expressions=[value.sql.copy(), _place(sql, index)])
    return SqlValue(or_failure(result, element), element, domain=value.domain)


def _place(sql: ExpressionScope, index: Node) -> exp.Expr:
    """Returns an index as SQL counts: from 1, or from the end."""
    match index:
        case tree.Literal(value=number) if type(number) is int and number < EXACT:
            return exp.Literal.number(number + 1)
    place = sql.number(index)
    if place.sql_type.type != "integer":
        raise NotSqlError
    negative = exp.LT(this=wrapped(place.sql), expression=exp.Literal.number(0))
    shifted = exp.Add(this=wrapped(place.sql), expression=exp.Literal.number(1))
    return exp.case().when(negative, copied(place.sql)).else_(shifted)


def element_at(value: SqlValue, place: int) -> exp.Expr:
    """Returns an element of a list that has so many, counted from 1."""
    if value.elements is not None:
        return value.elements[place - 1].sql
    return exp.func("list_extract", value.sql.copy(), exp.Literal.number(place))
