"""An episode is what lies between two resets, whatever the time of the simulator does."""

import warnings

import gymnasium
import mujoco
import numpy as np
import pytest

import ssduck
from ssduck.errors import ProgramWarning, RecordError, SimulatorError
from ssduck.gym import QueryWrapper, score
from ssduck.recording.episode_steps import EpisodeSteps
from tests.support.gym_environments import Drop
from tests.support.of_model import OfModel

TEXT = """
<mujoco><option gravity="0 0 0"/><worldbody><body name="a"><freejoint/>
<geom type="sphere" size=".1" mass="1"/></body></worldbody></mujoco>
"""
TERMS = {"success": "x(sim.a) > 5", "reward": "x(sim.a) - initially(x(sim.a))"}
FALLS = r"MuJoCo's time fell to 0.02 s within an episode"


class Flight(OfModel):
    """A ball that flies; the state becomes unstable at some steps.

    Args:
        kicks: the steps at which it does.
        most: the number of steps after which an episode is over.
        change: what else happens at step 3.
    """

    def __init__(self, kicks=(), most=4, change=None):
        super().__init__(TEXT, 10)
        self.kicks, self.most, self.change, self.steps = kicks, most, change, 0

    def start(self):
        self.data.qpos[0], self.data.qvel[0], self.steps = 0.5, 1.0, 0

    def step(self, action):
        self.steps += 1
        if self.steps in self.kicks:
            self.data.qvel[0] = 1e12
        info = {}
        if self.steps == 3:
            info = (self.change and self.change(self)) or {}
        observation, *_ = super().step(action)
        return observation, 0.0, False, self.steps >= self.most, info


class Turn(Flight):
    """A simulation that is placed, and whose time stands still."""

    def step(self, action):
        self.steps += 1
        self.data.qpos[0] += 0.1
        mujoco.mj_forward(self.model, self.data)
        return self.data.qpos.copy(), 0.0, False, self.steps >= self.most, {}


def run(env, folder, steps, **terms):
    """Returns the rewards of some steps, the ticks of each episode, and the scores."""
    env = QueryWrapper(env, **(terms or TERMS), record_to=folder)
    env.reset(seed=0)
    rewards = [env.step(np.zeros(1))[1] for _ in range(steps)]
    env.close()
    ticks = [episode.ticks for episode in ssduck.episodes(folder)]
    return rewards, ticks, [one.rewards for one in score(folder, reward=(terms or TERMS)["reward"])]


@pytest.mark.slow
@pytest.mark.parametrize("kicks", [(2,), (3,), (2, 3)])
def test_an_unstable_state_that_mujoco_resets_ends_no_episode(tmp_path, monkeypatch, kicks):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log
    with pytest.warns(ProgramWarning, match=FALLS + r".*unstable \(a smaller timestep"):
        rewards, ticks, scores = run(Flight(kicks), tmp_path / "record", 4)
    assert (ticks, scores) == ([5], [tuple(rewards)])
    # MuJoCo's state is that of the model then: x is 0, and 0.5 at the episode's first tick.
    assert rewards[kicks[0] - 1 :] == pytest.approx([-0.5] * (5 - kicks[0]))
    steps = EpisodeSteps.read(tmp_path / "record", "sim", 0)
    # Two states that MuJoCo reset, one after the other, do not differ: no time has passed for it.
    assert kicks == (2, 3) or steps.times == pytest.approx([0, 0.02, 0.04, 0.06, 0.08])


@pytest.mark.slow
def test_an_unstable_state_in_a_loop(tmp_path, monkeypatch):
    """The time is that of PyBullet, which resets nothing; a reset by the user begins an episode."""
    monkeypatch.chdir(tmp_path)
    model = mujoco.MjModel.from_xml_string(TEXT)
    data = mujoco.MjData(model)
    with ssduck.Interpreter() as ss:
        ss["sim"] = world = ssduck.World.attach(model, data)
        mujoco.mj_step(model, data, 10)
        mujoco.mj_step(model, data, 10)
        run = world.tick().snapshot.run
        data.qvel[0] = 1e12
        mujoco.mj_step(model, data, 10)
        with pytest.warns(ProgramWarning, match=FALLS):
            world.tick()
        assert (world.snapshot.run, world.time) == (run, pytest.approx(0.08))
        mujoco.mj_step(model, data, 10)
        assert world.tick().time == pytest.approx(0.1)
        assert ss.past("sim").times == pytest.approx([0, 0.04, 0.08, 0.1])
        mujoco.mj_resetData(model, data)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            world.tick()
        assert (world.snapshot.run == run, world.time) == (False, 0.0)


