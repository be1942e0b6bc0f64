"""Checks that programs over time give live what the record of the run gives.

`python -m tools.check_live [COUNT] [--seed N]` generates COUNT programs, half of them in MuJoCo and
half in PyBullet: functions of time in one another over relations, comparisons, margins and
variables, also in rows. 1,000 take about 15 minutes. The exit status is 1 if one differs.

Bodies are dropped, pushed and put elsewhere. At each tick, a program is evaluated in the world that
goes on, and, if no record is needed, in an interpreter without one. Then the record is opened, and
sought to each tick, where it has to give the same value or kind of error. What looks back must be
in its rows, too, and what looks ahead must stay as it was from the tick on at which it was decided.
"""

from __future__ import annotations

import argparse
import math
import random
import sys
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pybullet

import ssduck
from ssduck.errors import SelectScriptError
from tests.support.two_simulators import Part, in_mujoco, in_pybullet

SIMULATORS = ("mujoco", "pybullet")
# The numbers of programs of a run, of its ticks, and of those that the record is sought to.
PER_RUN, TICKS, SOUGHT = 10, 16, 3
_UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
_BODIES = (
    ("table", "box", (0.4, 0.4, 0.1), (0.0, 0.0, 0.1), 0.0),
    ("ball", "sphere", (0.06,), (0.0, 0.0, 0.5), 1.0),
    ("can", "cylinder", (0.05, 0.08), (0.2, 0.1, 0.29), 0.5),
    ("bar", "capsule", (0.04, 0.12), (-0.2, 0.1, 0.5), 0.7),
    ("stone", "mesh", (0.06, 0.05, 0.07), (0.1, -0.2, 0.4), 0.8),
)
PARTS = [
    Part(name, kind, size, np.array(place), _UPRIGHT, mass)
    for name, kind, size, place, mass in _BODIES
]
MOVING = [part.name for part in PARTS if part.mass]
LIMITS = ("", ", 0", ", 0, 0.05", ", 0.03, 0.1", ", 0.02", ", 0, wide", ", 0, 0.015")
BACK, AHEAD = ("once", "historically", "heldSince"), ("always", "eventually", "until")
TABLES = ("entities", "links", "joints", "contacts")
_LENGTHS = ("distance", "clearance", "penetration")
# Variables of the programs.
VARIABLES = {"low": 0.25, "wide": 0.06, "near_by": 0.15, "corner": [-0.3, -0.3, 0.0]}


@dataclass(frozen=True)
class Expression:
    """A generated expression, and whether it depends on later ticks."""

    text: str
    looks_ahead: bool = False


