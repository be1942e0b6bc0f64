"""Fits text tables to the width of a terminal.

Cells that are too wide are folded at spaces, as long as every column has room for its longest
word. Otherwise they are elided, as in the tables of DuckDB's shell: a column of … replaces the
middle columns, long texts end with …, and a line below gives the number of columns. Every cut
bears this mark.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

from rich.cells import cell_len, set_cell_size

from ssduck.formatting import count_of

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderResult
    from rich.measure import Measurement

MARK = "…"
GAP = "   "
# The least widths to which a column of texts is elided and folded, in cells of a terminal.
NARROWEST = 20
_NARROWEST_FOLDED = 10


@dataclass(frozen=True)
class TextColumn:
    """A column of a table, as texts of one line each.

    Attributes:
        head: the name, and the type if it is known; empty in a table without a head.
        cells: a text for each row.
        numeric: whether the cells are numbers, which are aligned right and cut last.
    """

    head: tuple[str, ...]
    cells: Sequence[str]
    numeric: bool

    @cached_property
    def natural_width(self) -> int:
        """The width without folding and eliding."""
        return max(map(_width, (*self.head, *self.cells)), default=0)

    @property
    def min_folded_width(self) -> int:
        """The least width when folded: no word is broken."""
        texts = (*self.head, *self.cells)
        words = texts if self.numeric else {word for text in texts for word in text.split()}
        least = min(self.natural_width, _NARROWEST_FOLDED)
        return max(least, max(map(_width, words), default=0))

    @property
    def min_elided_width(self) -> int:
        """The least width when elided: numbers stay whole."""
        numbers = self.cells if self.numeric else ()
        return max(min(self.natural_width, NARROWEST), max(map(_width, numbers), default=0))


@dataclass(frozen=True)
class _Layout:
    """The visible columns of a table and their widths."""

    columns: Sequence[TextColumn]  # the visible columns
    widths: Sequence[int]  # the width of each column
    folds: bool = False  # whether wide cells are folded; otherwise they are elided
    omitted: int = 0  # the number of columns left out

    def lines(self, gap: str) -> tuple[list[str], list[str]]:
        """Returns the lines of the head and those of the rows."""
        heads = zip(*(column.head for column in self.columns), strict=True)
        rows = zip(*(column.cells for column in self.columns), strict=True)
        head, body = (
            [line for row in part for line in self._row(row, gap)] for part in (heads, rows)
        )
        return head, body

    def _row(self, texts: Sequence[str], gap: str) -> Iterator[str]:
        """Yields the lines of a row, several if cells are folded."""
        cells = [
            _folded(text, width) if self.folds else [elided(text, width)]
            for text, width in zip(texts, self.widths, strict=True)
        ]
        for parts in zip_longest(*cells, fillvalue=""):
            padded = []
            for part, width, column in zip(parts, self.widths, self.columns, strict=True):
                padding = " " * (width - _width(part))
                padded.append(padding + part if column.numeric else part + padding)
            yield gap.join(padded).rstrip()


class FittedTable:
    """A table that fits a rich console or a given width."""

    def __init__(self, columns: Sequence[TextColumn], note: str = "") -> None:
        self._columns = columns
        self._note = note

    def lines(self, width: int) -> list[str]:
        """Returns the lines, each at most `width` cells wide."""
        head, body = self._parts(width)
        return [*head, *body]

    def __rich_console__(self, _: Console, options: ConsoleOptions) -> RenderResult:
        from rich.text import Text

        head, body = self._parts(options.max_width)
        for lines, style in ((head[:-1], "bold"), ([*head[-1:], *body], "")):
            if lines:
                yield Text("\n".join(lines), style=style, no_wrap=True, overflow="ignore")

    def __rich_measure__(self, _: Console, options: ConsoleOptions) -> Measurement:
        from rich.measure import Measurement

        widest = max(map(_width, self.lines(options.max_width)), default=0)
        return Measurement(widest, widest)

    def plain_lines(self) -> list[str]:
        """Returns the lines at full width and without the note, for files and other programs."""
        layout = _Layout(self._columns, [column.natural_width for column in self._columns])
        head, body = layout.lines("  ")
        rule = ["  ".join("-" * width for width in layout.widths)] if head else []
        return [*head, *rule, *body]

    def _parts(self, width: int) -> tuple[list[str], list[str]]:
        """Returns the lines of the head, with its rule, and the lines below."""
        width = max(width, 1)
        layout = _layout(self._columns, width)
        head, body = layout.lines(GAP)
        rule = ["─" * _total(layout.widths)] if head else []
        return [*head, *rule], [*body, *self._notes(layout, width)]

    def _notes(self, layout: _Layout, width: int) -> list[str]:
        notes = [self._note] if self._note else []
        if layout.omitted:
            count = len(self._columns)
            notes = notes or [count_of(len(self._columns[0].cells), "row")]
            notes.append(f"{count} columns ({count - layout.omitted} shown)")
        joined = ", ".join(notes)
        if _width(joined) <= width:
            return [joined] if joined else []
        return [elided(line, width) for note in notes for line in _folded(note, width)]


def elided(text: str, width: int) -> str:
    """Returns a text of at most `width` cells of a terminal; … stands for the omitted end.

    >>> elided("microwave", 6)
    'micro…'
    """
    if _width(text) <= width:
        return text
    kept = set_cell_size(text, width - 1)  # a space is in place of half a wide letter
    return (kept if text.startswith(kept) else kept[:-1]) + MARK


def _width(text: str) -> int:
    """Returns the number of terminal cells that a text takes."""
    return len(text) if text.isascii() else int(cell_len(text))


# -- widths -----------------------------------------------------------------------------------


def _layout(columns: Sequence[TextColumn], width: int) -> _Layout:
    natural = [column.natural_width for column in columns]
    if _total(natural) <= width:
        return _Layout(columns, natural)
    min_folded = [column.min_folded_width for column in columns]
    if _total(min_folded) <= width:
        return _Layout(columns, _spread(min_folded, natural, width), folds=True)
    min_elided = [column.min_elided_width for column in columns]
    if _total(min_elided) <= width:
        return _Layout(columns, _spread(min_elided, natural, width))
    if len(columns) == 1:
        return _Layout(columns, [width])
    return _outermost(columns, natural, min_elided, width)


def _outermost(
    columns: Sequence[TextColumn], natural: Sequence[int], min_elided: Sequence[int], width: int
) -> _Layout:
    """Keeps as many columns on both sides as fit, with a column of marks between them."""
    room_beside_mark = width - len(GAP) - len(MARK)
    if room_beside_mark < 1:
        return _Layout(columns[:1], [width], omitted=len(columns) - 1)
    least = [min(min_elided[0], room_beside_mark), *min_elided[1:]]

    def kept(values: Sequence[Any], mark: Any, sides: tuple[int, int]) -> list[Any]:
        return [*values[: sides[0]], mark, *values[len(values) - sides[1] :]]

    left, right = 1, 0
    while left + right < len(columns) - 1:
        # A column of the shorter side is added first; if it is too wide, one of the other side.
        wider = [(left + 1, right), (left, right + 1)][:: -1 if right < left else 1]
        fitting = [sides for sides in wider if _total(kept(least, 1, sides)) <= width]
        if not fitting:
            break
        left, right = fitting[0]
    sides = left, right
    mark = TextColumn((MARK,) * len(columns[0].head), [MARK] * len(columns[0].cells), numeric=False)
    widths = _spread(kept(least, 1, sides), kept(natural, 1, sides), width)
    return _Layout(kept(columns, mark, sides), widths, omitted=len(columns) - left - right)


def _total(widths: Sequence[int]) -> int:
    """Returns the width of columns side by side."""
    return sum(widths) + len(GAP) * max(len(widths) - 1, 0)


def _spread(least: Sequence[int], natural: Sequence[int], width: int) -> list[int]:
    """Returns widths between the least and the natural ones that fill the available width."""
    widths = list(least)
    room = width - _total(widths)
    while room and (growable := [n for n, w in enumerate(widths) if w < natural[n]]):
        # Growing the narrowest column first makes the wide columns equal in the end.
        chosen = min(growable, key=widths.__getitem__)
        widths[chosen] += 1
        room -= 1
    return widths


def _folded(text: str, width: int) -> list[str]:
    """Returns the lines of a text folded at spaces; words wider than a line stay whole."""
    if _width(text) <= width:
        return [text]
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}" if lines[-1] else word
        if _width(longer) <= width:
            lines[-1] = longer
        elif lines[-1]:
            lines.append(word)
        else:
            lines[-1] = word
    return lines
