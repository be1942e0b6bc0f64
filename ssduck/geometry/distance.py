"""Computes the signed distance of two solids: their distance, or minus the depth of their overlap.

The signed distance of a and b is the distance of their nearest points. If they overlap, it is minus
the length of the shortest translation that separates them. It comes with a point of each solid and
the unit normal from b to a, so that `point_a - point_b == distance * normal`.

For convex solids, it is that of their cores minus the radii (Schneider, Convex Bodies, 3.1, for
parallel bodies). Formulas compare the cores of spheres and capsules (Ericson, Real-Time Collision
Detection, 5.1), support functions compare half-spaces, and FCL's distance of triangle surfaces
compares all others. FCL's own GJK is not used: its distances of boxes and cylinders with parallel
edges are wrong by their size, and its signed distance ends the process. Results are certified: the
normal separates a from b by the distance of the nearest points. If that fails, the solids overlap,
and an expanding polytope yields the depth (van den Bergen 2001). For an ellipsoid, support points
yield the nearest points without triangles.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from ssduck.geometry.arrays import Array
from ssduck.geometry.ellipsoids import nearest_on_ellipsoid
from ssduck.geometry.placed_solid import PlacedSolid, Point
from ssduck.geometry.poses import cross

# Surfaces that are nearer touch, metres.
CONTACT_TOLERANCE = 1e-9
# The error of results for cylinders and ellipsoids, metres; other convex shapes are exact up to
# rounding.
CYLINDER_TOLERANCE = 1e-7
# Corners that are nearer to a face lie in it, metres.
FACE_TOLERANCE = 1e-6
# The same for cylinders and ellipsoids, relative to the sizes.
_CYLINDER_FACE_TOLERANCE = 2e-5
MAX_EXPANSIONS = 40
MAX_POLYTOPE_POINTS = 400
MAX_STEPS = 100
_UP: Point = (0.0, 0.0, 1.0)
NEIGHBOUR_DIRECTIONS = np.array(
    [[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z],
    dtype=np.float64,
)
NEIGHBOUR_DIRECTIONS /= np.linalg.norm(NEIGHBOUR_DIRECTIONS, axis=1)[:, None]


@dataclass(frozen=True)
class Statistics:
    """The work of geometric relations for one world, over all its ticks.

    Attributes:
        pairs: the number of pairs of entities that were compared; a pair counts once a tick. If all
            pairs of a tick are compared at once, the candidate pairs count.
        calls: the number of calls of FCL: one or two for two shapes that are near each other, more
            for meshes that are deep in something, none for pairs that formulas decide, as they do
            for nearly all pairs that are compared at once. Calls that only propose what formulas
            then prove do not count.
    """

    pairs: int
    calls: int


@dataclass
class CallCounter:
    """Counts calls of FCL and compared pairs of entities.

    Attributes:
        calls: calls of FCL's collide and distance.
        pairs: the pairs of entities that were compared. A pair counts once a tick. If all pairs of
            a tick are compared at once, the candidate pairs count.
    """

    calls: int = 0
    pairs: int = 0


@dataclass(frozen=True, slots=True)
class SignedDistance:
    """The signed distance of a and b: `point_a - point_b == distance * normal`.

    Attributes:
        distance: metres; that of their nearest points, or minus the depth.
        point_a: on a, in the world. If they overlap, a point of a that is deepest in b. If a
            cylinder or an ellipsoid is deep in something, the point may be off by up to 0.005 of
            their sizes, because the depth hardly depends on it.
        point_b: on b.
        normal: unit, from b to a: the direction in which a would leave b. None for overlapping
            half-spaces, which no translation separates.
    """

    distance: float
    point_a: Point
    point_b: Point
    normal: Point | None

    def swapped(self) -> SignedDistance:
        """Returns the signed distance of b and a."""
        normal = self.normal
        reversed_normal = None if normal is None else (-normal[0], -normal[1], -normal[2])
        return SignedDistance(self.distance, self.point_b, self.point_a, reversed_normal)


Rule: TypeAlias = Callable[[PlacedSolid, PlacedSolid], SignedDistance]


def signed_distance(a: PlacedSolid, b: PlacedSolid, calls: CallCounter) -> SignedDistance:
    """Returns the signed distance of two convex solids, or of a half-space and any solid."""
    kinds = a.solid.type, b.solid.type
    rule = _RULES.get(kinds)
    if rule is not None:
        return rule(a, b)
    rule = _RULES.get(kinds[::-1])
    if rule is not None:
        return rule(b, a).swapped()
    if kinds[0] == "plane":
        return _against_plane(b, a).swapped()
    if kinds[1] == "plane":
        return _against_plane(a, b)
    gap, p, q, normal = _core_gap(a, b, calls)
    return offset_by_radii(gap, p, q, normal, a, b)


def offset_by_radii(
    gap: float, p: Any, q: Any, normal: Any, a: PlacedSolid, b: PlacedSolid
) -> SignedDistance:
    """Returns the signed distance of two shapes, from that of their cores."""
    radius_a, radius_b = a.solid.radius, b.solid.radius
    x, y, z = float(normal[0]), float(normal[1]), float(normal[2])
    return SignedDistance(
        float(gap) - radius_a - radius_b,
        (float(p[0]) - radius_a * x, float(p[1]) - radius_a * y, float(p[2]) - radius_a * z),
        (float(q[0]) + radius_b * x, float(q[1]) + radius_b * y, float(q[2]) + radius_b * z),
        (x, y, z),
    )


# -- formulas ---------------------------------------------------------------------------------


def _ends(a: PlacedSolid) -> tuple[Point, Point]:
    """Returns the ends of the core of a sphere or a capsule."""
    if a.solid.type == "sphere":
        x, y, z = a.solid.core[0].tolist()
        centre = a.to_world(x, y, z)
        return centre, centre
    half = a.solid.half_length
    return a.to_world(0.0, 0.0, -half), a.to_world(0.0, 0.0, half)


def _segments(a: PlacedSolid, b: PlacedSolid) -> SignedDistance:
    """Spheres and capsules: the nearest points of two segments."""
    (p1, p2), (q1, q2) = _ends(a), _ends(b)
    d1, d2, r = _difference(p2, p1), _difference(q2, q1), _difference(p1, q1)
    s, t = _nearest_on_segments(d1, d2, r)
    p = (p1[0] + s * d1[0], p1[1] + s * d1[1], p1[2] + s * d1[2])
    q = (q1[0] + t * d2[0], q1[1] + t * d2[1], q1[2] + t * d2[2])
    offset = _difference(p, q)
    length = math.sqrt(_dot(offset, offset))
    if length > CONTACT_TOLERANCE:
        normal = (offset[0] / length, offset[1] / length, offset[2] / length)
        return offset_by_radii(length, p, q, normal, a, b)
    return offset_by_radii(0.0, p, p, _any_normal(d1, d2), a, b)


def _nearest_on_segments(d1: Point, d2: Point, r: Point) -> tuple[float, float]:
    """Returns the fractions 0..1 along two segments of their nearest points (Ericson, 5.1.9)."""
    a, e, f = _dot(d1, d1), _dot(d2, d2), _dot(d2, r)
    if a <= 0.0 and e <= 0.0:
        return 0.0, 0.0
    if a <= 0.0:
        return 0.0, _clamp(f / e)
    c = _dot(d1, r)
    if e <= 0.0:
        return _clamp(-c / a), 0.0
    b = _dot(d1, d2)
    determinant = a * e - b * b
    s = _clamp((b * f - c * e) / determinant) if determinant > 1e-14 * a * e else 0.0
    t = (b * s + f) / e
    if t < 0.0:
        return _clamp(-c / a), 0.0
    if t > 1.0:
        return _clamp((b - c) / a), 1.0
    return s, t


def _any_normal(u: Point, v: Point) -> Point:
    """Returns a unit vector normal to two vectors of any length."""
    x, y, z = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
    length = math.sqrt(x * x + y * y + z * z)
    if length > 1e-9 * math.sqrt(_dot(u, u) * _dot(v, v)) and length > 0.0:
        return x / length, y / length, z / length
    along = u if _dot(u, u) > 0.0 else v
    if _dot(along, along) == 0.0:
        return _UP
    smallest = min(range(3), key=lambda k: abs(along[k]))
    return _any_normal(along, (float(smallest == 0), float(smallest == 1), float(smallest == 2)))


def _sphere_box(a: PlacedSolid, b: PlacedSolid) -> SignedDistance:
    centre = _ends(a)[0]
    x, y, z = point = b.to_local(centre)
    halves: Point = tuple(b.solid.core[7].tolist())
    nearest = [min(max(c, -h), h) for c, h in zip(point, halves, strict=True)]
    offset = _difference((x, y, z), (nearest[0], nearest[1], nearest[2]))
    length = math.sqrt(_dot(offset, offset))
    if length > CONTACT_TOLERANCE:
        normal = b.direction_to_world(offset[0] / length, offset[1] / length, offset[2] / length)
        return offset_by_radii(length, centre, b.to_world(*nearest), normal, a, b)
    axis = min(range(3), key=lambda k: halves[k] - abs(point[k]))
    side = math.copysign(1.0, point[axis])
    nearest[axis] = side * halves[axis]
    normal = b.direction_to_world(*(side if k == axis else 0.0 for k in range(3)))
    return offset_by_radii(
        abs(point[axis]) - halves[axis], centre, b.to_world(*nearest), normal, a, b
    )


def _sphere_cylinder(a: PlacedSolid, b: PlacedSolid) -> SignedDistance:
    centre = _ends(a)[0]
    x, y, z = b.to_local(centre)
    axis_distance, radius, half = math.hypot(x, y), b.solid.disc_radius, b.solid.half_length
    ux, uy = (x / axis_distance, y / axis_distance) if axis_distance > 0.0 else (1.0, 0.0)
    side, top = axis_distance - radius, abs(z) - half
    up = math.copysign(1.0, z)
    if max(side, top) > CONTACT_TOLERANCE:
        r, h = min(axis_distance, radius), min(max(z, -half), half)
        length = math.hypot(max(side, 0.0), max(top, 0.0))
        offset = (max(side, 0.0) / length * ux, max(side, 0.0) / length * uy, (z - h) / length)
        return offset_by_radii(
            length, centre, b.to_world(r * ux, r * uy, h), b.direction_to_world(*offset), a, b
        )
    if side >= top:
        nearest, normal, gap = (radius * ux, radius * uy, z), (ux, uy, 0.0), side
    else:
        nearest, normal, gap = (x, y, up * half), (0.0, 0.0, up), top
    return offset_by_radii(gap, centre, b.to_world(*nearest), b.direction_to_world(*normal), a, b)


def _sphere_ellipsoid(a: PlacedSolid, b: PlacedSolid) -> SignedDistance:
    centre = _ends(a)[0]
    point, semi_axes = b.to_local(centre), b.solid.semi_axes
    nearest = nearest_on_ellipsoid(semi_axes, point)
    x, y, z = (p / s / s for p, s in zip(nearest, semi_axes, strict=True))
    length = math.sqrt(x * x + y * y + z * z)
    normal = b.direction_to_world(x / length, y / length, z / length)
    q = b.to_world(*nearest)
    return offset_by_radii(_dot(_difference(centre, q), normal), centre, q, normal, a, b)


def _against_plane(a: PlacedSolid, b: PlacedSolid) -> SignedDistance:
    """Compares any solid a with the half-space b, by the deepest point of a."""
    normal = b.normals[0]
    heights = (a.points - b.position) @ normal
    lowest = float(heights.min())
    if a.solid.type == "ellipsoid":
        deepest = a.support_points(-normal[None])[0]
        lowest = float((deepest - b.position) @ normal)
        return offset_by_radii(lowest, deepest, deepest - lowest * normal, normal, a, b)
    lowest_points = a.points[heights <= lowest + CONTACT_TOLERANCE]
    deepest = np.add.reduce(lowest_points, axis=0) / len(lowest_points)
    if a.solid.disc_radius:
        axis = a.matrix[:, 2]
        down = float(normal @ axis) * axis - normal
        length = float(np.linalg.norm(down))
        lowest -= a.solid.disc_radius * length
        if length > CONTACT_TOLERANCE:
            deepest = deepest + a.solid.disc_radius / length * down
    return offset_by_radii(lowest, deepest, deepest - lowest * normal, normal, a, b)


def _two_planes(a: PlacedSolid, b: PlacedSolid) -> SignedDistance:
    """Returns two half-spaces, which are separate only if they face away from each other."""
    n, m = a.normals[0], b.normals[0]
    p, q = np.array(a.position), np.array(b.position)
    if float(np.linalg.norm(n + m)) <= CONTACT_TOLERANCE:
        gap = float((p - q) @ m)
        return offset_by_radii(gap, q + gap * m, q, m, a, b)
    # A point in both: on both boundaries, or on that of the deeper of two parallel half-spaces.
    if float(np.linalg.norm(n - m)) <= CONTACT_TOLERANCE:
        inside = p if float((p - q) @ n) <= 0.0 else q
    else:
        step = m - float(n @ m) * n
        inside = p + float((q - p) @ m) / float(step @ m) * step
    x, y, z = inside.tolist()
    return SignedDistance(-math.inf, (x, y, z), (x, y, z), None)


_RULES: dict[tuple[str, str], Rule] = {
    ("sphere", "sphere"): _segments,
    ("sphere", "capsule"): _segments,
    ("capsule", "capsule"): _segments,
    ("sphere", "box"): _sphere_box,
    ("sphere", "cylinder"): _sphere_cylinder,
    ("sphere", "ellipsoid"): _sphere_ellipsoid,
    ("plane", "plane"): _two_planes,
}


def _difference(p: Point, q: Point) -> Point:
    return p[0] - q[0], p[1] - q[1], p[2] - q[2]


def _dot(p: Point, q: Point) -> float:
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


def _clamp(value: float) -> float:
    return min(max(value, 0.0), 1.0)


# -- convex cores -----------------------------------------------------------------------------

Core: TypeAlias = tuple[float, Array, Array, Array]


def surface_distance(a: Any, b: Any, calls: CallCounter) -> tuple[float, Array, Array]:
    """FCL's distance of two surfaces, 0 if they cross, and their nearest points."""
    import fcl

    calls.calls += 1
    result = fcl.DistanceResult()  # a new object each time: FCL only lowers its distance
    distance = fcl.distance(a, b, fcl.DistanceRequest(enable_nearest_points=True), result)
    p, q = result.nearest_points
    return max(0.0, distance), p, q


