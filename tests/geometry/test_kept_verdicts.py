"""Verdicts that are kept while shapes move by less than their room, and those that FCL proposes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssduck.geometry.proofs.gjk import tolerances
from ssduck.geometry.proofs.proposals import Proposer, gap_bounds
from ssduck.geometry.proofs.verdicts import (
    ABOVE,
    BELOW,
    UNDECIDED,
    Decisions,
    KeptVerdicts,
    ShapePoses,
)
from ssduck.geometry.solids import SolidsOfShapes, solid_of
from tests.support import pairs
from tests.support.pairs import gap

BOTH = np.array([0]), np.array([1])
STILL = np.eye(3)


def poses(*centres, matrices=None, radii=(1.0, 1.0)):
    matrices = np.stack([STILL] * len(centres)) if matrices is None else np.stack(matrices)
    rotations = matrices.transpose(1, 2, 0).reshape(9, -1).copy()
    return ShapePoses(np.array(centres, float).T.copy(), rotations, np.array(radii))


def turned(angle, axis=(0.0, 0.0, 1.0)):
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def motion(before, after):
    return float(after.motion_since(before, *BOTH)[0])


# -- motions -----------------------------------------------------------------------------------


def test_a_half_space_that_stands_still_does_not_move_and_one_that_turns_moves_without_bound():
    radii = (np.inf, 1.0)
    before = poses((0, 0, 0), (0, 0, 1), radii=radii)
    after = poses((0, 0, 0), (0, 0, 1.25), radii=radii)
    assert motion(before, after) == pytest.approx(0.25, abs=1e-12)
    tilted = poses((0, 0, 0), (0, 0, 1), matrices=(turned(1e-9, (1, 0, 0)), STILL), radii=radii)
    assert motion(before, tilted) == np.inf


@given(seed=st.integers(0, 2**32), far=st.sampled_from([1e-6, 1e-3, 0.1, 3.0]))
def test_no_point_moves_farther(seed, far):
    random = np.random.default_rng(seed)
    radii = random.uniform(0.1, 2.0, 2)
    befores, afters = (
        poses(
            *random.normal(size=(2, 3)) * size,
            matrices=[turned(random.normal() * size, random.normal(size=3)) for _ in range(2)],
            radii=radii,
        )
        for size in (far, far)
    )
    inner = random.normal(size=(2, 200, 3))
    inner *= (radii[:, None] / np.linalg.norm(inner, axis=2))[..., None]
    moved = [
        (inner[k] @ after.rotations[:, k].reshape(3, 3).T + after.centres[:, k])
        - (inner[k] @ before.rotations[:, k].reshape(3, 3).T + before.centres[:, k])
        for before, after in [(befores, afters)]
        for k in range(2)
    ]
    relative = np.linalg.norm(moved[0] - moved[1], axis=1)
    assert relative.max() <= motion(befores, afters) + 1e-12


# -- what is kept ------------------------------------------------------------------------------


def kept(verdict, room):
    verdicts = KeptVerdicts()
    decisions = Decisions(np.array([verdict], np.int8), np.array([room]))
    verdicts.keep(poses((0, 0, 0), (1, 0, 0)), *BOTH, decisions)
    return verdicts


@pytest.mark.parametrize("verdict", [ABOVE, BELOW])
@pytest.mark.parametrize(("step", "holds"), [(0.24, True), (0.25, False), (0.26, False)])
def test_a_verdict_holds_up_to_its_room(verdict, step, holds):
    found = kept(verdict, 0.25).find(poses((step, 0, 0), (1, 0, 0)), *BOTH)
    assert found.verdicts.tolist() == [verdict if holds else UNDECIDED]
    if holds:
        assert found.room[0] == pytest.approx(0.25 - step)


@pytest.mark.parametrize("moved", [0, 1])
def test_a_verdict_without_room_holds_for_poses_that_are_the_same_to_the_last_bit(moved):
    here, there = poses((0, 0, 0), (1, 0, 0)), poses((0, 0, 0), (1, 0, 0))
    assert kept(ABOVE, 0.0).find(here, *BOTH).verdicts.tolist() == [ABOVE]
    there.centres[2, moved] = 5e-324
    assert kept(ABOVE, 0.0).find(there, *BOTH).verdicts.tolist() == [UNDECIDED]
    here.rotations[0, moved] = np.nextafter(1.0, 0.0)
    assert kept(ABOVE, 0.0).find(here, *BOTH).verdicts.tolist() == [UNDECIDED]


def test_poses_that_are_not_known_decide_nothing():
    lost = poses((np.nan, 0, 0), (1, 0, 0))
    assert kept(ABOVE, 1.0).find(lost, *BOTH).verdicts.tolist() == [UNDECIDED]


# -- what FCL proposes for a few pairs is proved: a verdict is what the signed distance says -----

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
