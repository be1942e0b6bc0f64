"""`QueryWrapper`: success, failure, reward and episodes by queries on the simulation."""

import re

import gymnasium
import numpy as np
import pybullet
import pytest
from gymnasium.utils.env_checker import check_env

import ssduck
from ssduck.errors import ArgumentError, SelectScriptError, SimulatorError, UnknownNameError
from ssduck.gym import QueryWrapper, score
from tests.support.cases import sampled
from tests.support.gym_environments import Drop, Push

GOAL = {"goal": lambda env: env.goal}
REWARD = "-sqrt((x(sim.ball) - goal[0])^2 + (y(sim.ball) - goal[1])^2 + (z(sim.ball) - goal[2])^2)"


@pytest.fixture
def wrap():
    """Wraps environments, and closes them in the end."""
    wrapped = []

    def make(env, *terms, **options):
        wrapped.append(QueryWrapper(env, *terms, **options))
        return wrapped[-1]

    yield make
    for env in wrapped:
        env.close()


def episode(env, seed, steps=20, action=1.0):
    """Runs an episode; yields the reward and the `info` of each step."""
    env.reset(seed=seed)
    for _ in range(steps):
        _, reward, terminated, truncated, info = env.step(np.array([action], np.float32))
        yield reward, terminated, info["ssduck"]
        if terminated or truncated:
            return


@pytest.mark.slow
def test_agrees_with_the_environment(wrap):
    env = wrap(
        Push(),
        success="on(sim.table, sim.ball) AND x(sim.ball) > goal[0]",
        reward=REWARD,
        variables=GOAL,
    )
    plain = Push()
    successes = []
    for seed in range(3):
        plain.reset(seed=seed)
        for reward, terminated, info in episode(env, seed, 60):
            expected = plain.step(1.0)[1]
            ball = plain.data.body("ball").xpos
            assert reward == info["reward"] == pytest.approx(expected, abs=1e-12)
            assert info["success"] == (ball[0] > plain.goal[0])
            assert not terminated
            successes.append(info["success"])
    assert {True, False} == set(successes)


@pytest.mark.slow
def test_history_begins_at_a_reset(wrap):
    env = wrap(Push(), success="heldFor(on(sim.table, sim.ball)) >= 0.1")
    for seed in range(2):
        seen = [info["success"] for _, _, info in episode(env, seed, 15)]
        # A step takes 0.01 s.
        first = seen.index(True)
        assert first in (9, 10), seen
        assert seen == [False] * first + [True] * (15 - first)


@pytest.mark.slow
def test_the_step_before_and_the_start_in_terms(wrap):
    inner = Push()
    env = wrap(
        inner,
        success="distance(sim.ball, sim{0.0}.ball) > 9",
        reward={
            "place": "x(sim.pusher)",
            "speed": "rate(x(sim.pusher))",
            "nearer": "previous(x(sim.pusher)) - x(sim.pusher)",
            "moved": "x(sim.pusher) - at(0.0, x(sim.pusher))",
            "since": "distance(sim.pusher, sim{0.0}.pusher)",
        },
    )
    for _ in range(2):  # the past begins anew at a reset
        places, starts = [], []
        for _, _, info in episode(env, 0, 4):
            parts = info["parts"]
            places.append((inner.data.time, parts["place"]))
            start = parts["place"] - parts["moved"]
            assert parts["since"] == pytest.approx(abs(parts["moved"]), abs=1e-12)
            if len(places) > 1:
                (before, a), (now, b) = places[-2:]
                assert parts["speed"] == pytest.approx((b - a) / (now - before), abs=1e-9)
                assert parts["nearer"] == pytest.approx(a - b, abs=1e-12)
                assert start == pytest.approx(starts[-1], abs=1e-12)
                assert parts["moved"] != 0
            starts.append(start)


@pytest.mark.slow
def test_the_past_has_the_tables_that_terms_read(wrap):
    near = "joint(sim.pusher, 'push') < 0.01"
    env = wrap(
        Push(), success=f"heldFor({near}) >= 0.03", reward=f"heldFor(NOT {near})", failure=near
    )
    held = [True]  # at the reset
    for _, _, info in episode(env, 0, 60):
        held.append(info["failure"])
        ticks = held[::-1].index(False) if False in held else len(held)  # 0.01 s apart
        assert info["success"] == (ticks > 3)
        assert (info["reward"] > 0) == (not any(held[-2:]))
    assert {True, False} == set(held)


