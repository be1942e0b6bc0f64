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
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices, column_lengths, selected, unit_columns
from ssduck.geometry.proofs.cores import PlacedCores
from ssduck.geometry.proofs.gjk import tolerances
from ssduck.geometry.proofs.verdicts import UNDECIDED, Decisions

# -- triangles of directions --------------------------------------------------------------------

# Heights of normals that are nearer to the least one are not decided here.
HEIGHT_ROOM = 1e-9
NEXT, LAST = np.array([1, 2, 0]), np.array([2, 0, 1])
# Which directions may be in a triangle: upward ones, others, or both.
UPWARD_ONLY, OTHER_ONLY, BOTH = 1, 2, 3


@dataclass(frozen=True, eq=False)
class Mesh:
    """Directions, and the triangles of which they are the corners.

    Attributes:
        directions: (3, m), unit vectors.
        corners: (3, k), the places of the corners of each triangle.
        stretch: (k,), see `stretch_of`.
        classes: (k,), which directions may be in the triangle.
    """

    directions: Array
    corners: Indices
    stretch: Array
    classes: Indices


@lru_cache(maxsize=8)
def mesh_of(min_height: float) -> Mesh:
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
    stretch = stretch_of(vectors)
    return Mesh(directions, corners, stretch, classes_of(vectors[:, 2], stretch, min_height))


def stretch_of(corners: Array) -> Array:
    """Returns the greatest sum of weights of corners (3, 3, n) whose combination has length 1."""
    edges = corners[1:] - corners[0]
    normals = _cross(edges[:1], edges[1:])[0]
    volumes = np.abs(np.einsum("cn,cn->n", corners[0], normals))
    stretch: Array = column_lengths(normals) / np.maximum(volumes, 1e-300)
    return stretch


def classes_of(heights: Array, stretch: Array, min_height: float) -> Indices:
    """Returns which directions may be in triangles: those above a height, others, or both."""
    highest = heights.max(axis=0)
    upward = highest * np.where(highest > 0.0, stretch, 1.0) >= min_height - HEIGHT_ROOM
    other = heights.min(axis=0) <= min_height + HEIGHT_ROOM
    classes: Indices = upward * UPWARD_ONLY + other * OTHER_ONLY
    return classes


@dataclass(frozen=True, eq=False)
class Triangles:
    """Triangles of directions of several pairs."""

    owners: Indices  # (n,), the pair of each
    classes: Indices  # (n,), which directions may be in it
    corners: Array  # (3, 3, n), the directions at the corners: (corner, axis, triangle)
    points: Array  # (3, 3, n), the support points of the pair's difference in these directions
    products: Array  # (3, 3, n), of points and directions: (point, corner, triangle)
    stretch: Array  # (n,), the greatest sum of weights of corners whose combination has length 1
    bounds: Array  # (n,), lower bounds of the overlaps in the triangles, metres
    facets: Array  # (3, n), the weights of the corners for the direction of the facet

    def joined(self, other: Triangles) -> Triangles:
        """Returns the triangles of both."""
        parts = zip(vars(self).values(), vars(other).values(), strict=True)
        return Triangles(*(np.concatenate(part, axis=-1) for part in parts))


def bounds_of(products: Array, stretch: Array) -> tuple[Array, Array]:
    """Returns lower bounds of overlaps in triangles, and the directions of facets.

    The overlap at a direction is at least the product of the direction with any mean of the support
    points. Its least product in the triangle is at a corner. The best mean is that of a matrix
    game: one of the points, or the mean whose products with the corners are equal.
    """
    crossed = _cross(products[NEXT], products[LAST])
    weights, facets = crossed.sum(axis=1), crossed.sum(axis=0)
    total = weights.sum(axis=0)
    weights = np.maximum(np.copysign(weights, weights * total), 0.0)
    total = weights.sum(axis=0)
    weights /= np.where(total > 0.0, total, 1.0)
    mixed = (weights[:, None] * products).sum(axis=0).min(axis=0)
    mixed[~(total > 0.0)] = -math.inf
    mixed *= np.where(mixed < 0.0, stretch, 1.0)
    bounds = np.maximum(corner_bounds(products, stretch), mixed)
    return bounds, np.copysign(facets, facets * facets.sum(axis=0))


