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
from ssduck.recording.stores.base import PairRequest, PartGroup, TickArchive
from ssduck.recording.stores.tick_checks import stray_message, stray_row
from ssduck.schema import FRAMES, RECORDED
from ssduck.world.layout import EntityInfo

Integers = npt.NDArray[np.int64]

# The columns of each table that name a link, by that of its entity.
_LINKS = {"contacts": {"a": "link_a", "b": "link_b"}}
# The tables that have a row for each part of a body at each tick that has one of them.
_COMPLETE = frozenset(("links", "joints", FRAMES))
_LARGEST = 1 << 62
# So many rows of all ticks are checked at once: a hundred megabytes; of tables whose rows are not
# numbered, a member is taken to have so many at a tick.
_ROWS_AT_ONCE = 1 << 19
_ROWS_OF_MEMBER = 16


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
    _checked_groups: set[tuple[str, PartGroup]] = field(default_factory=set)

    def fetch(self, table: str, first: int, last: int) -> pa.Table:
        """Returns the rows of a table at the ticks from first to last, both included.

        Raises:
            RecordError: they are of unknown ticks, entities or links, twice there, or incomplete.
        """
        rows = self.archive.fetch(table, first, last)
        self._check(table, rows)
        return rows

    def _check(self, table: str, rows: pa.Table) -> None:
        """Checks rows of all parts of some ticks."""
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

    def recheck(self) -> None:
        """Forgets which tables were checked: the archive has other rows now."""
        self._checked.clear()
        self._checked_groups.clear()

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

    def check_groups(self, table: str, first: int, last: int) -> None:
        """Checks the same of the rows that a view reads for the ticks from first to last.

        Raises:
            RecordError: a row has the number or the time of no tick of the record.
        """
        if table in self._checked:
            return
        groups = self.archive.part_groups(table)
        found = [
            group
            for group in groups
            if not group.parts or (group.first <= last and first <= group.last)
        ]
        if len(found) == len(groups):
            self.check_ticks(table)
            return
        for group in found:
            if (table, group) not in self._checked_groups:
                self._check_group(table, group)

    def _check_group(self, table: str, group: PartGroup) -> None:
        begin, end = self.ticks.numbers.searchsorted([group.first, group.last + 1]).tolist()
        numbers, times = self.ticks.numbers[begin:end], self.ticks.times[begin:end]
        ticks = pa.table({"tick": numbers, "time": times})
        stray = self.archive.stray_tick_in(table, group, ticks)
        if stray is not None:
            self._fail(table, stray_message(*stray))
        self._checked_groups.add((table, group))

    def check_rows(self, table: str, *, bodies: bool = True) -> None:
        """Checks all rows of a table, a bounded number at a time.

        Args:
            table: the table.
            bodies: whether to check that the bodies with parts are those of the table of entities,
                whose rows must be right.

        Raises:
            RecordError: they are of unknown ticks, entities or links, twice there, or incomplete.
        """
        self.check_ticks(table)
        if not RECORDED[table].entity_columns:
            return
        numbers, step = self.ticks.numbers, self._ticks_at_once(table)
        for start in range(0, len(numbers), step):
            first, last = int(numbers[start]), int(numbers[start : start + step][-1])
            rows = self.archive.fetch_stored(table, first, last)
            self._check(table, rows)
            if bodies and table in _COMPLETE and "entities" in self.archive.tables:
                self._check_bodies(table, rows, self.fetch("entities", first, last))

    def _ticks_at_once(self, table: str) -> int:
        """Returns at how many ticks all rows of a table are about `_ROWS_AT_ONCE`."""
        has_key = bool(RECORDED[table].key)
        rows = int(self._parts(table).sum()) if has_key else _ROWS_OF_MEMBER * len(self.members)
        return max(_ROWS_AT_ONCE // max(rows, 1), 1)

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

    def _check_bodies(self, table: str, rows: pa.Table, entities: pa.Table) -> None:
        """Checks that the bodies with parts are those that are there, at each tick.

        A body of one link needs no row of it: that would repeat the pose of the body.
        """
        has_parts = self._parts(table) > (table != "joints")
        found = []
        for owner, present in ((RECORDED[table].key[0], rows), ("id", entities)):
            indices = self._indices(table, present[owner].to_numpy())
            ticks = np.searchsorted(self.ticks.numbers, present["tick"].to_numpy())
            keys = ticks * len(has_parts) + indices
            found.append(np.unique(keys[has_parts.take(indices)]))
        if not np.array_equal(found[0], found[1]):
            self._fail(table, "those of a body are missing at a tick, or there without it")

    def _fail(self, table: str, reason: str) -> None:
        raise RecordError(f"{self.source} is damaged: of the rows of {table}, {reason}")
