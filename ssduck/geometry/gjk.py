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
import numpy.typing as npt

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.distance import CONTACT_TOLERANCE, CYLINDER_TOLERANCE
from ssduck.geometry.solids import Solid

Verdicts: TypeAlias = npt.NDArray[np.int8]

BELOW, ABOVE, UNDECIDED = 1, -1, 0
# Polytopes need few steps; the steps towards a cylinder's rim get smaller and smaller.
MAX_STEPS = 40
# The number of times that a tetrahedron is moved around the origin.
MAX_MOVES = 12
# The number of pairs that are compared at a time, so that their arrays stay in the cache.
PAIRS_AT_ONCE = 4096
# Cubes of larger lengths and distances, metres, overflow: nothing is decided.
LARGE = 1e100
# The number of points that are compared at a time.
MAX_POINTS = 1 << 20
_NEXT = np.array([1, 2, 0])
# Four directions that are parallel to no axis. The offsets of directions from normals, in turn.
_OBLIQUE_DIRECTIONS = np.array(
    [[1.0, 0.9, 0.8], [-0.9, -0.8, 1.0], [-0.8, 1.0, -0.9], [0.9, -1.0, -0.8]]
)
_DEVIATIONS = np.array([[0, 0, 0], [0.27, 0.11, 0.4], [0, 0, 0], [-0.4, -0.27, -0.11]])
# The faces of a tetrahedron of points 0..3; face i is opposite to point i.
_FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])


class ConvexCores:
    """The convex hulls of solids' cores, relative to the centres of the solids.

    A core is the sum of a box with half extents (a point for a sphere, a segment for a capsule or a
    cylinder) and a disc across z, or it is the hull of points. A half-space is represented by a
    point without a meaning.

    Args:
        solids: the distinct solids.
        solid_indices: (n,), the index of each shape's solid.
    """

    def __init__(self, solids: Sequence[Solid], solid_indices: Indices) -> None:
        self.half_extents = (
            np.array([_half_extents(solid) for solid in solids]).reshape(-1, 3).T[:, solid_indices]
        )
        self.disc_radius = np.array([solid.disc_radius for solid in solids])[solid_indices]
        self.radius = np.array([solid.radius for solid in solids])[solid_indices]
        radii = [
            solid.bounding_radius if np.isfinite(solid.bounding_radius) else 0.0 for solid in solids
        ]
        self.bounding_radius = np.array(radii)[solid_indices]
        self.is_thick = np.array([solid.inscribed_radius > 0.0 for solid in solids], dtype=bool)[
            solid_indices
        ]
        # The radius of the ball in the core: a part of a round solid's ball is around its core.
        self.core_ball_radius = np.array(
            [solid.inscribed_radius - solid.radius for solid in solids]
        )[solid_indices]
        hulls = {n: _corners(solid) for n, solid in enumerate(solids) if _has_corners(solid)}
        sizes = {n: _padded_size(len(points)) for n, points in hulls.items()}
        kinds, rows = np.full(len(solids), -1), np.zeros(len(solids), np.intp)
        self.points: list[Array] = []
        for kind, size in enumerate(sorted(set(sizes.values()))):
            numbers = [n for n in hulls if sizes[n] == size]
            kinds[numbers], rows[numbers] = kind, np.arange(len(numbers))
            self.points.append(np.array([_pad(hulls[n], size) for n in numbers]))
        self.kind, self.row = kinds[solid_indices], rows[solid_indices]


def _half_extents(solid: Solid) -> Array:
    if solid.type in ("box", "capsule", "cylinder") and len(solid.core):
        extents: Array = solid.core.max(axis=0)
        return extents
    return np.zeros(3)


def _has_corners(solid: Solid) -> bool:
    return solid.type in ("hull", "mesh") and len(solid.core) > 0


def _corners(solid: Solid) -> Array:
    points = solid.hull_corners if solid.type == "mesh" else solid.core
    relative: Array = points - np.array(solid.centre)
    return relative


