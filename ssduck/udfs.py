"""The relations between entities, by name: `RELATIONS`, each of them a `Relation`.

They are defined, topic by topic, in the package `ssduck.sql.relations`.
"""

from ssduck.sql.relations.registry import RELATIONS
from ssduck.sql.relations.relation import Relation

__all__ = ["RELATIONS", "Relation"]
