"""Finds all pairs of entities of a tick of which one's position lies in or over the other's box.

Positions are sorted into strips along x, and by y in each strip. A strip is about as wide as a box,
so a box spans two or three. In each of them, a binary search gives the positions whose y is within
the box. A large box spans many strips, but all boxes together span few more than there are boxes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeAlias

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.id_pairs import IdPairs, Ids

# The places of the first and of the second entity of each pair.
Pairs: TypeAlias = tuple[Indices, Indices]
# Takes the boxes, (6, n), the positions, (3, n), and pairs.
PairCondition: TypeAlias = Callable[[Array, Array, Indices, Indices], Flags]

# The number of candidates that are compared at a time.
_CANDIDATES_AT_ONCE = 500_000


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


def positions_over_boxes(
    low: Array, high: Array, positions: Array
) -> Iterator[tuple[Indices, Indices]]:
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
    strip_of = _strips(low[0, boxes], high[0, boxes], positions[0, points])
    # By strip, then by y; in place of y its rank, so that both fit into one key.
    by_y = np.argsort(positions[1, points], kind="stable")
    heights, points = positions[1, points[by_y]], points[by_y]
    keys = strip_of(positions[0, points]) * (len(points) + 1) + np.arange(len(points))
    order = np.argsort(keys)
    keys, points = keys[order], points[order]
    first_strips, last_strips = strip_of(low[0, boxes]), strip_of(high[0, boxes])
    counts = last_strips - first_strips + 1
    searched, strips = _runs(first_strips, counts)
    boxes = boxes[searched]
    key = strips * (len(points) + 1)
    starts = np.searchsorted(keys, key + np.searchsorted(heights, low[1], "left")[boxes])
    ends = np.searchsorted(keys, key + np.searchsorted(heights, high[1], "right")[boxes])
    lengths = ends - starts
    for part in _portions(lengths):
        rows, places = _runs(starts[part], lengths[part])
        box, point = boxes[part][rows], points[places]
        x = positions[0, point]
        within = (x >= low[0, box]) & (x <= high[0, box])
        yield box[within], point[within]


def _strips(low: Array, high: Array, x: Array) -> Callable[[Array], Indices]:
    """Returns the function from coordinates to the numbers of strips, which never decreases."""
    finite = x[np.isfinite(x)]
    start, end = (finite.min(), finite.max()) if len(finite) else (0.0, 0.0)
    count = 4 * (len(low) + len(x))
    with np.errstate(over="ignore"):
        width = float(np.mean(np.clip(high, start, end) - np.clip(low, start, end)))
        width = max(width, (end - start) / count)
    if not (0.0 < width < np.inf):
        return lambda coordinates: np.zeros(len(coordinates), np.int64)

    def strip_of(coordinates: Array) -> Indices:
        with np.errstate(over="ignore"):
            numbers = np.floor((np.clip(coordinates, start, end) - start) / width)
        return np.clip(numbers, 0, count).astype(np.int64)

    return strip_of


def _runs(starts: Indices, counts: Indices) -> tuple[Indices, Indices]:
    """Returns the row and the value of each element of ranges `starts + [0, counts)`."""
    rows = np.repeat(np.arange(len(starts)), counts)
    ends = np.cumsum(counts)
    values = np.arange(len(rows)) + np.repeat(starts - ends + counts, counts)
    return rows, values


def _portions(lengths: Indices) -> Iterator[slice]:
    """Yields the parts of ranges that have about `_CANDIDATES_AT_ONCE` elements each."""
    ends = np.cumsum(lengths)
    start = 0
    while start < len(lengths):
        limit = (ends[start - 1] if start else 0) + _CANDIDATES_AT_ONCE
        end = max(start + 1, int(np.searchsorted(ends, limit, "right")))
        yield slice(start, end)
        start = end
