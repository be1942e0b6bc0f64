"""Verdicts on contact normals hold while shapes move less than their room."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from ssduck.geometry.contact_support import MIN_UP
from ssduck.geometry.proofs.contact_directions import UPWARD, decide_upward
from ssduck.geometry.proofs.nearest_points import decide_upward_round
from tests.support import pairs
from tests.support.pairs import gap

KINDS = ("sphere", "box", "cylinder", "capsule", "ellipsoid", "hull")
COMBINATIONS = list(itertools.combinations_with_replacement(KINDS, 2))
HEIGHTS = (0.5, MIN_UP)


def made(kinds, count):
    return [pairs.pair(kinds, seed) for seed in range(count)]


def decided(two, min_height, decide=decide_upward):
    cores = pairs.bodies([shape for pair in two for shape in pair])
    first = np.arange(0, 2 * len(two), 2)
    return decide(cores, first, first + 1, min_height)


def moved(two, random, far):
    """Returns pairs whose second shape moves by a distance each."""
    ways = random.normal(size=(len(two), 3))
    ways *= np.broadcast_to(far, len(two))[:, None] / np.linalg.norm(ways, axis=1)[:, None]
    return [(a, b.at(b.position + way)) for (a, b), way in zip(two, ways, strict=True)]


@pytest.mark.slow
@pytest.mark.parametrize("decide", [decide_upward, decide_upward_round])
@pytest.mark.parametrize("min_height", HEIGHTS)
def test_a_verdict_holds_within_its_room(decide, min_height):
    random, checked, far_rooms = np.random.default_rng(5), 0, 0
    for kinds in COMBINATIONS:
        two = made(kinds, 16)
        found = decided(two, min_height, decide)
        assert (found.room[found.verdicts == 0] == 0.0).all()
        assert (found.room >= 0.0).all()
        places = np.flatnonzero(found.room > 0.0)
        far_rooms += int((found.room > 1e-2).sum())
        near = moved([two[n] for n in places], random, 0.99 * found.room[places])
        for (a, b), verdict in zip(near, found.verdicts[places].tolist(), strict=True):
            rises = -gap(a, b).normal[2]
            assert (rises >= min_height) == (verdict == UPWARD)
            checked += 1
    assert checked > 60
    assert far_rooms > 20


def test_rooms_are_not_much_smaller_than_needed():
    """A ball on a ball: the normal turns to 30 degrees when the upper one moves so far."""
    lower = pairs.Shape("sphere", pairs.geometry("sphere", np.random.default_rng(1), True),
                        np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))  # fmt: skip
    reach = lower.geometry.size[0] * 2.0
    upper = lower.at((0.0, 0.0, 0.98 * reach))
    room = float(decided([(lower, upper)], MIN_UP, decide_upward_round).room[0])
    aside = 0.98 * reach * 0.5
    assert 0.1 * aside < room < aside
