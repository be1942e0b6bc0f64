"""The history of a world in DuckDB: where its ticks are stored, and the views that show them.

What differs from tick to tick is stored in tables of numbers, what an entity is once, beside
them. The views `<table>_history` join the two, and what waits in the rings with what is stored.

A world's history is a schema of its own. Its rows are written by a connection of their own, and
made good between queries (`ssduck.recording.background_writer`), so that none sees a tick twice or
not at all. Where older ticks are dropped, the tables are as many `SLOTS`: the oldest is dropped as
a whole, which takes no time and gives its memory back.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any, Protocol, TypeAlias

import numpy as np
import pyarrow as pa
from sqlglot import exp

from ssduck.recording.background_writer import WHENEVER, Cut
from ssduck.recording.buffers import FRAME_REALS, FRAMES, STORED, TickBuffer
from ssduck.recording.spec import QUARTERS, RECORDABLE, Recording
from ssduck.recording.static_tables import KEYS, MODELS, ShapeNumbers, defaults, models_of
from ssduck.schema import BOX, TABLES
from ssduck.world.layout import EntityInfo

SLOTS = QUARTERS + 2
# The version of what is stored, and the table that tells it.
VERSION = 1
ABOUT = "ssduck record"


class VisibleRows(Protocol):
    """Rows that DuckDB looks into where they are."""

    version: int

    @property
    def arrow(self) -> pa.Table:
        """The rows; another object, if the version is another one."""


# Gives the names of the tables in which the rows of a table are that are not stored.
Waiting: TypeAlias = Callable[[str], Sequence[str]]


class StoreConnection(Protocol):
    """A connection to DuckDB of a history's own."""

    def run(self, sql: str) -> None:
        """Run a statement."""

    def insert(self, place: str, rows: pa.Table) -> None:
        """Add rows to a table, by the names of its columns."""

    def insert_new(self, place: str, rows: pa.Table) -> None:
        """Make a table of rows."""

    def rows(
        self,
        sql: str,
        parameters: Sequence[Any] = (),
        tables: Mapping[str, pa.Table] | None = None,
    ) -> pa.Table:
        """All rows of a SELECT; it may read tables that are given."""

    def fetchall(self, sql: str) -> list[tuple[Any, ...]]:
        """All rows of a SELECT, as tuples."""

    def settle(self) -> None:
        """Tidy up what was stored, if there is reason and room to; reading goes on meanwhile."""

    def close(self) -> None:
        """Close the connection."""


class TickArchive(Protocol):
    """Where ticks are stored that can be read.

    Attributes:
        recording: what is kept of each tick.
    """

    recording: Recording

    def select(self, table: str, rings: Waiting | None) -> str | None:
        """What the view of a table's history selects; None for what is not recorded."""

    def models(self) -> dict[str, str]:
        """What the views select that tell what entities are, by their names."""

    def fetch(self, table: str, first: int, last: int) -> pa.Table:
        """The rows of a table at ticks from first to last."""

    def near(self, asked: PairRequest, waiting: pa.Table | None) -> pa.Table:
        """The pairs of entities whose boxes are near at some ticks; see `near_rows`."""

    def close(self, *, forget: bool) -> None:
        """Let go of it; what is stored is dropped, or not."""


