"""PyBullet behind the interface of `ssduck.simulators`; the only module that imports pybullet.

PyBullet reports the pose of a link's centre of mass; what leaves this module is the link
frame: `X_W_link = X_W_com * inverse(X_link_com)`, X_link_com from `getDynamicsInfo`. Its
quaternions are x, y, z, w. Its padded boxes are not used: shapes are read once and boxed
exactly (ssduck.geometry).
"""

from __future__ import annotations

import os
import sys
import tempfile
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import chain, repeat
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from ssduck.errors import SceneError, SelectScriptError, SimulatorError, nearest
from ssduck.geometry import (
    Array,
    Geometry,
    PlacedGeometry,
    compose,
    invert,
    load_hulls,
    load_mesh,
    multiply,
    rotate,
    rotation_matrices,
)
from ssduck.scenes import BodySpec, Camera, Scene
from ssduck.simulators import Body, Contact, Frames, Joint, Kind, Link


@contextmanager
def _captured() -> Iterator[list[str]]:
    """Keep what Bullet's C code prints off the user's terminal; the list gets the lines."""
    lines: list[str] = []
    with tempfile.TemporaryFile() as sink:
        kept = {}
        for stream, number in ((sys.stdout, 1), (sys.stderr, 2)):
            if stream is not None:
                stream.flush()
            kept[number] = os.dup(number)
            os.dup2(sink.fileno(), number)
        try:
            yield lines
        finally:
            for number, copy in kept.items():
                os.dup2(copy, number)
                os.close(copy)
            sink.seek(0)
            lines += sink.read().decode(errors="replace").splitlines()


with _captured():  # the module prints its build time when it is imported
    import pybullet

# The joint types by PyBullet's numbers; a point-to-point joint cannot come from a model file.
_JOINT_TYPES = {
    pybullet.JOINT_REVOLUTE: "revolute",
    pybullet.JOINT_PRISMATIC: "prismatic",
    pybullet.JOINT_SPHERICAL: "spherical",
    pybullet.JOINT_PLANAR: "planar",
    pybullet.JOINT_FIXED: "fixed",
}
_TAG = "ssduck"
_flatten = chain.from_iterable


