"""Handles of what is in a world: `Entity`, `Sensor`, and what they tell of links and joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ssduck import validation
from ssduck.errors import (
    ArgumentError,
    RemovedEntityError,
    SelectScriptError,
)
from ssduck.geometry.arrays import Array, Indices
from ssduck.schema import MASSES
from ssduck.simulators.interface import Body, Kind
from ssduck.simulators.joints import openness
from ssduck.simulators.kinematics import JointValues, unit
from ssduck.simulators.scenes import SensorSpec
from ssduck.simulators.sensor_types import SENSOR_TYPES
from ssduck.world.layout import EntityInfo
from ssduck.world.openrave_names import OpenRaveEntity, OpenRaveSensor
from ssduck.world.sensor_readings import Reading

if TYPE_CHECKING:
    from ssduck.world.world import World

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class LinkState:
    """A link at a tick: its name, position (m), orientation (w, x, y, z), box and mass (kg)."""

    name: str
    position: list[float]
    orientation: list[float]
    aabb: tuple[list[float], list[float]]
    mass: float


@dataclass(frozen=True, eq=False)
class JointState:
    """A joint at a tick: position (rad or m), velocity, effort of its motor, limits.

    The effort is None where nobody knows it, in a what-if world.
    """

    name: str
    type: str
    position: float
    velocity: float
    effort: float | None
    lower: float | None
    upper: float | None

    @property
    def openness(self) -> float | None:
        """How far it is open, as a share of its range; None if it has no two limits.

        The closed end is that of the two limits that is nearer to 0, or the lower one.
        """
        return openness(self, self.position)


class WorldArchive(Protocol):
    """The recorded ticks of a world, as handles and worlds of these ticks see them."""

    @property
    def world(self) -> World:
        """Whose ticks they are."""

    def at(self, tick: int) -> World:
        """The world at a tick."""

    def entity(self, tick: int, id: int) -> Entity:
        """The handle of an entity at a tick."""

    def warn_of_masses(self) -> None:
        """Warn of masses that are others than the recorded ones."""


@dataclass(frozen=True, eq=False)
class RecordedTick:
    """A recorded tick that a handle stays at."""

    record: WorldArchive
    tick: int


class Entity(OpenRaveEntity):
    """A handle of a robot, kinbody or sensor: what it tells is of its world's last tick.

    One that a query of the past gave, `FROM kitchen{12.5}`, stays at the tick that it is of.
    Two handles are equal when they are of the same entity of the same world, at whatever tick.

    Attributes:
        world: the world that it is in.
        id: ssduck's own number, never used again in this world.
        name: unique in the world.
        kind: `"robot"`, `"kinbody"` or `"sensor"`.
        moment: the recorded tick that it stays at; None for the world's last one.
    """

    __slots__ = ("id", "kind", "moment", "name", "world")

    # How programs get at what it has, as it has no keys.
    KEY_HINT = "functions tell of an entity: z(this), or k.z where k is a source"

    def __init__(
        self, world: World, id: int, name: str, kind: Kind, moment: RecordedTick | None = None
    ) -> None:
        self.world = world
        self.id = id
        self.name = name
        self.kind = kind
        self.moment = moment

    @property
    def state(self) -> World:
        """The world as it is at the tick that the handle tells of."""
        moment = self.moment
        if moment is None or moment.tick == self.world.snapshot.number:
            return self.world
        return moment.record.at(moment.tick)

    @property
    def is_there(self) -> bool:
        """Whether its world has it, at the tick that it tells of."""
        return self.id in self.state.snapshot.rows

    @property
    def position(self) -> list[float]:
        """The link frame's origin [x, y, z], metres, world frame."""
        return self._numbers("x", "z")

    @property
    def orientation(self) -> list[float]:
        """The link frame's orientation [w, x, y, z], world frame."""
        return self._numbers("qw", "qz")

    @property
    def pose(self) -> list[float]:
        """Orientation, then position: [w, x, y, z, x, y, z]."""
        return self.orientation + self.position

    @property
    def velocity(self) -> list[float]:
        """Of the link frame's origin, m/s, then angular, rad/s: six numbers, world frame."""
        return self._numbers("vx", "wz")

    @property
    def aabb(self) -> tuple[list[float], list[float]]:
        """The lower and upper corner of the exact axis-aligned box, metres."""
        return self._numbers("xmin", "zmin"), self._numbers("xmax", "zmax")

    @property
    def mass(self) -> float:
        """Kilograms of all links; 0 for a sensor and for what cannot move."""
        with self.state.lock:
            self.state.request_tables([MASSES])
            return self._numbers("mass", "mass")[0]

    @property
    def links(self) -> list[LinkState]:
        """The links, the base first; asks the world for the table of links."""
        table = self._table("links")
        box = ("xmin", "ymin", "zmin"), ("xmax", "ymax", "zmax")
        return [
            LinkState(
                name=row["name"],
                position=[row[axis] for axis in ("x", "y", "z")],
                orientation=[row[axis] for axis in ("qw", "qx", "qy", "qz")],
                aabb=([row[axis] for axis in box[0]], [row[axis] for axis in box[1]]),
                mass=row["mass"],
            )
            for row in table
        ]

    @property
    def joints(self) -> list[JointState]:
        """The joints; asks the world for the table of joints."""
        keys = ("name", "type", "position", "velocity", "effort", "lower", "upper")
        return [JointState(**{key: row[key] for key in keys}) for row in self._table("joints")]

    def move(
        self,
        position: Sequence[float] | None = None,
        orientation: Sequence[float] | None = None,
        joints: JointValues | None = None,
    ) -> None:
        """Put it elsewhere at rest, and take a tick: the next query sees it.

        Joints that are not given keep their positions and speeds.

        In a simulation that ssduck loaded, motors that hold joints hold them at the new
        positions; in one of yours they are as you set them.

        Args:
            position: of its link frame, [x, y, z], metres; None leaves it.
            orientation: of its link frame, [w, x, y, z], any length but 0; None leaves it.
            joints: positions, rad or m: by the joint's name, or one for each revolute and
                prismatic joint in order. Joints alone leave the body where it is, and
                as fast.

        Raises:
            StateError: a number is not finite, the orientation is all 0, or a joint is beyond
                its limits.
            UnknownNameError: there is no joint of a name, with the nearest names.
            ArgumentError: it is a sensor, a joint's position is not one number, or there are
                too many values or too few.
            RemovedEntityError: it is no longer in its world.
            UnsupportedError: it is in a what-if world.
        """
        pose = None
        if joints is None or position is not None or orientation is not None:
            place = self.position if position is None else position
            turn = self.orientation if orientation is None else orientation
            pose = (
                validation.finite_array(place, 3, f"{self.name}: position"),
                unit(validation.finite_array(turn, 4, f"{self.name}: orientation"), self.name),
            )
        self.state.place(self, pose, joints)

    def drive(
        self,
        positions: JointValues | None = None,
        velocities: Mapping[str, float] | None = None,
        efforts: Mapping[str, float] | None = None,
    ) -> None:
        """Set the motors of its joints; they act in the steps to come, until they are set again.

        Nothing moves at once, and no tick is taken. Motors of joints that are not named go on
        with what they did. `move` with joints makes motors hold the new positions, in a
        simulation that ssduck loaded.

        Args:
            positions: where motors take joints and hold them, rad or m: by the joint's name, or
                one for each revolute and prismatic joint in order. They go no faster than the
                joint's model allows.
            velocities: how fast motors turn joints, rad/s or m/s, by the joint's name.
            efforts: the most that these motors give, N m or N, by the joint's name; others give
                what the joint's model allows.

        Raises:
            StateError: a number is not finite, a position is beyond the joint's limits, or a
                velocity or an effort is more than its model allows.
            UnknownNameError: there is no joint of a name, with the nearest names.
            ArgumentError: it is a sensor, a joint has both a position and a velocity, or an
                effort and neither; there are too many positions or too few.
            RemovedEntityError: it is no longer in its world.
            UnsupportedError: it is in a what-if world.
        """
        self.state.drive(self, positions, velocities, efforts)

    def hold(self, other: Entity, link: str | None = None, *, touching: int = 1) -> None:
        """Tie a body that one of its links touches to that link, rigidly, as they are now.

        It is a fixed constraint of the simulator, between the link and the other body's base: it
        stands for a grip that does not slip, as planners of grasps have it, and is stronger than
        any friction. It is made only where they touch, and takes a tick to see that; it moves
        nothing. What was held when a world was saved or an excerpt taken is held in these, too.

        Args:
            other: the body, of the same world.
            link: the link that holds it; None for the base.
            touching: how many links, of this one and those that hang on it (the fingers of a
                hand), are to be within 1 mm of it at least, as the narrow phase has it.

        Raises:
            StateError: fewer are; or it is held already.
            UnknownNameError: there is no link of that name, with the nearest names.
            ArgumentError: one of them is a sensor, or the other is of another world, or itself.
            RemovedEntityError: one of them is no longer in its world.
            UnsupportedError: it is in a what-if world.
        """
        self.state.hold(self, other, link, touching)

    def release(self, other: Entity) -> None:
        """Let go of a body that it holds: remove fixed constraints of its links to that's base.

        Raises:
            StateError: it does not hold it.
            ArgumentError: one of them is a sensor, or the other is of another world, or itself.
            RemovedEntityError: one of them is no longer in its world.
            UnsupportedError: it is in a what-if world.
        """
        self.state.release(self, other)

    @property
    def enabled(self) -> bool:
        """Whether it takes part in collisions; setting it takes a tick.

        Rays do not meet what is not enabled either. PyBullet does not tell what a body may
        collide with; enabled again, it is what PyBullet begins with.

        Raises:
            ArgumentError: it is a sensor.
            RemovedEntityError: it is no longer in its world.
            UnsupportedError: it is in a what-if world.
        """
        return bool(self.column("enabled"))

    @enabled.setter
    def enabled(self, on: bool) -> None:
        self.state.enable(self, on)

    @property
    def visible(self) -> bool:
        """Whether it is drawn; setting it takes a tick. It gets its colours back.

        Raises:
            ArgumentError: it is a sensor.
            RemovedEntityError: it is no longer in its world.
            UnsupportedError: it is in a what-if world.
        """
        return bool(self.column("visible"))

    @visible.setter
    def visible(self, on: bool) -> None:
        self.state.show(self, on)

    def body_of(self, info: EntityInfo, verb: str) -> Body:
        """What it is made of, by its entry in the world; `verb` says what for.

        Raises:
            ArgumentError: it is a sensor.
        """
        if info.body is None:
            raise ArgumentError(f"{self.name} is a sensor; {verb} what it sits on")
        return info.body

    def column(self, name: str) -> Any:
        """Its value in a column of the table of entities; None for an unknown one."""
        return self.state.snapshot.value(self._row(), name)

    def _row(self) -> int:
        row = self.state.snapshot.rows.get(self.id)
        if row is None:
            raise self.removed()
        return row

    def removed(self) -> RemovedEntityError:
        """What to raise where it is no longer in its world."""
        return RemovedEntityError(f"{self.name!r} is no longer in world {self.world.name!r}")

    def _numbers(self, first: str, last: str) -> list[float]:
        with self.state.lock:
            column = self.state.snapshot.tables["entities"].doubles(first, last)[:, self._row()]
            values: list[float] = column.tolist()
        return values

    def _table(self, name: str) -> list[dict[str, Any]]:
        with self.state.lock:
            self._row()
            self.state.request_tables([name, MASSES] if name == "links" else [name])
            self._row()  # asking may have taken a tick
            table = self.state.snapshot.tables[name]
            own = table.arrow.filter(pa.array(table["entity"] == self.id))
            rows: list[dict[str, Any]] = own.to_pylist()
        return rows

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Entity) and (self.world, self.id) == (other.world, other.id)

    def __hash__(self) -> int:
        return hash((id(self.world), self.id))

    def __deepcopy__(self, _: dict[int, Any]) -> Entity:
        """A handle changes nothing, so it is its own copy."""
        return self

    def __repr__(self) -> str:
        return f"<{self.kind} {self.name!r}>"


