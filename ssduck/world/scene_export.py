"""Saving a world as a scene: a folder with a `scene.toml` and the models that it needs."""

from __future__ import annotations

import re
from collections.abc import Iterator
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
# An array of numbers, which tomli-w writes a line each.
_ARRAY = re.compile(r"\[\n((?: {4}[^ ]+,\n)+)\]")

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
    everyone = {info.id for info in snapshot.load_order}
    originals = list(originals_of(snapshot, everyone))
    scene = backend(simulator.backend).scene_of(simulator, originals, tick_of(snapshot), folder)
    return replace(scene, sensors=tuple(sensors_of(snapshot, everyone)))


def write_scene(scene: Scene, folder: Path) -> Path:
    """Write the file of a scene into its folder."""
    import tomli_w

    file = folder / FILE
    text = tomli_w.dumps(_document(scene, folder))
    file.write_text(_ARRAY.sub(_on_one_line, text), encoding="utf-8")
    return file


def _document(scene: Scene, folder: Path) -> dict[str, Any]:
    """A scene's file; what is as it is without being said is left out."""
    values = {name: getattr(scene, name) for name in _SCENE}
    document = {
        "name": scene.name,
        **{name: value for name, value in values.items() if value != getattr(Scene, name)},
        "camera": _changed(scene.camera, Camera()),
        "engine": _changed(scene.engine, Engine(0, 50, 1)),
        "body": [_body(body, folder) for body in scene.bodies],
        "sensor": list(map(_sensor, scene.sensors)),
        "constraint": [_changed(one, ConstraintSpec("", "")) for one in scene.constraints],
    }
    return {name: value for name, value in document.items() if value not in ({}, [])}


def _changed(part: Any, plain: Any) -> dict[str, Any]:
    values = {f.name: getattr(part, f.name) for f in fields(part)}
    return {name: value for name, value in values.items() if value != getattr(plain, name)}


def _body(body: BodySpec, folder: Path) -> dict[str, Any]:
    urdf = body.model.relative_to(folder).as_posix()
    plain = BodySpec(body.name, body.kind, body.model)
    values = {"name": body.name, "kind": body.kind, "urdf": urdf, **_changed(body, plain)}
    return {name: value for name, value in values.items() if value is not None}


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
