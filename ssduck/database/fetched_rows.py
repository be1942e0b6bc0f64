"""The rows of a user's statement, fetched once: as Python's values, or as an Arrow table."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import Any

import duckdb
import numpy.typing as npt
import pyarrow as pa

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
# The same for ssduck's own statements, whose columns become tuples again.
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


class FetchedRows:
    """All rows of a statement; tuples and the Arrow table are made when they are needed.

    Args:
        header: their columns.
        first: the first rows.
        rest: the columns of the other rows.
    """

    def __init__(
        self,
        header: Header,
        first: list[tuple[Any, ...]],
        rest: Sequence[npt.NDArray[Any]] = (),
    ) -> None:
        self._header = header
        self._first = first
        self._rest = rest
        self._count = len(first) + (len(rest[0]) if rest else 0)

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
        is_long = self._count >= MAX_TUPLES
        return (
            self._header
            if self._header.is_long is is_long
            else replace(self._header, is_long=is_long)
        )

    def __len__(self) -> int:
        return self._count

    def renamed(self, columns: tuple[str, ...]) -> FetchedRows:
        """Returns the same rows with other names of the columns."""
        if self._header.names == columns:
            return self
        return FetchedRows(replace(self._header, names=columns), self._first, self._rest)

    @cached_property
    def rows(self) -> list[tuple[Any, ...]]:
        """The rows as tuples."""
        if not self._rest:
            return self._first
        return [*self._first, *zip(*(column.tolist() for column in self._rest), strict=True)]

    @cached_property
    def table(self) -> pa.Table:
        """The rows as an Arrow table, as DuckDB makes it."""
        names, types = self._header.names, self._header.types
        first = list(zip(*self._first, strict=True)) or [()] * len(names)
        rest = [column.tolist() for column in self._rest] or [[]] * len(names)
        arrays = [
            pa.array(list(chain(start, end)), ARROW_TYPES[name])
            for start, end, name in zip(first, rest, types, strict=True)
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
        return FetchedRows(header, rows, list(result.fetchnumpy().values()))
    return FetchedRows(header, rows)


def all_rows(result: duckdb.DuckDBPyConnection) -> list[tuple[Any, ...]]:
    """Returns all rows of a result; many rows are fetched by column, in a quarter of the time."""
    rows: list[tuple[Any, ...]] = result.fetchmany(MANY_ROWS)
    if len(rows) == MANY_ROWS:
        if all(str(column[1]) in ARROW_TYPES for column in result.description):
            columns = result.fetchnumpy().values()
            rows.extend(zip(*(column.tolist() for column in columns), strict=True))
        else:
            rows.extend(result.fetchall())
    return rows
