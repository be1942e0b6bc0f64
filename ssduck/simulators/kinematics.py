"""Joints and forward kinematics: poses of links for other positions of the base and the joints.

New poses are computed from the present ones: a joint that turns further takes its link, and all
links beyond it, along. So no zero position needs to be known, and joints whose position is not one
number stay as they are.

The openness of a joint is the fraction of its range from its closed end. The closed end is the
limit that is nearer to 0, or the lower limit if both are equally near. The openness is below 0 or
above 1 where the simulator lets a joint leave its range.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np

from ssduck import validation
from ssduck.errors import (
    ArgumentError,
    SceneError,
    StateError,
    UnknownNameError,
    UnsupportedError,
    nearest,
)
from ssduck.formatting import joined_names, short_repr
from ssduck.geometry.arrays import Array
from ssduck.geometry.poses import IDENTITY, compose, cross, invert, rotate, rotation_matrices
from ssduck.simulators.interface import SCALAR_JOINTS, Body, Joint, LinkPoses, MotorTarget
from ssduck.simulators.scene_bodies import BodySpec, Primitive

Pose: TypeAlias = tuple[Array, Array]
JointValues: TypeAlias = Mapping[str, float] | Sequence[float]

# Positions may exceed limits by this, rad or m: physics solvers leave joints there.
LIMIT_TOLERANCE = 1e-3


# -- checks of requested poses, positions and motor targets -------------------------------------


def parse_pose(values: Sequence[float], of: str) -> Pose:
    """Returns the pose of the numbers w, x, y, z, x, y, z, with a unit quaternion."""
    numbers = validation.finite_array(values, 7, f"{of}: pose w, x, y, z, x, y, z")
    return numbers[4:], unit(numbers[:4], of)


def unit(orientation: Array, of: str) -> Array:
    """Returns a quaternion, scaled to unit length."""
    # Otherwise the squares of huge numbers would be infinite, and those of tiny ones 0.
    largest = float(np.abs(orientation).max())
    if largest < 1e-9:
        raise StateError(f"{of}: orientation: w, x, y, z are all 0")
    scaled: Array = orientation / largest
    return scaled / float(np.linalg.norm(scaled))


def joint_positions(values: JointValues, body: Body, name: str) -> dict[int, float]:
    """Returns positions of joints, rad or m, by index: given by name, or one for each scalar."""
    if not isinstance(values, Mapping):
        if isinstance(values, str) or not isinstance(values, Sequence | np.ndarray):
            raise ArgumentError(
                f"{name}: joint values are given in a list, or by the joints' names in a dict, not "
                f"as {short_repr(values)}"
            )
        settable = [joint.name for joint in body.joints if joint.type in SCALAR_JOINTS]
        if len(values) != len(settable):
            raise ArgumentError(
                f"{name} takes {len(settable)} joint values ({', '.join(settable) or 'none'}), "
                f"found {len(values)}"
            )
        values = dict(zip(settable, values, strict=True))
    return {
        (n := _scalar_joint(key, body, name)): _position(value, body.joints[n], name)
        for key, value in values.items()
    }


def motor_targets(
    positions: JointValues | None,
    velocities: Mapping[str, float] | None,
    efforts: Mapping[str, float] | None,
    body: Body,
    name: str,
) -> dict[int, MotorTarget]:
    """Returns the targets of motors by the indices of their joints; see `Entity.drive`."""
    for values, quantity in ((velocities, "velocities"), (efforts, "efforts")):
        validation.mapping(values, f"{name}: {quantity} are given by the joints' names, in a dict")
    position_values = joint_positions(positions, body, name) if positions is not None else {}
    velocity_values, effort_values = (
        {
            (n := _scalar_joint(key, body, name)): _bounded(value, body.joints[n], of, name)
            for key, value in (values or {}).items()
        }
        for values, of in ((velocities, "velocity"), (efforts, "effort"))
    )
    for number in position_values.keys() & velocity_values.keys():
        raise ArgumentError(
            f"{name}: joint {body.joints[number].name!r} has both a position and a velocity"
        )
    for number in effort_values.keys() - position_values.keys() - velocity_values.keys():
        raise ArgumentError(
            f"{name}: joint {body.joints[number].name!r} has an effort, but no position or velocity"
        )
    return {
        number: MotorTarget(
            position=position_values.get(number),
            velocity=velocity_values.get(number, 0.0),
            effort=effort_values.get(number, body.joints[number].max_effort or 0.0),
            speed=body.joints[number].max_velocity or None,
        )
        for number in sorted(position_values.keys() | velocity_values.keys())
    }


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
    """Returns the index of a link by its name."""
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


def _scalar_joint(key: str, body: Body, name: str) -> int:
    """Returns the index of the joint of a name, whose position is one number."""
    joints = {joint.name: number for number, joint in enumerate(body.joints)}
    if key not in joints:
        raise UnknownNameError(f"{name} has no joint {key!r}", suggestions=nearest(key, joints))
    type = body.joints[joints[key]].type
    if type not in SCALAR_JOINTS:
        raise ArgumentError(
            f"{name}: joint {key!r} is {type}; only a joint that is "
            f"{' or '.join(SCALAR_JOINTS)} can be set"
        )
    return joints[key]


def _position(value: float, joint: Joint, name: str) -> float:
    position = float(validation.finite_array([value], 1, f"{name}: joint {joint.name!r}")[0])
    low, high = _limits(joint)
    if not low - LIMIT_TOLERANCE <= position <= high + LIMIT_TOLERANCE:
        raise StateError(
            f"{name}: joint {joint.name!r}: {position:g} is not from {low:g} to {high:g}, "
            "the joint's limits"
        )
    return position


# -- the poses of moved links -------------------------------------------------------------------


def moved_link_poses(
    body: Body,
    link_poses: LinkPoses,
    base: Pose | None,
    joints: Mapping[int, float],
    states: Array | None = None,
) -> LinkPoses:
    """Returns the poses of a body's links after its base and joints were moved, all at rest.

    Joints that are not given keep their positions and velocities.

    Args:
        body: the body.
        link_poses: the present poses of its links.
        base: the new pose of the base link frame; None leaves it to the joints of the base.
        joints: the changes of joint positions, rad or m, by the index of the joint.
        states: the present positions and velocities of all joints, (joints, 2 or more); needed
            where a link with several joints moves.
    """
    old = link_poses.states_at(link_poses.positions, np.arange(len(body.links)))
    parents = np.array([link.parent for link in body.links], dtype=np.intp)
    # The parent of the base is the world, the last row.
    frames = np.concatenate((old, _WORLD))
    within = relative_states(frames[parents], old)
    moving = sorted({body.joints[number].link for number in joints})
    for link in moving:
        numbers = [n for n, joint in enumerate(body.joints) if joint.link == link]
        _move_link(within[link : link + 1], body.joints, numbers, joints, states)
    new = np.zeros_like(old)
    if base is not None:
        new[0, :3], new[0, 3:7] = base
    elif 0 in moving:
        new[:1] = absolute_states(_WORLD, within[:1])
    else:
        new[0] = old[0]
    depths = np.zeros(len(parents), dtype=np.intp)
    for link, parent in enumerate(parents[1:].tolist(), 1):
        depths[link] = depths[parent] + 1
    for depth in range(1, int(depths.max()) + 1):
        links = np.flatnonzero(depths == depth)
        new[links] = absolute_states(new[parents[links]], within[links])
    return LinkPoses(new[:, :3].copy(), new)


# The state of the world's frame.
_WORLD = np.array([[0.0, 0.0, 0.0, 1.0, *(0.0,) * 9]])


def relative_states(parents: Array, links: Array) -> Array:
    """Returns the states of links (n, 13), at their frames' origins, relative to their parents."""
    arms = links[:, :3] - parents[:, :3]
    inverse = invert(*_pose(parents))
    positions, orientations = compose(*inverse, *_pose(links))
    to_parent = rotation_matrices(inverse[1])
    drift = links[:, 7:10] - parents[:, 7:10] - cross(parents[:, 10:], arms)
    spin = links[:, 10:] - parents[:, 10:]
    return np.hstack((positions, orientations, rotate(to_parent, drift), rotate(to_parent, spin)))


