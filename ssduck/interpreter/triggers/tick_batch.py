"""Decides which triggers are evaluated together at a tick, and what is new for each of them."""

from __future__ import annotations

import operator
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from ssduck.adapters.registry import Adapter
from ssduck.errors import SelectScriptError
from ssduck.interpreter.execution import Execution
from ssduck.interpreter.triggers.batch import FormulaBatches, Outcome
from ssduck.interpreter.triggers.formulas import Formula, FormulaPlanner
from ssduck.interpreter.triggers.table_state import TableState
from ssduck.interpreter.triggers.trigger import Trigger
from ssduck.language.tree import Query
from ssduck.language.value_keys import ATOMS
from ssduck.schema import TABLES
from ssduck.world.handles import Handle
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

    def begin(self, world: World, due: Collection[Trigger], stamp: object) -> TickBatch:
        """Returns the batch of the triggers that are due in a world at its tick."""
        return TickBatch(self, world, due, stamp)

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

    def outcomes(self, world: World, formulas: dict[Trigger, Formula]) -> dict[Formula, Outcome]:
        """Returns the rows of formulas at the tick of their world."""
        with self._execution.lock:
            if self._execution.is_running or not formulas:
                return {}
            return self._batches.outcomes(world, list(formulas.values()))


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
        self,
        batches: TriggerBatches,
        world: World,
        due: Collection[Trigger],
        stamp: object,
    ) -> None:
        self.is_doubtful = False
        self._batches = batches
        self._world = world
        self._due = due
        self._stamp = stamp
        self._formulas: dict[Trigger, Formula] | None = None
        self._outcomes: dict[Formula, Outcome] = {}

    def result(self, trigger: Trigger) -> BatchedResult | None:
        """Returns the result of a trigger; None if it has to be evaluated by itself."""
        if self._formulas is None:
            self._formulas = self._due_formulas()
            self._outcomes = self._evaluate()
        formula = self._formulas.get(trigger)
        outcome = None if formula is None else self._outcomes.get(formula)
        if formula is None or outcome is None or outcome.tick != self._world.snapshot.number:
            return None
        if self.is_doubtful and not self._batches.is_current(trigger, self._world):
            return None
        threshold = trigger.config.threshold
        if outcome.fingerprint == trigger.batched.fingerprint:
            return _UNCHANGED
        if threshold and self._batches.has_same_tables(trigger, [self._world]):
            return _UNCHANGED
        try:
            result = formula.value(outcome.rows(formula))
        except Exception:  # noqa: BLE001  # evaluated by itself, it raises the error with its place
            return None
        trigger.batched.fingerprint = outcome.fingerprint
        trigger.dependencies = None
        if threshold:
            self._batches.note_tables(trigger, ((), [(self._world, outcome.tick)]))
        return BatchedResult(is_new=True, value=result)

    def _due_formulas(self) -> dict[Trigger, Formula]:
        """Returns the formulas of the triggers that are due."""
        formulas = {}
        for trigger in self._due:
            formula = self._batches.formula(trigger, self._world, self._stamp)
            if formula is not None:
                formulas[trigger] = formula
        return formulas

    def _evaluate(self) -> dict[Formula, Outcome]:
        """Returns the rows of the formulas; none if they have to be evaluated one by one."""
        assert self._formulas is not None
        # Evaluated one by one, the triggers report what is wrong.
        with suppress(SelectScriptError):
            return self._batches.outcomes(self._world, self._formulas)
        return {}
