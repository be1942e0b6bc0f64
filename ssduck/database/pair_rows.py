"""Looks up the rows of a query of all pairs that a search finds, without a statement."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ssduck.database.binding import BoundWorld
from ssduck.geometry.arrays import Flags, Indices
from ssduck.geometry.id_pairs import IdPairs
from ssduck.sql.pair_lookup import PairColumn, PairLookup
from ssduck.world.live_tables import LiveTable

_COMPARE: Mapping[str, Callable[[Any, Any], Any]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "=": operator.eq,
    "<>": operator.ne,
}


def pair_rows(
    lookup: PairLookup, bound: BoundWorld, parameters: Mapping[str, Any]
) -> list[tuple[Any, ...]]:
    """Returns the rows that the SQL of a look-up's query has.

    Args:
        lookup: the look-up.
        bound: its world; the caller pins it, with its shapes read.
        parameters: the values of the query's parameters.
    """
    entities = bound.world.snapshot.tables["entities"]
    rows = _found(lookup, bound, parameters)
    for comparison in lookup.comparisons:
        ranks = entities["id"] if comparison.column == "id" else _ranks(entities)
        left, right = (ranks[rows[side]] for side in comparison.sides)
        holds: Flags = _COMPARE[comparison.sign](left, right)
        rows = rows[0][holds], rows[1][holds]
    values: dict[PairColumn, list[Any]] = {}
    for column in lookup.columns:
        if column not in values:
            values[column] = entities.values(column.name, rows[column.side])
    if not lookup.columns:  # the SQL selects a constant
        return [(1,)] * len(rows[0])
    return list(zip(*(values[column] for column in lookup.columns), strict=True))


def _found(
    lookup: PairLookup, bound: BoundWorld, parameters: Mapping[str, Any]
) -> tuple[Indices, Indices]:
    """Returns the rows of the two entities of each pair that the search of a look-up finds."""
    search, distance = lookup.search, lookup.distance
    if search.of_boxes:
        found: IdPairs = search.function(bound.world.snapshot.boxes())
        return found.first, found.second
    shapes = bound.shapes(None, None)
    bound.warn_of_filled_meshes(search.function, shapes)
    if search.takes_distance:
        value = float(parameters[distance]) if isinstance(distance, str) else distance
        found = search.function(shapes, value)
    else:
        found = search.function(shapes)
    return found.first, found.second


def _ranks(entities: LiveTable) -> Indices:
    """Returns the place of each entity's name in their order; equal names have equal places."""
    names = entities.values("name")
    places = {name: place for place, name in enumerate(sorted(set(names)))}
    return np.array([places[name] for name in names], np.intp)
