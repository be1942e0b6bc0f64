"""Points on the surfaces of shapes: `PointCloud`."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ssduck.errors import ArgumentError
from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.poses import cross
from ssduck.geometry.solids import PlacedSolids, Solid

MOST_POINTS = 20_000_000


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Points on surfaces, in the world frame; as an array it is the points, (n, 3).

    Attributes:
        points: (n, 3), m.
        normals: (n, 3), unit vectors out of the shape that a point is of.
        owners: (n,), which of `names` each point is of.
        names: of the entities.
    """

    points: Array
    normals: Array
    owners: Indices
    names: tuple[str, ...]

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> Array:
        return np.array(self.points, dtype=dtype, copy=copy)

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        return f"<PointCloud: {len(self):,} points of {len(self.names)} entities>"

    def of(self, name: str) -> Array:
        """The points of an entity, (k, 3)."""
        if name not in self.names:
            raise ArgumentError(f"there are no points of {name!r}", suggestions=list(self.names))
        own: Array = self.points[self.owners == self.names.index(name)]
        return own

    def save(self, path: str | Path) -> Path:
        """Write a file of the kind that its suffix says: `.ply`, `.xyz`, `.obj` or `.glb`."""
        import trimesh

        path = Path(path)
        try:
            cloud: Any = trimesh.PointCloud(self.points)  # type: ignore[no-untyped-call]
            cloud.export(path)
        except ValueError as error:
            raise ArgumentError(f"{path}: {error}") from error
        return path


def sampled(
    placed: PlacedSolids, names: Mapping[int, str], spacing: float, seed: int
) -> PointCloud:
    """Points spread over surfaces at random, each as likely in any equal area of them.

    Args:
        placed: the shapes. All of a shape's surface is covered, also where it is in another.
        names: of the owners, by their ids.
        spacing: the mean distance, m: there is one point for each square of that side.
        seed: of the random numbers; the same gives the same points.

    Raises:
        ArgumentError: a plane has no end, or there would be more than `MOST_POINTS`.
    """
    random = np.random.default_rng(seed)
    areas = [area_of(solid) for solid in placed.solids]
    if not math.isfinite(sum(areas)):
        raise ArgumentError("a plane has no end; leave it out by WHERE")
    square = max(spacing**2, sys.float_info.min)  # which is not 0
    if sum(areas) / square > MOST_POINTS:
        raise ArgumentError(
            f"{sum(areas) / square:,.0f} points are more than {MOST_POINTS:,}; "
            "take a larger spacing"
        )
    numbers = {id: number for number, id in enumerate(names)}
    points, normals, owners = [np.zeros((0, 3))], [np.zeros((0, 3))], [np.zeros(0, np.intp)]
    for (solid, position, matrix), area, owner in zip(placed, areas, placed.owners, strict=True):
        count = int(area / square + random.random())  # right on average, however small
        found, out = _on(solid, count, random)
        points.append(found @ matrix.T + position)
        normals.append(out @ matrix.T)
        owners.append(np.full(count, numbers[int(owner)], dtype=np.intp))
    return PointCloud(
        np.concatenate(points),
        np.concatenate(normals),
        np.concatenate(owners),
        tuple(names.values()),
    )


def area_of(solid: Solid) -> float:
    """The area of a shape's surface, m²; infinite of a plane."""
    match solid.type:
        case "plane":
            return math.inf
        case "sphere":
            return 4.0 * math.pi * solid.radius**2
        case "capsule":
            return 4.0 * math.pi * solid.radius * (solid.radius + solid.half_length)
        case "cylinder":
            return 2.0 * math.pi * solid.disc_radius * (solid.disc_radius + 2.0 * solid.half_length)
    return float(_areas(solid.surface.triangles).sum())


def _on(solid: Solid, count: int, random: np.random.Generator) -> tuple[Array, Array]:
    """Points on a shape and the normals there, in its frame, (count, 3) each."""
    if not count:
        return np.zeros((0, 3)), np.zeros((0, 3))
    match solid.type:
        case "sphere" | "capsule":
            return _on_round(solid, count, random)
        case "cylinder":
            return _on_cylinder(solid.disc_radius, solid.half_length, count, random)
    return _on_triangles(solid.surface.triangles, count, random)


def _on_round(solid: Solid, count: int, random: np.random.Generator) -> tuple[Array, Array]:
    """On a sphere, or a sphere's halves with a cylinder's side between them."""
    half = solid.half_length if solid.type == "capsule" else 0.0
    out = random.normal(size=(count, 3))
    is_side = random.random(count) < half / (half + solid.radius)
    out[is_side, 2] = 0.0
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    along = np.where(is_side, random.uniform(-half, half, count), np.sign(out[:, 2]) * half)
    points = out * solid.radius
    points[:, 2] += along
    if solid.type == "sphere":
        points += solid.core[0]
    return points, out


def _on_cylinder(
    radius: float, half: float, count: int, random: np.random.Generator
) -> tuple[Array, Array]:
    turn = random.uniform(0.0, 2.0 * math.pi, count)
    ring = np.stack((np.cos(turn), np.sin(turn)), axis=1)
    is_side = random.random(count) < 2.0 * half / (2.0 * half + radius)
    end = np.where(random.random(count) < 0.5, -1.0, 1.0)
    points, out = np.zeros((count, 3)), np.zeros((count, 3))
    # The square root spreads points evenly over a disc.
    off = np.where(is_side, radius, radius * np.sqrt(random.random(count)))
    points[:, :2] = ring * off[:, None]
    points[:, 2] = np.where(is_side, random.uniform(-half, half, count), end * half)
    out[is_side, :2] = ring[is_side]
    out[~is_side, 2] = end[~is_side]
    return points, out


def _on_triangles(triangles: Array, count: int, random: np.random.Generator) -> tuple[Array, Array]:
    """On triangles (m, 3, 3); their corners run counter-clockwise seen from outside."""
    areas = _areas(triangles)
    chosen = triangles[random.choice(len(triangles), count, p=areas / areas.sum())]
    # Of the parallelogram of two edges, the far half is folded back.
    u, v = random.random((2, count, 1))
    far = u + v > 1.0
    u, v = np.where(far, 1.0 - u, u), np.where(far, 1.0 - v, v)
    first, second = chosen[:, 1] - chosen[:, 0], chosen[:, 2] - chosen[:, 0]
    out = cross(first, second)
    return chosen[:, 0] + u * first + v * second, out / np.linalg.norm(out, axis=1, keepdims=True)


def _areas(triangles: Array) -> Array:
    out = cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    areas: Array = np.linalg.norm(out, axis=1) / 2.0
    return areas
