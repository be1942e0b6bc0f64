"""The values of an expression at the recorded ticks of a world."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.language.operators import truth
from ssduck.language.tree import Node
from ssduck.recording.replay.past import Past, past_of
from ssduck.recording.replay.record import Record

# The number of ticks that `since` reads first; each further read is twice as long.
FIRST_TICKS = 240
# Returns rows [tick, time, value] of some ticks.
RowsOf: TypeAlias = Callable[[Past], Sequence[Sequence[Any]]]
# Returns the first tick with the least clearance of two entities, and the clearance, m.
LeastClearance: TypeAlias = Callable[[Past], tuple[int, float] | None]


class TickSeries:
    """The values of an expression at the recorded ticks of a world.

    Args:
        record: the record of the world.
        run: a function that returns rows [tick, time, value] of some ticks.
        node: the expression.
        least_clearance: returns the least value of the expression at some ticks, of which no two
            have the same time, with its first tick; None if it is not the clearance of two
            entities.
        now: the number of the tick of a row of the past, up to which the series goes; None for the
            current tick of the world.
    """

    def __init__(
        self,
        record: Record,
        run: RowsOf,
        node: Node,
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

    def at(self, past: Past) -> tuple[list[float], list[Any]]:
        """Returns the times and values at some ticks; None where an entity was not there.

        Of several ticks of the same time, the last one replaces the others.
        """
        rows = self._run(past)
        ticks, times = past.ticks_and_times
        if [row[0] for row in rows] == ticks and len(set(times)) == len(times):
            return times, [row[2] for row in rows]
        values = {row[0]: row[2] for row in rows}
        last_ticks = dict(zip(times, ticks, strict=True))
        return list(last_ticks), [values.get(tick) for tick in last_ticks.values()]

    def holding(self, past: Past) -> tuple[list[float], list[bool]]:
        """Returns the times, and whether the expression was true."""
        times, values = self.at(past)
        return times, list(map(self.is_true, values))

    def is_true(self, value: Any) -> bool:
        """Returns whether the expression is true where it has a value."""
        return is_true(value, self.node)

    def backwards(self) -> Iterator[Past]:
        """Yields all ticks in pieces, the last ones first, each twice as long as the one before."""
        numbers, all_times = self.ticks()
        end, size = len(numbers), FIRST_TICKS
        while end > 0:
            # Ticks of the same time are in the same piece.
            start = int(np.searchsorted(all_times, all_times[max(end - size, 0)]))
            yield Past(self.record, int(numbers[start]), int(numbers[end - 1]), is_window=True)
            end, size = start, size * 2


def is_true(value: Any, node: Node) -> bool:
    """Returns whether a condition is true where it has a value."""
    return value is True or (value is not None and value is not False and truth(value, node))
