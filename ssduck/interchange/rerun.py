"""Writes an episode as a recording of Rerun: poses over simulated time, and the shapes.

The timelines are `sim_time`, the simulated time, and `tick`. Frames are `world/<entity>` and
`world/<entity>.<link>`, each with its pose in the world. The extra `rerun` brings the library.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ssduck.adapters.optional import library
from ssduck.geometry.shapes import PlacedGeometry
from ssduck.interchange.motion import Motion, mesh_of
from ssduck.recording.stores.files import write_with_folders


def write_rrd(file: Path, motion: Motion) -> Path:
    """Writes an episode to a file, all or nothing; an existing file is replaced."""
    rerun = library("rerun", "rerun")
    write_with_folders(file, lambda place: _write(rerun, place, motion))
    return file


def _write(rerun: Any, file: Path, motion: Motion) -> None:
    stream = rerun.RecordingStream("ssduck", recording_id=motion.run.id)
    with stream:
        stream.save(str(file))
        stream.log("world", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for number, frame in enumerate(motion.frames):
            place = rerun.new_entity_path(["world", frame.name])
            stream.log(place, rerun.AnyValues(kind=frame.entity.kind), static=True)
            for index, shape in frame.shapes.items():
                stream.log(f"{place}/shape_{index}", *_shape(rerun, shape), static=True)
            _send_poses(rerun, stream, place, motion, number)
        stream.flush()
    stream.disconnect()


def _send_poses(rerun: Any, stream: Any, place: str, motion: Motion, number: int) -> None:
    """Sends the poses of a frame at all ticks at once."""
    there = motion.present[:, number]
    poses = motion.poses[there, number]
    columns = [
        rerun.TimeColumn("sim_time", duration=motion.times[there]),
        rerun.TimeColumn("tick", sequence=motion.ticks[there]),
    ]
    turns = np.roll(poses[:, 3:], -1, axis=1)  # x, y, z, w
    transforms = rerun.Transform3D.columns(translation=poses[:, :3], quaternion=turns)
    stream.send_columns(place, columns, transforms)


def _shape(rerun: Any, shape: PlacedGeometry) -> list[Any]:
    """Returns what draws a shape, at its pose in the frame of its link."""
    size, turn = shape.geometry.size, np.roll(shape.orientation, -1)
    pose = rerun.Transform3D(translation=shape.position, quaternion=turn)
    match shape.geometry.type:
        case "box":
            return [pose, rerun.Boxes3D(sizes=[size])]
        case "sphere":
            return [pose, rerun.Ellipsoids3D(radii=[size[0]])]
        case "ellipsoid":
            return [pose, rerun.Ellipsoids3D(half_sizes=[size])]
        case "cylinder":
            return [pose, rerun.Cylinders3D(radii=[size[0]], lengths=[size[1]])]
        case _:
            vertices, faces = mesh_of(shape.geometry)
            return [pose, rerun.Mesh3D(vertex_positions=vertices, triangle_indices=faces)]
