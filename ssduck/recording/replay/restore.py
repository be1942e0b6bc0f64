"""Restores a world as it was at a recorded tick, from rows that are cached in blocks."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ssduck.errors import RecordError
from ssduck.formatting import past_path, past_query
from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.queries import ShapeQueries
from ssduck.recording.buffers import TickBuffer
from ssduck.schema import FRAMES, ON_DEMAND, POSE, TABLES
from ssduck.simulators.interface import Body, LinkPoses
from ssduck.simulators.partial import StaticSimulator
from ssduck.world.entities import Entity
from ssduck.world.handles import RecordedTick, WorldArchive
from ssduck.world.layout import BodyGroup, EntityInfo, TableLayout
from ssduck.world.snapshot import RECORDED_DOUBLES, Snapshot
from ssduck.world.ticking import LiveTicker
from ssduck.world.world import World

# The number of ticks of a block, and the number of cached blocks.
BLOCK = 64
MAX_BLOCKS = 8


class RowCache:
    """The rows of a record, with a cache of the least recently used blocks."""

    def __init__(
        self, fetch: Callable[[str, int, int], pa.Table], ticks: TickBuffer, source: str
    ) -> None:
        self.source = source
        self._fetch = fetch
        self._ticks = ticks
        self._blocks: OrderedDict[tuple[int, int], dict[str, dict[str, npt.NDArray[Any]]]] = (
            OrderedDict()
        )

    def clear(self) -> None:
        """Drops all rows."""
        self._blocks.clear()

    def rows(self, table: str, tick: int) -> dict[str, npt.NDArray[Any]]:
        """Returns the columns of a table at a tick; NaN for unknown numbers."""
        number = tick // BLOCK
        # The key of the last block changes when further ticks are recorded.
        last = min((number + 1) * BLOCK - 1, int(self._ticks.numbers[-1]))
        key = number, last
        if key not in self._blocks:
            while len(self._blocks) >= MAX_BLOCKS:
                self._blocks.popitem(last=False)
            self._blocks[key] = {}
        self._blocks.move_to_end(key)
        block = self._blocks[key]
        if table not in block:
            rows = self._fetch(table, number * BLOCK, last)
            order = np.argsort(rows["tick"].to_numpy(), kind="stable")
            block[table] = {name: rows[name].to_numpy()[order] for name in rows.column_names}
        columns = block[table]
        first, end = np.searchsorted(columns["tick"], [tick, tick + 1])
        return {name: column[first:end] for name, column in columns.items()}


_NAN = float("nan")
# Tables that only a simulator provides; their rows are copied from the record.
_COPIED = frozenset(name for name in ON_DEMAND if not TABLES[name].key)
_STATE = (*POSE, "vx", "vy", "vz", "wx", "wy", "wz")


@dataclass(frozen=True, eq=False)
class _Template:
    """What ticks with the same entities share."""

    snapshot: Snapshot
    sources: tuple[tuple[BodyGroup, Indices], ...]  # rows of link poses: of entities, then links
    bases: Indices  # (n, 2), the row of the base of each body with links, and of its entity
    link_owners: Indices  # the ids of these bodies, once for each link, ascending


class SnapshotRestorer:
    """Restores recorded ticks; caches what ticks with the same entities share."""

    def __init__(
        self,
        members: Mapping[int, EntityInfo],
        tables: frozenset[str],
        rows: RowCache,
        empty: Snapshot,
    ) -> None:
        self._members = members
        self._tables = tables
        self._links = links_of(tables)
        self._rows = rows
        self._empty = empty
        self._templates: dict[tuple[int, ...], _Template] = {}

    def snapshot(self, tick: int, unavailable: Mapping[str, str]) -> Snapshot:
        """Returns a snapshot with the entities of a tick, to restore the tick into."""
        template = self._template_at(tick).snapshot
        return template.clone(unavailable, template.run)

    def restore_into(self, snapshot: Snapshot, tick: int, time: float) -> StaticSimulator:
        """Restores a tick into a snapshot, and returns the static simulator of the tick."""
        template = self._template_at(tick)
        members = template.snapshot.load_order
        rows = self._rows.rows("entities", tick)
        by_id = np.argsort(rows["id"])
        listed = [member.id for member in template.snapshot.entities]
        order = by_id[np.searchsorted(rows["id"][by_id], listed)]
        doubles = np.array([rows[name] for name in RECORDED_DOUBLES])[:, order]
        own_states = np.array([rows[name] for name in _STATE])[:, order].T
        links = self._states_of_links(tick, template.link_owners)
        states = np.concatenate((own_states, links))
        states[template.bases[:, 0], 7:] = states[template.bases[:, 1], 7:]
        absent = {
            name: frozenset(
                member.body
                for member, is_so in zip(
                    template.snapshot.entities, rows[name][order].tolist(), strict=True
                )
                if member.body is not None and not is_so
            )
            for name in ("enabled", "visible")
        }
        simulator = StaticSimulator(
            time=time,
            link_poses={
                part.bodies: _link_poses(states[source]) for part, source in template.sources
            },
            joints=self._joints(tick, template.snapshot.layout),
            disabled=absent["enabled"],
            hidden=absent["visible"],
            description="a recorded tick",
        )
        snapshot.go_to(tick, doubles)
        snapshot.take(simulator, members)
        for table in _COPIED & self._tables:
            recorded = self._rows.rows(table, tick)
            snapshot.tables[table].fill(len(recorded["tick"]), recorded)
        return simulator

    def _template_at(self, tick: int) -> _Template:
        return self._template_of(tuple(np.sort(self._rows.rows("entities", tick)["id"]).tolist()))

    def _template_of(self, ids: tuple[int, ...]) -> _Template:
        if ids not in self._templates:
            if not set(ids) <= self._members.keys():
                raise self._damage("a row is of an unknown entity")
            members = [self._members[id] for id in ids]
            if not {member.mount[0] for member in members if member.sensor} <= set(ids):
                raise self._damage("a sensor is there without the body that carries it")
            template = Snapshot(self._empty.geometries, self._empty.run)
            layout = TableLayout(members, is_external=False)
            simulator = StaticSimulator(
                0.0,
                {
                    part.bodies: _identity_poses(part)
                    for part in (layout.static_bodies, layout.moving_bodies)
                },
                {body: np.zeros((len(body.joints), 3)) for _, body in layout.bodies},
                frozenset(),
                frozenset(),
            )
            template.take(simulator, members)
            template_layout = template.layout
            starts = _base_rows(template_layout)
            sources = tuple(
                _sources(part, template_layout, starts)
                for part in (template_layout.static_bodies, template_layout.moving_bodies)
            )
            bases = [(start, template_layout.rows[id]) for id, start in starts.items()]
            bodies = dict(template_layout.bodies)
            self._templates[ids] = _Template(
                template,
                sources,
                np.array(bases, dtype=np.intp).reshape(-1, 2),
                np.repeat(list(starts), [len(bodies[id].links) for id in starts]).astype(np.int64),
            )
        return self._templates[ids]

    def _damage(self, reason: str) -> RecordError:
        return RecordError(f"{self._rows.source} is damaged: {reason}")

    def _states_of_links(self, tick: int, owners: Indices) -> Array:
        """Returns the poses and velocities of the links of bodies with several links, (n, 13)."""
        rows = self._rows.rows(self._links, tick)
        if not np.array_equal(np.sort(rows["entity"]), owners):
            raise self._damage(f"at tick {tick}, the links are not those of the entities")
        keys = np.array([rows[name] for name in ("entity", "link")])
        unknown = np.full(len(rows["tick"]), _NAN)
        doubles = [rows.get(name, unknown) for name in _STATE]
        return np.array(doubles)[:, np.lexsort(keys[::-1])].T

    def _joints(self, tick: int, layout: TableLayout) -> dict[Body, Array]:
        if "joints" not in self._tables:
            return {b: np.full((len(b.joints), 3), _NAN) for _, b in layout.bodies}
        rows = self._rows.rows("joints", tick)
        owners = rows["entity"]
        states = np.array([rows[name] for name in ("position", "velocity", "effort")])
        numbers = rows["joint"]
        joints = {}
        for id, body in layout.bodies:
            indices = np.flatnonzero(owners == id)
            if len(indices) != len(body.joints):
                raise self._damage(f"at tick {tick}, the joints are not those of the entities")
            joints[body] = states[:, indices[np.argsort(numbers[indices])]].T.copy()
        return joints


def links_of(tables: Collection[str]) -> str:
    """Returns the recorded table that has the poses of the links of bodies with several links."""
    return "links" if "links" in tables else FRAMES


def _link_poses(states: Array) -> LinkPoses:
    return LinkPoses(np.ascontiguousarray(states[:, :3]), states)


def _identity_poses(part: BodyGroup) -> LinkPoses:
    count = sum(run.stop - run.start for run in part.runs.values())
    states = np.zeros((count, 13))
    states[:, 3] = 1.0
    return _link_poses(states)


def _base_rows(layout: TableLayout) -> dict[int, int]:
    """Returns the row of the base of each body with several links, after the rows of entities."""
    first = len(layout.entities)
    rows: dict[int, int] = {}
    for id, body in sorted(layout.bodies, key=lambda entry: entry[0]):
        if len(body.links) > 1:
            rows[id] = first
            first += len(body.links)
    return rows


def _sources(
    part: BodyGroup, layout: TableLayout, starts: Mapping[int, int]
) -> tuple[BodyGroup, Indices]:
    """Returns a body group with the rows of its links, among those of entities and after them."""
    ids = {body: id for id, body in layout.bodies}
    rows: list[int] = []
    for body in part.bodies:
        id = ids[body]
        start = starts.get(id, layout.rows[id])
        rows += range(start, start + len(body.links))
    return part, np.array(rows, dtype=np.intp)


# Tables that are read from the static simulator; the others are copied from the record.
READ = frozenset(name for name in ON_DEMAND if TABLES[name].key)


class PastTicker(LiveTicker):
    """Takes a recorded tick, again and again, with the tables that are requested."""

    def __init__(
        self, record: WorldArchive, simulator: StaticSimulator, snapshot: Snapshot
    ) -> None:
        super().__init__(record.world.name, simulator, snapshot)
        self._record = record

    def removal_of(self, name: str) -> str:
        """Returns that an entity of a name is recorded at other ticks; "" if none is."""
        return recorded_elsewhere(self._record, name)

    def request_tables(self, tables: Collection[str]) -> None:
        """Ensures that the tick includes tables; recorded ones are always there."""
        self._record.warn_of_missing(tables)
        super().request_tables(READ.intersection(tables))


def recorded_elsewhere(record: WorldArchive, name: str) -> str:
    """Returns that an entity of a name is recorded at other ticks, for an error; "" if none is."""
    if all(member.name != name for member in record.members.values()):
        return ""
    world = record.world.name
    return (
        f"it is there at other ticks of the record: {past_path(world, name)}; functions of "
        f"time take it from a query at its last time t, as {past_query(world, name, 't')}"
    )


class PastWorld(World):
    """A world as it was at a recorded tick, which never changes."""

    def __init__(
        self, moment: RecordedTick, simulator: StaticSimulator, snapshot: Snapshot
    ) -> None:
        self._record = moment.record
        ticker = PastTicker(self._record, simulator, snapshot)
        super().__init__(ticker, camera=self._record.world.camera)

    @property
    def origin(self) -> World:
        """The recorded world."""
        return self._record.world

    def shapes(self) -> ShapeQueries:
        """Returns queries of the shapes at this tick."""
        self.request_tables(("shapes",))
        return self.snapshot.shapes()

    def shapes_and_sites(self) -> ShapeQueries:
        """Returns queries in which sites have their regions as shapes."""
        self.request_tables(("shapes",))
        return self.snapshot.shapes_and_sites()

    def entity(self, id: int) -> Entity:
        """Returns the handle of an entity at this tick, by its id."""
        return self._record.entity(self.snapshot.number, id)

    def __contains__(self, thing: object) -> bool:
        """Checks whether there is an entity of a name, or a given entity."""
        if isinstance(thing, Entity):
            return thing.world is self._record.world and thing.id in self.snapshot.rows
        return super().__contains__(thing)
