"""A query's tree to DuckDB SQL, through sqlglot.

`translate` takes a query and the shapes of its sources, and gives a `Plan`: one SELECT whose
columns are what SQL can do of the query, and what is left to Python. A part goes to SQL when
its types are known and SQL means the same by it; everything else is evaluated in Python on the
rows that the SQL leaves, over the parts of it that are columns. It knows no simulator and no
database.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, Protocol

from sqlglot import exp

from ssduck import language
from ssduck.errors import ArgumentError, UnknownNameError, UnsupportedError, nearest
from ssduck.language import (
    Assignment,
    Binary,
    Call,
    Given,
    If,
    Index,
    ListOf,
    Name,
    Node,
    Query,
    Source,
    This,
    Unary,
)
from ssduck.tables import TABLES
from ssduck.udfs import RELATIONS, Parameter, Relation, ValueType

# Calls that do something: they are made row by row, in order.
IMPURE = frozenset(("print", "eval", "clear", "var", "help", "getTime", "to"))


@dataclass(frozen=True)
class Tag:
    """The type of a value: what a plan depends on.

    Attributes:
        type: what it is.
        element: of a list, what its elements are.
        length: of a list, how many it has.
        schema: of an entity, the world that it is in.
    """

    type: ValueType
    element: ValueType | None = None
    length: int | None = None
    schema: str | None = None


@dataclass(frozen=True)
class Shape:
    """What a source is, and what it is called.

    A source without a schema is a list of values, or of entities of one world if `tag` says so;
    one with a schema and no tag is a world.
    """

    alias: str
    schema: str | None
    tag: Tag | None


class Names(Protocol):
    """What the translator needs to know of the interpreter's names."""

    def has_variable(self, name: str) -> bool:
        """Whether there is a variable of that name."""

    def has_source(self, alias: str) -> bool:
        """Whether a query around this one has a source of that name."""

    def tag(self, node: Node) -> Tag:
        """The type of the value of an expression that depends on no row of this query."""

    def check_call(self, node: Call) -> None:
        """Complain of an unknown function, or of a wrong number of arguments."""


@dataclass(frozen=True)
class Binding:
    """A parameter of the SQL.

    Attributes:
        name: of the parameter.
        node: the expression that it is the value of,
        column: or the column of the entity that the expression is.
        source: instead, the source that it lists the elements of.
        type: of the value.
    """

    name: str
    node: Node | None = None
    column: str | None = None
    source: str | None = None
    type: ValueType = "list"


@dataclass(frozen=True)
class Output:
    """A column of the SQL: its place, and of an entity's id the world that it is of."""

    index: int
    schema: str | None


@dataclass(frozen=True)
class Item:
    """A value for each row: a column, or an expression over columns left to Python."""

    node: Node
    output: Output | None


