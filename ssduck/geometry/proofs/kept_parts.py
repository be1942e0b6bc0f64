"""Keeps from tick to tick how the directions of pairs of shapes were divided.

`ssduck.geometry.proofs.contact_directions` divides triangles of directions until bounds of the
overlaps in them tell whether the contact normal points up. Shapes move little between two ticks, so
that the same parts probably tell it again. They are only where the next proof starts: its bounds
are those of the new tick.

Where shapes move far between two ticks, more parts are needed at each, and some pairs have to be
divided further all the same, which takes longer than to begin anew. So it is counted how many pairs
were decided undivided. If they are too few, all parts are given up, and tried again much later.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.proofs.kept_verdicts import Keys

# The greatest number of parts of a pair that are kept: many would take longer than dividing anew.
_MAX_PARTS = 1024
# The number of pairs whose parts are kept.
_MAX_PAIRS = 4096
# If more pairs are divided together, it takes longer to keep their parts than to divide them anew.
MAX_DIVIDED = 128
# A pair that has to be divided further costs as much as so many save that need not be.
_COST = 8.0
# Parts are given up when the cost exceeds what was saved by those of so many ticks.
_CREDIT = 12.0
# The number of ticks at which pairs are divided anew then.
_PAUSE = 96


@dataclass(frozen=True, eq=False)
class Parts:
    """Parts of the triangles of a mesh of directions.

    Attributes:
        owners: (n,), the pair of each.
        faces: (n,), the triangle of the mesh that it is a part of; all parts of one cover it.
        classes: (n,), which directions may be in it.
        stretch: (n,), the greatest sum of weights of corners whose combination has length 1.
        corners: (3, n), the places of its corners.
        directions: (3, m), the unit directions of the corners.
        corner_owners: (m,), the pair of each direction.
    """

    owners: Indices
    faces: Indices
    classes: Indices
    stretch: Array
    corners: Indices
    directions: Array
    corner_owners: Indices

    def at_corners(self, places: Indices) -> Array:
        """Returns the directions at the corners of parts, (3, 3, n): (corner, axis, part)."""
        directions: Array = self.directions.take(self.corners[:, places], axis=1).swapaxes(0, 1)
        return directions


@dataclass(frozen=True, eq=False)
class _PairParts:
    """The parts of one pair.

    Attributes:
        numbers: (5, n), faces, classes and corners; see `Parts`.
        stretch: (n,).
        directions: (3, m).
    """

    numbers: Indices
    stretch: Array
    directions: Array


class KeptParts:
    """The parts of one condition on all pairs of shapes, for the next tick."""

    def __init__(self) -> None:
        self._parts: dict[int, _PairParts] = {}
        self._credit, self._pause = _CREDIT, 0

    def judge(self, sufficed: Flags) -> None:
        """Counts the pairs whose parts decided them undivided, and gives all up if these are few.

        Args:
            sufficed: (n,), whether the parts of a pair did, of those for which some were found.
        """
        share = float(np.count_nonzero(sufficed)) / len(sufficed)
        self._credit = min(self._credit + share - _COST * (1.0 - share), _CREDIT)
        if self._credit <= 0.0:
            self._parts.clear()
            self._credit, self._pause = _CREDIT, _PAUSE

    def find(self, keys: Keys) -> Parts | None:
        """Returns the parts that are kept of pairs; None if there are none."""
        self._pause = max(0, self._pause - 1)
        kept = [(n, self._parts.get(key)) for n, key in enumerate(keys.tolist())]
        found = [(n, parts) for n, parts in kept if parts is not None]
        if not found:
            return None
        owners = np.array([n for n, _ in found])
        counts = [len(parts.stretch) for _, parts in found]
        sizes = np.array([parts.directions.shape[1] for _, parts in found])
        numbers = np.concatenate([parts.numbers for _, parts in found], axis=1)
        numbers[2:] += np.repeat(np.cumsum(sizes) - sizes, counts)
        return Parts(
            np.repeat(owners, counts),
            numbers[0],
            numbers[1],
            np.concatenate([parts.stretch for _, parts in found]),
            numbers[2:],
            np.concatenate([parts.directions for _, parts in found], axis=1),
            np.repeat(owners, sizes),
        )

    def keep(
        self, key: int, faces: Indices, classes: Indices, stretch: Array, corners: Array
    ) -> None:
        """Replaces the parts of a pair, unless parts were given up lately.

        Args:
            key: the pair.
            faces: (n,), see `Parts`.
            classes: (n,), likewise.
            stretch: (n,), likewise.
            corners: (3, 3, n), the directions at the corners (corner, axis, part).
        """
        self._parts.pop(key, None)
        if self._pause or not 0 < len(faces) <= _MAX_PARTS:
            return
        if len(self._parts) >= _MAX_PAIRS:
            self._parts.clear()
        directions, places = np.unique(
            corners.swapaxes(0, 1).reshape(3, -1), axis=1, return_inverse=True
        )
        numbers = np.concatenate((faces[None], classes[None], places.reshape(3, -1)))
        # A copy: the stretch may be a row of an array that has all that is known of the parts.
        self._parts[key] = _PairParts(numbers, stretch.copy(), directions)