def absolute_states(parents: Array, links: Array) -> Array:
    """Returns the inverse of `relative_states`: the states of links (n, 13) in the world."""
    to_world = rotation_matrices(parents[:, 3:7])
    positions, orientations = compose(*_pose(parents), *_pose(links))
    lever_velocities = cross(parents[:, 10:], positions - parents[:, :3])
    velocities = parents[:, 7:10] + lever_velocities + rotate(to_world, links[:, 7:10])
    spins = parents[:, 10:] + rotate(to_world, links[:, 10:])
    return np.hstack((positions, orientations, velocities, spins))


def _move_link(
    within: Array,
    joints: Sequence[Joint],
    numbers: Sequence[int],
    changes: Mapping[int, float],
    states: Array | None,
) -> None:
    """Moves a link (1, 13), relative to its parent, by its joints, in place."""
    within[:, 7:] = 0.0
    if len(numbers) == 1:
        step = _displacement(joints[numbers[0]], changes[numbers[0]])
        within[:, :3], within[:, 3:7] = compose(*_pose(within), *step)
        return
    if states is None:
        states = np.full((len(joints), 2), np.nan)
    old = {n: _position_of(joints[n], float(states[n, 0])) for n in numbers}
    new = {n: position + changes.get(n, 0.0) for n, position in old.items()}
    fixed = compose(*_pose(within), *invert(*_product(joints, old, numbers)))
    within[:, :3], within[:, 3:7] = compose(*fixed, *_product(joints, new, numbers))
    for place, number in enumerate(numbers):
        if number not in changes:
            later = _product(joints, new, numbers[place + 1 :])
            _add_velocity(within, joints[number], float(states[number, 1]), later)


