"""Checks that mutated programs end in a value or a `SelectScriptError`.

`python -m tools.fuzz [COUNT] [--seed N] [--jobs J]` prints the findings; 1,000,000 inputs take
about 25 minutes on two busy cores.

Each input is a mutated program of `tests/data/programs.txt`, or sometimes mutated SQL. An error
must be printable and its position must lie in the text; after it the variables must be unchanged,
and the next correct query must give the right result. Everything else is a finding: another
exception, a crash, a hang. Worker processes run the inputs and report their progress, so that the
parent can name the input of a crash or a hang. An input depends only on the seed and its number:
`--only NUMBER` repeats and prints one.
"""

from __future__ import annotations

import argparse
import contextlib
import faulthandler
import multiprocessing
import os
import random
import re
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
CORPUS = ROOT / "tests" / "data" / "programs.txt"

# The seconds after which an input is slow, or hangs; the limit of its queries is 2 s.
SLOW = 6.0
HANG = 11.0
# The number of inputs of an interpreter, which caches their plans.
LIFETIME = 4000
MEMORY = 6 * 2**30

# -- inputs -----------------------------------------------------------------------------------

SQL = (
    "SELECT name, z FROM entities ORDER BY z DESC LIMIT 3",
    "SELECT a.name, b.name FROM entities a, entities b WHERE above(a, b)",
    "SELECT count(*), avg(mass) FROM room.entities GROUP BY kind HAVING count(*) > 0",
    "WITH t AS (SELECT * FROM links) SELECT entity, max(link) FROM t GROUP BY ALL",
    "SELECT unnest([1, 2, 3]) AS n, 'text' || 'more', NULL, 1e308 * 10, 2 ** 0.5",
    'SELECT volume(e), "position"(e), distance(e, e) FROM entities e WHERE isKinbody(e)',
    "SELECT s.*, g.type FROM shapes s JOIN geometries g ON s.geometry = g.id",
    "SELECT CASE WHEN kind = 'robot' THEN 1 ELSE 0 END FROM entities -- a comment",
    "SELECT depth, force FROM contacts WHERE a <> b UNION ALL SELECT 1, 2",
    "SELECT j.name, j.upper - j.lower FROM joints j /* all */ WHERE j.upper > j.lower",
)

