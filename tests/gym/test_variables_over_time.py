"""Variables of the environment in functions of time."""

import numpy as np
import pytest

from ssduck.errors import ArgumentError
from ssduck.gym import QueryWrapper, score

pytest.importorskip("pybullet")
from tests.support.gym_environments import Push

VARIABLES = {
    "n": lambda env: env.steps,
    "goal": lambda env: [float(env.goal[0]), float(env.steps)],
    "late": lambda env: float(env.steps >= 3),
}
NEARER = "previous(abs(x(sim.pusher) - {0})) - abs(x(sim.pusher) - {0})"


def rewards(reward, steps=4, **options):
    """Returns the rewards of the steps of two episodes, with their numbers."""
    env = QueryWrapper(Push(), reward=reward, variables=VARIABLES, forward=False, **options)
    found = []
    try:
        for seed in range(2):
            env.reset(seed=seed)
            found += [env.step(np.array([1.0]))[1] for _ in range(steps)]
    finally:
        env.close()
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    "term",
    [
        NEARER.format("n"),
        "rate(x(sim.pusher) * n)",
        "initially(x(sim.pusher) - n)",
        "heldFor(x(sim.pusher) < n)",
        "least(x(sim.pusher) - n)[1]",
        "at(0, x(sim.pusher) - n)",
        "count(SELECT this FROM sim{} WHERE x(sim.pusher) < n AS list)",
        "sum(SELECT x(this) - n FROM sim{-0.1} WHERE id(this) == 'pusher' AS list)",
    ],
)
def test_one_that_changes_is_an_error(term):
    message = (
        r"reward: .* has the variable n in (\w+\(…\)|a query of sim\{…\}), "
        ".* from 0 to 1: .*variables="
    )
    with pytest.raises(ArgumentError, match=message):
        rewards(term)


@pytest.mark.slow
def test_at_the_step_where_it_changes():
    assert len(rewards(NEARER.format("late"), 2)) == 4
    env = QueryWrapper(
        Push(), success="heldFor(x(sim.ball) < late) > 9", variables=VARIABLES, forward=False
    )
    env.reset()
    for _ in range(2):
        env.step(np.zeros(1))
    with pytest.raises(ArgumentError, match=r"the variable late .* from 0\.0 to 1\.0"):
        env.step(np.zeros(1))
    env.reset()
    env.step(np.zeros(1))
    env.close()


@pytest.mark.slow
def test_a_constant_of_the_episode():
    term = NEARER.format("goal[0]")  # goal[1] changes
    env = QueryWrapper(Push(), reward=term, variables=VARIABLES, forward=False)
    for seed in range(2):
        env.reset(seed=seed)
        before = abs(-0.3 - env.unwrapped.goal[0])
        for _ in range(3):
            reward = env.step(np.array([1.0]))[1]
            now = abs(env.unwrapped.data.xpos[2, 0] - env.unwrapped.goal[0])
            assert reward == pytest.approx(before - now, abs=1e-12)
            before = now
    env.close()
    with pytest.raises(ArgumentError, match=r"the variable goal\[1\]"):
        rewards(NEARER.format("goal[1]"))


@pytest.mark.slow
def test_outside_of_the_expression_it_may_change():
    assert len(rewards("n * previous(x(sim.pusher))")) == 8
    assert len(rewards("at(0.001 * n, x(sim.pusher))")) == 8


@pytest.mark.parametrize("term", ["previous(n)", "n - previous(n)", "rate(goal[0])"])
def test_one_alone_is_an_error_at_once(term):
    with pytest.raises(ArgumentError, match=r"of variables alone, .*variables={'before'"):
        QueryWrapper(Push(), reward=term, variables=VARIABLES, forward=False)


@pytest.mark.slow
def test_scores(tmp_path):
    rewards("x(sim.ball)", record_to=tmp_path)
    with pytest.raises(ArgumentError, match="the variable n in previous"):
        list(score(tmp_path, reward=NEARER.format("n")))
    assert len(list(score(tmp_path, reward=NEARER.format("goal[0]")))) == 2
