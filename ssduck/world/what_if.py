"""Computes a tick of a world with some bodies or joints elsewhere, without the simulator."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ssduck.geometry.arrays import Array
from ssduck.simulators.interface import Body, LinkPoses
from ssduck.simulators.kinematics import Pose, moved_link_poses
from ssduck.simulators.partial import StaticSimulator
from ssduck.world.layout import BodyGroup
from ssduck.world.snapshot import Snapshot

UNAVAILABLE = {
    "contacts": "a what-if world has no contacts: the solver finds contacts in a step, and a "
    "what-if world is never stepped; compare boxes, or move the bodies themselves",
    "sensings": "sensors perceive nothing in a what-if world: rays can only be cast in the "
    "simulation; move the bodies themselves",
}


# Poses of a diverging simulation may be NaN; they stay NaN.
@np.errstate(invalid="ignore")
def what_if_tick(
    snapshot: Snapshot, poses: Mapping[Body, Pose], joints: Mapping[Body, Mapping[int, float]]
) -> tuple[StaticSimulator, Snapshot]:
    """Returns a static simulator of the what-if state, and a snapshot to take from it.

    Args:
        snapshot: the tick; if a body has several links, the tables of links and joints must have
            been requested.
        poses: the new poses of the bodies' base link frames in the world frame.
        joints: the new positions of joints, rad or m, by body and index of the joint.
    """
    states = snapshot.joints()
    offsets = {
        body: {n: position - states[body][n, 0] for n, position in positions.items()}
        for body, positions in joints.items()
    }
    clone = snapshot.clone(UNAVAILABLE)
    link_poses = {}
    for group, current in snapshot.body_groups:
        moved = [body for body in group.runs if body in poses or body in offsets]
        link_poses[group.bodies] = _moved(group, current, moved, poses, offsets, states)
        if moved:
            clone.invalidate_static_poses()
    simulator = StaticSimulator(
        time=snapshot.time,
        link_poses=link_poses,
        joints={body: _at_rest(values, joints.get(body, {})) for body, values in states.items()},
        disabled=snapshot.disabled,
        hidden=snapshot.hidden,
    )
    return simulator, clone


def copied_tick(snapshot: Snapshot) -> tuple[StaticSimulator, Snapshot]:
    """Returns a static simulator of a tick as it is, and a snapshot to take from it.

    The copy has the contacts, what sensors perceive if that was requested, and is of the same run.

    Args:
        snapshot: the tick; the tables of contacts and, if a body has several links, of links and
            joints must have been requested.
    """
    simulator = StaticSimulator(
        time=snapshot.time,
        link_poses={group.bodies: poses for group, poses in snapshot.body_groups},
        joints=snapshot.joints(),
        disabled=snapshot.disabled,
        hidden=snapshot.hidden,
        contacts=snapshot.contact_points.all(),
        description="a copy of a tick",
    )
    return simulator, snapshot.clone({}, snapshot.run)


def _moved(
    group: BodyGroup,
    link_poses: LinkPoses,
    bodies: list[Body],
    poses: Mapping[Body, Pose],
    offsets: Mapping[Body, Mapping[int, float]],
    joint_states: Mapping[Body, Array],
) -> LinkPoses:
    """Returns the link poses of a group after some of its bodies or their joints moved."""
    if not bodies:
        return link_poses
    positions, matrices = link_poses.positions.copy(), link_poses.matrices.copy()
    states = link_poses.states.copy()
    for body in bodies:
        run = group.runs[body]
        current = LinkPoses(positions[run], matrices[run], states[run])
        new = moved_link_poses(
            body, current, poses.get(body), offsets.get(body, {}), joint_states.get(body)
        )
        positions[run], matrices[run], states[run] = new.positions, new.matrices, new.states
    return LinkPoses(positions, matrices, states)


def _at_rest(states: Array, positions: Mapping[int, float]) -> Array:
    """Sets joints of states (joints, 3) to rest at positions, in place; all efforts are unknown."""
    states[:, 2] = np.nan
    for number, position in positions.items():
        states[number, :2] = position, 0.0
    return states
