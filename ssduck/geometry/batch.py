"""Which entities of a tick collide, touch or are near each other, all of them at once.

The broad phase finds the pairs of shapes whose boxes meet. Spheres around the shapes that are far
apart, and spheres in them that are near, decide many of these; half-spaces are decided by support
functions, boxes that may collide by their separating axes (Gottschalk, Lin and Manocha, OBBTree,
1996), what else is convex by `ssduck.geometry.gjk`. The convex hull of a mesh tells if it is far
from something. Only what is left is compared one by one: what is as near to the bound as errors
are, meshes that may meet.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.broad_phase import Pairs, overlapping_pairs
from ssduck.geometry.gjk import (
    ABOVE,
    BELOW,
    UNDECIDED,
    ConvexCores,
    PlacedCores,
    Verdicts,
    classify_gaps,
    tolerances,
)
from ssduck.geometry.poses import rotate
from ssduck.geometry.solids import Solid

# Two edges that are as parallel have no axis of their own.
_PARALLEL = 1e-6
# Boxes are looked at a little farther out, m, for what is exactly as far as is asked for.
_MARGIN = 1e-8
_MOST_ENTITIES = 1 << 32
# The other two axes of each.
_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])


PredicateKind: TypeAlias = Literal["colliding", "within", "touching"]


@dataclass(frozen=True)
class PairPredicate:
    """What is asked of two entities: it holds if it does of two of their shapes.

    Attributes:
        of: whether they collide: are deeper in each other than `distance`; whether the distance
            of their nearest points is at most `distance`; whether they touch: that distance is
            at most `distance` and the collision margins of both shapes.
        distance: metres.
    """

    of: PredicateKind
    distance: float

    def bound(self, margins: float) -> float:
        """What the gap of two shapes is to be below, or at most.

        Args:
            margins: of both together, metres.
        """
        if self.of == "colliding":
            return -self.distance
        return self.distance + margins if self.of == "touching" else self.distance

    def bounds(self, table: ShapeTable, first: Indices, second: Indices) -> Array:
        """The bounds of pairs of shapes, (n,)."""
        found = np.full(len(first), self.bound(0.0))
        if self.of == "touching":
            found += table.margins[first] + table.margins[second]
        return found

    def candidates(self, tick: TickShapes) -> Pairs:
        """The pairs of shapes whose boxes are near enough."""
        if self.of == "colliding":
            return _candidates(tick, tick.boxes, 0.0)
        if self.of == "within":
            return _candidates(tick, tick.boxes, self.distance + _MARGIN)
        margins = tick.table.margins
        grown = np.concatenate((tick.boxes[:3] - margins, tick.boxes[3:] + margins))
        return _candidates(tick, grown, max(self.distance, 0.0) + _MARGIN)


class ShapeTable:
    """What does not depend on the poses of shapes.

    Args:
        solids: the different solids.
        of: (n,), which solid each shape is.
        entities: (n,), whose shape it is.
        margins: (n,), the collision margins, metres; None for none.
    """

    def __init__(
        self,
        solids: Sequence[Solid],
        of: Indices,
        entities: Indices,
        margins: Array | None = None,
    ) -> None:
        self.entities = entities
        self.margins = np.zeros(len(of)) if margins is None else margins
        self.count = int(entities.max(initial=-1)) + 1
        self.has_single_shapes = bool(np.bincount(entities).max(initial=0) <= 1)
        self.is_known = np.array([solid.is_known for solid in solids], dtype=bool)[of]
        self.has_points = np.array([not solid.is_empty for solid in solids], dtype=bool)[of]
        self.is_plane = np.array([solid.type == "plane" for solid in solids], dtype=bool)[of]
        self.is_box = np.array([solid.type == "box" for solid in solids], dtype=bool)[of]
        self.is_convex = np.array([solid.is_convex for solid in solids], dtype=bool)[of]
        self.bounding_radius = np.array([solid.bounding_radius for solid in solids])[of]
        self.centre = np.array([solid.centre for solid in solids]).reshape(-1, 3)[of]
        self.inscribed_centre = np.array([solid.inscribed_centre for solid in solids]).reshape(
            -1, 3
        )[of]
        self.inscribed_radius = np.array([solid.inscribed_radius for solid in solids])[of]
        up = np.array([0.0, 0.0, 1.0])
        normals = [s.normals[0] if s.type == "plane" and s.is_known else up for s in solids]
        self.normal = np.array(normals).reshape(-1, 3)[of]
        self.cores = ConvexCores(solids, of)


@dataclass(frozen=True, eq=False)
class TickShapes:
    """The shapes of a tick, in arrays.

    Attributes:
        table: what they are, and whose.
        is_known: (n,), whether the poses and the shapes of its entity are known.
        boxes: (6, n), lower corners, upper corners.
        positions: (n, 3).
        matrices: (n, 3, 3).
    """

    table: ShapeTable
    is_known: Flags
    boxes: Array
    positions: Array
    matrices: Array

    def moved(self, points: Array) -> Array:
        """A point (n, 3) of each shape, in the world."""
        if not points.any():
            return self.positions
        with np.errstate(invalid="ignore"):
            moved: Array = self.positions + rotate(self.matrices, points)
        return moved

    @cached_property
    def centres(self) -> Array:
        """(n, 3), of the spheres around the shapes."""
        return self.moved(self.table.centre)

    @cached_property
    def inner(self) -> Array:
        """(n, 3), of the spheres in the shapes."""
        return self.moved(self.table.inscribed_centre)

    @cached_property
    def placed_cores(self) -> PlacedCores:
        """The shapes' cores."""
        turns = np.ascontiguousarray(self.matrices.transpose(1, 2, 0)).reshape(9, -1)
        centres, inner = map(np.ascontiguousarray, (self.centres.T, self.inner.T))
        return PlacedCores(self.table.cores, turns, centres, inner)

    def owners(self, first: Indices, second: Indices) -> Indices:
        """Whose shapes these are: a number for each pair of entities, as of `pair_number`."""
        i, j = self.table.entities[first], self.table.entities[second]
        return np.minimum(i, j) * _MOST_ENTITIES + np.maximum(i, j)


