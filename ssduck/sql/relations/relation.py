"""The description of a relation: its parameters, formula, help and DuckDB macro."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Literal, TypeAlias

import sqlglot
from sqlglot import exp

from ssduck.schema import ALL_ENTITIES, BOX, LINK_FACTOR, MARGINS, MASSES, TWIST, VELOCITIES
from ssduck.simulators.contact_pairs import ContactPairs
from ssduck.sql.relations.geometry_query import CandidatePairs, GeometryQuery

# What an expression yields. `place` is an entity or a point [x, y, z]; `array` is an array of
# numpy that may be a point; `number` is real or integer from case to case; `record` is a dict of
# the same keys each time; `any` is a value that only Python knows.
ValueType: TypeAlias = Literal[
    "entity",
    "place",
    "double",
    "integer",
    "number",
    "string",
    "boolean",
    "list",
    "array",
    "record",
    "nothing",
    "any",
]


@dataclass(frozen=True)
class Parameter:
    """A parameter of a relation; optional ones come last.

    Either all optional ones are given or none, unless there is a formula for the first one alone.
    """

    name: str
    type: ValueType
    meaning: str
    optional: bool = False
    default: str = ""  # what its margin has in place of an optional number that is not given


@dataclass(frozen=True)
class Relation:
    """A function of entities that runs as SQL.

    >>> box = Parameter("object", "entity", "an entity")
    >>> height = Relation("height", (box,), "double", "object.zmax - object.zmin", "Its height.")
    >>> height.usage
    'height(object) -> float'
    >>> height.macro()
    'CREATE OR REPLACE TEMP MACRO "height" (object) AS (object.zmax - object.zmin)'
    """

    name: str  # its name in SelectScript and in SQL
    parameters: tuple[Parameter, ...]  # its parameters
    result: ValueType  # the type of its result
    formula: str  # a DuckDB expression over the columns of its parameters
    about: str  # its meaning and its boundary, in a sentence or two
    # The formulas with optional parameters given: with all of them, or with the first and with all.
    options: tuple[str, ...] = ()
    # The type of its result then, if it is another one.
    result_with_options: ValueType | None = None
    unit: str = ""  # the unit of the result
    is_symmetric: bool = False  # whether the order of two entities does not matter
    element: ValueType = "double"  # the type of the elements, if the result is a list
    geometry: GeometryQuery | None = None  # the function of shapes that it calls, if any
    # The pairs of a tick of which it may hold, if they can be found at once.
    candidate_pairs: CandidatePairs | None = None
    # The formula of a macro for rows of a recorded tick, if it looks up what differs from tick to
    # tick.
    recorded_formula: str = ""
    link_formula: str = ""  # the formula where an entity may be a link, if it is another one
    site_formula: str = ""  # the formula where the first entity is a site, whose row has its region
    link_name: str = "name"  # the column of a link that stands for `name`
    list_formula: str = ""  # the formula for two lists, if it has another meaning for them
    aliases: tuple[str, ...] = ()  # other names; a name that raw SQL has to quote has one
    alias_of: str = ""  # the first name, if this is another one
    python_table: str = ""  # the table that its Python function reads, if that is not of shapes
    # What to fetch before it is evaluated that its formula does not show.
    further_inputs: frozenset[str] = frozenset()
    # Of a condition, its margin in SelectScript: more than 0 where it holds, less where it does
    # not; and that with optional parameters given, if it is another one.
    margin: str = ""
    margin_with_options: str = ""
    may_fail: bool = False  # whether there are entities for which it is an error
    positive_only_if: str = ""  # the relation of the entities that holds where the value is above 0
    # The function of contacts that returns the same for two entities of a tick.
    of_contacts: Callable[[ContactPairs, int, int], bool | float] | None = None

    @property
    def usage(self) -> str:
        """`name(parameters) -> result`, as in its help."""
        return f"{self.name}({_parameter_list(self.parameters)}) -> {_RESULT_WORDS[self.result]}"

    @property
    def help(self) -> str:
        """The text of `help('name')` after the name."""
        sentences = (self.about, self.unit_note, self.margin_note, self.alias_note)
        return " ".join(filter(None, sentences)) + f"\nUsage: {self.usage}"

    @property
    def unit_note(self) -> str:
        """A sentence about the unit of the result; empty if it has none."""
        return f"Unit: {self.unit}." if self.unit else ""

    @property
    def margin_note(self) -> str:
        """A sentence about what `robustness` of it is; empty if it has no margin."""
        return f"Margin: {self.margin}." if self.margin else ""

    @property
    def alias_note(self) -> str:
        """A sentence about its other names; empty if it has none."""
        if self.alias_of:
            return f"The same as {self.alias_of}, which raw SQL has to quote."
        if self.aliases:
            return f"Also called {', '.join(self.aliases)}, which raw SQL need not quote."
        return ""

    @property
    def required_count(self) -> int:
        """The least number of arguments."""
        return sum(not parameter.optional for parameter in self.parameters)

    def margin_of(self, count: int) -> str:
        """Returns its margin in SelectScript, of a number of arguments; empty if it has none."""
        given = self.parameters[self.required_count : count]
        margin = (given and self.margin_with_options) or self.margin
        return margin if all(parameter.name in margin for parameter in given) else ""

    def result_type(self, count: int) -> ValueType:
        """Returns the type of its result, by the number of arguments."""
        if count > self.required_count and self.result_with_options is not None:
            return self.result_with_options
        return self.result

    @cached_property
    def expressions(self) -> dict[int, exp.Expr]:
        """The formula as a tree, by the number of arguments."""
        counts = range(len(self.parameters) + 1 - len(self.options), len(self.parameters) + 1)
        formulas = dict(zip(counts, self.options, strict=True))
        return {
            count: _parsed(formula)
            for count, formula in {self.required_count: self.formula, **formulas}.items()
        }

    @cached_property
    def link_expressions(self) -> dict[int, exp.Expr]:
        """The formula where an entity may be a link, as a tree, by the number of arguments.

        A link has the relations to its entity that an entity has to itself.
        """
        trees = dict(self.expressions)
        if self.link_formula:
            trees[self.required_count] = _parsed(self.link_formula)
        return {count: _with_own_links(tree) for count, tree in trees.items()}

    def formula_of(self, tables: Sequence[str], count: int) -> exp.Expr:
        """Returns the formula as a tree for rows of these tables, of a number of arguments."""
        if self.site_formula and tables[0] == "sites":
            return self._site_expression
        has_links = any(table != "entities" for table in tables)
        return (self.link_expressions if has_links else self.expressions)[count]

    @cached_property
    def _site_expression(self) -> exp.Expr:
        return _parsed(self.site_formula)

    def candidate_distance(self, count: int) -> exp.Expr:
        """Returns the largest distance of its candidate pairs, by the number of arguments."""
        pairs = self.candidate_pairs
        assert pairs is not None
        is_short = count == self.required_count
        return _parsed(pairs.distance if is_short else pairs.distance_with_options)

    @cached_property
    def _reads_boxes(self) -> bool:
        tree = self.expressions[self.required_count]
        return any(column.name in BOX for column in tree.find_all(exp.Column))

    @cached_property
    def may_be_infinite(self) -> bool:
        """Whether the result may be infinite: the box of a plane is."""
        return self.result in ("double", "list") and self.depends_on_shapes

    @cached_property
    def depends_on_shapes(self) -> bool:
        """Whether it depends on shapes or their boxes, and is not exact where boxes stand in."""
        return self._reads_boxes or self.geometry is not None

    @cached_property
    def across_worlds_expression(self) -> exp.Expr:
        """The error for entities of two worlds, if the formula looks things up in one."""
        return _parsed(
            f"error('{self.name}: these entities are of two worlds, and {self.name} is of "
            "entities of one')"
        )

    @cached_property
    def tables(self) -> frozenset[str]:
        """The tables in which it looks things up."""
        tree = self.expressions[self.required_count]
        tables = {table.name for table in tree.find_all(exp.Table)}
        if tree.find(exp.Placeholder) is not None:
            tables.add(self.python_table or "shapes")
        return frozenset(tables)

    @cached_property
    def macro_inputs(self) -> frozenset[str]:
        """The data to fetch before its macro is evaluated, whose rows may be of links."""
        tree = self.link_expressions[self.required_count]
        return self.inputs | {table.name for table in tree.find_all(exp.Table)}

    @cached_property
    def inputs(self) -> frozenset[str]:
        """The data to fetch before it is evaluated: tables, masses, margins, all entities."""
        tree = self.expressions[self.required_count]
        read = {column.name for column in tree.find_all(exp.Column)}
        uses_margins = self.geometry is not None and self.geometry.uses_margins
        result = self.tables | self.further_inputs | ({MASSES} if "mass" in read else frozenset())
        result |= {VELOCITIES} if read.intersection(TWIST) else frozenset()
        result |= {MARGINS} if uses_margins else frozenset()
        # A relation of two entities reads their contacts, one of a single entity all of its own.
        entities = [one for one in self.parameters if one.type == "entity"]
        reads_all = "contacts" in self.tables and len(entities) == 1
        reads_all |= self.geometry is not None and self.geometry.needs_whole_tick
        return result | ({ALL_ENTITIES} if reads_all else frozenset())

    def _checked(self, tree: exp.Expr, schema: str) -> exp.Expr:
        """Returns a formula for rows of users' SQL: these may be of another run, or changed."""
        rows = [p.name for p in self.parameters if p.type in ("entity", "place")]
        if tree.find(exp.Placeholder) is not None:
            result = _with_checked_ticks(in_schema(tree, schema), schema)
            return self.at_one_tick(result, [exp.column("tick", table=row) for row in rows])
        result = self._at_tick_of_rows(in_schema(tree, schema), schema, rows)
        run = exp.select("any_value(run)").from_(exp.table_("entities", db=schema)).subquery()
        another = [
            exp.and_(
                exp.column("id", table=row).is_(exp.null()).not_(),
                exp.NullSafeNEQ(this=exp.column("run", table=row), expression=run.copy()),
            )
            for row in rows
        ]
        failing = exp.func(
            "error", exp.Literal.string(_OTHER_RUN_MESSAGE.format(self.name, schema))
        )
        return exp.case().when(exp.or_(*another), failing).else_(result)

    def _at_tick_of_rows(self, tree: exp.Expr, schema: str, rows: Sequence[str]) -> exp.Expr:
        """Returns a formula that reads tables at the current tick, or at that of recorded rows."""
        if not self.recorded_formula:
            return tree
        ticks = [exp.column("tick", table=row) for row in rows]
        present = exp.select("max(tick)").from_(exp.table_("ticks", db=schema)).subquery()
        recorded = in_schema(_with_own_links(_parsed(self.recorded_formula)), schema)
        is_present = exp.EQ(this=ticks[0].copy(), expression=present)
        return self.at_one_tick(exp.case().when(is_present, tree).else_(recorded), ticks)

    def at_one_tick(self, formula: exp.Expr, ticks: Sequence[exp.Expr]) -> exp.Expr:
        """Returns a formula that is an error if its entities are not all at the same tick."""
        first, *others = ticks
        differ = [exp.NEQ(this=first.copy(), expression=other.copy()) for other in others]
        if not differ:
            return formula
        message = exp.Literal.string(_TWO_TICKS_MESSAGE.format(self.name))
        return exp.case().when(exp.or_(*differ), exp.func("error", message)).else_(formula)

    def macro(self, schema: str | None = None, *, inside: bool = False) -> str:
        """Returns the statement that makes the DuckDB macro of the same name."""
        name = exp.to_identifier(self.name, quoted=True).sql("duckdb")
        place = f"TEMP MACRO {name}"
        if inside:
            place = f"MACRO {exp.to_identifier(str(schema), quoted=True).sql('duckdb')}.{name}"
        return f"CREATE OR REPLACE {place} {_overloads(self, schema)}"

    def comment(self, schema: str | None = None) -> str:
        """Returns the statement that describes the macro in DuckDB's own list of functions."""
        place = ("temp", "main") if schema is None else (schema,)
        parts = (exp.to_identifier(part, quoted=True).sql("duckdb") for part in (*place, self.name))
        return (
            f"COMMENT ON MACRO {'.'.join(parts)} IS {exp.Literal.string(self.help).sql('duckdb')}"
        )

    def macro_body(self, tree: exp.Expr, schema: str | None) -> exp.Expr:
        """Returns the body of a macro, with the schema in which it looks things up."""
        if not self.tables:
            return tree
        if schema is not None:
            return self._checked(_lenient_joints(tree), schema)
        reason = (
            f"{self.name}: in SQL it needs one world, and there is none or several; write the "
            f"name of the world before it, world.{self.name}(…)"
        )
        return exp.Anonymous(this="error", expressions=[exp.Literal.string(reason)])