@pytest.mark.slow
def test_a_reset_without_steps_begins_an_episode(wrap, tmp_path):
    env = wrap(Push(), success="x(sim.ball) > 0.02", record_to=tmp_path)
    for _ in range(3):
        env.reset()
    list(episode(env, 0, 3))
    env.close()
    assert [(one.number, one.ticks) for one in ssduck.episodes(tmp_path)] == [
        (0, 1),
        (1, 1),
        (2, 1),
        (3, 4),
    ]


@pytest.mark.slow
@pytest.mark.parametrize("reconnects", [False, True])
def test_pybullet(wrap, reconnects):
    env = wrap(
        Drop(reconnects=reconnects),
        success="heldFor(z(sim.body_1) < 0.11) >= 0.1",
        reward="-z(sim.body_1)",
        step_time=4 / 240,
    )
    for _ in range(2):
        observation, info = env.reset()
        assert info["ssduck"]["reward"] == -observation[2]
        seen = []
        for _ in range(60):
            observation, reward, _, _, info = env.step(0)
            assert reward == -observation[2]
            seen.append((observation[2] < 0.11, info["ssduck"]["success"]))
        low = [is_low for is_low, _ in seen].index(True)
        done = [is_done for _, is_done in seen].index(True)
        assert low + 6 <= done <= low + 7


def test_a_bonus_of_each_step_and_a_limit_of_time():
    env = QueryWrapper(
        Push(),
        reward={"height": "z(sim.ball)", "alive": "1.0", "time": "-0.25"},
        stop_when="getTime() > 0.05",
    )
    env.reset()
    for _ in range(30):
        _, reward, terminated, _, _ = env.step(0)
        data = env.unwrapped.data
        assert reward == pytest.approx(data.body("ball").xpos[2] + 0.75, abs=1e-4)
        assert terminated == (data.time > 0.05)
    assert terminated


@pytest.mark.parametrize(
    ("terms", "error", "message"),
    [
        ({"success": "on(sim.tabel, sim.ball)"}, UnknownNameError, "success: .*'tabel'.*'table'"),
        ({"success": "onn(sim.table, sim.ball)"}, UnknownNameError, "success: .*'onn'"),
        ({"success": "z(sim.ball)"}, ArgumentError, "success: .* not True or False"),
        ({"success": "always(z(sim.ball) > 0)"}, ArgumentError, "always may depend on later steps"),
        ({"reward": "z(sim.ball) > 1"}, ArgumentError, r"reward: .* not a number: int\("),
        ({"reward": {"a": "z(sim.ball) > 1"}}, ArgumentError, r"reward\['a'\]: .* not a number"),
        ({"success": "1 > 2"}, ArgumentError, "can never change: it has no entity"),
        (
            {"success": "z(sim.table) > 2"},
            ArgumentError,
            "change: no joint moves table.*variables={",
        ),
        ({"success": "z(sim.ball) >"}, SelectScriptError, "success: "),
        ({"success": "z(sim.ball) > 1; 2"}, ArgumentError, "one expression"),
        (
            {"reward": {"a": "-distance(sim.pusher, sim.ball)^2"}},
            ArgumentError,
            r"reward\['a'\]: this is \(-distance\(sim.pusher, sim.ball\)\)\^2; .*or "
            r"-\(distance\(sim.pusher, sim.ball\)\^2\)",
        ),
        ({"success": "exp(-x(sim.ball)^2) > 2"}, ArgumentError, r"success: .*-\(x\(sim.ball\)\^2"),
        ({"success": ""}, ArgumentError, "success: a term is a text"),
        ({"reward": {"alive": 1.0}}, ArgumentError, "not 1.0: write '1.0'"),
        ({"success": "success AND z(sim.ball) > 1"}, ArgumentError, "success is what this term"),
        ({"success": "time > 3"}, UnknownNameError, r"the simulated time now is getTime\(\)"),
        (
            {"reward": {"a": "z(sim.ball)", "b": "2 * a"}},
            UnknownNameError,
            r"\['b'\]: .* terms can use success and failure",
        ),
        (
            {"success": "heldFor(z(sim.ball) < 1, 0.2)"},
            ArgumentError,
            r"heldFor\(condition\) >= 0.2",
        ),
        ({"success": "x(sim.ball) > 9 AND z(sim.bal) > 1"}, UnknownNameError, "success: .*'ball'"),
        ({"failure": "x(sim.ball) < 9 OR z(sim.bal) > 1"}, UnknownNameError, "failure: .*'ball'"),
        ({"success": "x(sim.table.tabel) > 1"}, SelectScriptError, "did you mean 'table'"),
        ({"success": "x(sim.table.site) > 1"}, SelectScriptError, "'site'; its links: table;"),
        ({"success": "joint(sim.pusher, 'psuh') > 1"}, SelectScriptError, "'psuh'; .*'push'"),
        ({"success": "x(sim.ball) > goal", "variables": {"gaol": len}}, UnknownNameError, "'gaol'"),
        ({}, ArgumentError, "give a term"),
        (
            {"success": "z(sim.ball) > hight"},
            UnknownNameError,
            r"variables=\{'hight': lambda env: ",
        ),
        (
            {"reward": {"a": "-x(sim.ball) - goal[0]"}},
            UnknownNameError,
            r"\['a'\]: .* variables=\{'goal'",
        ),
        ({"success": "z(ball) > 1"}, UnknownNameError, "'ball'; for the entity, write sim.ball$"),
        ({"success": "z(sim.tray) > 1"}, UnknownNameError, r"'tray'; .* write sim\.pusher\.tray$"),
        ({"success": "z(sim.trai) > 1"}, UnknownNameError, r"did you mean 'pusher\.tray'\?"),
        ({"stop_when": "success"}, ArgumentError, "no such term"),
        ({"success": "x(sim.ball) > 1", "variables": {"sim": abs}}, ArgumentError, "the world"),
        ({"success": "x(sim.ball) > 1", "variables": {"goal": 3}}, ArgumentError, "function"),
    ],
)
def test_errors_at_construction(terms, error, message):
    with pytest.raises(error) as raised:
        QueryWrapper(Push(), **terms)
    assert re.search(message, str(raised.value), re.MULTILINE)


