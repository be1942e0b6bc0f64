"""Writes an episode as an MCAP file with Foxglove's schemas, and reads poses of such files.

| topic | schema | what it has |
|---|---|---|
| `/tf` | `foxglove.FrameTransforms` | the pose of each frame in the frame `world`, at each tick |
| `/scene` | `foxglove.SceneUpdate` | the shapes of the entities, when they come and go |
| `/ssduck/tick` | JSON | the number of each tick, and its time to the last digit |

The messages of a tick have its simulated time, in whole nanoseconds. The metadata `ssduck` has the
world, the id and the tags of the episode, and the kind of each entity. The extra `mcap` brings the
libraries.
"""

from __future__ import annotations

import json
from array import array
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from ssduck.adapters.optional import library
from ssduck.errors import ArgumentError, RecordError, SelectScriptError
from ssduck.formatting import short_repr
from ssduck.geometry.shapes import PlacedGeometry
from ssduck.interchange.mcap_records import records_of
from ssduck.interchange.meshes import mesh_of
from ssduck.interchange.motion import Frame, Motion
from ssduck.recording.stores.atomic_files import write_with_folders
from ssduck.schema import POSE

WORLD_FRAME = "world"
TRANSFORMS, SCENE, TICKS = "/tf", "/scene", "/ssduck/tick"
METADATA = "ssduck"
_NANO = 10**9
# Times are less, s: signed integers of 64 bits have their nanoseconds.
_END = 9.2e9
_COLOUR = (0.7, 0.7, 0.7, 1.0)
_TICK_SCHEMA = {
    "type": "object",
    "properties": {"tick": {"type": "integer"}, "time": {"type": "number"}},
}


def write_mcap(file: Path, motion: Motion) -> Path:
    """Writes an episode to a file, all or nothing; an existing file is replaced.

    Returns:
        The file.

    Raises:
        UnsupportedError: the extra `mcap` is not installed.
        ArgumentError: a time is negative, or 292 years or more.
        RecordError: the file cannot be written.
    """
    library("mcap", "mcap")
    library("mcap_protobuf", "mcap")
    library("foxglove_schemas_protobuf", "mcap")
    wrong = motion.times[~((motion.times >= 0.0) & (motion.times < _END))]
    if len(wrong):
        raise ArgumentError(
            f"episode {motion.run.number} of {motion.run.world!r} has a tick at {wrong[0]:g} s: "
            "times in an MCAP file are from 0 s to 292 years"
        )
    write_with_folders(file, lambda place: _write(place, motion))
    return file


def _write(place: Path, motion: Motion) -> None:
    with place.open("wb") as stream:
        _write_messages(stream, motion)


def _write_messages(stream: Any, motion: Motion) -> None:
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
    from mcap.writer import Writer

    present = motion.present
    # The checksum of all that is not in a chunk, such as the metadata.
    writer: Any = Writer(stream, enable_data_crcs=True)
    writer.start(library="ssduck")
    schema = writer.register_schema("ssduck.Tick", "jsonschema", json.dumps(_TICK_SCHEMA).encode())
    ticks = writer.register_channel(TICKS, "json", schema)
    scene = _channel(writer, SCENE, SceneUpdate)
    transforms = _channel(writer, TRANSFORMS, FrameTransforms)
    writer.add_metadata(METADATA, _about(motion))
    before = np.zeros(len(motion.frames), dtype=bool)
    for number, (tick, time) in enumerate(
        zip(motion.ticks.tolist(), motion.times.tolist(), strict=True)
    ):
        moment = round(time * _NANO)
        told = []
        if (present[number] != before).any():
            update = _scene(motion, present[number], before, moment)
            told.append((scene, update.SerializeToString()))
            before = present[number]
        poses = _transforms(motion, number, present[number], moment)
        told.append((transforms, poses.SerializeToString()))
        told.append((ticks, json.dumps({"tick": tick, "time": time}).encode()))
        for channel, data in told:
            writer.add_message(channel, log_time=moment, publish_time=moment, data=data)
    writer.finish()


