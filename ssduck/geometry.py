"""Shapes, poses and exact boxes; pure functions over numpy arrays.

Metres and radians. Quaternions are w, x, y, z and of unit length. A pose is that of a frame B
in a frame A: `point_A = position + R(orientation) @ point_B`. Arrays of n frames have shapes
(n, 3) and (n, 4).
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[np.float64]
Indices: TypeAlias = npt.NDArray[np.intp]
GeometryType: TypeAlias = Literal["sphere", "box", "cylinder", "capsule", "plane", "hull", "mesh"]

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
# Below this many points a hull costs more to find than it saves in each box.
WORTH_A_HULL = 9


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
    faces: npt.NDArray[np.int32]

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
        digest.update(f"{self.type}{self.size}".encode())
        digest.update(self.vertices.tobytes())
        digest.update(self.faces.tobytes())
        return digest.hexdigest()


@lru_cache(maxsize=256)
def load_mesh(path: Path, scale: tuple[float, ...]) -> tuple[Geometry, ...]:
    """A triangle mesh from a file that trimesh reads (OBJ, STL, …), scaled along its axes.

    Raises:
        ValueError: the file holds no triangles.
    """
    import trimesh

    loaded: Any = trimesh.load_mesh(path, process=False)
    faces = np.asarray(loaded.faces, dtype=np.int32)
    if len(faces) == 0:
        raise ValueError(f"{path} holds no triangles")
    vertices = np.asarray(loaded.vertices, dtype=np.float64) * np.asarray(scale)
    return (Geometry("mesh", (0.0, 0.0, 0.0), vertices, faces),)


@lru_cache(maxsize=256)
def load_hulls(path: Path, scale: tuple[float, ...]) -> tuple[Geometry, ...]:
    """The convex hull of each object in a file that trimesh reads, scaled along its axes.

    Raises:
        ValueError: the file holds no vertices.
    """
    import trimesh

    options: dict[str, Any] = {}
    if path.suffix.lower() == ".obj":
        options = {"split_objects": True, "split_groups": True}
    scene: Any = trimesh.load_scene(path, process=False, **options)
    pieces = [np.asarray(mesh.vertices) * np.asarray(scale) for mesh in scene.geometry.values()]
    if not any(map(len, pieces)):
        raise ValueError(f"{path} holds no vertices")
    return tuple(Geometry.hull(piece) for piece in pieces if len(piece))


# -- poses ------------------------------------------------------------------------------------

# R = 1/|q|^2 * (the products q_i q_j weighed so): one matrix product for all nine entries.
# Source: the rotation matrix of a quaternion, e.g. Shuster 1993, eq. 102 (transposed).
_products = np.zeros((4, 4, 3, 3))
for _i, _j, _row, _column, _weight in (
    *((0, 0, axis, axis, 1.0) for axis in range(3)),
    *(
        (1 + a, 1 + a, axis, axis, 1.0 if a == axis else -1.0)
        for a in range(3)
        for axis in range(3)
    ),
    *((1 + a, 1 + b, a, b, 2.0) for a in range(3) for b in range(3) if a != b),
    *((0, 1 + c, b, a, 2.0) for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1))),
    *((0, 1 + c, a, b, -2.0) for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1))),
):
    _products[_i, _j, _row, _column] += _weight
_PRODUCTS: Array = _products.reshape(16, 9)


def rotation_matrices(orientations: Array) -> Array:
    """(n, 4) unit quaternions to (n, 3, 3) rotation matrices."""
    count = len(orientations)
    products = (orientations[:, :, None] * orientations[:, None, :]).reshape(count, 16)
    return (products @ _PRODUCTS).reshape(count, 3, 3)


def rotate(matrices: Array, vectors: Array) -> Array:
    """Each (3, 3) of (n, 3, 3) times each (3,) of (n, 3)."""
    rotated: Array = np.einsum("nij,nj->ni", matrices, vectors)
    return rotated


def multiply(first: Array, second: Array) -> Array:
    """Hamilton products of (n, 4) quaternions: the rotation `second`, then `first`."""
    w, x, y, z = first.T
    a, b, c, d = second.T
    return np.stack(
        (
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        ),
        axis=-1,
    )


def compose(
    positions: Array, orientations: Array, inner_positions: Array, inner_orientations: Array
) -> tuple[Array, Array]:
    """Poses of C in A from those of B in A and of C in B; all of n rows."""
    matrices = rotation_matrices(orientations)
    return (
        positions + rotate(matrices, inner_positions),
        multiply(orientations, inner_orientations),
    )


def invert(positions: Array, orientations: Array) -> tuple[Array, Array]:
    """Poses of A in B from those of B in A."""
    inverse = orientations * np.array([1.0, -1.0, -1.0, -1.0])
    return -rotate(rotation_matrices(inverse), positions), inverse


# -- boxes ------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PlacedGeometry:
    """A geometry that is fixed to a frame: which one, and where in it."""

    frame: int
    geometry: Geometry
    position: Array
    orientation: Array


class Boxer:
    """Exact world boxes of groups of rigid frames' shapes, for many poses one after another.

    What does not depend on the poses is worked out once. A shape is either a *core*, which is
    a centre with half-axes, a radius around it and a disc across its third axis (spheres,
    boxes, cylinders and capsules are such), or a set of points (hulls and meshes), or a plane.

    Args:
        shapes: the shapes, in any order.
        groups: per shape, the group whose box it belongs to.
        count: how many groups there are. One without shapes gets a box of NaN.
    """

    def __init__(self, shapes: Sequence[PlacedGeometry], groups: Sequence[int], count: int) -> None:
        self.count = count
        pairs = list(zip(shapes, groups, strict=True))
        points, solid = _gathered_points(pairs)
        cores = [pair for pair in solid if pair[0].geometry.type != "plane"]
        self.planes = [pair for pair in solid if pair[0].geometry.type == "plane"]
        self._set_cores(cores)
        self._set_points(points)
        owners = [group for _, group in cores] + [group for _, group, _ in points]
        self._order = np.argsort(owners, kind="stable").astype(np.intp)
        self._groups, self._starts = np.unique(np.sort(owners), return_index=True)
        self._in_order = bool(np.all(np.diff(self._order) == 1))
        self._complete = len(self._groups) == count

    def _set_cores(self, cores: list[tuple[PlacedGeometry, int]]) -> None:
        self._core_frames = np.array([shape.frame for shape, _ in cores], dtype=np.intp)
        halves = np.zeros((len(cores), 3))
        self._radii = np.zeros((len(cores), 1))
        self._discs = np.zeros((len(cores), 1))
        for row, (shape, _) in enumerate(cores):
            a, b, c = shape.geometry.size
            match shape.geometry.type:
                case "box":
                    halves[row] = a / 2, b / 2, c / 2
                case "sphere":
                    self._radii[row] = a
                case "capsule":
                    halves[row, 2], self._radii[row] = b / 2, a
                case "cylinder":
                    halves[row, 2], self._discs[row] = b / 2, a
        self._round = bool(self._discs.any())
        local = rotation_matrices(_stacked([shape.orientation for shape, _ in cores], 4))
        self._axes = local[:, :, 2]
        centres = _stacked([shape.position for shape, _ in cores], 3)
        # Columns: the centre, then the three half-axes; one product turns them all.
        self._columns = np.concatenate((centres[:, :, None], local * halves[:, None, :]), axis=2)

    def _set_points(self, points: list[tuple[int, int, Array]]) -> None:
        counts = [len(rows) for _, _, rows in points]
        frames = [frame for frame, _, _ in points]
        self._points = (
            np.concatenate([rows for _, _, rows in points]) if points else np.zeros((0, 3))
        )
        self._point_frames = np.repeat(np.array(frames, dtype=np.intp), counts)
        self._point_starts = np.concatenate(([0], np.cumsum(counts)[:-1])).astype(np.intp)

    def boxes(self, positions: Array, matrices: Array) -> tuple[Array, Array]:
        """The boxes at these poses of the frames.

        Args:
            positions: (frames, 3).
            matrices: (frames, 3, 3) rotations.

        Returns:
            The lower and the upper corners, (groups, 3) each.
        """
        low, high = self._shape_boxes(positions, matrices)
        if len(low) and not self._in_order:
            low, high = low[self._order], high[self._order]
        if len(low) and len(self._starts) < len(low):
            low = np.minimum.reduceat(low, self._starts)
            high = np.maximum.reduceat(high, self._starts)
        if not self._complete:
            low, high = self._spread(low), self._spread(high)
        for shape, group in self.planes:
            _add_plane(low[group], high[group], shape, positions, matrices)
        return low, high

    def _shape_boxes(self, positions: Array, matrices: Array) -> tuple[Array, Array]:
        lows, highs = [], []
        if len(self._core_frames):
            turned = matrices[self._core_frames] @ self._columns
            centres = turned[:, :, 0] + positions[self._core_frames]
            extents = np.abs(turned[:, :, 1:]).sum(axis=2) + self._radii
            if self._round:
                along = rotate(matrices[self._core_frames], self._axes)
                extents = extents + self._discs * np.sqrt(np.maximum(0.0, 1.0 - along * along))
            lows.append(centres - extents)
            highs.append(centres + extents)
        if len(self._points):
            points = rotate(matrices[self._point_frames], self._points)
            points += positions[self._point_frames]
            lows.append(np.minimum.reduceat(points, self._point_starts))
            highs.append(np.maximum.reduceat(points, self._point_starts))
        if len(lows) == 1:
            return lows[0], highs[0]
        if not lows:
            return np.zeros((0, 3)), np.zeros((0, 3))
        return np.concatenate(lows), np.concatenate(highs)

    def _spread(self, rows: Array) -> Array:
        every = np.full((self.count, 3), np.nan)
        every[self._groups] = rows
        return every


def _gathered_points(
    pairs: list[tuple[PlacedGeometry, int]],
) -> tuple[list[tuple[int, int, Array]], list[tuple[PlacedGeometry, int]]]:
    """The point sets of each frame and group as one, reduced to its hull; and the other shapes.

    A box beside hulls on the same frame joins them by its corners.
    """
    with_points = {(shape.frame, group) for shape, group in pairs if len(shape.geometry.vertices)}
    sets: dict[tuple[int, int], list[Array]] = {}
    others = []
    for shape, group in pairs:
        key = (shape.frame, group)
        if len(shape.geometry.vertices) or (shape.geometry.type == "box" and key in with_points):
            sets.setdefault(key, []).append(_corners(shape))
        else:
            others.append((shape, group))
    return [
        (frame, group, _extreme(np.concatenate(parts))) for (frame, group), parts in sets.items()
    ], others


_SIGNS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


def _corners(shape: PlacedGeometry) -> Array:
    """The points of a polyhedral shape in its body's frame."""
    vertices = shape.geometry.vertices
    if shape.geometry.type == "box":
        vertices = _SIGNS * np.array(shape.geometry.size)
    matrix: Array = rotation_matrices(shape.orientation[None])[0]
    points: Array = vertices @ matrix.T + shape.position
    return points


