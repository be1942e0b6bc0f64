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
from typing import TYPE_CHECKING

from rich.cells import cell_len

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

    def _parts(self, width: int) -> tuple[list[str], list[str]]:
        """Returns the lines of the head, with its rule, and the lines below."""
        width = max(width, 1)
        layout = _layout(self._columns, width)
        names = zip(*(column.head for column in layout.columns), strict=True)
        head = [line for texts in names for line in _lines(layout, texts)]
        if head:
            head.append("─" * _total(layout.widths))
        rows = zip(*(column.cells for column in layout.columns), strict=True)
        body = [line for texts in rows for line in _lines(layout, texts)]
        return head, [*body, *self._notes(layout, width)]

    def _notes(self, layout: _Layout, width: int) -> list[str]:
        notes = [self._note] if self._note else []
        if layout.omitted:
            count, rows = len(self._columns), len(self._columns[0].cells)
            notes = notes or [f"{rows} row{'' if rows == 1 else 's'}"]
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
    letters, width_so_far = [], _width(MARK)
    for letter in text:
        width_so_far += _width(letter)
        if width_so_far > width:
            break
        letters.append(letter)
    return "".join(letters) + MARK


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
    rows = len(columns[0].cells)
    mark = TextColumn((MARK,) * len(columns[0].head), [MARK] * rows, numeric=False)
    room_beside_mark = width - len(GAP) - mark.natural_width
    if min_elided[0] > room_beside_mark:  # not even one column fits
        if room_beside_mark < 1:
            return _Layout(columns[:1], [width], omitted=len(columns) - 1)
        return _Layout(
            [columns[0], mark], [room_beside_mark, mark.natural_width], omitted=len(columns) - 1
        )
    left, right = 1, 0
    used = min_elided[0]
    # A column of the shorter side is added first; if it is too wide, one of the other side.
    while True:
        sides = (min_elided[left], min_elided[len(columns) - 1 - right])
        order = (1, 0) if right < left else (0, 1)
        fitting = [side for side in order if used + len(GAP) + sides[side] <= room_beside_mark]
        if not fitting or left + right == len(columns) - 1:
            break
        used += len(GAP) + sides[fitting[0]]
        left, right = (left, right + 1) if fitting[0] else (left + 1, right)
    end = len(columns) - right
    chosen = [*columns[:left], *columns[end:]]
    widths = _spread(
        [*min_elided[:left], *min_elided[end:]], [*natural[:left], *natural[end:]], room_beside_mark
    )
    chosen.insert(left, mark)
    widths.insert(left, mark.natural_width)
    return _Layout(chosen, widths, omitted=end - left)


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


# -- lines ------------------------------------------------------------------------------------


def _lines(layout: _Layout, texts: Sequence[str]) -> Iterator[str]:
    """Yields the lines of a row, several if cells are folded."""
    cells = [
        _folded(text, width) if layout.folds else [elided(text, width)]
        for text, width in zip(texts, layout.widths, strict=True)
    ]
    for parts in zip_longest(*cells, fillvalue=""):
        padded = [
            _padded(part, width, right=column.numeric)
            for part, width, column in zip(parts, layout.widths, layout.columns, strict=True)
        ]
        yield GAP.join(padded).rstrip()


def _padded(text: str, width: int, *, right: bool) -> str:
    padding = " " * (width - _width(text))
    return padding + text if right else text + padding


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
