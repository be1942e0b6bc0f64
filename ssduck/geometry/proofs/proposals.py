"""Decides pairs of convex shapes by directions and points that FCL proposes, if there are few.

For a few pairs, a call of FCL for each is faster than a step of GJK for all of them. Its distance
of solids that are apart proposes their nearest points, and the direction between them. Its contact
of solids that meet proposes a point of both, and the contact normal. FCL may be wrong: its
distances of boxes and cylinders with parallel edges are. Only what a proof makes of a proposal
counts:

* The supports of the shapes against any direction bound their signed distance from below.
* Of any point of each shape, the balls around them in the shapes bound it from above: the distance
  of the points less both radii. Of shapes that meet, it is one point, moved along the direction to
  where it is equally deep in both.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, TypeAlias

import numpy as np

from ssduck.geometry.arrays import Array, Indices, column_lengths, padded_columns
from ssduck.geometry.proofs.cores import PlacedCores
from ssduck.geometry.proofs.gjk import tolerances
from ssduck.geometry.proofs.verdicts import Decisions
from ssduck.geometry.solids import Solid, SolidsOfShapes

# The positions (n, 3) and the rotations (n, 3, 3) of shapes.
Poses: TypeAlias = tuple[Array, Array]


class Proposer:
    """Decides pairs of shapes of a table by what FCL proposes.

    FCL's objects are placed anew for each proposal.

    Args:
        of_each: the solids of n shapes.
    """

    def __init__(self, of_each: SolidsOfShapes) -> None:
        self._of_each = of_each

    @cached_property
    def interiors(self) -> ConvexInteriors:
        """The interiors of the shapes, made when first needed: a table of many ticks needs none."""
        return ConvexInteriors(self._of_each)

    def decide(
        self, bodies: PlacedCores, poses: Poses, first: Indices, second: Indices, bounds: Array
    ) -> Decisions:
        """Decides pairs whose signed distances are proved to be beyond the bounds."""
        asked = self.ask(poses, first, second)
        least, greatest = gap_bounds(bodies, self.interiors, asked, first, second)
        return Decisions.of_interval(least, greatest, bounds, tolerances(bodies, first, second))

    @cached_property
    def _objects(self) -> list[Any]:
        """The object of each shape; None for shapes that FCL does not compare."""
        import fcl

        indices, known = self._of_each.indices.tolist(), self.interiors.are_known.tolist()
        geometries: dict[int, Any] = {}
        for index, is_known in zip(indices, known, strict=True):
            if is_known and index not in geometries:
                geometries[index] = _geometry(self._of_each.distinct[index])
        return [
            fcl.CollisionObject(geometries[index]) if is_known else None
            for index, is_known in zip(indices, known, strict=True)
        ]

    def ask(self, poses: Poses, first: Indices, second: Indices) -> Array:
        """Returns what FCL says of pairs of shapes with known interiors, (n, 3, 3).

        It is a point on the first shape, a point on the second one, and the contact normal from the
        second to the first; 0 for shapes that do not meet.
        """
        import fcl

        objects, distance, collide = self._objects, fcl.distance, fcl.collide
        wanted, contact = (
            fcl.DistanceRequest(enable_nearest_points=True),
            fcl.CollisionRequest(enable_contact=True),
        )
        positions, matrices = poses
        pairs = list(zip(first.tolist(), second.tolist(), strict=True))
        for shape in {shape for pair in pairs for shape in pair}:
            objects[shape].setRotation(matrices[shape])
            objects[shape].setTranslation(positions[shape])
        rows: list[Array] = []
        for first_shape, second_shape in pairs:
            one, other = objects[first_shape], objects[second_shape]
            meeting = fcl.CollisionResult()
            collide(one, other, contact, meeting)
            if contacts := meeting.contacts:
                deepest = contacts[0]
                rows += (deepest.pos, deepest.pos, -deepest.normal)
                continue
            nearest = fcl.DistanceResult()  # a new one each time: FCL only lowers its distance
            distance(one, other, wanted, nearest)
            rows += (*nearest.nearest_points, _NO_DIRECTION)
        return np.concatenate(rows).reshape(-1, 3, 3)


_NO_DIRECTION = np.zeros(3)


def _geometry(solid: Solid) -> Any:
    """Returns FCL's geometry of a convex solid with an inside."""
    import fcl

    radius, half = solid.radius, solid.core[-1].tolist()
    if solid.type == "box":
        return fcl.Box(*(2.0 * side for side in half))
    if solid.type == "sphere":
        return fcl.Sphere(radius)
    if solid.type == "capsule":
        return fcl.Capsule(radius, 2.0 * half[2])
    if solid.type == "cylinder":
        return fcl.Cylinder(solid.disc_radius, 2.0 * half[2])
    if solid.type == "ellipsoid":
        return fcl.Ellipsoid(*solid.semi_axes)
    counts = np.full((len(solid.faces), 1), 3)
    corners = np.concatenate((counts, solid.faces), axis=1)
    return fcl.Convex(solid.core, len(solid.faces), corners.ravel())


