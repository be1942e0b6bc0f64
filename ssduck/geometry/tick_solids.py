"""The solids of a tick at their poses, one by one and in arrays."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import TypeVar

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.placed_solid import PlacedSolid, Point, Quaternion
from ssduck.geometry.poses import placed_point, rotate, rotation_matrices, unit_quaternions
from ssduck.geometry.solids import Solid

T = TypeVar("T")

# After this number of shapes, what belongs to each is computed for all at once.
MAX_SINGLE = 16


class TickSolids:
    """The solids of the shapes of a tick.

    Args:
        solids: the distinct solids.
        solid_indices: (n,), the index of each shape's solid.
        positions: (n, 3), in the world.
        orientations: (n, 4), quaternions w, x, y, z of any length.
        boxes: (n, 6), lower corner, upper corner, in the world.
        margins: (n,), the collision margins, metres; None for none.

    Attributes:
        solids: the solid of each shape.
        positions, orientations, boxes: see above.
        margins: the collision margin of each shape, metres.
        quaternions: the orientation of each shape, of length 1.
        are_known: whether the pose and the solid of each shape are known.
        corners: the box of each shape: lower corner, upper corner.
        centres: the centre of the sphere around each shape.
        inscribed_centres: the centre of the sphere in each shape.
    """

    def __init__(
        self,
        solids: Sequence[Solid],
        solid_indices: Indices,
        positions: Array,
        orientations: Array,
        boxes: Array,
        margins: Array | None = None,
    ) -> None:
        self._distinct = solids
        self._indices = np.asarray(solid_indices, dtype=np.intp)
        indices = self._indices.tolist()
        self.margins: list[float] = [0.0] * len(indices) if margins is None else margins.tolist()
        self.solids: list[Solid] = [solids[index] for index in indices]
        self.positions, self.orientations, self.boxes = positions, orientations, boxes
        self._placed: dict[int, PlacedSolid] = {}
        self._ranks: dict[int, tuple[str | float, ...]] = {}
        self.quaternions = _OfShapes(self._quaternion, self._unit_orientations_as_tuples)
        self.are_known = _OfShapes(self._is_known, self._all_known)
        self.corners = _OfShapes(lambda shape: boxes[shape].tolist(), boxes.tolist)
        self.centres = self._points_of(lambda solid: solid.centre)
        self.inscribed_centres = self._points_of(lambda solid: solid.inscribed_centre)

    def placed(self, shape: int) -> PlacedSolid:
        """Returns a shape in the world."""
        if shape not in self._placed:
            x, y, z = self.positions[shape].tolist()
            self._placed[shape] = PlacedSolid(
                self.solids[shape], (x, y, z), self.quaternions[shape]
            )
        return self._placed[shape]

    def rank(self, shape: int) -> tuple[str | float, ...]:
        """Returns the place of a shape in the order of shapes, by its geometry and its pose."""
        if shape not in self._ranks:
            pose = *self.positions[shape].tolist(), *self.quaternions[shape]
            self._ranks[shape] = (self.solids[shape].key, *pose)
        return self._ranks[shape]

    def pairs_within(
        self, first: Sequence[int], second: Sequence[int], max_distance: float
    ) -> Iterator[tuple[int, int]]:
        """Yields the pairs whose boxes are at most a distance apart along each axis, m.

        A half-space is a pair with every shape: its box does not bound it.

        Args:
            first: the shapes of one side.
            second: those of the other side.
            max_distance: the distance, m.
        """
        a, b = self.boxes[first][:, None], self.boxes[second]
        with np.errstate(invalid="ignore"):  # no comparison with an unknown box leaves a pair out
            is_apart = (a[..., :3] - b[:, 3:] > max_distance) | (
                b[:, :3] - a[..., 3:] > max_distance
            )
        is_near = ~is_apart.any(axis=2)
        is_near |= self._are_unbounded[first][:, None] | self._are_unbounded[second]
        for row, column in zip(*(side.tolist() for side in is_near.nonzero()), strict=True):
            yield first[row], second[column]

    @cached_property
    def bounding_radii(self) -> list[float]:
        """The radius of the sphere around each solid, m; infinite for half-spaces."""
        distinct = [solid.bounding_radius for solid in self._distinct]
        return [distinct[index] for index in self._indices.tolist()]

    @cached_property
    def _are_unbounded(self) -> Flags:
        """Whether each shape is a half-space."""
        return np.isinf(np.array(self.bounding_radii, dtype=np.float64))

    # -- poses: of few shapes one by one, or of all at once -----------------------------------

    @cached_property
    def _unit_orientations(self) -> Array:
        return unit_quaternions(self.orientations)

    def _unit_orientations_as_tuples(self) -> list[Quaternion]:
        return [(w, x, y, z) for w, x, y, z in self._unit_orientations.tolist()]

    def _quaternion(self, shape: int) -> Quaternion:
        w, x, y, z = self.orientations[shape].tolist()
        length = math.sqrt(w * w + x * x + y * y + z * z) or math.nan
        return w / length, x / length, y / length, z / length

    @cached_property
    def are_finite(self) -> Flags:
        """Whether the pose of each shape is finite."""
        poses = np.concatenate((self.positions, self._unit_orientations), axis=1)
        return np.asarray(np.isfinite(poses).all(axis=1))

    def _all_known(self) -> list[bool]:
        known = np.array([solid.is_known for solid in self._distinct], dtype=bool)
        are_known: list[bool] = (self.are_finite & known[self._indices]).tolist()
        return are_known

    def _is_known(self, shape: int) -> bool:
        pose = *self.positions[shape].tolist(), *self.quaternions[shape]
        return self.solids[shape].is_known and all(map(math.isfinite, pose))

    def _points_of(self, point_of: Callable[[Solid], Point]) -> _OfShapes[list[float]]:
        """Returns a point of each shape, which is a point of its solid, in the world."""

        def of_one(shape: int) -> list[float]:
            position = self.positions[shape].tolist()
            return placed_point(position, self.quaternions[shape], point_of(self.solids[shape]))

        def of_all() -> list[list[float]]:
            points = list(map(point_of, self._distinct))
            local = np.array(points, dtype=np.float64).reshape(-1, 3)[self._indices]
            with np.errstate(invalid="ignore"):
                moved: list[list[float]] = (self.positions + rotate(self.matrices, local)).tolist()
            return moved

        return _OfShapes(of_one, of_all)

    @cached_property
    def matrices(self) -> Array:
        """The rotation matrices, (n, 3, 3)."""
        with np.errstate(invalid="ignore"):
            return rotation_matrices(self._unit_orientations)


class _OfShapes(dict[int, T]):
    """What belongs to each shape: of few shapes one by one, of more for all at once.

    Both give the same, to the last bit.

    Args:
        of_one: a function that returns what belongs to a shape.
        of_all: a function that returns what belongs to each shape.
    """

    def __init__(self, of_one: Callable[[int], T], of_all: Callable[[], Sequence[T]]) -> None:
        self._of_one, self._of_all = of_one, of_all

    def __missing__(self, shape: int) -> T:
        """Returns what belongs to a shape that nobody asked for yet."""
        if len(self) < MAX_SINGLE:
            self[shape] = found = self._of_one(shape)
            return found
        self.update(enumerate(self._of_all()))
        return self[shape]
