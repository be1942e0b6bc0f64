"""How much of a volume is inside a convex hull, and what a hull covers on the ground."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ssduck.geometry import Array, Geometry, Indices
from ssduck.separation import Placed
from ssduck.solids import hull_of, solid_of
from ssduck.surfaces import TOGETHER, without_copies

# What sticks out of a hull by less, metres, is in it; what sticks into it by less is not.
ROUNDING = 1e-9
# A triangle whose shadow is smaller, as a share of its longest edge squared, casts none.
UPRIGHT = 1e-13
# Pairs of triangles that are cut together: 10 MB an array.
CUT_TOGETHER = 30_000


@dataclass(frozen=True, eq=False)
class Hull:
    """The convex hull of shapes, in the world; it has a volume.

    Attributes:
        normals: (m, 3) outward unit normals of the faces; none of what is all of space.
        offsets: (m,): x is inside if `normals @ x <= offsets`.
        triangles: (k, 3, 3) the surface, facing outward; none of what has no end.
    """

    normals: Array
    offsets: Array
    triangles: Array

    @property
    def is_everything(self) -> bool:
        """Whether no point is outside."""
        return not len(self.normals)


def hull_around(a: Sequence[Placed]) -> Hull | None:
    """The convex hull of shapes; None if it has no volume.

    Round shapes are polyhedra: see `share_inside`.
    """
    planes = [one for one in a if one.solid.type == "plane"]
    points = _points(a)
    if not planes:
        solid = hull_of(points)
        if solid.offsets is None:
            return None
        return Hull(solid.normals, solid.offsets, solid.core[solid.faces])
    endless = np.zeros((0, 3, 3))
    normal = planes[0].normals[0]
    if any(float(np.linalg.norm(normal - one.normals[0])) > ROUNDING for one in planes):
        return Hull(np.zeros((0, 3)), np.zeros(0), endless)  # they differ in direction
    heights = [float(normal @ one.position) for one in planes]
    heights += (points @ normal).tolist()
    return Hull(normal[None], np.array([max(heights)]), endless)


def share_inside(hull: Hull | None, b: Sequence[Placed]) -> float | None:
    """The share of b's volume that is inside a convex hull, 0..1.

    Exact for boxes, hulls and closed meshes. A ball, or the end of a capsule, that the hull cuts
    is a polyhedron of the same volume with about 1000 corners, a cylinder a prism with 64 sides,
    and so they are in the hull: this puts the share off by at most 0.005. An open mesh has the
    volume of its convex hull. Shapes of b count one by one.

    Returns:
        None if b has no volume.
    """
    if any(one.solid.type == "plane" for one in b):
        return 1.0 if hull is not None and hull.is_everything else 0.0
    solid = [one for one in b if one.solid.bulk > 0.0]
    whole = sum(one.solid.bulk for one in solid)
    if not solid:
        return None
    if hull is None:
        return 0.0
    spans = [_span(hull, one) for one in solid]
    inside = sum(
        one.solid.bulk for one, (_, top) in zip(solid, spans, strict=True) if top <= ROUNDING
    )
    cut = [
        one
        for one, (bottom, top) in zip(solid, spans, strict=True)
        if bottom < -ROUNDING and top > ROUNDING
    ]
    if cut:
        inside += _volume_inside(hull, cut)
    return min(1.0, max(0.0, inside / whole))


def _points(a: Sequence[Placed]) -> Array:
    """Points of shapes in the world whose convex hull is theirs."""
    bodies = [one for one in a if one.solid.type != "plane"]
    placed = [one.solid.points @ one.matrix.T + one.position for one in bodies]
    return np.concatenate(placed) if placed else np.zeros((0, 3))


# -- in a hull ---------------------------------------------------------------------------------


def _span(hull: Hull, one: Placed) -> tuple[float, float]:
    """Heights over the faces of a hull: the most of a shape's lowest points, and of its highest.

    A shape whose highest are all below the faces is inside; one whose lowest are above a face is
    not. That is all that counts, so one that a sphere around it shows to be so is not looked at.
    """
    middle, reach = one.world(*one.solid.centre), one.solid.reach
    heights = hull.normals @ middle - hull.offsets
    farthest = float(heights.max(initial=-math.inf))
    if abs(farthest) >= reach:
        return farthest - reach, farthest + reach
    near = np.flatnonzero(heights > -reach)
    bottom = top = -math.inf
    step = max(1, TOGETHER // len(one.points))
    for start in range(0, len(near), step):
        some = near[start : start + step]
        normals, offsets = hull.normals[some], hull.offsets[some]
        radius = one.solid.radius
        top = max(top, float((one.reaches(normals) + radius - offsets).max()))
        bottom = max(bottom, float((-one.reaches(-normals) - radius - offsets).max()))
    return bottom, top


def _volume_inside(hull: Hull, cut: Sequence[Placed]) -> float:
    """How much of shapes' volumes is within a hull."""
    surfaces = [one.solid.filled for one in cut]
    corners = [
        (surface.vertices @ one.matrix.T + one.position)[surface.faces]
        for one, surface in zip(cut, surfaces, strict=True)
    ]
    # What is round has the volume of its polyhedron only nearly.
    weights = [
        one.solid.bulk / surface.volume for one, surface in zip(cut, surfaces, strict=True)
    ]
    weight = np.repeat(weights, [len(surface.faces) for surface in surfaces])
    triangles = np.concatenate(corners)
    around = hull.triangles
    if not len(around):
        around = _below(hull, triangles.reshape(-1, 3))
    return common_volume(triangles, weight, around)


