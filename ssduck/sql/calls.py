"""Translates calls: of relations, of built-in functions and of users' functions."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import reduce

from sqlglot import exp

from ssduck.errors import ArgumentError
from ssduck.language import ast
from ssduck.language.analysis import BINARY_SIGNS, IMPURE, OVER_TIME, UNARY_SIGNS
from ssduck.language.builtins import EXTREMES_OF_MARGINS, LEAST_SQUARE, NUMBER_OF_ENTITY
from ssduck.sql import subqueries
from ssduck.sql.operators import double_of, element_at
from ssduck.sql.relation_calls import expanded, in_world, note_pair
from ssduck.sql.relations.registry import RELATIONS
from ssduck.sql.relations.relation import Parameter, Relation
from ssduck.sql.scope import ExpressionScope
from ssduck.sql.sql_values import (
    FloatDomain,
    NotSqlError,
    SqlValue,
    StatementContext,
    copied,
    failure,
    literal,
    or_failure,
    wrapped,
)
from ssduck.sql.types import DOUBLE, INTEGER, POINT, STRING, SqlType

# Functions that SQL and Python take from C, with the same results to the last digit.
_REAL_FUNCTIONS = ("sin", "cos", "tan", "atan", "tanh")
# The logarithm of the largest double.
MAX_EXPONENT_OF_E = 709.782712893384


def call(sql: ExpressionScope, node: ast.Call) -> SqlValue:
    """Returns a function call."""
    sql.names.check_call(node)
    if node.name in IMPURE or node.name in OVER_TIME:
        raise NotSqlError
    if node.name in RELATIONS:
        return _relation(sql, RELATIONS[node.name], node)
    if node.name in BINARY_SIGNS:
        left, right = node.arguments
        return sql.value(ast.Binary(node.span, BINARY_SIGNS[node.name], left, right))
    if node.name in UNARY_SIGNS:
        return sql.value(ast.Unary(node.span, UNARY_SIGNS[node.name], *node.arguments))
    if node.name == "count" and isinstance(node.arguments[0], ast.Query):
        return subqueries.counted(sql, node.arguments[0])
    values = [sql.value(argument) for argument in node.arguments]
    builtin = _builtin(sql.context, node.name, values)
    if builtin is not None:
        return builtin
    signature = sql.names.signature(node.name, tuple(value.sql_type for value in values))
    if signature is None or any(
        value.sql_type.nullable or value.may_exceed_double for value in values
    ):
        raise NotSqlError
    sql.context.note_possible_failure()
    sql.context.plan.signatures.add(signature)
    arguments = [
        exp.cast(value.sql.copy(), sql_type.duckdb_type, dialect="duckdb")
        for value, sql_type in zip(values, signature.parameters, strict=True)
    ]
    return SqlValue(
        exp.Anonymous(this=exp.to_identifier(signature.name, quoted=True), expressions=arguments),
        signature.result,
    )


def _relation(sql: ExpressionScope, relation: Relation, node: ast.Call) -> SqlValue:
    count = len(node.arguments)
    if relation.may_fail and (sql.rows or sql.outer is not None):
        sql.context.note_possible_failure()  # for rows that an earlier condition would exclude
    values = {
        parameter.name: _argument(sql, relation, parameter, argument)
        for parameter, argument in zip(relation.parameters, node.arguments, strict=False)
    }
    arguments = dict(values)
    sql.ticks.join_entities(values, at_one_tick=bool(relation.tables))
    joined = [value for name, value in values.items() if value is not arguments[name]]
    over_ticks = sql.ticks.over_all_ticks(relation, values, count)
    if over_ticks is not None:
        return over_ticks
    tables = [value.sql_type.table for value in values.values()]
    has_links = any(table != "entities" for table in tables)
    formula = relation.formula_of(tables, count)
    if relation.result == "entity":
        (entity,) = values.values()

        def column(name: str) -> exp.Expr:
            return expanded(formula, values, name)

        return SqlValue(None, replace(entity.sql_type, nullable=relation.name != "obj"), column)
    if relation.tables:
        ticks = sql.ticks.of(values.values())
        is_cautious = sql.context.plan.purpose == "cautious"
        if len(ticks) > 1 and (sql.outer is None or is_cautious):  # a nested query stays in the SQL
            sql.context.note_possible_failure()
        formula = in_world(relation, formula, values, ticks)
    result = expanded(formula, values, relation.link_name if has_links else None)
    if relation.tables:
        result = _unless_missing(result, joined)
    decides_alone = relation.geometry is not None and relation.geometry.decides_alone
    if relation.of_contacts is not None or (decides_alone and not has_links):
        note_pair(result, relation, values)
    domain = FloatDomain.INFINITE if relation.may_be_infinite else FloatDomain.FINITE
    if isinstance(result, exp.Array):
        return _array(result, domain)
    sql_type = SqlType(relation.result_type(count))
    if sql_type.type == "list":
        element = SqlType(relation.element)
        sql_type = SqlType(
            "list", SqlType("list", DOUBLE) if relation.element == "list" else element
        )
    return SqlValue(result, sql_type, is_non_negative=relation.name == "tick", domain=domain)


def _unless_missing(result: exp.Expr, entities: Sequence[SqlValue]) -> exp.Expr:
    """Returns what depends on rows of other tables, NULL where an entity was not there."""
    ids = [entity.column("id") for entity in entities if entity.column is not None]
    if not ids or isinstance(result, exp.Array):
        return result
    case = exp.case()
    for id in ids:
        case = case.when(exp.Is(this=id, expression=exp.null()), exp.null())
    return case.else_(result)


def _array(array: exp.Array, domain: FloatDomain) -> SqlValue:
    """Returns a list of numbers, or of lists of numbers, whose elements are written out."""
    elements = tuple(
        _array(part, domain)
        if isinstance(part, exp.Array)
        else SqlValue(part, DOUBLE, domain=domain)
        for part in array.expressions
    )
    length = 3 if len(elements) == 3 else None
    element = replace(elements[0].sql_type, length=None)
    return SqlValue(array, SqlType("list", element, length), elements=elements, domain=domain)


def _argument(
    sql: ExpressionScope, relation: Relation, parameter: Parameter, node: ast.Node
) -> SqlValue:
    value = _point(sql, parameter, node) or sql.value(node)
    if value.sql_type.nullable:
        raise NotSqlError  # NULL in SQL, but an error in Python
    if value.domain and parameter.type == "double":
        value = sql.context.nan_checked(value)  # a distance may be infinite
    elif value.domain:
        raise NotSqlError  # a formula of infinities may be NaN
    if value.may_fail:
        raise NotSqlError
    if value.sql_type.type == parameter.type or (
        parameter.type == "double" and value.sql_type.is_number
    ):
        return value
    if parameter.type == "place" and value.sql_type.type == "entity":
        return value
    element = value.sql_type.element
    if (
        parameter.type == "place"
        and value.sql_type.type == "list"
        and element
        and element.is_number
    ):
        if value.sql_type.length != 3:
            raise _argument_error(sql, relation, parameter, "a list of another length", node)
        index = {"x": 1, "y": 2, "z": 3}
        return replace(value, column=lambda name: element_at(value, index[name]))
    raise _argument_error(sql, relation, parameter, value.sql_type.words, node)


def _point(sql: ExpressionScope, parameter: Parameter, node: ast.Node) -> SqlValue | None:
    """Returns an array or a list that is a point, whose numbers are doubles; None for another.

    Where no place is asked, an array has another meaning, and a list may have integers.
    """
    if parameter.type != "place" or isinstance(node, ast.ListLiteral) or not sql.is_constant(node):
        return None
    sql_type = sql.context.constant_type(node)
    element = sql_type.element
    is_point = sql_type.length == 3 and element is not None and element.is_number
    if not is_point and sql_type.type != "array":
        return None
    return sql.context.constant("point", node, POINT)


def _argument_error(
    sql: ExpressionScope, relation: Relation, parameter: Parameter, actual: str, node: ast.Node
) -> Exception:
    """Returns the error for an argument; in a query it is an error only if a row reaches it."""
    if sql.rows or sql.outer is not None:
        return NotSqlError()
    message = f"{relation.name}: {parameter.name} must be {parameter.meaning}, not {actual}"
    if actual == "a text" and parameter.type in ("entity", "place"):
        message += (
            "; the entity of a name is room['cup'] in a world room, its link room['cup'].handle, "
            "that of a row this"
        )
    return ArgumentError(message, span=node.span)


def _builtin(context: StatementContext, name: str, values: list[SqlValue]) -> SqlValue | None:
    """Returns a function of the language that SQL has too."""
    match name, values:
        case "count", [SqlValue(sql_type=SqlType(type="list")) as value]:
            return SqlValue(exp.func("len", value.sql.copy()), INTEGER)
        case "abs", [SqlValue(sql_type=SqlType(type="double" | "integer")) as value] if (
            not value.may_exceed_double
        ):
            return SqlValue(
                exp.func("abs", value.sql.copy()),
                value.sql_type,
                is_non_negative=True,
                domain=value.domain,
            )
        case "sqrt", [SqlValue(sql_type=SqlType(type="double" | "integer")) as value] if (
            not value.may_exceed_double
        ):
            return _root(context, value)
        case name, [value] if (
            name in _REAL_FUNCTIONS and value.sql_type.is_number and not value.may_exceed_double
        ):
            return _real_function(context, name, value)
        case "exp", [value] if value.sql_type.is_number and not value.may_exceed_double:
            return _exponential(context, value)
        case "norm", [SqlValue(elements=tuple() as elements)] if elements and all(
            e.sql_type.is_number and not e.may_exceed_double for e in elements
        ):
            return _norm(context, elements)
        case "clip", [_, _, _] if {v.sql_type.type for v in values} in (
            {"double"},
            {"double", "integer"},
        ):
            return _clipped([context.nan_checked(v) if v.domain else v for v in values])
        case "int", [SqlValue(sql_type=SqlType(type="boolean", nullable=False)) as value]:
            return SqlValue(exp.cast(value.sql.copy(), "BIGINT"), INTEGER, is_non_negative=True)
        case "floor" | "ceil", [SqlValue(sql_type=SqlType(type="double")) as value]:
            context.note_possible_failure()
            whole = exp.Anonymous(this=name, expressions=[value.sql.copy()])
            return SqlValue(exp.cast(whole, "BIGINT"), INTEGER, may_exceed_double=True)
        case "str", [SqlValue(sql_type=SqlType(type="string")) as value]:
            return value
        case "str", [SqlValue(sql_type=SqlType(type="integer")) as value]:
            return SqlValue(exp.cast(value.sql.copy(), "VARCHAR"), STRING)
        case "sum", [
            SqlValue(sql_type=SqlType(type="list", element=SqlType(type="integer"))) as value
        ]:
            context.note_possible_failure()
            total = exp.cast(_list_function("sum", value), "BIGINT")
            result = exp.Coalesce(this=total, expressions=[literal(0)])
            return SqlValue(result, INTEGER, may_exceed_double=True)
        case "sum", [
            SqlValue(sql_type=SqlType(type="list", element=SqlType(type="double"))) as value
        ]:
            result = exp.Coalesce(this=_list_function("sum", value), expressions=[literal(0.0)])
            # The sum of an empty list is an integer.
            domain = FloatDomain.NAN if value.domain else FloatDomain.INFINITE
            return SqlValue(result, SqlType("number"), domain=domain)
        case "min" | "max" | "margin of AND" | "margin of OR", [
            SqlValue(sql_type=SqlType(type="list", element=SqlType() as element)) as v
        ] if element.type in ("double", "integer", "string"):
            found = _where_all_are_known(v, _list_function(EXTREMES_OF_MARGINS.get(name, name), v))
            if name not in EXTREMES_OF_MARGINS:
                context.note_possible_failure()
                found = or_failure(found, element)
            return SqlValue(found, element, domain=v.domain)
        case "margin of truth", [SqlValue(sql_type=SqlType(type="boolean")) as value]:
            margin = exp.case().when(value.sql, literal(float("inf")))
            margin = margin.when(exp.not_(wrapped(copied(value.sql))), literal(-float("inf")))
            return SqlValue(margin, DOUBLE, domain=FloatDomain.INFINITE)
        case "unit of scale", [value] if value.sql_type.is_number and not value.may_exceed_double:
            context.note_possible_failure()
            unit = double_of(value)
            is_above = exp.GT(this=wrapped(unit), expression=literal(0.0))
            sql = exp.case().when(is_above, copied(unit)).else_(failure(DOUBLE))
            return SqlValue(sql, DOUBLE, is_non_negative=True)
        case name, [SqlValue(column=column)] if name == NUMBER_OF_ENTITY and column is not None:
            return SqlValue(column("id"), INTEGER)
    return None


def _real_function(context: StatementContext, name: str, value: SqlValue) -> SqlValue:
    """Returns a function of a real number; for infinity it fails, as in Python; SQL's is NaN."""
    context.note_possible_failure()
    sql: exp.Expr = exp.Anonymous(this=name, expressions=[double_of(value)])
    if value.domain:
        finite = exp.func("isfinite", copied(double_of(value)))
        sql = exp.case().when(finite, sql).else_(failure(DOUBLE))
    return SqlValue(sql, DOUBLE)


