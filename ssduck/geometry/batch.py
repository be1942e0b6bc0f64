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
from ssduck.geometry.broad_phase import Pairs, meeting
from ssduck.geometry.gjk import (
    ABOVE,
    BELOW,
    UNDECIDED,
    ConvexCores,
    PlacedCores,
    Verdicts,
    compare,
    slack,
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


Asked: TypeAlias = Literal["colliding", "within", "touching"]


@dataclass(frozen=True)
class PairPredicate:
    """What is asked of two entities: it holds if it does of two of their shapes.

    Attributes:
        of: whether they collide: are deeper in each other than `distance`; whether the distance
            of their nearest points is at most `distance`; whether they touch: that distance is
            at most `distance` and the collision margins of both shapes.
        distance: metres.
    """

    of: Asked
    distance: float

    def bound(self, margins: float) -> float:
        """What the gap of two shapes is to be below, or at most.

        Args:
            margins: of both together, metres.
        """
        if self.of == "colliding":
            return -self.distance
        return self.distance + margins if self.of == "touching" else self.distance

    def bounds(self, sorts: ShapeTable, first: Indices, second: Indices) -> Array:
        """The bounds of pairs of shapes, (n,)."""
        found = np.full(len(first), self.bound(0.0))
        if self.of == "touching":
            found += sorts.margins[first] + sorts.margins[second]
        return found

    def candidates(self, scene: TickPairs) -> Pairs:
        """The pairs of shapes whose boxes are near enough."""
        if self.of == "colliding":
            return _candidates(scene, scene.boxes, 0.0)
        if self.of == "within":
            return _candidates(scene, scene.boxes, self.distance + _MARGIN)
        margins = scene.sorts.margins
        grown = np.concatenate((scene.boxes[:3] - margins, scene.boxes[3:] + margins))
        return _candidates(scene, grown, max(self.distance, 0.0) + _MARGIN)


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
        self.single = bool(np.bincount(entities).max(initial=0) <= 1)
        self.known = np.array([solid.known for solid in solids], dtype=bool)[of]
        self.is_shown = np.array([not solid.is_empty for solid in solids], dtype=bool)[of]
        self.is_endless = np.array([solid.type == "plane" for solid in solids], dtype=bool)[of]
        self.is_box = np.array([solid.type == "box" for solid in solids], dtype=bool)[of]
        self.is_convex = np.array([solid.is_convex for solid in solids], dtype=bool)[of]
        self.reach = np.array([solid.reach for solid in solids])[of]
        self.centre = np.array([solid.centre for solid in solids]).reshape(-1, 3)[of]
        self.inner_centre = np.array([solid.inner_centre for solid in solids]).reshape(-1, 3)[of]
        self.inner_radius = np.array([solid.inner_radius for solid in solids])[of]
        up = np.array([0.0, 0.0, 1.0])
        normals = [s.normals[0] if s.type == "plane" and s.known else up for s in solids]
        self.normal = np.array(normals).reshape(-1, 3)[of]
        self.cores = ConvexCores(solids, of)


@dataclass(frozen=True, eq=False)
class TickPairs:
    """The shapes of a tick, in arrays.

    Attributes:
        sorts: what they are, and whose.
        known: (n,), whether the poses and the shapes of its entity are known.
        boxes: (6, n), lower corners, upper corners.
        positions: (n, 3).
        matrices: (n, 3, 3).
    """

    sorts: ShapeTable
    known: Flags
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
        return self.moved(self.sorts.centre)

    @cached_property
    def inner(self) -> Array:
        """(n, 3), of the spheres in the shapes."""
        return self.moved(self.sorts.inner_centre)

    @cached_property
    def bodies(self) -> PlacedCores:
        """The shapes' cores."""
        turns = np.ascontiguousarray(self.matrices.transpose(1, 2, 0)).reshape(9, -1)
        centres, inner = map(np.ascontiguousarray, (self.centres.T, self.inner.T))
        return PlacedCores(self.sorts.cores, turns, centres, inner)

    def owners(self, first: Indices, second: Indices) -> Indices:
        """Whose shapes these are: a number for each pair of entities, as of `pair_number`."""
        i, j = self.sorts.entities[first], self.sorts.entities[second]
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


def known_with_all(sorts: ShapeTable, known: Flags) -> Flags:
    """Of each shape whether all of its entity are known."""
    lost = np.bincount(sorts.entities[~known], minlength=sorts.count)
    all_known: Flags = lost[sorts.entities] == 0
    return all_known


def entities_of(
    scene: TickPairs,
    question: PairPredicate,
    holds: Callable[[int, int], bool],
    among: Pairs | None = None,
) -> PairResult:
    """The pairs of entities of which something holds.

    Args:
        scene: the shapes.
        question: what is to hold of two of their shapes.
        holds: whether it does, asked of those that nothing else decides.
        among: the pairs of shapes that are compared; None for all that are near enough.
    """
    among = question.candidates(scene) if among is None else _usable(scene, among)
    bounds = question.bounds(scene.sorts, *among)
    rules: tuple[Rule, ...] = _by_spheres, _by_planes, _by_cores
    if question.of == "colliding":
        rules = _by_spheres, _by_planes, _by_axes, _by_cores
    else:  # no distance is below 0
        usable = bounds >= 0.0
        among, bounds = (among[0][usable], among[1][usable]), bounds[usable]
    return _found(scene, among, rules, bounds, holds)


def _usable(scene: TickPairs, shapes: Pairs) -> Pairs:
    first, second = shapes
    usable = scene.known & scene.sorts.is_shown
    both = usable[first] & usable[second]
    return first[both], second[both]


Rule: TypeAlias = Callable[[TickPairs, Indices, Indices, Array], Verdicts]


# What is too large for its squares is not decided by them.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def _found(
    scene: TickPairs,
    candidates: Pairs,
    rules: Sequence[Rule],
    bounds: Array,
    is_below: Callable[[int, int], bool],
) -> PairResult:
    """The pairs of entities with shapes whose gaps are below bounds, or of which it is said.

    Args:
        scene: the shapes.
        candidates: the pairs of shapes that are compared.
        rules: what is asked of them, one after another, until they are decided.
        bounds: of each pair, metres.
        is_below: asked of two shapes that no rule decides.
    """
    first, second = candidates
    single = scene.sorts.single
    owners = scene.owners(first, second)
    compared = owners if single else np.unique(owners)
    found = np.zeros(0, np.intp)
    for rule in rules:
        verdicts = rule(scene, first, second, bounds)
        found = np.concatenate((found, owners[verdicts == BELOW]))
        left = verdicts == UNDECIDED
        if not single:
            left &= ~np.isin(owners, found)
        first, second, owners, bounds = first[left], second[left], owners[left], bounds[left]
    more: set[int] = set()
    for owner, s, t in zip(owners.tolist(), first.tolist(), second.tolist(), strict=True):
        if owner not in more and is_below(s, t):
            more.add(owner)
    found = np.concatenate((found, np.array(sorted(more), np.intp)))
    return PairResult(np.sort(found) if single else np.unique(found), compared)


