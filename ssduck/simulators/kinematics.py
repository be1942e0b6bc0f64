"""Where the links of a body are if its base and its joints are elsewhere, and joints by name.

What is asked for is told from where the links are now: a joint that turns by as much more takes
its link, and all that hangs on it, along. So no zero position has to be known, and joints of
types that have no number for a position stay as they are.
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

# How far beyond its limit a joint may be put, rad or m: solvers leave them there.
LIMIT_TOLERANCE = 1e-3


# -- what may be asked for ----------------------------------------------------------------------


def parse_pose(values: Sequence[float], of: str) -> Pose:
    """A pose from w, x, y, z, x, y, z; the orientation is made of unit length.

    Raises:
        StateError: these are no seven finite numbers, or the orientation is all 0.
    """
    numbers = validation.finite_array(values, 7, f"{of}: pose w, x, y, z, x, y, z")
    return numbers[4:], unit(numbers[:4], of)


def unit(orientation: Array, of: str) -> Array:
    """A quaternion made of unit length.

    Raises:
        StateError: it is all 0.
    """
    # Without this, the squares of huge numbers would be infinite, and of tiny ones 0.
    most = float(np.abs(orientation).max())
    if most < 1e-9:
        raise StateError(f"{of}: orientation: w, x, y, z are all 0")
    scaled: Array = orientation / most
    return scaled / float(np.linalg.norm(scaled))


def joint_positions(values: JointValues, body: Body, name: str) -> dict[int, float]:
    """Joints' positions, rad or m, by the numbers of the links that they move.

    Args:
        values: by the joint's name; or one for each joint whose position is a number, in order.
        body: whose joints they are.
        name: what errors call it.

    Raises:
        UnknownNameError: there is no joint of a name, with the nearest names.
        ArgumentError: too many values or too few, or the joint's position is no one number.
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
        for joint, value in ((_named(key, joints, name), value) for key, value in values.items())
    }


def motor_targets(
    positions: JointValues | None,
    velocities: Mapping[str, float] | None,
    efforts: Mapping[str, float] | None,
    body: Body,
    name: str,
) -> dict[int, MotorTarget]:
    """What motors are to do, by the numbers of the links that they move; see `Entity.drive`."""
    for values, what in ((velocities, "velocities"), (efforts, "efforts")):
        validation.mapping(values, f"{name}: {what} are given by the joints' names, in a dict")
    joints = {joint.name: joint for joint in body.joints}
    places = joint_positions(positions, body, name) if positions is not None else {}
    speeds = {
        _named(key, joints, name).link: _bounded(value, joints[key], "velocity", name)
        for key, value in (velocities or {}).items()
    }
    limits = {
        _named(key, joints, name).link: _bounded(value, joints[key], "effort", name)
        for key, value in (efforts or {}).items()
    }
    by_link = {joint.link: joint for joint in body.joints}
    for link in places.keys() & speeds.keys():
        raise ArgumentError(f"{name}: joint {by_link[link].name!r}: a position or a velocity")
    for link in limits.keys() - places.keys() - speeds.keys():
        raise ArgumentError(
            f"{name}: joint {by_link[link].name!r} has an effort, but no position or velocity"
        )
    return {
        link: MotorTarget(
            position=places.get(link),
            velocity=speeds.get(link, 0.0),
            effort=limits.get(link, by_link[link].max_effort or 0.0),
            speed=by_link[link].max_velocity or None,
        )
        for link in sorted(places.keys() | speeds.keys())
    }


def _check_sequence(values: Any, name: str) -> None:
    """Complain of what are no joint values in order."""
    if isinstance(values, str) or not isinstance(values, Sequence | np.ndarray):
        raise ArgumentError(
            f"{name}: joint values are given in a list, or by the joints' names in a dict, not as "
            f"{short_repr(values)}"
        )


def _bounded(value: float, joint: Joint, what: str, name: str) -> float:
    """A velocity or an effort that the joint's model allows."""
    given = float(validation.finite_array([value], 1, f"{name}: joint {joint.name!r}: {what}")[0])
    most = joint.max_velocity if what == "velocity" else joint.max_effort
    if (most is not None and abs(given) > most) or (what == "effort" and given < 0.0):
        raise StateError(
            f"{name}: joint {joint.name!r}: {what} {given:g} is more than the joint's {most:g}"
            if given > 0.0 or what == "velocity"
            else f"{name}: joint {joint.name!r}: effort {given:g} is below 0"
        )
    return given


