"""A robot on wheels, with an arm and a hand, that takes cups to where they belong."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ssduck.demos.chain import Chain
from ssduck.demos.motion import Mover
from ssduck.demos.obstacles import Held, Surroundings, Wall, hull_in, walls_of
from ssduck.demos.planning import plan, shortened
from ssduck.demos.spaces import ARM_APART, ARM_SPACING, BASE_APART, ArmSpace, BaseSpace
from ssduck.entities import Entity
from ssduck.geometry import Array
from ssduck.narrow import TOUCHES
from ssduck.world import World

ARM = ("j1", "j2", "j3", "j4", "j5", "j6", "j7")
WHEELS = ("left_wheel", "right_wheel")
RADIUS, TRACK, AXLE = 0.24, 0.49, -0.04
# How far from each joint of the arm, and from the axle, anything is, m.
LEVERS = np.array([1.1, 1.1, 0.85, 0.7, 0.45, 0.38, 0.15])
LEVER = 0.4
# Where a cup's rim is in the hand's frame when the fingers are in it, m: at their tips, which
# are upright against it then. Deeper in they slant, and their force would push the cup off.
GRIP = np.array([0.0, 0.0, 0.135])
# Fingers that fit into a cup, rad; spread against its walls they hold it by friction, N m.
NARROW = {"f1": 0.3, "f2": 0.25, "f3": 0.25, "spread": 0.0}
SPREAD = {"f1": 0.0, "f2": 0.0, "f3": 0.0}
FORCE = 5.0
UP = np.array([0.0, 0.0, 1.0])
# How far above a cup the hand begins to go straight down, m, and in what steps.
ABOVE = 0.09
STEP = 0.01
# Where the arm holds a cup's rim while the robot drives, in the base's frame: a cup there is
# higher than those on the table.
CARRIED = np.array([0.2, 0.0, 0.36])
# The hand with a cup is tilted no more, rad.
TILT = 0.7
# What is tried: places to stand at, postures of the arm at each, random postures of a plan.
PLACES, POSTURES, TRIES = 600, 4, 400
FLOOR = 0.16
# How often it tries to draw the arm back.
CHANCES = 3
# How far from its base's frame the arm reaches with a cup, m.
REACH = 1.4
# If there is no other way, the arm comes as near to things, m.
NARROWLY = 0.004
# How much of its speed the arm has with a cup.
CAREFUL = 0.6


class Failed(Exception):  # noqa: N818  # it is no error: it is what is told
    """Why a cup was not taken away."""


@dataclass(frozen=True, eq=False)
class Stand:
    """Where to stand, (3,), and the arm's posture there, (arm joints,)."""

    place: Array
    posture: Array


