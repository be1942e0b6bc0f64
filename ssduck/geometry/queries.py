"""Answers the questions of geometric relations about one tick, by the ids of entities."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from itertools import permutations
from threading import RLock

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.broad_phase import IdPairs, Ids, overlapping_pairs, places_by_number
from ssduck.geometry.containment import overlap_share
from ssduck.geometry.narrow_phase import MIN_DEPTH, NarrowPhase
from ssduck.geometry.neighbour_relations import NeighbourRelations, Orientation
from ssduck.geometry.on_pairs import are_on
from ssduck.geometry.shapes import Geometry
from ssduck.geometry.solids import PlacedSolids
from ssduck.geometry.tick_shapes import PairPredicate, depth, pair_number
from ssduck.geometry.tick_solids import TOUCHING_DISTANCE
from ssduck.schema import LINK_FACTOR, entity_of

# After this number of pairs, or a quarter of the entities, all pairs are compared at once.
MIN_PAIRS_AT_ONCE = 64
# After this number of pairs of links of one body, all links are compared at once.
MAX_SINGLE_OWN_PAIRS = 8
# The number of sets of links for which queries are cached.
MAX_LINK_QUERIES = 64
# The pairs that may be on each other.
_TOUCHING = PairPredicate("touching", TOUCHING_DISTANCE)
# The rounding error of distances between boxes, m.
BOX_TOLERANCE = 1e-9


class ShapeQueries:
    """The narrow phase of a tick, by the ids of entities.

    An answer is None, for unknown, if a pose is not finite, or if an entity is not in the tick.

    Args:
        narrow: the narrow phase.
        numbers: the number in `narrow` of each id.
        boxes: (6, n), those of the entities in the order of `ids`, or a function that returns them.
        ids: (n,), the ids.
        links: (shapes,), the number of each shape's link; None if links are not queried.
        are_regions: (shapes,), whether each shape is the region of a site, which does not belong to
            its entity; None if none is.
        places: what `places_by_number` returns, which is the same at each tick; None if unknown.
    """

    def __init__(
        self,
        narrow: NarrowPhase,
        numbers: Mapping[int, int],
        boxes: Array | Callable[[], Array],
        ids: Ids,
        links: Indices | None = None,
        are_regions: Flags | None = None,
        places: Indices | None = None,
    ) -> None:
        self._are_regions, self._places = are_regions, places
        self._narrow = narrow
        self._numbers = numbers
        self._table = narrow.table
        self._boxes_or_function = boxes
        self._ids = ids
        self._links = links
        self._by_links: dict[frozenset[int], ShapeQueries] = {}
        # The queries of the tick without links, of queries in which all links are bodies.
        self._whole: ShapeQueries | None = None
        self._loaded: dict[tuple[int, bool], bool] = {}
        self._lock = RLock()
        # By the distance, and whether margins count.
        self._overlapping: dict[tuple[float, bool], IdPairs] = {}
        # The number of pairs that were compared one by one, by predicate.
        self._pair_counts: Counter[PairPredicate] = Counter()
        self._own_pair_count = 0
        self._matching_by_predicate: dict[PairPredicate, frozenset[int]] = {}
        self._pairs_by_predicate: dict[PairPredicate, IdPairs] = {}
        self._on: IdPairs | None = None

    @cached_property
    def _boxes(self) -> Array:
        """The boxes of the entities, (6, n)."""
        boxes = self._boxes_or_function
        return boxes() if callable(boxes) else boxes

    @cached_property
    def _neighbours(self) -> NeighbourRelations:
        """The relations among several; made when first needed, since it refers back to this."""
        return NeighbourRelations(self._narrow, self._near_pairs, self._on_pairs)

    def of(self, ids: Iterable[int], *, needs_whole_tick: bool = False) -> ShapeQueries:
        """Returns the queries in which ids of links stand for the shapes of these links."""
        ids = tuple(ids)
        links = frozenset(id for id in ids if id >= LINK_FACTOR)
        if not links:
            return self
        if not needs_whole_tick:
            is_of_links = all(id >= LINK_FACTOR for id in ids)
            return self.links if is_of_links else self.links_and_entities
        with self._lock:
            if links not in self._by_links:
                if len(self._by_links) > MAX_LINK_QUERIES:
                    self._by_links.clear()
                is_part = np.isin(self._link_ids, list(links))
                self._by_links[links] = self._regrouped(~is_part, is_part)
            return self._by_links[links]

    @cached_property
    def links(self) -> ShapeQueries:
        """The queries of the tick in which each link is a body of its own."""
        every = np.ones(len(self._link_ids), dtype=bool)
        return self._regrouped(~every, every, whole=self)

    @cached_property
    def links_and_entities(self) -> ShapeQueries:
        """The queries in which all links stand beside their entities; only for one of each.

        Each shape is there twice.
        """
        every = np.ones(len(self._link_ids), dtype=bool)
        return self._regrouped(every, every, whole=self)

    @cached_property
    def _link_ids(self) -> Ids:
        """The id of each shape's link, (shapes,)."""
        assert self._links is not None
        owner_ids = {number: id for id, number in self._numbers.items()}
        ids = np.array([owner_ids[owner] for owner in self._table.entities.tolist()], np.int64)
        result: Ids = (self._links + 1) * LINK_FACTOR + ids
        return result

    def _regrouped(
        self, is_of_entity: Flags, is_of_link: Flags, whole: ShapeQueries | None = None
    ) -> ShapeQueries:
        """Returns queries in which shapes belong to their entities, their links, or both."""
        table = self._table
        if self._are_regions is not None:
            is_of_entity = is_of_entity & ~self._are_regions
        count = 1 + max(self._numbers.values(), default=0)
        link_ids, shapes = self._link_ids, np.arange(len(self._link_ids))
        found = np.unique(link_ids[is_of_link])
        of_links = count + np.searchsorted(found, link_ids[is_of_link])
        owners = np.concatenate((table.entities[is_of_entity], of_links))
        shapes = np.concatenate((shapes[is_of_entity], shapes[is_of_link]))
        order = np.argsort(owners, kind="stable")
        owners, shapes = owners[order], shapes[order]
        numbers = _Numbers(self._numbers)
        numbers |= {id: count + place for place, id in enumerate(found.tolist())}
        numbers.empty = count + len(found)
        starts = np.searchsorted(owners, np.arange(numbers.empty + 2))
        narrow = self._narrow.regrouped(shapes, owners, starts.tolist())
        groups = [number for number in range(numbers.empty) if starts[number] < starts[number + 1]]
        id_of = {number: id for id, number in numbers.items()}
        boxes = np.array([narrow.box(number) for number in groups]).reshape(-1, 6).T
        ids = np.array([id_of[number] for number in groups], np.int64)
        queries = ShapeQueries(narrow, numbers, boxes, ids)
        queries._whole = whole
        return queries

    def with_regions(
        self, regions: Sequence[Geometry], poses: Sequence[Array], entities: Ids, links: Indices
    ) -> ShapeQueries:
        """Returns the queries in which n sites, which are links, have their regions as shapes.

        They answer for ids of links; see `of`.
        """
        assert self._links is not None
        count, owners = len(self._table.entities), [self._numbers[id] for id in entities.tolist()]
        table = self._table.extended(regions, np.array(owners, np.intp))
        are_regions = np.arange(count + len(regions)) >= count
        narrow = self._narrow.extended(table, poses)
        links, boxes = np.concatenate((self._links, links)), lambda: self._boxes
        given = narrow, self._numbers, boxes, self._ids
        return ShapeQueries(*given, links, are_regions, self._places)

    def all_colliding(self, min_depth: float) -> IdPairs:
        """Returns the pairs that are deeper in each other than a depth, m.

        Each pair is there in both orders. So it is in the other methods.
        """
        return self._pairs(PairPredicate("colliding", depth(min_depth)))

    def all_within(self, max_distance: float) -> IdPairs:
        """Returns the pairs of two entities whose clearance is at most a distance, m."""
        return self._pairs(PairPredicate("within", max_distance))

    def all_touching(self, max_distance: float) -> IdPairs:
        """Returns the pairs with shapes that are at most a distance, m, plus both margins apart."""
        return self._pairs(PairPredicate("touching", max_distance))

    def _pairs(self, predicate: PairPredicate) -> IdPairs:
        if predicate not in self._pairs_by_predicate:
            places = self._places_by_number
            first, second = (places.take(side) for side in self._all_pairs(predicate))
            self._pairs_by_predicate[predicate] = IdPairs.in_both_orders(self._ids, first, second)
        return self._pairs_by_predicate[predicate]

    def _all_pairs(self, predicate: PairPredicate) -> tuple[Indices, Indices]:
        """Returns the numbers of the pairs for which a predicate holds, the lower ones first."""
        if not self._is_of_both:
            return self._narrow.all_pairs(predicate).sides
        # A link and an entity match if the link and one of the entity's links do.
        assert self._whole is not None
        first, second = self._whole.links._all_pairs(predicate)  # noqa: SLF001  # one class
        ids = self._ids.take(self._places_by_number).tolist()
        owners = np.array([self._numbers[entity_of(id)] for id in ids], np.intp)
        owner_of_first, owner_of_second = owners[first], owners[second]
        differ = owner_of_first != owner_of_second
        entities = np.concatenate((owner_of_first[differ], owner_of_second[differ]))
        links = np.concatenate((second[differ], first[differ]))
        known = np.array([self._narrow.is_known(e) for e in entities.tolist()], dtype=bool)
        pairs = np.unique(np.array((entities[known], links[known])), axis=1)
        return pairs[0], pairs[1]

    @cached_property
    def _places_by_number(self) -> Indices:
        """The place of each number in the narrow phase among the ids."""
        if self._places is None:
            return places_by_number(self._numbers, self._ids)
        return self._places

    @property
    def _is_of_both(self) -> bool:
        """Whether these are the queries of links beside their entities."""
        return self._whole is not None and self._whole.links is not self

    def all_meeting(self, max_distance: float) -> IdPairs:
        """Returns the pairs whose boxes are at most a distance apart along every axis, m."""
        return self._overlapping_boxes(max_distance, has_margins=False)

    def all_reaching(self, max_distance: float) -> IdPairs:
        """Returns the pairs whose boxes, grown by their largest margins, are that near."""
        return self._overlapping_boxes(max_distance, has_margins=True)

    def _overlapping_boxes(self, max_distance: float, *, has_margins: bool) -> IdPairs:
        key = max_distance, has_margins
        if key in self._overlapping:
            return self._overlapping[key]
        boxes = self._boxes_with_margins if has_margins else self._boxes
        first, second = overlapping_pairs(boxes, max_distance + BOX_TOLERANCE)
        if self._is_of_both:
            a, b = self._ids[first], self._ids[second]
            is_of_both = (a < LINK_FACTOR) != (b < LINK_FACTOR)
            wanted = is_of_both & (a % LINK_FACTOR != b % LINK_FACTOR)
            first, second = first[wanted], second[wanted]
        self._overlapping[key] = found = IdPairs.in_both_orders(self._ids, first, second)
        return found

    def all_on(self) -> IdPairs:
        """Returns the pairs of which the second is on the first."""
        with self._lock:
            if self._on is None:
                places = self._places_by_number
                a, b = self._on_among(self._all_pairs(_TOUCHING))
                self._on = IdPairs.sorted(self._ids, places.take(a), places.take(b))
            return self._on

    def _on_among(self, touching: tuple[Indices, Indices]) -> tuple[Indices, Indices]:
        """Returns the entities and what is on them, of pairs that touch, in either order."""
        a, b = np.concatenate(touching), np.concatenate(touching[::-1])
        on = are_on(self._narrow, a, b)
        return a[on], b[on]

    def _on_pairs(self) -> Iterator[tuple[int, int]]:
        """Yields the pairs of entity numbers of which the second is on the first."""
        a, b = self._on_among(self._narrow.all_pairs(_TOUCHING).sides)
        return zip(a.tolist(), b.tolist(), strict=True)

    def all_resting(self) -> IdPairs:
        """Returns the pairs of which the second rests on the first, directly or through others."""
        pairs = np.array(self._neighbours.all_resting(), np.intp).reshape(-1, 2)
        first, second = self._places_by_number.take(pairs).T
        return IdPairs.sorted(self._ids, first, second)

    def all_unknown(self) -> list[int]:
        """Returns the entities whose poses are not finite, or whose shapes are not valid."""
        return [id for id, number in self._numbers.items() if not self._narrow.is_known(number)]

    @cached_property
    def _boxes_with_margins(self) -> Array:
        """The boxes, grown by the largest margin of their shapes, (6, n)."""
        margins = np.array([self._narrow.margin(self._numbers[id]) for id in self._ids.tolist()])
        grown: Array = np.concatenate((self._boxes[:3] - margins, self._boxes[3:] + margins))
        return grown

    def _near_pairs(self, max_distance: float) -> list[tuple[int, int]]:
        """Returns the pairs of entity numbers whose grown boxes are at most a distance apart, m."""
        numbers = np.array([self._numbers[id] for id in self._ids.tolist()], dtype=np.int64)
        first, second = overlapping_pairs(self._boxes_with_margins, max_distance)
        return list(zip(numbers[first].tolist(), numbers[second].tolist(), strict=True))

    def _pair(self, a: int, b: int) -> tuple[int, int]:
        """Returns the numbers of two ids; counts the pair once a tick."""
        i, j = self._numbers[a], self._numbers[b]
        self._narrow.count_compared((pair_number(i, j),))
        return i, j

    def _matching_pairs(self, predicate: PairPredicate) -> frozenset[int] | None:
        """Returns all pairs for which a predicate holds; None for the first few queries."""
        if predicate not in self._matching_by_predicate:
            self._pair_counts[predicate] += 1
            max_single_pairs = max(MIN_PAIRS_AT_ONCE, len(self._numbers) // 4)
            is_far = predicate.kind != "colliding" and not predicate.distance <= self._median_size
            if self._pair_counts[predicate] <= max_single_pairs or is_far:
                return None
            return self._numbers_of_matching(predicate)
        return self._matching_by_predicate[predicate]

    def _numbers_of_matching(self, predicate: PairPredicate) -> frozenset[int]:
        """Returns all pairs for which a predicate holds, compared at once."""
        if predicate not in self._matching_by_predicate:
            first, second = (side.tolist() for side in self._all_pairs(predicate))
            self._matching_by_predicate[predicate] = frozenset(map(pair_number, first, second))
        return self._matching_by_predicate[predicate]

    @cached_property
    def _median_size(self) -> float:
        """The median of the longest sides of the boxes, metres."""
        with np.errstate(invalid="ignore"):
            sides = (self._boxes[3:] - self._boxes[:3]).max(axis=0, initial=0.0)
        finite = sides[np.isfinite(sides)]
        return float(np.median(finite)) if len(finite) else 0.0

    def _contains_pair(self, pairs: frozenset[int], i: int, j: int) -> bool | None:
        if pair_number(i, j) in pairs:
            return True
        return False if self._narrow.is_known(i) and self._narrow.is_known(j) else None

    def collides(self, a: int, b: int, min_depth: float = MIN_DEPTH) -> bool | None:
        """Checks whether two entities are deeper in each other than a depth, m."""
        i, j = self._pair(a, b)
        pairs = self._matching_pairs(PairPredicate("colliding", depth(min_depth)))
        if pairs is None:
            return self._narrow.collides(i, j, min_depth)
        return self._contains_pair(pairs, i, j)

    def penetration(self, a: int, b: int) -> float | None:
        """Returns the depth of the deepest two shapes, m; 0 if all are separate."""
        return self._narrow.penetration(*self._pair(a, b))

    def clearance(self, a: int, b: int) -> float | None:
        """Returns the distance of the nearest points, m; infinite for an entity without shapes."""
        i, j = self._pair(a, b)
        if self._narrow.is_without_shapes(i) or self._narrow.is_without_shapes(j):
            return math.inf
        return 0.0 if self._are_overlapping_links(a, b) else self._narrow.clearance(i, j)

    def clearance_up_to(self, a: int, b: int, limit: float) -> float | None:
        """Returns the distance of the nearest points of two entities, m; infinite beyond a limit.

        It is infinite for an entity without shapes, too.
        """
        i, j = self._pair(a, b)
        if self._narrow.is_without_shapes(i) or self._narrow.is_without_shapes(j):
            return math.inf
        return self._narrow.clearance(i, j, limit)

    @property
    def reaches(self) -> Array:
        """The largest distances of the points of shapes from the origins of their frames, m."""
        centres = np.sqrt((self._table.centres**2).sum(axis=0))
        reaches: Array = centres + self._table.bounding_radius
        return reaches

    def near(self, a: int, b: int, max_distance: float) -> bool | None:
        """Checks whether two entities are at most a distance apart, m; False without shapes."""
        i, j = self._pair(a, b)
        if self._narrow.is_without_shapes(i) or self._narrow.is_without_shapes(j):
            return False
        pairs = self._matching_pairs(PairPredicate("within", max_distance))
        if pairs is not None:
            return self._contains_pair(pairs, i, j)
        if max_distance >= 0.0 and self._are_overlapping_links(a, b):
            return True
        clearance = self._narrow.clearance(i, j, max_distance)
        return None if clearance is None else clearance <= max_distance

    def _are_overlapping_links(self, a: int, b: int) -> bool:
        """Checks whether two links of one body surely overlap, as neighbours do."""
        if entity_of(a) != entity_of(b) or min(a, b) < LINK_FACTOR:
            return False
        self._own_pair_count += 1
        if self._own_pair_count <= MAX_SINGLE_OWN_PAIRS:
            return False
        number = pair_number(self._numbers[a], self._numbers[b])
        return number in self._numbers_of_matching(PairPredicate("colliding", MIN_DEPTH))

    def touching(self, a: int, b: int, max_distance: float) -> bool | None:
        """Checks whether two of their shapes are at most a distance, m, plus both margins apart."""
        i, j = self._pair(a, b)
        pairs = self._matching_pairs(PairPredicate("touching", max_distance))
        if pairs is None:
            return self._narrow.touches(i, j, max_distance)
        return self._contains_pair(pairs, i, j)

    def gap(self, a: int, b: int) -> float | None:
        """Returns the least distance of two of their shapes less both margins, m."""
        return self._narrow.gap(*self._pair(a, b))

    def way_to(self, a: int, b: int, distance: float, *, has_margins: bool) -> Array | None:
        """Returns the translation of b to a signed distance from a; see `NarrowPhase.way_to`."""
        return self._narrow.way_to(*self._pair(a, b), distance, has_margins=has_margins)

    def shapes_touching(self, a: int, b: int, max_distance: float) -> list[int]:
        """Returns the indices of a's shapes that touch a shape of b."""
        return self._narrow.shapes_touching(*self._pair(a, b), max_distance)

    def points(self, a: int, b: int) -> list[list[float]] | None:
        """Returns the nearest points, or the deepest ones, one of each entity."""
        points = self._narrow.nearest_points(*self._pair(a, b))
        return None if points is None else [list(point) for point in points]

    def on(self, a: int, b: int) -> bool | None:
        """Checks whether b rests on a."""
        return self._narrow.on(*self._pair(a, b))

    def supports(self, a: int, b: int) -> bool | None:
        """Checks whether a carries b, alone or together with others."""
        if self._whole is not None:
            touches = self.touching(a, b, TOUCHING_DISTANCE)
            return self._beside_the_rest(a, b).supports(a, b) if touches else touches
        return self._neighbours.supports(*self._pair(a, b))

    def rests_on(self, a: int, b: int) -> bool | None:
        """Checks whether b is on a, or on something that rests on a."""
        if self._whole is not None:
            queries = self._whole.links_and_entities
            if not (queries._is_loaded(a, is_below=True) and queries._is_loaded(b, is_below=False)):  # noqa: SLF001
                return False
            return self._beside_the_rest(a, b).rests_on(a, b)
        return self._neighbours.rests_on(self._numbers[a], self._numbers[b])

    def encloses(self, a: int, b: int, *orientation: float) -> bool | None:
        """Checks whether b is within walls of a, whose link frame has the given orientation."""
        return self._neighbours.encloses(*self._pair(a, b), _orientation(orientation))

    def beside(self, a: int, b: int, max_distance: float, *orientations: float) -> bool | None:
        """Checks whether two entities with overlapping heights are beside each other."""
        is_near = self.near(a, b, max_distance)
        if not is_near:
            return is_near
        if self._whole is not None:
            queries = self._beside_the_rest(a, b)
            return queries.beside(a, b, max_distance, *orientations)
        return self._neighbours.are_beside(
            *self._pair(a, b), _orientation(orientations[:4]), _orientation(orientations[4:])
        )

    def _beside_the_rest(self, a: int, b: int) -> ShapeQueries:
        """Returns the queries in which the links among two ids stand beside the rest of theirs."""
        assert self._whole is not None
        return self._whole.of((a, b), needs_whole_tick=True)

    def _is_loaded(self, id: int, *, is_below: bool) -> bool:
        """Checks whether anything is on an entity or a link, or it is on anything; or may be."""
        key = id, is_below
        if key not in self._loaded:
            entity = entity_of(id)
            # An entity is not on its links, nor they on it; one of its links may be on another.
            others = [
                other
                for other in self._numbers
                if other not in (id, entity) and (id != entity or entity_of(other) != id)
            ]
            self._loaded[key] = any(
                (self.on(id, other) if is_below else self.on(other, id)) is not False
                for other in others
            )
        return self._loaded[key]

    def inside(self, a: int, b: int) -> float | None:
        """Returns the fraction of b's volume inside a's convex hull; 0 if b has no volume."""
        i, j = self._pair(a, b)
        return 0.0 if self._narrow.solid_volume(j) == 0.0 else self._narrow.inside(i, j)

    def contains(self, a: int, b: int) -> bool | None:
        """Checks whether enough of b's volume is inside a's convex hull."""
        i, j = self._pair(a, b)
        return False if self._narrow.solid_volume(j) == 0.0 else self._narrow.contains(i, j)

    def volume(self, entity: int) -> float | None:
        """Returns the sum of the volumes of an entity's shapes, m³."""
        return self._narrow.solid_volume(self._numbers[entity])

    def overlap_share(self, entity: int) -> float:
        """Returns the share of the volume of an entity's shapes that two of them have in common."""
        return overlap_share(self._narrow.shapes_of(self._numbers[entity]))

    def filled_meshes(self, ids: Sequence[int] | None = None) -> list[int]:
        """Returns the entities with a closed mesh that surrounds another one."""
        meshes = self._table.with_closed_meshes
        if not meshes:
            return []
        pairs = self._in_boxes() if ids is None else permutations(ids, 2)
        numbered = ((a, self._numbers[a], self._numbers[b]) for a, b in pairs)
        return [a for a, i, j in numbered if i in meshes and self._narrow.surrounds(i, j)]

    def _in_boxes(self) -> Iterator[tuple[int, int]]:
        """Returns the ids of pairs of which the box of the first nearly contains the second's."""
        met, room = self.all_meeting(0.0), TOUCHING_DISTANCE
        outer, inner = self._boxes[:, met.first], self._boxes[:, met.second]
        fits = (outer[:3] - room <= inner[:3]) & (inner[3:] <= outer[3:] + room)
        chosen = fits.all(axis=0)
        a, b = (met.ids[side[chosen]].tolist() for side in (met.first, met.second))
        return zip(a, b, strict=True)

    def unknown(self, ids: Sequence[int]) -> list[int]:
        """Returns the entities whose poses are not finite, or whose shapes are not valid."""
        queries = self.of(ids)
        return [id for id in ids if not queries._narrow.is_known(queries._numbers[id])]  # noqa: SLF001

    def placed(self, ids: Sequence[int]) -> PlacedSolids:
        """Returns the shapes of some entities in the world."""
        queries = self.of(ids)
        return queries._narrow.placed([queries._numbers[id] for id in ids], ids)  # noqa: SLF001


class _Numbers(dict[int, int]):
    """The numbers of ids in a narrow phase; those of links without shapes are `empty`."""

    empty = 0

    def __missing__(self, id: int) -> int:
        if id < LINK_FACTOR:
            raise KeyError(id)
        return self.empty


def _orientation(numbers: tuple[float, ...]) -> Orientation:
    w, x, y, z = numbers
    return w, x, y, z
