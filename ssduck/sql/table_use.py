"""Finds the tables of a world that the relations in a part of a program read."""

from __future__ import annotations

from ssduck.language.analysis import cached_by_node
from ssduck.language.tree import Call, Name, Node, QualifiedName, UnresolvedName
from ssduck.sql.relations.registry import RELATIONS


@cached_by_node
def tables_of(node: Node) -> frozenset[str]:
    """Returns the tables that relations in a part look things up in, and masses."""
    own: frozenset[str] = frozenset()
    # A name may be a relation of the only source, a key one of a source.
    name = node.key if isinstance(node, QualifiedName) else getattr(node, "name", None)
    if isinstance(node, Call | UnresolvedName | Name | QualifiedName) and name in RELATIONS:
        own = RELATIONS[name].inputs
    return own.union(*map(tables_of, node.children()))
