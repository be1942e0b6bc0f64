"""Parametrization of which a sample is run each time, and the numbers of generated cases."""

from __future__ import annotations

import os
from itertools import combinations, product

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
    cases = list(cases)
    chosen = range(0, len(cases), every)
    marked = [_case(names, case, number in chosen) for number, case in enumerate(cases)]
    return pytest.mark.parametrize(names, marked, **options)


def pairwise(names, *values, **options):
    """Returns `pytest.mark.parametrize` of all combinations of values, of which few are run each time.

    Those few have each pair of values of two parameters; the others are marked `long`.

    Args:
        names: the parameters, with commas between them.
        *values: the values of each; a value that `pytest.param` marks gives its marks to all cases
            that have it.
    """
    chosen = _covering([range(len(each)) for each in values])
    marked = []
    for indices in product(*(range(len(each)) for each in values)):
        picked = [_plain(each[index]) for each, index in zip(values, indices, strict=True)]
        marks = [mark for _, own in picked for mark in own]
        case = pytest.param(*(value for value, _ in picked), marks=marks)
        marked.append(_case(names, case, indices in chosen))
    return pytest.mark.parametrize(names, marked, **options)


def _plain(value):
    is_marked = isinstance(value, type(pytest.param()))
    return (value.values[0], value.marks) if is_marked else (value, ())


def _case(names, case, is_chosen):
    if is_chosen:
        return case
    if isinstance(case, type(pytest.param())):
        return case._replace(marks=[*case.marks, pytest.mark.long])
    is_single = isinstance(names, str) and "," not in names
    return pytest.param(*([case] if is_single else case), marks=pytest.mark.long)


def _covering(axes):
    """Few combinations with each pair of values of two axes: each next one has the most new pairs."""

    def pairs(indices):
        return set(combinations(enumerate(indices), 2))

    every = {indices: pairs(indices) for indices in product(*axes)}
    missing = set().union(*every.values())
    chosen = set()
    while missing:
        best = max(every, key=lambda indices: len(every[indices] & missing))
        chosen.add(best)
        missing -= every[best]
    return chosen or set(every)
