"""Translates the expressions of a query to SQL, through sqlglot.

A part becomes SQL if its types are known and SQL has the same meaning; otherwise `NotSqlError` is
raised, and the part is left to Python. Operations that may fail in SQL (an overflow, a division by
zero, an index out of range) become SQL unless the plan is cautious; if one fails, the query runs
again by a cautious plan, which leaves them to Python.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from sqlglot import exp

from ssduck.errors import ArgumentError
from ssduck.language import ast
from ssduck.language.analysis import is_impure
from ssduck.sql import subqueries
from ssduck.sql.calls import call
from ssduck.sql.operators import (
    COMPARISONS,
    arithmetic,
    comparison,
    concatenation,
    like_match,
    list_literal,
    membership,
    missing,
    truth,
)
from ssduck.sql.plan import ParameterBinding
from ssduck.sql.scope import ExpressionScope
from ssduck.sql.sql_values import (
    NotSqlError,
    SqlValue,
    column_type,
    copied,
    literal,
    or_failure,
    wrapped,
)
from ssduck.sql.types import BOOLEAN, EXACT, STRING

LOGIC = ("AND", "OR", "XOR")
# Longer lists of literals are parameters.
MAX_WRITTEN_LENGTH = 32


class Expressions(ExpressionScope):
    """The expressions of one query, over the elements of its sources."""

    def value(self, node: ast.Node) -> SqlValue:
        """Returns a part as SQL."""
        before = self.context.possible_failures
        value = self._value(node)
        if self.context.possible_failures == before or value.may_fail:
            return value
        if isinstance(value.expression, exp.Boolean):
            raise NotSqlError  # SQL would not evaluate the part that may fail
        return replace(value, may_fail=True)

    def _value(self, node: ast.Node) -> SqlValue:
        match node:
            case ast.This() if node.alias is None or self.element(node.alias) is not None:
                return self._this(node)
            case ast.Literal():
                return self._literal(node)
            case ast.QualifiedName() if self._is_variable(node):
                return self.value(node.index)
            case ast.QualifiedName() if self.element(node.alias) is not None:
                is_record = self._this(node.this).sql_type.type == "record"
                return self._index(self._key_of(node)) if is_record else self._function_of(node)
            case ast.Name(name=name) if name in self.locals:
                return self.locals[name]
            case ast.Name(name=name) if (deferred := self.context.list_in(name)) is not None:
                return self.value(deferred)
            case ast.Query():
                return self._query(node)
            case ast.ListLiteral(items=items) if _is_short(items):
                return list_literal(self.context, [self.value(item) for item in items])
        if self.is_constant(node):
            return self._constant(node)
        match node:
            case ast.Call():
                return call(self, node)
            case ast.Unary(operator="NOT", operand=operand):
                return SqlValue(exp.Not(this=wrapped(truth(self.value(operand)))), BOOLEAN)
            case ast.Unary(operator="IS NULL", operand=operand):
                return missing(self.value(operand))
            case ast.Unary(operator=sign, operand=operand):
                inner = self.number(operand)
                if sign == "+":
                    return inner
                return replace(inner, expression=exp.Neg(this=wrapped(inner.sql)), elements=None)
            case ast.Binary():
                return self._binary(node)
            case ast.OperatorChain():
                return self._chain(node)
            case ast.Index():
                return self._index(node)
            case ast.ListLiteral(items=items):
                return list_literal(self.context, [self.value(item) for item in items])
            case ast.If(otherwise=(otherwise,)) if len(node.else_ifs) < ast.MAX_NESTING:
                return self._choice(node, otherwise)
        raise NotSqlError

    def _function_of(self, node: ast.QualifiedName) -> SqlValue:
        return call(self, node.call(self.names.resolved_name(node.key)))

    def _key_of(self, node: ast.QualifiedName) -> ast.Index:
        return ast.Index(node.span, node.this, node.index.indices)

    def _query(self, node: ast.Query) -> SqlValue:
        """Returns a nested query: a part of the statement, or a constant if it sees no row."""
        try:
            if is_impure(node):
                raise NotSqlError
            return subqueries.value(self, node)
        except NotSqlError:
            if not self.is_constant(node):
                raise
        return self._constant(node)

    def _literal(self, node: ast.Literal) -> SqlValue:
        sql_type = self.names.sql_type(node)
        match node.value:
            case _ if not sql_type.is_sql:  # a number too large for SQL
                raise NotSqlError
            case value:
                return SqlValue(literal(value), sql_type)

    def _this(self, node: ast.This) -> SqlValue:
        value = self.element(node.alias)
        if value is None:
            choices = ", ".join(f"{name}.this" for name in self.rows)
            raise ArgumentError(
                f"'this' alone is ambiguous here; write one of {choices}", span=node.span
            )
        if value.sql_type.type == "any":
            raise NotSqlError
        return value

    def _constant(self, node: ast.Node) -> SqlValue:
        sql_type = self.context.constant_type(node)
        if not sql_type.is_sql or sql_type.type == "record":
            raise NotSqlError
        stem = node.name if isinstance(node, ast.Name | ast.Placeholder) else "value"
        if sql_type.type != "entity":
            return self.context.constant(stem, node, sql_type)

        def column(name: str) -> exp.Expr:
            binding = ParameterBinding("", node, name, sql_type=column_type(name))
            return self.context.parameter(f"{stem}_{name}", binding)

        return SqlValue(None, sql_type, column)  # its columns become parameters when they are used

    # -- operators --------------------------------------------------------------------------

    def _binary(self, node: ast.Binary) -> SqlValue:
        sign = node.operator
        if sign in LOGIC:
            sides = [truth(self.value(side)) for side in (node.left, node.right)]
            return SqlValue(_joined(sign, sides), BOOLEAN)
        if sign in ("==", "!="):
            result = subqueries.emptiness(self, node) or subqueries.equality(self, node)
            if result is not None:
                return SqlValue(result, BOOLEAN)
        if sign == "IN" and isinstance(node.right, ast.Query):
            result = subqueries.membership(self, node.left, node.right)
            if result is not None:
                return SqlValue(result, BOOLEAN)
        left_value, right_value = self.value(node.left), self.value(node.right)
        if sign in COMPARISONS:
            return comparison(self.context, sign, left_value, right_value)
        if sign == "IN":
            return membership(self.context, left_value, right_value)
        if sign == "LIKE":
            return like_match(left_value, right_value)
        if sign == "+" and left_value.sql_type.type == right_value.sql_type.type == "string":
            joined = exp.DPipe(this=wrapped(left_value.sql), expression=wrapped(right_value.sql))
            return SqlValue(exp.paren(joined, copy=False), STRING)
        if sign == "+" and left_value.sql_type.type == right_value.sql_type.type == "list":
            return concatenation(left_value, right_value)
        a, b = left_value.elements, right_value.elements
        if sign == "-" and a is not None and b is not None and len(a) == len(b):
            parts = [arithmetic(self.context, node, *pair) for pair in zip(a, b, strict=True)]
            return list_literal(self.context, parts)
        return arithmetic(self.context, node, left_value, right_value)

    def _chain(self, node: ast.OperatorChain) -> SqlValue:
        """Translates long chains of AND, OR or XOR; others would be nested too deeply for SQL."""
        sign = node.operators[0]
        if sign not in LOGIC or len(node.operands) > ast.MAX_CHAIN:
            raise NotSqlError
        return SqlValue(_joined(sign, [truth(self.value(side)) for side in node.operands]), BOOLEAN)

    def _index(self, node: ast.Index) -> SqlValue:
        if len(node.indices) > ast.MAX_NESTING:
            raise NotSqlError
        value = self.value(node.base)
        for index in node.indices:
            value = _indexed(self, value, index)
        return value

    def _choice(self, node: ast.If, otherwise: ast.Node) -> SqlValue:
        if any(len(branch.then) != 1 for branch in node.branches):
            raise NotSqlError
        values = [self.value(branch.then[0]) for branch in node.branches]
        last = self.value(otherwise)
        if last.sql_type.type == "entity" or any(
            value.sql_type != last.sql_type for value in values
        ):
            raise NotSqlError
        case = exp.case()
        for branch, value in zip(node.branches, values, strict=True):
            case = case.when(truth(self.value(branch.condition)), value.sql)
        all_values = (*values, last)
        domain = max(value.domain for value in all_values)
        may_exceed_double = any(value.may_exceed_double for value in all_values)
        return SqlValue(
            case.else_(last.sql), last.sql_type, may_exceed_double=may_exceed_double, domain=domain
        )


def _joined(sign: str, sides: Sequence[exp.Expr]) -> exp.Expr:
    """Conditions with AND, OR or XOR between them, nested as little as can be."""
    if len(sides) == 1:
        return sides[0]
    half = (len(sides) + 1) // 2
    left, right = _joined(sign, sides[:half]), _joined(sign, sides[half:])
    if sign == "XOR":
        return exp.paren(exp.NEQ(this=wrapped(left), expression=wrapped(right)), copy=False)
    connect = exp.and_ if sign == "AND" else exp.or_
    return exp.paren(connect(left, right, copy=False), copy=False)


def _is_short(items: Sequence[ast.Node]) -> bool:
    """Checks whether a list is so short that it is written out."""
    return 0 < len(items) <= MAX_WRITTEN_LENGTH and all(isinstance(i, ast.Literal) for i in items)


def _indexed(sql: ExpressionScope, value: SqlValue, index: ast.Node) -> SqlValue:
    """Returns an element of a list, or what a key of a record holds."""
    match index:
        case ast.Literal(value=str() as key) if key in value.fields:
            return value.fields[key]
        case ast.Literal(value=number) if type(number) is int and value.elements is not None:
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


def _place(sql: ExpressionScope, index: ast.Node) -> exp.Expr:
    """Returns an index as SQL counts: from 1, or from the end."""
    match index:
        case ast.Literal(value=number) if type(number) is int and number < EXACT:
            return exp.Literal.number(number + 1)
    place = sql.number(index)
    if place.sql_type.type != "integer":
        raise NotSqlError
    negative = exp.LT(this=wrapped(place.sql), expression=exp.Literal.number(0))
    shifted = exp.Add(this=wrapped(place.sql), expression=exp.Literal.number(1))
    return exp.case().when(negative, copied(place.sql)).else_(shifted)
