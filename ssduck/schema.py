"""The tables of a world: their columns, with types, units and meanings.

Metres, seconds, kilograms, newtons, radians; world frame; quaternions w, x, y, z; positions are
those of link frames, not of centres of mass.
"""

from __future__ import annotations

from typing import Literal, NamedTuple, TypeAlias

# What is asked for like a table: the masses, which others may change in a simulation of theirs.
MASSES = "masses"
# The collision margins, likewise.
MARGINS = "margins"
# So many ticks is what was asked for read without another question.
FORGOTTEN_AFTER = 240
# A pair of entities in SQL is one number, the first id times this and the second: DuckDB takes and
# sorts one number in less time than two.
MOST_IDS = 1 << 32
# Of an entity's numbers these may be infinite; the others are finite or unknown.
BOX = ("xmin", "ymin", "zmin", "xmax", "ymax", "zmax")

ColumnType: TypeAlias = Literal["real", "integer", "text", "flag", "points", "triples"]
_SQL: dict[ColumnType, str] = {
    "real": "DOUBLE",
    "integer": "BIGINT",
    "text": "VARCHAR",
    "flag": "BOOLEAN",
    "points": "DOUBLE[3][]",
    "triples": "INTEGER[3][]",
}


class Column(NamedTuple):
    """A column of a table.

    Attributes:
        name: of the column.
        type: of its values.
        comment: what it means, with the unit.
        also: its second name in the views of SQL, where the first one, or that of a neighbour of
            the same meaning, has to be quoted there; else nothing.
    """

    name: str
    type: ColumnType
    comment: str
    also: str = ""

    @property
    def sql(self) -> str:
        """The type of its values in SQL."""
        return _SQL[self.type]


def _reals(names: str, comment: str, also: str = "") -> tuple[Column, ...]:
    seconds = [f"{also}_{name[-1]}" if also else "" for name in names.split()]
    return tuple(
        Column(name, "real", comment, second)
        for name, second in zip(names.split(), seconds, strict=True)
    )


_TICK = (
    Column("tick", "integer", "number of the snapshot"),
    Column("time", "real", "simulated time, s"),
)
_POSE = (
    *_reals("x y z", "position of the link frame, m"),
    *_reals("qw qx qy qz", "orientation of the link frame, unit quaternion"),
)
_TWIST = (
    *_reals("vx vy vz", "velocity of the link frame's origin, m/s"),
    *_reals("wx wy wz", "angular velocity, rad/s"),
)
_BOX = _reals(" ".join(BOX), "axis-aligned box of the shapes, exact, m")

EXACT = (
    "whether it is the simulator's own shape; else a box stands in for it. Unknown in records "
    "that are older than this column"
)

# What a row of each table is.
ROWS: dict[str, str] = {
    "entities": "a robot, kinbody or sensor of the world",
    "links": "a link of an entity",
    "joints": "a joint of an entity",
    "shapes": "a shape by which an entity collides",
    "geometries": "a geometry that shapes have, in its own frame",
    "contacts": "a contact point that the physics solver found in the last step",
    "sensings": "an entity that a sensor perceives",
    "ticks": "the tick",
}

TABLES: dict[str, tuple[Column, ...]] = {
    "entities": (
        *_TICK,
        Column("id", "integer", "ssduck's own number of the entity, never used again"),
        Column("name", "text", "unique in its world"),
        Column("kind", "text", "robot, kinbody or sensor"),
        Column("parent", "text", "the entity that a sensor sits on"),
        *_POSE,
        *_TWIST,
        *_BOX,
        Column("mass", "real", "kg; 0 for what cannot move"),
        Column("enabled", "flag", "takes part in collisions"),
        Column("visible", "flag", "is drawn"),
        Column("run", "integer", "random number of the run that the row is of"),
    ),
    "links": (
        *_TICK,
        Column("entity", "integer", "id of the entity"),
        Column("link", "integer", "number of the link; the base is 0"),
        Column("name", "text", "as in the model"),
        Column("parent", "integer", "number of the parent link; none for the base"),
        *_POSE,
        *_TWIST,
        *_BOX,
        Column("mass", "real", "kg; 0 for a base that cannot move"),
    ),
    "joints": (
        *_TICK,
        Column("entity", "integer", "id of the entity"),
        Column("link", "integer", "number of the link that the joint moves"),
        Column("name", "text", "as in the model"),
        Column("type", "text", "revolute, prismatic, spherical, planar or fixed"),
        Column("position", "real", "rad or m"),
        Column("velocity", "real", "rad/s or m/s"),
        Column("effort", "real", "of the joint's motor in the last step, N m or N"),
        Column("lower", "real", "limit, rad or m"),
        Column("upper", "real", "limit, rad or m"),
        Column("max_effort", "real", "limit, N m or N"),
        Column("max_velocity", "real", "limit, rad/s or m/s"),
    ),
    "shapes": (
        *_TICK,
        Column("entity", "integer", "id of the entity"),
        Column("link", "integer", "number of the link"),
        Column("shape", "integer", "number of the shape in its entity"),
        Column("geometry", "integer", "id of the geometry"),
        *_POSE,
        *_BOX,
        Column("margin", "real", "how far around it the simulator takes others to touch it, m"),
        Column("exact", "flag", EXACT),
    ),
    "geometries": (
        Column("id", "integer", "the same for equal geometries"),
        Column("type", "text", "sphere, box, cylinder, capsule, plane, hull or mesh"),
        *_reals("size_x size_y size_z", "box: full sizes; else radius, length; plane: normal; m"),
        Column("vertices", "points", "of hulls and meshes, m"),
        Column("faces", "triples", "of meshes: three vertex numbers each"),
    ),
    "contacts": (
        *_TICK,
        Column("a", "integer", "id of an entity; a < b, but for self-contacts"),
        Column("link_a", "integer", "number of its link"),
        Column("b", "integer", "id of the other entity"),
        Column("link_b", "integer", "number of its link"),
        *_reals("ax ay az", "point on a, m", "point_a"),
        *_reals("bx by bz", "point on b, m", "point_b"),
        *_reals("nx ny nz", "unit normal, from b to a", "normal"),
        Column("depth", "real", "penetration, m"),
        Column("force", "real", "normal force, N"),
        *_reals("fx fy fz", "force on a, friction included, N", "force"),
    ),
    "sensings": (
        *_TICK,
        Column("sensor", "integer", "id of a sensor that is switched on"),
        Column("entity", "integer", "id of an entity that it perceives"),
        Column("hits", "integer", "how many of its rays, pixels or contact points end on that"),
        Column("rays", "integer", "how many it has"),
        Column("measured", "real", "simulated time of the reading, s"),
    ),
    "ticks": (*_TICK, Column("wall_time", "real", "seconds since 1970")),
}


def second_names(table: str) -> dict[str, str]:
    """The columns of a table that have a second name, with that."""
    return {column.name: column.also for column in TABLES.get(table, ()) if column.also}
