"""What FCL proposes for a few pairs is proved: a verdict is what the signed distance says.

What is kept of a pair is tried first when shapes have moved.
"""

from __future__ import annotations

import numpy as np
import pytest

from ssduck.geometry.proofs import kept_columns, proposals
from ssduck.geometry.proofs.gjk import tolerances
from ssduck.geometry.proofs.kept_proposals import KeptProposals, proved_again
from ssduck.geometry.proofs.pair_proofs import PlacedInterior, pair_proof
from ssduck.geometry.proofs.proposals import Proof, Proposals, Proposer, proposals_of
from ssduck.geometry.proofs.verdicts import ABOVE, BELOW, UNDECIDED, Decisions
from ssduck.geometry.solids import solid_of
from tests.support import pairs
from tests.support.cases import sampled
from tests.support.pairs import gap

KINDS = ("sphere", "box", "cylinder", "capsule", "ellipsoid", "hull")
BOUNDS = (-1e-6, 0.0, 1e-3, 0.1)


class Scene:
    """Pairs of shapes, each of which may move."""

    def __init__(self, two):
        shapes = [shape for pair in two for shape in pair]
        solids, indices = [solid_of(one.geometry) for one in shapes], np.arange(len(shapes))
        self.proposer = Proposer(solids, indices)
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


def decisions(two, bound, spoil=lambda proposals: proposals):
    """Returns the decisions on pairs of shapes, and their signed distances."""
    scene = Scene(two)
    proposed = spoil(proposals_of(scene.proposer.ask(scene.poses, *scene.pairs)))
    proof = Proof(scene.cores, scene.proposer.interiors, proposed, *scene.pairs)
    bounds, error = np.full(len(scene.first), bound), tolerances(scene.cores, *scene.pairs)
    return Decisions.of_interval(proof.least, proof.greatest, bounds, error), scene.gaps()


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

    def spoil(one):
        points = one.points + random.normal(size=one.points.shape) * size
        directions = one.directions + random.normal(size=one.directions.shape) * size
        return Proposals(points, directions, one.meet ^ (random.random(len(one.meet)) < 0.5))

    check(*decisions(random_pairs(6, 3), bound, spoil), bound)


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.0, 1e-3, 0.1, 10.0])
def test_whatever_is_kept_of_pairs_bounds_their_signed_distances(size):
    scene, random = Scene(random_pairs(12, 4)), np.random.default_rng(13)
    proposed = proposals_of(scene.proposer.ask(scene.poses, *scene.pairs))
    interiors, gaps = scene.proposer.interiors, scene.gaps()
    columns = Proof(scene.cores, interiors, proposed, *scene.pairs).columns
    columns += random.normal(size=columns.shape) * size
    columns[:3] /= np.linalg.norm(columns[:3], axis=0)
    least, greatest = proved_again(scene.cores, interiors, *scene.pairs, columns)
    error = tolerances(scene.cores, *scene.pairs)
    assert (least - error <= gaps).all()
    assert (gaps <= greatest + error).all()
    if size < 0.1:  # and closely
        assert (least > gaps - size - 1e-6)[gaps > 0.0].mean() > 0.7
        assert (np.isfinite(greatest) & (greatest < 0.0))[gaps < -0.02].mean() > 0.7


@pytest.mark.slow
def test_points_without_a_direction_between_them_are_kept_with_some_direction():
    scene = Scene(random_pairs(14, 2))
    centres = np.array([scene.cores.centres[:, side] for side in scene.pairs])
    nowhere, apart = np.zeros_like(centres[0]), np.zeros(len(scene.first), dtype=bool)
    interiors, gaps = scene.proposer.interiors, scene.gaps()
    proof = Proof(scene.cores, interiors, Proposals(centres, nowhere, apart), *scene.pairs)
    assert np.linalg.norm(proof.columns[:3], axis=0) == pytest.approx(np.ones(len(gaps)))
    again = proved_again(scene.cores, interiors, *scene.pairs, proof.columns)
    error = tolerances(scene.cores, *scene.pairs)
    for least, greatest in ((proof.least, proof.greatest), again):
        assert (least - error <= gaps).all()
        assert (gaps <= greatest + error).all()


def moved(shapes, random, far):
    """Returns shapes that have moved and turned by about a distance."""
    result = []
    for one in shapes:
        turn = one.quaternion + random.normal(size=4) * far
        place = one.position + random.normal(size=3) * far
        result.append(one.at(place, turn / np.linalg.norm(turn)))
    return result


