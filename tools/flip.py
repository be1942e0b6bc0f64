"""Checks that a damaged record gives the right answers, or an error.

`python -m tools.flip [COUNT] [--seed N]` damages COUNT copies of small records: folders
and DuckDB files, closed ones and ones whose recorder was killed. 2,000 take about 15 minutes on two
busy cores. The exit status is 1 if there are faults.

Of ten damages, eight are a flipped bit of a random file, one is a file that is cut off, and one is
a file that is missing. Other processes open the copies and ask for all rows, and for relations at
all ticks. Each answer must be that of the record before, or a `RecordError`; a process that crashes
or takes too long is a fault. A record whose recorder was killed may lack its last ticks, as if it
had been killed earlier.
"""

from __future__ import annotations

import argparse
import json
import pickle
import random
import select
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import ssduck
from ssduck import Recording
from ssduck.errors import RecordError, SqlError
from tools import kill

RECORDS = ("run", "unfinished", "run.duckdb", "unfinished.duckdb")
TICKS = 40
# The time that opening a record and asking it may take, s.
TIMEOUT = 60.0
# The number of damages between two lines of progress.
REPORT_EVERY = 100
QUERIES = {
    **{table: f"FROM {table}_history ORDER BY ALL" for table in ("ticks", *kill.TABLES)},
    "models": "SELECT 0, * FROM shapes_model ORDER BY ALL",
    "pairs": "SELECT tick, id FROM lab{} WHERE collides(this, lab.arm) OR above(lab.arm, this);",
    "poses": "SELECT tick, id, position, orientation FROM lab{};",
    "near": "SELECT tick, id, clearance(this, lab.arm) FROM lab{} WHERE near(this, lab.arm, 2);",
}


# -- the records ------------------------------------------------------------------------------


def write_records(place: Path) -> None:
    """Writes the records to a folder: of each kind, one that is closed, and one as at a kill."""
    world, move = kill.new_world(random.Random(1))  # noqa: S311  # no secret
    recording = Recording(tables=kill.TABLES, flush_every=0.05)
    with ssduck.Interpreter(place / "run.duckdb", recording=recording) as ss:
        ss.add_variable("lab", world)
        with ss.record_to(place / "run", "lab", recording) as writing:
            for tick in range(TICKS):
                if tick in (10, 20, 30):
                    writing.flush()
                    writing._folder.complete()  # noqa: SLF001  # a part, though it is small
                if tick == 20:
                    _checkpoint(ss)
                if tick == 35:
                    log = place / "run" / "log"
                    while len(list(log.rglob("*.arrow"))) < 1:
                        time.sleep(0.02)
                    ss.flush()
                    shutil.copytree(place / "run", place / "unfinished")
                    for suffix in ("", ".wal"):
                        shutil.copy(
                            place / f"run.duckdb{suffix}", place / f"unfinished.duckdb{suffix}"
                        )
                move(world.snapshot.number + 1)
                world.step()


def _checkpoint(ss: ssduck.Interpreter) -> None:
    """Checkpoints the database at a moment at which no ticks are being stored."""
    for _ in range(200):
        try:
            ss.sql("CHECKPOINT")
        except SqlError as error:
            if "CHECKPOINT" not in error.message:
                raise
            time.sleep(0.02)
        else:
            return
    raise TimeoutError("ticks are being stored all the time")


def files_of(record: Path) -> list[Path]:
    """Returns the files of a record."""
    if record.is_dir():
        return sorted(file for file in record.rglob("*") if file.is_file())
    log = record.with_name(f"{record.name}.wal")
    return [record, *([log] if log.exists() else ())]


def copy_of(record: Path, folder: Path) -> Path:
    """Copies a record to a folder."""
    if record.is_dir():
        return Path(shutil.copytree(record, folder / record.name))
    for file in files_of(record):
        shutil.copy(file, folder / file.name)
    return folder / record.name


def damage(record: Path, rng: random.Random) -> str:
    """Damages a record; returns what was done."""
    files = files_of(record)
    # Small files matter as much as large ones.
    weights = [file.stat().st_size ** 0.5 + 1 for file in files]
    (file,) = rng.choices(files, weights)
    name, size = str(file.relative_to(record.parent)), file.stat().st_size
    kind = rng.random()
    if kind < 0.1:
        file.unlink()
        return f"{name} is missing"
    if kind < 0.2:
        length = rng.randrange(size)
        file.write_bytes(file.read_bytes()[:length])
        return f"{name} is cut off after {length} of {size} bytes"
    content, position, bit = bytearray(file.read_bytes()), rng.randrange(size), rng.randrange(8)
    content[position] ^= 1 << bit
    file.write_bytes(content)
    return f"bit {bit} of byte {position} of {size} of {name} is flipped"


# -- the process that opens them --------------------------------------------------------------


def answers(record: Path) -> dict[str, Any]:
    """Returns the answer of a record to each query, or its error."""
    found: dict[str, Any] = {}

    def keep(name: str, ask: Any) -> None:
        try:
            found[name] = ask()
        except Exception as error:  # noqa: BLE001  # all kinds are compared
            found[name] = _Failure(type(error).__name__, str(error), isinstance(error, RecordError))

    keep("episodes", lambda: [(e.world, e.number, e.complete) for e in ssduck.episodes(record)])
    try:
        ss = ssduck.open(record)
    except Exception as error:  # noqa: BLE001
        failure = _Failure(type(error).__name__, str(error), isinstance(error, RecordError))
        return found | {"open": failure}
    with ss:
        keep("past", lambda: [(tick,) for tick in ss.past("lab").ticks])
        for name, query in QUERIES.items():
            ask = ss.eval if query.endswith(";") else ss.sql
            keep(name, lambda ask=ask, query=query: _rows(ask(query)))
    return found


