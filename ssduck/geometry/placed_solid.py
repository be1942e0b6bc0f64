"""A solid at a pose: where its points are in the world, and how far it reaches."""

from __future__ import annotations

from functools import cached_property
from typing import Any, TypeAlias

import numpy as np

from ssduck.geometry.arrays import Array
from ssduck.geometry.solids import Solid

Point: TypeAlias = tuple[float, float, float]
Point4: TypeAlias = tuple[float, float, float, float]


class PlacedSolid:
    """A solid at a pose in the world; the pose is finite, its quaternion w, x, y, z of length 1."""

    def __init__(self, solid: Solid, position: Point, orientation: Point4) -> None:
        self.solid = solid
        self.position = position
        self.orientation = orientation
        w, x, y, z = orientation
        self.matrix_rows = (
            (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        )

    def to_world(self, x: float, y: float, z: float) -> Point:
        """A point of the solid's frame in the world."""
        (a, b, c), (d, e, f), (g, h, i) = self.matrix_rows
        u, v, w = self.position
        return u + a * x + b * y + c * z, v + d * x + e * y + f * z, w + g * x + h * y + i * z

    def to_local(self, point: Point) -> Point:
        """A point of the world in the solid's frame."""
        (a, b, c), (d, e, f), (g, h, i) = self.matrix_rows
        x, y, z = (point[k] - self.position[k] for k in range(3))
        return a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z

    def direction_to_world(self, x: float, y: float, z: float) -> Point:
        """A direction of the solid's frame in the world."""
        (a, b, c), (d, e, f), (g, h, i) = self.matrix_rows
        return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z

    @cached_property
    def matrix(self) -> Array:
        """The rotation, (3, 3)."""
        return np.array(self.matrix_rows)

    @cached_property
    def points(self) -> Array:
        """The core's points in the world."""
        placed: Array = self.solid.core @ self.matrix.T + self.position
        return placed

    @cached_property
    def normals(self) -> Array:
        """The faces' normals in the world."""
        direction_to_world: Array = self.solid.normals @ self.matrix.T
        return direction_to_world

    @cached_property
    def offsets(self) -> Array | None:
        """The faces' offsets in the world."""
        if self.solid.offsets is None:
            return None
        moved: Array = self.solid.offsets + self.normals @ np.array(self.position)
        return moved

    @cached_property
    def fcl_object(self) -> Any:
        """The core's surface for FCL, a prism for a cylinder."""
        return self._object(self.solid.surface.bvh)

    @cached_property
    def fine_fcl_object(self) -> Any:
        """The same with a finer prism."""
        return self._object(self.solid.fine_surface.bvh)

    def _object(self, tree: Any) -> Any:
        import fcl

        return fcl.CollisionObject(tree, fcl.Transform(self.orientation, self.position))

    def support_points(self, directions: Array) -> Array:
        """The core's farthest points (k, 3) in unit directions (k, 3)."""
        points = self.points
        farthest: Array = points[np.argmax(directions @ points.T, axis=1)]
        if self.solid.disc_radius:
            # Turned after it is made long, so that it is across the axis up to rounding.
            across = directions @ self.matrix[:, :2]
            length = np.sqrt((across * across).sum(axis=1))
            across /= np.maximum(length, 1e-300)[:, None]
            farthest = farthest + self.solid.disc_radius * across @ self.matrix[:, :2].T
        return farthest

    def extreme_points(self, direction: Array, flush: float) -> Array:
        """The core's points (n, 3) that are farthest in a unit direction, up to `flush` metres."""
        points = self.points
        heights = points @ direction
        far: Array = points[heights >= heights.max() - flush]
        if not self.solid.disc_radius:
            return far
        across = direction @ self.matrix[:, :2]
        length = float(np.linalg.norm(across))
        if self.solid.disc_radius * length > flush:
            far += self.solid.disc_radius / length * across @ self.matrix[:, :2].T
            return far
        rim = self.solid.fine_surface.vertices @ self.matrix.T + self.position
        far = rim[rim @ direction >= (rim @ direction).max() - 2 * flush]
        return np.ascontiguousarray(far)

    def support_heights(self, directions: Array) -> Array:
        """How far the core reaches in unit directions (k, 3)."""
        farthest: Array = (directions @ self.points.T).max(axis=1)
        if self.solid.disc_radius:
            across = directions @ self.matrix[:, :2]
            farthest = farthest + self.solid.disc_radius * np.sqrt((across * across).sum(axis=1))
        return farthest
