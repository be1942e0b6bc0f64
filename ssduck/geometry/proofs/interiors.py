"""How deep points are in many convex shapes at once, and how far these reach, by closed forms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.proofs.columns import column_lengths, padded_columns
from ssduck.geometry.proofs.cores import corners_from_centre
from ssduck.geometry.solids import Solid

# Points are moved by this fraction towards the middle of the shape, so that they are surely in it.
SHRINK = 1e-8


class ConvexInteriors:
    """The interiors of convex solids with an inside, relative to the centres of the solids.

    A box, and a cylinder along its axis, are between planes. A sphere, a capsule, a cylinder across
    its axis and an ellipsoid are what is less than 1 from a box or the origin, along scaled axes. A
    hull is behind the planes of its faces.

    Args:
        solids: the distinct solids.
        solid_indices: (n,), the index of each shape's solid.

    Attributes:
        are_known: (n,), whether the shape has a formula.
    """

    def __init__(self, solids: Sequence[Solid], solid_indices: Indices) -> None:
        self.are_known: Flags = np.array([_has_inside(s) for s in solids], dtype=bool)[
            solid_indices
        ]
        # One array: to take some of its columns takes one call.
        numbers = np.array([_numbers(solid) for solid in solids]).reshape(-1, _ROWS).T
        self._numbers = numbers[:, solid_indices]
        hulls = [n for n, solid in enumerate(solids) if _has_inside(solid) and _is_hull(solid)]
        rows = np.full(len(solids), -1)
        rows[hulls] = np.arange(len(hulls))
        self._hull_rows = rows[solid_indices]
        # The corners and the planes of each hull, the last one repeated.
        count = max((len(solids[n].core) for n in hulls), default=0)
        self._corners = np.array(
            [padded_columns(corners_from_centre(solids[n]), count) for n in hulls]
        )
        count = max((len(solids[n].normals) for n in hulls), default=0)
        self._planes = np.array([_planes(solids[n], count) for n in hulls])

    def of(self, shapes: Indices) -> SomeInteriors:
        """Returns the interiors of shapes with a formula, (m,)."""
        return SomeInteriors(
            self._numbers.take(shapes, axis=1),
            self._hull_rows.take(shapes),
            self._corners,
            self._planes,
        )


class SomeInteriors:
    """The interiors of m shapes, each in its frame from the solid's centre.

    Args:
        numbers: (rows, m), see `_numbers`.
        hull_rows: (m,), the place of each shape's hull; -1 for other shapes.
        corners: (hulls, 3, k), those of hulls.
        planes: (hulls, 4, l), the normals and the offsets of hulls.

    Attributes:
        inscribed_offsets: (3, m), the centres of the balls in the solids.
        margins: (m,), by how much the radii of balls in the solids are less than depths, metres: by
            far more than the rounding errors of depths.
    """

    def __init__(self, numbers: Array, hull_rows: Indices, corners: Array, planes: Array) -> None:
        self._numbers = numbers
        self.inscribed_offsets, self.margins = numbers[16:19], numbers[20]
        self._hulls = np.flatnonzero(hull_rows >= 0)
        if len(self._hulls):
            rows = hull_rows.take(self._hulls)
            self._corners, self._planes = corners.take(rows, axis=0), planes.take(rows, axis=0)

    def heights(self, directions: Array) -> Array:
        """Returns the extents of the shapes from their centres in unit directions (3, m), (m,)."""
        numbers = self._numbers
        heights: Array = np.einsum("cn,cn->n", numbers[:3], np.abs(directions))
        heights += column_lengths(numbers[3:6] * directions)
        heights += numbers[19]
        if len(self._hulls):
            products = np.einsum("nck,cn->nk", self._corners, directions.take(self._hulls, axis=1))
            heights[self._hulls] = products.max(axis=1)
        return heights

    def depths(self, points: Array) -> Array:
        """Returns lower bounds of the depths of points (3, m), (m,), metres; negative outside.

        The ball of that radius around a point is in the shape.
        """
        numbers = self._numbers
        magnitudes = np.abs(points)
        between = (numbers[6:9] - magnitudes).min(axis=0)
        magnitudes -= numbers[9:12]
        scaled = np.maximum(magnitudes, 0.0, out=magnitudes)
        scaled *= numbers[12:15]
        depths: Array = np.minimum(between, numbers[15] * (1.0 - column_lengths(scaled)))
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
_ROWS = 21


def _numbers(solid: Solid) -> list[float]:
    """Returns the properties of a solid; those with x, y and z take three rows.

    0 half the sides of the box and 3 the axes of the ellipsoid whose sum it is, with the ball of
    radius 19 around. 6 the distances of planes, 9 half the sides of the core, 12 the scales around
    it, 15 the radius at which these are 1. 16 the centre of the ball in it; 20 the margin of balls.
    """
    if not _has_inside(solid):
        return [0.0] * _ROWS
    half = solid.core[-1].tolist() if solid.type in ("box", "capsule", "cylinder") else [0.0] * 3
    inside = np.subtract(solid.inscribed_centre, solid.centre).tolist()
    last = solid.radius, 2.0 * SHRINK * solid.bounding_radius
    return [*half, *solid.semi_axes, *_scaled_numbers(solid), *inside, *last]


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
