"""The relations between entities: what each one means, one entry in one place.

A `Relation` says what it takes and yields, its formula, and its help. They are listed by topic:
`entities`, `shapes`, `contacts`, `regions`, `joints`, `sensors`, and `ode` for the names of the ODE
dialect. `registry` brings them together.
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
