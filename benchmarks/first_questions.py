"""Measures what the check of a foreign record's rows costs the first question of SQL, and a second.

`python -m benchmarks first` asks a record anew, with the check and without it, in turns; the
checksums of the data belong to the check. The floor is what no check can do without: to read the
bytes once, for their checksum, and to decode the columns that tell which rows there are. The times
are processor times of all threads.
"""

from __future__ import annotations

import tempfile
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from pathlib import Path
from statistics import median
from unittest.mock import patch

import pyarrow.parquet as pq

import ssduck
from benchmarks.timing import text_of, uncollected
from ssduck import Recording
from ssduck.recording.replay.checked_rows import CheckedRows
from ssduck.recording.stores.row_checks import key_types

ROUNDS = 12
TICKS = 4_000
# The tables that are checked for a question, by its text.
QUESTIONS = {
    "SELECT count(*) FROM contacts_history": ("contacts",),
    "SELECT max(force) FROM contacts_history": ("contacts",),
    "SELECT count(*) FROM links_history": ("links", "entities"),
    "SELECT max(position) FROM joints_history": ("joints", "entities"),
    "SELECT max(z) FROM entities_history": ("entities",),
}
HEADER = (
    "a question of SQL",
    "unchecked",
    "checked",
    "ratio",
    "floor of the check",
    "ratio with it",
    "the question again, ratio",
)
_PIECE = 1 << 18


def rows() -> Iterator[tuple[str, ...]]:
    """Yields a row for each question."""
    with tempfile.TemporaryDirectory() as folder, ssduck.load("kitchen", recording=None) as ss:
        run = Path(folder) / "run"
        tables = ("entities", "links", "joints", "contacts")
        with ss.record_to(run, recording=Recording(tables=tables)):
            ss.call_variable("kitchen").step(TICKS, every=1)
        for question, checked in QUESTIONS.items():
            yield _row(run, question, checked)


def _row(run: Path, question: str, tables: tuple[str, ...]) -> tuple[str, ...]:
    ask = partial(_ask, run, question)
    unchecked, checked = _in_turns(
        lambda: _times(ask, _unchecked()), lambda: _times(ask, nullcontext())
    )
    floor = median(_time(partial(_read_keys, run, tables)) for _ in range(ROUNDS))
    return (
        question,
        text_of(unchecked[0]),
        text_of(checked[0]),
        f"{checked[0] / unchecked[0]:.2f}",
        text_of(floor),
        f"{1 + floor / unchecked[0]:.2f}",
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
    ask: Callable[[], tuple[float, float]], context: AbstractContextManager[None]
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


@contextmanager
def _unchecked() -> Iterator[None]:
    """Leaves out the check of rows, and the checksums of the data that it reads."""
    with (
        patch.object(CheckedRows, "check_rows", _do_nothing),
        patch.object(CheckedRows, "check_groups", _do_nothing),
    ):
        yield


def _do_nothing(*_: object, **__: object) -> None:
    return None


def _time(call: Callable[[], None]) -> float:
    with uncollected():
        start = time.process_time()
        call()
        return time.process_time() - start


def _read_keys(run: Path, tables: tuple[str, ...]) -> None:
    """Reads the bytes of tables, and decodes the columns that tell which rows there are."""
    piece = bytearray(_PIECE)
    for table in tables:
        for file in sorted(run.glob(f"{table}/**/*.parquet")):
            checksum = 0
            with file.open("rb", buffering=0) as content:
                while count := content.readinto(piece):
                    checksum = zlib.crc32(memoryview(piece)[:count], checksum)
            pq.ParquetFile(file).read(columns=key_types(table).names, use_threads=False)
