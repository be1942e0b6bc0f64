"""Compares all candidate pairs of a tick at once: which entities collide, touch or are near.

The broad phase finds the pairs of shapes with overlapping boxes. Many of them are decided by
spheres: those around the shapes are far apart, or those in the shapes overlap. Support functions
decide half-spaces, separating axes decide boxes that may collide (Gottschalk, Lin and Manocha,
OBBTree, 1996), and `ssduck.geometry.proofs.gjk` decides other convex shapes. The convex hull of a
mesh shows that the mesh is far from something. Only the pairs that are left are compared one by
one: pairs that are as near to the bound as rounding errors, and meshes that may collide.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Literal, TypeAlias

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.broad_phase import Pairs, overlapping_pairs
from ssduck.geometry.poses import rotate
from ssduck.geometry.proofs.cores import ConvexCores, PlacedCores
from ssduck.geometry.proofs.gjk import decide_gaps, tolerances
from ssduck.geometry.proofs.kept_verdicts import KeptVerdicts, ShapePoses, pair_keys
from ssduck.geometry.proofs.separating_axes import box_depths
from ssduck.geometry.proofs.verdicts import ABOVE, BELOW, UNDECIDED, Decisions, Verdicts
from ssduck.geometry.proofs.witnesses import KeptWitnesses
from ssduck.geometry.shapes import Geometry
from ssduck.geometry.solids import Solid, solid_of

# Added to distances of boxes, m, so that pairs exactly at the bound are candidates.
_BOUND_MARGIN = 1e-8
_MAX_ENTITIES = 1 << 32
# Among pairs of other shapes, fewer pairs of boxes are decided together with these.
_MIN_BOXES = 8
# The number of pairs of boxes that the narrow phase compares faster than rules for many pairs.
_FEW_BOXES = 2
# The number of predicates of which something is kept from tick to tick.
_MAX_PREDICATES = 16
# The number of regrouped tables that are kept from tick to tick.
_MAX_REGROUPED = 16


PredicateKind: TypeAlias = Literal["colliding", "within", "touching"]


@dataclass(frozen=True)
class PairPredicate:
    """A condition on two entities; it holds if it holds for two of their shapes.

    Attributes:
        kind: "colliding": they are deeper in each other than `distance`. "within": the distance of
            their nearest points is at most `distance`. "touching": that distance is at most
            `distance` plus the collision margins of both shapes.
        distance: metres.
    """

    kind: PredicateKind
    distance: float

    def bound(self, margins: float) -> float:
        """Returns the bound of the signed distance of two shapes.

        Args:
            margins: the sum of their collision margins, metres.
        """
        if self.kind == "colliding":
            return -self.distance
        return self.distance + margins if self.kind == "touching" else self.distance

    def bounds(self, table: ShapeTable, first: Indices, second: Indices) -> Array:
        """Returns the bounds for pairs of shapes, (n,)."""
        bounds = np.full(len(first), self.bound(0.0))
        if self.kind == "touching":
            bounds += table.margins[first] + table.margins[second]
        return bounds

    def candidates(self, tick: TickShapes) -> Pairs:
        """Returns the pairs of shapes whose boxes are near enough."""
        if self.kind == "colliding":
            return _candidates(tick, tick.boxes, 0.0)
        if self.kind == "within":
            return _candidates(tick, tick.boxes, self.distance + _BOUND_MARGIN)
        margins = tick.table.margins
        grown = np.concatenate((tick.boxes[:3] - margins, tick.boxes[3:] + margins))
        return _candidates(tick, grown, max(self.distance, 0.0) + _BOUND_MARGIN)


class KeptPairs:
    """What decided the pairs of a condition at the tick before, and the verdicts."""

    def __init__(self) -> None:
        self.witnesses, self.verdicts = KeptWitnesses(), KeptVerdicts()


class ShapeTable:
    """The properties of shapes that do not depend on their poses.

    Args:
        solids: the distinct solids.
        solid_indices: (n,), the index of each shape's solid.
        entities: (n,), the index of each shape's entity.
        margins: (n,), the collision margins, metres; None for none.
    """

    def __init__(
        self,
        solids: Sequence[Solid],
        solid_indices: Indices,
        entities: Indices,
        margins: Array | None = None,
    ) -> None:
        self.solids, self.solid_indices = solids, solid_indices
        self.entities = entities
        self.margins = np.zeros(len(solid_indices)) if margins is None else margins
        self.count = int(entities.max(initial=-1)) + 1
        self.has_single_shapes = bool(np.bincount(entities).max(initial=0) <= 1)
        self.is_known = np.array([solid.is_known for solid in solids], dtype=bool)[solid_indices]
        self.has_points = np.array([not solid.is_empty for solid in solids], dtype=bool)[
            solid_indices
        ]
        self.is_plane = np.array([solid.type == "plane" for solid in solids], dtype=bool)[
            solid_indices
        ]
        self.has_planes = bool(self.is_plane.any())
        self.is_box = np.array([solid.type == "box" for solid in solids], dtype=bool)[solid_indices]
        self.is_convex = np.array([solid.is_convex for solid in solids], dtype=bool)[solid_indices]
        self.bounding_radius = np.array([solid.bounding_radius for solid in solids])[solid_indices]
        self.centre = np.array([solid.centre for solid in solids]).reshape(-1, 3)[solid_indices]
        self.inscribed_centre = np.array([solid.inscribed_centre for solid in solids]).reshape(
            -1, 3
        )[solid_indices]
        self.inscribed_radius = np.array([solid.inscribed_radius for solid in solids])[
            solid_indices
        ]
        up = np.array([0.0, 0.0, 1.0])
        normals = [s.normals[0] if s.type == "plane" and s.is_known else up for s in solids]
        self.normal = np.array(normals).reshape(-1, 3)[solid_indices]
        self.cores = ConvexCores(solids, solid_indices)
        self._kept: dict[PairPredicate, KeptPairs] = {}
        self._regrouped: dict[tuple[bytes, bytes], ShapeTable] = {}
        self._extended: tuple[tuple[tuple[str, ...], bytes], ShapeTable] | None = None

    def kept(self, predicate: PairPredicate) -> KeptPairs:
        """Returns what is kept of a predicate from the tick before."""
        if predicate not in self._kept:
            if len(self._kept) >= _MAX_PREDICATES:
                self._kept.clear()
            self._kept[predicate] = KeptPairs()
        return self._kept[predicate]

    def extended(self, geometries: Sequence[Geometry], entities: Indices) -> ShapeTable:
        """Returns the table with further shapes, without margins; it keeps the last one.

        Args:
            geometries: their geometries.
            entities: (n,), the index of each one's entity.
        """
        key = tuple(geometry.key for geometry in geometries), entities.tobytes()
        if self._extended is not None and self._extended[0] == key:
            return self._extended[1]
        known = len(self.solids)
        distinct = {geometry.key: geometry for geometry in geometries}
        places = {key: known + place for place, key in enumerate(distinct)}
        indices = [places[geometry.key] for geometry in geometries]
        table = ShapeTable(
            [*self.solids, *map(solid_of, distinct.values())],
            np.concatenate((self.solid_indices, np.array(indices, np.intp))),
            np.concatenate((self.entities, entities)),
            np.concatenate((self.margins, np.zeros(len(indices)))),
        )
        self._extended = key, table
        return table

    def regrouped(self, shapes: Indices, entities: Indices) -> ShapeTable:
        """Returns the table of some of the shapes, which belong to other entities.

        The table is the same at each tick, so that it keeps its witnesses.

        Args:
            shapes: (m,), the numbers of the shapes.
            entities: (m,), the index of each shape's entity.
        """
        key = shapes.tobytes(), entities.tobytes()
        table = self._regrouped.get(key)
        if table is None:
            if len(self._regrouped) >= _MAX_REGROUPED:
                self._regrouped.clear()
            indices, margins = self.solid_indices[shapes], self.margins[shapes]
            table = self._regrouped[key] = ShapeTable(self.solids, indices, entities, margins)
        return table


@dataclass(frozen=True, eq=False)
class TickShapes:
    """The shapes of a tick, in arrays.

    Attributes:
        table: the properties that do not depend on the tick.
        is_known: (n,), whether all poses and shapes of the entity are known.
        boxes: (6, n), lower corners, upper corners.
        positions: (n, 3).
        matrices: (n, 3, 3).
    """

    table: ShapeTable
    is_known: Flags
    boxes: Array
    positions: Array
    matrices: Array

    def to_world(self, points: Array) -> Array:
        """Returns a point (n, 3) of each shape, transformed to the world."""
        if not points.any():
            return self.positions
        with np.errstate(invalid="ignore"):
            moved: Array = self.positions + rotate(self.matrices, points)
        return moved

    @cached_property
    def centres(self) -> Array:
        """The centres of the spheres around the shapes, (n, 3)."""
        return self.to_world(self.table.centre)

    @cached_property
    def inscribed_centres(self) -> Array:
        """The centres of the spheres in the shapes, (n, 3)."""
        return self.to_world(self.table.inscribed_centre)

    @cached_property
    def poses(self) -> ShapePoses:
        """The poses, from which the motion between two ticks is bounded."""
        return ShapePoses(self.centres, self.matrices, self.table.bounding_radius)

    @cached_property
    def placed_cores(self) -> PlacedCores:
        """The cores of the shapes."""
        rotations = np.ascontiguousarray(self.matrices.transpose(1, 2, 0)).reshape(9, -1)
        centres, inscribed = map(np.ascontiguousarray, (self.centres.T, self.inscribed_centres.T))
        return PlacedCores(self.table.cores, rotations, centres, inscribed)

    def owners(self, first: Indices, second: Indices) -> Indices:
        """Returns the pairs of entities that own pairs of shapes, as numbers; see `pair_number`."""
        i, j = self.table.entities[first], self.table.entities[second]
        return np.minimum(i, j) * _MAX_ENTITIES + np.maximum(i, j)


def pair_number(i: int, j: int) -> int:
    """Returns the number of a pair of entities, in either order.

    >>> pair_number(3, 7) == pair_number(7, 3)
    True
    """
    return min(i, j) * _MAX_ENTITIES + max(i, j)


@dataclass(frozen=True, eq=False)
class PairResult:
    """The result for all pairs of entities of a tick.

    Attributes:
        numbers: the pairs for which the predicate holds, ascending; see `pair_number`.
        compared: the candidate pairs of entities.
    """

    numbers: Indices
    compared: Indices

    @property
    def sides(self) -> Pairs:
        """The lower entity of each pair, and the other."""
        return self.numbers // _MAX_ENTITIES, self.numbers % _MAX_ENTITIES

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """The pairs in order; the lower entity of each is first."""
        first, second = self.sides
        return list(zip(first.tolist(), second.tolist(), strict=True))


def of_known_entities(table: ShapeTable, is_known: Flags) -> Flags:
    """Checks whether all shapes of each shape's entity are known, (n,)."""
    lost = np.bincount(table.entities[~is_known], minlength=table.count)
    all_known: Flags = lost[table.entities] == 0
    return all_known


