"""Writes values in the formats of files and of the command line: `FORMATS` has them all."""

from __future__ import annotations

import csv
import io
import json
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, TextIO

from ssduck.adapters.base import replace_file
from ssduck.adapters.display import (
    DisplayTable,
    RowsOfColumns,
    are_numeric,
    as_json,
    cell_text,
    display_table,
    numbered_duplicates,
    on_one_line,
    print_table,
    readable_table,
    table_lines,
)
from ssduck.errors import ArgumentError, check_known, printable
from ssduck.logic.why import Why

# Characters that Markdown would interpret: [ only in links, _ only beside a word.
_MARKDOWN = re.compile(r"[\\`*|~]|\[(?=[^]]*\]\()|(?<!\w)_|_(?!\w)")


def _table(value: Any, stream: TextIO) -> None:
    if value is None:
        return
    stream.writelines(f"{line}\n" for line in table_lines(readable_table(value)))


def _json(value: Any, stream: TextIO) -> None:
    if isinstance(value, Why):
        value = value.rows()
    if isinstance(value, RowsOfColumns):
        columns = numbered_duplicates(value.columns)
        value = [dict(zip(columns, row, strict=True)) for row in value]
    # Only streams in memory have no encoding.
    ascii_only = (stream.encoding or "utf-8").lower() not in ("utf-8", "utf8")
    to_text = partial(json.dumps, ensure_ascii=ascii_only)
    if not (isinstance(value, list) and any(isinstance(row, list | dict) for row in value)):
        stream.write(f"{to_text(as_json(value))}\n")
        return
    start = "[\n"
    for row in value:  # one row per line is readable for people, too
        stream.write(start + to_text(as_json(row)))
        start = ",\n"
    stream.write("\n]\n")


@dataclass(frozen=True)
class _LineEnds:
    """Writes lines that end with two characters to a stream, with a line feed in their place."""

    stream: TextIO

    def write(self, line: str) -> None:
        self.stream.write(f"{line[:-2]}\n")


def _csv(value: Any, stream: TextIO) -> None:
    table = display_table(value)
    # The module quotes the characters of the line end, and readers take \r alone for one, too.
    writer = csv.writer(_LineEnds(stream), lineterminator="\r\n")
    if table.columns:
        writer.writerow(table.columns)
    writer.writerows([cell_text(element) for element in row] for row in table.rows)


def _markdown(value: Any, stream: TextIO) -> None:
    stream.writelines(f"{line}\n" for line in markdown_lines(display_table(value)))


def markdown_lines(table: DisplayTable) -> Iterator[str]:
    """Yields the lines of a table in Markdown; numbers are aligned right."""
    count = max([len(table.columns), *map(len, table.rows)], default=0)
    names = [*table.columns, *[""] * (count - len(table.columns))]
    numeric = [*are_numeric(table), *[False] * count]
    if not count:
        return
    yield _markdown_row(map(_escaped, names))
    yield _markdown_row("---:" if right else "---" for right in numeric[:count])
    for row in table.rows:
        yield _markdown_row([*map(_escaped, row), *[""] * (count - len(row))])


def _markdown_row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _escaped(value: Any) -> str:
    """Returns the text of a value with all characters escaped that Markdown would interpret."""
    text = _MARKDOWN.sub(r"\\\g<0>", on_one_line(value))
    return text.replace("&", "&amp;").replace("<", "&lt;")


def _parquet(value: Any, stream: BinaryIO) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    from ssduck.adapters.columns import array_of

    if isinstance(value, RowsOfColumns):
        table = value.arrow().rename_columns(numbered_duplicates(value.columns))
    else:
        rows = display_table(value)
        if not rows.columns:
            raise ArgumentError("the rows are lists without names; Parquet needs named columns")
        columns = zip(*rows.rows, strict=True) if rows.rows else [()] * len(rows.columns)
        pairs = zip(rows.columns, columns, strict=True)
        table = pa.table({name: array_of(name, column) for name, column in pairs})
    pq.write_table(table, stream)


def png_of(value: Any) -> bytes | None:
    """Returns the picture that a value has, by IPython's protocol, as PNG; None if it has none."""
    return value._repr_png_() if hasattr(type(value), "_repr_png_") else None


def _png(value: Any, stream: BinaryIO) -> None:
    picture = png_of(value)
    if picture is None:
        raise ArgumentError(
            "this is no picture; AS image, mesh, points, graph and the grids are pictures"
        )
    stream.write(picture)


@dataclass(frozen=True)
class Format:
    """A format of files: it writes a value to a text stream, or to a binary one."""

    name: str
    write: Callable[[Any, Any], None]
    suffixes: tuple[str, ...]
    is_binary: bool = False

    def write_bytes(self, value: Any, stream: BinaryIO) -> None:
        """Writes a value to a binary stream, texts in UTF-8."""
        if self.is_binary:
            self.write(value, stream)
            return
        text = io.TextIOWrapper(stream, encoding="utf-8", newline="\n")
        self.write(value, text)
        text.detach()  # flushes, and leaves the stream open


FORMATS = {
    format.name: format
    for format in (
        Format("table", _table, (".txt",)),
        Format("csv", _csv, (".csv",)),
        Format("json", _json, (".json",)),
        Format("parquet", _parquet, (".parquet",), is_binary=True),
        Format("markdown", _markdown, (".md", ".markdown")),
        Format("png", _png, (".png",), is_binary=True),
    )
}


def format_of(path: Path) -> Format:
    """Returns the format of a file by its suffix."""
    by_suffix = {suffix: format for format in FORMATS.values() for suffix in format.suffixes}
    suffix = path.suffix.lower()
    message = f"{path}: the suffix {suffix!r} is of no format; known are {', '.join(by_suffix)}"
    check_known(suffix, by_suffix, message)
    return by_suffix[suffix]


def text_of(value: Any, format: Format) -> str:
    """Returns a value in a text format."""
    stream = io.StringIO()
    format.write(value, stream)
    return stream.getvalue()


def save(value: Any, path: Path, format: Format | None = None) -> Path:
    """Writes a value to a file and atomically replaces an existing file of that name."""
    replace_file(path, partial((format or format_of(path)).write_bytes, value))
    return path


class _Terminal(io.TextIOBase):
    """Standard output, with control characters escaped: names may come from strangers."""

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return sys.stdout.encoding

    def write(self, text: str) -> int:
        return sys.stdout.write(printable(text, kept="\n\t"))


def print_value(value: Any, format: Format, max_rows: int | None = None) -> None:
    """Writes a value to standard output."""
    if format.name != "table":
        is_terminal = sys.stdout.isatty()
        format.write(value, _Terminal() if is_terminal else sys.stdout)
    elif value is not None:
        print_table(readable_table(value, max_rows))