class PyBulletSimulator:
    """A PyBullet client as a `Simulator`.

    Args:
        client: the number of a connected client.
        timestep: seconds a step, None to take the client's.
        owned: whether ssduck made the client and disconnects it; else others may change it.
        names: names by PyBullet body number, instead of those of the models.
        kinds: kinds by PyBullet body number, instead of robot for what has movable joints.
    """

    def __init__(
        self,
        client: int,
        *,
        owned: bool,
        timestep: float | None = None,
        names: Mapping[int, str] | None = None,
        kinds: Mapping[int, Kind] | None = None,
    ) -> None:
        self.client = client
        self.watched = not owned
        self._names = dict(names or {})
        self._kinds = dict(kinds or {})
        self._steps = 0
        self._timestep = timestep or self._call(
            lambda: float(pybullet.getPhysicsEngineParameters(client)["fixedTimeStep"])
        )
        self._bodies: dict[int, Body] = {}
        self._tags: dict[int, int] = {}
        self._inertial: dict[int, tuple[Array, Array]] = {}
        self._layout: tuple[tuple[int, ...], _Layout] = ((), _Layout([], []))
        # Two worlds on one client must not take each other's tags for their own.
        self._tag = f"{_TAG}.{id(self)}"

    # -- bodies ---------------------------------------------------------------------------

    def describe(self) -> tuple[list[Body], list[Body]] | None:
        """Bodies that came and went since the last call.

        PyBullet gives the number of a removed body to the next one at once, so every known
        body carries a tag (user data, which goes with it) that tells the two apart.
        """
        handles = self._call(self.handles)
        tags = list(map(self._tag_of, handles))
        if tags == list(map(self._tags.get, handles)) and len(handles) == len(self._bodies):
            return None
        kept = {h for h, tag in zip(handles, tags, strict=True) if self._tags.get(h) == tag}
        gone = [body for handle, body in self._bodies.items() if handle not in kept]
        for body in gone:
            for known in (self._bodies, self._tags, self._inertial):
                known.pop(body.handle, None)
        came = [self._call(lambda h=h: self._describe(h)) for h in handles if h not in kept]
        return came, gone

    def handles(self) -> list[int]:
        """The numbers of the client's bodies."""
        count = pybullet.getNumBodies(self.client)
        return [pybullet.getBodyUniqueId(index, self.client) for index in range(count)]

    def _tag_of(self, handle: int) -> int:
        return int(pybullet.getUserDataId(handle, self._tag, -1, -1, self.client))

    def _describe(self, handle: int) -> Body:
        link_name, body_name = (
            text.decode(errors="replace") for text in pybullet.getBodyInfo(handle, self.client)
        )
        count = pybullet.getNumJoints(handle, self.client)
        infos = [pybullet.getJointInfo(handle, index, self.client) for index in range(count)]
        dynamics = [
            pybullet.getDynamicsInfo(handle, link, self.client) for link in range(-1, count)
        ]
        joints = tuple(_joint(info) for info in infos)
        parents = [-1] + [info[16] + 1 for info in infos]
        names = [link_name] + [info[12].decode(errors="replace") for info in infos]
        jointed = any(joint.type != "fixed" for joint in joints)
        body = Body(
            handle=handle,
            name=self._names.get(handle) or body_name or f"body_{handle}",
            kind=self._kinds.get(handle) or ("robot" if jointed else "kinbody"),
            movable=jointed or dynamics[0][0] > 0.0,
            links=tuple(
                Link(name, parent, float(dynamic[0]))
                for name, parent, dynamic in zip(names, parents, dynamics, strict=True)
            ),
            joints=joints,
            shapes=(),
        )
        inertial = (
            np.array([dynamic[3] for dynamic in dynamics], dtype=np.float64),
            _wxyz(np.array([dynamic[4] for dynamic in dynamics], dtype=np.float64)),
        )
        self._inertial[handle] = inertial
        shapes = [s for link in range(count + 1) for s in self._shapes(body, link, inertial)]
        self._bodies[handle] = body = replace(body, shapes=tuple(shapes))
        pybullet.addUserData(handle, self._tag, "1", -1, -1, self.client)
        self._tags[handle] = self._tag_of(handle)
        return body

    # -- shapes ---------------------------------------------------------------------------

    def _shapes(
        self, body: Body, link: int, inertial: tuple[Array, Array]
    ) -> Iterator[PlacedGeometry]:
        """The collision shapes of a link in its link frame (link 0 is the base)."""
        data = pybullet.getCollisionShapeData(body.handle, link - 1, self.client)
        origin = inertial[0][[link]], inertial[1][[link]]
        for index, entry in enumerate(data):
            local = np.array([entry[5]]), _wxyz(np.array([entry[6]]))
            place = compose(*origin, *local)
            primitive = _primitive(entry)
            if primitive is not None:
                yield PlacedGeometry(link, primitive, place[0][0], place[1][0])
            elif entry[2] == pybullet.GEOM_MESH:
                yield from self._mesh(body, link, index, entry, origin, place)
            else:
                what = f"a shape of PyBullet's type {entry[2]}"
                yield self._stand_in(body, link, what, origin)

    def _mesh(
        self,
        body: Body,
        link: int,
        index: int,
        entry: tuple[Any, ...],
        origin: tuple[Array, Array],
        place: tuple[Array, Array],
    ) -> Iterator[PlacedGeometry]:
        """A mesh: convex hulls, or the surface of a concave one.

        PyBullet makes one hull of each object in an OBJ file, gives back the first only, and
        that rounded to about a 10,000th of its size; so files are read where there are any.
        """
        file = Path(entry[4].decode(errors="replace"))
        _, vertices = pybullet.getMeshData(
            body.handle, link - 1, collisionShapeIndex=index, physicsClientId=self.client
        )
        concave = not vertices  # PyBullet keeps the triangles of a concave mesh to itself
        if file.is_file() and (concave or file.suffix.lower() in (".obj", ".stl")):
            scale = tuple(map(float, entry[3]))
            pieces = load_mesh(file, scale) if concave else load_hulls(file, scale)
            for piece in pieces:
                yield PlacedGeometry(link, piece, place[0][0], place[1][0])
        elif concave:
            what = "a concave mesh that came from no file"
            yield self._stand_in(body, link, what, origin)
        else:  # given in the inertial frame
            yield PlacedGeometry(link, Geometry.hull(vertices), origin[0][0], origin[1][0])

    def _stand_in(
        self, body: Body, link: int, what: str, origin: tuple[Array, Array]
    ) -> PlacedGeometry:
        """What is used for a shape that PyBullet does not give back: its box, and a warning."""
        low, high = pybullet.getAABB(body.handle, link - 1, self.client)
        position, orientation = self._com_pose(body.handle, link)
        corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
        world = np.array(low) + corners * (np.array(high) - np.array(low))
        # Row vectors times R are those turned by the inverse of R.
        local = (world - position) @ rotation_matrices(orientation[None])[0]
        warnings.warn(
            f"{body.name}: link {body.links[link].name!r} has {what}, which PyBullet does not "
            "give back; its bounding box is used instead",
            stacklevel=2,
        )
        return PlacedGeometry(link, Geometry.hull(local), origin[0][0], origin[1][0])

    def _com_pose(self, handle: int, link: int) -> tuple[Array, Array]:
        if link == 0:
            pose = pybullet.getBasePositionAndOrientation(handle, self.client)
        else:
            pose = pybullet.getLinkState(handle, link - 1, 0, 1, self.client)
        return np.array(pose[0]), _wxyz(np.array(pose[1])[None])[0]

    # -- state ----------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Simulated seconds: the steps that ssduck has run, in the client's time step."""
        return self._steps * self._timestep

    def read_frames(self, bodies: Sequence[Body]) -> Frames:
        """All frames of these bodies as they are now, body after body."""
        handles = tuple(body.handle for body in bodies)
        if self._layout[0] != handles:
            self._layout = (handles, _Layout(bodies, [self._inertial[h] for h in handles]))
        frames: Frames = self._call(lambda: self._layout[1].read(self.client))
        return frames

    def read_joints(self, bodies: Sequence[Body]) -> Array:
        """Position, velocity and effort of these bodies' joints, (joints, 3)."""

        def read() -> Iterator[tuple[float, float, float]]:
            for body in bodies:
                indices = range(len(body.joints))
                for state in pybullet.getJointStates(body.handle, list(indices), self.client):
                    yield state[0], state[1], state[3]

        rows: list[tuple[float, float, float]] = self._call(lambda: list(read()))
        return np.array(rows, dtype=np.float64).reshape(-1, 3)

    def read_contacts(self) -> Iterable[Contact]:
        """The points of the last step at which shapes meet; PyBullet's near misses left out."""
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
                )

    def step(self, count: int) -> None:
        """Advance by that many steps."""

        def run() -> None:
            for _ in range(count):
                pybullet.stepSimulation(self.client)
                self._steps += 1

        self._call(run)

    def place(self, body: Body, position: Array, orientation: Array) -> None:
        """Put a body's base link frame there."""
        inner_position, inner_orientation = self._inertial[body.handle]
        com, turn = compose(
            position[None], orientation[None], inner_position[:1], inner_orientation[:1]
        )
        self._call(
            lambda: pybullet.resetBasePositionAndOrientation(
                body.handle, com[0].tolist(), _xyzw(turn)[0].tolist(), self.client
            )
        )

    def render(self, camera: Camera, width: int, height: int) -> npt.NDArray[np.uint8]:
        """A colour picture by PyBullet's software renderer, (height, width, 3)."""
        view = pybullet.computeViewMatrix(camera.eye, camera.target, (0.0, 0.0, 1.0))
        lens = pybullet.computeProjectionMatrixFOV(camera.fov, width / height, 0.05, 50.0)
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
                shadow=1,
                renderer=pybullet.ER_TINY_RENDERER,
                physicsClientId=self.client,
            )
        )[2]
        pixels = np.asarray(picture, dtype=np.uint8).reshape(height, width, 4)
        return np.ascontiguousarray(pixels[:, :, :3])

    def close(self) -> None:
        """Disconnect the client if ssduck made it."""
        if not self.watched and pybullet.isConnected(self.client):
            pybullet.disconnect(self.client)

    def _call(self, function: Any) -> Any:
        """Call PyBullet; its errors say which of ssduck's they are."""
        try:
            return function()
        except pybullet.error as error:
            if not pybullet.isConnected(self.client):
                raise SimulatorError(
                    f"PyBullet client {self.client} is disconnected; load or attach the world again"
                ) from error
            raise SimulatorError(f"PyBullet: {error}") from error


