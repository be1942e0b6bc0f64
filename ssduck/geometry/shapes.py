"""Shapes, poses and exact boxes; pure functions over numpy arrays.

Metres and radians. Quaternions are w, x, y, z and of unit length. A pose is that of a frame B
in a frame A: `point_A = position + R(orientation) @ point_B`. Arrays of n frames have shapes
(n, 3) and (n, 4).
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[np.float64]
Indices: TypeAlias = npt.NDArray[np.intp]
Triangles: TypeAlias = npt.NDArray[np.int32]
# A plane whose normal is off an axis by less is across it: 1 km out that is 1e-6 m.
LEVEL = 1e-9

GeometryType: TypeAlias = Literal["sphere", "box", "cylinder", "capsule", "plane", "hull", "mesh"]

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
# Points are turned and compared in bunches of this size; a box has eight corners.
TOGETHER = 8
# Below this many points a hull costs more to find than it saves in each box.
WORTH_A_HULL = 9
# A scene has a few dozen mesh files at most, each in one or two sizes. What is not used any
# more goes, so that big meshes do not add up.
CACHED_FILES = 64


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


# -- mesh files -------------------------------------------------------------------------------


def load_mesh(path: Path, scale: tuple[float, ...]) -> Geometry:
    """All triangles of a mesh file (OBJ, STL, …), scaled along its axes.

    Raises:
        ValueError: the file cannot be read, or holds no triangles.
    """
    return _mesh(path, scale, _stamp(path))


def load_hulls(path: Path, scale: tuple[float, ...]) -> tuple[Geometry, ...]:
    """The convex hull of each object in a mesh file (OBJ, STL, …), scaled along its axes.

    Raises:
        ValueError: the file cannot be read, or holds no triangles.
    """
    return _hulls(path, scale, _stamp(path))


def _stamp(path: Path) -> tuple[int, int]:
    """Tells a file from what it was before it was written anew."""
    try:
        status = path.stat()
    except OSError as error:
        raise ValueError(f"{path} cannot be read: {error.strerror}") from error
    return status.st_mtime_ns, status.st_size


@lru_cache(maxsize=CACHED_FILES)
def _mesh(path: Path, scale: tuple[float, ...], _: tuple[int, int]) -> Geometry:
    vertices, objects = _read_triangles(path)
    return Geometry("mesh", (0.0, 0.0, 0.0), vertices * scale, np.concatenate(objects))


@lru_cache(maxsize=CACHED_FILES)
def _hulls(path: Path, scale: tuple[float, ...], _: tuple[int, int]) -> tuple[Geometry, ...]:
    vertices, objects = _read_triangles(path)
    return tuple(Geometry.hull(vertices[np.unique(faces)] * scale) for faces in objects)


def _read_triangles(path: Path) -> tuple[Array, list[Triangles]]:
    """The vertices of a file, and the triangles of each of its objects."""
    try:
        if path.suffix.lower() == ".obj":
            vertices, objects = _read_obj(path.read_text(encoding="utf-8", errors="replace"))
        else:
            vertices, objects = _read_other(path)
    except Exception as error:  # of any kind: trimesh lets its readers' own errors through
        raise ValueError(f"{path} cannot be read as a mesh: {error}") from error
    if not objects:
        raise ValueError(f"{path} holds no triangles")
    used = np.concatenate(objects)
    if used.min() < 0 or used.max() >= len(vertices):
        raise ValueError(f"{path}: a face has a vertex that is not there")
    if not np.isfinite(vertices[used]).all():
        raise ValueError(f"{path}: a vertex is no finite number")
    return vertices, objects


def _read_obj(text: str) -> tuple[Array, list[Triangles]]:
    """An OBJ file; `o` and `g` begin an object, as they do for PyBullet."""
    vertices: list[list[float]] = []
    objects: list[list[list[int]]] = [[]]
    for line in text.splitlines():
        match line.partition("#")[0].split():
            case ["v", x, y, z, *_]:
                vertices.append([float(x), float(y), float(z)])
            case ["f", *corners]:
                # A corner is vertex/texture/normal; numbers count from 1, or back from the end.
                numbers = [int(corner.partition("/")[0]) for corner in corners]
                face = [n - 1 if n > 0 else len(vertices) + n for n in numbers]
                objects[-1] += [[face[0], *edge] for edge in pairwise(face[1:])]
            case ["o" | "g", *_]:
                objects.append([])
    return (
        np.array(vertices, dtype=np.float64).reshape(-1, 3),
        [np.array(triangles, dtype=np.int32) for triangles in objects if triangles],
    )


def _read_other(path: Path) -> tuple[Array, list[Triangles]]:
    """A file that trimesh reads, as one object."""
    import trimesh

    loaded: Any = trimesh.load_mesh(path, process=False)
    faces = np.asarray(loaded.faces, dtype=np.int32).reshape(-1, 3)
    return np.asarray(loaded.vertices, dtype=np.float64), [faces] if len(faces) else []


# -- poses ------------------------------------------------------------------------------------

# A row's result has the same bits in whatever company it is worked out: a tick's rows, a few of
# them, those of many ticks. So these are sums of a fixed order, term by term over all rows: of a
# matrix product, or of `einsum`, the order depends on the number of rows.


def rotation_matrices(orientations: Array) -> Array:
    """(n, 4) unit quaternions to (n, 3, 3) rotation matrices."""
    return np.ascontiguousarray(turns_of(orientations).T).reshape(-1, 3, 3)


def turns_of(orientations: Array) -> Array:
    """As `rotation_matrices`, one row an entry: (n, 4) to (9, n)."""
    # R = (s s - u.u) 1 + 2 u u^T + 2 s [u x], e.g. Shuster 1993, eq. 102 (transposed). In few
    # operations, each on several rows: in a tick of a small world these cost more than the sums.
    columns = np.ascontiguousarray(orientations.T)
    products = columns.take(_FIRST, axis=0)
    products *= columns.take(_SECOND, axis=0)
    with_w, mixed, squares = products[:3], products[3:6], products[7:, None] * _SIGNS
    entries = np.zeros((9, len(orientations)))
    diagonal = entries[:3]
    np.add(products[6], squares[0], out=diagonal)
    diagonal += squares[1]
    diagonal += squares[2]
    np.subtract(mixed, with_w, out=entries[3:6])
    np.add(mixed, with_w, out=entries[6:])
    entries[3:] *= 2.0
    turns: Array = entries.take(_ROW_BY_ROW, axis=0)
    return turns


# The products wz, wx, wy; xy, yz, zx; ww, xx, yy, zz.
_FIRST = np.array([0, 0, 0, 1, 2, 3, 0, 1, 2, 3])
_SECOND = np.array([3, 1, 2, 2, 3, 1, 0, 1, 2, 3])
# Of xx, yy and zz in each entry of the diagonal.
_SIGNS = np.array([[1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])[:, :, None]
# The diagonal, then xy - wz, yz - wx, zx - wy, then the same sums, as the rows of a matrix.
_ROW_BY_ROW = np.array([0, 3, 8, 6, 1, 4, 5, 7, 2])


def rotate(matrices: Array, vectors: Array) -> Array:
    """Each (3, 3) of (n, 3, 3) times each (3,) of (n, 3)."""
    products = matrices * vectors[:, None, :]
    rotated: Array = products[:, :, 0] + products[:, :, 1]
    rotated += products[:, :, 2]
    return rotated


def cross(first: Array, second: Array) -> Array:
    """Cross products of the rows of (n, 3)."""
    products = first.take(_CROSSED, axis=1)
    products *= second.take(_CROSSED_WITH, axis=1)
    crossed: Array = products[:, :3] - products[:, 3:]
    return crossed


_CROSSED = np.array([1, 2, 0, 2, 0, 1])
_CROSSED_WITH = np.array([2, 0, 1, 1, 2, 0])


def multiply(first: Array, second: Array) -> Array:
    """Hamilton products of (n, 4) quaternions: the rotation `second`, then `first`."""
    # (s, u)(t, v) = (s t - u.v, s v + t u + u x v)
    w, x, y, z = np.ascontiguousarray(first.T)
    s, i, j, k = np.ascontiguousarray(second.T)
    product = np.array(
        [
            w * s - x * i - y * j - z * k,
            w * i + x * s + y * k - z * j,
            w * j + y * s + z * i - x * k,
            w * k + z * s + x * j - y * i,
        ]
    )
    return np.ascontiguousarray(product.T)


def unit_quaternions(orientations: Array) -> Array:
    """Quaternions (n, 4) of length 1; NaN where they have none."""
    squares = orientations * orientations
    length = np.sqrt(squares[:, 0] + squares[:, 1] + squares[:, 2] + squares[:, 3])
    with np.errstate(invalid="ignore", divide="ignore"):
        unit: Array = orientations / length[:, None]
    return unit


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


def quaternion_of(matrix: Array) -> Array:
    """A rotation matrix (3, 3) as a unit quaternion."""
    from scipy.spatial.transform import Rotation

    turn: Array = np.roll(Rotation.from_matrix(matrix).as_quat(), 1)
    return turn


# -- boxes ------------------------------------------------------------------------------------


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


@dataclass(frozen=True, eq=False)
class _Core:
    """Points of a frame, with a sphere around each, or a disc across an axis around each.

    What is convex of a shape, for its box: a sphere is one point with a sphere, a capsule two; a
    cylinder is two with discs; boxes, hulls and meshes are points with neither.

    Attributes:
        group: whose box it belongs to.
        frame: whose points these are.
        points: (n, 3), in the frame.
        radius: of the spheres.
        disc: (2, 3), two radii of the discs at a right angle.
    """

    group: int
    frame: int
    points: Array
    radius: float = 0.0
    disc: Array = field(default_factory=lambda: np.zeros((2, 3)))

    def parts(self) -> Iterator[_Core]:
        """The same with `TOGETHER` points each; the last point is there as often as it takes."""
        for start in range(0, len(self.points), TOGETHER):
            some = np.minimum(np.arange(start, start + TOGETHER), len(self.points) - 1)
            yield replace(self, points=self.points[some])


class Boxer:
    """Exact world boxes of groups of rigid frames' shapes, for many poses one after another.

    What does not depend on the poses is worked out once.

    Args:
        shapes: the shapes, in any order.
        groups: per shape, the group whose box it belongs to.
        count: how many groups there are. One without shapes gets an empty box: its lower
            corner is at infinity, its upper one at minus infinity.
    """

    def __init__(self, shapes: Sequence[PlacedGeometry], groups: Sequence[int], count: int) -> None:
        pairs = list(zip(shapes, groups, strict=True))
        self._planes = [pair for pair in pairs if pair[0].geometry.type == "plane"]
        self._count = count
        cores = [part for core in _cores(pairs) for part in core.parts()]
        cores.sort(key=lambda core: core.group)
        self._groups, self._starts = np.unique(
            np.array([core.group for core in cores], dtype=np.intp), return_index=True
        )
        self._frames = np.array([core.frame for core in cores], dtype=np.intp)
        self._radii = np.array([core.radius for core in cores])
        self._has_discs = any(core.disc.any() for core in cores)
        # What turns with the frames: of each core its points, then two radii of its discs.
        turning = [core.points for core in cores]
        if self._has_discs:
            turning = [np.vstack((core.points, core.disc)) for core in cores]
        self._vectors = np.array(turning).reshape(len(cores), -1, 3).T.copy() if cores else None

    def boxes(self, positions: Array, matrices: Array) -> Array:
        """The boxes at these poses of the frames.

        Args:
            positions: (frames, 3).
            matrices: (frames, 3, 3) rotations.

        Returns:
            (6, groups): the lower corners' x, y, z, then the upper corners'.
        """
        boxes = self._of_groups(positions, matrices)
        for shape, group in self._planes:
            _add_plane(boxes[:, group], shape, positions, matrices)
        return boxes

    def _of_groups(self, positions: Array, matrices: Array) -> Array:
        if self._vectors is None:
            return self._spread(np.zeros((6, 0)))
        low, high = self._of_cores(positions, matrices, self._vectors)
        boxes = np.zeros((6, len(self._groups)))
        np.minimum.reduceat(low, self._starts, axis=1, out=boxes[:3])
        np.maximum.reduceat(high, self._starts, axis=1, out=boxes[3:])
        return boxes if len(self._groups) == self._count else self._spread(boxes)

    def _of_cores(self, positions: Array, matrices: Array, vectors: Array) -> tuple[Array, Array]:
        """The lower and the upper corners of the cores' boxes, (3, cores) each."""
        # Copies, for what is not contiguous costs more than copying it.
        turn = matrices.reshape(-1, 9).take(self._frames, axis=0).T.copy().reshape(3, 3, -1)
        turned = turn[:, 0, None] * vectors[0]
        turned += turn[:, 1, None] * vectors[1]
        turned += turn[:, 2, None] * vectors[2]
        origins = positions.take(self._frames, axis=0).T.copy()
        low = turned[:, :TOGETHER].min(axis=1) + origins
        high = turned[:, :TOGETHER].max(axis=1) + origins
        reach = self._radii
        if self._has_discs:
            # A circle reaches as far along x as the x of two of its radii are long together.
            sides = turned[:, TOGETHER:]
            reach = reach + np.sqrt(sides[:, 0] * sides[:, 0] + sides[:, 1] * sides[:, 1])
        return low - reach, high + reach

    def _spread(self, boxes: Array) -> Array:
        """The boxes of all groups, those without shapes among them."""
        every = np.repeat([[np.inf], [-np.inf]], 3, axis=0).repeat(self._count, axis=1)
        every[:, self._groups] = boxes
        return every


