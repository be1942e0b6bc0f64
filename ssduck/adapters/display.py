"""Answers on the command line: as a table, as JSON, as CSV."""

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

# How wide the output is at least where there is no terminal to tell.
WIDTH = 100


@dataclass(frozen=True)
class DisplayTable:
    """An answer as rows.

    Attributes:
        columns: their names, none if the rows are lists.
        rows: may differ in length if there are no columns.
        named: whether the answer itself names the columns.
        types: of the columns, as DuckDB calls them; none if they are not known.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]
    named: bool = True
    types: Sequence[str] = ()


class RowsOfColumns(ABC):
    """Rows whose columns have names and types: what `ss.sql` gives."""

    @property
    @abstractmethod
    def columns(self) -> list[str]:
        """The names of the columns."""

    @property
    @abstractmethod
    def types(self) -> list[str]:
        """The types of the columns, as DuckDB calls them."""

    @abstractmethod
    def fetchall(self) -> list[tuple[Any, ...]]:
        """The rows that were not fetched yet, as tuples."""

    @abstractmethod
    def __iter__(self) -> Iterator[tuple[Any, ...]]:
        """All rows, as tuples."""


def answer_of(value: Any) -> DisplayTable:
    """A value as rows: lists of dicts and of lists row by row, else a row a value."""
    if isinstance(value, RowsOfColumns):
        return DisplayTable(_distinct(value.columns), list(value), types=value.types)
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


def _distinct(names: Sequence[str]) -> list[str]:
    """Columns of the same name are told apart by a number."""
    found: list[str] = []
    for name in names:
        numbered = (f"{name}_{number}" for number in range(2, 2 + len(names)))
        found.append(next(n for n in (name, *numbered) if n not in found))
    return found


def _write_table(value: Any) -> None:
    answer = answer_of(value)
    if answer.columns and not answer.named:
        for row in answer.rows:
            print_line(readable(row[0]))
    elif answer.columns or answer.rows:
        print_table(answer)
    if answer.columns and not answer.rows and value is not None:
        print_line("(no rows)")


def _write_json(value: Any) -> None:
    if isinstance(value, RowsOfColumns):
        columns = _distinct(value.columns)
        value = [dict(zip(columns, row, strict=True)) for row in value.fetchall()]
    ascii_only = (sys.stdout.encoding or "").lower() not in ("utf-8", "utf8")
    if not (isinstance(value, list) and any(isinstance(row, list | dict) for row in value)):
        print_line(json.dumps(as_json(value), ensure_ascii=ascii_only))
        return
    start = "[\n"
    for row in value:  # a row a line can be read by people too
        sys.stdout.write(start + json.dumps(as_json(row), ensure_ascii=ascii_only))
        start = ",\n"
    print_line("\n]")


def _write_csv(value: Any) -> None:
    answer = answer_of(value)
    writer = csv.writer(sys.stdout, lineterminator="\n")
    if answer.columns:
        writer.writerow(answer.columns)
    writer.writerows([[_cell(element) for element in row] for row in answer.rows])


WRITERS: dict[str, Callable[[Any], None]] = {
    "table": _write_table,
    "json": _write_json,
    "csv": _write_csv,
}


def as_json(value: Any) -> Any:
    """A value as JSON has it: entities and worlds by name, numbers that are none as null."""
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
    return _of_other_type(value)


def _of_other_type(value: Any) -> Any:
    import numpy as np

    from ssduck.world.entities import Entity
    from ssduck.world.world import World

    match value:
        case np.ndarray() | np.generic():
            return as_json(value.tolist())
        case Entity() | World():
            return value.name
        case Decimal():
            return float(value)
        case dt.date() | dt.time():
            return value.isoformat()
    return str(value)


def _key(key: Any) -> str:
    return key if isinstance(key, str) else _cell(key)


def _cell(value: Any) -> str:
    """A value in a CSV file: a text, or JSON; an unknown value is empty."""
    plain = as_json(value)
    if plain is None:
        return ""
    return plain if isinstance(plain, str) else json.dumps(plain, ensure_ascii=False)


def readable(value: Any, *, inside: bool = False) -> str:
    """A value for people: numbers rounded to six digits, entities by name."""
    match value:
        case float():
            return f"{value + 0.0:.{6 if abs(value) < 1e6 else 15}g}"  # -0.0 + 0.0 is 0.0
        case str():
            return repr(value) if inside else value
        case list() | tuple():
            return f"[{', '.join(readable(element, inside=True) for element in value)}]"
        case dict():
            told = partial(readable, inside=True)
            return f"{{{', '.join(f'{told(key)}: {told(part)}' for key, part in value.items())}}}"
        case None:
            return "NULL"
        case bool():
            return str(value)
    return str(as_json(value))


# -- on the terminal ----------------------------------------------------------------------


def print_line(text: str) -> None:
    """Write a line to standard output as it is."""
    sys.stdout.write(f"{text}\n")


def console_of_answers() -> Console:
    """Where text is printed as it is: square brackets are no markup, numbers not coloured."""
    from rich.console import Console

    console = Console(markup=False, highlight=False, emoji=False)
    if not console.is_terminal:
        console.width = WIDTH
    return console


def terminal_width() -> int | None:
    """How wide the terminal is that standard output goes to; None if it goes elsewhere."""
    from rich.console import Console

    console = Console()
    return console.width if console.is_terminal else None


def print_table(answer: DisplayTable) -> None:
    """A table that fits the terminal; elsewhere it is as wide as it is."""
    console = console_of_answers()
    if console.is_terminal:
        console.print(fitted(answer))
    else:
        sys.stdout.writelines(f"{line}\n" for line in lines_of(answer))


def fitted(answer: DisplayTable, note: str = "") -> FittedTable:
    """A table that fits a terminal.

    Args:
        answer: the rows.
        note: what a line below tells of them.
    """
    from ssduck.adapters.text_table import FittedTable, TextColumn

    told = (answer.columns, answer.types) if answer.types else (answer.columns,)
    heads = list(zip(*(map(_on_one_line, names) for names in told), strict=True))
    lines = [[_on_one_line(value) for value in row] for row in answer.rows]
    cells = list(zip_longest(*lines, fillvalue="")) or [()] * len(heads)
    if not answer.named:
        heads = [()] * len(cells)
    parts = zip(heads, cells, _numeric(answer), strict=True)
    return FittedTable([TextColumn(*part) for part in parts], note)


def lines_of(answer: DisplayTable) -> Iterator[str]:
    """The lines of a table that is read by programs, or kept."""
    from rich.cells import cell_len

    lines = [[_on_one_line(value) for value in row] for row in answer.rows]
    if answer.named:
        lines.insert(0, [_on_one_line(name) for name in answer.columns])
    widths = [max(map(cell_len, cells)) for cells in zip_longest(*lines, fillvalue="")]
    if answer.named:
        lines.insert(1, ["-" * width for width in widths])
    numeric = _numeric(answer)
    for line in lines:
        padded = (
            " " * (width - cell_len(text)) + text
            if right
            else text + " " * (width - cell_len(text))
            for text, width, right in zip(line, widths, numeric, strict=False)
        )
        yield "  ".join(padded).rstrip()


def _numeric(answer: DisplayTable) -> list[bool]:
    """Which columns hold numbers only; they are aligned at the right."""
    columns = zip_longest(*answer.rows)
    found = [all(map(_is_number, column)) for column in columns]
    return found or [False] * len(answer.columns)


def _is_number(value: Any) -> bool:
    return value is None or (
        isinstance(value, int | float | Decimal) and not isinstance(value, bool)
    )


def _on_one_line(value: Any) -> str:
    """As `shown`; line ends and what else would upset a terminal are escaped."""
    text = readable(value)
    return text if text.isprintable() else repr(text)[1:-1]
