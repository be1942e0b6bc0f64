"""A world in a database, and what is kept of it there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from ssduck.errors import UnsupportedError
from ssduck.history import Archive, Shown, history_name, not_recorded
from ssduck.joints import Joints
from ssduck.record import Record
from ssduck.recorder import Recorder
from ssduck.shapes import Shapes
from ssduck.tables import LiveTable
from ssduck.then import TOLD
from ssduck.world import World


@dataclass(frozen=True)
class Kept:
    """The history of a world: who keeps it, where, and how it is told.

    Attributes:
        history: where it is stored.
        record: tells it.
        recorder: keeps it; None if it is only read.
        shown: the rows that DuckDB is shown where they are, by table.
    """

    history: Archive
    record: Record
    recorder: Recorder | None = None
    shown: tuple[Mapping[str, Shown], ...] = ()


@dataclass
class Bound:
    """A world in this database.

    Attributes:
        world: the world.
        key: what its buffers are called among DuckDB's temporary views.
        schemas: its names here; the first is the one that ssduck's own statements use.
        versions: those of the tables that DuckDB has been shown.
        kept: its history; None if its ticks are not recorded.
    """

    world: World
    key: str
    schemas: list[str] = field(default_factory=list)
    versions: dict[str, int] = field(default_factory=dict)
    kept: Kept | None = None

    def buffers(self) -> list[tuple[str, str, LiveTable | Shown]]:
        """What DuckDB is to be shown: of which table, under which name, and the rows."""
        found: list[tuple[str, str, LiveTable | Shown]] = [
            (table, self.live(table), live) for table, live in self.world.snapshot.tables.items()
        ]
        for part, tables in enumerate(self.kept.shown if self.kept is not None else ()):
            for table, rows in tables.items():
                found.append((history_name(table), self.waiting(table)[part], rows))
        return found

    def live(self, table: str) -> str:
        """What a table's buffers are called among DuckDB's temporary views."""
        return f"{self.key}: {table}"

    def waiting(self, table: str) -> list[str]:
        """What the rows are called that are not stored, among DuckDB's temporary views."""
        parts = len(self.kept.shown) if self.kept is not None else 0
        return [f"{self.key}: {table} that wait, {part}" for part in range(parts)]

    def shapes(self, tick: int | None, ids: Sequence[int] | None) -> Shapes:
        """The shapes at a tick, those of some entities at least, or at the present one.

        Args:
            tick: its number; None for the present one.
            ids: of the entities; None for all.

        Raises:
            EvaluationError: the tick is not recorded.
        """
        snapshot = self.world.snapshot
        if tick is None or tick == snapshot.number:
            return snapshot.shapes()
        if self.kept is None:
            raise UnsupportedError(
                f"the shapes of {self.world.name!r} are known of its tick {snapshot.number} only: "
                "its ticks are not recorded, so that rows of another one cannot be compared"
            )
        return self.kept.record.shapes(tick, ids)

    def joints(self, tick: int, id: int) -> Joints:
        """The joints of an entity at a tick.

        Raises:
            UnsupportedError: they are not recorded.
        """
        snapshot = self.world.snapshot
        if tick == snapshot.number and "joints" not in snapshot.untold:
            member, rows = snapshot.members[snapshot.rows[id]], snapshot.tables["joints"]
            own: Mapping[str, Any] = {name: rows[name] for name in ("entity", "position")}
        else:
            own = self._recorded("joints", tick)
            assert self.kept is not None
            member = self.kept.record.members[id]
        joints = () if member.body is None else member.body.joints
        return Joints(member.name, joints, own["position"][own["entity"] == id].tolist())

    def joint_owners(self) -> dict[str, set[int]]:
        """The ids of the entities that have a joint of each name, now or at a recorded tick."""
        members = {member.id: member for member in self.world.snapshot.members}
        if self.kept is not None:
            members.update(self.kept.record.members)
        found: dict[str, set[int]] = {}
        for id, member in members.items():
            for joint in () if member.body is None else member.body.joints:
                found.setdefault(joint.name, set()).add(id)
        return found

    def _recorded(self, table: str, tick: int) -> Mapping[str, Any]:
        """The columns of a table at a recorded tick.

        Raises:
            UnsupportedError: it is not recorded.
        """
        if self.kept is None:
            raise UnsupportedError(f"the ticks of {self.world.name!r} are not recorded")
        record = self.kept.record
        if table not in record.tables:
            raise UnsupportedError(not_recorded(table, self.world.name))
        return record.rows(table, tick)

    def told(self, what: str, tick: int, a: int, b: int) -> list[float]:
        """What contacts or sensors told at a recorded tick.

        Raises:
            UnsupportedError: they are not recorded.
        """
        return TOLD[what](partial(self._recorded, tick=tick), a, b)
