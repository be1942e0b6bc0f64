"""Declares the tables of a world: columns, types, units, meanings, and how they are recorded.

Each table is declared once, as a `Table`; the DuckDB schema, the buffers of live and recorded rows,
the stores, the Parquet files and the manual's page follow from it.

Metres, seconds, kilograms, newtons, radians; world frame; quaternions w, x, y, z; positions are
those of link frames, not of centres of mass.

>>> TABLES["joints"].tick_columns.integers
('tick', 'entity', 'joint')
>>> [column.name for column in TABLES["links"].model]
['entity', 'link', 'name', 'parent', 'mass', 'region', 'region_x', 'region_y', 'region_z']
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, TypeAlias

# Requested like a table: the masses, which users may change in their own client.
MASSES = "masses"
# Requested likewise: the collision margins.
MARGINS = "margins"
# Requested likewise: all entities of a tick, or all contacts of one; a record may have some only.
ALL_ENTITIES = "all entities"
# Requested likewise: the moments of contacts besides those of their forces, which are not stored.
MOMENTS = "moments"
# Requested likewise: velocities, which a record of poses does not have.
VELOCITIES = "velocities"
# A table is read with each tick until this number of ticks has passed without a request.
FORGOTTEN_AFTER = 240
# A pair of entities in SQL is one number, the first id times this plus the second: DuckDB passes
# and sorts one number faster than two.
ID_FACTOR = 1 << 32
# The id of a link is (its number + 1) times this plus the id of its entity; so ids of entities are
# fewer, and ids of links are fewer than `MAX_IDS`.
LINK_FACTOR = 1 << 19
MAX_IDS = 1 << 31
MAX_LINKS = MAX_IDS // LINK_FACTOR - 1
# The numbers of an entity that may be infinite; the others are finite or unknown.
BOX = ("xmin", "ymin", "zmin", "xmax", "ymax", "zmax")
POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")

# The tables whose rows are values of programs.
LinkTable: TypeAlias = Literal["links", "sites"]
EntityTable: TypeAlias = Literal["entities"] | LinkTable
ColumnType: TypeAlias = Literal["double", "integer", "string", "boolean", "points", "triples"]
# Where a record stores a column: with the rows of each tick, once for each entity in the *model*
# of the table, or in both.
Storage: TypeAlias = Literal["tick", "model", "both"]
# DuckDB's names of these types.
SQL_TYPES: dict[ColumnType, str] = {
    "double": "DOUBLE",
    "integer": "BIGINT",
    "string": "VARCHAR",
    "boolean": "BOOLEAN",
    "points": "DOUBLE[3][]",
    "triples": "INTEGER[3][]",
}


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        name: its name.
        type: the type of its values.
        comment: its meaning, with the unit.
        second_name: another name in SQL views if the name, or that of a related column, must be
            quoted there; else empty.
        storage: where a record stores it.
        is_live: whether the table of the current tick has it; else only the model has.
        model_comment: its meaning in the model, where it differs; else empty.
        is_of_sites: whether only rows of sites have it, so that the view of links lacks it.
    """

    name: str
    type: ColumnType
    comment: str
    second_name: str = ""
    storage: Storage = "tick"
    is_live: bool = True
    model_comment: str = ""
    is_of_sites: bool = False

    @property
    def sql(self) -> str:
        """The type of its values in SQL."""
        return SQL_TYPES[self.type]


@dataclass(frozen=True)
class TickColumns:
    """The columns of a table that a record stores with each tick, by type.

    Attributes:
        integers: their names, `tick` first.
        doubles: their names, `time` first.
        booleans: their names.
    """

    integers: tuple[str, ...]
    doubles: tuple[str, ...]
    booleans: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """All names, in the order of the stored columns."""
        return (*self.integers, *self.doubles, *self.booleans)

    @property
    def measured(self) -> tuple[str, ...]:
        """The doubles that may be unknown: all but the time."""
        return self.doubles[1:]

    @property
    def sql(self) -> dict[str, str]:
        """The type of each column in SQL."""
        return {
            **dict.fromkeys(self.integers, SQL_TYPES["integer"]),
            **dict.fromkeys(self.doubles, SQL_TYPES["double"]),
            **dict.fromkeys(self.booleans, SQL_TYPES["boolean"]),
        }


