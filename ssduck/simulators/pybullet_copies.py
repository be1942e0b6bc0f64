"""Copies of bodies in a new PyBullet client: what `World.excerpt` is made of.

A body that ssduck loaded from a file is loaded from it again, with the same flags and in the same
order; any other gets a model that is written of what PyBullet, or a record, tells of it. Then
what differs is set: dynamics, colours, poses and velocities, joints, motors, constraints.

What PyBullet does, as measured with 3.2.7:

- A copy at load is the same to the last bit, and stays so: nothing is set that is so already.
- `saveBullet` and `restoreState` of a file carry over contacts from client to client if links
  have one shape each. Of a pair of bodies the importer restores one manifold, and into it the
  last one that the file has of that pair; bodies of several shapes have many. Such copies find
  their contacts anew, which shifts the kitchen by less than 0.1 mm in 2 s, as does a velocity
  that is 1e-15 m/s off.
- PyBullet does not tell the targets of motors (those of ssduck's own are remembered), damping of
  bodies, filters of collisions, and textures.
"""

from __future__ import annotations

import math
import tempfile
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ssduck.errors import SimulatorError, UnsupportedError
from ssduck.geometry import Array, Boxer, compose, invert
from ssduck.scenes import BodySpec, ConstraintSpec, Scene
from ssduck.simulators import SETTABLE, Body, Frames, Simulator
from ssduck.simulators.pybullet import (
    MOST_NAMED,
    PyBulletSimulator,
    colours_of,
    frames_of,
    new_client,
)
from ssduck.simulators.pybullet_bodies import Description, com_of, primitive_of, wxyz, xyzw
from ssduck.simulators.pybullet_console import captured, pybullet
from ssduck.simulators.pybullet_models import Drawn, Model, write_model, zero_poses
from ssduck.simulators.pybullet_scenes import (
    CONSTRAINTS,
    Filled,
    engine_of,
    hold_joint,
    load_body,
    load_model,
    make_constraint,
    next_to_zero,
    set_engine,
)

# A link of a client: the body's number, and PyBullet's of the link; -1, -1 is the world.
End: TypeAlias = tuple[int, int]

_SOFT_BODY = 3
# Where getDynamicsInfo tells what changeDynamics calls so. Margins are those of the shapes; of
# whatever link one is set, PyBullet sets the base's.
_DYNAMICS = {
    "mass": 0,
    "lateralFriction": 1,
    "localInertiaDiagonal": 2,
    "restitution": 5,
    "rollingFriction": 6,
    "spinningFriction": 7,
}
_CONTACT = {"contactDamping": 8, "contactStiffness": 9}
# What a model's file calls them.
_ELEMENTS = {
    "rolling_friction": 6,
    "spinning_friction": 7,
    "restitution": 5,
    "damping": 8,
    "stiffness": 9,
}
# The same of getJointInfo.
_JOINT = {"jointDamping": 6, "maxJointVelocity": 11}
_LIMITS = {"jointLowerLimit": 8, "jointUpperLimit": 9}


@dataclass(frozen=True, eq=False)
class Original:
    """A body that is to be copied, as a tick tells of it.

    Attributes:
        name: in its world.
        body: what it is made of.
        frames: where its links are.
        joints: their positions and velocities, (joints, 2); NaN for what nobody knows.
    """

    name: str
    body: Body
    frames: Frames
    joints: Array


@dataclass(frozen=True, eq=False)
class Tick:
    """What else a tick tells.

    Attributes:
        time: simulated seconds.
        disabled: the bodies that take no part in collisions.
        hidden: the bodies that are not drawn.
    """

    time: float
    disabled: frozenset[Body]
    hidden: frozenset[Body]


def excerpt(
    source: Simulator | None, originals: Sequence[Original], tick: Tick
) -> PyBulletSimulator:
    """A new simulation of some bodies as they are at a tick.

    Args:
        source: what runs them, or the world that the tick is of, now; None if nobody does any
            more.
        originals: the bodies, in load order.
        tick: when that is.

    Raises:
        SimulatorError: the source does not answer, or there is no room for another client.
        UnsupportedError: a body is soft.
        SceneError: a model's file cannot be loaded any more.
    """
    live = source if isinstance(source, PyBulletSimulator) else None
    if live is not None and _may_carry_contacts(live, originals, tick):
        with suppress(_NotCarriedError), new_client() as client:
            return _Copier(live, client, tick).copied(originals, carry=True)
    with new_client() as client:
        return _Copier(live, client, tick).copied(originals)