def _channel(writer: Any, topic: str, kind: Any) -> int:
    """Returns the number of a new channel of messages of a kind."""
    from mcap_protobuf.schema import register_schema

    channel: int = writer.register_channel(topic, "protobuf", register_schema(writer, kind))
    return channel


def _about(motion: Motion) -> dict[str, str]:
    kinds = {frame.name: frame.entity.kind for frame in motion.frames if not frame.link}
    values = {
        "world": motion.run.world,
        "episode": motion.run.number,
        "id": motion.run.id,
        "tags": dict(motion.tags),
        "kinds": kinds,
    }
    return {name: json.dumps(value) for name, value in values.items()}


def _stamp(moment: int) -> Any:
    from google.protobuf.timestamp_pb2 import Timestamp

    seconds, nanos = divmod(moment, _NANO)
    return Timestamp(seconds=seconds, nanos=nanos)


def _transforms(motion: Motion, number: int, present: Any, moment: int) -> Any:
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

    stamp, transforms = _stamp(moment), []
    for frame, pose, is_there in zip(
        motion.frames, motion.poses[number].tolist(), present.tolist(), strict=True
    ):
        if is_there:
            one = FrameTransform(
                timestamp=stamp, parent_frame_id=WORLD_FRAME, child_frame_id=frame.name
            )
            one.translation.x, one.translation.y, one.translation.z = pose[:3]
            one.rotation.w, one.rotation.x, one.rotation.y, one.rotation.z = pose[3:]
            transforms.append(one)
    return FrameTransforms(transforms=transforms)


# -- shapes -----------------------------------------------------------------------------------


def _scene(motion: Motion, present: Any, before: Any, moment: int) -> Any:
    """Returns the entities that came since the tick before, and those that went."""
    from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

    stamp, update = _stamp(moment), SceneUpdate()
    for frame, is_there, was_there in zip(motion.frames, present, before, strict=True):
        if is_there and not was_there:
            update.entities.append(_scene_entity(frame, stamp))
        elif was_there and not is_there:
            kind = SceneEntityDeletion.MATCHING_ID
            update.deletions.append(SceneEntityDeletion(timestamp=stamp, type=kind, id=frame.name))
    return update


def _scene_entity(frame: Frame, stamp: Any) -> Any:
    from foxglove_schemas_protobuf.KeyValuePair_pb2 import KeyValuePair
    from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity

    kind = KeyValuePair(key="kind", value=frame.entity.kind)
    entity = SceneEntity(
        timestamp=stamp,
        frame_id=frame.name,
        id=frame.name,
        frame_locked=True,
        metadata=[kind],
    )
    shapes = frame.entity.body.shapes if frame.entity.body else ()
    for shape in shapes:
        if shape.frame == frame.link:
            _add_shape(entity, shape)
    return entity


def _add_shape(entity: Any, shape: PlacedGeometry) -> None:
    """Adds a shape to an entity of Foxglove's scene, in the frame of its link."""
    size = shape.geometry.size
    sizes: tuple[float, ...] | None = None
    match shape.geometry.type:
        case "box":
            primitive, sizes = entity.cubes.add(), size
        case "sphere":
            primitive, sizes = entity.spheres.add(), (2 * size[0],) * 3
        case "ellipsoid":
            primitive, sizes = entity.spheres.add(), (2 * size[0], 2 * size[1], 2 * size[2])
        case "cylinder":
            primitive, sizes = entity.cylinders.add(), (2 * size[0], 2 * size[0], size[1])
            primitive.bottom_scale = primitive.top_scale = 1.0
        case _:
            primitive = entity.triangles.add()
            vertices, faces = mesh_of(shape.geometry)
            for x, y, z in vertices.tolist():
                primitive.points.add(x=x, y=y, z=z)
            primitive.indices.extend(faces.reshape(-1).tolist())
    position, turn = shape.position.tolist(), shape.orientation.tolist()
    primitive.pose.position.x, primitive.pose.position.y, primitive.pose.position.z = position
    orientation = primitive.pose.orientation
    orientation.w, orientation.x, orientation.y, orientation.z = turn
    if sizes is not None:
        primitive.size.x, primitive.size.y, primitive.size.z = sizes
    colour = primitive.color
    colour.r, colour.g, colour.b, colour.a = _COLOUR