def _exponential(context: StatementContext, value: SqlValue) -> SqlValue:
    """Returns e to the power of a number; where the result is no double it fails, as in Python."""
    is_above = exp.GT(this=wrapped(double_of(value)), expression=literal(MAX_EXPONENT_OF_E))
    return _unless(context, is_above, exp.Exp(this=copied(double_of(value))))


def _norm(context: StatementContext, elements: Sequence[SqlValue]) -> SqlValue:
    """Returns the root of a sum of squares; where that is too large or small, Python has a way."""
    parts = [wrapped(copied(double_of(e))) for e in elements]
    squares: list[exp.Expr] = [exp.Mul(this=part, expression=copied(part)) for part in parts]
    total = reduce(lambda a, b: exp.Add(this=a, expression=b), squares)
    is_large = exp.GT(this=wrapped(total), expression=literal(sys.float_info.max))
    is_small = exp.LT(this=wrapped(copied(total)), expression=literal(LEAST_SQUARE))
    others = [exp.NEQ(this=copied(part), expression=literal(0.0)) for part in parts]
    fails = exp.or_(is_large, exp.and_(is_small, exp.or_(*others)))
    return _unless(context, fails, exp.Sqrt(this=copied(total)))


def _unless(context: StatementContext, fails: exp.Expr, sql: exp.Expr) -> SqlValue:
    """Returns what is not negative, or a failure where a condition holds."""
    context.note_possible_failure()
    result = exp.case().when(fails, failure(DOUBLE)).else_(sql)
    return SqlValue(result, DOUBLE, is_non_negative=True)


