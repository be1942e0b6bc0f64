"""Finds the entities and links in the rows of a result, which stand out where they are shown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from ssduck.adapters.display import RowsOfColumns
from ssduck.errors import ProgramWarning, warn
from ssduck.formatting import joined_names, short_repr
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
        self._names = {info.id: info.name for info in entities}
        # The names in a row that links of several entities have.
        self._shared: dict[str, Sequence[Mark]] = {}
        self._has_told = False

    def of(self, row: Sequence[Any]) -> list[Mark]:
        """Returns what a row has: handles, and texts that are names of entities or links.

        A name is that of an entity first, then the full name of a link, and then the name of the
        links of one entity that are called so. Those of several entities do not stand out, but for
        one that the row names, too; a warning says so, once.
        """
        found = list(dict.fromkeys(mark for cell in row for mark in self._in(cell)))
        if not self._shared:
            return found
        named = {id for id, _ in found}
        for name, links in self._shared.items():
            of_row = [mark for mark in links if mark[0] in named]
            if len({id for id, _ in of_row}) == 1:
                found += [mark for mark in of_row if mark not in found]
            elif not self._has_told:
                self._has_told = True
                owners = [self._names[id] for id in dict(links)]
                warn(
                    f"{short_repr(name)} is a link of {joined_names(owners)}, and stands out in "
                    f"none: select obj, or full_name, as in {f'{owners[0]}.{name}'!r}",
                    ProgramWarning,
                )
        self._shared.clear()
        return found

    def _in(self, value: Any) -> Iterator[Mark]:
        if isinstance(value, Handle):
            is_link = value.id >= LINK_FACTOR
            yield (entity_of(value.id), link_of(value.id)) if is_link else (value.id, -1)
        elif isinstance(value, str):
            marks = self._named.get(value, ())
            if len(dict(marks)) > 1:
                self._shared[value] = marks
            else:
                yield from marks
        elif isinstance(value, dict):
            for part in value.values():
                yield from self._in(part)
        elif isinstance(value, list | tuple) and not isinstance(value, RowsOfColumns):
            for part in value:
                if not isinstance(part, int | float):  # there may be millions
                    yield from self._in(part)
