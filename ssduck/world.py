"""What a simulation is, whichever simulator runs it: `World`.

A *world* is one simulation; an *entity* is a robot, a kinbody or a sensor of it. What an entity
tells of itself is of the world's last tick, never of the simulator's present.
"""

from __future__ import annotations

import threading
import time
import weakref
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import count
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt

from ssduck.entities import Entity, Sensor
from ssduck.errors import (
    ArgumentError,
    SceneError,
    SelectScriptError,
    UnknownNameError,
    nearest,
)
from ssduck.following import Followed
from ssduck.kinematics import JointValues, Pose, pose_of, positions_of
from ssduck.layout import Member
from ssduck.openrave import WorldSpellings
from ssduck.recording import Recorder
from ssduck.scenes import Camera, Scene, SensorSpec, read_sensor
from ssduck.sensing import Reading
from ssduck.simulators import Body, Kind, Simulator
from ssduck.simulators.posed import Posed
from ssduck.snapshot import Snapshot
from ssduck.what_if import imagined

T = TypeVar("T")

# What a world is called before it gets a name.
UNNAMED = "world"
_serials = count()
# Seconds that a step waits while another thread wants to ask.
_TURN = 1e-4
# Whoever watches a run is told each so many steps.
_WATCHED = 24


class World(Followed, WorldSpellings):
    """One simulation and its current tick.

    Use `World.load` or `World.attach` to make one. Every `step` and `tick` replaces the tables
    at once; in between nothing changes them.

    Args:
        simulator: what runs it.
        name: what the world is called until it is bound to a variable.
        sensors: the sensors on its bodies, in load order.
        camera: the view that `render` draws if it is given none.

    Attributes:
        serial: the order in which worlds were made, and in which several are held.
    """

    _members: list[Member]

    def __init__(
        self,
        simulator: Simulator,
        *,
        name: str = UNNAMED,
        sensors: Sequence[SensorSpec] = (),
        camera: Camera | None = None,
    ) -> None:
        self._begin(simulator, Snapshot(), name, camera or Camera())
        # Ids count as worlds list: sensors first.
        sensor_ids = [next(self._ids) for _ in sensors]
        self._update_members()
        self._members = self._mounted(sensor_ids, sensors) + self._members
        for member in self._members:
            if member.sensor is not None and not member.sensor.powered:
                self.snapshot.switch(member.id, on=False)
        self.tick()

    def _begin(self, simulator: Simulator, snapshot: Snapshot, name: str, camera: Camera) -> None:
        self.name = name
        self.camera = camera
        self.lock = threading.RLock()
        self._begin_following()
        self.serial = next(_serials)
        self.snapshot = snapshot
        self._queries = 0
        self._waiting = 0
        self._simulator = simulator
        self._ids = count(1)
        self._members = snapshot.listed
        self._recorders: list[weakref.ref[Recorder]] = []

    @classmethod
    def load(cls, scene: Scene) -> World:
        """A world made from a scene in a PyBullet simulation of its own.

        Raises:
            SceneError: the scene cannot be loaded: file, key and reason.
        """
        from ssduck.simulators import pybullet

        simulator = pybullet.load(scene)
        try:
            world = cls(simulator, name=scene.name, sensors=scene.sensors, camera=scene.camera)
        except BaseException as error:
            simulator.close()
            if isinstance(error, SceneError):
                message = f"{scene.path}: {error.message}"
                raise SceneError(message, suggestions=error.suggestions) from error
            raise
        # A simulation takes tens of megabytes: it goes with the last handle of its world.
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
    ) -> World:
        """A world around a PyBullet client that you made and go on using.

        Bodies that you add, remove or move are seen at the next `tick()`. Each body gets a
        piece of PyBullet user data, by which a removed body is told from the next one of the
        same number. Simulated time counts the steps that this world runs with `step`.

        Args:
            client: the client's number, or an object that holds it as `_client`.
            names: names by PyBullet body number of bodies that are there now; others are named
                as in their models, made unique.
            kinds: `"robot"` or `"kinbody"` by such a number; by default what has movable joints
                is a robot.
            name: what the world is called until it is bound to a variable.

        Raises:
            SimulatorError: the client is not connected.
            SelectScriptError: a number is no body's, or a kind is none of these.
        """
        from ssduck.simulators import pybullet

        return cls(pybullet.attach(client, names, kinds), name=name)

    # -- time -----------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Simulated seconds at the last tick."""
        return self.snapshot.time

    @property
    def timestep(self) -> float:
        """Simulated seconds that the next step takes; 0 for a what-if world, which has none."""
        with self.lock:
            return self._simulator.timestep

    def step(self, count: int = 1) -> World:
        """Run that many steps of the simulator, then take a tick.

        Where a follower wants a tick on the way (a trigger is due, say), one is taken there, too.
        Ctrl-C ends it at a tick.

        Raises:
            SimulatorError: the simulator does not answer; the last tick stays.
            UnsupportedError: it is a what-if world.
        """
        if count < 0:
            raise ValueError(f"a simulation cannot run {count} steps")
        while True:
            run = min(count, self.steps_to_due())
            self.advance(int(run))
            self.tell()
            count -= int(run)
            if count <= 0:
                return self

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
        from ssduck.running import run

        run([self], seconds, realtime=realtime, progress=progress, every=every)
        return self

    def tick(self) -> World:
        """Take a tick: the tables are replaced by the simulator's state as it is now.

        Raises:
            SimulatorError: the simulator does not answer; the last tick stays.
        """
        with self.lock:
            self._take_tick()
        self.tell()
        return self

    def _take_tick(self) -> None:
        self._check_not_held()
        self._take()

    def advance(self, count: int, watch: Callable[[int], object] | None = None) -> None:
        """Run steps and take a tick, telling no follower: a part of `step`.

        Args:
            count: how many steps.
            watch: is told now and then how many more were run; the world is locked meanwhile.
        """
        if self._waiting:
            time.sleep(_TURN)  # locks are not fair: a thread that only steps would keep it
        with self.lock:
            self._check_not_held()
            try:
                for done in _parts(count, count if watch is None else _WATCHED):
                    self._simulator.step(done)
                    if watch is not None:
                        watch(done)
            except KeyboardInterrupt:
                self._take_tick()  # the tables are not to lag behind the simulator
                raise
            self._take_tick()

    def _take(self) -> None:
        self._update_members()
        self.snapshot.take(self._simulator, self._members)
        for reference in self._recorders:
            recorder = reference()
            if recorder is not None:
                recorder.note(self.snapshot)

    @property
    def is_final(self) -> bool:
        """Whether no other tick of it will come: it is a what-if world, or a past one."""
        return isinstance(self._simulator, Posed)

    def record(self, recorder: Recorder) -> None:
        """Let a recorder keep this tick and those to come, as long as anyone else holds it."""
        with self.lock:
            self._check_not_held()
            self._recorders.append(weakref.ref(recorder))
            self._read_recorded()
            if self.snapshot.ask(()):
                self._take()
            else:
                recorder.note(self.snapshot)

    def forget(self, recorder: Recorder) -> None:
        """Let a recorder keep no more ticks."""
        with self.lock:
            self._recorders = [r for r in self._recorders if r() not in (None, recorder)]
            self._read_recorded()

    def _read_recorded(self) -> None:
        """See to it that each tick has the tables that are recorded."""
        recorders = [recorder for reference in self._recorders if (recorder := reference())]
        tables = frozenset(table for r in recorders for table in r.recording.tables)
        self.snapshot.recorded = tables - {"entities"}

    def ask(self, tables: Iterable[str]) -> None:
        """See to it that the current tick has these tables; takes a fresh one if it has not."""
        with self.lock:
            if self.snapshot.ask(tables):
                self._take_asked()

    def _take_asked(self) -> None:
        if self._simulator.watched:
            self._check_not_held()
        # Under a query nothing has moved in a world that ssduck alone steps.
        self._take()

    @contextmanager
    def held(self, tables: Iterable[str] = ()) -> Iterator[None]:
        """Hold the world at its tick, with these tables read, while a query runs."""
        self._waiting += 1
        self.lock.acquire()
        self._waiting -= 1
        try:
            self.ask(tables)
            self._queries += 1
            try:
                yield
            finally:
                self._queries -= 1
        finally:
            self.lock.release()

    def _check_not_held(self) -> None:
        if self._queries:
            raise SelectScriptError(
                f"a query on {self.name!r} is running: its tick cannot be replaced before it ends"
            )

    def close(self) -> None:
        """Give up the simulation; a client that you made stays connected."""
        with self.lock:
            self._simulator.close()

    def render(
        self, width: int = 960, height: int = 720, camera: Camera | None = None
    ) -> npt.NDArray[np.uint8]:
        """A colour picture of the simulation as it is now, (height, width, 3)."""
        with self.lock:
            return self._simulator.render(camera or self.camera, width, height)

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
        has_links = any(m.body and m.body.joints for m in self.snapshot.members)
        with self.held(("links", "joints") if has_links else ()):
            places = {body: pose_of(pose, name) for name, body, pose in self._bodies(poses or {})}
            positions = {
                body: positions_of(values, body, name)
                for name, body, values in self._bodies(joints or {})
            }
            posed, snapshot = imagined(self.snapshot, places, positions)
        world = World.__new__(World)
        world._begin(posed, snapshot, UNNAMED, self.camera)  # noqa: SLF001  # one class
        return world.tick()

    def _bodies(self, by_entity: Mapping[str | Entity, T]) -> Iterator[tuple[str, Body, T]]:
        """What is said of entities, with their names and what they are at this tick."""
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
            yield entity.name, entity.body_of(self.snapshot.members[row], "move"), value

    # -- entities -------------------------------------------------------------------------

    def __iter__(self) -> Iterator[Entity]:
        """The entities: sensors first, then bodies, each in load order."""
        return map(self.entity, [member.id for member in self.snapshot.members])

    def __len__(self) -> int:
        return len(self.snapshot.members)

    def __contains__(self, thing: object) -> bool:
        """Whether it has an entity of that name, or that entity."""
        if isinstance(thing, Entity):
            return thing.world is self and thing.id in self.snapshot.rows
        return any(member.name == thing for member in self.snapshot.members)

    def __getitem__(self, name: str) -> Entity:
        """The entity of that name.

        Raises:
            UnknownNameError: there is none, with the nearest names.
        """
        for member in self.snapshot.members:
            if member.name == name:
                return self.entity(member.id)
        known = [member.name for member in self.snapshot.members]
        raise UnknownNameError(
            f"world {self.name!r} has no entity {name!r}", suggestions=nearest(name, known)
        )

    def entity(self, id: int) -> Entity:
        """The handle of an entity that is there, by its id."""
        member = self.snapshot.members[self.snapshot.rows[id]]
        kind = Sensor if member.kind == "sensor" else Entity
        return kind(self, id, member.name, member.kind)

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
            type: one of `ssduck.sensors.SENSOR_TYPES`.
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
            self._check_not_held()
            self._update_members()
            host = self._host(on)
            taken = {member.name for member in self._members}
            if name in taken:
                raise ArgumentError(f"add_sensor: name: {name!r} is there already")
            values = {
                "type": type,
                "on": host.name,
                "name": name if name is not None else _unique(f"{host.name}_{type}", taken),
                "position": _plain(position),
                "orientation": _plain(orientation),
                **({} if link is None else {"link": link}),
                **settings,
            }
            try:
                spec = read_sensor(values, [host.name])
                (member,) = self._mounted([next(self._ids)], [spec])
            except SceneError as error:
                message = f"add_sensor: {error.message.removeprefix('sensor[0].')}"
                raise ArgumentError(message, suggestions=error.suggestions) from error
            self._members = [*self._members, member]
            self.snapshot.switch(member.id, on=spec.powered)
            self._take_tick()
            sensor = self.entity(member.id)
        assert isinstance(sensor, Sensor)
        return sensor

    def _host(self, on: str | Entity) -> Member:
        """The body of that name, or that entity."""
        if isinstance(on, Entity):
            if on.world is not self:
                raise ArgumentError(f"add_sensor: on: {on.name!r} is of another world")
            found = [member for member in self._members if member.id == on.id]
            if not found:
                raise on.removed()
        else:
            found = [member for member in self._members if member.name == on]
        if not found:
            known = [member.name for member in self._members if member.body is not None]
            raise UnknownNameError(
                f"world {self.name!r} has no body {on!r}", suggestions=nearest(on, known)
            )
        if found[0].body is None:
            raise ArgumentError(f"add_sensor: on: {found[0].name!r} is a sensor, not a body")
        return found[0]

    def remove_sensor(self, sensor: str | Sensor) -> None:
        """Take a sensor off its body, and take a tick.

        Raises:
            UnknownNameError: there is no such sensor, with the nearest names.
            RemovedEntityError: it is no longer in the world.
        """
        with self.lock:
            self._check_not_held()
            entity = sensor if isinstance(sensor, Entity) else self[sensor]
            if entity not in self:
                raise entity.removed()
            if not isinstance(entity, Sensor):
                raise ArgumentError(f"{entity.name!r} is a {entity.kind}, no sensor")
            self._members = [member for member in self._members if member.id != entity.id]
            self._take_tick()

    def switch(self, sensor: Sensor, *, on: bool) -> None:
        """Switch a sensor on or off; see `Sensor.power`."""
        with self.lock:
            self._check_not_held()
            if sensor not in self:
                raise sensor.removed()
            if on != self.snapshot.sensing.is_on(sensor.id):
                self.snapshot.switch(sensor.id, on=on)

    def reading(self, sensor: Sensor, *, picture: bool = False) -> Reading | None:
        """What a sensor measured last, with its colours if they are asked for; None if off."""
        with self.lock:
            if sensor not in self:
                raise sensor.removed()
            if self.snapshot.ask_sensor(sensor.id, picture=picture):
                self._take_asked()
                if sensor not in self:  # its body went
                    raise sensor.removed()
            return self.snapshot.sensing.readings.get(sensor.id)

    # -- bodies ---------------------------------------------------------------------------

    def place(self, entity: Entity, pose: Pose | None, joints: JointValues | None) -> None:
        """Put a body's link frame and its joints there and take a tick; see `Entity.move`."""

        def put(body: Body) -> None:
            values = {} if joints is None else positions_of(joints, body, entity.name)
            if pose is not None:
                self._simulator.place(body, *pose)
            if values:
                self._simulator.set_joints(body, values)

        self._change(entity, "move", put)

    def enable(self, entity: Entity, on: bool) -> None:
        """Let a body take part in collisions, or not, and take a tick."""
        self._change(entity, "enable", lambda body: self._simulator.enable(body, on))

    def show(self, entity: Entity, on: bool) -> None:
        """Let a body be drawn, or not, and take a tick."""
        self._change(entity, "show", lambda body: self._simulator.show(body, on))

    def _change(self, entity: Entity, verb: str, change: Callable[[Body], None]) -> None:
        """Change a body in the simulator, and take a tick."""
        with self.lock:
            self._check_not_held()
            # Its number may be another body's by now.
            self._update_members()
            member = next((member for member in self._members if member.id == entity.id), None)
            if member is None:
                raise entity.removed()
            change(entity.body_of(member, verb))
            self.snapshot.read_all_anew()
            self._take_tick()

    def _update_members(self) -> None:
        """Take note of bodies that came and went."""
        changes = self._simulator.describe()
        if changes is None:
            return
        came, gone = changes
        gone_bodies = set(gone)
        gone_ids = {member.id for member in self._members if member.body in gone_bodies}
        self._members = [
            member
            for member in self._members
            if member.id not in gone_ids and member.mount[0] not in gone_ids
        ]
        taken = {member.name for member in self._members}
        for body in came:
            name = _unique(body.name, taken)
            taken.add(name)
            self._members.append(Member(next(self._ids), name, body.kind, body=body))

    def _mounted(self, ids: Sequence[int], specs: Sequence[SensorSpec]) -> list[Member]:
        """The sensors on the bodies that carry them."""
        by_name = {member.name: member for member in self._members}
        sensors = []
        for index, (id, spec) in enumerate(zip(ids, specs, strict=True)):
            host = by_name[spec.on]
            mount = (host.id, _link_number(host, spec, index))
            sensors.append(
                Member(id, spec.name, "sensor", parent=spec.on, sensor=spec, mount=mount)
            )
        return sensors


def _parts(count: int, most: int) -> Iterator[int]:
    """A number in parts of at most `most`; 0 is one part."""
    yield min(count, most)
    for begun in range(most, count, most or 1):
        yield min(most, count - begun)


def _unique(name: str, taken: Container[str]) -> str:
    """The name, or the name and a number if it is taken already."""
    if name not in taken:
        return name
    return next(n for n in (f"{name}_{i}" for i in count(2)) if n not in taken)


def _link_number(host: Member, spec: SensorSpec, index: int) -> int:
    assert host.body is not None
    if spec.link is None:
        return 0
    names = [link.name for link in host.body.links]
    if spec.link not in names:
        raise SceneError(
            f"sensor[{index}].link: {host.name!r} has no link {spec.link!r}",
            suggestions=nearest(spec.link, names),
        )
    return names.index(spec.link)


def _plain(values: Any) -> Any:
    """Numbers of an array or a sequence as a list, whatever they are."""
    return values.tolist() if isinstance(values, np.ndarray) else list(values)
