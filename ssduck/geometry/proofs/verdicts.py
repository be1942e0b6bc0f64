"""Verdicts on pairs of shapes, and how they are kept from tick to tick while shapes hardly move.

A verdict says whether the signed distance of two shapes is below a bound. The signed distance of
two convex shapes is the least support of their difference, with the sign changed. It changes by no
more than the points of the shapes move relative to each other. A verdict whose signed distance has
some room to the bound therefore holds until the shapes have moved by that room.

    ----- BELOW -----|--- bound ---|------------ ABOVE ------------> signed distance
                       (tolerance)  |<-- room -->x   kept while the shapes move by less

A kept verdict is not proved again. It is only kept with room beyond the tolerance within which a
pair stays undecided, so that a new comparison would give the same verdict. Any verdict holds for
two shapes whose poses are the same to the last bit: a comparison depends on nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array, Flags, Indices, column_lengths

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
        """Decides pairs by bounds of their signed distances, each (n,), metres."""
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


Keys: TypeAlias = npt.NDArray[np.int64]

# Keys of pairs: the index of the first shape times this, plus that of the second.
_KEY_FACTOR = 1 << 32
# The rounding error of a motion, as a fraction of the largest coordinate.
_ROUNDING = 8e-15
# The root of a half, rounded up.
_HALF_ROOT = 0.7071067811865477


def pair_keys(first: Indices, second: Indices) -> Keys:
    """Returns the keys of pairs of shapes, (n,); their order matters."""
    keys: Keys = first * _KEY_FACTOR + second
    return keys


@dataclass(frozen=True, eq=False)
class ShapePoses:
    """The poses of shapes, from which their motion is bounded.

    Attributes:
        centres: (3, n), of the spheres around the shapes, metres.
        rotations: (9, n), their rotation matrices.
        radii: (n,), of these spheres, metres; infinite for half-spaces.
    """

    centres: Array
    rotations: Array
    radii: Array

    @cached_property
    def _largest(self) -> Array:
        """The largest coordinate of each centre, (n,), without its sign."""
        largest: Array = np.abs(self.centres).max(axis=0, initial=0.0)
        return largest

    def are_still(self, before: ShapePoses) -> Flags:
        """Checks which shapes have the same pose as before, (n,)."""
        are_still: Flags = (self.centres == before.centres).all(axis=0)
        are_still &= (self.rotations == before.rotations).all(axis=0)
        return are_still

    def motion_since(self, before: ShapePoses, first: Indices, second: Indices) -> Array:
        """Returns how far the points of two shapes moved at most, relative to each other, (n,).

        A rotation moves a point at distance r from the centre by at most r times the spectral norm
        of the difference of the matrices, which is its Frobenius norm over the root of 2.
        """
        norms = column_lengths(self.rotations - before.rotations)
        norms *= _HALF_ROOT
        reach = np.multiply(norms, self.radii, out=np.zeros(len(norms)), where=norms != 0.0)
        reach += _ROUNDING * np.maximum(self._largest, before._largest)
        shifts = self.centres - before.centres
        motion = column_lengths(shifts.take(first, axis=1) - shifts.take(second, axis=1))
        motion += reach.take(first)
        motion += reach.take(second)
        return motion


@dataclass(frozen=True, eq=False)
class _Kept:
    """The decided pairs of a tick."""

    keys: Keys  # (n,), the pairs, ascending
    decisions: Decisions  # the verdicts on them
    poses: ShapePoses  # the poses of all shapes at that tick
    has_exact: bool  # whether some verdict has no room: it holds for the very same poses


class KeptVerdicts:
    """The verdicts of one condition on all pairs of shapes, for the next tick."""

    def __init__(self) -> None:
        self._kept: _Kept | None = None  # replaced as a whole: threads see one tick's

    def find(self, poses: ShapePoses, first: Indices, second: Indices) -> Decisions:
        """Returns the verdicts on pairs of shapes that still hold, with the room that is left."""
        kept = self._kept
        if kept is None or not len(kept.keys):
            return Decisions.none(len(first))
        keys = pair_keys(first, second)
        places = kept.keys.searchsorted(keys)
        room = kept.decisions.room.take(places, mode="clip")
        room -= poses.motion_since(kept.poses, first, second)
        holds = room > 0.0
        if kept.has_exact:
            are_still = poses.are_still(kept.poses)
            holds |= are_still.take(first) & are_still.take(second)
        holds &= kept.keys.take(places, mode="clip") == keys
        verdicts = kept.decisions.verdicts.take(places, mode="clip")
        verdicts *= holds
        room = np.maximum(room, 0.0, out=room)
        room[~holds] = 0.0
        return Decisions(verdicts, room)

    def keep(
        self, poses: ShapePoses, first: Indices, second: Indices, decisions: Decisions
    ) -> None:
        """Replaces all verdicts by those of a tick."""
        places = np.flatnonzero(decisions.verdicts)
        keys = pair_keys(first, second).take(places)
        order = np.argsort(keys)
        places = places.take(order)
        kept = Decisions(decisions.verdicts.take(places), decisions.room.take(places))
        has_exact = not (kept.room > 0.0).all()
        self._kept = _Kept(keys.take(order), kept, poses, has_exact)
