"""Reads the sensors of a world.

A *reading* is the result of one measurement of a sensor; it never changes. A sensor is read when
the table of sensings or its reading is requested, and again when its period has passed; until then
its last reading remains valid. All rays of a tick are cast in one call.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array, Indices
from ssduck.schema import FORGOTTEN_AFTER
from ssduck.simulators.interface import CameraView, ContactPoints, LinkPoses, Simulator
from ssduck.simulators.sensor_types import SENSOR_TYPES
from ssduck.world.layout import EntityInfo, TableLayout
from ssduck.world.live_tables import LiveTable

SENSING_COLUMNS = ("sensor", "entity", "hits", "rays", "measured")
# Sums of time steps deviate by less than this, s.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Reading:
    """A measurement of a sensor; its arrays are read-only.

    A ray is a ray of a laser, a pixel of a camera, row by row from the upper left, or a contact
    point of a contact sensor.

    Attributes:
        tick: the number of the tick of the measurement.
        time: the simulated time of the measurement, s.
        entities: (n,), the id of the entity that each ray hits; 0 for none.
        points: (m, 3), the points that rays hit, world frame, m.
        ranges: (n,), the length of each ray, m; inf for one that hits nothing.
        depth: (height, width), of a camera: the distance of each pixel along the axis, m; inf for
            nothing.
        segmentation: (height, width), of a camera: `entities` as an image.
        image: (height, width, 3), of a camera: red, green, blue; None unless requested.
        forces: (n,), of a contact sensor: the normal forces, N.
    """

    tick: int
    time: float
    entities: Indices
    points: Array
    ranges: Array | None = None
    depth: Array | None = None
    segmentation: Indices | None = None
    image: npt.NDArray[np.uint8] | None = None
    forces: Array | None = None

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    @property
    def rays(self) -> int:
        """The number of rays, pixels or contact points."""
        return len(self.entities)

    @cached_property
    def hits(self) -> Mapping[int, int]:
        """The number of rays that hit each entity, by its id, in the order of the ids."""
        ids, counts = np.unique(self.entities[self.entities > 0], return_counts=True)
        return dict(zip(ids.tolist(), counts.tolist(), strict=True))


@dataclass(frozen=True, eq=False)
class SensorPose:
    """The pose of a sensor in the world frame: position (3,), m, and rotation matrix (3, 3)."""

    info: EntityInfo
    position: Array
    matrix: Array


class TickState(NamedTuple):  # made faster than a dataclass is
    """What a tick was read as; all rows of the tick follow from it and the entities."""

    number: int  # the number of the tick
    time: float  # the simulated time of the tick, s
    wall_time: float  # the time at which it was read, s since 1970
    static: LinkPoses  # the link poses of the bodies that cannot move
    moving: LinkPoses  # those of the other bodies
    # Position, velocity and effort of all joints, (joints, 3); None if not read.
    joints: Array | None
    contacts: ContactPoints  # the contacts; empty if not read
    readings: Mapping[int, Reading]  # the last reading of each sensor, by its id
    sensors: frozenset[int]  # the ids of the sensors whose readings are up to date


class TickContext(NamedTuple):  # made faster than a dataclass is
    """The tick at which sensors are read."""

    tick: int  # the number of the tick
    time: float  # the simulated time, s
    layout: TableLayout  # the entities
    # Whether entities were added, removed or moved by hand, so that all readings are out of date
    # although no time passed.
    is_discontinuous: bool


class SensorReader:
    """The readings and the switches of a world's sensors, by their ids."""

    def __init__(self) -> None:
        self.readings: Mapping[int, Reading] = {}
        self._off: set[int] = set()
        # The tick at which each camera's picture was last requested.
        self._pictures: dict[int, int] = {}
        self._rays: dict[int, Array] = {}

    def clone(self) -> SensorReader:
        """Returns a reader with the same switches and no readings."""
        clone = SensorReader()
        clone._off = set(self._off)
        return clone

    def is_on(self, id: int) -> bool:
        """Checks whether a sensor is switched on."""
        return id not in self._off

    def switch(self, id: int, *, on: bool) -> None:
        """Switches a sensor on or off, and discards its last reading."""
        if on:
            self._off.discard(id)
        else:
            self._off.add(id)
        self._discard(id)

    def request_picture(self, id: int, tick: int) -> bool:
        """Notes a request for a camera's picture; returns whether its reading lacks one."""
        self._pictures[id] = tick
        reading = self.readings.get(id)
        if reading is not None and reading.image is not None:
            return False
        self._discard(id)  # depth and colours must be of the same tick
        return True

    def _discard_removed(self, layout: TableLayout) -> None:
        self._off &= layout.rows.keys()
        self._pictures = {id: at for id, at in self._pictures.items() if id in layout.rows}
        self._rays = {id: ends for id, ends in self._rays.items() if id in layout.rows}

    def _discard(self, id: int) -> None:
        self.readings = {key: value for key, value in self.readings.items() if key != id}

    # -- a tick ---------------------------------------------------------------------------

    def due(
        self, context: TickContext, sensors: Iterable[EntityInfo], *, is_external: bool
    ) -> set[int]:
        """Returns the ids of the sensors whose readings are out of date."""
        return {
            info.id
            for info in sensors
            if self.is_on(info.id)
            and (
                context.is_discontinuous
                or self._is_outdated(info, context.time, is_external=is_external)
            )
        }

    def _is_outdated(self, info: EntityInfo, time: float, *, is_external: bool) -> bool:
        reading = self.readings.get(info.id)
        if reading is None or info.sensor is None:
            return True
        elapsed = time - reading.time
        if is_external and elapsed == 0.0:
            return True
        return not 0.0 <= elapsed < info.sensor.period - _ROUNDING

    def read(
        self,
        simulator: Simulator,
        context: TickContext,
        poses: Sequence[SensorPose],
        contacts: ContactPoints,
    ) -> Mapping[int, Reading]:
        """Returns the readings at a tick: new ones of some sensors, the last ones of the others."""
        kept = {} if context.is_discontinuous else self.readings
        if context.is_discontinuous:
            self._discard_removed(context.layout)
        if not poses:
            return kept
        read_ids = {pose.info.id for pose in poses}
        readings = {id: one for id, one in kept.items() if id not in read_ids}
        with_rays = []
        for pose in poses:
            if not has_rays(pose.info):
                readings[pose.info.id] = _contact_reading(pose.info, context, contacts)
            # A diverging simulation has poses that are not numbers; their sensors see nothing.
            elif np.isfinite(pose.position).all() and np.isfinite(pose.matrix).all():
                with_rays.append(pose)
        return readings | self._cast(simulator, context, with_rays)

    def _cast(
        self, simulator: Simulator, context: TickContext, sensors: Sequence[SensorPose]
    ) -> dict[int, Reading]:
        """Returns the readings of ray sensors, whose rays it casts in one call."""
        if not sensors:
            return {}
        rays = [self._rays_of(sensor.info) for sensor in sensors]
        counts = [len(ends) for ends in rays]
        positions = np.array([sensor.position for sensor in sensors])
        hosts = [_host(sensor.info, context.layout) for sensor in sensors]
        starts = np.repeat(positions, counts, axis=0)
        offsets = np.concatenate(
            [ends @ sensor.matrix.T for ends, sensor in zip(rays, sensors, strict=True)]
        )
        hits = simulator.cast_rays(starts, starts + offsets, np.repeat(hosts, counts))
        entities = context.layout.ids_of(hits.bodies)
        is_hit = hits.bodies >= 0
        points = starts + hits.fractions[:, None] * offsets
        readings = {}
        stops = np.cumsum(counts).tolist()
        for sensor, ends, stop in zip(sensors, rays, stops, strict=True):
            run = slice(stop - len(ends), stop)
            fractions = np.where(is_hit[run], hits.fractions[run], np.inf)
            readings[sensor.info.id] = Reading(
                context.tick,
                context.time,
                entities[run].copy(),
                points[run][is_hit[run]],
                fractions * np.linalg.norm(ends, axis=1),
                **self._images(simulator, context, sensor, fractions, entities[run]),
            )
        return readings

    def _rays_of(self, info: EntityInfo) -> Array:
        """Returns the ends of a sensor's rays at maximum range, in its own frame, (n, 3)."""
        spec = info.sensor
        if info.id not in self._rays and spec is not None:
            ray_ends = SENSOR_TYPES[spec.type].rays
            assert ray_ends is not None
            self._rays[info.id] = ray_ends(spec.max_range, spec.settings)
        return self._rays[info.id]

    def _images(
        self,
        simulator: Simulator,
        context: TickContext,
        sensor: SensorPose,
        fractions: Array,
        entities: Indices,
    ) -> dict[str, Any]:
        """Returns the images of a reading by attribute; empty unless the sensor is a camera."""
        spec = sensor.info.sensor
        assert spec is not None
        kind = SENSOR_TYPES[spec.type]
        if not kind.has_picture:
            return {}
        height, width = kind.shape(spec.settings)
        images: dict[str, Any] = {
            "depth": (fractions * spec.max_range).reshape(height, width),
            "segmentation": entities.reshape(height, width).copy(),
        }
        requested = self._pictures.get(sensor.info.id)
        if requested is not None and context.tick - requested <= FORGOTTEN_AFTER:
            view = CameraView(sensor.position, sensor.matrix, spec.settings["fov"], width, height)
            images["image"] = simulator.photograph(view)
        return images


