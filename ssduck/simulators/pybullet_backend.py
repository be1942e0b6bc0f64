"""What PyBullet does for worlds: the functions of `ssduck.simulators.backends.Backend`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ssduck.scenes import Scene
from ssduck.simulators import Simulator
from ssduck.simulators import pybullet_saving as saving
from ssduck.simulators.backends import Original, Tick
from ssduck.simulators.pybullet import PyBulletSimulator, attach, load
from ssduck.simulators.pybullet_copies import excerpt

__all__ = ["attach", "excerpt", "load", "scene_of"]


def scene_of(
    simulator: Simulator, originals: Sequence[Original], tick: Tick, folder: Path
) -> Scene:
    """The scene that a simulation is, without its sensors; writes its models into a folder."""
    assert isinstance(simulator, PyBulletSimulator)
    return saving.scene_of(simulator, originals, tick, folder)