class DuckDBStore:
    """The stored ticks of a world.

    Args:
        schema: what holds them.
        writer: a connection of its own.
        recording: what is kept of each tick.
        world: what the world is called; None to read what is stored there already.
        catalog: of the attached file that has the schema; None for the database itself.

    Attributes:
        shown: the rows that it keeps where DuckDB is to be shown them, by table.
        untold_run: the number of the run, where its rows do not tell it.
    """

    untold_run: int | None = None

    keeps = False
    shown: tuple[Mapping[str, VisibleRows], ...] = ()

    def __init__(
        self,
        schema: str,
        writer: StoreConnection,
        recording: Recording,
        world: str | None = None,
        *,
        catalog: str | None = None,
    ) -> None:
        self.schema = schema
        self._catalog = catalog
        self.recording = recording
        self._writer = writer
        self._slots = SLOTS if recording.is_bounded else 1
        # Of each slot in use, the oldest first: its number, and its first tick.
        self._used: list[tuple[int, int]] = [(0, 0)]
        # Of the last one: how many ticks it has, and the times of the first and the last.
        self._filled, self._times = 0, (0.0, 0.0)
        self._geometries: set[int] = set()
        self.tables = ("ticks", *(t for t in RECORDABLE if t in recording.tables))
        if "links" not in recording.tables:
            self.tables += (FRAMES,)
        self._is_own = world is not None
        self._whole_models: dict[str, str] = {}
        if world is not None:
            self._make(world)

    def close(self, *, forget: bool) -> None:
        """Write no more.

        Args:
            forget: whether what is stored is dropped.
        """
        if forget:
            self._writer.run(f"DROP SCHEMA {quoted(self.schema)} CASCADE")
        self._writer.close()

    def _make(self, world: str) -> None:
        about = {
            "version": VERSION,
            "world": world,
            "started": datetime.now(UTC).isoformat(timespec="seconds"),
            "recording": asdict(self.recording),
        }
        with self._whole():
            self._writer.run(f"CREATE SCHEMA {quoted(self.schema)}")
            self._writer.insert_new(self.place(ABOUT), pa.table({"about": [json.dumps(about)]}))
            for table, columns in MODELS.items():
                self._writer.run(_create(self._model(table), columns))
            self._make_tables()

    def _make_tables(self) -> None:
        for table in self.tables:
            for slot in range(self._slots):
                self._writer.run(_create(self._slot(table, slot), self._columns(table)))

    @contextmanager
    def _whole(self, cut: Cut = WHENEVER) -> Iterator[None]:
        """What is written in here is stored together, or not at all; in the cut it is made good."""
        self._writer.run("BEGIN")
        try:
            yield
        except BaseException:
            self._writer.run("ROLLBACK")
            raise
        with cut:
            self._writer.run("COMMIT")

    @property
    def views(self) -> dict[str, str]:
        """What the views of what is stored select, by their names."""
        tables = (table for table in self.tables if table != FRAMES)
        return {history_name(t): str(self.select(t, None)) for t in tables} | self.models()

    def show(self) -> None:
        """Make these views in its schema, where DuckDB can read them without ssduck."""
        for name, rows in self.views.items():
            self._writer.run(f"CREATE VIEW {self.place(name)} AS {rows}")

    def ticks(self) -> TickBuffer:
        """The ticks that are stored."""
        rows = f"SELECT tick, time FROM ({self._stored('ticks')}) AS ticks ORDER BY tick"  # noqa: S608
        found = self._writer.rows(rows)
        return TickBuffer.of(found["tick"].to_numpy(), found["time"].to_numpy())

    def all_models(self) -> dict[str, pa.Table]:
        """What the entities are that they tell of, as rows."""
        return {
            table: self._writer.rows(f"SELECT * FROM {self._model(table)}")  # noqa: S608
            for table in MODELS
        }

    def _columns(self, table: str) -> dict[str, str]:
        columns = columns_of(table)
        return columns | {"until": "BIGINT"} if self._is_changed(table) else columns

    def _is_changed(self, table: str) -> bool:
        """Whether rows of a table are stored only where they changed."""
        return self.recording.changed and table in (*KEYS, FRAMES)

    def place(self, name: str) -> str:
        """A table or view of its schema, in SQL."""
        where = (self.schema,) if self._catalog is None else (self._catalog, self.schema)
        return ".".join(map(quoted, (*where, name)))

    def _slot(self, table: str, slot: int) -> str:
        return self.place(f"{table} {slot}")

    # -- writing (ssduck.recording.recorder.RowStore) ----------------------------------------

    def add_members(self, members: Collection[EntityInfo], numbers: ShapeNumbers) -> None:
        """Keep what entities are, before rows of theirs."""
        models = models_of(members, numbers, self._geometries)
        self._insert({self._model(table): rows for table, rows in models.items()})
        self._geometries |= set(models["geometries"]["id"].to_pylist())

    def add(self, rows: Mapping[str, pa.Table], cut: Cut = WHENEVER) -> None:
        """Keep the rows of whole ticks, all or none of them; enters the cut to make them good."""
        numbers, times = (rows["ticks"][name].to_numpy() for name in ("tick", "time"))
        self._turn(int(numbers[0]))
        slot, _ = self._used[-1]
        self._insert(
            {
                self._slot(table, slot): _changes(table, own) if self._is_changed(table) else own
                for table, own in rows.items()
                if own.num_rows
            },
            cut,
        )
        first = self._times[0] if self._filled else float(times[0])
        self._filled, self._times = self._filled + len(times), (first, float(times[-1]))
        self._writer.settle()

    def _insert(self, rows: Mapping[str, pa.Table], cut: Cut = WHENEVER) -> None:
        """Add rows to tables, all or none of them."""
        with self._whole(cut):
            for place, own in rows.items():
                if own.num_rows:
                    self._writer.insert(place, own)

    def _turn(self, tick: int) -> None:
        """Take the next slot, if a quarter of what is kept is in this one."""
        if self._slots == 1:
            return
        if not self._filled:
            self._used[-1] = self._used[-1][0], tick
            return
        count, seconds = self._filled, self._times[1] - self._times[0]
        recording = self.recording
        full = recording.ticks is not None and count >= recording.ticks // QUARTERS
        # What is stored together ends a tick before a quarter is over.
        if recording.seconds is not None and seconds >= recording.seconds / QUARTERS / 2:
            full = True
        free = set(range(SLOTS)) - {number for number, _ in self._used}
        if full and free:
            self._used.append((free.pop(), tick))
            self._filled = 0

    def drop_before(self, tick: int) -> int:
        """Drop slots whose ticks are all older; tells the first tick that is still there."""
        while len(self._used) > 1 and self._used[1][1] <= tick:
            slot, _ = self._used.pop(0)
            for table in self.tables:
                place = self._slot(table, slot)
                self._writer.run(_create(place, self._columns(table), replace=True))
        return self._used[0][1]

    # -- reading ----------------------------------------------------------------------------

    def fetch(self, table: str, first: int, last: int) -> pa.Table:
        """The stored rows of a table at ticks from first to last, what waits left out."""
        rows = self._stored(table)
        return self._writer.rows(
            f"SELECT * FROM ({rows}) AS stored WHERE tick BETWEEN ? AND ?",  # noqa: S608
            (first, last),
        )

    def near(self, asked: PairRequest, waiting: pa.Table | None) -> pa.Table:
        """The pairs of entities whose boxes are near at some ticks; see `near_rows`."""
        return near_rows(self._writer, self._stored("entities"), asked, waiting)

    def _stored(self, table: str) -> str:
        """A SELECT of the stored rows of a table."""
        return " UNION ALL ".join(self._of_slot(table, slot) for slot in range(self._slots))

    def _of_slot(self, table: str, slot: int) -> str:
        place, columns = self._slot(table, slot), columns_of(table)
        if not self._is_changed(table):
            return f"SELECT {_listed(columns)} FROM {place}"  # noqa: S608
        told = _listed(columns, lambda name: "ticks" if name in ("tick", "time") else "rows")
        return (
            f"SELECT {told} FROM (SELECT *, unnest(range(tick, until + 1)) AS at "  # noqa: S608
            f"FROM {place}) AS rows JOIN {self._slot('ticks', slot)} AS ticks "
            "ON ticks.tick = rows.at"
        )

    def select(self, table: str, rings: Waiting | None) -> str | None:
        """What the view of a table's history selects; None for what is not recorded.

        Args:
            table: a table of a world.
            rings: the names of the tables in which the rows of a table wait, if any do.
        """
        if table not in self.tables:
            return None
        rows, entities = self._all(table, rings), self._all("entities", rings)
        return history_of(table, rows, entities, self._model_rows)

    def models(self) -> dict[str, str]:
        """What the views select that tell what entities are, by their names."""
        return {
            model_name(table): f"SELECT * FROM {self._model_rows(table)}"  # noqa: S608
            for table in MODELS
        }

    def _all(self, table: str, rings: Waiting | None) -> str:
        """A SELECT of all rows of a table, those that wait among them."""
        if rings is None:
            return self._stored(table)
        waiting = [self._of_ring(table, ring) for ring in rings(table)]
        return " UNION ALL ".join([self._stored(table), *waiting])

    def _of_ring(self, table: str, ring: str) -> str:
        """A SELECT of the rows of a ring."""
        flags = STORED[table].flags if table in STORED else ()
        told = _listed(name for name in columns_of(table) if name not in flags)
        told += "".join(f", {quoted(name)}::BOOLEAN AS {quoted(name)}" for name in flags)
        return f"SELECT {told} FROM {quoted(ring)} WHERE tick >= 0"  # noqa: S608

    def _model(self, table: str) -> str:
        return self.place(f"{table} model")

    def _model_rows(self, table: str) -> str:
        """The rows of what is fixed of a table, in SQL: of an older record with all columns."""
        place = self._model(table)
        if self._is_own:
            return place
        if table not in self._whole_models:
            present = self._writer.rows(f"SELECT * FROM {place} LIMIT 0").column_names  # noqa: S608
            missing = defaults(self.untold_run, self._model("geometries"))
            self._whole_models[table] = f"({whole_rows(place, MODELS[table], present, missing)})"
        return self._whole_models[table]


