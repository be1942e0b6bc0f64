"""Stores the recorded ticks of a world in DuckDB, and selects them for its views.

Columns that differ from tick to tick are stored in tables of numbers, the models of entities once,
beside them. The views `<table>_history` join the two, and the rows that wait in buffers with those
that are stored.

The record of a world is a schema of its own. A connection of its own writes the rows and commits
them between queries (`ssduck.recording.background_writer`), so that no query sees a tick twice or
misses it. Where older ticks are dropped, each table is split into `SLOTS`: the oldest is dropped as
a whole, which takes no time and gives its memory back.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
import pyarrow as pa

from ssduck.recording.background_writer import WHENEVER, Cut
from ssduck.recording.buffers import TickBuffer
from ssduck.recording.spec import QUARTERS, Recording
from ssduck.recording.static_tables import ShapeNumbers
from ssduck.recording.stores.base import (
    PairRequest,
    StoreConnection,
    TickArchive,
    TickStore,
    Waiting,
)
from ssduck.recording.stores.history_sql import (
    all_columns,
    column_list,
    create_table,
    history,
    near_rows,
    waiting_rows,
)
from ssduck.recording.stores.model_tables import ModelTables
from ssduck.schema import FRAMES, MODELS, RECORDED, TABLES, recorded_tables
from ssduck.world.layout import EntityInfo

SLOTS = QUARTERS + 2


class DuckDBStore(TickStore, TickArchive):
    """The stored ticks of a world in a DuckDB schema.

    Args:
        schema: the name of the schema.
        connection: a connection of its own.
        recording: what is recorded of each tick.
        world: the name of the world, to make the schema; None to read one that is there already.
        catalog: the attached file that has the schema; None for the database itself.
    """

    def __init__(
        self,
        schema: str,
        connection: StoreConnection,
        recording: Recording,
        world: str | None = None,
        *,
        catalog: str | None = None,
    ) -> None:
        self.recording = recording
        self.tables = recorded_tables(recording.tables)
        self._connection = connection
        self._models = ModelTables(schema, connection, catalog)
        self._slots = SLOTS if recording.is_bounded else 1
        # Of each slot in use, the oldest first: its number, and its first tick.
        self._used: list[tuple[int, int]] = [(0, 0)]
        # Of the last one: how many ticks it has, and the times of the first and the last.
        self._filled, self._times = 0, (0.0, 0.0)
        self._is_new = world is not None
        # Of an older record: the columns that the stored rows of each table have.
        self._present: dict[str, frozenset[str]] = {}
        if world is not None:
            with self._models.transaction():
                self._models.create(world, recording)
                for table in self.tables:
                    for slot in range(self._slots):
                        self._make_slot(table, slot)

    def close(self, *, forget: bool) -> None:
        """Closes the connection; drops the schema first, if it is to be forgotten."""
        self._models.close(forget=forget)

    def place(self, name: str) -> str:
        """A table or view of the schema, in SQL."""
        return self._models.place(name)

    def _slot(self, table: str, slot: int) -> str:
        return self.place(f"{table} {slot}")

    def _make_slot(self, table: str, slot: int, *, replace: bool = False) -> None:
        columns = RECORDED[table].tick_columns.sql
        if self._has_changes_only(table):
            columns |= {"until": "BIGINT"}
        self._connection.run(create_table(self._slot(table, slot), columns, replace=replace))

    def _has_changes_only(self, table: str) -> bool:
        """Whether rows of a table are stored only where they changed."""
        return self.recording.changed and bool(RECORDED[table].key)

    # -- writing ------------------------------------------------------------------------------

    def add_members(self, members: Collection[EntityInfo], numbers: ShapeNumbers) -> None:
        """Stores the models of entities, before any row of theirs."""
        self._models.add_members(members, numbers)

    def add(self, rows: Mapping[str, pa.Table], cut: Cut = WHENEVER) -> None:
        """Stores the rows of whole ticks, all or nothing; commits in the cut."""
        numbers, times = (rows["ticks"][name].to_numpy() for name in ("tick", "time"))
        self._choose_slot(int(numbers[0]))
        slot, _ = self._used[-1]
        self._models.insert(
            {
                self._slot(table, slot): _changed_rows(table, own)
                if self._has_changes_only(table)
                else own
                for table, own in rows.items()
                if own.num_rows
            },
            cut,
        )
        first = self._times[0] if self._filled else float(times[0])
        self._filled, self._times = self._filled + len(times), (first, float(times[-1]))
        self._connection.settle()

    def _choose_slot(self, tick: int) -> None:
        """Takes the next slot, if this one has a quarter of what is kept."""
        if self._slots == 1:
            return
        if not self._filled:
            self._used[-1] = self._used[-1][0], tick
            return
        count, seconds = self._filled, self._times[1] - self._times[0]
        recording = self.recording
        is_full = recording.ticks is not None and count >= recording.ticks // QUARTERS
        # What is stored together ends a tick before a quarter is over.
        if recording.seconds is not None and seconds >= recording.seconds / QUARTERS / 2:
            is_full = True
        free = set(range(SLOTS)) - {number for number, _ in self._used}
        if is_full and free:
            self._used.append((free.pop(), tick))
            self._filled = 0

    def drop_before(self, tick: int) -> int:
        """Drops slots whose ticks are all older; returns the first tick that is still there."""
        while len(self._used) > 1 and self._used[1][1] <= tick:
            slot, _ = self._used.pop(0)
            for table in self.tables:
                self._make_slot(table, slot, replace=True)
        return self._used[0][1]

    # -- reading ------------------------------------------------------------------------------

    def ticks(self) -> TickBuffer:
        """The numbers and times of the stored ticks."""
        stored = self._stored("ticks")
        sql = f"SELECT tick, time FROM ({stored}) AS ticks ORDER BY tick"  # noqa: S608
        rows = self._connection.rows(sql)
        return TickBuffer.of(rows["tick"].to_numpy(), rows["time"].to_numpy())

    def model_rows(self) -> dict[str, pa.Table]:
        """The stored rows of each model, by the table that it is of."""
        return self._models.rows()

    def fetch(self, table: str, first: int, last: int) -> pa.Table:
        """The stored rows of a table at the ticks from first to last."""
        rows = self._stored(table)
        return self._connection.rows(
            f"SELECT * FROM ({rows}) AS stored WHERE tick BETWEEN ? AND ?",  # noqa: S608
            (first, last),
        )

    def near(self, request: PairRequest, waiting: pa.Table | None) -> pa.Table:
        """The pairs of entities whose boxes are near at a tick, or unknown."""
        return near_rows(self._connection, self._stored("entities"), request, waiting)

    def select(self, table: str, waiting: Waiting | None) -> str | None:
        """The SELECT of the view of a table's history; None for a table that is not recorded."""
        if table not in self.tables:
            return None
        rows, entities = self._all(table, waiting), self._all("entities", waiting)
        return history(TABLES[table], rows, entities, self._model)

    def models(self) -> dict[str, str]:
        """The SELECT of the view of each model, by the name of the view."""
        return {
            table.model_view: f"SELECT * FROM {self._model(table.name)}"  # noqa: S608
            for table in MODELS.values()
        }

    @property
    def views(self) -> dict[str, str]:
        """The SELECTs of the views of the stored rows, by the names of the views."""
        tables = [table for table in self.tables if table != FRAMES]
        histories = {TABLES[t].history_view: str(self.select(t, None)) for t in tables}
        return histories | self.models()

    def make_views(self) -> None:
        """Makes these views in the schema, where DuckDB can read them without ssduck."""
        for name, rows in self.views.items():
            self._connection.run(f"CREATE VIEW {self.place(name)} AS {rows}")

    def _model(self, table: str) -> str:
        return self._models.source(table, self.unrecorded_run)

    def _all(self, table: str, waiting: Waiting | None) -> str:
        """A SELECT of all rows of a table, those that wait among them."""
        views = () if waiting is None else waiting(table)
        parts = [self._stored(table), *(waiting_rows(table, view) for view in views)]
        return " UNION ALL ".join(parts)

    def _stored(self, table: str) -> str:
        """A SELECT of the stored rows of a table."""
        return " UNION ALL ".join(self._rows_of_slot(table, slot) for slot in range(self._slots))

    def _rows_of_slot(self, table: str, slot: int) -> str:
        columns = RECORDED[table].tick_columns
        rows = self._source_of_slot(table, slot)
        if not self._has_changes_only(table):
            return f"SELECT {column_list(columns.names)} FROM {rows}"  # noqa: S608
        listed = column_list(
            columns.names, lambda name: "ticks" if name in ("tick", "time") else "rows"
        )
        return (
            f"SELECT {listed} FROM (SELECT *, unnest(range(tick, until + 1)) AS at "  # noqa: S608
            f"FROM {rows}) AS rows JOIN {self._slot('ticks', slot)} AS ticks "
            "ON ticks.tick = rows.at"
        )

    def _source_of_slot(self, table: str, slot: int) -> str:
        """The stored rows of a slot, in SQL; of an older record with all columns."""
        place = self._slot(table, slot)
        if self._is_new:
            return place
        if table not in self._present:
            rows = self._connection.rows(f"SELECT * FROM {place} LIMIT 0")  # noqa: S608
            self._present[table] = frozenset(rows.column_names)
        present, columns = self._present[table], RECORDED[table].tick_columns.sql
        if present >= columns.keys():
            return place
        if self._has_changes_only(table):
            columns |= {"until": "BIGINT"}
        return f"({all_columns(place, columns, present, {})})"


def _changed_rows(table: str, rows: pa.Table) -> pa.Table:
    """The rows that differ from those of the tick before, each with the last tick it holds at."""
    if not rows.num_rows:
        return rows.append_column("until", rows["tick"])
    keys = RECORDED[table].key
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
