"""Decides for many pairs of touching entities at once whether the second is on the first.

`NarrowPhase.on` defines it: a contact normal is within 30 degrees of up, and the centre of the
second's box is over the footprint of the first. A verdict here is proved, with more room than
rounding errors need. The narrow phase decides all other pairs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.batch import TickShapes
from ssduck.geometry.contact_support import MIN_UP
from ssduck.geometry.distance import NEIGHBOUR_DIRECTIONS
from ssduck.geometry.gjk import ABOVE, BELOW, UNDECIDED, Verdicts
from ssduck.geometry.poses import rotate
from ssduck.geometry.separating_axes import box_axes

# The verdicts.
ON, NOT_ON = BELOW, ABOVE
# The polyhedron in the place of a round shape's footprint leaves its box by less, relatively.
_ROUND_ERROR = 3e-3
# Overlaps that differ by less, metres, may have either normal.
_TIE = 1e-8
# Boxes whose gap is larger, metres, are apart; their nearest points decide.
_MAX_GAP = 5e-10
# Beyond this distance from the origin, metres, rounding errors may be as large.
_MAX_COORDINATE = 100.0
# What is nearer to a boundary, metres, is not decided here; relatively for directions.
_ROOM = 1e-6
_UP_ROOM = 1e-9
# Directions near up: each one within `MIN_UP` is within an angle of `_CELL` of one of them.
_CELL = math.radians(9.0)
_RINGS = ((0.0, 1), (13.0, 6), (26.0, 12))
_UPWARD = np.array(
    [
        [
            math.sin(math.radians(tilt)) * math.cos(2.0 * math.pi * place / count),
            math.sin(math.radians(tilt)) * math.sin(2.0 * math.pi * place / count),
            math.cos(math.radians(tilt)),
        ]
        for tilt, count in _RINGS
        for place in range(count)
    ]
)


def entity_boxes(boxes: Array, starts: Sequence[int]) -> Array:
    """Returns the boxes around the shapes of entities, (entities, 6); empty ones without shapes.

    Args:
        boxes: (shapes, 6), lower corner, upper corner.
        starts: the first shape of each entity, and the number of shapes.
    """
    firsts = np.array(starts)
    has_shapes = firsts[1:] > firsts[:-1]
    result = np.repeat([[math.inf] * 3 + [-math.inf] * 3], len(has_shapes), axis=0)
    segments = firsts[:-1][has_shapes]
    if len(segments):
        result[has_shapes, :3] = np.minimum.reduceat(boxes[:, :3], segments)
        result[has_shapes, 3:] = np.maximum.reduceat(boxes[:, 3:], segments)
    return result


def on_verdicts(
    tick: TickShapes, boxes: Array, starts: Sequence[int], a: Indices, b: Indices
) -> Verdicts:
    """Returns whether b is on a, for pairs of entities that touch: `ON`, `NOT_ON` or `UNDECIDED`.

    Args:
        tick: the shapes.
        boxes: (entities, 6), the boxes of the entities.
        starts: the first shape of each entity, and the number of shapes.
        a: (n,), the lower entities.
        b: (n,), the upper entities.
    """
    verdicts = np.full(len(a), UNDECIDED, np.int8)
    firsts = np.array(starts)
    table = tick.table
    has_plane = np.bincount(table.entities[table.is_plane], minlength=len(boxes)) > 0
    with np.errstate(invalid="ignore"):  # the boxes of planes
        verdicts[~_may_be_over(boxes[a], boxes[b]) & ~has_plane[a]] = NOT_ON
        is_single = (firsts[1:] - firsts[:-1] == 1)[: len(boxes)]
        left = np.flatnonzero((verdicts == UNDECIDED) & is_single[a] & is_single[b])
        s, t = firsts[a[left]], firsts[b[left]]
        verdicts[left[_is_not_upward_by_balls(tick, s, t)]] = NOT_ON
        are_boxes = (verdicts[left] == UNDECIDED) & table.is_box[s] & table.is_box[t]
        left, s, t = left[are_boxes], s[are_boxes], t[are_boxes]
        if len(left):
            upward, over = _upward_boxes(tick, s, t), _over_boxes(tick, s, boxes[b[left]])
            verdicts[left[(upward == ON) & (over == ON)]] = ON
            verdicts[left[(upward == NOT_ON) | (over == NOT_ON)]] = NOT_ON
        left = np.flatnonzero((verdicts == UNDECIDED) & is_single[a] & is_single[b])
        if len(left):
            s, t = firsts[a[left]], firsts[b[left]]
            verdicts[left[_is_not_upward_by_points(tick, s, t)]] = NOT_ON
    return verdicts


def _may_be_over(boxes_a: Array, boxes_b: Array) -> Flags:
    """Checks whether the centres of boxes are over other boxes, with room for round footprints."""
    centres = (boxes_b[:, :2] + boxes_b[:, 3:5]) / 2
    low, high = boxes_a[:, :2], boxes_a[:, 3:5]
    room = _ROOM + _ROUND_ERROR * (high - low).max(axis=1, keepdims=True, initial=0.0)
    is_over: Flags = ((centres >= low - room) & (centres <= high + room)).all(axis=1)
    return is_over


def _are_bounded(tick: TickShapes, first: Indices, second: Indices) -> Flags:
    """Checks whether both shapes are convex and bounded."""
    has_verdict = tick.table.is_convex & ~tick.table.is_plane
    are_bounded: Flags = has_verdict[first] & has_verdict[second]
    return are_bounded


def _is_not_upward_by_balls(tick: TickShapes, first: Indices, second: Indices) -> Flags:
    """Checks whether the contact normal from the first to the second certainly is not upward.

    The overlap along the contact normal is the least of all directions. The balls in two convex
    shapes bound the overlap along each direction near up from below. Where that is more than the
    least overlap along the axes of the world, the normal is another direction.
    """
    table = tick.table
    radii = table.inscribed_radius[first], table.inscribed_radius[second]
    is_bounded = (radii[0] > 0.0) & (radii[1] > 0.0) & _are_bounded(tick, first, second)
    offsets = tick.inscribed_centres[first] - tick.inscribed_centres[second]
    least = _least_product(offsets, np.array([0.0, 0.0, 1.0]), math.acos(MIN_UP))
    boxes_a, boxes_b = tick.boxes[:, first], tick.boxes[:, second]
    overlaps = np.minimum(boxes_a[3:] - boxes_b[:3], boxes_b[3:] - boxes_a[:3]).min(axis=0)
    is_not: Flags = is_bounded & (least + radii[0] + radii[1] > overlaps + 2 * _ROOM)
    return is_not


def _is_not_upward_by_points(tick: TickShapes, first: Indices, second: Indices) -> Flags:
    """Checks the same by support points in directions all around, and in directions near up.

    A support point of the difference of two shapes bounds their overlap from below along each
    direction near that for which it was computed. The directions around are those with which
    `ssduck.geometry.distance` begins, so that its normal has at most their least overlap.
    """
    cores, pairs = tick.placed_cores, len(first)
    directions = np.concatenate((NEIGHBOUR_DIRECTIONS, _UPWARD))
    count = len(directions)
    tiled = np.tile(directions.T, pairs)
    points = cores.support_points(np.repeat(first, count), tiled)
    points -= cores.support_points(np.repeat(second, count), -tiled)
    points += np.repeat(cores.centres[:, first] - cores.centres[:, second], count, axis=1)
    by_pair = points.T.reshape(pairs, count, 3)
    heights = np.einsum("nkc,kc->nk", by_pair, directions)
    overlaps = heights[:, : len(NEIGHBOUR_DIRECTIONS)].min(axis=1)
    # The best bound of all points in each cell of directions near up, and that of the worst cell.
    bounds = _least_product(by_pair[:, :, None], _UPWARD, _CELL).max(axis=1).min(axis=1)
    is_not: Flags = _are_bounded(tick, first, second) & (bounds > overlaps + 2 * _ROOM)
    return is_not


def _least_product(vectors: Array, directions: Array, angle: float) -> Array:
    """Returns the least product of vectors (…, 3) with a unit vector within an angle of directions.

    The angle is at most a right one.
    """
    along = (vectors * directions).sum(axis=-1)
    squares = (vectors * vectors).sum(axis=-1)
    across = np.sqrt(np.maximum(squares - along * along, 0.0))
    # The vector itself, backwards, is near the directions.
    is_opposite = -along >= math.cos(angle) * np.sqrt(squares)
    least: Array = np.where(
        is_opposite, -np.sqrt(squares), along * math.cos(angle) - across * math.sin(angle)
    )
    return least


def _upward_boxes(tick: TickShapes, first: Indices, second: Indices) -> Verdicts:
    """Returns whether the contact normals of boxes from the first to the second are upward.

    It is the axis of least overlap of boxes that overlap. All axes that rounding errors could make
    the least must agree.
    """
    axes = box_axes(tick, first, second)
    least = axes.overlaps.min(axis=1)
    is_least = axes.overlaps <= least[:, None] + _TIE
    rising = axes.directions_z
    # Where the centres are level along an axis, its other direction has the same overlap.
    is_either = is_least & (axes.distances <= _TIE)
    lowest = np.where(is_either, -np.abs(rising), rising)
    highest = np.where(is_either, np.abs(rising), rising)
    size = np.abs(tick.positions).max(axis=1, initial=0.0) + tick.table.bounding_radius
    is_sure = (least >= -_MAX_GAP) & ~axes.is_doubtful
    is_sure &= np.maximum(size[first], size[second]) <= _MAX_COORDINATE
    upward = np.where(is_least, lowest, math.inf).min(axis=1) >= MIN_UP + _UP_ROOM
    not_upward = np.where(is_least, highest, -math.inf).max(axis=1) <= MIN_UP - _UP_ROOM
    verdicts = np.full(len(first), UNDECIDED, np.int8)
    verdicts[is_sure & upward] = ON
    verdicts[is_sure & not_upward] = NOT_ON
    return verdicts


def _over_boxes(tick: TickShapes, shapes: Indices, boxes: Array) -> Verdicts:
    """Returns whether the centres of world boxes (n, 6) are over turned boxes.

    The vertical line through a centre crosses a box that is smaller by some room, or not even one
    that is larger by it.
    """
    centres = (boxes[:, :3] + boxes[:, 3:]) / 2
    centres[:, 2] = tick.positions[shapes, 2]
    inverse = tick.matrices[shapes].transpose(0, 2, 1)
    starts = rotate(inverse, centres - tick.positions[shapes])
    directions = inverse[:, :, 2]
    halves = tick.table.cores.half_extents[:, shapes].T
    verdicts = np.full(len(shapes), UNDECIDED, np.int8)
    verdicts[_crosses(starts, directions, halves - _ROOM)] = ON
    is_thick = (halves > _ROOM).all(axis=1)  # a flat footprint has a wider boundary
    verdicts[~_crosses(starts, directions, halves + _ROOM) & is_thick] = NOT_ON
    return verdicts


def _crosses(starts: Array, directions: Array, halves: Array) -> Flags:
    """Checks whether lines cross boxes around the origin; all are (n, 3)."""
    is_level = np.abs(directions) < 1e-12
    divisors = np.where(is_level, 1.0, directions)
    near, far = (-halves - starts) / divisors, (halves - starts) / divisors
    enter = np.where(is_level, -math.inf, np.minimum(near, far)).max(axis=1)
    leave = np.where(is_level, math.inf, np.maximum(near, far)).min(axis=1)
    is_between = (~is_level | (np.abs(starts) <= halves)).all(axis=1)
    crosses: Flags = is_between & (enter <= leave) & (halves > 0.0).all(axis=1)
    return crosses