@dataclass(frozen=True)
class PairRequest:
    """Which pairs of entities are asked for, at which ticks.

    Attributes:
        first: the first tick,
        last: and the last one.
        a: the one entity's id; 0 for any.
        b: the other's.
        apart: how far apart their boxes may be along each axis, m.
    """

    first: int
    last: int
    a: int
    b: int
    apart: float


POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
# What `near_rows` gives.
NEAR_COLUMNS = ("tick", "a", "b", *(f"{side}_{name}" for side in "ab" for name in POSE))
# Boxes are looked at a little farther out, m, for what is exactly as far as is asked for.
BOXES_OFF = 1e-9
_WAITING = "entities that wait"


def near_rows(
    writer: StoreConnection, stored: str | None, asked: PairRequest, waiting: pa.Table | None
) -> pa.Table:
    """Pairs of entities whose boxes are near at a tick, or are not known, with both poses.

    Args:
        writer: a connection of its own.
        stored: a SELECT of the stored rows of entities, if any are.
        asked: which pairs.
        waiting: rows of entities that wait to be stored.
    """
    columns = ("tick", "id", *POSE, *BOX)
    places = [] if stored is None else [f"({stored}) AS stored"]
    if waiting is not None:
        places.append(f'"{_WAITING}"')
    rows = " UNION ALL ".join(
        f"SELECT {_listed(columns)} FROM {place} WHERE tick BETWEEN ? AND ?"  # noqa: S608
        for place in places
    )
    values = [asked.first, asked.last] * len(places)
    poses = ", ".join(f'{side}."{name}" AS {side}_{name}' for side in "ab" for name in POSE)
    sides = (("a", "b"), ("b", "a"))
    far = [f"{s}.{axis}min > {t}.{axis}max + far" for axis in "xyz" for s, t in sides]
    only = [f"{side}.id = {id}" for side, id in (("a", asked.a), ("b", asked.b)) if id]
    sql = (
        f"WITH seen AS ({rows}), "  # noqa: S608
        f"asked AS (SELECT {asked.apart!r}::DOUBLE + {BOXES_OFF!r}::DOUBLE AS far) "
        f"SELECT a.tick AS tick, a.id AS a, b.id AS b, {poses} "
        "FROM seen AS a JOIN seen AS b ON a.tick = b.tick CROSS JOIN asked "
        f"WHERE {' AND '.join(['a.id <> b.id', *only])} "
        f"AND ({' OR '.join(far)}) IS NOT TRUE ORDER BY tick"
    )
    tables = {} if waiting is None else {_WAITING: waiting}
    return writer.rows(sql, values, tables)


