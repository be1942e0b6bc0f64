"""Rows of ticks that wait to be stored: numpy buffers that an Arrow table looks into.

Whoever holds that table sees the rows at once. Columns that are the same in each tick are laid
into a `RowBuffer` beforehand.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ssduck.geometry.arrays import Array
from ssduck.schema import RECORDED

# So many rows of a table wait at most to be stored.
MAX_BUFFERED_ROWS = 1 << 17
_LEAST_ROWS = 1024


class RowBuffer:
    """Rows of one table that wait to be stored.

    Attributes:
        arrow: the table; its unused rows are of tick -1.
        version: counts up whenever `arrow` became another object.
        count: how many rows wait.
        capacity: how many can.
        ticks: the numbers of their ticks.
        doubles: (columns, capacity).
    """

    def __init__(
        self, integers: tuple[str, ...], doubles: tuple[str, ...], booleans: tuple[str, ...] = ()
    ) -> None:
        self._names = integers, doubles, booleans
        self.version = 0
        self.count = 0
        self._lent: list[list[npt.NDArray[Any]]] = []
        self._make(_LEAST_ROWS)

    def _make(self, capacity: int) -> None:
        integers, doubles, booleans = self._names
        self.capacity = capacity
        # Who laid out the rows, of how many a tick, and whether from the first one on.
        self._laid: tuple[object, int] | None = None
        self._is_laid_whole = False
        numbers = self._numbers_of(capacity)
        self.integers = dict(zip(integers, numbers[: len(integers)], strict=True))
        self.ticks = self.integers["tick"]
        self.ticks.fill(-1)
        self.doubles = numbers[len(integers)]
        self.booleans = dict(zip(booleans, numbers[len(integers) + 1 :], strict=True))
        columns: list[npt.NDArray[Any]] = [
            *self.integers.values(),
            *self.doubles,
            *self.booleans.values(),
        ]
        arrays = [
            pa.Array.from_buffers(pa.from_numpy_dtype(c.dtype), capacity, [None, pa.py_buffer(c)])
            for c in columns
        ]
        self.arrow = pa.table(arrays, names=[*integers, *doubles, *booleans])
        self.version += 1

    def _numbers_of(self, capacity: int) -> list[npt.NDArray[Any]]:
        """Returns buffers of integers, doubles and booleans: old ones out of use, or new ones.

        Memory that the process already has is five times faster than new memory.
        """
        integers, doubles, booleans = self._names
        free = [own for own in self._lent if _is_free(own)]
        self._lent = [own for own in self._lent if not any(own is other for other in free)]
        for own in free:
            if len(own[0]) == capacity:
                return own
        return [
            *(np.zeros(capacity, dtype=np.int64) for _ in integers),
            np.zeros((len(doubles), capacity)),
            *(np.zeros(capacity, dtype=np.uint8) for _ in booleans),
        ]

    def takes(self, count: int) -> bool:
        """Whether it has room for so many rows more."""
        return self.count + count <= self.capacity

    def reserve(self, count: int, ticks: int) -> None:
        """Make room for some ticks of so many rows, beside what waits if it cannot be stored."""
        wanted = max(min(count * ticks, MAX_BUFFERED_ROWS), count, _LEAST_ROWS)
        if self.takes(count) and wanted <= self.capacity:
            return
        waiting, before = slice(0, self.count), (self.integers, self.doubles, self.booleans)
        self._make(max(wanted, self.count + count, 2 * self.count))
        self.doubles[:, waiting] = before[1][:, waiting]
        for now, then in ((self.integers, before[0]), (self.booleans, before[2])):
            for name, column in then.items():
                now[name][waiting] = column[waiting]

    def run(self, count: int) -> slice:
        """The place of so many new rows."""
        first, self.count = self.count, self.count + count
        return slice(first, self.count)

    def lay(self, owner: object, count: int, columns: Callable[[], Mapping[str, Any]]) -> None:
        """See to it that the rows to come have what is the same in each tick.

        Args:
            owner: what makes them; asked again, it has nothing else to tell.
            count: of rows a tick.
            columns: gives integers and booleans of them.
        """
        if not count or self._laid == (owner, count):
            return
        times = -(-(self.capacity - self.count) // count)
        for name, values in columns().items():
            column = self.booleans[name] if name in self.booleans else self.integers[name]
            column[self.count :] = np.tile(values, times)[: self.capacity - self.count]
        self._laid = owner, count
        self._is_laid_whole = self.count == 0

    def rows(self) -> pa.Table:
        """What waits; what is no number is NULL."""
        waiting = self.arrow.slice(0, self.count)
        with np.errstate(invalid="ignore"):  # a sum takes a third of the time of looking at each
            sums = self.doubles[:, : self.count].sum(axis=1)
        for row in np.flatnonzero(np.isnan(sums)).tolist():
            place = len(self.integers) + row
            column = pa.array(self.doubles[row, : self.count], from_pandas=True)
            waiting = waiting.set_column(place, waiting.column_names[place], column)
        return waiting

    def taken(self) -> pa.Table:
        """What waits; the buffer has nothing to do with it any more."""
        rows = self.rows()
        if 2 * self.count < self.capacity:
            rows = rows.take(pa.array(np.arange(self.count)))
            self.clear()
        else:
            self._lent.append([*self.integers.values(), self.doubles, *self.booleans.values()])
            self._make(self.capacity)
            self.count = 0
        return rows

    def clear(self) -> None:
        """Forget what waited."""
        self.ticks[: self.count] = -1
        self.count = 0
        if not self._is_laid_whole:
            self._laid = None


def _is_free(numbers: list[npt.NDArray[Any]]) -> bool:
    """Whether nobody but its list, and who asks, knows these buffers."""
    return all(sys.getrefcount(numbers[place]) == 2 for place in range(len(numbers)))


def buffer_schema(table: str) -> pa.Schema:
    """The names and types of the columns of a table's buffer."""
    return buffer_of(table).arrow.schema


