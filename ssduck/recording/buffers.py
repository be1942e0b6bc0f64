"""Buffers rows of ticks until they are stored, in numpy arrays that an Arrow table shares.

The table shows new rows at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ssduck.geometry.arrays import Array
from ssduck.recording.stores.stored_columns import with_nulls
from ssduck.schema import RECORDED
from ssduck.world.live_tables import new_version

# The largest number of buffered rows of a table.
MAX_BUFFERED_ROWS = 1 << 17
_MIN_ROWS = 1024
# A buffer that is filled to this part, 1 / n, is lent with its rows; fewer rows are copied.
_LENT_FRACTION = 4


@dataclass(frozen=True, eq=False)
class TickRows:
    """Rows of some ticks, in the order of these."""

    # the columns of integers by name, `tick` among them
    integers: Mapping[str, npt.NDArray[np.int64]]
    doubles: Array  # the columns of doubles, (columns, rows), the time first
    booleans: Mapping[str, npt.NDArray[np.uint8]]  # the columns of booleans by name, as 0 and 1

    def __len__(self) -> int:
        return len(self.doubles[0])

    def arrow(self, table: str) -> pa.Table:
        """Returns them as rows of a table."""
        columns = RECORDED[table].tick_columns
        integers, booleans = self.integers, self.booleans
        arrays = [
            *(integers[name] for name in columns.integers),
            *self.doubles,
            *(booleans[name] for name in columns.booleans),
        ]
        return pa.table(arrays, schema=buffer_schema(table))


class RowBuffer:
    """Buffered rows of one table."""

    def __init__(
        self, integers: tuple[str, ...], doubles: tuple[str, ...], booleans: tuple[str, ...] = ()
    ) -> None:
        self._names = integers, doubles, booleans
        self.count = 0  # the number of buffered rows
        self._allocate(_MIN_ROWS)

    def _allocate(self, capacity: int) -> None:
        integers, doubles, booleans = self._names
        self.capacity = capacity  # the number of rows that fit
        self.integers = {name: np.zeros(capacity, dtype=np.int64) for name in integers}
        self.ticks = self.integers["tick"]  # the tick of each row, (capacity,)
        self.ticks.fill(-1)
        # The columns of doubles, (columns, capacity).
        self.doubles = np.zeros((len(doubles), capacity))
        self.booleans = {name: np.zeros(capacity, dtype=np.uint8) for name in booleans}
        self.arrow = self._table(slice(0, capacity))  # the table; its unused rows have tick -1
        # A number that changes whenever `arrow` becomes another object.
        self.version = new_version()

    def _table(self, rows: slice, *, copied: bool = False) -> pa.Table:
        """Returns rows as a table that shares their memory, unless it is to be copied."""
        integers, booleans = self.integers.values(), self.booleans.values()
        columns = [column[rows] for column in (*integers, *self.doubles, *booleans)]
        arrays = [
            pa.Array.from_buffers(
                pa.from_numpy_dtype(column.dtype),
                len(column),
                [None, pa.py_buffer(column.copy() if copied else column)],
            )
            for column in columns
        ]
        return pa.table(arrays, names=[name for names in self._names for name in names])

    @property
    def row_bytes(self) -> int:
        """The size of a row, bytes."""
        return 8 * (len(self.integers) + len(self.doubles)) + len(self.booleans)

    def has_room(self, count: int) -> bool:
        """Checks whether a number of further rows fit."""
        return self.count + count <= self.capacity

    def reserve(self, count: int, ticks: int) -> None:
        """Makes room for ticks of `count` rows each, and keeps the buffered rows."""
        required = max(min(count * ticks, MAX_BUFFERED_ROWS), count, _MIN_ROWS)
        if self.has_room(count) and required <= self.capacity:
            return
        buffered = slice(0, self.count)
        integers, doubles, booleans = self.integers, self.doubles, self.booleans
        self._allocate(max(required, self.count + count, 2 * self.count))
        self.doubles[:, buffered] = doubles[:, buffered]
        for new, old in ((self.integers, integers), (self.booleans, booleans)):
            for name, column in old.items():
                new[name][buffered] = column[buffered]

    def add(self, rows: TickRows) -> None:
        """Adds rows, for which there must be room."""
        place = slice(self.count, self.count + len(rows))
        self.count = place.stop
        self.doubles[:, place] = rows.doubles
        for own, new in ((self.booleans, rows.booleans), (self.integers, rows.integers)):
            for name, column in new.items():
                own[name][place] = column

    def rows(self) -> pa.Table:
        """Returns the buffered rows, with NULL for NaN."""
        return with_nulls(self.arrow.slice(0, self.count))

    def rows_between(self, first: int, last: int) -> pa.Table:
        """Returns a copy of the buffered rows at the ticks from first to last."""
        ends = np.searchsorted(self.ticks[: self.count], [first, last + 1]).tolist()
        return with_nulls(self._table(slice(*ends), copied=True))

    def take(self) -> pa.Table:
        """Returns the buffered rows and empties the buffer, which no longer shares their memory."""
        if _LENT_FRACTION * self.count < self.capacity:
            rows = with_nulls(self._table(slice(0, self.count), copied=True))
            self.clear()
        else:
            rows = self.rows()
            self._allocate(self.capacity)
            self.count = 0
        return rows

    def clear(self) -> None:
        """Discards the buffered rows."""
        self.ticks[: self.count] = -1
        self.count = 0


@cache
def buffer_schema(table: str) -> pa.Schema:
    """Returns the names and types of the columns of a table's buffer."""
    return new_buffer(table).arrow.schema


