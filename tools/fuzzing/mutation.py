"""Makes inputs by mutating programs and SQL."""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CORPUS = ROOT / "tests" / "data" / "programs.txt"


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
