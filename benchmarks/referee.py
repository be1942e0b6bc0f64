"""Who is right where two ways disagree whether a pair collides: depths between proved bounds.

The depth of two convex shapes is the least of their overlaps in all directions, and below 0 if
they are apart. So the overlap in any one direction bounds it from above. Their difference holds
the hull of some of its points, the farthest ones in the directions tried; how deep the origin is
in that hull bounds it from below. Trying the normals of the hull's thinnest faces next brings
the two together (van den Bergh, Proximity queries and penetration depth computation, 2001).
Nothing of ssduck's or of its peers' is used.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from benchmarks.crowds import Crowd
from ssduck.geometry.arrays import Array

ROUNDS = 30
# So many of the thinnest faces are tried at once: of round shapes all are as thin.
_THINNEST = 16


def _around(count: int = 64) -> Array:
    """Directions evenly around."""
    index = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * index / count, math.pi * (1.0 + math.sqrt(5.0)) * index
    ring = np.sqrt(1.0 - z * z)
    return np.stack((ring * np.cos(angle), ring * np.sin(angle), z), axis=1)


def _farthest(crowd: Crowd, body: int, ways: Array) -> Array:
    """The points of a body that are farthest in some directions, (n, 3)."""
    matrix = crowd.matrix(body)
    found: Array = crowd.piece(body).reached(ways @ matrix) @ matrix.T + crowd.positions[body]
    return found


def bounds(crowd: Crowd, i: int, j: int, beside: float) -> tuple[float, float]:
    """Bounds of how deep two bodies are in each other, metres; minus infinity if none is known.

    Args:
        crowd: whose bodies they are.
        i: a body.
        j: another.
        beside: depths at either side of this one, not below 0, are not told apart any further.
    """
    ways = _around()
    points = np.zeros((0, 3))
    least, most = -math.inf, math.inf
    for _ in range(ROUNDS):
        new = _farthest(crowd, i, ways) - _farthest(crowd, j, -ways)
        most = min(most, float(np.einsum("ij,ij->i", ways, new).min()))
        points = np.concatenate((points, new))
        if most < beside:
            break
        try:
            hull = ConvexHull(points)
        except QhullError:
            break
        inside = -hull.equations[:, 3]
        if inside.min() >= 0.0:  # else the origin is out of it, which tells nothing
            least = max(least, float(inside.min()))
        if least > beside:
            break
        ways = hull.equations[np.argsort(inside)[:_THINNEST], :3]
    return least, most


def verdict(crowd: Crowd, i: int, j: int, deeper: float) -> bool | None:
    """Whether two bodies are deeper in each other; None if it is too close to tell."""
    least, most = bounds(crowd, i, j, deeper)
    if least > deeper:
        return True
    return False if most < deeper else None


def may_touch(crowd: Crowd, i: int, j: int, within: float) -> bool:
    """Whether nothing proves that two bodies are deeper, or farther apart."""
    least, most = bounds(crowd, i, j, within)
    return least <= within and most >= -within
