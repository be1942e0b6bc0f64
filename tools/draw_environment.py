"""Draws the picture of the environment in the README.

`python tools/draw_environment.py [FOLDER]` writes it to docs/images or to another folder. It shows
the arm, the object and the goal of gymnasium's Pusher, the latter two highlighted.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "egl")  # read when MuJoCo is imported

import gymnasium
import numpy as np
from PIL import Image

from ssduck.gym import QueryWrapper
from ssduck.simulators.scenes import Camera

IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"
SIZE = (640, 360)
CAMERA = Camera(eye=(1.5, 0.75, 0.75), target=(0.32, -0.28, -0.2), fov=38.0)
PICTURE = (
    "SELECT obj FROM sim WHERE id == 'object' OR id == 'goal' "
    f"AS image({2 * SIZE[0]}, {2 * SIZE[1]});"
)


def draw(folder: Path) -> Path:
    """Writes the picture into a folder; returns its path."""
    env = QueryWrapper(gymnasium.make("Pusher-v5"), "distance(sim.object, sim.goal) < 0.1")
    env.reset(seed=0)
    for _ in range(12):
        env.step(np.full(7, 2.0))
    env.interpreter["sim"].camera = CAMERA
    picture: Image.Image = env.interpreter.eval(PICTURE)
    env.close()
    path = folder / "gym.png"
    # Drawn at twice the size, edges are smooth.
    picture.resize(SIZE, Image.Resampling.LANCZOS).quantize(128).save(path, optimize=True)
    return path


if __name__ == "__main__":
    print(draw(Path(sys.argv[1]) if sys.argv[1:] else IMAGES))
