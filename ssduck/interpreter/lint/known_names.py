"""Looks up names and kinds of parts of worlds, and finds the expressions that are such parts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, get_args
from weakref import WeakKeyDictionary

from ssduck.errors import SourceSpan, UnknownNameError, nearest
from ssduck.formatting import short_repr
from ssduck.language.tree import Call, Index, Literal, Name, Node
from ssduck.simulators.interface import Kind
from ssduck.sql.name_comparisons import NameKind
from ssduck.world.handles import Handle, Link
from ssduck.world.world import World

_OWNERS: Mapping[NameKind, str] = {
    "entity": "entity",
    "link": "link",
    "full link": "link",
    "joint": "joint",
    "kind": "entity",
    "kind of link": "link",
}
# The kinds that there are, in any world.
_KINDS: Mapping[NameKind, frozenset[str]] = {
    "kind": frozenset(get_args(Kind)),
    "kind of link": frozenset(("link", "site")),
}


class KnownNames:
    """The names that the entities, links and joints of worlds have, or had in a record."""

    def __init__(self, recorded: Callable[[World], Iterable[str]]) -> None:
        self._recorded = recorded
        self._known: WeakKeyDictionary[World, set[tuple[NameKind, str]]] = WeakKeyDictionary()

    def has(self, world: World, kind: NameKind, name: str) -> bool:
        """Checks whether a part of a world has a name or is of a kind, or may have been it."""
        if kind in _KINDS:
            return name in _KINDS[kind]
        known = self._known.setdefault(world, set())
        if (kind, name) not in known and self._finds(world, kind, name):
            known.add((kind, name))
        return (kind, name) in known

    def _finds(self, world: World, kind: NameKind, name: str) -> bool:
        if kind == "entity":
            return name in world or name in self._recorded(world)
        # The links and joints of an entity that was removed are not known.
        has_removed = any(recorded not in world for recorded in self._recorded(world))
        return has_removed or name in self._names(world, kind)

    def _names(self, world: World, kind: NameKind) -> Iterable[str]:
        if kind in _KINDS:
            return _KINDS[kind]
        if kind == "entity":
            return {info.name for info in world.snapshot.entities}.union(self._recorded(world))
        bodies = [(e.name, e.body) for e in world.snapshot.entities if e.body is not None]
        if kind == "joint":
            return {joint.name for _, body in bodies for joint in body.joints}
        pairs = [(owner, link.name) for owner, body in bodies for link in body.links]
        return {link if kind == "link" else f"{owner}.{link}" for owner, link in pairs}

    def error(
        self, name: str, worlds: list[World], kinds: Iterable[NameKind], span: SourceSpan
    ) -> UnknownNameError:
        """Returns the error for a name or a kind that nothing has, with the nearest ones."""
        kinds = list(kinds)
        names: set[str] = set().union(
            *(self._names(world, kind) for world in worlds for kind in kinds)
        )
        owners = " or ".join(dict.fromkeys(_OWNERS[kind] for kind in kinds))
        world_names = " or ".join(world.name for world in worlds[:3])
        verb = "is of the kind" if _KINDS.keys() & kinds else "has the name"
        message = f"no {owners} of {world_names} {verb} {short_repr(name)}"
        parts = [world.part_hint(name) for world in worlds] if kinds == ["entity"] else []
        told = next(filter(None, parts), "")
        if told:
            return UnknownNameError(f"{message}; {told}", span=span)
        return UnknownNameError(message, span=span, suggestions=nearest(name, names))


@dataclass(frozen=True)
class KnownHandle:
    """What is known of an expression that is an entity, a link or a site for sure.

    Attributes:
        world: its world; None if it is not known.
        is_link: whether it is a link or a site.
    """

    world: World | None
    is_link: bool


def handle_of(node: Node, variable: Callable[[str], Any]) -> KnownHandle | None:
    """Returns what is known of an expression outside of a source; None if it may be no handle.

    Args:
        node: the expression.
        variable: a function that returns the value of a variable; None if there is none.
    """
    match node:
        case Name(name=name):
            return _known(variable(name))
        case Index(base=Name(name=name), indices=(Literal(value=str() as key), *links)):
            place = variable(name)
            if isinstance(place, Handle):  # a link of an entity
                return None if links else KnownHandle(place.world, is_link=True)
            if isinstance(place, World) and key in place and len(links) <= 1:
                return KnownHandle(place, is_link=bool(links))
        case Call(name="entity", arguments=(_,)) if variable("entity") is None:
            return KnownHandle(None, is_link=False)
    return None


def _known(value: Any) -> KnownHandle | None:
    is_handle = isinstance(value, Handle)
    return KnownHandle(value.world, is_link=isinstance(value, Link)) if is_handle else None


def spelled(node: Node) -> str:
    """Returns such an expression as it is written: `room.cup`."""
    match node:
        case Name(name=name):
            return name
        case Index(base=Name(name=name)):
            return f"{name}.{_path(node)}"
    return "x"


def spelled_id(node: Node) -> str:
    """Returns its id as it is written: `'cup'`, or a call of `id`."""
    return f"'{_path(node)}'" if isinstance(node, Index) else f"id({spelled(node)})"


def _path(node: Index) -> str:
    return ".".join(str(index.value) for index in node.indices if isinstance(index, Literal))
