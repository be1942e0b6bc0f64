"""Measures what `Limits.strict()` costs: queries, raw SQL, recording and opening.

`python -m benchmarks strict` compares two interpreters on scenes of their own, with and without the
limits. The times are processor times, so that other processes do not matter.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median

import ssduck
from benchmarks.timing import text_of

# The greatest ratio.
MAX_RATIO = 1.05
ROUNDS = 100
HEADER = ("under Limits.strict()", "without limits", "strict", "ratio", "bound")
PROGRAMS = {
    "query: robots": "SELECT id FROM kitchen WHERE isRobot(this) AS list;",
    "query: near pairs": (
        "SELECT a.this, b.this FROM a=kitchen, b=kitchen WHERE near(a.this, b.this, 0.1);"
    ),
    "query: all pairs": "SELECT a.id, b.id, a.z - b.z FROM a=kitchen, b=kitchen AS list;",
    "row by row: 1,000 numbers": "SELECT round(this / 7, 2) FROM numbers ORDER BY -this AS list;",
    "path search": (
        "SELECT this FROM [1, 2, 3] START WITH s=0 CONNECT BY UNIQUE s = round(s + this) "
        "STOP WITH s > 60 AS list;"
    ),
}
STATEMENTS = {
    "raw SQL: robots": "SELECT name FROM entities WHERE kind = 'robot'",
    "raw SQL: 10,000 rows": "SELECT range, 'row ' || range AS name FROM range(10000)",
    "raw SQL: 10,000 dates": "SELECT range, DATE '2026-01-01' + range::INTEGER FROM range(10000)",
}


def rows() -> Iterator[tuple[str, ...]]:
    """Yields a row for each task."""
    limits = ssduck.Limits.strict(progress=False)
    with ssduck.load("kitchen") as free, ssduck.load("kitchen", limits=limits) as strict:
        for ss in (free, strict):
            ss.add_variable("numbers", list(range(1000)))
        for name, text in PROGRAMS.items():
            yield _row(name, *(_query(ss.eval, ss.compile(text)) for ss in (free, strict)))
        for name, text in STATEMENTS.items():
            yield _row(name, *(_query(ss.sql, text) for ss in (free, strict)))
        worlds = [ss.call_variable("kitchen") for ss in (free, strict)]
        yield _row("recording: 20 ticks", *(_step(world) for world in worlds))
        with tempfile.TemporaryDirectory() as folder:
            free.export(Path(folder) / "run")
            yield _row("opening a record", *(_open(folder, given) for given in (None, limits)))


def _query(run: Callable[..., object], text: object) -> Callable[[], object]:
    return lambda: run(text)


def _step(world: ssduck.World) -> Callable[[], object]:
    return lambda: world.step(20)


def _open(folder: str, limits: ssduck.Limits | None) -> Callable[[], object]:
    return lambda: ssduck.open(Path(folder) / "run", limits=limits).close()


def _row(name: str, free: Callable[[], object], strict: Callable[[], object]) -> tuple[str, ...]:
    """Returns the cells of a task; each way goes first in every other round."""
    times: tuple[list[float], list[float]] = [], []
    ways = [(free, times[0]), (strict, times[1])]
    for number in range(ROUNDS):
        ways.reverse()
        for call, own in ways:
            start = time.process_time()
            call()
            if number >= ROUNDS // 10:
                own.append(time.process_time() - start)
    before, after = map(median, times)
    return name, text_of(before), text_of(after), f"{after / before:.2f}", f"{MAX_RATIO}"
