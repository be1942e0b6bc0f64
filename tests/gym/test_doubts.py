"""Terms that cannot be meant are told of: at construction, and after some episodes."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import SyncVectorEnv

from ssduck.errors import ArgumentError
from ssduck.gym import QueryWrapper, VectorQueryWrapper, make_task
from ssduck.gym.doubts import EPISODES
from tests.gym.test_unrecorded import Fall
from tests.support import warned
from tests.support.gym_environments import TASK, TASK_MODEL, Drop

# (success, whether it never or always holds in episodes of 1 s)
TOO_LONG = [
    ("eventually(z(sim.ball) < 0.9, 10, 20)", "never holds: it asks for what is 10 s ahead"),
    ("always(z(sim.ball) > 0.1, 0, 2)", "never holds: it asks for what is 2 s ahead"),
    ("once(z(sim.ball) > 0.1, 1.1, 3)", "never holds: it asks for what is 1.1 s ago"),
    ("NOT historically(z(sim.ball) > 0.1, 2)", "always holds: it asks for what is 2 s ago"),
    ("heldFor(z(sim.ball) > 0.1) > 5", "never holds: heldFor is from 0 to 1"),
    ("int(heldFor(z(sim.ball) > 0.1) > 5) == 1", "never holds: heldFor is from 0 to 1"),
]
LONG_ENOUGH = [
    "eventually(z(sim.ball) < 0.9, 0.5, 20)",
    "always(z(sim.ball) > 0.1, 0, 1)",
    "NOT always(z(sim.ball) > 0.1, 0, 2)",
    "NOT always(z(sim.ball) > 0.1) OR z(sim.ball) < 0.9",
    "once(z(sim.ball) > 0.1, 0, 3)",
    "historically(z(sim.ball) > 0.1, 1)",
    "heldFor(z(sim.ball) > 0.1) >= 1",
    "heldFor(z(sim.ball) > 0.1) < 5 AND z(sim.ball) < 0.9",
]


class Stepped(Fall):
    """A ball that falls, in an environment that says how long its steps are."""

    @property
    def frame_skip(self):
        return self.substeps

    @property
    def dt(self):
        return self.model.opt.timestep * self.frame_skip


def seconds(env, duration):
    """The environment, whose episodes end after a duration."""
    step = env.model.opt.timestep * env.substeps
    return gymnasium.wrappers.TimeLimit(env, round(duration / step))


def told(make, play=lambda _: None):
    """What is told while an environment is made, and while it is played."""
    made = []
    first = warned.told(lambda: made.append(make()))
    later = warned.told(play, made[0])
    made[0].close()
    return [first, later]


def play(env, episodes=1, holds=None):
    """Plays episodes until they end; a success is to hold at each step, or at none, if so given."""
    for seed in range(episodes):
        env.reset(seed=seed)
        over = False
        while not over:
            *_, terminated, truncated, info = env.step(env.action_space.sample())
            assert holds is None or info["ssduck"]["success"] is holds
            over = np.all(terminated | truncated)


@pytest.mark.parametrize(("success", "why"), TOO_LONG)
@pytest.mark.parametrize("kind", [Stepped, Fall])
def test_what_needs_more_time_than_an_episode_is_told_of_once(kind, success, why):
    """At construction if the environment says how long a step is, or else after an episode."""
    found = told(
        lambda: QueryWrapper(seconds(kind(), 1), success, forward=False),
        lambda env: play(env, 3, holds=False),
    )
    first, later = found if kind is Stepped else found[::-1]
    assert later == []
    (message,) = first
    assert message.startswith("success: ")
    assert success.removeprefix("NOT ").removeprefix("int(")[:30] in message
    assert why in message
    assert "an episode lasts 1 s" in message


def test_what_is_decided_at_no_step_is_told_of():
    success = "always(z(sim.ball) > 0.1) AND z(sim.ball) < 9"
    ((message,), later) = told(
        lambda: QueryWrapper(seconds(Stepped(), 1), success, forward=False),
        lambda env: play(env, holds=False),
    )
    assert message.startswith("success: always(z(sim.ball) > 0.1) holds at no step")
    assert "write historically" in message
    assert later == []


@pytest.mark.parametrize("success", LONG_ENOUGH)
def test_what_an_episode_has_time_for_is_not(success):
    make = lambda: QueryWrapper(seconds(Stepped(), 1), success, forward=False)  # noqa: E731
    assert told(make, play) == [[], []]


def test_a_wrapper_that_takes_several_steps_in_one_is_no_mistake():
    class Twice(gymnasium.Wrapper):
        def step(self, action):
            self.env.step(action)
            return self.env.step(action)

    env = gymnasium.wrappers.TimeLimit(Twice(Stepped()), 50)  # of 2 s
    success = "heldFor(z(sim.ball) > -1) >= 1.9"
    found = told(lambda: QueryWrapper(env, success, forward=False), lambda env: play(env, 2))
    assert found == [[], []]


def test_without_an_end_nothing_is_known():
    assert told(lambda: QueryWrapper(Stepped(), TOO_LONG[0][0], forward=False)) == [[], []]


def test_steps_of_pybullet_are_as_long_as_is_said():
    env = gymnasium.wrappers.TimeLimit(Drop(), 10)
    found, _ = told(
        lambda: QueryWrapper(env, reward="int(heldFor(getTime() > 0) > 3)", step_time=0.25)
    )
    (message,) = found
    assert "reward: heldFor(getTime() > 0) > 3 never holds: heldFor is from 0 to 2.5" in message


def test_environments_of_a_vector_are_told_of():
    def make():
        return seconds(Stepped(), 1)

    found, later = told(
        lambda: VectorQueryWrapper(SyncVectorEnv([make] * 2), failure=TOO_LONG[4][0]), play
    )
    assert later == []
    (message,) = found
    assert message.startswith("failure: heldFor(z(sim.ball) > 0.1) > 5 never holds")
    for text, why in (
        ("z(sim.ball) > 1 AND z(sim.ball) < 0", "never"),
        ("tilt(sim.ball) > 45", ""),
    ):
        with pytest.raises(ArgumentError, match=f"success: .*{why}"):
            VectorQueryWrapper(SyncVectorEnv([make] * 2), success=text)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "push.xml").write_text(TASK_MODEL)
    return tmp_path


def test_tasks_are_told_of(folder):
    text = TASK.replace(
        "x(sim.ball) > goal", "heldFor(z(sim.ball) > 0.3) >= 0.5 OR x(sim.ball) > 5"
    )
    (folder / "task.toml").write_text(text.replace("z(sim.ball) < 0.3", "z(sim.ball) < 3"))

    def reset(env):
        for _ in range(2 * EPISODES):
            env.reset()

    (first,), (second,) = told(lambda: make_task(folder / "task.toml"), reset)
    assert first.startswith("success: heldFor(z(sim.ball) > 0.3) >= 0.5 never holds")
    assert "an episode lasts 0.16 s" in first  # 8 steps of 0.02 s
    assert second.startswith(
        f"failure: 'z(sim.ball) < 3' held at the first tick of each of {EPISODES} "
    )


@pytest.mark.parametrize(
    ("terms", "key"),
    [
        ({"success": "z(sim.ball) > 0.1"}, "success"),
        ({"failure": "z(sim.ball) > 0.1", "success": "z(sim.ball) < 0.1"}, "failure"),
        ({"reward": "1", "stop_when": "z(sim.ball) > 0.1"}, "stop_when"),
        ({"success": "z(sim.ball) > 0.1", "stop_when": "success"}, "success"),
    ],
)
def test_what_holds_at_the_beginning_of_each_episode_is_told_of_once(terms, key):
    def make():
        return seconds(Fall(), 0.1)

    wrapped = (
        lambda: QueryWrapper(make(), **terms, forward=False),
        lambda: VectorQueryWrapper(SyncVectorEnv([make] * 2), **terms),
    )
    for number, wrap in enumerate(wrapped, 1):
        assert told(wrap, lambda env, n=number: play(env, (EPISODES - 1) // n)) == [[], []]
        first, (message,) = told(wrap, lambda env: play(env, 2 * EPISODES))
        assert first == []
        start = f"{key}: '{terms[key]}' held at the first tick of each of {EPISODES} episodes"
        assert message.startswith(start)


def test_one_episode_that_begins_otherwise_is_enough():
    class Once(Fall):
        def start(self):
            self.data.qpos[2] = 0.05 if self.np_random_seed == EPISODES - 2 else 1.0

    make = lambda: QueryWrapper(seconds(Once(), 0.1), "z(sim.ball) > 0.1", forward=False)  # noqa: E731
    assert told(make, lambda env: play(env, 3 * EPISODES)) == [[], []]
