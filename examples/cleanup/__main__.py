"""Cleans up the table of the kitchen; `python -m examples.cleanup --help` tells the options."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import ssduck
from examples.cleanup.program import clean
from examples.cleanup.recorded import record


def main() -> bool:
    """Runs the program; returns whether all cups are in the sink."""
    parser = argparse.ArgumentParser(
        prog="python -m examples.cleanup",
        description="A robot plans how to take the kitchen's cups to the sink, and does so.",
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="the seed of the planners (0)"
    )
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="draw pictures into a folder")
    parser.add_argument(
        "--record",
        type=Path,
        metavar="FOLDER",
        help="write the run as a small record, which `ssduck demo cleanup` can tell",
    )
    options = parser.parse_args()
    with ssduck.load("kitchen") as ss:
        if options.record is None:
            return clean(ss, options.out, print, seed=options.seed).succeeded
        return record(ss, options.out, print, options.record, seed=options.seed).succeeded


if __name__ == "__main__":
    sys.exit(not main())
