"""Triangle surfaces: whether they are closed, which points they enclose, and FCL's trees."""

from __future__ import annotations

import math
from collections import Counter as Multiset
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ssduck.geometry.arrays import Array, Indices, Triangles
from ssduck.geometry.broad_phase import overlapping_pairs_across
from ssduck.geometry.poses import cross

# The slant of rays, along x and y per z.
SLANT = np.array([0.2719, 0.1373])


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles over distinct vertices (n, 3)."""

    vertices: Array
    faces: Triangles

    @cached_property
    def triangles(self) -> Array:
        """The corners of the triangles, (m, 3, 3)."""
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
        """Whether every edge is traversed equally often in both directions."""
        edges = self._edges.tolist()
        counts = Multiset((a, b) for a, b in edges)
        return bool(edges) and all(counts[b, a] == count for (a, b), count in counts.items())

    @cached_property
    def volume(self) -> float:
        """The enclosed volume of a closed surface, m³; negative if it faces inward."""
        return enclosed_volume(self.triangles)

    @property
    def _edges(self) -> Triangles:
        edges: Triangles = self.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        return edges

    def oriented(self) -> Surface:
        """Returns the surface with its faces outward, if it can be closed in that way."""
        if not len(self.faces):
            return self
        surface = self if self.is_closed else Surface(self.vertices, self._consistent_faces())
        if not surface.is_closed:
            return self
        if enclosed_volume(surface.triangles) < 0:
            return Surface(surface.vertices, np.ascontiguousarray(surface.faces[:, ::-1]))
        return surface

    def _consistent_faces(self) -> Triangles:
        """Returns faces that agree with their neighbours, if each edge has two faces."""
        owners: dict[tuple[int, int], list[int]] = {}
        faces: list[list[int]] = self.faces.tolist()
        for number, (a, b, c) in enumerate(faces):
            for u, v in ((a, b), (b, c), (c, a)):
                owners.setdefault((min(u, v), max(u, v)), []).append(number)
        if any(len(faces_of_edge) != 2 for faces_of_edge in owners.values()):
            return self.faces
        visited: set[int] = set()
        for first in range(len(faces)):
            pending = [] if first in visited else [first]
            while pending:
                number = pending.pop()
                visited.add(number)
                a, b, c = faces[number]
                for u, v in ((a, b), (b, c), (c, a)):
                    for other in owners[min(u, v), max(u, v)]:
                        if other not in visited:
                            x, y, z = faces[other]
                            if (u, v) in ((x, y), (y, z), (z, x)):
                                faces[other] = [z, y, x]
                            visited.add(other)
                            pending.append(other)
        return np.array(faces, np.int32)

    @cached_property
    def component_vertices(self) -> Array:
        """A vertex of each connected component."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        a, b = self._edges.T
        count = len(self.vertices)
        graph = coo_array((np.ones(len(a)), (a, b)), shape=(count, count))
        _, components = connected_components(graph, directed=False)
        used_vertices = np.unique(self.faces)
        _, first = np.unique(components[used_vertices], return_index=True)
        return self.vertices[used_vertices[first]]

    @cached_property
    def box(self) -> tuple[Array, Array]:
        """The lower and the upper corner of its bounding box."""
        return self.vertices.min(axis=0), self.vertices.max(axis=0)

    def encloses(self, points: Array) -> Any:
        """Checks which of some points (n, 3) the closed surface winds around, (n,)."""
        low, high = self.box
        in_box = ((points > low) & (points < high)).all(axis=1)
        is_enclosed = np.zeros(len(points), bool)
        is_enclosed[in_box] = _winding_numbers(points[in_box], self.triangles) > 0
        return is_enclosed


def _winding_numbers(points: Array, triangles: Array) -> Indices:
    """Counts the winding numbers of a closed surface around points, by signed crossings of rays."""
    points, triangles = _shear(points), _shear(triangles)
    windings = np.zeros(len(points), np.intp)
    start, end = points.T.copy(), points.T.copy()
    end[2] = math.inf
    boxes = triangles.min(axis=1).T.copy(), triangles.max(axis=1).T.copy()
    for j, i in overlapping_pairs_across(boxes, (start, end), touching=True):
        corners = triangles[j] - points[i][:, None]
        signs = _winding_signs(corners)
        volumes = np.einsum("ni,ni->n", corners[:, 0], cross(corners[:, 1], corners[:, 2]))
        is_above = signs * volumes > 0.0
        np.add.at(windings, i[is_above], signs[is_above])
    return windings


def _shear(points: Array) -> Array:
    """Returns sheared points, so that no axis-aligned face is parallel to the rays along +z."""
    sheared = points.copy()
    sheared[..., :2] -= SLANT * points[..., 2:]
    return sheared


def _winding_signs(triangles: Array) -> Indices:
    """Returns the winding numbers of triangles' projections around the origin: 1, 0 or -1, (n,)."""
    x, y = triangles[:, :, 0], triangles[:, :, 1]
    next_x, next_y = np.roll(x, -1, axis=1), np.roll(y, -1, axis=1)
    side = x * next_y - y * next_x
    up = (y <= 0.0) & (next_y > 0.0) & (side > 0.0)
    down = (next_y <= 0.0) & (y > 0.0) & (side < 0.0)
    signs: Indices = up.sum(axis=1) - down.sum(axis=1)
    return signs


def enclosed_volume(triangles: Array) -> float:
    """Returns the signed volume of the tetrahedra over triangles; positive if they face outward."""
    if not len(triangles):
        return 0.0
    a, b, c = (triangles[:, k] - triangles[0, 0] for k in range(3))
    return float(np.einsum("ij,ij->", a, cross(b, c)) / 6.0)


def unique_points(points: Array) -> Array:
    """Returns the distinct points of (n, 3); -0 is 0."""
    return np.unique(points + 0.0, axis=0) if len(points) else points
