"""Stores the recorded ticks of a world in DuckDB, and selects them for its views.

Columns that differ from tick to tick are stored in tables of numbers; the models of entities are
stored once, in tables of their own. The views `<table>_history` join the two, and unite buffered
and stored rows.

The record of a world is a schema. A separate connection writes the rows and commits them between
queries (`ssduck.recording.background_writer`), so that a query sees each tick exactly once. Where
older ticks are dropped, each table is split into `SLOTS`: the oldest is dropped as a whole, which
takes no time and releases its memory.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
import pyarrow as pa

from ssduck.recording.background_writer import NO_LOCK, CommitLock
from ssduck.recording.buffers import TickBuffer
from ssduck.recording.episode import Tags
from ssduck.recording.spec import RETENTION_PARTS, Recording, bytes_before_dropping, quarters_of
from ssduck.recording.stores.base import (
    BufferViews,
    PairRequest,
    StoreConnection,
    TickArchive,
    TickStore,
)
from ssduck.recording.stores.history_sql import (
    all_columns,
    buffered_rows,
    column_list,
    create_table,
    history,
    near_pair_rows,
)
from ssduck.recording.stores.model_tables import ModelTables, RecordFile
from ssduck.recording.stores.stored_columns import tick_types
from ssduck.schema import FRAMES, RECORDED, TABLES, recorded_tables
from ssduck.simulators.scenes import Camera
from ssduck.world.layout import EntityInfo
from ssduck.world.snapshot import Snapshot

SLOTS = RETENTION_PARTS + 2


class DuckDBStore(TickStore, TickArchive):
    """The stored ticks of a world in a DuckDB schema."""

    def __init__(
        self,
        schema: str,
        connection: StoreConnection,
        recording: Recording,
        world: str | None = None,
        *,
        file: RecordFile | None = None,
        tags: Tags | None = None,
        camera: Camera | None = None,
        order: int = 0,
    ) -> None:
        self.recording = recording
        self.tables = recorded_tables(recording.tables)
        self._connection = connection
        self._file = file
        self._models = ModelTables(schema, connection, file)
        self._slots = SLOTS if recording.is_bounded else 1
        # The number and the first tick of each slot in use, oldest first.
        self._used_slots: list[tuple[int, int]] = [(0, 0)]
        # The number of ticks of the last slot, and its first and last time.
        self._slot_ticks, self._slot_times = 0, (0.0, 0.0)
        # The size of the rows that were added to each slot in use, bytes, oldest first.
        self._slot_bytes = [0]
        self._max_bytes = bytes_before_dropping(recording)
        if world is not None:
            with self._models.transaction():
                self._models.create(world, recording, tags, camera, order)
                for table in self.tables:
                    for slot in range(self._slots):
                        self._create_slot(table, slot)

    def close(self, *, forget: bool) -> None:
        """Closes the connection; drops the schema first if `forget` is set."""
        self._models.close(forget=forget)

    def place(self, name: str) -> str:
        """Returns a table or view of the schema, in SQL."""
        return self._models.place(name)

    def _slot(self, table: str, slot: int) -> str:
        return self.place(f"{table} {slot}")

    def _create_slot(self, table: str, slot: int, *, replace: bool = False) -> None:
        columns = RECORDED[table].tick_columns.sql
        if self._has_changes_only(table):
            columns |= {"until": "BIGINT"}
        self._connection.run(create_table(self._slot(table, slot), columns, replace=replace))

    def _has_changes_only(self, table: str) -> bool:
        """Checks whether rows of a table are stored only where they changed."""
        return self.recording.changed and bool(RECORDED[table].key)

    # -- writing ------------------------------------------------------------------------------

    def add_members(self, members: Collection[EntityInfo], snapshot: Snapshot) -> None:
        """Stores the models of entities, before any row of theirs."""
        self._models.add_members(members, snapshot)

    def add(self, rows: Mapping[str, pa.Table], commit_lock: CommitLock = NO_LOCK) -> None:
        """Stores the rows of whole ticks, all or nothing; commits under the lock."""
        numbers, times = (rows["ticks"][name].to_numpy() for name in ("tick", "time"))
        self._choose_slot(int(numbers[0]))
        slot, _ = self._used_slots[-1]
        self._models.insert(
            {
                self._slot(table, slot): _changed_rows(table, added)
                if self._has_changes_only(table)
                else added
                for table, added in rows.items()
                if added.num_rows
            },
            commit_lock,
        )
        first = self._slot_times[0] if self._slot_ticks else float(times[0])
        self._slot_ticks, self._slot_times = (
            self._slot_ticks + len(times),
            (first, float(times[-1])),
        )
        self._slot_bytes[-1] += sum(added.nbytes for added in rows.values())
        self._connection.checkpoint()

    def _choose_slot(self, tick: int) -> None:
        """Begins the next slot if the last one has a quarter of the retained ticks."""
        if self._slots == 1:
            return
        if not self._slot_ticks:
            self._used_slots[-1] = self._used_slots[-1][0], tick
            return
        # Batches end a tick before a quarter is over: half of its time is enough.
        seconds = 2.0 * (self._slot_times[1] - self._slot_times[0])
        filled = quarters_of(self.recording, self._slot_ticks, seconds, self._slot_bytes[-1])
        free = set(range(SLOTS)) - {number for number, _ in self._used_slots}
        if filled >= 1.0 and free:
            self._used_slots.append((free.pop(), tick))
            self._slot_bytes.append(0)
            self._slot_ticks = 0

    def drop_before(self, tick: int) -> int:
        """Drops slots whose ticks are all older; returns the first tick of the oldest one left."""
        while len(self._used_slots) > 1 and (
            self._used_slots[1][1] <= tick or sum(self._slot_bytes) > self._max_bytes
        ):
            slot, _ = self._used_slots.pop(0)
            del self._slot_bytes[0]
            for table in self.tables:
                self._create_slot(table, slot, replace=True)
        return self._used_slots[0][1]

    def finish(self) -> None:
        """Marks the record as complete: its recorder was not killed."""
        self._models.mark_as_complete()

    # -- reading ------------------------------------------------------------------------------

    @property
    def has_ticks(self) -> bool:
        """Whether ticks are stored."""
        rows = self.stored_rows("ticks")
        return bool(self._connection.fetchall(f"SELECT tick FROM ({rows}) AS ticks LIMIT 1"))  # noqa: S608

    def ticks(self) -> TickBuffer:
        """Returns the numbers and times of the stored ticks."""
        stored = self.stored_rows("ticks")
        sql = f"SELECT tick, time FROM ({stored}) AS ticks ORDER BY tick"  # noqa: S608
        if self._file is None:
            rows = self._connection.rows(sql)
            return TickBuffer.from_arrays(rows["tick"].to_numpy(), rows["time"].to_numpy())
        source = f"{self._file.path}: the ticks of {self._models.schema}"
        return TickBuffer.checked(self._connection.rows(sql), source)

    def model_rows(self) -> dict[str, pa.Table]:
        """Returns the stored rows of each model, by the name of its table."""
        return self._models.rows()

    def fetch(self, table: str, first: int, last: int) -> pa.Table:
        """Returns the stored rows of a table at the ticks from first to last."""
        rows = self.stored_rows(table)
        return self._connection.rows(
            f"SELECT * FROM ({rows}) AS stored WHERE tick BETWEEN ? AND ?",  # noqa: S608
            (first, last),
        )

    def near_pairs(self, request: PairRequest, buffered: pa.Table | None) -> pa.Table:
        """Returns the pairs of entities whose boxes are near at a tick, or unknown."""
        return near_pair_rows(self._connection, self.stored_rows("entities"), request, buffered)

    def select(self, table: str, buffer_views: BufferViews | None) -> str | None:
        """Returns the SELECT of the view of a table's history; None if it is not recorded."""
        if table not in self.tables:
            return None
        rows, entities = (
            self._all_rows(table, buffer_views),
            self._all_rows("entities", buffer_views),
        )
        return history(TABLES[table], rows, entities, self.model_source)

    def models(self) -> dict[str, str]:
        """Returns the SELECT of the view of each model, by the name of the view."""
        return self._models.views()

    @property
    def views(self) -> dict[str, str]:
        """The SELECTs of the views of stored rows and models, by the names of the views."""
        tables = [table for table in self.tables if table != FRAMES]
        histories = {TABLES[t].history_view: str(self.select(t, None)) for t in tables}
        return histories | self.models()

    def create_views(self) -> None:
        """Creates the views in the schema, where DuckDB reads them without ssduck."""
        for name, rows in self.views.items():
            self._connection.run(f"CREATE VIEW {self.place(name)} AS {rows}")

    def model_source(self, table: str) -> str:
        """Returns the rows of a model, in SQL."""
        return self._models.source(table)

    def _all_rows(self, table: str, buffer_views: BufferViews | None) -> str:
        """Returns a SELECT of all rows of a table, buffered ones included."""
        views = () if buffer_views is None else buffer_views(table)
        parts = [self.stored_rows(table), *(buffered_rows(table, view) for view in views)]
        return " UNION ALL ".join(parts)

    def stored_rows(self, table: str) -> str:
        """Returns a SELECT of the stored rows of a table."""
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
        """Returns the stored rows of a slot, in SQL; those of a file checked, with NULL for NaN."""
        place = self._slot(table, slot)
        if self._file is None:
            return place
        types, columns = tick_types(table), RECORDED[table].tick_columns.sql
        if self._has_changes_only(table):
            types["until"], columns = "integer", columns | {"until": "BIGINT"}
        self._file.check(self._connection, self._models.schema, f"{table} {slot}", types)
        return f"({all_columns(place, columns)})"


def _changed_rows(table: str, rows: pa.Table) -> pa.Table:
    """Returns the rows that differ from those of the previous tick, and `until` when they hold."""
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
    # A run of equal rows also ends at a tick without such a row.
    present = np.unique(ticks)
    place = np.searchsorted(present, ticks)
    same &= place[1:] == place[:-1] + 1
    starts = np.concatenate(([0], np.flatnonzero(~same) + 1))
    ends = np.concatenate((starts[1:] - 1, [len(ticks) - 1]))
    return sorted_rows.take(starts).append_column("until", pa.array(ticks[ends]))