def matching_pairs(
    tick: TickShapes,
    predicate: PairPredicate,
    satisfies: Callable[[int, int], bool],
    among: Pairs | None = None,
    kept: KeptPairs | None = None,
) -> PairResult:
    """Returns the pairs of entities for which a predicate holds.

    Args:
        tick: the shapes.
        predicate: the condition on two shapes.
        satisfies: decides the pairs of shapes that no rule decides.
        among: the pairs of shapes to compare; None for all candidate pairs.
        kept: what is kept of the same predicate from the tick before.
    """
    among = predicate.candidates(tick) if among is None else comparable_pairs(tick, among)
    bounds = predicate.bounds(tick.table, *among)
    by_cores = partial(_by_cores, kept=None if kept is None else kept.witnesses)
    rules: tuple[Rule, ...] = _by_spheres, _by_planes, _by_axes, by_cores
    if predicate.kind != "colliding":  # a distance is not negative
        rules = _by_spheres, _by_planes, _by_axes_if_sure, by_cores
        is_non_negative = bounds >= 0.0
        among, bounds = (
            (among[0][is_non_negative], among[1][is_non_negative]),
            bounds[is_non_negative],
        )
    return _matching_entities(tick, among, rules, bounds, satisfies, kept)


def comparable_pairs(tick: TickShapes, shapes: Pairs) -> Pairs:
    """Returns those of some pairs of shapes whose entities are known, and which have points."""
    first, second = shapes
    has_known_points = tick.is_known & tick.table.has_points
    both = has_known_points[first] & has_known_points[second]
    return first[both], second[both]


