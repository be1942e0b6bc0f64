"""Keeps from tick to tick the directions and the points from which verdicts on pairs were proved.

Bodies move little between two ticks. A direction that separated two shapes probably separates them
still, and points in two shapes that overlap, which move with these, are probably deep in both
still. So they are proposed first: whatever they prove at the poses of the new tick, FCL is not
asked about.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.proofs.cores import PlacedCores
from ssduck.geometry.proofs.kept_columns import KeptColumns
from ssduck.geometry.proofs.kept_verdicts import Keys


@dataclass(frozen=True, eq=False)
class Proposals:
    """Directions and points that may prove verdicts on n pairs of shapes.

    Attributes:
        points: (2, 3, n), on or in the first shapes, and the second ones, in the world.
        directions: (3, n), from the second to the first, of any length.
        meet: (n,), whether the shapes are thought to overlap, around the points.
    """

    points: Array
    directions: Array
    meet: Flags


class KeptProposals:
    """What FCL last proposed for pairs of shapes of a table, whatever the condition.

    A column of a pair has the direction; the points on the first shape and the second one, in their
    frames from the solids' centres; and whether they meet, as 0 or 1.
    """

    def __init__(self) -> None:
        self._kept = KeptColumns(10)

    def find(self, keys: Keys) -> tuple[Indices, Array]:
        """Returns the places of pairs of which something is kept, and these columns."""
        return self._kept.find(keys)

    def keep(self, keys: Keys, columns: Array) -> None:
        """Replaces the columns (10, n) of pairs."""
        self._kept.keep(keys, columns)


def placed_proposals(
    bodies: PlacedCores, first: Indices, second: Indices, columns: Array
) -> Proposals:
    """Returns what is kept of pairs, (10, n), moved with their shapes."""
    both = np.concatenate((first, second))
    local = np.concatenate((columns[3:6], columns[6:9]), axis=1)
    points = bodies.to_world(both, local[None])[0]
    points += bodies.centres.take(both, axis=1)
    return Proposals(points.reshape(3, 2, -1).swapaxes(0, 1), columns[:3], columns[9] > 0.0)
