"""Defines handles of the entities of a world: `Entity`, `KinBody`, `Robot` and `Sensor`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Never, Self

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ssduck import validation
from ssduck.errors import (
    ArgumentError,
    SelectScriptError,
    StateError,
    UnknownNameError,
    nearest,
)
from ssduck.formatting import joined_names, short_repr
from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.tick_solids import TOUCHING_DISTANCE
from ssduck.schema import MARGINS
from ssduck.simulators.interface import DEFAULT_BACKEND, Body, Kind, Simulator
from ssduck.simulators.kinematics import (
    JointValues,
    descendant_links,
    joint_positions,
    link_index,
    motor_targets,
    openness,
)
from ssduck.simulators.scenes import SensorSpec
from ssduck.simulators.sensor_types import SENSOR_TYPES
from ssduck.world.handles import (
    Handle,
    Link,
    NamedList,
    RecordedTick,
    Site,
    links_and_sites_of,
    links_of,
    sites_of,
)
from ssduck.world.layout import EntityInfo
from ssduck.world.orientations import Orientation, orientation_of
from ssduck.world.public_names import INSTEAD_IN_ENTITIES
from ssduck.world.sensor_readings import Reading

if TYPE_CHECKING:
    from ssduck.world.world import World


# What to write for the arguments that other libraries' functions have for a pose.
_OF_MOVE = {
    **dict.fromkeys(("pos", "xyz", "translation"), "the position is position=[x, y, z], m"),
    **dict.fromkeys(
        ("quaternion", "quat", "orn", "rotation"),
        "a quaternion is wxyz=[w, x, y, z], or xyzw=[x, y, z, w]",
    ),
    **dict.fromkeys(("q", "qpos"), "positions of joints are joints={'name': 0.5}"),
}


@dataclass(frozen=True, eq=False)
class JointState:
    """A joint at a tick: position (rad or m), velocity, effort of its motor, limits.

    The effort is None in a what-if world, where it is unknown.
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
        """The distance from the closed end as a share of the range; None without two limits.

        The closed end is the limit nearer to 0; if both are as near, the lower limit.
        """
        return openness(self, self.position)


