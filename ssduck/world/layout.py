"""Lays out the entities of a world as rows of its tables.

A `BodyGroup` is a set of bodies that are read together: those that can move, or those that cannot.
Values that do not depend on poses are computed once, so that each tick costs a few operations on
whole arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate
from typing import Any

import numpy as np

from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.bounds import BoundingBoxes
from ssduck.geometry.poses import (
    IDENTITY,
    compose,
    multiply,
    rotate,
    rotation_matrices,
)
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.schema import BOX, POSE, TWIST
from ssduck.simulators.interface import Body, Kind, LinkPoses
from ssduck.simulators.scenes import SensorSpec


@dataclass(frozen=True, eq=False)
class EntityInfo:
    """The description of an entity: a body, or a sensor on one."""

    id: int  # the id of the entity
    name: str  # its name, unique in the world
    kind: Kind  # robot, kinbody or sensor
    parent: str | None = None  # of a sensor, the name of its body
    body: Body | None = None  # of a robot or a kinbody, the body of the simulator
    sensor: SensorSpec | None = None  # of a sensor, its specification
    mount: tuple[int, int] = (0, 0)  # of a sensor, the id of its body and the number of the link

    @property
    def mass(self) -> float:
        """The mass of all links, kg; 0 for a sensor and for a body that cannot move."""
        return sum(self.masses)

    @property
    def masses(self) -> list[float]:
        """The masses of the links, kg; empty for a sensor."""
        return [link.mass for link in self.body.links] if self.body else []

    def with_masses(self, masses: Sequence[float]) -> EntityInfo:
        """Returns the entity with other masses of its links, kg."""
        if self.body is None or list(masses) == self.masses:
            return self
        links = (
            replace(link, mass=mass) for link, mass in zip(self.body.links, masses, strict=True)
        )
        return replace(self, body=replace(self.body, links=tuple(links)))

    def with_margins(self, margins: Sequence[float]) -> EntityInfo:
        """Returns the entity with other collision margins of its shapes, m."""
        if self.body is None or list(margins) == self.body.margins:
            return self
        pairs = zip(self.body.shapes, margins, strict=True)
        shapes = tuple(replace(shape, margin=margin) for shape, margin in pairs)
        return replace(self, body=replace(self.body, shapes=shapes))


def margins_of(entities: Iterable[EntityInfo]) -> float:
    """Returns the largest distance of two shapes of entities whose margins touch, m."""
    bodies = (info.body for info in entities if info.body is not None)
    return 2.0 * max((shape.margin for body in bodies for shape in body.shapes), default=0.0)


class TableLayout:
    """The rows of entities, given in load order, in the tables of their world.

    Attributes:
        entities: the entities by row: sensors first, then bodies.
        rows: the rows, by the ids of the entities.
        bodies: the bodies in order, each after the id of its entity.
        link_rows: the row of each body's first link, by the id of its entity.
        static_bodies: the bodies that never move.
        moving_bodies: the other bodies; users of an external client may move all.
    """

    def __init__(self, entities: Iterable[EntityInfo], is_external: bool) -> None:
        self.entities = sorted(entities, key=lambda info: info.kind != "sensor")
        self.rows = {info.id: row for row, info in enumerate(self.entities)}
        self.bodies = [(m.id, m.body) for m in self.entities if m.body is not None]
        # The row of each body's first link and first shape.
        links = [len(body.links) for _, body in self.bodies]
        shapes = [len(body.shapes) for _, body in self.bodies]
        starts = zip(accumulate(links, initial=0), accumulate(shapes, initial=0), strict=True)
        first = dict(zip((id for id, _ in self.bodies), starts, strict=False))
        self.link_rows = {id: link for id, (link, _) in first.items()}
        static = {id for id, body in self.bodies if not (is_external or body.movable)}
        self.static_bodies, self.moving_bodies = (
            BodyGroup(
                [m for m in self.entities if m.body and (m.id in static) is is_static], self, first
            )
            for is_static in (True, False)
        )

    @cached_property
    def shape_order(self) -> Indices | None:
        """The place of each shape among those of static bodies, followed by those of others.

        None if they are in this order.
        """
        rows = np.concatenate((self.static_bodies.shape_rows, self.moving_bodies.shape_rows))
        order: Indices = np.argsort(rows)
        return None if (order == np.arange(len(order))).all() else order

    @cached_property
    def sites(self) -> list[tuple[int, int, Geometry]]:
        """The entity, the number and the region of each site, by group and body."""
        ids = {body: id for id, body in self.bodies}
        return [
            (ids[body], number, link.region)
            for group in (self.static_bodies, self.moving_bodies)
            for body in group.bodies
            for number, link in enumerate(body.links)
            if link.region is not None
        ]

    @cached_property
    def handles(self) -> dict[int, int]:
        """The handle of each body, by the id of its entity."""
        return {id: body.handle for id, body in self.bodies}

    @cached_property
    def ids_of_handles(self) -> Indices:
        """The id of the entity for each handle of a body; 0 for the last one, -1."""
        ids = np.zeros(
            max((body.handle for _, body in self.bodies), default=-1) + 2, dtype=np.int64
        )
        for id, body in self.bodies:
            ids[body.handle] = id
        return ids

    def ids_of(self, handles: Indices) -> Indices:
        """Returns the ids of body handles; 0 for none, and for bodies not in the world yet."""
        ids = self.ids_of_handles
        known: Indices = ids[np.where(handles < len(ids) - 1, handles, -1)]
        return known


class BodyGroup:
    """Bodies that are read together, the sensors on them, and their rows in the tables.

    Args:
        entities: the entities of the bodies, in order.
        layout: the rows of all entities, including sensors.
        first: the rows of the first link and of the first shape, by the id of the entity.
    """

    def __init__(
        self,
        entities: Sequence[EntityInfo],
        layout: TableLayout,
        first: Mapping[int, tuple[int, int]],
    ) -> None:
        self.bodies = tuple(info.body for info in entities if info.body is not None)
        counts = [len(body.links) for body in self.bodies]
        starts = np.concatenate(([0], np.cumsum(counts))).astype(np.intp)
        self._bases = starts[:-1]
        runs = map(slice, starts[:-1].tolist(), starts[1:].tolist())
        self.runs = dict(zip(self.bodies, runs, strict=True))
        self.link_count = sum(counts)
        self._link_rows = _runs([first[info.id][0] for info in entities], counts)
        # The regions of sites, by the place of the link.
        self._regions = {
            start + number: link.region
            for start, body in zip(starts.tolist(), self.bodies, strict=False)
            for number, link in enumerate(body.links)
            if link.region is not None
        }
        shape_counts = [len(body.shapes) for body in self.bodies]
        self.shape_rows = _runs([first[info.id][1] for info in entities], shape_counts)
        self._shapes = [
            replace(shape, frame=start + shape.frame)
            for start, body in zip(starts.tolist(), self.bodies, strict=False)
            for shape in body.shapes
        ]
        start_of = dict(zip((info.id for info in entities), starts.tolist(), strict=False))
        sensors = [info for info in layout.entities if info.mount[0] in start_of]
        self.sensors = tuple(sensors)
        self._mounts = [
            PlacedGeometry(
                start_of[info.mount[0]] + info.mount[1],
                _POINT,
                np.array(info.sensor.position),
                np.array(info.sensor.orientation),
            )
            for info in sensors
            if info.sensor is not None
        ]
        mount_positions = np.array([mount.position for mount in self._mounts]).reshape(-1, 3)
        self._mount_positions = mount_positions.T[..., None]  # x, y and z, each (n, 1)
        self._turns = np.array([mount.orientation for mount in self._mounts]).reshape(-1, 4)
        # The rows in the table of entities, and the frame of each.
        rows = [layout.rows[info.id] for info in (*entities, *sensors)]
        self._rows = np.array(rows, dtype=np.intp)
        mounts = np.array([mount.frame for mount in self._mounts], dtype=np.intp)
        self._row_frames = np.concatenate((self._bases, mounts))
        # What was computed of the last link poses, with these.
        self._computed: dict[str, tuple[LinkPoses, Any]] = {}

    # The columns x to zmax of the tables of entities and links are pose, velocities and box. What
    # writes rows takes the link poses of one tick or of several, one tick after the other.

    def _ticks_of(self, link_poses: LinkPoses) -> int:
        return max(len(link_poses.positions) // max(self.link_count, 1), 1)

    def _at_ticks(self, links: Indices, link_poses: LinkPoses) -> Indices:
        """Returns the places of links in link poses: the first one's at all ticks come first."""
        ticks = self._ticks_of(link_poses)
        if ticks == 1:
            return links
        return (links[:, None] + self.link_count * np.arange(ticks)).reshape(-1)

    def _bounds(self, boxer: BoundingBoxes, link_poses: LinkPoses) -> Array:
        """Returns boxes of shapes, (6, boxes) or (6, boxes, ticks)."""
        ticks, positions, matrices = (
            self._ticks_of(link_poses),
            link_poses.positions,
            link_poses.matrices,
        )
        if ticks == 1:
            return boxer.boxes(positions, matrices)
        placed = positions.reshape(ticks, -1, 3), matrices.reshape(ticks, -1, 3, 3)
        return boxer.over(*placed).transpose(1, 2, 0)

    def write_entities(self, link_poses: LinkPoses, block: Array) -> None:
        """Writes the rows of the bodies and of their sensors; `block` is (19, entities, ticks)."""
        self.write_states(link_poses, block)
        self.write_boxes(link_poses, block)

    def _once(self, name: str, link_poses: LinkPoses, compute: Callable[[], Any]) -> Any:
        """Returns what follows from link poses: few bodies that cannot move ever have others."""
        last = self._computed.get(name)
        if last is None or last[0] is not link_poses:
            last = self._computed[name] = link_poses, compute()
        return last[1]

    def numbers_in(
        self, link_poses: LinkPoses, table: str, row: int, columns: tuple[str, ...]
    ) -> list[float] | None:
        """Returns numbers x to zmax of the row of a body or link here; None for other rows."""
        place = self._places[table].get(row)
        if place is None or not _COLUMNS.keys() >= set(columns):
            return None
        wanted = [_COLUMNS[name] for name in columns]
        link = place if table == "links" else self._bases[place]
        if max(wanted) < 3:  # which velocities are not computed for
            numbers = link_poses.positions[link].tolist()
        else:
            numbers = self._once("states", link_poses, lambda: self._states(link_poses))[
                link
            ].tolist()
        if max(wanted) >= len(numbers):
            boxes = self._boxes(link_poses) if table == "links" else self._entity_boxes(link_poses)
            numbers += boxes[:, place].tolist()
        return [numbers[number] for number in wanted]

    def _states(self, link_poses: LinkPoses) -> Array:
        """Returns the poses and velocities of the links at one tick, (links, 13)."""
        return link_poses.states_at(link_poses.positions, np.arange(self.link_count))

    @cached_property
    def _places(self) -> Mapping[str, Mapping[int, int]]:
        """The places of the rows of bodies and of links, by table."""
        rows = {"entities": self._rows[: len(self.bodies)], "links": self._link_rows}
        return {
            table: {row: place for place, row in enumerate(of_table.tolist())}
            for table, of_table in rows.items()
        }

    def write_states(self, link_poses: LinkPoses, block: Array) -> None:
        """Writes the poses and velocities of these rows."""
        frames, ticks = self._at_ticks(self._row_frames, link_poses), self._ticks_of(link_poses)
        positions = link_poses.positions.take(frames, axis=0)
        first = len(self.bodies) * ticks
        if self._mounts:
            matrices = link_poses.matrices.take(frames[first:], axis=0)
            positions[first:] += self._mount_offsets(matrices)
        states = link_poses.states_at(positions, frames)
        if self._mounts:
            turns = self._turns.repeat(ticks, axis=0)
            states[first:, 3:7] = multiply(states[first:, 3:7], turns)
        block[:13, self._rows] = states.T.reshape(13, len(self._rows), ticks)

    def _mount_offsets(self, columns: Array) -> Array:
        """Returns the vectors from links, of orientations (n, 3, 3), to their sensors, (n, 3)."""
        ticks = len(columns) // len(self._mounts)
        x, y, z = self._mount_positions.repeat(ticks, axis=1)
        offsets: Array = columns[:, :, 0] * x + columns[:, :, 1] * y + columns[:, :, 2] * z
        return offsets

    def write_boxes(self, link_poses: LinkPoses, block: Array) -> None:
        """Writes the boxes of these rows, the last columns."""
        ticks = self._ticks_of(link_poses)
        block[-6:, self._rows] = self._entity_boxes(link_poses).reshape(6, len(self._rows), ticks)

    def sensor_poses(self, link_poses: LinkPoses) -> tuple[Array, Array]:
        """Returns positions (n, 3), m, and rotation matrices (n, 3, 3) of the sensors."""
        indices = np.array([mount.frame for mount in self._mounts], dtype=np.intp)
        positions, orientations = compose(
            link_poses.positions[indices],
            link_poses.orientations[indices],
            np.array([mount.position for mount in self._mounts]).reshape(-1, 3),
            np.array([mount.orientation for mount in self._mounts]).reshape(-1, 4),
        )
        return positions, rotation_matrices(orientations)

    def write_links(self, link_poses: LinkPoses, block: Array) -> None:
        """Writes the rows of the links; `block` is (19, links, ticks)."""
        count, ticks = self.link_count, self._ticks_of(link_poses)
        links = self._at_ticks(np.arange(count), link_poses)
        states = link_poses.states_at(link_poses.positions.take(links, axis=0), links)
        boxes = self._boxes(link_poses)[:, :count].reshape(6, count * ticks)
        rows = np.concatenate((states.T, boxes))
        block[:, self._link_rows] = rows.reshape(19, count, ticks)

    def write_shapes(self, link_poses: LinkPoses, block: Array) -> None:
        """Writes the rows of the shapes; `block` is (13, shapes, ticks): pose, box."""
        positions, orientations, boxes = self.place_shapes(link_poses)
        rows = np.concatenate((positions.T, orientations.T, boxes.reshape(6, len(positions))))
        block[:, self.shape_rows] = rows.reshape(
            13, len(self.shape_rows), self._ticks_of(link_poses)
        )

    def place_shapes(self, link_poses: LinkPoses) -> tuple[Array, Array, Array]:
        """Returns positions (n, 3), orientations (n, 4) and boxes (6, n) of the shapes.

        At several ticks, the first shape comes first, at all of them; boxes are (6, shapes, ticks).
        """
        placed: tuple[Array, Array, Array] = self._once(
            "shapes", link_poses, lambda: self._place_shapes(link_poses)
        )
        return placed

    def _place_shapes(self, link_poses: LinkPoses) -> tuple[Array, Array, Array]:
        links, *inner = self._shape_places
        ticks = self._ticks_of(link_poses)
        links = self._at_ticks(links, link_poses)
        inner_positions, inner_orientations = (part.repeat(ticks, axis=0) for part in inner)
        arms = rotate(link_poses.matrices.take(links, axis=0), inner_positions)
        return (
            link_poses.positions.take(links, axis=0) + arms,
            multiply(link_poses.orientations.take(links, axis=0), inner_orientations),
            self._boxes(link_poses)[:, : len(self._shapes)]
            if self._are_shapes_links
            else self._bounds(self._shape_boxer, link_poses),
        )

    @cached_property
    def _are_shapes_links(self) -> bool:
        """Whether each link has one shape, in the order of the links: then it has its box."""
        return [shape.frame for shape in self._shapes] == list(range(self.link_count))

    @cached_property
    def _shape_places(self) -> tuple[Indices, Array, Array]:
        """The link of each shape, its position there (n, 3), and its orientation (n, 4)."""
        return (
            np.array([shape.frame for shape in self._shapes], dtype=np.intp),
            np.array([shape.position for shape in self._shapes]).reshape(-1, 3),
            np.array([shape.orientation for shape in self._shapes]).reshape(-1, 4),
        )

    def place_regions(self, link_poses: LinkPoses) -> tuple[Array, Array, Array]:
        """Returns positions (n, 3), orientations (n, 4) and boxes (n, 6) of the sites' regions."""
        rows = np.array(list(self._regions), dtype=np.intp)
        boxes = self._boxes(link_poses)[:, rows].T
        return link_poses.positions[rows], link_poses.orientations[rows], boxes

    def _entity_boxes(self, link_poses: LinkPoses) -> Array:
        """Returns the boxes of the bodies, then those of the sensors, as `_boxes` does."""
        boxes: Array = self._once("entities", link_poses, lambda: self._merged_boxes(link_poses))
        return boxes

    def _merged_boxes(self, link_poses: LinkPoses) -> Array:
        """Computes them from the boxes of the links."""
        boxes = self._boxes(link_poses)
        links, starts = self._bounding_links
        if len(links) == len(starts) and len(links) == self.link_count:
            return boxes
        of_links = boxes.take(links, axis=1)
        low = np.minimum.reduceat(of_links[:3], starts, axis=1)
        high = np.maximum.reduceat(of_links[3:], starts, axis=1)
        return np.concatenate((np.vstack((low, high)), boxes[:, self.link_count :]), axis=1)

    @cached_property
    def _bounding_links(self) -> tuple[Indices, Indices]:
        """The links whose boxes make those of their bodies; the place of each body's first one."""
        is_bounding = np.zeros(self.link_count, dtype=bool)
        is_bounding[[shape.frame for shape in self._shapes]] = True
        is_bounding[[self.runs[body].start for body in self.bodies if not body.shapes]] = True
        links = np.flatnonzero(is_bounding)
        return links, np.searchsorted(links, self._bases)

    def _boxes(self, link_poses: LinkPoses) -> Array:
        """Returns the boxes of links, then those of sensors, (6, n) or (6, n, ticks)."""
        boxes: Array = self._once(
            "links", link_poses, lambda: self._bounds(self._boxer, link_poses)
        )
        return boxes

    @cached_property
    def _boxer(self) -> BoundingBoxes:
        owners = [shape.frame for shape in self._shapes]
        links = self.link_count
        bare = sorted(set(range(links)) - set(owners))
        # The box of a link without shapes contains its origin, or the region of a site.
        points = [
            PlacedGeometry(frame, self._regions.get(frame, _POINT), np.zeros(3), IDENTITY)
            for frame in bare
        ]
        count = links + len(self._mounts)
        groups = [*owners, *bare, *range(links, count)]
        return BoundingBoxes(self._shapes + points + self._mounts, groups, count)

    @cached_property
    def _shape_boxer(self) -> BoundingBoxes:
        return BoundingBoxes(self._shapes, range(len(self._shapes)), len(self._shapes))


# The columns of a row that follow from link poses.
_COLUMNS = {name: place for place, name in enumerate((*POSE, *TWIST, *BOX))}
_POINT = Geometry.primitive("sphere", (0, 0, 0))


def _runs(starts: Sequence[int], counts: Sequence[int]) -> Indices:
    """Returns start, start + 1, … (as many as the count) for each start, concatenated."""
    runs = [np.arange(start, start + n) for start, n in zip(starts, counts, strict=True)]
    return np.concatenate(runs).astype(np.intp) if runs else np.zeros(0, np.intp)
