"""Bounds the signed distances of a few pairs of convex shapes, one pair after another.

They are the bounds of `ssduck.geometry.proofs.proposals.Proof`, by the same formulas, in Python's
numbers: for so few pairs, this takes less time than arrays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

Vector: TypeAlias = Sequence[float]

# Points are moved by this fraction towards the middle of the shape, so that they are surely in it.
SHRINK = 1e-8


def ball_margin(bounding_radius: float) -> float:
    """Returns by how much the radius of a ball in a solid is less than the depth of its centre.

    It is far more than the rounding errors of depths.

    Args:
        bounding_radius: the radius of the ball around the solid, metres.
    """
    return 2.0 * SHRINK * bounding_radius


class Interior:
    """The interior of a convex solid with an inside, in its frame from the solid's centre.

    Args:
        numbers: those of `ssduck.geometry.proofs.interiors`.
        corners: the corners of a hull; empty for other solids.
        planes: the normals and the offsets of a hull.

    Attributes:
        middle: the centre of the ball in it, metres.
        margin: see `ball_margin`, metres.
    """

    def __init__(
        self, numbers: Vector, corners: Sequence[Vector], planes: Sequence[Vector]
    ) -> None:
        self._corners, self._planes = corners, planes
        self._half, self._axes, self._radius = numbers[0:3], numbers[3:6], numbers[19]
        self._walls, self._core = numbers[6:9], numbers[9:12]
        self._scales, self._scaled_radius = numbers[12:15], numbers[15]
        self.middle, self.margin = numbers[16:19], numbers[20]

    def height(self, direction: Vector) -> float:
        """Returns the extent from the centre in a unit direction, metres."""
        x, y, z = direction
        if self._corners:
            return max([a * x + b * y + c * z for a, b, c in self._corners])
        (a, b, c), (d, e, f) = self._half, self._axes
        box = a * abs(x) + b * abs(y) + c * abs(z)
        return box + math.hypot(d * x, e * y, f * z) + self._radius

    def depth(self, point: Vector) -> float:
        """Returns a lower bound of the depth of a point, metres; negative outside."""
        x, y, z = point
        if self._planes:
            return min([h - (a * x + b * y + c * z) for a, b, c, h in self._planes])
        x, y, z = abs(x), abs(y), abs(z)
        (a, b, c), (d, e, f), (g, h, i) = self._walls, self._core, self._scales
        beyond = math.hypot(g * max(x - d, 0.0), h * max(y - e, 0.0), i * max(z - f, 0.0))
        return min(a - x, b - y, c - z, self._scaled_radius * (1.0 - beyond))


@dataclass(frozen=True, eq=False)
class PlacedInterior:
    """An interior at a pose.

    Attributes:
        interior: the interior.
        rotation: (9,), the rotation matrix, row by row.
        centre: the centre of the solid in the world, metres.
    """

    interior: Interior
    rotation: Vector
    centre: Vector

    def to_local(self, vector: Vector) -> Vector:
        """Returns a vector of the world in the axes of the shape."""
        x, y, z = vector
        a, b, c, d, e, f, g, h, i = self.rotation
        return (a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z)

    def from_centre(self, point: Vector) -> Vector:
        """Returns a point of the world in the shape's frame from the solid's centre."""
        x, y, z = self.centre
        return self.to_local((point[0] - x, point[1] - y, point[2] - z))

    def shrunk(self, point: Vector) -> Vector:
        """Returns a point of the shape's frame, a little nearer to the middle."""
        (x, y, z), (a, b, c) = point, self.interior.middle
        return (x + SHRINK * (a - x), y + SHRINK * (b - y), z + SHRINK * (c - z))

    def radius(self, point: Vector) -> float:
        """Returns the radius of a ball around a point that is in the shape.

        Minus infinity for a point that may be outside.
        """
        depth = self.interior.depth(point)
        return depth - self.interior.margin if depth >= 0.0 else -math.inf


@dataclass(frozen=True)
class PairProof:
    """Bounds of the signed distance of two shapes.

    Attributes:
        least: what it is at least, metres.
        greatest: what it is at most.
        column: what is kept of them; see `KeptProposals`.
    """

    least: float
    greatest: float
    column: Vector


def pair_proof(
    one: PlacedInterior, other: PlacedInterior, points: tuple[Vector, Vector], towards: Vector
) -> PairProof:
    """Returns bounds of the signed distance of two shapes, of points and a direction.

    Args:
        one: a shape.
        other: the other one.
        points: a point on each, in the world; the same one if they are thought to overlap.
        towards: the direction from the other to the first, of any length; 0 for that between the
            points, of shapes that are thought to be apart.
    """
    between = _moved(points[0], -1.0, points[1])
    apart, meet = math.hypot(*between), any(towards)
    x, y, z = towards if meet else between
    length = math.hypot(x, y, z)
    # Any direction of length 1 gives a bound.
    unit = (x / length, y / length, z / length) if length > 0.0 else (0.0, 0.0, 1.0)
    x, y, z = one.to_local(unit)
    outward = (-x, -y, -z), other.to_local(unit)
    (x, y, z), (a, b, c), (d, e, f) = unit, one.centre, other.centre
    least = x * (a - d) + y * (b - e) + z * (c - f)
    least -= one.interior.height(outward[0]) + other.interior.height(outward[1])
    if meet := meet or least < 0.0:
        points, apart = (_moved(points[0], -0.5, between),) * 2, 0.0
    first, second = one.from_centre(points[0]), other.from_centre(points[1])
    if meet:  # to where they are about equally deep in both
        step = 0.5 * (one.interior.depth(first) - other.interior.depth(second))
        first, second = _moved(first, step, outward[0]), _moved(second, -step, outward[1])
    first, second = one.shrunk(first), other.shrunk(second)
    greatest = apart - one.radius(first) - other.radius(second)
    (x, y, z), (a, b, c) = first, second
    return PairProof(least, greatest, (*unit, x, a, y, b, z, c))


def _moved(point: Vector, by: float, along: Vector) -> Vector:
    x, y, z = along
    return (point[0] + by * x, point[1] + by * y, point[2] + by * z)
