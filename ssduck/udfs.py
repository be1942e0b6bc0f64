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

import re
from typing import Literal

import sqlglot

from ssduck.intervals import RELATIONS_OF_INTERVALS
from ssduck.relations import Candidates, Parameter, Relation, ValueType

_ENTITY = (Parameter("object", "entity", "an entity"),)
_A_B = (Parameter("a", "entity", "an entity"), Parameter("b", "entity", "another entity"))
_SLICE = (
    Parameter("start", "integer", "the first number that is kept, from 0", optional=True),
    Parameter("stop", "integer", "the first number that is not kept", optional=True),
)


def _of_entity(
    name: str,
    result: ValueType,
    formula: str,
    about: str,
    unit: str = "",
    element: ValueType = "real",
    then: str = "",
) -> Relation:
    return Relation(name, _ENTITY, result, formula, about, unit=unit, element=element, then=then)


def _sliced(name: str, formula: str, about: str, unit: str) -> Relation:
    """A list of an entity, whole or from start to stop as Python slices."""
    part = (
        f"list_slice({formula}, CASE WHEN start < 0 THEN start ELSE start + 1 END, "
        "CASE WHEN stop < 0 THEN stop - 1 ELSE stop END)"
    )
    return Relation(name, _ENTITY + _SLICE, "list", formula, about, sliced=part, unit=unit)


_SENSOR = (Parameter("s", "entity", "a sensor"),)
_SENSOR_AND_OTHER = (*_SENSOR, Parameter("e", "entity", "another entity"))


def _boxes_within(apart: str) -> str:
    """Whether two boxes are that near; a nanometre is allowed for what is rounded."""
    far = f"({apart}) + 1e-9"
    sides = [
        f"a.{axis}min <= b.{axis}max + {far} AND b.{axis}min <= a.{axis}max + {far}"
        for axis in "xyz"
    ]
    return " AND ".join(sides)


def _meet(apart: str = "0") -> str:
    """Whether the boxes of two entities are that near."""
    return f"a.id <> b.id AND {_boxes_within(apart)}"


def _told(what: str, a: str, b: str = "") -> str:
    """What contacts or sensors told at the tick of a row, as numbers: see `ssduck.then`."""
    other = f"{b}.id" if b else "0"
    return f"\"then told\"($world, '{what}', {a}.tick, {a}.id, {other})"


def _ask(answer: str, *more: str) -> str:
    """A call of the narrow phase, of two rows; more of what it takes."""
    return f'"narrow {answer}"({", ".join(("$world, a.tick, a.id, b.tick, b.id", *more))})'


def _narrow(call: str, apart: str = "0", otherwise: str = "FALSE") -> str:
    """A formula that calls the narrow phase where the boxes are that near.

    Where it is unknown whether they are, so is what comes of it.
    """
    if otherwise == "FALSE":
        return f"({_meet(apart)}) AND CASE WHEN {_meet(apart)} THEN {call} END"
    return f"CASE WHEN {_meet(apart)} THEN {call} WHEN NOT ({_meet(apart)}) THEN {otherwise} END"


# Of which pairs the narrow phase is asked.
_MEETING = "on pairs whose boxes meet"
_EVERY = "on every pair that is asked for"


def _on_shapes(
    name: str,
    result: ValueType,
    formula: str,
    about: str,
    *,
    asked: str = _MEETING,
    more: tuple[Parameter, ...] = (),
    sliced: str | None = None,
    unit: str = "",
    symmetric: bool = False,
    element: ValueType = "real",
    candidates: Candidates | None = None,
    far: Literal["", "more", "nothing"] = "",
) -> Relation:
    """A relation of the shapes of two entities."""
    return Relation(
        name,
        _A_B + more,
        result,
        formula,
        about,
        sliced=sliced,
        unit=unit,
        symmetric=symmetric,
        element=element,
        apart="error('of entities of two worlds')",
        asked=asked,
        candidates=candidates,
        far=far,
    )