def pair_number(i: int, j: int) -> int:
    """A number for a pair of entities in either order."""
    return min(i, j) * _MOST_ENTITIES + max(i, j)


@dataclass(frozen=True, eq=False)
class PairResult:
    """What was found of all pairs of entities.

    Attributes:
        numbers: of those asked for, ascending; see `pair_number`.
        compared: of those with shapes whose boxes meet, or are as near as is asked for.
    """

    numbers: Indices
    compared: Indices

    @property
    def sides(self) -> Pairs:
        """The lesser entity of each pair, and the other."""
        return self.numbers // _MOST_ENTITIES, self.numbers % _MOST_ENTITIES

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """The pairs, in order; of each the lesser entity is the first."""
        first, second = self.sides
        return list(zip(first.tolist(), second.tolist(), strict=True))


def of_known_entities(table: ShapeTable, is_known: Flags) -> Flags:
    """Of each shape whether all of its entity are known."""
    lost = np.bincount(table.entities[~is_known], minlength=table.count)
    all_known: Flags = lost[table.entities] == 0
    return all_known


def matching_pairs(
    tick: TickShapes,
    predicate: PairPredicate,
    holds: Callable[[int, int], bool],
    among: Pairs | None = None,
) -> PairResult:
    """The pairs of entities of which something holds.

    Args:
        tick: the shapes.
        predicate: what is to hold of two of their shapes.
        holds: whether it does, asked of those that nothing else decides.
        among: the pairs of shapes that are compared; None for all that are near enough.
    """
    among = predicate.candidates(tick) if among is None else _usable(tick, among)
    bounds = predicate.bounds(tick.table, *among)
    rules: tuple[Rule, ...] = _by_spheres, _by_planes, _by_cores
    if predicate.of == "colliding":
        rules = _by_spheres, _by_planes, _by_axes, _by_cores
    else:  # no distance is below 0
        usable = bounds >= 0.0
        among, bounds = (among[0][usable], among[1][usable]), bounds[usable]
    return _found(tick, among, rules, bounds, holds)


