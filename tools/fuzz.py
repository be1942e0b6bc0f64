"""Checks that mutated programs end in a value or a `SelectScriptError`.

`python -m tools.fuzz [COUNT] [--seed N] [--jobs J]` prints the findings; 1,000,000 inputs take
about 25 minutes on two busy cores.

Each input is a mutated program of `tests/data/programs.txt`, or sometimes mutated SQL. An error
must be printable and its position must lie in the text; after it the variables must be unchanged,
and the next correct query must give the right result. Everything else is a finding: another
exception, a crash, a hang. Worker processes run the inputs and report their progress, so that the
parent can name the input of a crash or a hang. An input depends only on the seed and its number:
`--only NUMBER` repeats and prints one.
"""

from __future__ import annotations

import argparse
import sys
import time

from tools.fuzzing.bench import Bench, Finding
from tools.fuzzing.mutation import input_of
from tools.fuzzing.workers import distinct, fuzz


def main() -> int:
    """Runs inputs and prints the findings; the exit status is 1 if there are any."""
    parser = argparse.ArgumentParser(description="Run mutated programs.")
    parser.add_argument("count", nargs="?", type=int, default=10_000, help="the number of inputs")
    parser.add_argument("--seed", type=int, default=0, help="the seed of the inputs")
    parser.add_argument("--jobs", type=int, default=2, help="the number of processes")
    parser.add_argument("--only", type=int, help="print and run the input of this number alone")
    options = parser.parse_args()
    if options.only is not None:
        tested = input_of(options.seed, options.only)
        print(repr(tested.text))
        print(Bench().check(tested))
        return 0
    started = time.monotonic()
    kinds: set[tuple[str, str]] = set()

    def print_new_kind(finding: Finding) -> None:
        if (finding.kind, finding.cause) not in kinds:
            kinds.add((finding.kind, finding.cause))
            print(f"{finding}\n  {finding.trace}\n", flush=True)

    findings = fuzz(options.count, options.seed, options.jobs, print_new_kind)
    seconds = time.monotonic() - started
    print("-- each kind once, its shortest input")
    for finding, times in distinct(findings):
        print(f"{times} x {finding}")
    print(f"{options.count} inputs in {seconds:.0f} s ({options.count / seconds:.0f}/s)")
    print(f"{len(findings)} findings, {len(kinds)} kinds")
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
