"""Answers the questions of geometric relations about one tick, by the ids of entities."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.errors import ArgumentError
from ssduck.geometry.arrays import Array
from ssduck.geometry.batch import PairPredicate, ShapeTable, pair_number
from ssduck.geometry.broad_phase import overlapping_pairs
from ssduck.geometry.narrow_phase import MIN_DEPTH, NarrowPhase
from ssduck.geometry.neighbour_relations import NeighbourRelations, Orientation
from ssduck.geometry.solids import PlacedSolids
from ssduck.schema import ID_FACTOR

# After this number of pairs, or a quarter of the entities, all pairs are compared at once.
MIN_PAIRS_AT_ONCE = 64
# The rounding error of distances between boxes, m.
BOX_TOLERANCE = 1e-9

Ids: TypeAlias = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Statistics:
    """The work of geometric relations for one world, over all its ticks.

    Attributes:
        pairs: the number of pairs of entities that were compared; a pair counts once a tick. If all
            pairs of a tick are compared at once, the candidate pairs count.
        calls: the number of calls of FCL: one or two for two shapes that are near each other, more
            for meshes that are deep in something, none for pairs that formulas decide, as they do
            for nearly all pairs that are compared at once.
    """

    pairs: int
    calls: int


class ShapeQueries:
    """The narrow phase of a tick, by the ids of entities.

    An answer is None, for unknown, if a pose is not finite, or if an entity is not in the tick.

    Args:
        narrow: the narrow phase.
        numbers: the number in `narrow` of each id.
        table: the properties of the shapes.
        boxes: (6, n), of the entities in the order of `ids`: lower corners, upper corners.
        ids: (n,), the ids.
    """

    def __init__(
        self,
        narrow: NarrowPhase,
        numbers: Mapping[int, int],
        table: ShapeTable,
        boxes: Array,
        ids: Ids,
    ) -> None:
        self._narrow = narrow
        self._neighbours = NeighbourRelations(narrow, self._near_pairs)
        self._numbers = numbers
        self._table = table
        self._boxes = boxes
        self._ids = ids
        self._overlapping: dict[float, list[int]] = {}
        self._reaching: dict[float, list[int]] = {}
        # The number of pairs that were compared one by one, by predicate.
        self._pair_counts: Counter[PairPredicate] = Counter()
        self._matching: dict[PairPredicate, frozenset[int]] = {}
        self._all: dict[PairPredicate, list[int]] = {}

    def all_colliding(self, deeper: float) -> list[int]:
        """The pairs that are deeper in each other than a depth, m, as numbers.

        A number is `first * ID_FACTOR + second`; each pair is there in both orders. So it is in the
        other methods.

        Raises:
            ArgumentError: the depth is negative or NaN.
        """
        return self._pairs(PairPredicate("colliding", depth(deeper)))

    def all_within(self, apart: float) -> list[int]:
        """The pairs whose clearance is at most a distance, m; no pair of an entity with itself."""
        return self._pairs(PairPredicate("within", apart))

    def all_touching(self, apart: float) -> list[int]:
        """The pairs with shapes that are at most a distance, m, plus both margins apart."""
        return self._pairs(PairPredicate("touching", apart))

    def _pairs(self, predicate: PairPredicate) -> list[int]:
        """The pairs for which a predicate holds."""
        if predicate not in self._all:
            found = self._narrow.all_of(predicate, self._table)
            ids = np.array(list(self._numbers), dtype=np.int64)
            first, second = found.sides
            self._all[predicate] = _both_ways(ids[first], ids[second])
        return self._all[predicate]

    def all_meeting(self, apart: float) -> list[int]:
        """The pairs whose boxes are at most a distance apart along every axis, m."""
        if apart not in self._overlapping:
            first, second = overlapping_pairs(self._boxes, apart + BOX_TOLERANCE)
            self._overlapping[apart] = _both_ways(self._ids[first], self._ids[second])
        return self._overlapping[apart]

    def all_reaching(self, apart: float) -> list[int]:
        """The pairs whose boxes, grown by the largest margin of their shapes, are that near."""
        if apart not in self._reaching:
            first, second = overlapping_pairs(self._boxes_with_margins, apart + BOX_TOLERANCE)
            self._reaching[apart] = _both_ways(self._ids[first], self._ids[second])
        return self._reaching[apart]

    def all_resting(self) -> list[int]:
        """The pairs of which the second rests on the first, directly or through others."""
        ids = {number: id for id, number in self._numbers.items()}
        pairs = self._neighbours.all_resting()
        return sorted(ids[a] * ID_FACTOR + ids[b] for a, b in pairs)

    @cached_property
    def _boxes_with_margins(self) -> Array:
        """The boxes, grown by the largest margin of their shapes, (6, n)."""
        margins = np.array([self._narrow.margin(self._numbers[id]) for id in self._ids.tolist()])
        grown: Array = np.concatenate((self._boxes[:3] - margins, self._boxes[3:] + margins))
        return grown

    def _near_pairs(self, apart: float) -> list[tuple[int, int]]:
        """The pairs of entity numbers whose grown boxes are at most a distance apart, m."""
        numbers = np.array([self._numbers[id] for id in self._ids.tolist()], dtype=np.int64)
        first, second = overlapping_pairs(self._boxes_with_margins, apart)
        return list(zip(numbers[first].tolist(), numbers[second].tolist(), strict=True))

    def _pair(self, a: int, b: int) -> tuple[int, int]:
        """The numbers of two ids; counts the pair once a tick."""
        i, j = self._numbers[a], self._numbers[b]
        self._narrow.note((pair_number(i, j),))
        return i, j

    def _compared_at_once(self, predicate: PairPredicate) -> frozenset[int] | None:
        """The pairs for which a predicate holds, compared at once; None while few were asked for.

        If the distance is large compared to the bodies, too many pairs are candidates.
        """
        if predicate not in self._matching:
            self._pair_counts[predicate] += 1
            few = max(MIN_PAIRS_AT_ONCE, len(self._numbers) // 4)
            is_far = predicate.of != "colliding" and not predicate.distance <= self._median_size
            if self._pair_counts[predicate] <= few or is_far:
                return None
            found = self._narrow.all_of(predicate, self._table)
            self._matching[predicate] = frozenset(found.numbers.tolist())
        return self._matching[predicate]

    @cached_property
    def _median_size(self) -> float:
        """The median of the longest sides of the boxes, metres."""
        with np.errstate(invalid="ignore"):
            sides = (self._boxes[3:] - self._boxes[:3]).max(axis=0, initial=0.0)
        finite = sides[np.isfinite(sides)]
        return float(np.median(finite)) if len(finite) else 0.0

    def _is_among(self, found: frozenset[int], i: int, j: int) -> bool | None:
        if pair_number(i, j) in found:
            return True
        return False if self._narrow.is_known(i) and self._narrow.is_known(j) else None

    def collides(self, a: int, b: int, deeper: float = MIN_DEPTH) -> bool | None:
        """Whether two entities are deeper in each other than a depth, m.

        Raises:
            ArgumentError: the depth is negative or NaN.
        """
        i, j = self._pair(a, b)
        found = self._compared_at_once(PairPredicate("colliding", depth(deeper)))
        return self._narrow.collides(i, j, deeper) if found is None else self._is_among(found, i, j)

    def penetration(self, a: int, b: int) -> float | None:
        """The depth of the deepest two shapes, m; 0 if all are separate."""
        return self._narrow.penetration(*self._pair(a, b))

    def clearance(self, a: int, b: int) -> float | None:
        """The distance of the nearest points, m; infinite for an entity without shapes."""
        i, j = self._pair(a, b)
        if self._narrow.is_without_shapes(i) or self._narrow.is_without_shapes(j):
            return math.inf
        return self._narrow.clearance(i, j)

    def near(self, a: int, b: int, apart: float) -> bool | None:
        """Whether two entities are at most a distance apart, m; False without shapes."""
        i, j = self._pair(a, b)
        if self._narrow.is_without_shapes(i) or self._narrow.is_without_shapes(j):
            return False
        found = self._compared_at_once(PairPredicate("within", apart))
        if found is not None:
            return self._is_among(found, i, j)
        gap = self._narrow.clearance(i, j, apart)
        return None if gap is None else gap <= apart

    def touching(self, a: int, b: int, apart: float) -> bool | None:
        """Whether two of their shapes are at most a distance, m, plus both margins apart."""
        i, j = self._pair(a, b)
        found = self._compared_at_once(PairPredicate("touching", apart))
        return self._narrow.touches(i, j, apart) if found is None else self._is_among(found, i, j)

    def shapes_touching(self, a: int, b: int, apart: float) -> list[int]:
        """The indices of a's shapes that touch a shape of b."""
        return self._narrow.shapes_touching(*self._pair(a, b), apart)

    def points(self, a: int, b: int) -> list[list[float]] | None:
        """The nearest points, or the deepest ones, one of each entity."""
        found = self._narrow.nearest_points(*self._pair(a, b))
        return None if found is None else [list(point) for point in found]

    def on(self, a: int, b: int) -> bool | None:
        """Whether b rests on a."""
        return self._narrow.on(*self._pair(a, b))

    def supports(self, a: int, b: int) -> bool | None:
        """Whether a carries b, alone or together with others."""
        return self._neighbours.supports(*self._pair(a, b))

    def rests_on(self, a: int, b: int) -> bool | None:
        """Whether b is on a, or on something that rests on a."""
        return self._neighbours.rests_on(self._numbers[a], self._numbers[b])

    def encloses(self, a: int, b: int, *turn: float) -> bool | None:
        """Whether b is within walls of a, whose link frame has the given orientation."""
        return self._neighbours.encloses(*self._pair(a, b), _turn(turn))

    def beside(self, a: int, b: int, apart: float, *turns: float) -> bool | None:
        """Whether two entities with overlapping heights are beside each other.

        Args:
            a: an entity.
            b: another one.
            apart: their greatest distance, m.
            turns: the orientation of a's link frame, then of b's.
        """
        is_near = self.near(a, b, apart)
        if not is_near:
            return is_near
        return self._neighbours.are_beside(*self._pair(a, b), _turn(turns[:4]), _turn(turns[4:]))

    def inside(self, a: int, b: int) -> float | None:
        """The fraction of b's volume inside a's convex hull; 0 if b has no volume."""
        i, j = self._pair(a, b)
        return 0.0 if self._narrow.solid_volume(j) == 0.0 else self._narrow.inside(i, j)

    def contains(self, a: int, b: int) -> bool | None:
        """Whether enough of b's volume is inside a's convex hull."""
        i, j = self._pair(a, b)
        return False if self._narrow.solid_volume(j) == 0.0 else self._narrow.contains(i, j)

    def volume(self, entity: int) -> float | None:
        """The sum of the volumes of an entity's shapes, m³."""
        return self._narrow.solid_volume(self._numbers[entity])

    def unknown(self, ids: Sequence[int]) -> list[int]:
        """The entities whose poses are not finite, or whose shapes are not valid."""
        return [id for id in ids if not self._narrow.is_known(self._numbers[id])]

    def placed(self, ids: Sequence[int]) -> PlacedSolids:
        """The shapes of some entities in the world."""
        return self._narrow.placed([self._numbers[id] for id in ids], ids)


def depth(deeper: float) -> float:
    """Checks a depth, m.

    Raises:
        ArgumentError: it is negative or NaN.
    """
    if not deeper >= 0.0:
        raise ArgumentError(f"collides: the depth is a number of metres from 0 up, not {deeper:g}")
    return deeper


def _turn(numbers: tuple[float, ...]) -> Orientation:
    w, x, y, z = numbers
    return w, x, y, z


def _both_ways(a: Ids, b: Ids) -> list[int]:
    """Pairs of ids as sorted numbers, each pair in both orders."""
    numbers = np.concatenate((a * ID_FACTOR + b, b * ID_FACTOR + a))
    found: list[int] = np.sort(numbers).tolist()
    return found
