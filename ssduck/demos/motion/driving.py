"""Moving a robot along planned paths by its motors, as the simulation runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ssduck.demos.motion.kinematics import KinematicChain
from ssduck.demos.motion.spaces import BaseSpace, wrapped
from ssduck.geometry.arrays import Array, Indices
from ssduck.world.entities import Entity

# Steps of the simulation between two commands.
EVERY = 8
# Of the arm: rad/s, rad/s² of every joint.
FASTEST = 1.3
SWIFTEST = 4.0
# How near its end the arm is to be, rad, and how often it is waited for.
ARRIVED, RESTS = 0.002, 5
# Of the base: m/s and rad/s, and what these change in a second.
ROLLING, TURNING = 0.7, 1.2
ROLLING_MORE, TURNING_MORE = 1.0, 2.5
# How near the base is to get to where it is to be: m, rad; and how long it may take, s.
THERE = 0.006
TURNED = 0.006
PATIENCE = 40.0


@dataclass(frozen=True, eq=False)
class Mover:
    """Drives a robot's motors.

    Attributes:
        robot: the robot.
        chain: its links.
        arm: which joints are the arm's.
        wheels: the names of its left and its right wheel's joint.
        radius: of a wheel, m.
        track: from wheel to wheel, m.
        after: is called after each command's steps.
    """

    robot: Entity
    chain: KinematicChain
    arm: Indices
    wheels: tuple[str, str]
    radius: float
    track: float
    after: Callable[[], object]

    def run(self, steps: int) -> None:
        """Let the simulation run."""
        for _ in range(0, steps, EVERY):
            self.robot.world.step(EVERY)
            self.after()

    def pose(self, postures: dict[str, float], effort: float | None = None) -> None:
        """Let motors take joints somewhere from the next step on."""
        efforts = None if effort is None else dict.fromkeys(postures, effort)
        self.robot.drive(postures, efforts=efforts)

    def follow(self, path: Array) -> None:
        """Move the arm along a path (n, arm joints), and let it come to rest at its end."""
        names = [self.chain.names[column] for column in self.arm]
        clock, path = timed(path)
        step = EVERY * self.robot.world.timestep
        for now in np.arange(step, clock[-1] + step, step):
            posture = [float(np.interp(now, clock, column)) for column in path.T]
            self.pose(dict(zip(names, posture, strict=True)))
            self.run(EVERY)
        for _ in range(RESTS):
            self.run(2 * EVERY)
            off = self.chain.now(self.robot)[1][self.arm] - path[-1]
            if np.abs(off).max() < ARRIVED:
                break

    # -- the base -------------------------------------------------------------------------

    def roll(self, space: BaseSpace, path: Array) -> bool:
        """Drive along a path of places (n, 3); whether it got there."""
        for goal, turns in legs(path):
            if not (self._turn(space, goal) if turns else self._go(space, goal)):
                self._stop()
                return False
        self._stop()
        return True

    def _stop(self) -> None:
        self._wheels(0.0, 0.0)
        self.run(6 * EVERY)

    def _here(self, space: BaseSpace) -> Array:
        return space.place(self.chain.now(self.robot)[0])

    def _turn(self, space: BaseSpace, goal: Array) -> bool:
        speed, step = 0.0, EVERY * self.robot.world.timestep
        for _ in range(int(PATIENCE / step)):
            left = float(wrapped(goal[2] - self._here(space)[2]))
            if abs(left) < TURNED:
                return True
            wanted = float(np.clip(2.5 * left, -TURNING, TURNING))
            speed += float(np.clip(wanted - speed, -TURNING_MORE * step, TURNING_MORE * step))
            self._wheels(0.0, speed)
            self.run(EVERY)
        return False

    def _go(self, space: BaseSpace, goal: Array) -> bool:
        speed, step = 0.0, EVERY * self.robot.world.timestep
        for _ in range(int(PATIENCE / step)):
            here = self._here(space)
            ahead = np.array([np.cos(goal[2]), np.sin(goal[2])])
            left = float(ahead @ (goal[:2] - here[:2]))
            aside = float(ahead[0] * (goal[1] - here[1]) - ahead[1] * (goal[0] - here[0]))
            if abs(left) < THERE:
                return True
            wanted = float(np.clip(2.0 * left, -ROLLING, ROLLING))
            speed += float(np.clip(wanted - speed, -ROLLING_MORE * step, ROLLING_MORE * step))
            # Towards the line, and along it.
            heading = goal[2] + float(np.clip(3.0 * aside, -0.4, 0.4)) * np.sign(speed)
            self._wheels(speed, float(np.clip(2.5 * wrapped(heading - here[2]), -0.6, 0.6)))
            self.run(EVERY)
        return False

    def _wheels(self, speed: float, turning: float) -> None:
        left, right = (
            (speed + side * turning * self.track / 2) / self.radius for side in (-1.0, 1.0)
        )
        self.robot.drive(velocities=dict(zip(self.wheels, (left, right), strict=True)))


def timed(path: Array) -> tuple[Array, Array]:
    """When to be where on a path (n, joints): as fast as speeds and their changes allow.

    Where the path bends it slows down; passes ahead and back bound the acceleration.

    Returns:
        Seconds (m,), and the postures (m, joints).
    """
    path = path[np.append(True, np.abs(np.diff(path, axis=0)).max(axis=1) > 1e-9)]
    steps = np.diff(path, axis=0)
    if not len(steps):
        return np.array([0.0]), path
    sizes = np.abs(steps).max(axis=1)
    ways = steps / np.linalg.norm(steps, axis=1)[:, None]
    bend = np.clip(np.einsum("ij,ij->i", ways[:-1], ways[1:]), 0.0, 1.0)
    speeds = np.concatenate(([0.0], FASTEST * np.maximum(bend**8, 0.1), [0.0]))
    for i, size in enumerate(sizes):
        speeds[i + 1] = min(speeds[i + 1], np.sqrt(speeds[i] ** 2 + 2 * SWIFTEST * size))
    for i, size in reversed(list(enumerate(sizes))):
        speeds[i] = min(speeds[i], np.sqrt(speeds[i + 1] ** 2 + 2 * SWIFTEST * size))
    means = np.maximum((speeds[:-1] + speeds[1:]) / 2, 0.02)
    return np.concatenate(([0.0], np.cumsum(sizes / means))), path


def legs(path: Array) -> list[tuple[Array, bool]]:
    """Where a path of places turns or stops: the end of each leg, and whether it turned there."""
    found: list[tuple[Array, bool]] = []
    before, turned = 0, 0.0
    for a, b in pairwise(path):
        dx, dy = (b - a)[:2]
        rolls = np.hypot(dx, dy) > 1e-6
        turn = float(wrapped(b[2] - a[2]))
        ahead = dx * np.cos(a[2]) + dy * np.sin(a[2])
        kind = int(np.sign(ahead)) if rolls else 2 * int(np.sign(turn))
        turned = turned + abs(turn) if kind == before else abs(turn)
        # Half a turn ahead, nobody knows which way is meant.
        if kind == before and turned < 2.5:
            found[-1] = (b, not rolls)
        else:
            found.append((b, not rolls))
            turned = abs(turn)
        before = kind
    return found
