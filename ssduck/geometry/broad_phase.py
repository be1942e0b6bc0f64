"""The broad phase: which boxes meet, found for all of a tick at once.

A uniform grid for each class of sizes, in sorted arrays: boxes of a class have about the same
extent, and a cell is as large as the largest of them, so that boxes that meet begin in
neighbouring cells. Where along an axis bodies are very far out, the empty cells between are left
out, so that the number of a cell is a whole number of 64 bits however far they are. Boxes without
end, a ground plane's, are compared with all others.
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

# Extents within this factor share a class.
_BASE = 4.0
# A cell is larger than the boxes in it by this share, which is more than rounding may take away.
_MARGIN = 1e-6
# No cell is smaller: the margin of a number near the least there is would round to nothing.
_LEAST = 1e-300
# Corners beyond are as good as without end: their differences might be too large for a number.
_MOST = 1e306
# What the number of a cell stays below.
_NUMBERS = 2**62
# Cells along an axis from which on the empty ones are left out; its cube has such numbers.
_MANY = 2.0**20
# So many candidates are compared at a time, or those of one box.
_AT_ONCE = 250_000
# Pairs of boxes of two sets that are looked at together, and up to twice as many found.
TOGETHER = 20_000
# Rows of cells along z, by their steps along x and y: those ahead, and those behind.
_AHEAD = ((0, 1), (1, -1), (1, 0), (1, 1))
_BEHIND = ((0, -1), (-1, 1), (-1, 0), (-1, -1))


def overlapping_pairs(boxes: Array, apart: float = 0.0) -> Pairs:
    """The pairs of boxes that meet, or are no farther apart along any axis than asked.

    Args:
        boxes: (6, n), the lower corners' x, y, z, then the upper corners', metres. One whose
            lower corner is not below its upper one, or that has a NaN, meets none.
        apart: metres, along each axis.

    Returns:
        The first and the second of each pair, in no order; each pair once.
    """
    pad = 0.5 * apart
    with np.errstate(over="ignore", invalid="ignore"):  # without end, or not a box at all
        low, high = boxes[:3] - pad, boxes[3:] + pad
    here: Flags = np.asarray((low <= high).all(axis=0))
    near = ((low >= -_MOST) & (high <= _MOST)).all(axis=0)
    endless: Flags = np.asarray(here & ~near)
    parts = [_with_others(low, high, one, here, endless) for one in np.flatnonzero(endless)]
    bounded = np.flatnonzero(here & ~endless)
    if len(bounded) > 1:
        pairs = _in_grids(low[:, bounded], high[:, bounded])
        parts += [(bounded[i], bounded[j]) for i, j in pairs]
    if not parts:
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    first, second = zip(*parts, strict=True)
    return np.concatenate(first), np.concatenate(second)


def _with_others(low: Array, high: Array, one: np.intp, here: Flags, endless: Flags) -> Pairs:
    """A box without end with each that it meets; of others without end, the later ones."""
    meets = here & (low <= high[:, one, None]).all(axis=0) & (high >= low[:, one, None]).all(axis=0)
    meets[: one + 1] &= ~endless[: one + 1]
    others = np.flatnonzero(meets)
    return np.full(len(others), one), others


def _in_grids(low: Array, high: Array) -> Iterator[Pairs]:
    """The pairs of bounded boxes that meet, in parts, a class of sizes at a time."""
    extents = np.maximum((high - low).max(axis=0), _LEAST)
    orders = (np.log(extents) - np.log(extents.max())) / np.log(_BASE)
    classes = np.ceil(orders - 1e-9)
    for size in np.unique(classes):
        yield from _in_grid(low, high, classes, extents, size)


def _in_grid(
    low: Array, high: Array, classes: Array, extents: Array, size: float
) -> Iterator[Pairs]:
    """The pairs of a box of a class with one of the same or of a smaller class, in parts."""
    members = np.flatnonzero(classes <= size)
    numbers, wide = _numbered(low[:, members], extents[members].max() * (1.0 + _MARGIN))
    order = np.argsort(numbers, kind="stable")
    members, numbers = members[order], numbers[order]
    low, high = low[:, members], high[:, members]
    same = classes[members] == size
    asking, smaller = np.flatnonzero(same), np.flatnonzero(~same)
    for asked in (asking, smaller) if len(smaller) else (asking,):
        of = numbers[asked]
        alike = asked is asking
        steps = ((0, 0), *_AHEAD, *(() if alike else _BEHIND))
        ways = np.array([(across * wide[1] + along) * wide[2] for across, along in steps])
        rows = numbers[asking] + ways[:, None]
        starts, ends = np.searchsorted(of, rows - 1), np.searchsorted(of, rows + 1, "right")
        if alike:  # in its own row, of two of one class the later one is ahead
            starts[0] = np.arange(1, len(asking) + 1)
        each = np.tile(asking, len(steps))
        for one, places in _runs(each, starts.ravel(), (ends - starts).ravel()):
            i, j = _met(low, high, one, asked[places])
            yield members[i], members[j]


def _numbered(low: Array, cell: float) -> tuple[Cells, list[int]]:
    """The number of the cell of each box, and the grid's width in cells along each axis.

    They are whole numbers, for as floats those of neighbours could be the same. Along an axis there
    are no more than `_MANY` cells or twice the boxes, so only millions of boxes can have too many.
    """
    x, y, z = cells = [_along(axis, cell) for axis in low]
    # A cell around the grid keeps rows from running into each other.
    wide = [int(axis.max()) + 3 for axis in cells]
    if math.prod(wide) > _NUMBERS:
        return _numbered(low, 8.0 * cell)  # boxes that meet are neighbours in a coarser grid too
    return ((x + 1) * wide[1] + y + 1) * wide[2] + z + 1, wide


def _along(low: Array, cell: float) -> Cells:
    """The cell of each box along an axis, from 0 on; boxes that meet are no more than 1 apart.

    They are counted from a box that begins near, not from the origin: the difference of two
    floats is off by no more than 2 ** -53 of itself, so that a count of n cells is off by less than
    n * 2 ** -51, which is within the margin of a cell for n up to 2 ** 31.
    """
    before = low - low.min()
    if before.max() / _MANY <= cell:
        cells: Cells = np.floor(before / cell).astype(np.int64)
        return cells
    # Where the next box begins more than a cell later, none before meets any after: a new group,
    # counted from its own first box, and an empty cell between.
    order = np.argsort(low)
    ascending = low[order]
    begins = np.append(0, np.flatnonzero(np.diff(ascending) > cell) + 1)
    sizes = np.diff(begins, append=len(low))
    within = np.floor((ascending - np.repeat(ascending[begins], sizes)) / cell).astype(np.int64)
    widths = within[begins + sizes - 1] + 2
    cells = np.zeros(len(low), np.int64)
    cells[order] = within + np.repeat(np.cumsum(widths) - widths, sizes)
    return cells


def _runs(asking: Indices, starts: Indices, counts: Indices) -> Iterator[Pairs]:
    """Each that asks with each place of its run; a part at a time, for there may be many."""
    totals = np.cumsum(counts)
    parts = np.searchsorted(totals, np.arange(0, totals[-1], _AT_ONCE), "right")
    for begin, end in pairwise((*parts, len(totals))):
        lengths = counts[begin:end]
        shifts = starts[begin:end] - np.cumsum(lengths) + lengths
        i = np.repeat(asking[begin:end], lengths)
        yield i, np.arange(len(i)) + np.repeat(shifts, lengths)


def _met(low: Array, high: Array, i: Indices, j: Indices) -> Pairs:
    """Of candidates those that meet."""
    for begin, end in zip(low, high, strict=True):
        meets = (begin.take(i) <= end.take(j)) & (begin.take(j) <= end.take(i))
        kept = np.flatnonzero(meets)
        i, j = i.take(kept), j.take(kept)
    return i, j


# -- boxes of two sets ---------------------------------------------------------------------------


def meeting_across(first: Corners, second: Corners, *, rims: bool) -> Iterator[Pairs]:
    """The pairs of a box of one set and a box of another that meet, in parts.

    The larger of two sets that may meet is halved until there are few pairs.

    Args:
        first: the lower and the upper corners, (3, n) each; they may be infinite along z.
        second: the same, (3, m).
        rims: whether boxes meet that have only parts of their rims in common.
    """
    (low, high), (lows, highs) = first, second
    less = np.less_equal if rims else np.less
    todo = [(np.arange(low.shape[1]), np.arange(lows.shape[1]))]
    found: list[Pairs] = []
    count = 0
    while todo:
        i, j = todo.pop()
        i = i[_overlap(less, low[:, i], high[:, i], _least(lows[:, j]), _most(highs[:, j]))]
        j = j[_overlap(less, lows[:, j], highs[:, j], _least(low[:, i]), _most(high[:, i]))]
        if len(i) * len(j) > TOGETHER:
            if len(i) > len(j):
                todo += [(half, j) for half in _halves(i, low[:2, i] + high[:2, i])]
            else:
                todo += [(i, half) for half in _halves(j, lows[:2, j] + highs[:2, j])]
            continue
        a, b = i[:, None], j[None]
        pairs = np.nonzero(_overlap(less, low[:, a], high[:, a], lows[:, b], highs[:, b]))
        found.append((i[pairs[0]], j[pairs[1]]))
        count += len(pairs[0])
        if count > TOGETHER or not todo:
            of_first, of_second = zip(*found, strict=True)
            yield np.concatenate(of_first), np.concatenate(of_second)
            found, count = [], 0


def _overlap(less: np.ufunc, low: Array, high: Array, lows: Array, highs: Array) -> Flags:
    """Whether boxes meet: (3, …) lower and upper corners of either."""
    meet: Flags = np.asarray((less(low, highs) & less(lows, high)).all(axis=0))
    return meet


def _least(low: Array) -> Array:
    least: Array = low.min(axis=1, keepdims=True, initial=math.inf)
    return least


def _most(high: Array) -> Array:
    most: Array = high.max(axis=1, keepdims=True, initial=-math.inf)
    return most


def _halves(some: Indices, places: Array) -> Pairs:
    """Those on either side of the middle one, along the axis along which places (2, n) differ."""
    middle = len(some) // 2
    order = places[np.ptp(places, axis=1).argmax()].argpartition(middle)
    return some[order[:middle]], some[order[middle:]]
