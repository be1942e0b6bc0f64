"""Where the bodies of a world go in its tables.

A `Part` is a set of bodies that are read together: those that can move, or those that cannot.
What does not depend on their poses is worked out once; each tick then costs a few operations
on whole arrays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ssduck.geometry import (
    Array,
    Boxer,
    Indices,
    PlacedGeometry,
    compose,
    multiply,
    rotate,
    rotation_matrices,
)
from ssduck.scenes import SensorSpec
from ssduck.simulators import Body, Frames, Kind


@dataclass(frozen=True, eq=False)
class Member:
    """An entity as the tables know it: a body, or a sensor on one.

    Attributes:
        mount: of a sensor, the id of its body and the number of the link.
    """

    id: int
    name: str
    kind: Kind
    parent: str | None = None
    body: Body | None = None
    sensor: SensorSpec | None = None
    mount: tuple[int, int] = (0, 0)

    @property
    def mass(self) -> float:
        """Kilograms; 0 for a sensor and for what cannot move."""
        return sum(link.mass for link in self.body.links) if self.body else 0.0


class Part:
    """Bodies that are read together, the sensors on them, and their rows in the tables.

    Args:
        members: the bodies, in order.
        sensors: the sensors that sit on them.
        rows: the row of each entity's id in the table of entities.
        first_link: the row of each entity's id in the table of links, that of its base.
        first_shape: the row of each entity's id in the table of shapes, that of its first.
    """

    def __init__(
        self,
        members: Sequence[Member],
        sensors: Sequence[Member],
        rows: Mapping[int, int],
        first_link: Mapping[int, int],
        first_shape: Mapping[int, int],
    ) -> None:
        self.bodies = [member.body for member in members if member.body is not None]
        counts = [len(body.links) for body in self.bodies]
        starts = np.concatenate(([0], np.cumsum(counts))).astype(np.intp)
        self._bases = starts[:-1]
        self._every_frame_is_a_base = int(starts[-1]) == len(self.bodies)
        self._rows = np.array([rows[member.id] for member in members], dtype=np.intp)
        self._link_rows = _runs([first_link[member.id] for member in members], counts)
        shape_counts = [len(body.shapes) for body in self.bodies]
        self._shape_rows = _runs([first_shape[member.id] for member in members], shape_counts)
        self._shapes = [
            PlacedGeometry(start + shape.frame, shape.geometry, shape.position, shape.orientation)
            for start, body in zip(starts.tolist(), self.bodies, strict=False)
            for shape in body.shapes
        ]
        self._owners = np.repeat(np.arange(len(self.bodies)), shape_counts).tolist()
        self._bare = np.array([index for index, n in enumerate(shape_counts) if n == 0], np.intp)
        start_of = dict(zip((member.id for member in members), starts.tolist(), strict=False))
        self._set_sensors(sensors, rows, start_of)

    def _set_sensors(
        self, sensors: Sequence[Member], rows: Mapping[int, int], start_of: Mapping[int, int]
    ) -> None:
        specs = [member.sensor for member in sensors if member.sensor is not None]
        self._sensor_rows = np.array([rows[member.id] for member in sensors], dtype=np.intp)
        self._sensor_frames = np.array(
            [start_of[member.mount[0]] + member.mount[1] for member in sensors], dtype=np.intp
        )
        self._sensor_positions = np.array([s.position for s in specs]).reshape(-1, 3)
        self._sensor_orientations = np.array([s.orientation for s in specs]).reshape(-1, 4)

    # Rows x to zmax of the tables of entities and links: pose, velocities, box.

    def write_entities(self, frames: Frames, block: Array) -> None:
        """Write the rows of these bodies and of their sensors; `block` is (19, entities)."""
        matrices = rotation_matrices(frames.orientations)
        low, high = self._entity_boxer.boxes(frames.positions, matrices)
        bases = frames if self._every_frame_is_a_base else _picked(frames, self._bases)
        if len(self._bare):  # a body without shapes is a point
            low[self._bare] = high[self._bare] = bases.positions[self._bare]
        block[:, self._rows] = np.concatenate((*_columns(bases), low, high), axis=1).T
        if len(self._sensor_rows):
            block[:, self._sensor_rows] = self._sensors(frames, matrices).T

    def _sensors(self, frames: Frames, matrices: Array) -> Array:
        """A sensor is a point on its link and moves with it."""
        on = _picked(frames, self._sensor_frames)
        arms = rotate(matrices[self._sensor_frames], self._sensor_positions)
        points = on.positions + arms
        turned = multiply(on.orientations, self._sensor_orientations)
        linear = on.linear + np.cross(on.angular, arms)
        return np.concatenate((points, turned, linear, on.angular, points, points), axis=1)

    def write_links(self, frames: Frames, block: Array) -> None:
        """Write the rows of these bodies' links; `block` is (19, links)."""
        matrices = rotation_matrices(frames.orientations)
        low, high = self._link_boxer.boxes(frames.positions, matrices)
        bare = np.ones(len(low), dtype=bool)
        bare[[shape.frame for shape in self._shapes]] = False
        low[bare] = high[bare] = frames.positions[bare]
        block[:, self._link_rows] = np.concatenate((*_columns(frames), low, high), axis=1).T

    def write_shapes(self, frames: Frames, block: Array) -> None:
        """Write the rows of these bodies' shapes; `block` is (13, shapes): pose, box."""
        on = np.array([shape.frame for shape in self._shapes], dtype=np.intp)
        positions, orientations = compose(
            frames.positions[on],
            frames.orientations[on],
            np.array([shape.position for shape in self._shapes]).reshape(-1, 3),
            np.array([shape.orientation for shape in self._shapes]).reshape(-1, 4),
        )
        matrices = rotation_matrices(frames.orientations)
        low, high = self._shape_boxer.boxes(frames.positions, matrices)
        block[:, self._shape_rows] = np.concatenate((positions, orientations, low, high), axis=1).T

    @cached_property
    def _entity_boxer(self) -> Boxer:
        return Boxer(self._shapes, self._owners, len(self.bodies))

    @cached_property
    def _link_boxer(self) -> Boxer:
        return Boxer(self._shapes, [s.frame for s in self._shapes], len(self._link_rows))

    @cached_property
    def _shape_boxer(self) -> Boxer:
        return Boxer(self._shapes, range(len(self._shapes)), len(self._shapes))


def _runs(starts: Sequence[int], counts: Sequence[int]) -> Indices:
    """start, start + 1, … (count of them), for each start."""
    runs = [np.arange(start, start + n) for start, n in zip(starts, counts, strict=True)]
    return np.concatenate(runs).astype(np.intp) if runs else np.zeros(0, np.intp)


def _columns(frames: Frames) -> tuple[Array, Array, Array, Array]:
    return frames.positions, frames.orientations, frames.linear, frames.angular


def _picked(frames: Frames, indices: Indices) -> Frames:
    return Frames(*(column[indices] for column in _columns(frames)))
