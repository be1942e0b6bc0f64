"""Computes the common volume of two closed surfaces.

For two polyhedra it is a sum over pairs of faces, one of each. No corners of the intersection are
searched for: the faces above a point tell whether it is inside.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.broad_phase import Pairs, overlapping_pairs_across

# Triangles with a smaller projection, relative to their longest edge squared, are left out.
MIN_PROJECTION = 1e-13


def common_volume(surface: Array, weights: Array, other: Array) -> float:
    """Returns the common volume of two closed surfaces, m³.

    Let s be 1 for a triangle that faces up and -1 for one that faces down. The winding number of a
    surface around a point is the sum of s over its triangles above the point. So the volume is a
    sum over pairs of triangles, one of either surface: the product of their s, times the integral
    of the lower of their heights over the common part of their projections on the ground. The s of
    all triangles over a place of the ground add up to 0, so that all heights may be taken from the
    second triangle: only the part of the first that is below it counts. Every term is continuous in
    the corners, so that rounding decides nothing, even for coplanar faces.
    """
    centroid = surface.reshape(-1, 3).mean(axis=0)
    surface, other = surface - centroid, other - centroid
    areas, other_areas = _projected_areas(surface), _projected_areas(other)
    surface, weights = surface[areas != 0.0], weights[areas != 0.0]
    other, other_areas = other[other_areas != 0.0], other_areas[other_areas != 0.0]
    volume = 0.0
    for i, j in _overlapping_pairs(surface, other):
        volume += float(weights[i] @ _heights_below(surface[i], other[j], other_areas[j]))
    return volume


def _projected_areas(triangles: Array) -> Array:
    """Returns twice the areas of triangles' projections, (n,); negative if they face down."""
    first_edges, second_edges = (triangles[:, k, :2] - triangles[:, 0, :2] for k in (1, 2))
    areas: Array = first_edges[:, 0] * second_edges[:, 1] - first_edges[:, 1] * second_edges[:, 0]
    edges = triangles - np.roll(triangles, 1, axis=1)
    longest = np.einsum("nki,nki->nk", edges, edges).max(axis=1, initial=0.0)
    return np.where(np.abs(areas) > MIN_PROJECTION * longest, areas, 0.0)


def _overlapping_pairs(surface: Array, other: Array) -> Iterator[Pairs]:
    """Yields pairs of triangles with overlapping projections, if the first is not above."""
    low, high, lows, highs = (
        corner.T.copy()
        for triangles in (surface, other)
        for corner in (triangles.min(axis=1), triangles.max(axis=1))
    )
    high[2], lows[2] = math.inf, -math.inf
    return overlapping_pairs_across((low, high), (lows, highs), touching=False)


def _heights_below(first: Array, second: Array, areas: Array) -> Array:
    """Integrates the height of the first triangle below the second, for pairs (n, 3, 3)."""
    origin, edges = second[:, :1], second[:, 1:] - second[:, :1]
    # In the frame in which the projection of the second has the corners (0, 0), (1, 0), (0, 1).
    x, y = np.moveaxis((first - origin)[:, :, :2], 2, 0)
    (px, py), (qx, qy) = np.moveaxis(edges[:, :, :2], 0, 2)[:, :, :, None]
    u, v = x * qy - y * qx, y * px - x * py
    polygons = np.stack((u, v, first[:, :, 2]), axis=2)
    polygons[:, :, :2] /= areas[:, None, None]
    rows = np.arange(len(first))
    for side in ((1.0, 0.0), (0.0, 1.0), (-1.0, -1.0)):
        heights = polygons[:, :, :2] @ np.array(side) + (sum(side) < 0.0)
        polygons, indices = clip_polygons(polygons, heights)
        rows = rows[indices]
    plane_heights = (
        np.einsum("nki,ni->nk", polygons[:, :, :2], edges[rows, :, 2]) + origin[rows, :, 2]
    )
    polygons[:, :, 2] -= plane_heights
    polygons, indices = clip_polygons(polygons, -polygons[:, :, 2])
    rows = rows[indices]
    integrals = np.zeros(len(first))
    integrals[rows] = _integrals(polygons) * np.abs(areas[rows])
    return integrals


def clip_polygons(polygons: Array, heights: Array) -> tuple[Array, Indices]:
    """Clips convex polygons (n, k, d) to where heights (n, k), linear over each, are not < 0."""
    is_kept = heights >= 0.0
    is_crossed = is_kept != np.roll(is_kept, -1, axis=1)
    fraction = heights / np.where(is_crossed, heights - np.roll(heights, -1, axis=1), 1.0)
    crossings = polygons + fraction[:, :, None] * (np.roll(polygons, -1, axis=1) - polygons)
    count, k, d = polygons.shape
    corners = np.stack((polygons, crossings), axis=2).reshape(count, 2 * k, d)
    is_used = np.stack((is_kept, is_crossed), axis=2).reshape(count, 2 * k)
    corner_counts = is_used.sum(axis=1)
    rows = np.flatnonzero(corner_counts)
    order = np.argsort(~is_used[rows], axis=1, kind="stable")
    last = np.minimum(np.arange(corner_counts.max(initial=0)), corner_counts[rows, None] - 1)
    order = np.take_along_axis(order, last, axis=1)
    return np.take_along_axis(corners[rows], order[:, :, None], axis=1), rows


def _integrals(polygons: Array) -> Array:
    """Integrates the third coordinate of polygons (n, k, 3) over the plane of the other two."""
    start, first, second = polygons[:, :1], polygons[:, 1:-1], polygons[:, 2:]
    u, v = first - start, second - start
    areas = u[:, :, 0] * v[:, :, 1] - u[:, :, 1] * v[:, :, 0]
    heights = start[:, :, 2] + first[:, :, 2] + second[:, :, 2]
    integrals: Array = np.einsum("nk,nk->n", areas, heights) / 6.0
    return integrals
