"""Relations of the ODE dialect: other names, and some that only it has."""

from __future__ import annotations

import re

from ssduck.geometry.queries import ShapeQueries
from ssduck.schema import MOMENTS
from ssduck.sql.relations.common import ENTITY, entity_relation, link_of, recorded_numbers
from ssduck.sql.relations.contacts import contact_sum
from ssduck.sql.relations.geometry_query import COLLIDING, CandidatePairs, GeometryQuery
from ssduck.sql.relations.relation import Parameter, Relation
from ssduck.sql.relations.shapes import DEEP, shape_relation

# Of a unit quaternion w, x, y, z.
_ROTATION = re.sub(
    r"\b([wxyz])\b",
    r"object.q\1",
    "[[1 - 2 * (y ** 2 + z ** 2), 2 * (x * y - w * z), 2 * (x * z + w * y)], "
    "[2 * (x * y + w * z), 1 - 2 * (x ** 2 + z ** 2), 2 * (y * z - w * x)], "
    "[2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x ** 2 + y ** 2)]]",
)

_FORCE = ("fx", "fy", "fz")
_TORQUE = ("y * fz - z * fy", "z * fx - x * fz", "x * fy - y * fx")
# The kinds of the geometries of each entity and each link.
_PARTS = (
    f"SELECT unnest([shapes.entity, {link_of('shapes.entity', 'shapes.link')}]) AS id, "  # noqa: S608
    "geometries.type AS type FROM shapes JOIN geometries ON geometries.id = shapes.geometry"
)

ODE_RELATIONS: tuple[Relation, ...] = (
    entity_relation(
        "pos",
        "list",
        "[object.x, object.y, object.z]",
        "Returns the position [x, y, z]; the same as position(object).",
        "m",
    ),
    *(
        entity_relation(
            f"pos{axis}",
            "double",
            f"object.{axis.lower()}",
            f"Returns the {axis.lower()} coordinate; the same as {axis.lower()}(object).",
            "m",
        )
        for axis in "XYZ"
    ),
    entity_relation(
        "quat",
        "list",
        "[object.qw, object.qx, object.qy, object.qz]",
        "Returns the orientation [w, x, y, z]; the same as orientation(object).",
    ),
    entity_relation(
        "rot",
        "list",
        _ROTATION,
        "Returns the rotation matrix of the entity's link frame in the world frame, as three "
        "rows: [[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]].",
        element="list",
    ),
    Relation(
        "linearVelocity",
        (*ENTITY, Parameter("axis", "integer", "0, 1 or 2 for x, y or z", optional=True)),
        "list",
        "[object.vx, object.vy, object.vz]",
        "Returns the velocity [x, y, z] of the origin of the entity's link frame in the world "
        "frame, or its component along an axis.",
        options=(
            (
                "CASE axis WHEN 0 THEN object.vx WHEN 1 THEN object.vy WHEN 2 THEN object.vz "
                "ELSE error('linearVelocity: axis must be 0, 1 or 2') END"
            ),
        ),
        result_with_options="double",
        unit="m/s",
    ),
    entity_relation(
        "velocity",
        "list",
        "[object.vx, object.vy, object.vz]",
        "Returns the velocity [x, y, z]; the same as linearVelocity(object).",
        "m/s",
    ),
    entity_relation(
        "angularVelocity",
        "list",
        "[object.wx, object.wy, object.wz]",
        "Returns the angular velocity [x, y, z] of the entity in the world frame.",
        "rad/s",
    ),
    entity_relation(
        "mass",
        "double",
        "object.mass",
        "Returns the mass of all links of the entity; 0 for an immovable entity.",
        "kg",
    ),
    entity_relation(
        "aabb",
        "list",
        "[object.xmin, object.xmax, object.ymin, object.ymax, object.zmin, object.zmax]",
        "Returns the entity's axis-aligned box [xmin, xmax, ymin, ymax, zmin, zmax] in the "
        "world frame.",
        "m",
    ),
    entity_relation(
        "force",
        "list",
        contact_sum(*_FORCE),
        "Returns the sum [x, y, z] of the contact forces on the entity in the last step, "
        "friction included, in the world frame. Forces that a program applies are not included.",
        "N",
        recorded_formula=f"{recorded_numbers('wrench', 'object')}[1:3]",
        link_formula=contact_sum(*_FORCE, of_links=True),
    ),
    entity_relation(
        "torque",
        "list",
        contact_sum(*_TORQUE),
        "Returns the sum [x, y, z] of the moments of the contact forces (see force) about the "
        "entity's position, in the world frame. The moments of torsional and rolling friction are "
        "not included; a warning tells of them in MuJoCo.",
        "N m",
        recorded_formula=f"{recorded_numbers('wrench', 'object')}[4:6]",
        link_formula=contact_sum(*_TORQUE, of_links=True),
        further_inputs=frozenset({MOMENTS}),
    ),
    entity_relation(
        "gravityMode",
        "boolean",
        "object.mass > 0",
        "Checks if gravity acts on the entity: in PyBullet, if it has a mass.",
    ),
    entity_relation(
        "hasBody",
        "boolean",
        "object.mass > 0",
        "Checks if the entity moves under forces: if it has a mass.",
    ),
    shape_relation(
        "collision",
        "boolean",
        GeometryQuery(ShapeQueries.collides, (DEEP,), over_ticks="colliding"),
        "Checks if a and b collide; the same as collides(a, b).",
        is_symmetric=True,
        candidate_pairs=CandidatePairs(COLLIDING, DEEP),
    ),
    *(
        entity_relation(
            name,
            "boolean",
            "object.id IN (SELECT shapes.entity FROM shapes JOIN geometries ON geometries.id = "  # noqa: S608
            f"shapes.geometry GROUP BY ALL HAVING bool_and(geometries.type {of}))",
            f"Checks if all shapes of the entity are {words}; False without shapes.",
            link_formula=f"object.id IN (SELECT parts.id FROM ({_PARTS}) AS parts "  # noqa: S608
            f"GROUP BY ALL HAVING bool_and(parts.type {of}))",
        )
        for name, of, words in (
            ("isBox", "= 'box'", "boxes"),
            ("isSphere", "= 'sphere'", "spheres"),
            ("isCylinder", "= 'cylinder'", "cylinders"),
            ("isCapsule", "= 'capsule'", "capsules"),
            ("isEllipsoid", "= 'ellipsoid'", "ellipsoids"),
            ("isPlane", "= 'plane'", "planes"),
            ("isTriMesh", "IN ('hull', 'mesh')", "meshes or hulls"),
        )
    ),
)
