"""The narrow phase: relations of entities by the shapes that they are made of.

An entity is all its shapes: it is as near, as deep and as much in contact as the closest of
them. Every pair of shapes is compared once a tick, and only if their boxes and the spheres
around and in them do not tell: see `ssduck.geometry.distance` for what a gap, a depth and a normal
are, and `ssduck.geometry.mesh_distance` for those of meshes that are not convex. Which of all pairs
collide or are near each other is found at once, by `ssduck.geometry.batch`, with the same answers.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import cached_property
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
from ssduck.geometry.contact_support import UPRIGHT
from ssduck.geometry.containment import (
    Box,
    WorldHull,
    footprint,
    fraction_inside,
    hull_bounds,
    is_over_footprint,
    max_fraction_in_box,
    max_fraction_in_hull,
    world_hull,
)
from ssduck.geometry.distance import CallCounter, SignedDistance, signed_distance
from ssduck.geometry.mesh_distance import is_surely_deeper, mesh_distance, mesh_penetration
from ssduck.geometry.placed_solid import PlacedSolid, Point
from ssduck.geometry.poses import rotate, rotation_matrices, unit_quaternions
from ssduck.geometry.solids import PlacedSolids, Solid

# What is deeper collides.
COLLIDES = 1e-6
# What is as near touches, for `on`.
TOUCHES = 1e-3
# What boxes and spheres tell of a distance, metres, may be off by as much.
ROUNDING = 1e-9
# Of what is contained, at least this share of the volume is inside.
CONTAINED = 0.95
# What boxes and spheres tell of a share may be off by as much.
TOLD = 0.01


class NarrowPhase:
    """The shapes of one tick.

    All methods take entities by number. Their answer is None, for unknown, if a pose or a shape of
    either is no number or no shape. An entity and itself have clearance 0, and no contact. One
    without shapes collides with nothing, and its clearance is unknown.

    Args:
        solids: the different solids.
        of: per shape, which solid it is.
        positions: (shapes, 3), in the world.
        orientations: (shapes, 4), quaternions w, x, y, z; their lengths do not matter.
        boxes: (shapes, 6), lower corner, upper corner, in the world.
        starts: (entities + 1,): the shapes of entity e are those from `starts[e]` up to, and
            without, `starts[e + 1]`.
        calls: counts what FCL is asked.
        margins: (shapes,), the collision margins, metres; None for none.
    """

    def __init__(
        self,
        solids: Sequence[Solid],
        of: Indices,
        positions: Array,
        orientations: Array,
        boxes: Array,
        starts: Sequence[int],
        calls: CallCounter,
        margins: Array | None = None,
    ) -> None:
        self.calls = calls
        self._margins: list[float] = [0.0] * len(of) if margins is None else margins.tolist()
        self._solids: list[Solid] = [solids[number] for number in np.asarray(of).tolist()]
        self._positions, self._orientations, self._boxes = positions, orientations, boxes
        self._starts = list(starts)
        self._placed: dict[int, PlacedSolid] = {}
        self._ranks: dict[int, tuple[str | float, ...]] = {}
        self._apart: dict[tuple[int, int], SignedDistance | None] = {}
        self._deep: dict[tuple[int, int], SignedDistance] = {}
        self._clearances: dict[tuple[int, int], float | None] = {}
        self._beyond: dict[tuple[int, int], float] = {}
        self._decided: dict[tuple[int, int, PairPredicate], bool | None] = {}
        self._closest: dict[tuple[int, int], SignedDistance | None] = {}
        self._shares: dict[tuple[int, int], float | None] = {}
        self._hulls: dict[int, WorldHull | None] = {}
        self._arounds: dict[int, Box] = {}
        self._footprints: dict[int, Array] = {}
        self._all: dict[PairPredicate, PairResult] = {}
        self._compared: set[int] = set()
        # DuckDB calls from its own threads. A pair would be compared twice, not wrongly.
        self._lock = RLock()

    # -- relations ------------------------------------------------------------------------

    def collides(self, i: int, j: int, deeper: float = COLLIDES) -> bool | None:
        """Whether they are deeper in each other, m."""
        return self._holds(i, j, PairPredicate("colliding", deeper))

    def touches(self, i: int, j: int, apart: float = TOUCHES) -> bool | None:
        """Whether two shapes are at most so far apart, m, and the margins of both."""
        return self._holds(i, j, PairPredicate("touching", apart))

    def _holds(self, i: int, j: int, predicate: PairPredicate) -> bool | None:
        if i == j:
            return False
        key = (i, j, predicate) if i < j else (j, i, predicate)
        with self._lock:
            if key not in self._decided:
                self._decided[key] = self._decide(*key)
            return self._decided[key]

    def all_of(self, predicate: PairPredicate, table: ShapeTable) -> PairResult:
        """The pairs of entities of which something holds.

        Args:
            predicate: what is to hold.
            table: what the shapes are, and whose.
        """
        with self._lock:
            if predicate not in self._all:
                scene = self._scene(table)
                found = matching_pairs(scene, predicate, lambda s, t: self.answer(s, t, predicate))
                self.note(found.compared.tolist())
                self._all[predicate] = found
            return self._all[predicate]

    def note(self, pairs: Iterable[int]) -> None:
        """Count pairs of entities, by their numbers, as compared.

        Each counts once a tick, however it is asked about and whatever decides it.
        """
        with self._lock:
            before = len(self._compared)
            self._compared.update(pairs)
            self.calls.pairs += len(self._compared) - before

    def _scene(self, table: ShapeTable) -> TickShapes:
        known = of_known_entities(table, self._finite & table.is_known)
        return TickShapes(table, known, self._boxes.T, self._positions, self._matrices)

    def answer(self, s: int, t: int, predicate: PairPredicate) -> bool:
        """Whether something holds of two shapes."""
        if predicate.of == "colliding":
            return self._are_deep(s, t, predicate.distance)
        return self._are_within(s, t, predicate.bound(self._margin(s, t)))

    def _are_deep(self, s: int, t: int, deeper: float) -> bool:
        """Whether two shapes are deeper in each other."""
        if self._bound(s, t) > 0.0:
            return False
        # Most meshes that collide are found to without their depth.
        first, second = self._in_order(s, t)
        is_new = self._is_of_mesh(s, t) and (first, second) not in self._apart
        if is_new and is_surely_deeper(self._place(first), self._place(second), deeper, self.calls):
            return True
        return self._signed_distance(s, t).distance < -deeper

    def _are_within(self, s: int, t: int, apart: float) -> bool:
        """Whether two shapes are at most so far apart, m."""
        if self._bound(s, t) > apart + ROUNDING:
            return False
        found = self._gap(s, t)
        return (0.0 if found is None else max(0.0, found.distance)) <= apart

    def _margin(self, s: int, t: int) -> float:
        """The collision margins of two shapes together, m."""
        return self._margins[s] + self._margins[t]

    def _margins_of(self, i: int, j: int) -> float:
        """The same of two entities, of those of their shapes that have the largest."""
        return self.margin(i) + self.margin(j)

    def shapes_touching(self, i: int, j: int, apart: float) -> list[int]:
        """Which of an entity's shapes are at most so far from one of another's, m, and margins."""
        predicate = PairPredicate("touching", apart)
        with self._lock:
            near = self._near(i, j, apart + self._margins_of(i, j))
            found = {s for s, t in near if self.answer(s, t, predicate)}
        return sorted(s - self._starts[i] for s in found)

    def clearance(self, i: int, j: int, upto: float = math.inf) -> float | None:
        """The distance of the nearest points, 0 where they meet.

        Args:
            i: an entity.
            j: another.
            upto: what is farther does not matter: it is infinity.
        """
        if i == j:
            return 0.0
        key = (i, j) if i < j else (j, i)
        with self._lock:
            if key not in self._clearances:
                if upto <= self._beyond.get(key, -math.inf):
                    return math.inf
                found = self._clear(*key, upto)
                if found == math.inf:
                    self._beyond[key] = upto
                    return found
                self._clearances[key] = found
            found = self._clearances[key]
            return math.inf if found is not None and found > upto else found

    def penetration(self, i: int, j: int) -> float | None:
        """The depth of the deepest two shapes, 0 if all are apart."""
        if i == j:
            return 0.0
        with self._lock:
            if not (self._are_known[i] and self._are_known[j]):
                return None
            found = (self._signed_distance(s, t) for s, t in self._near(i, j, 0.0))
            return max((0.0, *(-one.distance for one in found)))

    def signed_distance(self, i: int, j: int) -> SignedDistance | None:
        """The deepest two shapes if any meet, else the nearest two; None without shapes."""
        if i == j:
            return None
        key = (i, j) if i < j else (j, i)
        with self._lock:
            if key not in self._closest:
                self._closest[key] = self._find_closest(*key)
            found = self._closest[key]
        return found if found is None or i < j else found.swapped()

    def nearest_points(self, i: int, j: int) -> tuple[Point, Point] | None:
        """A point on i and one on j, in the world: the nearest, or the deepest where they meet."""
        found = self.signed_distance(i, j)
        return None if found is None else (found.point_a, found.point_b)

    def pushes(self, a: int, b: int) -> list[Point]:
        """The normals, from a to b, of their shapes that touch, by 1 mm and the margins of both."""
        with self._lock:
            near = self._near(a, b, TOUCHES + self._margins_of(a, b))
            found = ((self._signed_distance(s, t), TOUCHES + self._margin(s, t)) for s, t in near)
            normals = [one.normal for one, apart in found if one.distance <= apart]
        return [(-x, -y, -z) for x, y, z in filter(None, normals)]

    def on(self, a: int, b: int) -> bool | None:
        """Whether b rests on a.

        They are within 1 mm and the margins of both shapes, a normal there from a to b is within
        30 degrees of up, and the middle of b's box is over the hull of a's footprint.
        """
        if a == b:
            return False
        with self._lock:
            if not (self._are_known[a] and self._are_known[b]):
                return None
            near = self._near(a, b, TOUCHES + self._margins_of(a, b))
            if not near or not self._is_over(a, b):
                return False
            return any(push[2] >= UPRIGHT for push in self.pushes(a, b))

    def _is_over(self, a: int, b: int) -> bool:
        """Whether the middle of b's box is over the hull of a's footprint."""
        x, y, _ = self.middle(b).tolist()
        if not (math.isfinite(x) and math.isfinite(y)):
            return False
        if a not in self._footprints:
            self._footprints[a] = footprint(self.shapes_of(a))
        return is_over_footprint(self.shapes_of(a), self._footprints[a], x, y)

    def inside(self, a: int, b: int) -> float | None:
        """The share of b's volume that is inside the convex hull of a, 0..1.

        None if b has no volume. See `ssduck.geometry.containment.fraction_inside`.
        """
        with self._lock:
            if not (self._are_known[a] and self._are_known[b]):
                return None
            if (a, b) not in self._shares:
                self._shares[a, b] = fraction_inside(self._hull(a), self.shapes_of(b))
            return self._shares[a, b]

    def contains(self, a: int, b: int) -> bool | None:
        """Whether a share of b's volume that counts as all is inside the convex hull of a.

        False if b has no volume.
        """
        with self._lock:
            if not (self._are_known[a] and self._are_known[b]):
                return None
            volume = self.solid_volume(b)
            if not volume:
                return False
            if volume < math.inf and (a, b) not in self._shares and self._is_surely_out(a, b):
                return False
            share = self.inside(a, b)
            return share is not None and share >= CONTAINED

    def _is_surely_out(self, a: int, b: int) -> bool:
        """Whether not enough of b, which has a volume, can be inside the hull of a."""
        if a not in self._arounds:
            self._arounds[a] = hull_bounds(self._boxed(a))
        if max_fraction_in_box(self._arounds[a], self._boxed(b)) < CONTAINED - TOLD:
            return True
        return max_fraction_in_hull(self._hull(a), self.shapes_of(b)) < CONTAINED - TOLD

    def _hull(self, e: int) -> WorldHull | None:
        if e not in self._hulls:
            self._hulls[e] = world_hull(self.shapes_of(e))
        return self._hulls[e]

    def _boxed(self, e: int) -> list[tuple[Solid, Box]]:
        return [(self._solids[shape], self._corners[shape]) for shape in self._shapes[e]]

    def solid_volume(self, e: int) -> float | None:
        """The volumes of the shapes, m³, those that overlap more than once.

        An open mesh has none, a half-space is infinite.
        """
        if not self._are_known[e]:
            return None
        return sum(self._solids[shape].volume for shape in self._shapes[e])

    def margin(self, e: int) -> float:
        """The largest collision margin of its shapes, m; 0 without any."""
        return max((self._margins[shape] for shape in self._shapes[e]), default=0.0)

    def is_known(self, e: int) -> bool:
        """Whether an entity's poses are numbers and its shapes are known."""
        return self._are_known[e]

    def is_without_shapes(self, e: int) -> bool:
        """Whether an entity has no shape with a point."""
        return not self._shapes[e]

    def placed(self, entities: Sequence[int], ids: Sequence[int]) -> PlacedSolids:
        """The shapes of entities, those without a point left out, as of `ids`."""
        counts = [len(self._shapes[e]) for e in entities]
        numbers = [s for e in entities for s in self._shapes[e]]
        return PlacedSolids(
            [self._solids[s] for s in numbers],
            self._positions[numbers],
            self._matrices[numbers],
            self._boxes[numbers],
            np.repeat(np.array(ids, dtype=np.intp), counts),
        )

    # -- of two entities ------------------------------------------------------------------

    def _decide(self, i: int, j: int, predicate: PairPredicate) -> bool | None:
        if not (self._are_known[i] and self._are_known[j]):
            return None
        near = self._near(i, j, predicate.bound(self._margins_of(i, j)))
        if predicate.of == "colliding" and any(
            self._overlap(s, t) > predicate.distance + ROUNDING for s, t in near
        ):
            return True
        return any(self.answer(s, t, predicate) for s, t in near)

    def _clear(self, i: int, j: int, upto: float) -> float | None:
        if not (self._are_known[i] and self._are_known[j]):
            return None
        best = math.inf
        pairs = self._pairs(i, j)
        if not pairs:
            return None
        for bound, s, t in pairs:
            if bound > min(best, upto) + ROUNDING:
                break
            if bound <= 0.0 and self._overlap(s, t) > COLLIDES:
                return 0.0
            apart = self._gap(s, t)
            best = min(best, 0.0 if apart is None else max(0.0, apart.distance))
            if best == 0.0:
                break
        return best if best <= upto else math.inf

    def _find_closest(self, i: int, j: int) -> SignedDistance | None:
        if not (self._are_known[i] and self._are_known[j]):
            return None
        best: SignedDistance | None = None
        for bound, s, t in self._pairs(i, j):
            # Those that meet are all compared, for the deepest; the others up to the nearest.
            if best is not None and bound > max(0.0, best.distance) + ROUNDING:
                break
            found = self._signed_distance(s, t)
            if best is None or found.distance < best.distance:
                best = found
        return best

    def _pairs(self, i: int, j: int) -> list[tuple[float, int, int]]:
        """The pairs of their shapes with a lower bound of their distances, nearest first."""
        first, second = self._shapes[i], self._shapes[j]
        bound = self._bound
        if len(first) == len(second) == 1:
            s, t = first[0], second[0]
            return [(bound(s, t), s, t)]
        return sorted((bound(s, t), s, t) for s in first for t in second)

    def _near(self, i: int, j: int, within: float) -> list[tuple[int, int]]:
        """Those that may be no farther apart."""
        far = max(0.0, within) + ROUNDING
        return [(s, t) for bound, s, t in self._pairs(i, j) if bound <= far]

    def _bound(self, s: int, t: int) -> float:
        """The distance of two shapes' boxes, or of the spheres around them if that is more."""
        both = self._reaches[s] + self._reaches[t]
        if both == math.inf:
            is_plane = self._reaches[s] == math.inf
            return self._bound_of_plane(s, t) if is_plane else self._bound_of_plane(t, s)
        a, b = self._corners[s], self._corners[t]
        x = max(0.0, a[0] - b[3], b[0] - a[3])
        y = max(0.0, a[1] - b[4], b[1] - a[4])
        z = max(0.0, a[2] - b[5], b[2] - a[5])
        spheres = math.dist(self._centres[s], self._centres[t]) - both
        return max(math.sqrt(x * x + y * y + z * z), spheres)

    def _bound_of_plane(self, plane: int, other: int) -> float:
        """Its box does not serve: far out, a plane that is hardly tilted is out of it."""
        if self._solids[other].type == "plane":
            return 0.0
        x, y, z = self._place(plane).normals[0].tolist()
        (a, b, c), (d, e, f) = self._centres[other], self._place(plane).position
        height: float = x * (a - d) + y * (b - e) + z * (c - f)
        return max(0.0, height - self._solids[other].bounding_radius)

    def _overlap(self, s: int, t: int) -> float:
        """How deep spheres in the shapes are in each other: they are at least as deep, m.

        A shape without an inside has no such sphere, and one around nothing, a ring, none that
        is known: then it is minus infinity.
        """
        own, other = self._solids[s].inscribed_radius, self._solids[t].inscribed_radius
        if not (own > 0.0 and other > 0.0):
            return -math.inf
        return own + other - math.dist(self._inner[s], self._inner[t])

    # -- of two shapes --------------------------------------------------------------------

    def _gap(self, s: int, t: int) -> SignedDistance | None:
        """The separation of shapes, s's from t's; None for meshes that meet."""
        first, second = key = self._in_order(s, t)
        if key not in self._apart:
            a, b = self._place(first), self._place(second)
            compare = mesh_distance if self._is_of_mesh(s, t) else signed_distance
            self._apart[key] = compare(a, b, self.calls)
        found = self._apart[key]
        return found if found is None or first == s else found.swapped()

    def _signed_distance(self, s: int, t: int) -> SignedDistance:
        found = self._gap(s, t)
        if found is not None:
            return found
        first, second = key = self._in_order(s, t)
        if key not in self._deep:
            self._deep[key] = mesh_penetration(self._place(first), self._place(second), self.calls)
        return self._deep[key] if first == s else self._deep[key].swapped()

    def _in_order(self, s: int, t: int) -> tuple[int, int]:
        """Two shapes in an order that hangs on what and where they are, not on their numbers.

        So they are compared with the same rounding whoever asks: first of one and then of the
        other, of a tick's rows or of two of them.
        """
        return (s, t) if (self._rank(s), s) <= (self._rank(t), t) else (t, s)

    def _rank(self, shape: int) -> tuple[str | float, ...]:
        if shape not in self._ranks:
            place = *self._positions[shape].tolist(), *self._unit[shape].tolist()
            self._ranks[shape] = (self._solids[shape].key, *place)
        return self._ranks[shape]

    def _is_of_mesh(self, s: int, t: int) -> bool:
        """Whether one of them is a mesh and neither a half-space."""
        kinds = {self._solids[s].type, self._solids[t].type}
        return "mesh" in kinds and "plane" not in kinds

    def _place(self, shape: int) -> PlacedSolid:
        if shape not in self._placed:
            x, y, z = self._positions[shape].tolist()
            turn = self._unit[shape].tolist()
            orientation = turn[0], turn[1], turn[2], turn[3]
            self._placed[shape] = PlacedSolid(self._solids[shape], (x, y, z), orientation)
        return self._placed[shape]

    # -- of one entity --------------------------------------------------------------------

    def shapes_of(self, e: int) -> list[PlacedSolid]:
        """The shapes of an entity that have points, where they are."""
        return [self._place(shape) for shape in self._shapes[e]]

    def box(self, e: int) -> Array:
        """The lower and the upper corner of the box of an entity that has shapes, (6,)."""
        rows = self._boxes[self._starts[e] : self._starts[e + 1]]
        return np.concatenate((rows[:, :3].min(axis=0), rows[:, 3:].max(axis=0)))

    def middle(self, e: int) -> Array:
        """The centre of that box, (3,); not finite where a plane's box has none."""
        box = self.box(e)
        with np.errstate(invalid="ignore"):
            centre: Array = (box[:3] + box[3:]) / 2
        return centre

    def shapes_in(self, low: Array, high: Array, without: Iterable[int]) -> list[PlacedSolid]:
        """The known shapes whose boxes meet a box, those of some entities left out."""
        with np.errstate(invalid="ignore"):
            both = (self._boxes[:, :3] <= high) & (self._boxes[:, 3:] >= low)
        meets: Flags = np.asarray(both.all(axis=1))
        for e in without:
            meets[self._starts[e] : self._starts[e + 1]] = False
        found = np.flatnonzero(meets).tolist()
        return [
            self._place(shape)
            for shape in found
            if self._known[shape] and not self._solids[shape].is_empty
        ]

    @cached_property
    def _shapes(self) -> list[list[int]]:
        """Of each entity the shapes that have points."""
        empty = [solid.is_empty for solid in self._solids]
        ranges = map(range, self._starts, self._starts[1:])
        return [[shape for shape in shapes if not empty[shape]] for shapes in ranges]

    @cached_property
    def _are_known(self) -> list[bool]:
        """Of each entity whether all its poses and shapes are known."""
        return [all(self._known[a:b]) for a, b in pairwise(self._starts)]

    @cached_property
    def _reaches(self) -> list[float]:
        return [solid.bounding_radius for solid in self._solids]

    # What all shapes need of their poses is worked out at once, and not before it is asked for.

    @cached_property
    def _unit(self) -> Array:
        return unit_quaternions(self._orientations)

    @cached_property
    def _finite(self) -> Flags:
        """Of each shape whether its pose is."""
        poses = np.concatenate((self._positions, self._unit), axis=1)
        return np.asarray(np.isfinite(poses).all(axis=1))

    @cached_property
    def _known(self) -> list[bool]:
        known = np.array([solid.is_known for solid in self._solids], dtype=bool)
        found: list[bool] = (self._finite & known).tolist()
        return found

    @cached_property
    def _corners(self) -> list[list[float]]:
        corners: list[list[float]] = self._boxes.tolist()
        return corners

    @cached_property
    def _centres(self) -> list[list[float]]:
        return self._moved([solid.centre for solid in self._solids])

    @cached_property
    def _inner(self) -> list[list[float]]:
        return self._moved([solid.inscribed_centre for solid in self._solids])

    def _moved(self, points: list[Point]) -> list[list[float]]:
        """A point of each shape in the world."""
        local = np.array(points, dtype=np.float64).reshape(-1, 3)
        with np.errstate(invalid="ignore"):
            found: list[list[float]] = (self._positions + rotate(self._matrices, local)).tolist()
        return found

    @cached_property
    def _matrices(self) -> Array:
        with np.errstate(invalid="ignore"):
            return rotation_matrices(self._unit)
