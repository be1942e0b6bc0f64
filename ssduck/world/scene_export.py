"""Saving a world as a scene: a folder with a `scene.toml` and the models that it needs."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from ssduck.errors import SceneError
from ssduck.simulators.backends import backend
from ssduck.simulators.interface import Simulator
from ssduck.simulators.scenes import BodySpec, Camera, ConstraintSpec, Engine, Scene, SensorSpec
from ssduck.world.excerpt import originals_of, sensors_of, tick_of
from ssduck.world.snapshot import Snapshot

FILE = "scene.toml"

# What of a scene, and of each of its parts, is told otherwise than by its own name.
_SCENE = ("description", "gravity", "timestep", "time", "elastic")


@contextmanager
def new_folder(folder: Path) -> Iterator[None]:
    """Make a folder for a scene, and fill it within; what goes wrong there is told as its.

    Raises:
        SceneError: something is there already, or cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise SceneError(f"{folder} is not empty: a scene is saved into a folder of its own")
        yield
    except (OSError, ValueError) as error:  # a null character is a ValueError
        reason = error.strerror if isinstance(error, OSError) else None
        raise SceneError(f"{folder}: {reason or error}") from error


def scene_of(snapshot: Snapshot, simulator: Simulator, folder: Path) -> Scene:
    """The scene of a simulation at a tick; writes the models that it needs into a folder."""
    everyone = {member.id for member in snapshot.listed}
    originals = list(originals_of(snapshot, everyone))
    scene = backend().scene_of(simulator, originals, tick_of(snapshot), folder)
    return replace(scene, sensors=tuple(sensors_of(snapshot, everyone)))


def write_scene(scene: Scene, folder: Path) -> Path:
    """Write the file of a scene into its folder."""
    file = folder / FILE
    file.write_text("\n".join(_lines(scene, folder)) + "\n", encoding="utf-8")
    return file


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
