"""The relations: one entry for each, in one registry.

From a `Relation` follow the SelectScript function and its help, the DuckDB macro of the same name
for raw SQL, its entry in the manual, its completion, and the tests that it has all of these.

Most relations are formulas: SQL expressions over the columns of their entities, for which Python
is never called. A relation of the shapes themselves calls the narrow phase (`geometry_query`);
where the answer is unknown, so is the relation. Parameters are rows of `entities`, or values. World
frame, metres, radians, kilograms; quaternions w, x, y, z. A relation of an entity with itself is
False (a distance 0); an unknown value is NULL.

A formula may look things up in another table of the entities' world, in a subquery that sees
nothing of the rows around it: a macro's parameters are unknown in there, and an alias of the
rows could be taken for a column of that table.
"""

from __future__ import annotations

from collections.abc import Iterable

import sqlglot

from ssduck.sql.relations.contacts import CONTACT_RELATIONS, SENSOR_RELATIONS
from ssduck.sql.relations.entities import ENTITY_RELATIONS, REGION_RELATIONS
from ssduck.sql.relations.geometry_query import (
    UNKNOWN,
    GeometryUdf,
    boxes_within,
)
from ssduck.sql.relations.motion import JOINT_RELATIONS, MOTION_RELATIONS
from ssduck.sql.relations.ode import ODE_RELATIONS
from ssduck.sql.relations.relation import Relation, by_name
from ssduck.sql.relations.shapes import SHAPE_RELATIONS

RELATIONS: dict[str, Relation] = by_name(
    relation
    for family in (
        ENTITY_RELATIONS,
        SHAPE_RELATIONS,
        CONTACT_RELATIONS,
        REGION_RELATIONS,
        JOINT_RELATIONS,
        MOTION_RELATIONS,
        ODE_RELATIONS,
        SENSOR_RELATIONS,
    )
    for relation in family
)

# A condition: the boxes of a and b are at most d apart along each axis.
BOXES_WITHIN = sqlglot.parse_one(boxes_within("d"), dialect="duckdb")


def _geometry_udf(relation: Relation) -> GeometryUdf:
    """Returns the function of shapes that a relation calls."""
    query = relation.geometry
    assert query is not None
    element = "DOUBLE[]" if relation.element == "list" else "DOUBLE"
    types = {"boolean": "BOOLEAN", "double": "DOUBLE", "list": f"{element}[]"}
    if relation.result not in types:
        known = ", ".join(types)
        raise ValueError(f"{relation.name}: the geometry yields {known}, not {relation.result}")
    return GeometryUdf(
        query.function,
        entities=sum(parameter.type == "entity" for parameter in relation.parameters),
        numbers=len(query.arguments),
        result=types[relation.result],
        needs_whole_tick=query.needs_whole_tick,
        uses_margins=query.uses_margins,
    )


def geometry_udfs(relations: Iterable[Relation]) -> dict[str, GeometryUdf]:
    """Returns the functions of shapes that relations call or that find all pairs, by name."""
    result: dict[str, GeometryUdf] = {UNKNOWN.name: UNKNOWN}
    for relation in relations:
        if relation.candidate_pairs is not None:
            search = relation.candidate_pairs.search
            result[search.name] = search
        if relation.geometry is not None:
            udf = _geometry_udf(relation)
            if result.setdefault(udf.name, udf) != udf:
                raise ValueError(
                    f"{relation.name}: another relation describes {udf.name!r} differently: "
                    f"{result[udf.name]}, {udf}"
                )
    return result


GEOMETRY_UDFS = geometry_udfs(RELATIONS.values())
