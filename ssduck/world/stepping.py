"""Steps worlds and runs them for a simulated time: in lockstep, in real time, with a progress bar.

A *stop* is a simulated time since the start of the run, in seconds, at which ticks are taken:
whenever an observer of some world requests one, after every given number of steps where a recorder
or an observer gets the tick, and at the end. In real time, other threads get all ticks.
All worlds reach a stop before any observer is notified of it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from itertools import count
from typing import Any, Literal, Never, Self, TypeAlias

import numpy as np

from ssduck import validation
from ssduck.errors import ArgumentError
from ssduck.formatting import short_repr
from ssduck.simulators.interface import Simulator
from ssduck.world.observers import ROUNDING, Observers, TickObserver
from ssduck.world.snapshot import Snapshot
from ssduck.world.ticking import Ticker

_serials = count()
# A function that is called with the simulated seconds that were run since the last call.
ProgressCallback: TypeAlias = Callable[[float], object]
# What to write for the arguments that other simulators' functions have for the time.
_TIME_STEP = "the time step is the simulator's own, .timestep; "
OF_TICK = {
    **dict.fromkeys(
        ("dt", "timestep", "time_step", "seconds", "duration", "n", "count"),
        f"{_TIME_STEP}after n of your steps write tick(steps=n), or tick(time=…) with the "
        "simulated time now, s",
    ),
    "t": "the simulated time now is time=",
}
OF_STEPS = {
    **dict.fromkeys(
        ("dt", "timestep", "time_step"),
        f"{_TIME_STEP}step(n) runs n of them, and run(seconds) as many as that takes",
    ),
    **dict.fromkeys(("n", "steps", "num_steps", "n_steps"), "step(n) runs n steps"),
    **dict.fromkeys(("seconds", "duration", "time", "t"), "run(seconds) runs for a time"),
}


class SteppedWorld:
    """A world as time passes in it: it takes ticks, and notifies observers of them.

    Attributes:
        ticker: takes the ticks.
        observers: are notified of the ticks.
        lock: guards the simulator and the tick.
        serial: the number of the object in order of creation; several are locked in this order.
    """

    def __init__(self, ticker: Ticker) -> None:
        self.ticker = ticker
        self.lock = ticker.lock
        self.observers = Observers(self.lock)
        self.serial = next(_serials)

    @property
    def name(self) -> str:
        """The name: that of the variable that the world is bound to."""
        return self.ticker.name

    @name.setter
    def name(self, name: str) -> None:
        self.ticker.name = name

    @property
    def simulator(self) -> Simulator:
        """The simulator of the world."""
        return self.ticker.simulator

    @property
    def snapshot(self) -> Snapshot:
        """The last tick."""
        return self.ticker.snapshot

    @property
    def present(self) -> Self:
        """The world itself, as the world of its last tick."""
        return self

    @property
    def is_final(self) -> bool:
        """Whether its ticks need not be recorded: of a what-if world, say, or recorded already."""
        return self.ticker.is_final

    # -- time -----------------------------------------------------------------------------

    @property
    def tick_number(self) -> int:
        """The number of the last tick."""
        return self.ticker.number

    @property
    def time(self) -> float:
        """The simulated time of the last tick, s."""
        return self.ticker.time

    @property
    def timestep(self) -> float:
        """The simulated time of the next step, s; 0 for a what-if world, which has no steps."""
        return self.ticker.timestep

    def tick(
        self,
        *unnamed: Never,
        steps: int | None = None,
        time: float | None = None,
        **others: Never,
    ) -> Self:
        """Takes a tick: replaces the tables by the current state of the simulator.

        In an attached PyBullet world, whose client you step, each such tick advances simulated
        time: by the client's current time step, unless an argument sets it. MuJoCo keeps the time
        itself. In all other worlds only steps advance time. There neither argument is accepted.

        If MuJoCo's time has fallen since the last tick, or the model is another one, you have reset
        the simulation: a new episode begins with this tick, in records, too. An unstable state that
        MuJoCo itself resets begins none, and neither does any fall of the time once you have called
        `begin_episode`: the time goes on, and a warning says so.

        Args:
            *unnamed: none; the two arguments need their names.
            steps: the number of steps that you have run since the last tick, 0 or more. 0 takes
                another tick at the same time, for example after bodies were moved.
            time: the current simulated time, s, instead of a number of steps; not before that
                of the last tick.
            **others: none; an error says what to write for other names.

        Returns:
            The world itself.

        Raises:
            SimulatorError: the simulator does not answer; the last tick and its time remain.
            NumberError: an argument is no such number, or the time is before the last tick's.
            ArgumentError: both arguments are given, or one without its name, or the world is not
                attached, or its simulator keeps the time.
        """
        if unnamed:
            value = short_repr(unnamed[0])
            raise ArgumentError(
                f"tick: {value} has no name: write tick(steps={value}) for a number of steps, "
                f"tick(time={value}) for the simulated time in seconds"
            )
        validation.no_others(others, "tick", ("steps", "time"), OF_TICK)
        self.ticker.tick(steps, time)
        self.notify_observers()
        return self

    def begin_episode(self) -> Self:
        """Takes a tick that begins a new episode: you have reset the simulation.

        `tick` sees a reset by itself where the time of MuJoCo has fallen, or its model is another
        one. If you call this at one reset, call it at each: from then on, only this and another
        model begin an episode. PyBullet has no time; it is 0 again at this tick. Its bodies that
        were built again, with the same shapes and numbers, keep the names and kinds that they were
        attached with; a warning says which do not.

        Returns:
            The world itself.

        Raises:
            ArgumentError: the world is not attached: ssduck itself runs its simulation.
            SimulatorError: the simulator does not answer.
        """
        self.ticker.begin_episode()
        self.notify_observers()
        return self

    def step(self, count: int = 1, *, every: int | None = 1, **others: Never) -> Self:
        """Runs steps of the simulator, and takes a tick after each of them.

        With `every`, there are fewer ticks: after so many steps each, at the end, and when
        observers request them, for example triggers that are due. A world that is neither recorded
        nor observed takes the last tick only. Ctrl-C ends the run at a tick.

        Args:
            count: the number of steps, 0 or more; for a number of seconds, see `run`.
            every: the number of steps between ticks; None for requested ticks and the last.
            **others: none; an error says what to write for other names.

        Returns:
            The world itself.

        Raises:
            NumberError: the count is no such number.
            ArgumentError: `every` is less than 1.
            SimulatorError: the simulator does not answer; the last tick remains.
            UnsupportedError: it is a what-if world.
        """
        validation.no_others(others, "step", ("count", "every"), OF_STEPS)
        count = validation.step_count(count, "step", "run({})")
        every = validation.tick_interval(every, "step: every")
        done = 0
        while True:
            steps = int(min(count - done, self.steps_to_tick(done, every)))
            self.ticker.advance(steps)
            self.notify_observers()
            done += steps
            if done >= count:
                return self

    def run(
        self,
        seconds: float,
        *,
        realtime: bool | float = False,
        progress: bool | Literal["always"] = False,
        every: int | None = 1,
        **others: Never,
    ) -> Self:
        """Runs for a simulated time, and takes a tick after each step.

        With `every`, there are fewer ticks: after so many steps each, at the end, and when
        observers request them. A world that is neither recorded nor observed takes the last tick
        only, except in real time.

        Args:
            seconds: the simulated time, s, rounded to the nearest number of steps.
            realtime: whether to run in real time; or the speed relative to it: 2.0 takes half as
                long if the simulator is fast enough. A late run catches up. Such a run waits at
                ticks only.
            progress: whether to show a progress bar on standard error if that is a terminal;
                `"always"`: in any case.
            every: the number of steps between ticks; None for requested ticks and the last.
            **others: none; an error says what to write for other names.

        Returns:
            The world itself.

        Raises:
            ArgumentError: the time is negative or not finite, the speed is not above 0, or
                `every` is less than 1.
            SimulatorError: the simulator does not answer; the last tick remains.
            UnsupportedError: it is a what-if world.
            KeyboardInterrupt: Ctrl-C stopped the run, at a tick.
        """
        run([self], seconds, realtime=realtime, progress=progress, every=every, **others)
        return self

    def steps_to_tick(self, done: int, every: int | None) -> float:
        """Returns the number of steps to the next tick of a run; inf if it needs none.

        Args:
            done: the number of steps since the start of the run.
            every: the number of steps between ticks that are recorded or observed; None for no
                ticks but requested ones.
        """
        steps = self.observers.steps_to_due(self)
        is_watched = every and (self.observers.are_there or self.ticker.is_recorded)
        return min(steps, every - done % every) if every and is_watched else steps

    def notify_observers(self) -> None:
        """Notifies the observers of the last tick; the caller must not hold a lock."""
        if self.ticker.is_restarted:
            self.ticker.is_restarted = False
            self.observers.notify_restart(self)
        self.observers.notify(self)

    def follow(self, follower: TickObserver) -> None:
        """Adds an observer, which may request ticks and is notified of all ticks.

        The observer is notified of the ticks of `step`, `run` and `tick`, in the thread that
        takes them. That thread then holds no lock of ssduck, so the observer may query any world.
        (An interpreter's lock is acquired before those of worlds; a thread that holds a world's
        `lock` must not step it.)

        If an observer or another thread steps the world during notification, these steps notify
        no one; the next tick notifies observers that became due meanwhile. So notifications do
        not recurse.

        The world has only a weak reference to the observer.

        Args:
            follower: the observer.
        """
        self.observers.follow(follower)

    def unfollow(self, follower: TickObserver) -> None:
        """Removes an observer."""
        self.observers.unfollow(follower)

    def reached(self, due: float) -> bool:
        """Checks whether the last tick is at a simulated time or later, up to rounding."""
        return self.time >= due - self.ticker.slack

    def request_tables(self, tables: Iterable[str]) -> None:
        """Ensures that the last tick includes tables."""
        self.ticker.request_tables(frozenset(tables))

    def pinned(self, tables: Collection[str] = ()) -> AbstractContextManager[None]:
        """Keeps the world at its tick, with tables included, while a query runs."""
        return self.ticker.pinned(tables)


def run(
    worlds: Sequence[SteppedWorld],
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
        self, world: SteppedWorld, seconds: float, every: int | None, *, is_realtime: bool
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
        goal = min(self.total, math.floor(stop / self._timestep + ROUNDING))
        if goal > self._done:
            on_steps = None if on_progress is None else lambda n: on_progress(n * self._timestep)
            self.world.ticker.advance(goal - self._done, on_steps)
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
