"""Relations of type, pose and box, of regions and of views: formulas over columns."""

from __future__ import annotations

from ssduck.sql.relations.common import A_B, ENTITY, entity_relation, if_from_0_up, in_frame
from ssduck.sql.relations.geometry_query import ABOVE, BELOW, INSIDE, CandidatePairs
from ssduck.sql.relations.relation import Parameter, Relation

_SLICE = (
    Parameter("start", "integer", "the index of the first element, from 0", optional=True),
    Parameter("stop", "integer", "the index after the last element", optional=True),
)
_IN_BOX = (
    "b.x > a.xmin AND b.x < a.xmax AND b.y > a.ymin AND b.y < a.ymax "
    "AND b.z > a.zmin AND b.z < a.zmax AND a.id <> b.id"
)
# The margins of a position in the sides of a box.
_BESIDE_X = "x(b) - aabb(a)[0], aabb(a)[1] - x(b)"
_BESIDE_Y = "y(b) - aabb(a)[2], aabb(a)[3] - y(b)"
_FOOTPRINT = "b.x BETWEEN a.xmin AND a.xmax AND b.y BETWEEN a.ymin AND a.ymax"


_SITE_IN_SQL = (
    "within: raw SQL tests no region of a site; for a row s of sites whose region is a box, write "
    "inBox(b, {x: -s.region_x / 2, y: -s.region_y / 2, z: -s.region_z / 2}, "
    "{x: s.region_x / 2, y: s.region_y / 2, z: s.region_z / 2}, s)"
)


def _in_region() -> str:
    """Returns a formula: whether the position of b is in the region of a, a site."""
    u, v, w = in_frame("a", "b")
    sizes = [f"a.region_{axis}" for axis in "xyz"]
    p, q = sizes[:2]
    box = " AND ".join(f"2 * abs({c}) < {size}" for c, size in zip((u, v, w), sizes, strict=True))
    across = f"{u} ** 2 + {v} ** 2"
    ellipsoid = " + ".join(f"({c} / {size}) ** 2" for c, size in zip((u, v, w), sizes, strict=True))
    return (
        f"a.id <> b.id AND CASE a.region WHEN 'box' THEN {box} "
        f"WHEN 'sphere' THEN {across} + {w} ** 2 < {p} ** 2 "
        f"WHEN 'cylinder' THEN {across} < {p} ** 2 AND 2 * abs({w}) < {q} "
        f"WHEN 'capsule' THEN {across} + greatest(abs({w}) - {q} / 2, 0) ** 2 < {p} ** 2 "
        f"ELSE {ellipsoid} < 1 END"
    )


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
        options=(part,),
        unit=unit,
        aliases=aliases,
    )


