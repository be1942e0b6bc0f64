"""Decides for many pairs of convex shapes whether their signed distance is below a bound.

The algorithm is that of Gilbert, Johnson and Keerthi (1988) in the form of van den Bergen (A Fast
and Robust GJK Implementation, 1999). It works on the difference of two cores: the set of all `a -
b`. It holds up to four points of the difference, and the point v of their hull that is nearest to
the origin; the support point of the difference against v is the next point. All pairs take a step
together. Decided pairs are left out of the next step.

Every verdict is proved:

* The difference is beyond a plane across v, so that the distance is at least that of the plane
  from the origin. This holds for any direction, however inaccurate v is.
* v is in the difference, so that the distance is at most its length.
* Between a ball in the difference and a point of it lie smaller balls in the difference. The depth
  is at least the depth of the origin in one of them.
* If the origin is inside the tetrahedron of four points, the depth is at least the radius of the
  ball around the origin in it.

Pairs that rounding errors could decide stay undecided: touching shapes, and flat differences.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.proofs.columns import column_lengths, unit_columns
from ssduck.geometry.proofs.cores import PlacedCores
from ssduck.geometry.proofs.verdicts import ABOVE, BELOW, UNDECIDED, Decisions, Verdicts

# Polytopes need few steps; the steps towards a cylinder's rim get smaller and smaller.
MAX_STEPS = 40
# The number of times that a tetrahedron is moved around the origin.
MAX_MOVES = 12
# The number of pairs that are compared at a time, so that their arrays stay in the cache.
PAIRS_AT_ONCE = 4096
_NEXT = np.array([1, 2, 0])
# Four directions that are parallel to no axis. The offsets of directions from normals, in turn.
_OBLIQUE_DIRECTIONS = np.array(
    [[1.0, 0.9, 0.8], [-0.9, -0.8, 1.0], [-0.8, 1.0, -0.9], [0.9, -1.0, -0.8]]
)
_DEVIATIONS = np.array([[0, 0, 0], [0.27, 0.11, 0.4], [0, 0, 0], [-0.4, -0.27, -0.11]])
# The faces of a tetrahedron of points 0..3; face i is opposite to point i.
_FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])


# -- the pairs that are not decided yet --------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Pairs of shapes, and the state of the algorithm for the difference of each.

    Attributes:
        number: (n,), the index of the pair in the request.
        first, second: (n,), the shapes.
        between: (3, n), from the centre of the second to that of the first.
        low, high: (n,): distances of the cores above `high` are above the bound, those below `low`
            below it.
        simplex: (3, 3, n): three points (point, axis, pair) of the difference.
        nearest: (3, n), a point of their hull.
        upper_bound: (n,), its distance from the origin.
    """

    number: Indices
    first: Indices
    second: Indices
    between: Array
    low: Array
    high: Array
    simplex: Array
    nearest: Array
    upper_bound: Array

    def select(self, indices: Indices) -> _Pairs:
        """Returns the selected pairs."""
        return _Pairs(*(getattr(self, name).take(indices, axis=-1) for name in _FIELDS))

    def difference_points(self, bodies: PlacedCores, directions: Array) -> Array:
        """Returns the support points (3, n) of the differences in directions (3, n)."""
        count = len(self.first)
        both = np.concatenate((self.first, self.second))
        points = bodies.support_points(both, np.concatenate((directions, -directions), axis=1))
        points_of_difference: Array = points[:, :count] - points[:, count:]
        points_of_difference += self.between
        return points_of_difference


_FIELDS = tuple(_Pairs.__dataclass_fields__)


def _concatenate(parts: Sequence[_Pairs]) -> _Pairs:
    fields = (np.concatenate([getattr(p, name) for p in parts], axis=-1) for name in _FIELDS)
    return _Pairs(*fields)


def classify_gaps(
    bodies: PlacedCores, first: Indices, second: Indices, bound: float | Array
) -> Verdicts:
    """Classifies the signed distances of convex shapes as BELOW a bound, ABOVE it, or UNDECIDED.

    The signed distance is that of `ssduck.geometry.distance`: minus the depth of shapes that
    overlap. A verdict allows for the errors of that module, so that both always agree.

    Args:
        bodies: the cores.
        first: (n,), indices of shapes.
        second: (n,), indices of shapes. For the hull of a shape that is not convex, only ABOVE
            holds for the shape.
        bound: metres, for all pairs or (n,) for each.
    """
    return decide_gaps(bodies, first, second, bound).verdicts


