"""Writes the scene `kitchen`: the URDFs, their meshes and `scene.toml`.

`python -m tools.build_kitchen` writes all files of `scenes/kitchen` in a second or two; `--check`
only compares them, with exit status 1 if a file differs.
"""

from __future__ import annotations

import sys

from tools.kitchen.placement import KINBODIES, MODELS, ROBOTS, SENSORS
from tools.scenes.writing import files, scene_text, write

HEADING = f"""
# Written by tools/build_kitchen.py; change it there.
name = "kitchen"
description = "A kitchen with a laid table, appliances and four robots."
gravity = [0.0, 0.0, -9.81]
timestep = {1 / 240!r}

[camera]
eye = [3.55, -4.1, 3.45]
target = [0.18, 0.03, 0.7]
fov = 47.0
"""


def main() -> int:
    scene = scene_text(HEADING, [*ROBOTS, *KINBODIES], SENSORS)
    return write("kitchen", files(scene, MODELS))


if __name__ == "__main__":
    sys.exit(main())
