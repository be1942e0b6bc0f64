"""A world of what is near the vacuum cleaner, cut out of the kitchen, that goes on by itself.

As the tutorial's section 10.1: `AS environment`. Without the kitchen there is no floor: the vacuum
cleaner falls, and what is on the table, which is held where it is, stays. How deep it falls is
checked against gravity's formula, and a copy of the whole kitchen goes on as the kitchen does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ssduck.demos.results import keep, keep_picture
from ssduck.simulators.scenes import Camera

if TYPE_CHECKING:
    from ssduck.world.world import World

NEAR = """\
roomba = SELECT obj FROM kitchen WHERE id(this) == 'roomba_625x' AS value;
SELECT obj FROM kitchen WHERE distance(roomba, this) <= 1.5 AS environment;"""
ALL = "SELECT obj FROM kitchen AS environment;"

SECONDS = 0.5
# How far bodies of a copy of all may be from the first ones, m.
ALIKE = 1e-6
# PyBullet damps speeds: a body falls less deep by that part at most. What lies settles, m.
SLOWER = 0.03
STAYS = 2e-3
CAMERA = Camera(eye=(2.9, -1.9, 1.9), target=(1.0, 0.0, 0.3), fov=45)


def run(folder: Path, say: Callable[[str], None], *, seed: int) -> bool:  # noqa: ARG001
    """Cut it out, let both go on, compare, draw."""
    from ssduck.interpreter.opening import load

    with load("kitchen") as ss:
        kitchen: World = ss.call_variable("kitchen")
        say(NEAR)
        near: World = ss.eval(NEAR)
        copy: World = ss.eval(ALL)
        say(f"{len(near)} of {len(kitchen)} entities: {', '.join(e.name for e in near)}")
        picture = keep_picture(near.render(640, 480, CAMERA), folder / "environment.png")
        before = _heights(near)
        steps = round(SECONDS / kitchen.timestep)
        for world in (kitchen, near, copy):
            world.step(steps)
        # Each step adds its own speed.
        free = 9.81 * kitchen.timestep**2 * steps * (steps + 1) / 2
        found = _falls(before, _heights(near), free, say)
        found &= _are_alike(kitchen, copy, say)
        saved = keep(folder / "near_roomba", near.save)
        again = load(saved / "scene.toml").call_variable("kitchen")
        then = _heights(again)
        same = all(abs(then[name] - z) < ALIKE for name, z in _heights(near).items())
        say(f"Saved as {saved}; loaded again, bodies are where they were: {same}")
        for world in (near, copy, again):
            world.close()
        kitchen.step()
    say(f"What was cut out: {picture}")
    return found and same


def _heights(world: World) -> dict[str, float]:
    """Of the link frames of all bodies, m."""
    return {entity.name: entity.position[2] for entity in world if entity.kind != "sensor"}


def _falls(
    before: Mapping[str, float], after: Mapping[str, float], free: float, say: Callable[[str], None]
) -> bool:
    """Whether the vacuum cleaner fell as what is free does, and what is on the table stayed."""
    fallen = {name: before[name] - after[name] for name in before}
    cleaner = fallen.pop("roomba_625x")
    farthest = max(map(abs, fallen.values()))
    say(
        f"After {SECONDS:g} s the vacuum cleaner is {cleaner:.3f} m deeper (free fall: "
        f"{free:.3f} m), all else has moved by at most {1000 * farthest:.1f} mm"
    )
    return abs(cleaner - free) < SLOWER * free and farthest < STAYS


def _are_alike(kitchen: World, copy: World, say: Callable[[str], None]) -> bool:
    """Whether a copy of all went on as the kitchen did."""
    apart = max(
        float(np.abs(np.subtract(entity.position, copy[entity.name].position)).max())
        for entity in kitchen
    )
    say(f"A copy of all of it went on alike: at most {apart:.1g} m apart")
    return apart < ALIKE
