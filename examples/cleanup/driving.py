"""Moves a robot along planned paths by its motors, in the running simulation."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from examples.cleanup.kinematics import KinematicChain
from examples.cleanup.spaces import BaseSpace, wrapped
from ssduck.geometry.arrays import Array, Indices
from ssduck.world.entities import Entity

# The number of simulation steps between two commands.
EVERY = 8
# The largest velocity and acceleration of the joints of the arm, rad/s and rad/s².
MAX_VELOCITY = 1.3
MAX_ACCELERATION = 4.0
# The tolerance at the end of a path of the arm, rad, and the number of waits for it.
ARM_TOLERANCE, WAITS = 0.002, 5
# The largest velocities of the base, m/s and rad/s, and accelerations, m/s² and rad/s².
MAX_SPEED, MAX_TURN_RATE = 0.7, 1.2
ROLL_ACCELERATION, TURN_ACCELERATION = 1.0, 2.5
# The tolerances of the base, m and rad, and the time limit of a motion, s.
POSITION_TOLERANCE = 0.006
YAW_TOLERANCE = 0.006
TIME_LIMIT = 40.0


@dataclass(frozen=True, eq=False)
class Mover:
    """Commands the motors of a robot.

    Attributes:
        robot: the robot.
        chain: the kinematic chain of the robot.
        arm: the indices of the joints of the arm.
        wheels: the names of the joints of the left and the right wheel.
        radius: the radius of a wheel, m.
        track: the distance of the wheels, m.
    """

    robot: Entity
    chain: KinematicChain
    arm: Indices
    wheels: tuple[str, str]
    radius: float
    track: float

    def run(self, steps: int) -> None:
        """Runs the simulation."""
        for _ in range(0, steps, EVERY):
            self.robot.world.step(EVERY, every=EVERY)

    def pose(self, postures: dict[str, float], effort: float | None = None) -> None:
        """Sets target positions of joints, which the motors approach from the next step on."""
        efforts = None if effort is None else dict.fromkeys(postures, effort)
        self.robot.drive(postures, efforts=efforts)

    def follow(self, path: Array) -> None:
        """Moves the arm along a path (n, arm joints), and waits until it rests at the end."""
        names = [self.chain.names[column] for column in self.arm]
        clock, path = timed(path)
        step = EVERY * self.robot.world.timestep
        for time in np.arange(step, clock[-1] + step, step):
            posture = [float(np.interp(time, clock, column)) for column in path.T]
            self.pose(dict(zip(names, posture, strict=True)))
            self.run(EVERY)
        for _ in range(WAITS):
            self.run(2 * EVERY)
            deviation = self.chain.state(self.robot)[1][self.arm] - path[-1]
            if np.abs(deviation).max() < ARM_TOLERANCE:
                break

    # -- the base -------------------------------------------------------------------------

    def roll(self, space: BaseSpace, path: Array) -> bool:
        """Drives along a path of places (n, 3); returns whether the robot arrived."""
        for goal, is_turn in legs(path):
            if not (self._turn(space, goal) if is_turn else self._roll_straight(space, goal)):
                self._stop()
                return False
        self._stop()
        return True

    def _stop(self) -> None:
        self._wheels(0.0, 0.0)
        self.run(6 * EVERY)

    def _here(self, space: BaseSpace) -> Array:
        return space.place(self.chain.state(self.robot)[0])

    def _turn(self, space: BaseSpace, goal: Array) -> bool:
        speed, step = 0.0, EVERY * self.robot.world.timestep
        for _ in range(int(TIME_LIMIT / step)):
            remaining = float(wrapped(goal[2] - self._here(space)[2]))
            if abs(remaining) < YAW_TOLERANCE:
                return True
            target = float(np.clip(2.5 * remaining, -MAX_TURN_RATE, MAX_TURN_RATE))
            speed += float(
                np.clip(target - speed, -TURN_ACCELERATION * step, TURN_ACCELERATION * step)
            )
            self._wheels(0.0, speed)
            self.run(EVERY)
        return False

    def _roll_straight(self, space: BaseSpace, goal: Array) -> bool:
        speed, step = 0.0, EVERY * self.robot.world.timestep
        for _ in range(int(TIME_LIMIT / step)):
            here = self._here(space)
            forward = np.array([np.cos(goal[2]), np.sin(goal[2])])
            remaining = float(forward @ (goal[:2] - here[:2]))
            lateral = float(forward[0] * (goal[1] - here[1]) - forward[1] * (goal[0] - here[0]))
            if abs(remaining) < POSITION_TOLERANCE:
                return True
            target = float(np.clip(2.0 * remaining, -MAX_SPEED, MAX_SPEED))
            speed += float(
                np.clip(target - speed, -ROLL_ACCELERATION * step, ROLL_ACCELERATION * step)
            )
            # The heading corrects the lateral deviation.
            heading = goal[2] + float(np.clip(3.0 * lateral, -0.4, 0.4)) * np.sign(speed)
            self._wheels(speed, float(np.clip(2.5 * wrapped(heading - here[2]), -0.6, 0.6)))
            self.run(EVERY)
        return False

    def _wheels(self, speed: float, turning: float) -> None:
        left, right = (
            (speed + side * turning * self.track / 2) / self.radius for side in (-1.0, 1.0)
        )
        self.robot.drive(velocities=dict(zip(self.wheels, (left, right), strict=True)))


def timed(path: Array) -> tuple[Array, Array]:
    """Times a path (n, joints) within the limits of velocity and acceleration.

    The motion slows down where the path bends; a forward and a backward pass bound the
    acceleration.

    Returns:
        The times (m,), s, and the postures (m, joints).
    """
    path = path[np.append(True, np.abs(np.diff(path, axis=0)).max(axis=1) > 1e-9)]
    steps = np.diff(path, axis=0)
    if not len(steps):
        return np.array([0.0]), path
    sizes = np.abs(steps).max(axis=1)
    directions = steps / np.linalg.norm(steps, axis=1)[:, None]
    bend = np.clip(np.einsum("ij,ij->i", directions[:-1], directions[1:]), 0.0, 1.0)
    speeds = np.concatenate(([0.0], MAX_VELOCITY * np.maximum(bend**8, 0.1), [0.0]))
    for i, size in enumerate(sizes):
        speeds[i + 1] = min(speeds[i + 1], np.sqrt(speeds[i] ** 2 + 2 * MAX_ACCELERATION * size))
    for i, size in reversed(list(enumerate(sizes))):
        speeds[i] = min(speeds[i], np.sqrt(speeds[i + 1] ** 2 + 2 * MAX_ACCELERATION * size))
    means = np.maximum((speeds[:-1] + speeds[1:]) / 2, 0.02)
    return np.concatenate(([0.0], np.cumsum(sizes / means))), path


def legs(path: Array) -> list[tuple[Array, bool]]:
    """Splits a path of places into legs; returns the end of each, and whether it is a turn."""
    ends: list[tuple[Array, bool]] = []
    previous_kind, total_turn = 0, 0.0
    for a, b in pairwise(path):
        dx, dy = (b - a)[:2]
        rolls = np.hypot(dx, dy) > 1e-6
        turn = float(wrapped(b[2] - a[2]))
        forward = dx * np.cos(a[2]) + dy * np.sin(a[2])
        kind = int(np.sign(forward)) if rolls else 2 * int(np.sign(turn))
        total_turn = total_turn + abs(turn) if kind == previous_kind else abs(turn)
        # The direction of a turn of half a circle or more would be ambiguous.
        if kind == previous_kind and total_turn < 2.5:
            ends[-1] = (b, not rolls)
        else:
            ends.append((b, not rolls))
            total_turn = abs(turn)
        previous_kind = kind
    return ends
