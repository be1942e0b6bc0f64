"""Parametrization of which the fast tests run a sample, and the numbers of generated cases."""

from __future__ import annotations

import os

import pytest

# `python -m tools.long` sets it: so many times the generated cases.
FACTOR = "SSDUCK_TEST_FACTOR"


def generated(count):
    """Returns how many cases a test generates: `count`, or more in `python -m tools.long`."""
    return count * int(os.environ.get(FACTOR, "1"))


def sampled(names, cases, *, every, **options):
    """Returns `pytest.mark.parametrize`; of `every` successive cases the first stays fast.

    The others are marked `slow`.
    """
    is_single = isinstance(names, str) and "," not in names
    marked = list(cases)
    for number, case in enumerate(marked):
        if number % every:
            if isinstance(case, type(pytest.param())):
                marked[number] = case._replace(marks=[*case.marks, pytest.mark.slow])
            else:
                values = [case] if is_single else case
                marked[number] = pytest.param(*values, marks=pytest.mark.slow)
    return pytest.mark.parametrize(names, marked, **options)