def _core_gap(a: PlacedSolid, b: PlacedSolid, calls: CallCounter) -> Core:
    if "ellipsoid" in (a.solid.type, b.solid.type):
        return _gap_by_support_points(a, b)
    distance, p, q = surface_distance(a.fcl_object, b.fcl_object, calls)
    is_round = a.solid.is_swept or b.solid.is_swept
    if distance > CONTACT_TOLERANCE:
        p, q = _move_to_cylinder(a, q, p), _move_to_cylinder(b, p, q)
        core = _certify(a, b, p, q, CYLINDER_TOLERANCE if is_round else CONTACT_TOLERANCE)
        if core is not None:
            return core
    overlap = _overlap_depth(a, b, CYLINDER_TOLERANCE if is_round else CONTACT_TOLERANCE)
    return overlap or _nearest(a, b, p, q)


def _gap_by_support_points(a: PlacedSolid, b: PlacedSolid) -> Core:
    """Returns the signed distance of cores, of which one is an ellipsoid."""
    centres = (np.array(placed.to_world(*placed.solid.centre)) for placed in (a, b))
    nearest = _nearest(a, b, *centres)
    _, p, q, _ = nearest
    apart = _certify(a, b, p, q, CYLINDER_TOLERANCE)
    return apart or _overlap_depth(a, b, CYLINDER_TOLERANCE) or nearest


