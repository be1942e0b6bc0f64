"""The narrow phase of live ticks, for the conditions of many triggers at once.

How far bodies have moved bounds how much their distance has changed: mostly the last distance of
two still decides whether they are near. What it does not decide is asked of the narrow phase, as a
single condition would ask, so that the answers are the same.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from ssduck.columns.arrays import Array as Values
from ssduck.columns.compiler import LeftToDuckDBError
from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.broad_phase import Ids
from ssduck.geometry.queries import ShapeQueries
from ssduck.schema import ID_FACTOR
from ssduck.sql.relations.geometry_query import GeometryUdf
from ssduck.world.snapshot import Snapshot

# The rounding errors of two computed distances together are less, m.
_TOLERANCE = 1e-5
# Distances are computed up to this much beyond the largest one of interest, m.
_BEYOND = 0.01
# The largest number of clearances that are kept; when it is reached, all are dropped.
_MAX_CLEARANCES = 100_000
_UNKNOWN = (-math.inf, math.inf, 0.0)


class _Motion:
    """How far bodies have moved since the first tick."""

    def __init__(self, snapshot: Snapshot, serial: int) -> None:
        table = snapshot.table("shapes")
        self._key, self._table = _key_of(snapshot), table
        self._poses = table.doubles("x", "qz").copy()
        self._reaches = snapshot.shapes().reaches
        owners = table["entity"]
        self._starts = np.flatnonzero(np.diff(owners, prepend=-1))
        self._entities: Ids = owners[self._starts]
        self._lengths = np.zeros(len(self._starts))
        self.serial = serial  # a number that grows whenever a shape moves

    def is_of(self, snapshot: Snapshot) -> bool:
        """Checks whether it knows the shapes of a tick, with these margins."""
        return self._key == _key_of(snapshot)

    def update(self) -> None:
        """Takes note of the poses of the tick."""
        poses, before = self._table.doubles("x", "qz"), self._poses
        if np.array_equal(poses.view(np.int64), before.view(np.int64)):
            return
        shift = poses - before
        moves = np.sqrt((shift[:3] ** 2).sum(axis=0))
        # q and -q are the same rotation.
        turns = 2.0 * np.sqrt(
            np.minimum((shift[3:] ** 2).sum(axis=0), ((poses[3:] + before[3:]) ** 2).sum(axis=0))
        )
        with np.errstate(invalid="ignore"):
            moves += np.where(turns > 0.0, turns * self._reaches, 0.0)
        self.serial += 1
        self._lengths += np.maximum.reduceat(moves, self._starts)
        self._poses = poses.copy()
        self.__dict__.pop("paths", None)

    @cached_property
    def paths(self) -> dict[int, float]:
        """Upper bounds of the lengths of the paths of the points of entities with shapes, m."""
        return dict(zip(self._entities.tolist(), self._lengths.tolist(), strict=True))


def _key_of(snapshot: Snapshot) -> tuple[object, ...]:
    """Returns what differs where a tick has other shapes, or other margins."""
    table = snapshot.table("shapes")
    return table, table.version, snapshot.layout, table["margin"].tobytes()


class LiveShapes:
    """The narrow phase of a world at its ticks; see `ssduck.columns.arrays.Calls`."""

    def __init__(self) -> None:
        self._snapshot: Snapshot | None = None
        self._motion: _Motion | None = None
        # Bounds of the clearances of pairs at some tick, m, and the length of their paths by then.
        self._clearances: dict[int, tuple[float, float, float]] = {}

    def begin(self, snapshot: Snapshot) -> int:
        """Begins a tick, which has the shapes; returns a number that changes if they have moved."""
        self._snapshot = snapshot
        if self._motion is None or not self._motion.is_of(snapshot):
            self._motion = _Motion(snapshot, 1 if self._motion is None else self._motion.serial + 1)
            self._clearances.clear()
        else:
            self._motion.update()
        return self._motion.serial

    @property
    def margins(self) -> float:
        """The largest distance, m, of shapes that touch by their margins."""
        assert self._snapshot is not None
        return self._snapshot.margins

    def values(self, udf: GeometryUdf, arguments: Sequence[Values], places: Indices) -> Values:
        """Returns the values of a function of shapes, (m,)."""
        ids = [column.astype(np.int64) for column in arguments[: udf.entities]]
        numbers = [column.astype(np.float64) for column in arguments[udf.entities :]]
        if any(np.isnan(column).any() for column in numbers):
            raise LeftToDuckDBError
        if udf.function is ShapeQueries.collides and (numbers[0] < 0.0).any():
            raise LeftToDuckDBError  # evaluated by itself, it raises the error
        values, is_open = np.zeros(len(places)), np.ones(len(places), np.bool_)
        if udf.function is ShapeQueries.near:
            is_near, is_open = self._are_near(ids[0], ids[1], numbers[0])
            values[is_near] = 1.0
        left = np.flatnonzero(is_open)
        if len(left):
            keys = np.stack([c[left].view(np.int64) for c in (*ids, *numbers)], axis=1)
            _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
            answers = [
                self._answer(udf, *[column[place].item() for column in (*ids, *numbers)])
                for place in left[first].tolist()
            ]
            values[left] = np.array(answers)[inverse.ravel()]
        return values

    def _answer(self, udf: GeometryUdf, *arguments: float) -> float:
        """Returns the answer of the narrow phase about some entities."""
        assert self._snapshot is not None
        value = udf.function(self._snapshot.shapes(), *arguments)
        if value is None:
            raise LeftToDuckDBError
        return float(value)

    def _are_near(self, a: Ids, b: Ids, reach: Array) -> tuple[Flags, Flags]:
        """Returns whether the clearances of m pairs are within some distances, and may be."""
        numbers = np.minimum(a, b) * ID_FACTOR + np.maximum(a, b)
        pairs, inverse = np.unique(numbers, return_inverse=True)
        largest = np.full(len(pairs), -math.inf)
        np.maximum.at(largest, inverse, reach)
        bounds = np.array([self._bounds(pair) for pair in pairs.tolist()])
        low, high = bounds[inverse].T
        is_open = np.zeros(len(pairs), np.bool_)
        is_open[inverse[(low <= reach) & (reach < high)]] = True
        for place in np.flatnonzero(is_open).tolist():
            bounds[place] = self._compare(int(pairs[place]), float(largest[place]) + _BEYOND)
        low, high = bounds[inverse].T
        are_near: Flags = (high < math.inf) & (reach >= high)
        return are_near, ~are_near & (low <= reach)

    def _path(self, pair: int) -> float:
        """Returns how far two entities have moved."""
        assert self._motion is not None
        paths = self._motion.paths
        a, b = divmod(pair, ID_FACTOR)
        return paths.get(a, 0.0) + paths.get(b, 0.0)

    def _bounds(self, pair: int) -> tuple[float, float]:
        """Returns bounds of the clearance of two entities from their last comparison, m."""
        low, high, path = self._clearances.get(pair, _UNKNOWN)
        error = self._path(pair) - path + _TOLERANCE
        return low - error, high + error

    def _compare(self, pair: int, limit: float) -> tuple[float, float]:
        """Returns bounds of the clearance of two entities, compared up to a limit, m."""
        assert self._snapshot is not None
        clearance = self._snapshot.shapes().clearance_up_to(*divmod(pair, ID_FACTOR), limit)
        if clearance is None:
            raise LeftToDuckDBError
        if len(self._clearances) >= _MAX_CLEARANCES:
            self._clearances.clear()
        self._clearances[pair] = min(clearance, limit), clearance, self._path(pair)
        return self._bounds(pair)
