"""A PyBullet client as a `Simulator`.

PyBullet reports the poses of the links' centres of mass; ssduck uses those of the link frames:
`X_W_link = X_W_com * inverse(X_link_com)`, with X_link_com from `getDynamicsInfo`. PyBullet's
quaternions are x, y, z, w. PyBullet's padded boxes are not used: shapes are read once and their
boxes are computed exactly (`ssduck.geometry.bounds`).
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial, wraps
from itertools import count, repeat
from typing import Any, Concatenate, ParamSpec, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from ssduck.errors import SceneError, SimulatorError, warn
from ssduck.formatting import joined_names
from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.margins import Margins
from ssduck.geometry.poses import compose
from ssduck.simulators.clock import Clock
from ssduck.simulators.interface import (
    Body,
    CameraView,
    ContactPoints,
    Kind,
    LinkPoses,
    MotorTarget,
    RayHits,
)
from ssduck.simulators.pybullet import scene_loader
from ssduck.simulators.pybullet.bodies import (
    BodyDescription,
    BodyReader,
    UserShapes,
    margins_now,
    masses_of,
    xyzw,
)
from ssduck.simulators.pybullet.bullet_file import SavedShapes
from ssduck.simulators.pybullet.clients import all_handles_of, captured, handles_of, pybullet
from ssduck.simulators.pybullet.given_bodies import GivenBodies, names_of
from ssduck.simulators.pybullet.readings import LinkPosesReader, cast_rays, read_contacts
from ssduck.simulators.pybullet.scene_loader import LoadedBodies
from ssduck.simulators.scenes import Camera, Scene

T = TypeVar("T")
P = ParamSpec("P")
# The colours of a body's visual shapes: link, index among those of the link, red green blue alpha.
VisualColours: TypeAlias = list[tuple[int, int, Sequence[float]]]

# The depth range of sensors' images, metres: about that of PyBullet's own camera.
NEAR_PLANE = 0.01
FAR_PLANE = 100.0

# Bullet's collision groups and masks: fixed bodies collide with all bodies but fixed ones.
_FREE_FILTER, _FIXED_FILTER = (1, ~0), (2, ~2)
# The number of lists of bodies whose reading stays prepared.
_MAX_READERS = 2
# The arguments of user data, link and visual shape, that mean the body itself.
_WHOLE_BODY = (-1, -1)
# The largest number of a shape: PyBullet computes with single floats.
MAX_NUMBER = float(np.finfo(np.float32).max)


def _calls(
    method: Callable[Concatenate[PyBulletSimulator, P], T],
) -> Callable[Concatenate[PyBulletSimulator, P], T]:
    """Runs a method as `PyBulletSimulator.call` runs a function."""

    @wraps(method)
    def run(self: PyBulletSimulator, /, *args: P.args, **named: P.kwargs) -> T:
        return self.call(lambda: method(self, *args, **named))

    return run


class PyBulletSimulator:
    """A PyBullet client as a `Simulator`, which describes what the methods do.

    Args:
        client: the number of a connected client.
        owned: whether ssduck made the client and disconnects it; else the user may change it.
        names, kinds, shapes: what is said of the present bodies; see `GivenBodies`.
        loaded: the bodies that ssduck loaded; updated with the positions that motors hold.
    """

    backend = "pybullet"
    keeps_time = False
    episode = 0

    def __init__(
        self,
        client: int,
        *,
        owned: bool,
        names: Mapping[int, str] | None = None,
        kinds: Mapping[int, Kind] | None = None,
        shapes: Mapping[int, UserShapes] | None = None,
        loaded: LoadedBodies | None = None,
    ) -> None:
        self.client = client
        self.is_external = not owned
        # Empty for a client that ssduck did not fill.
        self.loaded = loaded or LoadedBodies()
        self._given = GivenBodies(names, kinds, shapes)
        self.disabled: frozenset[Body] = frozenset()
        self.hidden: frozenset[Body] = frozenset()
        self._colours: dict[Body, VisualColours] = {}  # those of hidden bodies when shown
        self._descriptions: dict[int, BodyDescription] = {}
        self._margins = Margins(np.zeros(0))  # the last that were read
        # The tags of two worlds on one client must differ.
        self._tag = f"ssduck.{id(self)}"
        self._tags: dict[int, int] = {}  # of the described bodies, by their numbers
        self._is_described = False
        # Whether the client's list is known to lack bodies; see `all_handles_of`.
        self._lacks_bodies = False
        # The bodies that `remove` removed since the last `describe`.
        self._removed: list[Body] = []
        # The reason why the client must not be used any more: PyBullet reuses the number of a
        # disconnected client.
        self._lost_reason: str | None = None
        # The last lists of bodies whose poses were read, the last one first.
        self._readers: list[tuple[tuple[Body, ...], LinkPosesReader]] = []
        self.clock = Clock(self.timestep, self.loaded.time)

    # -- bodies ---------------------------------------------------------------------------

    @_calls
    def describe(self) -> tuple[list[Body], list[Body]] | None:
        # PyBullet reuses the number of a removed body at once. So every described body carries a
        # tag: user data, which PyBullet removes with the body.
        if self._is_described and not self.is_external:
            gone, self._removed = self._removed, []
            return ([], gone) if gone else None
        tags = self._read_tags(handles_of)
        if self._tags == tags and not self._lacks_bodies:
            self._given.end()
            return None
        if self.is_external and (-1 in tags.values() or self._lacks_bodies):
            # What made the new bodies may have made others that the client's list lacks.
            self._lacks_bodies = False
            tags = self._read_tags(all_handles_of)
        handles = list(tags)
        present = {handle for handle, tag in tags.items() if self._tags.get(handle) == tag}
        added = [handle for handle in handles if handle not in present]
        # Copies have the order of their originals. PyBullet's order changes with a removal.
        order = {handle: number for number, handle in enumerate(self.loaded.described)}
        added.sort(key=lambda handle: order.get(handle, len(order)))
        saved = SavedShapes(self.client, added)
        with captured():  # PyBullet prints warnings about shapes that it does not return
            name_bodies = partial(names_of, self.client, handles)
            names = name_bodies(added, self._given.names)
            new = {handle: self._describe_body(handle, names[handle], saved) for handle in added}
            changed = self._given.changed(description.body for description in new.values())
            names = name_bodies(changed, self._given.names)
            new |= {handle: self._describe_body(handle, names[handle], saved) for handle in changed}
        if self._is_described and not present:
            self._given.warn_of_reset([description.body for description in new.values()])
        self._check_shapes(description.body for description in new.values())
        read = [description.body for handle, description in new.items() if handle not in order]
        if boxed := [body.name for body in read if body.has_stand_ins]:
            warn(
                f"{joined_names(boxed)}: PyBullet does not give back all shapes (a height field is "
                "such a shape); bounding boxes are used instead, which have exact = false in the "
                "table of shapes: World.attach(client, shapes={…}) takes the shapes themselves; of "
                "a soft body, the box keeps its present form, the velocity is unknown (NULL), and "
                "the mass is told as 0"
            )
        gone = [d.body for handle, d in self._descriptions.items() if handle not in present]
        self._forget(gone)
        self._descriptions = {handle: self._descriptions[handle] for handle in present} | new
        self._tags = self._read_tags(lambda _: handles)
        self._given.end()
        self._is_described = True
        for handle, spec in self.loaded.origins.items():
            self.enable(self._descriptions[handle].body, spec.enabled)
            self.show(self._descriptions[handle].body, spec.visible)
        return [description.body for description in new.values()], gone

    @_calls
    def remove(self, body: Body) -> None:
        pybullet.removeBody(body.handle, self.client)
        # Bodies that rested on it must fall with the next step.
        pybullet.performCollisionDetection(self.client)
        self._forget([body])
        del self._descriptions[body.handle]
        for values in (self.loaded.origins, self.loaded.motor_positions):
            values.pop(body.handle, None)
        self._removed.append(body)

    def description_of(self, body: Body) -> BodyDescription | None:
        """Returns the description of a body, if the client still has the body."""
        description = self._descriptions.get(body.handle)
        if description is None or description.body is not body or self._lost_reason is not None:
            return None
        if self.is_external:
            # Another body may have its number by now.
            tag = self._tags.get(body.handle)
            if self.call(lambda: self._tags_of([body.handle])) != [tag]:
                return None
        return description

    def colours_when_shown(self, body: Body) -> VisualColours:
        """Returns the colours of a body; of one that is hidden, those that it will have again."""
        return self._colours.get(body) or self.call(
            lambda: visual_colours(self.client, body.handle)
        )

    def _forget(self, gone: Sequence[Body]) -> None:
        if not self.disabled.isdisjoint(gone):
            self.disabled -= frozenset(gone)
        if not self.hidden.isdisjoint(gone):
            self.hidden -= frozenset(gone)
            for body in gone:
                self._colours.pop(body, None)

    def _read_tags(self, list_bodies: Callable[[int], list[int]]) -> dict[int, int]:
        """Returns the tags of the bodies that a function lists of a client, by number."""
        handles = list_bodies(self.client)
        return dict(zip(handles, self._tags_of(handles), strict=True))

    def _tags_of(self, handles: Sequence[int]) -> list[int]:
        """Returns the tag of each body; -1 for none."""
        link, shape = map(repeat, _WHOLE_BODY)
        key, client = repeat(self._tag), repeat(self.client)
        return list(map(pybullet.getUserDataId, handles, key, link, shape, client))

    def _describe_body(self, handle: int, name: str, saved: SavedShapes) -> BodyDescription:
        description = self.loaded.described.pop(handle, None)
        if description is None:
            shapes = self._given.shapes.get(handle, {})
            reader = BodyReader(self.client, handle, name, saved, shapes)
            description = reader.read(self._given.kinds.get(handle))
        pybullet.addUserData(handle, self._tag, "1", *_WHOLE_BODY, self.client)
        return description

    def _check_shapes(self, bodies: Iterable[Body]) -> None:
        """Warns of shapes with numbers that are not finite in PyBullet."""
        for body in bodies:
            for shape in body.shapes:
                form = shape.geometry
                numbers = form.vertices.ravel(), form.size, shape.position, shape.orientation
                if (np.abs(np.concatenate(numbers)) <= MAX_NUMBER).all():
                    continue
                message = f"{body.name!r} has a {form.type} with numbers that are not finite"
                if body.handle in self.loaded.origins:
                    raise SceneError(f"{message} as single floats, which are below 3.4e38")
                warn(f"{message}: its boxes, and what is computed of them, are wrong")
                break

    # -- state ----------------------------------------------------------------------------

    @property
    def time(self) -> float:
        return self.clock.time

    @property
    @_calls
    def timestep(self) -> float:
        # The user may change it at any time.
        return float(pybullet.getPhysicsEngineParameters(self.client)["fixedTimeStep"])

    @_calls
    def settings(self) -> Scene:
        """Returns a scene without bodies: the gravity, the time step and the solver."""
        return scene_loader.settings_of(self.client, self.loaded)

    def begin_episode(self) -> None:
        self.episode += 1
        self._given.begin_episode()
        self.clock = Clock(self.timestep)

    def set_clock(self, clock: Clock) -> None:
        self.clock = clock

    def read_link_poses(self, bodies: tuple[Body, ...]) -> LinkPoses:
        reader = next((reader for known, reader in self._readers if known is bodies), None)
        if reader is None:
            reader = LinkPosesReader(bodies, [self._descriptions[b.handle].com for b in bodies])
            self._readers = [(bodies, reader), *self._readers[: _MAX_READERS - 1]]
        return self.call(partial(reader.read, self.client))

    @_calls
    def read_joints(self, bodies: Sequence[Body]) -> Array:
        rows = [
            (state[0], state[1], state[3])
            for body in bodies
            for state in pybullet.getJointStates(
                body.handle, list(range(len(body.joints))), self.client
            )
        ]
        return np.array(rows, dtype=np.float64).reshape(-1, 3)

    @_calls
    def read_masses(self, bodies: Sequence[Body]) -> list[list[float]]:
        return [
            masses_of(self.client, body) if is_present else body.masses
            for body, is_present in zip(bodies, self._are_present(bodies), strict=True)
        ]

    @_calls
    def read_margins(self, bodies: Sequence[Body]) -> Margins:
        margins: list[float] = []
        for body, is_present in zip(bodies, self._are_present(bodies), strict=True):
            if is_present:
                known = self._descriptions[body.handle].link_margins
                margins += margins_now(self.client, body, known)
            else:
                margins += body.margins
        if margins != self._margins.listed:  # the same object as long as nothing has changed
            self._margins = Margins(np.array(margins))
        return self._margins

    def _are_present(self, bodies: Sequence[Body]) -> list[bool]:
        """Returns whether the client still has each of some bodies."""
        now = self._tags_of([body.handle for body in bodies])
        return [tag == self._tags.get(b.handle) for b, tag in zip(bodies, now, strict=True)]

    @_calls
    def has_moved_on(self, sample: Sequence[Body]) -> bool:
        count = pybullet.getNumBodies(self.client)
        return count != len(self._tags) or not all(self._are_present(sample))

    def read_contacts(self) -> ContactPoints:
        # Bodies that another client of the same simulation made are described at the next tick;
        # until then their contacts are left out.
        known = self._descriptions.keys()
        contacts, self._lacks_bodies = self.call(lambda: read_contacts(self.client, known))
        return contacts

    def cast_rays(self, starts: Array, ends: Array, through: Indices) -> RayHits:
        return self.call(lambda: cast_rays(self.client, starts, ends, through))

    @_calls
    def step(self, count: int) -> None:
        timestep, done = self.timestep, 0
        try:
            for _ in range(count):
                # Ctrl-C is handled after the call, so that a step is counted before it runs.
                done += 1
                pybullet.stepSimulation(self.client)
        finally:
            self.clock = self.clock.after(done, timestep)

    @_calls
    def place(self, body: Body, position: Array, orientation: Array) -> None:
        com = self._descriptions[body.handle].com
        com_pose = compose(position[None], orientation[None], com[0][:1], com[1][:1])
        pybullet.resetBasePositionAndOrientation(
            body.handle, com_pose[0][0].tolist(), xyzw(com_pose[1])[0].tolist(), self.client
        )
        # Otherwise its contacts would be those at its old place.
        pybullet.performCollisionDetection(self.client)

    @_calls
    def set_joints(self, body: Body, positions: Mapping[int, float]) -> None:
        # The motors of a client that ssduck made hold the new positions.
        for number, position in positions.items():
            joint = body.joints[number]
            pybullet.resetJointState(body.handle, number, position, 0.0, self.client)
            if not self.is_external:
                scene_loader.hold_joint(body.handle, joint, position, self.client)
                self.loaded.motor_positions.setdefault(body.handle, {})[joint.link] = position
        pybullet.performCollisionDetection(self.client)

    @_calls
    def drive(self, body: Body, motors: Mapping[int, MotorTarget]) -> None:
        for number, motor in motors.items():
            scene_loader.set_motor(body.handle, body.joints[number].link, motor, self.client)

    @_calls
    def has_constraint(self, body: Body, other: Body) -> bool:
        return bool(scene_loader.fixed_constraints(self.client, body.handle, other.handle))

    @_calls
    def add_constraint(self, body: Body, link: int, other: Body) -> None:
        scene_loader.add_fixed_constraint(self.client, (body.handle, link - 1), other.handle)

    @_calls
    def remove_constraint(self, body: Body, other: Body) -> None:
        for number in scene_loader.fixed_constraints(self.client, body.handle, other.handle):
            pybullet.removeConstraint(number, self.client)

    @_calls
    def enable(self, body: Body, on: bool) -> None:
        # PyBullet does not return collision filters. A body that is switched on again gets the
        # default ones.
        if on == (body not in self.disabled):
            return
        for link, part in enumerate(body.links):
            fixed = link == 0 and part.mass == 0.0
            group, mask = (_FIXED_FILTER if fixed else _FREE_FILTER) if on else (0, 0)
            pybullet.setCollisionFilterGroupMask(body.handle, link - 1, group, mask, self.client)
        pybullet.performCollisionDetection(self.client)
        self.disabled = self.disabled - {body} if on else self.disabled | {body}

    @_calls
    def show(self, body: Body, on: bool) -> None:
        if on == (body not in self.hidden):
            return
        colours = self.colours_when_shown(body)
        for link, shape, (*rgb, alpha) in colours:
            colour = [*rgb, alpha if on else 0.0]
            pybullet.changeVisualShape(
                body.handle, link, shape, rgbaColor=colour, physicsClientId=self.client
            )
        self.hidden = self.hidden - {body} if on else self.hidden | {body}
        if on:
            self._colours.pop(body, None)
        else:
            self._colours[body] = colours

    def render(
        self, camera: Camera, width: int, height: int, *, shadow: bool
    ) -> npt.NDArray[np.uint8]:
        return self._draw(width, height, *_camera_matrices(camera, width, height), shadow=shadow)

    @_calls
    def segment(self, camera: Camera, width: int, height: int) -> tuple[Indices, Indices]:
        pixels = pybullet.getCameraImage(
            width,
            height,
            *_camera_matrices(camera, width, height),
            renderer=pybullet.ER_TINY_RENDERER,
            flags=pybullet.ER_SEGMENTATION_MASK_OBJECT_AND_LINKINDEX,
            physicsClientId=self.client,
        )[4]
        # A pixel is link << 24 | body, the base being link 0; -1 shows no body.
        numbers = np.asarray(pixels, dtype=np.intp).reshape(height, width)
        return np.where(numbers < 0, -1, numbers & 0xFFFFFF), numbers >> 24

    def photograph(self, view: CameraView) -> npt.NDArray[np.uint8]:
        target = view.position + view.matrix[:, 0]
        view_matrix = pybullet.computeViewMatrix(
            view.position.tolist(), target.tolist(), view.matrix[:, 2].tolist()
        )
        projection = pybullet.computeProjectionMatrixFOV(
            view.fov, view.width / view.height, NEAR_PLANE, FAR_PLANE
        )
        return self._draw(view.width, view.height, view_matrix, projection, shadow=False)

    @_calls
    def _draw(
        self, width: int, height: int, view: Any, projection: Any, *, shadow: bool
    ) -> npt.NDArray[np.uint8]:
        picture = pybullet.getCameraImage(
            width,
            height,
            view,
            projection,
            lightDirection=(4.0, -6.0, 8.0),
            lightDistance=8.0,
            lightAmbientCoeff=0.65,
            lightDiffuseCoeff=0.6,
            lightSpecularCoeff=0.05,
            shadow=int(shadow),
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=self.client,
        )[2]
        pixels = np.asarray(picture, dtype=np.uint8).reshape(height, width, 4)
        return np.ascontiguousarray(pixels[:, :, :3])

    def close(self) -> None:
        if self._lost_reason is not None:
            return
        self._lost_reason = "the world is closed"
        if not pybullet.isConnected(self.client):
            return
        if self.is_external:
            for tag in self._tags.values():
                pybullet.removeUserData(tag, self.client)
        else:
            pybullet.disconnect(self.client)

    def call(self, function: Callable[[], T]) -> T:
        """Calls PyBullet and converts its errors into those of ssduck."""
        if self._lost_reason is not None:
            raise SimulatorError(f"{self._lost_reason}; load or attach the world again")
        try:
            return function()
        except pybullet.error as error:
            if not pybullet.isConnected(self.client):
                self._lost_reason = f"PyBullet client {self.client} is disconnected"
                raise SimulatorError(
                    f"{self._lost_reason}; load or attach the world again"
                ) from error
            raise SimulatorError(f"PyBullet: {error}") from error


def _camera_matrices(camera: Camera, width: int, height: int) -> tuple[Any, Any]:
    """Returns PyBullet's view and projection matrices of a camera."""
    view = pybullet.computeViewMatrix(camera.eye, camera.target, (0.0, 0.0, 1.0))
    # A view much deeper than the scene has too little depth resolution: shadows get rings.
    depth = 3.0 * math.dist(camera.eye, camera.target)
    return view, pybullet.computeProjectionMatrixFOV(camera.fov, width / height, 0.05, depth)


def visual_colours(client: int, handle: int) -> VisualColours:
    """Returns the colours of a body as they are now."""
    entries = pybullet.getVisualShapeData(handle, physicsClientId=client)
    numbers: dict[int, Iterator[int]] = defaultdict(count)
    return [(entry[1], next(numbers[entry[1]]), entry[7]) for entry in entries]
