"""Tests how contact points of PyBullet become arrays."""

import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.simulators.interface import ContactPoints
from ssduck.simulators.pybullet import readings
from ssduck.world.rows import contact_rows

SPHERE, BOX = pybullet.GEOM_SPHERE, pybullet.GEOM_BOX


@pytest.fixture
def pile():
    """A client with a box, and a sphere on it, after a second."""
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setGravity(0, 1.0, -9.81, physicsClientId=client)
    box = pybullet.createCollisionShape(BOX, halfExtents=[1, 1, 0.1], physicsClientId=client)
    ball = pybullet.createCollisionShape(SPHERE, radius=0.1, physicsClientId=client)
    pybullet.createMultiBody(0, box, physicsClientId=client)
    for place in ((0, 0, 0.2), (0.5, 0, 0.2), (0.5, 0, 0.39)):
        pybullet.createMultiBody(1, ball, basePosition=place, physicsClientId=client)
    for _ in range(60):
        pybullet.stepSimulation(client)
    yield client
    pybullet.disconnect(client)


def _read(client):
    known = {pybullet.getBodyUniqueId(n, client) for n in range(pybullet.getNumBodies(client))}
    return readings.PyBulletContacts.read(client, known)[0].all()


def test_points_equal_those_of_pybullet(pile):
    expected = [p for p in pybullet.getContactPoints(physicsClientId=pile) if p[8] <= 0 or p[9] > 0]
    read = _read(pile)
    assert len(read) == len(expected) >= 2
    assert read.bodies.tolist() == [[p[1], p[2]] for p in expected]
    assert read.links.tolist() == [[p[3] + 1, p[4] + 1] for p in expected]
    assert read.points.tolist() == [[list(p[5]), list(p[6])] for p in expected]
    assert read.normals.tolist() == [list(p[7]) for p in expected]
    assert (-read.depths).tolist() == [p[8] for p in expected]
    assert read.forces.tolist() == [p[9] for p in expected]
    friction = [
        [p[10] * along + p[12] * across for along, across in zip(p[11], p[13], strict=True)]
        for p in expected
    ]
    assert read.frictions.tolist() == friction


def test_no_points(pile):
    pybullet.resetSimulation(physicsClientId=pile)
    read = _read(pile)
    assert (len(read), read.points.shape, read.bodies.shape) == (0, (0, 2, 3), (0, 2))


@pytest.mark.parametrize("count", [1, 30])
def test_rows_are_those_of_a_loop_in_python(count):
    """Few different numbers, so that points and sides coincide."""
    draws = np.random.default_rng(count)
    numbers = [0.0, -0.0, 1.0, 0.3, -2.5]
    for _ in range(20):
        points = ContactPoints(
            draws.integers(0, 3, (count, 2)),
            draws.integers(0, 3, (count, 2)),
            draws.choice(numbers[:3], (count, 2, 3)),
            *(draws.choice(numbers, shape) for shape in ((count, 3), count, count, (count, 3))),
        )
        sides, values = contact_rows(points, points.bodies + 1)
        columns = [column.tolist() for column in (*sides, *values)]
        rows = list(zip(*columns, strict=True))
        expected = sorted(map(_row, *vars(points).values()), key=lambda row: (*row[:10], row[14]))
        assert list(map(repr, rows)) == list(map(repr, expected))


def _row(bodies, links, points, normal, depth, force, friction):
    """A row of the table of contacts, without numpy's functions of arrays."""
    sides = [(int(bodies[side]) + 1, int(links[side])) for side in (0, 1)]
    first, sign = (0, 1.0) if sides[0] <= sides[1] else (1, -1.0)
    normal = [sign * x for x in normal]
    forces = [force * n + sign * f for n, f in zip(normal, friction, strict=True)]
    at = [*points[first], *points[1 - first]]
    numbers = map(float, (*at, *normal, depth, force, *forces))
    return (*sides[first], *sides[1 - first], *numbers)


@pytest.mark.slow
def test_rows_are_sorted():
    ss = ssduck.load("kitchen", recording=None)
    ss.call_variable("kitchen").step(30)
    rows = ss.sql("SELECT * FROM contacts").fetchall()
    keys = [row[2:12] for row in rows]
    assert len(rows) > 100
    assert keys == sorted(keys)
    assert all(row[2] < row[4] for row in rows)
    ss.close()
