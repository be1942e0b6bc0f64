"""What contacts and sensors told at a recorded tick, of one or two entities.

SQL's macros cannot look things up by the tick of a row; these can. Each takes the columns of the
table at a tick (`ssduck.recording.replay.record.Record.rows`), and gives numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array

Columns: TypeAlias = Mapping[str, npt.NDArray[Any]]
# Gives the columns of a table at the tick.
Rows: TypeAlias = Callable[[str], Columns]


def sensed(rows: Rows, sensor: int, entity: int) -> list[float]:
    """[share of its rays] that end on the entity; none if it does not perceive it."""
    told = rows("sensings")
    found = np.flatnonzero((told["sensor"] == sensor) & (told["entity"] == entity))
    shares: list[float] = (told["hits"][found] / told["rays"][found]).tolist()
    return shares


def perceived(rows: Rows, sensor: int, _: int) -> list[float]:
    """The ids of what a sensor perceives, ascending."""
    told = rows("sensings")
    ids: list[float] = np.sort(told["entity"][told["sensor"] == sensor]).astype(float).tolist()
    return ids


def pressing(rows: Rows, a: int, b: int) -> list[float]:
    """The normal forces of the contacts of two entities, N."""
    told = rows("contacts")
    found = (told["a"] == min(a, b)) & (told["b"] == max(a, b))
    forces: list[float] = told["force"][found].tolist()
    return forces


def wrench(rows: Rows, entity: int, _: int) -> list[float]:
    """The sums of the forces on an entity, N, and of their moments about its position, N m."""
    told, entities = rows("contacts"), rows("entities")
    own = np.flatnonzero(entities["id"] == entity)
    if not len(own):
        return [0.0] * 6
    place = np.array([entities[axis][own[0]] for axis in "xyz"])
    total = np.zeros(6)
    for side, way in (("a", 1.0), ("b", -1.0)):
        touching = told[side] == entity
        forces = way * _three(told, touching, "fx", "fy", "fz")
        arms = _three(told, touching, f"{side}x", f"{side}y", f"{side}z") - place
        total[:3] += forces.sum(axis=0)
        total[3:] += np.cross(arms, forces).sum(axis=0)
    listed: list[float] = total.tolist()
    return listed


def _three(columns: Columns, rows: npt.NDArray[np.bool_], *names: str) -> Array:
    return np.array([columns[name][rows] for name in names]).T.reshape(-1, 3)


TOLD: dict[str, Callable[[Rows, int, int], list[float]]] = {
    told.__name__: told for told in (sensed, perceived, pressing, wrench)
}
