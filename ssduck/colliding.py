"""Which entities of a tick collide, or are near each other, all of them at once.

The broad phase finds the pairs of shapes whose boxes meet. Spheres around the shapes that are far
apart, and spheres in them that are near, decide many of these; half-spaces are decided by support
functions, boxes that may collide by their separating axes (Gottschalk, Lin and Manocha, OBBTree,
1996), what else is convex by `ssduck.gjk`. The convex hull of a mesh tells if it is far from
something. Only what is left is compared one by one: what is as near to the bound as errors are,
meshes that may meet.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np

from ssduck.broad import Flags, Pairs, meeting
from ssduck.geometry import Array, Indices, rotate, turns_of
from ssduck.gjk import ABOVE, BELOW, UNDECIDED, Bodies, Cores, Verdicts, compare, slack
from ssduck.solids import Solid

# Two edges that are as parallel have no axis of their own.
_PARALLEL = 1e-6
# Boxes are looked at a little farther out, m, for what is exactly as far as is asked for.
_MARGIN = 1e-8
_MOST_ENTITIES = 1 << 32
# The other two axes of each.
_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])


class Sorts:
    """What does not depend on the poses of shapes.

    Args:
        solids: the different solids.
        of: (n,), which solid each shape is.
        entities: (n,), whose shape it is.
    """

    def __init__(self, solids: Sequence[Solid], of: Indices, entities: Indices) -> None:
        self.entities = entities
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
        self.cores = Cores(solids, of)


@dataclass(frozen=True, eq=False)
class Scene:
    """The shapes of a tick, in arrays.

    Attributes:
        sorts: what they are, and whose.
        known: (n,), whether the poses and the shapes of its entity are known.
        boxes: (6, n), lower corners, upper corners.
        positions: (n, 3).
        matrices: (n, 3, 3).
    """

    sorts: Sorts
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
    def bodies(self) -> Bodies:
        """The shapes' cores."""
        turns = np.ascontiguousarray(self.matrices.transpose(1, 2, 0)).reshape(9, -1)
        centres, inner = map(np.ascontiguousarray, (self.centres.T, self.inner.T))
        return Bodies(self.sorts.cores, turns, centres, inner)

    def owners(self, first: Indices, second: Indices) -> Indices:
        """Whose shapes these are: a number for each pair of entities, as of `pair_number`."""
        i, j = self.sorts.entities[first], self.sorts.entities[second]
        return np.minimum(i, j) * _MOST_ENTITIES + np.maximum(i, j)


def pair_number(i: int, j: int) -> int:
    """A number for a pair of entities in either order."""
    return min(i, j) * _MOST_ENTITIES + max(i, j)


@dataclass(frozen=True, eq=False)
class Found:
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


def colliding(scene: Scene, deeper: float, is_deeper: Callable[[int, int], bool]) -> Found:
    """The pairs of entities with shapes that are deeper in each other.

    Args:
        scene: the shapes.
        deeper: metres.
        is_deeper: whether two shapes are, for those that nothing else decides.
    """
    rules = _by_spheres, _by_planes, _by_axes, _by_cores
    return _found(scene, _candidates(scene, 0.0), rules, -deeper, is_deeper)


def colliding_of(
    scene: Scene, shapes: Pairs, deeper: float, is_deeper: Callable[[int, int], bool]
) -> Found:
    """As `colliding`, of these pairs of shapes."""
    rules = _by_spheres, _by_planes, _by_axes, _by_cores
    return _found(scene, _usable(scene, shapes), rules, -deeper, is_deeper)


def within_of(
    scene: Scene, shapes: Pairs, apart: float, is_within: Callable[[int, int], bool]
) -> Found:
    """As `all_within`, of these pairs of shapes."""
    rules = _by_spheres, _by_planes, _by_cores
    return _found(scene, _usable(scene, shapes), rules, apart, is_within)


def _usable(scene: Scene, shapes: Pairs) -> Pairs:
    first, second = shapes
    usable = scene.known & scene.sorts.is_shown
    both = usable[first] & usable[second]
    return first[both], second[both]


def all_within(scene: Scene, apart: float, is_within: Callable[[int, int], bool]) -> Found:
    """The pairs of entities with shapes that are at most so far apart; what meets is 0 apart.

    Args:
        scene: the shapes.
        apart: metres, not below 0.
        is_within: whether two shapes are, for those that nothing else decides.
    """
    rules = _by_spheres, _by_planes, _by_cores
    return _found(scene, _candidates(scene, apart + _MARGIN), rules, apart, is_within)


Rule: TypeAlias = Callable[[Scene, Indices, Indices, float], Verdicts]


