"""Finds the tables of a world that the relations in a part of a program read."""

from __future__ import annotations

from ssduck.language.analysis import cached_by_node
from ssduck.language.tree import Call, Name, Node, QualifiedName, UnresolvedName
from ssduck.sql.relations.registry import RELATIONS


@cached_by_node
def tables_of(node: Node) -> frozenset[str]:
    """Returns the tables that relations in a part read, and masses if they read these."""
    tables: frozenset[str] = frozenset()
    # A bare name may be a relation of the only source, a key a relation of its source.
    name = node.key if isinstance(node, QualifiedName) else getattr(node, "name", None)
    if isinstance(node, Call | UnresolvedName | Name | QualifiedName) and name in RELATIONS:
        tables = RELATIONS[name].inputs
    return tables.union(*map(tables_of, node.children()))
