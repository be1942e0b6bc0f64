"""Checks that the records of killed processes open and are complete.

`python -m tools.kill [COUNT] [--seed N] [--to KIND] [--slack T]` kills COUNT recorders; 200 take
about 15 minutes on two busy cores. The exit status is 1 if a record has faults.

A separate process records a small world and reports each tick with the time of day. Half of the
processes store ticks at random moments, report these too, and are killed after some ticks; half of
these also store every few ticks in a thread and checkpoint DuckDB each time. The others never ask
to store, tick for some seconds, or stand still after some ticks, and are killed after some seconds.

A record must open, contain every tick that was reported as stored, contain every tick that is older
than `flush_every`, and contain only whole ticks with the right rows and values. On a busy machine
storing takes its time; the greatest age of a lost tick is shown, and more than 1.5 s is a fault
(`--slack` adds to that).
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import random
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeAlias

import ssduck
from ssduck import Recording
from ssduck.database import worlds, writer
from ssduck.errors import RecordError, SelectScriptError
from ssduck.recording.stores import parquet
from tests.support.bodies import create_linked_body

Kind: TypeAlias = Literal["parquet", "file"]
TABLES = ("entities", "links", "joints", "shapes", "contacts")
BALLS = 8
# The greatest numbers of lines and of further seconds after which a recorder is killed, and of
# seconds after which one is killed that does not ask to store.
MAX_LINES = 60
MAX_SECONDS = 0.1
MAX_TIMED_SECONDS = 3.0
# The time between two ticks of such a recorder, s, and the age from which on no tick may be lost.
PERIOD = 1 / 60
FLUSH_EVERY = 1.0
MAX_AGE = 1.5
# The number of recorders between two lines of progress.
REPORT_EVERY = 20


def place_of(ball: int, tick: int) -> list[float]:
    """Returns the position of a ball at a tick, m."""
    return [ball * 1.0, math.sin(tick * 0.01 + ball), 1.0 + tick * 0.001]


def angle_of(tick: int) -> float:
    """Returns the position of the arm's joint at a tick, rad."""
    return math.sin(tick * 0.02)


# -- the process that is killed ---------------------------------------------------------------


def record(kind: Kind, path: str, seed: int) -> None:
    """Records and reports on standard output until the process is killed."""
    rng = random.Random(seed)  # noqa: S311  # no secret
    timed = is_timed(seed)
    if not timed and rng.random() < 0.5:
        few = rng.randrange(1, 9)
        vars(worlds).update(BUFFERED_TICKS=few, PART_TICKS=few)
        vars(parquet).update(PART_TICKS=2 * few)
        writer.LONG_LOG = 1
    world, move = new_world(rng)
    recording = Recording(tables=TABLES, flush_every=FLUSH_EVERY)
    stands_still_at = rng.randrange(30, 150) if timed and rng.random() < 0.3 else None
    _report(begun=True)
    if kind == "file":
        ss = ssduck.Interpreter(path, recording=recording)
        ss.add_variable("lab", world)
        flush = ss.flush
    else:
        ss = ssduck.Interpreter()
        ss.add_variable("lab", world)
        flush = ss.record_to(path, "lab", recording).flush  # type: ignore[assignment]
    while True:
        number = world.snapshot.number
        counts = {name: world.snapshot.tables[name].count for name in TABLES}
        _report(tick=number, counts=counts, at=world.snapshot.tables["ticks"]["wall_time"][0])
        if not timed and rng.random() < 0.1:
            flush()
            _report(stored=number)
        if timed:
            time.sleep(1000 if number == stands_still_at else PERIOD)
        move(number + 1)
        world.step()


def is_timed(seed: int) -> bool:
    """Checks whether a recorder stores ticks by time only."""
    return seed // 2 % 2 == 1


