"""Triangle surfaces: whether they are closed, what they enclose, and FCL's tree over them."""

from __future__ import annotations

import math
from collections import Counter as Multiset
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ssduck.geometry.arrays import Array, Indices, Triangles
from ssduck.geometry.broad_phase import meeting_across
from ssduck.geometry.poses import cross

# How far rays lean, along x and y per z.
LEAN = np.array([0.2719, 0.1373])


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles over vertices (n, 3), no two of which are equal."""

    vertices: Array
    faces: Triangles

    @cached_property
    def triangles(self) -> Array:
        """(m, 3, 3) the corners."""
        return self.vertices[self.faces]

    @cached_property
    def bvh(self) -> Any:
        """FCL's bounding volume hierarchy. A triangle may be a segment or a point."""
        import fcl

        bvh = fcl.BVHModel()
        bvh.beginModel(len(self.vertices), len(self.faces))
        bvh.addSubModel(self.vertices, self.faces)
        bvh.endModel()
        return bvh

    @cached_property
    def is_closed(self) -> bool:
        """Whether every edge is run through as often one way as the other."""
        edges = self._edges.tolist()
        ways = Multiset((a, b) for a, b in edges)
        return bool(edges) and all(ways[b, a] == count for (a, b), count in ways.items())

    @cached_property
    def volume(self) -> float:
        """What it encloses, m³, if it is closed; negative if it faces inward."""
        return enclosed_volume(self.triangles)

    @property
    def _edges(self) -> Triangles:
        edges: Triangles = self.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        return edges

    def oriented(self) -> Surface:
        """The same with its faces outward, if it can be closed that way."""
        if not len(self.faces):
            return self
        surface = self if self.is_closed else Surface(self.vertices, self._turned())
        if not surface.is_closed:
            return self
        if enclosed_volume(surface.triangles) < 0:
            return Surface(surface.vertices, np.ascontiguousarray(surface.faces[:, ::-1]))
        return surface

    def _turned(self) -> Triangles:
        """Faces turned so that neighbours agree, where each edge has two of them."""
        owners: dict[tuple[int, int], list[int]] = {}
        faces: list[list[int]] = self.faces.tolist()
        for number, (a, b, c) in enumerate(faces):
            for u, v in ((a, b), (b, c), (c, a)):
                owners.setdefault((min(u, v), max(u, v)), []).append(number)
        if any(len(two) != 2 for two in owners.values()):
            return self.faces
        seen: set[int] = set()
        for first in range(len(faces)):
            todo = [] if first in seen else [first]
            while todo:
                number = todo.pop()
                seen.add(number)
                a, b, c = faces[number]
                for u, v in ((a, b), (b, c), (c, a)):
                    for other in owners[min(u, v), max(u, v)]:
                        if other not in seen:
                            x, y, z = faces[other]
                            if (u, v) in ((x, y), (y, z), (z, x)):
                                faces[other] = [z, y, x]
                            seen.add(other)
                            todo.append(other)
        return np.array(faces, np.int32)

    @cached_property
    def component_vertices(self) -> Array:
        """A vertex of each connected part."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        a, b = self._edges.T
        count = len(self.vertices)
        graph = coo_array((np.ones(len(a)), (a, b)), shape=(count, count))
        _, part = connected_components(graph, directed=False)
        used = np.unique(self.faces)
        _, first = np.unique(part[used], return_index=True)
        return self.vertices[used[first]]

    @cached_property
    def box(self) -> tuple[Array, Array]:
        """The lower and the upper corner."""
        return self.vertices.min(axis=0), self.vertices.max(axis=0)

    def encloses(self, points: Array) -> Any:
        """Of points (n, 3), which the closed surface winds around, (n,)."""
        low, high = self.box
        near = ((points > low) & (points < high)).all(axis=1)
        found = np.zeros(len(points), bool)
        found[near] = _windings(points[near], self.triangles) > 0
        return found


def _windings(points: Array, triangles: Array) -> Indices:
    """How often a closed surface winds around points: the triangles on a ray from each, signed.

    Which side of an edge a ray passes is the same for both triangles that share the edge, whatever
    is rounded; so a ray that meets an edge or a corner is counted right.
    """
    points, triangles = _leaning(points), _leaning(triangles)
    found = np.zeros(len(points), np.intp)
    start, end = points.T.copy(), points.T.copy()
    end[2] = math.inf
    boxes = triangles.min(axis=1).T.copy(), triangles.max(axis=1).T.copy()
    for j, i in meeting_across(boxes, (start, end), rims=True):
        to = triangles[j] - points[i][:, None]
        turns = _turns(to)
        volumes = np.einsum("ni,ni->n", to[:, 0], cross(to[:, 1], to[:, 2]))
        above = turns * volumes > 0.0
        np.add.at(found, i[above], turns[above])
    return found


def _leaning(points: Array) -> Array:
    """Sheared, so that no side of a box that is straight in its frame is along the rays, +z."""
    leaning = points.copy()
    leaning[..., :2] -= LEAN * points[..., 2:]
    return leaning


def _turns(triangles: Array) -> Indices:
    """How often the shadows of triangles (n, 3, 3) run around the origin: 1, 0 or -1."""
    x, y = triangles[:, :, 0], triangles[:, :, 1]
    next_x, next_y = np.roll(x, -1, axis=1), np.roll(y, -1, axis=1)
    side = x * next_y - y * next_x
    up = (y <= 0.0) & (next_y > 0.0) & (side > 0.0)
    down = (next_y <= 0.0) & (y > 0.0) & (side < 0.0)
    turns: Indices = up.sum(axis=1) - down.sum(axis=1)
    return turns


def enclosed_volume(triangles: Array) -> float:
    """Signed: the sum of the tetrahedra over the triangles; positive if they face outward."""
    if not len(triangles):
        return 0.0
    a, b, c = (triangles[:, k] - triangles[0, 0] for k in range(3))
    return float(np.einsum("ij,ij->", a, cross(b, c)) / 6.0)


def unique_points(points: Array) -> Array:
    """Points (n, 3) without equal ones; -0 is 0."""
    return np.unique(points + 0.0, axis=0) if len(points) else points