Rule: TypeAlias = Callable[[TickShapes, Indices, Indices, Array], Decisions]


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def proven_verdicts(tick: TickShapes, first: Indices, second: Indices, bounds: Array) -> Verdicts:
    """Classifies the signed distances of pairs of shapes, as far as rules prove it.

    Args:
        tick: the shapes.
        first: (n,), known shapes that have points.
        second: (n,), the same.
        bounds: (n,), one for each pair, metres; not negative.
    """
    verdicts = np.zeros(len(first), np.int8)
    pairs = np.arange(len(first))
    for rule in (_by_spheres, _by_planes, _by_axes_if_sure, _by_cores):
        verdicts[pairs] = rule(tick, first[pairs], second[pairs], bounds[pairs]).verdicts
        pairs = pairs[verdicts[pairs] == UNDECIDED]
    return verdicts


# Shapes whose squared lengths overflow stay undecided.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def _matching_entities(
    tick: TickShapes,
    candidates: Pairs,
    rules: Sequence[Rule],
    bounds: Array,
    is_below: Callable[[int, int], bool],
    kept: KeptPairs | None,
) -> PairResult:
    """Returns the pairs of entities with shapes whose signed distance is below a bound.

    Args:
        tick: the shapes.
        candidates: the pairs of shapes to compare.
        rules: the rules to apply, one after another, until all pairs are decided.
        bounds: one for each pair, metres.
        is_below: decides pairs that no rule decides.
        kept: the verdicts of the tick before, which are replaced by those of this one.
    """
    first, second = candidates
    has_single_shapes = tick.table.has_single_shapes
    owners = tick.owners(first, second)
    compared = owners if has_single_shapes else np.unique(owners)
    decisions = Decisions.none(len(first))
    if kept is not None:
        decisions = kept.verdicts.find(tick.poses, first, second)
    verdicts = decisions.verdicts
    open_pairs = np.flatnonzero(verdicts == UNDECIDED)
    is_kept = True
    for rule in rules:
        if not has_single_shapes:
            matching = owners[verdicts == BELOW]
            open_pairs = open_pairs[~np.isin(owners[open_pairs], matching)]
        if not len(open_pairs):
            break
        is_kept = False
        found = rule(tick, first[open_pairs], second[open_pairs], bounds[open_pairs])
        decisions.decide(open_pairs, found.verdicts, found.room)
        open_pairs = open_pairs[found.verdicts == UNDECIDED]
    if kept is not None and not is_kept:
        _keep(kept, tick, candidates, decisions)
    matching = owners[verdicts == BELOW]
    others = _compared_one_by_one(owners, candidates, open_pairs, matching, is_below)
    matching = np.concatenate((matching, others))
    return PairResult(np.sort(matching) if has_single_shapes else np.unique(matching), compared)


