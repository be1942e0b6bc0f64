"""Fetches the rows of a statement once, within limits: as Python's values or an Arrow table."""

from __future__ import annotations

import sys
from collections import UserList
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from operator import itemgetter
from typing import Any, TypeAlias, cast

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
# More rows are fetched by column, which takes half of the time.
MAX_TUPLES = 200
# The same for ssduck's own statements, whose columns become tuples when they are read so.
MANY_ROWS = 100


@dataclass(frozen=True)
class Header:
    """The columns of rows.

    Attributes:
        names: their names.
        types: DuckDB's names of their types, in capitals.
        is_long: whether there are many rows.
    """

    names: tuple[str, ...]
    types: tuple[str, ...]
    is_long: bool | None = None


class ColumnRows(UserList[tuple[Any, ...]]):
    """Rows that are columns until they are read as tuples.

    Args:
        columns: the columns, masked where there is no value.
    """

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


def _rows_of(columns: Iterable[npt.NDArray[Any]]) -> list[tuple[Any, ...]]:
    return cast("list[tuple[Any, ...]]", ColumnRows(list(columns)))  # it does what a list does


def _joined(head: Sequence[Any], rest: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Returns a column with some values before it, None where there is none."""
    known = np.array([rest.dtype.type() if value is None else value for value in head], rest.dtype)
    unknown = np.append([value is None for value in head], np.ma.getmaskarray(rest))
    whole = np.append(known, np.ma.getdata(rest))
    return np.ma.array(whole, mask=unknown) if unknown.any() else whole


class FetchedRows:
    """All rows of a statement; tuples and the Arrow table are made when they are needed.

    Args:
        header: their columns.
        values: the rows.
    """

    def __init__(self, header: Header, values: list[tuple[Any, ...]]) -> None:
        self._header, self._values = header, values

    @property
    def columns(self) -> Sequence[str]:
        """The names of the columns."""
        return self._header.names

    @property
    def types(self) -> list[str]:
        """DuckDB's names of the columns' types, in small letters."""
        return [name.lower() for name in self._header.types]

    @property
    def header(self) -> Header:
        """The columns, and whether there are many rows."""
        is_long = len(self) >= MAX_TUPLES
        return (
            self._header
            if self._header.is_long is is_long
            else replace(self._header, is_long=is_long)
        )

    def __len__(self) -> int:
        return len(self._values)

    def renamed(self, columns: tuple[str, ...]) -> FetchedRows:
        """Returns the same rows with other names of the columns."""
        if self._header.names == columns:
            return self
        return FetchedRows(replace(self._header, names=columns), self._values)

    @property
    def rows(self) -> list[tuple[Any, ...]]:
        """The rows as tuples."""
        return self._values.data if isinstance(self._values, ColumnRows) else self._values

    @cached_property
    def table(self) -> pa.Table:
        """The rows as an Arrow table, as DuckDB makes it."""
        names, types = self._header.names, self._header.types
        columns = columns_of(self._values) or [np.zeros(0)] * len(names)
        arrays = [
            pa.array(column.tolist(), ARROW_TYPES[name])
            for column, name in zip(columns, types, strict=True)
        ]
        fields = [(name, array.type) for name, array in zip(names, arrays, strict=True)]
        return pa.Table.from_arrays(arrays, schema=pa.schema(fields))


def are_plain(types: Iterable[str]) -> bool:
    """Checks whether Python's values of columns of these types are those of Arrow's."""
    return ARROW_TYPES.keys() >= set(types)


def has_plain_types(table: pa.Table) -> bool:
    """Checks whether the columns of a table can be fetched as Python's values."""
    return all(kind in ARROW_TYPES.values() for kind in table.schema.types)


def fetched(
    result: duckdb.DuckDBPyConnection,
    limited: Callable[..., list[tuple[Any, ...]]] | None,
    header: Header | None,
) -> FetchedRows | None:
    """Returns all rows of a result; None if an Arrow table is needed, or faster.

    Args:
        result: a connection that has executed a statement.
        limited: a function that fetches the rows within limits, as `limited_rows`; None for all.
        header: the columns of rows that were fetched before, with the expected number of rows;
            None if they are not known.
    """
    if header is None:
        description = result.description
        names = tuple(column[0] for column in description)
        header = Header(names, tuple(str(column[1]) for column in description))
        if not are_plain(header.types):
            result.abort()
            return None
    if limited is not None:
        expected = MAX_TUPLES if header.is_long is False else 0
        return FetchedRows(header, limited(result, header.types, expected=expected))
    if header.is_long is False:
        return FetchedRows(header, result.fetchall())
    rows = [] if header.is_long else result.fetchmany(MAX_TUPLES)
    if header.is_long or len(rows) == MAX_TUPLES:
        rows = _with_rest(rows, result)
    return FetchedRows(header, rows)


def all_rows(result: duckdb.DuckDBPyConnection) -> list[tuple[Any, ...]]:
    """Returns all rows of a result; many rows are fetched by column, in a quarter of the time."""
    rows: list[tuple[Any, ...]] = result.fetchmany(MANY_ROWS)
    if len(rows) == MANY_ROWS:
        if all(str(column[1]) in ARROW_TYPES for column in result.description):
            return _with_rest(rows, result)
        rows.extend(result.fetchall())
    return rows


def _with_rest(
    first: Sequence[tuple[Any, ...]], result: duckdb.DuckDBPyConnection
) -> list[tuple[Any, ...]]:
    """Returns some rows, and those that are not fetched yet, of plain types."""
    rest = list(result.fetchnumpy().values())
    return _rows_of(map(_joined, zip(*first, strict=True), rest) if first else rest)


# Counts the size of values, bytes.
Charge: TypeAlias = Callable[[int], None]

# The largest number of rows that are fetched at a time, and their expected size, bytes.
_MOST_ROWS, _MOST_BYTES = 10_000, 10_000_000
# DuckDB computes so many rows at a time, whatever is fetched of them.
_VECTOR = 2_048
# So many rows of an Arrow table are measured at a time; the second if they all have one size.
_BATCH, _LARGE_BATCH = 2 * _VECTOR, 32 * _VECTOR
# The types whose values all have about the same size.
_SMALL = frozenset(("BIGINT", "INTEGER", "DOUBLE", "BOOLEAN", "FLOAT", "HUGEINT"))
# Those, and others of at most so many bytes in Arrow.
_LARGEST_FIXED = 16
_FIXED = _SMALL.union(
    ("TINYINT", "SMALLINT", "UTINYINT", "USMALLINT", "UINTEGER", "UBIGINT", "DATE", "TIME"),
    ("TIMESTAMP", "TIMESTAMP_S", "TIMESTAMP_MS", "TIMESTAMP_NS", "TIMESTAMP WITH TIME ZONE"),
    ("INTERVAL",),
)
_TEXTS = ARROW_TYPES["VARCHAR"]
# Of so many statements it is known how many rows they had.
_MOST_KNOWN = 200
# Begins a statement that executes a prepared one.
EXECUTE = "EXECUTE "
# DuckDB's types that Arrow may not hold, and those that have others within.
_UNSIGNED, _ZONED = "uhugeint", "time with time zone"
_NESTED = frozenset(("list", "array", "struct", "tuple", "map", "union"))
# The sizes of Python's objects, bytes.
_ROW, _VALUE, _TEXT, _POINTER = 64, 32, 56, 8


@dataclass(frozen=True)
class _RowSizes:
    """What the types of columns tell of the sizes of rows.

    Attributes:
        fixed: the size of a row without what its texts and others point to, bytes.
        texts: functions that return a text of a row.
        others: functions that return a value of a row whose size depends on more.
    """

    fixed: int
    texts: tuple[itemgetter[int], ...]
    others: tuple[itemgetter[int], ...]

    def first_count(self, expected: int) -> int:
        """Returns how many rows are fetched first; the first one tells how large others may be."""
        if self.texts or self.others:
            return min(expected + 1, _VECTOR)
        return _MOST_BYTES // self.fixed

    def of(self, rows: list[tuple[Any, ...]]) -> int:
        """Returns the size of rows, bytes."""
        size = len(rows) * self.fixed
        for text in self.texts:
            try:
                size += sum(map(len, map(text, rows)))
            except TypeError:  # NULL
                size += sum(map(len, filter(None, map(text, rows))))
        for value in self.others:
            size += sum(map(_size, map(value, rows)))
        return size


@lru_cache
def _sizes_of(types: tuple[str, ...]) -> _RowSizes:
    texts = tuple(itemgetter(i) for i, name in enumerate(types) if name == "VARCHAR")
    others = (i for i, name in enumerate(types) if name not in _SMALL and name != "VARCHAR")
    return _RowSizes(_ROW + _VALUE * len(types), texts, tuple(map(itemgetter, others)))


def types_of(result: duckdb.DuckDBPyConnection) -> tuple[str, ...]:
    """Returns DuckDB's names of the types of a result's columns."""
    return tuple(str(column[1]) for column in result.description)


def limited_rows(
    result: duckdb.DuckDBPyConnection,
    types: tuple[str, ...],
    max_rows: int | None,
    charge: Charge,
    expected: int = 0,
) -> list[tuple[Any, ...]]:
    """Returns the rows of a result as tuples.

    Args:
        result: a connection that has executed a statement.
        types: the types of its columns, as `types_of` returns them.
        max_rows: the number of rows after which no more are fetched; None for all.
        charge: a function that is called with the sizes of rows, bytes, and raises an error if they
            are too large.
        expected: how many rows there were last time; 0 if that is not known.
    """
    sizes = _sizes_of(types)
    most = sys.maxsize if max_rows is None else max_rows
    wanted = min(sizes.first_count(expected), most)
    try:
        rows = result.fetchmany(wanted)
        total = sizes.of(rows)
        charge(total)
        while len(rows) == wanted < most:
            count = max(1, min(_MOST_ROWS, _MOST_BYTES * wanted // total))
            chunk = result.fetchmany(min(count, most - wanted))
            rows += chunk
            wanted = min(wanted + count, most)
            size = sizes.of(chunk)
            charge(size)
            total += size
        if len(rows) == most:
            result.abort()
    except LimitError:
        result.abort()
        raise
    return rows


class RepeatedStatements:
    """Fetches the rows of statements, of which some run again and again."""

    def __init__(self) -> None:
        self._known: dict[str, _RepeatedRows] = {}

    def rows(
        self,
        connection: duckdb.DuckDBPyConnection,
        sql: str,
        parameters: Any,
        max_rows: int | None,
        charge: Charge | None,
    ) -> list[tuple[Any, ...]]:
        """Returns the rows of a statement as tuples.

        Args:
            connection: the same connection each time.
            sql: the statement; if it executes a prepared one, its columns keep their types.
            parameters: the values of its parameters.
            max_rows: see `limited_rows`.
            charge: see there; None for no limits.
        """
        if not parameters:
            known = self._known.get(sql)
            if known is None:
                if len(self._known) >= _MOST_KNOWN:
                    del self._known[next(iter(self._known))]
                known = self._known[sql] = _RepeatedRows(sql)
            return known.rows(connection, max_rows, charge)
        result = connection.execute(sql, parameters)
        if charge is None:
            return all_rows(result)
        return limited_rows(result, types_of(result), max_rows, charge)

    def forget(self, sql: str) -> None:
        """Forgets the columns of a statement."""
        self._known.pop(sql, None)


class _RepeatedRows:
    """Fetches the rows of a statement without parameters, each time that it runs.

    If there were many last time, they are fetched by column, in half of the time: measured before
    they are Python's values. Those of a prepared statement are not: DuckDB runs it, and keeps all
    rows, when the relation is made, which takes longer.
    """

    def __init__(self, sql: str) -> None:
        self._sql, self._is_prepared = sql, sql.startswith(EXECUTE)
        self._types: tuple[str, ...] = ()
        self._expected = 0
        self._is_plain = not self._is_prepared

    def rows(
        self,
        connection: duckdb.DuckDBPyConnection,
        max_rows: int | None,
        charge: Charge | None,
    ) -> list[tuple[Any, ...]]:
        """Returns the rows as tuples; for the arguments see `RepeatedStatements.rows`."""
        if charge is None:
            return all_rows(connection.execute(self._sql))
        rows = None
        if self._expected >= MANY_ROWS and self._is_plain:
            relation = connection.sql(self._sql)
            self._is_plain = are_plain(map(str, relation.types))
            if self._is_plain:
                rows = _rows_by_column(relation, max_rows, charge)
        if rows is None:
            result = connection.execute(self._sql)
            if not (self._types and self._is_prepared):  # a prepared statement keeps them
                self._types = types_of(result)
            rows = limited_rows(result, self._types, max_rows, charge, self._expected)
        self._expected = len(rows)
        return rows


def _rows_by_column(
    relation: duckdb.DuckDBPyRelation, max_rows: int | None, charge: Charge
) -> list[tuple[Any, ...]]:
    """Returns the rows of columns of plain types; for the arguments see `limited_rows`."""
    batches: list[pa.RecordBatch] = []

    def take(batch: pa.RecordBatch) -> None:
        texts = sum(column.nbytes for column in batch.columns if column.type == _TEXTS)
        charge(batch.num_rows * (_ROW + _VALUE * batch.num_columns) + texts)
        batches.append(batch)

    schema = _read(relation, _BATCH, max_rows, take)
    return _rows_of(map(_values, pa.Table.from_batches(batches, schema).columns))


def _values(column: pa.ChunkedArray) -> npt.NDArray[Any]:
    """Returns a column of a plain type, masked where there is no value."""
    values: npt.NDArray[Any]
    if not column.null_count or column.type == _TEXTS:
        values = column.to_numpy()
    else:
        known = column.fill_null(column.type.to_pandas_dtype()()).to_numpy()
        values = np.ma.array(known, mask=column.is_null().to_numpy())
    return values


def limited_table(
    relation: duckdb.DuckDBPyRelation, max_rows: int | None, charge: Charge
) -> pa.Table:
    """Returns the rows of a relation as an Arrow table; for the arguments see `limited_rows`."""
    batches: list[pa.RecordBatch] = []

    def take(batch: pa.RecordBatch) -> None:
        charge(batch.nbytes)
        batches.append(batch)

    schema = _read(relation, _batch_size(tuple(map(str, relation.types))), max_rows, take)
    return _exact(relation, pa.Table.from_batches(batches, schema))


@lru_cache
def _batch_size(types: tuple[str, ...]) -> int:
    """Returns how many rows of columns of these types are measured at a time."""
    if not _FIXED.issuperset(types):
        return _BATCH
    return max(_BATCH, min(_LARGE_BATCH, _MOST_BYTES // (_LARGEST_FIXED * len(types))))


def _read(
    relation: duckdb.DuckDBPyRelation,
    size: int,
    max_rows: int | None,
    take: Callable[[pa.RecordBatch], None],
) -> pa.Schema:
    """Passes rows on, until there are enough; returns their columns."""
    count = 0
    try:
        with relation.to_arrow_reader(size) as reader:
            for batch in reader:
                take(batch)
                count += batch.num_rows
                if max_rows is not None and count >= max_rows:
                    break
            return reader.schema
    except (OSError, pa.ArrowException) as error:  # Arrow's error of DuckDB's
        raise duckdb_error(str(error)) from error


def whole_table(relation: duckdb.DuckDBPyRelation) -> pa.Table:
    """Returns all rows of a relation as an Arrow table."""
    try:
        table = relation.to_arrow_table()
    except pa.ArrowException as error:  # a type that is nested too deeply for Arrow
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


def _size(value: Any) -> int:
    """Returns the size of a value that DuckDB has made, bytes."""
    if isinstance(value, str | bytes):
        return _TEXT + len(value)
    if isinstance(value, list | tuple):
        return _ROW + _POINTER * len(value) + sum(map(_size, value))
    if isinstance(value, dict):
        return _ROW + sum(_size(key) + _size(part) for key, part in value.items())
    return _VALUE