class Entity(Handle):
    """A handle of a robot, kinbody or sensor; its properties are those at its world's last tick.

    A handle from a query of the past, such as `FROM kitchen{12.5}`, is fixed to that tick.
    Two handles are equal if they stand for the same entity of the same world, at any tick.

    Attributes:
        world: the world of the entity.
        id: ssduck's number of the entity, never used again in this world.
        name: the name, unique in the world.
        kind: `"robot"`, `"kinbody"` or `"sensor"`.
        moment: the recorded tick to which the handle is fixed; None for the world's last tick.
    """

    __slots__ = ("kind",)

    INSTEAD_OF = INSTEAD_IN_ENTITIES

    kind: Kind

    def __init__(
        self, world: World, id: int, name: str, kind: Kind, moment: RecordedTick | None = None
    ) -> None:
        super().__init__(world, id, name, moment)
        self.kind = kind

    def pinned(self, moment: RecordedTick) -> Self:
        """Returns the handle that stays at a recorded tick."""
        return type(self)(self.world, self.id, self.name, self.kind, moment)

    @property
    def is_there(self) -> bool:
        """Whether the world has the entity at the tick of the handle."""
        return self.id in self.state.snapshot.rows

    @property
    def entity(self) -> Entity:
        """The entity itself; of a link, its entity."""
        return self

    @property
    def info(self) -> EntityInfo:
        """The description of the entity at the tick of the handle."""
        state = self.state
        with state.lock:
            return state.snapshot.entities[self._row()]

    @property
    def links(self) -> NamedList[Link]:
        """The links, the base first, by number or name; requests the table of links."""
        with self.state.lock:
            self._row()
            self.state.request_tables(["links"])
            return NamedList(links_of(self))

    @property
    def sites(self) -> NamedList[Site]:
        """The sites, by number or name; requests the table of links from the world."""
        with self.state.lock:
            self._row()
            self.state.request_tables(["links"])
            return NamedList(sites_of(self))

    def link(self, name: str) -> Link:
        """Returns the link, or the site, of a name.

        Raises:
            UnknownNameError: nothing has the name; the error suggests the nearest names.
            RemovedEntityError: the entity is no longer in its world.
        """
        links = links_and_sites_of(self)
        for link in links:
            if link.name == name:
                return link
        names = [link.name for link in links]
        kinds = " or ".join(dict.fromkeys(link.kind for link in links)) or "link"
        raise UnknownNameError(
            f"{self.name!r} has no {kinds} {short_repr(name)}", suggestions=nearest(name, names)
        )

    def __getitem__(self, name: str) -> Link:
        """Returns the link, or the site, of a name; see `link`.

        Raises:
            TypeError: nothing has a name like that.
        """
        try:
            return self.link(name)
        except UnknownNameError as error:
            if error.suggestions and not self._is_of_another_kind(name):
                raise
            raise TypeError(error.message) from error

    def _is_of_another_kind(self, name: str) -> bool:
        """Checks whether a name that no link has is that of a joint, say, or of a value."""
        return hasattr(type(self), name) or bool(self.part_hint(name))

    def key_hint(self, key: str) -> str:
        """The hint of the error for a program that asks for a part or a value by a key."""
        parts = links_and_sites_of(self)
        kinds = " and ".join(dict.fromkeys(f"{part.kind}s" for part in parts))
        names = [part.name for part in parts]
        near = () if self._is_of_another_kind(key) else nearest(key, names, 1)
        told = f"did you mean {near[0]!r}?" if near else super().key_hint(key)
        return f"its {kinds}: {joined_names(names)}; {told}" if parts else told

    @property
    def joints(self) -> NamedList[JointState]:
        """The joints, by number or name; requests the table of joints from the world."""
        keys = ("name", "type", "position", "velocity", "effort", "lower", "upper")
        rows = self._table("joints")
        return NamedList(JointState(**{key: row[key] for key in keys}) for row in rows)

    def move(
        self,
        position: Sequence[float] | None = None,
        orientation: Orientation | None = None,
        joints: JointValues | None = None,
        *,
        wxyz: Sequence[float] | None = None,
        xyzw: Sequence[float] | None = None,
        **others: Never,
    ) -> None:
        """Moves the body to another pose, at rest, and takes a tick, so that queries see it.

        Joints that are not given keep their positions and velocities.

        In a simulation that ssduck loaded, motors that hold joints then hold them at the new
        positions; in your own client, motors stay as you set them.

        Args:
            position: the position of the link frame, [x, y, z], m, world frame; None keeps it.
            orientation: the orientation of the link frame, world frame: a quaternion [w, x, y, z]
                of any length but 0, or a `Rotation` of SciPy; None keeps it. PyBullet's quaternions
                are [x, y, z, w]: in a world of PyBullet, a warning tells of each list that is not
                the present `orientation` of an entity; elsewhere, of one that is probably of
                this order.
            joints: positions, rad or m: by the joint's name, or one for each revolute and
                prismatic joint in order. With joints alone, the body keeps its pose and its
                velocity.
            wxyz: in place of `orientation`: a quaternion [w, x, y, z], without the warning.
            xyzw: in place of `orientation`: a quaternion [x, y, z, w], as PyBullet has them.
            **others: none; an error says what to write for other names.

        Raises:
            StateError: a number is not finite, the orientation is all 0, or a joint is beyond
                its limits.
            UnknownNameError: no joint has a name; the error suggests the nearest names.
            ArgumentError: the entity is a sensor, a joint's position is not one number, there
                are too many or too few values, or the orientation is given twice.
            RemovedEntityError: the entity is no longer in its world.
            UnsupportedError: the entity is in a what-if world.
        """
        arguments = ("position", "orientation", "joints", "wxyz", "xyzw")
        validation.no_others(others, "move", arguments, _OF_MOVE)
        pose = None
        given = (position, orientation, wxyz, xyzw)
        if joints is None or any(value is not None for value in given):
            position = self.position if position is None else position
            is_pybullet = self.world.simulator.backend == DEFAULT_BACKEND
            known = (entity.orientation for entity in self.world) if is_pybullet else None
            pose = (
                validation.finite_array(position, 3, f"{self.name}: position"),
                orientation_of(orientation, wxyz, xyzw, self.orientation, self.name, known),
            )
        with self.changed("move") as (simulator, body):
            values = {} if joints is None else joint_positions(joints, body, self.name)
            if pose is not None:
                simulator.place(body, *pose)
            if values:
                simulator.set_joints(body, values)

    def drive(
        self,
        positions: JointValues | None = None,
        velocities: Mapping[str, float] | None = None,
        efforts: Mapping[str, float] | None = None,
    ) -> None:
        """Sets the targets of joint motors; they act in the following steps until set again.

        Nothing moves at once, and no tick is taken. Motors of joints that are not named keep
        their targets. `move` with joints makes motors hold the new positions, in a simulation
        that ssduck loaded.

        Args:
            positions: target positions, rad or m: by the joint's name, or one for each revolute
                and prismatic joint in order. Joints move no faster than their model allows.
            velocities: target velocities, rad/s or m/s, by the joint's name.
            efforts: the maximal efforts of these motors, N m or N, by the joint's name; by
                default what the joint's model allows.

        Raises:
            StateError: a number is not finite, a position is beyond the joint's limits, or a
                velocity or an effort is more than its model allows.
            UnknownNameError: no joint has a name; the error suggests the nearest names.
            ArgumentError: the entity is a sensor; a joint has both a position and a velocity, or
                an effort and neither; or there are too many or too few positions.
            RemovedEntityError: the entity is no longer in its world.
            UnsupportedError: the entity is in a what-if world.
        """
        with self._in_simulator("drive") as (simulator, body):
            motors = motor_targets(positions, velocities, efforts, body, self.name)
            simulator.drive(body, motors)

    def hold(self, other: Entity, link: str | Link | None = None, *, touching: int = 1) -> None:
        """Attaches another body that a link touches rigidly to that link, at their current poses.

        The attachment is a fixed constraint of the simulator between the link and the base of
        the other body. It models a grip that does not slip and is stronger than any friction.
        The method takes a tick to check that the bodies touch, and moves nothing. Saved worlds
        and excerpts keep the constraint.

        Args:
            other: the other body, of the same world.
            link: the holding link or its name; None for the base.
            touching: the minimal number of links within 1 mm of the other body, by the narrow
                phase: the holding link and the links that descend from it, such as fingers.

        Raises:
            StateError: fewer links are as near, or the other body is held already.
            UnknownNameError: no link has the name; the error suggests the nearest names.
            ArgumentError: one of them is a sensor, or the other one is of another world, or the
                same; or the link is of another entity.
            RemovedEntityError: one of them is no longer in its world.
            UnsupportedError: the entity is in a what-if world.
        """
        if isinstance(link, Link):
            if link.entity != self:
                raise ArgumentError(f"hold: {link!r} is no link of {self.name!r}")
            link = link.name
        touching = validation.integer(touching, "hold: touching", minimum=1)
        state = self.state
        with self._in_simulator("hold", other) as (simulator, body, held_body):
            number = 0 if link is None else link_index(body, link, self.name)
            if simulator.has_constraint(body, held_body):
                raise StateError(f"{self.name} holds {other.name} already")
            state.ticker.take()
            with state.pinned(("shapes", MARGINS)):
                shapes = state.snapshot.shapes().shapes_touching(
                    self.id, other.id, TOUCHING_DISTANCE
                )
            links = {body.shapes[shape].frame for shape in shapes}
            count = len(links & descendant_links(body, number))
            if count < touching:
                raise StateError(
                    f"{self.name} cannot hold {other.name}: {count} links of "
                    f"{body.links[number].name!r} and beyond are within {TOUCHING_DISTANCE:g} m of "
                    f"it, not {touching}; move them there first"
                )
            simulator.add_constraint(body, number, held_body)

    def release(self, other: Entity) -> None:
        """Releases a held body: removes the fixed constraints between links and its base.

        Args:
            other: the held body.

        Raises:
            StateError: the other body is not held.
            ArgumentError: one of them is a sensor, or the other one is of another world, or the
                same.
            RemovedEntityError: one of them is no longer in its world.
            UnsupportedError: the entity is in a what-if world.
        """
        with self._in_simulator("release", other) as (simulator, body, held_body):
            if not simulator.has_constraint(body, held_body):
                raise StateError(f"{self.name} does not hold {other.name}")
            simulator.remove_constraint(body, held_body)

    @property
    def enabled(self) -> bool:
        """Whether the body takes part in collisions; setting it takes a tick.

        Rays do not hit a disabled body either. PyBullet does not report collision filters, so a
        body that is enabled again has PyBullet's default filter.

        Raises:
            ArgumentError: the entity is a sensor.
            RemovedEntityError: the entity is no longer in its world.
            UnsupportedError: the entity is in a what-if world.
        """
        return bool(self.column("enabled"))

    @enabled.setter
    def enabled(self, on: bool) -> None:
        on = validation.boolean(on, "enabled")
        with self.changed("enable") as (simulator, body):
            simulator.enable(body, on)

    @property
    def visible(self) -> bool:
        """Whether the body is drawn; setting it takes a tick. A body shown again has its colours.

        Raises:
            ArgumentError: the entity is a sensor.
            RemovedEntityError: the entity is no longer in its world.
            UnsupportedError: the entity is in a what-if world.
        """
        return bool(self.column("visible"))

    @visible.setter
    def visible(self, on: bool) -> None:
        on = validation.boolean(on, "visible")
        with self.changed("show") as (simulator, body):
            simulator.show(body, on)

    @contextmanager
    def changed(self, verb: str) -> Iterator[tuple[Simulator, Body]]:
        """Yields the simulator and the body, to change it; takes a tick after that."""
        with self._in_simulator(verb) as (simulator, body):
            yield simulator, body
            self.state.snapshot.invalidate_static_poses()
            self.state.ticker.take()

    @contextmanager
    def _in_simulator(self, verb: str, *others: Entity) -> Iterator[tuple[Any, ...]]:
        """Yields the simulator, and the bodies of this entity and of others of its world."""
        state = self.state
        with state.lock:
            state.ticker.check_not_pinned()
            for other in others:
                if not isinstance(other, Entity) or other.world is not state:
                    raise ArgumentError(
                        f"{verb}: {other!r} is no entity of the world {state.name!r}"
                    )
                if other == self:
                    raise ArgumentError(f"{verb}: {self.name} cannot {verb} itself")
            registry, simulator = state.ticker.registry, state.simulator
            registry.update(simulator)  # another body may have the number of one by now
            bodies = []
            for entity in (self, *others):
                info = registry.get(entity.id)
                if info is None:
                    raise entity.removed()
                bodies.append(entity.body_of(info, verb))
            yield simulator, *bodies

    def body_of(self, info: EntityInfo, verb: str) -> Body:
        """Returns the body of the entity, on which an action is tried; a sensor has none."""
        if info.body is None:
            raise ArgumentError(f"{self.name} is a sensor; {verb} the body that it is mounted on")
        return info.body

    def _row(self) -> int:
        row = self.state.snapshot.rows.get(self.id)
        if row is None:
            raise self.removed()
        return row

    def _table(self, name: str) -> list[dict[str, Any]]:
        with self.state.lock:
            self._row()
            self.state.request_tables([name])
            self._row()  # the request may have taken a tick
            table = self.state.snapshot.tables[name]
            selected = table.arrow.filter(pa.array(table["entity"] == self.id))
            rows: list[dict[str, Any]] = selected.to_pylist()
        return rows

    def __repr__(self) -> str:
        return f"<{self.kind} {self.name!r}>"


