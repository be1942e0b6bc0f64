"""Decides for many pairs of convex shapes at once whether their contact normal points up.

The contact normal of two shapes is the direction of least overlap: that in which the difference of
the shapes, the set of all `a - b`, extends least from the origin. Whether it is near up needs no
more than bounds of the overlaps near up, and of those in all other directions.

The directions are divided into triangles on the unit sphere. The overlap at a direction is that of
a support point of the difference, and bounds the least overlap from above. The support points of a
triangle's corners are points of the difference, so that they bound the overlaps in the triangle
from below. A triangle whose bound is above the least overlap found has no contact normal in it. The
others are divided, until all that are left agree. Most pairs are decided before, since one of the
points is far above in all upward directions. Every verdict is proved, with more room than rounding
errors and the tolerances of `ssduck.geometry.distance` need.

Overlaps change by no more than the points of the shapes move relative to each other. A verdict
therefore holds until they have moved by half of what the overlaps of the other directions exceed
the least one by.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.proofs.columns import column_lengths, unit_columns
from ssduck.geometry.proofs.cores import PlacedCores
from ssduck.geometry.proofs.gjk import tolerances
from ssduck.geometry.proofs.kept_parts import KeptParts, Parts
from ssduck.geometry.proofs.kept_verdicts import pair_keys
from ssduck.geometry.proofs.verdicts import UNDECIDED, Decisions

UPWARD, NOT_UPWARD = 1, -1
# Overlaps that differ by less, metres, may be that of the contact normal.
_ROOM = 2e-6
# Heights of normals that are nearer to the least one are not decided here.
HEIGHT_ROOM = 1e-9
# The number of times that triangles are divided, and the greatest number of triangles of a pair.
_MAX_DIVISIONS = 12
_MAX_TRIANGLES = 96
# The number of triangles of all pairs that are bounded at a time, so that they stay in the cache.
_TRIANGLES_AT_ONCE = 1 << 15
# Edges are divided where the support point changes, but not near their ends.
_MIN_FRACTION = 0.25
_EACH, _NEXT, _LAST = np.array([0, 1, 2]), np.array([1, 2, 0]), np.array([2, 0, 1])


# -- triangles of directions --------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Mesh:
    """Directions, and the triangles of which they are the corners.

    Attributes:
        directions: (3, m), unit vectors.
        corners: (3, k), the places of the corners of each triangle.
        stretch: (k,), see `_stretch`.
        classes: (k,), which directions may be in the triangle.
    """

    directions: Array
    corners: Indices
    stretch: Array
    classes: Indices


@lru_cache(maxsize=8)
def _mesh(min_height: float) -> _Mesh:
    """Returns triangles all around; the directions of the least height separate some of them."""
    from scipy.spatial import ConvexHull

    tilt = math.acos(min_height)
    step = (math.pi - tilt) / round((math.pi - tilt) / math.radians(37.0))
    tilts = [0.0, tilt / 2, *np.arange(tilt, math.pi + 1e-9, step).tolist()]
    rings = []
    for row, angle in enumerate(tilts):
        count = max(1, round(2.0 * math.pi * math.sin(angle) / math.radians(34.0)))
        turns = 2.0 * math.pi * (np.arange(count) + row % 2 / 2) / count
        height = np.full(count, math.cos(angle))
        rings.append(math.sin(angle) * np.stack((np.cos(turns), np.sin(turns), 0.0 * turns)))
        rings[-1][2] = height
    directions = np.concatenate(rings, axis=1)
    corners = ConvexHull(directions.T).simplices.T
    vectors = directions[:, corners].transpose(1, 0, 2)
    stretch = _stretch(vectors)
    return _Mesh(directions, corners, stretch, _classes(vectors[:, 2], stretch, min_height))


def _stretch(corners: Array) -> Array:
    """Returns the greatest sum of weights of corners (3, 3, n) whose combination has length 1."""
    edges = corners[1:] - corners[0]
    normals = _cross(edges[:1], edges[1:])[0]
    volumes = np.abs(np.einsum("cn,cn->n", corners[0], normals))
    stretch: Array = column_lengths(normals) / np.maximum(volumes, 1e-300)
    return stretch


def _classes(heights: Array, stretch: Array, min_height: float) -> Indices:
    """Returns which directions may be in triangles: those above a height, others, or both.

    Args:
        heights: (3, n), those of the corners.
        stretch: (n,), that of the triangles.
        min_height: the least height of upward directions, not negative.
    """
    highest = heights.max(axis=0)
    upward = highest * np.where(highest > 0.0, stretch, 1.0) >= min_height - HEIGHT_ROOM
    other = heights.min(axis=0) <= min_height + HEIGHT_ROOM
    classes: Indices = upward * _UPWARD_ONLY + other * _OTHER_ONLY
    return classes


# Which directions may be in a triangle: upward ones, others, or both.
_UPWARD_ONLY, _OTHER_ONLY, _BOTH = 1, 2, 3


@dataclass(frozen=True, eq=False)
class _Triangles:
    """Triangles of directions of several pairs.

    Attributes:
        owners: (n,), the pair of each.
        faces: (n,), the triangle of the mesh of which it is a part; `~face` for a whole one.
        classes: (n,), which directions may be in it.
        numbers: (31, n), all other properties.
    """

    owners: Indices
    faces: Indices
    classes: Indices
    numbers: Array

    @classmethod
    def of_parts(
        cls, owners: Indices, faces: Indices, numbers: Array, min_height: float
    ) -> _Triangles:
        """Returns parts of triangles, of which only corners and points are written in `numbers`."""
        corners, points = numbers[:9].reshape(3, 3, -1), numbers[9:18].reshape(3, 3, -1)
        products = np.einsum("kcn,icn->kin", points, corners)
        stretch = _stretch(corners)
        numbers[30], numbers[27:30] = _bounds(products, stretch)
        numbers[18:27] = products.reshape(9, -1)
        return cls(owners, faces, _classes(corners[:, 2], stretch, min_height), numbers)

    @property
    def corners(self) -> Array:
        """The directions at the corners, (3, 3, n): (corner, axis, triangle)."""
        return self.numbers[:9].reshape(3, 3, -1)

    @property
    def points(self) -> Array:
        """The support points of the pair's difference in these directions, (3, 3, n)."""
        return self.numbers[9:18].reshape(3, 3, -1)

    @property
    def products(self) -> Array:
        """The products of points and directions, (3, 3, n): (point, corner, triangle)."""
        return self.numbers[18:27].reshape(3, 3, -1)

    @property
    def facets(self) -> Array:
        """The weights of the corners for the direction of the facet, (3, n); see `_bounds`."""
        return self.numbers[27:30]

    @property
    def bounds(self) -> Array:
        """Lower bounds of the overlaps in the triangles, (n,), metres."""
        bounds: Array = self.numbers[30]
        return bounds

    def select(self, places: Indices) -> _Triangles:
        """Returns the selected triangles."""
        return _Triangles(
            self.owners[places],
            self.faces[places],
            self.classes[places],
            self.numbers.take(places, axis=1),
        )

    def joined(self, other: _Triangles) -> _Triangles:
        """Returns the triangles of both."""
        return _Triangles(
            np.concatenate((self.owners, other.owners)),
            np.concatenate((self.faces, other.faces)),
            np.concatenate((self.classes, other.classes)),
            np.concatenate((self.numbers, other.numbers), axis=1),
        )


