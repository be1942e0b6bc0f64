"""The values of an expression at the recorded ticks of a world."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.database.fetched_rows import columns_of
from ssduck.geometry.arrays import Array, Flags
from ssduck.language import ast
from ssduck.language.operators import truth
from ssduck.recording.replay.past import Past, past_of
from ssduck.recording.replay.record import Record

# The number of ticks that `since` reads first; each further read is four times as long.
FIRST_TICKS = 240
# The times of n ticks, s, (n,), each later than the one before, and the values at these, (n,):
# masked, or None of objects, where there is none.
_Values: TypeAlias = tuple[Array, npt.NDArray[Any]]
# Returns the first tick with the least clearance of two entities, and the clearance, m.
LeastClearance: TypeAlias = Callable[[Past], tuple[int, float] | None]


@dataclass(frozen=True, eq=False)
class TickColumns:
    """The values of an expression at some ticks."""

    ticks: npt.NDArray[np.int64]  # the numbers of n ticks in ascending order, (n,)
    values: npt.NDArray[Any]  # the values, (n,); masked, or None of objects, where there is none

    @classmethod
    def of(cls, rows: Sequence[Sequence[Any]]) -> TickColumns:
        """Returns those of rows [tick, time, value] in any order."""
        if not rows:
            return cls(np.zeros(0, np.int64), np.zeros(0, np.object_))
        numbers, _, values, *_ = columns_of(rows)
        ticks = np.asarray(numbers, np.int64)
        if (ticks[1:] < ticks[:-1]).any():
            places = np.argsort(ticks, kind="stable")
            ticks, values = ticks[places], values[places]
        return cls(ticks, values)

    def between(self, first: int, last: int) -> TickColumns:
        """Returns those of the ticks from one to another."""
        ends = np.searchsorted(self.ticks, first), np.searchsorted(self.ticks, last, "right")
        return TickColumns(self.ticks[slice(*ends)], self.values[slice(*ends)])


# Returns the values of an expression at some ticks.
ColumnsOf: TypeAlias = Callable[[Past], TickColumns]


class TickSeries:
    """The values of an expression at the recorded ticks of a world.

    Args:
        least_clearance: returns the least value of the expression at some ticks, of which no two
            have the same time, with its first tick; None if it is not the clearance of two
            entities.
        now: the number of the tick of a row of the past, up to which the series goes; None for the
            current tick of the world.
    """

    def __init__(
        self,
        record: Record,
        run: ColumnsOf,
        node: ast.Node,
        least_clearance: LeastClearance | None = None,
        now: int | None = None,
    ) -> None:
        self.record = record
        self._now = now
        self.node = node
        self.least_clearance = least_clearance
        self._run = run

    def ticks(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
        """Returns the numbers and the times of the ticks until now."""
        return self.record.ticks_until_now(self._now)

    @property
    def time(self) -> float:
        """The time of the tick that is now, s."""
        return self.record.world.time if self._now is None else float(self.ticks()[1][-1])

    def past(self, age: float | None) -> Past:
        """Returns the tick at a time, those of the last seconds, or all, as braces do."""
        return past_of(self.record, age, self._now)

    def whole(self, age: float | None) -> Past:
        """Returns the ticks of `past`; warns if some of them are kept no longer."""
        self.record.warn_of_dropped_ticks(age)
        return self.past(age)

    def window(self, first: float, last: float) -> Past:
        """Returns all ticks from one time to another."""
        numbers, times = self.ticks()
        start, end = np.searchsorted(times, first), np.searchsorted(times, last, side="right")
        return Past(self.record, int(numbers[start]), int(numbers[end - 1]), is_window=True)

    def at(self, past: Past) -> _Values:
        """Returns the times and values at some ticks; none where an entity was not there.

        Of several ticks of the same time, the last one replaces the others.
        """
        found = self._run(past)
        numbers, times = past.ticks_and_times
        are_last = are_last_of_their_times(times)
        if not are_last.all():
            numbers, times = numbers[are_last], times[are_last]
        if np.array_equal(found.ticks, numbers):
            return times, found.values
        if not len(found.ticks):
            return times, np.full(len(times), None)
        places = np.searchsorted(found.ticks, numbers, side="right") - 1
        values = np.ma.array(found.values[places])
        values[found.ticks[places] != numbers] = np.ma.masked
        return times, values

    def holding(self, past: Past) -> tuple[Array, Flags]:
        """Returns the times, and whether the expression was true."""
        times, values = self.at(past)
        if values.dtype == np.bool_:
            return times, np.ma.filled(values, False)
        return times, np.array(list(map(self.is_true, values.tolist())), np.bool_)

    def is_true(self, value: Any) -> bool:
        """Returns whether the expression is true where it has a value."""
        return is_true(value, self.node)

    def backwards(self) -> Iterator[Past]:
        """Yields all ticks in pieces, the last ones first, each four times as long as the last."""
        numbers, all_times = self.ticks()
        end, size = len(numbers), FIRST_TICKS
        while end > 0:
            # Ticks of the same time are in the same piece.
            start = int(np.searchsorted(all_times, all_times[max(end - size, 0)]))
            yield Past(self.record, int(numbers[start]), int(numbers[end - 1]), is_window=True)
            end, size = start, size * 4


def are_last_of_their_times(times: Array) -> Flags:
    """Returns which of n ticks count, (n,): of those of the same time, the last one."""
    return np.append(times[1:] != times[:-1], True)


def is_true(value: Any, node: ast.Node) -> bool:
    """Returns whether a condition is true where it has a value."""
    return value is True or (value is not None and value is not False and truth(value, node))
