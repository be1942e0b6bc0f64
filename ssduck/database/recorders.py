"""Records the ticks of the worlds in a database, in histories or in folders."""

from __future__ import annotations

from itertools import count
from pathlib import Path

from ssduck.database.binding import BoundWorld, WorldHistory
from ssduck.database.connection import Connection
from ssduck.errors import UnsupportedError
from ssduck.recording.episode import Tags
from ssduck.recording.folder_recording import ParquetRecording
from ssduck.recording.recorder import BUFFERED_TICKS, MEMORY_TICKS, Recorder
from ssduck.recording.replay.record import Record
from ssduck.recording.replay.replayed_world import ReplayedWorld
from ssduck.recording.spec import Recording, check_names, with_size_limit
from ssduck.recording.stores.duckdb import DuckDBStore
from ssduck.recording.stores.memory import MemoryStore
from ssduck.recording.stores.model_tables import RUN_SCHEMA
from ssduck.recording.stores.parquet import PART_TICKS
from ssduck.world import ctrl_c
from ssduck.world.world import World


class Recorders:
    """The running recorders of a database.

    Args:
        connection: the connection to the database of the histories.
        running: the recorders; their waiting ticks are stored at the end.
    """

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
            world.add_recorder(recorder)
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
            world.remove_recorder(recorder)
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
