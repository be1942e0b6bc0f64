"""Triggers: programs that are evaluated as simulated time passes, and callbacks for what changes.

A trigger is *due* every `interval` seconds of simulated time, counted from when it was added, of
each world that its program is about. It then evaluates its program; where the result is another
one than its callback was last told of, it *fires*: the callback gets the result.
"""

from __future__ import annotations

import math
import threading
import warnings
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args
from weakref import WeakKeyDictionary, WeakSet

from ssduck.changes import bag, changed, copied, is_true, likeness, rows_of
from ssduck.dependencies import IMPURE, calls_of, tables_of, variables_of
from ssduck.entities import Entity
from ssduck.errors import ArgumentError, UnknownNameError, nearest
from ssduck.inbox import Inbox
from ssduck.keys import ATOMS
from ssduck.messages import shown
from ssduck.running import duration
from ssduck.tree import Bare, Program, Query
from ssduck.world import World

if TYPE_CHECKING:
    from ssduck.interpreter import Compiled, Interpreter

When: TypeAlias = Literal["change", "rising", "falling"]

# So many different errors of one trigger are warned of.
MOST_WARNINGS = 100
# Seconds that closing waits for a callback that is running in a thread of its own.
PATIENCE = 5.0
# What gives another value though nothing that it is given is another one.
_CHANGING = IMPURE | {"getTime", "var"}
_LIVE = World | Entity


def _read_by(program: Program) -> frozenset[str] | None:
    """The names of variables and functions that a query may use.

    None for a program that is none, or whose result may change between two ticks.
    """
    match program.statements:
        case [Query() as query] if not program.explain:
            bare = {part.name for part in query.walk() if isinstance(part, Bare)}
            names = calls_of(query) | variables_of(query) | bare
            # Sensors can be switched between two ticks.
            is_fixed = names.isdisjoint(_CHANGING) and "sensings" not in tables_of(query)
            return names if is_fixed else None
    return None


class TriggerWarning(RuntimeWarning):
    """The program or the callback of a trigger failed; the world goes on."""


