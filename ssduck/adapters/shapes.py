"""Finds the shapes of selected entities, for spatial result forms."""

from __future__ import annotations

from collections.abc import Sequence

from ssduck.adapters.base import Selection
from ssduck.errors import ArgumentError
from ssduck.geometry.solids import PlacedSolids
from ssduck.world.entities import Sensor
from ssduck.world.handles import Handle
from ssduck.world.world import World

# The table that these result forms read.
SHAPES = frozenset(("shapes",))


def shapes_of(selection: Selection) -> PlacedSolids:
    """Returns the shapes of the selected entities at the tick of the query; sensors have none."""
    entities = [entity for entity in selection.entities if not isinstance(entity, Sensor)]
    if not entities:
        return PlacedSolids.empty()
    return placed_shapes(selection.world, entities)


def placed_shapes(world: World, entities: Sequence[Handle]) -> PlacedSolids:
    """Returns the shapes of entities at the tick of their world.

    Raises:
        RemovedEntityError: an entity has been removed.
        ArgumentError: the pose of an entity is not finite.
    """
    for entity in entities:
        if not entity.is_there:
            raise entity.removed()
    world.request_tables(("shapes",))
    shapes = world.snapshot.shapes()
    ids = [entity.id for entity in entities]
    for id in shapes.unknown(ids)[:1]:
        name = world.handle(id).full_name
        raise ArgumentError(f"{name!r}: the pose is not a number; exclude the entity by WHERE")
    return shapes.placed(ids)
