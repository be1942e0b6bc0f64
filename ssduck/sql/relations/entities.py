"""Relations of an entity's type, pose and box: formulas over its columns."""

from __future__ import annotations

from ssduck.sql.relations.common import A_B, ENTITY, of_entity
from ssduck.sql.relations.relation import Parameter, Relation

_SLICE = (
    Parameter("start", "integer", "the first number that is kept, from 0", optional=True),
    Parameter("stop", "integer", "the first number that is not kept", optional=True),
)
_FOOTPRINT = "b.x BETWEEN a.xmin AND a.xmax AND b.y BETWEEN a.ymin AND a.ymax"


def _sliced(
    name: str, formula: str, about: str, unit: str, aliases: tuple[str, ...] = ()
) -> Relation:
    """Returns a list of an entity, whole or from start to stop as Python slices."""
    part = (
        f"list_slice({formula}, CASE WHEN start < 0 THEN start ELSE start + 1 END, "
        "CASE WHEN stop < 0 THEN stop - 1 ELSE stop END)"
    )
    return Relation(
        name,
        ENTITY + _SLICE,
        "list",
        formula,
        about,
        formula_with_options=part,
        unit=unit,
        aliases=aliases,
    )


ENTITY_RELATIONS: tuple[Relation, ...] = (
    of_entity("id", "string", "object.name", "Returns the name of an object, unique in its world."),
    of_entity(
        "type", "string", "object.kind", "Returns the kind of an object: robot, kinbody or sensor."
    ),
    of_entity(
        "tick", "integer", "object.tick", "Returns the number of the tick that object is of."
    ),
    of_entity(
        "time",
        "double",
        "object.time",
        "Returns the simulated time of the tick that object is of.",
        "s",
        aliases=("timeOf",),
    ),
    of_entity("obj", "entity", "object.name", "Returns the object itself."),
    *(
        of_entity(
            kind,
            "entity",
            f"CASE WHEN object.kind = '{kind}' THEN object.name END",
            f"Returns the object itself if it is a {kind}, else nothing.",
        )
        for kind in ("robot", "sensor", "kinbody")
    ),
    *(
        of_entity(
            f"is{kind}",
            "boolean",
            f"object.kind = '{kind.lower()}'",
            f"Checks if object is of type {kind}.",
        )
        for kind in ("Robot", "Sensor", "Kinbody")
    ),
    _sliced(
        "position",
        "[object.x, object.y, object.z]",
        "Returns [x, y, z] of the object's link frame in the world, or that list from start "
        "to stop.",
        "m",
        aliases=("positionOf",),
    ),
    *(
        of_entity(
            axis,
            "double",
            f"object.{axis}",
            f"Returns the {axis} coordinate of the object's link frame in the world.",
            "m",
        )
        for axis in "xyz"
    ),
    _sliced(
        "orientation",
        "[object.qw, object.qx, object.qy, object.qz]",
        "Returns the unit quaternion [w, x, y, z] of the object's link frame in the world, or "
        "that list from start to stop.",
        "",
    ),
    _sliced(
        "pose",
        "[object.qw, object.qx, object.qy, object.qz, object.x, object.y, object.z]",
        "Returns the orientation [w, x, y, z] and the position [x, y, z] as one list of seven, "
        "or that list from start to stop.",
        "m",
    ),
    of_entity(
        "volume",
        "double",
        "CASE WHEN object.kind = 'kinbody' THEN (object.xmax - object.xmin) "
        "* (object.ymax - object.ymin) * (object.zmax - object.zmin) / 8 ELSE 0.0::DOUBLE END",
        "Returns the product of the three half-extents of the object's axis-aligned box: an "
        "eighth of the box's volume (see aabbVolume); 0 for what is no kinbody.",
        "m^3",
    ),
    of_entity(
        "aabbVolume",
        "double",
        "(object.xmax - object.xmin) * (object.ymax - object.ymin) * (object.zmax - object.zmin)",
        "Returns the volume of the object's axis-aligned box.",
        "m^3",
    ),
    Relation(
        "distance",
        (
            Parameter("a", "place", "an entity or a point [x, y, z]"),
            Parameter("b", "place", "an entity or a point [x, y, z]"),
        ),
        "double",
        "sqrt((a.x - b.x) ** 2 + (a.y - b.y) ** 2 + (a.z - b.z) ** 2)",
        "Returns the distance between the positions of two objects, or between two points "
        "given as lists. The size of the objects does not matter.",
        unit="m",
        is_symmetric=True,
    ),
    Relation(
        "above",
        A_B,
        "boolean",
        f"{_FOOTPRINT} AND b.z >= a.zmax AND a.id <> b.id",
        "Checks if the position of b is above a: x and y within the box of a, edges "
        "included, and z at its top or higher.",
    ),
    Relation(
        "below",
        A_B,
        "boolean",
        f"{_FOOTPRINT} AND 2 * b.z < a.zmin + a.zmax AND a.zmax < 'infinity'::DOUBLE "
        "AND a.id <> b.id",
        "Checks if the position of b is below the centre of a: x and y within the box of a, "
        "edges included, and z less than that of the box's centre.",
    ),
    Relation(
        "within",
        A_B,
        "boolean",
        "b.x > a.xmin AND b.x < a.xmax AND b.y > a.ymin AND b.y < a.ymax "
        "AND b.z > a.zmin AND b.z < a.zmax AND a.id <> b.id",
        "Checks if the position of b is inside the box of a, edges excluded.",
    ),
    of_entity(
        "isEnabled", "boolean", "object.enabled", "Checks if object takes part in collisions."
    ),
    of_entity("isVisible", "boolean", "object.visible", "Checks if object is drawn."),
    of_entity(
        "environmentID", "integer", "object.id", "Returns the number of the object in its world."
    ),
)
