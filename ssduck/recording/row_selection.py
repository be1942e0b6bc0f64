"""Selects the rows of ticks that are recorded, and makes them of the states of the ticks."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array, Indices
from ssduck.recording.buffers import TickRows
from ssduck.recording.spec import chosen_members
from ssduck.schema import FRAMES, RECORDED, STORED_TABLES, TABLES
from ssduck.simulators.interface import ContactPoints, LinkPoses
from ssduck.world.layout import BodyGroup, TableLayout
from ssduck.world.rows import CONTACT_SIDES, contact_rows
from ssduck.world.sensor_readings import SENSING_COLUMNS, TickState, sensing_rows
from ssduck.world.snapshot import Snapshot

# The tables that have the same rows at each tick as long as the entities are the same.
FIXED_ROW_TABLES = tuple(table.name for table in STORED_TABLES.values() if table.key)
# The functions that write the poses of tables.
_WRITERS: Mapping[str, Callable[[BodyGroup, LinkPoses, Array], None]] = {
    "entities": BodyGroup.write_entities,
    "links": BodyGroup.write_links,
    "shapes": BodyGroup.write_shapes,
}
# The groups of bodies that are read together, with their link poses at some ticks.
_Groups: TypeAlias = Sequence[tuple[BodyGroup, LinkPoses]]
# Columns of integers and booleans by name, (rows,), those of doubles without the time, (columns,
# rows), and the place of each row's tick among the ticks, (rows,).
_Columns: TypeAlias = tuple[Mapping[str, Indices], Array, Indices]


@dataclass(frozen=True, eq=False)
class _FixedRows:
    """What is the same at each tick."""

    count: int  # the number of rows of the table
    chosen: Indices | None  # those that are recorded; None for all
    # the columns of these that have integers, but the tick, or booleans, by name
    numbers: Mapping[str, npt.NDArray[Any]]


class RecordedRows:
    """The rows of a world's tables that are recorded while its entities are the same."""

    def __init__(
        self, snapshot: Snapshot, tables: Collection[str], names: Collection[str] | None
    ) -> None:
        self._tables, self._layout = tables, snapshot.layout
        self._flags = snapshot.disabled, snapshot.hidden
        members = self._layout.entities
        # The recorded entities.
        self.members = members if names is None else chosen_members(members, names)
        # The ids of the recorded entities; None for all.
        self._ids = None if names is None else np.array([m.id for m in self.members], np.int64)
        ids = {member.id for member in self.members}
        self._link_selections = [
            _select_links(part, self._layout, ids)
            for part in (self._layout.static_bodies, self._layout.moving_bodies)
        ]
        self.link_count = sum(len(body.links) for _, body in self._layout.bodies)
        self._fixed = {t: self._fixed_rows(snapshot, t) for t in tables if t in FIXED_ROW_TABLES}
        if FRAMES in tables:
            parts = self._link_selections
            numbers = {
                "entity": np.concatenate([links.entities for links in parts]),
                "link": np.concatenate([links.links for links in parts]),
            }
            self._fixed[FRAMES] = _FixedRows(len(numbers["link"]), None, numbers)

    def matches(self, snapshot: Snapshot) -> bool:
        """Checks whether the entities of a snapshot and their flags are the same."""
        return snapshot.layout is self._layout and (
            (snapshot.disabled, snapshot.hidden) == self._flags
        )

    def _fixed_rows(self, snapshot: Snapshot, table: str) -> _FixedRows:
        live, columns = snapshot.tables[table], TABLES[table].tick_columns
        (owner,) = TABLES[table].entity_columns
        is_chosen = np.ones(live.count, bool)
        if self._ids is not None:
            is_chosen = np.isin(live[owner], self._ids)
        if table == "links":  # a body of one link has its pose
            counts = [len(body.links) for _, body in self._layout.bodies]
            is_chosen &= np.repeat(counts, counts) > 1
        rows = np.flatnonzero(is_chosen)
        return _FixedRows(
            live.count,
            None if is_chosen.all() else rows,
            {
                **{name: live[name][rows] for name in columns.integers[1:]},
                **{name: live.booleans(name)[rows] for name in columns.booleans},
            },
        )

    # -- the rows of ticks ------------------------------------------------------------------

    @np.errstate(invalid="ignore")  # a diverging simulation has infinite numbers
    def of_ticks(self, states: Sequence[TickState]) -> dict[str, TickRows]:
        """Returns the rows of ticks, by table."""
        groups: _Groups = (
            (self._layout.static_bodies, states[0].static),
            (self._layout.moving_bodies, LinkPoses.joined([state.moving for state in states])),
        )
        numbers = np.array([state.number for state in states])
        times = np.array([state.time for state in states])
        rows = {}
        for table in self._tables:
            integers, doubles, ticks = self._columns(table, states, groups)
            rows[table] = TickRows(
                {"tick": numbers[ticks], **integers}, np.vstack((times[ticks], doubles))
            )
        return rows

    def _columns(self, table: str, states: Sequence[TickState], groups: _Groups) -> _Columns:
        """Returns the columns of a table at some ticks, tick after tick."""
        count = len(states)
        if table in self._fixed:
            fixed, block = self._fixed[table], self._block(table, states, groups)
            chosen = block if fixed.chosen is None else block.take(fixed.chosen, axis=1)
            return (
                {name: np.tile(values, count) for name, values in fixed.numbers.items()},
                chosen.swapaxes(1, 2).reshape(len(block), chosen.shape[1] * count),
                np.arange(count).repeat(chosen.shape[1]),
            )
        if table == "ticks":
            return {}, np.array([[state.wall_time for state in states]]), np.arange(count)
        make = self._contacts if table == "contacts" else self._sensings
        integers, doubles, ticks = make(states)
        if self._ids is None:
            return integers, doubles, ticks
        owners = [integers[name] for name in TABLES[table].entity_columns]
        rows = np.flatnonzero(np.logical_and.reduce([np.isin(ids, self._ids) for ids in owners]))
        return {n: v[rows] for n, v in integers.items()}, doubles[:, rows], ticks[rows]

    def _block(self, table: str, states: Sequence[TickState], groups: _Groups) -> Array:
        """Returns the doubles of a table of fixed rows at some ticks, (columns, rows, ticks)."""
        if table == "joints":
            joints = [state.joints for state in states if state.joints is not None]
            return np.stack(joints, axis=-1).swapaxes(0, 1)
        width = len(RECORDED[table].tick_columns.measured)
        block = np.zeros((width, self._fixed[table].count, len(states)))
        if table != FRAMES:
            for group, poses in groups:
                _WRITERS[table](group, poses, block)
            return block
        first = 0
        for links, (group, poses) in zip(self._link_selections, groups, strict=True):
            if not len(links.indices):
                continue
            values = np.concatenate((poses.positions, poses.orientations), axis=1)
            at_ticks = values.reshape(-1, group.link_count, width)
            end = first + len(links.indices)
            block[:, first:end] = at_ticks[:, links.indices].transpose(2, 1, 0)
            first = end
        return block

    def _contacts(self, states: Sequence[TickState]) -> _Columns:
        points, counts = ContactPoints.joined([state.contacts for state in states])
        ticks = np.arange(len(states)).repeat(counts)
        entities = self._layout.ids_of_handles[points.bodies]
        sides, numbers = contact_rows(points, entities, ticks)
        return dict(zip(CONTACT_SIDES, sides, strict=True)), numbers, ticks

    def _sensings(self, states: Sequence[TickState]) -> _Columns:
        parts = [sensing_rows(state.readings, self._layout.rows) for state in states]
        ticks = np.arange(len(states)).repeat([len(part) for part in parts])
        *integers, measured = np.concatenate(parts).T
        columns = zip(SENSING_COLUMNS[:-1], integers, strict=True)
        return {name: v.astype(np.int64) for name, v in columns}, measured[None], ticks


@dataclass(frozen=True, eq=False)
class _LinkSelection:
    """The recorded links of a body group: those of bodies with several links."""

    indices: Indices  # (n,), their places in the link poses of the group
    entities: Indices  # (n,), the ids of their entities
    links: Indices  # (n,), their numbers in their bodies


def _select_links(part: Any, layout: TableLayout, ids: Collection[int]) -> _LinkSelection:
    id_of = {body: id for id, body in layout.bodies}
    runs = [
        (id_of[body], run)
        for body, run in part.runs.items()
        if len(body.links) > 1 and id_of[body] in ids
    ]
    counts = [run.stop - run.start for _, run in runs]
    empty = np.zeros(0, dtype=np.intp)
    return _LinkSelection(
        np.concatenate([empty, *(np.arange(run.start, run.stop) for _, run in runs)]),
        np.repeat(np.array([id for id, _ in runs], dtype=np.int64), counts),
        np.concatenate([empty, *map(np.arange, counts)]),
    )
