"""The relations: what each one means, in one registry.

From a `Relation` come the SelectScript function and its help, the DuckDB macro of the same name
for raw SQL, its row in the manual, and the tests that it has all of these.

A relation that is a formula of the columns of its entities is an SQL expression over them, and
Python is never called. One of the shapes themselves calls the narrow phase, through a function
of `NARROW`, on the pairs whose boxes, grown by the distance asked for, meet: the formula says
so twice, once for a join to go by, and once for wherever a condition is not a join's. Where
that is unknown, so is the relation. Its parameters are rows of `entities`, or values. World
frame, metres, radians, kilograms; quaternions w, x, y, z. A relation of an entity with itself is
False (a distance 0); an unknown value is NULL.

A formula may look things up in another table of the entities' world, in a subquery that sees
nothing of the rows around it: a macro's parameters are unknown in there, and an alias of the
rows could be taken for a column of that table.
"""

from __future__ import annotations

import sqlglot

from ssduck.geometry.batch import Asked
from ssduck.sql.relations.contacts import OF_CONTACTS
from ssduck.sql.relations.entities import OF_ENTITIES
from ssduck.sql.relations.joints import OF_JOINTS
from ssduck.sql.relations.ode import OF_ODE
from ssduck.sql.relations.regions import OF_PLACES
from ssduck.sql.relations.relation import Relation, by_name
from ssduck.sql.relations.sensors import OF_SENSORS
from ssduck.sql.relations.shapes import OF_SHAPES, boxes_within

RELATIONS: dict[str, Relation] = by_name(
    relation
    for family in (OF_ENTITIES, OF_SHAPES, OF_CONTACTS, OF_PLACES, OF_JOINTS, OF_ODE, OF_SENSORS)
    for relation in family
)

# Whether the boxes of a and b are at most d apart along each axis.
BOXES_WITHIN = sqlglot.parse_one(boxes_within("d"), dialect="duckdb")

# The functions of the narrow phase, as SQL calls them: what they take besides a world, and what
# they yield. An entity is the tick that its row is of, and its id.
_ONE = ("BIGINT", "BIGINT")
_PAIR = _ONE + _ONE
NARROW: dict[str, tuple[tuple[str, ...], str]] = {
    **{
        f"narrow all_{of}": (("DOUBLE",), "BIGINT[]")
        for of in ("colliding", "within", "touching", "meeting", "reaching")
    },
    "narrow all_resting": ((), "BIGINT[]"),
    "narrow collides": ((*_PAIR, "DOUBLE"), "BOOLEAN"),
    "narrow penetration": (_PAIR, "DOUBLE"),
    "narrow clearance": (_PAIR, "DOUBLE"),
    "narrow near": ((*_PAIR, "DOUBLE"), "BOOLEAN"),
    "narrow touching": ((*_PAIR, "DOUBLE"), "BOOLEAN"),
    "narrow points": (_PAIR, "DOUBLE[][]"),
    "narrow on": (_PAIR, "BOOLEAN"),
    "narrow supports": (_PAIR, "BOOLEAN"),
    "narrow rests_on": (_PAIR, "BOOLEAN"),
    "narrow encloses": ((*_PAIR, *["DOUBLE"] * 4), "BOOLEAN"),
    "narrow beside": ((*_PAIR, *["DOUBLE"] * 9), "BOOLEAN"),
    "narrow inside": (_PAIR, "DOUBLE"),
    "narrow contains": (_PAIR, "BOOLEAN"),
    "narrow volume": (_ONE, "DOUBLE"),
}

# How far apart shapes of a world may be that touch by their margins alone, metres.
MARGINS = "narrow margins"

# Those that look at all entities of the tick, and not only at the two that are asked about.
OF_WHOLE_TICK = frozenset(("narrow supports", "narrow rests_on", "narrow beside"))

# Those that the collision margins of shapes count for.
BY_MARGINS = frozenset(
    f"narrow {name}"
    for name in (
        *("touching", "on", "supports", "rests_on", "beside"),
        *("all_touching", "all_reaching", "all_resting"),
    )
)

# The functions of joints: what they take besides a world, and an entity as its tick and its id.
JOINTS: dict[str, tuple[str, ...]] = {
    "joints position": ("VARCHAR",),
    "joints openness": ("VARCHAR",),
    "joints most_open": (),
}

# Those over many ticks: of a world, the first and the last tick, the ids of two entities (0 for
# any), and a distance. They yield [tick, a, b, 1] of each pair of which it holds, with a 0 at the
# end where it is not known.
THEN: dict[str, Asked] = {
    "then colliding": "colliding",
    "then within": "within",
    "then touching": "touching",
}
THEN_TOLD = "then told"
