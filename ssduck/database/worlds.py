"""The worlds in a database: which there are, under which names, and showing DuckDB their rows."""

from __future__ import annotations

import weakref
from contextlib import suppress
from itertools import chain, count

from sqlglot import exp

from ssduck.database.binding import BoundWorld, WorldRecording
from ssduck.database.connection import Connection
from ssduck.database.recorders import Recorders
from ssduck.database.schemas import Schemas
from ssduck.database.statement import PreparedPlans
from ssduck.errors import ArgumentError
from ssduck.recording.replay.replayed_world import ReplayedWorld
from ssduck.recording.spec import Recording
from ssduck.recording.stores.model_tables import ABOUT
from ssduck.world.world import UNNAMED, World

# Schemas that DuckDB has already.
_TAKEN = frozenset(("main", "temp", "system", "pg_catalog", "information_schema"))


class WorldRegistry:
    """The worlds in a database.

    Args:
        connection: to that.
        plans: of prepared statements, which read the worlds' buffers.
        schemas: where their tables are.
        recorders: keep their ticks,
        recording: so, from when they are first seen on; None for not at all.

    Attributes:
        bound: the worlds; the first one's tables go without its name. One that a program made is
            here while somebody else has it (`sweep`), one with a name of the user's for good.
        by_schema: the same by all names of theirs.
    """

    def __init__(
        self,
        connection: Connection,
        plans: PreparedPlans,
        schemas: Schemas,
        recorders: Recorders,
        recording: Recording | None,
    ) -> None:
        self._connection = connection
        self._plans = plans
        self._schemas = schemas
        self._recorders = recorders
        self._recording = recording
        self.bound: list[BoundWorld] = []
        self.by_schema: dict[str, BoundWorld] = {}
        self._numbers = count(1)

    def bind(self, name: str, world: World) -> None:
        """Make the schema of that name that of a world's tables; it may have several.

        Raises:
            ArgumentError: DuckDB has a schema or a database of that name, or another world has
                one that differs in case only, which DuckDB does not tell apart.
        """
        self._check_schema(name)
        self._unbind(name, world)
        if world.name == UNNAMED:
            world.name = name
        bound = self.entry(world, name)
        bound.held = world
        self._name(bound, name)

    def _name(self, bound: BoundWorld, name: str) -> None:
        """Make the schema of that name that of a world's tables."""
        if name not in bound.schemas:
            bound.schemas.append(name)
            self._schemas.make(name, bound)
            self._plans.forget("entities")
        self._renamed()

    def _renamed(self) -> None:
        """Note which names the worlds have."""
        self._set_search_path()
        names = {schema: bound for bound in self.bound for schema in bound.schemas}
        self.by_schema.clear()
        self.by_schema.update(names)

    def _unbind(self, name: str, world: World) -> None:
        """Take a name from another world; one without a name is not held any more."""
        for other in [bound for bound in self.bound if name in bound.schemas]:
            if other.reference() is world:
                continue
            other.schemas.remove(name)
            if not other.schemas:
                self.bound.remove(other)
                self._recorders.stop(other)
                for shown in other.versions:
                    self._connection.unshow(shown)

    def sweep(self) -> bool:
        """Let go of worlds that nobody else has any more; tells whether there were some."""
        gone = [bound for bound in self.bound if bound.reference() is None]
        for bound in gone:
            self.bound.remove(bound)
            kept = bound.kept
            self._recorders.stop(bound)
            for schema in bound.schemas:
                self._schemas.drop(schema, kept)
            for shown in bound.versions:
                self._connection.unshow(shown)
        if gone:
            self._plans.forget("entities")
            self._renamed()
        return bool(gone)

    def _check_schema(self, name: str) -> None:
        """Complain of a name that a world cannot have.

        Raises:
            ArgumentError: DuckDB has a schema or database of that name, or another world has one
                that differs in case only.
        """
        ((database,),) = self._connection.own_rows("SELECT current_database()")
        if name.casefold() in _TAKEN or name.casefold() == database.casefold():
            raise ArgumentError(
                f"a world cannot be called {name!r}: DuckDB has a schema or database of that name"
            )
        runs = "SELECT schema_name FROM duckdb_tables() WHERE table_name = ?"
        taken = self._connection.own_rows(runs, [ABOUT])
        if name.casefold() in {schema.casefold() for (schema,) in taken}:
            raise ArgumentError(
                f"a world cannot be called {name!r}: a recorded run is called so in SQL"
            )
        for other in self.bound:
            for schema in other.schemas:
                if schema != name and schema.casefold() == name.casefold():
                    raise ArgumentError(
                        f"a world cannot be called {name!r}: there is {schema!r}, "
                        "and SQL does not tell upper from lower case"
                    )

    def _set_search_path(self) -> None:
        """The first world's tables go without its name."""
        first = next((bound.schemas[0] for bound in self.bound if bound.schemas), None)
        if first is not None:
            name = exp.to_identifier(first, quoted=True).sql("duckdb")
            path = exp.Literal.string(f"main,{name}").sql("duckdb")
            self._connection.run(f"SET search_path = {path}")

    def entry(self, world: World, name: str | None = None) -> BoundWorld:
        """What is known of a world; its ticks are recorded under the name that it gets first."""
        for bound in self.bound:
            if bound.reference() is world:
                return bound
        bound = BoundWorld(weakref.ref(world), f"world {next(self._numbers)}")
        self.bound.append(bound)
        try:
            if isinstance(world, ReplayedWorld):
                bound.kept = WorldRecording(world.archive, world.own_record)
            if self._recording is not None and not world.is_final:
                self._recorders.start(bound, self._recording, name or world.name)
            self.show(bound)
        except BaseException:
            self.bound.remove(bound)
            raise
        return bound

    def record(self, bound: BoundWorld, recording: Recording | None) -> None:
        """Keep the ticks of a world in a new history, and none in that before; None keeps none."""
        with bound.world.held():
            self._recorders.stop(bound)
        if recording is not None:
            self._recorders.start(bound, recording, bound.schemas[0])
        self.show(bound)
        for schema in bound.schemas:
            self._schemas.make_history(schema, bound)
        self._plans.forget("entities")

    def schema_of(self, world: World) -> str:
        """The schema of a world's tables; one is made for a world that has none here."""
        bound = self.entry(world)
        if not bound.schemas:
            self._name(bound, self._free_name(world.name))
        return bound.schemas[0]

    def _free_name(self, wanted: str) -> str:
        """A name that no world has, and a world can have."""
        taken = {schema for other in self.bound for schema in other.schemas}
        for name in chain((wanted,), (f"{wanted}_{number}" for number in count(2))):
            with suppress(ArgumentError):
                self._check_schema(name)
                if name not in taken:
                    return name
        raise AssertionError(wanted)

    def show(self, bound: BoundWorld) -> None:
        """Let DuckDB see the buffers that were made anew; the others it sees already."""
        new = [
            entry for entry in bound.buffers() if bound.versions.get(entry[1]) != entry[2].version
        ]
        stale = {table for table, name, _ in new if name in bound.versions}
        if bound.margins != bound.planned_margins:  # DuckDB takes them for constants
            stale.add("entities")
            bound.planned_margins = bound.margins
        if stale:
            self._plans.forget(*stale)
        for _, name, rows in new:
            self._connection.show(name, rows.arrow)
            bound.versions[name] = rows.version
