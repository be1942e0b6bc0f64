"""Functions of time of a world that is not recorded, which are asked at each of its ticks.

A fold needs its state at the tick before and the value now, and no record. The state begins at the
first tick of an episode, and each tick has to be added: a tick that was missed is an error.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any
from weakref import WeakKeyDictionary

from ssduck.errors import (
    ArgumentError,
    EvaluationError,
    LimitError,
    RemovedEntityError,
    SelectScriptError,
    UnknownNameError,
)
from ssduck.interpreter.over_time.functions import TEMPORAL_FUNCTIONS, parts_of
from ssduck.interpreter.over_time.series import is_true
from ssduck.interpreter.planner import Planner
from ssduck.language.clauses import formed
from ssduck.language.evaluator import EvaluationScope, Frame
from ssduck.language.tree import Call, ListLiteral, Literal, Name, Node, Query, Source
from ssduck.language.value_keys import ATOMS, node_key
from ssduck.recording.spec import no_ticks_message
from ssduck.world.handles import Handle
from ssduck.world.world import World

# Of more states, those that cannot go on are dropped.
_MANY = 256


def names_in(expression: Node) -> tuple[str, ...]:
    """Returns the variables of an expression, each once."""
    return tuple(dict.fromkeys(n.name for n in expression.walk() if isinstance(n, Name)))


def select_of(expression: Node) -> Query:
    """Returns a SELECT of one row that has the value of an expression."""
    zero = ListLiteral(expression.span, (Literal(expression.span, 0),))
    return Query(expression.span, (expression,), (Source(expression.span, None, zero),))


def meaning_of(scope: EvaluationScope, names: Sequence[str]) -> tuple[Any, ...] | None:
    """Returns what variables of an expression mean; None if that may change by itself.

    It holds no world. What else an expression depends on has the planner forget its states.
    """
    meaning: list[Any] = []
    for name in names:
        value = scope.variable(name) if scope.has_variable(name) else None
        if type(value) in ATOMS:
            meaning.append((name, type(value), repr(value)))
        elif isinstance(value, World):
            meaning.append((name, value.serial))
        elif isinstance(value, Handle) and value.moment is None:
            meaning.append((name, type(value), value.world.serial, value.id))
        else:
            return None
    return tuple(meaning)


@dataclass(frozen=True, eq=False)
class _Folded:
    """The state of a fold at the last tick that was added.

    Attributes:
        run: the number of the world's run.
        meaning: the values of the variables in its expression.
        tick: the number of the tick.
        time: its time, s.
        state: the state.
        before: the state before the ticks of this time; None if there is none.
        failure: the error of the expression at a tick, as long as the value depends on that.
        reach: the number of ticks from that one on for which it does; None for all.
        age: the number of ticks of later times than that one.
    """

    run: int
    meaning: tuple[Any, ...]
    tick: int
    time: float
    state: Any
    before: tuple[Any] | None
    failure: SelectScriptError | None = None
    reach: int | None = None
    age: int = 0


class UnrecordedFolds:
    """The states of functions of time of worlds that are not recorded.

    Args:
        scope: the variables.
        planner: runs queries.
    """

    def __init__(self, scope: EvaluationScope, planner: Planner) -> None:
        self._scope, self._planner = scope, planner
        self._keys: WeakKeyDictionary[Call, tuple[str, tuple[str, ...]]] = WeakKeyDictionary()
        # By the key of the call: equal calls share them.
        self._queries: dict[str, Query] = {}
        self._folded: dict[str, _Folded] = {}

    def world_of(self, call: Call) -> World | None:
        """Returns the only world of a call's expression; None if there is no such one."""
        scope = self._scope
        values = [scope.variable(n) for n in self._key(call)[1] if scope.has_variable(n)]
        worlds = [value.world if isinstance(value, Handle) else value for value in values]
        found = {world for world in worlds if isinstance(world, World)}
        return found.pop() if len(found) == 1 else None

    def goes_on(self, call: Call, world: World) -> bool:
        """Checks whether a call has a state at the present tick of a world, or the one before."""
        last = self._folded.get(self._key(call)[0])
        snapshot = world.snapshot
        return (
            last is not None and last.run == snapshot.run and 0 <= snapshot.number - last.tick <= 1
        )

    def is_planned(self, call: Call) -> bool:
        """Checks whether the next value of a call is computed without DuckDB."""
        query = self._queries.get(self._key(call)[0])
        return query is not None and self._planner.is_kept(query)

    def misses(self, call: Call, world: World) -> bool:
        """Checks whether the present tick is not in the state of a call yet."""
        last = self._folded.get(self._key(call)[0])
        return last is None or (last.run, last.tick) != (world.snapshot.run, world.snapshot.number)

    def value(self, call: Call, world: World) -> Any:
        """Returns the value of a call at the present tick; the caller pins the worlds.

        Raises:
            EvaluationError: the call was not asked at an earlier tick of the episode.
            SelectScriptError: its expression fails, or failed at an earlier tick.
        """
        fold = TEMPORAL_FUNCTIONS[call.name].fold
        assert fold is not None
        key, names = self._key(call)
        snapshot, meaning = world.snapshot, meaning_of(self._scope, names)
        last = self._folded.get(key)
        if last is not None and (last.run != snapshot.run or last.meaning != meaning):
            last = None
        if last is None or last.tick != snapshot.number:
            if meaning is None or not self._follows(world, last):
                raise EvaluationError(
                    f"{no_ticks_message(world.name)}; without a record, {call.name}(…) has to be "
                    "asked at each tick of an episode, and one was taken without that: record the "
                    "world before the next reset",
                    span=call.span,
                )
            last = self._with_present(call, world, last, meaning)
            self._keep(key, last, world)
        if last.failure is not None:
            raise copy.copy(last.failure)
        return copied(fold.value(last.state, last.time))

    def _key(self, call: Call) -> tuple[str, tuple[str, ...]]:
        """Returns the key of a call, and the variables in its expression."""
        if call not in self._keys:
            self._keys[call] = node_key(call), names_in(parts_of(call)[0])
        return self._keys[call]

    @staticmethod
    def _follows(world: World, last: _Folded | None) -> bool:
        """Checks whether the present tick is the next one, or the first one of an episode."""
        snapshot = world.snapshot
        if last is None:
            return snapshot.time == world.episode_start
        return snapshot.number == last.tick + 1

    def _with_present(
        self, call: Call, world: World, last: _Folded | None, meaning: tuple[Any, ...]
    ) -> _Folded:
        """Returns the state with the present tick."""
        snapshot = world.snapshot
        number, time = snapshot.number, snapshot.time
        fold = TEMPORAL_FUNCTIONS[call.name].fold
        assert fold is not None
        is_later = last is not None and time > last.time
        if last is None or time == world.episode_start:  # of ticks of one time, the last one counts
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
            state = stepped(is_true(value, parts_of(call)[0]) if fold.is_of_condition else value)
        except LimitError:
            raise
        except SelectScriptError as error:
            is_missing = isinstance(error, UnknownNameError | RemovedEntityError)
            failure, age = error, 0
            reach = 1 if is_missing else fold.reach
            state = stepped(False if fold.is_of_condition else None)
        return _Folded(snapshot.run, meaning, number, time, state, before, failure, reach, int(age))

    def _present(self, call: Call, world: World) -> Any:
        """Returns the value of a call's expression at the present tick; None where it is NaN."""
        key, _ = self._key(call)
        query = self._queries.get(key)
        if query is None:
            query = self._queries[key] = select_of(parts_of(call)[0])
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

    def _keep(self, key: str, folded: _Folded, world: World) -> None:
        """Keeps a state; of many, those of other ticks can go on no more."""
        self._folded[key] = folded
        if len(self._folded) > _MANY:
            number = world.snapshot.number
            self._folded = {k: f for k, f in self._folded.items() if f.tick >= number - 1}
            self._queries = {k: query for k, query in self._queries.items() if k in self._folded}


def copied(value: Any) -> Any:
    """Returns a value whose lists the caller may change."""
    return list(map(copied, value)) if type(value) is list else value
