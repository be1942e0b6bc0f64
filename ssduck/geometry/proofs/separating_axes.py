"""The overlaps of pairs of boxes along the 15 axes that may separate them.

Two convex shapes are apart if and only if their shadows on some axis are. Of two boxes, one of 15
axes does it if any does: the normals of three faces of each, and the cross products of an edge of
one with an edge of the other (Gottschalk, Lin and Manocha, OBBTree, 1996). Of boxes that meet, the
axis of least overlap is the contact normal.

    [  a  ]    [ b ]
    |-----|    |---|    ---> an axis: the shadows leave a gap, so that the boxes are apart
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.proofs.cores import PlacedCores

# The cross product of edges that are more parallel is no separating axis.
_MIN_SINE = 1e-6
# The axes, and the first two again: behind each are the other two.
_AROUND = np.array([0, 1, 2, 0, 1])
_NEXT, _LAST = slice(1, 4), slice(2, 5)


@dataclass(frozen=True, eq=False)
class BoxAxes:
    """The axes of pairs of boxes: the faces of the first, those of the second, pairs of edges.

    Attributes:
        overlaps: (15, n), metres; negative for an axis that separates the boxes, infinite for
            edges that are parallel.
        distances: (15, n), of the centres along the axes, metres.
        directions_z: (15, n), the height in the world of the unit axis from the first box to the
            second.
        is_doubtful: (n,), whether edges are so nearly parallel that another computation may leave
            out an axis, or take it.
    """

    overlaps: Array
    distances: Array
    directions_z: Array
    is_doubtful: Flags


class _BoxPairs:
    """Pairs of boxes, the second in the frame of the first."""

    def __init__(self, cores: PlacedCores, first: Indices, second: Indices) -> None:
        half_extents, rotations, centres = cores.cores.half_extents, cores.rotations, cores.centres
        self.a, self.b = half_extents.take(first, axis=1), half_extents.take(second, axis=1)
        self.matrices_a = matrices_a = rotations.take(first, axis=1).reshape(3, 3, -1)
        self.matrices_b = matrices_b = rotations.take(second, axis=1).reshape(3, 3, -1)
        between = centres.take(second, axis=1) - centres.take(first, axis=1)
        around = matrices_a.take(_AROUND, axis=1)
        self._rotations = _sum_of_products(around[:, :, None], matrices_b[:, None])
        self._offsets = _sum_of_products(around, between[:, None])
        self.rotations, self.offsets = self._rotations[:3], self._offsets[:3]
        self.offsets_b = _sum_of_products(self.rotations, self.offsets[:, None])
        self.sines = np.sqrt(np.maximum(1.0 - self.rotations * self.rotations, 0.0))

    def overlaps(self) -> Array:
        """Returns the overlaps along all axes, (15, n)."""
        a, b, magnitudes = self.a, self.b, np.abs(self._rotations)
        rows_next, rows_last, magnitudes = magnitudes[_NEXT], magnitudes[_LAST], magnitudes[:3]
        count = a.shape[1]
        overlaps = np.zeros((15, count))
        overlaps[:3] = a + _sum_of_products(magnitudes.swapaxes(0, 1), b[:, None])
        overlaps[:3] -= np.abs(self.offsets)
        overlaps[3:6] = b + _sum_of_products(magnitudes, a[:, None])
        overlaps[3:6] -= np.abs(self.offsets_b)
        edges = overlaps[6:].reshape(3, 3, count)
        a, b = a.take(_AROUND, axis=0), b.take(_AROUND, axis=0)
        columns = magnitudes.take(_AROUND, axis=1)
        np.multiply(a[_NEXT, None], rows_last, out=edges)
        edges += a[_LAST, None] * rows_next
        edges += b[_NEXT] * columns[:, _LAST] + b[_LAST] * columns[:, _NEXT]
        edges -= np.abs(self.edge_distances())
        is_parallel = self.sines < _MIN_SINE
        edges /= np.where(is_parallel, 1.0, self.sines)
        edges[is_parallel] = np.inf
        return overlaps

    def edge_distances(self) -> Array:
        """Returns the offsets along the cross products of edges, times their sines, (3, 3, n)."""
        distances: Array = self._offsets[_LAST, None] * self._rotations[_NEXT]
        distances -= self._offsets[_NEXT, None] * self._rotations[_LAST]
        return distances


def _sum_of_products(first: Array, second: Array) -> Array:
    """Returns the sums of products over the first axis, of length 3."""
    total: Array = first[0] * second[0]
    total += first[1] * second[1]
    total += first[2] * second[2]
    return total


def box_depths(cores: PlacedCores, first: Indices, second: Indices) -> Array:
    """Returns the depths of pairs of boxes, m: their least overlaps along 15 axes, signed."""
    depths: Array = _BoxPairs(cores, first, second).overlaps().min(axis=0)
    return depths


def box_axes(cores: PlacedCores, first: Indices, second: Indices) -> BoxAxes:
    """Returns the axes of pairs of boxes, with their overlaps."""
    pairs = _BoxPairs(cores, first, second)
    count, sines = len(first), pairs.sines
    lengths = np.where(sines < _MIN_SINE, 1.0, sines)
    # Along the cross product of the edges: signed as `a_i x b_j`.
    distances = np.concatenate(
        (pairs.offsets, pairs.offsets_b, (pairs.edge_distances() / lengths).reshape(9, count))
    )
    (xs_a, ys_a, zs_a), (xs_b, ys_b, zs_b) = pairs.matrices_a, pairs.matrices_b
    crossed_z = xs_a[:, None] * ys_b - ys_a[:, None] * xs_b
    heights = np.concatenate((zs_a, zs_b, (crossed_z / lengths).reshape(9, count)))
    is_near = (sines > _MIN_SINE / 2) & (sines < _MIN_SINE * 2)
    is_doubtful: Flags = np.asarray(is_near.any(axis=(0, 1)))
    return BoxAxes(
        pairs.overlaps(), np.abs(distances), np.copysign(heights, heights * distances), is_doubtful
    )
