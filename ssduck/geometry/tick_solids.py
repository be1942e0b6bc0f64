"""The solids of a tick at their poses, one by one."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, partial
from typing import TypeAlias, TypeVar

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.margins import Margins
from ssduck.geometry.placed_solid import PlacedSolid, Point, Quaternion
from ssduck.geometry.poses import (
    flat_rotation_matrices,
    placed_point,
    stacked_matrices,
    unit_quaternions,
)
from ssduck.geometry.solids import Solid

T = TypeVar("T")


class Found(dict[int, T]):
    """What belongs to each shape, or to each entity, found when it is asked for.

    Args:
        find: a function that returns what belongs to one. It does not refer to what owns this: in a
            cycle of references, that would stay in memory until Python collects garbage.
    """

    def __init__(self, find: Callable[[int], T]) -> None:
        self._find = find

    def __missing__(self, number: int) -> T:
        """Returns what nobody asked for yet."""
        self[number] = found = self._find(number)
        return found


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
        are_known: whether the pose and the solid of each shape are known.
        corners: the box of each shape: lower corner, upper corner.
        centres: the centre of the sphere around each shape.
        inscribed_centres: the centre of the sphere in each shape.
    """

    def __init__(self, shapes: ShapeSolids, places: ShapePlaces) -> None:
        self._shapes, self.places = shapes, places
        poses = Found(partial(_pose, places))
        self.are_known = Found(partial(_is_known, shapes, poses))
        self.corners = Found(places.box)
        self.centres = Found(partial(_centre, shapes, poses))
        self.inscribed_centres = Found(partial(_inscribed_centre, shapes, poses))
        self._placed = Found(partial(_placed, shapes, poses))
        self._ranks = Found(partial(_rank, shapes, poses))

    def placed(self, shape: int) -> PlacedSolid:
        """Returns a shape in the world."""
        return self._placed[shape]

    def rank(self, shape: int) -> tuple[str | float, ...]:
        """Returns the place of a shape in the order of shapes, by its geometry and its pose."""
        return self._ranks[shape]

    def pairs_within(
        self, first: Sequence[int], second: Sequence[int], max_distance: float
    ) -> Iterator[tuple[int, int]]:
        """Yields the pairs whose boxes are at most a distance apart along each axis, m.

        A half-space is a pair with every shape: its box does not bound it.
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

    @cached_property
    def _unit_orientations(self) -> Array:
        return unit_quaternions(self.orientations)

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

    @cached_property
    def rotations(self) -> Array:
        """The rotation matrices, (9, n), row by row."""
        with np.errstate(invalid="ignore"):
            return flat_rotation_matrices(self._unit_orientations)

    @cached_property
    def matrices(self) -> Array:
        """The rotation matrices, (n, 3, 3)."""
        return stacked_matrices(self.rotations)


_Pose: TypeAlias = tuple[Point, Quaternion]


def _pose(places: ShapePlaces, shape: int) -> _Pose:
    """Returns the position of a shape, and its orientation with length 1."""
    (x, y, z), (w, i, j, k) = places.pose(shape)
    length = math.sqrt(w * w + i * i + j * j + k * k) or math.nan
    return (x, y, z), (w / length, i / length, j / length, k / length)


def _is_known(shapes: ShapeSolids, poses: Found[_Pose], shape: int) -> bool:
    position, orientation = poses[shape]
    return shapes.solids[shape].is_known and all(map(math.isfinite, position + orientation))


def _centre(shapes: ShapeSolids, poses: Found[_Pose], shape: int) -> list[float]:
    return placed_point(*poses[shape], shapes.solids[shape].centre)


def _inscribed_centre(shapes: ShapeSolids, poses: Found[_Pose], shape: int) -> list[float]:
    return placed_point(*poses[shape], shapes.solids[shape].inscribed_centre)


def _placed(shapes: ShapeSolids, poses: Found[_Pose], shape: int) -> PlacedSolid:
    return PlacedSolid(shapes.solids[shape], *poses[shape])


def _rank(shapes: ShapeSolids, poses: Found[_Pose], shape: int) -> tuple[str | float, ...]:
    position, orientation = poses[shape]
    return (shapes.solids[shape].key, *position, *orientation)
