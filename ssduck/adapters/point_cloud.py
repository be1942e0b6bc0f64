"""Samples points on the surfaces of shapes, as a `PointCloud`."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ssduck.errors import ArgumentError, ProgramWarning, warn
from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.poses import cross
from ssduck.geometry.solids import PlacedSolids, Solid
from ssduck.lazy import import_whole

if TYPE_CHECKING:
    from PIL import Image

MAX_POINTS = 20_000_000


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Points on surfaces, in the world frame; numpy converts it to the points, (n, 3).

    Attributes:
        points: (n, 3), m.
        normals: (n, 3), unit normals that point out of the shapes.
        owners: (n,), the index in `names` of each point's entity.
        names: the names of the entities.
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
        """Returns the points of an entity, (k, 3), m.

        Raises:
            ArgumentError: the cloud has no entity of that name.
        """
        if name not in self.names:
            raise ArgumentError(f"there are no points of {name!r}", suggestions=list(self.names))
        points: Array = self.points[self.owners == self.names.index(name)]
        return points

    def image(self) -> Image.Image:
        """Returns a picture with axes in metres and a colour for each entity."""
        from ssduck.adapters.charts import draw_points

        return draw_points(self.points, self.owners, self.names)

    def _repr_png_(self) -> bytes:
        """Returns `image()` as a PNG picture for notebooks."""
        from ssduck.adapters.charts import png

        return png(self.image())

    def plot(self, ax: Any = None) -> Any:
        """Draws the points with matplotlib, with axes in metres and a colour for each entity.

        Args:
            ax: three-dimensional axes of matplotlib; by default those of a new figure.

        Returns:
            The axes.

        Raises:
            UnsupportedError: matplotlib is not installed; the message says how to install it.
        """
        from ssduck.adapters.optional import axes_of

        ax = axes_of(ax, projection="3d")
        for index, name in enumerate(self.names):
            x, y, z = self.points[self.owners == index].T
            ax.scatter(x, y, z, s=1, label=name)
        for axis in "xyz":
            getattr(ax, f"set_{axis}label")(f"{axis} [m]")
        ax.set_aspect("equal")
        ax.legend(loc="upper left", bbox_to_anchor=(1.15, 1.0), markerscale=5)
        return ax

    def save(self, path: str | Path) -> Path:
        """Writes a file in the format of its suffix: `.ply`, `.xyz`, `.obj` or `.glb`."""
        import_whole("trimesh")
        import trimesh

        path = Path(path)
        try:
            cloud: Any = trimesh.PointCloud(self.points)  # type: ignore[no-untyped-call]
            cloud.export(path)
        except ValueError as error:
            raise ArgumentError(f"{path}: {error}") from error
        return path


def sample_points(
    placed: PlacedSolids,
    names: Mapping[int, str],
    spacing: float,
    seed: int,
    check: Callable[[float], None] = lambda _: None,
) -> PointCloud:
    """Samples points uniformly from the surfaces of shapes, also inside other shapes.

    There is one point for each square with the side `spacing`, m. `check` gets the number of points
    before they are made, and may raise an error. `names` are those of the owners by their ids.
    """
    random = np.random.default_rng(seed)
    areas = [surface_area(solid) for solid in placed.solids]
    if not math.isfinite(sum(areas)):
        raise ArgumentError("a plane is infinite; exclude it by WHERE")
    square = max(spacing**2, sys.float_info.min)  # not 0
    if sum(areas) / square > MAX_POINTS:
        raise ArgumentError(
            f"{sum(areas) / square:,.0f} points are more than {MAX_POINTS:,}; take a larger spacing"
        )
    check(sum(areas) / square)
    if 0 < sum(areas) < square:
        warn(
            f"AS points: a mean distance of {spacing:g} m is larger than what is sampled, whose "
            f"surface is {sum(areas):.3g} m^2: it is in metres, as in AS points(0.01)",
            ProgramWarning,
        )
    indices = {id: index for index, id in enumerate(names)}
    points, normals, owners = [np.zeros((0, 3))], [np.zeros((0, 3))], [np.zeros(0, np.intp)]
    for (solid, position, matrix), area, owner in zip(placed, areas, placed.owners, strict=True):
        count = int(area / square + random.random())  # unbiased also for small areas
        local, local_normals = _sample(solid, count, random)
        points.append(local @ matrix.T + position)
        normals.append(local_normals @ matrix.T)
        owners.append(np.full(count, indices[int(owner)], dtype=np.intp))
    return PointCloud(
        np.concatenate(points),
        np.concatenate(normals),
        np.concatenate(owners),
        tuple(names.values()),
    )


def surface_area(solid: Solid) -> float:
    """Returns the area of the surface of a shape, m²; infinity for a plane."""
    match solid.type:
        case "plane":
            return math.inf
        case "sphere":
            return 4.0 * math.pi * solid.radius**2
        case "capsule":
            return 4.0 * math.pi * solid.radius * (solid.radius + solid.half_length)
        case "cylinder":
            return 2.0 * math.pi * solid.disc_radius * (solid.disc_radius + 2.0 * solid.half_length)
        case "ellipsoid":
            return _ellipsoid_area(solid.semi_axes)
    return float(_triangle_areas(solid.surface.triangles).sum())


def _ellipsoid_area(semi_axes: tuple[float, float, float]) -> float:
    """Returns the area of an ellipsoid, m² (Carlson's symmetric integral R_G, DLMF 19.33.2)."""
    from scipy.special import elliprg

    inverse = [(1.0 / axis) ** 2 for axis in semi_axes]
    return 4.0 * math.pi * math.prod(semi_axes) * float(elliprg(*inverse))


def _sample(solid: Solid, count: int, random: np.random.Generator) -> tuple[Array, Array]:
    """Returns points on a shape and their normals, in its frame, (count, 3) each."""
    if not count:
        return np.zeros((0, 3)), np.zeros((0, 3))
    match solid.type:
        case "sphere" | "capsule":
            return _sample_round(solid, count, random)
        case "cylinder":
            return _sample_cylinder(solid.disc_radius, solid.half_length, count, random)
        case "ellipsoid":
            return _sample_ellipsoid(np.array(solid.semi_axes), count, random)
    return _sample_triangles(solid.surface.triangles, count, random)


def _sample_round(solid: Solid, count: int, random: np.random.Generator) -> tuple[Array, Array]:
    """Samples a sphere or a capsule."""
    half = solid.half_length if solid.type == "capsule" else 0.0
    normals = random.normal(size=(count, 3))
    is_side = random.random(count) < half / (half + solid.radius)
    normals[is_side, 2] = 0.0
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = np.where(is_side, random.uniform(-half, half, count), np.sign(normals[:, 2]) * half)
    points = normals * solid.radius
    points[:, 2] += offsets
    if solid.type == "sphere":
        points += solid.core[0]
    return points, normals


def _sample_ellipsoid(
    semi_axes: Array, count: int, random: np.random.Generator
) -> tuple[Array, Array]:
    """Samples an ellipsoid: scaled points of a ball, kept as often as a place is stretched."""
    points, normals = np.zeros((0, 3)), np.zeros((0, 3))
    while len(points) < count:
        on_ball = random.normal(size=(count, 3))
        on_ball /= np.linalg.norm(on_ball, axis=1, keepdims=True)
        # A small area of the ball grows by the product of the axes times this.
        gradients = on_ball / semi_axes
        stretch = np.linalg.norm(gradients, axis=1)
        kept = random.random(count) * (1.0 / semi_axes.min()) < stretch
        points = np.concatenate((points, on_ball[kept] * semi_axes))
        normals = np.concatenate((normals, gradients[kept] / stretch[kept, None]))
    return points[:count], normals[:count]


def _sample_cylinder(
    radius: float, half: float, count: int, random: np.random.Generator
) -> tuple[Array, Array]:
    angle = random.uniform(0.0, 2.0 * math.pi, count)
    ring = np.stack((np.cos(angle), np.sin(angle)), axis=1)
    is_side = random.random(count) < 2.0 * half / (2.0 * half + radius)
    end = np.where(random.random(count) < 0.5, -1.0, 1.0)
    points, normals = np.zeros((count, 3)), np.zeros((count, 3))
    # The square root spreads points evenly over a disc.
    distances = np.where(is_side, radius, radius * np.sqrt(random.random(count)))
    points[:, :2] = ring * distances[:, None]
    points[:, 2] = np.where(is_side, random.uniform(-half, half, count), end * half)
    normals[is_side, :2] = ring[is_side]
    normals[~is_side, 2] = end[~is_side]
    return points, normals


def _sample_triangles(
    triangles: Array, count: int, random: np.random.Generator
) -> tuple[Array, Array]:
    """Samples triangles (m, 3, 3), whose corners run counter-clockwise seen from outside."""
    areas = _triangle_areas(triangles)
    chosen = triangles[random.choice(len(triangles), count, p=areas / areas.sum())]
    # Points in the outer half of the parallelogram of two edges are folded back.
    u, v = random.random((2, count, 1))
    is_outside = u + v > 1.0
    u, v = np.where(is_outside, 1.0 - u, u), np.where(is_outside, 1.0 - v, v)
    first, second = chosen[:, 1] - chosen[:, 0], chosen[:, 2] - chosen[:, 0]
    normals = cross(first, second)
    return chosen[:, 0] + u * first + v * second, normals / np.linalg.norm(
        normals, axis=1, keepdims=True
    )


def _triangle_areas(triangles: Array) -> Array:
    normals = cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    areas: Array = np.linalg.norm(normals, axis=1) / 2.0
    return areas