@dataclass
class Generator:
    """Generates expressions; `row` is what stands for the entity of a row, if there is one."""

    draw: random.Random
    row: str = ""
    ahead: bool = True  # whether operators may look ahead
    looks_ahead: bool = field(default=False, init=False)

    def entity(self) -> str:
        """Returns an entity."""
        if self.row and self.draw.random() < 0.5:
            return self.row
        return self.draw.choice([f"sim.{name}" for name in MOVING] + ["sim.table", "ball"])

    def pair(self) -> str:
        """Returns two entities."""
        return f"{self.entity()}, {self.entity()}"

    def number(self, depth: int) -> str:
        """Returns a number."""
        draw = self.draw
        if depth == 0:
            return draw.choice(
                [
                    f"{draw.choice('xyz')}({self.entity()})",
                    f"z({self.entity()})",
                    f"{draw.choice(_LENGTHS)}({self.pair()})",
                    f"{draw.choice(('speed', 'angularSpeed', 'tilt'))}({self.entity()})",
                    f"contactForce({self.pair()})",
                    f"velocity({self.entity()})[2]",
                    f"joint(sim.arm, 'joint{draw.choice('12')}')",
                ]
            )
        kind = draw.choice(
            ["rate", "previous", "initially", "heldFor", "arithmetic", "margin", "extreme", "list"]
        )
        match kind:
            case "rate" | "previous" | "initially":
                return f"{kind}({self.number(depth - 1)})"
            case "heldFor":
                return f"heldFor({self.condition(depth - 1)})"
            case "margin":
                return f"robustness({self.condition(depth - 1)})"
            case "extreme":
                return f"{draw.choice(('least', 'greatest'))}({self.number(depth - 1)})[1]"
            case "list":
                one, other = (self.number(depth - 1) for _ in range(2))
                return f"{draw.choice(('min', 'max'))}([{one}, {other}])"
        one = self.number(depth - 1)
        return draw.choice(
            [f"({one} + low)", f"2 * {one}", f"-{one}", f"({one} - {self.number(0)})"]
        )

    def leaf(self) -> str:
        """Returns a condition without other conditions."""
        draw = self.draw
        distance = draw.choice(["0.02", "0.1", "near_by", "0.3"])
        return draw.choice(
            [
                f"z({self.entity()}) {draw.choice(('>', '<=', '>=', '<'))} low",
                f"z({self.entity()}) < z({self.entity()})",
                f"near({self.pair()}, {distance})",
                f"{draw.choice(('above', 'below', 'within', 'overlaps'))}({self.pair()})",
                f"touching({self.pair()}{draw.choice(('', ', 0.01'))})",
                f"{draw.choice(('collides', 'inContact', 'on', 'nextTo'))}({self.pair()})",
                f"collides({self.pair()}, 0.002)",
                f"inBox({self.entity()}, corner, [0.3, 0.3, 0.45])",
                f"inSphere({self.entity()}, [0, 0, 0.3], 0.2)",
                f"upright({self.entity()}{draw.choice(('', ', 0.05'))})",
                f"lifted({self.entity()}, 0.02)",
                f"settled({self.entity()})",
                f"speed({self.entity()}) < 0.5",
                f"z({self.entity()}) BETWEEN 0.25 AND 0.4",
                f"isOpen(sim.arm, 'joint{draw.choice('12')}')",
                f"isKinbody({self.entity()})",
            ]
        )

    def condition(self, depth: int) -> str:
        """Returns a condition."""
        draw = self.draw
        if depth == 0:
            return self.leaf()
        kind = draw.choice(
            ["NOT", "AND", "OR", "IMPLIES", "scale", "compared", "value", *BACK, *BACK]
            + self.ahead * [*AHEAD]
        )
        match kind:
            case "NOT":
                return f"(NOT {self.condition(depth - 1)})"
            case "AND" | "OR" | "IMPLIES":
                return f"({self.condition(depth - 1)} {kind} {self.condition(depth - 1)})"
            case "scale":
                return f"scale({self.condition(depth - 1)}, {draw.choice(('0.1', '2'))})"
            case "compared":
                sign = draw.choice(("<", "<=", ">", ">="))
                return f"{self.number(depth - 1)} {sign} {draw.choice(('low', '0', '0.1'))}"
            case "value":
                name = draw.choice(("previous", "initially"))
                return f"{name}({self.condition(depth - 1)})"
        self.looks_ahead |= kind in AHEAD
        count = 2 if kind in ("until", "heldSince") else 1
        parts = ", ".join(self.condition(depth - 1) for _ in range(count))
        return f"{kind}({parts}{draw.choice(LIMITS)})"

    def expression(self, depth: int) -> Expression:
        """Returns a condition, a number, or a list of what was."""
        self.looks_ahead = False
        kind = self.draw.choice(["condition"] * 4 + ["number"] * 2 + ["margin", "history", "since"])
        match kind:
            case "number":
                text = self.number(depth)
            case "margin":
                text = f"robustness({self.condition(depth)})"
            case "history":
                name = self.draw.choice(("holds", "changes"))
                text = f"{name}({self.condition(depth - 1)}{self.draw.choice(('', ', -0.05'))})"
            case "since":
                text = f"since({self.condition(depth - 1)})"
            case _:
                text = self.condition(depth)
        return Expression(text, self.looks_ahead)


