"""OpenRAVE's spellings, so that programs written for SelectScript's OpenRAVE dialect still run.

Only what its tutorial uses and what goes with that: names, boxes, transforms, joints, and the
getters of an environment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import numpy.typing as npt

from ssduck import validation
from ssduck.errors import ArgumentError, StateError
from ssduck.formatting import short_repr
from ssduck.geometry.arrays import Array
from ssduck.geometry.poses import quaternion_from_matrix, rotation_matrices
from ssduck.simulators.interface import SCALAR_JOINTS
from ssduck.simulators.kinematics import parse_pose

if TYPE_CHECKING:
    from ssduck.world.entities import Entity, JointState
    from ssduck.world.world import World


# What of `CloneSelf`'s options matters: there are no viewers and no controllers.
CLONE_BODIES = 1


@dataclass(frozen=True, eq=False)
class AABB:
    """An axis-aligned box by its centre and its half-extents, metres."""

    centre: Array
    half_extents: Array

    def pos(self) -> Array:
        """The centre, (3,)."""
        return self.centre

    def extents(self) -> Array:
        """The half-extents, (3,)."""
        return self.half_extents


class OpenRaveEntity:
    """OpenRAVE's names of what an `Entity` has."""

    def GetName(self: Any) -> str:  # noqa: N802  # OpenRAVE's name
        """Its name."""
        return str(self.name)

    def GetEnv(self: Any) -> World:  # noqa: N802  # OpenRAVE's name
        """The world that it is in."""
        world: World = self.world
        return world

    def ComputeAABB(self: Any) -> AABB:  # noqa: N802  # OpenRAVE's name
        """Its axis-aligned box in the world frame."""
        low, high = (np.array(corner) for corner in self.aabb)
        return AABB((low + high) / 2, (high - low) / 2)

    def GetTransform(self: Any) -> Array:  # noqa: N802  # OpenRAVE's name
        """Its pose as a (4, 4) homogeneous matrix, from its link frame to the world."""
        matrix = np.eye(4)
        matrix[:3, :3] = rotation_matrices(np.array([self.orientation]))[0]
        matrix[:3, 3] = self.position
        return matrix

    def SetTransform(self: Any, transform: npt.ArrayLike) -> None:  # noqa: N802  # OpenRAVE's name
        """Move it: a (4, 4) homogeneous matrix, or a pose [w, x, y, z, x, y, z].

        Raises:
            StateError: it is neither.
        """
        try:
            given = np.asarray(transform, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            given = np.zeros(0)
        if given.shape == (4, 4):
            self.move(given[:3, 3], _quaternion(given[:3, :3], self.name))
        else:
            position, orientation = parse_pose(cast("Sequence[float]", transform), self.name)
            self.move(position, orientation)

    def GetDOFValues(self: Any) -> Array:  # noqa: N802  # OpenRAVE's name
        """The positions of its revolute and prismatic joints, rad or m."""
        return np.array([joint.position for joint in _settable(self)])

    def SetDOFValues(  # noqa: N802  # OpenRAVE's name
        self: Any, values: Sequence[float], dofindices: Sequence[int] | None = None
    ) -> None:
        """Set its revolute and prismatic joints, or those of these indices among them.

        Raises:
            ArgumentError: an index is none's, or there are too many values or too few.
        """
        if dofindices is None:
            self.move(joints=values)
            return
        if not (validation.are_numbers(values) and validation.are_numbers(dofindices)):
            told = f"{short_repr(dofindices)} and {short_repr(values)}"
            raise ArgumentError(f"{self.name}: indices and values are numbers in lists, not {told}")
        names = [joint.name for joint in _settable(self)]
        if len(dofindices) != len(values):
            raise ArgumentError(f"{self.name}: {len(dofindices)} indices, {len(values)} values")
        for index in dofindices:
            if not validation.is_integer(index) or not 0 <= index < len(names):
                raise ArgumentError(
                    f"{self.name} has no joint {short_repr(index)}; it has {len(names)}, counted "
                    "from 0"
                )
        self.move(joints={names[i]: value for i, value in zip(dofindices, values, strict=True)})

    def Enable(self: Any, enable: bool) -> None:  # noqa: N802  # OpenRAVE's name
        """Let it take part in collisions, or not."""
        self.enabled = enable

    def IsEnabled(self: Any) -> bool:  # noqa: N802  # OpenRAVE's name
        """Whether it takes part in collisions."""
        return bool(self.enabled)

    def SetVisible(self: Any, visible: bool) -> None:  # noqa: N802  # OpenRAVE's name
        """Let it be drawn, or not."""
        self.visible = visible

    def IsVisible(self: Any) -> bool:  # noqa: N802  # OpenRAVE's name
        """Whether it is drawn."""
        return bool(self.visible)


class SensorCommand(Enum):
    """What OpenRAVE tells a sensor to do; drawing is told, and nothing is drawn."""

    PowerOn = 0x10
    PowerOff = 0x11
    PowerCheck = 0x12
    RenderDataOn = 0x20
    RenderDataOff = 0x21
    RenderDataCheck = 0x23


class OpenRaveSensor:
    """OpenRAVE's names of what a `Sensor` has."""

    __slots__ = ()

    ConfigureCommand = SensorCommand

    def Configure(self: Any, command: SensorCommand) -> bool:  # noqa: N802  # OpenRAVE's name
        """Switch it on or off, or tell whether it is on."""
        match command:
            case SensorCommand.PowerOn | SensorCommand.PowerOff:
                self.power(command is SensorCommand.PowerOn)
                return True
            case SensorCommand.PowerCheck:
                return bool(self.powered)
            case SensorCommand.RenderDataOn | SensorCommand.RenderDataOff:
                return True
        return False


class OpenRaveWorld:
    """OpenRAVE's names of what a `World` has; an unknown name gives None, as there."""

    def GetRobots(self: Any) -> list[Entity]:  # noqa: N802  # OpenRAVE's name
        """The robots in load order."""
        return [entity for entity in self if entity.kind == "robot"]

    def GetSensors(self: Any) -> list[Entity]:  # noqa: N802  # OpenRAVE's name
        """The sensors in load order."""
        return [entity for entity in self if entity.kind == "sensor"]

    def GetBodies(self: Any) -> list[Entity]:  # noqa: N802  # OpenRAVE's name
        """Robots and kinbodies in load order."""
        return [entity for entity in self if entity.kind != "sensor"]

    def GetRobot(self: Any, name: str) -> Entity | None:  # noqa: N802  # OpenRAVE's name
        """The robot of that name."""
        return _named(self, name, "robot")

    def GetKinBody(self: Any, name: str) -> Entity | None:  # noqa: N802  # OpenRAVE's name
        """The robot or kinbody of that name: there, robots are kinbodies."""
        return _named(self, name, "robot", "kinbody")

    def GetSensor(self: Any, name: str) -> Entity | None:  # noqa: N802  # OpenRAVE's name
        """The sensor of that name."""
        return _named(self, name, "sensor")

    def CloneSelf(self: Any, options: int = 1) -> World:  # noqa: N802  # OpenRAVE's name
        """A new world of the same entities; of none unless options have `CLONE_BODIES`."""
        options = validation.integer(options, "CloneSelf: options", minimum=0)
        world: World = self.excerpt(self if options & CLONE_BODIES else ())
        return world

    def Remove(self: Any, entity: Entity) -> bool:  # noqa: N802  # OpenRAVE's name
        """Take an entity out."""
        self.remove(entity)
        return True

    def Destroy(self: Any) -> None:  # noqa: N802  # OpenRAVE's name
        """Give up the simulation."""
        self.close()


def _settable(entity: Entity) -> list[JointState]:
    return [joint for joint in entity.joints if joint.type in SCALAR_JOINTS]


def _quaternion(matrix: Array, name: str) -> Array:
    """A rotation matrix as w, x, y, z."""
    if not np.isfinite(matrix).all() or np.linalg.det(matrix) <= 0.0:
        raise StateError(f"{name}: the matrix turns nothing: {matrix.tolist()}")
    return quaternion_from_matrix(matrix)


def _named(world: World, name: str, *kinds: str) -> Entity | None:
    return next((e for e in world if e.name == name and e.kind in kinds), None)
