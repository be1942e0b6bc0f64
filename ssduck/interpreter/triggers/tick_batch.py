"""Decides which triggers are evaluated together at a tick, and what is new for each of them."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from ssduck.adapters.base import Adapter
from ssduck.columns.compiler import LeftToDuckDBError
from ssduck.errors import SelectScriptError
from ssduck.interpreter.execution import Execution
from ssduck.interpreter.triggers.formulas import (
    TIME_COLUMNS,
    Formula,
    FormulaGroup,
    Meaning,
    TableState,
)
from ssduck.interpreter.triggers.shapes import LiveShapes
from ssduck.interpreter.triggers.trigger import Trigger
from ssduck.language import ast
from ssduck.schema import TABLES
from ssduck.world.snapshot import Snapshot
from ssduck.world.world import World


def are_same(before: Sequence[Any], now: Sequence[Any]) -> bool:
    """Checks whether two sequences of the same length have the same objects."""
    return all(map(operator.is_, before, now))


class _DueFormulas:
    """The formulas of the triggers that are due in a world, in groups of one shape."""

    def __init__(
        self,
        key: tuple[Any, ...],
        world: World,
        shapes: LiveShapes,
        by_trigger: dict[Trigger, Formula],
    ) -> None:
        self.key, self.by_trigger = key, by_trigger
        self._world, self._shapes = world, shapes
        self._layout = world.snapshot.layout
        formulas = by_trigger.values()
        self._tables = frozenset().union(*(formula.tables for formula in formulas))
        # The columns that move; the others are replaced with their table.
        read = frozenset().union(*(formula.columns for formula in formulas))
        doubles = world.snapshot.table("entities").names_of_doubles
        self._columns = [name for name in doubles if name in read.difference(TIME_COLUMNS)]
        by_shape: dict[Any, list[Formula]] = {}
        for formula in formulas:
            by_shape.setdefault(formula.shape, []).append(formula)
        self._last: list[Any] = []
        # The triggers whose last results still hold; None if that is to be found out.
        self.standing: frozenset[Trigger] | None = None
        self._groups = [
            FormulaGroup(formulas, world.snapshot, self._shapes) for formulas in by_shape.values()
        ]

    def evaluate(self) -> None:
        """Evaluates the formulas at the tick of their world, as far as they can be together."""
        standing, self.standing = self.standing, None
        self._world.ticker.pin(self._tables, is_settled=False)
        try:
            snapshot = self._world.snapshot
            # A tick that was taken just now may have other entities.
            is_same = snapshot.layout is self._layout
            if not (is_same and snapshot.table("entities").is_complete):
                return  # numpy would take an unknown number for NaN
            before, self._last = self._last, self._numbers(snapshot)
            has_moved = before != self._last
            for group in list(self._groups):
                try:
                    if group.evaluate(snapshot, has_moved=has_moved):
                        standing = None
                except LeftToDuckDBError:
                    standing = None
                    if len(group.formulas) > 1:
                        self._split(group, snapshot)
            self.standing = standing
        finally:
            self._world.ticker.unpin()

    def _numbers(self, snapshot: Snapshot) -> list[Any]:
        """Returns what differs if a number that is read, or a shape, is another one."""
        table = snapshot.table("entities")
        numbers = [table.version, *(table[name].tobytes() for name in self._columns)]
        return [*numbers, self._shapes.begin(snapshot)] if "shapes" in self._tables else numbers

    def _split(self, group: FormulaGroup, snapshot: Snapshot) -> None:
        """Evaluates each formula of a group by itself, as one of them cannot be with others."""
        self._groups.remove(group)
        for formula in group.formulas:
            alone = FormulaGroup([formula], snapshot, self._shapes)
            self._groups.append(alone)
            with suppress(LeftToDuckDBError):
                alone.evaluate(snapshot, has_moved=True)


class TriggerBatches:
    """Evaluates triggers together.

    Args:
        query_of: returns the query to run for a query and its result form; None if each trigger is
            evaluated by itself.
    """

    def __init__(
        self, execution: Execution, query_of: Callable[[ast.Query, Adapter], ast.Query] | None
    ) -> None:
        self._execution, self._query_of = execution, query_of
        self._generation = 0
        self._shapes: WeakKeyDictionary[World, LiveShapes] = WeakKeyDictionary()
        self._last_due: WeakKeyDictionary[World, _DueFormulas] = WeakKeyDictionary()

    def begin(self, world: World, due: tuple[Trigger, ...], stamp: object) -> TickBatch:
        """Evaluates the formulas of the triggers that are due in a world at its tick."""
        key = due, stamp, world.snapshot.layout, self._generation
        last = self._last_due.get(world)
        if last is None or last.key[0] != due or not are_same(last.key[1:], key[1:]):
            by_trigger = {
                trigger: trigger.meaning.formula
                for trigger in due
                if self.is_current(trigger, world, stamp)
                and trigger.meaning is not None
                and trigger.meaning.formula is not None
                and trigger.meaning.formula.world is world
            }
            shapes = self._shapes.setdefault(world, LiveShapes())
            last = self._last_due[world] = _DueFormulas(key, world, shapes, by_trigger)
        # Evaluated one by one, the triggers report what is wrong.
        with self._execution.lock, suppress(SelectScriptError), np.errstate(all="ignore"):
            if last.by_trigger and not self._execution.is_running:
                last.evaluate()
        return TickBatch(self, world, last)

    def note(
        self,
        trigger: Trigger,
        worlds: Sequence[World],
        key: tuple[Any, ...] | None,
        ticks: Sequence[int],
    ) -> None:
        """Notes what decided the result of a trigger that was evaluated at ticks, by itself."""
        before = trigger.meaning
        is_settled = key is not None and before is not None and are_same(before.key, key)
        if is_settled and before is not None:
            before.rows = before.state = None
        elif key is not None or before is not None:
            self.forget(trigger)
        if key is not None and not is_settled and self._query_of is not None:
            of_program = trigger.program, trigger.names, key
            trigger.meaning = Meaning(self._execution, self._query_of, *of_program)
        # What changes at each evaluation is not worth the search for its tables.
        if trigger.meaning is not None and (is_settled or trigger.config.threshold):
            self.note_tables(trigger, worlds[0], ticks[0])

    def forget(self, trigger: Trigger) -> None:
        """Forgets what a program means."""
        trigger.meaning = None
        self.regroup()

    def regroup(self) -> None:
        """Groups the formulas anew at the next tick."""
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
        """
        if trigger.reads is None or len(worlds) != 1 or self._query_of is None:
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

    def note_tables(self, trigger: Trigger, world: World, tick: int) -> None:
        """Notes the numbers on which the result of a trigger at a tick depends."""
        meaning = trigger.meaning
        if meaning is None:
            return
        meaning.state = None
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


