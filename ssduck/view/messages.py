"""The binary messages to the page: the scene, poses of links that moved, and recorded poses.

Numbers are little-endian. The first number, of 32 bits, is the kind of the message. A scene has the
length of its head, the head as JSON, and then the vertices (float32) and triangles (uint32) of its
meshes. Poses have a count, the time (float64), the tick (float64), the rows of the links (uint32),
and for each row x y z w x y z (float32). A track has the length of its head, the head as JSON, the
poses of all links at its first tick, and those of the moving ones at all ticks (float32).
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from ssduck.geometry.shapes import Geometry
from ssduck.geometry.solids import solid_of
from ssduck.simulators.interface import Body, VisualShape
from ssduck.view.frames import Frame, Poses
from ssduck.view.tracks import Track
from ssduck.world.layout import EntityInfo

SCENE, POSES, TRACK = 1, 2, 3
# The types of geometries that the page makes by itself.
_PRIMITIVES = frozenset(("box", "sphere", "cylinder", "capsule", "plane"))


def poses_message(frame: Frame, last: Poses | None) -> bytes:
    """Returns the message of the links that moved since the last poses; of all, for None."""
    poses = frame.poses
    if last is None:
        rows = np.arange(len(poses), dtype=np.uint32)
    else:
        # Poses that are not numbers do not equal themselves: they are sent once only.
        moved = (poses != last) & ~(np.isnan(poses) & np.isnan(last))
        rows = np.flatnonzero(moved.any(axis=1)).astype(np.uint32)
    head = struct.pack("<IIdd", POSES, len(rows), frame.time, frame.number)
    return head + rows.astype("<u4").tobytes() + poses[rows].astype("<f4").tobytes()


def track_message(id: Any, track: Track) -> bytes:
    """Returns the message of recorded poses, which answers the question of an id."""
    head = {
        "id": id,
        "first": track.first,
        "count": len(track.poses),
        "links": len(track.base),
        "rows": track.moving.tolist(),
    }
    text = _padded(head)
    poses = track.base.astype("<f4").tobytes() + track.poses.astype("<f4").tobytes()
    return struct.pack("<II", TRACK, len(text)) + text + poses


def scene_message(
    frame: Frame, visuals: Callable[[Body], list[VisualShape]], about: dict[str, Any]
) -> bytes:
    """Returns the message of a scene.

    Args:
        frame: a tick with the entities.
        visuals: returns what is drawn of a body.
        about: further facts for the page.
    """
    meshes = _Meshes()
    owners = {info.body: info for info in frame.layout.entities if info.body is not None}
    links: list[list[Any]] = []
    shapes: list[list[Any]] = []
    for body in frame.bodies:
        first, info = len(links), owners[body]
        links += [[info.id, number, link.name] for number, link in enumerate(body.links)]
        if body not in frame.hidden:
            shapes += [_shape(first, each, meshes) for each in visuals(body)]
    head = {
        **about,
        "entities": [_entity(info) for info in frame.layout.entities],
        "links": links,
        "shapes": shapes,
        "geometries": meshes.descriptions,
    }
    text = _padded(head)
    return struct.pack("<II", SCENE, len(text)) + text + b"".join(meshes.arrays())


def _padded(head: dict[str, Any]) -> bytes:
    """Returns JSON whose length is a multiple of 4, so that numbers may follow."""
    text = json.dumps(head, separators=(",", ":")).encode()
    return text + b" " * (-len(text) % 4)


def _entity(info: EntityInfo) -> dict[str, Any]:
    return {"id": info.id, "name": info.name, "kind": info.kind, "host": info.mount[0]}


def _shape(first: int, shape: VisualShape, meshes: _Meshes) -> list[Any]:
    """Returns a shape: the row of its link, its geometry, its pose there, and its colour."""
    pose = [*map(float, shape.position), *map(float, shape.orientation)]
    colour = None if shape.colour is None else list(map(float, shape.colour))
    return [first + shape.link, meshes.number_of(shape.geometry), pose, colour]


class _Meshes:
    """The geometries of a scene, each of them once.

    Attributes:
        descriptions: type and size of each; of a mesh, the places of its vertices and triangles.
    """

    def __init__(self) -> None:
        self.descriptions: list[dict[str, Any]] = []
        self._numbers: dict[str, int] = {}
        self._vertices: list[npt.NDArray[Any]] = []
        self._faces: list[npt.NDArray[Any]] = []
        self._counts = [0, 0]

    def number_of(self, geometry: Geometry) -> int:
        """Returns the number of a geometry, which is added if it is new."""
        if geometry.key not in self._numbers:
            self._numbers[geometry.key] = len(self.descriptions)
            self.descriptions.append({"type": geometry.type, "size": list(geometry.size)})
            if geometry.type not in _PRIMITIVES:
                self.descriptions[-1] |= {"type": "mesh", **self._add(geometry)}
        return self._numbers[geometry.key]

    def _add(self, geometry: Geometry) -> dict[str, Any]:
        surface = solid_of(geometry).surface
        places = {
            "vertices": [self._counts[0], len(surface.vertices)],
            "faces": [self._counts[1], len(surface.faces)],
        }
        self._counts[0] += len(surface.vertices)
        self._counts[1] += len(surface.faces)
        self._vertices.append(surface.vertices.astype("<f4"))
        self._faces.append(surface.faces.astype("<u4"))
        return places

    def arrays(self) -> Iterator[bytes]:
        """Yields the vertices and the triangles of all meshes."""
        for part in (*self._vertices, *self._faces):
            yield part.tobytes()