@dataclass(frozen=True)
class Program:
    """A program, and what is known of it."""

    text: str
    expression: Expression
    has_rows: bool = False


def program(draw: random.Random) -> Program:
    """Returns a generated program."""
    form = draw.choice(("value", "value", "list", "rows", "where"))
    depth = draw.randint(1, 3)
    if form in ("value", "list"):
        generator = Generator(draw)
        one = generator.expression(depth)
        if form == "value":
            return Program(f"{one.text};", one)
        other = generator.expression(1)
        looks_ahead = one.looks_ahead or other.looks_ahead
        both = Expression(f"[{one.text}, {other.text}]", looks_ahead)
        return Program(f"{both.text};", both)
    one = Generator(draw, "this").expression(depth)
    if form == "rows":
        text = f"SELECT name, {one.text} AS value FROM sim WHERE isKinbody(this) AS list;"
    else:
        condition = Generator(draw, "this").condition(depth)
        text = f"SELECT name FROM sim WHERE isKinbody(this) AND {condition} AS list;"
    return Program(text, one, has_rows=True)


# -- runs -----------------------------------------------------------------------------------------


@contextmanager
def opened(simulator: str, recording: ssduck.Recording | None) -> Iterator[ssduck.Interpreter]:
    """Yields an interpreter with a new world of a simulator, at the first tick of an episode."""
    with ssduck.Interpreter(recording=recording) as ss:
        if simulator == "mujoco":
            world = ssduck.World.attach(in_mujoco(PARTS))
        else:
            client = pybullet.connect(pybullet.DIRECT)
            pybullet.setGravity(0, 0, -9.81, physicsClientId=client)
            world = ssduck.World.attach(client, names=in_pybullet(PARTS, client, margins=True))
        provided(ss, world)
        world.begin_episode()
        try:
            yield ss
        finally:
            if simulator == "pybullet":
                pybullet.disconnect(client)


def act(world: ssduck.World, draw: random.Random) -> None:
    """Moves a body, which is another tick at the same time, or takes some steps."""
    if draw.random() < 0.15:
        place = [draw.uniform(-0.3, 0.3), draw.uniform(-0.3, 0.3), draw.uniform(0.25, 0.5)]
        world[draw.choice(MOVING)].move(place)
    else:
        world.step(draw.choice((1, 2, 2, 5, 10)), every=None)


def outcome(ss: ssduck.Interpreter, text: str) -> Any:
    """Returns the value of a program, or the kind of its error."""
    try:
        return ss.eval(text)
    except SelectScriptError as error:
        return f"{type(error).__name__}: {error.message}"


def are_equal(one: Any, other: Any) -> bool:
    """Compares values; numbers that are no numbers are equal."""
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(are_equal, one, other))
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(are_equal(one[k], other[k]) for k in one)
    if isinstance(one, float) and isinstance(other, float) and math.isnan(one):
        return math.isnan(other)
    return type(one) is type(other) and bool(one == other)


def provided(ss: ssduck.Interpreter, world: ssduck.World) -> None:
    """Gives an interpreter the variables of the programs."""
    ss.add_variable("sim", world)
    ss.add_variable("ball", world["ball"])
    for name, value in VARIABLES.items():
        ss.add_variable(name, value)