def history_name(table: str) -> str:
    """What the view of a table with all recorded ticks is called."""
    return f"{table}_history"


def model_name(table: str) -> str:
    """What the view of a table with what is the same at each tick is called."""
    return f"{table}_model"


def not_recorded(table: str, world: str) -> str:
    """Why there is no history of a table."""
    return (
        f"the table of {table} of {world!r} is not recorded: record it with "
        f"tables=('entities', '{table}')"
    )


def columns_of(table: str) -> dict[str, str]:
    """The columns of a table that differ from tick to tick, with DuckDB's types."""
    if table == FRAMES:
        return {**dict.fromkeys(("tick", "entity", "link"), "BIGINT"), **_reals(FRAME_REALS)}
    stored = STORED[table]
    return {
        **dict.fromkeys(stored.integers, "BIGINT"),
        **_reals(stored.names_of_reals(table)),
        **dict.fromkeys(stored.flags, "BOOLEAN"),
    }


def _reals(names: Sequence[str]) -> dict[str, str]:
    return dict.fromkeys(names, "DOUBLE")


def history_of(table: str, rows: str, entities: str, model: Callable[[str], str]) -> str:
    """What a table's history selects: its columns as at a tick, in their order.

    Args:
        table: a table of a world.
        rows: a SELECT of what differs from tick to tick.
        entities: the same of the table of entities.
        model: the name of the table of what is fixed of a table.
    """
    columns = [column.name for column in TABLES[table]]
    if table not in KEYS:
        return f"SELECT {_listed(columns)} FROM ({rows}) AS rows"  # noqa: S608
    varying = columns_of(table)
    told = _listed(columns, lambda name: "rows" if name in varying else "model")
    if table == "links":  # of a body of one link, that is the body
        reals = _listed(STORED["links"].names_of_reals("links"))
        rows += (
            f" UNION ALL SELECT tick, id, 0, {reals} FROM ({entities}) AS entities "  # noqa: S608
            f"WHERE id IN (SELECT id FROM {model('entities')} WHERE links = 1)"
        )
    keys = _listed(KEYS[table])
    return f"SELECT {told} FROM ({rows}) AS rows JOIN {model(table)} AS model USING ({keys})"  # noqa: S608


