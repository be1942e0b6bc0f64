"""What decided a pair at a tick is tried first at the next one, and never changes a verdict."""

from __future__ import annotations

import numpy as np
import pybullet
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ssduck
from ssduck.geometry.proofs.cores import PlacedCores
from ssduck.geometry.proofs.gjk import classify_gaps
from ssduck.geometry.proofs.verdicts import ABOVE, BELOW, UNDECIDED
from ssduck.geometry.proofs.witnesses import KeptWitnesses
from tests.geometry.test_colliding import fill
from tests.support import pairs
from tests.support.cases import sampled
from tests.support.pairs import Shape, gap
from tests.support.solids import box

BOUNDS = (-1e-6, 0.0, 1e-3, 0.1)
KINDS = ("sphere", "box", "cylinder", "capsule", "ellipsoid", "hull", "flat")


class Ticks:
    """Pairs of shapes that move, and the witnesses of the tick before."""

    def __init__(self, bound):
        self.bound = bound
        self.kept = KeptWitnesses()

    def verdicts(self, two):
        """Returns the verdicts with witnesses, and those without."""
        cores = pairs.bodies([shape for pair in two for shape in pair])
        first = np.arange(0, 2 * len(two), 2)
        alone = classify_gaps(cores, first, first + 1, self.bound)
        return classify_gaps(cores, first, first + 1, self.bound, self.kept), alone


def check(ticks, two):
    """Checks verdicts against the signed distances; returns them."""
    with_witnesses, alone = ticks.verdicts(two)
    gaps = np.array([gap(*pair).distance for pair in two])
    for found in (with_witnesses, alone):
        assert not (gaps[found == BELOW] >= ticks.bound).any()
        assert not (gaps[found == ABOVE] <= ticks.bound).any()
    # What only a witness, or only the steps decide, is at the bound.
    differ = with_witnesses != alone
    assert (np.abs(gaps[differ] - ticks.bound) < 1e-6).all()
    return with_witnesses


def moved(shape, random, far):
    """Returns a shape that has moved a little."""
    turn = shape.quaternion + random.normal(size=4) * far
    return shape.at(shape.position + random.normal(size=3) * far, turn / np.linalg.norm(turn))


@pytest.mark.slow
@given(
    seed=st.integers(0, 2**32),
    bound=st.sampled_from(BOUNDS),
    far=st.sampled_from([0.0, 1e-9, 1e-4, 0.01, 0.3]),
    kinds=st.lists(st.tuples(st.sampled_from(KINDS), st.sampled_from(KINDS)), min_size=1),
)
def test_verdicts_of_shapes_that_move_are_what_gaps_say(seed, bound, far, kinds):
    random = np.random.default_rng(seed)
    two = [pairs.pair(both, int(random.integers(1 << 31))) for both in kinds]
    ticks = Ticks(bound)
    for _ in range(4):
        check(ticks, two)
        two = [tuple(moved(shape, random, far) for shape in pair) for pair in two]


@pytest.mark.parametrize("bound", BOUNDS)
@pytest.mark.parametrize("off", [0.0, 1e-12, 1e-9, 2e-9, 1e-8, 1e-6, 1e-3])
@pytest.mark.parametrize("turn", range(3))
def test_pairs_that_move_to_the_bound(bound, off, turn):
    """From either side to just inside, at, or just outside of the bound."""
    turns = [np.array(q, float) / np.linalg.norm(q) for q in ((1, 0, 0, 0), (1, 1, 0, 0))]
    first = Shape("box", box(), np.zeros(3), turns[0])
    way = [np.array([1.0, 0, 0]), np.array([0, 0.6, 0.8]), np.array([0.48, 0.6, 0.64])][turn]
    other = first.at((0, 0, 0), turns[turn > 0])
    # The distance of the centres at which the gap is 0, along the way, by bisection.
    low, high = 0.0, 4.0
    for _ in range(80):
        middle = (low + high) / 2
        is_apart = gap(first, other.at(way * middle)).distance > bound
        low, high = (low, middle) if is_apart else (middle, high)
    for start in (low - 0.05, low + 0.05):
        for sign in (-1, 1):
            ticks = Ticks(bound)
            check(ticks, [(first, other.at(way * start))])
            check(ticks, [(first, other.at(way * (low + sign * off)))])


@pytest.fixture
def supports(monkeypatch):
    """How many support points are computed in each call."""
    counts = []
    compute = PlacedCores.support_points

    def counted(self, shapes, directions):
        counts.append(len(shapes))
        return compute(self, shapes, directions)

    monkeypatch.setattr(PlacedCores, "support_points", counted)
    return counts


def test_pairs_that_move_together_take_one_step(supports):
    random = np.random.default_rng(5)
    two = [pairs.pair((a, b), int(random.integers(1000))) for a in KINDS for b in KINDS] * 3
    for bound in (-1e-6, 0.05):
        ticks = Ticks(bound)
        cores = pairs.bodies([shape for pair in two for shape in pair])
        first = np.arange(0, 2 * len(two), 2)
        before = classify_gaps(cores, first, first + 1, bound, ticks.kept)
        steps = len(supports)
        supports.clear()
        shift = np.array([0.5, 0.25, -1.0])
        two = [tuple(s.at(s.position + shift) for s in pair) for pair in two]
        cores = pairs.bodies([shape for pair in two for shape in pair])
        after = classify_gaps(cores, first, first + 1, bound, ticks.kept)
        assert after.tolist() == before.tolist()
        left = int((before == UNDECIDED).sum())
        assert supports[0] == 2 * len(two)
        assert sum(supports[1:]) <= 2 * 60 * left  # only what the steps never decide
        assert steps > 2
        supports.clear()


CONDITIONS = ("collides(a.this, b.this)", "near(a.this, b.this, 0.05)", "touching(a.this, b.this)")
CONDITIONS += ("collides(a.this, b.this, 0.01)", "on(a.this, b.this)")
MIXED = ["box"] * 8 + ["sphere"] * 4 + ["capsule"] * 4 + ["cylinder"] * 4 + ["hull"] * 8 + ["plane"]


@pytest.mark.slow
@sampled("condition", CONDITIONS, every=3)
def test_a_world_that_moves_answers_as_one_that_was_never_asked(client, condition):
    query = f"SELECT id(a.this), id(b.this) FROM a=w, b=w WHERE {condition} AS list;"
    fill(client, MIXED, seed=4, side=0.9)
    random = np.random.default_rng(6)
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("w", ssduck.World.attach(client))
        for far in (0.0, 1e-4, 1e-3, 0.02, 0.0, 0.3):
            for body in range(len(MIXED)):
                place, turn = pybullet.getBasePositionAndOrientation(body, client)
                place, turn = (
                    np.array(v) + random.normal(size=len(v)) * far for v in (place, turn)
                )
                turn = turn / np.linalg.norm(turn)
                pybullet.resetBasePositionAndOrientation(body, place, turn, client)
            world.tick()
            found = ss.eval(query)
            with ssduck.Interpreter() as other:
                other.add_variable("w", ssduck.World.attach(client))
                assert other.eval(query) == found
                one_by_one = query.replace(" AS list", " AND z(a.this) > -1e9 AS list")
                assert other.eval(one_by_one) == found
