"""Runs worlds for a simulated time: in lockstep, in real time, with a progress bar.

A *stop* is a simulated time since the start of the run, in seconds, at which ticks are taken:
whenever an observer of some world requests one, after every given number of steps where a recorder
or an observer gets the tick, and at the end. In real time, other threads get all ticks.
All worlds reach a stop before any observer is notified of it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Literal, Never, TypeAlias

import numpy as np

from ssduck import validation
from ssduck.errors import ArgumentError
from ssduck.formatting import short_repr
from ssduck.world.ticking import OF_STEPS, SteppedSimulation

# A function that is called with the simulated seconds that were run since the last call.
ProgressCallback: TypeAlias = Callable[[float], object]
# The share of a step by which sums of steps may be off.
_ROUNDING = 1e-6


def run(
    worlds: Sequence[SteppedSimulation],
    seconds: float,
    *,
    realtime: bool | float = False,
    progress: bool | Literal["always"] = False,
    every: int | None = 1,
    **others: Never,
) -> None:
    """Runs worlds for a simulated time, s; the arguments are those of `World.run`."""
    known = ("seconds", "realtime", "progress", "every")
    validation.no_others(others, "run", known, OF_STEPS)
    seconds = validation.duration(seconds, "run: seconds")
    speed = _speed(realtime)
    every = validation.tick_interval(every, "run: every")
    lanes = [_Lane(world, seconds, every, is_realtime=speed is not None) for world in worlds]
    start = time.monotonic()
    with _progress_bar(seconds, len(lanes), progress) as on_progress:
        for lane in lanes:
            if not lane.total:
                lane.world.step(0)
        while stops := [stop for lane in lanes if (stop := lane.next_stop()) is not None]:
            for lane in lanes:
                lane.advance(min(stops), on_progress)
            if speed is not None:
                time.sleep(max(0.0, start + min(stops) / speed - time.monotonic()))
            for lane in lanes:
                lane.world.notify_observers()


class _Lane:
    """One world's part of a run."""

    def __init__(
        self, world: SteppedSimulation, seconds: float, every: int | None, *, is_realtime: bool
    ) -> None:
        self.world = world
        self._timestep = world.timestep
        if not self._timestep:
            world.step()  # raises: the world cannot be stepped
        self.total = validation.steps_in(seconds, self._timestep, "run: seconds")
        self._done = 0
        self._every = every
        self._is_realtime = is_realtime

    def next_stop(self) -> float | None:
        """Returns the time of the next required tick, s since the start; None at the end."""
        if self._done == self.total:
            return None
        steps = min(self.total - self._done, self.world.steps_to_tick(self._done, self._every))
        if self._is_realtime and self._every:
            steps = min(steps, self._every - self._done % self._every)
        return (self._done + steps) * self._timestep

    def advance(self, stop: float, on_progress: ProgressCallback | None) -> None:
        """Steps up to a stop, not beyond it, and takes a tick if there was a step."""
        goal = min(self.total, math.floor(stop / self._timestep + _ROUNDING))
        if goal > self._done:
            on_steps = None if on_progress is None else lambda n: on_progress(n * self._timestep)
            self.world.advance(goal - self._done, on_steps)
            self._done = goal


def _speed(realtime: Any) -> float | None:
    """Returns the speed relative to real time; None for as fast as possible."""
    if isinstance(realtime, bool | np.bool_):
        return 1.0 if realtime else None
    return validation.positive_number(realtime, "run: realtime", "speed; True, or a number above 0")


@contextmanager
def _progress_bar(
    seconds: float, lanes: int, progress: bool | str
) -> Iterator[ProgressCallback | None]:
    """Shows a bar on standard error; yields the function that advances it, None without a bar."""
    if not validation.is_boolean(progress) and progress != "always":
        raise ArgumentError(f"run: progress: {short_repr(progress)} is not True, False or 'always'")
    if not progress:
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True, force_terminal=True if progress == "always" else None)
    if not console.is_terminal:
        yield None
        return
    simulated = TextColumn("{task.completed:.1f} of {task.total:g} s simulated")
    with Progress(BarColumn(), simulated, TimeRemainingColumn(), console=console) as bar:
        task = bar.add_task("", total=seconds)
        yield lambda seconds_run: bar.advance(task, seconds_run / lanes)
