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
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array, Flags, Indices, ranges
from ssduck.geometry.common_volume import clip_polygons
from ssduck.geometry.rasters.raster import CELL_TOLERANCE, Raster, StripIntervals
from ssduck.geometry.rasters.rasterize_round import Ellipsoid, RoundShape, round_parts
from ssduck.geometry.solids import PlacedSolids, Solid

# The number of pairs of an edge and a strip that are processed at a time.
PAIRS_AT_ONCE = 2_000_000


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