class KinBody(Entity):
    """A handle of a body: of a kinbody, or of a robot, which is one too, as in OpenRAVE."""

    __slots__ = ()


class Robot(KinBody):
    """A handle of a robot."""

    __slots__ = ()


class Sensor(OpenRaveSensor, Entity):
    """A handle of a sensor: what it measured last, by its world's last tick.

    It is read from the simulator when it is asked for, and then again when its `period` has
    passed. A ray is a ray of a laser, a pixel of a camera (row by row from the upper left) or a
    contact point of a contact sensor. All arrays are numpy's, and cannot be written to.
    """

    __slots__ = ()

    def power(self, on: bool) -> None:
        """Switch it on or off; the next query sees it. It perceives nothing while it is off."""
        self.state.switch(self, on=on)

    @property
    def powered(self) -> bool:
        """Whether it is switched on."""
        self._row()
        return self.state.snapshot.sensing.is_on(self.id)

    @property
    def reading(self) -> Reading | None:
        """All that it measured last, and when; None while it is switched off."""
        return self.state.reading(self)

    @property
    def rays(self) -> int:
        """How many rays, pixels or contact points its reading has."""
        return self._measured("rays")  # type: ignore[no-any-return]

    @property
    def ranges(self) -> Array:
        """How long each ray is, m, (n,); inf for one that ends on nothing within range."""
        return self._measured("ranges")  # type: ignore[no-any-return]

    @property
    def points(self) -> Array:
        """Where rays end on something, [x, y, z] in the world frame, m, (hits, 3)."""
        return self._measured("points")  # type: ignore[no-any-return]

    @property
    def depth(self) -> Array:
        """Of a camera, how far along its axis each pixel is, m, (height, width); else inf."""
        return self._measured("depth")  # type: ignore[no-any-return]

    @property
    def segmentation(self) -> Indices:
        """Of a camera, the id of what each pixel shows, (height, width); 0 for nothing."""
        return self._measured("segmentation")  # type: ignore[no-any-return]

    @property
    def image(self) -> npt.NDArray[np.uint8]:
        """Of a camera, its colours: red, green, blue, (height, width, 3), from 0 to 255.

        It shows what is drawn, the sensor's own body and what is out of range included.
        """
        return self._measured("image")  # type: ignore[no-any-return]

    @property
    def forces(self) -> Array:
        """Of a contact sensor, the normal force at each contact point, N, (n,)."""
        return self._measured("forces")  # type: ignore[no-any-return]

    def _measured(self, what: str) -> Any:
        reading = self.state.reading(self, picture=what == "image" and self._has_picture())
        if reading is None:
            raise SelectScriptError(
                f"{self.name!r} measures nothing: it is switched off, or nowhere; "
                "power(True) switches it on"
            )
        value = getattr(reading, what)
        if value is None:
            has = ", ".join(k for k, v in vars(reading).items() if isinstance(v, np.ndarray))
            raise ArgumentError(f"{self.name!r} is a {self.spec.type}: no {what}, but {has}")
        return value

    def _has_picture(self) -> bool:
        return SENSOR_TYPES[self.spec.type].has_picture

    @property
    def host(self) -> int:
        """The id of the body that it sits on."""
        info = self.state.snapshot.entities[self._row()]
        return info.mount[0]

    @property
    def spec(self) -> SensorSpec:
        """What the sensor is, and where it sits."""
        spec = self.state.snapshot.entities[self._row()].sensor
        assert spec is not None
        return spec


# What the handles of entities are, by their kind.
HANDLES: dict[Kind, type[Entity]] = {"robot": Robot, "kinbody": KinBody, "sensor": Sensor}
