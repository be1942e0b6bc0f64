"""Runs a SELECT of one row again without looking for its plan: only its parameters are read.

A condition that is evaluated at every step of an environment takes longer to plan again than to
compute. Its plan holds while the worlds have the same entities, and variables values of the same
types; whatever else would change it makes the planner forget all plans.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ssduck.database.values import is_exactly
from ssduck.errors import ArgumentError, EvaluationError
from ssduck.interpreter.query_runner import PlannedQuery
from ssduck.language.clauses import Rows, Selected, SelectedValue
from ssduck.language.deferred import LazyList
from ssduck.language.evaluator import EvaluationScope, Frame
from ssduck.language.tree import Index, ListLiteral, Literal, Name, Node, QualifiedName
from ssduck.sql.plan import ParameterBinding
from ssduck.sql.types import SqlType
from ssduck.world.handles import Handle, place_of
from ssduck.world.layout import EntityInfo
from ssduck.world.world import World

# Returns the value of a parameter in a frame.
_Reader = Callable[[Frame], Any]


class _ChangedError(Exception):
    """The plan may be another one now."""


class KeptScalars:
    """A planned SELECT of one row, with functions that read its parameters.

    Args:
        planned: the query with its plan, which has run in this frame.
        frame: a frame without rows and state variables around it.

    Raises:
        ValueError: it has to be planned each time.
    """

    def __init__(self, planned: PlannedQuery, frame: Frame) -> None:
        plan = planned.plan
        if planned.scalars is None:
            raise ValueError("DuckDB has to evaluate it")
        self._select = planned.scalars
        self._planned, self._places = planned, planned.places
        # Variables that are worlds or entities, with the world and its entities.
        self._worlds: dict[str, tuple[World | Handle, World, list[EntityInfo]]] = {}
        self._variables: set[str] = set()
        # Each value is read once, however often a program names it.
        self._readers: dict[tuple[Any, ...], _Reader] = {}
        # The columns of entities and links that are read, by world, table and row.
        self._columns: dict[tuple[World, str, int], dict[str, tuple[Any, ...]]] = {}
        self._sources = {
            shape.alias: _literals(source.value)
            for shape, source in zip(plan.source_types, plan.query.sources, strict=True)
        }
        keys = {b.name: self._key(b, frame) for b in plan.bindings if b.node}
        self._bindings = [(name, keys[name]) for name in keys if name in self._select.parameters]
        self._leave_out_columns({key for _, key in self._bindings})
        bound = {binding.node for binding in plan.bindings}
        for node in plan.constants.keys() - bound:  # the plan relies on their types
            self._key(ParameterBinding("", node, sql_type=plan.constants[node]), frame)
        if plan.worlds:
            raise ValueError("the plan depends on more than its parameters")
        self._parameters = {
            binding.name: self._sources[binding.source]
            for binding in plan.bindings
            if binding.source is not None
        }
        known = self._variables.union(self._worlds)
        # A name has another meaning as soon as it is a variable, or is none; so has one of a list
        # that the query evaluates.
        self._others = {
            name: frame.scope.has_variable(name)
            for name in (*plan.bare, *plan.deferred)
            if name not in known
        }
        if not self._are_same(frame.scope):
            raise ValueError("the query evaluates a list")

    @property
    def columns(self) -> tuple[SelectedValue, ...]:
        """The selected columns."""
        return self._planned.columns

    def run(self, frame: Frame) -> Selected | None:
        """Returns the row; None if the query has to be planned again.

        Args:
            frame: a frame without rows and state variables around it.
        """
        rows = self._rows(frame)
        return None if rows is None else self._planned.selected(rows, frame, self._sources)

    def row(self, frame: Frame) -> list[Any] | None:
        """Returns the values of the row, as `run` does."""
        rows = self._rows(frame)
        if rows is None:
            return None
        if self._places is not None:
            return [rows[0][place] for place in self._places]
        selected = self._planned.selected(rows, frame, self._sources)
        return list(selected.values[0]) if isinstance(selected, Rows) else None

    def _rows(self, frame: Frame) -> list[tuple[Any, ...]] | None:
        """Returns the row as DuckDB would return it; None if the query has to be planned again."""
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
        except (_ChangedError, ArgumentError, EvaluationError):
            return None
        parameters = self._parameters | {name: values[key] for name, key in self._bindings}
        rows = self._select.rows(parameters)
        scope.meter.check_time()
        return rows

    def _leave_out_columns(self, keys: set[tuple[Any, ...]]) -> None:
        """Leaves out the columns of entities that have none of these keys."""
        for place, columns in list(self._columns.items()):
            read = {column: key for column, key in columns.items() if key in keys}
            self._columns[place] = read
            if not read:
                del self._columns[place]

    def _are_same(self, scope: EvaluationScope) -> bool:
        """Checks whether names that are no parameters have the same meaning."""
        return all(
            scope.has_variable(name) == is_variable
            and not (is_variable and isinstance(scope.variable(name), LazyList))
            for name, is_variable in self._others.items()
        )

    def _key(self, binding: ParameterBinding, frame: Frame) -> tuple[Any, ...]:
        """Returns the key of the reader of a parameter."""
        node = binding.node
        assert node is not None
        names = _names_in(node)
        value = None if names is None else frame.value(node)
        if names is not None and isinstance(value, Handle) and value.moment is None:
            for name in names:
                self._note_world(name, frame)
            column = binding.column or "id"
            key: tuple[Any, ...] = value.world.serial, value.id, column
            table, row = place_of(value)
            if value.world.snapshot.has_double(column, table):
                self._columns.setdefault((value.world, table, row), {})[column] = key
            else:
                self._readers[key] = _column_reader(value, column)
            return key
        if binding.column is not None:
            raise ValueError("it names an entity in another way")
        self._variables.update(part.name for part in node.walk() if isinstance(part, Name))
        key = (node.name if isinstance(node, Name) else node,)
        if isinstance(node, Name):
            self._readers[key] = _variable_reader(node.name, binding.sql_type)
        else:
            self._readers[key] = _expression_reader(node, binding.sql_type)
        return key

    def _note_world(self, name: str, frame: Frame) -> None:
        """Notes that a variable, and the entities of its world, have to stay the same."""
        value = frame.scope.variable(name)
        world = value.world if isinstance(value, Handle) else value
        if not isinstance(world, World):
            raise ValueError("an entity is an element of something else")  # noqa: TRY004
        self._worlds[name] = value, world, world.snapshot.load_order


def _column_reader(handle: Handle, column: str) -> _Reader:
    """Returns the reader of a column at the last tick, while the entities are the same."""
    if column == "id":
        return lambda _: handle.id
    if column == "tick":
        return lambda _: handle.world.snapshot.number
    return lambda _: handle.column(column)


def _variable_reader(name: str, sql_type: SqlType) -> _Reader:
    def read(frame: Frame) -> Any:
        scope = frame.scope
        value = scope.variable(name) if scope.has_variable(name) else None
        return _checked(value, sql_type)

    return read


def _checked(value: Any, sql_type: SqlType) -> Any:
    """Returns a value if it has the type that the plan relies on."""
    is_same = is_exactly(value, sql_type)
    if is_same and sql_type.type == "list":
        is_same = bool(value) and (len(value) == 3) == (sql_type.length == 3)
    if not is_same:
        raise _ChangedError
    return value


def _expression_reader(node: Node, sql_type: SqlType) -> _Reader:
    """Returns the reader of a value that Python computes, of the past for example."""

    def read(frame: Frame) -> Any:
        return _checked(frame.value(node), sql_type)

    return read


def _names_in(node: Node) -> list[str] | None:
    """Returns the variables of an element of variables, such as sim.cup; None for others."""
    parts = list(node.walk())
    if not all(isinstance(part, Index | QualifiedName | Name | Literal) for part in parts):
        return None
    return [part.name for part in parts if isinstance(part, Name)]


def _literals(node: Node) -> list[Any]:
    """Returns the values of a list of literals."""
    if not isinstance(node, ListLiteral):
        raise ValueError("a source is no list of literals")  # noqa: TRY004
    values = [item.value for item in node.items if isinstance(item, Literal)]
    if len(values) != len(node.items):
        raise ValueError("a source is no list of literals")
    return values
