"""Copies entities of a tick: into a new, running simulation, or into the folder of a saved scene.

A saved scene is a `scene.toml` and its models.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Collection, Container, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from ssduck.errors import SceneError
from ssduck.simulators.backends import BACKENDS, BodyToCopy, TickToCopy, backend
from ssduck.simulators.interface import Joint, LinkPoses, Simulator
from ssduck.simulators.partial import StaticSimulator
from ssduck.simulators.scene_bodies import BodySpec, Material, Primitive
from ssduck.simulators.scenes import Camera, ConstraintSpec, Engine, Scene, SensorSpec
from ssduck.world.snapshot import Snapshot


def excerpt(
    snapshot: Snapshot, ids: Collection[int], source: Simulator
) -> tuple[Simulator, list[SensorSpec]]:
    """Returns a new simulation of entities of a tick, with bodies of sensors, and the sensors."""
    by_id = {info.id: info for info in snapshot.load_order}
    with_hosts = {*ids, *(by_id[id].mount[0] for id in ids if by_id[id].sensor is not None)}
    sensors = sensors_of(snapshot, with_hosts)
    originals = list(originals_of(snapshot, with_hosts))
    return backend(source.backend).excerpt(source, originals, tick_of(snapshot)), sensors


def posed(snapshot: Snapshot, source: Simulator) -> Simulator:
    """Returns a simulation that is drawn, and never stepped: all bodies of a tick, as they are.

    The joints of what no simulator runs are fixed: PyBullet, which draws it, may not have them.
    """
    originals: Iterable[BodyToCopy] = originals_of(snapshot, snapshot.rows)
    if isinstance(source, StaticSimulator):
        originals = map(_with_fixed_joints, originals)
    return backend(source.backend).excerpt(source, list(originals), tick_of(snapshot))


def _with_fixed_joints(original: BodyToCopy) -> BodyToCopy:
    joints = tuple(
        Joint(link.name, "fixed", number, None, None, None, None)
        for number, link in enumerate(original.body.links[1:], start=1)
    )
    body = replace(original.body, joints=joints)
    return replace(original, body=body, joints=np.zeros((len(joints), 2)))


def tick_of(snapshot: Snapshot) -> TickToCopy:
    """Returns the state of a tick as a whole, to be copied."""
    return TickToCopy(snapshot.time, snapshot.disabled, snapshot.hidden)


def sensors_of(snapshot: Snapshot, ids: Container[int]) -> list[SensorSpec]:
    """Returns the specifications of the sensors among some entities, powered as at the tick."""
    return [
        replace(info.sensor, powered=snapshot.sensing.is_on(info.id))
        for info in snapshot.load_order
        if info.sensor is not None and info.id in ids
    ]


def originals_of(snapshot: Snapshot, ids: Container[int]) -> Iterator[BodyToCopy]:
    """Yields the bodies among some entities with their states at a tick, in load order."""
    groups = {
        body: (group, poses) for group, poses in snapshot.body_groups for body in group.bodies
    }
    joints = snapshot.joints() if snapshot.has("joints") else {}
    for info in snapshot.load_order:
        body = info.body
        if body is None or info.id not in ids:
            continue
        group, poses = groups[body]
        run = group.runs[body]
        link_poses = LinkPoses(poses.positions[run], poses.matrices[run], poses.states[run])
        unknown = np.full((len(body.joints), 3), np.nan)
        yield BodyToCopy(info.name, body, link_poses, joints.get(body, unknown)[:, :2])


FILE = "scene.toml"
# An array of numbers, of which tomli-w writes one per line.
_ARRAY = re.compile(r"\[\n((?: {4}[^ ]+,\n)+)\]")

# The attributes of a scene that its file has under the same keys.
_SCENE = ("description", "simulator", "gravity", "timestep", "time", "elastic")


@contextmanager
def new_folder(folder: Path) -> Iterator[None]:
    """Creates a folder for a scene, without files after an error; errors are a SceneError of it."""
    try:
        is_new = not folder.exists()
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise SceneError(f"{folder} is not empty: a scene is saved into a folder of its own")
        try:
            yield
        except BaseException:
            _empty(folder)
            if is_new:
                folder.rmdir()
            raise
    except SceneError:
        raise
    except (OSError, ValueError) as error:  # a null character is a ValueError
        reason = error.strerror if isinstance(error, OSError) else None
        raise SceneError(f"{folder}: {reason or error}") from error


def _empty(folder: Path) -> None:
    for place in folder.iterdir():
        if place.is_dir():
            shutil.rmtree(place)
        else:
            place.unlink()


def scene_of(snapshot: Snapshot, simulator: Simulator, folder: Path, target: str) -> Scene:
    """Returns the scene of a tick, for the simulator `target`; writes its models into a folder."""
    ids = {info.id for info in snapshot.load_order}
    originals = list(originals_of(snapshot, ids))
    if target not in BACKENDS:
        backend(target)  # raises the error; to write a model, its simulator need not be there
    source = backend(simulator.backend)
    scene = source.scene_of(simulator, originals, tick_of(snapshot), folder, target)
    return replace(scene, sensors=tuple(sensors_of(snapshot, ids)))


def write_scene(scene: Scene, folder: Path) -> Path:
    """Writes the file of a scene into its folder, and returns its path."""
    import tomli_w

    file = folder / FILE
    text = tomli_w.dumps(_document(scene, folder))
    file.write_text(_ARRAY.sub(_on_one_line, text), encoding="utf-8")
    return file


def _document(scene: Scene, folder: Path) -> dict[str, Any]:
    """Returns the content of a scene's file, without default values."""
    values = {name: getattr(scene, name) for name in _SCENE}
    document = {
        "name": scene.name,
        **{name: value for name, value in values.items() if value != getattr(Scene, name)},
        "camera": _differences(scene.camera, Camera()),
        "engine": _differences(scene.engine, Engine(0, 50, 1)),
        "body": [_body(body, folder) for body in scene.bodies],
        "sensor": list(map(_sensor, scene.sensors)),
        "constraint": [_differences(one, ConstraintSpec("", "")) for one in scene.constraints],
    }
    return {name: value for name, value in document.items() if value not in ({}, [])}


