"""Measures a step of an environment alone, wrapped, and with its predicate written in numpy.

`python -m benchmarks gym` takes some seconds. The scene has boxes at rest on a plane. Success is
that one box is near a goal, and the reward is the negative distance of two boxes; `inContact` needs
the contacts as well, and `on` the shapes. Times are those of the processor. `tools.environments`
prints the same for environments of others.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np

from benchmarks.mujoco_ticks import simulation
from benchmarks.timing import medians, text_of
from ssduck.gym import QueryWrapper

BOXES = 50
# The number of the simulator's steps in a step of the environment.
SUBSTEPS = 5
DISTANCE = "-sqrt((x({a})-x({b}))^2 + (y({a})-y({b}))^2 + (z({a})-z({b}))^2)"
REWARD = DISTANCE.format(a="sim.body_1", b="sim.body_2")
NEAR = "abs(x(sim.body_1) - goal[0]) < 0.05"
CONTACT = "inContact(sim.world, sim.body_1)"
ON = "on(sim.world, sim.body_1)"


class Boxes(gymnasium.Env[Any, Any]):
    """Boxes at rest on a plane."""

    observation_space = gymnasium.spaces.Box(-100, 100, (1,), np.float64)
    action_space = gymnasium.spaces.Discrete(1)

    def __init__(self) -> None:
        self.model, self.data = simulation(BOXES)
        self.goal = np.zeros(3)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, Any]:
        """Begins an episode."""
        super().reset(seed=seed, options=options)
        return self.data.qpos[:1].copy(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Steps the simulation."""
        import mujoco

        del action
        mujoco.mj_step(self.model, self.data, SUBSTEPS)
        return self.data.qpos[:1].copy(), 0.0, False, False, {}


def by_hand(env: Boxes) -> tuple[bool, float]:
    """Returns success and reward as an environment computes them."""
    first, second = env.data.xpos[1], env.data.xpos[2]
    return bool(abs(first[0] - env.goal[0]) < 0.05), -float(np.linalg.norm(first - second))


def rows() -> Iterator[tuple[str, ...]]:
    """Yields a row for each way to score a step."""
    variables = {"goal": lambda env: env.goal}
    alone, hand = Boxes(), Boxes()
    wrapped = {
        "poses: near and reward": QueryWrapper(Boxes(), NEAR, None, REWARD, variables=variables),
        "contacts: inContact and reward": QueryWrapper(Boxes(), CONTACT, None, REWARD),
        "shapes: on and reward": QueryWrapper(Boxes(), ON, None, REWARD),
    }

    def step_by_hand() -> object:
        hand.step(0)
        return by_hand(hand)

    ways: dict[str, Any] = {"step alone": lambda: alone.step(0), "numpy by hand": step_by_hand}
    for name, env in wrapped.items():
        env.reset()
        ways[name] = lambda env=env: env.step(0)
    times = medians(ways, 200, time.process_time)
    for name, seconds in times.items():
        added = seconds - times["step alone"]
        yield name, text_of(seconds), text_of(added), f"{added / times['step alone']:.0%}"
    for env in wrapped.values():
        env.close()


HEADER = (f"a step with {BOXES} boxes", "time", "added", "of the step")