def _seen(name: str, condition: str, about: str) -> Relation:
    """Where b is of a, for a viewer."""
    forward = (
        "(1 - 2 * (viewer.qy ** 2 + viewer.qz ** 2)) * (b.x - a.x) "
        "+ 2 * (viewer.qx * viewer.qy + viewer.qw * viewer.qz) * (b.y - a.y) "
        "+ 2 * (viewer.qx * viewer.qz - viewer.qw * viewer.qy) * (b.z - a.z)"
    )
    left = (
        "2 * (viewer.qx * viewer.qy - viewer.qw * viewer.qz) * (b.x - a.x) "
        "+ (1 - 2 * (viewer.qx ** 2 + viewer.qz ** 2)) * (b.y - a.y) "
        "+ 2 * (viewer.qy * viewer.qz + viewer.qw * viewer.qx) * (b.z - a.z)"
    )
    formula = condition.format(forward=f"({forward})", left=f"({left})")
    return Relation(
        name,
        (*_A_B, Parameter("viewer", "entity", "an entity that looks along its own +x")),
        "flag",
        f"a.id <> b.id AND {formula}",
        f"{about}, as seen by the viewer: of the differences of the two positions along its own "
        "x (forward) and y (left) the larger one decides; if they are alike, that along x.",
    )


_CORNERS = (
    Parameter("min", "place", "the lower corner [x, y, z]"),
    Parameter("max", "place", "the upper corner [x, y, z]"),
)
# A sixth of the mean of the six sides of two boxes.
_BESIDE = "(" + " + ".join(f"{o}.{s}max - {o}.{s}min" for o in "ab" for s in "xyz") + ") / 36"
_FOOTPRINT = "b.x BETWEEN a.xmin AND a.xmax AND b.y BETWEEN a.ymin AND a.ymax"

# Of a unit quaternion w, x, y, z.
_ROTATION = re.sub(
    r"\b([wxyz])\b",
    r"object.q\1",
    "[[1 - 2 * (y ** 2 + z ** 2), 2 * (x * y - w * z), 2 * (x * z + w * y)], "
    "[2 * (x * y + w * z), 1 - 2 * (x ** 2 + z ** 2), 2 * (y * z - w * x)], "
    "[2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x ** 2 + y ** 2)]]",
)


def _summed(*terms: str) -> str:
    """Sums over the contacts of an object: of the forces on it, and of where it is touched."""
    sides = " UNION ALL ".join(
        f"SELECT contacts.{side} AS entity, contacts.{side}x - entities.x AS x, "  # noqa: S608
        f"contacts.{side}y - entities.y AS y, contacts.{side}z - entities.z AS z, "
        f"{sign}fx AS fx, {sign}fy AS fy, {sign}fz AS fz "
        f"FROM contacts JOIN entities ON entities.id = contacts.{side}"
        for side, sign in (("a", ""), ("b", "-"))
    )
    sums = ", ".join(f"sum({term})" for term in terms)
    return (
        "COALESCE(map_extract_value((SELECT map(list(entity), list(total)) "  # noqa: S608
        f"FROM (SELECT entity, [{sums}] AS total FROM ({sides}) AS sides GROUP BY entity) "
        "AS summed), object.id), [0.0, 0.0, 0.0]::DOUBLE[])"
    )


_COLLIDES = _narrow(_ask("collides"))

