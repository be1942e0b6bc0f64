"""The one door to DuckDB: worlds as schemas, statements, and the tick that they run on.

A `Database` is a `Connection` on which statements run, and the `WorldRegistry` of the worlds that
they read. Each world is a schema of views on its buffers. Nothing outside this folder imports
`duckdb`.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Sequence
from collections.abc import Set as AbstractSet
from contextlib import AbstractContextManager
from pathlib import Path

import pyarrow as pa

from ssduck.database.binding import BoundWorld, WorldHistory
from ssduck.database.connection import Connection, Parameters
from ssduck.database.fetched_rows import FetchedRows
from ssduck.database.functions import (
    add_user_function,
    converter_of,
    offer_geometry_functions,
    offer_user_function,
    shape_functions,
)
from ssduck.database.plans import PreparedPlans
from ssduck.database.raw_sql import RawSql
from ssduck.database.schemas import Schemas, TickRanges
from ssduck.database.statement_names import ReadData
from ssduck.database.values import Converter
from ssduck.database.worlds import Recorders, WorldRegistry, check_is_live, pinned_worlds
from ssduck.errors import ArgumentError, EvaluationError
from ssduck.language.builtins import Function
from ssduck.limits import Limits
from ssduck.recording.episode import Tags
from ssduck.recording.folder_recording import ParquetRecording, export
from ssduck.recording.recorder import Recorder
from ssduck.recording.replay.record import Record
from ssduck.recording.spec import Recording, check_names, no_ticks_message
from ssduck.recording.stores.parquet import ParquetStore
from ssduck.schema import HISTORIES, TABLES
from ssduck.sql.types import Signature, SqlType
from ssduck.world import ctrl_c
from ssduck.world.observers import EpisodeObserver
from ssduck.world.world import World

# The names of a world's tables, which may be used without the name of the first world.
WORLD_TABLES = frozenset((*TABLES, *(table.history_view for table in HISTORIES.values())))


class Database:
    """A DuckDB connection and the worlds that are bound to it.

    Attributes:
        connection: the connection that runs the translator's statements.
        plans: the plans of prepared statements.
        raw_sql: what users' statements may read.
    """

    def __init__(
        self,
        path: str,
        tracer: Callable[[str], None] | None,
        limits: Limits | None = None,
        recording: Recording | None = None,
    ) -> None:
        running: list[Recorder] = []
        self.connection = Connection(path, tracer, limits or Limits(), running)
        self._lock = threading.RLock()
        # The tables that views and prepared statements of users read.
        persistent: set[str] = set()
        by_schema: dict[str, BoundWorld] = {}
        self.plans = PreparedPlans(self.connection, by_schema)
        self._schemas = Schemas(self.connection)
        if self.connection.is_file:
            self._schemas.drop_stale_views()
        self._recorders = Recorders(self.connection, running)
        self._worlds = WorldRegistry(
            self.connection, self.plans, self._schemas, self._recorders, by_schema, recording
        )
        self.raw_sql = RawSql(
            self.connection, self.plans, persistent, self._worlds, self._schemas, self._lock
        )
        # The names of the frames that users have registered.
        self._registered: set[str] = set()
        offer_geometry_functions(self.connection, self._worlds.by_schema)
        # Those that Python calls itself, where it computes what a statement would.
        self.shape_functions = shape_functions(self._worlds.by_schema)
        self.connection.apply_limits()

    def close(self) -> None:
        """Closes the connection; in a file, it drops the views and macros on live worlds."""
        with ctrl_c.deferred(), self._lock:  # views of a file are dropped, too
            if not self.connection.is_open:
                return
            try:
                for bound in self._worlds.bound:
                    history = bound.history
                    self._recorders.stop(bound)
                    for schema in bound.schemas if self.connection.is_file else ():
                        self._schemas.detach(schema, history)
            finally:
                self.connection.close()

    # -- statements -----------------------------------------------------------------------

    def user_rows(self, sql: str, parameters: Parameters) -> FetchedRows | pa.Table:
        """Returns all rows of a user's statement, for which the tables that it names are read."""
        with self._lock:
            return self.raw_sql.rows(sql, parameters)

    def pinned(
        self,
        tables: AbstractSet[str] = frozenset(),
        worlds: Collection[World] | None = None,
        *,
        is_settled: bool = True,
    ) -> AbstractContextManager[None]:
        """Pins all worlds at their tick while statements run.

        Args:
            tables: the tables to read, from the simulators if need be.
            worlds: the worlds whose tables are read; None for all.
            is_settled: whether all columns are written; without it, call `settle` before DuckDB
                reads them.
        """
        serials = None if worlds is None else [world.serial for world in worlds]
        reads = ReadData(tables, serials)
        return pinned_worlds(self._lock, self._worlds, reads, is_settled=is_settled)

    def settle(self) -> None:
        """Writes the rows of pinned worlds that were deferred, for DuckDB to read."""
        self._worlds.settle()

    def add_function(self, signature: Signature, function: Function) -> None:
        """Registers a user's function with SQL; replaces one of that signature."""
        self.raw_sql.statements.forget()
        add_user_function(self.connection, signature, function, self._worlds.by_schema)

    def offer_function(
        self, function: Function, parameters: Sequence[SqlType], result: SqlType
    ) -> None:
        """Lets raw SQL call a user's function by its name, unless SQL has one of that name."""
        self.withdraw_function(function.name)
        if all(sql_type.is_plain for sql_type in (*parameters, result)):
            offer_user_function(self.connection, function, parameters, result)

    def withdraw_function(self, name: str) -> None:
        """Takes back what `offer_function` gave to raw SQL."""
        self.raw_sql.statements.forget()
        self.connection.withdraw_function(name)

    def register(self, name: str, table: pa.Table) -> None:
        """Makes a table of Arrow a table of raw SQL; replaces an earlier one of that name."""
        with self._lock:
            known = name.lower() in (table.lower() for table in self._registered)
            if name.lower() in WORLD_TABLES or (not known and self._is_table(name)):
                raise ArgumentError(
                    f"register: there is a table {name!r} already; give the frame another name"
                )
            self.raw_sql.forget_names()
            self.connection.register(name, table)
            self._registered.add(name)

    def _is_table(self, name: str) -> bool:
        """Checks whether a user has made a table or a view of a name."""
        ((count,),) = self.connection.internal_rows(
            "SELECT count(*) FROM information_schema.tables WHERE lower(table_name) = lower(?) "
            "AND table_schema IN ('main', 'temp')",
            [name],
        )
        return bool(count)

    def converter(self, sql_type: SqlType) -> Converter | None:
        """Returns the function from values of SQL to Python's; None if they are the same."""
        return converter_of(sql_type, self._worlds.by_schema)

    # -- worlds ---------------------------------------------------------------------------

    def bind(self, name: str, world: World) -> None:
        """Makes a schema of that name for a world's tables; a world may have several."""
        with self._lock:
            self._worlds.bind(name, world)

    def sweep(self) -> bool:
        """Drops worlds to which nothing else refers; returns whether there were any.

        No statement may be running, and no plan may be used after that.
        """
        if not self._worlds.has_unused:
            return False
        with self._lock:
            return self._worlds.sweep()

    def schema_of(self, world: World) -> str:
        """Returns the schema of a world's tables; makes one if the world has none here."""
        with self._lock:
            return self._worlds.schema_of(world)

    def reading_ticks(self, ticks: TickRanges) -> AbstractContextManager[None]:
        """Has only the ticks of histories checked that a statement in the context reads."""
        return self._schemas.reading(self._worlds.by_schema, ticks)

    def bound_world(self, schema: str) -> BoundWorld:
        """Returns the world of a schema."""
        return self._worlds.by_schema[schema]

    @property
    def worlds(self) -> dict[str, World]:
        """The worlds, by the schema that ssduck's own statements use, the first one first."""
        return self._worlds.named

    @property
    def has_attached_world(self) -> bool:
        """Whether the simulation of one of the worlds is a client of the user's."""
        present = (bound.reference() for bound in self._worlds.bound)
        return any(world is not None and world.ticker.is_attached for world in present)

    @property
    def records(self) -> dict[str, Record]:
        """The records of the recorded worlds, by the same schemas."""
        return self._worlds.records

    # -- recording --------------------------------------------------------------------------

    def record(self, world: World, recording: Recording | None, tags: Tags | None = None) -> None:
        """Records the ticks of a world from now on in a history of its own; None for none.

        The history before is dropped, unless it is in a file.
        """
        with ctrl_c.deferred(), self._lock:  # the one recording ends, the other begins
            bound = self._worlds.entry(world)
            check_is_live(world)
            if recording is not None:
                check_names(recording, world.snapshot.entities)
            self._worlds.record(bound, recording, tags)

    def observe_episodes(self, observer: EpisodeObserver) -> None:
        """Lets an observer know of new episodes of the worlds that are bound from now on."""
        self._worlds.episode_observer = observer

    def begin_episode(self, world: World) -> None:
        """Records a world that was reset as before, in new records; ends the records before."""
        with ctrl_c.deferred(), self._lock:
            if not self.connection.is_open:
                return
            for bound in self._worlds.bound:
                history = bound.history
                if bound.reference() is world and history and history.recorder is not None:
                    self._worlds.record(bound, history.store.recording, history.record.tags)
            self._recorders.begin_episodes(world)

    def record_to(
        self, world: World, recording: Recording, path: Path, tags: Tags | None = None
    ) -> ParquetRecording:
        """Writes the ticks of a world to a folder, too, from now on."""
        with ctrl_c.deferred(), self._lock:
            check_is_live(world)
            check_names(recording, world.snapshot.entities)
            name = self.schema_of(world)
            bound = self._worlds.entry(world)
            return self._recorders.to_folder(bound, recording, path, name, tags)

    def history_of(self, world: World) -> WorldHistory | None:
        """Returns the recorded ticks of a world; None if it is not recorded."""
        with self._lock:
            return self._worlds.entry(world).history

    def record_of(self, world: World) -> Record:
        """Returns the record of a world."""
        with self._lock:
            history = self._worlds.entry(world).history
            if history is None:
                raise EvaluationError(no_ticks_message(world.name))
            return history.record

    def is_recorded(self, world: World) -> bool:
        """Checks whether the ticks of a world are recorded."""
        return self._worlds.entry(world).history is not None

    def export(
        self,
        world: World,
        path: Path,
        names: tuple[str, ...] | None,
        time_range: tuple[float | None, float | None],
        begun: list[ParquetStore],
        tags: Tags | None = None,
    ) -> Path:
        """Writes the record of a world to a folder as a new episode; returns its ticks' folder.

        The caller discards what has `begun` if anything fails, as in `whole_record`.
        """
        record = self.record_of(world)
        with self._lock, world.pinned():
            bound = self._worlds.entry(world)
            assert bound.history is not None
            recording = bound.history.store.recording
            name = self.schema_of(world)
            order = bound.number if record.order is None else record.order
            return export(record, recording, name, path, names, time_range, begun, tags, order)

    def flush(self) -> dict[str, int]:
        """Stores waiting ticks; returns the last tick of each world, by its schema."""
        with self._lock:
            last_ticks = {}
            for bound in self._worlds.bound:
                world = bound.reference()
                recorder = bound.history.recorder if bound.history is not None else None
                if world is not None and recorder is not None and bound.schemas:
                    with world.pinned():
                        recorder.flush()
                        numbers = recorder.ticks.numbers
                        last_ticks[bound.schemas[0]] = int(numbers[-1])
            return last_ticks
