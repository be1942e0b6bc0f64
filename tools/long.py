"""Runs the tests that generate their cases, with many times as many of them.

`python -m tools.long [FACTOR] [ARGUMENT ...]` hands the arguments to pytest; without any, it runs
all test files that call `generated`. The exit status is pytest's.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

import pytest

from tests.support.cases import FACTOR

TESTS = Path(__file__).resolve().parents[1] / "tests"


def files() -> list[str]:
    """Returns the test files that generate cases."""
    paths = sorted(TESTS.rglob("test_*.py"))
    return [str(path) for path in paths if "generated(" in path.read_text(encoding="utf-8")]


def main() -> int:
    parser = argparse.ArgumentParser(description="Run generated tests with more cases.")
    parser.add_argument("factor", nargs="?", type=int, default=10)
    options, arguments = parser.parse_known_args()
    os.environ[FACTOR] = str(options.factor)
    return pytest.main(arguments or files())


if __name__ == "__main__":
    sys.exit(main())