def _compared_one_by_one(
    owners: Indices,
    candidates: Pairs,
    open_pairs: Indices,
    matching: Indices,
    is_below: Callable[[int, int], bool],
) -> Indices:
    """Returns the owners of pairs that no rule decided, and that are below their bound."""
    known = set(matching.tolist()) if len(open_pairs) else set()
    others: set[int] = set()
    sides = (side[open_pairs].tolist() for side in (owners, *candidates))
    for owner, s, t in zip(*sides, strict=True):
        if owner not in known and owner not in others and is_below(s, t):
            others.add(owner)
    return np.array(sorted(others), np.intp)


def _keep(kept: KeptPairs, tick: TickShapes, pairs: Pairs, decisions: Decisions) -> None:
    """Keeps the verdicts of a tick for the next one.

    The depth of a shape that is not convex may change by more than its points move.
    """
    first, second = pairs
    is_convex = tick.table.is_convex
    is_concave = ~(is_convex[first] & is_convex[second])
    decisions.room[is_concave & (decisions.verdicts == BELOW)] = 0.0
    kept.verdicts.keep(tick.poses, first, second, decisions)
    kept.witnesses.keep_only(pair_keys(first, second))


def _candidates(tick: TickShapes, boxes: Array, max_distance: float) -> Pairs:
    """Returns the pairs of known shapes of two entities whose boxes (6, n) are near each other.

    There are none if the greatest distance is negative or NaN.
    """
    if not max_distance >= 0.0:
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    table = tick.table
    known = np.flatnonzero(tick.is_known & table.has_points)
    if max_distance == np.inf:
        first, second = np.triu_indices(len(known), 1)
    else:
        first, second = overlapping_pairs(boxes[:, known], max_distance)
    # In the same order at each tick, for the witnesses.
    first, second = known[np.minimum(first, second)], known[np.maximum(first, second)]
    if table.has_single_shapes:
        return first, second
    different = table.entities[first] != table.entities[second]
    return first[different], second[different]


# -- rules -------------------------------------------------------------------------------------


def _by_spheres(tick: TickShapes, first: Indices, second: Indices, bounds: Array) -> Decisions:
    """Decides by the spheres around and in the shapes; a half-space has none."""
    table, error = tick.table, tolerances(tick.placed_cores, first, second)
    outer_radii = table.bounding_radius[first] + table.bounding_radius[second]
    inner_radii = table.inscribed_radius[first], table.inscribed_radius[second]
    gaps = _distances(tick.inscribed_centres, first, second) - inner_radii[0] - inner_radii[1]
    gaps[(inner_radii[0] <= 0.0) | (inner_radii[1] <= 0.0)] = np.inf
    least = _distances(tick.centres, first, second) - outer_radii
    return Decisions.of_interval(least, gaps, bounds, error)