class _Layout:
    """How the frames of a fixed list of bodies are read: worked out once, used every tick."""

    def __init__(self, bodies: Sequence[Body], inertial: Sequence[tuple[Array, Array]]) -> None:
        self.handles = [body.handle for body in bodies]
        self.linked = [
            (body.handle, list(range(len(body.links) - 1)))
            for body in bodies
            if len(body.links) > 1
        ]
        counts = [len(body.links) for body in bodies]
        starts = np.concatenate(([0], np.cumsum(counts))).astype(np.intp)
        self.count = int(starts[-1])
        self.bases = starts[:-1]
        is_base = np.zeros(self.count, dtype=bool)
        is_base[self.bases] = True
        self.rest = np.flatnonzero(~is_base)
        positions = [pose[0] for pose in inertial] or [np.zeros((0, 3))]
        orientations = [pose[1] for pose in inertial] or [np.zeros((0, 4))]
        self.com_in_link, turned = np.concatenate(positions), np.concatenate(orientations)
        self.link_in_com = invert(self.com_in_link, turned)
        self.turned = bool(np.any(np.abs(turned[:, 1:]) > 0.0))
        self.shifted = bool(np.any(self.com_in_link != 0.0))

    def read(self, client: int) -> Frames:
        handles, number = self.handles, len(self.handles)
        # Through iterators in C: flattening in a Python loop would cost as much as the calls.
        poses = np.fromiter(
            _flatten(
                _flatten(map(pybullet.getBasePositionAndOrientation, handles, repeat(client)))
            ),
            np.float64,
            7 * number,
        ).reshape(number, 7)
        twists = np.fromiter(
            _flatten(_flatten(map(pybullet.getBaseVelocity, handles, repeat(client)))),
            np.float64,
            6 * number,
        ).reshape(number, 6)
        if self.linked:
            poses, twists = self._with_links(client, poses, twists)
        return self._link_frames(poses, twists)

    def _with_links(self, client: int, poses: Array, twists: Array) -> tuple[Array, Array]:
        """The bases' rows with those of the links between them."""
        # Links are read with forward kinematics: without, they lag the base by a step.
        states = (
            pybullet.getLinkStates(handle, links, 1, 1, client) for handle, links in self.linked
        )
        # Of a state: pose of the centre of mass, local and link frame poses, velocities.
        rows = np.fromiter(
            _flatten(_flatten(_flatten(states))), np.float64, 27 * len(self.rest)
        ).reshape(-1, 27)
        all_poses, all_twists = np.zeros((self.count, 7)), np.zeros((self.count, 6))
        all_poses[self.bases], all_twists[self.bases] = poses, twists
        all_poses[self.rest], all_twists[self.rest] = rows[:, :7], rows[:, 21:]
        return all_poses, all_twists

    def _link_frames(self, poses: Array, twists: Array) -> Frames:
        """From the centres of mass to the link frames."""
        positions, orientations = poses[:, :3], _wxyz(poses[:, 3:])
        linear, angular = twists[:, :3], twists[:, 3:]
        if self.turned:
            orientations = multiply(orientations, self.link_in_com[1])
        if self.shifted:
            # From the centre of mass to the link frame's origin, in the world frame.
            arms = rotate(rotation_matrices(orientations), -self.com_in_link)
            positions = positions + arms
            linear = linear + np.cross(angular, arms)
        return Frames(positions, orientations, linear, angular)


