"""Positions of an entity's joints at a tick, and how far open they are.

How far a joint is open is told as a share of its range, from its closed end: that of its two limits
that is nearer to 0, or the lower one where both are as near. It is below 0 or above 1 where the
simulator lets a joint go beyond its limits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from ssduck.errors import UnknownNameError, nearest
from ssduck.simulators.interface import SCALAR_JOINTS, Joint

# What is open, and what is closed, if no share is given.
OPEN, CLOSED = 0.5, 0.05
# Shares are rounded by as much.
ROUNDED = 1e-9


class JointError(UnknownNameError):
    """An entity has no joint of a name, or not one with what is asked of it."""


class HasLimits(Protocol):
    """What moves between limits, rad or m: a joint of a model, or one at a tick."""

    @property
    def type(self) -> str:
        """What kind of joint it is."""

    @property
    def lower(self) -> float | None:
        """The lower limit."""

    @property
    def upper(self) -> float | None:
        """The upper limit."""


def openness(joint: HasLimits, position: float) -> float | None:
    """How far a joint is open, as a share of its range; None if it has no two limits.

    Args:
        joint: the joint.
        position: where it is, rad or m; of NaN comes NaN.
    """
    lower, upper = joint.lower, joint.upper
    if joint.type not in SCALAR_JOINTS or lower is None or upper is None:
        return None
    if not (math.isfinite(upper - lower) and lower < upper):
        return None
    way = upper - position if abs(upper) < abs(lower) else position - lower
    return way / (upper - lower)


@dataclass(frozen=True)
class EntityJoints:
    """The joints of an entity at a tick.

    Attributes:
        entity: what the entity is called.
        joints: as in its model.
        positions: of each, rad or m; NaN where it is unknown.
    """

    entity: str
    joints: Sequence[Joint]
    positions: Sequence[float]

    def position(self, name: str) -> float | None:
        """The position of a joint, rad or m; None where it is unknown.

        Raises:
            JointError: there is no such joint, or its position is not one number.
        """
        joint, position = self._named(name)
        if joint.type not in SCALAR_JOINTS:
            raise JointError(
                f"{self.entity}: joint {name!r} is {joint.type}; a position of one number has "
                f"what is {' or '.join(SCALAR_JOINTS)}"
            )
        return None if math.isnan(position) else position

    def openness(self, name: str) -> float | None:
        """How far a joint is open; None where its position is unknown.

        Raises:
            JointError: there is no such joint, or it has no limits.
        """
        joint, position = self._named(name)
        share = openness(joint, position)
        if share is None:
            raise JointError(
                f"{self.entity}: joint {name!r} is {joint.type} and has no range between two "
                "limits, so that it is neither open nor closed"
            )
        return None if math.isnan(share) else share

    def most_open(self) -> float | None:
        """How far the joint that is open farthest is; -inf if none has limits.

        None where a position is unknown.
        """
        found = map(openness, self.joints, self.positions)
        shares = [share for share in found if share is not None]
        return None if any(map(math.isnan, shares)) else max(shares, default=-math.inf)

    def _named(self, name: str) -> tuple[Joint, float]:
        for joint, position in zip(self.joints, self.positions, strict=True):
            if joint.name == name:
                return joint, position
        names = [joint.name for joint in self.joints]
        told = f"{self.entity} has no joint {name!r}" if names else f"{self.entity} has no joints"
        raise JointError(told, suggestions=nearest(name, names))
