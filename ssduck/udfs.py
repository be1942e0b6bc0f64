"""The relations: what each one means, in one registry.

From a `Relation` come the SelectScript function and its help, the DuckDB macro of the same name
for raw SQL, its row in the manual, and the tests that it has all of these.

A relation that is a formula of the columns of its entities is an SQL expression over them, and
Python is never called. Its parameters are rows of `entities`, or values. World frame, metres,
radians, kilograms; quaternions w, x, y, z. A relation of an entity with itself is False (a
distance 0); an unknown value is NULL.

A formula may look things up in another table of the entities' world, in a subquery that sees
nothing of the rows around it: a macro's parameters are unknown in there, and an alias of the rows
could be taken for a column of that table.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

import sqlglot
from sqlglot import exp

# What an expression yields. `place` is an entity or a point [x, y, z]; `number` is real or
# integer from case to case; `record` is a dict of the same keys each time; `any` is a value
# that only Python knows.
ValueType: TypeAlias = Literal[
    "entity",
    "place",
    "real",
    "integer",
    "number",
    "text",
    "flag",
    "list",
    "record",
    "nothing",
    "any",
]


# Of an entity's numbers these may be infinite; the others are finite or unknown.
BOX = ("xmin", "ymin", "zmin", "xmax", "ymax", "zmax")


@dataclass(frozen=True)
class Parameter:
    """A parameter of a relation; optional ones come last and together or not at all."""

    name: str
    type: ValueType
    meaning: str
    optional: bool = False


@dataclass(frozen=True)
class Relation:
    """A function of entities that runs as SQL.

    Attributes:
        name: in SelectScript and in SQL.
        parameters: what it takes.
        result: what it yields.
        formula: a DuckDB expression over the columns of its parameters.
        sliced: the same with the optional parameters given.
        about: what it means, in a sentence or two, with its boundary.
        unit: of the result.
        symmetric: whether the order of two entities does not matter.
        element: of a list, what its elements are.
        apart: of a formula that looks things up, what it is of entities of two worlds.
    """

    name: str
    parameters: tuple[Parameter, ...]
    result: ValueType
    formula: str
    about: str
    sliced: str | None = None
    unit: str = ""
    symmetric: bool = False
    element: ValueType = "real"
    apart: str = ""

    @property
    def usage(self) -> str:
        """`name(parameters) -> result`, as in its help."""
        return f"{self.name}({_listed(self.parameters)}) -> {_RESULT_WORDS[self.result]}"

    @property
    def help(self) -> str:
        """What `help('name')` tells after the name."""
        return f"{self.about}\nUsage: {self.usage}"

    @property
    def required(self) -> int:
        """How many arguments it takes at least."""
        return sum(not parameter.optional for parameter in self.parameters)

    @cached_property
    def expressions(self) -> dict[int, exp.Expr]:
        """The formula as a tree, by the number of arguments."""
        found = {self.required: _parsed(self.formula)}
        if self.sliced is not None:
            found[len(self.parameters)] = _parsed(self.sliced)
        return found

    @cached_property
    def is_unbounded(self) -> bool:
        """Whether it may be infinite: it is of boxes, and that of a plane is."""
        columns = self.expressions[self.required].find_all(exp.Column)
        return self.result in ("real", "list") and any(c.name in BOX for c in columns)

    @cached_property
    def when_apart(self) -> exp.Expr:
        """What it is of entities of two worlds, if it looks things up in one."""
        return _parsed(self.apart)

    @cached_property
    def tables(self) -> frozenset[str]:
        """The tables that it looks things up in."""
        tables = self.expressions[self.required].find_all(exp.Table)
        return frozenset(table.name for table in tables)

    def macro(self, schema: str | None = None) -> str:
        """The statement that makes the DuckDB macro of the same name.

        Args:
            schema: that of the tables that it looks things up in; without one it fails.
        """
        overloads = [
            f"({', '.join(p.name for p in self.parameters[:count])}) "
            f"AS ({self._body(tree, schema).sql('duckdb')})"
            for count, tree in self.expressions.items()
        ]
        return f'CREATE OR REPLACE TEMP MACRO "{self.name}" {", ".join(overloads)}'

    def _body(self, tree: exp.Expr, schema: str | None) -> exp.Expr:
        if not self.tables:
            return tree
        if schema is not None:
            return in_schema(tree, schema)
        reason = (
            f"{self.name}: in SQL it is for one world, and there is none or several; "
            f"join the table {', '.join(sorted(self.tables))} of the world that is meant"
        )
        return exp.Anonymous(this="error", expressions=[exp.Literal.string(reason)])


_RESULT_WORDS: dict[ValueType, str] = {
    "entity": "object",
    "place": "object",
    "real": "float",
    "integer": "int",
    "text": "str",
    "flag": "bool",
    "list": "list",
    "nothing": "nothing",
    "number": "number",
    "record": "dict",
    "any": "value",
}


def _parsed(formula: str) -> exp.Expr:
    return sqlglot.parse_one(formula, dialect="duckdb")


def in_schema(formula: exp.Expr, schema: str) -> exp.Expr:
    """A formula with the tables of that schema."""
    found = formula.copy()
    for table in list(found.find_all(exp.Table)):
        table.set("db", exp.to_identifier(schema))
    return found


def _listed(parameters: tuple[Parameter, ...]) -> str:
    required = ", ".join(p.name for p in parameters if not p.optional)
    optional = "".join(f"[, {p.name}" for p in parameters if p.optional)
    return required + optional + "]" * optional.count("[")


_ENTITY = (Parameter("object", "entity", "an entity"),)
_A_B = (Parameter("a", "entity", "an entity"), Parameter("b", "entity", "another entity"))
_SLICE = (
    Parameter("start", "integer", "the first number that is kept, from 0", optional=True),
    Parameter("stop", "integer", "the first number that is not kept", optional=True),
)


def _of_entity(name: str, result: ValueType, formula: str, about: str, unit: str = "") -> Relation:
    return Relation(name, _ENTITY, result, formula, about, unit=unit)


def _sliced(name: str, formula: str, about: str, unit: str) -> Relation:
    """A list of an entity, whole or from start to stop as Python slices."""
    part = (
        f"list_slice({formula}, CASE WHEN start < 0 THEN start ELSE start + 1 END, "
        "CASE WHEN stop < 0 THEN stop - 1 ELSE stop END)"
    )
    return Relation(name, _ENTITY + _SLICE, "list", formula, about, sliced=part, unit=unit)


_SENSOR = (Parameter("s", "entity", "a sensor"),)
_SENSOR_AND_OTHER = (*_SENSOR, Parameter("e", "entity", "another entity"))

_FOOTPRINT = "b.x BETWEEN a.xmin AND a.xmax AND b.y BETWEEN a.ymin AND a.ymax"

_LISTED = (
    _of_entity("id", "text", "object.name", "Returns the name of an object, unique in its world."),
    _of_entity(
        "type", "text", "object.kind", "Returns the kind of an object: robot, kinbody or sensor."
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
    Relation(
        "isSensing",
        _SENSOR_AND_OTHER,
        "flag",
        "(s.id, e.id) IN (SELECT sensor, entity FROM sensings)",
        "Checks if sensor s perceives e now: if one of its rays, pixels or contact points ends "
        "on e. False while s is switched off, for the body that s sits on, for a sensor, and for "
        "what is no sensor.",
        apart="FALSE",
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
    ),
)

RELATIONS: dict[str, Relation] = {relation.name: relation for relation in _LISTED}