def _below(hull: Hull, points: Array) -> Array:
    """The surface (12, 3, 3) of a cube in a half-space that has what it has of the points."""
    low, high = points.min(axis=0), points.max(axis=0)
    normal, middle = hull.normals[0], (low + high) / 2
    side = 2.0 * math.dist(low, high)
    along = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    along /= np.linalg.norm(along)
    frame = np.stack((along, np.cross(normal, along), normal))
    centre = middle - (middle @ normal - hull.offsets[0] + side / 2) * normal
    cube = solid_of(Geometry.primitive("box", (side, side, side)))
    triangles: Array = (cube.core @ frame + centre)[cube.faces]
    return triangles


def common_volume(surface: Array, weights: Array, other: Array) -> float:
    """The volume that two closed surfaces have in common.

    With s = 1 of a triangle that faces up and -1 of one that faces down, a point is inside as
    often as the sum of s over the triangles above it says. So the volume is the sum over pairs
    of triangles, one of either surface, of the product of their s and the integral, over the
    common part of their shadows on the ground, of the lesser of their heights. As the s of all
    triangles over a place of the ground add up to 0, it may be lowered by the height of the
    second, which leaves but pairs with something of the first below the second. Nothing is
    decided by rounding: faces that lie in each other are like all others.

    Args:
        surface: triangles (n, 3, 3) that face outward.
        weights: (n,) how often what a triangle encloses counts.
        other: triangles (m, 3, 3) that face outward.
    """
    middle = surface.reshape(-1, 3).mean(axis=0)
    surface, other = surface - middle, other - middle
    areas, other_areas = _shadows(surface), _shadows(other)
    surface, weights = surface[areas != 0.0], weights[areas != 0.0]
    other, other_areas = other[other_areas != 0.0], other_areas[other_areas != 0.0]
    volume = 0.0
    for first, second in _over_each_other(surface, other):
        for start in range(0, len(first), CUT_TOGETHER):
            i, j = first[start : start + CUT_TOGETHER], second[start : start + CUT_TOGETHER]
            sums = _lowered(surface[i], other[j], other_areas[j])
            volume += float(weights[i] @ sums)
    return volume


def _shadows(triangles: Array) -> Array:
    """Twice the areas of triangles' shadows, (n,), negative of those that face down."""
    one, two = (triangles[:, k, :2] - triangles[:, 0, :2] for k in (1, 2))
    areas: Array = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]
    edges = triangles - np.roll(triangles, 1, axis=1)
    longest = np.einsum("nki,nki->nk", edges, edges).max(axis=1, initial=0.0)
    return np.where(np.abs(areas) > UPRIGHT * longest, areas, 0.0)


