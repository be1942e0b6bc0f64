"""Casts rays in a PyBullet client.

PyBullet returns the first hit of a ray, or all its hits one by one, in no order. So a ray that hits
the body that it passes through is cast again for its other hits, until it has no more. A new ray
that begins behind the hit would miss bodies that touch that body, because Bullet ignores a convex
shape that a ray begins in.
"""

from __future__ import annotations

from itertools import count
from operator import itemgetter

import numpy as np

from ssduck.geometry.arrays import Array, Indices
from ssduck.simulators.interface import RayHits
from ssduck.simulators.pybullet.clients import pybullet

# PyBullet refuses more rays than its maximum in one call, and returns nothing for the maximum.
MAX_RAYS: int = pybullet.MAX_RAY_INTERSECTION_BATCH_SIZE - 1
# Waking other threads takes longer than casting fewer rays than this.
MIN_RAYS_FOR_THREADS = 50
_ALL_THREADS = 0
_body = itemgetter(0)
_fraction = itemgetter(2)


def cast_rays(client: int, starts: Array, ends: Array, through: Indices) -> RayHits:
    """Returns the first hit of each ray, ignoring the body that it passes through."""
    bodies, fractions = _cast(client, starts, ends)
    blocked = np.flatnonzero((bodies == through) & (bodies >= 0))
    if blocked.size:
        bodies[blocked], fractions[blocked] = _first_others(
            client, starts[blocked], ends[blocked], through[blocked]
        )
    return RayHits(bodies, fractions)


def _first_others(
    client: int, starts: Array, ends: Array, through: Indices
) -> tuple[Indices, Array]:
    """Returns the nearest of all hits, without those of the bodies that the rays pass through."""
    bodies = np.full(len(starts), -1, dtype=np.intp)
    fractions = np.ones(len(starts))
    rays = np.arange(len(starts))
    for number in count():
        hit_bodies, hit_fractions = _cast(client, starts[rays], ends[rays], number)
        is_hit = hit_bodies >= 0
        is_nearer = is_hit & (hit_bodies != through[rays]) & (hit_fractions < fractions[rays])
        bodies[rays[is_nearer]] = hit_bodies[is_nearer]
        fractions[rays[is_nearer]] = hit_fractions[is_nearer]
        rays = rays[is_hit]
        if not rays.size:
            break
    return bodies, fractions


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
    return (
        np.fromiter(map(_body, hits), np.intp, total),
        np.fromiter(map(_fraction, hits), np.float64, total),
    )
