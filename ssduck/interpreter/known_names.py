"""Looks up the names that the entities and links of worlds have, or had in a record."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Literal, TypeAlias
from weakref import WeakKeyDictionary

from ssduck.errors import SourceSpan, UnknownNameError, nearest
from ssduck.formatting import short_repr
from ssduck.world.world import World

# Whose name it is: an entity's, a link's as in its model, or a link's with that of its entity.
NameKind: TypeAlias = Literal["entity", "link", "full link"]
_OWNERS: dict[NameKind, str] = {"entity": "entity", "link": "link", "full link": "link"}


class KnownNames:
    """The names that the entities and links of worlds have, or had in a record.

    Args:
        recorded: a function that returns the names of all entities in a world's record.
    """

    def __init__(self, recorded: Callable[[World], Iterable[str]]) -> None:
        self._recorded = recorded
        self._known: WeakKeyDictionary[World, set[tuple[NameKind, str]]] = WeakKeyDictionary()

    def has(self, world: World, kind: NameKind, name: str) -> bool:
        """Checks whether an entity or a link of a world has a name, or may have had it."""
        known = self._known.setdefault(world, set())
        if (kind, name) not in known and self._finds(world, kind, name):
            known.add((kind, name))
        return (kind, name) in known

    def _finds(self, world: World, kind: NameKind, name: str) -> bool:
        if kind == "entity":
            return name in world or name in self._recorded(world)
        # The links of an entity that was removed are not known.
        has_removed = any(recorded not in world for recorded in self._recorded(world))
        return has_removed or name in self._names(world, kind)

    def _names(self, world: World, kind: NameKind) -> set[str]:
        if kind == "entity":
            return {info.name for info in world.snapshot.entities}.union(self._recorded(world))
        pairs = (
            (info.name, link.name)
            for info in world.snapshot.entities
            if info.body is not None
            for link in info.body.links
        )
        return {link if kind == "link" else f"{owner}.{link}" for owner, link in pairs}

    def error(
        self, name: str, worlds: list[World], kinds: Iterable[NameKind], span: SourceSpan
    ) -> UnknownNameError:
        """Returns the error for a name that nothing has; it suggests the nearest names."""
        kinds = list(kinds)
        names = set().union(*(self._names(world, kind) for world in worlds for kind in kinds))
        owners = " or ".join(dict.fromkeys(_OWNERS[kind] for kind in kinds))
        world_names = " or ".join(world.name for world in worlds[:3])
        return UnknownNameError(
            f"no {owners} of {world_names} has the name {short_repr(name)}",
            span=span,
            suggestions=nearest(name, names),
        )
