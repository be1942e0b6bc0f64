"""Finds the triggers whose programs are formulas over the rows of one world's entities.

A *formula* is a query that is one `ArraySelect`, with nothing left to Python. Formulas that differ
in their constants alone have the same *shape*, and are evaluated at once, as a *group*; the
constants are its *slots*.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from operator import itemgetter
from typing import Any, TypeAlias

import numpy as np
from sqlglot import exp

from ssduck.adapters.base import Adapter
from ssduck.adapters.tabular import VALUES
from ssduck.columns.arrays import Array, ArrayOperations, ArrayValues
from ssduck.columns.compiler import Expression, Kind, LeftToDuckDBError, literal_of
from ssduck.columns.selects import ArraySelect
from ssduck.database.values import to_sql
from ssduck.errors import SelectScriptError
from ssduck.interpreter.execution import Execution
from ssduck.interpreter.output import AsClause, as_clause_of
from ssduck.interpreter.program import CompiledProgram
from ssduck.interpreter.query_runner import PlannedQuery
from ssduck.interpreter.triggers.shapes import LiveShapes
from ssduck.language import ast
from ssduck.language.clauses import Selected
from ssduck.language.evaluator import Frame
from ssduck.language.value_keys import ATOMS
from ssduck.schema import ALL_ENTITIES, MARGINS, MASSES, TABLES, VELOCITIES
from ssduck.sql.plan import ParameterBinding, Plan
from ssduck.sql.sql_values import with_values
from ssduck.world.entities import Entity
from ssduck.world.handles import Handle
from ssduck.world.live_tables import LiveTable
from ssduck.world.snapshot import Snapshot
from ssduck.world.world import World

# The columns that differ from tick to tick though nothing moves.
TIME_COLUMNS = ("tick", "time")
# A component of a quaternion changes by at most half the angle of a rotation.
_QUATERNION = ("qw", "qx", "qy", "qz")


class TableState:
    """The numbers of tables at a tick, to compare later ticks with."""

    def __init__(self, snapshot: Snapshot, tables: Iterable[str]) -> None:
        # The version of each table, which changes with all that is no number, and its numbers.
        self._copies: dict[str, tuple[int, Array, list[Array]]] = {}
        for name in tables:
            table = snapshot.tables[name]
            integers = [column.copy() for column in _integers_of(table)]
            self._copies[name] = table.version, table.block.copy(), integers

    def is_same(self, snapshot: Snapshot, threshold: float) -> bool:
        """Checks whether no number in the tables has changed by more than a threshold."""
        return all(
            version == snapshot.tables[name].version
            and all(map(np.array_equal, integers, _integers_of(snapshot.tables[name])))
            and _are_near(doubles, snapshot.tables[name], threshold)
            for name, (version, doubles, integers) in self._copies.items()
        )


def _integers_of(table: LiveTable) -> list[Array]:
    """Returns the columns of integers that are numbers in each row."""
    others = {*table.names_of_doubles, *TIME_COLUMNS}
    return [table[name] for name in table.names_of_numbers if name not in others]


def _are_near(doubles: Array, table: LiveTable, threshold: float) -> bool:
    """Checks whether no double has changed by more than a threshold."""
    names = [name for name in table.names_of_doubles if name not in TIME_COLUMNS]
    changing = table.block_rows(tuple(names))
    now, before = table.block[changing], doubles[changing]
    if not threshold:
        return np.array_equal(now.view(np.int64), before.view(np.int64))
    with np.errstate(invalid="ignore"):  # infinite boxes
        change = np.abs(now - before)
    change[now == before] = 0.0
    change[[name in _QUATERNION for name in names]] *= 2.0
    return bool((change <= threshold).all())


_TYPES = {"double": np.float64, "decimal": np.float64, "integer": np.int64, "string": np.object_}


Planned: TypeAlias = tuple[ast.Query, PlannedQuery, AsClause, Frame]


@dataclass(frozen=True)
class Slot:
    """A constant of a shape, or a number of an entity that is the value of a variable."""

    kind: Kind  # the type of its values
    value: Any  # the constant, or the entity
    column: str | None = None  # the column of the entity; None for a constant

    @property
    def key(self) -> tuple[Any, ...]:
        """A key that slots of equal values share; 0.0 and -0.0 differ."""
        return self.kind, self.column, self.value.id if self.column else repr(self.value)


@dataclass(eq=False)
class Formula:
    """A query over the entities of one world, of which each row is decided by itself."""

    world: World
    select: ArraySelect  # its SELECT, with slots in place of constants
    slots: Sequence[Slot]  # the constants
    tables: frozenset[str]  # what is read from the simulator beside the entities
    columns: frozenset[str | None]  # the columns that it reads
    _planned: Planned
    # The formulas that were last evaluated with it; None before that.
    group: FormulaGroup | None = field(default=None, init=False)
    place: int = field(default=0, init=False)  # its place among them

    @cached_property
    def shape(self) -> tuple[Any, ...]:
        """What formulas that are evaluated at once have in common."""
        return self.select.text, *((slot.kind, slot.column) for slot in self.slots)

    def is_evaluated_at(self, tick: int) -> bool:
        """Checks whether its rows are those of the tick of a number."""
        return self.group is not None and self.group.number == tick

    @property
    def key(self) -> Any:
        """What differs if a bit of its rows does."""
        return None if self.group is None else self.group.key_of(self.place)

    def value(self) -> Any:
        """Returns the result of the program for the rows of its last evaluation."""
        rows = [] if self.group is None else self.group.rows_of(self.place)
        query, planned, form, frame = self._planned
        execution = frame.scope

        def run(_: ast.Query, __: Frame, check: Callable[[Any], None]) -> Selected:
            check(planned.columns)
            return planned.output_rows(rows)

        assert isinstance(execution, Execution)
        with execution.lock:
            execution.begin_program()
            execution.meter.check_rows(len(rows))
            return form.value(query, Frame(execution), run)


def _bits(values: Array) -> tuple[Any, ...]:
    """Returns a key of an array that tells 0.0 from -0.0."""
    of_objects = values.dtype == np.object_
    return values.dtype, values.shape, values.tolist() if of_objects else values.tobytes()


class FormulaGroup:
    """Formulas of one shape that are evaluated at the same ticks.

    Attributes:
        formulas: the formulas.
        number: the number of the tick of the last evaluation; 0 before the first.
    """

    def __init__(self, formulas: Sequence[Formula], snapshot: Snapshot, shapes: LiveShapes) -> None:
        self.formulas, self.number = tuple(formulas), 0
        self._select, self._shapes = formulas[0].select, shapes
        self._slots = [
            _slot_reader(s, snapshot) for s in zip(*(f.slots for f in formulas), strict=True)
        ]
        self._reads_time = not formulas[0].columns.isdisjoint(TIME_COLUMNS)
        # The columns of the rows of all formulas, those of the first one first; where the rows of
        # each begin; and the keys of the columns, and of the rows of each.
        self._columns: list[Array] = []
        self._ends: list[int] = [0] * (len(formulas) + 1)
        self._bits: list[Any] = []
        self._keys: dict[int, Any] = {}
        for place, formula in enumerate(formulas):
            formula.group, formula.place = self, place

    def rows_of(self, place: int) -> list[tuple[Any, ...]]:
        """Returns the last rows of a formula as Python's values."""
        columns = [column.tolist() for column in self._own(place)]
        start, end = self._ends[place : place + 2]
        return list(zip(*columns, strict=True)) if columns else [()] * (end - start)

    def key_of(self, place: int) -> Any:
        """Returns what differs if a bit of the last rows of a formula does."""
        if place not in self._keys:
            start, end = self._ends[place : place + 2]
            self._keys[place] = end - start, *map(_bits, self._own(place))
        return self._keys[place]

    def _own(self, place: int) -> list[Array]:
        return [column[slice(*self._ends[place : place + 2])] for column in self._columns]

    def evaluate(self, snapshot: Snapshot, *, has_moved: bool) -> bool:
        """Evaluates the formulas at a tick; returns whether their rows may have changed.

        They are as they were if nothing that the formulas read has moved.
        """
        bits = self._bits
        if has_moved or self._reads_time or not self.number:
            self.number = 0
            formulas, *columns = self._evaluated(snapshot.table("entities"))
            bits = [*map(_bits, (formulas, *columns))]
        has_changed = bits != self._bits
        if has_changed:
            ends = np.searchsorted(formulas, np.arange(len(self.formulas) + 1))
            self._columns, self._ends, self._keys = columns, ends.tolist(), {}
            self._bits = bits
        self.number = snapshot.number
        return has_changed

    def _evaluated(self, table: LiveTable) -> list[Array]:
        """Returns the place of the formula of each row, ascending, and the columns of the rows."""

        def read(key: int | str) -> Array:
            if isinstance(key, int):
                return self._slots[key](table)
            if key in table.names_of_numbers:
                return table[key]
            return np.array(table.values(key), np.object_ if key in ("name", "kind") else np.bool_)

        values = ArrayValues(read, table.count, self._shapes)
        mask = np.ones((1, table.count), np.bool_)
        for condition in self._select.conditions:
            mask = mask & condition(values)
        values.active = mask
        parts = [np.atleast_2d(part(values)) for part in self._select.columns]
        shape = len(self.formulas), table.count
        chosen = np.nonzero(np.broadcast_to(mask, shape))
        columns = [np.broadcast_to(part, shape + part.shape[2:])[chosen] for part in parts]
        return self._select.arranged([chosen[0], *columns])