def decide_gaps(
    bodies: PlacedCores,
    first: Indices,
    second: Indices,
    bound: float | Array,
    directions: Array | None = None,
) -> Decisions:
    """Returns the same verdicts as `classify_gaps`, with the room of those that took one step.

    Args:
        bodies: see `classify_gaps`.
        first: see there.
        second: see there.
        bound: see there.
        directions: (3, n), from the second shapes to the first, to try first; 0 for those of the
            centres.
    """
    decisions = Decisions.none(len(first))
    bounds = np.broadcast_to(np.asarray(bound, dtype=np.float64), first.shape)
    for start in range(0, len(first), PAIRS_AT_ONCE):
        batch = slice(start, start + PAIRS_AT_ONCE)
        part = decisions.part(batch)
        pairs = _initial_pairs(bodies, first[batch], second[batch], bounds[batch])
        tried = pairs.between.copy()
        if directions is not None:
            is_given = directions[:, batch].any(axis=0)
            np.copyto(tried, directions[:, batch], where=is_given)
        _decide(_first_step(pairs, tried, bodies, part), bodies, part)
    return decisions


def tolerances(bodies: PlacedCores, first: Indices, second: Indices) -> Array:
    """Returns the distances from the bound, metres, within which pairs stay undecided."""
    least, growing = bodies.error_terms
    error: Array = np.maximum(least.take(first), least.take(second))
    error += growing.take(first)
    error += growing.take(second)
    return error


def _initial_pairs(bodies: PlacedCores, first: Indices, second: Indices, bounds: Array) -> _Pairs:
    cores = bodies.cores
    between = bodies.centres[:, first] - bodies.centres[:, second]
    error = tolerances(bodies, first, second)
    core_bound = bounds + cores.radius[first] + cores.radius[second]
    count = len(first)
    return _Pairs(
        np.arange(count),
        first,
        second,
        between,
        core_bound - error,
        core_bound + error,
        np.zeros((3, 3, count)),
        between,
        np.full(count, np.inf),
    )


# -- steps -------------------------------------------------------------------------------------


def _decide(pairs: _Pairs, bodies: PlacedCores, decisions: Decisions) -> None:
    """Decides pairs after their first step, by their indices."""
    on_origin = []
    for _ in range(MAX_STEPS):
        if not len(pairs.number):
            break
        pairs, shallow = _step(pairs, bodies, decisions)
        on_origin += [shallow] if shallow else []
    if on_origin:
        surrounding = _concatenate([pairs for pairs, _ in on_origin])
        corners = np.concatenate([corners for _, corners in on_origin], axis=-1)
        verdicts = decisions.verdicts
        _move_tetrahedra(surrounding, corners, bodies, verdicts)
        undecided = surrounding.select(np.flatnonzero(verdicts[surrounding.number] == UNDECIDED))
        if len(undecided.number):
            _move_tetrahedra(undecided, _tetrahedron(undecided, bodies), bodies, verdicts)


def _first_step(
    pairs: _Pairs, directions: Array, bodies: PlacedCores, decisions: Decisions
) -> _Pairs:
    """Steps against directions; that of the centres separates most pairs that are apart.

    For many overlapping pairs, the origin is in a ball between the known ball in the difference and
    the support point. The others continue from there.
    """
    length = column_lengths(directions)
    directions[0, length == 0.0] = 1.0
    new = pairs.difference_points(bodies, -directions)
    room = _dots(directions, new) / np.where(length == 0.0, 1.0, length) - pairs.high
    is_apart = room > 0.0
    decisions.decide(pairs.number[is_apart], ABOVE, room[is_apart])
    has_ball, centre, radius = bodies.balls(pairs.first, pairs.second)
    centre = np.where(has_ball, centre, new)
    edges = new - centre
    fraction = np.clip(-_dots(centre, edges) / np.maximum(_dots(edges, edges), 1e-300), 0.0, 1.0)
    nearest = centre + fraction * edges
    upper_bound = column_lengths(nearest)
    room = pairs.low - upper_bound + np.where(has_ball, (1.0 - fraction) * radius, 0.0)
    is_below = (room > 0.0) & ~is_apart
    decisions.decide(pairs.number[is_below], BELOW, room[is_below])
    pairs = replace(
        pairs,
        simplex=np.array((new, centre, centre)),
        nearest=nearest,
        upper_bound=upper_bound,
    )
    return pairs.select(np.flatnonzero(~(is_apart | is_below)))