def by_name(relations: Iterable[Relation]) -> dict[str, Relation]:
    """Relations by their names; an alias is a relation that differs only in its name."""
    result: dict[str, Relation] = {}
    for relation in relations:
        seconds = (
            replace(relation, name=n, aliases=(), alias_of=relation.name) for n in relation.aliases
        )
        for named in (relation, *seconds):
            if named.name in result:
                raise ValueError(f"there are two relations {named.name!r}")
            result[named.name] = named
    return result


_OTHER_RUN_MESSAGE = (
    "{}: a row is of another run than {}: its contacts and sensings are not known here; open the "
    "record of its run, or write the name of its world before the relation"
)
_TWO_TICKS_MESSAGE = (
    "{}: the entities are of two ticks: compare those of one, in SQL a.tick = b.tick; of two ticks "
    "there are positions: distance(a, b)"
)
# The columns of a row that identify its entity and tick, and its pose, which is checked.
IDENTIFYING_COLUMNS = ("run", "tick", "id", "x", "y", "z", "qw", "qx", "qy", "qz")
CHECKED_TICK_UDF = "narrow tick"


def _with_checked_ticks(formula: exp.Expr, schema: str) -> exp.Expr:
    """Returns a formula whose calls of the narrow phase check the world and the pose of rows."""

    def checked(part: exp.Expr) -> exp.Expr:
        if not (isinstance(part, exp.Column) and part.name == "tick"):
            return part
        columns = [exp.column(name, table=part.table) for name in IDENTIFYING_COLUMNS]
        world = exp.Literal.string(schema)
        name = exp.to_identifier(CHECKED_TICK_UDF, quoted=True)
        return exp.Anonymous(this=name, expressions=[world, *columns])

    result: exp.Expr = formula.transform(checked)
    return result