class _NotCarriedError(Exception):
    """Contacts were carried over to others than those that they are of."""


def _may_carry_contacts(
    source: PyBulletSimulator, originals: Sequence[Original], tick: Tick
) -> bool:
    """Whether the contacts of a client could be restored in a copy of all of it."""
    if len(originals) < source.count() or tick.disabled:
        return False
    shapes = [Counter(shape.frame for shape in o.body.shapes) for o in originals]
    return all(max(counts.values(), default=0) <= 1 for counts in shapes)


@dataclass(eq=False)
class _Copier:
    """Fills a client with copies.

    Attributes:
        source: what runs the originals now, if anything does.
        client: the new client.
        tick: when it is.
        filled: what is known of the copies.
        handles: the copies' numbers.
        guessed: what is not as it is in the source: names by what is said of them.
    """

    source: PyBulletSimulator | None
    client: int
    tick: Tick
    filled: Filled = field(default_factory=Filled)
    handles: dict[Body, int] = field(default_factory=dict)
    guessed: dict[str, list[str]] = field(default_factory=dict)

    def copied(self, originals: Sequence[Original], *, carry: bool = False) -> PyBulletSimulator:
        """Copy them; with the contacts that the solver knows of, if they are all there are.

        Raises:
            _NotCarriedError: other contacts are there then.
        """
        self.filled.time = self.tick.time
        self._set_up()
        with tempfile.TemporaryDirectory(prefix="ssduck") as folder:
            self._load(originals, Path(folder))
            as_now = [self._finish(original) for original in originals]
            self._tie()
            pybullet.performCollisionDetection(self.client)
            if carry and all(as_now):
                self._carry_contacts(Path(folder) / "state.bullet")
        self._warn()
        return PyBulletSimulator(self.client, owned=True, filled=self.filled)

    def _set_up(self) -> None:
        """Gravity, time step and solver are as in the source."""
        timestep, gravity = Scene.timestep, Scene.gravity
        if self.source is not None:
            told = self.source.parameters()
            timestep = told["fixedTimeStep"]
            gravity = tuple(told[f"gravityAcceleration{axis}"] for axis in "XYZ")
            set_engine(engine_of(self.source.client), self.client)
        pybullet.setTimeStep(timestep, self.client)
        pybullet.setGravity(*gravity, physicsClientId=self.client)

    # -- bodies ---------------------------------------------------------------------------

    def _load(self, originals: Sequence[Original], folder: Path) -> None:
        loaded: dict[int, Sequence[int]] = {}  # by entry of a scene, all bodies of its file
        for original in originals:
            spec, number = self._origin_of(original.body)
            if spec is None:
                handle = self._load_written(original, folder, len(self.handles))
            else:
                if id(spec) not in loaded:
                    loaded[id(spec)] = load_body(spec, "", self.filled, self.client)
                handle = loaded[id(spec)][number]
            if pybullet.getNumJoints(handle, self.client) != len(original.body.joints):
                raise SimulatorError(
                    f"the model of {original.name!r} has changed since it was loaded"
                )
            self.handles[original.body] = handle
        for handle in {h for handles in loaded.values() for h in handles}.difference(
            self.handles.values()
        ):
            pybullet.removeBody(handle, self.client)
        # What the scene's file says of them was at the start.
        self.filled.disabled, self.filled.hidden = set(), set()
        kept = self.handles.values()
        self.filled.origins = {h: o for h, o in self.filled.origins.items() if h in kept}
        self.filled.held = {h: o for h, o in self.filled.held.items() if h in kept}

    def _origin_of(self, body: Body) -> tuple[BodySpec | None, int]:
        """The entry of a scene that a body was loaded from, if it still can be."""
        if self.source is None or self._known(body) is None:
            return None, 0
        origin = self.source.filled.origins.get(body.handle)
        if origin is None or not origin.spec.model.is_file():
            return None, 0
        return origin.spec, origin.number

    def _known(self, body: Body) -> Description | None:
        return None if self.source is None else self.source.description_of(body)

    def _load_written(self, original: Original, folder: Path, number: int) -> int:
        """Load a body by a model that is written of what is known of it."""
        known = self._known(original.body)
        if known is None:
            model = _guessed_model(original)
            self._guess(
                "only shapes, links, joints and masses are known; inertia and centre of mass are "
                "those of the shapes, friction, damping and colours PyBullet's own, and joints "
                "are held",
                original,
            )
        else:
            assert self.source is not None
            model = model_of(self.source, original.body)
            if not known.exact:
                self._guess("not all shapes are given back; it collides as its box", original)
        path = write_model(model, folder, f"body_{number}")
        spec = BodySpec(None, None, path, own_inertia=known is not None)
        # Meshes of another copy may have been in a file of that name, and would be kept for ever.
        pybullet.setPhysicsEngineParameter(enableFileCaching=0, physicsClientId=self.client)
        (handle,) = load_model(spec, "", self.client)
        pybullet.setPhysicsEngineParameter(enableFileCaching=1, physicsClientId=self.client)
        return handle

    def _finish(self, original: Original) -> bool:
        """Let a loaded body be as the original is at the tick; tells whether it is so still."""
        body, handle = original.body, self.handles[original.body]
        known = self._known(body)
        com = com_of(self.client, handle)
        if known is not None:
            assert self.source is not None
            _copy_dynamics(self.source.client, body.handle, self.client, handle)
            _copy_colours(self.source.colours_of(body), self.client, handle)
        as_now = self._is_as_now(original)
        if as_now:
            assert self.source is not None
            state = state_of(self.source.client, body.handle)
        else:
            state = self._told_state(original, com, handle)
        set_state(self.client, handle, body, state)
        self._hold(original, state, handle)
        if body in self.tick.disabled:
            self.filled.disabled.add(handle)
        if body in self.tick.hidden:
            self.filled.hidden.add(handle)
        own = replace(body, handle=handle, name=original.name)
        self.filled.described[handle] = Description(own, com, exact=True)
        return as_now

    def _is_as_now(self, original: Original) -> bool:
        """Whether a body is in the source as it was at the tick, to the last digit."""
        body = original.body
        if self.source is None or self._known(body) is None:
            return False
        now, then = self.source.read_frames((body,), links_move=True), original.frames
        base = np.array([0])
        told = (
            (now.positions, then.positions),
            (now.states[:, 3:7], then.states[:, 3:7]),
            (now.at(now.positions[:1], base), then.at(then.positions[:1], base)),
        )
        if not all(np.array_equal(here, there) for here, there in told):
            return False
        joints = self.source.read_joints([body] if body.joints else [])[:, :2]
        # Those that the tick does not tell are as the links are.
        return bool((np.isnan(original.joints) | (joints == original.joints)).all())

    def _told_state(self, original: Original, com: tuple[Array, Array], handle: int) -> State:
        """A body's state as the tick tells of it."""
        frames = original.frames
        base = np.array([0])
        link = frames.positions[:1], frames.states[:1, 3:7]
        place, turn = compose(*link, com[0][:1], com[1][:1])
        (moving,) = frames.at(place, base)
        joints = original.joints
        if np.isnan(joints).any():
            joints = self._joints_by_frames(original, handle)
        if any(joint.type in ("spherical", "planar") for joint in original.body.joints):
            self._guess("spherical and planar joints are where the model has them", original)
        told = [
            ((float(position),), (float(velocity),)) if joint.type in SETTABLE else None
            for joint, (position, velocity) in zip(original.body.joints, joints, strict=True)
        ]
        return State(
            (tuple(place[0].tolist()), tuple(xyzw(turn)[0].tolist())),
            (tuple(moving[7:10].tolist()), tuple(moving[10:].tolist())),
            tuple(told),
        )

    def _joints_by_frames(self, original: Original, handle: int) -> Array:
        """Positions of joints that nobody has noted, from where the links are; at rest."""
        body = original.body
        what = "velocities" if self._known(body) is not None else "positions and velocities"
        self._guess(f"{what} of joints are not recorded; they rest where links are", original)
        here = frames_of(self.client, replace(body, handle=handle), com_of(self.client, handle))
        states = state_of(self.client, handle).joints
        at = np.array([[state[0][0] if state and state[0] else 0.0] for state in states])
        zero = zero_poses(body, here, _positions(body, at))
        parents = np.array([link.parent for link in body.links[1:]], dtype=np.intp)
        places, turns = original.frames.positions, original.frames.states[:, 3:7]
        within = compose(*invert(places[parents], turns[parents]), places[1:], turns[1:])
        shifts, twists = compose(*invert(*zero), *within)
        joints = np.zeros((len(body.joints), 2))
        for number, joint in enumerate(body.joints):
            axis = np.array(joint.axis)
            if joint.type == "revolute":
                joints[number, 0] = 2 * np.arctan2(twists[number, 1:] @ axis, twists[number, 0])
            elif joint.type == "prismatic":
                joints[number, 0] = shifts[number] @ axis / (axis @ axis)
        return joints

    def _hold(self, original: Original, state: State, handle: int) -> None:
        """Let motors hold joints where they do, or where they are at a tick that was before."""
        body = original.body
        held: Mapping[int, float] = {}
        now: State | None = None
        if self.source is not None and self._known(body) is not None:
            if self.source.watched and any(joint.type in SETTABLE for joint in body.joints):
                self._guess("what motors do is not told; they are as PyBullet begins", original)
            held = self.source.filled.held.get(body.handle, {})
            now = state_of(self.source.client, body.handle) if held else None
        elif self.source is None or self._known(body) is None:
            held = {joint.link: 0.0 for joint in body.joints if joint.type in SETTABLE}
        begun = self.filled.held.get(handle, {})
        targets = {}
        for link, target in held.items():
            there = state.joints[link - 1]
            assert there is not None
            moved = now is None or now.joints[link - 1] != there
            targets[link] = there[0][0] if moved else target
            if begun.get(link) != targets[link]:
                hold_joint(handle, body.joints[link - 1], targets[link], self.client)
        self.filled.held[handle] = targets

    def _carry_contacts(self, file: Path) -> None:
        """Restore the contacts that the solver knows of, and the impulses that it begins with.

        They are found by numbers that count the colliders ever made in a client, which are the
        same here if none was removed there.

        Raises:
            _NotCarriedError: they are not those of the same bodies.
        """
        assert self.source is not None
        source, client = self.source.client, self.client
        with captured():  # it tells of each that it does not find
            pybullet.saveBullet(str(file), source)
            pybullet.restoreState(fileName=str(file), physicsClientId=client)
        handles = {body.handle: handle for body, handle in self.handles.items()}
        there = _contacts(source, handles)
        if there != _contacts(client, {handle: handle for handle in handles.values()}):
            raise _NotCarriedError

    # -- constraints ----------------------------------------------------------------------

    def _tie(self) -> None:
        """Make the constraints between the bodies, and to the world."""
        if self.source is None:
            return
        known = [body for body in self.handles if self._known(body) is not None]
        handles = {body.handle: self.handles[body] for body in known}
        handles[-1] = -1
        for spec, on, to in constraints_of(self.source.client):
            if on[0] in handles and to[0] in handles:
                ends = [(handles[body], link) for body, link in (on, to)]
                make_constraint(spec, ends[0], ends[1], self.client)

    # -- what is not as it was ------------------------------------------------------------

    def _guess(self, what: str, original: Original) -> None:
        self.guessed.setdefault(what, []).append(original.name)

    def _warn(self) -> None:
        if self.source is None:
            self.guessed["gravity and time step are not recorded; they are as in a new scene"] = []
        for what, names in self.guessed.items():
            told = ", ".join(names[:MOST_NAMED])
            if len(names) > MOST_NAMED:
                told += f" and {len(names) - MOST_NAMED} more"
            warnings.warn(f"{told}: {what}" if told else what, stacklevel=6)


