"""The state and the dynamics of PyBullet bodies: read from one client, set in another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ssduck.simulators.interface import SCALAR_JOINTS, Body
from ssduck.simulators.pybullet.console import pybullet
from ssduck.simulators.pybullet.simulator import visual_colours

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
# The same of getJointInfo.
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
    for joint, here, there in zip(body.joints, now.joints, state.joints, strict=True):
        if there is None or here == there:
            continue
        if joint.type in SCALAR_JOINTS:
            (position,), (velocity,) = there
            pybullet.resetJointState(handle, joint.link - 1, position, velocity, client)
        elif joint.type == "spherical":
            pybullet.resetJointStateMultiDof(handle, joint.link - 1, *there, client)


def contacts_of(client: int, handles: Mapping[int, int]) -> list[tuple[Any, ...]]:
    """Returns the contacts with mapped body numbers and points rounded to 1e-9 m, sorted."""
    found = [
        (handles[a], link_a, handles[b], link_b, *(round(x, 9) for x in (*at_a, *at_b)))
        for _, a, b, link_a, link_b, at_a, at_b, *_ in pybullet.getContactPoints(
            physicsClientId=client
        )
    ]
    return sorted(found)


def copy_dynamics(source: int, original: int, client: int, handle: int) -> None:
    """Copies masses, inertias, friction and the like as far as they differ."""
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


def copy_colours(
    wanted: Sequence[tuple[int, int, Sequence[float]]], client: int, handle: int
) -> None:
    """Colours a body; each colour comes with the link and the index of the shape."""
    own_colours = {(link, shape): colour for link, shape, colour in visual_colours(client, handle)}
    for link, shape, colour in wanted:
        own = own_colours.get((link, shape))
        if own is not None and tuple(own) != tuple(colour):
            pybullet.changeVisualShape(
                handle, link, shape, rgbaColor=colour, physicsClientId=client
            )