def _pad(points: Array, count: int) -> Array:
    """Returns points as (3, count), with the last point repeated."""
    return np.ascontiguousarray(points[np.minimum(np.arange(count), len(points) - 1)].T)


@dataclass(frozen=True, eq=False)
class PlacedCores:
    """Cores at poses.

    Attributes:
        cores: the cores in their own frames.
        rotations: (9, n), their rotation matrices, row by row.
        centres: (3, n), the centres of the solids in the world, metres.
        inscribed_centres: (3, n), the centres of the balls in them, metres.
    """

    cores: ConvexCores
    rotations: Array
    centres: Array
    inscribed_centres: Array

    def balls(self, first: Indices, second: Indices) -> tuple[Flags, Array, Array]:
        """Returns balls in differences of cores: if one is known, its centre (3, m), radius."""
        cores, inscribed_centres = self.cores, self.inscribed_centres
        is_known = cores.is_thick.take(first) & cores.is_thick.take(second)
        centre = inscribed_centres.take(first, axis=1) - inscribed_centres.take(second, axis=1)
        radius = cores.core_ball_radius.take(first) + cores.core_ball_radius.take(second)
        return is_known, centre, radius

    def support_points(self, shapes: Indices, directions: Array) -> Array:
        """Returns the support points (3, m) of cores, relative to their centres, in world axes.

        Args:
            shapes: (m,), the indices of the shapes.
            directions: (3, m), directions that are not 0; their lengths do not matter.
        """
        cores, rotations = self.cores, self.rotations.take(shapes, axis=1)
        x, y, z = directions
        local = rotations[0:3] * x
        local += rotations[3:6] * y
        local += rotations[6:9] * z
        points = np.copysign(cores.half_extents.take(shapes, axis=1), local)
        disc = cores.disc_radius.take(shapes)
        if disc.any():
            length = np.maximum(np.sqrt(local[0] * local[0] + local[1] * local[1]), 1e-300)
            points[:2] += local[:2] * (disc / length)
        kinds = cores.kind.take(shapes)
        for kind, hulls in enumerate(cores.points):
            selected = np.flatnonzero(kinds == kind)
            if len(selected):
                points[:, selected] = _hull_support_points(
                    hulls, cores.row[shapes[selected]], local[:, selected]
                )
        in_world: Array = rotations[0::3] * points[0]
        in_world += rotations[1::3] * points[1]
        in_world += rotations[2::3] * points[2]
        return in_world


