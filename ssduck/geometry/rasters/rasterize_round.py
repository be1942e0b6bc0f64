"""The intervals of round shapes in strips of cells between two heights, by formulas."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from ssduck.geometry.arrays import Array
from ssduck.geometry.rasters.raster import CELL_TOLERANCE, Raster, StripIntervals
from ssduck.geometry.solids import Solid

# The greatest error of computed points, m.
_POINT_ERROR = 1e-10


# Returns the least and the greatest y of a shape in strips from left to right, between two heights.
_Bounds: TypeAlias = Callable[[Array, Array, float, float], tuple[Array, Array]]


def _intervals(
    raster: Raster,
    centre: Array,
    extents: Array,
    low: float,
    high: float,
    bounds: _Bounds,
    min_overlap: float = CELL_TOLERANCE,
) -> StripIntervals | None:
    """Returns the intervals of a shape with a box around its centre; None without any."""
    start, end = centre - extents, centre + extents
    if start[2] > high or end[2] < low or low > high:
        return None
    first, last = raster.overlapped_cells(start[:1], end[:1], min_overlap, 0)
    strips = np.arange(first[0], last[0] + 1)
    left = raster.origin[0] + strips * raster.size + min_overlap
    bottom, top = bounds(left, left + raster.size - 2 * min_overlap, low, high)
    is_reached = bottom <= top
    return StripIntervals(strips[is_reached], bottom[is_reached], top[is_reached], min_overlap)


@dataclass(frozen=True, eq=False)
class RoundShape:
    """A sphere, or a cylinder along its frame's z.

    Attributes:
        radius: m.
        half: half the length of a cylinder; negative for a sphere.
        position: (3,).
        matrix: (3, 3).
    """

    radius: float
    half: float
    position: Array
    matrix: Array

    def intervals(self, raster: Raster, low: float, high: float) -> StripIntervals | None:
        """Returns the occupied intervals of strips between two heights; None without any."""
        if self.half < 0.0:
            box = self.position, np.full(3, self.radius)
            return _intervals(raster, *box, low, high, self._sphere_bounds)
        across = np.hypot(self.matrix[:, 0], self.matrix[:, 1])
        extents = self.radius * across + abs(self.matrix[:, 2]) * self.half
        min_overlap = -CELL_TOLERANCE if self.half == 0.0 else CELL_TOLERANCE
        bounds = self._cylinder_bounds
        return _intervals(raster, self.position, extents, low, high, bounds, min_overlap)

    def _sphere_bounds(
        self, left: Array, right: Array, low: float, high: float
    ) -> tuple[Array, Array]:
        x, y, z = self.position
        offset_x = x - np.clip(x, left, right)
        squared = self.radius**2 - offset_x**2 - (z - np.clip(z, low, high)) ** 2
        half_width = np.where(squared >= 0.0, np.sqrt(np.maximum(squared, 0.0)), -np.inf)
        return y - half_width, y + half_width

    def _cylinder_bounds(
        self, left: Array, right: Array, low: float, high: float
    ) -> tuple[Array, Array]:
        """Returns the least and the greatest y of points of the cylinder, in strips (n,)."""
        (x, y, z), count = self.position, len(left)
        axis = np.array([0.0, 0.0, 1.0])
        repeat = np.broadcast_to
        pairs = (
            (axis, [repeat(-self.half, count), repeat(self.half, count)]),
            (self.matrix[0], [left - x, right - x]),
            (self.matrix[2], [repeat(low - z, count), repeat(high - z, count)]),
        )
        points = [np.zeros((count, 0, 3))]
        points += [_corners(pairs)]
        points += [self._on_lines(*two_pairs) for two_pairs in itertools.combinations(pairs, 2)]
        points += [self._on_ellipses(*pair) for pair in pairs]
        candidates = np.concatenate(points, axis=1)
        is_valid = np.hypot(candidates[:, :, 0], candidates[:, :, 1]) <= self.radius + _POINT_ERROR
        for normal, (lower, upper) in pairs:
            values = candidates @ normal
            is_valid &= (values >= lower[:, None] - _POINT_ERROR) & (
                values <= upper[:, None] + _POINT_ERROR
            )
        values = candidates @ self.matrix[1] + y
        return (
            np.where(is_valid, values, np.inf).min(axis=1, initial=np.inf),
            np.where(is_valid, values, -np.inf).max(axis=1, initial=-np.inf),
        )

    def _on_lines(self, one: tuple[Array, list[Array]], two: tuple[Array, list[Array]]) -> Array:
        """Returns the points where lines of two planes intersect the side: (n, 8, 3) at most."""
        direction = np.cross(one[0], two[0])
        squared_length = float(direction @ direction)
        horizontal = float(direction[:2] @ direction[:2])
        first, second = np.cross(two[0], direction), np.cross(direction, one[0])
        points = []
        if horizontal > 1e-24:
            for c, d in itertools.product(one[1], two[1]):
                base = (np.outer(c, first) + np.outer(d, second)) / squared_length
                nearest = -(base[:, :2] @ direction[:2]) / horizontal
                base = base + nearest[:, None] * direction
                squared = self.radius**2 - np.einsum("ni,ni->n", base[:, :2], base[:, :2])
                half_chord = np.sqrt(np.where(squared >= 0.0, squared, np.nan) / horizontal)
                step = half_chord[:, None] * direction
                points += [base - step, base + step]
        return np.stack(points, axis=1) if points else np.zeros((len(one[1][0]), 0, 3))

    def _on_ellipses(self, normal: Array, offsets: list[Array]) -> Array:
        """Returns the points of extreme y where planes cut the round side: (n, 4, 3) at most."""
        if abs(normal[2]) < 1e-12:
            return np.zeros((len(offsets[0]), 0, 3))
        steep = self.matrix[1] - self.matrix[1, 2] / normal[2] * normal
        length = float(np.hypot(steep[0], steep[1]))
        offset_xy = (
            steep[:2] * (self.radius / length) if length > 1e-12 else np.array([self.radius, 0])
        )
        points = []
        for offset, side in itertools.product(offsets, (offset_xy, -offset_xy)):
            height = (offset - normal[:2] @ side) / normal[2]
            points.append(np.column_stack((np.tile(side, (len(height), 1)), height)))
        return np.stack(points, axis=1)


def _corners(pairs: tuple[tuple[Array, list[Array]], ...]) -> Array:
    """Returns the intersections of three planes, one of each pair: (n, 8, 3) or (n, 0, 3)."""
    normals = np.array([normal for normal, _ in pairs])
    if abs(np.linalg.det(normals)) < 1e-12:
        return np.zeros((len(pairs[0][1][0]), 0, 3))
    inverse = np.linalg.inv(normals)
    offsets = [np.stack(planes, axis=1) for planes in itertools.product(*(c for _, c in pairs))]
    corners: Array = np.stack(offsets, axis=1) @ inverse.T
    return corners


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """An ellipsoid: all p + C u with a position p, where u C u <= 1.

    Attributes:
        position: (3,).
        covariance: (3, 3), C; the extent in a unit direction n is the root of n C n.
    """

    position: Array
    covariance: Array

    def intervals(self, raster: Raster, low: float, high: float) -> StripIntervals | None:
        """Returns the occupied intervals of strips between two heights; None without any."""
        extents = np.sqrt(np.diagonal(self.covariance))
        return _intervals(raster, self.position, extents, low, high, self._bounds)

    def _bounds(self, left: Array, right: Array, low: float, high: float) -> tuple[Array, Array]:
        (x, y, z), count = self.position, len(left)
        box = left - x, right - x, np.full(count, low - z), np.full(count, high - z)
        # The other end is that of the mirrored ellipsoid in the mirrored strip.
        return y - self._greatest(-box[1], -box[0], -box[3], -box[2]), y + self._greatest(*box)

    def _greatest(self, left: Array, right: Array, low: Array, high: Array) -> Array:
        """Returns the greatest y of points in rectangles of x and z, (n,); -inf if none."""
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = self.covariance
        extent = np.sqrt(yy)
        x, z = np.full(len(left), xy / extent), np.full(len(left), yz / extent)
        is_inside = (left <= x) & (x <= right) & (low <= z) & (z <= high)
        places = [(x, np.where(is_inside, z, np.nan))]
        for side in (left, right):
            z = _place_in_section(side, xx, (xy, xz), (yy, yz))
            places.append((side, np.clip(z, low, high)))
        for side in (low, high):
            x = _place_in_section(side, zz, (yz, xz), (yy, xy))
            places.append((np.clip(x, left, right), side))
        tops = np.stack([self._height_over(x, z) for x, z in places])
        greatest: Array = np.where(np.isnan(tops), -np.inf, tops).max(axis=0)
        return greatest

    def _height_over(self, x: Array, z: Array) -> Array:
        """Returns the greatest y over points of the xz plane, from the centre; NaN outside."""
        ground = self.covariance[np.ix_([0, 2], [0, 2])]
        slope = np.linalg.solve(ground, self.covariance[[0, 2], 1])
        rest = self.covariance[1, 1] - slope @ self.covariance[[0, 2], 1]
        points = np.stack((x, z))
        squared = 1.0 - (points * np.linalg.solve(ground, points)).sum(axis=0)
        heights: Array = slope @ points
        heights += np.sqrt(np.where(squared >= 0.0, squared, np.nan) * rest)
        return heights


def _place_in_section(
    side: Array, variance: float, shared: tuple[float, float], rest: tuple[float, float]
) -> Array:
    """Returns the w where sections u = side of an ellipsoid have their greatest v, (n,); or NaN."""
    (uv, uw), (vv, vw) = shared, rest
    squared = 1.0 - side * side / variance
    width = np.sqrt(np.where(squared >= 0.0, squared, np.nan) / (vv - uv * uv / variance))
    place: Array = side * (uw / variance) + (vw - uv * uw / variance) * width
    return place


def round_parts(solid: Solid, position: Array, matrix: Array) -> Sequence[RoundShape | Ellipsoid]:
    """Returns the spheres, cylinders and ellipsoids that make up a round shape."""
    if solid.type == "ellipsoid":
        axes = matrix * solid.semi_axes
        return [Ellipsoid(position, axes @ axes.T)]
    if solid.type == "cylinder":
        return [RoundShape(solid.disc_radius, solid.half_length, position, matrix)]
    parts = [
        RoundShape(solid.radius, -1.0, matrix @ point + position, matrix) for point in solid.core
    ]
    if solid.type == "capsule":
        parts.append(RoundShape(solid.radius, solid.half_length, position, matrix))
    return parts
