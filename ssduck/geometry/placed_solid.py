"""A solid at a pose: its points, its extents and its FCL objects in the world."""

from __future__ import annotations

from functools import cached_property
from typing import Any, TypeAlias

import numpy as np

from ssduck.geometry.arrays import Array
from ssduck.geometry.solids import Solid

Point: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]


class PlacedSolid:
    """A solid at a finite pose in the world; the quaternion is w, x, y, z, of length 1."""

    def __init__(self, solid: Solid, position: Point, orientation: Quaternion) -> None:
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
        """Transforms a point from the solid's frame to the world."""
        (a, b, c), (d, e, f), (g, h, i) = self.matrix_rows
        u, v, w = self.position
        return u + a * x + b * y + c * z, v + d * x + e * y + f * z, w + g * x + h * y + i * z

    def to_local(self, point: Point) -> Point:
        """Transforms a point from the world to the solid's frame."""
        (a, b, c), (d, e, f), (g, h, i) = self.matrix_rows
        x, y, z = (point[k] - self.position[k] for k in range(3))
        return a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z

    def direction_to_world(self, x: float, y: float, z: float) -> Point:
        """Rotates a direction from the solid's frame to the world."""
        (a, b, c), (d, e, f), (g, h, i) = self.matrix_rows
        return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z

    @cached_property
    def matrix(self) -> Array:
        """The rotation matrix, (3, 3)."""
        return np.array(self.matrix_rows)

    @cached_property
    def points(self) -> Array:
        """The points of the core in the world, (n, 3)."""
        points: Array = self.solid.core @ self.matrix.T + self.position
        return points

    @cached_property
    def normals(self) -> Array:
        """The normals of the faces in the world, (m, 3)."""
        normals: Array = self.solid.normals @ self.matrix.T
        return normals

    @cached_property
    def offsets(self) -> Array | None:
        """The offsets of the faces in the world, (m,)."""
        if self.solid.offsets is None:
            return None
        offsets: Array = self.solid.offsets + self.normals @ np.array(self.position)
        return offsets

    @cached_property
    def fcl_object(self) -> Any:
        """The surface of the core for FCL; a polyhedron for a cylinder and an ellipsoid."""
        import fcl

        pose = fcl.Transform(self.orientation, self.position)
        return fcl.CollisionObject(self.solid.surface.bvh, pose)

    def support_points(self, directions: Array) -> Array:
        """Returns the farthest points (k, 3) of the core in unit directions (k, 3)."""
        points = self.points
        farthest: Array = points[np.argmax(directions @ points.T, axis=1)]
        if self.solid.is_swept:
            farthest = farthest + self._swept_points(directions)
        return farthest

    def _swept_points(self, directions: Array) -> Array:
        """Returns the farthest points (k, 3) of the ellipsoid that is swept along the core."""
        # Scaled before it is rotated, so that a disc is normal to its axis up to rounding.
        scaled = directions @ self.matrix * self.solid.semi_axes
        length = np.sqrt((scaled * scaled).sum(axis=1))
        scaled /= np.maximum(length, 1e-300)[:, None]
        points: Array = scaled * self.solid.semi_axes @ self.matrix.T
        return points

    def extreme_points(self, direction: Array, tolerance: float) -> Array:
        """Returns the points (n, 3) of the core that are farthest in a unit direction."""
        points = self.points
        heights = points @ direction
        farthest_points: Array = points[heights >= heights.max() - tolerance]
        if self.solid.type == "ellipsoid":
            return self.support_points(direction[None])
        if not self.solid.disc_radius:
            return farthest_points
        radial = direction @ self.matrix[:, :2]
        length = float(np.linalg.norm(radial))
        if self.solid.disc_radius * length > tolerance:
            farthest_points += self.solid.disc_radius / length * radial @ self.matrix[:, :2].T
            return farthest_points
        rim = self.solid.surface.vertices @ self.matrix.T + self.position
        farthest_points = rim[rim @ direction >= (rim @ direction).max() - 2 * tolerance]
        return np.ascontiguousarray(farthest_points)

    def support_heights(self, directions: Array) -> Array:
        """Returns the extents (k,) of the core from the origin in unit directions (k, 3), m."""
        farthest: Array = (directions @ self.points.T).max(axis=1)
        if self.solid.is_swept:
            scaled = directions @ self.matrix * self.solid.semi_axes
            farthest = farthest + np.sqrt((scaled * scaled).sum(axis=1))
        return farthest
