"""The solids of a tick at their poses, one by one and in arrays."""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import TypeVar

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.margins import Margins
from ssduck.geometry.placed_solid import PlacedSolid, Point, Quaternion
from ssduck.geometry.poses import (
    flat_rotation_matrices,
    placed_point,
    rotate,
    stacked_matrices,
    unit_quaternions,
)
from ssduck.geometry.solids import Solid

T = TypeVar("T")

# After this number of shapes, or one in so many, what belongs to each is computed for all at once:
# those of some pairs among the thousands of a batch of ticks are computed alone.
MAX_SINGLE = 16
SINGLE_IN = 8


class ShapePlaces:
    """Where n shapes are in the world.

    Args:
        positions: (n, 3).
        orientations: (n, 4), quaternions w, x, y, z of any length.
        boxes: (n, 6), lower corner, upper corner.

    Attributes:
        positions, orientations, boxes: see above.
    """

    def __init__(self, positions: Array, orientations: Array, boxes: Array) -> None:
        self.positions, self.orientations, self.boxes = positions, orientations, boxes

    def pose(self, shape: int) -> tuple[list[float], list[float]]:
        """Returns the position and the orientation of a shape."""
        return self.positions[shape].tolist(), self.orientations[shape].tolist()

    def box(self, shape: int) -> list[float]:
        """Returns the box of a shape: lower corner, upper corner."""
        box: list[float] = self.boxes[shape].tolist()
        return box


class ShapeSolids:
    """The solids and the margins of n shapes, which are the same at many ticks.

    Args:
        distinct: the distinct solids.
        indices: (n,), the index of each shape's solid.
        margins: (n,), the collision margins, metres; None for none.

    Attributes:
        distinct, indices, margins: see above.
    """

    def __init__(
        self, distinct: Sequence[Solid], indices: Indices, margins: Margins | Array | None = None
    ) -> None:
        self.distinct, self.indices = distinct, np.asarray(indices, dtype=np.intp)
        self.margins = Margins.of(margins, len(self.indices))

    @cached_property
    def solids(self) -> list[Solid]:
        """The solid of each shape."""
        return [self.distinct[index] for index in self.indices.tolist()]

    @cached_property
    def bounding_radii(self) -> list[float]:
        """The radius of the sphere around each solid, m; infinite for half-spaces."""
        distinct = [solid.bounding_radius for solid in self.distinct]
        return [distinct[index] for index in self.indices.tolist()]

    @cached_property
    def are_unbounded(self) -> Flags:
        """Whether each shape is a half-space."""
        return np.isinf(np.array(self.bounding_radii, dtype=np.float64))


