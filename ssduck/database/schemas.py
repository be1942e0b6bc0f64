"""The contents of worlds' schemas: views of tables, macros of relations, and comments.

Macros and comments serve users' SQL: a query gets the macros that it names, other statements get
all macros and comments. The SQL of SelectScript contains the relations' formulas instead.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from typing import TypeAlias

from sqlglot import exp

from ssduck.database.binding import BoundWorld, Buffer, WorldHistory
from ssduck.database.connection import Connection
from ssduck.errors import SqlError
from ssduck.language.intervals import ABOUT_INTERVALS, INTERVALS, RELATIONS_OF_INTERVALS
from ssduck.recording.spec import not_recorded_message
from ssduck.recording.stores.base import VisibleRows
from ssduck.recording.stores.duckdb import DuckDBStore
from ssduck.recording.stores.history_sql import quoted
from ssduck.schema import HISTORIES, LINK_FACTOR, MAX_LINKS, MODELS, TABLES, Table
from ssduck.sql.from_clause import pair_table
from ssduck.sql.relations.geometry_query import COLLIDING, WITHIN, PairKind, PairSearch
from ssduck.sql.relations.registry import RELATIONS
from ssduck.world.live_tables import LiveTable

_HISTORY_VIEWS = {table.history_view: table for table in HISTORIES.values()}
_MODEL_VIEWS = [table.model_view for table in MODELS.values()]
# A reference to a world's buffers, as a regular expression in SQL.
_STALE_BUFFER = exp.Literal.string(r'"world \d+: ').sql("duckdb")
_HAS_LIVE_VIEWS = (
    "SELECT view_name FROM duckdb_views() "
    "WHERE NOT internal AND list_contains($1, view_name) LIMIT 1"
)
# The first and the last tick that a statement reads, by schema and view.
TickRanges: TypeAlias = Mapping[tuple[str, str], tuple[int, int]]


class Schemas:
    """The schemas of worlds."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        # The schemas with all macros and comments; None before anything needed these.
        self._described: set[str] | None = None
        # The macros that are there, by schema and name, and the worlds that they are of.
        self._macros: set[tuple[str | None, str]] = set()
        self._macros_for: tuple[tuple[str, ...], str | None] = ((), None)
        # The words of the views and macros that a file has from before.
        self._stored_words: set[str] = set()
        # The views of histories, by schema and name, of which not all files were checked.
        self._partly_made: set[tuple[str, str]] = set()

    def make(self, name: str, bound: BoundWorld) -> None:
        """Creates the schema of a world, or recreates its views."""
        self._connection.make_schema(name)
        on_demand = self._connection.on_demand
        for table in TABLES.values():
            on_demand.offer((name, table.name), partial(_make_live_view, name, bound, table))
        self.make_history(name, bound)

    def make_history(self, name: str, bound: BoundWorld) -> None:
        """Creates or replaces the views of a world's history.

        In memory, a view is made when a statement names it. In a file, statements of other programs
        read the views, too.
        """
        self.forget(name)
        self._partly_made = {made for made in self._partly_made if made[0] != name}
        on_demand = self._connection.on_demand
        for table in HISTORIES.values():
            maker = partial(_make_history_view, name, bound, table)
            on_demand.offer((name, table.history_view), maker)
        if bound.history is not None:
            models = cache(bound.history.store.models)
            for view in _MODEL_VIEWS:
                on_demand.offer((name, view), partial(_make_model_view, name, view, models))
        if self._connection.is_file:
            on_demand.make_schema(name, self._connection)

    @contextmanager
    def reading(self, worlds: Mapping[str, BoundWorld], ticks: TickRanges) -> Iterator[None]:
        """Has the files of some histories checked at the ticks only that a statement reads.

        Before any other statement that names their views, all of their files are.
        """
        on_demand = self._connection.on_demand
        partly = [
            (schema, view)
            for (schema, view), span in ticks.items()
            if on_demand.is_offered((schema, view))
            and self._make_partly(schema, view, worlds[schema], span)
        ]
        with on_demand.without(partly):
            yield

    def _make_partly(
        self, schema: str, view: str, bound: BoundWorld, ticks: tuple[int, int]
    ) -> bool:
        """Creates the view of a history of which some ticks are checked, if it has many parts."""
        table, history = _HISTORY_VIEWS[view], bound.history
        if history is None or table.view_columns or not history.store.has_groups(table.source):
            return False
        history.store.check(table.source, ticks)
        if (schema, view) not in self._partly_made:
            try:
                _define_history_view(schema, bound, table, self._connection)
            except SqlError:  # DuckDB cannot read a part, of whatever ticks
                return False
            self._partly_made.add((schema, view))
        return True

    @property
    def has_comments(self) -> bool:
        """Whether all macros and comments have been made once."""
        return self._described is not None

    def note_stored(self, words: AbstractSet[str]) -> None:
        """Takes note of the words of a view or a macro in a file: any statement may use it."""
        self._stored_words |= words

    def provide(
        self,
        words: AbstractSet[str],
        names: Sequence[str],
        only: str | None,
        recorded: Collection[str] | None,
    ) -> None:
        """Creates the views and macros that a statement needs.

        Args:
            words: the words of the statement, in small letters.
            names: the names of all schemas of worlds.
            only: the schema of the only world; None if there are several worlds.
            recorded: the schemas of recorded worlds, for all views, macros and comments; None for
                those views and macros that the words name.
        """
        connection = self._connection
        if self._macros_for != (worlds := (tuple(names), only)):
            self._drop_unqualified()
            self._macros_for = worlds
        if recorded is None:
            connection.on_demand.make_named(words, connection)
        else:
            connection.on_demand.make_all(connection)
            if self._described != set(names):
                connection.run(description_script(tuple(names), only, frozenset(recorded)))
                self._described = set(names)
                self._macros |= {(None, name) for name in MACRO_NAMES}
                self._macros |= {(schema, name) for schema in names for name in WORLD_MACROS}
        for name in sorted(MACRO_NAMES & (words | self._stored_words)):
            for schema in (None, *names):
                if (schema, name) not in self._macros:
                    statement = macro_statement(name, schema, only)
                    if statement is not None:
                        connection.on_demand.provide(statement, connection)
                        connection.define(statement)
                    self._macros.add((schema, name))

    def _drop_unqualified(self) -> None:
        """Drops the macros that have no schema before their name: they depend on the worlds."""
        dropped = [drop_macro(name) for schema, name in self._macros if schema is None]
        if dropped:
            self._connection.define(";\n".join(dropped))
        self._macros = {made for made in self._macros if made[0] is not None}
        self._described = None if self._described is None else set()

    def forget(self, name: str) -> None:
        """Has the macros and comments of a schema made anew."""
        if self._described is not None:
            self._described.discard(name)
        self._macros = {made for made in self._macros if made[0] != name}

    def drop(self, schema: str, history: WorldHistory | None) -> None:
        """Drops a schema whose world is gone; in a file its history stays."""
        if self._connection.is_file:
            self.detach(schema, history)
        else:
            self._connection.drop_schema(schema)
        self._connection.on_demand.withdraw_schema(schema)
        self.forget(schema)

    def detach(self, schema: str, history: WorldHistory | None) -> None:
        """Drops the parts of a schema that need ssduck."""
        if self._connection.is_file:
            self._detach_history(schema, history)
        for statement in drop_statements(schema, [n for own, n in self._macros if own == schema]):
            self._connection.run(statement)

    def _detach_history(self, schema: str, history: WorldHistory | None) -> None:
        """Makes the views of a world's history read what is stored in the file."""
        store = history.store if history is not None else None
        if not isinstance(store, DuckDBStore):
            store = None
        for name in (*_HISTORY_VIEWS, *_MODEL_VIEWS):
            table = _HISTORY_VIEWS.get(name)
            source = name if table is None else TABLES[table.source].history_view
            if store is not None and source in store.views:
                rows = f"SELECT * FROM {store.place(source)}"  # noqa: S608
                view = (
                    rows
                    if table is None
                    else with_view_columns(table, rows, schema, "entities_history")
                )
                _make_view(self._connection, schema, name, view)
            else:
                view = exp.table_(name, db=schema, quoted=True).sql("duckdb")
                self._connection.run(f"DROP VIEW IF EXISTS {view}")

    def drop_stale_views(self) -> None:
        """Drops the views on worlds of a process that was killed."""
        # DuckDB writes the texts of all views for any of them. `detach` drops these last.
        if not self._connection.internal_rows(_HAS_LIVE_VIEWS, [list(TABLES)]):
            return
        stale = self._connection.internal_rows(
            "SELECT schema_name, view_name FROM duckdb_views() WHERE NOT internal AND NOT "  # noqa: S608
            f"temporary AND system.main.regexp_matches(sql, {_STALE_BUFFER})"
        )
        for schema, name in stale:
            view = exp.table_(name, db=schema, quoted=True).sql("duckdb")
            self._connection.run(f"DROP VIEW {view}")


