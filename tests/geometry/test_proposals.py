"""What FCL proposes for a few pairs is proved: a verdict is what the signed distance says."""

import numpy as np
import pytest

from ssduck.geometry.proofs.gjk import tolerances
from ssduck.geometry.proofs.proposals import Proposer, gap_bounds
from ssduck.geometry.proofs.verdicts import ABOVE, BELOW, UNDECIDED, Decisions
from ssduck.geometry.solids import SolidsOfShapes, solid_of
from tests.support import pairs
from tests.support.pairs import gap

KINDS = ("sphere", "box", "cylinder", "capsule", "ellipsoid", "hull")
BOUNDS = (-1e-6, 0.0, 1e-3, 0.1)


class Scene:
    """Pairs of shapes, each of which may move."""

    def __init__(self, two):
        shapes = [shape for pair in two for shape in pair]
        solids, indices = [solid_of(one.geometry) for one in shapes], np.arange(len(shapes))
        self.proposer = Proposer(SolidsOfShapes(solids, indices))
        known = self.proposer.interiors.are_known
        self.first = indices[::2][known[::2] & known[1::2]]
        self.pairs = self.first, self.first + 1
        self.place(shapes)

    def place(self, shapes):
        """Places the shapes anew."""
        self.shapes, self.cores = shapes, pairs.bodies(shapes)
        placed = [one.placed() for one in shapes]
        self.poses = (
            np.array([one.position for one in placed]),
            np.array([one.matrix for one in placed]),
        )

    def gaps(self):
        """Returns the signed distances of the pairs."""
        return np.array([gap(*self.shapes[one : one + 2]).distance for one in self.first.tolist()])


def decisions(two, bound, spoil=lambda asked: asked):
    """Returns the decisions on pairs of shapes, and their signed distances."""
    scene = Scene(two)
    asked = spoil(scene.proposer.ask(scene.poses, *scene.pairs))
    least, greatest = gap_bounds(scene.cores, scene.proposer.interiors, asked, *scene.pairs)
    bounds, error = np.full(len(scene.first), bound), tolerances(scene.cores, *scene.pairs)
    return Decisions.of_interval(least, greatest, bounds, error), scene.gaps()


def check(found, gaps, bound):
    assert not (gaps[found.verdicts == BELOW] >= bound).any()
    assert not (gaps[found.verdicts == ABOVE] <= bound).any()
    assert (found.room <= np.abs(gaps - bound) + 1e-9).all()


def random_pairs(seed, each):
    random = np.random.default_rng(seed)
    both = [(one, other) for one in KINDS for other in KINDS for _ in range(each)]
    return [pairs.pair(kinds, int(random.integers(1 << 31))) for kinds in both]


@pytest.mark.slow
@pytest.mark.parametrize("bound", BOUNDS)
def test_verdicts_and_rooms_are_what_gaps_say(bound):
    found, gaps = decisions(random_pairs(5, 6), bound)
    check(found, gaps, bound)
    far = np.abs(gaps - bound) > 1e-3
    assert (found.verdicts[far] != UNDECIDED).mean() > 0.7


@pytest.mark.slow
@pytest.mark.parametrize("bound", BOUNDS)
@pytest.mark.parametrize("size", [1e-9, 1e-3, 0.1, 10.0])
def test_wrong_proposals_give_no_wrong_verdict(bound, size):
    random = np.random.default_rng(3)

    def spoil(asked):
        spoiled = asked + random.normal(size=asked.shape) * size
        spoiled[random.random(len(asked)) < 0.5, 2] = 0.0  # as if they did not meet
        return spoiled

    check(*decisions(random_pairs(6, 3), bound, spoil), bound)
