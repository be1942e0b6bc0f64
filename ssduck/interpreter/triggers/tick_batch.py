"""Decides which triggers are evaluated together at a tick, and what is new for each of them."""

from __future__ import annotations

import operator
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from typing import Any
from weakref import WeakKeyDictionary, WeakSet

import numpy as np

from ssduck.adapters.base import Adapter
from ssduck.columns.arrays import Array
from ssduck.columns.expressions import LeftToDuckDBError
from ssduck.errors import SelectScriptError
from ssduck.interpreter.execution import Execution
from ssduck.interpreter.triggers.formulas import FormulaPlanner, Meaning
from ssduck.interpreter.triggers.groups import Formula, FormulaGroup
from ssduck.interpreter.triggers.shapes import LiveShapes
from ssduck.interpreter.triggers.table_state import TIME_COLUMNS, TableState
from ssduck.interpreter.triggers.trigger import Trigger
from ssduck.language.tree import Query
from ssduck.schema import TABLES
from ssduck.world.snapshot import Snapshot
from ssduck.world.world import World


def are_same(before: Sequence[Any], now: Sequence[Any]) -> bool:
    """Checks whether two sequences of the same length have the same objects."""
    return all(map(operator.is_, before, now))


class _DueFormulas:
    """The formulas of the triggers that are due in a world, in groups of one shape.

    Args:
        key: what decided them; None to decide them anew at the next tick.
        world: the world.
        shapes: its narrow phase.
        by_trigger: the formulas of those triggers that have one.
        alone: the formulas that could not be evaluated with others at some tick.

    Attributes:
        standing: the triggers whose last results stand, as long as no row changes; None if unknown.
    """

    def __init__(
        self,
        key: tuple[Any, ...],
        world: World,
        shapes: LiveShapes,
        by_trigger: dict[Trigger, Formula],
        alone: WeakSet[Formula],
    ) -> None:
        self.key: tuple[Any, ...] | None = key
        self.by_trigger = by_trigger
        self.standing: frozenset[Trigger] | None = None
        self._world, self._shapes, self._alone = world, shapes, alone
        self._layout = world.snapshot.layout
        formulas = by_trigger.values()
        self._tables = frozenset().union(*(formula.tables for formula in formulas))
        # The columns that move; the others are replaced with their table.
        read = frozenset().union(*(formula.columns for formula in formulas))
        doubles = world.snapshot.table("entities").names_of_doubles
        self._columns = [name for name in doubles if name in read.difference(TIME_COLUMNS)]
        by_shape: dict[Any, list[Formula]] = {}
        for formula in formulas:
            own = formula if formula in alone else formula.shape
            by_shape.setdefault(own, []).append(formula)
        # The version of the table, the motion of the shapes, and the numbers at the last tick.
        self._last: tuple[int, int, Array] | None = None
        self._groups = [
            FormulaGroup(formulas, world.snapshot, shapes) for formulas in by_shape.values()
        ]

    def evaluate(self) -> None:
        """Evaluates the formulas at the tick of their world, as far as they can be together."""
        standing, self.standing = self.standing, None
        self._world.pin(self._tables, is_settled=False)
        try:
            snapshot = self._world.snapshot
            # A tick that was taken just now may have other entities.
            is_same = snapshot.layout is self._layout
            if not (is_same and snapshot.table("entities").is_complete):
                return  # numpy would take an unknown number for NaN
            has_moved = self._have_moved(snapshot)
            for group in self._groups:
                try:
                    has_changed = group.evaluate(snapshot, has_moved=has_moved)
                except LeftToDuckDBError:
                    has_changed = True
                    self._evaluate_singly(group, snapshot)
                standing = None if has_changed else standing
        finally:
            self._world.unpin()
        self.standing = standing

    def _have_moved(self, snapshot: Snapshot) -> bool:
        """Checks whether a number or a shape is another one than at the tick before."""
        table = snapshot.table("entities")
        moves = self._shapes.begin(snapshot) if "shapes" in self._tables else 0
        numbers = np.array([table[name] for name in self._columns]).view(np.int64)
        last, self._last = self._last, (table.version, moves, numbers)
        is_same = last is not None and last[:2] == self._last[:2]
        return last is None or not is_same or not np.array_equal(last[2], numbers)

    def _evaluate_singly(self, group: FormulaGroup, snapshot: Snapshot) -> None:
        """Evaluates each formula of a group; the next one has none that cannot be."""
        if len(group.formulas) == 1:
            return
        self.key = None
        for formula in group.formulas:
            try:
                FormulaGroup([formula], snapshot, self._shapes).evaluate(snapshot, has_moved=True)
            except LeftToDuckDBError:
                self._alone.add(formula)