@dataclass(frozen=True)
class _Failure:
    """An error: the name of its class, its message, and whether it is a `RecordError`."""

    kind: str
    message: str
    is_own: bool


def _rows(result: Any) -> list[tuple[Any, ...]]:
    if hasattr(result, "fetchall"):
        return [(*map(repr, row[1:]), row[0]) for row in result.fetchall()]
    return [(repr(row), row["tick"]) for row in result]


def judge(expected: dict[str, Any], record: Path) -> tuple[str, list[str]]:
    """Compares a record's answers; returns "right", "early" or "error", and the faults.

    Args:
        expected: the right answers.
        record: the record.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = answers(record)
    outcome, faults = "right", []
    is_killed = record.name.startswith("unfinished")
    last = None
    past = found.get("past")
    if is_killed and isinstance(past, list) and past != expected["past"]:
        last, outcome = max(tick for (tick,) in past), "early"
    for name, value in found.items():
        if isinstance(value, _Failure):
            outcome = "error"
            if not value.is_own:
                faults.append(f"{name} fails with {value.kind}: {value.message[:300]}")
        elif name == "models" and last is not None:  # of bodies that came later
            faults += [] if set(value) <= set(expected[name]) else ["models is wrong"]
        elif value != _until(expected[name], last, name):
            faults.append(f"{name} is wrong")
    return outcome, faults


def _until(rows: list[tuple[Any, ...]], last: int | None, name: str) -> list[tuple[Any, ...]]:
    """Returns the rows until a tick, which each row has at its end."""
    if last is None or name == "episodes":
        return rows
    return [row for row in rows if row[-1] <= last]


def serve(expected_file: str) -> None:
    """Judges the records whose paths are on standard input, a line each."""
    expected = pickle.loads(Path(expected_file).read_bytes())  # noqa: S301  # our own
    for line in sys.stdin:
        record = Path(line.rstrip("\n"))
        try:
            outcome, faults = judge(expected[record.name], record)
        except Exception:  # noqa: BLE001
            outcome, faults = "wrong", [traceback.format_exc()]
        sys.stdout.write(json.dumps([outcome, faults]) + "\n")
        sys.stdout.flush()


class Judge:
    """A process that judges records, and is started again when it crashes or hangs.

    Args:
        expected: the file of the right answers.
    """

    def __init__(self, expected: Path) -> None:
        self._expected = expected
        self._process: subprocess.Popen[str] | None = None

    def __call__(self, record: Path) -> tuple[str, list[str]]:
        """Returns the outcome and the faults of a record."""
        if self._process is None:
            code = f"from tools.flip import serve; serve({str(self._expected)!r})"
            self._process = subprocess.Popen(  # noqa: S603
                [sys.executable, "-c", code],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(f"{record}\n")
        process.stdin.flush()
        if not select.select([process.stdout], [], [], TIMEOUT)[0]:
            self.close()
            return "wrong", [f"it takes more than {TIMEOUT:g} s"]
        line = process.stdout.readline()
        if not line:
            self.close()
            return "wrong", [f"the process crashed with {process.returncode}"]
        outcome, faults = json.loads(line)
        return outcome, faults

    def close(self) -> None:
        """Ends the process."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


# -- the run ----------------------------------------------------------------------------------


@dataclass
class Run:
    """Damages records one after the other, and counts.

    Attributes:
        place: the folder of the whole records.
        outcomes: the number of records with each outcome.
        faults: the faults of records, by the seed.
    """

    place: Path
    outcomes: Counter[str] = field(default_factory=Counter)
    faults: dict[int, list[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        write_records(self.place)
        expected = {name: answers(self.place / name) for name in RECORDS}
        failed = [a for each in expected.values() for a in each.values() if isinstance(a, _Failure)]
        if failed:
            raise RuntimeError(f"a whole record fails: {failed[0]}")
        file = self.place / "expected.pickle"
        file.write_bytes(pickle.dumps(expected))
        self._judge = Judge(file)

    def add(self, seed: int) -> None:
        """Damages a copy of a record, and judges it."""
        rng = random.Random(seed)  # noqa: S311
        name = RECORDS[seed % len(RECORDS)]
        with tempfile.TemporaryDirectory(prefix="ssduck-flip-") as folder:
            record = copy_of(self.place / name, Path(folder))
            told = damage(record, rng)
            outcome, faults = self._judge(record)
        self.outcomes[f"{'DuckDB' if name.endswith('.duckdb') else 'folder'}, {outcome}"] += 1
        if faults:
            self.faults[seed] = faults
            print(f"seed {seed}: {told}: {'; '.join(faults[:3])}", flush=True)

    def close(self) -> None:
        """Ends the process that judges."""
        self._judge.close()


def main() -> int:
    parser = argparse.ArgumentParser(description="Damage records, and ask them.")
    parser.add_argument("count", nargs="?", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0, help="the seed of the first damage")
    options = parser.parse_args()
    started = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="ssduck-flip-") as folder:
        run = Run(Path(folder))
        for number in range(options.count):
            run.add(options.seed + number)
            if (number + 1) % REPORT_EVERY == 0:
                print(f"{number + 1} damaged, {len(run.faults)} with faults", flush=True)
        run.close()
    outcomes = ", ".join(f"{name}: {count}" for name, count in sorted(run.outcomes.items()))
    print(
        f"{options.count} damaged in {time.monotonic() - started:.0f} s, {len(run.faults)} with "
        f"faults; {outcomes}"
    )
    return 1 if run.faults else 0


if __name__ == "__main__":
    sys.exit(main())
