"""The one door to DuckDB: worlds as schemas, statements, and the tick that they run on.

A `Database` is a `Connection` on which statements run, and the `WorldRegistry` that they are about,
each a schema of views that look into its buffers. Nothing outside this folder imports `duckdb`.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pyarrow as pa

from ssduck.database.connection import Connection, Parameters
from ssduck.database.functions import add_own, add_users, converter_of
from ssduck.database.recorders import Recorders, check_runs
from ssduck.database.referenced_tables import ReferencedTables, check_length, tells_past_masses
from ssduck.database.schemas import Schemas
from ssduck.database.statement import PreparedPlans, Statement
from ssduck.database.values import Converter
from ssduck.database.worlds import WorldRegistry
from ssduck.errors import EvaluationError
from ssduck.language.builtins import Function
from ssduck.limits import Limits
from ssduck.recording.export import exported
from ssduck.recording.recorder import Recorder
from ssduck.recording.replay.record import Record
from ssduck.recording.spec import Recording, check_names
from ssduck.recording.stores.parquet import ParquetRecording
from ssduck.sql.types import Signature, SqlType
from ssduck.world.world import World

__all__ = ["Database", "Statement"]


class Database:
    """A DuckDB connection with worlds in it.

    Args:
        path: a DuckDB file, or `":memory:"`.
        tracer: is told each statement before it runs.
        limits: what SQL may use.
        recording: what is kept of each world's ticks; None for nothing.

    Attributes:
        connection: where the translator's statements run.
        plans: of prepared statements.
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
        self._asked = ReferencedTables()
        self.plans = PreparedPlans(self.connection, self._asked.for_good)
        self._schemas = Schemas(self.connection)
        self._recorders = Recorders(self.connection, running)
        self._worlds = WorldRegistry(
            self.connection, self.plans, self._schemas, self._recorders, recording
        )
        if self.connection.is_file:
            self._schemas.forget_lost()
        add_own(self.connection, self._worlds.by_schema)
        self.connection.confine()

    def close(self) -> None:
        """Close the connection; a file keeps no views or macros on worlds that are gone.

        Raises:
            SqlError: what waits cannot be stored, for the disk is full, say; it is closed then.
        """
        with self._lock:
            if not self.connection.is_open:
                return
            try:
                for bound in self._worlds.bound:
                    kept = bound.kept
                    self._recorders.stop(bound)
                    for schema in bound.schemas:
                        self._schemas.leave(schema, kept)
            finally:
                self.connection.close()

    # -- statements -----------------------------------------------------------------------

    def table(self, sql: str, parameters: Parameters) -> pa.Table:
        """All rows of a statement that a user wrote; the tables that its text names are asked for.

        Raises:
            LimitError: it takes more than it may.
            SqlError: DuckDB cannot run it.
        """
        if self.connection.meter.limits.seconds is not None:
            check_length(sql)
        tables = self._asked.tables(sql)
        with self.held(tables, self._asked.worlds(sql, self._worlds.bound)):
            schemas = list(self._worlds.by_schema)
            only = schemas[0] if len(self.worlds) == 1 else None
            self._schemas.describe(schemas, only, self.records)
            self._schemas.make_formulas(sql, schemas)
            if tells_past_masses(sql):
                for bound in self._worlds.bound:
                    if bound.kept is not None and bound.reference() is not None:
                        bound.kept.record.warn_of_masses()
            return self.connection.table(sql, parameters)

    @contextmanager
    def held(
        self,
        tables: set[str] | frozenset[str] = frozenset(),
        worlds: Collection[World] | None = None,
    ) -> Iterator[None]:
        """Hold all worlds at their tick while statements run.

        Args:
            tables: those that are read, of the simulators if need be.
            worlds: of which worlds; None for all.
        """
        with ExitStack() as stack:
            stack.enter_context(self._lock)
            # In one order in all databases, so that no two wait for each other.
            there = [
                (world, bound)
                for bound in self._worlds.bound
                if (world := bound.reference()) is not None
            ]
            for world, _ in sorted(there, key=lambda each: each[0].serial):
                asked = worlds is None or any(world is other for other in worlds)
                stack.enter_context(world.held(tables if asked else ()))
            for _, bound in there:
                if bound.kept is not None and bound.kept.recorder is not None:
                    stack.enter_context(bound.kept.recorder.reading)
                self._worlds.show(bound)
            yield

    def add_function(self, signature: Signature, function: Function) -> None:
        """Make a user's function one of SQL; replaces one of that signature."""
        add_users(self.connection, signature, function, self._worlds.by_schema)

    def converter(self, tag: SqlType) -> Converter | None:
        """What makes values of a type of those that SQL gives back; None if they are."""
        return converter_of(tag, self._worlds.by_schema)

    # -- worlds ---------------------------------------------------------------------------

    def bind(self, name: str, world: World) -> None:
        """Make the schema of that name that of a world's tables; it may have several.

        Raises:
            ArgumentError: DuckDB has a schema or a database of that name, or another world has
                one that differs in case only, which DuckDB does not tell apart.
        """
        with self._lock:
            self._worlds.bind(name, world)

    def sweep(self) -> bool:
        """Let go of worlds that nobody else has any more; tells whether there were some.

        No statement is running, and no plan is used after that.
        """
        with self._lock:
            return self._worlds.sweep()

    def schema_of(self, world: World) -> str:
        """The schema of a world's tables; one is made for a world that has none here."""
        with self._lock:
            return self._worlds.schema_of(world)

    @property
    def worlds(self) -> dict[str, World]:
        """The worlds by the schema that ssduck's own statements use, the first one first."""
        return {
            bound.schemas[0]: world
            for bound in self._worlds.bound
            if bound.schemas and (world := bound.reference()) is not None
        }

    @property
    def records(self) -> dict[str, Record]:
        """What is kept of those that are recorded, by the same."""
        return {
            bound.schemas[0]: bound.kept.record
            for bound in self._worlds.bound
            if bound.schemas and bound.kept is not None and bound.reference() is not None
        }

    # -- what is kept -----------------------------------------------------------------------

    def record(self, world: World, recording: Recording | None) -> None:
        """Keep the ticks of a world from now on, in a history of their own; None keeps none.

        What was kept before is dropped, unless it is in a file.
        """
        with self._lock:
            bound = self._worlds.entry(world)
            check_runs(world)
            if recording is not None:
                check_names(recording, world.snapshot.members)
            self._worlds.record(bound, recording)

    def record_to(self, world: World, recording: Recording, path: Path) -> ParquetRecording:
        """Write the ticks of a world to a folder from now on, too."""
        with self._lock:
            check_runs(world)
            check_names(recording, world.snapshot.members)
            return self._recorders.to_folder(world, recording, path, self.schema_of(world))

    def record_of(self, world: World) -> Record:
        """What is kept of a world.

        Raises:
            EvaluationError: nothing is.
        """
        with self._lock:
            kept = self._worlds.entry(world).kept
            if kept is None:
                raise EvaluationError(
                    f"the ticks of {world.name!r} are not recorded; record(…) lets them be"
                )
            return kept.record

    def keeps(self, world: World) -> bool:
        """Whether the ticks of a world are recorded."""
        return self._worlds.entry(world).kept is not None

    def export(
        self,
        world: World,
        path: Path,
        names: tuple[str, ...] | None,
        between: tuple[float | None, float | None],
    ) -> Path:
        """Write what is kept of a world as a new episode in a folder; gives that of its ticks.

        Raises:
            RecordError: the folder has something else in it, or cannot be written.
            EvaluationError: nothing is kept of it, or nothing of that time.
        """
        record = self.record_of(world)
        with self._lock, world.held():
            kept = self._worlds.entry(world).kept
            assert kept is not None
            recording = kept.history.recording
            return exported(record, recording, self.schema_of(world), path, names, between)

    def flush(self) -> dict[str, int]:
        """Store what waits; tells up to which tick of each world, by its schema."""
        with self._lock:
            found = {}
            for bound in self._worlds.bound:
                world = bound.reference()
                recorder = bound.kept.recorder if bound.kept is not None else None
                if world is not None and recorder is not None and bound.schemas:
                    with world.held():
                        recorder.flush()
                        numbers = recorder.ticks.numbers
                        found[bound.schemas[0]] = int(numbers[-1])
            return found
