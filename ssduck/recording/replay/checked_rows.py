"""Checks the rows of a record's ticks when they are read, against the models of its entities.

A record may come from a stranger. What SelectScript reads of a tick is checked then; SQL reads all
rows of a view in place, so these are checked once, before the first time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np
import pyarrow as pa

from ssduck.errors import RecordError
from ssduck.recording.buffers import TickBuffer
from ssduck.recording.stores.base import PairRequest, PartGroup, RowBlock, TickArchive
from ssduck.recording.stores.row_checks import (
    TABLES_OF_BODIES,
    TWICE,
    RowChecks,
    keys_of,
)
from ssduck.world.layout import EntityInfo

# So many rows of all ticks are checked at once, of a store without parts: a hundred megabytes; of
# tables whose rows are not numbered, a member is taken to have so many at a tick.
_ROWS_AT_ONCE = 1 << 19
_ROWS_OF_MEMBER = 16


@dataclass(frozen=True, eq=False)
class CheckedRows:
    """The rows of an archive, checked: a RecordError tells what is wrong with them.

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
    _checked_groups: dict[PartGroup, set[str]] = field(default_factory=dict)

    def fetch(self, table: str, first: int, last: int) -> pa.Table:
        """Returns the rows of a table at the ticks from first to last, both included."""
        rows = self.archive.fetch(table, first, last)
        self._require(table, self._checks.problem(table, rows, self.ticks))
        return rows

    def check_rows(self, table: str, *, bodies: bool = True) -> None:
        """Checks all stored rows of a table, once: those that SQL reads.

        Args:
            table: the table.
            bodies: whether to check that the bodies with parts are those of the table of entities,
                whose rows are checked, too.
        """
        if table not in self._checked:
            self._check_blocks(table, self._blocks, self._checked, bodies=bodies)

    def check_groups(self, table: str, first: int, last: int) -> None:
        """Checks the rows that SQL reads of a table for the ticks from first to last, each once."""
        groups = self.archive.part_groups(table, first, last)
        found = [
            group
            for group in groups
            if not group.parts or (group.first <= last and first <= group.last)
        ]
        if len(found) == len(groups):
            self.check_rows(table)
        if table in self._checked:
            return
        for group in found:
            checked = self._checked_groups.setdefault(group, set())
            if table not in checked:
                self._check_blocks(table, partial(self.archive.group_rows, group), checked)

    def _check_blocks(
        self,
        table: str,
        blocks_of: Callable[[str], Iterator[RowBlock]],
        checked: set[str],
        *,
        bodies: bool = True,
    ) -> None:
        """Checks the blocks that a function returns of a table, and those that these depend on."""
        if bodies and table in TABLES_OF_BODIES and "entities" in self.archive.tables:
            for block, entities in zip(blocks_of(table), blocks_of("entities"), strict=True):
                if "entities" not in checked | self._checked:
                    self._check_block("entities", entities)
                self._check_block(table, block)
                problem = self._checks.problem_of_bodies(
                    table, block.rows, entities.rows, single=self.archive.has_single_links
                )
                self._require(table, problem)
            checked.add("entities")
        else:
            for block in blocks_of(table):
                self._check_block(table, block)
        checked.add(table)

    def _blocks(self, table: str) -> Iterator[RowBlock]:
        starts = self.ticks.numbers[:: self._ticks_at_once]
        return self.archive.key_rows(table, starts.tolist())

    def _check_block(self, table: str, block: RowBlock) -> None:
        self._require(table, self._checks.problem_of_block(table, block, self.ticks))

    @cached_property
    def _ticks_at_once(self) -> int:
        """At how many ticks all rows of a table are about `_ROWS_AT_ONCE`."""
        rows = max(self._checks.rows_of_a_tick("links"), _ROWS_OF_MEMBER * len(self.members), 1)
        return max(_ROWS_AT_ONCE // rows, 1)

    def near_pairs(self, request: PairRequest) -> pa.Table:
        """Returns the pairs of entities whose boxes are near at a tick, or unknown."""
        pairs = self.archive.near_pairs(request, None)
        ticks, a, b = (pairs[name].to_numpy() for name in ("tick", "a", "b"))
        if not np.isin(ticks, self.ticks.numbers).all():
            self._require("entities", "one is at a tick that the record does not have")
        for ids in (a, b):
            self._require("entities", self._checks.stranger(ids))
        keys = np.sort(keys_of(ticks, self._checks.place_of_pairs(a, b), len(self.members) ** 2))
        if (np.diff(keys) == 0).any():
            self._require("entities", TWICE)
        return pairs

    @cached_property
    def _checks(self) -> RowChecks:
        return RowChecks(self.members)

    def _require(self, table: str, problem: str | None) -> None:
        if problem is not None:
            raise RecordError(f"{self.source} is damaged: of the rows of {table}, {problem}")
