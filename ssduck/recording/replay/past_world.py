"""A world as it was at a recorded tick."""

from __future__ import annotations

from collections.abc import Iterable

from ssduck.geometry.queries import ShapeQueries
from ssduck.schema import MASSES, ON_DEMAND, TABLES
from ssduck.simulators.static import StaticSimulator
from ssduck.world.entities import Entity, RecordedTick
from ssduck.world.snapshot import Snapshot
from ssduck.world.world import World

# Tables that are read from what stands for a simulator; the others are copied from the record.
_READ = frozenset(name for name in ON_DEMAND if TABLES[name].key)
_ENTITY_DOUBLES = TABLES["entities"].tick_columns.doubles


class PastWorld(World):
    """A world as it was at a recorded tick: it never changes, and knows what was recorded.

    Args:
        moment: the tick, and what is kept of the world.
        posed: where its bodies were.
        snapshot: of that tick.
    """

    def __init__(self, moment: RecordedTick, posed: StaticSimulator, snapshot: Snapshot) -> None:
        record = moment.record
        self._begin(posed, snapshot, record.world.name, record.world.camera)
        self._record = record
        entities = snapshot.tables["entities"]
        self._recorded = entities.block[entities.block_rows(_ENTITY_DOUBLES)].copy()

    @property
    def origin(self) -> World:
        """The world whose past it is."""
        return self._record.world

    def _take(self) -> None:
        super()._take()
        # Other tables are worked out of poses; this one is to the last digit as it was.
        entities = self.snapshot.tables["entities"]
        entities.block[entities.block_rows(_ENTITY_DOUBLES)] = self._recorded
        entities.publish_unknown()

    def request_tables(self, tables: Iterable[str]) -> None:
        """See to it that there are these tables; what was recorded is there."""
        wanted = frozenset(tables)
        if MASSES in wanted:
            self._record.warn_of_masses()
        super().request_tables(_READ & wanted)

    def shapes(self) -> ShapeQueries:
        """The shapes of this tick, to be compared."""
        self.request_tables(("shapes",))
        return self.snapshot.shapes()

    def entity(self, id: int) -> Entity:
        """The handle of an entity at this tick, by its id."""
        return self._record.entity(self.snapshot.number, id)

    def __contains__(self, thing: object) -> bool:
        """Whether it has an entity of that name, or that entity."""
        if isinstance(thing, Entity):
            return thing.world is self._record.world and thing.id in self.snapshot.rows
        return super().__contains__(thing)
