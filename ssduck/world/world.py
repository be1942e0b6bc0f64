"""What a simulation is, whichever simulator runs it: `World`.

A *world* is one simulation; an *entity* is a robot, a kinbody or a sensor of it. What an entity
tells of itself is of the world's last tick, never of the simulator's present.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt

from ssduck import validation
from ssduck.errors import (
    ArgumentError,
    SceneError,
    UnknownNameError,
    UnsupportedError,
    nearest,
)
from ssduck.formatting import short_repr
from ssduck.geometry.arrays import Indices
from ssduck.schema import MARGINS, MASSES
from ssduck.simulators.backends import ShapesByBody, backend
from ssduck.simulators.interface import DEFAULT_BACKEND, Body, Kind, Simulator
from ssduck.simulators.kinematics import (
    JointValues,
    joint_positions,
    parse_pose,
)
from ssduck.simulators.scenes import Camera, Scene, SensorSpec, variable_name
from ssduck.world.entities import HANDLES, Entity, Sensor
from ssduck.world.excerpt import excerpt
from ssduck.world.manipulation import ManipulableSimulation
from ssduck.world.openrave_names import OpenRaveWorld
from ssduck.world.running import run
from ssduck.world.scene_export import new_folder, scene_of, write_scene
from ssduck.world.sensor_readings import Reading
from ssduck.world.snapshot import Snapshot
from ssduck.world.what_if import what_if_tick

T = TypeVar("T")

# What a world is called before it gets a name.
UNNAMED = "world"


class World(ManipulableSimulation, OpenRaveWorld):
    """One simulation and its current tick.

    Use `World.load` or `World.attach` to make one. Every `step` and `tick` replaces the tables
    at once; in between nothing changes them.

    Args:
        simulator: what runs it.
        name: what the world is called until it is bound to a variable.
        sensors: the sensors on its bodies, in load order.
        camera: the view that `render` draws if it is given none.
    """

    def __init__(
        self,
        simulator: Simulator,
        *,
        name: str = UNNAMED,
        sensors: Sequence[SensorSpec] = (),
        camera: Camera | None = None,
    ) -> None:
        self._begin(simulator, Snapshot(), name, camera or Camera())
        self._registry.begin(simulator, sensors)
        for info in self._registry.entities:
            if info.sensor is not None and not info.sensor.powered:
                self.snapshot.switch(info.id, on=False)
        with self.lock:
            self._take_tick()

    def _begin(self, simulator: Simulator, snapshot: Snapshot, name: str, camera: Camera) -> None:
        self.camera = camera
        self._init_ticking(simulator, snapshot, name)
        self._origin: World | None = None

    @classmethod
    def load(cls, scene: Scene, *, simulator: str = DEFAULT_BACKEND) -> World:
        """A world made from a scene in a simulation of its own.

        Args:
            scene: the scene.
            simulator: the name of the simulator that runs it; see `BACKENDS`.

        Raises:
            SceneError: the scene cannot be loaded: file, key and reason.
            ArgumentError: `scene` is no `Scene`.
        """
        if not isinstance(scene, Scene):
            raise ArgumentError(
                f"load: {short_repr(scene)} is no Scene; find_scene of ssduck.simulators reads one"
            )
        running = backend(simulator).load(scene)
        try:
            return cls.owning(running, scene.name, scene.sensors, scene.camera)
        except SceneError as error:
            message = f"{scene.path}: {error.message}"
            raise SceneError(message, suggestions=error.suggestions) from error

    @classmethod
    def owning(
        cls, simulator: Simulator, name: str, sensors: Sequence[SensorSpec], camera: Camera
    ) -> World:
        """A world of a simulation that nobody else has: it is closed with its last handle."""
        try:
            world = cls(simulator, name=name, sensors=sensors, camera=camera)
        except BaseException:
            simulator.close()
            raise
        # A simulation takes tens of megabytes.
        weakref.finalize(world, simulator.close)
        return world

    @classmethod
    def attach(
        cls,
        client: Any,
        names: Mapping[int, str] | None = None,
        kinds: Mapping[int, Kind] | None = None,
        *,
        name: str = UNNAMED,
        shapes: ShapesByBody | None = None,
        simulator: str = DEFAULT_BACKEND,
    ) -> World:
        """A world around a PyBullet client that you made and go on using.

        Bodies that you add, remove or move are seen at the next `tick()`. Each body gets a
        piece of PyBullet user data, by which a removed body is told from the next one of the
        same number. Simulated time begins at 0. It goes on by the client's time step with each
        `tick()`, which stands for a step of yours, and with each step that `step` and `run` run.

        Args:
            client: the client's number, or an object that holds it as `_client`.
            names: names by PyBullet body number of bodies that are there now; others are named
                as in their models, made unique.
            kinds: `"robot"` or `"kinbody"` by such a number; by default what has movable joints
                is a robot.
            name: what the world is called until it is bound to a variable.
            shapes: collision shapes of bodies that are there now, instead of what PyBullet tells
                of them: of a body's base by its number, of a link by (body, link), of one of its
                shapes by (body, link, number), links by PyBullet's numbers (the base is -1). Each
                is a mesh in the frame of the link, metres, or a list of meshes: a
                `trimesh.Trimesh`, (vertices (n, 3), faces (m, 3)), or the path of a mesh file;
                faces of None make the convex hull. See `ssduck.height_field`.
            simulator: the name of the simulator that the client is of; see `BACKENDS`.

        Raises:
            SimulatorError: the client is not connected.
            SelectScriptError: a number is no body's, or a kind is none of these.
            ArgumentError: a key of `shapes` is no shape's, or a value is no mesh.
        """
        return cls(backend(simulator).attach(client, names, kinds, shapes), name=name)

    # -- time -----------------------------------------------------------------------------

    def run(
        self,
        seconds: float,
        *,
        realtime: bool | float = False,
        progress: bool | Literal["always"] = False,
        every: int | None = None,
    ) -> World:
        """Run for so much simulated time, then take a tick; others where followers want them.

        Args:
            seconds: rounded to the nearest number of steps.
            realtime: whether it takes as long by the clock on the wall; or how many times as
                fast that is to be: 2.0 takes half as long, if the simulator can. A run that is
                late makes up for it. It takes a tick 30 times a second of the clock, unless
                `every` says otherwise, and waits at ticks only.
            progress: whether a bar tells how far it is, on standard error if that is a
                terminal; `"always"`: on any.
            every: takes a tick each so many steps.

        Raises:
            ArgumentError: a time is negative or not finite, a speed is not above 0, `every` is
                less than 1.
            SimulatorError: the simulator does not answer; the last tick stays.
            UnsupportedError: it is a what-if world.
            KeyboardInterrupt: it was stopped by Ctrl-C, at a tick.
        """
        run([self], seconds, realtime=realtime, progress=progress, every=every)
        return self

    def close(self) -> None:
        """Give up the simulation; a client that you made stays connected."""
        with self.lock:
            self._simulator.close()

    def render(
        self,
        width: int = 960,
        height: int = 720,
        camera: Camera | None = None,
        *,
        shadow: bool = True,
    ) -> npt.NDArray[np.uint8]:
        """A colour picture of the simulation as it is now, (height, width, 3).

        Args:
            width: pixels, 1 to 8192.
            height: pixels, 1 to 8192.
            camera: what it is seen by; by default the scene's.
            shadow: whether things throw shadows.

        Raises:
            NumberError: the width or the height is no such number.
            UnsupportedError: it is a what-if world, or a recorded one.
        """
        width, height = validation.picture_size(width, height, "render")
        shadow = validation.boolean(shadow, "render: shadow")
        with self.lock:
            return self._simulator.render(camera or self.camera, width, height, shadow=shadow)

    def segmentation(
        self, width: int = 960, height: int = 720, camera: Camera | None = None
    ) -> Indices:
        """What each pixel of that picture shows, (height, width): an entity's id; 0 for nothing."""
        width, height = validation.picture_size(width, height, "segmentation")
        with self.lock:
            seen = self._simulator.segment(camera or self.camera, width, height)
            ids = np.zeros(int(seen.max(initial=-1)) + 2, dtype=np.intp)
            for info in self._registry.entities:
                if info.body is not None and info.body.handle < len(ids) - 1:
                    ids[info.body.handle] = info.id
        return ids[seen]  # nothing is -1: the last one

    # -- what if --------------------------------------------------------------------------

    def what_if(
        self,
        poses: Mapping[str | Entity, Sequence[float]] | None = None,
        joints: Mapping[str | Entity, JointValues] | None = None,
    ) -> World:
        """The world of this tick with some bodies elsewhere; the simulator is not touched.

        It has the same entities, of the same ids and names, the same time and tick, and is
        queried like any other. It never changes, whatever this world does later. What is moved
        is at rest, but joints that are not given are as fast as they were, and sensors move with
        what they sit on. It was not simulated, so that it has no contacts (asking for them is an
        error), the efforts of joints are unknown, and it can neither be stepped nor drawn.

        Args:
            poses: of link frames in the world by entity: orientation, then position, [w, x, y,
                z, x, y, z], as `Entity.pose`; the orientation of any length but 0.
            joints: positions by entity, rad or m: by the joint's name, or one for each
                revolute and prismatic joint in order. The others stay as they are.

        Raises:
            UnknownNameError: there is no entity or no joint of a name, with the nearest names.
            StateError: a number is not finite, an orientation is all 0, or a joint is beyond
                its limits.
            ArgumentError: an entity is a sensor or of another world, a joint's position is not
                one number, or there are too many values or too few.
            RemovedEntityError: an entity is no longer in this world.
        """
        has_links = any(m.body and m.body.joints for m in self.snapshot.entities)
        with self.pinned((MASSES, MARGINS, *(("links", "joints") if has_links else ()))):
            places = {
                body: parse_pose(pose, name) for name, body, pose in self._bodies_of(poses or {})
            }
            positions = {
                body: joint_positions(values, body, name)
                for name, body, values in self._bodies_of(joints or {})
            }
            posed, snapshot = what_if_tick(self.snapshot, places, positions)
        world = World.__new__(World)
        world._begin(posed, snapshot, UNNAMED, self.camera)  # noqa: SLF001  # one class
        world._origin = self.origin  # noqa: SLF001
        return world.tick()

    def _bodies_of(self, by_entity: Mapping[str | Entity, T]) -> Iterator[tuple[str, Body, T]]:
        """What is said of entities, with their names and what they are at this tick.

        Raises:
            UnknownNameError: there is no entity of a name, with the nearest names.
            ArgumentError: an entity is of another world, or no body.
            RemovedEntityError: an entity is no longer in the world.
        """
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
        """The world whose tick it is, if it is a what-if world or a past one; else itself."""
        return self if self._origin is None else self._origin

    @property
    def simulator(self) -> Simulator:
        """What runs it."""
        return self._simulator

    def excerpt(self, entities: Iterable[str | Entity]) -> World:
        """A new, running world of some entities as they are at this tick, independent of it.

        It is in a PyBullet simulation of its own, and begins at the same time; its entities have
        the same names. What is carried over, and what PyBullet does not tell, is listed in
        docs/reference/result-forms.md.

        Args:
            entities: entities of this world, or their names; a sensor brings the body that it
                sits on. None for an empty world of the same settings.

        Raises:
            UnknownNameError: there is no entity of a name, with the nearest names.
            ArgumentError: an entity is of another world.
            RemovedEntityError: an entity is not in the world at this tick.
            SimulatorError: the simulator does not answer, or has no room for another.
            UnsupportedError: a body is soft.
        """
        # Nothing is to move while it is read: neither here nor where the simulation is.
        # The tick of a client that others step cannot be taken anew for its joints.
        tables = () if self._simulator.is_external else ("joints",)
        with self.pinned(tables), self.origin.lock:
            chosen = {self._id_of(entity) for entity in entities}
            simulator, sensors = excerpt(self.snapshot, chosen, self.origin.simulator)
        return World.owning(simulator, self.name, sensors, self.camera)

    def _id_of(self, entity: str | Entity) -> int:
        """The id of an entity of this world, or of the one whose tick it is.

        Raises:
            UnknownNameError: there is none of that name, with the nearest names.
            ArgumentError: it is of another world.
            RemovedEntityError: it is not in the world at its tick.
        """
        if not isinstance(entity, Entity):
            return self[entity].id
        if entity.world not in (self, self.origin):
            raise ArgumentError(
                f"{entity!r} is in world {entity.world.name!r}, not in {self.name!r}"
            )
        if entity.id not in self.snapshot.rows:
            raise entity.removed()
        return entity.id

    def save(self, path: str | Path) -> Path:
        """Save the world as it is at this tick as a scene, that `ssduck.load` reads.

        Args:
            path: a folder that is not there yet, or is empty: it gets a `scene.toml`, and the
                models.

        Returns:
            The scene's file.

        Raises:
            SceneError: something is there already, or cannot be written.
        """
        folder = Path(path)
        with new_folder(folder):
            # A copy is a world that ssduck made, whatever it is of: a tick of the past, a client
            # that somebody else has, what would be if.
            copy = self.excerpt(self)
            try:
                with copy.pinned(("joints",)):
                    scene = scene_of(copy.snapshot, copy.simulator, folder)
            finally:
                copy.close()
            scene = replace(scene, name=variable_name(self.name), camera=self.camera)
            return write_scene(scene, folder)

    # -- entities -------------------------------------------------------------------------

    def __iter__(self) -> Iterator[Entity]:
        """The entities: sensors first, then bodies, each in load order."""
        return map(self.entity, [info.id for info in self.snapshot.entities])

    def __len__(self) -> int:
        return len(self.snapshot.entities)

    def __contains__(self, thing: object) -> bool:
        """Whether it has an entity of that name, or that entity."""
        if isinstance(thing, Entity):
            return thing.world is self and thing.id in self.snapshot.rows
        return any(info.name == thing for info in self.snapshot.entities)

    def __getitem__(self, name: str) -> Entity:
        """The entity of that name.

        Raises:
            UnknownNameError: there is none, with the nearest names.
        """
        for info in self.snapshot.entities:
            if info.name == name:
                return self.entity(info.id)
        known = [info.name for info in self.snapshot.entities]
        raise UnknownNameError(
            f"world {self.name!r} has no entity {name!r}", suggestions=nearest(name, known)
        )

    def entity(self, id: int) -> Entity:
        """The handle of an entity that is there, by its id.

        Raises:
            UnknownNameError: there is none of that id.
        """
        row = self.snapshot.rows.get(id) if validation.is_integer(id) else None
        if row is None:
            raise UnknownNameError(f"world {self.name!r} has no entity of the id {short_repr(id)}")
        info = self.snapshot.entities[row]
        return HANDLES[info.kind](self, id, info.name, info.kind)

    def __repr__(self) -> str:
        return f"<World {self.name!r}: {len(self)} entities, t={self.time:g} s>"

    # -- sensors --------------------------------------------------------------------------

    def add_sensor(
        self,
        type: str,
        on: str | Entity,
        name: str | None = None,
        link: str | None = None,
        *,
        position: Sequence[float] = (0.0, 0.0, 0.0),
        orientation: Sequence[float] = (1.0, 0.0, 0.0, 0.0),
        **settings: float,
    ) -> Sensor:
        """Put a sensor on a body, and take a tick.

        Args:
            type: one of `ssduck.simulators.sensor_types.SENSOR_TYPES`.
            on: the body, or its name. The sensor does not perceive it.
            name: unique in the world; made of the two above if it is not given.
            link: the link that it sits on; by default the base.
            position: in that link's frame, metres.
            orientation: in that link's frame, w, x, y, z; it looks along its own +x, with z up.
            **settings: `max_range` (m), those of its type, `period` (seconds between two
                measurements; 0: each tick is one) and `powered` (whether it is switched on).

        Raises:
            UnknownNameError: there is no such body or link, with the nearest names.
            ArgumentError: a setting is wrong.
            RemovedEntityError: the body is no longer in the world.
        """
        with self.lock:
            self._check_not_pinned()
            self._registry.update(self._simulator)
            if isinstance(on, Entity) and on.world is not self:
                raise ArgumentError(f"add_sensor: on: {on.name!r} is of another world")
            host = self._registry.host(on, self.name)
            values = {
                "position": _plain(position),
                "orientation": _plain(orientation),
                **({} if link is None else {"link": link}),
                **{key: _plain(value) for key, value in settings.items()},
            }
            info = self._registry.add_sensor(type, host, name, values)
            assert info.sensor is not None
            self.snapshot.switch(info.id, on=info.sensor.powered)
            self._take_tick()
            sensor = self.entity(info.id)
        assert isinstance(sensor, Sensor)
        return sensor

    def remove_sensor(self, sensor: str | Sensor) -> None:
        """Take a sensor off its body, and take a tick.

        Raises:
            UnknownNameError: there is no such sensor, with the nearest names.
            RemovedEntityError: it is no longer in the world.
        """
        with self.lock:
            self._check_not_pinned()
            entity = sensor if isinstance(sensor, Entity) else self[sensor]
            if entity not in self:
                raise entity.removed()
            if not isinstance(entity, Sensor):
                raise ArgumentError(f"{entity.name!r} is a {entity.kind}, no sensor")
            self._registry.remove(entity.id)
            self._take_tick()

    def switch(self, sensor: Sensor, *, on: bool) -> None:
        """Switch a sensor on or off; see `Sensor.power`."""
        with self.lock:
            self._check_not_pinned()
            if sensor not in self:
                raise sensor.removed()
            on = validation.boolean(on, "power: on")
            if on != self.snapshot.sensing.is_on(sensor.id):
                self.snapshot.switch(sensor.id, on=on)

    def reading(self, sensor: Sensor, *, picture: bool = False) -> Reading | None:
        """What a sensor measured last, with its colours if they are asked for; None if off."""
        with self.lock:
            if sensor not in self:
                raise sensor.removed()
            if self.snapshot.request_sensor(sensor.id, picture=picture):
                self._take_requested()
                if sensor not in self:  # its body went
                    raise sensor.removed()
            return self.snapshot.sensing.readings.get(sensor.id)

    # -- bodies ---------------------------------------------------------------------------

    def remove(self, entity: str | Entity) -> None:
        """Take an entity out of a world that ssduck made, with the sensors on it, and take a tick.

        Raises:
            UnknownNameError: there is no entity of that name, with the nearest names.
            RemovedEntityError: it is no longer in its world.
            UnsupportedError: the client is yours: remove the body there, and the next tick sees
                it; or it is a what-if world.
        """
        chosen = entity if isinstance(entity, Entity) else self[entity]
        if isinstance(chosen, Sensor):
            self.remove_sensor(chosen)
            return
        if self._simulator.is_external:
            raise UnsupportedError(
                f"{chosen.name!r} is in a client of yours: remove it there, and the next tick sees "
                "it; or take an excerpt, and remove it from that"
            )
        self._change(chosen, "remove", self._simulator.remove)


def _plain(value: Any) -> Any:
    """Numpy's numbers as Python's, and a sequence as a list; whatever else it is as it is."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    is_list = isinstance(value, Sequence) and not isinstance(value, str)
    return [_plain(part) for part in value] if is_list else value
