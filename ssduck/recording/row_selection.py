"""Selects the rows of a tick that are recorded, and copies them into buffers."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Indices
from ssduck.recording.buffers import RowBuffer
from ssduck.recording.spec import chosen_members
from ssduck.schema import FRAMES, STORED_TABLES, TABLES
from ssduck.world.layout import TableLayout
from ssduck.world.live_tables import LiveTable
from ssduck.world.snapshot import Snapshot

# The tables that have the same rows at each tick as long as the entities are the same.
FIXED_ROW_TABLES = tuple(table.name for table in STORED_TABLES.values() if table.key)


class RecordedRows:
    """The rows of a world's tables that are recorded while its entities are the same.

    Args:
        snapshot: the snapshot of a tick.
        names: the names of the recorded entities; None for all.

    Attributes:
        members: the recorded entities.
    """

    def __init__(self, snapshot: Snapshot, names: Collection[str] | None) -> None:
        self._layout = snapshot.layout
        self._flags = snapshot.disabled, snapshot.hidden
        members = self._layout.entities
        self.members = members if names is None else chosen_members(members, names)
        self._ids = np.array([member.id for member in self.members], dtype=np.int64)
        ids = {member.id for member in self.members}
        self._link_selections = [
            _select_links(part, self._layout, ids)
            for part in (self._layout.static_bodies, self._layout.moving_bodies)
        ]
        self._link_count = sum(len(links.indices) for links in self._link_selections)
        self._fixed_rows: dict[str, Indices | None] = {
            table: None if names is None else self._rows_of_members(snapshot, table)
            for table in FIXED_ROW_TABLES
            if table != "links"
        }
        self._fixed_rows["links"] = self._rows_of_links(ids)

    def matches(self, snapshot: Snapshot) -> bool:
        """Checks whether the entities of a snapshot and their flags are the same."""
        return snapshot.layout is self._layout and (
            (snapshot.disabled, snapshot.hidden) == self._flags
        )

    def _rows_of_members(self, snapshot: Snapshot, table: str) -> Indices:
        (owner,) = TABLES[table].entity_columns
        return np.flatnonzero(np.isin(snapshot.tables[table][owner], self._ids))

    def _rows_of_links(self, ids: Collection[int]) -> Indices:
        """Returns the rows of the links of bodies that have several links."""
        owners = [(id, len(body.links)) for id, body in self._layout.bodies for _ in body.links]
        rows = [row for row, (id, links) in enumerate(owners) if links > 1 and id in ids]
        return np.array(rows, dtype=np.intp)

    def count(self, snapshot: Snapshot, table: str) -> int:
        """Returns the number of rows of a table that are recorded."""
        if table == FRAMES:
            return self._link_count
        selected = self._selected_rows(snapshot, table)
        return snapshot.tables[table].count if selected is None else len(selected)

    def _selected_rows(self, snapshot: Snapshot, table: str) -> Indices | None:
        """Returns the rows of a table that are recorded; None for all."""
        if table in self._fixed_rows:
            return self._fixed_rows[table]
        owners = TABLES[table].entity_columns
        if not owners or self._fixed_rows["entities"] is None:
            return None
        live = snapshot.tables[table]
        are_selected = [np.isin(live[owner], self._ids) for owner in owners]
        return np.flatnonzero(np.logical_and.reduce(are_selected))

    def copy(self, snapshot: Snapshot, table: str, buffer: RowBuffer, count: int) -> None:
        """Copies the recorded rows of a table into a buffer.

        Args:
            snapshot: has the rows.
            table: the name of the table.
            buffer: gets the rows.
            count: the number of rows, as `count` returns it.
        """
        if table in self._fixed_rows or table == FRAMES:
            buffer.prefill(self, count, lambda: self._fixed_columns(snapshot, table))
        rows = buffer.extend(count)
        buffer.ticks[rows] = snapshot.number
        if table == FRAMES:
            self._copy_link_poses(snapshot, buffer, rows)
            return
        live: LiveTable = snapshot.tables[table]
        columns, selected = TABLES[table].tick_columns, self._selected_rows(snapshot, table)
        doubles = live.block[live.block_rows(columns.doubles)]
        buffer.doubles[:, rows] = doubles if selected is None else doubles[:, selected]
        if table not in self._fixed_rows:
            for name in columns.integers[1:]:
                column = live[name]
                buffer.integers[name][rows] = column if selected is None else column[selected]

    def _fixed_columns(self, snapshot: Snapshot, table: str) -> dict[str, npt.NDArray[Any]]:
        """Returns the integer and boolean columns of a table, without the tick."""
        if table == FRAMES:
            return {
                "entity": np.concatenate([links.entities for links in self._link_selections]),
                "link": np.concatenate([links.links for links in self._link_selections]),
            }
        columns, selected = TABLES[table].tick_columns, self._fixed_rows[table]
        live = snapshot.tables[table]
        fixed = {name: live[name] for name in columns.integers[1:]}
        fixed |= {name: live.booleans(name) for name in columns.booleans}
        return {n: values if selected is None else values[selected] for n, values in fixed.items()}

    def _copy_link_poses(self, snapshot: Snapshot, buffer: RowBuffer, rows: slice) -> None:
        buffer.doubles[0, rows] = snapshot.time
        first = rows.start
        for links, (_, frames) in zip(self._link_selections, snapshot.body_groups, strict=True):
            if not len(links.indices):
                continue
            target = slice(first, first + len(links.indices))
            first = target.stop
            buffer.doubles[1:4, target] = frames.positions.take(links.indices, axis=0).T
            buffer.doubles[4:, target] = frames.states[:, 3:7].take(links.indices, axis=0).T


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
