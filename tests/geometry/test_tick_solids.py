"""What belongs to one shape of a tick is the same whether it is computed alone or with all."""

import gc
import math
import weakref

import numpy as np
import pytest

from ssduck.geometry.shapes import Geometry
from ssduck.geometry.solids import solid_of
from ssduck.geometry.tick_solids import (
    MAX_SINGLE,
    SINGLE_IN,
    ShapePlaces,
    ShapeSolids,
    TickSolids,
)

COUNT = 5 * MAX_SINGLE
SOLIDS = [
    solid_of(geometry)
    for geometry in (
        Geometry.primitive("box", (0.3, 0.2, 0.1)),
        Geometry.primitive("sphere", (0.2, 0, 0)),
        Geometry.primitive("cylinder", (0.1, 0.5, 0)),
        Geometry.hull([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 0.5]]),
        Geometry.hull([[0, 0, math.nan], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    )
]


@pytest.fixture
def make_tick():
    """Returns a function that makes the same tick anew."""
    rng = np.random.default_rng(5)
    positions, orientations = rng.normal(size=(COUNT, 3)), rng.normal(size=(COUNT, 4))
    orientations[: COUNT // 2] /= np.linalg.norm(orientations[: COUNT // 2], axis=1)[:, None]
    positions[3, 1], orientations[5, 2], orientations[7] = np.nan, np.inf, 0.0
    places = ShapePlaces(positions, orientations, rng.normal(size=(COUNT, 6)))
    shapes = ShapeSolids(SOLIDS, np.arange(COUNT) % len(SOLIDS))
    return lambda: TickSolids(shapes, places)


PARTS = {
    "are_known": lambda tick, shape: tick.are_known[shape],
    "corners": lambda tick, shape: tick.corners[shape],
    "centres": lambda tick, shape: tick.centres[shape],
    "inscribed_centres": lambda tick, shape: tick.inscribed_centres[shape],
    "rank": lambda tick, shape: tick.rank(shape),
    "matrix_rows": lambda tick, shape: tick.placed(shape).matrix_rows,
}


@pytest.mark.parametrize("part", PARTS.values(), ids=PARTS)
def test_alone_and_at_once(make_tick, part):
    at_once = make_tick()
    expected = [part(at_once, shape) for shape in range(COUNT)]
    for shape in range(COUNT):
        assert repr(part(make_tick(), shape)) == repr(expected[shape]), shape


def test_many_are_computed_at_once(make_tick, monkeypatch):
    calls = []
    of_all = TickSolids._all_corners
    monkeypatch.setattr(TickSolids, "_all_corners", lambda tick: calls.append(tick) or of_all(tick))
    tick = make_tick()
    for shape in range(MAX_SINGLE):
        assert len(tick.corners[shape]) == 6
    assert not calls
    assert tick.corners[MAX_SINGLE] == tick.boxes[MAX_SINGLE].tolist()
    assert tick.corners[COUNT - 1] == tick.boxes[COUNT - 1].tolist()
    assert len(calls) == 1


@pytest.mark.slow
def test_a_few_of_many_ticks_are_computed_alone(monkeypatch):
    count, calls = 100 * SINGLE_IN, []
    of_all = TickSolids._all_poses
    monkeypatch.setattr(TickSolids, "_all_poses", lambda tick: calls.append(tick) or of_all(tick))
    places = ShapePlaces(np.zeros((count, 3)), np.ones((count, 4)), np.zeros((count, 6)))
    tick = TickSolids(ShapeSolids(SOLIDS, np.zeros(count)), places)
    for shape in range(100):
        tick.rank(shape)
    assert not calls
    tick.rank(100)
    assert len(calls) == 1


def test_no_cycle_of_references_keeps_a_tick(make_tick):
    tick = make_tick()
    for part in PARTS.values():
        part(tick, 0)
    kept = weakref.ref(tick)
    gc.disable()
    try:
        del tick
        assert kept() is None
    finally:
        gc.enable()
