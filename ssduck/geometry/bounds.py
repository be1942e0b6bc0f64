"""Exact axis-aligned boxes of shapes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ssduck.geometry.arrays import Array
from ssduck.geometry.poses import rotation_matrices
from ssduck.geometry.shapes import PlacedGeometry

# A plane whose normal is off an axis by less is across it: 1 km out that is 1e-6 m.
LEVEL = 1e-9
# Points are turned and compared in bunches of this size; a box has eight corners.
TOGETHER = 8
# Below this many points a hull costs more to find than it saves in each box.
WORTH_A_HULL = 9


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


class BoundingBoxes:
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
