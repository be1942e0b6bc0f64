"""Copies bodies into a new PyBullet client, for `World.excerpt`.

A copy has the model file of its original, if ssduck loaded that and it is a URDF file; else a model
is written from the data of PyBullet or of a recording. Then the rest is copied: dynamics, colours,
joints, motors, constraints.

Measured with PyBullet 3.2.7:

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
from ssduck.simulators.pybullet import introspection, scene_loader
from ssduck.simulators.pybullet.bodies import BodyDescription, com_poses_of, xyzw
from ssduck.simulators.pybullet.clients import new_client, pybullet
from ssduck.simulators.pybullet.readings import LinkPosesReader
from ssduck.simulators.pybullet.scene_loader import LoadedBodies
from ssduck.simulators.pybullet.scene_writer import loadable_spec, placed, write_model
from ssduck.simulators.pybullet.simulator import PyBulletSimulator, visual_colours
from ssduck.simulators.scene_bodies import BodySpec
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
    # What is different, with the names of the bodies.
    differences: dict[str, dict[str, None]] = field(default_factory=dict)

    def copy(self, originals: Sequence[BodyToCopy]) -> PyBulletSimulator:
        settings = self.source.settings() if self.source else Scene("", Path())
        scene_loader.set_up(settings, self.client)
        self.loaded.time, self.loaded.elastic = self.tick.time, settings.elastic
        with tempfile.TemporaryDirectory(prefix="ssduck") as folder:
            for original in originals:
                self._copy_body(original, Path(folder))
        self._copy_constraints()
        pybullet.performCollisionDetection(self.client)
        for difference, names in self.differences.items():
            warn(f"{joined_names(list(names))}: {difference}")
        if self.source is None:
            warn("gravity and time step are not recorded; they are as in a new scene")
        return PyBulletSimulator(self.client, owned=True, loaded=self.loaded)

    # -- bodies ---------------------------------------------------------------------------

    def _copy_body(self, original: BodyToCopy, folder: Path) -> None:
        body, live = original.body, self._live(original.body)
        spec = placed(self._spec_of(original, folder), original, self.tick)
        (handle,) = scene_loader.load_body(spec, "", self.loaded, self.client)
        if pybullet.getNumJoints(handle, self.client) != len(body.joints):
            raise SimulatorError(f"the model of {original.name!r} has changed since it was loaded")
        self.handles[body] = handle
        if live is not None:
            copy_dynamics(live.client, body.handle, self.client, handle)
            present = {(n, i): colour for n, i, colour in visual_colours(self.client, handle)}
            for link, shape, colour in live.colours_when_shown(body):
                if present.get((link, shape), colour) != colour:
                    pybullet.changeVisualShape(
                        handle, link, shape, rgbaColor=colour, physicsClientId=self.client
                    )
        self._copy_joints(original, handle)
        copy = replace(body, handle=handle, name=original.name)
        description = BodyDescription(copy, com_poses_of(self.client, handle))
        self.loaded.described[handle] = description

    def _live(self, body: Body) -> PyBulletSimulator | None:
        """Returns the source if it still has a body."""
        has_body = self.source is not None and self.source.description_of(body) is not None
        return self.source if has_body else None

    def _spec_of(self, original: BodyToCopy, folder: Path) -> BodySpec:
        """Returns a scene entry with the model of a body, which is written unless it has a file."""
        body, live = original.body, self._live(original.body)
        spec = None if live is None else loadable_spec(live, body)
        if spec is not None:
            return replace(spec, joints={}, joint_velocities={}, held={}, hold=False)
        if live is None:
            model = introspection.estimated_model(body, original.link_poses, original.joints)
            self._note_difference(
                "only shapes, links, joints and masses are known; inertia and centre of mass are "
                "those of the shapes, friction and damping PyBullet's own, and joints are held",
                original,
            )
        else:
            model = introspection.model_of(live, body)
            if body.has_stand_ins:
                self._note_difference(
                    "not all shapes are given back; it collides as its box", original
                )
        if any(shape.geometry.type == "ellipsoid" for shape in body.shapes):
            self._note_difference(
                "PyBullet has no ellipsoids; hulls of 1,000 corners stand for them", original
            )
        path = write_model(model, folder, f"body_{len(self.handles)}")
        return BodySpec(None, None, path, own_inertia=live is not None, hold=False)

    # -- joints ---------------------------------------------------------------------------

    def _copy_joints(self, original: BodyToCopy, handle: int) -> None:
        """Sets joints to their state at the tick, and makes motors hold them as in the source."""
        joints = original.body.joints
        states, turns, spins = self._joint_states(original, handle)
        motors = self._motors(original, states[:, 0])
        for number, joint in enumerate(joints):
            if joint.type in SCALAR_JOINTS:
                position, velocity = states[number].tolist()
                pybullet.resetJointState(handle, number, position, velocity, self.client)
                if joint.link in motors:
                    scene_loader.hold_joint(handle, joint, motors[joint.link], self.client)
            elif joint.type == "spherical":
                turn, spin = xyzw(turns[[number]])[0].tolist(), spins[number].tolist()
                pybullet.resetJointStateMultiDof(handle, number, turn, spin, self.client)
            elif joint.type == "planar":
                self._note_difference("planar joints are where the model has them", original)
        self.loaded.motor_positions[handle] = dict(motors)

    def _joint_states(self, original: BodyToCopy, handle: int) -> tuple[Array, Array, Array]:
        """Returns the states of joints, (n, 2), and turns (n, 4) and spins (n, 3) of their links.

        The turns and spins are relative to the parents; the states of joints that were not recorded
        follow from them. The velocities of these are 0.
        """
        body, poses = original.body, original.link_poses
        copy = replace(body, handle=handle)
        reader = LinkPosesReader([copy], [com_poses_of(self.client, handle)])
        present = reader.read(self.client)
        before = [
            pybullet.getJointState(handle, n, self.client)[0] for n in range(len(body.joints))
        ]
        zero = introspection.zero_poses(body, present, np.array(before)[:, None])
        shifts, turns = compose(*invert(*zero), *introspection.poses_in_parents(body, poses))
        parents = [link.parent for link in body.links[1:]]
        drift = poses.states[1:, 10:] - poses.states[parents, 10:]
        spins = np.einsum("nji,nj->ni", poses.matrices[1:], np.nan_to_num(drift))
        states = self._known_joints(original).copy()
        for number, joint in enumerate(body.joints):
            axis, is_unknown = np.array(joint.axis), np.isnan(states[number]).any()
            if is_unknown and joint.type == "revolute":
                states[number] = 2 * np.arctan2(turns[number, 1:] @ axis, turns[number, 0]), 0.0
            elif is_unknown and joint.type == "prismatic":
                states[number] = shifts[number] @ axis / (axis @ axis), 0.0
            if is_unknown and joint.type in SCALAR_JOINTS:
                missing = "positions and " if self._live(body) is None else ""
                self._note_difference(
                    f"{missing}velocities of joints are not recorded; they rest where links are",
                    original,
                )
        return states, turns, spins

    def _known_joints(self, original: BodyToCopy) -> Array:
        """Returns the joints at a tick; the present ones if the links are where they are now."""
        live, body = self._live(original.body), original.body
        if live is None or not np.isnan(original.joints).any():
            return original.joints
        now = live.read_link_poses((body,))
        is_present = np.array_equal(now.positions, original.link_poses.positions)
        return live.read_joints((body,))[:, :2] if is_present else original.joints

    def _motors(self, original: BodyToCopy, positions: Array) -> Mapping[int, float]:
        """Returns the positions that motors hold, by link."""
        body, live = original.body, self._live(original.body)
        scalar = {joint.link for joint in body.joints if joint.type in SCALAR_JOINTS}
        if live is None:
            return {link: float(positions[link - 1]) for link in scalar}
        if live.is_external and scalar:
            self._note_difference("the motors are not known; they are as PyBullet begins", original)
        targets = live.loaded.motor_positions.get(body.handle, {})
        now = live.read_joints([body] if targets else [])[:, 0]
        # A joint that was elsewhere at the tick is held where it was.
        return {
            link: target if now[link - 1] == positions[link - 1] else float(positions[link - 1])
            for link, target in targets.items()
        }

    # -- constraints ----------------------------------------------------------------------

    def _copy_constraints(self) -> None:
        """Makes the constraints between the bodies, and to the world."""
        if self.source is None:
            return
        copies = self.handles.items()
        handles = {body.handle: new for body, new in copies if self._live(body) is not None}
        handles[-1] = -1
        for _, spec, on, to in scene_loader.constraints_of(self.source.client):
            if on[0] in handles and to[0] in handles:
                ends = [(handles[body], link) for body, link in (on, to)]
                scene_loader.create_constraint(spec, ends[0], ends[1], self.client)

    # -- differences ----------------------------------------------------------------------

    def _note_difference(self, difference: str, original: BodyToCopy) -> None:
        self.differences.setdefault(difference, {})[original.name] = None


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