def test_a_loop_that_begins_its_episodes_is_told_of_other_resets():
    model = mujoco.MjModel.from_xml_string(TEXT)
    data = mujoco.MjData(model)
    world = ssduck.World.attach(model, data)
    run = world.begin_episode().snapshot.run
    mujoco.mj_step(model, data, 5)
    world.tick()
    mujoco.mj_resetData(model, data)
    with pytest.warns(ProgramWarning, match=r"reset without begin_episode\(\)"):
        world.tick()
    assert (world.time, world.snapshot.run) == (pytest.approx(0.02), run)
    mujoco.mj_resetData(model, data)
    assert world.begin_episode().time == 0.0


@pytest.mark.slow
def test_a_reset_within_is_an_episode_of_both_simulators(tmp_path):
    within = gymnasium.wrappers.Autoreset(Flight())
    rewards, ticks, scores = run(within, tmp_path / "mujoco", 7)
    assert ticks == [5, 3]
    assert rewards[4] == 0.0  # the reset
    assert scores == [tuple(rewards[:4]), tuple(rewards[5:])]
    assert rewards[5:] == rewards[:2]  # initially(…) is of the episode's first tick
    within = gymnasium.wrappers.Autoreset(gymnasium.wrappers.TimeLimit(Drop(), 4))
    reward = "z(sim.body_1) - initially(z(sim.body_1))"
    rewards, ticks, scores = run(within, tmp_path / "pybullet", 7, reward=reward)
    assert ticks == [5, 3]
    assert scores == [tuple(rewards[:4]), tuple(rewards[5:])]
    assert rewards[5:] == rewards[:2]
    assert rewards[0] < 0


@pytest.mark.slow
def test_a_time_that_stands_still(tmp_path):
    rewards, ticks, scores = run(Turn(), tmp_path, 3, reward="x(sim.a)")
    assert rewards == pytest.approx([0.6, 0.7, 0.8])
    assert (ticks, scores) == ([4], [tuple(rewards)])


@pytest.mark.slow
def test_steps_after_the_end_are_told_of(tmp_path):
    env = QueryWrapper(Flight(most=2), **TERMS, record_to=tmp_path)
    env.reset()
    env.step(np.zeros(1))
    env.step(np.zeros(1))
    with pytest.warns(ProgramWarning, match=r"has ended.*same episode: call reset; .*Autoreset"):
        env.step(np.zeros(1))
    env.close()
    assert [episode.ticks for episode in ssduck.episodes(tmp_path)] == [4]
    assert [len(one.rewards) for one in score(tmp_path, reward="x(sim.a)")] == [3]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda env: env.build(), "made its simulation anew within an episode.*call reset"),
        (lambda _: {"final_observation": 0}, "info has 'final_observation'.*QueryWrapper first"),
    ],
)
def test_episodes_that_terms_cannot_see_are_errors(change, message):
    env = QueryWrapper(Flight(change=change), **TERMS)
    env.reset()
    env.step(np.zeros(1))
    env.step(np.zeros(1))
    with pytest.raises(SimulatorError, match=message):
        env.step(np.zeros(1))
    env.close()


@pytest.mark.parametrize(
    "steps",
    [
        EpisodeSteps({}, times=[0.1, 0.0], ticks=[1, 2], rewards=[0.0]),
        EpisodeSteps({}, times=[0.0, 0.1], ticks=[2, 1], rewards=[0.0]),
    ],
)
def test_steps_of_two_episodes_are_not_written(tmp_path, steps):
    with pytest.raises(RecordError, match="not of one episode"):
        steps.write(tmp_path, "sim", 0)
    assert list(tmp_path.iterdir()) == []
