"""The entities of a recorded tick, where they were: rows to a snapshot."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.poses import rotation_matrices
from ssduck.recording.replay.row_cache import RowCache
from ssduck.schema import FRAMES, ON_DEMAND, POSE, TABLES
from ssduck.simulators.interface import Body, LinkPoses
from ssduck.simulators.static import StaticSimulator
from ssduck.world.layout import BodyGroup, EntityInfo, TableLayout
from ssduck.world.snapshot import Snapshot

_NAN = float("nan")
# Tables that only a simulator knows; their rows are copied from the record.
_COPIED = frozenset(name for name in ON_DEMAND if not TABLES[name].key)
_STATE = (*POSE, "vx", "vy", "vz", "wx", "wy", "wz")
_ENTITY_DOUBLES = TABLES["entities"].tick_columns.doubles


@dataclass(frozen=True, eq=False)
class _Placing:
    """The entities of a tick, and where the frames of their bodies are found.

    Attributes:
        template: a snapshot of such entities.
        sources: of each part, the rows of its frames: those of entities, then those of links.
        bases: of bodies of several links, the row of the base, and that of the entity, which
            knows how fast it is, (n, 2).
    """

    template: Snapshot
    sources: tuple[tuple[BodyGroup, Indices], ...]
    bases: Indices


class SnapshotRestorer:
    """Places what a record tells of; what is the same while the entities are is kept.

    Args:
        members: the entities, by id.
        tables: which tables are recorded.
        rows: of these.
        empty: a snapshot of their run in which nothing is.
    """

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
        self._placings: dict[tuple[int, ...], _Placing] = {}

    def snapshot(self, tick: int, unavailable: Mapping[str, str]) -> Snapshot:
        """One of the entities at a tick, to be taken.

        Args:
            tick: which one.
            unavailable: tables whose rows nobody knows there, and why.
        """
        return self._at(tick).template.past(tick, unavailable)

    def take(self, snapshot: Snapshot, tick: int, time: float) -> StaticSimulator:
        """Make a snapshot that of a tick; gives what stands for a simulator there."""
        placing = self._at(tick)
        members = placing.template.load_order
        rows = self._rows.rows("entities", tick)
        by_id = np.argsort(rows["id"])
        listed = [member.id for member in placing.template.entities]
        order = by_id[np.searchsorted(rows["id"][by_id], listed)]
        doubles = np.array([rows[name] for name in _ENTITY_DOUBLES])[:, order]
        own_states = np.array([rows[name] for name in _STATE])[:, order].T
        states = np.concatenate((own_states, self._states_of_links(tick)))
        states[placing.bases[:, 0], 7:] = states[placing.bases[:, 1], 7:]
        absent = {
            name: frozenset(
                member.body
                for member, is_so in zip(
                    placing.template.entities, rows[name][order].tolist(), strict=True
                )
                if member.body is not None and not is_so
            )
            for name in ("enabled", "visible")
        }
        posed = StaticSimulator(
            time=time,
            link_poses={part.bodies: _frames(states[source]) for part, source in placing.sources},
            joints=self._joints(tick, placing.template.layout),
            disabled=absent["enabled"],
            hidden=absent["visible"],
            description="a recorded tick",
        )
        snapshot.go_to(tick)
        snapshot.take(posed, members)
        # To the last digit as it was.
        entities = snapshot.tables["entities"]
        entities.block[entities.block_rows(_ENTITY_DOUBLES)] = doubles
        entities.publish_unknown()
        for table in _COPIED & self._tables:
            told = self._rows.rows(table, tick)
            snapshot.tables[table].fill(len(told["tick"]), told)
        return posed

    def _at(self, tick: int) -> _Placing:
        return self._of(tuple(np.sort(self._rows.rows("entities", tick)["id"]).tolist()))

    def _of(self, ids: tuple[int, ...]) -> _Placing:
        if ids not in self._placings:
            members = [self._members[id] for id in ids]
            template = Snapshot(self._empty.geometries, self._empty.run)
            layout = TableLayout(members, is_external=False)
            posed = StaticSimulator(
                0.0,
                {
                    part.bodies: _nowhere(part)
                    for part in (layout.static_bodies, layout.moving_bodies)
                },
                {body: np.zeros((len(body.joints), 3)) for _, body in layout.bodies},
                frozenset(),
                frozenset(),
            )
            template.take(posed, members)
            laid = template.layout
            starts = _starts(laid)
            sources = tuple(
                _sources(part, laid, starts) for part in (laid.static_bodies, laid.moving_bodies)
            )
            bases = [(start, laid.rows[id]) for id, start in starts.items()]
            self._placings[ids] = _Placing(
                template, sources, np.array(bases, dtype=np.intp).reshape(-1, 2)
            )
        return self._placings[ids]

    def _states_of_links(self, tick: int) -> Array:
        """Of the links of bodies that have several: pose and velocities, (n, 13)."""
        rows = self._rows.rows(self._links, tick)
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
        links = rows["link"]
        found = {}
        for id, body in layout.bodies:
            own = np.flatnonzero(owners == id)
            found[body] = states[:, own[np.argsort(links[own])]].T.copy()
        return found


def links_of(tables: Collection[str]) -> str:
    """Which of these tables tells where the links of bodies of several links are."""
    return "links" if "links" in tables else FRAMES


def _frames(states: Array) -> LinkPoses:
    positions = np.ascontiguousarray(states[:, :3])
    with np.errstate(invalid="ignore"):
        matrices = rotation_matrices(states[:, 3:7])
    return LinkPoses(positions, matrices, states)


def _nowhere(part: BodyGroup) -> LinkPoses:
    count = sum(run.stop - run.start for run in part.runs.values())
    states = np.zeros((count, 13))
    states[:, 3] = 1.0
    return _frames(states)


def _starts(layout: TableLayout) -> dict[int, int]:
    """The row of the base of each body of several links, behind the rows of all entities."""
    first = len(layout.entities)
    found: dict[int, int] = {}
    for id, body in sorted(layout.bodies, key=lambda entry: entry[0]):
        if len(body.links) > 1:
            found[id] = first
            first += len(body.links)
    return found


def _sources(
    part: BodyGroup, layout: TableLayout, starts: Mapping[int, int]
) -> tuple[BodyGroup, Indices]:
    """Where the frames of a part are: among the entities' rows, and behind them."""
    ids = {body: id for id, body in layout.bodies}
    places: list[int] = []
    for body in part.bodies:
        id = ids[body]
        start = starts.get(id, layout.rows[id])
        places += range(start, start + len(body.links))
    return part, np.array(places, dtype=np.intp)
