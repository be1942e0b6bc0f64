"""A tick of a world with some bodies elsewhere, made of what the tick knows."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ssduck.geometry.arrays import Array
from ssduck.simulators.interface import Body, LinkPoses
from ssduck.simulators.kinematics import Pose, moved_link_poses
from ssduck.simulators.static import StaticSimulator
from ssduck.world.layout import BodyGroup
from ssduck.world.snapshot import Snapshot

UNAVAILABLE = {
    "contacts": "a what-if world has no contacts: they are what a solver finds in a step, and it "
    "was never simulated; compare boxes, or move the bodies themselves",
    "sensings": "sensors perceive nothing in a what-if world: its rays would have to be cast in "
    "the simulation; move the bodies themselves",
}


# Where a simulation that explodes has a body is no number, and stays none.
@np.errstate(invalid="ignore")
def what_if_tick(
    snapshot: Snapshot, places: Mapping[Body, Pose], joints: Mapping[Body, Mapping[int, float]]
) -> tuple[StaticSimulator, Snapshot]:
    """What stands for a simulator, and the snapshot to be taken of it.

    Args:
        snapshot: of the tick; the tables of links and joints have to have been asked for if a
            body has several links.
        places: where bodies are put: of the base link's frame in the world.
        joints: positions of joints, rad or m, by body and number of the joint's link.
    """
    told = snapshot.joints()
    further = {
        body: {link: position - told[body][link - 1, 0] for link, position in positions.items()}
        for body, positions in joints.items()
    }
    clone = snapshot.clone(UNAVAILABLE)
    frames = {}
    for part, known in snapshot.body_groups:
        changed = [body for body in part.runs if body in places or body in further]
        frames[part.bodies] = _changed(part, known, changed, places, further)
        if changed:
            clone.invalidate_static_poses()
    posed = StaticSimulator(
        time=snapshot.time,
        link_poses=frames,
        joints={body: _joints(states, joints.get(body, {})) for body, states in told.items()},
        disabled=snapshot.disabled,
        hidden=snapshot.hidden,
    )
    return posed, clone


def _changed(
    part: BodyGroup,
    frames: LinkPoses,
    bodies: list[Body],
    places: Mapping[Body, Pose],
    further: Mapping[Body, Mapping[int, float]],
) -> LinkPoses:
    """The frames with these bodies elsewhere."""
    if not bodies:
        return frames
    positions, matrices = frames.positions.copy(), frames.matrices.copy()
    states = frames.states.copy()
    for body in bodies:
        run = part.runs[body]
        own = LinkPoses(positions[run], matrices[run], states[run])
        new = moved_link_poses(body, own, places.get(body), further.get(body, {}))
        positions[run], matrices[run], states[run] = new.positions, new.matrices, new.states
    return LinkPoses(positions, matrices, states)


def _joints(states: Array, positions: Mapping[int, float]) -> Array:
    """Positions, velocities and efforts of a body's joints; what a motor would do is unknown."""
    states[:, 2] = np.nan
    for link, position in positions.items():
        states[link - 1, :2] = position, 0.0
    return states
