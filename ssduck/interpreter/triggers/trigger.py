"""One trigger: its schedule, the dependencies of its result, its callback and its state."""

from __future__ import annotations

import math
import threading
import weakref
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

from ssduck.errors import warn
from ssduck.interpreter.program import CompiledProgram
from ssduck.interpreter.triggers.conditions import Debouncer, TriggerConfig, copy_of
from ssduck.interpreter.triggers.formulas import Meaning
from ssduck.language import ast
from ssduck.language.analysis import IMPURE, calls_of, variables_of
from ssduck.sql.relation_calls import tables_of
from ssduck.world.world import World


class CallbackQueue:
    """A queue of values and a thread that calls back with each of them in turn.

    A full queue drops its oldest value. The thread refers to nothing but this object and the
    callback. It starts with the first value, and ends with `close`.
    """

    def __init__(self, call: Callable[[Any], object], size: int, name: str) -> None:
        self.dropped = 0  # the number of values that were dropped
        self._call = call
        self._size = size
        self._waiting: deque[Any] = deque()
        self._changed = threading.Condition()
        self._is_open = True
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)

    @property
    def pending(self) -> int:
        """The number of waiting values."""
        return len(self._waiting)

    def put(self, value: Any) -> None:
        """Adds a value, and drops the oldest one if the queue is full."""
        with self._changed:
            if not self._is_open:
                return
            if not self._thread.ident:
                self._thread.start()
            if len(self._waiting) == self._size:
                self._waiting.popleft()
                self.dropped += 1
            self._waiting.append(value)
            self._changed.notify()

    def close(self) -> None:
        """Drops the waiting values and ends the thread."""
        with self._changed:
            self._is_open = False
            self.dropped += len(self._waiting)
            self._waiting.clear()
            self._changed.notify()

    def join(self, seconds: float) -> bool:
        """Waits for the end of the thread, or for a time, s; tells whether it has ended."""
        if not self._thread.ident or self._thread is threading.current_thread():
            return True
        self._thread.join(seconds)
        return not self._thread.is_alive()

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or not self._is_open)
                if not self._is_open:
                    return
                value = self._waiting.popleft()
            self._call(value)
            del value


# The largest number of different errors of one trigger that become warnings.
MAX_WARNINGS = 100
# Functions whose values change though their arguments do not.
_CHANGING = IMPURE | {"getTime", "var"}


@dataclass
class KnownWorlds:
    """The worlds that a program reads."""

    # The stamp of the names for which they are known; None if values that decide them may change.
    stamp: object = None
    worlds: Sequence[World] = ()  # the worlds; empty if they are not known


class TriggerWarning(RuntimeWarning):
    """The program or the callback of a trigger failed; the world goes on."""


