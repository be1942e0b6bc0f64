"""Where the entities of a world go in its tables.

A `BodyGroup` is a set of bodies that are read together: those that can move, or those that cannot.
What does not depend on their poses is worked out once; each tick then costs a few operations
on whole arrays.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate

import numpy as np

from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.bounds import BoundingBoxes
from ssduck.geometry.poses import IDENTITY, compose, multiply, rotation_matrices
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.simulators.interface import Body, Kind, LinkPoses
from ssduck.simulators.scenes import SensorSpec


@dataclass(frozen=True, eq=False)
class EntityInfo:
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
        return sum(self.masses)

    @property
    def masses(self) -> list[float]:
        """Those of the links, kg."""
        return [link.mass for link in self.body.links] if self.body else []

    def with_masses(self, masses: Sequence[float]) -> EntityInfo:
        """The same entity with other masses of its links, kg."""
        if self.body is None or list(masses) == self.masses:
            return self
        links = (
            replace(link, mass=mass) for link, mass in zip(self.body.links, masses, strict=True)
        )
        return replace(self, body=replace(self.body, links=tuple(links)))


def margins_of(members: Iterable[EntityInfo]) -> float:
    """How far apart two shapes of some entities may be that touch by their margins, metres."""
    bodies = (member.body for member in members if member.body is not None)
    return 2.0 * max((shape.margin for body in bodies for shape in body.shapes), default=0.0)


class TableLayout:
    """The rows of some entities in their world's tables.

    Args:
        members: the entities, in load order.
        is_external: whether bodies that cannot move by themselves may be moved by others.

    Attributes:
        members: the entities by row: sensors first, then bodies.
        rows: the row of each entity's id.
        bodies: the bodies, each with the id of its entity, in order.
        still: the bodies that are known never to move.
        moving: the others.
    """

    def __init__(self, members: Iterable[EntityInfo], is_external: bool) -> None:
        self.entities = sorted(members, key=lambda member: member.kind != "sensor")
        self.rows = {member.id: row for row, member in enumerate(self.entities)}
        self.bodies = [(m.id, m.body) for m in self.entities if m.body is not None]
        # In the tables of links and of shapes, where each body's begin.
        links = [len(body.links) for _, body in self.bodies]
        shapes = [len(body.shapes) for _, body in self.bodies]
        places = zip(accumulate(links, initial=0), accumulate(shapes, initial=0), strict=True)
        first = dict(zip((id for id, _ in self.bodies), places, strict=False))
        still = {id for id, body in self.bodies if not (is_external or body.movable)}
        self.static_bodies, self.moving_bodies = (
            BodyGroup(
                [m for m in self.entities if m.body and (m.id in still) is stands], self, first
            )
            for stands in (True, False)
        )


class BodyGroup:
    """Bodies that are read together, the sensors on them, and their rows in the tables.

    Args:
        members: the bodies, in order.
        layout: all entities, the sensors among them, and their rows.
        first: of each body's id, the rows of its first link and of its first shape.

    Attributes:
        bodies: the bodies.
        runs: of each body, where its links are among the frames.
        sensors: the sensors on them.
        sensors_on_links: whether a sensor moves with a link that is no base.
    """

    def __init__(
        self,
        members: Sequence[EntityInfo],
        layout: TableLayout,
        first: Mapping[int, tuple[int, int]],
    ) -> None:
        self.bodies = tuple(member.body for member in members if member.body is not None)
        counts = [len(body.links) for body in self.bodies]
        starts = np.concatenate(([0], np.cumsum(counts))).astype(np.intp)
        self._bases = starts[:-1]
        runs = map(slice, starts[:-1].tolist(), starts[1:].tolist())
        self.runs = dict(zip(self.bodies, runs, strict=True))
        self._link_rows = _runs([first[member.id][0] for member in members], counts)
        shape_counts = [len(body.shapes) for body in self.bodies]
        self._shape_rows = _runs([first[member.id][1] for member in members], shape_counts)
        self._shapes = [
            replace(shape, frame=start + shape.frame)
            for start, body in zip(starts.tolist(), self.bodies, strict=False)
            for shape in body.shapes
        ]
        self._owners = np.repeat(np.arange(len(self.bodies)), shape_counts).tolist()
        start_of = dict(zip((member.id for member in members), starts.tolist(), strict=False))
        sensors = [member for member in layout.entities if member.mount[0] in start_of]
        self.sensors = tuple(sensors)
        self._mounts = [
            PlacedGeometry(
                start_of[member.mount[0]] + member.mount[1],
                _POINT,
                np.array(member.sensor.position),
                np.array(member.sensor.orientation),
            )
            for member in sensors
            if member.sensor is not None
        ]
        # A product with a constant quaternion is one with a matrix: the products of 1, i, j, k.
        self._turns = np.array(
            [multiply(np.eye(4), np.tile(m.orientation, (4, 1))) for m in self._mounts]
        )
        # The rows of the table of entities, and the frames that they tell of.
        rows = [layout.rows[member.id] for member in (*members, *sensors)]
        self._rows = np.array(rows, dtype=np.intp)
        mounts = np.array([mount.frame for mount in self._mounts], dtype=np.intp)
        self.sensors_on_links = bool(np.setdiff1d(mounts, self._bases).size)
        self._told = np.concatenate((self._bases, mounts))

    # Rows x to zmax of the tables of entities and links: pose, velocities, box.

    def write_entities(self, frames: LinkPoses, block: Array) -> None:
        """Write the rows of these bodies and of their sensors; `block` is (19, entities)."""
        boxes = self._entity_boxer.boxes(frames.positions, frames.matrices)
        positions = frames.positions.take(self._told, axis=0)
        first = len(self.bodies)
        if self._mounts:
            # A sensor is a point on its link and moves with it; its box tells where it is.
            positions[first:] = boxes[:3, first:].T
        states = frames.states_at(positions, self._told)
        if self._mounts:
            states[first:, 3:7] = np.einsum("ni,nij->nj", states[first:, 3:7], self._turns)
        block[:, self._rows] = np.concatenate((states.T, boxes))

    def sensor_poses(self, frames: LinkPoses) -> tuple[Array, Array]:
        """Where the sensors on these bodies are: (n, 3) and matrices (n, 3, 3)."""
        on = np.array([mount.frame for mount in self._mounts], dtype=np.intp)
        positions, orientations = compose(
            frames.positions[on],
            frames.states[on, 3:7],
            np.array([mount.position for mount in self._mounts]).reshape(-1, 3),
            np.array([mount.orientation for mount in self._mounts]).reshape(-1, 4),
        )
        return positions, rotation_matrices(orientations)

    def write_links(self, frames: LinkPoses, block: Array) -> None:
        """Write the rows of these bodies' links; `block` is (19, links)."""
        states = frames.states_at(frames.positions, np.arange(len(frames.positions)))
        boxes = self._link_boxer.boxes(frames.positions, frames.matrices)
        block[:, self._link_rows] = np.concatenate((states.T, boxes))

    def write_shapes(self, frames: LinkPoses, block: Array) -> None:
        """Write the rows of these bodies' shapes; `block` is (13, shapes): pose, box."""
        on = np.array([shape.frame for shape in self._shapes], dtype=np.intp)
        positions, orientations = compose(
            frames.positions[on],
            frames.states[on, 3:7],
            np.array([shape.position for shape in self._shapes]).reshape(-1, 3),
            np.array([shape.orientation for shape in self._shapes]).reshape(-1, 4),
        )
        boxes = self._shape_boxer.boxes(frames.positions, frames.matrices)
        block[:, self._shape_rows] = np.concatenate((positions.T, orientations.T, boxes))

    @cached_property
    def _entity_boxer(self) -> BoundingBoxes:
        bare = [index for index, body in enumerate(self.bodies) if not body.shapes]
        points = [_point(frame) for frame in self._bases[bare].tolist()]
        count = len(self.bodies) + len(self._mounts)
        groups = [*self._owners, *bare, *range(len(self.bodies), count)]
        return BoundingBoxes(self._shapes + points + self._mounts, groups, count)

    @cached_property
    def _link_boxer(self) -> BoundingBoxes:
        owners = [shape.frame for shape in self._shapes]
        bare = sorted(set(range(len(self._link_rows))) - set(owners))
        points = [_point(frame) for frame in bare]
        return BoundingBoxes(self._shapes + points, owners + bare, len(self._link_rows))

    @cached_property
    def _shape_boxer(self) -> BoundingBoxes:
        return BoundingBoxes(self._shapes, range(len(self._shapes)), len(self._shapes))


_POINT = Geometry.primitive("sphere", (0, 0, 0))


def _point(frame: int) -> PlacedGeometry:
    """The box of what has no shapes is the frame's origin."""
    return PlacedGeometry(frame, _POINT, np.zeros(3), IDENTITY)


def _runs(starts: Sequence[int], counts: Sequence[int]) -> Indices:
    """start, start + 1, … (count of them), for each start."""
    runs = [np.arange(start, start + n) for start, n in zip(starts, counts, strict=True)]
    return np.concatenate(runs).astype(np.intp) if runs else np.zeros(0, np.intp)
