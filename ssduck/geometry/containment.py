"""Computes volumes inside convex hulls, common volumes, and footprints of shapes on the ground."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import TypeAlias

import numpy as np

from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.broad_phase import Pairs, overlapping_pairs_across
from ssduck.geometry.placed_solid import PlacedSolid
from ssduck.geometry.shapes import Geometry
from ssduck.geometry.solids import Solid, hull_solid, solid_of
from ssduck.geometry.surfaces import unique_points

# Shapes that stick out of a hull by less are in it; those that stick into it by less are out, m.
ROUNDING = 1e-9
# Polyhedra stick out of the round shapes that they stand for by at most this, relative to the
# radius.
ROUND_SHAPE_ERROR = 0.002
# The number of pairs of a point and a direction that are compared at a time: 8 MB an array.
PAIRS_AT_ONCE = 1_000_000
# Triangles with a smaller projection, relative to their longest edge squared, are left out.
MIN_PROJECTION = 1e-13

# The lower corner and the upper one.
Box: TypeAlias = list[float]


@dataclass(frozen=True, eq=False)
class WorldHull:
    """The convex hull of shapes, in the world; it has a volume.

    Attributes:
        normals: (m, 3), the outward unit normals of the faces; none if it is all of space.
        offsets: (m,): x is inside if `normals @ x <= offsets`.
        triangles: (k, 3, 3), the surface, facing outward; none if it is unbounded.
    """

    normals: Array
    offsets: Array
    triangles: Array

    @property
    def is_everything(self) -> bool:
        """Whether it contains all points."""
        return not len(self.normals)


def world_hull(a: Sequence[PlacedSolid]) -> WorldHull | None:
    """Returns the convex hull of shapes; None if it has no volume.

    Polyhedra stand for round shapes; see `fraction_inside`.
    """
    planes = [placed for placed in a if placed.solid.type == "plane"]
    if not planes:
        solid = hull_solid(_hull_points(a))
        if solid.offsets is None:
            return None
        return WorldHull(solid.normals, solid.offsets, solid.core[solid.faces])
    unbounded = np.zeros((0, 3, 3))
    normal = planes[0].normals[0]
    if any(float(np.linalg.norm(normal - placed.normals[0])) > ROUNDING for placed in planes):
        return WorldHull(
            np.zeros((0, 3)), np.zeros(0), unbounded
        )  # half-spaces that differ in direction
    heights = [float(normal @ placed.position) for placed in planes]
    bodies = (placed for placed in a if placed.solid.type != "plane")
    heights += [
        float(placed.support_heights(normal[None])[0]) + placed.solid.radius for placed in bodies
    ]
    return WorldHull(normal[None], np.array([max(heights)]), unbounded)


def fraction_inside(hull: WorldHull | None, b: Sequence[PlacedSolid]) -> float | None:
    """Returns the fraction of the volume of some shapes inside a convex hull, 0..1.

    Exact for boxes, hulls and closed meshes. In the hull, and where the hull cuts them, polyhedra
    of about 1000 corners stand for balls, ellipsoids and the ends of capsules, and prisms with 64
    sides for cylinders, of the same volume. Their surfaces are off by at most 0.002 of the radius
    (of an ellipsoid, of the longest half length), fractions by at most 0.005 if the shapes are no
    thinner than half the radius of the round shapes in the
    hull. Overlapping shapes count more than once. An open mesh has no volume and does not count.
    """
    if any(placed.solid.type == "plane" for placed in b):
        return 1.0 if hull is not None and hull.is_everything else 0.0
    with_volume = [placed for placed in b if placed.solid.volume > 0.0]
    total = sum(placed.solid.volume for placed in with_volume)
    if not with_volume:
        return None
    if hull is None:
        return 0.0
    inside, crossing = 0.0, []
    for placed in with_volume:
        bottom, top = _height_range(hull, placed)
        if top <= ROUNDING:
            inside += placed.solid.volume
        elif bottom < -ROUNDING:
            crossing.append(placed)
    if crossing:
        inside += _volume_inside(hull, crossing)
    return min(1.0, max(0.0, inside / total))


def overlap_share(b: Sequence[PlacedSolid]) -> float:
    """Returns the sum of the common volumes of each two of some shapes, relative to that of all.

    So much may `fraction_inside` be off at most, which counts them twice.
    """
    with_volume = [placed for placed in b if 0.0 < placed.solid.volume < math.inf]
    if len(with_volume) < 2:
        return 0.0
    surfaces = [_closed_triangles(placed) for placed in with_volume]
    corners = [triangles.reshape(-1, 3) for triangles in surfaces]
    boxes = [(points.min(axis=0), points.max(axis=0)) for points in corners]
    overlap = 0.0
    for (first, (low, high)), (second, (lower, higher)) in combinations(
        zip(surfaces, boxes, strict=True), 2
    ):
        if (low < higher).all() and (lower < high).all():
            overlap += common_volume(first, np.ones(len(first)), second)
    return overlap / sum(placed.solid.volume for placed in with_volume)


def hull_bounds(a: Iterable[tuple[Solid, Box]]) -> Box:
    """Returns a box that contains the hull of shapes: by the solids, and the box of each."""
    boxes = np.array([_grow(solid, box) for solid, box in a]).reshape(-1, 6)
    low, high = boxes[:, :3].min(0, initial=math.inf), boxes[:, 3:].max(0, initial=-math.inf)
    corners: Box = [*low.tolist(), *high.tolist()]
    return corners


def max_fraction_in_box(hull_box: Box, b: Iterable[tuple[Solid, Box]]) -> float:
    """Returns an upper bound of `fraction_inside`, by the overlap of the boxes."""
    inside = total = 0.0
    for solid, box in b:
        grown, overlap_volume = _grow(solid, box), 1.0
        for k in range(3):
            overlap_volume *= max(
                min(hull_box[k + 3], grown[k + 3]) - max(hull_box[k], grown[k]), 0.0
            )
        inside += min(solid.volume, overlap_volume)
        total += solid.volume
    return inside / total


def _grow(solid: Solid, box: Box) -> Box:
    """Returns the box of the polyhedron that stands for a solid."""
    if solid.type == "plane":
        return [-math.inf] * 3 + [math.inf] * 3
    margin = ROUNDING + ROUND_SHAPE_ERROR * solid.largest_radius
    a, b, c, d, e, f = box
    return [a - margin, b - margin, c - margin, d + margin, e + margin, f + margin]


def _hull_points(a: Sequence[PlacedSolid]) -> Array:
    """Returns points in the world whose convex hull is that of the shapes."""
    bodies = [shape for shape in a if shape.solid.type != "plane"]
    placed = [shape.solid.points @ shape.matrix.T + shape.position for shape in bodies]
    return np.concatenate(placed) if placed else np.zeros((0, 3))


# -- in a hull ---------------------------------------------------------------------------------


def _height_range(hull: WorldHull, placed: PlacedSolid) -> tuple[float, float]:
    """Returns the greatest heights of a shape's lowest and highest points over a hull's faces."""
    # highest <= 0: inside; lowest > 0 over one face: outside. A sphere around it mostly decides.
    centre, bounding_radius = placed.to_world(*placed.solid.centre), placed.solid.bounding_radius
    heights = hull.normals @ centre - hull.offsets
    greatest = float(heights.max(initial=-math.inf))
    if abs(greatest) >= bounding_radius:
        return greatest - bounding_radius, greatest + bounding_radius
    faces = np.flatnonzero(heights > -bounding_radius)
    bottom = top = -math.inf
    step = max(1, PAIRS_AT_ONCE // len(placed.points))
    for start in range(0, len(faces), step):
        indices = faces[start : start + step]
        normals, offsets = hull.normals[indices], hull.offsets[indices]
        radius = placed.solid.radius
        top = max(top, float((placed.support_heights(normals) + radius - offsets).max()))
        bottom = max(bottom, float((-placed.support_heights(-normals) - radius - offsets).max()))
    return bottom, top


def _volume_inside(hull: WorldHull, crossing: Sequence[PlacedSolid]) -> float:
    parts, weights = [], []
    for placed in crossing:
        surface = placed.solid.closed_surface
        parts.append(_closed_triangles(placed))
        # The volume of a capsule differs slightly from that of its polyhedron.
        weights.append(np.full(len(surface.faces), placed.solid.volume / surface.volume))
    triangles = np.concatenate(parts)
    hull_box = hull.triangles
    if not len(hull_box):
        hull_box = _half_space_cube(hull, triangles.reshape(-1, 3))
    return common_volume(triangles, np.concatenate(weights), hull_box)


def _closed_triangles(placed: PlacedSolid) -> Array:
    """Returns the surface (n, 3, 3) of a shape, or of the polyhedron that stands for it."""
    surface = placed.solid.closed_surface
    triangles: Array = (surface.vertices @ placed.matrix.T + placed.position)[surface.faces]
    return triangles


def _half_space_cube(hull: WorldHull, points: Array) -> Array:
    """Returns the surface (12, 3, 3) of a cube: the part of a half-space around some points."""
    low, high = points.min(axis=0), points.max(axis=0)
    normal, middle = hull.normals[0], (low + high) / 2
    side = 2.0 * math.dist(low, high)
    tangent = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    tangent /= np.linalg.norm(tangent)
    frame = np.stack((tangent, np.cross(normal, tangent), normal))
    centre = middle - (middle @ normal - hull.offsets[0] + side / 2) * normal
    cube = solid_of(Geometry.primitive("box", (1, 1, 1)))
    triangles: Array = (side * cube.core @ frame + centre)[cube.faces]
    return triangles


# -- the common volume of two closed surfaces ---------------------------------------------------

# For two polyhedra it is a sum over pairs of faces, one of each. No corners of the intersection are
# searched for: the faces above a point tell whether it is inside.


def common_volume(surface: Array, weights: Array, other: Array) -> float:
    """Returns the common volume of two closed surfaces, m³.

    Let s be 1 for a triangle that faces up and -1 for one that faces down. The winding number of a
    surface around a point is the sum of s over its triangles above the point. So the volume is a
    sum over pairs of triangles, one of either surface: the product of their s, times the integral
    of the lower of their heights over the common part of their projections on the ground. The s of
    all triangles over a place of the ground add up to 0, so that all heights may be taken from the
    second triangle: only the part of the first that is below it counts. Every term is continuous in
    the corners, so that rounding decides nothing, even for coplanar faces.
    """
    centroid = surface.reshape(-1, 3).mean(axis=0)
    surface, other = surface - centroid, other - centroid
    areas, other_areas = _projected_areas(surface), _projected_areas(other)
    surface, weights = surface[areas != 0.0], weights[areas != 0.0]
    other, other_areas = other[other_areas != 0.0], other_areas[other_areas != 0.0]
    volume = 0.0
    for i, j in _overlapping_pairs(surface, other):
        volume += float(weights[i] @ _heights_below(surface[i], other[j], other_areas[j]))
    return volume


def _projected_areas(triangles: Array) -> Array:
    """Returns twice the areas of triangles' projections, (n,); negative if they face down."""
    first_edges, second_edges = (triangles[:, k, :2] - triangles[:, 0, :2] for k in (1, 2))
    areas: Array = first_edges[:, 0] * second_edges[:, 1] - first_edges[:, 1] * second_edges[:, 0]
    edges = triangles - np.roll(triangles, 1, axis=1)
    longest = np.einsum("nki,nki->nk", edges, edges).max(axis=1, initial=0.0)
    return np.where(np.abs(areas) > MIN_PROJECTION * longest, areas, 0.0)


