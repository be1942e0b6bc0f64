"""Checks that work on records that is killed leaves no half that looks whole.

`python -m tools.kill_work [COUNT] [--seed N] [--work NAME]` kills COUNT processes in the middle of
their work, in turn: while they export a record, close a recording, open a record and ask it, begin
another episode in a record, repair one, and import an MCAP file (extra
`mcap`). 500 take about ten minutes on two busy cores. The exit status is 1 if there are faults.
`python -m tools.kill` kills recorders while they record and flush.

Records are folders and DuckDB files, in turn. A process is killed at a random moment of the time
that its work takes. After that, every tick that was stored before must be there with the same rows,
an export and an import must be whole or not there at all, only an episode with
all its ticks may be `complete`, and the same work must succeed when it is done again.
"""

from __future__ import annotations

import argparse
import multiprocessing
import random
import shutil
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any
from unittest.mock import patch

import ssduck
from ssduck import Recording
from ssduck.database import worlds
from ssduck.errors import RecordError
from ssduck.interchange.conversion import write_runs
from ssduck.recording.stores import parquet
from ssduck.recording.stores.parquet_layout import FolderRun
from tools.kill import TABLES, new_world

TICKS = 120
# The number of ticks in a part of a record: it has several.
PART_TICKS = 16
# A tick after which the recorder of another episode stores what it has.
FLUSHED = 40
# A worker is killed between its beginning and so many times the time that its work took alone.
MARGIN = 1.2
# The number of processes between two lines of progress.
REPORT_EVERY = 50
# What differs from run to run is left out.
ROWS = "SELECT COLUMNS(lambda name: name NOT IN ('run', 'wall_time')) FROM {}_history ORDER BY ALL"

Report = Callable[[str], None]


def _path(folder: Path, kind: str) -> Path:
    return folder / ("run.duckdb" if kind == "file" else "run")


def _record(path: Path, flushed: Report | None = None, seed: int = 1) -> None:
    """Records a number of ticks as a new episode, and closes the recording.

    Args:
        path: a folder, or a DuckDB file.
        flushed: a function that is told "stored" when the first ticks are stored, and "closing".
        seed: the seed of the bodies that come and go.
    """
    world, move = new_world(random.Random(seed))  # noqa: S311  # no secret
    recording = Recording(tables=TABLES, flush_every=None)
    with (
        patch.multiple(worlds, BUFFERED_TICKS=PART_TICKS, PART_TICKS=PART_TICKS),
        patch.object(parquet, "PART_TICKS", PART_TICKS),
        ssduck.Interpreter()
        if path.suffix == ""
        else ssduck.Interpreter(path, recording=recording) as ss,
    ):
        ss.add_variable("lab", world)
        flush = ss.flush if path.suffix else ss.record_to(path, "lab", recording).flush
        for tick in range(3, TICKS):
            move(tick)
            world.step()
            if tick == FLUSHED and flushed is not None:
                flush()
                flushed("stored")
        if flushed is not None:
            flushed("closing")


def _contents(path: Path, episode: int | None = None) -> dict[str, list[tuple[Any, ...]]]:
    """Returns all rows of an episode, by table."""
    with ssduck.open(path, "lab", episode) as ss:
        return {table: ss.sql(ROWS.format(table)).fetchall() for table in ("ticks", *TABLES)}


def _complete(path: Path) -> dict[int, bool | None]:
    """Returns whether episodes are complete, by number."""
    return {each.number: each.complete for each in ssduck.episodes(path)}


