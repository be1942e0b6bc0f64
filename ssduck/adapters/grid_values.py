"""Defines grids, the values of grid result forms: cells with their place in the world.

The first index counts along x (the first axis), the second along y, as in SelectScript's
tutorial; pictures have x to the right and y up.

Maps of ROS's map_server are a picture (PGM, P5) and its YAML file; see
http://wiki.ros.org/map_server. A pixel x is occupied if (255 - x) / 255 is above `occupied_thresh`,
free if it is below `free_thresh`, otherwise unknown; with `negate`, x / 255 is compared instead.
The lower left pixel is at `origin`. The key `z` is an addition of ssduck, which others ignore.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck import validation
from ssduck.adapters.optional import axes_of
from ssduck.errors import ArgumentError
from ssduck.formatting import error_text

if TYPE_CHECKING:
    from PIL import Image

Cells: TypeAlias = npt.NDArray[Any]
Height: TypeAlias = float | tuple[float, float]

# More cells are probably a mistake, and too many for the memory of most machines.
MAX_CELLS = 100_000_000
# Pictures in notebooks are enlarged to about this size, pixels.
NOTEBOOK_SIZE = 400
# Larger pictures are reduced for charts, pixels.
_MAX_CHART_SIZE = 2000
# The colours from nothing to the largest value: red, green, blue.
_SCALE = np.array([[255, 255, 255], [254, 217, 118], [240, 59, 32], [74, 0, 60]])
_FREE, _OCCUPIED = 255, 40


def _colours(shares: Cells) -> npt.NDArray[np.uint8]:
    """Returns the colours of shares of the largest value, with a last axis for red, green, blue."""
    stops = np.linspace(0.0, 1.0, len(_SCALE))
    channels = [np.interp(shares, stops, channel) for channel in _SCALE.T]
    return np.stack(channels, axis=-1).round().astype(np.uint8)


@dataclass(frozen=True, eq=False)
class Grid:
    """A grid of square or cubic cells; numpy converts it to the array of its cells.

    Attributes:
        cells: the values, read-only; the first index is along the first axis.
        origin: the lower corner, a coordinate for each axis, m.
        resolution: the side of a cell, m.

    >>> grid = Grid(np.array([[0, 1], [2, 3], [4, 5]]), (1.0, 0.0), 0.5)
    >>> grid.bounds
    ((1.0, 0.0), (2.5, 1.0))
    >>> grid.at(1.6, 0.9), grid.at(1.5, 0.0)
    (3, 2)
    """

    cells: Cells
    origin: tuple[float, ...]
    resolution: float

    def __post_init__(self) -> None:
        self.cells.setflags(write=False)

    @property
    def axes(self) -> str:
        """The axes of the world along which the indices count."""
        return "XYZ"[: self.cells.ndim]

    @property
    def shape(self) -> tuple[int, ...]:
        """The number of cells along each axis."""
        return self.cells.shape

    @property
    def bounds(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The lower and the upper corner, m."""
        upper = (o + n * self.resolution for o, n in zip(self.origin, self.shape, strict=True))
        return self.origin, tuple(upper)

    def centres(self, axis: int) -> npt.NDArray[np.float64]:
        """Returns the coordinates of the centres of the cells along an axis, m.

        Args:
            axis: 0 for x, 1 for y, 2 for z.

        Raises:
            NumberError: the grid does not have the axis.
        """
        axis = validation.integer(axis, "centres: axis", minimum=0, maximum=len(self.shape) - 1)
        steps: npt.NDArray[np.float64] = np.arange(self.shape[axis], dtype=np.float64) + 0.5
        return self.origin[axis] + steps * self.resolution

    def at(self, *point: float) -> Any:
        """Returns the value of the cell at a point; on a boundary, that of the upper cell.

        Args:
            point: a coordinate for each axis, m.

        Raises:
            ArgumentError: the point is outside the grid.
        """
        if len(point) != len(self.origin):
            raise ArgumentError(f"a point of this grid has {len(self.origin)} coordinates")
        coordinates = [
            validation.finite_number(part, "at: a coordinate", "metres") for part in point
        ]
        steps = (np.array(coordinates) - self.origin) / self.resolution
        if not ((steps >= 0.0) & (steps < self.shape)).all():
            raise ArgumentError(f"{list(point)} is not in the grid, which spans {self.bounds}")
        return self.cells[tuple(steps.astype(np.intp))].item()

    def astype(self, dtype: npt.DTypeLike) -> Cells:
        """Returns the cells as an array of another type."""
        return self.cells.astype(dtype)

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> Cells:
        return np.array(self.cells, dtype=dtype, copy=copy)

    def __getitem__(self, key: Any) -> Any:
        return self.cells[key]

    def __len__(self) -> int:
        return len(self.cells)

    def __bool__(self) -> bool:
        """Checks whether any cell is not zero or False."""
        return bool(self.cells.any())

    def __eq__(self, other: object) -> bool:
        """Checks whether the other grid has the same class, place and values."""
        if type(self) is not type(other) or not isinstance(other, Grid):
            return False
        mine, others = ({**vars(grid), "cells": None} for grid in (self, other))
        return mine == others and np.array_equal(self.cells, other.cells)

    def __hash__(self) -> int:
        return hash((type(self), self.shape, self.origin, self.resolution))

    def __repr__(self) -> str:
        count = " x ".join(map(str, self.shape))
        return f"<{type(self).__name__}: {count} cells of {self.resolution:g} m from {self.origin}>"

    # -- pictures -------------------------------------------------------------------------

    def _flat(self) -> Cells:
        """Returns the values that a picture shows, (along x, along y)."""
        return self.cells

    def image(self) -> Image.Image:
        """Returns a picture with a pixel for each cell: x to the right, y up, empty cells white."""
        from PIL import Image

        values = self._flat().T[::-1]
        if values.dtype == np.bool_:
            return Image.fromarray(np.where(values, _OCCUPIED, _FREE).astype(np.uint8))
        largest = float(values.max(initial=0.0))
        shares = np.clip(values / largest, 0.0, 1.0) if largest > 0.0 else np.zeros(values.shape)
        return Image.fromarray(_colours(shares))

    @property
    def _labels(self) -> tuple[str, str]:
        return f"{self.axes[0].lower()} [m]", f"{self.axes[1].lower()} [m]"

    # The name and the unit of the values.
    _LABEL: ClassVar[str] = "value"

    def chart(self, size: int = NOTEBOOK_SIZE) -> Image.Image:
        """Returns a picture with axes in metres and a legend or a scale; empty cells are white.

        Args:
            size: the least width or height of the area of the cells, pixels.

        Raises:
            NumberError: `size` is not a whole number of at least 1.
        """
        from PIL import Image

        from ssduck.adapters.charts import ColourScale, chart

        size = validation.integer(size, "chart: size", minimum=1)
        area = self.image()
        area = area.reduce(max(1, math.ceil(max(area.size) / max(_MAX_CHART_SIZE, size))))
        factor = max(1, math.ceil(size / max(area.size)))
        area = area.resize((area.width * factor, area.height * factor), Image.Resampling.NEAREST)
        values, (lower, upper) = self._flat(), self.bounds
        bounds = lower[:2], upper[:2]
        if values.dtype == np.bool_:
            shades = [(shade, shade, shade) for shade in (_OCCUPIED, _FREE)]
            entries = list(zip(shades, (self._LABEL, "free"), strict=True))
            return chart(area, bounds, self._labels, entries=entries)
        colours = [(r, g, b) for r, g, b in _colours(np.linspace(0.0, 1.0, 256)).tolist()]
        is_whole = values.dtype.kind in "iu"
        scale = ColourScale(self._LABEL, float(values.max(initial=0.0)), colours, is_whole)
        return chart(area, bounds, self._labels, scale=scale)

    def _repr_png_(self) -> bytes:
        """Returns `chart()` as a PNG picture for notebooks."""
        from ssduck.adapters.charts import png

        return png(self.chart())

    def plot(self, ax: Any = None) -> Any:
        """Draws the grid with matplotlib, with axes in metres.

        Args:
            ax: the axes of matplotlib; by default those of a new figure.

        Returns:
            The axes.

        Raises:
            UnsupportedError: matplotlib is not installed; the message says how to install it.
        """
        ax = axes_of(ax)
        (left, bottom), (right, top) = (corner[:2] for corner in self.bounds)
        values = self._flat().T
        is_boolean = values.dtype == np.bool_
        image = ax.imshow(
            values,
            origin="lower",
            extent=(left, right, bottom, top),
            cmap="Greys" if is_boolean else "YlOrRd",
            interpolation="nearest",
        )
        ax.set(xlabel=self._labels[0], ylabel=self._labels[1])
        if is_boolean:
            from matplotlib.patches import Patch

            patches = [Patch(facecolor="black", label=self._LABEL)]
            patches.append(Patch(facecolor="white", edgecolor="black", label="free"))
            ax.legend(handles=patches, loc="upper left", bbox_to_anchor=(1.02, 1.0))
        else:
            ax.figure.colorbar(image, ax=ax, label=self._LABEL)
        return ax


