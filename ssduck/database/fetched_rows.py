"""Fetches the rows of a statement once, within limits: as Python's values or an Arrow table."""

from __future__ import annotations

import sys
from collections import UserList
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, cast

import duckdb
import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from ssduck.errors import LimitError, SqlError
from ssduck.formatting import short_repr
from ssduck.language.intervals import column_of
from ssduck.recording.stores.stored_columns import parts_of

# DuckDB's types whose values are the same in Python's rows, in NumPy and in Arrow.
ARROW_TYPES = {
    "BOOLEAN": pa.bool_(),
    "INTEGER": pa.int32(),
    "BIGINT": pa.int64(),
    "DOUBLE": pa.float64(),
    "VARCHAR": pa.string(),
}
# So many rows of a user's statement are fetched as an Arrow table, which takes less time.
MANY_ROWS = 1_000
# So many of ssduck's own statements are fetched by column, and become tuples when they are read so.
_BY_COLUMN = 100
# So many rows are measured at a time: DuckDB computes 2,048 whatever is fetched of them.
_BATCH = 4_096
# The types whose values all have about the same size.
_SMALL = frozenset(("BIGINT", "INTEGER", "DOUBLE", "BOOLEAN", "FLOAT", "HUGEINT"))
# DuckDB's types that Arrow may not hold, and those that have others within.
_UNSIGNED, _ZONED = "uhugeint", "time with time zone"
_NESTED = frozenset(("list", "array", "struct", "tuple", "map", "union"))
# The sizes of Python's objects, bytes.
_ROW, _VALUE, _TEXT, _POINTER = 64, 32, 56, 8


@dataclass(frozen=True)
class RowLimits:
    """The limits of the rows that a statement yields."""

    most: int | None  # the number of rows after which no more are fetched; None for all
    # A function that is called with the sizes of rows, bytes, and raises an error if they are too
    # large.
    charge: Callable[[int], None]

    def rows(self, result: duckdb.DuckDBPyConnection) -> list[tuple[Any, ...]]:
        """Returns the rows of a statement that a connection has executed."""
        most = sys.maxsize if self.most is None else self.most
        names = [str(column[1]) for column in result.description]
        texts = [place for place, name in enumerate(names) if name == "VARCHAR"]
        others = [p for p, name in enumerate(names) if name not in _SMALL and p not in texts]
        rows: list[tuple[Any, ...]] = []
        try:
            while len(rows) < most:
                wanted = min(_BATCH, most - len(rows))
                batch = result.fetchmany(wanted)
                size = len(batch) * (_ROW + _VALUE * len(names))
                size += sum(len(row[place] or "") for place in texts for row in batch)
                self.charge(size + sum(_size(row[place]) for place in others for row in batch))
                rows += batch
                if len(batch) < wanted:
                    return rows
        except LimitError:
            result.abort()
            raise
        result.abort()
        return rows


def _size(value: Any) -> int:
    """Returns the size of a value that DuckDB has made, bytes."""
    if isinstance(value, str | bytes):
        return _TEXT + len(value)
    if isinstance(value, list | tuple):
        return _ROW + _POINTER * len(value) + sum(map(_size, value))
    if isinstance(value, dict):
        return _ROW + sum(_size(key) + _size(part) for key, part in value.items())
    return _VALUE


@dataclass(frozen=True)
class Header:
    """The names of columns, and DuckDB's names of their types, in capitals."""

    names: tuple[str, ...]
    types: tuple[str, ...]


@dataclass(frozen=True)
class FetchedRows:
    """All rows of a user's statement as tuples, with their columns."""

    header: Header
    rows: list[tuple[Any, ...]]

    @property
    def columns(self) -> Sequence[str]:
        """The names of the columns."""
        return self.header.names

    @property
    def types(self) -> list[str]:
        """DuckDB's names of the columns' types, in small letters."""
        return [name.lower() for name in self.header.types]

    def __len__(self) -> int:
        return len(self.rows)

    def renamed(self, columns: tuple[str, ...]) -> FetchedRows:
        """Returns the same rows with other names of the columns."""
        return replace(self, header=replace(self.header, names=columns))

    @cached_property
    def table(self) -> pa.Table:
        """The rows as an Arrow table, as DuckDB makes it."""
        columns = zip(*self.rows, strict=True) if self.rows else [()] * len(self.header.names)
        arrays = [
            pa.array(column, ARROW_TYPES[name])
            for column, name in zip(columns, self.header.types, strict=True)
        ]
        fields = [(name, array.type) for name, array in zip(self.columns, arrays, strict=True)]
        return pa.Table.from_arrays(arrays, schema=pa.schema(fields))


def are_plain(types: Iterable[str]) -> bool:
    """Checks whether Python's values of columns of these types are those of Arrow's."""
    return ARROW_TYPES.keys() >= set(types)


def is_short_and_plain(table: pa.Table) -> bool:
    """Checks whether the rows of a table are better fetched as Python's values."""
    is_plain = all(kind in ARROW_TYPES.values() for kind in table.schema.types)
    return is_plain and table.num_rows < MANY_ROWS


def fetched(
    result: duckdb.DuckDBPyConnection, limits: RowLimits | None, header: Header | None
) -> FetchedRows | None:
    """Returns all rows of a result; None if their types require an Arrow table.

    Args:
        result: a connection that has executed a statement.
        limits: the limits of its rows; None for none.
        header: its columns; None if they are not known.
    """
    if header is None:
        names, types = zip(
            *((name, str(kind)) for name, kind, *_ in result.description), strict=True
        )
        if not are_plain(types):
            result.abort()
            return None
        header = Header(names, types)
    return FetchedRows(header, result.fetchall() if limits is None else limits.rows(result))


