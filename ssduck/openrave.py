"""OpenRAVE's spellings, so that programs written for SelectScript's OpenRAVE dialect still run.

Only what its tutorial uses: names, boxes, transforms and the getters of an environment.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np

from ssduck.geometry import Array, rotation_matrices

if TYPE_CHECKING:
    from ssduck.world import Entity, World


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


class EntitySpellings:
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


class SensorCommand(Enum):
    """What OpenRAVE tells a sensor to do; drawing is told, and nothing is drawn."""

    PowerOn = 0x10
    PowerOff = 0x11
    PowerCheck = 0x12
    RenderDataOn = 0x20
    RenderDataOff = 0x21
    RenderDataCheck = 0x23


class SensorSpellings:
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


class WorldSpellings:
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


def _named(world: World, name: str, *kinds: str) -> Entity | None:
    return next((e for e in world if e.name == name and e.kind in kinds), None)