def _bounds(products: Array, stretch: Array) -> tuple[Array, Array]:
    """Returns lower bounds of overlaps in triangles, and the directions of facets.

    The overlap at a direction is at least the product of the direction with any mean of the support
    points. Its least product in the triangle is at a corner. The best mean is that of a matrix
    game: one of the points, or the mean whose products with the corners are equal.

    Args:
        products: (3, 3, n), of support points and corners (point, corner, triangle).
        stretch: (n,), that of the triangles.

    Returns:
        The bounds, (n,); and the weights (3, n) of the corners whose sum is normal to the plane
        through the three points. They have a meaning if all are positive.
    """
    crossed = _cross(products[_NEXT], products[_LAST])
    weights, facets = crossed.sum(axis=1), crossed.sum(axis=0)
    total = weights.sum(axis=0)
    weights = np.maximum(np.copysign(weights, weights * total), 0.0)
    total = weights.sum(axis=0)
    weights /= np.where(total > 0.0, total, 1.0)
    mixed = (weights[:, None] * products).sum(axis=0).min(axis=0)
    mixed[~(total > 0.0)] = -math.inf
    bounds = np.maximum(products.min(axis=1).max(axis=0), mixed)
    bounds *= np.where(bounds < 0.0, stretch, 1.0)
    return bounds, np.copysign(facets, facets * facets.sum(axis=0))


# -- pairs --------------------------------------------------------------------------------------


