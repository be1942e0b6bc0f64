"""Turns values into rows and texts for people: tables, and values on one line."""

from __future__ import annotations

import datetime as dt
import math
import sys
import warnings
from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence, Sized
from contextlib import contextmanager
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import partial
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

from ssduck.errors import printable
from ssduck.formatting import count_of, short_repr
from ssduck.logic.why import Why

if TYPE_CHECKING:
    import pyarrow as pa
    from rich.console import Console

    from ssduck.adapters.text_table import FittedTable

# The width of output that goes elsewhere than to a terminal, in characters.
WIDTH = 100
# The number of rows of a table on a terminal.
_TERMINAL_ROWS = 40
# Stands for rows that are left out.
ROW_MARK = "·"


@dataclass(frozen=True)
class DisplayTable:
    """A value as rows for display.

    Attributes:
        columns: the names of the columns; empty if the rows are lists.
        rows: the rows; they may differ in length if `columns` is empty.
        named: whether the names of the columns come from the value.
        types: DuckDB's names of the columns' types; empty if unknown.
        omitted: the number of rows left out in the middle.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]
    named: bool = True
    types: Sequence[str] = ()
    omitted: int = 0

    def shortened(self, maximum: int) -> DisplayTable:
        """Returns the table with its first and its last rows only, at most `maximum` together."""
        omitted = len(self.rows) - maximum
        if omitted <= 0:
            return self
        last = maximum // 2
        rows = [*self.rows[: maximum - last], *self.rows[len(self.rows) - last :]]
        return replace(self, rows=rows, omitted=omitted)

    @property
    def is_list(self) -> bool:
        """Whether it is a list of plain values, which is shown without a head."""
        return bool(self.columns) and not self.named

    @property
    def row_note(self) -> str:
        """The number of rows, if some are left out or there are none; otherwise empty."""
        shown = len(self.rows)
        if self.omitted:
            return f"{count_of(shown + self.omitted, 'row')} ({shown} shown)"
        return "(no rows)" if self.columns and not shown else ""

    def texts(self, text: Callable[[Any], str]) -> list[list[str]]:
        """Returns the texts of the cells; a row of · replaces those left out."""
        lines = [[*map(text, row)] for row in self.rows]
        if self.omitted:
            count = max([len(self.columns), *map(len, lines)])
            lines.insert((len(lines) + 1) // 2, [ROW_MARK] * count)
        return lines


class RowsOfColumns(Sized, Iterable[tuple[Any, ...]]):
    """Rows whose columns have names and types, as `ss.sql` returns them."""

    @property
    @abstractmethod
    def columns(self) -> list[str]:
        """The names of the columns."""

    @property
    @abstractmethod
    def types(self) -> list[str]:
        """DuckDB's names of the columns' types."""

    @abstractmethod
    def arrow(self) -> pa.Table:
        """Returns the rows as a pyarrow table."""

    @abstractmethod
    def part(self, start: int, count: int) -> list[tuple[Any, ...]]:
        """Returns at most `count` rows from an index on, as tuples."""


def display_table(value: Any, max_rows: int | None = None) -> DisplayTable:
    """Returns a value as rows: an element of a list is a row, any other value is one row.

    >>> display_table([{"id": "sink", "volume": 0.03}]).columns
    ['id', 'volume']
    """
    if isinstance(value, RowsOfColumns):
        return _table_of_result(value, len(value) if max_rows is None else max_rows)
    table = value if isinstance(value, DisplayTable) else _table_of_value(value)
    return table if max_rows is None else table.shortened(max_rows)


def readable_table(value: Any, max_rows: int | None = None) -> DisplayTable:
    """Returns what people read of a value: DuckDB's plans and trees as they are, others as rows."""
    if isinstance(value, RowsOfColumns) and value.columns == ["explain_key", "explain_value"]:
        plans = [[plan.rstrip("\n")] for _, plan in value]
        return DisplayTable(["value"], plans, named=False)
    if isinstance(value, Why):
        return DisplayTable(["value"], [[str(value)]], named=False)
    return display_table(value, max_rows)


def _table_of_result(result: RowsOfColumns, max_rows: int) -> DisplayTable:
    """Returns at most `max_rows` rows; only these become values of Python."""
    last = max_rows // 2 if len(result) > max_rows else 0
    rows = result.part(0, max_rows - last) + result.part(len(result) - last, last)
    names, omitted = numbered_duplicates(result.columns), len(result) - len(rows)
    return DisplayTable(names, rows, types=result.types, omitted=omitted if names else 0)


