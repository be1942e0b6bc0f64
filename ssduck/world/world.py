"""Defines `World`, a simulation in any simulator.

A *world* is one simulation; an *entity* is a robot, a kinbody or a sensor of it. The properties of
an entity are those at the world's last tick, which its `ticker` took from the simulator.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from ssduck import validation
from ssduck.errors import (
    ArgumentError,
    SceneError,
    SelectScriptError,
    UnknownNameError,
    UnsupportedError,
)
from ssduck.formatting import contents_of, short_repr
from ssduck.geometry.arrays import Indices
from ssduck.lazy import service
from ssduck.schema import LINK_FACTOR, MARGINS, MASSES, entity_of, link_of
from ssduck.simulators.backends import ShapesByBody
from ssduck.simulators.interface import Body, Kind, Simulator
from ssduck.simulators.kinematics import JointValues, joint_positions, parse_pose
from ssduck.simulators.naming import is_made_up
from ssduck.simulators.scenes import Camera, Scene, SensorSpec
from ssduck.world.copies import excerpt, new_folder, posed, saved, what_if_tick
from ssduck.world.entities import HANDLES, Entity, Sensor
from ssduck.world.entity_registry import no_entity_error, told_of_part
from ssduck.world.handles import Handle, Link, links_and_sites_of
from ssduck.world.loading import attached, loaded
from ssduck.world.pictures import framing_camera, png
from ssduck.world.public_names import INSTEAD_IN_WORLDS, WORLD_INTERNALS, PublicNames
from ssduck.world.sensor_readings import Reading
from ssduck.world.stepping import SteppedWorld
from ssduck.world.ticking import UNNAMED, LiveTicker, Ticker


class World(SteppedWorld, PublicNames):
    """A simulation and its current tick.

    Use `World.load` or `World.attach` to make one. Every `step` and `tick` replaces the tables
    at once; nothing changes them in between.

    Args:
        simulator: the simulator; or what takes the ticks of a world that is there already.
        name: the name until the world is bound to a variable.
        sensors: the sensors on its bodies, in load order.
        camera: its camera; None for one that frames what is small and moves.
        origin: the world from which it derives.
    """

    INTERNAL_NAMES, INSTEAD_OF = WORLD_INTERNALS, INSTEAD_IN_WORLDS

    # Closes the simulator of a world that owns it.
    _finalizer: weakref.finalize[..., Self] | None = None

    def __init__(
        self,
        simulator: Simulator | Ticker,
        *,
        name: str = UNNAMED,
        sensors: Sequence[SensorSpec] = (),
        camera: Camera | None = None,
        origin: World | None = None,
    ) -> None:
        if not isinstance(simulator, Ticker):
            simulator = LiveTicker.begun(name, simulator, sensors)
        super().__init__(simulator)
        self._camera = None if camera == Camera() else camera
        self._framed: tuple[Any, Camera] | None = None
        self._origin = origin

    @classmethod
    def load(cls, scene: Scene, *, simulator: str | None = None) -> Self:
        """Loads a scene into a new simulation, and returns its world.

        Args:
            scene: the scene.
            simulator: the name of the simulator, see `BACKENDS`; by default MuJoCo, if it is
                installed, for an MJCF file by itself, and PyBullet for everything else; the one
                that is installed, if the other is not.

        Raises:
            SceneError: the scene cannot be loaded; the message has file, key and reason.
            ArgumentError: `scene` is no `Scene`.
            UnsupportedError: the simulator is not installed, or does not load such scenes.
        """
        simulation = loaded(scene, simulator)
        try:
            return cls.owning(simulation, scene.name, scene.sensors, scene.camera)
        except SceneError as error:
            error.message = f"{scene.path}: {error.message}"
            raise

    @classmethod
    def owning(
        cls, simulator: Simulator, name: str, sensors: Sequence[SensorSpec], camera: Camera
    ) -> Self:
        """Returns a world that owns its simulator, and closes it when the world is collected."""
        try:
            world = cls(simulator, name=name, sensors=sensors, camera=camera)
        except BaseException:
            simulator.close()
            raise
        # A simulation takes tens of megabytes.
        world._finalizer = weakref.finalize(world, simulator.close)
        return world

    @classmethod
    def attach(
        cls,
        client: Any,
        *data_names_kinds: Any,
        names: Mapping[Any, str] | None = None,
        kinds: Mapping[Any, Kind] | None = None,
        name: str = UNNAMED,
        shapes: ShapesByBody | None = None,
        simulator: str | None = None,
        forward: bool = False,
        camera: Camera | None = None,
    ) -> Self:
        """Returns a world around a simulation that you created and continue to use.

        `World.attach(client)` takes a PyBullet client, `World.attach(model, data)` a MuJoCo model
        with its data. The next `tick()` sees what you changed: bodies that you added, removed or
        moved, or a model that you made anew.

        A PyBullet client has no time: it begins at 0, and each `tick()`, which stands for one step
        of yours, advances it by the client's time step, as does each step of `step` and `run`.
        ssduck attaches user data to each body, to distinguish a removed body from a later one with
        the same number. In MuJoCo the time is that of the data. A new episode begins when the time
        has fallen, or the model is another one.

        Args:
            client: of PyBullet, the number of the client, or an object with this number as
                `_client`. Of MuJoCo, the model, an environment that has model and data, or a
                function that returns (model, data), which is called at each tick.
            *data_names_kinds: MuJoCo's data, if `client` is a model; then `names` and `kinds`.
            names: the names of present bodies. Of PyBullet by body number; other bodies are named
                as in their models, as identifiers, made unique. Of MuJoCo by the number or the name
                of the root body of an entity; others have MuJoCo's name of that.
            kinds: `"robot"` or `"kinbody"`, likewise; by default a body with movable joints is a
                robot.
            name: the name until the world is bound to a variable.
            shapes: for PyBullet, collision shapes of present bodies, which replace those that it
                reports: of a body's base by its number, of a link by (body, link), of one of its
                shapes by (body, link, number), with PyBullet's link numbers (the base is -1).
                Each is a mesh in the frame of the link, m, or a list of meshes: a
                `trimesh.Trimesh`, (vertices (n, 3), faces (m, 3)), or the path of a mesh file;
                faces of None make the convex hull. See `ssduck.height_field`.
            simulator: the name of the simulator, see `BACKENDS`; None to recognise it.
            forward: for MuJoCo, whether a tick has the poses and contacts at its time, which
                `qpos` tells, also of free joints. Those of the data, as code that reads `xpos`
                sees them, are of the beginning of the last step.
            camera: the camera of pictures, of films and of the page, a `Camera` of
                `ssduck.simulators.scenes`; by default one that frames what is small and moves.
                `world.camera = …` sets another one.

        Raises:
            SimulatorError: the client is not connected, or the object has no simulation that is
                known.
            SelectScriptError: no body has a number, or a kind is invalid.
            UnknownNameError: no body has a name; with the nearest names.
            ArgumentError: no shape has a key of `shapes`, or a value is no mesh; or two bodies have
                one name.
            UnsupportedError: MuJoCo is not installed.
        """
        given = client, *data_names_kinds
        simulation = attached(given, names, kinds, shapes, simulator, forward)
        return cls(simulation, name=name, camera=camera)

    @staticmethod
    def batch(model: Any, count: int, *, name: str = UNNAMED, history: int = 0) -> Any:
        """Returns many simulations of one model as one world, a `BatchWorld`, in its initial state.

        Programs are evaluated over all of them, the *environments*, at once: `ss.eval` returns an
        array with a value for each. `tick` takes their states, as arrays of any library.

        Args:
            model: a `mujoco.MjModel`; or a world whose bodies each environment has, for states
                from any other simulator.
            count: the number of environments, from 1 up.
            name: the name until the world is bound to a variable.
            history: the largest number of ticks whose states are kept in memory, for
                `Interpreter.export_batch`; older ones are dropped.

        Raises:
            SimulatorError: the object is no model that is known.
            UnsupportedError: MuJoCo is not installed.

        >>> import mujoco
        >>> import ssduck
        >>> ball = "<body name='ball'><freejoint/><geom size='0.1'/></body>"
        >>> text = f"<mujoco><worldbody>{ball}</worldbody></mujoco>"
        >>> with ssduck.Interpreter() as ss:
        ...     sim = ss["sim"] = ssduck.World.batch(mujoco.MjModel.from_xml_string(text), count=2)
        ...     _ = sim.tick(qpos=[[0, 0, 0.5, 1, 0, 0, 0], [0, 0, 1.5, 1, 0, 0, 0]], time=0.0)
        ...     ss.eval("z(sim.ball) > 1;").tolist()
        [False, True]
        """
        return service("batch")(model, count, name, history)

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

    def close(self) -> None:
        """Closes the simulation; a client that you created stays connected."""
        with self.lock:
            self.simulator.close()
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
            return self.simulator.render(camera or self.camera, width, height, shadow=shadow)

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
            handles, numbers = self.simulator.segment(camera or self.camera, width, height)
        entities = self.snapshot.layout.ids_of(handles)
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
            tick = what_if_tick(self.snapshot, body_poses, positions)
        return World(LiveTicker.of_tick(*tick), camera=self.camera, origin=self.origin)

    def _bodies_of(self, by_entity: Mapping[str | Entity, Any]) -> Iterator[tuple[str, Body, Any]]:
        for key, value in by_entity.items():
            entity = self._present(key, (self,), "; give its name")
            info = self.snapshot.entities[self.snapshot.rows[entity.id]]
            yield entity.name, entity.body_of(info, "move"), value

    def _present(self, entity: str | Entity, worlds: Iterable[World], advice: str = "") -> Entity:
        """Returns the handle of an entity, after checking that the world has it at this tick."""
        if not isinstance(entity, Entity):
            entity = self[entity]
        if entity.world not in worlds:
            other = f"{entity!r} is in world {entity.world.name!r}"
            raise ArgumentError(f"{other}, not in {self.name!r}{advice}")
        if entity.id not in self.snapshot.rows:
            raise entity.removed()
        return entity

    # -- copies ---------------------------------------------------------------------------

    @property
    def origin(self) -> World:
        """The world from which a what-if or past world derives; else the world itself."""
        return self if self._origin is None else self._origin

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
        tables = () if self.simulator.is_external else ("joints",)
        with self.pinned(tables), self.origin.lock:
            chosen = [self._present(entity, (self, self.origin)) for entity in entities]
            ids = {entity.id for entity in chosen}
            simulator, sensors = excerpt(self.snapshot, ids, self.origin.simulator)
        return World.owning(simulator, self.name, sensors, self.camera)

    def posed(self) -> World:
        """Returns a copy of all bodies as they are at this tick, to be drawn."""
        tables = () if self.simulator.is_external else ("joints",)
        with self.pinned(tables), self.origin.lock:
            simulator = posed(self.snapshot, self.origin.simulator)
        return World.owning(simulator, self.name, [], self.camera)

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
        # The copy is an ordinary world, also of a past, what-if or attached one.
        with (
            new_folder(path) as folder,
            closing(self.excerpt(self)) as copy,
            copy.pinned(("joints",)),
        ):
            tick = copy.snapshot, copy.simulator
            return saved(*tick, folder, simulator, self.name, self._camera)

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
        raise no_entity_error(self.name, name, self.snapshot.entities, self.ticker.removal_of(name))

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
        names = dict.fromkeys(entity.name for entity in self) if self.ticker.is_attached else {}
        unclear = next((name for name in names if is_made_up(name, names)), None)
        hint = f"; World.attach(…, names=…) names {unclear}" if unclear else ""
        return f"<World {self.name!r}: {contents}, t={self.time:g} s{hint}>"

    def _repr_png_(self) -> bytes | None:
        """Returns a picture for notebooks; None if the world cannot be rendered."""
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
        ticker = self.ticker
        with self.lock:
            ticker.check_not_pinned()
            ticker.registry.update(self.simulator)
            if isinstance(on, Link):
                if link is not None:
                    raise ArgumentError(
                        f"{on!r} is given with another link; give its entity with that"
                    )
                on, link = on.entity, on.name
            if isinstance(on, Entity):
                if on.world is not self:
                    raise ArgumentError(f"add_sensor: on: {on.name!r} is of another world")
                host = ticker.registry.get(on.id)
                if host is None:
                    raise on.removed()
            else:
                host = ticker.registry.host(on, self.name)
            pose = {"position": position, "orientation": orientation}
            mount = pose if link is None else {**pose, "link": link}
            info = ticker.registry.add_sensor(type, host, name, {**mount, **settings})
            assert info.sensor is not None
            self.snapshot.switch(info.id, on=info.sensor.powered)
            ticker.take()
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
            self.ticker.check_not_pinned()
            entity = self._present(sensor, (self, self.origin))
            if not isinstance(entity, Sensor):
                raise ArgumentError(f"{entity.name!r} is a {entity.kind}, no sensor")
            self.ticker.registry.remove(entity.id, self.time)
            self.ticker.take()

    def reading(self, sensor: Sensor, *, picture: bool = False) -> Reading | None:
        """Returns the last reading of a sensor, with a picture if requested; None if it is off."""
        with self.lock:
            if sensor not in self:
                raise sensor.removed()
            if self.snapshot.request_sensor(sensor.id, picture=picture):
                self.ticker.take_requested()
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
        if self.simulator.is_external:
            raise UnsupportedError(
                f"{handle.name!r} is in a client of yours: remove it there, and the next tick sees "
                "it; or take an excerpt, and remove it from that"
            )
        with handle.changed("remove") as (simulator, body):
            simulator.remove(body)
