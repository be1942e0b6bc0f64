"""Compares all candidate pairs of a tick at once: which entities collide, touch or are near.

The broad phase finds the pairs of shapes with overlapping boxes. Many of them are decided by
spheres: those around the shapes are far apart, or those in the shapes overlap. Support functions
decide half-spaces, separating axes decide boxes that may collide, and `ssduck.geometry.proofs.gjk`
decides other convex shapes, or `ssduck.geometry.proofs.proposals` if there are few. The convex hull
of a mesh shows that the mesh is far from something. Only the pairs that are left are compared one
by one: pairs that are as near to the bound as rounding errors, and meshes that may collide.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.broad_phase import Pairs
from ssduck.geometry.poses import rotate
from ssduck.geometry.proofs.gjk import decide_gaps, tolerances
from ssduck.geometry.proofs.separating_axes import box_depths
from ssduck.geometry.proofs.verdicts import (
    ABOVE,
    BELOW,
    UNDECIDED,
    Decisions,
    KeptVerdicts,
    Verdicts,
)
from ssduck.geometry.tick_shapes import (
    MAX_ENTITIES,
    PairPredicate,
    ShapeTable,
    TickShapes,
)

# The greatest number of pairs for which FCL's proposals are faster than other rules.
_MAX_PROPOSALS = 128


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
        return self.numbers // MAX_ENTITIES, self.numbers % MAX_ENTITIES

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """The pairs in order; the lower entity of each is first."""
        first, second = self.sides
        return list(zip(first.tolist(), second.tolist(), strict=True))


def matching_pairs(
    tick: TickShapes,
    predicate: PairPredicate,
    satisfies: Callable[[int, int], bool],
    among: Pairs | None = None,
    kept: KeptVerdicts | None = None,
) -> PairResult:
    """Returns the pairs of entities for which a predicate holds."""
    among = predicate.candidates(tick) if among is None else comparable_pairs(tick, among)
    bounds = predicate.bounds(tick.table, *among)
    rules: tuple[Rule, ...] = (_by_planes, _by_axes, _by_proposals, _by_spheres, _by_cores)
    if predicate.kind != "colliding":  # a distance is not negative
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


def proven_verdicts(
    tick: TickShapes,
    first: Indices,
    second: Indices,
    bounds: Array,
    directions: Array | None = None,
) -> Verdicts:
    """Classifies the signed distances of pairs of shapes, as far as rules prove it."""
    return _proven(tick, first, second, bounds, directions).verdicts


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def _proven(
    tick: TickShapes,
    first: Indices,
    second: Indices,
    bounds: Array,
    directions: Array | None = None,
) -> Decisions:
    decisions = Decisions.none(len(first))
    pairs = np.arange(len(first))
    for rule in (_by_spheres, _by_planes, _by_axes):
        found = rule(tick, first[pairs], second[pairs], bounds[pairs])
        decisions.decide(pairs, found.verdicts, found.room)
        pairs = pairs[found.verdicts == UNDECIDED]
    tried = None if directions is None else directions[:, pairs]
    found = _by_cores(tick, first[pairs], second[pairs], bounds[pairs], directions=tried)
    decisions.decide(pairs, found.verdicts, found.room)
    return decisions


def touching_verdicts(tick: TickShapes, pairs: Pairs, predicate: PairPredicate) -> Verdicts:
    """Returns the verdicts on a distance of touching shapes, and keeps them for the next tick."""

    def decide(first: Indices, second: Indices) -> Decisions:
        return _proven(tick, first, second, predicate.bounds(tick.table, first, second))

    return kept_verdicts(tick, tick.table.kept_touching, pairs, decide)


def kept_verdicts(
    tick: TickShapes,
    kept: KeptVerdicts,
    pairs: Pairs,
    decide: Callable[[Indices, Indices], Decisions],
) -> Verdicts:
    """Returns the verdicts of the tick before that still hold, and decides the other pairs."""
    first, second = pairs
    with np.errstate(invalid="ignore"):
        decisions = kept.find(tick.poses, first, second)
    places = np.flatnonzero(decisions.verdicts == UNDECIDED)
    if len(places):
        found = decide(first[places], second[places])
        decisions.decide(places, found.verdicts, found.room)
        _limit_room(decisions, tick, pairs)
        kept.keep(tick.poses, first, second, decisions)
    return decisions.verdicts


def _limit_room(decisions: Decisions, tick: TickShapes, pairs: Pairs) -> None:
    """The depth of a shape that is not convex may change by more than its points move."""
    if tick.table.are_all_convex:
        return
    first, second = pairs
    is_convex = tick.table.is_convex
    is_concave = ~(is_convex[first] & is_convex[second])
    decisions.room[is_concave & (decisions.verdicts == BELOW)] = 0.0


# Shapes whose squared lengths overflow stay undecided.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def _matching_entities(
    tick: TickShapes,
    candidates: Pairs,
    rules: Sequence[Rule],
    bounds: Array,
    is_below: Callable[[int, int], bool],
    kept: KeptVerdicts | None,
) -> PairResult:
    """Returns the pairs of entities with shapes whose signed distance is below a bound."""
    first, second = candidates
    has_single_shapes = tick.table.has_single_shapes
    owners = tick.owners(first, second)
    compared = owners if has_single_shapes else np.unique(owners)
    decisions = Decisions.none(len(first))
    if kept is not None:
        decisions = kept.find(tick.poses, first, second)
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
        some = first.take(open_pairs), second.take(open_pairs), bounds.take(open_pairs)
        found = rule(tick, *some)
        if found.verdicts.any():
            decisions.decide(open_pairs, found.verdicts, found.room)
            open_pairs = open_pairs[found.verdicts == UNDECIDED]
    _compare_one_by_one(decisions, open_pairs, owners, candidates, is_below)
    if kept is not None and not is_kept:
        _limit_room(decisions, tick, candidates)
        kept.keep(tick.poses, first, second, decisions)
    matching = owners[verdicts == BELOW]
    return PairResult(np.sort(matching) if has_single_shapes else np.unique(matching), compared)


def _compare_one_by_one(
    decisions: Decisions,
    open_pairs: Indices,
    owners: Indices,
    candidates: Pairs,
    is_below: Callable[[int, int], bool],
) -> None:
    """Decides the pairs that no rule decides, until one of each pair of entities is below."""
    if not len(open_pairs):
        return
    matching = set(owners[decisions.verdicts == BELOW].tolist())
    sides = (side[open_pairs].tolist() for side in (owners, *candidates))
    for pair, owner, s, t in zip(open_pairs.tolist(), *sides, strict=True):
        if owner not in matching:
            decisions.verdicts[pair] = BELOW if is_below(s, t) else ABOVE
            if decisions.verdicts[pair] == BELOW:
                matching.add(owner)


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


def _by_proposals(tick: TickShapes, first: Indices, second: Indices, bounds: Array) -> Decisions:
    """Decides a few convex shapes by what FCL proposes."""
    if len(first) > _MAX_PROPOSALS:
        return Decisions.none(len(first))
    proposer = tick.table.proposer
    interiors, poses = proposer.interiors, (tick.positions, tick.matrices)
    decisions, are_known = Decisions.none(len(first)), interiors.are_known
    indices = np.flatnonzero(are_known.take(first) & are_known.take(second))
    if not len(indices):
        return decisions
    pairs = first.take(indices), second.take(indices)
    found = proposer.decide(tick.placed_cores, poses, *pairs, bounds.take(indices))
    decisions.decide(indices, found.verdicts, found.room)
    return decisions


def pairs_of_boxes(table: ShapeTable, first: Indices, second: Indices) -> Indices:
    """Returns which pairs of shapes are boxes."""
    return np.flatnonzero(table.is_box[first] & table.is_box[second])


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
    directions: Array | None = None,
) -> Decisions:
    """Decides convex shapes by GJK. The convex hull of a mesh can only show that it is far away."""
    table = tick.table
    decisions = Decisions.none(len(first))
    indices = np.flatnonzero(~(table.is_plane[first] | table.is_plane[second]))
    tried = None if directions is None else directions[:, indices]
    some = first[indices], second[indices], bounds[indices]
    found = decide_gaps(tick.placed_cores, *some, tried)
    is_concave = ~(table.is_convex[first[indices]] & table.is_convex[second[indices]])
    found.decide(is_concave & (found.verdicts == BELOW), UNDECIDED)
    decisions.decide(indices, found.verdicts, found.room)
    return decisions
