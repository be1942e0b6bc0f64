"""Decides whether a pair collides if two ways disagree, by proved bounds of the depth.

A part of `benchmarks.pairs`; it measures nothing and uses no code of ssduck or of its peers.

The depth of two convex shapes is the least overlap in any direction, and negative if they are
apart. So the overlap in one direction is an upper bound. The Minkowski difference contains the hull
of its farthest points in the directions tried; the depth of the origin in that hull is a lower
bound. Trying the normals of the faces nearest to the origin next brings the bounds together (van
den Bergh, Proximity queries and penetration depth computation, 2001).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from benchmarks.random_scenes import RandomScene
from ssduck.geometry.arrays import Array

ROUNDS = 30
# The number of nearest faces tried at once: on round shapes all are about equally near.
_NEAREST = 16


def _sphere_directions(count: int = 64) -> Array:
    """Returns evenly distributed directions."""
    index = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * index / count, math.pi * (1.0 + math.sqrt(5.0)) * index
    ring = np.sqrt(1.0 - z * z)
    return np.stack((ring * np.cos(angle), ring * np.sin(angle), z), axis=1)


def _farthest(scene: RandomScene, body: int, directions: Array) -> Array:
    """Returns the points of a body that are farthest in some directions, (n, 3)."""
    matrix = scene.matrix(body)
    points: Array = (
        scene.piece(body).farthest(directions @ matrix) @ matrix.T + scene.positions[body]
    )
    return points


def bounds(scene: RandomScene, i: int, j: int, beside: float) -> tuple[float, float]:
    """Returns bounds of the depth of two bodies, metres; minus infinity if none is known.

    Args:
        scene: the scene of the bodies.
        i: a body.
        j: another body.
        beside: a depth of at least 0; the bounds stop improving once both are on one side of it.
    """
    directions = _sphere_directions()
    points = np.zeros((0, 3))
    lower, upper = -math.inf, math.inf
    for _ in range(ROUNDS):
        new = _farthest(scene, i, directions) - _farthest(scene, j, -directions)
        upper = min(upper, float(np.einsum("ij,ij->i", directions, new).min()))
        points = np.concatenate((points, new))
        if upper < beside:
            break
        try:
            hull = ConvexHull(points)
        except QhullError:
            break
        depths = -hull.equations[:, 3]
        if depths.min() >= 0.0:  # otherwise the origin is outside, which gives no bound
            lower = max(lower, float(depths.min()))
        if lower > beside:
            break
        directions = hull.equations[np.argsort(depths)[:_NEAREST], :3]
    return lower, upper


def verdict(scene: RandomScene, i: int, j: int, deeper: float) -> bool | None:
    """Checks whether two bodies are deeper than a depth; None if the bounds do not decide."""
    lower, upper = bounds(scene, i, j, deeper)
    if lower > deeper:
        return True
    return False if upper < deeper else None


def may_touch(scene: RandomScene, i: int, j: int, within: float) -> bool:
    """Checks whether the bounds allow that two bodies touch within a distance."""
    lower, upper = bounds(scene, i, j, within)
    return lower <= within and upper >= -within
