"""The positions of joints: at a tick, how far open they are, and where those of scenes begin.

The openness of a joint is the fraction of its range from its closed end. The closed end is the
limit that is nearer to 0, or the lower limit if both are equally near. The openness is below 0 or
above 1 where the simulator lets a joint leave its range.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from ssduck.errors import SceneError, UnknownNameError, nearest
from ssduck.formatting import first_names
from ssduck.simulators.interface import SCALAR_JOINTS, Joint
from ssduck.simulators.kinematics import LIMIT_TOLERANCE
from ssduck.simulators.scene_bodies import BodySpec, Primitive

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
    """The joints of an entity at a tick.

    Attributes:
        entity: the name of the entity.
        joints: the joints of its model.
        positions: their positions, rad or m; NaN where unknown.
    """

    entity: str
    joints: Sequence[Joint]
    positions: Sequence[float]

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
        only = f", only {first_names(names)}" if names and not near else ""
        if not names:
            only = f"; leave out what has none: WHERE isRobot(this) AND joint(this, {name!r}) > 0"
        raise JointError(f"{self.entity} has {missing}{only}", suggestions=near)


# -- the joints of scenes --------------------------------------------------------------------------


def check_joints(spec: BodySpec, joints: Sequence[Joint], place: str) -> None:
    """Checks that the bodies of a scene entry can have their joints as the entry says."""
    model = "" if isinstance(spec.model, Primitive) else spec.model.name
    for key in ("joints", "held"):
        for name, value in getattr(spec, key).items():
            _check_joint(name, value, joints, f"{place}{key}.{name}: {model}")
    for name in spec.joint_velocities:
        _check_joint(name, None, joints, f"{place}joint_velocities.{name}: {model}")


def position_nearest_zero(joint: Joint) -> float:
    """Returns 0, or the limit of a joint nearest to 0."""
    low, high = _limits(joint)
    return min(max(0.0, low), high)


def _check_joint(name: str, value: float | None, joints: Sequence[Joint], place: str) -> None:
    """Raises an error for a joint that does not exist or cannot be at a position."""
    by_name = {joint.name: joint for joint in joints}
    if name not in by_name:
        raise SceneError(f"{place} has no such joint", suggestions=nearest(name, by_name))
    joint = by_name[name]
    if joint.type not in SCALAR_JOINTS:
        raise SceneError(f"{place}: a {joint.type} joint has no position")
    low, high = _limits(joint)
    # Solvers leave a joint a little beyond its limits, and worlds are saved in that state.
    if value is not None and not low - LIMIT_TOLERANCE < value < high + LIMIT_TOLERANCE:
        raise SceneError(f"{place}: {value:g} is not from {low:g} to {high:g}, the joint's limits")


def _limits(joint: Joint) -> tuple[float, float]:
    if joint.lower is None or joint.upper is None:
        return -math.inf, math.inf
    return joint.lower, joint.upper
