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


def played(both, actions, *, resets=False, rtol=1e-12):
    """Yields what two vectors give for actions, which is the same; what ends is reset, if asked."""
    for action in actions:
        found, expected = (envs.step(action) for envs in both)
        for mine, other in zip(found[:4], expected[:4], strict=True):
            assert np.allclose(mine, other, rtol=rtol, atol=rtol)
        yield found, expected
        done = found[2] | found[3]
        if resets and done.any():
            # gymnasium takes the mask out of the options.
            first = [envs.reset(options={"reset_mask": done.copy()})[0] for envs in both]
            assert np.array_equal(*first)
    for envs in both:
        envs.close()


def number_ended(found):
    return int((found[2] | found[3]).sum())


@pytest.mark.slow
@sampled(
    "mode", [AutoresetMode.SAME_STEP, AutoresetMode.DISABLED, AutoresetMode.NEXT_STEP], every=3
)
def test_it_is_that_of_each_by_itself(mode, terms):
    wrapped = VectorQueryWrapper(SyncVectorEnv([make] * COUNT, autoreset_mode=mode), **terms)
    each = SyncVectorEnv(
        [lambda: QueryWrapper(make(), **terms, forward=False)] * COUNT, autoreset_mode=mode
    )
    assert np.array_equal(wrapped.reset(seed=7)[0], each.reset(seed=7)[0])
    actions = np.random.default_rng(0).uniform(-2, 2, (STEPS, COUNT, 1)).astype(np.float32)
    ended, resets = 0, mode == AutoresetMode.DISABLED
    for found, expected in played((wrapped, each), actions, resets=resets):
        ended += number_ended(found)
        infos = expected[4]["ssduck"]
        if mode != AutoresetMode.SAME_STEP:
            assert found[4]["ssduck"]["success"].tolist() == infos["success"].tolist()
        elif number_ended(found):
            number = int(np.flatnonzero(found[2] | found[3])[0])
            last = found[4]["final_info"]["ssduck"]
            assert last["success"][number] == expected[4]["final_info"]["ssduck"]["success"][number]
    assert ended > 3


@pytest.mark.slow
@sampled("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED], every=2)
def test_environments_in_other_processes_are_judged_alike(mode, terms):
    terms = {name: term for name, term in terms.items() if name != "stop_when"}
    both = [
        VectorQueryWrapper(kind([make] * 2, autoreset_mode=mode), **terms)
        for kind in (SyncVectorEnv, AsyncVectorEnv)
    ]
    for envs in both:
        envs.reset(seed=3)
    actions = [np.full((2, 1), np.sin(step), np.float32) for step in range(30)]
    ended, resets = 0, mode == AutoresetMode.DISABLED
    for here, there in played(both, actions, resets=resets, rtol=0):
        assert here[4]["ssduck"]["success"].tolist() == there[4]["ssduck"]["success"].tolist()
        ended += number_ended(here)
    assert ended


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
    actions = [np.full((COUNT, 1), 0.4, np.float32)] * STEPS
    assert sum(number_ended(found) for found, _ in played((shown, other), actions, resets=True))
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
