"""Other ways to find all pairs of a crowd that collide: FCL, PyBullet, and coal.

Each is made of the crowd beforehand, and is then timed as it would be used at every tick: it is
given the bodies' poses anew, which are made beforehand, too, and tells the pairs. A pair is
(i, j), i < j.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from types import ModuleType
from typing import Any, TypeAlias

import fcl
import numpy as np
import pybullet
from scipy.spatial import ConvexHull

from benchmarks.crowds import Crowd, Piece
from ssduck.geometry.arrays import Array, Triangles

Pairs: TypeAlias = list[tuple[int, int]]
# What is deeper, metres, collides, as ssduck has it.
COLLIDES = 1e-6


def coal_or_none() -> ModuleType | None:
    """The package, where it is installed."""
    try:
        import coal
    except ImportError:
        return None
    found: ModuleType = coal
    return found


def _sorted(i: int, j: int) -> tuple[int, int]:
    return (i, j) if i < j else (j, i)


def _surface(points: Array) -> tuple[Array, Triangles]:
    """The corners of a hull, and its triangles, turned outward."""
    hull = ConvexHull(points)
    number = np.zeros(len(points), np.int32)
    number[hull.vertices] = np.arange(len(hull.vertices))
    corners, faces = points[hull.vertices], number[hull.simplices]
    a, b, c = (corners[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return corners, faces


class Fcl:
    """Python-fcl's objects, pair by pair in a loop, or in a tree of boxes."""

    def __init__(self, crowd: Crowd) -> None:
        # A geometry for each body: its contacts tell of geometries only.
        self._geometries = [_of_fcl(crowd.piece(body)) for body in range(len(crowd))]
        self._numbers = {id(geometry): n for n, geometry in enumerate(self._geometries)}
        turns = [np.roll(turn, 1) for turn in crowd.orientations]
        self._poses = list(map(fcl.Transform, turns, crowd.positions))
        self._objects = list(map(fcl.CollisionObject, self._geometries, self._poses))
        self._manager = fcl.DynamicAABBTreeCollisionManager()
        self._manager.registerObjects(self._objects)
        self._manager.setup()

    def place(self) -> None:
        """Give all objects their poses."""
        for one, pose in zip(self._objects, self._poses, strict=True):
            one.setTransform(pose)

    def loop(self, pairs: Iterable[tuple[int, int]]) -> Pairs:
        """Those of some pairs that collide, each asked about by itself."""
        objects, collide, request = self._objects, fcl.collide, fcl.CollisionRequest()
        return [
            (i, j)
            for i, j in pairs
            if collide(objects[i], objects[j], request, fcl.CollisionResult())
        ]

    def managed(self) -> Pairs:
        """All pairs that collide, of those whose boxes the tree finds to meet."""
        self.place()
        self._manager.update()
        data = fcl.CollisionData(request=fcl.CollisionRequest())
        self._manager.collide(data, _collide)
        number = self._numbers
        return [_sorted(number[id(c.o1)], number[id(c.o2)]) for c in data.result.contacts]


def _collide(one: Any, other: Any, data: Any) -> bool:
    """What the tree calls: it notes a contact, and goes on."""
    fcl.collide(one, other, data.request, data.result)
    return False


def _primitive(library: ModuleType, piece: Piece) -> Any:
    sizes = [2.0 * half for half in piece.size] if piece.kind == "box" else piece.size
    return getattr(library, piece.kind.capitalize())(*sizes)


def _of_fcl(piece: Piece) -> Any:
    if piece.kind != "hull":
        return _primitive(fcl, piece)
    corners, faces = _surface(piece.points)
    threes = np.full((len(faces), 1), 3)
    return fcl.Convex(corners, len(faces), np.hstack((threes, faces)).flatten())


class Coal:
    """Coal's tree, with the callback that it comes with: it collects contacts without Python."""

    def __init__(self, coal: ModuleType, crowd: Crowd) -> None:
        self._coal = coal
        kinds = [_of_coal(coal, piece) for piece in crowd.pieces]
        # A geometry for each body, as above.
        geometries = [type(kinds[piece])(kinds[piece]) for piece in crowd.of.tolist()]
        self._numbers = {geometry.id(): n for n, geometry in enumerate(geometries)}
        matrices = map(crowd.matrix, range(len(crowd)))
        self._poses = list(map(coal.Transform3s, matrices, crowd.positions))
        self._objects = list(map(coal.CollisionObject, geometries, self._poses))
        self._manager = coal.DynamicAABBTreeCollisionManager()
        for one in self._objects:
            self._manager.registerObject(one)
        self._manager.setup()
        self._most = len(crowd.met) + 1

    def managed(self) -> Pairs:
        """All pairs that collide."""
        for one, pose in zip(self._objects, self._poses, strict=True):
            one.setTransform(pose)
            one.computeAABB()
        self._manager.update()
        found = self._coal.CollisionCallBackDefault()
        found.data.request.num_max_contacts = self._most
        self._manager.collide(found)
        number, contacts = self._numbers, found.data.result.getContacts()
        return [_sorted(number[c.o1.id()], number[c.o2.id()]) for c in contacts]


def _of_coal(coal: ModuleType, piece: Piece) -> Any:
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
    """Asks PyBullet about the nearest points of some pairs, one by one.

    The bodies are where they are: it is given no poses. Of what is deeper than `COLLIDES` it has
    a point of less than minus that distance.
    """
    ask = pybullet.getClosestPoints

    def loop(pairs: Iterable[tuple[int, int]]) -> Pairs:
        return [
            (i, j)
            for i, j in pairs
            if any(p[8] < -COLLIDES for p in ask(bodies[i], bodies[j], 0.0, physicsClientId=client))
        ]

    return loop
