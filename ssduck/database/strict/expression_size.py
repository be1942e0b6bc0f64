"""Measures regular expressions: as many letters as they have when repeats are written out."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

# A class of Unicode such as `\pL` has hundreds of ranges.
_UNICODE = 20
_TOKEN = re.compile(
    r"""
    \\Q(?P<quoted>.*?)(?:\\E|\Z)
    | (?P<unicode>\\[pP](?:\{[^}]*\}|.))
    | (?P<class>\[\^?\]?(?:\[:[^\]]*:\]|\\.|[^\]\\])*\])
    | (?P<open>\((?:\?(?:P?<[^>]*>|[a-zA-Z-]*:|(?=[a-zA-Z-]*\))))?)
    | (?P<close>\))
    | \{(?P<least>\d+)(?P<to>,(?P<most>\d*))?\}
    | (?P<any>[*+?])
    | (?P<letter>\\x\{[^}]*\}|\\.|.)
    """,
    re.VERBOSE | re.DOTALL,
)
_UNICODE_IN_CLASS = re.compile(r"\\[pP]")


class _Token(NamedTuple):
    """A part of an expression.

    Attributes:
        kind: open, close, repeat, any (of `*`, `+` and `?`), or part.
        size: its size; of a repeat, how often the part before is there at most.
    """

    kind: str
    size: int


def expression_size(text: str) -> int:
    """Returns the size of a regular expression as RE2 compiles it, in letters without repeats."""
    # The parts of each open group, innermost last.
    groups: list[list[int]] = [[]]
    for token in _tokens(text):
        if token.kind == "open":
            groups.append([])
        elif token.kind == "close" and len(groups) > 1:
            size = sum(groups.pop())
            groups[-1].append(size + token.size)
        elif token.kind == "repeat" and groups[-1]:
            groups[-1][-1] *= token.size
        elif token.kind == "any" and groups[-1]:
            groups[-1][-1] += token.size
        else:
            groups[-1].append(token.size)
    return sum(map(sum, groups))


def _tokens(text: str) -> Iterator[_Token]:
    for match in _TOKEN.finditer(text):
        kind = match.lastgroup
        if kind in ("open", "close"):
            yield _Token(kind, 2)
        elif match["least"] is not None:
            least, most = int(match["least"]), int(match["most"] or 0)
            is_open = match["to"] is not None and not match["most"]
            yield _Token("repeat", max(least + is_open, most, 1))
        elif kind == "any":
            yield _Token("any", 1)
        elif kind == "unicode":
            yield _Token("part", _UNICODE)
        elif kind == "class":
            yield _Token("part", 1 + _UNICODE * len(_UNICODE_IN_CLASS.findall(match["class"])))
        else:
            yield _Token("part", len(match["quoted"]) if kind == "quoted" else 1)
