"""Exports `RELATIONS`, the relations between entities by name, each of them a `Relation`.

The package `ssduck.sql.relations` defines them by topic.
"""

from ssduck.sql.relations.registry import RELATIONS
from ssduck.sql.relations.relation import Relation

__all__ = ["RELATIONS", "Relation"]
