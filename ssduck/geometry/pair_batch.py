"""Decides questions about many pairs of entities at once, each pair at a tick of its own.

The rules of `ssduck.geometry.batch` prove most answers: shapes are farther apart than a bound. What
remains is computed by the narrow phase, shape by shape, so that the results are those of a single
pair to the last bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, TypeAlias, get_args

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.batch import comparable_pairs, matching_pairs, proven_verdicts
from ssduck.geometry.broad_phase import Pairs
from ssduck.geometry.contact_support import MIN_RISING, MIN_UP
from ssduck.geometry.narrow_phase import NarrowPhase
from ssduck.geometry.on_pairs import decide_contacts
from ssduck.geometry.proofs.contact_directions import NOT_UPWARD, UPWARD
from ssduck.geometry.proofs.footprints import OVER, over_verdicts, shapes_of
from ssduck.geometry.proofs.verdicts import ABOVE, BELOW, UNDECIDED, Verdicts
from ssduck.geometry.tick_shapes import PairPredicate, PredicateKind
from ssduck.geometry.tick_solids import TOUCHING_DISTANCE

Direction: TypeAlias = tuple[float, float, float]

# Questions that the narrow phase decides pose by pose.
PlacedKind: TypeAlias = Literal["inside", "contains", "enclosed"]
QuestionKind: TypeAlias = Literal[
    PredicateKind, PlacedKind, "clearance", "gap", "penetration", "on", "supports", "resting"
]

# After so many rounds, the clearances that are left are computed one by one.
MAX_ROUNDS = 16
# In so many rounds at most, the shapes that carry at one tick are tried first at the others.
MAX_CARRIED_ROUNDS = 4
# A point that is farther inside is surely inside, m.
_SURELY_INSIDE = 1e-9
# The share of pairs that are left where the search for the least clearance is given up.
_MOST_LEFT = 0.75
_NO_DIRECTION: Direction = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class PairQuestion:
    """A question about two entities at a tick.

    Attributes:
        kind: the kind of a `PairPredicate`; or else a method of `ShapeQueries`, which is `rests_on`
            for "resting" and `encloses` for "enclosed".
        distance: that of the predicate, m.
    """

    kind: QuestionKind
    distance: float = 0.0

    @property
    def predicate(self) -> PairPredicate | None:
        """The predicate, if it is one."""
        match self.kind:
            case "colliding" | "within" | "touching" as kind:
                return PairPredicate(kind, self.distance)
        return None

    @property
    def is_symmetric(self) -> bool:
        """Whether the order of the entities does not matter."""
        return self.kind not in ("on", "supports", "resting", *get_args(PlacedKind))

    @property
    def is_number(self) -> bool:
        """Whether the answer is a number, and not True or False."""
        return self.kind in ("clearance", "gap", "penetration", "inside")

    @property
    def is_placed(self) -> bool:
        """Whether entities are placed, and compared, once for each two of their poses."""
        return self.kind in get_args(PlacedKind)

    @property
    def needs_whole_tick(self) -> bool:
        """Whether the answer depends on all entities of the tick."""
        return self.kind in ("supports", "resting")

    @property
    def uses_margins(self) -> bool:
        """Whether the collision margins of shapes count."""
        return self.kind in ("touching", "gap", "on", "supports", "resting")

    @property
    def max_gap(self) -> float:
        """The largest gap of two boxes, without margins, at which the answer is not trivial, m."""
        match self.kind:
            case "within" | "touching":
                return self.distance
            case "on" | "supports":
                return TOUCHING_DISTANCE
            case "clearance" | "gap" | "resting":
                return math.inf
        return 0.0


@dataclass(frozen=True, eq=False)
class Answers:
    """The answers to a question about n pairs.

    Attributes:
        values: (n,), numbers; 1 for True, 0 for False, NaN for unknown.
        is_open: (n,), whether the shapes of the two entities do not decide the answer.
    """

    values: Array
    is_open: Flags


class PairBatch:
    """The shapes of n pairs of entities; those of pair k are the entities k and n + k.

    Args:
        shapes: the pairs of shapes of the pairs, by pair.
        count: the number n of pairs.
        narrow: the narrow phase of the same shapes, without boxes.
        starts: (2 n + 1,): the shapes of entity e are `starts[e]` to `starts[e + 1] - 1`.
        step: is called before each comparison of two shapes in Python; it may raise an error.
    """

    def __init__(
        self,
        shapes: Pairs,
        count: int,
        narrow: NarrowPhase,
        starts: Indices,
        step: Callable[[], object],
    ) -> None:
        self._scene = scene = narrow.arrays
        self._narrow, self._starts = narrow, starts
        self._count, self._step = count, step
        self._all_shapes = shapes
        self._first, self._second = comparable_pairs(scene, shapes)
        self._rows = scene.table.entities[self._first]
        self._margins = np.zeros(len(self._rows))  # of pairs of shapes, m: less is their gap

    def answers(self, question: PairQuestion, groups: Indices | None = None) -> Answers:
        """Returns the answers to a question.

        Of the entities, the one with the lower number is the first argument.
        """
        is_open = np.zeros(self._count, dtype=bool)
        predicate = question.predicate
        if predicate is not None:
            values = self._matching(predicate)
        elif question.kind == "clearance":
            values = self._clearances() if groups is None else self._least_clearances(groups)
        elif question.kind == "gap":
            self._margins = self._scene.table.margins.of_pairs(self._first, self._second)
            values = self._clearances()
        elif question.kind == "penetration":
            values = self._penetrations()
        elif question.kind == "resting":
            values, is_open = np.zeros(self._count), ~is_open
        else:
            values, is_open = self._standing(needs_centre=question.kind == "on")
        are_known = self._are_known
        is_unknown = ~are_known
        if question.kind == "clearance":
            is_unknown &= self._have_shapes
        values[is_unknown] = np.nan
        return Answers(values, is_open & are_known)

    @property
    def compared_count(self) -> int:
        """The number of pairs whose shapes are compared."""
        return int(np.count_nonzero(np.bincount(self._rows)))

    @property
    def _have_shapes(self) -> Flags:
        """Whether both entities of each pair have shapes with points, (n,)."""
        table, count = self._scene.table, self._count
        have = np.bincount(table.entities[table.has_points], minlength=2 * count) > 0
        both: Flags = have[:count] & have[count:]
        return both

    @property
    def _are_known(self) -> Flags:
        """Whether all poses and shapes of both entities of each pair are known, (n,)."""
        known = np.ones(2 * self._count, dtype=bool)
        known[self._scene.table.entities[~self._scene.is_known]] = False
        both: Flags = known[: self._count] & known[self._count :]
        return both

    def _bounds(self) -> Array:
        """Returns the largest distances of touching shapes, for each pair of shapes."""
        touching = PairPredicate("touching", TOUCHING_DISTANCE)
        return touching.bounds(self._scene.table, self._first, self._second)

    def _matching(self, predicate: PairPredicate) -> Array:
        def satisfies(s: int, t: int) -> bool:  # for the few pairs that no rule decides
            self._step()
            return self._narrow.shapes.satisfies(s, t, predicate)

        result = matching_pairs(self._scene, predicate, satisfies, self._all_shapes)
        values = np.zeros(self._count)
        values[result.sides[0]] = 1.0
        return values

    # -- distances --------------------------------------------------------------------------

    def _compared(self, pair: int) -> tuple[int, int]:
        """Returns the shapes to compare for a pair of shapes, and counts a comparison."""
        self._step()
        return int(self._first[pair]), int(self._second[pair])

    def _distance(self, pair: int) -> tuple[float, Direction]:
        """Returns the distance of a pair of shapes, m, and the unit normal from the second."""
        result = self._narrow.shapes.distance(*self._compared(pair))
        if result is None:
            return 0.0, _NO_DIRECTION
        return max(0.0, result.distance), result.normal or _NO_DIRECTION

    def _clearances(self) -> Array:
        """Returns the least gaps of the shapes of each pair, m."""
        # What is nearest in one row mostly is in the others: its distance there bounds their
        # clearances, so that the other shapes are mostly proved to be farther apart.
        best, normals = np.full(self._count, math.inf), np.zeros((3, self._count))
        pairs = np.arange(len(self._rows))
        places = self._places()
        for _ in range(MAX_ROUNDS):
            if not len(pairs):
                return best
            row = self._rows[pairs[0]]
            end = int(np.searchsorted(self._rows[pairs], row, side="right"))
            own, nearest = self._nearest(pairs[:end])
            best[row] = min(best[row], own)
            pairs = pairs[end:]
            is_probe = places[pairs] == places[nearest]
            for pair in pairs[is_probe].tolist():
                row, (distance, normal) = self._rows[pair], self._distance(pair)
                if distance - self._margins[pair] < best[row]:
                    best[row], normals[:, row] = distance - self._margins[pair], normal
            pairs = pairs[~is_probe]
            rows = self._rows[pairs]
            pairs = self._nearer_than(best[rows] + self._margins[pairs], pairs, normals[:, rows])
        for row, members in _groups(self._rows[pairs], pairs):
            best[row] = min(best[row], self._nearest(members)[0])
        return best

    def _least_clearances(self, groups: Indices) -> Array:
        """Returns the clearance of each pair that may have the least one of its group, m."""
        # Others are infinite. The pair of the nearest spheres is first: it mostly excludes others.
        clearances, least = np.full(self._count, math.inf), np.full(groups.max() + 1, math.inf)
        zero = np.full(len(least), self._count)  # the first pair that meets, of each group
        gaps = self._sphere_gaps(np.arange(len(self._rows)))
        pairs = np.arange(len(self._rows))
        for _ in range(MAX_ROUNDS):
            if not len(pairs):
                return clearances
            rows = self._rows[pairs]
            order = np.lexsort((gaps[pairs], groups[rows]))
            is_first = np.diff(groups[rows[order]], prepend=-1) != 0
            for row in rows[order[is_first]].tolist():
                start, end = np.searchsorted(rows, [row, row + 1]).tolist()
                clearances[row], _ = self._nearest(pairs[start:end])
                least[groups[row]] = min(least[groups[row]], clearances[row])
                if clearances[row] == 0.0:
                    zero[groups[row]] = min(zero[groups[row]], row)
            is_open = (clearances[rows] == math.inf) & (rows < zero[groups[rows]])
            pairs = pairs[is_open]
            bounds = np.maximum(least, _SURELY_INSIDE)[groups[self._rows[pairs]]]
            pairs = self._nearer_than(bounds, pairs)
            if len(pairs) > _MOST_LEFT * len(rows):  # of a large body, spheres exclude nothing
                return self._clearances()
        for row, members in _groups(self._rows[pairs], pairs):
            clearances[row], _ = self._nearest(members)
        return clearances

    def _sphere_gaps(self, pairs: Indices) -> Array:
        """Returns the distances of the bounding spheres of pairs of shapes, m; negative if met."""
        scene = self._scene
        first, second = self._first[pairs], self._second[pairs]
        with np.errstate(over="ignore", invalid="ignore"):
            offsets = scene.centres[first] - scene.centres[second]
            radii = scene.table.bounding_radius[first] + scene.table.bounding_radius[second]
            gaps: Array = np.sqrt((offsets * offsets).sum(axis=1)) - radii
        return gaps

    def _places(self) -> Array:
        """Returns numbers that are equal for pairs of corresponding shapes of different rows."""
        first = self._first - self._starts[self._rows]
        second = self._second - self._starts[self._count + self._rows]
        places: Array = first * (1 << 32) + second
        return places

    def _nearest(self, pairs: Indices) -> tuple[float, int]:
        """Returns the least gap among pairs of shapes of one row, and the pair."""
        best, nearest, towards = math.inf, int(pairs[0]), np.zeros(3)
        pairs = pairs[np.argsort(self._sphere_gaps(pairs))]
        while len(pairs):
            distance, normal = self._distance(int(pairs[0]))
            gap = distance - self._margins[pairs[0]]
            if gap < best:
                best, nearest, towards = gap, int(pairs[0]), np.array(normal)
            pairs = pairs[1:]
            directions = np.broadcast_to(towards[:, None], (3, len(pairs)))
            pairs = self._nearer_than(best + self._margins[pairs], pairs, directions)
        return best, nearest

    def _nearer_than(
        self, bounds: Array, pairs: Indices, directions: Array | None = None
    ) -> Indices:
        """Returns the pairs of shapes that may be nearer than a distance each."""
        is_bounded = (bounds > 0.0) & (bounds < math.inf)
        bounded = pairs[is_bounded]
        shapes = self._first[bounded], self._second[bounded]
        tried = None if directions is None else directions[:, is_bounded]
        is_near = proven_verdicts(self._scene, *shapes, bounds[is_bounded], tried) != ABOVE
        kept: Indices = np.concatenate((pairs[bounds == math.inf], bounded[is_near]))
        kept.sort()
        return kept

    def _penetrations(self) -> Array:
        """Returns the depths of the deepest shapes of each pair, m; 0 if all are apart."""
        depths = np.zeros(self._count)
        first, second = self._first, self._second
        verdicts = proven_verdicts(self._scene, first, second, np.zeros(len(first)))
        for pair in np.flatnonzero(verdicts != ABOVE).tolist():
            result = self._narrow.shapes.signed_distance(*self._compared(pair))
            row = self._rows[pair]
            depths[row] = max(depths[row], -result.distance)
        return depths

    # -- standing ---------------------------------------------------------------------------

    def _standing(self, *, needs_centre: bool) -> tuple[Array, Flags]:
        """Returns whether contact normals of touching shapes carry the second of each pair."""
        # 1 or 0 for each pair, and the pairs that are open.
        values, is_open = np.zeros(self._count), np.zeros(self._count, dtype=bool)
        bounds = self._bounds()
        verdicts = proven_verdicts(self._scene, self._first, self._second, bounds)
        near = np.flatnonzero((verdicts != ABOVE) & (bounds >= 0.0))
        if needs_centre:
            rows = np.unique(self._rows[near])
            centres = self._box_centres(self._count + rows)
            over = over_verdicts(self._scene, self._starts, rows, centres)
            is_open[rows] = over == UNDECIDED
            wanted = np.zeros(self._count, dtype=bool)
            wanted[rows] = over == OVER
            near = near[wanted[self._rows[near]]]
        near = self._carry(near, (verdicts == BELOW)[near], values)
        upward = self._upward(near, MIN_UP)
        touch = (verdicts == BELOW)[near]
        values[self._rows[near[touch & (upward == UPWARD)]]] = 1.0
        left = values[self._rows[near]] == 0.0
        upward, near = upward[left], near[left]
        if needs_centre:
            near = near[upward != NOT_UPWARD]
        else:  # steep normals carry together with others
            is_rising = upward != NOT_UPWARD
            is_rising[~is_rising] = self._upward(near[~is_rising], MIN_RISING) != NOT_UPWARD
            near = near[is_rising]
        places, last = self._places(), -1
        for row, pairs in _groups(self._rows[near], near):
            # What carried it at the tick before probably does so still.
            highest = -1.0
            for pair in sorted(pairs.tolist(), key=lambda pair: places[pair] != last):
                height = self._narrow.shapes.contact_height(*self._compared(pair))
                highest = max(highest, -1.0 if height is None else height)
                if highest >= MIN_UP:
                    values[row], last = 1.0, places[pair]
                    break
            is_open[row] = not needs_centre and MIN_RISING <= highest < MIN_UP
        return values, is_open

    def _carry(self, near: Indices, touch: Flags, values: Array) -> Indices:
        """Sets the values of most rows to 1 in which a normal carries; returns what is left."""
        places, is_left = self._places()[near], np.ones(len(near), dtype=bool)
        tried = touch.copy()
        for _ in range(MAX_CARRIED_ROUNDS):
            pairs = np.flatnonzero(tried)
            if not len(pairs):
                break
            pairs = pairs[self._rows[near[pairs]] == self._rows[near[pairs[0]]]]
            carrying = pairs[self._upward(near[pairs], MIN_UP) == UPWARD]
            if not len(carrying):
                break
            alike = np.flatnonzero(tried & (places == places[carrying[0]]))
            carrying = alike[self._upward(near[alike], MIN_UP) == UPWARD]
            values[self._rows[near[carrying]]] = 1.0
            is_left = values[self._rows[near]] == 0.0
            tried &= is_left
            tried[alike] = False
        return near[is_left]

    def _upward(self, pairs: Indices, min_height: float) -> Verdicts:
        """Returns whether the contact normals of pairs of shapes point up."""
        first, second = self._first[pairs], self._second[pairs]
        return decide_contacts(self._scene, first, second, min_height).verdicts

    def _box_centres(self, entities: Indices) -> Array:
        """Returns the centres of the boxes of entities over the ground, (2, n); NaN for planes."""
        scene, table, cores = self._scene, self._scene.table, self._scene.table.cores
        shapes, owners = shapes_of(scene, self._starts, entities)
        low = np.full((2, len(entities)), math.inf)
        high = np.full((2, len(entities)), -math.inf)
        for axis in (0, 1):
            for sign, ends, choose in ((-1.0, low, np.minimum), (1.0, high, np.maximum)):
                directions = np.zeros((3, len(shapes)))
                directions[axis] = sign
                reach = scene.placed_cores.support_points(shapes, directions)[axis]
                places = scene.centres[shapes, axis] + reach + sign * cores.radius[shapes]
                choose.at(ends[axis], owners, places)
        with np.errstate(invalid="ignore"):
            centres: Array = (low + high) / 2
        centres[:, owners[table.is_plane[shapes]]] = np.nan
        return centres


def _groups(keys: Indices, values: Indices) -> Iterator[tuple[int, Indices]]:
    """Yields the distinct keys, ascending, each with its values."""
    order = np.argsort(keys, kind="stable")
    keys, values = keys[order], values[order]
    ends = [*np.flatnonzero(np.diff(keys, prepend=-1)).tolist(), len(keys)]
    for start, end in pairwise(ends):
        yield int(keys[start]), values[start:end]
