"""Copies a tick: as a what-if or past one, into a new simulation, or as the folder of a scene.

A saved scene is a `scene.toml` and its models.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Collection, Container, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from ssduck.errors import SceneError
from ssduck.geometry.arrays import Array
from ssduck.simulators.backends import BACKENDS, BodyToCopy, TickToCopy, backend
from ssduck.simulators.interface import Body, Joint, LinkPoses, Simulator
from ssduck.simulators.kinematics import Pose, moved_link_poses
from ssduck.simulators.partial import StaticSimulator
from ssduck.simulators.scene_bodies import BodySpec, Material, Primitive
from ssduck.simulators.scenes import (
    Camera,
    ConstraintSpec,
    Engine,
    Scene,
    SensorSpec,
    variable_name,
)
from ssduck.world.layout import BodyGroup
from ssduck.world.snapshot import Snapshot

UNAVAILABLE = {
    "contacts": "a what-if world has no contacts: the solver finds contacts in a step, and a "
    "what-if world is never stepped; compare boxes, or move the bodies themselves",
    "sensings": "sensors perceive nothing in a what-if world: rays can only be cast in the "
    "simulation; move the bodies themselves",
}


# Poses of a diverging simulation may be NaN; they stay NaN.
@np.errstate(invalid="ignore")
def what_if_tick(
    snapshot: Snapshot, poses: Mapping[Body, Pose], joints: Mapping[Body, Mapping[int, float]]
) -> tuple[StaticSimulator, Snapshot]:
    """Returns a static simulator of the what-if state, and a snapshot to take from it.

    Args:
        snapshot: the tick; if a body has several links, the tables of links and joints must have
            been requested.
        poses: the new poses of the bodies' base link frames in the world frame.
        joints: the new positions of joints, rad or m, by body and index of the joint.
    """
    states = snapshot.joints()
    offsets = {
        body: {n: position - states[body][n, 0] for n, position in positions.items()}
        for body, positions in joints.items()
    }
    clone = snapshot.clone(UNAVAILABLE)
    link_poses = {}
    for group, current in snapshot.body_groups:
        moved = [body for body in group.runs if body in poses or body in offsets]
        link_poses[group.bodies] = _moved(group, current, moved, poses, offsets, states)
        if moved:
            clone.invalidate_static_poses()
    simulator = StaticSimulator(
        time=snapshot.time,
        link_poses=link_poses,
        joints={body: _at_rest(values, joints.get(body, {})) for body, values in states.items()},
        disabled=snapshot.disabled,
        hidden=snapshot.hidden,
    )
    return simulator, clone


def copied_tick(snapshot: Snapshot) -> tuple[StaticSimulator, Snapshot]:
    """Returns a static simulator of a tick as it is, and a snapshot to take from it.

    The copy has the contacts, what sensors perceive if that was requested, and is of the same run.

    Args:
        snapshot: the tick; the tables of contacts and, if a body has several links, of links and
            joints must have been requested.
    """
    simulator = StaticSimulator(
        time=snapshot.time,
        link_poses={group.bodies: poses for group, poses in snapshot.body_groups},
        joints=snapshot.joints(),
        disabled=snapshot.disabled,
        hidden=snapshot.hidden,
        contacts=snapshot.contact_points,
        description="a copy of a tick",
    )
    return simulator, snapshot.clone({}, snapshot.run)


def _moved(
    group: BodyGroup,
    link_poses: LinkPoses,
    bodies: list[Body],
    poses: Mapping[Body, Pose],
    offsets: Mapping[Body, Mapping[int, float]],
    joint_states: Mapping[Body, Array],
) -> LinkPoses:
    """Returns the link poses of a group after some of its bodies or their joints moved."""
    if not bodies:
        return link_poses
    positions, states = link_poses.positions.copy(), link_poses.states.copy()
    for body in bodies:
        run = group.runs[body]
        current = LinkPoses(positions[run], states[run])
        new = moved_link_poses(
            body, current, poses.get(body), offsets.get(body, {}), joint_states.get(body)
        )
        positions[run], states[run] = new.positions, new.states
    return LinkPoses(positions, states)


def _at_rest(states: Array, positions: Mapping[int, float]) -> Array:
    """Sets joints of states (joints, 3) to rest at positions, in place; all efforts are unknown."""
    states[:, 2] = np.nan
    for number, position in positions.items():
        states[number, :2] = position, 0.0
    return states


# -- running copies --------------------------------------------------------------------------


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
        link_poses = LinkPoses(poses.positions[run], poses.states[run])
        unknown = np.full((len(body.joints), 3), np.nan)
        yield BodyToCopy(info.name, body, link_poses, joints.get(body, unknown)[:, :2])


FILE = "scene.toml"
# An array of numbers, of which tomli-w writes one per line.
_ARRAY = re.compile(r"\[\n((?: {4}[^ ]+,\n)+)\]")

# The attributes of a scene that its file has under the same keys.
_SCENE = ("description", "simulator", "gravity", "timestep", "time", "elastic")


@contextmanager
def new_folder(path: str | Path) -> Iterator[Path]:
    """Creates a folder for a scene, without files after an error; errors are a SceneError of it."""
    folder = Path(path)
    try:
        is_new = not folder.exists()
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise SceneError(f"{folder} is not empty: a scene is saved into a folder of its own")
        try:
            yield folder
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


def _scene_of(snapshot: Snapshot, simulator: Simulator, folder: Path, target: str) -> Scene:
    """Returns the scene of a tick, for the simulator `target`; writes its models into a folder."""
    ids = {info.id for info in snapshot.load_order}
    originals = list(originals_of(snapshot, ids))
    if target not in BACKENDS:
        backend(target)  # raises the error; to write a model, its simulator need not be there
    source = backend(simulator.backend)
    scene = source.scene_of(simulator, originals, tick_of(snapshot), folder, target)
    return replace(scene, sensors=tuple(sensors_of(snapshot, ids)))


def saved(
    snapshot: Snapshot,
    simulator: Simulator,
    folder: Path,
    target: str | None,
    name: str,
    camera: Camera | None,
) -> Path:
    """Saves a tick as the scene of a world of a name, for the simulator `target`."""
    scene = _scene_of(snapshot, simulator, folder, target or simulator.backend)
    scene = replace(scene, name=variable_name(name), camera=camera or Camera())
    return write_scene(scene, folder)


def write_scene(scene: Scene, folder: Path) -> Path:
    """Writes the file of a scene into its folder, and returns its path."""
    import tomli_w

    file = folder / FILE
    text = tomli_w.dumps(_document(scene, folder))
    on_one_line = _ARRAY.sub(lambda part: f"[{' '.join(part[1].split()).rstrip(',')}]", text)
    file.write_text(on_one_line, encoding="utf-8")
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