def _over_each_other(surface: Array, other: Array) -> Iterator[tuple[Indices, Indices]]:
    """Pairs of triangles: shadows whose boxes meet, and not all of the first above the second."""
    low, high = surface.min(axis=1), surface.max(axis=1)
    other_low, other_high = other.min(axis=1), other.max(axis=1)
    step = max(1, TOGETHER // max(1, len(surface)))
    for start in range(0, len(other), step):
        lows, highs = other_low[start : start + step], other_high[start : start + step]
        i, j = np.nonzero(low[:, None, 2] < highs[None, :, 2])
        for axis in (0, 1):
            meets = (low[i, axis] < highs[j, axis]) & (lows[j, axis] < high[i, axis])
            i, j = i[meets], j[meets]
        yield i, j + start


def _lowered(first: Array, second: Array, areas: Array) -> Array:
    """Of pairs of triangles (n, 3, 3) the integrals of how far the first is below the second.

    Negative, and with the sign of the product of their s: see `common_volume`.

    Args:
        first: ones of any shadow.
        second: others.
        areas: (n,) what `_shadows` says of those.
    """
    origin, edges = second[:, :1], second[:, 1:] - second[:, :1]
    # In the frame in which the shadow of the second has the corners (0, 0), (1, 0), (0, 1).
    x, y = np.moveaxis((first - origin)[:, :, :2], 2, 0)
    (px, py), (qx, qy) = np.moveaxis(edges[:, :, :2], 0, 2)[:, :, :, None]
    u, v = x * qy - y * qx, y * px - x * py
    polygons = np.stack((u, v, first[:, :, 2]), axis=2)
    polygons[:, :, :2] /= areas[:, None, None]
    rows = np.arange(len(first))
    for side in ((1.0, 0.0), (0.0, 1.0), (-1.0, -1.0)):
        heights = polygons[:, :, :2] @ np.array(side) + (sum(side) < 0.0)
        polygons, some = _cut(polygons, heights)
        rows = rows[some]
    over = np.einsum("nki,ni->nk", polygons[:, :, :2], edges[rows, :, 2]) + origin[rows, :, 2]
    polygons[:, :, 2] -= over
    polygons, some = _cut(polygons, -polygons[:, :, 2])
    rows = rows[some]
    found = np.zeros(len(first))
    found[rows] = _integrals(polygons) * np.abs(areas[rows])
    return found


def _cut(polygons: Array, heights: Array) -> tuple[Array, Indices]:
    """The parts of convex polygons (n, k, d) where heights (n, k), linear over each, are not < 0.

    Returns:
        Those that have such a part, their last corner repeated so that all have as many; which
        ones they are.
    """
    held = heights >= 0.0
    crossed = held != np.roll(held, -1, axis=1)
    share = heights / np.where(crossed, heights - np.roll(heights, -1, axis=1), 1.0)
    met = polygons + share[:, :, None] * (np.roll(polygons, -1, axis=1) - polygons)
    count, k, d = polygons.shape
    corners = np.stack((polygons, met), axis=2).reshape(count, 2 * k, d)
    used = np.stack((held, crossed), axis=2).reshape(count, 2 * k)
    left = used.sum(axis=1)
    rows = np.flatnonzero(left)
    order = np.argsort(~used[rows], axis=1, kind="stable")
    last = np.minimum(np.arange(left.max(initial=0)), left[rows, None] - 1)
    order = np.take_along_axis(order, last, axis=1)
    return np.take_along_axis(corners[rows], order[:, :, None], axis=1), rows


def _integrals(polygons: Array) -> Array:
    """Of polygons (n, k, 3) the integrals of their third coordinate over the plane of the others.

    Negated where they run clockwise.
    """
    start, one, two = polygons[:, :1], polygons[:, 1:-1], polygons[:, 2:]
    u, v = one - start, two - start
    areas = u[:, :, 0] * v[:, :, 1] - u[:, :, 1] * v[:, :, 0]
    heights = start[:, :, 2] + one[:, :, 2] + two[:, :, 2]
    found: Array = np.einsum("nk,nk->n", areas, heights) / 6.0
    return found


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
