"""A world of everything near the vacuum cleaner, copied from the kitchen, runs by itself.

As in the tutorial's section 10.1: `AS environment`. Without the kitchen there is no floor, so the
vacuum cleaner falls; the fixed table and the things on it stay.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ssduck.demos.results import Say, keep, keep_picture
from ssduck.interpreter.opening import load
from ssduck.simulators.scenes import Camera
from ssduck.world.world import World

NEAR = """\
roomba = SELECT obj FROM kitchen WHERE id(this) == 'roomba_625x' AS value;
SELECT obj FROM kitchen WHERE distance(roomba, this) <= 1.5 AS environment;"""
ALL = "SELECT obj FROM kitchen AS environment;"

SECONDS = 0.5
# The allowed deviation of the copy of the kitchen, m.
TOLERANCE = 1e-6
# PyBullet damps velocities: the share by which a fall may be shorter. Resting things settle, m.
DAMPING_SHARE = 0.03
SETTLING = 2e-3
CAMERA = Camera(eye=(2.9, -1.9, 1.9), target=(1.0, 0.0, 0.3), fov=45)


def run(folder: Path, say: Say, *, seed: int) -> bool:  # noqa: ARG001
    """Cuts out the world, simulates both, compares them, and draws a picture."""
    with load("kitchen") as ss:
        kitchen: World = ss.call_variable("kitchen")
        say(NEAR)
        near: World = ss.eval(NEAR)
        copy: World = ss.eval(ALL)
        say(f"{len(near)} of {len(kitchen)} entities: {', '.join(e.name for e in near)}")
        picture = keep_picture(near.render(640, 480, CAMERA), folder / "environment.png")
        heights_before = _heights(near)
        steps = round(SECONDS / kitchen.timestep)
        for world in (kitchen, near, copy):
            world.step(steps)
        # The sum of the distances of the steps.
        expected = 9.81 * kitchen.timestep**2 * steps * (steps + 1) / 2
        falls = {name: heights_before[name] - z for name, z in _heights(near).items()}
        fall = falls.pop("roomba_625x")
        farthest = max(map(abs, falls.values()))
        say(
            f"After {SECONDS:g} s the vacuum cleaner is {fall:.3f} m deeper (free fall: "
            f"{expected:.3f} m), all else has moved by at most {1000 * farthest:.1f} mm"
        )
        gaps = [np.subtract(entity.position, copy[entity.name].position) for entity in kitchen]
        deviation = float(np.abs(gaps).max())
        say(f"A copy of all of it went on alike: at most {deviation:.1g} m apart")
        saved = keep(folder / "near_roomba", near.save)
        reloaded = load(saved / "scene.toml").call_variable("kitchen")
        heights = _heights(reloaded)
        is_same = all(abs(heights[name] - z) < TOLERANCE for name, z in _heights(near).items())
        say(f"Saved as {saved}; loaded again, bodies are where they were: {is_same}")
        for world in (near, copy, reloaded):
            world.close()
        kitchen.step()
    say(f"What was cut out: {picture}")
    is_free_fall = abs(fall - expected) < DAMPING_SHARE * expected and farthest < SETTLING
    return is_free_fall and deviation < TOLERANCE and is_same


def _heights(world: World) -> dict[str, float]:
    """Returns the heights of the link frames of all bodies, m."""
    return {entity.name: entity.position[2] for entity in world if entity.kind != "sensor"}
