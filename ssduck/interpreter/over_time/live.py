"""Functions of time of a simulation that goes on: each tick adds its value to what was before.

A condition of an environment that asks `heldFor(…)` at each step would read all ticks of the
episode anew. Here, a call keeps the *state* of its fold over the ticks until now, and the value at
the next tick is computed as a SELECT of one row.

The state of a recorded world is made from the record, anew whenever anything but the next tick is
new, such as a variable, a body or the first recorded tick. That of a world that is not recorded
begins at the first tick of an episode, and needs each tick: a tick that was missed is an error.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any
from weakref import ReferenceType, WeakKeyDictionary, ref

from ssduck.errors import (
    ArgumentError,
    EvaluationError,
    LimitError,
    RemovedEntityError,
    SelectScriptError,
    UnknownNameError,
)
from ssduck.interpreter.over_time.functions import (
    TEMPORAL_FUNCTIONS,
    Fold,
    expressions_of,
    is_fold,
)
from ssduck.interpreter.over_time.series import TickSeries, is_true
from ssduck.interpreter.planner import Planner
from ssduck.language import ast
from ssduck.language.analysis import free_aliases
from ssduck.language.builtins import BUILTINS
from ssduck.language.clauses import formed
from ssduck.language.evaluator import EvaluationScope, Frame
from ssduck.language.value_keys import ATOMS, node_key
from ssduck.recording.replay.record import Record
from ssduck.recording.replay.replayed_world import ReplayedWorld
from ssduck.recording.spec import no_ticks_message
from ssduck.schema import MASSES
from ssduck.simulators.kinematics import JointError
from ssduck.sql.relations.registry import RELATIONS
from ssduck.world.handles import Handle
from ssduck.world.layout import TableLayout
from ssduck.world.world import World

# Of more states, those that cannot go on are dropped.
_MANY = 256


@dataclass(frozen=True, eq=False)
class _Origin:
    """The recorded ticks that a state was made from."""

    first: int  # the number of the first one
    layout: ReferenceType[TableLayout]  # the entities of the world
    plans: object  # the planner's generation; another one has functions that mean something else


@dataclass(frozen=True, eq=False)
class _Folded:
    """The state of a fold at the last tick that was added."""

    run: int  # the number of the world's run
    meaning: tuple[Any, ...]  # the values of the variables in its expression
    tick: int  # the number of the tick
    time: float  # its time, s
    state: Any
    # The recorded ticks that it was made from; None of a world that is not recorded.
    origin: _Origin | None = None
    # The state before the ticks of this time; None if there is none.
    before: tuple[Any] | None = None
    # The error of the expression at a tick, as long as the value depends on that.
    failure: SelectScriptError | None = None
    reach: int | None = None  # the number of ticks from that one on for which it does; None for all
    age: int = 0  # the number of ticks of later times than that one


class LiveFolds:
    """The states of calls of functions of time; equal calls share them.

    Args:
        is_recorded: checks whether a world is recorded.
    """

    def __init__(
        self,
        scope: EvaluationScope,
        planner: Planner,
        tables_read: Callable[[ast.Node], frozenset[str]],
        is_recorded: Callable[[World], bool],
        record_of: Callable[[World], Record],
    ) -> None:
        self._scope, self._planner, self._tables_read = scope, planner, tables_read
        self._is_recorded, self._record_of = is_recorded, record_of
        # The keys of calls, and the variables in their expressions.
        self._keys: WeakKeyDictionary[ast.Call, tuple[str, tuple[str, ...]]] = WeakKeyDictionary()
        # Whether the expression of a call is the same at the present tick and in the record.
        self._are_simple: WeakKeyDictionary[ast.Call, bool] = WeakKeyDictionary()
        self._inner_calls: WeakKeyDictionary[ast.Call, list[ast.Call]] = WeakKeyDictionary()
        self._queries: dict[str, list[ast.Query]] = {}
        self._folded: dict[str, _Folded] = {}

    def takes(self, call: ast.Call, frame: Frame) -> bool:
        """Checks whether the state of a call can be kept: it depends on no row around it.

        A finished record decides what looks ahead, and is no state.
        """
        has_rows = any(isinstance(element, Handle) for element in frame.elements.values())
        is_replay = not is_fold(call) and isinstance(self._world_of(call), ReplayedWorld)
        if frame.local or frame.placeholders or has_rows or is_replay:
            return False
        if call not in self._are_simple:
            expressions = expressions_of(call)
            is_simple = not free_aliases(call) and all(map(self._is_simple, expressions))
            self._are_simple[call] = is_simple
        return self._are_simple[call]

    def misses(self, call: ast.Call) -> bool:
        """Checks whether the present tick would be lost to a call: its world is not recorded."""
        world = self._unrecorded_world(call)
        if world is None:
            return False
        last, snapshot = self._last(call), world.snapshot
        return last is None or (last.run, last.tick) != (snapshot.run, snapshot.number)

    def settle(self, calls: Iterable[ast.Call]) -> None:
        """Adds the present tick to calls whose values nothing has needed at it."""
        for call in calls:
            if self.misses(call):
                with suppress(SelectScriptError):
                    Frame(self._scope).value(call)

    def need_no_tables(self, call: ast.Call) -> bool:
        """Checks whether the value of a call needs no table that DuckDB reads."""
        queries = self._queries.get(self._key(call)[0], ())
        is_planned = bool(queries) and all(map(self._planner.may_repeat, queries))
        return is_planned and self._unrecorded_world(call) is not None

    def value(
        self,
        call: ast.Call,
        fold: Fold,
        series_of: Callable[[], TickSeries],
        of_record: Callable[[TickSeries], Any],
    ) -> Any:
        """Returns the value of a call at the present tick; the caller pins the worlds.

        Args:
            call: the call.
            fold: what it is of all ticks.
            series_of: returns the recorded ticks.
            of_record: returns the value from the record alone.
        """
        world = self._unrecorded_world(call)
        if world is not None:
            folded = self._unrecorded(call, world, fold)
        else:
            known = self._recorded(call, fold)
            if known is None:
                series = series_of()
                known = self._made(call, series, fold)
                if known is None:
                    return of_record(series)
            folded = known
        self._cache(call, folded)
        if folded.failure is not None:
            raise copy.copy(folded.failure)
        return copied(fold.value(folded.state, folded.time))

    # -- states -----------------------------------------------------------------------------

    def _key(self, call: ast.Call) -> tuple[str, tuple[str, ...]]:
        if call not in self._keys:
            self._keys[call] = node_key(call), _names_in(call)
        return self._keys[call]

    def _last(self, call: ast.Call) -> _Folded | None:
        return self._folded.get(self._key(call)[0])

    def _cache(self, call: ast.Call, folded: _Folded) -> None:
        """Keeps a state; of many, those of other ticks can go on no more."""
        self._folded[self._key(call)[0]] = folded
        if len(self._folded) > _MANY:
            self._folded = {k: f for k, f in self._folded.items() if f.tick >= folded.tick - 1}
            self._queries = {k: query for k, query in self._queries.items() if k in self._folded}

    def _world_of(self, call: ast.Call) -> World | None:
        """Returns the only world of a call's expression; None if there is no such one."""
        scope = self._scope
        values = [scope.variable(n) for n in self._key(call)[1] if scope.has_variable(n)]
        worlds = [value.world if isinstance(value, Handle) else value for value in values]
        found = {world for world in worlds if isinstance(world, World)}
        return found.pop() if len(found) == 1 else None

    def _unrecorded_world(self, call: ast.Call) -> World | None:
        """Returns the only world of a call, if it was not recorded where its episode began."""
        world = self._world_of(call)
        if world is None or not self._is_recorded(world):
            return world
        last, snapshot = self._last(call), world.snapshot
        goes_on = (
            last is not None
            and last.origin is None
            and last.run == snapshot.run
            and 0 <= snapshot.number - last.tick <= 1
        )
        return world if goes_on else None

    def _unrecorded(self, call: ast.Call, world: World, fold: Fold) -> _Folded:
        """Returns the state at the present tick of a world that is not recorded."""
        snapshot, meaning = world.snapshot, self._meaning(call)
        last = self._last(call)
        if last is not None and (last.run, last.meaning) != (snapshot.run, meaning):
            last = None
        if last is not None and last.tick == snapshot.number:
            return last
        is_first = last is None and snapshot.time == world.ticker.episode_start
        is_next = last is not None and snapshot.number == last.tick + 1
        if meaning is None or not (is_first or is_next):
            raise EvaluationError(
                f"{no_ticks_message(world.name)}; without a record, {call.name}(…) has to be "
                "asked at each tick of an episode, and one was taken without that: record the "
                "world before the next reset",
                span=call.span,
            )
        return self._with_present(call, world, last, meaning, fold)

    def _recorded(self, call: ast.Call, fold: Fold) -> _Folded | None:
        """Returns the state at the present tick of a recorded world, if it follows from the last.

        None if it has to be made from the record, which raises the error if there is one.
        """
        last, world, meaning = self._last(call), self._world_of(call), self._meaning(call)
        if last is None or last.origin is None or world is None or meaning is None:
            return None
        snapshot, origin = world.snapshot, last.origin
        is_same = (last.run, last.meaning) == (snapshot.run, meaning)
        if not is_same or origin.layout() is not snapshot.layout:
            return None
        numbers, times = self._record_of(world).ticks_until_now()
        is_now = len(numbers) and numbers[-1] == snapshot.number and numbers[0] == origin.first
        if not is_now or origin.plans is not self._planner.generation:
            return None
        if last.tick == snapshot.number:
            return last
        if len(numbers) < 2 or numbers[-2] != last.tick or times[-1] <= last.time:
            return None
        folded = self._with_present(call, world, last, meaning, fold)
        return folded if folded.failure is None else None

    def _made(self, call: ast.Call, series: TickSeries, fold: Fold) -> _Folded | None:
        """Returns a state from the record.

        None if the present tick is not recorded, or not all of it, if a variable is of a type that
        may change, or if the state has entities, which have a tick.
        """
        record, snapshot = series.record, series.record.world.snapshot
        is_whole = record.recording is None or record.recording.entities is None
        numbers, times = series.ticks()
        meaning = self._meaning(call)
        is_now = len(numbers) > 0 and numbers[-1] == snapshot.number
        if not (is_whole and is_now) or meaning is None or self._world_of(call) is None:
            return None
        state = fold.begin(series)
        if _has_entity(state):
            return None
        origin = _Origin(int(numbers[0]), ref(snapshot.layout), self._planner.generation)
        return _Folded(snapshot.run, meaning, int(numbers[-1]), float(times[-1]), state, origin)

    # -- the present tick -------------------------------------------------------------------

    def _with_present(
        self,
        call: ast.Call,
        world: World,
        last: _Folded | None,
        meaning: tuple[Any, ...],
        fold: Fold,
    ) -> _Folded:
        snapshot = world.snapshot
        number, time = snapshot.number, snapshot.time
        origin = None if last is None else last.origin
        is_later = last is not None and time > last.time
        # Of ticks of one time, the last one counts.
        if last is None or time == world.ticker.episode_start:
            last, before = None, None
        else:
            before = (last.state,) if is_later else last.before

        def stepped(value: Any) -> Any:
            return fold.first(time, value) if before is None else fold.step(before[0], time, value)

        if last is not None and fold.reach == 0:
            return replace(last, tick=number, time=time)
        failure, reach, age = None, None, 0
        if last is not None and last.failure is not None:
            failure, reach, age = last.failure, last.reach, last.age + is_later
            if reach is not None and age >= reach:
                failure = None
        try:
            value = self._present(call, world)
            if fold.is_of_condition:
                value = is_true(value, expressions_of(call)[0])
            state = stepped(value)
        except LimitError:
            raise
        except SelectScriptError as error:
            is_missing = isinstance(error, UnknownNameError | RemovedEntityError)
            is_missing &= not isinstance(error, JointError)  # no later tick has another joint
            failure, age = error, 0
            reach = 1 if is_missing else fold.reach
            state = stepped(False if fold.is_of_condition else None)
        return _Folded(
            snapshot.run, meaning, number, time, state, origin, before, failure, reach, int(age)
        )

    def _present(self, call: ast.Call, world: World) -> Any:
        """Returns the present value of a call's expression, of two a tuple; None for NaN."""
        key, _ = self._key(call)
        if key not in self._queries:
            self._queries[key] = [select_of(expression) for expression in expressions_of(call)]
        try:
            values = tuple(self._selected(query, call, world) for query in self._queries[key])
        finally:
            self.settle(self._inner(call))
        return values if len(values) > 1 else values[0]

    def _selected(self, query: ast.Query, call: ast.Call, world: World) -> Any:
        """Returns the value that a SELECT of one row has; None where it is NaN."""
        try:
            selected = self._planner.run(query, Frame(self._scope), lambda _: None)
        except ArgumentError:
            if not world.snapshot.entities_with_nan():
                raise
            return None
        ((value,),) = formed(selected, lambda rows: rows.values)
        if isinstance(value, Handle):  # its columns would be those of the present tick
            raise EvaluationError(no_ticks_message(world.name), span=call.span)
        return value

    def _inner(self, call: ast.Call) -> list[ast.Call]:
        """Returns the functions of time in the expressions of a call, the innermost ones first."""
        if call not in self._inner_calls:
            parts = [part for node in expressions_of(call) for part in node.walk()]
            found = [p for p in parts if isinstance(p, ast.Call) and p.name in TEMPORAL_FUNCTIONS]
            self._inner_calls[call] = found[::-1]
        return self._inner_calls[call]

    def _meaning(self, call: ast.Call) -> tuple[Any, ...] | None:
        """Returns what a call's variables mean, without worlds; None if it may change by itself."""
        scope = self._scope
        meaning: list[tuple[Any, ...]] = []
        for name in self._key(call)[1]:
            value = scope.variable(name) if scope.has_variable(name) else None
            if type(value) in ATOMS:
                meaning.append((name, type(value), repr(value)))
            elif isinstance(value, World):
                meaning.append((name, World, value.serial))
            elif isinstance(value, Handle) and value.moment is None:
                meaning.append((name, type(value), (value.world.serial, value.id)))
            else:
                return None
        return tuple(meaning)

    def _is_simple(self, expression: ast.Node) -> bool:
        """Checks whether an expression has the same value at the present tick and in the record.

        Masses are recorded once, and functions of users may give another value each time.
        """
        for node in expression.walk():
            if isinstance(node, ast.TimeIndex | ast.Query):
                return False
            if isinstance(node, ast.Call) and node.name in TEMPORAL_FUNCTIONS:
                if not is_fold(node):
                    return False
            elif isinstance(node, ast.Call) and not (
                node.name in RELATIONS or node.name in BUILTINS
            ):
                return False
        return MASSES not in self._tables_read(expression)


def select_of(expression: ast.Node) -> ast.Query:
    """Returns a SELECT of one row that has the value of an expression."""
    zero = ast.ListLiteral(expression.span, (ast.Literal(expression.span, 0),))
    return ast.Query(expression.span, (expression,), (ast.Source(expression.span, None, zero),))


def copied(value: Any) -> Any:
    """Returns a value whose lists the caller may change."""
    return list(map(copied, value)) if type(value) is list else value


def _names_in(expression: ast.Node) -> tuple[str, ...]:
    """Returns the variables of an expression, each once."""
    return tuple(dict.fromkeys(n.name for n in expression.walk() if isinstance(n, ast.Name)))


def _has_entity(state: Any) -> bool:
    parts: Sequence[Any] = state if isinstance(state, list | tuple) else ()
    return isinstance(state, Handle) or any(map(_has_entity, parts))