# -- states -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class State:
    """Where a body is in a client, as PyBullet tells and takes it.

    Attributes:
        base: position and orientation (x, y, z, w) of the base's centre of mass.
        twist: its velocity and angular velocity.
        joints: positions and velocities of each joint, as many numbers as it has; None for what
            is left as it is.
    """

    base: tuple[tuple[float, ...], tuple[float, ...]]
    twist: tuple[tuple[float, ...], tuple[float, ...]]
    joints: tuple[tuple[tuple[float, ...], tuple[float, ...]] | None, ...]


def state_of(client: int, handle: int) -> State:
    """The state of a body."""
    joints = [
        pybullet.getJointStateMultiDof(handle, joint, client)[:2]
        for joint in range(pybullet.getNumJoints(handle, client))
    ]
    return State(
        pybullet.getBasePositionAndOrientation(handle, client),
        pybullet.getBaseVelocity(handle, client),
        tuple(joints),
    )


def set_state(client: int, handle: int, body: Body, state: State) -> None:
    """Put a body into a state; what is so already is left to the last bit."""
    if state_of(client, handle).base != state.base:
        pybullet.resetBasePositionAndOrientation(handle, *state.base, client)
    if state_of(client, handle).twist != state.twist:
        pybullet.resetBaseVelocity(handle, *state.twist, client)
    now = state_of(client, handle)
    for joint, here, there in zip(body.joints, now.joints, state.joints, strict=True):
        if there is None or here == there:
            continue
        if joint.type in SETTABLE:
            (position,), (velocity,) = there
            pybullet.resetJointState(handle, joint.link - 1, position, velocity, client)
        elif joint.type == "spherical":
            pybullet.resetJointStateMultiDof(handle, joint.link - 1, *there, client)