class TriggerBatches:
    """Evaluates triggers together.

    Args:
        execution: runs programs.
        query_of: returns the query to run for a query and its result form.
    """

    def __init__(self, execution: Execution, query_of: Callable[[Query, Adapter], Query]) -> None:
        self._execution = execution
        self._planner = FormulaPlanner(execution, query_of)
        self._generation = 0
        self._shapes: WeakKeyDictionary[World, LiveShapes] = WeakKeyDictionary()
        self._last_due: WeakKeyDictionary[World, _DueFormulas] = WeakKeyDictionary()
        self._alone: WeakSet[Formula] = WeakSet()

    def begin(self, world: World, due: tuple[Trigger, ...], stamp: object) -> TickBatch:
        """Returns the batch of the triggers that are due in a world at its tick."""
        last, key = self._last_due.get(world), (stamp, world.snapshot.layout, self._generation)
        is_same = last is not None and last.key is not None and are_same(last.key[1:], key)
        if last is None or not is_same or last.key is None or last.key[0] != due:
            by_trigger = {
                trigger: trigger.meaning.formula
                for trigger in due
                if self.is_current(trigger, world, stamp)
                and trigger.meaning is not None
                and trigger.meaning.formula is not None
                and trigger.meaning.formula.world is world
            }
            shapes = self._shapes.setdefault(world, LiveShapes())
            last = _DueFormulas((due, *key), world, shapes, by_trigger, self._alone)
            self._last_due[world] = last
        return TickBatch(self, world, last)

    def note_key(self, trigger: Trigger, key: tuple[Any, ...] | None) -> bool:
        """Notes what decided the meaning of a program that was evaluated by itself.

        Returns:
            Whether it is the same as at the evaluation before.
        """
        before = trigger.meaning
        if key is not None and before is not None and are_same(before.key, key):
            before.fingerprint = before.state = None
            return True
        if key is not None or before is not None:
            self.forget(trigger)
        if key is not None:
            trigger.meaning = Meaning(self._planner, trigger.program, trigger.names, key)
        return False

    def forget(self, trigger: Trigger) -> None:
        """Forgets what a program means."""
        trigger.meaning = None
        self._generation += 1

    def release_worlds(self) -> None:
        """Drops what refers to worlds."""
        with self._execution.lock:
            self._last_due.clear()
            self._shapes.clear()

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

    def is_current(self, trigger: Trigger, world: World, stamp: object = None) -> bool:
        """Checks whether a program has the meaning with which it was last evaluated by itself."""
        meaning, stamp = trigger.meaning, stamp or self._execution.stamp
        if meaning is None or meaning.key[0] is not world.snapshot.layout:
            return False
        if meaning.stamp is not stamp:
            key = self.key(trigger, [world])
            if key is None or not are_same(meaning.key, key):
                return False
            meaning.stamp = stamp
        return True

    def note_tables(self, trigger: Trigger, dependencies: Any) -> None:
        """Notes the numbers on which the result of a trigger depends, after its evaluation.

        Args:
            trigger: the trigger.
            dependencies: the variables and ticks on which the result depends.
        """
        meaning = trigger.meaning
        if meaning is None:
            return
        meaning.state = None
        if dependencies is None:
            return
        ((world, tick),) = dependencies[1]
        names = TABLES.keys() & (meaning.tables or ())
        with world.lock:
            snapshot = world.snapshot
            is_read = all(name == "entities" or snapshot.has(name) for name in names)
            is_same = snapshot.layout is meaning.key[0] and snapshot.number == tick
            if names and is_read and is_same:
                meaning.state = TableState(snapshot, names)

    def has_same_tables(self, trigger: Trigger, worlds: Sequence[World]) -> bool:
        """Checks whether no number has changed by more than the threshold since the last result."""
        meaning = trigger.meaning
        if meaning is None or meaning.state is None or len(worlds) != 1:
            return False
        (world,) = worlds
        if not self.is_current(trigger, world):
            return False
        with suppress(SelectScriptError), world.pinned(meaning.tables or frozenset()):
            return meaning.state.is_same(world.snapshot, trigger.config.threshold)
        return False  # evaluated, it raises the error

    def evaluate(self, due: _DueFormulas) -> None:
        """Evaluates formulas at the tick of their world; see `_DueFormulas.evaluate`."""
        # Evaluated one by one, the triggers report what is wrong.
        with self._execution.lock, suppress(SelectScriptError), np.errstate(all="ignore"):
            if self._execution.is_running or not due.by_trigger:
                due.standing = None
            else:
                due.evaluate()


class TickBatch:
    """The triggers that are due in a world at a tick, evaluated together when the first one is.

    Args:
        batches: evaluates them.
        world: the world.
        due: their formulas.

    Attributes:
        is_doubtful: whether variables, functions and worlds may have changed meanwhile.
    """

    def __init__(self, batches: TriggerBatches, world: World, due: _DueFormulas) -> None:
        self.is_doubtful = False
        self._batches, self._world, self._due = batches, world, due
        self._tick = 0

    def unchanged(self) -> Collection[Trigger]:
        """Returns the triggers whose last results stand, and have been dealt with.

        That is so until a program or a callback makes the batch doubtful.
        """
        self._evaluate()
        due = self._due
        if due.standing is None:
            due.standing = frozenset(
                trigger
                for trigger, formula in due.by_trigger.items()
                if trigger.stands(formula.version) and formula.is_evaluated_at(self._tick)
            )
        return due.standing

    def result(self, trigger: Trigger) -> tuple[Any] | None:
        """Returns the result of a trigger, in a tuple; None if it has to be evaluated by itself."""
        self._evaluate()
        self._due.standing = None
        formula, meaning = self._due.by_trigger.get(trigger), trigger.meaning
        number = self._world.snapshot.number
        if formula is None or meaning is None or not formula.is_evaluated_at(number):
            return None
        if self.is_doubtful and not self._batches.is_current(trigger, self._world):
            return None
        is_unchanged = formula.version == meaning.fingerprint
        threshold = trigger.config.threshold
        if is_unchanged or (threshold and self._batches.has_same_tables(trigger, [self._world])):
            return (trigger.result,)
        try:
            result = formula.value()
        except Exception:  # noqa: BLE001  # evaluated by itself, it raises the error with its place
            return None
        meaning.fingerprint = formula.version
        trigger.dependencies = None
        if threshold:
            self._batches.note_tables(trigger, ((), [(self._world, number)]))
        return (result,)

    def _evaluate(self) -> None:
        """Evaluates the formulas, unless they have been."""
        if not self._tick:
            self._tick = self._world.snapshot.number
            self._batches.evaluate(self._due)
            self._tick = self._world.snapshot.number
