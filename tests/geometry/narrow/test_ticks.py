"""The narrow phase of a tick."""

import itertools
import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from tests.support import pairs
from tests.support.narrow_cases import two
from tests.support.pairs import Shape
from tests.support.solids import box, narrow, sphere


def test_a_limit_of_the_clearance_is_where_it_ends():
    arm = [(box(0.1, 0.1, 0.9), (0, 0, z)) for z in range(10)]
    tick = narrow(arm, [(box(0.1, 0.1, 0.1), (0.5, 0.02, 0))])
    assert tick.clearance(0, 1) == pytest.approx(0.4)
    assert tick.clearance(0, 1, limit=0.1) == math.inf
    assert tick.clearance(1, 0, limit=0.4 + 1e-9) == pytest.approx(0.4)


def test_an_entity_is_all_its_shapes():
    table = [(box(2, 2, 0.1), (0, 0, 1)), (box(0.1, 0.1, 1), (0.9, 0.9, 0.5))]
    tick = narrow(table, [(sphere(0.1), (0, 0, 0.8))], [(sphere(0.1), (0.8, 0.9, 0.5))])
    assert tick.clearance(0, 1) == pytest.approx(0.05)
    assert tick.penetration(0, 2) == pytest.approx(0.05)
    assert tick.collides(2, 0)
    assert tick.solid_volume(0) == pytest.approx(0.41)


def test_an_entity_and_itself():
    tick = two(box(), box())
    assert tick.collides(0, 0) is False
    assert tick.clearance(0, 0) == 0.0
    assert tick.penetration(0, 0) == 0.0
    assert tick.on(0, 0) is False
    assert tick.nearest_points(0, 0) is None


@pytest.mark.slow
def test_many_entities_as_one_by_one():
    random = np.random.default_rng(5)
    kinds = ["sphere", "box", "hull", "cylinder", "mesh"]
    shapes = [
        Shape(
            k,
            pairs.geometry(k, random, is_round=False),
            random.uniform(-1, 1, 3),
            pairs.pose(random, is_round=False)[1],
        )
        for k in kinds * 4
    ]
    tick = narrow(*([(one.geometry, one.position, one.quaternion)] for one in shapes))
    for i, j in itertools.combinations(range(len(shapes)), 2):
        alone = pairs.gap(shapes[i], shapes[j]).distance
        assert tick.collides(j, i) is (alone < -1e-6)
        assert tick.clearance(i, j) == pytest.approx(max(0.0, alone), abs=1e-7)


def test_threads_get_the_same():
    random = np.random.default_rng(6)
    places = [
        [(pairs.geometry("hull", random, is_round=False), random.uniform(-1, 1, 3))]
        for _ in range(12)
    ]
    every = list(itertools.combinations(range(12), 2))
    alone, together = narrow(*places), narrow(*places)
    expected = [alone.clearance(i, j) for i, j in every]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(lambda pair: together.clearance(*pair), every * 3)) == expected * 3
