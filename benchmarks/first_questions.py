"""Measures what checksums cost the first question of SQL about a record, and a second.

`python -m benchmarks first` asks a record anew, with the checksums of the data that it reads and
without them, in turns. The times are processor times of all threads.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from pathlib import Path
from statistics import median
from unittest.mock import patch

import ssduck
from benchmarks.timing import text_of, uncollected
from ssduck import Recording
from ssduck.recording.stores.parquet_layout import FolderRun

ROUNDS = 12
TICKS = 4_000
QUESTIONS = (
    "SELECT count(*) FROM contacts_history",
    "SELECT max(force) FROM contacts_history",
    "SELECT count(*) FROM links_history",
    "SELECT max(position) FROM joints_history",
    "SELECT max(z) FROM entities_history",
)
HEADER = (
    "a question of SQL",
    "unchecked",
    "checked",
    "ratio",
    "the question again, ratio",
)


def rows() -> Iterator[tuple[str, ...]]:
    """Yields a row for each question."""
    with tempfile.TemporaryDirectory() as folder, ssduck.load("kitchen", recording=None) as ss:
        run = Path(folder) / "run"
        tables = ("entities", "links", "joints", "contacts")
        with ss.record_to(run, recording=Recording(tables=tables)):
            ss.call_variable("kitchen").step(TICKS, every=1)
        for question in QUESTIONS:
            yield _row(run, question)


def _row(run: Path, question: str) -> tuple[str, ...]:
    ask = partial(_ask, run, question)
    unchecked, checked = _in_turns(
        lambda: _times(ask, patch.object(FolderRun, "check_data")),
        lambda: _times(ask, nullcontext()),
    )
    return (
        question,
        text_of(unchecked[0]),
        text_of(checked[0]),
        f"{checked[0] / unchecked[0]:.2f}",
        f"{checked[1] / unchecked[1]:.2f}",
    )


def _in_turns(*ways: Callable[[], tuple[float, float]]) -> list[tuple[float, float]]:
    """Returns the medians of the two times of each way; each goes first in every other round."""
    found: list[list[tuple[float, float]]] = [[] for _ in ways]
    for number in range(-1, ROUNDS):
        order = range(len(ways)) if number % 2 else range(len(ways) - 1, -1, -1)
        for place in order:
            times = ways[place]()
            if number >= 0:
                found[place].append(times)
    return [(median(one for one, _ in own), median(two for _, two in own)) for own in found]


def _times(
    ask: Callable[[], tuple[float, float]], context: AbstractContextManager[object]
) -> tuple[float, float]:
    with context, uncollected():
        return ask()


def _ask(run: Path, question: str) -> tuple[float, float]:
    """Returns the times of opening with a first question, and of the question again, s."""
    start = time.process_time()
    with ssduck.open(run) as ss:
        ss.sql(question).fetchall()
        first = time.process_time()
        ss.sql(question).fetchall()
        return first - start, time.process_time() - first