def _move_to_cylinder(a: PlacedSolid, towards: Array, point: Array) -> Array:
    """Moves a point of a cylinder's prism to the point of the cylinder nearest to another point."""
    if not a.solid.disc_radius:
        return point
    x, y, z = a.to_local((float(towards[0]), float(towards[1]), float(towards[2])))
    shrink = min(1.0, a.solid.disc_radius / max(math.hypot(x, y), 1e-300))
    half = a.solid.half_length
    return np.array(a.to_world(x * shrink, y * shrink, min(max(z, -half), half)))


def _certify(a: PlacedSolid, b: PlacedSolid, p: Array, q: Array, tolerance: float) -> Core | None:
    """Returns the distance if the direction from q to p separates the cores by it."""
    offset = p - q
    length = math.sqrt(float(offset @ offset))
    if length <= CONTACT_TOLERANCE:
        return None
    normal = offset / length
    gap = -float((a.support_heights(-normal[None]) + b.support_heights(normal[None]))[0])
    scale = a.solid.bounding_radius + b.solid.bounding_radius
    if length - gap > max(tolerance, 1e-12 * scale):
        return None
    return length, p, q, normal


def _overlap_depth(a: PlacedSolid, b: PlacedSolid, tolerance: float) -> Core | None:
    """Returns minus the depth (the least overlap in any direction); None if the cores are apart."""
    directions = _candidate_directions(a, b)
    overlaps = b.support_heights(directions) + a.support_heights(-directions)
    smallest = int(overlaps.argmin())
    if overlaps[smallest] < -CONTACT_TOLERANCE:
        return None
    normal, depth = directions[smallest], max(0.0, float(overlaps[smallest]))
    for first, second in ((a, b), (b, a)):
        corner = _deepest_corner(first, second, depth)
        if corner is not None:
            if first is a:
                return -depth, corner, corner + depth * normal, normal
            return -depth, corner - depth * normal, corner, normal
    if not a.solid.type == b.solid.type == "box":
        expanded = _expand_polytope(a, b, directions, normal, float(overlaps[smallest]), tolerance)
        if expanded is None:
            return None
        depth, normal = expanded
    face_tolerance = FACE_TOLERANCE
    if a.solid.is_swept or b.solid.is_swept:
        # The depth has the error of the tolerance, and so has the direction relative to the sizes.
        face_tolerance = max(
            FACE_TOLERANCE,
            _CYLINDER_FACE_TOLERANCE * (a.solid.bounding_radius + b.solid.bounding_radius),
        )
    return _witnesses(
        depth,
        normal,
        a.extreme_points(-normal, face_tolerance),
        b.extreme_points(normal, face_tolerance),
    )


