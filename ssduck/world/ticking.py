"""Takes the ticks of a world: `Ticker`, and `LiveTicker` for those of a simulation."""

from __future__ import annotations

import threading
import time
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Protocol, Self

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
from ssduck.formatting import past_path, past_query
from ssduck.schema import MARGINS, MASSES, MOMENTS, ON_DEMAND, RECORDED_BY_DEFAULT
from ssduck.simulators.clock import Clock
from ssduck.simulators.environments import EnvironmentSimulator
from ssduck.simulators.interface import Simulator
from ssduck.simulators.partial import StaticSimulator
from ssduck.simulators.scenes import SensorSpec
from ssduck.world import ctrl_c
from ssduck.world.entity_registry import EntityRegistry
from ssduck.world.observers import ROUNDING
from ssduck.world.pictures import DrawnBodies
from ssduck.world.snapshot import Snapshot
from ssduck.world.stale_tick import StaleTickCheck

# The name of a world that is not bound to a variable yet.
UNNAMED = "world"
# The time that a step yields to a thread that waits for the lock, s.
_YIELD_SECONDS = 1e-4
# The number of steps between two progress reports.
_STEPS_PER_REPORT = 24


class TickSink(Protocol):
    """A recorder of the ticks of a world."""

    @property
    def tables(self) -> Collection[str]:
        """The tables that each tick must include."""

    def record(self, snapshot: Snapshot) -> None:
        """Records a tick if it is due, at once or later; the caller holds the lock of the world."""

    def check_masses(self, snapshot: Snapshot) -> None:
        """Compares masses that were read anew with the recorded ones."""