@dataclass(frozen=True, eq=False, repr=False)
class OccupancyGrid(Grid):
    """The cells occupied at a height or between two heights; cells are True or False.

    Attributes:
        z: the height, or the lower and the upper height, m.
    """

    _LABEL: ClassVar[str] = "occupied"

    z: Height = 0.0

    def save(self, path: str | Path) -> Path:
        """Writes a map for ROS's map_server: a YAML file and a PGM picture beside it.

        Occupied cells are black (0), free ones 254. The first row of the picture has the
        greatest y.

        Args:
            path: the path of the YAML file; `.yaml` is added if it has no suffix.

        Returns:
            The path of the YAML file.
        """
        import yaml
        from PIL import Image

        path = Path(path)
        path = path if path.suffix else path.with_suffix(".yaml")
        picture = path.with_suffix(".pgm")
        if picture == path:
            raise ArgumentError(
                f"{path} is the name of the picture; name the YAML file, map.yaml say"
            )
        pixels = np.where(self.cells.T[::-1], OCCUPIED, FREE).astype(np.uint8)
        values = {
            "image": picture.name,
            "resolution": self.resolution,
            "origin": [*self.origin, 0.0],
            "negate": 0,
            "occupied_thresh": OCCUPIED_THRESH,
            "free_thresh": FREE_THRESH,
            "z": list(self.z) if isinstance(self.z, tuple) else self.z,
        }
        try:
            str(path).encode()  # fails before anything is written if the name cannot be encoded
            Image.fromarray(pixels).save(picture, "PPM")
            with path.open("w", encoding="utf-8", newline="\n") as file:
                yaml.safe_dump(
                    values, file, sort_keys=False, default_flow_style=None, width=math.inf
                )
        except (OSError, ValueError) as error:  # a null character is a ValueError
            raise ArgumentError(f"{path} cannot be written: {error_text(error)}") from error
        return path

    @classmethod
    def load(cls, path: str | Path, *, unknown: bool | None = None) -> OccupancyGrid:
        """Reads a map written by `save` or by ROS's map_saver.

        Args:
            path: the path of the YAML file.
            unknown: whether cells that are neither occupied nor free count as occupied; by
                default such cells are an error.

        Raises:
            ArgumentError: the file is not such a map; the map is rotated; or it has unknown
                cells and `unknown` is not given.
        """
        if unknown is not None:
            unknown = validation.boolean(unknown, "load: unknown")
        return _load_map(cls, Path(path), unknown)


