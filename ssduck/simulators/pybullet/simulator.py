"""A PyBullet client as a `Simulator`.

PyBullet reports the poses of the links' centres of mass; ssduck uses those of the link frames:
`X_W_link = X_W_com * inverse(X_link_com)`, with X_link_com from `getDynamicsInfo`. PyBullet's
quaternions are x, y, z, w. PyBullet's padded boxes are not used: shapes are read once and their
boxes are computed exactly (`ssduck.geometry.bounds`).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import repeat
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from ssduck.errors import SimulatorError, warn
from ssduck.formatting import joined_names
from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.poses import compose
from ssduck.simulators.clock import Clock
from ssduck.simulators.interface import (
    Body,
    CameraView,
    Contact,
    Kind,
    LinkPoses,
    MotorTarget,
    RayHits,
)
from ssduck.simulators.pybullet.bodies import (
    BodyDescription,
    GivenShapes,
    describe,
    masses_of,
    xyzw,
)
from ssduck.simulators.pybullet.bullet_file import SavedShapes
from ssduck.simulators.pybullet.clients import handles_of
from ssduck.simulators.pybullet.collision_margins import margins_of
from ssduck.simulators.pybullet.console import captured, pybullet
from ssduck.simulators.pybullet.constraints import add_fixed_constraint, fixed_constraints
from ssduck.simulators.pybullet.link_frames import LinkPosesReader
from ssduck.simulators.pybullet.rays import cast_rays
from ssduck.simulators.pybullet.scene_loader import LoadedBodies, hold_joint, set_motor
from ssduck.simulators.scenes import Camera

T = TypeVar("T")

# The depth range of sensors' images, metres: about that of PyBullet's own camera.
NEAREST_DRAWN = 0.01
FARTHEST_DRAWN = 100.0

# Bullet's collision groups and masks: fixed bodies collide with all bodies but fixed ones.
_FREE, _FIXED = (1, -1), (2, -3)


class PyBulletSimulator:
    """A PyBullet client as a `Simulator`.

    Args:
        client: the number of a connected client.
        owned: whether ssduck made the client and disconnects it; else the user may change it.
        names: names of the present bodies by PyBullet body number, instead of those of the models.
        kinds: kinds of these bodies, instead of robot for bodies with movable joints.
        shapes: the shapes of these bodies that the caller knows.
        loaded: what ssduck knows of bodies that it loaded.

    Attributes:
        loaded: the same; updated with the positions that motors hold.
        clock: counts the steps that ssduck runs; in a client of the user's, it follows the ticks.
    """

    backend = "pybullet"

    def __init__(
        self,
        client: int,
        *,
        owned: bool,
        names: Mapping[int, str] | None = None,
        kinds: Mapping[int, Kind] | None = None,
        shapes: Mapping[int, GivenShapes] | None = None,
        loaded: LoadedBodies | None = None,
    ) -> None:
        self.client = client
        self.is_external = not owned
        # Empty for a client that ssduck did not fill.
        self.loaded = loaded or LoadedBodies()
        self._names = dict(names or {})
        self._kinds = dict(kinds or {})
        self._given = dict(shapes or {})
        self.disabled: frozenset[Body] = frozenset()
        self.hidden: frozenset[Body] = frozenset()
        # The colours of hidden bodies: link, index among its visual shapes, colour.
        self._colours: dict[Body, list[tuple[int, int, Sequence[float]]]] = {}
        self._known: dict[int, BodyDescription] = {}
        # Two worlds on one client must not take each other's tags for their own.
        self._tag = f"ssduck.{id(self)}"
        self._listed: tuple[list[int], list[int]] = ([], [])
        self._described = False
        # Bodies that were removed since `describe` was called.
        self._removed: list[Body] = []
        # The reason why the client must not be used any more. PyBullet reuses the number of a
        # client that is gone.
        self._lost: str | None = None
        self._layout: tuple[tuple[Body, ...], LinkPosesReader] = ((), LinkPosesReader([], []))
        self.clock = Clock(self._clients_timestep(), self.loaded.time)

    # -- bodies ---------------------------------------------------------------------------

    def describe(self) -> tuple[list[Body], list[Body]] | None:
        """Returns the bodies that came and went since the last call.

        PyBullet reuses the number of a removed body at once. So every known body carries a tag
        (user data, which is removed with it) that tells the two apart.
        """
        if self._described and not self.is_external:
            gone, self._removed = self._removed, []
            return ([], gone) if gone else None
        handles = self._call(lambda: handles_of(self.client))
        tags = self._call(lambda: self._tags_of(handles))
        if self._listed == (handles, tags):
            return None
        known = dict(zip(*self._listed, strict=True))
        kept = {h for h, tag in zip(handles, tags, strict=True) if known.get(h) == tag}
        unknown = [handle for handle in handles if handle not in kept]
        saved = SavedShapes(self.client, unknown)
        with captured():  # PyBullet prints warnings about shapes that it does not return
            new = self._call(lambda: {handle: self._read(handle, saved) for handle in unknown})
        _warn_of_guesses([one.body for one in new.values() if not one.exact])
        gone = [one.body for handle, one in self._known.items() if handle not in kept]
        self._forget(gone)
        self._known = {handle: self._known[handle] for handle in kept} | new
        self._listed = handles, self._call(lambda: self._tags_of(handles))
        # They hold for the bodies of that time, not for later bodies with the same numbers.
        self._names, self._kinds, self._given, self._described = {}, {}, {}, True
        self._begin_absent()
        return [one.body for one in new.values()], gone

    def _begin_absent(self) -> None:
        """Switches off the bodies that begin without collisions or hidden."""
        for handle in self.loaded.disabled:
            self.enable(self._known[handle].body, on=False)
        for handle in self.loaded.hidden:
            self.show(self._known[handle].body, on=False)
        self.loaded.disabled, self.loaded.hidden = set(), set()

    def remove(self, body: Body) -> None:
        """Removes a body from a client that ssduck made."""
        self._call(lambda: pybullet.removeBody(body.handle, self.client))
        # Bodies that rested on it must fall with the next step.
        self._call(lambda: pybullet.performCollisionDetection(self.client))
        self._forget([body])
        del self._known[body.handle]
        for known in (self.loaded.origins, self.loaded.held):
            known.pop(body.handle, None)
        self._removed.append(body)

    def description_of(self, body: Body) -> BodyDescription | None:
        """Returns the description of a body, if the client still has the body."""
        known = self._known.get(body.handle)
        if known is None or known.body is not body or self._lost is not None:
            return None
        if self.is_external:
            # Its number may be another's by now.
            handles, tags = self._listed
            tag = dict(zip(handles, tags, strict=True)).get(body.handle)
            if self._call(lambda: self._tags_of([body.handle])) != [tag]:
                return None
        return known

    def count(self) -> int:
        """Returns the number of bodies that the client has now."""
        return self._call(lambda: int(pybullet.getNumBodies(self.client)))

    def visual_colours(self, body: Body) -> list[tuple[int, int, Sequence[float]]]:
        """Returns the colours of a body, shown or hidden: link, index of the shape, colour."""
        return self._colours.get(body) or self._call(
            lambda: visual_colours(self.client, body.handle)
        )

    def _forget(self, gone: Sequence[Body]) -> None:
        if not self.disabled.isdisjoint(gone):
            self.disabled -= frozenset(gone)
        if not self.hidden.isdisjoint(gone):
            self.hidden -= frozenset(gone)
            self._colours = {body: self._colours[body] for body in self.hidden}

    def _tags_of(self, handles: Sequence[int]) -> list[int]:
        get = pybullet.getUserDataId
        none = repeat(-1)
        return list(map(get, handles, repeat(self._tag), none, none, repeat(self.client)))

    def _read(self, handle: int, saved: SavedShapes) -> BodyDescription:
        read = self.loaded.described.pop(handle, None) or describe(
            self.client,
            handle,
            self._names.get(handle),
            self._kinds.get(handle),
            saved,
            self._given.get(handle),
        )
        pybullet.addUserData(handle, self._tag, "1", -1, -1, self.client)
        return read

    # -- state ----------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Simulated seconds, as counted by the clock."""
        return self.clock.time

    @property
    def timestep(self) -> float:
        """The length of the next step, simulated seconds, as the client is set now."""
        return self._clients_timestep()

    def set_clock(self, clock: Clock) -> None:
        """Replaces the clock."""
        self.clock = clock

    def read_link_poses(self, bodies: tuple[Body, ...], *, with_velocities: bool) -> LinkPoses:
        """Returns the poses of all links of some bodies as they are now, body after body."""
        if self._layout[0] is not bodies:
            self._layout = (
                bodies,
                LinkPosesReader(bodies, [self._known[b.handle].com for b in bodies]),
            )
        return self._call(lambda: self._layout[1].read(self.client, with_velocities))

    def read_joints(self, bodies: Sequence[Body]) -> Array:
        """Returns the position, velocity and effort of the joints of some bodies, (joints, 3)."""

        def read() -> Iterator[tuple[float, float, float]]:
            for body in bodies:
                indices = range(len(body.joints))
                for state in pybullet.getJointStates(body.handle, list(indices), self.client):
                    yield state[0], state[1], state[3]

        rows = self._call(lambda: list(read()))
        return np.array(rows, dtype=np.float64).reshape(-1, 3)

    def read_masses(self, bodies: Sequence[Body]) -> list[list[float]]:
        """Returns the masses of bodies' links; the last known ones if a body is gone."""
        there = self._are_there(bodies)
        client = self.client
        return self._call(
            lambda: [masses_of(client, b) if b in there else b.masses for b in bodies]
        )

    def read_margins(self, bodies: Sequence[Body]) -> list[list[float]]:
        """Returns the margins of bodies' shapes; the last known ones if a body is gone."""
        told = {body: self._known[body.handle].link_margins for body in self._are_there(bodies)}
        return self._call(
            lambda: [margins_of(self.client, body, told.get(body, ())) for body in bodies]
        )

    def _are_there(self, bodies: Sequence[Body]) -> set[Body]:
        """Returns the bodies that the client still has."""
        tags = dict(zip(*self._listed, strict=True))
        now = self._call(lambda: self._tags_of([body.handle for body in bodies]))
        return {b for b, tag in zip(bodies, now, strict=True) if tag == tags.get(b.handle)}

    def read_contacts(self) -> Iterable[Contact]:
        """Yields the contacts of the last step, without PyBullet's points of separate shapes."""
        for entry in self._call(lambda: pybullet.getContactPoints(physicsClientId=self.client)):
            if entry[8] <= 0.0:
                yield Contact(
                    body_a=entry[1],
                    link_a=entry[3] + 1,
                    body_b=entry[2],
                    link_b=entry[4] + 1,
                    point_a=entry[5],
                    point_b=entry[6],
                    normal=entry[7],
                    depth=-entry[8],
                    force=entry[9],
                    friction=_friction(entry),
                )

    def cast_rays(self, starts: Array, ends: Array, through: Indices) -> RayHits:
        """Returns the first body that each ray hits; see `ssduck.simulators.pybullet.rays`."""
        return self._call(lambda: cast_rays(self.client, starts, ends, through))

    def step(self, count: int) -> None:
        """Advances by a number of steps."""
        timestep = self._clients_timestep()

        def run() -> None:
            done = 0
            try:
                for _ in range(count):
                    # Ctrl-C is handled after the call, so that a step is counted before it runs.
                    done += 1
                    pybullet.stepSimulation(self.client)
            finally:
                self.clock = self.clock.after(done, timestep)

        self._call(run)

    def _clients_timestep(self) -> float:
        """Returns the client's time step, which the user may change at any time."""
        return float(self.parameters()["fixedTimeStep"])

    def parameters(self) -> dict[str, Any]:
        """Returns PyBullet's parameters of gravity, time step and solver."""
        told: dict[str, Any] = self._call(lambda: pybullet.getPhysicsEngineParameters(self.client))
        return told

    def place(self, body: Body, position: Array, orientation: Array) -> None:
        """Puts the base link frame of a body at a pose, at rest."""
        com = self._known[body.handle].com
        place, turn = compose(position[None], orientation[None], com[0][:1], com[1][:1])

        def put() -> None:
            pybullet.resetBasePositionAndOrientation(
                body.handle, place[0].tolist(), xyzw(turn)[0].tolist(), self.client
            )
            # Else its contacts would be those of the place where it was.
            pybullet.performCollisionDetection(self.client)

        self._call(put)

    def set_joints(self, body: Body, positions: Mapping[int, float]) -> None:
        """Sets joints by the indices of their links, at rest.

        The motors of a client that ssduck made hold the new positions.
        """

        def put() -> None:
            for link, position in positions.items():
                pybullet.resetJointState(body.handle, link - 1, position, 0.0, self.client)
                if not self.is_external:
                    hold_joint(body.handle, body.joints[link - 1], position, self.client)
                    self.loaded.held.setdefault(body.handle, {})[link] = position
            pybullet.performCollisionDetection(self.client)

        self._call(put)

    def drive(self, body: Body, motors: Mapping[int, MotorTarget]) -> None:
        """Sets motors of joints by the indices of their links for the next steps."""

        def put() -> None:
            for link, motor in motors.items():
                set_motor(body.handle, link, motor, self.client)

        self._call(put)

    def has_constraint(self, body: Body, other: Body) -> bool:
        """Checks whether a fixed constraint connects a link of a body to the base of another."""
        return bool(self._call(lambda: fixed_constraints(self.client, body.handle, other.handle)))

    def add_constraint(self, body: Body, link: int, other: Body) -> None:
        """Adds a fixed constraint between a link of a body and the base of another, as they are."""
        self._call(lambda: add_fixed_constraint(self.client, (body.handle, link - 1), other.handle))

    def remove_constraint(self, body: Body, other: Body) -> None:
        """Removes the fixed constraints between links of a body and the base of another."""

        def remove() -> None:
            for number in fixed_constraints(self.client, body.handle, other.handle):
                pybullet.removeConstraint(number, self.client)

        self._call(remove)

    def enable(self, body: Body, on: bool) -> None:
        """Switches the collisions of a body on or off.

        PyBullet does not return collision filters. A body that is switched on again gets the
        default ones.
        """
        if on == (body not in self.disabled):
            return

        def put() -> None:
            for link, part in enumerate(body.links):
                fixed = link == 0 and part.mass == 0.0
                group, mask = (_FIXED if fixed else _FREE) if on else (0, 0)
                pybullet.setCollisionFilterGroupMask(
                    body.handle, link - 1, group, mask, self.client
                )
            pybullet.performCollisionDetection(self.client)

        self._call(put)
        self.disabled = self.disabled - {body} if on else self.disabled | {body}

    def show(self, body: Body, on: bool) -> None:
        """Shows a body in the colours that it had, or hides it."""
        if on == (body not in self.hidden):
            return
        colours = self.visual_colours(body)

        def put() -> None:
            for link, shape, (*rgb, alpha) in colours:
                colour = [*rgb, alpha if on else 0.0]
                pybullet.changeVisualShape(
                    body.handle, link, shape, rgbaColor=colour, physicsClientId=self.client
                )

        self._call(put)
        self.hidden = self.hidden - {body} if on else self.hidden | {body}
        self._colours = {kept: self._colours.get(kept, colours) for kept in self.hidden}

    def render(
        self, camera: Camera, width: int, height: int, *, shadow: bool
    ) -> npt.NDArray[np.uint8]:
        """Returns a camera's colour image by PyBullet's software renderer, (height, width, 3)."""
        return self._drawn(width, height, *_seen(camera, width, height), shadow=shadow)

    def segment(self, camera: Camera, width: int, height: int) -> Indices:
        """Returns the number of the body in each pixel, (height, width); -1 for none."""
        view, lens = _seen(camera, width, height)
        bodies = self._call(
            lambda: pybullet.getCameraImage(
                width,
                height,
                view,
                lens,
                renderer=pybullet.ER_TINY_RENDERER,
                physicsClientId=self.client,
            )
        )[4]
        return np.asarray(bodies, dtype=np.intp).reshape(height, width)

    def photograph(self, view: CameraView) -> npt.NDArray[np.uint8]:
        """Returns the colour image of a camera on a body, by PyBullet's software renderer."""
        target = view.position + view.matrix[:, 0]
        seen = pybullet.computeViewMatrix(
            view.position.tolist(), target.tolist(), view.matrix[:, 2].tolist()
        )
        lens = pybullet.computeProjectionMatrixFOV(
            view.fov, view.width / view.height, NEAREST_DRAWN, FARTHEST_DRAWN
        )
        return self._drawn(view.width, view.height, seen, lens, shadow=False)

    def _drawn(
        self, width: int, height: int, view: Any, lens: Any, *, shadow: bool
    ) -> npt.NDArray[np.uint8]:
        picture = self._call(
            lambda: pybullet.getCameraImage(
                width,
                height,
                view,
                lens,
                lightDirection=(4.0, -6.0, 8.0),
                lightDistance=8.0,
                lightAmbientCoeff=0.65,
                lightDiffuseCoeff=0.6,
                lightSpecularCoeff=0.05,
                shadow=int(shadow),
                renderer=pybullet.ER_TINY_RENDERER,
                physicsClientId=self.client,
            )
        )[2]
        pixels = np.asarray(picture, dtype=np.uint8).reshape(height, width, 4)
        return np.ascontiguousarray(pixels[:, :, :3])

    def close(self) -> None:
        """Removes the tags from the bodies, and disconnects the client if ssduck made it."""
        if self._lost is not None:
            return
        self._lost = "the world is closed"
        if not pybullet.isConnected(self.client):
            return
        if self.is_external:
            for tag in self._listed[1]:
                pybullet.removeUserData(tag, self.client)
        else:
            pybullet.disconnect(self.client)

    def _call(self, function: Callable[[], T]) -> T:
        """Calls PyBullet and converts its errors into those of ssduck."""
        if self._lost is not None:
            raise SimulatorError(f"{self._lost}; load or attach the world again")
        try:
            return function()
        except pybullet.error as error:
            if not pybullet.isConnected(self.client):
                self._lost = f"PyBullet client {self.client} is disconnected"
                raise SimulatorError(f"{self._lost}; load or attach the world again") from error
            raise SimulatorError(f"PyBullet: {error}") from error


