"""The volume that two closed surfaces have in common.

Of two polyhedra it is a sum over pairs of faces, one of each, without any search for the corners
of what they share: a point is below so many faces of either as say whether it is inside.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.broad_phase import Pairs, meeting_across

# A triangle whose shadow is smaller, as a share of its longest edge squared, casts none.
UPRIGHT = 1e-13


def common_volume(surface: Array, weights: Array, other: Array) -> float:
    """The volume that two closed surfaces have in common.

    With s = 1 of a triangle that faces up and -1 of one that faces down, a surface encloses a
    point as often as the s of its triangles above the point add up to. So the volume is a sum
    over pairs of triangles, one of either surface: the product of their s, times the integral
    over the common part of their shadows on the ground of the lesser of their heights. As the s
    of all triangles over a place of the ground add up to 0, all heights may be taken from the
    second: what counts is how far the first is below it. Every term is continuous in the corners,
    so that rounding decides nothing, not even of faces that lie in each other.

    Args:
        surface: triangles (n, 3, 3) that face outward.
        weights: (n,) how often what they enclose counts, the same for all of a closed part.
        other: triangles (m, 3, 3) that face outward.
    """
    middle = surface.reshape(-1, 3).mean(axis=0)
    surface, other = surface - middle, other - middle
    areas, other_areas = _shadows(surface), _shadows(other)
    surface, weights = surface[areas != 0.0], weights[areas != 0.0]
    other, other_areas = other[other_areas != 0.0], other_areas[other_areas != 0.0]
    volume = 0.0
    for i, j in _over_each_other(surface, other):
        volume += float(weights[i] @ _lowered(surface[i], other[j], other_areas[j]))
    return volume


def _shadows(triangles: Array) -> Array:
    """Twice the areas of triangles' shadows, (n,), negative of those that face down."""
    one, two = (triangles[:, k, :2] - triangles[:, 0, :2] for k in (1, 2))
    areas: Array = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]
    edges = triangles - np.roll(triangles, 1, axis=1)
    longest = np.einsum("nki,nki->nk", edges, edges).max(axis=1, initial=0.0)
    return np.where(np.abs(areas) > UPRIGHT * longest, areas, 0.0)


def _over_each_other(surface: Array, other: Array) -> Iterator[Pairs]:
    """Pairs of triangles: shadows whose boxes meet, and not all of the first above the second."""
    low, high, lows, highs = (
        corner.T.copy() for one in (surface, other) for corner in (one.min(axis=1), one.max(axis=1))
    )
    high[2], lows[2] = math.inf, -math.inf
    return meeting_across((low, high), (lows, highs), rims=False)


def _lowered(first: Array, second: Array, areas: Array) -> Array:
    """Of pairs of triangles (n, 3, 3) the integrals of how far the first is below the second.

    Negative, and with the sign of the product of their s: see `common_volume`.

    Args:
        first: ones of any shadow.
        second: others.
        areas: (n,) what `_shadows` says of those.
    """
    origin, edges = second[:, :1], second[:, 1:] - second[:, :1]
    # In the frame in which the shadow of the second has the corners (0, 0), (1, 0), (0, 1).
    x, y = np.moveaxis((first - origin)[:, :, :2], 2, 0)
    (px, py), (qx, qy) = np.moveaxis(edges[:, :, :2], 0, 2)[:, :, :, None]
    u, v = x * qy - y * qx, y * px - x * py
    polygons = np.stack((u, v, first[:, :, 2]), axis=2)
    polygons[:, :, :2] /= areas[:, None, None]
    rows = np.arange(len(first))
    for side in ((1.0, 0.0), (0.0, 1.0), (-1.0, -1.0)):
        heights = polygons[:, :, :2] @ np.array(side) + (sum(side) < 0.0)
        polygons, some = clip_polygons(polygons, heights)
        rows = rows[some]
    over = np.einsum("nki,ni->nk", polygons[:, :, :2], edges[rows, :, 2]) + origin[rows, :, 2]
    polygons[:, :, 2] -= over
    polygons, some = clip_polygons(polygons, -polygons[:, :, 2])
    rows = rows[some]
    found = np.zeros(len(first))
    found[rows] = _integrals(polygons) * np.abs(areas[rows])
    return found


def clip_polygons(polygons: Array, heights: Array) -> tuple[Array, Indices]:
    """The parts of convex polygons (n, k, d) where heights (n, k), linear over each, are not < 0.

    Returns:
        Those that have such a part, their last corner repeated so that all have as many; which
        ones they are.
    """
    held = heights >= 0.0
    crossed = held != np.roll(held, -1, axis=1)
    share = heights / np.where(crossed, heights - np.roll(heights, -1, axis=1), 1.0)
    met = polygons + share[:, :, None] * (np.roll(polygons, -1, axis=1) - polygons)
    count, k, d = polygons.shape
    corners = np.stack((polygons, met), axis=2).reshape(count, 2 * k, d)
    used = np.stack((held, crossed), axis=2).reshape(count, 2 * k)
    left = used.sum(axis=1)
    rows = np.flatnonzero(left)
    order = np.argsort(~used[rows], axis=1, kind="stable")
    last = np.minimum(np.arange(left.max(initial=0)), left[rows, None] - 1)
    order = np.take_along_axis(order, last, axis=1)
    return np.take_along_axis(corners[rows], order[:, :, None], axis=1), rows


def _integrals(polygons: Array) -> Array:
    """Of polygons (n, k, 3) the integrals of their third coordinate over the plane of the others.

    Negated where they run clockwise.
    """
    start, one, two = polygons[:, :1], polygons[:, 1:-1], polygons[:, 2:]
    u, v = one - start, two - start
    areas = u[:, :, 0] * v[:, :, 1] - u[:, :, 1] * v[:, :, 0]
    heights = start[:, :, 2] + one[:, :, 2] + two[:, :, 2]
    found: Array = np.einsum("nk,nk->n", areas, heights) / 6.0
    return found
