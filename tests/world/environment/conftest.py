"""Fixtures of the tests in this folder."""

import numpy as np
import pytest

import ssduck
from tests.support.bodies import create_linked_body, solid
from tests.support.environments import state

pybullet = pytest.importorskip("pybullet")


TILTED = pybullet.getQuaternionFromEuler([0.3, 0.2, 0.1])


@pytest.fixture
def menagerie(client):
    """A world of bodies of all sorts in a client of the user's; some of them touch the ground."""
    pybullet.setGravity(0, 0, -9.81, client)
    bodies = create_solids(client) | create_arm(client) | create_tied_boxes(client)
    return ssduck.World.attach(client, names={number: name for name, number in bodies.items()})


def create_box(client):
    half = [0.1, 0.2, 0.05]
    return pybullet.createCollisionShape(
        pybullet.GEOM_BOX, halfExtents=half, physicsClientId=client
    )


def create_solids(client):
    """Creates bodies without links, one with other dynamics and one of another colour."""
    own = {"physicsClientId": client}
    offset = {"baseInertialFramePosition": [0.02, 0, 0.01], "baseOrientation": TILTED}
    lying = pybullet.getQuaternionFromEuler([0.3, np.pi / 2, 0.1])
    rod = {"radius": 0.05, "height": 0.2}
    box = create_box(client)
    bodies = {
        "ground": solid(client, pybullet.GEOM_BOX, halfExtents=[20, 20, 0.1]),
        "box": pybullet.createMultiBody(2, box, basePosition=[0, 0, 0.5], **offset, **own),
        "ball": solid(client, pybullet.GEOM_SPHERE, 1, [1, 0, 0.5], radius=0.1),
        "cylinder": solid(client, pybullet.GEOM_CYLINDER, 1, [2, 0, 0.3], lying, **rod),
        "capsule": solid(client, pybullet.GEOM_CAPSULE, 1, [3, 0, 0.3], **rod),
    }
    pybullet.changeDynamics(
        bodies["ball"],
        -1,
        lateralFriction=0.9,
        rollingFriction=0.01,
        restitution=0.7,
        localInertiaDiagonal=[0.01, 0.02, 0.03],
        **own,
    )
    pybullet.resetBaseVelocity(bodies["ball"], [1, 0, 0], [0, 0, 3], client)
    pybullet.changeVisualShape(bodies["box"], -1, rgbaColor=[1, 0, 0, 0.5], **own)
    return bodies


def create_arm(client):
    """Creates a fixed body of three links; two of its joints move."""
    box = create_box(client)
    ball = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.1, physicsClientId=client)
    straight = [0, 0, 0, 1]
    arm = create_linked_body(
        client,
        0,
        box,
        basePosition=[8, 0, 3],
        linkMasses=[1, 0.5, 0.3],
        linkCollisionShapeIndices=[box, box, ball],
        linkPositions=[[0.3, 0, 0], [0, 0.5, 0], [0, 0, 0.3]],
        linkOrientations=[TILTED, straight, straight],
        linkInertialFramePositions=[[0.05, 0, 0], [0, 0, 0], [0, 0, 0]],
        linkInertialFrameOrientations=[TILTED, straight, straight],
        linkParentIndices=[0, 1, 1],
        linkJointTypes=[pybullet.JOINT_REVOLUTE, pybullet.JOINT_PRISMATIC, pybullet.JOINT_FIXED],
        linkJointAxis=[[0, 0, 1], [1, 0, 0], [0, 0, 0]],
    )
    pybullet.resetJointState(arm, 0, 0.4, 0.2, client)
    pybullet.resetJointState(arm, 1, 0.05, -0.1, client)
    return {"arm": arm}


def create_tied_boxes(client):
    """Creates a box that hangs from a point of the world, and one that is fixed to it."""
    own = {"physicsClientId": client}
    box = create_box(client)
    first = pybullet.createMultiBody(1, box, basePosition=[10, 0, 3], **own)
    second = pybullet.createMultiBody(1, box, basePosition=[10, 0.6, 3], **own)
    point = pybullet.JOINT_POINT2POINT
    pybullet.createConstraint(
        first, -1, -1, -1, point, [0, 0, 0], [0, -0.2, 0], [10, -0.2, 3.1], **own
    )
    tie = pybullet.createConstraint(
        first, -1, second, -1, pybullet.JOINT_FIXED, [0] * 3, [0, 0.3, 0], [0, -0.3, 0], **own
    )
    pybullet.changeConstraint(tie, maxForce=200, **own)
    return {"first": first, "second": second}


@pytest.fixture
def recorded(kitchen):
    """The kitchen, recorded each 60 steps for a second, and what it was like at half of it."""
    ss = ssduck.Interpreter()
    ss.add_variable("kitchen", kitchen)
    ss.record("kitchen", ssduck.Recording(tables=("joints", "links")))
    for _ in range(2):
        kitchen.step(60)
    half = state(kitchen)
    for _ in range(2):
        kitchen.step(60)
    return ss, half
