"""MuJoCo's poses lag its joint positions by a step: a warning where a flag depends on which it sees."""

import warnings

import numpy as np
import pytest

from ssduck.errors import ProgramWarning
from ssduck.gym import QueryWrapper
from tests.support.of_model import OfModel

MODEL = """
<mujoco><option gravity="0 0 0"/><worldbody>
  <body name="table"><geom type="box" size=".1 .1 .1"/></body>
  <body name="ball" pos="0 0 1"><freejoint/><geom size=".05"/></body>
</worldbody></mujoco>
"""


class Drift(OfModel):
    """A ball that drifts by 2 mm a step; its flag goes by `qpos` or by `xpos`."""

    def __init__(self, reads="qpos"):
        super().__init__(MODEL)
        self.reads, self.goal = reads, 0.0205

    def start(self):
        self.data.qvel[0] = 1.0

    def step(self, action):
        result = super().step(action)
        x = self.data.qpos[0] if self.reads == "qpos" else self.data.body("ball").xpos[0]
        return *result[:-1], {"done": bool(x > self.goal)}


TERMS = {"variables": {"goal": lambda env: env.goal}}


def flags(env, steps=15):
    """The flags of ssduck and of the environment at each step."""
    env.reset(seed=0)
    infos = [env.step(np.zeros(1))[-1] for _ in range(steps)]
    env.close()
    return [info["ssduck"]["success"] for info in infos], [info["done"] for info in infos]


@pytest.mark.slow
@pytest.mark.parametrize(
    "success", ["x(sim.ball) > goal", "heldFor(x(sim.ball) > goal) >= 0 AND x(sim.ball) > goal"]
)
def test_the_step_at_which_they_differ_is_told_of_once(success):
    env = QueryWrapper(Drift(), success=success, **TERMS)
    text = r"step 11: success is False by MuJoCo's poses.* and True by .*forward=True"
    with pytest.warns(ProgramWarning, match=text) as caught:
        mine, theirs = flags(env)
    assert len(caught) == 1
    assert [caught[0].filename] == [__file__]
    assert [n for n in range(15) if mine[n] != theirs[n]] == [10]


@pytest.mark.parametrize(("reads", "forward"), [("qpos", True), ("xpos", False)])
def test_who_says_what_the_environment_reads_is_not_told(reads, forward):
    env = QueryWrapper(Drift(reads), success="x(sim.ball) > goal", forward=forward, **TERMS)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mine, theirs = flags(env)
    assert mine == theirs
    assert set(mine) == {True, False}


def test_where_no_flag_differs_nothing_is_told():
    env = QueryWrapper(Drift(), success="z(sim.ball) > goal", reward="x(sim.ball)", **TERMS)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mine, _ = flags(env)
    assert mine == [True] * 15


def run(env, steps):
    env.reset(seed=0)
    for _ in range(steps):
        env.step(np.zeros(1))


class Pulled(Drift):
    """A ball that gets faster; the environment has a rate of its own, by `qpos`."""

    def __init__(self):
        super().__init__()
        self.model.opt.gravity[0] = 5.0
        self.lost = float("nan")

    def step(self, action):
        before = self.data.qpos[0]
        result = super().step(action)
        self.speed = (self.data.qpos[0] - before) / self.model.opt.timestep
        return result


@pytest.mark.slow
@pytest.mark.parametrize(
    "term",
    [
        "rate(x(sim.ball))",
        "speed(sim.ball)",
        "3 * norm(linearVelocity(sim.ball))",
        "(x(sim.ball) - x(previous(sim.ball))) / 0.002",
    ],
)
def test_a_number_that_says_how_fast_something_moves_is_told_of(term):
    reward = {"lost": "lost", "fast": term, "where": "x(sim.ball)"}
    variables = {"lost": lambda env: env.lost}
    env = QueryWrapper(Pulled(), reward=reward, variables=variables, nan=-7.0)
    with pytest.warns(ProgramWarning, match=r"step \d: reward\['fast'\] is .* and .*forward=True"):
        run(env, 4)
    env.close()
    forward = QueryWrapper(
        Pulled(), reward="rate(x(sim.ball))", stop_when="x(sim.ball) > 9", forward=True
    )
    forward.reset(seed=0)
    for _ in range(4):
        assert forward.step(np.zeros(1))[1] == pytest.approx(forward.unwrapped.speed, rel=1e-6)
    forward.close()


@pytest.mark.parametrize("nan", ["failure", -7.0])
@pytest.mark.parametrize(
    "terms",
    [
        {"success": "z(sim.ball) > 2", "reward": "lost"},
        {"success": "lost > 1", "stop_when": "success OR z(sim.ball) > 2", "reward": "x(sim.ball)"},
        {"reward": {"lost": "lost", "fast": "rate(z(sim.ball))"}},
    ],
)
def test_what_is_nan_by_both_poses_does_not_differ(nan, terms):
    env = QueryWrapper(Drift(), **terms, variables={"lost": lambda env: float("nan")}, nan=nan)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(2):
            env.reset(seed=0)
            env.step(np.zeros(1))
    env.close()


def test_at_a_step_with_nan_the_flags_that_are_known_are_compared():
    lost = {"lost": lambda env: float("nan"), "goal": lambda env: env.goal}
    env = QueryWrapper(
        Drift(), success="x(sim.ball) > goal", reward="lost", variables=lost, nan=0.0
    )
    with pytest.warns(ProgramWarning, match=r"step 11: success is False by MuJoCo's poses"):
        run(env, 12)
    env.close()
