"""Terms whose functions of time follow from tick to tick need no record of the episode."""

import gymnasium
import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.errors import ArgumentError, EvaluationError, SelectScriptError
from ssduck.gym import QueryWrapper
from tests.support.of_model import OfModel

MODEL = """
<mujoco><worldbody>
  <geom type="plane" size="3 3 .1"/>
  <body name="ball" pos="0 0 1"><freejoint/><geom size=".05"/></body>
</worldbody></mujoco>
"""


class Fall(OfModel):
    """A ball that falls from 1 m."""

    def __init__(self):
        super().__init__(MODEL, 10)


def heights(env, steps):
    """Returns the ball's height at the reset and after each step, with the rewards."""
    env.reset()
    found, rewards = [env.unwrapped.data.xpos[1, 2]], []
    for _ in range(steps):
        rewards.append(env.step(env.action_space.sample())[1])
        found.append(env.unwrapped.data.xpos[1, 2])
    return found, rewards


@pytest.mark.parametrize("forward", [None, False])
def test_a_function_behind_a_condition_has_all_ticks(forward):
    # `heldFor` is first needed when the ball is below 0.8 m.
    term = "IF(z(sim.ball) < 0.8; heldFor(z(sim.ball) < 0.95); -1.0)"
    env = QueryWrapper(Fall(), reward=term, forward=forward)
    for _ in range(2):
        found, rewards = heights(env, 20)
        below = [time for time, z in enumerate(found) if z < 0.95]
        times = [0.02 * (step - below[0]) if step in below else 0.0 for step in range(1, 21)]
        expected = [t if z < 0.8 else -1.0 for t, z in zip(times, found[1:], strict=True)]
        assert rewards == pytest.approx(expected)
        assert -1.0 in rewards
        assert max(rewards) > 0.1


@pytest.mark.parametrize(
    ("term", "needs_record"),
    [
        ("heldFor(z(sim.ball) < 0.9)", False),
        ("rate(position(sim.ball))[2]", False),
        ("least(z(sim.ball))[1] + lifted(sim.ball, 0.1)", False),
        ("x(previous(sim.ball))", True),
        ("holds(z(sim.ball) < 2)[0][0]", True),
        ("z(sim.ball) - z(sim{0.0}.ball)", True),
        ("heldFor(rate(z(sim.ball)) < 0)", False),
        ("robustness(once(heldFor(z(sim.ball) < 0.9) > 0.01, 0, 0.1))", False),
        ("IF(eventually(z(sim.ball) < 0.9); 1; 0)", False),
        ("IF(always(z(sim.ball) > 0 OR eventually(z(sim.ball) > 0.9, 0, 5)); 1; 0)", True),
        ("heldFor(eventually(z(sim.ball) > 0.9, 0, 5)) > 1", True),
        ("least(z(sim.ball), -0.1)[1]", True),
        ("max(SELECT heldFor(z(this) < 0.9) FROM sim AS list)", True),
    ],
)
def test_a_world_is_recorded_only_where_a_term_reads_the_record(term, needs_record):
    env = QueryWrapper(Fall(), reward=f"0.0 + ({term})")
    heights(env, 3)
    ss = env.interpreter
    if needs_record:
        assert len(ss.past("sim").times) == 4
        return
    with pytest.raises(EvaluationError, match="not recorded"):
        ss.past("sim")
    ss.record("sim", ssduck.Recording())
    heights(env, 3)
    assert len(ss.past("sim").times) == 4


class Hooked(Fall):
    """A ball that falls, and what happens to it at each step."""

    def __init__(self, hook=lambda _: None):
        super().__init__()
        self.hook, self.step_number, self.goal = hook, 0, [0.9, 0.0]

    def reset(self, **options):
        self.step_number = 0
        return super().reset(**options)

    def step(self, action):
        self.step_number += 1
        self.hook(self)
        return super().step(action)


def told(env, steps):
    """Returns the reward of each step, or the message of its error."""
    env.reset()
    found = []
    for _ in range(steps):
        try:
            found.append(env.step(env.action_space.sample())[1])
        except (SelectScriptError, RuntimeError) as error:
            found.append(str(error))
    return found


def test_the_first_value_alone_counts_for_initially():
    env = QueryWrapper(Hooked(), reward="initially(log(z(sim.ball) - 0.95)) - z(sim.ball)")
    found, rewards = heights(env, 9)
    assert rewards == pytest.approx(np.log(0.05) - np.array(found[1:]))
    assert found[-1] < 0.95


@pytest.mark.parametrize("forward", [None, False])
def test_the_last_two_values_alone_count_for_rate(forward):
    def thrown(env):
        if env.step_number == 1:
            env.data.qvel[2] = 3

    term = "IF(z(sim.ball) > 1.1; rate(log(z(sim.ball) - 1.05)); 0.0)"
    env = QueryWrapper(Hooked(thrown), reward=term, forward=forward)
    found, rewards = heights(env, 9)
    logs = [np.log(z - 1.05) if z > 1.05 else None for z in found]
    for step, reward in enumerate(rewards, 1):
        if found[step] > 1.1 and logs[step - 1] is not None:
            assert reward == pytest.approx((logs[step] - logs[step - 1]) / 0.02)
    assert sum(reward != 0 for reward in rewards) > 4


