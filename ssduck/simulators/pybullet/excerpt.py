"""Copies bodies into a new PyBullet client, for `World.excerpt`.

A body that ssduck loaded from a file is loaded from it again, with the same flags and in the same
order. Any other body gets a model that is written from what PyBullet, or a record, knows of it.
Then the copy gets what differs: dynamics, colours, poses and velocities, joints, motors,
constraints.

Measured with PyBullet 3.2.7:

- A copy of a body as loaded is equal to the last bit, and stays so; equal values are not set.
- `saveBullet` and `restoreState` of a file transfer contacts between clients if links have one
shape
  each. The importer restores one contact manifold for each pair of bodies, with the last one that
  the file has of the pair; bodies of several shapes have many. Copies of such bodies find their
  contacts anew, which shifts the kitchen by less than 0.1 mm in 2 s, as does a velocity that is off
  by 1e-15 m/s.
- PyBullet does not return the targets of motors (ssduck remembers its own), the damping of bodies,
  collision filters, or textures.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ssduck.errors import SimulatorError, warn
from ssduck.formatting import joined_names
from ssduck.geometry.arrays import Array
from ssduck.geometry.poses import compose, invert
from ssduck.simulators.backends import BodyToCopy, TickToCopy
from ssduck.simulators.interface import SCALAR_JOINTS, Body, Simulator
from ssduck.simulators.pybullet.bodies import BodyDescription, com_of, xyzw
from ssduck.simulators.pybullet.body_state import (
    BodyState,
    contacts_of,
    copy_colours,
    copy_dynamics,
    set_state,
    state_of,
)
from ssduck.simulators.pybullet.clients import new_client
from ssduck.simulators.pybullet.console import captured, pybullet
from ssduck.simulators.pybullet.introspection import (
    constraints_of,
    guessed_model,
    model_of,
    positions_by_link,
)
from ssduck.simulators.pybullet.link_frames import link_poses_of
from ssduck.simulators.pybullet.scene_loader import (
    LoadedBodies,
    hold_joint,
    load_body,
    load_model,
    make_constraint,
    make_elastic,
    set_elastic,
    set_solver_settings,
    solver_settings,
)
from ssduck.simulators.pybullet.simulator import PyBulletSimulator
from ssduck.simulators.pybullet.urdf import write_model, zero_poses
from ssduck.simulators.scenes import BodySpec, Scene


def excerpt(
    source: Simulator | None, originals: Sequence[BodyToCopy], tick: TickToCopy
) -> PyBulletSimulator:
    """Starts a simulation of some bodies as they are at a tick.

    Args:
        source: the simulator of the world that the tick belongs to, as it is now; None if nothing
            runs that world any more.
        originals: the bodies, in load order.
        tick: the time of the tick and its flags.

    Raises:
        SimulatorError: the source does not answer, or there is no room for another client.
        UnsupportedError: a body is soft.
        SceneError: a model file can no longer be loaded.
    """
    live = source if isinstance(source, PyBulletSimulator) else None
    if live is not None and _may_carry_contacts(live, originals, tick):
        with suppress(_NotCarriedError), new_client() as client:
            return _Copier(live, client, tick).copied(originals, carry=True)
    with new_client() as client:
        return _Copier(live, client, tick).copied(originals)


class _NotCarriedError(Exception):
    """The restored contacts are not those of the source."""


def _may_carry_contacts(
    source: PyBulletSimulator, originals: Sequence[BodyToCopy], tick: TickToCopy
) -> bool:
    """Checks whether the contacts of a client can be restored in a copy of all its bodies."""
    if len(originals) < source.count() or tick.disabled:
        return False
    shapes = [Counter(shape.frame for shape in o.body.shapes) for o in originals]
    return all(max(counts.values(), default=0) <= 1 for counts in shapes)


@dataclass(eq=False)
class _Copier:
    """Fills a client with copies.

    Attributes:
        source: the simulator that runs the originals now, if any.
        client: the new client.
        tick: the time of the tick and its flags.
        loaded: knowledge about the copies.
        handles: the numbers of the copies.
        guessed: the names of bodies that differ from the originals, by the difference.
    """

    source: PyBulletSimulator | None
    client: int
    tick: TickToCopy
    loaded: LoadedBodies = field(default_factory=LoadedBodies)
    handles: dict[Body, int] = field(default_factory=dict)
    guessed: dict[str, list[str]] = field(default_factory=dict)

    def copied(self, originals: Sequence[BodyToCopy], *, carry: bool = False) -> PyBulletSimulator:
        """Copies bodies; on request with the contacts of the solver, if these are all bodies.

        Raises:
            _NotCarriedError: the restored contacts are not those of the source.
        """
        self.loaded.time = self.tick.time
        self._set_up()
        with tempfile.TemporaryDirectory(prefix="ssduck") as folder:
            self._load(originals, Path(folder))
            as_now = [self._finish(original) for original in originals]
            self._tie()
            pybullet.performCollisionDetection(self.client)
            if carry and all(as_now):
                self._carry_contacts(Path(folder) / "state.bullet")
        self._warn()
        return PyBulletSimulator(self.client, owned=True, loaded=self.loaded)

    def _set_up(self) -> None:
        """Copies gravity, time step and solver settings from the source."""
        timestep, gravity = Scene.timestep, Scene.gravity
        if self.source is not None:
            told = self.source.parameters()
            timestep = told["fixedTimeStep"]
            gravity = tuple(told[f"gravityAcceleration{axis}"] for axis in "XYZ")
            set_solver_settings(solver_settings(self.source.client), self.client)
            if self.source.loaded.elastic:
                self.loaded.elastic = True
                set_elastic(self.client)
        pybullet.setTimeStep(timestep, self.client)
        pybullet.setGravity(*gravity, physicsClientId=self.client)

    # -- bodies ---------------------------------------------------------------------------

    def _load(self, originals: Sequence[BodyToCopy], folder: Path) -> None:
        loaded: dict[int, Sequence[int]] = {}  # by entry of a scene, all bodies of its file
        for original in originals:
            spec, number = self._origin_of(original.body)
            if spec is None:
                handle = self._load_written(original, folder, len(self.handles))
            else:
                if id(spec) not in loaded:
                    loaded[id(spec)] = load_body(spec, "", self.loaded, self.client)
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
        self.loaded.disabled, self.loaded.hidden = set(), set()
        kept = self.handles.values()
        self.loaded.origins = {h: o for h, o in self.loaded.origins.items() if h in kept}
        self.loaded.held = {h: o for h, o in self.loaded.held.items() if h in kept}

    def _origin_of(self, body: Body) -> tuple[BodySpec | None, int]:
        """Returns the scene entry that a body was loaded from, if it can be loaded again."""
        if self.source is None or self._known(body) is None:
            return None, 0
        origin = self.source.loaded.origins.get(body.handle)
        if origin is None or not origin.spec.model.is_file():
            return None, 0
        return origin.spec, origin.number

    def _known(self, body: Body) -> BodyDescription | None:
        return None if self.source is None else self.source.description_of(body)

    def _load_written(self, original: BodyToCopy, folder: Path, number: int) -> int:
        """Loads a body from a model that is written from the knowledge about it."""
        known = self._known(original.body)
        if known is None:
            model = guessed_model(original.body, original.link_poses, original.joints)
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
        if self.loaded.elastic:
            make_elastic(handle, self.client)
        pybullet.setPhysicsEngineParameter(enableFileCaching=1, physicsClientId=self.client)
        return handle

    def _finish(self, original: BodyToCopy) -> bool:
        """Gives a copy the state of its original; returns whether that is the present state."""
        body, handle = original.body, self.handles[original.body]
        known = self._known(body)
        com = com_of(self.client, handle)
        if known is not None:
            assert self.source is not None
            copy_dynamics(self.source.client, body.handle, self.client, handle)
            copy_colours(self.source.visual_colours(body), self.client, handle)
        as_now = self._is_as_now(original)
        if as_now:
            assert self.source is not None
            state = state_of(self.source.client, body.handle)
        else:
            state = self._told_state(original, com, handle)
        set_state(self.client, handle, body, state)
        self._hold(original, state, handle)
        if body in self.tick.disabled:
            self.loaded.disabled.add(handle)
        if body in self.tick.hidden:
            self.loaded.hidden.add(handle)
        own = replace(body, handle=handle, name=original.name)
        self.loaded.described[handle] = BodyDescription(own, com, exact=True)
        return as_now

    def _is_as_now(self, original: BodyToCopy) -> bool:
        """Checks whether a body is now as it was at the tick, to the last bit."""
        body = original.body
        if self.source is None or self._known(body) is None:
            return False
        now, then = self.source.read_link_poses((body,), with_velocities=True), original.link_poses
        base = np.array([0])
        told = (
            (now.positions, then.positions),
            (now.states[:, 3:7], then.states[:, 3:7]),
            (now.states_at(now.positions[:1], base), then.states_at(then.positions[:1], base)),
        )
        if not all(np.array_equal(here, there) for here, there in told):
            return False
        joints = self.source.read_joints([body] if body.joints else [])[:, :2]
        # Those that the tick does not tell are as the links are.
        return bool((np.isnan(original.joints) | (joints == original.joints)).all())

    def _told_state(self, original: BodyToCopy, com: tuple[Array, Array], handle: int) -> BodyState:
        """Returns the state of a body at the tick."""
        link_poses = original.link_poses
        base = np.array([0])
        link = link_poses.positions[:1], link_poses.states[:1, 3:7]
        place, turn = compose(*link, com[0][:1], com[1][:1])
        (moving,) = link_poses.states_at(place, base)
        joints = original.joints
        if np.isnan(joints).any():
            joints = self._joints_by_frames(original, handle)
        if any(joint.type in ("spherical", "planar") for joint in original.body.joints):
            self._guess("spherical and planar joints are where the model has them", original)
        told = [
            ((float(position),), (float(velocity),)) if joint.type in SCALAR_JOINTS else None
            for joint, (position, velocity) in zip(original.body.joints, joints, strict=True)
        ]
        return BodyState(
            (tuple(place[0].tolist()), tuple(xyzw(turn)[0].tolist())),
            (tuple(moving[7:10].tolist()), tuple(moving[10:].tolist())),
            tuple(told),
        )

    def _joints_by_frames(self, original: BodyToCopy, handle: int) -> Array:
        """Returns the positions of unrecorded joints, computed from the links; at rest."""
        body = original.body
        what = "velocities" if self._known(body) is not None else "positions and velocities"
        self._guess(f"{what} of joints are not recorded; they rest where links are", original)
        here = link_poses_of(self.client, replace(body, handle=handle), com_of(self.client, handle))
        states = state_of(self.client, handle).joints
        at = np.array([[state[0][0] if state and state[0] else 0.0] for state in states])
        zero = zero_poses(body, here, positions_by_link(body, at))
        parents = np.array([link.parent for link in body.links[1:]], dtype=np.intp)
        places, turns = original.link_poses.positions, original.link_poses.states[:, 3:7]
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

    def _hold(self, original: BodyToCopy, state: BodyState, handle: int) -> None:
        """Makes motors hold joints as in the source, or at the positions of an earlier tick."""
        body = original.body
        held: Mapping[int, float] = {}
        now: BodyState | None = None
        if self.source is not None and self._known(body) is not None:
            if self.source.is_external and any(
                joint.type in SCALAR_JOINTS for joint in body.joints
            ):
                self._guess("what motors do is not told; they are as PyBullet begins", original)
            held = self.source.loaded.held.get(body.handle, {})
            now = state_of(self.source.client, body.handle) if held else None
        elif self.source is None or self._known(body) is None:
            held = {joint.link: 0.0 for joint in body.joints if joint.type in SCALAR_JOINTS}
        begun = self.loaded.held.get(handle, {})
        targets = {}
        for link, target in held.items():
            there = state.joints[link - 1]
            assert there is not None
            moved = now is None or now.joints[link - 1] != there
            targets[link] = there[0][0] if moved else target
            if begun.get(link) != targets[link]:
                hold_joint(handle, body.joints[link - 1], targets[link], self.client)
        self.loaded.held[handle] = targets

    def _carry_contacts(self, file: Path) -> None:
        """Restores the solver's contacts and the impulses that it begins with.

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
        there = contacts_of(source, handles)
        if there != contacts_of(client, {handle: handle for handle in handles.values()}):
            raise _NotCarriedError

    # -- constraints ----------------------------------------------------------------------

    def _tie(self) -> None:
        """Makes the constraints between the bodies, and to the world."""
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

    def _guess(self, what: str, original: BodyToCopy) -> None:
        self.guessed.setdefault(what, []).append(original.name)

    def _warn(self) -> None:
        if self.source is None:
            self.guessed["gravity and time step are not recorded; they are as in a new scene"] = []
        for what, names in self.guessed.items():
            warn(f"{joined_names(names)}: {what}" if names else what)
