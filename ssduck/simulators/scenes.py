"""Scenes: a TOML format that names bodies, models, poses and sensors.

docs/reference/scenes.md documents the format. A scene file is checked completely before a simulator
starts; errors name the file, the key and the reason.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from itertools import count
from pathlib import Path
from typing import Any

from ssduck.errors import ArgumentError, SceneError, UnknownNameError, nearest
from ssduck.formatting import joined_names, short_repr
from ssduck.simulators.scene_bodies import MODEL_SUFFIXES, BodySpec, read_body, read_floor
from ssduck.simulators.sensor_types import SENSOR_TYPES, SensorSetting
from ssduck.simulators.toml_reader import REQUIRED, Quaternion, TomlTable, Vector


@dataclass(frozen=True)
class Camera:
    """A pinhole camera.

    Attributes:
        eye: where it is, [x, y, z], m, world frame.
        target: what it looks at, likewise.
        fov: the vertical angle of view, degrees, in (0, 180).

    Raises:
        ArgumentError: a number is not finite, it looks at where it is, or it has no such angle.
    """

    eye: Vector = (3.0, -3.0, 2.5)
    target: Vector = (0.0, 0.0, 0.5)
    fov: float = 50.0

    def __post_init__(self) -> None:
        eye, target = tuple(self.eye), tuple(self.target)
        if not all(map(math.isfinite, (*eye, *target))) or eye == target:
            raise ArgumentError(
                f"a camera looks from one place to another, not from {list(eye)} to {list(target)}"
            )
        if not 0.0 < self.fov < 180.0:
            raise ArgumentError(f"the angle of a camera is in (0, 180), not {self.fov:g}")


CONSTRAINT_TYPES = ("fixed", "point", "prismatic", "gear")


@dataclass(frozen=True)
class ConstraintSpec:
    """A constraint between a link of a body and a link of another, or the world.

    Attributes:
        type: one of `CONSTRAINT_TYPES`.
        on: the body.
        to: the other body; None for the world.
        link: the link of the body; None for its base.
        to_link: the link of the other body; None for its base.
        axis: the axis of a prismatic constraint.
        position: in the frame of the link's centre of mass, metres.
        orientation: in that frame, w, x, y, z.
        to_position: in the frame of the other link's centre of mass, or in the world, metres.
        to_orientation: in that frame, w, x, y, z.
        max_force: newtons.
        gear_ratio: the ratio of a gear.
        gear_link: the number of the third link of a gear.
        gear_target: the relative position that a gear reaches.
        erp: the fraction of an error that a step corrects; 0 for PyBullet's default.
    """

    type: str
    on: str
    to: str | None = None
    link: str | None = None
    to_link: str | None = None
    axis: Vector = (0.0, 0.0, 0.0)
    position: Vector = (0.0, 0.0, 0.0)
    orientation: Quaternion = (1.0, 0.0, 0.0, 0.0)
    to_position: Vector = (0.0, 0.0, 0.0)
    to_orientation: Quaternion = (1.0, 0.0, 0.0, 0.0)
    max_force: float = 500.0
    gear_ratio: float = 0.0
    gear_link: int = 0
    gear_target: float = 0.0
    erp: float = 0.0


@dataclass(frozen=True)
class Engine:
    """Settings of the physics solver; None for PyBullet's default.

    Attributes:
        substeps: the number of parts of a step, at most 10,000; 0 for none.
        iterations: the greatest number of solver iterations in a step, at most 10,000.
        joint_iterations: the number of iterations for joints and constraints in each of them, at
            most 100.
    """

    substeps: int | None = None
    iterations: int | None = None
    joint_iterations: int | None = None


@dataclass(frozen=True)
class SensorSpec:
    """A sensor at a pose in the frame of a body's link.

    A sensor looks along its own +x axis; +z is up.

    Attributes:
        name: the name.
        on: the body.
        link: the link; None for the base.
        type: one of `SENSOR_TYPES`.
        position: in the link frame, metres.
        orientation: in the link frame, w, x, y, z.
        period: seconds between two readings.
        max_range: metres; 0 for a type without a range.
        settings: the settings of its type.
        powered: whether it is switched on.
    """

    name: str
    on: str
    link: str | None
    type: str
    position: Vector
    orientation: Quaternion
    period: float
    max_range: float
    settings: dict[str, float]
    powered: bool = True


@dataclass(frozen=True)
class Scene:
    """A scene; bodies and sensors are in load order.

    Attributes:
        name: the name.
        path: the scene file or model file.
        description: free text.
        gravity: m/s².
        timestep: the length of a step, s.
        time: the initial simulated time, s.
        camera: the default camera.
        floor: the floor, if there is one; it is loaded before the bodies.
        bodies: the bodies, and files of bodies.
        sensors: the sensors.
        elastic: whether there is neither friction nor damping, and collisions lose no energy.
        constraints: the constraints.
        engine: the settings of the physics solver.
        simulator: the name of the simulator that loads it, see
            `ssduck.simulators.backends.BACKENDS`; None for the default.
    """

    name: str
    path: Path
    description: str = ""
    gravity: Vector = (0.0, 0.0, -9.81)
    timestep: float = 1.0 / 240.0
    time: float = 0.0
    camera: Camera = Camera()
    floor: BodySpec | None = None
    bodies: tuple[BodySpec, ...] = ()
    sensors: tuple[SensorSpec, ...] = ()
    elastic: bool = False
    constraints: tuple[ConstraintSpec, ...] = ()
    engine: Engine = Engine()
    simulator: str | None = None

    @property
    def entries(self) -> list[tuple[BodySpec, str]]:
        """The floor and the bodies, with what errors put before their keys."""
        # A model by itself has no entry in a scene's file.
        is_model = self.path.suffix.lower() in MODEL_SUFFIXES
        places = ("" if is_model else f"{self.path}: body[{n}]." for n in count())
        floor = [(self.floor, "")] if self.floor else []
        return [*floor, *zip(self.bodies, places, strict=False)]

    @property
    def model_file(self) -> Path | None:
        """The model file that is loaded by itself; None for the bodies of a scene file."""
        model = self.bodies[0].model if len(self.bodies) == 1 else None
        return model if isinstance(model, Path) and model == self.path.resolve() else None


def shipped_scenes() -> dict[str, Path]:
    """Returns the scenes that come with ssduck: the path of the scene file by name."""
    package = Path(str(files("ssduck")))
    inside = package / "scenes"  # in a wheel; in a checkout they are beside the package
    folder = inside if inside.is_dir() else package.parent / "scenes"
    return {path.parent.name: path for path in sorted(folder.glob("*/scene.toml"))}


def find_scene(name: str | Path) -> Scene:
    """Finds a scene by the name of a shipped one, or by the path of a scene or a model file.

    >>> find_scene("kitchen").name
    'kitchen'
    """
    shipped = shipped_scenes()
    if str(name) in shipped:
        return read_scene(shipped[str(name)])
    path = scene_file(Path(name))
    if path != Path(name) and not path.is_file():
        raise SceneError(f"{path.parent} is a folder without a scene.toml")
    if not _is(path, Path.is_file):
        raise UnknownNameError(
            f"there is no scene {str(name)!r}: neither a shipped one ({', '.join(shipped)}) "
            "nor a file of that name",
            suggestions=nearest(name, shipped),
        )
    suffix = path.suffix.lower()
    if suffix == ".toml":
        return read_scene(path)
    if suffix in MODEL_SUFFIXES:
        body = BodySpec(name=None, kind=None, model=path.resolve())
        return Scene(name=variable_name(path.stem), path=path, bodies=(body,))
    raise SceneError(
        f"{path}: unknown file type; a scene ends in .toml, a model in {', '.join(MODEL_SUFFIXES)}"
    )


def scene_file(path: Path) -> Path:
    """Returns the file of a scene: that of a folder is its `scene.toml`."""
    return path / "scene.toml" if _is(path, Path.is_dir) else path


def _is(path: Path, check: Callable[[Path], bool]) -> bool:
    """Applies a check to a path; False for a name that no file can have."""
    try:
        return check(path)
    except (OSError, ValueError):
        return False


def read_scene(path: Path) -> Scene:
    """Reads a scene file."""
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:  # a TOMLDecodeError is a ValueError
        reason = error.strerror if isinstance(error, OSError) else error
        raise SceneError(f"{path}: {reason}") from error
    except RecursionError:
        raise SceneError(f"{path}: it is nested too deeply") from None
    return _scene(TomlTable(path, "", table), path)


def _scene(table: TomlTable, path: Path) -> Scene:
    if "scene" in table.values:
        told = f"its scene is {short_repr(table.values['scene'])}; ssduck.gym.make_task makes"
        table.fail("scene", f"this is the file of a task, no scene: {told} its environment")
    floor = _floor(table)
    bodies = tuple(read_body(entry, path.parent) for entry in table.tables("body"))
    first = () if floor is None else (floor,)
    _check_unique(path, "body", [body.name for body in bodies], first)
    everything = (*first, *bodies)
    # Files may name some bodies.
    all_named = all(body.is_named for body in everything)
    names = {str(body.name) for body in everything} if all_named else None
    sensors = tuple(_sensor(entry, names) for entry in table.tables("sensor"))
    _check_unique(path, "sensor", [sensor.name for sensor in sensors], everything)
    constraints = tuple(_constraint(entry, names) for entry in table.tables("constraint"))
    camera = table.table("camera")
    eye, target = camera.vector("eye", Camera.eye), camera.vector("target", Camera.target)
    if eye == target:
        camera.fail("target", "the target is where the camera is")
    engine = table.table("engine")
    full = path.resolve()  # name.toml, or name/scene.toml
    stem = full.parent.name if full.name == "scene.toml" else full.stem
    scene = Scene(
        name=table.text("name", variable_name(stem)),
        path=path,
        description=table.text("description", "", empty=True),
        gravity=table.vector("gravity", Scene.gravity),
        timestep=table.number("timestep", Scene.timestep, above=0.0),
        time=table.number("time", Scene.time, at_least=0.0),
        camera=Camera(eye, target, camera.number("fov", Camera.fov, above=0.0, below=180.0)),
        floor=floor,
        bodies=bodies,
        sensors=sensors,
        elastic=table.flag("elastic", False),
        constraints=constraints,
        engine=Engine(
            engine.whole("substeps", at_least=0, at_most=10_000),
            engine.whole("iterations", at_least=1, at_most=10_000),
            engine.whole("joint_iterations", at_least=1, at_most=100),
        ),
        simulator=table.text("simulator", "") or None,
    )
    if not scene.name.isidentifier():
        table.fail("name", f"{scene.name!r} is no name: letters, digits and _ only")
    camera.end()
    engine.end()
    table.end()
    return scene


def _floor(table: TomlTable) -> BodySpec | None:
    if isinstance(table.values.get("floor", {}), bool):
        return read_floor(TomlTable(None, "", {})) if table.flag("floor", False) else None
    floor = table.table("floor", "true, false or a table")
    return read_floor(floor) if "floor" in table.values else None


def check_body(name: str, bodies: Collection[str] | None, place: str) -> None:
    """Raises an error for a name that no body of a scene has, if their names are known."""
    if bodies is not None and name not in bodies:
        raise SceneError(
            f"{place}: the scene has no body {name!r}", suggestions=nearest(name, bodies)
        )


def _constraint(table: TomlTable, bodies: Collection[str] | None) -> ConstraintSpec:
    type = table.text("type")
    if type not in CONSTRAINT_TYPES:
        table.fail("type", f"no such constraint: {type!r}", nearest(type, CONSTRAINT_TYPES))
    ends = table.text("on"), table.text("to", "") or None
    for key, body in zip(("on", "to"), ends, strict=True):
        if body is not None:
            check_body(body, bodies, table.place(key))
    default = ConstraintSpec
    spec = ConstraintSpec(
        type,
        *ends,
        link=table.text("link", "") or None,
        to_link=table.text("to_link", "") or None,
        axis=table.vector("axis", default.axis),
        position=table.vector("position", default.position),
        orientation=table.quaternion("orientation"),
        to_position=table.vector("to_position", default.to_position),
        to_orientation=table.quaternion("to_orientation"),
        max_force=table.number("max_force", default.max_force, at_least=0.0),
        gear_ratio=table.number("gear_ratio", default.gear_ratio),
        gear_link=table.whole("gear_link") or default.gear_link,
        gear_target=table.number("gear_target", default.gear_target),
        erp=table.number("erp", default.erp, at_least=0.0),
    )
    table.end()
    return spec


def read_sensor(values: Mapping[str, Any], bodies: Collection[str]) -> SensorSpec:
    """Reads a sensor from the values of a `[[sensor]]` table."""
    return _sensor(TomlTable(None, "", dict(values)), bodies)


def _sensor(table: TomlTable, bodies: Collection[str] | None) -> SensorSpec:
    name = table.text("type")
    if name not in SENSOR_TYPES:
        known = f"the types are {joined_names(list(SENSOR_TYPES))}"
        told = f"there is no sensor type {name!r}; {known}"
        table.fail("type", told, nearest(name, SENSOR_TYPES))
    kind = SENSOR_TYPES[name]
    on = table.text("on")
    check_body(on, bodies, table.place("on"))
    spec = SensorSpec(
        name=table.text("name"),
        on=on,
        link=table.text("link", "") or None,
        type=name,
        position=table.vector("position", (0.0, 0.0, 0.0)),
        orientation=table.quaternion("orientation"),
        period=table.number("period", 0.0, at_least=0.0),
        max_range=table.number("max_range", above=0.0) if kind.has_range else 0.0,
        settings={setting.name: _setting(table, setting) for setting in kind.settings},
        powered=table.flag("powered", True),
    )
    if fault := kind.fault(spec.settings):
        table.fail(*fault)
    table.end()
    return spec


def _setting(table: TomlTable, setting: SensorSetting) -> float:
    value = table.number(
        setting.name,
        REQUIRED if setting.default is None else setting.default,
        above=setting.above,
        at_least=setting.at_least,
        below=setting.below,
        at_most=setting.at_most,
    )
    if setting.whole and not value.is_integer():
        table.fail(setting.name, f"{value:g} is no whole number")
    return value


def _check_unique(
    path: Path, table: str, names: Sequence[str | None], others: Sequence[BodySpec] = ()
) -> None:
    other_names = {body.name for body in others}
    for index, name in enumerate(names):
        if name is not None and (name in other_names or name in names[:index]):
            raise SceneError(f"{path}: {table}[{index}].name: {name!r} is there already")


def variable_name(text: str) -> str:
    """Makes a valid name of a scene, which is a variable in programs, from a text."""
    name = "".join(letter if letter.isalnum() or letter == "_" else "_" for letter in text)
    return name if name.isidentifier() else f"world_{name}".rstrip("_")
