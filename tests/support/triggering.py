"""Falling balls and callbacks for the tests of triggers."""

import time

import pytest

import ssduck
from tests.support.bodies import solid
from tests.support.timing import HANGS

pybullet = pytest.importorskip("pybullet")


def falling(client):
    """A ball that falls; nothing below it."""
    pybullet.setGravity(0, 0, -10, physicsClientId=client)
    ball = solid(client, pybullet.GEOM_SPHERE, 1, [0, 0, 10.0], radius=0.1)
    return ssduck.World.attach(client, names={ball: "ball"})


def state(ss, name):
    (found,) = [state for state in ss.triggers() if state.name == name]
    return found


class Times(list):
    """A callback that takes down when it was called."""

    def __init__(self, world):
        super().__init__()
        self.world = world

    def __call__(self, result):
        self.append(round(self.world.time, 9))


HEIGHT = "SELECT z FROM sim WHERE id(this) == 'ball' AS value;"

NAN = float("nan")


def until(condition):
    end = time.monotonic() + HANGS
    while not condition():
        assert time.monotonic() < end, "it does not happen"
        time.sleep(0.001)