# -- loading ----------------------------------------------------------------------------------


def load(scene: Scene) -> PyBulletSimulator:
    """A new PyBullet simulation of a scene.

    Raises:
        SceneError: a model cannot be loaded: file, key and reason.
    """
    client = pybullet.connect(pybullet.DIRECT)
    if client < 0:
        raise SimulatorError("PyBullet could not make another client")
    try:
        return _load(scene, client)
    except BaseException:
        pybullet.disconnect(client)
        raise


def _load(scene: Scene, client: int) -> PyBulletSimulator:
    pybullet.setTimeStep(scene.timestep, client)
    pybullet.setGravity(*scene.gravity, physicsClientId=client)
    names: dict[int, str] = {}
    kinds: dict[int, Kind] = {}
    for index, spec in enumerate(scene.bodies):
        place = f"{scene.path}: body[{index}]" if spec.name else str(scene.path)
        for handle in _load_model(spec, place, client):
            if spec.name:
                names[handle] = spec.name
            if spec.kind:
                kinds[handle] = spec.kind
            _set_joints(handle, spec, place, client)
    return PyBulletSimulator(client, owned=True, timestep=scene.timestep, names=names, kinds=kinds)


def _load_model(spec: BodySpec, place: str, client: int) -> Sequence[int]:
    """Load a model file; an SDF or MJCF file may hold several bodies."""
    if spec.name and spec.model.suffix != ".urdf":
        raise SceneError(f"{place}.urdf: {spec.model.name!r} is no URDF file; load it by itself")
    file = str(spec.model)
    with _captured() as lines:
        try:
            if spec.model.suffix == ".urdf":
                return (_load_urdf(spec, file, client),)
            if spec.model.suffix == ".sdf":
                return cast("Sequence[int]", pybullet.loadSDF(file, physicsClientId=client))
            return cast("Sequence[int]", pybullet.loadMJCF(file, physicsClientId=client))
        except pybullet.error as error:
            failure = error
    reason = " ".join(line.strip() for line in lines if line.strip()) or str(failure)
    raise SceneError(f"{place}.urdf: {file} cannot be loaded: {reason}") from failure


