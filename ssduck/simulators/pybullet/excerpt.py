"""Copies bodies into a new PyBullet client, for `World.excerpt`.

A body that ssduck loaded from a file is loaded from it again, with the same flags and in the same
order. For any other body, a model is written from the data of PyBullet or of a recording. Then the
remaining state is copied: dynamics, colours, poses and velocities, joints, motors, constraints.

Measured with PyBullet 3.2.7:

- The copy of an unchanged body is equal to the last bit, and stays so; equal values are not set.
- The solver's contacts, with the impulses that it begins with, are not copied. Copies find their
  contacts again, which shifts the kitchen by less than 0.1 mm in 2 s, as does a velocity error of
  1e-15 m/s.
- PyBullet does not return the targets of motors (ssduck remembers its own), the damping of bodies,
  collision filters, or textures.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ssduck.errors import SimulatorError, UnsupportedError, warn
from ssduck.formatting import joined_names
from ssduck.geometry.arrays import Array
from ssduck.geometry.poses import compose, invert
from ssduck.simulators.backends import BodyToCopy, TickToCopy
from ssduck.simulators.interface import SCALAR_JOINTS, Body, Simulator
from ssduck.simulators.pybullet.bodies import BodyDescription, com_poses_of, xyzw
from ssduck.simulators.pybullet.clients import new_client, pybullet
from ssduck.simulators.pybullet.introspection import (
    constraints_of,
    estimated_model,
    model_of,
    poses_in_parents,
    zero_poses,
)
from ssduck.simulators.pybullet.readings import link_poses_of
from ssduck.simulators.pybullet.scene_loader import (
    LoadedBodies,
    create_constraint,
    gravity_of,
    hold_joint,
    load_body,
    load_model,
    make_elastic,
    set_elastic,
    set_solver_settings,
    solver_settings,
)
from ssduck.simulators.pybullet.scene_writer import write_model
from ssduck.simulators.pybullet.simulator import PyBulletSimulator, visual_colours
from ssduck.simulators.scene_bodies import BodySpec, Primitive
from ssduck.simulators.scenes import Scene


def excerpt(
    source: Simulator | None, originals: Sequence[BodyToCopy], tick: TickToCopy
) -> PyBulletSimulator:
    """Starts a simulation of some bodies as they are at a tick; see `Backend.excerpt`."""
    originals = [_with_pybullet_joints(original) for original in originals]
    live = source if isinstance(source, PyBulletSimulator) else None
    with new_client() as client:
        return _Copier(live, client, tick).copy(originals)


def _with_pybullet_joints(original: BodyToCopy) -> BodyToCopy:
    """Returns a body, maybe of another simulator, without the joint of a free base."""
    joints = original.body.joints
    kept = [number for number, joint in enumerate(joints) if joint.type != "free"]
    links = [joints[number].link for number in kept]
    is_simple = all(not any(joints[n].anchor) and not joints[n].reference for n in kept)
    if links != list(range(1, len(original.body.links))) or not is_simple:
        raise UnsupportedError(
            f"{original.name} has joints that PyBullet does not have, and a record holds no model "
            "of its simulator: copy it from the running world"
        )
    if len(kept) == len(joints):
        return original
    body = replace(original.body, joints=tuple(joints[number] for number in kept))
    return replace(original, body=body, joints=original.joints[kept])


@dataclass(eq=False)
class _Copier:
    """Fills a client with copies."""

    source: PyBulletSimulator | None  # that runs the originals now
    client: int  # the new one
    tick: TickToCopy
    loaded: LoadedBodies = field(default_factory=LoadedBodies)
    handles: dict[Body, int] = field(default_factory=dict)
    differences: dict[str, list[str]] = field(default_factory=dict)  # bodies by difference

    def copy(self, originals: Sequence[BodyToCopy]) -> PyBulletSimulator:
        """Copies bodies."""
        self.loaded.time = self.tick.time
        self._copy_settings()
        with tempfile.TemporaryDirectory(prefix="ssduck") as folder:
            self._load(originals, Path(folder))
        for original in originals:
            self._copy_state(original)
        self._copy_constraints()
        pybullet.performCollisionDetection(self.client)
        self._warn_of_differences()
        return PyBulletSimulator(self.client, owned=True, loaded=self.loaded)

    def _copy_settings(self) -> None:
        """Copies gravity, time step and solver settings from the source."""
        timestep, gravity = Scene.timestep, Scene.gravity
        if self.source is not None:
            parameters = self.source.parameters()
            timestep = parameters["fixedTimeStep"]
            gravity = gravity_of(parameters)
            set_solver_settings(solver_settings(self.source.client), self.client)
            if self.source.loaded.elastic:
                self.loaded.elastic = True
                set_elastic(self.client)
        pybullet.setTimeStep(timestep, self.client)
        pybullet.setGravity(*gravity, physicsClientId=self.client)

    # -- bodies ---------------------------------------------------------------------------

    def _load(self, originals: Sequence[BodyToCopy], folder: Path) -> None:
        loaded: dict[int, Sequence[int]] = {}  # all bodies of a file, by id of its scene entry
        for original in originals:
            spec, number = self._origin_of(original.body)
            if spec is None:
                handle = self._load_generated(original, folder, len(self.handles))
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
        # The flags of the scene file are those of the start.
        self.loaded.disabled, self.loaded.hidden = set(), set()
        copies = self.handles.values()
        self.loaded.origins = {h: o for h, o in self.loaded.origins.items() if h in copies}
        self.loaded.motor_positions = {
            h: o for h, o in self.loaded.motor_positions.items() if h in copies
        }

    def _origin_of(self, body: Body) -> tuple[BodySpec | None, int]:
        """Returns the scene entry that a body was loaded from, if it can be loaded again."""
        if self.source is None or self._description_of(body) is None:
            return None, 0
        origin = self.source.loaded.origins.get(body.handle)
        if origin is None:
            return None, 0
        model = origin.spec.model
        if not isinstance(model, Primitive) and not model.is_file():
            return None, 0
        return origin.spec, origin.number

    def _description_of(self, body: Body) -> BodyDescription | None:
        return None if self.source is None else self.source.description_of(body)

    def _load_generated(self, original: BodyToCopy, folder: Path, number: int) -> int:
        """Loads a body from a model that is written for it."""
        description = self._description_of(original.body)
        if description is None:
            model = estimated_model(original.body, original.link_poses, original.joints)
            self._note_difference(
                "only shapes, links, joints and masses are known; inertia and centre of mass are "
                "those of the shapes, friction and damping PyBullet's own, and joints are held",
                original,
            )
        else:
            assert self.source is not None
            model = model_of(self.source, original.body)
            if not description.exact:
                self._note_difference(
                    "not all shapes are given back; it collides as its box", original
                )
        if any(shape.geometry.type == "ellipsoid" for shape in original.body.shapes):
            self._note_difference(
                "PyBullet has no ellipsoids; hulls of 1,000 corners stand for them", original
            )
        path = write_model(model, folder, f"body_{number}")
        spec = BodySpec(None, None, path, own_inertia=description is not None)
        # PyBullet caches meshes by file name, for ever; another copy may have used that name.
        pybullet.setPhysicsEngineParameter(enableFileCaching=0, physicsClientId=self.client)
        (handle,) = load_model(spec, "", self.client).handles
        if self.loaded.elastic:
            make_elastic(handle, self.client)
        pybullet.setPhysicsEngineParameter(enableFileCaching=1, physicsClientId=self.client)
        return handle

    def _copy_state(self, original: BodyToCopy) -> None:
        """Gives a copy the state of its original."""
        body, handle = original.body, self.handles[original.body]
        com = com_poses_of(self.client, handle)
        if self._description_of(body) is not None:
            assert self.source is not None
            copy_dynamics(self.source.client, body.handle, self.client, handle)
            copy_colours(self.source.visual_colours(body), self.client, handle)
        if self._is_unchanged(original):
            assert self.source is not None
            state = state_of(self.source.client, body.handle)
        else:
            state = self._state_at_tick(original, com, handle)
        set_state(self.client, handle, body, state)
        self._set_motors(original, state, handle)
        if body in self.tick.disabled:
            self.loaded.disabled.add(handle)
        if body in self.tick.hidden:
            self.loaded.hidden.add(handle)
        copy = replace(body, handle=handle, name=original.name)
        self.loaded.described[handle] = BodyDescription(copy, com, exact=True)

    def _is_unchanged(self, original: BodyToCopy) -> bool:
        """Checks whether a body is now as it was at the tick, to the last bit."""
        body = original.body
        if self.source is None or self._description_of(body) is None:
            return False
        now = replace(
            original, link_poses=self.source.read_link_poses((body,), with_velocities=True)
        )
        before, after = original.link_poses, now.link_poses
        compared = (
            (after.positions, before.positions),
            (after.states[:, 3:7], before.states[:, 3:7]),
            (now.base_state, original.base_state),
        )
        if not all(np.array_equal(new, old) for new, old in compared):
            return False
        joints = self.source.read_joints([body] if body.joints else [])[:, :2]
        # Joints that the tick does not have follow from the links.
        return bool((np.isnan(original.joints) | (joints == original.joints)).all())

    def _state_at_tick(
        self, original: BodyToCopy, com: tuple[Array, Array], handle: int
    ) -> BodyState:
        """Returns the state of a body at the tick."""
        link_poses = original.link_poses
        base = np.array([0])
        link = link_poses.positions[:1], link_poses.states[:1, 3:7]
        position, orientation = compose(*link, com[0][:1], com[1][:1])
        (com_state,) = link_poses.states_at(position, base)
        joints = original.joints
        if np.isnan(joints).any():
            joints = self._joints_from_links(original, handle)
        if any(joint.type in ("spherical", "planar") for joint in original.body.joints):
            self._note_difference(
                "spherical and planar joints are where the model has them", original
            )
        joint_states = [
            ((float(value),), (float(velocity),)) if joint.type in SCALAR_JOINTS else None
            for joint, (value, velocity) in zip(original.body.joints, joints, strict=True)
        ]
        return BodyState(
            (tuple(position[0].tolist()), tuple(xyzw(orientation)[0].tolist())),
            (tuple(com_state[7:10].tolist()), tuple(com_state[10:].tolist())),
            tuple(joint_states),
        )

    def _joints_from_links(self, original: BodyToCopy, handle: int) -> Array:
        """Returns the positions of unrecorded joints, computed from the links; at rest."""
        body = original.body
        missing = "velocities" if self._description_of(body) else "positions and velocities"
        self._note_difference(
            f"{missing} of joints are not recorded; they rest where links are", original
        )
        link_poses = link_poses_of(
            self.client, replace(body, handle=handle), com_poses_of(self.client, handle)
        )
        states = state_of(self.client, handle).joints
        positions = np.array([[state[0][0] if state and state[0] else 0.0] for state in states])
        zero = zero_poses(body, link_poses, positions)
        shifts, twists = compose(*invert(*zero), *poses_in_parents(body, original.link_poses))
        joints = np.zeros((len(body.joints), 2))
        for number, joint in enumerate(body.joints):
            axis = np.array(joint.axis)
            if joint.type == "revolute":
                joints[number, 0] = 2 * np.arctan2(twists[number, 1:] @ axis, twists[number, 0])
            elif joint.type == "prismatic":
                joints[number, 0] = shifts[number] @ axis / (axis @ axis)
        return joints

    def _set_motors(self, original: BodyToCopy, state: BodyState, handle: int) -> None:
        """Makes motors hold joints as in the source, or at the positions of an earlier tick."""
        body = original.body
        motors: Mapping[int, float]  # the positions that they hold, by link
        now: BodyState | None = None
        if self.source is not None and self._description_of(body) is not None:
            if self.source.is_external and any(
                joint.type in SCALAR_JOINTS for joint in body.joints
            ):
                self._note_difference(
                    "the motors are not known; they are as PyBullet begins", original
                )
            motors = self.source.loaded.motor_positions.get(body.handle, {})
            now = state_of(self.source.client, body.handle) if motors else None
        else:
            motors = {joint.link: 0.0 for joint in body.joints if joint.type in SCALAR_JOINTS}
        initial = self.loaded.motor_positions.get(handle, {})
        targets = {}
        for link, target in motors.items():
            joint_state = state.joints[link - 1]
            assert joint_state is not None
            is_moved = now is None or now.joints[link - 1] != joint_state
            targets[link] = joint_state[0][0] if is_moved else target
            if initial.get(link) != targets[link]:
                hold_joint(handle, body.joints[link - 1], targets[link], self.client)
        self.loaded.motor_positions[handle] = targets

    # -- constraints ----------------------------------------------------------------------

    def _copy_constraints(self) -> None:
        """Makes the constraints between the bodies, and to the world."""
        if self.source is None:
            return
        described = [body for body in self.handles if self._description_of(body) is not None]
        handles = {body.handle: self.handles[body] for body in described}
        handles[-1] = -1
        for spec, on, to in constraints_of(self.source.client):
            if on[0] in handles and to[0] in handles:
                ends = [(handles[body], link) for body, link in (on, to)]
                create_constraint(spec, ends[0], ends[1], self.client)

    # -- differences ----------------------------------------------------------------------

    def _note_difference(self, difference: str, original: BodyToCopy) -> None:
        self.differences.setdefault(difference, []).append(original.name)

    def _warn_of_differences(self) -> None:
        if self.source is None:
            self.differences[
                "gravity and time step are not recorded; they are as in a new scene"
            ] = []
        for difference, names in self.differences.items():
            warn(f"{joined_names(names)}: {difference}" if names else difference)


# The indices of changeDynamics' parameters in the result of getDynamicsInfo. Margins are not among
# them: they belong to the shapes, and PyBullet sets that of the base, whatever the link.
_DYNAMICS = {
    "mass": 0,
    "lateralFriction": 1,
    "localInertiaDiagonal": 2,
    "restitution": 5,
    "rollingFriction": 6,
    "spinningFriction": 7,
}
_CONTACT = {"contactDamping": 8, "contactStiffness": 9}
# Their indices in the result of getJointInfo.
_JOINT = {"jointDamping": 6, "maxJointVelocity": 11}
_LIMITS = {"jointLowerLimit": 8, "jointUpperLimit": 9}


@dataclass(frozen=True)
class BodyState:
    """The state of a body in PyBullet's terms."""

    # Position and orientation (x, y, z, w) of the base's centre of mass.
    base: tuple[tuple[float, ...], tuple[float, ...]]
    twist: tuple[tuple[float, ...], tuple[float, ...]]  # its velocity and angular velocity
    # Positions and velocities of each joint, as many numbers as it has; None for a joint that is
    # left as it is.
    joints: tuple[tuple[tuple[float, ...], tuple[float, ...]] | None, ...]


