"""What is around an entity: whether another one encloses it, and whether one is beside it.

Both are told by rays against the shapes, with the poses of one tick.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import TypeAlias

import numpy as np

from ssduck.geometry.arrays import Array
from ssduck.geometry.batch import pair_number
from ssduck.geometry.contact_support import is_carried_by
from ssduck.geometry.distance import SignedDistance
from ssduck.geometry.narrow_phase import NarrowPhase
from ssduck.geometry.placed_solid import PlacedSolid, Point
from ssduck.geometry.poses import rotation_matrices
from ssduck.geometry.ray_casting import (
    HIT_TOLERANCE,
    crossings,
    first_hits,
    is_triangle_surface,
    ray_chords,
)

# The numbers w, x, y, z of a unit quaternion.
Orientation: TypeAlias = tuple[float, float, float, float]

# The boxes of what rests on something, grown by margins, are no farther apart than that, m.
RESTING = 0.01
# What reaches past something at both ends by more, metres, is not enclosed along that axis.
PAST = 1e-3
# Of three axes, at least so many have walls on both sides.
WALLED = 2
# Where lines run between two entities: shares of the breadth and of the height they have in common.
SHARES = (0.5, 0.1, 0.9, 0.3, 0.7)
# A direction whose horizontal part is shorter is vertical.
VERTICAL = 1e-6


class NeighbourRelations:
    """What is around the entities of one tick, by their shapes.

    All methods take entities by number. Their answer is None, for unknown, as the narrow phase's
    is; an entity has nothing to do with itself, and one without shapes with no other.

    Args:
        narrow: the shapes.
        pairs: gives the pairs of entities whose boxes, grown by the margins of their shapes, are no
            farther apart along any axis, m.
    """

    def __init__(
        self, narrow: NarrowPhase, pairs: Callable[[float], Iterable[tuple[int, int]]]
    ) -> None:
        self._narrow = narrow
        self._pairs = pairs
        self._resting: dict[int, frozenset[int]] = {}

    def encloses(self, a: int, b: int, turn: Orientation) -> bool | None:
        """Whether b is within walls of a: see `encloses`, of the middle of b's box.

        Args:
            a: what may enclose.
            b: what may be enclosed.
            turn: the orientation of a's link frame, whose axes count.
        """
        if not self._are_known(a, b):
            return None
        if not self._have_shapes(a, b):
            return False
        narrow = self._narrow
        centre, axes = narrow.middle(b), rotation_matrices(np.array([turn]))[0].T
        if not np.isfinite(centre).all():
            return False
        return encloses(narrow.shapes_of(a), axes, narrow.shapes_of(b), centre)

    def are_beside(self, a: int, b: int, turn_a: Orientation, turn_b: Orientation) -> bool | None:
        """Whether neither is on or in the other, and one is in sight of the other: `is_in_sight`.

        That their heights overlap, and that they are near enough, is to be known.
        """
        if not self._are_known(a, b):
            return None
        if not self._have_shapes(a, b):
            return False
        for first, second, turn in ((a, b, turn_a), (b, a, turn_b)):
            narrow = self._narrow
            if self.supports(first, second) or narrow.contains(first, second):
                return False
            if self.encloses(first, second, turn) or second in self._resting_on(first):
                return False
        return self._are_in_sight(min(a, b), max(a, b))

    def _are_in_sight(self, a: int, b: int) -> bool:
        narrow = self._narrow
        boxes, nearest = np.stack((narrow.box(a), narrow.box(b))), narrow.signed_distance(a, b)
        if nearest is None:
            return False
        low, high = boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)
        low[2], high[2] = boxes[:, 2].max(), boxes[:, 5].min()
        others = narrow.shapes_in(low, high, (a, b))
        return is_in_sight(narrow.shapes_of(a), narrow.shapes_of(b), others, nearest)

    # -- what carries what, and rests on what -------------------------------------------------

    def supports(self, a: int, b: int) -> bool | None:
        """Whether a carries b, alone or together with others; see `is_carried_by`."""
        if not self._are_known(a, b):
            return None
        own = self._pushes(a, b) if self._have_shapes(a, b) else []
        if not own:
            return False
        beside = (other for other in self._neighbours.get(b, ()) if other != a)
        return is_carried_by(own, chain.from_iterable(self._pushes(other, b) for other in beside))

    def _pushes(self, a: int, b: int) -> list[Point]:
        self._narrow.note((pair_number(a, b),))
        return self._narrow.pushes(a, b)

    @cached_property
    def _neighbours(self) -> dict[int, list[int]]:
        """The known entities that may touch each entity."""
        found: dict[int, list[int]] = {}
        for a, b in self._pairs(RESTING):
            if self._are_known(a, b):
                found.setdefault(a, []).append(b)
                found.setdefault(b, []).append(a)
        return found

    def rests_on(self, a: int, b: int) -> bool | None:
        """Whether b is on a, or on something that rests on a."""
        if a == b:
            return False
        if not self._are_known(a, b):
            return None
        return b in self._resting_on(a)

    def all_resting(self) -> list[tuple[int, int]]:
        """All pairs of which the second rests on the first."""
        return [(a, b) for a in self._on for b in self._resting_on(a) if a != b]

    def _resting_on(self, a: int) -> frozenset[int]:
        """All that rest on an entity, through others or not."""
        if a not in self._resting:
            found: set[int] = set()
            todo = [a]
            while todo:
                new = self._on.get(todo.pop(), frozenset()) - found
                found |= new
                todo += new
            self._resting[a] = frozenset(found)
        return self._resting[a]

    @cached_property
    def _on(self) -> dict[int, frozenset[int]]:
        """What is on each entity, of all pairs of the tick."""
        found: dict[int, set[int]] = {}
        for b, others in self._neighbours.items():
            self._narrow.note(pair_number(a, b) for a in others)
            for a in others:
                if self._narrow.on(a, b):
                    found.setdefault(a, set()).add(b)
        return {a: frozenset(b) for a, b in found.items()}

    # -- of two -------------------------------------------------------------------------------

    def _are_known(self, a: int, b: int) -> bool:
        return self._narrow.is_known(a) and self._narrow.is_known(b)

    def _have_shapes(self, a: int, b: int) -> bool:
        narrow = self._narrow
        return a != b and not (narrow.is_without_shapes(a) or narrow.is_without_shapes(b))


# -- enclosed -----------------------------------------------------------------------------------


def encloses(
    a: Sequence[PlacedSolid], axes: Array, b: Sequence[PlacedSolid], centre: Array
) -> bool:
    """Whether rays from a centre meet a on both sides along two axes at least.

    A convex shape that holds the centre is not met. An axis along which b reaches past a at both
    ends does not count.

    Args:
        a: the shapes of what may enclose.
        axes: (3, 3), unit vectors as rows.
        b: the shapes of what may be enclosed.
        centre: (3,), of b.
    """
    ways = np.concatenate((axes, -axes))
    met = np.zeros(len(ways), dtype=bool)
    for one in a:
        if not _may_be_met(one, axes, centre):
            continue
        start = (centre - one.position) @ one.matrix
        shares = first_hits(one.solid, start, ways @ one.matrix)
        met |= np.isfinite(shares) & (shares > HIT_TOLERANCE)
    walled = met[:3] & met[3:]
    if walled.sum() < WALLED:
        return False
    walled &= ~((_extents(b, ways) - _extents(a, ways)).reshape(2, 3) > PAST).all(axis=0)
    return bool(walled.sum() >= WALLED)


def _may_be_met(one: PlacedSolid, axes: Array, centre: Array) -> bool:
    """Whether a line along an axis through a point meets the sphere around a shape."""
    off = axes @ (np.array(one.to_world(*one.solid.centre)) - centre)
    beside = off @ off - off * off
    return bool((beside <= (one.solid.bounding_radius + HIT_TOLERANCE) ** 2).any())


def _extents(shapes: Sequence[PlacedSolid], ways: Array) -> Array:
    """How far shapes reach in unit directions (n, 3), m from the origin, (n,)."""
    reaches = [
        np.full(len(ways), math.inf)
        if one.solid.type == "plane"
        else one.support_heights(ways) + one.solid.radius
        for one in shapes
    ]
    farthest: Array = np.max(reaches, axis=0)
    return farthest


# -- beside -------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Lines:
    """Parallel horizontal lines: where they begin (n, 3), and their unit direction (3,)."""

    starts: Array
    way: Array

    @property
    def ways(self) -> Array:
        return np.repeat(self.way[None], len(self.starts), axis=0)


def is_in_sight(
    a: Sequence[PlacedSolid],
    b: Sequence[PlacedSolid],
    others: Sequence[PlacedSolid],
    nearest: SignedDistance,
) -> bool:
    """Whether a horizontal ray from a or b meets the other before anything else.

    The rays run along the horizontal parts of the nearest points' connection and of that of the
    centres, through the nearest points and through a grid over the breadth and the height that a
    and b have in common.

    Args:
        a: the shapes of an entity; none is a plane.
        b: those of another one.
        others: the shapes of all other entities that may be between them.
        nearest: the nearest points of a and b.
    """
    return any(
        _is_clear(lines, a, b, others)
        for way in _ways(a, b, nearest)
        for lines in (_lines(a, b, way, nearest),)
    )


def _ways(
    a: Sequence[PlacedSolid], b: Sequence[PlacedSolid], nearest: SignedDistance
) -> list[Array]:
    """Horizontal unit directions from a to b."""
    up = np.concatenate((np.eye(3), -np.eye(3)))
    of_a, of_b = _extents(a, up), _extents(b, up)
    middles = (of_b[:3] - of_b[3:] - of_a[:3] + of_a[3:]) / 2
    apart = np.subtract(nearest.point_b, nearest.point_a)
    if nearest.normal is not None and nearest.distance <= HIT_TOLERANCE:
        apart = -np.array(nearest.normal)
    found = []
    for direction in (apart, middles):
        length = math.hypot(direction[0], direction[1])
        if length > VERTICAL * float(np.linalg.norm(direction)):
            found.append(np.array([direction[0] / length, direction[1] / length, 0.0]))
    return found


def _lines(
    a: Sequence[PlacedSolid], b: Sequence[PlacedSolid], way: Array, nearest: SignedDistance
) -> _Lines:
    """Lines in a direction, over what a and b have in common across it."""
    across = np.array([-way[1], way[0], 0.0])
    axes = np.stack((way, across, [0.0, 0.0, 1.0]))
    reach = np.stack([_extents(one, np.concatenate((axes, -axes))) for one in (a, b)])
    high, low = reach[:, :3].min(axis=0), (-reach[:, 3:]).max(axis=0)
    begin = float((-reach[:, 3]).min()) - 1.0
    places = [
        (low[1] + s * (high[1] - low[1]), low[2] + t * (high[2] - low[2]))
        for s in SHARES
        for t in SHARES
        if high[1] >= low[1]
    ]
    middle = (np.array(nearest.point_a) + nearest.point_b) / 2
    for point in (nearest.point_a, nearest.point_b, middle):
        height = min(max(point[2], low[2]), high[2])
        places.append((float(across @ point), height))
    starts = [begin * way + y * across + np.array([0.0, 0.0, z]) for y, z in places]
    return _Lines(np.array(starts), way)


def _is_clear(
    lines: _Lines, a: Sequence[PlacedSolid], b: Sequence[PlacedSolid], others: Sequence[PlacedSolid]
) -> bool:
    """Whether on one of the lines nothing is between a and b."""
    of_a, of_b = _stretches(lines, a), _stretches(lines, b)
    if not any(p and q for p, q in zip(of_a, of_b, strict=True)):
        return False
    between = _stretches(lines, others)
    return any(
        _is_free(max(p, q)[0], min(p, q)[1], blocks)
        for p_all, q_all, blocks in zip(of_a, of_b, between, strict=True)
        for p in p_all
        for q in q_all
    )


def _is_free(far: float, near: float, blocks: Sequence[tuple[float, float]]) -> bool:
    """Whether nothing is between the end of one stretch and the beginning of the next one."""
    return not any(
        leave > near + HIT_TOLERANCE and enter < far - HIT_TOLERANCE and far > near + HIT_TOLERANCE
        for enter, leave in blocks
    )


def _stretches(lines: _Lines, shapes: Sequence[PlacedSolid]) -> list[list[tuple[float, float]]]:
    """Of each line where it enters shapes and leaves them, m; it crosses triangles in a point."""
    found: list[list[tuple[float, float]]] = [[] for _ in lines.starts]
    ways = lines.ways
    for one in shapes:
        starts, own = (lines.starts - one.position) @ one.matrix, ways @ one.matrix
        if is_triangle_surface(one.solid):
            shares = crossings(one.solid, starts, own)
            for line, share in np.argwhere(np.isfinite(shares)).tolist():
                found[line].append((float(shares[line, share]),) * 2)
            continue
        chords = ray_chords(one.solid, starts, own)
        for line in np.flatnonzero(chords.enter <= chords.leave).tolist():
            found[line].append((float(chords.enter[line]), float(chords.leave[line])))
    return found
