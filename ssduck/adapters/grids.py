"""Defines the grid result forms: occupied cells, sensor coverage, values summed over a plane."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ssduck import validation
from ssduck.adapters.base import SHAPES, Selection, form, placed_shapes, shapes_of
from ssduck.adapters.grid_values import MAX_CELLS, OccupancyGrid, PlaneGrid, SensorGrid, VoxelGrid
from ssduck.errors import ArgumentError
from ssduck.formatting import short_repr
from ssduck.geometry.arrays import Array
from ssduck.geometry.poses import rotation_matrices
from ssduck.geometry.rasters import CELL_TOLERANCE, Raster, Rasterizer
from ssduck.geometry.ray_casting import are_blocked
from ssduck.geometry.solids import PlacedSolids
from ssduck.language import ast
from ssduck.simulators.sensor_types import SENSOR_TYPES
from ssduck.world.entities import Sensor
from ssduck.world.handles import Handle

# The number of cells that are made in a second on a slow machine, and the memory of each meanwhile.
CELLS_PER_SECOND, CELL_BYTES = 10_000_000, 25
# The number of cells whose visibility is computed at a time.
_BATCH = 1_000_000
# Default bounds are rounded outward to multiples of this, m, as in the tutorial.
_BOUNDS_STEP = 0.01
# Rounding ignores an excess of less than this share of a step or a cell.
_TOLERANCE = 1e-6
_PLANES = {"XY": (0, 1), "XZ": (0, 2), "YZ": (1, 2)}


# -- occupied cells ------------------------------------------------------------------------------


@form(
    "occupancygrid",
    "map",
    help="The grid of cells that shapes occupy at a height, or between two heights [lowest, "
    "highest]; all lengths in m.",
    needs="entities",
    tables=SHAPES,
)
def _occupancy(
    selection: Selection, z_pos: Any, grid_size: Any, bounds: Any = None
) -> OccupancyGrid:
    heights = z_pos if isinstance(z_pos, list | tuple) else [z_pos, z_pos]
    validation.sequence(heights, 2, "z_pos is a height or [lowest, highest]")
    low, high = (validation.number(height, "z_pos") for height in heights)
    if low > high:
        raise ArgumentError(f"z_pos: the lowest height {low:g} is above the highest, {high:g}")
    return _occupied_cells(selection, (low, high), grid_size, bounds)


@form(
    "roombaGrid",
    help="The grid of AS occupancygrid with the sizes of SelectScript's tutorial, in m, and one "
    "more cell along each axis.",
    needs="entities",
    tables=SHAPES,
)
def _roomba_grid(selection: Selection, z_pos: Any = 0.22, grid_size: Any = 0.025) -> OccupancyGrid:
    z = validation.number(z_pos, "z_pos")
    # The tutorial requests one cell more than the bounds have.
    return _occupied_cells(selection, (z, z), grid_size, None, more=1)


def _occupied_cells(
    selection: Selection, heights: tuple[float, float], grid_size: Any, bounds: Any, more: int = 0
) -> OccupancyGrid:
    size = validation.length(grid_size, "the size of a cell")
    placed = shapes_of(selection)
    raster = _raster(selection, bounds, placed, size, more)
    cells = Rasterizer(placed).cells(raster, *heights)
    z = heights[0] if heights[0] == heights[1] else heights
    return OccupancyGrid(cells, raster.origin, raster.size, z)


@form("voxelgrid", needs="entities", tables=SHAPES)
def _voxels(selection: Selection, grid_size: Any, bounds: Any = None) -> VoxelGrid:
    """The grid of cubes that shapes occupy; all lengths in m."""
    size = validation.length(grid_size, "the size of a cell")
    placed = shapes_of(selection)
    lower, upper = _bounds(bounds, placed, 3)
    nx, ny, nz = _counts(selection, lower, upper, size)
    raster, rasterizer = Raster((lower[0], lower[1]), size, (nx, ny)), Rasterizer(placed)
    cells = np.zeros((nx, ny, nz), dtype=bool)
    for layer in range(nz):
        selection.check_time()
        ground = lower[2] + layer * size
        cells[:, :, layer] = rasterizer.cells(
            raster, ground, ground + size, min_overlap=CELL_TOLERANCE
        )
    return VoxelGrid(cells, lower, size)


# -- sensor coverage ------------------------------------------------------------------------------


@form(
    "sensorgrid",
    help="The grid of the number of selected sensors that see each cell at a height; all lengths "
    "in m.",
    needs="entities",
    tables=SHAPES,
)
def _sensor_grid(
    selection: Selection, z_pos: Any, grid_size: Any, bounds: Any = None
) -> SensorGrid:
    z, size = validation.number(z_pos, "z_pos"), validation.length(grid_size, "the size of a cell")
    sensors = [entity for entity in selection.entities if isinstance(entity, Sensor)]
    if not sensors and selection.entities:
        raise ArgumentError("no sensor is selected; WHERE isSensor(this) selects them all")
    world = selection.world
    placed = placed_shapes(world, [e for e in world if not isinstance(e, Sensor)])
    bounded = placed.select(np.asarray(np.isfinite(placed.boxes).all(axis=1)))
    raster = _raster(selection, bounds, bounded, size)
    nx, ny = raster.shape
    cells = np.zeros((nx, ny), dtype=np.int32)
    columns = max(1, _BATCH // ny)
    for first in range(0, nx, columns):
        batch = slice(first, first + columns)
        x, y = np.meshgrid(raster.centres(0)[batch], raster.centres(1), indexing="ij")
        points = np.stack((x.ravel(), y.ravel(), np.full(x.size, z)), axis=1)
        for sensor in sensors:
            selection.check_time()
            cells[batch].reshape(-1)[_visible_points(sensor, placed, points, size / 2)] += 1
    return SensorGrid(cells, raster.origin, size, z, tuple(sensor.name for sensor in sensors))


def _visible_points(sensor: Sensor, placed: PlacedSolids, points: Array, tolerance: float) -> Any:
    """Returns the indices of the points (n, 3) that a sensor sees."""
    spec = sensor.spec
    view = SENSOR_TYPES[spec.type].view
    if view is None or not sensor.powered:
        return []
    start, orientation = np.array(sensor.position), np.array([sensor.orientation])
    if not np.isfinite(np.concatenate((start, orientation[0]))).all():
        raise ArgumentError(f"{sensor.name!r}: the pose is not a number")
    matrix = rotation_matrices(orientation)[0]
    inside = np.flatnonzero(
        view((points - start) @ matrix, spec.max_range, spec.settings, tolerance)
    )
    others = placed.select(placed.owners != sensor.host)
    return inside[~are_blocked(others, start, points[inside])]


# -- values over a plane --------------------------------------------------------------------------


def _with_entity(query: ast.Query) -> ast.Query:
    """Adds the entity of the only source as a column; its position selects the cell."""
    if len(query.sources) != 1 or not query.items or any(map(_is_entity, query.items)):
        return query
    span = query.span
    alias = query.sources[0].alias
    entity = ast.Call(span, "obj", (ast.This(span, alias),), span)
    return replace(query, items=(*query.items, entity))


def _is_entity(item: Any) -> bool:
    return isinstance(item, ast.This) or (
        isinstance(item, ast.Name | ast.UnresolvedName | ast.Call) and item.name == "obj"
    )


@form(
    "plane",
    help="The grid of the sums of the rows' values in each cell of a plane such as 'XY', by "
    "position; size is [cells, cells, side of a cell in m].",
    needs="entities",
    select=_with_entity,
)
def _plane(selection: Selection, axes: Any, origin: Any, size: Any, blur: Any = 1) -> PlaneGrid:
    plane = axes.upper() if isinstance(axes, str) else ""
    if plane not in _PLANES:
        raise ArgumentError(f"axes are 'XY', 'XZ' or 'YZ', not {short_repr(axes)}")
    lower = np.array(validation.number_list(origin, 2, "origin", "[first, second]"))
    *counts, side = validation.number_list(
        size, 3, "size", "[cells along first, along second, m a cell]"
    )
    side = validation.length(side, "the size of a cell")
    if any(count < 1 or count != int(count) for count in counts):
        raise ArgumentError(f"size: the numbers of cells must be whole, not {short_repr(size)}")
    nx, ny = map(int, counts)
    validation.integer_between(blur, "blur", 1, max(nx, ny))
    _check_count(selection, (nx + 2 * blur, ny + 2 * blur))
    weights = _pyramid(blur)
    cells = np.zeros((nx + 2 * blur, ny + 2 * blur))
    for entity, value in _entity_values(selection):
        selection.check_time()
        steps = (np.array(_finite_position(entity))[list(_PLANES[plane])] - lower) / side
        if ((steps >= 0) & (steps < (nx, ny))).all():
            i, j = steps.astype(np.intp) + blur
            window = slice(i - blur + 1, i + blur), slice(j - blur + 1, j + blur)
            cells[window] += value * weights
    return PlaneGrid(cells[blur:-blur, blur:-blur].copy(), tuple(lower.tolist()), side, plane)


def _pyramid(blur: int) -> Array:
    """Returns weights (2 blur - 1, 2 blur - 1) that decrease from the middle; their sum is 1."""
    steps = np.abs(np.arange(1 - blur, blur))
    weights: Array = np.maximum(1.0 + blur - steps[:, None] - steps, 0.0)
    weights /= weights.sum()
    return weights


def _entity_values(selection: Selection) -> list[tuple[Handle, float]]:
    """Returns the entity of each row and the sum of the numbers of the row."""
    names = selection.columns
    entity_values = []
    for row in selection.rows:
        entities = [value for value in row if isinstance(value, Handle)]
        if not entities:
            raise ArgumentError(
                "a row has no entity, whose position selects the cell of its values"
            )
        values = [
            _sum(value, name)
            for name, value in zip(names, row, strict=True)
            if not isinstance(value, Handle)
        ]
        if not values:
            raise ArgumentError(
                "no column has a number to sum in each cell; select one, the mass for example"
            )
        entity_values.append((entities[0], math.fsum(values)))
    return entity_values


def _sum(value: Any, name: str) -> float:
    """Returns a number or the sum of a list of numbers; NULL counts as 0."""
    if value is None:
        return 0.0
    if isinstance(value, list | tuple):
        return math.fsum(_sum(part, name) for part in value)
    if isinstance(value, int | float | np.number):
        return float(value)
    raise ArgumentError(f"column {name!r} cannot be summed: {short_repr(value)} is no number")


# -- bounds ---------------------------------------------------------------------------------------


def _raster(
    selection: Selection, bounds: Any, placed: PlacedSolids, size: float, more: int = 0
) -> Raster:
    """Returns the cells of bounds in the plane, and some more at their upper sides."""
    lower, upper = _bounds(bounds, placed, 2)
    nx, ny = _counts(selection, lower, upper, size)
    return Raster((lower[0], lower[1]), size, (nx + more, ny + more))


def _bounds(
    bounds: Any, placed: PlacedSolids, count: int
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Returns the corners of the bounds; by default those of the shapes, rounded outward."""
    if bounds is not None:
        return _given_bounds(bounds, count)
    if not len(placed):
        raise ArgumentError("no selected entity has shapes; give bounds for an empty grid")
    low, high = placed.boxes[:, :count].min(axis=0), placed.boxes[:, 3 : 3 + count].max(axis=0)
    if not np.isfinite((low, high)).all():
        raise ArgumentError("a plane is infinite: give bounds, or exclude it by WHERE")
    low = np.floor(low / _BOUNDS_STEP + _TOLERANCE) * _BOUNDS_STEP
    high = np.maximum(
        np.ceil(high / _BOUNDS_STEP - _TOLERANCE) * _BOUNDS_STEP, low + _BOUNDS_STEP
    )  # walls may be flat
    # 0.29, not 0.29000000000000004
    return tuple(low.round(9).tolist()), tuple(high.round(9).tolist())


