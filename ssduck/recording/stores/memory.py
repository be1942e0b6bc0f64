"""The history of a world in memory: the rings that are full, as they are.

Nothing is copied: DuckDB looks into them where they are (`ssduck.recording.buffers`), which costs a
tick a tenth of what storing it in DuckDB's tables does. The oldest are dropped as a whole.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ssduck.geometry.arrays import Array, Indices
from ssduck.recording.background_writer import WHENEVER, BufferedRows, Cut
from ssduck.recording.buffers import STORED, in_parts
from ssduck.recording.spec import QUARTERS
from ssduck.recording.stores.duckdb import (
    BOXES_OFF,
    NEAR_COLUMNS,
    POSE,
    DuckDBStore,
    PairRequest,
    Waiting,
    near_rows,
)

# Fewer rows are put together with those before them.
_LEAST_ROWS = 4096


class MemoryStore(DuckDBStore):
    """The kept ticks of a world in memory; see `ssduck.recording.stores.duckdb.DuckDBStore`.

    Attributes:
        shown: what DuckDB is to be shown of it, by table.
    """

    keeps = True

    def _make_tables(self) -> None:
        self._kept = {table: BufferedRows(in_parts(table)) for table in self.tables}
        self.shown = (self._kept,)
        # The first tick of each part, and the time of its first and its last.
        self._parts: list[tuple[int, float, float]] = []

    # -- writing ----------------------------------------------------------------------------

    def add(self, rows: Mapping[str, pa.Table], cut: Cut = WHENEVER) -> None:
        """Keep the rows of whole ticks, all or none of them; enters the cut to do so."""
        with cut:
            self._add(rows)

    def _add(self, rows: Mapping[str, pa.Table]) -> None:
        numbers, times = (rows["ticks"][name].to_numpy() for name in ("tick", "time"))
        joined = self._joins(len(numbers), float(times[-1]))
        new = dict(rows)
        if joined:
            for table, kept in self._kept.items():
                new[table] = pa.concat_tables([kept.parts[-1], new[table]]).combine_chunks()
        for table, kept in self._kept.items():
            kept.parts[len(kept.parts) - joined :] = [new[table]]
            kept.version += 1
        if joined:
            first, since, _ = self._parts.pop()
        else:
            first, since = int(numbers[0]), float(times[0])
        self._parts.append((first, since, float(times[-1])))

    def _joins(self, ticks: int, until: float) -> bool:
        """Whether so many ticks more go to the last part, for it is a small one."""
        if not self._parts or max(k.parts[-1].num_rows for k in self._kept.values()) > _LEAST_ROWS:
            return False
        recording = self.recording
        ticks += self._kept["ticks"].parts[-1].num_rows
        if recording.ticks is not None and ticks > recording.ticks // QUARTERS:
            return False
        seconds = until - self._parts[-1][1]
        return recording.seconds is None or seconds <= recording.seconds / QUARTERS

    def drop_before(self, tick: int) -> int:
        """Drop parts whose ticks are all older; tells the first tick that is still there."""
        while len(self._parts) > 1 and self._parts[1][0] <= tick:
            del self._parts[0]
            for kept in self._kept.values():
                del kept.parts[0]
                kept.version += 1
        return self._parts[0][0]

    # -- reading ----------------------------------------------------------------------------

    def fetch(self, table: str, first: int, last: int) -> pa.Table:
        """The kept rows of a table at ticks from first to last, what waits left out."""
        found = self._between(table, first, last)
        ticks = found["tick"].to_numpy()
        found = found.filter(pa.array((ticks >= first) & (ticks <= last)))
        for name in STORED[table].flags if table in STORED else ():
            place = found.column_names.index(name)
            found = found.set_column(place, name, found[name].cast(pa.bool_()))
        return found

    def _between(self, table: str, first: int, last: int) -> pa.Table:
        """The parts of a table that have the ticks from first to last."""
        starts = [start for start, _, _ in self._parts]
        begin = max(int(np.searchsorted(starts, first, side="right")) - 1, 0)
        end = int(np.searchsorted(starts, last, side="right"))
        kept = self._kept[table]
        return pa.concat_tables([kept.empty, *kept.parts[begin:end]])

    def near(self, asked: PairRequest, waiting: pa.Table | None) -> pa.Table:
        """The pairs of entities whose boxes are near at some ticks; see `near_rows`."""
        kept = self._between("entities", asked.first, asked.last)
        rows = kept if waiting is None else pa.concat_tables([kept, waiting])
        if asked.a and asked.b and asked.a != asked.b:
            return _near_of_two(rows, asked)
        return near_rows(self._writer, None, asked, rows)

    def _all(self, table: str, rings: Waiting | None) -> str:
        """A SELECT of all rows of a table, those that wait among them."""
        assert rings is not None
        return " UNION ALL ".join(self._of_ring(table, ring) for ring in rings(table))


def _near_of_two(rows: pa.Table, asked: PairRequest) -> pa.Table:
    """What `near_rows` gives of one pair, picked out of the columns where they are.

    Args:
        rows: of entities, in parts of whole ticks, the oldest first.
        asked: which pair.
    """
    parts = [_near_in(part, asked) for part in rows.to_batches()]
    columns = zip(*parts, strict=True) if parts else [[np.zeros(0, np.int64)]] * len(NEAR_COLUMNS)
    return pa.table([np.concatenate(column) for column in columns], names=NEAR_COLUMNS)


def _near_in(part: pa.RecordBatch, asked: PairRequest) -> list[npt.NDArray[Any]]:
    """The columns of `near_rows`, of some ticks."""
    start, end = np.searchsorted(part["tick"].to_numpy(), [asked.first, asked.last + 1]).tolist()
    part = part.slice(start, max(end - start, 0))
    ticks, ids = part["tick"].to_numpy(), part["id"].to_numpy()
    one, other = np.flatnonzero(ids == asked.a), np.flatnonzero(ids == asked.b)
    if not np.array_equal(ticks[one], ticks[other]):  # one of them was not there all the time
        _, in_one, in_other = np.intersect1d(
            ticks[one], ticks[other], assume_unique=True, return_indices=True
        )
        one, other = one[in_one], other[in_other]

    def column(name: str, rows: Indices) -> Array:
        found: Array = part[name].to_numpy(zero_copy_only=False)[rows]
        return found  # NaN where it is not known, which is not far

    apart = asked.apart + BOXES_OFF
    far = np.zeros(len(one), dtype=bool)
    for axis in "xyz":
        for side, beside in ((one, other), (other, one)):
            far |= column(f"{axis}min", side) > column(f"{axis}max", beside) + apart
    one, other = one[~far], other[~far]
    poses = [column(name, side) for side in (one, other) for name in POSE]
    return [ticks[one], ids[one], ids[other], *poses]
