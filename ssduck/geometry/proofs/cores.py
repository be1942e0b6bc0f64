"""The convex cores of solids, and their support points at poses.

The support point of a shape in a direction is its farthest point that way. All that these proofs
know of a shape is where these points are: that of `a - b` in a direction is the one of a that way
less the one of b the other way. A round solid is a core that is grown by a radius.

       .--------s   ---> direction: s is farther that way than any other point
       |  core  |
       '--------'
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices, padded_columns
from ssduck.geometry.distance import CONTACT_TOLERANCE, CYLINDER_TOLERANCE
from ssduck.geometry.solids import Solid, SolidsOfShapes

# The number of points that are compared at a time.
MAX_POINTS = 1 << 20
# Cubes of larger lengths and distances, metres, overflow: nothing is decided.
LARGE = 1e100


class ConvexCores:
    """The convex hulls of solids' cores, relative to the centres of the solids.

    A core is the hull of points, or the sum of a box and an ellipsoid. The box is a point for a
    sphere and an ellipsoid, and a segment for a capsule and a cylinder; the ellipsoid is a disc
    across z for a cylinder. A half-space is represented by a point without a meaning.

    Args:
        of_each: the solids of n shapes.
    """

    def __init__(self, of_each: SolidsOfShapes) -> None:
        self.half_extents = of_each.vectors(_half_extents)
        self.semi_axes = of_each.vectors(lambda solid: solid.semi_axes)
        self.is_swept: Flags = np.asarray(self.semi_axes.any(axis=0))
        # The error of signed distances of two shapes is at least the larger of these, metres.
        self.least_error = 2.5 * np.where(self.is_swept, CYLINDER_TOLERANCE, CONTACT_TOLERANCE)
        self.largest_radius = of_each.numbers(lambda solid: solid.largest_radius)
        self.radius = of_each.numbers(lambda solid: solid.radius)
        radii = of_each.numbers(lambda solid: solid.bounding_radius)
        self.bounding_radius = np.where(np.isfinite(radii), radii, 0.0)
        inscribed_radii = of_each.numbers(lambda solid: solid.inscribed_radius)
        self.is_thick: Flags = inscribed_radii > 0.0
        # The radius of the ball in the core: a part of a round solid's ball is around its core.
        self.core_ball_radius = inscribed_radii - self.radius
        # The corners of hulls, and of the hulls of meshes, from the centres of the solids.
        hulls = {
            n: (solid.hull_corners if solid.type == "mesh" else solid.core) - solid.centre
            for n, solid in enumerate(of_each.distinct)
            if solid.type in ("hull", "mesh") and len(solid.core)
        }
        # They are padded to a power of two from 8 up, so that few sizes occur.
        sizes = {n: 1 << max(3, (len(points) - 1).bit_length()) for n, points in hulls.items()}
        count = len(of_each.distinct)
        kinds, rows = np.full(count, -1), np.zeros(count, np.intp)
        # Of each kind: the corners of its hulls, (3, hulls, size).
        self.points: list[Array] = []
        for kind, size in enumerate(sorted(set(sizes.values()))):
            numbers = [n for n in hulls if sizes[n] == size]
            kinds[numbers], rows[numbers] = kind, np.arange(len(numbers))
            corners = np.array([padded_columns(hulls[n], size) for n in numbers])
            self.points.append(np.ascontiguousarray(corners.swapaxes(0, 1)))
        self.kind, self.row = kinds[of_each.indices], rows[of_each.indices]


def _half_extents(solid: Solid) -> Array:
    if solid.type in ("box", "capsule", "cylinder") and len(solid.core):
        extents: Array = solid.core.max(axis=0)
        return extents
    return np.zeros(3)


@dataclass(frozen=True, eq=False)
class PlacedCores:
    """Cores at poses.

    Attributes:
        cores: the cores in their own frames: the first n of them, of which there may be more.
        rotations: (9, n), their rotation matrices, row by row.
        centres: (3, n), the centres of the solids in the world, metres.
        inscribed_centres: (3, n), the centres of the balls in them, metres.
    """

    cores: ConvexCores
    rotations: Array
    centres: Array
    inscribed_centres: Array

    @cached_property
    def error_terms(self) -> tuple[Array, Array]:
        """The errors of signed distances of shapes, two arrays (n,), metres.

        That of two shapes is the larger of the first, plus both of the second, which grow with the
        sizes and the distances from the origin.
        """
        largest = np.abs(self.centres).max(axis=0, initial=0.0)
        size = self.cores.bounding_radius[: len(largest)]
        growing = 4e-12 * size + 4e-15 * largest
        growing[np.maximum(largest, 2.0 * size) > LARGE] = np.inf
        return self.cores.least_error[: len(largest)], growing

    def balls(self, first: Indices, second: Indices) -> tuple[Flags, Array, Array]:
        """Returns balls in differences of cores: if one is known, its centre (3, m), radius."""
        cores, inscribed_centres = self.cores, self.inscribed_centres
        is_known = cores.is_thick.take(first) & cores.is_thick.take(second)
        centre = inscribed_centres.take(first, axis=1) - inscribed_centres.take(second, axis=1)
        radius = cores.core_ball_radius.take(first) + cores.core_ball_radius.take(second)
        return is_known, centre, radius

    def to_local(self, shapes: Indices, vectors: Array) -> Array:
        """Returns vectors (k, 3, m) of the world in the axes of shapes (m,)."""
        rotations = self.rotations.take(shapes, axis=1).reshape(3, 3, -1)
        turned: Array = np.einsum("jim,kjm->kim", rotations, vectors)
        return turned

    def support_points(self, shapes: Indices, directions: Array) -> Array:
        """Returns the support points (3, m) of cores, relative to their centres, in world axes."""
        cores, rotations = self.cores, self.rotations.take(shapes, axis=1)
        x, y, z = directions
        local = rotations[0:3] * x
        local += rotations[3:6] * y
        local += rotations[6:9] * z
        points = np.copysign(cores.half_extents.take(shapes, axis=1), local)
        if cores.is_swept.take(shapes).any():
            points += _ellipsoid_points(cores.semi_axes.take(shapes, axis=1), local)
        kinds = cores.kind.take(shapes)
        for kind, hulls in enumerate(cores.points):
            selected = (kinds == kind).nonzero()[0]
            if len(selected):
                rows = cores.row.take(shapes.take(selected))
                points[:, selected] = _hull_support_points(
                    hulls, rows, local.take(selected, axis=1)
                )
        in_world: Array = rotations[0::3] * points[0]
        in_world += rotations[1::3] * points[1]
        in_world += rotations[2::3] * points[2]
        return in_world

    def support_points_all_around(self, shapes: Indices, directions: Array) -> Array:
        """Returns the support points (3, m, n) of shapes (n,) in the same directions (3, m)."""
        cores, rotations = self.cores, self.rotations.take(shapes, axis=1)
        # In the order (direction, axis, shape); the axis first.
        local = np.matmul(directions.T, rotations.reshape(3, -1)).reshape(-1, 3, len(shapes))
        local = np.ascontiguousarray(local.swapaxes(0, 1))
        points = np.copysign(cores.half_extents.take(shapes, axis=1)[:, None], local)
        if cores.is_swept.take(shapes).any():
            points += _ellipsoid_points(cores.semi_axes.take(shapes, axis=1)[:, None], local)
        kinds = cores.kind.take(shapes)
        for kind, hulls in enumerate(cores.points):
            selected = np.flatnonzero(kinds == kind)
            step = max(1, MAX_POINTS // (hulls.shape[2] * directions.shape[1]))
            for start in range(0, len(selected), step):
                some = selected[start : start + step]
                rows = cores.row.take(shapes.take(some))
                corners = hulls.take(rows, axis=1).swapaxes(0, 1)
                heights = np.matmul(local.take(some, axis=2).transpose(2, 1, 0), corners)
                farthest = heights.argmax(axis=2).T + rows * hulls.shape[2]
                points[..., some] = hulls.reshape(3, -1).take(farthest, axis=1)
        rotations = rotations.reshape(3, 3, -1)
        in_world: Array = np.einsum("ijn,jmn->imn", rotations, points)
        return in_world


def _ellipsoid_points(semi_axes: Array, directions: Array) -> Array:
    """Returns the support points (3, …) of ellipsoids around the origin, in directions (3, …)."""
    scaled = semi_axes * directions
    lengths = np.sqrt(scaled[0] * scaled[0] + scaled[1] * scaled[1] + scaled[2] * scaled[2])
    scaled *= semi_axes
    scaled /= np.maximum(lengths, 1e-300)
    return scaled


def _hull_support_points(hulls: Array, rows: Indices, directions: Array) -> Array:
    """Returns support points (3, m) of the hulls `rows` of (3, h, k), in directions (3, m)."""
    size = hulls.shape[2]
    step = max(1, MAX_POINTS // size)
    if len(rows) > step:
        starts = range(0, len(rows), step)
        batches = [(rows[i : i + step], directions[:, i : i + step]) for i in starts]
        return np.concatenate([_hull_support_points(hulls, *b) for b in batches], axis=1)
    heights = np.einsum("cmk,cm->mk", hulls.take(rows, axis=1), directions)
    farthest = heights.argmax(axis=1)
    farthest += rows * size
    support_points: Array = hulls.reshape(3, -1).take(farthest, axis=1)
    return support_points