@dataclass(frozen=True, eq=False, repr=False)
class SensorGrid(Grid):
    """The number of sensors that see each cell at a height; cells are integers.

    Attributes:
        z: the height, m.
        sensors: the names of the sensors.
    """

    _LABEL: ClassVar[str] = "sensors that see the cell"

    z: float = 0.0
    sensors: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class PlaneGrid(Grid):
    """Sums of values over a plane; cells are floats.

    Attributes:
        plane: the axes of the plane: `"XY"`, `"XZ"` or `"YZ"`.
    """

    _LABEL: ClassVar[str] = "sum of values"

    plane: str = field(default="XY")

    @property
    def axes(self) -> str:
        """The axes of the world along which the indices count."""
        return self.plane


@dataclass(frozen=True, eq=False, repr=False)
class VoxelGrid(Grid):
    """The occupied cubes; cells are True or False, along x, y and z."""

    _LABEL: ClassVar[str] = "height [m]"

    def heights(self) -> npt.NDArray[np.float64]:
        """Returns the height of the occupied cubes in each column above the grid's ground, m."""
        top = self.shape[2] - self.cells[:, :, ::-1].argmax(axis=2)
        heights: npt.NDArray[np.float64] = (
            np.where(self.cells.any(axis=2), top, 0) * self.resolution
        )
        return heights

    def _flat(self) -> Cells:
        return self.heights()


