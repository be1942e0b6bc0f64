"""Computes exact axis-aligned bounding boxes of shapes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ssduck.geometry.arrays import Array
from ssduck.geometry.poses import rotation_matrices
from ssduck.geometry.shapes import PlacedGeometry
from ssduck.geometry.solids import CORNERS

# A normal that deviates from an axis by less counts as parallel to it: 1e-6 m at 1 km.
AXIS_TOLERANCE = 1e-9
# Points are rotated and compared in groups of this size. A box has eight corners.
GROUP_SIZE = 8
# Below this number of points, computing a hull costs more than it saves.
MIN_HULL_POINTS = 9


@dataclass(frozen=True, eq=False)
class _Core:
    """Points of a frame, each with a sphere, a disc or an ellipsoid around it."""

    group: int  # the group whose box it belongs to
    frame: int  # the frame of its points
    points: Array  # (n, 3), in the frame
    radius: float = 0.0  # of the spheres
    axes: Array = field(default_factory=lambda: np.zeros((0, 3)))

    def parts(self) -> Iterator[_Core]:
        """Splits the points into groups of `GROUP_SIZE`; the last point is repeated to fill one."""
        for start in range(0, len(self.points), GROUP_SIZE):
            indices = np.minimum(np.arange(start, start + GROUP_SIZE), len(self.points) - 1)
            yield replace(self, points=self.points[indices])


class BoundingBoxes:
    """Exact boxes of groups of shapes on rigid frames, for many sets of poses.

    The constructor computes all that does not depend on the poses.

    >>> from ssduck.geometry.poses import IDENTITY
    >>> from ssduck.geometry.shapes import Geometry
    >>> ball = PlacedGeometry(0, Geometry.primitive("sphere", (0.5, 0, 0)), np.zeros(3), IDENTITY)
    >>> BoundingBoxes([ball], [0], 1).boxes(np.ones((1, 3)), np.eye(3)[None])[:, 0].tolist()
    [0.5, 0.5, 0.5, 1.5, 1.5, 1.5]

    Args:
        shapes: the shapes, in any order.
        groups: for each shape, the group whose box it belongs to.
        count: the number of groups. A group without shapes gets an empty box: its lower corner is
            at infinity, its upper corner at minus infinity.
    """

    def __init__(self, shapes: Sequence[PlacedGeometry], groups: Sequence[int], count: int) -> None:
        pairs = list(zip(shapes, groups, strict=True))
        self._planes = [pair for pair in pairs if pair[0].geometry.type == "plane"]
        self._plane_frames = np.array([shape.frame for shape, _ in self._planes], dtype=np.intp)
        # The boxes of the planes, and the poses that they are of: a plane rarely moves.
        self._last_planes: tuple[bytes, list[Array]] | None = None
        self._count = count
        self._empty = np.repeat([[np.inf], [-np.inf]], 3, axis=0).repeat(count, axis=1)
        cores = [part for core in _cores(pairs) for part in core.parts()]
        cores.sort(key=lambda core: core.group)
        self._groups, self._starts = np.unique(
            np.array([core.group for core in cores], dtype=np.intp), return_index=True
        )
        self._frames = np.array([core.frame for core in cores], dtype=np.intp)
        self._radii = np.array([core.radius for core in cores])
        count = max((len(core.axes) for core in cores), default=0)
        # These rotate with the frames: the points of each core, then the half axes around them.
        vectors = [
            np.vstack((core.points, core.axes, np.zeros((count - len(core.axes), 3))))
            for core in cores
        ]
        self._vectors = np.array(vectors).reshape(len(cores), -1, 3).T.copy() if cores else None

    def boxes(self, positions: Array, matrices: Array) -> Array:
        """Returns the boxes (6, groups): lower corners, upper corners; infinite with a plane.

        The frames are at positions (frames, 3) with rotations (frames, 3, 3).
        """
        boxes = self._group_boxes(positions, matrices)
        if self._planes:
            self._extend(boxes, positions, matrices)
        return boxes

    def _extend(self, boxes: Array, positions: Array, matrices: Array) -> None:
        """Extends boxes, (6, groups) or (n, 6, groups), by those of the planes in the groups."""
        extents = self._plane_boxes(positions, matrices)
        for (_, group), (low, high) in zip(self._planes, extents, strict=True):
            box = boxes[..., group]
            np.minimum(box[..., :3], low, out=box[..., :3])
            np.maximum(box[..., 3:], high, out=box[..., 3:])

    def _plane_boxes(self, positions: Array, matrices: Array) -> list[Array]:
        """Returns the box of each plane, (2, 3): the lower corner and the upper one."""
        placed = (
            positions.take(self._plane_frames, axis=0),
            matrices.take(self._plane_frames, axis=0),
        )
        poses = placed[0].tobytes() + placed[1].tobytes()
        last = self._last_planes
        if last is None or last[0] != poses:
            boxes = [_plane_box(shape, positions, matrices) for shape, _ in self._planes]
            last = self._last_planes = poses, boxes
        return last[1]

    def _group_boxes(self, positions: Array, matrices: Array) -> Array:
        if self._vectors is None:
            return self._empty.copy()
        # Copied, because operations on strided arrays cost more than a copy.
        rotations = matrices.reshape(-1, 9).take(self._frames, axis=0).T.copy().reshape(3, 3, -1)
        origins = positions.take(self._frames, axis=0).T.copy()
        low, high = self._core_boxes(origins, rotations, self._vectors)
        if len(self._groups) == len(self._frames):  # a core each
            boxes = np.concatenate((low, high))
        else:
            boxes = np.zeros((6, len(self._groups)))
            np.minimum.reduceat(low, self._starts, axis=1, out=boxes[:3])
            np.maximum.reduceat(high, self._starts, axis=1, out=boxes[3:])
        if len(self._groups) == self._count:
            return boxes
        all_boxes = self._empty.copy()
        all_boxes[:, self._groups] = boxes
        return all_boxes

    def over(self, positions: Array, matrices: Array) -> Array:
        """Returns the boxes (n, 6, groups) at n sets of poses, as `boxes` does of each."""
        # What stands still does so in all of them.
        is_same = all(
            (poses[-1] == poses[0]).all() and (poses == poses[0]).all()
            for poses in (positions, matrices)
        )
        if is_same or self._vectors is None:
            rows = range(1 if is_same else len(positions))
            each = np.stack([self.boxes(positions[row], matrices[row]) for row in rows])
            return np.broadcast_to(each, (len(positions), *each.shape[1:]))
        rotations = matrices.transpose(2, 3, 0, 1).take(self._frames, axis=-1)
        origins = positions.transpose(2, 0, 1).take(self._frames, axis=-1)
        low, high = self._core_boxes(origins, rotations, self._vectors[:, :, None])
        if len(self._groups) < len(self._frames):  # several cores in a group
            low = np.minimum.reduceat(low, self._starts, axis=-1)
            high = np.maximum.reduceat(high, self._starts, axis=-1)
        boxes = np.concatenate((low, high)).swapaxes(0, 1)
        if len(self._groups) < self._count:
            own, boxes = boxes, np.repeat(self._empty[None], len(positions), axis=0)
            boxes[..., self._groups] = own
        planes = [poses.take(self._plane_frames, axis=1) for poses in (positions, matrices)]
        if all((poses == poses[0]).all() for poses in planes):
            self._extend(boxes, positions[0], matrices[0])
        else:
            for row in range(len(boxes)):
                self._extend(boxes[row], positions[row], matrices[row])
        return boxes

    def _core_boxes(self, origins: Array, rotations: Array, vectors: Array) -> tuple[Array, Array]:
        """Returns the lower and the upper corners of the cores' boxes, (3, …, cores) each."""
        rotated = rotations[:, 0, None] * vectors[0]
        rotated += rotations[:, 1, None] * vectors[1]
        rotated += rotations[:, 2, None] * vectors[2]
        points = rotated[:, :GROUP_SIZE]
        low = np.minimum.reduce(points, axis=1) + origins
        high = np.maximum.reduce(points, axis=1) + origins
        radii = self._radii
        if rotated.shape[1] > GROUP_SIZE:
            # The extent of an ellipsoid along x is the length of the vector of its half axes' x.
            sides = rotated[:, GROUP_SIZE:]
            # Sums in one order, for one core as for several, which those of einsum are not.
            squares = (sides * sides).swapaxes(0, 1)
            radii = radii + np.sqrt(sum(squares[1:], squares[0]))
        return low - radii, high + radii


