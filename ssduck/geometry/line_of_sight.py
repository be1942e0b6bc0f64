"""What is in the way between a point and others: rays that end at points, by formulas of shapes.

As for the rays of sensors, a convex shape that a ray begins in is not in its way; the triangles of
a mesh are, from either side. A shape that holds the far end is in the way, one that begins there is
not.
"""

from __future__ import annotations

import numpy as np

from ssduck.geometry.arrays import Array, Flags
from ssduck.geometry.ray_casting import HIT_TOLERANCE, first_hits
from ssduck.geometry.solids import PlacedSolids, Solid

# Rays times faces that are looked at together.
TOGETHER = 1_000_000


def are_blocked(placed: PlacedSolids, start: Array, ends: Array) -> Flags:
    """Of points (n, 3) whether a shape is between `start` (3,) and each."""
    blocked = np.zeros(len(ends), dtype=bool)
    ways = ends - start
    lengths = np.linalg.norm(ways, axis=1)
    for solid, position, matrix in placed:
        left = np.flatnonzero(~blocked)
        left = left[_may_meet(solid, matrix, position - start, ways[left], lengths[left])]
        many = max(1, TOGETHER // max(1, len(solid.faces), len(solid.normals)))
        for first in range(0, len(left), many):
            some = left[first : first + many]
            near = (start - position) @ matrix
            blocked[some] = _meets(solid, near, ways[some] @ matrix, lengths[some])
    return blocked


def _may_meet(solid: Solid, matrix: Array, off: Array, ways: Array, lengths: Array) -> Flags:
    """Whether rays meet the sphere around a solid whose frame is at `off` from where they begin."""
    if solid.type == "plane":
        return np.ones(len(ways), dtype=bool)
    centre = matrix @ np.array(solid.centre) + off
    along = ways @ centre / lengths
    square, reach = float(centre @ centre), solid.bounding_radius + HIT_TOLERANCE
    near: Flags = (square - along**2 <= reach**2) & (along >= -reach) & (along - reach <= lengths)
    return near


def _meets(solid: Solid, start: Array, ways: Array, lengths: Array) -> Flags:
    """Whether rays meet a solid before they end; all in its frame."""
    far = first_hits(solid, start, ways) * lengths
    met: Flags = (far > HIT_TOLERANCE) & (far < lengths - HIT_TOLERANCE)
    return met
