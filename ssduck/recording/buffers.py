"""Buffers rows of ticks until they are stored, in numpy arrays that an Arrow table shares.

The table shows new rows at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ssduck.errors import RecordError
from ssduck.geometry.arrays import Array
from ssduck.recording.stores.stored_columns import with_nulls
from ssduck.schema import RECORDED
from ssduck.world.live_tables import new_version

# The largest number of buffered rows of a table.
MAX_BUFFERED_ROWS = 1 << 17
_MIN_ROWS = 1024
# A buffer that is filled to this part, 1 / n, is lent with its rows; fewer rows are copied.
_LENT_FRACTION = 4
# Numbers of ticks are less, so that each of them is also a double.
_MAX_TICK = 1 << 53


@dataclass(frozen=True, eq=False)
class TickRows:
    """Rows of some ticks, in the order of these."""

    # the columns of integers, `tick` among them, and of booleans, as 0 and 1, by name
    numbers: Mapping[str, npt.NDArray[Any]]
    doubles: Array  # the columns of doubles, (columns, rows), the time first

    def __len__(self) -> int:
        return len(self.doubles[0])

    def arrow(self, table: str) -> pa.Table:
        """Returns them as rows of a table."""
        names, schema = RECORDED[table].tick_columns.doubles, buffer_schema(table)
        columns = {**self.numbers, **dict(zip(names, self.doubles, strict=True))}
        return pa.table([columns[name] for name in schema.names], schema=schema)


class RowBuffer:
    """Buffered rows of one table."""

    def __init__(self, table: str) -> None:
        self._names = RECORDED[table].tick_columns
        self.count = 0  # the number of buffered rows
        self._allocate(_MIN_ROWS)

    def _allocate(self, capacity: int) -> None:
        names = self._names
        self.capacity = capacity  # the number of rows that fit
        # The columns of doubles, (columns, capacity), and all columns by name, (capacity,).
        self._doubles = np.zeros((len(names.doubles), capacity))
        self._columns: dict[str, npt.NDArray[Any]] = {
            **{name: np.zeros(capacity, np.int64) for name in names.integers},
            **dict(zip(names.doubles, self._doubles, strict=True)),
            **{name: np.zeros(capacity, np.uint8) for name in names.booleans},
        }
        self._columns["tick"].fill(-1)
        self.arrow = self._table(slice(0, capacity))  # the table; its unused rows have tick -1
        # A number that changes whenever `arrow` becomes another object.
        self.version = new_version()

    def _table(self, rows: slice, *, copied: bool = False) -> pa.Table:
        """Returns rows as a table that shares their memory, unless it is to be copied."""
        columns = [column[rows] for column in self._columns.values()]
        arrays = [
            pa.Array.from_buffers(
                pa.from_numpy_dtype(column.dtype),
                len(column),
                [None, pa.py_buffer(column.copy() if copied else column)],
            )
            for column in columns
        ]
        return pa.table(arrays, names=list(self._columns))

    @property
    def row_bytes(self) -> int:
        """The size of a row, bytes."""
        return sum(column.itemsize for column in self._columns.values())

    def has_room(self, count: int) -> bool:
        """Checks whether a number of further rows fit."""
        return self.count + count <= self.capacity

    def reserve(self, count: int, ticks: int) -> None:
        """Makes room for ticks of `count` rows each, and keeps the buffered rows."""
        required = max(min(count * ticks, MAX_BUFFERED_ROWS), count, _MIN_ROWS)
        if self.has_room(count) and required <= self.capacity:
            return
        before, buffered = self._columns, slice(0, self.count)
        self._allocate(max(required, self.count + count, 2 * self.count))
        for name, column in before.items():
            self._columns[name][buffered] = column[buffered]

    def add(self, rows: TickRows) -> None:
        """Adds rows, for which there must be room."""
        place = slice(self.count, self.count + len(rows))
        self.count = place.stop
        self._doubles[:, place] = rows.doubles
        for name, column in rows.numbers.items():
            self._columns[name][place] = column

    def rows(self) -> pa.Table:
        """Returns the buffered rows, with NULL for NaN."""
        return with_nulls(self.arrow.slice(0, self.count))

    def rows_between(self, first: int, last: int) -> pa.Table:
        """Returns a copy of the buffered rows at the ticks from first to last."""
        ends = np.searchsorted(self._columns["tick"][: self.count], [first, last + 1]).tolist()
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
        self._columns["tick"][: self.count] = -1
        self.count = 0


@cache
def buffer_schema(table: str) -> pa.Schema:
    """Returns the names and types of the columns of a table's buffer."""
    return RowBuffer(table).arrow.schema


class TickBuffer:
    """The numbers and times of recorded ticks, ascending."""

    def __init__(self) -> None:
        self.replace(np.zeros(0, dtype=np.int64), np.zeros(0))
        self.has_dropped = False  # whether ticks were removed

    def __len__(self) -> int:
        return self._end - self._first

    @classmethod
    def from_arrays(cls, numbers: npt.ArrayLike, times: npt.ArrayLike) -> TickBuffer:
        """Makes a buffer of ticks in ascending order."""
        ticks = cls()
        ticks.replace(np.array(numbers, dtype=np.int64), np.array(times, dtype=np.float64))
        return ticks

    @classmethod
    def checked(cls, rows: pa.Table, source: str) -> TickBuffer:
        """Makes a buffer of the ticks of a stored record, which are to be in order."""
        if rows["tick"].null_count or rows["time"].null_count:
            raise RecordError(f"{source} is damaged: a tick lacks its number or its time")
        numbers, times = rows["tick"].to_numpy(), rows["time"].to_numpy()
        if len(numbers) and not (numbers.min() >= 0 and numbers.max() < _MAX_TICK):
            raise RecordError(f"{source} is damaged: the number of a tick is out of bounds")
        if (np.diff(numbers) <= 0).any():
            raise RecordError(f"{source} is damaged: its ticks do not ascend")
        if not np.isfinite(times).all() or (np.diff(times) < 0).any():
            raise RecordError(f"{source} is damaged: the times of its ticks do not ascend")
        return cls.from_arrays(numbers, times)

    def replace(self, numbers: npt.NDArray[np.int64], times: Array) -> None:
        """Replaces the ticks by others in ascending order, without copying them."""
        self._numbers, self._times = numbers, times
        self._first, self._end = 0, len(numbers)

    def append(self, number: int, time: float) -> None:
        """Adds a tick."""
        if self._end == len(self._numbers):
            count = len(self)
            room = np.zeros(max(256, count))
            numbers = np.concatenate((self.numbers, room.astype(np.int64)))
            self.replace(numbers, np.concatenate((self.times, room)))
            self._end = count
        self._numbers[self._end], self._times[self._end] = number, time
        self._end += 1

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
