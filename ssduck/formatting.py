"""Formats values and errors for messages: in one line, and shortened if long."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from itertools import islice
from reprlib import Repr
from typing import Any

from ssduck.errors import EvaluationError, SourceSpan, printable

# The largest numbers of elements and of characters of a value in a message.
MAX_SHOWN_ELEMENTS = 20
MAX_TEXT_LENGTH = 200
_MAX_KINDS = 5

# The largest number of names in a message.
MAX_NAMED = 50

# Words that never begin an expression of a program, so that no name can be one of them.
RESERVED_WORDS = frozenset(("OR", "XOR", "AND", "NOT", "IN", "FROM", "WHERE", "SELECT", "AS"))

_SHORT_REPR = Repr()
_SHORT_REPR.maxlist = _SHORT_REPR.maxtuple = _SHORT_REPR.maxdict = _SHORT_REPR.maxset = (
    MAX_SHOWN_ELEMENTS
)
_SHORT_REPR.maxstring = _SHORT_REPR.maxlong = _SHORT_REPR.maxother = 2 * MAX_TEXT_LENGTH


def name_path(world: str, *names: str) -> str:
    """Returns how a program names an entity, or a part of one.

    >>> name_path("lab", "arm", "tip"), name_path("lab", "duplo2x4/")
    ('lab.arm.tip', "lab['duplo2x4/']")
    """
    words = (*RESERVED_WORDS, "THIS")  # `lab.this.tip` asks for the tips of a column
    if all(name.isidentifier() and name.upper() not in words for name in (world, *names)):
        return ".".join((world, *names))
    return world + "".join(f"[{name!r}]" for name in names)


def past_path(world: str, name: str) -> str:
    """Returns how a program names an entity at an earlier time.

    >>> past_path("lab", "cup"), past_path("lab", "duplo2x4/")
    ('lab{…}.cup', "lab{…}['duplo2x4/']")
    """
    return f"{world}{{…}}{name_path(world, name).removeprefix(world)}"


def past_query(world: str, name: str, time: float | str) -> str:
    """Returns how a program asks about an entity at all ticks up to a time, s, or its name.

    >>> past_query("lab", "cup", 0.25)
    "SELECT greatest(z(this)) FROM lab{0.25} WHERE id(this) == 'cup' AS value"
    """
    shown = time if isinstance(time, str) else round(max(time, 0.0), 6)
    source = f"{world}{{{shown}}}"
    return f"SELECT greatest(z(this)) FROM {source} WHERE id(this) == {name!r} AS value"  # noqa: S608


def short_repr(value: Any) -> str:
    """Returns the `repr` of a value, shortened if it is long.

    >>> short_repr([1, 2.5, "cup"])
    "[1, 2.5, 'cup']"
    >>> short_repr(10 ** 5000)
    'a number of some 5000 digits'
    """
    try:
        return first_line(_SHORT_REPR.repr(value))
    except ValueError:  # Python refuses to format integers of thousands of digits
        if not isinstance(value, int):
            return type_in_words(value)
        sign = "negative " if value < 0 else ""
        return f"a {sign}number of some {int(value.bit_length() * math.log10(2))} digits"


def joined_names(names: Sequence[str], maximum: int = MAX_NAMED) -> str:
    """Returns names separated by commas, and the number of those left out.

    >>> joined_names(["cup", "fork", "plate"], maximum=2)
    'cup, fork and 1 more'
    """
    omitted = len(names) - maximum
    return ", ".join(names[:maximum]) + (f" and {omitted} more" if omitted > 0 else "")


def error_text(error: BaseException) -> str:
    """Returns the message of any error, shortened if it is long."""
    try:
        return first_line(str(error))
    except Exception:  # noqa: BLE001  # a user's class may do anything
        return "it gives no reason"


def first_sentence(text: str) -> str:
    """Returns the first sentence of a text.

    >>> first_sentence("Returns the mass. Unit: kg.")
    'Returns the mass.'
    """
    end = text.find(". ")
    return text if end < 0 else text[: end + 1]


def first_line(text: str) -> str:
    """Returns the first line of a text, shortened if it is long."""
    line = text.strip().partition("\n")[0]
    return line if len(line) <= MAX_TEXT_LENGTH else f"{line[:MAX_TEXT_LENGTH]}…"


def type_in_words(value: Any) -> str:
    """Returns the type of a value in words; a class may define its words as `IN_WORDS`.

    >>> type_in_words(2.5), type_in_words(None)
    ('a number', 'nothing')
    """
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
    default: str = getattr(kind, "IN_WORDS", kind.__name__)
    return words.get(kind, default)


def argument_in_words(value: Any) -> str:
    """Returns a refused argument in words: a plain value itself, or the types in a list.

    >>> argument_in_words([1, "cup"])
    'a list with a number, a text'
    """
    if isinstance(value, bool | int | float | str):
        return short_repr(value)
    if not isinstance(value, list | tuple):
        return type_in_words(value)
    if not value:
        return "an empty list"
    kinds = list(dict.fromkeys(map(type_in_words, islice(value, MAX_TEXT_LENGTH))))
    more = ", …" if len(kinds) > _MAX_KINDS else ""
    return f"a list with {', '.join(kinds[:_MAX_KINDS])}{more}"


def as_evaluation_error(error: Exception, span: SourceSpan | None) -> EvaluationError:
    """Returns an error that a Python value raised, such as an array without a truth value.

    The library of the value may raise errors of any class, with messages of any length.
    """
    return EvaluationError(f"{type(error).__name__}: {error_text(error)}", span=span)


_PLURALS = {"entity": "entities", "kinbody": "kinbodies"}


def count_of(number: int, noun: str) -> str:
    """Returns a number and a noun, in the plural unless the number is 1.

    >>> count_of(1, "entity"), count_of(2, "entity"), count_of(0, "row")
    ('1 entity', '2 entities', '0 rows')
    """
    return f"{number} {noun if number == 1 else _PLURALS.get(noun, noun + 's')}"


def contents_of(entities: Sequence[tuple[str, str]]) -> str:
    """Returns the numbers of entities, of all and of each kind, and the first names, for a `repr`.

    >>> contents_of([("fridge", "robot"), ("can", "kinbody"), ("cup", "kinbody")])
    '3 entities (1 robot, 2 kinbodies: fridge, can, cup)'
    """
    total = count_of(len(entities), "entity")
    if not entities:
        return total
    counts = Counter(kind for _, kind in entities)
    kinds = ", ".join(count_of(number, kind) for kind, number in counts.items())
    return f"{total} ({kinds}: {joined_names([printable(name) for name, _ in entities], 6)})"