class TickBatch:
    """The triggers that are due in a world at a tick, whose formulas were evaluated together."""

    def __init__(self, batches: TriggerBatches, world: World, due: _DueFormulas) -> None:
        # Whether variables, functions and worlds may have changed meanwhile.
        self.is_doubtful = False
        self._batches, self._world, self._due = batches, world, due
        if due.standing is None:
            number = world.snapshot.number
            due.standing = frozenset(
                trigger
                for trigger, formula in due.by_trigger.items()
                if formula.is_evaluated_at(number) and trigger.stands(formula.key)
            )
        # The triggers of which another evaluation would change nothing.
        self.standing = due.standing

    def doubt(self) -> None:
        """Notes that a program or a callback ran, which may have changed anything."""
        self.is_doubtful, self.standing = True, frozenset()
        self._due.standing = None

    def result(self, trigger: Trigger) -> tuple[Any] | None:
        """Returns the result of a trigger, in a tuple; None if it has to be evaluated by itself."""
        self._due.standing = None
        formula, meaning = self._due.by_trigger.get(trigger), trigger.meaning
        number = self._world.snapshot.number
        if formula is None or meaning is None or not formula.is_evaluated_at(number):
            return None
        if self.is_doubtful and not self._batches.is_current(trigger, self._world):
            return None
        rows, threshold = formula.key, trigger.config.threshold
        is_unchanged = rows == meaning.rows
        if is_unchanged or (threshold and self._batches.has_same_tables(trigger, [self._world])):
            return (trigger.result,)
        try:
            result = formula.value()
        except Exception:  # noqa: BLE001  # evaluated by itself, it raises the error with its place
            return None
        meaning.rows = rows
        trigger.dependencies = None
        if threshold:
            self._batches.note_tables(trigger, self._world, number)
        return (result,)
