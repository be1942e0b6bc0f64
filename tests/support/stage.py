"""A PyBullet client that tests fill with shapes, and queries about its world."""

import pytest

import ssduck
from tests.support.bodies import solid

pybullet = pytest.importorskip("pybullet")

BOX, SPHERE, PLANE = pybullet.GEOM_BOX, pybullet.GEOM_SPHERE, pybullet.GEOM_PLANE


class Stage:
    """A PyBullet client that tests fill with shapes; its world, and interpreters of both kinds."""

    def __init__(self, client=None):
        self.client = pybullet.connect(pybullet.DIRECT) if client is None else client
        self.names = {}
        self.interpreters_to_close = []

    def add(self, name, kind, position=(0, 0, 0), turn=(0, 0, 0, 1), mass=0.0, **size):
        body = solid(self.client, kind, mass, position, turn, **size)
        self.names[body] = name
        return body

    def box(self, name, position=(0, 0, 0), half=0.5, **more):
        halves = [half] * 3 if isinstance(half, float) else half
        return self.add(name, BOX, position, halfExtents=halves, **more)

    def sphere(self, name, position=(0, 0, 0), radius=0.5, **more):
        return self.add(name, SPHERE, position, radius=radius, **more)

    def urdf(self, name, path, position=(0, 0, 0)):
        body = pybullet.loadURDF(str(path), position, physicsClientId=self.client)
        self.names[body] = name
        return body

    def open(self):
        return ssduck.World.attach(self.client, names=self.names)

    def interpreters(self, **worlds):
        """Yields one that uses SQL and one row by row, with a variable for each entity."""
        for row_by_row in (False, True):
            ss = ssduck.Interpreter(row_by_row=row_by_row)
            self.interpreters_to_close.append(ss)
            for name, world in worlds.items():
                ss.add_variable(name, world)
            for entity in next(iter(worlds.values())):
                ss.add_variable(entity.name, entity)
            yield ss

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        for ss in self.interpreters_to_close:
            ss.close()
        if pybullet.isConnected(self.client):
            pybullet.disconnect(self.client)


def pairs_of(ss, condition):
    """Returns the pairs of names for which a condition on rows p and q holds, in raw SQL."""
    rows = ss.sql(f"SELECT p.name, q.name FROM entities p, entities q WHERE {condition}")
    return sorted(rows.fetchall())
