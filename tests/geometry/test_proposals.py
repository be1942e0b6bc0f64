"""What FCL proposes for a few pairs is proved: a verdict is what the signed distance says."""

from __future__ import annotations

import numpy as np
import pytest

from ssduck.geometry.proofs.proposals import Proposer, decide_by_proposals
from ssduck.geometry.proofs.verdicts import ABOVE, BELOW, UNDECIDED
from ssduck.geometry.solids import solid_of
from tests.support import pairs
from tests.support.pairs import gap

KINDS = ("sphere", "box", "cylinder", "capsule", "ellipsoid", "hull")
BOUNDS = (-1e-6, 0.0, 1e-3, 0.1)


def decisions(two, bound, spoil=None):
    """Returns the decisions on pairs of shapes, and their signed distances."""
    shapes = [shape for pair in two for shape in pair]
    solids, indices = [solid_of(one.geometry) for one in shapes], np.arange(len(shapes))
    cores, proposer = pairs.bodies(shapes), Proposer(solids, indices)
    first = indices[::2]
    known = proposer.interiors.are_known
    first = first[known[first] & known[first + 1]]
    placed = [one.placed() for one in shapes]
    positions = np.array([one.position for one in placed])
    matrices = np.array([one.matrix for one in placed])
    proposed = proposer.propose(positions, matrices, first, first + 1)
    if spoil is not None:
        proposed = spoil(*proposed)
    bounds = np.full(len(first), bound)
    found = decide_by_proposals(cores, proposer.interiors, proposed, first, first + 1, bounds)
    gaps = np.array([gap(shapes[one], shapes[one + 1]).distance for one in first.tolist()])
    return found, gaps


def check(found, gaps, bound):
    assert not (gaps[found.verdicts == BELOW] >= bound).any()
    assert not (gaps[found.verdicts == ABOVE] <= bound).any()
    assert (found.room <= np.abs(gaps - bound) + 1e-9).all()


def random_pairs(seed, each):
    random = np.random.default_rng(seed)
    both = [(one, other) for one in KINDS for other in KINDS for _ in range(each)]
    return [pairs.pair(kinds, int(random.integers(1 << 31))) for kinds in both]


@pytest.mark.parametrize("bound", BOUNDS)
def test_verdicts_and_rooms_are_what_gaps_say(bound):
    found, gaps = decisions(random_pairs(5, 6), bound)
    check(found, gaps, bound)
    far = np.abs(gaps - bound) > 1e-3
    assert (found.verdicts[far] != UNDECIDED).mean() > 0.7


@pytest.mark.parametrize("bound", BOUNDS)
@pytest.mark.parametrize("size", [1e-9, 1e-3, 0.1, 10.0])
def test_wrong_proposals_give_no_wrong_verdict(bound, size):
    random = np.random.default_rng(3)

    def spoil(points, directions):
        noise = random.normal(size=points.shape) * size
        return points + noise, directions + random.normal(size=directions.shape) * size

    check(*decisions(random_pairs(6, 3), bound, spoil), bound)