ENTITY_RELATIONS: tuple[Relation, ...] = (
    entity_relation(
        "id",
        "string",
        "object.name",
        "Returns the name of an entity, which is unique in its world; of a link the names of "
        "both, as in 'panda.panda_hand'.",
        link_name="full_name",
    ),
    entity_relation(
        "name",
        "string",
        "object.name",
        "Returns the name of an entity, as `id` does; of a link as in its model.",
    ),
    entity_relation(
        "type",
        "string",
        "object.kind",
        "Returns the kind of an entity: 'robot', 'kinbody' or 'sensor'; of a link 'link'.",
    ),
    entity_relation(
        "kind", "string", "object.kind", "Returns the kind of an entity; the same as `type`."
    ),
    entity_relation(
        "tick", "integer", "object.tick", "Returns the number of the tick of an entity."
    ),
    entity_relation(
        "time",
        "double",
        "object.time",
        "Returns the simulated time of the tick of an entity.",
        "s",
        aliases=("timeOf",),
    ),
    entity_relation("obj", "entity", "object.name", "Returns the object itself."),
    *(
        entity_relation(
            kind,
            "entity",
            f"CASE WHEN object.kind = '{kind}' THEN object.name END",
            f"Returns the entity itself if it is a {kind}, else nothing.",
        )
        for kind in ("robot", "sensor", "kinbody")
    ),
    *(
        entity_relation(
            f"is{kind}",
            "boolean",
            f"object.kind = '{kind.lower()}'",
            f"Checks if object is of type {kind}.",  # as the published tutorial prints it
        )
        for kind in ("Robot", "Sensor", "Kinbody")
    ),
    _sliced(
        "position",
        "[object.x, object.y, object.z]",
        "Returns the position [x, y, z] of the entity's link frame in the world frame, or its "
        "elements from start to stop.",
        "m",
        aliases=("positionOf",),
    ),
    *(
        entity_relation(
            axis,
            "double",
            f"object.{axis}",
            f"Returns the {axis} coordinate of the entity's link frame in the world frame.",
            "m",
        )
        for axis in "xyz"
    ),
    _sliced(
        "orientation",
        "[object.qw, object.qx, object.qy, object.qz]",
        "Returns the orientation of the entity's link frame in the world frame, a unit "
        "quaternion [w, x, y, z], or its elements from start to stop.",
        "",
    ),
    _sliced(
        "pose",
        "[object.qw, object.qx, object.qy, object.qz, object.x, object.y, object.z]",
        "Returns the pose [qw, qx, qy, qz, x, y, z] of the entity's link frame in the world "
        "frame, or its elements from start to stop.",
        "m",
    ),
    entity_relation(
        "volume",
        "double",
        "CASE WHEN object.kind IN ('kinbody', 'link', 'site') THEN (object.xmax - object.xmin) "
        "* (object.ymax - object.ymin) * (object.zmax - object.zmin) / 8 ELSE 0.0::DOUBLE END",
        "Returns the product of the half-extents of a kinbody's or a link's axis-aligned box, an "
        "eighth of "
        "the volume of the box (see aabbVolume); 0 for robots and sensors.",
        "m^3",
    ),
    entity_relation(
        "aabbVolume",
        "double",
        "(object.xmax - object.xmin) * (object.ymax - object.ymin) * (object.zmax - object.zmin)",
        "Returns the volume of the entity's axis-aligned box.",
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
        "Returns the distance of two positions, each that of an entity or a point [x, y, z]. "
        "The sizes of the entities do not matter.",
        unit="m",
        is_symmetric=True,
    ),
    Relation(
        "above",
        A_B,
        "boolean",
        f"{_FOOTPRINT} AND b.z >= a.zmax AND a.id <> b.id",
        "Checks if the position of b, the origin of its frame, is above the box of a: x and y are "
        "within the box, edges included, and z is at its top or higher. For what stands on a, "
        "wherever its origin is, write on(a, b). The box of a tilted plane is infinite: nothing is "
        "above it.",
        candidate_pairs=CandidatePairs(ABOVE),
        margin=f"min([{_BESIDE_X}, {_BESIDE_Y}, z(b) - aabb(a)[5]])",
    ),
    Relation(
        "below",
        A_B,
        "boolean",
        f"{_FOOTPRINT} AND CASE WHEN a.zmax = 'infinity'::DOUBLE THEN b.z < a.zmin "
        "WHEN a.zmin = -('infinity'::DOUBLE) THEN b.z < a.zmax "
        "ELSE 2 * b.z < a.zmin + a.zmax END AND a.id <> b.id",
        "Checks if the position of b is below the centre of the box of a: x and y are within "
        "the box, edges included, and z is lower than the centre. The box of a level plane has no "
        "centre: what is below its surface is below it. That of a tilted plane is infinite: "
        "nothing is below it.",
        candidate_pairs=CandidatePairs(BELOW),
        margin=f"min([{_BESIDE_X}, {_BESIDE_Y}, CASE WHEN aabb(a)[5] > 1e300 THEN aabb(a)[4] "
        "WHEN aabb(a)[4] < -1e300 THEN aabb(a)[5] ELSE (aabb(a)[4] + aabb(a)[5]) / 2 END - z(b)])",
    ),
    Relation(
        "within",
        A_B,
        "boolean",
        _IN_BOX,
        "Checks if the position of b is inside the axis-aligned box of a, or in the region of a, a "
        "site, as it is turned; edges excluded. In raw SQL, a site is an error: write inBox with "
        "the site as the frame.",
        candidate_pairs=CandidatePairs(INSIDE),
        # The kinds after 'sensor' are 'site' alone, whose regions have no margin.
        margin="CASE WHEN type(a) > 'sensor' THEN IF(within(a, b); 1e999; -1e999) "
        f"ELSE min([{_BESIDE_X}, {_BESIDE_Y}, z(b) - aabb(a)[4], aabb(a)[5] - z(b)]) END",
        link_formula=f"CASE WHEN a.kind = 'site' THEN error('{_SITE_IN_SQL}')::BOOLEAN "
        f"ELSE {_IN_BOX} END",
        site_formula=_in_region(),
    ),
    entity_relation(
        "isEnabled",
        "boolean",
        "object.enabled",
        "Checks if the simulator lets the entity collide: the value that was set by `enabled` of "
        "a handle. Calls of setCollisionFilterGroupMask do not change it: PyBullet does not tell "
        "of them.",
    ),
    entity_relation(
        "isVisible", "boolean", "object.visible", "Checks if the simulator draws the entity."
    ),
    entity_relation(
        "environmentID",
        "integer",
        "object.id",
        "Returns the id of the entity, a number that is unique in its world.",
    ),
)


