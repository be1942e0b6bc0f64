"""Shapes in frames of their own, and shapes that are fixed to frames."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array, Triangles

GeometryType: TypeAlias = Literal["sphere", "box", "cylinder", "capsule", "plane", "hull", "mesh"]


@dataclass(frozen=True, eq=False)
class Geometry:
    """One collision shape in its own frame.

    Attributes:
        type: what it is. A hull is the convex hull of its vertices, a mesh the surface of its
            faces, a plane the solid half-space below the origin against the normal.
        size: metres. box: full x, y, z; sphere: radius, 0, 0; cylinder and capsule: radius,
            length along z (of a capsule without its caps), 0; plane: its unit normal; else 0s.
        vertices: (n, 3), scaled; empty for primitives.
        faces: (m, 3) indices of vertices; empty for primitives and hulls.
    """

    type: GeometryType
    size: tuple[float, float, float]
    vertices: Array
    faces: Triangles

    @classmethod
    def primitive(cls, type: GeometryType, size: Sequence[float]) -> Geometry:
        """A box, sphere, cylinder, capsule or plane of that size."""
        x, y, z = (float(value) for value in size)
        return cls(type, (x, y, z), np.zeros((0, 3)), np.zeros((0, 3), np.int32))

    @classmethod
    def hull(cls, vertices: npt.ArrayLike) -> Geometry:
        """The convex hull of points, (n, 3)."""
        points = np.array(vertices, dtype=np.float64).reshape(-1, 3)
        return cls("hull", (0.0, 0.0, 0.0), points, np.zeros((0, 3), np.int32))

    @cached_property
    def key(self) -> str:
        """Equal for equal shapes: geometries are stored and built once by content."""
        digest = hashlib.blake2b(digest_size=12)
        digest.update(f"{self.type}{self.size}{self.vertices.shape}".encode())
        digest.update(self.vertices.tobytes())
        digest.update(self.faces.tobytes())
        return digest.hexdigest()


@dataclass(frozen=True, eq=False)
class PlacedGeometry:
    """A geometry that is fixed to a frame: which one, and where in it.

    Attributes:
        frame: the frame's number.
        geometry: the shape.
        position: (3,), in the frame, metres.
        orientation: (4,), in the frame, w, x, y, z.
        margin: how far around the shape the simulator takes others to touch it, metres.
        exact: whether it is what the simulator has; else it is a box that stands in for that.
            None if nobody knows.
    """

    frame: int
    geometry: Geometry
    position: Array
    orientation: Array
    margin: float = 0.0
    exact: bool | None = True
