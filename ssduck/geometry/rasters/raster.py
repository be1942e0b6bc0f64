"""Square cells over the ground, and intervals of strips of cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array, Indices

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