def _hull_support_points(hulls: Array, rows: Indices, directions: Array) -> Array:
    """Returns support points (3, m) of the hulls `rows` of (h, 3, k), in directions (3, m)."""
    support_points = np.zeros((3, len(rows)))
    step = max(1, MAX_POINTS // hulls.shape[2])
    for start in range(0, len(rows), step):
        batch = slice(start, start + step)
        points = hulls.take(rows[batch], axis=0)
        heights = np.matmul(directions[:, batch].T[:, None], points)[:, 0]
        support_points[:, batch] = points[np.arange(len(points)), :, heights.argmax(axis=1)].T
    return support_points


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
        """Returns the support points of the differences in directions (3, n)."""
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
    verdicts = np.zeros(len(first), np.int8)
    bounds = np.broadcast_to(np.asarray(bound, dtype=np.float64), first.shape)
    for start in range(0, len(first), PAIRS_AT_ONCE):
        batch = slice(start, start + PAIRS_AT_ONCE)
        pairs = _initial_pairs(bodies, first[batch], second[batch], bounds[batch])
        _decide(pairs, bodies, verdicts[batch])
    return verdicts


def tolerances(bodies: PlacedCores, first: Indices, second: Indices) -> Array:
    """Returns the distances from the bound, metres, within which pairs stay undecided."""
    cores, centres = bodies.cores, bodies.centres
    is_round = (cores.disc_radius[first] > 0.0) | (cores.disc_radius[second] > 0.0)
    largest = np.abs(centres).max(axis=0, initial=0.0)
    largest_of_pair = np.maximum(largest[first], largest[second])
    size = cores.bounding_radius[first] + cores.bounding_radius[second]
    error: Array = (
        np.where(is_round, 2.5 * CYLINDER_TOLERANCE, 2.5 * CONTACT_TOLERANCE)
        + 4e-12 * size
        + 4e-15 * largest_of_pair
    )
    error[np.maximum(largest_of_pair, size) > LARGE] = np.inf
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


def _decide(pairs: _Pairs, bodies: PlacedCores, verdicts: Verdicts) -> None:
    """Writes the verdicts of pairs, by their indices."""
    pairs = _first_step(pairs, bodies, verdicts)
    on_origin = []
    for step in range(MAX_STEPS):
        if not len(pairs.number):
            break
        pairs, shallow = _step(pairs, bodies, verdicts, step)
        on_origin += [shallow] if shallow else []
    if on_origin:
        surrounding = _concatenate([pairs for pairs, _ in on_origin])
        corners = np.concatenate([corners for _, corners in on_origin], axis=-1)
        _move_tetrahedra(surrounding, corners, bodies, verdicts)
        undecided = surrounding.select(np.flatnonzero(verdicts[surrounding.number] == UNDECIDED))
        if len(undecided.number):
            _move_tetrahedra(undecided, _tetrahedron(undecided, bodies), bodies, verdicts)


def _first_step(pairs: _Pairs, bodies: PlacedCores, verdicts: Verdicts) -> _Pairs:
    """Steps from the difference of the centres, which separates most pairs that are apart.

    For many overlapping pairs, the origin is in a ball between the known ball in the difference and
    the support point. The others continue from there.
    """
    directions = pairs.between.copy()
    length = _length(directions)
    directions[0, length == 0.0] = 1.0
    new = pairs.difference_points(bodies, -directions)
    is_apart = _dots(directions, new) > pairs.high * np.where(length == 0.0, 1.0, length)
    verdicts[pairs.number[is_apart]] = ABOVE
    has_ball, centre, radius = bodies.balls(pairs.first, pairs.second)
    centre = np.where(has_ball, centre, new)
    edges = new - centre
    fraction = np.clip(-_dots(centre, edges) / np.maximum(_dots(edges, edges), 1e-300), 0.0, 1.0)
    nearest = centre + fraction * edges
    upper_bound = _length(nearest)
    is_below = upper_bound - np.where(has_ball, (1.0 - fraction) * radius, 0.0) < pairs.low
    verdicts[pairs.number[is_below]] = BELOW
    pairs = replace(
        pairs, simplex=np.array((new, centre, centre)), nearest=nearest, upper_bound=upper_bound
    )
    return pairs.select(np.flatnonzero(~(is_apart | is_below)))


_SurroundingPairs: TypeAlias = tuple[_Pairs, Array]


def _step(
    pairs: _Pairs, bodies: PlacedCores, verdicts: Verdicts, step: int
) -> tuple[_Pairs, _SurroundingPairs | None]:
    """Takes a step with each pair.

    Returns:
        The pairs that are undecided and can go on, and those whose tetrahedron (4, 3, n) contains
        the origin without deciding them.
    """
    new = pairs.difference_points(bodies, -pairs.nearest)
    height = _dots(pairs.nearest, new)
    is_apart = height > pairs.high * pairs.upper_bound
    verdicts[pairs.number[is_apart]] = ABOVE
    # A point that is as far away as its plane is the nearest one.
    remaining = np.flatnonzero(~is_apart & (height < pairs.upper_bound * pairs.upper_bound))
    pairs, new = pairs.select(remaining), new[:, remaining]
    corners = np.concatenate((pairs.simplex, new[None]))
    simplex, nearest = _closest(pairs.simplex, new)
    upper_bound = _length(nearest)
    # The first step has no four points.
    depth = _depths(corners)[0].min(axis=0) if step else np.full(len(remaining), -1.0)
    is_below = np.where(depth > 0.0, -depth, upper_bound) < pairs.low
    verdicts[pairs.number[is_below]] = BELOW
    is_on_origin = (depth > 0.0) | (upper_bound <= 1e-13 * np.abs(corners).max(axis=(0, 1)))
    shallow = np.flatnonzero(is_on_origin & ~is_below)
    on_origin = (pairs.select(shallow), corners[:, :, shallow]) if len(shallow) else None
    undecided = np.flatnonzero(~(is_below | is_on_origin) & (upper_bound < pairs.upper_bound))
    pairs = replace(pairs, simplex=simplex, nearest=nearest, upper_bound=upper_bound)
    return pairs.select(undecided), on_origin


def _closest(simplex: Array, new: Array) -> tuple[Array, Array]:
    """Returns the point nearest to the origin on the three faces at a tetrahedron's newest corner.

    The fourth face is no nearer. Corners may be equal.

    Args:
        simplex: (3, 3, n), the older corners (point, axis, pair).
        new: (3, n), the newest corner.

    Returns:
        The corners of the point's face, (3, 3, n), the newest first; the point, (3, n).
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
    corners = np.array((new, simplex[face, :, rows].T, simplex[_NEXT[face], :, rows].T))
    return corners, points[best, :, rows].T


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
    """
    for move in range(MAX_MOVES):
        depths, normals = _depths(corners)
        rows = np.arange(len(pairs.number))
        directions = _unit(normals[_nearest_face(depths, normals), :, rows].T)
        directions += _DEVIATIONS[move % len(_DEVIATIONS)][:, None]
        new = pairs.difference_points(bodies, directions)
        is_above = -_dots(directions, new) > pairs.high * _length(directions)
        verdicts[pairs.number[is_above]] = ABOVE
        moved, depth = _replace_corner(corners, new)
        is_below = ~is_above & (-depth < pairs.low)
        verdicts[pairs.number[is_below]] = BELOW
        undecided = np.flatnonzero(~(is_above | is_below))
        if not len(undecided):
            return
        pairs, corners = pairs.select(undecided), moved[:, :, undecided]


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


def _replace_corner(corners: Array, new: Array) -> tuple[Array, Array]:
    """Returns the tetrahedra in which a new corner leaves the origin deepest, and its depth."""
    rows = np.arange(new.shape[1])
    choices = np.repeat(corners[None], 4, axis=0)
    choices[np.arange(4), np.arange(4)] = new
    all_choices = choices.transpose(1, 2, 0, 3).reshape(4, 3, -1)
    depths = _depths(all_choices)[0].min(axis=0).reshape(4, -1)
    best = depths.argmax(axis=0)
    return choices[best, :, :, rows].transpose(1, 2, 0), depths[best, rows]


def _length(vectors: Array) -> Array:
    length: Array = np.sqrt(np.einsum("cn,cn->n", vectors, vectors))
    return length


def _unit(vectors: Array) -> Array:
    unit: Array = vectors / np.maximum(_length(vectors), 1e-300)
    return unit


def _dots(first: Array, second: Array) -> Array:
    dots: Array = np.einsum("cn,cn->n", first, second)
    return dots


def _cross(first: Array, second: Array) -> Array:
    """Returns cross products of (m, 3, n), along the second axis."""
    a, b, c = first[:, 0], first[:, 1], first[:, 2]
    x, y, z = second[:, 0], second[:, 1], second[:, 2]
    return np.stack((b * z - c * y, c * x - a * z, a * y - b * x), axis=1)


def _padded_size(count: int) -> int:
    """Returns the padded number of points: a power of two from 8 up, so that few sizes occur."""
    return 1 << max(3, (count - 1).bit_length())
