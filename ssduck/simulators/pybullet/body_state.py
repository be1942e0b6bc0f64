"""The state and the dynamics of PyBullet bodies: read from one client, set in another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ssduck.simulators.interface import SCALAR_JOINTS, Body
from ssduck.simulators.pybullet.clients import pybullet
from ssduck.simulators.pybullet.simulator import visual_colours

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
    """The state of a body in PyBullet's terms.

    Attributes:
        base: position and orientation (x, y, z, w) of the base's centre of mass.
        twist: its velocity and angular velocity.
        joints: positions and velocities of each joint, as many numbers as it has; None for a joint
            that is left as it is.
    """

    base: tuple[tuple[float, ...], tuple[float, ...]]
    twist: tuple[tuple[float, ...], tuple[float, ...]]
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