def _make_view(connection: Connection, schema: str, name: str, rows: str) -> None:
    view = f"{quoted(schema)}.{quoted(name)}"
    connection.define(f"CREATE OR REPLACE VIEW {view} AS {rows}")


def _make_live_view(schema: str, bound: BoundWorld, table: Table, connection: Connection) -> None:
    if table.view_columns:
        connection.on_demand.make((schema, "entities"), connection)
    _register(connection, bound, bound.live_buffers(), [bound.live_view(table.source)])
    rows = _live_rows(bound, table, bound.world.snapshot.unavailable.get(table.source))
    _make_view(connection, schema, table.name, with_view_columns(table, rows, schema))


def _make_history_view(
    schema: str, bound: BoundWorld, table: Table, connection: Connection
) -> None:
    """Creates the view of a table at all recorded ticks, whose files it checks."""
    if bound.history is not None:
        bound.history.store.check(table.source)
    if table.view_columns:
        connection.on_demand.make((schema, TABLES["entities"].history_view), connection)
    _define_history_view(schema, bound, table, connection)


def _define_history_view(
    schema: str, bound: BoundWorld, table: Table, connection: Connection
) -> None:
    history, rows = bound.history, None
    if history is not None:
        waiting = bound.buffer_views if history.visible_rows else None
        if history.recorder is not None:
            history.recorder.settle()
        tables = {table.source, "entities"} & set(history.store.tables)
        names = [name for table_name in tables for name in bound.buffer_views(table_name)]
        _register(connection, bound, bound.history_buffers(), names)
        rows = history.store.select(table.source, waiting)
    if rows is None:
        _register(connection, bound, bound.live_buffers(), [bound.live_view(table.source)])
        rows = _live_rows(bound, table, _not_recorded(table, schema, history))
    columns = with_view_columns(table, rows, schema, TABLES["entities"].history_view)
    _make_view(connection, schema, table.history_view, columns)


