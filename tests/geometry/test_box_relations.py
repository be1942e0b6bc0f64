"""Positions in and over boxes: the pairs are those of comparing every box with every position."""

import numpy as np
import pytest

from ssduck.geometry import box_relations
from ssduck.geometry.box_relations import BoxQueries
from ssduck.schema import ID_FACTOR

INF, HUGE = np.inf, 1e308


def above(box, at):
    return over(box, at) and at[2] >= box[5]


def below(box, at):
    return over(box, at) and 2 * at[2] < box[2] + box[5] and box[5] < INF


def inside(box, at):
    return all(box[axis] < at[axis] < box[axis + 3] for axis in range(3))


def over(box, at):
    return box[0] <= at[0] <= box[3] and box[1] <= at[1] <= box[4]


def scene(seed):
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
    monkeypatch.setattr(box_relations, "_CANDIDATES_AT_ONCE", at_once)
    found = 0
    for seed in range(30):
        boxes, positions = scene(seed)
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
