"""Stores the recorded ticks of a world in memory: full buffers, as they are.

Nothing is copied: DuckDB reads them where they are (`ssduck.recording.buffers`), which costs a tick
a tenth of storing it in DuckDB's tables. The oldest are dropped as a whole. The models of entities
are in a DuckDB schema, as those of a `ssduck.recording.stores.duckdb.DuckDBStore` are.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ssduck.geometry.arrays import Array, Indices
from ssduck.recording.background_writer import WHENEVER, BufferedRows, Cut
from ssduck.recording.buffers import buffer_schema
from ssduck.recording.spec import QUARTERS, Recording
from ssduck.recording.static_tables import ShapeNumbers
from ssduck.recording.stores.base import (
    PAIR_COLUMNS,
    PairRequest,
    StoreConnection,
    TickArchive,
    TickStore,
    Waiting,
)
from ssduck.recording.stores.history_sql import (
    BOX_TOLERANCE,
    history,
    near_rows,
    waiting_rows,
)
from ssduck.recording.stores.model_tables import ModelTables
from ssduck.schema import MODELS, POSE, RECORDED, TABLES, recorded_tables
from ssduck.world.layout import EntityInfo

# A part of fewer rows takes those that come next.
_LEAST_ROWS = 4096


class MemoryStore(TickStore, TickArchive):
    """The recorded ticks of a world in memory.

    Args:
        schema: the name of the DuckDB schema for the models.
        connection: a connection of its own.
        recording: what is recorded of each tick.
        world: the name of the world.
    """

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
        # The first tick of each part, and the time of its first and its last.
        self._parts: list[tuple[int, float, float]] = []

    @property
    def nbytes(self) -> int:
        """The memory of the stored rows, bytes."""
        return sum(part.nbytes for rows in self._stored.values() for part in rows.parts)

    def close(self, *, forget: bool) -> None:
        """Closes the connection; drops the models first, if they are to be forgotten."""
        self._models.close(forget=forget)

    # -- writing ------------------------------------------------------------------------------

    def add_members(self, members: Collection[EntityInfo], numbers: ShapeNumbers) -> None:
        """Stores the models of entities, before any row of theirs."""
        self._models.add_members(members, numbers)

    def add(self, rows: Mapping[str, pa.Table], cut: Cut = WHENEVER) -> None:
        """Keeps the rows of whole ticks, in the cut."""
        with cut:
            self._add(rows)

    def _add(self, rows: Mapping[str, pa.Table]) -> None:
        numbers, times = (rows["ticks"][name].to_numpy() for name in ("tick", "time"))
        joins = self._joins(len(numbers), float(times[-1]))
        new = dict(rows)
        if joins:
            for table, stored in self._stored.items():
                new[table] = pa.concat_tables([stored.parts[-1], new[table]]).combine_chunks()
        for table, stored in self._stored.items():
            stored.parts[len(stored.parts) - joins :] = [new[table]]
            stored.version += 1
        if joins:
            first, since, _ = self._parts.pop()
        else:
            first, since = int(numbers[0]), float(times[0])
        self._parts.append((first, since, float(times[-1])))

    def _joins(self, ticks: int, until: float) -> bool:
        """Whether so many ticks more go to the last part, for it is a small one."""
        if not self._parts or max(map(_last_rows, self._stored.values())) > _LEAST_ROWS:
            return False
        recording = self.recording
        ticks += self._stored["ticks"].parts[-1].num_rows
        if recording.ticks is not None and ticks > recording.ticks // QUARTERS:
            return False
        seconds = until - self._parts[-1][1]
        return recording.seconds is None or seconds <= recording.seconds / QUARTERS

    def drop_before(self, tick: int) -> int:
        """Drop parts whose ticks are all older; tells the first tick that is still there."""
        while len(self._parts) > 1 and self._parts[1][0] <= tick:
            del self._parts[0]
            for stored in self._stored.values():
                del stored.parts[0]
                stored.version += 1
        return self._parts[0][0]

    # -- reading ----------------------------------------------------------------------------

    def fetch(self, table: str, first: int, last: int) -> pa.Table:
        """The stored rows of a table at the ticks from first to last."""
        rows = self._between(table, first, last)
        ticks = rows["tick"].to_numpy()
        rows = rows.filter(pa.array((ticks >= first) & (ticks <= last)))
        for name in RECORDED[table].tick_columns.booleans:
            place = rows.column_names.index(name)
            rows = rows.set_column(place, name, rows[name].cast(pa.bool_()))
        return rows

    def _between(self, table: str, first: int, last: int) -> pa.Table:
        """The parts of a table that have the ticks from first to last."""
        starts = [start for start, _, _ in self._parts]
        begin = max(int(np.searchsorted(starts, first, side="right")) - 1, 0)
        end = int(np.searchsorted(starts, last, side="right"))
        stored = self._stored[table]
        return pa.concat_tables([stored.empty, *stored.parts[begin:end]])

    def near(self, request: PairRequest, waiting: pa.Table | None) -> pa.Table:
        """The pairs of entities whose boxes are near at a tick, or unknown."""
        stored = self._between("entities", request.first, request.last)
        rows = stored if waiting is None else pa.concat_tables([stored, waiting])
        if request.a and request.b and request.a != request.b:
            return _near_pair(rows, request)
        return near_rows(self._connection, None, request, rows)

    def select(self, table: str, waiting: Waiting | None) -> str | None:
        """The SELECT of the view of a table's history; None for a table that is not recorded.

        All rows wait, as far as DuckDB is concerned: it reads the stored ones from memory, too.
        """
        if table not in self.tables:
            return None
        assert waiting is not None
        rows, entities = (
            " UNION ALL ".join(waiting_rows(name, view) for view in waiting(name))
            for name in (table, "entities")
        )
        return history(TABLES[table], rows, entities, self._model)

    def models(self) -> dict[str, str]:
        """The SELECT of the view of each model, by the name of the view."""
        return {
            table.model_view: f"SELECT * FROM {self._model(table.name)}"  # noqa: S608
            for table in MODELS.values()
        }

    def _model(self, table: str) -> str:
        return self._models.source(table, None)


def _last_rows(rows: BufferedRows) -> int:
    """How many rows the last part has."""
    count: int = rows.parts[-1].num_rows
    return count


def _near_pair(rows: pa.Table, request: PairRequest) -> pa.Table:
    """What `near_rows` gives of one pair, picked out of the columns where they are.

    Args:
        rows: of entities, in parts of whole ticks, the oldest first.
        request: which pair.
    """
    parts = [_near_in(part, request) for part in rows.to_batches()]
    columns = zip(*parts, strict=True) if parts else [[np.zeros(0, np.int64)]] * len(PAIR_COLUMNS)
    return pa.table([np.concatenate(column) for column in columns], names=PAIR_COLUMNS)


def _near_in(part: pa.RecordBatch, request: PairRequest) -> list[npt.NDArray[Any]]:
    """The columns of `near_rows`, of some ticks."""
    start, end = np.searchsorted(
        part["tick"].to_numpy(), [request.first, request.last + 1]
    ).tolist()
    part = part.slice(start, max(end - start, 0))
    ticks, ids = part["tick"].to_numpy(), part["id"].to_numpy()
    one, other = np.flatnonzero(ids == request.a), np.flatnonzero(ids == request.b)
    if not np.array_equal(ticks[one], ticks[other]):  # one of them was not there all the time
        _, in_one, in_other = np.intersect1d(
            ticks[one], ticks[other], assume_unique=True, return_indices=True
        )
        one, other = one[in_one], other[in_other]

    def column(name: str, rows: Indices) -> Array:
        found: Array = part[name].to_numpy(zero_copy_only=False)[rows]
        return found  # NaN where it is not known, which is not far

    apart = request.apart + BOX_TOLERANCE
    far = np.zeros(len(one), dtype=bool)
    for axis in "xyz":
        for side, beside in ((one, other), (other, one)):
            far |= column(f"{axis}min", side) > column(f"{axis}max", beside) + apart
    one, other = one[~far], other[~far]
    poses = [column(name, side) for side in (one, other) for name in POSE]
    return [ticks[one], ids[one], ids[other], *poses]
