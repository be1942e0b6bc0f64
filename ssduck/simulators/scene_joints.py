"""The joints of scenes' bodies: where they begin, and whether a model has them."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ssduck.errors import SceneError, nearest
from ssduck.simulators.interface import SCALAR_JOINTS, Joint
from ssduck.simulators.kinematics import LIMIT_TOLERANCE
from ssduck.simulators.scene_bodies import BodySpec, Primitive


def check_joints(spec: BodySpec, joints: Sequence[Joint], place: str) -> None:
    """Checks that the bodies of a scene entry can have their joints as the entry says.

    Args:
        spec: the entry.
        joints: the joints of its bodies.
        place: the place of the entry in errors.

    Raises:
        SceneError: there is no such joint, or it cannot be at such a position.
    """
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
