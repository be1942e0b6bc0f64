"""A simulation and its current tick, with handles of its entities.

A `World` steps its simulator and takes ticks (`ticking`). A tick is a `Snapshot`: tables that are
filled from the simulator on request (`layout`, `live_tables`). `observers` are notified of ticks as
simulated time passes. An `Entity` is a handle: its properties are those at its world's last tick.
"""

from typing import TYPE_CHECKING

from ssduck.lazy import exports

if TYPE_CHECKING:
    from ssduck.world.entities import Entity, Sensor
    from ssduck.world.observers import TickObserver
    from ssduck.world.snapshot import Snapshot
    from ssduck.world.stepping import run
    from ssduck.world.world import World

__all__ = [
    "Entity",
    "Sensor",
    "Snapshot",
    "TickObserver",
    "World",
    "run",
]

__getattr__, __dir__ = exports(
    __name__,
    {
        "entities": ("Entity", "Sensor"),
        "observers": ("TickObserver",),
        "stepping": ("run",),
        "snapshot": ("Snapshot",),
        "world": ("World",),
    },
)
