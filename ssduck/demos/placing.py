"""Where a robot may be: its shapes at a place, against those of everything else there."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ssduck.world.entities import Entity
    from ssduck.world.world import World


class Placing:
    """A robot that is put here and there in what-if worlds of a world's last tick.

    Args:
        world: what else there is, and where it is.
        robot: who is put somewhere.
        apart: how far it is to be from everything, metres.
        ignored: names of what it may be near, as of the floor that it stands on.

    Attributes:
        asked: at how many places it was looked at.
    """

    def __init__(
        self,
        world: World,
        robot: Entity,
        apart: float,
        *,
        ignored: Iterable[str] = (),
    ) -> None:
        self._world, self._robot = world, robot
        self._height = robot.position[2]
        self._apart = apart
        left_out = {robot.name, *ignored}
        others = [e for e in self._world if e.kind != "sensor" and e.name not in left_out]
        self._others = [(other.id, other.name) for other in others]
        self._boxes = np.array([other.aabb for other in others]).reshape(-1, 2, 3)
        self.asked = 0

    def near(self, x: float, y: float, yaw: float = 0.0) -> list[str]:
        """The names of what is not far enough from the robot there, by their exact shapes.

        Args:
            x: of its link frame in the world, metres; its height stays as it is.
            y: the same.
            yaw: how far it is turned about the vertical, radians.
        """
        self.asked += 1
        pose = [math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2), x, y, self._height]
        there = self._world.what_if({self._robot: pose})
        there.ask(["shapes"])
        low, high = np.array(there.entity(self._robot.id).aabb)
        apart = np.maximum(self._boxes[:, 0] - high, low - self._boxes[:, 1]).max(axis=1)
        shapes, me = there.snapshot.shapes(), self._robot.id
        return [
            name
            for (other, name), gap in zip(self._others, apart.tolist(), strict=True)
            # Asked how far apart they are, what collides takes longest to answer.
            if gap <= self._apart
            and (shapes.collides(me, other) or shapes.near(me, other, self._apart))
        ]