_SurroundingPairs: TypeAlias = tuple[_Pairs, Array]


def _step(
    pairs: _Pairs, bodies: PlacedCores, decisions: Decisions
) -> tuple[_Pairs, _SurroundingPairs | None]:
    """Takes a step with each pair.

    Returns:
        The pairs that are undecided and can go on, and those whose tetrahedron contains the origin
        without deciding them, with its corners, (4, 3, n).
    """
    new = pairs.difference_points(bodies, -pairs.nearest)
    height = _dots(pairs.nearest, new)
    is_origin = pairs.upper_bound == 0.0  # which is no direction
    room = height / np.where(is_origin, 1.0, pairs.upper_bound) - pairs.high
    is_apart = (room > 0.0) & ~is_origin
    decisions.decide(pairs.number[is_apart], ABOVE, room[is_apart])
    # A point that is as far away as its plane is the nearest one.
    remaining = np.flatnonzero(~is_apart & (height < pairs.upper_bound * pairs.upper_bound))
    pairs, new = pairs.select(remaining), new[:, remaining]
    corners = np.concatenate((pairs.simplex, new[None]))
    simplex, nearest = _closest(pairs.simplex, new)
    upper_bound = column_lengths(nearest)
    depth = _depths(corners)[0].min(axis=0)
    room = pairs.low - np.where(depth > 0.0, -depth, upper_bound)
    is_below = room > 0.0
    decisions.decide(pairs.number[is_below], BELOW, room[is_below])
    is_on_origin = (depth > 0.0) | (upper_bound <= 1e-13 * np.abs(corners).max(axis=(0, 1)))
    shallow = np.flatnonzero(is_on_origin & ~is_below)
    on_origin = None
    if len(shallow):
        on_origin = pairs.select(shallow), corners[..., shallow]
    undecided = np.flatnonzero(~(is_below | is_on_origin) & (upper_bound < pairs.upper_bound))
    moved = replace(pairs, simplex=simplex, nearest=nearest, upper_bound=upper_bound)
    return moved.select(undecided), on_origin


def _closest(simplex: Array, new: Array) -> tuple[Array, Array]:
    """Returns the point nearest to the origin on the three faces at a tetrahedron's newest corner.

    The fourth face is no nearer. Corners may be equal.

    Args:
        simplex: (3, 3, n), the older corners (point, axis, pair).
        new: (3, n), the newest corner.

    Returns:
        The corners of the point's face, the newest first, (3, 3, n); the point, (3, n).
    """
    edges = simplex - new
    after = edges[_NEXT]
    squares = np.einsum("ecn,ecn->en", edges, edges)
    products = np.einsum("ecn,ecn->en", edges, after)
    ahead = -np.einsum("cn,ecn->en", new, edges)
    # On the edges, and in the faces by the normal equations; a point outside a face is on an edge.
    fraction = np.clip(ahead / np.maximum(squares, 1e-300), 0.0, 1.0)
    on_edges = new + fraction[:, None] * edges
    area = squares * squares[_NEXT] - products * products
    has_area = area > 1e-14 * squares * squares[_NEXT]
    area = np.where(has_area, area, 1.0)
    first = (ahead * squares[_NEXT] - ahead[_NEXT] * products) / area
    second = (ahead[_NEXT] * squares - ahead * products) / area
    has_area &= (first > 0.0) & (second > 0.0) & (first + second < 1.0)
    in_faces = new + first[:, None] * edges + second[:, None] * after
    points = np.concatenate((on_edges, in_faces))
    squared_distances = np.einsum("ecn,ecn->en", points, points)
    squared_distances[3:][~has_area] = np.inf
    best, rows = squared_distances.argmin(axis=0), np.arange(new.shape[1])
    face = best % 3
    nearest_face = np.array((new, simplex[face, :, rows].T, simplex[_NEXT[face], :, rows].T))
    return nearest_face, points[best, :, rows].T