WORDS = (
    *("SELECT", "FROM", "WHERE", "START WITH", "CONNECT BY", "STOP WITH", "NO CYCLE", "UNIQUE"),
    *("MEMORIZE", "MAXIMUM", "GROUP BY", "HAVING", "ORDER BY", "ASC", "DESC", "LIMIT", "AS"),
    *("AS list", "AS dict", "AS value", "EXPLAIN", "IF", "True", "False", "this", "NOT", "OR"),
    *("AND", "XOR", "IN", "=", "==", "!=", "<", "<=", ">", ">=", "+", "-", "*", "/", "%", "^"),
    *("(", ")", "[", "]", "{", "}", ",", ";", ".", "//", "#", "/*", "*/", "'", '"', "\\"),
)
NUMBERS = (
    *("0", "1", "2", "-1", "-0", "0.0", "-0.0", "0.1", "1e308", "1e-308", "1e309", "-1e309"),
    *("100000000000000000000", "99999999999999999999999999999999999999999", "2147483647"),
    *("2147483648", "-2147483649", "9223372036854775807", "9223372036854775808", "1000000"),
    *("170141183460469231731687303715884105728", "1_000", "0x10", "1e", "1.2.3", "5.", ".5"),
    *("1e999999999", "4294967296", "65536", "1000", "9" * 400, "9" * 5000),
)
NAMES = (
    *("room", "numbers", "nested", "words", "mixed", "empty", "people", "record", "frame", "polar"),
    *("arrow", "grid", "moves", "edges", "cup", "shelf", "n", "nan", "huge", "text", "flag"),
    *("nothing", "double", "plus", "half", "shout", "total", "height", "is_low", "broken"),
    *("strange", "huge_of", "liar", "move", "id", "z", "position", "volume", "distance", "above"),
    *("isRobot", "obj", "robot", "type", "count", "sum", "min", "max", "avg", "uniq", "str"),
    *("int", "float", "round", "pow", "sqrt", "abs", "log", "exp", "floor", "eval", "var"),
    *("clear", "help", "print", "to", "getTime", "this", "a.this", "list", "value", "dict"),
    *("unknown", "numbrs", "SELECT", "select", "entities", "main", "_", "ä", "__class__", "name"),
)
LETTERS = (
    *("\x00", "\ud800", "\udfff", "\udc80", "\ufeff", "\u2028", "\u00a0", "\x0b", "\x0c", "\x1c"),
    *("\r", "\n", "\t", " ", "é", "e\u0301", "世", "🤖", "\u202e", "\x7f", "\x1b", "\u0660", "²"),
    *("`", "$", "@", "!", "?", "&", "|", "~", ":", "::", "->", "\\u", "%s", "{}", "--", "'", '"'),
    *(
        "0",
        "9",
        "_",
        "ß",
        "İ",
        "\u017f",
        "½",
        "Ⅷ",
        "\U0010ffff",
        "=",
        "<>",
        "<=>",
        "||",
        "**",
        "\\",
    ),
)
OPENINGS = (
    *("(", "[", "-", "+", "NOT ", "IF(1;", "x = ", "double(", "eval('", "print(", "this[", "n{"),
    *("SELECT this FROM ", "(SELECT this FROM ", "SELECT (SELECT ", "1 + ", "1 ^ ", "/*", "'"),
    *("SELECT this FROM numbers WHERE ", "x = [", "IF(", "[[", "1 == ", "a, ", "not(", "x{"),
)
CLOSINGS = (")", "]", "}", "[0]", ".a", ".this", ";", ",", " + 1", " OR n", ", 1", " AS list", "[")

_TOKEN = re.compile(
    r"""'(?:\\.|[^'\\])*' | "(?:\\.|[^"\\])*" | //[^\n]* | \#[^\n]* | /\*.*?\*/
    | \d+\.?\d* | \w+ | \s+ | [=!<>]= | .""",
    re.VERBOSE | re.DOTALL,
)
_MAX_LENGTH = 20_000


@dataclass(frozen=True)
class Input:
    """An input: a program or SQL."""

    text: str
    is_sql: bool = False


@cache
def programs() -> tuple[str, ...]:
    """Returns the valid programs from which inputs are made."""
    return tuple(CORPUS.read_text(encoding="utf-8").strip().split("\n\n"))


def input_of(seed: int, number: int) -> Input:
    """Returns the input of a number."""
    rng = random.Random(f"{seed} {number}")  # noqa: S311  # nothing secret
    is_sql = rng.random() < 0.06
    corpus = SQL if is_sql else programs()
    tokens = _TOKEN.findall(rng.choice(corpus))
    for _ in range(rng.choice((1, 1, 1, 2, 2, 3, 5))):
        mutation = rng.choices(_MUTATIONS, _WEIGHTS)[0]
        tokens = mutation(rng, tokens, corpus)
    return Input("".join(tokens)[:_MAX_LENGTH], is_sql)


def _at(rng: random.Random, tokens: Sequence[str], kind: str = r"\S") -> int:
    """Returns the position of a token of a kind, or of any token if there is none."""
    places = [place for place, token in enumerate(tokens) if re.match(kind, token)]
    return rng.choice(places) if places else rng.randrange(len(tokens) + 1)


def _delete(rng: random.Random, tokens: list[str], _: Sequence[str]) -> list[str]:
    at = _at(rng, tokens)
    return tokens[:at] + tokens[at + rng.choice((1, 1, 1, 2, 4, 8)) :]


def _duplicate(rng: random.Random, tokens: list[str], _: Sequence[str]) -> list[str]:
    at = _at(rng, tokens)
    end = at + rng.choice((1, 1, 2, 4, 8, 16))
    return [*tokens[:end], " ", *tokens[at:]]


