"""A query's tree to DuckDB SQL, through sqlglot.

`translate` takes a query and the shapes of its sources, and gives a `Plan`: one SELECT whose
columns are what SQL can do of the query, and what is left to Python. A part goes to SQL when
its types are known and SQL means the same by it; everything else is evaluated in Python on the
rows that the SQL leaves, over the parts of it that are columns. It knows no simulator and no
database.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from sqlglot import exp

from ssduck import tree
from ssduck.errors import ArgumentError, UnknownNameError, UnsupportedError, nearest
from ssduck.expressions import Expressions, NotSqlError, SqlValue
from ssduck.plan import Binding, Item, Names, Output, Plan, Shape
from ssduck.tree import (
    Binary,
    Call,
    Name,
    Node,
    Query,
    This,
)
from ssduck.udfs import RELATIONS, ValueType


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


_MOST_ROWS = 2**62
_SQL_TYPES: dict[ValueType, str] = {
    "entity": "BIGINT",
    "integer": "BIGINT",
    "real": "DOUBLE",
    "text": "VARCHAR",
    "flag": "BOOLEAN",
    "any": "BIGINT",
}


class _Translator:
    def __init__(self, query: Query, shapes: tuple[Shape, ...], names: Names) -> None:
        self.query = query
        self.names = names
        self.sql = Expressions(shapes, names)
        self.result = Plan(query, shapes, bindings=self.sql.bindings, constants=self.sql.constants)
        self.columns: list[exp.Expr] = []
        self.texts: dict[str, int] = {}

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
            for alias in self.sql.shapes:
                plan.elements[alias] = self._output(self.sql.row(alias))
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
        # A part that turned out not to be SQL may have asked for parameters before it did.
        used = {parameter.name for parameter in plan.select.find_all(exp.Parameter)}
        plan.bindings = [binding for binding in plan.bindings if binding.name in used]
        plan.sql = plan.select.sql(dialect="duckdb")
        return plan

    def _condition(self, node: Node) -> exp.Expr | None:
        try:
            return self.sql.truth(self.sql.value(node))
        except NotSqlError:
            self._leave(node)
            self.result.conditions.append(node)
            return None

    def _item(self, node: Node) -> Item:
        node = self._resolved(node)
        try:
            return Item(node, self._output(self.sql.value(node)))
        except NotSqlError:
            self._leave(node)
            return Item(node, None)

    def _selected(self) -> Iterator[tuple[Node, str | Node]]:
        """The selected expressions with their names."""
        if not self.query.items:
            for name in self.sql.shapes:
                yield This(self.query.span, name), name
        for node in self.query.items:
            match node:
                case Call(name="to", arguments=(value, tree.Literal(value=str() as name))):
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
        # What is the same for all rows orders nothing; to SQL a number would be a column's.
        wanted = [
            key for key in self.query.order if not self.sql.is_constant(self._resolved(key.value))
        ]
        keys = [(self._item(key.value), key.descending) for key in wanted]
        ordered: list[exp.Expr] = []
        if any(item.output is None or item.output.schema is not None for item, _ in keys):
            self.result.order = keys
        else:
            for item, descending in keys:
                assert item.output is not None
                key = self.columns[item.output.index].copy()
                ordered.append(exp.Ordered(this=key, desc=descending, nulls_first=False))
        # A scan keeps its order; a join, and be it with the row of parameters, need not.
        if len(self.sql.shapes) > 1 or ordered or self.result.bindings:
            for shape in self.result.shapes:
                ordered.extend(self._position(shape))
        return ordered

    def _limit(self) -> None:
        plan = self.result
        if self.query.limit is None:
            return
        match self.query.limit:
            case tree.Literal(value=number) if (
                type(number) is int
                and number < _MOST_ROWS
                and not plan.conditions
                and not plan.order
            ):
                plan.select = plan.select.limit(number)
            case limit:
                plan.limit = limit

    def _table(self, shape: Shape) -> exp.Expr:
        """A source as a table: the entities of a world, some of them, or numbered values."""
        alias = exp.to_identifier(self.sql.aliases[shape.alias])
        if shape.tag is None:
            return exp.table_("entities", db=shape.schema, alias=alias)
        given = self.sql.parameter(shape.alias, Binding("", source=shape.alias))
        # Without its type DuckDB would take the smallest that fits.
        rows = exp.cast(given, f"{_SQL_TYPES[shape.tag.type]}[]", dialect="duckdb")
        numbers = exp.func("generate_subscripts", rows, exp.Literal.number(1))
        if shape.tag.type == "any":
            numbered = exp.select(exp.alias_(numbers, "n"))
        else:
            name = "id" if shape.tag.type == "entity" else "value"
            values = exp.func("unnest", rows.copy())
            numbered = exp.select(exp.alias_(values, name), exp.alias_(numbers, "n"))
        if shape.tag.type != "entity":
            return numbered.subquery(alias)
        entities = exp.table_("entities", db=shape.tag.schema, alias="e")
        joined = exp.select("e.*", "i.n").from_(numbered.subquery("i")).join(entities, using=["id"])
        return joined.subquery(alias)

    def _position(self, shape: Shape) -> list[exp.Expr]:
        """The keys by which a source's elements are in their order."""
        if shape.tag is not None:
            return [self.sql.column(shape.alias, "n")]
        sensors_first = exp.NEQ(
            this=self.sql.column(shape.alias, "kind"), expression=exp.Literal.string("sensor")
        )
        return [sensors_first, self.sql.column(shape.alias, "id")]

    def _output(self, value: SqlValue) -> Output:
        text = value.sql.sql(dialect="duckdb")
        if text not in self.texts:
            self.texts[text] = len(self.columns)
            self.columns.append(value.sql)
        return Output(self.texts[text], value.tag.schema if value.tag.type == "entity" else None)

    def _leave(self, node: Node) -> None:
        """Leave a part to Python: fetch the largest parts of it that SQL can do."""
        if isinstance(node, Query) and not self.sql.is_constant(node):
            return  # it runs by itself, and sees the elements
        if isinstance(node, Call) and node.name not in RELATIONS:
            self.names.check_call(node)
        if self.sql.is_constant(node):
            self.result.once.append(node)
            return
        try:
            self.result.known[node] = self._output(self.sql.value(node))
        except NotSqlError:
            for child in node.children():
                self._leave(child)

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


def _conjuncts(node: Node | None) -> Iterator[Node]:
    """The parts of a condition that are joined by AND, in order."""
    if isinstance(node, Binary) and node.operator == "AND":
        yield from _conjuncts(node.left)
        yield from _conjuncts(node.right)
    elif node is not None:
        yield node


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
