"""Recorded worlds for the tests of histories."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

import ssduck

pybullet = pytest.importorskip("pybullet")

ALL = ("entities", "links", "joints", "shapes", "contacts", "sensings")


def _falling(balls: int = 2) -> tuple[int, list[int]]:
    """A client of PyBullet with a table that stands still and balls that fall on it."""
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setGravity(0, 0, -9.81, client)
    board = pybullet.createCollisionShape(
        pybullet.GEOM_BOX, halfExtents=[2, 2, 0.05], physicsClientId=client
    )
    pybullet.createMultiBody(0, board, basePosition=[0, 0, 0.45], physicsClientId=client)
    ball = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.1, physicsClientId=client)
    bodies = [
        pybullet.createMultiBody(1, ball, basePosition=[i - 0.5, 0, 1], physicsClientId=client)
        for i in range(balls)
    ]
    return client, bodies


def _step(ss: ssduck.Interpreter, count: int, world: str = "lab") -> None:
    for _ in range(count):
        ss.call_variable(world).step()


@contextmanager
def _stepped(world: ssduck.World) -> Iterator[None]:
    """While this lasts, another thread steps the world."""
    ends = threading.Event()

    def steps() -> None:
        while not ends.is_set():
            world.step()

    thread = threading.Thread(target=steps)
    thread.start()
    try:
        yield
    finally:
        ends.set()
        thread.join()
