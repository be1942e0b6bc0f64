"""Triggers: programs that run as simulated time passes, and callbacks for changes of their results.

A trigger is *due* every `interval` seconds of simulated time, counted from when it was added, in
each world that its program reads. It then evaluates its program. If the result differs from the
last one delivered, it *fires*: the callback gets the result.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary, WeakSet

from ssduck import validation
from ssduck.errors import ArgumentError, UnknownNameError, nearest, warn
from ssduck.formatting import short_repr
from ssduck.interpreter.execution import Execution
from ssduck.interpreter.program import CompiledProgram
from ssduck.interpreter.triggers.conditions import TriggerConfig, When
from ssduck.interpreter.triggers.formulas import are_fixed
from ssduck.interpreter.triggers.tick_batch import TickBatch, TriggerBatches
from ssduck.interpreter.triggers.trigger import Trigger, TriggerState, TriggerWarning
from ssduck.world.world import World

# The time for which closing waits for a callback in a thread of its own, s.
PATIENCE = 5.0


@dataclass(frozen=True, eq=False)
class _Readers:
    """The triggers that read a world and are not paused."""

    by_name: Mapping[str, Trigger]  # all triggers
    stamp: object  # the stamp of the names
    pauses: int  # the number of times that a trigger was paused or resumed
    triggers: tuple[Trigger, ...]  # those that read the world
    are_always_due: bool  # whether all of them are due at each tick


class TriggerRegistry:
    """The triggers of an interpreter; observes the worlds that they read."""

    def __init__(
        self,
        compile: Callable[[str], CompiledProgram],
        evaluate: Callable[[CompiledProgram], Any],
        names: Execution,
        batches: TriggerBatches,
    ) -> None:
        self._compile, self._eval = compile, evaluate
        self._names = names
        self._batches = batches
        self._by_name: dict[str, Trigger] = {}
        # Are called with the name of each trigger that fires.
        self.listeners: list[Callable[[str], object]] = []
        self._lock = threading.Lock()
        # The number of times that a trigger was paused or resumed.
        self._pauses = 0
        self._readers: WeakKeyDictionary[World, _Readers] = WeakKeyDictionary()
        self._observed: WeakSet[World] = WeakSet()

    def add_trigger(
        self,
        name: str,
        program: str | CompiledProgram,
        interval: float,
        callback: Callable[[Any], object] | None = None,
        *,
        when: When = "change",
        debounce: float = 0.0,
        rows: bool = False,
        queue: int | None = None,
        threshold: float = 0.0,
    ) -> None:
        """Calls a function when the result of a program changes as simulated time passes.

        The program is evaluated at once, and then every `interval` seconds of simulated time of
        each world that it reads; of all worlds if that is not known or there is none. The first
        result counts as a change. The callback gets a copy of the result.

        Without a queue the callback runs in the thread that steps the world, between two steps.
        It may query and change worlds, and add and remove triggers. It may also step worlds: other
        triggers that become due meanwhile are evaluated after the next step, this one is not.
        An error in the program or the callback becomes a `TriggerWarning`, once for each different
        error, and is listed by `triggers`.

        Args:
            name: the name of the trigger.
            program: the text, or a compiled program.
            interval: the simulated time between evaluations, s; if it is less than a step, 0
                included, after every step.
            callback: the function to call with the result, or with the rows that `rows` asks for.
            when: `"change"`: when the result differs; `"rising"`: when it becomes true;
                `"falling"`: when it becomes false. No rows, None, 0, NaN and an empty text are
                false, and the trigger begins false.
            debounce: the simulated time, s, for which a new result has to hold at each evaluation
                before it counts.
            rows: whether the callback gets `Changed(added, removed)`, the rows in which the result
                differs from the last one delivered. Their order does not matter, and at first
                there are none.
            queue: the number of results that may wait for the callback, which then runs in a
                thread of its own; if more wait, the oldest is dropped.
            threshold: the largest change of a number since the last evaluation that does not
                count, in the number's unit: m, rad (of orientations), m/s, rad/s, N. While no
                number in the tables that the program reads has changed by more, the result is
                taken to be the last one. So bodies at rest, which the simulator moves by fractions
                of a micrometre, do not let the program run at each evaluation. Applies to queries
                that SQL evaluates over present entities, without functions of yours, `time` and
                `tick`; others are evaluated each time.

        Raises:
            SelectScriptError: the program cannot be evaluated; the trigger is not added.
            ArgumentError: a trigger of that name exists, or an argument is wrong.

        >>> import ssduck
        >>> times = []
        >>> with ssduck.load("kitchen") as ss:
        ...     ss.add_trigger("clock", "getTime();", 0.25, times.append)
        ...     ss.run(1.0)
        >>> times
        [0.0, 0.25, 0.5, 0.75, 1.0]
        """
        if callback is None:
            missing = "interval" if callable(interval) else "callback"
            raise ArgumentError(
                f"add_trigger: {missing} is missing: add_trigger(name, program, interval, "
                "callback), with the interval in seconds of simulated time"
            )
        config = TriggerConfig(name, interval, when, debounce, rows, queue, threshold)
        if isinstance(program, str):
            program = self._compile(program)
        elif not hasattr(program, "tree"):
            raise ArgumentError(
                f"add_trigger: program: {short_repr(program)} is neither a text nor a compiled "
                "program"
            )
        validation.function(callback, "add_trigger: callback")
        self._check_free(config.name)
        trigger = Trigger(config, program, callback)
        trigger.begin()
        try:
            trigger.reschedule(self._observe(trigger))
            delivery = self._next_delivery(trigger)
            with self._lock:
                self._check_free(config.name)
                self._by_name = {**self._by_name, config.name: trigger}
            self._fire(trigger, delivery)
        finally:
            trigger.end()

    def _check_free(self, name: str) -> None:
        if name in self._by_name:
            raise ArgumentError(
                f"add_trigger: there is a trigger {name!r} already; del_trigger({name!r}) first, "
                "or choose another name"
            )

    def del_trigger(self, name: str) -> None:
        """Removes a trigger; its callback is not called any more, but a running one goes on.

        Raises:
            UnknownNameError: no trigger has that name; the error suggests the nearest names.
        """
        with self._lock:
            self._trigger(name).remove()
            self._by_name = {n: t for n, t in self._by_name.items() if n != name}
        if not self._by_name:
            self._release_worlds()

    def pause_trigger(self, name: str) -> None:
        """Stops the evaluations of a trigger until `resume_trigger`.

        Raises:
            UnknownNameError: no trigger has that name; the error suggests the nearest names.
        """
        self._trigger(name).paused = True
        self._pauses += 1

    def resume_trigger(self, name: str) -> None:
        """Resumes the evaluations of a trigger at the next multiple of its interval.

        Raises:
            UnknownNameError: no trigger has that name; the error suggests the nearest names.
        """
        trigger = self._trigger(name)
        trigger.resume(self._worlds_of(trigger))
        self._batches.regroup()
        self._pauses += 1

    def _trigger(self, name: str) -> Trigger:
        if name not in self._by_name:
            raise UnknownNameError(
                f"there is no trigger {short_repr(name)}", suggestions=nearest(name, self._by_name)
            )
        return self._by_name[name]

    def triggers(self) -> list[TriggerState]:
        """Returns the state of each trigger, in the order in which they were added."""
        return [trigger.state() for trigger in self._by_name.values()]

    def close(self) -> None:
        """Removes all triggers, and waits for callbacks that run in threads of their own."""
        with self._lock:
            triggers, self._by_name = list(self._by_name.values()), {}
        for trigger in triggers:
            trigger.remove()
        for world in list(self._observed):
            world.unfollow(self)
        self._observed.clear()
        self._release_worlds()
        for trigger in triggers:
            if trigger.queue is not None and not trigger.queue.join(PATIENCE):
                warn(
                    f"trigger {trigger.config.name!r}: its callback is still running",
                    TriggerWarning,
                )

    # -- worlds (ssduck.world.observers.TickObserver) ----------------------------------------

    def due(self, world: World, /) -> float:
        """Returns the time at which the next trigger is due in a world."""
        due = math.inf
        for trigger in self._readers_of(world, self._names.stamp).triggers:
            due = min(due, trigger.due(world))
            if due == -math.inf:
                break
        return due

    def ticked(self, world: World, /) -> None:
        """Evaluates the triggers that are due in a world, in the order in which they were added."""
        if not self._by_name:
            return
        stamp, triggers = self._names.stamp, self._by_name.values()
        readers = self._readers_of(world, stamp)
        due = readers.triggers
        if not readers.are_always_due:
            due = tuple(trigger for trigger in due if self._is_due(trigger, world, stamp))
        if not due:
            return
        batch = self._batches.begin(world, due, stamp)
        due_now = frozenset(due)
        for trigger in triggers:
            if trigger in batch.standing:
                trigger.count_evaluation()
                if trigger.config.interval:
                    trigger.reschedule(self._worlds_of(trigger))
                continue
            # An earlier callback or program may have changed what is due.
            if batch.is_doubtful:
                is_due = self._is_due(trigger, world, self._names.stamp)
            else:
                is_due = trigger in due_now and not trigger.paused
            if is_due and not trigger.removed:
                self._evaluate(trigger, batch)

    def episode_began(self, world: World) -> None:
        """Lets the triggers that read a world begin anew, as it was reset."""
        self._release_worlds()
        for trigger in self._by_name.values():
            if world in self._worlds_of(trigger):
                trigger.restart(world)

    def _readers_of(self, world: World, stamp: object) -> _Readers:
        by_name, pauses = self._by_name, self._pauses
        known = self._readers.get(world)
        if (
            known is None
            or known.by_name is not by_name
            or known.stamp is not stamp
            or known.pauses != pauses
        ):
            triggers = [trigger for trigger in by_name.values() if not trigger.paused]
            readers = tuple(t for t in triggers if world in self._worlds_of(t, stamp))
            is_fixed = all(trigger.worlds.stamp is stamp for trigger in triggers)
            are_always_due = not any(trigger.config.interval for trigger in readers)
            known = _Readers(
                by_name, stamp if is_fixed else object(), pauses, readers, are_always_due
            )
            self._readers[world] = known
        return known

    def _is_due(self, trigger: Trigger, world: World, stamp: object) -> bool:
        if trigger.paused or world not in self._worlds_of(trigger, stamp):
            return False
        due = trigger.due(world)
        return due == -math.inf or (due < math.inf and world.reached(due))

    def rebound(self) -> None:
        """Observes the worlds that triggers read, after a name was bound to another world."""
        self._release_worlds()
        for trigger in self._by_name.values():
            self._batches.forget(trigger)
            before = set(trigger.worlds.worlds)
            self._observe(trigger)
            if not before.issubset(trigger.worlds.worlds):  # it reads another run
                trigger.begin_anew()

    def _release_worlds(self) -> None:
        """Drops what refers to worlds, which may be gone."""
        self._readers.clear()
        self._batches.release_worlds()

    def _evaluate(self, trigger: Trigger, batch: TickBatch | None = None) -> None:
        if not trigger.begin():
            return
        try:
            if trigger.config.interval:
                trigger.reschedule(self._worlds_of(trigger))
            try:
                delivery = self._next_delivery(trigger, batch)
            except Exception as error:  # noqa: BLE001  # no error stops the world
                self._batches.forget(trigger)
                trigger.fail(error)
                return
            if delivery is not None:
                if batch is not None:
                    batch.doubt()
                self._fire(trigger, delivery)
        finally:
            trigger.end()

    def _fire(self, trigger: Trigger, delivery: tuple[Any] | None) -> None:
        """Fires a trigger if there is a value to deliver."""
        if delivery is not None:
            for listener in self.listeners:
                listener(trigger.config.name)
            trigger.fire(*delivery)
            # The callback may have stepped worlds; evaluations that were due meanwhile are skipped.
            trigger.reschedule(self._worlds_of(trigger))

    def _next_delivery(self, trigger: Trigger, batch: TickBatch | None = None) -> tuple[Any] | None:
        """Evaluates a trigger, and returns the value to deliver, in a tuple; None for none."""
        trigger.count_evaluation()
        together = None if batch is None else batch.result(trigger)
        if together is not None:
            return trigger.deliverable(*together, self._observe(trigger))
        dependencies, worlds = self._dependencies_of(trigger), self._worlds_of(trigger)
        is_known = dependencies is not None and dependencies == trigger.dependencies
        if is_known or self._batches.has_same_tables(trigger, worlds):
            return trigger.deliverable(trigger.result, self._observe(trigger))
        trigger.dependencies = None
        # As read before the evaluation, so that a tick taken meanwhile is not missed.
        key = self._batches.key(trigger, worlds)
        ticks = [world.snapshot.number for world in worlds]
        result = self._eval(trigger.program)
        trigger.dependencies = dependencies
        self._batches.note(trigger, worlds, key, ticks)
        if batch is not None:
            batch.doubt()
        return trigger.deliverable(result, self._observe(trigger))

    def _dependencies_of(self, trigger: Trigger) -> Any:
        """Returns the meaning of names and the ticks on which a result depends; None if unknown."""
        names, scope = trigger.reads, self._names
        if names is None or any(scope.is_users(scope.resolved_name(name)) for name in names):
            return None
        if not are_fixed(scope.bound_values(names)):
            return None
        return scope.stamp, [(w, w.snapshot.number) for w in self._worlds_of(trigger)]

    def _worlds_of(self, trigger: Trigger, stamp: object = None) -> Sequence[World]:
        """Returns the worlds that a program reads; all worlds if unknown or none."""
        known, stamp = trigger.worlds, stamp or self._names.stamp
        if known.stamp is not stamp:
            worlds: list[World] | None = None
            with suppress(RecursionError):  # a list that contains itself
                worlds = self._names.worlds_of(trigger.program.tree.statements)
            known.worlds = list(dict.fromkeys(worlds or ()))
            is_fixed = are_fixed(self._names.bound_values(trigger.variables))
            known.stamp = stamp if is_fixed else None
        return known.worlds or self._names.worlds

    def _observe(self, trigger: Trigger) -> Sequence[World]:
        """Observes the worlds that a trigger reads, and all that it may come to read."""
        worlds = self._worlds_of(trigger)
        for world in (*worlds, *self._names.worlds):
            if world not in self._observed:
                world.follow(self)
                self._observed.add(world)
        return worlds
