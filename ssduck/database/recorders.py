"""Keeping the ticks of the worlds in a database, in histories of theirs or in folders."""

from __future__ import annotations

from itertools import count
from pathlib import Path

from ssduck.database.binding import BoundWorld, WorldRecording
from ssduck.database.connection import Connection
from ssduck.errors import UnsupportedError
from ssduck.recording.recorder import MEMORY_TICKS, RING_TICKS, Recorder
from ssduck.recording.replay.record import Record
from ssduck.recording.replay.replayed_world import ReplayedWorld
from ssduck.recording.spec import Recording, check_names
from ssduck.recording.stores.duckdb import DuckDBStore
from ssduck.recording.stores.memory import MemoryStore
from ssduck.recording.stores.parquet import PART_TICKS, ParquetRecording, ParquetStore
from ssduck.world.world import World


class Recorders:
    """Those that keep ticks at present.

    Args:
        connection: to the database that has the histories.
        running: the recorders; what waits in them is stored at the end.
    """

    def __init__(self, connection: Connection, running: list[Recorder]) -> None:
        self._connection = connection
        self.running = running

    def start(self, bound: BoundWorld, recording: Recording, name: str) -> None:
        """Keep the ticks of a world in a history, called after such a name."""
        world, is_file = bound.world, self._connection.is_file
        check_names(recording, world.snapshot.members)
        in_memory = not is_file and not recording.changed
        schema, connection = self._free_schema(name), self._connection.writer()
        history: MemoryStore | DuckDBStore
        if in_memory:
            history = MemoryStore(schema, connection, recording, name)
        else:
            history = DuckDBStore(schema, connection, recording, name)
            if is_file:
                history.make_views()
        # Of a file, what waits is lost when the process is killed; of memory, all is.
        recorder = Recorder(recording, history, MEMORY_TICKS if in_memory else RING_TICKS)
        tables = tuple(recorder.buffers)
        record = Record(
            world,
            recorder.ticks,
            recorder.members,
            tables,
            recorder.fetch,
            recorder.near,
            reweighed=recorder.reweighed,
        )
        bound.kept = WorldRecording(
            history, record, recorder, (*history.visible_rows, *recorder.visible_rows)
        )
        self.running.append(recorder)
        try:
            world.record(recorder)
        except BaseException:
            self._forget(bound, recorder)
            raise

    def _free_schema(self, world: str) -> str:
        rows = self._connection.own_rows("SELECT schema_name FROM duckdb_schemas()")
        taken = {name.casefold() for (name,) in rows}
        names = (f"{world}_record_{number}" for number in count())
        return next(name for name in names if name.casefold() not in taken)

    def stop(self, bound: BoundWorld) -> None:
        """Keep no more ticks of a world in its history; what waits is stored."""
        if bound.kept is None:
            return
        kept, is_file = bound.kept, self._connection.is_file
        if is_file and kept.recorder is not None and bound.reference() is not None:
            kept.record.warn_of_masses()
        kept.record.is_closed = True
        if kept.recorder is None:
            bound.kept = None
            kept.history.close(forget=False)
            return
        if is_file:
            kept.recorder.flush()
        kept.recorder.wait()
        waiting = [name for table in kept.recorder.buffers for name in bound.waiting(table)]
        self._forget(bound, kept.recorder)
        kept.history.close(forget=not is_file)
        for name in waiting:
            if bound.versions.pop(name, None) is not None:
                self._connection.unshow(name)

    def _forget(self, bound: BoundWorld, recorder: Recorder) -> None:
        """Let a recorder keep no more ticks, without storing what waits."""
        world = bound.reference()
        if world is not None:
            world.forget(recorder)
        self.running.remove(recorder)
        bound.kept = None

    def to_folder(
        self, world: World, recording: Recording, path: Path, name: str
    ) -> ParquetRecording:
        """Write the ticks of a world to a folder, too, under such a name."""
        folder = ParquetStore(path, name, recording)
        recorder = Recorder(recording, folder, waits=PART_TICKS)
        self.running.append(recorder)
        try:
            world.record(recorder)
        except BaseException:
            world.forget(recorder)
            self.running.remove(recorder)
            folder.discard()
            raise
        return ParquetRecording(world, recorder, folder, self.running)


def check_runs(world: World) -> None:
    """Complain of a world that has no ticks to come."""
    if isinstance(world, ReplayedWorld):
        raise UnsupportedError(
            f"{world.name!r} is a record itself, with no ticks to come; export(…) copies it"
        )
