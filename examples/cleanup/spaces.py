"""Defines the spaces of planning: postures of an arm, and places of a two-wheeled robot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from examples.cleanup.kinematics import KinematicChain
from examples.cleanup.obstacles import Obstacles
from ssduck.geometry.arrays import Array, Flags, Indices

# For an arm: the largest motion between two postures of a path, and the clearances, m.
ARM_SPACING = 0.03
ARM_CLEARANCE = 0.016
SELF_CLEARANCE = 0.01
# The same for the base.
BASE_SPACING = 0.04
BASE_CLEARANCE = 0.03


@dataclass(frozen=True, eq=False)
class ArmSpace:
    """The postures of an arm, rad, on a base at rest.

    Attributes:
        chain: the robot.
        obstacles: the obstacles.
        base: (4, 4), the pose of the base.
        others: (joints,), the positions of all joints; those of the arm are replaced.
        arm: the indices of the joints of the arm.
        levers: (arm joints,), the largest distance of moved parts from each joint, m.
        clearance: the required clearance, m.
    """

    chain: KinematicChain
    obstacles: Obstacles
    base: Array
    others: Array
    arm: Indices
    levers: Array
    clearance: float = ARM_CLEARANCE

    def sample(self, rng: np.random.Generator) -> Array:
        """Returns a random posture within the limits."""
        result: Array = rng.uniform(self.chain.lower[self.arm], self.chain.upper[self.arm])
        return result

    def distances(self, here: Array, others: Array) -> Array:
        """Returns upper bounds of the motion of any point of the arm, m."""
        result: Array = np.abs(others - here) @ self.levers
        return result

    def path(self, here: Array, there: Array) -> Array:
        """Returns a straight path in joint space."""
        count = max(2, int(self.distances(here, there[None])[0] / ARM_SPACING) + 2)
        shares = np.linspace(0.0, 1.0, count)[:, None]
        result: Array = here + shares * (there - here)
        return result

    def full(self, postures: Array) -> Array:
        """Returns the positions of all joints (n, joints) in postures of the arm."""
        result = np.tile(self.others, (len(postures), 1))
        result[:, self.arm] = postures
        return result

    def clear(self, postures: Array) -> Flags:
        """Checks whether the arm keeps clear of obstacles and of the robot."""
        bases = np.tile(self.base, (len(postures), 1, 1))
        full = self.full(postures)
        links = range(int(self.chain.links[self.arm].min()), len(self.chain.rest))
        return self.obstacles.clear(
            bases,
            full,
            self.clearance,
            moving=links,
            self_clearance=min(SELF_CLEARANCE, self.clearance),
        )


@dataclass(frozen=True, eq=False)
class BaseSpace:
    """The places of a two-wheeled robot with a resting arm: x, y of its axle, m, and yaw, rad.

    The robot turns on the spot, rolls straight forwards or backwards, and turns again.

    Attributes:
        chain: the robot.
        obstacles: the obstacles.
        positions: (joints,), the joint positions.
        height: the height of the base link's frame, m.
        axle: the distance of the axle ahead of the base link's origin, m.
        lever: the largest distance of the robot's parts from the axle, m.
        low: the least x and y, m.
        high: the greatest x and y, m.
        clearance: the required clearance, m.
    """

    chain: KinematicChain
    obstacles: Obstacles
    positions: Array
    height: float
    axle: float
    lever: float
    low: tuple[float, float]
    high: tuple[float, float]
    clearance: float = BASE_CLEARANCE

    def sample(self, rng: np.random.Generator) -> Array:
        """Returns a random place."""
        x, y = rng.uniform(self.low, self.high)
        return np.array([x, y, rng.uniform(-np.pi, np.pi)])

    def distances(self, here: Array, others: Array) -> Array:
        """Returns the rolled distances plus the arcs of the farthest point in turns, m."""
        rolled = np.hypot(*(others[:, :2] - here[:2]).T)
        result: Array = rolled + self.lever * np.abs(wrapped(others[:, 2] - here[2]))
        return result

    def path(self, here: Array, there: Array) -> Array:
        """Returns a path that turns, rolls and turns; it rolls backwards if it turns less so."""
        dx, dy = there[:2] - here[:2]
        parts = [here[None]]
        if np.hypot(dx, dy) > 1e-6:
            heading = np.arctan2(dy, dx)
            headings = heading, heading + np.pi
            total_turns = [abs(wrapped(h - here[2])) + abs(wrapped(there[2] - h)) for h in headings]
            heading = headings[int(np.argmin(total_turns))]
            parts.append(self._turn(here, heading))
            corner = np.concatenate(parts)[-1]
            count = max(2, int(np.hypot(dx, dy) / BASE_SPACING) + 2)
            shares = np.linspace(0.0, 1.0, count)[1:, None]
            parts.append(corner + shares * np.array([dx, dy, 0.0]))
        parts.append(self._turn(np.concatenate(parts)[-1], float(there[2])))
        return np.concatenate(parts)

    def _turn(self, here: Array, yaw: float) -> Array:
        angle = wrapped(yaw - here[2])
        if abs(angle) < 1e-6:
            return np.zeros((0, 3))
        count = int(abs(angle) * self.lever / BASE_SPACING) + 1
        result = np.tile(here, (count, 1))
        result[:, 2] += np.linspace(0.0, angle, count + 1)[1:]
        return result

    def bases(self, places: Array) -> Array:
        """Returns the poses of the base link (n, 4, 4) at places (n, 3)."""
        result = np.tile(np.eye(4), (len(places), 1, 1))
        sine, cosine = np.sin(places[:, 2]), np.cos(places[:, 2])
        result[:, 0, 0] = result[:, 1, 1] = cosine
        result[:, 1, 0], result[:, 0, 1] = sine, -sine
        result[:, 0, 3] = places[:, 0] - self.axle * cosine
        result[:, 1, 3] = places[:, 1] - self.axle * sine
        result[:, 2, 3] = self.height
        return result

    def place(self, base: Array) -> Array:
        """Returns the place (3,) of a base pose (4, 4)."""
        x, y = base[:2, 3] + self.axle * base[:2, 0]
        return np.array([x, y, np.arctan2(base[1, 0], base[0, 0])])

    def clear(self, postures: Array) -> Flags:
        """Checks whether the robot keeps clear of obstacles at each place."""
        places = postures[:, :2]
        inside = np.asarray(((places >= self.low) & (places <= self.high)).all(axis=1))
        rows = np.flatnonzero(inside)
        if len(rows):
            positions = np.tile(self.positions, (len(rows), 1))
            inside[rows] = self.obstacles.clear(
                self.bases(postures[rows]), positions, self.clearance
            )
        return inside


def wrapped(angle: Array | float) -> Array:
    """Returns an angle modulo a full turn, from -pi to pi.

    >>> float(wrapped(1.5 * np.pi) / np.pi)
    -0.5
    """
    result: Array = (np.asarray(angle) + np.pi) % (2.0 * np.pi) - np.pi
    return result
