"""Solids: the shapes as the narrow phase uses them, computed once for each geometry.

A solid is a core and a radius: a sphere is a point and a radius, a capsule a segment and a radius.
The core of a box, a hull or a mesh is its corners, without a radius. The core of a cylinder is a
segment with a disc across it, that of an ellipsoid a point with the ellipsoid around it. A plane is
a half-space.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from itertools import compress
from threading import RLock
from typing import Any, Literal, TypeAlias

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices, Triangles
from ssduck.geometry.poses import cross
from ssduck.geometry.shapes import Geometry
from ssduck.geometry.surfaces import Surface, enclosed_volume, unique_points

SolidType: TypeAlias = Literal[
    "sphere", "box", "cylinder", "capsule", "ellipsoid", "plane", "hull", "mesh"
]

# FCL gets an inscribed prism for a cylinder. Against convex shapes the result is corrected to be
# exact. It never leaves the cylinder's bounding box and sphere, so that their bounds hold.
PRISM_SIDES = 64
# An inscribed polyhedron stands for an ellipsoid against meshes: an icosahedron that is divided so
# often. It is off by up to 0.0013 of the longest half length.
ELLIPSOID_DIVISIONS = 4
# Sets of points that are thinner than this fraction of their length are flat.
FLAT = 1e-9
CACHED_SOLIDS = 1024
CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


@dataclass(frozen=True, eq=False)
class Solid:
    """A shape in its own frame; lengths are metres.

    Attributes:
        type: the type of the geometry, except that a closed convex mesh is a hull, and a hull with
            a single corner a sphere of radius 0.
        core: (n, 3), the points whose convex hull, or surface, is the core.
        radius: of the ball that is swept along the core.
        disc_radius: of the disc that is swept along a cylinder's core, else 0.
        semi_axes: (3,), half the lengths of the ellipsoid that is swept along the core: of an
            ellipsoid its own, of a cylinder those of the disc; else 0s.
        normals: (m, 3), the outward unit normals of the faces of a box or a hull, of a cylinder's
            caps, or at the ends of an ellipsoid's axes.
        offsets: (m,), of the faces: x is inside if `normals @ x <= offsets`. None for hulls
            without an inside, and for round shapes.
        faces: (k, 3), triangles of core points, for boxes, hulls and meshes.
        is_known: whether the numbers make a shape; relations with other solids are unknown.
        is_shell: whether a hull was given as a closed mesh, so that rays hit it from within.
        is_closed: whether the surface of a mesh is closed.
        volume: m³; 0 for open meshes and flat hulls, infinite for planes.
        centre, bounding_radius: a sphere around the shape.
        inscribed_centre, inscribed_radius: a sphere in the shape; of radius 0 if none is known.
        hull_corners: (k, 3), of a mesh, the core points that are corners of its convex hull.
        key: equal for solids of equal geometries.
    """

    type: SolidType
    core: Array
    radius: float = 0.0
    disc_radius: float = 0.0
    semi_axes: tuple[float, float, float] = (0.0, 0.0, 0.0)
    normals: Array = field(default_factory=lambda: np.zeros((0, 3)))
    offsets: Array | None = None
    faces: Triangles = field(default_factory=lambda: np.zeros((0, 3), np.int32))
    is_known: bool = True
    is_shell: bool = False
    is_closed: bool = True
    volume: float = 0.0
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bounding_radius: float = 0.0
    inscribed_centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    inscribed_radius: float = 0.0
    hull_corners: Array = field(default_factory=lambda: np.zeros((0, 3)))
    key: str = ""

    @property
    def is_convex(self) -> bool:
        """Whether it is its own convex hull."""
        return self.type != "mesh"

    @property
    def is_closed_mesh(self) -> bool:
        """Whether it was given as a closed mesh, convex or not."""
        return self.is_shell or (self.type == "mesh" and self.is_closed)

    @cached_property
    def is_swept(self) -> bool:
        """Whether an ellipsoid, or a disc, is swept along the core."""
        return any(self.semi_axes)

    @cached_property
    def largest_radius(self) -> float:
        """The largest radius or half length of a round shape; 0 for others."""
        return max(self.radius, *self.semi_axes)

    @property
    def is_empty(self) -> bool:
        """Whether it is a hull or a mesh without points."""
        return self.is_known and self.type != "plane" and not len(self.core)

    @cached_property
    def half_length(self) -> float:
        """Half the length of the core of a cylinder or a capsule."""
        return float(self.core[1, 2])

    @cached_property
    def surface(self) -> Surface:
        """The triangles of the core; of an inscribed polyhedron for a cylinder and an ellipsoid."""
        if self.type == "cylinder":
            return prism(self.disc_radius, self.half_length, PRISM_SIDES)
        if self.type == "ellipsoid":
            return _inscribed_polyhedron(self.semi_axes)
        if self.type in ("sphere", "capsule"):
            return Surface(self.core, np.array([[0, 0, len(self.core) - 1]], np.int32))
        return Surface(self.core, self.faces)

    @cached_property
    def _equal_volume_surface(self) -> Surface:
        """The triangles of the core; those of a prism of equal volume for a cylinder."""
        if self.type == "cylinder":
            angle = 2.0 * math.pi / PRISM_SIDES
            return prism(
                self.disc_radius * math.sqrt(angle / math.sin(angle)), self.half_length, PRISM_SIDES
            )
        return self.surface

    @cached_property
    def points(self) -> Array:
        """Points whose convex hull is the shape's; within 0.002 of the radius for round shapes."""
        if self.type == "cylinder":
            return self._equal_volume_surface.vertices
        if self.type == "ellipsoid":
            return _unit_ball() * self.semi_axes
        if not self.radius:
            return self.core
        ball = _unit_ball() * self.radius
        if self.type == "sphere":
            placed: Array = ball + self.core[0]
            return placed
        upper = ball[:, 2] > 0
        lower = ~upper
        points: Array = np.concatenate((ball[upper] + self.core[1], ball[lower] + self.core[0]))
        return points

    @cached_property
    def closed_surface(self) -> Surface:
        """A closed surface of the shape; a polyhedron for a round shape."""
        if self.radius or self.type == "ellipsoid":
            size = self.bounding_radius or 1.0  # qhull takes very large or very small sets for flat
            hull = hull_solid(self.points / size)
            return Surface(hull.core * size, hull.faces)
        return self._equal_volume_surface


