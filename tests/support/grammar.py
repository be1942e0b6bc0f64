"""Random programs of the language, and the comparison of both evaluators on them.

`Program` is drawn from `Choices`: numbers that come from a `random.Random`, from hypothesis, or
from a list. The simplest choice is 0 everywhere, so that smaller numbers are smaller programs.
"""

from __future__ import annotations

import random
import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from hypothesis import strategies as st

import ssduck
from ssduck.simulators.scenes import find_scene

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

    def __init__(self, draw: Callable[[int], int], first: Sequence[int] = ()) -> None:
        self._draw = draw
        self._first = first
        self.taken: list[int] = []

    def below(self, bound: int) -> int:
        """Returns a number from 0 to below the bound."""
        index = len(self.taken)
        number = self._first[index] % bound if index < len(self._first) else self._draw(bound)
        self.taken.append(number)
        return number

    def pick(self, options: Sequence[T]) -> T:
        """Returns one of the options; the first is the simplest."""
        return options[self.below(len(options))]

    def chance(self, percent: int) -> bool:
        """Returns True with a probability; False is simpler."""
        return self.below(100) >= 100 - percent


def seeded(seed: int) -> Choices:
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


def list_of(element: Type) -> Type:
    """Returns the type of a list of at least two elements, where it is one of a list's elements."""
    return Type("list", element)


INTS, REALS, TEXTS = list_of(INT), list_of(REAL), list_of(TEXT)
RECORD = Type("dict", keys=(("k", INT), ("name", TEXT), ("r", REAL)))

