"""Completes names at a place in a program: what may stand there, with its usage and its meaning.

Shells and pages use it while their user types. A completion reads names that are in memory: it
runs no SQL, takes no tick and reads nothing from a simulator.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Literal, TypeAlias

from ssduck import validation
from ssduck.adapters.registry import all_adapters, loaded_adapters
from ssduck.errors import ArgumentError, nearest
from ssduck.interpreter.interpreter import Interpreter
from ssduck.language.tokens import DelimitedText, delimited, escaped
from ssduck.schema import HISTORIES, TABLES
from ssduck.sql.relations.registry import RELATIONS
from ssduck.world.entities import Entity
from ssduck.world.world import World

Language: TypeAlias = Literal["selectscript", "sql"]
Kind: TypeAlias = Literal[
    "alias", "column", "entity", "form", "function", "keyword", "link", "table", "variable", "world"
]

_QUERY = "SELECT, FROM, WHERE, GROUP BY, HAVING, ORDER BY, ASC, DESC, LIMIT, OFFSET, AS, AND, OR, "
_QUERY += "NOT, IN, LIKE, BETWEEN, IS NULL, CASE, WHEN, THEN, ELSE, END"
KEYWORDS: dict[Language, tuple[str, ...]] = {
    "selectscript": (
        *_QUERY.split(", "),
        *("START WITH", "CONNECT BY", "STOP WITH", "XOR", "IMPLIES", "IF", "True", "False", "None"),
        "this",
    ),
    "sql": (
        *_QUERY.split(", "),
        *("WITH", "JOIN", "LEFT JOIN", "ON", "USING", "UNION", "EXCEPT", "DISTINCT", "EXISTS"),
        *("CAST", "OVER", "PARTITION BY", "TRUE", "FALSE", "NULL"),
    ),
}
# The order of the kinds among equally near names.
_KINDS: tuple[Kind, ...] = (
    *("alias", "world", "variable", "column", "table", "entity", "link"),
    *("function", "form", "keyword"),
)
_WORD = re.compile(r"\w*\Z")
_PATH = re.compile(r"((?:\w+\s*\.\s*)+)\Z")
_PREVIOUS_WORD = re.compile(r"(\w+)\s*\Z")
_PREVIOUS_LETTERS = re.compile(r"(?<!\w)[eE]\Z")
_ASSIGNED = re.compile(r"\b([^\W\d]\w*)\s*=(?![=])")
_SQL_SOURCE = re.compile(
    r"\b(?:FROM|JOIN|,)\s+(?:(\w+)\s*\.\s*)?(\w+)(?=(?:\s+(?:AS\s+)?(\w+))?)", re.IGNORECASE
)
_SQL_DELIMITED = re.compile(
    r"--[^\n]*|/\*.*?(?:\*/|\Z)|'(?:[^']|'')*(?:'|\Z)|\"[^\"]*(?:\"|\Z)", re.DOTALL
)
# The letters before the cursor that are searched: the time grows with their square.
_LETTERS_BEFORE = 500
# These end before the end of their line.
_LINE_COMMENTS = ("--", "//", "#")
# The words behind which a source follows.
_BEFORE_SOURCE = {"selectscript": ("FROM",), "sql": ("FROM", "JOIN")}


@dataclass(frozen=True)
class Completion:
    """A name that may stand at a place.

    Attributes:
        text: the name, as it is written: inside a text, without what would end that.
        start: the index in the text from which on the name replaces what is there.
        kind: what it is.
        usage: how it is used, `near(a, b, d) -> bool`; empty where the name says it.
        about: its meaning, in a sentence; may be empty.
    """

    text: str
    start: int
    kind: Kind
    usage: str = ""
    about: str = ""


@dataclass(frozen=True)
class _Place:
    """A place in a program: what is around it."""

    ss: Interpreter
    language: Language
    text: str
    before: str
    start: int

    def completion(self, name: str, kind: Kind, usage: str = "", about: str = "") -> Completion:
        return Completion(name, self.start, kind, usage, about)


def complete(
    ss: Interpreter, text: str, cursor: int | None = None, language: Language = "selectscript"
) -> list[Completion]:
    """Returns the names that may stand at a place in a program, the nearest to what is there first.

    Args:
        ss: the interpreter whose variables, functions and worlds it names.
        text: the program, which need not be complete.
        cursor: the place, characters from the beginning; by default the end.
        language: `"selectscript"` or `"sql"`.

    Raises:
        NumberError: the place is not inside the text.
        ArgumentError: there is no such language.

    >>> import ssduck
    >>> with ssduck.load("kitchen") as ss:
    ...     [each.text for each in complete(ss, "SELECT id(kitchen.frid")]
    ['fridge', 'fridge_webcam']
    """
    cursor = (
        len(text) if cursor is None else validation.integer(cursor, "complete: cursor", minimum=0)
    )
    validation.integer(len(text) - cursor, "complete: characters after the cursor", minimum=0)
    if language not in KEYWORDS:
        raise ArgumentError(f"complete: there is no language {language!r}: selectscript or sql")
    parts = list(delimited_parts(text, language))
    inside = next((p for p in parts if p.start < cursor and _reaches(p, cursor)), None)
    if inside is not None:
        if inside.opening not in ("'", '"') or (language == "sql" and inside.opening == '"'):
            return []  # a comment, or a quoted identifier
        place = _Place(ss, language, text, "", inside.start + 1)
        return _nearest_first(text[place.start : cursor], _names_in_text(place))
    plain = _without(text, parts)
    word = _WORD.search(plain, max(cursor - _LETTERS_BEFORE, 0), cursor)
    assert word is not None
    if word[0][:1].isdigit():
        return []
    place = _Place(ss, language, plain, plain[: word.start()], word.start())
    return _nearest_first(word[0], _candidates(place))


@cache
def usage_and_summary(text: str) -> tuple[str, str]:
    """Returns the usage and the first sentence of a text of `Interpreter.help`."""
    name, *lines = text.splitlines()
    usage = next((line for line in lines if line.startswith("Usage: ")), name)
    about = " ".join(line for line in lines if line != usage)
    return usage.removeprefix("Usage: "), re.split(r"(?<=\.) ", about, maxsplit=1)[0]


def delimited_parts(text: str, language: Language) -> Iterator[DelimitedText]:
    """Yields the texts and comments of a program, and the quoted identifiers of SQL."""
    if language == "selectscript":
        yield from delimited(text)
        return
    for match in _SQL_DELIMITED.finditer(text):
        opening = match[0][:1] if match[0][0] in "'\"" else match[0][:2]
        ends = {"--": "", "/*": "*/"}.get(opening, opening)
        is_closed = len(match[0]) > len(opening) and match[0].endswith(ends)
        yield DelimitedText(opening, match.start(), match.end(), is_closed)


def _reaches(part: DelimitedText, cursor: int) -> bool:
    """Checks whether a place behind the start of a text or a comment is inside it."""
    is_open = not part.is_closed or part.opening in _LINE_COMMENTS
    return cursor < part.end or (cursor == part.end and is_open)


def _without(text: str, parts: Iterable[DelimitedText]) -> str:
    """Returns a program with signs of no meaning in place of its texts and comments."""
    pieces, end = [], 0
    for part in parts:
        sign = "?" if part.opening in ("'", '"') else " "
        pieces += [text[end : part.start], sign * (part.end - part.start)]
        end = part.end
    return "".join((*pieces, text[end:]))


def _candidates(place: _Place) -> Iterable[Completion]:
    """Yields all names that may stand at a place."""
    first = max(len(place.before) - _LETTERS_BEFORE, 0)
    path = _PATH.search(place.before, first)
    if path is not None:
        return _members(place, re.findall(r"\w+", path[1]))
    previous = _PREVIOUS_WORD.search(place.before, first)
    word = previous[1].upper() if previous is not None else ""
    if word == "AS":
        return _forms(place) if place.language == "selectscript" else ()
    if word in _BEFORE_SOURCE[place.language]:
        return _sources(place)
    return _everything(place)


def _members(place: _Place, path: list[str]) -> Iterator[Completion]:
    """Yields what may follow names with a full stop behind them."""
    worlds = {world.name: world for world in place.ss.worlds}
    if place.language == "sql":
        yield from _sql_members(place, path, worlds)
        return
    is_known = path[0] in place.ss
    owner = place.ss[path[0]] if is_known else None
    if isinstance(owner, World) and len(path) == 2 and path[1] in owner:
        owner, path = owner[path[1]], path[:1]
    if len(path) > 1:
        return
    if isinstance(owner, World):
        yield from (each for each in _entities(place, [owner]) if each.text.isidentifier())
    elif isinstance(owner, Entity):
        yield from _links(place, owner)
    elif path[0] in _aliases(place):
        yield place.completion("this", "keyword", about="The element of the row.")
        yield from _columns(place, "entities")


def _sql_members(place: _Place, path: list[str], worlds: dict[str, World]) -> Iterator[Completion]:
    if len(path) == 1 and path[0] in worlds:
        yield from _tables(place)
    table = _sql_sources(place).get(path[-1].lower())
    if table is not None:
        yield from _columns(place, table)


def _names_in_text(place: _Place) -> Iterator[Completion]:
    """Yields the names of entities, as they are written inside of a text.

    A name from elsewhere ends no text. Neither language can write control characters in a text.
    """
    opening = place.start - 1
    quote = place.text[opening]
    # Backslashes have a meaning in texts of SQL with an E before them.
    before = _PREVIOUS_LETTERS.search(place.text, max(opening - 2, 0), opening)
    has_escapes = place.language == "sql" and before is not None
    for each in _entities(place, place.ss.worlds):
        if not each.text.isprintable() or (has_escapes and "\\" in each.text):
            continue
        is_sql = place.language == "sql"
        text = each.text.replace("'", "''") if is_sql else escaped(each.text, quote)
        yield replace(each, text=text)


def _entities(place: _Place, worlds: Iterable[World]) -> Iterator[Completion]:
    for world in worlds:
        for info in world.snapshot.entities:
            yield place.completion(info.name, "entity", about=f"A {info.kind} of {world.name}.")


def _links(place: _Place, entity: Entity) -> Iterator[Completion]:
    infos = entity.world.snapshot.entities
    body = next((info.body for info in infos if info.name == entity.name), None)
    for link in () if body is None else body.links:
        if link.name.isidentifier():
            yield place.completion(link.name, "link", about=f"A link or site of {entity.name}.")


def _forms(place: _Place) -> Iterator[Completion]:
    _load_packages()
    for form in loaded_adapters():
        about = re.split(r"(?<=\.)\s", form.help, maxsplit=1)[0]
        for name in form.names:
            yield place.completion(name, "form", form.usage, about)


@cache
def _load_packages() -> None:
    """Loads the forms of installed packages, once: looking for them reads files."""
    all_adapters()


def _sources(place: _Place) -> Iterator[Completion]:
    """Yields what may follow FROM."""
    yield from _variables(place)
    if place.language == "sql":
        yield from _tables(place)
    else:
        yield from _functions(place)


def _everything(place: _Place) -> Iterator[Completion]:
    """Yields what may begin an expression, and keywords."""
    for alias in _aliases(place):
        yield place.completion(alias, "alias")
    yield from _variables(place)
    if place.language == "sql":
        for table in dict.fromkeys(_sql_sources(place).values()):
            yield from _columns(place, table)
        yield from _tables(place)
    yield from _functions(place)
    for word in KEYWORDS[place.language]:
        yield place.completion(word, "keyword")


def _variables(place: _Place) -> Iterator[Completion]:
    worlds = {world.name: world for world in place.ss.worlds}
    for name in place.ss:
        if name in worlds:
            about = f"A world with {len(worlds[name])} entities."
            yield place.completion(name, "world", about=about)
        elif place.language == "selectscript":
            yield place.completion(name, "variable")


def _functions(place: _Place) -> Iterator[Completion]:
    for name in place.ss.help():
        if place.language == "selectscript" or name in RELATIONS:
            usage, about = usage_and_summary(place.ss.help(name))
            yield place.completion(name, "function", usage, about)


def _tables(place: _Place) -> Iterator[Completion]:
    for table in TABLES.values():
        about = f"A row is {table.row}."
        yield place.completion(table.name, "table", about=about)
        if table.name in HISTORIES:
            view = HISTORIES[table.name].history_view
            yield place.completion(view, "table", about=f"{about[:-1]}, at each recorded tick.")


def _columns(place: _Place, table: str) -> Iterator[Completion]:
    for column in TABLES[table].shown_columns:
        yield place.completion(column.name, "column", column.sql, column.comment)


def _aliases(place: _Place) -> dict[str, Any]:
    """Returns the names that the text itself gives to sources and values."""
    if place.language == "sql":
        tables = (*TABLES, *(table.history_view for table in HISTORIES.values()))
        return {name: None for name in _sql_sources(place) if name not in tables}
    return dict.fromkeys(_ASSIGNED.findall(place.text))


def _sql_sources(place: _Place) -> dict[str, str]:
    """Returns the tables that the text reads, by their names and aliases in lower case."""
    sources: dict[str, str] = {}
    keywords = {word.split()[0].lower() for word in KEYWORDS["sql"]}
    for _, name, alias in _SQL_SOURCE.findall(place.text):
        table = name.lower().removesuffix("_history")
        if table in TABLES:
            is_alias = alias and alias.lower() not in keywords
            sources[(alias if is_alias else name).lower()] = table
    return sources


def _nearest_first(word: str, candidates: Iterable[Completion]) -> list[Completion]:
    """Returns the completions of a word: itself, those that begin with it, then similar ones."""
    by_name = {each.text: each for each in reversed(list(candidates))}
    folded = word.casefold()
    ranks: dict[str, int] = {}
    for name in by_name:
        other = name.casefold()
        if name == word:
            ranks[name] = -1
        elif other.startswith(folded):
            ranks[name] = 0 if name.startswith(word) else 1
        elif len(folded) > 1 and folded in other:
            ranks[name] = 2
    if not ranks and word:
        ranks = {name: 3 + index for index, name in enumerate(nearest(word, by_name))}
    order = {kind: index for index, kind in enumerate(_KINDS)}
    return sorted(
        (by_name[name] for name in ranks),
        key=lambda each: (ranks[each.text], order[each.kind], each.text.casefold(), each.text),
    )
