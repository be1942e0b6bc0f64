"""The broad phase: finds all pairs of boxes of a tick that overlap.

The algorithm compares some tens of boxes with each other. It sorts more boxes into cells: strips
along each axis but the last, with as many corners each. A box spans about two strips of each axis.
In each cell, the boxes are sorted along the last axis, so that a binary search gives those that
begin within a box. Only the order of corners counts: no size, and no distance, is too large.

       | a    |      |     a: in the first two strips, and so is b; c is in the last two
       | [---a--]    |     the pair a b is found in the first cell in which both are
       |   [-b--] [-c|-]
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Self, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array, Flags, Indices, ranges
from ssduck.schema import ID_FACTOR

Ids: TypeAlias = npt.NDArray[np.int64]
Pairs: TypeAlias = tuple[Indices, Indices]
Corners: TypeAlias = tuple[Array, Array]

# The largest number of boxes that are all compared with each other.
_MAX_COMPARED = 128
# Whether the row is before the column.
_IS_FIRST = ~np.tri(_MAX_COMPARED, dtype=bool)
# The number of candidates that are compared at a time.
_CANDIDATES_AT_ONCE = 250_000
# The number of pairs of boxes of two sets that are compared at a time; up to twice as many result.
PAIRS_AT_ONCE = 20_000


def overlapping_pairs(boxes: Array, max_distance: float = 0.0) -> Pairs:
    """Returns the pairs of boxes that overlap or touch, or are near each other along every axis.

    >>> boxes = np.array([[0, 0, 0, 1, 1, 1], [0.5, 0, 0, 2, 1, 1], [5, 5, 5, 6, 6, 6]], float).T
    >>> [side.tolist() for side in overlapping_pairs(boxes)]
    [[0], [1]]
    """
    low, high = boxes[:3], boxes[3:]
    if max_distance != 0.0:
        pad = 0.5 * max_distance
        with np.errstate(over="ignore", invalid="ignore"):  # unbounded, or no box
            low, high = low - pad, high + pad
    if low.shape[1] <= _MAX_COMPARED:
        return _compared_pairs(low, high)
    none = np.zeros(0, np.intp)
    parts = (none, none), *_pairs_in_cells(low, high)
    first, second = map(np.concatenate, zip(*parts, strict=True))
    return np.minimum(first, second), np.maximum(first, second)


def _compared_pairs(low: Array, high: Array) -> Pairs:
    """Returns the pairs of boxes that overlap, by a comparison of all of them."""
    begins_before: Flags = low[0, :, None] <= high[0]
    for begin, end in zip(low[1:], high[1:], strict=True):
        begins_before &= begin[:, None] <= end
    overlaps: Flags = begins_before & begins_before.T
    is_box = begins_before.diagonal()
    if not is_box.all():
        overlaps &= is_box & is_box[:, None]
    count = len(overlaps)
    overlaps &= _IS_FIRST[:count, :count]
    first, second = np.divmod(overlaps.ravel().nonzero()[0], count)
    return first, second


def _pairs_in_cells(low: Array, high: Array) -> Iterator[Pairs]:
    """Yields the pairs of boxes that overlap or touch, each once, in parts."""
    is_box = np.flatnonzero((low <= high).all(axis=0))
    low, high = low[:, is_box], high[:, is_box]
    count = len(is_box)
    boxes, firsts = np.arange(count), []
    places: list[Indices] = []
    for begin, end in zip(low[:-1], high[:-1], strict=True):
        first, last = _strips(begin, end)
        rows, strips = ranges(first[boxes], (last - first + 1)[boxes])
        boxes, places = boxes[rows], [*(place[rows] for place in places), strips]
        firsts.append(first)
    order = np.argsort(low[-1], kind="stable")
    ranks = np.argsort(order)
    cells = sum(place * (count + 1) ** axis for axis, place in enumerate(places, 1))
    by_cell = np.argsort(cells + ranks[boxes])
    boxes, cells = boxes[by_cell], cells[by_cell]
    ends = np.searchsorted(low[-1][order], high[-1], "right")[boxes]
    ends = np.searchsorted(cells + ranks[boxes], cells + ends)
    starts = np.arange(1, len(boxes) + 1)
    for part in portions(ends - starts):
        rows, others = ranges(starts[part], (ends - starts)[part])
        i, j = boxes[part][rows], boxes[others]
        is_new = np.ones(len(i), dtype=bool)
        for first, place in zip(firsts, places, strict=True):
            is_new &= place[by_cell[part]][rows] == np.maximum(first[i], first[j])
        i, j = i[is_new], j[is_new]
        for begin, end in zip(low[:-1], high[:-1], strict=True):
            hits = np.flatnonzero((begin.take(i) <= end.take(j)) & (begin.take(j) <= end.take(i)))
            i, j = i.take(hits), j.take(hits)
        yield is_box[i], is_box[j]


def _strips(begin: Array, end: Array) -> Pairs:
    """Returns the first and the last strip of each box along an axis."""
    sorted_begins = np.sort(begin)
    first = np.searchsorted(sorted_begins, begin, "right")
    last = np.searchsorted(sorted_begins, end, "right")
    # A box without end is in all cells, which are not more than the boxes.
    size = max((last - first).mean(), math.sqrt(len(begin))) if len(begin) else 1
    return first // int(size), last // int(size)


def portions(lengths: Indices) -> Iterator[slice]:
    """Yields the parts of ranges that have about `_CANDIDATES_AT_ONCE` elements each."""
    ends = np.cumsum(lengths)
    start = 0
    while start < len(lengths):
        limit = (ends[start - 1] if start else 0) + _CANDIDATES_AT_ONCE
        end = max(start + 1, int(np.searchsorted(ends, limit, "right")))
        yield slice(start, end)
        start = end


# -- boxes of two sets ---------------------------------------------------------------------------


def overlapping_pairs_across(first: Corners, second: Corners, *, touching: bool) -> Iterator[Pairs]:
    """Returns the pairs of a box of one set and a box of another that overlap, in parts.

    The larger of the two sets is halved until few pairs are left.
    """
    (low, high), (lows, highs) = first, second
    less = np.less_equal if touching else np.less
    pending = [(np.arange(low.shape[1]), np.arange(lows.shape[1]))]
    parts: list[Pairs] = []
    count = 0
    while pending:
        i, j = pending.pop()
        i = i[_overlap(less, low[:, i], high[:, i], _lowest(lows[:, j]), _highest(highs[:, j]))]
        j = j[_overlap(less, lows[:, j], highs[:, j], _lowest(low[:, i]), _highest(high[:, i]))]
        if len(i) * len(j) > PAIRS_AT_ONCE:
            if len(i) > len(j):
                pending += [(half, j) for half in _halves(i, low[:2, i] + high[:2, i])]
            else:
                pending += [(i, half) for half in _halves(j, lows[:2, j] + highs[:2, j])]
            continue
        a, b = i[:, None], j[None]
        pairs = np.nonzero(_overlap(less, low[:, a], high[:, a], lows[:, b], highs[:, b]))
        parts.append((i[pairs[0]], j[pairs[1]]))
        count += len(pairs[0])
        if count > PAIRS_AT_ONCE or not pending:
            of_first, of_second = zip(*parts, strict=True)
            yield np.concatenate(of_first), np.concatenate(of_second)
            parts, count = [], 0


def _overlap(less: np.ufunc, low: Array, high: Array, lows: Array, highs: Array) -> Flags:
    """Checks whether boxes overlap, by their lower and upper corners (3, …)."""
    overlap: Flags = np.asarray((less(low, highs) & less(lows, high)).all(axis=0))
    return overlap


def _lowest(low: Array) -> Array:
    lowest: Array = low.min(axis=1, keepdims=True, initial=math.inf)
    return lowest


def _highest(high: Array) -> Array:
    highest: Array = high.max(axis=1, keepdims=True, initial=-math.inf)
    return highest


def _halves(indices: Indices, positions: Array) -> Pairs:
    """Returns the two halves of a set, split at the median along the axis of the largest range."""
    middle = len(indices) // 2
    order = positions[np.ptp(positions, axis=1).argmax()].argpartition(middle)
    return indices[order[:middle]], indices[order[middle:]]


# -- pairs by the ids of entities ----------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class IdPairs:
    """Pairs of entities.

    Attributes:
        ids: the ids of all entities, in the order of their table.
        first: (n,), the places of the first entities there.
        second: (n,), those of the second ones.
    """

    ids: Ids
    first: Indices
    second: Indices

    @classmethod
    def sorted(cls, ids: Ids, first: Indices, second: Indices) -> Self:
        """Returns pairs in the order of their numbers."""
        order = _numbers(ids, first, second).argsort()
        return cls(ids, first.take(order), second.take(order))

    @classmethod
    def in_both_orders(cls, ids: Ids, first: Indices, second: Indices) -> Self:
        """Returns pairs in the order of their numbers, each pair in both orders."""
        both = np.concatenate((first, second)), np.concatenate((second, first))
        return cls.sorted(ids, *both)

    @cached_property
    def numbers(self) -> list[int]:
        """The pairs as numbers, `first * ID_FACTOR + second` of the ids."""
        numbers: list[int] = _numbers(self.ids, self.first, self.second).tolist()
        return numbers


def _numbers(ids: Ids, first: Indices, second: Indices) -> Ids:
    numbers = ids.take(first)
    numbers *= ID_FACTOR
    numbers += ids.take(second)
    return numbers


def places_by_number(numbers: Mapping[int, int], ids: Ids) -> Indices:
    """Returns the place of each number of an entity among the ids of all, by the number."""
    places = np.zeros(1 + max(numbers.values(), default=-1), np.intp)
    places[[numbers[id] for id in ids.tolist()]] = np.arange(len(ids))
    return places
