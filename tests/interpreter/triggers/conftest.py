"""Fixtures of the tests in this folder."""

import pytest

import ssduck
from tests.support.triggering import falling

pybullet = pytest.importorskip("pybullet")


@pytest.fixture
def told():
    """The statements that `ss` sends to DuckDB."""
    return []


@pytest.fixture
def ss(told):
    with ssduck.Interpreter(tracer=told.append) as interpreter:
        yield interpreter


@pytest.fixture
def sim(ss, client):
    """A world with a ball that falls, 240 steps a second."""
    return ss.add_variable("sim", falling(client))


@pytest.fixture
def other(ss):
    """A second world, 100 steps a second."""
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setTimeStep(0.01, client)
    yield ss.add_variable("other", falling(client))
    pybullet.disconnect(client)
