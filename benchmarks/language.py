"""Programs that compute, against the same in Python: four colours, the Towers of Hanoi.

`loop` is what one would write without the language: a loop over all combinations of colours,
and a search for each form of the towers (`benchmarks.problems`), with the same results. `row
by row` is the evaluator that queries are compared with, `Interpreter(row_by_row=True)`. Ratios
are those of ssduck's time to theirs. What takes more than a second is run once; twelve regions
row by row would take minutes and are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias

import ssduck
from benchmarks import problems
from benchmarks.timing import medians, shown

Ways: TypeAlias = dict[str, Callable[[], object]]


@dataclass(frozen=True)
class Problem:
    """A program, the same in Python, and how often each is timed.

    Attributes:
        program: the text.
        loop: the same in Python.
        rounds: how often ssduck and the loop take turns.
        rows_rounds: how often the row-by-row evaluator is timed; 0 leaves it out. If it is as
            often as the others, they all take turns.
    """

    program: str
    loop: Callable[[], object]
    rounds: int
    rows_rounds: int


PROBLEMS = {
    "map of 8 regions": Problem(
        problems.flat(problems.SMALL), partial(problems.coloured, problems.SMALL), 50, 3
    ),
    "the same, nested": Problem(
        problems.nested(problems.SMALL), partial(problems.coloured, problems.SMALL), 50, 1
    ),
    "map of 12 regions": Problem(
        problems.flat(problems.LARGE), partial(problems.coloured, problems.LARGE), 1, 0
    ),
    "towers of Hanoi": Problem(problems.PLAIN, problems.plain, 50, 50),
    "towers, NO CYCLE": Problem(problems.NO_CYCLE, problems.no_cycle, 50, 50),
    "towers, UNIQUE": Problem(problems.UNIQUE, problems.unique, 50, 50),
    "towers, MEMORIZE 7": Problem(problems.MEMORIZE, problems.memorized, 100, 100),
}


def interpreter(*, row_by_row: bool = False) -> ssduck.Interpreter:
    """An interpreter with the function that the towers need."""
    ss = ssduck.Interpreter(row_by_row=row_by_row)
    ss.add_function("move", problems.move)
    return ss


def rows() -> Iterator[tuple[str, ...]]:
    """One row a problem: ssduck, the loop, the row-by-row evaluator, ratios."""
    with interpreter() as ss, interpreter(row_by_row=True) as by_row:
        for name, problem in PROBLEMS.items():
            compiled, same = ss.compile(problem.program), by_row.compile(problem.program)
            ss.eval(compiled)  # plans are made once
            ways: Ways = {"ours": partial(ss.eval, compiled), "loop": problem.loop}
            slow: Ways = {"rows": partial(by_row.eval, same)}
            if problem.rows_rounds == problem.rounds:
                times = medians(ways | slow, problem.rounds)
            else:
                times = medians(ways, problem.rounds)
                times |= medians(slow, problem.rows_rounds) if problem.rows_rounds else {}
            yield (name, shown(times["ours"]), *_beside(times, "loop"), *_beside(times, "rows"))


def _beside(times: dict[str, float], way: str) -> tuple[str, str]:
    """The time of another way, and the ratio of ssduck's to it."""
    if way not in times:
        return "", ""
    ratio = times["ours"] / times[way]
    return shown(times[way]), f"{ratio:.2f}" if ratio >= 0.1 else f"{ratio:.2g}"


HEADER = ("a program", "ssduck", "loop", "ratio", "row by row", "ratio")