def _swap(rng: random.Random, tokens: list[str], _: Sequence[str]) -> list[str]:
    swapped = [*tokens, ""]
    one, other = _at(rng, tokens), _at(rng, tokens)
    swapped[one], swapped[other] = swapped[other], swapped[one]
    return swapped


def _insert(rng: random.Random, tokens: list[str], _: Sequence[str]) -> list[str]:
    at = _at(rng, tokens)
    word = rng.choice(rng.choice((WORDS, NAMES, NUMBERS)))
    return [*tokens[:at], " ", word, " ", *tokens[at:]]


def _splice(rng: random.Random, tokens: list[str], corpus: Sequence[str]) -> list[str]:
    other = _TOKEN.findall(rng.choice(corpus))
    at, from_ = _at(rng, tokens), _at(rng, other)
    end = from_ + rng.choice((1, 3, 6, 12, len(other)))
    return [*tokens[:at], " ", *other[from_:end], " ", *tokens[at + rng.choice((0, 1, 3)) :]]


def _expression(rng: random.Random, tokens: list[str], corpus: Sequence[str]) -> list[str]:
    """Replaces a name or a number by a whole program in brackets."""
    other = rng.choice(corpus).rstrip("; ")
    at = _at(rng, tokens, r"\w")
    return [*tokens[:at], "(", other, ")", *tokens[at + 1 :]]


def _number(rng: random.Random, tokens: list[str], _: Sequence[str]) -> list[str]:
    at = _at(rng, tokens, r"\d")
    return [*tokens[:at], rng.choice(NUMBERS), *tokens[at + 1 :]]


def _name(rng: random.Random, tokens: list[str], _: Sequence[str]) -> list[str]:
    at = _at(rng, tokens, r"(?!(?:select|from|where|this)\b)[^\W\d]")
    return [*tokens[:at], rng.choice(NAMES), *tokens[at + 1 :]]


def _operator(rng: random.Random, tokens: list[str], _: Sequence[str]) -> list[str]:
    at = _at(rng, tokens, r"[-+*/%^<>!]|==|and\b|or\b|in\b|AND\b|OR\b|IN\b")
    sign = rng.choice(WORDS[WORDS.index("OR") : WORDS.index("(")])
    return [*tokens[:at], " ", sign, " ", *tokens[at + 1 :]]


def _call(rng: random.Random, tokens: list[str], _: Sequence[str]) -> list[str]:
    """Wraps a name or a number in a call."""
    at = _at(rng, tokens, r"\w")
    more = rng.choice(("", "", ", 1", ", this", ", n"))
    return [
        *tokens[:at],
        rng.choice(NAMES),
        "(",
        *tokens[at : at + 1],
        more,
        ")",
        *tokens[at + 1 :],
    ]


def _letters(rng: random.Random, tokens: list[str], _: Sequence[str]) -> list[str]:
    text = "".join(tokens)
    for _times in range(rng.choice((1, 1, 2, 5))):
        at = rng.randrange(len(text) + 1)
        letter = rng.choice(LETTERS) if rng.random() < 0.8 else chr(rng.randrange(0x300))
        text = text[:at] + letter + text[at + rng.randrange(2) :]
    return _TOKEN.findall(text)


def _bytes(rng: random.Random, tokens: list[str], _: Sequence[str]) -> list[str]:
    """Flips bits of the text's bytes."""
    data = bytearray("".join(tokens).encode("utf-8", "surrogatepass"))
    for _times in range(rng.choice((1, 2, 8))):
        if data:
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return _TOKEN.findall(data.decode("utf-8", rng.choice(("surrogateescape", "replace"))))


def _case(rng: random.Random, tokens: list[str], _: Sequence[str]) -> list[str]:
    at = _at(rng, tokens, r"[^\W\d]")
    changed = "".join(
        rng.choice((str.upper, str.lower))(letter) for letter in "".join(tokens[at : at + 1])
    )
    return [*tokens[:at], changed, *tokens[at + 1 :]]


