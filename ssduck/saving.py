"""Saving a world as a scene: a folder with a `scene.toml` and the models that it needs."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from ssduck.errors import SceneError
from ssduck.excerpts import originals_of
from ssduck.scenes import BodySpec, Camera, ConstraintSpec, Engine, Scene, SensorSpec, variable_name
from ssduck.simulators.pybullet import PyBulletSimulator
from ssduck.simulators.pybullet_copies import Tick
from ssduck.simulators.pybullet_saving import scene_of
from ssduck.world import World

FILE = "scene.toml"

# What of a scene, and of each of its parts, is told otherwise than by its own name.
_SCENE = ("description", "gravity", "timestep", "time", "elastic")


def save(world: World, folder: Path) -> Path:
    """Save a world; see `World.save`."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise SceneError(f"{folder} is not empty: a scene is saved into a folder of its own")
        # A copy is a world that ssduck made, whatever it is of: a tick of the past, a client
        # that somebody else has, what would be if.
        copy = world.excerpt(world)
        try:
            scene = _scene(copy, folder)
        finally:
            copy.close()
        file = folder / FILE
        file.write_text("\n".join(_lines(scene, folder)) + "\n", encoding="utf-8")
    except (OSError, ValueError) as error:  # a null character is a ValueError
        reason = error.strerror if isinstance(error, OSError) else None
        raise SceneError(f"{folder}: {reason or error}") from error
    return file


def _scene(world: World, folder: Path) -> Scene:
    with world.held(("joints",)):
        snapshot = world.snapshot
        simulator = world.simulator
        assert isinstance(simulator, PyBulletSimulator)
        tick = Tick(world.time, snapshot.disabled, snapshot.hidden)
        everyone = {member.id for member in snapshot.listed}
        scene = scene_of(simulator, list(originals_of(world, everyone)), tick, folder)
        sensors = [
            replace(member.sensor, powered=snapshot.sensing.is_on(member.id))
            for member in snapshot.listed
            if member.sensor is not None
        ]
    return replace(
        scene, name=variable_name(world.name), camera=world.camera, sensors=tuple(sensors)
    )


def _lines(scene: Scene, folder: Path) -> Iterator[str]:
    """The lines of a scene's file; what is as it is without being said is left out."""
    yield f"name = {_told(scene.name)}"
    for name in _SCENE:
        if getattr(scene, name) != getattr(Scene, name):
            yield f"{name} = {_told(getattr(scene, name))}"
    yield from _table("[camera]", scene.camera, Camera())
    yield from _table("[engine]", scene.engine, Engine(0, 50, 1))
    for body in scene.bodies:
        yield from _table("[[body]]", body, BodySpec("", None, Path()), folder)
    for sensor in scene.sensors:
        yield from _sensor(sensor)
    for constraint in scene.constraints:
        yield from _table("[[constraint]]", constraint, ConstraintSpec("", ""))


def _table(header: str, part: Any, plain: Any, folder: Path | None = None) -> Iterator[str]:
    values = {f.name: getattr(part, f.name) for f in fields(part)}
    told = {name: value for name, value in values.items() if value != getattr(plain, name)}
    if not told and not header.startswith("[["):
        return
    yield from ("", header)
    for name, value in told.items():
        if isinstance(value, Path):
            assert folder is not None
            yield f"urdf = {_told(value.relative_to(folder).as_posix())}"
        else:
            yield f"{name} = {_told(value)}"


def _sensor(sensor: SensorSpec) -> Iterator[str]:
    yield from ("", "[[sensor]]")
    for name in ("name", "type", "on", "link", "position", "orientation", "period"):
        value = getattr(sensor, name)
        if value is not None:
            yield f"{name} = {_told(value)}"
    if sensor.max_range:
        yield f"max_range = {_told(sensor.max_range)}"
    if not sensor.powered:
        yield "powered = false"
    for name, value in sensor.settings.items():
        yield f"{name} = {_told(value)}"


def _told(value: Any) -> str:
    """A value as TOML; numbers to the last digit."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # As in JSON, but for the one character that TOML wants escaped and JSON does not.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_told(k)} = {_told(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_told, value)) + "]"
    return repr(value)
