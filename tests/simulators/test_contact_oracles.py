"""Contacts equal a loop over the simulators' own getters, by point, force and distance, at each step."""

from __future__ import annotations

from collections import defaultdict

import pybullet
import pybullet_data
import pytest

import ssduck

ALL = ssduck.Recording(tables=("entities", "links", "contacts"))
COLUMNS = 'a, link_a, b, link_b, ax, ay, az, bx, "by", bz, force, -depth'


def duck_drop(client):
    pybullet.loadURDF("plane.urdf", physicsClientId=client)
    pybullet.loadURDF("duck_vhacd.urdf", [0, 0, 0.38], physicsClientId=client)


def pile(client):
    pybullet.loadURDF("plane.urdf", physicsClientId=client)
    for n in range(4):
        place = [0.01 * n, 0.005 * n, 0.1 + 0.08 * n]
        pybullet.loadURDF("cube_small.urdf", place, physicsClientId=client)
        pybullet.loadURDF("sphere_small.urdf", [0.02 * n, 0.2, place[2]], physicsClientId=client)


def batch(client):
    """Bodies that PyBullet makes by one call, of which its list has the last one only."""
    pybullet.loadURDF("plane.urdf", physicsClientId=client)
    ball = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.05, physicsClientId=client)
    places = [[0.04 * n, 0, 0.2 + 0.11 * n] for n in range(5)]
    pybullet.createMultiBody(0.1, ball, batchPositions=places, physicsClientId=client)


SCENES = {scene.__name__: scene for scene in (duck_drop, pile, batch)}
# The quick form has the first impacts.
STEPS = [pytest.param(90), pytest.param(2000, marks=pytest.mark.long)]


def points_of_pybullet(client, ids):
    """The rows of contacts by PyBullet's getter: where shapes meet, or the solver presses."""
    for point in pybullet.getContactPoints(physicsClientId=client):
        sides = (ids[point[1]], point[3] + 1, *point[5]), (ids[point[2]], point[4] + 1, *point[6])
        (a, link_a, *at_a), (b, link_b, *at_b) = sorted(sides)
        if point[8] <= 0 or point[9] > 0:
            yield (a, link_a, b, link_b, *at_a, *at_b, point[9], point[8])


@pytest.mark.slow
@pytest.mark.parametrize("steps", STEPS)
@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_contacts_of_pybullet(client, scene, steps):
    pybullet.setAdditionalSearchPath(pybullet_data.getDataPath(), physicsClientId=client)
    pybullet.setGravity(0, 0, -9.81, physicsClientId=client)
    scene(client)
    with ssduck.Interpreter(recording=ALL) as ss:
        world = ss.add_variable("sim", ssduck.World.attach(client))
        handles = range(len(world))
        ids = dict(zip(handles, (entity.id for entity in world), strict=True))
        pushes, apart, plane = [], 0, ids[0]
        for _ in range(steps):
            pybullet.stepSimulation(client)
            world.tick()
            expected = sorted(points_of_pybullet(client, ids))
            assert sorted(ss.sql(f"SELECT {COLUMNS} FROM sim.contacts").fetchall()) == expected
            apart += sum(row[-1] > 0 for row in expected)
            forces = defaultdict(float)
            for row in expected:
                forces[row[0], row[2]] += row[-2]
            pushes.append(forces[plane, ids[1]])
        assert apart or scene is not duck_drop  # some are pressed at a distance
        hardest = max(pushes)
        first = next(step for step, push in enumerate(pushes, 1) if push > 0)
        one = ", ".join(f"sim.{entity.name}" for entity in list(world)[:2])
        changes = ss.eval(f"changes(inContact({one}));")
        assert next(time for time, holds in changes if holds) == pytest.approx(first / 240)
        time, force = ss.eval(f"greatest(contactForce({one}));")
        assert (time, force) == pytest.approx(((pushes.index(hardest) + 1) / 240, hardest))
