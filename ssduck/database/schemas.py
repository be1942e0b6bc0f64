"""What is in the schemas of worlds: views of their tables, macros of relations, and comments."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from sqlglot import exp

from ssduck.database.binding import BoundWorld, WorldRecording
from ssduck.database.connection import Connection
from ssduck.database.macros import described, dropped, formulas
from ssduck.database.referenced_tables import behind_a_schema
from ssduck.recording.spec import not_recorded
from ssduck.recording.stores.duckdb import DuckDBStore
from ssduck.recording.stores.history_sql import quoted
from ssduck.schema import HISTORIES, MODELS, TABLES, Table

_HISTORY_VIEWS = {table.history_view: table for table in HISTORIES.values()}
_MODEL_VIEWS = [table.model_view for table in MODELS.values()]
# What refers to a world's buffers, as a regular expression in SQL.
_LOST = exp.Literal.string(r'"world \d+: ').sql("duckdb")

# What a file keeps that may call relations.
_KEPT_TEXTS = (
    "SELECT sql FROM duckdb_views() WHERE NOT internal AND NOT temporary UNION ALL "
    "SELECT macro_definition FROM duckdb_functions() "
    "WHERE NOT internal AND macro_definition IS NOT NULL AND database_name <> 'temp'"
)


class Schemas:
    """The schemas of worlds.

    Args:
        connection: to the database that has them.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        # Those whose relations and tables users' SQL was told of; None: not even the others.
        self._told_of: set[str] | None = None
        # The relations that look nothing up of which each schema has macros.
        self._formulas: dict[str, set[str]] = {}
        self._is_searched = False

    def make(self, name: str, bound: BoundWorld) -> None:
        """Make that of a world, or make it anew, with views of its tables."""
        schema = exp.table_(name, quoted=True)
        self._connection.run(exp.Create(this=schema, kind="SCHEMA", exists=True).sql("duckdb"))
        for table in TABLES.values():
            rows = exp.select("*").from_(exp.table_(bound.live(table.name), quoted=True))
            if table.name in bound.world.snapshot.untold:
                _refuse(rows, bound.world.snapshot.untold[table.name])
            view = _with_second_names(table, rows.sql("duckdb"))
            self._make_view(name, table.name, view)
        self.make_history(name, bound)

    def make_history(self, name: str, bound: BoundWorld) -> None:
        """Make the views of what is kept of a world, instead of those that were there."""
        if self._told_of is not None:
            self._told_of.discard(name)
        kept = bound.kept
        for table in HISTORIES.values():
            rows = None
            if kept is not None:
                waiting = bound.waiting if kept.recorder is not None else None
                rows = kept.history.select(table.name, waiting)
            if rows is None:
                refused = exp.select("*").from_(exp.table_(bound.live(table.name), quoted=True))
                _refuse(refused, not_recorded(table.name, bound.world.name))
                rows = refused.sql("duckdb")
            self._make_view(name, table.history_view, _with_second_names(table, rows))
        for view, rows in kept.history.models().items() if kept is not None else ():
            self._make_view(name, view, rows)

    def _make_view(self, schema: str, name: str, rows: str) -> None:
        view = exp.table_(name, db=schema, quoted=True).sql("duckdb")
        self._connection.run(f"CREATE OR REPLACE VIEW {view} AS {rows}")

    def describe(self, names: Sequence[str], only: str | None, recorded: Collection[str]) -> None:
        """Make the relations functions of SQL, and let it say what the tables hold.

        Args:
            names: of all schemas of worlds.
            only: that of the only world.
            recorded: those whose ticks are recorded.
        """
        if self._told_of != set(names):
            for statement in described(names, only, self._told_of, recorded):
                self._connection.run(statement)
            self._told_of = set(names)

    def make_formulas(self, sql: str, names: Sequence[str]) -> None:
        """Make the relations that look nothing up functions of a schema, where SQL calls them so.

        All of them in all schemas would take longer than a statement. What a file has kept may
        call them, too.

        Args:
            sql: a statement that is to run.
            names: of all schemas of worlds.
        """
        called = behind_a_schema(sql)
        if self._connection.is_file and not self._is_searched:
            self._is_searched = True
            for (kept,) in self._connection.own_rows(_KEPT_TEXTS):
                called |= behind_a_schema(kept)
        for name in names if called else ():
            known = self._formulas.setdefault(name, set())
            for statement in formulas(sorted(called - known), name):
                self._connection.run(statement)
            known |= called

    def drop(self, schema: str, kept: WorldRecording | None) -> None:
        """Drop one whose world is gone; in a file what was kept of it stays."""
        if self._connection.is_file:
            self.leave(schema, kept)
        else:
            place = exp.to_identifier(schema, quoted=True).sql("duckdb")
            self._connection.run(f"DROP SCHEMA IF EXISTS {place} CASCADE")
        if self._told_of is not None:
            self._told_of.discard(schema)

    def leave(self, schema: str, kept: WorldRecording | None) -> None:
        """Leave one without what needs ssduck."""
        described = schema in (self._told_of or ())
        own = self._formulas.pop(schema, ())
        for statement in dropped(schema, described=described, formulas=own):
            self._connection.run(statement)
        if not self._connection.is_file:
            return
        history = kept.history if kept is not None else None
        if not isinstance(history, DuckDBStore):
            history = None
        for name in (*_HISTORY_VIEWS, *_MODEL_VIEWS):
            if history is not None and name in history.views:
                rows = f"SELECT * FROM {history.place(name)}"  # noqa: S608
                table = _HISTORY_VIEWS.get(name)
                view = rows if table is None else _with_second_names(table, rows)
                self._make_view(schema, name, view)
            else:
                view = exp.table_(name, db=schema, quoted=True).sql("duckdb")
                self._connection.run(f"DROP VIEW IF EXISTS {view}")

    def forget_lost(self) -> None:
        """Drop the views on worlds of a process that was killed."""
        lost = self._connection.own_rows(
            "SELECT schema_name, view_name FROM duckdb_views() WHERE NOT internal AND NOT "  # noqa: S608
            f"temporary AND regexp_matches(sql, {_LOST})"
        )
        for schema, name in lost:
            view = exp.table_(name, db=schema, quoted=True).sql("duckdb")
            self._connection.run(f"DROP VIEW {view}")


def _with_second_names(table: Table, rows: str) -> str:
    """A SELECT of a table's rows with the second names of its columns at the end, if any have."""
    if not table.second_names:
        return rows
    columns = ", ".join(
        f"{quoted(name)} AS {quoted(second)}" for name, second in table.second_names.items()
    )
    return f"SELECT *, {columns} FROM ({rows}) AS rows"  # noqa: S608


def _refuse(rows: exp.Select, why: str) -> None:
    """Make a SELECT fail when it is read; a condition on no rows would not be looked at."""
    failing = exp.func("error", exp.Literal.string(why)).as_("why")
    rows.join(exp.select(failing).subquery("untold"), join_type="cross", copy=False)
    rows.set("expressions", [exp.Star(except_=[exp.column("why")])])
    rows.where(exp.column("why").is_(exp.null()), copy=False)
