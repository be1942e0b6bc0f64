"""Parametrization of which a sample is run each time, and the numbers of generated cases."""

import os
from collections import defaultdict
from itertools import combinations

import pytest

# `make long` sets it: so many times the generated cases.
FACTOR = "SSDUCK_TEST_FACTOR"


def factor():
    """Returns how many times as many cases a test generates as it does in `make test`."""
    return int(os.environ.get(FACTOR, "1"))


def generated(count):
    """Returns how many cases a test generates: `count`, or so many times as many in `make long`."""
    return count * factor()


def sampled(names, cases, *, every, **options):
    """Returns `pytest.mark.parametrize`; of `every` successive cases the first is run each time.

    The others repeat with other data what it shows: they are marked `long`.
    """
    is_single = isinstance(names, str) and "," not in names
    marked = list(cases)
    if every > len(marked):
        raise ValueError(
            f"only the first of {len(marked)} cases is run: let every be {len(marked)}"
        )
    for number, case in enumerate(marked):
        if number % every:
            if isinstance(case, type(pytest.param())):
                marked[number] = case._replace(marks=[*case.marks, pytest.mark.long])
            else:
                values = [case] if is_single else case
                marked[number] = pytest.param(*values, marks=pytest.mark.long)
    return pytest.mark.parametrize(names, marked, **options)


def mark_all_but_pairs(items):
    """Marks cases of tests that are marked `pairwise` as `long`: all but few.

    Those few have each pair of values of two parameters of the test.
    """
    tests = defaultdict(dict)
    for item in items:
        if item.get_closest_marker("pairwise"):
            name = item.nodeid.partition("[")[0]
            tests[name].setdefault(tuple(item.callspec.indices.values()), []).append(item)
    for cases in tests.values():
        for indices in cases.keys() - covering(cases):
            for item in cases[indices]:
                item.add_marker(pytest.mark.long)


def covering(cases):
    """Returns few of the cases, tuples of indices, that have each pair which any of them has.

    Each next one is the one that has the most new pairs, the first of several.
    """
    pairs = {case: set(combinations(enumerate(case), 2)) or {case} for case in cases}
    missing, chosen = set().union(*pairs.values()), set()
    while missing:
        best = max(pairs, key=lambda case: len(pairs[case] & missing))
        chosen.add(best)
        missing -= pairs[best]
    return chosen
