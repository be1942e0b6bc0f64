"""Records small episodes that differ in one number: a cup that rises beside a pot."""

import numpy as np

import ssduck


def write_rising_cups(place, episodes, ticks):
    """Records episodes of a world `lab`, in each of which the cup begins at another height."""
    for episode in range(episodes):
        poses = np.zeros((ticks, 2, 3))
        poses[:, 1, 0] = 5.0
        poses[:, :, 2] = episode + np.arange(ticks)[:, None] / 10
        shapes = {name: {"box": [0.1] * 3} for name in ("cup", "pot")}
        ssduck.write_record(place, shapes, poses, np.arange(ticks) / 10, world="lab")
    return place