def gap_bounds(
    bodies: PlacedCores, interiors: ConvexInteriors, asked: Array, first: Indices, second: Indices
) -> tuple[Array, Array]:
    """Returns what the signed distances of pairs are at least and at most, (n,), metres.

    They hold whatever is `asked`, which `Proposer.ask` describes.
    """
    both, count = np.concatenate((first, second)), len(first)
    centres = bodies.centres.take(both, axis=1)
    on_first, on_second, normals = asked.transpose(1, 2, 0)
    between = on_first - on_second
    meet = np.asarray(normals.any(axis=0))
    directions = np.where(meet, normals, between)
    lengths = column_lengths(directions)
    directions /= np.where(lengths > 0.0, lengths, 1.0)
    directions[2] += lengths == 0.0  # any direction of length 1 gives a bound
    # From below: by the supports of the shapes against the directions.
    outward = np.concatenate((-directions, directions), axis=1)
    reach = np.einsum("cn,cn->n", bodies.support_points(both, outward), outward)
    reach += bodies.cores.radius.take(both)
    least = np.einsum("cn,cn->n", directions, centres[:, :count] - centres[:, count:])
    least -= reach[:count] + reach[count:]
    # From above: by the balls in the shapes around the points; those of shapes that meet are one
    # point, which is about equally deep in both.
    meet |= least < 0.0
    points = np.concatenate((on_first, on_second), axis=1) - centres
    middles = np.concatenate((-0.5 * between * meet, 0.5 * between * meet), axis=1)
    local, outward = bodies.to_local(both, np.array((points + middles, outward)))
    inner = interiors.of(both)
    if meet.any():
        depths = inner.depths(local)
        steps = 0.5 * (depths[:count] - depths[count:]) * meet
        local += np.concatenate((steps, -steps)) * outward
    local += SHRINK * (inner.inscribed_offsets - local)
    depths = inner.depths(local)
    radii = depths - inner.margins
    greatest = column_lengths(between) * ~meet - radii[:count] - radii[count:]
    greatest[(depths[:count] < 0.0) | (depths[count:] < 0.0)] = np.inf
    return least, greatest


# -- how deep points are in shapes, by closed forms ----------------------------------------------

# Points are moved by this fraction towards the middle of the shape, so that they are surely in it.
SHRINK = 1e-8


class ConvexInteriors:
    """The interiors of convex solids with an inside, relative to the centres of the solids.

    A box, and a cylinder along its axis, are between planes. A sphere, a capsule, a cylinder across
    its axis and an ellipsoid are what is less than 1 from a box or the origin, along scaled axes. A
    hull is behind the planes of its faces.

    Args:
        of_each: the solids of n shapes.

    Attributes:
        are_known: (n,), whether the shape has a formula.
    """

    def __init__(self, of_each: SolidsOfShapes) -> None:
        solids, solid_indices = of_each.distinct, of_each.indices
        self.are_known = of_each.flags(_has_inside)
        numbers = np.array([_numbers(solid) for solid in solids]).reshape(-1, _ROWS).T
        self._numbers = numbers[:, solid_indices]
        hulls = [n for n, solid in enumerate(solids) if _has_inside(solid) and _is_hull(solid)]
        rows = np.full(len(solids), -1)
        rows[hulls] = np.arange(len(hulls))
        self._hull_rows = rows[solid_indices]
        # The planes of each hull, the last one repeated.
        count = max((len(solids[n].normals) for n in hulls), default=0)
        self._planes = np.array([_planes(solids[n], count) for n in hulls])

    def of(self, shapes: Indices) -> SomeInteriors:
        """Returns the interiors of shapes with a formula, (m,)."""
        return SomeInteriors(
            self._numbers.take(shapes, axis=1),
            self._hull_rows.take(shapes),
            self._planes,
        )