class Trigger:
    """One trigger: its program, its callback and its state."""

    def __init__(
        self, config: TriggerConfig, program: CompiledProgram, callback: Callable[[Any], object]
    ) -> None:
        self.config = config  # when it fires
        self.program = program  # the program that it evaluates
        self.paused = False  # whether it is never due
        self.removed = False  # whether its callback is not to be called any more
        # The names on which the result depends, if it depends on these and ticks only.
        self.reads = _names_read_by(program.tree)
        # The variables and ticks of its last result; None if they are unknown.
        self.dependencies: Any = None
        # The names whose values decide what the program means, in a fixed order.
        self.names = tuple(sorted(self.reads or ()))
        # The names of the variables that the program reads, in a fixed order.
        self.variables = tuple(
            sorted(frozenset().union(*map(variables_of, program.tree.statements)))
        )
        self.worlds = KnownWorlds()
        # What its program meant when it was last evaluated by itself; None if that failed, or if it
        # is always evaluated by itself.
        self.meaning: Meaning | None = None
        self._busy = threading.Lock()
        # The times from which its interval counts, and at which it is due, by world, s.
        self._starts: WeakKeyDictionary[World, float] = WeakKeyDictionary()
        self._due: WeakKeyDictionary[World, float] = WeakKeyDictionary()
        self._debouncer = Debouncer(config)
        self._log = _Log(config.name)
        self._call: Callable[[Any], object] = _with_errors_logged(callback, self._log)
        # The queue of its callback; None if the callback runs in the stepping thread.
        self.queue: CallbackQueue | None = None
        if config.queue is not None:
            self.queue = CallbackQueue(
                _without_warnings(self._call), config.queue, f"trigger {config.name}"
            )
            self._call = self.queue.put
            # The thread does not refer to the trigger, and ends with it.
            weakref.finalize(self, self.queue.close)

    def stands(self, rows: Any) -> bool:
        """Checks whether its last result is that of its formula's rows of a key, and is old."""
        return (
            self.meaning is not None
            and self.meaning.rows == rows
            and self._debouncer.is_steady
            and not self._busy.locked()
        )

    def begin(self) -> bool:
        """Begins an evaluation, unless one is running, in another thread or around this call."""
        return self._busy.acquire(blocking=False)

    def end(self) -> None:
        """Ends an evaluation that was begun."""
        self._busy.release()

    def due(self, world: World) -> float:
        """Returns the time at which it is due in a world; infinity while it is evaluated."""
        if self.paused or self._busy.locked():
            return math.inf
        if not self.config.interval:
            return -math.inf
        if world not in self._starts:
            self.reschedule([world])
        return self._due.get(world, -math.inf)

    def reschedule(self, worlds: Sequence[World]) -> None:
        """Sets the next due time to the next multiple of the interval, without drift.

        An interval shorter than a step, 0 included, is due after every step.
        """
        interval = self.config.interval
        for world in worlds if interval else ():
            start, slack = self._starts.setdefault(world, world.time), world.ticker.slack
            if interval > slack:
                count = math.floor((world.time + slack - start) / interval) + 1
                self._due[world] = start + count * interval

    def begin_anew(self) -> None:
        """Takes the next result for the first one, as that of another run or episode."""
        self._debouncer.begin_episode()

    def restart(self, world: World) -> None:
        """Counts its interval from now on in a world that it reads, where an episode begins."""
        self.begin_anew()
        if world in self._starts:
            self._starts[world] = self._due[world] = world.time  # the first tick counts

    def resume(self, worlds: Sequence[World]) -> None:
        """Resumes the evaluations at the next multiple of the interval."""
        if self.paused:
            self._debouncer.reset()  # the candidate may not have held meanwhile
            self.reschedule(worlds)
            self.paused = False

    @property
    def result(self) -> Any:
        """The last result."""
        return self._log.result

    def deliverable(self, result: Any, worlds: Sequence[World]) -> tuple[Any] | None:
        """Records a result, and returns the value to deliver, in a tuple; None for none."""
        delivery = self._debouncer.fires(result, worlds)
        self._log.result = copy_of(result)
        return delivery

    def count_evaluation(self) -> None:
        """Counts an evaluation."""
        self._log.evaluations += 1

    def fire(self, delivery: Any) -> None:
        """Calls the callback, or puts the value into its queue."""
        if not self.removed:
            self._log.firings += 1
            self._call(delivery)

    def fail(self, error: Exception) -> None:
        """Records that the program failed."""
        self._debouncer.reset()
        self._log.report(error, "program")

    def remove(self) -> None:
        """Stops calling the callback."""
        self.removed = True
        if self.queue is not None:
            self.queue.close()

    def state(self) -> TriggerState:
        """Returns its state."""
        queue = self.queue
        return TriggerState(
            config=self.config,
            program=self.program.text,
            paused=self.paused,
            evaluations=self._log.evaluations,
            firings=self._log.firings,
            pending=queue.pending if queue else 0,
            dropped=queue.dropped if queue else 0,
            result=copy_of(self._log.result),
            failures=self._log.failures,
            error=self._log.error,
        )


@dataclass(frozen=True)
class TriggerState:
    """The state of a trigger.

    Attributes:
        config: when it fires.
        program: the text of its program.
        paused: whether it waits for `resume_trigger`.
        evaluations: the number of evaluations.
        firings: the number of firings.
        pending: the number of results that wait for a callback with a queue.
        dropped: the number of those that were dropped because the queue was full or was closed.
        result: the last result, whether it fired or not; None before the first.
        failures: the number of failures of its program or its callback.
        error: the last of these errors; None before the first.
    """

    config: TriggerConfig
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
        """The name of the trigger."""
        return self.config.name

    @property
    def interval(self) -> float:
        """The simulated time between two evaluations, s."""
        return self.config.interval


def _names_read_by(program: ast.Program) -> frozenset[str] | None:
    """Returns the names of variables and functions that a query may use.

    None for another program than a query, or if the result may change between two ticks.
    """
    match program.statements:
        case [ast.Query() as query] if not program.explain:
            unresolved = {
                part.name for part in query.walk() if isinstance(part, ast.UnresolvedName)
            }
            names = calls_of(query) | variables_of(query) | unresolved
            # Sensors can be switched between two ticks.
            is_fixed = names.isdisjoint(_CHANGING) and "sensings" not in tables_of(query)
            return names if is_fixed else None
    return None


class _Log:
    """The history of a trigger; the thread of its callback refers to nothing else of it."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.evaluations = 0
        self.firings = 0
        self.failures = 0
        self.result: Any = None
        self.error: Exception | None = None
        self._warned: set[str] = set()

    def report(self, error: Exception, part: str) -> None:
        """Counts an error, and warns of it if it is the first of its text."""
        self.failures += 1
        self.error = error
        message = f"trigger {self.name!r}: its {part} failed: {type(error).__name__}: {error}"
        if message not in self._warned and len(self._warned) < MAX_WARNINGS:
            self._warned.add(message)
            warn(message, TriggerWarning)


def _with_errors_logged(callback: Callable[[Any], object], log: _Log) -> Callable[[Any], object]:
    """Wraps a callback so that its errors do not stop the world."""

    def call(result: Any) -> None:
        try:
            callback(result)
        except Exception as error:  # noqa: BLE001  # any error of the user's callback
            log.report(error, "callback")

    return call


def _without_warnings(call: Callable[[Any], object]) -> Callable[[Any], object]:
    """Wraps a callback for a thread, where nothing catches a warning that is made an error."""

    def quiet(result: Any) -> None:
        with suppress(TriggerWarning):
            call(result)

    return quiet
