"""Cleans up: takes the cups that a query selects to the sink, and asks whether they are there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from examples.cleanup.cleaner import Cleaner, Failed
from ssduck.demos.cleanup import IN_SINK, ON_TABLE, ROBOT, Outcome, Report, coordinates
from ssduck.geometry.arrays import Array
from ssduck.interpreter.interpreter import Interpreter
from ssduck.recording.spec import Recording
from ssduck.world.entities import Entity

# The number of attempts for each cup.
ATTEMPTS = 3
# The number of ticks for each recorded one.
EVERY = 8
# The spots for cups in the sink, m from its middle: in two rows, to leave room for others, or
# anywhere if these are out of reach; and the least distance of two cups.
ROWS = [(x, y) for y in (-0.15, -0.03) for x in (-0.14, 0.0, 0.14)]
ANYWHERE = [
    (x, y) for y in (-0.16, -0.1, -0.03) for x in (-0.15, -0.1, -0.05, 0.0, 0.05, 0.1, 0.15)
]
CUP_DISTANCE = 0.1


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
    report = Report(ss, folder, say)
    ss.record(report.world, Recording(every=EVERY))
    cups = report.begin()
    cleaner = Cleaner(report.world[ROBOT], np.random.default_rng(seed))
    try:
        cleaner.prepare()
        _take_away(report, cleaner, cups)
    except Failed as failure:
        say(f"The robot cannot go on: {failure}.")
    return report.conclude()


def _take_away(report: Report, cleaner: Cleaner, cups: list[Entity]) -> None:
    """Takes the cups away, the nearest first; failed ones are tried again later."""
    for _ in range(ATTEMPTS):
        waiting = [cup for cup in cups if cup in report.ss.eval(ON_TABLE)]
        while waiting:
            robot_position = np.array(report.world[ROBOT].position[:2])
            distances = [
                float(np.linalg.norm(robot_position - cup.position[:2])) for cup in waiting
            ]
            cup = waiting.pop(int(np.argmin(distances)))
            try:
                _take(report, cleaner, cup)
            except Failed as failure:
                report.outcome.trouble.setdefault(cup.name, []).append(str(failure))
                report.say(f"{cup.name}: {failure}; it is at {coordinates(cup)}.")
                cleaner.recover()


def _take(report: Report, cleaner: Cleaner, cup: Entity) -> None:
    """Takes a cup from the table to the sink."""
    report.approaches(cup.name)
    for spots in (_free_spots(report, spots) for spots in (ROWS, ANYWHERE)):
        if spots and cleaner.can_drop(cup, spots):
            break
    else:
        raise Failed("there is no spot in the sink that the arm reaches")
    cleaner.pick(cup)
    report.holds(cup)
    cleaner.drop(spots)
    if not report.has_dropped(cup):
        raise Failed("it did not fall into the sink")


def _free_spots(report: Report, spots: Sequence[tuple[float, float]]) -> list[Array]:
    """Returns the free ones of some spots in the sink, (3,) each, m."""
    low, high = (np.array(corner) for corner in report.world["sink"].aabb)
    centre = np.array([*((low + high) / 2)[:2], high[2]])
    occupied = [np.array(cup.position[:2]) for cup in report.ss.eval(IN_SINK)]
    return [
        spot
        for spot in (centre + np.array([x, y, 0.0]) for x, y in spots)
        if all(np.linalg.norm(spot[:2] - other) > CUP_DISTANCE for other in occupied)
    ]
