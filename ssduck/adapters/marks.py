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
        entities = world.snapshot.entities
        self._named: dict[str, list[Mark]] = {info.name: [(info.id, -1)] for info in entities}
        names = dict[str, list[Mark]]()
        for info in entities:
            for number, link in enumerate(info.body.links if info.body else ()):
                self._named.setdefault(f"{info.name}.{link.name}", [(info.id, number)])
                names.setdefault(link.name, []).append((info.id, number))
        self._named = names | self._named

    def of(self, row: Sequence[Any]) -> list[Mark]:
        """Returns what a row has: handles, and texts that are names of entities or links.

        A name of a link is that of an entity first, then the full name of a link, and then the
        name of all links that are called so.
        """
        return list(dict.fromkeys(mark for cell in row for mark in self._in(cell)))

    def _in(self, value: Any) -> Iterator[Mark]:
        if isinstance(value, Handle):
            is_link = value.id >= LINK_FACTOR
            yield (entity_of(value.id), link_of(value.id)) if is_link else (value.id, -1)
        elif isinstance(value, str):
            yield from self._named.get(value, ())
        elif isinstance(value, dict):
            for part in value.values():
                yield from self._in(part)
        elif isinstance(value, list | tuple) and not isinstance(value, RowsOfColumns):
            for part in value:
                if not isinstance(part, int | float):  # there may be millions
                    yield from self._in(part)