def _unbalance(rng: random.Random, tokens: list[str], _: Sequence[str]) -> list[str]:
    at = _at(rng, tokens, r"[\])}'\"]")
    cut = tokens[at : at + 1]
    return [*tokens[:at], *(token[:-1] for token in cut), *tokens[at + 1 :]]


def _nest(rng: random.Random, tokens: list[str], _: Sequence[str]) -> list[str]:
    """Nests deeply, closed or not, or repeats many times."""
    at = _at(rng, tokens)
    depth = rng.choice((2, 10, 55, 70, 300, 1200, 5000))
    opening, closing = rng.choice(OPENINGS), rng.choice(CLOSINGS)
    match rng.randrange(4):
        case 0:
            return [*tokens[:at], opening * depth, *tokens[at:]]
        case 1:
            return [*tokens[:at], *tokens[at : at + 1], closing * depth, *tokens[at + 1 :]]
        case 2:
            pairs = {"(": ")", "[": "]", "{": "}"}
            closing = "".join(pairs[letter] for letter in reversed(opening) if letter in pairs)
            return [
                *tokens[:at],
                opening * depth,
                *tokens[at : at + 1],
                closing * depth,
                *tokens[at + 1 :],
            ]
    times = rng.choice((2, 5, 40, 400))
    return [*tokens[:at], *(tokens[at : at + rng.choice((1, 2, 5))] * times), *tokens[at:]]


def _truncate(rng: random.Random, tokens: list[str], _: Sequence[str]) -> list[str]:
    text = "".join(tokens)
    return _TOKEN.findall(text[: rng.randrange(len(text) + 1)])


_Mutation = Callable[[random.Random, list[str], Sequence[str]], list[str]]
_MUTATIONS: tuple[_Mutation, ...] = (
    *(_delete, _duplicate, _swap, _insert, _splice, _expression, _number, _name, _operator),
    *(_call, _letters, _bytes, _case, _unbalance, _nest, _truncate),
)
_WEIGHTS = (4, 3, 3, 4, 4, 5, 8, 10, 6, 6, 4, 2, 2, 1, 2, 1)

# -- the environment of the inputs ------------------------------------------------------------


def _move(step: Any, tower: Any) -> Any:
    """Returns the position after a move of the Towers of Hanoi, [] for an invalid move."""
    source, target = tower[step[0]], tower[step[1]]
    if not source or (target and target[-1] < source[-1]):
        return []
    target.append(source.pop())
    return tower


def _strange(kind: Any) -> Any:
    """Returns values that no query expects."""
    import numpy as np

    endless: list[Any] = [1]
    endless.append(endless)
    kinds = (None, float("nan"), object(), float("inf"), np.zeros(2), {1, 2}, {3: {"a": None}})
    others = (10**30, b"\xff", 1j, "\ud800", "\x00", endless, np.float64(2.5), range(3), int)
    values = (*kinds, *others)
    return values[int(kind) % len(values)]


def _broken(value: Any) -> Any:
    raise KeyError(value)


def _functions() -> dict[str, Callable[..., Any]]:
    from ssduck import Entity

    def plus(a: int, b: int) -> int:
        return a + b

    def half(a: float) -> float:
        return a / 2

    def shout(a: str) -> str:
        return a.upper() + "!"

    def total(values: list[float]) -> float:
        return sum(values)

    def height(e: Entity) -> float:
        (_, _, low), (_, _, high) = e.aabb
        return high - low

    def is_low(e: Entity, limit: float) -> bool:
        return e.position[2] < limit

    def huge_of(a: int) -> int:
        return a * 10**30

    def liar(a: int) -> str:
        return a  # type: ignore[return-value]  # the hint is wrong on purpose

    def double(value: Any) -> Any:
        return value * 2

    named = (plus, half, shout, total, height, is_low, huge_of, liar, double)
    functions: dict[str, Callable[..., Any]] = {function.__name__: function for function in named}
    for function in (plus, half, shout, total, height, is_low, huge_of, liar):
        hints = {"int": int, "float": float, "str": str, "bool": bool, "list[float]": list[float]}
        hints["Entity"] = Entity
        function.__annotations__ = {k: hints[v] for k, v in function.__annotations__.items()}
    return {**functions, "move": _move, "strange": _strange, "broken": _broken}


