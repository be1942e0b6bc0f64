"""Keeps from tick to tick what decided pairs of convex shapes: separating directions, and points.

Bodies move little between two ticks. A direction that separated two shapes probably separates them
still, which one support point of their difference proves. Four points of the difference that proved
an overlap are points of the two shapes; they move with these, and probably prove it still.

Whatever is kept is only an attempt at a proof at the poses of the new tick. It changes how fast a
pair is decided, never how.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.proofs.kept_verdicts import Keys, pair_keys

# The number of witnesses of pairs that are no candidates any more, beyond that of the candidates.
_MAX_OTHERS = 64


@dataclass(frozen=True, eq=False)
class Witnesses:
    """What decided some pairs.

    Attributes:
        keys: (n,), the pairs.
        are_apart: (n,), whether a direction separates them; else they have points.
        directions: (3, n), from the second to the first, in the world.
        points_first: (4, 3, n), the points' parts on the first shape, in its frame, from its
            centre.
        points_second: (4, 3, n), those on the second shape.
    """

    keys: Keys
    are_apart: Flags
    directions: Array
    points_first: Array
    points_second: Array

    def __len__(self) -> int:
        return len(self.keys)

    def select(self, indices: Indices) -> Witnesses:
        """Returns the selected pairs."""
        return Witnesses(*(getattr(self, name).take(indices, axis=-1) for name in _FIELDS))


_FIELDS = tuple(Witnesses.__dataclass_fields__)


class KeptWitnesses:
    """The witnesses of one tick for the next one, of one condition on all pairs of shapes."""

    def __init__(self) -> None:
        self._witnesses: Witnesses | None = None

    def find(self, keys: Keys) -> tuple[Indices, Witnesses] | None:
        """Returns the places of pairs that have a witness, and these; None if no pair has one."""
        kept = self._witnesses
        if kept is None or not len(kept):
            return None
        places = np.minimum(np.searchsorted(kept.keys, keys), len(kept) - 1)
        found = np.flatnonzero(kept.keys[places] == keys)
        return (found, kept.select(places[found])) if len(found) else None

    def keep(self, log: WitnessLog, tried: Keys) -> None:
        """Replaces the witnesses of the pairs that were tried by those of a log."""
        before = self._witnesses
        if before is not None and len(before):
            log.add(before.select(np.flatnonzero(~np.isin(before.keys, tried))))
        self._witnesses = log.witnesses()

    def keep_only(self, pairs: Keys) -> None:
        """Forgets the witnesses of other pairs, if there are many."""
        kept = self._witnesses
        if kept is not None and len(kept) > _MAX_OTHERS + 2 * len(pairs):
            self._witnesses = kept.select(np.flatnonzero(np.isin(kept.keys, pairs)))


class WitnessLog:
    """The witnesses of the pairs that are decided at a tick."""

    def __init__(self) -> None:
        self._parts: list[Witnesses] = []

    def add(self, witnesses: Witnesses) -> None:
        """Adds witnesses that still hold."""
        self._parts.append(witnesses)

    def add_directions(self, first: Indices, second: Indices, directions: Array) -> None:
        """Adds pairs that directions (3, n) separate."""
        if len(first):
            points = np.zeros((4, 3, len(first)))
            are_apart = np.ones(len(first), dtype=bool)
            self.add(Witnesses(pair_keys(first, second), are_apart, directions, points, points))

    def add_points(
        self, first: Indices, second: Indices, points_first: Array, points_second: Array
    ) -> None:
        """Adds pairs that four points of their difference decide.

        Args:
            first: (n,), the shapes.
            second: (n,), the other shapes.
            points_first: (4, 3, n), the points on the first shape, in its frame.
            points_second: (4, 3, n), the points on the second shape, in its frame.
        """
        if len(first):
            are_apart, directions = np.zeros(len(first), dtype=bool), np.zeros((3, len(first)))
            keys = pair_keys(first, second)
            self.add(Witnesses(keys, are_apart, directions, points_first, points_second))

    def witnesses(self) -> Witnesses | None:
        """Returns all of them, in the order of their keys."""
        if not self._parts:
            return None
        together = self._parts[0]
        if len(self._parts) > 1:
            fields = (
                np.concatenate([getattr(p, n) for p in self._parts], axis=-1) for n in _FIELDS
            )
            together = Witnesses(*fields)
        return together.select(np.argsort(together.keys))
