"""Checks that a replayed record gives the same answers as the live world.

`python -m tools.replay SECONDS [--every STEPS] [--seed N]` records the kitchen with moving robots;
the exit status is 1 if an answer differs. 600 seconds take about 40 minutes to record and 20 to
replay.

Each simulation step is a tick, and all tables are recorded. Every STEPS steps, programs with
relations of every kind run on the live world; the record is then replayed with the same programs.
A trigger counts the entities that sensors see, live and replayed.
"""

from __future__ import annotations

import argparse
import math
import random
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import ssduck

PAIRS = "SELECT id(a.this), id(b.this) FROM a=kitchen, b=kitchen WHERE "
PROGRAMS = (
    "SELECT position, orientation, velocity(this), mass, aabb FROM kitchen AS list;",
    f"{PAIRS} above(a.this, b.this) AS list;",
    f"{PAIRS} isRobot(a.this) AND near(a.this, b.this, 0.1) AS list;",
    f"{PAIRS} isRobot(a.this) AND collides(a.this, b.this) AS list;",
    f"{PAIRS} isSensing(a.this, b.this) AS list;",
    f"{PAIRS} inContact(a.this, b.this) AND contactForce(a.this, b.this) > 1 AS list;",
    f"{PAIRS} isRobot(a.this) AND penetration(a.this, b.this) > 0.001 AS list;",
    "SELECT id(this), clearance(this, table) FROM kitchen WHERE isRobot(this) AS list;",
    "SELECT id(this) FROM kitchen WHERE on(table, this) AS list;",
    "SELECT id(this), sensingAmount(this, robot), sensingEnvIDs(this) FROM kitchen AS list;",
    "SELECT id(this), force(this), torque(this) FROM kitchen WHERE isKinbody(this) AS list;",
    "SELECT id(this), inside(room, this) FROM kitchen WHERE isRobot(this) AS list;",
    "SELECT id(this) FROM kitchen WHERE isBox(this) OR leftOf(table, this, room) AS list;",
    "SELECT tick(this), z(robot) FROM kitchen{-0.05} WHERE near(table, robot, 1.0) AS list;",
    "[holds(near(robot, table, 1.0), -0.5), least(distance(robot, table), -0.2)];",
)
SIGHTINGS = (
    "SELECT id(s.this), id(r.this) FROM s=kitchen, r=kitchen "
    "WHERE isSensor(s.this) AND isRobot(r.this) AND isSensing(s.this, r.this) AS list;"
)
# Seconds between two evaluations of the trigger.
INTERVAL = 0.5


@dataclass
class RunResults:
    """The results of the programs and the trigger in a run.

    Attributes:
        results: the results of all programs as texts, by simulated time.
        fired: the results of the trigger, with the time of each.
    """

    results: dict[float, list[str]] = field(default_factory=dict)
    fired: list[tuple[float, str]] = field(default_factory=list)


def recorded(folder: Path, seconds: float, every: int, seed: int) -> RunResults:
    """Records a run into a folder; returns the results of the live world."""
    run = RunResults()
    with ssduck.load("kitchen") as ss, ss.record_to(folder, "kitchen"):
        ss.record("kitchen", ssduck.Recording(seconds=60))  # from the same tick on
        kitchen = ss.call_variable("kitchen")
        _prepare(ss, run)
        moves = _moves(random.Random(seed))  # noqa: S311  # no secret
        for step in range(1, round(seconds * 240) + 1):
            kitchen.step()
            if step % every == 0:
                run.results[kitchen.time] = _results(ss)
            if step % 24 == 0:
                for name, pose in next(moves).items():
                    kitchen[name].move(*pose)
    return run


def replayed(folder: Path, times: list[float]) -> RunResults:
    """Replays a record; returns the results at some simulated times."""
    run = RunResults()
    rounds = set(times)
    with ssduck.open(folder) as ss:
        kitchen = ss.call_variable("kitchen")
        kitchen.seek(0.0)
        _prepare(ss, run)
        while kitchen.time < max(times) - 1e-9:
            kitchen.step()
            if kitchen.time in rounds:
                run.results[kitchen.time] = _results(ss)
    return run


def _prepare(ss: ssduck.Interpreter, run: RunResults) -> None:
    kitchen = ss.call_variable("kitchen")
    for variable, name in (("table", "table"), ("room", "kitchen"), ("robot", "roomba_625x")):
        ss.add_variable(variable, kitchen[name])
    ss.add_trigger(
        "seen", SIGHTINGS, INTERVAL, lambda result: run.fired.append((kitchen.time, repr(result)))
    )


def _results(ss: ssduck.Interpreter) -> list[str]:
    return [repr(ss.eval(program)) for program in PROGRAMS]


def _moves(rng: random.Random) -> Iterator[dict[str, Any]]:
    """Yields the next poses of the robots: random walks through the room."""
    places = {"roomba_625x": [0.5, -1.0, 0.05], "barrett_4918": [0.25, -1.9, 0.892]}
    angle = 0.0
    while True:
        angle += rng.uniform(-0.4, 0.4)
        turn = [math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2)]
        for place in places.values():
            place[0] = min(max(place[0] + rng.uniform(-0.1, 0.1), -1.5), 1.5)
            place[1] = min(max(place[1] + rng.uniform(-0.1, 0.1), -2.0), 2.0)
        yield {name: (list(place), turn) for name, place in places.items()}


def differences(live: RunResults, again: RunResults) -> list[str]:
    """Returns a line for each difference."""
    lines = []
    for moment, live_results in live.results.items():
        replayed_results = again.results.get(moment)
        if replayed_results is None:
            lines.append(f"at {moment:g} s nothing was replayed")
            continue
        for program, a, b in zip(PROGRAMS, live_results, replayed_results, strict=False):
            if a != b:
                lines.append(f"at {moment:g} s {program}: {a[:80]} is {b[:80]}")
    if live.fired != again.fired:
        lines.append(f"the trigger fired {len(live.fired)} times, replayed {len(again.fired)}")
    return lines


def main(arguments: list[str] | None = None) -> int:
    """Records, replays and compares."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seconds", type=float)
    parser.add_argument("--every", type=int, default=120, help="steps between two rounds")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        start = time.monotonic()
        live = recorded(Path(folder) / "run", options.seconds, options.every, options.seed)
        recorded_at = time.monotonic()
        again = replayed(Path(folder) / "run", list(live.results))
        size = sum(file.stat().st_size for file in Path(folder).rglob("*") if file.is_file())
        end = time.monotonic()
    lines = differences(live, again)
    for line in lines[:20]:
        print(line)
    print(
        f"{options.seconds:g} s, {len(live.results)} rounds of {len(PROGRAMS)} programs, "
        f"{len(live.fired)} firings, {size / 1e6:.0f} MB: {len(lines)} differences; "
        f"recorded in {recorded_at - start:.0f} s, replayed in {end - recorded_at:.0f} s"
    )
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