@dataclass(frozen=True, eq=False)
class SolidsOfShapes:
    """The solids of n shapes, of which many are the same.

    Attributes:
        distinct: the distinct solids.
        indices: (n,), the index of each shape's solid.
    """

    distinct: Sequence[Solid]
    indices: Indices

    def flags(self, test: Callable[[Solid], bool]) -> Flags:
        """Returns what a test says of each shape's solid, (n,)."""
        return np.array(list(map(test, self.distinct)), dtype=bool)[self.indices]

    def numbers(self, value: Callable[[Solid], float]) -> Array:
        """Returns a number of each shape's solid, (n,)."""
        return np.array(list(map(value, self.distinct)), dtype=np.float64)[self.indices]

    def vectors(self, value: Callable[[Solid], Any]) -> Array:
        """Returns a vector of each shape's solid, (3, n)."""
        vectors = np.array(list(map(value, self.distinct)), dtype=np.float64)
        return vectors.reshape(-1, 3).T[:, self.indices]


@dataclass(frozen=True, eq=False)
class PlacedSolids:
    """Solids in the world.

    Attributes:
        solids: (n,), the solids.
        positions: (n, 3).
        matrices: (n, 3, 3).
        boxes: (n, 6), lower corners, upper corners.
        owners: (n,), the ids of their entities.
    """

    solids: Sequence[Solid]
    positions: Array
    matrices: Array
    boxes: Array
    owners: Indices

    def __len__(self) -> int:
        return len(self.solids)

    def __iter__(self) -> Iterator[tuple[Solid, Array, Array]]:
        """Returns each solid with its position and its rotation matrix."""
        return zip(self.solids, self.positions, self.matrices, strict=True)

    def select(self, flags: Flags) -> PlacedSolids:
        """Returns the solids that are flagged."""
        arrays: tuple[Any, ...] = self.positions, self.matrices, self.boxes, self.owners
        return PlacedSolids(list(compress(self.solids, flags)), *(each[flags] for each in arrays))

    @classmethod
    def empty(cls) -> PlacedSolids:
        """Makes an empty set of solids."""
        points = np.zeros((0, 3))
        return cls([], points, np.zeros((0, 3, 3)), np.zeros((0, 6)), np.zeros(0, np.intp))


