"""The point of an ellipsoid's surface that is nearest to a point, inside or outside.

The vector from the nearest point to the given one is normal to the surface, and points outward with
some length t: the nearest point has the coordinates s² y / (s² + t), and t is the root of an
equation that decreases (Eberly, Distance from a Point to an Ellipse, an Ellipsoid, or a
Hyperellipsoid, 2013). Only for points inside on a plane of symmetry, the surface may be nearest
beside that plane, in two directions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from ssduck.geometry.placed_solid import Point

_ROUNDING = 1e-15
# A coordinate that is a smaller fraction of the half length is 0: the distance hardly changes.
_LEAST_FRACTION = 1e-20


def nearest_on_ellipsoid(semi_axes: Sequence[float], point: Sequence[float]) -> Point:
    """Returns the point of an ellipsoid's surface that is nearest to a point, in its own frame.

    >>> nearest_on_ellipsoid((3.0, 2.0, 1.0), (0.0, 0.0, 5.0))
    (0.0, 0.0, 1.0)
    """
    order = sorted(range(3), key=lambda k: -semi_axes[k])
    found = _nearest([semi_axes[k] for k in order], [abs(point[k]) for k in order])
    result = [0.0, 0.0, 0.0]
    for k, value in zip(order, found, strict=True):
        result[k] = math.copysign(value, point[k]) if point[k] else value
    return result[0], result[1], result[2]


def _nearest(semi_axes: list[float], point: list[float]) -> list[float]:
    """Returns the nearest point, for half lengths that descend and coordinates that are not < 0."""
    shortest = semi_axes[-1]
    if len(semi_axes) == 1:
        return [shortest]
    if point[-1] > _LEAST_FRACTION * shortest:
        return _by_root(semi_axes, point)
    # In the plane of symmetry: beside it, unless the point is too far from the middle.
    rest = [(s - shortest) * (s + shortest) / s for s in semi_axes[:-1]]
    if all(y < r for y, r in zip(point, rest, strict=False)):
        scaled = [y / r for y, r in zip(point, rest, strict=False)]
        level = 1.0 - sum(value * value for value in scaled)
        if level > 0.0:
            places = [s * v for s, v in zip(semi_axes, scaled, strict=False)]
            return [*places, shortest * math.sqrt(level)]
    return [*_nearest(semi_axes[:-1], point[:-1]), 0.0]


def _by_root(semi_axes: list[float], point: list[float]) -> list[float]:
    from scipy.optimize import brentq

    shortest = semi_axes[-1]
    ratios = [(s / shortest) ** 2 for s in semi_axes]
    products = [r * y / s for r, y, s in zip(ratios, point, semi_axes, strict=True)]
    # t in units of the shortest half length squared, from its least value: that is -1, near which
    # the root is for a point near the plane of symmetry, and t itself would round it away.
    others = [(s - shortest) * (s + shortest) / shortest**2 for s in semi_axes]

    def level(rest: float) -> float:
        return sum((p / (rest + o)) ** 2 for p, o in zip(products, others, strict=True)) - 1.0

    low, high = products[-1], math.hypot(*products)
    high += _ROUNDING * high
    if level(low) <= 0.0:
        root = low
    elif level(high) >= 0.0:
        root = high
    else:
        root = brentq(level, low, high, xtol=1e-300, rtol=4 * _ROUNDING, maxiter=200)
    return [r * y / (root + o) for r, y, o in zip(ratios, point, others, strict=True)]
