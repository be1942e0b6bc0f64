"""Which pushes carry a body: by the normals of its contacts, without friction and moments.

A push that is near up carries alone. Steeper ones carry together, where their sum may be near up:
as of the two sides of a groove, of three balls under a fourth one, of a slope and a wall.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import combinations

import numpy as np

from ssduck.geometry.placed_solid import Point

# What carries pushes within 30 degrees of up, alone or together with others.
UPRIGHT = math.cos(math.radians(30.0)) - 1e-9
# Of pushes that carry together, one that is farther from up than 80 degrees only holds against.
RISING = math.cos(math.radians(80.0))
# What pushes down by no more is level.
LEVEL = 1e-3
# Pushes that are as alike are one.
ALIKE = 3


def is_carried_by(own: Sequence[Point], others: Iterable[Point]) -> bool:
    """Whether a body carries another one, alone or with others.

    It does if one of its pushes is in a set of pushes that together may be within 30 degrees of up,
    and of which no part may be so: then they need each other.

    Args:
        own: the unit normals of the contacts in which it pushes that body.
        others: those in which other bodies push it.
    """
    if any(push[2] >= UPRIGHT for push in own):
        return True
    rising = _different(push for push in own if push[2] >= RISING)
    if not rising:
        return False
    steep = _different(p for p in (*own, *others) if -LEVEL <= p[2] < UPRIGHT)
    if any(_may_rise(p, q) for p in rising for q in steep):
        return True
    return any(
        _hold_together(p, q, r) and not _may_rise(q, r)
        for p in rising
        for q, r in combinations(steep, 2)
    )


def _different(pushes: Iterable[Point]) -> list[Point]:
    """Without those that are about the same."""
    return list({tuple(round(part, ALIKE) for part in push): push for push in pushes}.values())


def _may_rise(p: Point, q: Point) -> bool:
    """Whether a sum of two steep pushes may be near up: where that is nearest, both are needed."""
    along = p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
    room = 1.0 - along * along
    if room < 1e-9:
        return False
    of_p, of_q = (p[2] - along * q[2]) / room, (q[2] - along * p[2]) / room
    # The part of up in their plane is of_p * p + of_q * q; its height is its length's square.
    return of_p > 0.0 and of_q > 0.0 and of_p * p[2] + of_q * q[2] >= UPRIGHT**2


def _hold_together(p: Point, q: Point, r: Point) -> bool:
    """Whether a sum of three pushes is up, each of which is needed."""
    pushes = np.array([p, q, r]).T
    if abs(float(np.linalg.det(pushes))) < 1e-9:
        return False
    return bool((np.linalg.solve(pushes, [0.0, 0.0, 1.0]) > 1e-9).all())