def _overlapping_pairs(surface: Array, other: Array) -> Iterator[Pairs]:
    """Yields pairs of triangles with overlapping projections, if the first is not above."""
    low, high, lows, highs = (
        corner.T.copy()
        for triangles in (surface, other)
        for corner in (triangles.min(axis=1), triangles.max(axis=1))
    )
    high[2], lows[2] = math.inf, -math.inf
    return overlapping_pairs_across((low, high), (lows, highs), touching=False)


def _heights_below(first: Array, second: Array, areas: Array) -> Array:
    """Integrates the height of the first triangle below the second, for pairs (n, 3, 3)."""
    origin, edges = second[:, :1], second[:, 1:] - second[:, :1]
    # In the frame in which the projection of the second has the corners (0, 0), (1, 0), (0, 1).
    x, y = np.moveaxis((first - origin)[:, :, :2], 2, 0)
    (px, py), (qx, qy) = np.moveaxis(edges[:, :, :2], 0, 2)[:, :, :, None]
    u, v = x * qy - y * qx, y * px - x * py
    polygons = np.stack((u, v, first[:, :, 2]), axis=2)
    polygons[:, :, :2] /= areas[:, None, None]
    rows = np.arange(len(first))
    for side in ((1.0, 0.0), (0.0, 1.0), (-1.0, -1.0)):
        heights = polygons[:, :, :2] @ np.array(side) + (sum(side) < 0.0)
        polygons, indices = clip_polygons(polygons, heights)
        rows = rows[indices]
    plane_heights = (
        np.einsum("nki,ni->nk", polygons[:, :, :2], edges[rows, :, 2]) + origin[rows, :, 2]
    )
    polygons[:, :, 2] -= plane_heights
    polygons, indices = clip_polygons(polygons, -polygons[:, :, 2])
    rows = rows[indices]
    integrals = np.zeros(len(first))
    integrals[rows] = _integrals(polygons) * np.abs(areas[rows])
    return integrals


