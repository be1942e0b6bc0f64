"""Tables that fit a terminal, whatever its width.

What is too wide is folded at spaces, as long as every column has room for its longest word. Else
it is elided, as DuckDB's box does: columns in the middle become a column of …, long texts end
with …, and a line below tells how many columns there are. Nothing is cut without such a mark.
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
# A column of texts is not made narrower than that, in cells of a terminal.
NARROWEST = 20


@dataclass(frozen=True)
class TextColumn:
    """A column of a table, as texts of one line each.

    Attributes:
        head: its name, and its type if that is known; empty in a table without a head.
        cells: a text for each row.
        numeric: whether these are numbers: they are aligned at the right, and not cut as long
            as there is room for them.
    """

    head: tuple[str, ...]
    cells: Sequence[str]
    numeric: bool

    @cached_property
    def natural(self) -> int:
        """The width at which nothing is folded or elided."""
        return max(map(_width, (*self.head, *self.cells)), default=0)

    @property
    def foldable(self) -> int:
        """The width down to which it may be folded: no word is broken."""
        texts = (*self.head, *self.cells)
        words = texts if self.numeric else {word for text in texts for word in text.split()}
        return max(min(self.natural, NARROWEST), max(map(_width, words), default=0))

    @property
    def elidable(self) -> int:
        """The width down to which it may be elided: numbers stay whole."""
        numbers = self.cells if self.numeric else ()
        return max(min(self.natural, NARROWEST), max(map(_width, numbers), default=0))


@dataclass(frozen=True)
class _Layout:
    """What is shown of a table.

    Attributes:
        columns: those that are shown, a column of marks in the place of those that are not.
        widths: of each.
        folds: whether cells are folded; else they are elided.
        omitted: how many columns are not shown.
    """

    columns: Sequence[TextColumn]
    widths: Sequence[int]
    folds: bool = False
    omitted: int = 0


class FittedTable:
    """A table as wide as a console of rich's, or as a number of cells.

    Args:
        columns: the columns; all have as many cells.
        note: what a line below tells of the rows; empty for nothing.
    """

    def __init__(self, columns: Sequence[TextColumn], note: str = "") -> None:
        self._columns = columns
        self._note = note

    def lines(self, width: int) -> list[str]:
        """The lines; none is wider than that."""
        head, below = self._parts(width)
        return [*head, *below]

    def __rich_console__(self, _: Console, options: ConsoleOptions) -> RenderResult:
        from rich.text import Text

        head, below = self._parts(options.max_width)
        for lines, style in ((head[:-1], "bold"), ([*head[-1:], *below], "")):
            if lines:
                yield Text("\n".join(lines), style=style, no_wrap=True, overflow="ignore")

    def __rich_measure__(self, _: Console, options: ConsoleOptions) -> Measurement:
        from rich.measure import Measurement

        widest = max(map(_width, self.lines(options.max_width)), default=0)
        return Measurement(widest, widest)

    def _parts(self, width: int) -> tuple[list[str], list[str]]:
        """The lines of the head, its rule the last one; and those below."""
        width = max(width, 1)
        layout = _layout(self._columns, width)
        names = zip(*(column.head for column in layout.columns), strict=True)
        head = [line for texts in names for line in _lines(layout, texts)]
        if head:
            head.append("─" * _total(layout.widths))
        rows = zip(*(column.cells for column in layout.columns), strict=True)
        below = [line for texts in rows for line in _lines(layout, texts)]
        return head, [*below, *self._notes(layout, width)]

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
    """A text that is not wider than so many cells of a terminal; … for what is left out."""
    if _width(text) <= width:
        return text
    kept, taken = [], _width(MARK)
    for letter in text:
        taken += _width(letter)
        if taken > width:
            break
        kept.append(letter)
    return "".join(kept) + MARK


def _width(text: str) -> int:
    """How many cells of a terminal a text takes."""
    return len(text) if text.isascii() else int(cell_len(text))


# -- how wide ---------------------------------------------------------------------------------


def _layout(columns: Sequence[TextColumn], width: int) -> _Layout:
    natural = [column.natural for column in columns]
    if _total(natural) <= width:
        return _Layout(columns, natural)
    foldable = [column.foldable for column in columns]
    if _total(foldable) <= width:
        return _Layout(columns, _spread(foldable, natural, width), folds=True)
    elidable = [column.elidable for column in columns]
    if _total(elidable) <= width:
        return _Layout(columns, _spread(elidable, natural, width))
    if len(columns) == 1:
        return _Layout(columns, [width])
    return _outermost(columns, natural, elidable, width)


def _outermost(
    columns: Sequence[TextColumn], natural: Sequence[int], elidable: Sequence[int], width: int
) -> _Layout:
    """As many columns from both sides as there is room for, beside a mark in the middle."""
    rows = len(columns[0].cells)
    mark = TextColumn((MARK,) * len(columns[0].head), [MARK] * rows, numeric=False)
    marked = width - len(GAP) - mark.natural
    if elidable[0] > marked:  # not even one
        if marked < 1:
            return _Layout(columns[:1], [width], omitted=len(columns) - 1)
        return _Layout([columns[0], mark], [marked, mark.natural], omitted=len(columns) - 1)
    left, right = 1, 0
    while True:
        more = (left, right + 1) if right < left else (left + 1, right)
        sides = [*elidable[: more[0]], *elidable[len(columns) - more[1] :]]
        if _total(sides) > marked:
            break
        left, right = more
    end = len(columns) - right
    chosen = [*columns[:left], *columns[end:]]
    widths = _spread([*elidable[:left], *elidable[end:]], [*natural[:left], *natural[end:]], marked)
    chosen.insert(left, mark)
    widths.insert(left, mark.natural)
    return _Layout(chosen, widths, omitted=end - left)


def _total(widths: Sequence[int]) -> int:
    """The width of columns beside each other."""
    return sum(widths) + len(GAP) * max(len(widths) - 1, 0)


def _spread(least: Sequence[int], natural: Sequence[int], width: int) -> list[int]:
    """Widths between the least and the natural ones that take all the room there is."""
    widths = list(least)
    room = width - _total(widths)
    while room and (narrow := [n for n, w in enumerate(widths) if w < natural[n]]):
        # The narrowest one grows first, so that the wide ones end up as wide as each other.
        chosen = min(narrow, key=widths.__getitem__)
        widths[chosen] += 1
        room -= 1
    return widths


# -- lines ------------------------------------------------------------------------------------


def _lines(layout: _Layout, texts: Sequence[str]) -> Iterator[str]:
    """The lines of a row: several if its cells are folded."""
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
    """A text in lines, folded at spaces; a word that is wider stays whole."""
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
