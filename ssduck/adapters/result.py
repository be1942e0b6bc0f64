"""Defines `Result`, the rows that `ss.sql` returns."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast

import pyarrow as pa
import pyarrow.compute as pc

from ssduck import validation
from ssduck.adapters.display import RowsOfColumns
from ssduck.errors import EvaluationError
from ssduck.formatting import count_of
from ssduck.recording.stores.stored_columns import parts_of

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl

    from ssduck.adapters.table_view import TableView

# Representations list at most this number of columns.
_MAX_NAMED = 12
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
_NO_SUCH_TIME = (
    "there is a date beyond the years 1 to 9999, or the time 24:00, which Python cannot hold: cast "
    "it to text, with ::VARCHAR"
)
# The length of a day, in the units of Arrow's times.
_DAY = {"us": 86_400 * 10**6, "ns": 86_400 * 10**9}
_FAMILIES = (
    (pa.types.is_struct, "struct"),
    (pa.types.is_map, "map"),
    (pa.types.is_time, "time"),
    (pa.types.is_interval, "interval"),
    (pa.types.is_duration, "interval"),
)


class TupleRows(Protocol):
    """Rows that are tuples already, of which an Arrow table is made when it is needed."""

    @property
    def columns(self) -> Sequence[str]:
        """The names of the columns."""

    @property
    def types(self) -> list[str]:
        """DuckDB's names of the columns' types."""

    @property
    def rows(self) -> list[tuple[Any, ...]]:
        """The rows."""

    @property
    def table(self) -> pa.Table:
        """The rows as an Arrow table."""

    def __len__(self) -> int:
        """Returns the number of rows."""


class Result(RowsOfColumns):
    """The rows of an SQL query, all fetched, so that stepping the world does not change them.

    Args:
        rows: the rows, as an Arrow table or as tuples.

    >>> result = Result(pa.table({"name": ["sink", "table"]}))
    >>> result.types, result.fetchone(), len(result)
    (['varchar'], ('sink',), 2)
    """

    def __init__(self, rows: pa.Table | TupleRows) -> None:
        self._rows = rows
        self._fetched = 0

    @cached_property
    def _table(self) -> pa.Table:
        return self._rows if isinstance(self._rows, pa.Table) else self._rows.table

    @property
    def columns(self) -> list[str]:
        """The names of the columns."""
        is_table = isinstance(self._rows, pa.Table)
        return list(self._table.column_names if is_table else self._rows.columns)

    @property
    def types(self) -> list[str]:
        """DuckDB's names of the columns' types."""
        if not isinstance(self._rows, pa.Table):
            return self._rows.types
        return [_type_name(column.type) for column in self._table.columns]

    @property
    def shape(self) -> tuple[int, int]:
        """The numbers of rows and of columns."""
        return (len(self), len(self.columns))

    def fetchall(self) -> list[tuple[Any, ...]]:
        """Returns the rows not fetched yet, as tuples."""
        start, self._fetched = self._fetched, len(self)
        return self._slice(start, len(self))

    def fetchmany(self, size: int = 1) -> list[tuple[Any, ...]]:
        """Returns the next rows, at most `size`, as tuples.

        Raises:
            NumberError: `size` is not a whole number of at least 0.
        """
        size = validation.integer(size, "fetchmany: size", minimum=0)
        rows = self.part(self._fetched, size)
        self._fetched = min(self._fetched + size, len(self))
        return rows

    def fetchone(self) -> tuple[Any, ...] | None:
        """Returns the next row; None after the last one."""
        rows = self.fetchmany(1)
        return rows[0] if rows else None

    def part(self, start: int, count: int) -> list[tuple[Any, ...]]:
        """Returns at most `count` rows from an index on, as tuples.

        Raises:
            NumberError: `start` or `count` is not a whole number of at least 0.
        """
        start = validation.integer(start, "part: start", minimum=0)
        count = validation.integer(count, "part: count", minimum=0)
        return self._slice(start, count)

    def _slice(self, start: int, count: int) -> list[tuple[Any, ...]]:
        if not isinstance(self._rows, pa.Table):
            return self._rows.rows[start : start + count]
        columns = [python_values(column) for column in self._table.slice(start, count).columns]
        return list(zip(*columns, strict=True)) if columns else []

    def arrow(self) -> pa.Table:
        """Returns the rows as a pyarrow table."""
        return self._table

    def df(self) -> pd.DataFrame:
        """Returns the rows as a pandas data frame.

        Raises:
            UnsupportedError: pandas is not installed; the message says how to install it.
            EvaluationError: Python cannot hold a date or a time.
        """
        from ssduck.adapters.optional import library

        library("pandas", "pandas")
        self._check_times()
        with _python_dates():
            return self._table.to_pandas()

    def _check_times(self) -> None:
        if any(_has_day_end(chunk) for column in self._table.columns for chunk in column.chunks):
            raise EvaluationError(_NO_SUCH_TIME)

    def pl(self) -> pl.DataFrame:
        """Returns the rows as a polars data frame.

        Raises:
            UnsupportedError: polars is not installed; the message says how to install it.
            EvaluationError: polars cannot hold the time 24:00.
        """
        from ssduck.adapters.optional import library

        self._check_times()
        return cast("pl.DataFrame", library("polars", "polars").from_arrow(self._table))

    def show(self, rows: int | None = None, width: int | None = None) -> None:
        """Prints the first and the last rows as a table.

        Args:
            rows: the maximal number of rows, 20 by default.
            width: the maximal width, characters; by default that of the terminal, if there is one.

        Raises:
            NumberError: `rows` or `width` is not such a number.
        """
        sys.stdout.write(f"{_view(self, rows).text(width)}\n")

    def save(self, path: str | Path) -> Path:
        """Writes all rows to a file in the format of its suffix, and returns its path.

        Args:
            path: the file: `.csv`, `.json`, `.parquet`, `.md` (Markdown) or `.txt` (the table). An
                existing one is replaced.

        Raises:
            UnknownNameError: no format has the suffix.
            ArgumentError: the file cannot be written.
        """
        from ssduck.adapters.formats import save

        return save(self, Path(path))

    def __len__(self) -> int:
        return len(self._rows)

    def __iter__(self) -> Iterator[tuple[Any, ...]]:
        return iter(self.part(0, len(self)))

    def __repr__(self) -> str:
        rows, count = self.shape
        names = self.columns
        if count > _MAX_NAMED:
            half = _MAX_NAMED // 2
            names = [*names[:half], "…", *names[-half:]]
        prefix = f"{count} columns: " if count > _MAX_NAMED else ""
        return f"<Result: {count_of(rows, 'row')} of {prefix}{', '.join(names)}>"

    def __str__(self) -> str:
        """Returns the first and the last rows as a text table, as `show` prints it."""
        return repr(_view(self))

    def _repr_html_(self) -> str:
        """Returns the first and the last rows as an HTML table for notebooks."""
        return _view(self)._repr_html_()

    def __rich__(self) -> TableView:
        return _view(self)


def _view(result: Result, rows: int | None = None) -> TableView:
    from ssduck.adapters.table_view import MAX_ROWS, TableView

    return TableView(result, MAX_ROWS if rows is None else rows)


def python_values(column: pa.ChunkedArray | pa.Array) -> list[Any]:
    """Returns the Python values of a column; integral decimals become int.

    DuckDB exports its 128-bit integers as decimals.

    Raises:
        EvaluationError: Python cannot hold a date or a time.
    """
    chunks = column.chunks if isinstance(column, pa.ChunkedArray) else [column]
    if any(map(_has_day_end, chunks)):  # Python would take it for 0:00
        raise EvaluationError(_NO_SUCH_TIME)
    with _python_dates():
        values: list[Any] = column.to_pylist()
    if pa.types.is_decimal(column.type) and (column.type.precision, column.type.scale) == (38, 0):
        return [None if value is None else int(value) for value in values]
    return values


def _has_day_end(values: pa.Array) -> bool:
    """Checks whether a column has the time 24:00, at any depth."""
    kind = values.type
    if pa.types.is_time64(kind):
        return bool(pc.any(pc.greater_equal(values.cast(pa.int64()), _DAY[kind.unit])).as_py())
    return pa.types.is_nested(kind) and any(map(_has_day_end, parts_of(values)))


@contextmanager
def _python_dates() -> Iterator[None]:
    """Turns errors of dates that Python cannot hold into ssduck's."""
    try:
        yield
    except (OverflowError, ValueError) as error:
        if type(error) not in (OverflowError, ValueError):  # Arrow's errors are ValueErrors, too
            raise
        raise EvaluationError(_NO_SUCH_TIME) from error


def _type_name(type: pa.DataType) -> str:
    """Returns DuckDB's name of an Arrow type."""
    if pa.types.is_dictionary(type):  # an enumeration
        return _type_name(type.value_type)
    if pa.types.is_list(type) or pa.types.is_large_list(type):
        return f"{_type_name(type.value_type)}[]"
    if pa.types.is_fixed_size_list(type):
        return f"{_type_name(type.value_type)}[{type.list_size}]"
    if pa.types.is_decimal(type) and type not in _TYPES:
        return f"decimal({type.precision},{type.scale})"
    if pa.types.is_timestamp(type):
        return "timestamp with time zone" if type.tz else "timestamp"
    for is_family, name in _FAMILIES:
        if is_family(type):
            return name
    return _TYPES.get(type, str(type))