def _cores(pairs: Sequence[tuple[PlacedGeometry, int]]) -> list[_Core]:
    """Returns the cores of all shapes but planes."""
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
                cores.append(_Core(group, shape.frame, ends, axes=a * matrix[:, :2].T))
            case "ellipsoid":
                axes = matrix.T * np.array([[a], [b], [c]])
                cores.append(_Core(group, shape.frame, shape.position[None], axes=axes))
            case "box" | "hull" | "mesh" as kind:
                corners = CORNERS * (a, b, c) if kind == "box" else shape.geometry.vertices
                placed = corners @ matrix.T + shape.position
                polyhedra.setdefault((group, shape.frame), []).append(placed)
    for (group, frame), sets in polyhedra.items():
        cores.append(_Core(group, frame, _hull_corners(np.concatenate(sets))))
    return cores


_ENDS = np.array([[0.0, 0.0, -0.5], [0.0, 0.0, 0.5]])


def _hull_corners(points: Array) -> Array:
    """Returns the points that a box can touch: the corners of the convex hull."""
    if len(points) < MIN_HULL_POINTS:
        return points
    from scipy.spatial import ConvexHull, QhullError

    try:
        corners: Array = points[ConvexHull(points).vertices]
    except QhullError:  # a flat or thin set has no hull with a volume
        return points
    return corners


def _plane_box(shape: PlacedGeometry, positions: Array, matrices: Array) -> Array:
    """Returns the box (2, 3) of a half-space: infinite, but for an axis-aligned side."""
    local = rotation_matrices(shape.orientation[None])[0]
    normal = matrices[shape.frame] @ (local @ np.array(shape.geometry.size))
    origin = positions[shape.frame] + matrices[shape.frame] @ shape.position
    if not np.isfinite(normal + origin).all():
        return np.full((2, 3), np.nan)
    low, high = box = np.array([[-np.inf] * 3, [np.inf] * 3])
    axis = int(np.argmax(np.abs(normal)))
    if np.abs(np.delete(normal, axis)).max() < AXIS_TOLERANCE:
        (high if normal[axis] > 0 else low)[axis] = origin[axis]
    return box
