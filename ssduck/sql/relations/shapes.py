"""Relations of the shapes themselves, and of their boxes: most ask the narrow phase."""

from __future__ import annotations

from typing import Any

from ssduck.geometry.queries import ShapeQueries
from ssduck.language.intervals import RELATIONS_OF_INTERVALS
from ssduck.sql.relations.common import A_B, ENTITY
from ssduck.sql.relations.geometry_query import (
    BOXES_MEETING,
    BOXES_REACHING,
    COLLIDING,
    EVERY_PAIR,
    MARGINS,
    RESTING,
    STACKED,
    TOUCHING,
    WITHIN,
    ZERO,
    CandidatePairs,
    GeometryQuery,
)
from ssduck.sql.relations.relation import Parameter, Relation, ValueType

# A third of the mean of the six sides of two boxes.
_BESIDE = "(" + " + ".join(f"{o}.{s}max - {o}.{s}min" for o in "ab" for s in "xyz") + ") / 18"
_ORIENTATION_A, _ORIENTATION_B = (tuple(f"{e}.q{part}" for part in "wxyz") for e in "ab")
_POSITION = "[a.x, a.y, a.z]"


def shape_relation(
    name: str,
    result: ValueType,
    geometry: GeometryQuery,
    about: str,
    *,
    parameters: tuple[Parameter, ...] = A_B,
    options: GeometryQuery | None = None,
    **further: Any,
) -> Relation:
    """Returns a relation that a function of the shapes of its entities answers.

    With its optional parameters, it is another query, `options`.
    """
    entities = [parameter.name for parameter in parameters if parameter.type == "entity"]
    if len(entities) > 1 and result != "boolean" and geometry.otherwise == "FALSE":
        raise ValueError(
            f"{name}: state `otherwise`, the value beyond the bound and of an entity with itself"
        )
    if any(parameter.optional for parameter in parameters) and options is None:
        raise ValueError(f"{name}: state `options`: it has optional parameters")
    return Relation(
        name,
        parameters,
        result,
        geometry.formula(entities),
        about,
        options=() if options is None else (options.formula(entities),),
        geometry=geometry,
        **further,
    )


# Shapes that are deeper in each other collide, metres.
DEEP = "1e-6"
# The depth is checked in the bound of boxes: that is evaluated even if none meet.
_CHECKED_DEPTH = (
    "CASE WHEN depth < 0 OR isnan(depth::DOUBLE) THEN "
    "error('collides: the depth is a number of metres from 0 up, not ' || depth)::DOUBLE "
    "ELSE 0.0::DOUBLE END"
)

