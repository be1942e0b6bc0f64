"""A robot takes the cups from the kitchen's table to the sink, on paths that it plans itself.

The job is that of SelectScript's tutorial: everything that is on the table, and less than 1.3 m
away from the robot, belongs in the sink. A query selects these cups, and another checks the result.
The robot drives on its wheels, spreads its fingers in a cup, and drops it over the sink, by motors
and gravity of the running simulation. A constraint holds a cup that the fingers touch.
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
ON_TABLE = "SELECT obj FROM kitchen WHERE isCup(this) AND onX(table, this) AS list;"
IN_SINK = "SELECT obj FROM kitchen WHERE isCup(this) AND onX(sink, this) AS list;"
DEEPEST = """\
SELECT coalesce(max(kitchen.penetration(a, b)), 0.0)
FROM entities_history a JOIN entities_history b USING (tick)
WHERE a.name = ? AND b.mass = 0"""
# The allowed penetration of robot and furniture, m: wheels on the floor, a finger that slips.
ALLOWED = 1e-3
# The number of attempts for each cup.
ATTEMPTS = 3
VIEW = Camera(eye=(2.6, -0.6, 2.7), target=(0.6, 1.1, 0.8), fov=50.0)
# The number of ticks for each recorded one.
EVERY = 8
# The spots for cups in the sink, m from its middle: in two rows, to leave room for others, or
# anywhere if these are out of reach; and the least distance of two cups.
ROWS = [(x, y) for y in (-0.15, -0.03) for x in (-0.14, 0.0, 0.14)]
ANYWHERE = [
    (x, y) for y in (-0.16, -0.1, -0.03) for x in (-0.15, -0.1, -0.05, 0.0, 0.05, 0.1, 0.15)
]
CUP_DISTANCE = 0.1


@dataclass
class Outcome:
    """The outcome of cleaning up.

    Attributes:
        cups: the names of the cups to be taken away.
        trouble: the failures by the name of the cup, the latest last.
        left: the names of the cups on the table.
        washed: the names of the cups in the sink.
        deepest: the largest penetration of robot and furniture at a recorded tick, m.
        seconds: the simulated time.
    """

    cups: list[str]
    trouble: dict[str, list[str]] = field(default_factory=dict)
    left: list[str] = field(default_factory=list)
    washed: list[str] = field(default_factory=list)
    deepest: float = 0.0
    seconds: float = 0.0

    @property
    def succeeded(self) -> bool:
        """Whether all cups are in the sink and the robot ran into nothing."""
        return not self.left and set(self.cups) <= set(self.washed) and self.deepest <= ALLOWED


def run(folder: Path, say: Callable[[str], None], *, seed: int) -> bool:
    """Cleans up the table of the kitchen, and writes pictures.

    Args:
        folder: the folder for the pictures.
        say: writes lines of the report.
        seed: the seed of the planners' random numbers.

    Returns:
        Whether all cups are in the sink.
    """
    with load("kitchen") as ss:
        return clean(ss, folder, say, seed=seed).succeeded


def clean(
    ss: Interpreter, folder: Path | None, say: Callable[[str], None], *, seed: int
) -> Outcome:
    """Cleans up the table of a running kitchen.

    Args:
        ss: an interpreter with the world `kitchen`.
        folder: the folder for pictures; None for none.
        say: writes lines of the report.
        seed: the seed of the planners' random numbers.
    """
    report = _Report(ss, folder, say)
    report.picture("before")
    cups = report.requested_cups()
    outcome = Outcome([cup.name for cup in cups])
    rng = np.random.default_rng(seed)
    start_time = report.world.time
    cleaner = Cleaner(report.world[ROBOT], rng, lambda: None)
    try:
        cleaner.prepare()
        _take_away(report, cleaner, cups, outcome)
    except Failed as failure:
        say(f"The robot cannot go on: {failure}.")
    report.picture("after")
    outcome.seconds = report.world.time - start_time
    report.conclude(outcome)
    return outcome


def _take_away(report: _Report, cleaner: Cleaner, cups: list[Entity], outcome: Outcome) -> None:
    """Takes the cups away, the nearest first; failed ones are tried again later."""
    for _ in range(ATTEMPTS):
        waiting = [cup for cup in cups if cup in report.select(ON_TABLE)]
        while waiting:
            robot_position = np.array(report.world[ROBOT].position[:2])
            distances = [
                float(np.linalg.norm(robot_position - cup.position[:2])) for cup in waiting
            ]
            cup = waiting.pop(int(np.argmin(distances)))
            try:
                report.take(cleaner, cup)
            except Failed as failure:
                outcome.trouble.setdefault(cup.name, []).append(str(failure))
                report.say(f"{cup.name}: {failure}; it is at {_coordinates(cup.position)}.")
                cleaner.recover()


class _Report:
    """The queries, the report and the pictures of a run."""

    def __init__(self, ss: Interpreter, folder: Path | None, say: Callable[[str], None]) -> None:
        self.ss, self.folder, self.say = ss, folder, say
        world = ss.call_variable("kitchen")
        assert isinstance(world, World)
        self.world = world
        self._pictures = 0
        ss.record(world, Recording(every=EVERY))
        ss.add_function("onX", on, "onX(o1, o2): whether the position of o2 is over o1")
        ss.add_function("isCup", _is_cup, "isCup(object): whether it is a cup, by its name")

    def requested_cups(self) -> list[Entity]:
        """Returns the cups to be cleaned up."""
        self.say(JOB)
        self.ss.eval(JOB)
        cups: list[Entity] = self.ss.call_variable("cleanUp")
        self.say(f"To be taken to the sink: {', '.join(cup.name for cup in cups) or 'nothing'}.")
        return cups

    def select(self, program: str) -> list[Entity]:
        """Returns the entities that a program selects."""
        entities: list[Entity] = self.ss.eval(program)
        return entities

    def take(self, cleaner: Cleaner, cup: Entity) -> None:
        """Takes a cup from the table to the sink."""
        self.say(f"{cup.name}: the robot drives to it, and takes it.")
        for spots in map(self._free_spots, (ROWS, ANYWHERE)):
            if spots and cleaner.can_drop(cup, spots):
                break
        else:
            raise Failed("there is no spot in the sink that the arm reaches")
        cleaner.pick(cup)
        self.picture(f"holding_{cup.name}")
        cleaner.drop(spots)
        if cup not in self.select(IN_SINK):
            raise Failed("it did not fall into the sink")
        self.say(f"{cup.name}: is in the sink, at {_coordinates(cup.position)}.")

    def _free_spots(self, spots: Sequence[tuple[float, float]]) -> list[Array]:
        """Returns the free ones of some spots in the sink, (3,) each, m."""
        low, high = (np.array(corner) for corner in self.world["sink"].aabb)
        centre = np.array([*((low + high) / 2)[:2], high[2]])
        occupied = [np.array(cup.position[:2]) for cup in self.select(IN_SINK)]
        spots_in_world = [centre + np.array([x, y, 0.0]) for x, y in spots]
        return [
            spot
            for spot in spots_in_world
            if all(np.linalg.norm(spot[:2] - other) > CUP_DISTANCE for other in occupied)
        ]

    def picture(self, name: str) -> None:
        """Writes a picture of the current state."""
        if self.folder is None:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        picture = self.world.render(800, 600, VIEW)
        path = keep_picture(picture, self.folder / f"cleanup_{self._pictures}_{name}.png")
        self._pictures += 1
        self.say(f"picture: {path}")

    def conclude(self, outcome: Outcome) -> None:
        """Queries and reports the outcome."""
        left, washed = self.select(ON_TABLE), self.select(IN_SINK)
        outcome.left = [cup.name for cup in left]
        outcome.washed = [cup.name for cup in washed]
        outcome.deepest = float(self.ss.sql(DEEPEST, [ROBOT]).fetchall()[0][0])
        self.say(ON_TABLE)
        self.say(f"On the table: {', '.join(outcome.left) or 'no cup'}.")
        self.say(f"In the sink: {', '.join(outcome.washed) or 'no cup'}.")
        for name in outcome.cups:
            if name not in outcome.washed:
                place = _coordinates(self.world[name].position)
                reasons = "; ".join(outcome.trouble.get(name, ["nobody tried"]))
                self.say(f"{name} is not in the sink, but at {place}: {reasons}.")
        self.say(
            f"{outcome.seconds:.0f} s of simulation; the robot was at most "
            f"{1000 * outcome.deepest:.2f} mm deep in furniture or floor."
        )


def _is_cup(thing: Any) -> bool:
    return bool(thing.name.startswith("cup"))


def _coordinates(position: list[float]) -> str:
    return "(" + ", ".join(f"{number:.2f}" for number in position) + ")"
