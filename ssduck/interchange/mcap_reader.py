"""Reads the poses of MCAP files with Foxglove's schemas, also of those that others wrote.

Each frame is told of in another frame, when the one who tells likes: what is there at a tick is the
last that was told of it (*latest-at*), and a pose in the world is found along the tree of frames.
Times are whole nanoseconds until the end.
"""

from __future__ import annotations

import json
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from ssduck.adapters.optional import library
from ssduck.errors import ArgumentError, RecordError, SelectScriptError
from ssduck.formatting import count_of
from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.poses import compose, unit_quaternions
from ssduck.interchange.mcap import END, METADATA, NANO, TICKS
from ssduck.interchange.pose_batches import ImportedPoses
from ssduck.schema import POSE

# A file gives at most so many poses, and about so many at once.
MAX_POSES, _AT_ONCE = 10**8, 1 << 18
# The largest number of ticks per second: one for each nanosecond.
MAX_RATE = 1e9
# The parent of a frame that a message says is gone.
_GONE = -1
# The type of a deletion that means all that is in the scene; others mean one id.
_ALL = 1


def read_poses(file: Path, rate: float | None = None) -> ImportedPoses:
    """Returns the poses of a file in its fixed frame, and what the file says of them.

    Transforms (`foxglove.FrameTransform`, `foxglove.FrameTransforms`) tell of frames by their
    names, and poses (`foxglove.PoseInFrame`) by their topics; deletions of a `foxglove.SceneUpdate`
    end them, by ids that are names of frames. The frame that is in no other one is the world. Other
    messages do not tell of named frames.

    The ticks are `rate` a second, from the first message on, or those that ssduck wrote. In other
    files, a tick is at the time of a message; it takes in earlier messages of other frames, which
    are less than a period of the most frequent frame before. A message without a time of its own
    has the one of its log.
    """
    library("mcap", "mcap")
    library("mcap_protobuf", "mcap")

    try:
        return _read(file, rate)
    except SelectScriptError:
        raise
    except Exception as error:  # the libraries of the compressions raise errors of their own
        raise RecordError(f"{file} cannot be read as an MCAP file: {error}") from error


def _read(file: Path, rate: float | None) -> ImportedPoses:
    from mcap.records import Channel, Message, Metadata, Schema
    from mcap.stream_reader import StreamReader

    told = _Told()
    about: dict[str, Any] = {}
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    with file.open("rb") as stream:
        for record in StreamReader(stream, validate_crcs=True).records:
            match record:
                case Metadata() if record.name == METADATA:
                    about = {name: json.loads(value) for name, value in record.metadata.items()}
                case Schema():
                    schemas[record.id] = record
                case Channel():
                    channels[record.id] = record
                case Message():
                    channel = channels[record.channel_id]
                    told.read(schemas.get(channel.schema_id), channel, record)
    if not told.placed:
        raise RecordError(
            f"{file} has no poses of named frames ({', '.join(_READERS)}); its other topics: "
            f"{', '.join(sorted(told.unread)) or 'none'}"
        )
    known: dict[str, Any] = {
        name: about[name] for name in ("world", "tags", "kinds") if name in about
    }
    ordered, unread = _in_order(told), sorted(told.unread)
    ticks = _ticks_of(file, told, ordered, rate)
    if rate is None:
        lost = {
            "before another one of the same frame at the same time": _repeated(ordered, ticks),
            "after the last tick": len(ordered.places) - int(ticks.ends[-1]),
        }
        unread += [f"{count_of(n, 'pose')} {where}" for where, n in lost.items() if n]
    frames = _Tree(file, [*told.numbers], ordered, ticks)
    return ImportedPoses(frames.names, frames.tables(), known, unread)


# -- messages ---------------------------------------------------------------------------------


def _decoders() -> Any:
    from mcap_protobuf.decoder import DecoderFactory

    return DecoderFactory()


