"""The intervals of spheres and cylinders in strips of cells between two heights, by formulas."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from ssduck.geometry.arrays import Array
from ssduck.geometry.raster import CELL_TOLERANCE, Raster, StripIntervals
from ssduck.geometry.solids import Solid

# The greatest error of computed points, m.
_POINT_ERROR = 1e-10


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

    def spans(self, raster: Raster, low: float, high: float) -> StripIntervals | None:
        """The interval in each strip that it reaches between two heights; None if there is none."""
        across = np.hypot(self.matrix[:, 0], self.matrix[:, 1])
        reach = self.radius * across + abs(self.matrix[:, 2]) * self.half
        if self.half < 0.0:
            reach = np.full(3, self.radius)
        start, end = self.position - reach, self.position + reach
        if start[2] > high or end[2] < low or low > high:
            return None
        within = -CELL_TOLERANCE if self.half == 0.0 else CELL_TOLERANCE
        first, last = raster.overlapped_cells(start[:1], end[:1], within, 0)
        strips = np.arange(first[0], last[0] + 1)
        left = raster.origin[0] + strips * raster.size + within
        right = left + raster.size - 2 * within
        bounds = self._of_sphere if self.half < 0.0 else self._of_cylinder
        bottom, top = bounds(left, right, low, high)
        some = bottom <= top
        return StripIntervals(strips[some], bottom[some], top[some], within)

    def _of_sphere(self, left: Array, right: Array, low: float, high: float) -> tuple[Array, Array]:
        x, y, z = self.position
        aside = x - np.clip(x, left, right)
        square = self.radius**2 - aside**2 - (z - np.clip(z, low, high)) ** 2
        reach = np.where(square >= 0.0, np.sqrt(np.maximum(square, 0.0)), -np.inf)
        return y - reach, y + reach

    def _of_cylinder(
        self, left: Array, right: Array, low: float, high: float
    ) -> tuple[Array, Array]:
        """The least and the greatest y of points of the cylinder, in strips (n,).

        Three pairs of planes bound the points: the caps, the sides of the strip, the heights. y is
        least where three planes intersect, where two planes intersect the round side, or on the
        ellipse of one plane with the round side, where the gradients of all three are coplanar.
        """
        (x, y, z), count = self.position, len(left)
        axis = np.array([0.0, 0.0, 1.0])
        along = np.broadcast_to
        pairs = (
            (axis, [along(-self.half, count), along(self.half, count)]),
            (self.matrix[0], [left - x, right - x]),
            (self.matrix[2], [along(low - z, count), along(high - z, count)]),
        )
        points = [np.zeros((count, 0, 3))]
        points += [_corners(pairs)]
        points += [self._on_lines(*two) for two in itertools.combinations(pairs, 2)]
        points += [self._on_ellipses(*one) for one in pairs]
        found = np.concatenate(points, axis=1)
        fits = np.hypot(found[:, :, 0], found[:, :, 1]) <= self.radius + _POINT_ERROR
        for normal, (least, most) in pairs:
            value = found @ normal
            fits &= (value >= least[:, None] - _POINT_ERROR) & (
                value <= most[:, None] + _POINT_ERROR
            )
        value = found @ self.matrix[1] + y
        return (
            np.where(fits, value, np.inf).min(axis=1, initial=np.inf),
            np.where(fits, value, -np.inf).max(axis=1, initial=-np.inf),
        )

    def _on_lines(self, one: tuple[Array, list[Array]], two: tuple[Array, list[Array]]) -> Array:
        """The points where lines of two planes intersect the round side: (n, 8, 3) at most."""
        way = np.cross(one[0], two[0])
        square, flat = float(way @ way), float(way[:2] @ way[:2])
        first, second = np.cross(two[0], way), np.cross(way, one[0])
        found = []
        if flat > 1e-24:
            for c, d in itertools.product(one[1], two[1]):
                base = (np.outer(c, first) + np.outer(d, second)) / square
                middle = -(base[:, :2] @ way[:2]) / flat
                base = base + middle[:, None] * way
                room = self.radius**2 - np.einsum("ni,ni->n", base[:, :2], base[:, :2])
                step = np.sqrt(np.where(room >= 0.0, room, np.nan) / flat)[:, None] * way
                found += [base - step, base + step]
        return np.stack(found, axis=1) if found else np.zeros((len(one[1][0]), 0, 3))

    def _on_ellipses(self, normal: Array, offsets: list[Array]) -> Array:
        """The points of extreme y where planes cut the round side: (n, 4, 3) at most."""
        if abs(normal[2]) < 1e-12:
            return np.zeros((len(offsets[0]), 0, 3))
        steep = self.matrix[1] - self.matrix[1, 2] / normal[2] * normal
        length = float(np.hypot(steep[0], steep[1]))
        flat = steep[:2] * (self.radius / length) if length > 1e-12 else np.array([self.radius, 0])
        found = []
        for offset, side in itertools.product(offsets, (flat, -flat)):
            height = (offset - normal[:2] @ side) / normal[2]
            found.append(np.column_stack((np.tile(side, (len(height), 1)), height)))
        return np.stack(found, axis=1)


def _corners(pairs: tuple[tuple[Array, list[Array]], ...]) -> Array:
    """The intersections of three planes, one of each pair: (n, 8, 3); none if there are none."""
    normals = np.array([normal for normal, _ in pairs])
    if abs(np.linalg.det(normals)) < 1e-12:
        return np.zeros((len(pairs[0][1][0]), 0, 3))
    inverse = np.linalg.inv(normals)
    offsets = [np.stack(three, axis=1) for three in itertools.product(*(c for _, c in pairs))]
    found: Array = np.stack(offsets, axis=1) @ inverse.T
    return found


def round_parts(solid: Solid, position: Array, matrix: Array) -> list[RoundShape]:
    """The spheres and cylinders that make up a sphere, a cylinder or a capsule."""
    if solid.type == "cylinder":
        return [RoundShape(solid.disc_radius, solid.half_length, position, matrix)]
    parts = [
        RoundShape(solid.radius, -1.0, matrix @ point + position, matrix) for point in solid.core
    ]
    if solid.type == "capsule":
        parts.append(RoundShape(solid.radius, solid.half_length, position, matrix))
    return parts