class KinBody(Entity):
    """A handle of a body; as in OpenRAVE, robots are kinbodies, too."""

    __slots__ = ()


class Robot(KinBody):
    """A handle of a robot."""

    __slots__ = ()


class Sensor(Entity):
    """A handle of a sensor, with its last reading at its world's last tick.

    The sensor is read when its reading is requested, and again when its `period` has passed. A
    ray is a ray of a laser, a pixel of a camera (row by row from the upper left) or a contact
    point of a contact sensor. All arrays are read-only numpy arrays.
    """

    __slots__ = ()

    def power(self, on: bool) -> None:
        """Switches the sensor on or off; it perceives nothing while it is off."""
        state = self.state
        with state.lock:
            state.ticker.check_not_pinned()
            if self not in state:
                raise self.removed()
            on = validation.boolean(on, "power: on")
            if on != state.snapshot.sensing.is_on(self.id):
                state.snapshot.switch(self.id, on=on)

    @property
    def powered(self) -> bool:
        """Whether the sensor is switched on."""
        self._row()
        return self.state.snapshot.sensing.is_on(self.id)

    @property
    def reading(self) -> Reading | None:
        """The last reading; None while the sensor is switched off."""
        return self.state.reading(self)

    @property
    def rays(self) -> int:
        """The number of rays, pixels or contact points of the reading."""
        return self._measured("rays")  # type: ignore[no-any-return]

    @property
    def ranges(self) -> Array:
        """The length of each ray, m, (n,); inf for one that hits nothing within range."""
        return self._measured("ranges")  # type: ignore[no-any-return]

    @property
    def points(self) -> Array:
        """The points that rays hit, [x, y, z] in the world frame, m, (hits, 3)."""
        return self._measured("points")  # type: ignore[no-any-return]

    @property
    def depth(self) -> Array:
        """Of a camera, the depth along its axis, m, (height, width); inf for nothing."""
        return self._measured("depth")  # type: ignore[no-any-return]

    @property
    def segmentation(self) -> Indices:
        """Of a camera, the id of the entity in each pixel, (height, width); 0 for none."""
        return self._measured("segmentation")  # type: ignore[no-any-return]

    @property
    def image(self) -> npt.NDArray[np.uint8]:
        """Of a camera, the picture: red, green, blue, (height, width, 3), from 0 to 255.

        It shows all visible bodies, including the sensor's own and those out of range.
        """
        return self._measured("image")  # type: ignore[no-any-return]

    @property
    def forces(self) -> Array:
        """Of a contact sensor, the normal force at each contact point, N, (n,)."""
        return self._measured("forces")  # type: ignore[no-any-return]

    def _measured(self, quantity: str) -> Any:
        is_picture = quantity == "image" and SENSOR_TYPES[self.spec.type].has_picture
        reading = self.state.reading(self, picture=is_picture)
        if reading is None:
            raise SelectScriptError(
                f"{self.name!r} measures nothing: it is switched off, or nowhere; "
                "power(True) switches it on"
            )
        value = getattr(reading, quantity)
        if value is None:
            names = ", ".join(k for k, v in vars(reading).items() if isinstance(v, np.ndarray))
            raise ArgumentError(f"{self.name!r} is a {self.spec.type}: no {quantity}, but {names}")
        return value

    @property
    def host(self) -> int:
        """The id of the body that the sensor is mounted on."""
        info = self.state.snapshot.entities[self._row()]
        return info.mount[0]

    @property
    def spec(self) -> SensorSpec:
        """The specification of the sensor: type, settings and mounting."""
        spec = self.state.snapshot.entities[self._row()].sensor
        assert spec is not None
        return spec


# The classes of handles, by the kind of the entity.
HANDLES: dict[Kind, type[Entity]] = {"robot": Robot, "kinbody": KinBody, "sensor": Sensor}