def _variables() -> dict[str, Any]:
    import numpy as np
    import pandas as pd
    import polars as pl
    import pyarrow as pa

    moves = [[a, b] for a in range(3) for b in range(3) if a != b]
    return {
        "numbers": [3, 1, 2],
        "nested": [[1, 2], [3, 4]],
        "words": ["b", "a", "ä"],
        "mixed": [1, "a", None, 2.5, [1], True, {"a": 1}],
        "empty": [],
        "people": [{"name": "Ann", "age": 31}, {"name": "Bo", "age": 19}],
        "record": {"name": "x", "parts": [1, 2]},
        "frame": pd.DataFrame({"a": [1, 2, 3], "b": ["x", "y", None]}),
        "polar": pl.DataFrame({"a": [1, 2], "c": [0.5, float("nan")]}),
        "arrow": pa.table({"k": ["p", "q"], "v": [1.5, 2.5]}),
        "grid": np.arange(6).reshape(3, 2),
        "moves": moves,
        "edges": [["a", "b"], ["b", "c"], ["c", "d"], ["b", "a"]],
        "n": 3,
        "nan": float("nan"),
        "huge": 10**30,
        "text": "wörld",
        "flag": True,
        "nothing": None,
    }


def _world() -> Any:
    """Returns a world of a robot and a few bodies."""
    import pybullet as p

    from ssduck import World

    client = p.connect(p.DIRECT)
    box = p.createCollisionShape(p.GEOM_BOX, halfExtents=[0.5, 0.5, 0.2], physicsClientId=client)
    ball = p.createCollisionShape(p.GEOM_SPHERE, radius=0.1, physicsClientId=client)
    names = {}
    for name, shape, place in (
        ("shelf", box, [0, 0, 0.2]),
        ("cup", ball, [0.1, 0, 0.5]),
        ("crate", box, [2, 1, 0.2]),
        ("ball", ball, [-1, 2, 0.1]),
    ):
        number = p.createMultiBody(1, shape, basePosition=place, physicsClientId=client)
        names[number] = name
    number = p.createMultiBody(
        baseMass=1,
        baseCollisionShapeIndex=box,
        basePosition=[3, 3, 1],
        linkMasses=[1],
        linkCollisionShapeIndices=[ball],
        linkVisualShapeIndices=[-1],
        linkPositions=[[0, 0, 0.5]],
        linkOrientations=[[0, 0, 0, 1]],
        linkInertialFramePositions=[[0, 0, 0]],
        linkInertialFrameOrientations=[[0, 0, 0, 1]],
        linkParentIndices=[0],
        linkJointTypes=[p.JOINT_REVOLUTE],
        linkJointAxis=[[0, 0, 1]],
        physicsClientId=client,
    )
    return World.attach(client, names={**names, number: "arm"})


# Programs and their values, whatever ran before.
CORRECT = (
    ("n + 1;", 4),
    ("SELECT double(this) FROM numbers WHERE this > 1 AS list;", [6, 4]),
    ("SELECT id FROM room WHERE isKinbody(this) AND above(shelf, this) AS list;", ["cup"]),
    ("SELECT id(this) FROM room WHERE z(this) > n - 2.6 AS list;", ["cup", "arm"]),
    ("SELECT half(this) FROM [1.0, 5.0] AS list;", [0.5, 2.5]),
)


