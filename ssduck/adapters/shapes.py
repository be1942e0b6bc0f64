"""The shapes of what a query selected, for forms of space."""

from __future__ import annotations

from collections.abc import Sequence

from ssduck.adapters.base import Selection
from ssduck.errors import ArgumentError
from ssduck.geometry.solids import PlacedSolids
from ssduck.world.entities import Entity, Sensor
from ssduck.world.world import World

# What such a form reads of the tick.
SHAPES = frozenset(("shapes",))


def shapes_of(selection: Selection) -> PlacedSolids:
    """The shapes of what is selected, at the tick of the query; sensors have none."""
    entities = [entity for entity in selection.entities if not isinstance(entity, Sensor)]
    if not entities:
        return PlacedSolids.none()
    return placed_shapes(selection.world, entities)


def placed_shapes(world: World, entities: Sequence[Entity]) -> PlacedSolids:
    """The shapes of entities of a world, as it is at its tick.

    Raises:
        RemovedEntityError: one is no longer there.
        ArgumentError: one's pose is no number.
    """
    for entity in entities:
        if not entity.is_there:
            raise entity.removed()
    world.ask(("shapes",))
    shapes = world.snapshot.shapes()
    ids = [entity.id for entity in entities]
    for id in shapes.unknown(ids)[:1]:
        name = world.entity(id).name
        raise ArgumentError(f"{name!r} is nowhere: its pose is no number; leave it out by WHERE")
    return shapes.placed(ids)