@dataclass(frozen=True)
class Table:
    """A table of a world.

    Attributes:
        name: its name.
        row: what a row is, to follow "A row is".
        all_columns: its columns and those that only its model has, in order.
        key: the columns that join the rows of a tick with those of the model; empty
            for a table whose rows differ from tick to tick.
        entity_columns: the columns that hold ids of entities: a row is recorded if all of these
            entities are.
        is_live: whether each world has it; else only records have it.
        is_on_demand: whether it is read from the simulator only when it is requested.
        is_recordable: whether users choose to record it.
        has_history: whether its rows belong to ticks.
        view_columns: the columns that only its views have: they follow from others.
        follows_from_poses: whether it can be computed for a past tick without being recorded.
        part_of: the table that has its rows among others, so that it is only a view; else empty.
        has_unknown_numbers: whether numbers are often unknown. In other tables they rarely are: a
            recorder stores such rows at once.
    """

    name: str
    row: str
    all_columns: tuple[Column, ...]
    key: tuple[str, ...] = ()
    entity_columns: tuple[str, ...] = ()
    is_live: bool = True
    is_on_demand: bool = False
    is_recordable: bool = True
    has_history: bool = True
    view_columns: tuple[Column, ...] = ()
    follows_from_poses: bool = False
    part_of: str = ""
    has_unknown_numbers: bool = False

    @property
    def source(self) -> str:
        """The name of the table that has its rows: its own, unless it is a part of another."""
        return self.part_of or self.name

    @cached_property
    def shown_columns(self) -> tuple[Column, ...]:
        """The columns of its views."""
        shown = (c for c in self.columns if self.part_of or not c.is_of_sites)
        return (*shown, *self.view_columns)

    @cached_property
    def columns(self) -> tuple[Column, ...]:
        """The columns of the table of a tick."""
        return tuple(column for column in self.all_columns if column.is_live)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The names of these columns."""
        return tuple(column.name for column in self.columns)

    @cached_property
    def model(self) -> tuple[Column, ...]:
        """The columns of its model, with their meanings there; empty if it has none."""
        return tuple(
            replace(column, comment=column.model_comment or column.comment)
            for column in self.all_columns
            if column.storage != "tick"
        )

    @cached_property
    def tick_columns(self) -> TickColumns:
        """The columns that a record stores with each tick."""
        integers, doubles, booleans = (
            tuple(c.name for c in self.columns if c.type == type and c.storage != "model")
            for type in ("integer", "double", "boolean")
        )
        return TickColumns(integers, doubles, booleans)

    @cached_property
    def second_names(self) -> dict[str, str]:
        """The second names, by the names of the columns that have one."""
        return {column.name: column.second_name for column in self.columns if column.second_name}

    @property
    def history_view(self) -> str:
        """The name of the view of all recorded ticks."""
        return f"{self.name}_history"

    @property
    def model_view(self) -> str:
        """The name of the view of the model."""
        return f"{self.name}_model"


def _doubles(
    names: str,
    comment: str,
    second_name: str = "",
    storage: Storage = "tick",
    model_comment: str = "",
) -> tuple[Column, ...]:
    """Returns columns of doubles with the same comment; second names keep the last letter."""
    return tuple(
        Column(
            name,
            "double",
            comment,
            f"{second_name}_{name[-1]}" if second_name else "",
            storage,
            model_comment=model_comment,
        )
        for name in names.split()
    )


def _fixed(name: str, type: ColumnType, comment: str, model_comment: str = "") -> Column:
    """Returns a column whose values are the same at each tick."""
    return Column(name, type, comment, storage="model", model_comment=model_comment)


def _of_sites(name: str, type: ColumnType, comment: str) -> Column:
    """Returns a column that only rows of sites have."""
    return Column(name, type, comment, storage="model", is_of_sites=True)


def _key(name: str, comment: str) -> Column:
    """Returns a column that joins the rows of a tick with those of the model."""
    return Column(name, "integer", comment, storage="both")


def _model_only(name: str, type: ColumnType, comment: str) -> Column:
    return Column(name, type, comment, storage="model", is_live=False)


_TICK = (
    Column("tick", "integer", "number of the snapshot"),
    Column("time", "double", "simulated time, s"),
)
_POSITION = "position of the link frame, m"
_ORIENTATION = "orientation of the link frame, unit quaternion"
_POSE = (*_doubles("x y z", _POSITION), *_doubles("qw qx qy qz", _ORIENTATION))
_POSE_OF_SHAPE = (
    *_doubles("x y z", _POSITION, "", "both", "position in the frame of the link, m"),
    *_doubles("qw qx qy qz", _ORIENTATION, "", "both", "orientation in the frame of the link"),
)
TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
_TWIST = (
    *_doubles(" ".join(TWIST[:3]), "velocity of the link frame's origin, m/s"),
    *_doubles(" ".join(TWIST[3:]), "angular velocity, rad/s"),
)
_BOX = _doubles(" ".join(BOX), "axis-aligned box of the shapes, exact, m")
_FIRST_MASS = "kg, when the entity was first recorded; a later change is not recorded"

_REGION_SIZE = "size of a site's region, as that of geometries, m; else 0"

EXACT = (
    "whether it is the simulator's own shape; else a box stands in for it. Unknown in records "
    "that are older than this column"
)

_ENTITIES = Table(
    "entities",
    "a robot, kinbody or sensor of the world",
    (
        *_TICK,
        _key("id", "ssduck's own number of the entity, never used again"),
        _fixed("name", "string", "unique in its world"),
        _fixed("kind", "string", "robot, kinbody or sensor"),
        _fixed("parent", "string", "the entity that a sensor is mounted on"),
        *_POSE,
        *_TWIST,
        *_BOX,
        _fixed("mass", "double", "kg; 0 for a sensor and for a body that cannot move", _FIRST_MASS),
        Column("enabled", "boolean", "whether it takes part in collisions"),
        Column("visible", "boolean", "whether it is drawn"),
        _model_only("links", "integer", "number of links"),
        _model_only("joints", "integer", "number of joints"),
        _model_only("movable", "boolean", "whether the simulation can move it; NULL for a sensor"),
        _model_only("host", "integer", "id of the entity that a sensor is mounted on"),
        _model_only("host_link", "integer", "number of the link that a sensor is mounted on"),
        _model_only("sensor", "string", "specification of a sensor, as JSON"),
        _model_only("visuals", "string", "what is drawn of it, as JSON; NULL if that is not known"),
        _fixed("run", "integer", "random number of the run that the row belongs to"),
    ),
    key=("id",),
    entity_columns=("id",),
)
_LINKS = Table(
    "links",
    "a link of an entity",
    (
        *_TICK,
        _key("entity", "id of the entity"),
        _key("link", "number of the link; the base is 0"),
        _fixed("name", "string", "as in the model"),
        _fixed("parent", "integer", "number of the parent link; NULL for the base"),
        *_POSE,
        *_TWIST,
        *_BOX,
        _fixed("mass", "double", "kg; 0 for a base that cannot move", _FIRST_MASS),
        _of_sites("region", "string", "form of a site's region: a type of geometries; else NULL"),
        *(_of_sites(f"region_{axis}", "double", _REGION_SIZE) for axis in "xyz"),
    ),
    key=("entity", "link"),
    entity_columns=("entity",),
    is_on_demand=True,
    view_columns=(
        Column(
            "id", "integer", "id of the link, among those of entities: (link + 1) * 2^19 + entity"
        ),
        Column("full_name", "string", "names of entity and link, unique in the world"),
        Column("kind", "string", "link or site"),
        Column("enabled", "boolean", "whether its entity takes part in collisions"),
        Column("visible", "boolean", "whether its entity is drawn"),
        Column("run", "integer", "random number of the run that the row belongs to"),
    ),
    follows_from_poses=True,
)
_SITES = replace(
    _LINKS,
    name="sites",
    row="a site of an entity: a named frame on a link, with a region around it",
    is_recordable=False,
    part_of="links",
)
_JOINTS = Table(
    "joints",
    "a joint of an entity",
    (
        *_TICK,
        _key("entity", "id of the entity"),
        _key("joint", "number of the joint in its entity"),
        _fixed("link", "integer", "number of the link that the joint moves"),
        _fixed("name", "string", "as in the model"),
        _fixed("type", "string", "revolute, prismatic, spherical, planar, free or fixed"),
        Column("position", "double", "rad or m; NULL for a joint whose position is no number"),
        Column("velocity", "double", "rad/s or m/s"),
        Column("effort", "double", "of the joint's motor in the last step, N m or N"),
        _fixed("lower", "double", "limit, rad or m"),
        _fixed("upper", "double", "limit, rad or m"),
        _fixed("max_effort", "double", "limit, N m or N"),
        _fixed("max_velocity", "double", "limit, rad/s or m/s"),
        _model_only("axis_x", "double", "axis in the frame of the link"),
        _model_only("axis_y", "double", "axis in the frame of the link"),
        _model_only("axis_z", "double", "axis in the frame of the link"),
        _model_only("anchor_x", "double", "point of the axis, in the frame of the link, m"),
        _model_only("anchor_y", "double", "point of the axis, in the frame of the link, m"),
        _model_only("anchor_z", "double", "point of the axis, in the frame of the link, m"),
        _model_only("reference", "double", "position at which the joint moves nothing, rad or m"),
    ),
    key=("entity", "joint"),
    entity_columns=("entity",),
    is_on_demand=True,
    has_unknown_numbers=True,
)
_SHAPES = Table(
    "shapes",
    "a shape by which an entity collides",
    (
        *_TICK,
        _key("entity", "id of the entity"),
        _fixed("link", "integer", "number of the link"),
        _key("shape", "number of the shape in its entity"),
        _fixed("geometry", "integer", "id of the geometry"),
        *_POSE_OF_SHAPE,
        *_BOX,
        _fixed("margin", "double", "distance at which the simulator already reports contact, m"),
        _fixed("exact", "boolean", EXACT),
    ),
    key=("entity", "shape"),
    entity_columns=("entity",),
    is_on_demand=True,
    follows_from_poses=True,
)
_GEOMETRIES = Table(
    "geometries",
    "a geometry that shapes or, in records, visuals have, in its own frame",
    (
        _fixed("id", "integer", "the same for equal geometries"),
        _fixed("type", "string", "sphere, box, cylinder, capsule, ellipsoid, plane, hull or mesh"),
        *_doubles(
            "size_x size_y size_z",
            "box: full sizes; else radius, length; plane: normal; m",
            storage="model",
        ),
        _fixed("vertices", "points", "of hulls and meshes, m"),
        _fixed("faces", "triples", "of meshes: three vertex numbers each"),
    ),
    is_recordable=False,
    has_history=False,
)
_CONTACTS = Table(
    "contacts",
    "a contact point that the physics solver found in the last step",
    (
        *_TICK,
        Column("a", "integer", "id of an entity; a < b, but for self-contacts"),
        Column("link_a", "integer", "number of its link"),
        Column("b", "integer", "id of the other entity"),
        Column("link_b", "integer", "number of its link"),
        *_doubles("ax ay az", "point on a where the force acts, m", "point_a"),
        *_doubles("bx by bz", 'point on b where it acts, m; in SQL write "by"', "point_b"),
        *_doubles("nx ny nz", "unit normal, from b to a", "normal"),
        Column("depth", "double", "penetration, m"),
        Column("force", "double", "normal force, N"),
        *_doubles("fx fy fz", "force on a, friction included, N", "force"),
    ),
    entity_columns=("a", "b"),
    is_on_demand=True,
)
_SENSINGS = Table(
    "sensings",
    "an entity that a sensor perceives",
    (
        *_TICK,
        Column("sensor", "integer", "id of a sensor that is switched on"),
        Column("entity", "integer", "id of an entity that it perceives"),
        Column("hits", "integer", "number of its rays, pixels or contact points on the entity"),
        Column("rays", "integer", "number of all its rays, pixels or contact points"),
        Column("measured", "double", "simulated time of the reading, s"),
    ),
    entity_columns=("sensor", "entity"),
    is_on_demand=True,
)
_TICKS = Table(
    "ticks",
    "the tick",
    (*_TICK, Column("wall_time", "double", "seconds since 1970")),
    is_recordable=False,
)
_FRAMES = Table(
    "frames",
    "the pose of a link of a body that has several, where the table of links is not recorded",
    (
        *_TICK,
        Column("entity", "integer", "id of the entity"),
        Column("link", "integer", "number of the link"),
        *_POSE,
    ),
    key=("entity", "link"),
    entity_columns=("entity",),
    is_live=False,
    is_recordable=False,
)

_DECLARED = (
    _ENTITIES,
    _LINKS,
    _SITES,
    _JOINTS,
    _SHAPES,
    _GEOMETRIES,
    _CONTACTS,
    _SENSINGS,
    _TICKS,
    _FRAMES,
)
# The tables that each world has, by name.
TABLES: Mapping[str, Table] = {table.name: table for table in _DECLARED if table.is_live}
# Those that have rows of their own, and are not only views.
STORED_TABLES: Mapping[str, Table] = {n: table for n, table in TABLES.items() if not table.part_of}
# The tables that are read from the simulator only when they are requested.
ON_DEMAND = frozenset(table.source for table in _DECLARED if table.is_on_demand)
# The tables whose numbers are often unknown.
OFTEN_UNKNOWN = frozenset(table.name for table in _DECLARED if table.has_unknown_numbers)
# The tables that users choose to record; `ticks` is recorded always, and models once.
RECORDABLE = tuple(table.name for table in _DECLARED if table.is_recordable)
# The tables that are recorded unless the user chooses others.
RECORDED_BY_DEFAULT = ("entities", "links", "contacts")
# The tables of ticks that a record may store, by name.
RECORDED: Mapping[str, Table] = {
    table.name: table for table in _DECLARED if table.has_history and not table.part_of
}
# The recorded tables that users see.
HISTORIES: Mapping[str, Table] = {
    **{name: RECORDED[name] for name in ("ticks", *RECORDABLE)},
    _SITES.name: _SITES,
}
# The tables that have a model, by name.
MODELS: Mapping[str, Table] = {
    table.name: table for table in _DECLARED if table.model and not table.part_of
}
# The recorded poses of links, where the table of links is not recorded.
FRAMES = _FRAMES.name


def link_id(entity: int, link: int) -> int:
    """Returns the id of a link.

    >>> link_id(3, 0), entity_of(link_id(3, 7)), link_of(link_id(3, 7))
    (524291, 3, 7)

    Args:
        entity: the id of its entity.
        link: its number; the base is 0.
    """
    return (link + 1) * LINK_FACTOR + entity


def entity_of(id: int) -> int:
    """Returns the id of the entity of a link; of an entity its own."""
    return id % LINK_FACTOR


def link_of(id: int) -> int:
    """Returns the number of a link; -1 for the id of an entity."""
    return id // LINK_FACTOR - 1


def recorded_tables(chosen: tuple[str, ...]) -> tuple[str, ...]:
    """Returns the tables that a record stores with each tick.

    Args:
        chosen: the chosen tables, of `RECORDABLE`.

    >>> recorded_tables(("entities", "joints"))
    ('ticks', 'entities', 'joints', 'frames')
    """
    frames = () if "links" in chosen else (FRAMES,)
    return ("ticks", *dict.fromkeys(chosen), *frames)
