"""Square cells over a plane, and intervals of strips of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array, Indices

# What is as near to a boundary is on it, m.
CELL_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Raster:
    """Square cells over a part of the xy plane.

    Attributes:
        origin: x and y of the lower corner, m.
        size: the side of a cell, m.
        shape: how many cells there are along x and along y.
    """

    origin: tuple[float, float]
    size: float
    shape: tuple[int, int]

    def centres(self, axis: int) -> Array:
        """The coordinates of the cells' centres along x (0) or y (1)."""
        steps: Array = np.arange(self.shape[axis], dtype=np.float64) + 0.5
        return self.origin[axis] + steps * self.size

    def reached(self, low: Array, high: Array, within: float, axis: int) -> tuple[Indices, Indices]:
        """The first and the last cell along an axis that intervals reach into.

        Args:
            low: where they begin,
            high: and end.
            within: by how much they have to reach into a cell; negative for how far they may be.
            axis: x (0) or y (1).

        Returns:
            Numbers from 0 on; the last is below the first where there is none.
        """
        start, count = self.origin[axis], self.shape[axis]
        first = np.floor((low + within - start) / self.size)
        last = np.ceil((high - within - start) / self.size) - 1
        return (
            np.clip(first, 0, count).astype(np.intp),
            np.clip(last, -1, count - 1).astype(np.intp),
        )


@dataclass(frozen=True, eq=False)
class StripIntervals:
    """Intervals along y of strips of cells.

    Attributes:
        strips: (n,)
        low: (n,) where they begin,
        high: and end.
        within: by how much they have to reach into a cell.
    """

    strips: Indices
    low: Array
    high: Array
    within: float

    def count(self, raster: Raster, changes: npt.NDArray[np.int32]) -> None:
        """Add 1 at the first cell of each, and -1 behind its last."""
        first, last = raster.reached(self.low, self.high, self.within, 1)
        some = first <= last
        strips = self.strips[some]
        np.add.at(changes, (strips, first[some]), 1)
        np.add.at(changes, (strips, last[some] + 1), -1)