def corner_bounds(products: Array, stretch: Array) -> Array:
    """Returns lower bounds of overlaps in triangles, by one of their points; see `bounds_of`."""
    bounds: Array = products.min(axis=1).max(axis=0)
    bounds *= np.where(bounds < 0.0, stretch, 1.0)
    return bounds


def facet_directions(corners: Array, weights: Array) -> Array:
    """Returns the unit normals of the facets of triangles (3, 3, n), or their middles, (3, n)."""
    weights = np.where(weights.min(axis=0) > 0.0, weights, 1.0)
    weights /= weights.max(axis=0)
    return unit_columns((weights[:, None] * corners).sum(axis=0))


def _cross(first: Array, second: Array) -> Array:
    """Returns the cross products of vectors (k, 3, n)."""
    crossed: Array = first[:, NEXT] * second[:, LAST]
    crossed -= first[:, LAST] * second[:, NEXT]
    return crossed


# -- contact normals ------------------------------------------------------------------------------

UPWARD, NOT_UPWARD = 1, -1
# Overlaps that differ by less, metres, may be that of the contact normal.
_ROOM = 2e-6
# The number of times that triangles are divided, and the greatest number of triangles of a pair.
_MAX_DIVISIONS = 12
_MAX_TRIANGLES = 96
# The number of triangles of all pairs that are bounded at a time, so that they stay in the cache.
_TRIANGLES_AT_ONCE = 1 << 15
# Edges are divided where the support point changes, but not near their ends.
_MIN_FRACTION = 0.25
_EACH = np.array([0, 1, 2])


def contact_room(cores: PlacedCores, first: Indices, second: Indices) -> Array:
    """Returns how much overlaps may exceed that of the contact normal, (n,), metres."""
    room: Array = _ROOM + 2.0 * tolerances(cores, first, second)
    return room


@dataclass(eq=False)
class _Differences:
    """The differences of pairs of shapes, and the least overlaps that were found."""

    cores: PlacedCores  # the shapes
    first: Indices  # (n,), the first shapes
    second: Indices  # (n,), the second shapes
    offsets: Array  # (3, n), from the centres of the second to those of the first
    room: Array  # (n,), see `contact_room`
    least: Array  # (n,), the least overlaps that were found, metres
    best: Array  # (3, n), their directions

    @classmethod
    def of(cls, cores: PlacedCores, first: Indices, second: Indices) -> _Differences:
        """Returns the differences of pairs, for which no overlap was found yet."""
        offsets = cores.centres.take(first, axis=1) - cores.centres.take(second, axis=1)
        least, best = np.full(len(first), math.inf), np.zeros((3, len(first)))
        room = contact_room(cores, first, second)
        return cls(cores, first, second, offsets, room, least, best)

    def __len__(self) -> int:
        return len(self.first)

    @property
    def limits(self) -> Array:
        """The overlaps above which a direction is not the contact normal, (n,), metres."""
        limits: Array = self.least + self.room
        return limits

    def points_all_around(self, directions: Array) -> Array:
        """Returns the support points of all pairs in directions (3, m), (3, m, n)."""
        count, pairs = directions.shape[1], len(self)
        unique, places = np.unique(np.concatenate((self.first, self.second)), return_inverse=True)
        both = np.concatenate((directions, -directions), axis=1)
        supports = self.cores.support_points_all_around(unique, both)
        points = supports[:, :count].take(places[:pairs], axis=2)
        points -= supports[:, count:].take(places[pairs:], axis=2)
        points += self.offsets[:, None]
        overlaps = np.einsum("cmn,cm->mn", points, directions)
        best = overlaps.argmin(axis=0)
        least = overlaps[best, np.arange(pairs)]
        self.best, self.least = directions.take(best, axis=1), least
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
        self.best[:, owners[less]] = directions.take(less, axis=1)
        return points


