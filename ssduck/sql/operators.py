"""Translates operators and lists: comparisons, membership, truth, arithmetic, elements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from sqlglot import exp

from ssduck.language import ast
from ssduck.sql.sql_values import (
    FloatDomain,
    NotSqlError,
    SqlValue,
    StatementContext,
    copied,
    failure,
    wrapped,
)
from ssduck.sql.types import ANY, BOOLEAN, DOUBLE, EXACT, INTEGER, SqlType, merged

COMPARISONS = {"==": exp.EQ, "!=": exp.NEQ, ">=": exp.GTE, ">": exp.GT, "<=": exp.LTE, "<": exp.LT}
# Values of different kinds among these are never equal.
_DISJOINT_KINDS = ("string", "list", "number")


def comparison(context: StatementContext, sign: str, left: SqlValue, right: SqlValue) -> SqlValue:
    """Translates a comparison by one of the six operators."""
    if left.sql_type.nullable or right.sql_type.nullable:
        raise NotSqlError  # NULL does not equal NULL
    kinds = tuple("number" if v.sql_type.is_number else v.sql_type.type for v in (left, right))
    equality = sign in ("==", "!=")
    if equality and kinds[0] != kinds[1] and all(kind in _DISJOINT_KINDS for kind in kinds):
        return SqlValue(exp.convert(sign == "!="), BOOLEAN)
    comparable = kinds in (("number", "number"), ("string", "string")) or (
        equality and _may_be_equal(left.sql_type, right.sql_type)
    )
    if kinds == ("number", "number") and (left.may_exceed_double or right.may_exceed_double):
        comparable = left.sql_type.type == right.sql_type.type == "integer"
    if not comparable:
        raise NotSqlError
    kind = COMPARISONS[sign]
    if kinds == ("entity", "entity"):
        return SqlValue(kind(this=left.identity, expression=right.identity), BOOLEAN)
    sides = (wrapped(context.nan_checked(value).sql) for value in (left, right))
    return SqlValue(kind(this=next(sides), expression=next(sides)), BOOLEAN)


def _may_be_equal(left: SqlType, right: SqlType) -> bool:
    if left.type == right.type == "entity" and left.schema == right.schema:
        return True
    common = merged((left, right))
    if any(sql_type.element and sql_type.element.past for sql_type in (left, right)):
        return False  # entities at different ticks are equal, their keys are not
    return common is not None and common.type in ("entity", "boolean", "list") and common.is_sql


def membership(context: StatementContext, left: SqlValue, right: SqlValue) -> SqlValue:
    """Checks whether a value is among the elements of a list, or a text is part of another."""
    if left.sql_type.nullable or right.sql_type.nullable:
        raise NotSqlError
    if left.sql_type.type == right.sql_type.type == "string":
        return SqlValue(exp.func("contains", right.sql, left.sql), BOOLEAN)
    if right.sql_type.type != "list":
        raise NotSqlError
    if right.sql_type.element is None:
        return SqlValue(exp.false(), BOOLEAN)
    if right.elements is not None:
        if right.may_fail:
            raise NotSqlError  # SQL would not evaluate the elements after an equal one
        result = [comparison(context, "==", left, element).sql for element in right.elements]
        return SqlValue(exp.paren(exp.or_(*result)), BOOLEAN)
    common = merged((left.sql_type, right.sql_type.element))
    if common is None or not common.is_sql or left.may_exceed_double or common.past:
        raise NotSqlError
    if left.sql_type.is_number != right.sql_type.element.is_number:
        raise NotSqlError
    return SqlValue(exp.func("list_contains", right.sql, context.nan_checked(left).sql), BOOLEAN)


def like_match(left: SqlValue, right: SqlValue) -> SqlValue:
    """Checks whether a text is as a pattern says."""
    if any(value.sql_type.type != "string" or value.sql_type.nullable for value in (left, right)):
        raise NotSqlError
    return SqlValue(
        exp.paren(exp.Like(this=wrapped(left.sql), expression=wrapped(right.sql))), BOOLEAN
    )


def missing(value: SqlValue) -> SqlValue:
    """Checks whether a value is nothing."""
    if not value.sql_type.is_sql or value.sql_type.type in ("any", "record") or value.may_fail:
        raise NotSqlError
    return SqlValue(exp.paren(exp.Is(this=wrapped(value.sql), expression=exp.Null())), BOOLEAN)


def truth(value: SqlValue) -> exp.Expr:
    """Returns a value as a condition: numbers are true unless 0, texts and lists unless empty."""
    zero = exp.Literal.number(0)
    match value.sql_type.type:
        case "boolean":
            return value.sql
        case "double" | "integer" | "number" if not value.sql_type.nullable:
            return exp.NEQ(this=wrapped(value.sql), expression=zero)
        case "string" if not value.sql_type.nullable:
            return exp.NEQ(this=wrapped(value.sql), expression=exp.Literal.string(""))
        case "list" if not value.sql_type.nullable:
            if value.elements is not None:
                if value.may_fail:
                    raise NotSqlError
                return exp.convert(bool(value.elements))
            return exp.GT(this=exp.func("len", value.sql.copy()), expression=zero)
        case "entity":
            return exp.Not(this=exp.Is(this=value.sql, expression=exp.Null()))
    raise NotSqlError


_SUMS = {"+": exp.Add, "-": exp.Sub, "*": exp.Mul}
MAX_EXPONENT = 64


def arithmetic(
    context: StatementContext, node: ast.Binary, left: SqlValue, right: SqlValue
) -> SqlValue:
    """Returns the value of + - * / % ^ of two numbers.

    Raises:
        NotSqlError: SQL's result may differ from Python's.
    """
    sign = node.operator
    for value in (left, right):
        if not value.sql_type.is_number or value.sql_type.nullable:
            raise NotSqlError
    kinds = {left.sql_type.type, right.sql_type.type}
    sql_type = SqlType("number") if "number" in kinds and "double" not in kinds else DOUBLE
    if kinds == {"integer"}:
        sql_type = INTEGER
    elif left.may_exceed_double or right.may_exceed_double:
        raise NotSqlError  # SQL rounds at another place than Python
    if sign in _SUMS:
        return _sum(context, _SUMS[sign], left, right, sql_type)
    if sign == "/":
        if left.may_exceed_double or right.may_exceed_double:
            raise NotSqlError
        return _quotient(context, node, left, right)
    if sign == "%" and "number" not in kinds:
        return _remainder(context, node, left, right, sql_type)
    if sign == "^" and "number" not in kinds:
        return _power(context, node, left, sql_type)
    raise NotSqlError


def _sum(
    context: StatementContext,
    kind: type[exp.Binary],
    left: SqlValue,
    right: SqlValue,
    sql_type: SqlType,
) -> SqlValue:
    if sql_type == INTEGER:
        context.note_possible_failure()  # Python's integers are unbounded
    sql = kind(this=wrapped(left.sql), expression=wrapped(right.sql))
    domain = FloatDomain.FINITE if sql_type == INTEGER else _domain(kind, left, right)
    # Without a copy, which would take quadratic time for a long sum.
    return SqlValue(
        exp.paren(sql, copy=False),
        sql_type,
        may_exceed_double=sql_type == INTEGER,
        is_non_negative=kind is not exp.Sub and left.is_non_negative and right.is_non_negative,
        domain=domain,
    )


def _quotient(
    context: StatementContext, node: ast.Binary, left: SqlValue, right: SqlValue
) -> SqlValue:
    divided = exp.Div(
        this=wrapped(left.sql), expression=wrapped(right.sql), typed=False, safe=False
    )
    domain = _domain(exp.Div, left, right)
    return SqlValue(_unless_zero(context, node, right, divided, DOUBLE), DOUBLE, domain=domain)


def _remainder(
    context: StatementContext, node: ast.Binary, left: SqlValue, right: SqlValue, sql_type: SqlType
) -> SqlValue:
    """Returns Python's remainder, which has the sign of the divisor."""
    a, b = wrapped(left.sql), wrapped(right.sql)
    remainder = exp.paren(exp.Mod(this=a, expression=b))
    copied(remainder)
    zero = exp.Literal.number(0)
    if sql_type == INTEGER and isinstance(right.sql, exp.Literal) and int(right.sql.name) > 0:
        if left.is_non_negative:  # as in DuckDB; the shorter formula is faster
            return SqlValue(
                remainder, sql_type, may_exceed_double=left.may_exceed_double, is_non_negative=True
            )
        negative = exp.LT(this=remainder, expression=zero)
        case = exp.case().when(negative, exp.Add(this=remainder.copy(), expression=b.copy()))
        return SqlValue(
            case.else_(remainder.copy()),
            sql_type,
            may_exceed_double=left.may_exceed_double,
            domain=FloatDomain.FINITE,
        )
    signs_differ = exp.NEQ(
        this=exp.paren(exp.LT(this=remainder, expression=zero)),
        expression=exp.paren(exp.LT(this=b.copy(), expression=zero.copy())),
    )
    nonzero = exp.NEQ(this=remainder.copy(), expression=zero.copy())
    shifted = exp.Add(this=remainder.copy(), expression=b.copy())
    case = exp.case().when(exp.and_(nonzero, signs_differ), shifted)
    if sql_type != INTEGER:  # a remainder of 0 has the sign of the divisor as well
        signed_zero = exp.Mul(this=b.copy(), expression=zero.copy())
        case = case.when(exp.EQ(this=remainder.copy(), expression=zero.copy()), signed_zero)
    case = case.else_(remainder.copy())
    domain = FloatDomain.NAN if left.domain or right.domain else FloatDomain.FINITE
    sql = _unless_zero(context, node, right, case, sql_type)
    return SqlValue(sql, sql_type, may_exceed_double=left.may_exceed_double, domain=domain)


