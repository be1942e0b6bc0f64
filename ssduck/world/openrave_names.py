"""Provides OpenRAVE's method names, for programs written for SelectScript's OpenRAVE dialect.

Only the methods that its tutorial uses, and closely related ones, are provided: names, boxes,
transforms, joints, and the getters of an environment.
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


# The only option of `CloneSelf` with an effect: there are no viewers and no controllers.
CLONE_BODIES = 1


@dataclass(frozen=True, eq=False)
class AABB:
    """An axis-aligned box by its centre and its half-extents, m."""

    centre: Array
    half_extents: Array

    def pos(self) -> Array:
        """Returns the centre, (3,)."""
        return self.centre

    def extents(self) -> Array:
        """Returns the half-extents, (3,)."""
        return self.half_extents


class OpenRaveEntity:
    """OpenRAVE's methods of an `Entity`."""

    def GetName(self: Any) -> str:  # noqa: N802  # OpenRAVE's name
        """Returns the name."""
        return str(self.name)

    def GetEnv(self: Any) -> World:  # noqa: N802  # OpenRAVE's name
        """Returns the world of the entity."""
        world: World = self.world
        return world

    def ComputeAABB(self: Any) -> AABB:  # noqa: N802  # OpenRAVE's name
        """Returns the axis-aligned box in the world frame."""
        low, high = (np.array(corner) for corner in self.aabb)
        return AABB((low + high) / 2, (high - low) / 2)

    def GetTransform(self: Any) -> Array:  # noqa: N802  # OpenRAVE's name
        """Returns the pose as a (4, 4) homogeneous matrix, from the link frame to the world."""
        matrix = np.eye(4)
        matrix[:3, :3] = rotation_matrices(np.array([self.orientation]))[0]
        matrix[:3, 3] = self.position
        return matrix

    def SetTransform(self: Any, transform: npt.ArrayLike) -> None:  # noqa: N802  # OpenRAVE's name
        """Moves the entity to a (4, 4) homogeneous matrix or a pose [w, x, y, z, x, y, z].

        Raises:
            StateError: the transform is neither.
        """
        try:
            matrix = np.asarray(transform, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            matrix = np.zeros(0)
        if matrix.shape == (4, 4):
            self.move(matrix[:3, 3], wxyz=_quaternion(matrix[:3, :3], self.name))
        else:
            position, orientation = parse_pose(cast("Sequence[float]", transform), self.name)
            self.move(position, wxyz=orientation)

    def GetDOFValues(self: Any) -> Array:  # noqa: N802  # OpenRAVE's name
        """Returns the positions of the revolute and prismatic joints, rad or m."""
        return np.array([joint.position for joint in _settable(self)])

    def SetDOFValues(  # noqa: N802  # OpenRAVE's name
        self: Any, values: Sequence[float], dofindices: Sequence[int] | None = None
    ) -> None:
        """Sets the revolute and prismatic joints, or those of some indices among them.

        Raises:
            ArgumentError: no joint has an index, or there are too many or too few values.
        """
        if dofindices is None:
            self.move(joints=values)
            return
        if not (validation.are_numbers(values) and validation.are_numbers(dofindices)):
            values_text = f"{short_repr(dofindices)} and {short_repr(values)}"
            raise ArgumentError(
                f"{self.name}: indices and values are numbers in lists, not {values_text}"
            )
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
        """Enables or disables collisions."""
        self.enabled = enable

    def IsEnabled(self: Any) -> bool:  # noqa: N802  # OpenRAVE's name
        """Checks whether the entity takes part in collisions."""
        return bool(self.enabled)

    def SetVisible(self: Any, visible: bool) -> None:  # noqa: N802  # OpenRAVE's name
        """Shows or hides the entity."""
        self.visible = visible

    def IsVisible(self: Any) -> bool:  # noqa: N802  # OpenRAVE's name
        """Checks whether the entity is drawn."""
        return bool(self.visible)


class SensorCommand(Enum):
    """OpenRAVE's commands to sensors; commands to draw are accepted and have no effect."""

    PowerOn = 0x10
    PowerOff = 0x11
    PowerCheck = 0x12
    RenderDataOn = 0x20
    RenderDataOff = 0x21
    RenderDataCheck = 0x23


class OpenRaveSensor:
    """OpenRAVE's methods of a `Sensor`."""

    __slots__ = ()

    ConfigureCommand = SensorCommand

    def Configure(self: Any, command: SensorCommand) -> bool:  # noqa: N802  # OpenRAVE's name
        """Switches the sensor on or off, or returns whether it is on."""
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
    """OpenRAVE's methods of a `World`; as in OpenRAVE, an unknown name gives None."""

    def GetRobots(self: Any) -> list[Entity]:  # noqa: N802  # OpenRAVE's name
        """Returns the robots in load order."""
        return [entity for entity in self if entity.kind == "robot"]

    def GetSensors(self: Any) -> list[Entity]:  # noqa: N802  # OpenRAVE's name
        """Returns the sensors in load order."""
        return [entity for entity in self if entity.kind == "sensor"]

    def GetBodies(self: Any) -> list[Entity]:  # noqa: N802  # OpenRAVE's name
        """Returns robots and kinbodies in load order."""
        return [entity for entity in self if entity.kind != "sensor"]

    def GetRobot(self: Any, name: str) -> Entity | None:  # noqa: N802  # OpenRAVE's name
        """Returns the robot of a name."""
        return _named(self, name, "robot")

    def GetKinBody(self: Any, name: str) -> Entity | None:  # noqa: N802  # OpenRAVE's name
        """Returns the robot or kinbody of a name: in OpenRAVE, robots are kinbodies."""
        return _named(self, name, "robot", "kinbody")

    def GetSensor(self: Any, name: str) -> Entity | None:  # noqa: N802  # OpenRAVE's name
        """Returns the sensor of a name."""
        return _named(self, name, "sensor")

    def CloneSelf(self: Any, options: int = 1) -> World:  # noqa: N802  # OpenRAVE's name
        """Returns a new world of the same entities; an empty one without `CLONE_BODIES`."""
        options = validation.integer(options, "CloneSelf: options", minimum=0)
        world: World = self.excerpt(self if options & CLONE_BODIES else ())
        return world

    def Remove(self: Any, entity: Entity) -> bool:  # noqa: N802  # OpenRAVE's name
        """Removes an entity."""
        self.remove(entity)
        return True

    def Destroy(self: Any) -> None:  # noqa: N802  # OpenRAVE's name
        """Closes the simulation."""
        self.close()


def _settable(entity: Entity) -> list[JointState]:
    return [joint for joint in entity.joints if joint.type in SCALAR_JOINTS]


def _quaternion(matrix: Array, name: str) -> Array:
    """Returns a rotation matrix as a quaternion w, x, y, z."""
    if not np.isfinite(matrix).all() or np.linalg.det(matrix) <= 0.0:
        raise StateError(f"{name}: this is no rotation matrix: {matrix.tolist()}")
    return quaternion_from_matrix(matrix)


def _named(world: World, name: str, *kinds: str) -> Entity | None:
    return next((e for e in world if e.name == name and e.kind in kinds), None)