def _slot_reader(slots: Sequence[Slot], snapshot: Snapshot) -> Callable[[LiveTable], Array]:
    """Returns what reads a slot of k formulas at a tick, (k, 1), or (1, 1) if all are equal."""
    if len({slot.key for slot in slots}) == 1:
        slots = slots[:1]
    column = slots[0].column
    if column is None:
        constants: Array = np.array([[slot.value] for slot in slots], _TYPES[slots[0].kind])
        return lambda _: constants
    rows = np.array([[snapshot.rows[slot.value.id]] for slot in slots], np.intp)
    return lambda table: table[column][rows]


# -- from programs -----------------------------------------------------------------------------

_KINDS: dict[str, Kind] = {
    **{c.name: c.type for c in TABLES["entities"].columns if c.type in ("double", "integer")},
    **dict.fromkeys(("name", "kind"), "string"),
    **dict.fromkeys(("enabled", "visible"), "boolean"),
}
_TABLES = frozenset((ALL_ENTITIES, MASSES, MARGINS, VELOCITIES, "shapes"))
_CONSTANT_NODES = (ast.Name, ast.Literal, ast.Unary, ast.Binary)
_LARGEST = 1 << 63


class Slots:
    """The parameters and the constants of a formula, as the leaves of its expressions."""

    def __init__(self, parameters: Mapping[str, Slot]) -> None:
        self._parameters = parameters
        self._places: dict[tuple[Any, ...], int] = {}
        self.slots: list[Slot] = []  # all of them; equal ones are one
        self.columns: set[str | None] = set()  # the columns that are read, also those of entities

    def slotted(self, sql: exp.Expr) -> exp.Expr:
        """Returns an expression with the numbers of slots in place of parameters and constants."""
        whole = exp.Paren(this=sql.copy())
        for part in list(whole.find_all(exp.Literal, exp.Parameter)):
            slot = self._slot(part)
            if slot is not None:
                self.columns.add(slot.column)
                place = self._places.setdefault(slot.key, len(self.slots))
                if place == len(self.slots):
                    self.slots.append(slot)
                part.replace(exp.Parameter(this=exp.var(str(place))))
        result: exp.Expr = whole.this
        return result

    def _slot(self, part: exp.Expr) -> Slot | None:
        """Returns a parameter or a constant; None for a number that is a part of a form."""
        if isinstance(part, exp.Parameter):
            return self._parameters.get(part.name)
        around = part.parent
        is_exponent = isinstance(around, exp.Pow) and around.expression is part
        is_place = isinstance(around, exp.Anonymous) and around.name.lower() == "list_extract"
        is_compared = isinstance(around, exp.EQ | exp.NEQ | exp.In)
        if is_exponent or is_place or (part.is_string and not is_compared):
            return None
        assert isinstance(part, exp.Literal)
        with suppress(LeftToDuckDBError):
            return Slot(*literal_of(part))
        return None

    def leaf(self, sql: exp.Expr) -> Expression | None:
        """Returns a slot, or a column of the entities."""
        if isinstance(sql, exp.Column):
            self.columns.add(sql.name)
            kind = _KINDS.get(sql.name)
            return None if kind is None else Expression(kind, itemgetter(sql.name))
        if not sql.name.isdecimal():
            return None
        place = int(sql.name)
        slot = self.slots[place]
        is_integer = slot.kind == "integer" and slot.column is None
        if is_integer and not -_LARGEST < slot.value < _LARGEST:
            return None
        return Expression(slot.kind, itemgetter(place))


