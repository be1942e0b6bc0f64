"""Geometries, and geometries that are fixed to a frame."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array, Triangles

GeometryType: TypeAlias = Literal[
    "sphere", "box", "cylinder", "capsule", "ellipsoid", "plane", "hull", "mesh"
]


@dataclass(frozen=True, eq=False)
class Geometry:
    """The form of a collision shape, in the shape's own frame.

    Attributes:
        type: the kind. A hull is the convex hull of its vertices, a mesh the surface of its faces,
            a plane the solid half-space below the origin, opposite to its normal.
        size: metres. box: full x, y, z; sphere: radius, 0, 0; cylinder and capsule: radius,
            length along z (of a capsule without its caps), 0; ellipsoid: half its lengths along
            x, y, z; plane: its unit normal; else 0s.
        vertices: (n, 3), scaled; empty for primitives.
        faces: (m, 3) indices of vertices; empty for primitives and hulls.
    """

    type: GeometryType
    size: tuple[float, float, float]
    vertices: Array
    faces: Triangles

    @classmethod
    def primitive(cls, type: GeometryType, size: Sequence[float]) -> Geometry:
        """Returns a box, sphere, cylinder, capsule, ellipsoid or plane of a size.

        >>> Geometry.primitive("box", (0.1, 0.2, 0.3)).size
        (0.1, 0.2, 0.3)
        """
        x, y, z = (float(value) for value in size)
        return cls(type, (x, y, z), np.zeros((0, 3)), np.zeros((0, 3), np.int32))

    @classmethod
    def hull(cls, vertices: npt.ArrayLike) -> Geometry:
        """Returns the convex hull of points, (n, 3).

        >>> Geometry.hull([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]).vertices.shape
        (4, 3)
        """
        points = np.array(vertices, dtype=np.float64).reshape(-1, 3)
        return cls("hull", (0.0, 0.0, 0.0), points, np.zeros((0, 3), np.int32))

    @cached_property
    def key(self) -> str:
        """A digest of the content: equal geometries have equal keys and are stored once."""
        digest = hashlib.blake2b(digest_size=12)
        digest.update(f"{self.type}{self.size}{self.vertices.shape}".encode())
        digest.update(self.vertices.tobytes())
        digest.update(self.faces.tobytes())
        return digest.hexdigest()


@dataclass(frozen=True, eq=False)
class PlacedGeometry:
    """A geometry at a pose in a frame.

    Attributes:
        frame: the number of the frame.
        geometry: the form.
        position: (3,), in the frame, metres.
        orientation: (4,), in the frame, w, x, y, z.
        margin: the collision margin of the simulator, metres.
        exact: whether the simulator uses this shape. If False, the shape is a bounding box that
            stands in for an unknown one, or a sphere about a vertex of a form that bends. None if
            that is not known.
    """

    frame: int
    geometry: Geometry
    position: Array
    orientation: Array
    margin: float = 0.0
    exact: bool | None = True