def clip_polygons(polygons: Array, heights: Array) -> tuple[Array, Indices]:
    """Clips convex polygons (n, k, d) to where heights (n, k), linear over each, are not < 0."""
    is_kept = heights >= 0.0
    is_crossed = is_kept != np.roll(is_kept, -1, axis=1)
    fraction = heights / np.where(is_crossed, heights - np.roll(heights, -1, axis=1), 1.0)
    crossings = polygons + fraction[:, :, None] * (np.roll(polygons, -1, axis=1) - polygons)
    count, k, d = polygons.shape
    corners = np.stack((polygons, crossings), axis=2).reshape(count, 2 * k, d)
    is_used = np.stack((is_kept, is_crossed), axis=2).reshape(count, 2 * k)
    corner_counts = is_used.sum(axis=1)
    rows = np.flatnonzero(corner_counts)
    order = np.argsort(~is_used[rows], axis=1, kind="stable")
    last = np.minimum(np.arange(corner_counts.max(initial=0)), corner_counts[rows, None] - 1)
    order = np.take_along_axis(order, last, axis=1)
    return np.take_along_axis(corners[rows], order[:, :, None], axis=1), rows


def _integrals(polygons: Array) -> Array:
    """Integrates the third coordinate of polygons (n, k, 3) over the plane of the other two."""
    start, first, second = polygons[:, :1], polygons[:, 1:-1], polygons[:, 2:]
    u, v = first - start, second - start
    areas = u[:, :, 0] * v[:, :, 1] - u[:, :, 1] * v[:, :, 0]
    heights = start[:, :, 2] + first[:, :, 2] + second[:, :, 2]
    integrals: Array = np.einsum("nk,nk->n", areas, heights) / 6.0
    return integrals


