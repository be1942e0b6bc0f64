"""Values and errors in the words of a message: one line each, and never long."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import islice
from reprlib import Repr
from typing import Any

from ssduck.errors import EvaluationError, SourceSpan

# So many keys and letters of what is wrong are told.
MOST_KEYS = 20
MOST_LETTERS = 200
_MOST_KINDS = 5

# So many names.
MOST_NAMED = 50

_SHORT = Repr()
_SHORT.maxlist = _SHORT.maxtuple = _SHORT.maxdict = _SHORT.maxset = MOST_KEYS
_SHORT.maxstring = _SHORT.maxlong = _SHORT.maxother = 2 * MOST_LETTERS


def short_repr(value: Any) -> str:
    """A value as it is written, if that is not too long."""
    try:
        return first_line(_SHORT.repr(value))
    except ValueError:  # Python writes no number of thousands of digits
        if not isinstance(value, int):
            return type_in_words(value)
        sign = "negative " if value < 0 else ""
        return f"a {sign}number of some {int(value.bit_length() * math.log10(2))} digits"


def joined_names(names: Sequence[str], most: int = MOST_NAMED) -> str:
    """Names, and how many more there are."""
    left = len(names) - most
    return ", ".join(names[:most]) + (f" and {left} more" if left > 0 else "")


def error_text(error: BaseException) -> str:
    """What an error of whatever kind says, if that is not too long."""
    try:
        return first_line(str(error))
    except Exception:  # noqa: BLE001  # a user's class may do anything
        return "it does not tell why"


def first_line(text: str) -> str:
    """The first line of a text, if that is not too long."""
    line = text.strip().partition("\n")[0]
    return line if len(line) <= MOST_LETTERS else f"{line[:MOST_LETTERS]}…"


def type_in_words(value: Any) -> str:
    """What a value is, in words: those of its class, `IN_WORDS`, if it has any."""
    if value is None:
        return "nothing"
    words = {
        bool: "True or False",
        int: "a number",
        float: "a number",
        str: "a text",
        list: "a list",
    }
    kind = type(value)
    own: str = getattr(kind, "IN_WORDS", kind.__name__)
    return words.get(kind, own)


def argument_in_words(value: Any) -> str:
    """A value as an argument that is refused: what it is, and of a list what is in it."""
    if isinstance(value, bool | int | float | str):
        return short_repr(value)
    if not isinstance(value, list | tuple):
        return type_in_words(value)
    if not value:
        return "an empty list"
    kinds = list(dict.fromkeys(map(type_in_words, islice(value, MOST_LETTERS))))
    more = ", …" if len(kinds) > _MOST_KINDS else ""
    return f"a list with {', '.join(kinds[:_MOST_KINDS])}{more}"


def as_evaluation_error(error: Exception, span: SourceSpan | None) -> EvaluationError:
    """Of values that Python brought in: an array that is neither true nor false, say.

    Their libraries have errors of their own, of whatever kind and length.
    """
    return EvaluationError(f"{type(error).__name__}: {error_text(error)}", span=span)