class Run:
    """A run of a world with programs."""

    def __init__(self, simulator: str, seed: int, programs: list[Program]) -> None:
        self.draw = random.Random(seed)  # noqa: S311  # for generated cases
        self.simulator, self.seed, self.programs = simulator, seed, programs
        # The values of each program, by the time of the tick; the last one of a time counts.
        self.live: list[dict[float, Any]] = [{} for _ in programs]
        self.faults: list[str] = []

    def check(self, program: Program, time: float, what: str, one: Any, other: Any) -> None:
        """Notes a difference."""
        if not are_equal(one, other):
            self.faults.append(
                f"{self.simulator} {self.seed}, {time:.4f} s: {program.text}\n"
                f"  live: {one!r}\n  {what}: {other!r}"
            )

    def differences(self) -> list[str]:
        """Runs the world, and returns what differs."""
        with tempfile.TemporaryDirectory() as folder:
            recording = ssduck.Recording(TABLES)
            with opened(self.simulator, recording) as ss, opened(self.simulator, None) as bare:
                self._run(ss, bare)
                self._check_rows(ss, "kept ticks")
                ss.export(folder + "/run")
            with ssduck.open(folder + "/run") as record:
                provided(record, record.call_variable("sim"))
                self._check_rows(record, "rows of the record")
                self._check_decided(record)
                self._check_replay(record)
        return self.faults

    def _run(self, ss: ssduck.Interpreter, bare: ssduck.Interpreter) -> None:
        world, other = (one.call_variable("sim") for one in (ss, bare))
        for _ in range(TICKS):
            is_asked = self.draw.random() < 0.9  # of a tick that is not, a state lacks it
            for number, one in enumerate(self.programs):
                self.live[number].pop(world.time, None)
                found = "" if one.has_rows else outcome(bare, one.text)
                if is_asked:
                    value = self.live[number][world.time] = outcome(ss, one.text)
                    if not (one.has_rows or "are not recorded" in str(found)):
                        self.check(one, world.time, "without a record", value, found)
            seed = self.draw.random()
            for each in (world, other):
                act(each, random.Random(seed))  # noqa: S311  # for generated cases
        for live in self.live:
            live.pop(world.time, None)

    def _check_rows(self, ss: ssduck.Interpreter, what: str) -> None:
        """Compares what looks back with rows of the ticks."""
        for one, live in zip(self.programs, self.live, strict=True):
            if one.has_rows or one.expression.looks_ahead:
                continue
            text = f"SELECT time, {one.expression.text} AS value FROM sim{{}} WHERE name = 'can';"
            found = outcome(ss, text)
            if isinstance(found, str):
                is_error = any(isinstance(value, str) for value in live.values())
                self.check(one, math.nan, what, found if is_error else "a value", found)
                continue
            values = {row["time"]: row["value"] for row in found}
            for time, value in live.items():
                self.check(one, time, what, value, values.get(time, "no row"))

    def _check_decided(self, record: ssduck.Interpreter) -> None:
        """Compares verdicts of what looks ahead with those of the finished record."""
        for one, live in zip(self.programs, self.live, strict=True):
            if one.has_rows or not one.expression.text.startswith(AHEAD):
                continue
            final = outcome(record, one.text)
            for time, value in live.items():
                if value is not None:
                    self.check(one, time, "the end", value, final)

    def _check_replay(self, record: ssduck.Interpreter) -> None:
        world = record.call_variable("sim")
        for time in self.draw.sample(list(self.live[0]), SOUGHT):
            world.seek(time)
            for one, live in zip(self.programs, self.live, strict=True):
                self.check(one, time, "replay", live[time], outcome(record, one.text))


def main() -> int:
    parser = argparse.ArgumentParser(description="Compare live values with those of records.")
    parser.add_argument("count", nargs="?", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    faults, errors = [], 0
    for number in range(-(-options.count // PER_RUN)):
        seed = options.seed + number
        draw = random.Random(seed)  # noqa: S311  # for generated programs
        run = Run(SIMULATORS[number % 2], seed, [program(draw) for _ in range(PER_RUN)])
        for fault in run.differences():
            print(fault, flush=True)
            faults.append(fault)
        errors += sum(isinstance(value, str) for live in run.live for value in live.values())
    print(f"{options.count} programs, {errors} values are errors: {len(faults)} differences")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
