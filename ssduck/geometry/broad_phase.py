"""The broad phase: finds all pairs of boxes of a tick that overlap.

The algorithm compares some tens of boxes with each other. It sorts more boxes into a uniform grid
for each class of sizes. Boxes of a class have about the same extent, and a cell is as large as the
largest of them, so that boxes that overlap begin in neighbouring cells. The empty cells between
bodies that are very far apart are left out, so that cell numbers fit into 64 bits. Unbounded boxes,
such as that of a ground plane, are compared with all others.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array, Flags, Indices

Pairs: TypeAlias = tuple[Indices, Indices]
Corners: TypeAlias = tuple[Array, Array]
Cells: TypeAlias = npt.NDArray[np.int64]

# The ratio of the largest to the smallest extent of a class.
_SIZE_RATIO = 4.0
# A cell exceeds the boxes in it by this fraction, which is more than the rounding errors.
_MARGIN = 1e-6
# The smallest cell: near the smallest float, the margin would be rounded away.
_MIN_CELL = 1e-300
# Boxes with corners beyond count as unbounded: differences of corners could overflow.
_MAX_CORNER = 1e306
# The bound of cell numbers.
_MAX_CELL_NUMBER = 2**62
# Above this number of cells along an axis, empty cells are left out; its cube is below the bound.
_MAX_DENSE_CELLS = 2.0**20
# The largest number of boxes that are all compared with each other.
_MAX_COMPARED = 128
# Whether the row is before the column.
_IS_FIRST = ~np.tri(_MAX_COMPARED, dtype=bool)
# The number of candidates that are compared at a time.
_CANDIDATES_AT_ONCE = 250_000
# The number of pairs of boxes of two sets that are compared at a time; up to twice as many result.
PAIRS_AT_ONCE = 20_000
# Rows of cells along z, by their steps along x and y: the rows ahead, and the rows behind.
_AHEAD = ((0, 1), (1, -1), (1, 0), (1, 1))
_BEHIND = ((0, -1), (-1, 1), (-1, 0), (-1, -1))


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
    is_box: Flags = np.asarray((low <= high).all(axis=0))
    is_bounded = ((low >= -_MAX_CORNER) & (high <= _MAX_CORNER)).all(axis=0)
    is_unbounded: Flags = np.asarray(is_box & ~is_bounded)
    parts = [
        _pairs_of_unbounded(low, high, box, is_box, is_unbounded)
        for box in np.flatnonzero(is_unbounded)
    ]
    bounded = np.flatnonzero(is_box & ~is_unbounded)
    if len(bounded) > 1:
        pairs = _grid_pairs(low[:, bounded], high[:, bounded])
        parts += [(bounded[i], bounded[j]) for i, j in pairs]
    if not parts:
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
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


def _pairs_of_unbounded(
    low: Array, high: Array, box: np.intp, is_box: Flags, is_unbounded: Flags
) -> Pairs:
    """Returns the pairs of an unbounded box with bounded or later boxes that it overlaps."""
    overlaps = (
        is_box & (low <= high[:, box, None]).all(axis=0) & (high >= low[:, box, None]).all(axis=0)
    )
    overlaps[: box + 1] &= ~is_unbounded[: box + 1]
    others = np.flatnonzero(overlaps)
    return np.full(len(others), box), others


def _grid_pairs(low: Array, high: Array) -> Iterator[Pairs]:
    """Returns the pairs of bounded boxes that overlap, one class of sizes after another."""
    extents = np.maximum((high - low).max(axis=0), _MIN_CELL)
    orders = (np.log(extents) - np.log(extents.max())) / np.log(_SIZE_RATIO)
    classes = np.ceil(orders - 1e-9)
    for size in np.unique(classes):
        yield from _grid_pairs_of_class(low, high, classes, extents, size)


def _grid_pairs_of_class(
    low: Array, high: Array, classes: Array, extents: Array, size: float
) -> Iterator[Pairs]:
    """Returns the pairs of a box of a class with a box of the same or of a smaller class."""
    members = np.flatnonzero(classes <= size)
    numbers, widths = _cell_numbers(low[:, members], extents[members].max() * (1.0 + _MARGIN))
    order = np.argsort(numbers, kind="stable")
    members, numbers = members[order], numbers[order]
    low, high = low[:, members], high[:, members]
    in_class = classes[members] == size
    larger, smaller = np.flatnonzero(in_class), np.flatnonzero(~in_class)
    for targets in (larger, smaller) if len(smaller) else (larger,):
        target_numbers = numbers[targets]
        is_same_class = targets is larger
        steps = ((0, 0), *_AHEAD, *(() if is_same_class else _BEHIND))
        row_offsets = np.array(
            [(across * widths[1] + along) * widths[2] for across, along in steps]
        )
        rows = numbers[larger] + row_offsets[:, None]
        starts, ends = (
            np.searchsorted(target_numbers, rows - 1),
            np.searchsorted(target_numbers, rows + 1, "right"),
        )
        if is_same_class:  # of two boxes in one row, the later one is ahead
            starts[0] = np.arange(1, len(larger) + 1)
        repeated = np.tile(larger, len(steps))
        for boxes, places in _run_pairs(repeated, starts.ravel(), (ends - starts).ravel()):
            i, j = _overlapping(low, high, boxes, targets[places])
            yield members[i], members[j]


def _cell_numbers(low: Array, cell: float) -> tuple[Cells, list[int]]:
    """Returns the cell number of each box, and the grid's width in cells along each axis."""
    # Integers: as floats, the numbers of neighbours could be equal.
    x, y, z = cells = [_cells_along(axis, cell) for axis in low]
    # A cell around the grid keeps rows from running into each other.
    widths = [int(axis.max()) + 3 for axis in cells]
    if math.prod(widths) > _MAX_CELL_NUMBER:
        return _cell_numbers(
            low, 8.0 * cell
        )  # boxes that overlap are neighbours in a coarser grid too
    return ((x + 1) * widths[1] + y + 1) * widths[2] + z + 1, widths