def _seen(camera: Camera, width: int, height: int) -> tuple[Any, Any]:
    """Returns PyBullet's view and projection matrices of a camera."""
    view = pybullet.computeViewMatrix(camera.eye, camera.target, (0.0, 0.0, 1.0))
    # A view much deeper than the scene has too little depth resolution: shadows get rings.
    depth = 3.0 * math.dist(camera.eye, camera.target)
    return view, pybullet.computeProjectionMatrixFOV(camera.fov, width / height, 0.05, depth)


def _warn_of_guesses(bodies: Sequence[Body]) -> None:
    if bodies:
        warn(
            f"{joined_names([body.name for body in bodies])}: PyBullet does not give back "
            "all shapes (a height field is such a shape); bounding boxes are used instead, which "
            "have exact = false in the table of shapes: World.attach(client, shapes={…}) takes "
            "the shapes themselves",
        )


def visual_colours(client: int, handle: int) -> list[tuple[int, int, Sequence[float]]]:
    """Returns the colours of a body: link, index among its visual shapes, colour."""
    shapes: Counter[int] = Counter()
    colours = []
    for entry in pybullet.getVisualShapeData(handle, physicsClientId=client):
        colours.append((entry[1], shapes[entry[1]], entry[7]))
        shapes[entry[1]] += 1
    return colours


def _friction(entry: Sequence[Any]) -> tuple[float, float, float]:
    """Returns the friction force on body A, along two directions normal to the contact normal."""
    (first, along), (second, beside) = (entry[10], entry[11]), (entry[12], entry[13])
    x, y, z = (first * a + second * b for a, b in zip(along, beside, strict=True))
    return x, y, z
