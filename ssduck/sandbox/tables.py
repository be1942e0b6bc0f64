"""Writes Arrow tables for the host, and checks those that come from a worker.

A table may name more rows, in fewer bytes, than the host has memory for: by compression, by types
that repeat values, and by those without bytes. Only plain types cross.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from ssduck.errors import UnsupportedError
from ssduck.sandbox.budget import WIDEST, Budget, InvalidAnswerError

# What each element of a column, or of a list in one, takes at least, bytes.
_LEAST = 8
# What a number or a text takes as an object of Python, beside its bytes, and what a list, an array
# or a dict does, beside its elements.
_OBJECT, _NESTED = 72, 360
_TYPES = pa.types
_PLAIN: tuple[Callable[[pa.DataType], bool], ...] = (
    *(_TYPES.is_boolean, _TYPES.is_integer, _TYPES.is_floating, _TYPES.is_decimal),
    *(_TYPES.is_string, _TYPES.is_large_string, _TYPES.is_binary, _TYPES.is_large_binary),
    *(_TYPES.is_date, _TYPES.is_time, _TYPES.is_timestamp, _TYPES.is_duration, _TYPES.is_interval),
    *(_TYPES.is_null, _TYPES.is_fixed_size_binary),
)
# The fields for the header of a message (a table of FlatBuffers), and for a batch's compression.
_HEADER, _COMPRESSION = 2, 3


def table_bytes(table: pa.Table) -> memoryview:
    """Returns a table as a stream of Arrow: with plain types, and nothing but the columns."""
    plain = plain_table(table)
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, plain.schema) as stream:
        stream.write_table(plain)
    return memoryview(sink.getvalue())


def plain_table(table: pa.Table) -> pa.Table:
    """Returns a table with plain types, and nothing but the columns."""
    return pa.table([_plain(column) for column in table.columns], names=table.column_names)


def size_of_values(table: pa.Table) -> int:
    """Returns what the values of a table take at most as objects of Python, bytes."""
    return sum(_size_of(chunk) for column in table.columns for chunk in column.chunks)


def _size_of(array: Any) -> int:
    if inner := list(_inner(array)):
        return _NESTED * len(array) + sum(map(_size_of, inner))
    size: int = array.nbytes
    if _TYPES.is_string(array.type) or _TYPES.is_large_string(array.type):
        size *= 1 if pc.all(pc.string_is_ascii(array)).as_py() in (True, None) else WIDEST
    return _OBJECT * len(array) + size


def _plain(column: pa.ChunkedArray) -> pa.ChunkedArray:
    """Returns a column with a type that crosses."""
    kind = column.type
    if isinstance(kind, pa.BaseExtensionType):
        return _plain(column.cast(kind.storage_type))
    if _TYPES.is_dictionary(kind):
        return _plain(column.cast(kind.value_type))
    if is_plain(kind):
        return column
    try:
        return column.cast(pa.string())
    except pa.ArrowException:
        pass
    try:
        return pa.chunked_array([pc.cast(column, pa.binary())])
    except pa.ArrowException:
        raise UnsupportedError(
            f"a column of the type {kind} cannot cross the wall of the sandbox; select it as "
            "another type, as by CAST(… AS VARCHAR)"
        ) from None


def is_plain(kind: pa.DataType) -> bool:
    """Checks whether values of a type cross the wall as they are."""
    if isinstance(kind, pa.BaseExtensionType):
        return False
    if _TYPES.is_struct(kind):
        return all(is_plain(kind.field(i).type) for i in range(kind.num_fields))
    if _TYPES.is_list(kind) or _TYPES.is_large_list(kind) or _TYPES.is_fixed_size_list(kind):
        return is_plain(kind.value_type)
    if _TYPES.is_map(kind):
        return is_plain(kind.key_type) and is_plain(kind.item_type)
    return any(check(kind) for check in _PLAIN)


def own_table(data: memoryview, _: Budget) -> pa.Table:
    """Returns the table that a stream of the host holds, which a worker need not check."""
    return pa.ipc.open_stream(pa.py_buffer(data)).read_all()


def checked_table(data: memoryview, budget: Budget) -> pa.Table:
    """Returns the table that a stream of a worker holds."""
    try:
        source = pa.py_buffer(data)
        _check_messages(source)
        with pa.ipc.open_stream(source) as stream:
            if not all(is_plain(field.type) for field in stream.schema):
                raise InvalidAnswerError("a table has a column of a type that does not cross")
            schema, batches = stream.schema.remove_metadata(), []
            for batch in stream:
                for column in batch.columns:
                    _charge(column, budget)
                batches.append(batch.replace_schema_metadata(None))
        table = pa.Table.from_batches(batches, schema)
        for column in table.columns:
            for chunk in column.chunks:
                chunk.view(_bits_of(column.type)).validate(full=True)
    except (pa.ArrowException, ValueError, struct.error, OSError) as error:
        raise InvalidAnswerError(f"a table is damaged: {error}") from error
    return table


def _bits_of(kind: pa.DataType) -> pa.DataType:
    """Returns a type of the same layout, of which all bits are values.

    DuckDB's integers of 38 digits and its time 24:00 are more than Arrow's types allow.
    """
    if _TYPES.is_decimal(kind):
        return pa.binary(kind.byte_width)
    if _TYPES.is_time(kind) or _TYPES.is_date64(kind):
        return pa.int32() if kind.bit_width == 32 else pa.int64()
    if _TYPES.is_struct(kind):
        fields = [kind.field(i) for i in range(kind.num_fields)]
        return pa.struct([field.with_type(_bits_of(field.type)) for field in fields])
    if _TYPES.is_map(kind):
        return pa.map_(_bits_of(kind.key_type), _bits_of(kind.item_type))
    if _TYPES.is_fixed_size_list(kind):
        return pa.list_(_bits_of(kind.value_type), kind.list_size)
    if _TYPES.is_list(kind) or _TYPES.is_large_list(kind):
        make = pa.list_ if _TYPES.is_list(kind) else pa.large_list
        return make(kind.value_field.with_type(_bits_of(kind.value_type)))
    return kind


def _charge(array: Any, budget: Budget) -> None:
    """Counts the elements of an array, and of those inside it."""
    budget.charge(_LEAST * len(array))
    for inner in _inner(array):
        _charge(inner, budget)


def _inner(array: Any) -> Iterator[Any]:
    """Yields the arrays that hold the elements of an array of lists, of structures or of maps."""
    kind = array.type
    if _TYPES.is_struct(kind):
        yield from (array.field(i) for i in range(kind.num_fields))
    elif _TYPES.is_map(kind):
        yield from (array.keys, array.items)
    elif _TYPES.is_list(kind) or _TYPES.is_large_list(kind) or _TYPES.is_fixed_size_list(kind):
        yield array.values


def _check_messages(source: pa.Buffer) -> None:
    """Checks that a stream is one schema and batches of rows that are not compressed."""
    for i, message in enumerate(pa.ipc.MessageReader.open_stream(source)):
        metadata = bytes(message.metadata)
        if message.type != ("record batch" if i else "schema") or (i and _is_compressed(metadata)):
            raise InvalidAnswerError("a table has a part that is compressed, or none of a table")


def _is_compressed(metadata: bytes) -> bool:
    """Checks whether a batch of rows has the field for compression."""
    (message,) = struct.unpack_from("<I", metadata, 0)
    if not (header := _field(metadata, message, _HEADER)):
        return False
    (offset,) = struct.unpack_from("<I", metadata, header)
    return _field(metadata, header + offset, _COMPRESSION) != 0


def _field(data: bytes, table: int, number: int) -> int:
    """Returns the place of a field of a table of FlatBuffers; 0 if the table has it not."""
    (back,) = struct.unpack_from("<i", data, table)
    start = table - back
    if start < 0:
        raise InvalidAnswerError("a table has metadata that point outside")
    (size,) = struct.unpack_from("<H", data, start)
    at = 4 + 2 * number
    if at + 2 > size:
        return 0
    (offset,) = struct.unpack_from("<H", data, start + at)
    return table + offset if offset else 0