def _candidates(scene: TickPairs, boxes: Array, apart: float) -> Pairs:
    """The pairs of known shapes, of two entities, whose boxes (6, n) are no farther apart.

    There are none if that is below 0, or no number.
    """
    if not apart >= 0.0:
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    sorts = scene.sorts
    usable = np.flatnonzero(scene.known & sorts.is_shown)
    if apart == np.inf:
        first, second = np.triu_indices(len(usable), 1)
    else:
        first, second = meeting(boxes[:, usable], apart)
    first, second = usable[first], usable[second]
    if sorts.single:
        return first, second
    different = sorts.entities[first] != sorts.entities[second]
    return first[different], second[different]


# -- rules -------------------------------------------------------------------------------------


def _by_spheres(scene: TickPairs, first: Indices, second: Indices, bounds: Array) -> Verdicts:
    """The spheres around shapes, and those in them; a half-space has none."""
    sorts, error = scene.sorts, slack(scene.bodies, first, second)
    verdicts = np.zeros(len(first), np.int8)
    around = sorts.reach[first] + sorts.reach[second]
    verdicts[_distances(scene.centres, first, second) > around + bounds + error] = ABOVE
    within = sorts.inner_radius[first], sorts.inner_radius[second]
    apart = _distances(scene.inner, first, second) - within[0] - within[1]
    verdicts[(apart < bounds - error) & (within[0] > 0.0) & (within[1] > 0.0)] = BELOW
    return verdicts


def _distances(points: Array, first: Indices, second: Indices) -> Array:
    way = points[first] - points[second]
    lengths: Array = np.sqrt(np.einsum("ni,ni->n", way, way))
    return lengths


def _by_planes(scene: TickPairs, first: Indices, second: Indices, bounds: Array) -> Verdicts:
    """Half-spaces and any other shape, by the point of it that is farthest in."""
    sorts = scene.sorts
    verdicts = np.zeros(len(first), np.int8)
    some = np.flatnonzero(sorts.is_endless[first] != sorts.is_endless[second])
    if not len(some):
        return verdicts
    is_first = sorts.is_endless[first[some]]
    plane = np.where(is_first, first[some], second[some])
    other = np.where(is_first, second[some], first[some])
    normals = rotate(scene.matrices[plane], sorts.normal[plane])
    lowest = scene.centres[other] - scene.positions[plane]
    lowest += scene.bodies.supports(other, -normals.T).T
    gaps = np.einsum("ni,ni->n", normals, lowest) - sorts.cores.radius[other]
    error = slack(scene.bodies, plane, other)
    verdicts[some[gaps > bounds[some] + error]] = ABOVE
    verdicts[some[gaps < bounds[some] - error]] = BELOW
    return verdicts


def _by_axes(scene: TickPairs, first: Indices, second: Indices, bounds: Array) -> Verdicts:
    """Boxes that may be deep in each other: exactly."""
    verdicts = np.zeros(len(first), np.int8)
    some = np.flatnonzero(scene.sorts.is_box[first] & scene.sorts.is_box[second])
    is_deep = box_depths(scene, first[some], second[some]) > -bounds[some]
    verdicts[some] = np.where(is_deep, BELOW, ABOVE)
    return verdicts


def _by_cores(scene: TickPairs, first: Indices, second: Indices, bounds: Array) -> Verdicts:
    """What is convex; the convex hull of a mesh only tells that it is far from something."""
    sorts = scene.sorts
    verdicts = np.zeros(len(first), np.int8)
    some = np.flatnonzero(~(sorts.is_endless[first] | sorts.is_endless[second]))
    found = compare(scene.bodies, first[some], second[some], bounds[some])
    hollow = ~(sorts.is_convex[first[some]] & sorts.is_convex[second[some]])
    found[hollow & (found == BELOW)] = UNDECIDED
    verdicts[some] = found
    return verdicts


def box_depths(scene: TickPairs, first: Indices, second: Indices) -> Array:
    """How deep boxes are in each other, m: the least overlap along their 15 axes; < 0 if apart."""
    a, b = scene.sorts.cores.half[:, first].T, scene.sorts.cores.half[:, second].T
    turn_a, turn_b = scene.matrices[first], scene.matrices[second]
    # The second box in the frame of the first.
    turn = np.einsum("nji,njk->nik", turn_a, turn_b)
    way = np.einsum("nji,nj->ni", turn_a, scene.positions[second] - scene.positions[first])
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