def whole_rows(
    rows: str, columns: Mapping[str, str], present: Collection[str], missing: Mapping[str, str]
) -> str:
    """A SELECT of all columns of a table from rows of which an older record lacks some.

    Args:
        rows: what stands behind FROM.
        columns: the names and the types.
        present: those that are there.
        missing: the values of others, in SQL; without one a column is NULL.
    """
    told = ", ".join(
        quoted(name)
        if name in present
        else f"({missing.get(name, 'NULL')})::{type} AS {quoted(name)}"
        for name, type in columns.items()
    )
    return f"SELECT {told} FROM {rows}"  # noqa: S608


def _listed(names: Iterable[str], table: Callable[[str], str] | None = None) -> str:
    """Columns in SQL, each with the table that it is of."""
    return ", ".join(
        quoted(name) if table is None else f"{table(name)}.{quoted(name)}" for name in names
    )


def _create(place: str, columns: Mapping[str, str], *, replace: bool = False) -> str:
    told = ", ".join(f"{quoted(name)} {type}" for name, type in columns.items())
    return f"CREATE {'OR REPLACE ' if replace else ''}TABLE {place} ({told})"


def quoted(name: str) -> str:
    """A name in SQL."""
    return exp.to_identifier(name, quoted=True).sql("duckdb")


def _changes(table: str, rows: pa.Table) -> pa.Table:
    """The rows that differ from those of the tick before, each with the last tick it holds at."""
    if not rows.num_rows:
        return rows.append_column("until", rows["tick"])
    keys = ("entity", "link") if table == FRAMES else KEYS[table]
    order = np.lexsort([rows[name].to_numpy() for name in ("tick", *reversed(keys))])
    sorted_rows = rows.take(order)
    ticks = sorted_rows["tick"].to_numpy()
    same = np.ones(len(ticks) - 1, dtype=bool)
    for name in sorted_rows.column_names:
        if name in ("tick", "time"):
            continue
        values = sorted_rows[name].to_numpy()
        before, now = values[:-1], values[1:]
        unknown = np.isnan(before) & np.isnan(now) if values.dtype == np.float64 else False
        same &= (before == now) | unknown
    # A run ends where something is missing in between, as well.
    present = np.unique(ticks)
    place = np.searchsorted(present, ticks)
    same &= place[1:] == place[:-1] + 1
    starts = np.concatenate(([0], np.flatnonzero(~same) + 1))
    ends = np.concatenate((starts[1:] - 1, [len(ticks) - 1]))
    return sorted_rows.take(starts).append_column("until", pa.array(ticks[ends]))
