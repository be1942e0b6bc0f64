"""What probable mistakes are looked up in: variables, functions, and the parts of worlds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias, get_args
from weakref import WeakKeyDictionary

from ssduck.errors import SelectScriptError, SourceSpan, UnknownNameError, nearest
from ssduck.formatting import short_repr
from ssduck.language import ast
from ssduck.recording.replay.past import Past
from ssduck.simulators.interface import Kind
from ssduck.sql.user_sql import NameKind
from ssduck.world.entities import Entity
from ssduck.world.handles import Handle, Link, Links
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

    def is_known(self, name: str, worlds: Iterable[World], kinds: Iterable[NameKind]) -> bool:
        """Checks whether a part of one of some worlds has a name, or is of a kind."""
        return any(self.has(world, kind, name) for world in worlds for kind in kinds)

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


@dataclass(frozen=True, eq=False)
class Scope:
    """What the probable mistakes of a program are looked up in."""

    variable: Callable[[str], Any]  # returns the value of a variable; None if there is none
    is_function: Callable[[str], bool]  # checks whether a function has a name
    worlds: Callable[[], Iterable[World]]  # returns the worlds
    # Returns the type of a relation's result; None if a name is no relation.
    type_of_relation: Callable[[str], str | None]
    # Checks whether a query has a row; None if it cannot run.
    finds: Callable[[ast.Query], bool | None]
    value: Callable[[ast.Node], Any]  # returns the value of a variable or of a part of a world
    report: Callable[[SelectScriptError], None]  # warns of a mistake, once
    names: KnownNames  # the names of the parts of worlds
    # Whether the arguments of a relation and an entity are swapped, by their names.
    verdicts: WeakKeyDictionary[World, dict[tuple[str, int], bool]] = field(
        default_factory=WeakKeyDictionary
    )
    text: str = ""  # the program
    local: Mapping[str, Any] = field(default_factory=dict)  # the variables of the program alone

    def warn(self, error: SelectScriptError) -> None:
        """Warns of what may well be meant, so that it is an error nowhere."""
        error.locate(self.text)
        self.report(error)

    def is_relation(self, name: str) -> bool:
        """Checks whether that is a relation, which no function of the user's overrides."""
        return self.type_of_relation(name) is not None

    def entity(self, node: ast.Node) -> Entity | None:
        """Returns the entity of a world that an expression names; None if it is none."""
        match node:
            case ast.Name(name=name):
                value = self.variable(name)
                return value if isinstance(value, Entity) and value.is_there else None
            case (
                ast.QualifiedName(alias=alias, key=key)
                | ast.Index(base=ast.Name(name=alias), indices=(ast.Literal(value=str() as key),))
            ):
                return entity_of(self.variable(alias), key)
        return None

    def handle_of(self, node: ast.Node) -> KnownHandle | None:
        """Returns what is known of an expression outside of a source; None if it is no handle."""
        match node:
            case ast.Name(name=name):
                value = self.variable(name)
                is_handle = isinstance(value, Handle)
                return KnownHandle(value.world, isinstance(value, Link)) if is_handle else None
            case ast.Index(
                base=ast.Name(name=name), indices=(ast.Literal(value=str() as key), *links)
            ):
                place = self.variable(name)
                if isinstance(place, Handle):  # a link of an entity
                    return None if links else KnownHandle(place.world, is_link=True)
                if isinstance(place, World) and key in place and len(links) <= 1:
                    return KnownHandle(place, is_link=bool(links))
            case ast.Call(name="entity", arguments=(_,)) if self.variable("entity") is None:
                return KnownHandle(None, is_link=False)
        return None


# Returns the mistakes at a part of a statement: what is told of it depends on the scope.
Check: TypeAlias = Callable[[Scope], Iterable[SelectScriptError]]


@dataclass(frozen=True)
class KnownHandle:
    """What is known of an expression that is an entity, a link or a site for sure."""

    world: World | None  # its world; None if it is not known
    is_link: bool  # whether it is a link or a site


def entity_of(world: Any, name: Any) -> Entity | None:
    """Returns the entity of a world that has a name; None if it is no world, or has none."""
    return world[name] if isinstance(world, World) and name in world else None


def worlds_of(variable: Any) -> list[World]:
    """Returns the world that a variable holds, or whose past it is; none for other values."""
    if isinstance(variable, Past | Links):
        return [variable.world]
    return [variable] if isinstance(variable, World) else []


def spelled(node: ast.Node) -> str:
    """Returns such an expression as it is written: `room.cup`."""
    match node:
        case ast.Name(name=name):
            return name
        case ast.Index(base=ast.Name(name=name)):
            return f"{name}.{_path(node)}"
    return "x"


def spelled_id(node: ast.Node) -> str:
    """Returns its id as it is written: `'cup'`, or a call of `id`."""
    return f"'{_path(node)}'" if isinstance(node, ast.Index) else f"id({spelled(node)})"


def _path(node: ast.Index) -> str:
    return ".".join(str(index.value) for index in node.indices if isinstance(index, ast.Literal))
