"""Relations of regions, and of the view of another entity."""

from __future__ import annotations

from ssduck.sql.relations.common import A_B, ENTITY, if_from_0_up, in_frame
from ssduck.sql.relations.relation import Parameter, Relation

_CORNERS = (
    Parameter("min", "place", "the lower corner [x, y, z]"),
    Parameter("max", "place", "the upper corner [x, y, z]"),
)


def _in_box(x: str, y: str, z: str) -> str:
    return " AND ".join(
        f"{place} BETWEEN min.{axis} AND max.{axis}"
        for place, axis in zip((x, y, z), "xyz", strict=True)
    )


def _viewer_relation(name: str, condition: str, about: str) -> Relation:
    """Returns a relation of the direction from a to b, as a viewer sees it."""
    forward = (
        "(1 - 2 * (viewer.qy ** 2 + viewer.qz ** 2)) * (b.x - a.x) "
        "+ 2 * (viewer.qx * viewer.qy + viewer.qw * viewer.qz) * (b.y - a.y) "
        "+ 2 * (viewer.qx * viewer.qz - viewer.qw * viewer.qy) * (b.z - a.z)"
    )
    leftward = (
        "2 * (viewer.qx * viewer.qy - viewer.qw * viewer.qz) * (b.x - a.x) "
        "+ (1 - 2 * (viewer.qx ** 2 + viewer.qz ** 2)) * (b.y - a.y) "
        "+ 2 * (viewer.qy * viewer.qz + viewer.qw * viewer.qx) * (b.z - a.z)"
    )
    formula = condition.format(forward=f"({forward})", left=f"({leftward})")
    return Relation(
        name,
        (*A_B, Parameter("viewer", "entity", "an entity that looks along its +x axis")),
        "boolean",
        f"a.id <> b.id AND {formula}",
        f"{about}, as seen by the viewer. The direction from a to b is compared along the "
        "viewer's x axis (forward) and y axis (left): the larger component decides, or that along "
        "x if both are equal.",
    )


REGION_RELATIONS: tuple[Relation, ...] = (
    _viewer_relation("leftOf", "{left} > abs({forward})", "Checks if b is left of a"),
    _viewer_relation("rightOf", "-{left} > abs({forward})", "Checks if b is right of a"),
    _viewer_relation(
        "behind",
        "{forward} > 0 AND {forward} >= abs({left})",
        "Checks if b is behind a, farther away",
    ),
    _viewer_relation(
        "inFrontOf",
        "{forward} < 0 AND -{forward} >= abs({left})",
        "Checks if b is in front of a, nearer",
    ),
    Relation(
        "inBox",
        (
            *ENTITY,
            *_CORNERS,
            Parameter("frame", "entity", "the entity in whose frame the box is", optional=True),
        ),
        "boolean",
        _in_box("object.x", "object.y", "object.z"),
        "Checks if the position of the entity is in a box, boundary included: one that is aligned "
        "with the axes of the world, or of the frame of another entity, where its corners are "
        "then, too. Nothing is in a box whose lower corner is above its upper one along an axis.",
        formula_with_options=_in_box(*in_frame("frame", "object")),
    ),
    Relation(
        "fitsBox",
        (*ENTITY, *_CORNERS),
        "boolean",
        "object.xmin >= min.x AND object.xmax <= max.x AND object.ymin >= min.y "
        "AND object.ymax <= max.y AND object.zmin >= min.z AND object.zmax <= max.z "
        "AND object.xmin <= object.xmax",
        "Checks if all shapes of the entity are in an axis-aligned box, boundary included. "
        "Nothing is in a box whose lower corner is above its upper one along an axis.",
    ),
    Relation(
        "inSphere",
        (
            *ENTITY,
            Parameter("centre", "place", "an entity or a point [x, y, z]"),
            Parameter("r", "double", "a radius, m"),
        ),
        "boolean",
        if_from_0_up(
            "inSphere",
            "sqrt((object.x - centre.x) ** 2 + (object.y - centre.y) ** 2 "
            "+ (object.z - centre.z) ** 2) <= r",
            r="a radius, m",
        ),
        "Checks if the position of the entity is in a sphere, boundary included. A negative radius "
        "is an error.",
    ),
)
