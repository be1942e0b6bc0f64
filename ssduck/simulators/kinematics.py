"""Forward kinematics: the poses of a body's links for other positions of its base and its joints.

New poses are computed from the present ones: a joint that turns further takes its link, and all
links beyond it, along. So no zero position needs to be known, and joints whose position is not one
number stay as they are.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from ssduck import validation
from ssduck.errors import ArgumentError, StateError, UnknownNameError, nearest
from ssduck.formatting import short_repr
from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.poses import compose, cross, invert, multiply, rotate, rotation_matrices
from ssduck.simulators.interface import SCALAR_JOINTS, Body, Joint, LinkPoses, MotorTarget

Pose: TypeAlias = tuple[Array, Array]
JointValues: TypeAlias = Mapping[str, float] | Sequence[float]

# Positions may exceed limits by this, rad or m: physics solvers leave joints there.
LIMIT_TOLERANCE = 1e-3


# -- checks of requested poses, positions and motor targets -------------------------------------


def parse_pose(values: Sequence[float], of: str) -> Pose:
    """Returns the pose of the numbers w, x, y, z, x, y, z.

    The orientation is scaled to unit length.

    Raises:
        StateError: these are not seven finite numbers, or the orientation is all 0.
    """
    numbers = validation.finite_array(values, 7, f"{of}: pose w, x, y, z, x, y, z")
    return numbers[4:], unit(numbers[:4], of)


def unit(orientation: Array, of: str) -> Array:
    """Returns a quaternion, scaled to unit length.

    Raises:
        StateError: all its numbers are 0.
    """
    # Otherwise the squares of huge numbers would be infinite, and those of tiny ones 0.
    largest = float(np.abs(orientation).max())
    if largest < 1e-9:
        raise StateError(f"{of}: orientation: w, x, y, z are all 0")
    scaled: Array = orientation / largest
    return scaled / float(np.linalg.norm(scaled))


def joint_positions(values: JointValues, body: Body, name: str) -> dict[int, float]:
    """Returns the positions of joints, rad or m, by the indices of the links that they move.

    Args:
        values: positions by joint name, or one for each revolute or prismatic joint, in order.
        body: the body that has the joints.
        name: the name of the body in errors.

    Raises:
        UnknownNameError: there is no joint of a name; with the nearest names.
        ArgumentError: there are too many values or too few, or a joint's position is not one
            number.
        StateError: a value is not finite, or beyond the joint's limits.
    """
    joints = {joint.name: joint for joint in body.joints}
    if not isinstance(values, Mapping):
        _check_sequence(values, name)
        settable = [joint.name for joint in body.joints if joint.type in SCALAR_JOINTS]
        if len(values) != len(settable):
            raise ArgumentError(
                f"{name} takes {len(settable)} joint values ({', '.join(settable) or 'none'}), "
                f"found {len(values)}"
            )
        values = dict(zip(settable, values, strict=True))
    return {
        joint.link: _position(value, joint, name)
        for joint, value in (
            (_scalar_joint(key, joints, name), value) for key, value in values.items()
        )
    }


def motor_targets(
    positions: JointValues | None,
    velocities: Mapping[str, float] | None,
    efforts: Mapping[str, float] | None,
    body: Body,
    name: str,
) -> dict[int, MotorTarget]:
    """Returns the targets of motors by the indices of their links; see `Entity.drive`."""
    for values, quantity in ((velocities, "velocities"), (efforts, "efforts")):
        validation.mapping(values, f"{name}: {quantity} are given by the joints' names, in a dict")
    joints = {joint.name: joint for joint in body.joints}
    position_values = joint_positions(positions, body, name) if positions is not None else {}
    velocity_values = {
        _scalar_joint(key, joints, name).link: _bounded(value, joints[key], "velocity", name)
        for key, value in (velocities or {}).items()
    }
    effort_values = {
        _scalar_joint(key, joints, name).link: _bounded(value, joints[key], "effort", name)
        for key, value in (efforts or {}).items()
    }
    by_link = {joint.link: joint for joint in body.joints}
    for link in position_values.keys() & velocity_values.keys():
        raise ArgumentError(
            f"{name}: joint {by_link[link].name!r} has both a position and a velocity"
        )
    for link in effort_values.keys() - position_values.keys() - velocity_values.keys():
        raise ArgumentError(
            f"{name}: joint {by_link[link].name!r} has an effort, but no position or velocity"
        )
    return {
        link: MotorTarget(
            position=position_values.get(link),
            velocity=velocity_values.get(link, 0.0),
            effort=effort_values.get(link, by_link[link].max_effort or 0.0),
            speed=by_link[link].max_velocity or None,
        )
        for link in sorted(position_values.keys() | velocity_values.keys())
    }


def _check_sequence(values: Any, name: str) -> None:
    """Raises an error if values are not a sequence."""
    if isinstance(values, str) or not isinstance(values, Sequence | np.ndarray):
        raise ArgumentError(
            f"{name}: joint values are given in a list, or by the joints' names in a dict, not as "
            f"{short_repr(values)}"
        )


def _bounded(value: float, joint: Joint, quantity: str, name: str) -> float:
    """Checks a velocity or an effort against the limit of the joint's model."""
    place = f"{name}: joint {joint.name!r}: {quantity}"
    number = float(validation.finite_array([value], 1, place)[0])
    if quantity == "effort" and number < 0.0:
        raise StateError(f"{place} {number:g} is below 0")
    maximum = joint.max_velocity if quantity == "velocity" else joint.max_effort
    if maximum is not None and abs(number) > maximum:
        raise StateError(f"{place} {number:g} is more than the joint's {maximum:g}")
    return number