def link_index(body: Body, link: str, name: str) -> int:
    """The number of a link by its name.

    Raises:
        UnknownNameError: there is none, with the nearest names.
    """
    names = [one.name for one in body.links]
    if link not in names:
        raise UnknownNameError(f"{name} has no link {link!r}", suggestions=nearest(link, names))
    return names.index(link)


def descendant_links(body: Body, link: int) -> set[int]:
    """The numbers of a link and of all that hang on it."""
    found = {link}
    for number, one in enumerate(body.links):  # parents come first
        if one.parent in found:
            found.add(number)
    return found


def _named(key: str, joints: Mapping[str, Joint], name: str) -> Joint:
    if key not in joints:
        raise UnknownNameError(f"{name} has no joint {key!r}", suggestions=nearest(key, joints))
    if joints[key].type not in SCALAR_JOINTS:
        raise ArgumentError(
            f"{name}: joint {key!r} is {joints[key].type}; what can be set has one number for a "
            f"position: {' or '.join(SCALAR_JOINTS)}"
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


# -- where the links are then -------------------------------------------------------------------


def moved_link_poses(
    body: Body, frames: LinkPoses, base: Pose | None, joints: Mapping[int, float]
) -> LinkPoses:
    """A body's frames if its base is put elsewhere, and some joints have moved, all at rest.

    Joints that are not named keep position and velocity.

    Args:
        body: the body.
        frames: where its links are.
        base: of the base link's frame; None leaves it as it is.
        joints: how much further these joints are than now, rad or m, by the joint's link.
    """
    old = frames.at(frames.positions, np.arange(len(body.links)))
    new = np.zeros_like(old)
    if base is None:
        new[0] = old[0]
    else:
        new[0, :3], new[0, 3:7] = base
    parents = np.array([link.parent for link in body.links], dtype=np.intp)
    if len(parents) > 1:
        within = _within(old[parents[1:]], old[1:])
        for link, further in joints.items():
            _drive(within[link - 1 : link], body.joints[link - 1], further)
        for links in _generations(parents):
            new[links] = _outside(new[parents[links]], within[links - 1])
    return LinkPoses(new[:, :3].copy(), rotation_matrices(new[:, 3:7]), new)


def _within(parents: Array, links: Array) -> Array:
    """States of links (n, 13), told of their frames' origins, as their parents see them."""
    arms = links[:, :3] - parents[:, :3]
    away = parents[:, 3:7] * np.array([1.0, -1.0, -1.0, -1.0])
    positions, orientations = compose(
        *invert(parents[:, :3], parents[:, 3:7]), links[:, :3], links[:, 3:7]
    )
    back = rotation_matrices(away)
    drift = links[:, 7:10] - parents[:, 7:10] - cross(parents[:, 10:], arms)
    spin = links[:, 10:] - parents[:, 10:]
    return np.hstack((positions, orientations, rotate(back, drift), rotate(back, spin)))


def _outside(parents: Array, links: Array) -> Array:
    """What `_within` is of: states of links (n, 13) from those that their parents see."""
    turn = rotation_matrices(parents[:, 3:7])
    positions, orientations = compose(parents[:, :3], parents[:, 3:7], links[:, :3], links[:, 3:7])
    swept = cross(parents[:, 10:], positions - parents[:, :3])
    velocities = parents[:, 7:10] + swept + rotate(turn, links[:, 7:10])
    spins = parents[:, 10:] + rotate(turn, links[:, 10:])
    return np.hstack((positions, orientations, velocities, spins))


def _drive(within: Array, joint: Joint, further: float) -> None:
    """Move a link (1, 13) that its parent sees by its joint, in place; it rests then."""
    within[:, 7:] = 0.0
    if joint.type == "prismatic":
        shift = further * np.array([joint.axis])
        within[:, :3] += rotate(rotation_matrices(within[:, 3:7]), shift)
    else:
        turn = np.array([[math.cos(further / 2), *(math.sin(further / 2) * np.array(joint.axis))]])
        within[:, 3:7] = multiply(within[:, 3:7], turn)


def _generations(parents: Indices) -> list[Indices]:
    """The links but the base: its children, then theirs, and so on."""
    depths = np.zeros(len(parents), dtype=np.intp)
    for link, parent in enumerate(parents[1:].tolist(), 1):
        depths[link] = depths[parent] + 1
    return [np.flatnonzero(depths == depth) for depth in range(1, int(depths.max()) + 1)]