def _unless_zero(
    context: StatementContext, node: ast.Binary, right: SqlValue, sql: exp.Expr, sql_type: SqlType
) -> exp.Expr:
    """Makes the statement fail where the divisor is 0; SQL would yield NULL."""
    if isinstance(node.right, ast.Literal) and node.right.value:
        return exp.paren(sql)
    context.note_possible_failure()
    is_zero = exp.EQ(this=wrapped(copied(right.sql)), expression=exp.Literal.number(0))
    return exp.case().when(is_zero, failure(sql_type)).else_(sql)


def _power(
    context: StatementContext, node: ast.Binary, left: SqlValue, sql_type: SqlType
) -> SqlValue:
    """Returns a power with a small whole exponent; SQL computes others differently."""
    match node.right:
        case ast.Literal(value=exponent) if type(exponent) is int and 0 <= exponent <= MAX_EXPONENT:
            context.note_possible_failure()
            power = exp.Pow(this=double_of(left), expression=exp.Literal.number(exponent))
            maximum: float = EXACT if sql_type == INTEGER else 1.7976931348623157e308
            too_large = exp.GT(
                this=exp.func("abs", copied(power)), expression=exp.Literal.number(repr(maximum))
            )
            result: exp.Expr = exp.cast(power, "BIGINT") if sql_type == INTEGER else power
            return SqlValue(
                exp.case().when(too_large, failure(sql_type)).else_(result),
                sql_type,
                is_non_negative=left.is_non_negative or exponent % 2 == 0,
            )
    raise NotSqlError


