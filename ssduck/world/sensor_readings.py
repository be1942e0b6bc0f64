"""What the sensors of a world perceive: their readings, and when a new one is due.

A *reading* is what one sensor measured at one tick; it never changes. A sensor is read when its
table or its reading is asked for, and then again when its period has passed: until then its last
reading is kept. All rays of a tick are cast in one call.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array, Indices
from ssduck.schema import FORGOTTEN_AFTER
from ssduck.simulators.interface import CameraView, Contact, LinkPoses, Simulator
from ssduck.simulators.sensor_types import SENSOR_TYPES
from ssduck.world.layout import EntityInfo, TableLayout

# Sums of time steps are off by less.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Reading:
    """What a sensor measured; its arrays cannot be written to.

    A ray is a ray of a laser, a pixel of a camera, row by row from the upper left, or a contact
    point of a contact sensor.

    Attributes:
        tick: the number of the tick that it was read at.
        time: its simulated time, s.
        entities: (n,), the id of what each ray ends on; 0 for nothing.
        points: (m, 3), where rays end on something, world frame, m.
        ranges: (n,), how long each ray is, m; inf for one that ends on nothing.
        depth: (height, width), of a camera: how far along its axis each pixel is, m, else inf.
        segmentation: (height, width), of a camera: `entities` as an image.
        image: (height, width, 3), of a camera: red, green, blue; if it was asked for.
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
        """How many rays, pixels or contact points it has."""
        return len(self.entities)

    @cached_property
    def hits(self) -> Mapping[int, int]:
        """How many of them end on each entity, by its id, in the order of the ids."""
        ids, counts = np.unique(self.entities[self.entities > 0], return_counts=True)
        return dict(zip(ids.tolist(), counts.tolist(), strict=True))


@dataclass(frozen=True, eq=False)
class SensorPose:
    """A sensor and where it is: its position (3,) and its matrix (3, 3), in the world."""

    member: EntityInfo
    position: Array
    matrix: Array


@dataclass(frozen=True, eq=False)
class TickContext:
    """What is known of a tick when its sensors are read.

    Attributes:
        tick: its number.
        time: simulated seconds.
        layout: the entities.
        anew: whether things came, went or were moved by hand: no time passed, and yet all
            readings are out of date.
    """

    tick: int
    time: float
    layout: TableLayout
    anew: bool

    @cached_property
    def ids(self) -> Indices:
        """The id of each handle's entity, and a 0 at the end, for handle -1."""
        bodies = self.layout.bodies
        ids = np.zeros(max((body.handle for _, body in bodies), default=-1) + 2, dtype=np.int64)
        for id, body in bodies:
            ids[body.handle] = id
        return ids

    def entities(self, handles: Indices) -> Indices:
        """The ids of bodies; 0 for none, and for a body that is not in the world yet."""
        known = np.where(handles < len(self.ids) - 1, handles, -1)
        found: Indices = self.ids[known]
        return found