def _load_urdf(spec: BodySpec, file: str, client: int) -> int:
    handle = pybullet.loadURDF(
        file,
        useFixedBase=spec.fixed,
        # Cylinders stay cylinders; PyBullet would make prisms of them.
        flags=pybullet.URDF_USE_IMPLICIT_CYLINDER,
        physicsClientId=client,
    )
    # loadURDF's own position is that of the root's centre of mass or of its link frame
    # according to its flags; placing the link frame here leaves no doubt.
    dynamics = pybullet.getDynamicsInfo(handle, -1, client)
    position, orientation = compose(
        np.array([spec.position]),
        np.array([spec.orientation]),
        np.array([dynamics[3]]),
        _wxyz(np.array([dynamics[4]])),
    )
    pybullet.resetBasePositionAndOrientation(
        handle, position[0].tolist(), _xyzw(orientation)[0].tolist(), client
    )
    return int(handle)


def _set_joints(handle: int, spec: BodySpec, place: str, client: int) -> None:
    """Set the initial joint positions, and let motors hold joints with limits where they are.

    Joints without limits are wheels and the like; their motors hold them at velocity 0.
    """
    count = pybullet.getNumJoints(handle, client)
    infos = [pybullet.getJointInfo(handle, index, client) for index in range(count)]
    by_name = {info[1].decode(errors="replace"): info for info in infos}
    for name in spec.joints:
        if name not in by_name:
            raise SceneError(
                f"{place}.joints.{name}: {spec.model.name} has no such joint",
                suggestions=nearest(name, by_name),
            )
    for name, info in by_name.items():
        joint = _joint(info)
        if joint.type not in ("revolute", "prismatic"):
            continue
        value = spec.joints.get(name, 0.0)
        pybullet.resetJointState(handle, info[0], value, 0.0, client)
        effort = joint.max_effort if joint.max_effort is not None else 0.0
        held = joint.lower is not None
        pybullet.setJointMotorControl2(
            handle,
            info[0],
            pybullet.POSITION_CONTROL if held else pybullet.VELOCITY_CONTROL,
            force=effort,
            physicsClientId=client,
            **({"targetPosition": value} if held else {"targetVelocity": 0.0}),
        )


def attach(
    client: Any, names: Mapping[int, str] | None, kinds: Mapping[int, Kind] | None
) -> PyBulletSimulator:
    """The user's own client: its number, or an object that holds it as `_client`."""
    number = getattr(client, "_client", client)
    if not isinstance(number, int) or not pybullet.isConnected(number):
        raise SimulatorError(f"{client!r} is no connected PyBullet client")
    simulator = PyBulletSimulator(number, owned=False, names=names, kinds=kinds)
    handles = simulator.handles()
    for handle in (*(names or {}), *(kinds or {})):
        if handle not in handles:
            raise SelectScriptError(
                f"PyBullet has no body {handle}; its bodies are {', '.join(map(str, handles))}"
            )
    return simulator


def _primitive(entry: tuple[Any, ...]) -> Geometry | None:
    """The geometry of a collision shape that is no mesh; None for what is none of these."""
    kind, (a, b, c) = entry[2], entry[3]
    if kind == pybullet.GEOM_BOX:
        return Geometry.primitive("box", (a, b, c))
    if kind == pybullet.GEOM_SPHERE:
        return Geometry.primitive("sphere", (a, 0.0, 0.0))
    if kind == pybullet.GEOM_CYLINDER:  # PyBullet gives height, radius
        return Geometry.primitive("cylinder", (b, a, 0.0))
    if kind == pybullet.GEOM_CAPSULE:
        return Geometry.primitive("capsule", (b, a, 0.0))
    if kind == pybullet.GEOM_PLANE:
        return Geometry.primitive("plane", (a, b, c))
    return None


def _joint(info: tuple[Any, ...]) -> Joint:
    lower, upper = float(info[8]), float(info[9])
    limited = lower <= upper and (lower, upper) != (0.0, 0.0)
    return Joint(
        name=info[1].decode(errors="replace"),
        type=_JOINT_TYPES.get(info[2], "fixed"),  # type: ignore[arg-type]
        link=int(info[0]) + 1,
        lower=lower if limited else None,
        upper=upper if limited else None,
        max_effort=float(info[10]) or None,
        max_velocity=float(info[11]) or None,
    )


def _wxyz(orientations: Array) -> Array:
    return orientations[:, [3, 0, 1, 2]]


def _xyzw(orientations: Array) -> Array:
    return orientations[:, [1, 2, 3, 0]]
