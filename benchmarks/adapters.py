"""Measures grids of the shipped kitchen against ray casts, as one would write them in PyBullet.

`python -m benchmarks adapters` takes about a minute. `occupancygrid` is compared with a ray for
each cell, straight down from above the scene to the height of the grid, in batches of the largest
size that PyBullet allows. Rays find less: things above the height hide those at it, and a ray
through the centre of a cell misses the rest of it. `sensorgrid` is compared with a ray from each
sensor to each cell, whether in the field of view or not. Queries are compiled and run on a fresh
tick each time; of the rays, only the casting counts.

To add a row, add an entry to `COMPARISONS`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import numpy as np
import pybullet

import ssduck
from benchmarks.timing import Way, minima, text_of

# PyBullet refuses more rays in one call.
MAX_RAYS: int = pybullet.MAX_RAY_INTERSECTION_BATCH_SIZE - 1
ROUNDS, MAX_SECONDS = 7, 10.0
Loop: TypeAlias = Callable[[], object]


@dataclass(frozen=True)
class Comparison:
    """A query and an alternative without ssduck that does as much or less.

    Attributes:
        program: a query about `kitchen`.
        other: makes the alternative from the world and the result of the query.
        label: a description of the alternative.
    """

    program: str
    other: Callable[[ssduck.World, Any], Loop]
    label: str


def rays_down(kitchen: ssduck.World, grid: Any) -> Loop:
    """Returns a call that casts a ray for each cell, from 3 m above its height down to it."""
    z = grid.z[0] if isinstance(grid.z, tuple) else grid.z
    x, y = np.meshgrid(grid.centres(0), grid.centres(1), indexing="ij")
    return _batches(kitchen, _points(x, y, z + 3.0), _points(x, y, z))


def rays_from_sensors(kitchen: ssduck.World, grid: Any) -> Loop:
    """Returns a call that casts a ray from each sensor to each cell, in view or not."""
    x, y = np.meshgrid(grid.centres(0), grid.centres(1), indexing="ij")
    ends = _points(x, y, grid.z)
    places = [kitchen[name].position for name in grid.sensors]
    return _batches(kitchen, np.repeat(places, len(ends), axis=0), np.tile(ends, (len(places), 1)))


def _points(x: Any, y: Any, z: float) -> Any:
    return np.stack((x.ravel(), y.ravel(), np.full(x.size, z)), axis=1)


def _batches(kitchen: ssduck.World, starts: Any, ends: Any) -> Loop:
    client = kitchen.ticker.simulator.client  # type: ignore[attr-defined]
    parts = [slice(first, first + MAX_RAYS) for first in range(0, len(starts), MAX_RAYS)]

    def loop() -> object:
        return [
            pybullet.rayTestBatch(starts[part], ends[part], numThreads=0, physicsClientId=client)
            for part in parts
        ]

    return loop


ALL = "SELECT obj FROM kitchen AS"
COMPARISONS = {
    "occupancygrid(0.22, 0.05)": Comparison(
        f"{ALL} occupancygrid(0.22, 0.05);", rays_down, "a ray a cell"
    ),
    "occupancygrid(0.22, 0.01)": Comparison(
        f"{ALL} occupancygrid(0.22, 0.01);", rays_down, "a ray a cell"
    ),
    "occupancygrid([0.2, 1.5], 0.01)": Comparison(
        f"{ALL} occupancygrid([0.2, 1.5], 0.01);", rays_down, "a ray a cell"
    ),
    "sensorgrid(0.24, 0.05)": Comparison(
        "SELECT obj FROM kitchen WHERE isSensor(this) AS sensorgrid(0.24, 0.05);",
        rays_from_sensors,
        "a ray a sensor and a cell",
    ),
}


def rows() -> Iterator[tuple[str, ...]]:
    """Yields a row for each comparison: the cells, ssduck, the alternative, the ratio."""
    yield environment()
    with ssduck.load("kitchen") as ss:
        kitchen = ss.call_variable("kitchen").step(240)
        for name, comparison in COMPARISONS.items():
            compiled = ss.compile(comparison.program)
            result = ss.eval(compiled)  # the first call plans the query
            ways = {
                "ours": Way(partial(ss.eval, compiled), kitchen.tick),
                "other": Way(comparison.other(kitchen, result)),
            }
            times = minima(ways, ROUNDS, MAX_SECONDS)
            cells = f"{result.cells.size:,}" if hasattr(result, "cells") else ""
            ratio = f"{times['ours'] / times['other']:.2g}"
            yield (
                name,
                cells,
                text_of(times["ours"]),
                comparison.label,
                text_of(times["other"]),
                ratio,
            )


def environment() -> tuple[str, ...]:
    """Returns the row of a copy of the kitchen by a query, against loading the scene."""
    with ssduck.load("kitchen") as ss:
        compiled = ss.compile(f"{ALL} environment;")
        ways = {
            "ours": Way(lambda: ss.eval(compiled).close()),
            "other": Way(lambda: ssduck.load("kitchen").close()),
        }
        times = minima(ways, ROUNDS, MAX_SECONDS)
    ratio = f"{times['ours'] / times['other']:.2g}"
    cells = text_of(times["ours"]), "loading the scene", text_of(times["other"])
    return "environment", "", *cells, ratio


HEADER = ("behind AS", "cells", "ssduck", "against", "which takes", "ratio")
