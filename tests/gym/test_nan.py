"""A state that is not a number: what the terms are, and what their errors say."""

import mujoco
import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.errors import ArgumentError, SelectScriptError
from ssduck.gym import QueryWrapper, score
from tests.support.gym_environments import Drop
from tests.support.of_model import OfModel

TEXT = """
<mujoco><option gravity="0 0 0"><flag autoreset="disable"/></option><worldbody>
<body name="a" pos="0 0 1"><freejoint/><geom size=".1" mass="1"/></body>
<body name="b" pos="1 0 1"><freejoint/><geom size=".1" mass="1"/></body></worldbody></mujoco>
"""
STATE = r"the pose or the velocity of sim\.a is NaN at this step"
pytestmark = pytest.mark.filterwarnings("ignore:a. the simulator gives a pose")


class Broken(OfModel):
    """The pose of a body is NaN from a step on; the goal from another one."""

    def __init__(self, at=2, goal_at=99, until=99):
        super().__init__(TEXT, 2)
        self.at, self.goal_at, self.until = at, goal_at, until

    @property
    def goal(self):
        return [float("nan") if self.steps >= self.goal_at else 1.0]

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = -1
        return self.step(None)[0], {}

    def step(self, action):
        self.steps += 1
        if self.steps == self.until:
            mujoco.mj_resetData(self.model, self.data)
            self.data.time = 0.1
            mujoco.mj_kinematics(self.model, self.data)
        elif self.at <= self.steps < self.until:
            self.data.qpos[:3] = np.nan
            mujoco.mj_kinematics(self.model, self.data)
            self.data.time += 0.004
        else:
            return super().step(action)
        return self.data.qpos.copy(), 0.0, False, False, {}


def run(steps=2, env=None, **terms):
    """Returns what the last of some steps gives, but for the observation."""
    env = QueryWrapper(env or Broken(), **terms)
    try:
        env.reset()
        for _ in range(steps):
            result = env.step(np.zeros(1))
        return result[1], result[2], result[4]["ssduck"]
    finally:
        env.close()


@pytest.mark.parametrize(
    ("terms", "message"),
    [
        ({"reward": "x(sim.a)"}, r"reward: 'x\(sim.a\)' is NaN \(not a number\): " + STATE),
        ({"success": "z(sim.a) > 1"}, "success: .* is NaN .*" + STATE),
        ({"failure": "near(sim.a, sim.b, 0.1)"}, "failure: .* is NaN .*" + STATE),
        (
            {"reward": {"b": "x(sim.b)", "both": "-distance(sim.a, sim.b)"}},
            r"reward\['both'\]: .*NaN",
        ),
    ],
)
def test_the_error_says_what_is_nan(terms, message):
    with pytest.raises(ArgumentError, match=message) as caught:
        run(**terms)
    assert "not there" not in str(caught.value)
    assert "nan='failure'" in str(caught.value)


def test_a_variable_that_is_nan_is_named():
    variables = {"goal": lambda env: env.goal}
    with pytest.raises(ArgumentError, match=r"reward: .* the variable goal.* has NaN at this step"):
        run(env=Broken(99, 2), reward="x(sim.b) - goal[0]", variables=variables)


OF_VARIABLES = ["goal[0] > 9", "NOT goal[0] > 0.5", "goal[0] + x(sim.b) > 9", "max(goal) < 0"]


@pytest.mark.slow
@pytest.mark.parametrize("term", OF_VARIABLES)
@pytest.mark.parametrize("key", ["success", "failure", "stop_when"])
def test_a_condition_of_a_variable_that_is_nan_is_unknown(tmp_path, key, term):
    """No comparison with NaN holds, and its opposite does: neither is an answer."""
    options = {"variables": {"goal": lambda env: env.goal}, key: term}
    with pytest.raises(ArgumentError, match=f"{key}: .* the variable goal.* has NaN at this step"):
        run(env=Broken(99, 2), **options)
    _, terminated, info = run(env=Broken(99, 2), **options, nan="failure", record_to=tmp_path)
    assert (terminated, info["failure"]) == (True, True)
    assert run(env=Broken(99, 2), **options, nan=-1)[2].get(key, False) is False
    (scored,) = score(tmp_path, **{key: term}, nan="failure")
    assert scored.failure[-1] is True


def test_at_the_first_reset():
    with pytest.raises(ArgumentError, match="reward: .* is NaN .*" + STATE):
        run(env=Broken(0), reward="x(sim.a) * 2")
    reward, _, info = run(env=Broken(0), reward="x(sim.a) * 2", nan=-1)
    assert (reward, info["reward"]) == (-1.0, -1.0)


TERMS = {
    "success": "z(sim.a) > 0.5",
    "reward": {"a": "z(sim.a) + 1", "b": "x(sim.b)"},
    "stop_when": "z(sim.b) > 5",
}


@pytest.mark.slow
def test_a_failure_of_the_episode():
    assert run(1, **TERMS, nan="failure")[1:] == (
        False,
        {"success": True, "reward": 3.0, "parts": {"a": 2.0, "b": 1.0}},
    )
    reward, terminated, info = run(2, **TERMS, nan="failure")
    assert (reward, terminated) == (1.0, True)
    expected = {"success": False, "failure": True, "reward": 1.0, "parts": {"a": 0.0, "b": 1.0}}
    assert info == expected