class TickSolids:
    """The solids of the shapes of a tick.

    Args:
        shapes: the shapes.
        places: where the shapes are.

    Attributes:
        places: see above.
    """

    def __init__(self, shapes: ShapeSolids, places: ShapePlaces) -> None:
        self._shapes, self.places = shapes, places
        self._placed: dict[int, PlacedSolid] = {}
        self._ranks: dict[int, tuple[str | float, ...]] = {}

    # All pairs of a tick at once need none of these.

    @cached_property
    def are_known(self) -> _OfShapes[bool]:
        """Whether the pose and the solid of each shape are known."""
        return self._of_shapes(TickSolids._is_known, TickSolids._all_known)

    @cached_property
    def corners(self) -> _OfShapes[list[float]]:
        """The box of each shape: lower corner, upper corner."""
        return self._of_shapes(TickSolids._corners_of, TickSolids._all_corners)

    @cached_property
    def centres(self) -> _OfShapes[list[float]]:
        """The centre of the sphere around each shape."""
        return self._of_shapes(TickSolids._centre, TickSolids._all_centres)

    @cached_property
    def inscribed_centres(self) -> _OfShapes[list[float]]:
        """The centre of the sphere in each shape."""
        return self._of_shapes(TickSolids._inscribed_centre, TickSolids._all_inscribed_centres)

    @cached_property
    def _poses(self) -> _OfShapes[tuple[Point, Quaternion]]:
        return self._of_shapes(TickSolids._pose, TickSolids._all_poses)

    def _of_shapes(
        self, of_one: Callable[[TickSolids, int], T], of_all: Callable[[TickSolids], Sequence[T]]
    ) -> _OfShapes[T]:
        most = max(MAX_SINGLE, len(self._shapes.indices) // SINGLE_IN)
        return _OfShapes(weakref.ref(self), most, of_one, of_all)

    def placed(self, shape: int) -> PlacedSolid:
        """Returns a shape in the world."""
        if shape not in self._placed:
            self._placed[shape] = PlacedSolid(self.solids[shape], *self._poses[shape])
        return self._placed[shape]

    def rank(self, shape: int) -> tuple[str | float, ...]:
        """Returns the place of a shape in the order of shapes, by its geometry and its pose."""
        if shape not in self._ranks:
            position, orientation = self._poses[shape]
            self._ranks[shape] = (self.solids[shape].key, *position, *orientation)
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
        is_near |= self._shapes.are_unbounded[first][:, None] | self._shapes.are_unbounded[second]
        for row, column in zip(*(side.tolist() for side in is_near.nonzero()), strict=True):
            yield first[row], second[column]

    @property
    def solids(self) -> list[Solid]:
        """The solid of each shape."""
        return self._shapes.solids

    @property
    def margins(self) -> Margins:
        """The collision margins of the shapes."""
        return self._shapes.margins

    @property
    def bounding_radii(self) -> list[float]:
        """The radius of the sphere around each solid, m; infinite for half-spaces."""
        return self._shapes.bounding_radii

    @property
    def positions(self) -> Array:
        """The positions, (n, 3)."""
        return self.places.positions

    @property
    def orientations(self) -> Array:
        """The orientations, (n, 4), of any length."""
        return self.places.orientations

    @property
    def boxes(self) -> Array:
        """The boxes, (n, 6): lower corner, upper corner."""
        return self.places.boxes

    # -- poses: of few shapes one by one, or of all at once -----------------------------------

    @cached_property
    def _unit_orientations(self) -> Array:
        return unit_quaternions(self.orientations)

    def _all_poses(self) -> list[tuple[Point, Quaternion]]:
        poses = zip(self.positions.tolist(), self._unit_orientations.tolist(), strict=True)
        return [((x, y, z), (w, i, j, k)) for (x, y, z), (w, i, j, k) in poses]

    def _pose(self, shape: int) -> tuple[Point, Quaternion]:
        (x, y, z), (w, i, j, k) = self.places.pose(shape)
        length = math.sqrt(w * w + i * i + j * j + k * k) or math.nan
        return (x, y, z), (w / length, i / length, j / length, k / length)

    @cached_property
    def are_finite(self) -> Flags:
        """Whether the pose of each shape is finite."""
        positions, orientations = self.positions, self._unit_orientations
        with np.errstate(over="ignore", invalid="ignore"):
            total = np.add.reduce(positions, axis=None) + np.add.reduce(orientations, axis=None)
        if math.isfinite(total):  # then all of them are
            return np.ones(len(positions), dtype=bool)
        poses = np.concatenate((positions, orientations), axis=1)
        return np.asarray(np.isfinite(poses).all(axis=1))

    def _all_known(self) -> list[bool]:
        known = np.array([solid.is_known for solid in self._shapes.distinct], dtype=bool)
        are_known: list[bool] = (self.are_finite & known[self._shapes.indices]).tolist()
        return are_known

    def _is_known(self, shape: int) -> bool:
        position, orientation = self._poses[shape]
        return self.solids[shape].is_known and all(map(math.isfinite, position + orientation))

    def _corners_of(self, shape: int) -> list[float]:
        return self.places.box(shape)

    def _all_corners(self) -> list[list[float]]:
        corners: list[list[float]] = self.boxes.tolist()
        return corners

    def _centre(self, shape: int) -> list[float]:
        return placed_point(*self._poses[shape], self.solids[shape].centre)

    def _all_centres(self) -> list[list[float]]:
        return self._all_placed([solid.centre for solid in self._shapes.distinct])

    def _inscribed_centre(self, shape: int) -> list[float]:
        return placed_point(*self._poses[shape], self.solids[shape].inscribed_centre)

    def _all_inscribed_centres(self) -> list[list[float]]:
        return self._all_placed([solid.inscribed_centre for solid in self._shapes.distinct])

    def _all_placed(self, points: Sequence[Point]) -> list[list[float]]:
        """Returns the point of each shape, given the point of each distinct solid."""
        local = np.array(points, dtype=np.float64).reshape(-1, 3)[self._shapes.indices]
        with np.errstate(invalid="ignore"):
            moved: list[list[float]] = (self.positions + rotate(self.matrices, local)).tolist()
        return moved

    @cached_property
    def rotations(self) -> Array:
        """The rotation matrices, (9, n), row by row."""
        with np.errstate(invalid="ignore"):
            return flat_rotation_matrices(self._unit_orientations)

    @cached_property
    def matrices(self) -> Array:
        """The rotation matrices, (n, 3, 3)."""
        return stacked_matrices(self.rotations)


class _OfShapes(dict[int, T]):
    """What belongs to each shape: of few shapes one by one, of more for all at once.

    Both give the same, to the last bit.

    Args:
        tick: the solids of the tick, which own this. In a cycle of references, they would stay in
            memory until Python collects garbage.
        most_single: the largest number of shapes that are asked one by one.
        of_one: a function that returns what belongs to a shape.
        of_all: a function that returns what belongs to each shape.
    """

    def __init__(
        self,
        tick: weakref.ref[TickSolids],
        most_single: int,
        of_one: Callable[[TickSolids, int], T],
        of_all: Callable[[TickSolids], Sequence[T]],
    ) -> None:
        self._tick, self._most_single = tick, most_single
        self._of_one, self._of_all = of_one, of_all

    def __missing__(self, shape: int) -> T:
        """Returns what belongs to a shape that nobody asked for yet."""
        tick = self._tick()
        assert tick is not None  # what owns this is being asked
        if len(self) < self._most_single:
            self[shape] = found = self._of_one(tick, shape)
            return found
        self.update(enumerate(self._of_all(tick)))
        return self[shape]
