"""How far a mesh that is not convex is from another solid, or how deep they are in each other.

A closed mesh is the solid that it encloses, an open one a surface. FCL gives the distance of
surfaces, and which of their triangles cross; it has no depth. The depth here is the greatest of

* the depths of corners of one in the other, if that is convex or closed: how far the corner is
  from its surface;
* the depths of triangles that cross: the least translation that takes one off the other.

Each bounds from below how far one must be moved to leave the other; so the depth is a lower bound
of that, and exact where a corner is deepest, or an edge crosses an edge. A cylinder is a prism of
64 sides in it here, which is off by up to 0.0013 of its radius; the corners of a sphere and a
capsule are the ends of their cores.
"""

from __future__ import annotations

import itertools
import math
from functools import cache
from typing import Any

import numpy as np

from ssduck.geometry.arrays import Array
from ssduck.geometry.distance import (
    CONTACT_TOLERANCE,
    CallCounter,
    Core,
    SignedDistance,
    offset_by_radii,
    surface_distance,
)
from ssduck.geometry.placed_solid import PlacedSolid
from ssduck.geometry.poses import cross
from ssduck.geometry.surfaces import Surface

MOST_CONTACTS = 100_000
# As many triangles that cross tell nearly always that some are deep in each other.
SOME_CONTACTS = 16
# From the depths of so many corners those of the others are bounded.
TELLING = 200


def mesh_distance(a: PlacedSolid, b: PlacedSolid, calls: CallCounter) -> SignedDistance | None:
    """The gap of two solids, one or both a mesh; None if their cores meet."""
    if _pierced(a, b) or _pierced(b, a):
        return None
    distance, p, q = surface_distance(a.fine_fcl_object, b.fine_fcl_object, calls)
    if distance <= CONTACT_TOLERANCE or _encloses(a, b) or _encloses(b, a):
        return None
    return offset_by_radii(distance, p, q, (p - q) / distance, a, b)


def mesh_penetration(a: PlacedSolid, b: PlacedSolid, calls: CallCounter) -> SignedDistance:
    """The same for cores that meet."""
    found: list[Core] = [*_corners(a, b, calls), *_crossings(a, b, calls)]
    found += [(gap, p, q, -normal) for gap, q, p, normal in _corners(b, a, calls)]
    if not found:
        found.append(_touching(a, b, calls))
    gap, p, q, normal = min(found, key=lambda core: core[0])
    if gap >= -CONTACT_TOLERANCE:
        normal = _normal_at(a, b, (p + q) / 2)
    return offset_by_radii(gap, p, q, normal, a, b)


def is_surely_deeper(a: PlacedSolid, b: PlacedSolid, deeper: float, calls: CallCounter) -> bool:
    """Whether a mesh and another solid are deeper in each other, by some triangles that cross.

    Each bounds the depth from below. If these are not deeper, others may be.
    """
    numbers = _touched(a, b, SOME_CONTACTS, calls)
    if not numbers:
        return False
    i, j = zip(*numbers, strict=True)
    depths, _ = triangle_depths(_world_triangles(a, list(i)), _world_triangles(b, list(j)))
    return float(depths.max()) > deeper + CONTACT_TOLERANCE


def _pierced(segment: PlacedSolid, mesh: PlacedSolid) -> list[int]:
    """Which triangles a core that is a segment goes through: FCL overlooks some of them."""
    ends = segment.solid.fine_surface.vertices
    if len(ends) != 2:
        return []
    start, end = _local(mesh, _world(segment, ends))
    corners = mesh.solid.fine_surface.triangles
    way, off = end - start, start - corners[:, 0]
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = cross(u, v)
    along, square = normal @ way, np.einsum("ij,ij->i", normal, normal)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = -np.einsum("ij,ij->i", normal, off) / along
        at = off + share[:, None] * way
        x = np.einsum("ij,ij->i", cross(at, v), normal) / square
        y = np.einsum("ij,ij->i", cross(u, at), normal) / square
        hit = (share >= 0) & (share <= 1) & (x >= 0) & (y >= 0) & (x + y <= 1)
    return [int(face) for face in np.flatnonzero(hit)]


def _encloses(outer: PlacedSolid, inner: PlacedSolid) -> bool:
    """Whether a part of one is inside the other, if their surfaces do not cross."""
    if not _is_full(outer):
        return False
    points = _local(outer, _world(inner, inner.solid.fine_surface.component_vertices))
    return bool(outer.solid.fine_surface.encloses(points).any())


def _is_full(placed: PlacedSolid) -> bool:
    """Whether the core has an inside."""
    solid = placed.solid
    return solid.is_closed and solid.volume > 0.0 and not solid.radius


