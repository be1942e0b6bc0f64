"""The end of an episode tells which part of success is false, if that is asked for."""

import gymnasium
import pytest

from ssduck.gym import QueryWrapper
from tests.gym.test_unrecorded import Fall

SUCCESS = "z(sim.ball) < 0.9 AND historically(z(sim.ball) > 0.7)"


def last_step(steps, **options):
    """Returns the information of the last step of an episode, and the ball's heights before."""
    env = QueryWrapper(gymnasium.wrappers.TimeLimit(Fall(), steps), SUCCESS, **options)
    env.reset()
    heights = [env.unwrapped.data.xpos[1, 2]]
    for number in range(steps):
        *_, info = env.step(env.action_space.sample())
        heights.append(env.unwrapped.data.xpos[1, 2])
        assert ("why" in info["ssduck"]) is (options.get("why", False) and number == steps - 1)
    env.close()
    return info["ssduck"], heights


@pytest.mark.parametrize("steps", [5, 9, 30])
def test_each_part_is_told_with_the_tick_that_decides(steps):
    told, heights = last_step(steps, why=True, forward=False)
    is_low, is_high = bool(heights[-1] < 0.9), bool(min(heights) > 0.7)
    assert told["success"] is (is_low and is_high)
    whole, low, historically, high = told["why"].splitlines()
    assert whole.startswith(f"{'✓' if is_low and is_high else '✗'} {SUCCESS}")
    assert low.startswith(f"  {'✓' if is_low else '✗'} z(sim.ball) < 0.9")
    assert historically.startswith(f"  {'✓' if is_high else '✗'} historically(")
    assert f"z(sim.ball) is {min(heights):.6g}" in high


def test_nothing_is_told_unless_it_is_asked_for():
    told, _ = last_step(5, forward=False)
    assert "why" not in told
