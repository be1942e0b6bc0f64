"""Poses of many recorded ticks at once, so that a page goes through them by itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Indices
from ssduck.recording.replay.record import Record
from ssduck.recording.replay.restore import links_of
from ssduck.schema import POSE
from ssduck.view.frames import Frame, Poses

# The bytes of the poses of one track; a scene with many links has fewer ticks in it.
MAX_BYTES = 16 << 20
# The number of links of a body is less.
_FACTOR = 1 << 20


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
    """Returns the poses at some recorded ticks; None if the scene is another one at any of them.

    Args:
        record: the record.
        frame: a tick with the scene.
        first: the place of the first tick among those of the record.
        count: the number of ticks; there may be fewer in the track.
    """
    links = sum(len(body.links) for body in frame.bodies)
    count = min(count, max(1, MAX_BYTES // (28 * max(links, 1))))
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
    poses = np.full((len(ticks), links, 7), np.nan, dtype=np.float32)
    places = _places(frame)
    _fill(poses, ticks, entities, entities["id"].to_numpy() * _FACTOR, places.single)
    keys = parts["entity"].to_numpy() * _FACTOR + parts["link"].to_numpy()
    _fill(poses, ticks, parts, keys, places.several)
    with np.errstate(invalid="ignore"):
        is_moving = (poses != poses[:1]).any(axis=(0, 2)) & ~np.isnan(poses).all(axis=(0, 2))
    moving = np.flatnonzero(is_moving)
    return Track(first, poses[0], moving.astype(np.uint32), np.ascontiguousarray(poses[:, moving]))


@dataclass(frozen=True, eq=False)
class _Places:
    """The rows of links among the poses of a frame, by their keys: id · 2^20 + link.

    Attributes:
        single: of bodies with one link, whose rows are those of entities.
        several: of other bodies.
    """

    single: dict[int, int]
    several: dict[int, int]


def _places(frame: Frame) -> _Places:
    places = _Places({}, {})
    row = 0
    for id, body in zip(frame.ids, frame.bodies, strict=True):
        kind = places.single if len(body.links) == 1 else places.several
        for link in range(len(body.links)):
            kind[id * _FACTOR + link] = row
            row += 1
    return places


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


def _fill(
    poses: Poses,
    ticks: npt.NDArray[np.int64],
    rows: Any,
    keys: npt.NDArray[np.int64],
    places: dict[int, int],
) -> None:
    """Writes the poses of rows, (ticks, links, 7), where their links have a place."""
    if not places:
        return
    known = np.array(sorted(places), dtype=np.int64)
    place = np.clip(np.searchsorted(known, keys), 0, len(known) - 1)
    is_known = known[place] == keys
    links = np.array([places[key] for key in known.tolist()], dtype=np.intp)[place[is_known]]
    tick = np.searchsorted(ticks, rows["tick"].to_numpy()[is_known])
    for column, name in enumerate(POSE):
        values = rows[name].to_numpy(zero_copy_only=False)
        poses[tick, links, column] = values[is_known]
