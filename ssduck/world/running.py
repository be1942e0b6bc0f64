"""Worlds run in simulated time: several in lockstep, at the pace of a clock, with a bar.

A *stop* is a moment of a run, in simulated seconds since its start, at which ticks are taken:
where a follower of some world wants one, each so many steps, and at the end. All worlds run up
to a stop before anybody is told of it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Literal, TypeAlias

import numpy as np

from ssduck import validation
from ssduck.errors import ArgumentError
from ssduck.formatting import short_repr
from ssduck.world.ticking import SteppedSimulation

# Is told how many simulated seconds were run.
Watch: TypeAlias = Callable[[float], object]
# Ticks a second by the clock on the wall, of a run at its pace.
PICTURES = 30
# The part of a step by which sums of steps may be off.
_ROUNDING = 1e-6


def run(
    worlds: Sequence[SteppedSimulation],
    seconds: float,
    *,
    realtime: bool | float = False,
    progress: bool | Literal["always"] = False,
    every: int | None = None,
) -> None:
    """Run worlds for so much simulated time; the arguments are those of `World.run`."""
    seconds = validation.duration(seconds, "run: seconds")
    speed = _speed(realtime)
    if every is not None:
        every = validation.integer(
            every, "run: every", minimum=1, expected="number of steps; 1 or more"
        )
    period = every if speed is None or every is not None else speed / PICTURES
    lanes = [_Lane(world, seconds, period) for world in worlds]
    began = time.monotonic()
    with _bar(seconds, len(lanes), progress) as watch:
        for lane in lanes:
            if not lane.total:
                lane.world.step(0)
        while stops := [stop for lane in lanes if (stop := lane.next_stop()) is not None]:
            for lane in lanes:
                lane.advance(min(stops), watch)
            if speed is not None:
                time.sleep(max(0.0, began + min(stops) / speed - time.monotonic()))
            for lane in lanes:
                lane.world.notify_observers()


class _Lane:
    """One world's part of a run.

    Args:
        world: the world.
        seconds: for how long it runs.
        period: ticks are taken each so many steps, if it is an integer, or seconds.
    """

    def __init__(self, world: SteppedSimulation, seconds: float, period: float | None) -> None:
        self.world = world
        self._timestep = world.timestep
        if not self._timestep:
            world.step()  # refuses
        self.total = validation.steps_in(seconds, self._timestep, "run: seconds")
        self._done = 0
        self._period = period
        if isinstance(period, float):
            self._period = max(1, math.floor(period / self._timestep + 0.5))

    def next_stop(self) -> float | None:
        """The next moment at which it wants a tick; None at the end."""
        if self._done == self.total:
            return None
        steps = min(self.total - self._done, self.world.steps_to_due())
        if self._period is not None:
            steps = min(steps, self._period - self._done % self._period)
        return (self._done + steps) * self._timestep

    def advance(self, stop: float, watch: Watch | None) -> None:
        """Run up to a stop, not beyond it, and take a tick there if it is one of its steps."""
        goal = min(self.total, math.floor(stop / self._timestep + _ROUNDING))
        if goal > self._done:
            told = None if watch is None else lambda steps: watch(steps * self._timestep)
            self.world.advance(goal - self._done, told)
            self._done = goal


def _speed(realtime: Any) -> float | None:
    """How many times as fast as the clock; None for as fast as can be."""
    if isinstance(realtime, bool | np.bool_):
        return 1.0 if realtime else None
    return validation.positive_number(realtime, "run: realtime", "speed; True, or a number above 0")


@contextmanager
def _bar(seconds: float, lanes: int, progress: bool | str) -> Iterator[Watch | None]:
    """A bar on standard error, and who is to be told of seconds that were run; or nobody."""
    if not validation.is_boolean(progress) and progress != "always":
        raise ArgumentError(
            f"run: progress: {short_repr(progress)} is none of True, False, 'always'"
        )
    if not progress:
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True, force_terminal=True if progress == "always" else None)
    if not console.is_terminal:
        yield None
        return
    told = TextColumn("{task.completed:.1f} of {task.total:g} s simulated")
    with Progress(BarColumn(), told, TimeRemainingColumn(), console=console) as bar:
        task = bar.add_task("", total=seconds)
        yield lambda run: bar.advance(task, run / lanes)
