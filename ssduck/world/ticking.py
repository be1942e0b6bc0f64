"""A simulation that is looked at one tick at a time: taking ticks, holding them, keeping them."""

from __future__ import annotations

import threading
import time
import weakref
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from itertools import count
from typing import Protocol, Self

from ssduck import validation
from ssduck.errors import ArgumentError, NumberError, SelectScriptError, SimulatorError
from ssduck.schema import MARGINS, MASSES
from ssduck.simulators.clock import Clock
from ssduck.simulators.interface import Simulator
from ssduck.simulators.static import StaticSimulator
from ssduck.world.entity_registry import EntityRegistry
from ssduck.world.observers import Observable
from ssduck.world.snapshot import Snapshot

_serials = count()
# Seconds that a step waits while another thread wants to ask.
_TURN = 1e-4
# Whoever watches a run is told each so many steps.
_WATCHED = 24


class TickSink(Protocol):
    """Keeps ticks of a world as they are taken."""

    @property
    def tables(self) -> Collection[str]:
        """The tables that each tick is to have."""

    def note(self, snapshot: Snapshot) -> None:
        """Keep a tick, if it is one to be kept; the caller holds its world."""

    def note_masses(self, snapshot: Snapshot) -> None:
        """Take note of masses that were read anew."""


class SteppedSimulation(Observable):
    """A simulator and the last tick that was taken of it.

    Attributes:
        name: what it is called.
        lock: who holds it is alone with the simulator and the tick.
        serial: the order in which they were made, and in which several are held.
        snapshot: the last tick.
    """

    def _begin_ticking(self, simulator: Simulator, snapshot: Snapshot, name: str) -> None:
        self.name = name
        self.lock = threading.RLock()
        self._begin_following()
        self.serial = next(_serials)
        self.snapshot = snapshot
        self._queries = 0
        self._waiting = 0
        self._simulator = simulator
        self._registry = EntityRegistry(snapshot.load_order)
        self._recorders: list[weakref.ref[TickSink]] = []

    @property
    def time(self) -> float:
        """Simulated seconds at the last tick."""
        return self.snapshot.time

    @property
    def timestep(self) -> float:
        """Simulated seconds that the next step takes; 0 for a what-if world, which has none."""
        with self.lock:
            return self._simulator.timestep

    # -- a tick ---------------------------------------------------------------------------

    def tick(self, *, steps: int | None = None, time: float | None = None) -> Self:
        """Take a tick: the tables are replaced by the simulator's state as it is now.

        In an attached world, whose client you step, simulated time goes on with each such tick:
        by one of the client's time steps, as it is set now, unless an argument tells otherwise.
        In all other worlds only steps take time, and neither argument is accepted.

        Args:
            steps: how many steps you have run since the last tick, 0 or more. 0 takes another
                tick of the same time: bodies were put elsewhere, say.
            time: the simulated time that it is now, s, in place of a number of steps; not
                before that of the last tick.

        Raises:
            SimulatorError: the simulator does not answer; the last tick and its time stay.
            NumberError: an argument is no such number, or the time is before the last tick's.
            ArgumentError: both are given, or the world is not attached.
        """
        with self.lock:
            self._check_not_pinned()
            before, number = self._simulator.clock, self.snapshot.number
            if self._simulator.is_external:
                self._simulator.set_clock(self._clock_of_tick(steps, time))
            elif steps is not None or time is not None:
                raise ArgumentError(
                    f"tick: steps and time are for an attached world, and {self.name!r} is none: "
                    "only step and run take its time"
                )
            try:
                self._take()
            except BaseException:
                if self._simulator.is_external and self.snapshot.number == number:
                    self._simulator.set_clock(before)
                raise
        self.notify_observers()
        return self

    def _clock_of_tick(self, steps: int | None, time: float | None) -> Clock:
        """The clock of an attached world at the tick that is to be taken."""
        clock, timestep = self._simulator.clock, self._simulator.timestep
        if steps is not None and time is not None:
            raise ArgumentError("tick: steps and time exclude each other")
        if time is None:
            count = (
                1 if steps is None else validation.step_count(steps, "tick: steps", "tick(time=…)")
            )
            return clock.after(count, timestep)
        given = validation.finite_number(time, "tick: time", "seconds")
        if given < clock.time - self.slack:
            raise NumberError(
                f"tick: time: {given:g} s is before the last tick, {clock.time:g} s; time does "
                "not go back: after a reset, attach the client anew, which begins a new episode"
            )
        if timestep and given + timestep == given:
            raise NumberError(f"tick: time: {given:g} s is so late that a step does not count")
        # Within rounding it is the time of the last tick.
        return clock if abs(given - clock.time) <= self.slack else clock.at(given, timestep)

    def step(self, count: int = 1) -> Self:
        """Run that many steps of the simulator, then take a tick.

        Where a follower wants a tick on the way (a trigger is due, say), one is taken there, too.
        Ctrl-C ends it at a tick.

        Args:
            count: how many steps, 0 or more; a number of seconds is for `run`.

        Raises:
            NumberError: it is no such number.
            SimulatorError: the simulator does not answer; the last tick stays.
            UnsupportedError: it is a what-if world.
        """
        left = validation.step_count(count, "step", "run({})")
        while True:
            run = int(min(left, self.steps_to_due()))
            self.advance(run)
            self.notify_observers()
            left -= run
            if left <= 0:
                return self

    def advance(self, count: int, watch: Callable[[int], object] | None = None) -> None:
        """Run steps and take a tick, telling no follower: a part of `step`.

        Args:
            count: how many steps.
            watch: is told now and then how many more were run; the world is locked meanwhile.
        """
        if self._waiting:
            time.sleep(_TURN)  # locks are not fair: a thread that only steps would keep it
        with self.lock:
            self._check_not_pinned()
            try:
                for done in _parts(count, count if watch is None else _WATCHED):
                    self._simulator.step(done)
                    if watch is not None:
                        watch(done)
            except KeyboardInterrupt:
                self._take_tick()  # the tables are not to lag behind the simulator
                raise
            self._take_tick()

    def _take_tick(self) -> None:
        self._check_not_pinned()
        self._take()

    def _take(self) -> None:
        self._registry.update(self._simulator)
        self.snapshot.take(self._simulator, self._registry.entities)
        failed = None
        for reference in self._recorders:
            recorder = reference()
            if recorder is not None:
                try:
                    recorder.note(self.snapshot)
                except SelectScriptError as error:  # a full disk is no trouble of the others
                    failed = failed or error
        if failed is not None:
            raise failed

    # -- what is asked of it ----------------------------------------------------------------

    def request_tables(self, tables: Iterable[str]) -> None:
        """See to it that the current tick has these tables; takes a fresh one if it has not."""
        with self.lock:
            if self.snapshot.request_tables(tables):
                self._take_requested()
            if MASSES in tables:
                self._read_masses()
            if MARGINS in tables and not self.is_final:
                self.snapshot.read_margins(self._simulator)

    def _read_masses(self) -> None:
        """Read the masses at this tick, and tell who keeps ticks of them."""
        if self.is_final or not self.snapshot.read_masses(self._simulator):
            return
        for reference in self._recorders:
            recorder = reference()
            if recorder is not None:
                recorder.note_masses(self.snapshot)

    def _take_requested(self) -> None:
        if self._simulator.is_external:
            self._check_not_pinned()
        # Under a query nothing has moved in a world that ssduck alone steps.
        self._take()

    @contextmanager
    def pinned(self, tables: Iterable[str] = ()) -> Iterator[None]:
        """Hold the world at its tick, with these tables read, while a query runs."""
        self._waiting += 1
        self.lock.acquire()
        self._waiting -= 1
        try:
            self.request_tables(tables)
            self._queries += 1
            try:
                yield
            finally:
                self._queries -= 1
        finally:
            self.lock.release()

    def _check_not_pinned(self) -> None:
        if self._queries:
            raise SelectScriptError(
                f"a query on {self.name!r} is running: its tick cannot be replaced before it ends"
            )

    # -- who keeps ticks --------------------------------------------------------------------

    def add_recorder(self, recorder: TickSink) -> None:
        """Let a recorder keep this tick and those to come, as long as anyone else holds it."""
        with self.lock:
            self._check_not_pinned()
            with suppress(SimulatorError):  # which may be gone: its last tick is kept
                self._read_masses()
            self._recorders.append(weakref.ref(recorder))
            self._read_recorded()
            if self.snapshot.request_tables(()):
                self._take()
            else:
                recorder.note(self.snapshot)

    def remove_recorder(self, recorder: TickSink) -> None:
        """Let a recorder keep no more ticks."""
        with self.lock:
            self._recorders = [r for r in self._recorders if r() not in (None, recorder)]
            self._read_recorded()

    def _read_recorded(self) -> None:
        """See to it that each tick has the tables that are recorded."""
        recorders = [recorder for reference in self._recorders if (recorder := reference())]
        tables = frozenset(table for r in recorders for table in r.tables)
        self.snapshot.recorded = tables - {"entities"}

    @property
    def is_final(self) -> bool:
        """Whether no other tick of it will come: it is a what-if world, or a past one."""
        return isinstance(self._simulator, StaticSimulator)


def _parts(count: int, most: int) -> Iterator[int]:
    """A number in parts of at most `most`; 0 is one part."""
    yield min(count, most)
    for begun in range(most, count, most or 1):
        yield min(most, count - begun)
