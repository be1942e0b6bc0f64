"""A robot on wheels, with an arm and a hand, that takes cups to where they belong."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from ssduck.demos.motion.driving import Mover
from ssduck.demos.motion.kinematics import KinematicChain
from ssduck.demos.motion.obstacles import Held, Obstacles, Wall, hull_in, walls_of
from ssduck.demos.motion.planning import plan, shortened
from ssduck.demos.motion.spaces import ARM_APART, ARM_SPACING, BASE_APART, ArmSpace, BaseSpace
from ssduck.errors import StateError
from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.world.entities import Entity
from ssduck.world.world import World

T = TypeVar("T")

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
# How far above a cup the hand may begin to go straight down, m, and in what steps; and how far
# it goes up where there is no other way.
ABOVE = (0.06, 0.09)
HIGHER = (0.2, 0.1, 0.05)
STEP = 0.01
# Where the arm holds a cup's rim while the robot drives, in the base's frame: a cup there is
# higher than those on the table.
CARRIED = np.array([0.2, 0.0, 0.36])
# What is tried: places to stand at, postures of the arm at each, random postures of a plan.
PLACES, POSTURES, TRIES = 5000, 4, 1000
FLOOR = 0.16
# How often what may fail by chance is tried, and how often fingers are given time to close.
CHANCES = 3
PATIENCE = 10
# How far from its base's frame the arm reaches with a cup, m.
REACH = 1.4
# If there is no other way, the arm comes as near to things, m.
NARROWLY = 0.004
BARELY = 0.001
# From how high above a spot a cup may fall, and from how far above that the hand goes straight
# down, m; out of a sink's basin it has to come up straight.
FALLS = ((0.03, 0.15), (0.08, 0.1), (0.15, 0.03))
# The same where it is put back: it keeps off the table until it falls.
SET_DOWN = (ARM_APART + 0.004, 0.09)


class Failed(Exception):  # noqa: N818  # it is no error: it is what is told
    """Why a cup was not taken away."""


class OutOfReach(Failed):
    """There is no place to stand: many were tried, and as many more would hardly do."""


@dataclass(frozen=True, eq=False)
class Way:
    """A straight way of the hand's grip, down from one point (3,) to another."""

    above: Array
    goal: Array


def _ways(
    spots: Sequence[Array], hangs: float, falls: Sequence[tuple[float, float]]
) -> list[list[Way]]:
    """Ways to let go of what hangs so far below the grip, by how high above spots that is."""
    return [
        [Way(spot + (fall + hangs + lift) * UP, spot + (fall + hangs) * UP) for spot in spots]
        for fall, lift in falls
    ]


