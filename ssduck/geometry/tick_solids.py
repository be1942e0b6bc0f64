"""The solids of a tick at their poses, one by one."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TypeAlias, TypeVar

import numpy as np

from ssduck.geometry.arrays import Array, Flags
from ssduck.geometry.placed_solid import PlacedSolid, Point, Quaternion
from ssduck.geometry.poses import flat_rotation_matrices, unit_quaternions
from ssduck.geometry.tick_shapes import ShapeTable, TickShapes, of_known_entities

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


@dataclass(frozen=True, eq=False)
class ShapePlaces:
    """Where n shapes are in the world.

    Attributes:
        positions: (n, 3).
        orientations: (n, 4), quaternions w, x, y, z of any length.
        boxes: (n, 6), lower corner, upper corner.
    """

    positions: Array
    orientations: Array
    boxes: Array


class TickSolids:
    """The solids of the shapes of a tick.

    Args:
        table: the properties of the shapes.
        places: where the shapes are.

    Attributes:
        table, places: see above.
        are_known: whether the pose and the solid of each shape are known.
        corners: the box of each shape: lower corner, upper corner.
        centres: the centre of the sphere around each shape.
    """

    def __init__(self, table: ShapeTable, places: ShapePlaces) -> None:
        self.table, self.places = table, places
        poses = Found(partial(_pose, places))
        self.are_known = Found(partial(_is_known, table, poses))
        self.corners: Found[list[float]] = Found(lambda shape: places.boxes[shape].tolist())
        self._placed = Found(partial(_placed, table, poses))
        self.centres = Found(partial(_centre, self._placed))
        self._ranks = Found(partial(_rank, table, poses))

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
        a, b = self.places.boxes[first][:, None], self.places.boxes[second]
        with np.errstate(invalid="ignore"):  # no comparison with an unknown box leaves a pair out
            is_apart = (a[..., :3] - b[:, 3:] > max_distance) | (
                b[:, :3] - a[..., 3:] > max_distance
            )
        is_near = ~is_apart.any(axis=2)
        is_near |= self.table.is_plane[first][:, None] | self.table.is_plane[second]
        for row, column in zip(*(side.tolist() for side in is_near.nonzero()), strict=True):
            yield first[row], second[column]

    @cached_property
    def _unit_orientations(self) -> Array:
        return unit_quaternions(self.places.orientations)

    @cached_property
    def are_finite(self) -> Flags:
        """Whether the pose of each shape is finite."""
        positions, orientations = self.places.positions, self._unit_orientations
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
    def arrays(self) -> TickShapes:
        """The shapes in arrays."""
        known = of_known_entities(self.table, self.are_finite & self.table.is_known)
        places = self.places
        return TickShapes(self.table, known, places.boxes.T, places.positions, self.rotations)


_Pose: TypeAlias = tuple[Point, Quaternion]


def _pose(places: ShapePlaces, shape: int) -> _Pose:
    """Returns the position of a shape, and its orientation with length 1."""
    x, y, z = places.positions[shape].tolist()
    w, i, j, k = places.orientations[shape].tolist()
    length = math.sqrt(w * w + i * i + j * j + k * k) or math.nan
    return (x, y, z), (w / length, i / length, j / length, k / length)


def _is_known(table: ShapeTable, poses: Found[_Pose], shape: int) -> bool:
    position, orientation = poses[shape]
    return table.solids[shape].is_known and all(map(math.isfinite, position + orientation))


def _placed(table: ShapeTable, poses: Found[_Pose], shape: int) -> PlacedSolid:
    return PlacedSolid(table.solids[shape], *poses[shape])


def _centre(placed: Found[PlacedSolid], shape: int) -> Point:
    return placed[shape].to_world(*placed[shape].solid.centre)


def _rank(table: ShapeTable, poses: Found[_Pose], shape: int) -> tuple[str | float, ...]:
    position, orientation = poses[shape]
    return (table.solids[shape].key, *position, *orientation)
