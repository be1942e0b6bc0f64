"""Decides for many entities at once whether a point of the ground is over the footprint of each.

`ssduck.geometry.containment.Footprint` defines the footprint: the convex hull of the projections of
an entity's shapes on the ground. Support points in directions all around bound it from both sides:
it contains the polygon of these points, and is within the lines through them across the directions.
A verdict has more room than rounding errors, and the polyhedra that stand for round shapes, need.
"""

from __future__ import annotations

import math

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices, ranges
from ssduck.geometry.poses import rotate
from ssduck.geometry.proofs.verdicts import UNDECIDED, Verdicts
from ssduck.geometry.tick_shapes import TickShapes

OVER, OUTSIDE = 1, -1
# The polyhedron in the place of a round shape is off by less, relatively to its radius.
_ROUND_ERROR = 3e-3
# Points that are nearer to the boundary, metres, are not decided here.
_ROOM = 1e-6
# Beyond this distance from the origin, metres, rounding errors may be as large.
_MAX_COORDINATE = 1e6
# A half-space whose normal is nearer to level has a footprint that depends on the place.
_LEVEL = 1e-6


# The horizontal directions in which footprints are bounded, (3, 16), counterclockwise.
_ANGLES = np.arange(16) * (2.0 * math.pi / 16)
_DIRECTIONS = np.stack((np.cos(_ANGLES), np.sin(_ANGLES), np.zeros(16)))


def ground_boxes(boxes: Array, starts: Indices, entities: Indices) -> tuple[Array, Array]:
    """Returns the lower and the upper corners of entities' boxes on the ground, (2, n) each."""
    firsts = starts[:-1][starts[1:] > starts[:-1]]
    places = np.searchsorted(firsts, starts[entities])
    low = np.minimum.reduceat(boxes[:2], firsts, axis=1)
    high = np.maximum.reduceat(boxes[3:5], firsts, axis=1)
    return low.take(places, axis=1), high.take(places, axis=1)


def over_verdicts(
    tick: TickShapes,
    starts: Indices,
    a: Indices,
    centres: Array,
    boxes: tuple[Array, Array] | None = None,
) -> Verdicts:
    """Returns whether points of the ground are over entities: `OVER`, `OUTSIDE` or `UNDECIDED`."""
    verdicts, count = np.full(len(a), UNDECIDED, np.int8), len(starts) - 1
    has_centre = np.isfinite(centres).all(axis=0)
    verdicts[~has_centre] = OUTSIDE
    has_plane = np.zeros(len(a), dtype=bool)
    if tick.table.has_planes:
        has_plane = _have_planes(tick, count)[a]
        verdicts[has_centre & _have_steep_planes(tick, count)[a]] = OVER
    if boxes is not None:
        low, high = boxes
        with np.errstate(invalid="ignore"):  # the boxes of planes
            room = _ROOM + _ROUND_ERROR * (high - low).max(axis=0)
        is_beyond = ((centres < low - room) | (centres > high + room)).any(axis=0)
        verdicts[is_beyond & ~has_plane & has_centre] = OUTSIDE
    left = np.flatnonzero((verdicts == UNDECIDED) & ~has_plane)
    left = left[np.abs(centres[:, left]).max(axis=0, initial=0.0) <= _MAX_COORDINATE]
    if len(left):
        verdicts[left] = _over_bounded(tick, starts, a[left], centres[:, left])
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


def _over_bounded(tick: TickShapes, starts: Indices, a: Indices, centres: Array) -> Verdicts:
    """Returns whether points (2, n) of the ground are over entities (n,) without half-spaces."""
    entities, places = np.unique(a, return_inverse=True)
    shapes, owners = shapes_of(tick, starts, entities)
    points, error = _support_points(tick, shapes)
    if len(shapes) != len(entities):
        points, error = _of_entities(points, error, owners)
    verdicts = np.full(len(a), UNDECIDED, np.int8)
    room = error[places] + _ROOM
    # From each support point to the centre, across the direction and along the next edge.
    offsets = centres[:, None] - points.take(places, axis=2)
    beyond = np.einsum("cm,cmn->mn", _DIRECTIONS[:2], offsets).max(axis=0)
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
    owners, shapes = ranges(starts[entities], counts)
    has_points = tick.table.has_points[shapes]
    return shapes[has_points], owners[has_points]


def _support_points(tick: TickShapes, shapes: Indices) -> tuple[Array, Array]:
    """Returns the support points of shapes on the ground, (2, m, n), and their errors, (n,)."""
    cores = tick.table.cores
    points = tick.placed_cores.support_points_all_around(shapes, _DIRECTIONS)[:2]
    points += tick.placed_cores.centres[:2, None].take(shapes, axis=2)
    radius = cores.radius[shapes]
    points += _DIRECTIONS[:2, :, None] * radius
    return points, _ROUND_ERROR * cores.largest_radius[shapes]


def _of_entities(points: Array, error: Array, owners: Indices) -> tuple[Array, Array]:
    """Returns the support points and the errors of entities, of those of their shapes."""
    heights = np.einsum("cm,cmn->mn", _DIRECTIONS[:2], points)
    firsts = np.flatnonzero(np.diff(owners, prepend=-1))
    highest = np.maximum.reduceat(heights, firsts, axis=1)
    is_highest = heights == highest.take(owners, axis=1)
    places = np.where(is_highest, np.arange(len(owners)), len(owners))
    farthest = np.minimum.reduceat(places, firsts, axis=1)
    chosen: Array = points[:, np.arange(len(heights))[:, None], farthest]
    return chosen, np.maximum.reduceat(error, firsts)
