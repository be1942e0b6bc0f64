"""Runs users' statements; over batches, one reads tables of all environments, not of a tick."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

import pyarrow as pa
from sqlglot import exp

from ssduck.database.binding import BoundWorld
from ssduck.database.connection import NO_RANGE_JOINS, Connection, Parameters
from ssduck.database.fetched_rows import FetchedRows
from ssduck.database.instances import NO_IE_JOINS
from ssduck.database.own_catalog import OwnCatalog
from ssduck.database.plans import NAME_PREFIX, PreparedPlans
from ssduck.database.relation_rewriting import parsed, start_of
from ssduck.database.schemas import Schemas, with_view_columns
from ssduck.database.statement_names import (
    COMMENT,
    ReadData,
    StatementWords,
    WorldNames,
    named_worlds,
    source_tables,
    words_of,
)
from ssduck.database.user_statements import UserStatement, UserStatements
from ssduck.database.worlds import WorldRegistry, pinned_worlds
from ssduck.errors import LimitError, SqlError, UnsupportedError
from ssduck.recording.stores.history_sql import quoted
from ssduck.recording.stores.model_tables import RUN_SCHEMA
from ssduck.schema import HISTORIES, MARGINS, MASSES, MODELS, ON_DEMAND, TABLES
from ssduck.sql.relations.registry import RELATIONS
from ssduck.sql.user_sql import Edit, edited
from ssduck.world.batches.batch_world import BatchWorld

_RELATIONS = {name.lower(): name for name in RELATIONS}
# Returns a table of a batch with the environment of each row, by the batch and the name.
BatchTable: TypeAlias = Callable[[BatchWorld, str], pa.Table]


@dataclass(frozen=True)
class BatchStatement:
    """A query that reads batches."""

    text: str  # its text, in which their tables have names of their own
    tables: Mapping[str, tuple[BatchWorld, str]]  # the batch and the table of each of these names


def over_batches(
    sql: str, names: WorldNames, worlds: Mapping[str, BoundWorld]
) -> BatchStatement | None:
    """Returns a statement as a query that reads batches; None if it is no such query."""
    tree = parsed(sql)
    edits: list[Edit] = []
    tables: dict[str, tuple[BatchWorld, str]] = {}
    for table in () if tree is None else source_tables(tree):
        live, schema = names.live_table(table), names.schema(table)
        world = worlds[schema].reference() if schema is not None and schema in worlds else None
        start = start_of(table)
        if live is None or schema is None or start is None or not isinstance(world, BatchWorld):
            continue
        name = f"environments of {schema}: {live.name}"
        tables[name] = world, live.name
        rows = with_view_columns(live, f"SELECT * FROM {quoted(name)}", schema)  # noqa: S608
        alias = "" if table.alias else f" AS {quoted(table.name)}"
        edits.append(Edit(start, table.this.meta["end"] + 1, f"({rows}){alias}"))
    if tree is None or not tables:
        return None
    _check_calls(tree)
    return BatchStatement(edited(sql, edits), tables)


def _check_calls(tree: exp.Expr) -> None:
    """Checks that a query calls no relation, which is of the rows of one world."""
    for call in tree.find_all(exp.Anonymous):
        name = _RELATIONS.get(call.name.lower())
        if name is not None:
            raise UnsupportedError(
                f"in raw SQL, {name}(…) is of one world, and this reads a batch: select the rows "
                f'with ss.eval("SELECT env, … WHERE {name}(…) AS arrow;"), and ss.register makes '
                "them a table"
            )


_NAME = r'(?:"[^"]*"|\w+)'
# What a statement defines, changes or drops, with the schemas before it.
_DEFINED = re.compile(
    r"\b(?:TABLE|VIEW|MACRO|FUNCTION)\s+(?:IF\s+(?:NOT\s+)?EXISTS\s+)?"
    rf"({_NAME}(?:\s*\.\s*{_NAME})*)",
    re.IGNORECASE,
)
_NAMES = frozenset(
    name.lower()
    for name in (*TABLES, *(table.history_view for table in HISTORIES.values()), *RELATIONS)
)
# What a world reads for a statement; the other tables are always there.
READ_ON_REQUEST = frozenset((*ON_DEMAND, MASSES, MARGINS))
_ATTACHES = re.compile(r"\bATTACH\b", re.IGNORECASE)
_MERGE_JOINS = re.compile(r"merge_join|\bRESET\b", re.IGNORECASE)
# Statements that show tables, without those in which ssduck keeps ticks.
_SHOW = re.compile(
    r"\s*(?:SHOW\s+TABLES|(?P<all>SHOW\s+ALL\s+TABLES|SHOW|DESCRIBE)|(?P<schemas>SHOW\s+SCHEMAS))"
    r"\s*;?\s*",
    re.IGNORECASE,
)
_NESTED_SHOW = re.compile(r"\(\s*(SHOW\s+(?:ALL\s+)?TABLES)\s*\)", re.IGNORECASE)
_IS_SHOWN = rf"NOT system.main.regexp_matches(name, '^(world \d+: |{NAME_PREFIX})')"
_SHOWN = f"FROM (SHOW TABLES) WHERE {_IS_SHOWN} ORDER BY name"
_IS_NO_RUN = rf"NOT system.main.regexp_matches({{}}, '{RUN_SCHEMA}\d+$')"
_ALL_SHOWN = (
    f"FROM (SHOW ALL TABLES) WHERE {_IS_NO_RUN.format('schema')} "
    f"AND (database <> 'temp' OR {_IS_SHOWN}) ORDER BY database, schema, name"
)
# The names of what users have defined in the schema that comes before that of the first world.
_OWN_NAMES = (
    "SELECT lower(table_name) FROM duckdb_tables() WHERE NOT internal AND schema_name = 'main' "
    "UNION SELECT lower(view_name) FROM duckdb_views() WHERE NOT internal AND schema_name = 'main' "
    "UNION SELECT lower(function_name) FROM duckdb_functions() "
    "WHERE NOT internal AND schema_name = 'main' AND database_name <> 'temp'"
)


class RawSql:
    """Runs users' statements.

    A view or a prepared statement reads its tables under another name; so the tables in such a
    statement are `persistent`: they count for all later ones.

    Attributes:
        statements: the queries that are known.
        record_folders: the absolute paths of records that views read when files are off.
        batch_table: makes the tables of batches, once there is one.
    """

    def __init__(
        self,
        connection: Connection,
        plans: PreparedPlans,
        persistent: set[str],
        worlds: WorldRegistry,
        schemas: Schemas,
        lock: threading.RLock,
    ) -> None:
        self._own_catalog = OwnCatalog(connection, worlds, schemas)
        self._connection = connection
        self._persistent = persistent
        self._worlds = worlds
        self._schemas = schemas
        self._lock = lock
        self.statements = UserStatements(connection, plans, worlds.by_schema, worlds.settle)
        self.record_folders: list[Path] = []
        self.batch_table: BatchTable | None = None
        self._is_sealed = False
        # Whether a statement may have changed the schemas that may be omitted.
        self._search_path_changes = False
        self._world_names: WorldNames | None = None
        # The version of the worlds that `_world_names` are of.
        self._version = 0
        # The tables and relations that users' statements have defined anew.
        self._redefined: set[str] = set()
        # A file may have tables and macros from before.
        self._may_have_own_names = connection.is_file
        # Whether DuckDB may plan range joins.
        self._has_range_joins = connection.meter.limits.files
        # Whether the file has views and macros of users, and whether those of a record were noted.
        self._has_stored_queries = self._is_record_noted = False
        if connection.is_file:
            self._note_stored_queries(of_attached=False)

    def rows(self, sql: str, parameters: Parameters) -> FetchedRows | pa.Table:
        """Returns all rows of a user's statement, for which the tables that it names are read."""
        if self._worlds.has_batches:
            query = over_batches(sql, self._names(), self._worlds.by_schema)
            if query is not None:
                return self._batch_rows(sql, query, parameters)
        statement = None if parameters else self._ready(sql)
        if statement is not None and statement.reads is not None:
            with pinned_worlds(self._lock, self._worlds, statement.reads, is_settled=False):
                self._worlds.write_rows()
                assert self._world_names is not None
                return self.statements.rows(statement, None, self._world_names)
        self._confine(sql)
        words = words_of(sql)
        if words.stores_a_query:
            self._persistent |= words.tables
        known = self.statements.known(sql)
        tables = words.tables | self._persistent
        if known is not None:
            tables -= known.unread
        reads = ReadData(tables, self._read_worlds(words))
        with pinned_worlds(self._lock, self._worlds, reads):
            if self._names_all(sql, words):
                self._describe(words, is_all=False)
                try:
                    return self._pinned_rows(sql, parameters, words, reads)
                except SqlError as error:
                    if not error.is_refused:
                        raise
                    self._describe_after(error, words)
            else:
                self._describe(words)
            return self._pinned_rows(sql, parameters, words, reads)

    def _ready(self, sql: str) -> UserStatement | None:
        """Returns a query that has run before and only has to be executed; None for another."""
        is_known = self._world_names is not None and self._version == self._worlds.version
        return self.statements.ready(sql) if is_known and not self._search_path_changes else None

    def _batch_rows(self, sql: str, query: BatchStatement, parameters: Parameters) -> pa.Table:
        """Returns the rows of a user's query that reads batches, and perhaps other worlds."""
        self._confine(sql)
        assert self.batch_table is not None, "a batch is bound"
        tables = {name: self.batch_table(*table) for name, table in query.tables.items()}
        reads = ReadData(words_of(sql).tables, self._worlds.single_worlds())
        try:
            for name, table in tables.items():
                self._connection.register(name, table)
            with pinned_worlds(self._lock, self._worlds, reads):
                return self._connection.table(query.text, parameters)
        finally:
            for name in tables:
                self._connection.unregister(name)

    def _read_worlds(self, words: StatementWords) -> list[int] | None:
        """Returns the serial numbers of the worlds that a statement may read; None for all."""
        self._search_path_changes |= words.changes_search_path
        named = named_worlds(words, self._worlds.bound)
        if not (self._persistent or self._search_path_changes or words.stores_a_query):
            return named
        if not self._worlds.has_batches or self._has_users_queries:
            return None
        # No query is stored that reads a batch, so that a statement that reads one names it.
        return [*self._worlds.single_worlds(), *named]

    def _confine(self, sql: str) -> None:
        """Checks a user's statement; switches files off before the first one, after records."""
        limits = self._connection.meter.limits
        if not (limits.files or self._is_sealed):
            self.seal()
        is_refused = limits.select_only and not self._is_query(sql)
        if is_refused and self._connection.statements(sql) is not None:  # DuckDB can parse it
            raise LimitError(
                "SQL is one SELECT here, which changes nothing; PIVOT names its values: "
                "PIVOT t ON x IN ('a', 'b') USING count(*) (Limits: select_only)"
            )

    def seal(self, memory: int | None = None) -> None:
        """Switches files and settings off, and perhaps limits DuckDB's memory, bytes."""
        self._connection.seal(self.record_folders, memory)
        self._is_sealed = True

    def _names_all(self, sql: str, words: StatementWords) -> bool:
        """Checks whether a statement names all views and macros that it needs."""
        return not (
            self._schemas.has_comments
            or self._has_users_queries
            or words.reads_catalog
            or not self._is_query(sql)
        )

    def _describe(self, words: StatementWords, *, is_all: bool = True) -> None:
        """Creates the views, macros and comments that a user's statement may need."""
        worlds = self._worlds
        schemas = list(worlds.by_schema)
        only = schemas[0] if len(worlds.named) == 1 else None
        self._schemas.provide(words.words, schemas, only, worlds.records if is_all else None)
        if words.reads_recorded_masses:
            for bound in worlds.bound:
                if bound.history is not None and bound.reference() is not None:
                    bound.history.record.warn_of_masses()

    def _describe_after(self, refused: SqlError, words: StatementWords) -> None:
        """Creates all views and macros, as DuckDB's message suggests the names that there are."""
        self._describe(words)
        try:
            self._connection.meter.check_time()
        except LimitError:
            raise refused from refused.__cause__

    @property
    def _has_users_queries(self) -> bool:
        """Whether a file has views or macros of users, which may call relations."""
        if self._connection.has_attached and not self._is_record_noted:
            self._is_record_noted = True
            self._note_stored_queries(of_attached=True)
        return self._has_stored_queries

    def _is_query(self, sql: str) -> bool:
        """Checks whether a text is a single query."""
        self._names()
        return self.statements.statement(sql) is not None

    def _pinned_rows(
        self, sql: str, parameters: Parameters, words: StatementWords, reads: ReadData
    ) -> FetchedRows | pa.Table:
        """Returns all rows of a user's statement, whose worlds are pinned."""
        sql = _without_ticks(sql)
        if not (words.has_semi_joins and self._has_range_joins):
            return self._rows(sql, parameters, reads, is_kept=True)
        # Of two range conditions, a SEMI or ANTI join is an IE join in DuckDB 2.0, which may drop
        # rows, and invalidates the database at the second run of a prepared statement.
        self._connection.run(NO_RANGE_JOINS)
        try:
            return self._rows(sql, parameters, reads, is_kept=False)
        finally:
            if words.stores_a_query:  # any later statement may read it
                self._has_range_joins = False
            elif self._connection.is_open:
                self._connection.run("RESET nested_loop_join_threshold")

    def _rows(
        self, sql: str, parameters: Parameters, reads: ReadData, *, is_kept: bool
    ) -> FetchedRows | pa.Table:
        names = self._names()
        statement = self.statements.statement(sql)
        if statement is not None and not self._search_path_changes:
            rows = self.statements.rows(statement, parameters, names)
            if is_kept:
                statement.reads = replace(
                    reads, tables=(reads.tables - statement.unread) & READ_ON_REQUEST
                )
            return rows
        if statement is not None:
            return self._connection.table(sql, parameters)
        try:
            with self._own_catalog.guarded(sql):
                return self._connection.table(sql, parameters)
        finally:
            if not self._connection.meter.limits.select_only:  # a SELECT changes nothing
                self._update(sql)

    def _names(self) -> WorldNames:
        """Returns the names of the worlds; forgets all statements when these have changed."""
        worlds = self._worlds
        if self._world_names is None or self._version != worlds.version:
            self.statements.forget()
            first = next((bound.schemas[0] for bound in worlds.bound if bound.schemas), None)
            schemas = {name.lower(): bound.schemas[0] for name, bound in worlds.by_schema.items()}
            only = first if len(set(schemas.values())) == 1 else None
            own = self._own_names()
            self._world_names = WorldNames(schemas, first, only, _NAMES & own, own)
            self._version = worlds.version
        return self._world_names

    def _own_names(self) -> frozenset[str]:
        own: set[str] = set()
        if self._may_have_own_names:
            own = {name for (name,) in self._connection.internal_rows(_OWN_NAMES)}
        return frozenset(own | self._redefined)

    def forget_names(self) -> None:
        """Forgets what names mean, as there is a further table."""
        self._world_names = None
        self.statements.forget()

    def _update(self, sql: str) -> None:
        """Takes note of a statement that may have changed what names and settings mean."""
        self._world_names = None
        self._may_have_own_names = True
        defined = _DEFINED.findall(COMMENT.sub(" ", sql))
        self._redefined |= {name.rpartition(".")[2].strip().strip('"').lower() for name in defined}
        if _ATTACHES.search(sql) and self._connection.is_open:
            self._note_stored_queries(of_attached=True)
        if _MERGE_JOINS.search(sql) and self._connection.is_open:
            self._connection.run(NO_IE_JOINS)

    def _note_stored_queries(self, *, of_attached: bool) -> None:
        """Takes note of what views and macros from before read: any statement may use them."""
        rows = self._connection.internal_rows(_MACROS, [of_attached])
        if self._connection.internal_rows(_HAS_VIEWS, [of_attached, _OWN_VIEWS]):
            rows += self._connection.internal_rows(_VIEWS, [of_attached, _OWN_VIEWS])
        for (text,) in rows:
            self._has_stored_queries = True
            words = words_of(text)
            self._schemas.note_stored(words.words)
            self._persistent |= words.tables
            if words.has_semi_joins and self._has_range_joins:
                self._connection.run(NO_RANGE_JOINS)
                self._has_range_joins = False


