"""Fixtures of the tests in this folder."""

import pytest

import ssduck
from tests.support.pasts import _falling

pybullet = pytest.importorskip("pybullet")


@pytest.fixture
def falling():
    """An interpreter on such a world; its name is `lab`, the board's `board`."""
    client, bodies = _falling()
    names = {0: "board", **{body: f"ball_{i}" for i, body in enumerate(bodies)}}
    world = ssduck.World.attach(client, names=names)
    with ssduck.Interpreter() as ss:
        ss.add_variable("lab", world)
        yield ss
    pybullet.disconnect(client)
