"""Writes values for people and programs: as a table, as JSON, as CSV."""

from __future__ import annotations

import csv
import datetime as dt
import json
import math
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import partial
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

    from ssduck.adapters.text_table import FittedTable

# The width of output that goes elsewhere than to a terminal, in characters.
WIDTH = 100


@dataclass(frozen=True)
class DisplayTable:
    """A value as rows for display.

    Attributes:
        columns: the names of the columns; empty if the rows are lists.
        rows: the rows; they may differ in length if `columns` is empty.
        named: whether the names of the columns come from the value.
        types: DuckDB's names of the columns' types; empty if unknown.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]
    named: bool = True
    types: Sequence[str] = ()


class RowsOfColumns(ABC):
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
    def fetchall(self) -> list[tuple[Any, ...]]:
        """Returns the rows not fetched yet, as tuples."""

    @abstractmethod
    def __iter__(self) -> Iterator[tuple[Any, ...]]:
        """Iterates over all rows, as tuples."""


def display_table(value: Any) -> DisplayTable:
    """Returns a value as rows: an element of a list is a row, any other value is one row.

    >>> display_table([{"id": "sink", "volume": 0.03}]).columns
    ['id', 'volume']
    """
    if isinstance(value, RowsOfColumns):
        return DisplayTable(_numbered_duplicates(value.columns), list(value), types=value.types)
    if isinstance(value, dict):
        return DisplayTable(["key", "value"], list(value.items()))
    if value is None:
        return DisplayTable(["value"], [], named=False)
    if not isinstance(value, list):
        return DisplayTable(["value"], [[value]], named=False)
    if value and all(isinstance(row, dict) for row in value):
        names = list(dict.fromkeys(name for row in value for name in row))
        return DisplayTable(
            [_key(name) for name in names], [[*map(row.get, names)] for row in value]
        )
    if value and all(isinstance(row, list) for row in value):
        return DisplayTable([], value, named=False)
    return DisplayTable(["value"], [[element] for element in value], named=False)


def _numbered_duplicates(names: Sequence[str]) -> list[str]:
    """Returns names without repetitions, by appending numbers."""
    unique: list[str] = []
    for name in names:
        numbered = (f"{name}_{number}" for number in range(2, 2 + len(names)))
        unique.append(next(n for n in (name, *numbered) if n not in unique))
    return unique


def _write_table(value: Any) -> None:
    table = display_table(value)
    if table.columns and not table.named:
        for row in table.rows:
            print_line(readable(row[0]))
    elif table.columns or table.rows:
        print_table(table)
    if table.columns and not table.rows and value is not None:
        print_line("(no rows)")


def _write_json(value: Any) -> None:
    if isinstance(value, RowsOfColumns):
        columns = _numbered_duplicates(value.columns)
        value = [dict(zip(columns, row, strict=True)) for row in value.fetchall()]
    ascii_only = (sys.stdout.encoding or "").lower() not in ("utf-8", "utf8")
    if not (isinstance(value, list) and any(isinstance(row, list | dict) for row in value)):
        print_line(json.dumps(as_json(value), ensure_ascii=ascii_only))
        return
    start = "[\n"
    for row in value:  # one row per line is readable for people, too
        sys.stdout.write(start + json.dumps(as_json(row), ensure_ascii=ascii_only))
        start = ",\n"
    print_line("\n]")


def _write_csv(value: Any) -> None:
    table = display_table(value)
    writer = csv.writer(sys.stdout, lineterminator="\n")
    if table.columns:
        writer.writerow(table.columns)
    writer.writerows([[_cell(element) for element in row] for row in table.rows])


WRITERS: dict[str, Callable[[Any], None]] = {
    "table": _write_table,
    "json": _write_json,
    "csv": _write_csv,
}


def as_json(value: Any) -> Any:
    """Converts a value for JSON: entities and worlds to names, NaN and infinity to null.

    >>> as_json({"time": 0.5, "distance": math.inf})
    {'time': 0.5, 'distance': None}
    """
    match value:
        case None | bool() | int() | str():
            return value
        case float():
            return value if math.isfinite(value) else None
        case list() | tuple():
            return [as_json(element) for element in value]
        case dict():
            return {_key(key): as_json(element) for key, element in value.items()}
        case bytes():
            return value.hex()
    return _other_as_json(value)


def _other_as_json(value: Any) -> Any:
    import numpy as np

    from ssduck.world.handles import Handle
    from ssduck.world.world import World

    match value:
        case np.ndarray() | np.generic():
            return as_json(value.tolist())
        case Handle():
            return value.full_name
        case World():
            return value.name
        case Decimal():
            return float(value)
        case dt.date() | dt.time():
            return value.isoformat()
    return str(value)


def _key(key: Any) -> str:
    return key if isinstance(key, str) else _cell(key)


def _cell(value: Any) -> str:
    """Returns the text of a value in a CSV file: a string as it is, NULL as nothing, else JSON."""
    plain = as_json(value)
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
    """Returns the width of the terminal of standard output; None if output goes elsewhere."""
    from rich.console import Console

    console = Console()
    return console.width if console.is_terminal else None


def print_table(table: DisplayTable) -> None:
    """Prints a table, fitted to the terminal if standard output is one."""
    console = plain_console()
    if console.is_terminal:
        console.print(fitted_table(table))
    else:
        sys.stdout.writelines(f"{line}\n" for line in text_lines(table))


def fitted_table(table: DisplayTable, note: str = "") -> FittedTable:
    """Returns a table that fits itself to the width of a terminal.

    Args:
        table: the rows.
        note: a line below the rows.
    """
    from ssduck.adapters.text_table import FittedTable, TextColumn

    head_lines = (table.columns, table.types) if table.types else (table.columns,)
    heads = list(zip(*(map(_on_one_line, names) for names in head_lines), strict=True))
    lines = [[_on_one_line(value) for value in row] for row in table.rows]
    cells = list(zip_longest(*lines, fillvalue="")) or [()] * len(heads)
    if not table.named:
        heads = [()] * len(cells)
    parts = zip(heads, cells, _are_numeric(table), strict=True)
    return FittedTable([TextColumn(*part) for part in parts], note)


def text_lines(table: DisplayTable) -> Iterator[str]:
    """Yields the lines of a table at full width, for files and other programs."""
    from rich.cells import cell_len

    lines = [[_on_one_line(value) for value in row] for row in table.rows]
    if table.named:
        lines.insert(0, [_on_one_line(name) for name in table.columns])
    widths = [max(map(cell_len, cells)) for cells in zip_longest(*lines, fillvalue="")]
    if table.named:
        lines.insert(1, ["-" * width for width in widths])
    numeric = _are_numeric(table)
    for line in lines:
        padded = (
            " " * (width - cell_len(text)) + text
            if right
            else text + " " * (width - cell_len(text))
            for text, width, right in zip(line, widths, numeric, strict=False)
        )
        yield "  ".join(padded).rstrip()


def _are_numeric(table: DisplayTable) -> list[bool]:
    """Returns, for each column, whether it holds numbers only and so is aligned right."""
    columns = zip_longest(*table.rows)
    numeric = [all(map(_is_number, column)) for column in columns]
    return numeric or [False] * len(table.columns)


def _is_number(value: Any) -> bool:
    return value is None or (
        isinstance(value, int | float | Decimal) and not isinstance(value, bool)
    )


def _on_one_line(value: Any) -> str:
    """Returns the text of `readable` with line ends and control characters escaped."""
    text = readable(value)
    return text if text.isprintable() else repr(text)[1:-1]