class Moving(Push):
    """An environment whose goal is a list that it changes in place."""

    def step(self, action):
        self.goal[0] += 0.01
        self.goals[1][0] += 0.01
        return super().step(action)

    def reset(self, **options):
        result = super().reset(**options)
        self.goal, self.goals = [0.1, 0.0, 0.45], [[0.0, 0.0], [0.1, 0.0]]
        return result


@pytest.mark.slow
@pytest.mark.parametrize(
    ("reward", "value"),
    [
        ("-distance(sim.ball, goal)", lambda ball, goal: -np.linalg.norm(ball - goal)),
        ("x(sim.ball) - goal[0]", lambda ball, goal: ball[0] - goal[0]),
        ("x(sim.ball) - goals[1][0]", lambda ball, goal: ball[0] - goal[0]),
    ],
)
def test_a_list_that_changes_in_place_is_read_at_each_step(wrap, tmp_path, reward, value):
    variables = {name: (lambda env, name=name: getattr(env, name)) for name in ("goal", "goals")}
    env = wrap(Moving(), reward=reward, variables=variables, record_to=tmp_path / "run")
    rewards = []
    for one, _, _ in episode(env, 0, 10):
        ball = env.unwrapped.data.body("ball").xpos
        assert one == pytest.approx(value(ball, np.array(env.unwrapped.goal)), abs=1e-12)
        rewards.append(one)
    assert len(set(rewards)) == 10
    env.close()
    (scored,) = score(tmp_path / "run", reward=reward)
    assert list(scored.rewards) == rewards


@pytest.mark.slow
def test_a_score_tells_which_variables_are_recorded(wrap, tmp_path):
    for name, variables in (("without", {}), ("with", {"goal": lambda env: env.goal})):
        env = wrap(
            Push(), success="x(sim.ball) > 1", variables=variables, record_to=tmp_path / name
        )
        list(episode(env, 0, 2))
        env.close()
    for name, message in (("without", "has no variables"), ("with", "has the variables goal")):
        with pytest.raises(UnknownNameError, match=f"'height'; .*the record {message}"):
            list(score(tmp_path / name, success="z(sim.ball) > height"))


@pytest.mark.parametrize(
    ("read", "error", "message"),
    [
        (lambda env: env.goal[:2], ArgumentError, r"variables\['goal'\]: a term uses goal\[2\]"),
        (lambda env: env, ArgumentError, r"variables\['goal'\] is .*: a variable is"),
        (lambda env: env.gaol, AttributeError, "gaol"),
    ],
)
def test_variables_are_checked_at_the_first_reset(wrap, read, error, message):
    with pytest.raises(UnknownNameError, match="'bal'"):  # what needs no variable is, before
        QueryWrapper(Push(), reward=REWARD, success="x(sim.bal) > 1", variables={"goal": read})
    env = wrap(Push(), reward=REWARD, variables={"goal": read})
    with pytest.raises(error, match=message):
        env.reset()


