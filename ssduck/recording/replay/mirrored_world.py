"""A copy of the last tick of a live world, with its recorded past."""

from __future__ import annotations

from collections.abc import Iterable

from ssduck.recording.replay.record import Record
from ssduck.recording.stores.base import TickArchive
from ssduck.schema import MARGINS, MASSES
from ssduck.world.what_if import copied_tick
from ssduck.world.world import World

# The tables that the copy has from the world, and no static simulator could read again.
_COPIED = frozenset(("contacts",))


class MirroredWorld(World):
    """A copy of the last tick of a live world, which the simulation does not change.

    Args:
        world: the live world.
        name: the name of the copy.
        archive: stores the recorded ticks; None if there are none.
        record: reads them; its `world` becomes this one.
    """

    def __init__(
        self, world: World, name: str, archive: TickArchive | None, record: Record | None
    ) -> None:
        self._begin(name, world.camera)
        self.archive, self.source_record = archive, record
        if record is not None:
            record.world = self
        self.update(world)

    def update(self, world: World) -> None:
        """Copies the last tick of the world."""
        has_joints = any(info.body and info.body.joints for info in world.snapshot.entities)
        tables = ("links", "joints") if has_joints else ()
        with world.pinned((MASSES, MARGINS, *_COPIED, *tables)):
            simulator, snapshot = copied_tick(world.snapshot)
        with self.lock:
            self._set_state(simulator, snapshot)
            self._origin = world.origin
        self.tick()

    def request_tables(self, tables: Iterable[str]) -> None:
        """Ensures that the tick includes tables; those that were copied are always there."""
        super().request_tables(frozenset(tables) - _COPIED)