class Meaning:
    """What a program means while what decided it is the same."""

    def __init__(
        self,
        execution: Execution,
        query_of: Callable[[ast.Query, Adapter], ast.Query],
        program: CompiledProgram,
        names: Iterable[str],
        key: tuple[Any, ...],
    ) -> None:
        self._execution, self._query_of = execution, query_of
        self._program, self._names = program, frozenset(names)
        self.key = key
        # The stamp of the names for which the key is known to be up to date.
        self.stamp: object = None
        self.rows: Any = None  # the key of the formula's rows at the last result; None if unknown
        # The numbers of the tables at the last evaluation; None if unknown.
        self.state: TableState | None = None

    @cached_property
    def _is_fixed(self) -> bool:
        """Whether only variables of fixed values and the language's functions are read."""
        names = self._execution
        is_users = any(names.is_users(names.resolved_name(name)) for name in self._names)
        return are_fixed(self.key[1:]) and not is_users

    @cached_property
    def formula(self) -> Formula | None:
        """The formula of the program; None if it is none."""
        with self._execution.lock, suppress(SelectScriptError, LeftToDuckDBError):
            planned = self._planned() if self._is_fixed else None
            return None if planned is None else self._of_plan(planned)
        return None  # evaluated by itself, it raises the error

    @cached_property
    def tables(self) -> frozenset[str] | None:
        """The tables on which alone its result depends; None if these are not known."""
        execution = self._execution
        with execution.lock, suppress(SelectScriptError):
            is_fixed = self._is_fixed and self._names.isdisjoint(TIME_COLUMNS)
            planned = self._planned() if is_fixed else None
            if planned is None or not _is_of_tables(planned[1].plan):
                return None
            (query,) = execution.read(self._program.tree).statements
            is_nested = any(
                isinstance(part, ast.Query) for part in query.walk() if part is not query
            )
            return None if is_nested else execution.tables_read(query) | {"entities"}
        return None

    def _planned(self) -> Planned | None:
        """Returns the query that a program is, planned; None if its result is no value of rows."""
        tree = self._execution.read(self._program.tree)
        match tree.statements:
            case [ast.Query(recursion=None) as query] if not tree.explain:
                clause = query.adapter
                if clause is not None and (clause.arguments or clause.named):
                    return None
                frame = Frame(self._execution)
                form = as_clause_of(query, frame)
                adapted = self._query_of(query, form.adapter)
                planned = self._execution.planner.planned(adapted, frame)
                if planned is not None and form.adapter in VALUES:
                    return adapted, planned, form, frame
        return None

    def _of_plan(self, planned: Planned) -> Formula:
        query, (_, planned_query, _, frame) = planned[0], planned
        plan, sources = planned_query.plan, query.sources
        is_left = plan.outputs is None or plan.may_fail or any(plan.deferred.values())
        value = sources[0].value if len(sources) == 1 else None
        world = frame.value(value) if isinstance(value, ast.Name) else None
        tables = self._execution.tables_read(query)
        if is_left or not isinstance(world, World) or not tables <= _TABLES:
            raise LeftToDuckDBError
        parameters: dict[str, Slot] = {}
        texts: dict[str, Any] = {}
        for binding in plan.bindings:
            slot = _slot_of(binding, plan, world, frame)
            if isinstance(slot, Slot):
                parameters[binding.name] = slot
            else:
                texts[binding.name] = slot
        slots, schema = Slots(parameters), str(plan.source_types[0].schema)

        def slotted(sql: exp.Expr) -> exp.Expr:
            return slots.slotted(sql.transform(with_values(texts)) if texts else sql)

        operations = ArrayOperations(schema)
        select = ArraySelect(plan, schema, operations, slots.leaf, slotted, is_split=False)
        return Formula(world, select, slots.slots, tables, frozenset(slots.columns), planned)