_LISTED = (
    _of_entity("id", "text", "object.name", "Returns the name of an object, unique in its world."),
    _of_entity(
        "type", "text", "object.kind", "Returns the kind of an object: robot, kinbody or sensor."
    ),
    _of_entity(
        "tick", "integer", "object.tick", "Returns the number of the tick that object is of."
    ),
    _of_entity(
        "time",
        "real",
        "object.time",
        "Returns the simulated time of the tick that object is of.",
        "s",
    ),
    _of_entity("obj", "entity", "object.name", "Returns the object itself."),
    *(
        _of_entity(
            kind,
            "entity",
            f"CASE WHEN object.kind = '{kind}' THEN object.name END",
            f"Returns the object itself if it is a {kind}, else nothing.",
        )
        for kind in ("robot", "sensor", "kinbody")
    ),
    *(
        _of_entity(
            f"is{kind}",
            "flag",
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
    ),
    *(
        _of_entity(
            axis,
            "real",
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
    _of_entity(
        "volume",
        "real",
        "CASE WHEN object.kind = 'kinbody' THEN (object.xmax - object.xmin) "
        "* (object.ymax - object.ymin) * (object.zmax - object.zmin) / 8 ELSE 0.0::DOUBLE END",
        "Returns the product of the three half-extents of the object's axis-aligned box: an "
        "eighth of the box's volume (see aabbVolume); 0 for what is no kinbody.",
        "m^3",
    ),
    _of_entity(
        "aabbVolume",
        "real",
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
        "real",
        "sqrt((a.x - b.x) ** 2 + (a.y - b.y) ** 2 + (a.z - b.z) ** 2)",
        "Returns the distance between the positions of two objects, or between two points "
        "given as lists. The size of the objects does not matter.",
        unit="m",
        symmetric=True,
    ),
    Relation(
        "above",
        _A_B,
        "flag",
        f"{_FOOTPRINT} AND b.z >= a.zmax AND a.id <> b.id",
        "Checks if the position of b is above a: x and y within the box of a, edges "
        "included, and z at its top or higher.",
    ),
    Relation(
        "below",
        _A_B,
        "flag",
        f"{_FOOTPRINT} AND 2 * b.z < a.zmin + a.zmax AND a.zmax < 'infinity'::DOUBLE "
        "AND a.id <> b.id",
        "Checks if the position of b is below the centre of a: x and y within the box of a, "
        "edges included, and z less than that of the box's centre.",
    ),
    Relation(
        "within",
        _A_B,
        "flag",
        "b.x > a.xmin AND b.x < a.xmax AND b.y > a.ymin AND b.y < a.ymax "
        "AND b.z > a.zmin AND b.z < a.zmax AND a.id <> b.id",
        "Checks if the position of b is inside the box of a, edges excluded.",
    ),
    _of_entity("isEnabled", "flag", "object.enabled", "Checks if object takes part in collisions."),
    _of_entity("isVisible", "flag", "object.visible", "Checks if object is drawn."),
    _of_entity(
        "environmentID", "integer", "object.id", "Returns the number of the object in its world."
    ),
    # -- the shapes themselves ------------------------------------------------------------
    Relation(
        "overlaps",
        _A_B,
        "flag",
        "a.id <> b.id AND a.xmin <= b.xmax AND b.xmin <= a.xmax AND a.ymin <= b.ymax "
        "AND b.ymin <= a.ymax AND a.zmin <= b.zmax AND b.zmin <= a.zmax",
        "Checks if the axis-aligned boxes of a and b meet, touching included. Of two intervals "
        "[start, end] it checks if a begins before b, and ends inside b.",
        of_lists=RELATIONS_OF_INTERVALS["overlaps"].formula,
        symmetric=True,
    ),
    _on_shapes(
        "collides",
        "flag",
        _COLLIDES,
        "Checks if shapes of a and b are deeper in each other than 1e-6 m.",
        symmetric=True,
        candidates=Candidates("colliding"),
    ),
    _on_shapes(
        "penetration",
        "real",
        _narrow(_ask("penetration"), otherwise="0.0::DOUBLE"),
        "Returns the depth of the deepest penetration of the shapes of a and b: how far they "
        "would have to be moved to be apart; 0 if they are.",
        far="nothing",
        unit="m",
        symmetric=True,
    ),
    _on_shapes(
        "clearance",
        "real",
        f"CASE WHEN a.id = b.id THEN 0.0::DOUBLE ELSE {_ask('clearance')} END",
        "Returns the smallest distance between the surfaces of a and b, 0 if they meet. It is "
        "worked out for each pair that is asked for, but for near(a, b, d), and for "
        "WHERE clearance(a, b) < d in SelectScript: they leave out what is far apart. "
        "What has no shapes is infinitely far from everything.",
        far="more",
        asked=_EVERY,
        unit="m",
        symmetric=True,
    ),
    _on_shapes(
        "touching",
        "flag",
        _narrow(_ask("near", "0.001"), "0.001"),
        "Checks if the clearance of a and b is at most eps, 1 mm if it is not given; what meets "
        "touches.",
        asked="on pairs whose boxes are at most eps apart",
        more=(Parameter("eps", "real", "a distance, m", optional=True),),
        sliced=_narrow(_ask("near", "eps"), "eps"),
        symmetric=True,
        candidates=Candidates("within", "0.001", "eps"),
    ),
    _on_shapes(
        "near",
        "flag",
        _narrow(_ask("near", "d"), "d"),
        "Checks if the clearance of a and b is at most d.",
        asked="on pairs whose boxes are at most d apart",
        more=(Parameter("d", "real", "a distance, m"),),
        symmetric=True,
        candidates=Candidates("within", "d"),
    ),
    _on_shapes(
        "nearestPoints",
        "list",
        f"CASE WHEN a.id = b.id THEN [[a.x, a.y, a.z], [a.x, a.y, a.z]] ELSE {_ask('points')} END",
        "Returns a point on a and one on b, [[x, y, z], [x, y, z]] in the world: the nearest "
        "ones, or where they meet those that are deepest in the other; nothing of what has no "
        "shapes.",
        asked=_EVERY,
        unit="m",
        element="list",
    ),
    *(
        _on_shapes(
            name,
            "flag",
            _narrow(_ask("on"), "0.001"),
            "Checks if b rests on a: they touch (clearance at most 1 mm), a normal there is "
            "within 30 degrees of up, and the centre of the box of b is over the convex hull of "
            "the footprint of a.",
            asked="on pairs whose boxes are at most 1 mm apart",
            candidates=Candidates("meeting", "0.001"),
        )
        for name in ("on", "supports")
    ),
    _on_shapes(
        "inside",
        "real",
        _narrow(_ask("inside"), otherwise="0.0::DOUBLE"),
        "Returns the share of the volume of b that is inside the convex hull of a, from 0 to 1; "
        "0 if b has no volume. Open meshes have none: see solidVolume.",
        far="nothing",
    ),
    _on_shapes(
        "contains",
        "flag",
        _narrow(_ask("contains")),
        "Checks if at least 95 percent of the volume of b is inside the convex hull of a.",
        candidates=Candidates("meeting"),
    ),
    _on_shapes(
        "nextTo",
        "flag",
        _narrow(
            f"CASE WHEN a.zmin <= b.zmax AND b.zmin <= a.zmax AND {_BESIDE} < 1e300 "
            f"THEN {_ask('near', _BESIDE)} ELSE FALSE END",
            _BESIDE,
        ),
        "Checks if a and b are beside each other: the heights of their boxes overlap, and their "
        "clearance is at most a sixth of the mean of the six sides of the two boxes. A box "
        "without end has nothing beside it.",
        asked="on pairs whose boxes are at most that far apart",
        symmetric=True,
    ),
    Relation(
        "solidVolume",
        _ENTITY,
        "real",
        '"narrow volume"($world, object.tick, object.id)',
        "Returns the sum of the volumes of the object's shapes, infinity for a plane, 0 for an "
        "open mesh.",
        unit="m^3",
    ),
    Relation(
        "inContact",
        _A_B,
        "flag",
        "(least(a.id, b.id), greatest(a.id, b.id)) IN "
        "(SELECT contacts.a, contacts.b FROM contacts WHERE contacts.force > 0)",
        "Checks if the physics solver found a contact of a and b in the last step whose normal "
        "force is more than 0.",
        symmetric=True,
        apart="FALSE",
        then=f"a.id <> b.id AND COALESCE(list_max({_told('pressing', 'a', 'b')}) > 0, FALSE)",
    ),
    Relation(
        "contactForce",
        _A_B,
        "real",
        "CASE WHEN a.id = b.id THEN 0.0::DOUBLE ELSE COALESCE(map_extract_value((SELECT "
        "map(list((pair[1], pair[2])), list(total)) FROM (SELECT [contacts.a, contacts.b] AS pair, "
        "sum(contacts.force) AS total FROM contacts GROUP BY ALL) AS summed), "
        "(least(a.id, b.id), greatest(a.id, b.id))), 0.0::DOUBLE) END",
        "Returns the sum of the normal forces between a and b that the physics solver found in "
        "the last step.",
        unit="N",
        symmetric=True,
        apart="0.0::DOUBLE",
        then="CASE WHEN a.id = b.id THEN 0.0::DOUBLE "
        f"ELSE COALESCE(list_sum({_told('pressing', 'a', 'b')}), 0.0) END",
    ),
    # -- regions, and the view of another -------------------------------------------------
    _seen("leftOf", "{left} > abs({forward})", "Checks if b is left of a"),
    _seen("rightOf", "-{left} > abs({forward})", "Checks if b is right of a"),
    _seen(
        "behind",
        "{forward} > 0 AND {forward} >= abs({left})",
        "Checks if b is behind a, farther from the viewer",
    ),
    _seen(
        "inFrontOf",
        "{forward} < 0 AND -{forward} >= abs({left})",
        "Checks if b is in front of a, nearer to the viewer",
    ),
    Relation(
        "inBox",
        (*_ENTITY, *_CORNERS),
        "flag",
        "object.x BETWEEN min.x AND max.x AND object.y BETWEEN min.y AND max.y "
        "AND object.z BETWEEN min.z AND max.z",
        "Checks if the position of the object is in an axis-aligned box, its sides included.",
    ),
    Relation(
        "fitsBox",
        (*_ENTITY, *_CORNERS),
        "flag",
        "object.xmin >= min.x AND object.xmax <= max.x AND object.ymin >= min.y "
        "AND object.ymax <= max.y AND object.zmin >= min.z AND object.zmax <= max.z "
        "AND object.xmin <= object.xmax",
        "Checks if all of the object's shapes are in an axis-aligned box, its sides included.",
    ),
    Relation(
        "inSphere",
        (
            *_ENTITY,
            Parameter("centre", "place", "an entity or a point [x, y, z]"),
            Parameter("r", "real", "a radius, m"),
        ),
        "flag",
        "sqrt((object.x - centre.x) ** 2 + (object.y - centre.y) ** 2 "
        "+ (object.z - centre.z) ** 2) <= r",
        "Checks if the position of the object is in a sphere, its surface included.",
    ),
    # -- words of the ODE dialect ---------------------------------------------------------
    _of_entity("pos", "list", "[object.x, object.y, object.z]", "Returns position(object).", "m"),
    *(
        _of_entity(
            f"pos{axis}", "real", f"object.{axis.lower()}", f"Returns {axis.lower()}(object).", "m"
        )
        for axis in "XYZ"
    ),
    _of_entity(
        "quat",
        "list",
        "[object.qw, object.qx, object.qy, object.qz]",
        "Returns orientation(object), [w, x, y, z].",
    ),
    _of_entity(
        "rot",
        "list",
        _ROTATION,
        "Returns the rotation matrix of the object's link frame in the world, row by row: "
        "[[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]].",
        element="list",
    ),
    Relation(
        "linearVelocity",
        (*_ENTITY, Parameter("axis", "integer", "0, 1 or 2, for x, y or z", optional=True)),
        "list",
        "[object.vx, object.vy, object.vz]",
        "Returns the velocity [x, y, z] of the origin of the object's link frame, or one of the "
        "three.",
        sliced="CASE axis WHEN 0 THEN object.vx WHEN 1 THEN object.vy WHEN 2 THEN object.vz "
        "ELSE error('linearVelocity: axis is to be 0, 1 or 2') END",
        sliced_result="real",
        unit="m/s",
    ),
    _of_entity(
        "velocity",
        "list",
        "[object.vx, object.vy, object.vz]",
        "Returns linearVelocity(object).",
        "m/s",
    ),
    _of_entity(
        "angularVelocity",
        "list",
        "[object.wx, object.wy, object.wz]",
        "Returns the angular velocity [x, y, z] of the object.",
        "rad/s",
    ),
    _of_entity(
        "mass",
        "real",
        "object.mass",
        "Returns the mass of all links; 0 for what cannot move.",
        "kg",
    ),
    _of_entity(
        "aabb",
        "list",
        "[object.xmin, object.xmax, object.ymin, object.ymax, object.zmin, object.zmax]",
        "Returns the axis-aligned box, [xmin, xmax, ymin, ymax, zmin, zmax].",
        "m",
    ),
    _of_entity(
        "force",
        "list",
        _summed("fx", "fy", "fz"),
        "Returns the sum [x, y, z] of the forces on the object by contacts that the physics "
        "solver found in the last step, friction included. What a program applies, PyBullet does "
        "not tell.",
        "N",
        then=f"{_told('wrench', 'object')}[1:3]",
    ),
    _of_entity(
        "torque",
        "list",
        _summed("y * fz - z * fy", "z * fx - x * fz", "x * fy - y * fx"),
        "Returns the sum [x, y, z] of the moments of those forces (see force) about the object's "
        "position.",
        "N m",
        then=f"{_told('wrench', 'object')}[4:6]",
    ),
    _of_entity(
        "gravityMode",
        "flag",
        "object.mass > 0",
        "Checks if gravity acts on the object: in PyBullet, on all that have a mass.",
    ),
    _of_entity(
        "hasBody",
        "flag",
        "object.mass > 0",
        "Checks if the object moves under forces: if it has a mass.",
    ),
    _on_shapes(
        "collision",
        "flag",
        _COLLIDES,
        "Checks if a and b collide: collides(a, b).",
        symmetric=True,
        candidates=Candidates("colliding"),
    ),
    *(
        _of_entity(
            name,
            "flag",
            "object.id IN (SELECT shapes.entity FROM shapes JOIN geometries ON geometries.id = "  # noqa: S608
            f"shapes.geometry GROUP BY ALL HAVING bool_and(geometries.type {of}))",
            f"Checks if all of the object's shapes are {words}; False without a shape.",
        )
        for name, of, words in (
            ("isBox", "= 'box'", "boxes"),
            ("isSphere", "= 'sphere'", "spheres"),
            ("isCylinder", "= 'cylinder'", "cylinders"),
            ("isCapsule", "= 'capsule'", "capsules"),
            ("isPlane", "= 'plane'", "planes"),
            ("isTriMesh", "IN ('hull', 'mesh')", "meshes or their hulls"),
        )
    ),
    Relation(
        "isSensing",
        _SENSOR_AND_OTHER,
        "flag",
        "(s.id, e.id) IN (SELECT sensor, entity FROM sensings)",
        "Checks if sensor s perceives e now: if one of its rays, pixels or contact points ends "
        "on e. False while s is switched off, for the body that s sits on, for a sensor, and for "
        "what is no sensor.",
        apart="FALSE",
        then=f"len({_told('sensed', 's', 'e')}) > 0",
    ),
    Relation(
        "sensingAmount",
        _SENSOR_AND_OTHER,
        "real",
        "COALESCE(map_extract_value((SELECT map(list((sensor, entity)), list(hits / rays)) "
        "FROM sensings), (s.id, e.id)), 0.0::DOUBLE)",
        "Returns the share of the rays, pixels or contact points of sensor s that end on e, from "
        "0 to 1; 0 where isSensing(s, e) is False.",
        apart="0.0::DOUBLE",
        then=f"COALESCE({_told('sensed', 's', 'e')}[1], 0.0)",
    ),
    Relation(
        "sensingEnvIDs",
        _SENSOR,
        "list",
        "COALESCE(map_extract_value((SELECT map(list(sensor), list(ids)) FROM (SELECT sensor, "
        "list(entity ORDER BY entity) AS ids FROM sensings GROUP BY sensor) AS seen), s.id), "
        "[]::BIGINT[])",
        "Returns the numbers (see environmentID) of what sensor s perceives now, in ascending "
        "order; an empty list while it is switched off.",
        element="integer",
        then=f"{_told('perceived', 's')}::BIGINT[]",
    ),
)

# Whether the boxes of a and b are at most d apart along each axis.
BOXES_WITHIN = sqlglot.parse_one(_boxes_within("d"), dialect="duckdb")

# The functions of the narrow phase, as SQL calls them: what they take besides a world, and what
# they yield. An entity is the tick that its row is of, and its id.
_ONE = ("BIGINT", "BIGINT")
_PAIR = _ONE + _ONE
NARROW: dict[str, tuple[tuple[str, ...], str]] = {
    "narrow all_colliding": ((), "BIGINT[]"),
    "narrow all_within": (("DOUBLE",), "BIGINT[]"),
    "narrow all_meeting": (("DOUBLE",), "BIGINT[]"),
    "narrow collides": (_PAIR, "BOOLEAN"),
    "narrow penetration": (_PAIR, "DOUBLE"),
    "narrow clearance": (_PAIR, "DOUBLE"),
    "narrow near": ((*_PAIR, "DOUBLE"), "BOOLEAN"),
    "narrow points": (_PAIR, "DOUBLE[][]"),
    "narrow on": (_PAIR, "BOOLEAN"),
    "narrow inside": (_PAIR, "DOUBLE"),
    "narrow contains": (_PAIR, "BOOLEAN"),
    "narrow volume": (_ONE, "DOUBLE"),
}

# Those over many ticks: of a world, the first and the last tick, the ids of two entities (0 for
# any), and a distance. They yield [tick, a, b, 1] of each pair of which it holds, with a 0 at the
# end where it is not known.
THEN_COLLIDING = "then colliding"
THEN_WITHIN = "then within"
THEN_TOLD = "then told"
THEN = (THEN_COLLIDING, THEN_WITHIN)

RELATIONS: dict[str, Relation] = {relation.name: relation for relation in _LISTED}
