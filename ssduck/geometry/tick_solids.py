"""The solids of a tick at their poses, one by one and in arrays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.placed_solid import PlacedSolid, Point
from ssduck.geometry.poses import rotate, rotation_matrices, unit_quaternions
from ssduck.geometry.solids import Solid


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
        positions, orientations, boxes: see above.
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
        self._distinct, self._margins = solids, margins
        self._indices = np.asarray(solid_indices, dtype=np.intp)
        self.positions, self.orientations, self.boxes = positions, orientations, boxes
        self._placed: dict[int, PlacedSolid] = {}
        self._ranks: dict[int, tuple[str | float, ...]] = {}

    def placed(self, shape: int) -> PlacedSolid:
        """Returns a shape in the world."""
        if shape not in self._placed:
            x, y, z = self.positions[shape].tolist()
            quaternion = self._unit_orientations[shape].tolist()
            orientation = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
            self._placed[shape] = PlacedSolid(self.solids[shape], (x, y, z), orientation)
        return self._placed[shape]

    def rank(self, shape: int) -> tuple[str | float, ...]:
        """Returns the place of a shape in the order of shapes, by its geometry and its pose."""
        if shape not in self._ranks:
            pose = *self.positions[shape].tolist(), *self._unit_orientations[shape].tolist()
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

    # Computed for all shapes at once, when first needed.

    @cached_property
    def solids(self) -> list[Solid]:
        """The solid of each shape."""
        return [self._distinct[index] for index in self._indices.tolist()]

    @cached_property
    def margins(self) -> list[float]:
        """The collision margin of each shape, metres."""
        count = len(self._indices)
        margins: list[float] = [0.0] * count if self._margins is None else self._margins.tolist()
        return margins

    @cached_property
    def bounding_radii(self) -> list[float]:
        """The radius of the sphere around each solid, m; infinite for half-spaces."""
        distinct = [solid.bounding_radius for solid in self._distinct]
        return [distinct[index] for index in self._indices.tolist()]

    @cached_property
    def _are_unbounded(self) -> Flags:
        """Whether each shape is a half-space."""
        return np.isinf(np.array(self.bounding_radii, dtype=np.float64))

    @cached_property
    def _unit_orientations(self) -> Array:
        return unit_quaternions(self.orientations)

    @cached_property
    def are_finite(self) -> Flags:
        """Whether the pose of each shape is finite."""
        poses = np.concatenate((self.positions, self._unit_orientations), axis=1)
        return np.asarray(np.isfinite(poses).all(axis=1))

    @cached_property
    def are_known(self) -> list[bool]:
        """Whether the pose and the solid of each shape are known."""
        known = np.array([solid.is_known for solid in self._distinct], dtype=bool)
        are_known: list[bool] = (self.are_finite & known[self._indices]).tolist()
        return are_known

    @cached_property
    def corners(self) -> list[list[float]]:
        """The box of each shape: lower corner, upper corner."""
        corners: list[list[float]] = self.boxes.tolist()
        return corners

    @cached_property
    def centres(self) -> list[list[float]]:
        """The centre of the sphere around each shape."""
        return self._to_world([solid.centre for solid in self._distinct])

    @cached_property
    def inscribed_centres(self) -> list[list[float]]:
        """The centre of the sphere in each shape."""
        return self._to_world([solid.inscribed_centre for solid in self._distinct])

    def _to_world(self, points: list[Point]) -> list[list[float]]:
        """Returns a point of each shape in the world; `points` are those of the solids."""
        local = np.array(points, dtype=np.float64).reshape(-1, 3)[self._indices]
        with np.errstate(invalid="ignore"):
            moved: list[list[float]] = (self.positions + rotate(self.matrices, local)).tolist()
        return moved

    @cached_property
    def matrices(self) -> Array:
        """The rotation matrices, (n, 3, 3)."""
        with np.errstate(invalid="ignore"):
            return rotation_matrices(self._unit_orientations)
