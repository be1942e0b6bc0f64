"""The sources behind FROM: worlds, lists, tables, any value."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from itertools import pairwise
from typing import Any, cast

import numpy as np
import pyarrow as pa

from ssduck.adapters.result import Result, python_values
from ssduck.database.fetched_rows import ARROW_TYPES
from ssduck.database.values import SchemaOf, common_sql_type, to_sql
from ssduck.errors import ArgumentError
from ssduck.language import ast
from ssduck.language.analysis import aliases_of
from ssduck.language.clauses import LockstepSource
from ssduck.recording.replay.past import Past, PresentTick
from ssduck.recording.replay.record import Record
from ssduck.schema import EntityTable
from ssduck.sql.plan import PastKind, SourceType
from ssduck.sql.relations.registry import RELATIONS
from ssduck.sql.types import ANY, INTEGER, SqlType
from ssduck.world.handles import Handle, Links, removal_of
from ssduck.world.world import World

# Longer lists are not examined: they may have entities of any world.
MAX_EXAMINED = 100


def elements_of(value: Any) -> Sequence[Any]:
    """Returns the elements of a source.

    These are the entities of a world, the elements of a list or a tuple, the rows of an array, and
    those of a table of pandas, polars, Arrow or of `Interpreter.sql`, or of a structured array, as
    dicts. Any other value is the only element.

    >>> elements_of([1, 2])
    [1, 2]
    >>> elements_of(3)
    [3]
    """
    if isinstance(value, list | tuple):
        return value
    if isinstance(value, World | Links | Past | PresentTick):
        return list(value)
    if isinstance(value, np.ndarray) and value.ndim and value.dtype.names is None:
        rows: list[Any] = value.tolist()
        return rows
    table = _rows_of_table(value)
    return [value] if table is None else table


def all_elements(values: Sequence[Any]) -> list[Sequence[Any]]:
    """Returns the elements of all sources; those of several ticks of one world run in lockstep."""
    elements_by_source: list[Sequence[Any]] = []
    leaders: dict[World, int] = {}
    for place, value in enumerate(values):
        elements = elements_of(value)
        if isinstance(value, Past) and value.is_window:
            leader = leaders.setdefault(value.world, place)
            elements = elements if leader == place else LockstepSource(elements, leader)
        elements_by_source.append(elements)
    return elements_by_source


def _rows_of_table(value: Any) -> list[dict[str, Any]] | None:
    """Returns the rows of a data frame as dicts; None of another value."""
    names, columns = _table(value)
    if names is None:
        return None
    duplicates = [name for name, count in Counter(names).items() if count > 1]
    if duplicates:
        raise ArgumentError(f"a table has two columns of the name {duplicates[0]!r}")
    return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]


def _table(value: Any) -> tuple[list[str] | None, list[list[Any]]]:
    """Returns the names and the columns of a data frame; None, and no column, of another value."""
    if isinstance(value, Result):
        return value.columns, [python_values(column) for column in value.arrow().columns]
    if isinstance(value, pa.Table | pa.RecordBatch):
        return value.column_names, [python_values(column) for column in value.columns]
    if isinstance(value, np.ndarray) and value.ndim and value.dtype.names:
        return list(value.dtype.names), [value[n].tolist() for n in value.dtype.names]
    # By name, because the libraries may not be installed.
    match type(value).__module__.partition(".")[0], type(value).__name__:
        case "pandas", "DataFrame":
            columns = [value.iloc[:, place] for place in range(value.shape[1])]
            return list(map(str, value.columns)), list(map(_pandas_values, columns))
        case "polars", "DataFrame":
            return value.columns, list(map(_polars_values, value.get_columns()))
    return None, []


def _pandas_values(column: Any) -> list[Any]:
    """Returns the values of a column as Python's, None for missing ones."""
    if column.dtype != object:
        with suppress(pa.ArrowException, TypeError):  # Arrow lacks some types
            array = pa.array(column, from_pandas=True)
            if not isinstance(array.type, pa.BaseExtensionType):
                values: list[Any] = array.to_pylist()
                return values
    pairs = zip(column.tolist(), column.isna().tolist(), strict=True)
    return [None if missing else _python_value(value) for value, missing in pairs]


