"""Checks that recorded episodes score as they did live, and that resets leave nothing behind.

`python -m tools.episodes [COUNT] [--resets N] [--seed N]` runs so many episodes of random actions
in a recorded environment, with terms of positions, contacts, shapes and time, and scores them again
from the record: with the same terms, and with others that a second wrapper had live. Every reward,
every part of one and every condition has to be equal to the last digit. Then it resets environments
so many times, some of which make a new model or client at each reset, and counts what is left:
worlds, threads, PyBullet clients, memory. The exit status is 1 if anything differs or is left.
"""

from __future__ import annotations

import argparse
import gc
import sys
import tempfile
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pybullet

from ssduck.gym import EpisodeScore, QueryWrapper, score
from ssduck.world.world import World
from tests.support.gym_environments import Drop, Push

VARIABLES = {"goal": lambda env: env.goal}
TERMS: dict[str, Any] = {
    "success": "speed(sim.pusher) > goal[0]",
    "failure": "NOT on(sim.table, sim.ball)",
    "reward": {
        "goal": "-distance(sim.ball, goal)",
        "near": "-clearance(sim.pusher, sim.ball)",
        "weight": "contactForce(sim.table, sim.ball)",
        "joint": "joint(sim.pusher, 'push')",
    },
}
# A condition over time, which takes much longer; every so many records have it in place of success.
OVER_TIME = "heldFor(speed(sim.pusher) > goal[0]) >= 0.02"
EVERY = 10
# Those of a second wrapper, with which the record is scored, too.
OTHERS: dict[str, Any] = {
    "success": "inContact(sim.table, sim.ball) AND x(sim.pusher) > -0.3",
    "failure": "touching(sim.pusher, sim.ball)",
    "reward": "-norm([x(sim.pusher) - goal[0], y(sim.ball)]) - int(grasped(sim.pusher, sim.ball))",
}
# The numbers of steps of an episode, and of episodes of a record.
STEPS, RECORD = 6, 50
# The memory that may be left by a reset, kB.
MAX_LEFT = 50


class _Noting(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Notes what an environment gives at each step: its reward, and what its terms say."""

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        super().__init__(env)
        self.episodes: list[list[tuple[float, dict[str, Any]]]] = []

    def reset(self, **options: Any) -> Any:
        """Begins an episode."""
        self.episodes.append([])
        return self.env.reset(**options)

    def step(self, action: Any) -> Any:
        """Steps the environment."""
        result = self.env.step(action)
        self.episodes[-1].append((float(result[1]), result[4]["ssduck"]))
        return result


def differences(live: list[tuple[float, dict[str, Any]]], scored: EpisodeScore) -> int:
    """Returns in how many values an episode differs from its score."""
    count = int(len(live) != len(scored.rewards))
    for step, (reward, info) in enumerate(live[: len(scored.rewards)]):
        count += reward != scored.rewards[step]
        for name, values in (("success", scored.success), ("failure", scored.failure)):
            count += values is not None and info[name] != values[step]
        for name, parts in scored.parts.items():
            count += name in info.get("parts", {}) and info["parts"][name] != parts[step]
    return count


@dataclass
class Tally:
    """What was compared, and in how many values it differs."""

    episodes: int = 0
    steps: int = 0
    successes: int = 0
    differences: int = 0

    def __str__(self) -> str:
        return (
            f"{self.episodes:,} episodes, {self.steps:,} steps, {self.successes:,} successes at "
            f"the end: {self.differences} differences"
        )


def check_scores(count: int, seed: int) -> int:
    """Returns in how many values recorded episodes differ from their scores."""
    tally = Tally()
    for start in range(0, count, RECORD):
        number = start // RECORD
        terms = TERMS | ({"success": OVER_TIME} if number % EVERY == 0 else {})
        with tempfile.TemporaryDirectory() as folder:
            add_record(tally, terms, folder, range(start, min(start + RECORD, count)), seed)
        print(tally, flush=True)
    return tally.differences


def add_record(tally: Tally, terms: dict[str, Any], folder: str, numbers: range, seed: int) -> None:
    """Runs and records episodes, and compares them with their scores."""
    random = np.random.default_rng((seed, numbers.start))
    others = _Noting(QueryWrapper(Push(most=STEPS), **OTHERS, variables=VARIABLES))
    env = _Noting(QueryWrapper(others, **terms, variables=VARIABLES, record_to=folder))
    for number in numbers:
        env.reset(seed=seed + number)
        push, is_over = random.uniform(-1, 1), False
        while not is_over:
            action = np.clip(push + random.normal(0, 0.5, 1), -1, 1)
            _, _, terminated, truncated, _ = env.step(action)
            is_over = terminated or truncated
    env.close()
    for given, noted in ((terms, env.episodes), (OTHERS, others.episodes)):
        scores = list(score(folder, **given))
        tally.differences += len(scores) != len(numbers)
        tally.differences += sum(map(differences, noted, scores))
    tally.episodes += len(numbers)
    tally.steps += sum(map(len, env.episodes))
    tally.successes += sum(episode[-1][1]["success"] for episode in env.episodes)


def counts() -> tuple[int, int, int]:
    """Returns the numbers of worlds, of threads and of PyBullet clients."""
    gc.collect()
    worlds = sum(isinstance(one, World) for one in gc.get_objects())
    return worlds, threading.active_count(), sum(map(pybullet.isConnected, range(64)))


def kilobytes() -> int:
    """Returns the resident memory of the process, kB."""
    pages = int(Path("/proc/self/statm").read_text("ascii").split()[1])
    return pages * 4096 // 1024


ENVIRONMENTS: dict[str, tuple[Callable[[], gymnasium.Env[Any, Any]], str, Any]] = {
    "MuJoCo": (Push, "x(sim.ball) > 0.02", [1.0]),
    "MuJoCo, a new model": (lambda: Push(rebuilds=True), "x(sim.ball) > 0.02", [1.0]),
    "PyBullet": (Drop, "z(sim.body_1) < 0.2", 0),
    "PyBullet, a new client": (lambda: Drop(reconnects=True), "z(sim.body_1) < 0.2", 0),
}


def check_resets(count: int) -> int:
    """Returns how many environments leave something behind."""
    print("| an environment | worlds | threads | clients | memory of a reset |")
    print("|---|---|---|---|---|")
    wrong = 0
    for name, (make, success, action) in ENVIRONMENTS.items():
        env = QueryWrapper(make(), success=f"heldFor({success}) >= 0.01")
        before, memory = counts(), 0
        for number in range(2 * count):  # the first half warms up
            if number == count:
                before, memory = counts(), kilobytes()
            env.reset(seed=number)
            env.step(action)
        after, left = counts(), (kilobytes() - memory) / count
        env.close()
        more = [now - then for now, then in zip(after, before, strict=True)]
        wrong += any(more) or left > MAX_LEFT
        print(f"| {name} | {more[0]:+} | {more[1]:+} | {more[2]:+} | {left:.1f} kB |", flush=True)
    return wrong


def main() -> int:
    parser = argparse.ArgumentParser(description="Check scores of episodes, and resets.")
    parser.add_argument("count", nargs="?", type=int, help="the number of episodes", default=1000)
    parser.add_argument("--resets", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    wrong = check_scores(options.count, options.seed) if options.count else 0
    wrong += check_resets(options.resets) if options.resets else 0
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
