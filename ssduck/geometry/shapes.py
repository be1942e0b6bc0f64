"""Geometries, geometries that are fixed to a frame, and the meshes of height fields."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.errors import ArgumentError
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

        Args:
            type: the kind.
            size: three numbers for each kind, see `Geometry`.

        >>> Geometry.primitive("box", (0.1, 0.2, 0.3)).size
        (0.1, 0.2, 0.3)
        >>> Geometry.primitive("sphere", (0.1, 0, 0)).size
        (0.1, 0.0, 0.0)
        """
        if len(size) != 3:
            raise ArgumentError(
                f"the size of a {type} has three numbers, not {len(size)}: of a sphere radius, 0, "
                "0; of a cylinder or a capsule radius, length, 0"
            )
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
        colour: of a shape that is drawn, red, green, blue, alpha, from 0 to 1; None without one.
    """

    frame: int
    geometry: Geometry
    position: Array
    orientation: Array
    margin: float = 0.0
    exact: bool | None = True
    colour: tuple[float, float, float, float] | None = None


def height_field(
    heights: npt.ArrayLike, rows: int, columns: int, scale: Sequence[float] = (1.0, 1.0, 1.0)
) -> tuple[Array, Triangles]:
    """Returns the surface of a height field as PyBullet builds it, to be passed as one of `shapes`.

    PyBullet puts the centre of the field's box at the origin of the body.

    >>> vertices, faces = height_field([0.0, 0.0, 0.0, 1.0], 2, 2)
    >>> vertices[:, 2].tolist(), faces.tolist()
    ([-0.5, -0.5, -0.5, 0.5], [[0, 1, 2], [1, 3, 2]])

    Args:
        heights: rows times columns numbers, as `heightfieldData` of `createCollisionShape`.
        rows: `numHeightfieldRows`: the number of heights along x.
        columns: `numHeightfieldColumns`: the number of heights along y.
        scale: `meshScale`: metres between two heights along x and y, and for one unit of height.

    Returns:
        The vertices (rows · columns, 3), metres, and the faces, (n, 3).

    Raises:
        ArgumentError: there are fewer than two rows or columns, the number of heights differs, or
            a number is not finite.
    """
    if min(rows, columns) < 2:
        raise ArgumentError(f"a height field has 2 rows and columns at least: {rows}, {columns}")
    values = _numbers(heights, rows * columns, f"heights are to be {rows} times {columns}")
    size = _numbers(scale, 3, "scale is to be three")
    # PyBullet stores heights in single precision.
    z = values.astype(np.float32).astype(np.float64)
    y, x = np.divmod(np.arange(rows * columns), rows)
    centre = (rows - 1) / 2, (columns - 1) / 2, (z.min() + z.max()) / 2
    vertices = (np.column_stack((x, y, z)) - centre) * size
    first = (np.arange(columns - 1)[:, None] * rows + np.arange(rows - 1)).reshape(-1)
    next_x, next_y, diagonal = first + 1, first + rows, first + rows + 1
    lower, upper = np.array((first, next_x, next_y)), np.array((next_x, diagonal, next_y))
    return vertices, np.hstack((lower, upper)).T.astype(np.int32)


def _numbers(values: npt.ArrayLike, count: int, rule: str) -> Array:
    try:
        numbers = np.asarray(values, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"{rule} finite numbers") from error
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise ArgumentError(f"{rule} finite numbers")
    return numbers