SHAPE_RELATIONS: tuple[Relation, ...] = (
    Relation(
        "overlaps",
        A_B,
        "boolean",
        "a.id <> b.id AND a.xmin <= b.xmax AND b.xmin <= a.xmax AND a.ymin <= b.ymax "
        "AND b.ymin <= a.ymax AND a.zmin <= b.zmax AND b.zmin <= a.zmax",
        "Checks if the axis-aligned boxes of a and b overlap or touch. For two intervals "
        "[start, end], it checks if a begins before b and ends inside b.",
        list_formula=RELATIONS_OF_INTERVALS["overlaps"].formula,
        is_symmetric=True,
        margin="min([aabb(b)[1] - aabb(a)[0], aabb(a)[1] - aabb(b)[0], aabb(b)[3] - aabb(a)[2], "
        "aabb(a)[3] - aabb(b)[2], aabb(b)[5] - aabb(a)[4], aabb(a)[5] - aabb(b)[4]])",
    ),
    shape_relation(
        "collides",
        "boolean",
        GeometryQuery(ShapeQueries.collides, (DEEP,), over_ticks="colliding"),
        "Checks if shapes of a and b penetrate each other by more than depth, 1e-6 m by "
        "default. A body at rest penetrates its support by about 1e-5 m, or stays away from it "
        "by the margins of the simulator: use inContact or touching for rest, and collides(a, "
        "b, 1e-3) for intrusion. A negative depth is an error.",
        parameters=(*A_B, Parameter("depth", "double", "a depth, m", True, DEEP)),
        options=GeometryQuery(ShapeQueries.collides, ("depth",), bound=_CHECKED_DEPTH),
        is_symmetric=True,
        candidate_pairs=CandidatePairs(COLLIDING, DEEP, "depth"),
        margin="penetration(a, b) - clearance(a, b) - depth",
    ),
    shape_relation(
        "penetration",
        "double",
        GeometryQuery(ShapeQueries.penetration, otherwise=ZERO, over_ticks="penetration"),
        "Returns the largest penetration of the shapes of a and b, the length of the shortest "
        "translation that separates them; 0 if they are apart.",
        unit="m",
        is_symmetric=True,
    ),
    shape_relation(
        "clearance",
        "double",
        GeometryQuery(
            ShapeQueries.clearance,
            bound=None,
            otherwise=ZERO,
            pairs=EVERY_PAIR,
            is_at_least_box_distance=True,
            over_ticks="clearance",
        ),
        "Returns the smallest distance between the surfaces of a and b; 0 if they meet. It is "
        "computed for every pair, while near(a, b, d), and WHERE clearance(a, b) < d in "
        "SelectScript, skip distant pairs. An entity without shapes is infinitely far from "
        "everything.",
        unit="m",
        is_symmetric=True,
    ),
    shape_relation(
        "contactGap",
        "double",
        GeometryQuery(
            ShapeQueries.gap,
            bound=None,
            otherwise=ZERO,
            pairs=EVERY_PAIR,
            uses_margins=True,
            over_ticks="gap",
        ),
        "Returns the smallest distance between two shapes of a and b less the collision margins of "
        "both: touching(a, b, eps) is contactGap(a, b) <= eps.",
        unit="m",
        is_symmetric=True,
    ),
    shape_relation(
        "touching",
        "boolean",
        GeometryQuery(
            ShapeQueries.touching,
            ("0.001",),
            bound=f"0.001 + {MARGINS}",
            pairs="on pairs whose boxes are at most eps and the largest margins apart",
            uses_margins=True,
            over_ticks="touching",
        ),
        "Checks if the clearance of shapes of a and b is at most eps, 1 mm by default, plus the "
        "collision margins of the two shapes. The simulator keeps bodies at rest apart by their "
        "margins (the column margin of the table shapes), 2 mm for two hulls in PyBullet. "
        "near(a, b, d) ignores margins. With a negative eps, so much of the margins does not "
        "count.",
        parameters=(*A_B, Parameter("eps", "double", "a distance, m", True, "0.001")),
        options=GeometryQuery(ShapeQueries.touching, ("eps",), bound=f"(eps) + {MARGINS}"),
        is_symmetric=True,
        candidate_pairs=CandidatePairs(TOUCHING, "0.001", "eps"),
        margin="eps - contactGap(a, b)",
    ),
    shape_relation(
        "near",
        "boolean",
        GeometryQuery(
            ShapeQueries.near,
            ("d",),
            bound="d",
            pairs="on pairs whose boxes are at most d apart",
            over_ticks="within",
        ),
        "Checks if the clearance of a and b is at most d. It is never negative, so that none are "
        "near at a negative d.",
        parameters=(*A_B, Parameter("d", "double", "a distance, m")),
        is_symmetric=True,
        candidate_pairs=CandidatePairs(WITHIN, "d"),
        margin="d - clearance(a, b)",
    ),
    shape_relation(
        "nearestPoints",
        "list",
        GeometryQuery(
            ShapeQueries.points,
            bound=None,
            otherwise=f"[{_POSITION}, {_POSITION}]",
            pairs=EVERY_PAIR,
        ),
        "Returns the nearest points of a and b, [[x, y, z], [x, y, z]] in the world frame; if "
        "they meet, the points that are deepest in the other; nothing for an entity without "
        "shapes.",
        unit="m",
        element="list",
    ),
    shape_relation(
        "on",
        "boolean",
        GeometryQuery(
            ShapeQueries.on,
            bound=f"0.001 + {MARGINS}",
            pairs="on pairs whose boxes are at most 1 mm and the largest margins apart",
            uses_margins=True,
            decides_alone=True,
            over_ticks="on",
        ),
        "Checks if b stands on a: they touch (see touching, with eps 1 mm), a contact normal is "
        "within 30 degrees of up, and the centre of the box of b is above the convex hull of "
        "the footprint of a. For a support that carries b together with others, see supports.",
        candidate_pairs=CandidatePairs(STACKED),
        aliases=("onTop",),
    ),
    shape_relation(
        "supports",
        "boolean",
        GeometryQuery(
            ShapeQueries.supports,
            bound=f"0.001 + {MARGINS}",
            pairs="on pairs whose boxes are at most 1 mm and the largest margins apart",
            needs_whole_tick=True,
            uses_margins=True,
            over_ticks="supports",
        ),
        "Checks if a carries b, alone or with others, wherever the centre of b is: they touch "
        "(see touching, with eps 1 mm), and a contact normal from a to b is within 30 degrees "
        "of up, or is steeper and pushes up together with others, as the sides of a groove do. "
        "A plank on two blocks is supported by both, but on neither. Forces are not considered.",
        candidate_pairs=CandidatePairs(BOXES_REACHING, "0.001"),
    ),
    shape_relation(
        "restsOn",
        "boolean",
        GeometryQuery(
            ShapeQueries.rests_on,
            bound=None,
            pairs="on all pairs of the tick whose boxes are at most 1 cm apart, once",
            needs_whole_tick=True,
            uses_margins=True,
            over_ticks="resting",
        ),
        "Checks if b is on a, or on something that rests on a: a cup on a plate on a table "
        "rests on the table. All pairs of a tick are computed at once.",
        candidate_pairs=CandidatePairs(RESTING),
    ),
    shape_relation(
        "inside",
        "double",
        GeometryQuery(ShapeQueries.inside, otherwise=ZERO, over_ticks="inside"),
        "Returns the share of the volume of b inside the convex hull of a, the container, from 0 "
        "to 1; as a condition, contains is meant. It is 0 if b has no volume, as an open mesh (see "
        "solidVolume). Where shapes of b overlap, what they share counts more than once. The hull "
        "of a table includes the space between its legs; enclosed requires walls.",
    ),
    shape_relation(
        "contains",
        "boolean",
        GeometryQuery(ShapeQueries.contains, over_ticks="contains"),
        "Checks if at least 95 percent of the volume of b is inside the convex hull of a. The "
        "hull of a table includes the space between its legs; enclosed requires walls.",
        margin="inside(a, b) - 0.95",
        candidate_pairs=CandidatePairs(BOXES_MEETING),
    ),
    shape_relation(
        "enclosed",
        "boolean",
        GeometryQuery(ShapeQueries.encloses, _ORIENTATION_A, over_ticks="enclosed"),
        "Checks if b is between walls of a, as in a cup, a drawer or a room: along at least two "
        "of the three axes of a's link frame, rays from the centre of the box of b meet a on "
        "both sides. A grazing ray counts. A convex shape that contains the centre is not a "
        "wall; a mesh is one from either side. An axis along which b extends past a by more "
        "than 1 mm at both ends does not count.",
        candidate_pairs=CandidatePairs(BOXES_MEETING),
    ),
    shape_relation(
        "nextTo",
        "boolean",
        GeometryQuery(
            ShapeQueries.beside,
            (_BESIDE, *_ORIENTATION_A, *_ORIENTATION_B),
            bound=_BESIDE,
            only_if=f"a.zmin <= b.zmax AND b.zmin <= a.zmax AND {_BESIDE} < 1e300",
            pairs="on pairs whose boxes are at most that far apart",
            needs_whole_tick=True,
            uses_margins=True,
        ),
        "Checks if a and b are beside each other: the heights of their boxes overlap, their "
        "clearance is at most a third of the mean side of the two boxes, a horizontal ray from "
        "one meets the other before anything else, and neither supports, contains or encloses "
        "the other, or rests on it. An infinite box has nothing beside it.",
        is_symmetric=True,
    ),
    shape_relation(
        "solidVolume",
        "double",
        GeometryQuery(ShapeQueries.volume, pairs=""),
        "Returns the sum of the volumes of the entity's shapes; a plane has infinite volume, an "
        "open mesh none.",
        parameters=ENTITY,
        unit="m^3",
    ),
)
