"""One trigger: when it is due, what its result depends on, its callback, what has become of it."""

from __future__ import annotations

import math
import threading
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

from ssduck.errors import warn
from ssduck.interpreter.program import CompiledProgram
from ssduck.interpreter.triggers.callback_queue import CallbackQueue
from ssduck.interpreter.triggers.conditions import Debouncer, TriggerConfig
from ssduck.interpreter.triggers.diff import copied
from ssduck.language.analysis import IMPURE, calls_of, variables_of
from ssduck.language.tree import Program, Query, UnresolvedName
from ssduck.sql.table_use import tables_of
from ssduck.world.world import World

# So many different errors of one trigger are warned of.
MOST_WARNINGS = 100
# What gives another value though nothing that it is given is another one.
_CHANGING = IMPURE | {"getTime", "var"}


class TriggerWarning(RuntimeWarning):
    """The program or the callback of a trigger failed; the world goes on."""


class Trigger:
    """One trigger: its program, its callback and its state.

    Attributes:
        terms: when it fires.
        program: what it evaluates.
        paused: whether it is never due.
        removed: whether its callback is not to be called any more.
        reads: the names that the result depends on, if nothing else but ticks matters.
        basis: what its last result depends on, where that is known.
    """

    def __init__(
        self, terms: TriggerConfig, program: CompiledProgram, callback: Callable[[Any], object]
    ) -> None:
        self.terms = terms
        self.program = program
        self.paused = False
        self.removed = False
        self.reads = _read_by(program.tree)
        self.basis: Any = None
        self._busy = threading.Lock()
        self._beats: WeakKeyDictionary[World, Schedule] = WeakKeyDictionary()
        self._settling = Debouncer(terms)
        self._log = _Log(terms.name)
        self._call: Callable[[Any], object] = _guarded(callback, self._log)
        self.inbox: CallbackQueue | None = None
        if terms.queue is not None:
            self.inbox = CallbackQueue(_quiet(self._call), terms.queue, f"trigger {terms.name}")
            self._call = self.inbox.put
            # The thread ends with the trigger, of which it knows nothing.
            weakref.finalize(self, self.inbox.close)

    @contextmanager
    def turn(self) -> Iterator[bool]:
        """Whether it is not at work already, be it in another thread or around this call."""
        is_mine = self._busy.acquire(blocking=False)
        try:
            yield is_mine
        finally:
            if is_mine:
                self._busy.release()

    def due(self, world: World) -> float:
        """When it is due in a world that it is about; never while it is at work."""
        if self.paused or self._busy.locked():
            return math.inf
        return self._beat(world).due

    def _beat(self, world: World) -> Schedule:
        beat = self._beats.get(world)
        if beat is None:
            beat = self._beats[world] = Schedule(world, self.terms.interval)
        return beat

    def count_on(self, worlds: Sequence[World]) -> None:
        """Be due again one interval further on."""
        for world in worlds:
            self._beat(world).count_on(world)

    def resume(self, worlds: Sequence[World]) -> None:
        """Be due again, from the next multiple of the interval on."""
        if self.paused:
            self._settling.unsettle()  # what held before may not have held meanwhile
            self.count_on(worlds)
            self.paused = False

    @property
    def result(self) -> Any:
        """The last result."""
        return self._log.result

    def note(self, result: Any, worlds: Sequence[World]) -> tuple[Any] | None:
        """Take note of a result; gives what the callback is to be told, in a tuple, or None."""
        told = self._settling.fires(result, worlds)
        self._log.result = copied(result)
        return told

    def note_looked(self) -> None:
        """Take note that it was due and is looked at."""
        self._log.evaluations += 1

    def fire(self, told: Any) -> None:
        """Call the callback, or have it called."""
        if not self.removed:
            self._log.firings += 1
            self._call(told)

    def fail(self, error: Exception) -> None:
        """Take note that the program failed."""
        self._settling.unsettle()
        self._log.report(error, "program")

    def remove(self) -> None:
        """Call the callback no more."""
        self.removed = True
        if self.inbox is not None:
            self.inbox.close()

    def state(self) -> TriggerState:
        """What has become of it."""
        inbox = self.inbox
        return TriggerState(
            terms=self.terms,
            program=self.program.text,
            paused=self.paused,
            evaluations=self._log.evaluations,
            firings=self._log.firings,
            pending=inbox.pending if inbox else 0,
            dropped=inbox.dropped if inbox else 0,
            result=copied(self._log.result),
            failures=self._log.failures,
            error=self._log.error,
        )