def are_fixed(values: Sequence[Any]) -> bool:
    """Checks whether no value can change without being replaced."""
    return all(
        type(value) in ATOMS or type(value) is object or isinstance(value, World | Handle)
        for value in values
    )


def _slot_of(binding: ParameterBinding, plan: Plan, world: World, frame: Frame) -> Any:
    """Returns the slot of a parameter; its value in SQL if it is no number."""
    node = binding.node
    if node is None or not _is_constant(node):
        raise LeftToDuckDBError
    value = frame.value(node)
    if binding.column is not None:
        kind = _KINDS.get(binding.column)
        is_live = isinstance(value, Entity) and value.world is world and value.moment is None
        if not is_live or kind not in ("double", "integer"):
            raise LeftToDuckDBError
        return Slot(plan.numbers[binding.name], value, binding.column)
    value = to_sql(value)
    return Slot(plan.numbers[binding.name], value) if binding.name in plan.numbers else value


def _is_constant(node: ast.Node) -> bool:
    """Checks whether a part depends on the values of variables only."""
    return all(isinstance(part, _CONSTANT_NODES) for part in node.walk())


def _is_of_tables(plan: Plan) -> bool:
    """Checks whether SQL alone decides a result, by present rows of worlds."""
    if plan.outputs is None or plan.signatures or plan.tables or any(plan.deferred.values()):
        return False
    return all(
        source.schema is not None and source.sql_type is None and not source.past_kind
        for source in plan.source_types
    )
