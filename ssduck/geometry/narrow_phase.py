"""The narrow phase: compares the shapes of entities.

The distance of two entities is that of their nearest shapes, their depth that of their deepest
shapes. Every pair of shapes is compared at most once a tick, and only if their boxes and spheres do
not decide. `ssduck.geometry.distance` defines the signed distance and the normal, and
`ssduck.geometry.mesh_distance` does for meshes that are not convex. `ssduck.geometry.batch`
compares all pairs of a tick at once, with the same results.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import cached_property, partial
from itertools import pairwise
from threading import RLock

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.batch import (
    PairPredicate,
    PairResult,
    ShapeTable,
    TickShapes,
    matching_pairs,
    of_known_entities,
)
from ssduck.geometry.contact_support import MIN_UP
from ssduck.geometry.containment import (
    Box,
    Footprint,
    WorldHull,
    fraction_inside,
    hull_bounds,
    max_fraction_in_box,
    max_fraction_in_hull,
    world_hull,
)
from ssduck.geometry.distance import CallCounter, SignedDistance, signed_distance
from ssduck.geometry.mesh_distance import is_surely_deeper, mesh_distance, mesh_penetration
from ssduck.geometry.placed_solid import PlacedSolid, Point
from ssduck.geometry.poses import rotate, rotation_matrices, unit_quaternions
from ssduck.geometry.solids import PlacedSolids, Solid

# Shapes that are deeper collide, m.
MIN_DEPTH = 1e-6
# Shapes that are nearer touch, for `on`, m.
TOUCHING_DISTANCE = 1e-3
# The error of bounds by boxes and spheres, m.
ROUNDING = 1e-9
# The least fraction of the volume of a contained entity that is inside.
MIN_FRACTION_INSIDE = 0.95
# The error of upper bounds of that fraction.
FRACTION_ERROR = 0.01


class NarrowPhase:
    """The shapes of one tick, and the comparisons of entities.

    Entities are numbered from 0. A result is None, for unknown, if a pose or a shape of either
    entity is unknown. An entity and itself have clearance 0 and no contact. An entity without
    shapes collides with nothing; its clearance is unknown.

    Args:
        solids: the distinct solids.
        solid_indices: (shapes,), the index of each shape's solid.
        positions: (shapes, 3), in the world.
        orientations: (shapes, 4), quaternions w, x, y, z of any length.
        boxes: (shapes, 6), lower corner, upper corner, in the world.
        starts: (entities + 1,): the shapes of entity e are `starts[e]` to `starts[e + 1] - 1`.
        calls: counts the calls of FCL.
        margins: (shapes,), the collision margins, metres; None for none.
    """

    def __init__(
        self,
        solids: Sequence[Solid],
        solid_indices: Indices,
        positions: Array,
        orientations: Array,
        boxes: Array,
        starts: Sequence[int],
        calls: CallCounter,
        margins: Array | None = None,
    ) -> None:
        self.calls = calls
        indices = np.asarray(solid_indices).tolist()
        self._margins: list[float] = [0.0] * len(indices) if margins is None else margins.tolist()
        self._solids: list[Solid] = [solids[index] for index in indices]
        self._positions, self._orientations, self._boxes = positions, orientations, boxes
        self.starts = list(starts)
        self._placed_solids: dict[int, PlacedSolid] = {}
        self._ranks: dict[int, tuple[str | float, ...]] = {}
        self._distances: dict[tuple[int, int], SignedDistance | None] = {}
        self._depths: dict[tuple[int, int], SignedDistance] = {}
        self._clearances: dict[tuple[int, int], float | None] = {}
        self._clearance_bounds: dict[tuple[int, int], float] = {}
        self._verdicts: dict[tuple[int, int, PairPredicate], bool | None] = {}
        self._signed_distances: dict[tuple[int, int], SignedDistance | None] = {}
        self._fractions_inside: dict[tuple[int, int], float | None] = {}
        self._hulls: dict[int, WorldHull | None] = {}
        self._hull_bounds: dict[int, Box] = {}
        self._footprints: dict[int, Footprint] = {}
        self._results: dict[PairPredicate, PairResult] = {}
        self._compared: set[int] = set()
        self._ticks: dict[ShapeTable, TickShapes] = {}
        # DuckDB calls from its own threads. Without the lock, pairs would be compared twice.
        self._lock = RLock()

    def regrouped(self, shapes: Indices, starts: Sequence[int]) -> NarrowPhase:
        """Returns the narrow phase of the tick with other entities: runs of shapes at `starts`."""
        placed = self._positions[shapes], self._orientations[shapes], self._boxes[shapes]
        margins = np.array(self._margins)[shapes]
        return NarrowPhase(self._solids, shapes, *placed, starts, self.calls, margins)

    # -- relations ------------------------------------------------------------------------

    def collides(self, i: int, j: int, min_depth: float = MIN_DEPTH) -> bool | None:
        """Checks whether two entities are deeper in each other than a depth, m."""
        return self._holds(i, j, PairPredicate("colliding", min_depth))

    def touches(self, i: int, j: int, distance: float = TOUCHING_DISTANCE) -> bool | None:
        """Checks whether two of their shapes are at most a distance plus both margins apart, m."""
        return self._holds(i, j, PairPredicate("touching", distance))

    def _holds(self, i: int, j: int, predicate: PairPredicate) -> bool | None:
        if i == j:
            return False
        key = (i, j, predicate) if i < j else (j, i, predicate)
        with self._lock:
            if key not in self._verdicts:
                self._verdicts[key] = self._decide(*key)
            return self._verdicts[key]

    def all_pairs(self, predicate: PairPredicate, table: ShapeTable) -> PairResult:
        """Returns the pairs of entities for which a predicate holds.

        Args:
            predicate: the condition.
            table: the properties of the shapes.
        """
        with self._lock:
            if predicate not in self._results:
                decide = partial(self.satisfies, predicate=predicate)
                kept = table.witnesses(predicate)
                result = matching_pairs(self.tick_shapes(table), predicate, decide, kept=kept)
                self.count_compared(result.compared.tolist())
                self._results[predicate] = result
            return self._results[predicate]

    def count_compared(self, pairs: Iterable[int]) -> None:
        """Counts pairs of entities, by their numbers, as compared.

        A pair counts once a tick, however often and by whatever it is compared.
        """
        with self._lock:
            before = len(self._compared)
            self._compared.update(pairs)
            self.calls.pairs += len(self._compared) - before

    def tick_shapes(self, table: ShapeTable) -> TickShapes:
        """Returns the shapes in arrays; the table has their other properties."""
        if table not in self._ticks:
            known = of_known_entities(table, self._finite & table.is_known)
            poses = self._positions, self._matrices
            self._ticks[table] = TickShapes(table, known, self._boxes.T, *poses)
        return self._ticks[table]

    def satisfies(self, s: int, t: int, predicate: PairPredicate) -> bool:
        """Checks whether a predicate holds for two shapes."""
        if predicate.kind == "colliding":
            return self._are_deeper(s, t, predicate.distance)
        return self._are_within(s, t, predicate.bound(self._margin(s, t)))

    def _are_deeper(self, s: int, t: int, min_depth: float) -> bool:
        """Checks whether two shapes are deeper in each other than a depth, m."""
        if self._bound(s, t) > 0.0:
            return False
        # Most collisions of meshes are found without computing their depth.
        first, second = self._ordered(s, t)
        is_new = self._is_of_mesh(s, t) and (first, second) not in self._distances
        if is_new and is_surely_deeper(
            self._placed_solid(first), self._placed_solid(second), min_depth, self.calls
        ):
            return True
        return self.shape_signed_distance(s, t).distance < -min_depth

    def _are_within(self, s: int, t: int, max_distance: float) -> bool:
        """Checks whether two shapes are at most a distance apart, m."""
        if self._bound(s, t) > max_distance + ROUNDING:
            return False
        result = self.shape_distance(s, t)
        return (0.0 if result is None else max(0.0, result.distance)) <= max_distance

    def _margin(self, s: int, t: int) -> float:
        """Returns the sum of the collision margins of two shapes, m."""
        return self._margins[s] + self._margins[t]

    def _margins_of(self, i: int, j: int) -> float:  # the largest of each
        return self.margin(i) + self.margin(j)

    def shapes_touching(self, i: int, j: int, distance: float) -> list[int]:
        """Returns the indices of the shapes of an entity that touch a shape of another entity."""
        predicate = PairPredicate("touching", distance)
        with self._lock:
            near = self._near_shapes(i, j, distance + self._margins_of(i, j))
            touching = {s for s, t in near if self.satisfies(s, t, predicate)}
        return sorted(s - self.starts[i] for s in touching)

    def clearance(self, i: int, j: int, limit: float = math.inf) -> float | None:
        """Returns the distance of the nearest points, m; 0 if the entities overlap.

        Args:
            i: an entity.
            j: another one.
            limit: the largest distance of interest, m; beyond it, the result is infinite.
        """
        if i == j:
            return 0.0
        key = (i, j) if i < j else (j, i)
        with self._lock:
            if key not in self._clearances:
                if limit <= self._clearance_bounds.get(key, -math.inf):
                    return math.inf
                clearance = self._compute_clearance(*key, limit)
                if clearance == math.inf:
                    self._clearance_bounds[key] = limit
                    return clearance
                self._clearances[key] = clearance
            clearance = self._clearances[key]
            return math.inf if clearance is not None and clearance > limit else clearance

    def penetration(self, i: int, j: int) -> float | None:
        """Returns the depth of the deepest two shapes, m; 0 if all are separate."""
        if i == j:
            return 0.0
        with self._lock:
            if not (self._are_known[i] and self._are_known[j]):
                return None
            results = (self.shape_signed_distance(s, t) for s, t in self._near_shapes(i, j, 0.0))
            return max((0.0, *(-result.distance for result in results)))

    def signed_distance(self, i: int, j: int) -> SignedDistance | None:
        """Returns that of the deepest or else the nearest two shapes; None without shapes."""
        if i == j:
            return None
        key = (i, j) if i < j else (j, i)
        with self._lock:
            if key not in self._signed_distances:
                self._signed_distances[key] = self._compute_signed_distance(*key)
            result = self._signed_distances[key]
        return result if result is None or i < j else result.swapped()

    def nearest_points(self, i: int, j: int) -> tuple[Point, Point] | None:
        """Returns the nearest points of i and j in the world; the deepest if they overlap."""
        result = self.signed_distance(i, j)
        return None if result is None else (result.point_a, result.point_b)

    def contact_normals(self, a: int, b: int) -> list[Point]:
        """Returns the normals, from a to b, of touching shapes (within 1 mm and both margins)."""
        with self._lock:
            near = self._near_shapes(a, b, TOUCHING_DISTANCE + self._margins_of(a, b))
            results = [(self.shape_signed_distance(s, t), self._margin(s, t)) for s, t in near]
        touching = [r for r, margin in results if r.distance <= TOUCHING_DISTANCE + margin]
        return [(-x, -y, -z) for x, y, z in (r.normal for r in touching if r.normal)]

    def contact_height(self, s: int, t: int) -> float | None:
        """Returns the z of the unit contact normal from a shape to another one.

        None if they do not touch, or have no normal.
        """
        with self._lock:
            result = self.shape_signed_distance(s, t)
        if result.distance > TOUCHING_DISTANCE + self._margin(s, t) or result.normal is None:
            return None
        return -result.normal[2]

    def on(self, a: int, b: int) -> bool | None:
        """Checks whether b rests on a.

        They are within 1 mm and the margins of both shapes, a contact normal from a to b is within
        30 degrees of up, and the centre of b's box is over the convex hull of a's footprint.
        """
        if a == b:
            return False
        with self._lock:
            if not (self._are_known[a] and self._are_known[b]):
                return None
            near = self._near_shapes(a, b, TOUCHING_DISTANCE + self._margins_of(a, b))
            if not near or not self.is_over(a, b):
                return False
            return any(normal[2] >= MIN_UP for normal in self.contact_normals(a, b))

    def is_over(self, a: int, b: int) -> bool:
        """Checks whether the centre of b's box is over the convex hull of a's footprint."""
        x, y, _ = self.box_centre(b).tolist()
        if not (math.isfinite(x) and math.isfinite(y)):
            return False
        return self._footprints.setdefault(a, Footprint(self.shapes_of(a))).contains(x, y)

    def inside(self, a: int, b: int) -> float | None:
        """Returns the fraction of b's volume inside the convex hull of a; None if b has no volume.

        See `ssduck.geometry.containment.fraction_inside`.
        """
        with self._lock:
            if not (self._are_known[a] and self._are_known[b]):
                return None
            if (a, b) not in self._fractions_inside:
                self._fractions_inside[a, b] = fraction_inside(self._hull(a), self.shapes_of(b))
            return self._fractions_inside[a, b]

    def contains(self, a: int, b: int) -> bool | None:
        """Checks whether enough of b's volume is inside the convex hull of a."""
        with self._lock:
            if not (self._are_known[a] and self._are_known[b]):
                return None
            volume = self.solid_volume(b)
            if not volume:
                return False
            if (
                volume < math.inf
                and (a, b) not in self._fractions_inside
                and self._is_surely_outside(a, b)
            ):
                return False
            fraction = self.inside(a, b)
            return fraction is not None and fraction >= MIN_FRACTION_INSIDE

    def _is_surely_outside(self, a: int, b: int) -> bool:
        """Checks whether bounds prove that too little of b is inside; b has a volume."""
        if a not in self._hull_bounds:
            self._hull_bounds[a] = hull_bounds(self._solids_with_boxes(a))
        minimum = MIN_FRACTION_INSIDE - FRACTION_ERROR
        return (
            max_fraction_in_box(self._hull_bounds[a], self._solids_with_boxes(b)) < minimum
            or max_fraction_in_hull(self._hull(a), self.shapes_of(b)) < minimum
        )

    def _hull(self, e: int) -> WorldHull | None:
        if e not in self._hulls:
            self._hulls[e] = world_hull(self.shapes_of(e))
        return self._hulls[e]

    def _solids_with_boxes(self, e: int) -> list[tuple[Solid, Box]]:
        return [(self._solids[shape], self._corners[shape]) for shape in self._shapes[e]]

    def solid_volume(self, e: int) -> float | None:
        """Returns the sum of the volumes of the shapes, m³; overlaps count more than once.

        Open meshes have volume 0, half-spaces are infinite.
        """
        if not self._are_known[e]:
            return None
        return sum(self._solids[shape].volume for shape in self._shapes[e])

    def margin(self, e: int) -> float:
        """Returns the largest collision margin of the shapes of an entity, m; 0 without shapes."""
        return max((self._margins[shape] for shape in self._shapes[e]), default=0.0)

    def is_known(self, e: int) -> bool:
        """Checks whether all poses and shapes of an entity are known."""
        return self._are_known[e]

    def is_without_shapes(self, e: int) -> bool:
        """Checks whether an entity has no shape with a point."""
        return not self._shapes[e]

    def placed(self, entities: Sequence[int], ids: Sequence[int]) -> PlacedSolids:
        """Returns the shapes of entities that have points, in the world, owned by `ids`."""
        counts = [len(self._shapes[e]) for e in entities]
        shapes = [s for e in entities for s in self._shapes[e]]
        return PlacedSolids(
            [self._solids[s] for s in shapes],
            self._positions[shapes],
            self._matrices[shapes],
            self._boxes[shapes],
            np.repeat(np.array(ids, dtype=np.intp), counts),
        )

    # -- of two entities ------------------------------------------------------------------

    def _decide(self, i: int, j: int, predicate: PairPredicate) -> bool | None:
        if not (self._are_known[i] and self._are_known[j]):
            return None
        near = self._near_shapes(i, j, predicate.bound(self._margins_of(i, j)))
        if predicate.kind == "colliding" and any(
            self._min_depth(s, t) > predicate.distance + ROUNDING for s, t in near
        ):
            return True
        return any(self.satisfies(s, t, predicate) for s, t in near)

    def _compute_clearance(self, i: int, j: int, limit: float) -> float | None:
        if not (self._are_known[i] and self._are_known[j]):
            return None
        best = math.inf
        pairs = self._pairs(i, j)
        if not pairs:
            return None
        for bound, s, t in pairs:
            if bound > min(best, limit) + ROUNDING:
                break
            if bound <= 0.0 and self._min_depth(s, t) > MIN_DEPTH:
                return 0.0
            result = self.shape_distance(s, t)
            best = min(best, 0.0 if result is None else max(0.0, result.distance))
            if best == 0.0:
                break
        return best if best <= limit else math.inf

    def _compute_signed_distance(self, i: int, j: int) -> SignedDistance | None:
        if not (self._are_known[i] and self._are_known[j]):
            return None
        best: SignedDistance | None = None
        for bound, s, t in self._pairs(i, j):
            # All overlapping shapes are compared, for the deepest; the others up to the nearest.
            if best is not None and bound > max(0.0, best.distance) + ROUNDING:
                break
            result = self.shape_signed_distance(s, t)
            if best is None or result.distance < best.distance:
                best = result
        return best

    def _pairs(self, i: int, j: int) -> list[tuple[float, int, int]]:
        """Returns the pairs of two entities' shapes with lower bounds of distances, sorted."""
        first, second = self._shapes[i], self._shapes[j]
        bound = self._bound
        if len(first) == len(second) == 1:
            s, t = first[0], second[0]
            return [(bound(s, t), s, t)]
        return sorted((bound(s, t), s, t) for s in first for t in second)

    def _near_shapes(self, i: int, j: int, max_distance: float) -> list[tuple[int, int]]:
        """Returns the pairs of shapes that may be at most a distance apart, m."""
        limit = max(0.0, max_distance) + ROUNDING
        return [(s, t) for bound, s, t in self._pairs(i, j) if bound <= limit]

    def _bound(self, s: int, t: int) -> float:
        """Returns a lower bound of the distance of two shapes, by boxes and bounding spheres, m."""
        radii = self._bounding_radii[s] + self._bounding_radii[t]
        if radii == math.inf:
            is_plane = self._bounding_radii[s] == math.inf
            return self._bound_of_plane(s, t) if is_plane else self._bound_of_plane(t, s)
        a, b = self._corners[s], self._corners[t]
        x = max(0.0, a[0] - b[3], b[0] - a[3])
        y = max(0.0, a[1] - b[4], b[1] - a[4])
        z = max(0.0, a[2] - b[5], b[2] - a[5])
        spheres = math.dist(self._centres[s], self._centres[t]) - radii
        return max(math.sqrt(x * x + y * y + z * z), spheres)

    def _bound_of_plane(self, plane: int, other: int) -> float:
        """Returns a lower bound of the distance to a half-space, m, by a bounding sphere."""
        # The box of a tilted plane does not bound it: far out, the plane leaves its box.
        if self._solids[other].type == "plane":
            return 0.0
        x, y, z = self._placed_solid(plane).normals[0].tolist()
        (a, b, c), (d, e, f) = self._centres[other], self._placed_solid(plane).position
        height: float = x * (a - d) + y * (b - e) + z * (c - f)
        return max(0.0, height - self._solids[other].bounding_radius)

    def _min_depth(self, s: int, t: int) -> float:
        """Returns a lower bound of the depth of two shapes, by the spheres in them, m.

        Minus infinity for shapes without a known sphere: open meshes, rings and the like.
        """
        radius, other_radius = self._solids[s].inscribed_radius, self._solids[t].inscribed_radius
        if not (radius > 0.0 and other_radius > 0.0):
            return -math.inf
        distance = math.dist(self._inscribed_centres[s], self._inscribed_centres[t])
        return radius + other_radius - distance

    # -- of two shapes --------------------------------------------------------------------

    def shape_distance(self, s: int, t: int) -> SignedDistance | None:
        """Returns the signed distance of two shapes; None for meshes that overlap."""
        first, second = key = self._ordered(s, t)
        if key not in self._distances:
            a, b = self._placed_solid(first), self._placed_solid(second)
            compare = mesh_distance if self._is_of_mesh(s, t) else signed_distance
            self._distances[key] = compare(a, b, self.calls)
        result = self._distances[key]
        return result if result is None or first == s else result.swapped()

    def shape_signed_distance(self, s: int, t: int) -> SignedDistance:
        """Returns the signed distance of two shapes, which for meshes that overlap takes longer."""
        if (result := self.shape_distance(s, t)) is not None:
            return result
        first, second = key = self._ordered(s, t)
        if key not in self._depths:
            self._depths[key] = mesh_penetration(
                self._placed_solid(first), self._placed_solid(second), self.calls
            )
        return self._depths[key] if first == s else self._depths[key].swapped()

    def _ordered(self, s: int, t: int) -> tuple[int, int]:
        """Returns two shapes ordered by their geometries and poses, not by their indices.

        So the rounding errors of a comparison do not depend on the caller.
        """
        return (s, t) if (self._rank(s), s) <= (self._rank(t), t) else (t, s)

    def _rank(self, shape: int) -> tuple[str | float, ...]:
        if shape not in self._ranks:
            pose = *self._positions[shape].tolist(), *self._unit_orientations[shape].tolist()
            self._ranks[shape] = (self._solids[shape].key, *pose)
        return self._ranks[shape]

    def _is_of_mesh(self, s: int, t: int) -> bool:
        """Checks whether one of two shapes is a mesh, and none a half-space."""
        kinds = {self._solids[s].type, self._solids[t].type}
        return "mesh" in kinds and "plane" not in kinds

    def _placed_solid(self, shape: int) -> PlacedSolid:
        if shape not in self._placed_solids:
            x, y, z = self._positions[shape].tolist()
            quaternion = self._unit_orientations[shape].tolist()
            orientation = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
            self._placed_solids[shape] = PlacedSolid(self._solids[shape], (x, y, z), orientation)
        return self._placed_solids[shape]

    # -- of one entity --------------------------------------------------------------------

    def shapes_of(self, e: int) -> list[PlacedSolid]:
        """Returns the shapes of an entity that have points, in the world."""
        return [self._placed_solid(shape) for shape in self._shapes[e]]

    def box(self, e: int) -> Array:
        """Returns the box of an entity that has shapes, (6,): lower corner, upper corner."""
        rows = self._boxes[self.starts[e] : self.starts[e + 1]]
        return np.concatenate((rows[:, :3].min(axis=0), rows[:, 3:].max(axis=0)))

    def box_centre(self, e: int) -> Array:
        """Returns the centre of that box, (3,); not finite for the box of a plane."""
        box = self.box(e)
        with np.errstate(invalid="ignore"):
            centre: Array = (box[:3] + box[3:]) / 2
        return centre

    def shapes_in(self, low: Array, high: Array, excluded: Iterable[int]) -> list[PlacedSolid]:
        """Returns the known shapes whose boxes overlap a box, without those of some entities."""
        with np.errstate(invalid="ignore"):
            overlaps = (self._boxes[:, :3] <= high) & (self._boxes[:, 3:] >= low)
        is_overlapping: Flags = np.asarray(overlaps.all(axis=1))
        for e in excluded:
            is_overlapping[self.starts[e] : self.starts[e + 1]] = False
        shapes = np.flatnonzero(is_overlapping).tolist()
        return [
            self._placed_solid(shape)
            for shape in shapes
            if self._are_shapes_known[shape] and not self._solids[shape].is_empty
        ]

    @cached_property
    def _shapes(self) -> list[list[int]]:
        """The shapes of each entity that have points."""
        empty = [solid.is_empty for solid in self._solids]
        ranges = map(range, self.starts, self.starts[1:])
        return [[shape for shape in shapes if not empty[shape]] for shapes in ranges]

    @cached_property
    def _are_known(self) -> list[bool]:
        """Whether all poses and shapes of each entity are known."""
        return [all(self._are_shapes_known[a:b]) for a, b in pairwise(self.starts)]

    @cached_property
    def _bounding_radii(self) -> list[float]:
        return [solid.bounding_radius for solid in self._solids]

    # Computed for all shapes at once, when first needed.

    @cached_property
    def _unit_orientations(self) -> Array:
        return unit_quaternions(self._orientations)

    @cached_property
    def _finite(self) -> Flags:
        """Whether the pose of each shape is finite."""
        poses = np.concatenate((self._positions, self._unit_orientations), axis=1)
        return np.asarray(np.isfinite(poses).all(axis=1))

    @cached_property
    def _are_shapes_known(self) -> list[bool]:
        known = np.array([solid.is_known for solid in self._solids], dtype=bool)
        are_known: list[bool] = (self._finite & known).tolist()
        return are_known

    @cached_property
    def _corners(self) -> list[list[float]]:
        corners: list[list[float]] = self._boxes.tolist()
        return corners

    @cached_property
    def _centres(self) -> list[list[float]]:
        return self._to_world([solid.centre for solid in self._solids])

    @cached_property
    def _inscribed_centres(self) -> list[list[float]]:
        return self._to_world([solid.inscribed_centre for solid in self._solids])

    def _to_world(self, points: list[Point]) -> list[list[float]]:
        """Returns a point of each shape, transformed to the world."""
        local = np.array(points, dtype=np.float64).reshape(-1, 3)
        with np.errstate(invalid="ignore"):
            moved: list[list[float]] = (self._positions + rotate(self._matrices, local)).tolist()
        return moved

    @cached_property
    def _matrices(self) -> Array:
        with np.errstate(invalid="ignore"):
            return rotation_matrices(self._unit_orientations)
