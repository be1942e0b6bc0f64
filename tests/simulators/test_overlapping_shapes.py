"""Compounds whose shapes overlap: `inside` counts the common part twice, and says so once."""

import numpy as np
import pybullet
import pytest

import ssduck
from tests.support.bodies import solid
from tests.support.warned import heard

TOLD = "shapes of compound overlap, and inside counts"


def attached(client, apart):
    """Two boxes of 0.2 m so far apart along x, from 0.3 m on, at the wall of a box at 0.5 m."""
    here = {"physicsClientId": client}
    shape = pybullet.createCollisionShapeArray(
        shapeTypes=[pybullet.GEOM_BOX] * 2,
        halfExtents=[[0.1] * 3] * 2,
        collisionFramePositions=[[0, 0, 0], [apart, 0, 0]],
        **here,
    )
    names = {
        solid(client, pybullet.GEOM_BOX, halfExtents=[0.5] * 3): "bin",
        pybullet.createMultiBody(1, shape, basePosition=[0.4, 0, 0], **here): "compound",
    }
    return ssduck.World.attach(client, names=names)


def true_share(client):
    """The share of the volume inside, by slices of the shapes that PyBullet tells, along x."""
    x = np.linspace(0, 1, 100_001)
    starts = [
        0.4 + entry[5][0] - entry[3][0] / 2
        for entry in pybullet.getCollisionShapeData(1, -1, physicsClientId=client)
    ]
    filled = np.any([(x > start) & (x < start + 0.2) for start in starts], axis=0)
    return float((filled & (x < 0.5)).sum() / filled.sum())


def answer_and_told(ss):
    return heard(lambda: ss.eval("inside(sim.bin, sim.compound);"), TOLD)


@pytest.mark.slow
@pytest.mark.parametrize("apart", [0.1, 0.05, 0.19, 0.2, 0.3])
def test_overlaps_that_count_twice_are_told_of_once(client, apart):
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", attached(client, apart))
        answer, messages = answer_and_told(ss)
        share = max(0.0, (0.2 - apart) / 0.4)
        assert abs(answer - true_share(client)) <= share + 1e-3
        assert len(messages) == (share > 0.05)
        assert all(f"{share:.0%} of their volume twice" in message for message in messages)
        assert answer_and_told(ss) == (answer, [])
