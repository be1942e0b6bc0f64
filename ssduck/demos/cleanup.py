"""A robot takes the cups from the kitchen's table to the sink, on paths that it plans itself.

The job is that of SelectScript's tutorial: what is on the table, and less than 1.3 m away from
the robot, belongs in the sink; a query says what that is, and another whether it was done. The
robot drives on its wheels, spreads its fingers in a cup, and lets go of it over the sink: by
motors and gravity of the running simulation. What the fingers touch is held by a constraint.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ssduck.demos.kitchen import on
from ssduck.demos.motion import Cleaner, Failed
from ssduck.demos.results import keep_picture
from ssduck.geometry.arrays import Array
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.opening import load
from ssduck.recording.spec import Recording
from ssduck.simulators.scenes import Camera
from ssduck.world.entities import Entity
from ssduck.world.world import World

ROBOT = "barrett_4918"
JOB = """\
barrett = SELECT obj FROM kitchen WHERE id(this) == 'barrett_4918' AS value;
table   = SELECT obj FROM kitchen WHERE id(this) == 'table' AS value;
sink    = SELECT obj FROM kitchen WHERE id(this) == 'sink' AS value;
cleanUp = SELECT obj FROM kitchen
          WHERE isCup(this) AND onX(table, this) AND distance(barrett, this) < 1.3
          AS list;"""
LEFT = "SELECT obj FROM kitchen WHERE isCup(this) AND onX(table, this) AS list;"
WASHED = "SELECT obj FROM kitchen WHERE isCup(this) AND onX(sink, this) AS list;"
DEEPEST = """\
SELECT coalesce(max(kitchen.penetration(a, b)), 0.0)
FROM entities_history a JOIN entities_history b USING (tick)
WHERE a.name = ? AND b.mass = 0"""
# What the robot may be deep in furniture, m: its wheels on the floor, a finger that slips.
ALLOWED = 1e-3
# How often a cup is tried.
CHANCES = 3
VIEW = Camera(eye=(2.6, -0.6, 2.7), target=(0.6, 1.1, 0.8), fov=50.0)
# Ticks that are recorded: one of so many.
RECORDED = 8
# Where in the sink cups go, m from its middle, and how far from each other: in two rows, so that
# they leave room for others; where that cannot be, anywhere.
ROWS = [(x, y) for y in (-0.15, -0.03) for x in (-0.14, 0.0, 0.14)]
ANYWHERE = [
    (x, y) for y in (-0.16, -0.1, -0.03) for x in (-0.15, -0.1, -0.05, 0.0, 0.05, 0.1, 0.15)
]
FREE = 0.1


@dataclass
class Outcome:
    """What became of the cups.

    Attributes:
        cups: the names of those that were to be taken away.
        trouble: what went wrong, by the name of the cup, the latest last.
        left: the names of those that are on the table.
        washed: of those that are in the sink.
        deepest: how deep the robot was in furniture, m, in any recorded tick.
        seconds: of simulated time.
    """

    cups: list[str]
    trouble: dict[str, list[str]] = field(default_factory=dict)
    left: list[str] = field(default_factory=list)
    washed: list[str] = field(default_factory=list)
    deepest: float = 0.0
    seconds: float = 0.0

    @property
    def succeeded(self) -> bool:
        """Whether all are in the sink, and nothing was run into."""
        return not self.left and set(self.cups) <= set(self.washed) and self.deepest <= ALLOWED


def run(folder: Path, say: Callable[[str], None], *, seed: int) -> bool:
    """Clean up the kitchen's table, and write pictures.

    Args:
        folder: where the pictures are written.
        say: is told what is done.
        seed: of chance in planning.

    Returns:
        Whether all cups are in the sink.
    """
    with load("kitchen") as ss:
        return clean(ss, folder, say, seed=seed).succeeded


def clean(
    ss: Interpreter, folder: Path | None, say: Callable[[str], None], *, seed: int
) -> Outcome:
    """Clean up the table of a kitchen as it stands.

    Args:
        ss: with the world `kitchen`.
        folder: where pictures are written; None for none.
        say: is told what is done.
        seed: of chance in planning.
    """
    story = _Story(ss, folder, say)
    story.picture("before")
    cups = story.asked()
    outcome = Outcome([cup.name for cup in cups])
    rng = np.random.default_rng(seed)
    began = story.world.time
    cleaner = Cleaner(story.world[ROBOT], rng, story.count)
    try:
        cleaner.prepare()
        _take_away(story, cleaner, cups, outcome)
    except Failed as failure:
        say(f"The robot cannot go on: {failure}.")
    story.picture("after")
    outcome.seconds = story.world.time - began
    story.conclude(outcome)
    return outcome


def _take_away(story: _Story, cleaner: Cleaner, cups: list[Entity], outcome: Outcome) -> None:
    """Take the cups away, the nearest first; those that fail get another chance later."""
    for _ in range(CHANCES):
        waiting = [cup for cup in cups if cup in story.asks(LEFT)]
        while waiting:
            at = np.array(story.world[ROBOT].position[:2])
            away = [float(np.linalg.norm(at - cup.position[:2])) for cup in waiting]
            cup = waiting.pop(int(np.argmin(away)))
            try:
                story.take(cleaner, cup)
            except Failed as failure:
                outcome.trouble.setdefault(cup.name, []).append(str(failure))
                story.say(f"{cup.name}: {failure}; it is at {_shown(cup.position)}.")
                cleaner.recover()


class _Story:
    """What is asked, said and shown."""

    def __init__(self, ss: Interpreter, folder: Path | None, say: Callable[[str], None]) -> None:
        self.ss, self.folder, self.say = ss, folder, say
        world = ss.call_variable("kitchen")
        assert isinstance(world, World)
        self.world = world
        self._pictures = 0
        ss.record(world, Recording(every=RECORDED))
        ss.add_function("onX", on, "onX(o1, o2): whether the position of o2 is over o1")
        ss.add_function("isCup", _is_cup, "isCup(object): whether it is a cup, by its name")

    def asked(self) -> list[Entity]:
        """What is to be cleaned up."""
        self.say(JOB)
        self.ss.eval(JOB)
        cups: list[Entity] = self.ss.call_variable("cleanUp")
        self.say(f"To be taken to the sink: {', '.join(cup.name for cup in cups) or 'nothing'}.")
        return cups

    def asks(self, program: str) -> list[Entity]:
        """The entities that a program yields."""
        found: list[Entity] = self.ss.eval(program)
        return found

    def count(self) -> None:
        """What is done as the simulation runs: nothing but to let it run."""

    def take(self, cleaner: Cleaner, cup: Entity) -> None:
        """Take a cup from the table to the sink."""
        self.say(f"{cup.name}: the robot drives to it, and takes it.")
        for spots in map(self._free, (ROWS, ANYWHERE)):
            if spots and cleaner.can_drop(cup, spots):
                break
        else:
            raise Failed("there is no spot in the sink that the arm reaches")
        cleaner.pick(cup)
        self.picture(f"holding_{cup.name}")
        cleaner.drop(spots)
        if cup not in self.asks(WASHED):
            raise Failed("it did not fall into the sink")
        self.say(f"{cup.name}: is in the sink, at {_shown(cup.position)}.")

    def _free(self, spots: Sequence[tuple[float, float]]) -> list[Array]:
        """Those spots in the sink (3,) that are free, m."""
        low, high = (np.array(corner) for corner in self.world["sink"].aabb)
        middle = np.array([*((low + high) / 2)[:2], high[2]])
        there = [np.array(cup.position[:2]) for cup in self.asks(WASHED)]
        found = [middle + np.array([x, y, 0.0]) for x, y in spots]
        return [s for s in found if all(np.linalg.norm(s[:2] - t) > FREE for t in there)]

    def picture(self, name: str) -> None:
        """Write a picture of the simulation as it is."""
        if self.folder is None:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        picture = self.world.render(800, 600, VIEW)
        path = keep_picture(picture, self.folder / f"cleanup_{self._pictures}_{name}.png")
        self._pictures += 1
        self.say(f"picture: {path}")

    def conclude(self, outcome: Outcome) -> None:
        """Ask what is left, and say it."""
        left, washed = self.asks(LEFT), self.asks(WASHED)
        outcome.left = [cup.name for cup in left]
        outcome.washed = [cup.name for cup in washed]
        outcome.deepest = float(self.ss.sql(DEEPEST, [ROBOT]).fetchall()[0][0])
        self.say(LEFT)
        self.say(f"On the table: {', '.join(outcome.left) or 'no cup'}.")
        self.say(f"In the sink: {', '.join(outcome.washed) or 'no cup'}.")
        for name in outcome.cups:
            if name not in outcome.washed:
                where = _shown(self.world[name].position)
                why = "; ".join(outcome.trouble.get(name, ["nobody tried"]))
                self.say(f"{name} is not in the sink, but at {where}: {why}.")
        self.say(
            f"{outcome.seconds:.0f} s of simulation; the robot was at most "
            f"{1000 * outcome.deepest:.2f} mm deep in furniture or floor."
        )


def _is_cup(thing: Any) -> bool:
    return bool(thing.name.startswith("cup"))


def _shown(position: list[float]) -> str:
    return "(" + ", ".join(f"{number:.2f}" for number in position) + ")"
