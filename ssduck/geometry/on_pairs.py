"""Decides for all pairs of touching entities of a tick at once whether the second is on the first.

`NarrowPhase.on` defines it: a contact normal is within 30 degrees of up, and the centre of the
second's box is over the footprint of the first. A verdict here is proved, with more room than
rounding errors need. The narrow phase decides what is left, one pair of shapes at a time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from ssduck.geometry.arrays import Flags, Indices
from ssduck.geometry.batch import kept_verdicts, pairs_of_boxes, touching_verdicts
from ssduck.geometry.broad_phase import Pairs
from ssduck.geometry.contact_support import MIN_UP
from ssduck.geometry.narrow_phase import NarrowPhase
from ssduck.geometry.poses import rotate
from ssduck.geometry.proofs.contact_directions import NOT_UPWARD, UPWARD, decide_upward
from ssduck.geometry.proofs.footprints import OUTSIDE, OVER, ground_boxes, over_verdicts
from ssduck.geometry.proofs.separating_axes import box_axes
from ssduck.geometry.proofs.verdicts import ABOVE, BELOW, UNDECIDED, Decisions, Verdicts
from ssduck.geometry.tick_shapes import PairPredicate, TickShapes
from ssduck.geometry.tick_solids import TOUCHING_DISTANCE

# Overlaps that differ by less, metres, may have either normal.
_TIE = 1e-8
# Boxes whose gap is larger, metres, are apart; their nearest points decide.
_MAX_GAP = 5e-10
# Beyond this distance from the origin, metres, rounding errors may be as large.
_MAX_COORDINATE = 100.0
# Heights of normals that are nearer to the least one are not decided here.
_UP_ROOM = 1e-9


@dataclass(frozen=True, eq=False)
class _ShapePairs:
    """Pairs of shapes of pairs of entities."""

    rows: Indices  # (n,), the pair of entities of each
    first: Indices  # (n,), the shapes of the lower entity
    second: Indices  # (n,), those of the upper one
    touch: Flags  # (n,), whether they surely touch; the others may touch


def are_on(narrow: NarrowPhase, a: Indices, b: Indices) -> Flags:
    """Returns whether b is on a, for pairs of known entities that touch, (n,)."""
    result = np.zeros(len(a), dtype=bool)
    tick, starts = narrow.arrays, np.array(narrow.starts)
    with np.errstate(invalid="ignore"):  # the boxes of planes
        low, high = ground_boxes(tick.boxes, starts, b)
        centres = (low + high) / 2
    over = over_verdicts(tick, starts, a, centres, ground_boxes(tick.boxes, starts, a))
    rows = np.flatnonzero(over != OUTSIDE)
    if not len(rows):
        return result
    shapes = _touching_shapes(tick, starts, rows, a, b)
    ordered = shapes.first, shapes.second
    upward = kept_verdicts(
        tick,
        tick.table.kept_upward,
        ordered,
        partial(decide_contacts, tick, min_height=MIN_UP),
    )
    is_carried = np.zeros(len(a), dtype=bool)
    is_carried[shapes.rows[(upward == UPWARD) & shapes.touch]] = True
    result[is_carried & (over == OVER)] = True
    open_shapes: dict[int, list[tuple[int, int]]] = {}
    for place in np.flatnonzero((upward != NOT_UPWARD) & ~result[shapes.rows]).tolist():
        pair = int(shapes.first[place]), int(shapes.second[place])
        open_shapes.setdefault(int(shapes.rows[place]), []).append(pair)
    for row, pairs in open_shapes.items():
        if over[row] == OVER or narrow.is_over(int(a[row]), int(b[row])):
            result[row] = is_carried[row] or any(_is_upward(narrow, s, t) for s, t in pairs)
    return result


def _is_upward(narrow: NarrowPhase, s: int, t: int) -> bool:
    height = narrow.shapes.contact_height(s, t)
    return height is not None and height >= MIN_UP


def _touching_shapes(
    tick: TickShapes, starts: Indices, rows: Indices, a: Indices, b: Indices
) -> _ShapePairs:
    """Returns the pairs of shapes that may touch, of pairs of entities that touch."""
    if tick.table.has_single_shapes:
        firsts, seconds = starts.take(a.take(rows)), starts.take(b.take(rows))
        return _ShapePairs(rows, firsts, seconds, np.ones(len(rows), dtype=bool))
    touching = PairPredicate("touching", TOUCHING_DISTANCE)
    first, second = _of_rows(tick, touching.candidates(tick), a[rows], b[rows])
    verdicts = touching_verdicts(tick, (first, second), touching)
    near = verdicts != ABOVE
    first, second, touch = first[near], second[near], (verdicts == BELOW)[near]
    first, second = np.concatenate((first, second)), np.concatenate((second, first))
    entities, count = tick.table.entities, len(starts)
    keys = a[rows] * count + b[rows]
    order = np.argsort(keys)
    wanted = entities[first] * count + entities[second]
    places = np.minimum(np.searchsorted(keys, wanted, sorter=order), len(keys) - 1)
    found = np.flatnonzero(keys[order[places]] == wanted)
    return _ShapePairs(
        rows[order[places[found]]], first[found], second[found], np.tile(touch, 2)[found]
    )


def _of_rows(tick: TickShapes, shapes: Pairs, a: Indices, b: Indices) -> Pairs:
    """Returns the pairs of shapes that belong to pairs of entities, in either order."""
    first, second = shapes
    entities, count = tick.table.entities, tick.table.count
    low, high = np.minimum(a, b), np.maximum(a, b)
    i, j = entities[first], entities[second]
    wanted = np.isin(np.minimum(i, j) * count + np.maximum(i, j), low * count + high)
    return first[wanted], second[wanted]


def decide_contacts(
    tick: TickShapes, first: Indices, second: Indices, min_height: float
) -> Decisions:
    """Decides whether contact normals point up: `UPWARD`, `NOT_UPWARD` or `UNDECIDED`.

    The room of a verdict is how far the shapes may move relative to each other before a normal may
    turn so far; it is 0 for boxes and half-spaces, whose normals turn with them.
    """
    table, decisions = tick.table, Decisions.none(len(first))
    verdicts = decisions.verdicts
    are_boxes = pairs_of_boxes(table, first, second)
    if len(are_boxes):
        of_boxes = first[are_boxes], second[are_boxes]
        verdicts[are_boxes] = _upward_boxes(tick, *of_boxes, min_height)
    if table.has_planes:
        on_planes = np.flatnonzero(table.is_plane[first] & ~table.is_plane[second])
        heights = rotate(tick.matrices, table.normal)[first[on_planes], 2]
        verdicts[on_planes[heights >= min_height + _UP_ROOM]] = UPWARD
        verdicts[on_planes[heights <= min_height - _UP_ROOM]] = NOT_UPWARD
    are_bounded = table.is_convex & ~table.is_plane
    left = np.flatnonzero((verdicts == UNDECIDED) & are_bounded[first] & are_bounded[second])
    if len(left):
        found = decide_upward(tick.placed_cores, first[left], second[left], min_height)
        decisions.decide(left, found.verdicts, found.room)
    return decisions


def _upward_boxes(tick: TickShapes, first: Indices, second: Indices, min_height: float) -> Verdicts:
    """Returns whether the contact normals of boxes from the first to the second are upward."""
    axes = box_axes(tick.placed_cores, first, second)
    least = axes.overlaps.min(axis=0)
    is_least = axes.overlaps <= least + _TIE
    rising = axes.directions_z
    # Where the centres are level along an axis, its other direction has the same overlap.
    is_either = is_least & (axes.distances <= _TIE)
    lowest = np.where(is_either, -np.abs(rising), rising)
    highest = np.where(is_either, np.abs(rising), rising)
    size = np.abs(tick.positions).max(axis=1, initial=0.0) + tick.table.bounding_radius
    is_sure = (least >= -_MAX_GAP) & ~axes.is_doubtful
    is_sure &= np.maximum(size[first], size[second]) <= _MAX_COORDINATE
    upward = np.where(is_least, lowest, math.inf).min(axis=0) >= min_height + _UP_ROOM
    not_upward = np.where(is_least, highest, -math.inf).max(axis=0) <= min_height - _UP_ROOM
    verdicts = np.full(len(first), UNDECIDED, np.int8)
    verdicts[is_sure & upward] = UPWARD
    verdicts[is_sure & not_upward] = NOT_UPWARD
    return verdicts
