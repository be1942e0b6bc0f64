"""Decides for many pairs of entities at once whether one's centre is over the other's footprint.

`ssduck.geometry.containment.Footprint` defines the footprint: the convex hull of the projections of
an entity's shapes on the ground. That of a box has a formula. Support points in directions all
around bound other footprints from both sides.
A verdict has more room than rounding errors, and the polyhedra that stand for round shapes, need.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.poses import rotate
from ssduck.geometry.proofs.verdicts import UNDECIDED, Verdicts
from ssduck.geometry.tick_shapes import TickShapes

OVER, OUTSIDE = 1, -1
# The polyhedron in the place of a round shape is off by less, relatively to its radius.
_ROUND_ERROR = 3e-3
# Points that are nearer to the boundary, metres, are not decided here.
_ROOM = 1e-6
# An edge of a box whose sine to up is less has no direction on the ground.
_MIN_SINE = 1e-8
# What is added to the room of a box, relatively to its size, since such an edge is left out.
_BOX_ERROR = 1e-6
# Among others, fewer boxes are decided together with these.
_MIN_BOXES = 8
# Beyond this distance from the origin, metres, rounding errors may be as large.
_MAX_COORDINATE = 1e6
# A half-space whose normal is nearer to level has a footprint that depends on the place.
_LEVEL = 1e-6


def _around(count: int) -> Array:
    """Returns horizontal unit directions, (3, count), counterclockwise."""
    angles = np.arange(count) * (2.0 * math.pi / count)
    return np.stack((np.cos(angles), np.sin(angles), np.zeros(count)))


# The directions in which footprints are bounded, and those for the few that are left.
_DIRECTIONS, _MANY_DIRECTIONS = _around(16), _around(128)


def entity_boxes(boxes: Array, starts: Sequence[int] | Indices) -> Array:
    """Returns the boxes around the shapes of entities, (6, entities); empty ones without shapes.

    Args:
        boxes: (6, shapes), lower corners, upper corners.
        starts: the first shape of each entity, and the number of shapes.
    """
    firsts = np.asarray(starts)
    has_shapes = firsts[1:] > firsts[:-1]
    if has_shapes.all() and len(has_shapes) == boxes.shape[1]:
        return boxes
    result = np.repeat([[math.inf]] * 3 + [[-math.inf]] * 3, len(has_shapes), axis=1)
    segments = firsts[:-1][has_shapes]
    if len(segments):
        result[:3, has_shapes] = np.minimum.reduceat(boxes[:3], segments, axis=1)
        result[3:, has_shapes] = np.maximum.reduceat(boxes[3:], segments, axis=1)
    return result


def over_verdicts(
    tick: TickShapes, starts: Sequence[int] | Indices, a: Indices, b: Indices
) -> Verdicts:
    """Returns whether the centre of b's box is over a: `OVER`, `OUTSIDE` or `UNDECIDED`.

    See `finer_over_verdicts` for the few that it leaves undecided.

    Args:
        tick: the shapes.
        starts: the first shape of each entity, and the number of shapes.
        a: (n,), known entities with shapes, below.
        b: (n,), the entities above.
    """
    verdicts, table = np.full(len(a), UNDECIDED, np.int8), tick.table
    firsts = np.asarray(starts)
    with np.errstate(invalid="ignore"):  # the boxes of planes
        boxes = entity_boxes(tick.boxes, firsts)
        centres = (boxes[:2].take(b, axis=1) + boxes[3:5].take(b, axis=1)) / 2
    has_centre = np.isfinite(centres).all(axis=0)
    verdicts[~has_centre] = OUTSIDE
    room = np.full(len(a), _ROOM)
    low, high = boxes[:2].take(a, axis=1), boxes[3:5].take(a, axis=1)
    has_plane = np.zeros(len(a), dtype=bool)
    if table.has_planes:
        has_plane = _have_planes(tick, len(boxes[0]))[a]
        verdicts[has_centre & _have_steep_planes(tick, len(boxes[0]))[a]] = OVER
    with np.errstate(invalid="ignore"):
        room += _ROUND_ERROR * (high - low).max(axis=0)
    is_beyond = ((centres < low - room) | (centres > high + room)).any(axis=0)
    verdicts[is_beyond & ~has_plane & has_centre] = OUTSIDE
    left = np.flatnonzero((verdicts == UNDECIDED) & ~has_plane)
    left = left[np.abs(centres[:, left]).max(axis=0, initial=0.0) <= _MAX_COORDINATE]
    rules = [_over_balls, _over_boxes]
    if np.count_nonzero(_are_boxes(tick, firsts, a[left])) >= _MIN_BOXES:
        rules.reverse()  # it decides many boxes at once, those over balls too
    for rule in rules:
        if len(left):
            found = rule(tick, firsts, a[left], centres[:, left])
            verdicts[left] = found
            left = left[found == UNDECIDED]
    if len(left):
        verdicts[left] = _over_bounded(tick, firsts, a[left], centres[:, left], _DIRECTIONS)
    return verdicts


def finer_over_verdicts(
    tick: TickShapes, starts: Sequence[int] | Indices, a: Indices, b: Indices
) -> Verdicts:
    """Returns the same by more directions, for the pairs that need it of those left undecided."""
    verdicts, table = np.full(len(a), UNDECIDED, np.int8), tick.table
    firsts = np.asarray(starts)
    with np.errstate(invalid="ignore"):  # the boxes of planes
        boxes = entity_boxes(tick.boxes, firsts)
        centres = (boxes[:2].take(b, axis=1) + boxes[3:5].take(b, axis=1)) / 2
    is_bounded = np.abs(centres).max(axis=0, initial=0.0) <= _MAX_COORDINATE
    if table.has_planes:
        is_bounded &= ~_have_planes(tick, len(boxes[0]))[a]
    left = np.flatnonzero(is_bounded)
    if len(left):
        verdicts[left] = _over_bounded(tick, firsts, a[left], centres[:, left], _MANY_DIRECTIONS)
    return verdicts


def _have_planes(tick: TickShapes, count: int) -> Flags:
    """Checks whether a shape of each entity is a half-space."""
    table = tick.table
    have: Flags = np.bincount(table.entities[table.is_plane], minlength=count) > 0
    return have


def _have_steep_planes(tick: TickShapes, count: int) -> Flags:
    """Checks whether a half-space of each entity, which is not upright, has all of the ground."""
    table = tick.table
    planes = np.flatnonzero(table.is_plane & tick.is_known)
    heights = rotate(tick.matrices[planes], table.normal[planes])[:, 2]
    have: Flags = np.zeros(count, dtype=bool)
    have[table.entities[planes[np.abs(heights) > _LEVEL]]] = True
    return have


def _over_balls(tick: TickShapes, starts: Indices, a: Indices, centres: Array) -> Verdicts:
    """Returns which points (2, n) of the ground are surely over the balls in entities (n,).

    A ball has no footprint smaller than its own: whatever else its entity has only adds to it.
    """
    shapes = starts[a]
    radii = tick.table.inscribed_radius.take(shapes) * (1.0 - _ROUND_ERROR) - _ROOM
    offsets = centres - tick.placed_cores.inscribed_centres[:2].take(shapes, axis=1)
    verdicts = np.full(len(a), UNDECIDED, np.int8)
    verdicts[np.hypot(offsets[0], offsets[1]) < radii] = OVER
    return verdicts


def _are_boxes(tick: TickShapes, starts: Indices, entities: Indices) -> Flags:
    """Checks whether entities that have shapes consist of a box."""
    shapes = starts[entities]
    are: Flags = tick.table.is_box[shapes] & (starts[entities + 1] - shapes == 1)
    return are


def _over_boxes(tick: TickShapes, starts: Indices, a: Indices, centres: Array) -> Verdicts:
    """Returns whether points (2, n) of the ground are over entities (n,) that are a box.

    A few among others are decided together with these.
    """
    verdicts = np.full(len(a), UNDECIDED, np.int8)
    places = np.flatnonzero(_are_boxes(tick, starts, a))
    if len(places) >= min(_MIN_BOXES, len(a)):
        verdicts[places] = _over_footprints(tick, starts[a[places]], centres[:, places])
    return verdicts


def _over_footprints(tick: TickShapes, boxes: Indices, centres: Array) -> Verdicts:
    """Returns whether points (2, n) of the ground are over boxes (n,).

    The footprint of a box is a zonogon: it is between two lines along the projection of each edge.
    """
    cores = tick.placed_cores
    half_extents = cores.cores.half_extents.take(boxes, axis=1)
    axes = cores.rotations.take(boxes, axis=1).reshape(3, 3, -1)[:2]
    offsets = centres - cores.centres[:2].take(boxes, axis=1)
    sines = np.sqrt(axes[0] * axes[0] + axes[1] * axes[1])
    # The cross product of an axis with another edge: of unit axes, the distance of lines.
    edges = axes * half_extents
    widths = np.abs(axes[0, :, None] * edges[1] - axes[1, :, None] * edges[0]).sum(axis=1)
    beyond = np.abs(axes[0] * offsets[1] - axes[1] * offsets[0]) - widths
    has_line = sines > _MIN_SINE
    beyond /= np.where(has_line, sines, 1.0)
    farthest = np.where(has_line, beyond, -math.inf).max(axis=0)
    room = _ROOM + _BOX_ERROR * half_extents.max(axis=0)
    verdicts = np.full(len(boxes), UNDECIDED, np.int8)
    verdicts[farthest > room] = OUTSIDE
    verdicts[farthest < -room] = OVER
    return verdicts


def _over_bounded(
    tick: TickShapes, starts: Indices, a: Indices, centres: Array, directions: Array
) -> Verdicts:
    """Returns whether points (2, n) of the ground are over entities (n,) without half-spaces."""
    entities, places = np.unique(a, return_inverse=True)
    shapes, owners = shapes_of(tick, starts, entities)
    points, error = _support_points(tick, shapes, directions)
    if len(shapes) != len(entities):
        points, error = _of_entities(points, error, owners, directions)
    verdicts = np.full(len(a), UNDECIDED, np.int8)
    room = error[places] + _ROOM
    # From each support point to the centre, across the direction and along the next edge.
    offsets = centres[:, None] - points.take(places, axis=2)
    beyond = np.einsum("cm,cmn->mn", directions[:2], offsets).max(axis=0)
    verdicts[beyond > room] = OUTSIDE
    edges = np.roll(points, -1, axis=1) - points
    lengths = np.sqrt((edges * edges).sum(axis=0))
    is_edge = lengths > 0.0
    edges /= np.where(is_edge, lengths, 1.0)
    edges, is_edge = edges.take(places, axis=2), is_edge.take(places, axis=1)
    depths = edges[0] * offsets[1] - edges[1] * offsets[0]
    inside = np.where(is_edge, depths, math.inf).min(axis=0) > room
    verdicts[inside & (is_edge.sum(axis=0) >= 3)] = OVER
    return verdicts


def shapes_of(tick: TickShapes, starts: Indices, entities: Indices) -> tuple[Indices, Indices]:
    """Returns the shapes of entities that have points, and the place of each one's entity."""
    counts = starts[entities + 1] - starts[entities]
    if (counts == 1).all() and tick.table.has_points.all():
        return starts[entities], np.arange(len(entities))
    owners = np.repeat(np.arange(len(entities)), counts)
    offsets = np.arange(len(owners)) - np.repeat(np.cumsum(counts) - counts, counts)
    shapes = starts[entities][owners] + offsets
    has_points = tick.table.has_points[shapes]
    return shapes[has_points], owners[has_points]