def new_world(rng: random.Random) -> tuple[ssduck.World, Any]:
    """Returns a world and a function that places its bodies for a tick."""
    import pybullet

    client = pybullet.connect(pybullet.DIRECT)
    here = {"physicsClientId": client}
    box = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=[0.2, 0.2, 0.2], **here)
    ball = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.1, **here)
    balls = [pybullet.createMultiBody(1, ball, **here) for _ in range(BALLS)]
    pybullet.createMultiBody(0, box, basePosition=[0, 0, -5], **here)
    pushed = pybullet.createMultiBody(1, box, **here)
    arm = create_linked_body(
        client,
        0,
        box,
        link_shape=ball,
        basePosition=[0, 0, -9],
        linkPositions=[[0, 0, 0.5]],
        linkJointTypes=[pybullet.JOINT_REVOLUTE],
        linkJointAxis=[[1, 0, 0]],
    )
    names = {body: f"ball {number}" for number, body in enumerate(balls)} | {arm: "arm"}
    guests: list[int] = []

    def move(tick: int) -> None:
        for number, body in enumerate(balls):
            place = place_of(number, tick)
            pybullet.resetBasePositionAndOrientation(body, place, [0, 0, 0, 1], **here)
            pybullet.resetBaseVelocity(body, [0, 0, 0], [0, 0, 0], **here)
        # It touches the fixed box at every other tick.
        height = -4.61 if tick % 2 else -3
        pybullet.resetBasePositionAndOrientation(pushed, [0, 0, height], [0, 0, 0, 1], **here)
        pybullet.resetJointState(arm, 0, angle_of(tick), 0, **here)
        if rng.random() < 0.05:
            if guests:
                pybullet.removeBody(guests.pop(), **here)
            else:
                guests.append(pybullet.createMultiBody(0, box, basePosition=[0, 0, -20], **here))

    world = ssduck.World.attach(client, names=names)
    move(2)  # the first tick that is recorded: contacts are read with it
    return world, move


def _report(**entry: Any) -> None:
    sys.stdout.write(json.dumps(entry) + "\n")
    sys.stdout.flush()


# -- the checks of its record -----------------------------------------------------------------


@dataclass
class RecorderReport:
    """The report of a recorder until it was killed.

    Attributes:
        counts: the number of rows of each table, by tick.
        times: the time of day of each tick, s.
        stored: the last tick that was reported as stored; 0 for none.
        killed_at: the time of day at which it was killed, s.
    """

    counts: dict[int, dict[str, int]] = field(default_factory=dict)
    times: dict[int, float] = field(default_factory=dict)
    stored: int = 0
    killed_at: float = 0.0

    def greatest_age(self, last: int) -> float:
        """Returns how long before its end the first tick was taken that is lost, s; 0 if none is.

        Args:
            last: the last tick that is there.
        """
        lost = [time for tick, time in self.times.items() if tick > last]
        return self.killed_at - min(lost) if lost else 0.0


def killed(kind: Kind, path: Path, seed: int) -> RecorderReport:
    """Starts a recorder and kills it at a random moment; returns its report."""
    code = f"from tools.kill import record; record({kind!r}, {str(path)!r}, {seed})"
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)  # noqa: S603
    assert process.stdout is not None
    while not process.stdout.readline().startswith('{"begun"'):
        if process.poll() is not None:
            raise RuntimeError("the recorder ended by itself")
    rng = random.Random(seed)  # noqa: S311
    # Half of the recorders that ask to store are killed at the very beginning.
    count = 1 if is_timed(seed) else rng.randrange(MAX_LINES) * (seed % 8 > 1)
    lines = [process.stdout.readline() for _ in range(count)]
    time.sleep(rng.uniform(0.0, MAX_TIMED_SECONDS if is_timed(seed) else MAX_SECONDS))
    if process.poll() is not None:
        raise RuntimeError("the recorder ended by itself")
    process.kill()
    report = RecorderReport(killed_at=time.time())
    rest, _ = process.communicate()
    for line in [*lines, *rest.splitlines()]:
        with contextlib.suppress(ValueError):  # the last one may be cut off
            entry = json.loads(line)
            if "tick" in entry:
                report.counts[entry["tick"]] = entry["counts"]
                report.times[entry["tick"]] = entry["at"]
            report.stored = entry.get("stored", report.stored)
    return report


@dataclass(frozen=True)
class RecordCheck:
    """The result of the check of a record.

    Attributes:
        faults: what is wrong.
        ticks: the number of its ticks.
        lost_seconds: the greatest age of a lost tick, s.
    """

    faults: list[str]
    ticks: int
    lost_seconds: float


def check(path: Path, report: RecorderReport, slack: float = 0.0) -> RecordCheck:
    """Checks a record.

    Args:
        path: the record.
        report: the report of its recorder.
        slack: the time that storing may take longer than on a quiet machine, s.
    """
    try:
        ss = ssduck.open(path)
    except RecordError as error:
        # The process may have stored nothing yet.
        age = report.greatest_age(0)
        faults = [f"it does not open: {error}"] if report.stored else []
        return RecordCheck(faults + _too_old(age, slack), 0, age)
    except SelectScriptError as error:
        return RecordCheck([f"it opens with another error: {error}"], 0, 0.0)
    with ss:
        ticks = ss.past("lab").ticks
        age = report.greatest_age(ticks[-1])
        return RecordCheck([*_faults(ss, ticks, report), *_too_old(age, slack)], len(ticks), age)


