"""Fixtures of the tests in this folder."""

import numpy as np
import pytest

import ssduck
from ssduck.adapters.grid_values import OccupancyGrid


@pytest.fixture(scope="module")
def kitchen():
    with ssduck.load("kitchen") as ss:
        ss.call_variable("kitchen").step(2)
        yield ss


@pytest.fixture
def grid():
    cells = np.zeros((4, 3), bool)
    cells[1, 0] = cells[3, 2] = True
    return OccupancyGrid(cells, (-1.0, 2.0), 0.5, 0.22)