def _depths(corners: Array) -> tuple[Array, Array]:
    """Returns the depths of the origin below the faces of tetrahedra, less the rounding error.

    Negative for faces that the origin is beyond, and for all faces of a flat tetrahedron.

    Args:
        corners: (4, 3, n).

    Returns:
        The depths, and the outward normals (4, 3, n), not of unit length.
    """
    first, second, third = (corners[_FACES[:, k]] for k in range(3))
    normals = _cross(second - first, third - first)
    volume = np.einsum("fcn,fcn->fn", normals, corners - first)
    normals *= np.where(volume > 0.0, -1.0, 1.0)[:, None]
    length = np.maximum(np.sqrt(np.einsum("fcn,fcn->fn", normals, normals)), 1e-300)
    heights = np.einsum("fcn,fcn->fn", normals, first) / length
    cube = np.abs(corners).max(axis=(0, 1)) ** 3
    is_flat = np.abs(volume).min(axis=0) <= 1e-12 * cube
    return np.where(is_flat, -np.inf, heights - 1e-13 * cube / length), normals


def _move_tetrahedra(
    pairs: _Pairs, corners: Array, bodies: PlacedCores, verdicts: Verdicts
) -> None:
    """Decides pairs whose tetrahedra contain the origin, by the face nearest to it.

    Either the difference ends at the face, or its support point beyond the face replaces the corner
    that leaves the origin deepest in the tetrahedron. Every other time the direction deviates from
    the face's normal, because symmetric shapes would cycle otherwise.

    Args:
        pairs: the pairs.
        corners: (4, 3, n), the corners of the tetrahedra.
        bodies: the cores.
        verdicts: those of all pairs.
    """
    for move in range(MAX_MOVES):
        depths, normals = _depths(corners)
        rows = np.arange(len(pairs.number))
        directions = unit_columns(normals[_nearest_face(depths, normals), :, rows].T)
        directions += _DEVIATIONS[move % len(_DEVIATIONS)][:, None]
        new = pairs.difference_points(bodies, directions)
        is_above = -_dots(directions, new) > pairs.high * column_lengths(directions)
        verdicts[pairs.number[is_above]] = ABOVE
        replaced, depth = _replaced_corner(corners, new)
        moved = corners.copy()
        moved[replaced, :, rows] = new.T
        is_below = ~is_above & (-depth < pairs.low)
        verdicts[pairs.number[is_below]] = BELOW
        undecided = np.flatnonzero(~(is_above | is_below))
        if not len(undecided):
            return
        pairs, corners = pairs.select(undecided), moved[..., undecided]


def _tetrahedron(pairs: _Pairs, bodies: PlacedCores) -> Array:
    """Returns points of the differences in four directions of the first's frame, (4, 3, n)."""
    rotations = bodies.rotations.take(pairs.first, axis=1).reshape(3, 3, -1)
    directions = np.einsum("ijn,dj->din", rotations, _OBLIQUE_DIRECTIONS)
    return np.array([pairs.difference_points(bodies, direction) for direction in directions])


def _nearest_face(depths: Array, normals: Array) -> Indices:
    """Returns the face nearest to the origin; the largest face of a flat tetrahedron."""
    is_flat = ~np.isfinite(depths).all(axis=0)
    area = np.einsum("fcn,fcn->fn", normals, normals)
    faces: Indices = np.where(is_flat, area.argmax(axis=0), depths.argmin(axis=0))
    return faces


def _replaced_corner(corners: Array, new: Array) -> tuple[Indices, Array]:
    """Returns the corner (n,) whose replacement leaves the origin deepest, and that depth."""
    rows = np.arange(new.shape[1])
    choices = np.repeat(corners[None], 4, axis=0)
    choices[np.arange(4), np.arange(4)] = new
    all_choices = choices.transpose(1, 2, 0, 3).reshape(4, 3, -1)
    depths = _depths(all_choices)[0].min(axis=0).reshape(4, -1)
    best = depths.argmax(axis=0)
    return best, depths[best, rows]


def _dots(first: Array, second: Array) -> Array:
    dots: Array = np.einsum("cn,cn->n", first, second)
    return dots


def _cross(first: Array, second: Array) -> Array:
    """Returns cross products of (m, 3, n), along the second axis."""
    a, b, c = first[:, 0], first[:, 1], first[:, 2]
    x, y, z = second[:, 0], second[:, 1], second[:, 2]
    return np.stack((b * z - c * y, c * x - a * z, a * y - b * x), axis=1)