@pytest.mark.slow
@sampled("far", [1e-4, 2e-3, 0.05], every=3)
def test_what_is_kept_gives_no_wrong_verdict_and_fcl_is_asked_about_the_rest(far, monkeypatch):
    scene, random = Scene(random_pairs(7, 4)), np.random.default_rng(8)
    asked, ask = [], scene.proposer.ask
    monkeypatch.setattr(
        scene.proposer,
        "ask",
        lambda poses, first, second: asked.append(len(first)) or ask(poses, first, second),
    )
    kept, keep = [], KeptProposals.keep
    monkeypatch.setattr(
        KeptProposals,
        "keep",
        lambda this, keys, *rest: kept.append(len(keys)) or keep(this, keys, *rest),
    )
    for tick in range(8):
        bound = BOUNDS[tick % 2]  # whatever the condition
        found = scene.proposer.decide(
            scene.cores, scene.poses, *scene.pairs, np.full(len(scene.first), bound)
        )
        gaps = scene.gaps()
        check(found, gaps, bound)
        far_pairs = np.abs(gaps - bound) > 1e-3
        assert (found.verdicts[far_pairs] != UNDECIDED).mean() > 0.7
        scene.place(moved(scene.shapes, random, far))
    assert asked[0] == len(scene.first)
    assert kept == asked  # what proves a verdict again stays as it is
    if far < 0.05:
        assert sum(asked[1:]) < 0.5 * (len(asked) - 1) * len(scene.first)


@pytest.mark.parametrize(("least", "expected"), [(1, 1), (2, 5)])
def test_shapes_that_begin_to_overlap_or_part_are_decided_by_what_is_kept(
    least, expected, monkeypatch
):
    """A ball above a box goes down into it, and up again; of fewer pairs, nothing is kept."""
    monkeypatch.setattr(proposals, "_MIN_KEPT", least)
    random = np.random.default_rng(1)
    box, ball = (pairs.Shape(kind, pairs.geometry(kind, random, True), np.zeros(3),
                             np.array([1.0, 0.0, 0.0, 0.0])) for kind in ("box", "sphere"))  # fmt: skip
    reach = box.geometry.size[2] / 2 + ball.geometry.size[0]
    scene = Scene([(box, ball)])
    asked, ask = [], scene.proposer.ask
    scene.proposer.ask = lambda *pair: asked.append(1) or ask(*pair)
    for height in (2e-3, -2e-3, -4e-3, 2e-3, 4e-3):
        scene.place([box, ball.at((1e-3, 0.0, reach + height))])
        found = scene.proposer.decide(scene.cores, scene.poses, *scene.pairs, np.zeros(1))
        assert found.verdicts.tolist() == [ABOVE if height > 0.0 else BELOW]
        assert found.room[0] == pytest.approx(abs(height), abs=1e-6)
    assert len(asked) == expected


@pytest.mark.parametrize("spoilt", [0.0, 1e-3, 0.1])
def test_pairs_are_proved_one_after_another_as_together(spoilt):
    scene, random = Scene(random_pairs(9, 4)), np.random.default_rng(2)
    asked = scene.proposer.ask(scene.poses, *scene.pairs)
    asked[:, 2] += spoilt * random.normal(size=(len(asked), 3)) * asked[:, 2].any(axis=1)[:, None]
    asked[:, :2] += spoilt * random.normal(size=(len(asked), 1, 3))
    proof = Proof(scene.cores, scene.proposer.interiors, proposals_of(asked), *scene.pairs)
    rooms = []
    for place, (first, second) in enumerate(zip(*(s.tolist() for s in scene.pairs), strict=True)):
        shapes = (
            PlacedInterior(
                scene.proposer.interiors.single(shape),
                scene.cores.rotations[:, shape].tolist(),
                scene.cores.centres[:, shape].tolist(),
            )
            for shape in (first, second)
        )
        on_first, on_second, towards = asked[place].tolist()
        found = pair_proof(*shapes, (on_first, on_second), towards)
        assert found.least == pytest.approx(proof.least[place], abs=1e-12)
        assert found.greatest == pytest.approx(proof.greatest[place], abs=1e-12)
        assert found.column == pytest.approx(proof.columns[:, place], abs=1e-12)
        rooms.append(found.greatest)
    assert np.isfinite(rooms).mean() > 0.05
    assert {True, False} == set(proof.meet.tolist())


@pytest.mark.slow
@pytest.mark.parametrize("far", [1e-3, 0.02])
def test_the_way_of_proving_changes_no_verdict(far, monkeypatch):
    random, verdicts = np.random.default_rng(4), {}
    ticks = [random_pairs(11, 2)]
    for _ in range(6):
        ticks.append([moved(pair, random, far) for pair in ticks[-1]])
    for most in (0, 7, 1 << 20):
        monkeypatch.setattr(proposals, "_MAX_SINGLE", most)
        scene = Scene(ticks[0])
        verdicts[most] = []
        for tick in ticks:
            scene.place([shape for pair in tick for shape in pair])
            bounds = np.full(len(scene.first), 1e-3)
            found = scene.proposer.decide(scene.cores, scene.poses, *scene.pairs, bounds)
            verdicts[most].append(found.verdicts.tolist())
    assert verdicts[0] == verdicts[7] == verdicts[1 << 20]


def test_the_number_of_pairs_whose_proposals_are_kept_is_bounded(monkeypatch):
    monkeypatch.setattr(kept_columns, "_MAX_PAIRS", 8)
    kept = KeptProposals()
    for start in (0, 6, 12):
        keys = np.arange(start, start + 6)
        directions = np.full((3, 6), float(start))
        kept.keep(keys, np.concatenate((directions, np.zeros((6, 6)))))
        places, columns = kept.find(np.arange(20))
        assert places.tolist() == keys.tolist()
        assert (columns[0] == start).all()