def state_of(client: int, handle: int) -> BodyState:
    """Returns the state of a body."""
    joints = [
        pybullet.getJointStateMultiDof(handle, joint, client)[:2]
        for joint in range(pybullet.getNumJoints(handle, client))
    ]
    return BodyState(
        pybullet.getBasePositionAndOrientation(handle, client),
        pybullet.getBaseVelocity(handle, client),
        tuple(joints),
    )


def set_state(client: int, handle: int, body: Body, state: BodyState) -> None:
    """Sets the state of a body; equal values are not set, so that they keep their last bit."""
    if state_of(client, handle).base != state.base:
        pybullet.resetBasePositionAndOrientation(handle, *state.base, client)
    if state_of(client, handle).twist != state.twist:
        pybullet.resetBaseVelocity(handle, *state.twist, client)
    now = state_of(client, handle)
    for joint, old, new in zip(body.joints, now.joints, state.joints, strict=True):
        if new is None or old == new:
            continue
        if joint.type in SCALAR_JOINTS:
            (position,), (velocity,) = new
            pybullet.resetJointState(handle, joint.link - 1, position, velocity, client)
        elif joint.type == "spherical":
            pybullet.resetJointStateMultiDof(handle, joint.link - 1, *new, client)


def copy_dynamics(source: int, original: int, client: int, handle: int) -> None:
    """Copies the masses, inertias, frictions and so on that differ."""
    count = pybullet.getNumJoints(handle, client)
    for link in range(-1, count):
        present = pybullet.getDynamicsInfo(handle, link, client)
        expected = pybullet.getDynamicsInfo(original, link, source)
        if expected[10] != present[10]:
            continue  # PyBullet returns uninitialized memory for a rigid body
        changes = {k: expected[at] for k, at in _DYNAMICS.items() if expected[at] != present[at]}
        if any(expected[at] != present[at] for at in _CONTACT.values()):
            changes |= {key: expected[at] for key, at in _CONTACT.items()}
        if link >= 0:
            present = pybullet.getJointInfo(handle, link, client)
            expected = pybullet.getJointInfo(original, link, source)
            changes |= {k: expected[at] for k, at in _JOINT.items() if expected[at] != present[at]}
            limits = {key: expected[at] for key, at in _LIMITS.items()}
            is_limited = limits["jointLowerLimit"] <= limits["jointUpperLimit"]
            if is_limited and any(expected[at] != present[at] for at in _LIMITS.values()):
                changes |= limits
        if changes:
            pybullet.changeDynamics(handle, link, physicsClientId=client, **changes)


def copy_colours(
    new_colours: Sequence[tuple[int, int, Sequence[float]]], client: int, handle: int
) -> None:
    """Colours a body; each colour comes with the link and the index of the shape."""
    colours = {(link, shape): colour for link, shape, colour in visual_colours(client, handle)}
    for link, shape, colour in new_colours:
        present = colours.get((link, shape))
        if present is not None and tuple(present) != tuple(colour):
            pybullet.changeVisualShape(
                handle, link, shape, rgbaColor=colour, physicsClientId=client
            )