def solid_of(geometry: Geometry) -> Solid:
    """Returns the solid of a geometry; equal geometries share one.

    >>> solid_of(Geometry.primitive("box", (1, 2, 3))).volume
    6.0
    """
    key = geometry.key
    with _LOCK:
        solid = _CACHE.get(key)
        if solid is None:
            solid = _CACHE[key] = replace(_build(geometry), key=key)
            if len(_CACHE) > CACHED_SOLIDS:
                _CACHE.popitem(last=False)
        else:
            _CACHE.move_to_end(key)
    return solid


_CACHE: OrderedDict[str, Solid] = OrderedDict()
_LOCK = RLock()


def _build(geometry: Geometry) -> Solid:
    if not _is_valid(geometry):
        return Solid(geometry.type, np.zeros((0, 3)), is_known=False)
    a, b, c = geometry.size
    match geometry.type:
        case "sphere":
            return _round("sphere", np.zeros((1, 3)), a)
        case "capsule":
            return _round("capsule", np.array([[0.0, 0.0, -b / 2], [0.0, 0.0, b / 2]]), a)
        case "cylinder":
            return _cylinder(a, b)
        case "ellipsoid":
            return _ellipsoid(a, b, c)
        case "box":
            return _box(a, b, c)
        case "plane":
            normal = np.array(geometry.size) / math.hypot(a, b, c)
            return Solid(
                "plane",
                np.zeros((0, 3)),
                normals=normal[None],
                offsets=np.zeros(1),
                volume=math.inf,
                bounding_radius=math.inf,
            )
        case "hull":
            return hull_solid(geometry.vertices)
        case "mesh":
            return _mesh(geometry)


def _is_valid(geometry: Geometry) -> bool:
    """Checks whether the numbers make a shape. FCL accepts any numbers and may crash."""
    size, faces = geometry.size, geometry.faces
    if not (np.isfinite(size).all() and np.isfinite(geometry.vertices).all()):
        return False
    if geometry.type == "plane":
        return math.hypot(*size) > 0.0
    if geometry.type == "ellipsoid" and not min(size) > 0.0:
        return False
    in_range = not len(faces) or (faces.min() >= 0 and faces.max() < len(geometry.vertices))
    return min(size) >= 0.0 and bool(in_range)


def _round(type: SolidType, core: Array, radius: float) -> Solid:
    length = float(np.ptp(core[:, 2]))
    return Solid(
        type,
        core,
        radius=radius,
        volume=math.pi * radius**2 * (4.0 / 3.0 * radius + length),
        bounding_radius=radius + length / 2,
        inscribed_radius=radius,
    )


def _cylinder(radius: float, length: float) -> Solid:
    axis = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    return Solid(
        "cylinder",
        axis * length / 2,
        disc_radius=radius,
        semi_axes=(radius, radius, 0.0),
        normals=axis,
        volume=math.pi * radius**2 * length,
        bounding_radius=math.hypot(radius, length / 2),
        inscribed_radius=min(radius, length / 2),
    )


def _ellipsoid(a: float, b: float, c: float) -> Solid:
    return Solid(
        "ellipsoid",
        np.zeros((1, 3)),
        semi_axes=(a, b, c),
        normals=np.concatenate((np.eye(3), -np.eye(3))),
        volume=4.0 / 3.0 * math.pi * a * b * c,
        bounding_radius=max(a, b, c),
        inscribed_radius=min(a, b, c),
    )


