"""Finds all pairs of entities of a tick of which one's position lies in or over the other's box.

Positions are sorted into strips along x with as many of them each, and by y in each strip. A box
spans two or three strips. In each, a binary search gives the positions whose y is within the box.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import TypeAlias

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices, ranges
from ssduck.geometry.broad_phase import IdPairs, Ids, Pairs, portions

# Takes the boxes, (6, n), the positions, (3, n), and pairs.
PairCondition: TypeAlias = Callable[[Array, Array, Indices, Indices], Flags]


class BoxQueries:
    """Finds the pairs of a tick for which a relation of a box and a position holds.

    The relations compare as their formulas in SQL do; with an unknown number (NaN), none holds.

    Args:
        boxes: (6, n), of the entities in the order of `ids`: lower corners, upper corners.
        positions: (3, n).
        ids: (n,), the ids.
    """

    def __init__(self, boxes: Array, positions: Array, ids: Ids) -> None:
        self._boxes = boxes
        self._positions = positions
        self._ids = ids
        self._pairs: dict[PairCondition, IdPairs] = {}

    def all_above(self) -> IdPairs:
        """Returns the pairs of which the second's position is above the first's box.

        They are in the order of the first entities, then of the second ones. So it is in the other
        methods.
        """
        return self._all(_is_above)

    def all_below(self) -> IdPairs:
        """Returns the pairs of which the second's position is below the first's box's centre."""
        return self._all(_is_below)

    def all_inside(self) -> IdPairs:
        """Returns the pairs of which the second's position is inside the first's box."""
        return self._all(_is_inside)

    def _all(self, condition: PairCondition) -> IdPairs:
        if condition not in self._pairs:
            self._pairs[condition] = IdPairs(self._ids, *self._found(condition))
        return self._pairs[condition]

    def _found(self, condition: PairCondition) -> Pairs:
        boxes, positions, count = self._boxes, self._positions, len(self._ids)
        parts = [np.zeros(0, np.intp)]
        for first, second in positions_over_boxes(boxes[[0, 1]], boxes[[3, 4]], positions[:2]):
            holds = condition(boxes, positions, first, second) & (first != second)
            parts.append(first[holds] * count + second[holds])
        first, second = np.divmod(np.sort(np.concatenate(parts)), max(count, 1))
        return first, second


def _is_above(boxes: Array, positions: Array, first: Indices, second: Indices) -> Flags:
    return np.asarray(positions[2, second] >= boxes[5, first])


@np.errstate(invalid="ignore")  # boxes of planes are infinite
def _is_below(boxes: Array, positions: Array, first: Indices, second: Indices) -> Flags:
    # The box of a level plane has no centre, but a surface.
    high = np.where(boxes[5] == np.inf, boxes[2], boxes[5])
    low = np.where(boxes[2] == -np.inf, high, boxes[2])
    return np.asarray(2 * positions[2, second] < (low + high)[first])


def _is_inside(boxes: Array, positions: Array, first: Indices, second: Indices) -> Flags:
    result = np.ones(len(first), bool)
    for axis in range(3):
        place = positions[axis, second]
        result &= (place > boxes[axis, first]) & (place < boxes[axis + 3, first])
    return result


def positions_over_boxes(low: Array, high: Array, positions: Array) -> Iterator[Pairs]:
    """Yields the boxes and positions whose x and y are within the boxes, edges included, in parts.

    >>> low, high = np.array([[0.0], [0.0]]), np.array([[2.0], [1.0]])
    >>> positions = np.array([[0.5, 3.0, 2.0], [0.5, 0.5, 1.0]])
    >>> [(box.tolist(), position.tolist()) for box, position in
    ...  positions_over_boxes(low, high, positions)]
    [([0, 0], [0, 2])]
    """
    boxes = np.flatnonzero((low <= high).all(axis=0))  # not with NaN
    points = np.flatnonzero(~np.isnan(positions).any(axis=0))
    if not len(boxes) or not len(points):
        return
    x, y = np.sort(positions[:, points])
    begins, ends = np.searchsorted(x, low[0, boxes]), np.searchsorted(x, high[0, boxes], "right")
    size = int(max((ends - begins).mean(), math.sqrt(len(points))))
    # By strip, then by y; in place of y its rank, so that both fit into one key.
    points = points[np.argsort(positions[1, points], kind="stable")]
    keys = np.searchsorted(x, positions[0, points]) // size * (len(points) + 1)
    keys += np.arange(len(points))
    order = np.argsort(keys)
    keys, points = keys[order], points[order]
    rows, strips = ranges(begins // size, np.maximum(-(-ends // size) - begins // size, 0))
    key = strips * (len(points) + 1)
    starts = np.searchsorted(keys, key + np.searchsorted(y, low[1, boxes])[rows])
    ends = np.searchsorted(keys, key + np.searchsorted(y, high[1, boxes], "right")[rows])
    boxes = boxes[rows]
    for part in portions(ends - starts):
        rows, places = ranges(starts[part], (ends - starts)[part])
        box, point = boxes[part][rows], points[places]
        at = positions[0, point]
        within = (at >= low[0, box]) & (at <= high[0, box])
        yield box[within], point[within]
