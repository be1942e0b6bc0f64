"""Grids stop when the time of a program is up."""

import time
from itertools import pairwise

import pytest

import ssduck
from ssduck.errors import LimitError
from ssduck.limits import UsageMeter
from tests.support.cases import sampled

LARGE = [
    "SELECT obj FROM kitchen WHERE isSensor(this) AS sensorgrid(0.24, 0.002);",
    "SELECT obj FROM kitchen AS voxelgrid(0.01);",
]


@pytest.mark.slow
@sampled("program", LARGE, every=2)
def test_a_large_grid_stops_at_the_next_check(program, monkeypatch):
    """A step of the work between two checks is small: the time is up at the fifth check."""
    checks = []

    def check_time(meter):
        checks.append(time.process_time())
        if len(checks) == 5:
            raise LimitError("the time is up")

    with ssduck.load("kitchen", limits=ssduck.Limits(seconds=600.0), recording=None) as ss:
        ss.eval("SELECT obj FROM kitchen AS voxelgrid(1);")  # shapes are built
        monkeypatch.setattr(UsageMeter, "check_time", check_time)
        with pytest.raises(LimitError, match="the time is up"):
            ss.eval(program)
    assert len(checks) == 5
    assert max(after - before for before, after in pairwise(checks)) < 5.0
