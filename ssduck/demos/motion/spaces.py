"""What is planned in: postures of an arm, and places of a robot on two wheels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ssduck.demos.motion.kinematics import KinematicChain
from ssduck.demos.motion.obstacles import Obstacles
from ssduck.geometry.arrays import Array, Flags, Indices

# Of an arm: how far anything moves between two postures of a path, m, and what is kept free.
ARM_SPACING = 0.03
ARM_APART = 0.016
ITSELF = 0.01
# The same of the base.
BASE_SPACING = 0.04
BASE_APART = 0.03


@dataclass(frozen=True, eq=False)
class ArmSpace:
    """Postures of an arm, rad, on a base that stands still.

    Attributes:
        chain: the robot.
        around: what it keeps clear of.
        base: (4, 4), where its base is.
        others: (joints,), the positions of all joints; those of the arm are replaced.
        arm: which joints are the arm's.
        levers: (arm joints,), how far from each joint anything is that it moves, m.
        apart: what is kept free around it, m.
    """

    chain: KinematicChain
    around: Obstacles
    base: Array
    others: Array
    arm: Indices
    levers: Array
    apart: float = ARM_APART

    def sample(self, rng: np.random.Generator) -> Array:
        """Any posture within the limits."""
        found: Array = rng.uniform(self.chain.lower[self.arm], self.chain.upper[self.arm])
        return found

    def distances(self, here: Array, others: Array) -> Array:
        """A bound of how far any point of the arm moves, m."""
        found: Array = np.abs(others - here) @ self.levers
        return found

    def way(self, here: Array, there: Array) -> Array:
        """Straight in the space of joints."""
        count = max(2, int(self.distances(here, there[None])[0] / ARM_SPACING) + 2)
        shares = np.linspace(0.0, 1.0, count)[:, None]
        found: Array = here + shares * (there - here)
        return found

    def full(self, postures: Array) -> Array:
        """All joints' positions (n, joints) in postures of the arm."""
        found = np.tile(self.others, (len(postures), 1))
        found[:, self.arm] = postures
        return found

    def clear(self, postures: Array) -> Flags:
        """Whether the arm is clear of all else."""
        bases = np.tile(self.base, (len(postures), 1, 1))
        full = self.full(postures)
        links = range(int(self.chain.links[self.arm].min()), len(self.chain.rest))
        return self.around.clear(
            bases, full, self.apart, moving=links, itself=min(ITSELF, self.apart)
        )


@dataclass(frozen=True, eq=False)
class BaseSpace:
    """Places of a robot on two wheels, its arm held still: x, y, m, of its axle, and yaw, rad.

    It turns on the spot, rolls straight, ahead or back, and turns again.

    Attributes:
        chain: the robot.
        around: what it keeps clear of.
        positions: (joints,), where its joints are.
        height: of the base link's frame, m.
        axle: how far ahead of the base link's origin the axle is, m.
        lever: how far from the axle anything of it is, m.
        low: the least x and y.
        high: the greatest.
        apart: what is kept free around it, m.
    """

    chain: KinematicChain
    around: Obstacles
    positions: Array
    height: float
    axle: float
    lever: float
    low: tuple[float, float]
    high: tuple[float, float]
    apart: float = BASE_APART

    def sample(self, rng: np.random.Generator) -> Array:
        """Anywhere."""
        x, y = rng.uniform(self.low, self.high)
        return np.array([x, y, rng.uniform(-np.pi, np.pi)])

    def distances(self, here: Array, others: Array) -> Array:
        """How far it rolls, and how far its farthest point turns, m."""
        rolled = np.hypot(*(others[:, :2] - here[:2]).T)
        found: Array = rolled + self.lever * np.abs(wrapped(others[:, 2] - here[2]))
        return found

    def way(self, here: Array, there: Array) -> Array:
        """Turn, roll, turn; back if that turns less."""
        dx, dy = there[:2] - here[:2]
        parts = [here[None]]
        if np.hypot(dx, dy) > 1e-6:
            heading = np.arctan2(dy, dx)
            headings = heading, heading + np.pi
            turned = [abs(wrapped(h - here[2])) + abs(wrapped(there[2] - h)) for h in headings]
            heading = headings[int(np.argmin(turned))]
            parts.append(self._turned(here, heading))
            corner = np.concatenate(parts)[-1]
            count = max(2, int(np.hypot(dx, dy) / BASE_SPACING) + 2)
            shares = np.linspace(0.0, 1.0, count)[1:, None]
            parts.append(corner + shares * np.array([dx, dy, 0.0]))
        parts.append(self._turned(np.concatenate(parts)[-1], float(there[2])))
        return np.concatenate(parts)

    def _turned(self, here: Array, yaw: float) -> Array:
        angle = wrapped(yaw - here[2])
        if abs(angle) < 1e-6:
            return np.zeros((0, 3))
        count = int(abs(angle) * self.lever / BASE_SPACING) + 1
        found = np.tile(here, (count, 1))
        found[:, 2] += np.linspace(0.0, angle, count + 1)[1:]
        return found

    def bases(self, places: Array) -> Array:
        """The base link's poses (n, 4, 4) at places (n, 3)."""
        found = np.tile(np.eye(4), (len(places), 1, 1))
        sine, cosine = np.sin(places[:, 2]), np.cos(places[:, 2])
        found[:, 0, 0] = found[:, 1, 1] = cosine
        found[:, 1, 0], found[:, 0, 1] = sine, -sine
        found[:, 0, 3] = places[:, 0] - self.axle * cosine
        found[:, 1, 3] = places[:, 1] - self.axle * sine
        found[:, 2, 3] = self.height
        return found

    def place(self, base: Array) -> Array:
        """The place (3,) of a base at a pose (4, 4)."""
        x, y = base[:2, 3] + self.axle * base[:2, 0]
        return np.array([x, y, np.arctan2(base[1, 0], base[0, 0])])

    def clear(self, postures: Array) -> Flags:
        """Whether it is clear of all else there."""
        places = postures[:, :2]
        inside = np.asarray(((places >= self.low) & (places <= self.high)).all(axis=1))
        some = np.flatnonzero(inside)
        if len(some):
            positions = np.tile(self.positions, (len(some), 1))
            inside[some] = self.around.clear(self.bases(postures[some]), positions, self.apart)
        return inside


def wrapped(angle: Array | float) -> Array:
    """An angle as one from -pi to pi."""
    found: Array = (np.asarray(angle) + np.pi) % (2.0 * np.pi) - np.pi
    return found
