"""The relations between entities: one entry defines one relation.

A `Relation` has its parameters, its result, its formula, and its help. There is a module for each
topic: `entities`, `shapes`, `contacts`, `regions`, `joints`, `sensors`, and `ode` for the names of
the ODE dialect. `registry` collects them.
"""

from typing import TYPE_CHECKING

from ssduck.lazy import exports

if TYPE_CHECKING:
    from ssduck.sql.relations.registry import RELATIONS
    from ssduck.sql.relations.relation import Relation

__all__ = [
    "RELATIONS",
    "Relation",
]

__getattr__, __dir__ = exports(
    __name__,
    {
        "registry": ("RELATIONS",),
        "relation": ("Relation",),
    },
)
