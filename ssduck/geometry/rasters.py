"""Finds the cells of a raster that shapes occupy between two heights.

Let S be a convex solid and a <= x <= b a strip of cells. The part of S in the strip and between the
heights is convex, so that its projection on the y axis is one interval: S occupies exactly the
cells that overlap it. The ends of the interval are on the surface of S, because the strip and the
heights do not bound y. So a polyhedron is computed from the edges of its faces, cut at the two
heights. A sphere has a formula. For a cylinder the ends are among a few points where enough of its
bounds intersect, for an ellipsoid on its sections by these bounds. A capsule is a cylinder and two
spheres. A surface is computed triangle by triangle. A closed mesh is its surface, and the cells
that it winds around.

A solid occupies a cell if it reaches into it by more than `CELL_TOLERANCE`. One that only touches a
cell leaves it free. A shape without an inside (an open mesh, a flat hull) occupies every cell that
it touches.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array, Flags, Indices, ranges
from ssduck.geometry.containment import clip_polygons
from ssduck.geometry.solids import PlacedSolids, Solid

# The number of pairs of an edge and a strip that are processed at a time.
PAIRS_AT_ONCE = 2_000_000
# Points that are nearer to the boundary of a cell are on it, m.
CELL_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Raster:
    """Square cells over a part of the xy plane.

    Attributes:
        origin: x and y of the lower corner, m.
        size: the side of a cell, m.
        shape: the number of cells along x and along y.
    """

    origin: tuple[float, float]
    size: float
    shape: tuple[int, int]

    def centres(self, axis: int) -> Array:
        """Returns the coordinates of the cells' centres along x (0) or y (1).

        >>> Raster((0.0, 0.0), 0.5, (3, 2)).centres(0).tolist()
        [0.25, 0.75, 1.25]
        """
        steps: Array = np.arange(self.shape[axis], dtype=np.float64) + 0.5
        return self.origin[axis] + steps * self.size

    def overlapped_cells(
        self, low: Array, high: Array, min_overlap: float, axis: int
    ) -> tuple[Indices, Indices]:
        """Returns the first and the last cell along an axis that intervals overlap."""
        start, count = self.origin[axis], self.shape[axis]
        first = np.floor((low + min_overlap - start) / self.size)
        last = np.ceil((high - min_overlap - start) / self.size) - 1
        return (
            np.clip(first, 0, count).astype(np.intp),
            np.clip(last, -1, count - 1).astype(np.intp),
        )


@dataclass(frozen=True, eq=False)
class StripIntervals:
    """Intervals along y in strips of cells.

    Attributes:
        strips: (n,), the indices of the strips.
        low: (n,), the starts of the intervals.
        high: (n,), their ends.
        min_overlap: the length by which an interval has to extend into a cell, m.
    """

    strips: Indices
    low: Array
    high: Array
    min_overlap: float

    def count(self, raster: Raster, changes: npt.NDArray[np.int32]) -> None:
        """Adds 1 at the first cell of each interval, and -1 behind its last cell."""
        first, last = raster.overlapped_cells(self.low, self.high, self.min_overlap, 1)
        is_overlapping = first <= last
        strips = self.strips[is_overlapping]
        np.add.at(changes, (strips, first[is_overlapping]), 1)
        np.add.at(changes, (strips, last[is_overlapping] + 1), -1)


class Rasterizer:
    """Shapes that are rasterized at any number of heights.

    >>> from ssduck.geometry.shapes import Geometry
    >>> from ssduck.geometry.solids import solid_of
    >>> cube = solid_of(Geometry.primitive("box", (1, 1, 1)))
    >>> placed = PlacedSolids(
    ...     [cube], np.zeros((1, 3)), np.eye(3)[None], np.zeros((1, 6)), np.zeros(1, np.intp)
    ... )
    >>> cells = Rasterizer(placed).cells(Raster((-1.0, -1.0), 0.5, (4, 4)), 0.0, 0.1)
    >>> int(cells.sum())
    4

    Args:
        placed: the shapes; all of them known.
    """

    def __init__(self, placed: PlacedSolids) -> None:
        triangles: list[Array] = [np.zeros((0, 3, 3))]
        groups: list[Indices] = [np.zeros(0, np.intp)]
        thin: list[Flags] = [np.zeros(0, bool)]
        count = 0
        self._round: list[RoundShape | Ellipsoid] = []
        self._meshes: list[Array] = []
        self._planes: list[tuple[Array, float]] = []
        for solid, position, matrix in placed:
            if solid.type == "plane":
                normal = matrix @ solid.normals[0]
                self._planes.append((normal, float(normal @ position)))
            elif solid.largest_radius:
                self._round += round_parts(solid, position, matrix)
            elif len(solid.core):
                surface = solid.surface
                corners = (surface.vertices @ matrix.T + position)[surface.faces]
                separate_groups = np.arange(len(corners)) if not _is_solid_hull(solid) else 0
                groups.append(np.zeros(len(corners), np.intp) + separate_groups + count)
                count = int(groups[-1][-1]) + 1
                triangles.append(corners)
                thin.append(np.full(len(corners), solid.volume == 0.0))
                if solid.type == "mesh" and solid.is_closed:
                    self._meshes.append(corners)
        self._triangles = np.concatenate(triangles)
        self._groups = np.concatenate(groups)
        self._thin = np.concatenate(thin)
        heights = self._triangles[:, :, 2]
        self._low, self._high = heights.min(axis=1), heights.max(axis=1)

    def cells(
        self, raster: Raster, low: float, high: float, *, min_overlap: float = -CELL_TOLERANCE
    ) -> npt.NDArray[np.bool_]:
        """Returns the cells that the shapes occupy anywhere between two heights."""
        changes = np.zeros((raster.shape[0], raster.shape[1] + 1), dtype=np.int32)
        for intervals in self._intervals(raster, low, high, min_overlap):
            intervals.count(raster, changes)
        occupied = np.cumsum(changes, axis=1, out=changes)[:, :-1] > 0
        if low + min_overlap <= high - min_overlap:
            for corners in self._meshes:
                _fill_interior(raster, corners, (low + high) / 2, occupied)
            for normal, offset in self._planes:
                _add_half_space(
                    raster, normal, offset, (low + min_overlap, high - min_overlap), occupied
                )
        return occupied

    def _intervals(
        self, raster: Raster, low: float, high: float, min_overlap: float
    ) -> Iterator[StripIntervals]:
        for shape in self._round:
            intervals = shape.intervals(raster, low + min_overlap, high - min_overlap)
            if intervals is not None:
                yield intervals
        for thin in (False, True):
            margin = -CELL_TOLERANCE if thin else min_overlap
            bottom, top = low + margin, high - margin
            selected = np.flatnonzero(
                (self._low <= top) & (self._high >= bottom) & (self._thin == thin)
            )
            if len(selected) and bottom <= top:
                polygons, rows = clip_polygons(
                    self._triangles[selected], self._triangles[selected][:, :, 2] - bottom
                )
                polygons, kept = clip_polygons(polygons, top - polygons[:, :, 2])
                groups = self._groups[selected[rows[kept]]]
                yield from _polygon_intervals(
                    raster, polygons, groups, -CELL_TOLERANCE if thin else CELL_TOLERANCE
                )


def _is_solid_hull(solid: Solid) -> bool:
    return solid.is_convex and solid.volume > 0.0


# -- polyhedra and surfaces -----------------------------------------------------------------------


def _polygon_intervals(
    raster: Raster, polygons: Array, groups: Indices, min_overlap: float
) -> Iterator[StripIntervals]:
    """Yields the intervals of sets of convex polygons (n, k, 3); `groups` are their sets."""
    if not len(polygons):
        return
    order = np.argsort(groups, kind="stable")
    polygons, groups = polygons[order, :, :2], groups[order]
    start, end = polygons, np.roll(polygons, -1, axis=1)
    is_edge = (start != end).any(axis=2)
    is_edge[:, 0] = True  # of a point
    start, end = start[is_edge], end[is_edge]
    owners = np.repeat(groups, is_edge.sum(axis=1))
    left, right = np.minimum(start[:, 0], end[:, 0]), np.maximum(start[:, 0], end[:, 0])
    first, last = raster.overlapped_cells(left, right, min_overlap, 0)
    counts = np.maximum(last - first + 1, 0)
    for part in _batches(owners, counts):
        edges, strips = ranges(first[part], counts[part])
        edges += part.start
        if not len(strips):
            continue
        low, high = _y_ranges(raster, start[edges], end[edges], strips, min_overlap)
        keys = (owners[edges] - owners[edges[0]]) * raster.shape[0] + strips
        order = np.argsort(keys, kind="stable")
        keys, begin = np.unique(keys[order], return_index=True)
        yield StripIntervals(
            keys % raster.shape[0],
            np.minimum.reduceat(low[order], begin),
            np.maximum.reduceat(high[order], begin),
            min_overlap,
        )


def _batches(owners: Indices, counts: Indices) -> Iterator[slice]:
    """Returns ranges of edges with about `PAIRS_AT_ONCE` strips, each set of edges in one range."""
    begins = np.flatnonzero(np.diff(owners, prepend=-1))
    total = np.cumsum(counts)
    batch = total[begins] // PAIRS_AT_ONCE
    cuts = begins[np.flatnonzero(np.diff(batch, prepend=-1))].tolist()
    for first, stop in itertools.pairwise([*cuts, len(owners)]):
        yield slice(first, stop)


def _y_ranges(
    raster: Raster, start: Array, end: Array, strips: Indices, min_overlap: float
) -> tuple[Array, Array]:
    """Returns the least and the greatest y of edges (n, 2) in strips (n,) that they reach."""
    side = raster.origin[0] + strips * raster.size
    widths = end[:, 0] - start[:, 0]
    is_across = widths == 0.0
    slope = np.where(is_across, 1.0, widths)
    ends = [
        start[:, 1] + np.clip((x - start[:, 0]) / slope, 0.0, 1.0) * (end[:, 1] - start[:, 1])
        for x in (side + min_overlap, side + raster.size - min_overlap)
    ]
    ends[0][is_across], ends[1][is_across] = start[is_across, 1], end[is_across, 1]
    return np.minimum(*ends), np.maximum(*ends)


def _fill_interior(raster: Raster, corners: Array, height: float, occupied: Flags) -> None:
    """Occupies the cells whose centres a closed surface winds around at a height."""
    above = corners[:, :, 2] > height
    corners = corners[above.any(axis=1) & ~above.all(axis=1)]
    above = corners[:, :, 2] > height
    rows = np.arange(len(corners))
    crossings = []
    for rising in (True, False):
        # the edge behind corner k goes up, or down, through the height
        is_next_above = np.roll(above, -1, axis=1)
        k = ((~above & is_next_above) if rising else (above & ~is_next_above)).argmax(axis=1)
        starts, ends = corners[rows, k], corners[rows, (k + 1) % 3]
        lower, upper = (starts, ends) if rising else (ends, starts)
        fraction = (height - lower[:, 2]) / (upper[:, 2] - lower[:, 2])
        crossings.append(lower[:, :2] + fraction[:, None] * (upper[:, :2] - lower[:, :2]))
    up, down = crossings
    sign = np.where(down[:, 0] > up[:, 0], 1, -1)  # seen from within, y runs out of it, or in
    left, right = np.minimum(up[:, 0], down[:, 0]), np.maximum(up[:, 0], down[:, 0])
    # strips with left <= centre < right
    centre = raster.origin[0] + raster.size / 2
    first = np.clip(np.ceil((left - centre) / raster.size), 0, raster.shape[0]).astype(np.intp)
    stop = np.clip(np.ceil((right - centre) / raster.size), 0, raster.shape[0]).astype(np.intp)
    counts = np.maximum(stop - first, 0)
    edges, strips = ranges(first, counts)
    if not len(strips):
        return
    begin, vectors = up[edges], down[edges] - up[edges]
    fraction = (centre + strips * raster.size - begin[:, 0]) / vectors[:, 0]
    y = begin[:, 1] + fraction * vectors[:, 1]
    below = np.ceil((y - raster.origin[1]) / raster.size - 0.5)
    below = np.clip(below, 0, raster.shape[1]).astype(np.intp)
    window = slice(int(strips.min()), int(strips.max()) + 1), slice(0, int(below.max(initial=0)))
    winding_changes = np.zeros(
        (window[0].stop - window[0].start, window[1].stop + 1), dtype=np.int32
    )
    np.add.at(winding_changes, (strips - window[0].start, below), sign[edges])
    winding = winding_changes[:, ::-1].cumsum(axis=1)[:, ::-1][:, 1:]
    occupied[window] |= winding > 0


def _add_half_space(
    raster: Raster, normal: Array, offset: float, heights: tuple[float, float], occupied: Flags
) -> None:
    """Occupies the cells that a half-space `normal @ x <= offset` reaches into."""
    lowest = min(normal[2] * height for height in heights)
    sums = [np.zeros(0), np.zeros(0)]
    for axis in (0, 1):
        starts = raster.origin[axis] + np.arange(raster.shape[axis]) * raster.size + CELL_TOLERANCE
        sums[axis] = np.minimum(normal[axis] * starts, normal[axis] * (starts + raster.size - 2e-9))
    occupied |= sums[0][:, None] + sums[1] + lowest <= offset


# -- round shapes, by formulas --------------------------------------------------------------------


# The greatest error of computed points, m.
_POINT_ERROR = 1e-10


# Returns the least and the greatest y of a shape in strips from left to right, between two heights.
_Bounds: TypeAlias = Callable[[Array, Array, float, float], tuple[Array, Array]]


def _intervals(
    raster: Raster,
    centre: Array,
    extents: Array,
    low: float,
    high: float,
    bounds: _Bounds,
    min_overlap: float = CELL_TOLERANCE,
) -> StripIntervals | None:
    """Returns the intervals of a shape with a box around its centre; None without any."""
    start, end = centre - extents, centre + extents
    if start[2] > high or end[2] < low or low > high:
        return None
    first, last = raster.overlapped_cells(start[:1], end[:1], min_overlap, 0)
    strips = np.arange(first[0], last[0] + 1)
    left = raster.origin[0] + strips * raster.size + min_overlap
    bottom, top = bounds(left, left + raster.size - 2 * min_overlap, low, high)
    is_reached = bottom <= top
    return StripIntervals(strips[is_reached], bottom[is_reached], top[is_reached], min_overlap)


@dataclass(frozen=True, eq=False)
class RoundShape:
    """A sphere, or a cylinder along its frame's z.

    Attributes:
        radius: m.
        half: half the length of a cylinder; negative for a sphere.
        position: (3,).
        matrix: (3, 3).
    """

    radius: float
    half: float
    position: Array
    matrix: Array

    def intervals(self, raster: Raster, low: float, high: float) -> StripIntervals | None:
        """Returns the occupied intervals of strips between two heights; None without any."""
        if self.half < 0.0:
            box = self.position, np.full(3, self.radius)
            return _intervals(raster, *box, low, high, self._sphere_bounds)
        across = np.hypot(self.matrix[:, 0], self.matrix[:, 1])
        extents = self.radius * across + abs(self.matrix[:, 2]) * self.half
        min_overlap = -CELL_TOLERANCE if self.half == 0.0 else CELL_TOLERANCE
        bounds = self._cylinder_bounds
        return _intervals(raster, self.position, extents, low, high, bounds, min_overlap)

    def _sphere_bounds(
        self, left: Array, right: Array, low: float, high: float
    ) -> tuple[Array, Array]:
        x, y, z = self.position
        offset_x = x - np.clip(x, left, right)
        squared = self.radius**2 - offset_x**2 - (z - np.clip(z, low, high)) ** 2
        half_width = np.where(squared >= 0.0, np.sqrt(np.maximum(squared, 0.0)), -np.inf)
        return y - half_width, y + half_width

    def _cylinder_bounds(
        self, left: Array, right: Array, low: float, high: float
    ) -> tuple[Array, Array]:
        """Returns the least and the greatest y of points of the cylinder, in strips (n,)."""
        (x, y, z), count = self.position, len(left)
        axis = np.array([0.0, 0.0, 1.0])
        repeat = np.broadcast_to
        pairs = (
            (axis, [repeat(-self.half, count), repeat(self.half, count)]),
            (self.matrix[0], [left - x, right - x]),
            (self.matrix[2], [repeat(low - z, count), repeat(high - z, count)]),
        )
        points = [np.zeros((count, 0, 3))]
        points += [_corners(pairs)]
        points += [self._on_lines(*two_pairs) for two_pairs in itertools.combinations(pairs, 2)]
        points += [self._on_ellipses(*pair) for pair in pairs]
        candidates = np.concatenate(points, axis=1)
        is_valid = np.hypot(candidates[:, :, 0], candidates[:, :, 1]) <= self.radius + _POINT_ERROR
        for normal, (lower, upper) in pairs:
            values = candidates @ normal
            is_valid &= (values >= lower[:, None] - _POINT_ERROR) & (
                values <= upper[:, None] + _POINT_ERROR
            )
        values = candidates @ self.matrix[1] + y
        return (
            np.where(is_valid, values, np.inf).min(axis=1, initial=np.inf),
            np.where(is_valid, values, -np.inf).max(axis=1, initial=-np.inf),
        )

    def _on_lines(self, one: tuple[Array, list[Array]], two: tuple[Array, list[Array]]) -> Array:
        """Returns the points where lines of two planes intersect the side: (n, 8, 3) at most."""
        direction = np.cross(one[0], two[0])
        squared_length = float(direction @ direction)
        horizontal = float(direction[:2] @ direction[:2])
        first, second = np.cross(two[0], direction), np.cross(direction, one[0])
        points = []
        if horizontal > 1e-24:
            for c, d in itertools.product(one[1], two[1]):
                base = (np.outer(c, first) + np.outer(d, second)) / squared_length
                nearest = -(base[:, :2] @ direction[:2]) / horizontal
                base = base + nearest[:, None] * direction
                squared = self.radius**2 - np.einsum("ni,ni->n", base[:, :2], base[:, :2])
                half_chord = np.sqrt(np.where(squared >= 0.0, squared, np.nan) / horizontal)
                step = half_chord[:, None] * direction
                points += [base - step, base + step]
        return np.stack(points, axis=1) if points else np.zeros((len(one[1][0]), 0, 3))

    def _on_ellipses(self, normal: Array, offsets: list[Array]) -> Array:
        """Returns the points of extreme y where planes cut the round side: (n, 4, 3) at most."""
        if abs(normal[2]) < 1e-12:
            return np.zeros((len(offsets[0]), 0, 3))
        steep = self.matrix[1] - self.matrix[1, 2] / normal[2] * normal
        length = float(np.hypot(steep[0], steep[1]))
        offset_xy = (
            steep[:2] * (self.radius / length) if length > 1e-12 else np.array([self.radius, 0])
        )
        points = []
        for offset, side in itertools.product(offsets, (offset_xy, -offset_xy)):
            height = (offset - normal[:2] @ side) / normal[2]
            points.append(np.column_stack((np.tile(side, (len(height), 1)), height)))
        return np.stack(points, axis=1)


def _corners(pairs: tuple[tuple[Array, list[Array]], ...]) -> Array:
    """Returns the intersections of three planes, one of each pair: (n, 8, 3) or (n, 0, 3)."""
    normals = np.array([normal for normal, _ in pairs])
    if abs(np.linalg.det(normals)) < 1e-12:
        return np.zeros((len(pairs[0][1][0]), 0, 3))
    inverse = np.linalg.inv(normals)
    offsets = [np.stack(planes, axis=1) for planes in itertools.product(*(c for _, c in pairs))]
    corners: Array = np.stack(offsets, axis=1) @ inverse.T
    return corners


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """An ellipsoid: all p + C u with a position p, where u C u <= 1.

    Attributes:
        position: (3,).
        covariance: (3, 3), C; the extent in a unit direction n is the root of n C n.
    """

    position: Array
    covariance: Array

    def intervals(self, raster: Raster, low: float, high: float) -> StripIntervals | None:
        """Returns the occupied intervals of strips between two heights; None without any."""
        extents = np.sqrt(np.diagonal(self.covariance))
        return _intervals(raster, self.position, extents, low, high, self._bounds)

    def _bounds(self, left: Array, right: Array, low: float, high: float) -> tuple[Array, Array]:
        (x, y, z), count = self.position, len(left)
        box = left - x, right - x, np.full(count, low - z), np.full(count, high - z)
        # The other end is that of the mirrored ellipsoid in the mirrored strip.
        return y - self._greatest(-box[1], -box[0], -box[3], -box[2]), y + self._greatest(*box)

    def _greatest(self, left: Array, right: Array, low: Array, high: Array) -> Array:
        """Returns the greatest y of points in rectangles of x and z, (n,); -inf if none."""
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = self.covariance
        extent = np.sqrt(yy)
        x, z = np.full(len(left), xy / extent), np.full(len(left), yz / extent)
        is_inside = (left <= x) & (x <= right) & (low <= z) & (z <= high)
        places = [(x, np.where(is_inside, z, np.nan))]
        for side in (left, right):
            z = _place_in_section(side, xx, (xy, xz), (yy, yz))
            places.append((side, np.clip(z, low, high)))
        for side in (low, high):
            x = _place_in_section(side, zz, (yz, xz), (yy, xy))
            places.append((np.clip(x, left, right), side))
        tops = np.stack([self._height_over(x, z) for x, z in places])
        greatest: Array = np.where(np.isnan(tops), -np.inf, tops).max(axis=0)
        return greatest

    def _height_over(self, x: Array, z: Array) -> Array:
        """Returns the greatest y over points of the xz plane, from the centre; NaN outside."""
        ground = self.covariance[np.ix_([0, 2], [0, 2])]
        slope = np.linalg.solve(ground, self.covariance[[0, 2], 1])
        rest = self.covariance[1, 1] - slope @ self.covariance[[0, 2], 1]
        points = np.stack((x, z))
        squared = 1.0 - (points * np.linalg.solve(ground, points)).sum(axis=0)
        heights: Array = slope @ points
        heights += np.sqrt(np.where(squared >= 0.0, squared, np.nan) * rest)
        return heights


def _place_in_section(
    side: Array, variance: float, shared: tuple[float, float], rest: tuple[float, float]
) -> Array:
    """Returns the w where sections u = side of an ellipsoid have their greatest v, (n,); or NaN."""
    (uv, uw), (vv, vw) = shared, rest
    squared = 1.0 - side * side / variance
    width = np.sqrt(np.where(squared >= 0.0, squared, np.nan) / (vv - uv * uv / variance))
    place: Array = side * (uw / variance) + (vw - uv * uw / variance) * width
    return place


def round_parts(solid: Solid, position: Array, matrix: Array) -> Sequence[RoundShape | Ellipsoid]:
    """Returns the spheres, cylinders and ellipsoids that make up a round shape."""
    if solid.type == "ellipsoid":
        axes = matrix * solid.semi_axes
        return [Ellipsoid(position, axes @ axes.T)]
    if solid.type == "cylinder":
        return [RoundShape(solid.disc_radius, solid.half_length, position, matrix)]
    parts = [
        RoundShape(solid.radius, -1.0, matrix @ point + position, matrix) for point in solid.core
    ]
    if solid.type == "capsule":
        parts.append(RoundShape(solid.radius, solid.half_length, position, matrix))
    return parts
