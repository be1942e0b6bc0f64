"""Finds the tables and worlds that users' statements refer to, by the words in them."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from functools import lru_cache

import duckdb

from ssduck.database.binding import BoundWorld
from ssduck.database.macros import TABLE_MACROS
from ssduck.errors import SqlError
from ssduck.formatting import short_repr
from ssduck.schema import MARGINS, MASSES, TABLES
from ssduck.sql.relations.registry import RELATIONS

# The tables that are read for a column.
_READ = {"mass": MASSES, "margin": MARGINS}


def _with_read_columns(table: str) -> frozenset[str]:
    """Returns a table, and the tables read for its columns."""
    read = (_READ[name] for name in TABLES[table].names if name in _READ)
    return frozenset((TABLES[table].source, *read))


_WORLD_TABLES = {name.lower(): name for name in TABLES}
_PAIR_TABLES = frozenset(table.name for table in TABLE_MACROS)
_RELATIONS = {relation.name.lower(): relation for relation in RELATIONS.values()}
_WORD = re.compile(r"\w+", re.ASCII)
# Words with no schema before them.
_UNQUALIFIED = re.compile(r'(?<!\.)(?<!\.")\b\w+', re.ASCII)
_OF_RECORDS = re.compile(r"_(?:history|model)$")
_BETWEEN = r"(?:\s|/\*(?:(?!\*/).)*\*/|--[^\n]*(?:\n|\Z))*"
# A query of WITH that changes rows or writes a file.
_CHANGING = re.compile(
    rf"[()]{_BETWEEN}(?:INSERT|UPDATE|DELETE|MERGE|COPY|EXECUTE)\b", re.IGNORECASE | re.DOTALL
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
# What reads the catalog, or runs a text that an expression makes.
_READS_CATALOG = re.compile(
    r"\b(?:duckdb_\w+|pg_\w+|pragma_\w+|sqlite_\w+|information_schema|show|describe|summarize|query|"
    r"query_table|sql_auto_complete|json_execute_serialized_sql)\b|(?:^|[(/\n])\s*desc\b",
    re.IGNORECASE,
)
# The words by which the schema of another world than the first may be omitted.
_CHANGES_SEARCH_PATH = re.compile(r"\b(USE|search_path|schema)\b", re.IGNORECASE)
COMMENT = re.compile(r"/\*.*?\*/|--[^\n]*", re.DOTALL)


def _tables_of(word: str) -> frozenset[str]:
    """Returns the tables that a word refers to: a table's name, or a relation that reads tables."""
    if word in _WORLD_TABLES:
        return _with_read_columns(_WORLD_TABLES[word])
    if word in _PAIR_TABLES:
        return frozenset(("shapes",))
    relation = _RELATIONS.get(word)
    return relation.macro_inputs if relation is not None and relation.tables else frozenset()


@dataclass(frozen=True)
class StatementWords:
    """What the words in a user's statement say.

    Attributes:
        words: the words, in small letters.
        tables: the tables that they refer to.
        stores_a_query: whether it makes a view, a macro or a prepared statement.
        changes_search_path: whether it may change the schemas that may be omitted.
        reads_recorded_masses: whether it reads recorded masses: the column, or all columns.
        reads_catalog: whether it may read the catalog, or names that its text does not have.
        omits_schema: whether a table has no schema before it.
        has_semi_joins: whether it may have SEMI or ANTI joins.
        folded: its text in small letters.
    """

    words: frozenset[str]
    tables: frozenset[str]
    stores_a_query: bool
    changes_search_path: bool
    reads_recorded_masses: bool
    reads_catalog: bool
    omits_schema: bool
    has_semi_joins: bool
    folded: str


def types_and_texts(
    connection: duckdb.DuckDBPyConnection, sql: str
) -> list[tuple[str, str]] | None:
    """Returns the type and the text of each statement in a text; None if it is no SQL.

    A type is the name of one of `duckdb.StatementType`. That of a SELECT is WITH if a query of WITH
    may change rows or write a file.
    """
    try:
        return [_type_and_text(statement) for statement in connection.extract_statements(sql)]
    except (duckdb.Error, TypeError):  # TypeError: it is no text in UTF-8
        return None
    except ValueError as error:  # UPDATE EXTENSIONS
        shown = short_repr(" ".join(sql.split()))
        raise SqlError(f"SQL has no such statement here: {shown}") from error


def _type_and_text(statement: duckdb.Statement) -> tuple[str, str]:
    name, text = statement.type.name, statement.query
    if name == "SELECT" and "with" in text.casefold() and _CHANGING.search(text) is not None:
        name = "WITH"
    return name, text


@lru_cache(maxsize=256)
def words_of(sql: str) -> StatementWords:
    """Returns what the words in a statement say."""
    words = frozenset(word.lower() for word in _WORD.findall(sql))
    unqualified = {_OF_RECORDS.sub("", word.lower()) for word in _UNQUALIFIED.findall(sql)}
    return StatementWords(
        words=words,
        tables=frozenset(table for word in words for table in _tables_of(word)),
        stores_a_query=_STORES_A_QUERY.search(sql) is not None,
        changes_search_path=_CHANGES_SEARCH_PATH.search(sql) is not None,
        reads_recorded_masses=_MASS_HISTORIES.search(sql) is not None
        and _MASS_OR_ALL.search(sql) is not None,
        reads_catalog=_READS_CATALOG.search(sql) is not None,
        omits_schema=any(map(_tables_of, unqualified)),
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
        """Returns the serial numbers of the worlds that a statement may read; None for all."""
        self.search_path_changes |= words.changes_search_path
        if self.persistent or self.search_path_changes or words.stores_a_query:
            return None
        return self.named_worlds(words, bound)

    def named_worlds(self, words: StatementWords, bound: Sequence[BoundWorld]) -> list[int]:
        """Returns the serial numbers of the worlds whose tables a statement may name.

        The schema of the first world may be omitted: it is read if a table has no schema.
        """
        return [
            world.serial
            for number, entry in enumerate(bound)
            if (world := entry.reference()) is not None
            and (
                (number == 0 and words.omits_schema)
                or any(schema.casefold() in words.folded for schema in entry.schemas)
            )
        ]
