"""Measures what the checksums of records cost: recording, opening and first questions.

`python -m benchmarks checksums` does each task with them and without them, in turns. Without them,
Parquet has no checksums of its pages, files get constant checksums, nothing is compared, and
Parquet files are opened where they are rather than read whole. The times are processor times.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from functools import partial
from itertools import count
from pathlib import Path
from statistics import median
from types import SimpleNamespace
from typing import Any, TypeAlias
from unittest.mock import patch

import pyarrow.parquet as pq

import ssduck
from benchmarks.timing import text_of, uncollected
from ssduck import Recording
from ssduck.recording.stores import descriptions, files, parquet_layout, part_log

# The greatest ratio.
MAX_RATIO = 1.05
ROUNDS = 40
RECORDING_ROUNDS = 12
TICKS = 600
TABLES = ("entities", "links", "joints", "contacts")
HEADER = ("checksums of a record", "without", "with", "ratio", "bound")
PROGRAMS = {
    "opening": None,
    "opening, first filter": "SELECT id FROM kitchen{} WHERE z > 1 AS list;",
    "opening, first filter of a tick": "SELECT id FROM kitchen{1} WHERE z > 1 AS list;",
}
STATEMENTS = {"opening, first count of contacts": "SELECT count(*) FROM contacts_history"}

# A call, what holds meanwhile, and its times.
_Way: TypeAlias = tuple[
    Callable[[], object], Callable[[], AbstractContextManager[None]], list[float]
]


def rows() -> Iterator[tuple[str, ...]]:
    """Yields a row for each task."""
    with tempfile.TemporaryDirectory() as folder:
        yield _recording(Path(folder))
        run = Path(folder) / "run"
        with ssduck.load("kitchen", recording=None) as ss:
            _record(ss, run)
        for name, text in PROGRAMS.items():
            yield _question(name, run, "eval", text)
        for name, text in STATEMENTS.items():
            yield _question(name, run, "sql", text)


def _recording(folder: Path) -> tuple[str, ...]:
    """Compares recordings of the kitchen, of two interpreters, each in new folders."""
    with (
        ssduck.load("kitchen", recording=None) as one,
        ssduck.load("kitchen", recording=None) as other,
    ):
        folders = (folder / str(number) for number in count())
        before, after = _medians(
            lambda: _record(one, next(folders)),
            lambda: _record(other, next(folders)),
            rounds=RECORDING_ROUNDS,
        )
    return _cells("recording a tick, beginning and end included", before / TICKS, after / TICKS)


def _record(ss: ssduck.Interpreter, run: Path) -> None:
    with ss.record_to(run, recording=Recording(tables=TABLES)):
        ss.call_variable("kitchen").step(TICKS, every=1)


def _question(name: str, run: Path, door: str, text: str | None) -> tuple[str, ...]:
    call = partial(_ask, run, door, text)
    return _cells(name, *_medians(call, call, rounds=ROUNDS))


def _ask(run: Path, door: str, text: str | None) -> None:
    with ssduck.open(run) as ss:
        if text is not None:
            rows = getattr(ss, door)(text)
            if not (rows if door == "eval" else rows.fetchall()):
                raise AssertionError(f"{text} finds nothing")


def _medians(
    without: Callable[[], object], given: Callable[[], object], rounds: int
) -> tuple[float, float]:
    """Returns the processor times, s, of a call without checksums and of one with them.

    Each way goes first in every other round, and garbage is collected between the calls: one way
    must not pay for what the other leaves.
    """
    times: tuple[list[float], list[float]] = [], []
    ways: list[_Way] = [(without, _no_checksums, times[0]), (given, nullcontext, times[1])]
    for number in range(-(rounds // 10), rounds):
        ways.reverse()
        for call, context, own in ways:
            with context(), uncollected():
                start = time.process_time()
                call()
                elapsed = time.process_time() - start
            if number >= 0:
                own.append(elapsed)
    return median(times[0]), median(times[1])


def _cells(name: str, before: float, after: float) -> tuple[str, ...]:
    return name, text_of(before), text_of(after), f"{after / before:.2f}", f"{MAX_RATIO}"


@contextmanager
def _no_checksums() -> Iterator[None]:
    """Writes and reads records without checksums."""
    replaced: list[tuple[Any, dict[str, Any]]] = [
        (files, {"zlib": SimpleNamespace(crc32=lambda *_: 0)}),
        (pq, {"ParquetWriter": _writer_without_sums}),
        (descriptions, {"pop_checksum": _unchecked}),
        (part_log, {"log_problem": _no_problem}),
        *((parquet_layout, {name: _no_problem}) for name in ("parquet_problem", "footer_problem")),
    ]
    with ExitStack() as stack:
        for module, values in replaced:
            stack.enter_context(patch.multiple(module, **values))
        yield


_Writer = pq.ParquetWriter


def _writer_without_sums(*args: Any, **options: Any) -> pq.ParquetWriter:
    return _Writer(*args, **(options | {"write_page_checksum": False}))


def _no_problem(*_: object, **__: object) -> None:
    return None


def _unchecked(content: dict[str, Any]) -> bool:
    content.pop(files.CHECKSUM_KEY, None)
    return True
