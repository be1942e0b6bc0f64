"""What users' statements are about, by the words in them."""

from __future__ import annotations

import re
from collections.abc import Sequence

import duckdb

from ssduck.database.binding import BoundWorld
from ssduck.database.macros import TABLE_MACROS, looking_up
from ssduck.errors import LimitError, SourceSpan
from ssduck.schema import MARGINS, MASSES, TABLES
from ssduck.sql.relations.registry import RELATIONS
from ssduck.world.world import World

# What is read where a table has such a column.
_READ = {"mass": MASSES, "margin": MARGINS}


def _asked_with(table: str) -> frozenset[str]:
    """A table, and what is read into its columns when it is asked for."""
    return frozenset((table, *(_READ[name] for name in TABLES[table].names if name in _READ)))


# The tables that a word in a statement stands for: a table's name, or that of a relation that
# looks things up in some.
_TABLES_OF = {
    **{name.lower(): _asked_with(name) for name in TABLES},
    **{relation.name.lower(): relation.inputs for relation in looking_up()},
    **{table.name: frozenset(("shapes",)) for table in TABLE_MACROS},
}
_TABLE_WORDS = re.compile(rf"\b({'|'.join(_TABLES_OF)})\b", re.IGNORECASE | re.ASCII)
# Relations that look nothing up are macros of a world's schema once a text names one so.
_OF_NO_TABLE = {
    relation.name.lower(): relation.name for relation in RELATIONS.values() if not relation.tables
}
_BETWEEN = r"(?:\s|/\*.*?\*/|--[^\n]*)*"
_BEHIND_A_SCHEMA = re.compile(
    rf'\.{_BETWEEN}"?({"|".join(_OF_NO_TABLE)})"?{_BETWEEN}\(',
    re.IGNORECASE | re.ASCII | re.DOTALL,
)
_KEEPS_A_QUERY = re.compile(r"\b(CREATE|PREPARE)\b", re.IGNORECASE)
_OF_MASSES = [name for name in TABLES if MASSES in _asked_with(name)]
_OF_PAST_MASSES = re.compile(
    rf"\b({'|'.join(_OF_MASSES)})_(history|model)\b", re.IGNORECASE | re.ASCII
)
# All columns: a star that counts no rows, or FROM without SELECT.
_MASS_OR_ALL = re.compile(
    r"\bmass\b|(?<!count\()\*|(^|\()\s*FROM\b", re.IGNORECASE | re.ASCII | re.MULTILINE
)
# What lets tables of another world than the first go without its name.
_CHANGES_THE_FIRST = re.compile(r"\b(USE|search_path|schema)\b", re.IGNORECASE)

# SQL with more words, or with more brackets around one of them, takes DuckDB's parser a time that
# nothing ends.
MOST_WORDS = 200_000
MOST_BRACKETS = 100


class ReferencedTables:
    """What users' statements ask for.

    A view or a prepared statement asks again when it is used, under another name; so what such a
    statement names is asked for from then on.

    Attributes:
        for_good: the tables that are so.
    """

    def __init__(self) -> None:
        self.for_good: set[str] = set()
        self._first_changes = False

    def tables(self, sql: str) -> set[str]:
        """The tables that a statement may read."""
        words = {word.lower() for word in _TABLE_WORDS.findall(sql)}
        asked = {table for word in words for table in _TABLES_OF[word]}
        if _KEEPS_A_QUERY.search(sql):
            self.for_good |= asked
        return asked | self.for_good

    def worlds(self, sql: str, bound: Sequence[BoundWorld]) -> list[World] | None:
        """The worlds that a statement may be about; None for all, where it may use another one.

        The first one's tables go without its name.
        """
        self._first_changes |= _CHANGES_THE_FIRST.search(sql) is not None
        if self.for_good or self._first_changes or _KEEPS_A_QUERY.search(sql):
            return None
        text = sql.casefold()
        return [
            world
            for number, own in enumerate(bound)
            if (world := own.reference()) is not None
            and (number == 0 or any(schema.casefold() in text for schema in own.schemas))
        ]


def tells_past_masses(sql: str) -> bool:
    """Whether a text names a table of masses as they were recorded, and the column or all of it."""
    return _OF_PAST_MASSES.search(sql) is not None and _MASS_OR_ALL.search(sql) is not None


def behind_a_schema(sql: str) -> set[str]:
    """The relations that look nothing up and that a text may call with a schema before them."""
    return {_OF_NO_TABLE[name.lower()] for name in _BEHIND_A_SCHEMA.findall(sql)}


def check_length(sql: str) -> None:
    """Complain of SQL that DuckDB would parse for a long time; it cannot be stopped there.

    Raises:
        LimitError: it is too long, or nested too deeply.
    """
    letters = sql.encode("utf-8", "replace")  # DuckDB itself complains of what is no letter
    words = duckdb.tokenize(letters.decode())
    if len(words) > MOST_WORDS:
        raise LimitError(f"SQL of {len(words)} words; under a limit it may have {MOST_WORDS}")
    depth = 0
    for place, _ in words:
        depth += _DEEPER.get(letters[place], 0)
        if depth > MOST_BRACKETS:
            start = len(letters[:place].decode())
            told = f"SQL nested deeper than {MOST_BRACKETS} brackets"
            raise LimitError(told, text=sql, span=SourceSpan(start, start + 1))


_DEEPER = {**dict.fromkeys(b"([{", 1), **dict.fromkeys(b")]}", -1)}