@dataclass(frozen=True)
class Finding:
    """An outcome that should not happen.

    Attributes:
        number: the number of the input.
        input: the input.
        kind: a line that describes the outcome.
        cause: the place in the code; findings of one kind and cause count as one.
        trace: details.
    """

    number: int
    input: Input
    kind: str
    cause: str = ""
    trace: str = ""

    def __str__(self) -> str:
        kind = "sql" if self.input.is_sql else "program"
        text = _shortened(ascii(self.input.text), 1500)
        return f"#{self.number} {self.kind} [{self.cause}]\n  {kind}: {text}"


def _shortened(text: str, limit: int) -> str:
    return text if len(text) <= limit else f"{text[: limit // 2]} ... {text[-limit // 2 :]}"


class Bench:
    """Runs inputs one after another in interpreters on one world."""

    def __init__(self) -> None:
        self._world = _world()
        self._run_count = 0
        self._error_count = 0
        self._ss: Any = None

    def check(self, tested: Input) -> tuple[str, str, str] | None:
        """Runs an input; returns the kind, cause and trace of an error in its outcome."""
        if self._ss is None or self._run_count >= LIFETIME:
            self._begin()
        self._run_count += 1
        started = time.monotonic()
        fault = self._fault_of(tested)
        seconds = time.monotonic() - started
        if fault is None and seconds > SLOW:
            fault = ("slow", "", f"{seconds:.1f} s")
        if fault is not None:
            self._begin()
        return fault

    def error_of(self, tested: Input) -> Exception | None:
        """Returns the `SelectScriptError` of an input; None if it has a value."""
        if self._ss is None:
            self._begin()
        try:
            return self._error_of(tested)
        finally:
            self._ss._execution.variables = dict(self._before)  # noqa: SLF001  # each input anew

    def _error_of(self, tested: Input) -> Exception | None:
        from ssduck import SelectScriptError

        try:
            _ = self._ss.sql(tested.text) if tested.is_sql else self._ss.eval(tested.text)
        except SelectScriptError as error:
            return error
        return None

    def _begin(self) -> None:
        from ssduck import Interpreter, Limits

        if self._ss is not None:
            self._ss.close()
        limits = Limits(seconds=2, rows=100_000, memory=2 * 10**8, files=False)
        self._ss = ss = Interpreter(limits=limits)
        ss.add_variable("room", self._world)
        ss.add_variable("cup", self._world["cup"])
        ss.add_variable("shelf", self._world["shelf"])
        for name, value in _variables().items():
            ss.add_variable(name, value)
        for name, function in _functions().items():
            ss.add_function(name, function)
        self._before: Mapping[str, Any] = dict(ss._execution.variables)  # noqa: SLF001  # to compare with
        self._values = self._mutable_values()
        self._run_count = 0

    def _mutable_values(self) -> str:
        return repr([v for v in self._before.values() if isinstance(v, list | dict)])

    def _fault_of(self, tested: Input) -> tuple[str, str, str] | None:
        try:
            error = self._error_of(tested)
            return (self._check_error(error) if error else None) or self._check_values()
        except BaseException as caught:  # noqa: BLE001  # every exception is a finding
            return _fault_from("raises", caught)
        finally:
            self._ss._execution.variables = dict(self._before)  # noqa: SLF001  # each input anew

    def _check_error(self, error: Any) -> tuple[str, str, str] | None:
        try:
            message = str(error)
        except Exception as caught:  # noqa: BLE001  # every exception is a finding
            return _fault_from("str(error) raises", caught)
        text, span = error.text, error.span
        # An error at the end of the text underlines one letter behind it.
        if text is not None and span is not None:
            end = len(text) + 1
            if not 0 <= span.start <= span.end <= end:
                return (
                    "span outside the text",
                    type(error).__name__,
                    f"{span} of {len(text)}: {message}",
                )
        variables = self._ss._execution.variables  # noqa: SLF001  # to compare with
        if variables.keys() != self._before.keys():
            return ("names changed", "", str(variables.keys() ^ self._before.keys()))
        for name, value in variables.items():
            if value is not self._before[name]:
                return ("value replaced", name, repr(value))
        return self._check_next(error)

    def _check_next(self, error: Any) -> tuple[str, str, str] | None:
        """Checks a correct query, but seldom after errors of the parser, which are frequent."""
        from ssduck.errors import ParseError

        self._error_count += 1
        if isinstance(error, ParseError) and self._error_count % 50:
            return None
        program, expected = CORRECT[self._error_count % len(CORRECT)]
        try:
            value = self._ss.eval(program)
        except BaseException as caught:  # noqa: BLE001  # every exception is a finding
            kind, cause, trace = _fault_from("the next query raises", caught)
            return (kind, cause, f"{program}\n{trace}")
        return None if value == expected else ("the next query is wrong", program, repr(value))

    def _check_values(self) -> tuple[str, str, str] | None:
        values = self._mutable_values()
        return None if values == self._values else ("values changed", "", values)


