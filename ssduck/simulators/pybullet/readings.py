"""Reads link poses, contact points and rays of a PyBullet client into arrays.

PyBullet reports centres of mass; `ssduck.simulators.pybullet.simulator` explains the conversion.

It returns the first hit of a ray, or all its hits one by one, in no order. So a ray that hits the
body that it passes through is cast again for its other hits, until it has no more. A new ray that
begins behind the hit would miss bodies that touch that body, because Bullet ignores a convex shape
that a ray begins in.
"""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from itertools import chain, count, repeat
from operator import itemgetter

import numpy as np

from ssduck.geometry.arrays import Array, Indices, are_moderate
from ssduck.geometry.poses import invert, multiply, rotate
from ssduck.simulators.interface import Body, ContactPoints, LinkPoses, RayHits
from ssduck.simulators.pybullet.bodies import Pose, is_soft
from ssduck.simulators.pybullet.clients import pybullet

# The bodies of a point.
_BODIES = slice(1, 3)
_BODY_A, _BODY_B = itemgetter(1), itemgetter(2)
# The numbers of a point in rows of floats: the places on a and b and the normal, the distance, the
# normal force, and two frictions, each with its direction.
_DISTANCE, _FORCE, _FRICTION_1, _FRICTION_2 = 9, 10, 11, 15
_FLOATS = 19

_flatten = chain.from_iterable


def read_contacts(client: int, known: AbstractSet[int]) -> tuple[ContactPoints, bool]:
    """Returns the points of the last step at which shapes press or meet, and whether it lacks some.

    Those between known bodies are returned. Bullet's list also has points of shapes that are about
    to meet, up to some millimetres apart. It presses some of these in the first step of an impact.
    """
    points = pybullet.getContactPoints(physicsClientId=client)
    lacks_bodies = not known >= {*map(_BODY_A, points), *map(_BODY_B, points)}
    if lacks_bodies:
        points = [point for point in points if known >= set(point[_BODIES])]
    if not points:
        return ContactPoints.none(), lacks_bodies
    numbers = _flatten((*p[5], *p[6], *p[7], *p[8:11], *p[11], p[12], *p[13]) for p in points)
    rows = np.fromiter(numbers, np.float64, _FLOATS * len(points)).reshape(-1, _FLOATS)
    floats = rows.T.copy()
    ends = _flatten(point[1:5] for point in points)
    sides = np.fromiter(ends, np.intp, 4 * len(points)).reshape(-1, 4).T
    friction = floats[_FRICTION_1] * floats[_FRICTION_1 + 1 : _FRICTION_2]
    friction += floats[_FRICTION_2] * floats[_FRICTION_2 + 1 :]
    contacts = ContactPoints(
        bodies=sides[:2].T,
        links=sides[2:].T + 1,
        points=floats[:6].reshape(2, 3, -1).transpose(2, 0, 1),
        normals=floats[6:9].T,
        depths=-floats[_DISTANCE],
        forces=floats[_FORCE],
        frictions=friction.T,
    )
    is_found = (floats[_DISTANCE] <= 0.0) | (floats[_FORCE] > 0.0)
    return contacts if is_found.all() else contacts.only(is_found), lacks_bodies


# Parts of a link's state: the pose of the centre of mass; linear and angular velocity.
_pose_and_twist = itemgetter(0, 1, 6, 7)