class Cleaner:
    """Plans and runs what the robot does.

    Args:
        robot: the robot, its arm out of the way.
        rng: chance.
        after: is called as the simulation runs.
    """

    def __init__(
        self,
        robot: Entity,
        rng: np.random.Generator,
        after: Callable[[], object],
    ) -> None:
        self.robot, self.rng = robot, rng
        self.world: World = robot.world
        self.chain = Chain.of(robot)
        self.arm = self.chain.columns(ARM)
        self.hand = self.chain.link("arm7")
        self.mover = Mover(robot, self.chain, self.arm, WHEELS, RADIUS, TRACK, after)
        self.held: Held | None = None
        self._fixed: dict[int, list[Wall]] = {}
        self._last = np.zeros((0, len(ARM)))  # the arm's last planned path
        self.mover.pose(NARROW)
        self.mover.run(60)
        self.carrying = self._carrying()

    # -- what it does ---------------------------------------------------------------------

    def prepare(self) -> None:
        """Bring the arm to where it is while the robot drives.

        Raises:
            Failed: it cannot.
        """
        self._bring(self.carrying)

    def recover(self) -> None:
        """Let go of whatever is held, draw the hand up and the arm back.

        Raises:
            Failed: it cannot.
        """
        self.mover.pose(NARROW)
        self.mover.run(60)
        self.held = None
        grip = self._hand() @ np.append(GRIP, 1.0)
        for height in (0.2, 0.1, 0.05):
            try:
                up = self._line(self._now(), grip[:3], grip[:3] + height * UP)
            except Failed:
                continue
            self.mover.follow(up)
            break
        for _ in range(CHANCES):
            try:
                self._bring(self.carrying)
            except Failed as failure:
                failed = failure
            else:
                return
        raise failed

    def pick(self, cup: Entity) -> None:
        """Take a cup that stands upright.

        Raises:
            Failed: it cannot.
        """
        low, high = cup.aabb
        rim = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, high[2]])
        above = rim + ABOVE * UP
        down = self._reach_over(above, rim, but=cup)
        self.mover.follow(down)
        self.mover.pose(SPREAD, FORCE)
        self.mover.run(120)
        if not self._touches(cup):
            raise Failed("the fingers do not touch it")
        self.mover.follow(self._line(self._now(), rim, above))
        if cup.position[2] < low[2] + ABOVE / 2:
            raise Failed("it slipped out of the fingers")
        base, angles = self.chain.now(self.robot)
        frame = self.chain.frames(base[None], angles[None])[0, self.hand]
        self.held = Held(self.hand, cup, hull_in(frame, cup))
        self._bring(self.carrying)

    def drop(self, spot: Array) -> None:
        """Bring what it holds to a spot, let go of it, and draw the arm back.

        Args:
            spot: (3,), where its underside is to be, m.

        Raises:
            Failed: it cannot.
        """
        assert self.held is not None
        cup = self.held.entity
        hangs = self._hand()[:3, 3] + self._hand()[:3, :3] @ GRIP - cup.aabb[0]
        goal = spot + hangs[2] * UP
        above = goal + 0.22 * UP
        down = self._reach_over(above, goal)
        if (lost := self._lost()) is not None:
            raise Failed(lost)
        self.mover.follow(down)
        self.mover.pose(NARROW)
        self.mover.run(120)
        self.held = None
        self.mover.follow(self._line(self._now(), goal, above))
        self._bring(self.carrying)

    # -- where ----------------------------------------------------------------------------

    def _carrying(self) -> Array:
        """The posture of the arm in which the robot takes the least room."""
        base, (_, angles) = np.eye(4), self.chain.now(self.robot)
        found = self._solve(base, CARRIED, 64, angles)
        space = self._arm_space(base, self._around(()))
        found = found[space.clear(found)]
        frames = self.chain.frames(np.tile(base, (len(found), 1, 1)), space.full(found))
        size = np.hypot(frames[..., 0, 3], frames[..., 1, 3]).max(axis=1)
        least: Array = found[int(size.argmin())]
        return least

    def _solve(
        self, base: Array, rim: Array, count: int, angles: Array, off: float | None = None
    ) -> Array:
        """Postures (n, arm joints) that bring the hand over a rim, found from random ones.

        Args:
            base: (4, 4).
            rim: (3,), in the world, m.
            count: from how many.
            angles: (joints,), of all joints.
            off: how far these are off `angles`, rad; None for any within the limits.
        """
        starts = np.tile(angles, (count, 1))
        low, high = self.chain.lower[self.arm], self.chain.upper[self.arm]
        random = self.rng.uniform(low, high, (count, len(self.arm)))
        if off is not None:
            random = angles[self.arm] + self.rng.uniform(-off, off, random.shape)
        starts[:, self.arm] = np.clip(random, low, high)
        goals = np.tile([*rim, 0.0, 0.0, -1.0], (count, 1))
        bases = np.tile(base, (count, 1, 1))
        found, solved = self.chain.reach(bases, starts, self.arm, self.hand, GRIP, goals)
        postures: Array = found[solved][:, self.arm]
        return postures

    def _reach_over(self, above: Array, goal: Array, but: Entity | None = None) -> Array:
        """Drive to where the hand reaches two points, and bring it over the first.

        Returns:
            The way of the arm down to the second, (n, arm joints).
        """
        posture = self._drive_to(above, goal, but)
        self._bring(self._posture(above, goal, posture, but))
        down = self._line(self._now(), above, goal)
        base, _ = self.chain.now(self.robot)
        if not self._arm_space(base, self._near(base, but), NARROWLY).clear(down).all():
            raise Failed("something is in the arm's way")
        return down

    def _drive_to(self, above: Array, goal: Array, but: Entity | None) -> Array:
        """Drive to where the hand reaches both points; the arm's posture over the first."""
        if np.abs(self._now() - self.carrying).max() > 0.1:
            self._bring(self.carrying)
        space = self._base_space()
        here = space.place(self.chain.now(self.robot)[0])
        for stand in self._stands(space, here, above, goal, but):
            for apart in (BASE_APART, NARROWLY):
                space = replace(space, apart=apart)
                path = plan(space, here, stand.place, self.rng, TRIES // 4, 1.0)
                if path is None:
                    continue
                path = shortened(space, path, self.rng, 60)
                if not self.mover.roll(space, path):
                    raise Failed("the robot is stuck on its way")
                if (lost := self._lost()) is not None:
                    raise Failed(lost)
                return stand.posture
        raise Failed("there is no place to stand from which the arm reaches it")

    def _stands(
        self, space: BaseSpace, here: Array, above: Array, goal: Array, but: Entity | None
    ) -> Iterator[Stand]:
        """Where the robot may stand to reach two points, the nearest first."""
        away = self.rng.uniform(0.3, 0.75, PLACES)
        way = self.rng.uniform(-np.pi, np.pi, PLACES)
        yaw = self.rng.uniform(-np.pi, np.pi, PLACES)
        # The arm's first joint is behind the axle.
        places = np.stack(
            (
                above[0] + away * np.cos(way) + 0.06 * np.cos(yaw),
                above[1] + away * np.sin(way) + 0.06 * np.sin(yaw),
                yaw,
            ),
            axis=1,
        )
        places = np.concatenate((here[None], places))
        places = places[np.argsort(space.distances(here, places))]
        around = self._around(self._walls(but))
        _, angles = self.chain.now(self.robot)
        for start in range(0, len(places), 32):
            some = places[start : start + 32]
            some = some[space.clear(some)]
            if not len(some):
                continue
            bases = np.repeat(space.bases(some), POSTURES, axis=0)
            starts = np.tile(angles, (len(bases), 1))
            starts[:, self.arm] = self.rng.uniform(
                self.chain.lower[self.arm],
                self.chain.upper[self.arm],
                (len(bases), len(self.arm)),
            )
            goals = np.tile([*above, 0.0, 0.0, -1.0], (len(bases), 1))
            found, solved = self.chain.reach(bases, starts, self.arm, self.hand, GRIP, goals)
            for row in np.flatnonzero(solved):
                arm = self._arm_space(bases[row], around)
                posture = found[row, self.arm]
                if not arm.clear(posture[None])[0]:
                    continue
                try:
                    line = self._line(posture, above, goal, bases[row])
                except Failed:
                    continue
                if arm.clear(line).all():
                    yield Stand(some[row // POSTURES], posture)

    def _posture(self, above: Array, goal: Array, near: Array, but: Entity | None) -> Array:
        """A posture with the hand over a point, near another one, from which it can go down."""
        base, angles = self.chain.now(self.robot)
        angles[self.arm] = near
        close, other = (self._solve(base, above, n, angles, o) for n, o in ((16, 0.1), (96, None)))
        close = close[np.argsort(np.abs(close - near).max(axis=1))]
        found = np.concatenate((close, other))
        space = self._arm_space(base, self._near(base))
        down = self._arm_space(base, self._near(base, but))
        clear: Sequence[Array] = list(found[space.clear(found)]) if len(found) else []
        for posture in clear:
            try:
                if down.clear(self._line(posture, above, goal)).all():
                    return posture
            except Failed:
                continue
        raise Failed("the arm does not reach it from here")

    def _line(self, posture: Array, start: Array, end: Array, base: Array | None = None) -> Array:
        """Postures on a straight way of the grip, from a posture at its start."""
        here, angles = self.chain.now(self.robot)
        base = here if base is None else base
        count = int(np.linalg.norm(end - start) / STEP) + 2
        full = angles.copy()
        full[self.arm] = posture
        path = [posture]
        for share in np.linspace(0.0, 1.0, count)[1:]:
            goal = np.array([[*(start + share * (end - start)), 0.0, 0.0, -1.0]])
            found, solved = self.chain.reach(
                base[None], full[None], self.arm, self.hand, GRIP, goal
            )
            if not solved[0] or np.abs(found[0, self.arm] - path[-1]).max() > 0.3:
                raise Failed("the arm does not reach all the way")
            full = found[0]
            path.append(full[self.arm])
        return np.array(path)

    # -- how ------------------------------------------------------------------------------

    def _bring(self, posture: Array) -> None:
        """Move the arm to a posture along a planned path."""
        base, _ = self.chain.now(self.robot)
        space = self._arm_space(base, self._near(base))
        path = self._back(space, posture)
        for apart in (ARM_APART, NARROWLY):
            if path is None:
                space = replace(space, apart=apart)
                path = plan(space, self._now(), posture, self.rng, TRIES, 0.8)
                path = None if path is None else shortened(space, path, self.rng, 60)
        if path is None:
            raise Failed("no clear path of the arm was found")
        self._last = path
        self.mover.follow(path, self._pace())

    def _back(self, space: ArmSpace, posture: Array) -> Array | None:
        """The way that the arm came, if it leads to a posture and is still clear."""
        if not len(self._last) or np.abs(self._last[0] - posture).max() > 0.02:
            return None
        path = np.concatenate((self._now()[None], self._last[::-1], posture[None]))
        joined = float(space.distances(path[0], path[1:2])[0]) <= ARM_SPACING
        is_clear = joined and replace(space, apart=NARROWLY).clear(path).all()
        return path if is_clear else None

    def _pace(self) -> float:
        return 1.0 if self.held is None else CAREFUL

    def _now(self) -> Array:
        now: Array = self.chain.now(self.robot)[1][self.arm]
        return now

    def _hand(self) -> Array:
        base, angles = self.chain.now(self.robot)
        found: Array = self.chain.frames(base[None], angles[None])[0, self.hand]
        return found

    def _lost(self) -> str | None:
        """What to say if the hand no longer has what it held."""
        if self.held is None or self._touches(self.held.entity):
            return None
        self.held = None
        return "it was lost on the way"

    def _touches(self, cup: Entity) -> bool:
        """Whether robot and cup are in contact, as the narrow phase has it."""
        with self.world.held(["shapes"]):
            shapes = self.world.snapshot.shapes()
            gap = shapes.clearance(self.robot.id, cup.id)
        return gap is not None and gap < TOUCHES

    # -- what is around -------------------------------------------------------------------

    def _walls(self, but: Entity | None = None) -> list[Wall]:
        """The shapes of all else; what is fixed is looked at once."""
        held = None if self.held is None else self.held.entity
        found = []
        for entity in self.world:
            if entity.kind == "sensor" or entity in (self.robot, held, but):
                continue
            if entity.mass > 0.0:
                found += walls_of(entity)
                continue
            if entity.id not in self._fixed:
                self._fixed[entity.id] = walls_of(entity)
            found += self._fixed[entity.id]
        return found

    def _around(self, walls: Sequence[Wall]) -> Surroundings:
        return Surroundings(self.chain, self.robot, walls, self.held, self.chain.beyond("arm7"))

    def _near(self, base: Array, but: Entity | None = None) -> Surroundings:
        """What the arm may reach on a base that stands there."""
        low, high = base[:3, 3] - REACH, base[:3, 3] + REACH
        return self._around(
            [w for w in self._walls(but) if (w.low <= high).all() and (w.high >= low).all()]
        )

    def _arm_space(self, base: Array, around: Surroundings, apart: float = ARM_APART) -> ArmSpace:
        _, angles = self.chain.now(self.robot)
        tilt = None if self.held is None else TILT
        return ArmSpace(self.chain, around, base, angles, self.arm, LEVERS, self.hand, tilt, apart)

    def _base_space(self) -> BaseSpace:
        base, angles = self.chain.now(self.robot)
        around = self._around([wall for wall in self._walls() if wall.high[2] > FLOOR])
        low, high = self.world["kitchen"].aabb
        return BaseSpace(
            self.chain,
            around,
            angles,
            float(base[2, 3]),
            AXLE,
            LEVER,
            (low[0], low[1]),
            (high[0], high[1]),
        )
