"""The functions of links in programs: `links`, `sites`, `entity` and `parent`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Literal

from ssduck.errors import ArgumentError
from ssduck.formatting import type_in_words
from ssduck.language import ast
from ssduck.language.analysis import cached_by_node, calls_of, variables_of
from ssduck.language.builtins import Function
from ssduck.recording.replay.past import Past
from ssduck.world.entities import Entity
from ssduck.world.handles import Link, Links
from ssduck.world.world import World


def _parts(table: Literal["links", "sites"], thing: Any) -> Any:
    """Returns the links or sites of an entity, or a source of those of all entities of a world."""
    if isinstance(thing, World):
        return Links(thing, table)
    if isinstance(thing, Past):
        return replace(thing, table=table)
    if isinstance(thing, Entity):
        return getattr(thing, table)
    raise ArgumentError(f"{table} takes a world or an entity, not {type_in_words(thing)}")


def entity(thing: Any) -> Entity:
    """Returns the entity of a link; an entity itself."""
    if isinstance(thing, Link):
        return thing.entity
    if isinstance(thing, Entity):
        return thing
    raise ArgumentError(f"entity takes a link, not {type_in_words(thing)}")


def parent(thing: Any) -> Link | None:
    """Returns the parent of a link; nothing for the base."""
    if isinstance(thing, Link):
        return thing.parent
    raise ArgumentError(f"parent takes a link, not {type_in_words(thing)}")


LINK_FUNCTIONS = {
    name: replace(Function.of(name, call, f"{about}\nUsage: {usage}"), builtin=True)
    for name, call, about, usage in (
        (
            "links",
            partial(_parts, "links"),
            (
                "Returns the links of an entity, the base first, or those of all entities of a "
                "world as a source of queries: FROM links(kitchen)."
            ),
            "links(world or entity)",
        ),
        (
            "sites",
            partial(_parts, "sites"),
            (
                "Returns the sites of an entity, or those of all entities of a world as a source "
                "of queries: FROM sites(kitchen). A site is a named frame on a link, with a region "
                "around it; MuJoCo's models have sites."
            ),
            "sites(world or entity)",
        ),
        ("entity", entity, "Returns the entity of a link; an entity itself.", "entity(link)"),
        (
            "parent",
            parent,
            "Returns the link to which a joint connects a link; nothing for the base.",
            "parent(link)",
        ),
    )
}


def mentions_links(node: ast.Node, variables: Mapping[str, Any]) -> bool:
    """Checks whether a part of a program may have links as values, but for users' functions."""
    if not calls_of(node).isdisjoint(LINK_FUNCTIONS):
        return True
    if any(_has_link(variables[name]) for name in variables_of(node) if name in variables):
        return True
    return any(_is_link(base, count, variables) for base, count in _indices_of(node))


def _has_link(value: Any) -> bool:
    if isinstance(value, list):
        return any(isinstance(part, Link) for part in value)
    is_past = isinstance(value, Past) and value.table != "entities"
    return isinstance(value, Link | Links) or is_past


@cached_by_node
def _indices_of(node: ast.Node) -> frozenset[tuple[str, int]]:
    """Returns the names that a part indexes, each with the number of its indices."""
    own: frozenset[tuple[str, int]] = frozenset()
    if isinstance(node, ast.Index) and isinstance(node.base, ast.Name):
        own = frozenset(((node.base.name, len(node.indices)),))
    return own.union(*map(_indices_of, node.children()))


def _is_link(base: str, count: int, variables: Mapping[str, Any]) -> bool:
    """Checks whether indices give a link: `kitchen.panda.panda_hand`, `arm.panda_hand`."""
    value = variables.get(base)
    return isinstance(value, Entity) or (isinstance(value, World) and count > 1)
