"""Triangles of directions, and bounds of the overlaps of pairs of convex shapes in them.

See `ssduck.geometry.proofs.contact_directions`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.proofs.columns import column_lengths, unit_columns

# Heights of normals that are nearer to the least one are not decided here.
HEIGHT_ROOM = 1e-9
NEXT, LAST = np.array([1, 2, 0]), np.array([2, 0, 1])
# Which directions may be in a triangle: upward ones, others, or both.
UPWARD_ONLY, OTHER_ONLY, BOTH = 1, 2, 3


@dataclass(frozen=True, eq=False)
class Mesh:
    """Directions, and the triangles of which they are the corners.

    Attributes:
        directions: (3, m), unit vectors.
        corners: (3, k), the places of the corners of each triangle.
        stretch: (k,), see `stretch_of`.
        classes: (k,), which directions may be in the triangle.
    """

    directions: Array
    corners: Indices
    stretch: Array
    classes: Indices


@lru_cache(maxsize=8)
def mesh_of(min_height: float) -> Mesh:
    """Returns triangles all around; the directions of the least height separate some of them."""
    from scipy.spatial import ConvexHull

    tilt = math.acos(min_height)
    step = (math.pi - tilt) / round((math.pi - tilt) / math.radians(37.0))
    tilts = [0.0, tilt / 2, *np.arange(tilt, math.pi + 1e-9, step).tolist()]
    rings = []
    for row, angle in enumerate(tilts):
        count = max(1, round(2.0 * math.pi * math.sin(angle) / math.radians(34.0)))
        turns = 2.0 * math.pi * (np.arange(count) + row % 2 / 2) / count
        height = np.full(count, math.cos(angle))
        rings.append(math.sin(angle) * np.stack((np.cos(turns), np.sin(turns), 0.0 * turns)))
        rings[-1][2] = height
    directions = np.concatenate(rings, axis=1)
    corners = ConvexHull(directions.T).simplices.T
    vectors = directions[:, corners].transpose(1, 0, 2)
    stretch = stretch_of(vectors)
    return Mesh(directions, corners, stretch, classes_of(vectors[:, 2], stretch, min_height))


def stretch_of(corners: Array) -> Array:
    """Returns the greatest sum of weights of corners (3, 3, n) whose combination has length 1."""
    edges = corners[1:] - corners[0]
    normals = _cross(edges[:1], edges[1:])[0]
    volumes = np.abs(np.einsum("cn,cn->n", corners[0], normals))
    stretch: Array = column_lengths(normals) / np.maximum(volumes, 1e-300)
    return stretch


def classes_of(heights: Array, stretch: Array, min_height: float) -> Indices:
    """Returns which directions may be in triangles: those above a height, others, or both.

    Args:
        heights: (3, n), those of the corners.
        stretch: (n,), that of the triangles.
        min_height: the least height of upward directions, not negative.
    """
    highest = heights.max(axis=0)
    upward = highest * np.where(highest > 0.0, stretch, 1.0) >= min_height - HEIGHT_ROOM
    other = heights.min(axis=0) <= min_height + HEIGHT_ROOM
    classes: Indices = upward * UPWARD_ONLY + other * OTHER_ONLY
    return classes


@dataclass(frozen=True, eq=False)
class Triangles:
    """Triangles of directions of several pairs.

    Attributes:
        owners: (n,), the pair of each.
        classes: (n,), which directions may be in it.
        numbers: (32, n), all other properties.
    """

    owners: Indices
    classes: Indices
    numbers: Array

    @classmethod
    def of(
        cls,
        owners: Indices,
        classes: Indices,
        corners: Array,
        points: Array,
        products: Array,
        stretch: Array,
    ) -> Triangles:
        """Returns triangles, and bounds of the overlaps in them."""
        bounds, facets = bounds_of(products, stretch)
        vectors = np.concatenate((corners, points, products)).reshape(27, -1)
        numbers = np.concatenate((vectors, facets, bounds[None], stretch[None]))
        return cls(owners, classes, numbers)

    @property
    def corners(self) -> Array:
        """The directions at the corners, (3, 3, n): (corner, axis, triangle)."""
        return self.numbers[:9].reshape(3, 3, -1)

    @property
    def points(self) -> Array:
        """The support points of the pair's difference in these directions, (3, 3, n)."""
        return self.numbers[9:18].reshape(3, 3, -1)

    @property
    def products(self) -> Array:
        """The products of points and directions, (3, 3, n): (point, corner, triangle)."""
        return self.numbers[18:27].reshape(3, 3, -1)

    @property
    def facets(self) -> Array:
        """The weights of the corners for the direction of the facet, (3, n); see `bounds_of`."""
        return self.numbers[27:30]

    @property
    def bounds(self) -> Array:
        """Lower bounds of the overlaps in the triangles, (n,), metres."""
        bounds: Array = self.numbers[30]
        return bounds

    @property
    def stretch(self) -> Array:
        """The greatest sum of weights of corners whose combination has length 1, (n,)."""
        stretch: Array = self.numbers[31]
        return stretch

    def select(self, places: Indices) -> Triangles:
        """Returns the selected triangles."""
        return Triangles(
            self.owners[places],
            self.classes[places],
            self.numbers.take(places, axis=1),
        )

    def joined(self, other: Triangles) -> Triangles:
        """Returns the triangles of both."""
        return Triangles(
            np.concatenate((self.owners, other.owners)),
            np.concatenate((self.classes, other.classes)),
            np.concatenate((self.numbers, other.numbers), axis=1),
        )