def _usable(tick: TickShapes, shapes: Pairs) -> Pairs:
    first, second = shapes
    usable = tick.is_known & tick.table.has_points
    both = usable[first] & usable[second]
    return first[both], second[both]


Rule: TypeAlias = Callable[[TickShapes, Indices, Indices, Array], Verdicts]


# What is too large for its squares is not decided by them.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def _found(
    tick: TickShapes,
    candidates: Pairs,
    rules: Sequence[Rule],
    bounds: Array,
    is_below: Callable[[int, int], bool],
) -> PairResult:
    """The pairs of entities with shapes whose gaps are below bounds, or of which it is said.

    Args:
        tick: the shapes.
        candidates: the pairs of shapes that are compared.
        rules: what is asked of them, one after another, until they are decided.
        bounds: of each pair, metres.
        is_below: asked of two shapes that no rule decides.
    """
    first, second = candidates
    has_single_shapes = tick.table.has_single_shapes
    owners = tick.owners(first, second)
    compared = owners if has_single_shapes else np.unique(owners)
    found = np.zeros(0, np.intp)
    for rule in rules:
        verdicts = rule(tick, first, second, bounds)
        found = np.concatenate((found, owners[verdicts == BELOW]))
        left = verdicts == UNDECIDED
        if not has_single_shapes:
            left &= ~np.isin(owners, found)
        first, second, owners, bounds = first[left], second[left], owners[left], bounds[left]
    more: set[int] = set()
    for owner, s, t in zip(owners.tolist(), first.tolist(), second.tolist(), strict=True):
        if owner not in more and is_below(s, t):
            more.add(owner)
    found = np.concatenate((found, np.array(sorted(more), np.intp)))
    return PairResult(np.sort(found) if has_single_shapes else np.unique(found), compared)


def _candidates(tick: TickShapes, boxes: Array, apart: float) -> Pairs:
    """The pairs of known shapes, of two entities, whose boxes (6, n) are no farther apart.

    There are none if that is below 0, or no number.
    """
    if not apart >= 0.0:
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    table = tick.table
    usable = np.flatnonzero(tick.is_known & table.has_points)
    if apart == np.inf:
        first, second = np.triu_indices(len(usable), 1)
    else:
        first, second = overlapping_pairs(boxes[:, usable], apart)
    first, second = usable[first], usable[second]
    if table.has_single_shapes:
        return first, second
    different = table.entities[first] != table.entities[second]
    return first[different], second[different]


# -- rules -------------------------------------------------------------------------------------


def _by_spheres(tick: TickShapes, first: Indices, second: Indices, bounds: Array) -> Verdicts:
    """The spheres around shapes, and those in them; a half-space has none."""
    table, error = tick.table, tolerances(tick.placed_cores, first, second)
    verdicts = np.zeros(len(first), np.int8)
    around = table.bounding_radius[first] + table.bounding_radius[second]
    verdicts[_distances(tick.centres, first, second) > around + bounds + error] = ABOVE
    within = table.inscribed_radius[first], table.inscribed_radius[second]
    apart = _distances(tick.inner, first, second) - within[0] - within[1]
    verdicts[(apart < bounds - error) & (within[0] > 0.0) & (within[1] > 0.0)] = BELOW
    return verdicts


def _distances(points: Array, first: Indices, second: Indices) -> Array:
    way = points[first] - points[second]
    lengths: Array = np.sqrt(np.einsum("ni,ni->n", way, way))
    return lengths