# -- on the ground -----------------------------------------------------------------------------


class Footprint:
    """The convex hull of the projections of some shapes on the ground.

    Args:
        shapes: the shapes.
    """

    def __init__(self, shapes: Sequence[PlacedSolid]) -> None:
        self._shapes = shapes

    @cached_property
    def _corners(self) -> Array:
        return footprint(self._shapes)

    def contains(self, x: float, y: float) -> bool:
        """Checks whether a point of the ground is in it, including its boundary."""
        return _is_over_plane(self._shapes, x, y) or is_in_polygon(self._corners, x, y)


def footprint(a: Sequence[PlacedSolid]) -> Array:
    """Returns the corners (k, 2) of the convex hull of the shapes' projections on the ground.

    Half-spaces are left out.
    """
    points = unique_points(_hull_points(a)[:, :2])
    from scipy.spatial import ConvexHull, QhullError

    if len(points) < 4:
        return points
    try:
        corners: Array = points[ConvexHull(points).vertices]
    except QhullError:  # all on one line
        return points
    return corners


def _is_over_plane(a: Sequence[PlacedSolid], x: float, y: float) -> bool:
    """Checks whether a point of the ground is in the projection of a half-space."""
    for placed in a:
        if placed.solid.type == "plane":
            nx, ny, nz = placed.normals[0].tolist()
            height = nx * (x - placed.position[0]) + ny * (y - placed.position[1])
            if abs(nz) > ROUNDING or height <= ROUNDING:
                return True
    return False


def is_in_polygon(corners: Array, x: float, y: float) -> bool:
    """Checks whether a point of the ground is in a convex polygon, including its boundary."""
    if not len(corners):
        return False
    if len(corners) < 3:
        return _is_between(corners[0], corners[-1], x, y)
    next_corners = np.roll(corners, -1, axis=0)
    dx, dy = (next_corners - corners).T
    offsets = dx * (y - corners[:, 1]) - dy * (x - corners[:, 0])
    doubled_area = float(dx @ corners[:, 1] - dy @ corners[:, 0])
    length = np.hypot(dx, dy)
    sign = -1.0 if doubled_area > 0 else 1.0
    if not np.any(np.abs(offsets) > ROUNDING * length):
        return _is_between(corners.min(axis=0), corners.max(axis=0), x, y)
    return bool((sign * offsets >= -ROUNDING * length).all())


def _is_between(p: Array, q: Array, x: float, y: float) -> bool:
    """Checks whether a point is on a segment."""
    direct = math.dist(p, q)
    return math.dist(p, (x, y)) + math.dist((x, y), q) <= direct + ROUNDING
