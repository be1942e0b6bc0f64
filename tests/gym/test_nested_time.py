"""Functions of time in each other, and of elements of lists: live, scored, asked of a lake."""

import math

import gymnasium
import numpy as np
import pytest

import ssduck
from ssduck.errors import ArgumentError
from ssduck.gym import QueryWrapper, VectorQueryWrapper, score
from tests.support.cases import sampled
from tests.support.of_model import OfModel

FALL = """
<mujoco><worldbody>
  <geom type="plane" size="3 3 .1"/>
  <body name="ball" pos="0 0 1"><freejoint/><geom size=".05"/><site name="top" pos="0 0 .05"/></body>
</worldbody></mujoco>
"""
EPISODES, STEPS = 3, 8


class Fall(OfModel):
    """A ball that falls from a height that depends on the seed."""

    def __init__(self):
        super().__init__(FALL, 5)

    def reset(self, *, seed=None, options=None):
        self.height = 1 + 0.5 * seed
        result = super().reset(seed=seed)
        self.heights = [self.data.xpos[1, 2].item()]
        return result

    def start(self):
        self.data.qpos[2] = self.height

    def step(self, action):
        result = super().step(action)
        self.heights.append(self.data.xpos[1, 2].item())
        return result


Z = "z(sim.ball)"
# (a reward, its value from the heights at all ticks until now, 0.01 s apart)
REWARDS = [
    (f"previous({Z} + position(sim.ball)[2])", lambda h: 2 * h[-2]),
    ("initially(position(sim.ball)[2])", lambda h: h[0]),
    ("rate((position(sim.ball) - [0, 0, 0.5])[2])", lambda h: (h[-1] - h[-2]) / 0.01),
    ("heldFor(position(sim.ball)[2] > 0)", lambda h: 0.01 * (len(h) - 1)),
    (f"heldFor({Z} <= least({Z})[1])", lambda h: 0.01 * (len(h) - 1)),
    (f"greatest({Z} - initially({Z}))[1]", lambda _: 0.0),
    (f"least({Z} - initially({Z}))[1]", lambda h: h[-1] - h[0]),
    (f"initially({Z} + getTime())", lambda h: h[0]),
    ("previous(z(sim.ball.top)) - 0.05", lambda h: h[-2]),
    (f"greatest(rate({Z}))[1]", lambda _: 0.0),
]


def of_heights(value, heights):
    return [value(heights[: index + 1]) for index in range(1, len(heights))]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A record of episodes, and the heights of each."""
    folder, heights = tmp_path_factory.mktemp("falls") / "record", []
    env = QueryWrapper(Fall(), reward=Z, forward=False, record_to=folder)
    for seed in range(EPISODES):
        env.reset(seed=seed)
        for _ in range(STEPS):
            env.step(env.action_space.low)
        heights.append(env.unwrapped.heights)
    env.close()
    return folder, heights


@pytest.mark.slow
@sampled(("reward", "value"), REWARDS, every=4)
def test_values_are_those_of_the_heights(recorded, reward, value):
    folder, heights = recorded
    env = QueryWrapper(Fall(), reward=reward, forward=False)
    live = []
    for seed in range(EPISODES):
        env.reset(seed=seed)
        live.append([float(env.step(env.action_space.low)[1]) for _ in range(STEPS)])
    env.close()
    expected = [pytest.approx(of_heights(value, own), abs=1e-9) for own in heights]
    assert live == expected
    scored = [list(one.rewards) for one in score(folder, reward=reward)]
    assert scored == live
    returns = ssduck.lake(folder).score(reward=reward, processes=1)["return"].to_pylist()
    assert returns == [sum(rewards) for rewards in live]


@pytest.mark.slow
@pytest.mark.parametrize(
    "program",
    [
        f"greatest({Z} - initially({Z}))[1];",
        f"holds(rate({Z}) < -0.3);",
        f"holds({Z} < z(sim{{0.0}}.ball) - 0.01);",
        "m = sim.ball; holds(rate(z(m)) < -0.3);",
        f"holds({Z} < getTime() * 4);",
        "lifted(sim.ball, -0.02);",
        f"heldFor({Z} < initially({Z}) - 0.01);",
        "SELECT greatest(z(this) - initially(z(this)))[1] FROM sim AS list;",
    ],
)
def test_each_episode_of_a_lake_has_its_own_past(recorded, program):
    folder, _ = recorded
    answers = []
    for number in range(EPISODES):
        with ssduck.open(folder, episode=number) as ss:
            answers.append(ss.eval(program))
    lake = ssduck.lake(folder)
    assert lake.ask(program, processes=1)["answer"].to_pylist() == answers
    lake.ask(f"{Z} - initially({Z});", processes=1)  # leaves worlds at other ticks
    assert lake.ask(program, processes=1)["answer"].to_pylist() == answers


@pytest.mark.slow
@pytest.mark.parametrize("sign", ["OR", "AND"])
def test_a_variable_that_is_nan_matters_where_it_decides(sign):
    reads = iter([0.0, *[math.nan, 1.0] * 4, math.nan, math.nan, *[1.0] * 9])
    left = f"{Z} > 0.1" if sign == "OR" else f"{Z} < 0.1"
    terms = {"reward": f"int({left} {sign} err > 0.2)", "success": "z(sim.ball) < 0"}
    variables = {"err": lambda _: next(reads)}
    env = QueryWrapper(Fall(), **terms, variables=variables, forward=False, nan=-1.0)
    env.reset(seed=0)
    rewards = [env.step(env.action_space.low)[1] for _ in range(STEPS + 4)]
    env.close()
    assert rewards == [float(sign == "OR")] * (STEPS + 4)


@pytest.mark.slow
def test_the_greatest_of_what_is_nan_is_nan():
    env = QueryWrapper(Fall(), reward=f"max([{Z}, 0.3])", forward=False)
    env.reset(seed=0)
    assert env.step(env.action_space.low)[1] > 0.9
    step = env.unwrapped.step

    def lost(action):
        result = step(action)
        env.unwrapped.data.xpos[1] = math.nan
        return result

    env.unwrapped.step = lost
    with pytest.warns(UserWarning, match="no number"), pytest.raises(ArgumentError, match="is NaN"):
        env.step(env.action_space.low)
    env.close()


@pytest.mark.parametrize("vector", [False, True])
def test_the_opposite_of_what_is_not_decided_does_not_hold(vector):
    texts = {
        "success": "NOT eventually(z(sim.ball) < 0.2)",
        "failure": "NOT always(z(sim.ball) > 0.99)",
    }
    env = Fall()
    if vector:
        env = VectorQueryWrapper(gymnasium.vector.SyncVectorEnv([lambda: env] * 1), **texts)
    else:
        env = QueryWrapper(env, **texts, forward=False)
    env.reset(seed=0)
    flags = []
    for _ in range(8):
        info = env.step(np.zeros(env.action_space.shape, np.float32))[-1]["ssduck"]
        flags.append((bool(np.all(info["success"])), bool(np.all(info["failure"]))))
    assert flags[0] == (False, False)
    assert flags[-1] == (False, True)
    env.close()