def _box(a: float, b: float, c: float) -> Solid:
    halves = np.array([a, b, c]) / 2
    corners = CORNERS * (a, b, c)
    faces = [[0, 1, 3], [0, 3, 2], [4, 7, 5], [4, 6, 7], [0, 5, 1], [0, 4, 5]]
    faces += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    return Solid(
        "box",
        corners,
        normals=np.concatenate((np.eye(3), -np.eye(3))),
        offsets=np.concatenate((halves, halves)),
        faces=np.array(faces, np.int32),
        volume=a * b * c,
        bounding_radius=math.hypot(a, b, c) / 2,
        inscribed_radius=min(a, b, c) / 2,
    )


def hull_solid(points: Array) -> Solid:
    """Returns the convex hull of points (n, 3), which may be flat, straight or a single point."""
    points = unique_points(points)
    if len(points) == 0:
        return Solid("hull", points)
    centroid = points.mean(axis=0)
    # The spread along the principal axes tells flat and straight sets.
    _, spread, axes = np.linalg.svd(points - centroid, full_matrices=False)
    rank = int((spread > FLAT * max(spread[0], 1e-300)).sum()) if spread[0] > 0 else 0
    if rank < 3:
        return _flat_hull(points, centroid, axes, rank)
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except QhullError:
        return _flat_hull(points, centroid, axes, 2)
    hull_vertices, faces = hull.vertices, hull.simplices
    new_numbers = np.zeros(len(points), np.int32)
    new_numbers[hull_vertices] = np.arange(len(hull_vertices))
    corners = points[hull_vertices]
    interior_point = corners.mean(axis=0)
    faces = _orient_outward(new_numbers[faces], corners, interior_point)
    low, high = corners.min(axis=0), corners.max(axis=0)
    centre = (low + high) / 2
    # qhull's planes before it merges them, which are exact up to rounding
    normals, offsets = hull.equations[:, :3], -hull.equations[:, 3]
    _, first = np.unique(hull.equations.round(12), axis=0, return_index=True)
    if len(first) < len(normals):
        normals, offsets = normals[first], offsets[first]
    return Solid(
        "hull",
        corners,
        normals=normals,
        offsets=offsets,
        faces=faces,
        volume=float(hull.volume),
        centre=_point(centre),
        bounding_radius=float(np.linalg.norm(corners - centre, axis=1).max()),
        inscribed_centre=_point(interior_point),
        inscribed_radius=max(0.0, float((offsets - normals @ interior_point).min())),
    )


def _flat_hull(points: Array, centroid: Array, axes: Array, rank: int) -> Solid:
    """Returns a hull without an inside: a polygon, a segment or a point."""
    if rank == 0:
        return Solid("sphere", centroid[None], centre=_point(centroid))
    if rank == 1:
        positions = (points - centroid) @ axes[0]
        corners = points[[int(positions.argmin()), int(positions.argmax())]]
        faces = np.array([[0, 1, 1]], np.int32)
        normals = np.zeros((0, 3))
    else:
        from scipy.spatial import ConvexHull, QhullError

        try:
            hull_corners = ConvexHull((points - centroid) @ axes[:2].T).vertices
        except QhullError:
            return _flat_hull(points, centroid, axes, 1)
        corners = points[hull_corners]
        faces = np.array([[0, n, n + 1] for n in range(1, len(hull_corners) - 1)], np.int32)
        edges = np.roll(corners, -1, axis=0) - corners
        up = np.cross(axes[0], axes[1])
        sides = cross(edges, np.repeat(up[None], len(edges), axis=0))
        sides /= np.linalg.norm(sides, axis=1)[:, None]
        normals = np.concatenate(([up, -up], sides))
    bounding_radius = float(np.linalg.norm(corners - centroid, axis=1).max())
    return Solid(
        "hull",
        corners,
        normals=normals,
        faces=faces,
        centre=_point(centroid),
        bounding_radius=bounding_radius,
    )