def _table_of_value(value: Any) -> DisplayTable:
    if isinstance(value, Why):
        value = value.rows()
    if isinstance(value, dict):
        return DisplayTable(["key", "value"], list(value.items()))
    if value is None:
        return DisplayTable(["value"], [], named=False)
    if not isinstance(value, list):
        return DisplayTable(["value"], [[value]], named=False)
    if value and all(isinstance(row, dict) for row in value):
        names = list(dict.fromkeys(name for row in value for name in row))
        rows = [[*map(row.get, names)] for row in value]
        types = [_type_of(column) for column in zip(*rows, strict=True)]
        return DisplayTable([json_key(name) for name in names], rows, types=types)
    if value and all(isinstance(row, list) for row in value):
        return DisplayTable([], value, named=False)
    return DisplayTable(["value"], [[element] for element in value], named=False)


def numbered_duplicates(names: Sequence[str]) -> list[str]:
    """Returns names without repetitions, by appending numbers."""
    unique: list[str] = []
    for name in names:
        numbered = (f"{name}_{number}" for number in range(2, 2 + len(names)))
        unique.append(next(n for n in (name, *numbered) if n not in unique))
    return unique


# DuckDB's names of the types of Python's values.
_TYPES = {bool: "boolean", int: "bigint", float: "double", str: "varchar", dict: "struct"}


def _type_of(values: Iterable[Any]) -> str:
    """Returns DuckDB's name of the type of values; empty if unknown or if there are several.

    >>> _type_of([None, [0, 0.5]])
    'double[]'
    """
    present = [value for value in values if value is not None]
    kinds = set(map(type, present))
    if kinds == {int, float}:
        return "double"
    if len(kinds) != 1:
        return ""
    (kind,) = kinds
    if kind in (list, tuple):
        element = _type_of(element for value in present for element in value)
        return f"{element}[]" if element else "list"
    return _TYPES.get(kind, "")


_NOT_FINITE = {math.inf: "Infinity", -math.inf: "-Infinity"}
# Python writes any integer of fewer bits.
_SHORT_BITS = 2_000


def as_json(value: Any, *, words: bool = False) -> Any:
    """Converts a value for JSON: entities and worlds to names, NaN and infinity to null or words.

    >>> as_json({"time": 0.5, "distance": math.inf})
    {'time': 0.5, 'distance': None}
    """
    match value:
        case None | bool() | str():
            return value
        case int():
            return value if value.bit_length() < _SHORT_BITS else _long_integer(value)
        case float():
            if math.isfinite(value):
                return value
            return _NOT_FINITE.get(value, "NaN") if words else None
        case list() | tuple():
            return [as_json(element, words=words) for element in value]
        case dict():
            return {json_key(key): as_json(part, words=words) for key, part in value.items()}
        case bytes():
            return value.hex()
    return _other_as_json(value, words)


def _long_integer(value: int) -> int | str:
    """Returns an integer; its description if it has more digits than Python writes."""
    try:
        str(value)
    except ValueError:
        return short_repr(value)
    return value


def _other_as_json(value: Any, words: bool) -> Any:
    import numpy as np

    from ssduck.world.handles import Handle
    from ssduck.world.world import World

    match value:
        case np.ndarray() | np.generic():
            return as_json(value.tolist(), words=words)
        case Handle():
            return value.full_name
        case World():
            return value.name
        case Decimal():
            return float(value)
        case dt.date() | dt.time():
            return value.isoformat()
    return str(value)


def json_key(key: Any) -> str:
    """Returns the name in JSON of a key of a dict."""
    return key if isinstance(key, str) else cell_text(key)


def cell_text(value: Any) -> str:
    """Returns the text of a value in a CSV file: a string as it is, else JSON.

    NULL and NaN are empty, an infinity is `inf` or `-inf`, as pandas writes and reads them.
    """
    import json

    if isinstance(value, float) and not math.isfinite(value):
        return "" if math.isnan(value) else str(float(value))
    plain = as_json(value, words=True)
    if plain is None:
        return ""
    return plain if isinstance(plain, str) else json.dumps(plain, ensure_ascii=False)


