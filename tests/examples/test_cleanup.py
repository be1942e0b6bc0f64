"""The example that cleans up the table: reaching, keeping clear, planning, and the whole."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import pytest

import ssduck
from examples.cleanup import cleaner as cleaner_module
from examples.cleanup.cleaner import ARM, FALLS, Cleaner, Failed
from examples.cleanup.driving import MAX_ACCELERATION, MAX_VELOCITY, timed
from examples.cleanup.kinematics import KinematicChain
from examples.cleanup.obstacles import Obstacles, walls_of
from examples.cleanup.planning import length, plan, shortened
from examples.cleanup.program import clean
from ssduck.demos.cleanup import ALLOWED
from ssduck.simulators.scenes import find_scene
from ssduck.world.world import World

pytestmark = pytest.mark.slow

FEW = ("barrett_4918", "kitchen", "chair_12d0", "chair_6b56", "table", "sink", "cup_58a2")


def kitchen_of(names):
    """The kitchen with these things only: what is not there takes no time."""
    scene = find_scene("kitchen")
    bodies = tuple(body for body in scene.bodies if body.name in names)
    return World.load(replace(scene, bodies=bodies, sensors=()))


@pytest.fixture(scope="module")
def few():
    with ssduck.Interpreter() as ss:
        yield ss, ss.add_variable("kitchen", kitchen_of(FEW))


@pytest.fixture(scope="module")
def barrett(few):
    return few[1]["barrett_4918"]


@pytest.fixture(scope="module")
def chain(barrett):
    return KinematicChain.of(barrett)


def postures(chain, count, seed):
    """Random postures of the arm."""
    arm = chain.columns(ARM)
    rng = np.random.default_rng(seed)
    found = np.zeros((count, len(chain.names)))
    found[:, arm] = rng.uniform(chain.lower[arm], chain.upper[arm], (count, len(arm)))
    return found


# -- reaching ------------------------------------------------------------------------------------


def test_frames_are_those_of_a_what_if_world(chain, barrett):
    base, _ = chain.state(barrett)
    all_of = postures(chain, 6, 1)
    frames = chain.frames(np.tile(base, (6, 1, 1)), all_of)
    for posture, frame in zip(all_of, frames, strict=True):
        joints = dict(zip(chain.names, posture, strict=True))
        there = barrett.world.what_if(joints={barrett.name: joints})[barrett.name]
        assert frame[:, :3, 3] == pytest.approx(
            np.array([link.position for link in there.links]), abs=1e-9
        )


# -- keeping clear -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def bent(few, barrett, chain):
    """Postures near the table: the base, the joints, the obstacles, and the least clearances.

    Those are of the narrow phase, body by body, in what-if worlds: one posture at a time.
    """
    ss, world = few
    others = [world[name] for name in ("table", "sink", "chair_12d0", "cup_58a2")]
    near_the_table = np.eye(4)
    near_the_table[:3, 3] = 0.8, 1.12, barrett.position[2]
    all_of = postures(chain, 20, 4)
    rng = np.random.default_rng(5)  # bent over the table
    all_of[:, chain.columns(["j1"])] = rng.uniform(-2.2, -0.8, (20, 1))
    all_of[:, chain.columns(["j2"])] = rng.uniform(0.6, 1.5, (20, 1))
    around = Obstacles(chain, barrett, [wall for other in others for wall in walls_of(other)])
    clearances = []
    for posture in all_of:
        joints = dict(zip(chain.names, posture, strict=True))
        pose = [1, 0, 0, 0, *near_the_table[:3, 3]]
        maybe = world.what_if({barrett.name: pose}, {barrett.name: joints})
        ss.add_variable("maybe", maybe)
        least = ss.sql(
            "SELECT min(maybe.clearance(a, b)) FROM maybe.entities a, maybe.entities b "
            "WHERE a.name = 'barrett_4918' AND list_contains(?, b.name)",
            [[other.name for other in others]],
        ).fetchall()[0][0]
        clearances.append(least)
    return np.tile(near_the_table, (20, 1, 1)), all_of, around, clearances


@pytest.mark.parametrize("apart", [0.0, 0.02, 0.1])
def test_clear_is_what_clearances_say(bent, apart):
    bases, all_of, around, clearances = bent
    found = around.clear(bases, all_of, apart)
    expected = [least > apart for least in clearances]
    assert found.tolist() == expected
    assert 0 < sum(expected) < 20, "some are, and some are not"


def test_an_arm_that_would_be_in_the_base_is_not_clear(barrett, chain):
    around = Obstacles(chain, barrett, (), hand=chain.descendants("arm7"))
    base, now = chain.state(barrett)
    inside = now.copy()
    inside[chain.columns(["j1", "j2", "j4"])] = 0.0, 2.0, 1.6
    both = np.array([now, inside])
    moving = chain.descendants("arm1")
    bases = np.tile(base, (2, 1, 1))
    assert around.clear(bases, both, 0.01, moving=moving, self_clearance=0.01).tolist() == [
        True,
        False,
    ]
    assert around.clear(bases, both, 0.01, moving=moving).tolist() == [True, True]


# -- planning ------------------------------------------------------------------------------------


@dataclass
class Plane:
    """A square of 2 m with a wall across that has a gap."""

    gap: float
    looked_at: list = field(default_factory=list)

    def sample(self, rng):
        return rng.uniform(-1.0, 1.0, 2)

    def distances(self, here, others):
        return np.linalg.norm(others - here, axis=1)

    def path(self, here, there):
        count = max(2, int(np.linalg.norm(there - here) / 0.02) + 2)
        return here + np.linspace(0.0, 1.0, count)[:, None] * (there - here)

    def clear(self, postures):
        self.looked_at.append(len(postures))
        in_wall = np.abs(postures[:, 0]) < 0.1
        return ~in_wall | (np.abs(postures[:, 1] - 0.8) < self.gap / 2)


@pytest.mark.parametrize("seed", range(5))
def test_a_path_through_a_gap(seed):
    plane, rng = Plane(0.2), np.random.default_rng(seed)
    start, goal = np.array([-0.8, -0.8]), np.array([0.8, -0.8])
    path = plan(plane, start, goal, rng, 2000, 0.3)
    assert path[0] == pytest.approx(start)
    assert path[-1] == pytest.approx(goal)
    for one in (path, shortened(plane, path, rng, 100)):
        assert plane.clear(one).all()
        assert max(np.linalg.norm(b - a) for a, b in pairwise(one)) < 0.0201
        # The shortest one goes by the edges of the gap.
        assert length(plane, one) > 2 * np.hypot(0.7, 1.5)
    assert length(plane, one) < 1.2 * (2 * np.hypot(0.7, 1.5) + 0.2)


# -- moving --------------------------------------------------------------------------------------


def test_a_path_in_time_is_no_faster_than_allowed():
    corner = np.concatenate((np.linspace((0, 0), (1, 0), 60), np.linspace((1, 0), (1, 2), 90)))
    clock, path = timed(corner)
    assert clock[0] == 0.0
    assert path[-1] == pytest.approx([1, 2])
    speeds = np.abs(np.diff(path, axis=0)).max(axis=1) / np.diff(clock)
    assert (np.diff(clock) > 0).all()
    assert speeds.max() <= MAX_VELOCITY * (1 + 1e-9)
    assert speeds.max() > 0.9 * MAX_VELOCITY
    middle = (clock[1:] + clock[:-1]) / 2
    changes = np.abs(np.diff(speeds) / np.diff(middle))
    assert changes.max() < 1.5 * MAX_ACCELERATION
    assert speeds[58:61].min() < 0.4 * MAX_VELOCITY  # it slows down for the corner


# -- the whole -----------------------------------------------------------------------------------


@pytest.mark.long
def test_a_cup_is_taken_to_the_sink(tmp_path):
    said = []
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("kitchen", kitchen_of(FEW))
        cup = world["cup_58a2"]
        outcome = clean(ss, tmp_path, said.append, seed=1)
        low, high = world["sink"].aabb
        assert (np.array(cup.position[:2]) >= low[:2]).all()
        assert (np.array(cup.position[:2]) <= high[:2]).all()
        # Nothing is put elsewhere: nothing goes faster between two ticks than 3 m/s.
        fastest = """
            SELECT max(sqrt((h.x - g.x)**2 + (h.y - g.y)**2 + (h.z - g.z)**2) / (h.time - g.time))
            FROM entities_history h JOIN entities_history g ON h.name = g.name
            WHERE h.tick - g.tick BETWEEN 1 AND 8 AND h.time > g.time
            AND h.name IN ('cup_58a2', 'barrett_4918')"""
        assert 0.1 < ss.sql(fastest).fetchall()[0][0] < 3.0
    assert outcome.succeeded
    assert outcome.cups == outcome.washed == ["cup_58a2"]
    assert outcome.left == []
    assert outcome.deepest <= ALLOWED
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == [
        "cleanup_0_before.png",
        "cleanup_1_holding_cup_58a2.png",
        "cleanup_2_after.png",
    ]
    assert any("On the table: no cup" in line for line in said)


@pytest.mark.long
def test_a_cup_that_cannot_be_dropped_is_put_back():
    world = kitchen_of(FEW)
    cup = world["cup_58a2"]
    before = np.array(cup.position)
    cleaner = Cleaner(world["barrett_4918"], np.random.default_rng(1))
    cleaner.prepare()
    far = np.array([0.35, 3.5, 0.8])  # behind the wall
    assert not cleaner.can_drop(cup, [far])
    assert cleaner.can_drop(cup, [np.array([0.35, 2.0, 0.8])])
    assert cleaner.held is None
    cleaner.pick(cup)
    assert cup.position[2] > before[2] + 0.05
    with pytest.raises(Failed, match="no place to stand"):
        cleaner.drop([far], FALLS[:1])
    assert cleaner.held is not None  # it does not let go of it elsewhere
    assert cup.position[2] > before[2] + 0.05
    cleaner.recover()
    world.step(120)
    assert cleaner.held is None
    assert cup.position == pytest.approx(before, abs=0.02)
    tilt = 2 * np.linalg.norm(cup.orientation[1:3])
    assert tilt < 0.02  # upright


@pytest.mark.long
def test_what_cannot_be_reached_is_said(monkeypatch):
    monkeypatch.setattr(cleaner_module, "PLACES", 200)  # there is none, however many are tried
    said = []
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("kitchen", kitchen_of([*FEW, "plate_fa76"]))
        x, y, _ = world["cup_58a2"].position
        world["plate_fa76"].move([x, y, 1.081])  # a lid
        world.step(60)
        outcome = clean(ss, None, said.append, seed=1)
    assert not outcome.succeeded
    assert outcome.left == ["cup_58a2"]
    assert outcome.washed == []
    assert set(outcome.trouble["cup_58a2"]) == {
        "there is no place to stand from which the arm reaches it"
    }
    last = "\n".join(said[-4:])
    assert "On the table: cup_58a2" in last
    assert "cup_58a2 is not in the sink, but at (0.61, 0.45, 0.92)" in last
