"""Decides for many pairs of round shapes at once whether their contact normal points up.

A sphere and a capsule consist of all that is near their core, a point or a segment. While the cores
of two shapes are apart, their contact normal is the direction of the nearest points of the cores,
also if the shapes overlap. Projecting a point on one core and on the other, in turns, finds these
points (von Neumann 1950), for a sphere at once.

The points need not be exact. The difference of any two points of the cores is a point of the cores'
difference, which bounds the overlaps in all directions from below. The support point in its
direction bounds the least overlap from above. The contact normal is in the cone of directions in
which the one bound is below the other.
"""

from __future__ import annotations

import math

import numpy as np

from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.proofs.columns import column_lengths
from ssduck.geometry.proofs.contact_directions import NOT_UPWARD, UPWARD, contact_room
from ssduck.geometry.proofs.cores import PlacedCores
from ssduck.geometry.proofs.direction_triangles import HEIGHT_ROOM
from ssduck.geometry.proofs.verdicts import Decisions

# The number of further projections on each of two cores, if none is a point.
_MORE_PROJECTIONS = 2


def decide_upward_round(
    cores: PlacedCores, first: Indices, second: Indices, min_height: float, min_count: int = 1
) -> Decisions:
    """Decides whether contact normals point up: `UPWARD`, `NOT_UPWARD` or `UNDECIDED`.

    Args:
        cores: the shapes.
        first: (n,), bounded convex shapes.
        second: (n,), the same; normals point from the first to the second.
        min_height: the least z of an upward unit normal, from 0 to 1.
        min_count: fewer pairs of round shapes stay undecided.
    """
    decisions = Decisions.none(len(first))
    has_projection, radius = (cores.cores.kind < 0) & ~cores.cores.is_ellipsoid, cores.cores.radius
    has_formula = has_projection[first] & has_projection[second]
    places = np.flatnonzero(has_formula & (radius[first] + radius[second] > 0.0))
    if len(places) >= max(1, min_count):
        found = _decide(cores, first[places], second[places], min_height)
        decisions.decide(places, found.verdicts, found.room)
    return decisions


def _decide(cores: PlacedCores, first: Indices, second: Indices, min_height: float) -> Decisions:
    """Decides pairs without hulls and ellipsoids."""
    points = _difference_points(cores, first, second)
    lengths = column_lengths(points)
    directions = points / np.maximum(lengths, 1e-300)
    support = cores.centres.take(first, axis=1) - cores.centres.take(second, axis=1)
    support += cores.support_points(first, -directions)
    support -= cores.support_points(second, directions)
    # Of the cores' distance: that of the support point is less, that of the points is greater.
    distances = np.einsum("cn,cn->n", directions, support)
    reached = distances - contact_room(cores, first, second)
    tilts = np.arccos(np.clip(-directions[2], -1.0, 1.0))
    decisions = Decisions.none(len(first))
    for verdict, sign in ((UPWARD, 1.0), (NOT_UPWARD, -1.0)):
        # The cone reaches the least height at this angle. A motion changes both bounds.
        angles = sign * (math.acos(min(min_height + sign * HEIGHT_ROOM, 1.0)) - tilts)
        needed = lengths * np.cos(np.minimum(angles, math.pi / 2.0))
        decided = np.flatnonzero((angles > 0.0) & (reached > needed))
        decisions.decide(decided, verdict, (reached - needed)[decided] / 2.0)
    return decisions


def _difference_points(cores: PlacedCores, first: Indices, second: Indices) -> Array:
    """Returns points (3, n) of the differences of cores that are nearly nearest to the origin."""
    on_second = cores.centres.take(second, axis=1)
    on_first = _nearest_points(cores, first, on_second)
    on_second = _nearest_points(cores, second, on_first)
    size = cores.cores.half_extents[2] + cores.cores.disc_radius
    are_long = np.flatnonzero((size[first] > 0.0) & (size[second] > 0.0))
    if len(are_long):
        first, second, some = first[are_long], second[are_long], on_second[:, are_long]
        for _ in range(_MORE_PROJECTIONS):
            others = _nearest_points(cores, first, some)
            some = _nearest_points(cores, second, others)
        on_first[:, are_long], on_second[:, are_long] = others, some
    return on_first - on_second


def _nearest_points(cores: PlacedCores, shapes: Indices, points: Array) -> Array:
    """Returns the points of cores without corners that are nearest to points (3, n), (3, n)."""
    half_extents, disc = (
        cores.cores.half_extents.take(shapes, axis=1),
        cores.cores.disc_radius[shapes],
    )
    rotations = cores.rotations.take(shapes, axis=1).reshape(3, 3, -1)
    centres = cores.centres.take(shapes, axis=1)
    local = np.einsum("ijn,in->jn", rotations, points - centres)
    nearest = np.minimum(np.maximum(local, -half_extents), half_extents)
    if disc.any():
        length = np.maximum(np.sqrt(local[0] * local[0] + local[1] * local[1]), 1e-300)
        nearest[:2] += local[:2] * np.minimum(disc / length, disc > 0.0)
    placed: Array = np.einsum("ijn,jn->in", rotations, nearest)
    placed += centres
    return placed
