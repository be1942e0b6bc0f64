"""Records the ticks of a world as they come.

A `Recorder` copies the rows of each tick into buffers (`ssduck.recording.buffers`). When one is
full, all of them go to a store together, so that the stored rows end with a whole tick. A store on
a disk gets them in a thread (`ssduck.recording.background_writer`), while the buffers fill anew.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Mapping
from contextlib import AbstractContextManager
from typing import Any

import numpy as np
import pyarrow as pa

from ssduck.errors import RecordError, SelectScriptError
from ssduck.recording.background_writer import BackgroundWriter, BufferedRows
from ssduck.recording.buffers import RowBuffer, TickBuffer, buffer_of
from ssduck.recording.mass_changes import MassChanges
from ssduck.recording.row_selection import RecordedRows
from ssduck.recording.spec import QUARTERS, Recording
from ssduck.recording.static_tables import ShapeNumbers
from ssduck.recording.stores.base import PairRequest, TickArchive, TickStore
from ssduck.world.layout import EntityInfo
from ssduck.world.snapshot import Snapshot

# So many ticks wait at most to be stored, in a file or in memory.
BUFFERED_TICKS = 240
MEMORY_TICKS = 960


class Recorder:
    """Keeps the ticks of a world.

    Args:
        recording: what of them.
        store: where.
        waits: so many ticks wait at most to be stored.

    Attributes:
        buffers: what waits to be stored, by table.
        ticks: those that are kept.
        members: the entities that they tell of, by id; of those that are gone, too.
        reweighed: the bodies whose masses are known to have changed since.
    """

    def __init__(self, recording: Recording, store: TickStore, waits: int = BUFFERED_TICKS) -> None:
        self.recording = recording
        self._waits = waits
        self._store = store
        self.buffers = {table: buffer_of(table) for table in store.tables}
        columns = {table: buffer.arrow.schema for table, buffer in self.buffers.items()}
        self._storing = BackgroundWriter(store.add, columns)
        self._lock = threading.RLock()
        self.ticks = TickBuffer()
        self.members: dict[int, EntityInfo] = {}
        self.reweighed = MassChanges()
        self._told = 0
        self._is_looked_after = True
        self._rows: RecordedRows | None = None
        # Entities of which the store has not been told, and what numbers them.
        self._new: list[EntityInfo] = []
        self._numbers: ShapeNumbers | None = None

    @property
    def tables(self) -> Collection[str]:
        """The tables that each tick of the world is to have."""
        return self.recording.tables

    @property
    def visible_rows(self) -> tuple[Mapping[str, RowBuffer | BufferedRows], ...]:
        """What is not stored, by table; to be read with what is, and under `reading`."""
        return (self.buffers,) if self._store.is_in_place else (self._storing.batches, self.buffers)

    @property
    def reading(self) -> AbstractContextManager[Any]:
        """Nothing goes from what is not stored to what is while this lasts.

        Who enters it holds the world.
        """
        return self._storing.lock

    @property
    def is_stored_here(self) -> bool:
        """Whether the thread that asks is the one that stores."""
        return self._storing.is_here

    def note(self, snapshot: Snapshot) -> None:
        """Keep a tick, if it is one to be kept; the caller holds its world.

        Raises:
            RecordError: what waits cannot be stored in a folder; this tick waits with it.
            SqlError: the same of a database.
        """
        self._told += 1
        if (self._told - 1) % self.recording.every:
            return
        with self._lock:
            self._keep(snapshot, self._rows_of(snapshot))

    def note_masses(self, snapshot: Snapshot) -> None:
        """Take note of masses that are others than those that are kept: they were read anew."""
        for id, masses in snapshot.masses.items():
            member = self.members.get(id)
            if member is not None and masses != member.masses:
                self.reweighed.note(id, member.name)

    def _keep(self, snapshot: Snapshot, rows: RecordedRows) -> None:
        counts = {table: rows.count(snapshot, table) for table in self.buffers}
        failed = self._tried(self._tell_new)
        is_due = self._is_due(snapshot.time) or not all(
            self.buffers[table].takes(count) for table, count in counts.items()
        )
        if is_due:
            failed = self._tried(self._hand_over) or failed
        elif not self._storing.is_busy:
            failed = failed or self._tried(self._look_after)
        failed = failed or self._storing.failure()
        if is_due or not self.buffers["ticks"].count:
            for table, count in counts.items():
                self.buffers[table].reserve(count, self._waits)
        for table, count in counts.items():
            rows.copy(snapshot, table, self.buffers[table], count)
        self.ticks.append(snapshot.number, snapshot.time)
        if not snapshot.is_complete:  # where the buffer has what is no number, the store has NULL
            failed = failed or self._tried(self.flush)
        if failed is not None:
            raise failed

    @staticmethod
    def _tried(store: Callable[[], None]) -> BaseException | None:
        """Why something could not be stored, or waited for; None if it was."""
        try:
            store()
        except (SelectScriptError, KeyboardInterrupt) as error:
            return error
        return None

    def _hand_over(self) -> None:
        """Let what waits be stored, when all before it is."""
        self.wait()
        self._put()
        self._look_after()
        if self._new or not len(self._storing):  # rows go after what their entities are
            return
        self._is_looked_after = False
        if self._store.is_in_place:
            self._storing.store()
            self._look_after()
        else:
            self._storing.start()

    def _put(self) -> None:
        """Empty the buffers; what was in them waits in a batch."""
        if self.buffers["ticks"].count:
            self._storing.put({table: buffer.taken() for table, buffer in self.buffers.items()})

    def wait(self) -> None:
        """Wait until nothing is being stored in a thread."""
        self._storing.wait()

    def flush(self) -> None:
        """Store what waits, and drop what is too old.

        Raises:
            RecordError: it cannot be stored in a folder; it waits on.
            SqlError: the same of a database.
        """
        with self._lock:
            self.wait()
            failed = self._storing.failure()
            if len(self._storing):  # whether it can be stored now is seen here
                failed = None
            self._tell_new()
            self._put()
            self._is_looked_after = False
            self._storing.store()
            self._look_after()
            if failed is not None:
                raise failed

    def _look_after(self) -> None:
        """Drop what is too old, once after something was stored; nothing is being stored."""
        if self._is_looked_after:
            return
        self._is_looked_after = True
        oldest = self._oldest()
        if oldest is not None:
            self.ticks.forget_before(self._store.drop_before(oldest))

    def fetch(self, table: str, first: int, last: int) -> pa.Table:
        """The rows of a table at ticks from first to last, those that wait among them.

        The caller holds the world.
        """
        with self.reading:
            stored = self._archive.fetch(table, first, last)
            waiting = self._waiting(table)
            ticks = waiting["tick"].to_numpy()
            inside = waiting.filter(pa.array((ticks >= first) & (ticks <= last)))
            copied = inside.select(stored.column_names).cast(stored.schema)
            return pa.concat_tables([stored, copied])

    def near(self, request: PairRequest) -> pa.Table:
        """The pairs of entities whose boxes are near at some ticks, with their poses.

        The caller holds the world.
        """
        with self.reading:
            return self._archive.near(request, self._waiting("entities"))

    @property
    def _archive(self) -> TickArchive:
        """The store, to be read.

        Raises:
            RecordError: it is a folder, which is opened to be read.
        """
        if not isinstance(self._store, TickArchive):
            raise RecordError("a folder that is being recorded is read by opening it")
        return self._store

    def _waiting(self, table: str) -> pa.Table:
        """The rows of a table that are not stored."""
        return pa.concat_tables([self._storing.batches[table].arrow, self.buffers[table].rows()])

    def _is_due(self, time: float) -> bool:
        """Whether what waits is to be stored: so many ticks, or a quarter of what is kept."""
        waiting = self.buffers["ticks"].count
        if not waiting:
            return False
        recording = self.recording
        if recording.seconds is not None:
            since = self.ticks.times[-waiting]
            if time - since >= recording.seconds / QUARTERS:
                return True
        most = self._waits if recording.ticks is None else recording.ticks // QUARTERS
        return waiting >= min(self._waits, max(most, 1))

    def _oldest(self) -> int | None:
        """The first tick that is to be kept; None if all are."""
        recording, numbers = self.recording, self.ticks.numbers
        if not len(numbers) or not recording.is_bounded:
            return None
        first = 0
        if recording.ticks is not None:
            first = max(first, len(numbers) - recording.ticks)
        if recording.seconds is not None:
            times = self.ticks.times
            first = max(first, int(np.searchsorted(times, times[-1] - recording.seconds)))
        return int(numbers[first])

    def _rows_of(self, snapshot: Snapshot) -> RecordedRows:
        if self._rows is None or not self._rows.fit(snapshot):
            self._rows = RecordedRows(snapshot, self.recording.entities)
            masses = snapshot.masses
            new = [
                member.with_masses(masses.get(member.id, member.masses))
                for member in self._rows.members
                if member.id not in self.members
            ]
            self._new += new
            self._numbers = snapshot
            self.members |= {member.id: member for member in new}
        return self._rows

    def _tell_new(self) -> None:
        """Store what entities are, before rows of theirs."""
        if self._new:
            assert self._numbers is not None
            self.wait()
            self._store.add_members(self._new, self._numbers)
            self._new = []
