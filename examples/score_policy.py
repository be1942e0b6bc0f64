"""Scores a scripted policy on an environment of gymnasium, with success and reward as queries.

`python examples/score_policy.py` needs `pip install 'ssduck[gym,mujoco]' 'gymnasium[mujoco]'`.
The task is to keep a pendulum upright on a cart, and the cart near the middle. It prints a line for
each policy: how many of ten episodes succeed, and the mean return.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from ssduck.gym import QueryWrapper

Policy = Callable[[npt.NDArray[np.float64]], float]

UPRIGHT = "rot(sim.cart.pole)[2][2]"  # the cosine of the angle of the pole
TERMS: dict[str, Any] = {
    "success": f"heldFor({UPRIGHT} > 0.99 AND abs(x(sim.cart)) < 0.1) >= 1.0",
    "failure": f"{UPRIGHT} < 0.9",
    "reward": {"upright": UPRIGHT, "middle": "-abs(x(sim.cart))", "done": "10 * int(success)"},
    "stop_when": "success OR failure",
}


def idle(_: npt.NDArray[np.float64]) -> float:
    """Does nothing."""
    return 0.0


def balance(observation: npt.NDArray[np.float64]) -> float:
    """Pushes the cart under the pole: gains for its place, the angle, and their velocities."""
    return float(observation @ [0.5, 6.0, 0.7, 0.8])


def episode(env: QueryWrapper, policy: Policy, seed: int) -> tuple[bool, float]:
    """Returns whether an episode succeeds, and its return."""
    observation, _ = env.reset(seed=seed)
    total, over = 0.0, False
    while not over:
        action = np.array([np.clip(policy(observation), -3, 3)], np.float32)
        observation, reward, terminated, truncated, info = env.step(action)
        total, over = total + float(reward), terminated or truncated
    return info["ssduck"]["success"], total


def main() -> None:
    """Scores both policies in the same episodes."""
    env = QueryWrapper(gymnasium.make("InvertedPendulum-v5"), forward=True, **TERMS)
    for policy in (idle, balance):
        scores = [episode(env, policy, seed) for seed in range(10)]
        successes = sum(success for success, _ in scores)
        mean = np.mean([total for _, total in scores])
        print(f"{policy.__name__:8} {successes:2} of {len(scores)} succeed, return {mean:.2f}")
    env.close()


if __name__ == "__main__":
    main()
