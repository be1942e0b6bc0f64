"""Describes the bodies and the sensors of a scene; quaternions are w, x, y, z."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from tools.scenes.pieces import Quat, Vec


@dataclass(frozen=True)
class Body:
    name: str
    kind: str
    model: str
    position: Vec
    orientation: Quat = (1.0, 0.0, 0.0, 0.0)
    fixed: bool = False
    joints: dict[str, float] = field(default_factory=dict)
    velocity: tuple[float, ...] = ()


@dataclass(frozen=True)
class Sensor:
    name: str
    on: str
    type: str
    position: Vec
    orientation: Quat
    max_range: float
    more: dict[str, float]  # what this type of sensor has beyond the others
    period: float = 0.2


def looking(yaw: float, down: float = 0.0) -> Quat:
    """Returns the orientation of a sensor that looks to `yaw` and `down`, degrees."""
    a, b = math.radians(yaw) / 2, math.radians(down) / 2
    return (
        math.cos(a) * math.cos(b),
        -math.sin(a) * math.sin(b),
        math.cos(a) * math.sin(b),
        math.sin(a) * math.cos(b),
    )