def _clipped(values: Sequence[SqlValue]) -> SqlValue:
    """Returns the nearer of two limits, or the number between them, as Python's min and max do."""
    number, low, high = map(double_of, values)
    above = exp.case().when(exp.GT(this=wrapped(low), expression=wrapped(number)), copied(low))
    above = above.else_(copied(number))
    below = exp.case().when(exp.LT(this=wrapped(high), expression=above), copied(high))
    return SqlValue(below.else_(copied(above)), DOUBLE, domain=max(v.domain for v in values))


def _root(context: StatementContext, value: SqlValue) -> SqlValue:
    """Returns a square root; of a negative number it fails, as in Python."""
    root: exp.Expr = exp.Sqrt(this=double_of(value))
    if not value.is_non_negative:
        context.note_possible_failure()
        is_negative = exp.LT(this=wrapped(double_of(value)), expression=exp.Literal.number(0))
        root = exp.case().when(copied(is_negative), failure(DOUBLE)).else_(root)
    return SqlValue(root, DOUBLE, is_non_negative=True, domain=value.domain)


def _where_all_are_known(value: SqlValue, sql: exp.Expr) -> exp.Expr:
    """Returns a function of a list, NULL where an element is: SQL's own passes over NULL."""
    elements = [part.sql for part in value.elements or () if not isinstance(part.sql, exp.Literal)]
    if not elements:
        return sql
    are_known = [exp.not_(exp.Is(this=wrapped(copied(e)), expression=exp.null())) for e in elements]
    return exp.case().when(exp.and_(*are_known), sql)


def _list_function(function: str, value: SqlValue) -> exp.Expr:
    return exp.Anonymous(this=f"list_{function}", expressions=[value.sql.copy()])
