"""The overlaps of pairs of boxes along the 15 axes that may separate them (Gottschalk 1996)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices

# The cross product of edges that are more parallel is no separating axis.
_MIN_SINE = 1e-6
# The other two axes of each axis.
_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])


class PlacedBoxes(Protocol):
    """Boxes at poses; of other shapes, half the sizes have no meaning."""

    @property
    def half_extents(self) -> Array:
        """Half the sizes, (3, n), metres."""

    @property
    def positions(self) -> Array:
        """The centres, (n, 3)."""

    @property
    def matrices(self) -> Array:
        """The rotation matrices, (n, 3, 3)."""


@dataclass(frozen=True, eq=False)
class BoxAxes:
    """The axes of pairs of boxes: the faces of the first, those of the second, pairs of edges.

    Attributes:
        overlaps: (n, 15), metres; negative for an axis that separates the boxes, infinite for
            edges that are parallel.
        distances: (n, 15), of the centres along the axes, metres.
        directions_z: (n, 15), the height in the world of the unit axis from the first box to the
            second.
        is_doubtful: (n,), whether edges are so nearly parallel that another computation may leave
            out an axis, or take it.
    """

    overlaps: Array
    distances: Array
    directions_z: Array
    is_doubtful: Flags


@dataclass(frozen=True, eq=False)
class _Relative:
    """Pairs of boxes, the second in the frame of the first.

    Attributes:
        a: (n, 3), half the sizes of the first.
        b: (n, 3), half the sizes of the second.
        rotations: (n, 3, 3).
        magnitudes: the same without signs.
        offsets: (n, 3).
    """

    a: Array
    b: Array
    rotations: Array
    magnitudes: Array
    offsets: Array

    @property
    def along_faces_of_second(self) -> Array:
        """The offsets along the axes of the second, (n, 3)."""
        offsets: Array = np.einsum("nij,ni->nj", self.rotations, self.offsets)
        return offsets


def _relative(boxes: PlacedBoxes, first: Indices, second: Indices) -> _Relative:
    half_extents = boxes.half_extents
    rotations_a, rotations_b = boxes.matrices[first], boxes.matrices[second]
    rotations = np.einsum("nji,njk->nik", rotations_a, rotations_b)
    offsets = np.einsum("nji,nj->ni", rotations_a, boxes.positions[second] - boxes.positions[first])
    return _Relative(
        half_extents[:, first].T, half_extents[:, second].T, rotations, np.abs(rotations), offsets
    )


def box_depths(boxes: PlacedBoxes, first: Indices, second: Indices) -> Array:
    """Returns the depths of pairs of boxes, m: their least overlaps along 15 axes, signed."""
    depths: Array = _overlaps(_relative(boxes, first, second)).min(axis=1)
    return depths


def _overlaps(pair: _Relative) -> Array:
    """Returns the overlaps along all axes, (n, 15)."""
    a, b, magnitudes = pair.a, pair.b, pair.magnitudes
    faces_a = a + np.einsum("nij,nj->ni", magnitudes, b) - np.abs(pair.offsets)
    faces_b = b + np.einsum("nij,ni->nj", magnitudes, a) - np.abs(pair.along_faces_of_second)
    edges = _edge_overlaps(pair).reshape(len(a), 9)
    overlaps: Array = np.concatenate((faces_a, faces_b, edges), axis=1)
    return overlaps


def _edge_overlaps(pair: _Relative) -> Array:
    """Returns the overlaps along the cross products of edges, (n, 3, 3)."""
    a, b, magnitudes = pair.a, pair.b, pair.magnitudes
    extents_a = (
        a[:, _NEXT, None] * magnitudes[:, _LAST, :] + a[:, _LAST, None] * magnitudes[:, _NEXT, :]
    )
    extents_b = (
        b[:, None, _NEXT] * magnitudes[:, :, _LAST] + b[:, None, _LAST] * magnitudes[:, :, _NEXT]
    )
    length = _sines(pair)
    is_parallel = length < _MIN_SINE
    overlaps: Array = (extents_a + extents_b - np.abs(_edge_distances(pair))) / np.where(
        is_parallel, 1.0, length
    )
    return np.where(is_parallel, np.inf, overlaps)


def _edge_distances(pair: _Relative) -> Array:
    """Returns the offsets along the cross products of edges, times their sines, (n, 3, 3)."""
    distances: Array = (
        pair.offsets[:, _LAST, None] * pair.rotations[:, _NEXT, :]
        - pair.offsets[:, _NEXT, None] * pair.rotations[:, _LAST, :]
    )
    return distances


def _sines(pair: _Relative) -> Array:
    """Returns the sines of the angles of the edges, (n, 3, 3)."""
    sines: Array = np.sqrt(np.maximum(1.0 - pair.rotations * pair.rotations, 0.0))
    return sines


def box_axes(boxes: PlacedBoxes, first: Indices, second: Indices) -> BoxAxes:
    """Returns the axes of pairs of boxes, with their overlaps."""
    pair = _relative(boxes, first, second)
    count, sines = len(first), _sines(pair)
    lengths = np.where(sines < _MIN_SINE, 1.0, sines)
    # Along the cross product of the edges: signed as `a_i x b_j`.
    edge_distances = _edge_distances(pair) / lengths
    distances = np.concatenate(
        (pair.offsets, pair.along_faces_of_second, edge_distances.reshape(count, 9)), axis=1
    )
    matrices_a, matrices_b = boxes.matrices[first], boxes.matrices[second]
    crossed = np.cross(
        matrices_a.transpose(0, 2, 1)[:, :, None, :], matrices_b.transpose(0, 2, 1)[:, None, :, :]
    )
    heights = np.concatenate(
        (matrices_a[:, 2], matrices_b[:, 2], (crossed[..., 2] / lengths).reshape(count, 9)), axis=1
    )
    is_near = (sines > _MIN_SINE / 2) & (sines < _MIN_SINE * 2)
    is_doubtful: Flags = np.asarray(is_near.any(axis=(1, 2)))
    return BoxAxes(
        _overlaps(pair), np.abs(distances), np.copysign(heights, heights * distances), is_doubtful
    )
