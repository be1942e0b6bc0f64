"""What PyBullet does for worlds: the functions of `ssduck.simulators.backends.Backend`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ssduck.simulators.backends import BodyToCopy, TickToCopy
from ssduck.simulators.interface import Simulator
from ssduck.simulators.pybullet import scene_writer as saving
from ssduck.simulators.pybullet.excerpt import excerpt
from ssduck.simulators.pybullet.simulator import PyBulletSimulator, attach, load
from ssduck.simulators.scenes import Scene

__all__ = ["attach", "excerpt", "load", "scene_of"]


def scene_of(
    simulator: Simulator, originals: Sequence[BodyToCopy], tick: TickToCopy, folder: Path
) -> Scene:
    """The scene that a simulation is, without its sensors; writes its models into a folder."""
    assert isinstance(simulator, PyBulletSimulator)
    return saving.scene_of(simulator, originals, tick, folder)