def _cores(pairs: Sequence[tuple[PlacedGeometry, int]]) -> list[_Core]:
    """What the boxes of all shapes but planes are made of.

    The polyhedral shapes of a frame and a group become one set of points: those of its hull.
    """
    cores = []
    polyhedra: dict[tuple[int, int], list[Array]] = {}
    for shape, group in pairs:
        matrix = rotation_matrices(shape.orientation[None])[0]
        a, b, c = shape.geometry.size
        ends = _ENDS * b @ matrix.T + shape.position
        match shape.geometry.type:
            case "sphere":
                cores.append(_Core(group, shape.frame, shape.position[None], radius=a))
            case "capsule":
                cores.append(_Core(group, shape.frame, ends, radius=a))
            case "cylinder":
                cores.append(_Core(group, shape.frame, ends, disc=a * matrix[:, :2].T))
            case "box" | "hull" | "mesh" as kind:
                corners = _CORNERS * (a, b, c) if kind == "box" else shape.geometry.vertices
                placed = corners @ matrix.T + shape.position
                polyhedra.setdefault((group, shape.frame), []).append(placed)
    for (group, frame), sets in polyhedra.items():
        cores.append(_Core(group, frame, _extreme(np.concatenate(sets))))
    return cores


_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_ENDS = np.array([[0.0, 0.0, -0.5], [0.0, 0.0, 0.5]])


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


def _add_plane(box: Array, shape: PlacedGeometry, positions: Array, matrices: Array) -> None:
    """Widen a box (6,) in place by a half-space: endless, but for a side across an axis."""
    local = rotation_matrices(shape.orientation[None])[0]
    normal = matrices[shape.frame] @ (local @ np.array(shape.geometry.size))
    origin = positions[shape.frame] + matrices[shape.frame] @ shape.position
    if not np.isfinite(normal + origin).all():
        box[:] = np.nan
        return
    low, high = np.full(3, -np.inf), np.full(3, np.inf)
    axis = int(np.argmax(np.abs(normal)))
    if np.abs(np.delete(normal, axis)).max() < LEVEL:
        (high if normal[axis] > 0 else low)[axis] = origin[axis]
    np.minimum(box[:3], low, out=box[:3])
    np.maximum(box[3:], high, out=box[3:])
