"""The poses of all links of a world as they are shown: at a tick, at many, and as messages.

The messages to the page are binary, with little-endian numbers of so many bits (u unsigned, f
float). The first one is the kind of the message, and n a length or a count:

    scene:  1 u32 | n u32 | head: n bytes of JSON | vertices f32 | triangles u32
    poses:  2 u32 | n u32 | time f64 | tick f64 | rows of links u32 (n) | poses f32 (n, 7)
    track:  3 u32 | n u32 | head: n bytes of JSON | poses at the first tick f32 (links, 7) |
            poses of the moving links f32 (ticks, moving, 7)

Vertices and triangles are those of all meshes. A pose is x y z, w x y z.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Indices
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.geometry.solids import solid_of
from ssduck.interchange.motion import fill, rows_of
from ssduck.recording.replay.record import Record
from ssduck.recording.replay.restore import links_of
from ssduck.schema import POSE
from ssduck.simulators.interface import Body, LinkPoses
from ssduck.world.layout import EntityInfo, TableLayout
from ssduck.world.snapshot import Snapshot

Poses = npt.NDArray[np.float32]

# The numbers of a pose: x y z, w x y z.
_POSE_SIZE = 7


@dataclass(frozen=True, eq=False)
class Frame:
    """The poses of all links at a tick.

    Attributes:
        layout: the entities; the same object while they are the same.
        hidden: the bodies that are not drawn; the same object until they change.
        bodies: the bodies, in the order of their links among the poses.
        link_poses: the poses of the links, which are never written to.
        number: the number of the tick.
        time: its simulated time, s.
    """

    layout: TableLayout
    hidden: frozenset[Body]
    bodies: tuple[Body, ...]
    link_poses: tuple[LinkPoses, ...]
    number: int
    time: float

    @classmethod
    def of(cls, snapshot: Snapshot) -> Frame:
        """Returns the frame of a tick; it copies nothing, so that a step costs no more."""
        groups = tuple(snapshot.body_groups)
        bodies = tuple(body for group, _ in groups for body in group.bodies)
        poses = tuple(poses for _, poses in groups)
        layout, hidden = snapshot.layout, snapshot.hidden
        return cls(layout, hidden, bodies, poses, snapshot.number, snapshot.time)

    @cached_property
    def poses(self) -> Poses:
        """The poses of the links, (links, 7): x y z, w x y z."""
        parts = [np.hstack((each.positions, each.states[:, 3:7])) for each in self.link_poses]
        return np.concatenate([np.zeros((0, _POSE_SIZE)), *parts]).astype(np.float32)

    @cached_property
    def ids(self) -> tuple[int, ...]:
        """The ids of the entities of the bodies."""
        ids = {body: id for id, body in self.layout.bodies}
        return tuple(ids[body] for body in self.bodies)

    @property
    def hidden_ids(self) -> frozenset[int]:
        """The ids of the entities that are not drawn."""
        return frozenset(
            id for id, body in zip(self.ids, self.bodies, strict=True) if body in self.hidden
        )

    def has_same_scene(self, other: Frame) -> bool:
        """Checks whether another frame has the same entities, with the same ones hidden."""
        if self.layout is other.layout and self.hidden is other.hidden:
            return True
        return self.ids == other.ids and self.hidden_ids == other.hidden_ids


# -- tracks -----------------------------------------------------------------------------------


# The bytes of the poses of one track; a scene with many links has fewer ticks in it.
MAX_BYTES = 16 << 20


@dataclass(frozen=True, eq=False)
class Track:
    """The poses of the links of a scene at consecutive recorded ticks.

    Attributes:
        first: the place of the first tick among those of the record.
        base: the poses at the first tick, (links, 7): x y z, w x y z.
        moving: the rows of the links that move.
        poses: their poses at all ticks, (ticks, moving, 7).
    """

    first: int
    base: Poses
    moving: npt.NDArray[np.uint32]
    poses: Poses


def track_of(record: Record, frame: Frame, first: int, count: int) -> Track | None:
    """Returns the poses at some recorded ticks; None if the scene is another one at any of them."""
    links = sum(len(body.links) for body in frame.bodies)
    count = min(count, max(1, MAX_BYTES // (4 * _POSE_SIZE * max(links, 1))))
    with record.world.lock:
        record.check_open()
        ticks = record.ticks.numbers[first : first + count].copy()
        if not len(ticks):
            return None
        ends = int(ticks[0]), int(ticks[-1])
        entities = record.fetch("entities", *ends)
        parts = record.fetch(links_of(record.tables), *ends)
    if not _has_scene(entities, frame, len(ticks)):
        return None
    poses = np.full((len(ticks), links, _POSE_SIZE), np.nan, dtype=np.float32)
    single, several = _places(frame)
    fill(poses, [rows_of(entities, ("id",), POSE)], ticks, single)
    fill(poses, [rows_of(parts, ("entity", "link"), POSE)], ticks, several)
    with np.errstate(invalid="ignore"):  # a NaN differs from itself; a link of NaN alone is at rest
        is_moving = (poses != poses[:1]).any(axis=(0, 2)) & ~np.isnan(poses).all(axis=(0, 2))
    moving = np.flatnonzero(is_moving)
    return Track(first, poses[0], moving.astype(np.uint32), np.ascontiguousarray(poses[:, moving]))


def _places(frame: Frame) -> tuple[dict[tuple[int, int], int], ...]:
    """Returns the rows of links among poses, by entity and link.

    First those of bodies with a single link, which the table of entities has, then of the others,
    which the table of links has.
    """
    single, several = dict[tuple[int, int], int](), dict[tuple[int, int], int]()
    row = 0
    for id, body in zip(frame.ids, frame.bodies, strict=True):
        places = single if len(body.links) == 1 else several
        for link in range(len(body.links)):
            places[id, link] = row
            row += 1
    return single, several


def _has_scene(entities: Any, frame: Frame, ticks: int) -> bool:
    """Checks whether rows of entities are those of a scene at each of a number of ticks."""
    ids: Indices = entities["id"].to_numpy()
    expected = sorted(info.id for info in frame.layout.entities)
    found, counts = np.unique(ids, return_counts=True)
    if found.tolist() != expected or (counts != ticks).any():
        return False
    is_hidden = ~entities["visible"].to_numpy(zero_copy_only=False).astype(bool)
    bodies = np.isin(ids, frame.ids)
    should_be = np.isin(ids, sorted(frame.hidden_ids))
    return bool((is_hidden == should_be)[bodies].all())


# -- messages ---------------------------------------------------------------------------------


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
    frame: Frame, visuals: Callable[[Body], Sequence[PlacedGeometry]], camera: dict[str, Any]
) -> bytes:
    """Returns the message of a scene.

    Args:
        frame: a frame of the scene.
        visuals: returns the shapes of a body that are drawn.
        camera: the part of the head that has the camera.
    """
    geometries = _Geometries()
    owners = {info.body: info for info in frame.layout.entities if info.body is not None}
    links: list[list[Any]] = []
    shapes: list[list[Any]] = []
    for body in frame.bodies:
        first, info = len(links), owners[body]
        links += [[info.id, number, link.name] for number, link in enumerate(body.links)]
        if body not in frame.hidden:
            shapes += [_shape(first, each, geometries) for each in visuals(body)]
    head = {
        **camera,
        "entities": [_entity(info) for info in frame.layout.entities],
        "links": links,
        "shapes": shapes,
        "geometries": geometries.descriptions,
    }
    text = _padded(head)
    return struct.pack("<II", SCENE, len(text)) + text + b"".join(geometries.arrays())


def _padded(head: dict[str, Any]) -> bytes:
    """Returns JSON whose length is a multiple of 4, so that numbers may follow."""
    text = json.dumps(head, separators=(",", ":")).encode()
    return text + b" " * (-len(text) % 4)


def _entity(info: EntityInfo) -> dict[str, Any]:
    return {"id": info.id, "name": info.name, "kind": info.kind, "host": info.mount[0]}


def _shape(first: int, shape: PlacedGeometry, geometries: _Geometries) -> list[Any]:
    """Returns a shape: the row of its link, its geometry, its pose there, and its colour."""
    pose = [*map(float, shape.position), *map(float, shape.orientation)]
    colour = None if shape.colour is None else list(map(float, shape.colour))
    return [first + shape.frame, geometries.number_of(shape.geometry), pose, colour]


class _Geometries:
    """The geometries of a scene, each of them once; those of no simple type have a mesh."""

    def __init__(self) -> None:
        self.descriptions: list[dict[str, Any]] = []
        self._numbers: dict[str, int] = {}
        self._vertices: list[npt.NDArray[Any]] = []
        self._faces: list[npt.NDArray[Any]] = []
        self._counts = [0, 0]  # of vertices and faces, of all meshes

    def number_of(self, geometry: Geometry) -> int:
        """Returns the number of a geometry, which is added if it is new."""
        if geometry.key not in self._numbers:
            self._numbers[geometry.key] = len(self.descriptions)
            self.descriptions.append({"type": geometry.type, "size": list(geometry.size)})
            if geometry.type not in _PRIMITIVES:
                self.descriptions[-1] |= {"type": "mesh", **self._add_mesh(geometry)}
        return self._numbers[geometry.key]

    def _add_mesh(self, geometry: Geometry) -> dict[str, Any]:
        """Adds the surface of a geometry; returns its first vertex and face, and how many."""
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