def _domain(kind: type[exp.Binary], left: SqlValue, right: SqlValue) -> FloatDomain:
    """Returns the domain of a sum, a product or a quotient; the operation may overflow."""
    domains = (left.domain, right.domain)
    if max(domains) == FloatDomain.NAN or domains == (FloatDomain.INFINITE, FloatDomain.INFINITE):
        return FloatDomain.NAN
    if kind is exp.Mul and max(domains) == FloatDomain.INFINITE:  # infinity times 0
        finite = left if left.domain == FloatDomain.FINITE else right
        is_factor = isinstance(finite.sql, exp.Literal) and float(finite.sql.this) != 0
        return FloatDomain.INFINITE if is_factor else FloatDomain.NAN
    return FloatDomain.INFINITE


def double_of(value: SqlValue) -> exp.Expr:
    """Returns a number as a DOUBLE."""
    return (
        value.sql.copy()
        if value.sql_type.type == "double"
        else exp.cast(value.sql.copy(), "DOUBLE")
    )


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


def element_at(value: SqlValue, place: int) -> exp.Expr:
    """Returns an element of a list that has so many, counted from 1."""
    if value.elements is not None:
        return value.elements[place - 1].sql
    return exp.func("list_extract", value.sql.copy(), exp.Literal.number(place))