# Variables that are there before a program runs, in both interpreters.
VARIABLES: dict[str, tuple[Any, Type]] = {
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
AGED: tuple[tuple[str, Type], ...] = (
    ("past", INT),
    ("past{1.5}", INT),
    ("past{}", INTS),
    ("past{-2.0}", INTS),
    ("trail{getTime() - 1}", TEXT),
    ("trail{}", TEXTS),
)
LITERALS: dict[str, tuple[str, ...]] = {
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
REAL_RELATIONS = ("z", "x", "y", "aabbVolume", "volume")
FLAG_RELATIONS = ("isRobot", "isKinbody", "isSensor", "isOpen", "isClosed")
PAIR_RELATIONS = ("above", "within", "below", "isSensing")


def plain(value: int, whole: int) -> int:
    """Returns a user's function with hints."""
    return value * 2 + whole


def scaled(value: float) -> float:
    """Returns a user's function with hints."""
    return value * 0.5 - 1.0


def longer(left: str, right: str) -> bool:
    """Returns a user's function with hints."""
    return len(left) > len(right)


def bare(value: Any) -> Any:
    """Returns a user's function that gives back what it gets."""
    return value


def unhinted(value):  # type: ignore[no-untyped-def]
    """Returns a user's function without hints: of what it gets, twice."""
    return value + value


FUNCTIONS: tuple[Callable[..., Any], ...] = (plain, scaled, longer, bare, unhinted)


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

    def of(self, wanted: Type) -> list[str]:
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
    def written(self) -> str:
        """As it stands in FROM."""
        return self.text if self.alias is None else f"{self.alias}={self.text}"

    @property
    def this(self) -> str:
        """Its current element."""
        return "this" if self.alias is None else f"{self.alias}.this"


def reached(text: str, type_: Type) -> Iterator[tuple[str, Type]]:
    """Yields a value and what can be reached in it by constant keys."""
    yield text, type_
    if type_.element is not None:
        for place in ("0", "1", "-1", "-2"):
            yield f"{text}[{place}]", type_.element
    for key, part in type_.keys:
        yield f"{text}['{key}']", part


# -- programs -----------------------------------------------------------------------------------


class Grammar:
    """Makes the text of a program of choices.

    Args:
        choices: what decides.
    """

    def __init__(self, choices: Choices) -> None:
        self.c = choices
        self.wild = choices.chance(20)
        self.joins = not self.wild or choices.chance(35)
        self.aliases = 0
        self.before: list[str] = []
        self.tally = choices.chance(5)
        self.worlds = 2
        self.size = choices.pick((1, 1, 2, 1))
        self.deepest = choices.pick((1, 1, 2, 1))

    # -- statements -------------------------------------------------------------------------

    def program(self) -> str:
        """Statements, the last of them a query or an expression."""
        variables = ((name, type_) for name, (_, type_) in VARIABLES.items())
        scope = Scope(variables=(*variables, *(AGED if self.c.chance(25) else ())))
        if self.c.chance(5):
            name, type_ = self.c.pick((("past", INT), ("trail", TEXT)))
            horizon = self.c.pick(("", "2.0", "0", "n"))
            value = self.expression(type_, scope, 2, 1)
            self.before.append(f"{name}{{{horizon}}} = {value}")
        kind = self.c.below(100)
        if kind < 62:
            last = self.query(scope, 0)
        elif kind < 75:
            last = self.hierarchy(scope, 0)
        elif kind < 85:
            last = self.deferred(scope)
        elif kind < 93:
            last = self.expression(self.c.pick((*SCALARS, INTS)), scope, 3, 1)
        else:
            last = self.stored(scope)
        if self.tally:
            self.before.insert(0, "tally = 0")
            last = f"[({last}), tally]"
        return " ".join(f"{statement};" for statement in (*self.before, last))

    def stored(self, scope: Scope) -> str:
        """Returns a query over the stored result of another query."""
        type_ = self.c.pick(SCALARS)
        self.before.append(f"found = {self.query(scope, 1, type_)}")
        alias = self.alias()
        source = Source(alias, "found", type_)
        return self.rest(scope, [source], 0, None)

    def deferred(self, scope: Scope) -> str:
        """Returns a list for the query that uses it, stored before that."""
        first, second = self.alias(), self.alias()
        lists = (list_of(INT), list_of(TEXT), list_of(REAL))
        type_ = self.c.pick(lists)
        element = type_.element
        assert element is not None
        names = (f"{first}.this", f"{second}.this")
        rows = [
            f"[{self.c.pick(names)}, {self.c.pick((*names, self.literal(element)))}]"
            for _ in range(1 + self.c.below(3))
        ]
        self.before.append(f"later = [{', '.join(rows)}]")
        atoms = tuple((name, element) for name in names)
        inner = replace(scope, outer=(*scope.outer, *atoms))
        self.worlds = 0
        name = self.alias()
        nested = self.rest(inner, [Source(name, "later", type_)], 1, self.c.pick((None, element)))
        condition = self.c.pick(
            (
                f"[] == {self.nested(nested)}",
                f"count({self.nested(nested)}) > {self.c.below(3)}",
                f"{names[0]} IN {self.nested(nested)}",
            )
        )
        sources = [Source(alias, self.list(element, scope), element) for alias in (first, second)]
        return self.rest(scope, sources, 0, None, where=condition)

    # -- queries ----------------------------------------------------------------------------

    def alias(self) -> str:
        """Returns a new name of a source; now and then a name that was used."""
        if self.aliases and self.c.chance(3):
            return "abcdefghijklmnopq"[self.c.below(min(self.aliases, 17))]
        self.aliases += 1
        return f"s{self.aliases}" if self.aliases > 17 else "abcdefghijklmnopq"[self.aliases - 1]

    def nested(self, text: str) -> str:
        """Returns a query in parentheses."""
        return f"({text})"

    def query(self, scope: Scope, depth: int, wanted: Type | None = None, form: str = "") -> str:
        """Returns a query; one with a column of a type, on request."""
        many = 1 + self.c.below(3 if depth == 0 else 2) if self.c.chance(45) else 1
        aliased = many > 1 or self.c.chance(60)
        sources = [self.source(scope, depth, aliased=aliased) for _ in range(many)]
        return self.rest(scope, sources, depth, wanted, form=form)

    def rest(
        self,
        scope: Scope,
        sources: list[Source],
        depth: int,
        wanted: Type | None,
        *,
        form: str = "",
        where: str = "",
    ) -> str:
        """Returns a query over these sources."""
        inner = self.inside(scope, sources)
        columns = self.columns(inner, sources, depth, wanted)
        distinct = "DISTINCT " if columns != ["*"] and self.c.chance(6) else ""
        parts = [
            f"SELECT {distinct}{', '.join(columns)} FROM {', '.join(s.written for s in sources)}"
        ]
        conditions = [where] if where else []
        if depth == 0 and self.tally and self.c.chance(70):
            conditions.append(self.counted(inner, depth + 1))
        if self.c.chance(60):
            conditions.append(self.expression(FLAG, inner, self.size, depth + 1))
            if self.joins and self.c.chance(25):
                conditions.append(self.expression(FLAG, inner, self.size, depth + 1))
        if conditions:
            parts.append(f"WHERE {' AND '.join(conditions)}")
        if depth == 0 and wanted is None and not distinct:
            if self.c.chance(12):
                parts.append(self.grouping(inner, sources))
            elif self.c.chance(10):
                return self.aggregated(parts, inner, sources)
        parts.extend(self.arranging(inner, sources))
        chosen: str = form or ("list" if wanted else self.c.pick(("list", "dict", "value", "list")))
        if chosen != "dict" or self.c.chance(30):
            parts.append(f"AS {self.c.pick((chosen, chosen, chosen.upper(), chosen.title()))}")
        return " ".join(parts)

    def aggregated(self, parts: list[str], inner: Scope, sources: list[Source]) -> str:
        """Returns a query of aggregates over the rows of its groups, or of all rows."""
        source = parts[0].split(" FROM ", 1)[1]
        found = [f"{self.aggregate(inner)} AS c{n}" for n in range(1 + self.c.below(2))]
        made = [f"SELECT count(*), {', '.join(found)} FROM {source}", *parts[1:]]
        if self.c.chance(60):
            made.append(self.grouping(inner, sources))
        elif self.c.chance(40):
            made.append(f"HAVING {self.aggregate(inner)} {self.c.pick(COMPARISONS)} 1")
        if self.c.chance(40):
            made.append(f"ORDER BY {self.aggregate(inner)}{self.c.pick(('', ' DESC'))}, count(*)")
        if self.c.chance(20):
            made.append(f"LIMIT {self.c.pick(('2', '1', '0'))}")
        return " ".join([*made, f"AS {self.c.pick(('list', 'dict', 'value'))}"])

    def aggregate(self, inner: Scope) -> str:
        """Returns a number of the rows of a group."""
        name = self.c.pick(("count", "sum", "min", "max", "avg"))
        over = self.expression(self.c.pick((INT, REAL)), inner, 1, 9)
        kinds = (f"{name}({over})", "count(*)", f"count(DISTINCT {over})", f"{name}(uniq({over}))")
        return f"{self.c.pick(kinds)}{self.c.pick(('', ' + 1', ' * 2'))}"

    def arranging(self, inner: Scope, sources: list[Source]) -> Iterator[str]:
        """ORDER BY and LIMIT."""
        if self.c.chance(30):
            keys = []
            for _ in range(1 + self.c.below(3)):
                names = self.names(sources, (INT, REAL, TEXT))
                if names and self.c.chance(30):
                    key = self.c.pick(names)
                else:
                    key = self.expression(self.c.pick((INT, REAL, TEXT)), inner, 1, 9)
                keys.append(key + self.c.pick(("", " DESC", " ASC", " DESCENDING")))
            yield f"ORDER BY {', '.join(keys)}"
        if self.c.chance(15):
            yield f"LIMIT {self.c.pick(('2', '1', '0', '5', 'n', 'n + 1', 'count(ints)'))}"

    def grouping(self, inner: Scope, sources: list[Source]) -> str:
        """GROUP BY, perhaps with HAVING."""
        keys = []
        for _ in range(1 + self.c.below(2)):
            names = self.names(sources, SCALARS)
            if names and self.c.chance(30):
                keys.append(self.c.pick(names))
            else:
                keys.append(self.expression(self.c.pick(SCALARS), inner, 1, 9))
        text = f"GROUP BY {', '.join(keys)}"
        if not self.c.chance(50):
            return text
        sign, bound = self.c.pick(COMPARISONS), self.literal(self.c.pick((INT, REAL)))
        return f"{text} HAVING {self.aggregate(inner)} {sign} {bound}"

    def inside(self, scope: Scope, sources: list[Source]) -> Scope:
        """Returns the scope of a query's parts: its own sources, and the outer ones by alias."""
        outer = tuple(
            (text, type_)
            for text, type_ in (*scope.outer, *scope.own)
            if not text.startswith("this") and text not in ("level", "state")
        )
        taken = tuple(f"{source.this}" for source in sources)
        outer = tuple(entry for entry in outer if not entry[0].startswith(taken))
        own = [atom for source in sources for atom in reached(source.this, source.type)]
        return Scope(outer, tuple(own), scope.variables)

    def names(self, sources: list[Source], types: Sequence[Type]) -> list[str]:
        """Bare names that mean something of the only source."""
        if len(sources) != 1:
            return []
        type_ = sources[0].type
        if type_ == ENTITY:
            known = (("id", TEXT), ("z", REAL), ("environmentID", INT), ("isRobot", FLAG))
            return [name for name, of in known if of in types]
        return [name for name, of in type_.keys if of in types]

    def columns(
        self, inner: Scope, sources: list[Source], depth: int, wanted: Type | None
    ) -> list[str]:
        """What is selected."""
        if wanted is not None:
            return [self.expression(wanted, inner, self.size, depth + 1)]
        if self.c.chance(5):
            return ["*"]
        found: list[str] = []
        for number in range(self.c.pick((1, 1, 2, 3))):
            names = [name for name in self.names(sources, SCALARS) if name not in found]
            if names and self.c.chance(40):
                found.append(self.c.pick(names))
                continue
            types = [*SCALARS, *{t for _, t in inner.own if t.kind != "dict"}]
            types.sort(key=repr)
            value = self.expression(self.c.pick(types), inner, self.size, depth + 1)
            found.append(f"to({value}, 'c{number}')")
        return found

    def source(self, scope: Scope, depth: int, *, aliased: bool) -> Source:
        """Returns a source of a query."""
        alias = self.alias() if aliased else None
        kind = self.c.below(100)
        if kind < 38:
            type_ = self.c.pick((INT, REAL, TEXT, FLAG, INT, NUMBER))
            return Source(alias, self.list(type_, scope), INT if type_ == NUMBER else type_)
        if kind < 62 and self.worlds > 0:
            self.worlds -= 1
            return Source(alias, "w", ENTITY)
        if kind < 70:
            element = self.c.pick((INT, TEXT, REAL))
            rows = [self.pair(element, scope) for _ in range(1 + self.c.below(3))]
            return Source(alias, f"[{', '.join(rows)}]", list_of(element))
        if kind < 76:
            return Source(alias, "records", RECORD)
        if kind < 84 or depth >= self.deepest:
            lists = (("ints", INT), ("words", TEXT), ("pairs", INTS))
            aged = (("past{}", INT), ("trail{-2.0}", TEXT), ("past{n}", INT))
            name, type_ = self.c.pick(lists if self.c.chance(75) else aged)
            return Source(alias, name, type_)
        if kind < 96:
            type_ = self.c.pick((*SCALARS, ENTITY if self.worlds > 0 else INT))
            return Source(alias, self.nested(self.query(scope, depth + 1, type_, "list")), type_)
        if kind < 98:
            return Source(alias, *self.records(scope, depth))
        type_ = self.c.pick(SCALARS)
        return Source(alias, self.literal(type_), type_)

    def records(self, scope: Scope, depth: int) -> tuple[str, Type]:
        """Returns a nested query AS dict, as a source."""
        source = self.source(scope, 2, aliased=True)
        inner = self.inside(scope, [source])
        keys = (("k", INT), ("name", TEXT))
        columns = [f"to({self.expression(t, inner, 1, depth + 1)}, '{key}')" for key, t in keys]
        text = f"(SELECT {', '.join(columns)} FROM {source.written} AS dict)"
        return text, Type("dict", keys=keys)

    def list(self, element: Type, scope: Scope) -> str:
        """Returns a list that is written out; of numbers of both kinds, if that is what it is of."""
        values = []
        for _ in range(self.c.below(5)):
            type_ = self.c.pick((INT, REAL)) if element == NUMBER else element
            atoms = [text for text, of in scope.outer if of == type_]
            if atoms and self.c.chance(40):
                values.append(self.c.pick(atoms))
            else:
                values.append(self.literal(type_))
        return f"[{', '.join(values)}]"

    def pair(self, element: Type, scope: Scope) -> str:
        """Returns a list of two or three values."""
        atoms = [text for text, of in scope.outer if of == element]
        values = [
            self.c.pick(atoms) if atoms and self.c.chance(40) else self.literal(element)
            for _ in range(2 + self.c.below(2))
        ]
        return f"[{', '.join(values)}]"

    # -- hierarchies ------------------------------------------------------------------------

    def hierarchy(self, scope: Scope, depth: int) -> str:
        """Returns a hierarchical query that a level bounds."""
        type_ = self.c.pick((INT, TEXT, INTS, REAL))
        aliased = self.c.chance(60)
        if self.c.chance(25):
            source = Source(self.alias() if aliased else None, "w", ENTITY)
        elif self.c.chance(40):
            source = Source(self.alias() if aliased else None, "pairs", INTS)
        else:
            element = self.c.pick((INT, TEXT, REAL))
            source = Source(self.alias() if aliased else None, self.list(element, scope), element)
        self.worlds = 0
        inner = self.inside(scope, [source])
        inner = replace(inner, own=(*inner.own, ("level", INT), ("state", type_), ("state", type_)))
        columns = self.columns(inner, [source], 8, None)
        if columns == ["*"]:
            columns = ["level"]
        parts = [f"SELECT {', '.join(columns)} FROM {source.written}"]
        if self.c.chance(60):
            parts.append(f"WHERE {self.expression(FLAG, inner, self.size, depth + 2)}")
        start = self.expression(type_, replace(inner, own=()), 1, 9)
        parts.append(f"START WITH level = 0, state = {start}")
        kind = self.c.pick(
            ("", "NO CYCLE", "UNIQUE", "MEMORIZE 3", "MEMORIZE 2", "NO CYCLE UNIQUE")
        )
        most = self.c.pick(("", "", "MAXIMUM 2", "MAXIMUM 1"))
        step = self.expression(type_, inner, 1, depth + 2)
        words = " ".join(filter(None, ("CONNECT BY", kind, most)))
        parts.append(f"{words} level = level + 1, state = {step}")
        stop = f"level >= {1 + self.c.below(2)}"
        if self.c.chance(35):
            stop = f"{stop} OR {self.expression(FLAG, inner, 1, depth + 2)}"
        parts.append(f"STOP WITH {stop}")
        if self.c.chance(10):
            parts.append(self.grouping(inner, [source]))
        if self.c.chance(30):
            parts.extend(self.arranging(inner, [source]))
        parts.append(f"AS {self.c.pick(('list', 'dict', 'value'))}")
        return " ".join(parts)

    # -- expressions ------------------------------------------------------------------------

    def literal(self, type_: Type) -> str:
        """Returns a constant of a type."""
        if self.wild and type_.kind in WILD and self.c.chance(15):
            return self.c.pick(WILD[type_.kind])
        return self.c.pick(LITERALS[type_.kind])

    def expression(self, type_: Type, scope: Scope, size: int, depth: int) -> str:
        """Returns an expression of a type; seldom of another one, if errors are allowed."""
        if self.wild and self.c.chance(4):
            type_ = self.c.pick((INT, TEXT, REAL, INTS, FLAG))
        if size <= 0 or not self.c.chance(95 if type_ == FLAG else 62):
            return self.atom(type_, scope)
        makers: dict[str, Callable[[Scope, int, int], str]] = {
            "int": self.integer,
            "real": self.real,
            "text": self.text,
            "flag": self.flag,
        }
        if type_.kind in makers and self.c.chance(1):
            return f"({self.chain(type_, scope)})"
        if type_.kind in makers:
            return f"({makers[type_.kind](scope, size - 1, depth)})"
        return self.atom(type_, scope) if type_.kind != "list" else self.listed(type_, scope, size)

    def atom(self, type_: Type, scope: Scope) -> str:
        """Returns a literal, a variable, or what an element gives."""
        atoms = scope.of(type_)
        if atoms and not self.c.chance(30):
            return self.c.pick(atoms)
        entities = [text for text, of in scope.own if of == ENTITY]
        if entities and self.c.chance(60):
            this = self.c.pick(entities)
            if type_ == REAL:
                return f"{self.c.pick(REAL_RELATIONS)}({this})"
            if type_ == TEXT:
                return f"{self.c.pick(('id', 'type'))}({this})"
            if type_ == FLAG:
                return f"{self.c.pick(FLAG_RELATIONS)}({this})"
            if type_ == INT:
                return f"environmentID({this})"
        if type_.kind in LITERALS:
            return self.literal(type_)
        if type_.element is not None and type_.element.kind in LITERALS:
            return self.pair(type_.element, scope)
        return atoms[0] if atoms else "[[1, 2], [3, 4]]"

    def listed(self, type_: Type, scope: Scope, size: int) -> str:
        """Returns a list of at least two elements."""
        element = type_.element
        if element is None or element.kind not in LITERALS:
            return self.atom(type_, scope)
        kind = self.c.below(6)
        parts = [self.expression(element, scope, size - 1, 9) for _ in range(2)]
        if kind == 0:
            return f"({self.atom(type_, scope)} + [{parts[0]}])"
        if kind == 1:
            condition = self.expression(FLAG, scope, size - 1, 9)
            return f"IF({condition}; {self.atom(type_, scope)}; {self.atom(type_, scope)})"
        if kind == 2 and element == REAL:
            entities = scope.of(ENTITY)
            if entities:
                return f"position({self.c.pick(entities)})"
        return f"[{', '.join(parts)}]"

    def choice(self, type_: Type, scope: Scope, size: int, depth: int) -> str:
        """IF with branches of a type, perhaps one after another; of flags some may be missing."""
        condition = self.expression(FLAG, scope, size, depth)
        if type_ == FLAG and self.c.chance(20):
            return f"IF({condition})"
        then, other = (self.expression(type_, scope, size, depth) for _ in range(2))
        if self.c.chance(30):
            return f"CASE WHEN {condition} THEN {then} ELSE {other} END"
        if self.c.chance(20):
            one, two = (self.expression(TEXT, scope, 0, depth) for _ in range(2))
            return f"CASE {one} WHEN {two} THEN {then} ELSE {other} END"
        if type_ == FLAG and self.c.chance(20):
            return f"IF({condition}; {then})"
        if self.c.chance(20):
            further = self.expression(FLAG, scope, size, depth)
            other = f"IF({further}; {other}; {self.atom(type_, scope)})"
        return f"IF({condition}; {then}; {other})"

    def chain(self, type_: Type, scope: Scope) -> str:
        """Returns about as many operands in a row as are kept flat."""
        signs = {"int": ("+", "-"), "real": ("+", "-", "*"), "text": ("+",)}
        parts = [self.atom(type_, scope) for _ in range(2)]
        many = self.c.pick((31, 32, 33, 40))
        if type_ == FLAG:
            return f" {self.c.pick(('OR', 'AND', 'XOR'))} ".join((parts * many)[:many])
        sign = self.c.pick(signs[type_.kind])
        return f" {sign} ".join((parts * many)[:many])

    def counted(self, scope: Scope, depth: int) -> str:
        """Returns a condition that counts where it holds, or how often it is asked."""
        condition = self.expression(FLAG, scope, 1, depth)
        if self.c.chance(50):
            return f"IF({condition}; tally = tally + 1, True; False)"
        return f"((tally = tally + 1) > {self.c.below(4)} AND {condition})"

    def divisor(self, type_: Type, scope: Scope, size: int) -> str:
        """Returns a divisor that is not 0, unless errors are allowed."""
        if self.wild and self.c.chance(60):
            return self.expression(type_, scope, size, 9)
        if type_ == INT:
            return self.c.pick(("2", "3", "(-2)", "7"))
        return self.c.pick(("0.5", "2.0", "(-3.5)", "0.1"))

    def integer(self, scope: Scope, size: int, depth: int) -> str:
        """Returns an integer."""
        one = self.expression(INT, scope, size, depth)
        match self.c.below(18):
            case 0 | 1 | 2 | 3:
                other = self.expression(INT, scope, size, depth)
                return f"{one} {self.c.pick(('+', '-', '*'))} {other}"
            case 4:
                divisor = self.divisor(INT, scope, size)
                return self.c.pick((f"{one} % {divisor}", f"mod({one}, {divisor})"))
            case 5:
                return f"{one} ^ {self.c.pick(('2', '0', '3', '1'))}"
            case 6:
                return self.c.pick((f"-{one}", f"neg({one})", f"sub(1, {one})", f"mul(2, {one})"))
            case 7:
                return f"abs({one})"
            case 8:
                real = self.expression(REAL, scope, size, depth)
                return f"{self.c.pick(('floor', 'ceil', 'round'))}({real})"
            case 9:
                return f"plain({one}, {self.atom(INT, scope)})"
            case 10:
                return f"{self.c.pick(('bare', 'unhinted'))}({one})"
            case 11:
                return self.choice(INT, scope, size, depth)
            case 12:
                values = self.expression(INTS, scope, size, depth)
                return f"{self.c.pick(('sum', 'min', 'max', 'count'))}({values})"
            case 13:
                return self.indexed(INT, scope, size)
            case 14:
                return f"past{{{one if self.wild else f'abs({one})'}}}"
        if depth > self.deepest:
            return one
        return self.of_query(INT, scope, depth)

    def of_query(self, type_: Type, scope: Scope, depth: int) -> str:
        """Returns a value of a nested query."""
        kind = self.c.below(3)
        if type_ in (INT, REAL) and kind < 2:
            query = self.nested(self.query(scope, depth, type_, "list"))
            if type_ == INT and kind == 0:
                return f"count({query})"
            names = ("sum", "min", "max") if self.wild else ("sum",)
            return f"{self.c.pick(names)}({query})"
        if self.wild or self.c.chance(30):
            return self.nested(self.query(scope, depth, type_, "value"))
        # A value that is there.
        source = Source(self.alias(), "ints", INT)
        inner = self.inside(scope, [source])
        column = self.expression(type_, inner, 1, 9)
        order = " ".join(self.arranging(inner, [source])).split("LIMIT")[0].strip()
        return f"(SELECT {column} FROM {source.written} {order} AS value)"

    def indexed(self, type_: Type, scope: Scope, size: int) -> str:
        """Returns an element of a list."""
        values = self.expression(list_of(type_), scope, size, 9)
        if self.wild and self.c.chance(50):
            return f"{values}[{self.expression(INT, scope, size, 9)}]"
        return f"{values}[{self.c.pick(('0', '1', '-1', '-2'))}]"

    def real(self, scope: Scope, size: int, depth: int) -> str:
        """Returns a real number."""
        one = self.expression(REAL, scope, size, depth)
        match self.c.below(17):
            case 0 | 1 | 2:
                type_ = self.c.pick((REAL, INT))
                other = self.expression(type_, scope, size, depth)
                return f"{one} {self.c.pick(('+', '-', '*'))} {other}"
            case 3 | 4:
                type_ = self.c.pick((REAL, INT))
                return f"{self.expression(type_, scope, size, depth)} / {self.divisor(REAL, scope, size)}"
            case 5:
                return f"{one} % {self.divisor(self.c.pick((REAL, INT)), scope, size)}"
            case 6:
                return f"{one} ^ {self.c.pick(('2', '0', '3', '1'))}"
            case 7:
                return f"-{one}"
            case 8:
                return f"abs({one})" if self.c.chance(50) else f"sqrt(abs({one}))"
            case 9:
                return f"scaled({one})"
            case 10:
                return f"{self.c.pick(('bare', 'unhinted'))}({one})"
            case 11:
                return self.choice(REAL, scope, size, depth)
            case 12:
                values = self.expression(REALS, scope, size, depth)
                return f"{self.c.pick(('sum', 'min', 'max', 'avg'))}({values})"
            case 13:
                return self.indexed(REAL, scope, size)
            case 14:
                entities = scope.of(ENTITY)
                if entities:
                    return f"distance({self.c.pick(entities)}, {self.c.pick(entities)})"
                return f"round({one}, {self.c.below(3)})"
        return one if depth > self.deepest else self.of_query(REAL, scope, depth)

    def text(self, scope: Scope, size: int, depth: int) -> str:
        """Returns a text."""
        one = self.expression(TEXT, scope, size, depth)
        match self.c.below(9):
            case 0 | 1:
                return f"{one} + {self.expression(TEXT, scope, size, depth)}"
            case 2 | 3:
                return f"str({self.expression(self.c.pick(SCALARS), scope, size, depth)})"
            case 4:
                return self.choice(TEXT, scope, size, depth)
            case 5:
                return f"{self.c.pick(('bare', 'unhinted'))}({one})"
            case 6:
                return self.indexed(TEXT, scope, size)
            case 7:
                return f"trail{{1 + abs({self.expression(INT, scope, size, depth)})}}"
        return one if depth > self.deepest else self.of_query(TEXT, scope, depth)

    def flag(self, scope: Scope, size: int, depth: int) -> str:
        """Returns a condition."""
        entities = scope.of(ENTITY)
        kind = self.c.below(25)
        if kind >= 22:
            return self.habit(scope, size, kind)
        if kind < 6 or (kind in (20, 21) and not entities):
            return self.comparison(scope, size, depth)
        if kind < 9:
            left, right = (self.expression(FLAG, scope, size, depth) for _ in range(2))
            signs = ("OR", "XOR", "AND") if self.joins else ("OR", "XOR")
            return f"{left} {self.c.pick(signs)} {right}"
        if kind == 9:
            return f"NOT {self.expression(FLAG, scope, size, depth)}"
        if kind < 12:
            return self.membership(scope, size, depth)
        if kind == 12:
            return self.choice(FLAG, scope, size, depth)
        if kind == 13:
            left, right = (self.expression(TEXT, scope, size, 9) for _ in range(2))
            return f"longer({left}, {right})"
        if kind == 14:
            return f"bare({self.expression(FLAG, scope, size, depth)})"
        if kind < 20:
            return self.of_rows(scope, size, depth)
        names = (self.c.pick(entities), self.c.pick((*entities, "box")))
        return f"{self.c.pick(PAIR_RELATIONS)}({names[0]}, {names[1]})"

    def habit(self, scope: Scope, size: int, kind: int) -> str:
        """Returns a condition as SQL has it."""
        negated = self.c.pick(("", "NOT "))
        if kind == 22:
            one = self.expression(TEXT, scope, size, 9)
            pattern = self.c.pick(("'%'", "'a%'", "'_'", "'%b%'", "'a_'", "''", "'box'"))
            return f"{one} {negated}LIKE {pattern}"
        type_ = self.c.pick((INT, REAL))
        one = self.expression(type_, scope, size, 9)
        if kind == 23:
            low, high = (self.expression(type_, scope, 0, 9) for _ in range(2))
            return f"({one} {negated}BETWEEN {low} AND {high})"
        if self.c.chance(40):
            return f"{one} IS {negated}NULL"
        values = ", ".join(self.literal(type_) for _ in range(self.c.below(4)))
        return f"{one} {negated}IN ({values})"

    def comparison(self, scope: Scope, size: int, depth: int) -> str:
        """Two values of like types, compared."""
        type_ = self.c.pick((INT, REAL, TEXT, INTS, FLAG, ENTITY))
        if type_ == ENTITY:
            entities = scope.of(ENTITY)
            if entities:
                return f"{self.c.pick(entities)} {self.c.pick(('==', '!='))} box"
            type_ = INT
        other = self.c.pick((INT, REAL)) if type_ in (INT, REAL) else type_
        if self.c.chance(4):
            other = self.c.pick(SCALARS)
        left = self.expression(type_, scope, size, depth)
        right = self.expression(other, scope, size, depth)
        both = {type_, other}
        ordered = both <= {INT, REAL} or both == {TEXT}
        signs = COMPARISONS if ordered or (self.wild and self.c.chance(30)) else ("==", "!=")
        return f"{left} {self.c.pick(signs)} {right}"

    def membership(self, scope: Scope, size: int, depth: int) -> str:
        """IN a list, a text, a query."""
        type_ = self.c.pick((INT, TEXT, REAL))
        left = self.expression(type_, scope, size, depth)
        if type_ == TEXT and self.c.chance(40):
            return f"{left} IN {self.expression(TEXT, scope, size, depth)}"
        if depth <= self.deepest and self.c.chance(50):
            return f"{left} IN {self.nested(self.query(scope, depth, type_, 'list'))}"
        if self.c.chance(15):
            type_ = self.c.pick((INT, TEXT, REAL))
        return f"{left} IN {self.expression(list_of(type_), scope, size, depth)}"

    def of_rows(self, scope: Scope, size: int, depth: int) -> str:
        """Returns a question about the rows of a nested query."""
        if depth > self.deepest:
            return self.comparison(scope, size, depth)
        type_ = self.c.pick((INT, TEXT, REAL))
        form = self.c.pick(("list", "list", "dict", "value"))
        query = self.nested(self.query(scope, depth, type_, form))
        kind = self.c.below(4)
        if kind < 2:
            sides = ("[]", query) if self.c.chance(50) else (query, "[]")
            return f"{sides[0]} {self.c.pick(('==', '!='))} {sides[1]}"
        query = self.nested(self.query(scope, depth, type_, "list"))
        if kind == 2:
            sign = self.c.pick(COMPARISONS)
            return f"count({query}) {sign} {self.c.pick(('1', '0', '2', 'n'))}"
        return f"{self.pair(type_, scope)} == {query}"


def program(choices: Choices) -> str:
    """Returns the text of a program."""
    return Grammar(choices).program()


@cache
def _below(bound: int) -> st.SearchStrategy[int]:
    return st.integers(0, bound - 1)


@st.composite
def programs(draw: st.DrawFn) -> str:
    """Programs, for hypothesis."""
    return program(Choices(lambda bound: draw(_below(bound))))


# -- the world that they run on -----------------------------------------------------------------

_BOX = """<robot name="{name}"><link name="base"><inertial><mass value="1"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><box size="{size}"/></geometry></collision></link></robot>"""
# name, kind, size, position
_BODIES = (
    ("table", "kinbody", "2 2 0.5", (0.0, 0.0, 0.25)),
    ("box", "kinbody", "0.5 0.5 0.5", (0.25, 0.0, 0.75)),
    ("cup", "kinbody", "0.125 0.125 0.25", (0.25, 0.0, 0.75)),
    ("lamp", "kinbody", "0.1 0.1 0.7", (-0.5, 0.5, 1.3)),
    ("arm", "robot", "0.25 0.25 1", (3.0, 0.0, 0.5)),
)


def small_world(folder: Path) -> ssduck.World:
    """Five boxes and a sensor."""
    lines = ['name = "w"']
    for name, kind, size, place in _BODIES:
        (folder / f"{name}.urdf").write_text(_BOX.format(name=name, size=size), encoding="utf-8")
        lines.append(f'[[body]]\nname = "{name}"\nkind = "{kind}"\nurdf = "{name}.urdf"')
        lines.append(f"fixed = true\nposition = {list(place)}")
    eye = '[[sensor]]\nname = "eye"\ntype = "planar_laser"\non = "arm"\nmax_range = 4.0\n'
    lines.append(eye + "min_angle = 90\nmax_angle = 270\nresolution = 2")
    scene = folder / "scene.toml"
    scene.write_text("\n".join(lines), encoding="utf-8")
    return ssduck.World.load(find_scene(scene))


# -- both evaluators ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """What running a program came to: a value, or an error."""

    value: Any = None
    error: BaseException | None = None

    def __str__(self) -> str:
        if self.error is None:
            return repr(self.value)
        first = str(self.error).splitlines()[:1]
        return f"{type(self.error).__name__}: {''.join(first)}"

    @property
    def is_crash(self) -> bool:
        """Whether it is an error that is none of the language's."""
        return self.error is not None and not isinstance(self.error, ssduck.SelectScriptError)


class Evaluators:
    """Two interpreters with the same world, variables and functions.

    Args:
        world: the world.
    """

    def __init__(self, world: ssduck.World) -> None:
        self.world = world
        self.sql = ssduck.Interpreter()
        self.rows = ssduck.Interpreter(row_by_row=True)
        for interpreter in (self.sql, self.rows):
            interpreter.add_variable("w", world)
            for function in FUNCTIONS:
                interpreter.add_function(function.__name__, function)
        for assignments in HISTORIES:
            for interpreter in (self.sql, self.rows):
                interpreter.eval(" ".join(assignments))
            world.step(240)
        self._histories = {
            interpreter: {name: interpreter._variables[name] for name in ("past", "trail")}
            for interpreter in (self.sql, self.rows)
        }

    def refresh(self, interpreter: ssduck.Interpreter) -> None:
        """Make the variables what they were before any program ran."""
        interpreter.eval("clear();")
        for name, (value, _) in VARIABLES.items():
            interpreter.add_variable(name, value)
        interpreter._variables.update(self._histories[interpreter])
        interpreter.add_variable("box", self.world["box"])

    def outcome(self, interpreter: ssduck.Interpreter, text: str) -> Outcome:
        """What a program comes to; the variables are fresh."""
        self.refresh(interpreter)
        try:
            return Outcome(interpreter.eval(text))
        except Exception as error:  # noqa: BLE001  # whatever it is, it is compared
            return Outcome(error=error)

    def disagreement(self, text: str) -> str | None:
        """How the two differ on a program; None if they agree."""
        rows, sql = self.outcome(self.rows, text), self.outcome(self.sql, text)
        if agree(rows, sql, text):
            return None
        return f"{text}\n    row by row: {rows}\n    SQL: {sql}"

    def is_all_sql(self, text: str) -> bool:
        """Checks whether nothing of a program's queries is left to Python."""
        self.refresh(self.sql)
        try:
            plan = self.sql.explain(text)
        except ssduck.SelectScriptError:
            return False
        return "SELECT" in plan and "-- left to Python" not in plan and "-- row by row" not in plan

    def close(self) -> None:
        """Close both."""
        self.sql.close()
        self.rows.close()


@contextmanager
def evaluators() -> Iterator[Evaluators]:
    """Both evaluators on a small world; lists are sources of SQL, however short."""
    from ssduck.interpreter import query_runner as queries

    with ExitStack() as stack:
        stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("error")  # DuckDB refuses what was written, say
        warnings.simplefilter("ignore", ssduck.ProgramWarning)
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        few = queries.FEW_ROWS
        stack.callback(setattr, queries, "FEW_ROWS", few)
        queries.FEW_ROWS = 0
        both = Evaluators(small_world(Path(folder)))
        stack.callback(both.world.close)
        stack.callback(both.close)
        yield both


def agree(rows: Outcome, sql: Outcome, text: str) -> bool:
    """Checks whether SQL gives what row by row gives.

    An error row by row may be a value in SQL only in a program with AND, or with LIMIT: which
    side of AND is looked at first is not promised, nor are conditions of rows beyond a limit.
    """
    if rows.is_crash or sql.is_crash:
        return False
    if rows.error is None:
        return sql.error is None and is_same(rows.value, sql.value)
    return sql.error is not None or " AND " in text or " LIMIT " in text


def is_same(left: Any, right: Any) -> bool:
    """Checks whether two values are equal and of the same types, in the same order."""
    if type(left) is not type(right):
        return False
    if isinstance(left, dict):
        return is_same(list(left.items()), list(right.items()))
    if isinstance(left, list | tuple):
        return len(left) == len(right) and all(map(is_same, left, right))
    return bool(left == right) or (left != left and right != right)  # noqa: PLR0124  # no number


def shrunk(taken: Sequence[int], fails: Callable[[str], bool], attempts: int = 400) -> str:
    """Returns the smallest program near some choices that still fails."""
    best = list(taken)
    left = attempts

    def attempt(candidate: list[int]) -> bool:
        nonlocal best, left
        choices = Choices(lambda _: 0, candidate)
        text = program(choices)
        if left <= 0 or (len(choices.taken), choices.taken) >= (len(best), best):
            return False
        left -= 1
        if fails(text):
            best = choices.taken
            return True
        return False

    changed = True
    while changed and left > 0:
        changed = False
        for size in (16, 8, 4, 2, 1):
            place = 0
            while place < len(best):
                cut = best[:place] + best[place + size :]
                zeroed = best[:place] + [0] * size + best[place + size :]
                if attempt(cut) or attempt(zeroed[: len(best)]):
                    changed = True
                else:
                    place += 1
        for place in range(len(best)):
            if place >= len(best):
                break
            for smaller in (best[place] // 2, best[place] - 1):
                if smaller >= 0 and attempt([*best[:place], smaller, *best[place + 1 :]]):
                    changed = True
                    break
    return program(Choices(lambda _: 0, best))