# What is too large for its squares is not decided by them.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def _found(
    scene: Scene,
    candidates: Pairs,
    rules: Sequence[Rule],
    bound: float,
    is_below: Callable[[int, int], bool],
) -> Found:
    """The pairs of entities with shapes whose gaps are below a bound, or of which it is said.

    Args:
        scene: the shapes.
        candidates: the pairs of shapes that are compared.
        rules: what is asked of them, one after another, until they are decided.
        bound: metres.
        is_below: asked of two shapes that no rule decides.
    """
    first, second = candidates
    single = scene.sorts.single
    owners = scene.owners(first, second)
    compared = owners if single else np.unique(owners)
    found = np.zeros(0, np.intp)
    for rule in rules:
        verdicts = rule(scene, first, second, bound)
        found = np.concatenate((found, owners[verdicts == BELOW]))
        left = verdicts == UNDECIDED
        if not single:
            left &= ~np.isin(owners, found)
        first, second, owners = first[left], second[left], owners[left]
    more: set[int] = set()
    for owner, s, t in zip(owners.tolist(), first.tolist(), second.tolist(), strict=True):
        if owner not in more and is_below(s, t):
            more.add(owner)
    found = np.concatenate((found, np.array(sorted(more), np.intp)))
    return Found(np.sort(found) if single else np.unique(found), compared)


def _candidates(scene: Scene, apart: float) -> Pairs:
    """The pairs of known shapes, of two entities, whose boxes are no farther apart."""
    sorts = scene.sorts
    usable = np.flatnonzero(scene.known & sorts.is_shown)
    if apart == np.inf:
        first, second = np.triu_indices(len(usable), 1)
    else:
        first, second = meeting(scene.boxes[:, usable], apart)
    first, second = usable[first], usable[second]
    if sorts.single:
        return first, second
    different = sorts.entities[first] != sorts.entities[second]
    return first[different], second[different]


# -- rules -------------------------------------------------------------------------------------


def _by_spheres(scene: Scene, first: Indices, second: Indices, bound: float) -> Verdicts:
    """The spheres around shapes, and those in them; a half-space has none."""
    sorts, error = scene.sorts, slack(scene.bodies, first, second)
    verdicts = np.zeros(len(first), np.int8)
    around = sorts.reach[first] + sorts.reach[second]
    verdicts[_distances(scene.centres, first, second) > around + bound + error] = ABOVE
    within = sorts.inner_radius[first], sorts.inner_radius[second]
    apart = _distances(scene.inner, first, second) - within[0] - within[1]
    verdicts[(apart < bound - error) & (within[0] > 0.0) & (within[1] > 0.0)] = BELOW
    return verdicts


def _distances(points: Array, first: Indices, second: Indices) -> Array:
    way = points[first] - points[second]
    lengths: Array = np.sqrt(np.einsum("ni,ni->n", way, way))
    return lengths


def _by_planes(scene: Scene, first: Indices, second: Indices, bound: float) -> Verdicts:
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
    verdicts[some[gaps > bound + error]] = ABOVE
    verdicts[some[gaps < bound - error]] = BELOW
    return verdicts


def _by_axes(scene: Scene, first: Indices, second: Indices, bound: float) -> Verdicts:
    """Boxes that may be deep in each other: exactly."""
    verdicts = np.zeros(len(first), np.int8)
    some = np.flatnonzero(scene.sorts.is_box[first] & scene.sorts.is_box[second])
    is_deep = box_depths(scene, first[some], second[some]) > -bound
    verdicts[some] = np.where(is_deep, BELOW, ABOVE)
    return verdicts


def _by_cores(scene: Scene, first: Indices, second: Indices, bound: float) -> Verdicts:
    """What is convex; the convex hull of a mesh only tells that it is far from something."""
    sorts = scene.sorts
    verdicts = np.zeros(len(first), np.int8)
    some = np.flatnonzero(~(sorts.is_endless[first] | sorts.is_endless[second]))
    found = compare(scene.bodies, first[some], second[some], bound)
    hollow = ~(sorts.is_convex[first[some]] & sorts.is_convex[second[some]])
    found[hollow & (found == BELOW)] = UNDECIDED
    verdicts[some] = found
    return verdicts


def box_depths(scene: Scene, first: Indices, second: Indices) -> Array:
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


def known_with_all(sorts: Sorts, known: Flags) -> Flags:
    """Of each shape whether all of its entity are known."""
    lost = np.bincount(sorts.entities[~known], minlength=sorts.count)
    all_known: Flags = lost[sorts.entities] == 0
    return all_known


def scene_of(sorts: Sorts, positions: Array, orientations: Array) -> Scene:
    """Shapes at poses, without boxes.

    Args:
        sorts: what they are, and whose.
        positions: (n, 3), in the world.
        orientations: (n, 4), quaternions w, x, y, z; their lengths do not matter.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        length = np.sqrt(np.einsum("ij,ij->i", orientations, orientations))
        unit = orientations / length[:, None]
        finite = np.isfinite(positions).all(axis=1) & np.isfinite(unit).all(axis=1)
        matrices = turns_of(unit).reshape(3, 3, -1).transpose(2, 0, 1)
    known = known_with_all(sorts, finite & sorts.known)
    return Scene(sorts, known, np.zeros((6, 0)), positions, matrices)