def _support_points(tick: TickShapes, shapes: Indices, directions: Array) -> tuple[Array, Array]:
    """Returns the support points of shapes on the ground, (2, m, n), and their errors, (n,)."""
    cores = tick.table.cores
    points = tick.placed_cores.support_points_all_around(shapes, directions)[:2]
    points += tick.placed_cores.centres[:2, None].take(shapes, axis=2)
    radius = cores.radius[shapes]
    points += directions[:2, :, None] * radius
    return points, _ROUND_ERROR * cores.largest_radius[shapes]


def _of_entities(
    points: Array, error: Array, owners: Indices, directions: Array
) -> tuple[Array, Array]:
    """Returns the support points and the errors of entities, of those of their shapes."""
    heights = np.einsum("cm,cmn->mn", directions[:2], points)
    firsts = np.flatnonzero(np.diff(owners, prepend=-1))
    highest = np.maximum.reduceat(heights, firsts, axis=1)
    is_highest = heights == highest.take(owners, axis=1)
    places = np.where(is_highest, np.arange(len(owners)), len(owners))
    farthest = np.minimum.reduceat(places, firsts, axis=1)
    chosen: Array = points[:, np.arange(len(heights))[:, None], farthest]
    return chosen, np.maximum.reduceat(error, firsts)