def _make_model_view(
    schema: str, name: str, models: Callable[[], Mapping[str, str]], connection: Connection
) -> None:
    """Creates the view of the values of a table that no tick changes."""
    _make_view(connection, schema, name, models()[name])


def _register(
    connection: Connection, bound: BoundWorld, buffers: Iterable[Buffer], names: Collection[str]
) -> None:
    """Registers some buffers of a world with DuckDB, unless they are."""
    for name, rows in buffers:
        if name in names and name not in bound.versions:
            register_rows(connection, bound, name, rows)


def register_rows(
    connection: Connection, bound: BoundWorld, name: str, rows: LiveTable | VisibleRows
) -> None:
    """Registers rows of a world with DuckDB under a name."""
    version = rows.version  # before the rows, which may be stored meanwhile: they are read again
    connection.register(name, rows.arrow)
    bound.versions[name] = version


def _not_recorded(table: Table, world: str, history: WorldHistory | None) -> str:
    if history is None:
        return not_recorded_message(table.source, world, None)
    recording, is_live = history.store.recording, history.recorder is not None
    return not_recorded_message(table.source, world, recording, is_live=is_live)


def with_view_columns(table: Table, rows: str, schema: str, entities: str = "entities") -> str:
    """Returns the SELECT of a table's rows, with the columns that only views have at the end."""
    if table.view_columns:
        place, listed = f"{quoted(schema)}.{quoted(entities)}", "*"
        if not table.part_of:
            hidden = ", ".join(column.name for column in table.columns if column.is_of_sites)
            listed = f"* EXCLUDE ({hidden})"
        return part_rows(table, rows, place, listed)
    if not table.second_names:
        return rows
    columns = ", ".join(
        f"{quoted(name)} AS {quoted(second)}" for name, second in table.second_names.items()
    )
    return f"SELECT *, {columns} FROM ({rows}) AS rows"  # noqa: S608


def part_rows(table: Table, rows: str, entities: str, listed: str) -> str:
    """Returns the SELECT of the view of links or sites."""
    added = _link_columns(entities, "site" if table.part_of else "link")
    columns = ", ".join(f"{value} AS {quoted(name)}" for name, value in added.items())
    condition = "region IS NOT NULL" if table.part_of else "region IS NULL"
    return f"SELECT {listed}, {columns} FROM ({rows}) AS rows WHERE {condition}"  # noqa: S608