@pytest.mark.slow
def test_a_value_in_its_place(tmp_path):
    reward, terminated, info = run(3, **TERMS, nan=-4.5, record_to=tmp_path)
    assert (reward, terminated, info["success"]) == (-3.5, False, False)
    (scored,) = score(tmp_path, **TERMS, nan=-4.5)
    assert scored.rewards == (3.0, -3.5, -3.5)
    assert scored.success == (True, False, False)
    with pytest.raises(ArgumentError, match="success: .* is NaN .*" + STATE):
        list(score(tmp_path, **TERMS))
    (failed,) = score(tmp_path, **TERMS, nan="failure")
    assert (failed.failure, failed.stop) == ((False, True), (False, True))


@pytest.mark.slow
@pytest.mark.parametrize("nan", [-4.5, "failure"])
def test_a_lake_scores_likewise(tmp_path, nan):
    run(3, **TERMS, nan=-4.5, record_to=tmp_path)
    (scored,) = score(tmp_path, **TERMS, nan=nan)
    lake = ssduck.lake(tmp_path)
    (row,) = lake.score(**TERMS, nan=nan, processes=1).to_pylist()
    found = (row["return"], row["success"], row["failure"], row["steps"], row["error"])
    failed = None if scored.failure is None else scored.failure[-1]
    assert found == (scored.total, scored.succeeded, failed, len(scored.rewards), None)
    (row,) = lake.score(**TERMS, processes=1).to_pylist()
    assert "is NaN" in row["error"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("term", "rewards"),
    [
        # The pose is NaN at the second and the third step, and time goes on from 0.1 s.
        ("heldFor(z(sim.a) > 0.5)", [0.004, -4.5, -4.5, 0.0, 0.004]),
        ("heldFor(near(sim.a, sim.b, 9))", [0.004, -4.5, -4.5, 0.0, 0.004]),
        ("count(holds(z(sim.a) > 0.5))", [1, -4.5, -4.5, 2, 2]),
        ("heldFor(z(sim.b) > 0.5)", [0.004, 0.008, 0.012, 0.096, 0.1]),
        ("x(sim.b) + heldFor(z(sim.b) < 0.5)", [1, 1, 1, 1, 1]),
    ],
)
def test_conditions_over_time_that_are_unknown(tmp_path, term, rewards):
    env = QueryWrapper(Broken(until=4), reward=term, nan=-4.5, record_to=tmp_path)
    env.reset()
    assert [env.step(np.zeros(1))[1] for _ in range(5)] == pytest.approx(rewards)
    env.close()
    (scored,) = score(tmp_path, reward=term, nan=-4.5)
    assert scored.rewards == pytest.approx(rewards)
    if -4.5 in rewards:
        with pytest.raises(ArgumentError, match="reward: .* is NaN .*" + STATE):
            list(score(tmp_path, reward=term))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("term", "replaced"),
    [
        ("rate(x(sim.a))", [2, 3]),
        ("previous(x(sim.a)) - x(sim.a)", [2, 3]),
        ("least(x(sim.a))[1]", []),
        ("previous(x(sim.b))", []),
    ],
)
def test_a_value_whose_past_is_nan(tmp_path, term, replaced):
    env = QueryWrapper(Broken(until=3), reward=term, nan=-4.5, record_to=tmp_path)
    rewards = []
    for _ in range(2):  # the next episode has another past
        env.reset()
        rewards.append([env.step(np.zeros(1))[1] for _ in range(4)])
    env.close()
    for one in rewards:
        assert [number for number, r in enumerate(one, 1) if r == -4.5] == replaced
    scored = [list(episode.rewards) for episode in score(tmp_path, reward=term, nan=-4.5)]
    assert scored == rewards


@pytest.mark.slow
def test_the_error_of_a_past_that_is_nan(tmp_path):
    message = r"reward: .* is NaN .*: the pose or the velocity of sim\.a was NaN at an earlier step"
    with pytest.raises(ArgumentError, match=message):
        run(3, env=Broken(until=3), reward="previous(x(sim.a))")
    first = {"env": Broken(0, until=1), "reward": "initially(x(sim.a))"}
    with pytest.raises(ArgumentError, match=r"reward: .* is NaN"):
        run(1, **first)
    assert run(3, **first, nan=-1.0, record_to=tmp_path)[0] == -1.0
    (scored,) = score(tmp_path, reward=first["reward"], nan=-1.0)
    assert scored.rewards == (-1.0,) * 3


def test_a_past_that_is_nan_excuses_no_other_term():
    terms = {"a": "previous(x(sim.a))", "b": "1 / (z(sim.b) - z(sim.b))"}
    with pytest.raises(SelectScriptError, match="reward"):
        run(3, env=Broken(until=3), reward=terms, nan=-1.0)


def test_pybullet():
    class Broken(Drop):
        def step(self, action):
            pybullet.resetBasePositionAndOrientation(
                self.cube, [0, 0, np.nan], [0, 0, 0, 1], self.physics_client
            )
            return self._observation(), 0.0, False, False, {}

    with (
        pytest.warns(UserWarning, match="no number"),
        pytest.raises(ArgumentError, match=r"sim\.body_1 is NaN"),
    ):
        run(1, env=Broken(), reward="z(sim.body_1)")


@pytest.mark.parametrize("nan", ["fail", None, True, float("inf")])
def test_other_arguments_are_errors(nan):
    with pytest.raises(ArgumentError, match="nan"):
        QueryWrapper(Broken(), reward="x(sim.a)", nan=nan)


def test_a_term_that_fails_after_all_numbers_are_known_again_is_an_error():
    text, variables = "IF(count > 3; log(z(sim.b) - 9); 0.0)", {"count": lambda env: env.steps}
    env = QueryWrapper(Broken(2, until=4), reward=text, variables=variables, forward=False, nan=-7)
    env.reset()
    assert [env.step(None)[1] for _ in range(3)] == [0.0] * 3
    with pytest.raises(ArgumentError, match="log does not take -8"):
        env.step(None)
