"""Finds string literals and comments in a program."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

_ENDS = {"'": "'", '"': '"', "/*": "*/", "//": "\n", "#": "\n", "--": "\n"}
_QUOTES = ("'", '"')


@dataclass(frozen=True)
class DelimitedText:
    """A text or a comment: its opening sign, its place, and whether it is closed."""

    opening: str
    start: int
    end: int
    is_closed: bool


def delimited(text: str) -> Iterator[DelimitedText]:
    """Yields the texts and comments of a program, in order."""
    index = 0
    while index < len(text):
        opening = next((o for o in _ENDS if text.startswith(o, index)), None)
        if opening is None or (opening == "--" and not _is_comment(text, index)):
            index += 1 if opening is None else len(opening)
            continue
        start, end = index, _ENDS[opening]
        index += len(opening)
        while index < len(text) and not (ends := text.startswith(end, index)):
            index += 2 if text[index] == "\\" and opening in _QUOTES else 1
            if opening in _QUOTES and text.startswith(end * 2, index):
                index += 2
        is_closed = end == "\n" or (index < len(text) and ends)
        index = min(len(text), index + (0 if end == "\n" else len(end)))
        yield DelimitedText(opening, start, index, is_closed)


def _is_comment(text: str, index: int) -> bool:
    """Checks whether two dashes begin a comment: before white space, or where the text ends."""
    return index + 2 >= len(text) or text[index + 2].isspace()


def without_dashes(text: str) -> str:
    """Returns the program with blanks in place of the comments that begin with two dashes.

    >>> without_dashes("SELECT z -- height")
    'SELECT z          '
    """
    if "--" not in text:
        return text
    parts, last = [], 0
    for part in delimited(text):
        if part.opening == "--":
            parts += [text[last : part.start], " " * (part.end - part.start)]
            last = part.end
    return "".join([*parts, text[last:]])


def last_opening(text: str) -> int:
    """Returns the start of the string literal or comment that is never closed."""
    return next((part.start for part in delimited(text) if not part.is_closed), 0)