def _python_value(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def _polars_values(column: Any) -> list[Any]:
    """Returns the values of a column; Arrow has neither Python's objects nor 128 bits."""
    kind = str(column.dtype)
    if kind == "Object" or "128" in kind:
        return [_python_value(value) for value in column.to_list()]
    return python_values(column.to_arrow())


def source_types(
    query: ast.Query, values: Sequence[Any], schema_of: SchemaOf
) -> tuple[SourceType, ...]:
    """Returns the types of a query's sources."""
    aliases = aliases_of(query)
    return tuple(
        source_type(alias, value, schema_of) for alias, value in zip(aliases, values, strict=True)
    )


class _Inline:
    """Stands for the value of a source that is a part of the statement."""


INLINE = _Inline()


def source_type(alias: str, value: Any, schema_of: SchemaOf) -> SourceType:
    """Returns the type of a source."""
    if value is INLINE:
        return SourceType(alias, has_values=False)
    if isinstance(value, World):
        return SourceType(alias, schema_of(value))
    if isinstance(value, Links):
        return SourceType(alias, schema_of(value.world), table=value.table)
    if isinstance(value, Past):
        past_kind: PastKind = "window" if value.is_window else "instant"
        return SourceType(
            alias,
            schema_of(value.world),
            past_kind=past_kind,
            is_one_entity=value.id is not None,
            table=value.table,
        )
    if isinstance(value, PresentTick):
        return SourceType(alias, schema_of(value.world), past_kind="now", table=value.table)
    elements = elements_of(value)
    sql_type = _element_type(elements, schema_of)
    dicts = any(issubclass(kind, dict) for kind in set(map(type, elements)))
    return SourceType(alias, sql_type=sql_type, dicts=dicts, known=bool(elements))


def _element_type(elements: Sequence[Any], schema_of: SchemaOf) -> SqlType:
    sql_type = common_sql_type(elements, schema_of)
    if sql_type is None or sql_type.type == "nothing":
        return ANY
    if sql_type.type == "record":
        return sql_type
    is_empty = sql_type.type == "list" and sql_type.element is None
    return sql_type if sql_type.comes_back and not is_empty else ANY


def arrow_table(elements: Sequence[Any], sql_type: SqlType) -> pa.Table:
    """Returns records as a table: the column `n` from 1, and a column for each key."""
    columns: dict[str, Any] = {"n": pa.array(range(1, len(elements) + 1), pa.int64())}
    for index, (key, part) in enumerate(sql_type.fields):
        if part.is_sql and part.type != "record":
            values = [to_sql(element[key]) for element in elements]
            columns[f"f{index}"] = pa.array(values, _arrow_type(part))
    return pa.table(columns)


def _arrow_type(sql_type: SqlType) -> pa.DataType:
    if sql_type.type == "list":
        return pa.list_(_arrow_type(sql_type.element or INTEGER))
    return ARROW_TYPES[sql_type.duckdb_type]


def with_present_ticks(
    values: Sequence[Any], elements: Sequence[Any], inside: Sequence[Any]
) -> list[Any]:
    """Returns the values of sources; a world beside its past, at its current tick.

    The past is another source, one of the elements of queries around, or a source of one inside.
    """
    records = {
        value.world: cast("Record", value.moment.record)
        for value in elements
        if isinstance(value, Handle) and value.moment is not None
    }
    has_present = any(isinstance(value, World | Links) for value in values)
    for value in (*values, *inside):
        if isinstance(value, Past):
            value.check()
            records[value.world] = value.record
        elif has_present and isinstance(value, list):
            for element in value:
                if isinstance(element, Handle) and element.moment is not None:
                    records[element.world] = cast("Record", element.moment.record)
    return [_with_present_tick(value, records) for value in values]


def _with_present_tick(value: Any, records: Mapping[World, Record]) -> Any:
    """Returns a world, or its links, at its current tick if its past is a source, too."""
    world = value.world if isinstance(value, Links) else value
    if not isinstance(world, World) or world not in records:
        return value
    table: EntityTable = value.table if isinstance(value, Links) else "entities"
    return PresentTick(records[world], world.tick_number, table)


def worlds_in(value: Any) -> list[World] | None:
    """Returns the worlds of a value: a world, an entity, a list of such; None if unknown."""
    match value:
        case World():
            return [value]
        case Past() | PresentTick() | Links():
            return [value.world]
        case Handle():
            return [value.world]
        case None | str() | int() | float() | Result():
            return []
        case list() | tuple() if len(value) <= MAX_EXAMINED:
            element_worlds = [worlds_in(element) for element in value]
            return (
                None
                if None in element_worlds
                else [world for inner in element_worlds for world in inner or ()]
            )
    return None


def check_tick(node: ast.Call, values: Iterable[Any]) -> None:
    """Checks that entities whose shapes, contacts or joints are compared are of one tick."""
    if not RELATIONS[node.name].tables:
        return
    handles = [value for value in values if isinstance(value, Handle) and value.moment is not None]
    for first, second in pairwise(handles):
        if first.world is second.world and first.moment.tick != second.moment.tick:  # type: ignore[union-attr]
            advice = (
                f"for all of them at a time t write at(t, {node.name}(…)); of two ticks there are "
                "positions: distance(a, b)"
            )
            removals = (
                f"{handle.name}: {told}" for handle in handles if (told := removal_of(handle))
            )
            raise ArgumentError(
                f"{node.name} is of entities at one tick, and these are of {first.state.time:g} s "
                f"and of {second.state.time:g} s: {next(removals, advice)}",
                span=node.span,
            )
