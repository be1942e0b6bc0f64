"""Defines `World`, a simulation in any simulator.

A *world* is one simulation; an *entity* is a robot, a kinbody or a sensor of it. The properties of
an entity are those at the world's last tick, not those of the simulator at present.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, Never, TypeVar

import numpy as np
import numpy.typing as npt

from ssduck import validation
from ssduck.errors import (
    ArgumentError,
    SelectScriptError,
    UnknownNameError,
    UnsupportedError,
)
from ssduck.formatting import contents_of, past_path, past_query, short_repr
from ssduck.geometry.arrays import Indices
from ssduck.schema import (
    LINK_FACTOR,
    MARGINS,
    MASSES,
    ON_DEMAND,
    RECORDED_BY_DEFAULT,
    entity_of,
    link_of,
)
from ssduck.simulators.interface import Body, Simulator
from ssduck.simulators.kinematics import (
    JointValues,
    joint_positions,
    parse_pose,
)
from ssduck.simulators.naming import is_made_up
from ssduck.simulators.scenes import Camera, SensorSpec, variable_name
from ssduck.world.construction import UNNAMED, ConstructibleWorld
from ssduck.world.entities import HANDLES, Entity, Sensor
from ssduck.world.entity_registry import no_entity_error, told_of_part
from ssduck.world.excerpt import excerpt, new_folder, posed, scene_of, write_scene
from ssduck.world.handles import Handle, Link, links_and_sites_of
from ssduck.world.manipulation import ManipulableSimulation
from ssduck.world.pictures import framing_camera
from ssduck.world.public_names import INSTEAD_IN_WORLDS, WORLD_INTERNALS, PublicNames
from ssduck.world.running import run
from ssduck.world.sensor_readings import Reading
from ssduck.world.snapshot import Snapshot
from ssduck.world.what_if import what_if_tick

T = TypeVar("T")


class World(ConstructibleWorld, ManipulableSimulation, PublicNames):
    """A simulation and its current tick.

    Use `World.load` or `World.attach` to make one. Every `step` and `tick` replaces the tables
    at once; nothing changes them in between.

    Args:
        simulator: the simulator.
        name: the name until the world is bound to a variable.
        sensors: the sensors on its bodies, in load order.
        camera: its camera; None for one that frames what is small and moves.
    """

    INTERNAL_NAMES, INSTEAD_OF = WORLD_INTERNALS, INSTEAD_IN_WORLDS

    def __init__(
        self,
        simulator: Simulator,
        *,
        name: str = UNNAMED,
        sensors: Sequence[SensorSpec] = (),
        camera: Camera | None = None,
    ) -> None:
        self._begin(name, camera or Camera())
        self._set_state(simulator, Snapshot())
        self._registry.add_all(simulator, sensors)
        for info in self._registry.entities:
            if info.sensor is not None and not info.sensor.powered:
                self.snapshot.switch(info.id, on=False)
        with self.lock:
            # So a recording with these tables begins without a second tick of the same time.
            self.snapshot.recorded = ON_DEMAND.intersection(RECORDED_BY_DEFAULT)
            self._take_tick()
            self._read_recorded()

    def _begin(self, name: str, camera: Camera) -> None:
        self._camera = None if camera == Camera() else camera
        self._framed: tuple[Any, Camera] | None = None
        self._init_ticking(name)
        self._origin: World | None = None

    @property
    def camera(self) -> Camera:
        """The camera of pictures, of films and of the page; it may be set.

        By default, it is that of the scene. Without one, it frames what is small and moves at the
        first picture, and again when there are other bodies.
        """
        if self._camera is not None:
            return self._camera
        bodies = tuple(info.id for info in self.snapshot.entities)
        if self._framed is None or self._framed[0] != bodies:
            self._framed = bodies, framing_camera(self.snapshot)
        return self._framed[1]

    @camera.setter
    def camera(self, camera: Camera | None) -> None:
        validation.instance(camera, Camera, "camera")
        self._camera = camera

    # -- time -----------------------------------------------------------------------------

    def run(
        self,
        seconds: float,
        *,
        realtime: bool | float = False,
        progress: bool | Literal["always"] = False,
        every: int | None = 1,
        **others: Never,
    ) -> World:
        """Runs for a simulated time, and takes a tick after each step.

        With `every`, there are fewer ticks: after so many steps each, at the end, and when
        observers request them. A world that is neither recorded nor observed takes the last tick
        only, except in real time.

        Args:
            seconds: the simulated time, s, rounded to the nearest number of steps.
            realtime: whether to run in real time; or the speed relative to it: 2.0 takes half as
                long if the simulator is fast enough. A late run catches up. Such a run waits at
                ticks only.
            progress: whether to show a progress bar on standard error if that is a terminal;
                `"always"`: in any case.
            every: the number of steps between ticks; None for requested ticks and the last.
            **others: none; an error says what to write for other names.

        Returns:
            The world itself.

        Raises:
            ArgumentError: the time is negative or not finite, the speed is not above 0, or
                `every` is less than 1.
            SimulatorError: the simulator does not answer; the last tick remains.
            UnsupportedError: it is a what-if world.
            KeyboardInterrupt: Ctrl-C stopped the run, at a tick.
        """
        run([self], seconds, realtime=realtime, progress=progress, every=every, **others)
        return self

    def close(self) -> None:
        """Closes the simulation; a client that you created stays connected."""
        with self.lock:
            self._simulator.close()
            if self._finalizer is not None:
                self._finalizer.detach()

    def render(
        self,
        width: int = 960,
        height: int = 720,
        camera: Camera | None = None,
        *,
        shadow: bool = True,
    ) -> npt.NDArray[np.uint8]:
        """Returns a colour picture of the current simulation, (height, width, 3), 0 to 255.

        Args:
            width: the width in pixels, 1 to 8192.
            height: the height in pixels, 1 to 8192.
            camera: the camera; by default that of the world.
            shadow: whether bodies cast shadows.

        Raises:
            NumberError: the width or the height is no such number.
            UnsupportedError: it is a what-if world, or a recorded one.
        """
        width, height = validation.picture_size(width, height, "render")
        shadow = validation.boolean(shadow, "render: shadow")
        with self.lock:
            return self._simulator.render(camera or self.camera, width, height, shadow=shadow)

    def segmentation(
        self,
        width: int = 960,
        height: int = 720,
        camera: Camera | None = None,
        *,
        links: bool = False,
    ) -> Indices:
        """Returns the entity's id for each pixel of that picture, (height, width); 0 for none.

        Args:
            width: pixels.
            height: pixels.
            camera: the camera; None for that of the world.
            links: whether the ids are those of links, as in the table `links`.
        """
        width, height = validation.picture_size(width, height, "segmentation")
        links = validation.boolean(links, "segmentation: links")
        with self.lock:
            handles, numbers = self._simulator.segment(camera or self.camera, width, height)
            ids = np.zeros(int(handles.max(initial=-1)) + 2, dtype=np.intp)
            for info in self._registry.entities:
                if info.body is not None and info.body.handle < len(ids) - 1:
                    ids[info.body.handle] = info.id
        entities = ids[handles]  # -1 stands for no body, and takes the last element
        return np.where(entities, (numbers + 1) * LINK_FACTOR + entities, 0) if links else entities

    # -- what if --------------------------------------------------------------------------

    def what_if(
        self,
        poses: Mapping[str | Entity, Sequence[float]] | None = None,
        joints: Mapping[str | Entity, JointValues] | None = None,
    ) -> World:
        """Returns the world of this tick with some bodies elsewhere, without the simulator.

        The what-if world has the same entities, with the same ids and names, and the same time
        and tick. It is queried like any other world, and never changes. Moved bodies are at rest,
        but joints that are not given keep their velocities; sensors move with their bodies.
        Since it is not simulated, it has no contacts (requesting them is an error), joint efforts
        are unknown, and it can neither be stepped nor drawn.

        Args:
            poses: the poses of link frames by entity: orientation, then position, [w, x, y, z,
                x, y, z], as `Entity.pose`, world frame; the orientation of any length but 0.
            joints: the positions of joints by entity, rad or m: by the joint's name, or one for
                each revolute and prismatic joint in order. Other joints keep their positions.

        Raises:
            UnknownNameError: no entity or joint has a name; the error suggests the nearest names.
            StateError: a number is not finite, an orientation is all 0, or a joint is beyond
                its limits.
            ArgumentError: an entity is a sensor or of another world, a joint's position is not
                one number, or there are too many or too few values.
            RemovedEntityError: an entity is no longer in this world.
        """
        has_links = any(m.body and m.body.joints for m in self.snapshot.entities)
        with self.pinned((MASSES, MARGINS, *(("links", "joints") if has_links else ()))):
            body_poses = {
                body: parse_pose(pose, name) for name, body, pose in self._bodies_of(poses or {})
            }
            positions = {
                body: joint_positions(values, body, name)
                for name, body, values in self._bodies_of(joints or {})
            }
            simulator, snapshot = what_if_tick(self.snapshot, body_poses, positions)
        return World.of_tick(simulator, snapshot, self.camera, self.origin)

    @staticmethod
    def of_tick(
        simulator: Simulator, snapshot: Snapshot, camera: Camera, origin: World | None = None
    ) -> World:
        """Returns the world of a single tick, which never changes.

        Args:
            simulator: a simulator in which nothing moves.
            snapshot: the tick to be taken from it.
            camera: the camera of the world.
            origin: the world from which it derives.
        """
        world = World.__new__(World)
        world._begin(UNNAMED, camera)  # noqa: SLF001  # one class
        world._set_state(simulator, snapshot)  # noqa: SLF001
        world._origin = origin  # noqa: SLF001
        return world.tick()

    def _bodies_of(self, by_entity: Mapping[str | Entity, T]) -> Iterator[tuple[str, Body, T]]:
        """Yields the name, the body and the value of each entity."""
        for key, value in by_entity.items():
            entity = key if isinstance(key, Entity) else self[key]
            if entity.world is not self:
                raise ArgumentError(
                    f"{entity!r} is in world {entity.world.name!r}, not in {self.name!r}; "
                    "give its name"
                )
            row = self.snapshot.rows.get(entity.id)
            if row is None:
                raise entity.removed()
            yield entity.name, entity.body_of(self.snapshot.entities[row], "move"), value

    # -- copies ---------------------------------------------------------------------------

    @property
    def origin(self) -> World:
        """The world from which a what-if or past world derives; else the world itself."""
        return self if self._origin is None else self._origin

    @property
    def simulator(self) -> Simulator:
        """The simulator of the world."""
        return self._simulator

    def excerpt(self, entities: Iterable[str | Entity]) -> World:
        """Returns a new, running world with copies of some entities as they are at this tick.

        The new world has a simulation of its own, which starts at the same simulated time;
        its entities have the same names. docs/reference/result-forms.md lists what is copied, and
        what a simulator does not report.

        Args:
            entities: entities of this world, or their names; with a sensor, its body is copied,
                too. No entities make an empty world with the same settings.

        Raises:
            UnknownNameError: no entity has a name; the error suggests the nearest names.
            ArgumentError: an entity is of another world.
            RemovedEntityError: an entity is not in the world at this tick.
            SimulatorError: the simulator does not answer, or has no room for another.
            UnsupportedError: a body is soft.
        """
        # Nothing may move while it is read, neither in this world nor in its origin.
        # In an attached world, a new tick for the joints could differ from this one.
        tables = () if self._simulator.is_external else ("joints",)
        with self.pinned(tables), self.origin.lock:
            ids = {self._id_of(entity) for entity in entities}
            simulator, sensors = excerpt(self.snapshot, ids, self.origin.simulator)
        return World.owning(simulator, self.name, sensors, self.camera)

    def posed(self) -> World:
        """Returns a copy of all bodies as they are at this tick, to be drawn."""
        tables = () if self._simulator.is_external else ("joints",)
        with self.pinned(tables), self.origin.lock:
            simulator = posed(self.snapshot, self.origin.simulator)
        return World.owning(simulator, self.name, [], self.camera)

    def _id_of(self, entity: str | Entity) -> int:
        """Returns the id of an entity of this world or of its origin."""
        if not isinstance(entity, Entity):
            return self[entity].id
        if entity.world not in (self, self.origin):
            raise ArgumentError(
                f"{entity!r} is in world {entity.world.name!r}, not in {self.name!r}"
            )
        if entity.id not in self.snapshot.rows:
            raise entity.removed()
        return entity.id

    def save(self, path: str | Path, simulator: str | None = None) -> Path:
        """Saves the world at this tick as a scene, which `ssduck.load` reads.

        For MuJoCo, the model is the file `world.xml` in MJCF, which MuJoCo also loads by itself.
        The key `ssduck` in it is the state at the tick. What a world of PyBullet has and MJCF has
        not is named by a warning.

        Args:
            path: a new or empty folder for the file `scene.toml` and the models.
            simulator: the simulator to load it with: `"mujoco"` also for a world of PyBullet; by
                default that of the world.

        Returns:
            The path of the scene's file.

        Raises:
            SceneError: the folder is not empty, or something cannot be written.
            UnknownNameError: there is no such simulator; with the nearest names.
            UnsupportedError: the model of a MuJoCo world is not known as MJCF, or is to be saved
                for PyBullet.
        """
        folder = Path(path)
        with new_folder(folder):
            # The copy is an ordinary world, also of a past, what-if or attached one.
            copy = self.excerpt(self)
            try:
                with copy.pinned(("joints",)):
                    scene = scene_of(
                        copy.snapshot, copy.simulator, folder, simulator or copy.simulator.backend
                    )
            finally:
                copy.close()
            scene = replace(scene, name=variable_name(self.name), camera=self._camera or Camera())
            return write_scene(scene, folder)

    # -- entities -------------------------------------------------------------------------

    def __iter__(self) -> Iterator[Entity]:
        """Iterates over the entities: sensors first, then bodies, each in load order."""
        return map(self.entity, [info.id for info in self.snapshot.entities])

    def __len__(self) -> int:
        return len(self.snapshot.entities)

    def __contains__(self, thing: object) -> bool:
        """Checks whether the world has an entity, given by its name or its handle."""
        if isinstance(thing, Entity):
            return thing.world is self and thing.id in self.snapshot.rows
        return any(info.name == thing for info in self.snapshot.entities)

    def __getitem__(self, name: str) -> Entity:
        """Returns the entity of a name.

        Raises:
            UnknownNameError: no entity has the name; the error suggests the nearest names.
            ArgumentError: it is the handle of a link.
        """
        if isinstance(name, Link):
            raise ArgumentError(f"{name!r} is a link, no entity; .entity is its entity")
        for info in self.snapshot.entities:
            if info.name == name:
                return self.entity(info.id)
        raise no_entity_error(self.name, name, self.snapshot.entities, self.removal_of(name))

    def removal_of(self, name: str) -> str:
        """Returns when an entity of a name was removed, for an error; '' if none was."""
        time = self._registry.removed.get(name)
        if time is None:
            return ""
        return (
            f"it was removed at {time:g} s; where it is recorded, "
            f"{past_path(self.name, name)} is that of an earlier time, and functions of time take "
            f"it from a query, as {past_query(self.name, name, time - self.timestep / 2)}"
        )

    def part_hint(self, name: str) -> str:
        """The hint of an error for a name: what of the world has it; "" if nothing has."""
        return told_of_part(self.name, name, self.snapshot.entities)

    def entity(self, id: int) -> Entity:
        """Returns the handle of a present entity by its id.

        Raises:
            UnknownNameError: no entity has the id.
        """
        row = self.snapshot.rows.get(id) if validation.is_integer(id) else None
        if row is None:
            raise UnknownNameError(f"world {self.name!r} has no entity of the id {short_repr(id)}")
        info = self.snapshot.entities[row]
        return HANDLES[info.kind](self, id, info.name, info.kind)

    def handle(self, id: int) -> Handle:
        """Returns the handle of a present entity or of a link of one, by its id."""
        if id < LINK_FACTOR:
            return self.entity(id)
        return links_and_sites_of(self.entity(entity_of(id)))[link_of(id)]

    def __repr__(self) -> str:
        contents = contents_of([(entity.name, entity.kind) for entity in self])
        names = dict.fromkeys(entity.name for entity in self) if self.is_attached else {}
        unclear = next((name for name in names if is_made_up(name, names)), None)
        hint = f"; World.attach(…, names=…) names {unclear}" if unclear else ""
        return f"<World {self.name!r}: {contents}, t={self.time:g} s{hint}>"

    def _repr_png_(self) -> bytes | None:
        """Returns a picture for notebooks; None if the world cannot be rendered."""
        from ssduck.world.pictures import png

        try:
            return png(self)
        except SelectScriptError:  # its simulation is closed, say; the text is shown then
            return None

    # -- sensors --------------------------------------------------------------------------

    def add_sensor(
        self,
        type: str,
        on: str | Entity | Link,
        name: str | None = None,
        link: str | None = None,
        *,
        position: Sequence[float] = (0.0, 0.0, 0.0),
        orientation: Sequence[float] = (1.0, 0.0, 0.0, 0.0),
        **settings: float,
    ) -> Sensor:
        """Adds a sensor on a body, and takes a tick.

        Args:
            type: one of `ssduck.simulators.sensor_types.SENSOR_TYPES`.
            on: the body or its name, or one of its links. The sensor does not perceive this body.
            name: the name, unique in the world; by default made of the names of body and type.
            link: the link that the sensor is mounted on; by default the base.
            position: the position in the frame of the link, m.
            orientation: the orientation in the frame of the link, w, x, y, z; the sensor looks
                along its own +x, with z up.
            **settings: `max_range` (m), the settings of the type, `period` (seconds between two
                measurements; 0: one at each tick) and `powered` (whether it is switched on).

        Returns:
            The handle of the sensor.

        Raises:
            UnknownNameError: no body or link has the name; the error suggests the nearest names.
            ArgumentError: a setting is wrong.
            RemovedEntityError: the body is no longer in the world.
        """
        with self.lock:
            self._check_not_pinned()
            self._registry.update(self._simulator)
            if isinstance(on, Link) and link is None:
                on, link = on.entity, on.name
            if isinstance(on, Handle) and on.world is not self:
                raise ArgumentError(f"add_sensor: on: {on.name!r} is of another world")
            host = self._registry.host(on, self.name)
            values = {
                **({} if link is None else {"link": link}),
                **_plain({"position": position, "orientation": orientation, **settings}),
            }
            info = self._registry.add_sensor(type, host, name, values)
            assert info.sensor is not None
            self.snapshot.switch(info.id, on=info.sensor.powered)
            self._take_tick()
            sensor = self.entity(info.id)
        assert isinstance(sensor, Sensor)
        return sensor

    def remove_sensor(self, sensor: str | Sensor) -> None:
        """Removes a sensor, and takes a tick.

        Args:
            sensor: the sensor or its name.

        Raises:
            UnknownNameError: no sensor has the name; the error suggests the nearest names.
            ArgumentError: the entity is no sensor.
            RemovedEntityError: the sensor is no longer in the world.
        """
        with self.lock:
            self._check_not_pinned()
            entity = sensor if isinstance(sensor, Entity) else self[sensor]
            if entity not in self:
                raise entity.removed()
            if not isinstance(entity, Sensor):
                raise ArgumentError(f"{entity.name!r} is a {entity.kind}, no sensor")
            self._registry.remove(entity.id, self.time)
            self._take_tick()

    def switch(self, sensor: Sensor, *, on: bool) -> None:
        """Switches a sensor on or off; see `Sensor.power`."""
        with self.lock:
            self._check_not_pinned()
            if sensor not in self:
                raise sensor.removed()
            on = validation.boolean(on, "power: on")
            if on != self.snapshot.sensing.is_on(sensor.id):
                self.snapshot.switch(sensor.id, on=on)

    def reading(self, sensor: Sensor, *, picture: bool = False) -> Reading | None:
        """Returns the last reading of a sensor, with a picture if requested; None if it is off."""
        with self.lock:
            if sensor not in self:
                raise sensor.removed()
            if self.snapshot.request_sensor(sensor.id, picture=picture):
                self._take_requested()
                if sensor not in self:  # its body was removed
                    raise sensor.removed()
            return self.snapshot.sensing.readings.get(sensor.id)

    # -- bodies ---------------------------------------------------------------------------

    def remove(self, entity: str | Entity) -> None:
        """Removes an entity with the sensors on it from a world that ssduck loaded; takes a tick.

        Args:
            entity: the entity or its name.

        Raises:
            UnknownNameError: no entity has the name; the error suggests the nearest names.
            RemovedEntityError: the entity is no longer in its world.
            UnsupportedError: the world is attached (remove the body in your client, and the next
                tick sees it), or it is a what-if world.
        """
        handle = entity if isinstance(entity, Entity) else self[entity]
        if isinstance(handle, Sensor):
            self.remove_sensor(handle)
            return
        if self._simulator.is_external:
            raise UnsupportedError(
                f"{handle.name!r} is in a client of yours: remove it there, and the next tick sees "
                "it; or take an excerpt, and remove it from that"
            )
        self._change(handle, "remove", self._simulator.remove)


def _plain(value: Any) -> Any:
    """Converts numpy values to Python's and sequences to lists; returns other values unchanged."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    is_list = isinstance(value, Sequence) and not isinstance(value, str)
    return [_plain(part) for part in value] if is_list else value