class SensorReader:
    """The readings of a world's sensors, and which of them are switched on.

    Attributes:
        readings: the last reading of each sensor that has one, by its id.
    """

    def __init__(self) -> None:
        self.readings: Mapping[int, Reading] = {}
        self._off: set[int] = set()
        # Of each sensor, the tick at which its picture was last asked for.
        self._pictures: dict[int, int] = {}
        self._rays: dict[int, Array] = {}

    def clone(self) -> SensorReader:
        """The same switches, without a reading."""
        clone = SensorReader()
        clone._off = set(self._off)
        return clone

    def is_on(self, id: int) -> bool:
        """Whether a sensor is switched on."""
        return id not in self._off

    def switch(self, id: int, *, on: bool) -> None:
        """Switch a sensor on or off; its last reading is forgotten."""
        if on:
            self._off.discard(id)
        else:
            self._off.add(id)
        self._forget(id)

    def request_picture(self, id: int, tick: int) -> bool:
        """Note that a camera's picture is asked for; tells whether its reading lacks it."""
        self._pictures[id] = tick
        reading = self.readings.get(id)
        if reading is not None and reading.image is not None:
            return False
        self._forget(id)  # its depth and its colours are of one moment
        return True

    def _forget_gone(self, layout: TableLayout) -> None:
        """Let go of what is kept of sensors that are gone."""
        self._off &= layout.rows.keys()
        self._pictures = {id: at for id, at in self._pictures.items() if id in layout.rows}
        self._rays = {id: ends for id, ends in self._rays.items() if id in layout.rows}

    def _forget(self, id: int) -> None:
        self.readings = {key: value for key, value in self.readings.items() if key != id}

    # -- a tick ---------------------------------------------------------------------------

    def due(
        self, scan: TickContext, sensors: Iterable[EntityInfo], *, is_external: bool
    ) -> set[int]:
        """Those of these sensors that are to be read, by their ids.

        Args:
            scan: the tick.
            sensors: those that are asked for.
            is_external: whether others may move things while no time passes that is known of.
        """
        return {
            member.id
            for member in sensors
            if self.is_on(member.id)
            and (scan.anew or self._is_over(member, scan.time, is_external=is_external))
        }

    def _is_over(self, member: EntityInfo, time: float, *, is_external: bool) -> bool:
        reading = self.readings.get(member.id)
        if reading is None or member.sensor is None:
            return True
        elapsed = time - reading.time
        if is_external and elapsed == 0.0:
            return True
        return not 0.0 <= elapsed < member.sensor.period - _ROUNDING

    def read(
        self,
        simulator: Simulator,
        scan: TickContext,
        posed: Sequence[SensorPose],
        contacts: Sequence[Contact],
    ) -> Mapping[int, Reading]:
        """The readings at a tick: new ones of these sensors, the last ones of the others."""
        if scan.anew:
            self._forget_gone(scan.layout)
        if not posed:
            return {} if scan.anew else self.readings
        due = {sensor.member.id for sensor in posed}
        kept = {} if scan.anew else {id: r for id, r in self.readings.items() if id not in due}
        feeling = [sensor.member for sensor in posed if not has_rays(sensor.member)]
        # A simulation that explodes has poses that are no numbers; there is nothing to see.
        seeing = [
            sensor
            for sensor in posed
            if has_rays(sensor.member)
            and np.isfinite(sensor.position).all()
            and np.isfinite(sensor.matrix).all()
        ]
        felt = {member.id: _touched(member, scan, contacts) for member in feeling}
        return {**kept, **felt, **self._cast(simulator, scan, seeing)}

    def _cast(
        self, simulator: Simulator, scan: TickContext, sensors: Sequence[SensorPose]
    ) -> dict[int, Reading]:
        """Cast the rays of these sensors in one go."""
        if not sensors:
            return {}
        rays = [self._rays_of(sensor.member) for sensor in sensors]
        counts = [len(ends) for ends in rays]
        places = np.array([sensor.position for sensor in sensors])
        hosts = [_host(sensor.member, scan.layout) for sensor in sensors]
        starts = np.repeat(places, counts, axis=0)
        ways = np.concatenate(
            [ends @ sensor.matrix.T for ends, sensor in zip(rays, sensors, strict=True)]
        )
        hits = simulator.cast_rays(starts, starts + ways, np.repeat(hosts, counts))
        entities = scan.entities(hits.bodies)
        met = hits.bodies >= 0
        points = starts + hits.fractions[:, None] * ways
        readings = {}
        last = np.cumsum(counts).tolist()
        for sensor, ends, stop in zip(sensors, rays, last, strict=True):
            own = slice(stop - len(ends), stop)
            fractions = np.where(met[own], hits.fractions[own], np.inf)
            readings[sensor.member.id] = Reading(
                scan.tick,
                scan.time,
                entities[own].copy(),
                points[own][met[own]],
                fractions * np.linalg.norm(ends, axis=1),
                **self._images(simulator, scan, sensor, fractions, entities[own]),
            )
        return readings

    def _rays_of(self, member: EntityInfo) -> Array:
        """Where a sensor's rays end at their longest, in its own frame."""
        spec = member.sensor
        if member.id not in self._rays and spec is not None:
            make = SENSOR_TYPES[spec.type].rays
            assert make is not None
            self._rays[member.id] = make(spec.max_range, spec.settings)
        return self._rays[member.id]

    def _images(
        self,
        simulator: Simulator,
        scan: TickContext,
        sensor: SensorPose,
        fractions: Array,
        entities: Indices,
    ) -> dict[str, Any]:
        """What only a camera has."""
        spec = sensor.member.sensor
        assert spec is not None
        kind = SENSOR_TYPES[spec.type]
        if not kind.has_picture:
            return {}
        height, width = kind.shape(spec.settings)
        images: dict[str, Any] = {
            "depth": (fractions * spec.max_range).reshape(height, width),
            "segmentation": entities.reshape(height, width).copy(),
        }
        asked = self._pictures.get(sensor.member.id)
        if asked is not None and scan.tick - asked <= FORGOTTEN_AFTER:
            view = CameraView(sensor.position, sensor.matrix, spec.settings["fov"], width, height)
            images["image"] = simulator.photograph(view)
        return images


def posed(
    layout: TableLayout, still: LinkPoses, moving: LinkPoses, ids: set[int]
) -> list[SensorPose]:
    """Where these sensors are, in the order of the rows."""
    found = []
    for part, frames in ((layout.static_bodies, still), (layout.moving_bodies, moving)):
        if ids.isdisjoint(member.id for member in part.sensors):
            continue
        positions, matrices = part.sensor_poses(frames)
        found += [
            SensorPose(member, position, matrix)
            for member, position, matrix in zip(part.sensors, positions, matrices, strict=True)
            if member.id in ids
        ]
    return sorted(found, key=lambda sensor: layout.rows[sensor.member.id])


def has_rays(member: EntityInfo) -> bool:
    """Whether a sensor sees; else it feels."""
    assert member.sensor is not None
    return SENSOR_TYPES[member.sensor.type].rays is not None


def _host(member: EntityInfo, layout: TableLayout) -> int:
    """The handle of the body that a sensor sits on."""
    body = layout.entities[layout.rows[member.mount[0]]].body
    assert body is not None
    return body.handle


def _touched(member: EntityInfo, scan: TickContext, contacts: Sequence[Contact]) -> Reading:
    """The contacts of the link that a sensor sits on, or of the whole body."""
    host = _host(member, scan.layout)
    spec = member.sensor
    link = member.mount[1] if spec is not None and spec.link is not None else None
    found = []
    for contact in contacts:
        sides = (
            (contact.body_a, contact.link_a, contact.point_a, contact.body_b),
            (contact.body_b, contact.link_b, contact.point_b, contact.body_a),
        )
        for own, own_link, point, other in sides:
            if own == host != other and contact.force > 0 and link in (None, own_link):
                found.append((other, point, contact.force))
    return Reading(
        scan.tick,
        scan.time,
        scan.entities(np.array([other for other, _, _ in found], dtype=np.intp)),
        np.array([point for _, point, _ in found]).reshape(-1, 3),
        forces=np.array([force for _, _, force in found], dtype=np.float64),
    )