@dataclass
class _Told:
    """What a file tells of frames, message after message: poses, and that a frame is gone."""

    # Arrays, since a pose may take some bytes of a file only.
    poses: array[float] = field(default_factory=lambda: array("d"))
    # The times that messages have of their own, and those of the log, ns.
    stamps: array[int] = field(default_factory=lambda: array("q"))
    logged: array[int] = field(default_factory=lambda: array("q"))
    # The number of each pose's frame, and that of the frame that it is relative to.
    places: array[int] = field(default_factory=lambda: array("q"))
    parents: array[int] = field(default_factory=lambda: array("q"))
    numbers: dict[str, int] = field(default_factory=dict)
    # The frames that have a pose; others only have frames in them.
    placed: set[int] = field(default_factory=set)
    # What is in the scene, by its ids.
    drawn: set[str] = field(default_factory=set)
    unread: set[str] = field(default_factory=set)
    # Number and time of each tick that ssduck wrote, and the number of poses until then.
    ticks: array[int] = field(default_factory=lambda: array("q"))
    times: array[float] = field(default_factory=lambda: array("d"))
    ends: array[int] = field(default_factory=lambda: array("q"))
    decoders: Any = field(default_factory=_decoders)

    def read(self, schema: Any, channel: Any, message: Any) -> None:
        """Adds what a message tells of frames or of a tick."""
        if channel.topic == TICKS and channel.message_encoding == "json":
            content = json.loads(message.data)
            self.ticks.append(content["tick"])
            self.times.append(float(content["time"]))
            self.ends.append(len(self.places))
            return
        kind = None if schema is None else schema.name
        decode = self.decoders.decoder_for(channel.message_encoding, schema)
        if decode is None or kind not in _READERS:
            self.unread.add(channel.topic)
            return
        _READERS[kind](self, channel.topic, message.log_time, decode(message.data))

    def place(
        self, told: Any, logged: int, parent: str, name: str, position: Any, turn: Any
    ) -> None:
        if not name:
            raise ValueError("a message tells of a frame without a name")
        pose = position.x, position.y, position.z, turn.w, turn.x, turn.y, turn.z
        if not any(pose[3:]):
            raise ValueError(f"a message of {name!r} has the quaternion 0, 0, 0, 0: no orientation")
        place = self.numbers.setdefault(name, len(self.numbers))
        self.placed.add(place)
        self._add(told, logged, place, self.numbers.setdefault(parent, len(self.numbers)), pose)

    def remove(self, told: Any, logged: int, name: str) -> None:
        """Notes that a frame is gone, if there is one of that name."""
        if self.numbers.get(name) in self.placed:
            self._add(told, logged, self.numbers[name], _GONE, (0.0,) * len(POSE))

    def _add(self, told: Any, logged: int, place: int, parent: int, pose: Any) -> None:
        seconds, nanos = told.timestamp.seconds, told.timestamp.nanos
        for moment in (seconds * NANO + nanos, logged if not (seconds or nanos) else 0):
            if abs(moment) >= END * NANO:
                raise ValueError(f"a message has a time of {moment} ns")
        self.stamps.append(seconds * NANO + nanos)
        self.logged.append(min(logged, int(END * NANO)))
        self.places.append(place)
        self.parents.append(parent)
        self.poses.extend(pose)


def _read_transform(told: _Told, _: str, logged: int, one: Any) -> None:
    names = one.parent_frame_id, one.child_frame_id
    told.place(one, logged, *names, one.translation, one.rotation)


def _read_transforms(told: _Told, topic: str, logged: int, message: Any) -> None:
    for one in message.transforms:
        _read_transform(told, topic, logged, one)


def _read_pose(told: _Told, topic: str, logged: int, one: Any) -> None:
    pose = one.pose
    told.place(one, logged, one.frame_id, topic.strip("/"), pose.position, pose.orientation)


def _read_scene(told: _Told, _: str, logged: int, message: Any) -> None:
    told.drawn.update(entity.id for entity in message.entities)
    for one in message.deletions:
        gone = sorted(told.drawn) if one.type == _ALL else [one.id]
        for name in gone:
            told.remove(one, logged, name)
        told.drawn.difference_update(gone)


_READERS = {
    "foxglove.FrameTransform": _read_transform,
    "foxglove.FrameTransforms": _read_transforms,
    "foxglove.PoseInFrame": _read_pose,
    "foxglove.SceneUpdate": _read_scene,
}