def readable(value: Any, *, inside: bool = False) -> str:
    """Returns the text of a value for people: six digits of numbers, entities by name.

    >>> readable([1 / 3, "sink", None])
    "[0.333333, 'sink', NULL]"
    """
    match value:
        case float():
            return f"{value + 0.0:.{6 if abs(value) < 1e6 else 15}g}"  # -0.0 + 0.0 is 0.0
        case str():
            return repr(value) if inside else value
        case list() | tuple():
            return f"[{', '.join(readable(element, inside=True) for element in value)}]"
        case dict():
            nested = partial(readable, inside=True)
            items = (f"{nested(key)}: {nested(part)}" for key, part in value.items())
            return f"{{{', '.join(items)}}}"
        case None:
            return "NULL"
        case bool():
            return str(value)
    return str(as_json(value))


# -- on the terminal ----------------------------------------------------------------------


def print_line(text: str) -> None:
    """Writes a line to standard output unchanged."""
    sys.stdout.write(f"{text}\n")


def plain_console() -> Console:
    """Returns a console that prints text unchanged: no markup, no coloured numbers."""
    from rich.console import Console

    console = Console(markup=False, highlight=False, emoji=False)
    if not console.is_terminal:
        console.width = WIDTH
    return console


def terminal_width() -> int | None:
    """Returns the width of the terminal of standard output; None if output is not to be cut.

    A notebook has the width of a page. Files and pipes have none.
    """
    from rich.console import Console

    console = Console()
    if console.is_terminal:
        return console.width
    return WIDTH if _is_notebook() else None


def terminal_rows() -> int | None:
    """Returns the number of rows of a table that a terminal shows by default; None for all."""
    return None if terminal_width() is None else _TERMINAL_ROWS


@contextmanager
def written_warnings() -> Iterator[None]:
    """Writes the message of each warning once to standard error, without the place in the code."""
    written: set[str] = set()

    def write(message: Warning | str, *_: Any, **__: Any) -> None:
        text = str(message)
        if text not in written:
            written.add(text)
            sys.stderr.write(f"warning: {text}\n")

    with warnings.catch_warnings():
        warnings.showwarning = write
        yield


def _is_notebook() -> bool:
    """Checks whether the process is the kernel of a notebook, whose pages fold long lines."""
    return "ipykernel" in sys.modules and not hasattr(sys.stdout, "buffer")


def print_table(table: DisplayTable) -> None:
    """Prints a table, fitted to the terminal if standard output is one."""
    console = plain_console()
    if console.is_terminal and not table.is_list:
        console.print(fitted_table(table))
    else:
        sys.stdout.writelines(f"{line}\n" for line in table_lines(table))


def table_lines(table: DisplayTable, width: int | None = None) -> list[str]:
    """Returns the lines of a table with a note on its rows, or of a plain list of values."""
    if table.is_list:
        lines = [text for (text,) in table.texts(on_lines)]
    elif width is not None:
        return fitted_table(table).lines(width)
    else:
        lines = text_lines(table)
    return [*lines, table.row_note] if table.row_note else lines


def fitted_table(table: DisplayTable) -> FittedTable:
    """Returns a table that fits itself to the width of a terminal."""
    from ssduck.adapters.text_table import FittedTable, TextColumn

    head_lines = (table.columns, table.types) if table.types else (table.columns,)
    heads = list(zip(*(map(on_one_line, names) for names in head_lines), strict=True))
    lines = table.texts(on_one_line)
    cells = list(zip_longest(*lines, fillvalue="")) or [()] * len(heads)
    if not table.named:
        heads = [()] * len(cells)
    parts = zip(heads, cells, are_numeric(table), strict=True)
    return FittedTable([TextColumn(*part) for part in parts], table.row_note)


def text_lines(table: DisplayTable) -> list[str]:
    """Returns the lines of a table at full width, for files and other programs."""
    return fitted_table(replace(table, types=())).plain_lines()


def are_numeric(table: DisplayTable) -> list[bool]:
    """Returns, for each column, whether it holds numbers only and so is aligned right."""
    columns = zip_longest(*table.rows)
    numeric = [all(map(_is_number, column)) for column in columns]
    return numeric or [False] * len(table.columns)


def _is_number(value: Any) -> bool:
    return value is None or (
        isinstance(value, int | float | Decimal) and not isinstance(value, bool)
    )


def on_one_line(value: Any) -> str:
    """Returns the text of `readable` with line ends and control characters escaped."""
    text = readable(value)
    return text if text.isprintable() else repr(text)[1:-1]


def on_lines(value: Any) -> str:
    """Returns the text of `readable` with control characters escaped but line ends and tabs."""
    return printable(readable(value), kept="\n\t")