class ColumnRows(UserList[tuple[Any, ...]]):
    """Rows that are columns, masked where there is no value, until they are read as tuples."""

    def __init__(self, columns: Sequence[npt.NDArray[Any]]) -> None:
        self.columns = columns

    @cached_property
    def data(self) -> list[tuple[Any, ...]]:  # type: ignore[override]
        """The rows as tuples."""
        return list(zip(*(column.tolist() for column in self.columns), strict=True))

    def __len__(self) -> int:
        return len(self.columns[0])

    def __iter__(self) -> Iterator[tuple[Any, ...]]:
        return iter(self.data)

    def __getitem__(self, place: Any) -> Any:
        if place == 0:  # which tells how many columns there are
            return tuple(column[:1].tolist()[0] for column in self.columns)
        return self.data[place]


def columns_of(rows: Sequence[Sequence[Any]]) -> Sequence[npt.NDArray[Any]]:
    """Returns rows by column: arrays of their types where DuckDB has these, else of objects."""
    if isinstance(rows, ColumnRows):
        return rows.columns
    return [column_of(column) for column in zip(*rows, strict=True)]


def all_rows(result: duckdb.DuckDBPyConnection) -> list[tuple[Any, ...]]:
    """Returns all rows of a result; many rows are fetched by column, in a quarter of the time."""
    rows: list[tuple[Any, ...]] = result.fetchmany(_BY_COLUMN)
    if len(rows) < _BY_COLUMN:
        return rows
    if not are_plain(str(kind) for _, kind, *_ in result.description):
        return rows + result.fetchall()
    rest = result.fetchnumpy().values()
    columns = list(map(_joined, zip(*rows, strict=True), rest))
    return cast("list[tuple[Any, ...]]", ColumnRows(columns))  # it does what a list does


def _joined(head: Sequence[Any], rest: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Returns a column with some values before it, None where there is none."""
    known = np.array([rest.dtype.type() if value is None else value for value in head], rest.dtype)
    whole = np.concatenate((known, np.ma.getdata(rest)))
    if None not in head and np.ma.getmask(rest) is np.ma.nomask:
        return whole
    unknown = np.append([value is None for value in head], np.ma.getmaskarray(rest))
    return np.ma.array(whole, mask=unknown) if unknown.any() else whole


def arrow_table(relation: duckdb.DuckDBPyRelation, limits: RowLimits | None) -> pa.Table:
    """Returns the rows of a relation as an Arrow table."""
    batches: list[pa.RecordBatch] = []
    most = sys.maxsize if limits is None or limits.most is None else limits.most
    try:
        with relation.to_arrow_reader(_BATCH) as reader:
            for batch in reader:
                if limits is not None:
                    limits.charge(batch.nbytes)
                batches.append(batch)
                most -= batch.num_rows
                if most <= 0:
                    break
            table = pa.Table.from_batches(batches, reader.schema)
    except (OSError, pa.ArrowException) as error:  # Arrow's error of DuckDB's
        raise duckdb_error(str(error)) from error
    return _exact(relation, table)


def _exact(relation: duckdb.DuckDBPyRelation, table: pa.Table) -> pa.Table:
    """Returns the Arrow table of a relation, after a check that Arrow can hold its values."""
    if not any(map(_may_differ, table.schema.types)):
        return table
    for name, kind, column in zip(table.column_names, relation.types, table.columns, strict=True):
        kinds = set(_kinds_in(kind))
        if _UNSIGNED in kinds and any(_overflows(kind, chunk) for chunk in column.chunks):
            raise SqlError(
                f"{short_repr(name)} has an integer of 2^127 or more, which Arrow cannot hold: "
                "cast it to VARCHAR or DOUBLE"
            )
        if _ZONED in kinds:
            raise SqlError(
                f"{short_repr(name)} has times of day with a zone, which Arrow cannot hold: cast "
                "them to VARCHAR, or to TIME without the zone"
            )
    return table


def _may_differ(kind: pa.DataType) -> bool:
    """Checks whether values of DuckDB's may be others in columns of a type of Arrow's."""
    types = pa.types
    return bool(types.is_decimal(kind) or types.is_time(kind) or types.is_nested(kind))


def _kinds_in(kind: duckdb.sqltypes.DuckDBPyType) -> Iterator[str]:
    """Yields the names of a type and of those within it."""
    yield kind.id
    if kind.id in _NESTED:
        for _, child in kind.children:
            if isinstance(child, duckdb.sqltypes.DuckDBPyType):  # an array has a size, too
                yield from _kinds_in(child)


def _overflows(kind: duckdb.sqltypes.DuckDBPyType, values: pa.Array) -> bool:
    """Checks whether a column of a type of DuckDB's has a negative UHUGEINT, at any depth."""
    if kind.id == _UNSIGNED:
        return bool(pc.any(pc.less(values, 0)).as_py())
    if kind.id not in _NESTED:
        return False
    kinds = [child for _, child in kind.children if isinstance(child, duckdb.sqltypes.DuckDBPyType)]
    if kind.id == "union":  # the first one is the tag
        kinds = kinds[1:]
    return any(map(_overflows, kinds, parts_of(values)))


def duckdb_error(message: str) -> duckdb.Error:
    """Returns the error that DuckDB raises itself when no Arrow reader is between."""
    if "INTERRUPT" in message:
        return duckdb.InterruptException(message)
    if "Out of Memory" in message:
        return duckdb.OutOfMemoryException(message)
    return duckdb.Error(message)


def is_duckdb_error(error: Exception) -> bool:
    """Checks whether DuckDB raised an error; it raises a RuntimeError at Ctrl-C."""
    if isinstance(error, RuntimeError):
        return "interrupted" in str(error).lower()
    return isinstance(error, duckdb.Error)