def _contacts(client: int, handles: Mapping[int, int]) -> list[tuple[Any, ...]]:
    """What contacts there are: the bodies by other numbers, the links, places to 1e-9 m."""
    found = [
        (handles[a], link_a, handles[b], link_b, *(round(x, 9) for x in (*at_a, *at_b)))
        for _, a, b, link_a, link_b, at_a, at_b, *_ in pybullet.getContactPoints(
            physicsClientId=client
        )
    ]
    return sorted(found)


def _copy_dynamics(source: int, original: int, client: int, handle: int) -> None:
    """Set of masses, inertias, friction and the like what differs."""
    count = pybullet.getNumJoints(handle, client)
    for link in range(-1, count):
        own = pybullet.getDynamicsInfo(handle, link, client)
        wanted = pybullet.getDynamicsInfo(original, link, source)
        if wanted[10] != own[10]:
            continue  # of a rigid body PyBullet tells what happened to be in memory
        changes = {k: wanted[at] for k, at in _DYNAMICS.items() if wanted[at] != own[at]}
        if any(wanted[at] != own[at] for at in _CONTACT.values()):
            changes |= {key: wanted[at] for key, at in _CONTACT.items()}
        if link >= 0:
            own = pybullet.getJointInfo(handle, link, client)
            wanted = pybullet.getJointInfo(original, link, source)
            changes |= {k: wanted[at] for k, at in _JOINT.items() if wanted[at] != own[at]}
            limits = {key: wanted[at] for key, at in _LIMITS.items()}
            is_limited = limits["jointLowerLimit"] <= limits["jointUpperLimit"]
            if is_limited and any(wanted[at] != own[at] for at in _LIMITS.values()):
                changes |= limits
        if changes:
            pybullet.changeDynamics(handle, link, physicsClientId=client, **changes)


