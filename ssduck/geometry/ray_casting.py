"""Intersects rays with shapes: by formulas for convex solids, by triangles for all others.

Rays begin at one common point, or each at its own point. A distance along a ray is a fraction of
its length vector. Points and rays are in the frame of the solid.

In the line of sight between two points, a convex shape that contains the start does not block, as
for the rays of sensors. The triangles of a mesh block from either side. A shape that contains the
end blocks; one that begins there does not.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ssduck.geometry.arrays import Array, Flags
from ssduck.geometry.poses import cross
from ssduck.geometry.solids import PlacedSolids, Solid

# A surface that is nearer to the start of a ray contains it, m.
HIT_TOLERANCE = 1e-9
# Triangles are widened by this fraction of their sides: no ray slips between two of them.
EDGE_TOLERANCE = 1e-9


class RayChords(NamedTuple):
    """The parts of n rays that are in a convex solid.

    Attributes:
        contains: (n,) or (), whether the solid contains the start of the ray.
        enter: (n,), the fraction at which the ray enters the solid; below 0 behind its start. inf
            if the ray misses the solid.
        leave: (n,), the fraction at which it leaves the solid; -inf if the ray misses it.
    """

    contains: Flags
    enter: Array
    leave: Array


def is_triangle_surface(solid: Solid) -> bool:
    """Checks whether rays hit the triangles of a solid from either side, rather than its volume."""
    is_round = solid.type in ("sphere", "capsule", "cylinder", "ellipsoid")
    return solid.is_shell or (solid.offsets is None and not is_round)


def first_hits(solid: Solid, start: Array, rays: Array) -> Array:
    """Returns the fraction of each ray at which it first hits a solid, (n,); inf for no hit.

    A convex solid that contains the start is not hit. The triangles of a mesh are hit from either
    side.
    """
    if is_triangle_surface(solid):
        fractions = crossings(solid, start, rays)
        nearest: Array = np.where(fractions > 0.0, fractions, np.inf).min(axis=1, initial=np.inf)
        return nearest
    chords = ray_chords(solid, start, rays)
    hits: Array = np.where(chords.contains | (chords.enter < 0.0), np.inf, chords.enter)
    return hits


def ray_chords(solid: Solid, starts: Array, rays: Array) -> RayChords:
    """Returns the parts of rays that are in a convex solid."""
    parts = _parts(solid, starts, rays)
    contains = np.any([part.contains for part in parts], axis=0)
    is_hit = [part.enter <= part.leave for part in parts]
    enter = [np.where(hit, part.enter, np.inf) for hit, part in zip(is_hit, parts, strict=True)]
    leave = [np.where(hit, part.leave, -np.inf) for hit, part in zip(is_hit, parts, strict=True)]
    return RayChords(contains, np.min(enter, axis=0), np.max(leave, axis=0))


def _parts(solid: Solid, starts: Array, rays: Array) -> list[RayChords]:
    match solid.type:
        case "sphere" | "capsule":
            chords = [_quadratic(rays, starts - point, solid.radius) for point in solid.core]
            if solid.type == "capsule":
                chords.append(_cylinder(solid.radius, solid.half_length, starts, rays))
            return chords
        case "cylinder":
            return [_cylinder(solid.disc_radius, solid.half_length, starts, rays)]
        case "ellipsoid":
            return [_ellipsoid(np.array(solid.semi_axes), starts, rays)]
    assert solid.offsets is not None
    return [_half_spaces(solid.normals, solid.offsets, starts, rays)]


def _half_spaces(normals: Array, offsets: Array, starts: Array, rays: Array) -> RayChords:
    heights, rates = offsets - starts @ normals.T, rays @ normals.T
    with np.errstate(divide="ignore", invalid="ignore"):
        fractions = heights / rates
    enter = np.where(rates < 0.0, fractions, -np.inf)
    enter[(rates == 0.0) & (heights < 0.0)] = np.inf  # parallel to a face and outside
    leave = np.where(rates > 0.0, fractions, np.inf)
    contains = np.asarray((heights >= -HIT_TOLERANCE).all(axis=-1))
    return RayChords(contains, enter.max(axis=1), leave.min(axis=1))


def _cylinder(radius: float, half: float, starts: Array, rays: Array) -> RayChords:
    caps = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    side = _quadratic(rays[:, :2], starts[..., :2], radius)
    ends = _half_spaces(caps, np.array([half, half]), starts, rays)
    return RayChords(
        side.contains & ends.contains,
        np.maximum(side.enter, ends.enter),
        np.minimum(side.leave, ends.leave),
    )


def _ellipsoid(semi_axes: Array, starts: Array, rays: Array) -> RayChords:
    """Returns the chords in an ellipsoid, which are those in a ball in scaled coordinates."""
    points = starts / semi_axes
    chords = _quadratic(rays / semi_axes, points, 1.0)
    # The distance from the surface, m, up to its square: the level by the length of its gradient.
    level, gradient = (points * points).sum(axis=-1) - 1.0, points / semi_axes
    steepness = np.sqrt((gradient * gradient).sum(axis=-1))
    return chords._replace(contains=np.asarray(level <= 2.0 * steepness * HIT_TOLERANCE))


def _quadratic(rays: Array, offset: Array, radius: float) -> RayChords:
    """Returns the chord in which |off + fraction * ray| is at most a radius."""
    a, b = (rays * rays).sum(axis=1), (rays * offset).sum(axis=1)
    c = (offset * offset).sum(axis=-1) - radius**2
    discriminant = b**2 - a * c
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(np.maximum(discriminant, 0.0))
        enter, leave = (-b - root) / a, (-b + root) / a
    is_parallel, is_within = a == 0.0, c <= 0.0
    enter = np.where(is_parallel, np.where(is_within, -np.inf, np.inf), enter)
    leave = np.where(is_parallel, np.where(is_within, np.inf, -np.inf), leave)
    enter[discriminant < 0.0] = np.inf
    return RayChords(np.asarray(c <= 2.0 * radius * HIT_TOLERANCE), enter, leave)


def crossings(solid: Solid, starts: Array, rays: Array) -> Array:
    """Returns the fractions at which rays cross the triangles of a solid's surface.

    By T. Möller and B. Trumbore, Fast, Minimum Storage Ray-Triangle Intersection, 1997.
    """
    corners = solid.surface.triangles
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    offset = starts[..., None, :] - corners[:, 0]
    normal = cross(u, v)
    with np.errstate(divide="ignore", invalid="ignore"):
        denominator = -(rays @ normal.T)
        first = -_dot_products(_cross(offset, v), rays) / denominator
        second = _dot_products(_cross(offset, u), rays) / denominator
        fraction = (offset * normal).sum(axis=-1) / denominator
        is_crossed = (
            (first >= -EDGE_TOLERANCE)
            & (second >= -EDGE_TOLERANCE)
            & (first + second <= 1.0 + EDGE_TOLERANCE)
        )
    fractions: Array = np.where(is_crossed, fraction, np.inf)
    return fractions


def _cross(vectors: Array, others: Array) -> Array:
    """Returns cross products of vectors (m, 3) or (n, m, 3) with others (m, 3)."""
    flat = np.broadcast_to(others, vectors.shape).reshape(-1, 3)
    products: Array = cross(vectors.reshape(-1, 3), flat).reshape(vectors.shape)
    return products


def _dot_products(vectors: Array, rays: Array) -> Array:
    """Returns dot products of vectors (m, 3) or (n, m, 3) with rays (n, 3), (n, m)."""
    if vectors.ndim == 2:
        return rays @ vectors.T
    products: Array = np.einsum("nmi,ni->nm", vectors, rays)
    return products


# The number of pairs of a ray and a face that are compared at a time.
PAIRS_AT_ONCE = 1_000_000


# -- the line of sight ----------------------------------------------------------------------------


def are_blocked(placed: PlacedSolids, start: Array, ends: Array) -> Flags:
    """Checks whether a shape blocks the line of sight from a point to each of some others."""
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
