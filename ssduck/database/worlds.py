"""The worlds in a database: their names, their rows, their pinning and recording."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import chain, count
from pathlib import Path

from sqlglot import exp

from ssduck import validation
from ssduck.database.binding import BoundWorld, WorldHistory
from ssduck.database.connection import Connection
from ssduck.database.plans import PreparedPlans
from ssduck.database.schemas import Schemas, register_rows
from ssduck.database.statement_names import ReadData
from ssduck.errors import ArgumentError, UnsupportedError
from ssduck.recording.episode import Tags
from ssduck.recording.folder_recording import ParquetRecording
from ssduck.recording.recorder import BUFFERED_TICKS, MEMORY_TICKS, Recorder
from ssduck.recording.replay.record import Record
from ssduck.recording.replay.replayed_world import ReplayedWorld
from ssduck.recording.spec import Recording, check_names, with_size_limit
from ssduck.recording.stores.duckdb import DuckDBStore
from ssduck.recording.stores.memory import MemoryStore
from ssduck.recording.stores.model_tables import ABOUT, RUN_SCHEMA
from ssduck.recording.stores.parquet import PART_TICKS
from ssduck.world import ctrl_c
from ssduck.world.batches.batch_world import BatchWorld
from ssduck.world.observers import EpisodeObserver
from ssduck.world.snapshot import Snapshot
from ssduck.world.ticking import UNNAMED
from ssduck.world.world import World


class Recorders:
    """The running recorders of a database."""

    def __init__(self, connection: Connection, running: list[Recorder]) -> None:
        self._connection = connection
        self.running = running
        self._folders: list[ParquetRecording] = []

    def start(
        self, bound: BoundWorld, recording: Recording, name: str, tags: Tags | None = None
    ) -> None:
        """Starts to record the ticks of a world in a history that is named after `name`."""
        world, is_file = bound.world, self._connection.is_file
        check_names(recording, world.snapshot.entities)
        in_memory = not is_file and not recording.changed
        recording = with_size_limit(recording, in_memory=not is_file)
        schema, connection = self._free_schema(name), self._connection.writer()
        store: MemoryStore | DuckDBStore
        if in_memory:
            store = MemoryStore(schema, connection, recording, name)
        else:
            store = DuckDBStore(
                schema,
                connection,
                recording,
                name,
                tags=tags,
                camera=world.camera,
                order=bound.number,
            )
            if is_file:
                store.create_views()
        # In a file, few ticks may wait: a killed process loses them.
        ticks = MEMORY_TICKS if in_memory else BUFFERED_TICKS
        flush_every = recording.flush_every if is_file else None
        recorder = Recorder(recording, store, ticks, flush_every)
        tables = tuple(recorder.buffers)
        record = Record(
            world,
            recorder.ticks,
            recorder.members,
            tables,
            recorder.fetch,
            recorder.near_pairs,
            mass_changes=recorder.mass_changes,
            recording=recording,
            tags=tags,
            entities=recording.entities,
        )
        bound.history = WorldHistory(
            store, record, recorder, (*store.visible_rows, *recorder.visible_rows)
        )
        self.running.append(recorder)
        try:
            world.ticker.add_recorder(recorder)
        except BaseException:
            self._forget(bound, recorder)
            raise

    def _free_schema(self, world: str) -> str:
        rows = self._connection.internal_rows("SELECT schema_name FROM duckdb_schemas()")
        used = {name.casefold() for (name,) in rows}
        names = (f"{world}{RUN_SCHEMA}{number}" for number in count())
        return next(name for name in names if name.casefold() not in used)

    def stop(self, bound: BoundWorld) -> None:
        """Stops recording the ticks of a world in its history, and stores the waiting ticks."""
        if bound.history is None:
            return
        with ctrl_c.deferred():
            self._stop(bound, bound.history)

    def _stop(self, bound: BoundWorld, history: WorldHistory) -> None:
        is_file = self._connection.is_file
        if is_file and history.recorder is not None and bound.reference() is not None:
            history.record.warn_of_masses()
        history.record.is_closed = True
        if history.recorder is None:
            bound.history = None
            history.store.close(forget=False)
            return
        if is_file:
            history.recorder.finish()
        history.recorder.wait()
        waiting = [name for table in history.recorder.buffers for name in bound.buffer_views(table)]
        self._forget(bound, history.recorder)
        history.store.close(forget=not is_file)
        for name in waiting:
            if bound.versions.pop(name, None) is not None:
                self._connection.unregister(name)

    def _forget(self, bound: BoundWorld, recorder: Recorder) -> None:
        """Removes a recorder without storing its waiting ticks."""
        recorder.stop_flushing()
        world = bound.reference()
        if world is not None:
            world.ticker.remove_recorder(recorder)
        self.running.remove(recorder)
        bound.history = None

    def to_folder(
        self,
        bound: BoundWorld,
        recording: Recording,
        path: Path,
        name: str,
        tags: Tags | None = None,
    ) -> ParquetRecording:
        """Starts to write the ticks of a world to a folder as well, under a name."""
        running = ParquetRecording(
            bound.world, recording, path, name, PART_TICKS, self.running, tags, bound.number
        )
        self._folders = [one for one in self._folders if one.is_running]
        self._folders.append(running)
        return running

    def begin_episodes(self, world: World) -> None:
        """Begins a new episode in each folder to which the ticks of a world are written."""
        for recording in self._folders:
            if recording.world is world and recording.is_running:
                recording.begin_episode()


def check_is_live(world: World) -> None:
    """Checks that a world is no record."""
    if isinstance(world, ReplayedWorld):
        raise UnsupportedError(
            f"{world.name!r} is itself a record, without new ticks; export(…) copies it"
        )


class WorldRegistry:
    """The worlds in a database.

    Attributes:
        bound: the worlds; the schema of the first may be omitted. A world that a program made is
            here while anything else refers to it (`sweep`), a world that the user named always.
        by_schema: the worlds by all their names.
        version: is incremented whenever a name gets another meaning.
        episode_observer: learns of new episodes of the worlds.
    """

    def __init__(
        self,
        connection: Connection,
        plans: PreparedPlans,
        schemas: Schemas,
        recorders: Recorders,
        by_schema: dict[str, BoundWorld],
        recording: Recording | None,
    ) -> None:
        self._connection = connection
        self._plans = plans
        self._schemas = schemas
        self._recorders = recorders
        self._recording = recording
        self.bound: list[BoundWorld] = []
        self.by_schema = by_schema
        self.version = 0
        self.episode_observer: EpisodeObserver | None = None
        self._numbers = count(1)
        # The references to worlds that are gone; a list, as a callback must not keep this object.
        self._gone: list[weakref.ref[World]] = []

    def bind(self, name: str, world: World) -> None:
        """Makes a schema of that name for a world's tables; a world may have several."""
        self._check_schema(name)
        self._unbind(name, world)
        if world.name == UNNAMED:
            world.name = name
        bound = self.entry(world, name)
        bound.named_world = world
        self._name(bound, name)

    def _name(self, bound: BoundWorld, name: str) -> None:
        """Makes a schema of that name for a world's tables."""
        if name not in bound.schemas:
            bound.schemas.append(name)
            self._schemas.make(name, bound)
            self._plans.forget()
        self._update_names()

    def _update_names(self) -> None:
        self.set_search_path()
        names = {schema: bound for bound in self.bound for schema in bound.schemas}
        self.by_schema.clear()
        self.by_schema.update(names)
        self.version += 1

    def _unbind(self, name: str, world: World) -> None:
        """Takes a name from another world; a world without names is dropped."""
        for other in [bound for bound in self.bound if name in bound.schemas]:
            if other.reference() is world:
                continue
            other.schemas.remove(name)
            if not other.schemas:
                self.bound.remove(other)
                self._recorders.stop(other)
                for view in other.versions:
                    self._connection.unregister(view)

    @property
    def has_unused(self) -> bool:
        """Whether `sweep` would drop a world."""
        return bool(self._gone)

    def sweep(self) -> bool:
        """Drops worlds to which nothing else refers; returns whether there were any."""
        self._gone.clear()
        unused = [bound for bound in self.bound if bound.reference() is None]
        for bound in unused:
            self.bound.remove(bound)
            history = bound.history
            self._recorders.stop(bound)
            for schema in bound.schemas:
                self._schemas.drop(schema, history)
            for view in bound.versions:
                self._connection.unregister(view)
        if unused:
            self._plans.forget()
            self._update_names()
        return bool(unused)

    def _check_schema(self, name: str) -> None:
        validation.world_name(name)
        run_schemas: Sequence[tuple[str]] = ()
        if self._connection.has_records and RUN_SCHEMA in name.casefold():
            runs = "SELECT schema_name FROM duckdb_tables() WHERE table_name = ?"
            run_schemas = self._connection.internal_rows(runs, [ABOUT])
        if name.casefold() in {schema.casefold() for (schema,) in run_schemas}:
            raise ArgumentError(
                f"a world cannot have the name {name!r}: a recorded run has it in SQL"
            )
        for other in self.bound:
            for schema in other.schemas:
                if schema != name and schema.casefold() == name.casefold():
                    raise ArgumentError(
                        f"a world cannot have the name {name!r}: there is {schema!r}, "
                        "and SQL ignores case"
                    )

    def set_search_path(self) -> None:
        """Lets the schema of the first world be omitted."""
        first = next((bound.schemas[0] for bound in self.bound if bound.schemas), None)
        if first is not None:
            name = exp.to_identifier(first, quoted=True).sql("duckdb")
            path = exp.Literal.string(f"main,{name}").sql("duckdb")
            self._connection.run(f"SET search_path = {path}")

    def entry(self, world: World, name: str | None = None) -> BoundWorld:
        """Returns the entry of a world, whose first name becomes that of its history."""
        for bound in self.bound:
            if bound.reference() is world:
                return bound
        bound = BoundWorld(weakref.ref(world, self._gone.append), next(self._numbers))
        self.bound.append(bound)
        if self.episode_observer is not None:
            world.observers.follow_episodes(self.episode_observer)
        try:
            if isinstance(world, ReplayedWorld) and world.past is not None:
                archive, record = world.past
                bound.history = WorldHistory(archive, record, visible_rows=archive.visible_rows)
            if self._recording is not None and not world.is_final:
                self._recorders.start(bound, self._recording, name or world.name)
            self.register(bound)
        except BaseException:
            self.bound.remove(bound)
            raise
        return bound

    @property
    def named(self) -> dict[str, World]:
        """The worlds, by the schema that ssduck's own statements use, the first one first."""
        return {
            bound.schemas[0]: world
            for bound in self.bound
            if bound.schemas and (world := bound.reference()) is not None
        }

    @property
    def records(self) -> dict[str, Record]:
        """The records of the recorded worlds, by the same schemas."""
        return {
            bound.schemas[0]: bound.history.record
            for bound in self.bound
            if bound.schemas and bound.history is not None and bound.reference() is not None
        }

    @property
    def has_batches(self) -> bool:
        """Whether any of the worlds is a batch."""
        return any(isinstance(bound.reference(), BatchWorld) for bound in self.bound)

    def single_worlds(self) -> list[int]:
        """Returns the serial numbers of the worlds that are no batches."""
        worlds = (bound.reference() for bound in self.bound)
        return [w.serial for w in worlds if w is not None and not isinstance(w, BatchWorld)]

    def settle(self, are_rows_unwritten: bool = True) -> None:
        """Writes what recorders, and perhaps ticks, left for later, for DuckDB to read."""
        for bound in self.bound:
            bound.settle_history()
        if are_rows_unwritten:
            self.write_rows()

    def write_rows(self) -> None:
        """Writes the rows of the ticks; a plan that reads buffers ends where they are replaced."""
        for bound, snapshot in self._snapshots():
            snapshot.settle()
            self.register(bound)

    def _snapshots(self) -> Iterator[tuple[BoundWorld, Snapshot]]:
        """Yields the worlds whose tables have a tick, each with its snapshot."""
        for bound in self.bound:
            world = bound.reference()
            if world is not None and world.ticker.is_restored:
                yield bound, world.snapshot

    def record(
        self, bound: BoundWorld, recording: Recording | None, tags: Tags | None = None
    ) -> None:
        """Records the ticks of a world in a new history from now on; None for no recording."""
        with bound.world.pinned():
            self._recorders.stop(bound)
        if recording is not None:
            self._recorders.start(bound, recording, bound.schemas[0], tags)
        self.register(bound)
        for schema in bound.schemas:
            self._schemas.make_history(schema, bound)
        self._plans.forget()

    def schema_of(self, world: World) -> str:
        """Returns the schema of a world's tables; makes one if the world has none here."""
        bound = self.entry(world)
        if not bound.schemas:
            self._name(bound, self._free_name(world.name))
        return bound.schemas[0]

    def _free_name(self, preferred: str) -> str:
        """Returns a name that no world has, and a world can have."""
        used = {schema for other in self.bound for schema in other.schemas}
        for name in chain((preferred,), (f"{preferred}_{number}" for number in count(2))):
            with suppress(ArgumentError):
                self._check_schema(name)
                if name not in used:
                    return name
        raise AssertionError(preferred)

    def register(self, bound: BoundWorld) -> None:
        """Registers replaced buffers with DuckDB, of those that views read already.

        It may be interrupted: what was not registered then is at the next time.
        """
        state = bound.state()
        if state == bound.registered:
            return
        margins = bound.margins
        has_margins = margins == bound.planned_margins  # DuckDB treats them as constants
        if not has_margins:
            self._plans.forget()
        bound.planned_margins = margins
        for name, rows in bound.buffers():
            version = bound.versions.get(name)
            if version is not None and (version != rows.version or not has_margins):
                register_rows(self._connection, bound, name, rows)
        bound.registered = state