def _copy_colours(
    wanted: Sequence[tuple[int, int, Sequence[float]]], client: int, handle: int
) -> None:
    own_colours = {(link, shape): colour for link, shape, colour in colours_of(client, handle)}
    for link, shape, colour in wanted:
        own = own_colours.get((link, shape))
        if own is not None and tuple(own) != tuple(colour):
            pybullet.changeVisualShape(
                handle, link, shape, rgbaColor=colour, physicsClientId=client
            )


# -- what models say --------------------------------------------------------------------------


def model_of(simulator: PyBulletSimulator, body: Body) -> Model:
    """What a model's file would say of a body.

    Raises:
        UnsupportedError: it is soft.
    """
    client, handle = simulator.client, body.handle
    dynamics = [pybullet.getDynamicsInfo(handle, i, client) for i in range(-1, len(body.joints))]
    if dynamics[0][10] == _SOFT_BODY:
        raise UnsupportedError(f"{body.name!r} is soft: PyBullet does not tell what it is made of")
    known = simulator.description_of(body)
    assert known is not None
    infos = [pybullet.getJointInfo(handle, index, client) for index in range(len(body.joints))]
    frames = simulator.read_frames((body,), links_move=True)
    joints = simulator.read_joints([body] if body.joints else [])
    return Model(
        body,
        zero_poses(body, frames, _positions(body, joints)),
        known.com,
        np.array([dynamic[2] for dynamic in dynamics]),
        [info[6] for info in infos],
        [_contact(dynamic) for dynamic in dynamics],
        list(_drawn(simulator, body)),
    )


