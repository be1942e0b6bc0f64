"""The broad phase: which boxes meet, found for all of a tick at once.

A uniform grid for each class of sizes, in sorted arrays: boxes of a class have about the same
extent, and a cell is as large as the largest of them, so that boxes that meet begin in
neighbouring cells. Boxes without end, a ground plane's, are compared with all others.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.geometry import Array, Indices

Flags: TypeAlias = npt.NDArray[np.bool_]
Pairs: TypeAlias = tuple[Indices, Indices]

# Extents within this factor share a class.
_BASE = 4.0
# Rows of cells along z, by their steps along x and y: those ahead, and those behind.
_AHEAD = ((0, 1), (1, -1), (1, 0), (1, 1))
_BEHIND = ((0, -1), (-1, 1), (-1, 0), (-1, -1))


def meeting(boxes: Array, apart: float = 0.0) -> Pairs:
    """The pairs of boxes that meet, or are no farther apart along any axis than asked.

    Args:
        boxes: (6, n), the lower corners' x, y, z, then the upper corners', metres. One whose
            lower corner is not below its upper one, or that has a NaN, meets none.
        apart: metres, along each axis.

    Returns:
        The first and the second of each pair, in no order; each pair once.
    """
    pad = 0.5 * apart
    low, high = boxes[:3] - pad, boxes[3:] + pad
    here: Flags = np.asarray((low <= high).all(axis=0))
    endless: Flags = np.asarray(here & ~np.isfinite(boxes).all(axis=0))
    parts = [_with_others(low, high, one, here, endless) for one in np.flatnonzero(endless)]
    bounded = np.flatnonzero(here & ~endless)
    if len(bounded) > 1:
        i, j = _in_grids(low[:, bounded], high[:, bounded])
        parts.append((bounded[i], bounded[j]))
    if not parts:
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    return _joined(parts)


def _joined(parts: list[Pairs]) -> Pairs:
    first, second = zip(*parts, strict=True)
    return np.concatenate(first), np.concatenate(second)


def _with_others(low: Array, high: Array, one: np.intp, here: Flags, endless: Flags) -> Pairs:
    """A box without end with each that it meets; of others without end, the later ones."""
    meets = here & (low <= high[:, one, None]).all(axis=0) & (high >= low[:, one, None]).all(axis=0)
    meets[: one + 1] &= ~endless[: one + 1]
    others = np.flatnonzero(meets)
    return np.full(len(others), one), others


def _in_grids(low: Array, high: Array) -> Pairs:
    """The pairs of bounded boxes that meet, a class of sizes at a time."""
    extents = (high - low).max(axis=0)
    largest = extents.max() or 1.0
    shares = np.maximum(extents, largest * 1e-6) / largest
    classes = np.ceil(np.log(shares) / np.log(_BASE) - 1e-9)
    return _joined([_in_grid(low, high, classes, extents, size) for size in np.unique(classes)])


def _in_grid(low: Array, high: Array, classes: Array, extents: Array, size: float) -> Pairs:
    """The pairs of a box of a class with one of the same or of a smaller class."""
    members = np.flatnonzero(classes <= size)
    cell = extents[members].max() * (1.0 + 1e-9) or 1.0
    cells = np.floor((low[:, members] - low[:, members].min(axis=1, keepdims=True)) / cell)
    # A cell's number; a cell around the grid keeps rows from running into each other.
    wide = cells.max(axis=1) + 3.0
    numbers = ((cells[0] + 1.0) * wide[1] + cells[1] + 1.0) * wide[2] + cells[2] + 1.0
    order = np.argsort(numbers, kind="stable")
    members, numbers = members[order], numbers[order]
    low, high = low[:, members], high[:, members]
    same = classes[members] == size
    asking, smaller = np.flatnonzero(same), np.flatnonzero(~same)
    found = []
    for asked in (asking, smaller) if len(smaller) else (asking,):
        of = numbers[asked]
        alike = asked is asking
        for across, along in ((0, 0), *_AHEAD, *(() if alike else _BEHIND)):
            row = numbers[asking] + (across * wide[1] + along) * wide[2]
            # In its own row, of two of one class the later one is ahead.
            own = alike and not (across or along)
            starts = np.arange(1, len(asking) + 1) if own else np.searchsorted(of, row - 1.0)
            counts = np.searchsorted(of, row + 1.0, "right") - starts
            i = np.repeat(asking, counts)
            places = np.arange(len(i)) + np.repeat(starts - np.cumsum(counts) + counts, counts)
            found.append(_met(low, high, i, asked[places]))
    first, second = _joined(found)
    return members[first], members[second]


def _met(low: Array, high: Array, i: Indices, j: Indices) -> Pairs:
    """Of candidates those that meet."""
    for axis in range(3):
        meets = (low[axis, i] <= high[axis, j]) & (low[axis, j] <= high[axis, i])
        i, j = i[meets], j[meets]
    return i, j
