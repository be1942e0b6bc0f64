"""Checks that SQL and row-by-row evaluation agree on random programs.

`python -m tools.agree [COUNT] [--seed N]` prints the programs on which the two disagree, reduced
to small ones; the exit status is 1 if there are any. 100,000 programs take about 40 minutes on one
busy core.
"""

from __future__ import annotations

import argparse
import sys
import time

import ssduck
from tests.support.choices import seeded
from tests.support.evaluators import Evaluators, evaluators, shrunk
from tests.support.grammar import program

# The number of programs between two lines of progress.
REPORT_EVERY = 500


class Run:
    """The counts of a run.

    Args:
        both: the evaluators.
    """

    def __init__(self, both: Evaluators) -> None:
        self.both = both
        self.queries = self.sql = self.errors = 0
        self.differences: dict[str, str] = {}

    def add(self, seed: int) -> None:
        """Runs the program of a seed."""
        choices = seeded(seed)
        text = program(choices)
        rows = self.both.outcome(self.both.rows, text)
        self.errors += rows.error is not None
        if self.both.disagreement(text) is not None:
            smallest = shrunk(choices.taken, lambda t: self.both.disagreement(t) is not None)
            description = self.both.disagreement(smallest) or smallest
            if smallest not in self.differences:
                print(f"seed {seed}: {description}", flush=True)
            self.differences[smallest] = description
        if seed % 10 == 0 and "SELECT" in text:
            self.queries += 1
            self.sql += is_all_sql(self.both, text)


def is_all_sql(both: Evaluators, text: str) -> bool:
    """Checks whether nothing of a program's queries is left to Python."""
    both.refresh(both.sql)
    try:
        plan = both.sql.explain(text)
    except ssduck.SelectScriptError:
        return False
    return "-- left to Python" not in plan and "-- row by row" not in plan


def main() -> int:
    parser = argparse.ArgumentParser(description="Run random programs in both evaluators.")
    parser.add_argument("count", nargs="?", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0, help="the seed of the first program")
    options = parser.parse_args()
    with evaluators() as both:
        run, started = Run(both), time.monotonic()
        for number in range(options.count):
            run.add(options.seed + number)
            if (number + 1) % REPORT_EVERY == 0:
                rate = (number + 1) / (time.monotonic() - started)
                print(
                    f"{number + 1} programs, {rate:.0f}/s, {len(run.differences)} differ",
                    flush=True,
                )
    share = 100 * run.sql / max(1, run.queries)
    print(
        f"{options.count} programs in {time.monotonic() - started:.0f} s, "
        f"{run.errors} with errors, {share:.0f} % of queries SQL alone, "
        f"{len(run.differences)} differences"
    )
    return 1 if run.differences else 0


if __name__ == "__main__":
    sys.exit(main())
