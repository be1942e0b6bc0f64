"""Determines which contacts carry a body, by their normals, without friction and moments.

A force that points nearly up carries alone. Steeper ones carry together if their sum can point
nearly up: the two sides of a groove, three balls under a fourth, a slope and a wall.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import combinations

import numpy as np

from ssduck.geometry.placed_solid import Point

# A force within 30 degrees of up carries, alone or as a sum.
MIN_UP = math.cos(math.radians(30.0)) - 1e-9
# A force that deviates from up by more than 80 degrees does not carry, but may counteract.
MIN_RISING = math.cos(math.radians(80.0))
# A force that points down by less counts as level.
LEVEL = 1e-3
# Forces that agree to this number of digits are equal.
DIGITS = 3


def is_carried_by(own_normals: Sequence[Point], other_normals: Iterable[Point]) -> bool:
    """Checks whether a body is carried by another one, alone or together with others.

    It is if one of the other's normals is in a set of normals that have a positive combination
    within 30 degrees of up, while no part of the set has one: then they need each other.
    """
    if any(normal[2] >= MIN_UP for normal in own_normals):
        return True
    rising = _distinct(normal for normal in own_normals if normal[2] >= MIN_RISING)
    if not rising:
        return False
    steep = _distinct(p for p in (*own_normals, *other_normals) if -LEVEL <= p[2] < MIN_UP)
    if any(_can_point_up(p, q) for p in rising for q in steep):
        return True
    return any(
        _balance_upward(p, q, r) and not _can_point_up(q, r)
        for p in rising
        for q, r in combinations(steep, 2)
    )


def _distinct(normals: Iterable[Point]) -> list[Point]:
    """Returns normals without near duplicates."""
    return list(
        {tuple(round(part, DIGITS) for part in normal): normal for normal in normals}.values()
    )


def _can_point_up(p: Point, q: Point) -> bool:
    """Checks whether a positive sum of two steep normals, both needed, can point nearly up."""
    cosine = p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
    squared_sine = 1.0 - cosine * cosine
    if squared_sine < 1e-9:
        return False
    weight_p, weight_q = (
        (p[2] - cosine * q[2]) / squared_sine,
        (q[2] - cosine * p[2]) / squared_sine,
    )
    # The projection of up to their plane is weight_p * p + weight_q * q; its z is its squared
    # length.
    return weight_p > 0.0 and weight_q > 0.0 and weight_p * p[2] + weight_q * q[2] >= MIN_UP**2


def _balance_upward(p: Point, q: Point, r: Point) -> bool:
    """Checks whether a positive sum of three normals points up, with all of them needed."""
    normals = np.array([p, q, r]).T
    if abs(float(np.linalg.det(normals))) < 1e-9:
        return False
    return bool((np.linalg.solve(normals, [0.0, 0.0, 1.0]) > 1e-9).all())
