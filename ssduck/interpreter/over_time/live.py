"""Functions of time of a simulation that goes on: each tick adds its value to what was before.

A condition of an environment that asks `heldFor(…)` at each step would read all ticks of the
episode anew. Here, a call keeps the *state* of its fold over the ticks until now, and the value at
the next tick is computed as a SELECT of one row. Whenever anything but the next tick is new, such
as a variable, a body or the first recorded tick, the state is made anew from the record.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

from ssduck.errors import SelectScriptError
from ssduck.interpreter.over_time.functions import Fold, TemporalFunction, parts_of
from ssduck.interpreter.over_time.series import TickSeries
from ssduck.interpreter.over_time.unrecorded import (
    UnrecordedFolds,
    copied,
    meaning_of,
    names_in,
    select_of,
)
from ssduck.interpreter.planner import Planner
from ssduck.language.analysis import free_aliases
from ssduck.language.builtins import BUILTINS
from ssduck.language.clauses import formed
from ssduck.language.evaluator import EvaluationScope, Frame
from ssduck.language.tree import Call, Node, Query, TimeIndex
from ssduck.schema import MASSES
from ssduck.sql.relations.registry import RELATIONS
from ssduck.world.handles import Handle
from ssduck.world.layout import TableLayout
from ssduck.world.world import World


@dataclass
class _Kept:
    """The state of a fold over the ticks until one.

    Attributes:
        query: the SELECT that has the value of the expression at the present tick.
        names: the variables of the expression.
        meaning: the values of its variables.
        layout: the entities of the world.
        series: the ticks.
        run: the number of the world's run.
        first: the number of the first recorded tick.
        tick: the number of the last one that is in the state.
        time: its time, s.
        state: the state.
    """

    query: Query
    names: tuple[str, ...]
    meaning: tuple[Any, ...]
    layout: TableLayout
    series: TickSeries
    run: int
    first: int
    tick: int
    time: float
    state: Any


class LiveFolds:
    """The states of calls of functions of time.

    Args:
        scope: the variables.
        planner: runs queries.
        tables_read: returns the data that an expression reads.
        is_recorded: checks whether a world is recorded.
    """

    def __init__(
        self,
        scope: EvaluationScope,
        planner: Planner,
        tables_read: Callable[[Node], frozenset[str]],
        is_recorded: Callable[[World], bool],
    ) -> None:
        self._scope, self._planner, self._tables_read = scope, planner, tables_read
        self._is_recorded = is_recorded
        self._unrecorded = UnrecordedFolds(scope, planner)
        self._kept: WeakKeyDictionary[Call, _Kept] = planner.states
        # Whether the expression of a call is the same at the present tick and in the record.
        self._are_simple: WeakKeyDictionary[Call, bool] = WeakKeyDictionary()

    def takes(self, call: Call, frame: Frame) -> bool:
        """Checks whether the state of a call can be kept: it depends on no row around it."""
        if frame.local or frame.placeholders or any(map(_is_row, frame.elements.values())):
            return False
        if call not in self._are_simple:
            self._are_simple[call] = not free_aliases(call) and self._is_simple(parts_of(call)[0])
        return self._are_simple[call]

    def misses(self, call: Call) -> bool:
        """Checks whether the present tick would be lost to a call: its world is not recorded."""
        world = self._unrecorded_world(call)
        return world is not None and self._unrecorded.misses(call, world)

    def need_no_tables(self, call: Call) -> bool:
        """Checks whether the value of a call needs no table that DuckDB reads."""
        return self._unrecorded_world(call) is not None and self._unrecorded.is_planned(call)

    def _unrecorded_world(self, call: Call) -> World | None:
        """Returns the only world of a call, if it was not recorded where its episode began."""
        world = self._unrecorded.world_of(call)
        if world is None or not self._is_recorded(world) or self._unrecorded.goes_on(call, world):
            return world
        return None

    def value(self, call: Call, form: TemporalFunction, series_of: Callable[[], TickSeries]) -> Any:
        """Returns the value of a call at the present tick; the caller pins the worlds.

        Args:
            call: a call that it takes.
            form: its function, which is a fold.
            series_of: a function that returns the ticks of its expression.
        """
        fold = form.fold
        assert fold is not None
        kept = self._kept.pop(call, None)  # so that Ctrl-C leaves no state of half a step
        if kept is None or not self._is_next(kept, fold):
            world = self._unrecorded_world(call)
            if world is not None:
                return self._unrecorded.value(call, world)
            series = series_of()
            kept = self._made(call, series, fold)
            if kept is None:
                return form.make(series, None)
        self._kept[call] = kept
        return copied(fold.value(kept.state, kept.time))

    def _is_next(self, kept: _Kept, fold: Fold) -> bool:
        """Adds the present tick to a state, unless it has it; returns whether that is all."""
        snapshot = kept.series.record.world.snapshot
        if (
            kept.run != snapshot.run
            or kept.layout is not snapshot.layout
            or kept.meaning != meaning_of(self._scope, kept.names)
        ):
            return False
        numbers, times = kept.series.ticks()
        if not len(numbers) or numbers[0] != kept.first or numbers[-1] != snapshot.number:
            return False
        if numbers[-1] == kept.tick:
            return True
        time = float(times[-1])
        if len(numbers) < 2 or numbers[-2] != kept.tick or time <= kept.time:
            return False
        try:
            selected = self._planner.run(kept.query, Frame(self._scope), lambda _: None)
            ((value,),) = formed(selected, lambda rows: rows.values)
            if fold.is_of_condition:
                value = kept.series.is_true(value)
            kept.state = fold.step(kept.state, time, value)
        except SelectScriptError:
            return False  # made from the record, it raises the error if there is one
        kept.tick, kept.time = int(numbers[-1]), time
        return True

    def _made(self, call: Call, series: TickSeries, fold: Fold) -> _Kept | None:
        """Returns a state to keep.

        Returns:
            None if the present tick is not recorded, or not all of it, or if a variable is of a
            type that may change.
        """
        recording, snapshot = series.record.recording, series.record.world.snapshot
        if recording is not None and recording.entities is not None:
            return None
        numbers, times = series.ticks()
        expression, _ = parts_of(call)
        names = names_in(expression)
        meaning = meaning_of(self._scope, names)
        if meaning is None or not len(numbers) or numbers[-1] != snapshot.number:
            return None
        return _Kept(
            select_of(expression),
            names,
            meaning,
            snapshot.layout,
            series,
            snapshot.run,
            int(numbers[0]),
            int(numbers[-1]),
            float(times[-1]),
            fold.begin(series),
        )

    def _is_simple(self, expression: Node) -> bool:
        """Checks whether an expression has the same value at the present tick and in the record.

        Masses are recorded once, and functions of users may give another value each time.
        """
        for node in expression.walk():
            if isinstance(node, TimeIndex | Query):
                return False
            if isinstance(node, Call) and node.name not in RELATIONS and node.name not in BUILTINS:
                return False
        return MASSES not in self._tables_read(expression)


def _is_row(element: Any) -> bool:
    return isinstance(element, Handle)