# -- maps of ROS ------------------------------------------------------------------------------


FREE, OCCUPIED = 254, 0
OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196
_REQUIRED = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")


def _load_map(kind: type[OccupancyGrid], path: Path, unknown: bool | None) -> OccupancyGrid:
    from PIL import Image

    values = _map_values(path)
    try:
        with Image.open(path.parent / str(values["image"])) as picture:
            shade = np.asarray(picture.convert("L"), dtype=np.float64).T[:, ::-1] / 255.0
        x, y, yaw = map(float, values["origin"])
        resolution = float(values["resolution"])
        thresholds = float(values["occupied_thresh"]), float(values["free_thresh"])
        height = values.get("z", 0.0)
        z = tuple(map(float, height)) if isinstance(height, list) else float(height)
    except (OSError, TypeError, ValueError) as error:
        raise ArgumentError(f"{path} cannot be read as a map: {error_text(error)}") from error
    if not (math.isfinite(resolution) and resolution > 0.0 and math.isfinite(x + y)):
        raise ArgumentError(
            f"{path} cannot be read as a map: resolution {resolution:g}, origin {x:g}, {y:g}"
        )
    if values.get("mode") == "raw":
        raise ArgumentError(f"{path}: the mode is raw; trinary and scale can be read")
    if yaw != 0.0:
        raise ArgumentError(f"{path}: the map is rotated by {yaw:g} rad; grids are axis-aligned")
    if values["negate"] not in (1, "true", "True"):
        shade = 1.0 - shade
    occupied, free = shade > thresholds[0], shade < thresholds[1]
    unknown_count = int((~occupied & ~free).sum())
    if unknown_count and unknown is None:
        raise ArgumentError(
            f"{path}: {unknown_count} cells are unknown; load(path, unknown=True) counts them as "
            "occupied, unknown=False for free"
        )
    return kind(~free if unknown else occupied, (x, y), resolution, z)  # type: ignore[arg-type]


def _map_values(path: Path) -> dict[str, Any]:
    """Returns the keys and values of the YAML file."""
    import yaml

    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise ArgumentError(f"{path} cannot be read: {line}{error.problem}") from error
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise ArgumentError(f"{path} cannot be read: {error_text(error)}") from error
    entries: dict[str, Any] = values if isinstance(values, dict) else {}
    missing = [key for key in _REQUIRED if key not in entries]
    if missing:
        raise ArgumentError(f"{path} is no map of ROS's map_server: it has no {missing[0]}")
    return entries