class SomeInteriors:
    """The interiors of m shapes, each in its frame from the solid's centre.

    Args:
        numbers: (rows, m), see `_numbers`.
        hull_rows: (m,), the place of each shape's hull; -1 for other shapes.
        planes: (hulls, 4, l), the normals and the offsets of hulls.

    Attributes:
        inscribed_offsets: (3, m), the centres of the balls in the solids.
        margins: (m,), by how much the radii of balls in the solids are less than depths, metres: by
            far more than the rounding errors of depths.
    """

    def __init__(self, numbers: Array, hull_rows: Indices, planes: Array) -> None:
        self._numbers = numbers
        self.inscribed_offsets, self.margins = numbers[10:13], numbers[13]
        self._hulls = np.flatnonzero(hull_rows >= 0)
        if len(self._hulls):
            self._planes = planes.take(hull_rows.take(self._hulls), axis=0)

    def depths(self, points: Array) -> Array:
        """Returns lower bounds of the depths of points (3, m), (m,), metres; negative outside.

        The ball of that radius around a point is in the shape.
        """
        numbers = self._numbers
        magnitudes = np.abs(points)
        between = (numbers[0:3] - magnitudes).min(axis=0)
        magnitudes -= numbers[3:6]
        scaled = np.maximum(magnitudes, 0.0, out=magnitudes)
        scaled *= numbers[6:9]
        depths: Array = np.minimum(between, numbers[9] * (1.0 - column_lengths(scaled)))
        if len(self._hulls):
            planes = self._planes
            heights = np.einsum("nck,cn->nk", planes[:, :3], points.take(self._hulls, axis=1))
            depths[self._hulls] = (planes[:, 3] - heights).min(axis=1)
        return depths


def _has_inside(solid: Solid) -> bool:
    if not (solid.is_known and solid.is_convex and solid.inscribed_radius > 0.0):
        return False
    return solid.type != "plane" and (not _is_hull(solid) or solid.offsets is not None)


def _is_hull(solid: Solid) -> bool:
    return solid.type == "hull"


# The rows of `_numbers`.
_ROWS = 14


def _numbers(solid: Solid) -> list[float]:
    """Returns the properties of a solid; those with x, y and z take three rows."""
    if not _has_inside(solid):
        return [0.0] * _ROWS
    inside = np.subtract(solid.inscribed_centre, solid.centre).tolist()
    return [*_scaled_numbers(solid), *inside, 2.0 * SHRINK * solid.bounding_radius]


def _scaled_numbers(solid: Solid) -> list[float]:
    """Returns the distances of planes, the sides of the core, the scales and the radius."""
    none, anywhere = [0.0] * 3, [np.inf] * 3
    if _is_hull(solid):
        return [*anywhere, *none, *none, np.inf]
    if solid.type == "box":
        return [*solid.core[-1].tolist(), *none, *none, np.inf]
    if solid.type == "cylinder":
        radius = solid.disc_radius
        return [np.inf, np.inf, solid.half_length, *none, 1 / radius, 1 / radius, 0.0, radius]
    if solid.type == "ellipsoid":
        return [*anywhere, *none, *(1 / axis for axis in solid.semi_axes), min(solid.semi_axes)]
    core = [0.0, 0.0, solid.half_length if solid.type == "capsule" else 0.0]
    return [*anywhere, *core, *([1 / solid.radius] * 3), solid.radius]


def _planes(solid: Solid, count: int) -> Array:
    """Returns the planes of a hull, (4, count): normals, and offsets from its centre."""
    assert solid.offsets is not None
    offsets = solid.offsets - solid.normals @ np.array(solid.centre)
    return padded_columns(np.concatenate((solid.normals, offsets[:, None]), axis=1), count)
