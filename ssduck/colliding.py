"""Which entities of a tick collide, all of them at once.

The broad phase finds the pairs of shapes whose boxes meet. Spheres around the shapes that miss
each other, and spheres in them that meet, decide most of these; of boxes the separating axes do
(Gottschalk, Lin and Manocha, OBBTree, 1996); only what is left is compared one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ssduck.broad import Flags, meeting
from ssduck.geometry import Array, Indices
from ssduck.solids import Solid

# Two edges that are as parallel have no axis of their own.
_PARALLEL = 1e-6
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
        self.single = len(np.unique(entities)) == len(entities)
        self.reach = np.array([solid.reach for solid in solids])[of]
        self.radius = np.array([solid.inner_radius for solid in solids])[of]
        self.is_endless = np.array([solid.type == "plane" for solid in solids], dtype=bool)[of]
        self.is_box = np.array([solid.type == "box" for solid in solids], dtype=bool)[of]
        none = np.zeros(3)
        halves = [s.core.max(axis=0) if s.type == "box" else none for s in solids]
        self.half = np.array(halves).reshape(-1, 3)[of]


@dataclass(frozen=True, eq=False)
class Scene:
    """The shapes of a tick, in arrays.

    Attributes:
        sorts: what they are, and whose.
        known: (n,), whether its pose is known.
        boxes: (6, n), lower corners, upper corners.
        positions: (n, 3).
        matrices: (n, 3, 3).
        centres: (n, 3), of the sphere around each shape.
        inner: (n, 3), of the sphere in each shape.
    """

    sorts: Sorts
    known: Flags
    boxes: Array
    positions: Array
    matrices: Array
    centres: Array
    inner: Array


def colliding(
    scene: Scene, deeper: float, compare: Callable[[int, int], bool]
) -> list[tuple[int, int]]:
    """The pairs of entities with shapes that are deeper in each other, each once, the lesser first.

    Args:
        scene: the shapes.
        deeper: metres.
        compare: whether two shapes are, for those that nothing else decides.
    """
    sorts = scene.sorts
    first, second = meeting(scene.boxes)
    apart = sorts.entities[first] != sorts.entities[second]
    both = apart & scene.known[first] & scene.known[second]
    first, second = first[both], second[both]
    first, second = _within_reach(scene, first, second)
    hit = _inside_each_other(scene, first, second, deeper)
    found = _entities(scene, first[hit], second[hit])
    first, second = _undecided(scene, first[~hit], second[~hit], found)
    square = sorts.is_box[first] & sorts.is_box[second]
    a, b = first[square], second[square]
    deep = box_depths(scene, a, b) > deeper
    found |= _entities(scene, a[deep], b[deep])
    for s, t in zip(first[~square].tolist(), second[~square].tolist(), strict=True):
        pair = _pair(scene, s, t)
        if pair not in found and compare(s, t):
            found.add(pair)
    return sorted(found)


def _pair(scene: Scene, s: int, t: int) -> tuple[int, int]:
    i, j = int(scene.sorts.entities[s]), int(scene.sorts.entities[t])
    return (i, j) if i < j else (j, i)


def _entities(scene: Scene, first: Indices, second: Indices) -> set[tuple[int, int]]:
    """Whose shapes these are."""
    i, j = scene.sorts.entities[first], scene.sorts.entities[second]
    return set(zip(np.minimum(i, j).tolist(), np.maximum(i, j).tolist(), strict=True))


def _undecided(
    scene: Scene, first: Indices, second: Indices, found: set[tuple[int, int]]
) -> tuple[Indices, Indices]:
    """Those of entities that are not known to collide."""
    if not found or scene.sorts.single:
        return first, second
    pairs = zip(first.tolist(), second.tolist(), strict=True)
    open_ = np.array([_pair(scene, s, t) not in found for s, t in pairs], dtype=bool)
    return first[open_], second[open_]


def _within_reach(scene: Scene, first: Indices, second: Indices) -> tuple[Indices, Indices]:
    """Those whose spheres around meet; a half-space has none."""
    reach, endless = scene.sorts.reach, scene.sorts.is_endless
    between = np.linalg.norm(scene.centres[first] - scene.centres[second], axis=1)
    near = (between <= reach[first] + reach[second]) | endless[first] | endless[second]
    return first[near], second[near]


def _inside_each_other(scene: Scene, first: Indices, second: Indices, deeper: float) -> Flags:
    """Whether the spheres in them are deeper in each other."""
    radius = scene.sorts.radius
    between = np.linalg.norm(scene.inner[first] - scene.inner[second], axis=1)
    together = radius[first] + radius[second] - deeper
    hit: Flags = (together > 0.0) & (between < together)
    return hit


def box_depths(scene: Scene, first: Indices, second: Indices) -> Array:
    """How deep boxes are in each other, m: the least overlap along their 15 axes; < 0 if apart."""
    a, b = scene.sorts.half[first], scene.sorts.half[second]
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
