"""Computes the signed distance of two solids of which one is a mesh that is not convex.

A closed mesh is the solid that it encloses, an open one a surface. FCL yields the distance of
surfaces and the triangles that cross, but no depth. The depth here is the greatest of

* the depths of corners of one solid in the other, if that is convex or closed: the distance of the
  corner from its surface;
* the depths of crossing triangles: the least translation that separates the two triangles.

Each of them is a lower bound of the translation that separates the solids. So is the depth, which
is exact where a corner is deepest, or an edge crosses an edge. Here a cylinder is a prism of 64
sides, which is off by up to 0.0013 of its radius, and an ellipsoid a polyhedron of 5,120 faces,
which is off by up to 0.0013 of its longest half length. The corners of a sphere and a capsule are
the ends of their cores.
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
from ssduck.geometry.ray_casting import crossings
from ssduck.geometry.surfaces import Surface

MAX_CONTACTS = 100_000
# This number of crossing triangles nearly always includes a pair that is deep.
FIRST_CONTACTS = 16
# The number of corners whose depths bound the depths of the others.
BOUNDING_CORNERS = 200


def mesh_distance(a: PlacedSolid, b: PlacedSolid, calls: CallCounter) -> SignedDistance | None:
    """Returns the signed distance of a mesh and another solid; None if their cores overlap."""
    if _pierced_triangles(a, b) or _pierced_triangles(b, a):
        return None
    distance, p, q = surface_distance(a.fcl_object, b.fcl_object, calls)
    if distance <= CONTACT_TOLERANCE or _encloses(a, b) or _encloses(b, a):
        return None
    return offset_by_radii(distance, p, q, (p - q) / distance, a, b)


def mesh_penetration(a: PlacedSolid, b: PlacedSolid, calls: CallCounter) -> SignedDistance:
    """Returns the signed distance of two solids, at least one a mesh, whose cores overlap."""
    cores: list[Core] = [*_deepest_corner(a, b, calls), *_deepest_crossing(a, b, calls)]
    cores += [(gap, p, q, -normal) for gap, q, p, normal in _deepest_corner(b, a, calls)]
    if not cores:
        cores.append(_touching(a, b, calls))
    gap, p, q, normal = min(cores, key=lambda core: core[0])
    if gap >= -CONTACT_TOLERANCE:
        normal = _normal_at(a, b, (p + q) / 2)
    return offset_by_radii(gap, p, q, normal, a, b)


def is_surely_deeper(a: PlacedSolid, b: PlacedSolid, min_depth: float, calls: CallCounter) -> bool:
    """Checks whether crossing triangles prove that a mesh and another solid exceed a depth.

    Each pair of crossing triangles bounds the depth from below. If the result is False, other pairs
    may be deeper.
    """
    pairs = _crossing_triangles(a, b, FIRST_CONTACTS, calls)
    if not pairs:
        return False
    i, j = zip(*pairs, strict=True)
    depths, _ = triangle_depths(_world_triangles(a, list(i)), _world_triangles(b, list(j)))
    return float(depths.max()) > min_depth + CONTACT_TOLERANCE


def _pierced_triangles(segment: PlacedSolid, mesh: PlacedSolid) -> list[int]:
    """Returns the triangles that a segment core passes through; FCL misses some of them."""
    ends = segment.solid.surface.vertices
    if len(ends) != 2:
        return []
    start, end = _to_local(mesh, _to_world(segment, ends))
    fractions = crossings(mesh.solid, start, (end - start)[None])[0]
    return [int(face) for face in np.flatnonzero((fractions >= 0.0) & (fractions <= 1.0))]


def _encloses(outer: PlacedSolid, inner: PlacedSolid) -> bool:
    """Checks whether one solid contains a part of the other, if their surfaces do not cross."""
    if not _has_interior(outer):
        return False
    points = _to_local(outer, _to_world(inner, inner.solid.surface.component_vertices))
    return bool(outer.solid.surface.encloses(points).any())


def _has_interior(placed: PlacedSolid) -> bool:
    """Checks whether the core has an inside."""
    solid = placed.solid
    return solid.is_closed and solid.volume > 0.0 and not solid.radius


def _to_world(placed: PlacedSolid, points: Array) -> Array:
    transformed: Array = points @ placed.matrix.T + placed.position
    return transformed


def _to_local(placed: PlacedSolid, points: Array) -> Array:
    transformed: Array = (points - placed.position) @ placed.matrix
    return transformed


def _deepest_corner(a: PlacedSolid, b: PlacedSolid, calls: CallCounter) -> list[Core]:
    """Returns the corner of a that is deepest in b."""
    if not _has_interior(b):
        return []
    points = _to_world(a, a.solid.surface.vertices)
    points = points[b.solid.surface.encloses(_to_local(b, points))]
    if not len(points):
        return []
    if b.solid.type == "mesh":
        return [_deepest_in_mesh(points, b, calls)]
    surface = b.solid.surface
    normals, offsets = b.solid.normals, b.solid.offsets
    if offsets is None:
        normals, offsets = _planes(surface)
    below = offsets - _to_local(b, points) @ normals.T
    deepest = int(below.min(axis=1).argmax())
    face = int(below[deepest].argmin())
    depth, normal = float(below[deepest, face]), b.matrix @ normals[face]
    return [(-depth, points[deepest], points[deepest] + depth * normal, normal)]


def _planes(surface: Surface) -> tuple[Array, Array]:
    """Returns the normals and offsets of the faces of a convex surface."""
    a, b, c = (surface.triangles[:, k] for k in range(3))
    normals = cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return normals, np.einsum("ij,ij->i", normals, a)


def _deepest_in_mesh(points: Array, mesh: PlacedSolid, calls: CallCounter) -> Core:
    """Returns the point inside a mesh that is farthest from its surface."""
    # The depths of two points differ by at most their distance: most are never computed.
    upper_bounds = np.full(len(points), math.inf)
    depth, p, q = -1.0, points[0], points[0]
    for iteration in itertools.count():
        index = int(upper_bounds.argmax())
        if upper_bounds[index] <= depth:
            break
        result = surface_distance(_fcl_point(points[index]), mesh.fcl_object, calls)
        if result[0] > depth:
            depth, p, q = result
        upper_bounds[index] = result[0]
        if iteration < BOUNDING_CORNERS:  # if many points are equally deep, more bounds do not help
            offsets = points - points[index]
            upper_bounds = np.minimum(
                upper_bounds, result[0] + np.sqrt(np.einsum("ij,ij->i", offsets, offsets))
            )
    if depth <= CONTACT_TOLERANCE:
        return 0.0, p, p, _normals_at(mesh, p)[0]
    return -depth, p, q, (q - p) / depth


def _fcl_point(point: Array) -> Any:
    import fcl

    return fcl.CollisionObject(_point().bvh, fcl.Transform(point))


@cache
def _point() -> Surface:
    return Surface(np.zeros((1, 3)), np.zeros((1, 3), np.int32))


def _normals_at(placed: PlacedSolid, point: Array) -> Array:
    """Returns the normals (n, 3) of the faces that contain a point of the surface."""
    surface = placed.solid.surface
    local = _to_local(placed, point[None])[0]
    corners = surface.triangles
    normals = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1)
    is_full = length > 0.0
    normals, corners = normals[is_full] / length[is_full, None], corners[is_full]
    if not len(normals):
        return np.zeros((0, 3))
    distances = np.abs(np.einsum("ij,ij->i", normals, local - corners[:, 0]))
    local_normals: Array = normals[distances <= distances.min() + 10 * CONTACT_TOLERANCE]
    normals_in_world: Array = np.einsum("ij,nj->ni", placed.matrix, local_normals)
    return normals_in_world


def _deepest_crossing(a: PlacedSolid, b: PlacedSolid, calls: CallCounter) -> list[Core]:
    """Returns the deepest pair of crossing triangles."""
    pairs = _crossing_triangles(a, b, MAX_CONTACTS, calls)
    pairs |= {(0, face) for face in _pierced_triangles(a, b)} | {
        (face, 0) for face in _pierced_triangles(b, a)
    }
    if not pairs:
        return []
    indices = np.array(sorted(pairs))
    first, second = _world_triangles(a, indices[:, 0]), _world_triangles(b, indices[:, 1])
    depths, normals = triangle_depths(first, second)
    deepest = int(depths.argmax())
    # FCL reports some coplanar triangles that lie side by side.
    if depths[deepest] < -CONTACT_TOLERANCE:
        return []
    depth, normal = max(0.0, float(depths[deepest])), normals[deepest]
    midpoint = _crossing_point(first[deepest], second[deepest])
    return [(-depth, midpoint - depth / 2 * normal, midpoint + depth / 2 * normal, normal)]


def _crossing_triangles(
    a: PlacedSolid, b: PlacedSolid, max_contacts: int, calls: CallCounter
) -> set[tuple[int, int]]:
    """Returns the pairs of triangles that cross, according to FCL."""
    import fcl

    calls.calls += 1
    result = fcl.CollisionResult()
    request = fcl.CollisionRequest(num_max_contacts=max_contacts, enable_contact=True)
    fcl.collide(a.fcl_object, b.fcl_object, request, result)
    return {(contact.b1, contact.b2) for contact in result.contacts}


def _crossing_point(first: Array, second: Array) -> Array:
    """Returns the centre of the points where two triangles cross; else of their boxes."""
    points = []
    for edges, other in ((first, second), (second, first)):
        normal = np.cross(other[1] - other[0], other[2] - other[0])
        squared_length = float(normal @ normal)
        for start, end in zip(edges, np.roll(edges, -1, axis=0), strict=True):
            height = float((end - start) @ normal)
            if height == 0.0 or squared_length == 0.0:
                continue
            point = start + float((other[0] - start) @ normal) / height * (end - start)
            sides = np.cross(np.roll(other, -1, axis=0) - other, point - other) @ normal
            inside = sides.min() >= -1e-9 * squared_length
            between = (
                float((point - start) @ (point - end)) <= CONTACT_TOLERANCE * CONTACT_TOLERANCE
            )
            if inside and between:
                points.append(point)
    if points:
        mean: Array = np.array(points).mean(axis=0)
        return mean
    low = np.maximum(first.min(axis=0), second.min(axis=0))
    high = np.minimum(first.max(axis=0), second.max(axis=0))
    centre: Array = (low + high) / 2
    return centre


def _world_triangles(placed: PlacedSolid, numbers: list[int] | Array) -> Array:
    surface = placed.solid.surface
    return _to_world(placed, surface.vertices)[surface.faces[numbers]]


def triangle_depths(first: Array, second: Array) -> tuple[Array, Array]:
    """Returns the least overlaps of pairs of triangles (k, 3, 3), and their directions.

    The overlap is negative if the direction separates the triangles. The directions are the
    triangles' normals and the cross products of their edges: the face normals of their difference.
    A triangle may be a segment.
    """
    edges_a, edges_b = np.roll(first, -1, 1) - first, np.roll(second, -1, 1) - second
    pairs = np.repeat(edges_a, 3, axis=1), np.tile(edges_b, (1, 3, 1))
    side_pairs = (edges_a[:, 0], edges_a[:, 1]), (edges_b[:, 0], edges_b[:, 1])
    directions = np.concatenate(
        (
            cross(side_pairs[0][0], side_pairs[0][1])[:, None],
            cross(side_pairs[1][0], side_pairs[1][1])[:, None],
            cross(pairs[0].reshape(-1, 3), pairs[1].reshape(-1, 3)).reshape(-1, 9, 3),
        ),
        axis=1,
    )
    length = np.linalg.norm(directions, axis=2)
    longest = np.linalg.norm(edges_a, axis=2).max(1) * np.linalg.norm(edges_b, axis=2).max(1)
    longest = np.maximum(longest[:, None], 1e-300)
    directions = directions / np.maximum(length, 1e-300)[:, :, None]
    extents_a, extents_b = (
        np.einsum("kwi,kci->kwc", directions, first),
        np.einsum("kwi,kci->kwc", directions, second),
    )
    up = extents_b.max(2) - extents_a.min(2)  # a moves along the direction,
    down = extents_a.max(2) - extents_b.min(2)  # or in the opposite direction
    overlap = np.where(length > 1e-9 * longest, np.minimum(up, down), math.inf)
    best = overlap.argmin(axis=1)
    rows = np.arange(len(first))
    sign = np.where(up[rows, best] <= down[rows, best], 1.0, -1.0)
    depths = overlap[rows, best]
    # Triangles on one line have no such direction; they only touch.
    depths[~np.isfinite(depths)] = 0.0
    return depths, directions[rows, best] * sign[:, None]


def _touching(a: PlacedSolid, b: PlacedSolid, calls: CallCounter) -> Core:
    """Cores that share a point of their surfaces and nothing else."""
    _, p, q = surface_distance(a.fcl_object, b.fcl_object, calls)
    midpoint = (p + q) / 2
    return 0.0, midpoint, midpoint, _normal_at(a, b, midpoint)


def _normal_at(a: PlacedSolid, b: PlacedSolid, point: Array) -> Array:
    faces = np.concatenate((_normals_at(a, point), _normals_at(b, point)))
    if not len(faces):
        return np.array([0.0, 0.0, 1.0])
    directions = np.concatenate((faces, -faces))
    overlaps = a.support_heights(-directions) + b.support_heights(directions)
    best: Array = directions[int(overlaps.argmin())]
    return best
