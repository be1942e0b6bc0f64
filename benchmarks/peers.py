"""Finds all pairs of a scene that collide by other libraries: FCL, PyBullet and coal.

A part of `benchmarks.pairs`, which times them. Objects and poses are made beforehand; the timed
part is that of every tick: setting the poses and finding the pairs. A pair is (i, j), i < j.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from types import ModuleType
from typing import Any, TypeAlias

import fcl
import numpy as np
import pybullet
from scipy.spatial import ConvexHull

from benchmarks.random_scenes import PERIOD, Piece, RandomScene
from ssduck.geometry.arrays import Array, Triangles

Pairs: TypeAlias = list[tuple[int, int]]
# Deeper pairs, metres, collide, as in ssduck.
COLLIDES = 1e-6


def coal_or_none() -> ModuleType | None:
    """Returns the package coal, or None if it is not installed."""
    try:
        import coal
    except ImportError:
        return None
    package: ModuleType = coal
    return package


def _sorted(i: int, j: int) -> tuple[int, int]:
    return (i, j) if i < j else (j, i)


def _surface(points: Array) -> tuple[Array, Triangles]:
    """Returns the corners of a hull and its triangles, oriented outward."""
    hull = ConvexHull(points)
    number = np.zeros(len(points), np.int32)
    number[hull.vertices] = np.arange(len(hull.vertices))
    corners, faces = points[hull.vertices], number[hull.simplices]
    a, b, c = (corners[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return corners, faces


class Fcl:
    """Tests pairs by python-fcl, one by one in a loop or in a tree of boxes."""

    def __init__(self, scene: RandomScene) -> None:
        # A geometry for each body, as contacts only name geometries.
        self._geometries = [_fcl_geometry(scene.piece(body)) for body in range(len(scene))]
        self._numbers = {id(geometry): n for n, geometry in enumerate(self._geometries)}
        self._poses_of_ticks = [_fcl_poses(scene.at(tick)) for tick in range(PERIOD)]
        self._poses = self._poses_of_ticks[0]
        self._objects = list(map(fcl.CollisionObject, self._geometries, self._poses))
        self._manager = fcl.DynamicAABBTreeCollisionManager()
        self._manager.registerObjects(self._objects)
        self._manager.setup()

    def move(self, tick: int) -> None:
        """Chooses the poses of a tick."""
        self._poses = self._poses_of_ticks[tick % PERIOD]

    def place(self) -> None:
        """Sets the poses of all objects."""
        for one, pose in zip(self._objects, self._poses, strict=True):
            one.setTransform(pose)

    def loop(self, pairs: Iterable[tuple[int, int]]) -> Pairs:
        """Returns the pairs that collide of some pairs, each tested by itself."""
        objects, collide, request = self._objects, fcl.collide, fcl.CollisionRequest()
        return [
            (i, j)
            for i, j in pairs
            if collide(objects[i], objects[j], request, fcl.CollisionResult())
        ]

    def managed(self) -> Pairs:
        """Returns all pairs that collide, by the tree of boxes."""
        self.place()
        self._manager.update()
        data = fcl.CollisionData(request=fcl.CollisionRequest())
        self._manager.collide(data, _collide)
        number = self._numbers
        return [_sorted(number[id(c.o1)], number[id(c.o2)]) for c in data.result.contacts]


def _collide(one: Any, other: Any, data: Any) -> bool:
    """Records the contacts of a pair of the tree; returns that the search goes on."""
    fcl.collide(one, other, data.request, data.result)
    return False


def _primitive(library: ModuleType, piece: Piece) -> Any:
    sizes = [2.0 * half for half in piece.size] if piece.kind == "box" else piece.size
    return getattr(library, piece.kind.capitalize())(*sizes)


def _fcl_poses(scene: RandomScene) -> list[Any]:
    quaternions = np.roll(scene.orientations, 1, axis=1)
    return list(map(fcl.Transform, quaternions, scene.positions))


def _fcl_geometry(piece: Piece) -> Any:
    if piece.kind != "hull":
        return _primitive(fcl, piece)
    corners, faces = _surface(piece.points)
    threes = np.full((len(faces), 1), 3)
    return fcl.Convex(corners, len(faces), np.hstack((threes, faces)).flatten())


class Coal:
    """Tests pairs by the tree of coal and its own callback, which collects contacts in C++."""

    def __init__(self, coal: ModuleType, scene: RandomScene) -> None:
        self._coal = coal
        shapes = [_coal_geometry(coal, piece) for piece in scene.pieces]
        # A geometry for each body, as above.
        geometries = [type(shapes[piece])(shapes[piece]) for piece in scene.of.tolist()]
        self._numbers = {geometry.id(): n for n, geometry in enumerate(geometries)}
        self._poses_of_ticks = [_coal_poses(coal, scene.at(tick)) for tick in range(PERIOD)]
        self._poses = self._poses_of_ticks[0]
        self._objects = list(map(coal.CollisionObject, geometries, self._poses))
        self._manager = coal.DynamicAABBTreeCollisionManager()
        for one in self._objects:
            self._manager.registerObject(one)
        self._manager.setup()
        self._max_contacts = len(scene.met) + 1

    def move(self, tick: int) -> None:
        """Chooses the poses of a tick."""
        self._poses = self._poses_of_ticks[tick % PERIOD]

    def managed(self) -> Pairs:
        """Returns all pairs that collide."""
        for one, pose in zip(self._objects, self._poses, strict=True):
            one.setTransform(pose)
            one.computeAABB()
        self._manager.update()
        callback = self._coal.CollisionCallBackDefault()
        callback.data.request.num_max_contacts = self._max_contacts
        self._manager.collide(callback)
        number, contacts = self._numbers, callback.data.result.getContacts()
        return [_sorted(number[c.o1.id()], number[c.o2.id()]) for c in contacts]


def _coal_poses(coal: ModuleType, scene: RandomScene) -> list[Any]:
    return list(map(coal.Transform3s, map(scene.matrix, range(len(scene))), scene.positions))


def _coal_geometry(coal: ModuleType, piece: Piece) -> Any:
    if piece.kind != "hull":
        return _primitive(coal, piece)
    points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    corners, faces = _surface(piece.points)
    for corner in corners:
        points.append(corner)
    for face in faces.tolist():
        triangles.append(coal.Triangle(*face))
    return coal.Convex(points, triangles)


def pybullet_loop(
    client: int, bodies: Sequence[int]
) -> Callable[[Iterable[tuple[int, int]]], Pairs]:
    """Returns a loop that finds the pairs that collide by PyBullet's closest points.

    The bodies keep their poses. A pair is deeper than `COLLIDES` if a closest point has a distance
    of less than minus that.
    """
    closest_points = pybullet.getClosestPoints

    def loop(pairs: Iterable[tuple[int, int]]) -> Pairs:
        return [
            (i, j)
            for i, j in pairs
            if any(
                p[8] < -COLLIDES
                for p in closest_points(bodies[i], bodies[j], 0.0, physicsClientId=client)
            )
        ]

    return loop
