"""Finds the tables of a world that the relations in a part of a program read."""

from __future__ import annotations

from ssduck.language.analysis import cached_by_node, sees_outside
from ssduck.language.tree import Call, Name, Node, QualifiedName, Query, UnresolvedName
from ssduck.schema import ALL_ENTITIES
from ssduck.sql.relations.registry import RELATIONS


@cached_by_node
def tables_of(node: Node) -> frozenset[str]:
    """Returns the tables that relations in a part read, and masses if they read these.

    A nested query about rows of the queries around it depends on all entities of the tick.
    """
    is_nested = isinstance(node, Query) and sees_outside(node)
    tables = frozenset((ALL_ENTITIES,)) if is_nested else frozenset()
    # A bare name may be a relation of the only source, a key a relation of its source.
    name = node.key if isinstance(node, QualifiedName) else getattr(node, "name", None)
    if isinstance(node, Call | UnresolvedName | Name | QualifiedName) and name in RELATIONS:
        tables = RELATIONS[name].inputs
    return tables.union(*map(tables_of, node.children()))