def _given_bounds(bounds: Any, count: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Returns two corners of `count` coordinates; also accepts the value of `aabb`."""
    corner = "[x, y]" if count == 2 else "[x, y, z]"
    form = f"two corners {corner}, or the aabb of an entity"
    if isinstance(bounds, list | tuple) and len(bounds) == 6:
        bounds = [bounds[0::2], bounds[1::2]]
    corners = validation.sequence(bounds, 2, f"bounds are {form}")
    lower, upper = (
        tuple(
            validation.number_list(
                c[:count] if isinstance(c, list | tuple) else c, count, "bounds", form
            )
        )
        for c in corners
    )
    return lower, upper


def _counts(
    selection: Selection, lower: Sequence[float], upper: Sequence[float], size: float
) -> tuple[int, ...]:
    """Returns the number of cells between the corners along each axis."""
    for low, high in zip(lower, upper, strict=True):
        if not low < high:
            raise ArgumentError(f"bounds: {low:g} is not below {high:g}")
    steps = [(high - low) / size - _TOLERANCE for low, high in zip(lower, upper, strict=True)]
    _check_count(selection, steps)
    return tuple(max(1, math.ceil(step)) for step in steps)


def _check_count(selection: Selection, counts: Sequence[float]) -> None:
    counts = [max(1.0, count) for count in counts]
    listed = " x ".join(f"{count:,.0f}" for count in counts)
    if math.prod(counts) > MAX_CELLS:
        raise ArgumentError(
            f"{listed} cells are more than {MAX_CELLS:,}; take larger cells, or bounds of a part"
        )
    selection.check_size(
        math.prod(counts), f"{listed} cells", per_second=CELLS_PER_SECOND, bytes_each=CELL_BYTES
    )


def _finite_position(entity: Handle) -> list[float]:
    position = entity.position
    if not np.isfinite(position).all():
        raise ArgumentError(f"{entity.full_name!r}: the position is not a number")
    return position


GRIDS = (_occupancy, _roomba_grid, _voxels, _sensor_grid, _plane)
