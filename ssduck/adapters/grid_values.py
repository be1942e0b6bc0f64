"""What grid forms give: cells with their place in the world, to be computed with, seen and stored.

The first index counts along x (the first axis), the second along y, as in SelectScript's tutorial;
pictures have x to the right and y up.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck import validation
from ssduck.adapters import ros_map as ros_maps
from ssduck.errors import ArgumentError

if TYPE_CHECKING:
    from PIL import Image

Cells: TypeAlias = npt.NDArray[Any]
Height: TypeAlias = float | tuple[float, float]

# So many cells are a mistake, or too much for the memory of most machines.
MOST_CELLS = 100_000_000
# A picture for a notebook is at least that large, pixels.
SHOWN = 400
# From nothing over much to most: red, green, blue.
_SCALE = np.array([[255, 255, 255], [254, 217, 118], [240, 59, 32], [74, 0, 60]])
_FREE, _OCCUPIED = 255, 40


@dataclass(frozen=True, eq=False)
class Grid:
    """Square or cubic cells; numpy takes it for the array of its cells.

    Attributes:
        cells: the values, which cannot be written to; the first index is along the first axis.
        origin: the lower corner, a coordinate for each axis, m.
        resolution: the side of a cell, m.
    """

    cells: Cells
    origin: tuple[float, ...]
    resolution: float

    def __post_init__(self) -> None:
        self.cells.setflags(write=False)

    @property
    def axes(self) -> str:
        """Which axes of the world the indices are along."""
        return "XYZ"[: self.cells.ndim]

    @property
    def shape(self) -> tuple[int, ...]:
        """How many cells there are along each axis."""
        return self.cells.shape

    @property
    def bounds(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The lower and the upper corner, m."""
        upper = (o + n * self.resolution for o, n in zip(self.origin, self.shape, strict=True))
        return self.origin, tuple(upper)

    def centres(self, axis: int) -> npt.NDArray[np.float64]:
        """The coordinates of the cells' centres along an axis, m.

        Args:
            axis: 0 for x, 1 for y, 2 for z.

        Raises:
            NumberError: the grid has no such axis.
        """
        axis = validation.integer(axis, "centres: axis", minimum=0, maximum=len(self.shape) - 1)
        steps: npt.NDArray[np.float64] = np.arange(self.shape[axis], dtype=np.float64) + 0.5
        return self.origin[axis] + steps * self.resolution

    def at(self, *point: float) -> Any:
        """The value of the cell that a point is in; of two cells, the upper one.

        Args:
            point: a coordinate for each axis, m.

        Raises:
            ArgumentError: it is not in the grid.
        """
        if len(point) != len(self.origin):
            raise ArgumentError(f"a point of this grid has {len(self.origin)} coordinates")
        given = [validation.finite_number(part, "at: a coordinate", "metres") for part in point]
        steps = (np.array(given) - self.origin) / self.resolution
        if not ((steps >= 0.0) & (steps < self.shape)).all():
            raise ArgumentError(f"{list(point)} is not in the grid, which spans {self.bounds}")
        return self.cells[tuple(steps.astype(np.intp))].item()

    def astype(self, dtype: npt.DTypeLike) -> Cells:
        """The cells as an array of another type."""
        return self.cells.astype(dtype)

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> Cells:
        return np.array(self.cells, dtype=dtype, copy=copy)

    def __getitem__(self, key: Any) -> Any:
        return self.cells[key]

    def __len__(self) -> int:
        return len(self.cells)

    def __bool__(self) -> bool:
        """Whether any cell has something in it."""
        return bool(self.cells.any())

    def __eq__(self, other: object) -> bool:
        """Whether it is the same kind of grid, at the same place, with the same values."""
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
        """What a picture shows, (along x, along y)."""
        return self.cells

    def image(self) -> Image.Image:
        """A picture, a pixel a cell: x to the right, y up; white where there is nothing."""
        from PIL import Image

        values = self._flat().T[::-1]
        if values.dtype == np.bool_:
            return Image.fromarray(np.where(values, _OCCUPIED, _FREE).astype(np.uint8))
        most = float(values.max(initial=0.0))
        share = np.clip(values / most, 0.0, 1.0) if most > 0.0 else np.zeros(values.shape)
        stops = np.linspace(0.0, 1.0, len(_SCALE))
        colours = [np.interp(share, stops, channel) for channel in _SCALE.T]
        return Image.fromarray(np.stack(colours, axis=2).round().astype(np.uint8))

    def _repr_png_(self) -> bytes:
        """For notebooks: small grids are drawn larger."""
        from PIL import Image

        drawn, stored = self.image(), io.BytesIO()
        times = max(1, SHOWN // max(drawn.size))
        drawn = drawn.resize((drawn.width * times, drawn.height * times), Image.Resampling.NEAREST)
        drawn.save(stored, "PNG")
        return stored.getvalue()

    def plot(self, ax: Any = None) -> Any:
        """Draw it with matplotlib, axes in metres.

        Args:
            ax: matplotlib's axes; by default those of a new figure.

        Returns:
            The axes.

        Raises:
            ArgumentError: matplotlib is not installed.
        """
        try:
            from matplotlib.figure import Figure
        except ImportError as error:
            raise ArgumentError(
                "plot needs matplotlib: pip install 'ssduck[plot]'; image() does without"
            ) from error
        ax = Figure().subplots() if ax is None else ax
        (left, bottom), (right, top) = (corner[:2] for corner in self.bounds)
        values = self._flat().T
        is_plain = values.dtype == np.bool_
        drawn = ax.imshow(
            values,
            origin="lower",
            extent=(left, right, bottom, top),
            cmap="Greys" if is_plain else "YlOrRd",
            interpolation="nearest",
        )
        ax.set_xlabel(f"{self.axes[0].lower()} [m]")
        ax.set_ylabel(f"{self.axes[1].lower()} [m]")
        if not is_plain:
            ax.figure.colorbar(drawn, ax=ax)
        return ax


@dataclass(frozen=True, eq=False, repr=False)
class OccupancyGrid(Grid):
    """Which cells are occupied at a height, or anywhere between two; cells are True or False.

    Attributes:
        z: the height, or the lower and the upper one, m.
    """

    z: Height = 0.0

    def save(self, path: str | Path) -> Path:
        """Write it as ROS's map_server reads it: a YAML file, and a PGM picture beside it.

        Occupied cells are black (0), free ones 254. The first row of the picture is that of the
        greatest y.

        Args:
            path: of the YAML file; `.yaml` is added if it has no suffix.

        Returns:
            The path of the YAML file.
        """
        return ros_maps.save(Path(path), self.cells, self.origin, self.resolution, self.z)

    @classmethod
    def load(cls, path: str | Path, *, unknown: bool | None = None) -> OccupancyGrid:
        """Read what `save`, or a ROS map_saver, wrote.

        Args:
            path: of the YAML file.
            unknown: whether cells that are neither occupied nor free count as occupied; such cells
                are an error if it is not said.

        Raises:
            ArgumentError: it is no such map, or is turned, or has cells that are unknown.
        """
        if unknown is not None:
            unknown = validation.boolean(unknown, "load: unknown")
        return cls(*ros_maps.load(Path(path), unknown=unknown))


@dataclass(frozen=True, eq=False, repr=False)
class SensorGrid(Grid):
    """How many sensors see each cell at a height; cells are whole numbers.

    Attributes:
        z: the height, m.
        sensors: the names of the sensors.
    """

    z: float = 0.0
    sensors: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class PlaneGrid(Grid):
    """Sums of values over a plane; cells are real numbers.

    Attributes:
        plane: its axes: `"XY"`, `"XZ"` or `"YZ"`.
    """

    plane: str = field(default="XY")

    @property
    def axes(self) -> str:
        """Which axes of the world the indices are along."""
        return self.plane


@dataclass(frozen=True, eq=False, repr=False)
class VoxelGrid(Grid):
    """Which cubes are occupied; cells are True or False, along x, y and z."""

    def heights(self) -> npt.NDArray[np.float64]:
        """How high the topmost occupied cube of each column reaches above the grid's ground, m."""
        top = self.shape[2] - self.cells[:, :, ::-1].argmax(axis=2)
        found: npt.NDArray[np.float64] = np.where(self.cells.any(axis=2), top, 0) * self.resolution
        return found

    def _flat(self) -> Cells:
        return self.heights()