def _link_columns(entities: str, kind: str) -> dict[str, str]:
    """Returns the columns that only views of links and sites have, in SQL."""
    # Subqueries that depend on no row run once, and a join could change the order of the rows.

    def is_not_among(condition: str) -> str:
        absent = f"SELECT tick, id FROM {entities} WHERE {condition} AND kind <> 'sensor'"  # noqa: S608
        return f"(tick, entity) NOT IN ({absent})"

    names = f"SELECT map(list(id), list(name)) FROM (SELECT DISTINCT id, name FROM {entities})"  # noqa: S608
    return {
        "id": f"CASE WHEN link < {MAX_LINKS} THEN (link + 1) * {LINK_FACTOR} + entity END",
        "full_name": f"map_extract_value(({names}), entity) || '.' || name",
        "kind": f"'{kind}'",
        "enabled": is_not_among("NOT enabled"),
        "visible": is_not_among("NOT visible"),
        "run": f"(SELECT any_value(run) FROM {entities})",  # noqa: S608
    }


def _live_rows(bound: BoundWorld, table: Table, reason: str | None = None) -> str:
    """Returns the SELECT of a table's rows of the current tick, which fails with a reason."""
    rows = f"FROM {quoted(bound.live_view(table.source))}"
    if reason is None:
        return f"SELECT * {rows}"
    failing = f"SELECT error({exp.Literal.string(reason).sql('duckdb')}) AS reason"
    # The condition makes DuckDB evaluate `error` even if there are no rows.
    unavailable = f"CROSS JOIN ({failing}) AS unavailable WHERE reason IS NULL"
    return f"SELECT * EXCLUDE (reason) {rows} {unavailable}"


@dataclass(frozen=True)
class PairTableMacro:
    """A table of pairs of entities or links, faster than a join of rows for thousands of them."""

    name: str  # its name in a world's schema; the schema of the only world may be omitted
    parameters: tuple[str, ...]  # its parameters
    search: PairSearch  # the search for pairs
    distance: str  # the parameter that is the distance or the depth, m
    about: str  # the meaning of a row
    kind: PairKind  # what the two sides of a pair are

    def macro(self, schema: str, *, inside: bool) -> str:
        """Returns the statement that creates it, in the schema of its world or for all."""
        distance = exp.column(self.distance)
        pairs = pair_table(self.search, distance, schema, "pairs", self.kind).table
        rows = exp.select("pairs.a", "pairs.b").from_(pairs).sql("duckdb")
        place = f"MACRO {_dotted((schema,), self.name)}" if inside else f"TEMP MACRO {self.name}"
        return f"CREATE OR REPLACE {place}({', '.join(self.parameters)}) AS TABLE {rows}"


_SIDES: tuple[tuple[str, PairKind, str], ...] = (
    ("", "entities", "two entities"),
    ("link_", "links", "two links, of one entity or two,"),
)
TABLE_MACROS = (
    *(
        PairTableMacro(
            f"colliding_{prefix}pairs",
            ("depth := 1e-6",),
            COLLIDING,
            "depth",
            f"A row is the ids a, b of {sides} that penetrate each other by more than depth, in "
            "metres, 1e-6 by default; each pair in both orders.",
            kind,
        )
        for prefix, kind, sides in _SIDES
    ),
    *(
        PairTableMacro(
            f"{prefix}pairs_within",
            ("d",),
            WITHIN,
            "d",
            f"A row is the ids a, b of {sides} whose clearance is at most d metres; each pair in "
            "both orders.",
            kind,
        )
        for prefix, kind, sides in _SIDES
    ),
)


def _dotted(path: Sequence[str], name: str) -> str:
    return ".".join(map(quoted, (*path, name)))


_RELATIONS = {relation.name.lower(): relation for relation in RELATIONS.values()}
_PAIR_TABLES = {table.name: table for table in TABLE_MACROS}
_INTERVALS = "intervals"
# The macros that have a table; those of `TABLE_MACROS` depend on the worlds.
_WITH_TABLE = frozenset((_INTERVALS, *_PAIR_TABLES))
MACRO_NAMES = frozenset((*_RELATIONS, *RELATIONS_OF_INTERVALS)) | _WITH_TABLE
# Those that read tables of a world, and so are in its schema before a statement names them.
WORLD_MACROS = frozenset((*_PAIR_TABLES, *(n for n, one in _RELATIONS.items() if one.tables)))


