"""Stands in for `openravepy`, so that SelectScript's tutorial runs unchanged.

The module has the names of handles, worlds and environments in SelectScript's OpenRAVE dialect, as
far as its tutorial and closely related programs use them, and the occupancy grid of the tutorial's
filter plugin. `RaveCreateModule` makes an OpenRAVE module, which takes commands as texts. The
plugin is a part of ssduck; there is nothing to load.

Worlds and handles know nothing of it: `spellings` tells them of attributes that they have not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from ssduck import validation
from ssduck.adapters.base import placed_shapes
from ssduck.adapters.grid_values import MAX_CELLS
from ssduck.errors import ArgumentError, StateError, nearest
from ssduck.formatting import short_repr
from ssduck.geometry.arrays import Array
from ssduck.geometry.poses import quaternion_from_matrix, rotation_matrices
from ssduck.geometry.rasters import Raster, Rasterizer
from ssduck.simulators.interface import SCALAR_JOINTS
from ssduck.simulators.kinematics import parse_pose
from ssduck.world.entities import Entity, JointState, KinBody, Robot, Sensor
from ssduck.world.world import World

__all__ = [
    "AABB",
    "CLONE_BODIES",
    "MODULES",
    "KinBody",
    "OccupancyGridMap",
    "RaveCreateModule",
    "RaveInitialize",
    "RaveLoadPlugin",
    "Robot",
    "Sensor",
    "SensorCommand",
]

# The only option of `CloneSelf` with an effect: there are no viewers and no controllers.
CLONE_BODIES = 1


@dataclass(frozen=True, eq=False)
class AABB:
    """An axis-aligned box by its centre and its half-extents, m."""

    centre: Array
    half_extents: Array

    @classmethod
    def of(cls, low: Sequence[float], high: Sequence[float]) -> AABB:
        """Returns the box between two corners."""
        lower, upper = np.array(low), np.array(high)
        return cls((lower + upper) / 2, (upper - lower) / 2)

    def pos(self) -> Array:
        """Returns the centre, (3,)."""
        return self.centre

    def extents(self) -> Array:
        """Returns the half-extents, (3,)."""
        return self.half_extents


class SensorCommand(Enum):
    """OpenRAVE's commands to sensors; commands to draw are accepted and have no effect."""

    PowerOn = 0x10
    PowerOff = 0x11
    PowerCheck = 0x12
    RenderDataOn = 0x20
    RenderDataOff = 0x21
    RenderDataCheck = 0x23


def _get_transform(entity: Entity) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_matrices(np.array([entity.orientation]))[0]
    matrix[:3, 3] = entity.position
    return matrix


