"""Models for the tests of frames."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pybullet = pytest.importorskip("pybullet")
pybullet_data = pytest.importorskip("pybullet_data")

LIBRARY = Path(pybullet_data.getDataPath())

# PyBullet gives link frames in single precision, centres of mass in double.
SINGLE = 1e-6


def rows(world, table, columns, entity=None):
    """Columns of a table as (rows, columns), of one entity or of all."""
    arrow = world.snapshot.tables[table].arrow
    numbers = np.array([arrow[name].to_numpy() for name in columns]).T
    if entity is not None:
        numbers = numbers[arrow["entity"].to_numpy() == world[entity].id]
    return numbers


def asked(world, *tables):
    """The world with these tables read at its present state."""
    world.request_tables(tables)
    return world.tick()


def matrix(orientation_xyzw):
    return Rotation.from_quat(orientation_xyzw)


def same_turn(quaternions_wxyz, quaternions_xyzw, tolerance=SINGLE):
    """Whether rows of orientations are the same rotations."""
    first = Rotation.from_quat(np.roll(quaternions_wxyz, -1, axis=1))
    second = Rotation.from_quat(quaternions_xyzw)
    return (first * second.inv()).magnitude().max() < tolerance


def link_states(client, handle):
    """PyBullet's own states of the links, the base aside."""
    count = pybullet.getNumJoints(handle, client)
    return pybullet.getLinkStates(handle, range(count), 1, 1, client) if count else ()


def base_state(client, handle):
    """Pose of the centre of mass, pose of the link frame: scipy's work."""
    position, turn = pybullet.getBasePositionAndOrientation(handle, client)
    inner, inner_turn = pybullet.getDynamicsInfo(handle, -1, client)[3:5]
    frame_turn = matrix(turn) * matrix(inner_turn).inv()
    return np.array(position), np.array(position) - frame_turn.apply(inner), frame_turn
