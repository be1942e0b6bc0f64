"""How much of a volume is inside a convex hull, and what a hull covers on the ground."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from ssduck.geometry.arrays import Array
from ssduck.geometry.common_volume import common_volume
from ssduck.geometry.placed_solid import PlacedSolid
from ssduck.geometry.shapes import Geometry
from ssduck.geometry.solids import FLAT, Solid, hull_solid, solid_of
from ssduck.geometry.surfaces import unique_points

# What sticks out of a hull by less, metres, is in it; what sticks into it by less is not.
ROUNDING = 1e-9
# Corners of polyhedra stick out of what is round by no more, as a share of its radius.
ROUND = 0.002
# Points times directions that are looked at together: 8 MB an array.
REACHES = 1_000_000

# The lower corner and the upper one.
Box: TypeAlias = list[float]


@dataclass(frozen=True, eq=False)
class WorldHull:
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


def world_hull(a: Sequence[PlacedSolid]) -> WorldHull | None:
    """The convex hull of shapes; None if it has no volume.

    Round shapes are polyhedra: see `fraction_inside`.
    """
    planes = [one for one in a if one.solid.type == "plane"]
    own = _own_hull(a[0]) if len(a) == 1 else None
    if own is not None:
        return own
    if not planes:
        solid = hull_solid(_points(a))
        if solid.offsets is None:
            return None
        return WorldHull(solid.normals, solid.offsets, solid.core[solid.faces])
    endless = np.zeros((0, 3, 3))
    normal = planes[0].normals[0]
    if any(float(np.linalg.norm(normal - one.normals[0])) > ROUNDING for one in planes):
        return WorldHull(np.zeros((0, 3)), np.zeros(0), endless)  # they differ in direction
    heights = [float(normal @ one.position) for one in planes]
    bodies = (one for one in a if one.solid.type != "plane")
    heights += [float(one.support_heights(normal[None])[0]) + one.solid.radius for one in bodies]
    return WorldHull(normal[None], np.array([max(heights)]), endless)


def _own_hull(a: PlacedSolid) -> WorldHull | None:
    """That of a polyhedron that is its own, and surely is not flat."""
    sharp = (
        a.solid.type in ("box", "hull")
        and a.solid.inscribed_radius > FLAT * a.solid.bounding_radius
    )
    if not sharp or a.offsets is None:
        return None
    return WorldHull(a.normals, a.offsets, a.points[a.solid.faces])


def fraction_inside(hull: WorldHull | None, b: Sequence[PlacedSolid]) -> float | None:
    """The share of b's volume that is inside a convex hull, 0..1.

    Exact for boxes, hulls and closed meshes. In the hull, and where the hull cuts them, balls and
    the ends of capsules are polyhedra of about 1000 corners, cylinders prisms with 64 sides, of
    the same volume. Their surfaces are off by at most 0.002 of the radius, shares by at most
    0.005 if b is no thinner than half the radius of what is round in the hull. Shapes of b count
    one by one; an open mesh has no volume, and does not count.

    Returns:
        None if b has no volume.
    """
    if any(one.solid.type == "plane" for one in b):
        return 1.0 if hull is not None and hull.is_everything else 0.0
    solid = [one for one in b if one.solid.volume > 0.0]
    whole = sum(one.solid.volume for one in solid)
    if not solid:
        return None
    if hull is None:
        return 0.0
    inside, cut = 0.0, []
    for one in solid:
        bottom, top = _span(hull, one)
        if top <= ROUNDING:
            inside += one.solid.volume
        elif bottom < -ROUNDING:
            cut.append(one)
    if cut:
        inside += _volume_inside(hull, cut)
    return min(1.0, max(0.0, inside / whole))


def hull_bounds(a: Iterable[tuple[Solid, Box]]) -> Box:
    """A box that the hull of shapes is in: by the solids, and the box of each."""
    boxes = np.array([_grown(solid, box) for solid, box in a]).reshape(-1, 6)
    low, high = boxes[:, :3].min(0, initial=math.inf), boxes[:, 3:].max(0, initial=-math.inf)
    corners: Box = [*low.tolist(), *high.tolist()]
    return corners


def max_fraction_in_box(around: Box, b: Iterable[tuple[Solid, Box]]) -> float:
    """What `fraction_inside` says at most: no more of a shape is inside than its box has room for.

    Args:
        around: a box that the hull is in.
        b: the solids, and the box of each; they have a volume, and none is a plane.
    """
    inside = whole = 0.0
    for solid, box in b:
        own, room = _grown(solid, box), 1.0
        for k in range(3):
            room *= max(min(around[k + 3], own[k + 3]) - max(around[k], own[k]), 0.0)
        inside += min(solid.volume, room)
        whole += solid.volume
    return inside / whole


def max_fraction_in_hull(hull: WorldHull | None, b: Sequence[PlacedSolid]) -> float:
    """The same: what a face of the hull cuts off from the sphere in a shape is not inside."""
    if hull is None:
        return 0.0
    inside = whole = 0.0
    for one in b:
        middle, radius = one.to_world(*one.solid.inscribed_centre), one.solid.inscribed_radius
        over = float((hull.normals @ middle - hull.offsets).max(initial=-math.inf)) - ROUNDING
        height = min(max(radius + over, 0.0), 2.0 * radius)
        inside += one.solid.volume - math.pi * height**2 * (radius - height / 3.0)
        whole += one.solid.volume
    return inside / whole


def _grown(solid: Solid, box: Box) -> Box:
    """The box of what stands in for a solid here: of a polyhedron if it is round."""
    if solid.type == "plane":
        return [-math.inf] * 3 + [math.inf] * 3
    off = ROUNDING + ROUND * max(solid.radius, solid.disc_radius)
    a, b, c, d, e, f = box
    return [a - off, b - off, c - off, d + off, e + off, f + off]


def _points(a: Sequence[PlacedSolid]) -> Array:
    """Points of shapes in the world whose convex hull is theirs."""
    bodies = [one for one in a if one.solid.type != "plane"]
    placed = [one.solid.points @ one.matrix.T + one.position for one in bodies]
    return np.concatenate(placed) if placed else np.zeros((0, 3))


# -- in a hull ---------------------------------------------------------------------------------


def _span(hull: WorldHull, one: PlacedSolid) -> tuple[float, float]:
    """Heights over the faces of a hull: the most of a shape's lowest points, and of its highest.

    A shape whose highest are all below the faces is inside; one whose lowest are above a face is
    not. That is all that counts, so one that a sphere around it shows to be so is not looked at.
    """
    middle, reach = one.to_world(*one.solid.centre), one.solid.bounding_radius
    heights = hull.normals @ middle - hull.offsets
    farthest = float(heights.max(initial=-math.inf))
    if abs(farthest) >= reach:
        return farthest - reach, farthest + reach
    near = np.flatnonzero(heights > -reach)
    bottom = top = -math.inf
    step = max(1, REACHES // len(one.points))
    for start in range(0, len(near), step):
        some = near[start : start + step]
        normals, offsets = hull.normals[some], hull.offsets[some]
        radius = one.solid.radius
        top = max(top, float((one.support_heights(normals) + radius - offsets).max()))
        bottom = max(bottom, float((-one.support_heights(-normals) - radius - offsets).max()))
    return bottom, top


def _volume_inside(hull: WorldHull, cut: Sequence[PlacedSolid]) -> float:
    """How much of shapes' volumes is within a hull."""
    parts, weights = [], []
    for one in cut:
        surface = one.solid.closed_surface
        parts.append((surface.vertices @ one.matrix.T + one.position)[surface.faces])
        # A capsule has the volume of its polyhedron only nearly.
        weights.append(np.full(len(surface.faces), one.solid.volume / surface.volume))
    triangles = np.concatenate(parts)
    around = hull.triangles
    if not len(around):
        around = _below(hull, triangles.reshape(-1, 3))
    return common_volume(triangles, np.concatenate(weights), around)