def _mesh(geometry: Geometry) -> Solid:
    surface = Surface(*_merge_vertices(geometry.vertices, geometry.faces)).oriented()
    if not len(surface.faces):
        return Solid("mesh", np.zeros((0, 3)), is_closed=False)
    vertices = surface.vertices
    hull = hull_solid(vertices)
    volume = enclosed_volume(surface.triangles) if surface.is_closed else 0.0
    if surface.is_closed and volume > 0 and abs(volume - hull.volume) <= 1e-9 * hull.volume:
        return replace(hull, is_shell=True)
    return Solid(
        "mesh",
        vertices,
        faces=surface.faces,
        is_closed=surface.is_closed and volume > 0,
        volume=volume,
        centre=hull.centre,
        bounding_radius=hull.bounding_radius,
        hull_corners=hull.core,
    )


def _merge_vertices(vertices: Array, faces: Triangles) -> tuple[Array, Triangles]:
    """Removes duplicate vertices, vertices of no face, and faces without an area."""
    if not len(faces):
        return np.zeros((0, 3)), np.zeros((0, 3), np.int32)
    unique, indices = np.unique(vertices[faces.reshape(-1)] + 0.0, axis=0, return_inverse=True)
    merged = indices.reshape(-1, 3).astype(np.int32)
    a, b, c = merged.T
    return unique, merged[(a != b) & (b != c) & (c != a)]


def prism(radius: float, half_length: float, sides: int) -> Surface:
    """Returns a regular prism along z whose corners are at a radius."""
    angles = np.arange(sides) * (2.0 * math.pi / sides)
    ring = np.stack((np.cos(angles), np.sin(angles)), axis=1) * radius
    heights = np.repeat([-half_length, half_length], sides)
    vertices = np.column_stack((np.tile(ring, (2, 1)), heights))
    corners, next_corners = np.arange(sides), np.roll(np.arange(sides), -1)
    walls = np.concatenate(
        (
            np.stack((corners, next_corners, next_corners + sides), 1),
            np.stack((corners, next_corners + sides, corners + sides), 1),
        )
    )
    fan = np.arange(1, sides - 1)
    bottom = np.stack((np.zeros_like(fan), fan + 1, fan), 1)
    top = np.stack((np.zeros_like(fan), fan, fan + 1), 1) + sides
    return Surface(vertices, np.concatenate((walls, bottom, top)).astype(np.int32))


def _inscribed_polyhedron(semi_axes: Sequence[float]) -> Surface:
    """Returns a polyhedron whose corners are on an ellipsoid."""
    from trimesh.creation import icosphere

    ball = icosphere(subdivisions=ELLIPSOID_DIVISIONS)
    return Surface(np.array(ball.vertices) * semi_axes, np.array(ball.faces, np.int32))


@cache
def _unit_ball(count: int = 1000) -> Array:
    """Returns evenly distributed points whose hull has the volume of the unit ball."""
    from scipy.spatial import ConvexHull

    index = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * index / count, math.pi * (1.0 + math.sqrt(5.0)) * index
    ring = np.sqrt(1.0 - z * z)
    points = np.stack((ring * np.cos(angle), ring * np.sin(angle), z), axis=1)
    scaled: Array = points * (4.0 / 3.0 * math.pi / ConvexHull(points).volume) ** (1.0 / 3.0)
    return scaled


def _orient_outward(faces: Triangles, corners: Array, interior_point: Array) -> Triangles:
    """Returns faces whose normals point away from a point inside."""
    a, b, c = (corners[faces[:, k]] for k in range(3))
    is_inward = np.einsum("ij,ij->i", cross(b - a, c - a), a - interior_point) < 0
    oriented = faces.astype(np.int32)
    oriented[is_inward] = oriented[is_inward][:, ::-1]
    return oriented


def _point(values: Any) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z