@dataclass(frozen=True)
class Terms:
    """When a trigger fires, and what it hands over; see `Interpreter.add_trigger`.

    Raises:
        ArgumentError: one of them is none that a trigger can have.
    """

    name: str
    interval: float
    when: When = "change"
    debounce: float = 0.0
    rows: bool = False
    queue: int | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise ArgumentError(f"add_trigger: name: {shown(self.name)} is no name; give a text")
        for name in ("interval", "debounce"):
            seconds = duration(getattr(self, name), f"add_trigger: {name}")
            object.__setattr__(self, name, seconds)  # for good from here on
        if self.when not in get_args(When):
            raise ArgumentError(
                f"add_trigger: when: {shown(self.when)} is none of 'change', 'rising', 'falling'",
                suggestions=nearest(self.when, get_args(When)),
            )
        if not isinstance(self.rows, bool):
            raise ArgumentError(f"add_trigger: rows: {shown(self.rows)} is not True or False")
        queue = self.queue
        is_size = isinstance(queue, int) and not isinstance(queue, bool) and queue >= 1
        if queue is not None and not is_size:
            raise ArgumentError(
                f"add_trigger: queue: {shown(queue)} is no size; 1 or more, or None for none"
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

    terms: Terms
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


class Beat:
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


class Settling:
    """What a callback was last told of, and what it is to be told of once that has held.

    Before the first result there are no rows, nothing is true, and any result is a change.
    """

    def __init__(self, terms: Terms) -> None:
        self._terms = terms
        self._told_rows: list[Any] = []
        self._settled: Any = None
        if terms.when != "change":
            self._settled = (False,)
        elif terms.rows:
            self._settled = bag([])
        self._next: Any = None
        self._since: WeakKeyDictionary[World, float] | None = None

    def fires(self, result: Any, worlds: Sequence[World]) -> tuple[Any] | None:
        """What is handed over for a result, in a tuple; None if it does not fire.

        Args:
            result: that of the evaluation.
            worlds: those whose time passes.
        """
        if not self._settles(self._compared(result), worlds):
            return None
        if self._terms.when != "change" and self._settled[0] is not (self._terms.when == "rising"):
            return None
        if not self._terms.rows:
            return (copied(result),)
        rows = copied(rows_of(result))
        before, self._told_rows = self._told_rows, rows
        return (changed(before, copied(rows)),)

    def _compared(self, result: Any) -> Any:
        """What is compared with what was told: in a tuple, for None stands for nothing yet."""
        if self._terms.when != "change":
            return (is_true(result),)
        return bag(rows_of(result)) if self._terms.rows else (likeness(result),)

    def _settles(self, value: Any, worlds: Sequence[World]) -> bool:
        """Whether it is another value, and has been so for long enough."""
        if value == self._settled:
            self.unsettle()
            return False
        if self._since is None or value != self._next:
            self._next = value
            self._since = WeakKeyDictionary({world: world.time for world in worlds})
        since = self._since
        held = any(w.reached(since.get(w, w.time) + self._terms.debounce) for w in worlds)
        if held or not self._terms.debounce:
            self._settled = value
            self.unsettle()
            return True
        return False

    def unsettle(self) -> None:
        """Forget what was to be told: it does not hold any more."""
        self._next = self._since = None


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

    def __init__(self, terms: Terms, program: Compiled, callback: Callable[[Any], object]) -> None:
        self.terms = terms
        self.program = program
        self.paused = False
        self.removed = False
        self.reads = _read_by(program.tree)
        self.basis: Any = None
        self._busy = threading.Lock()
        self._beats: WeakKeyDictionary[World, Beat] = WeakKeyDictionary()
        self._settling = Settling(terms)
        self._log = _Log(terms.name)
        self._call: Callable[[Any], object] = _guarded(callback, self._log)
        self.inbox: Inbox | None = None
        if terms.queue is not None:
            self.inbox = Inbox(_quiet(self._call), terms.queue, f"trigger {terms.name}")
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

    def _beat(self, world: World) -> Beat:
        beat = self._beats.get(world)
        if beat is None:
            beat = self._beats[world] = Beat(world, self.terms.interval)
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
            warnings.warn(told, TriggerWarning, stacklevel=2)


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


class Triggers:
    """The triggers of an interpreter; follows the worlds that they are about.

    Args:
        interpreter: what evaluates their programs.
    """

    def __init__(self, interpreter: Interpreter) -> None:
        self._interpreter = interpreter
        self._by_name: dict[str, Trigger] = {}
        self._lock = threading.Lock()
        self._followed: WeakSet[World] = WeakSet()

    def add(self, terms: Terms, program: str | Compiled, callback: Callable[[Any], object]) -> None:
        """Add one, and evaluate it for the first time; see `Interpreter.add_trigger`."""
        if isinstance(program, str):
            program = self._interpreter.compile(program)
        elif not hasattr(program, "tree"):
            raise ArgumentError(
                f"add_trigger: program: {shown(program)} is neither a text nor what compile gave"
            )
        if not callable(callback):
            raise ArgumentError(f"add_trigger: callback: {shown(callback)} is no function")
        self._check_free(terms.name)
        trigger = Trigger(terms, program, callback)
        with trigger.turn():
            trigger.count_on(self._follow(trigger))
            told = self._looked_at(trigger)
            with self._lock:
                self._check_free(terms.name)
                self._by_name = {**self._by_name, terms.name: trigger}
            self._fire(trigger, told)

    def _check_free(self, name: str) -> None:
        if name in self._by_name:
            raise ArgumentError(
                f"add_trigger: there is a trigger {name!r} already; del_trigger({name!r}) first, "
                "or choose another name"
            )

    def remove(self, name: str) -> None:
        """Remove one."""
        with self._lock:
            self._named(name).remove()
            self._by_name = {n: t for n, t in self._by_name.items() if n != name}

    def pause(self, name: str) -> None:
        """Let one never be due."""
        self._named(name).paused = True

    def resume(self, name: str) -> None:
        """Let one be due again."""
        trigger = self._named(name)
        trigger.resume(self._about(trigger))

    def _named(self, name: str) -> Trigger:
        if name not in self._by_name:
            raise UnknownNameError(
                f"there is no trigger {shown(name)}", suggestions=nearest(name, self._by_name)
            )
        return self._by_name[name]

    def states(self) -> list[TriggerState]:
        """What has become of each, in the order in which they were added."""
        return [trigger.state() for trigger in self._by_name.values()]

    def close(self) -> None:
        """Remove all, and wait for callbacks that are running in threads of their own."""
        with self._lock:
            triggers, self._by_name = list(self._by_name.values()), {}
        for trigger in triggers:
            trigger.remove()
        for world in list(self._followed):
            world.unfollow(self)
        self._followed.clear()
        for trigger in triggers:
            if trigger.inbox is not None and not trigger.inbox.join(PATIENCE):
                warnings.warn(
                    f"trigger {trigger.terms.name!r}: its callback is still running",
                    TriggerWarning,
                    stacklevel=3,
                )

    # -- worlds (ssduck.following.Follower) -------------------------------------------------

    def due(self, world: World, /) -> float:
        """When the next trigger is due in a world."""
        triggers = [t for t in self._by_name.values() if world in self._about(t)]
        return min((trigger.due(world) for trigger in triggers), default=math.inf)

    def ticked(self, world: World, /) -> None:
        """Evaluate what is due in a world, in the order in which triggers were added."""
        for trigger in self._by_name.values():
            # A callback may have removed or paused it meanwhile.
            is_about = not trigger.removed and world in self._about(trigger)
            if is_about and world.reached(trigger.due(world)):
                self._evaluate(trigger)

    def rebound(self) -> None:
        """Follow what triggers are about, now that a name stands for another world."""
        for trigger in self._by_name.values():
            self._follow(trigger)

    def _evaluate(self, trigger: Trigger) -> None:
        with trigger.turn() as is_mine:
            if not is_mine:
                return
            trigger.count_on(self._about(trigger))
            try:
                told = self._looked_at(trigger)
            except Exception as error:  # noqa: BLE001  # whatever it is, the world goes on
                trigger.fail(error)
                return
            self._fire(trigger, told)

    def _fire(self, trigger: Trigger, told: tuple[Any] | None) -> None:
        """Let one fire if there is something to tell."""
        if told is not None:
            trigger.fire(*told)
            # Its callback may have stepped worlds: what was due meanwhile is passed over.
            trigger.count_on(self._about(trigger))

    def _looked_at(self, trigger: Trigger) -> tuple[Any] | None:
        """Evaluate one; gives what its callback is to be told, in a tuple, or None."""
        trigger.note_looked()
        basis = self._basis(trigger)
        if basis is None or basis != trigger.basis:
            trigger.basis = None
            result = self._interpreter.eval(trigger.program)
            # As it was before: a tick that is taken meanwhile is not missed.
            trigger.basis = basis
        else:
            result = trigger.result
        return trigger.note(result, self._follow(trigger))

    def _basis(self, trigger: Trigger) -> Any:
        """What the result of a program depends on, if that is known: a query's worlds' ticks."""
        names, room = trigger.reads, self._interpreter
        if names is None or any(map(room.is_users, names)):
            return None
        known = [(name, room.variable(name)) for name in names if room.has_variable(name)]
        if not all(type(value) in ATOMS or isinstance(value, _LIVE) for _, value in known):
            return None
        ticks = [(world, world.snapshot.number) for world in self._about(trigger)]
        return [(name, type(value), value) for name, value in known], ticks

    def _about(self, trigger: Trigger) -> list[World]:
        """The worlds that a program is about; all, if it does not tell or is about none."""
        found: list[World] | None = None
        with suppress(RecursionError):  # a list that is in itself
            found = self._interpreter._worlds_of(trigger.program.tree.statements)  # noqa: SLF001
        return list(dict.fromkeys(found or self._interpreter.worlds))

    def _follow(self, trigger: Trigger) -> list[World]:
        """Follow the worlds that a trigger is about, and all that it may come to be about."""
        worlds = self._about(trigger)
        for world in (*worlds, *self._interpreter.worlds):
            if world not in self._followed:
                world.follow(self)
                self._followed.add(world)
        return worlds


class TriggerVerbs:
    """What an interpreter lets its users do with triggers."""

    _triggers: Triggers

    def add_trigger(
        self,
        name: str,
        program: str | Compiled,
        interval: float,
        callback: Callable[[Any], object],
        *,
        when: When = "change",
        debounce: float = 0.0,
        rows: bool = False,
        queue: int | None = None,
    ) -> None:
        """Call a function when the result of a program changes as simulated time passes.

        The program is evaluated at once, and then every `interval` seconds of the simulated time
        of each world that it is about; where it does not tell, or is about none, of all. The
        first result is a change. What the callback is given is its own.

        Without a queue the callback runs in the thread that steps the world, between two steps.
        It may query and change worlds, and add and remove triggers. It may step them, too: a
        world that is being stepped around it runs through; what became due of other triggers
        meanwhile is evaluated after the next step, of this one it is passed over. An error of
        the program or of the callback is a `TriggerWarning`, once for each that is different,
        and is told by `triggers`.

        Args:
            name: to find it by.
            program: its text, or what `compile` gave.
            interval: simulated seconds; less than a step, 0 included: after every step.
            callback: is called with the result, or with what `rows` says.
            when: `"change"`: when the result is another one; `"rising"`: when it becomes true;
                `"falling"`: when it becomes false. No rows, None, 0, NaN and an empty text are
                false, and so is what was before the first result.
            debounce: simulated seconds for which a new result has to hold, at each evaluation,
                before it counts.
            rows: whether the callback gets `Changed(added, removed)`, the rows by which the
                result differs from what it was last told of; their order does not matter then,
                and at first there are none.
            queue: the callback runs in a thread of its own, and so many results may wait for
                it; when there are more, the oldest is dropped.

        Raises:
            SelectScriptError: the program cannot be evaluated; the trigger is not added.
            ArgumentError: there is one of that name, or an argument is wrong.
        """
        terms = Terms(name, interval, when, debounce, rows, queue)
        self._triggers.add(terms, program, callback)

    def del_trigger(self, name: str) -> None:
        """Remove a trigger: its callback is not called any more; one that runs goes on.

        Raises:
            UnknownNameError: there is none, with the nearest names.
        """
        self._triggers.remove(name)

    def pause_trigger(self, name: str) -> None:
        """Let a trigger not be evaluated until `resume_trigger`.

        Raises:
            UnknownNameError: there is none, with the nearest names.
        """
        self._triggers.pause(name)

    def resume_trigger(self, name: str) -> None:
        """Let a trigger be evaluated again, from the next multiple of its interval on.

        Raises:
            UnknownNameError: there is none, with the nearest names.
        """
        self._triggers.resume(name)

    def triggers(self) -> list[TriggerState]:
        """What has become of each trigger, in the order in which they were added."""
        return self._triggers.states()

    # The tutorial's spellings.
    addTrigger = add_trigger  # noqa: N815
    delTrigger = del_trigger  # noqa: N815
