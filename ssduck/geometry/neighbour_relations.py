"""Relations of an entity to its neighbours: enclosing, beside, supporting, resting on.

Rays against the shapes of a tick decide the first two, contact normals the others.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from itertools import chain
from typing import TypeAlias

import numpy as np

from ssduck.geometry.arrays import Array
from ssduck.geometry.contact_support import is_carried_by
from ssduck.geometry.distance import SignedDistance
from ssduck.geometry.narrow_phase import NarrowPhase
from ssduck.geometry.placed_solid import PlacedSolid, Point
from ssduck.geometry.poses import rotation_matrices
from ssduck.geometry.ray_casting import (
    HIT_TOLERANCE,
    crossings,
    first_hits,
    is_triangle_surface,
    ray_chords,
)
from ssduck.geometry.tick_shapes import pair_number

# The numbers w, x, y, z of a unit quaternion.
Orientation: TypeAlias = tuple[float, float, float, float]

# The part of a line that is in a shape: the distances from its start, m.
_Interval: TypeAlias = tuple[float, float]

# The greatest distance of the boxes, grown by margins, of entities that rest on each other, m.
RESTING_DISTANCE = 0.01
# An entity that extends beyond another at both ends by more is not enclosed along that axis, m.
MAX_PROTRUSION = 1e-3
# The least number of axes, of three, with walls on both sides.
MIN_WALLED_AXES = 2
# The places of lines between two entities: fractions of their common breadth and height.
LINE_FRACTIONS = (0.5, 0.1, 0.9, 0.3, 0.7)
# A direction with a smaller horizontal part counts as vertical.
MIN_HORIZONTAL = 1e-6


class NeighbourRelations:
    """Relations of the entities of one tick to their neighbours, by their shapes.

    Entities are numbered from 0. A result is None, for unknown, as in the narrow phase. An entity
    has no relation to itself, and one without shapes to none.

    Args:
        narrow: the narrow phase of the tick.
        pairs: yields the pairs of entities whose boxes, grown by the margins of their shapes, are
            at most a distance apart along every axis, m.
        on_pairs: yields the pairs of which the second is directly on the first.
    """

    def __init__(
        self,
        narrow: NarrowPhase,
        pairs: Callable[[float], Iterable[tuple[int, int]]],
        on_pairs: Callable[[], Iterable[tuple[int, int]]],
    ) -> None:
        self._narrow = narrow
        self._pairs = pairs
        self._on_pairs = on_pairs
        self._resting: dict[int, frozenset[int]] = {}

    def encloses(self, a: int, b: int, orientation: Orientation) -> bool | None:
        """Checks whether b is within walls of a, seen from the centre of b's box.

        The walls stand across the axes of a's link frame, which has the orientation.
        """
        if not self._are_known(a, b):
            return None
        if not self._are_two_with_shapes(a, b):
            return False
        narrow = self._narrow
        centre = np.array(narrow.box_centre(b))
        axes = rotation_matrices(np.array([orientation]))[0].T
        if not np.isfinite(centre).all():
            return False
        return _is_walled_in(narrow.shapes_of(a), axes, narrow.shapes_of(b), centre)

    def are_beside(
        self, a: int, b: int, orientation_a: Orientation, orientation_b: Orientation
    ) -> bool | None:
        """Checks whether neither is on or in the other, and nothing stands between them.

        The caller has tested that their heights overlap and that they are near enough.
        """
        if not self._are_known(a, b):
            return None
        if not self._are_two_with_shapes(a, b):
            return False
        for first, second, orientation in ((a, b, orientation_a), (b, a, orientation_b)):
            if self.supports(first, second) or self._narrow.contains(first, second):
                return False
            if self.encloses(first, second, orientation) or second in self._resting_on(first):
                return False
        return self._are_in_sight(min(a, b), max(a, b))

    def _are_in_sight(self, a: int, b: int) -> bool:
        narrow = self._narrow
        boxes, nearest = np.array((narrow.box(a), narrow.box(b))), narrow.signed_distance(a, b)
        if nearest is None:
            return False
        # What may stand between them is in the box around both, cut to their common heights.
        low, high = boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)
        low[2], high[2] = boxes[:, 2].max(), boxes[:, 5].min()
        others = narrow.shapes_in(low, high, (a, b))
        return _is_in_sight(narrow.shapes_of(a), narrow.shapes_of(b), others, nearest)

    # -- what carries what, and rests on what -------------------------------------------------

    def supports(self, a: int, b: int) -> bool | None:
        """Checks whether a carries b, alone or together with others; see `is_carried_by`."""
        if not self._are_known(a, b):
            return None
        normals = self._contact_normals(a, b) if self._are_two_with_shapes(a, b) else []
        if not normals:
            return False
        others = (other for other in self._neighbours.get(b, ()) if other != a)
        return is_carried_by(
            normals, chain.from_iterable(self._contact_normals(other, b) for other in others)
        )

    def _contact_normals(self, a: int, b: int) -> list[Point]:
        self._narrow.count_compared((pair_number(a, b),))
        return self._narrow.contact_normals(a, b)

    @cached_property
    def _neighbours(self) -> dict[int, list[int]]:
        """The known entities that may touch each entity."""
        neighbours: dict[int, list[int]] = {}
        for a, b in self._pairs(RESTING_DISTANCE):
            if self._are_known(a, b):
                neighbours.setdefault(a, []).append(b)
                neighbours.setdefault(b, []).append(a)
        return neighbours

    def rests_on(self, a: int, b: int) -> bool | None:
        """Checks whether b is on a, or on something that rests on a."""
        if a == b:
            return False
        if not self._are_known(a, b):
            return None
        return b in self._resting_on(a)

    def all_resting(self) -> list[tuple[int, int]]:
        """Returns all pairs of which the second rests on the first."""
        return [(a, b) for a in self._on for b in self._resting_on(a) if a != b]

    def _resting_on(self, a: int) -> frozenset[int]:
        """Returns the entities that rest on an entity, directly or through others."""
        if a not in self._resting:
            resting: set[int] = set()
            pending = [a]
            while pending:
                new = self._on.get(pending.pop(), frozenset()) - resting
                resting |= new
                pending += new
            self._resting[a] = frozenset(resting)
        return self._resting[a]

    @cached_property
    def _on(self) -> dict[int, frozenset[int]]:
        """The entities that are directly on each entity."""
        on: dict[int, set[int]] = {}
        for a, b in self._on_pairs():
            on.setdefault(a, set()).add(b)
        return {a: frozenset(b) for a, b in on.items()}

    # -- of two -------------------------------------------------------------------------------

    def _are_known(self, a: int, b: int) -> bool:
        return self._narrow.is_known(a) and self._narrow.is_known(b)

    def _are_two_with_shapes(self, a: int, b: int) -> bool:
        narrow = self._narrow
        return a != b and not (narrow.is_without_shapes(a) or narrow.is_without_shapes(b))


# -- enclosed -----------------------------------------------------------------------------------


# A cup, a, from the side. Rays from the centre of b hit it at both ends of two axes: the one shown
# from left to right, and the one into the picture. A tray hits b's rays only below.
#
#     |    ^    |
#     |<-- b -->|
#     |____v____|
def _is_walled_in(
    a: Sequence[PlacedSolid], axes: Array, b: Sequence[PlacedSolid], centre: Array
) -> bool:
    """Checks whether rays from a point hit shapes on both sides along two axes or more."""
    directions = np.concatenate((axes, -axes))
    is_hit = np.zeros(len(directions), dtype=bool)
    for shape in a:
        if not _may_be_hit(shape, axes, centre):
            continue
        start = (centre - shape.position) @ shape.matrix
        fractions = first_hits(shape.solid, start, directions @ shape.matrix)
        is_hit |= np.isfinite(fractions) & (fractions > HIT_TOLERANCE)
    has_walls = is_hit[:3] & is_hit[3:]
    if has_walls.sum() < MIN_WALLED_AXES:
        return False
    # An axis along which b extends beyond a at both ends does not count: a ring is no wall of the
    # long stick in it.
    has_walls &= ~(
        (_support_heights(b, directions) - _support_heights(a, directions)).reshape(2, 3)
        > MAX_PROTRUSION
    ).all(axis=0)
    return bool(has_walls.sum() >= MIN_WALLED_AXES)


def _may_be_hit(shape: PlacedSolid, axes: Array, centre: Array) -> bool:
    """Checks whether a line along an axis through a point hits the bounding sphere of a shape."""
    # With d from the point to the centre, a line along the unit vector u passes it at the distance
    # sqrt(|d|² - (u·d)²); |d|² is the sum of the three (u·d)².
    offsets = axes @ (np.array(shape.to_world(*shape.solid.centre)) - centre)
    squared_distances = offsets @ offsets - offsets * offsets
    return bool((squared_distances <= (shape.solid.bounding_radius + HIT_TOLERANCE) ** 2).any())


def _support_heights(shapes: Sequence[PlacedSolid], directions: Array) -> Array:
    """Returns the support heights of shapes in unit directions (n, 3), m from the origin, (n,)."""
    heights = [
        np.full(len(directions), math.inf)
        if shape.solid.type == "plane"
        else shape.support_heights(directions) + shape.solid.radius
        for shape in shapes
    ]
    highest: Array = np.max(heights, axis=0)
    return highest


# -- beside -------------------------------------------------------------------------------------


def _is_in_sight(
    a: Sequence[PlacedSolid],
    b: Sequence[PlacedSolid],
    others: Sequence[PlacedSolid],
    nearest: SignedDistance,
) -> bool:
    """Checks whether a horizontal ray from a or b hits the other before anything else."""
    return any(
        _is_clear(_line_starts(a, b, direction, nearest), direction, a, b, others)
        for direction in _horizontal_directions(a, b, nearest)
    )


def _horizontal_directions(
    a: Sequence[PlacedSolid], b: Sequence[PlacedSolid], nearest: SignedDistance
) -> list[Array]:
    """Returns horizontal unit directions from a to b."""
    axes = np.concatenate((np.eye(3), -np.eye(3)))
    heights_a, heights_b = _support_heights(a, axes), _support_heights(b, axes)
    between_centres = (heights_b[:3] - heights_b[3:] - heights_a[:3] + heights_a[3:]) / 2
    between_points = np.subtract(nearest.point_b, nearest.point_a)
    if nearest.normal is not None and nearest.distance <= HIT_TOLERANCE:  # they touch or overlap
        between_points = -np.array(nearest.normal)
    directions = []
    for direction in (between_points, between_centres):
        length = math.hypot(direction[0], direction[1])
        if length > MIN_HORIZONTAL * float(np.linalg.norm(direction)):
            directions.append(np.array([direction[0] / length, direction[1] / length, 0.0]))
    return directions


def _line_starts(
    a: Sequence[PlacedSolid], b: Sequence[PlacedSolid], direction: Array, nearest: SignedDistance
) -> Array:
    """Returns the starts of lines in a direction, over the common breadth and height, (n, 3)."""
    across = np.array([-direction[1], direction[0], 0.0])
    axes = np.stack((direction, across, [0.0, 0.0, 1.0]))
    heights = np.stack(
        [_support_heights(shapes, np.concatenate((axes, -axes))) for shapes in (a, b)]
    )
    high, low = heights[:, :3].min(axis=0), (-heights[:, 3:]).max(axis=0)
    begin = float((-heights[:, 3]).min()) - 1.0  # 1 m before both
    places = [
        (low[1] + s * (high[1] - low[1]), low[2] + t * (high[2] - low[2]))
        for s in LINE_FRACTIONS
        for t in LINE_FRACTIONS
        if high[1] >= low[1]  # else they have no common breadth
    ]
    midpoint = (np.array(nearest.point_a) + nearest.point_b) / 2
    for point in (nearest.point_a, nearest.point_b, midpoint):
        height = min(max(point[2], low[2]), high[2])
        places.append((float(across @ point), height))
    starts = [begin * direction + y * across + np.array([0.0, 0.0, z]) for y, z in places]
    return np.array(starts)


def _is_clear(
    starts: Array,
    direction: Array,
    a: Sequence[PlacedSolid],
    b: Sequence[PlacedSolid],
    others: Sequence[PlacedSolid],
) -> bool:
    """Checks whether nothing is between a and b on one of the lines."""
    lines = starts, np.repeat(direction[None], len(starts), axis=0)
    intervals_a, intervals_b = _line_intervals(*lines, a), _line_intervals(*lines, b)
    if not any(p and q for p, q in zip(intervals_a, intervals_b, strict=True)):
        return False
    between = _line_intervals(*lines, others)
    return any(
        _is_free(p, q, blocks)
        for p_all, q_all, blocks in zip(intervals_a, intervals_b, between, strict=True)
        for p in p_all
        for q in q_all
    )


# The intervals of a line in a, in b, and in something that blocks it:
#
#     |==a==|         |==b==|
#          near       far
#              |===|
#          enter   leave
def _is_free(p: _Interval, q: _Interval, blocks: Sequence[_Interval]) -> bool:
    """Checks whether none of some intervals of a line is between two others."""
    (_, near), (far, _) = sorted((p, q))
    return far <= near + HIT_TOLERANCE or not any(
        leave > near + HIT_TOLERANCE and enter < far - HIT_TOLERANCE for enter, leave in blocks
    )


def _line_intervals(
    starts: Array, directions: Array, shapes: Sequence[PlacedSolid]
) -> list[list[_Interval]]:
    """Returns the intervals of each line in shapes, m; a crossing of a triangle is a point."""
    intervals: list[list[_Interval]] = [[] for _ in starts]
    for shape in shapes:
        local_starts = (starts - shape.position) @ shape.matrix
        local_directions = directions @ shape.matrix
        if is_triangle_surface(shape.solid):
            fractions = crossings(shape.solid, local_starts, local_directions)
            for line, triangle in np.argwhere(np.isfinite(fractions)).tolist():
                intervals[line].append((float(fractions[line, triangle]),) * 2)
            continue
        chords = ray_chords(shape.solid, local_starts, local_directions)
        for line in np.flatnonzero(chords.enter <= chords.leave).tolist():
            intervals[line].append((float(chords.enter[line]), float(chords.leave[line])))
    return intervals
