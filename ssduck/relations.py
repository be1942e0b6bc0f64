"""What a relation is: what it takes and yields, its formula, its help, its DuckDB macro."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
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


# A pair of entities in SQL is one number, the first id times this and the second: DuckDB takes and
# sorts one number in less time than two.
MOST_IDS = 1 << 32

# Of an entity's numbers these may be infinite; the others are finite or unknown.
BOX = ("xmin", "ymin", "zmin", "xmax", "ymax", "zmax")


@dataclass(frozen=True)
class Parameter:
    """A parameter of a relation; optional ones come last.

    They come together or not at all, but where a relation has a formula for the first one alone.
    """

    name: str
    type: ValueType
    meaning: str
    optional: bool = False


@dataclass(frozen=True)
class Candidates:
    """Where the pairs of a tick are found of which a relation of two entities may hold.

    Attributes:
        of: those that collide; whose clearance is at most `apart`; of which one rests on the other;
            or whose boxes are no farther apart along any axis, in which case the relation is still
            to be asked about each.
        apart: metres, a DuckDB expression over parameters that are values.
        sliced: the same with the optional parameters given.
    """

    of: Literal["colliding", "within", "resting", "meeting"]
    apart: str = "0"
    sliced: str = "0"

    @property
    def are_exact(self) -> bool:
        """Whether the relation holds of all of them."""
        return self.of != "meeting"

    @property
    def take_distance(self) -> bool:
        """Whether they depend on `apart`."""
        return self.of in ("within", "meeting")

    @property
    def are_of_many_ticks(self) -> bool:
        """Whether they can be found at many ticks at once."""
        return self.of in ("colliding", "within")


@dataclass(frozen=True)
class Relation:
    """A function of entities that runs as SQL.

    Attributes:
        name: in SelectScript and in SQL.
        parameters: what it takes.
        result: what it yields.
        formula: a DuckDB expression over the columns of its parameters.
        sliced: the same with the optional parameters given.
        sliced_result: what that yields, where it is another type.
        about: what it means, in a sentence or two, with its boundary.
        unit: of the result.
        symmetric: whether the order of two entities does not matter.
        element: of a list, what its elements are.
        apart: of a formula that looks things up, what it is of entities of two worlds.
        asked: of one that calls the narrow phase, on which pairs it does.
        candidates: where all pairs of a tick are found of which it may hold.
        then: of one that looks up what differs from tick to tick, its formula in a macro for rows
            of a recorded tick.
        of_lists: of one that has another meaning for two lists, that formula.
        far: what it yields of entities whose boxes are apart: at least as much, or 0.
        partly: the formula with the first of two optional parameters given, and not the other.
        reads: of one that calls Python for what is no shape, the table that it looks at.
        may_fail: whether there are entities that it is an error of.
    """

    name: str
    parameters: tuple[Parameter, ...]
    result: ValueType
    formula: str
    about: str
    sliced: str | None = None
    sliced_result: ValueType | None = None
    unit: str = ""
    symmetric: bool = False
    element: ValueType = "real"
    apart: str = ""
    asked: str = ""
    candidates: Candidates | None = None
    then: str = ""
    of_lists: str = ""
    far: Literal["", "more", "nothing"] = ""
    partly: str | None = None
    reads: str = ""
    may_fail: bool = False

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

    def yields(self, count: int) -> ValueType:
        """What it yields, by the number of arguments."""
        given = count > self.required and self.sliced_result is not None
        return self.sliced_result if given and self.sliced_result else self.result

    @cached_property
    def expressions(self) -> dict[int, exp.Expr]:
        """The formula as a tree, by the number of arguments."""
        found = {self.required: _parsed(self.formula)}
        if self.sliced is not None:
            found[len(self.parameters)] = _parsed(self.sliced)
        if self.partly is not None:
            found[self.required + 1] = _parsed(self.partly)
        return found

    def apart_of(self, count: int) -> exp.Expr:
        """How far apart its candidates are, by the number of arguments."""
        assert self.candidates is not None
        far = self.candidates.apart if count == self.required else self.candidates.sliced
        return _parsed(far)

    @cached_property
    def is_unbounded(self) -> bool:
        """Whether it may be infinite: it is of boxes, and that of a plane is."""
        tree = self.expressions[self.required]
        of_box = any(column.name in BOX for column in tree.find_all(exp.Column))
        of_shapes = tree.find(exp.Placeholder) is not None and not self.reads
        return self.result in ("real", "list") and (of_box or of_shapes)

    @cached_property
    def when_apart(self) -> exp.Expr:
        """What it is of entities of two worlds, if it looks things up in one."""
        return _parsed(self.apart)

    @cached_property
    def tables(self) -> frozenset[str]:
        """The tables that it looks things up in."""
        tree = self.expressions[self.required]
        tables = {table.name for table in tree.find_all(exp.Table)}
        if tree.find(exp.Placeholder) is not None:
            tables.add(self.reads or "shapes")
        return frozenset(tables)

    def _now_or_then(self, tree: exp.Expr, schema: str) -> exp.Expr:
        """A formula of what is looked up: now, or at the tick of a row that was recorded."""
        if not self.then:
            return tree
        row = exp.column("tick", table=self.parameters[0].name)
        present = exp.select("max(tick)").from_(exp.table_("ticks", db=schema)).subquery()
        then = in_schema(_parsed(self.then), schema)
        return exp.case().when(exp.EQ(this=row, expression=present), tree).else_(then)

    def macro(self, schema: str | None = None, *, inside: bool = False) -> str:
        """The statement that makes the DuckDB macro of the same name.

        Args:
            schema: that of the world that it looks things up in; without one it fails.
            inside: whether the macro is one of that schema, rather than one for all.
        """
        name = exp.to_identifier(self.name, quoted=True).sql("duckdb")
        place = f"TEMP MACRO {name}"
        if inside:
            place = f"MACRO {exp.to_identifier(str(schema), quoted=True).sql('duckdb')}.{name}"
        return f"CREATE OR REPLACE {place} {_overloads(self, schema)}"

    def comment(self, schema: str | None = None) -> str:
        """The statement that lets DuckDB's own list of functions say what the macro does.

        Args:
            schema: whose macro it is; without one, that for all.
        """
        place = ("temp", "main") if schema is None else (schema,)
        parts = (exp.to_identifier(part, quoted=True).sql("duckdb") for part in (*place, self.name))
        return (
            f"COMMENT ON MACRO {'.'.join(parts)} IS {exp.Literal.string(self.help).sql('duckdb')}"
        )

    def body(self, tree: exp.Expr, schema: str | None) -> exp.Expr:
        """A formula as a macro has it, in the schema that it looks things up in."""
        if not self.tables:
            return tree
        if schema is not None:
            return self._now_or_then(in_schema(_lenient(tree), schema), schema)
        reason = (
            f"{self.name}: in SQL it is for one world, and there is none or several; write the "
            f"name of the world that is meant before it, world.{self.name}(…)"
        )
        return exp.Anonymous(this="error", expressions=[exp.Literal.string(reason)])


# What a function of joints is called where other rows may have what is asked for.
ANY = "any "


def _lenient(tree: exp.Expr) -> exp.Expr:
    """A formula for raw SQL, whose conditions come in no order: see `ssduck.families.joints`."""

    def renamed(part: exp.Expr) -> exp.Expr:
        if isinstance(part, exp.Anonymous) and part.name.startswith("joints "):
            part.set("this", exp.to_identifier(ANY + part.name, quoted=True))
        return part

    found: exp.Expr = tree.copy().transform(renamed)
    return found


# DuckDB has functions of texts that are called so; they go on being there.
_OF_TEXTS = ("contains", "position")


@cache
def _overloads(relation: Relation, schema: str | None) -> str:
    """What a macro takes and is, by the number of arguments: written once, for it takes long."""
    found = [
        f"({', '.join(p.name for p in relation.parameters[:count])}) "
        f"AS ({relation.body(tree, schema).sql('duckdb')})"
        for count, tree in relation.expressions.items()
    ]
    if relation.of_lists:
        found.insert(0, f"(a DOUBLE[], b DOUBLE[]) AS ({relation.of_lists})")
    if relation.name in _OF_TEXTS:
        found.insert(0, f"(a VARCHAR, b VARCHAR) AS (system.main.{relation.name}(a, b))")
    return ", ".join(found)


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
    """A formula with the tables of that schema, and the narrow phase of its world."""
    found = formula.copy()
    for table in list(found.find_all(exp.Table)):
        table.set("db", exp.to_identifier(schema))
    for world in list(found.find_all(exp.Placeholder)):
        world.replace(exp.Literal.string(schema))
    return found


def _listed(parameters: tuple[Parameter, ...]) -> str:
    required = ", ".join(p.name for p in parameters if not p.optional)
    optional = "".join(f", {p.name}" for p in parameters if p.optional)
    return f"{required}[{optional}]" if optional else required
