"""The broad phase, and relations of boxes and positions, find what comparing all of them finds."""

from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ssduck.geometry import broad_phase as broad
from ssduck.geometry.box_relations import BoxQueries
from ssduck.geometry.broad_phase import overlapping_pairs
from ssduck.schema import ID_FACTOR
from tests.support.cases import sampled


def brute(boxes, apart=0.0):
    low, high = boxes[:3] - apart / 2, boxes[3:] + apart / 2
    meets = (low[:, :, None] <= high[:, None, :]).all(axis=0)
    here = (low <= high).all(axis=0)
    meets = meets & meets.T & here & here[:, None]
    return [(i, j) for i, j in np.argwhere(meets).tolist() if i < j]


def found(boxes, apart=0.0):
    """The pairs, by each way that this number of boxes can take."""
    result = sorted_pairs(boxes, apart)
    if boxes.shape[1] <= broad._MAX_COMPARED:
        with mock.patch.object(broad, "_MAX_COMPARED", 0):
            assert sorted_pairs(boxes, apart) == result
    return result


def sorted_pairs(boxes, apart):
    pairs = zip(*(side.tolist() for side in overlapping_pairs(boxes, apart)), strict=True)
    return sorted((min(pair), max(pair)) for pair in pairs)


def scene(count, seed, sizes=(0.05, 0.4), side=4.0):
    rng = np.random.default_rng(seed)
    low = rng.uniform(0, side, (3, count))
    return np.vstack((low, low + rng.uniform(*sizes, (3, count))))


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("sizes", [(0.05, 0.4), (0.3, 0.3), (1e-6, 2.0), (0.0, 0.0), (3.0, 9.0)])
@pytest.mark.parametrize("apart", [0.0, 0.25])
def test_the_same_as_all_pairs(seed, sizes, apart):
    boxes = scene(60, seed, sizes)
    assert found(boxes, apart) == brute(boxes, apart)


@pytest.mark.slow
@given(
    arrays(np.int8, (3, 12), elements=st.integers(-4, 4)),
    arrays(np.int8, (3, 12), elements=st.integers(-1, 30)),
)
def test_boxes_that_touch_meet(low, extent):
    """On a grid of whole numbers many boxes touch exactly; some have no inside."""
    boxes = np.vstack((low, low + extent)).astype(np.float64)
    assert found(boxes) == brute(boxes)


def test_boxes_without_end_without_shape_and_unknown():
    boxes = scene(30, 3)
    boxes[:, 4] = [-np.inf, -np.inf, -np.inf, np.inf, np.inf, 1.0]
    boxes[:, 9] = [-np.inf] * 3 + [np.inf] * 3
    boxes[:, 11] = [np.inf] * 3 + [-np.inf] * 3
    boxes[2, 12] = np.nan
    pairs = found(boxes)
    assert pairs == brute(boxes)
    assert (4, 9) in pairs
    assert not any({11, 12} & set(pair) for pair in pairs)


@pytest.mark.parametrize("count", [0, 1])
def test_of_none_and_of_one_there_is_no_pair(count):
    assert found(np.zeros((6, count))) == []


@pytest.mark.parametrize(("gap", "meets"), [(-1e-9, True), (0.0, True), (1e-9, False)])
def test_the_boundary(gap, meets):
    boxes = np.array([[0, 0, 0, 1, 1, 1], [1 + gap, 0, 0, 2, 1, 1]], dtype=float).T
    assert bool(found(boxes)) is meets


def with_far(boxes, *distances):
    """Three small bodies far out for each distance, two in one place and one opposite."""
    corners = [np.full(3, sign * distance) for distance in distances for sign in (-1, 1, 1)]
    return np.hstack((boxes, *(np.r_[at, at + 0.01][:, None] for at in corners)))


@sampled("distances", [[2e3], [2e4], [1e9], [1e300], [1e308], [2e3, 1e9, 1e300]], every=3)
@pytest.mark.parametrize(("size", "side"), [(0.01, 0.1), (0.1, 1.0), (0.0, 1.0), (1e-9, 1e-8)])
@pytest.mark.parametrize("apart", [0.0, 0.003, 1e12, 1e302])
def test_a_few_far_out(distances, size, side, apart):
    boxes = with_far(scene(100, 5, (size, size), side), *distances)
    assert found(boxes, apart) == brute(boxes, apart)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("distance", [-1e300, -1e9, 2e4, 1e17])
def test_far_out_along_one_axis(axis, distance):
    boxes = scene(200, 6, (0.05, 0.1), 1.0)
    boxes[[axis, axis + 3], :20] += distance
    assert found(boxes) == brute(boxes)


@pytest.mark.parametrize(
    ("offset", "size", "side"),
    [
        (1e7, 1e-3, 6e-3),
        (-1e7, 1e-3, 6e-3),
        (1e7, 1e-8, 1e-7),
        (1e16, 1, 10),
        (-1e300, 1e285, 4e285),
    ],
)
def test_everything_far_out(offset, size, side):
    boxes = scene(200, 7, (0.5 * size, size), side) + offset
    assert len(brute(boxes)) > 50
    assert found(boxes) == brute(boxes)


@pytest.mark.parametrize("offset", [0.0, 1e3, 1e7, -1e7, 1e12])
@pytest.mark.parametrize("size", [1e-3, 0.1, 1 / 3, 0.7, 1e5])
@pytest.mark.parametrize("distances", [[], [1e9], [-1e300]])
def test_each_touches_the_next(offset, size, distances):
    """Corners of a row of boxes fall where cells end, but for rounding."""
    ends = offset + size * np.arange(1001)
    row = np.vstack((ends[:-1],) * 3 + (ends[1:],) * 3)
    boxes = with_far(row, *distances)
    assert found(boxes) == brute(boxes)
    assert {(k, k + 1) for k in range(999)} <= set(found(boxes))