def _without_ticks(sql: str) -> str:
    """Returns a statement that shows tables without those in which ssduck keeps ticks."""
    if (shown := _SHOW.fullmatch(COMMENT.sub(" ", sql))) is not None:
        if shown["schemas"]:
            return f"FROM (SHOW SCHEMAS) WHERE {_IS_NO_RUN.format('schema_name')}"
        return _ALL_SHOWN if shown["all"] else _SHOWN
    if "'" in sql or not _NESTED_SHOW.search(sql):  # it may be a part of a text
        return sql
    return _NESTED_SHOW.sub(
        lambda part: f"({_ALL_SHOWN if 'all' in part[1].lower() else _SHOWN})", sql
    )


_OWN_VIEWS = [
    *(table.history_view for table in HISTORIES.values()),
    *(table.model_view for table in MODELS.values()),
]
_OF_VIEWS = (
    "FROM duckdb_views() WHERE NOT internal AND NOT temporary "
    "AND (database_name <> current_database()) = $1 AND NOT list_contains($2, view_name)"
)
# DuckDB writes the texts of all views for any of them, and each episode has some of ssduck's.
_HAS_VIEWS = f"SELECT view_name {_OF_VIEWS} LIMIT 1"
_VIEWS = f"SELECT sql {_OF_VIEWS}"
_MACROS = (
    "SELECT macro_definition FROM duckdb_functions() "
    "WHERE NOT internal AND macro_definition IS NOT NULL AND database_name <> 'temp' "
    "AND (database_name <> current_database()) = $1"
)
