"""What a relation is: what it takes and yields, its formula, its help, its DuckDB macro."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Literal, TypeAlias

import sqlglot
from sqlglot import exp

from ssduck.schema import BOX, MARGINS, MASSES

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
class CandidatePairs:
    """Where the pairs of a tick are found of which a relation of two entities may hold.

    Attributes:
        of: those that collide, deeper than `apart`; whose clearance is at most `apart`; that
            touch, so far apart and the margins of both; of which one rests on the other; or whose
            boxes are no farther apart along any axis, or no farther and the margins of both, in
            which cases the relation is still
            to be asked about each.
        apart: metres, a DuckDB expression over parameters that are values.
        sliced: the same with the optional parameters given.
    """

    of: Literal["colliding", "within", "touching", "resting", "meeting", "reaching"]
    apart: str = "0"
    sliced: str = "0"

    @property
    def are_exact(self) -> bool:
        """Whether the relation holds of all of them."""
        return self.of not in ("meeting", "reaching")

    @property
    def take_distance(self) -> bool:
        """Whether they depend on `apart`."""
        return self.of != "resting"

    @property
    def are_of_many_ticks(self) -> bool:
        """Whether they can be found at many ticks at once."""
        return self.of in ("colliding", "within", "touching")


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
        also: second names, for a name that raw SQL has to quote.
        second_of: of what is called by a second name, the first one.
        partly: the formula with the first of two optional parameters given, and not the other.
        looks_at: of one that calls Python for what is no shape, the table that it looks at.
        may_fail: whether there are entities that it is an error of.
        by_margins: whether the collision margins of shapes count.
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
    candidates: CandidatePairs | None = None
    then: str = ""
    of_lists: str = ""
    far: Literal["", "more", "nothing"] = ""
    also: tuple[str, ...] = ()
    second_of: str = ""
    partly: str | None = None
    looks_at: str = ""
    may_fail: bool = False
    by_margins: bool = False

    @property
    def usage(self) -> str:
        """`name(parameters) -> result`, as in its help."""
        return f"{self.name}({_listed(self.parameters)}) -> {_RESULT_WORDS[self.result]}"

    @property
    def help(self) -> str:
        """What `help('name')` tells after the name."""
        return " ".join(filter(None, (self.about, self.others))) + f"\nUsage: {self.usage}"

    @property
    def others(self) -> str:
        """A sentence about its other names; nothing if it has none."""
        if self.second_of:
            return f"The same as {self.second_of}, which raw SQL has to quote."
        if self.also:
            return f"Also called {', '.join(self.also)}, which raw SQL need not quote."
        return ""

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
        of_shapes = tree.find(exp.Placeholder) is not None and not self.looks_at
        return self.result in ("real", "list") and (of_box or of_shapes)

    @cached_property
    def is_of_shapes(self) -> bool:
        """Whether it asks shapes or their boxes: where a box stands in for a shape it is off."""
        tree = self.expressions[self.required]
        of_box = any(column.name in BOX for column in tree.find_all(exp.Column))
        return of_box or (tree.find(exp.Placeholder) is not None and not self.looks_at)

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
            tables.add(self.looks_at or "shapes")
        return frozenset(tables)

    @cached_property
    def reads(self) -> frozenset[str]:
        """What has to be asked for before it is evaluated: tables, masses, margins."""
        tree = self.expressions[self.required]
        of_mass = any(column.name == "mass" for column in tree.find_all(exp.Column))
        found = self.tables | ({MASSES} if of_mass else frozenset())
        return found | ({MARGINS} if self.by_margins else frozenset())

    def _of_rows(self, tree: exp.Expr, schema: str) -> exp.Expr:
        """A formula of rows that users give: they may be of another run, or changed."""
        rows = [p.name for p in self.parameters if p.type in ("entity", "place")]
        if tree.find(exp.Placeholder) is not None:
            return _with_checked_ticks(in_schema(tree, schema), schema)
        found = self._now_or_then(in_schema(tree, schema), schema, rows)
        run = exp.select("any_value(run)").from_(exp.table_("entities", db=schema)).subquery()
        another = [
            exp.and_(
                exp.column("id", table=row).is_(exp.null()).not_(),
                exp.NullSafeNEQ(this=exp.column("run", table=row), expression=run.copy()),
            )
            for row in rows
        ]
        failing = exp.func("error", exp.Literal.string(_OF_ANOTHER_RUN.format(self.name, schema)))
        return exp.case().when(exp.or_(*another), failing).else_(found)

    def _now_or_then(self, tree: exp.Expr, schema: str, rows: Sequence[str]) -> exp.Expr:
        """A formula of what is looked up: now, or at the tick of rows that were recorded."""
        if not self.then:
            return tree
        first, *others = (exp.column("tick", table=row) for row in rows)
        present = exp.select("max(tick)").from_(exp.table_("ticks", db=schema)).subquery()
        then = in_schema(_parsed(self.then), schema)
        found = exp.case()
        for other in others:
            told = exp.Literal.string(f"{self.name}: its rows are of two ticks of {schema}")
            found = found.when(exp.NEQ(this=first, expression=other), exp.func("error", told))
        return found.when(exp.EQ(this=first.copy(), expression=present), tree).else_(then)

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
            return self._of_rows(_lenient(tree), schema)
        reason = (
            f"{self.name}: in SQL it is for one world, and there is none or several; write the "
            f"name of the world that is meant before it, world.{self.name}(…)"
        )
        return exp.Anonymous(this="error", expressions=[exp.Literal.string(reason)])


def by_name(relations: Iterable[Relation]) -> dict[str, Relation]:
    """Relations by their names; each second name is of a relation that differs in that only.

    Raises:
        ValueError: two have the same name.
    """
    found: dict[str, Relation] = {}
    for relation in relations:
        seconds = (
            replace(relation, name=n, also=(), second_of=relation.name) for n in relation.also
        )
        for own in (relation, *seconds):
            if own.name in found:
                raise ValueError(f"there are two relations {own.name!r}")
            found[own.name] = own
    return found


_OF_ANOTHER_RUN = (
    "{}: a row is of another run than {}: what was found there is not known here; open the record "
    "that the row is of, or write the name of its world before the relation"
)
# The columns of a row by which it is known whose it is, and whether it is as it was.
TOLD_BY = ("run", "tick", "id", "x", "y", "z", "qw", "qx", "qy", "qz")
CHECKED_TICK = "narrow tick"


def _with_checked_ticks(formula: exp.Expr, schema: str) -> exp.Expr:
    """A formula whose calls of the narrow phase look at whose rows they are about."""

    def checked(part: exp.Expr) -> exp.Expr:
        if not (isinstance(part, exp.Column) and part.name == "tick"):
            return part
        columns = [exp.column(name, table=part.table) for name in TOLD_BY]
        world = exp.Literal.string(schema)
        name = exp.to_identifier(CHECKED_TICK, quoted=True)
        return exp.Anonymous(this=name, expressions=[world, *columns])

    found: exp.Expr = formula.transform(checked)
    return found


# What a function of joints is called where other rows may have what is asked for.
ANY = "any "


def _lenient(tree: exp.Expr) -> exp.Expr:
    """A formula for raw SQL, whose conditions come in no order: see `joints`."""

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