# -- work ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """Work on a record, and the record before.

    Attributes:
        folder: the folder of the record.
        kind: "folder" or "file".
        before: the rows of its first episode; empty if it has none.
    """

    folder: Path
    kind: str
    before: dict[str, list[tuple[Any, ...]]]

    @property
    def path(self) -> Path:
        """The record."""
        return _path(self.folder, self.kind)

    def unharmed(self) -> Iterator[str]:
        """Yields faults of the record that was there before."""
        if _contents(self.path, 0) != self.before:
            yield "the record has other rows than before"
        if _complete(self.path)[0] is not True:
            yield "the record is no longer complete"


def _export(case: Case, report: Report) -> None:
    with ssduck.open(case.path) as ss:
        report("begun")
        ss.export(case.folder / "export")


def _after_export(case: Case, _: list[str]) -> Iterator[str]:
    target = case.folder / "export"
    yield from case.unharmed()
    try:
        made = _complete(target)
    except RecordError:  # it is no record yet
        made = {}
    if made and _contents(target) != case.before:
        yield "the export has a part of the rows"
    if not all(made.values()):
        yield "the export is there and not complete"
    _export(case, lambda _: None)
    if _contents(target) != case.before:
        yield "another export has other rows"


def _close(case: Case, report: Report) -> None:
    report("begun")
    _record(_path(case.folder, case.kind).with_stem("new"), report)


def _after_close(case: Case, told: list[str]) -> Iterator[str]:
    yield from _begun(case, _path(case.folder, case.kind).with_stem("new"), 0, told)


def _begin(case: Case, report: Report) -> None:
    report("begun")
    _record(case.path, report)


def _after_begin(case: Case, told: list[str]) -> Iterator[str]:
    yield from case.unharmed()
    yield from _begun(case, case.path, 1, told)
    _record(case.path)
    if _contents(case.path) != case.before:
        yield "an episode that is recorded afterwards has other rows"


def _begun(case: Case, path: Path, number: int, told: list[str]) -> Iterator[str]:
    """Yields faults of an episode whose recorder was killed."""
    try:
        complete = _complete(path).get(number)
        rows = _contents(path, number)
    except RecordError as error:
        if "stored" in told:
            yield f"ticks were stored, but {error}"
        return
    last = max(tick for tick, *_ in rows["ticks"])
    if "stored" in told and last < FLUSHED:
        yield f"tick {FLUSHED} was stored; the last one is {last}"
    expected = {table: [row for row in of if row[0] <= last] for table, of in case.before.items()}
    if rows != expected:
        yield "the episode has other rows than those up to its last tick"
    if complete and rows != case.before:
        yield "the episode is complete, and ticks are missing"


def _open(case: Case, report: Report) -> None:
    report("begun")
    with ssduck.open(case.path) as ss:
        ss.eval("SELECT tick, id FROM lab{} WHERE collides(this, lab.arm);")
        ss.sql("SELECT count(*) FROM contacts_history").fetchall()


def _after_open(case: Case, _: list[str]) -> Iterator[str]:
    yield from case.unharmed()


def _repair(case: Case, report: Report) -> None:
    if case.kind == "folder":
        _damage(case.path)
    report("begun")
    ssduck.check(case.path, repair=True)


def _damage(path: Path) -> None:
    """Flips a bit in the middle of a part of the record."""
    file = max((path / "entities").rglob("*.parquet"))
    content = bytearray(file.read_bytes())
    content[len(content) // 3] ^= 8
    file.write_bytes(content)


def _after_repair(case: Case, _: list[str]) -> Iterator[str]:
    if case.kind == "file":
        yield from case.unharmed()
        return
    ssduck.check(case.path, repair=True)
    if ssduck.check(case.path):
        yield "another repair leaves damages"
    try:
        rows = _contents(case.path)
    except RecordError:
        return  # its only part was damaged
    if not all(set(rows[table]) <= set(before) for table, before in case.before.items()):
        yield "the repaired record has rows that were not there"


def _import(case: Case, report: Report) -> None:
    source = case.folder / "poses.mcap"
    if not source.exists():
        run = FolderRun(_folder_of(case), "lab", 0)
        write_runs([run], source, "mcap")
    report("begun")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what such a file does not tell
        ssduck.import_poses(source, _imported(case))


def _folder_of(case: Case) -> Path:
    """Returns a record in a folder, from which an MCAP file is written."""
    if case.kind == "folder":
        return case.path
    with ssduck.open(case.path) as ss:
        ss.export(case.folder / "source")
    return case.folder / "source"


def _imported(case: Case) -> Path:
    """Returns the folder of an import: a new one, or the record, which gets another episode."""
    return case.path if case.kind == "folder" else case.folder / "imported"


def _after_import(case: Case, _: list[str]) -> Iterator[str]:
    yield from case.unharmed()
    target, first = _imported(case), int(case.kind == "folder")
    try:
        made = _complete(target)
    except RecordError:  # it is no record yet
        made = {}
    made = {number: is_whole for number, is_whole in made.items() if number >= first}
    found = {number: _imported_rows(target, number) for number in made}
    _import(case, lambda _: None)
    again = max(_complete(target))
    if not all(made.values()):
        yield f"of imported episodes, some are not complete: {made}"
    if any(rows != _imported_rows(target, again) for rows in found.values()):
        yield "an import has a part of the rows"
    if len(_imported_rows(target, again)["ticks"]) != len(case.before["ticks"]):
        yield "another import has other ticks"


def _imported_rows(path: Path, number: int) -> dict[str, list[tuple[Any, ...]]]:
    """Returns all rows of an imported episode, by table; it has few of them."""
    (tables,) = (each.tables for each in ssduck.episodes(path) if each.number == number)
    with ssduck.open(path, "lab", number) as ss:
        return {table: ss.sql(ROWS.format(table)).fetchall() for table in ("ticks", *tables)}


@dataclass(frozen=True)
class Work:
    """Work on a record.

    Attributes:
        do: does it in a process, and reports when it begins.
        faults: yields what is wrong after the process was killed; is given what it reported.
        start: the report after which the process is killed.
    """

    do: Callable[[Case, Report], None]
    faults: Callable[[Case, list[str]], Iterator[str]]
    start: str = "begun"


WORK = {
    "export": Work(_export, _after_export),
    "close": Work(_close, _after_close, start="closing"),
    "open": Work(_open, _after_open),
    "begin": Work(_begin, _after_begin),
    "repair": Work(_repair, _after_repair),
    "import": Work(_import, _after_import),
}


# -- killing -------------------------------------------------------------------------------------


def _work(name: str, case: Case, pipe: Connection) -> None:
    """Does work in a process of its own."""
    WORK[name].do(case, pipe.send)
    pipe.send("done")


@dataclass
class Run:
    """Kills processes one after the other, and counts.

    Attributes:
        names: the names of the work, in turn.
        folder: the folder of the records that are copied.
        faults: the faults, by the seed.
        ended: the number of processes that ended before they were killed.
    """

    names: tuple[str, ...]
    folder: Path
    faults: dict[int, list[str]] = field(default_factory=dict)
    ended: int = 0

    def __post_init__(self) -> None:
        self._processes = multiprocessing.get_context("forkserver")
        self._processes.set_forkserver_preload(["tools.kill", "ssduck.interpreter.opening"])
        self._before: dict[str, dict[str, list[tuple[Any, ...]]]] = {}
        for kind in ("folder", "file"):
            _record(_path(self.folder, kind))
            self._before[kind] = _contents(_path(self.folder, kind))
        # The time that work takes when it is not killed, s, by its name and the kind of record.
        self._seconds: dict[tuple[str, str], float] = {}

    def add(self, seed: int) -> None:
        """Kills another process, and checks what it left."""
        name = self.names[seed % len(self.names)]
        kind = ("folder", "file")[seed // len(self.names) % 2]
        rng = random.Random(seed)  # noqa: S311
        if (name, kind) not in self._seconds:
            self._seconds[name, kind] = self._one(name, kind, None)[0]
        delay = rng.uniform(0.0, MARGIN * self._seconds[name, kind])
        _, faults = self._one(name, kind, delay)
        if faults:
            self.faults[seed] = faults
            print(f"seed {seed}, {name}, {kind}: {'; '.join(faults[:3])}", flush=True)

    def _one(self, name: str, kind: str, delay: float | None) -> tuple[float, list[str]]:
        """Does work on a copy, and kills it after some seconds; returns its time and faults."""
        work = WORK[name]
        with tempfile.TemporaryDirectory(prefix="ssduck-kill-") as folder:
            case = Case(Path(folder), kind, self._before[kind])
            source = _path(self.folder, kind)
            (shutil.copytree if kind == "folder" else shutil.copy)(source, case.path)
            receiver, sender = self._processes.Pipe(duplex=False)
            process = self._processes.Process(target=_work, args=(name, case, sender))
            process.start()
            sender.close()
            told: list[str] = []
            while work.start not in told:
                told.append(receiver.recv())
            started = time.monotonic()
            process.join(delay)
            seconds = time.monotonic() - started
            self.ended += delay is not None and process.exitcode is not None
            process.kill()
            process.join()
            while receiver.poll():
                try:
                    told.append(receiver.recv())
                except EOFError:
                    break
            if delay is None and "done" not in told:
                return seconds, ["the work fails by itself"]
            return seconds, _faults(work, case, told)


def _faults(work: Work, case: Case, told: list[str]) -> list[str]:
    try:
        return list(work.faults(case, told))
    except Exception as error:  # noqa: BLE001  # anything is a fault
        return [f"{type(error).__name__}: {error}"]


def main() -> int:
    parser = argparse.ArgumentParser(description="Kill work on records, and check what it left.")
    parser.add_argument("count", nargs="?", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0, help="the seed of the first process")
    parser.add_argument("--work", choices=list(WORK), help="only this work", default=None)
    options = parser.parse_args()
    started = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="ssduck-kill-") as folder:
        run = Run(tuple(WORK) if options.work is None else (options.work,), Path(folder))
        for number in range(options.count):
            run.add(options.seed + number)
            if (number + 1) % REPORT_EVERY == 0:
                print(f"{number + 1} killed, {len(run.faults)} with faults", flush=True)
    print(
        f"{options.count} processes in {time.monotonic() - started:.0f} s, {run.ended} ended "
        f"before they were killed; {len(run.faults)} with faults"
    )
    return 1 if run.faults else 0


if __name__ == "__main__":
    sys.exit(main())
