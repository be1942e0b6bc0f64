"""Verdicts on pairs of shapes: whether their signed distance is below a bound."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array, Flags, Indices

Verdicts: TypeAlias = npt.NDArray[np.int8]

BELOW, ABOVE, UNDECIDED = 1, -1, 0


@dataclass(frozen=True, eq=False)
class Decisions:
    """The verdicts on pairs of shapes, and how far the shapes may move before these are in doubt.

    Attributes:
        verdicts: (n,), `BELOW`, `ABOVE` or `UNDECIDED`.
        room: (n,), metres between the signed distance and the tolerance around the bound. At least
            so much; 0 where it is not known.
    """

    verdicts: Verdicts
    room: Array

    @classmethod
    def none(cls, count: int) -> Decisions:
        """Returns undecided pairs."""
        return cls(np.zeros(count, np.int8), np.zeros(count))

    @classmethod
    def of_interval(cls, least: Array, greatest: Array, bounds: Array, error: Array) -> Decisions:
        """Decides pairs by bounds of their signed distances, each (n,), metres.

        Args:
            least: lower bounds of the signed distances.
            greatest: upper bounds.
            bounds: what the signed distances are compared with.
            error: the tolerances, within which a pair stays undecided.
        """
        above, below = least - bounds - error, bounds - error - greatest
        is_below, is_above = below > 0.0, above > 0.0
        verdicts: Verdicts = is_below.view(np.int8) - is_above.view(np.int8)
        return cls(verdicts, np.maximum(np.maximum(above, below), 0.0))

    def part(self, pairs: slice) -> Decisions:
        """Returns a view of some of the pairs."""
        return Decisions(self.verdicts[pairs], self.room[pairs])

    def decide(
        self, pairs: Indices | Flags, verdict: int | Verdicts, room: Array | float = 0.0
    ) -> None:
        """Decides some of the pairs."""
        self.verdicts[pairs] = verdict
        self.room[pairs] = room