@dataclass(eq=False)
class Plan:
    """How a query runs.

    Attributes:
        select: the SQL as sqlglot's tree; `sql` is its text.
        bindings: its parameters.
        constants: what does not depend on rows, with the types that the plan relies on.
        known: the columns by the part of the tree that they are the value of.
        conditions: parts of WHERE that are left to Python, in order.
        items: what is selected.
        names: what each selected item is called: a text, or an item to be evaluated.
        order: keys that are left to Python, with whether they descend.
        limit: LIMIT, if it is left to Python.
        elements: the column of each source's element, by alias.
        once: constants that are left to Python.
        bare: bare names that were looked up, and whether there was a variable of that name.
    """

    query: Query
    shapes: tuple[Shape, ...]
    select: exp.Select = field(default_factory=exp.Select)
    sql: str = ""
    bindings: list[Binding] = field(default_factory=list)
    constants: dict[Node, Tag] = field(default_factory=dict)
    known: dict[Node, Output] = field(default_factory=dict)
    conditions: list[Node] = field(default_factory=list)
    items: list[Item] = field(default_factory=list)
    names: list[str | Item] = field(default_factory=list)
    order: list[tuple[Item, bool]] = field(default_factory=list)
    limit: Node | None = None
    elements: dict[str, Output] = field(default_factory=dict)
    once: list[Node] = field(default_factory=list)
    bare: dict[str, bool] = field(default_factory=dict)

    @cached_property
    def outputs(self) -> list[Output] | None:
        """The columns that the selected items are, if nothing is left to Python."""
        if self.left or not all(isinstance(name, str) for name in self.names):
            return None
        return [item.output for item in self.items if item.output is not None]

    @property
    def numbers(self) -> dict[str, Literal["real", "integer"]] | None:
        """The types of its parameters if all of them are numbers."""
        types: dict[str, Literal["real", "integer"]] = {}
        for binding in self.bindings:
            if binding.type not in ("real", "integer"):
                return None
            types[binding.name] = binding.type
        return types

    def fits(self, shapes: tuple[Shape, ...], names: Names) -> bool:
        """Whether it runs as it is for sources of these shapes and the present variables."""
        return (
            self.shapes == shapes
            and all(names.has_variable(name) == known for name, known in self.bare.items())
            and all(names.tag(node) == tag for node, tag in self.constants.items())
        )

    @property
    def left(self) -> list[Node]:
        """What is left to Python."""
        items = [item.node for item in self.items if item.output is None]
        names = [name.node for name in self.names if isinstance(name, Item) and not name.output]
        keys = [item.node for item, _ in self.order]
        return [*self.conditions, *items, *names, *keys, *([self.limit] if self.limit else [])]


def translate(query: Query, shapes: Sequence[Shape], names: Names) -> Plan:
    """Plan a query.

    Args:
        query: the query.
        shapes: what its sources are, in order.
        names: variables, functions, and the types of what is constant in the query.

    Raises:
        SelectScriptError: a name or a number of arguments is wrong, or a construct is not
            supported.
    """
    return _Translator(query, tuple(shapes), names).plan()


class _NotSqlError(Exception):
    """A part that is left to Python."""


@dataclass(frozen=True)
class _Value:
    """A part as SQL, its type, and for an entity how to get at its columns."""

    given: exp.Expr | None
    tag: Tag
    column: Callable[[str], exp.Expr] | None = None
    elements: tuple[_Value, ...] | None = None

    @property
    def sql(self) -> exp.Expr:
        """The value; of an entity its id."""
        if self.given is not None:
            return self.given
        assert self.column is not None
        return self.column("id")


_NUMBERS = ("real", "integer")
_COLUMN_TYPES: dict[str, ValueType] = {
    column.name: column.type
    for column in TABLES["entities"]
    if column.type in ("real", "integer", "text", "flag")
}
_COMPARISONS = {"==": exp.EQ, "!=": exp.NEQ, ">=": exp.GTE, ">": exp.GT, "<=": exp.LTE, "<": exp.LT}
_ARITHMETIC = {"+": exp.Add, "-": exp.Sub, "*": exp.Mul}


