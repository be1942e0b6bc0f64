"""An arm with all kinds of joints, and the columns of its links' poses."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.urdf import collision, joint, link, robot

pybullet = pytest.importorskip("pybullet")

POSE = ["x", "y", "z", "qw", "qx", "qy", "qz"]
TWIST = ["vx", "vy", "vz", "wx", "wy", "wz"]
LOW, HIGH = ["xmin", "ymin", "zmin"], ["xmax", "ymax", "zmax"]
LIMIT = '<limit lower="{}" upper="{}" effort="{}" velocity="{}"/>'


# The inertial frames of the base and the links are shifted and rotated; all kinds of joints.
ARM = robot(
    link(
        "base",
        com=(0.1, 0.2, 0.3),
        rpy=(0.3, -0.2, 1.1),
        shapes=collision('<box size="0.4 0.2 0.1"/>', xyz=(0.05, 0, 0.1), rpy=(0.1, 0.2, 0.3))
        + collision('<cylinder radius="0.1" length="0.5"/>', xyz=(0, 0.3, 0), rpy=(1, 0, 0)),
    ),
    link(
        "upper",
        com=(0, 0, 0.25),
        rpy=(0, 0.5, 0),
        shapes=collision('<capsule radius="0.05" length="0.4"/>', xyz=(0, 0, 0.2), rpy=(0, 0.7, 0)),
    ),
    link("slide", com=(0.02, 0, 0), shapes=collision('<sphere radius="0.07"/>', xyz=(0.1, 0, 0))),
    link("plate", com=(-0.1, 0.1, 0), rpy=(0, 0, 0.4)),
    link(
        "wheel",
        shapes=collision('<cylinder radius="0.15" length="0.04"/>', rpy=(math.pi / 2, 0, 0)),
    ),
    joint(
        "shoulder",
        "revolute",
        "base",
        "upper",
        xyz=(0, 0.1, 0.2),
        rpy=(0.2, 0, 0.1),
        axis=(0, 1, 0),
        limit=LIMIT.format(-2.5, 1.5, 40, 3),
    ),
    joint(
        "extend",
        "prismatic",
        "upper",
        "slide",
        xyz=(0, 0, 0.5),
        axis=(0, 0, 1),
        limit=LIMIT.format(-0.2, 0.3, 15, 0.5),
    ),
    joint("mount", "fixed", "slide", "plate", xyz=(0.1, 0, 0), rpy=(0, 0, 1)),
    joint("roll", "continuous", "base", "wheel", xyz=(0.3, 0, 0), axis=(0, 1, 0)),
)


def unsettle(client, handle, seed):
    """Gives a body a random pose, random velocities and random joint states."""
    rng = np.random.default_rng(seed)
    turn = Rotation.random(random_state=seed).as_quat()
    pybullet.resetBasePositionAndOrientation(handle, rng.normal(size=3), turn, client)
    pybullet.resetBaseVelocity(handle, rng.normal(size=3), rng.normal(size=3), client)
    for index in range(pybullet.getNumJoints(handle, client)):
        kind, low, high = (pybullet.getJointInfo(handle, index, client)[i] for i in (2, 8, 9))
        if kind in (pybullet.JOINT_REVOLUTE, pybullet.JOINT_PRISMATIC):
            low, high = (low, high) if low < high else (-1.0, 1.0)
            pybullet.resetJointState(
                handle, index, rng.uniform(low, high), rng.normal(), physicsClientId=client
            )
