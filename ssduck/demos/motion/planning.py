"""Paths that keep clear of everything: RRT-Connect, and shortcuts.

Kuffner and LaValle, RRT-Connect: an efficient approach to single-query path planning, 2000. A
path is an array of postures; between two neighbours nothing moves farther than `SPACING`, so
that what is clear by half of it at both is clear between them, too.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Protocol

import numpy as np

from ssduck.geometry.arrays import Array, Flags

# How often a tree grows towards the other in turn.
MOST_STEPS = 50


class Space(Protocol):
    """What is planned in."""

    def sample(self, rng: np.random.Generator) -> Array:
        """A random posture (d,)."""

    def distances(self, here: Array, others: Array) -> Array:
        """How far postures (n, d) are from one, metres, (n,)."""

    def way(self, here: Array, there: Array) -> Array:
        """The postures (n, d) on the way from one to another, both of them included."""

    def clear(self, postures: Array) -> Flags:
        """Whether each of these postures is allowed."""


@dataclass(eq=False)
class _Tree:
    """Postures that can be reached, and the ways that lead to them."""

    nodes: list[Array]
    parents: list[int] = field(default_factory=list)
    ways: list[Array] = field(default_factory=list)

    def add(self, parent: int, way: Array) -> int:
        self.nodes.append(way[-1])
        self.parents.append(parent)
        self.ways.append(way)
        return len(self.nodes) - 1

    def path(self, node: int) -> Array:
        """From the root to a node."""
        parts = []
        while self.parents[node] >= 0:
            parts.append(self.ways[node][1:])
            node = self.parents[node]
        return np.concatenate([self.nodes[node][None], *reversed(parts)])


def plan(
    space: Space, start: Array, goal: Array, rng: np.random.Generator, tries: int, longest: float
) -> Array | None:
    """A path (n, d) from a posture to another, or None if none was found.

    Args:
        space: what is planned in.
        start: (d,), where it begins.
        goal: (d,), where it ends.
        rng: chance.
        tries: how many random postures are tried.
        longest: how far a tree grows at once, metres.
    """
    if not space.clear(np.array([start, goal])).all():
        return None
    direct = space.way(start, goal)
    if _is_clear(space, direct):
        return direct
    trees = [_Tree([start], [-1], [start[None]]), _Tree([goal], [-1], [goal[None]])]
    for number in range(tries):
        grown, other = trees[number % 2], trees[1 - number % 2]
        node = _grow(space, grown, space.sample(rng), longest, steps=1)
        if node is None:
            continue
        met = _grow(space, other, grown.nodes[node], longest, steps=MOST_STEPS)
        if met is not None and np.allclose(other.nodes[met], grown.nodes[node]):
            ahead, back = (node, met) if number % 2 == 0 else (met, node)
            return np.concatenate((trees[0].path(ahead), trees[1].path(back)[::-1][1:]))
    return None


def _grow(space: Space, tree: _Tree, goal: Array, longest: float, steps: int) -> int | None:
    """Grow a tree from its nearest posture towards another; None if it cannot."""
    node = int(space.distances(goal, np.array(tree.nodes)).argmin())
    found = None
    for _ in range(steps):
        way = space.way(tree.nodes[node], goal)
        far = np.cumsum([space.distances(a, b[None])[0] for a, b in pairwise(way)])
        part = way[: max(2, int(np.searchsorted(far, longest)) + 1)]
        blocked = np.flatnonzero(~space.clear(part))
        end = len(part) if not len(blocked) else int(blocked[0])
        if end < 2:
            break
        found = node = tree.add(node, part[:end])
        if end < len(part) or len(part) == len(way):
            break
    return found


def _is_clear(space: Space, way: Array) -> bool:
    """Whether all of a way is clear; a few postures of it often tell that it is not."""
    return all(space.clear(way[some]).all() for some in (slice(None, None, 8), slice(None)))


def shortened(space: Space, path: Array, rng: np.random.Generator, tries: int) -> Array:
    """A path with detours cut off that nothing asks for."""
    for _ in range(tries):
        if len(path) < 3:
            break
        i, j = sorted(rng.choice(len(path), 2, replace=False).tolist())
        cut = space.way(path[i], path[j])
        if length(space, cut) < 0.98 * length(space, path[i : j + 1]) and _is_clear(space, cut):
            path = np.concatenate((path[:i], cut, path[j + 1 :]))
    return path


def length(space: Space, path: Array) -> float:
    """How long a path is, metres."""
    return float(sum(space.distances(a, b[None])[0] for a, b in pairwise(path)))