def _by_planes(tick: TickShapes, first: Indices, second: Indices, bounds: Array) -> Verdicts:
    """Half-spaces and any other shape, by the point of it that is farthest in."""
    table = tick.table
    verdicts = np.zeros(len(first), np.int8)
    some = np.flatnonzero(table.is_plane[first] != table.is_plane[second])
    if not len(some):
        return verdicts
    is_first = table.is_plane[first[some]]
    plane = np.where(is_first, first[some], second[some])
    other = np.where(is_first, second[some], first[some])
    normals = rotate(tick.matrices[plane], table.normal[plane])
    lowest = tick.centres[other] - tick.positions[plane]
    lowest += tick.placed_cores.support_points(other, -normals.T).T
    gaps = np.einsum("ni,ni->n", normals, lowest) - table.cores.radius[other]
    error = tolerances(tick.placed_cores, plane, other)
    verdicts[some[gaps > bounds[some] + error]] = ABOVE
    verdicts[some[gaps < bounds[some] - error]] = BELOW
    return verdicts


def _by_axes(tick: TickShapes, first: Indices, second: Indices, bounds: Array) -> Verdicts:
    """Boxes that may be deep in each other: exactly."""
    verdicts = np.zeros(len(first), np.int8)
    some = np.flatnonzero(tick.table.is_box[first] & tick.table.is_box[second])
    is_deep = box_depths(tick, first[some], second[some]) > -bounds[some]
    verdicts[some] = np.where(is_deep, BELOW, ABOVE)
    return verdicts


def _by_cores(tick: TickShapes, first: Indices, second: Indices, bounds: Array) -> Verdicts:
    """What is convex; the convex hull of a mesh only tells that it is far from something."""
    table = tick.table
    verdicts = np.zeros(len(first), np.int8)
    some = np.flatnonzero(~(table.is_plane[first] | table.is_plane[second]))
    found = classify_gaps(tick.placed_cores, first[some], second[some], bounds[some])
    hollow = ~(table.is_convex[first[some]] & table.is_convex[second[some]])
    found[hollow & (found == BELOW)] = UNDECIDED
    verdicts[some] = found
    return verdicts


def box_depths(tick: TickShapes, first: Indices, second: Indices) -> Array:
    """How deep boxes are in each other, m: the least overlap along their 15 axes; < 0 if apart."""
    a, b = tick.table.cores.half_extents[:, first].T, tick.table.cores.half_extents[:, second].T
    turn_a, turn_b = tick.matrices[first], tick.matrices[second]
    # The second box in the frame of the first.
    turn = np.einsum("nji,njk->nik", turn_a, turn_b)
    way = np.einsum("nji,nj->ni", turn_a, tick.positions[second] - tick.positions[first])
    size = np.abs(turn)
    faces_a = a + np.einsum("nij,nj->ni", size, b) - np.abs(way)
    faces_b = b + np.einsum("nij,ni->nj", size, a) - np.abs(np.einsum("nij,ni->nj", turn, way))
    edges = _edge_overlaps(a, b, turn, size, way).reshape(len(first), 9)
    depths: Array = np.concatenate((faces_a, faces_b, edges), axis=1).min(axis=1)
    return depths


def _edge_overlaps(a: Array, b: Array, turn: Array, size: Array, way: Array) -> Array:
    """The overlaps along the cross products of edges, (n, 3, 3)."""
    of_a = a[:, _NEXT, None] * size[:, _LAST, :] + a[:, _LAST, None] * size[:, _NEXT, :]
    of_b = b[:, None, _NEXT] * size[:, :, _LAST] + b[:, None, _LAST] * size[:, :, _NEXT]
    across = way[:, _LAST, None] * turn[:, _NEXT, :] - way[:, _NEXT, None] * turn[:, _LAST, :]
    length = np.sqrt(np.maximum(1.0 - turn * turn, 0.0))
    parallel = length < _PARALLEL
    overlaps: Array = (of_a + of_b - np.abs(across)) / np.where(parallel, 1.0, length)
    return np.where(parallel, np.inf, overlaps)