def _fault_from(event: str, error: BaseException) -> tuple[str, str, str]:
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if "/ssduck/" in frame.filename] or list(frames)
    places = [f"{Path(f.filename).name}:{f.lineno} {f.name}" for f in ours[-2:]]
    with contextlib.suppress(Exception):
        kind = f"{event} {type(error).__name__}"
        return (kind, " < ".join(reversed(places)), _shortened(f"{error}", 400))
    return (f"{event} {type(error).__name__}", " < ".join(reversed(places)), "")


# -- workers ----------------------------------------------------------------------------------


def _work(seed: int, numbers: range, progress: Any, findings: Connection, log: str) -> None:
    """Runs inputs in a worker process.

    Args:
        seed: the seed of the inputs.
        numbers: the numbers of the inputs.
        progress: receives the number of the current input and the time of its start, or 0.
        findings: receives the findings, and None at the end.
        log: the file for traces of crashes and hangs.
    """
    import warnings

    warnings.simplefilter("ignore")
    trace = Path(log).open("w", encoding="utf-8")  # noqa: SIM115  # open until the process ends
    faulthandler.enable(trace)
    faulthandler.register(signal.SIGUSR1, trace, all_threads=False)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.__stdout__.fileno() if sys.__stdout__ else 1)
    sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: PTH123, SIM115  # so does print
    bench = Bench()
    for number in numbers:
        tested = input_of(seed, number)
        progress[1] = time.monotonic()
        progress[0] = number
        fault = bench.check(tested)
        progress[1] = 0.0
        if fault is not None:
            findings.send(Finding(number, tested, *fault))
    findings.send(None)
    findings.close()