def _candidate_directions(a: PlacedSolid, b: PlacedSolid) -> Array:
    """Returns directions that may have the least overlap; for boxes all (Gottschalk 1996)."""
    if a.solid.type == b.solid.type == "box":
        pairs = np.repeat(a.matrix.T, 3, axis=0), np.tile(b.matrix.T, (3, 1))
        edges = cross(*pairs)
        length = np.sqrt((edges * edges).sum(axis=1))
        has_length = length > 1e-6
        edges = edges[has_length] / length[has_length, None]
        return np.concatenate((b.normals, -a.normals, edges, -edges))
    return np.concatenate((b.normals, -a.normals, NEIGHBOUR_DIRECTIONS))


def _deepest_corner(a: PlacedSolid, b: PlacedSolid, depth: float) -> Array | None:
    """Returns a point of a that is as deep in b as the overlap in some direction; or None."""
    # Its depth bounds that of a from below, as the overlap in any direction does from above.
    if b.offsets is None:
        return None
    points = a.support_points(-b.normals) if a.solid.is_swept else a.points
    depths = (b.offsets - points @ b.normals.T).min(axis=1)
    is_deepest = depths >= depth - CONTACT_TOLERANCE
    if not is_deepest.any():
        return None
    centre: Array = points[is_deepest].mean(axis=0)
    return centre