# -- reading ----------------------------------------------------------------------------------


def _decoders() -> Any:
    from mcap_protobuf.decoder import DecoderFactory

    return DecoderFactory()


@dataclass
class _Poses:
    """The poses that a file tells of, message after message."""

    # Arrays, since a pose may take some bytes of a file only.
    poses: array[float] = field(default_factory=lambda: array("d"))
    moments: array[int] = field(default_factory=lambda: array("q"))
    times: array[float] = field(default_factory=lambda: array("d"))
    # The place of each pose's frame in the frames.
    places: array[int] = field(default_factory=lambda: array("q"))
    frames: dict[str, int] = field(default_factory=dict)
    ignored: set[str] = field(default_factory=set)
    # Frames by the frame that they are relative to; a file may change it from message to message.
    children: dict[str, str] = field(default_factory=dict)
    # The number of poses when the last tick was told of.
    told: int = 0
    decoders: Any = field(default_factory=_decoders)

    def add(self, moment: int, parent: str, name: str, position: Any, turn: Any) -> None:
        """Adds the pose of a frame in another one at a time, ns.

        Raises:
            ValueError: the frame has no name, the time is out of bounds, or the pose is no pose.
        """
        if not name:
            raise ValueError("a message tells of a frame without a name")
        if abs(moment) >= _END * _NANO:
            raise ValueError(f"a message of {name!r} has a time of {moment} ns")
        pose = position.x, position.y, position.z, turn.w, turn.x, turn.y, turn.z
        wrong = [number for number in pose if type(number) not in (float, int)]
        if wrong:
            raise ValueError(f"a message of {name!r} has {short_repr(wrong[0])} for a number")
        if not any(pose[3:]):
            raise ValueError(f"a message of {name!r} has the quaternion 0, 0, 0, 0: no orientation")
        self.poses.extend(pose)
        self.children.setdefault(parent, name)
        self.moments.append(moment)
        self.times.append(moment / _NANO)
        self.places.append(self.frames.setdefault(name, len(self.frames)))

    def tell_tick(self, moment: int, time: float) -> None:
        """Gives the poses of a tick its time to the last digit, s.

        Ticks may have the same nanosecond: the poses of each come before what tells of it.
        """
        for place in range(self.told, len(self.moments)):
            if self.moments[place] == moment:
                self.times[place] = time
        self.told = len(self.moments)


def read_poses(file: Path) -> tuple[pa.Table, dict[str, Any]]:
    """Returns the poses of a file in its fixed frame, and what the file says of them.

    Transforms (`foxglove.FrameTransform`, `foxglove.FrameTransforms`) tell of frames by their
    names, and poses (`foxglove.PoseInFrame`) by their topics. Each has to be relative to the same
    frame, which is the world. Other messages do not tell of named frames.

    Returns:
        A table that `ssduck.write_record` takes, and `world`, `tags` and `kinds` if ssduck wrote
        the file, `frame` (the fixed one) and `ignored` (the topics that are not read).

    Raises:
        UnsupportedError: the extra `mcap` is not installed.
        RecordError: the file cannot be read, has no such poses, or has some that are relative to
            another frame than the others.
    """
    library("mcap", "mcap")
    library("mcap_protobuf", "mcap")

    try:
        return _read(file)
    except SelectScriptError:
        raise
    except Exception as error:  # the libraries of the compressions raise errors of their own
        raise RecordError(f"{file} cannot be read as an MCAP file: {error}") from error


