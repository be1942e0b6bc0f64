"""The operators of temporal logic, tick by tick: those that look ahead at the first tick only.

All of them are one: `once(c)` is `heldSince(True, c)`, and `historically(c)` is `NOT once(NOT c)`.
With x(i) = max(start(i), min(value(i), x(i - 1))), the margin of `heldSince` without a window, that
of a window which ends with tick j is the least of the largest start in the window, the values after
j, and x(j); see `ssduck.logic.traces`.

At the first tick of an episode that goes on, those that look ahead are one, too: `eventually(c)` is
`until(True, c)`, and `always(c)` is `NOT eventually(NOT c)`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from ssduck.geometry.arrays import Array
from ssduck.logic.traces import Window, scanned
from ssduck.simulators.clock import TIME_TOLERANCE

# A tick that the window has not reached: its time, s, the value, the start and x.
_Tick: TypeAlias = tuple[float, float, float, float]
_NEVER = -np.inf


@dataclass(frozen=True)
class HeldSince:
    """The state of `heldSince` at a tick, of one bound of its margin."""

    window: Window
    x: float = _NEVER  # x at the last tick
    # The ticks later than the end of the window, the first one first.
    later: tuple[_Tick, ...] = ()
    x_at_end: float = _NEVER  # x at the end of the window
    # The starts in the window that no later one reaches, the largest first, each with the time of
    # the tick after it: a window that begins then is without it. Of an endless window, the largest.
    starts: tuple[tuple[float, float], ...] = ()

    @property
    def margin(self) -> float:
        """The margin of the operator."""
        if not self.starts:
            return _NEVER
        return min((self.starts[0][0], self.x_at_end, *(tick[1] for tick in self.later)))

    def after(self, times: Array, values: Array, starts: Array) -> HeldSince:
        """Returns the state after the n ticks of an episode, the first ones; see `step`."""
        window, x = self.window, scanned(values, starts)
        is_endless = np.isinf(window.end)
        first = times[-1] - (window.start if is_endless else window.end) + TIME_TOLERANCE
        place = max(int(np.searchsorted(times, first, side="right")) - 1, 0)
        state = self
        if is_endless and place:
            largest = float(starts[:place].max())
            state = HeldSince(window, x_at_end=float(x[place - 1]), starts=((largest, np.inf),))
        columns = (column[place:].tolist() for column in (times, values, starts, x))
        for tick in zip(*columns, strict=True):
            state = state._with(*tick)
        return state

    def step(self, time: float, value: float, start: float) -> HeldSince:
        """Returns the state with one more tick."""
        return self._with(time, value, start, max(start, min(value, self.x)))

    def _with(self, time: float, value: float, start: float, x: float) -> HeldSince:
        later = (*self.later, (time, value, start, x))
        end = time - self.window.start + TIME_TOLERANCE
        begin = time - self.window.end + TIME_TOLERANCE
        starts, x_at_end, count = list(self.starts), self.x_at_end, 0
        while count < len(later) and later[count][0] <= end:
            came, _, reached, x_at_end = later[count]
            while starts and starts[-1][0] <= reached:
                starts.pop()
            if starts:
                starts[-1] = starts[-1][0], min(starts[-1][1], came)
            starts.append((reached, np.inf))
            count += 1
        if begin == -np.inf:
            return HeldSince(self.window, x, later[count:], x_at_end, tuple(starts[:1]))
        gone = 0
        while gone < len(starts) - 1 and starts[gone][1] <= begin:
            gone += 1
        return HeldSince(self.window, x, later[count:], x_at_end, tuple(starts[gone:]))


@dataclass(frozen=True)
class UntilFromFirst:
    """The state of `until` at the first tick of an episode, of one bound of its margin."""

    window: Window
    is_upper: bool  # whether it is the upper bound, by the ticks to come
    first: float | None = None  # the time of the first tick, s
    time: float = 0.0  # that of the last one
    held: float = np.inf  # the least value of the condition at all ticks
    # The margin by the last tick until the window begins, which counts from then on, and by others.
    at_begin: float = _NEVER
    later: float = _NEVER

    @property
    def margin(self) -> float:
        """The margin of the operator."""
        assert self.first is not None
        found, now = self.later, self.time + TIME_TOLERANCE
        # A window that has not begun may begin with this tick, if the next one comes later.
        if self.is_upper or self.first + self.window.start <= now:
            found = max(found, self.at_begin)
        may_come = self.is_upper and self.first + self.window.end > now
        return max(found, self.held) if may_come else found

    def after(self, times: Array, values: Array, starts: Array) -> UntilFromFirst:
        """Returns the state after the n ticks of an episode; see `step`."""
        state = self
        for tick in zip(times.tolist(), values.tolist(), starts.tolist(), strict=True):
            state = state.step(*tick)
        return state

    def step(self, time: float, value: float, start: float) -> UntilFromFirst:
        """Returns the state with one more tick; `start` is the goal."""
        first = time if self.first is None else self.first
        held, x = min(self.held, value), min(self.held, start)
        if time <= first + self.window.start + TIME_TOLERANCE:
            return replace(self, first=first, time=time, held=held, at_begin=x)
        later = max(self.later, self.at_begin)
        if time <= first + self.window.end + TIME_TOLERANCE:
            later = max(later, x)
        return replace(self, time=time, held=held, at_begin=_NEVER, later=later)
