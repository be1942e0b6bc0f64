"""The narrow phase against oracles, and at its boundaries."""

import itertools
import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssduck.geometry.shapes import Geometry
from ssduck.geometry.solids import solid_of
from tests.support import pairs
from tests.support.cases import sampled
from tests.support.narrow_cases import ORIGIN, OVER, floor, shape, two
from tests.support.pairs import ell
from tests.support.solids import box, cylinder, mesh_of, narrow, plane, sphere

# -- against oracles -----------------------------------------------------------------------------


@pytest.mark.slow
@sampled("kinds", pairs.COMBINATIONS, every=6, ids=" ".join)
def test_a_gap_is_what_the_oracle_says(kinds):
    bound = 1e-6 if set(kinds) & pairs.SWEPT else 1e-9
    for seed in range(10):
        error, found = pairs.error_of(*pairs.pair(kinds, seed))
        assert error <= bound, (seed, found)


@pytest.mark.slow
@given(kinds=st.sampled_from(pairs.COMBINATIONS), seed=st.integers(0, 2**32))
def test_a_gap_is_symmetric(kinds, seed):
    a, b = pairs.pair(kinds, seed)
    one, other = pairs.gap(a, b), pairs.gap(b, a)
    assert one.distance == pytest.approx(other.distance, abs=2e-7)


@pytest.mark.slow
@given(
    kinds=st.sampled_from(pairs.COMBINATIONS),
    seed=st.integers(0, 2**32),
    shift=st.tuples(*[st.floats(-5, 5)] * 3),
    turn=st.tuples(st.floats(0.1, 1), *[st.floats(-1, 1)] * 3),
)
def test_a_gap_stays_if_the_world_moves(kinds, seed, shift, turn):
    a, b = pairs.pair(kinds, seed)
    turn = np.array(turn) / np.linalg.norm(turn)
    moved = [pairs.moved(one, np.array(shift), turn) for one in (a, b)]
    assert pairs.gap(*moved).distance == pytest.approx(pairs.gap(a, b).distance, abs=2e-7)


@pytest.mark.slow
@given(
    kinds=st.sampled_from(pairs.COMBINATIONS),
    seed=st.integers(0, 2**32),
    bounds=st.lists(st.floats(0, 3), min_size=2),
)
def test_what_is_near_is_near_for_more(kinds, seed, bounds):
    a, b = pairs.pair(kinds, seed)
    places = [[(one.geometry, one.position, one.quaternion)] for one in (a, b)]
    exact = narrow(*places).clearance(0, 1)
    tick = narrow(*places)
    for bound in bounds:
        found = tick.clearance(0, 1, limit=bound)
        assert found == (exact if exact <= bound else math.inf)


# -- boundaries ----------------------------------------------------------------------------------


UNDER = {
    "plane": (plane(), ORIGIN),
    "box": (box(4, 4, 1), (0.1, 0.2, -0.5)),
    "floor": (box(200, 200, 10), (3.0, -7.0, -5.0)),
    "cylinder": (cylinder(3.0, 2.0), (0.1, 0.2, -1.0)),
    "hull": (Geometry.hull(solid_of(box(4, 4, 2)).core), (0.1, 0.2, -1.0)),
    "closed mesh": (mesh_of(box(4, 4, 2)), (0.1, 0.2, -1.0)),
    "ell": (ell(8.0, 4.0, 2.0), (2.0, 0.0, -1.0)),
    "open mesh": (floor(4.0), (0.1, 0.2, 0.0)),
}


@pytest.mark.parametrize("under", UNDER)
@pytest.mark.parametrize("over", OVER)
@pytest.mark.parametrize(
    "height", [0.3, 1e-3, 1e-5, 2e-6, 1e-7, 0.0, -1e-7, -0.9e-6, -1.1e-6, -1e-4, -1e-2]
)
def test_at_the_surface(over, under, height):
    """The clearance, the depth, and colliding from 1e-6 m on."""
    geometry, at = UNDER[under]
    tick = narrow([(geometry, at)], [(OVER[over], (0.0, 0.0, 0.5 + height))])
    assert tick.clearance(0, 1) == pytest.approx(max(0.0, height), abs=3e-9)
    assert tick.penetration(0, 1) == pytest.approx(max(0.0, -height), abs=2e-8)
    assert tick.collides(0, 1) is (height < -1e-6)
    for within in (0.0, abs(height) - 1e-8, abs(height) + 1e-8):
        expected = max(0.0, height) <= within
        if abs(max(0.0, height) - within) > 5e-9:
            assert (tick.clearance(0, 1, limit=within) <= within) is expected
    normal = tick.signed_distance(1, 0).normal
    assert normal == pytest.approx((0, 0, 1), abs=1e-4)


@pytest.mark.parametrize(("a", "b"), list(itertools.combinations_with_replacement(OVER, 2)))
def test_the_same_place_and_parallel_edges(a, b):
    """FCL ends the process on such a pair of cylinders, and is off by metres on boxes."""
    for x, y, z in itertools.product((0.0, 0.5, 1.0, 1.5), repeat=3):
        found = pairs.gap(shape(OVER[a], (x, y, z)), shape(OVER[b]))
        if a == b == "box":
            outside = [max(0.0, c - 1.0) for c in (x, y, z)]
            expected = math.hypot(*outside) if any(outside) else max(x, y, z) - 1.0
            assert found.distance == pytest.approx(expected, abs=1e-9)
        assert math.isfinite(found.distance)
        way = np.array(found.point_a) - found.point_b
        assert way == pytest.approx(found.distance * np.array(found.normal), abs=1e-9)


# -- ticks -----------------------------------------------------------------------------------------


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
