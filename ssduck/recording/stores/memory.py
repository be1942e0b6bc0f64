"""Stores the recorded ticks of a world in memory, by keeping full buffers.

Nothing is copied: DuckDB reads the buffers in place (`ssduck.recording.buffers`), which takes a
tenth of the time of storing a tick in DuckDB's tables. The oldest buffers are dropped as a whole.
The models of entities are in a DuckDB schema, like those of a
`ssduck.recording.stores.duckdb.DuckDBStore`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ssduck.geometry.arrays import Array, Indices
from ssduck.recording.background_writer import NO_LOCK, BufferedRows, CommitLock
from ssduck.recording.buffers import buffer_schema
from ssduck.recording.spec import Recording, bytes_before_dropping, quarters_of
from ssduck.recording.stores.base import (
    PAIR_COLUMNS,
    BufferViews,
    PairRequest,
    StoreConnection,
    TickArchive,
    TickStore,
)
from ssduck.recording.stores.history_sql import (
    BOX_TOLERANCE,
    buffered_rows,
    history,
    near_pair_rows,
)
from ssduck.recording.stores.model_tables import ModelTables
from ssduck.schema import POSE, RECORDED, TABLES, recorded_tables
from ssduck.world.layout import EntityInfo
from ssduck.world.snapshot import Snapshot

# A part with fewer rows is joined with the next one.
_MIN_ROWS = 4096


class MemoryStore(TickStore, TickArchive):
    """The recorded ticks of a world in memory."""

    is_in_place = True

    def __init__(
        self, schema: str, connection: StoreConnection, recording: Recording, world: str
    ) -> None:
        self.recording = recording
        self.tables = recorded_tables(recording.tables)
        self._connection = connection
        self._models = ModelTables(schema, connection)
        with self._models.transaction():
            self._models.create(world, recording)
        self._stored = {table: BufferedRows(buffer_schema(table)) for table in self.tables}
        self.visible_rows = (self._stored,)
        # The first tick of each part, its first and its last time.
        self._parts: list[tuple[int, float, float]] = []
        self._max_bytes = bytes_before_dropping(recording)

    @property
    def nbytes(self) -> int:
        """The memory that the stored rows take, bytes."""
        return sum(part.nbytes for rows in self._stored.values() for part in rows.parts)

    def close(self, *, forget: bool) -> None:
        """Closes the connection; drops the models first if `forget` is set."""
        self._models.close(forget=forget)

    # -- writing ------------------------------------------------------------------------------

    def add_members(self, members: Collection[EntityInfo], snapshot: Snapshot) -> None:
        """Stores the models of entities, before any row of theirs."""
        self._models.add_members(members, snapshot, with_visuals=False)

    def add(self, rows: Mapping[str, pa.Table], commit_lock: CommitLock = NO_LOCK) -> None:
        """Keeps the rows of whole ticks, under the lock."""
        with commit_lock:
            self._add(rows)

    def _add(self, rows: Mapping[str, pa.Table]) -> None:
        numbers, times = (rows["ticks"][name].to_numpy() for name in ("tick", "time"))
        size = sum(table.nbytes for table in rows.values())
        is_joined = self._is_joined(len(numbers), float(times[-1]), size)
        new = dict(rows)
        if is_joined:
            for table, stored in self._stored.items():
                new[table] = pa.concat_tables([stored.parts[-1], new[table]]).combine_chunks()
        for table, stored in self._stored.items():
            stored.replace([*stored.parts[: len(stored.parts) - is_joined], new[table]])
        if is_joined:
            first, start, _ = self._parts.pop()
        else:
            first, start = int(numbers[0]), float(times[0])
        self._parts.append((first, start, float(times[-1])))

    def _is_joined(self, ticks: int, end: float, size: int) -> bool:
        """Checks whether further ticks are joined with the last part, as it is small."""
        last = [stored.parts[-1].num_rows for stored in self._stored.values() if self._parts]
        if not last or max(last) > _MIN_ROWS:
            return False
        size += sum(stored.parts[-1].nbytes for stored in self._stored.values())
        ticks += self._stored["ticks"].parts[-1].num_rows
        return quarters_of(self.recording, ticks, end - self._parts[-1][1], size) <= 1.0

    def drop_before(self, tick: int) -> int:
        """Drops parts whose ticks are all older; returns the first tick of the oldest one left."""
        while len(self._parts) > 1 and (self._parts[1][0] <= tick or self.nbytes > self._max_bytes):
            del self._parts[0]
            for stored in self._stored.values():
                stored.replace(stored.parts[1:])
        return self._parts[0][0]

    def begin_at(self, tick: int) -> None:
        """Drops all rows of older ticks; the memory of a part stays until the part is dropped."""
        self.drop_before(tick)
        for stored in self._stored.values():
            rows = stored.parts[0]
            start = int(np.searchsorted(rows["tick"].to_numpy(), tick))
            if start:
                stored.replace([rows.slice(start), *stored.parts[1:]])

    # -- reading ----------------------------------------------------------------------------

    def fetch(self, table: str, first: int, last: int) -> pa.Table:
        """Returns the stored rows of a table at the ticks from first to last."""
        rows = self._between(table, first, last)
        start, end = np.searchsorted(rows["tick"].to_numpy(), [first, last + 1]).tolist()
        rows = rows.slice(start, end - start)
        for name in RECORDED[table].tick_columns.booleans:
            place = rows.column_names.index(name)
            rows = rows.set_column(place, name, rows[name].cast(pa.bool_()))
        return rows

    def _between(self, table: str, first: int, last: int) -> pa.Table:
        """Returns the parts of a table that have the ticks from first to last."""
        starts = [start for start, _, _ in self._parts]
        begin = max(int(np.searchsorted(starts, first, side="right")) - 1, 0)
        end = int(np.searchsorted(starts, last, side="right"))
        stored = self._stored[table]
        return pa.concat_tables([stored.empty, *stored.parts[begin:end]])

    def near_pairs(self, request: PairRequest, buffered: pa.Table | None) -> pa.Table:
        """Returns the pairs of entities whose boxes are near at a tick, or unknown."""
        stored = self._between("entities", request.first, request.last)
        rows = stored if buffered is None else pa.concat_tables([stored, buffered])
        if request.a and request.b and request.a != request.b:
            return _near_pair(rows, request)
        return near_pair_rows(self._connection, None, request, rows)

    def select(self, table: str, buffer_views: BufferViews | None) -> str | None:
        """Returns the SELECT of the view of a table's history; None if it is not recorded.

        The stored rows are among the buffered ones for DuckDB: it reads both from memory.
        """
        if table not in self.tables:
            return None
        assert buffer_views is not None
        rows, entities = (
            " UNION ALL ".join(buffered_rows(name, view) for view in buffer_views(name))
            for name in (table, "entities")
        )
        return history(TABLES[table], rows, entities, self._models.source)

    def models(self) -> dict[str, str]:
        """Returns the SELECT of the view of each model, by the name of the view."""
        return self._models.views()


def _near_pair(rows: pa.Table, request: PairRequest) -> pa.Table:
    """Returns the result of `near_pair_rows` for one pair, taken from the columns in place."""
    parts = [_near_columns(part, request) for part in rows.to_batches()]
    columns = zip(*parts, strict=True) if parts else [[np.zeros(0, np.int64)]] * len(PAIR_COLUMNS)
    return pa.table([np.concatenate(column) for column in columns], names=PAIR_COLUMNS)


def _near_columns(part: pa.RecordBatch, request: PairRequest) -> list[npt.NDArray[Any]]:
    """Returns the columns of `near_pair_rows` for the ticks of a part."""
    start, end = np.searchsorted(
        part["tick"].to_numpy(), [request.first, request.last + 1]
    ).tolist()
    part = part.slice(start, max(end - start, 0))
    ticks, ids = part["tick"].to_numpy(), part["id"].to_numpy()
    rows_a, rows_b = np.flatnonzero(ids == request.a), np.flatnonzero(ids == request.b)
    if not np.array_equal(ticks[rows_a], ticks[rows_b]):  # one of them is missing at some ticks
        _, in_a, in_b = np.intersect1d(
            ticks[rows_a], ticks[rows_b], assume_unique=True, return_indices=True
        )
        rows_a, rows_b = rows_a[in_a], rows_b[in_b]

    def column(name: str, rows: Indices) -> Array:
        values: Array = part[name].to_numpy(zero_copy_only=False)[rows]
        return values  # NaN where unknown, which compares as not apart

    max_gap = request.max_gap + BOX_TOLERANCE
    are_apart = np.zeros(len(rows_a), dtype=bool)
    for axis in "xyz":
        for side, other in ((rows_a, rows_b), (rows_b, rows_a)):
            are_apart |= column(f"{axis}min", side) > column(f"{axis}max", other) + max_gap
    rows_a, rows_b = rows_a[~are_apart], rows_b[~are_apart]
    poses = [column(name, side) for side in (rows_a, rows_b) for name in POSE]
    return [ticks[rows_a], ids[rows_a], ids[rows_b], *poses]
