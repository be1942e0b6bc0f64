"""Answers the questions of geometric relations about many pairs of a tick at once.

Each pair is compared once, however many conditions ask about it, and not again before one of its
bodies moves. Even then, how far the bodies have moved bounds how much their distance has changed:
mostly the last distance still decides. What it does not decide is asked of the narrow phase, as a
single condition would ask, so that the answers are the same.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ssduck.columns.arrays import Array as Values
from ssduck.columns.expressions import LeftToDuckDBError
from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.id_pairs import Ids
from ssduck.geometry.queries import ShapeQueries
from ssduck.geometry.shape_comparisons import TOUCHING_DISTANCE
from ssduck.schema import ID_FACTOR
from ssduck.sql.relations.geometry_query import GeometryUdf
from ssduck.world.snapshot import Snapshot

# The rounding errors of two computed distances together are less, m.
_TOLERANCE = 1e-5
# Distances are computed up to this much beyond the largest one of interest, m.
_BEYOND = 0.01
# The largest number of answers that are kept; when it is reached, all are dropped.
_MAX_ANSWERS = 100_000


@dataclass
class _KnownClearance:
    """The clearance of two entities at some tick.

    Attributes:
        low: a lower bound, m.
        high: an upper bound, m; infinite if it is not known.
        travel: how far the two had moved by then, m.
        serial: the number of that tick.
    """

    low: float
    high: float
    travel: float
    serial: int


class _Motion:
    """How far bodies have moved since the first tick.

    Attributes:
        serial: a number that grows whenever a shape moves.
        entities: (entities,), the ids of the entities with shapes.
        travel: (entities + 1,), upper bounds of the lengths of the paths of their points, m; the
            last one is 0, for what has no shapes.
        moved: (entities + 1,), the serial of the last move; the last one is 0.
    """

    def __init__(self, snapshot: Snapshot) -> None:
        table = snapshot.tables["shapes"]
        self._table = table
        self._layout = snapshot.layout
        self._version = table.version
        self._poses = table.doubles("x", "qz").copy()
        self._margins = table["margin"].copy()
        self._reaches = snapshot.shapes().reaches
        owners = table["entity"]
        self._starts = np.flatnonzero(np.diff(owners, prepend=-1))
        self.serial = 1
        self.entities: Ids = owners[self._starts]
        self.travel = np.zeros(len(self._starts) + 1)
        self.moved = np.zeros(len(self._starts) + 1, dtype=np.int64)

    def is_of(self, snapshot: Snapshot) -> bool:
        """Checks whether it knows the shapes of a tick, with these margins."""
        table = snapshot.tables["shapes"]
        return (
            table is self._table
            and table.version == self._version
            and snapshot.layout is self._layout
            and np.array_equal(table["margin"], self._margins)
        )

    def update(self) -> None:
        """Takes note of the poses of the tick."""
        poses, before = self._table.doubles("x", "qz"), self._poses
        has_moved: Flags = (poses.view(np.int64) != before.view(np.int64)).any(axis=0)
        if not has_moved.any():
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
        self.travel[:-1] += np.maximum.reduceat(moves, self._starts)
        self.moved[:-1][np.logical_or.reduceat(has_moved, self._starts)] = self.serial
        self._poses = poses.copy()

    def places(self, ids: Ids) -> Indices:
        """Returns the places of entities; -1 for those without shapes."""
        if not len(self.entities):
            return np.full(len(ids), -1, dtype=np.intp)
        order = np.argsort(self.entities)
        found = np.searchsorted(self.entities, ids, sorter=order)
        places = order[np.minimum(found, len(order) - 1)]
        result: Indices = np.where(self.entities[places] == ids, places, -1)
        return result


class GeometricCalls:
    """The answers of the narrow phase about a world, kept while they hold."""

    def __init__(self) -> None:
        self._snapshot: Snapshot | None = None
        self._motion: _Motion | None = None
        self._clearances: dict[int, _KnownClearance] = {}
        self._answers: dict[tuple[object, ...], tuple[int, float]] = {}

    def begin(self, snapshot: Snapshot) -> int:
        """Begins a tick, which has the shapes; returns a number that changes if they have moved."""
        self._snapshot = snapshot
        if self._motion is None or not self._motion.is_of(snapshot):
            before = 0 if self._motion is None else self._motion.serial
            self._motion = _Motion(snapshot)
            self._motion.serial += before
            self._clearances.clear()
            self._answers.clear()
        else:
            self._motion.update()
        return self._motion.serial

    @property
    def margins(self) -> float:
        """The largest distance, m, of shapes that touch by their margins."""
        assert self._snapshot is not None
        return self._snapshot.margins

    def values(
        self, udf: GeometryUdf, arguments: Sequence[Values], active: Flags | None, count: int
    ) -> Values:
        """Returns the values of a function of shapes, (k, count) or (1, count).

        Args:
            udf: the function.
            arguments: the ids of entities, and the numbers, each broadcastable to the result.
            active: the places at which the values matter; None for all. Elsewhere they are 0.
            count: the number of rows.

        Raises:
            LeftToDuckDBError: an answer is unknown, or an argument is wrong.
        """
        needed = np.ones((1, count), dtype=np.bool_) if active is None else np.atleast_2d(active)
        shape = np.broadcast_shapes(needed.shape, *(argument.shape for argument in arguments))
        places = np.flatnonzero(np.broadcast_to(needed, shape))
        columns = [np.broadcast_to(a, shape).ravel()[places] for a in arguments]
        ids = [column.astype(np.int64) for column in columns[: udf.entities]]
        numbers = [column.astype(np.float64) for column in columns[udf.entities :]]
        if any(np.isnan(column).any() for column in numbers):
            raise LeftToDuckDBError
        if udf.function is ShapeQueries.collides and (numbers[0] < 0.0).any():
            raise LeftToDuckDBError  # evaluated by itself, it raises the error
        result: Values = np.zeros(shape, np.bool_ if udf.result == "BOOLEAN" else np.float64)
        if len(places):
            result.ravel()[places] = self._of_pairs(udf, ids, numbers)
        return result

    def _of_pairs(self, udf: GeometryUdf, ids: Sequence[Ids], numbers: Sequence[Array]) -> Array:
        """Returns the values for m combinations of entities and numbers, (m,)."""
        assert self._motion is not None
        count = len(ids[0])
        values, is_open = np.zeros(count), np.ones(count, dtype=np.bool_)
        reach = self._reach(udf, numbers)
        if reach is not None:
            holds, fails = self._by_bounds(ids[0], ids[1], reach + np.zeros(count))
            if udf.function is ShapeQueries.near:
                values[holds] = 1.0
                is_open &= ~holds
            is_open &= ~fails
        rows = np.flatnonzero(is_open)
        if len(rows):
            keys = np.stack([c[rows].view(np.int64) for c in (*ids, *numbers)], axis=1)
            _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
            distinct = rows[first]
            answers = [
                self._answer(udf, [int(c[row]) for c in ids], [float(c[row]) for c in numbers])
                for row in distinct.tolist()
            ]
            values[rows] = np.array(answers)[inverse.ravel()]
        return values

    def _reach(self, udf: GeometryUdf, numbers: Sequence[Array]) -> Array | float | None:
        """Returns the clearances, m, beyond which a condition fails; None if it is no such one."""
        assert self._snapshot is not None
        match udf.function:
            case ShapeQueries.near:
                return numbers[0]
            case ShapeQueries.touching:
                return numbers[0] + self._snapshot.margins
            case ShapeQueries.on:
                return TOUCHING_DISTANCE + self._snapshot.margins
            case ShapeQueries.collides:
                return 0.0
        return None

    def _by_bounds(self, a: Ids, b: Ids, reach: Array) -> tuple[Flags, Flags]:
        """Returns whether the clearances of m pairs are surely within some distances, or beyond."""
        motion = self._motion
        assert motion is not None
        pairs, first, inverse = np.unique(
            np.minimum(a, b) * ID_FACTOR + np.maximum(a, b), return_index=True, return_inverse=True
        )
        first_places, second_places = motion.places(a[first]), motion.places(b[first])
        travel = motion.travel[first_places] + motion.travel[second_places]
        moved = np.maximum(motion.moved[first_places], motion.moved[second_places])
        has_no_shapes = (first_places < 0) | (second_places < 0)
        largest = np.full(len(pairs), -math.inf)
        np.maximum.at(largest, inverse, reach)
        low, high = np.zeros(len(pairs)), np.full(len(pairs), math.inf)
        low[has_no_shapes] = math.inf
        for place in np.flatnonzero(~has_no_shapes).tolist():
            known = self._clearances.get(int(pairs[place]))
            if known is not None:
                error = float(travel[place]) - known.travel + _TOLERANCE
                low[place], high[place] = known.low - error, known.high + error
        holds, fails = reach >= high[inverse], reach < low[inverse]
        is_open = np.zeros(len(pairs), dtype=np.bool_)
        is_open[inverse[~(holds | fails)]] = True
        for place in np.flatnonzero(is_open).tolist():
            pair, limit = int(pairs[place]), float(largest[place]) + _BEYOND
            known = self._clearances.get(pair)
            if known is None or known.serial < moved[place] or known.low < limit < known.high:
                known = self._compare(pair, limit, float(travel[place]))
                low[place], high[place] = known.low - _TOLERANCE, known.high + _TOLERANCE
        return reach >= high[inverse], reach < low[inverse]

    def _compare(self, pair: int, limit: float, travel: float) -> _KnownClearance:
        """Returns the clearance of two entities at this tick, up to a limit, m."""
        assert self._snapshot is not None
        assert self._motion is not None
        clearance = self._snapshot.shapes().clearance_up_to(*divmod(pair, ID_FACTOR), limit)
        if clearance is None:
            raise LeftToDuckDBError
        low = limit if clearance == math.inf else clearance
        if len(self._clearances) >= _MAX_ANSWERS:
            self._clearances.clear()
        known = _KnownClearance(low, clearance, travel, self._motion.serial)
        self._clearances[pair] = known
        return known

    def _answer(self, udf: GeometryUdf, ids: list[int], numbers: list[float]) -> float:
        """Returns the answer of the narrow phase about some entities."""
        assert self._snapshot is not None
        assert self._motion is not None
        motion = self._motion
        key = (udf.function, *ids, *numbers)
        known = self._answers.get(key)
        if known is not None:
            moved = motion.serial
            if not udf.needs_whole_tick:
                places = motion.places(np.array(ids, np.int64))
                moved = int(motion.moved[places].max())
            if known[0] >= moved:
                return known[1]
        value = udf.function(self._snapshot.shapes(), *ids, *numbers)
        if value is None:
            raise LeftToDuckDBError
        if len(self._answers) >= _MAX_ANSWERS:
            self._answers.clear()
        self._answers[key] = motion.serial, float(value)
        return float(value)
