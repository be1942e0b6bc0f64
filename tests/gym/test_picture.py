"""The README's picture of an environment is what its tool draws."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("gymnasium")
pytest.importorskip("mujoco")

ROOT = Path(__file__).resolve().parents[2]


def pixels(path):
    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB")).astype(int)


@pytest.mark.long
def test_it_is_up_to_date_and_highlights_the_goal(tmp_path):
    command = [sys.executable, str(ROOT / "tools" / "draw_environment.py"), str(tmp_path)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if "OpenGL" in done.stderr:
        pytest.skip("MuJoCo finds no OpenGL library")
    assert done.returncode == 0, done.stderr
    drawn, stored = pixels(tmp_path / "gym.png"), pixels(ROOT / "docs" / "images" / "gym.png")
    assert stored.shape == drawn.shape == (360, 640, 3)
    # Renderers are not the same everywhere.
    assert (np.abs(stored - drawn).max(axis=2) > 32).mean() < 0.05
    red = (drawn[..., 0] > 150) & (drawn[..., 1:].max(axis=2) < 60)
    row, column = (places.mean() for places in np.nonzero(red))
    assert 500 < red.sum() < 5000
    assert (row, column) == pytest.approx((253, 347), abs=25)
