"""A world in a database, and what is kept of it there."""

from __future__ import annotations

import math
import weakref
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, TypeAlias

import numpy as np

from ssduck.errors import EvaluationError, UnsupportedError, warn
from ssduck.formatting import joined_names
from ssduck.geometry.queries import ShapeQueries
from ssduck.recording.recorder import Recorder
from ssduck.recording.replay.lookups import TOLD
from ssduck.recording.replay.record import Record
from ssduck.recording.spec import not_recorded
from ssduck.recording.stores.base import TickArchive, VisibleRows
from ssduck.schema import POSE, RECORDED
from ssduck.simulators.joints import EntityJoints
from ssduck.world.live_tables import LiveTable
from ssduck.world.world import World

# The poses of entities by id: x, y, z, qw, qx, qy, qz; None for what is not known.
Poses: TypeAlias = dict[int, tuple[float | None, ...]]
# So many of them are kept, about, to compare rows with.
MOST_POSES = 100_000
_NO_SHAPES = (
    "the shapes of {!r} are known of its tick {} only: its ticks are not recorded, so that rows of "
    "another one cannot be compared"
)


@dataclass(frozen=True)
class WorldRecording:
    """The history of a world: who keeps it, where, and how it is told.

    Attributes:
        history: where it is stored.
        record: tells it.
        recorder: keeps it; None if it is only read.
        shown: the rows that DuckDB is shown where they are, by table.
    """

    history: TickArchive
    record: Record
    recorder: Recorder | None = None
    shown: tuple[Mapping[str, VisibleRows], ...] = ()


@dataclass
class BoundWorld:
    """A world in this database.

    Attributes:
        reference: gives the world; None when nobody else has it any more.
        key: what its buffers are called among DuckDB's temporary views.
        schemas: its names here; the first is the one that ssduck's own statements use.
        versions: those of the tables that DuckDB has been shown.
        planned_margins: the margins, metres, that DuckDB's plans go by.
        kept: its history; None if its ticks are not recorded.
        held: the world, if it has a name of the user's: it is not to go.
    """

    reference: weakref.ref[World]
    key: str
    schemas: list[str] = field(default_factory=list)
    versions: dict[str, int] = field(default_factory=dict)
    kept: WorldRecording | None = None
    held: World | None = None
    planned_margins: float = 0.0
    _poses: OrderedDict[int, Poses] = field(default_factory=OrderedDict)
    _repadded: set[str] = field(default_factory=set)

    @property
    def world(self) -> World:
        """The world, while somebody has it."""
        world = self.reference()
        if world is None:
            raise EvaluationError(f"the world {', '.join(self.schemas)} is gone")
        return world

    def check_row(
        self, run: int | None, tick: int, id: int, pose: tuple[float | None, ...]
    ) -> None:
        """Complain of a row of entities that is of another run, or was changed.

        Args:
            run: the number of the row's run.
            tick: its tick.
            id: of the entity.
            pose: its x, y, z, qw, qx, qy, qz; None for what is not known.

        Raises:
            EvaluationError: the run is not that of this world, the pose not that of the tick, or
                there is no such entity.
        """
        own = self.world.snapshot.run
        if run != own:
            raise EvaluationError(
                f"a row (id {id}, tick {tick}) is of the run {run}, and {self.world.name!r} is of "
                f"the run {own}: its shapes are not known here; open the record of that run, or "
                "write the name of its world before the relation"
            )
        poses = self._poses_at(tick)
        if id not in poses:
            raise EvaluationError(
                f"a row (id {id}, tick {tick}) is of no entity: {self.world.name!r} has none of "
                "that id at that tick"
            )
        known = poses[id]
        if known != pose:
            raise EvaluationError(
                f"a row (id {id}, tick {tick}) is not as it was recorded: its pose is "
                f"{_listed(pose)}, and was {_listed(known)}; relations of shapes are of what "
                f"was: ask what_if for {self.world.name!r} with other poses"
            )

    def _poses_at(self, tick: int) -> Poses:
        """The poses of the entities at a tick, as their rows tell them, by id."""
        if tick not in self._poses:
            told = self._told_poses(tick)
            while self._poses and (len(self._poses) + 1) * len(told) > MOST_POSES:
                self._poses.popitem(last=False)
            self._poses[tick] = told
        return self._poses[tick]

    def _told_poses(self, tick: int) -> Poses:
        snapshot = self.world.snapshot
        if tick == snapshot.number:
            table = snapshot.tables["entities"]
            ids, columns = table["id"], table.reals("x", "qz")
        elif self.kept is None:
            raise UnsupportedError(_NO_SHAPES.format(self.world.name, snapshot.number))
        else:
            rows = self.kept.record.rows("entities", tick)
            ids, columns = rows["id"], np.array([rows[name] for name in POSE])
        told = columns.T.tolist()
        if np.isnan(columns).any():
            told = [[None if math.isnan(one) else one for one in pose] for pose in told]
        return dict(zip(ids.tolist(), map(tuple, told), strict=True))

    def buffers(self) -> list[tuple[str, str, LiveTable | VisibleRows]]:
        """What DuckDB is to be shown: of which table, under which name, and the rows."""
        found: list[tuple[str, str, LiveTable | VisibleRows]] = [
            (table, self.live(table), live) for table, live in self.world.snapshot.tables.items()
        ]
        for part, tables in enumerate(self.kept.shown if self.kept is not None else ()):
            for table, rows in tables.items():
                found.append((RECORDED[table].history_view, self.waiting(table)[part], rows))
        return found

    def live(self, table: str) -> str:
        """What a table's buffers are called among DuckDB's temporary views."""
        return f"{self.key}: {table}"

    def waiting(self, table: str) -> list[str]:
        """What the rows are called that are not stored, among DuckDB's temporary views."""
        parts = len(self.kept.shown) if self.kept is not None else 0
        return [f"{self.key}: {table} that wait, {part}" for part in range(parts)]

    def shapes(self, tick: int | None, ids: Sequence[int] | None) -> ShapeQueries:
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
            raise UnsupportedError(_NO_SHAPES.format(self.world.name, snapshot.number))
        return self.kept.record.shapes(tick, ids)

    @property
    def margins(self) -> float:
        """How far apart shapes may be that touch by their margins, metres, at any of its ticks."""
        now = self.world.snapshot.margins
        return now if self.kept is None else max(now, self.kept.record.margins)

    def note_margins(self, tick: int | None) -> None:
        """Warn, once of each entity, where recorded ticks go by other margins than there are now.

        Args:
            tick: the one that is asked for; None for the present one.
        """
        snapshot = self.world.snapshot
        if tick is None or tick == snapshot.number:
            return
        new = [name for name in snapshot.repadded if name not in self._repadded]
        if new:
            self._repadded.update(new)
            warn(
                f"{self.world.name!r}: the collision margins of {joined_names(new)} were changed; "
                "recorded ticks go by those that a body came with, so that on, touching and "
                "their like may differ there from what the simulator did",
            )

    def joints(self, tick: int, id: int) -> EntityJoints:
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
        return EntityJoints(member.name, joints, own["position"][own["entity"] == id].tolist())

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


def _listed(pose: Sequence[float | None]) -> str:
    return "[" + ", ".join("NULL" if number is None else f"{number:g}" for number in pose) + "]"