@lru_cache(maxsize=16)
def description_script(
    worlds: Sequence[str], only: str | None, recorded: Collection[str] = ()
) -> str:
    """Returns the statements that create all macros and comments.

    Relations read the tables of the only world, as a row does not name its world; each world
    also has them in its own schema. All arguments must be hashable.
    """
    statements: list[str] = []
    for schema, names in ((None, MACRO_NAMES), *((world, WORLD_MACROS) for world in worlds)):
        for name in sorted(names):
            statement = macro_statement(name, schema, only)
            if statement is not None:
                statements += statement, _macro_comment(name, schema)
    for schema in worlds:
        statements += _comments(schema, recorded=schema in recorded)
    return ";\n".join(statements)


def macro_statement(name: str, schema: str | None, only: str | None) -> str | None:
    """Returns the statement that creates a macro; None if there is no such macro in that place.

    Args:
        name: its name, in small letters.
        schema: the schema of a world; None for the macro that has no schema before its name.
        only: the schema of the only world; None if there are several worlds.
    """
    relation, pairs = _RELATIONS.get(name), _PAIR_TABLES.get(name)
    if relation is not None:
        return relation.macro(schema or only, inside=schema is not None)
    if pairs is not None:
        world = schema or only
        return None if world is None else pairs.macro(world, inside=schema is not None)
    if schema is not None:
        return None
    if name == _INTERVALS:
        return f"CREATE OR REPLACE TEMP MACRO {_INTERVALS}(source) AS TABLE {INTERVALS}"
    formula = RELATIONS_OF_INTERVALS[name].formula
    return f"CREATE OR REPLACE TEMP MACRO {name}(a, b) AS ({formula})"


def _macro_comment(name: str, schema: str | None) -> str:
    """Returns the statement that comments on a macro."""
    if name in _RELATIONS:
        return _RELATIONS[name].comment(schema)
    place = _dotted(("temp", "main") if schema is None else (schema,), name)
    if name in _PAIR_TABLES:
        kind, about = "MACRO TABLE", _PAIR_TABLES[name].about
    elif name == _INTERVALS:
        kind, about = "MACRO TABLE", ABOUT_INTERVALS
    else:
        kind, about = "MACRO", RELATIONS_OF_INTERVALS[name].about
    return f"COMMENT ON {kind} {place} IS {exp.Literal.string(about).sql('duckdb')}"


def drop_macro(name: str, schema: str | None = None) -> str:
    """Returns the statement that drops a macro, or one that has no schema before its name."""
    kind = "MACRO TABLE" if name in _WITH_TABLE else "MACRO"
    place = ("temp", "main") if schema is None else (schema,)
    return f"DROP {kind} IF EXISTS {_dotted(place, name)}"


def drop_statements(world: str, macros: Iterable[str]) -> Iterator[str]:
    """Yields the statements that drop the views of a world and its macros, by their names."""
    for table in TABLES:
        yield f"DROP VIEW IF EXISTS {_dotted((world,), table)}"
    for name in sorted(macros):
        yield drop_macro(name, world)


def _comments(schema: str, *, recorded: bool) -> Iterator[str]:
    for name, table in TABLES.items():
        columns = table.shown_columns
        comments = {column.name: column.comment for column in columns}
        comments |= {
            column.second_name: column.comment for column in table.columns if column.second_name
        }
        yield from _comments_on(schema, name, f"A row is {table.row}.", comments)
        if table.has_history:
            about = f"A row is {table.row}, at each recorded tick."
            yield from _comments_on(schema, table.history_view, about, comments)
    for table in MODELS.values() if recorded else ():
        about = f"Values that are the same at all recorded ticks. A row is {table.row}."
        comments = {column.name: column.comment for column in table.model}
        yield from _comments_on(schema, table.model_view, about, comments)


def _comments_on(schema: str, view: str, about: str, columns: Mapping[str, str]) -> Iterator[str]:
    yield _comment("VIEW", exp.table_(view, db=schema, quoted=True), about)
    for name, comment in columns.items():
        place = exp.column(name, table=view, db=schema, quoted=True)
        yield _comment("COLUMN", place, comment)


def _comment(kind: str, place: exp.Expr, text: str) -> str:
    literal = exp.Literal.string(text)
    return exp.Comment(this=place, kind=kind, expression=literal).sql("duckdb")
