"""How much of a volume is inside a convex hull, and what a hull covers on the ground."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ssduck.geometry import Array, Indices
from ssduck.separation import Placed
from ssduck.solids import Solid, hull_of
from ssduck.surfaces import without_copies

# What sticks out of a hull by less, metres, is in it.
ROUNDING = 1e-9


def share_inside(a: Sequence[Placed], b: Sequence[Placed]) -> float | None:
    """The share of b's volume that is inside the convex hull of a, 0..1.

    Exact for boxes, hulls and closed meshes. A sphere or a capsule is a polyhedron of the same
    volume with about 1000 corners, a cylinder a prism with 64 sides, which puts the share off by
    at most 0.005. An open mesh has the volume of its convex hull. Shapes of b count one by one.

    Returns:
        None if b has no volume.
    """
    if any(one.solid.type == "plane" for one in b):
        return 1.0 if _is_everything(a) else 0.0
    pieces = [(one, _filled(one.solid)) for one in b]
    whole = sum(solid.volume for _, solid in pieces)
    if not whole > 0.0:
        return None
    hull = _half_spaces(a)
    if hull is None:
        return 0.0
    inside = sum(_volume_inside(one, solid, *hull) for one, solid in pieces if solid.volume)
    return min(1.0, max(0.0, inside / whole))


def _filled(solid: Solid) -> Solid:
    return solid if solid.closed or solid.is_convex else hull_of(solid.points)


def _is_everything(a: Sequence[Placed]) -> bool:
    """Whether the hull is all of space: that of half-spaces which differ in direction."""
    normals = [one.normals[0] for one in a if one.solid.type == "plane"]
    return any(float(np.linalg.norm(normals[0] - normal)) > ROUNDING for normal in normals)


def _half_spaces(a: Sequence[Placed]) -> tuple[Array, Array] | None:
    """The hull as normals and offsets; None if it has no volume."""
    if _is_everything(a):
        return np.zeros((0, 3)), np.zeros(0)
    planes = [one for one in a if one.solid.type == "plane"]
    points = _points(a)
    if planes:
        normal = planes[0].normals[0]
        heights = [float(normal @ one.position) for one in planes]
        heights += (points @ normal).tolist()
        return normal[None], np.array([max(heights)])
    hull = hull_of(points)
    return None if hull.offsets is None else (hull.normals, hull.offsets)


def _points(a: Sequence[Placed]) -> Array:
    """Points of shapes in the world whose convex hull is theirs."""
    bodies = [one for one in a if one.solid.type != "plane"]
    placed = [one.solid.points @ one.matrix.T + one.position for one in bodies]
    return np.concatenate(placed) if placed else np.zeros((0, 3))


def _volume_inside(one: Placed, solid: Solid, normals: Array, offsets: Array) -> float:
    """How much of one shape's volume is within planes."""
    points = solid.points @ one.matrix.T + one.position
    outside = points @ normals.T - offsets > ROUNDING
    if outside.all(axis=0).any():
        return 0.0
    cutting = outside.any(axis=0)
    if not cutting.any():
        return solid.volume
    if solid.is_convex:
        hull = hull_of(points)
        assert hull.offsets is not None  # for it has a volume
        common = _common_volume(
            np.concatenate((normals[cutting], hull.normals)),
            np.concatenate((offsets[cutting], hull.offsets)),
        )
        return min(1.0, common / hull.volume) * solid.volume
    corners = points[solid.faces]
    apex = np.broadcast_to(corners.reshape(-1, 3).mean(axis=0), (len(corners), 1, 3))
    tetrahedra = np.concatenate((apex, corners), axis=1)
    signs = np.sign(_signed_volumes(tetrahedra))
    whole = float(signs @ np.abs(_signed_volumes(tetrahedra)))
    for normal, offset in zip(normals[cutting], offsets[cutting], strict=True):
        tetrahedra, signs = _clipped(tetrahedra, signs, normal, float(offset))
    share = float(signs @ np.abs(_signed_volumes(tetrahedra))) / whole
    return share * solid.volume