def _expand_polytope(
    a: PlacedSolid, b: PlacedSolid, directions: Array, normal: Array, depth: float, tolerance: float
) -> tuple[float, Array] | None:
    """Computes the depth and its direction with a polytope that grows in the difference."""
    from scipy.spatial import ConvexHull, QhullError

    points_a, points_b = a.support_points(-directions), b.support_points(directions)
    for _ in range(MAX_EXPANSIONS):
        try:
            hull = ConvexHull(points_a - points_b)
        except QhullError:  # a flat difference: they only touch
            differences = points_a - points_b
            normals = np.linalg.svd(differences - differences[0])[2][2:]
            normals = np.concatenate((normals, -normals))
            overlaps = b.support_heights(normals) + a.support_heights(-normals)
            if overlaps.min() < depth:
                depth, normal = float(overlaps.min()), normals[int(overlaps.argmin())]
            break
        outward, inside = hull.equations[:, :3], -hull.equations[:, 3]
        thin_directions = np.unique(outward[inside < depth - tolerance], axis=0)
        if not len(thin_directions):
            break
        new_a, new_b = a.support_points(thin_directions), b.support_points(-thin_directions)
        overlaps = np.einsum("ij,ij->i", thin_directions, new_a - new_b)
        best = int(overlaps.argmin())
        if overlaps[best] < depth:
            depth, normal = float(overlaps[best]), -thin_directions[best]
        if depth < -CONTACT_TOLERANCE:
            return None
        extents = np.einsum("ij,kj->ik", thin_directions, points_a - points_b).max(axis=1)
        is_new = overlaps > extents + tolerance / 4
        # If all sides are equally thin, as for coaxial cylinders, any of many directions is as
        # good as the best one.
        if not is_new.any() or len(points_a) > MAX_POLYTOPE_POINTS:
            break
        points_a, points_b = (
            np.concatenate((points_a, new_a[is_new])),
            np.concatenate((points_b, new_b[is_new])),
        )
    return None if depth < -CONTACT_TOLERANCE else (max(0.0, depth), normal)


