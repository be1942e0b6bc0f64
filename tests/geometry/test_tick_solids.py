"""What belongs to one shape of a tick is what arrays of all of them say."""

import gc
import math
import weakref

import numpy as np
import pytest

from ssduck.geometry.shapes import Geometry
from ssduck.geometry.solids import solid_of
from ssduck.geometry.tick_shapes import ShapeTable
from ssduck.geometry.tick_solids import ShapePlaces, TickSolids

COUNT = 80
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
    shapes = ShapeTable(SOLIDS, np.arange(COUNT) % len(SOLIDS), np.arange(COUNT))
    return lambda: TickSolids(shapes, places)


def test_each_shape_is_what_arrays_say(make_tick):
    tick = make_tick()
    for shape in range(COUNT):
        solid, position = SOLIDS[shape % len(SOLIDS)], tick.places.positions[shape]
        is_known = bool(tick.are_finite[shape]) and solid.is_known
        assert tick.are_known[shape] == is_known
        assert tick.corners[shape] == tick.places.boxes[shape].tolist()
        if not is_known:
            continue
        matrix = tick.arrays.matrices[shape]
        for found, local in (
            (tick.centres, solid.centre),
            (tick.inscribed_centres, solid.inscribed_centre),
        ):
            assert found[shape] == pytest.approx((position + matrix @ local).tolist(), abs=1e-12)
        assert tick.placed(shape).matrix == pytest.approx(matrix, abs=1e-12)
        assert tick.rank(shape)[:4] == (solid.key, *position.tolist())


def test_no_cycle_of_references_keeps_a_tick(make_tick):
    tick = make_tick()
    for shape in range(COUNT):
        assert len(tick.corners[shape]) == 6
    assert tick.are_known[0]
    assert tick.placed(0).solid is SOLIDS[0]
    assert (tick.centres[0], tick.rank(0)) != ([], ())
    kept = weakref.ref(tick)
    gc.disable()
    try:
        del tick
        assert kept() is None
    finally:
        gc.enable()
