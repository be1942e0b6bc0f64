"""Records the ticks of a world as they are taken.

A `Recorder` keeps the states of ticks as they were read, until there are enough of them or somebody
reads the record. Then it writes the rows of all of them into buffers (`ssduck.recording.buffers`).
When these are full, the rows of all of them go to a store, so that the stored rows end with a whole
tick. A store on a disk gets them in a background thread (`ssduck.recording.background_writer`),
while the buffers fill again. It gets the first tick at once, and the others at the latest when half
of the time is over after which they have to be there (`Recording.flush_every`), so that writing
them takes the other half at most. If no tick comes then, a timer sees to it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from time import monotonic
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from ssduck.errors import RecordError, SimulatorError, warn
from ssduck.formatting import joined_names
from ssduck.recording import background_writer
from ssduck.recording.background_writer import BackgroundWriter, BufferedRows
from ssduck.recording.buffers import MAX_BUFFERED_ROWS, RowBuffer, TickBuffer
from ssduck.recording.row_selection import RecordedRows
from ssduck.recording.spec import RETENTION_PARTS, Recording, quarters_of
from ssduck.recording.stores.base import PairRequest, TickArchive, TickStore
from ssduck.recording.stores.stored_columns import conformed
from ssduck.schema import MASSES, OFTEN_UNKNOWN
from ssduck.world import ctrl_c
from ssduck.world.layout import EntityInfo
from ssduck.world.sensor_readings import TickState
from ssduck.world.snapshot import Snapshot

if TYPE_CHECKING:
    from ssduck.world.stepping import SteppedWorld


class MassChanges:
    """The bodies of a record whose masses have changed since they were recorded."""

    def __init__(self) -> None:
        self._names: dict[int, str] = {}
        # How many of them a warning has named.
        self._warned = 0

    def add(self, id: int, name: str) -> None:
        """Adds a body by the id and the name of its entity."""
        self._names[id] = name

    def warn(self, world: SteppedWorld) -> None:
        """Reads the masses of a recorded world, and warns once of each body whose mass changed."""
        with suppress(SimulatorError):  # the simulator may be gone
            world.request_tables((MASSES,))
        new = list(self._names.values())[self._warned :]
        self._warned += len(new)
        if new:
            warn(
                f"{world.name}: {joined_names(new)}: the mass was changed while it is recorded; "
                "recorded ticks have the mass that a body had when it was first recorded",
            )


# The largest number of buffered ticks, of a record in a file and in memory.
BUFFERED_TICKS = 240
MEMORY_TICKS = 960
# The largest numbers of ticks whose rows are written at once, and of links at these.
_BLOCK_TICKS, _BLOCK_LINKS = 64, 2048


class Recorder:
    """Records the ticks of a world."""

    def __init__(
        self,
        recording: Recording,
        store: TickStore,
        max_ticks: int = BUFFERED_TICKS,
        flush_every: float | None = None,
    ) -> None:
        self.recording = recording
        self._max_ticks = max_ticks
        self._store = store
        self._buffers = {table: RowBuffer(table) for table in store.tables}
        # The ticks whose rows are not in the buffers yet, the largest number of them, and that of
        # buffered ticks.
        self._pending: list[TickState] = []
        self._write_failure: Exception | None = None
        self._most_pending = self._most_buffered = 1
        columns = {table: buffer.arrow.schema for table, buffer in self._buffers.items()}
        self._writer = BackgroundWriter(store.append, columns)
        self._lock = threading.RLock()
        self._flush_every = flush_every
        # The time at which the buffered rows are to be stored, s of `monotonic`; None for no time.
        self.flush_at: float | None = None
        self.ticks = TickBuffer()  # the recorded ticks, stored and buffered
        # The recorded entities by id, removed ones included.
        self.members: dict[int, EntityInfo] = {}
        # The bodies whose masses have changed since they were recorded.
        self.mass_changes = MassChanges()
        self._tick_count = 0
        self._has_dropped_old = True
        self._rows: RecordedRows | None = None
        # Entities whose models are not stored yet, and what gives their ids.
        self._new_members: list[EntityInfo] = []
        self._snapshot: Snapshot | None = None

    @property
    def tables(self) -> Collection[str]:
        """The tables that each tick of the world needs."""
        return self.recording.tables

    @property
    def visible_rows(self) -> tuple[Mapping[str, RowBuffer | BufferedRows], ...]:
        """The rows that are not stored yet, by table.

        Call `settle` before they are read, and read them and the store under `read_lock`.
        """
        buffers = self._buffers
        return (buffers,) if self._store.is_in_place else (self._writer.batches, buffers)

    @property
    def buffers(self) -> Mapping[str, RowBuffer]:
        """The buffered rows, by table."""
        self.settle()
        return self._buffers

    @property
    def read_lock(self) -> threading.Condition:
        """A lock under which no buffered row becomes a stored one; its holder holds the world."""
        return self._writer.lock

    def record(self, snapshot: Snapshot) -> None:
        """Records a tick if it is due; the caller holds its world."""
        self._tick_count += 1
        if (self._tick_count - 1) % self.recording.every:
            return
        with self._lock:
            self._record(snapshot)

    def settle(self) -> None:
        """Writes the rows of all recorded ticks, for readers of the buffers."""
        if self._pending:
            with ctrl_c.deferred(), self._lock:  # no row may be lost or written twice
                if self._write_pending():
                    self.flush()
                self._raise_write_failure()

    def check_masses(self, snapshot: Snapshot) -> None:
        """Compares the masses of a snapshot, which were read anew, with the recorded ones."""
        for id, masses in snapshot.masses.items():
            member = self.members.get(id)
            if member is not None and masses != member.masses:
                self.mass_changes.add(id, member.name)

    def _record(self, snapshot: Snapshot) -> None:
        state = snapshot.state
        assert state is not None
        is_unknown = self._follow(snapshot, state)
        error = self._error_of(self._store_new_members) if self._new_members else None
        if self._is_storing_due(state.time):
            error = self._error_of(self._start_storing) or error
        elif not self._has_dropped_old and not self._writer.is_busy:
            error = error or self._error_of(self._drop_old_ticks)
        error = error or self._writer.pop_failure()
        self._pending.append(state)
        self.ticks.append(state.number, state.time)
        if len(self._pending) >= self._most_pending or not state.moving.are_finite:
            is_unknown |= self._write_pending()
        if self._flush_every is not None:
            self._set_flush_time()
            error = error or self._error_of(self._flush_if_due)
        if is_unknown:  # the store has NULL where the buffer has NaN
            error = error or self._error_of(self.flush)
        if error is not None:
            raise error
        self._raise_write_failure()

    def _raise_write_failure(self) -> None:
        """Raises the error of a tick that could not be written, once."""
        failure, self._write_failure = self._write_failure, None
        if failure is not None:
            raise failure

    def _follow(self, snapshot: Snapshot, state: TickState) -> bool:
        """Prepares to write a tick's rows; returns whether rows before have unknown numbers."""
        # Those written together have the same entities, and poses of those that cannot move.
        is_same = self._rows is not None and self._rows.matches(snapshot)
        if is_same and not (self._pending and self._pending[0].static is not state.static):
            return False
        is_unknown = self._write_pending()
        if not is_same:
            self._rows = self._recorded_rows(snapshot)
            self._most_pending = 1  # how many rows a tick has is known then
        return is_unknown

    def _write_pending(self) -> bool:
        """Writes the rows of ticks into the buffers; returns whether they have unknown numbers."""
        states, self._pending = self._pending, []
        if not states:
            return False
        assert self._rows is not None
        try:
            rows = self._rows.of_ticks(states)
        except Exception as error:  # noqa: BLE001  # `_raise_write_failure` raises it later
            if len(states) == 1:
                self._write_failure = self._write_failure or error
                is_other = self.ticks.numbers != states[0].number
                self.ticks.replace(self.ticks.numbers[is_other], self.ticks.times[is_other])
                return False
            are_unknown = []
            for state in states:
                self._pending = [state]
                are_unknown.append(self._write_pending())
            return any(are_unknown)
        counts = {table: -(-len(of_table) // len(states)) for table, of_table in rows.items()}
        self._most_buffered = self._ticks_per_buffer(counts)
        links = max(self._rows.link_count, 1)
        self._most_pending = max(
            min(_BLOCK_TICKS, _BLOCK_LINKS // links, self._most_buffered // 2), 1
        )
        is_empty = not self._buffers["ticks"].count
        for table, of_table in rows.items():
            buffer = self._buffers[table]
            if is_empty:
                buffer.reserve(counts[table], self._most_buffered)
            if not buffer.has_room(len(of_table)):
                buffer.reserve(len(of_table), 1)
            buffer.add(of_table)
        often = OFTEN_UNKNOWN.intersection(rows)
        return any(np.isnan(rows[table].doubles).any() for table in rows.keys() - often)

    def _ticks_per_buffer(self, counts: Mapping[str, int]) -> int:
        ticks = min(self._max_ticks, MAX_BUFFERED_ROWS // max(counts.values()))
        max_bytes = self.recording.max_bytes
        if isinstance(max_bytes, int):
            size = sum(count * self._buffers[table].row_bytes for table, count in counts.items())
            ticks = min(ticks, max_bytes // RETENTION_PARTS // size)
        return max(ticks, 1)

    @staticmethod
    def _error_of(store: Callable[[], None]) -> BaseException | None:
        """Calls a function that stores or waits; returns its error, or None if it succeeds."""
        try:
            store()
        except BaseException as failure:  # noqa: BLE001  # `_record` raises it
            return failure
        return None

    def _start_storing(self) -> None:
        """Starts storing the buffered rows, once all earlier ones are stored."""
        self.wait()
        self._empty_buffers()
        self._drop_old_ticks()
        if self._new_members or not len(self._writer):  # rows follow the models of their entities
            return
        self._has_dropped_old = False
        if self._store.is_in_place:
            self._writer.store()
            self._drop_old_ticks()
        else:
            self._writer.start()

    def _empty_buffers(self) -> None:
        """Moves the buffered rows to a batch of the writer."""
        self.flush_at = None
        self._write_pending()
        if self._buffers["ticks"].count:
            with self.read_lock:
                self._writer.put({table: buffer.take() for table, buffer in self._buffers.items()})

    def _set_flush_time(self) -> None:
        """Sets the time at which the rows are stored that came into empty buffers."""
        if self._flush_every is None or self.flush_at is not None:
            return
        is_first = len(self.ticks) == 1
        self.flush_at = monotonic() + (0.0 if is_first else self._flush_every / 2)
        background_writer.start_watching(self)

    def _flush_if_due(self) -> None:
        """Starts storing the buffered rows if it is time, unless earlier ones are being stored."""
        is_due = self.flush_at is not None and monotonic() >= self.flush_at
        if is_due and not self._writer.is_busy and not self._new_members:
            self._empty_buffers()
            self._has_dropped_old = False
            self._writer.start()

    def try_to_flush(self) -> bool:
        """Does the same without the world, which stands still; returns whether that was possible.

        It was not if the recorder is in use.
        """
        if not self._lock.acquire(blocking=False):
            return False
        try:
            if self.flush_at is None:
                return True
            if not self.read_lock.acquire(blocking=False):
                return False
            try:
                self._flush_if_due()
            finally:
                self.read_lock.release()
            return self.flush_at is None
        finally:
            self._lock.release()

    def stop_flushing(self) -> None:
        """Stores no more rows unless asked to."""
        with self._lock:
            self._flush_every = self.flush_at = None

    def wait(self) -> None:
        """Waits until no rows are being stored in the background."""
        self._writer.wait()

    def flush(self) -> None:
        """Stores the buffered rows, and drops ticks that are too old."""
        with ctrl_c.deferred(), self._lock:  # no row may be lost or stored twice
            self.wait()
            error = self._writer.pop_failure()
            if len(self._writer):  # the batches are stored below, or that fails again
                error = None
            self._store_new_members()
            self._empty_buffers()
            self._has_dropped_old = False
            self._writer.store()
            self._drop_old_ticks()
            if error is not None:
                raise error

    def finish(self) -> None:
        """Stores the buffered rows, and marks the record as complete."""
        with ctrl_c.deferred(), self._lock:
            self._writer.wait(is_final=True)
            self.flush()
            self._store.complete()
            self._store.finish()

    def _drop_old_ticks(self) -> None:
        """Drops ticks that are too old, once after rows were stored; the writer must be idle."""
        if self._has_dropped_old:
            return
        self._has_dropped_old = True
        oldest = self._first_tick_to_keep()
        if oldest is not None:
            self.ticks.drop_before(self._store.drop_before(oldest))

    def fetch(self, table: str, first: int, last: int) -> pa.Table:
        """Returns the rows of a table at the ticks from first to last, buffered ones included.

        The caller holds the world.
        """
        self.settle()
        with self.read_lock:
            stored = self._archive.fetch(table, first, last)
            waiting = self._writer.batches[table].arrow
            start, end = np.searchsorted(waiting["tick"].to_numpy(), [first, last + 1]).tolist()
            rows = [
                waiting.slice(start, end - start),
                self._buffers[table].rows_between(first, last),
            ]
            return pa.concat_tables([stored, conformed(pa.concat_tables(rows), stored.schema)])

    def near_pairs(self, request: PairRequest) -> pa.Table:
        """Returns the pairs of entities whose boxes are near at some ticks, with their poses.

        The caller holds the world.
        """
        self.settle()
        with self.read_lock:
            parts = self._writer.batches["entities"].arrow, self._buffers["entities"].rows()
            return self._archive.near_pairs(request, pa.concat_tables(parts))

    @property
    def _archive(self) -> TickArchive:
        if not isinstance(self._store, TickArchive):
            raise RecordError("a folder that is being recorded is read by opening it")
        return self._store

    def _is_storing_due(self, time: float) -> bool:
        """Checks whether the buffered ticks are enough, or a quarter of what is retained."""
        buffered = self._buffers["ticks"].count + len(self._pending)
        if not buffered:
            return False
        if buffered >= min(self._max_ticks, self._most_buffered):
            return True
        size = 0.0
        if not self._pending:
            stored = sum(buffer.count * buffer.row_bytes for buffer in self._buffers.values())
            size = stored * (1 + self._most_pending / buffered)
        seconds = time - float(self.ticks.times[-buffered])
        return quarters_of(self.recording, buffered, seconds, size) >= 1.0

    def _first_tick_to_keep(self) -> int | None:
        """Returns the first tick to keep; None if all are kept."""
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

    def _recorded_rows(self, snapshot: Snapshot) -> RecordedRows:
        """Returns what makes the rows of a tick, and notes its new entities."""
        rows = RecordedRows(snapshot, self._store.tables, self.recording.entities)
        masses = snapshot.masses
        new = [
            member.with_masses(masses.get(member.id, member.masses))
            for member in rows.members
            if member.id not in self.members
        ]
        self._new_members += new
        self._snapshot = snapshot
        self.members |= {member.id: member for member in new}
        return rows

    def _store_new_members(self) -> None:
        """Stores the models of new entities, before any row of theirs."""
        if self._new_members:
            assert self._snapshot is not None
            self.wait()
            self._store.add_members(self._new_members, self._snapshot)
            self._new_members = []
