"""Copies some bodies of a MuJoCo simulation into a new one.

A compiled model cannot lose bodies. So the copy has the whole model, in which the bodies that were
not chosen neither collide nor pull at others, and are not described. The state is copied exactly if
the tick is the present one; else it is set from the poses and joints of the tick.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ssduck.errors import UnsupportedError, warn
from ssduck.formatting import joined_names
from ssduck.geometry.poses import compose, invert
from ssduck.simulators.backends import BodyToCopy, TickToCopy
from ssduck.simulators.interface import SCALAR_JOINTS, Simulator
from ssduck.simulators.mujoco.flexes import entity_roots
from ssduck.simulators.mujoco.interventions import take_out
from ssduck.simulators.mujoco.library import copied_data, mujoco
from ssduck.simulators.mujoco.simulator import MuJoCoSimulator


def excerpt(
    source: Simulator | None, originals: Sequence[BodyToCopy], tick: TickToCopy
) -> MuJoCoSimulator:
    """Starts a simulation of some bodies as they are at a tick; see `Backend.excerpt`."""
    if not isinstance(source, MuJoCoSimulator):
        raise UnsupportedError("a record holds no MuJoCo model: copy entities of the running world")
    earlier = [one.name for one in originals if not source.has(one.body)]
    if earlier:
        raise UnsupportedError(
            f"{joined_names(earlier)}: MuJoCo's model is another one by now, and cannot be copied "
            "as it was"
        )
    model = source.switched_on(source.model)
    data = copied_data(source.model, source.data, mujoco.MjData(model))
    chosen = {one.body.handle for one in originals}
    # Where everything is copied, so is what the world body shows.
    kept = {0, *chosen} if source.has_only(chosen) else chosen
    take_out(model, data, ~np.isin(entity_roots(model), list(kept)))
    if not _is_present(source, originals, tick):
        _restore(model, data, originals, tick)
    return MuJoCoSimulator(
        lambda: (model, data),
        owned=True,
        part_names=source.part_names,
        names={one.body.handle: one.name for one in originals},
        kinds={one.body.handle: one.body.kind for one in originals},
        only=chosen,
        spec=source.spec,
        switched_off=(
            [body.handle for body in tick.disabled],
            [body.handle for body in tick.hidden],
        ),
    )


def _is_present(source: MuJoCoSimulator, originals: Sequence[BodyToCopy], tick: TickToCopy) -> bool:
    """Checks whether bodies are at the tick as they are now."""
    bodies = tuple(one.body for one in originals)
    now = source.read_link_poses(bodies, with_velocities=True)
    parts = [one.link_poses.states for one in originals]
    states = np.concatenate([np.zeros((0, 13)), *parts])
    return tick.time == source.time and np.array_equal(now.states, states)


def _restore(model: Any, data: Any, originals: Sequence[BodyToCopy], tick: TickToCopy) -> None:
    """Sets the state from the poses and joints of a tick."""
    data.time = tick.time
    for original in originals:
        if original.body.handle:  # the world body does not move
            _restore_base(model, data, original)
            _restore_joints(model, data, original)
    if model.nu:
        warn("the copy of an earlier or assumed tick has the present controls of actuators")
    mujoco.mj_forward(model, data)


def _restore_base(model: Any, data: Any, original: BodyToCopy) -> None:
    root, state = original.body.handle, original.base_state
    position = state[:3]
    joint, mocap = int(model.body_jntadr[root]), int(model.body_mocapid[root])
    if mocap >= 0:
        data.mocap_pos[mocap], data.mocap_quat[mocap] = position, state[3:7]
    elif joint < 0:
        model.body_pos[root], model.body_quat[root] = position, state[3:7]
    elif model.jnt_type[joint] == int(mujoco.mjtJoint.mjJNT_FREE):
        first, velocity = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        data.qpos[first : first + 7] = state[:7]
        data.qvel[velocity : velocity + 3] = state[7:10]
        # MuJoCo has the angular velocity of a free joint in the frame of the body.
        data.qvel[velocity + 3 : velocity + 6] = original.link_poses.matrices[0].T @ state[10:]


def _restore_joints(model: Any, data: Any, original: BodyToCopy) -> None:
    """Sets the joints but a free one, whose pose is that of the base."""
    body = original.body
    first = 0
    for number, link in enumerate(body.links):
        joints = [joint for joint in body.joints if joint.link == number]
        for place, joint in enumerate(joints):
            index = int(model.body_jntadr[body.handle + number]) + place
            position, velocity = original.joints[first + place].tolist()
            if joint.type in SCALAR_JOINTS and not np.isnan(position):
                data.qpos[model.jnt_qposadr[index]] = position
                data.qvel[model.jnt_dofadr[index]] = 0.0 if np.isnan(velocity) else velocity
            elif joint.type == "spherical" and len(joints) == 1:
                _restore_ball(model, data, original, (number, link.parent, index))
            elif joint.type != "free":
                raise UnsupportedError(
                    f"{original.name}: the position of joint {joint.name!r} at {data.time:g} s is "
                    "unknown: record the table of joints"
                )
        first += len(joints)


def _restore_ball(
    model: Any, data: Any, original: BodyToCopy, numbers: tuple[int, int, int]
) -> None:
    """Sets a ball joint from the orientations of its link and of the parent."""
    link, parent, joint = numbers
    states = original.link_poses.states
    turns = states[:, 3:7]
    zero = np.zeros((1, 3))
    before = turns[parent : parent + 1] if parent >= 0 else np.array([[1.0, 0.0, 0.0, 0.0]])
    fixed = compose(zero, before, zero, model.body_quat[original.body.handle + link][None])
    _, turn = compose(*invert(*fixed), zero, turns[link : link + 1])
    first, velocity = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    data.qpos[first : first + 4] = turn[0]
    spin = states[link, 10:] - (states[parent, 10:] if parent >= 0 else 0.0)
    data.qvel[velocity : velocity + 3] = original.link_poses.matrices[link].T @ spin
