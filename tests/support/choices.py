"""Choices, types and scopes, of which random programs are made.

`Choices` are numbers that come from a `random.Random`, from hypothesis, or from a list. The
simplest choice is 0 everywhere, so that smaller numbers are smaller programs.
"""

from __future__ import annotations

import random
from dataclasses import dataclass
from typing import TypeVar

T = TypeVar("T")


# -- choices ------------------------------------------------------------------------------------


class Choices:
    """A source of choices: first the numbers of a list, then those of a function.

    Args:
        draw: returns a number below its argument.
        first: the first numbers.

    Attributes:
        taken: the numbers so far.
    """

    def __init__(self, draw, first=()):
        self._draw = draw
        self._first = first
        self.taken = []

    def below(self, bound):
        """Returns a number from 0 to below the bound."""
        index = len(self.taken)
        number = self._first[index] % bound if index < len(self._first) else self._draw(bound)
        self.taken.append(number)
        return number

    def pick(self, options):
        """Returns one of the options; the first is the simplest."""
        return options[self.below(len(options))]

    def chance(self, percent):
        """Returns True with a probability; False is simpler."""
        return self.below(100) >= 100 - percent


def seeded(seed):
    """Choices that a seed determines."""
    return Choices(random.Random(seed).randrange)  # noqa: S311  # a test's


# -- types --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Type:
    """The type of a value: a kind, and of a list its elements' or of a dict its keys'."""

    kind: str
    element: Type | None = None
    keys: tuple[tuple[str, Type], ...] = ()


INT, REAL, TEXT, FLAG, ENTITY = map(Type, ("int", "real", "text", "flag", "entity"))
NUMBER = Type("number")
SCALARS = (INT, REAL, TEXT, FLAG)


def list_of(element):
    """Returns the type of a list of at least two elements, where it is one of a list's elements."""
    return Type("list", element)


INTS, REALS, TEXTS = list_of(INT), list_of(REAL), list_of(TEXT)
RECORD = Type("dict", keys=(("k", INT), ("name", TEXT), ("r", REAL)))

# Variables that are there before a program runs, in both interpreters.
VARIABLES = {
    "n": (2, INT),
    "half": (0.5, REAL),
    "word": ("b", TEXT),
    "yes": (True, FLAG),
    "ints": ([3, 1, 2, 1], INTS),
    "words": (["b", "a", "ab"], TEXTS),
    "pairs": ([[1, 2], [2, 3], [3, 1]], list_of(INTS)),
    "records": (
        [
            {"k": 1, "name": "a", "r": 0.5},
            {"k": 2, "name": "b", "r": 1.5},
            {"k": 1, "name": "c", "r": -2.0},
        ],
        list_of(RECORD),
    ),
}
# Variables with a history, and how it comes about: of a second after another, what is assigned.
HISTORIES = (
    ("past{} = 3;", "trail{2.5} = 'a';"),
    ("past{} = 1;", "trail{2.5} = 'b';"),
    ("past{} = 2;", "trail{2.5} = 'ab';"),
)
AGED = (
    ("past", INT),
    ("past{1.5}", INT),
    ("past{}", INTS),
    ("past{-2.0}", INTS),
    ("trail{getTime() - 1}", TEXT),
    ("trail{}", TEXTS),
)
LITERALS = {
    "int": ("1", "0", "2", "3", "5", "(-1)", "(-2)", "7"),
    "real": ("0.5", "1.0", "2.0", "0.0", "1.5", "(-0.25)", "3.75", "0.1", "1e3"),
    "text": ("'a'", "'b'", "'ab'", "''", "'box'", "'cup'"),
    "flag": ("True", "False"),
    "entity": ("box",),
}
WILD = {
    "int": ("9223372036854775807", "4611686018427387904", "2147483647", "9007199254740993", "0"),
    "real": ("1e308", "1e-308", "9007199254740992.0", "0.0"),
}
COMPARISONS = ("==", "<", ">=", "!=", ">", "<=")
REAL_RELATIONS = (
    "z",
    "x",
    "y",
    "aabbVolume",
    "volume",
    "speed",
    "angularSpeed",
    "tilt",
    "openness",
)
FLAG_RELATIONS = ("isRobot", "isKinbody", "isSensor", "isOpen", "isClosed", "upright", "settled")
PAIR_RELATIONS = ("above", "within", "below", "isSensing")


def plain(value, whole):
    return value * 2 + whole


def scaled(value):
    return value * 0.5 - 1.0


def longer(left, right):
    return len(left) > len(right)


def bare(value):
    """Returns a user's function that gives back what it gets."""
    return value


def unhinted(value):  # type: ignore[no-untyped-def]
    """Returns a user's function without hints: of what it gets, twice."""
    return value + value


FUNCTIONS = (plain, scaled, longer, bare, unhinted)


# -- scopes -------------------------------------------------------------------------------------

Atoms = tuple[tuple[str, Type], ...]


@dataclass(frozen=True)
class Scope:
    """What an expression may mention.

    Attributes:
        outer: what aliased sources of the queries around give.
        own: what the sources of this query give.
        variables: what variables give.
    """

    outer: Atoms = ()
    own: Atoms = ()
    variables: Atoms = ()

    def of(self, wanted):
        """Returns the atoms of a type, those of this query first and twice."""
        own = [text for text, type_ in self.own if type_ == wanted]
        others = [text for text, type_ in (*self.outer, *self.variables) if type_ == wanted]
        return own + own + others


@dataclass(frozen=True)
class Source:
    """A source of a query: its alias, its text, the type of its elements."""

    alias: str | None
    text: str
    type: Type

    @property
    def written(self):
        """As it stands in FROM."""
        return self.text if self.alias is None else f"{self.alias}={self.text}"

    @property
    def this(self):
        """Its current element."""
        return "this" if self.alias is None else f"{self.alias}.this"


def reached(text, type_):
    """Yields a value and what can be reached in it by constant keys."""
    yield text, type_
    if type_.element is not None:
        for place in ("0", "1", "-1", "-2"):
            yield f"{text}[{place}]", type_.element
    for key, part in type_.keys:
        yield f"{text}['{key}']", part
