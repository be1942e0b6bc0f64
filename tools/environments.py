"""Checks that success by query is the flag that environments of others report.

`python -m tools.environments SUITE [--tasks N] [--episodes N] [--steps N]` runs the tasks of a
suite in `environments.toml`, in a Python that has the packages named there (`tools/suites.py` says
how to install them). Each task is wrapped by `ssduck.gym.QueryWrapper`, and runs episodes of random
actions and, where the suite has one, of its scripted policy. Then its object or its joint is put at
both sides of the threshold by hand. The flag and the query must agree at each step and in each
state. The exit status is 1 if they differ. The last columns are the median processor time of a step
of the environment, and what the wrapper adds to it.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np

from ssduck.gym import QueryWrapper
from ssduck.simulators.recognition import parts_of
from tools.suites import Fetch, MetaWorld, Robosuite, Suite

TASKS = Path(__file__).with_suffix(".toml")
# The distances from a threshold at which an object is put, as a share of the threshold.
SHARES = (-0.5, -1e-2, -1e-5, -1e-9, 1e-9, 1e-5, 1e-2, 0.5)
# The number of states that are made by hand, for each of these and of a joint.
DIRECTIONS, POSITIONS = 8, 100


SUITES: dict[str, Suite] = {
    "fetch": Fetch(),
    "metaworld": MetaWorld(),
    "robosuite": Robosuite(),
}


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
        times: the processor time of each step of the environment, and that of the wrapped one, s.
    """

    name: str
    steps: int = 0
    step_successes: int = 0
    states: int = 0
    state_successes: int = 0
    differences: list[str] = field(default_factory=list)
    times: list[tuple[float, float]] = field(default_factory=list)

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


def tasks_of(suite: str) -> list[dict[str, Any]]:
    """Returns what the file of tasks says of each task of a suite."""
    tasks: list[dict[str, Any]] = tomllib.loads(TASKS.read_text())[suite]["tasks"]
    return tasks


def compared(suite: Suite, task: dict[str, Any], episodes: int, steps: int) -> Comparison:
    """Compares the flag of a task with its query, in episodes and in states made by hand."""
    variables = {name: _reader(path) for name, path in task.get("variables", {}).items()}
    timed = _Timed(suite.make(task["name"], steps))
    env = QueryWrapper(timed, task["success"], variables=variables, forward=False)
    result = Comparison(task["name"])
    try:
        for number in range(episodes):
            policy = suite.policy(task["name"]) if number % 2 else None
            observation, _ = env.reset(seed=number)
            env.action_space.seed(number)
            for step in range(steps):
                action = env.action_space.sample() if policy is None else policy(observation)
                start = time.process_time()
                observation, _, terminated, truncated, info = env.step(action)
                result.times.append((timed.seconds, time.process_time() - start))
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


class _Timed(gymnasium.Wrapper[Any, Any, Any, Any]):
    """An environment that notes the processor time of its last step, s."""

    seconds = 0.0

    def step(self, action: Any) -> Any:
        """Steps the environment."""
        start = time.process_time()
        result = self.env.step(action)
        self.seconds = time.process_time() - start
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
                way *= place.get("along", [1, 1, 1])
                way *= place["radius"] * (1 + share) / np.linalg.norm(way)
                joint.qpos[:3] = _centre(env, place, data) + way
                joint.qpos[3:] = [1, 0, 0, 0]
                mujoco.mj_forward(model, data)
                yield f"{place['joint']} at {1 + share} of {place['radius']}"
    if (slide := task.get("slide")) is not None:
        low, high = model.joint(slide).range
        for position in np.linspace(low, high, POSITIONS):
            data.joint(slide).qpos[0] = position
            mujoco.mj_forward(model, data)
            yield f"{slide} at {position:.6g}"


def _centre(env: Any, place: dict[str, Any], data: Any) -> Any:
    """Returns the position around which an object is put, m."""
    offset = np.array(place.get("offset", [0.0, 0.0, 0.0]))
    if "body" in place:
        return data.body(place["body"]).xpos + offset
    return offset + (place["at"] if "at" in place else getattr(env, place["around"]))


def main() -> int:
    parser = argparse.ArgumentParser(description="Compare success by query with its flag.")
    parser.add_argument("suite", choices=list(SUITES))
    parser.add_argument("--tasks", type=int, help="only so many tasks", default=None)
    parser.add_argument("--episodes", type=int, default=4)
    parser.add_argument("--steps", type=int, default=150)
    options = parser.parse_args()
    suite = SUITES[options.suite]
    print("| task | steps | successes | states | successes | differences | a step | added |")
    print("|---|---|---|---|---|---|---|---|")
    differences = 0
    for task in tasks_of(options.suite)[: options.tasks]:
        result = compared(suite, task, options.episodes, options.steps)
        alone = 1e3 * statistics.median(step for step, _ in result.times)
        wrapped = 1e3 * statistics.median(whole for _, whole in result.times)
        print(
            f"| {result.name} | {result.steps} | {result.step_successes} | {result.states} "
            f"| {result.state_successes} | {len(result.differences)} "
            f"| {alone:.2f} ms | {wrapped - alone:.2f} ms |",
            flush=True,
        )
        for difference in result.differences[:5]:
            print(f"  {difference}", file=sys.stderr)
        differences += len(result.differences)
    return 1 if differences else 0


if __name__ == "__main__":
    sys.exit(main())
