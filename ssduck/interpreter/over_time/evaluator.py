"""Turns an expression over time into a query of the values at each tick.

`holds(near(gripper, cup, 0.02))` becomes a query. Its sources are the entities in the expression,
each at the ticks of the record; it selects the time and the value of the expression. Python
computes the result from these.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Protocol, TypeAlias
from weakref import WeakKeyDictionary

import numpy as np

from ssduck.database.fetched_rows import columns_of
from ssduck.errors import ArgumentError, LimitError, SelectScriptError, UnsupportedError
from ssduck.interpreter.over_time.functions import TEMPORAL_FUNCTIONS, expressions_of, parts_of
from ssduck.interpreter.over_time.series import ColumnsOf, TickColumns, TickSeries
from ssduck.language import ast
from ssduck.language.analysis import free_aliases
from ssduck.language.builtins import BUILTINS, EXTREMES, NUMBER_OF_ENTITY
from ssduck.language.evaluator import Frame
from ssduck.limits import UsageMeter
from ssduck.recording.replay.pair_answers import PairQueries
from ssduck.recording.replay.past import Past, common_moment, past_of
from ssduck.recording.replay.record import Record
from ssduck.recording.stores.base import PairRequest
from ssduck.sql.relations.registry import RELATIONS
from ssduck.world.handles import Handle, removal_of
from ssduck.world.world import World

# The largest number of rows that are read of all entities at once, for the rows of a query.
MOST_ROWS = 2_000_000
# So many rows of all entities are read in about the time that a query of one entity takes.
ROWS_A_QUERY = 50_000
# Returns the rows of a query, from the values of its placeholders.
RunQuery: TypeAlias = Callable[[ast.Query, dict[str, Any]], Sequence[Sequence[Any]]]
_PLACES = (ast.Name, ast.This, ast.TimeIndex, ast.Placeholder, ast.UnresolvedName)


class SeriesReader(Protocol):
    """Reads the values of an expression at ticks, for several records at once."""

    def columns(self, key: Hashable | None, past: Past, columns_of: ColumnsOf) -> TickColumns:
        """Returns the values at some ticks.

        Args:
            key: what identifies the expression, with its entities and values; None if it looks at
                ticks itself, and so depends on the record.
            past: the ticks.
            columns_of: a function that returns the values at any ticks.
        """

    def least_clearance(self, past: Past, a: int, b: int) -> tuple[int, float] | None:
        """Returns the first tick with the least clearance of two entities, and the clearance, m."""


class TemporalEvaluator:
    """Turns expressions into queries, and caches these: each is planned once."""

    def __init__(self, record_of: Callable[[World], Record], run: RunQuery) -> None:
        self._record_of, self._run = record_of, run
        # Reads the values of expressions; None to read those of the requested ticks only.
        self.reader: SeriesReader | None = None
        self._queries: WeakKeyDictionary[ast.Node, dict[Any, ast.Query]] = WeakKeyDictionary()

    def series(self, call: ast.Call, frame: Frame) -> TickSeries:
        """Returns the values of the expression in a call, tick by tick."""
        expression, _ = parts_of(call)
        places, world, values, handles = self._given(call, frame)
        query = self._query(call, places, handles)
        record, run = self._record_of(world), self._run
        record.world.ticker.warn_of_unrecorded_start()
        moment = common_moment(world, (), frame.own_elements())
        now = None if moment is None else moment.tick

        def of_one(past: Past) -> TickColumns:
            return TickColumns.of(run(query, _placeholders(values, handles, past)))

        columns: ColumnsOf = of_one
        reader, least = self.reader, None
        are_entities = all(handles) and all(value.TABLE == "entities" for value in values)
        is_clearance = isinstance(expression, ast.Call) and expression.name == "clearance"
        if is_clearance and are_entities and len(values) == len({v.id for v in values}) == 2:
            a, b = values
            least = partial(self._least_clearance, frame.scope.meter, a.id, b.id)
        cache: dict[Any, Any] = frame.cached
        of_rows = [number for number, place in enumerate(places) if free_aliases(place)]
        if reader is None and now is None:
            if len(of_rows) == 1 and handles[of_rows[0]] and values[of_rows[0]].TABLE == "entities":
                of_all = self._query(call, places, handles, of_rows[0])
                columns = _for_each(of_one, of_all, values, handles, of_rows[0], run, cache)
            return TickSeries(record, columns, expression, least)
        key = (query, _keys(values, handles))
        if reader is None:

            def from_all(past: Past) -> TickColumns:
                if key not in cache:  # of all ticks at once, for the next rows of the query
                    cache[key] = columns(past_of(record, None))
                of_all: TickColumns = cache[key]
                return of_all.between(past.first, past.last)

            return TickSeries(record, from_all, expression, least, now)
        shared = None if _reads_ticks(query, values, handles) else key
        return TickSeries(
            record, lambda past: reader.columns(shared, past, columns), expression, least, now
        )

    def query_over_ticks(self, call: ast.Call, frame: Frame) -> tuple[ast.Query, dict[str, Any]]:
        """Returns the query of the values of the first argument of a call, over all ticks.

        Its rows are [tick, time, value]. The arguments and errors are those of `series`.

        Returns:
            The query, and the values of its placeholders.
        """
        places, world, values, handles = self._given(call, frame)
        past = past_of(self._record_of(world), None)
        return self._query(call, places, handles), _placeholders(values, handles, past)

    def world_of(self, call: ast.Call, frame: Frame) -> World:
        """Returns the world of the entities in the expressions of a call."""
        return self._given(call, frame)[1]

    def names_entities(self, node: ast.Node, frame: Frame) -> bool:
        """Checks whether a part of an expression names an entity."""
        call = ast.Call(node.span, "changes", (node,), node.span)
        return any(isinstance(frame.value(place), Handle) for place in _places(node, call))

    def _given(
        self, call: ast.Call, frame: Frame
    ) -> tuple[list[ast.Node], World, list[Any], tuple[bool, ...]]:
        """Returns the places of entities, their world, the values, and which follow the ticks."""
        expression, _ = parts_of(call)
        places = [place for part in expressions_of(call) for place in _places(part, call)]
        values = [frame.value(place) for place in places]
        # An entity of a row of the past follows the ticks; that of `sim{0.0}.cup` stays at its own.
        handles = tuple(
            isinstance(value, Handle) and (value.moment is None or bool(free_aliases(place)))
            for place, value in zip(places, values, strict=True)
        )
        worlds = {v.world for v, is_entity in zip(values, handles, strict=True) if is_entity}
        if not worlds and any(isinstance(value, Handle) for value in values):
            removals = (removal_of(value) for value in values if isinstance(value, Handle))
            advice = next(filter(None, removals), "write it without {…}")
            raise ArgumentError(
                f"{call.name} takes an entity at all ticks, and this one stays at its tick: "
                f"{advice}",
                span=expression.span,
            )
        if not worlds:
            what = "takes an expression of entities, such as near(gripper, cup, 0.02)"
            if isinstance(expression, ast.Index):
                what = f"takes the whole list, and the index comes after it: {call.name}(…)[0]"
            elif call.name in EXTREMES:
                what += f"; of several numbers write {EXTREMES[call.name]}([a, b])"
            elif call.name == "at":
                what = "takes the time first, as in at(0.5, z(cup))"
            raise ArgumentError(f"{call.name} {what}", span=expression.span)
        if len(worlds) > 1:
            raise UnsupportedError(f"{call.name} takes entities of one world", span=call.span)
        return places, worlds.pop(), values, handles

    def _least_clearance(
        self, meter: UsageMeter, a: int, b: int, past: Past
    ) -> tuple[int, float] | None:
        """Returns the first tick with the least clearance of two entities, and the clearance, m."""
        if self.reader is not None:
            return self.reader.least_clearance(past, a, b)
        request = PairRequest(past.first, past.last, a, b, 0.0)
        starts = np.array([past.first])
        return PairQueries(past.record, meter).least_clearances(request, starts)[0]

    def _query(
        self,
        call: ast.Call,
        places: Sequence[ast.Node],
        handles: tuple[bool, ...],
        number: int | None = None,
    ) -> ast.Query:
        queries, key = self._queries.setdefault(call, {}), (handles, number)
        if key not in queries:
            queries[key] = _query_of(call, places, handles, number)
        return queries[key]


def _for_each(
    columns: ColumnsOf,
    query: ast.Query,
    values: Sequence[Any],
    handles: Sequence[bool],
    number: int,
    run: RunQuery,
    cache: dict[Any, Any],
) -> ColumnsOf:
    """Returns a function that reads ticks for all entities at once, for the rows of a query.

    The first entities are read each by itself, while that takes less time than to read all, as
    there may be no others. So is each one if the expression fails for any, as a condition of the
    query may exclude that.
    """
    keys, entity = _keys(values, handles), values[number]
    others = keys[:number] + keys[number + 1 :]

    def columns_of(past: Past) -> TickColumns:
        key = query, others, past.first, past.last
        read, rows = cache.get(key, 0), (past.last - past.first + 1) * len(past.world)
        if read is None or rows > MOST_ROWS:
            return columns(past)
        if isinstance(read, int):
            if read * ROWS_A_QUERY < rows:
                cache[key] = read + 1
                return columns(past)
            try:
                read = _by_entity(run(query, _placeholders(values, handles, past, number)))
            except LimitError:
                raise
            except SelectScriptError:
                read = None
            cache[key] = read
            return columns_of(past)
        found: TickColumns | None = read.get(entity.id)
        return TickColumns.of(()) if found is None else found

    return columns_of


def _by_entity(rows: Sequence[Sequence[Any]]) -> dict[int, TickColumns]:
    """Returns the values in rows [tick, time, value, entity] by the numbers of the entities."""
    if not rows:
        return {}
    ticks, _, values, entities = columns_of(rows)
    places = np.lexsort((ticks, entities))
    ids, starts = np.unique(entities[places], return_index=True)
    parts = np.split(places, starts[1:])
    return {
        id: TickColumns(ticks[part], values[part])
        for id, part in zip(ids.tolist(), parts, strict=True)
    }


def _keys(values: Sequence[Any], handles: Sequence[bool]) -> tuple[Hashable, ...]:
    """Returns what identifies each value."""
    return tuple(
        (value.id, value.TABLE) if is_entity else (type(value), repr(value))
        for value, is_entity in zip(values, handles, strict=True)
    )


def _placeholders(
    values: Sequence[Any], handles: Sequence[bool], past: Past, of_all: int | None = None
) -> dict[str, Any]:
    """Returns the values of the placeholders of a query: entities at some ticks, and others.

    In place of the entity with the number `of_all` are all of its world.
    """
    result = {f"value_{number}": value for number, value in enumerate(values)}
    every = replace(past, is_window=True)
    for number, (value, is_entity) in enumerate(zip(values, handles, strict=True)):
        if is_entity:
            one = replace(every, id=value.id, table=value.TABLE)
            result[f"value_{number}"] = every if number == of_all else one
    return result


def _reads_ticks(query: ast.Query, values: Sequence[Any], handles: Sequence[bool]) -> bool:
    """Checks whether an expression has a function of time inside, or an entity at another tick."""
    is_pinned = any(
        isinstance(value, Handle) and not is_entity
        for value, is_entity in zip(values, handles, strict=True)
    )
    return is_pinned or any(
        isinstance(part, ast.Call) and part.name in TEMPORAL_FUNCTIONS for part in query.walk()
    )


def _is_place(node: ast.Node) -> bool:
    """Checks whether a part may be an entity: position(e)[2] is no part of one, links(e)[0] is."""
    if isinstance(node, ast.Index) and isinstance(node.base, ast.Call):
        name = node.base.name
        return not (name in RELATIONS or name in BUILTINS or name in TEMPORAL_FUNCTIONS)
    if isinstance(node, ast.Index):
        return _is_place(node.base)
    return isinstance(node, _PLACES)


def _places(node: ast.Node, call: ast.Call) -> Iterator[ast.Node]:
    """Yields the parts of an expression that may be entities."""
    if isinstance(node, ast.Query):
        raise UnsupportedError(
            f"{call.name} takes an expression without a query; query FROM world{{}} instead",
            span=node.span,
        )
    if _is_place(node):
        yield node
        return
    for child in node.children():
        yield from _places(child, call)


def _query_of(
    call: ast.Call, places: Sequence[ast.Node], handles: tuple[bool, ...], number_of_row: int | None
) -> ast.Query:
    """Returns the query of an expression; its rows are [tick, time, value].

    A fourth column is the number of the entity at the place `number_of_row`.
    """
    span = call.span
    replacements: dict[ast.Node, ast.Node] = {}
    sources = []
    for number, (place, is_entity) in enumerate(zip(places, handles, strict=True)):
        placeholder = ast.Placeholder(place.span, f"value_{number}")
        if not is_entity:
            replacements[place] = placeholder
            continue
        alias = f"entity_{number}"
        replacements[place] = ast.This(place.span, alias)
        sources.append(ast.Source(place.span, alias, placeholder))
    first = ast.This(span, sources[0].alias)

    def replaced(node: ast.Node) -> ast.Node | None:
        if isinstance(node, ast.Call) and node.name == "getTime" and not node.arguments:
            return ast.Call(node.span, "time", (first,), node.span)
        return replacements.get(node)

    value = parts_of(call)[0].replaced(replaced)
    rows = () if number_of_row is None else (ast.This(span, f"entity_{number_of_row}"),)
    of_row = [ast.Call(span, NUMBER_OF_ENTITY, (row,), span) for row in rows]
    items = (*(ast.Call(span, name, (first,), span) for name in ("tick", "time")), value, *of_row)
    return ast.Query(span, items, tuple(sources), is_ordered=False)
