"""The operators of temporal logic on the values of a condition at all ticks of an episode.

A value is the margin by which the condition holds: more than 0 where it does, less where it does
not. `always` is then the minimum over a window of ticks, `eventually` the maximum, and NOT a change
of the sign. The same holds of truth values, with False below True.

What is not known lies between two bounds. An episode that goes on has a tick after its last one, at
which everything is unknown: so a verdict is known as soon as later ticks cannot change it, and both
of its bounds are the same.

A condition is constant from a tick to the next: a window that begins between two ticks begins with
the earlier one. Behind the last tick of an episode that has ended there is nothing: of an empty
window, `always` holds and `eventually` does not.

The semantics are those of Donzé and Maler, "Robust satisfaction of temporal logic over real-valued
signals", 2010. `until` in a window is taken apart as in Donzé, Ferrère and Maler, "Efficient robust
monitoring for STL", 2013.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.simulators.clock import TIME_TOLERANCE

# Margins or truth values.
Values: TypeAlias = npt.NDArray[Any]


@dataclass(frozen=True, eq=False)
class Trace:
    """The values of a condition at the n ticks of an episode, or of k episodes at once.

    They are margins or truth values; of two traces that are combined, both have the same kind.
    """

    times: Array  # the times of the ticks, s, ascending, (n,)
    low: Array  # the lower bounds, (n,) or (k, n)
    high: Array  # the upper bounds; the same array where all values are known
    is_open: bool = False  # whether the episode goes on

    @classmethod
    def of(
        cls, times: Array, values: Values, unknown: Flags | None = None, *, is_open: bool = False
    ) -> Trace:
        """Returns a trace of values, of which some may be unknown."""
        if unknown is None or not unknown.any():
            return cls(times, values, values, is_open)
        low, high = (np.where(unknown, bound, values) for bound in _bounds(values))
        return cls(times, low, high, is_open)

    @property
    def is_known(self) -> Flags:
        """Where nothing is unknown, and later ticks change nothing."""
        return np.asarray(self.low == self.high)

    @property
    def margins(self) -> Trace:
        """The trace with numbers in place of truth values: 1 and -1, and infinite where unknown."""
        if self.low.dtype != np.bool_:
            return self
        low = np.where(self.low, 1.0, np.where(self.high, -np.inf, -1.0))
        high = np.where(self.high, np.where(self.low, 1.0, np.inf), -1.0)
        return Trace(self.times, low, high, self.is_open)

    def of_bounds(self, bound: Callable[[Array, Array], Array], other: Trace) -> Trace:
        """Returns the trace of a function that grows with the margins of this and another one."""
        low = bound(self.low, other.low)
        if self.low is self.high and other.low is other.high:
            return Trace(self.times, low, low, self.is_open)
        return Trace(self.times, low, bound(self.high, other.high), self.is_open)

    def __and__(self, other: Trace) -> Trace:
        return self.of_bounds(np.minimum, other)

    def __or__(self, other: Trace) -> Trace:
        return self.of_bounds(np.maximum, other)

    def __invert__(self) -> Trace:
        low = _negated(self.high)
        high = low if self.low is self.high else _negated(self.low)
        return Trace(self.times, low, high, self.is_open)


@dataclass(frozen=True)
class Window:
    """The times that an operator looks at, counted from a tick; s."""

    start: float = 0.0
    end: float = np.inf

    def ahead(self, times: Array, *, is_open: bool) -> tuple[Indices, Indices]:
        """Returns the first and the last tick at the times after each tick; n for one to come."""
        first, last = (_last_until(times, bound) for bound in (self.start, self.end))
        end = times[-1] + TIME_TOLERANCE
        first[times + self.start > end] = len(times)
        if is_open:
            last[times + self.end > end] = len(times)
        return first, last

    def back(self, times: Array) -> tuple[Indices, Indices]:
        """Returns the first and the last tick at the times before each tick, -1 for none."""
        first, last = (_last_until(times, -bound) for bound in (self.end, self.start))
        return np.maximum(first, 0), last


def _last_until(times: Array, shift: float) -> Indices:
    """Returns the last tick until so many seconds after each tick; -1 for none."""
    count = len(times)
    if shift == 0.0:
        return np.arange(count)
    if np.isinf(shift):
        return np.full(count, count - 1 if shift > 0.0 else -1)
    return np.searchsorted(times, times + (shift + TIME_TOLERANCE), side="right") - 1


# -- operators ------------------------------------------------------------------------------------


def eventually(trace: Trace, window: Window = Window()) -> Trace:
    """Returns whether a condition holds at some tick of the window after each tick."""
    first, last = window.ahead(trace.times, is_open=trace.is_open)
    return _of_ticks_to_come(lambda values: _largest(values, first, last), trace)


def always(trace: Trace, window: Window = Window()) -> Trace:
    """Returns whether a condition holds at all ticks of the window after each tick."""
    return ~eventually(~trace, window)


def until(trace: Trace, goal: Trace, window: Window = Window()) -> Trace:
    """Returns whether a goal holds at a tick of the window, and a condition at all before that."""
    first, last = window.ahead(trace.times, is_open=trace.is_open)
    found = _until(trace, goal, first, last)
    # A window that has not begun may begin with the last tick, if the next one comes after that.
    may_begin = np.minimum(first, len(first) - 1)
    if not trace.is_open or (may_begin == first).all():
        return found
    other = _until(trace, goal, may_begin, last)
    low, high = np.minimum(found.low, other.low), np.maximum(found.high, other.high)
    return Trace(trace.times, low, high, is_open=True)


def _until(trace: Trace, goal: Trace, first: Indices, last: Indices) -> Trace:
    """Returns `until` of the windows from one tick to another."""
    here = np.arange(len(first))

    def bound(values: Array, goals: Array) -> Array:
        at_goal = _largest(goals, first, last)
        before = _negated(_largest(_negated(values), here, first - 1))
        whole = scanned(values[..., ::-1], goals[..., ::-1])[..., ::-1]
        return np.minimum(np.minimum(at_goal, before), _at(whole, first))

    return _of_ticks_to_come(bound, trace, goal)


def once(trace: Trace, window: Window = Window()) -> Trace:
    """Returns whether a condition held at some tick of the window before each tick."""
    first, last = window.back(trace.times)
    return trace.of_bounds(lambda values, _: _largest(values, first, last), trace)


def historically(trace: Trace, window: Window = Window()) -> Trace:
    """Returns whether a condition held at all ticks of the window before each tick."""
    return ~once(~trace, window)


def held_since(trace: Trace, start: Trace, window: Window = Window()) -> Trace:
    """Returns whether a start held at a tick of the window, and a condition at all after that."""
    first, last = window.back(trace.times)
    here = np.arange(len(first))

    def bound(values: Array, starts: Array) -> Array:
        at_start = _largest(starts, first, last)
        after = _negated(_largest(_negated(values), last + 1, here))
        return np.minimum(np.minimum(at_start, after), _at(scanned(values, starts), last))

    return trace.of_bounds(bound, start)


# -- arrays ---------------------------------------------------------------------------------------


def _bounds(values: Array) -> tuple[Any, Any]:
    """Returns the least and the largest value of a kind."""
    return (False, True) if values.dtype == np.bool_ else (-np.inf, np.inf)


def _negated(values: Array) -> Array:
    return np.logical_not(values) if values.dtype == np.bool_ else -values


def _of_ticks_to_come(bound: Callable[..., Array], *traces: Trace) -> Trace:
    """Returns the trace of a function that grows with margins, also those of a tick to come."""
    trace = traces[0]
    if not trace.is_open:
        low = bound(*(one.low for one in traces))
        is_known = all(one.low is one.high for one in traces)
        return Trace(trace.times, low, low if is_known else bound(*(one.high for one in traces)))
    lows = (_with_one_more(one.low, _bounds(one.low)[0]) for one in traces)
    highs = (_with_one_more(one.high, _bounds(one.high)[1]) for one in traces)
    return Trace(trace.times, bound(*lows), bound(*highs), is_open=True)


def _with_one_more(values: Array, value: Any) -> Array:
    return np.concatenate((values, np.full((*values.shape[:-1], 1), value)), axis=-1)


def _at(values: Array, places: Indices) -> Array:
    """Returns the values at some ticks, the least one where there is none."""
    count = values.shape[-1]
    is_tick = (places >= 0) & (places < count)
    return np.where(is_tick, values[..., np.where(is_tick, places, 0)], _bounds(values)[0])


def _largest(values: Array, first: Indices, last: Indices) -> Array:
    """Returns the largest value from each tick to another, the least one where there is none.

    A window of a length is that of two which overlap, of the largest power of two that fits. So one
    pass over the values for each power is enough for windows of all lengths.
    """
    if not first.any():  # as without a beginning
        return _at(np.maximum.accumulate(values, axis=-1), last)
    if last[0] >= 0 and (last == last[0]).all():  # as without an end
        ahead = values[..., last[0] :: -1]
        return _at(np.maximum.accumulate(ahead, axis=-1)[..., ::-1], first)
    lengths = last - first + 1
    result = np.full((*values.shape[:-1], len(first)), _bounds(values)[0])
    powers = np.frexp(np.maximum(lengths, 1))[1] - 1
    powers[lengths < 1] = -1
    # Of the windows that begin at each tick.
    largest, size = values, 1
    for power in range(int(powers.max(initial=-1)) + 1):
        places = np.flatnonzero(powers == power)
        if len(places):
            starts, ends = first[places], last[places] + 1 - size
            result[..., places] = np.maximum(largest[..., starts], largest[..., ends])
        largest = np.maximum(largest[..., : -size or None], largest[..., size:])
        size *= 2
    return result


def scanned(values: Array, starts: Array) -> Array:
    """Returns x[i] = max(starts[i], min(values[i], x[i - 1])), of which x[0] is starts[0].

    A step is a function of the one before: x -> max(start, min(value, x)). Two of these one after
    the other are such a function, too; so the first 1, 2, 4, … steps of each tick are joined.
    """
    starts, values = starts.copy(), values.copy()
    size = 1
    while size < starts.shape[-1]:
        joined = np.minimum(values[..., size:], starts[..., :-size])
        starts[..., size:] = np.maximum(starts[..., size:], joined)
        values[..., size:] = np.minimum(values[..., size:], values[..., :-size])
        size *= 2
    return starts
