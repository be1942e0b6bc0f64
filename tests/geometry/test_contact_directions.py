"""Whether contact normals point up, for many pairs at once, is what single pairs and formulas say."""

import itertools
import math

import numpy as np
import pytest

from ssduck.geometry.contact_support import MIN_RISING, MIN_UP
from ssduck.geometry.on_pairs import are_on
from ssduck.geometry.proofs.contact_directions import NOT_UPWARD, UPWARD, decide_upward
from ssduck.geometry.proofs.verdicts import UNDECIDED
from tests.support import pairs
from tests.support.pairs import Shape, gap
from tests.support.solids import box, narrow, sphere

KINDS = ("sphere", "box", "cylinder", "capsule", "ellipsoid", "hull", "flat")
COMBINATIONS = list(itertools.combinations_with_replacement(KINDS, 2))
HEIGHTS = (0.05, MIN_RISING, 0.5, MIN_UP, 0.99)
STRAIGHT = np.array([1.0, 0.0, 0.0, 0.0])


@pytest.mark.slow
@pytest.mark.parametrize("kinds", COMBINATIONS, ids=str)
def test_verdicts_are_what_the_normals_of_single_pairs_say(kinds):
    """In a long form: `python -m tools.oracles`."""
    two = [pairs.pair(kinds, seed) for seed in range(40)]
    results = [gap(*both) for both in two]
    rises = np.array([-result.normal[2] for result in results])
    undecided = 0
    for min_height in HEIGHTS:
        wrong, count = pairs.wrong_normals(two, rises, min_height)
        assert wrong == []
        undecided += count
    # Half of the pairs have faces, edges or corners that meet exactly.
    assert undecided < 0.12 * len(HEIGHTS) * 2 * len(two)


def verdict(first, second):
    cores = pairs.bodies([first, second])
    return int(decide_upward(cores, np.array([0]), np.array([1]), MIN_UP).verdicts[0])


@pytest.mark.parametrize("off", [1e-7, 1e-4, 0.02])
@pytest.mark.parametrize("depth", [0.3, 0.02, 1e-5, 0.0, -5e-4])
@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_spheres_about_30_degrees(depth, off, turn):
    lower = Shape("sphere", sphere(0.5), np.array([3.0, -2.0, 1.0]), STRAIGHT)
    for sign, wanted in ((-1, UPWARD), (1, NOT_UPWARD)):
        tilt = math.acos(MIN_UP) + sign * off
        across = math.sin(tilt)
        way = np.array([across * math.cos(turn), across * math.sin(turn), math.cos(tilt)])
        found = verdict(lower, lower.at(lower.position + way * (1.0 - depth), STRAIGHT))
        assert found in ((wanted,) if off == 0.02 else (wanted, UNDECIDED))


def test_equal_overlaps_are_left_to_the_narrow_phase():
    """The normals of spheres with one centre, and of a cube in a cube, are any of several."""
    ball = Shape("sphere", sphere(0.5), np.zeros(3), STRAIGHT)
    cube = Shape("box", box(1.0, 1.0, 1.0), np.zeros(3), STRAIGHT)
    assert verdict(ball, ball) == UNDECIDED
    assert verdict(cube, cube) == UNDECIDED


def entity(random, kinds):
    """Returns one to three shapes near the origin."""
    made = [pairs.pair((kind, kind), int(random.integers(1 << 30)))[0] for kind in kinds]
    scale = random.uniform(0.3, 1.0)
    return [(s.geometry, s.position * scale, s.quaternion) for s in made]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_entities_of_several_shapes_are_on_each_other_as_one_by_one(seed):
    random = np.random.default_rng(seed)
    kinds = (*KINDS, "mesh", "plane")
    entities = [entity(random, random.choice(kinds, random.integers(1, 4))) for _ in range(9)]
    at_once, one_by_one = narrow(*entities), narrow(*entities)
    every = itertools.permutations(range(len(entities)), 2)
    touching = [(a, b) for a, b in every if one_by_one.touches(a, b)]
    a, b = np.array(touching).T
    found = are_on(at_once, a, b)
    expected = [one_by_one.on(a, b) for a, b in touching]
    assert found.tolist() == expected
    assert True in expected
    assert False in expected


# -- the room of verdicts ----------------------------------------------------------------------


def made(kinds, count):
    return [pairs.pair(kinds, seed) for seed in range(count)]


def decided(two, min_height):
    cores = pairs.bodies([shape for pair in two for shape in pair])
    first = np.arange(0, 2 * len(two), 2)
    return decide_upward(cores, first, first + 1, min_height)


def moved(two, random, far):
    """Returns pairs whose second shape moves by a distance each."""
    ways = random.normal(size=(len(two), 3))
    ways *= np.broadcast_to(far, len(two))[:, None] / np.linalg.norm(ways, axis=1)[:, None]
    return [(a, b.at(b.position + way)) for (a, b), way in zip(two, ways, strict=True)]


@pytest.mark.slow
@pytest.mark.parametrize("min_height", [0.5, MIN_UP])
def test_a_verdict_holds_within_its_room(min_height):
    random, checked, far_rooms = np.random.default_rng(5), 0, 0
    for kinds in COMBINATIONS:
        two = made(kinds, 16)
        found = decided(two, min_height)
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