@dataclass(frozen=True)
class TriggerState:
    """What has become of a trigger.

    Attributes:
        terms: when it fires.
        program: its text.
        paused: whether it waits for `resume_trigger`.
        evaluations: how often it was due and looked at.
        firings: how often it fired.
        pending: how many results wait for a callback with a queue.
        dropped: how many of those went because the queue was full, or was closed.
        result: the last one, whether it fired or not; None before the first.
        failures: how often its program or its callback failed.
        error: the last error of these; None before the first.
    """

    terms: TriggerConfig
    program: str
    paused: bool
    evaluations: int
    firings: int
    pending: int
    dropped: int
    result: Any
    failures: int
    error: Exception | None

    @property
    def name(self) -> str:
        """Its name."""
        return self.terms.name

    @property
    def interval(self) -> float:
        """Simulated seconds between two evaluations."""
        return self.terms.interval


class Schedule:
    """When a trigger is due in one world: every `interval` seconds from `start`, no drift.

    An interval shorter than a step, 0 included, is due after every step.
    """

    def __init__(self, world: World, interval: float) -> None:
        self._start = world.time
        self._interval = interval
        self.due = -math.inf
        self.count_on(world)

    def count_on(self, world: World) -> None:
        """Be due at the first multiple of the interval that is not reached yet."""
        if self._interval > world.slack:
            passed = world.time + world.slack - self._start
            times = math.floor(passed / self._interval) + 1
            self.due = self._start + times * self._interval


def _read_by(program: Program) -> frozenset[str] | None:
    """The names of variables and functions that a query may use.

    None for a program that is none, or whose result may change between two ticks.
    """
    match program.statements:
        case [Query() as query] if not program.explain:
            bare = {part.name for part in query.walk() if isinstance(part, UnresolvedName)}
            names = calls_of(query) | variables_of(query) | bare
            # Sensors can be switched between two ticks.
            is_fixed = names.isdisjoint(_CHANGING) and "sensings" not in tables_of(query)
            return names if is_fixed else None
    return None


class _Log:
    """What has become of a trigger; all that the thread of its callback knows of it."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.evaluations = 0
        self.firings = 0
        self.failures = 0
        self.result: Any = None
        self.error: Exception | None = None
        self._warned: set[str] = set()

    def report(self, error: Exception, what: str) -> None:
        """Take note of an error, and warn of it if it is the first of its kind."""
        self.failures += 1
        self.error = error
        told = f"trigger {self.name!r}: its {what} failed: {type(error).__name__}: {error}"
        if told not in self._warned and len(self._warned) < MOST_WARNINGS:
            self._warned.add(told)
            warn(told, TriggerWarning)


def _guarded(callback: Callable[[Any], object], log: _Log) -> Callable[[Any], object]:
    """A callback whose errors do not stop the world."""

    def call(result: Any) -> None:
        try:
            callback(result)
        except Exception as error:  # noqa: BLE001  # it is the user's
            log.report(error, "callback")

    return call


def _quiet(call: Callable[[Any], object]) -> Callable[[Any], object]:
    """For a thread, in which nobody would catch a warning that is made an error."""

    def quiet(result: Any) -> None:
        with suppress(TriggerWarning):
            call(result)

    return quiet
