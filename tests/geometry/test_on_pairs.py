"""All pairs of which one is on the other, found at once, are what is found pair by pair."""

import math

import numpy as np
import pybullet
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ssduck
from ssduck.geometry.proofs.footprints import OUTSIDE, OVER, ground_boxes, over_verdicts
from ssduck.geometry.proofs.verdicts import UNDECIDED
from ssduck.geometry.solids import solid_of
from ssduck.schema import ID_FACTOR
from tests.geometry.test_colliding import fill
from tests.support.cases import sampled
from tests.support.pairs import geometry
from tests.support.solids import box as solid_box
from tests.support.solids import narrow

KINDS = ("box", "sphere", "capsule", "cylinder", "hull")


def found(client):
    """Returns the pairs that are found at once, and those pair by pair, in two new worlds."""
    at_once, one_by_one = ssduck.World.attach(client), ssduck.World.attach(client)
    for world in (at_once, one_by_one):
        world.snapshot.request_tables(("shapes",))
        world.tick()
    numbers = at_once.snapshot.shapes().all_on().numbers
    shapes = one_by_one.snapshot.shapes()
    ids = [entity.id for entity in one_by_one]
    expected = [(a, b) for a in ids for b in ids if a != b and shapes.on(a, b)]
    return [divmod(number, ID_FACTOR) for number in numbers], expected


def box(client, place, half, turn=(0, 0, 0, 1)):
    shape = pybullet.createCollisionShape(
        pybullet.GEOM_BOX, halfExtents=half, physicsClientId=client
    )
    pybullet.createMultiBody(1, shape, -1, place, turn, physicsClientId=client)


@pytest.mark.slow
@sampled("seed", range(12), every=4)
@pytest.mark.parametrize("kinds", [("box",), ("hull",), KINDS, ("plane", *KINDS)], ids=str)
def test_at_once_is_one_by_one(client, kinds, seed):
    fill(client, [kinds[n % len(kinds)] if n else kinds[0] for n in range(24)], seed, side=0.9)
    at_once, one_by_one = found(client)
    assert at_once == one_by_one


@pytest.mark.slow
@given(
    tilt=st.one_of(
        st.sampled_from([0.0, 30.0, 90.0, 45.0, 30 - 1e-7, 30 + 1e-7]), st.floats(0, 180)
    ),
    spin=st.sampled_from([0.0, 0.3, math.pi / 4]),
    depth=st.sampled_from([0.0, 1e-12, 1e-10, 1e-9, 1e-6, 1e-3, 0.02, -1e-10, -1e-9, -5e-4, -2e-3]),
    along=st.one_of(
        st.sampled_from([0.0, 0.5, 0.5 + 1e-9, 0.5 - 1e-9, 0.51, 0.49]), st.floats(0, 1)
    ),
)
def test_boxes_at_the_boundaries(tilt, spin, depth, along):
    """A box on a tilted one, just in or above it, about 30 degrees, about the edge."""
    client = pybullet.connect(pybullet.DIRECT)
    try:
        turn = pybullet.getQuaternionFromEuler((math.radians(tilt), 0, 0))
        up = np.array(pybullet.getMatrixFromQuaternion(turn)).reshape(3, 3)[:, 2]
        across = np.array(pybullet.getMatrixFromQuaternion(turn)).reshape(3, 3)[:, 0]
        turned = pybullet.multiplyTransforms(
            (0, 0, 0), turn, (0, 0, 0), pybullet.getQuaternionFromEuler((0, 0, spin))
        )[1]
        box(client, (0, 0, 0), (0.5, 0.5, 0.25), turn)
        box(client, up * (0.35 - depth) + across * along, (0.1, 0.1, 0.1), turned)
        at_once, one_by_one = found(client)
        assert at_once == one_by_one
    finally:
        pybullet.disconnect(client)


@pytest.mark.parametrize("kind", ["box", "cylinder", "capsule", "hull"])
def test_centres_over_footprints_are_what_single_pairs_say(kind):
    random = np.random.default_rng(5)
    turns = random.normal(size=(300, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    shape = geometry(kind, random, True)
    lower = (shape, np.zeros(3), turns[0])
    reach = solid_of(shape).bounding_radius
    uppers = [
        (solid_box(0.02, 0.02, 0.02), (*random.uniform(-reach, reach, 2), 1.0), turn)
        for turn in turns[1:]
    ]
    scene = narrow([lower], *([upper] for upper in uppers))
    a, b = np.zeros(len(uppers), np.intp), np.arange(1, len(uppers) + 1)
    tick, starts = scene.arrays, np.array(scene.starts)
    expected = np.array([scene.is_over(0, int(other)) for other in b])
    centres = sum(ground_boxes(tick.boxes, starts, b)) / 2
    boxes = ground_boxes(tick.boxes, starts, a)
    verdicts = over_verdicts(tick, starts, a, centres)
    with_boxes = over_verdicts(tick, starts, a, centres, boxes)
    assert ((with_boxes == verdicts) | (verdicts == UNDECIDED)).all()
    assert expected[verdicts == OVER].all()
    assert not expected[verdicts == OUTSIDE].any()
    assert np.count_nonzero(verdicts == UNDECIDED) < len(b) / 10
    assert 0 < expected.sum() < len(b)