def pairs_of_boxes(table: ShapeTable, first: Indices, second: Indices) -> Indices:
    """Returns which pairs of shapes are boxes; none for a few among others.

    Rules for all convex shapes decide these few, too, which takes less time.
    """
    indices = np.flatnonzero(table.is_box[first] & table.is_box[second])
    return indices if len(indices) >= min(_MIN_BOXES, len(first)) else indices[:0]


def are_few_boxes(table: ShapeTable, first: Indices, second: Indices) -> bool:
    """Checks whether pairs of shapes are so few boxes that the narrow phase is faster."""
    return len(first) <= _FEW_BOXES and bool((table.is_box[first] & table.is_box[second]).all())


def _distances(points: Array, first: Indices, second: Indices) -> Array:
    offsets = points[first] - points[second]
    lengths: Array = np.sqrt(np.einsum("ni,ni->n", offsets, offsets))
    return lengths


def _by_planes(tick: TickShapes, first: Indices, second: Indices, bounds: Array) -> Decisions:
    """Decides half-spaces against any other shape, by the point that is deepest."""
    table = tick.table
    decisions = Decisions.none(len(first))
    if not table.has_planes:
        return decisions
    indices = np.flatnonzero(table.is_plane[first] != table.is_plane[second])
    if not len(indices):
        return decisions
    is_first = table.is_plane[first[indices]]
    plane = np.where(is_first, first[indices], second[indices])
    other = np.where(is_first, second[indices], first[indices])
    normals = rotate(tick.matrices[plane], table.normal[plane])
    lowest = tick.centres[other] - tick.positions[plane]
    lowest += tick.placed_cores.support_points(other, -normals.T).T
    gaps = np.einsum("ni,ni->n", normals, lowest) - table.cores.radius[other]
    found = Decisions.of_interval(
        gaps, gaps, bounds[indices], tolerances(tick.placed_cores, plane, other)
    )
    decisions.decide(indices, found.verdicts, found.room)
    return decisions


def _by_axes(tick: TickShapes, first: Indices, second: Indices, bounds: Array) -> Decisions:
    """Decides boxes exactly, by separating axes."""
    decisions = Decisions.none(len(first))
    indices = pairs_of_boxes(tick.table, first, second)
    if not len(indices):
        return decisions
    boxes = first[indices], second[indices]
    depths, error = box_depths(tick.placed_cores, *boxes), tolerances(tick.placed_cores, *boxes)
    gaps = -depths - bounds[indices]
    room = np.maximum(np.abs(gaps) - error, 0.0)
    decisions.decide(indices, np.where(gaps < 0.0, BELOW, ABOVE), room)
    return decisions


def _by_axes_if_sure(tick: TickShapes, first: Indices, second: Indices, bounds: Array) -> Decisions:
    """Decides boxes that overlap, and those that an axis separates by more than the bound."""
    decisions = Decisions.none(len(first))
    indices = pairs_of_boxes(tick.table, first, second)
    if not len(indices):
        return decisions
    boxes = first[indices], second[indices]
    depths, error = box_depths(tick.placed_cores, *boxes), tolerances(tick.placed_cores, *boxes)
    # An axis that separates boxes is a lower bound of their distance only.
    greatest = np.where(depths > error, -depths, np.inf)
    found = Decisions.of_interval(-depths, greatest, bounds[indices], error)
    decisions.decide(indices, found.verdicts, found.room)
    return decisions


def _by_cores(
    tick: TickShapes,
    first: Indices,
    second: Indices,
    bounds: Array,
    kept: KeptWitnesses | None = None,
) -> Decisions:
    """Decides convex shapes by GJK. The convex hull of a mesh can only show that it is far away."""
    table = tick.table
    decisions = Decisions.none(len(first))
    if are_few_boxes(table, first, second):
        return decisions
    indices = np.flatnonzero(~(table.is_plane[first] | table.is_plane[second]))
    found = decide_gaps(tick.placed_cores, first[indices], second[indices], bounds[indices], kept)
    is_concave = ~(table.is_convex[first[indices]] & table.is_convex[second[indices]])
    found.decide(is_concave & (found.verdicts == BELOW), UNDECIDED)
    decisions.decide(indices, found.verdicts, found.room)
    return decisions
