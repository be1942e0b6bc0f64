"""What ssduck adds to MJCF files that it writes, and reads back."""

from __future__ import annotations

from pathlib import Path

from ssduck.simulators.recognition import MUJOCO
from ssduck.simulators.scene_bodies import BodySpec
from ssduck.simulators.scenes import Scene

# The key, a state in MJCF, that a world begins with.
STATE_KEY = "ssduck"
# A text of this name and that of an entity has the kind of the entity, if its joints do not tell.
KIND_PREFIX = "ssduck kind of "
# The file of the model in the folder of a scene.
MODEL_FILE = "world.xml"


def mjcf_scene(folder: Path) -> Scene:
    """Returns the scene of a folder that has a model file for MuJoCo, without sensors."""
    body = BodySpec(None, None, folder / MODEL_FILE)
    return Scene(name="world", path=folder, bodies=(body,), simulator=MUJOCO)
