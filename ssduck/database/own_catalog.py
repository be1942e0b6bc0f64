"""Keeps users' statements from breaking what ssduck has in DuckDB's catalog.

ssduck reads worlds through views in their schemas, stores recorded ticks in schemas of their own,
and keeps prepared statements. A statement that would change stored ticks is refused before it runs.
What others change by mistake is made anew, and they end with an error.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress

from sqlglot import exp

from ssduck.database.binding import BoundWorld
from ssduck.database.connection import Connection
from ssduck.database.plans import NAME_PREFIX
from ssduck.database.schemas import Schemas
from ssduck.database.statement_names import COMMENT
from ssduck.database.worlds import WorldRegistry
from ssduck.errors import SelectScriptError, SqlError
from ssduck.recording.stores.history_sql import quoted
from ssduck.recording.stores.model_tables import RUN_SCHEMA

# The types of statements that change no catalog.
_HARMLESS = frozenset(
    ("SELECT", "WITH", "EXPLAIN", "INSERT", "UPDATE", "DELETE", "MERGE_INTO", "COPY")
)
# Comments and texts; in a name between quotes, neither begins.
_NO_CODE = re.compile(r"""("(?:[^"]|"")*")|'(?:[^']|'')*'|--[^\n]*|/\*.*?\*/""", re.DOTALL)
_RECORDS = "SELECT schema_name FROM duckdb_schemas() WHERE contains(schema_name, $1)"
# What sets the schemas that may be omitted, and the values that are what is written.
_SETS_PATH = re.compile(
    r'\s*(?:SET|PRAGMA)\s+(?:(?:SESSION|LOCAL|GLOBAL)\s+)?"?(schema|search_path)"?\s*(?:=|TO\b)?'
    r"\s*(.*?)[\s;]*",
    re.IGNORECASE | re.DOTALL,
)
_WRITTEN_OUT = re.compile(r"""'[^']*'|"[^"]*"|\w+|\$\$\w*\$\$""")
_BEGINS = re.compile(r"\s*(BEGIN|START)\b", re.IGNORECASE)
# The views and macros in worlds' schemas, and the views of their rows.
_CATALOG = """
SELECT schema_name, view_name, view_oid FROM duckdb_views() WHERE NOT internal
UNION ALL
SELECT schema_name, function_name, function_oid FROM duckdb_functions()
WHERE NOT internal AND database_name = current_database()
"""
_DATABASES = "SELECT database_name FROM duckdb_databases()"


