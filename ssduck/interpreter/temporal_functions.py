"""Functions of an expression at each recorded tick: `since`, `holds`, `changes` and others.

`holds(near(gripper, cup, 0.02))` becomes a query. Its sources are the entities in the expression,
each at the ticks of the record; it selects the time and the value of the expression. Python
computes the result from these.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import itemgetter
from typing import Any, Protocol, TypeAlias
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from ssduck.errors import ArgumentError, UnsupportedError
from ssduck.formatting import short_repr
from ssduck.language.analysis import free_aliases
from ssduck.language.builtins import EXTREMES, Function
from ssduck.language.evaluator import Frame
from ssduck.language.intervals import changes_of, intervals_of
from ssduck.language.operators import apply, truth
from ssduck.language.tree import (
    Binary,
    Call,
    Index,
    Name,
    Node,
    Placeholder,
    Query,
    Source,
    This,
    TimeIndex,
    UnresolvedName,
)
from ssduck.limits import UsageMeter
from ssduck.recording.replay.pair_answers import PairQueries
from ssduck.recording.replay.past import Past, common_moment, past_of
from ssduck.recording.replay.record import Record
from ssduck.recording.stores.base import PairRequest
from ssduck.world.handles import Handle
from ssduck.world.world import World

_TICK = itemgetter(0)
# The number of ticks that `since` reads first; each further read is twice as long.
FIRST_TICKS = 240
# Returns rows [tick, time, value] of some ticks.
RowsOf: TypeAlias = Callable[[Past], Sequence[Sequence[Any]]]
# Returns the first tick with the least clearance of two entities, and the clearance, m.
LeastClearance: TypeAlias = Callable[[Past], tuple[int, float] | None]
_PLACES = (Name, This, Index, TimeIndex, Placeholder, UnresolvedName)


@dataclass(frozen=True)
class TemporalFunction:
    """A function whose first argument is evaluated at each tick.

    Attributes:
        name: its name.
        make: the function that computes its value from a series of ticks and an age.
        about: its description for help.
        usage: its signature for help.
        expansion: the function that returns the expression for which a call stands, of a function
            that is no series of its own.
        arguments: the least and the largest number of arguments.
        expression: the place of the expression among the arguments.
        is_in_lakes: whether it is evaluated over the episodes of a lake by one statement.
    """

    name: str
    make: Callable[[TickSeries, Any], Any]
    about: str
    usage: str
    expansion: Callable[[Call], Node] | None = None
    arguments: tuple[int, int] = (1, 2)
    expression: int = 0
    is_in_lakes: bool = True

    @property
    def function(self) -> Function:
        """The entry for help; it is never called."""
        help_text = f"{self.about}\nUsage: {self.usage}"
        return Function(self.name, lambda *_: None, help_text, *self.arguments, builtin=True)


def parts_of(call: Call) -> tuple[Node, Node | None]:
    """Returns the expression of a call that is evaluated at ticks, and the other argument."""
    form = TEMPORAL_FUNCTIONS.get(call.name)
    place = 0 if form is None else form.expression
    others = [part for number, part in enumerate(call.arguments) if number != place]
    return call.arguments[place], others[0] if others else None


class TickSeries:
    """The values of an expression at the recorded ticks of a world.

    Args:
        record: the record of the world.
        run: a function that returns rows [tick, time, value] of some ticks.
        node: the expression.
        least_clearance: returns the least value of the expression at some ticks, of which no two
            have the same time, with its first tick; None if it is not the clearance of two
            entities.
        now: the number of the tick of a row of the past, up to which the series goes; None for the
            current tick of the world.
    """

    def __init__(
        self,
        record: Record,
        run: RowsOf,
        node: Node,
        least_clearance: LeastClearance | None = None,
        now: int | None = None,
    ) -> None:
        self.record = record
        self._now = now
        self.node = node
        self.least_clearance = least_clearance
        self._run = run

    def ticks(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
        """Returns the numbers and the times of the ticks until now."""
        return self.record.ticks_until_now(self._now)

    @property
    def time(self) -> float:
        """The time of the tick that is now, s."""
        return self.record.world.time if self._now is None else float(self.ticks()[1][-1])

    def past(self, age: float | None) -> Past:
        """Returns the tick at a time, those of the last seconds, or all, as braces do."""
        return past_of(self.record, age, self._now)

    def window(self, first: float, last: float) -> Past:
        """Returns all ticks from one time to another."""
        numbers, times = self.ticks()
        start, end = np.searchsorted(times, first), np.searchsorted(times, last, side="right")
        return Past(self.record, int(numbers[start]), int(numbers[end - 1]), is_window=True)

    def at(self, past: Past) -> tuple[list[float], list[Any]]:
        """Returns the times and values at some ticks; None where an entity was not there.

        Of several ticks of the same time, the last one replaces the others.
        """
        rows = self._run(past)
        ticks, times = past.ticks_and_times
        if [row[0] for row in rows] == ticks and len(set(times)) == len(times):
            return times, [row[2] for row in rows]
        values = {row[0]: row[2] for row in rows}
        last_ticks = dict(zip(times, ticks, strict=True))
        return list(last_ticks), [values.get(tick) for tick in last_ticks.values()]

    def holding(self, past: Past) -> tuple[list[float], list[bool]]:
        """Returns the times, and whether the expression was true."""
        times, values = self.at(past)
        node = self.node
        return times, [
            value is True or (value is not None and value is not False and truth(value, node))
            for value in values
        ]

    def backwards(self) -> Iterator[Past]:
        """Yields all ticks in pieces, the last ones first, each twice as long as the one before."""
        numbers, all_times = self.ticks()
        end, size = len(numbers), FIRST_TICKS
        while end > 0:
            # Ticks of the same time are in the same piece.
            start = int(np.searchsorted(all_times, all_times[max(end - size, 0)]))
            yield Past(self.record, int(numbers[start]), int(numbers[end - 1]), is_window=True)
            end, size = start, size * 2


def _since(series: TickSeries, _: Any) -> float | None:
    start: float | None = None
    for past in series.backwards():
        times, holding = series.holding(past)
        holding.reverse()
        if False in holding:
            count = holding.index(False)
            return times[-count] if count else start
        start = times[0]
    return start


def _held_for(series: TickSeries, age: Any) -> float:
    start = _since(series, age)
    return 0.0 if start is None else float(series.ticks()[1][-1]) - start


def _holds(series: TickSeries, age: Any) -> list[list[float]]:
    return intervals_of(*series.holding(series.past(age)))


def _changes(series: TickSeries, age: Any) -> list[list[Any]]:
    return changes_of(*series.at(series.past(age)))


def _initially(series: TickSeries, _: Any) -> Any:
    start = series.ticks()[1][0]
    return series.at(series.window(start, start))[1][0]


def _previous(series: TickSeries, _: Any) -> Any:
    times = series.ticks()[1]
    before = times[: np.searchsorted(times, series.time)]
    time = before[-1] if len(before) else times[0]
    return series.at(series.window(time, time))[1][0]


def _rate(series: TickSeries, _: Any) -> Any:
    times = series.ticks()[1]
    before = times[: np.searchsorted(times, times[-1])]
    pair = series.at(series.window(before[-1] if len(before) else times[-1], times[-1]))
    if None in pair[1]:
        return None
    is_list = type(pair[1][0]) is list
    first, last = (value if is_list else [value] for value in (pair[1][0], pair[1][-1]))
    if not {int, float}.issuperset(map(type, (*first, *last))):
        raise ArgumentError(f"rate takes an expression of numbers, not {short_repr(pair[1][-1])}")
    seconds = pair[0][-1] - pair[0][0] if len(before) else 1.0
    rates = [change / seconds for change in apply("-", last, first)]
    return rates if is_list else rates[0]


def _at(series: TickSeries, time: Any) -> Any:
    if time is None or time < 0:
        raise ArgumentError(
            "at takes a time from 0 s on, then an expression: at(0.5, x(cup)); for half a second "
            "ago write at(getTime() - 0.5, x(cup))"
        )
    return series.at(series.past(time))[1][-1]


def _lifted(call: Call) -> Node:
    """Returns z(entity) - initially(z(entity)) >= height for lifted(entity, height)."""
    span = call.span
    entity, height = call.arguments
    z = Call(entity.span, "z", (entity,), entity.span)
    rise = Binary(span, "-", z, Call(span, "initially", (z,), span))
    return Binary(span, ">=", rise, height)


def _least(series: TickSeries, age: Any) -> list[Any] | None:
    if series.least_clearance is not None:
        past = series.past(age)
        ticks, times = past.ticks, past.times
        found = series.least_clearance(past) if len(set(times)) == len(times) else None
        if found is not None:
            return [times[ticks.index(found[0])], found[1]]
    return _extreme(series, age, "least", min)


def _greatest(series: TickSeries, age: Any) -> list[Any] | None:
    return _extreme(series, age, "greatest", max)


def _extreme(
    series: TickSeries, age: Any, name: str, choose: Callable[..., tuple[float, Any]]
) -> list[Any] | None:
    """Returns [time, value] of the first of the extreme values; None without numbers."""
    times, values = series.at(series.past(age))
    entries = [
        (time, value) for time, value in zip(times, values, strict=True) if _is_number(value)
    ]
    invalid = [v for v in values if v is not None and not isinstance(v, int | float)]
    if invalid:
        raise ArgumentError(f"{name} takes an expression of numbers, not {short_repr(invalid[0])}")
    return list(choose(entries, key=lambda entry: entry[1])) if entries else None


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not math.isnan(value)


TEMPORAL_FUNCTIONS: dict[str, TemporalFunction] = {
    form.name: form
    for form in (
        TemporalFunction(
            "since",
            _since,
            "Returns the simulated time, in seconds, since which a condition has held at every "
            "recorded tick; nothing if it does not hold now.",
            "since(condition) -> float",
            arguments=(1, 1),
        ),
        TemporalFunction(
            "heldFor",
            _held_for,
            "Returns the simulated time, in seconds, for which a condition has held until now; "
            "0 if it does not hold now.",
            "heldFor(condition) -> float",
            arguments=(1, 1),
        ),
        TemporalFunction(
            "holds",
            _holds,
            "Returns the maximal intervals [start, end] of simulated time, in seconds, during "
            "which a condition held. An interval ends at the first tick at which the condition "
            "does not hold, or at the last tick.",
            "holds(condition[, age]) -> list",
        ),
        TemporalFunction(
            "changes",
            _changes,
            "Returns [time, value] of an expression at the first recorded tick and at each tick "
            "where the value changes; times in seconds.",
            "changes(expression[, age]) -> list",
        ),
        TemporalFunction(
            "initially",
            _initially,
            "Returns the value of an expression at the first recorded tick, nothing if an entity "
            "was not there: z(cup) - initially(z(cup)) >= 0.1 is true of a cup that is lifted by "
            "10 cm.",
            "initially(expression) -> value",
            arguments=(1, 1),
        ),
        TemporalFunction(
            "lifted",
            _initially,
            "Checks if an entity is higher by so many metres than at the first recorded tick: "
            "z(entity) - initially(z(entity)) >= height.",
            "lifted(entity, height) -> bool",
            _lifted,
            arguments=(2, 2),
        ),
        TemporalFunction(
            "previous",
            _previous,
            "Returns the value of an expression at the last recorded tick before the current time: "
            "that of the tick itself at the first one, nothing if an entity was not there.",
            "previous(expression) -> value",
            arguments=(1, 1),
            is_in_lakes=False,
        ),
        TemporalFunction(
            "rate",
            _rate,
            "Returns the change of an expression from the recorded tick before to the last one, in "
            "its unit a second; 0 at the first tick, nothing if an entity was not there at one of "
            "them. Of a list of numbers it is a list.",
            "rate(expression) -> number",
            arguments=(1, 1),
            is_in_lakes=False,
        ),
        TemporalFunction(
            "at",
            _at,
            "Returns the value of an expression at a simulated time in seconds: at the last "
            "recorded tick until then; nothing if an entity was not there.",
            "at(time, expression) -> value",
            arguments=(2, 2),
            expression=1,
            is_in_lakes=False,
        ),
        TemporalFunction(
            "least",
            _least,
            "Returns [time, value] of the least value of an expression over the recorded ticks, "
            "at its first tick, the time in seconds: least(clearance(a, b)) is the closest "
            "approach.",
            "least(expression[, age]) -> list",
        ),
        TemporalFunction(
            "greatest",
            _greatest,
            "Returns [time, value] of the greatest value of an expression over the recorded ticks, "
            "at its first tick, the time in seconds: greatest(contactForce(a, b)) is the hardest "
            "push.",
            "greatest(expression[, age]) -> list",
        ),
    )
}


class SeriesReader(Protocol):
    """Reads the values of an expression at ticks, for several records at once."""

    def rows(self, key: Hashable, past: Past, rows_of: RowsOf) -> Sequence[Sequence[Any]]:
        """Returns the rows [tick, time, value] of some ticks.

        Args:
            key: what identifies the expression, with its entities and values.
            past: the ticks.
            rows_of: a function that returns the rows of any ticks.
        """

    def least_clearance(self, past: Past, a: int, b: int) -> tuple[int, float] | None:
        """Returns the first tick with the least clearance of two entities, and the clearance, m.

        Args:
            past: the ticks.
            a: the id of an entity.
            b: the id of another one.
        """


class TemporalEvaluator:
    """Turns expressions into queries, and caches these: each is planned once.

    Attributes:
        reader: reads the values of expressions; None to read those of the requested ticks only.
    """

    def __init__(self) -> None:
        self.reader: SeriesReader | None = None
        self._queries: WeakKeyDictionary[Node, dict[tuple[bool, ...], Query]] = WeakKeyDictionary()
        self._expansions: WeakKeyDictionary[Node, Node] = WeakKeyDictionary()

    def expansion(self, call: Call) -> Node | None:
        """Returns the expression for which a call stands; None for a series of its own."""
        expand = TEMPORAL_FUNCTIONS[call.name].expansion
        if expand is not None and call not in self._expansions:
            self._expansions[call] = expand(call)
        return self._expansions.get(call)

    def series(
        self,
        call: Call,
        frame: Frame,
        record_of: Callable[[World], Record],
        run: Callable[[Query, dict[str, Any]], Sequence[Sequence[Any]]],
        meter: UsageMeter,
    ) -> TickSeries:
        """Returns the values of the expression in a call, tick by tick.

        Args:
            call: the call, `holds(…)` say.
            frame: the scope, which has the entities in the expression and its other values.
            record_of: a function that returns the record of a world.
            run: a function that returns the rows of a query, from the values of its placeholders.
            meter: checks the limits of the running program.

        Raises:
            ArgumentError: the expression contains no entity.
            UnsupportedError: the expression contains a query, or entities of two worlds.
        """
        expression, _ = parts_of(call)
        query, world, values, handles = self._query_and_values(call, frame)
        record = record_of(world)
        record.world.warn_of_unrecorded_start()
        moment = common_moment(world, (), frame.own_elements())
        now = None if moment is None else moment.tick

        def rows(past: Past) -> Sequence[Sequence[Any]]:
            return run(query, _placeholders(values, handles, past))

        reader, least = self.reader, None
        are_entities = all(handles) and all(value.TABLE == "entities" for value in values)
        if are_entities and _is_clearance(expression) and len({v.id for v in values}) == 2:
            least = partial(self._least_clearance, meter, values[0].id, values[1].id)
        if reader is None and now is None:
            return TickSeries(record, rows, expression, least)
        key = (
            query,
            tuple(
                (value.id, value.TABLE) if is_entity else (type(value), repr(value))
                for value, is_entity in zip(values, handles, strict=True)
            ),
        )
        if reader is None:
            cache: dict[Any, Any] = frame.cached

            def rows_of(past: Past) -> Sequence[Sequence[Any]]:
                if key not in cache:  # of all ticks at once, for the next rows of the query
                    cache[key] = rows(past_of(record, None))
                of_all: Sequence[Sequence[Any]] = cache[key]
                return of_all[
                    bisect_left(of_all, past.first, key=_TICK) : bisect_right(
                        of_all, past.last, key=_TICK
                    )
                ]

            return TickSeries(record, rows_of, expression, least, now)
        return TickSeries(record, lambda past: reader.rows(key, past, rows), expression, least, now)

    def query_over_ticks(
        self, call: Call, frame: Frame, record_of: Callable[[World], Record]
    ) -> tuple[Query, dict[str, Any]]:
        """Returns the query of the values of the first argument of a call, over all ticks.

        Its rows are [tick, time, value]. The arguments and errors are those of `series`.

        Returns:
            The query, and the values of its placeholders.
        """
        query, world, values, handles = self._query_and_values(call, frame)
        return query, _placeholders(values, handles, past_of(record_of(world), None))

    def _query_and_values(
        self, call: Call, frame: Frame
    ) -> tuple[Query, World, list[Any], list[bool]]:
        """Returns the query of a call, the world, its values, and which of them are entities."""
        expression, _ = parts_of(call)
        places = list(_places(expression, call))
        values = [frame.value(place) for place in places]
        # An entity of a row of the past follows the ticks; that of `sim{0.0}.cup` stays at its own.
        handles = [
            isinstance(value, Handle) and (value.moment is None or bool(free_aliases(place)))
            for place, value in zip(places, values, strict=True)
        ]
        worlds = {v.world for v, is_entity in zip(values, handles, strict=True) if is_entity}
        if not worlds and any(isinstance(value, Handle) for value in values):
            raise ArgumentError(
                f"{call.name} takes an entity at all ticks, and this one stays at its tick: write "
                "it without {…}",
                span=expression.span,
            )
        if not worlds:
            what = "takes an expression of entities, such as near(gripper, cup, 0.02)"
            if isinstance(expression, Index):
                what = f"takes the whole list, and the index comes after it: {call.name}(…)[0]"
            elif call.name in EXTREMES:
                what += f"; of several numbers write {EXTREMES[call.name]}([a, b])"
            elif call.name == "at":
                what = "takes the time first, as in at(0.5, z(cup))"
            raise ArgumentError(f"{call.name} {what}", span=expression.span)
        if len(worlds) > 1:
            raise UnsupportedError(f"{call.name} takes entities of one world", span=call.span)
        return self._query(call, places, tuple(handles)), worlds.pop(), values, handles

    def _least_clearance(
        self, meter: UsageMeter, a: int, b: int, past: Past
    ) -> tuple[int, float] | None:
        """Returns the first tick with the least clearance of two entities, and the clearance, m."""
        if self.reader is not None:
            return self.reader.least_clearance(past, a, b)
        request = PairRequest(past.first, past.last, a, b, 0.0)
        starts = np.array([past.first])
        return PairQueries(past.record, meter).least_clearances(request, starts)[0]

    def _query(self, call: Call, places: Sequence[Node], handles: tuple[bool, ...]) -> Query:
        queries = self._queries.setdefault(call, {})
        if handles not in queries:
            queries[handles] = _query_of(call, places, handles)
        return queries[handles]


def _is_clearance(expression: Node) -> bool:
    """Checks whether an expression is the clearance of two entities."""
    return (
        isinstance(expression, Call)
        and expression.name == "clearance"
        and len(expression.arguments) == 2
    )


def _placeholders(values: Sequence[Any], handles: Sequence[bool], past: Past) -> dict[str, Any]:
    """Returns the values of the placeholders of a query: entities at some ticks, and others."""
    return {
        f"value_{number}": _of_entity(past, value) if is_entity else value
        for number, (value, is_entity) in enumerate(zip(values, handles, strict=True))
    }


def _of_entity(past: Past, entity: Handle) -> Past:
    """Returns the past of one entity."""
    return replace(past, is_window=True, id=entity.id, table=entity.TABLE)


def _places(node: Node, call: Call) -> Iterator[Node]:
    """Yields the parts of an expression that may be entities."""
    if isinstance(node, Query):
        raise UnsupportedError(
            f"{call.name} takes an expression without a query; query FROM world{{}} instead",
            span=node.span,
        )
    if isinstance(node, _PLACES):
        yield node
        return
    for child in node.children():
        yield from _places(child, call)


def _query_of(call: Call, places: Sequence[Node], handles: tuple[bool, ...]) -> Query:
    span = call.span
    replacements: dict[Node, Node] = {}
    sources = []
    for number, (place, is_entity) in enumerate(zip(places, handles, strict=True)):
        placeholder = Placeholder(place.span, f"value_{number}")
        if not is_entity:
            replacements[place] = placeholder
            continue
        alias = f"entity_{number}"
        replacements[place] = This(place.span, alias)
        sources.append(Source(place.span, alias, placeholder))
    first = This(span, sources[0].alias)
    value = parts_of(call)[0].replaced(replacements.get)
    items = (*(Call(span, name, (first,), span) for name in ("tick", "time")), value)
    return Query(span, items, tuple(sources))
