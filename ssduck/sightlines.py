"""What is in the way between a point and others: rays that end at points, by formulas of shapes.

As for the rays of sensors, a convex shape that a ray begins in is not in its way; the triangles of
a mesh are, from either side. A shape that holds the far end is in the way, one that begins there is
not.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from ssduck.broad import Flags
from ssduck.geometry import Array, cross
from ssduck.solids import PlacedSolids, Solid

# As near as this a surface begins at a point, m.
ROUNDED = 1e-9
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
    square, reach = float(centre @ centre), solid.reach + ROUNDED
    near: Flags = (square - along**2 <= reach**2) & (along >= -reach) & (along - reach <= lengths)
    return near


def _meets(solid: Solid, start: Array, ways: Array, lengths: Array) -> Flags:
    """Whether rays meet a solid before they end; all in its frame."""
    if solid.offsets is None and solid.type not in ("sphere", "capsule", "cylinder"):
        share = _of_triangles(solid, start, ways)
    else:
        parts = _parts(solid, start, ways)
        if any(bool(held) for held, _, _ in parts):
            return np.zeros(len(ways), dtype=bool)
        share = np.min([np.where(a <= b, a, np.inf) for _, a, b in parts], axis=0)
    far = share * lengths
    met: Flags = (far > ROUNDED) & (far < lengths - ROUNDED)
    return met


# Whether a part of a convex solid holds where the rays begin; the shares of each ray at which it
# enters the part and leaves it.
_Part: TypeAlias = tuple[bool, Array, Array]


def _parts(solid: Solid, start: Array, ways: Array) -> list[_Part]:
    match solid.type:
        case "sphere" | "capsule":
            found = [_quadratic(ways, start - point, solid.radius) for point in solid.core]
            if solid.type == "capsule":
                found.append(_cylinder(solid.radius, solid.half, start, ways))
            return found
        case "cylinder":
            return [_cylinder(solid.disc, solid.half, start, ways)]
    assert solid.offsets is not None
    return [_half_spaces(solid.normals, solid.offsets, start, ways)]


def _half_spaces(normals: Array, offsets: Array, start: Array, ways: Array) -> _Part:
    room, rate = offsets - normals @ start, ways @ normals.T
    with np.errstate(divide="ignore", invalid="ignore"):
        share = room / rate
    enter = np.where(rate < 0.0, share, -np.inf)
    enter[(rate == 0.0) & (room < 0.0)] = np.inf  # along a face, outside of it
    leave = np.where(rate > 0.0, share, np.inf)
    return bool((room >= -ROUNDED).all()), enter.max(axis=1), leave.min(axis=1)


def _cylinder(radius: float, half: float, start: Array, ways: Array) -> _Part:
    caps = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    in_side, *side = _quadratic(ways[:, :2], start[:2], radius)
    between, *ends = _half_spaces(caps, np.array([half, half]), start, ways)
    return in_side and between, np.maximum(side[0], ends[0]), np.minimum(side[1], ends[1])


def _quadratic(ways: Array, off: Array, radius: float) -> _Part:
    """Where |off + share * way| is at most a radius."""
    a, b = np.einsum("ni,ni->n", ways, ways), ways @ off
    c = float(off @ off) - radius**2
    room = b**2 - a * c
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(np.maximum(room, 0.0))
        enter, leave = (-b - root) / a, (-b + root) / a
    still = a == 0.0
    enter[still], leave[still] = (-np.inf, np.inf) if c <= 0.0 else (np.inf, -np.inf)
    enter[room < 0.0] = np.inf
    return c <= 2.0 * radius * ROUNDED, enter, leave


def _of_triangles(solid: Solid, start: Array, ways: Array) -> Array:
    """The share of each ray at which it meets the first triangle, else inf.

    By T. Möller and B. Trumbore, Fast, Minimum Storage Ray-Triangle Intersection, 1997.
    """
    corners = solid.surface.triangles
    u, v, off = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], start - corners[:, 0]
    normal, turned = cross(u, v), cross(off, v)
    with np.errstate(divide="ignore", invalid="ignore"):
        below = -(ways @ normal.T)
        first = -(ways @ turned.T) / below
        second = ways @ cross(off, u).T / below
        share = np.einsum("mi,mi->m", normal, off) / below
        met = (first >= 0.0) & (second >= 0.0) & (first + second <= 1.0) & (share > 0.0)
    nearest: Array = np.where(met, share, np.inf).min(axis=1, initial=np.inf)
    return nearest
