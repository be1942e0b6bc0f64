"""Keeps a column of numbers for each of many pairs of shapes, whatever the tick."""

from __future__ import annotations

import numpy as np

from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.proofs.kept_verdicts import Keys

# The number of pairs whose columns are kept.
_MAX_PAIRS = 4096


class KeptColumns:
    """Columns of numbers by the keys of pairs; they are forgotten when there are too many pairs.

    Args:
        rows: the length of a column.
    """

    def __init__(self, rows: int) -> None:
        self._slots: dict[int, int] = {}
        self._columns = np.zeros((rows, _MAX_PAIRS))

    def find(self, keys: Keys) -> tuple[Indices, Array]:
        """Returns the places of pairs of which a column is kept, and these, (rows, places)."""
        slots = self._slots
        found = np.array([slots.get(key, -1) for key in keys.tolist()], np.intp)
        places = np.flatnonzero(found >= 0)
        return places, self._columns.take(found.take(places), axis=1)

    def keep(self, keys: Keys, columns: Array) -> None:
        """Replaces the columns (rows, n) of n pairs, of which only so many are kept."""
        slots, numbers = self._slots, keys[:_MAX_PAIRS].tolist()
        if len(slots) + len(numbers) > _MAX_PAIRS:
            slots.clear()
        places = [slots.setdefault(key, len(slots)) for key in numbers]
        self._columns[:, places] = columns[:, : len(numbers)]