class LinkPosesReader:
    """Reads the link poses of a fixed list of bodies; the constructor prepares the reading."""

    def __init__(self, bodies: Sequence[Body], com: Sequence[Pose]) -> None:
        self._handles = [body.handle for body in bodies]
        self._linked = [body.handle for body in bodies if len(body.links) > 1]
        self._links = [list(range(len(body.links) - 1)) for body in bodies if len(body.links) > 1]
        soft = [is_soft(body) for body in bodies]
        counts = np.array([len(body.links) for body in bodies], dtype=np.intp)
        self._count, self._order = _order(counts, soft)
        self._are_known = not any(soft)
        positions = np.concatenate([np.zeros((0, 3)), *(pose[0] for pose in com)])
        orientations = np.concatenate([np.zeros((0, 4)), *(pose[1] for pose in com)])
        self._link_from_com = invert(positions, orientations)[1]
        self._has_rotated_com = bool(orientations[:, 1:].any())
        self._origins = -positions  # from the centres of mass, in the link frames' axes
        self._has_shifted_com = bool(positions.any())

    def read(self, client: int) -> LinkPoses:
        """Returns the present poses of all links, body after body."""
        links = map(
            pybullet.getLinkStates,
            self._linked,
            self._links,
            repeat(1),  # with velocities
            repeat(1),  # with forward kinematics: without, links lag the base by a step
            repeat(client),
        )
        # Iterators in C: a loop in Python would cost as much as the calls.
        results = chain(
            map(pybullet.getBasePositionAndOrientation, self._handles, repeat(client)),
            map(pybullet.getBaseVelocity, self._handles, repeat(client)),
            map(_pose_and_twist, _flatten(links)),
            _UNKNOWN,
        )
        numbers = np.fromiter(_flatten(_flatten(results)), np.float64, self._count)

        def states() -> Array:
            states = numbers.take(self._order)
            if self._has_rotated_com:
                states[:, 3:7] = multiply(states[:, 3:7], self._link_from_com)
            return states

        are_finite = self._are_known and are_moderate(numbers[:-1])
        return LinkPoses(self._positions, states, are_finite=are_finite)

    def _positions(self, poses: LinkPoses) -> Array:
        """Returns the origins of the link frames, from the centres of mass."""
        centres = poses.states[:, :3]
        if not self._has_shifted_com:
            return centres
        return centres + rotate(poses.matrices, self._origins)


# A result like those of PyBullet, of one value, for the velocities of soft bodies.
_UNKNOWN = (((np.nan,),),)


def _order(counts: Indices, soft: Sequence[bool]) -> tuple[int, Indices]:
    """Returns the number of values in PyBullet's results and each link's places, (links, 13).

    The results are the bases' poses, the bases' velocities, the states of other links, and an
    unknown value. Velocities of soft bodies are unknown.
    """
    bases, total = len(counts), int(counts.sum())
    first = np.cumsum(counts) - counts
    is_base = np.zeros(total, dtype=bool)
    is_base[first] = True
    order = np.zeros((total, 13), dtype=np.intp)
    order[~is_base] = np.arange(13 * bases, 13 * total).reshape(-1, 13)
    order[is_base, :7] = 7 * np.arange(bases)[:, None] + np.arange(7)
    order[is_base, 7:] = 7 * bases + 6 * np.arange(bases)[:, None] + np.arange(6)
    order[first[np.array(soft, dtype=bool)], 7:] = -1  # the unknown value at the end
    return 13 * total + 1, order[:, [0, 1, 2, 6, 3, 4, 5, *range(7, 13)]]


# PyBullet refuses more rays than its maximum in one call, and returns nothing for the maximum.
MAX_RAYS: int = pybullet.MAX_RAY_INTERSECTION_BATCH_SIZE - 1
# Waking other threads takes longer than casting fewer rays than this.
MIN_RAYS_FOR_THREADS = 50
_ALL_THREADS = 0


def cast_rays(client: int, starts: Array, ends: Array, through: Indices) -> RayHits:
    """Returns the first hit of each ray, ignoring the body that it passes through."""
    bodies, fractions = _cast(client, starts, ends)
    # The rays that hit that body first; those of them that have as many hits as were looked at.
    rays = np.flatnonzero((bodies == through) & (bodies >= 0))
    bodies[rays], fractions[rays] = -1, 1.0
    for number in count():
        if not rays.size:
            break
        hit_bodies, hit_fractions = _cast(client, starts[rays], ends[rays], number)
        is_hit = hit_bodies >= 0
        is_nearer = is_hit & (hit_bodies != through[rays]) & (hit_fractions < fractions[rays])
        bodies[rays[is_nearer]] = hit_bodies[is_nearer]
        fractions[rays[is_nearer]] = hit_fractions[is_nearer]
        rays = rays[is_hit]
    return RayHits(bodies, fractions)


def _cast(client: int, starts: Array, ends: Array, number: int = -1) -> tuple[Indices, Array]:
    """Returns the bodies and fractions of the first hits, or of the hits with an index."""
    total = len(starts)
    threads = 1 if total < MIN_RAYS_FOR_THREADS else _ALL_THREADS
    hits = [
        hit
        for first in range(0, total, MAX_RAYS)
        for hit in pybullet.rayTestBatch(
            starts[first : first + MAX_RAYS],
            ends[first : first + MAX_RAYS],
            numThreads=threads,
            reportHitNumber=number,
            physicsClientId=client,
        )
    ]
    bodies = np.fromiter(map(itemgetter(0), hits), np.intp, total)
    return bodies, np.fromiter(map(itemgetter(2), hits), np.float64, total)