def _pose(states: Array) -> Pose:
    return states[:, :3], states[:, 3:7]


def _position_of(joint: Joint, position: float) -> float:
    """Returns the present position of a joint of a link that has several."""
    if joint.type not in SCALAR_JOINTS or math.isnan(position):
        raise UnsupportedError(
            f"joint {joint.name!r} moves a link with others, and its position is "
            f"{'unknown' if joint.type in SCALAR_JOINTS else 'not one number'}: where the others "
            "would move the link is unknown, too"
        )
    return position


def _displacement(joint: Joint, change: float) -> Pose:
    """Returns the pose, in the frame of a joint's link, that a change of its position gives it."""
    if joint.type == "prismatic":
        return change * np.array([joint.axis]), IDENTITY[None]
    turn = np.array([[math.cos(change / 2), *(math.sin(change / 2) * np.array(joint.axis))]])
    anchor = np.array([joint.anchor])
    return anchor - rotate(rotation_matrices(turn), anchor), turn


def _product(
    joints: Sequence[Joint], positions: Mapping[int, float], numbers: Sequence[int]
) -> Pose:
    """Returns the pose that joints of one link give it, one after the other."""
    pose: Pose = np.zeros((1, 3)), IDENTITY[None]
    for number in numbers:
        moved = positions[number] - joints[number].reference
        pose = compose(*pose, *_displacement(joints[number], moved))
    return pose


def _add_velocity(within: Array, joint: Joint, velocity: float, later: Pose) -> None:
    """Adds the velocity that a joint gives its link, relative to the parent, in place."""
    position, turn = invert(*later)
    back, to_parent = rotation_matrices(turn), rotation_matrices(within[:, 3:7])
    axis = velocity * rotate(back, np.array([joint.axis]))
    if joint.type == "prismatic":
        within[:, 7:10] += rotate(to_parent, axis)
        return
    anchor = position + rotate(back, np.array([joint.anchor]))
    within[:, 7:10] += rotate(to_parent, cross(axis, -anchor))
    within[:, 10:] += rotate(to_parent, axis)


# The default least openness of an open joint, and greatest openness of a closed one.
OPEN, CLOSED = 0.5, 0.05
# The rounding error of an openness.
OPENNESS_TOLERANCE = 1e-9


class JointError(UnknownNameError):
    """An entity has no joint of a name, or the joint has no position or openness."""


class HasLimits(Protocol):
    """A joint of a model or at a tick, with limits in rad or m."""

    @property
    def type(self) -> str:
        """The type of the joint."""

    @property
    def lower(self) -> float | None:
        """The lower limit."""

    @property
    def upper(self) -> float | None:
        """The upper limit."""


