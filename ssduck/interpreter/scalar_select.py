"""Evaluates SELECTs of one row in Python, where the values are DuckDB's bit for bit.

A condition on a few numbers takes DuckDB hundreds of microseconds, and Python some. Only operations
with one correct result are evaluated here: comparisons, logic, sums, differences, products,
quotients and roots of finite doubles, and whole powers by the platform's own mathematical library,
which DuckDB uses, too. All others are left to DuckDB, and so are overflows and NaN.

A condition that is evaluated at every step of an environment takes longer to plan again than to
compute: `RepeatedSelect` only reads its parameters. Its plan holds while the worlds have the same
entities, and variables values of the same types; whatever else would change it makes the planner
forget all plans.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from typing import Any

from sqlglot import exp

from ssduck.columns.compiler import Compiler, Expression, Kind, LeftToDuckDBError
from ssduck.columns.numbers import NumberOperations, known
from ssduck.database.values import is_exactly, point_of
from ssduck.errors import ArgumentError, EvaluationError
from ssduck.language import ast
from ssduck.language.evaluator import EvaluationScope, Frame
from ssduck.language.value_history import LazyList
from ssduck.sql.plan import Plan
from ssduck.sql.types import EXACT, POINT, SqlType
from ssduck.world.handles import Handle, place_of
from ssduck.world.layout import EntityInfo
from ssduck.world.world import World

# The clauses that such a SELECT may have; of one row, the order does not matter.
_CLAUSES = frozenset(("expressions", "from_", "order"))
# The types of elements, by their names in the language.
_ELEMENTS: dict[str, Kind] = {"integer": "integer", "double": "double"}
# Returns the value of a parameter in a frame.
_Reader = Callable[[Frame], Any]


class ScalarSelect:
    """A SELECT of values that depend on parameters, without FROM or over a list of one element."""

    def __init__(self, plan: Plan, functions: Mapping[str, Callable[..., Any]]) -> None:
        kinds = _kinds_of(plan)
        self._list = _only_list(plan)
        leaves = _Leaves(plan, kinds, self._list)
        columns = plan.select.expressions
        compiler = Compiler(NumberOperations(functions), leaves.expression, columns)
        self._columns = [compiler.expression(part).compute for part in columns]
        # The types of the parameters that are read, besides the list.
        self.kinds = {name: kind for name, kind in kinds.items() if name in leaves.read}

    def rows(self, parameters: Mapping[str, Any]) -> list[tuple[Any, ...]] | None:
        """Returns the rows that DuckDB would return; None if DuckDB has to evaluate them."""
        values: dict[str, Any] = {}
        if self._list is not None:
            elements = parameters[self._list]
            if len(elements) != 1:
                return None
            values[self._list] = elements[0]
        try:
            for name, kind in self.kinds.items():
                value = parameters[name]
                # Most are doubles; a NaN differs from itself.
                is_number = kind == "double" and type(value) is float and value == value  # noqa: PLR0124
                values[name] = value if is_number else _checked(value, kind)
            return [tuple([column(values) for column in self._columns])]
        except Exception:  # noqa: BLE001  # DuckDB raises it, with its place in the program
            return None


def _only_list(plan: Plan) -> str | None:
    """Returns the parameter that is the list; None if there is no FROM."""
    select = plan.select
    lists = [binding for binding in plan.bindings if binding.source is not None]
    if (
        plan.paths
        or plan.tables
        or any(value for name, value in select.args.items() if name not in _CLAUSES)
        or len(lists) != len(plan.source_types)
    ):
        raise LeftToDuckDBError
    if not lists:
        if select.args.get("from_") is not None:
            raise LeftToDuckDBError
        return None
    source = plan.source_types[0].sql_type
    if len(lists) > 1 or lists[0].end or source is None or source.type not in _ELEMENTS:
        raise LeftToDuckDBError
    return lists[0].name


def _kinds_of(plan: Plan) -> dict[str, Kind]:
    """Returns the types of the parameters by name, without the list."""
    kinds: dict[str, Kind] = dict(plan.numbers)
    for binding in plan.bindings:
        if binding.source is None and binding.name not in kinds:
            kinds[binding.name] = _kind_of(binding.sql_type)
    return kinds


def _kind_of(sql_type: SqlType) -> Kind:
    """Returns the type of a parameter that is no number: a text, or a list of doubles."""
    element = sql_type.element
    if sql_type.type == "list" and element is not None and element.type == "double":
        return "list"
    if sql_type.type != "string":
        raise LeftToDuckDBError
    return "string"


def _checked(value: Any, kind: Kind) -> Any:
    if kind == "double" and type(value) in (float, int):
        return known(float(value))
    if kind == "integer" and type(value) is int and abs(value) < EXACT:
        return value
    if kind == "string" and type(value) is str:
        return value
    if kind == "list" and set(map(type, value)) == {float}:
        return list(map(known, value))
    raise LeftToDuckDBError


class _Leaves:
    """The parameters of a SELECT, and the element of its list."""

    def __init__(self, plan: Plan, kinds: Mapping[str, Kind], list_name: str | None) -> None:
        self._kinds = kinds
        self.read: set[str] = set()
        self._columns: dict[tuple[str, str], Expression] = {}
        if list_name is not None:
            (source,) = plan.source_types
            assert source.sql_type is not None
            element = Expression(_ELEMENTS[source.sql_type.type], operator.itemgetter(list_name))
            self._columns[source.alias, "value"] = element
            self._columns[source.alias, "n"] = Expression("integer", lambda _: 1)

    def expression(self, sql: exp.Expr) -> Expression | None:
        """Returns a parameter or a column; None for one that is not known."""
        if isinstance(sql, exp.Column):
            return self._columns.get((sql.table, sql.name))
        if sql.name not in self._kinds:
            return None
        self.read.add(sql.name)
        return Expression(self._kinds[sql.name], operator.itemgetter(sql.name))


class RepeatedSelect:
    """A planned SELECT of one row, with functions that read its parameters."""

    def __init__(self, plan: Plan, select: ScalarSelect, frame: Frame) -> None:
        self._select = select
        # Variables that are worlds or entities, with the world and its entities.
        self._worlds: dict[str, tuple[World | Handle, World, list[EntityInfo]]] = {}
        self._variables: set[str] = set()
        # Each value is read once, however often a program names it.
        self._readers: dict[tuple[Any, ...], _Reader] = {}
        # The columns of entities and links that are read, by world, table and row.
        self._columns: dict[tuple[World, str, int], dict[str, tuple[Any, ...]]] = {}
        # The keys of the values of parameters.
        self._bindings: dict[str, tuple[Any, ...]] = {}
        # The values of the sources by alias.
        self.sources = {
            shape.alias: _literals(source.value)
            for shape, source in zip(plan.source_types, plan.query.sources, strict=True)
        }
        self._parameters: dict[str, Any] = {}
        for binding in plan.bindings:
            if binding.source is not None:
                self._parameters[binding.name] = self.sources[binding.source]
            elif binding.node is not None:
                is_read = binding.name in select.kinds
                key = self._key(binding.node, binding.column, binding.sql_type, frame, is_read)
                if is_read:
                    self._bindings[binding.name] = key
        bound = {binding.node for binding in plan.bindings}
        for node in plan.constants.keys() - bound:  # the plan relies on their types
            self._key(node, None, plan.constants[node], frame, is_read=False)
        known = self._variables.union(self._worlds)
        # A name has another meaning as soon as it is a variable, or is none; so has one of a list
        # that the query evaluates.
        self._others = {
            name: frame.scope.has_variable(name)
            for name in (*plan.bare, *plan.deferred)
            if name not in known
        }
        if plan.worlds or not self._are_same(frame.scope):
            raise LeftToDuckDBError

    def rows(self, frame: Frame) -> list[tuple[Any, ...]] | None:
        """Returns the row as DuckDB would; None if the query has to be planned again."""
        scope = frame.scope
        if not self._are_same(scope):
            return None
        for name, (value, world, entities) in self._worlds.items():
            is_same = scope.has_variable(name) and scope.variable(name) is value
            if not is_same or world.snapshot.load_order is not entities:
                return None
        try:
            values = {key: read(frame) for key, read in self._readers.items()}
            for (world, table, row), keys in self._columns.items():
                numbers = world.snapshot.doubles_in(row, tuple(keys), table)
                values.update(zip(keys.values(), numbers, strict=True))
        except (LeftToDuckDBError, ArgumentError, EvaluationError):
            return None
        parameters = self._parameters | {name: values[key] for name, key in self._bindings.items()}
        rows = self._select.rows(parameters)
        scope.meter.check_time()
        return rows

    def _are_same(self, scope: EvaluationScope) -> bool:
        """Checks whether names that are no parameters have the same meaning."""
        return all(
            scope.has_variable(name) == is_variable
            and not (is_variable and isinstance(scope.variable(name), LazyList))
            for name, is_variable in self._others.items()
        )

    def _key(
        self, node: ast.Node, column: str | None, sql_type: SqlType, frame: Frame, is_read: bool
    ) -> tuple[Any, ...]:
        """Returns the key of a value, after noting how it is read, or how its type is checked."""
        names = _names_in(node)
        value = None if names is None else frame.value(node)
        if names is not None and isinstance(value, Handle) and value.moment is None:
            for name in names:
                self._note_world(name, frame)
            column = column or "id"
            key: tuple[Any, ...] = value.world.serial, value.id, column
            table, row = place_of(value)
            if is_read and value.world.snapshot.has_double(column, table):
                self._columns.setdefault((value.world, table, row), {})[column] = key
            elif is_read:
                self._readers[key] = _column_reader(value, column)
            return key
        if column is not None:  # it names an entity in another way
            raise LeftToDuckDBError
        self._variables.update(part.name for part in node.walk() if isinstance(part, ast.Name))
        key = (node.name if isinstance(node, ast.Name) else node,)
        self._readers[key] = lambda frame: _of_type(_value_of(node, frame), sql_type)
        return key

    def _note_world(self, name: str, frame: Frame) -> None:
        """Notes that a variable, and the entities of its world, have to stay the same."""
        value = frame.scope.variable(name)
        world = value.world if isinstance(value, Handle) else value
        if not isinstance(world, World):  # an entity is an element of something else
            raise LeftToDuckDBError
        self._worlds[name] = value, world, world.snapshot.load_order


def _column_reader(handle: Handle, column: str) -> _Reader:
    """Returns the reader of a column at the last tick, while the entities are the same."""
    if column == "id":
        return lambda _: handle.id
    if column == "tick":
        return lambda _: handle.world.snapshot.number
    return lambda _: handle.column(column)


def _value_of(node: ast.Node, frame: Frame) -> Any:
    """Returns the value of a variable, or what Python computes, of the past for example."""
    if isinstance(node, ast.Name) and not frame.scope.has_variable(node.name):
        raise LeftToDuckDBError
    return frame.scope.variable(node.name) if isinstance(node, ast.Name) else frame.value(node)


def _of_type(value: Any, sql_type: SqlType) -> Any:
    """Returns a value if it has the type that the plan relies on."""
    value = point_of(value) if sql_type == POINT else value
    is_same = is_exactly(value, sql_type)
    if is_same and sql_type.type == "list":
        is_same = bool(value) and (len(value) == 3) == (sql_type.length == 3)
    if not is_same:
        raise LeftToDuckDBError
    return value


def _names_in(node: ast.Node) -> list[str] | None:
    """Returns the variables of an element of variables, such as sim.cup; None for others."""
    parts = list(node.walk())
    if not all(
        isinstance(part, ast.Index | ast.QualifiedName | ast.Name | ast.Literal) for part in parts
    ):
        return None
    return [part.name for part in parts if isinstance(part, ast.Name)]


def _literals(node: ast.Node) -> list[Any]:
    items = node.items if isinstance(node, ast.ListLiteral) else (None,)
    values = [item.value for item in items if isinstance(item, ast.Literal)]
    if len(values) != len(items):
        raise LeftToDuckDBError
    return values