class OwnCatalog:
    """The views, macros and prepared statements of ssduck's own."""

    def __init__(self, connection: Connection, worlds: WorldRegistry, schemas: Schemas) -> None:
        self._connection = connection
        self._worlds = worlds
        self._schemas = schemas

    @contextmanager
    def guarded(self, sql: str) -> Iterator[None]:
        """Runs a user's statements that are more than a query."""
        statements = self._connection.statements(sql) or []
        statements = [(_kind_run(kind, text), text) for kind, text in statements]
        kinds = [kind for kind, _ in statements]
        self._check_names(statements)
        _check_search_path(statements)
        _check_transactions(statements)
        if _HARMLESS.issuperset(kinds):
            yield
            return
        before, database = self._entries(), self._connection.name
        try:
            yield
        except SelectScriptError:
            if "TRANSACTION" in kinds:
                with suppress(SelectScriptError):
                    self._connection.run("ROLLBACK")
            self._restore(before, database)
            raise
        error = self._restore(before, database)
        if error is not None:
            raise error

    def _check_names(self, statements: Sequence[tuple[str, str]]) -> None:
        """Checks that statements name no schema of recorded ticks, and no statement of ssduck's."""
        if all(kind in ("SELECT", "EXPLAIN") for kind, _ in statements):
            return
        rows = self._connection.internal_rows(_RECORDS, [RUN_SCHEMA])
        for kind, text in statements:
            if kind in ("SELECT", "EXPLAIN"):
                continue
            named = text if kind == "SET" else _NO_CODE.sub(r" \1 ", text)
            named = named.casefold()
            if NAME_PREFIX.casefold() in named:
                raise SqlError(f"names that begin with {NAME_PREFIX!r} are ssduck's own")
            for (schema,) in rows:
                if re.search(rf"(?<!\w){re.escape(schema.casefold())}(?!\w)", named):
                    raise SqlError(
                        f"the schema {schema!r} holds what ssduck has recorded, and SQL may only "
                        "read it: SELECT of the views whose names end in _history has its rows; "
                        "ss.record(world, None) drops a record in memory"
                    )

    def _entries(self) -> dict[tuple[str, str], int]:
        """Returns the numbers of the entries in worlds' schemas, and of the views of their rows."""
        rows = self._connection.internal_rows(_CATALOG)
        keys = tuple(f"{bound.key}:" for bound in self._worlds.bound)
        return {
            (schema, name): number
            for schema, name, number in rows
            if schema in self._worlds.by_schema or name.startswith(keys)
        }

    def _restore(self, before: dict[tuple[str, str], int], database: str) -> SqlError | None:
        """Makes what has changed anew; returns an error that says so, or None for no change."""
        for (attached,) in self._connection.internal_rows(_DATABASES):
            if attached in self._worlds.by_schema:
                self._connection.run(f"DETACH {quoted(attached)}")
                return SqlError(
                    f"{attached!r} is the name of a world: attach the database under another name"
                )
        if (error := self._returned(database)) is not None:
            return error
        after = self._entries()
        changed = sorted(name for name, number in before.items() if after.get(name) != number)
        if not changed:
            return None
        for bound in self._worlds.bound:
            self._remake(bound)
        schema, name = changed[0]
        return SqlError(
            f"{exp.table_(name, db=schema).sql('duckdb')} is ssduck's own and was made anew: give "
            "what you create another name, and drop nothing in the schema of a world but what you "
            "have created there"
        )

    def _returned(self, name: str) -> SqlError | None:
        """Makes the worlds' database the current one again; returns an error if it was not."""
        ((current,),) = self._connection.internal_rows("SELECT current_database()")
        if current == name:
            return None
        self._connection.run(f"USE {quoted(name)}")
        self._worlds.set_search_path()
        return SqlError(
            f"{current!r} cannot be the current database, which is that of the worlds: name its "
            "tables in full, as in other.main.things"
        )

    def _remake(self, bound: BoundWorld) -> None:
        """Makes the views of a world anew."""
        for view in bound.versions:
            self._connection.unregister(view)
            self._connection.run(f"DROP VIEW IF EXISTS temp.main.{quoted(view)}")  # a user's
        bound.versions.clear()
        bound.registered = None
        self._worlds.register(bound)
        for schema in bound.schemas:
            self._schemas.forget(schema)
            self._schemas.make(schema, bound)


def _kind_run(kind: str, text: str) -> str:
    """Returns the kind of a statement; that of EXPLAIN ANALYZE, which runs it, is told apart."""
    is_run = kind == "EXPLAIN" and re.search(r"\bANALYZE\b", text, re.IGNORECASE)
    return "EXPLAIN ANALYZE" if is_run else kind


def _check_search_path(statements: Sequence[tuple[str, str]]) -> None:
    """Checks that a schema that may be omitted is written out: `_check_names` looks for it."""
    for text in (text for kind, text in statements if kind in ("SET", "PRAGMA")):
        setting = _SETS_PATH.fullmatch(COMMENT.sub(" ", text))
        if setting is not None and not _WRITTEN_OUT.fullmatch(setting[2]):
            name = setting[1].lower()
            raise SqlError(
                f"SET {name} takes a name that is written out here, as in SET {name} = 'main'"
            )


def _check_transactions(statements: Sequence[tuple[str, str]]) -> None:
    """Checks that each transaction ends in the text in which it begins."""
    is_open = False
    for text in (text for kind, text in statements if kind == "TRANSACTION"):
        begins = _BEGINS.match(text) is not None
        if begins == is_open:
            break
        is_open = begins
    else:
        if not is_open:
            return
    raise SqlError(
        "a transaction begins and ends in one call of sql: "
        "'BEGIN; INSERT …; UPDATE …; COMMIT'. A call with a single statement is one by itself"
    )