# -- times ------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Ordered:
    """What a file tells of frames, in the order of time."""

    moments: Indices  # the times, ns, (messages,), ascending
    places: Indices  # the frames
    parents: Indices  # the frames that they are relative to; `_GONE`
    poses: Array  # x, y, z, qw, qx, qy, qz in the parent, (messages, 7)


@dataclass(frozen=True, eq=False)
class _Ticks:
    """The ticks: their numbers, their times, s, and the number of messages until each, (ticks,)."""

    numbers: Indices
    times: Array
    ends: Indices


def _in_order(told: _Told) -> _Ordered:
    moments = _moments(told)
    order = np.argsort(moments, kind="stable")
    poses = np.array(told.poses).reshape(-1, len(POSE))
    places, parents = np.array(told.places), np.array(told.parents)
    return _Ordered(moments[order], places[order], parents[order], poses[order])


def _repeated(ordered: _Ordered, ticks: _Ticks) -> int:
    """Returns how many poses are followed by another one of the same frame in the same tick."""
    tick = np.searchsorted(ticks.ends, np.arange(len(ordered.places)), side="right")
    by_frame = np.lexsort((tick, ordered.places))
    first, second = by_frame[:-1], by_frame[1:]
    again = (tick[first] == tick[second]) & (ordered.places[first] == ordered.places[second])
    again &= (ordered.poses[first] != ordered.poses[second]).any(axis=1)
    return int((again & (ordered.parents[second] != _GONE)).sum())


def _moments(told: _Told) -> Indices:
    """Returns the times of messages, ns: those of the log where a stamp is 0, and means none.

    A stamp of 0 is a time where the others begin nearer to 0 than to the log, as those of a
    simulation whose log has the time of the day.
    """
    moments, logged = np.array(told.stamps), np.array(told.logged)
    is_unset = moments == 0
    others = moments[~is_unset]
    if len(others):
        beyond = np.maximum(others.min() - logged, logged - others.max())
        is_unset &= beyond <= np.abs(others).min()
    moments[is_unset] = logged[is_unset]
    return moments


def _ticks_of(file: Path, told: _Told, ordered: _Ordered, rate: float | None) -> _Ticks:
    """Returns the ticks of a grid; or those that ssduck wrote; or else those of the messages."""
    moments, frames = ordered.moments, len(told.numbers)
    if rate is not None:
        count = int((moments[-1] - moments[0]) * (rate / NANO)) + 1
        if count * frames > MAX_POSES:
            raise ArgumentError(f"rate: {_too_many(count, frames)}")
        steps = np.arange(count)
        grid = moments[0] + np.rint(steps * (NANO / rate) if count > 1 else steps).astype(np.int64)
        ends = np.searchsorted(moments, grid, side="right")
        return _Ticks(steps, grid / NANO, ends)
    ends = np.array(told.ends) if told.ends else _ends(ordered)
    if len(ends) * frames > MAX_POSES:
        raise RecordError(
            f"{file}: {_too_many(len(ends), frames)}; give the ticks per second, rate="
        )
    if told.ends:
        return _Ticks(np.array(told.ticks), np.array(told.times), ends)
    return _Ticks(np.arange(len(ends)), moments[ends - 1] / NANO, ends)


def _too_many(ticks: int, frames: int) -> str:
    return f"{ticks:,} ticks of {frames:,} frames are more than {MAX_POSES:,} poses"


def _ends(ordered: _Ordered) -> Indices:
    """Returns the number of messages until the end of each tick.

    A tick ends before a frame is told of again, and before a period of the most frequent frame is
    over: no message is lost, and what comes at about the same time is in one tick.
    """
    moments = ordered.moments
    most = np.argmax(np.bincount(ordered.places))
    own = np.diff(np.unique(moments[ordered.places == most]))
    period = int(np.median(own)) if len(own) else 0
    starts = np.flatnonzero(np.diff(moments, prepend=moments[0] - 1)).tolist()
    places, ends = ordered.places.tolist(), []
    seen: set[int] = set()
    begin = 0
    for start, stop in zip(starts, [*starts[1:], len(moments)], strict=True):
        frames, moment = set(places[start:stop]), int(moments[start])
        if seen and (moment - begin >= period or not seen.isdisjoint(frames)):
            ends.append(start)
            seen = set()
        if not seen:
            begin = moment
        seen |= frames
    return np.array([*ends, len(moments)])