def decide_upward(
    cores: PlacedCores, first: Indices, second: Indices, min_height: float
) -> Decisions:
    """Decides whether contact normals point up: `UPWARD`, `NOT_UPWARD` or `UNDECIDED`."""
    mesh = mesh_of(min_height)
    decisions = Decisions.none(len(first))
    step = max(1, _TRIANGLES_AT_ONCE // len(mesh.stretch))
    for start in range(0, len(first), step):
        batch = slice(start, start + step)
        pairs = _Differences.of(cores, first[batch], second[batch])
        _decide_pairs(pairs, decisions.part(batch), mesh, min_height)
    return decisions


def _decide_pairs(pairs: _Differences, decisions: Decisions, mesh: Mesh, min_height: float) -> None:
    """Decides pairs by directions all around, then by triangles, which are divided."""
    points = pairs.points_all_around(mesh.directions)
    upward = np.flatnonzero(mesh.directions[2] >= min_height - HEIGHT_ROOM)
    bounds = _upward_bounds(points.take(upward, axis=1), min_height - HEIGHT_ROOM)
    above = bounds.max(axis=0) - pairs.limits
    is_above = above > 0.0
    decisions.decide(is_above, NOT_UPWARD, above[is_above] / 2.0)
    left = np.flatnonzero(~is_above)
    if len(left):
        found = _classified(selected(pairs, left), points.take(left, axis=2), mesh, min_height)
        decisions.decide(left, found.verdicts, found.room)


def _upward_bounds(points: Array, min_height: float) -> Array:
    """Returns lower bounds of the overlaps in upward directions by each point, (…), metres."""
    x, y, z = points
    products = z * min_height - np.sqrt((x * x + y * y) * (1.0 - min_height * min_height))
    products[z < 0.0] = -math.inf
    return np.asarray(products)


def _classified(pairs: _Differences, points: Array, mesh: Mesh, min_height: float) -> Decisions:
    """Decides pairs, whose support points in the directions of a mesh are given."""
    least = np.full((len(pairs), 4), math.inf)
    triangles = _mesh_triangles(pairs, points, mesh, least)
    decisions = Decisions.none(len(pairs))
    for division in range(_MAX_DIVISIONS + 1):
        is_left = triangles.bounds <= pairs.limits[triangles.owners]
        is_open = _decide(decisions, pairs, triangles, is_left, least)
        if division == _MAX_DIVISIONS or not is_open.any():
            break
        is_left &= is_open[triangles.owners]
        # Those that contradict the best direction are divided.
        contradicted = np.where(pairs.best[2] >= min_height, OTHER_ONLY, UPWARD_ONLY)
        is_divided = is_left & (triangles.classes & contradicted[triangles.owners] > 0)
        divided = _divided(selected(triangles, np.flatnonzero(is_divided)), pairs, min_height)
        triangles = selected(triangles, np.flatnonzero(is_left & ~is_divided)).joined(divided)
    return decisions


def _decide(
    decisions: Decisions, pairs: _Differences, triangles: Triangles, is_left: Flags, least: Array
) -> Flags:
    """Decides the pairs whose triangles that are left agree."""
    groups = 4 * triangles.owners + triangles.classes
    excluded = np.flatnonzero(~is_left)
    np.minimum.at(least.reshape(-1), groups[excluded], triangles.bounds[excluded])
    counts = np.bincount(groups[is_left], minlength=4 * len(pairs)).reshape(-1, 4)
    upward, other = counts[:, UPWARD_ONLY] > 0, counts[:, OTHER_ONLY] > 0
    is_open = (upward & other) | (counts[:, BOTH] > 0)
    is_new = ~is_open & (decisions.verdicts == UNDECIDED)
    for verdict, are, others in ((UPWARD, upward, OTHER_ONLY), (NOT_UPWARD, other, UPWARD_ONLY)):
        decided = np.flatnonzero(are & is_new)
        above = np.minimum(least[decided, others], least[decided, BOTH])
        decisions.decide(decided, verdict, (above - pairs.limits[decided]) / 2.0)
    is_open &= counts.sum(axis=1) <= _MAX_TRIANGLES
    return is_open


def _mesh_triangles(pairs: _Differences, points: Array, mesh: Mesh, least: Array) -> Triangles:
    """Returns the triangles of a mesh that may contain the contact normals of pairs."""
    directions, corners = mesh.directions, mesh.corners
    count, size = directions.shape[1], len(pairs)
    products = np.matmul(directions.T, points.swapaxes(0, 1))  # (point, direction, pair)
    places = corners[:, None] * count + corners  # (corner's point, corner, triangle)
    products = products.reshape(-1, size).take(places.ravel(), axis=0).reshape(3, 3, -1)
    stretch = np.repeat(mesh.stretch, size)
    bounds = corner_bounds(products, stretch)
    is_left = bounds <= np.tile(pairs.limits, len(mesh.stretch))
    excluded = np.where(is_left, math.inf, bounds).reshape(-1, size)
    for kind in (UPWARD_ONLY, OTHER_ONLY, BOTH):
        found = excluded[mesh.classes == kind].min(axis=0, initial=math.inf)
        least[:, kind] = np.minimum(least[:, kind], found)
    left = np.flatnonzero(is_left)
    faces, owners = np.divmod(left, size)
    at_corners = directions[:, corners[:, faces]].swapaxes(0, 1)
    points = points[:, corners[:, faces], owners].swapaxes(0, 1)
    parts = mesh.classes[faces], at_corners, points, products[..., left], stretch[left]
    return Triangles(owners, *parts, *bounds_of(*parts[-2:]))


def _divided(triangles: Triangles, pairs: _Differences, min_height: float) -> Triangles:
    """Returns the four parts of each triangle, with a new corner on each edge."""
    corners, products, count = triangles.corners, triangles.products, len(triangles.owners)
    # Along the edge from each corner to the next one: where their points are equally far.
    own = products[_EACH, _EACH]
    rise, fall = own - products[NEXT, _EACH], own[NEXT] - products[_EACH, NEXT]
    total = rise + fall
    fraction = np.where(total > 0.0, rise / np.where(total > 0.0, total, 1.0), 0.5)
    fraction = np.clip(fraction, _MIN_FRACTION, 1.0 - _MIN_FRACTION)[:, None]
    middles = corners + fraction * (corners[NEXT] - corners)
    middles /= np.sqrt((middles * middles).sum(axis=1))[:, None]
    facets = facet_directions(corners, triangles.facets)
    new = pairs.points(np.tile(triangles.owners, 4), np.concatenate((*middles, facets), axis=1))
    new_points = new[:, : 3 * count].reshape(3, 3, count).swapaxes(0, 1)
    vectors = np.zeros((18, 4 * count))
    # (corner or point, corner of the part, axis, part, triangle)
    parts = vectors.reshape(2, 3, 3, 4, count)
    for place, old, middle in ((0, corners, middles), (1, triangles.points, new_points)):
        parts[place, 0, :, :3] = old.swapaxes(0, 1)
        parts[place, 1, :, :3] = middle.swapaxes(0, 1)
        parts[place, 2, :, :3] = middle[LAST].swapaxes(0, 1)
        parts[place, :, :, 3] = middle
    corners, points = vectors.reshape(2, 3, 3, 4 * count)
    products = np.einsum("kcn,icn->kin", points, corners)
    stretch = stretch_of(corners)
    classes = classes_of(corners[:, 2], stretch, min_height)
    owners = np.tile(triangles.owners, 4)
    bounds, facets = bounds_of(products, stretch)
    bounds = np.maximum(bounds, np.tile(triangles.bounds, 4))
    return Triangles(owners, classes, corners, points, products, stretch, bounds, facets)