def _contact(dynamic: Sequence[Any]) -> dict[str, float]:
    """What contacts with a link are like; 0 and -1 are what PyBullet begins with."""
    told = {element: float(dynamic[at]) for element, at in _ELEMENTS.items()}
    return {element: value for element, value in told.items() if value not in (0.0, -1.0)} | {
        "lateral_friction": float(dynamic[1])
    }


def _guessed_model(original: Original) -> Model:
    """What a record tells of a body; its masses are in the middles of its shapes."""
    body, joints = original.body, original.joints
    positions = _positions(body, joints)
    com = np.array([_middle(body, link) for link in range(len(body.links))])
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (len(com), 1))
    return Model(
        body,
        zero_poses(body, original.frames, positions),
        (com, turns),
        None,
        [0.0] * len(body.joints),
        [{}] * len(body.links),
        None,
    )


def _positions(body: Body, joints: Array) -> dict[int, float]:
    """Where joints are, by link; of what nobody knows, 0 or the limit next to it."""
    found = {}
    for joint, states in zip(body.joints, joints, strict=True):
        if joint.type in SETTABLE:
            position = float(states[0])
            found[joint.link] = next_to_zero(joint) if math.isnan(position) else position
    return found


def _middle(body: Body, link: int) -> Array:
    """The middle of a link's shapes in its frame, by the volumes of their boxes."""
    shapes = [replace(shape, frame=0) for shape in body.shapes if shape.frame == link]
    if not shapes or any(shape.geometry.type == "plane" for shape in shapes):
        return np.zeros(3)
    boxer = Boxer(shapes, range(len(shapes)), len(shapes))
    boxes = boxer.boxes(np.zeros((1, 3)), np.eye(3)[None])
    low, high = boxes[:3].T, boxes[3:].T
    volumes = np.prod(high - low, axis=1)
    middle: Array = np.average((low + high) / 2, axis=0, weights=volumes + 1e-12)
    return middle


def _drawn(simulator: PyBulletSimulator, body: Body) -> Iterator[Drawn]:
    entries = pybullet.getVisualShapeData(body.handle, physicsClientId=simulator.client)
    colours = simulator.colours_of(body)
    for entry, (link, _, colour) in zip(entries, colours, strict=True):
        geometry = primitive_of(entry[2], entry[3])
        yield Drawn(
            link + 1,
            geometry,
            entry[4].decode(errors="replace"),
            entry[3],
            np.array(entry[5]),
            wxyz(np.array([entry[6]]))[0],
            colour,
        )


def constraints_of(client: int) -> Iterator[tuple[ConstraintSpec, End, End]]:
    """The constraints of a client, with the links that each is between; -1, -1 is the world."""
    names = {number: name for name, number in CONSTRAINTS.items()}
    for index in range(pybullet.getNumConstraints(client)):
        number = pybullet.getConstraintUniqueId(index, physicsClientId=client)
        info = pybullet.getConstraintInfo(number, client)
        (turn,), (to_turn,) = (wxyz(np.array([info[at]])).tolist() for at in (8, 9))
        spec = ConstraintSpec(
            type=names[info[4]],
            on="",
            axis=info[5],
            position=info[6],
            orientation=tuple(turn),
            to_position=info[7],
            to_orientation=tuple(to_turn),
            max_force=info[10],
            gear_ratio=info[11],
            gear_link=info[12],
            gear_target=info[13],
            erp=info[14],
        )
        yield spec, (info[0], info[1]), (info[2], info[3])