class Ticker(ABC):
    """Takes the ticks of a world, and keeps it at its last tick while a query runs.

    Args:
        name: the name of the world.

    Attributes:
        name: the name of the world, which may be set.
        lock: guards the simulator and the tick.
        simulator: the simulator of the last tick.
        snapshot: the last tick, always the same object.
        registry: the entities of the simulator.
        is_restarted: whether a new episode began of which observers are to learn.
    """

    simulator: Simulator
    snapshot: Snapshot
    registry: EntityRegistry

    def __init__(self, name: str) -> None:
        self.name = name
        self.lock = threading.RLock()
        self.is_restarted = False
        self._queries = 0
        self._waiting = 0

    # -- what the ticks are taken from ------------------------------------------------------

    @property
    @abstractmethod
    def is_final(self) -> bool:
        """Whether its ticks need not be recorded: of a what-if world, say, or recorded already."""

    @property
    def is_attached(self) -> bool:
        """Whether the simulation is a client of the user's."""
        return self.simulator.is_external

    @property
    def is_restored(self) -> bool:
        """Whether the last tick is in memory: a record is opened without it."""
        return True

    @property
    def is_recorded(self) -> bool:
        """Whether a recorder gets the next tick."""
        return False

    @property
    def episode_start(self) -> float | None:
        """The simulated time of the first tick of the present episode, s; None if unknown."""
        return None

    @property
    def number(self) -> int:
        """The number of the last tick."""
        return self.snapshot.number

    @property
    def time(self) -> float:
        """The simulated time of the last tick, s."""
        return self.snapshot.time

    @property
    def timestep(self) -> float:
        """The simulated time of the next step, s; 0 for a world that cannot be stepped."""
        with self.lock:
            return self.simulator.timestep

    @property
    def slack(self) -> float:
        """The rounding error allowed in a sum of steps, s: a millionth of a step."""
        return ROUNDING * self.timestep

    @abstractmethod
    def removal_of(self, name: str) -> str:
        """Returns when an entity of a name was there, for an error; "" if none ever was."""

    @abstractmethod
    def take(self, *, may_restart: bool = False) -> None:
        """Takes the present state as the last tick; the caller has the lock.

        Args:
            may_restart: whether a new episode may begin, as the caller notifies observers of it.
        """

    @abstractmethod
    def run(self, count: int, on_progress: Callable[[int], object] | None) -> None:
        """Runs steps without taking a tick; see `advance`."""

    def take_requested(self) -> None:
        """Takes the tick with the requested tables that it lacks."""
        self.take()

    def request_tables(self, tables: Collection[str]) -> None:
        """Ensures that the last tick includes tables."""
        with self.lock:
            if self.snapshot.request_tables(tables):
                self.take_requested()

    def warn_of_stale_tick(self) -> None:  # noqa: B027  # nothing may be simulated
        """Warns if a query is to read a tick that the user's simulation has left behind."""

    def warn_of_unrecorded_start(self) -> None:  # noqa: B027  # a record begins with its first tick
        """Warns, once, if the world had ticks of earlier times before it was recorded at all."""

    @abstractmethod
    def add_recorder(self, recorder: TickSink) -> None:
        """Records this tick and the following ones; there is a weak reference only."""

    def remove_recorder(self, recorder: TickSink) -> None:  # noqa: B027  # there may be none
        """Removes a recorder, which gets no more ticks."""

    # -- ticks ------------------------------------------------------------------------------

    def tick(self, steps: int | None, time: float | None) -> None:
        """Takes a tick; see `World.tick`."""
        with self.lock:
            self.check_not_pinned()
            number, simulator = self.snapshot.number, self.simulator
            is_told_time = simulator.is_external and not simulator.keeps_time
            if is_told_time:
                before = simulator.clock
                simulator.set_clock(self._clock_of_tick(steps, time))
            elif steps is not None or time is not None:
                reason = (
                    f"the simulator of {self.name!r} keeps the time itself"
                    if simulator.keeps_time
                    else f"{self.name!r} is none: only step and run take its time"
                )
                raise ArgumentError(
                    f"tick: steps and time are for an attached world without a time, and {reason}"
                )
            try:
                self.take(may_restart=True)
            except BaseException:
                if is_told_time and self.snapshot.number == number:
                    simulator.set_clock(before)
                raise

    def _clock_of_tick(self, steps: int | None, time: float | None) -> Clock:
        """Returns the clock of an attached world at the next tick."""
        clock, timestep = self.simulator.clock, self.simulator.timestep
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
        return clock if abs(seconds - clock.time) <= self.slack else Clock(timestep, seconds)

    def begin_episode(self) -> None:
        """Takes a tick that begins a new episode; see `World.begin_episode`."""
        with self.lock:
            self.check_not_pinned()
            if not self.simulator.is_external:
                raise ArgumentError(
                    f"begin_episode: {self.name!r} is not attached: load the scene again"
                )
            self.simulator.begin_episode()
            self.take(may_restart=True)

    def advance(self, count: int, on_progress: Callable[[int], object] | None = None) -> None:
        """Runs steps and takes a tick without notifying observers: a part of `World.step`.

        Args:
            count: the number of steps.
            on_progress: called at intervals with the number of steps since the last call; the
                world is locked meanwhile.
        """
        if self._waiting:
            time.sleep(_YIELD_SECONDS)  # locks are not fair: this thread might always win
        with self.lock:
            self.check_not_pinned()
            try:
                self.run(count, on_progress)
                self.check_not_pinned()
                self.take(may_restart=True)
            except SelectScriptError:
                raise
            except BaseException:  # of a signal, whatever its handler raises
                if self.snapshot.time != self.simulator.time:
                    self.check_not_pinned()
                    self.take()  # the tables must match the simulator
                raise

    # -- queries ------------------------------------------------------------------------------

    def pin(
        self, tables: Collection[str] = (), *, is_read: bool = True, is_settled: bool = True
    ) -> None:
        """Keeps the world at its tick until `unpin`, with tables included.

        Args:
            tables: the tables to include.
            is_read: whether the query reads the world, which warns of a stale tick.
            is_settled: whether all columns are written: DuckDB reads them without asking.
        """
        self._waiting += 1
        try:
            self.lock.acquire()
        finally:
            self._waiting -= 1
        try:
            if is_read and not self._queries:
                self.warn_of_stale_tick()
            if tables:
                self.request_tables(tables)
            if is_settled and self.is_restored:
                self.snapshot.settle()
            self._queries += 1
        except BaseException:
            self.lock.release()
            raise

    @contextmanager
    def pinned(self, tables: Collection[str]) -> Iterator[None]:
        """Keeps the world at its tick in a context; see `pin`."""
        self.pin(tables)
        try:
            yield
        finally:
            self.unpin()

    def unpin(self) -> None:
        """Ends what `pin` began."""
        self._queries -= 1
        self.lock.release()

    def check_not_pinned(self) -> None:
        """Checks that no query is running, whose tick must stay."""
        if self._queries:
            raise SelectScriptError(
                f"a query on {self.name!r} is running: its tick cannot be replaced before it ends"
            )