class _Translator:
    def __init__(self, query: Query, shapes: tuple[Shape, ...], names: Names) -> None:
        self.query = query
        self.shapes = {shape.alias: shape for shape in shapes}
        self.names = names
        self.only = shapes[0].alias if len(shapes) == 1 else None
        self.aliases = _sql_aliases(self.shapes)
        self.result = Plan(query, shapes)
        self.columns: list[exp.Expr] = []
        self.texts: dict[str, int] = {}

    # -- the whole query ------------------------------------------------------------------

    def plan(self) -> Plan:
        query, plan = self.query, self.result
        _refuse_what_is_missing(query)
        conditions = [self._condition(node) for node in _conjuncts(query.where)]
        for node, name in self._selected():
            plan.items.append(self._item(node))
            plan.names.append(name if isinstance(name, str) else self._item(name))
        order = self._order()
        self._limit()
        if plan.left:
            for alias in self.shapes:
                plan.elements[alias] = self._output(self._row(alias))
        for shape in plan.shapes:
            plan.select = (
                plan.select.from_(self._table(shape))
                if shape is plan.shapes[0]
                else plan.select.join(self._table(shape), join_type="cross")
            )
        plan.select = plan.select.select(*(self.columns or [exp.Literal.number(1)]))
        plan.select = plan.select.where(*[c for c in conditions if c is not None])
        if order:
            plan.select = plan.select.order_by(*order)
        plan.sql = plan.select.sql(dialect="duckdb")
        return plan

    def _condition(self, node: Node) -> exp.Expr | None:
        try:
            return self._truth(self.value(node))
        except _NotSqlError:
            self._leave(node)
            self.result.conditions.append(node)
            return None

    def _item(self, node: Node) -> Item:
        node = self._resolved(node)
        try:
            return Item(node, self._output(self.value(node)))
        except _NotSqlError:
            self._leave(node)
            return Item(node, None)

    def _selected(self) -> Iterator[tuple[Node, str | Node]]:
        """The selected expressions with their names."""
        if not self.query.items:
            for name in self.shapes:
                yield This(self.query.span, name), name
        for node in self.query.items:
            match node:
                case Call(name="to", arguments=(value, language.Literal(value=str() as name))):
                    yield value, name
                case Call(name="to", arguments=(value, name_node)):
                    yield value, name_node
                case Call(name="to"):
                    raise ArgumentError("to takes 2 arguments: to(value, name)", span=node.span)
                case Call() | Name():
                    yield node, node.name
                case This(alias=alias):
                    yield node, alias or "this"
                case _:
                    yield node, "value"

    def _order(self) -> list[exp.Expr]:
        """ORDER BY: the query's keys, then the order of the sources' elements."""
        keys = [(self._item(key.value), key.descending) for key in self.query.order]
        ordered: list[exp.Expr] = []
        if any(item.output is None for item, _ in keys):
            self.result.order = keys
        else:
            for item, descending in keys:
                assert item.output is not None
                key = self.columns[item.output.index].copy()
                ordered.append(exp.Ordered(this=key, desc=descending, nulls_first=False))
        # A scan keeps its order; a join, and be it with the row of parameters, need not.
        if len(self.shapes) > 1 or ordered or self.result.bindings:
            for shape in self.result.shapes:
                ordered.extend(self._position(shape))
        return ordered

    def _limit(self) -> None:
        plan = self.result
        if self.query.limit is None:
            return
        match self.query.limit:
            case language.Literal(value=int(number)) if not plan.conditions and not plan.order:
                plan.select = plan.select.limit(int(number))
            case limit:
                plan.limit = limit

    def _table(self, shape: Shape) -> exp.Expr:
        """A source as a table: the entities of a world, some of them, or numbered values."""
        alias = exp.to_identifier(self.aliases[shape.alias], quoted=True)
        if shape.tag is None:
            return exp.table_("entities", db=shape.schema, quoted=True, alias=alias)
        rows = self._parameter(shape.alias, Binding("", source=shape.alias))
        numbers = exp.func("generate_subscripts", rows, exp.Literal.number(1))
        if shape.tag.type == "any":
            numbered = exp.select(exp.alias_(numbers, "n"))
        else:
            name = "id" if shape.tag.type == "entity" else "value"
            values = exp.func("unnest", rows.copy())
            numbered = exp.select(exp.alias_(values, name), exp.alias_(numbers, "n"))
        if shape.tag.type != "entity":
            return numbered.subquery(alias)
        entities = exp.table_("entities", db=shape.tag.schema, quoted=True, alias="e")
        joined = exp.select("e.*", "i.n").from_(numbered.subquery("i")).join(entities, using=["id"])
        return joined.subquery(alias)

    def _position(self, shape: Shape) -> list[exp.Expr]:
        """The keys by which a source's elements are in their order."""
        if shape.tag is not None:
            return [self._column(shape.alias, "n")]
        sensors_first = exp.NEQ(
            this=self._column(shape.alias, "kind"), expression=exp.Literal.string("sensor")
        )
        return [sensors_first, self._column(shape.alias, "id")]

    # -- columns and parameters -----------------------------------------------------------

    def _column(self, alias: str, name: str) -> exp.Expr:
        return exp.column(name, table=self.aliases[alias], quoted=True)

    def _output(self, value: _Value) -> Output:
        text = value.sql.sql(dialect="duckdb")
        if text not in self.texts:
            self.texts[text] = len(self.columns)
            self.columns.append(value.sql)
        return Output(self.texts[text], value.tag.schema if value.tag.type == "entity" else None)

    def _leave(self, node: Node) -> None:
        """Leave a part to Python: fetch the largest parts of it that SQL can do."""
        if isinstance(node, Query) and not self._is_constant(node):
            return  # it runs by itself, and sees the elements
        if isinstance(node, Call) and node.name not in RELATIONS:
            self.names.check_call(node)
        if self._is_constant(node):
            self.result.once.append(node)
            return
        try:
            self.result.known[node] = self._output(self.value(node))
        except _NotSqlError:
            for child in node.children():
                self._leave(child)

    def _parameter(self, stem: str, wanted: Binding) -> exp.Expr:
        """A parameter for that binding: the same one for the same."""
        for binding in self.result.bindings:
            if replace(binding, name="") == wanted:
                return exp.Parameter(this=exp.var(binding.name))
        stem = stem if stem.isidentifier() else "value"
        taken = {binding.name.lower() for binding in self.result.bindings}
        candidates = (stem if n == 1 else f"{stem}_{n}" for n in range(1, len(taken) + 2))
        name = next(name for name in candidates if name.lower() not in taken)
        self.result.bindings.append(replace(wanted, name=name))
        return exp.Parameter(this=exp.var(name))

    # -- expressions ----------------------------------------------------------------------

    def _resolved(self, node: Node) -> Node:
        """With bare names in SELECT, GROUP BY or ORDER BY: variables, or functions of `this`."""

        def looked_up(part: Node) -> Node | None:
            if isinstance(part, Query):
                return part
            if not isinstance(part, Name):
                return None
            known = self.result.bare[part.name] = self.names.has_variable(part.name)
            if known:
                return part
            call = Call(part.span, part.name, (This(part.span, None),), part.span)
            self.names.check_call(call)
            return call

        return node.replaced(looked_up)

    def _is_constant(self, node: Node) -> bool:
        """Whether it is the same for all rows, and can be evaluated without a query of its own.

        A nested query that sees no row of this one is constant; a relation outside it is not:
        it becomes part of the SQL.
        """
        match node:
            case This(alias=alias) if alias is not None and alias not in self.shapes:
                if not self.names.has_source(alias):
                    raise UnknownNameError(
                        f"there is no source {alias!r} here",
                        span=node.span,
                        suggestions=nearest(alias, self.shapes) or list(self.shapes)[:3],
                    )
                return True
            case This():
                return False
            case Query():
                return not _free(node) & {None, *self.shapes} and not _is_impure(node)
            case Call(name=name) if name in RELATIONS or name in IMPURE:
                return False
            case Assignment():
                return False
        return all(self._is_constant(child) for child in node.children())

    def _own(self, node: This) -> bool:
        return node.alias is None or node.alias in self.shapes

    def _row(self, alias: str) -> _Value:
        shape = self.shapes[alias]
        if shape.tag is None or shape.tag.type == "entity":
            schema = shape.schema if shape.tag is None else shape.tag.schema
            return _Value(
                self._column(alias, "id"),
                Tag("entity", schema=schema),
                lambda name: self._column(alias, name),
            )
        if shape.tag.type == "any":
            return _Value(self._column(alias, "n"), shape.tag)
        return _Value(self._column(alias, "value"), shape.tag)

    def value(self, node: Node) -> _Value:
        """A part as SQL.

        Raises:
            _NotSqlError: it is left to Python.
        """
        match node:
            case This() if self._own(node):
                return self._this(node)
            case language.Literal(value=value):
                return _Value(exp.convert(value), self.names.tag(node))
        if self._is_constant(node):
            return self._constant(node)
        match node:
            case Call(name=name) if name in RELATIONS:
                return self._relation(RELATIONS[name], node)
            case Call():
                self.names.check_call(node)
                raise _NotSqlError
            case Unary(operator="NOT", operand=operand):
                return _Value(exp.Not(this=_wrapped(self._truth(self.value(operand)))), Tag("flag"))
            case Unary(operator=sign, operand=operand):
                inner = self._number(operand)
                return (
                    _Value(exp.Neg(this=_wrapped(inner.sql)), inner.tag) if sign == "-" else inner
                )
            case Binary():
                return self._binary(node)
            case Index(base=base, indices=(language.Literal(value=int() as index),)):
                elements = self.value(base).elements or ()
                if 0 <= index < len(elements):
                    return elements[index]
            case ListOf(items=items):
                return self._list([self.value(item) for item in items])
            case If(condition=condition, then=(then,), otherwise=(otherwise,)):
                return self._choice(condition, then, otherwise)
        raise _NotSqlError

    def _this(self, node: This) -> _Value:
        alias = node.alias if node.alias is not None else self.only
        if alias is None:
            raise ArgumentError(
                f"'this' alone is ambiguous here; write one of "
                f"{', '.join(f'{name}.this' for name in self.shapes)}",
                span=node.span,
            )
        value = self._row(alias)
        if value.tag.type == "any":
            raise _NotSqlError
        return value

    def _constant(self, node: Node) -> _Value:
        tag = self.result.constants.setdefault(node, self.names.tag(node))
        if tag.type == "any":
            raise _NotSqlError
        stem = node.name if isinstance(node, Name | Given) else "value"
        if tag.type != "entity":
            return _Value(self._parameter(stem, Binding("", node, type=tag.type)), tag)

        def column(name: str) -> exp.Expr:
            wanted = Binding("", node, name, type=_COLUMN_TYPES[name])
            return self._parameter(f"{stem}_{name}", wanted)

        return _Value(None, tag, column)  # its columns become parameters as they are asked for

    def _relation(self, relation: Relation, node: Call) -> _Value:
        self.names.check_call(node)
        count = len(node.arguments)
        values = {
            parameter.name: self._argument(parameter, argument)
            for parameter, argument in zip(relation.parameters, node.arguments, strict=False)
        }
        formula = relation.expressions[count]
        if relation.result == "entity":
            (entity,) = values.values()

            def column(name: str) -> exp.Expr:
                return _expanded(formula, values, name)

            return _Value(None, entity.tag, column)
        sql = _expanded(formula, values)
        if isinstance(sql, exp.Array):
            elements = tuple(_Value(part, Tag("real")) for part in sql.expressions)
            return _Value(sql, Tag("list", "real", len(elements)), elements=elements)
        return _Value(sql, Tag(relation.result, "real" if relation.result == "list" else None))

    def _argument(self, parameter: Parameter, node: Node) -> _Value:
        value = self.value(node)
        if value.tag.type == parameter.type:
            return value
        if parameter.type == "place" and value.tag.type == "entity":
            return value
        if parameter.type == "place" and value.tag.type == "list" and value.tag.element in _NUMBERS:
            if value.tag.length != 3:
                raise ArgumentError(
                    f"{parameter.name} is to be {parameter.meaning}, not a list of "
                    f"{value.tag.length if value.tag.length is not None else 'unknown length'}",
                    span=node.span,
                )
            index = {"x": 1, "y": 2, "z": 3}
            return _Value(
                value.sql,
                value.tag,
                lambda name: exp.func(
                    "list_extract", value.sql.copy(), exp.Literal.number(index[name])
                ),
            )
        raise ArgumentError(
            f"{parameter.name} is to be {parameter.meaning}, not {_worded(value.tag)}",
            span=node.span,
        )

    def _binary(self, node: Binary) -> _Value:
        sign = node.operator
        if sign in ("AND", "OR", "XOR"):
            left, right = (self._truth(self.value(side)) for side in (node.left, node.right))
            joined: exp.Expr
            if sign == "XOR":
                joined = exp.NEQ(this=_wrapped(left), expression=_wrapped(right))
            else:
                joined = exp.and_(left, right) if sign == "AND" else exp.or_(left, right)
            return _Value(exp.paren(joined), Tag("flag"))
        if sign in _ARITHMETIC:
            return self._arithmetic(_ARITHMETIC[sign], node)
        if sign == "/":
            return self._quotient(node)
        if sign in _COMPARISONS:
            return self._comparison(sign, self.value(node.left), self.value(node.right))
        if sign == "IN":
            return self._membership(self.value(node.left), self.value(node.right))
        raise _NotSqlError

    def _arithmetic(self, kind: type[exp.Binary], node: Binary) -> _Value:
        left, right = self._number(node.left), self._number(node.right)
        whole = left.tag.type == right.tag.type == "integer"
        sql = kind(this=_wrapped(left.sql), expression=_wrapped(right.sql))
        return _Value(exp.paren(sql), Tag("integer" if whole else "real"))

    def _quotient(self, node: Binary) -> _Value:
        """A division whose divisor cannot be 0; DuckDB would yield NULL, Python raises."""
        if not (isinstance(node.right, language.Literal) and node.right.value):
            raise _NotSqlError
        left, right = self._number(node.left), self._number(node.right)
        sql = exp.Div(this=_wrapped(left.sql), expression=right.sql, typed=False, safe=False)
        return _Value(exp.paren(sql), Tag("real"))

    def _comparison(self, sign: str, left: _Value, right: _Value) -> _Value:
        kinds = left.tag.type, right.tag.type
        alike = (
            all(kind in _NUMBERS for kind in kinds)
            or kinds == ("text", "text")
            or (sign in ("==", "!=") and kinds in (("entity", "entity"), ("flag", "flag")))
            or (sign in ("==", "!=") and kinds == ("list", "list") and _numeric(left, right))
        )
        if not alike or left.tag.schema != right.tag.schema:
            raise _NotSqlError
        kind = _COMPARISONS[sign]
        return _Value(kind(this=_wrapped(left.sql), expression=_wrapped(right.sql)), Tag("flag"))

    def _membership(self, left: _Value, right: _Value) -> _Value:
        if left.tag.type == right.tag.type == "text":
            return _Value(exp.func("contains", right.sql, left.sql), Tag("flag"))
        fits = right.tag.type == "list" and (
            (left.tag.type in _NUMBERS and right.tag.element in _NUMBERS)
            or (left.tag.type == "text" and right.tag.element == "text")
        )
        if not fits:
            raise _NotSqlError
        return _Value(exp.func("list_contains", right.sql, left.sql), Tag("flag"))

    def _list(self, values: list[_Value]) -> _Value:
        kinds = {value.tag.type for value in values}
        if len(kinds) != 1 or not kinds <= {"real", "text", "flag", "integer"}:
            raise _NotSqlError
        sql = exp.Array(expressions=[value.sql.copy() for value in values])
        return _Value(sql, Tag("list", kinds.pop(), len(values)), elements=tuple(values))

    def _choice(self, condition: Node, then: Node, otherwise: Node) -> _Value:
        first, second = self.value(then), self.value(otherwise)
        if first.tag != second.tag or first.tag.type == "entity":
            raise _NotSqlError
        case = exp.case().when(self._truth(self.value(condition)), first.sql).else_(second.sql)
        return _Value(case, first.tag)

    def _number(self, node: Node) -> _Value:
        value = self.value(node)
        if value.tag.type not in _NUMBERS:
            raise _NotSqlError
        return value

    def _truth(self, value: _Value) -> exp.Expr:
        """A value as a condition: numbers are true unless 0, texts unless empty."""
        match value.tag.type:
            case "flag":
                return value.sql
            case "real" | "integer":
                return exp.NEQ(this=_wrapped(value.sql), expression=exp.Literal.number(0))
            case "text":
                return exp.NEQ(this=_wrapped(value.sql), expression=exp.Literal.string(""))
            case "entity":
                return exp.Not(this=exp.Is(this=value.sql, expression=exp.Null()))
        raise _NotSqlError


