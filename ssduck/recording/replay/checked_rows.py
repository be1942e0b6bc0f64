"""Checks the rows of a record's ticks when they are read, against the models of its entities.

A record may come from a stranger. The replay takes for granted that each row is of a known entity,
that no entity is there twice at a tick, that a body has all of its links, and that each row has the
number and the time of a tick of the record.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ssduck.errors import RecordError
from ssduck.recording.buffers import TickBuffer
from ssduck.recording.stores.base import PairRequest, TickArchive
from ssduck.recording.stores.tick_checks import stray_message, stray_row
from ssduck.schema import FRAMES, RECORDED
from ssduck.world.layout import EntityInfo

Integers = npt.NDArray[np.int64]

# The columns of each table that name a link, by that of its entity.
_LINKS = {"contacts": {"a": "link_a", "b": "link_b"}}
# The tables that have a row for each part of a body at each tick that has one of them.
_COMPLETE = frozenset(("links", "joints", FRAMES))
_LARGEST = 1 << 62


@dataclass(frozen=True, eq=False)
class CheckedRows:
    """The rows of an archive, checked.

    Attributes:
        archive: has the rows.
        members: the recorded entities, by id.
        ticks: the recorded ticks.
        source: the folder or the file, to begin messages.
    """

    archive: TickArchive
    members: Mapping[int, EntityInfo]
    ticks: TickBuffer
    source: str
    _checked: set[str] = field(default_factory=set)

    def fetch(self, table: str, first: int, last: int) -> pa.Table:
        """Returns the rows of a table at the ticks from first to last, both included.

        Raises:
            RecordError: they are of unknown ticks, entities or links, twice there, or incomplete.
        """
        rows = self.archive.fetch(table, first, last)
        for column in rows.schema:
            if column.type != pa.float64() and rows[column.name].null_count:
                self._fail(table, f"the column {column.name!r} lacks a value")
        stray = stray_row(rows, self.ticks.numbers, self.ticks.times)
        if stray is not None:
            self._fail(table, stray)
        for name in RECORDED[table].entity_columns:
            indices = self._indices(table, rows[name].to_numpy())
            link = _LINKS.get(table, {}).get(name)
            if link is not None:
                self._check_range(table, rows[link].to_numpy(), self._parts("links").take(indices))
        if RECORDED[table].key and rows.num_rows:
            self._check_keys(table, rows)
        return rows

    def recheck(self) -> None:
        """Forgets which tables were checked: the archive has other rows now."""
        self._checked.clear()

    def check_ticks(self, table: str) -> None:
        """Checks that all rows of a table have the number and the time of a tick of the record.

        SQL reads the rows of a view in place, so they are checked once, before the first time.

        Raises:
            RecordError: a row has those of none.
        """
        if table in self._checked:
            return
        ticks = pa.table({"tick": self.ticks.numbers, "time": self.ticks.times})
        stray = self.archive.stray_tick(table, ticks)
        if stray is not None:
            self._fail(table, stray_message(*stray))
        self._checked.add(table)

    def near_pairs(self, request: PairRequest) -> pa.Table:
        """Returns the pairs of entities whose boxes are near at a tick, or unknown.

        Raises:
            RecordError: they are of unknown ticks or entities.
        """
        pairs = self.archive.near_pairs(request, None)
        is_known = np.isin(pairs["tick"].to_numpy(), self.ticks.numbers)
        if not is_known.all():
            self._fail("entities", "one is at a tick that the record does not have")
        for column in ("a", "b"):
            self._indices("entities", pairs[column].to_numpy())
        return pairs

    @cached_property
    def _ids(self) -> Integers:
        """The ids of the members, ascending."""
        return np.array(sorted(self.members), dtype=np.int64)

    def _parts(self, table: str) -> Integers:
        """Returns the number of parts of each member: its links, joints or shapes."""
        bodies = [self.members[id].body for id in self._ids.tolist()]
        if table == "entities":
            return np.ones(len(bodies), dtype=np.int64)
        attribute = table if table in ("joints", "shapes") else "links"
        counts = [0 if body is None else len(getattr(body, attribute)) for body in bodies]
        return np.array(counts, dtype=np.int64)

    def _indices(self, table: str, ids: Integers) -> Integers:
        """Returns the indices of entities among the members, by their ids."""
        indices: Integers = np.searchsorted(self._ids, ids)
        is_known = self._ids.take(indices, mode="clip") == ids if len(self._ids) else ids < 0
        if not is_known.all():
            self._fail(table, f"the entity {ids[~is_known][0]} is unknown")
        return indices

    def _check_range(self, table: str, numbers: Integers, counts: Integers) -> None:
        if not ((numbers >= 0) & (numbers < counts)).all():
            self._fail(table, "a link is unknown")

    def _check_keys(self, table: str, rows: pa.Table) -> None:
        """Checks that no row is twice there, and that no part of a body is missing."""
        owner, *numbered = RECORDED[table].key
        indices, counts = self._indices(table, rows[owner].to_numpy()), self._parts(table)
        numbers: Any = rows[numbered[0]].to_numpy() if numbered else 0
        self._check_range(table, numbers, counts.take(indices))
        starts = np.cumsum(counts) - counts
        ticks, size = rows["tick"].to_numpy(), int(counts.sum())
        offsets = ticks - ticks.min()
        if int(offsets.max()) * size > _LARGEST:
            offsets = np.unique(ticks, return_inverse=True)[1]
        keys = offsets * size + starts.take(indices) + numbers
        if (np.diff(keys) <= 0).any():
            keys = np.sort(keys)
            if (np.diff(keys) == 0).any():
                self._fail(table, "a row is twice there")
        if table in _COMPLETE:
            owners = np.repeat(np.arange(len(counts)), counts).take(keys % size)
            begins = np.flatnonzero(np.diff(keys // size, prepend=-1) | np.diff(owners, prepend=-1))
            if int(counts.take(owners.take(begins)).sum()) != len(keys):
                self._fail(table, "a body lacks some of them")

    def _fail(self, table: str, reason: str) -> None:
        raise RecordError(f"{self.source} is damaged: of the rows of {table}, {reason}")