def bounds_of(products: Array, stretch: Array) -> tuple[Array, Array]:
    """Returns lower bounds of overlaps in triangles, and the directions of facets.

    The overlap at a direction is at least the product of the direction with any mean of the support
    points. Its least product in the triangle is at a corner. The best mean is that of a matrix
    game: one of the points, or the mean whose products with the corners are equal.

    Args:
        products: (3, 3, n), of support points and corners (point, corner, triangle).
        stretch: (n,), that of the triangles.

    Returns:
        The bounds, (n,); and the weights (3, n) of the corners whose sum is normal to the plane
        through the three points. They have a meaning if all are positive.
    """
    crossed = _cross(products[NEXT], products[LAST])
    weights, facets = crossed.sum(axis=1), crossed.sum(axis=0)
    total = weights.sum(axis=0)
    weights = np.maximum(np.copysign(weights, weights * total), 0.0)
    total = weights.sum(axis=0)
    weights /= np.where(total > 0.0, total, 1.0)
    mixed = (weights[:, None] * products).sum(axis=0).min(axis=0)
    mixed[~(total > 0.0)] = -math.inf
    mixed *= np.where(mixed < 0.0, stretch, 1.0)
    bounds = np.maximum(corner_bounds(products, stretch), mixed)
    return bounds, np.copysign(facets, facets * facets.sum(axis=0))


def corner_bounds(products: Array, stretch: Array) -> Array:
    """Returns lower bounds of overlaps in triangles, by one of their points; see `bounds_of`."""
    bounds: Array = products.min(axis=1).max(axis=0)
    bounds *= np.where(bounds < 0.0, stretch, 1.0)
    return bounds


def facet_directions(corners: Array, weights: Array) -> Array:
    """Returns the unit normals of the facets of triangles (3, 3, n), or their middles, (3, n)."""
    weights = np.where(weights.min(axis=0) > 0.0, weights, 1.0)
    weights /= weights.max(axis=0)
    return unit_columns((weights[:, None] * corners).sum(axis=0))


def _cross(first: Array, second: Array) -> Array:
    """Returns the cross products of vectors (k, 3, n)."""
    crossed: Array = first[:, NEXT] * second[:, LAST]
    crossed -= first[:, LAST] * second[:, NEXT]
    return crossed
