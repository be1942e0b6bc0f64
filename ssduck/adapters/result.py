"""Defines `Result`, the rows that `ss.sql` returns, and views of values as tables."""

from __future__ import annotations

import html
import sys
from collections.abc import Iterator, Mapping, Sequence, Sized
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast

import pyarrow as pa
import pyarrow.compute as pc

from ssduck import validation
from ssduck.adapters.display import (
    RowsOfColumns,
    fitted_table,
    on_lines,
    readable_table,
    table_lines,
    terminal_width,
)
from ssduck.adapters.optional import library
from ssduck.adapters.text_table import FittedTable
from ssduck.errors import ArgumentError, EvaluationError
from ssduck.formatting import count_of, error_text, short_repr
from ssduck.recording.stores.stored_columns import parts_of

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl


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


class TupleRows(Sized, Protocol):
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
        return self.fetchmany(len(self))

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
    return TableView(result, MAX_ROWS if rows is None else rows)


def python_values(column: pa.ChunkedArray | pa.Array) -> list[Any]:
    """Returns the Python values of a column; integral decimals become int.

    DuckDB exports its 128-bit integers as decimals.
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


def arrow_of(frame: Any) -> pa.Table:
    """Returns an Arrow table with a copy of the rows of a frame; see `Interpreter.register`."""
    try:
        table = table_of_frame(frame)
    except (pa.ArrowException, TypeError, ValueError, AttributeError) as error:
        raise ArgumentError(
            f"register: {short_repr(frame)} is no table: {error_text(error)}"
        ) from error
    if table is None:
        raise ArgumentError(
            "register: give a data frame of pandas or polars, an Arrow table, a result of ss.sql, "
            f"or a dict of columns, not {short_repr(frame)}"
        )
    # Arrow shares the memory of numpy's arrays.
    copy = pa.BufferOutputStream()
    with pa.ipc.new_stream(copy, table.schema) as stream:
        stream.write_table(table)
    return pa.ipc.open_stream(copy.getvalue()).read_all()


def is_table(value: Any) -> bool:
    """Checks whether a value is a data frame, an Arrow table or a result of `ss.sql`."""
    kind = type(value)  # by name, because the libraries may not be installed
    is_frame = kind.__module__.partition(".")[0] in {"pandas", "polars"}
    is_frame &= kind.__name__ == "DataFrame"
    return is_frame or isinstance(value, pa.Table | pa.RecordBatch | Result)


def table_of_frame(frame: Any) -> pa.Table | None:
    """Returns an Arrow table with the rows of a frame; None for what is none."""
    match frame:
        case pa.Table():
            return frame
        case Result():
            return frame.arrow()
        case Mapping() if frame:
            return pa.table(dict(frame))
    if type(frame).__module__.partition(".")[0] == "pandas":
        return pa.Table.from_pandas(frame, preserve_index=False).replace_schema_metadata()
    return pa.table(frame) if hasattr(frame, "__arrow_c_stream__") else None


# The number of rows shown by default.
MAX_ROWS = 20


class TableView:
    """A view of a value as a table: its first and last rows, numbers rounded to six digits.

    A row of · stands for the rows in the middle that are left out, and a line below has the
    counts. A terminal shows text that fits its width, a notebook shows HTML, and rich a table of
    its own. Other output is text at full width.

    Args:
        value: the rows, a list of dicts for example.
        rows: the maximal number of rows shown.

    Raises:
        NumberError: `rows` is not a whole number of at least 0.

    >>> heights = [{"id": "sink", "z": 0.9}, {"id": "cup", "z": 1.0}, {"id": "lamp", "z": 2.1}]
    >>> TableView(heights, rows=2)
    id      z
    ----  ---
    sink  0.9
    ·       ·
    lamp  2.1
    3 rows (2 shown)
    """

    def __init__(self, value: Any, rows: int = MAX_ROWS) -> None:
        rows = validation.integer(rows, "show: rows", minimum=0)
        self._table = readable_table(value, rows)

    def text(self, width: int | None = None) -> str:
        """Returns the table as a text.

        Args:
            width: the maximal width, characters; by default that of the terminal, if there is one.

        Raises:
            NumberError: `width` is not a whole number of at least 1.
        """
        if width is None:
            width = terminal_width()
        else:
            width = validation.integer(width, "show: width", minimum=1)
        return "\n".join(table_lines(self._table, width))

    def __repr__(self) -> str:
        return self.text()

    def _repr_html_(self) -> str:
        table = self._table
        names = [*map(_escaped, table.columns)] if table.named else []
        types = [f"<br><small>{_escaped(type)}</small>" for type in table.types]
        head = _html_row("th", [*map("".join, zip(names, types, strict=True))] if types else names)
        rows = [_html_row("td", row) for row in table.texts(_escaped)]
        note = f"<p>{self._note}</p>" if self._note else ""
        html_table = f"<table><thead>{head}</thead><tbody>{''.join(rows)}</tbody></table>"
        # A wide table scrolls instead of widening the notebook.
        return f'<div style="overflow-x: auto">{html_table}</div>{note}'

    @property
    def _note(self) -> str:
        """The numbers of rows and of columns, if rows are left out."""
        table = self._table
        if not (table.omitted and table.named):
            return table.row_note
        return f"{table.row_note}, {count_of(len(table.columns), 'column')}"

    def __rich__(self) -> FittedTable:
        return fitted_table(self._table)


def _html_row(tag: str, cells: Any) -> str:
    return f"<tr>{''.join(f'<{tag}>{cell}</{tag}>' for cell in cells)}</tr>"


def _escaped(value: Any) -> str:
    text = html.escape(on_lines(value))
    return f"<pre>{text}</pre>" if "\n" in text else text
