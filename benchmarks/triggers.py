"""Measures a step of the resting kitchen with a hundred triggers against a step without.

`python -m benchmarks triggers` takes about a minute. The hundred triggers of a row are evaluated
after each step. The steps with and without them take turns in one process, and the time is the
processor's.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from dataclasses import dataclass

import ssduck
from benchmarks.timing import text_of

COUNT = 100


@dataclass(frozen=True)
class Case:
    """A hundred triggers.

    Attributes:
        name: what is measured.
        program: the program; `{name}` is the name of a body, `{number}` runs from 0 to 1.
        ratio: the largest ratio to a step without triggers, where there is such a budget.
        more: the largest time beyond it, s, where there is such a budget.
        is_moving: whether the bodies are moved between the steps, so that each result changes.
        is_paused: whether the triggers are paused.
        rounds: the number of steps with the triggers, and of those without.
    """

    name: str
    program: str
    ratio: float | None = None
    more: float | None = None
    is_moving: bool = False
    is_paused: bool = False
    rounds: int = 60


CASES = (
    Case(
        "100 at rest",
        "SELECT name FROM kitchen WHERE z(this) < {number} AND isKinbody(this) AS list;",
        ratio=1.25,
    ),
    Case(
        "100 changing",
        "SELECT x, y, z FROM kitchen WHERE name == '{name}';",
        more=5e-3,
        is_moving=True,
    ),
    Case(
        "100 paused",
        "SELECT name FROM kitchen WHERE z(this) < {number} AS list;",
        more=1e-4,
        is_paused=True,
    ),
    Case(
        "100 distances", "SELECT name FROM kitchen WHERE distance(table, this) < {number} AS list;"
    ),
    Case(
        "100 geometric",
        "SELECT name FROM kitchen WHERE near(table, this, {number}) AS list;",
        rounds=10,
    ),
    Case(
        "100 with a Python function",
        "SELECT name FROM kitchen WHERE heavy(this, {number}) AS list;",
        rounds=10,
    ),
)


class Kitchen:
    """The resting kitchen, and the bodies that are moved to change results."""

    def __init__(self, ss: ssduck.Interpreter) -> None:
        self.ss = ss
        self.world = ss.call_variable("kitchen")
        ss.add_variable("table", self.world["table"])
        ss.add_function("heavy", lambda entity, mass: entity.mass > mass)
        self.world.step(480)
        self.names = [entity.name for entity in self.world if entity.kind != "sensor"]
        self._height = 0.0

    def add(self, case: Case) -> None:
        """Adds the triggers of a case."""
        for number in range(COUNT):
            program = case.program.format(
                name=self.names[number % len(self.names)], number=number / COUNT
            )
            self.ss.add_trigger(f"{case.name} {number}", program, 0, lambda _: None)

    def pause(self, case: Case, *, is_paused: bool) -> None:
        """Pauses or resumes the triggers of a case."""
        change = self.ss.pause_trigger if is_paused else self.ss.resume_trigger
        for number in range(COUNT):
            change(f"{case.name} {number}")

    def remove(self, case: Case) -> None:
        """Removes the triggers of a case."""
        for number in range(COUNT):
            self.ss.del_trigger(f"{case.name} {number}")

    def move(self) -> None:
        """Moves all bodies by less than a micrometre, so that the position of each changes."""
        self._height = 1e-7 - self._height
        for name in self.names:
            entity = self.world[name]
            x, y, z = entity.position
            entity.move([x, y, z + self._height])

    def step(self, *, is_moving: bool) -> float:
        """Returns the processor time of a step, s; the first one after a change is not timed."""
        for _ in range(2):
            if is_moving:
                self.move()
            start = time.process_time()
            self.world.step()
        return time.process_time() - start


def measured(kitchen: Kitchen, case: Case) -> tuple[float, float]:
    """Returns the median processor time of a step without the triggers, and with them, s."""
    without, times = [], []
    kitchen.add(case)
    kitchen.world.step(3)
    for _ in range(case.rounds):
        if case.is_paused:
            kitchen.remove(case)
            without.append(kitchen.step(is_moving=case.is_moving))
            kitchen.add(case)
            kitchen.pause(case, is_paused=True)
        else:
            kitchen.pause(case, is_paused=True)
            without.append(kitchen.step(is_moving=case.is_moving))
            kitchen.pause(case, is_paused=False)
        times.append(kitchen.step(is_moving=case.is_moving))
    kitchen.remove(case)
    return statistics.median(without), statistics.median(times)


def rows() -> Iterator[tuple[str, str, str, str, str, str]]:
    """Yields a row for each case: a step without and with the triggers, and what they add."""
    with ssduck.load("kitchen") as ss:
        kitchen = Kitchen(ss)
        for case in CASES:
            without, with_triggers = measured(kitchen, case)
            ratio, more = with_triggers / without, with_triggers - without
            budget = ""
            if case.ratio is not None:
                budget = f"ratio {case.ratio:g}"
            if case.more is not None:
                budget = f"{text_of(case.more)} more"
            yield (
                case.name,
                text_of(without),
                text_of(with_triggers),
                f"{ratio:.2f}",
                text_of(max(more, 0.0)),
                budget,
            )


HEADER = ("a step of the kitchen", "without", "with triggers", "ratio", "more", "at most")