def _witnesses(depth: float, normal: Array, points_a: Array, points_b: Array) -> Core:
    """Returns a point of each core at a depth: opposite combinations of deepest points."""
    from scipy.optimize import nnls

    midpoint = (points_a.mean(axis=0) + points_b.mean(axis=0)) / 2
    scale = max(
        float(np.abs(points_a - midpoint).max()),
        float(np.abs(points_b - midpoint).max()),
        CONTACT_TOLERANCE,
    )
    count = len(points_a)
    system = np.zeros((5, count + len(points_b)))
    system[:3, :count] = ((points_a - midpoint) / scale).T
    system[:3, count:] = (-(points_b - midpoint) / scale).T
    system[3, :count] = system[4, count:] = 1.0
    weights, _ = nnls(system, np.concatenate((-depth / scale * normal, (1.0, 1.0))))
    p, q = weights[:count] @ points_a / weights[:count].sum(), weights[count:] @ points_b
    q /= weights[count:].sum()
    # Each point takes half of the rounding error, so that their distance is exactly the depth.
    midpoint = (p + q) / 2
    return -depth, midpoint - depth / 2 * normal, midpoint + depth / 2 * normal, normal


def _nearest(a: PlacedSolid, b: PlacedSolid, p: Array, q: Array) -> Core:
    """Returns the nearest points of separate cores: Wolfe's point of least norm (1976)."""
    points_a, points_b = a.support_points((q - p)[None]), b.support_points((p - q)[None])
    if float(np.linalg.norm(p - q)) > CONTACT_TOLERANCE:
        points_a, points_b = np.vstack((p, points_a)), np.vstack((q, points_b))
    weights = np.zeros(len(points_a))
    weights[0] = 1.0
    normal, last_length = np.array(_UP), math.inf
    for _ in range(MAX_STEPS):
        weights, points_a, points_b = _least_norm_combination(weights, points_a, points_b)
        p, q = weights @ points_a, weights @ points_b
        offset = p - q
        length = float(np.linalg.norm(offset))
        if length <= CONTACT_TOLERANCE:
            break
        normal = offset / length
        new_a, new_b = a.support_points(-normal[None]), b.support_points(normal[None])
        if length - float((new_a - new_b)[0] @ normal) <= CYLINDER_TOLERANCE / 10:
            break
        if length > last_length - CONTACT_TOLERANCE / 1e4:
            # Points that nearly coincide are replaced by their combination.
            points_a, points_b, weights = p[None], q[None], np.ones(1)
        last_length = length
        points_a, points_b = np.vstack((points_a, new_a)), np.vstack((points_b, new_b))
        weights = np.append(weights, 0.0)
    return length, p, q, normal


def _least_norm_combination(
    weights: Array, points_a: Array, points_b: Array
) -> tuple[Array, Array, Array]:
    """Returns the convex combination of least norm, by steps to the affine one."""
    while True:
        points = points_a - points_b
        # Relative to the first point: the normal equations would square the rounding errors of
        # points that are close together.
        directions = (points[1:] - points[0]).T
        length = np.maximum(np.sqrt((directions * directions).sum(axis=0)), 1e-300)
        coefficients = -np.linalg.lstsq(directions / length, points[0], rcond=1e-12)[0] / length
        affine = np.concatenate(([1.0 - coefficients.sum()], coefficients))
        if affine.min() > 1e-14:
            return affine, points_a, points_b
        is_negative = affine <= 1e-14
        fractions = weights[is_negative] / np.maximum(
            weights[is_negative] - affine[is_negative], 1e-300
        )
        step = min(1.0, float(fractions.min()))
        weights = weights + step * (affine - weights)
        keep = weights > 1e-14
        if keep.all():
            keep[int(weights.argmin())] = False
        if not keep.any():
            keep[int(weights.argmax())] = True
        weights, points_a, points_b = (
            weights[keep] / weights[keep].sum(),
            points_a[keep],
            points_b[keep],
        )
