"""Exports `Snapshot`, the tables of a tick.

A world takes a snapshot of its simulator with every tick; see the package `ssduck.world`.
"""

from ssduck.world.snapshot import Snapshot

__all__ = ["Snapshot"]