def _expanded(formula: exp.Expr, values: Mapping[str, _Value], name: str | None = None) -> exp.Expr:
    """A relation's formula with its parameters put in.

    Args:
        formula: over columns of the parameters.
        values: what the parameters stand for.
        name: the column to be taken instead of `name`, for a relation that yields an entity.
    """

    def put_in(part: exp.Expr) -> exp.Expr:
        if not isinstance(part, exp.Column):
            return part
        if not part.table:
            return _wrapped(values[part.name].sql.copy())
        column = values[part.table].column
        assert column is not None, f"{part.table} has no columns"
        return column(name if name is not None and part.name == "name" else part.name)

    expanded: exp.Expr = formula.copy().transform(put_in)
    return exp.paren(expanded) if isinstance(expanded, exp.Connector) else expanded


def _sql_aliases(names: Iterable[str]) -> dict[str, str]:
    """What sources are called in SQL, which does not tell upper from lower case."""
    aliases: dict[str, str] = {}
    for name in names:
        taken = {alias.casefold() for alias in aliases.values()}
        alike = sum(name.casefold() == other.casefold() for other in aliases)
        alias = f"{name} {alike + 1}" if name.casefold() in taken else name
        aliases[name] = alias
    return aliases


def _wrapped(sql: exp.Expr) -> exp.Expr:
    """In parentheses where it is not a single term."""
    return (
        exp.paren(sql)
        if isinstance(sql, exp.Binary | exp.Unary) and not isinstance(sql, exp.Paren)
        else sql
    )


