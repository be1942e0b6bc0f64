"""A world that is bound to a database, and its history there."""

from __future__ import annotations

import math
import weakref
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, TypeAlias

import numpy as np

from ssduck.errors import EvaluationError, UnsupportedError, warn
from ssduck.formatting import joined_names
from ssduck.geometry.narrow_phase import MIN_FRACTION_INSIDE
from ssduck.geometry.queries import ShapeQueries
from ssduck.recording.recorder import Recorder
from ssduck.recording.replay.lookups import LOOKUPS
from ssduck.recording.replay.record import Record
from ssduck.recording.spec import no_ticks_message, not_recorded_message
from ssduck.recording.stores.base import TickArchive, VisibleRows
from ssduck.schema import LINK_FACTOR, POSE, TABLES, EntityTable, entity_of, link_id
from ssduck.simulators.contact_pairs import ContactPairs
from ssduck.simulators.interface import DEFAULT_BACKEND
from ssduck.simulators.kinematics import EntityJoints
from ssduck.sql.relations.geometry_query import INDIFFERENT_TO_INSIDES
from ssduck.world.live_tables import LiveTable, last_version
from ssduck.world.snapshot import Snapshot
from ssduck.world.world import World

# The poses of entities by id: x, y, z, qw, qx, qy, qz; None for what is not known.
Poses: TypeAlias = dict[int, tuple[float | None, ...]]
# Rows that DuckDB reads in place: the name of their view, and the rows themselves.
Buffer: TypeAlias = tuple[str, LiveTable | VisibleRows]
# The approximate number of poses that are cached.
MAX_POSES = 100_000


@dataclass(frozen=True)
class WorldHistory:
    """The recorded ticks of a world."""

    store: TickArchive  # the store that holds them
    record: Record  # the record, which reads them
    recorder: Recorder | None = None  # the recorder that adds ticks; None if they are only read
    # The rows that DuckDB reads in place, by table.
    visible_rows: tuple[Mapping[str, VisibleRows], ...] = ()


