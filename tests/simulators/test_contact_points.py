"""Tests how contact points of PyBullet become arrays."""

import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.simulators.pybullet import contacts

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


def test_points_equal_those_of_pybullet(pile):
    expected = [p for p in pybullet.getContactPoints(physicsClientId=pile) if p[8] <= 0]
    read = contacts.read_contacts(pile)
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


def test_all_points_are_read_as_records(pile):
    """The fast way is taken, and the values are those of the slow one."""
    points = pybullet.getContactPoints(physicsClientId=pile)
    records = contacts._records(points)
    assert records is not None
    by_field = contacts._columns_by_field(points)
    for name, values in contacts._columns(points).items():
        np.testing.assert_array_equal(values, by_field[name])


@pytest.mark.parametrize("odd", [2**40, 0.5, None])
def test_points_of_another_layout_are_no_records(pile, odd):
    first, *others = pybullet.getContactPoints(physicsClientId=pile)
    changed = [(odd, *first[1:]), *others]
    assert contacts._records(changed) is None


def test_a_large_number_is_read_one_field_at_a_time(pile):
    first, *others = pybullet.getContactPoints(physicsClientId=pile)
    changed = [(2**40, *first[1:]), *others]
    assert contacts._columns(changed)["flags"].tolist()[0] == 2**40


def test_no_points(pile):
    pybullet.resetSimulation(physicsClientId=pile)
    read = contacts.read_contacts(pile)
    assert (len(read), read.points.shape, read.bodies.shape) == (0, (0, 2, 3), (0, 2))


def test_rows_are_sorted():
    ss = ssduck.load("kitchen", recording=None)
    ss.call_variable("kitchen").step(30)
    rows = ss.sql("SELECT * FROM contacts").fetchall()
    keys = [row[2:12] for row in rows]
    assert len(rows) > 100
    assert keys == sorted(keys)
    assert all(row[2] < row[4] for row in rows)
    ss.close()