# -- frames -----------------------------------------------------------------------------------


class _Tree:
    """The poses of frames in the world, along the tree of frames."""

    def __init__(self, file: Path, names: list[str], ordered: _Ordered, ticks: _Ticks) -> None:
        self._file, self._all = file, names
        self._ordered, self._ticks = ordered, ticks
        children = {int(place): None for place in ordered.places}
        roots = sorted(set(ordered.parents.tolist()) - {_GONE} - set(children))
        if len(roots) != 1:
            raise RecordError(self._no_tree(roots))
        (self._root,) = roots
        self._children = np.array([*children])
        self.names = [names[place] for place in children]

    def _no_tree(self, roots: list[int]) -> str:
        if not roots:
            return f"{self._file}: each frame is relative to another one, in a circle"
        ordered, told = self._ordered, []
        for root in roots[:2]:
            child = ordered.places[np.argmax(ordered.parents == root)]
            told.append((self._all[child], self._all[root]))
        (first, parent), (second, other) = told
        return (
            f"{self._file}: {first!r} is relative to {parent!r}, and {second!r} to {other!r}: "
            "ssduck reads one tree of frames; add a message that places one of them in the other, "
            "or leave out topics (`mcap filter`)"
        )

    def tables(self) -> Iterator[pa.Table]:
        """Yields the poses in the world, some ticks at a time."""
        ends, count = self._ticks.ends, len(self._all)
        ticks = np.searchsorted(ends, np.arange(len(self._ordered.moments)), side="right")
        last = np.full(count, -1)
        at_once = max(_AT_ONCE // count, 1)
        for start in range(0, len(ends), at_once):
            stop = min(start + at_once, len(ends))
            latest = np.full((stop - start, count), -1)
            latest[0] = last
            first = 0 if start == 0 else int(ends[start - 1])
            told = np.arange(first, ends[stop - 1])
            # Of several messages of a frame in a tick, numpy keeps the last one.
            latest[ticks[told] - start, self._ordered.places[told]] = told
            np.maximum.accumulate(latest, axis=0, out=latest)
            last = latest[-1]
            yield self._table(start, *self._in_world(latest, start))

    def _in_world(self, latest: Indices, start: int) -> tuple[Array, Indices]:
        """Returns the poses of the latest messages, (ticks, frames, 7), and their frames."""
        root, nowhere = self._root, len(self._all)
        above = np.full((len(latest), nowhere + 1), nowhere)
        parents = self._ordered.parents[latest]
        above[:, :nowhere] = np.where((latest < 0) | (parents == _GONE), nowhere, parents)
        above[:, root] = root
        poses = np.zeros((*above.shape, len(POSE)))
        poses[..., 3] = 1.0
        poses[:, :nowhere][latest >= 0] = self._ordered.poses[latest[latest >= 0]]
        for _ in range(nowhere.bit_length() + 1):
            tick, frame = np.nonzero((above != root) & (above != nowhere))
            if not len(tick):
                return poses, above
            # The pose in the parent's parent, for all at once: half of the way is left.
            parent = above[tick, frame]
            outer, inner = poses[tick, parent], poses[tick, frame]
            turned = [unit_quaternions(each[:, 3:]) for each in (outer, inner)]
            place, turn = compose(outer[:, :3], turned[0], inner[:, :3], turned[1])
            poses[tick, frame] = np.concatenate((place, turn), axis=1)
            above[tick, frame] = above[tick, parent]
        raise RecordError(
            f"{self._file}: at {self._ticks.times[start + tick[0]]:g} s, "
            f"{self._all[frame[0]]!r} is relative to itself, through other frames"
        )

    def _table(self, start: int, poses: Array, above: Indices) -> pa.Table:
        """Returns the rows of the frames that are in the world, in the order of the ticks."""
        tick, child = np.nonzero(above[:, self._children] == self._root)
        rows = poses[tick, self._children[child]]
        names = pa.DictionaryArray.from_arrays(pa.array(child, pa.int32()), pa.array(self.names))
        return pa.table(
            {
                "tick": self._ticks.numbers[start + tick],
                "time": self._ticks.times[start + tick],
                "name": names,
                **{name: rows[:, place] for place, name in enumerate(POSE)},
            }
        )