def _read(file: Path) -> tuple[pa.Table, dict[str, Any]]:
    from mcap.records import Channel, Message, Metadata, Schema

    found, about = _Poses(), dict[str, Any]()
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    for record in records_of(file):
        match record:
            case Metadata() if record.name == METADATA:
                about = {name: json.loads(value) for name, value in record.metadata.items()}
            case Schema():
                schemas[record.id] = record
            case Channel():
                channels[record.id] = record
            case Message():
                channel = channels[record.channel_id]
                _add_message(found, schemas.get(channel.schema_id), channel, record)
    return _table(found, about, file)


def _add_message(found: _Poses, schema: Any, channel: Any, message: Any) -> None:
    """Adds what a message tells of poses or of a tick."""
    if channel.topic == TICKS and channel.message_encoding == "json":
        found.tell_tick(message.log_time, float(json.loads(message.data)["time"]))
        return
    kind = None if schema is None else schema.name
    decode = found.decoders.decoder_for(channel.message_encoding, schema)
    if decode is None or kind not in _READERS:
        if channel.topic != SCENE:
            found.ignored.add(channel.topic)
        return
    _READERS[kind](found, channel.topic, message.log_time, decode(message.data))


def _moment_of(told: Any) -> int:
    """Returns the time of a message, ns.

    Raises:
        ValueError: it is a text or another value by the schema, which the file brings itself.
    """
    seconds, nanos = told.timestamp.seconds, told.timestamp.nanos
    if type(seconds) is not int or type(nanos) is not int:
        wrong = nanos if type(seconds) is int else seconds
        raise ValueError(f"a message has the time {short_repr(wrong)}, which is no whole number")
    return seconds * _NANO + nanos


def _add_transform(found: _Poses, _: str, __: int, told: Any) -> None:
    moment = _moment_of(told)
    found.add(moment, told.parent_frame_id, told.child_frame_id, told.translation, told.rotation)


def _add_transforms(found: _Poses, topic: str, moment: int, told: Any) -> None:
    for transform in told.transforms:
        _add_transform(found, topic, moment, transform)


def _add_pose(found: _Poses, topic: str, _: int, told: Any) -> None:
    moment = _moment_of(told)
    found.add(moment, told.frame_id, topic.strip("/"), told.pose.position, told.pose.orientation)


_READERS = {
    "foxglove.FrameTransform": _add_transform,
    "foxglove.FrameTransforms": _add_transforms,
    "foxglove.PoseInFrame": _add_pose,
}


def _table(found: _Poses, about: Mapping[str, Any], file: Path) -> tuple[pa.Table, dict[str, Any]]:
    if not found.frames:
        others = ", ".join(sorted(found.ignored)) or "none"
        raise RecordError(
            f"{file} has no poses of named frames ({', '.join(_READERS)}); its other topics: "
            f"{others}"
        )
    fixed = sorted(found.children)
    if len(fixed) > 1:
        raise RecordError(
            f"{file}: {found.children[fixed[1]]!r} is relative to {fixed[1]!r}, and "
            f"{found.children[fixed[0]]!r} to {fixed[0]!r}: ssduck reads poses that are all "
            "relative to one frame"
        )
    times = np.array(found.times)
    order = np.argsort(times, kind="stable")
    poses = np.array(found.poses).reshape(-1, len(POSE))[order]
    rows = pa.table(
        {
            "time": times[order],
            "name": pa.array([*found.frames]).take(pa.array(np.array(found.places)[order])),
            **{name: poses[:, place] for place, name in enumerate(POSE)},
        }
    )
    told = {name: about[name] for name in ("world", "tags", "kinds") if name in about}
    return rows, told | {"frame": fixed[0], "ignored": sorted(found.ignored)}
