"""Checks how often the robot clears a table with cups in random places.

`python -m tools.cleanup COUNT [--seed N]` runs the example `cleanup` once for each seed from
N on; the exit status is 1 if a table was not cleared. A table takes minutes.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

import ssduck
from examples.cleanup.program import clean
from ssduck.demos.cleanup import ALLOWED, Outcome
from ssduck.world.world import World

CUPS = ("cup_905a", "cup_58a2", "cup_b6af", "cup_d441")
# The least distances of cups from the edges of the table, and from each other, m.
EDGE_DISTANCE = 0.07
CUP_DISTANCE = 0.13
# The greatest distance of cups from the robot, which the job selects, and their least y, m.
ROBOT_DISTANCE = 1.29
LEAST_Y = 0.15


def scatter(world: World, rng: np.random.Generator) -> list[tuple[float, float]]:
    """Puts the cups at random places within the part of the table that is to be cleared."""
    low, high = (np.array(corner) for corner in world["table"].aabb)
    robot = np.array(world["barrett_4918"].position)
    plates = [np.array(e.position[:2]) for e in world if e.name.startswith("plate")]
    places: list[np.ndarray] = []
    while len(places) < len(CUPS):
        place = rng.uniform(
            (low[0] + EDGE_DISTANCE, LEAST_Y), (high[0] - EDGE_DISTANCE, high[1] - EDGE_DISTANCE)
        )
        z = high[2] + 0.0025
        if np.linalg.norm([*place, z] - robot) > ROBOT_DISTANCE:
            continue
        if any(np.linalg.norm(place - other) < CUP_DISTANCE for other in places):
            continue
        if any(np.linalg.norm(place - plate) < 0.21 for plate in plates):
            continue
        places.append(place)
    for name, place in zip(CUPS, places, strict=True):
        yaw = rng.uniform(-np.pi, np.pi)
        world[name].move([*place, z], [np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)])
    world.step(120)
    return [(float(x), float(y)) for x, y in places]


def clear_table(seed: int, folder: Path | None, verbose: bool) -> Outcome:
    """Clears a table with cups in random places and prints the outcome."""
    with ssduck.load("kitchen") as ss:
        places = scatter(ss.call_variable("kitchen"), np.random.default_rng(seed))
        print(f"seed {seed}: cups at", "  ".join(f"({x:.2f}, {y:.2f})" for x, y in places))
        start = time.perf_counter()
        outcome = clean(ss, folder, print if verbose else lambda _: None, seed=seed)
        verdict = "clean" if outcome.succeeded else "NOT CLEAN"
        print(
            f"  {verdict}: {len(outcome.washed)} in the sink, left {outcome.left}, "
            f"{outcome.seconds:.0f} s simulated, {time.perf_counter() - start:.0f} s, "
            f"{1000 * outcome.deepest:.3f} mm deep, trouble {outcome.trouble}",
            flush=True,
        )
        return outcome


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int)
    parser.add_argument("--seed", type=int, default=1, help="the seed of the first table")
    parser.add_argument("--pictures", type=Path, help="a folder for pictures")
    parser.add_argument("--loud", action="store_true")
    options = parser.parse_args()
    outcomes = [
        clear_table(seed, options.pictures and options.pictures / str(seed), options.loud)
        for seed in range(options.seed, options.seed + options.count)
    ]
    clean_ones = sum(outcome.succeeded for outcome in outcomes)
    deepest = max(outcome.deepest for outcome in outcomes)
    print(
        f"{clean_ones} of {options.count} tables clean; {sum(len(o.washed) for o in outcomes)} of "
        f"{sum(len(o.cups) for o in outcomes)} cups in the sink; at most "
        f"{1000 * deepest:.3f} mm deep in furniture (allowed: {1000 * ALLOWED:g} mm)"
    )
    raise SystemExit(clean_ones < options.count)


if __name__ == "__main__":
    main()