def sensor_poses(
    layout: TableLayout, static: LinkPoses, moving: LinkPoses, ids: set[int]
) -> list[SensorPose]:
    """Returns the poses of sensors of some ids, in the order of their rows."""
    poses = []
    for group, link_poses in ((layout.static_bodies, static), (layout.moving_bodies, moving)):
        if ids.isdisjoint(info.id for info in group.sensors):
            continue
        positions, matrices = group.sensor_poses(link_poses)
        poses += [
            SensorPose(info, position, matrix)
            for info, position, matrix in zip(group.sensors, positions, matrices, strict=True)
            if info.id in ids
        ]
    return sorted(poses, key=lambda pose: layout.rows[pose.info.id])


def has_rays(info: EntityInfo) -> bool:
    """Checks whether a sensor casts rays; otherwise it measures contacts."""
    assert info.sensor is not None
    return SENSOR_TYPES[info.sensor.type].rays is not None


def _host(info: EntityInfo, layout: TableLayout) -> int:
    """Returns the handle of the body that a sensor is mounted on."""
    body = layout.entities[layout.rows[info.mount[0]]].body
    assert body is not None
    return body.handle


def _contact_reading(info: EntityInfo, context: TickContext, contacts: ContactPoints) -> Reading:
    """Returns the reading of a contact sensor: contacts of its link, or of the whole body."""
    host = _host(info, context.layout)
    spec = info.sensor
    link = info.mount[1] if spec is not None and spec.link is not None else None
    has_force = (contacts.forces > 0) & (contacts.bodies[:, 0] != contacts.bodies[:, 1])
    is_touching = (contacts.bodies == host) & has_force[:, None]
    if link is not None:
        is_touching &= contacts.links == link
    rows, sides = np.nonzero(is_touching)
    return Reading(
        context.tick,
        context.time,
        context.layout.ids_of(contacts.bodies[rows, 1 - sides]),
        contacts.points[rows, sides],
        forces=contacts.forces[rows],
    )


def write_sensings(
    table: LiveTable, readings: Mapping[int, Reading], entities: Container[int]
) -> None:
    """Writes the rows of readings into the table of sensings; see `sensing_rows`."""
    numbers = sensing_rows(readings, entities)
    table.resize(len(numbers))
    for name, column in zip(SENSING_COLUMNS, numbers.T, strict=True):
        table[name][:] = column


def sensing_rows(readings: Mapping[int, Reading], entities: Container[int]) -> Array:
    """Returns rows of the table of sensings, (n, 5), without those of removed entities."""
    rows = [
        (sensor, entity, hits, reading.rays, reading.time)
        for sensor, reading in sorted(readings.items())
        for entity, hits in reading.hits.items()
        if entity in entities
    ]
    return np.array(rows, dtype=np.float64).reshape(-1, len(SENSING_COLUMNS))