@pytest.mark.parametrize("nan", [0.0, "failure", "error"])
def test_a_variable_that_becomes_nan_is_what_nan_says(nan):
    def lost(env):
        if env.step_number == 3:
            env.goal = [float("nan"), 0.0]

    env = QueryWrapper(
        Hooked(lost),
        reward="heldFor(z(sim.ball) < goal[0])",
        variables={"goal": lambda env: env.goal},
        nan=nan,
    )
    found = told(env, 5)
    assert found[:2] == [0.0, 0.0]
    assert "NaN" in found[2] if nan == "error" else found[2] == 0.0


@pytest.mark.parametrize("act", [lambda ss: ss["sim"].tick(), lambda ss: ss.eval("z(sim.ball);")])
def test_ticks_of_others_are_in_the_past(act):
    env = QueryWrapper(Fall(), reward="heldFor(z(sim.ball) < 0.95)")
    env.reset()
    rewards = []
    for step in range(12):
        if step == 8:
            act(env.interpreter)
        rewards.append(env.step(env.action_space.sample())[1])
    assert rewards[-4:] == pytest.approx(rewards[-1] - 0.02 * np.arange(3, -1, -1))
    assert rewards[-1] > 0.06


def test_a_variable_that_fails_once_loses_no_tick():
    def read(env):
        if env.step_number == 3:
            raise RuntimeError("sensor")
        return 1.0

    env = QueryWrapper(
        Hooked(), reward="heldFor(z(sim.ball) < 0.95) + v", variables={"v": read}, forward=False
    )
    found = told(env, 9)
    assert found[2] == "sensor"
    assert found[3] == 1.0
    assert found[-1] == pytest.approx(found[-2] + 0.02) != 1.02


def test_a_record_that_begins_in_an_episode_changes_no_reward():
    env = QueryWrapper(Fall(), reward="heldFor(z(sim.ball) < 0.99)", forward=False)
    env.reset()
    rewards = []
    for step in range(8):
        if step == 5:
            env.interpreter.record("sim", ssduck.Recording())
        rewards.append(env.step(env.action_space.sample())[1])
    assert np.diff(rewards[3:]) == pytest.approx([0.02] * 4)


def test_a_body_that_comes_later_has_no_past():
    class Late(gymnasium.Env):
        observation_space = action_space = gymnasium.spaces.Box(-1, 1, (1,), np.float32)

        def __init__(self):
            self._client, self.episodes = pybullet.connect(pybullet.DIRECT), 0

        def add(self, x):
            shape = pybullet.createCollisionShape(
                pybullet.GEOM_SPHERE, radius=0.05, physicsClientId=self._client
            )
            pybullet.createMultiBody(1, shape, -1, [x, 0, x], physicsClientId=self._client)

        def reset(self, **_):
            pybullet.resetSimulation(physicsClientId=self._client)
            self.add(1)
            self.steps, self.episodes = 0, self.episodes + 1
            if self.episodes == 1:
                self.add(2)
            return np.zeros(1, np.float32), {}

        def step(self, _):
            self.steps += 1
            if self.episodes > 1 and self.steps == 3:
                self.add(2)
            pybullet.stepSimulation(physicsClientId=self._client)
            return np.zeros(1, np.float32), 0.0, False, False, {}

    env = QueryWrapper(Late(), reward="IF(getTime() > 0.015; heldFor(z(sim.body_1) < 3); -1.0)")
    env.reset()
    found = told(env, 6)
    assert found == pytest.approx([-1.0, -1.0, -1.0, 1 / 240, 2 / 240, 3 / 240])
    pybullet.disconnect(env.unwrapped._client)


@pytest.mark.parametrize(
    ("term", "holds"),
    [
        ("eventually(z(sim.ball) < 0.9)", lambda low, _: low < 0.9),
        ("until(z(sim.ball) > 0.9, z(sim.ball) < 0.95)", lambda low, _: low < 0.95),
        ("always(z(sim.ball) > 0.9, 0, 0.05)", lambda _, step: step > 2),
    ],
)
def test_what_is_not_decided_yet_does_not_hold(term, holds):
    env = QueryWrapper(Fall(), success=term, forward=False)
    env.reset()
    for step in range(1, 13):
        info = env.step(env.action_space.sample())[-1]
        assert info["ssduck"]["success"] is bool(holds(env.unwrapped.data.xpos[1, 2], step))


@pytest.mark.parametrize(
    ("reward", "message"),
    [
        ("robustness(always(z(sim.ball) > 0.9))", "looks ahead.*historically"),
        ("robustness(z(sim.ball) > 0 AND isRobot(sim.ball))", "isRobot.sim.ball. has no margin"),
    ],
)
def test_a_reward_has_a_margin_at_each_step(reward, message):
    with pytest.raises(ArgumentError, match=message):
        QueryWrapper(Fall(), reward=reward, forward=False).reset()