def _numeric(left: _Value, right: _Value) -> bool:
    return left.tag.element in _NUMBERS and right.tag.element in _NUMBERS


def _conjuncts(node: Node | None) -> Iterator[Node]:
    """The parts of a condition that are joined by AND, in order."""
    if isinstance(node, Binary) and node.operator == "AND":
        yield from _conjuncts(node.left)
        yield from _conjuncts(node.right)
    elif node is not None:
        yield node


def _free(node: Node) -> set[str | None]:
    """The aliases whose `this` a part mentions, and that no query in it has as a source."""
    if isinstance(node, This):
        return {node.alias}
    found: set[str | None] = set()
    for child in node.children():
        if not (isinstance(node, Query) and isinstance(child, Source)):
            found |= _free(child)
    if isinstance(node, Query):
        found -= {None, *(source.alias for source in node.sources)}
        for source in node.sources:  # a source sees what is around the query
            found |= _free(source)
    return found


def sees_outside(query: Query) -> bool:
    """Whether a nested query sees rows of the queries around it."""
    return bool(_free(query))


def _is_impure(node: Node) -> bool:
    return any(
        isinstance(part, Assignment) or (isinstance(part, Call) and part.name in IMPURE - {"to"})
        for part in node.walk()
    )


def _worded(tag: Tag) -> str:
    words: dict[ValueType, str] = {
        "entity": "an entity",
        "real": "a number",
        "integer": "a number",
        "text": "a text",
        "flag": "True or False",
        "list": "a list",
        "nothing": "nothing",
    }
    return words.get(tag.type, "such a value")


def _refuse_what_is_missing(query: Query) -> None:
    for node, words in (
        (query.recursion, "hierarchical queries (CONNECT BY)"),
        (query.group[0] if query.group else None, "GROUP BY"),
        (query.having, "HAVING"),
    ):
        if node is not None:
            raise UnsupportedError(f"{words}: not supported yet", span=node.span)


def unknown_function(node: Call, known: Sequence[str]) -> UnknownNameError:
    """The error for a function that is not there."""
    return UnknownNameError(
        f"there is no function {node.name!r}",
        span=node.name_span,
        suggestions=nearest(node.name, known),
    )