@pytest.mark.slow
def test_gaps_of_what_has_no_shape_are_errors():
    """Pusher's goal is a disc that collides with nothing."""
    for term in ("near(sim.object, sim.goal, 10)", "0 < clearance(sim['object'], sim.goal)"):
        with pytest.raises(
            ArgumentError, match=r"of sim.goal, which has none .* distance\(sim.goal"
        ):
            QueryWrapper(gymnasium.make("Pusher-v5"), success=term)
    env = QueryWrapper(gymnasium.make("Pusher-v5"), reward="-distance(sim.object, sim.goal)")
    env.reset(seed=0)
    places = [env.unwrapped.get_body_com(name) for name in ("object", "goal")]
    reward = env.step(np.zeros(7, np.float32))[1]
    assert reward == pytest.approx(-np.linalg.norm(places[0] - places[1]), abs=1e-3)
    env.close()


def test_an_environment_without_a_simulation():
    env = gymnasium.make("CartPole-v1", disable_env_checker=True)
    with pytest.raises(SimulatorError, match=r"no MuJoCo model .* PyBullet"):
        QueryWrapper(env, success="z(sim.pole) > 1")


def test_an_entity_that_is_gone_is_an_error(wrap):
    env = wrap(Drop(), reward="-distance(sim.body_0, sim.body_1)")
    env.reset()
    pybullet.removeBody(0, env.unwrapped.physics_client)
    with pytest.raises(UnknownNameError, match="'body_0'"):
        env.step(0)


def make_held():
    held = "heldFor(on(sim.table, sim.ball))"
    return QueryWrapper(Push(most=4), success=f"{held} >= 0.015", reward=held)


@pytest.mark.slow
@sampled("kind", ["SyncVectorEnv", "AsyncVectorEnv"], every=2)
def test_history_begins_at_the_resets_of_vector_environments(kind):
    envs = getattr(gymnasium.vector, kind)([make_held, make_held])
    try:
        _, infos = envs.reset(seed=3)
        successes, rewards = [list(infos["ssduck"]["success"])], []
        for _ in range(9):  # a step takes 0.01 s; the fifth one resets the environments
            _, reward, _, _, infos = envs.step(np.ones((2, 1), np.float32))
            successes.append(list(infos["ssduck"]["success"]))
            rewards.append(reward)
    finally:
        envs.close()
    one = [False, False, True, True, True]
    assert successes == [[is_held] * 2 for is_held in one * 2]
    expected = [0.01, 0.02, 0.03, 0.04, 0.0, 0.01, 0.02, 0.03, 0.04]
    assert np.array(rewards) == pytest.approx(np.array([expected] * 2).T)


@pytest.mark.slow
def test_the_checker_of_gymnasium(wrap):
    env = wrap(Push(), success="x(sim.ball) > 0.02", reward="-distance(sim.pusher, sim.ball)")
    # It says that there is a wrapper.
    with pytest.warns(UserWarning, match="different from the unwrapped version"):
        check_env(env, skip_render_check=True)


@pytest.mark.slow
@pytest.mark.parametrize("before", [None, np.zeros(0), "missing"])
def test_variables_may_have_no_value_before_the_first_reset(wrap, before):
    class Later(Push):
        def __init__(self):
            super().__init__()
            self.later = before
            if isinstance(before, str):
                del self.later

        def reset(self, *, seed=None, options=None):
            result = super().reset(seed=seed, options=options)
            self.later = np.array(self.goal)
            return result

    env = wrap(
        Later(),
        success="distance(sim.ball, later) < 0.05",
        variables={"later": lambda env: env.later},
    )
    _, info = env.reset(seed=0)
    ball, goal = env.unwrapped.data.body("ball").xpos, env.unwrapped.goal
    assert info["ssduck"]["success"] == (np.linalg.norm(ball - goal) < 0.05)
    misspelt = wrap(
        Later(), success="distance(sim.bal, later) < 1", variables={"later": lambda env: env.later}
    )
    with pytest.raises(UnknownNameError, match="bal"):
        misspelt.reset(seed=0)


def test_a_closed_environment_takes_no_step():
    env = QueryWrapper(Push(), success="x(sim.ball) > 0.02")
    env.reset(seed=0)
    env.close()
    env.close()
    for act in (lambda: env.step(np.ones(1, np.float32)), env.reset):
        with pytest.raises(gymnasium.error.ClosedEnvironmentError, match="is closed: make it anew"):
            act()
