"""Decides which triggers are evaluated together at a tick, and what is new for each of them."""

from __future__ import annotations

import operator
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

from ssduck.adapters.registry import Adapter
from ssduck.errors import SelectScriptError
from ssduck.interpreter.execution import Execution
from ssduck.interpreter.triggers.batch import FormulaBatches
from ssduck.interpreter.triggers.formulas import Formula, FormulaPlanner
from ssduck.interpreter.triggers.table_state import TableState
from ssduck.interpreter.triggers.trigger import Batched, Trigger
from ssduck.language.tree import Query
from ssduck.language.value_keys import ATOMS
from ssduck.schema import TABLES
from ssduck.world.handles import Handle
from ssduck.world.layout import TableLayout
from ssduck.world.world import World


@dataclass(frozen=True)
class BatchedResult:
    """The result of a trigger that was evaluated together with others.

    Attributes:
        is_new: whether it may differ from the last one.
        value: the result; None if it is the last one.
    """

    is_new: bool
    value: Any = None


_UNCHANGED = BatchedResult(is_new=False)


def are_same(before: Sequence[Any], now: Sequence[Any]) -> bool:
    """Checks whether two sequences of the same length have the same objects."""
    return all(map(operator.is_, before, now))


def are_fixed(values: Sequence[Any]) -> bool:
    """Checks whether no value can change without being replaced."""
    return all(
        type(value) in ATOMS or type(value) is object or isinstance(value, World | Handle)
        for value in values
    )


# The names that read what differs from tick to tick though nothing moves.
_TIME_NAMES = frozenset(("tick", "time"))


@dataclass(frozen=True, eq=False)
class _DueFormulas:
    """The formulas of the triggers that are due at a tick.

    Attributes:
        due: the triggers.
        stamp: the stamp of the names.
        layout: the entities of the world.
        generation: the number of changes of what triggers mean.
        by_trigger: the formulas of those triggers that have one.
        formulas: the formulas.
    """

    due: tuple[Trigger, ...]
    stamp: object
    layout: TableLayout
    generation: int
    by_trigger: Mapping[Trigger, Formula]
    formulas: tuple[Formula, ...]


class TriggerBatches:
    """Evaluates triggers together.

    Args:
        execution: runs programs.
        query_of: returns the query to run for a query and its result form.
    """

    def __init__(self, execution: Execution, query_of: Callable[[Query, Adapter], Query]) -> None:
        self._execution = execution
        self._planner = FormulaPlanner(execution, query_of)
        self._batches = FormulaBatches(execution)
        self._generation = 0
        self._last_due: WeakKeyDictionary[World, _DueFormulas] = WeakKeyDictionary()

    def begin(self, world: World, due: tuple[Trigger, ...], stamp: object) -> TickBatch:
        """Returns the batch of the triggers that are due in a world at its tick."""
        return TickBatch(self, world, due, stamp)

    def note_key(self, trigger: Trigger, key: tuple[Any, ...] | None) -> bool:
        """Notes what decided the meaning of a program that was evaluated by itself.

        Returns:
            Whether it is the same as at the evaluation before.
        """
        batched = trigger.batched
        batched.fingerprint = batched.state = None
        before = batched.key
        if key is not None and before is not None and are_same(before, key):
            return True
        if key is not before:
            batched.key = key
            self._generation += 1
        return False

    def forget(self, trigger: Trigger) -> None:
        """Forgets what a program means."""
        trigger.batched = Batched()
        self._generation += 1

    def release_worlds(self) -> None:
        """Drops what refers to worlds."""
        with self._execution.lock:
            self._last_due.clear()
            self._batches.release_worlds()

    def formulas(self, world: World, due: tuple[Trigger, ...], stamp: object) -> _DueFormulas:
        """Returns the formulas of the triggers that are due; the same ones while they are."""
        last, layout = self._last_due.get(world), world.snapshot.layout
        if (
            last is None
            or last.stamp is not stamp
            or last.layout is not layout
            or last.generation != self._generation
            or last.due != due
        ):
            by_trigger = {
                trigger: formula
                for trigger in due
                if (formula := self.formula(trigger, world, stamp)) is not None
            }
            formulas = tuple(by_trigger.values())
            if last is not None and last.formulas == formulas:
                formulas = last.formulas
            last = _DueFormulas(due, stamp, layout, self._generation, by_trigger, formulas)
            self._last_due[world] = last
        return last

    def key(self, trigger: Trigger, worlds: Sequence[World]) -> tuple[Any, ...] | None:
        """Returns what decides the meaning of a program; None if it is evaluated by itself.

        It holds while it has the same objects: the entities of the world, the functions, and the
        variables that the program reads.

        Args:
            trigger: the trigger.
            worlds: the worlds that its program reads.
        """
        if trigger.reads is None or len(worlds) != 1:
            return None
        names = self._execution
        values = names.bound_values(trigger.names)
        return (worlds[0].snapshot.layout, *names.meaning, *values)

    def formula(self, trigger: Trigger, world: World, stamp: object) -> Formula | None:
        """Returns the formula of a trigger that was evaluated by itself with the same meaning."""
        if not self.is_current(trigger, world, stamp):
            return None
        batched = trigger.batched
        if batched.formula_key is not batched.key:
            batched.formula_key = batched.key
            batched.formula = self._formula(trigger)
        formula = batched.formula
        return formula if formula is not None and formula.world is world else None

    def is_current(self, trigger: Trigger, world: World, stamp: object = None) -> bool:
        """Checks whether a program has the meaning with which it was last evaluated by itself."""
        batched, stamp = trigger.batched, stamp or self._execution.stamp
        if batched.key is None or batched.key[0] is not world.snapshot.layout:
            return False
        if batched.stamp is not stamp:
            key = self.key(trigger, [world])
            if key is None or not are_same(batched.key, key):
                return False
            batched.stamp = stamp
        return True

    def note_tables(self, trigger: Trigger, dependencies: Any) -> None:
        """Notes the numbers on which the result of a trigger depends, after its evaluation.

        Args:
            trigger: the trigger.
            dependencies: the variables and ticks on which the result depends.
        """
        batched = trigger.batched
        batched.state = None
        if batched.key is None or dependencies is None:
            return
        ((world, tick),) = dependencies[1]
        if batched.tables_key is not batched.key:
            batched.tables_key = batched.key
            batched.tables = None
            if self._is_known(trigger) and not _TIME_NAMES.intersection(trigger.names):
                batched.tables = self._planner.tables(trigger.program)
        with world.lock:
            snapshot = world.snapshot
            names = TABLES.keys() & (batched.tables or ())
            is_read = all(name == "entities" or snapshot.has(name) for name in names)
            is_same = snapshot.layout is batched.key[0] and snapshot.number == tick
            if names and is_read and is_same:
                batched.state = TableState(snapshot, names)

    def has_same_tables(self, trigger: Trigger, worlds: Sequence[World]) -> bool:
        """Checks whether no number has changed by more than the threshold since the last result."""
        state, tables = trigger.batched.state, trigger.batched.tables
        if state is None or tables is None or len(worlds) != 1:
            return False
        (world,) = worlds
        if not self.is_current(trigger, world):
            return False
        with suppress(SelectScriptError), world.pinned(tables):  # evaluated, it raises the error
            return state.is_same(world.snapshot, trigger.config.threshold)
        return False

    def _is_known(self, trigger: Trigger) -> bool:
        """Checks whether only variables of fixed values and the language's functions are read."""
        names, values = self._execution, trigger.batched.key
        assert values is not None
        is_users = any(names.is_users(names.resolved_name(name)) for name in trigger.names)
        return are_fixed(values[1:]) and not is_users

    def _formula(self, trigger: Trigger) -> Formula | None:
        """Returns the formula of a trigger; None if it is none."""
        return self._planner.formula(trigger.program) if self._is_known(trigger) else None

    def evaluate(self, world: World, due: _DueFormulas) -> int | None:
        """Evaluates formulas at the tick of their world; see `FormulaBatches.evaluate`."""
        with self._execution.lock:
            if self._execution.is_running or not due.formulas:
                return None
            return self._batches.evaluate(world, due.layout, due.formulas)


