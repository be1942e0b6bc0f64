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

    .-------.|
    | a - b  s . . . . . O   s: the support point of a - b towards the origin O, against v;
    '-------'|               nothing of a - b is beyond the plane through s

Pairs that rounding errors could decide stay undecided, and so do shallow overlaps whose
tetrahedron does not prove them: a comparison by itself decides these few.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ssduck.geometry.arrays import Array, Indices, column_lengths, selected
from ssduck.geometry.proofs.cores import PlacedCores
from ssduck.geometry.proofs.verdicts import ABOVE, BELOW, Decisions

# Polytopes need few steps; the steps towards a cylinder's rim get smaller and smaller.
MAX_STEPS = 40
# The number of pairs that are compared at a time, so that their arrays stay in the cache.
PAIRS_AT_ONCE = 4096
_NEXT = np.array([1, 2, 0])
# The faces of a tetrahedron of points 0..3; face i is opposite to point i.
_FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])


# -- the pairs that are not decided yet --------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Pairs of shapes, and the state of the algorithm for the difference of each."""

    number: Indices  # (n,), the index of the pair in the request
    first: Indices  # (n,), the shapes
    second: Indices  # (n,), the shapes
    between: Array  # (3, n), from the centre of the second to that of the first
    low: Array  # (n,)
    high: Array  # (n,)
    simplex: Array  # (3, 3, n): three points (point, axis, pair) of the difference
    nearest: Array  # (3, n), a point of their hull
    upper_bound: Array  # (n,), its distance from the origin

    def difference_points(self, bodies: PlacedCores, directions: Array) -> Array:
        """Returns the support points (3, n) of the differences in directions (3, n)."""
        count = len(self.first)
        both = np.concatenate((self.first, self.second))
        points = bodies.support_points(both, np.concatenate((directions, -directions), axis=1))
        points_of_difference: Array = points[:, :count] - points[:, count:]
        points_of_difference += self.between
        return points_of_difference


def decide_gaps(
    bodies: PlacedCores,
    first: Indices,
    second: Indices,
    bounds: Array,
    directions: Array | None = None,
) -> Decisions:
    """Decides whether the signed distances of convex shapes are below bounds, each (n,), m.

    The signed distance is that of `ssduck.geometry.distance`: minus the depth of shapes that
    overlap. A verdict allows for the errors of that module, so that both always agree. It has the
    room of those that took one step, which is first against the directions, (3, n), if any.
    """
    decisions = Decisions.none(len(first))
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
    for _ in range(MAX_STEPS):
        if not len(pairs.number):
            break
        pairs = _step(pairs, bodies, decisions)


def _first_step(
    pairs: _Pairs, directions: Array, bodies: PlacedCores, decisions: Decisions
) -> _Pairs:
    """Steps against directions; that of the centres separates most pairs that are apart."""
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
    return selected(pairs, np.flatnonzero(~(is_apart | is_below)))


def _step(pairs: _Pairs, bodies: PlacedCores, decisions: Decisions) -> _Pairs:
    """Takes a step with each pair; returns those that are undecided and can go on."""
    new = pairs.difference_points(bodies, -pairs.nearest)
    height = _dots(pairs.nearest, new)
    is_origin = pairs.upper_bound == 0.0  # which is no direction
    room = height / np.where(is_origin, 1.0, pairs.upper_bound) - pairs.high
    is_apart = (room > 0.0) & ~is_origin
    decisions.decide(pairs.number[is_apart], ABOVE, room[is_apart])
    # A point that is as far away as its plane is the nearest one.
    remaining = np.flatnonzero(~is_apart & (height < pairs.upper_bound * pairs.upper_bound))
    pairs, new = selected(pairs, remaining), new[:, remaining]
    corners = np.concatenate((pairs.simplex, new[None]))
    simplex, nearest = _closest(pairs.simplex, new)
    upper_bound = column_lengths(nearest)
    depth = _depths(corners).min(axis=0)
    room = pairs.low - np.where(depth > 0.0, -depth, upper_bound)
    is_below = room > 0.0
    decisions.decide(pairs.number[is_below], BELOW, room[is_below])
    is_on_origin = (depth > 0.0) | (upper_bound <= 1e-13 * np.abs(corners).max(axis=(0, 1)))
    undecided = np.flatnonzero(~(is_below | is_on_origin) & (upper_bound < pairs.upper_bound))
    moved = replace(pairs, simplex=simplex, nearest=nearest, upper_bound=upper_bound)
    return selected(moved, undecided)


def _closest(simplex: Array, new: Array) -> tuple[Array, Array]:
    """Returns the face at the newest corner that is nearest to the origin, and the point."""
    # (3, 3, n), the newest corner first; (3, n). The fourth face is no nearer.
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


def _depths(corners: Array) -> Array:
    """Returns the depths (4, n) of the origin below the faces of tetrahedra (4, 3, n)."""
    first, second, third = (corners[_FACES[:, k]] for k in range(3))
    normals = _cross(second - first, third - first)
    volume = np.einsum("fcn,fcn->fn", normals, corners - first)
    normals *= np.where(volume > 0.0, -1.0, 1.0)[:, None]
    length = np.maximum(np.sqrt(np.einsum("fcn,fcn->fn", normals, normals)), 1e-300)
    heights = np.einsum("fcn,fcn->fn", normals, first) / length
    cube = np.abs(corners).max(axis=(0, 1)) ** 3
    is_flat = np.abs(volume).min(axis=0) <= 1e-12 * cube
    return np.where(is_flat, -np.inf, heights - 1e-13 * cube / length)


def _dots(first: Array, second: Array) -> Array:
    dots: Array = np.einsum("cn,cn->n", first, second)
    return dots


def _cross(first: Array, second: Array) -> Array:
    """Returns cross products of (m, 3, n), along the second axis."""
    a, b, c = first[:, 0], first[:, 1], first[:, 2]
    x, y, z = second[:, 0], second[:, 1], second[:, 2]
    return np.stack((b * z - c * y, c * x - a * z, a * y - b * x), axis=1)