def _common_volume(normals: Array, offsets: Array) -> float:
    """The volume of what is below all planes, around the middle of the largest ball in it."""
    from scipy.optimize import linprog
    from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

    rows = np.column_stack((normals, np.ones(len(normals))))
    ball = linprog((0, 0, 0, -1), A_ub=rows, b_ub=offsets, bounds=(None, None), method="highs")
    if ball.status != 0 or ball.x[3] <= ROUNDING:
        return 0.0
    try:
        corners = HalfspaceIntersection(np.column_stack((normals, -offsets)), ball.x[:3])
        return float(ConvexHull(corners.intersections).volume)
    except QhullError:  # too thin for it
        return 0.0


def _signed_volumes(tetrahedra: Array) -> Array:
    edges = tetrahedra[:, 1:] - tetrahedra[:, :1]
    volumes: Array = np.linalg.det(edges) / 6.0
    return volumes


def _clipped(tetra: Array, signs: Array, normal: Array, offset: float) -> tuple[Array, Array]:
    """Tetrahedra (k, 4, 3) cut off at a plane, as tetrahedra that add up to what is below it."""
    below = offset - tetra @ normal
    order = np.argsort(-below, axis=1)
    tetra = np.take_along_axis(tetra, order[:, :, None], axis=1)
    below = np.take_along_axis(below, order, axis=1)
    count = (below > 0.0).sum(axis=1)
    kept, weights = [tetra[count == 4]], [signs[count == 4]]

    def cut(rows: Indices, inner: int, outer: int) -> Array:
        h, g = below[rows, inner, None], below[rows, outer, None]
        point: Array = tetra[rows, inner] + h / (h - g) * (tetra[rows, outer] - tetra[rows, inner])
        return point

    one, two, three = (np.flatnonzero(count == number) for number in (1, 2, 3))
    # A corner; or a wedge, or a corner less: both prisms, with a triangle at either end.
    parts: list[tuple[Indices, tuple[Array, ...]]]
    parts = [(one, (tetra[one, 0], cut(one, 0, 1), cut(one, 0, 2), cut(one, 0, 3)))]
    first = tetra[two, 0], cut(two, 0, 2), cut(two, 0, 3)
    wedge = (*first, tetra[two, 1], cut(two, 1, 2), cut(two, 1, 3))
    stump = (*(tetra[three, k] for k in range(3)), *(cut(three, k, 3) for k in range(3)))
    parts += [(two, wedge[k : k + 4]) for k in range(3)]
    parts += [(three, stump[k : k + 4]) for k in range(3)]
    for rows, corners in parts:
        kept.append(np.stack(corners, axis=1))
        weights.append(signs[rows])
    return np.concatenate(kept), np.concatenate(weights)


# -- on the ground -----------------------------------------------------------------------------


def footprint(a: Sequence[Placed]) -> Array:
    """The corners (k, 2) of the convex hull of the shapes' shadows; of half-spaces not."""
    points = without_copies(_points(a)[:, :2])
    from scipy.spatial import ConvexHull, QhullError

    if len(points) < 4:
        return points
    try:
        corners: Array = points[ConvexHull(points).vertices]
    except QhullError:  # all in a line
        return points
    return corners


def covers(a: Sequence[Placed], corners: Array, x: float, y: float) -> bool:
    """Whether a point of the ground is over the footprint, its rim included."""
    for one in a:
        if one.solid.type == "plane":
            nx, ny, nz = one.normals[0].tolist()
            over = nx * (x - one.position[0]) + ny * (y - one.position[1])
            if abs(nz) > ROUNDING or over <= ROUNDING:
                return True
    if not len(corners):
        return False
    if len(corners) < 3:
        return _is_between(corners[0], corners[-1], x, y)
    after = np.roll(corners, -1, axis=0)
    dx, dy = (after - corners).T
    left = dx * (y - corners[:, 1]) - dy * (x - corners[:, 0])
    turn = float(dx @ corners[:, 1] - dy @ corners[:, 0])
    length = np.hypot(dx, dy)
    way = -1.0 if turn > 0 else 1.0
    if not np.any(np.abs(left) > ROUNDING * length):
        return _is_between(corners.min(axis=0), corners.max(axis=0), x, y)
    return bool((way * left >= -ROUNDING * length).all())


def _is_between(p: Array, q: Array, x: float, y: float) -> bool:
    """Whether a point is on a segment."""
    direct = math.dist(p, q)
    return math.dist(p, (x, y)) + math.dist((x, y), q) <= direct + ROUNDING
