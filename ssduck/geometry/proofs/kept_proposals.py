"""Keeps from tick to tick the directions and the points from which verdicts on pairs were proved.

Bodies move little between two ticks. A direction that separated two shapes probably separates them
still, and points in two shapes that overlap, which move with these, are probably deep in both
still. So they are proposed first: whatever they prove at the poses of the new tick, FCL is not
asked about.
"""

from __future__ import annotations

import numpy as np

from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.proofs.columns import column_lengths
from ssduck.geometry.proofs.cores import PlacedCores
from ssduck.geometry.proofs.interiors import ConvexInteriors
from ssduck.geometry.proofs.kept_columns import KeptColumns
from ssduck.geometry.proofs.kept_verdicts import Keys


class KeptProposals:
    """What FCL last proposed for pairs of shapes of a table, whatever the condition.

    A column of a pair has the direction, then the x, the y and the z of two points: each that of
    the point on the first shape and of the one on the second, in their frames from the solids'
    centres.
    """

    def __init__(self) -> None:
        self._kept = KeptColumns(9)

    def find(self, keys: Keys) -> tuple[Indices, Array]:
        """Returns the places of pairs of which something is kept, and these columns."""
        return self._kept.find(keys)

    def keep(self, keys: Keys, columns: Array) -> None:
        """Replaces the columns (9, n) of pairs."""
        self._kept.keep(keys, columns)


def proved_again(
    bodies: PlacedCores, interiors: ConvexInteriors, first: Indices, second: Indices, columns: Array
) -> tuple[Array, Array]:
    """Returns bounds of the signed distances of pairs of shapes, by what is kept of them.

    They are those of `ssduck.geometry.proofs.proposals.Proof`, with fewer operations: the supports
    against the direction bound from below, and balls around the points from above. Where the shapes
    may overlap, the points are the same one, in the middle of those that are kept. The radii of the
    balls are a little less than the depths of the points. So they are right for points that
    rounding errors moved out of the shapes, too.

    Args:
        bodies: the shapes.
        interiors: their interiors.
        first: (n,), shapes with known interiors.
        second: (n,), the same.
        columns: (9, n), what is kept of them; see `KeptProposals`.

    Returns:
        What the signed distances are at least and at most, (n,) each, metres.
    """
    count, both = len(first), np.concatenate((first, second))
    inner, directions = interiors.of(both), columns[:3]
    rotations = bodies.rotations.take(both, axis=1).reshape(3, 3, -1)
    centres = bodies.centres.take(both, axis=1)
    offsets = centres[:, :count] - centres[:, count:]
    outward = np.concatenate((-directions, directions), axis=1)
    heights = inner.heights(np.einsum("jim,jm->im", rotations, outward))
    least = np.einsum("cn,cn->n", directions, offsets)
    least -= heights[:count]
    least -= heights[count:]
    local = columns[3:].reshape(3, -1)
    points = np.einsum("ijm,jm->im", rotations, local)
    between = points[:, :count] - points[:, count:]
    between += offsets
    may_meet = least < 0.0
    halves = between * (0.5 * may_meet)
    towards = np.concatenate((-halves, halves), axis=1)
    local = local + np.einsum("jim,jm->im", rotations, towards)
    depths = inner.depths(local)
    radii = depths - inner.margins
    greatest = column_lengths(between)
    greatest[may_meet] = 0.0
    greatest -= radii[:count]
    greatest -= radii[count:]
    greatest[np.minimum(depths[:count], depths[count:]) < 0.0] = np.inf
    return least, greatest
