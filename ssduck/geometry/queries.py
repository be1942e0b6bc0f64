"""What the relations of shapes ask of one tick, by the ids of entities."""

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
from ssduck.schema import MOST_IDS

# After more pairs, or one for every four entities, all pairs of the tick are compared at once.
FEW = 64
# Boxes that are apart by less may be so by rounding, m.
ROUNDED = 1e-9

Ids: TypeAlias = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Statistics:
    """What the relations of shapes have taken of one world, over all its ticks.

    Attributes:
        pairs: how many pairs of entities were compared; one that is asked for twice in a tick
            counts once. Where all pairs of a tick are compared at once, these are the pairs
            whose boxes meet, or are as near as was asked for.
        calls: how often FCL was called for that: once or twice for two shapes that are near each
            other, more often for meshes that are deep in something; never for those that
            formulas decide, as nearly all are where all of a tick is compared at once.
    """

    pairs: int
    calls: int


class ShapeQueries:
    """The narrow phase of a tick, by the ids of entities.

    Every answer is None, for unknown, where a pose is no number, and where an entity is none of
    the tick's.

    Args:
        narrow: the shapes.
        numbers: which entity of `narrow` an id is.
        table: what the shapes are, and whose.
        boxes: (6, n), of the entities in the order of `ids`: the lower corners, then the upper.
        ids: (n,)
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
        self._around = NeighbourRelations(narrow, self._reached)
        self._numbers = numbers
        self._sorts = table
        self._boxes = boxes
        self._ids = ids
        self._overlapping: dict[float, list[int]] = {}
        self._reaching: dict[float, list[int]] = {}
        # How many pairs were asked about one by one, by what was asked.
        self._asked: Counter[PairPredicate] = Counter()
        self._found: dict[PairPredicate, frozenset[int]] = {}
        self._all: dict[PairPredicate, list[int]] = {}

    def all_colliding(self, deeper: float) -> list[int]:
        """The pairs that are deeper in each other, m, as numbers; so are those of the others.

        Raises:
            ArgumentError: that is no depth.
        """
        return self._pairs(PairPredicate("colliding", depth(deeper)))

    def all_within(self, apart: float) -> list[int]:
        """The pairs whose clearance is at most that, m; no entity and itself."""
        return self._pairs(PairPredicate("within", apart))

    def all_touching(self, apart: float) -> list[int]:
        """The pairs with shapes that are at most so far apart, m, and the margins of both."""
        return self._pairs(PairPredicate("touching", apart))

    def _pairs(self, predicate: PairPredicate) -> list[int]:
        """The pairs of which something holds."""
        if predicate not in self._all:
            found = self._narrow.all_of(predicate, self._sorts)
            ids = np.array(list(self._numbers), dtype=np.int64)
            first, second = found.sides
            self._all[predicate] = _both_ways(ids[first], ids[second])
        return self._all[predicate]

    def all_meeting(self, apart: float) -> list[int]:
        """The pairs whose boxes are no farther apart along any axis, m."""
        if apart not in self._overlapping:
            first, second = overlapping_pairs(self._boxes, apart + ROUNDED)
            self._overlapping[apart] = _both_ways(self._ids[first], self._ids[second])
        return self._overlapping[apart]

    def all_reaching(self, apart: float) -> list[int]:
        """The same of boxes that are grown by the largest margin of their shapes."""
        if apart not in self._reaching:
            first, second = overlapping_pairs(self._grown, apart + ROUNDED)
            self._reaching[apart] = _both_ways(self._ids[first], self._ids[second])
        return self._reaching[apart]

    def all_resting(self) -> list[int]:
        """The pairs of which the second rests on the first, through others or not."""
        ids = {number: id for id, number in self._numbers.items()}
        pairs = self._around.all_resting()
        return sorted(ids[a] * MOST_IDS + ids[b] for a, b in pairs)

    @cached_property
    def _grown(self) -> Array:
        """The boxes, grown by the largest margin of their shapes, (6, n)."""
        margins = np.array([self._narrow.margin(self._numbers[id]) for id in self._ids.tolist()])
        grown: Array = np.concatenate((self._boxes[:3] - margins, self._boxes[3:] + margins))
        return grown

    def _reached(self, apart: float) -> list[tuple[int, int]]:
        """The pairs of entities, by number, whose grown boxes are no farther apart, m."""
        numbers = np.array([self._numbers[id] for id in self._ids.tolist()], dtype=np.int64)
        first, second = overlapping_pairs(self._grown, apart)
        return list(zip(numbers[first].tolist(), numbers[second].tolist(), strict=True))

    def _pair(self, a: int, b: int) -> tuple[int, int]:
        """Which entities two ids are; a pair counts once a tick."""
        i, j = self._numbers[a], self._numbers[b]
        self._narrow.note((pair_number(i, j),))
        return i, j

    def _together(self, predicate: PairPredicate) -> frozenset[int] | None:
        """The pairs of which something holds, found at once; None while few were asked about.

        What is far, as bodies go, is near too many.
        """
        if predicate not in self._found:
            self._asked[predicate] += 1
            few = max(FEW, len(self._numbers) // 4)
            is_far = predicate.of != "colliding" and not predicate.distance <= self._usual
            if self._asked[predicate] <= few or is_far:
                return None
            found = self._narrow.all_of(predicate, self._sorts)
            self._found[predicate] = frozenset(found.numbers.tolist())
        return self._found[predicate]

    @cached_property
    def _usual(self) -> float:
        """How large bodies are: the median of their boxes' longest sides, metres."""
        with np.errstate(invalid="ignore"):
            sides = (self._boxes[3:] - self._boxes[:3]).max(axis=0, initial=0.0)
        finite = sides[np.isfinite(sides)]
        return float(np.median(finite)) if len(finite) else 0.0

    def _is_among(self, found: frozenset[int], i: int, j: int) -> bool | None:
        if pair_number(i, j) in found:
            return True
        return False if self._narrow.is_known(i) and self._narrow.is_known(j) else None

    def collides(self, a: int, b: int, deeper: float = MIN_DEPTH) -> bool | None:
        """Whether they are deeper in each other, m.

        Raises:
            ArgumentError: that is no depth.
        """
        i, j = self._pair(a, b)
        found = self._together(PairPredicate("colliding", depth(deeper)))
        return self._narrow.collides(i, j, deeper) if found is None else self._is_among(found, i, j)

    def penetration(self, a: int, b: int) -> float | None:
        """The depth of the deepest two shapes, m; 0 if all are apart."""
        return self._narrow.penetration(*self._pair(a, b))

    def clearance(self, a: int, b: int) -> float | None:
        """The distance of the nearest points, m; infinite of what has no shapes."""
        i, j = self._pair(a, b)
        if self._narrow.is_without_shapes(i) or self._narrow.is_without_shapes(j):
            return math.inf
        return self._narrow.clearance(i, j)

    def near(self, a: int, b: int, apart: float) -> bool | None:
        """Whether they are at most that far apart, m; what has no shapes is near nothing."""
        i, j = self._pair(a, b)
        if self._narrow.is_without_shapes(i) or self._narrow.is_without_shapes(j):
            return False
        found = self._together(PairPredicate("within", apart))
        if found is not None:
            return self._is_among(found, i, j)
        gap = self._narrow.clearance(i, j, apart)
        return None if gap is None else gap <= apart

    def touching(self, a: int, b: int, apart: float) -> bool | None:
        """Whether two of their shapes are at most so far apart, m, and the margins of both."""
        i, j = self._pair(a, b)
        found = self._together(PairPredicate("touching", apart))
        return self._narrow.touches(i, j, apart) if found is None else self._is_among(found, i, j)

    def shapes_touching(self, a: int, b: int, apart: float) -> list[int]:
        """The numbers of a's shapes that touch a shape of b so."""
        return self._narrow.shapes_touching(*self._pair(a, b), apart)

    def points(self, a: int, b: int) -> list[list[float]] | None:
        """The nearest or the deepest points, one of each."""
        found = self._narrow.nearest_points(*self._pair(a, b))
        return None if found is None else [list(point) for point in found]

    def on(self, a: int, b: int) -> bool | None:
        """Whether b rests on a."""
        return self._narrow.on(*self._pair(a, b))

    def supports(self, a: int, b: int) -> bool | None:
        """Whether a carries b, alone or with others."""
        return self._around.supports(*self._pair(a, b))

    def rests_on(self, a: int, b: int) -> bool | None:
        """Whether b is on a, or on something that rests on a."""
        return self._around.rests_on(self._numbers[a], self._numbers[b])

    def encloses(self, a: int, b: int, *turn: float) -> bool | None:
        """Whether b is within walls of a, whose link frame has that orientation."""
        return self._around.encloses(*self._pair(a, b), _turn(turn))

    def beside(self, a: int, b: int, apart: float, *turns: float) -> bool | None:
        """Whether two entities, whose heights overlap, are beside each other.

        Args:
            a: an entity.
            b: another one.
            apart: how far from each other they are at most, m.
            turns: the orientation of a's link frame, then of b's.
        """
        is_near = self.near(a, b, apart)
        if not is_near:
            return is_near
        return self._around.are_beside(*self._pair(a, b), _turn(turns[:4]), _turn(turns[4:]))

    def inside(self, a: int, b: int) -> float | None:
        """The share of b's volume that is inside a's convex hull; 0 if it has none."""
        i, j = self._pair(a, b)
        return 0.0 if self._narrow.solid_volume(j) == 0.0 else self._narrow.inside(i, j)

    def contains(self, a: int, b: int) -> bool | None:
        """Whether as much of b's volume is inside a's convex hull as counts as all."""
        i, j = self._pair(a, b)
        return False if self._narrow.solid_volume(j) == 0.0 else self._narrow.contains(i, j)

    def volume(self, entity: int) -> float | None:
        """The sum of the volumes of its shapes, m³."""
        return self._narrow.solid_volume(self._numbers[entity])

    def unknown(self, ids: Sequence[int]) -> list[int]:
        """Those of some entities whose poses are no numbers, or whose shapes are no shapes."""
        return [id for id in ids if not self._narrow.is_known(self._numbers[id])]

    def placed(self, ids: Sequence[int]) -> PlacedSolids:
        """The shapes of some entities where they are."""
        return self._narrow.placed([self._numbers[id] for id in ids], ids)


def depth(deeper: float) -> float:
    """How deep shapes are to be in each other, m.

    Raises:
        ArgumentError: it is below 0, or no number.
    """
    if not deeper >= 0.0:
        raise ArgumentError(f"collides: the depth is a number of metres from 0 up, not {deeper:g}")
    return deeper


def _turn(numbers: tuple[float, ...]) -> Orientation:
    w, x, y, z = numbers
    return w, x, y, z


def _both_ways(a: Ids, b: Ids) -> list[int]:
    """Pairs of ids as numbers, each pair both ways, in order."""
    numbers = np.concatenate((a * MOST_IDS + b, b * MOST_IDS + a))
    found: list[int] = np.sort(numbers).tolist()
    return found