def buffer_of(table: str) -> RowBuffer:
    """An empty buffer for the rows of a table."""
    columns = RECORDED[table].tick_columns
    return RowBuffer(columns.integers, columns.doubles, columns.booleans)


class TickBuffer:
    """The numbers and times of the ticks that are kept, ascending."""

    def __init__(self) -> None:
        self._numbers = np.zeros(256, dtype=np.int64)
        self._times = np.zeros(256)
        self._first = self._end = 0

    def __len__(self) -> int:
        return self._end - self._first

    @classmethod
    def of(cls, numbers: npt.ArrayLike, times: npt.ArrayLike) -> TickBuffer:
        """Such ticks, ascending; times in seconds."""
        ticks = cls()
        ticks._numbers = np.array(numbers, dtype=np.int64)
        ticks._times = np.array(times, dtype=np.float64)
        ticks._end = len(ticks._numbers)
        return ticks

    def append(self, number: int, time: float) -> None:
        """Note one more."""
        if self._end == len(self._numbers):
            self._make_room()
        self._numbers[self._end], self._times[self._end] = number, time
        self._end += 1

    def _make_room(self) -> None:
        kept = slice(self._first, self._end)
        count = len(self)
        numbers = np.zeros(max(256, 2 * count), dtype=np.int64)
        times = np.zeros(len(numbers))
        numbers[:count], times[:count] = self._numbers[kept], self._times[kept]
        self._numbers, self._times = numbers, times
        self._first, self._end = 0, count

    def forget_before(self, number: int) -> None:
        """Forget those of lower numbers."""
        self._first += int(np.searchsorted(self.numbers, number))

    @property
    def numbers(self) -> npt.NDArray[np.int64]:
        """(n,), ascending."""
        return self._numbers[self._first : self._end]

    @property
    def times(self) -> Array:
        """(n,), seconds, never falling."""
        return self._times[self._first : self._end]
