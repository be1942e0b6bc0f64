"""The state of a simulator at a tick, as far as it was read: `TickState`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from ssduck.geometry.arrays import Array
from ssduck.simulators.interface import Contacts, LinkPoses
from ssduck.world.sensor_readings import Reading


class TickState(NamedTuple):  # made faster than a dataclass is
    """What a tick was read as; all rows of the tick follow from it and the entities.

    Attributes:
        number: the number of the tick.
        time: the simulated time of the tick, s.
        wall_time: the time at which it was read, s since 1970.
        static: the link poses of the bodies that cannot move.
        moving: those of the other bodies.
        joints: position, velocity and effort of all joints, (joints, 3); None if not read.
        contacts: the contacts; empty if not read.
        readings: the last reading of each sensor, by its id.
        sensors: the ids of the sensors whose readings are up to date.
    """

    number: int
    time: float
    wall_time: float
    static: LinkPoses
    moving: LinkPoses
    joints: Array | None
    contacts: Contacts
    readings: Mapping[int, Reading]
    sensors: frozenset[int]
