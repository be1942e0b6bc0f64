"""Saves a world as a scene: a folder with a `scene.toml` and its models."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from ssduck.errors import SceneError
from ssduck.simulators.backends import BACKENDS, backend
from ssduck.simulators.interface import Simulator
from ssduck.simulators.scene_bodies import BodySpec, Material, Primitive
from ssduck.simulators.scenes import Camera, ConstraintSpec, Engine, Scene, SensorSpec
from ssduck.world.excerpt import originals_of, sensors_of, tick_of
from ssduck.world.snapshot import Snapshot

FILE = "scene.toml"
# An array of numbers, of which tomli-w writes one per line.
_ARRAY = re.compile(r"\[\n((?: {4}[^ ]+,\n)+)\]")

# The attributes of a scene that its file has under the same keys.
_SCENE = ("description", "simulator", "gravity", "timestep", "time", "elastic")


@contextmanager
def new_folder(folder: Path) -> Iterator[None]:
    """Creates a folder for a scene; errors in the body of the with statement name the folder.

    After an error, it has no files.

    Raises:
        SceneError: the folder is not empty, or something cannot be written.
    """
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
    """Returns the scene of a simulation at a tick, after writing its models into a folder.

    Args:
        snapshot: the tick.
        simulator: the simulation.
        folder: the folder of the scene.
        target: the name of the simulator that is to load it.
    """
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