def _below(hull: WorldHull, points: Array) -> Array:
    """The surface (12, 3, 3) of a cube in a half-space, with all that it has of points it cuts."""
    low, high = points.min(axis=0), points.max(axis=0)
    normal, middle = hull.normals[0], (low + high) / 2
    side = 2.0 * math.dist(low, high)
    along = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    along /= np.linalg.norm(along)
    frame = np.stack((along, np.cross(normal, along), normal))
    centre = middle - (middle @ normal - hull.offsets[0] + side / 2) * normal
    cube = solid_of(Geometry.primitive("box", (1, 1, 1)))
    triangles: Array = (side * cube.core @ frame + centre)[cube.faces]
    return triangles


# -- on the ground -----------------------------------------------------------------------------


def footprint(a: Sequence[PlacedSolid]) -> Array:
    """The corners (k, 2) of the convex hull of the shapes' shadows; of half-spaces not."""
    points = unique_points(_points(a)[:, :2])
    from scipy.spatial import ConvexHull, QhullError

    if len(points) < 4:
        return points
    try:
        corners: Array = points[ConvexHull(points).vertices]
    except QhullError:  # all in a line
        return points
    return corners


def is_over_footprint(a: Sequence[PlacedSolid], corners: Array, x: float, y: float) -> bool:
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
