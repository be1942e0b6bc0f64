"""A tick as tables: `Snapshot`.

A world takes one of its simulator with every tick; see the package `ssduck.world`.
"""

from ssduck.world.snapshot import Snapshot

__all__ = ["Snapshot"]
