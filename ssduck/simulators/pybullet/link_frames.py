"""Reads the poses and velocities of the link frames of PyBullet's bodies.

PyBullet reports centres of mass. `ssduck.simulators.pybullet.simulator` explains the conversion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from itertools import chain, repeat
from operator import itemgetter

import numpy as np

from ssduck.geometry.arrays import Array, Indices, are_moderate
from ssduck.geometry.poses import invert, multiply, rotate, rotation_matrices
from ssduck.simulators.interface import Body, LinkPoses, PosesSource
from ssduck.simulators.pybullet.bodies import Pose, is_soft
from ssduck.simulators.pybullet.clients import pybullet

_flatten = chain.from_iterable
# Parts of a link's state: the pose of the centre of mass; linear and angular velocity.
_pose = itemgetter(0, 1)
_pose_and_twist = itemgetter(0, 1, 6, 7)


class LinkPosesReader:
    """Reads the link poses of a fixed list of bodies; the constructor prepares the reading."""

    def __init__(self, bodies: Sequence[Body], com: Sequence[Pose]) -> None:
        self._handles = [body.handle for body in bodies]
        self._linked = [body.handle for body in bodies if len(body.links) > 1]
        self._links = [list(range(len(body.links) - 1)) for body in bodies if len(body.links) > 1]
        soft = [is_soft(body) for body in bodies]
        counts = np.array([len(body.links) for body in bodies], dtype=np.intp)
        # By whether the links' velocities are read: the number of values in PyBullet's results, and
        # the places of each link's values.
        self._orders = {
            with_velocities: _order(counts, soft, with_velocities)
            for with_velocities in (False, True)
        }
        self._are_known = not any(soft)
        positions = np.concatenate([np.zeros((0, 3)), *(pose[0] for pose in com)])
        orientations = np.concatenate([np.zeros((0, 4)), *(pose[1] for pose in com)])
        self._link_from_com = invert(positions, orientations)[1]
        self._has_rotated_com = bool(orientations[:, 1:].any())
        self._origins = -positions  # from the centres of mass, in the link frames' axes
        self._has_shifted_com = bool(positions.any())

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
        # Iterators in C: a loop in Python would cost as much as the calls.
        results = chain(
            map(pybullet.getBasePositionAndOrientation, self._handles, repeat(client)),
            map(pybullet.getBaseVelocity, self._handles, repeat(client)),
            map(_pose_and_twist if with_velocities else _pose, _flatten(links)),
            _UNKNOWN,
        )
        count, _ = self._orders[with_velocities]
        numbers = np.fromiter(_flatten(_flatten(results)), np.float64, count)
        return (self._poses if with_velocities else self._poses_without)(numbers[None])

    def _poses(self, numbers: Array, *, with_velocities: bool = True) -> LinkPoses:
        """Returns the link poses at t ticks, one after the other, of PyBullet's numbers, (t, k)."""
        states = cache(partial(self._states, numbers, self._orders[with_velocities][1]))
        matrices = cache(lambda: rotation_matrices(states()[:, 3:7]))
        return LinkPoses(
            lambda: self._positions(states()[:, :3], matrices),
            matrices,
            states,
            are_finite=self._are_known and are_moderate(numbers[:, :-1].reshape(-1)),
            source=PosesSource(numbers[0], self._poses if with_velocities else self._poses_without),
        )

    def _states(self, numbers: Array, order: Indices) -> Array:
        """Returns the states of the links at t ticks, (t n, 13); see `LinkPoses`."""
        states = numbers.take(order, axis=1).reshape(-1, 13)
        if self._has_rotated_com:
            turns = np.tile(self._link_from_com, (len(numbers), 1))
            states[:, 3:7] = multiply(states[:, 3:7], turns)
        return states

    def _positions(self, centres: Array, matrices: Callable[[], Array]) -> Array:
        """Returns the origins of link frames, (t n, 3), of the centres of mass of the links."""
        if not self._has_shifted_com:
            return centres
        origins = np.tile(self._origins, (len(centres) // len(self._origins), 1))
        return centres + rotate(matrices(), origins)

    def _poses_without(self, numbers: Array) -> LinkPoses:
        """Returns the link poses likewise, without the velocities of links."""
        return self._poses(numbers, with_velocities=False)


# A result like those of PyBullet, of one value, for velocities that are not read.
_UNKNOWN = (((np.nan,),),)


def _order(counts: Indices, soft: Sequence[bool], with_velocities: bool) -> tuple[int, Indices]:
    """Returns the number of values in PyBullet's results and each link's places, (links, 13).

    The results are the bases' poses, the bases' velocities, the links' states with or without
    velocities, and an unknown value. Velocities of soft bodies are unknown.
    """
    bases = len(counts)
    total = int(counts.sum())
    is_base = np.zeros(total, dtype=bool)
    is_base[np.cumsum(counts) - counts] = True
    width = 13 if with_velocities else 7
    order = np.full((total, 13), -1, dtype=np.intp)  # -1: the unknown value at the end
    order[is_base, :7] = 7 * np.arange(bases)[:, None] + np.arange(7)
    order[is_base, 7:] = 7 * bases + 6 * np.arange(bases)[:, None] + np.arange(6)
    order[(np.cumsum(counts) - counts)[np.array(soft, dtype=bool)], 7:] = -1
    links = 13 * bases + width * np.arange(total - bases)[:, None]
    order[~is_base, :width] = links + np.arange(width)
    count = 13 * bases + width * (total - bases) + 1
    return count, order[:, [0, 1, 2, 6, 3, 4, 5, *range(7, 13)]]


def link_poses_of(client: int, body: Body, com: Pose) -> LinkPoses:
    """Returns the link poses of one body as they are now."""
    return LinkPosesReader([body], [com]).read(client, with_velocities=True)
