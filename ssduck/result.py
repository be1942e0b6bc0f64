"""What `ss.sql` gives: rows that stay as they were when the query ran."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, cast

import pyarrow as pa

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl

    from ssduck.shown import Shown


class Result:
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
    def shape(self) -> tuple[int, int]:
        """How many rows and columns there are."""
        return (self._table.num_rows, self._table.num_columns)

    def fetchall(self) -> list[tuple[Any, ...]]:
        """The rows that were not fetched yet, as tuples."""
        return self.fetchmany(self._table.num_rows)

    def fetchmany(self, size: int = 1) -> list[tuple[Any, ...]]:
        """The next rows, at most that many."""
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
        """As a pandas data frame; pandas must be installed."""
        return self._table.to_pandas()

    def pl(self) -> pl.DataFrame:
        """As a polars data frame; polars must be installed."""
        import polars as pl

        return cast("pl.DataFrame", pl.from_arrow(self._table))

    def __len__(self) -> int:
        return int(self._table.num_rows)

    def __iter__(self) -> Iterator[tuple[Any, ...]]:
        return iter(Result(self._table).fetchall())

    def __repr__(self) -> str:
        return f"<Result: {self.shape[0]} rows of {', '.join(self.columns)}>"

    def __str__(self) -> str:
        """The first rows as a table."""
        return repr(_shown(self))

    def _repr_html_(self) -> str:
        """A table for notebooks, of the first rows."""
        return _shown(self)._repr_html_()  # notebooks call it so

    def __rich__(self) -> Shown:
        return _shown(self)


def _shown(result: Result) -> Shown:
    from ssduck.shown import Shown

    return Shown(result)


def values_of(column: pa.ChunkedArray | pa.Array) -> list[Any]:
    """A column's values as DuckDB gives them: its 128-bit integers travel as decimals."""
    values: list[Any] = column.to_pylist()
    if pa.types.is_decimal(column.type) and (column.type.precision, column.type.scale) == (38, 0):
        return [None if value is None else int(value) for value in values]
    return values
