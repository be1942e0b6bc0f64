"""Reads the poses and velocities of the link frames of PyBullet's bodies.

PyBullet reports centres of mass. `ssduck.simulators.pybullet.simulator` explains the conversion.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain, repeat
from operator import itemgetter

import numpy as np

from ssduck.geometry.arrays import Indices
from ssduck.geometry.poses import invert, multiply, rotate, rotation_matrices
from ssduck.simulators.interface import Body, LinkPoses
from ssduck.simulators.pybullet.bodies import Pose
from ssduck.simulators.pybullet.console import pybullet

_flatten = chain.from_iterable
# Parts of a link's state: the pose of the centre of mass; linear and angular velocity.
_pose = itemgetter(0, 1)
_pose_and_twist = itemgetter(0, 1, 6, 7)


class LinkPosesReader:
    """Reads the link poses of a fixed list of bodies; the constructor prepares the reading.

    Args:
        bodies: the bodies.
        com: for each body, the poses of its links' centres of mass in the link frames.
    """

    def __init__(self, bodies: Sequence[Body], com: Sequence[Pose]) -> None:
        self._handles = [body.handle for body in bodies]
        self._linked = [body.handle for body in bodies if len(body.links) > 1]
        self._links = [list(range(len(body.links) - 1)) for body in bodies if len(body.links) > 1]
        counts = np.array([len(body.links) for body in bodies], dtype=np.intp)
        # By whether the links' velocities are read: how many numbers the answers have, and
        # where each frame's are.
        self._orders = {
            with_velocities: _order(counts, with_velocities) for with_velocities in (False, True)
        }
        positions = np.concatenate([np.zeros((0, 3)), *(pose[0] for pose in com)])
        orientations = np.concatenate([np.zeros((0, 4)), *(pose[1] for pose in com)])
        self._link_from_com = invert(positions, orientations)[1]
        self._turned = bool(orientations[:, 1:].any())
        self._origins = -positions  # from the centres of mass, in the link frames' axes
        self._shifted = bool(positions.any())

    def read(self, client: int, with_velocities: bool) -> LinkPoses:
        """Returns the present poses of all links, body after body; with velocities on request."""
        links = map(
            pybullet.getLinkStates,
            self._linked,
            self._links,
            repeat(int(with_velocities)),
            repeat(1),  # with forward kinematics: without, links lag the base by a step
            repeat(client),
        )
        # Through iterators in C: a loop in Python would cost as much as the calls.
        answers = chain(
            map(pybullet.getBasePositionAndOrientation, self._handles, repeat(client)),
            map(pybullet.getBaseVelocity, self._handles, repeat(client)),
            map(_pose_and_twist if with_velocities else _pose, _flatten(links)),
            _UNKNOWN,
        )
        count, order = self._orders[with_velocities]
        numbers = np.fromiter(_flatten(_flatten(answers)), np.float64, count)
        states = numbers.take(order)
        if self._turned:
            states[:, 3:7] = multiply(states[:, 3:7], self._link_from_com)
        matrices = rotation_matrices(states[:, 3:7])
        positions = states[:, :3]
        if self._shifted:
            positions = positions + rotate(matrices, self._origins)
        return LinkPoses(positions, matrices, states)


# An answer like the others, of one number.
_UNKNOWN = (((np.nan,),),)


def _order(counts: Indices, with_velocities: bool) -> tuple[int, Indices]:
    """Returns the number of values in PyBullet's results and each link's places, (links, 13).

    The answers are the bases' poses, the bases' velocities, the links' states with or without
    velocities, and an unknown value. A pose is x y z and the quaternion x y z w.
    """
    bases = len(counts)
    total = int(counts.sum())
    is_base = np.zeros(total, dtype=bool)
    is_base[np.cumsum(counts) - counts] = True
    width = 13 if with_velocities else 7
    order = np.full((total, 13), -1, dtype=np.intp)  # from the end: the unknown one
    order[is_base, :7] = 7 * np.arange(bases)[:, None] + np.arange(7)
    order[is_base, 7:] = 7 * bases + 6 * np.arange(bases)[:, None] + np.arange(6)
    links = 13 * bases + width * np.arange(total - bases)[:, None]
    order[~is_base, :width] = links + np.arange(width)
    answered = 13 * bases + width * (total - bases) + 1
    return answered, order[:, [0, 1, 2, 6, 3, 4, 5, *range(7, 13)]]


def link_poses_of(client: int, body: Body, com: Pose) -> LinkPoses:
    """Returns the link poses of one body as they are now."""
    return LinkPosesReader([body], [com]).read(client, with_velocities=True)
