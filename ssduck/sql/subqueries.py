"""Translates nested queries to parts of the statement around them.

A nested query whose sources are list literals is unrolled: its rows are the elements. Any other
one becomes a subquery, which can use the rows of the outer query.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import TypeAlias

from sqlglot import exp

from ssduck.language import ast
from ssduck.language.aggregates import is_grouped
from ssduck.language.analysis import aliases_of, is_impure, sees_outside
from ssduck.sql.from_clause import (
    FromItem,
    column_of,
    entity_value,
    product_of,
    unnested,
    world_table,
)
from ssduck.sql.name_resolution import ResolvedQuery, resolve
from ssduck.sql.operators import comparison
from ssduck.sql.plan import ParameterBinding, SourceType
from ssduck.sql.scope import ExpressionScope
from ssduck.sql.sql_values import (
    ENTITY_COLUMNS,
    FloatDomain,
    NotSqlError,
    SqlValue,
    column_type,
    or_failure,
    wrapped,
)
from ssduck.sql.types import INTEGER, SqlType, merged

# More rows than this are not unrolled.
MAX_UNROLLED = 300
# More sources than this are not joined.
MAX_SOURCES = 64
_LISTS = ("list",)
_VALUES = ("value", "val")
_DICTS = ("dict", "dictionary")
# The value of one row at most.
_SCALAR = "scalar"


@dataclass(frozen=True)
class Subquery:
    """The rows of a nested query: tables, conditions, selected values, and order."""

    elements: tuple[FromItem, ...]
    conditions: tuple[exp.Expr, ...]
    items: tuple[SqlValue, ...]
    names: tuple[str, ...]
    order: tuple[exp.Ordered, ...]
    limit: int | None
    may_fail: bool = False  # whether a part of it may fail, so that all rows must be evaluated

    def select(self, *columns: exp.Expr, where: Sequence[exp.Expr] = ()) -> exp.Select:
        """Returns the rows, as a SELECT of these columns."""
        select = product_of(self.elements)
        conditions = [condition.copy() for condition in (*self.conditions, *where)]
        return select.select(*columns).where(*conditions)


@dataclass(frozen=True)
class UnrolledRows:
    """The rows of a nested query one by one: whether each exists, and its selected values."""

    rows: tuple[tuple[exp.Expr, tuple[SqlValue, ...]], ...]
    may_fail: bool


Rows: TypeAlias = Subquery | UnrolledRows


# -- values of nested queries ---------------------------------------------------------------


def value(outer: ExpressionScope, query: ast.Query) -> SqlValue:
    """Returns the value of a nested query."""
    form = _form(query)
    rows = _rows(outer, query)
    if form in _LISTS:
        return _unrolled_list(rows) if isinstance(rows, UnrolledRows) else _list(rows)
    if form == _SCALAR:
        return _scalar(outer, rows)
    if form in _VALUES:
        outer.context.note_possible_failure()  # there may be no row
        return _unrolled_value(rows) if isinstance(rows, UnrolledRows) else _value(rows)
    raise NotSqlError


def counted(outer: ExpressionScope, query: ast.Query) -> SqlValue:
    """Returns the number of elements of the list that a nested query yields."""
    if _form(query) not in (*_LISTS, *_DICTS):
        return _counted_list(value(outer, query))
    rows = _rows(outer, query)
    if rows.may_fail:
        return _counted_list(value(outer, query))
    column_count = len(query.items) or len(query.sources)
    elements_per_row = column_count if _form(query) in _LISTS else 1
    if isinstance(rows, UnrolledRows):
        count_literal, zero = exp.Literal.number(elements_per_row), exp.Literal.number(0)
        cases = [
            exp.case().when(exists, count_literal.copy()).else_(zero.copy())
            for exists, _ in rows.rows
        ]
        total: exp.Expr = cases[0] if cases else zero
        for case in cases[1:]:
            total = exp.Add(this=total, expression=case)
        return SqlValue(exp.paren(total), INTEGER)
    count: exp.Expr = exp.Count(this=exp.Star())
    if rows.limit is not None:
        count = exp.func("least", count, exp.Literal.number(rows.limit))
    if elements_per_row > 1:
        count = exp.Mul(this=count, expression=exp.Literal.number(elements_per_row))
    return SqlValue(exp.paren(rows.select(count)), INTEGER)


def _counted_list(value: SqlValue) -> SqlValue:
    if value.sql_type.type != "list":
        raise NotSqlError
    return SqlValue(exp.func("len", value.sql.copy()), INTEGER)


def emptiness(outer: ExpressionScope, node: ast.Binary) -> exp.Expr | None:
    """Translates `[] == SELECT …` to EXISTS; None for another comparison."""
    match node.left, node.right:
        case (ast.ListLiteral(items=()), ast.Query() as query) | (
            ast.Query() as query,
            ast.ListLiteral(items=()),
        ):
            pass
        case _:
            return None
    if is_impure(query) or _form(query) not in (*_LISTS, *_DICTS, *_VALUES):
        return None
    try:
        rows = _rows(outer, query)
    except NotSqlError:
        if outer.is_constant(query):
            return None
        raise
    if rows.may_fail or (_form(query) in _VALUES and not _never_empty(rows)):
        return None
    if isinstance(rows, Subquery) and rows.limit == 0:
        return exp.convert(node.operator == "==")
    exists = _exists(rows)
    return exp.Not(this=wrapped(exists)) if node.operator == "==" else exists


def _never_empty(rows: Rows) -> bool:
    """Checks whether no selected value is an empty list itself."""
    firsts = (
        [items[0] for _, items in rows.rows] if isinstance(rows, UnrolledRows) else rows.items[:1]
    )
    return all(item.sql_type.type not in ("list", "any") for item in firsts)


def equality(outer: ExpressionScope, node: ast.Binary) -> exp.Expr | None:
    """Translates `x == SELECT … AS value`, False without a row; None for another comparison."""
    sides = (node.left, node.right)
    queries = [s for s in sides if isinstance(s, ast.Query) and _form(s) in _VALUES]
    if len(queries) != 1 or is_impure(queries[0]) or outer.is_constant(queries[0]):
        return None
    result = _rows(outer, queries[0])
    if isinstance(result, UnrolledRows) or result.items[0].sql_type.type in ("list", "any"):
        return None
    values = [
        _value(result, missing=True) if side is queries[0] else outer.value(side) for side in sides
    ]
    if any(value.sql_type.type == "list" for value in values):
        return None  # without a row, the value is an empty list
    compared = comparison(outer.context, node.operator, *values).sql
    otherwise = exp.convert(node.operator == "!=")
    return exp.Coalesce(this=compared, expressions=[otherwise])


def membership(outer: ExpressionScope, left: ast.Node, query: ast.Query) -> exp.Expr | None:
    """Translates `x IN SELECT … AS list` to EXISTS; None if that is not possible."""
    if is_impure(query) or _form(query) not in _LISTS or outer.is_constant(query):
        return None
    rows = _rows(outer, query)
    if rows.may_fail:
        return None
    member = outer.value(left)
    if member.may_fail:
        return None
    if isinstance(rows, UnrolledRows):
        result = [
            exp.and_(exists.copy(), _any_equal(outer, member, items)) for exists, items in rows.rows
        ]
        return exp.paren(exp.or_(*result)) if result else exp.false()
    if rows.limit is not None:
        return None
    return _exists(rows, _any_equal(outer, member, rows.items))


def _any_equal(outer: ExpressionScope, member: SqlValue, items: Sequence[SqlValue]) -> exp.Expr:
    return exp.paren(
        exp.or_(*(comparison(outer.context, "==", member, item).sql.copy() for item in items))
    )


def _exists(rows: Rows, *where: exp.Expr) -> exp.Expr:
    if isinstance(rows, UnrolledRows):
        return (
            exp.paren(exp.or_(*(exists for exists, _ in rows.rows))) if rows.rows else exp.false()
        )
    return exp.Exists(this=rows.select(exp.Literal.number(1), where=where))


def _list(rows: Subquery) -> SqlValue:
    sql_type = _common(rows.items)
    domain = _domain(rows.items)
    items = rows.items[0].sql.copy()
    if len(rows.items) > 1:
        items = exp.Array(expressions=[item.sql.copy() for item in rows.items])
    result: exp.Expr = _aggregated("list", items, rows)
    if len(rows.items) > 1:
        result = exp.Anonymous(this="flatten", expressions=[result])
    if rows.limit is not None:
        end = exp.Literal.number(rows.limit * len(rows.items))
        result = exp.func("list_slice", result, exp.Literal.number(1), end)
    subquery = exp.paren(rows.select(result))
    list_type = SqlType("list", sql_type)
    empty = exp.cast(exp.Array(expressions=[]), list_type.duckdb_type, dialect="duckdb")
    return SqlValue(exp.Coalesce(this=subquery, expressions=[empty]), list_type, domain=domain)


def _scalar(outer: ExpressionScope, rows: Rows) -> SqlValue:
    """Returns the value of the only row; it fails without a row, or with several."""
    if isinstance(rows, UnrolledRows) or rows.items[0].sql_type.type == "entity":
        raise NotSqlError
    outer.context.note_possible_failure()
    value = _value(rows, missing=True)
    if rows.limit != 1:
        if rows.limit is not None:
            raise NotSqlError
        count = exp.paren(rows.select(exp.Count(this=exp.Star())))
        one = exp.EQ(this=count, expression=exp.Literal.number(1))
        value = replace(value, expression=exp.case().when(one, value.sql))
    return replace(value, expression=or_failure(value.sql, value.sql_type))


def _value(rows: Subquery, *, missing: bool = False) -> SqlValue:
    """Returns the first item of the first row; it fails without a row unless it may be missing."""
    item = rows.items[0]
    if rows.limit == 0 or item.sql_type.nullable:
        raise NotSqlError

    def first(expression: exp.Expr, sql_type: SqlType) -> exp.Expr:
        result = exp.paren(rows.select(_aggregated("first", expression.copy(), rows)))
        return result if missing else or_failure(result, sql_type)

    if item.sql_type.type != "entity":
        if not item.sql_type.is_sql or item.sql_type.type == "record":
            raise NotSqlError
        return SqlValue(
            first(item.sql, item.sql_type),
            item.sql_type,
            may_exceed_double=item.may_exceed_double,
            domain=_domain(rows.items[:1]),
        )
    columns = item.column
    assert columns is not None
    if item.sql_type.past:
        raise NotSqlError
    return SqlValue(None, item.sql_type, lambda name: first(columns(name), column_type(name)))


def _aggregated(function: str, expression: exp.Expr, rows: Subquery) -> exp.Expr:
    """Returns an aggregate of the rows in their order."""
    if rows.order:
        expression = exp.Order(this=expression, expressions=[key.copy() for key in rows.order])
    return exp.Anonymous(this=function, expressions=[expression])


def _unrolled_list(rows: UnrolledRows) -> SqlValue:
    every = [item for _, items in rows.rows for item in items]
    sql_type = _common(every)
    empty = exp.cast(exp.Array(expressions=[]), f"{sql_type.duckdb_type}[]", dialect="duckdb")
    parts = [
        exp.case()
        .when(exists, exp.Array(expressions=[item.sql.copy() for item in items]))
        .else_(empty.copy())
        for exists, items in rows.rows
    ]
    listed = exp.Anonymous(this="flatten", expressions=[exp.Array(expressions=parts)])
    return SqlValue(listed, SqlType("list", sql_type), domain=_domain(every))


def _unrolled_value(rows: UnrolledRows) -> SqlValue:
    if rows.may_fail:
        raise NotSqlError  # SQL would not evaluate the rows after the first one
    firsts = [items[0] for _, items in rows.rows]
    sql_type = _common(firsts)
    if sql_type.type == "entity":
        raise NotSqlError
    case = exp.case()
    for exists, items in rows.rows:
        case = case.when(exists, items[0].sql.copy())
    return SqlValue(or_failure(case, sql_type), sql_type, domain=_domain(firsts))


def _domain(items: Sequence[SqlValue]) -> FloatDomain:
    return max((item.domain for item in items), default=FloatDomain.FINITE)


def _common(items: Sequence[SqlValue]) -> SqlType:
    """Returns the one type of values that go into a list."""
    sql_type = merged(item.sql_type for item in items)
    if (
        sql_type is None
        or not sql_type.comes_back
        or sql_type.nullable
        or sql_type.type == "record"
    ):
        raise NotSqlError
    if any(item.may_exceed_double for item in items):
        raise NotSqlError
    return sql_type


# -- the rows of a nested query -------------------------------------------------------------


def _form(query: ast.Query) -> str:
    if query.adapter is None:
        return "dict"
    if query.adapter.of_sql and query.adapter.name == "value":
        return _SCALAR
    return "" if query.adapter.arguments or query.adapter.named else query.adapter.name


def _rows(outer: ExpressionScope, query: ast.Query) -> Rows:
    if query.recursion or query.distinct or is_grouped(query) or is_impure(query):
        raise NotSqlError
    check_sources(query)
    aliases = aliases_of(query)
    before = outer.context.possible_failures
    lists = [_written_out(outer, source.value) for source in query.sources]
    if all(values is not None for values in lists) and lists:
        if outer.context.possible_failures > before:
            raise NotSqlError  # SQL would not evaluate an unused element
        result = list(product(*[values for values in lists if values is not None]))
        if len(result) <= MAX_UNROLLED and not query.order and query.limit is None:
            return _unrolled(outer, query, aliases, result)
    inner = outer.inside()
    before = outer.context.possible_failures
    elements = [
        element(outer, alias, source.value, inner)
        for alias, source in zip(aliases, query.sources, strict=True)
    ]
    past = outer.ticks.past_worlds if sees_outside(query) else set()
    past |= {entry.value.sql_type.schema for entry in elements if entry.value.sql_type.past}
    elements = [
        _beside_past(inner, alias, entry) if entry.value.sql_type.schema in past else entry
        for alias, entry in zip(aliases, elements, strict=True)
    ]
    _bind(inner, aliases, [entry.value for entry in elements])
    rows = _subquery(inner, query, aliases, elements)
    if rows.limit is not None and outer.context.possible_failures > before:
        raise NotSqlError  # SQL would not evaluate rows beyond the limit
    return replace(rows, may_fail=outer.context.possible_failures > before)


def check_sources(query: ast.Query) -> None:
    """Checks that the sources are few enough for DuckDB to plan their product quickly."""
    if len(query.sources) > MAX_SOURCES:
        raise NotSqlError


def _bind(inner: ExpressionScope, aliases: Sequence[str], values: Sequence[SqlValue]) -> None:
    inner.rows.update(zip(aliases, values, strict=True))
    inner.only_alias = aliases[0] if len(aliases) == 1 else None


def _subquery(
    inner: ExpressionScope, query: ast.Query, aliases: Sequence[str], elements: Sequence[FromItem]
) -> Subquery:
    resolved = resolve_in(inner, query, aliases)
    where = resolved.query.where
    conditions = (*inner.ticks.joins(), *(() if where is None else (inner.condition(where),)))
    items = _items(inner, resolved)
    order = ordered(inner, resolved.query.order)
    for entry in elements:
        order.extend(entry.position)
    names = tuple(column.name for column in resolved.columns if isinstance(column.name, str))
    return Subquery(tuple(elements), conditions, items, names, tuple(order), _limit(query))


def _unrolled(
    outer: ExpressionScope,
    query: ast.Query,
    aliases: Sequence[str],
    rows: Sequence[tuple[SqlValue, ...]],
) -> UnrolledRows:
    before = outer.context.possible_failures
    unrolled = []
    for elements in rows:
        inner = outer.inside()
        _bind(inner, aliases, elements)
        resolved = resolve_in(inner, query, aliases)
        where = resolved.query.where
        exists = exp.true() if where is None else inner.condition(where)
        unrolled.append((exists, _items(inner, resolved)))
    return UnrolledRows(tuple(unrolled), outer.context.possible_failures > before)


def _items(inner: ExpressionScope, resolved: ResolvedQuery) -> tuple[SqlValue, ...]:
    values = (inner.value(column.node) for column in resolved.columns)
    return tuple(map(inner.context.nan_checked, values))


def resolve_in(inner: ExpressionScope, query: ast.Query, aliases: Sequence[str]) -> ResolvedQuery:
    """Resolves the bare names of a nested query whose sources are in SQL already."""
    source_types = [SourceType(alias, sql_type=inner.rows[alias].sql_type) for alias in aliases]
    resolved = resolve(query, source_types, inner.names, inner.locals)
    inner.context.plan.bare |= resolved.bare
    if is_grouped(resolved.query):
        raise NotSqlError  # its aggregates turned out to be over all rows
    return resolved


def ordered(inner: ExpressionScope, keys: Sequence[ast.OrderKey]) -> list[exp.Ordered]:
    """Returns the keys of ORDER BY; those that are the same for all rows order nothing.

    Raises:
        NotSqlError: Python orders such values differently, or not at all.
    """
    result = []
    for key in keys:
        if inner.is_constant(key.value):
            if inner.context.constant_type(key.value).type == "any":
                raise NotSqlError  # it may be an error
            continue
        value = inner.value(key.value)
        if not (value.sql_type.is_number or value.sql_type.type in ("string", "boolean")):
            raise NotSqlError
        if not isinstance(value.sql.unnest(), exp.Literal | exp.Boolean):
            this = inner.context.nan_checked(value).sql.copy()
            result.append(exp.Ordered(this=this, desc=key.descending, nulls_first=False))
    return result


def _limit(query: ast.Query) -> int | None:
    if query.offset is not None:
        raise NotSqlError
    match query.limit:
        case None:
            return None
        case ast.Literal(value=number) if type(number) is int and number < 2**31:
            return number
    raise NotSqlError


# -- sources --------------------------------------------------------------------------------


def _written_out(outer: ExpressionScope, node: ast.Node) -> list[SqlValue] | None:
    """Returns the elements of a list that mentions the rows around, or of a value of them."""
    node = _list_in(outer, node)
    if outer.is_constant(node) or isinstance(node, ast.Query):
        return None
    try:
        result = outer.value(node)
    except NotSqlError:
        return None
    if result.elements is not None:
        return list(result.elements)
    return [result] if result.sql_type.type not in ("list", "any") else None


def _list_in(outer: ExpressionScope, node: ast.Node) -> ast.Node:
    if isinstance(node, ast.Name):
        return outer.context.list_in(node.name) or node
    return node


def _beside_past(inner: ExpressionScope, alias: str, entry: FromItem) -> FromItem:
    """Returns a world as a source that stays at its current tick; other sources as they are."""
    sql_type = entry.value.sql_type
    if sql_type.past or not isinstance(entry.table, exp.Table):
        return entry
    present = SourceType(alias, sql_type.schema, past_kind="now", table=sql_type.table)
    return inner.ticks.past(present, ParameterBinding(""))


def element(outer: ExpressionScope, alias: str, node: ast.Node, inner: ExpressionScope) -> FromItem:
    """Returns a source of a nested query: a world or its past, a list, a query of its own.

    `outer` is the scope of its expression, `inner` the one of the query.

    Raises:
        NotSqlError: SQL has no such source.
    """
    node = _list_in(outer, node)
    name = outer.context.alias(alias)
    if isinstance(node, ast.Query):
        return _derived(outer, name, node)
    if not outer.is_constant(node):
        return unnested(name, outer.value(node))
    world = outer.context.plan.worlds.setdefault(node, outer.names.world(node))
    if world is not None and world.past_kind:
        return inner.ticks.past(replace(world, alias=alias), ParameterBinding("", node))
    if world is not None:
        return world_table(str(world.schema), name, world.table)
    sql_type = outer.context.constant_type(node)
    of_elements = sql_type.element if sql_type.type == "list" else sql_type
    if not sql_type.is_sql or of_elements is None or of_elements.type == "record":
        raise NotSqlError
    parameter = outer.context.parameter(alias, ParameterBinding("", node, sql_type=sql_type))
    values_sql = exp.cast(parameter, sql_type.duckdb_type, dialect="duckdb")
    return unnested(name, SqlValue(values_sql, sql_type))


def _derived(outer: ExpressionScope, name: str, query: ast.Query) -> FromItem:
    """Returns a query as a source: its one item, or its columns by their names."""
    form = _form(query)
    rows = _rows(outer, query)
    if rows.may_fail:
        raise NotSqlError  # SQL would not evaluate unused values
    if isinstance(rows, UnrolledRows):
        if form not in _LISTS:
            raise NotSqlError
        return unnested(name, _unrolled_list(rows))
    if form in _LISTS and len(rows.items) == 1:
        return _derived_items(rows, name)
    if form in _DICTS and len(rows.names) == len(rows.items):
        return _derived_records(rows, name)
    raise NotSqlError


def _derived_items(rows: Subquery, name: str) -> FromItem:
    (item,) = rows.items
    if item.sql_type.type != "entity":
        if not item.sql_type.is_sql or item.sql_type.type == "record":
            raise NotSqlError
        value = replace(item, expression=column_of(name, "value"), elements=None)
        return _derived_element(rows, name, value, {"value": item.sql})
    assert item.column is not None
    table = item.sql_type.table
    columns = {column: item.column(column) for column in ENTITY_COLUMNS[table]}
    value = entity_value(item.sql_type.schema, name, table)
    if item.sql_type.nullable or item.sql_type.past:
        raise NotSqlError
    return _derived_element(rows, name, value, columns)


def _derived_records(rows: Subquery, name: str) -> FromItem:
    if len(set(rows.names)) < len(rows.names):
        raise NotSqlError
    columns: dict[str, exp.Expr] = {}
    fields = {}
    for index, (key, item) in enumerate(zip(rows.names, rows.items, strict=True)):
        if not item.sql_type.comes_back or item.sql_type.type == "entity" or item.sql_type.nullable:
            raise NotSqlError
        columns[f"f{index}"] = item.sql
        fields[key] = replace(item, expression=column_of(name, f"f{index}"), elements=None)
    sql_type = SqlType(
        "record", fields=tuple((key, field.sql_type) for key, field in fields.items())
    )
    return _derived_element(rows, name, SqlValue(None, sql_type, fields=fields), columns)


def _derived_element(
    rows: Subquery, name: str, value: SqlValue, columns: dict[str, exp.Expr]
) -> FromItem:
    """Returns a SELECT in FROM, with the keys of its order as columns of their own."""
    keys = [f"key {index + 1}" for index in range(len(rows.order))]
    columns_sql = [exp.alias_(column.copy(), key) for key, column in columns.items()]
    columns_sql += [
        exp.alias_(key.this.copy(), alias, quoted=True)
        for alias, key in zip(keys, rows.order, strict=True)
    ]
    select = rows.select(*columns_sql)
    if rows.limit is not None:
        select = select.order_by(*(key.copy() for key in rows.order)).limit(rows.limit)
    position = tuple(
        exp.Ordered(this=column_of(name, alias), desc=key.args.get("desc"), nulls_first=False)
        for alias, key in zip(keys, rows.order, strict=True)
    )
    return FromItem(value, select.subquery(exp.to_identifier(name)), position)


def is_inline(node: ast.Node) -> bool:
    """Checks whether a source may be a part of the statement rather than a value."""
    return isinstance(node, ast.Query) and node.recursion is None and not is_grouped(node)