@contextmanager
def pinned_worlds(
    lock: threading.RLock, registry: WorldRegistry, reads: ReadData, *, is_settled: bool = True
) -> Iterator[None]:
    """Pins worlds at their tick, with their rows registered, while statements run.

    Args:
        lock: the lock of the database.
        registry: the worlds of the database.
        reads: the tables to read, from the simulators if need be, and of which worlds.
        is_settled: whether all columns are written, as DuckDB needs them.
    """
    ends: list[Callable[[], object]] = []
    with lock:
        present = [
            (world, bound) for bound in registry.bound if (world := bound.reference()) is not None
        ]
        if len(present) > 1:  # in the same order in all databases, so that there is no deadlock
            present.sort(key=lambda item: item[0].serial)
        try:
            for world, _ in present:
                is_read = reads.worlds is None or world.serial in reads.worlds
                tables = reads.tables if is_read else ()
                world.ticker.pin(tables, is_read=is_read, is_settled=is_settled)
                ends.append(world.ticker.unpin)
            for _, bound in present:
                history = bound.history
                if history is not None and history.recorder is not None:
                    if is_settled:
                        bound.settle_history()
                    history.recorder.read_lock.acquire()
                    ends.append(history.recorder.read_lock.release)
                registry.register(bound)
            yield
        finally:
            while ends:
                ends.pop()()
