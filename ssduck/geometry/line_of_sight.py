"""The line of sight between a point and others: rays against the formulas of shapes.

A convex shape that contains the start of a ray does not block it, as for the rays of sensors. The
triangles of a mesh block from either side. A shape that contains the end of a ray blocks it; a
shape that begins there does not.
"""

from __future__ import annotations

import numpy as np

from ssduck.geometry.arrays import Array, Flags
from ssduck.geometry.ray_casting import HIT_TOLERANCE, first_hits
from ssduck.geometry.solids import PlacedSolids, Solid

# The number of pairs of a ray and a face that are compared at a time.
PAIRS_AT_ONCE = 1_000_000


def are_blocked(placed: PlacedSolids, start: Array, ends: Array) -> Flags:
    """Checks whether a shape blocks the line of sight from a point to each of some others.

    Args:
        placed: the shapes.
        start: (3,), the eye.
        ends: (n, 3), the points to see.

    Returns:
        (n,), booleans.
    """
    blocked = np.zeros(len(ends), dtype=bool)
    rays = ends - start
    lengths = np.linalg.norm(rays, axis=1)
    for solid, position, matrix in placed:
        open_rays = np.flatnonzero(~blocked)
        open_rays = open_rays[
            _may_hit(solid, matrix, position - start, rays[open_rays], lengths[open_rays])
        ]
        count = max(1, PAIRS_AT_ONCE // max(1, len(solid.faces), len(solid.normals)))
        for first in range(0, len(open_rays), count):
            indices = open_rays[first : first + count]
            local_start = (start - position) @ matrix
            blocked[indices] = _are_hit(
                solid, local_start, rays[indices] @ matrix, lengths[indices]
            )
    return blocked


def _may_hit(solid: Solid, matrix: Array, offset: Array, rays: Array, lengths: Array) -> Flags:
    """Checks whether rays hit the sphere around a solid at an offset from their start."""
    if solid.type == "plane":
        return np.ones(len(rays), dtype=bool)
    centre = matrix @ np.array(solid.centre) + offset
    along = rays @ centre / lengths
    squared_distance, radius = float(centre @ centre), solid.bounding_radius + HIT_TOLERANCE
    may_hit: Flags = (
        (squared_distance - along**2 <= radius**2)
        & (along >= -radius)
        & (along - radius <= lengths)
    )
    return may_hit


def _are_hit(solid: Solid, start: Array, rays: Array, lengths: Array) -> Flags:
    """Checks whether rays hit a solid before they end; all in the solid's frame."""
    distances = first_hits(solid, start, rays) * lengths
    is_hit: Flags = (distances > HIT_TOLERANCE) & (distances < lengths - HIT_TOLERANCE)
    return is_hit
