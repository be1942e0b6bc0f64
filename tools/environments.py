"""Checks that success by query is the flag that environments of others report.

`python -m tools.environments SUITE [--tasks N] [--episodes N] [--steps N]` runs the tasks of a
suite in `environments.toml`, in a Python that has the packages named there. Each task is wrapped by
`ssduck.gym.QueryWrapper`, and runs episodes of random actions and, where the suite has one, of its
scripted policy. Then its object or its joint is put at both sides of the threshold by hand. The
flag and the query must agree at each step and in each state. The exit status is 1 if they differ.
"""

from __future__ import annotations

import argparse
import sys
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import gymnasium
import mujoco
import numpy as np

from ssduck.gym import QueryWrapper
from ssduck.simulators.recognition import parts_of

TASKS = Path(__file__).with_suffix(".toml")
# The distances from a threshold at which an object is put, as a share of the threshold.
SHARES = (-0.5, -1e-2, -1e-5, -1e-9, 1e-9, 1e-5, 1e-2, 0.5)
# The number of states that are made by hand, for each of these and of a joint.
DIRECTIONS, POSITIONS = 8, 100


class Suite(Protocol):
    """The environments of a package."""

    def make(self, name: str, steps: int) -> gymnasium.Env[Any, Any]:
        """Makes the environment of a task with a number of steps in an episode."""

    def flag(self, info: dict[str, Any]) -> bool:
        """Returns the success that a step has reported."""

    def flag_now(self, env: Any) -> bool:
        """Returns the success of the present state of an unwrapped environment."""

    def policy(self, name: str) -> Callable[[Any], Any] | None:
        """Returns the scripted policy of a task: a function of an observation, or None."""


class Fetch:
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


class MetaWorld:
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


class Robosuite:
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

    def policy(self, name: str) -> Callable[[Any], Any] | None:  # noqa: ARG002
        """Returns None: the package has no scripted policies."""
        return None


class _Flagged(gymnasium.Wrapper[Any, Any, Any, Any]):
    """An environment of robosuite whose steps report success."""

    def step(self, action: Any) -> Any:
        """Steps the environment."""
        *result, info = self.env.step(action)
        return *result, info | {"success": bool(self.env.unwrapped._check_success())}  # type: ignore[attr-defined]  # noqa: SLF001


SUITES: dict[str, Suite] = {"fetch": Fetch(), "metaworld": MetaWorld(), "robosuite": Robosuite()}


@dataclass
class Comparison:
    """A count of the steps and states in which the flag and the query agree.

    Attributes:
        name: the task.
        steps: the number of steps of episodes.
        step_successes: the number of these that were successes.
        states: the number of states made by hand.
        state_successes: the number of these that were successes.
        differences: where they differ.
    """

    name: str
    steps: int = 0
    step_successes: int = 0
    states: int = 0
    state_successes: int = 0
    differences: list[str] = field(default_factory=list)

    def add_step(self, flag: bool, query: bool, where: str) -> None:
        """Counts a step of an episode."""
        self.steps += 1
        self.step_successes += flag
        self._compare(flag, query, where)

    def add_state(self, flag: bool, query: bool, where: str) -> None:
        """Counts a state that was made by hand."""
        self.states += 1
        self.state_successes += flag
        self._compare(flag, query, where)

    def _compare(self, flag: bool, query: bool, where: str) -> None:
        if flag != query:
            self.differences.append(f"{where}: the flag is {flag}, the query {query}")


def compared(suite: Suite, task: dict[str, Any], episodes: int, steps: int) -> Comparison:
    """Compares the flag of a task with its query, in episodes and in states made by hand."""
    variables = {name: _reader(path) for name, path in task.get("variables", {}).items()}
    env = QueryWrapper(suite.make(task["name"], steps), task["success"], variables=variables)
    result = Comparison(task["name"])
    try:
        for number in range(episodes):
            policy = suite.policy(task["name"]) if number % 2 else None
            observation, _ = env.reset(seed=number)
            env.action_space.seed(number)
            for step in range(steps):
                action = env.action_space.sample() if policy is None else policy(observation)
                observation, _, terminated, truncated, info = env.step(action)
                flag, query = suite.flag(info), info["ssduck"]["success"]
                result.add_step(flag, query, f"episode {number}, step {step}")
                if terminated or truncated:
                    break
        for number, where in enumerate(_states(env.unwrapped, task)):
            flag, query = suite.flag_now(env.unwrapped), _by_query(env, task)
            result.add_state(flag, query, f"state {number}, {where}")
    finally:
        env.close()
    return result


def _reader(path: str) -> Callable[[Any], Any]:
    return lambda env: getattr(env, path)


def _by_query(env: QueryWrapper, task: dict[str, Any]) -> bool:
    """Returns the value of the query at the present state."""
    ss = env.interpreter
    for name, path in task.get("variables", {}).items():
        ss[name] = np.asarray(getattr(env.unwrapped, path)).tolist()
    ss["sim"].tick()
    return bool(ss.eval(f"{task['success'].strip()};"))


def _states(env: Any, task: dict[str, Any]) -> Iterator[str]:
    """Puts an environment into states on both sides of the threshold; yields what each is."""
    parts = parts_of(env)
    assert parts is not None
    model, data = parts
    rng = np.random.default_rng(0)
    if (place := task.get("place")) is not None:
        joint = data.joint(place["joint"])
        for share in SHARES:
            for _ in range(DIRECTIONS):
                way = np.array(place.get("direction", rng.normal(size=3)), float)
                way *= place["radius"] * (1 + share) / np.linalg.norm(way)
                joint.qpos[:3] = _centre(env, place, data) + way
                joint.qpos[3:] = [1, 0, 0, 0]
                mujoco.mj_forward(model, data)
                yield f"at {1 + share} of the threshold"
    if (slide := task.get("slide")) is not None:
        low, high = model.joint(slide).range
        for position in np.linspace(low, high, POSITIONS):
            data.joint(slide).qpos[0] = position
            mujoco.mj_forward(model, data)
            yield f"{slide} at {position:.6g}"


def _centre(env: Any, place: dict[str, Any], data: Any) -> Any:
    """Returns the position around which an object is put, m."""
    if "body" in place:
        return data.body(place["body"]).xpos.copy()
    return np.array(place["at"] if "at" in place else getattr(env, place["around"]))


def main() -> int:
    parser = argparse.ArgumentParser(description="Compare success by query with its flag.")
    parser.add_argument("suite", choices=list(SUITES))
    parser.add_argument("--tasks", type=int, help="only so many tasks", default=None)
    parser.add_argument("--episodes", type=int, default=4)
    parser.add_argument("--steps", type=int, default=150)
    options = parser.parse_args()
    suite, about = SUITES[options.suite], tomllib.loads(TASKS.read_text())[options.suite]
    print("| task | steps | successes | states | successes | differences |")
    print("|---|---|---|---|---|---|")
    differences = 0
    for task in about["tasks"][: options.tasks]:
        result = compared(suite, task, options.episodes, options.steps)
        print(
            f"| {result.name} | {result.steps} | {result.step_successes} | {result.states} "
            f"| {result.state_successes} | {len(result.differences)} |",
            flush=True,
        )
        for difference in result.differences[:5]:
            print(f"  {difference}", file=sys.stderr)
        differences += len(result.differences)
    return 1 if differences else 0


if __name__ == "__main__":
    sys.exit(main())