def _too_old(age: float, slack: float) -> list[str]:
    return [f"a tick of {age:.2f} s before the end is lost"] if age > MAX_AGE + slack else []


def _faults(ss: ssduck.Interpreter, ticks: list[int], report: RecorderReport) -> Any:
    if ticks[-1] < report.stored:
        yield f"tick {report.stored} was stored; the last one is {ticks[-1]}"
    if ticks != list(range(ticks[0], ticks[-1] + 1)):
        yield "ticks are missing in between"
    first = min(tick for tick in report.counts if tick <= ticks[-1])
    if ticks[-1] not in report.counts or ticks[0] > first:
        yield f"ticks {ticks[0]} to {ticks[-1]} are kept, of {first} to {max(report.counts)}"
    for table in TABLES:
        rows = ss.sql(f"SELECT tick, count(*) FROM {table}_history GROUP BY tick").fetchall()
        counts = dict(rows)
        for tick in ticks:
            expected = report.counts.get(tick, {}).get(table)
            if counts.get(tick, 0) != expected:
                yield f"tick {tick} has {counts.get(tick, 0)} rows of {table}, not {expected}"
        if set(counts) - set(ticks):
            yield f"{table} has rows of ticks that are not there"
    query = "SELECT tick, name, x, y, z FROM entities_history WHERE name LIKE 'ball%'"
    for tick, name, *place in ss.sql(query).fetchall():
        if not _are_close(place, place_of(int(name.split()[1]), tick)):
            yield f"{name} is at {place} at tick {tick}"
    for tick, angle in ss.sql("SELECT tick, position FROM joints_history").fetchall():
        if not _are_close([angle], [angle_of(tick)]):
            yield f"the joint is at {angle} at tick {tick}"


def _are_close(numbers: list[float], expected: list[float]) -> bool:
    return all(abs(a - b) < 1e-9 for a, b in zip(numbers, expected, strict=True))


@dataclass
class Run:
    """Kills recorders one after the other, and counts.

    Attributes:
        kinds: the kinds of records, in turn.
        slack: the time that storing may take longer than on a quiet machine, s.
        faults: the faults of records, by the seed.
        stored: the number of records in which ticks were reported as stored.
        ticks: the number of ticks in all records.
        lost_seconds: the greatest age of a lost tick, s.
    """

    kinds: tuple[Kind, ...]
    slack: float = 0.0
    faults: dict[int, list[str]] = field(default_factory=dict)
    stored: int = 0
    ticks: int = 0
    lost_seconds: float = 0.0

    def add(self, seed: int) -> None:
        """Runs and kills another recorder."""
        kind = self.kinds[seed % len(self.kinds)]
        folder = Path(tempfile.mkdtemp(prefix="ssduck-kill-"))
        try:
            path = folder / ("run.duckdb" if kind == "file" else "run")
            report = killed(kind, path, seed)
            result = check(path, report, self.slack)
        finally:
            shutil.rmtree(folder)
        self.stored += report.stored > 0
        self.ticks += result.ticks
        self.lost_seconds = max(self.lost_seconds, result.lost_seconds)
        if result.faults:
            self.faults[seed] = result.faults
            first = "; ".join(result.faults[:3])
            print(f"seed {seed}, {kind}: {len(result.faults)} faults, {first}", flush=True)


KINDS: dict[str, tuple[Kind, ...]] = {
    "parquet": ("parquet",),
    "file": ("file",),
    "both": ("parquet", "file"),
}


def main() -> int:
    parser = argparse.ArgumentParser(description="Kill recorders, and open what they left.")
    parser.add_argument("count", nargs="?", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0, help="the seed of the first recorder")
    parser.add_argument("--to", choices=list(KINDS), default="both", help="the kind of record")
    parser.add_argument(
        "--slack", type=float, default=0.0, help="the time that a busy machine takes to store, s"
    )
    options = parser.parse_args()
    run, started = Run(KINDS[options.to], options.slack), time.monotonic()
    for number in range(options.count):
        run.add(options.seed + number)
        if (number + 1) % REPORT_EVERY == 0:
            print(f"{number + 1} killed, {len(run.faults)} records with faults", flush=True)
    print(
        f"{options.count} killed in {time.monotonic() - started:.0f} s, {run.stored} of them after "
        f"something was flushed; {run.ticks} ticks found, at most {run.lost_seconds:.2f} s lost, "
        f"{len(run.faults)} records with faults"
    )
    return 1 if run.faults else 0


if __name__ == "__main__":
    sys.exit(main())
