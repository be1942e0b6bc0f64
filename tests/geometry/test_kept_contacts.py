"""Verdicts on contact normals hold while shapes move less than their room; kept parts find them."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from ssduck.geometry.contact_support import MIN_UP
from ssduck.geometry.proofs import contact_directions, kept_parts
from ssduck.geometry.proofs.contact_directions import NOT_UPWARD, UPWARD, decide_upward
from ssduck.geometry.proofs.kept_parts import _COST, _CREDIT, _MAX_PARTS, _PAUSE, KeptParts
from ssduck.geometry.proofs.nearest_points import decide_upward_round
from tests.support import pairs
from tests.support.pairs import gap

KINDS = ("sphere", "box", "cylinder", "capsule", "ellipsoid", "hull")
COMBINATIONS = list(itertools.combinations_with_replacement(KINDS, 2))
HEIGHTS = (0.5, MIN_UP)


def made(kinds, count):
    return [pairs.pair(kinds, seed) for seed in range(count)]


def decided(two, min_height, decide=decide_upward, **more):
    cores = pairs.bodies([shape for pair in two for shape in pair])
    first = np.arange(0, 2 * len(two), 2)
    return decide(cores, first, first + 1, min_height, **more)


def moved(two, random, far):
    """Returns pairs whose second shape moves by a distance each."""
    ways = random.normal(size=(len(two), 3))
    ways *= np.broadcast_to(far, len(two))[:, None] / np.linalg.norm(ways, axis=1)[:, None]
    return [(a, b.at(b.position + way)) for (a, b), way in zip(two, ways, strict=True)]


@pytest.mark.slow
@pytest.mark.parametrize("decide", [decide_upward, decide_upward_round])
@pytest.mark.parametrize("min_height", HEIGHTS)
def test_a_verdict_holds_within_its_room(decide, min_height):
    random, checked, far_rooms = np.random.default_rng(5), 0, 0
    for kinds in COMBINATIONS:
        two = made(kinds, 16)
        found = decided(two, min_height, decide)
        assert (found.room[found.verdicts == 0] == 0.0).all()
        assert (found.room >= 0.0).all()
        places = np.flatnonzero(found.room > 0.0)
        far_rooms += int((found.room > 1e-2).sum())
        near = moved([two[n] for n in places], random, 0.99 * found.room[places])
        for (a, b), verdict in zip(near, found.verdicts[places].tolist(), strict=True):
            rises = -gap(a, b).normal[2]
            assert (rises >= min_height) == (verdict == UPWARD)
            checked += 1
    assert checked > 60
    assert far_rooms > 20


def test_rooms_are_not_much_smaller_than_needed():
    """A ball on a ball: the normal turns to 30 degrees when the upper one moves so far."""
    lower = pairs.Shape("sphere", pairs.geometry("sphere", np.random.default_rng(1), True),
                        np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))  # fmt: skip
    reach = lower.geometry.size[0] * 2.0
    upper = lower.at((0.0, 0.0, 0.98 * reach))
    room = float(decided([(lower, upper)], MIN_UP, decide_upward_round).room[0])
    aside = 0.98 * reach * 0.5
    assert 0.1 * aside < room < aside


@pytest.mark.slow
@pytest.mark.parametrize("min_height", HEIGHTS)
def test_kept_parts_change_no_verdict(min_height, monkeypatch):
    """They are used where shapes have moved since."""
    calls = []
    divide = contact_directions._divided

    def counted(triangles, *rest):
        calls.append(len(triangles.owners))
        return divide(triangles, *rest)

    monkeypatch.setattr(contact_directions, "_divided", counted)
    random, kept = np.random.default_rng(6), KeptParts()
    two = [pair for kinds in COMBINATIONS for pair in made(kinds, 8)]
    with_parts, without = [], []
    for _ in range(8):
        two = moved(two, random, 1e-3)
        calls.clear()
        known = decided(two, min_height, kept=kept)
        with_parts.append(sum(calls))
        calls.clear()
        anew = decided(two, min_height)
        without.append(sum(calls))
        both = (known.verdicts != 0) & (anew.verdicts != 0)
        assert (known.verdicts == anew.verdicts)[both].all()
        assert np.count_nonzero(known.verdicts) >= np.count_nonzero(anew.verdicts) - 2
        wrong = [
            n
            for n, (a, b) in enumerate(two)
            if known.verdicts[n]
            and (-gap(a, b).normal[2] >= min_height) != (known.verdicts[n] == UPWARD)
        ]
        assert wrong == []
    assert with_parts[0] == without[0] > 0
    assert sum(with_parts[4:]) < 0.5 * sum(without[4:])
    assert {UPWARD, NOT_UPWARD} <= set(known.verdicts.tolist())


@pytest.mark.slow
def test_kept_parts_cover_their_triangles():
    """Each direction in a triangle that was divided is in one of its parts."""
    kept = KeptParts()
    two = [pair for kinds in COMBINATIONS for pair in made(kinds, 6)]
    cores = pairs.bodies([shape for pair in two for shape in pair])
    first = np.arange(0, 2 * len(two), 2)
    keys = contact_directions.pair_keys(first, first + 1)
    random = np.random.default_rng(7)
    for _ in range(2):  # the second time, parts that are kept are divided further
        decide_upward(cores, first, first + 1, MIN_UP, kept)
        parts = kept.find(keys)
        assert len(parts.owners) > 100
        assert np.bincount(parts.owners).max() <= _MAX_PARTS
        mesh = contact_directions.mesh_of(MIN_UP)
        for owner, face in {*zip(parts.owners.tolist(), parts.faces.tolist(), strict=True)}:
            weights = random.dirichlet((1.0, 1.0, 1.0), 20)
            ways = mesh.directions[:, mesh.corners[:, face]] @ weights.T  # (axis, way)
            places = np.flatnonzero((parts.owners == owner) & (parts.faces == face))
            corners = parts.at_corners(places).transpose(2, 1, 0)  # (part, axis, corner)
            contains = (np.linalg.solve(corners, ways[None]) >= -1e-9).all(axis=1)
            assert contains.any(axis=0).all()
        cores = pairs.bodies([s for pair in moved(two, random, 2e-2) for s in pair])


def test_pairs_with_many_parts_begin_anew():
    kept = KeptParts()
    for count, remains in ((_MAX_PARTS, True), (_MAX_PARTS + 1, False)):
        ones, numbers = np.ones(count), np.zeros(count, np.intp)
        kept.keep(
            7, numbers, numbers + 1, ones, np.random.default_rng(1).normal(size=(3, 3, count))
        )
        assert (kept.find(np.array([7])) is not None) == remains


def test_parts_that_mostly_have_to_be_divided_again_are_given_up_for_a_while():
    kept, key = KeptParts(), np.array([7])
    numbers, ones = np.zeros(3, np.intp), np.ones(3)
    corners = np.random.default_rng(1).normal(size=(3, 3, 3))

    def keep():
        kept.keep(7, numbers, numbers + 1, ones, corners)

    def judge(share):
        kept.judge(np.arange(20) < 20 * share)

    keep()
    for _ in range(500):  # most suffice
        judge(0.9)
    assert kept.find(key) is not None
    tries = 0
    while kept.find(key) is not None:
        judge(0.7)
        tries += 1
    assert tries == math.ceil(_CREDIT / (0.3 * _COST - 0.7))
    absent = 0
    while kept.find(key) is None:
        kept.proofs(key)  # once a tick
        keep()
        absent += 1
    assert absent == _PAUSE


@pytest.mark.slow
def test_shapes_that_move_far_are_divided_anew(monkeypatch):
    """Where parts do not pay, as many directions are computed as without them."""
    counts, compute = [], contact_directions._Differences.points
    monkeypatch.setattr(
        contact_directions._Differences,
        "points",
        lambda pairs, owners, ways: counts.append(len(owners)) or compute(pairs, owners, ways),
    )
    monkeypatch.setattr(kept_parts, "_CREDIT", 1.0)
    random, kept = np.random.default_rng(6), KeptParts()
    two = [pair for kinds in COMBINATIONS for pair in made(kinds, 2)]
    with_parts, without = [], []
    for _ in range(12):
        turns = [b.quaternion + random.normal(size=4) * 0.1 for _, b in two]
        places = [b.position + random.normal(size=3) * 0.1 for _, b in two]
        jumped = [
            (a, b.at(place, turn / np.linalg.norm(turn)))
            for (a, b), place, turn in zip(two, places, turns, strict=True)
        ]
        for known, sums in ((kept, with_parts), (None, without)):
            counts.clear()
            decided(jumped, MIN_UP, kept=known)
            sums.append(sum(counts))
    assert with_parts[1] > without[1] + 2 * len(two)
    # Two directions of each pair are tried all the same.
    for known, anew in zip(with_parts[-3:], without[-3:], strict=True):
        assert known - 2 * len(two) <= anew


@pytest.mark.slow
def test_what_proved_a_verdict_is_tried_before_directions_all_around(monkeypatch):
    anew, decide = [], contact_directions._decide_anew

    def counted(pairs, *rest):
        anew.append(len(pairs))
        return decide(pairs, *rest)

    monkeypatch.setattr(contact_directions, "_decide_anew", counted)
    random, kept = np.random.default_rng(8), KeptParts()
    two = [pair for kinds in COMBINATIONS for pair in made(kinds, 8)]
    first = decided(two, MIN_UP, kept=kept)
    again = decided(two, MIN_UP, kept=kept)
    assert (first.verdicts == again.verdicts).all()
    # What was divided into very many parts is not kept.
    assert anew[0] == len(two)
    assert sum(anew[1:]) <= np.count_nonzero(first.verdicts == 0) + 3
    decided(moved(two, random, 1e-4), MIN_UP, kept=kept)
    assert anew[-1] < 0.1 * len(two)


def test_both_proofs_of_a_pair_whose_verdict_changes_to_and_fro_are_kept(monkeypatch):
    """A ball that is now on a ball, now beside it."""
    anew, decide = [], contact_directions._decide_anew
    monkeypatch.setattr(
        contact_directions,
        "_decide_anew",
        lambda pairs, *rest: anew.append(len(pairs)) or decide(pairs, *rest),
    )
    lower = pairs.Shape("sphere", pairs.geometry("sphere", np.random.default_rng(1), True),
                        np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))  # fmt: skip
    reach = lower.geometry.size[0] * 2.0
    on, beside = lower.at((0.0, 0.0, 0.98 * reach)), lower.at((0.98 * reach, 0.0, 0.0))
    kept = KeptParts()
    found = [
        int(decided([(lower, upper)], MIN_UP, kept=kept).verdicts[0]) for upper in (on, beside) * 3
    ]
    assert found == [UPWARD, NOT_UPWARD] * 3
    assert len(anew) == 2
