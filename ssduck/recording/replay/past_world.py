"""A world as it was at a recorded tick."""

from __future__ import annotations

from collections.abc import Iterable

from ssduck.geometry.queries import ShapeQueries
from ssduck.schema import MASSES
from ssduck.simulators.static import StaticSimulator
from ssduck.world.entities import Entity, RecordedTick
from ssduck.world.snapshot import Snapshot
from ssduck.world.world import World

# Tables that are worked out of poses.
_AS_READ = frozenset(("links", "joints", "shapes"))


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
        self._recorded = snapshot.tables["entities"].reals("time", "zmax").copy()

    @property
    def origin(self) -> World:
        """The world whose past it is."""
        return self._record.world

    def _take(self) -> None:
        super()._take()
        # Other tables are worked out of poses; this one is to the last digit as it was.
        entities = self.snapshot.tables["entities"]
        entities.reals("time", "zmax")[:] = self._recorded
        entities.written()

    def ask(self, tables: Iterable[str]) -> None:
        """See to it that there are these tables; what was recorded is there."""
        wanted = frozenset(tables)
        if MASSES in wanted:
            self._record.warn_of_masses()
        super().ask(_AS_READ & wanted)

    def shapes(self) -> ShapeQueries:
        """The shapes of this tick, to be compared."""
        self.ask(("shapes",))
        return self.snapshot.shapes()

    def entity(self, id: int) -> Entity:
        """The handle of an entity at this tick, by its id."""
        return self._record.entity(self.snapshot.number, id)

    def __contains__(self, thing: object) -> bool:
        """Whether it has an entity of that name, or that entity."""
        if isinstance(thing, Entity):
            return thing.world is self._record.world and thing.id in self.snapshot.rows
        return super().__contains__(thing)
