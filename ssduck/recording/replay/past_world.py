"""Restores a world as it was at a recorded tick."""

from __future__ import annotations

from collections.abc import Iterable

from ssduck.formatting import past_path, past_query
from ssduck.geometry.queries import ShapeQueries
from ssduck.schema import ON_DEMAND, TABLES
from ssduck.simulators.interface import Simulator
from ssduck.simulators.partial import StaticSimulator
from ssduck.world.entities import Entity
from ssduck.world.handles import RecordedTick
from ssduck.world.snapshot import Snapshot
from ssduck.world.world import World

# Tables that are read from the static simulator; the others are copied from the record.
_READ = frozenset(name for name in ON_DEMAND if TABLES[name].key)
_ENTITY_DOUBLES = TABLES["entities"].tick_columns.doubles


class PastWorld(World):
    """A world as it was at a recorded tick, which never changes."""

    def __init__(
        self, moment: RecordedTick, simulator: StaticSimulator, snapshot: Snapshot
    ) -> None:
        record = moment.record
        self._begin(record.world.name, record.world.camera)
        self._record = record
        self._set_state(simulator, snapshot)

    def _set_state(self, simulator: Simulator, snapshot: Snapshot) -> None:
        super()._set_state(simulator, snapshot)
        entities = snapshot.tables["entities"]
        self._recorded = entities.block[entities.block_rows(_ENTITY_DOUBLES)].copy()

    @property
    def origin(self) -> World:
        """The recorded world."""
        return self._record.world

    def _take(self) -> None:
        super()._take()
        # Other tables are computed from poses; this one has exactly the recorded numbers.
        entities = self.snapshot.tables["entities"]
        entities.block[entities.block_rows(_ENTITY_DOUBLES)] = self._recorded
        entities.publish_unknown()

    def removal_of(self, name: str) -> str:
        """Returns that an entity of a name is recorded at other ticks; '' if none is."""
        if all(member.name != name for member in self._record.members.values()):
            return ""
        return (
            f"it is there at other ticks of the record: {past_path(self.name, name)}; functions of "
            f"time take it from a query at its last time t, as {past_query(self.name, name, 't')}"
        )

    def request_tables(self, tables: Iterable[str]) -> None:
        """Ensures that the tick includes tables; recorded ones are always there."""
        requested = frozenset(tables)
        self._record.warn_of_missing(requested)
        super().request_tables(_READ & requested)

    def shapes(self) -> ShapeQueries:
        """Returns queries of the shapes at this tick."""
        self.request_tables(("shapes",))
        return self.snapshot.shapes()

    def shapes_and_sites(self) -> ShapeQueries:
        """Returns queries in which sites have their regions as shapes."""
        self.request_tables(("shapes",))
        return self.snapshot.shapes_and_sites()

    def entity(self, id: int) -> Entity:
        """Returns the handle of an entity at this tick, by its id."""
        return self._record.entity(self.snapshot.number, id)

    def __contains__(self, thing: object) -> bool:
        """Checks whether there is an entity of a name, or a given entity."""
        if isinstance(thing, Entity):
            return thing.world is self._record.world and thing.id in self.snapshot.rows
        return super().__contains__(thing)