def _set_transform(entity: Any, transform: npt.ArrayLike) -> None:
    try:
        matrix = np.asarray(transform, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.zeros(0)
    if matrix.shape == (4, 4):
        turn = matrix[:3, :3]
        if not np.isfinite(turn).all() or np.linalg.det(turn) <= 0.0:
            raise StateError(f"{entity.name}: this is no rotation matrix: {turn.tolist()}")
        entity.move(matrix[:3, 3], wxyz=quaternion_from_matrix(turn))
    else:
        position, orientation = parse_pose(cast("Sequence[float]", transform), entity.name)
        entity.move(position, wxyz=orientation)


def _settable(entity: Entity) -> list[JointState]:
    return [joint for joint in entity.joints if joint.type in SCALAR_JOINTS]


def _set_positions(
    entity: Entity, values: Sequence[float], dofindices: Sequence[int] | None = None
) -> None:
    if dofindices is None:
        entity.move(joints=values)
        return
    if not (validation.are_numbers(values) and validation.are_numbers(dofindices)):
        raise ArgumentError(
            f"{entity.name}: indices and values are numbers in lists, not "
            f"{short_repr(dofindices)} and {short_repr(values)}"
        )
    names = [joint.name for joint in _settable(entity)]
    if len(dofindices) != len(values):
        raise ArgumentError(f"{entity.name}: {len(dofindices)} indices, {len(values)} values")
    for index in dofindices:
        if not validation.is_integer(index) or not 0 <= index < len(names):
            raise ArgumentError(
                f"{entity.name} has no joint {short_repr(index)}; it has {len(names)}, counted "
                "from 0"
            )
    entity.move(joints={names[i]: value for i, value in zip(dofindices, values, strict=True)})


def _configure(sensor: Sensor, command: SensorCommand) -> bool:
    match command:
        case SensorCommand.PowerOn | SensorCommand.PowerOff:
            sensor.power(command is SensorCommand.PowerOn)
            return True
        case SensorCommand.PowerCheck:
            return bool(sensor.powered)
    return command in (SensorCommand.RenderDataOn, SensorCommand.RenderDataOff)


def _of_kinds(world: World, *kinds: str) -> list[Entity]:
    return [entity for entity in world if entity.kind in kinds]


def _named(world: World, name: str, *kinds: str) -> Entity | None:
    return next((one for one in _of_kinds(world, *kinds) if one.name == name), None)


def _clone(world: World, options: int = CLONE_BODIES) -> World:
    options = validation.integer(options, "CloneSelf: options", minimum=0)
    return world.excerpt(world if options & CLONE_BODIES else ())


# OpenRAVE's methods of each class of worlds and of handles, with their help.
_METHODS: Mapping[str, Mapping[str, tuple[Callable[..., Any], str]]] = {
    "Entity": {
        "GetName": (lambda entity: entity.name, "Returns the name."),
        "GetEnv": (lambda entity: entity.world, "Returns the world of the entity."),
        "ComputeAABB": (
            lambda entity: AABB.of(*entity.aabb),
            "Returns the axis-aligned box in the world frame.",
        ),
        "GetTransform": (
            _get_transform,
            "Returns the pose as a (4, 4) homogeneous matrix, from the link frame to the world.",
        ),
        "SetTransform": (
            _set_transform,
            "Moves it to a (4, 4) homogeneous matrix or a pose [w, x, y, z, x, y, z].",
        ),
        "GetDOFValues": (
            lambda entity: np.array([joint.position for joint in _settable(entity)]),
            "Returns the positions of the revolute and prismatic joints, rad or m.",
        ),
        "SetDOFValues": (
            _set_positions,
            "Sets the revolute and prismatic joints, or those of some indices among them.",
        ),
        "Enable": (
            lambda entity, enable: setattr(entity, "enabled", enable),
            "Enables or disables collisions.",
        ),
        "IsEnabled": (lambda entity: entity.enabled, "Checks whether it takes part in collisions."),
        "SetVisible": (
            lambda entity, visible: setattr(entity, "visible", visible),
            "Shows or hides the entity.",
        ),
        "IsVisible": (lambda entity: entity.visible, "Checks whether the entity is drawn."),
    },
    "Sensor": {
        "Configure": (_configure, "Switches the sensor on or off, or returns whether it is on."),
    },
    "World": {
        "GetRobots": (lambda world: _of_kinds(world, "robot"), "Returns the robots."),
        "GetSensors": (lambda world: _of_kinds(world, "sensor"), "Returns the sensors."),
        "GetBodies": (
            lambda world: _of_kinds(world, "robot", "kinbody"),
            "Returns robots and kinbodies.",
        ),
        "GetRobot": (
            lambda world, name: _named(world, name, "robot"),
            "Returns the robot of a name; None if there is none.",
        ),
        "GetKinBody": (
            lambda world, name: _named(world, name, "robot", "kinbody"),
            "Returns the robot or kinbody of a name: in OpenRAVE, robots are kinbodies.",
        ),
        "GetSensor": (
            lambda world, name: _named(world, name, "sensor"),
            "Returns the sensor of a name; None if there is none.",
        ),
        "CloneSelf": (
            _clone,
            "Returns a new world of the same entities; an empty one without `CLONE_BODIES`.",
        ),
        "Remove": (lambda world, entity: world.remove(entity) or True, "Removes an entity."),
        "Destroy": (lambda world: world.close(), "Closes the simulation."),
    },
}


def _attributes() -> Mapping[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    for family, methods in _METHODS.items():
        found[family] = {name: function for name, (function, _) in methods.items()}
        for name, (function, about) in methods.items():
            function.__name__, function.__doc__ = name, about
    found["Sensor"]["ConfigureCommand"] = SensorCommand
    return found


_ATTRIBUTES = _attributes()


def spellings(owner: type) -> dict[str, Any]:
    """Returns OpenRAVE's attributes of a class of worlds or of handles, by their names."""
    families = [_ATTRIBUTES.get(base.__name__, {}) for base in reversed(owner.__mro__)]
    return {name: value for family in families for name, value in family.items()}


class OccupancyGridMap:
    """A module that computes the cells that the bodies of a world occupy at a height.

    Commands: `SetTranslation x y z` sets the corner and the height of the grid, m;
    `SetSize nx ny size` sets the numbers of cells and their side, m; `Scan` returns a byte for
    each cell, 1 for occupied, with y varying fastest; `SetLineWidth` and `Render` do nothing.

    Args:
        world: the world, read when `Scan` is sent.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._corner = (0.0, 0.0, 0.0)
        self._size = (0, 0, 0.0)

    def SendCommand(self, command: str) -> bytes | str:
        """Runs a command and returns its result, or an empty text.

        Raises:
            ArgumentError: the command does not exist or does not accept the numbers.
        """
        name, *arguments = command.split() or [""]
        commands: dict[str, Callable[..., bytes | str]] = {
            "SetTranslation": self._set_translation,
            "SetSize": self._set_size,
            "SetLineWidth": lambda _: "",
            "Scan": self._scan,
            "Render": lambda: "",
        }
        if name not in commands:
            raise ArgumentError(
                f"occupancygridmap has no command {short_repr(name)}",
                suggestions=nearest(name, commands),
            )
        try:
            return commands[name](*map(float, arguments))
        except (TypeError, ValueError) as error:
            raise ArgumentError(f"occupancygridmap: {short_repr(command)}: {error}") from error

    def _set_translation(self, x: float, y: float, z: float) -> str:
        if not all(map(math.isfinite, (x, y, z))):
            raise ValueError("the coordinates of the corner must be finite")
        self._corner = (x, y, z)
        return ""

    def _set_size(self, nx: float, ny: float, size: float) -> str:
        if not (nx >= 1 and ny >= 1 and 0.0 < size < math.inf):
            raise ValueError("there must be at least one cell, wider than 0 m")
        if not (nx * ny <= MAX_CELLS and nx.is_integer() and ny.is_integer()):
            raise ValueError(
                f"the numbers of cells must be whole, with {MAX_CELLS:,} cells at most"
            )
        self._size = (int(nx), int(ny), size)
        return ""

    def _scan(self) -> bytes:
        (x, y, z), (nx, ny, size) = self._corner, self._size
        if not nx:
            raise ValueError("SetSize must be sent before")
        with self._world.pinned(("shapes",)):
            placed = placed_shapes(self._world, _of_kinds(self._world, "robot", "kinbody"))
        return Rasterizer(placed).cells(Raster((x, y), size, (nx, ny)), z, z).tobytes()


MODULES: dict[str, Callable[[World], OccupancyGridMap]] = {"occupancygridmap": OccupancyGridMap}


def RaveCreateModule(env: World, name: str) -> OccupancyGridMap | None:
    """Returns a new module for a world; None, as in OpenRAVE, if the name is unknown."""
    module = MODULES.get(name.lower())
    return None if module is None else module(env)


def RaveInitialize() -> None:
    """Does nothing: ssduck needs no initialization."""


def RaveLoadPlugin(path: str) -> bool:
    """Checks whether a plugin is available: only `filter` is, as a part of ssduck.

    >>> RaveLoadPlugin("build/filter.so"), RaveLoadPlugin("other.so")
    (True, False)
    """
    return path.replace("\\", "/").rpartition("/")[2].partition(".")[0] == "filter"
