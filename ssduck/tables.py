"""The tables of a world: their columns, and the buffers that hold a tick's rows.

Metres, seconds, kilograms, newtons, radians; world frame; quaternions w, x, y, z; positions are
those of link frames, not of centres of mass.

The numbers of a table live in numpy buffers that an Arrow table looks into, so that whoever
holds the Arrow table (DuckDB does) sees the next tick without being told.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable
from itertools import count
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ssduck.geometry import Array

# What is asked for like a table: the masses, which others may change in a simulation of theirs.
MASSES = "masses"
# The collision margins, likewise.
MARGINS = "margins"
# So many ticks is what was asked for read without another question.
FORGOTTEN_AFTER = 240

_versions = count(1)

ColumnType: TypeAlias = Literal["real", "integer", "text", "flag", "points", "triples"]
_ARROW: dict[ColumnType, pa.DataType] = {
    "real": pa.float64(),
    "integer": pa.int64(),
    "text": pa.string(),
    "flag": pa.bool_(),
    "points": pa.list_(pa.list_(pa.float64(), 3)),
    "triples": pa.list_(pa.list_(pa.int32(), 3)),
}


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
_BOX = _reals("xmin ymin zmin xmax ymax zmax", "axis-aligned box of the shapes, exact, m")

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


class LiveTable:
    """The columns of one table.

    Attributes:
        arrow: the table; its numbers change in place.
        version: another one whenever `arrow` became another object; no two tables have the same.
        whole: whether every number is known; an unknown one is NaN here and NULL in `arrow`.
    """

    def __init__(self, columns: tuple[Column, ...]) -> None:
        self.columns = columns
        self.fill(0, {})

    def fill(self, count: int, values: dict[str, Any]) -> None:
        """Make the table anew with that many rows; columns without values start at 0."""
        self.count = count
        kinds: dict[str, ColumnType] = {column.name: column.type for column in self.columns}
        self._numbers: dict[str, npt.NDArray[Any]] = {}
        # What is given with gaps stays as it is given; the rest are buffers to be written.
        live = [
            (name, kind)
            for name, kind in kinds.items()
            if kind in ("real", "integer") and not _has_none(values.get(name, ()))
        ]
        # One block for all reals: neighbouring columns can be written in one go.
        reals = [name for name, kind in live if kind == "real"]
        self.block = np.zeros((len(reals), count))
        self._row = {name: row for row, name in enumerate(reals)}
        for name, kind in live:
            if kind == "real":
                self._numbers[name] = self.block[self._row[name]]
            else:
                self._numbers[name] = np.zeros(count, dtype=np.int64)
        self._others = {
            name: pa.array(values[name] if name in values else [None] * count, _ARROW[kind])
            for name, kind in kinds.items()
            if name not in self._numbers
        }
        for name, column in self._numbers.items():
            if name in values:
                column[:] = values[name]
        self.publish()

    def put(self, values: dict[str, Any]) -> None:
        """Put other values in the place of columns that hold no numbers."""
        kinds = {column.name: column.type for column in self.columns}
        new = {name: pa.array(column, _ARROW[kinds[name]]) for name, column in values.items()}
        self._others = self._others | new
        self.publish()

    def twin(self) -> LiveTable:
        """The same rows in buffers of their own; what is never written in place is shared."""
        twin = copy.copy(self)
        twin.block = self.block.copy()
        twin._numbers = {  # noqa: SLF001  # one class
            name: twin.block[self._row[name]] if name in self._row else column.copy()
            for name, column in self._numbers.items()
        }
        twin.publish()
        return twin

    def publish(self) -> None:
        """Make the Arrow table anew: its numbers look into the buffers, but for unknown ones."""
        unknown = np.logical_or.reduce(np.isnan(self.block), axis=1)
        self.whole = not any(unknown)
        arrays = []
        for name, kind, *_ in self.columns:
            if name not in self._numbers:
                arrays.append(self._others[name])
            elif name in self._row and unknown[self._row[name]]:
                arrays.append(pa.array(self._numbers[name], from_pandas=True))
            else:
                buffer = pa.py_buffer(self._numbers[name])
                arrays.append(pa.Array.from_buffers(_ARROW[kind], self.count, [None, buffer]))
        self.arrow = pa.table(arrays, names=[column.name for column in self.columns])
        self.version = next(_versions)

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        """The buffer of a column of numbers."""
        return self._numbers[name]

    def reals(self, first: str, last: str) -> Array:
        """The buffers of neighbouring columns of reals, (columns, rows)."""
        return self.block[self._row[first] : self._row[last] + 1]

    def written(self) -> None:
        """Tell that numbers were written: an unknown one (NaN) becomes NULL."""
        if not self.whole or np.isnan(self.block).any():
            self.publish()


def _has_none(values: Iterable[Any]) -> bool:
    return any(value is None for value in values)
