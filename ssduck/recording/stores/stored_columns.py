"""Checks the columns of stored tables against those that they are to have, before they are read."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from functools import cache, lru_cache
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from ssduck.errors import RecordError, RecordPermissionError
from ssduck.schema import MODELS, RECORDED, TABLES, Column, ColumnType
from ssduck.world.live_tables import ARROW_TYPES

MISSING = "is missing: the record was damaged, or only copied in part"


@cache
def part_columns(table: str) -> Mapping[str, ColumnType]:
    """Returns the types of the columns of a folder's parts, of a table or `models/<table>`."""
    model = table.removeprefix("models/")
    if model != table:
        return types_of(MODELS[model].model)
    return types_of((TABLES if table in TABLES else RECORDED)[table].columns)


def tick_types(table: str) -> dict[str, ColumnType]:
    """Returns the types of the columns that differ from tick to tick, in the order of a store."""
    types = types_of(RECORDED[table].columns)
    return {name: types[name] for name in RECORDED[table].tick_columns.names}


@cache
def arrow_types(table: str) -> pa.Schema:
    """Returns these columns with their types in Arrow."""
    return pa.schema({name: ARROW_TYPES[type] for name, type in tick_types(table).items()})


def types_of(columns: Iterable[Column]) -> dict[str, ColumnType]:
    """Returns the types of columns by name."""
    return {column.name: column.type for column in columns}


def check_columns(
    source: str, present: Iterable[tuple[str, str]], expected: Mapping[str, ColumnType]
) -> None:
    """Checks the columns of a stored table; further columns do not matter."""
    found = dict(present)
    for name, type in expected.items():
        if name not in found:
            raise RecordError(f"{source} is damaged: it lacks the column {name!r}")
        if found[name] != type:
            raise RecordError(
                f"{source} is damaged: its column {name!r} has the type {found[name]}; it is to "
                f"have values of the type {type}"
            )


def unreadable(source: object, error: Exception) -> RecordError:
    """Returns the error that a file cannot be read, for an error of the library or of a store."""
    if isinstance(error, RecordError):
        return error
    return RecordError(f"{source} cannot be read: it is damaged: {error}")


def unreadable_because(file: Path, error: OSError) -> str:
    """Returns what is wrong with a file of a record that cannot be read, for an error."""
    if isinstance(error, RecordPermissionError):
        raise error
    if isinstance(error, PermissionError):
        raise RecordPermissionError(f"{file} cannot be read: {error.strerror}") from error
    if isinstance(error, FileNotFoundError):
        return MISSING
    if isinstance(error, RecordError):
        return error.message.removeprefix(f"{file} ")
    return f"cannot be read: {error.strerror}"


def rows_of_part(file: Path, table: str, part: pq.ParquetFile) -> pa.Table:
    """Returns the rows of a part, with the columns that it is to have."""
    types = {name: ARROW_TYPES[type] for name, type in part_columns(table).items()}
    try:
        # The threads of the library take longer to wake up than most of these files to read.
        rows = part.read(columns=list(types), use_threads=False).select(list(types))
        return rows.cast(pa.schema(types))
    except (pa.ArrowException, OSError) as error:
        raise unreadable(file, error) from error


def checked_parquet(source: str, content: bytes | memoryview, table: str) -> pq.ParquetFile:
    """Returns a part, or what its footer tells of it, after a check of that."""
    try:
        part = pq.ParquetFile(pa.BufferReader(content))
        schema = part.schema_arrow
    except (pa.ArrowException, OSError) as error:
        raise unreadable(source, error) from error
    check_columns(source, arrow_columns(schema), part_columns(table))
    return part


def check_stream(source: str, schema: pa.Schema, table: str) -> None:
    """Checks the columns of the rows of a log."""
    booleans = RECORDED[table].tick_columns.booleans
    present = [
        (name, "boolean" if type == "uint8" and name in booleans else type)
        for name, type in arrow_columns(schema)
    ]
    check_columns(source, present, tick_types(table))


def arrow_columns(schema: pa.Schema) -> list[tuple[str, str]]:
    """Returns the names of columns, and their types: of `ColumnType`, or Arrow's names."""
    return [(field.name, _arrow_type(field.type)) for field in schema]


@lru_cache(maxsize=64)
def _arrow_type(type: pa.DataType) -> str:
    if pa.types.is_string(type) or pa.types.is_large_string(type):
        return "string"
    simple = {pa.int64(): "integer", pa.float64(): "double", pa.bool_(): "boolean"}
    if type in simple:
        return simple[type]
    if _is_list(type) and _is_list(type.value_type):
        nested = {pa.float64(): "points", pa.int32(): "triples"}
        return nested.get(type.value_type.value_type, str(type))
    return str(type)


def _is_list(type: pa.DataType) -> bool:
    return bool(
        pa.types.is_list(type) or pa.types.is_large_list(type) or pa.types.is_fixed_size_list(type)
    )


def parts_of(values: pa.Array) -> list[pa.Array]:
    """Returns the columns within one of a nested type; none for another type."""
    kind = values.type
    if pa.types.is_map(kind):
        return [values.keys, values.items]
    if pa.types.is_union(kind):
        return [values.field(place) for place in range(kind.num_fields)]
    if pa.types.is_struct(kind):
        return list(values.flatten())
    return [values.flatten()] if pa.types.is_nested(kind) else []


def conformed(rows: pa.Table, schema: pa.Schema) -> pa.Table:
    """Returns the columns of a schema, in its types; no cast is made that changes nothing."""
    chosen = rows.select(schema.names)
    return chosen if chosen.schema.equals(schema) else chosen.cast(schema)


def with_nulls(rows: pa.Table) -> pa.Table:
    """Returns rows with NULL for unknown numbers, which may be NaN: SQL takes that for a number."""
    for place, column in enumerate(rows.columns):
        # A sum that is a number has no NaN in it.
        if column.type == pa.float64() and math.isnan(pc.sum(column).as_py() or 0.0):
            known = pc.if_else(pc.is_nan(column), pa.scalar(None, column.type), column)
            rows = rows.set_column(place, rows.column_names[place], known)
    return rows
