"""Terms whose functions of time follow from tick to tick need no record of the episode."""

from __future__ import annotations

import gymnasium
import mujoco
import numpy as np
import pytest

import ssduck
from ssduck.errors import EvaluationError
from ssduck.gym import QueryWrapper
from ssduck.interpreter.planner import Planner

MODEL = """
<mujoco><worldbody>
  <geom type="plane" size="3 3 .1"/>
  <body name="ball" pos="0 0 1"><freejoint/><geom size=".05"/></body>
</worldbody></mujoco>
"""


class Fall(gymnasium.Env):
    """A ball that falls from 1 m."""

    observation_space = gymnasium.spaces.Box(-10, 10, (7,), np.float64)
    action_space = gymnasium.spaces.Box(-1, 1, (1,), np.float32)

    def __init__(self):
        self.model = mujoco.MjModel.from_xml_string(MODEL)
        self.data = mujoco.MjData(self.model)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_forward(self.model, self.data)
        return self.data.qpos.copy(), {}

    def step(self, action):
        mujoco.mj_step(self.model, self.data, 10)
        return self.data.qpos.copy(), 0.0, False, False, {}


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
        ("heldFor(rate(z(sim.ball)) < 0)", True),
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


def test_a_reset_makes_no_new_plan(monkeypatch):
    env = QueryWrapper(Fall(), success="heldFor(z(sim.ball) < 0.1) > 0.1", forward=False)
    heights(env, 5)
    heights(env, 5)
    made = []
    plan_for = Planner._plan_for
    monkeypatch.setattr(
        Planner, "_plan_for", lambda *args, **others: made.append(1) or plan_for(*args, **others)
    )
    heights(env, 5)
    assert not made
