"""Translates comparisons, membership in lists, and the truth of values."""

from __future__ import annotations

from sqlglot import exp

from ssduck.sql.sql_values import NotSqlError, SqlValue, StatementContext, wrapped
from ssduck.sql.types import BOOLEAN, SqlType, merged

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