@dataclass
class _Worker:
    """A process that runs some of the inputs, restarted after an input that ends it."""

    seed: int
    numbers: range
    log: str
    process: Any = None
    progress: Any = None
    receiver: Any = None
    is_done: bool = False
    findings: list[Finding] = field(default_factory=list)

    def begin(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.progress = context.Array("d", [-1.0, 0.0], lock=False)
        self.receiver, sender = context.Pipe(duplex=False)
        arguments = (self.seed, self.numbers, self.progress, sender, self.log)
        self.process = context.Process(target=_work, args=arguments, daemon=True)
        self.process.start()
        sender.close()

    def end(self) -> None:
        self.process.kill()
        self.process.join()

    def poll(self) -> list[Finding]:
        """Returns the findings since the last call."""
        new = list(self._received())
        if self.is_done:
            self.process.join()
        elif not self.process.is_alive():
            new += list(self._received())
            if not self.is_done:
                new.append(self._lost(f"crash, exit status {self.process.exitcode}"))
        elif self._hangs():
            os.kill(self.process.pid, signal.SIGUSR1)  # it writes where it is
            time.sleep(0.5)
            self.end()
            new.append(self._lost("hang"))
        self.findings += new
        return new

    def _hangs(self) -> bool:
        since: float = self.progress[1]  # read once: it is 0 when no input runs
        return since > 0 and time.monotonic() - since > HANG

    def _received(self) -> Iterator[Finding]:
        with contextlib.suppress(EOFError, OSError):
            while not self.is_done and self.receiver.poll():
                finding = self.receiver.recv()
                if finding is None:
                    self.is_done = True
                else:
                    yield finding

    def _lost(self, kind: str) -> Finding:
        """Handles a process that ended in an input, and continues after the input."""
        number = int(self.progress[0])
        trace = Path(self.log).read_text(encoding="utf-8")
        if number < 0:
            raise RuntimeError(f"a worker does not begin: {kind}\n{trace}")
        self.numbers = range(number + self.numbers.step, self.numbers.stop, self.numbers.step)
        if self.numbers:
            self.begin()
        else:
            self.is_done = True
        lines = [line.strip() for line in trace.splitlines() if "/ssduck/" in line]
        cause = lines[0].rpartition("/")[2] if lines else ""
        return Finding(number, input_of(self.seed, number), kind, cause, _shortened(trace, 3000))

    @property
    def at(self) -> int:
        """The number of started inputs."""
        if self.is_done:
            return len(self.numbers)
        return 0 if self.progress[0] < 0 else self.numbers.index(int(self.progress[0]))


def fuzz(
    count: int,
    seed: int = 0,
    jobs: int = 2,
    on_finding: Callable[[Finding], None] | None = None,
) -> list[Finding]:
    """Runs inputs in worker processes; returns the findings.

    Args:
        count: the number of inputs.
        seed: the seed of the inputs.
        jobs: the number of processes.
        on_finding: a callback for each finding.
    """
    with tempfile.TemporaryDirectory() as folder:
        workers = [
            _Worker(seed, range(job, count, jobs), str(Path(folder) / f"{job}.txt"))
            for job in range(min(jobs, count))
        ]
        try:
            for worker in workers:
                worker.begin()
            while not all(worker.is_done for worker in workers):
                time.sleep(0.1)
                for worker in workers:
                    if not worker.is_done:
                        for finding in worker.poll():
                            if on_finding is not None:
                                on_finding(finding)
        finally:
            for worker in workers:
                if worker.process is not None:
                    worker.end()
    return [finding for worker in workers for finding in worker.findings]


def distinct(findings: Sequence[Finding]) -> list[tuple[Finding, int]]:
    """Returns the shortest finding of each kind and cause, and their number."""
    groups: dict[tuple[str, str], list[Finding]] = {}
    for finding in findings:
        groups.setdefault((finding.kind, finding.cause), []).append(finding)
    return [(min(g, key=lambda f: len(f.input.text)), len(g)) for g in groups.values()]


def main() -> int:
    """Runs inputs and prints the findings; the exit status is 1 if there are any."""
    parser = argparse.ArgumentParser(description="Run mutated programs.")
    parser.add_argument("count", nargs="?", type=int, default=10_000, help="the number of inputs")
    parser.add_argument("--seed", type=int, default=0, help="the seed of the inputs")
    parser.add_argument("--jobs", type=int, default=2, help="the number of processes")
    parser.add_argument("--only", type=int, help="print and run the input of this number alone")
    options = parser.parse_args()
    if options.only is not None:
        tested = input_of(options.seed, options.only)
        print(repr(tested.text))
        print(Bench().check(tested))
        return 0
    started = time.monotonic()
    kinds: set[tuple[str, str]] = set()

    def print_new_kind(finding: Finding) -> None:
        if (finding.kind, finding.cause) not in kinds:
            kinds.add((finding.kind, finding.cause))
            print(f"{finding}\n  {finding.trace}\n", flush=True)

    findings = fuzz(options.count, options.seed, options.jobs, print_new_kind)
    seconds = time.monotonic() - started
    print("-- each kind once, its shortest input")
    for finding, times in distinct(findings):
        print(f"{times} x {finding}")
    print(f"{options.count} inputs in {seconds:.0f} s ({options.count / seconds:.0f}/s)")
    print(f"{len(findings)} findings, {len(kinds)} kinds")
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
