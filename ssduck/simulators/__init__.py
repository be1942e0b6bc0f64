"""The interface to simulators, and one folder for each simulator.

`interface` defines the protocol `Simulator` and the bodies, joints and poses that it exchanges.
`backends` lists the simulators by name, with the functions that make simulations. `scenes` reads
scene files. `partial` has a simulator in which nothing moves; it runs recorded ticks and what-if
worlds.
"""

from typing import TYPE_CHECKING

from ssduck.lazy import exports

if TYPE_CHECKING:
    from ssduck.simulators.backends import backend
    from ssduck.simulators.interface import (
        Body,
        CameraView,
        ContactPoints,
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
    "ContactPoints",
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
            "ContactPoints",
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
