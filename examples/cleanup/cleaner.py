"""Plans and executes the work of a wheeled robot whose arm and hand put cups away."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from examples.cleanup.driving import Mover
from examples.cleanup.kinematics import KinematicChain
from examples.cleanup.obstacles import HeldEntity, Obstacles, Wall, hull_in, walls_of
from examples.cleanup.planning import plan, shortened
from examples.cleanup.spaces import (
    ARM_CLEARANCE,
    ARM_SPACING,
    BASE_CLEARANCE,
    ArmSpace,
    BaseSpace,
)
from ssduck.errors import StateError
from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.world.entities import Entity
from ssduck.world.world import World

T = TypeVar("T")

ARM = ("j1", "j2", "j3", "j4", "j5", "j6", "j7")
WHEELS = ("left_wheel", "right_wheel")
RADIUS, TRACK, AXLE = 0.24, 0.49, -0.04
# The largest distance of moved parts from each joint of the arm, and from the axle, m.
LEVERS = np.array([1.1, 1.1, 0.85, 0.7, 0.45, 0.38, 0.15])
LEVER = 0.4
# The centre of a held cup's rim in the hand's frame, m: at the fingertips, which are upright there.
# Further in the fingers slant, and their force would push the cup off.
GRIP = np.array([0.0, 0.0, 0.135])
# Positions of fingers that fit into a cup, and that press against its walls, rad; effort, N m.
CLOSED = {"f1": 0.3, "f2": 0.25, "f3": 0.25, "spread": 0.0}
OPEN = {"f1": 0.0, "f2": 0.0, "f3": 0.0}
EFFORT = 5.0
UP = np.array([0.0, 0.0, 1.0])
# Heights above a cup from which the hand goes straight down, m; heights to go up if no other
# path is found; and the step of such straight motions.
APPROACH_HEIGHTS = (0.06, 0.09)
LIFT_HEIGHTS = (0.2, 0.1, 0.05)
STEP = 0.01
# The centre of the rim of a carried cup in the frame of the base: higher than the cups on the
# table.
CARRIED = np.array([0.2, 0.0, 0.36])
# Numbers of samples: places to stand, postures of the arm at each, random postures of a plan.
PLACES, POSTURES, SAMPLES = 5000, 4, 1000
FLOOR = 0.16
# The attempts of randomized steps, and the waits for fingers to close.
ATTEMPTS = 3
PATIENCE = 10
# The reach of the arm with a cup from the frame of the base, m.
REACH = 1.4
# Clearances of the arm if no other path is found, m.
NARROW_CLEARANCE = 0.004
LEAST_CLEARANCE = 0.001
# Heights above a spot from which a cup may fall, and above these from which the hand goes straight
# down, m; it also leaves the basin of a sink straight upwards.
FALLS = ((0.03, 0.15), (0.08, 0.1), (0.15, 0.03))
# The same for putting a cup back: it keeps clear of the table until it falls.
SET_DOWN = (ARM_CLEARANCE + 0.004, 0.09)


class Failed(Exception):  # noqa: N818  # a regular outcome, not an error
    """The reason why a step failed."""


class OutOfReach(Failed):
    """No place to stand was found, and further attempts would hardly find one."""


@dataclass(frozen=True, eq=False)
class Descent:
    """A straight descent of the grip from one point (3,) to another."""

    above: Array
    goal: Array


def _descents(
    spots: Sequence[Array], hanging_length: float, falls: Sequence[tuple[float, float]]
) -> list[list[Descent]]:
    """Returns descents for dropping a cup held below the grip, a list for each fall height."""
    return [
        [
            Descent(spot + (fall + hanging_length + lift) * UP, spot + (fall + hanging_length) * UP)
            for spot in spots
        ]
        for fall, lift in falls
    ]


@dataclass(frozen=True, eq=False)
class StandingPlace:
    """A place to stand (3,), the posture of the arm there (arm joints,), and the descent."""

    place: Array
    posture: Array
    descent: Descent


class Cleaner:
    """Plans and executes the motions of the robot.

    Args:
        robot: the robot, with its arm clear of obstacles.
        rng: the random numbers of the planners.
    """

    def __init__(self, robot: Entity, rng: np.random.Generator) -> None:
        self.robot, self.rng = robot, rng
        self.world: World = robot.world
        self.chain = KinematicChain.of(robot)
        self.arm = self.chain.columns(ARM)
        self.hand = self.chain.link("arm7")
        self.mover = Mover(robot, self.chain, self.arm, WHEELS, RADIUS, TRACK)
        self.held: HeldEntity | None = None
        self._fixed: dict[int, list[Wall]] = {}
        self._pick_spot = np.zeros(3)  # where the bottom of the held cup was
        self._last_path = np.zeros((0, len(ARM)))  # of the arm
        self.mover.pose(CLOSED)
        self.mover.run(60)
        self.carrying_posture = self._carrying_posture()

    # -- tasks ----------------------------------------------------------------------------

    def prepare(self) -> None:
        """Brings the arm to its posture for driving.

        Raises:
            Failed: no path was found.
        """
        self._move_arm(self.carrying_posture)

    def recover(self) -> None:
        """Puts back a held cup, lifts the hand and retracts the arm.

        Raises:
            Failed: a step failed.
        """
        if self.held is not None:
            self.drop([self._pick_spot], [SET_DOWN])
            return
        self._open()
        self.mover.follow(self._path_up())
        self._retry(lambda: self._move_arm(self.carrying_posture))

    def pick(self, cup: Entity) -> None:
        """Picks up a cup that stands upright.

        Raises:
            Failed: a step failed.
        """
        low, high = cup.aabb
        rim = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, high[2]])
        descents = [Descent(rim + above * UP, rim) for above in APPROACH_HEIGHTS]
        down = self._retry(lambda: self._reach_over(descents, cup))
        self.mover.follow(down)
        self._grasp(cup)
        self._pick_spot = np.array([*rim[:2], low[2]])
        self._lift(down[::-1])

    def _lift(self, up: Array) -> None:
        """Lifts a held cup and retracts the arm, or puts the cup back if no path is found."""
        self.mover.follow(up)
        try:
            self._move_arm(self.carrying_posture)
        except Failed:
            higher = self._path_up()
            self.mover.follow(higher)
            up = np.concatenate((up, higher))
            try:
                self._retry(lambda: self._move_arm(self.carrying_posture))
            except Failed as failure:
                self.mover.follow(up[::-1])
                self._open()
                self.mover.follow(up)
                raise Failed(f"{failure} with it in the hand, and it was put back") from failure

    def _path_up(self) -> Array:
        """Returns a straight and clear path (n, arm joints) of the hand upwards."""
        grip, now = self._grip_position(), self._arm_posture()
        base, _ = self.chain.state(self.robot)
        space = self._arm_space(base, self._obstacles_in_reach(base), NARROW_CLEARANCE)
        for height in LIFT_HEIGHTS:
            try:
                path = self._line(now, grip, grip + height * UP)
            except Failed:
                continue
            if space.clear(path).all():
                return path
        return now[None]

    def _grasp(self, cup: Entity) -> None:
        """Spreads the fingers until two of them touch the cup, and holds it."""
        self.mover.pose(OPEN, EFFORT)
        for _ in range(PATIENCE):
            self.mover.run(24)
            try:
                self.robot.hold(cup, "arm7", touching=2)
            except StateError as error:
                failed = error
                continue
            break
        else:
            raise Failed("the fingers do not touch it") from failed
        self.held = HeldEntity(self.hand, cup, hull_in(self._hand_pose(), cup))
        # The constraint holds the cup, so the fingers stop pressing.
        fingers = self.chain.columns(list(OPEN))
        now = self.chain.state(self.robot)[1][fingers]
        self.mover.pose(dict(zip(OPEN, map(float, now), strict=True)))

    def can_drop(self, cup: Entity, spots: Sequence[Array]) -> bool:
        """Checks whether the robot finds a place to stand for dropping a cup on one of some spots.

        Args:
            cup: an upright cup, held as by `pick`.
            spots: (3,) each, possible positions of the bottom of the cup, m.
        """
        low, high = (np.array(corner) for corner in cup.aabb)
        hand = np.diag([1.0, -1.0, -1.0, 1.0])
        hand[:3, 3] = [*(low + high)[:2] / 2, high[2] + GRIP[2]]
        self.held = HeldEntity(self.hand, cup, hull_in(hand, cup))
        try:
            space = self._base_space()
            here = space.place(self.chain.state(self.robot)[0])
            descents = _descents(spots, high[2] - low[2], FALLS)
            return any(
                True
                for options in descents
                for _ in self._places_to_stand(space, here, options, None)
            )
        finally:
            self.held = None

    def drop(self, spots: Sequence[Array], falls: Sequence[tuple[float, float]] = FALLS) -> None:
        """Brings the held cup to one of some spots, drops it there, and retracts the arm.

        Args:
            spots: (3,) each, possible positions of the bottom of the cup, m.
            falls: heights above a spot from which the cup may fall, and above these from which
                the hand goes straight down, m; in the order of attempts.

        Raises:
            Failed: a step failed; the cup is still held unless `held` is None.
        """
        assert self.held is not None
        hanging_length = self._grip_position()[2] - self.held.entity.aabb[0][2]
        self._retry(lambda: self._lower(_descents(spots, hanging_length, falls)))
        self._retry(lambda: self._move_arm(self.carrying_posture))

    def _lower(self, descents: Sequence[Sequence[Descent]]) -> None:
        for options in descents:
            try:
                down = self._reach_over(options)
            except Failed as failure:
                failed = failure
                continue
            self.mover.follow(down)
            self._open()
            self.mover.follow(down[::-1])
            return
        raise failed

    def _open(self) -> None:
        """Draws the fingers together and releases the held cup."""
        if self.held is not None:
            self.robot.release(self.held.entity)
        self.held = None
        self.mover.pose(CLOSED)
        self.mover.run(60)

    def _retry(self, act: Callable[[], T]) -> T:
        """Executes a randomized step, with several attempts if it fails."""
        for _ in range(ATTEMPTS):
            try:
                return act()
            except OutOfReach:
                raise
            except Failed as failure:
                failed = failure
        raise failed

    # -- postures -------------------------------------------------------------------------

    def _carrying_posture(self) -> Array:
        """Returns the carrying posture in which the robot needs the least room."""
        base, (_, angles) = np.eye(4), self.chain.state(self.robot)
        postures = self._solve(base, CARRIED, 64, angles)
        space = self._arm_space(base, self._obstacles(()))
        postures = postures[space.clear(postures)]
        frames = self.chain.frames(np.tile(base, (len(postures), 1, 1)), space.full(postures))
        size = np.hypot(frames[..., 0, 3], frames[..., 1, 3]).max(axis=1)
        smallest: Array = postures[int(size.argmin())]
        return smallest

    def _solve(
        self, base: Array, rim: Array, count: int, angles: Array, spread: float | None = None
    ) -> Array:
        """Returns postures (n, arm joints) with the hand over a rim, solved from random starts.

        Args:
            base: (4, 4), the pose of the base.
            rim: (3,), the centre of the rim in the world, m.
            count: the number of starts.
            angles: (joints,), the positions of all joints.
            spread: the largest deviation of starts from `angles`, rad; None for the joint limits.
        """
        starts = np.tile(angles, (count, 1))
        low, high = self.chain.lower[self.arm], self.chain.upper[self.arm]
        samples = self.rng.uniform(low, high, (count, len(self.arm)))
        if spread is not None:
            samples = angles[self.arm] + self.rng.uniform(-spread, spread, samples.shape)
        starts[:, self.arm] = np.clip(samples, low, high)
        goals = np.tile([*rim, 0.0, 0.0, -1.0], (count, 1))
        bases = np.tile(base, (count, 1, 1))
        positions, solved = self.chain.solve(bases, starts, self.arm, self.hand, GRIP, goals)
        postures: Array = positions[solved][:, self.arm]
        return postures

    def _reach_over(
        self, descents: Sequence[Descent], ignored_entity: Entity | None = None
    ) -> Array:
        """Drives to a place for a descent, and brings the hand to the start of the descent.

        Args:
            descents: the possible descents.
            ignored_entity: an entity that the fingers may touch at the end.

        Returns:
            The path of the arm for the descent, (n, arm joints).
        """
        stand = self._drive_to(descents, ignored_entity)
        above, goal = stand.descent.above, stand.descent.goal
        self._move_arm(self._posture_above(above, goal, stand.posture, ignored_entity))
        down = self._line(self._arm_posture(), above, goal)
        base, _ = self.chain.state(self.robot)
        obstacles = self._obstacles_in_reach(base, ignored_entity)
        if not self._arm_space(base, obstacles, NARROW_CLEARANCE).clear(down).all():
            raise Failed("something is in the arm's way")
        return down

    def _drive_to(
        self, descents: Sequence[Descent], ignored_entity: Entity | None
    ) -> StandingPlace:
        """Drives to a place from which the hand reaches both ends of a descent."""
        if np.abs(self._arm_posture() - self.carrying_posture).max() > 0.1:
            self._move_arm(self.carrying_posture)
        space = self._base_space()
        here = space.place(self.chain.state(self.robot)[0])
        for stand in self._places_to_stand(space, here, descents, ignored_entity):
            for clearance in (BASE_CLEARANCE, NARROW_CLEARANCE):
                near = replace(space, clearance=clearance)
                path = plan(near, here, stand.place, self.rng, SAMPLES // 10, 1.0)
                if path is None:
                    continue
                if not self.mover.roll(near, shortened(near, path, self.rng, 60)):
                    raise Failed("the robot is stuck on its way")
                return stand
        raise OutOfReach("there is no place to stand from which the arm reaches it")

    def _places_to_stand(
        self,
        space: BaseSpace,
        here: Array,
        descents: Sequence[Descent],
        ignored_entity: Entity | None,
    ) -> Iterator[StandingPlace]:
        """Yields places from which the hand reaches both ends of a descent, the nearest first."""
        obstacles = self._obstacles(self._walls(ignored_entity))
        places, numbers = self._places(space, here, descents)
        for start in range(0, len(places), 32):
            batch = start + np.flatnonzero(space.clear(places[start : start + 32]))
            if not len(batch):
                continue
            rows = np.repeat(batch, POSTURES)
            bases = space.bases(places[rows])
            above = np.array([descents[number].above for number in numbers[rows]])
            positions, solved = self._postures_over(bases, above)
            for row in np.flatnonzero(solved):
                arm = self._arm_space(bases[row], obstacles)
                posture, descent = positions[row, self.arm], descents[numbers[rows[row]]]
                if not arm.clear(posture[None])[0]:
                    continue
                try:
                    line = self._line(posture, descent.above, descent.goal, bases[row])
                except Failed:
                    continue
                if arm.clear(line).all():
                    yield StandingPlace(places[rows[row]], posture, descent)

    def _places(
        self, space: BaseSpace, here: Array, descents: Sequence[Descent]
    ) -> tuple[Array, Indices]:
        """Returns random places (n, 3) by distance, and the indices of their descents (n,)."""
        numbers = self.rng.integers(len(descents), size=PLACES)
        x, y, _ = np.array([descents[number].above for number in numbers]).T
        distances = self.rng.uniform(0.3, 0.85, PLACES)
        bearing, yaw = self.rng.uniform(-np.pi, np.pi, (2, PLACES))
        # The first joint of the arm is behind the axle.
        x += distances * np.cos(bearing) + 0.06 * np.cos(yaw)
        y += distances * np.sin(bearing) + 0.06 * np.sin(yaw)
        places = np.concatenate((np.tile(here, (len(descents), 1)), np.stack((x, y, yaw), axis=1)))
        numbers = np.concatenate((np.arange(len(descents)), numbers))
        order = np.argsort(space.distances(here, places))
        return places[order], numbers[order]

    def _postures_over(self, bases: Array, above: Array) -> tuple[Array, Flags]:
        """Returns joint positions (n, joints) with the hand over points, and their success (n,)."""
        starts = np.tile(self.chain.state(self.robot)[1], (len(bases), 1))
        low, high = self.chain.lower[self.arm], self.chain.upper[self.arm]
        starts[:, self.arm] = self.rng.uniform(low, high, (len(bases), len(self.arm)))
        goals = np.concatenate((above, np.tile([0.0, 0.0, -1.0], (len(bases), 1))), axis=1)
        return self.chain.solve(bases, starts, self.arm, self.hand, GRIP, goals)

    def _posture_above(
        self, above: Array, goal: Array, near: Array, ignored_entity: Entity | None
    ) -> Array:
        """Returns a posture over a point, preferably near another one, with a clear descent."""
        base, angles = self.chain.state(self.robot)
        angles[self.arm] = near
        near_postures, others = (
            self._solve(base, above, n, angles, spread) for n, spread in ((16, 0.1), (300, None))
        )
        order = np.argsort(np.abs(near_postures - near).max(axis=1))
        postures = np.concatenate((near_postures[order], others))
        space = self._arm_space(base, self._obstacles_in_reach(base))
        down = self._arm_space(base, self._obstacles_in_reach(base, ignored_entity))
        clear: Sequence[Array] = list(postures[space.clear(postures)]) if len(postures) else []
        for posture in clear:
            try:
                if down.clear(self._line(posture, above, goal)).all():
                    return posture
            except Failed:
                continue
        raise Failed("the arm does not reach it from here")

    def _line(self, posture: Array, start: Array, end: Array, base: Array | None = None) -> Array:
        """Returns the postures on a straight line of the grip, from a posture at its start."""
        here, angles = self.chain.state(self.robot)
        base = here if base is None else base
        count = int(np.linalg.norm(end - start) / STEP) + 2
        full = angles.copy()
        full[self.arm] = posture
        path = [posture]
        for share in np.linspace(0.0, 1.0, count)[1:]:
            goal = np.array([[*(start + share * (end - start)), 0.0, 0.0, -1.0]])
            positions, solved = self.chain.solve(
                base[None], full[None], self.arm, self.hand, GRIP, goal
            )
            if not solved[0] or np.abs(positions[0, self.arm] - path[-1]).max() > 0.3:
                raise Failed("the arm does not reach all the way")
            full = positions[0]
            path.append(full[self.arm])
        return np.array(path)

    # -- motions --------------------------------------------------------------------------

    def _move_arm(self, posture: Array) -> None:
        """Moves the arm to a posture along a planned path."""
        base, _ = self.chain.state(self.robot)
        space = self._arm_space(base, self._obstacles_in_reach(base))
        path = self._path_back(space, posture)
        for clearance in (ARM_CLEARANCE, NARROW_CLEARANCE, LEAST_CLEARANCE):
            if path is None:
                space = replace(space, clearance=clearance)
                path = plan(space, self._arm_posture(), posture, self.rng, SAMPLES, 0.8)
                path = None if path is None else shortened(space, path, self.rng, 120)
        if path is None:
            raise Failed("no clear path of the arm was found")
        self._last_path = path
        self.mover.follow(path)

    def _path_back(self, space: ArmSpace, posture: Array) -> Array | None:
        """Returns the last path reversed, if it leads to a posture and is still clear."""
        if not len(self._last_path) or np.abs(self._last_path[0] - posture).max() > 0.02:
            return None
        path = np.concatenate((self._arm_posture()[None], self._last_path[::-1], posture[None]))
        is_joined = float(space.distances(path[0], path[1:2])[0]) <= ARM_SPACING
        is_clear = is_joined and replace(space, clearance=NARROW_CLEARANCE).clear(path).all()
        return path if is_clear else None

    def _arm_posture(self) -> Array:
        now: Array = self.chain.state(self.robot)[1][self.arm]
        return now

    def _grip_position(self) -> Array:
        """Returns the position of the grip, (3,)."""
        position: Array = (self._hand_pose() @ np.append(GRIP, 1.0))[:3]
        return position

    def _hand_pose(self) -> Array:
        base, angles = self.chain.state(self.robot)
        pose: Array = self.chain.frames(base[None], angles[None])[0, self.hand]
        return pose

    # -- obstacles ------------------------------------------------------------------------

    def _walls(self, ignored_entity: Entity | None = None) -> list[Wall]:
        """Returns the shapes of all other entities; those of fixed entities are cached."""
        held = None if self.held is None else self.held.entity
        walls = []
        for entity in self.world:
            if entity.kind == "sensor" or entity in (self.robot, held, ignored_entity):
                continue
            if entity.mass > 0.0:
                walls += walls_of(entity)
                continue
            if entity.id not in self._fixed:
                self._fixed[entity.id] = walls_of(entity)
            walls += self._fixed[entity.id]
        return walls

    def _obstacles(self, walls: Sequence[Wall]) -> Obstacles:
        return Obstacles(self.chain, self.robot, walls, self.held, self.chain.descendants("arm7"))

    def _obstacles_in_reach(self, base: Array, ignored_entity: Entity | None = None) -> Obstacles:
        """Returns the obstacles within reach of the arm from a base pose."""
        low, high = base[:3, 3] - REACH, base[:3, 3] + REACH
        return self._obstacles(
            [
                wall
                for wall in self._walls(ignored_entity)
                if (wall.low <= high).all() and (wall.high >= low).all()
            ]
        )

    def _arm_space(
        self, base: Array, obstacles: Obstacles, clearance: float = ARM_CLEARANCE
    ) -> ArmSpace:
        _, angles = self.chain.state(self.robot)
        return ArmSpace(self.chain, obstacles, base, angles, self.arm, LEVERS, clearance)

    def _base_space(self) -> BaseSpace:
        base, angles = self.chain.state(self.robot)
        obstacles = self._obstacles([wall for wall in self._walls() if wall.high[2] > FLOOR])
        low, high = self.world["kitchen"].aabb
        return BaseSpace(
            self.chain,
            obstacles,
            angles,
            float(base[2, 3]),
            AXLE,
            LEVER,
            (low[0], low[1]),
            (high[0], high[1]),
        )
