"""Finds the tables and worlds that users' statements refer to, by the words in them."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from functools import lru_cache

import duckdb

from ssduck.database.binding import BoundWorld
from ssduck.database.macros import TABLE_MACROS, relations_with_tables
from ssduck.errors import LimitError, SourceSpan
from ssduck.schema import MARGINS, MASSES, TABLES
from ssduck.sql.relations.registry import RELATIONS

# The tables that are read for a column.
_READ = {"mass": MASSES, "margin": MARGINS}


def _with_read_columns(table: str) -> frozenset[str]:
    """Returns a table, and the tables read for its columns."""
    return frozenset((table, *(_READ[name] for name in TABLES[table].names if name in _READ)))


# The tables that a word in a statement refers to: a table's name, or a relation that reads tables.
_TABLES_OF = {
    **{name.lower(): _with_read_columns(name) for name in TABLES},
    **{relation.name.lower(): relation.macro_inputs for relation in relations_with_tables()},
    **{table.name: frozenset(("shapes",)) for table in TABLE_MACROS},
}
_TABLE_WORDS = re.compile(rf"\b({'|'.join(_TABLES_OF)})\b", re.IGNORECASE | re.ASCII)
# The same and the views of histories and models, where no schema stands before it.
_UNQUALIFIED_TABLE = re.compile(
    rf'(?<!\.)(?<!\.")\b({"|".join(_TABLES_OF)})(_history|_model)?\b', re.IGNORECASE | re.ASCII
)
# Relations that read no table become macros of a world's schema when a statement calls them so.
_FORMULAS = {
    relation.name.lower(): relation.name for relation in RELATIONS.values() if not relation.tables
}
_BETWEEN = r"(?:\s|/\*.*?\*/|--[^\n]*)*"
_QUALIFIED_CALL = re.compile(
    rf'\.{_BETWEEN}"?({"|".join(_FORMULAS)})"?{_BETWEEN}\(',
    re.IGNORECASE | re.ASCII | re.DOTALL,
)
_STORES_A_QUERY = re.compile(r"\b(CREATE|PREPARE)\b", re.IGNORECASE)
_SEMI_JOINS = re.compile(r"\b(SEMI|ANTI)\b", re.IGNORECASE)
_MASS_TABLES = [name for name in TABLES if MASSES in _with_read_columns(name)]
_MASS_HISTORIES = re.compile(
    rf"\b({'|'.join(_MASS_TABLES)})_(history|model)\b", re.IGNORECASE | re.ASCII
)
# The column, or all columns: a star outside count(*), or FROM without SELECT.
_MASS_OR_ALL = re.compile(
    r"\bmass\b|(?<!count\()\*|(^|\()\s*FROM\b", re.IGNORECASE | re.ASCII | re.MULTILINE
)
# The words by which the schema of another world than the first may be omitted.
_CHANGES_SEARCH_PATH = re.compile(r"\b(USE|search_path|schema)\b", re.IGNORECASE)

# DuckDB's parser, which cannot be interrupted, takes long for more words or more nested brackets.
MAX_TOKENS = 200_000
MAX_BRACKETS = 100


@dataclass(frozen=True)
class StatementWords:
    """What the words in a user's statement say.

    Attributes:
        tables: the tables that they refer to.
        stores_a_query: whether it makes a view, a macro or a prepared statement.
        changes_search_path: whether it may change the schemas that may be omitted.
        formulas: the relations without tables that it may call with a schema before them.
        reads_recorded_masses: whether it reads recorded masses: the column, or all columns.
        omits_schema: whether a table has no schema before it.
        has_semi_joins: whether it may have SEMI or ANTI joins.
        folded: its text in small letters.
    """

    tables: frozenset[str]
    stores_a_query: bool
    changes_search_path: bool
    formulas: frozenset[str]
    reads_recorded_masses: bool
    omits_schema: bool
    has_semi_joins: bool
    folded: str


@lru_cache(maxsize=256)
def words_of(sql: str) -> StatementWords:
    """Returns what the words in a statement say."""
    words = {word.lower() for word in _TABLE_WORDS.findall(sql)}
    return StatementWords(
        tables=frozenset(table for word in words for table in _TABLES_OF[word]),
        stores_a_query=_STORES_A_QUERY.search(sql) is not None,
        changes_search_path=_CHANGES_SEARCH_PATH.search(sql) is not None,
        formulas=frozenset(qualified_formulas(sql)),
        reads_recorded_masses=_MASS_HISTORIES.search(sql) is not None
        and _MASS_OR_ALL.search(sql) is not None,
        omits_schema=_UNQUALIFIED_TABLE.search(sql) is not None,
        has_semi_joins=_SEMI_JOINS.search(sql) is not None,
        folded=sql.casefold(),
    )


@dataclass(frozen=True)
class ReadData:
    """The data that a statement may read.

    Attributes:
        tables: the tables.
        worlds: the serial numbers of the worlds; None for all.
    """

    tables: AbstractSet[str]
    worlds: Collection[int] | None


class ReferencedTables:
    """The tables and worlds that users' statements refer to.

    A view or a prepared statement reads its tables under another name; so the tables in such a
    statement count for all later ones.

    Attributes:
        persistent: the tables that count for all later statements.
        search_path_changes: whether a statement may have changed the schemas that may be omitted.
    """

    def __init__(self) -> None:
        self.persistent: set[str] = set()
        self.search_path_changes = False

    def tables(self, words: StatementWords) -> AbstractSet[str]:
        """Returns the tables that a statement may read."""
        if words.stores_a_query:
            self.persistent |= words.tables
        return words.tables | self.persistent if self.persistent else words.tables

    def worlds(self, words: StatementWords, bound: Sequence[BoundWorld]) -> list[int] | None:
        """Returns the serial numbers of the worlds that a statement may read; None for all.

        The schema of the first world may be omitted: it is read if a table has no schema.
        """
        self.search_path_changes |= words.changes_search_path
        if self.persistent or self.search_path_changes or words.stores_a_query:
            return None
        return [
            world.serial
            for number, entry in enumerate(bound)
            if (world := entry.reference()) is not None
            and (
                (number == 0 and words.omits_schema)
                or any(schema.casefold() in words.folded for schema in entry.schemas)
            )
        ]


def qualified_formulas(sql: str) -> set[str]:
    """Returns the relations without tables that a statement may call with a schema before them."""
    return {_FORMULAS[name.lower()] for name in _QUALIFIED_CALL.findall(sql)}


def check_length(sql: str) -> None:
    """Checks that DuckDB can parse a statement in a short time; parsing cannot be interrupted.

    Raises:
        LimitError: the statement is too long, or nested too deeply.
    """
    letters = sql.encode("utf-8", "replace")  # DuckDB rejects invalid characters itself
    words = duckdb.tokenize(letters.decode())
    if len(words) > MAX_TOKENS:
        raise LimitError(f"the SQL has {len(words)} words; under a limit it may have {MAX_TOKENS}")
    depth = 0
    for offset, _ in words:
        depth += _NESTING.get(letters[offset], 0)
        if depth > MAX_BRACKETS:
            start = len(letters[:offset].decode())
            message = f"the SQL is nested deeper than {MAX_BRACKETS} brackets"
            raise LimitError(message, text=sql, span=SourceSpan(start, start + 1))


_NESTING = {**dict.fromkeys(b"([{", 1), **dict.fromkeys(b")]}", -1)}
