"""Runs what takes too long for each change: the `long` tests, and short forms of the long checks.

`python -m tools.long [NAME ...]`, which is `make long`, runs what is named, or all; it takes about
an hour on two cores. It prints a line for each, and ends with the exit status 1 if any failed; what
they print goes to a folder. `--write` puts the lines into tools/README.md.

The tests are those that are marked `long` and those that generate their cases, with `--factor`
times as many. The seeds of the other checks are of the day, so that each night tries other cases.
"""

from __future__ import annotations

import argparse
import datetime as dt
import os
import re
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from tests.support.cases import FACTOR

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "tools" / "README.md"
TABLE = re.compile(r"(?<=<!-- make long -->\n).*?(?=<!-- -->)", re.DOTALL)
TESTS = "tests"
# The checks, with arguments of which each takes a few minutes of one core.
CHECKS = {
    "agree": ("8000",),
    "fuzz": ("40000", "--jobs", "1"),
    "fuzz_scenes": ("3",),
    "oracles": ("4000",),
    "kill": ("20", "--slack", "3"),
    "kill_work": ("24",),
    "flip": ("200",),
    "lake": ("flip", "24"),
    "episodes": ("40", "--resets", "60"),
    "replay": ("20",),
    "check_live": ("200",),
    "check_why": ("500",),
    "soak": ("50000",),
    "cleanup": ("1",),
}


@dataclass(frozen=True)
class Outcome:
    """How a command ended.

    Args:
        command: what was run.
        status: its exit status.
        told: the last line that it printed.
        seconds: how long it took.
    """

    command: str
    status: int
    told: str
    seconds: float

    def row(self) -> str:
        """Returns the outcome as a row of the table."""
        day = dt.datetime.now(dt.UTC).strftime("%-d %B %Y")
        verdict = "passed" if self.status == 0 else f"**failed ({self.status})**"
        told = self.told.strip("= ").replace("|", "\\|")
        return f"| `{self.command}` | {day} | {verdict}: {told} | {self.seconds / 60:.1f} min |"


def run(arguments: list[str], log: Path, **environment: str) -> Outcome:
    """Runs a module of Python with arguments; what it prints goes to `log`."""
    begin = time.monotonic()
    with log.open("w", encoding="utf-8") as file:
        status = subprocess.run(  # noqa: S603
            [sys.executable, "-m", *arguments],
            cwd=ROOT,
            env={**os.environ, **environment},
            stdout=file,
            stderr=subprocess.STDOUT,
            check=False,
        ).returncode
    lines = log.read_text(encoding="utf-8", errors="replace").split("\n")
    told = next((line for line in reversed(lines) if line.strip()), "")
    outcome = Outcome(f"python -m {' '.join(arguments)}", status, told, time.monotonic() - begin)
    print(outcome.row(), flush=True)
    return outcome


def run_tests(factor: int, logs: Path) -> Outcome:
    """Runs the long tests, and those that generate their cases."""
    arguments = ["pytest", "-q", "-m", "long or hypothesis or generated"]
    return run(arguments, logs / "tests.txt", **{FACTOR: str(factor)})


def run_checks(names: list[str], seed: int, logs: Path) -> list[Outcome]:
    """Runs checks, one on each core."""

    def checked(name: str) -> Outcome:
        seeded = () if name == "soak" else ("--seed", str(seed))
        return run([f"tools.{name}", *CHECKS[name], *seeded], logs / f"{name}.txt")

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(checked, names))


def write(outcomes: list[Outcome]) -> None:
    """Puts the outcomes into the page."""
    rows = "\n".join(outcome.row() for outcome in outcomes)
    table = f"\n| command | date | result | time |\n|---|---|---|---|\n{rows}\n\n"
    PAGE.write_text(TABLE.sub(lambda _: table, PAGE.read_text(encoding="utf-8")), encoding="utf-8")


def main() -> int:
    parser = argparse.ArgumentParser(description="Run the long tests and checks.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join([TESTS, *CHECKS]))
    parser.add_argument("--factor", type=int, default=4, help="so many times the generated cases")
    parser.add_argument("--seed", type=int, default=dt.date.today().toordinal() * 1000)  # noqa: DTZ011
    parser.add_argument(
        "--write", action="store_true", help="write the results into tools/README.md"
    )
    options = parser.parse_args()
    names = options.names or [TESTS, *CHECKS]
    if unknown := set(names) - {TESTS, *CHECKS}:
        known = ", ".join([TESTS, *CHECKS])
        parser.error(f"no check is named {', '.join(sorted(unknown))}; there are {known}")
    logs = Path(tempfile.mkdtemp(prefix="ssduck-long-"))
    print(f"what the commands print is in {logs}", flush=True)
    outcomes = [run_tests(options.factor, logs)] if TESTS in names else []
    outcomes += run_checks([name for name in names if name != TESTS], options.seed, logs)
    if options.write:
        write(outcomes)
    return int(any(outcome.status for outcome in outcomes))


if __name__ == "__main__":
    sys.exit(main())
