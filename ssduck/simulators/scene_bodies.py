"""Bodies of scenes: model files, primitives and the floor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Literal

from ssduck.errors import nearest
from ssduck.simulators.toml_reader import Quaternion, TomlTable, Vector

# The suffixes of model files by the key of a body.
MODEL_FILES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"urdf": (".urdf",), "sdf": (".sdf", ".world"), "mjcf": (".mjcf", ".xml")}
)
MODEL_SUFFIXES = tuple(suffix for suffixes in MODEL_FILES.values() for suffix in suffixes)
# The number of values of a primitive by the key of a body, with the values in words.
PRIMITIVES: Mapping[str, tuple[int, str]] = MappingProxyType(
    {
        "box": (3, "its lengths along x, y and z"),
        "sphere": (1, "its radius"),
        "cylinder": (2, "its radius and its length"),
        "capsule": (2, "its radius and the length between the centres of its caps"),
        "plane": (3, "its normal"),
    }
)
FLOOR = "floor"
# The keys that only some bodies have.
_KEYS_OF_SOME = frozenset(
    (
        *("velocity", "own_inertia", "joints", "joint_velocities", "held", "hold"),
        *("mass", "colour", "friction", "rolling_friction", "spinning_friction", "restitution"),
    )
)


@dataclass(frozen=True)
class Material:
    """The surface of a primitive.

    Attributes:
        colour: red, green, blue, alpha, from 0 to 1.
        friction: the coefficient of friction against sliding.
        rolling_friction: the coefficient against rolling.
        spinning_friction: the coefficient against spinning about the normal of a contact.
        restitution: the part of the velocity that a bounce keeps.
    """

    colour: tuple[float, ...] = (0.7, 0.7, 0.7, 1.0)
    friction: float = 0.5
    rolling_friction: float = 0.0
    spinning_friction: float = 0.0
    restitution: float = 0.0


@dataclass(frozen=True)
class Primitive:
    """A body of one primitive shape, centred at its base link frame, with its axis along z.

    Attributes:
        type: one of `PRIMITIVES`.
        size: its values, metres; see `PRIMITIVES`.
        mass: kilograms, unless the body is fixed.
        material: the surface.
    """

    type: str
    size: tuple[float, ...]
    mass: float = 1.0
    material: Material = Material()


@dataclass(frozen=True)
class BodySpec:
    """A body of a scene, or the bodies of an SDF or MJCF file.

    Attributes:
        name: the name, or the beginning of the names of several bodies; None for that of the model.
        kind: robot or kinbody; None to decide by the joints.
        model: the model file, or a primitive.
        position: of the base link frame, metres; of an SDF or MJCF file, of the file's origin.
        orientation: of that frame, w, x, y, z.
        fixed: whether the base is fixed to the world.
        joints: initial positions by the joints' names, rad or m.
        velocity: initial velocity of the base link frame, m/s, then angular velocity, rad/s, in the
            world frame.
        joint_velocities: initial velocities by the joints' names, rad/s or m/s.
        hold: whether motors hold its joints.
        held: the positions that motors hold, if they differ from `joints`.
        enabled: whether it takes part in collisions.
        visible: whether it is drawn.
        own_inertia: whether moments of inertia are those of the model; else they follow from the
            shapes.
    """

    name: str | None
    kind: Literal["robot", "kinbody"] | None
    model: Path | Primitive
    position: Vector = (0.0, 0.0, 0.0)
    orientation: Quaternion = (1.0, 0.0, 0.0, 0.0)
    fixed: bool = False
    joints: dict[str, float] = field(default_factory=dict)
    velocity: tuple[float, ...] = (0.0,) * 6
    joint_velocities: dict[str, float] = field(default_factory=dict)
    hold: bool = True
    held: dict[str, float] = field(default_factory=dict)
    enabled: bool = True
    visible: bool = True
    own_inertia: bool = False

    @property
    def source(self) -> str:
        """The key under which a scene file has the model: one of `MODEL_FILES` or `PRIMITIVES`."""
        if isinstance(self.model, Primitive):
            return self.model.type
        suffix = self.model.suffix.lower()
        return next(key for key, suffixes in MODEL_FILES.items() if suffix in suffixes)

    @property
    def is_named(self) -> bool:
        """Whether the scene says the name; an SDF or MJCF file may name several bodies."""
        return self.name is not None and self.source not in ("sdf", "mjcf")


def read_body(table: TomlTable, folder: Path) -> BodySpec:
    """Reads a `[[body]]` table; model files are relative to a folder."""
    kind = table.text("kind", "") or None
    if kind not in (None, "robot", "kinbody"):
        near = nearest(kind, ("robot", "kinbody"))
        table.fail("kind", f"{kind!r} is neither 'robot' nor 'kinbody'", near)
    # An SDF or MJCF file may name its bodies.
    may_lack_name = "name" not in table.values and {"sdf", "mjcf"} & table.values.keys()
    name = table.text("name", "") or None if may_lack_name else table.text("name")
    source = table.one_of((*MODEL_FILES, *PRIMITIVES))
    fixed = table.flag("fixed", source == "plane")
    velocity = BodySpec.velocity
    if source in ("urdf", *PRIMITIVES):
        velocity = table.numbers("velocity", 6, velocity, meaning="vx, vy, vz, wx, wy, wz")
    is_file = source in MODEL_FILES
    joints, speeds, held = (
        table.table(key).all_numbers() if is_file else {}
        for key in ("joints", "joint_velocities", "held")
    )
    spec = BodySpec(
        name=name,
        kind=kind,  # type: ignore[arg-type]  # checked above
        model=_model(table, source, folder) if is_file else _primitive(table, source, fixed),
        position=table.vector("position", BodySpec.position),
        orientation=table.quaternion("orientation"),
        fixed=fixed,
        joints=joints,
        velocity=velocity,
        joint_velocities=speeds,
        hold=table.flag("hold", True) if is_file else True,
        held=held,
        enabled=table.flag("enabled", True),
        visible=table.flag("visible", True),
        own_inertia=table.flag("own_inertia", False) if source == "urdf" else False,
    )
    if spec.fixed and any(spec.velocity):
        table.fail("velocity", "a fixed body does not move")
    for key in table.values:
        if key in _KEYS_OF_SOME - table.read_keys:
            table.fail(key, f"a body with {source!r} has no such key")
    table.end()
    return spec


def read_floor(table: TomlTable) -> BodySpec:
    """Reads the values of a `[floor]` table: a horizontal plane of unlimited size."""
    height = table.number("height", 0.0)
    model = Primitive("plane", (0.0, 0.0, 1.0), material=_material(table))
    visible = table.flag("visible", True)
    table.end()
    return BodySpec(FLOOR, None, model, position=(0.0, 0.0, height), fixed=True, visible=visible)


def _model(table: TomlTable, key: str, folder: Path) -> Path:
    file = table.text(key)
    try:
        model = (folder / file).resolve()
        is_there = model.is_file()
    except (OSError, RuntimeError, ValueError):  # the name is too long, a link to itself, or NUL
        is_there = False
    if not is_there:
        where = "" if Path(file).is_absolute() else " beside the scene file"
        table.fail(key, f"there is no file {file!r}{where}")
    suffixes = MODEL_FILES[key]
    suffix = model.suffix.lower()
    if suffix not in suffixes:
        right = tuple(name for name, endings in MODEL_FILES.items() if suffix in endings)
        table.fail(key, f"{model.name!r} does not end in {' or '.join(suffixes)}", right)
    return model


def _primitive(table: TomlTable, type: str, fixed: bool) -> Primitive:
    count, meaning = PRIMITIVES[type]
    size: tuple[float, ...]
    if type == "plane":
        if not fixed:
            table.fail("fixed", "a plane cannot move")
        size = table.unit_vector(type)
    elif count == 1:
        size = (table.number(type, above=0.0),)
    else:
        size = table.numbers(type, count, meaning=meaning)
        if min(size) <= 0.0:
            table.fail(type, f"{meaning} must be above 0, found {list(size)}")
    if fixed:
        if "mass" in table.values:
            table.fail("mass", "a fixed body has no mass")
        return Primitive(type, size, material=_material(table))
    mass = table.number("mass", Primitive.mass, at_least=0.0)
    if mass == 0.0:
        table.fail("mass", "0 is not above 0; a body that never moves has fixed = true")
    return Primitive(type, size, mass, _material(table))


def _material(table: TomlTable) -> Material:
    default = Material()
    return Material(
        table.colour("colour", default.colour),
        table.number("friction", default.friction, at_least=0.0),
        table.number("rolling_friction", default.rolling_friction, at_least=0.0),
        table.number("spinning_friction", default.spinning_friction, at_least=0.0),
        table.number("restitution", default.restitution, at_least=0.0, at_most=1.0),
    )
