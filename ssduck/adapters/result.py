"""What `ss.sql` gives: rows that stay as they were when the query ran."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, cast

import pyarrow as pa

from ssduck import validation
from ssduck.adapters.display import RowsOfColumns

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl

    from ssduck.adapters.table_view import TableView

# A result of more columns does not name them all.
_MOST_NAMED = 12
_TYPES = {
    pa.null(): "null",
    pa.bool_(): "boolean",
    pa.int8(): "tinyint",
    pa.int16(): "smallint",
    pa.int32(): "integer",
    pa.int64(): "bigint",
    pa.uint8(): "utinyint",
    pa.uint16(): "usmallint",
    pa.uint32(): "uinteger",
    pa.uint64(): "ubigint",
    pa.float32(): "float",
    pa.float64(): "double",
    pa.string(): "varchar",
    pa.large_string(): "varchar",
    pa.binary(): "blob",
    pa.large_binary(): "blob",
    pa.date32(): "date",
    pa.decimal128(38, 0): "hugeint",
}
_FAMILIES = (
    (pa.types.is_struct, "struct"),
    (pa.types.is_map, "map"),
    (pa.types.is_time, "time"),
    (pa.types.is_interval, "interval"),
    (pa.types.is_duration, "interval"),
)


class Result(RowsOfColumns):
    """The rows of an SQL query, all of them fetched: stepping the world does not change them.

    Args:
        table: the rows.
    """

    def __init__(self, table: pa.Table) -> None:
        self._table = table
        self._fetched = 0

    @property
    def columns(self) -> list[str]:
        """The names of the columns."""
        return list(self._table.column_names)

    @property
    def types(self) -> list[str]:
        """The types of the columns, as DuckDB calls them."""
        return [_type_name(column.type) for column in self._table.columns]

    @property
    def shape(self) -> tuple[int, int]:
        """How many rows and columns there are."""
        return (self._table.num_rows, self._table.num_columns)

    def fetchall(self) -> list[tuple[Any, ...]]:
        """The rows that were not fetched yet, as tuples."""
        return self.fetchmany(self._table.num_rows)

    def fetchmany(self, size: int = 1) -> list[tuple[Any, ...]]:
        """The next rows, at most that many.

        Raises:
            NumberError: that is no whole number, 0 or more.
        """
        size = validation.integer(size, "fetchmany: size", minimum=0)
        part = self._table.slice(self._fetched, size)
        self._fetched += part.num_rows
        columns = [values_of(column) for column in part.columns]
        return list(zip(*columns, strict=True)) if columns else []

    def fetchone(self) -> tuple[Any, ...] | None:
        """The next row, None behind the last."""
        rows = self.fetchmany(1)
        return rows[0] if rows else None

    def arrow(self) -> pa.Table:
        """As a pyarrow table."""
        return self._table

    def df(self) -> pd.DataFrame:
        """As a pandas data frame.

        Raises:
            UnsupportedError: pandas is not installed, and how to install it.
        """
        from ssduck.adapters.optional import library

        library("pandas", "pandas")
        return self._table.to_pandas()

    def pl(self) -> pl.DataFrame:
        """As a polars data frame.

        Raises:
            UnsupportedError: polars is not installed, and how to install it.
        """
        from ssduck.adapters.optional import library

        return cast("pl.DataFrame", library("polars", "polars").from_arrow(self._table))

    def __len__(self) -> int:
        return int(self._table.num_rows)

    def __iter__(self) -> Iterator[tuple[Any, ...]]:
        return iter(Result(self._table).fetchall())

    def __repr__(self) -> str:
        rows, count = self.shape
        names = self.columns
        if count > _MOST_NAMED:
            half = _MOST_NAMED // 2
            names = [*names[:half], "…", *names[-half:]]
        of = f"{count} columns: " if count > _MOST_NAMED else ""
        return f"<Result: {rows} rows of {of}{', '.join(names)}>"

    def __str__(self) -> str:
        """The first rows as a table."""
        return repr(_shown(self))

    def _repr_html_(self) -> str:
        """A table for notebooks, of the first rows."""
        return _shown(self)._repr_html_()  # notebooks call it so

    def __rich__(self) -> TableView:
        return _shown(self)


def _shown(result: Result) -> TableView:
    from ssduck.adapters.table_view import TableView

    return TableView(result)


def values_of(column: pa.ChunkedArray | pa.Array) -> list[Any]:
    """A column's values as DuckDB gives them: its 128-bit integers travel as decimals."""
    values: list[Any] = column.to_pylist()
    if pa.types.is_decimal(column.type) and (column.type.precision, column.type.scale) == (38, 0):
        return [None if value is None else int(value) for value in values]
    return values


def _type_name(of: pa.DataType) -> str:
    """What DuckDB calls a type of Arrow's."""
    if pa.types.is_dictionary(of):  # an enumeration
        return _type_name(of.value_type)
    if pa.types.is_list(of) or pa.types.is_large_list(of):
        return f"{_type_name(of.value_type)}[]"
    if pa.types.is_fixed_size_list(of):
        return f"{_type_name(of.value_type)}[{of.list_size}]"
    if pa.types.is_decimal(of) and of not in _TYPES:
        return f"decimal({of.precision},{of.scale})"
    if pa.types.is_timestamp(of):
        return "timestamp with time zone" if of.tz else "timestamp"
    for is_one, name in _FAMILIES:
        if is_one(of):
            return name
    return _TYPES.get(of, str(of))