# What a function of joints is called where other rows may have what is asked for.
LENIENT_PREFIX = "any "


def _lenient_joints(tree: exp.Expr) -> exp.Expr:
    """Returns a formula for raw SQL, whose conditions have no order: see `motion`."""

    def renamed(part: exp.Expr) -> exp.Expr:
        if isinstance(part, exp.Anonymous) and part.name.startswith("joints "):
            part.set("this", exp.to_identifier(LENIENT_PREFIX + part.name, quoted=True))
        return part

    result: exp.Expr = tree.copy().transform(renamed)
    return result


# DuckDB has functions of texts that are called so; they go on being there.
_TEXT_FUNCTIONS = ("contains", "position")
# What DuckDB makes of `x IN list`; the lists that it goes on being there for are of these types.
_LIST_FUNCTION = "contains"
_LISTED = (
    *("BOOLEAN", "TINYINT", "SMALLINT", "INTEGER", "BIGINT", "HUGEINT"),
    *("UTINYINT", "USMALLINT", "UINTEGER", "UBIGINT", "FLOAT", "DOUBLE"),
    *("VARCHAR", "BLOB", "UUID", "DATE", "TIME", "TIMESTAMP", "INTERVAL"),
)


def overloads_of_others(relation: Relation) -> list[str]:
    """Returns the parameters and bodies of the macro of a relation for texts and for lists."""
    result = []
    if relation.list_formula:
        result.append(f"(a DOUBLE[], b DOUBLE[]) AS ({relation.list_formula})")
    body = f"(system.main.{relation.name}(a, b))"
    if relation.name in _TEXT_FUNCTIONS:
        result.append(f"(a VARCHAR, b VARCHAR) AS {body}")
    if relation.name == _LIST_FUNCTION:
        result.append('(a "NULL", b) AS (NULL)')
        result += [f"(a {type}[], b) AS {body}" for type in _LISTED]
    return result