_CORNERS = (
    Parameter("min", "place", "the lower corner [x, y, z]"),
    Parameter("max", "place", "the upper corner [x, y, z]"),
)


def _in_box(x: str, y: str, z: str) -> str:
    return " AND ".join(
        f"{place} BETWEEN min.{axis} AND max.{axis}"
        for place, axis in zip((x, y, z), "xyz", strict=True)
    )


def _listed(*parts: str) -> str:
    return f"[{', '.join(parts)}]"


def _to_faces(*position: str) -> str:
    """Returns the margin of a position in a box, in SelectScript."""
    ways = (f"{p} - min[{axis}], max[{axis}] - {p}" for axis, p in enumerate(position))
    return f"min({_listed(*ways)})"


def _viewer_relation(name: str, condition: str, about: str, margin: str) -> Relation:
    """Returns a relation of the direction from a to b, as a viewer sees it."""
    forward, left, _ = in_frame("viewer", "b", origin="a")
    formula = condition.format(forward=forward, left=left)
    return Relation(
        name,
        (*A_B, Parameter("viewer", "entity", "an entity that looks along its +x axis")),
        "boolean",
        f"a.id <> b.id AND {formula}",
        f"{about}, as seen by the viewer. The direction from a to b is compared along the "
        "viewer's x axis (forward) and y axis (left): the larger component decides, or that along "
        "x if both are equal.",
        margin=margin.format(*(f"positionIn(b, viewer, a)[{axis}]" for axis in (0, 1))),
    )


REGION_RELATIONS: tuple[Relation, ...] = (
    Relation(
        "positionIn",
        (
            *ENTITY,
            Parameter("frame", "entity", "the entity along whose axes the position is"),
            Parameter("origin", "entity", "the entity from which it is counted", optional=True),
        ),
        "list",
        _listed(*in_frame("frame", "object")),
        "Returns the position [x, y, z] of the entity in the frame of another one; with an origin, "
        "the way from this to the entity, along the axes of the frame.",
        options=(_listed(*in_frame("frame", "object", "origin")),),
        unit="m",
    ),
    _viewer_relation(
        "leftOf", "{left} > abs({forward})", "Checks if b is left of a", "{1} - abs({0})"
    ),
    _viewer_relation(
        "rightOf", "-{left} > abs({forward})", "Checks if b is right of a", "-{1} - abs({0})"
    ),
    _viewer_relation(
        "behind",
        "{forward} > 0 AND {forward} >= abs({left})",
        "Checks if b is behind a, farther away",
        "{0} - abs({1})",
    ),
    _viewer_relation(
        "inFrontOf",
        "{forward} < 0 AND -{forward} >= abs({left})",
        "Checks if b is in front of a, nearer",
        "-{0} - abs({1})",
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
        options=(_in_box(*in_frame("frame", "object")),),
        margin=_to_faces("x(object)", "y(object)", "z(object)"),
        margin_with_options=_to_faces(*(f"positionIn(object, frame)[{axis}]" for axis in range(3))),
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
        margin="min([aabb(object)[0] - min[0], max[0] - aabb(object)[1], aabb(object)[2] - min[1], "
        "max[1] - aabb(object)[3], aabb(object)[4] - min[2], max[2] - aabb(object)[5]])",
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
        margin="r - distance(object, centre)",
    ),
)
