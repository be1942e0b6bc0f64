"""A vector of environments judges each as `QueryWrapper` does by itself."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv

from ssduck.errors import ArgumentError, SimulatorError
from ssduck.gym import QueryWrapper, VectorQueryWrapper
from tests.support.cases import generated, sampled

COUNT, STEPS = 3, generated(30)


def make():
    return gymnasium.make("InvertedPendulum-v5", max_episode_steps=25)


def entity_names():
    env = QueryWrapper(make(), reward="1", forward=False)
    names = [entity.name for entity in env.interpreter["sim"].snapshot.entities]
    env.close()
    return names


@pytest.fixture(scope="module")
def terms():
    name = entity_names()[-1]
    return {
        "success": f"heldFor(z(sim.{name}) >= 0) > 0.1",
        "reward": {"place": f"x(sim.{name}.pole)", "speed": f"-0.1 * rate(x(sim.{name}.pole))"},
        "stop_when": f"x(sim.{name}.pole) > 0.05 OR rate(x(sim.{name}.pole)) < -0.6",
    }


@pytest.mark.slow
@sampled(
    "mode", [AutoresetMode.SAME_STEP, AutoresetMode.DISABLED, AutoresetMode.NEXT_STEP], every=3
)
def test_it_is_that_of_each_by_itself(mode, terms):
    wrapped = VectorQueryWrapper(SyncVectorEnv([make] * COUNT, autoreset_mode=mode), **terms)
    each = SyncVectorEnv(
        [lambda: QueryWrapper(make(), **terms, forward=False)] * COUNT, autoreset_mode=mode
    )
    draw, ended = np.random.default_rng(0), 0
    found, expected = wrapped.reset(seed=7), each.reset(seed=7)
    assert np.array_equal(found[0], expected[0])
    for _ in range(STEPS):
        actions = draw.uniform(-2, 2, (COUNT, 1)).astype(np.float32)
        found, expected = wrapped.step(actions), each.step(actions)
        for mine, other in zip(found[:4], expected[:4], strict=True):
            assert np.allclose(mine, other, rtol=1e-12)
        done = found[2] | found[3]
        ended += int(done.sum())
        infos = expected[4]["ssduck"]
        if mode != AutoresetMode.SAME_STEP:
            assert found[4]["ssduck"]["success"].tolist() == infos["success"].tolist()
        elif done.any():
            number = int(np.flatnonzero(done)[0])
            last = found[4]["final_info"]["ssduck"]
            assert last["success"][number] == expected[4]["final_info"]["ssduck"]["success"][number]
        if mode == AutoresetMode.DISABLED and done.any():
            # gymnasium takes the mask out of the options.
            found, expected = (e.reset(options={"reset_mask": done}) for e in (wrapped, each))
            assert np.array_equal(found[0], expected[0])
    assert ended > 3
    wrapped.close()
    each.close()


@pytest.mark.slow
@sampled("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED], every=2)
def test_environments_in_other_processes_are_judged_alike(mode, terms):
    terms = {name: term for name, term in terms.items() if name != "stop_when"}
    options = {"autoreset_mode": mode}
    both = [
        VectorQueryWrapper(kind([make] * 2, **options), **terms)
        for kind in (SyncVectorEnv, AsyncVectorEnv)
    ]
    for envs in both:
        envs.reset(seed=3)
    ended = 0
    for step in range(30):
        here, there = [envs.step(np.full((2, 1), np.sin(step), np.float32)) for envs in both]
        for mine, other in zip(here[:4], there[:4], strict=True):
            assert np.array_equal(mine, other)
        assert here[4]["ssduck"]["success"].tolist() == there[4]["ssduck"]["success"].tolist()
        done = here[2] | here[3]
        ended += int(done.sum())
        if mode == AutoresetMode.DISABLED and done.any():
            for envs in both:
                envs.reset(options={"reset_mask": done.copy()})
    assert ended
    for envs in both:
        envs.close()


def test_environments_in_other_processes_without_data_are_an_error():
    envs = AsyncVectorEnv([lambda: gymnasium.make("CartPole-v1")])
    with pytest.raises(SimulatorError, match="no MuJoCo model"):
        VectorQueryWrapper(envs, reward="1")
    envs.close()


@pytest.mark.slow
def test_states_in_arrays(terms):
    class Arrays(SyncVectorEnv):
        """A vector whose states are arrays, as those of a device."""

        def state(self):
            data = [env.unwrapped.data for env in self.envs]
            names = ("xpos", "xquat", "cvel", "subtree_com", "site_xpos", "qpos", "qvel")
            arrays = {name: np.stack([getattr(one, name) for one in data]) for name in names}
            return arrays | {"time": np.array([one.time for one in data])}

    def vector():
        return Arrays([make] * COUNT, autoreset_mode=AutoresetMode.DISABLED)

    env, model = vector(), make().unwrapped.model
    shown = VectorQueryWrapper(env, **terms, state=lambda e: e.unwrapped.state(), model=model)
    other = VectorQueryWrapper(vector(), **terms)
    assert np.array_equal(shown.reset(seed=3)[0], other.reset(seed=3)[0])
    for _ in range(STEPS):
        found, expected = (one.step(np.full((COUNT, 1), 0.4, np.float32)) for one in (shown, other))
        for mine, wanted in zip(found[:4], expected[:4], strict=True):
            assert np.allclose(mine, wanted)
        done = found[2] | found[3]
        if done.any():
            shown.reset(options={"reset_mask": done})
            other.reset(options={"reset_mask": done})
    shown.close()
    other.close()
    same = SyncVectorEnv([make], autoreset_mode=AutoresetMode.SAME_STEP)
    with pytest.raises(ArgumentError, match="SAME_STEP"):
        VectorQueryWrapper(same, reward="1", state=lambda _: {}, model=model)
    with pytest.raises(ArgumentError, match="give the model"):
        VectorQueryWrapper(vector(), reward="1", state=lambda _: {})


def test_variables_have_a_value_for_each_environment(terms):
    wrapped = VectorQueryWrapper(
        SyncVectorEnv([make] * COUNT),
        reward="goal[0] + scale",
        variables={"goal": lambda _: np.arange(6.0).reshape(3, 2), "scale": lambda _: 0.5},
    )
    wrapped.reset(seed=0)
    assert wrapped.step(np.zeros((COUNT, 1), np.float32))[1].tolist() == [0.5, 2.5, 4.5]
    wrapped.close()


def test_others_are_errors():
    with pytest.raises(SimulatorError, match="QueryWrapper"):
        VectorQueryWrapper(SyncVectorEnv([lambda: gymnasium.make("CartPole-v1")]), reward="1")
    with pytest.raises(ArgumentError, match="at hand"):
        VectorQueryWrapper(gymnasium.make_vec("CartPole-v1", num_envs=2), reward="1")