@cache
def _overloads(relation: Relation, schema: str | None) -> str:
    """Returns the parameters and bodies of a macro, by the number of arguments."""
    result = [
        f"({', '.join(p.name for p in relation.parameters[:count])}) "
        f"AS ({relation.macro_body(tree, schema).sql('duckdb')})"
        for count, tree in relation.link_expressions.items()
    ]
    return ", ".join([*overloads_of_others(relation), *result])


_RESULT_WORDS: dict[ValueType, str] = {
    "entity": "object",
    "place": "object",
    "double": "float",
    "integer": "int",
    "string": "str",
    "boolean": "bool",
    "list": "list",
    "nothing": "nothing",
    "number": "number",
    "record": "dict",
    "any": "value",
}


def _parsed(formula: str) -> exp.Expr:
    return sqlglot.parse_one(formula, dialect="duckdb")


def in_schema(formula: exp.Expr, schema: str) -> exp.Expr:
    """Returns a formula with the tables of that schema, and the narrow phase of its world."""
    result = formula.copy()
    for table in list(result.find_all(exp.Table)):
        table.set("db", exp.to_identifier(schema))
    for world in list(result.find_all(exp.Placeholder)):
        world.replace(exp.Literal.string(schema))
    return result


def _with_own_links(tree: exp.Expr) -> exp.Expr:
    """Returns a formula in which a link and its entity are the same where `a.id = b.id` is."""

    def widened(part: exp.Expr) -> exp.Expr:
        if isinstance(part, exp.EQ | exp.NEQ) and part.sql() in _SAME_ENTITY:
            return _parsed(_SAME_ENTITY[part.sql()])
        return part

    result: exp.Expr = tree.copy().transform(widened)
    return result


_SAME_ENTITY = {
    "a.id = b.id": f"(a.id = b.id OR a.id = b.id % {LINK_FACTOR} OR b.id = a.id % {LINK_FACTOR})",
    "a.id <> b.id": f"(a.id <> b.id AND a.id <> b.id % {LINK_FACTOR} "
    f"AND b.id <> a.id % {LINK_FACTOR})",
}


def _parameter_list(parameters: tuple[Parameter, ...]) -> str:
    required = ", ".join(p.name for p in parameters if not p.optional)
    optional = "".join(f", {p.name}" for p in parameters if p.optional)
    return f"{required}[{optional}]" if optional else required