def link_index(body: Body, link: str, name: str) -> int:
    """Returns the index of a link by its name.

    Raises:
        UnknownNameError: there is none; with the nearest names.
    """
    names = [part.name for part in body.links]
    if link not in names:
        raise UnknownNameError(f"{name} has no link {link!r}", suggestions=nearest(link, names))
    return names.index(link)


def descendant_links(body: Body, link: int) -> set[int]:
    """Returns the indices of a link and of all its descendants."""
    descendants = {link}
    for number, part in enumerate(body.links):  # parents come first
        if part.parent in descendants:
            descendants.add(number)
    return descendants


def _scalar_joint(key: str, joints: Mapping[str, Joint], name: str) -> Joint:
    if key not in joints:
        raise UnknownNameError(f"{name} has no joint {key!r}", suggestions=nearest(key, joints))
    if joints[key].type not in SCALAR_JOINTS:
        raise ArgumentError(
            f"{name}: joint {key!r} is {joints[key].type}; only a joint that is "
            f"{' or '.join(SCALAR_JOINTS)} can be set"
        )
    return joints[key]


def _position(value: float, joint: Joint, name: str) -> float:
    position = float(validation.finite_array([value], 1, f"{name}: joint {joint.name!r}")[0])
    low = -math.inf if joint.lower is None else joint.lower
    high = math.inf if joint.upper is None else joint.upper
    if not low - LIMIT_TOLERANCE <= position <= high + LIMIT_TOLERANCE:
        raise StateError(
            f"{name}: joint {joint.name!r}: {position:g} is not from {low:g} to {high:g}, "
            "the joint's limits"
        )
    return position


# -- the poses of moved links -------------------------------------------------------------------


def moved_link_poses(
    body: Body, link_poses: LinkPoses, base: Pose | None, joints: Mapping[int, float]
) -> LinkPoses:
    """Returns the poses of a body's links after its base and joints were moved, all at rest.

    Joints that are not given keep their positions and velocities.

    Args:
        body: the body.
        link_poses: the present poses of its links.
        base: the new pose of the base link frame; None leaves it as it is.
        joints: the changes of joint positions, rad or m, by the index of the joint's link.
    """
    old = link_poses.states_at(link_poses.positions, np.arange(len(body.links)))
    new = np.zeros_like(old)
    if base is None:
        new[0] = old[0]
    else:
        new[0, :3], new[0, 3:7] = base
    parents = np.array([link.parent for link in body.links], dtype=np.intp)
    if len(parents) > 1:
        within = _relative_states(old[parents[1:]], old[1:])
        for link, change in joints.items():
            _move_joint(within[link - 1 : link], body.joints[link - 1], change)
        for links in _generations(parents):
            new[links] = _absolute_states(new[parents[links]], within[links - 1])
    return LinkPoses(new[:, :3].copy(), rotation_matrices(new[:, 3:7]), new)


def _relative_states(parents: Array, links: Array) -> Array:
    """Returns the states of links (n, 13), at their frames' origins, relative to their parents."""
    arms = links[:, :3] - parents[:, :3]
    inverse = parents[:, 3:7] * np.array([1.0, -1.0, -1.0, -1.0])
    positions, orientations = compose(
        *invert(parents[:, :3], parents[:, 3:7]), links[:, :3], links[:, 3:7]
    )
    to_parent = rotation_matrices(inverse)
    drift = links[:, 7:10] - parents[:, 7:10] - cross(parents[:, 10:], arms)
    spin = links[:, 10:] - parents[:, 10:]
    return np.hstack((positions, orientations, rotate(to_parent, drift), rotate(to_parent, spin)))


def _absolute_states(parents: Array, links: Array) -> Array:
    """Returns the inverse of `_relative_states`: the states of links (n, 13) in the world."""
    to_world = rotation_matrices(parents[:, 3:7])
    positions, orientations = compose(parents[:, :3], parents[:, 3:7], links[:, :3], links[:, 3:7])
    lever_velocities = cross(parents[:, 10:], positions - parents[:, :3])
    velocities = parents[:, 7:10] + lever_velocities + rotate(to_world, links[:, 7:10])
    spins = parents[:, 10:] + rotate(to_world, links[:, 10:])
    return np.hstack((positions, orientations, velocities, spins))


def _move_joint(within: Array, joint: Joint, change: float) -> None:
    """Moves a link (1, 13), relative to its parent, by its joint, in place; at rest afterwards."""
    within[:, 7:] = 0.0
    if joint.type == "prismatic":
        shift = change * np.array([joint.axis])
        within[:, :3] += rotate(rotation_matrices(within[:, 3:7]), shift)
    else:
        turn = np.array([[math.cos(change / 2), *(math.sin(change / 2) * np.array(joint.axis))]])
        within[:, 3:7] = multiply(within[:, 3:7], turn)


def _generations(parents: Indices) -> list[Indices]:
    """Groups the links except the base by depth: its children, their children, and so on."""
    depths = np.zeros(len(parents), dtype=np.intp)
    for link, parent in enumerate(parents[1:].tolist(), 1):
        depths[link] = depths[parent] + 1
    return [np.flatnonzero(depths == depth) for depth in range(1, int(depths.max()) + 1)]
