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
from ssduck.database.schemas import Schemas
from ssduck.database.statement import NAME_PREFIX
from ssduck.database.worlds import WorldRegistry
from ssduck.errors import SelectScriptError, SqlError
from ssduck.recording.stores.history_sql import quoted
from ssduck.recording.stores.model_tables import RUN_SCHEMA

# The types of statements that change no catalog.
_HARMLESS = frozenset(
    ("SELECT", "WITH", "EXPLAIN", "INSERT", "UPDATE", "DELETE", "MERGE_INTO", "COPY")
)
# Statements that may read a record, and the part of each that names what it writes.
_WRITTEN = {
    "CREATE": re.compile(r"^.*?(?=\b(?:AS|SELECT|FROM)\b|$)", re.IGNORECASE | re.DOTALL),
    "COPY": re.compile(r"^.*?(?=\b(?:SELECT|FROM|TO)\b|$)", re.IGNORECASE | re.DOTALL),
    "INSERT": re.compile(r"\bINTO\s+\S+", re.IGNORECASE),
}
_RECORDS = "SELECT schema_name FROM duckdb_schemas() WHERE contains(schema_name, $1)"
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
    """The views, macros and prepared statements of ssduck's own.

    Args:
        connection: the connection to the database.
        worlds: the worlds of the database.
        schemas: the schemas of their tables.
    """

    def __init__(self, connection: Connection, worlds: WorldRegistry, schemas: Schemas) -> None:
        self._connection = connection
        self._worlds = worlds
        self._schemas = schemas

    @contextmanager
    def guarded(self, sql: str) -> Iterator[None]:
        """Runs a user's statements that are more than a query.

        Raises:
            SqlError: they would change what ssduck keeps, or have changed views, which are made
                anew; or they begin a transaction and do not end it.
        """
        statements = self._connection.statements(sql) or []
        kinds = [kind for kind, _ in statements]
        self._check_names(statements)
        _check_transactions(statements)
        if _HARMLESS.issuperset(kinds):
            yield
            return
        before = self._entries()
        try:
            yield
        except SelectScriptError:
            if "TRANSACTION" in kinds:
                with suppress(SelectScriptError):
                    self._connection.run("ROLLBACK")
            self._restore(before)
            raise
        error = self._restore(before)
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
            part = _WRITTEN[kind].search(text) if kind in _WRITTEN else None
            named = (text if part is None else part.group()).casefold()
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

    def _restore(self, before: dict[tuple[str, str], int]) -> SqlError | None:
        """Makes what has changed anew; returns an error that says so, or None for no change."""
        for (database,) in self._connection.internal_rows(_DATABASES):
            if database in self._worlds.by_schema:
                self._connection.run(f"DETACH {quoted(database)}")
                return SqlError(
                    f"{database!r} is the name of a world: attach the database under another name"
                )
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
