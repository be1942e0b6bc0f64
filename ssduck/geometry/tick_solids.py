"""The solids of a tick at their poses, one by one, and their comparisons, two at a time.

Every pair of shapes is compared at most once a tick. `ssduck.geometry.distance` defines the signed
distance and the normal, and `ssduck.geometry.mesh_distance` does for meshes that are not convex.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TypeAlias, TypeVar

import numpy as np

from ssduck.geometry.arrays import Array, Flags
from ssduck.geometry.distance import CallCounter, SignedDistance
from ssduck.geometry.distance import signed_distance as convex_distance
from ssduck.geometry.mesh_distance import is_surely_deeper, mesh_distance, mesh_penetration
from ssduck.geometry.placed_solid import PlacedSolid, Point, Quaternion
from ssduck.geometry.poses import flat_rotation_matrices, unit_quaternions
from ssduck.geometry.tick_shapes import (
    PairPredicate,
    ShapeTable,
    TickShapes,
    of_known_entities,
)

# Shapes that are nearer touch, for `on`, m.
TOUCHING_DISTANCE = 1e-3
# The error of bounds by boxes and spheres, m.
ROUNDING = 1e-9

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


class ShapeComparisons:
    """The comparisons of the shapes of a tick.

    Args:
        solids: the shapes.
        calls: counts the calls of FCL.
    """

    def __init__(self, solids: TickSolids, calls: CallCounter) -> None:
        self._tick, self._calls = solids, calls
        self._distances: dict[tuple[int, int], SignedDistance | None] = {}
        self._depths: dict[tuple[int, int], SignedDistance] = {}

    def satisfies(self, s: int, t: int, predicate: PairPredicate) -> bool:
        """Checks whether a predicate holds for two shapes."""
        if predicate.kind == "colliding":
            return self._are_deeper(s, t, predicate.distance)
        return self._are_within(s, t, predicate.bound(self.margin(s, t)))

    def _are_deeper(self, s: int, t: int, min_depth: float) -> bool:
        """Checks whether two shapes are deeper in each other than a depth, m."""
        if self.min_distance(s, t) > 0.0:
            return False
        # Most collisions of meshes are found without computing their depth.
        first, second = self._ordered(s, t)
        is_new = self._is_of_mesh(s, t) and (first, second) not in self._distances
        if is_new and is_surely_deeper(
            self._tick.placed(first), self._tick.placed(second), min_depth, self._calls
        ):
            return True
        return self.signed_distance(s, t).distance < -min_depth

    def _are_within(self, s: int, t: int, max_distance: float) -> bool:
        """Checks whether two shapes are at most a distance apart, m."""
        if self.min_distance(s, t) > max_distance + ROUNDING:
            return False
        result = self.distance(s, t)
        return (0.0 if result is None else max(0.0, result.distance)) <= max_distance

    def margin(self, s: int, t: int) -> float:
        """Returns the collision margin of two shapes, m."""
        return self._tick.table.margins.of_two(s, t)

    def contact_height(self, s: int, t: int) -> float | None:
        """Returns the z of the unit contact normal from a shape to another one.

        None if they do not touch, or have no normal.
        """
        result = self.signed_distance(s, t)
        if result.distance > TOUCHING_DISTANCE + self.margin(s, t) or result.normal is None:
            return None
        return -result.normal[2]

    def distance(self, s: int, t: int) -> SignedDistance | None:
        """Returns the signed distance of two shapes; None for meshes that overlap."""
        first, second = key = self._ordered(s, t)
        if key not in self._distances:
            a, b = self._tick.placed(first), self._tick.placed(second)
            compare = mesh_distance if self._is_of_mesh(s, t) else convex_distance
            self._distances[key] = compare(a, b, self._calls)
        result = self._distances[key]
        return result if result is None or first == s else result.swapped()

    def signed_distance(self, s: int, t: int) -> SignedDistance:
        """Returns the signed distance of two shapes, which for meshes that overlap takes longer."""
        if (result := self.distance(s, t)) is not None:
            return result
        first, second = key = self._ordered(s, t)
        if key not in self._depths:
            self._depths[key] = mesh_penetration(
                self._tick.placed(first), self._tick.placed(second), self._calls
            )
        return self._depths[key] if first == s else self._depths[key].swapped()

    def _ordered(self, s: int, t: int) -> tuple[int, int]:
        """Returns two shapes ordered by their geometries and poses, not by their indices."""
        return (s, t) if (self._tick.rank(s), s) <= (self._tick.rank(t), t) else (t, s)

    def _is_of_mesh(self, s: int, t: int) -> bool:
        """Checks whether one of two shapes is a mesh, and none a half-space."""
        kinds = {self._tick.table.solids[s].type, self._tick.table.solids[t].type}
        return "mesh" in kinds and "plane" not in kinds

    def min_distance(self, s: int, t: int) -> float:
        """Returns a lower bound of the distance of two shapes, by boxes and bounding spheres, m."""
        radii = self._tick.table.bounding_radii[s] + self._tick.table.bounding_radii[t]
        if radii == math.inf:
            is_plane = self._tick.table.bounding_radii[s] == math.inf
            return self._bound_of_plane(s, t) if is_plane else self._bound_of_plane(t, s)
        a, b = self._tick.corners[s], self._tick.corners[t]
        x = max(0.0, a[0] - b[3], b[0] - a[3])
        y = max(0.0, a[1] - b[4], b[1] - a[4])
        z = max(0.0, a[2] - b[5], b[2] - a[5])
        spheres = math.dist(self._tick.centres[s], self._tick.centres[t]) - radii
        return max(math.sqrt(x * x + y * y + z * z), spheres)

    def _bound_of_plane(self, plane: int, other: int) -> float:
        """Returns a lower bound of the distance to a half-space, m, by a bounding sphere."""
        # The box of a tilted plane does not bound it: far out, the plane leaves its box.
        if self._tick.table.solids[other].type == "plane":
            return 0.0
        x, y, z = self._tick.placed(plane).normals[0].tolist()
        (a, b, c), (d, e, f) = self._tick.centres[other], self._tick.placed(plane).position
        height: float = x * (a - d) + y * (b - e) + z * (c - f)
        return max(0.0, height - self._tick.table.solids[other].bounding_radius)
