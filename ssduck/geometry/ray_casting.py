"""Where rays meet shapes: by formulas of convex solids, and by the triangles of all others.

Rays begin at one point or each at a point of its own; a distance along a ray is a share of its
way. All points and ways are in the frame of the solid.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ssduck.geometry.arrays import Array, Flags
from ssduck.geometry.poses import cross
from ssduck.geometry.solids import Solid

# As near as this a surface begins at a point, m.
HIT_TOLERANCE = 1e-9
# A triangle is met that is as near, as a share of its sides: no ray slips between two of them.
EDGE = 1e-9


class RayChords(NamedTuple):
    """The parts of n rays that are in a convex solid.

    Attributes:
        held: (n,) or (), whether the solid holds the point where the ray begins.
        enter: (n,), the share at which the ray enters the solid; behind its beginning below 0.
            A ray that misses the solid has inf, and -inf to leave.
        leave: (n,), the share at which it leaves the solid.
    """

    held: Flags
    enter: Array
    leave: Array


def is_triangle_surface(solid: Solid) -> bool:
    """Whether rays meet the triangles of a solid from either side, rather than all of it."""
    is_round = solid.type in ("sphere", "capsule", "cylinder")
    return solid.is_shell or (solid.offsets is None and not is_round)


def first_hits(solid: Solid, start: Array, ways: Array) -> Array:
    """The share of each ray at which it first meets a solid, inf for none, (n,).

    A convex solid that holds `start` is not met; the triangles of a mesh are, from either side.

    Args:
        solid: the solid.
        start: (3,), where the rays begin.
        ways: (n, 3).
    """
    if is_triangle_surface(solid):
        shares = crossings(solid, start, ways)
        nearest: Array = np.where(shares > 0.0, shares, np.inf).min(axis=1, initial=np.inf)
        return nearest
    chords = ray_chords(solid, start, ways)
    met: Array = np.where(chords.held | (chords.enter < 0.0), np.inf, chords.enter)
    return met


def ray_chords(solid: Solid, starts: Array, ways: Array) -> RayChords:
    """The parts of rays that are in a convex solid.

    Args:
        solid: the solid; none of triangles.
        starts: (3,) or (n, 3), where the rays begin.
        ways: (n, 3).
    """
    parts = _parts(solid, starts, ways)
    held = np.any([part.held for part in parts], axis=0)
    hit = [part.enter <= part.leave for part in parts]
    enter = [np.where(one, part.enter, np.inf) for one, part in zip(hit, parts, strict=True)]
    leave = [np.where(one, part.leave, -np.inf) for one, part in zip(hit, parts, strict=True)]
    return RayChords(held, np.min(enter, axis=0), np.max(leave, axis=0))


def _parts(solid: Solid, starts: Array, ways: Array) -> list[RayChords]:
    match solid.type:
        case "sphere" | "capsule":
            found = [_quadratic(ways, starts - point, solid.radius) for point in solid.core]
            if solid.type == "capsule":
                found.append(_cylinder(solid.radius, solid.half_length, starts, ways))
            return found
        case "cylinder":
            return [_cylinder(solid.disc_radius, solid.half_length, starts, ways)]
    assert solid.offsets is not None
    return [_half_spaces(solid.normals, solid.offsets, starts, ways)]


def _half_spaces(normals: Array, offsets: Array, starts: Array, ways: Array) -> RayChords:
    room, rate = offsets - starts @ normals.T, ways @ normals.T
    with np.errstate(divide="ignore", invalid="ignore"):
        share = room / rate
    enter = np.where(rate < 0.0, share, -np.inf)
    enter[(rate == 0.0) & (room < 0.0)] = np.inf  # along a face, outside of it
    leave = np.where(rate > 0.0, share, np.inf)
    held = np.asarray((room >= -HIT_TOLERANCE).all(axis=-1))
    return RayChords(held, enter.max(axis=1), leave.min(axis=1))


def _cylinder(radius: float, half: float, starts: Array, ways: Array) -> RayChords:
    caps = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    side = _quadratic(ways[:, :2], starts[..., :2], radius)
    ends = _half_spaces(caps, np.array([half, half]), starts, ways)
    return RayChords(
        side.held & ends.held,
        np.maximum(side.enter, ends.enter),
        np.minimum(side.leave, ends.leave),
    )


def _quadratic(ways: Array, off: Array, radius: float) -> RayChords:
    """Where |off + share * way| is at most a radius."""
    a, b = (ways * ways).sum(axis=1), (ways * off).sum(axis=1)
    c = (off * off).sum(axis=-1) - radius**2
    room = b**2 - a * c
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(np.maximum(room, 0.0))
        enter, leave = (-b - root) / a, (-b + root) / a
    still, within = a == 0.0, c <= 0.0
    enter = np.where(still, np.where(within, -np.inf, np.inf), enter)
    leave = np.where(still, np.where(within, np.inf, -np.inf), leave)
    enter[room < 0.0] = np.inf
    return RayChords(np.asarray(c <= 2.0 * radius * HIT_TOLERANCE), enter, leave)


def crossings(solid: Solid, starts: Array, ways: Array) -> Array:
    """Where rays cross the triangles of a solid's surface.

    By T. Möller and B. Trumbore, Fast, Minimum Storage Ray-Triangle Intersection, 1997.

    Args:
        solid: the solid.
        starts: (3,) or (n, 3), where the rays begin.
        ways: (n, 3).

    Returns:
        The shares (n, triangles) at which each ray crosses each triangle; inf where it does not.
    """
    corners = solid.surface.triangles
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    off = starts[..., None, :] - corners[:, 0]
    normal = cross(u, v)
    with np.errstate(divide="ignore", invalid="ignore"):
        below = -(ways @ normal.T)
        first = -_along(_cross(off, v), ways) / below
        second = _along(_cross(off, u), ways) / below
        share = (off * normal).sum(axis=-1) / below
        met = (first >= -EDGE) & (second >= -EDGE) & (first + second <= 1.0 + EDGE)
    shares: Array = np.where(met, share, np.inf)
    return shares


def _cross(vectors: Array, others: Array) -> Array:
    """Cross products of vectors (m, 3) or (n, m, 3) with others (m, 3)."""
    flat = np.broadcast_to(others, vectors.shape).reshape(-1, 3)
    products: Array = cross(vectors.reshape(-1, 3), flat).reshape(vectors.shape)
    return products


def _along(vectors: Array, ways: Array) -> Array:
    """Products of vectors (m, 3) or (n, m, 3) with ways (n, 3), (n, m)."""
    if vectors.ndim == 2:
        return ways @ vectors.T
    products: Array = np.einsum("nmi,ni->nm", vectors, ways)
    return products