def _world(placed: PlacedSolid, points: Array) -> Array:
    moved: Array = points @ placed.matrix.T + placed.position
    return moved


def _local(placed: PlacedSolid, points: Array) -> Array:
    moved: Array = (points - placed.position) @ placed.matrix
    return moved


def _corners(a: PlacedSolid, b: PlacedSolid, calls: CallCounter) -> list[Core]:
    """The corner of a that is deepest in b."""
    if not _is_full(b):
        return []
    points = _world(a, a.solid.fine_surface.vertices)
    points = points[b.solid.fine_surface.encloses(_local(b, points))]
    if not len(points):
        return []
    if b.solid.type == "mesh":
        return [_deepest_in_mesh(points, b, calls)]
    surface = b.solid.fine_surface
    normals, offsets = b.solid.normals, b.solid.offsets
    if offsets is None:
        normals, offsets = _planes(surface)
    below = offsets - _local(b, points) @ normals.T
    deepest = int(below.min(axis=1).argmax())
    face = int(below[deepest].argmin())
    depth, normal = float(below[deepest, face]), b.matrix @ normals[face]
    return [(-depth, points[deepest], points[deepest] + depth * normal, normal)]


def _planes(surface: Surface) -> tuple[Array, Array]:
    """The normals and offsets of the faces of a convex surface."""
    a, b, c = (surface.triangles[:, k] for k in range(3))
    normals = cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return normals, np.einsum("ij,ij->i", normals, a)


def _deepest_in_mesh(points: Array, mesh: PlacedSolid, calls: CallCounter) -> Core:
    """Of points inside a mesh the one that is farthest from its surface.

    The depths of two points differ by no more than they are apart: most are never asked for.
    """
    most = np.full(len(points), math.inf)
    depth, p, q = -1.0, points[0], points[0]
    for asked in itertools.count():
        number = int(most.argmax())
        if most[number] <= depth:
            break
        found = surface_distance(_at(points[number]), mesh.fine_fcl_object, calls)
        if found[0] > depth:
            depth, p, q = found
        most[number] = found[0]
        if asked < TELLING:  # where many are as deep, more would tell nothing
            off = points - points[number]
            most = np.minimum(most, found[0] + np.sqrt(np.einsum("ij,ij->i", off, off)))
    if depth <= CONTACT_TOLERANCE:
        return 0.0, p, p, _facing(mesh, p)[0]
    return -depth, p, q, (q - p) / depth


def _at(point: Array) -> Any:
    """A point for FCL."""
    import fcl

    return fcl.CollisionObject(_point().bvh, fcl.Transform(point))


@cache
def _point() -> Surface:
    return Surface(np.zeros((1, 3)), np.zeros((1, 3), np.int32))


def _facing(placed: PlacedSolid, point: Array) -> Array:
    """The normals (n, 3) of the faces that have a point of the surface."""
    surface = placed.solid.fine_surface
    local = _local(placed, point[None])[0]
    corners = surface.triangles
    normals = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1)
    full = length > 0.0
    normals, corners = normals[full] / length[full, None], corners[full]
    if not len(normals):
        return np.zeros((0, 3))
    off = np.abs(np.einsum("ij,ij->i", normals, local - corners[:, 0]))
    at: Array = normals[off <= off.min() + 10 * CONTACT_TOLERANCE]
    turned: Array = np.einsum("ij,nj->ni", placed.matrix, at)
    return turned


def _crossings(a: PlacedSolid, b: PlacedSolid, calls: CallCounter) -> list[Core]:
    """The deepest two triangles that cross."""
    both = _touched(a, b, MOST_CONTACTS, calls)
    both |= {(0, face) for face in _pierced(a, b)} | {(face, 0) for face in _pierced(b, a)}
    if not both:
        return []
    numbers = np.array(sorted(both))
    first, second = _world_triangles(a, numbers[:, 0]), _world_triangles(b, numbers[:, 1])
    depths, normals = triangle_depths(first, second)
    deepest = int(depths.argmax())
    if depths[deepest] < -CONTACT_TOLERANCE:  # FCL counts some that lie in one plane side by side
        return []
    depth, normal = max(0.0, float(depths[deepest])), normals[deepest]
    middle = _crossing_point(first[deepest], second[deepest])
    return [(-depth, middle - depth / 2 * normal, middle + depth / 2 * normal, normal)]


