"""Steps a simulation and takes its ticks: `SteppedSimulation`."""

from __future__ import annotations

import threading
import time
import weakref
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import suppress
from itertools import count
from typing import Never, Protocol, Self

from ssduck import validation
from ssduck.errors import (
    ArgumentError,
    NumberError,
    ProgramWarning,
    SelectScriptError,
    SimulatorError,
    StateError,
    warn,
)
from ssduck.formatting import short_repr
from ssduck.schema import MARGINS, MASSES, MOMENTS
from ssduck.simulators.clock import Clock
from ssduck.simulators.environments import EnvironmentSimulator
from ssduck.simulators.interface import Simulator
from ssduck.simulators.partial import StaticSimulator
from ssduck.world import ctrl_c
from ssduck.world.drawn_bodies import DrawnBodies
from ssduck.world.entity_registry import EntityRegistry
from ssduck.world.observers import Observable
from ssduck.world.snapshot import Snapshot
from ssduck.world.stale_tick import StaleTickCheck

_serials = count()
# The time that a step yields to a thread that waits for the lock, s.
_YIELD_SECONDS = 1e-4
# The number of steps between two progress reports.
_STEPS_PER_REPORT = 24
# What to write for the arguments that other simulators' functions have for the time.
_TIME_STEP = "the time step is the simulator's own, .timestep; "
_OF_TICK = {
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


class TickSink(Protocol):
    """A recorder of the ticks of a world."""

    @property
    def tables(self) -> Collection[str]:
        """The tables that each tick must include."""

    def record(self, snapshot: Snapshot) -> None:
        """Records a tick if it is due, at once or later; the caller holds the lock of the world."""

    def check_masses(self, snapshot: Snapshot) -> None:
        """Compares masses that were read anew with the recorded ones."""


class Pin:
    """Keeps a world at its tick, with tables included, in a context; see `pin`."""

    __slots__ = ("_is_read", "_tables", "_world")

    def __init__(self, world: SteppedSimulation, tables: Collection[str], *, is_read: bool) -> None:
        self._world, self._tables, self._is_read = world, tables, is_read

    def __enter__(self) -> None:
        self._world.pin(self._tables, is_read=self._is_read)

    def __exit__(self, *_: object) -> None:
        self._world.unpin()


class SteppedSimulation(Observable):
    """A simulator with its last tick.

    Attributes:
        name: the name of the world.
        lock: guards the simulator and the tick.
        serial: the number of the object in order of creation; several are locked in this order.
        snapshot: the last tick.
    """

    def _init_ticking(self, name: str) -> None:
        self.name = name
        self.lock = threading.RLock()
        self._init_observers()
        self.serial = next(_serials)
        self._had_moments = self._has_told_of_moments = False
        self._queries = 0
        self._waiting = 0
        self._recorders: list[weakref.ref[TickSink]] = []
        self._stale_tick_check = StaleTickCheck()
        # The time of the first tick, and that of the first recorded one.
        self._start: float | None = None
        # The episode of the simulator at the last tick, and whether observers are to learn of it.
        self._episode: int | None = None
        self._may_restart = self._is_restarted = False
        self._first_recorded: float | None = None

    def _set_state(self, simulator: Simulator, snapshot: Snapshot) -> None:
        """Sets the simulator and its last tick."""
        self.snapshot = snapshot
        self._simulator = simulator
        self._registry = EntityRegistry(snapshot.load_order)
        if not isinstance(simulator, StaticSimulator):
            snapshot.drawn = DrawnBodies(simulator, self._registry)
        # What the states of environments lack is told of where it is read.
        snapshot.warns_of_unknown &= not isinstance(simulator, EnvironmentSimulator)

    @property
    def tick_number(self) -> int:
        """The number of the last tick."""
        return self.snapshot.number

    @property
    def present(self) -> Self:
        """The world itself, as the world of its last tick."""
        return self

    @property
    def is_restored(self) -> bool:
        """Whether the last tick is in memory: a record is opened without it."""
        return True

    @property
    def time(self) -> float:
        """The simulated time of the last tick, s."""
        return self.snapshot.time

    @property
    def timestep(self) -> float:
        """The simulated time of the next step, s; 0 for a what-if world, which has no steps."""
        with self.lock:
            return self._simulator.timestep

    # -- a tick ---------------------------------------------------------------------------

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
        validation.no_others(others, "tick", ("steps", "time"), _OF_TICK)
        with self.lock:
            self._check_not_pinned()
            number = self.snapshot.number
            is_told_time = self._simulator.is_external and not self._simulator.keeps_time
            if is_told_time:
                before = self._simulator.clock
                self._simulator.set_clock(self._clock_of_tick(steps, time))
            elif steps is not None or time is not None:
                reason = (
                    f"the simulator of {self.name!r} keeps the time itself"
                    if self._simulator.keeps_time
                    else f"{self.name!r} is none: only step and run take its time"
                )
                raise ArgumentError(
                    f"tick: steps and time are for an attached world without a time, and {reason}"
                )
            try:
                self._take_first_or_next()
            except BaseException:
                if is_told_time and self.snapshot.number == number:
                    self._simulator.set_clock(before)
                raise
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
        with self.lock:
            self._check_not_pinned()
            if not self._simulator.is_external:
                raise ArgumentError(
                    f"begin_episode: {self.name!r} is not attached: load the scene again"
                )
            self._simulator.begin_episode()
            self._take_first_or_next()
        self.notify_observers()
        return self

    def _clock_of_tick(self, steps: int | None, time: float | None) -> Clock:
        """Returns the clock of an attached world at the next tick."""
        clock, timestep = self._simulator.clock, self._simulator.timestep
        if steps is not None and time is not None:
            raise ArgumentError("tick: steps and time exclude each other")
        if time is None:
            count = (
                1 if steps is None else validation.step_count(steps, "tick: steps", "tick(time=…)")
            )
            return clock.after(count, timestep)
        seconds = validation.finite_number(time, "tick: time", "seconds")
        if seconds < clock.time - self.slack:
            raise NumberError(
                f"tick: time: {seconds:g} s is before the last tick, {clock.time:g} s; time does "
                "not go back: after a reset, call begin_episode()"
            )
        if timestep and seconds + timestep == seconds:
            raise NumberError(
                f"tick: time: {seconds:g} s is so large that adding a step does not change it"
            )
        # Within rounding it is the time of the last tick.
        return clock if abs(seconds - clock.time) <= self.slack else clock.at(seconds, timestep)

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
            self.advance(steps)
            self.notify_observers()
            done += steps
            if done >= count:
                return self

    def steps_to_tick(self, done: int, every: int | None) -> float:
        """Returns the number of steps to the next tick of a run; inf if it needs none.

        Args:
            done: the number of steps since the start of the run.
            every: the number of steps between ticks that are recorded or observed; None for no
                ticks but requested ones.
        """
        steps = self.steps_to_due()
        return min(steps, every - done % every) if every and self.is_watched else steps

    @property
    def is_watched(self) -> bool:
        """Whether a recorder or an observer gets the next tick."""
        return self.is_observed or any(ref() is not None for ref in self._recorders)

    def advance(self, count: int, on_progress: Callable[[int], object] | None = None) -> None:
        """Runs steps and takes a tick without notifying observers: a part of `step`.

        Args:
            count: the number of steps.
            on_progress: called at intervals with the number of steps since the last call; the
                world is locked meanwhile.
        """
        if self._waiting:
            time.sleep(_YIELD_SECONDS)  # locks are not fair: this thread might always win
        with self.lock:
            self._check_not_pinned()
            try:
                for steps in _portions(count, count if on_progress is None else _STEPS_PER_REPORT):
                    self._simulator.step(steps)
                    if on_progress is not None:
                        on_progress(steps)
                self._check_not_pinned()
                self._take_first_or_next()
            except SelectScriptError:
                raise
            except BaseException:  # of a signal, whatever its handler raises
                if self.snapshot.time != self._simulator.time:
                    self._take_tick()  # the tables must match the simulator
                raise

    def _take_tick(self) -> None:
        self._check_not_pinned()
        self._take()

    def _take_first_or_next(self) -> None:
        """Takes a tick, which may begin a new episode; the caller notifies observers of it."""
        self._may_restart = True
        try:
            self._take()
        finally:
            self._may_restart = False

    def _take(self) -> None:
        with ctrl_c.deferred():
            self._registry.update(self._simulator)
            self._check_episode()
            self.snapshot.take(self._simulator, self._registry.entities)
            self._stale_tick_check.note_tick()
            if self._start is None:
                self._start = self.snapshot.time
            self._record_tick()

    def _check_episode(self) -> None:
        """Ends the present episode if the simulation was reset since the last tick."""
        episode = self._simulator.episode
        if episode == self._episode:
            return
        if self._episode is not None:
            if not self._may_restart:
                raise StateError(
                    f"{self.name}: the simulation was reset since the last tick: call tick() "
                    "first, which begins a new episode"
                )
            self._recorders.clear()  # the ticks of a record are of one episode
            self.snapshot.restart()
            self._registry.removed.clear()
            self._start = self._first_recorded = None
            self._is_restarted = True
        self._episode = episode

    def notify_observers(self) -> None:
        """Notifies the observers of the last tick; the caller must not hold a lock."""
        if self._is_restarted:
            self._is_restarted = False
            self.notify_restart()
        super().notify_observers()

    def _record_tick(self) -> None:
        """Passes the tick to the recorders."""
        failure: BaseException | None = None
        self._note_moments()
        for reference in self._recorders:
            recorder = reference()
            if recorder is not None:
                try:
                    recorder.record(self.snapshot)
                except BaseException as error:  # noqa: BLE001  # a signal may raise any
                    failure = failure or error  # the other recorders still get the tick
        if failure is not None:
            raise failure

    def _note_moments(self) -> None:
        """Notes whether recorded contacts have moments besides those of their forces."""
        if not self._had_moments and "contacts" in self.snapshot.recorded:
            self._had_moments = self.snapshot.contact_points.has_moments

    # -- tables and queries -----------------------------------------------------------------

    def request_tables(self, tables: Iterable[str]) -> None:
        """Ensures that the current tick includes tables; see `_take_requested`."""
        with self.lock:
            if self.snapshot.request_tables(tables):
                self._take_requested()
            if MASSES in tables:
                self._read_masses()
            if MARGINS in tables and not self.is_final:
                self.snapshot.read_margins(self._simulator)
            if MOMENTS in tables:
                self._warn_of_moments()

    def _warn_of_moments(self) -> None:
        """Warns, once, if contacts of this tick or a recorded one have moments besides forces'."""
        if self._has_told_of_moments:
            return
        if self._had_moments or self.snapshot.contact_points.has_moments:
            self._has_told_of_moments = True
            warn(
                f"{self.name!r}: torque lacks the moments of torsional and rolling friction, which "
                "contacts of condim 4 and 6 have; mj_contactForce tells them"
            )

    def _read_masses(self) -> None:
        """Reads the masses at this tick, and passes them to the recorders."""
        if self.is_final or not self.snapshot.read_masses(self._simulator):
            return
        for reference in self._recorders:
            recorder = reference()
            if recorder is not None:
                recorder.check_masses(self.snapshot)

    def _take_requested(self) -> None:
        """Reads requested tables into this tick, or takes another if the simulator has moved on.

        A tick that is there is recorded, and counted by sums over the past: it must not be there
        twice.
        """
        if self._simulator.is_external:
            self._check_not_pinned()
        # During a query nothing moves in a world that only ssduck steps.
        if not self._read_again():
            self._take()

    def _read_again(self) -> bool:
        """Reads the tick again with requested tables if the simulator is still in its state."""
        if self.is_final or not self.is_restored:
            return False
        with ctrl_c.deferred():
            self._registry.update(self._simulator)
            self._check_episode()
            entities = self._registry.entities
            is_same = self.snapshot.is_still_of(self._simulator, entities)
            if is_same:
                self.snapshot.take(self._simulator, entities, is_again=True)
            return is_same

    def pinned(self, tables: Collection[str] = (), *, is_read: bool = True) -> Pin:
        """Keeps the world at its tick, with tables included, while a query runs.

        Args:
            tables: the tables to include.
            is_read: whether the query reads the world, which warns of a stale tick.
        """
        return Pin(self, tables, is_read=is_read)

    def pin(
        self, tables: Collection[str] = (), *, is_read: bool = True, is_settled: bool = True
    ) -> None:
        """Does what entering `pinned` does; `unpin` ends it.

        Args:
            tables: the tables to include.
            is_read: whether the query reads the world.
            is_settled: whether all columns are written: DuckDB reads them without asking.
        """
        self._waiting += 1
        try:
            self.lock.acquire()
        finally:
            self._waiting -= 1
        try:
            if is_read and not self._queries and self.is_restored:
                self._stale_tick_check.check(self.name, self._simulator, self.snapshot)
            if tables:
                self.request_tables(tables)
            if is_settled and self.is_restored:
                self.snapshot.settle()
            self._queries += 1
        except BaseException:
            self.lock.release()
            raise

    def unpin(self) -> None:
        """Ends what `pin` began."""
        self._queries -= 1
        self.lock.release()

    def _check_not_pinned(self) -> None:
        if self._queries:
            raise SelectScriptError(
                f"a query on {self.name!r} is running: its tick cannot be replaced before it ends"
            )

    # -- recorders --------------------------------------------------------------------------

    def add_recorder(self, recorder: TickSink) -> None:
        """Records this tick and the following ones; the world has a weak reference only."""
        with self.lock:
            self._check_not_pinned()
            with suppress(SimulatorError):  # of a closed simulator, the last tick is recorded
                self._read_masses()
            self._recorders.append(weakref.ref(recorder))
            if self._first_recorded is None:
                self._first_recorded = self.snapshot.time
            self._read_recorded()
            if self.snapshot.request_tables(()) and not self._read_again():
                self._take()
            else:
                self._note_moments()
                recorder.record(self.snapshot)

    def remove_recorder(self, recorder: TickSink) -> None:
        """Removes a recorder, which gets no more ticks."""
        with self.lock:
            self._recorders = [r for r in self._recorders if r() not in (None, recorder)]
            self._read_recorded()

    @property
    def episode_start(self) -> float | None:
        """The simulated time of the first tick of the present episode, s; None before that."""
        return self._start

    def warn_of_unrecorded_start(self) -> None:
        """Warns, once, if the world had ticks of earlier times before it was recorded at all."""
        start, first = self._start, self._first_recorded
        if start is not None and first is not None and first > start:
            self._first_recorded = start
            warn(
                f"{self.name}: its ticks before {first:g} s were not recorded, since an "
                "interpreter records a world from the moment it is bound to a variable; the past "
                "begins there",
                ProgramWarning,
            )

    def _read_recorded(self) -> None:
        """Makes each tick include the tables of the recorders."""
        recorders = [recorder for reference in self._recorders if (recorder := reference())]
        tables = frozenset(table for r in recorders for table in r.tables)
        self.snapshot.recorded = tables - {"entities"}

    @property
    def is_attached(self) -> bool:
        """Whether the simulation is a client of the user's."""
        return self._simulator.is_external

    @property
    def is_final(self) -> bool:
        """Whether no further tick can be taken: it is a what-if world or a past one."""
        return isinstance(self._simulator, StaticSimulator)


def _portions(count: int, maximum: int) -> Iterator[int]:
    """Yields positive numbers of at most `maximum` whose sum is `count`; 0 for 0."""
    yield min(count, maximum)
    for done in range(maximum, count, maximum or 1):
        yield min(maximum, count - done)
