"""Fetches the rows of a statement within limits of their number and of memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from operator import itemgetter
from typing import Any

import duckdb
import pyarrow as pa

from ssduck.errors import LimitError

# The largest number of rows that are fetched at a time, and their expected size, bytes.
_MOST_ROWS, _MOST_BYTES = 10_000, 10_000_000
_BATCH = 2_048
# The types whose values all have about the same size.
_SMALL = frozenset(("BIGINT", "INTEGER", "DOUBLE", "BOOLEAN", "FLOAT", "HUGEINT"))
# The sizes of Python's objects, bytes.
_ROW, _VALUE, _TEXT, _POINTER = 64, 32, 56, 8


def limited_rows(
    result: duckdb.DuckDBPyConnection, max_rows: int | None, charge: Callable[[int], None]
) -> list[tuple[Any, ...]]:
    """Returns the rows of a result as tuples.

    Args:
        result: a connection that has executed a statement.
        max_rows: the number of rows after which no more are fetched; None for all.
        charge: a function that is called with the sizes of rows, bytes, and raises an error if they
            are too large.
    """
    names = [str(column[1]) for column in result.description]
    texts = [index for index, name in enumerate(names) if name == "VARCHAR"]
    others = [i for i, name in enumerate(names) if name not in _SMALL and name != "VARCHAR"]
    fixed = _ROW + _VALUE * len(names)
    rows: list[tuple[Any, ...]] = []
    # The first row tells how large the others may be.
    count, total = 1 if texts or others else _MOST_BYTES // fixed, 0
    most = -1 if max_rows is None else max_rows
    try:
        while most < 0 or len(rows) < most:
            wanted = count if most < 0 else min(count, most - len(rows))
            chunk = result.fetchmany(wanted)
            rows += chunk
            size = len(chunk) * fixed
            size += sum(_text_size(map(itemgetter(index), chunk)) for index in texts)
            size += sum(_size(row[index]) for index in others for row in chunk)
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


def _text_size(texts: Iterable[str | None]) -> int:
    return sum(map(len, filter(None, texts)))


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


def _size(value: Any) -> int:
    """Returns the size of a value that DuckDB has made, bytes."""
    if isinstance(value, str | bytes):
        return _TEXT + len(value)
    if isinstance(value, list | tuple):
        return _ROW + _POINTER * len(value) + sum(map(_size, value))
    if isinstance(value, dict):
        return _ROW + sum(_size(key) + _size(part) for key, part in value.items())
    return _VALUE