def contact_room(cores: PlacedCores, first: Indices, second: Indices) -> Array:
    """Returns how much overlaps may exceed that of the contact normal, (n,), metres."""
    room: Array = _ROOM + 2.0 * tolerances(cores, first, second)
    return room


@dataclass(eq=False)
class _Differences:
    """The differences of pairs of shapes, and the least overlaps that were found.

    Attributes:
        cores: the shapes.
        first: (n,), the first shapes.
        second: (n,), the second shapes.
        offsets: (3, n), from the centres of the second to those of the first.
        room: (n,), see `contact_room`.
        least: (n,), the least overlaps that were found, metres.
        heights: (n,), the heights of their directions.
    """

    cores: PlacedCores
    first: Indices
    second: Indices
    offsets: Array
    room: Array
    least: Array
    heights: Array

    @classmethod
    def of(cls, cores: PlacedCores, first: Indices, second: Indices) -> _Differences:
        """Returns the differences of pairs, for which no overlap was found yet."""
        offsets = cores.centres.take(first, axis=1) - cores.centres.take(second, axis=1)
        least, heights = np.full(len(first), math.inf), np.zeros(len(first))
        room = contact_room(cores, first, second)
        return cls(cores, first, second, offsets, room, least, heights)

    def select(self, places: Indices) -> _Differences:
        """Returns the selected pairs."""
        return _Differences(
            self.cores,
            self.first[places],
            self.second[places],
            self.offsets.take(places, axis=1),
            self.room[places],
            self.least[places],
            self.heights[places],
        )

    def __len__(self) -> int:
        return len(self.first)

    @property
    def limits(self) -> Array:
        """The overlaps above which a direction is not the contact normal, (n,), metres."""
        limits: Array = self.least + self.room
        return limits

    def points_all_around(self, directions: Array) -> Array:
        """Returns the support points of all pairs in directions (3, m), (3, m, n)."""
        points = self.cores.support_points_all_around(self.first, directions)
        points -= self.cores.support_points_all_around(self.second, -directions)
        points += self.offsets[:, None]
        overlaps = np.einsum("cmn,cm->mn", points, directions)
        best = overlaps.argmin(axis=0)
        self.least, self.heights = overlaps[best, np.arange(len(self))], directions[2, best]
        return points

    def points(self, owners: Indices, directions: Array) -> Array:
        """Returns the support points (3, n) of pairs in unit directions (3, n)."""
        shapes = np.concatenate((self.first[owners], self.second[owners]))
        count = len(owners)
        both = self.cores.support_points(shapes, np.concatenate((directions, -directions), axis=1))
        points: Array = both[:, :count] - both[:, count:]
        points += self.offsets.take(owners, axis=1)
        overlaps = np.einsum("cn,cn->n", points, directions)
        less = np.flatnonzero(overlaps < self.least[owners])
        # The last one that is written for a pair is the least.
        less = less[np.argsort(-overlaps[less], kind="stable")]
        self.least[owners[less]] = overlaps[less]
        self.heights[owners[less]] = directions[2, less]
        return points


