"""Fetches the rows of a statement within limits of their number and of memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from operator import itemgetter
from typing import Any

import duckdb
import pyarrow as pa

from ssduck.errors import LimitError

# The largest number of rows that are fetched at a time, and their expected size, bytes.
_MOST_ROWS, _MOST_BYTES = 10_000, 10_000_000
_BATCH = 4_096
# The types whose values all have about the same size.
_SMALL = frozenset(("BIGINT", "INTEGER", "DOUBLE", "BOOLEAN", "FLOAT", "HUGEINT"))
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
    charge: Callable[[int], None],
) -> list[tuple[Any, ...]]:
    """Returns the rows of a result as tuples.

    Args:
        result: a connection that has executed a statement.
        types: the types of its columns, as `types_of` returns them.
        max_rows: the number of rows after which no more are fetched; None for all.
        charge: a function that is called with the sizes of rows, bytes, and raises an error if they
            are too large.
    """
    sizes = _sizes_of(types)
    rows: list[tuple[Any, ...]] = []
    # The first row tells how large the others may be.
    count, total = 1 if sizes.texts or sizes.others else _MOST_BYTES // sizes.fixed, 0
    most = -1 if max_rows is None else max_rows
    try:
        while most < 0 or len(rows) < most:
            wanted = count if most < 0 else min(count, most - len(rows))
            chunk = result.fetchmany(wanted)
            rows += chunk
            size = sizes.of(chunk)
            charge(size)
            if len(chunk) < wanted:
                return rows
            total += size
            count = max(1, min(_MOST_ROWS, _MOST_BYTES * len(rows) // total))
        result.abort()
    except LimitError:
        result.abort()
        raise
    return rows


def limited_table(
    relation: duckdb.DuckDBPyRelation, max_rows: int | None, charge: Callable[[int], None]
) -> pa.Table:
    """Returns the rows of a relation as an Arrow table; for the arguments see `limited_rows`."""
    batches, count = [], 0
    try:
        reader = relation.to_arrow_reader(_BATCH)
        for batch in reader:
            charge(batch.nbytes)
            batches.append(batch)
            count += batch.num_rows
            if max_rows is not None and count >= max_rows:
                break
    except (OSError, pa.ArrowException) as error:  # Arrow's error of DuckDB's
        raise duckdb_error(str(error)) from error
    return pa.Table.from_batches(batches, reader.schema)


def whole_table(relation: duckdb.DuckDBPyRelation) -> pa.Table:
    """Returns all rows of a relation as an Arrow table."""
    try:
        return relation.to_arrow_table()
    except pa.ArrowException as error:  # a type that is nested too deeply for Arrow
        raise duckdb_error(str(error)) from error


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
