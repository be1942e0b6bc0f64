"""Compares the shapes of a tick, two at a time.

Every pair of shapes is compared at most once a tick. `ssduck.geometry.distance` defines the signed
distance and the normal, and `ssduck.geometry.mesh_distance` does for meshes that are not convex.
"""

from __future__ import annotations

import math

from ssduck.geometry.distance import CallCounter, SignedDistance
from ssduck.geometry.distance import signed_distance as convex_distance
from ssduck.geometry.mesh_distance import is_surely_deeper, mesh_distance, mesh_penetration
from ssduck.geometry.tick_shapes import PairPredicate
from ssduck.geometry.tick_solids import TickSolids

# Shapes that are nearer touch, for `on`, m.
TOUCHING_DISTANCE = 1e-3
# The error of bounds by boxes and spheres, m.
ROUNDING = 1e-9


class ShapeComparisons:
    """The comparisons of the shapes of a tick.

    Args:
        solids: the shapes.
        calls: counts the calls of FCL.
    """

    def __init__(self, solids: TickSolids, calls: CallCounter) -> None:
        self._tick, self._calls = solids, calls
        self._distances: dict[tuple[int, int], SignedDistance | None] = {}
        self._depths: dict[tuple[int, int], SignedDistance] = {}

    def satisfies(self, s: int, t: int, predicate: PairPredicate) -> bool:
        """Checks whether a predicate holds for two shapes."""
        if predicate.kind == "colliding":
            return self._are_deeper(s, t, predicate.distance)
        return self._are_within(s, t, predicate.bound(self.margin(s, t)))

    def _are_deeper(self, s: int, t: int, min_depth: float) -> bool:
        """Checks whether two shapes are deeper in each other than a depth, m."""
        if self.min_distance(s, t) > 0.0:
            return False
        # Most collisions of meshes are found without computing their depth.
        first, second = self._ordered(s, t)
        is_new = self._is_of_mesh(s, t) and (first, second) not in self._distances
        if is_new and is_surely_deeper(
            self._tick.placed(first), self._tick.placed(second), min_depth, self._calls
        ):
            return True
        return self.signed_distance(s, t).distance < -min_depth

    def _are_within(self, s: int, t: int, max_distance: float) -> bool:
        """Checks whether two shapes are at most a distance apart, m."""
        if self.min_distance(s, t) > max_distance + ROUNDING:
            return False
        result = self.distance(s, t)
        return (0.0 if result is None else max(0.0, result.distance)) <= max_distance

    def margin(self, s: int, t: int) -> float:
        """Returns the collision margin of two shapes, m."""
        return self._tick.table.margins.of_two(s, t)

    def contact_height(self, s: int, t: int) -> float | None:
        """Returns the z of the unit contact normal from a shape to another one.

        None if they do not touch, or have no normal.
        """
        result = self.signed_distance(s, t)
        if result.distance > TOUCHING_DISTANCE + self.margin(s, t) or result.normal is None:
            return None
        return -result.normal[2]

    def distance(self, s: int, t: int) -> SignedDistance | None:
        """Returns the signed distance of two shapes; None for meshes that overlap."""
        first, second = key = self._ordered(s, t)
        if key not in self._distances:
            a, b = self._tick.placed(first), self._tick.placed(second)
            compare = mesh_distance if self._is_of_mesh(s, t) else convex_distance
            self._distances[key] = compare(a, b, self._calls)
        result = self._distances[key]
        return result if result is None or first == s else result.swapped()

    def signed_distance(self, s: int, t: int) -> SignedDistance:
        """Returns the signed distance of two shapes, which for meshes that overlap takes longer."""
        if (result := self.distance(s, t)) is not None:
            return result
        first, second = key = self._ordered(s, t)
        if key not in self._depths:
            self._depths[key] = mesh_penetration(
                self._tick.placed(first), self._tick.placed(second), self._calls
            )
        return self._depths[key] if first == s else self._depths[key].swapped()

    def _ordered(self, s: int, t: int) -> tuple[int, int]:
        """Returns two shapes ordered by their geometries and poses, not by their indices."""
        return (s, t) if (self._tick.rank(s), s) <= (self._tick.rank(t), t) else (t, s)

    def _is_of_mesh(self, s: int, t: int) -> bool:
        """Checks whether one of two shapes is a mesh, and none a half-space."""
        kinds = {self._tick.table.solids[s].type, self._tick.table.solids[t].type}
        return "mesh" in kinds and "plane" not in kinds

    def min_distance(self, s: int, t: int) -> float:
        """Returns a lower bound of the distance of two shapes, by boxes and bounding spheres, m."""
        radii = self._tick.table.bounding_radii[s] + self._tick.table.bounding_radii[t]
        if radii == math.inf:
            is_plane = self._tick.table.bounding_radii[s] == math.inf
            return self._bound_of_plane(s, t) if is_plane else self._bound_of_plane(t, s)
        a, b = self._tick.corners[s], self._tick.corners[t]
        x = max(0.0, a[0] - b[3], b[0] - a[3])
        y = max(0.0, a[1] - b[4], b[1] - a[4])
        z = max(0.0, a[2] - b[5], b[2] - a[5])
        spheres = math.dist(self._tick.centres[s], self._tick.centres[t]) - radii
        return max(math.sqrt(x * x + y * y + z * z), spheres)

    def _bound_of_plane(self, plane: int, other: int) -> float:
        """Returns a lower bound of the distance to a half-space, m, by a bounding sphere."""
        # The box of a tilted plane does not bound it: far out, the plane leaves its box.
        if self._tick.table.solids[other].type == "plane":
            return 0.0
        x, y, z = self._tick.placed(plane).normals[0].tolist()
        (a, b, c), (d, e, f) = self._tick.centres[other], self._tick.placed(plane).position
        height: float = x * (a - d) + y * (b - e) + z * (c - f)
        return max(0.0, height - self._tick.table.solids[other].bounding_radius)
