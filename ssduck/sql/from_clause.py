"""The sources of a query as tables: their elements, and the order of these."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from sqlglot import exp

from ssduck.schema import ID_FACTOR, TABLES, EntityTable
from ssduck.sql.relations.geometry_query import PairKind, PairSearch, name_over_ticks
from ssduck.sql.relations.relation import Relation
from ssduck.sql.sql_values import FloatDomain, NotSqlError, SqlValue
from ssduck.sql.types import ANY, BOOLEAN, DOUBLE, IDS, SqlType


@dataclass(frozen=True)
class FromItem:
    """A source in SQL."""

    value: SqlValue  # its current element
    table: exp.Expr  # its table in FROM
    position: tuple[exp.Ordered, ...]  # the keys of the order of its elements


def product_of(elements: Sequence[FromItem]) -> exp.Select:
    """Returns a SELECT of all combinations of sources, without columns yet."""
    select = exp.Select()
    for index, element in enumerate(elements):
        table = element.table.copy()
        if index:
            select.append("joins", exp.Join(this=table, kind="CROSS"))
        else:
            select.from_(table, copy=False)
    return select


def world_table(schema: str, name: str, table: EntityTable = "entities") -> FromItem:
    """Returns the entities of a world, or their links."""
    rows = exp.table_(table, db=schema, alias=exp.to_identifier(name))
    return FromItem(entity_value(schema, name, table), rows, _order_of(name, table))


def _order_of(name: str, table: EntityTable) -> tuple[exp.Ordered, ...]:
    """Returns the keys of the order of entities, sensors first, or of links."""
    if table != "entities":
        return ascending(column_of(name, "entity")), ascending(column_of(name, "link"))
    is_body = exp.NEQ(this=column_of(name, "kind"), expression=exp.Literal.string("sensor"))
    return ascending(is_body), ascending(column_of(name, "id"))


def past_table(
    schema: str,
    name: str,
    first: exp.Expr,
    last: exp.Expr,
    id: exp.Expr | None = None,
    table: EntityTable = "entities",
) -> FromItem:
    """Returns the entities of a world, or their links, at recorded ticks, or one of them."""
    rows = exp.Select(expressions=[exp.Star()])
    rows.from_(exp.table_(TABLES[table].history_view, db=schema), copy=False)
    rows.where(exp.Between(this=exp.column("tick"), low=first, high=last), copy=False)
    if id is not None:
        rows.where(exp.EQ(this=exp.column("id"), expression=id), copy=False)
    subquery = rows.subquery(exp.to_identifier(name, quoted=True))
    return replace(_past(schema, name, table), table=subquery)


def present_table(schema: str, name: str, table: EntityTable = "entities") -> FromItem:
    """Returns the entities of a world, or their links, at its current tick, beside its past."""
    rows = exp.table_(table, db=schema, alias=exp.to_identifier(name, quoted=True))
    return replace(_past(schema, name, table), table=rows)


def _past(schema: str, name: str, table: EntityTable) -> FromItem:
    live = world_table(schema, name, table)
    position = (ascending(column_of(name, "tick")), *live.position)
    return FromItem(past_value(schema, name, table), live.table, position)


def past_value(schema: str, name: str, table: EntityTable = "entities") -> SqlValue:
    """Returns the current row of a table of entities or links at recorded ticks."""
    sql_type = SqlType("entity", schema=schema, past=True, table=table)
    return SqlValue(None, sql_type, lambda column: column_of(name, column))


def entity_value(schema: str | None, name: str, table: EntityTable = "entities") -> SqlValue:
    """Returns the current row of a table of entities or links."""
    sql_type = SqlType("entity", schema=schema, table=table)
    return SqlValue(column_of(name, "id"), sql_type, lambda column: column_of(name, column))


def unnested(name: str, values: SqlValue) -> FromItem:
    """Returns the elements of a list; of any other value itself."""
    rows, sql_type = values.sql, values.sql_type.element
    if values.sql_type.type != "list":
        rows, sql_type = exp.Array(expressions=[values.sql]), values.sql_type
    if sql_type is None or not sql_type.is_sql or sql_type.nullable:
        raise NotSqlError
    numbers = exp.func("generate_subscripts", rows.copy(), exp.Literal.number(1))
    column_name = "id" if sql_type.type == "entity" else "value"
    table: exp.Select = exp.select(
        exp.alias_(exp.func("unnest", rows.copy()), column_name), exp.alias_(numbers, "n")
    )
    position = (ascending(column_of(name, "n")),)
    alias = exp.to_identifier(name)
    if sql_type.type != "entity":
        value = SqlValue(column_of(name, "value"), sql_type, domain=values.domain)
        return FromItem(value, table.subquery(alias), position)
    keys: list[int | str | exp.Expr] = ["id"]
    source: str = sql_type.table
    value = entity_value(sql_type.schema, name, sql_type.table)
    if sql_type.past:  # by the key of a tick and an entity
        value = past_value(str(sql_type.schema), name, sql_type.table)
        alias = exp.to_identifier(name, quoted=True)
        source, keys = TABLES[source].history_view, ["tick", "id"]
        tick = exp.IntDiv(this=exp.column("id"), expression=exp.Literal.number(IDS))
        id = exp.Mod(this=exp.column("id"), expression=exp.Literal.number(IDS))
        parts = exp.alias_(tick, "tick"), exp.alias_(id, "id"), "n"
        table = exp.select(*parts).from_(table.subquery("k"))
    entities = exp.table_(source, db=sql_type.schema, alias="e")
    joined = exp.select("e.*", "i.n").from_(table.subquery("i")).join(entities, using=keys)
    return FromItem(value, joined.subquery(alias), position)


@dataclass(frozen=True)
class JoinedEntity:
    """An entity at the tick of another row: its value and the join of its row."""

    value: SqlValue
    join: exp.Join


def joined_entity(
    schema: str, name: str, tick: exp.Expr, id: exp.Expr, entity_table: EntityTable = "entities"
) -> JoinedEntity:
    """Returns an entity at the tick of a row; unknown where it was not there."""
    history = TABLES[entity_table].history_view
    table = exp.table_(history, db=schema, alias=exp.to_identifier(name, quoted=True))
    same_tick = exp.EQ(this=column_of(name, "tick"), expression=tick.copy())
    same_id = exp.EQ(this=column_of(name, "id"), expression=id.copy())
    join = exp.Join(this=table, side="LEFT", on=exp.and_(same_tick, same_id))
    return JoinedEntity(past_value(schema, name, entity_table), join)


def pairs_over_ticks(
    relation: Relation,
    distance: exp.Expr,
    row: TickRange,
    ids: tuple[exp.Expr, exp.Expr],
    columns: tuple[exp.Expr, exp.Expr],
    name: str,
) -> JoinedEntity:
    """Returns a relation of two entities at the tick of a row, computed for all ticks at once."""
    geometry = relation.geometry
    assert geometry is not None
    assert geometry.over_ticks is not None
    arguments: list[exp.Expr] = [
        exp.Literal.string(row.schema),
        row.first.copy(),
        row.last.copy(),
        *(exp.Literal.number(0) if isinstance(id, exp.Column) else id.copy() for id in ids),
        exp.cast(distance.copy(), "DOUBLE"),
    ]
    function = exp.to_identifier(name_over_ticks(geometry.over_ticks), quoted=True)
    result = exp.Anonymous(this=function, expressions=arguments)
    unnested_pairs = exp.select(exp.alias_(exp.func("unnest", result), "p")).subquery("found")
    parts = [
        exp.alias_(exp.func("struct_extract", exp.column("p"), exp.Literal.string(part)), part)
        for part in ("tick", "a", "b", "value")
    ]
    table = exp.select(*parts).from_(unnested_pairs).subquery(exp.to_identifier(name, quoted=True))
    equal = zip(("tick", "a", "b"), (row.tick, *columns), strict=True)
    on = exp.and_(*(exp.EQ(this=column_of(name, c), expression=e.copy()) for c, e in equal))
    join = exp.Join(this=table, side="LEFT", on=on)
    value, holds = column_of(name, "value"), exp.case()
    for column in columns:
        holds = holds.when(_is_null(column), exp.null())
    is_missing = _is_null(column_of(name, "tick"))
    if relation.result == "double":
        zero = exp.cast(exp.Literal.number(0), "DOUBLE")
        domain = FloatDomain.INFINITE if relation.may_be_infinite else FloatDomain.FINITE
        number = holds.when(is_missing, zero).else_(value)
        return JoinedEntity(SqlValue(number, DOUBLE, domain=domain), join)
    known = exp.EQ(this=value, expression=exp.Literal.number(1))
    holds = holds.when(is_missing, exp.false()).when(known, exp.true())
    return JoinedEntity(SqlValue(holds, BOOLEAN), join)


def _is_null(value: exp.Expr) -> exp.Expr:
    return exp.Is(this=value.copy(), expression=exp.Null())


def needed_joins(joined_entities: Iterable[JoinedEntity], select: exp.Select) -> list[exp.Join]:
    """Returns the joins whose columns a SELECT or a later join reads.

    The joins do not change the number of rows.
    """
    result: list[exp.Join] = []
    for entity in reversed(list(joined_entities)):
        name = entity.join.this.alias
        parts: list[exp.Expr] = [select, *result]
        if any(column.table == name for part in parts for column in part.find_all(exp.Column)):
            result.append(entity.join)
    return result[::-1]


@dataclass(frozen=True)
class TickRange:
    """The ticks of a source, the tick of its current row, and its id if it is one entity."""

    schema: str
    first: exp.Expr
    last: exp.Expr
    tick: exp.Expr
    id: exp.Expr | None = None


@dataclass(frozen=True)
class PairTable:
    """A table of pairs of ids, each pair in both orders."""

    table: exp.Expr  # its table in FROM
    columns: tuple[exp.Expr, exp.Expr]  # the columns of the two ids
    position: exp.Ordered  # the key of the order of both sources, if they are entities


def pair_table(
    search: PairSearch, distance: exp.Expr, schema: str, name: str, kind: PairKind = "entities"
) -> PairTable:
    """Returns the pairs of entities of a world, of their links, or of both, that a search finds."""
    function = exp.to_identifier(search.name, quoted=True)
    arguments: list[exp.Expr] = [exp.Literal.string(schema), exp.Literal.string(kind)]
    if search.numbers:
        arguments.append(exp.cast(distance.copy(), "DOUBLE"))
    numbers = exp.func("unnest", exp.Anonymous(this=function, expressions=arguments))
    number, factor = exp.column("n"), exp.Literal.number(ID_FACTOR)
    table = (
        exp.select(
            exp.alias_(exp.IntDiv(this=number.copy(), expression=factor.copy()), "a"),
            exp.alias_(exp.Mod(this=number.copy(), expression=factor.copy()), "b"),
            number,
        )
        .from_(exp.select(exp.alias_(numbers, "n")).subquery("numbered"))
        .subquery(exp.to_identifier(name))
    )
    a, b, position = (column_of(name, column) for column in ("a", "b", "n"))
    return PairTable(table, (a, b), ascending(position))


def counted_rows(name: str, parameter: exp.Expr) -> FromItem:
    """Returns a row for each value of a list whose values SQL cannot represent."""
    numbers = exp.func("generate_subscripts", parameter, exp.Literal.number(1))
    table = exp.select(exp.alias_(numbers, "n")).subquery(exp.to_identifier(name))
    value = SqlValue(column_of(name, "n"), ANY)
    return FromItem(value, table, (ascending(column_of(name, "n")),))


def record_table(name: str, table: str, sql_type: SqlType) -> FromItem:
    """Records as a table: `n`, and a column a key."""
    fields = {
        key: SqlValue(column_of(name, f"f{index}"), part)
        for index, (key, part) in enumerate(sql_type.fields)
        if part.is_sql and part.type not in ("record", "entity")
    }
    value = SqlValue(column_of(name, "n"), sql_type, fields=fields)
    source = exp.table_(table, quoted=True, alias=exp.to_identifier(name))
    return FromItem(value, source, (ascending(column_of(name, "n")),))


def column_of(table: str, name: str) -> exp.Expr:
    """Returns a column of a table."""
    return exp.column(exp.to_identifier(name, quoted=" " in name), table=exp.to_identifier(table))


def ascending(key: exp.Expr) -> exp.Ordered:
    """Returns a key of ORDER BY, the least first."""
    return exp.Ordered(this=key, desc=False, nulls_first=False)
