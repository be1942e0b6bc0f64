"""What ssduck needs of a simulator, and one folder for each simulator.

`interface` says what a simulator is asked for, tick after tick, and what bodies are made of.
`backends` lists the simulators by name, with what makes simulations. `scenes` reads the files that
describe them. `static` stands for a simulator where nothing moves: a tick of the past, say.
"""

from typing import TYPE_CHECKING

from ssduck.lazy import exports

if TYPE_CHECKING:
    from ssduck.simulators.backends import backend
    from ssduck.simulators.interface import (
        Body,
        CameraView,
        Contact,
        Joint,
        Link,
        LinkPoses,
        MotorTarget,
        RayHits,
        Simulator,
    )
    from ssduck.simulators.scenes import Scene, find_scene
    from ssduck.simulators.sensor_types import SENSOR_TYPES

__all__ = [
    "SENSOR_TYPES",
    "Body",
    "CameraView",
    "Contact",
    "Joint",
    "Link",
    "LinkPoses",
    "MotorTarget",
    "RayHits",
    "Scene",
    "Simulator",
    "backend",
    "find_scene",
]

__getattr__, __dir__ = exports(
    __name__,
    {
        "backends": ("backend",),
        "interface": (
            "Body",
            "Contact",
            "LinkPoses",
            "RayHits",
            "Joint",
            "Link",
            "MotorTarget",
            "Simulator",
            "CameraView",
        ),
        "scenes": ("Scene", "find_scene"),
        "sensor_types": ("SENSOR_TYPES",),
    },
)