def decide_upward(
    cores: PlacedCores,
    first: Indices,
    second: Indices,
    min_height: float,
    kept: KeptParts | None = None,
) -> Decisions:
    """Decides whether contact normals point up: `UPWARD`, `NOT_UPWARD` or `UNDECIDED`.

    Args:
        cores: the shapes.
        first: (n,), bounded convex shapes.
        second: (n,), the same; normals point from the first to the second.
        min_height: the least z of an upward unit normal, from 0 to 1.
        kept: how directions were divided at the tick before, for the same height.
    """
    mesh = _mesh(min_height)
    decisions = Decisions.none(len(first))
    step = max(1, _TRIANGLES_AT_ONCE // len(mesh.stretch))
    for start in range(0, len(first), step):
        batch = slice(start, start + step)
        pairs = _Differences.of(cores, first[batch], second[batch])
        points = pairs.points_all_around(mesh.directions)
        upward = points.compress(mesh.directions[2] >= min_height - HEIGHT_ROOM, axis=1)
        above = _upward_bounds(upward, min_height - HEIGHT_ROOM) - pairs.limits
        decisions.part(batch).decide(above > 0.0, NOT_UPWARD, above[above > 0.0] / 2.0)
        left = np.flatnonzero(~(above > 0.0))
        if len(left):
            some = pairs.select(left)
            found = _classified(some, points.take(left, axis=2), mesh, min_height, kept)
            decisions.decide(start + left, found.verdicts, found.room)
    return decisions


def _upward_bounds(points: Array, min_height: float) -> Array:
    """Returns lower bounds of the overlaps in upward directions, (n,), metres.

    The overlap at a direction is at least the product of the direction with any of the points. Of
    all directions of a least height, that with the least product leans away from the point.

    Args:
        points: (3, m, n), points of the differences of pairs.
        min_height: the least height of upward directions, not negative.
    """
    x, y, z = points
    products = z * min_height - np.sqrt((x * x + y * y) * (1.0 - min_height * min_height))
    products[z < 0.0] = -math.inf
    bounds: Array = products.max(axis=0)
    return bounds


def _classified(
    pairs: _Differences, points: Array, mesh: _Mesh, min_height: float, kept: KeptParts | None
) -> Decisions:
    """Decides pairs, whose support points in the directions of a mesh are given."""
    keys = pair_keys(pairs.first, pairs.second)
    parts = None if kept is None else kept.find(keys)
    triangles, least = _initial_triangles(pairs, points, mesh, parts, min_height)
    decisions, count = Decisions.none(len(pairs)), len(pairs)
    done: list[_Triangles] = []
    divisions = 0
    while True:
        is_left = triangles.bounds <= pairs.limits[triangles.owners]
        places, excluded = np.flatnonzero(is_left), np.flatnonzero(~is_left)
        groups = 4 * triangles.owners + triangles.classes
        np.minimum.at(least.reshape(-1), groups[excluded], triangles.bounds[excluded])
        owners, classes = triangles.owners[places], triangles.classes[places]
        counts = np.bincount(groups[places], minlength=4 * count).reshape(count, 4)
        upward, other = counts[:, _UPWARD_ONLY] > 0, counts[:, _OTHER_ONLY] > 0
        is_open = (upward & other) | (counts[:, _BOTH] > 0)
        for verdict, are, others in ((UPWARD, upward, _OTHER_ONLY), (NOT_UPWARD, other, _UPWARD_ONLY)):
            decided = np.flatnonzero(are & ~is_open & (decisions.verdicts == UNDECIDED))
            above = np.minimum(least[decided, others], least[decided, _BOTH])
            decisions.decide(decided, verdict, (above - pairs.limits[decided]) / 2.0)
        is_open &= counts.sum(axis=1) <= _MAX_TRIANGLES
        if divisions == _MAX_DIVISIONS:
            is_open[:] = False
        is_left &= is_open[triangles.owners]
        done.append(triangles.select(np.flatnonzero(~is_left & (triangles.faces >= 0))))
        if not is_open.any():
            break
        divisions += 1
        # Those that contradict the best direction are divided.
        contradicted = np.where(pairs.heights >= min_height, _OTHER_ONLY, _UPWARD_ONLY)
        is_divided = (classes & contradicted[owners] > 0) & is_open[owners]
        divided = _divided(triangles.select(places[is_divided]), pairs, min_height)
        triangles = triangles.select(places[~is_divided & is_open[owners]]).joined(divided)
    if kept is not None:
        kept.keep(keys, _parts(done))
    return decisions


def _parts(triangles: Sequence[_Triangles]) -> Parts:
    return Parts(
        np.concatenate([some.owners for some in triangles]),
        np.concatenate([some.faces for some in triangles]),
        np.concatenate([some.numbers[:9] for some in triangles], axis=1),
    )


def _initial_triangles(
    pairs: _Differences, points: Array, mesh: _Mesh, parts: Parts | None, min_height: float
) -> tuple[_Triangles, Array]:
    """Returns the triangles of a mesh that may contain the contact normals of pairs.

    Known parts of triangles take their place.

    Returns:
        The triangles, and the least bounds of the others of each pair and class, (pairs, 4), metres.
    """
    directions, corners = mesh.directions, mesh.corners
    count, size = directions.shape[1], len(pairs)
    products = np.matmul(directions.T, points.swapaxes(0, 1))  # (point, direction, pair)
    places = corners[:, None] * count + corners  # (corner's point, corner, triangle)
    products = products.reshape(-1, size).take(places.ravel(), axis=0).reshape(3, 3, -1)
    bounds = products.min(axis=1).max(axis=0)
    stretch = np.repeat(mesh.stretch, size)
    bounds *= np.where(bounds < 0.0, stretch, 1.0)
    if parts is not None:
        numbers = np.zeros((31, len(parts.owners)))
        numbers[:9] = parts.corners
        at_parts = parts.corners.reshape(3, 3, -1).swapaxes(0, 1).reshape(3, -1)
        found = pairs.points(np.tile(parts.owners, 3), at_parts)
        numbers[9:18].reshape(3, 3, -1)[:] = found.reshape(3, 3, -1).swapaxes(0, 1)
        known = _Triangles.of_parts(parts.owners, parts.faces, numbers, min_height)
        bounds[parts.faces * size + parts.owners] = math.inf
    is_kept = bounds <= np.tile(pairs.limits, len(mesh.stretch))
    excluded = np.where(is_kept, math.inf, bounds).reshape(-1, size)
    least = np.full((size, 4), math.inf)
    for kind in (_UPWARD_ONLY, _OTHER_ONLY, _BOTH):
        least[:, kind] = excluded[mesh.classes == kind].min(axis=0, initial=math.inf)
    kept = np.flatnonzero(is_kept)
    faces, owners = np.divmod(kept, size)
    products = products[..., kept]
    bounds, facets = _bounds(products, stretch[kept])
    at_corners = directions[:, corners[:, faces]].transpose(1, 0, 2)
    kept_points = points[:, corners[:, faces], owners].transpose(1, 0, 2)
    vectors = np.concatenate((at_corners, kept_points, products)).reshape(27, -1)
    numbers = np.concatenate((vectors, facets, bounds[None]))
    triangles = _Triangles(owners, ~faces, mesh.classes[faces], numbers)
    if parts is not None:
        triangles = triangles.joined(known)
    # The facet of the least bound has a direction of less overlap than the corners.
    lowest = np.lexsort((triangles.bounds, triangles.owners))
    lowest = lowest[np.diff(triangles.owners[lowest], prepend=-1) > 0]
    best = triangles.select(lowest)
    pairs.points(best.owners, _facet_directions(best.corners, best.facets))
    return triangles, least


def _facet_directions(corners: Array, weights: Array) -> Array:
    """Returns the unit normals of the facets of triangles (3, 3, n), or their middles, (3, n)."""
    weights = np.where(weights.min(axis=0) > 0.0, weights, 1.0)
    weights /= weights.max(axis=0)
    return unit_columns((weights[:, None] * corners).sum(axis=0))


def _divided(triangles: _Triangles, pairs: _Differences, min_height: float) -> _Triangles:
    """Returns the four parts of each triangle, with a new corner on each edge."""
    corners, products, count = triangles.corners, triangles.products, len(triangles.owners)
    # Along the edge from each corner to the next one: where their points are equally far.
    own = products[_EACH, _EACH]
    rise, fall = own - products[_NEXT, _EACH], own[_NEXT] - products[_EACH, _NEXT]
    total = rise + fall
    fraction = np.where(total > 0.0, rise / np.where(total > 0.0, total, 1.0), 0.5)
    fraction = np.clip(fraction, _MIN_FRACTION, 1.0 - _MIN_FRACTION)[:, None]
    middles = corners + fraction * (corners[_NEXT] - corners)
    middles /= np.sqrt((middles * middles).sum(axis=1))[:, None]
    facets = _facet_directions(corners, triangles.facets)
    new = pairs.points(np.tile(triangles.owners, 4), np.concatenate((*middles, facets), axis=1))
    new_points = new[:, : 3 * count].reshape(3, 3, count).swapaxes(0, 1)
    numbers = np.zeros((31, 4 * count))
    # (corner or point, corner of the part, axis, part, triangle)
    parts = numbers[:18].reshape(2, 3, 3, 4, count)
    for place, old, middle in ((0, corners, middles), (1, triangles.points, new_points)):
        parts[place, 0, :, :3] = old.swapaxes(0, 1)
        parts[place, 1, :, :3] = middle.swapaxes(0, 1)
        parts[place, 2, :, :3] = middle[_LAST].swapaxes(0, 1)
        parts[place, :, :, 3] = middle
    owners = np.tile(triangles.owners, 4)
    faces = np.tile(np.maximum(triangles.faces, ~triangles.faces), 4)
    divided = _Triangles.of_parts(owners, faces, numbers, min_height)
    np.maximum(numbers[30], np.tile(triangles.bounds, 4), out=numbers[30])
    return divided


def _cross(first: Array, second: Array) -> Array:
    """Returns the cross products of vectors (k, 3, n)."""
    crossed: Array = first[:, _NEXT] * second[:, _LAST]
    crossed -= first[:, _LAST] * second[:, _NEXT]
    return crossed