def _differences(part: Any, default: Any) -> dict[str, Any]:
    values = {f.name: getattr(part, f.name) for f in fields(part)}
    return {
        name: value
        for name, value in values.items()
        if value is not None and value != getattr(default, name)
    }


def _body(body: BodySpec, folder: Path) -> dict[str, Any]:
    values: dict[str, Any] = {"name": body.name, "kind": body.kind}  # left out if None
    if isinstance(body.model, Primitive):
        values |= _primitive(body.model, body.fixed)
    else:
        values[body.source] = body.model.relative_to(folder).as_posix()
    values |= _differences(body, BodySpec(body.name, body.kind, body.model))
    return {name: value for name, value in values.items() if value is not None}


def _primitive(primitive: Primitive, fixed: bool) -> dict[str, Any]:
    size = primitive.size
    values: dict[str, Any] = {primitive.type: size[0] if len(size) == 1 else size}
    if not fixed:
        values["mass"] = primitive.mass
    return values | _differences(primitive.material, Material())


def _sensor(sensor: SensorSpec) -> dict[str, Any]:
    names = ("name", "type", "on", "link", "position", "orientation", "period")
    values = {name: getattr(sensor, name) for name in names}
    if sensor.max_range:
        values["max_range"] = sensor.max_range
    if not sensor.powered:
        values["powered"] = False
    values |= sensor.settings
    return {name: value for name, value in values.items() if value is not None}


def _on_one_line(array: re.Match[str]) -> str:
    return "[" + " ".join(array[1].split()).rstrip(",") + "]"