class TickBatch:
    """The triggers that are due in a world at a tick, evaluated together when the first one is.

    Args:
        batches: evaluates them.
        world: the world.
        due: the triggers.
        stamp: the stamp of the names.

    Attributes:
        is_doubtful: whether variables, functions and worlds may have changed meanwhile.
    """

    def __init__(
        self, batches: TriggerBatches, world: World, due: tuple[Trigger, ...], stamp: object
    ) -> None:
        self.is_doubtful = False
        self._batches = batches
        self._world = world
        self._due = batches.formulas(world, due, stamp)
        self._tick = 0
        self._changes: int | None = None

    @property
    def state(self) -> tuple[object, int] | None:
        """A value that is equal at two ticks only if no result differs; None if not known."""
        self._evaluate()
        is_whole = self._changes is not None and len(self._due.formulas) == len(self._due.due)
        return (self._due, self._changes or 0) if is_whole else None

    def unchanged(self) -> Collection[Trigger]:
        """Returns the triggers whose last results stand, and have been dealt with.

        That is so until a program or a callback makes the batch doubtful.
        """
        self._evaluate()
        tick, by_trigger = self._tick, self._due.by_trigger
        return {
            trigger
            for trigger, formula in by_trigger.items()
            if trigger.stands(formula.version) and formula.is_evaluated_at(tick)
        }

    def result(self, trigger: Trigger) -> BatchedResult | None:
        """Returns the result of a trigger; None if it has to be evaluated by itself."""
        self._evaluate()
        formula = self._due.by_trigger.get(trigger)
        number = self._world.snapshot.number
        if formula is None or not formula.is_evaluated_at(number):
            return None
        if self.is_doubtful and not self._batches.is_current(trigger, self._world):
            return None
        threshold = trigger.config.threshold
        if formula.version == trigger.batched.fingerprint:
            return _UNCHANGED
        if threshold and self._batches.has_same_tables(trigger, [self._world]):
            return _UNCHANGED
        try:
            result = formula.value(formula.rows())
        except Exception:  # noqa: BLE001  # evaluated by itself, it raises the error with its place
            return None
        trigger.batched.fingerprint = formula.version
        trigger.dependencies = None
        if threshold:
            self._batches.note_tables(trigger, ((), [(self._world, number)]))
        return BatchedResult(is_new=True, value=result)

    def _evaluate(self) -> None:
        """Evaluates the formulas, unless they have been."""
        if self._tick:
            return
        self._tick = self._world.snapshot.number
        # Evaluated one by one, the triggers report what is wrong.
        with suppress(SelectScriptError):
            self._changes = self._batches.evaluate(self._world, self._due)
            self._tick = self._world.snapshot.number