def new_buffer(table: str) -> RowBuffer:
    """Returns an empty buffer for the rows of a table."""
    columns = RECORDED[table].tick_columns
    return RowBuffer(columns.integers, columns.doubles, columns.booleans)


class TickBuffer:
    """The numbers and times of recorded ticks, ascending."""

    def __init__(self) -> None:
        self._numbers = np.zeros(256, dtype=np.int64)
        self._times = np.zeros(256)
        self._first = self._end = 0
        self.has_dropped = False  # whether ticks were removed

    def __len__(self) -> int:
        return self._end - self._first

    @classmethod
    def from_arrays(cls, numbers: npt.ArrayLike, times: npt.ArrayLike) -> TickBuffer:
        """Makes a buffer of ticks in ascending order."""
        ticks = cls()
        ticks._numbers = np.array(numbers, dtype=np.int64)
        ticks._times = np.array(times, dtype=np.float64)
        ticks._end = len(ticks._numbers)
        return ticks

    def replace(self, numbers: npt.NDArray[np.int64], times: Array) -> None:
        """Replaces the ticks by others in ascending order, without copying them."""
        self._numbers, self._times = numbers, times
        self._first, self._end = 0, len(numbers)

    def append(self, number: int, time: float) -> None:
        """Adds a tick."""
        if self._end == len(self._numbers):
            self._make_room()
        self._numbers[self._end], self._times[self._end] = number, time
        self._end += 1

    def _make_room(self) -> None:
        used = slice(self._first, self._end)
        count = len(self)
        numbers = np.zeros(max(256, 2 * count), dtype=np.int64)
        times = np.zeros(len(numbers))
        numbers[:count], times[:count] = self._numbers[used], self._times[used]
        self._numbers, self._times = numbers, times
        self._first, self._end = 0, count

    def drop_before(self, number: int) -> None:
        """Removes the ticks with lower numbers."""
        count = int(np.searchsorted(self.numbers, number))
        self._first += count
        self.has_dropped |= count > 0

    @property
    def numbers(self) -> npt.NDArray[np.int64]:
        """The numbers of the ticks, ascending, (n,)."""
        return self._numbers[self._first : self._end]

    @property
    def times(self) -> Array:
        """The simulated times of the ticks, s, never falling, (n,)."""
        return self._times[self._first : self._end]