def openness(joint: HasLimits, position: float) -> float | None:
    """Returns the openness of a joint, a fraction of its range; None without two limits.

    >>> openness(Joint("door", "revolute", 1, 0.0, 2.0, None, None), 0.5)
    0.25

    Args:
        joint: the joint.
        position: its position, rad or m; NaN yields NaN.
    """
    lower, upper = joint.lower, joint.upper
    if joint.type not in SCALAR_JOINTS or lower is None or upper is None:
        return None
    if not (math.isfinite(upper - lower) and lower < upper):
        return None
    distance = upper - position if abs(upper) < abs(lower) else position - lower
    return distance / (upper - lower)


@dataclass(frozen=True)
class EntityJoints:
    """The joints of an entity at a tick."""

    entity: str  # the name of the entity
    joints: Sequence[Joint]  # the joints of its model
    positions: Sequence[float]  # their positions, rad or m; NaN where unknown

    def position(self, name: str) -> float | None:
        """Returns the position of a joint, rad or m; None if it is unknown."""
        joint, position = self._find(name)
        if joint.type not in SCALAR_JOINTS:
            raise JointError(
                f"{self.entity}: joint {name!r} is {joint.type}; only a joint that is "
                f"{' or '.join(SCALAR_JOINTS)} has a position of one number"
            )
        return None if math.isnan(position) else position

    def openness(self, name: str) -> float | None:
        """Returns the openness of a joint; None if its position is unknown."""
        joint, position = self._find(name)
        fraction = openness(joint, position)
        if fraction is None:
            raise JointError(
                f"{self.entity}: joint {name!r} is {joint.type} and has no range between two "
                "limits, so that it is neither open nor closed"
            )
        return None if math.isnan(fraction) else fraction

    def most_open(self) -> float | None:
        """Returns the openness of the joint that is open farthest; -inf if no joint has limits.

        None if a position is unknown.
        """
        all_joints = map(openness, self.joints, self.positions)
        fractions = [fraction for fraction in all_joints if fraction is not None]
        return None if any(map(math.isnan, fractions)) else max(fractions, default=-math.inf)

    def _find(self, name: str) -> tuple[Joint, float]:
        for joint, position in zip(self.joints, self.positions, strict=True):
            if joint.name == name:
                return joint, position
        names = [joint.name for joint in self.joints]
        near = nearest(name, names)
        missing = f"no joint {name!r}" if names else "no joints"
        only = f", only {joined_names(names, 6)}" if names and not near else ""
        if not names:
            only = f"; leave out what has none: WHERE isRobot(this) AND joint(this, {name!r}) > 0"
        raise JointError(f"{self.entity} has {missing}{only}", suggestions=near)


# -- the joints of scenes --------------------------------------------------------------------------


def check_joints(spec: BodySpec, joints: Sequence[Joint], place: str) -> None:
    """Checks that the bodies of a scene entry can have their joints as the entry says."""
    model = "" if isinstance(spec.model, Primitive) else spec.model.name
    by_name = {joint.name: joint for joint in joints}
    for key in ("joints", "held", "joint_velocities"):
        for name, value in getattr(spec, key).items():
            where = f"{place}{key}.{name}: {model}"
            if name not in by_name:
                raise SceneError(f"{where} has no such joint", suggestions=nearest(name, by_name))
            joint = by_name[name]
            if joint.type not in SCALAR_JOINTS:
                raise SceneError(f"{where}: a {joint.type} joint has no position")
            low, high = _limits(joint)
            # Solvers leave a joint a little beyond its limits, and worlds are saved in that state.
            is_within = low - LIMIT_TOLERANCE < value < high + LIMIT_TOLERANCE
            if key != "joint_velocities" and not is_within:
                limits = f"{value:g} is not from {low:g} to {high:g}, the joint's limits"
                raise SceneError(f"{where}: {limits}")


def position_nearest_zero(joint: Joint) -> float:
    """Returns 0, or the limit of a joint nearest to 0."""
    low, high = _limits(joint)
    return min(max(0.0, low), high)


def _limits(joint: Joint) -> tuple[float, float]:
    low = -math.inf if joint.lower is None else joint.lower
    return low, math.inf if joint.upper is None else joint.upper