def _cells_along(low: Array, cell: float) -> Cells:
    """Returns the cells of boxes along an axis; those of overlapping boxes differ by 1 at most."""
    # Counted from a box that begins nearby, not from the origin: a count of n cells is then off
    # by less than n * 2 ** -51, which is within a cell's margin for n up to 2 ** 31.
    offsets = low - low.min()
    if offsets.max() / _MAX_DENSE_CELLS <= cell:
        cells: Cells = np.floor(offsets / cell).astype(np.int64)
        return cells
    # A gap of more than a cell separates the boxes before it from those after it: they form
    # groups that are counted from their own first boxes, with an empty cell between them.
    order = np.argsort(low)
    ascending = low[order]
    group_starts = np.append(0, np.flatnonzero(np.diff(ascending) > cell) + 1)
    sizes = np.diff(group_starts, append=len(low))
    cells_in_group = np.floor(
        (ascending - np.repeat(ascending[group_starts], sizes)) / cell
    ).astype(np.int64)
    widths = cells_in_group[group_starts + sizes - 1] + 2
    cells = np.zeros(len(low), np.int64)
    cells[order] = cells_in_group + np.repeat(np.cumsum(widths) - widths, sizes)
    return cells


def _run_pairs(larger: Indices, starts: Indices, counts: Indices) -> Iterator[Pairs]:
    """Returns pairs of each box with each place of its run, in parts that fit into memory."""
    totals = np.cumsum(counts)
    parts = np.searchsorted(totals, np.arange(0, totals[-1], _CANDIDATES_AT_ONCE), "right")
    for begin, end in pairwise((*parts, len(totals))):
        lengths = counts[begin:end]
        shifts = starts[begin:end] - np.cumsum(lengths) + lengths
        i = np.repeat(larger[begin:end], lengths)
        yield i, np.arange(len(i)) + np.repeat(shifts, lengths)


def _overlapping(low: Array, high: Array, i: Indices, j: Indices) -> Pairs:
    """Returns the candidate pairs that overlap."""
    for begin, end in zip(low, high, strict=True):
        overlaps = (begin.take(i) <= end.take(j)) & (begin.take(j) <= end.take(i))
        hits = np.flatnonzero(overlaps)
        i, j = i.take(hits), j.take(hits)
    return i, j


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