def test_a_box_larger_than_its_rounded_extent():
    """The middle one begins just before 1, in the first cell, and the last one at 2."""
    lows, highs = [0.0, np.nextafter(1.0, 0.0), 2.0], [1.0, 2.0, 3.0]
    assert found(np.array([lows] * 3 + [highs] * 3)) == [(0, 1), (1, 2)]


@pytest.mark.parametrize("low", [-9, -300])
@pytest.mark.parametrize("high", [2, 300])
def test_sizes_and_places_of_all_orders(low, high):
    rng = np.random.default_rng(8)
    places = rng.choice([-1, 1], (3, 300)) * 10 ** rng.uniform(low, high, (3, 300))
    boxes = np.vstack((places, places + 10 ** rng.uniform(low, high, (3, 300))))
    assert len(brute(boxes)) > 50
    assert found(boxes) == brute(boxes)


# Few digits, so that many are alike or touch; those that are added vanish in the larger ones.
numbers = st.builds(
    lambda digit, order: digit * 10.0**order,
    st.integers(0, 3),
    st.one_of(st.integers(-3, 1), st.sampled_from([-320, -300, -9, 4, 9, 16, 300, 307])),
)
signed = st.builds(lambda sign, number: sign * number, st.sampled_from([-1, 1]), numbers)


@pytest.mark.slow
@given(
    arrays(float, (3, 12), elements=signed),
    arrays(float, (3, 12), elements=signed),
    arrays(float, (3, 12), elements=numbers),
    st.one_of(st.just(0.0), numbers),
)
def test_of_all_orders_the_same_as_all_pairs(places, steps, extents, apart):
    low = places + steps
    boxes = np.vstack((low, low + extents))
    assert found(boxes, apart) == brute(boxes, apart)


@pytest.mark.parametrize("apart", [1e307, np.finfo(float).max, np.inf])
def test_all_meet_that_are_boxes(apart):
    boxes = scene(10, 9)
    boxes[:, 3] = [np.inf] * 3 + [-np.inf] * 3
    others = [k for k in range(10) if k != 3]
    assert found(boxes, apart) == [(i, j) for i in others for j in others if i < j]


def test_many_candidates_are_compared_in_parts(monkeypatch):
    """Thin plates in a stack: all begin in one cell, none meet."""
    heights = np.arange(500.0)[None] * 1e-3
    flat = np.zeros((2, 500))
    boxes = np.vstack((flat, heights, flat + 1.0, heights + 1e-4))
    monkeypatch.setattr(broad, "_CANDIDATES_AT_ONCE", 1000)
    assert found(boxes) == []
    boxes[5] += 2e-3
    assert found(boxes) == brute(boxes)


INF, HUGE = np.inf, 1e308


def above(box, at):
    return over(box, at) and at[2] >= box[5]


def below(box, at):
    return over(box, at) and 2 * at[2] < box[2] + box[5] and box[5] < INF


def inside(box, at):
    return all(box[axis] < at[axis] < box[axis + 3] for axis in range(3))


def over(box, at):
    return box[0] <= at[0] <= box[3] and box[1] <= at[1] <= box[4]


def boxes_and_positions(seed):
    """Boxes and positions, of all sizes, and in some scenes on a lattice, so that edges meet."""
    random = np.random.default_rng(seed)
    count, scale = random.integers(1, 60), 10.0 ** random.integers(-3, 4)
    positions = random.uniform(-1, 1, (3, count)) * scale
    extents = random.exponential(0.2, (3, count)) * scale
    if seed % 3 == 0:
        positions, extents = (np.round(4 * a / scale) * scale / 4 for a in (positions, extents))
    boxes = np.vstack((positions - extents, positions + extents))
    if seed % 4 == 0:  # a ground plane
        boxes[:, 0] = [-INF, -INF, -10, INF, INF, 0]
    if seed % 5 == 0:
        boxes[:, -1], positions[:, -1] = np.nan, np.nan
        positions[0, 0] = INF
    if seed % 7 == 0:
        boxes[:, -1] = [-HUGE, -HUGE, -HUGE, HUGE, HUGE, 1]
    if seed % 11 == 0:
        positions[0] = 0.5
    return boxes, positions


@pytest.mark.slow
@pytest.mark.parametrize("at_once", [3, 500_000])
def test_the_pairs_are_those_of_all_comparisons(monkeypatch, at_once):
    monkeypatch.setattr(broad, "_CANDIDATES_AT_ONCE", at_once)
    found = 0
    for seed in range(30):
        boxes, positions = boxes_and_positions(seed)
        ids = 7 * np.arange(1, boxes.shape[1] + 1, dtype=np.int64)[::-1]
        queries = BoxQueries(boxes, positions, ids)
        for numbers, holds in (
            (queries.all_above().numbers, above),
            (queries.all_below().numbers, below),
            (queries.all_inside().numbers, inside),
        ):
            expected = [
                int(a) * ID_FACTOR + int(b)
                for a, box in zip(ids, boxes.T, strict=True)
                for b, at in zip(ids, positions.T, strict=True)
                if a != b and holds(box, at)
            ]
            assert numbers == expected, (seed, holds)
            found += len(numbers)
    assert found > 1000