@dataclass(frozen=True, eq=False)
class Stand:
    """Where to stand, (3,), the arm's posture there, (arm joints,), and for which way."""

    place: Array
    posture: Array
    way: Way


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
        self.chain = KinematicChain.of(robot)
        self.arm = self.chain.columns(ARM)
        self.hand = self.chain.link("arm7")
        self.mover = Mover(robot, self.chain, self.arm, WHEELS, RADIUS, TRACK, after)
        self.held: Held | None = None
        self._fixed: dict[int, list[Wall]] = {}
        self._taken_from = np.zeros(3)  # where the underside of what is held was
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
        """Put back what is held, draw the hand up and the arm back.

        Raises:
            Failed: it cannot.
        """
        if self.held is not None:
            self.drop([self._taken_from], [SET_DOWN])
            return
        self._open()
        self.mover.follow(self._higher())
        self._tried(lambda: self._bring(self.carrying))

    def pick(self, cup: Entity) -> None:
        """Take a cup that stands upright.

        Raises:
            Failed: it cannot.
        """
        low, high = cup.aabb
        rim = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, high[2]])
        ways = [Way(rim + above * UP, rim) for above in ABOVE]
        down = self._tried(lambda: self._reach_over(ways, cup))
        self.mover.follow(down)
        self._grasp(cup)
        self._taken_from = np.array([*rim[:2], low[2]])
        self._lift(down[::-1])

    def _lift(self, up: Array) -> None:
        """Lift what is held and draw the arm back; or put it back, if no way is found."""
        self.mover.follow(up)
        try:
            self._bring(self.carrying)
        except Failed:
            higher = self._higher()
            self.mover.follow(higher)
            up = np.concatenate((up, higher))
            try:
                self._tried(lambda: self._bring(self.carrying))
            except Failed as failure:
                self.mover.follow(up[::-1])
                self._open()
                self.mover.follow(up)
                raise Failed(f"{failure} with it in the hand, and it was put back") from failure

    def _higher(self) -> Array:
        """A straight and clear way up (n, arm joints) from where the hand is."""
        grip, now = self._grip(), self._now()
        base, _ = self.chain.now(self.robot)
        space = self._arm_space(base, self._near(base), NARROWLY)
        for height in HIGHER:
            try:
                way = self._line(now, grip, grip + height * UP)
            except Failed:
                continue
            if space.clear(way).all():
                return way
        return now[None]

    def _grasp(self, cup: Entity) -> None:
        """Spread the fingers until two of them touch the cup, and hold it."""
        self.mover.pose(SPREAD, FORCE)
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
        self.held = Held(self.hand, cup, hull_in(self._hand(), cup))
        # They have it, and need not press any more.
        fingers = self.chain.columns(list(SPREAD))
        now = self.chain.now(self.robot)[1][fingers]
        self.mover.pose(dict(zip(SPREAD, map(float, now), strict=True)))

    def can_drop(self, cup: Entity, spots: Sequence[Array]) -> bool:
        """Whether there is a place to stand from which a cup can be dropped on one of some spots.

        Args:
            cup: that stands upright, to be held as `pick` does.
            spots: (3,), where its underside may come to be, m.
        """
        low, high = (np.array(corner) for corner in cup.aabb)
        hand = np.diag([1.0, -1.0, -1.0, 1.0])
        hand[:3, 3] = [*(low + high)[:2] / 2, high[2] + GRIP[2]]
        self.held = Held(self.hand, cup, hull_in(hand, cup))
        try:
            space = self._base_space()
            here = space.place(self.chain.now(self.robot)[0])
            ways = _ways(spots, high[2] - low[2], FALLS)
            return any(True for some in ways for _ in self._stands(space, here, some, None))
        finally:
            self.held = None

    def drop(self, spots: Sequence[Array], falls: Sequence[tuple[float, float]] = FALLS) -> None:
        """Bring what it holds to one of some spots, let go of it there, and draw the arm back.

        Args:
            spots: (3,), where its underside may come to be, m.
            falls: from how high above that it may fall, and from how far above that the hand
                goes straight down, m; the first is tried first.

        Raises:
            Failed: it cannot; if `held` is not None, it holds it still.
        """
        assert self.held is not None
        hangs = self._grip()[2] - self.held.entity.aabb[0][2]
        self._tried(lambda: self._lower(_ways(spots, hangs, falls)))
        self._tried(lambda: self._bring(self.carrying))

    def _lower(self, ways: Sequence[Sequence[Way]]) -> None:
        for some in ways:
            try:
                down = self._reach_over(some)
            except Failed as failure:
                failed = failure
                continue
            self.mover.follow(down)
            self._open()
            self.mover.follow(down[::-1])
            return
        raise failed

    def _open(self) -> None:
        """Draw the fingers together, and let go of what they hold."""
        if self.held is not None:
            self.robot.release(self.held.entity)
        self.held = None
        self.mover.pose(NARROW)
        self.mover.run(60)

    def _tried(self, act: Callable[[], T]) -> T:
        """Do what may fail by chance, several times if need be."""
        for _ in range(CHANCES):
            try:
                return act()
            except OutOfReach:
                raise
            except Failed as failure:
                failed = failure
        raise failed

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

    def _reach_over(self, ways: Sequence[Way], but: Entity | None = None) -> Array:
        """Drive to where the hand reaches both ends of a way, and bring it to where it begins.

        Args:
            ways: any of these will do.
            but: what the fingers may meet at the end.

        Returns:
            The way of the arm to its end, (n, arm joints).
        """
        stand = self._drive_to(ways, but)
        above, goal = stand.way.above, stand.way.goal
        self._bring(self._posture(above, goal, stand.posture, but))
        down = self._line(self._now(), above, goal)
        base, _ = self.chain.now(self.robot)
        if not self._arm_space(base, self._near(base, but), NARROWLY).clear(down).all():
            raise Failed("something is in the arm's way")
        return down

    def _drive_to(self, ways: Sequence[Way], but: Entity | None) -> Stand:
        """Drive to where the hand reaches both ends of a way."""
        if np.abs(self._now() - self.carrying).max() > 0.1:
            self._bring(self.carrying)
        space = self._base_space()
        here = space.place(self.chain.now(self.robot)[0])
        for stand in self._stands(space, here, ways, but):
            for apart in (BASE_APART, NARROWLY):
                near = replace(space, apart=apart)
                path = plan(near, here, stand.place, self.rng, TRIES // 10, 1.0)
                if path is None:
                    continue
                if not self.mover.roll(near, shortened(near, path, self.rng, 60)):
                    raise Failed("the robot is stuck on its way")
                return stand
        raise OutOfReach("there is no place to stand from which the arm reaches it")

    def _stands(
        self, space: BaseSpace, here: Array, ways: Sequence[Way], but: Entity | None
    ) -> Iterator[Stand]:
        """Where the robot may stand to reach both ends of a way, the nearest first."""
        around = self._around(self._walls(but))
        places, numbers = self._places(space, here, ways)
        for start in range(0, len(places), 32):
            some = start + np.flatnonzero(space.clear(places[start : start + 32]))
            if not len(some):
                continue
            rows = np.repeat(some, POSTURES)
            bases = space.bases(places[rows])
            above = np.array([ways[number].above for number in numbers[rows]])
            found, solved = self._postures_over(bases, above)
            for row in np.flatnonzero(solved):
                arm = self._arm_space(bases[row], around)
                posture, way = found[row, self.arm], ways[numbers[rows[row]]]
                if not arm.clear(posture[None])[0]:
                    continue
                try:
                    line = self._line(posture, way.above, way.goal, bases[row])
                except Failed:
                    continue
                if arm.clear(line).all():
                    yield Stand(places[rows[row]], posture, way)

    def _places(self, space: BaseSpace, here: Array, ways: Sequence[Way]) -> tuple[Array, Indices]:
        """Places (n, 3) around where ways begin, the nearest first, and which way's (n,)."""
        numbers = self.rng.integers(len(ways), size=PLACES)
        x, y, _ = np.array([ways[number].above for number in numbers]).T
        away = self.rng.uniform(0.3, 0.85, PLACES)
        way, yaw = self.rng.uniform(-np.pi, np.pi, (2, PLACES))
        # The arm's first joint is behind the axle.
        x += away * np.cos(way) + 0.06 * np.cos(yaw)
        y += away * np.sin(way) + 0.06 * np.sin(yaw)
        places = np.concatenate((np.tile(here, (len(ways), 1)), np.stack((x, y, yaw), axis=1)))
        numbers = np.concatenate((np.arange(len(ways)), numbers))
        order = np.argsort(space.distances(here, places))
        return places[order], numbers[order]

    def _postures_over(self, bases: Array, above: Array) -> tuple[Array, Flags]:
        """Joints (n, joints) with the hand over points (n, 3), and whether they are solutions."""
        starts = np.tile(self.chain.now(self.robot)[1], (len(bases), 1))
        low, high = self.chain.lower[self.arm], self.chain.upper[self.arm]
        starts[:, self.arm] = self.rng.uniform(low, high, (len(bases), len(self.arm)))
        goals = np.concatenate((above, np.tile([0.0, 0.0, -1.0], (len(bases), 1))), axis=1)
        return self.chain.reach(bases, starts, self.arm, self.hand, GRIP, goals)

    def _posture(self, above: Array, goal: Array, near: Array, but: Entity | None) -> Array:
        """A posture with the hand over a point, near another one, from which it can go down."""
        base, angles = self.chain.now(self.robot)
        angles[self.arm] = near
        close, other = (self._solve(base, above, n, angles, o) for n, o in ((16, 0.1), (300, None)))
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
        for apart in (ARM_APART, NARROWLY, BARELY):
            if path is None:
                space = replace(space, apart=apart)
                path = plan(space, self._now(), posture, self.rng, TRIES, 0.8)
                path = None if path is None else shortened(space, path, self.rng, 120)
        if path is None:
            raise Failed("no clear path of the arm was found")
        self._last = path
        self.mover.follow(path)

    def _back(self, space: ArmSpace, posture: Array) -> Array | None:
        """The way that the arm came, if it leads to a posture and is still clear."""
        if not len(self._last) or np.abs(self._last[0] - posture).max() > 0.02:
            return None
        path = np.concatenate((self._now()[None], self._last[::-1], posture[None]))
        joined = float(space.distances(path[0], path[1:2])[0]) <= ARM_SPACING
        is_clear = joined and replace(space, apart=NARROWLY).clear(path).all()
        return path if is_clear else None

    def _now(self) -> Array:
        now: Array = self.chain.now(self.robot)[1][self.arm]
        return now

    def _grip(self) -> Array:
        """Where the fingers' grip is, (3,)."""
        found: Array = (self._hand() @ np.append(GRIP, 1.0))[:3]
        return found

    def _hand(self) -> Array:
        base, angles = self.chain.now(self.robot)
        found: Array = self.chain.frames(base[None], angles[None])[0, self.hand]
        return found

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

    def _around(self, walls: Sequence[Wall]) -> Obstacles:
        return Obstacles(self.chain, self.robot, walls, self.held, self.chain.beyond("arm7"))

    def _near(self, base: Array, but: Entity | None = None) -> Obstacles:
        """What the arm may reach on a base that stands there."""
        low, high = base[:3, 3] - REACH, base[:3, 3] + REACH
        return self._around(
            [w for w in self._walls(but) if (w.low <= high).all() and (w.high >= low).all()]
        )

    def _arm_space(self, base: Array, around: Obstacles, apart: float = ARM_APART) -> ArmSpace:
        _, angles = self.chain.now(self.robot)
        return ArmSpace(self.chain, around, base, angles, self.arm, LEVERS, apart)

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