def _extreme(points: Array) -> Array:
    """The points that a box can touch: the corners of the convex hull."""
    if len(points) < WORTH_A_HULL:
        return points
    from scipy.spatial import ConvexHull, QhullError

    try:
        corners: Array = points[ConvexHull(points).vertices]
    except QhullError:  # flat or thin sets have no hull with a volume; all their points serve
        return points
    return corners


def _add_plane(
    low: Array, high: Array, shape: PlacedGeometry, positions: Array, matrices: Array
) -> None:
    """Widen a box in place by a half-space: endless, but for a side across an axis."""
    local = rotation_matrices(shape.orientation[None])[0]
    normal = matrices[shape.frame] @ (local @ np.array(shape.geometry.size))
    origin = positions[shape.frame] + matrices[shape.frame] @ shape.position
    low_plane, high_plane = np.full(3, -np.inf), np.full(3, np.inf)
    axis = int(np.argmax(np.abs(normal)))
    if abs(normal[axis]) > 1.0 - 1e-9:
        (high_plane if normal[axis] > 0 else low_plane)[axis] = origin[axis]
    low[:] = np.fmin(low, low_plane)
    high[:] = np.fmax(high, high_plane)


def _stacked(rows: list[Array], width: int) -> Array:
    return np.stack(rows) if rows else np.zeros((0, width))
