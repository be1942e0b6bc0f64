"""Measures what the sandbox of `Limits.strict()` costs: a question, a picture, and its start.

`python -m benchmarks strict` asks two interpreters on scenes of their own in turns. The times are
by the clock, as two processes take part: let nothing else run.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import ssduck
from benchmarks.timing import medians, text_of

HEADER = ("in a sandbox", "in this process", "sandbox", "more", "budget")
# The programs, and what each may take more in the sandbox, s.
PROGRAMS = {
    "`1 + 1;`": ("1 + 1;", 1e-4),
    "query: robots": ("SELECT id FROM kitchen WHERE isRobot(this) AS list;", 1e-3),
    "query: near pairs": (
        "SELECT a.this, b.this FROM a=kitchen, b=kitchen WHERE near(a.this, b.this, 0.1);",
        1e-3,
    ),
    "picture": ("SELECT obj FROM kitchen WHERE isRobot(this) AS image(320, 240);", 1e-2),
}
_WIDE = "range AS a, range * 2 AS b, range / 3 AS c, range % 7 AS d, 'row' AS e"
STATEMENTS = {
    "raw SQL: robots": ("SELECT name FROM entities WHERE kind = 'robot'", 1e-3),
    "raw SQL: 10,000 rows of 5": (f"SELECT {_WIDE} FROM range(10000)", 4e-3),
}
ROUNDS, STARTS = 200, 10


def rows() -> Iterator[tuple[str, ...]]:
    """Yields a row for each task."""
    strict = ssduck.Limits.strict(progress=False)
    with ssduck.load("kitchen") as here, ssduck.load("kitchen", limits=strict) as there:
        for name, (text, budget) in PROGRAMS.items():
            ways = [partial(ss.eval, ss.compile(text)) for ss in (here, there)]
            yield _row(name, ways, budget, ROUNDS if budget < 1e-2 else ROUNDS // 10)
        for name, (text, budget) in STATEMENTS.items():
            yield _row(name, [_arrow(ss, text) for ss in (here, there)], budget, ROUNDS)
        with tempfile.TemporaryDirectory() as folder:
            here.export(Path(folder) / "run")
            opened = [
                _closed(partial(ssduck.open, Path(folder) / "run", limits=limits))
                for limits in (None, strict)
            ]
            yield _row("a small record, opened", opened, 0.1, STARTS)
    loaded = [_closed(partial(ssduck.load, "kitchen", limits=each)) for each in (None, strict)]
    yield _row("the kitchen, loaded", loaded, 0.6, STARTS)


def _arrow(ss: ssduck.Interpreter, text: str) -> Callable[[], object]:
    return lambda: ss.sql(text).arrow()


def _closed(make: Callable[[], ssduck.Interpreter]) -> Callable[[], object]:
    return lambda: make().close()


def _row(
    name: str, ways: Sequence[Callable[[], object]], budget: float, rounds: int
) -> tuple[str, ...]:
    """Returns the cells of a task."""
    here, there = medians(dict(zip(("here", "there"), ways, strict=True)), rounds).values()
    return name, text_of(here), text_of(there), text_of(there - here), text_of(budget)
