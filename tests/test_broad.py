"""The broad phase finds the pairs that comparing all of them finds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ssduck.broad import meeting


def brute(boxes, apart=0.0):
    low, high = boxes[:3] - apart / 2, boxes[3:] + apart / 2
    meets = (low[:, :, None] <= high[:, None, :]).all(axis=0)
    here = (low <= high).all(axis=0)
    meets = meets & meets.T & here & here[:, None]
    return [(i, j) for i, j in np.argwhere(meets).tolist() if i < j]


def found(boxes, apart=0.0):
    pairs = zip(*(side.tolist() for side in meeting(boxes, apart)), strict=True)
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


@given(
    arrays(np.int8, (3, 12), elements=st.integers(-4, 4)),
    arrays(np.int8, (3, 12), elements=st.integers(-1, 30)),
)
def test_boxes_that_touch_meet(low, extent):
    """On a grid of whole numbers many boxes touch exactly; some have no inside."""
    boxes = np.vstack((low, low + extent)).astype(np.float64)
    assert found(boxes) == brute(boxes)


def test_boxes_of_all_sizes():
    rng = np.random.default_rng(1)
    low = rng.uniform(-50, 50, (3, 300))
    boxes = np.vstack((low, low + 10 ** rng.uniform(-5, 2, (3, 300))))
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