def _touched(a: PlacedSolid, b: PlacedSolid, most: int, calls: CallCounter) -> set[tuple[int, int]]:
    """Which triangles of the one cross which of the other, as FCL has it."""
    import fcl

    calls.calls += 1
    result = fcl.CollisionResult()
    request = fcl.CollisionRequest(num_max_contacts=most, enable_contact=True)
    fcl.collide(a.fine_fcl_object, b.fine_fcl_object, request, result)
    return {(contact.b1, contact.b2) for contact in result.contacts}


def _crossing_point(first: Array, second: Array) -> Array:
    """The middle of where the edges of two triangles go through the other; else of their boxes."""
    found = []
    for edges, other in ((first, second), (second, first)):
        normal = np.cross(other[1] - other[0], other[2] - other[0])
        square = float(normal @ normal)
        for start, end in zip(edges, np.roll(edges, -1, axis=0), strict=True):
            along = float((end - start) @ normal)
            if along == 0.0 or square == 0.0:
                continue
            at = start + float((other[0] - start) @ normal) / along * (end - start)
            sides = np.cross(np.roll(other, -1, axis=0) - other, at - other) @ normal
            inside = sides.min() >= -1e-9 * square
            if inside and float((at - start) @ (at - end)) <= CONTACT_TOLERANCE * CONTACT_TOLERANCE:
                found.append(at)
    if found:
        mean: Array = np.array(found).mean(axis=0)
        return mean
    low = np.maximum(first.min(axis=0), second.min(axis=0))
    high = np.minimum(first.max(axis=0), second.max(axis=0))
    middle: Array = (low + high) / 2
    return middle


def _world_triangles(placed: PlacedSolid, numbers: list[int] | Array) -> Array:
    surface = placed.solid.fine_surface
    return _world(placed, surface.vertices)[surface.faces[numbers]]


def triangle_depths(first: Array, second: Array) -> tuple[Array, Array]:
    """Of pairs of triangles (k, 3, 3) the least overlap in any direction, and the direction.

    It is negative if the direction separates them.
    The directions are their normals and those across an edge of each: the faces of the
    difference of two triangles. A triangle may be a segment.
    """
    edges_a, edges_b = np.roll(first, -1, 1) - first, np.roll(second, -1, 1) - second
    pairs = np.repeat(edges_a, 3, axis=1), np.tile(edges_b, (1, 3, 1))
    own = (edges_a[:, 0], edges_a[:, 1]), (edges_b[:, 0], edges_b[:, 1])
    ways = np.concatenate(
        (
            cross(own[0][0], own[0][1])[:, None],
            cross(own[1][0], own[1][1])[:, None],
            cross(pairs[0].reshape(-1, 3), pairs[1].reshape(-1, 3)).reshape(-1, 9, 3),
        ),
        axis=1,
    )
    length = np.linalg.norm(ways, axis=2)
    longest = np.linalg.norm(edges_a, axis=2).max(1) * np.linalg.norm(edges_b, axis=2).max(1)
    longest = np.maximum(longest[:, None], 1e-300)
    ways = ways / np.maximum(length, 1e-300)[:, :, None]
    of_a, of_b = np.einsum("kwi,kci->kwc", ways, first), np.einsum("kwi,kci->kwc", ways, second)
    up = of_b.max(2) - of_a.min(2)  # a moves along the direction
    down = of_a.max(2) - of_b.min(2)  # or against it
    overlap = np.where(length > 1e-9 * longest, np.minimum(up, down), math.inf)
    best = overlap.argmin(axis=1)
    rows = np.arange(len(first))
    sign = np.where(up[rows, best] <= down[rows, best], 1.0, -1.0)
    depths = overlap[rows, best]
    # Triangles that lie in one line have no such direction; they only touch.
    depths[~np.isfinite(depths)] = 0.0
    return depths, ways[rows, best] * sign[:, None]


def _touching(a: PlacedSolid, b: PlacedSolid, calls: CallCounter) -> Core:
    """Cores that share a point of their surfaces, and no more that is known.

    Of the normals of the faces there it is that along which the shapes overlap least.
    """
    _, p, q = surface_distance(a.fine_fcl_object, b.fine_fcl_object, calls)
    middle = (p + q) / 2
    return 0.0, middle, middle, _normal_at(a, b, middle)


def _normal_at(a: PlacedSolid, b: PlacedSolid, point: Array) -> Array:
    faces = np.concatenate((_facing(a, point), _facing(b, point)))
    if not len(faces):
        return np.array([0.0, 0.0, 1.0])
    ways = np.concatenate((faces, -faces))
    overlaps = a.support_heights(-ways) + b.support_heights(ways)
    best: Array = ways[int(overlaps.argmin())]
    return best
