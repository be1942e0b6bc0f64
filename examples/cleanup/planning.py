"""Plans collision-free paths by RRT-Connect, and shortens them.

Kuffner and LaValle, RRT-Connect: an efficient approach to single-query path planning, 2000. A
path is an array of postures. Between two neighbours nothing moves farther than the spacing of
the space; so a clearance of half the spacing at both ensures that the motion between is clear.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Protocol

import numpy as np

from ssduck.geometry.arrays import Array, Flags

# The largest number of consecutive steps of a tree towards the other.
MAX_STEPS = 50


class Space(Protocol):
    """A space of postures in which paths are planned."""

    def sample(self, rng: np.random.Generator) -> Array:
        """Returns a random posture (d,)."""

    def distances(self, here: Array, others: Array) -> Array:
        """Returns the distances of postures (n, d) from one, metres, (n,)."""

    def path(self, here: Array, there: Array) -> Array:
        """Returns the postures (n, d) on the direct path between two, both included."""

    def clear(self, postures: Array) -> Flags:
        """Checks whether each of some postures is allowed."""


@dataclass(eq=False)
class _Tree:
    """A tree of reachable postures and the paths to them."""

    nodes: list[Array]
    parents: list[int] = field(default_factory=list)
    paths: list[Array] = field(default_factory=list)

    def add(self, parent: int, path: Array) -> int:
        self.nodes.append(path[-1])
        self.parents.append(parent)
        self.paths.append(path)
        return len(self.nodes) - 1

    def path(self, node: int) -> Array:
        """Returns the path from the root to a node."""
        parts = []
        while self.parents[node] >= 0:
            parts.append(self.paths[node][1:])
            node = self.parents[node]
        return np.concatenate([self.nodes[node][None], *reversed(parts)])


def plan(
    space: Space,
    start: Array,
    goal: Array,
    rng: np.random.Generator,
    samples: int,
    max_growth: float,
) -> Array | None:
    """Returns a path (n, d) between two postures, or None if none was found.

    Args:
        space: the space.
        start: (d,), the first posture.
        goal: (d,), the last posture.
        rng: the random numbers.
        samples: the number of random postures.
        max_growth: the largest growth of a tree in one step, metres.
    """
    if not space.clear(np.array([start, goal])).all():
        return None
    direct = space.path(start, goal)
    if _is_clear(space, direct):
        return direct
    trees = [_Tree([start], [-1], [start[None]]), _Tree([goal], [-1], [goal[None]])]
    for iteration in range(samples):
        grown, other = trees[iteration % 2], trees[1 - iteration % 2]
        node = _grow(space, grown, space.sample(rng), max_growth, steps=1)
        if node is None:
            continue
        meeting = _grow(space, other, grown.nodes[node], max_growth, steps=MAX_STEPS)
        if meeting is not None and np.allclose(other.nodes[meeting], grown.nodes[node]):
            ahead, back = (node, meeting) if iteration % 2 == 0 else (meeting, node)
            return np.concatenate((trees[0].path(ahead), trees[1].path(back)[::-1][1:]))
    return None


def _grow(space: Space, tree: _Tree, goal: Array, max_growth: float, steps: int) -> int | None:
    """Grows a tree from its nearest posture towards a goal; returns the new node or None."""
    node = int(space.distances(goal, np.array(tree.nodes)).argmin())
    last_node = None
    for _ in range(steps):
        path = space.path(tree.nodes[node], goal)
        lengths = np.cumsum([space.distances(a, b[None])[0] for a, b in pairwise(path)])
        segment = path[: max(2, int(np.searchsorted(lengths, max_growth)) + 1)]
        blocked = np.flatnonzero(~space.clear(segment))
        end = len(segment) if not len(blocked) else int(blocked[0])
        if end < 2:
            break
        last_node = node = tree.add(node, segment[:end])
        if end < len(segment) or len(segment) == len(path):
            break
    return last_node


def _is_clear(space: Space, path: Array) -> bool:
    """Checks whether a path is clear; a few postures first, which often suffice to refuse it."""
    return all(space.clear(path[part]).all() for part in (slice(None, None, 8), slice(None)))


def shortened(space: Space, path: Array, rng: np.random.Generator, samples: int) -> Array:
    """Returns a path without unnecessary detours."""
    for _ in range(samples):
        if len(path) < 3:
            break
        i, j = sorted(rng.choice(len(path), 2, replace=False).tolist())
        cut = space.path(path[i], path[j])
        if length(space, cut) < 0.98 * length(space, path[i : j + 1]) and _is_clear(space, cut):
            path = np.concatenate((path[:i], cut, path[j + 1 :]))
    return path


def length(space: Space, path: Array) -> float:
    """Returns the length of a path, metres."""
    return float(sum(space.distances(a, b[None])[0] for a, b in pairwise(path)))
