"""Triggers: programs that are evaluated as simulated time passes, and callbacks for what changes.

A trigger is *due* every `interval` seconds of simulated time, counted from when it was added, of
each world that its program is about. It then evaluates its program; where the result is another
one than its callback was last told of, it *fires*: the callback gets the result.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any, Protocol
from weakref import WeakSet

from ssduck import validation
from ssduck.errors import ArgumentError, UnknownNameError, nearest, warn
from ssduck.formatting import short_repr
from ssduck.interpreter.program import CompiledProgram
from ssduck.interpreter.triggers.conditions import TriggerConfig, When
from ssduck.interpreter.triggers.trigger import Trigger, TriggerState, TriggerWarning
from ssduck.language.tree import Node
from ssduck.language.value_keys import ATOMS
from ssduck.world.entities import Entity
from ssduck.world.world import World

# Seconds that closing waits for a callback that is running in a thread of its own.
PATIENCE = 5.0
_LIVE = World | Entity


class Evaluator(Protocol):
    """What triggers need of an interpreter."""

    @property
    def worlds(self) -> list[World]:
        """The worlds that are bound to variables, the first one first."""

    def compile(self, text: str) -> CompiledProgram:
        """A program that is parsed once and evaluated often."""

    def eval(self, program: CompiledProgram) -> Any:
        """The result of a program."""

    def variable(self, name: str) -> Any:
        """A variable's value."""

    def has_variable(self, name: str) -> bool:
        """Whether there is a variable of that name."""

    def meant(self, name: str) -> str:
        """What calls the function of that name: the user's, where it replaces another."""

    def is_users(self, name: str) -> bool:
        """Whether that calls a user's function."""

    def _worlds_of(self, nodes: Iterable[Node]) -> list[World] | None:
        """The worlds that parts may be about; None if their values alone tell."""


class TriggerMethods:
    """What an interpreter lets its users do with triggers."""

    _triggers: TriggerRegistry

    def add_trigger(
        self,
        name: str,
        program: str | CompiledProgram,
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
        terms = TriggerConfig(name, interval, when, debounce, rows, queue)
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


class TriggerRegistry:
    """The triggers of an interpreter; follows the worlds that they are about.

    Args:
        interpreter: what evaluates their programs.
    """

    def __init__(self, interpreter: Evaluator) -> None:
        self._interpreter = interpreter
        self._by_name: dict[str, Trigger] = {}
        self._lock = threading.Lock()
        self._followed: WeakSet[World] = WeakSet()

    def add(
        self,
        terms: TriggerConfig,
        program: str | CompiledProgram,
        callback: Callable[[Any], object],
    ) -> None:
        """Add one, and evaluate it for the first time; see `Interpreter.add_trigger`."""
        if isinstance(program, str):
            program = self._interpreter.compile(program)
        elif not hasattr(program, "tree"):
            raise ArgumentError(
                f"add_trigger: program: {short_repr(program)} is neither a text nor what compile "
                "gave"
            )
        validation.function(callback, "add_trigger: callback")
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
                f"there is no trigger {short_repr(name)}", suggestions=nearest(name, self._by_name)
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
                warn(
                    f"trigger {trigger.terms.name!r}: its callback is still running",
                    TriggerWarning,
                )

    # -- worlds (ssduck.world.observers.TickObserver) ----------------------------------------

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
        if names is None or any(room.is_users(room.meant(name)) for name in names):
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
