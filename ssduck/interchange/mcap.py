"""Writes an episode as an MCAP file with Foxglove's schemas; `mcap_reader` reads such files.

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
from pathlib import Path
from typing import Any

import numpy as np

from ssduck.adapters.optional import library
from ssduck.errors import ArgumentError
from ssduck.geometry.shapes import PlacedGeometry
from ssduck.interchange.motion import Motion, mesh_of
from ssduck.recording.stores.files import write_with_folders

WORLD_FRAME = "world"
TRANSFORMS, SCENE, TICKS = "/tf", "/scene", "/ssduck/tick"
METADATA = "ssduck"
NANO = 10**9
# Times are less, s: signed integers of 64 bits have their nanoseconds.
END = 9.2e9
# The type of a deletion of one entity.
_MATCHING_ID = 0
_COLOUR = (0.7, 0.7, 0.7, 1.0)
_TICK_SCHEMA = {
    "type": "object",
    "properties": {"tick": {"type": "integer"}, "time": {"type": "number"}},
}


def write_mcap(file: Path, motion: Motion) -> Path:
    """Writes an episode to a file, all or nothing; an existing file is replaced."""
    library("mcap", "mcap")
    library("mcap_protobuf", "mcap")
    library("foxglove_schemas_protobuf", "mcap")
    wrong = motion.times[~((motion.times >= 0.0) & (motion.times < END))]
    if len(wrong):
        raise ArgumentError(
            f"episode {motion.run.number} of {motion.run.world!r} has a tick at {wrong[0]:g} s: "
            "times in an MCAP file are from 0 s to 292 years"
        )

    def write(place: Path) -> None:
        with place.open("wb") as stream:
            _write(stream, motion)

    write_with_folders(file, write)
    return file


def _write(stream: Any, motion: Motion) -> None:
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
        moment = round(time * NANO)
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
        "tags": dict(motion.run.tags),
        "kinds": kinds,
    }
    return {name: json.dumps(value) for name, value in values.items()}


def _stamp(moment: int) -> Any:
    from google.protobuf.timestamp_pb2 import Timestamp

    seconds, nanos = divmod(moment, NANO)
    return Timestamp(seconds=seconds, nanos=nanos)


def _transforms(motion: Motion, number: int, present: Any, moment: int) -> Any:
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

    stamp, told = _stamp(moment), FrameTransforms()
    for frame, pose, is_there in zip(
        motion.frames, motion.poses[number].tolist(), present.tolist(), strict=True
    ):
        if is_there:
            one = told.transforms.add(
                timestamp=stamp, parent_frame_id=WORLD_FRAME, child_frame_id=frame.name
            )
            one.translation.x, one.translation.y, one.translation.z = pose[:3]
            one.rotation.w, one.rotation.x, one.rotation.y, one.rotation.z = pose[3:]
    return told


# -- shapes -----------------------------------------------------------------------------------


def _scene(motion: Motion, present: Any, before: Any, moment: int) -> Any:
    """Returns the entities that came since the tick before, and those that went."""
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

    stamp, update = _stamp(moment), SceneUpdate()
    for frame, is_there, was_there in zip(motion.frames, present, before, strict=True):
        if is_there and not was_there:
            entity = update.entities.add(
                timestamp=stamp, frame_id=frame.name, id=frame.name, frame_locked=True
            )
            entity.metadata.add(key="kind", value=frame.entity.kind)
            for shape in frame.shapes.values():
                _add_shape(entity, shape)
        elif was_there and not is_there:
            update.deletions.add(timestamp=stamp, type=_MATCHING_ID, id=frame.name)
    return update


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
