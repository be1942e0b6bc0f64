"""Chooses the rows of a tick that are recorded, and copies them into buffers."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Indices
from ssduck.recording.buffers import RowBuffer
from ssduck.recording.spec import chosen_members
from ssduck.schema import FRAMES, TABLES
from ssduck.world.layout import TableLayout
from ssduck.world.live_tables import LiveTable
from ssduck.world.snapshot import Snapshot

# The tables whose rows are the same ones at each tick, while the entities are.
LAID_OUT = tuple(table.name for table in TABLES.values() if table.key)


class RecordedRows:
    """Which rows of a world's tables are kept, while its entities are the same.

    Args:
        snapshot: of a tick.
        names: of the entities that are kept; None for all.
    """

    def __init__(self, snapshot: Snapshot, names: Collection[str] | None) -> None:
        self._layout = snapshot.layout
        self._of = snapshot.disabled, snapshot.hidden
        members = self._layout.entities
        self.members = members if names is None else chosen_members(members, names)
        self._ids = np.array([member.id for member in self.members], dtype=np.int64)
        kept = {member.id for member in self.members}
        self._frames = [
            _frames_of(part, self._layout, kept)
            for part in (self._layout.static_bodies, self._layout.moving_bodies)
        ]
        self._frames_count = sum(len(frames.places) for frames in self._frames)
        self._picked: dict[str, Indices | None] = {
            table: None if names is None else self._pick(snapshot, table)
            for table in LAID_OUT
            if table != "links"
        }
        self._picked["links"] = self._links(kept)

    def fit(self, snapshot: Snapshot) -> bool:
        """Whether the entities are still the same, and their booleans."""
        return snapshot.layout is self._layout and (
            (snapshot.disabled, snapshot.hidden) == self._of
        )

    def _pick(self, snapshot: Snapshot, table: str) -> Indices:
        (owner,) = TABLES[table].entity_columns
        return np.flatnonzero(np.isin(snapshot.tables[table][owner], self._ids))

    def _links(self, kept: Collection[int]) -> Indices:
        """The rows of links of bodies that have several."""
        owners = [(id, len(body.links)) for id, body in self._layout.bodies for _ in body.links]
        rows = [row for row, (id, links) in enumerate(owners) if links > 1 and id in kept]
        return np.array(rows, dtype=np.intp)

    def count(self, snapshot: Snapshot, table: str) -> int:
        """How many rows of a table there are to be kept."""
        if table == FRAMES:
            return self._frames_count
        picked = self._selected(snapshot, table)
        return snapshot.tables[table].count if picked is None else len(picked)

    def _selected(self, snapshot: Snapshot, table: str) -> Indices | None:
        """The rows that are kept; None for all."""
        if table in self._picked:
            return self._picked[table]
        owners = TABLES[table].entity_columns
        if not owners or self._picked["entities"] is None:
            return None
        live = snapshot.tables[table]
        are_chosen = [np.isin(live[owner], self._ids) for owner in owners]
        return np.flatnonzero(np.logical_and.reduce(are_chosen))

    def copy(self, snapshot: Snapshot, table: str, buffer: RowBuffer, count: int) -> None:
        """Copy the rows of a table, of which there are so many, into a buffer."""
        if table in self._picked or table == FRAMES:
            buffer.lay(self, count, lambda: self._fixed(snapshot, table))
        run = buffer.run(count)
        buffer.ticks[run] = snapshot.number
        if table == FRAMES:
            self._copy_frames(snapshot, buffer, run)
            return
        live: LiveTable = snapshot.tables[table]
        columns, picked = TABLES[table].tick_columns, self._selected(snapshot, table)
        doubles = live.block[live.block_rows(columns.doubles)]
        buffer.doubles[:, run] = doubles if picked is None else doubles[:, picked]
        if table not in self._picked:
            for name in columns.integers[1:]:
                column = live[name]
                buffer.integers[name][run] = column if picked is None else column[picked]

    def _fixed(self, snapshot: Snapshot, table: str) -> dict[str, npt.NDArray[Any]]:
        """The columns of integers and booleans, but for the ticks."""
        if table == FRAMES:
            owners = {"entity": [f.entities for f in self._frames]}
            links = {"link": [f.links for f in self._frames]}
            return {name: np.concatenate(parts) for name, parts in (owners | links).items()}
        columns, picked = TABLES[table].tick_columns, self._picked[table]
        live = snapshot.tables[table]
        fixed = {name: live[name] for name in columns.integers[1:]}
        fixed |= {name: live.booleans(name) for name in columns.booleans}
        return {n: values if picked is None else values[picked] for n, values in fixed.items()}

    def _copy_frames(self, snapshot: Snapshot, buffer: RowBuffer, run: slice) -> None:
        buffer.doubles[0, run] = snapshot.time
        first = run.start
        for own, (_, frames) in zip(self._frames, snapshot.body_groups, strict=True):
            if not len(own.places):
                continue
            to = slice(first, first + len(own.places))
            first = to.stop
            buffer.doubles[1:4, to] = frames.positions.take(own.places, axis=0).T
            buffer.doubles[4:, to] = frames.states[:, 3:7].take(own.places, axis=0).T


@dataclass(frozen=True, eq=False)
class _Frames:
    """Of the bodies of several links that are read together: which frames, and whose."""

    places: Indices
    entities: Indices
    links: Indices


def _frames_of(part: Any, layout: TableLayout, kept: Collection[int]) -> _Frames:
    ids = {body: id for id, body in layout.bodies}
    runs = [
        (ids[body], run)
        for body, run in part.runs.items()
        if len(body.links) > 1 and ids[body] in kept
    ]
    counts = [run.stop - run.start for _, run in runs]
    empty = np.zeros(0, dtype=np.intp)
    return _Frames(
        np.concatenate([empty, *(np.arange(run.start, run.stop) for _, run in runs)]),
        np.repeat(np.array([id for id, _ in runs], dtype=np.int64), counts),
        np.concatenate([empty, *map(np.arange, counts)]),
    )
