"""Recorded worlds for the tests of histories."""

import threading
from contextlib import contextmanager

import pytest

from tests.support.stage import Stage

pybullet = pytest.importorskip("pybullet")

ALL = ("entities", "links", "joints", "shapes", "contacts", "sensings")


def _falling(balls=2):
    """A client of PyBullet with a table that stands still and balls that fall on it."""
    stage = Stage()
    pybullet.setGravity(0, 0, -9.81, stage.client)
    stage.box("board", (0, 0, 0.45), half=[2, 2, 0.05])
    bodies = [stage.sphere(None, (i - 0.5, 0, 1), radius=0.1, mass=1) for i in range(balls)]
    return stage.client, bodies


def _step(ss, count, world="lab"):
    for _ in range(count):
        ss.call_variable(world).step()


@contextmanager
def _stepped(world):
    """While this lasts, another thread steps the world."""
    ends = threading.Event()

    def steps():
        while not ends.is_set():
            world.step()

    thread = threading.Thread(target=steps)
    thread.start()
    try:
        yield
    finally:
        ends.set()
        thread.join()
