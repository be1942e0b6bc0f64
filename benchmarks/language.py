"""Measures programs that compute against Python: four colours, the Towers of Hanoi.

`python -m benchmarks language` takes about a minute. `loop` is the same in plain Python: a loop
over all combinations of colours, and a search for each form of the towers (`benchmarks.problems`),
with equal results. `row by row` is the evaluation without SQL, `Interpreter(row_by_row=True)`.
Ratios divide ssduck's time by theirs. Ways that take more than a second run once; twelve regions
row by row would take minutes and are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias

import ssduck
from benchmarks import problems
from benchmarks.timing import medians, text_of

Ways: TypeAlias = dict[str, Callable[[], object]]


@dataclass(frozen=True)
class Problem:
    """A program, the same in Python, and the numbers of timed calls.

    Attributes:
        program: the program.
        loop: the same in Python.
        rounds: the number of calls of ssduck and of the loop, in turns.
        rows_rounds: the number of calls of the row-by-row evaluator; 0 leaves it out. If it equals
            `rounds`, all three take turns.
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
    """Returns an interpreter with the function of the towers."""
    ss = ssduck.Interpreter(row_by_row=row_by_row)
    ss.add_function("move", problems.move)
    return ss


def rows() -> Iterator[tuple[str, ...]]:
    """Yields a row for each problem: ssduck, the loop, the row-by-row evaluator, ratios."""
    with interpreter() as ss, interpreter(row_by_row=True) as by_row:
        for name, problem in PROBLEMS.items():
            compiled, row_by_row_program = (
                ss.compile(problem.program),
                by_row.compile(problem.program),
            )
            ss.eval(compiled)  # the first call plans the queries
            ways: Ways = {"ours": partial(ss.eval, compiled), "loop": problem.loop}
            row_by_row_way: Ways = {"rows": partial(by_row.eval, row_by_row_program)}
            if problem.rows_rounds == problem.rounds:
                times = medians(ways | row_by_row_way, problem.rounds)
            else:
                times = medians(ways, problem.rounds)
                times |= medians(row_by_row_way, problem.rows_rounds) if problem.rows_rounds else {}
            yield (
                name,
                text_of(times["ours"]),
                *_time_and_ratio(times, "loop"),
                *_time_and_ratio(times, "rows"),
            )


def _time_and_ratio(times: dict[str, float], way: str) -> tuple[str, str]:
    """Returns the time of another way, and the ratio of ssduck's time to it."""
    if way not in times:
        return "", ""
    ratio = times["ours"] / times[way]
    return text_of(times[way]), f"{ratio:.2f}" if ratio >= 0.1 else f"{ratio:.2g}"


HEADER = ("a program", "ssduck", "loop", "ratio", "row by row", "ratio")
