"""Finds the entities and links in the rows of a result, which stand out where they are shown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from ssduck.adapters.display import RowsOfColumns
from ssduck.schema import LINK_FACTOR, entity_of, link_of
from ssduck.world.handles import Handle
from ssduck.world.world import World

# The number of an entity and of its link; -1 for the whole entity.
Mark = tuple[int, int]


class Marks:
    """Finds the entities and links in the rows of a result.

    Args:
        world: the world that was asked.
    """

    def __init__(self, world: World) -> None:
        self._ids = {info.name: info.id for info in world.snapshot.entities}

    def of(self, row: Sequence[Any]) -> list[Mark]:
        """Returns what a row has: handles, and texts that are names of entities."""
        return list(dict.fromkeys(mark for cell in row for mark in self._in(cell)))

    def _in(self, value: Any) -> Iterator[Mark]:
        if isinstance(value, Handle):
            is_link = value.id >= LINK_FACTOR
            yield (entity_of(value.id), link_of(value.id)) if is_link else (value.id, -1)
        elif isinstance(value, str):
            if value in self._ids:
                yield self._ids[value], -1
        elif isinstance(value, dict):
            for part in value.values():
                yield from self._in(part)
        elif isinstance(value, list | tuple) and not isinstance(value, RowsOfColumns):
            for part in value:
                if not isinstance(part, int | float):  # there may be millions
                    yield from self._in(part)