@dataclass
class BoundWorld:
    """A world that is bound to a database."""

    # A weak reference to the world; None when nothing else refers to the world.
    reference: weakref.ref[World]
    number: int  # tells the worlds of a database apart, and ascends in the order they were added
    # Its names; ssduck's own statements use the first.
    schemas: list[str] = field(default_factory=list)
    # The versions of the rows that DuckDB reads, by the name of their view.
    versions: dict[str, int] = field(default_factory=dict)
    registered: tuple[object, ...] | None = None  # the `state` at which all these were up to date
    history: WorldHistory | None = None  # its recorded ticks; None if they are not recorded
    named_world: World | None = None  # the world, if the user named it; it keeps the world alive
    planned_margins: float = 0.0  # the margins, m, that DuckDB's plans assume
    _poses: OrderedDict[tuple[int, EntityTable], Poses] = field(default_factory=OrderedDict)
    # What each warning was given for, or need not be: a name or ids of entities or links.
    _changed_margins: set[str] = field(default_factory=set)
    _checked_overlaps: set[int] = field(default_factory=set)
    _filled_meshes: set[int] = field(default_factory=set)
    _has_told_of_pairs: bool = False

    @property
    def key(self) -> str:
        """The prefix of its buffers' names among DuckDB's temporary views."""
        return f"world {self.number}"

    @property
    def world(self) -> World:
        """The world, while anything refers to it."""
        world = self.reference()
        if world is None:
            raise EvaluationError(f"the world {', '.join(self.schemas)} is gone")
        return world

    # -- the recorded poses of rows -----------------------------------------------------------

    def check_row(
        self, run: int | None, tick: int, id: int, pose: tuple[float | None, ...]
    ) -> None:
        """Checks that a row of entities is as it was recorded in this world.

        Args:
            run: the number of the row's run.
            tick: the number of its tick.
            id: the id of the entity.
            pose: its x, y, z (m), qw, qx, qy, qz; None for an unknown number.
        """
        run_number = self.world.snapshot.run
        if run != run_number:
            raise EvaluationError(
                f"a row (id {id}, tick {tick}) belongs to the run {run}, and {self.world.name!r} "
                f"to the run {run_number}: its shapes are not known here; open the record of "
                "that run, or write the name of its world before the relation"
            )
        poses = self._poses_at(tick, "links" if id >= LINK_FACTOR else "entities")
        if id not in poses:
            raise EvaluationError(
                f"a row (id {id}, tick {tick}) belongs to no entity: {self.world.name!r} has "
                "none of that id at that tick"
            )
        recorded_pose = poses[id]
        if recorded_pose != pose:
            raise EvaluationError(
                f"a row (id {id}, tick {tick}) differs from the record: its pose is "
                f"{_pose_text(pose)}, the recorded one {_pose_text(recorded_pose)}; relations "
                "of shapes use recorded poses; what_if makes a world with other poses"
            )

    def _poses_at(self, tick: int, table: EntityTable) -> Poses:
        """Returns the poses of the entities or links at a tick, by id, cached if possible."""
        key = tick, table
        if key not in self._poses:
            poses = self._read_poses(tick, table)
            # All ticks have about as many poses; the oldest of the cache goes first.
            while self._poses and (len(self._poses) + 1) * len(poses) > MAX_POSES:
                self._poses.popitem(last=False)
            self._poses[key] = poses
        return self._poses[key]

    def _read_poses(self, tick: int, table: EntityTable) -> Poses:
        snapshot = self.world.snapshot
        poses: Poses = {}
        if tick == snapshot.number:
            live = snapshot.tables[table]
            rows: Mapping[str, Any] = {name: live[name] for name in TABLES[table].key}
            columns = live.doubles("x", "qz")
        else:
            rows = self._record_of_shapes().rows(table, tick)
            columns = np.array([rows[name] for name in POSE])
            if table == "links":  # a body of one link has its pose, and no row of its own
                entities = self._poses_at(tick, "entities")
                poses = {link_id(id, 0): pose for id, pose in entities.items()}
        ids: Any = rows["id"] if table == "entities" else link_id(rows["entity"], rows["link"])
        numbers = columns.T.tolist()
        if np.isnan(columns).any():
            numbers = [[None if math.isnan(one) else one for one in pose] for pose in numbers]
        return poses | dict(zip(ids.tolist(), map(tuple, numbers), strict=True))

    # -- rows that DuckDB reads in place ------------------------------------------------------

    def buffers(self) -> list[Buffer]:
        """Returns the rows that DuckDB reads in place; of the current tick if it is in memory."""
        live = self.live_buffers() if self.world.ticker.is_restored else []
        return live + self.history_buffers()

    def live_buffers(self) -> list[Buffer]:
        """Returns the rows of the current tick."""
        tables = self.world.snapshot.tables
        return [(self.live_view(table), live) for table, live in tables.items()]

    def history_buffers(self) -> list[Buffer]:
        """Returns the rows of recorded ticks that DuckDB reads in place."""
        return [
            (self.buffer_views(table)[part], rows)
            for part, tables in enumerate(self.history.visible_rows if self.history else ())
            for table, rows in tables.items()
        ]

    def settle_history(self) -> None:
        """Writes the rows of all recorded ticks, unless no view reads them."""
        recorder = None if self.history is None else self.history.recorder
        if recorder is not None and self.buffer_views("entities")[0] in self.versions:
            recorder.settle()

    def state(self) -> tuple[object, ...]:
        """Returns a key: as long as it is equal, `buffers` and `margins` are what they were."""
        history = self.history
        recorded_margins = 0.0 if history is None else history.record.margins
        snapshot = self.world.snapshot if self.world.ticker.is_restored else None
        return last_version(), snapshot, history, recorded_margins

    def live_view(self, table: str) -> str:
        """Returns the name of a table's buffers among DuckDB's temporary views."""
        return f"{self.key}: {table}"

    def buffer_views(self, table: str) -> list[str]:
        """Returns the names of the rows that are not stored yet, among DuckDB's temporary views."""
        parts = len(self.history.visible_rows) if self.history is not None else 0
        return [f"{self.key}: {table} that wait, {part}" for part in range(parts)]

    # -- shapes, and warnings of them ---------------------------------------------------------

    def shapes(self, tick: int, *, with_sites: bool) -> ShapeQueries:
        """Returns the shapes at a tick; with_sites, sites have their regions as shapes."""
        snapshot = self.world.snapshot
        if tick == snapshot.number:
            return snapshot.shapes_and_sites() if with_sites else snapshot.shapes()
        return self._record_of_shapes().shapes(tick, with_sites=with_sites)

    def _record_of_shapes(self) -> Record:
        """Returns the record, for the shapes and poses of another tick than the present one."""
        if self.history is None:
            raise UnsupportedError(
                f"only the shapes of tick {self.world.snapshot.number} of {self.world.name!r} are "
                "known: its ticks are not recorded, so that rows of another tick cannot be compared"
            )
        return self.history.record

    @property
    def margins(self) -> float:
        """The largest distance, m, of shapes that touch by their collision margins, at any tick."""
        now = self.world.snapshot.margins if self.world.ticker.is_restored else 0.0
        return now if self.history is None else max(now, self.history.record.margins)

    def warn_of_changed_margins(self, tick: int) -> None:
        """Warns, once for each entity, if a tick is recorded with other margins than now."""
        snapshot = self.world.snapshot
        if tick == snapshot.number:
            return
        if snapshot.margins_of_pairs is not None and not self._has_told_of_pairs:
            self._has_told_of_pairs = True
            warn(
                f"{self.world.name!r}: some pairs of shapes have margins of their own (a <pair> of "
                "MuJoCo has one); recorded ticks have a margin for each shape, so that on, "
                "touching and similar relations may hold there at a larger distance",
            )
        new = [
            name
            for name in _names_with_changed_margins(snapshot)
            if name not in self._changed_margins
        ]
        if new:
            self._changed_margins.update(new)
            warn(
                f"{self.world.name!r}: the collision margins of {joined_names(new)} were changed; "
                "recorded ticks have the margins with which a body was first recorded, so that on, "
                "touching and similar relations may differ there from the simulator",
            )

    def warn_of_filled_meshes(
        self, function: Callable[..., Any], shapes: ShapeQueries, ids: Sequence[int] | None = None
    ) -> None:
        """Warns, once for each entity, of closed meshes of PyBullet that surround others.

        Args:
            function: a method of `ShapeQueries` that compares entities.
            shapes: the shapes at a tick.
            ids: the ids of the entities that are compared; None for all.
        """
        if function in INDIFFERENT_TO_INSIDES or self.world.simulator.backend != DEFAULT_BACKEND:
            return
        filled = {entity_of(id) for id in shapes.filled_meshes(ids)} - self._filled_meshes
        if filled:
            self._filled_meshes |= filled
            names = joined_names([self._name(id) for id in sorted(filled)])
            warn(
                f"{self.world.name!r}: a closed concave mesh of {names} is around something: for "
                "PyBullet it is a surface with nothing inside, for ssduck a solid, so that "
                "clearance is 0 there, near, touching and collides hold, and on does not; "
                "enclosed, contains and inContact are as in PyBullet"
            )

    def warn_of_missing_entities(self, tick: int) -> None:
        """Warns, once, if a recorded tick lacks entities; the present one has all."""
        if tick != self.world.snapshot.number and self.history is not None:
            self.history.record.warn_of_missing_entities()

    def warn_of_overlaps(self, shapes: ShapeQueries, id: int) -> None:
        """Warns, once for each entity or link, of overlaps of its shapes, counted twice."""
        if id in self._checked_overlaps:
            return
        self._checked_overlaps.add(id)
        share = shapes.overlap_share(id)
        if share > 1.0 - MIN_FRACTION_INSIDE:  # less may be a matter of how a form is cut
            warn(
                f"{self.world.name!r}: shapes of {self._name(id)} overlap, and inside counts "
                f"{share:.0%} of their volume twice: the share inside may be off by as much"
            )

    def _name(self, id: int) -> str:
        members = (member for member in self.world.snapshot.entities if member.id == entity_of(id))
        return next((member.name for member in members), f"entity {entity_of(id)}")

    # -- joints, links, contacts and sensors --------------------------------------------------

    def joints(self, tick: int, id: int) -> EntityJoints:
        """Returns the joints of an entity at a tick."""
        if id >= LINK_FACTOR:
            raise UnsupportedError(
                "a link has no joints of its own: ask its entity, as in joint(entity(link), name)"
            )
        snapshot = self.world.snapshot
        if tick == snapshot.number and "joints" not in snapshot.unavailable:
            member, rows = snapshot.entities[snapshot.rows[id]], snapshot.tables["joints"]
            columns: Mapping[str, Any] = {name: rows[name] for name in ("entity", "position")}
        else:
            columns = self._recorded("joints", tick)
            assert self.history is not None
            member = self.history.record.members[id]
        joints = () if member.body is None else member.body.joints
        return EntityJoints(
            member.name, joints, columns["position"][columns["entity"] == id].tolist()
        )

    def fastest_link(self, tick: int, id: int, columns: Sequence[str]) -> float | None:
        """Returns the greatest speed among an entity's links but its base; None if one is unknown.

        Args:
            tick: the number of the tick.
            id: the id of the entity; a link has no other links: 0.
            columns: the components of the velocity: vx, vy, vz (m/s) or wx, wy, wz (rad/s).
        """
        if id >= LINK_FACTOR:
            return 0.0
        snapshot = self.world.snapshot
        is_now = tick == snapshot.number and "links" not in snapshot.unavailable
        rows: Mapping[str, Any] | LiveTable = (
            snapshot.tables["links"] if is_now else self._recorded("links", tick)
        )
        others = (rows["entity"] == id) & (rows["link"] != 0)
        squares = sum(rows[name][others] ** 2 for name in columns)
        greatest = float(np.sqrt(squares).max(initial=0.0))
        return None if math.isnan(greatest) else greatest

    def contacts(self) -> ContactPairs:
        """Returns the contacts of the present tick."""
        snapshot = self.world.snapshot
        if "contacts" in snapshot.unavailable:
            raise UnsupportedError(snapshot.unavailable["contacts"])
        return snapshot.contacts()

    def joint_owners(self) -> dict[str, set[int]]:
        """Returns the ids of the entities that have a joint of each name, at any tick."""
        members = {member.id: member for member in self.world.snapshot.entities}
        if self.history is not None:
            members.update(self.history.record.members)
        owners: dict[str, set[int]] = {}
        for id, member in members.items():
            for joint in () if member.body is None else member.body.joints:
                owners.setdefault(joint.name, set()).add(id)
        return owners

    def _recorded(self, table: str, tick: int) -> Mapping[str, Any]:
        if self.history is None:
            raise UnsupportedError(no_ticks_message(self.world.name))
        record = self.history.record
        if table not in record.tables:
            recording, is_live = self.history.store.recording, self.history.recorder is not None
            name = self.schemas[0] if self.schemas else self.world.name
            raise UnsupportedError(not_recorded_message(table, name, recording, is_live=is_live))
        return record.rows(table, tick)

    def recorded_numbers(self, kind: str, tick: int, a: int, b: int) -> list[float]:
        """Returns what the lookup of a name (`LOOKUPS`) finds for two ids at a recorded tick."""
        if kind == "wrench" and self.history is not None:
            self.history.record.warn_of_missing_entities()
        return LOOKUPS[kind](partial(self._recorded, tick=tick), a, b)


def _names_with_changed_margins(snapshot: Snapshot) -> list[str]:
    """Returns the entities whose margins differ from the initial ones, which records store."""
    shapes = [(id, shape) for id, body in snapshot.layout.bodies for shape in body.shapes]
    current = snapshot.tables["shapes"]["margin"].tolist()
    pairs = zip(shapes, current, strict=True)
    changed = {id for (id, shape), margin in pairs if shape.margin != margin}
    return [info.name for info in snapshot.entities if info.id in changed]


def _pose_text(pose: Sequence[float | None]) -> str:
    return "[" + ", ".join("NULL" if number is None else f"{number:g}" for number in pose) + "]"
