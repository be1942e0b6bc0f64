"""Maps of the kitchen for its vacuum cleaner: of everything, and of everything near it.

As in the tutorial's section 10.2, a map contains the cells of 2.5 cm that something occupies 22 cm
above the floor.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import label

from ssduck.adapters.grid_values import OccupancyGrid
from ssduck.demos.results import Say, keep, keep_picture
from ssduck.interpreter.opening import load

ALL = "SELECT obj FROM kitchen AS roombaGrid;"
NEAR = """\
roomba = SELECT obj FROM kitchen WHERE id(this) == 'roomba_625x' AS value;
SELECT obj FROM kitchen WHERE distance(roomba, this) <= 1.5 AS roombaGrid;"""
# At 22 cm the legs of the table and of four chairs stand on the floor, in this region.
LEGS_REGION = ((0.0, -1.6), (1.6, 0.95))


def run(folder: Path, say: Say, *, seed: int) -> bool:  # noqa: ARG001
    """Makes, saves, loads and checks the maps."""
    succeeded, pictures = True, []
    with load("kitchen") as ss:
        for name, program in (("kitchen", ALL), ("near_roomba", NEAR)):
            say(program)
            grid: OccupancyGrid = ss.eval(program)
            cells, origin = np.asarray(grid), ", ".join(f"{c:g}" for c in grid.origin)
            size = f"{cells.shape[0]} x {cells.shape[1]} cells of {grid.resolution:g} m"
            say(f"{size} from {origin}: {cells.sum():,} occupied")
            target = keep(folder / f"{name}.yaml", grid.save)
            is_same = type(grid).load(target) == grid
            verdict = "the same" if is_same else "another one"
            say(f"Saved as {target} and its picture; loaded again it is {verdict}")
            pictures.append(str(keep_picture(grid.chart(), folder / f"{name}.png")))
            succeeded &= is_same and bool(cells.any()) and not cells.all()
        succeeded &= _has_legs(ss.eval(ALL), say)
    say(f"The maps: {', '.join(pictures)}")
    return succeeded


def _has_legs(grid: OccupancyGrid, say: Say) -> bool:
    """Checks whether the map shows as many legs as the table and the chairs have."""
    (left, low), (right, high) = LEGS_REGION
    x, y = grid.centres(0), grid.centres(1)
    inside: Any = np.asarray(grid)[np.ix_((x > left) & (x < right), (y > low) & (y < high))]
    count = int(label(inside, structure=np.ones((3, 3)))[1])
    say(f"About the table {count} separate things stand: four legs of its own, and of four chairs")
    return count == 20
