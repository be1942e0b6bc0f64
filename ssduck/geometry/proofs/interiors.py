"""How deep points are in many convex shapes at once, by closed forms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.solids import Solid


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
        are_balls: (n,), whether it is a sphere.
    """

    def __init__(self, solids: Sequence[Solid], solid_indices: Indices) -> None:
        self.are_known: Flags = np.array([_has_inside(s) for s in solids], dtype=bool)[
            solid_indices
        ]
        self.are_balls: Flags = np.array([s.type == "sphere" for s in solids], dtype=bool)[
            solid_indices
        ]
        numbers = np.array([_numbers(solid) for solid in solids]).reshape(-1, 10).T
        numbers = numbers[:, solid_indices]
        self._between, self._core, self._scales = numbers[:3], numbers[3:6], numbers[6:9]
        self._radius = numbers[9]
        hulls = [n for n, solid in enumerate(solids) if _has_inside(solid) and _is_hull(solid)]
        rows = np.full(len(solids), -1)
        rows[hulls] = np.arange(len(hulls))
        self._hull_rows = rows[solid_indices]
        # The planes of each hull: normals and offsets, the last one repeated.
        count = max((len(solids[n].normals) for n in hulls), default=0)
        self._planes = np.array([_planes(solids[n], count) for n in hulls])

    def depths(self, shapes: Indices, points: Array) -> Array:
        """Returns lower bounds of the depths of points, (m,), metres; negative outside.

        The ball of that radius around a point is in the shape.

        Args:
            shapes: (m,), shapes with a formula.
            points: (3, m), one for each shape, in its frame from the solid's centre.
        """
        magnitudes = np.abs(points)
        between = (self._between.take(shapes, axis=1) - magnitudes).min(axis=0)
        magnitudes -= self._core.take(shapes, axis=1)
        scaled = np.maximum(magnitudes, 0.0, out=magnitudes)
        scaled *= self._scales.take(shapes, axis=1)
        lengths = np.sqrt(np.einsum("cn,cn->n", scaled, scaled))
        depths: Array = np.minimum(between, self._radius.take(shapes) * (1.0 - lengths))
        rows = self._hull_rows.take(shapes)
        are_hulls = np.flatnonzero(rows >= 0)
        if len(are_hulls):
            planes = self._planes.take(rows.take(are_hulls), axis=0)
            heights = np.einsum("nck,cn->nk", planes[:, :3], points.take(are_hulls, axis=1))
            depths[are_hulls] = (planes[:, 3] - heights).min(axis=1)
        return depths


def _has_inside(solid: Solid) -> bool:
    if not (solid.is_known and solid.is_convex and solid.inscribed_radius > 0.0):
        return False
    return solid.type != "plane" and (not _is_hull(solid) or solid.offsets is not None)


def _is_hull(solid: Solid) -> bool:
    return solid.type == "hull"


def _numbers(solid: Solid) -> list[float]:
    """Returns the distances of planes, the sides of the core, the scales and the radius."""
    none, anywhere = [0.0] * 3, [np.inf] * 3
    if not _has_inside(solid) or _is_hull(solid):
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
    planes = np.concatenate((solid.normals.T, offsets[None]))
    padded: Array = planes[:, np.minimum(np.arange(count), len(offsets) - 1)]
    return padded
