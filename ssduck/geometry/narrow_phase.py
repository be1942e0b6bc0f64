"""The narrow phase: compares the shapes of entities.

The distance of two entities is that of their nearest shapes, their depth that of their deepest
shapes. `ssduck.geometry.tick_solids` compares these, unless their boxes and spheres decide.
`ssduck.geometry.batch` compares all pairs of a tick at once, with the same results.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from threading import RLock
from typing import TypeVar

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.batch import PairResult, matching_pairs
from ssduck.geometry.contact_support import MIN_UP
from ssduck.geometry.containment import (
    Box,
    Footprint,
    WorldHull,
    fraction_inside,
    hull_bounds,
    max_fraction_in_box,
    world_hull,
)
from ssduck.geometry.distance import CallCounter, SignedDistance
from ssduck.geometry.placed_solid import PlacedSolid, Point
from ssduck.geometry.solids import PlacedSolids, Solid
from ssduck.geometry.tick_shapes import PairPredicate, ShapeTable, TickShapes
from ssduck.geometry.tick_solids import (
    ROUNDING,
    TOUCHING_DISTANCE,
    Found,
    ShapeComparisons,
    ShapePlaces,
    TickSolids,
)

T = TypeVar("T")

# Shapes that are deeper collide, m.
MIN_DEPTH = 1e-6
# The least fraction of the volume of a contained entity that is inside.
MIN_FRACTION_INSIDE = 0.95
# The error of upper bounds of that fraction.
FRACTION_ERROR = 0.01
# The largest number of pairs of shapes whose boxes are compared in a loop, which is faster then.
MAX_LOOPED_PAIRS = 16
# A way to a distance ends at most so far beyond it, m, and takes at most so many steps.
PRECISION, MAX_STEPS = 1e-8, 200


class NarrowPhase:
    """The comparisons of the entities of one tick, by their shapes.

    Entities are numbered from 0. A result is None, for unknown, if a pose or a shape of either
    entity is unknown. An entity and itself have clearance 0 and no contact. An entity without
    shapes collides with nothing; its clearance is unknown.

    Args:
        table: the properties of the shapes.
        places: where they are.
        starts: (entities + 1,): the shapes of entity e are `starts[e]` to `starts[e + 1] - 1`.
        calls: counts the calls of FCL.

    Attributes:
        calls: the counter.
        table: see above.
        shapes: the comparisons of shapes.
        starts: see above.
    """

    def __init__(
        self,
        table: ShapeTable,
        places: ShapePlaces,
        starts: Sequence[int],
        calls: CallCounter,
    ) -> None:
        self.calls = calls
        self.table = table
        self._tick = TickSolids(table, places)
        self.shapes = ShapeComparisons(self._tick, calls)
        self.starts = starts
        # Each entity's shapes that have points, and whether all its poses and shapes are known.
        self._shapes = Found(partial(_shapes_with_points, self._tick, self.starts))
        self._are_known = Found(partial(_is_known, self._tick, self.starts))
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
        # DuckDB calls from its own threads. Without the lock, pairs would be compared twice.
        self._lock = RLock()

    def regrouped(self, shapes: Indices, owners: Indices, starts: Sequence[int]) -> NarrowPhase:
        """Returns the narrow phase of the tick with other entities: runs of shapes at `starts`."""
        places, table = self.places, self.table.regrouped(shapes, owners)
        parts = places.positions[shapes], places.orientations[shapes], places.boxes[shapes]
        return NarrowPhase(table, ShapePlaces(*parts), starts, self.calls)

    def extended(self, table: ShapeTable, poses: Sequence[Array]) -> NarrowPhase:
        """Returns the narrow phase of the tick with further shapes, which are of no entity yet."""
        before = self.places.positions, self.places.orientations, self.places.boxes
        places = ShapePlaces(*map(np.concatenate, zip(before, poses, strict=True)))
        return NarrowPhase(table, places, self.starts, self.calls)

    @property
    def places(self) -> ShapePlaces:
        """Where the shapes are."""
        return self._tick.places

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

    def all_pairs(self, predicate: PairPredicate) -> PairResult:
        """Returns the pairs of entities for which a predicate holds."""
        with self._lock:
            if predicate not in self._results:
                decide = partial(self.shapes.satisfies, predicate=predicate)
                kept = self.table.kept(predicate)
                result = matching_pairs(self.arrays, predicate, decide, kept=kept)
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

    @property
    def arrays(self) -> TickShapes:
        """The shapes in arrays."""
        return self._tick.arrays

    def _margins_of(self, i: int, j: int) -> float:  # the largest of each
        return self.margin(i) + self.margin(j)

    def shapes_touching(self, i: int, j: int, distance: float) -> list[int]:
        """Returns the indices of the shapes of an entity that touch a shape of another entity."""
        predicate = PairPredicate("touching", distance)
        with self._lock:
            near = self._near_shapes(i, j, distance + self._margins_of(i, j))
            touching = {s for s, t in near if self.shapes.satisfies(s, t, predicate)}
        return sorted(s - self.starts[i] for s in touching)

    def clearance(self, i: int, j: int, limit: float = math.inf) -> float | None:
        """Returns the distance of the nearest points, m; 0 if the entities overlap."""
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
            results = (self.shapes.signed_distance(s, t) for s, t in self._near_shapes(i, j, 0.0))
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

    def gap(self, i: int, j: int) -> float | None:
        """Returns the least distance of two shapes less their margins, m; infinite without any."""
        with self._lock:
            if not (self._are_known[i] and self._are_known[j]):
                return None
            best, most = math.inf, self._margins_of(i, j)
            for bound, s, t in self._pairs(i, j):
                if bound - most > best + ROUNDING:
                    break
                result = self.shapes.distance(s, t)
                distance = 0.0 if result is None else max(0.0, result.distance)
                best = min(best, distance - self.shapes.margin(s, t))
            return best

    def way_to(self, i: int, j: int, distance: float, *, has_margins: bool = False) -> Array | None:
        """Returns the translation of j after which its signed distance from i is just another one.

        It is the shortest one along the line of the nearest points, or of the deepest ones; None if
        it is not found. No step can be too long: a distance changes by no more than the way.

        Args:
            i: an entity.
            j: another entity.
            distance: the distance, m; minus a depth where they are to be in each other.
            has_margins: whether it is to be that less the margins of two shapes.
        """
        now = self._compute_signed_distance(i, j, has_margins=has_margins)
        if now is None or now.normal is None:
            return None
        sign = 1.0 if now.distance > distance else -1.0
        direction, way, found = sign * np.array(now.normal), 0.0, now
        for _ in range(MAX_STEPS):
            missing = sign * (found.distance - distance) + PRECISION
            if missing <= PRECISION:
                return direction * way if way else None
            way += missing
            moved = self._with_moved(i, j, direction * way)
            of_moved = moved._compute_signed_distance(0, 1, has_margins=has_margins)  # noqa: SLF001
            found = of_moved or now
        return None

    def _with_moved(self, i: int, j: int, way: Array) -> NarrowPhase:
        """Returns the narrow phase of two entities alone, of which the second one is elsewhere."""
        counts = [len(self._shapes[i]), len(self._shapes[j])]
        shapes, owners = np.array(self._shapes[i] + self._shapes[j]), np.repeat([0, 1], counts)
        both = self.regrouped(shapes, owners, [0, counts[0], sum(counts)])
        ways, places = np.outer(owners, way), both.places
        boxes = places.boxes + np.hstack((ways, ways))
        moved = ShapePlaces(places.positions + ways, places.orientations, boxes)
        return NarrowPhase(both.table, moved, both.starts, self.calls)

    def nearest_points(self, i: int, j: int) -> tuple[Point, Point] | None:
        """Returns the nearest points of i and j in the world; the deepest if they overlap."""
        result = self.signed_distance(i, j)
        return None if result is None else (result.point_a, result.point_b)

    def contact_normals(self, a: int, b: int) -> list[Point]:
        """Returns the normals, from a to b, of touching shapes (within 1 mm and both margins)."""
        with self._lock:
            return self._normals(self._near_shapes(a, b, self._reach(a, b)))

    def _normals(self, near: list[tuple[int, int]]) -> list[Point]:
        """Returns the contact normals of pairs of shapes, of those that touch."""
        results = [(self.shapes.signed_distance(s, t), self.shapes.margin(s, t)) for s, t in near]
        touching = [r for r, margin in results if r.distance <= TOUCHING_DISTANCE + margin]
        return [(-x, -y, -z) for x, y, z in (r.normal for r in touching if r.normal)]

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
            near = self._near_shapes(a, b, self._reach(a, b))
            if not near or not self.is_over(a, b):
                return False
            return any(normal[2] >= MIN_UP for normal in self._normals(near))

    def _reach(self, a: int, b: int) -> float:
        """Returns the largest distance of shapes of two entities that touch, m."""
        return TOUCHING_DISTANCE + self._margins_of(a, b)

    def is_over(self, a: int, b: int) -> bool:
        """Checks whether the centre of b's box is over the convex hull of a's footprint."""
        x, y, _ = self.box_centre(b)
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
        return max_fraction_in_box(self._hull_bounds[a], self._solids_with_boxes(b)) < minimum

    def _hull(self, e: int) -> WorldHull | None:
        if e not in self._hulls:
            self._hulls[e] = world_hull(self.shapes_of(e))
        return self._hulls[e]

    def _solids_with_boxes(self, e: int) -> list[tuple[Solid, Box]]:
        return [(self.table.solids[shape], self._tick.corners[shape]) for shape in self._shapes[e]]

    def solid_volume(self, e: int) -> float | None:
        """Returns the sum of the volumes of the shapes, m³; overlaps count more than once.

        Open meshes have volume 0, half-spaces are infinite.
        """
        if not self._are_known[e]:
            return None
        return sum(self.table.solids[shape].volume for shape in self._shapes[e])

    def surrounds(self, i: int, j: int) -> bool:
        """Checks whether a closed mesh of an entity surrounds another entity.

        The mesh contains the centre of the other's box, and the box of the mesh contains that box,
        but for `TOUCHING_DISTANCE`.
        """
        if not (self._are_known[i] and self._are_known[j] and self._shapes[j]):
            return False
        box, centre = self.box(j), self.box_centre(j)
        return any(
            self.table.solids[shape].is_closed_mesh
            and _contains_box(self._tick.corners[shape], box)
            and self._winds_around(shape, centre)
            for shape in self._shapes[i]
        )

    def _winds_around(self, shape: int, point: Point) -> bool:
        placed = self._tick.placed(shape)
        return bool(placed.solid.surface.encloses(np.array([placed.to_local(point)]))[0])

    def margin(self, e: int) -> float:
        """Returns the largest collision margin of the shapes of an entity, m; 0 without shapes."""
        return max((self.table.margins.listed[shape] for shape in self._shapes[e]), default=0.0)

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
            [self.table.solids[s] for s in shapes],
            self.places.positions[shapes],
            self.arrays.matrices[shapes],
            self.places.boxes[shapes],
            np.repeat(np.array(ids, dtype=np.intp), counts),
        )

    # -- of two entities ------------------------------------------------------------------

    def _decide(self, i: int, j: int, predicate: PairPredicate) -> bool | None:
        if not (self._are_known[i] and self._are_known[j]):
            return None
        near = self._near_shapes(i, j, predicate.bound(self._margins_of(i, j)))
        return any(self.shapes.satisfies(s, t, predicate) for s, t in near)

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
            result = self.shapes.distance(s, t)
            best = min(best, 0.0 if result is None else max(0.0, result.distance))
            if best == 0.0:
                break
        return best if best <= limit else math.inf

    def _compute_signed_distance(
        self, i: int, j: int, *, has_margins: bool = False
    ) -> SignedDistance | None:
        if not (self._are_known[i] and self._are_known[j]):
            return None
        best: SignedDistance | None = None
        most = self._margins_of(i, j) if has_margins else 0.0
        for bound, s, t in self._pairs(i, j):
            # All overlapping shapes are compared, for the deepest; the others up to the nearest.
            if best is not None and bound > max(0.0, best.distance + most) + ROUNDING:
                break
            result = self.shapes.signed_distance(s, t)
            if most:
                result = replace(result, distance=result.distance - self.shapes.margin(s, t))
            if best is None or result.distance < best.distance:
                best = result
        return best

    def _pairs(
        self, i: int, j: int, max_distance: float = math.inf
    ) -> list[tuple[float, int, int]]:
        """Returns the pairs of two entities' shapes with lower bounds of distances, sorted."""
        first, second = self._shapes[i], self._shapes[j]
        bound = self.shapes.min_distance
        if len(first) == len(second) == 1:
            s, t = first[0], second[0]
            return [(bound(s, t), s, t)]
        if max_distance < math.inf and len(first) * len(second) > MAX_LOOPED_PAIRS:
            pairs = self._tick.pairs_within(first, second, max_distance)
        else:
            pairs = product(first, second)
        return sorted((bound(s, t), s, t) for s, t in pairs)

    def _near_shapes(self, i: int, j: int, max_distance: float) -> list[tuple[int, int]]:
        """Returns the pairs of shapes that may be at most a distance apart, m."""
        limit = max(0.0, max_distance) + ROUNDING
        return [(s, t) for bound, s, t in self._pairs(i, j, limit) if bound <= limit]

    # -- of one entity --------------------------------------------------------------------

    def shapes_of(self, e: int) -> list[PlacedSolid]:
        """Returns the shapes of an entity that have points, in the world."""
        return [self._tick.placed(shape) for shape in self._shapes[e]]

    def box(self, e: int) -> list[float]:
        """Returns the box of an entity that has shapes: lower corner, upper corner."""
        shapes = range(self.starts[e], self.starts[e + 1])
        if len(shapes) == 1:
            return self._tick.corners[shapes[0]]
        rows = self.places.boxes[shapes.start : shapes.stop]
        low, high = rows[:, :3].min(axis=0).tolist(), rows[:, 3:].max(axis=0).tolist()
        return [*low, *high]

    def box_centre(self, e: int) -> Point:
        """Returns the centre of that box; not finite for the box of a plane."""
        low_x, low_y, low_z, high_x, high_y, high_z = self.box(e)
        return (low_x + high_x) / 2, (low_y + high_y) / 2, (low_z + high_z) / 2

    def shapes_in(self, low: Array, high: Array, excluded: Iterable[int]) -> list[PlacedSolid]:
        """Returns the known shapes whose boxes overlap a box, without those of some entities."""
        with np.errstate(invalid="ignore"):
            overlaps = (self.places.boxes[:, :3] <= high) & (self.places.boxes[:, 3:] >= low)
        is_overlapping: Flags = np.asarray(overlaps.all(axis=1))
        for e in excluded:
            is_overlapping[self.starts[e] : self.starts[e + 1]] = False
        shapes = np.flatnonzero(is_overlapping).tolist()
        return [
            self._tick.placed(shape)
            for shape in shapes
            if self._tick.are_known[shape] and not self.table.solids[shape].is_empty
        ]


def _shapes_with_points(tick: TickSolids, starts: Sequence[int], e: int) -> list[int]:
    return [
        shape for shape in range(starts[e], starts[e + 1]) if not tick.table.solids[shape].is_empty
    ]


def _is_known(tick: TickSolids, starts: Sequence[int], e: int) -> bool:
    """Checks whether all poses and shapes of an entity are known."""
    return all(tick.are_known[shape] for shape in range(starts[e], starts[e + 1]))


def _contains_box(outer: Box, inner: Box) -> bool:
    """Checks whether a box contains another one, but for `TOUCHING_DISTANCE`."""
    room = TOUCHING_DISTANCE
    return all(
        outer[k] - room <= inner[k] and inner[k + 3] <= outer[k + 3] + room for k in range(3)
    )
