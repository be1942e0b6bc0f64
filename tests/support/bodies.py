"""Bodies of PyBullet that tests create by a call."""

import pytest

pybullet = pytest.importorskip("pybullet")


def create_linked_body(client, mass, shape, *, link_shape=None, **settings):
    """Creates a body with a link besides its base, or a chain of as many as have positions.

    Args:
        client: the client.
        mass: the mass of the base, kg.
        shape: the collision shape of the base.
        link_shape: the collision shape of the link; None for that of the base.
        settings: arguments of `createMultiBody` that replace the default values. A link weighs
            1 kg. Its fixed joint is at the origin of the one before it, with the axis z.

    Returns:
        Its number.
    """
    count = len(settings.get("linkPositions", [0]))
    link = {
        "linkMasses": [1] * count,
        "linkCollisionShapeIndices": [shape if link_shape is None else link_shape] * count,
        "linkVisualShapeIndices": [-1] * count,
        "linkPositions": [[0, 0, 0]],
        "linkOrientations": [[0, 0, 0, 1]] * count,
        "linkInertialFramePositions": [[0, 0, 0]] * count,
        "linkInertialFrameOrientations": [[0, 0, 0, 1]] * count,
        "linkParentIndices": list(range(count)),
        "linkJointTypes": [pybullet.JOINT_FIXED] * count,
        "linkJointAxis": [[0, 0, 1]] * count,
    }
    return pybullet.createMultiBody(mass, shape, **(link | settings), physicsClientId=client)


def client_of(world):
    """Returns the number of the client that runs a world."""
    return world.simulator.client


def solid(client, kind, mass=0.0, place=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0, 1.0), **size):
    """Creates a body of one shape, of PyBullet's kind and sizes; returns its number."""
    shape = pybullet.createCollisionShape(kind, physicsClientId=client, **size)
    return pybullet.createMultiBody(mass, shape, -1, place, turn, physicsClientId=client)
