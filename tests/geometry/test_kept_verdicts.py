"""A verdict is kept while shapes move by less than its room, and is what a new comparison gives."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pybullet
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ssduck
from ssduck.geometry.proofs.cores import PlacedCores
from ssduck.geometry.proofs.verdicts import (
    ABOVE,
    BELOW,
    UNDECIDED,
    Decisions,
    KeptVerdicts,
    ShapePoses,
)
from tests.geometry.test_colliding import fill
from tests.support.cases import sampled

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


# -- worlds ------------------------------------------------------------------------------------

MIXED = ["box"] * 10 + ["sphere"] * 4 + ["capsule"] * 4 + ["cylinder"] * 4 + ["hull"] * 6
CONDITIONS = ("collides(a.this, b.this)", "near(a.this, b.this, 0.05)", "touching(a.this, b.this)")
CONDITIONS += ("on(a.this, b.this)",)


def drift(client, random, far):
    """Moves two of three bodies by about a distance."""
    for body in range(pybullet.getNumBodies(client)):
        if body % 3 == 0:
            continue
        place, turn = pybullet.getBasePositionAndOrientation(body, client)
        place, turn = (np.array(v) + random.normal(size=len(v)) * far for v in (place, turn))
        pybullet.resetBasePositionAndOrientation(
            body, place, turn / np.linalg.norm(turn), physicsClientId=client
        )


@pytest.mark.slow
@sampled("condition", CONDITIONS, every=len(CONDITIONS))
def test_a_world_that_drifts_answers_as_one_that_was_never_asked(client, condition):
    query = f"SELECT id(a.this), id(b.this) FROM a=w, b=w WHERE {condition} AS list;"
    fill(client, [*MIXED, "plane"], seed=8, side=0.8)
    random = np.random.default_rng(9)
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("w", ssduck.World.attach(client))
        for far in [1e-3] * 12 + [1e-9] * 4 + [5e-3] * 6:
            drift(client, random, far)
            world.tick()
            found = ss.eval(query)
            with ssduck.Interpreter() as other:
                other.add_variable("w", ssduck.World.attach(client))
                assert other.eval(query) == found


@pytest.mark.slow
@sampled("condition", [*CONDITIONS, "collides(a.this, b.this, 0.01)"], every=3)
def test_a_world_that_moves_answers_as_one_that_compares_pair_by_pair(client, condition):
    query = f"SELECT id(a.this), id(b.this) FROM a=w, b=w WHERE {condition} AS list;"
    one_by_one = query.replace(" AS list", " AND z(a.this) > -1e9 AS list")
    fill(client, [*MIXED, "plane"], seed=4, side=0.9)
    random = np.random.default_rng(6)
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("w", ssduck.World.attach(client))
        for far in (0.0, 1e-4, 1e-3, 0.02, 0.0, 0.3):
            drift(client, random, far)
            world.tick()
            found = ss.eval(query)
            with ssduck.Interpreter() as other:
                other.add_variable("w", ssduck.World.attach(client))
                assert other.eval(one_by_one) == found


def test_a_pair_at_its_bound_is_compared_once_while_it_stands_still(client):
    """The narrow phase decides it, which counts its calls of FCL."""
    names = {}
    for name, x in (("one", 0.0), ("other", 1.2)):
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_CYLINDER, radius=0.5, height=1.0, physicsClientId=client
        )
        names[
            pybullet.createMultiBody(0, shape, basePosition=(x, 0, 0), physicsClientId=client)
        ] = name
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("w", ssduck.World.attach(client, names=names))
        gap = ss.eval("clearance(w.one, w.other);")
        query = f"SELECT id(a.this) FROM a=w, b=w WHERE near(a.this, b.this, {gap!r}) AS list;"
        world.tick()
        counts = []
        for _ in range(3):
            before = ss.statistics()["w"].calls
            found = ss.eval(query)
            counts.append(ss.statistics()["w"].calls - before)
            assert len(found) == 2
            world.tick()
        assert counts[0] > 0
        assert counts[1:] == [0, 0]


@pytest.mark.slow
def test_bodies_at_rest_are_not_compared_again(client, monkeypatch):
    """A body that moves takes with it only the pairs whose verdict it may change."""
    counts = []

    def count(owner, name):
        compute = getattr(owner, name)
        monkeypatch.setattr(
            owner,
            name,
            lambda self, *ways: counts.append(ways[-1].shape[1]) or compute(self, *ways),
        )

    count(PlacedCores, "support_points")
    fill(client, MIXED, seed=8, side=0.8)
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("w", ssduck.World.attach(client))
        query = (
            "SELECT id(a.this), id(b.this) FROM a=w, b=w WHERE collides(a.this, b.this) AS list;"
        )
        first = ss.eval(query)
        calls = ss.statistics()["w"].calls
        assert sum(counts) > 100
        counts.clear()
        drift(client, np.random.default_rng(1), 1e-9)
        world.tick()
        assert ss.eval(query) == first
        assert sum(counts) == 0
        assert ss.statistics()["w"].calls == calls
        place, turn = pybullet.getBasePositionAndOrientation(0, client)
        far = [place[0] + 0.3, place[1], place[2]]
        pybullet.resetBasePositionAndOrientation(0, far, turn, physicsClientId=client)
        world.tick()
        assert ss.eval(query) != first
        assert 0 < sum(counts) < 200


@pytest.mark.parametrize("condition", CONDITIONS)
def test_the_shapes_of_a_tick_are_free_when_the_next_takes_their_place(client, condition):
    """No cycle of references keeps them until garbage is collected."""
    fill(client, MIXED, seed=8, side=0.8)
    query = f"SELECT id(a.this), id(b.this) FROM a=w, b=w WHERE {condition} AS list;"
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("w", ssduck.World.attach(client))
        ss.eval(query)
        shapes = weakref.ref(world.snapshot.shapes())
        gc.disable()
        try:
            world.tick()
            ss.eval(query)
            assert shapes() is None
        finally:
            gc.enable()
