"""Grids of small worlds."""

import numpy as np
import pytest

import ssduck
from ssduck.simulators.pybullet.simulator import PyBulletSimulator
from tests.support.bodies import solid

pybullet = pytest.importorskip("pybullet")

ALL = "SELECT obj FROM kitchen AS"

BALL = {"kind": pybullet.GEOM_SPHERE, "mass": 1.0, "radius": 0.3}

GROUND = {"kind": pybullet.GEOM_PLANE, "position": [0, 0, -0.5], "planeNormal": [0, 0, 1]}


class Boxes:
    """A world of boxes that cannot move, and of others: `sim` of an interpreter; named by letters."""

    def __init__(self, *boxes, others=(), owned=True):
        self.client = pybullet.connect(pybullet.DIRECT)
        pybullet.setGravity(0, 0, -9.81, physicsClientId=self.client)
        for halves, position in boxes:
            self.add(pybullet.GEOM_BOX, position, halfExtents=halves)
        for other in others:
            self.add(**other)
        names = dict(enumerate("abcdefgh"))
        self.world = ssduck.World(PyBulletSimulator(self.client, owned=owned, names=names))
        self.ss = ssduck.Interpreter()
        self.ss.add_variable("sim", self.world)

    def add(self, kind, position, mass=0.0, **size):
        solid(self.client, kind, mass, position, **size)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.ss.close()
        if pybullet.isConnected(self.client):
            pybullet.disconnect(self.client)

    def eval(self, text):
        return self.ss.eval(text)


def centres(grid, z):
    x, y = np.meshgrid(grid.centres(0), grid.centres(1), indexing="ij")
    return np.column_stack((x.ravel(), y.ravel(), np.full(x.size, z)))


TINY = 1e-6
