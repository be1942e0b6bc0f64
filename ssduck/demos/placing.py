"""Finds the obstacles near a robot at a place, by their exact shapes."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ssduck.world.entities import Entity
    from ssduck.world.world import World


class Placing:
    """Places a robot in what-if worlds of the last tick of a world.

    Args:
        world: the world with the obstacles.
        robot: the robot.
        clearance: the required distance to every obstacle, metres.
        ignored: names of entities that may be near, such as the floor.

    Attributes:
        count: the number of places tested so far.
    """

    def __init__(
        self,
        world: World,
        robot: Entity,
        clearance: float,
        *,
        ignored: Iterable[str] = (),
    ) -> None:
        self._world, self._robot = world, robot
        self._height = robot.position[2]
        self._clearance = clearance
        excluded = {robot.name, *ignored}
        others = [e for e in self._world if e.kind != "sensor" and e.name not in excluded]
        self._others = [(other.id, other.name) for other in others]
        self._boxes = np.array([other.aabb for other in others]).reshape(-1, 2, 3)
        self.count = 0

    def near(self, x: float, y: float, yaw: float = 0.0) -> list[str]:
        """Returns the names of the entities that are too near to the robot at a place.

        Args:
            x: the x of its link frame in the world, metres; its height stays.
            y: the y of its link frame, metres.
            yaw: the rotation about the vertical, radians.
        """
        self.count += 1
        pose = [math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2), x, y, self._height]
        what_if = self._world.what_if({self._robot: pose})
        what_if.request_tables(["shapes"])
        low, high = np.array(what_if.entity(self._robot.id).aabb)
        box_distances = np.maximum(self._boxes[:, 0] - high, low - self._boxes[:, 1]).max(axis=1)
        shapes, robot_id = what_if.snapshot.shapes(), self._robot.id
        return [
            name
            for (other, name), box_distance in zip(
                self._others, box_distances.tolist(), strict=True
            )
            # The distance of shapes that collide takes longest to compute.
            if box_distance <= self._clearance
            and (shapes.collides(robot_id, other) or shapes.near(robot_id, other, self._clearance))
        ]
