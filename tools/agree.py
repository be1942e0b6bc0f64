"""Checks that SQL and row-by-row evaluation agree on random programs.

`python -m tools.agree [COUNT] [--seed N]` prints the programs on which the two disagree, reduced
to small ones; the exit status is 1 if there are any. 100,000 programs take about 40 minutes on one
busy core.
"""

from __future__ import annotations

import argparse
import sys
import time

from tests.support.grammar import Evaluators, evaluators, program, seeded, shrunk

EACH = 500


class Run:
    """The counts of a run.

    Args:
        both: the evaluators.
    """

    def __init__(self, both: Evaluators) -> None:
        self.both = both
        self.queries = self.sql = self.errors = 0
        self.found: dict[str, str] = {}

    def add(self, seed: int) -> None:
        """Runs the program of a seed."""
        choices = seeded(seed)
        text = program(choices)
        rows = self.both.outcome(self.both.rows, text)
        self.errors += rows.error is not None
        if self.both.disagreement(text) is not None:
            small = shrunk(choices.taken, lambda t: self.both.disagreement(t) is not None)
            told = self.both.disagreement(small) or small
            if small not in self.found:
                print(f"seed {seed}: {told}", flush=True)
            self.found[small] = told
        if seed % 10 == 0 and "SELECT" in text:
            self.queries += 1
            self.sql += self.both.is_all_sql(text)


def main() -> int:
    parser = argparse.ArgumentParser(description="Run random programs in both evaluators.")
    parser.add_argument("count", nargs="?", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0, help="the first program's")
    given = parser.parse_args()
    with evaluators() as both:
        run, started = Run(both), time.monotonic()
        for number in range(given.count):
            run.add(given.seed + number)
            if (number + 1) % EACH == 0:
                rate = (number + 1) / (time.monotonic() - started)
                print(f"{number + 1} programs, {rate:.0f}/s, {len(run.found)} differ", flush=True)
    share = 100 * run.sql / max(1, run.queries)
    print(
        f"{given.count} programs in {time.monotonic() - started:.0f} s, {run.errors} with errors, "
        f"{share:.0f} % of queries SQL alone, {len(run.found)} differences"
    )
    return 1 if run.found else 0


if __name__ == "__main__":
    sys.exit(main())
