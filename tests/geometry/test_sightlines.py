"""What is in the way between points, against points along the way and closed forms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ssduck.geometry.ray_casting import are_blocked
from ssduck.geometry.shapes import Geometry
from ssduck.geometry.solids import PlacedSolids, solid_of
from tests.support.pairs import held

RNG = np.random.default_rng(11)
CORNERS = RNG.normal(size=(15, 3)) * 0.3
SHAPES = {
    "box": Geometry.primitive("box", (0.5, 0.3, 0.7)),
    "sphere": Geometry.primitive("sphere", (0.4, 0, 0)),
    "cylinder": Geometry.primitive("cylinder", (0.3, 0.6, 0)),
    "capsule": Geometry.primitive("capsule", (0.2, 0.7, 0)),
    "ellipsoid": Geometry.primitive("ellipsoid", (0.5, 0.3, 0.4)),
    "hull": Geometry.hull(CORNERS),
    "plane": Geometry.primitive("plane", (0.6, 0.0, 0.8)),
}


def placed(geometry, place=(0, 0, 0), turn=None):
    matrix = (turn or Rotation.identity()).as_matrix()
    return PlacedSolids(
        [solid_of(geometry)],
        np.array([place], float),
        matrix[None],
        np.zeros((1, 6)),
        np.zeros(1, int),
    )


@pytest.mark.parametrize("kind", SHAPES)
def test_ways_through_convex_shapes(kind):
    turn, place = Rotation.random(rng=5), np.array([0.1, -0.2, 0.3])
    start = place + turn.apply([0.9, 0.7, 1.1])
    ends = place + RNG.uniform(-1.2, 1.2, (600, 3))
    share = np.linspace(0, 1, 400)[:, None, None]
    along = turn.inv().apply((start + share * (ends - start) - place).reshape(-1, 3))
    expected = held(SHAPES[kind], along.reshape(400, 600, 3)).any(axis=0)
    found = are_blocked(placed(SHAPES[kind], place, turn), start, ends)
    assert 30 < expected.sum() < 570
    assert not (expected & ~found).any()
    assert (found & ~expected).sum() <= 6  # what is thinner than the steps along the way


@pytest.mark.parametrize("kind", SHAPES)
def test_what_holds_the_beginning_is_not_in_the_way(kind):
    start = np.array([0.0, 0.0, -0.1])
    assert held(SHAPES[kind], start)
    ends = RNG.uniform(-2, 2, (100, 3))
    assert not are_blocked(placed(SHAPES[kind]), start, ends).any()


TRIANGLE = Geometry(
    "mesh",
    (0, 0, 0),
    np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]),
    np.array([[0, 1, 2]], np.int32),
)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("end", "blocked"),
    [((0.2, 0.2, -1), True), ((0.7, 0.7, -1), False), ((0.2, 0.2, 0.001), False)]
    + [((0.2, 0.2, -0.001), True), ((-0.01, 0.2, -1), False), ((0.2, 0.2, 0.0), False)],
)
def test_a_triangle_is_in_the_way_from_either_side(end, blocked, side):
    x, y, z = end
    start = np.array([x, y, side])
    assert are_blocked(placed(TRIANGLE), start, np.array([[x, y, z * side]])).tolist() == [blocked]


def test_a_surface_begins_at_a_point():
    """What begins where a way ends is not in it, what the end is in is."""
    box, start = placed(SHAPES["box"]), np.array([1.0, 0, 0])
    ends = np.array([[0.25, 0, 0], [0.25 - 1e-6, 0, 0], [0.25 + 1e-6, 0, 0], [0, 0, 0], [-1, 0, 0]])
    assert are_blocked(box, start, ends).tolist() == [False, True, False, True, True]
    along = np.array([[-1, 0.15 + 1e-6, 0], [-1, 0.15 - 1e-6, 0]])
    beside = np.array([1, 0.15 + 1e-6, 0])
    assert are_blocked(box, beside, along[:1]).tolist() == [False]
    assert are_blocked(box, along[1] * [-1, 1, 1], along[1:]).tolist() == [True]


def test_nothing_is_in_the_way_of_nothing():
    assert are_blocked(PlacedSolids.empty(), np.zeros(3), np.ones((2, 3))).tolist() == [
        False,
        False,
    ]
    assert are_blocked(placed(SHAPES["box"]), np.ones(3), np.zeros((0, 3))).tolist() == []


def test_bunches_change_nothing(monkeypatch):
    ends = RNG.uniform(-1, 1, (50, 3))
    whole = are_blocked(placed(SHAPES["hull"]), np.ones(3), ends)
    monkeypatch.setattr("ssduck.geometry.ray_casting.PAIRS_AT_ONCE", 1)
    assert np.array_equal(are_blocked(placed(SHAPES["hull"]), np.ones(3), ends), whole)