class LiveTicker(Ticker):
    """Takes ticks from a simulator, and passes them to recorders.

    Args:
        name: the name of the world.
        simulator: the simulator; one that is static for a what-if world.
        snapshot: the tick to be taken from it.
    """

    def __init__(self, name: str, simulator: Simulator, snapshot: Snapshot) -> None:
        super().__init__(name)
        self.simulator, self.snapshot = simulator, snapshot
        self.registry = EntityRegistry(snapshot.load_order)
        if not isinstance(simulator, StaticSimulator):
            snapshot.drawn = DrawnBodies(simulator, self.registry.has_body)
        # What the states of environments lack is told of where it is read.
        snapshot.warns_of_unknown &= not isinstance(simulator, EnvironmentSimulator)
        self._recorders: list[weakref.ref[TickSink]] = []
        self._had_moments = self._has_told_of_moments = False
        self._stale_tick_check = StaleTickCheck()
        # The time of the first tick, and that of the first recorded one.
        self._start: float | None = None
        self._first_recorded: float | None = None
        self._episode: int | None = None  # that of the simulator at the last tick

    @classmethod
    def begun(cls, name: str, simulator: Simulator, sensors: Sequence[SensorSpec]) -> Self:
        """Returns the ticker of a new world, after its first tick."""
        ticker = cls(name, simulator, Snapshot())
        ticker.registry.add_all(simulator, sensors)
        for info in ticker.registry.entities:
            if info.sensor is not None and not info.sensor.powered:
                ticker.snapshot.switch(info.id, on=False)
        with ticker.lock:
            # So a recording with these tables begins without a second tick of the same time.
            ticker.snapshot.recorded = ON_DEMAND.intersection(RECORDED_BY_DEFAULT)
            ticker.take()
            ticker.snapshot.recorded = frozenset()
        return ticker

    @classmethod
    def of_tick(cls, simulator: StaticSimulator, snapshot: Snapshot) -> Self:
        """Returns the ticker of a world that never changes, after its only tick."""
        ticker = cls(UNNAMED, simulator, snapshot)
        ticker.take()
        return ticker

    @property
    def is_final(self) -> bool:
        """Whether no further tick can be taken: it is a what-if world or a past one."""
        return isinstance(self.simulator, StaticSimulator)

    def removal_of(self, name: str) -> str:
        """Returns when an entity of a name was removed, for an error; "" if none was."""
        time = self.registry.removed.get(name)
        if time is None:
            return ""
        return (
            f"it was removed at {time:g} s; where it is recorded, "
            f"{past_path(self.name, name)} is that of an earlier time, and functions of time take "
            f"it from a query, as {past_query(self.name, name, time - self.timestep / 2)}"
        )

    # -- a tick -------------------------------------------------------------------------------

    def run(self, count: int, on_progress: Callable[[int], object] | None) -> None:
        """Runs steps of the simulator."""
        for steps in _portions(count, count if on_progress is None else _STEPS_PER_REPORT):
            self.simulator.step(steps)
            if on_progress is not None:
                on_progress(steps)

    def take(self, *, may_restart: bool = False) -> None:
        """Takes the present state of the simulator as the last tick, and records it."""
        with ctrl_c.deferred():
            self.registry.update(self.simulator)
            self._check_episode(may_restart=may_restart)
            self.snapshot.take(self.simulator, self.registry.entities)
            self._stale_tick_check.note_tick()
            if self._start is None:
                self._start = self.snapshot.time
            self._record_tick()

    def _check_episode(self, *, may_restart: bool) -> None:
        """Ends the present episode if the simulation was reset since the last tick."""
        episode = self.simulator.episode
        if episode == self._episode:
            return
        if self._episode is not None:
            if not may_restart:
                raise StateError(
                    f"{self.name}: the simulation was reset since the last tick: call tick() "
                    "first, which begins a new episode"
                )
            self._recorders.clear()  # the ticks of a record are of one episode
            self.snapshot.restart()
            self.registry.removed.clear()
            self._start = self._first_recorded = None
            self.is_restarted = True
        self._episode = episode

    def request_tables(self, tables: Collection[str]) -> None:
        """Ensures that the last tick includes tables."""
        with self.lock:
            super().request_tables(tables)
            if MASSES in tables:
                self._read_masses()
            if MARGINS in tables and not self.is_final:
                self.snapshot.read_margins(self.simulator)
            if MOMENTS in tables:
                self._warn_of_moments()

    def take_requested(self) -> None:
        """Reads requested tables into this tick, or takes another if the simulator has moved on.

        A tick that is there is recorded, and counted by sums over the past: it must not be there
        twice.
        """
        if self.simulator.is_external:
            self.check_not_pinned()
        # During a query nothing moves in a world that only ssduck steps.
        if not self._read_again():
            self.take()

    def _read_again(self) -> bool:
        """Reads the tick again with requested tables if the simulator is still in its state."""
        if self.is_final:
            return False
        with ctrl_c.deferred():
            self.registry.update(self.simulator)
            self._check_episode(may_restart=False)
            entities = self.registry.entities
            is_same = self.snapshot.is_still_of(self.simulator, entities)
            if is_same:
                self.snapshot.take(self.simulator, entities, is_again=True)
            return is_same

    def warn_of_stale_tick(self) -> None:
        """Warns if the client has moved on since the last tick, once in each place."""
        self._stale_tick_check.check(self.name, self.simulator, self.snapshot)

    # -- recorders ----------------------------------------------------------------------------

    @property
    def is_recorded(self) -> bool:
        """Whether a recorder gets the next tick."""
        return any(ref() is not None for ref in self._recorders)

    def add_recorder(self, recorder: TickSink) -> None:
        """Records this tick and the following ones; there is a weak reference only."""
        with self.lock:
            self.check_not_pinned()
            with suppress(SimulatorError):  # of a closed simulator, the last tick is recorded
                self._read_masses()
            self._recorders.append(weakref.ref(recorder))
            if self._first_recorded is None:
                self._first_recorded = self.snapshot.time
            self._read_recorded()
            if self.snapshot.request_tables(()) and not self._read_again():
                self.take()
            else:
                self._note_moments()
                recorder.record(self.snapshot)

    def remove_recorder(self, recorder: TickSink) -> None:
        """Removes a recorder, which gets no more ticks."""
        with self.lock:
            self._recorders = [r for r in self._recorders if r() not in (None, recorder)]
            self._read_recorded()

    def _read_recorded(self) -> None:
        """Makes each tick include the tables of the recorders."""
        recorders = [recorder for reference in self._recorders if (recorder := reference())]
        tables = frozenset(table for r in recorders for table in r.tables)
        self.snapshot.recorded = tables - {"entities"}

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

    def _read_masses(self) -> None:
        """Reads the masses at this tick, and passes them to the recorders."""
        if self.is_final or not self.snapshot.read_masses(self.simulator):
            return
        for reference in self._recorders:
            recorder = reference()
            if recorder is not None:
                recorder.check_masses(self.snapshot)

    def _note_moments(self) -> None:
        """Notes whether recorded contacts have moments besides those of their forces."""
        if not self._had_moments and "contacts" in self.snapshot.recorded:
            self._had_moments = self.snapshot.contact_points.has_moments

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


def _portions(count: int, maximum: int) -> Iterator[int]:
    """Yields positive numbers of at most `maximum` whose sum is `count`; 0 for 0."""
    yield min(count, maximum)
    for done in range(maximum, count, maximum or 1):
        yield min(maximum, count - done)
