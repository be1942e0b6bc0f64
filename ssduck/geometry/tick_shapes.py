"""The shapes of a tick in arrays, and what is kept of their pairs from tick to tick."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np

from ssduck.errors import ArgumentError
from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.broad_phase import Pairs, overlapping_pairs
from ssduck.geometry.margins import Margins
from ssduck.geometry.poses import stacked_matrices
from ssduck.geometry.proofs.cores import ConvexCores, PlacedCores
from ssduck.geometry.proofs.proposals import Proposer
from ssduck.geometry.proofs.verdicts import KeptVerdicts, ShapePoses
from ssduck.geometry.shapes import Geometry
from ssduck.geometry.solids import Solid, SolidsOfShapes, solid_of

# Added to distances of boxes, m, so that pairs exactly at the bound are candidates.
_BOUND_MARGIN = 1e-8
MAX_ENTITIES = 1 << 32
# The number of predicates of which something is kept from tick to tick.
_MAX_PREDICATES = 16
# The number of regrouped tables that are kept from tick to tick.
_MAX_REGROUPED = 16


PredicateKind: TypeAlias = Literal["colliding", "within", "touching"]


@dataclass(frozen=True)
class PairPredicate:
    """A condition on two entities; it holds if it holds for two of their shapes.

    Attributes:
        kind: "colliding": they are deeper in each other than `distance`. "within": the distance of
            their nearest points is at most `distance`. "touching": that distance is at most
            `distance` plus the collision margins of both shapes.
        distance: metres.
    """

    kind: PredicateKind
    distance: float

    def bound(self, margins: float) -> float:
        """Returns the bound of the signed distance of two shapes."""
        if self.kind == "colliding":
            return -self.distance
        return self.distance + margins if self.kind == "touching" else self.distance

    def bounds(self, table: ShapeTable, first: Indices, second: Indices) -> Array:
        """Returns the bounds for pairs of shapes, (n,)."""
        bounds = np.full(len(first), self.bound(0.0))
        if self.kind == "touching":
            bounds += table.margins.of_pairs(first, second)
        return bounds

    def candidates(self, tick: TickShapes) -> Pairs:
        """Returns the pairs of shapes whose boxes are near enough."""
        if self.kind == "colliding":
            return _candidates(tick, tick.boxes, 0.0)
        if self.kind == "within":
            return _candidates(tick, tick.boxes, self.distance + _BOUND_MARGIN)
        margins = tick.table.margins.numbers
        grown = np.concatenate((tick.boxes[:3] - margins, tick.boxes[3:] + margins))
        return _candidates(tick, grown, max(self.distance, 0.0) + _BOUND_MARGIN)


class ShapeTable:
    """The properties of shapes that do not depend on their poses, and what is kept between ticks.

    Args:
        distinct: the distinct solids.
        solid_indices: (n,), the index of each shape's solid.
        entities: (n,), the index of each shape's entity.
        margins: (n,), the collision margins, metres; None for none.
    """

    def __init__(
        self,
        distinct: Sequence[Solid],
        solid_indices: Indices,
        entities: Indices,
        margins: Margins | Array | None = None,
    ) -> None:
        self._of_each = SolidsOfShapes(distinct, np.asarray(solid_indices, dtype=np.intp))
        self.entities = entities
        self.margins = Margins.of(margins, len(solid_indices))
        self.count = int(entities.max(initial=-1)) + 1
        self.has_single_shapes = bool(np.bincount(entities).max(initial=0) <= 1)
        of_each = self._of_each
        self.is_known = of_each.flags(lambda solid: solid.is_known)
        self.has_points = of_each.flags(lambda solid: not solid.is_empty)
        self.is_plane = of_each.flags(lambda solid: solid.type == "plane")
        self.has_planes = bool(self.is_plane.any())
        self.is_box = of_each.flags(lambda solid: solid.type == "box")
        self.is_convex = of_each.flags(lambda solid: solid.is_convex)
        self.are_all_convex = bool(self.is_convex.all())
        self.bounding_radius = of_each.numbers(lambda solid: solid.bounding_radius)
        self.inscribed_radius = of_each.numbers(lambda solid: solid.inscribed_radius)
        is_closed_mesh = of_each.flags(lambda solid: solid.is_closed_mesh)
        self.with_closed_meshes = frozenset(entities[is_closed_mesh].tolist())
        # In the frames of the shapes, (3, n).
        self.centres = of_each.vectors(lambda solid: solid.centre)
        self.inscribed_centres = of_each.vectors(lambda solid: solid.inscribed_centre)
        self.are_off_centre = bool(self.centres.any() or self.inscribed_centres.any())
        self.normal = of_each.vectors(_normal).T
        self.cores = ConvexCores(of_each)
        self.proposer = Proposer(of_each)
        self._kept: dict[PairPredicate, KeptVerdicts] = {}
        self.kept_touching, self.kept_upward = KeptVerdicts(), KeptVerdicts()
        self._regrouped: dict[tuple[bytes, bytes], ShapeTable] = {}
        self._extended: tuple[tuple[tuple[str, ...], bytes], ShapeTable] | None = None

    @cached_property
    def solids(self) -> list[Solid]:
        """The solid of each shape."""
        return [self._of_each.distinct[index] for index in self._of_each.indices.tolist()]

    @cached_property
    def bounding_radii(self) -> list[float]:
        """The radius of the sphere around each shape, m; infinite for half-spaces."""
        radii: list[float] = self.bounding_radius.tolist()
        return radii

    def kept(self, predicate: PairPredicate) -> KeptVerdicts:
        """Returns the verdicts on a predicate at the tick before."""
        if predicate not in self._kept:
            if len(self._kept) >= _MAX_PREDICATES:
                self._kept.clear()
            self._kept[predicate] = KeptVerdicts()
        return self._kept[predicate]

    def extended(self, geometries: Sequence[Geometry], entities: Indices) -> ShapeTable:
        """Returns the table with further shapes, without margins; it keeps the last one."""
        key = tuple(geometry.key for geometry in geometries), entities.tobytes()
        if self._extended is not None and self._extended[0] == key:
            return self._extended[1]
        before = self._of_each
        known = len(before.distinct)
        distinct = {geometry.key: geometry for geometry in geometries}
        places = {key: known + place for place, key in enumerate(distinct)}
        indices = [places[geometry.key] for geometry in geometries]
        table = ShapeTable(
            [*before.distinct, *map(solid_of, distinct.values())],
            np.concatenate((before.indices, np.array(indices, np.intp))),
            np.concatenate((self.entities, entities)),
            self.margins.padded(len(indices)),
        )
        self._extended = key, table
        return table

    def regrouped(self, shapes: Indices, entities: Indices) -> ShapeTable:
        """Returns the table of some of the shapes, which belong to other entities.

        The table is the same at each tick, so that it keeps its verdicts.
        """
        key = shapes.tobytes(), entities.tobytes()
        table = self._regrouped.get(key)
        if table is None:
            if len(self._regrouped) >= _MAX_REGROUPED:
                self._regrouped.clear()
            distinct, indices = self._of_each.distinct, self._of_each.indices[shapes]
            margins = self.margins.take(shapes)
            table = self._regrouped[key] = ShapeTable(distinct, indices, entities, margins)
        return table


@dataclass(frozen=True, eq=False)
class TickShapes:
    """The shapes of a tick, in arrays.

    Attributes:
        table: the properties that do not depend on the tick.
        is_known: (n,), whether all poses and shapes of the entity are known.
        boxes: (6, n), lower corners, upper corners.
        positions: (n, 3).
        rotations: (9, n), the rotation matrices, row by row.
    """

    table: ShapeTable
    is_known: Flags
    boxes: Array
    positions: Array
    rotations: Array

    @cached_property
    def matrices(self) -> Array:
        """The rotation matrices, (n, 3, 3)."""
        return stacked_matrices(self.rotations)

    def _to_world(self, points: Array) -> Array:
        """Returns a point (3, n) of each shape, transformed to the world."""
        with np.errstate(invalid="ignore"):  # the terms of `rotate`, in its order
            moved: Array = self.rotations[0::3] * points[0]
            moved += self.rotations[1::3] * points[1]
            moved += self.rotations[2::3] * points[2]
            moved += self.positions.T
        return moved

    @cached_property
    def centres(self) -> Array:
        """The centres of the spheres around the shapes, (n, 3)."""
        return np.ascontiguousarray(self.placed_cores.centres.T)

    @cached_property
    def inscribed_centres(self) -> Array:
        """The centres of the spheres in the shapes, (n, 3)."""
        return np.ascontiguousarray(self.placed_cores.inscribed_centres.T)

    @cached_property
    def poses(self) -> ShapePoses:
        """The poses, from which the motion between two ticks is bounded."""
        cores = self.placed_cores
        return ShapePoses(cores.centres, cores.rotations, self.table.bounding_radius)

    @cached_property
    def placed_cores(self) -> PlacedCores:
        """The cores of the shapes."""
        table = self.table
        centres = inscribed = np.ascontiguousarray(self.positions.T)
        if table.are_off_centre:
            centres = self._to_world(table.centres)
            inscribed = self._to_world(table.inscribed_centres)
        return PlacedCores(table.cores, self.rotations, centres, inscribed)

    def owners(self, first: Indices, second: Indices) -> Indices:
        """Returns the pairs of entities that own pairs of shapes, as numbers; see `pair_number`."""
        i, j = self.table.entities[first], self.table.entities[second]
        return np.minimum(i, j) * MAX_ENTITIES + np.maximum(i, j)


def pair_number(i: int, j: int) -> int:
    """Returns the number of a pair of entities, in either order.

    >>> pair_number(3, 7) == pair_number(7, 3)
    True
    """
    return min(i, j) * MAX_ENTITIES + max(i, j)


def _normal(solid: Solid) -> Sequence[float]:
    """Returns the normal of a half-space; up for other solids."""
    is_plane = solid.type == "plane" and solid.is_known
    normal: list[float] = solid.normals[0].tolist() if is_plane else [0.0, 0.0, 1.0]
    return normal


def of_known_entities(table: ShapeTable, is_known: Flags) -> Flags:
    """Checks whether all shapes of each shape's entity are known, (n,)."""
    if is_known.all():
        return is_known
    lost = np.bincount(table.entities[~is_known], minlength=table.count)
    all_known: Flags = lost[table.entities] == 0
    return all_known


def _candidates(tick: TickShapes, boxes: Array, max_distance: float) -> Pairs:
    """Returns the pairs of known shapes of two entities whose boxes (6, n) are near each other."""
    if not max_distance >= 0.0:
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    table = tick.table
    is_known = tick.is_known & table.has_points
    known = None if is_known.all() else np.flatnonzero(is_known)
    boxes = boxes if known is None else boxes[:, known]
    if max_distance == np.inf:
        first, second = np.triu_indices(boxes.shape[1], 1)
    else:
        # The lower number first: in the same order at each tick, for the kept verdicts.
        first, second = overlapping_pairs(boxes, max_distance)
    if known is not None:
        first, second = known[first], known[second]
    if table.has_single_shapes:
        return first, second
    different = table.entities[first] != table.entities[second]
    return first[different], second[different]


def depth(min_depth: float) -> float:
    """Checks a depth, m."""
    if not min_depth >= 0.0:
        raise ArgumentError(
            f"collides: the depth is a number of metres from 0 up, not {min_depth:g}"
        )
    return min_depth
