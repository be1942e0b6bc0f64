"""Finds the triggers whose programs are formulas over the rows of one world's entities.

A *formula* is a query that is one `ArraySelect`, with nothing left to Python. Formulas that differ
in their constants alone have the same *shape*; the constants are its *slots*.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from operator import itemgetter
from typing import Any

from sqlglot import exp

from ssduck.adapters.base import Adapter
from ssduck.adapters.tabular import VALUES
from ssduck.columns.arrays import ArrayOperations
from ssduck.columns.compiler import Expression, Kind, LeftToDuckDBError, literal_of
from ssduck.columns.selects import ArraySelect
from ssduck.database.values import to_sql
from ssduck.errors import SelectScriptError
from ssduck.interpreter.execution import Execution
from ssduck.interpreter.output import as_clause_of
from ssduck.interpreter.program import CompiledProgram
from ssduck.interpreter.triggers.groups import TIME_COLUMNS, Formula, Planned, Slot, TableState
from ssduck.language.evaluator import Frame
from ssduck.language.tree import Binary, Literal, Name, Node, Query, Unary
from ssduck.language.value_keys import ATOMS
from ssduck.schema import ALL_ENTITIES, MARGINS, MASSES, TABLES, VELOCITIES
from ssduck.sql.plan import ParameterBinding, Plan
from ssduck.sql.sql_values import with_values
from ssduck.world.entities import Entity
from ssduck.world.handles import Handle
from ssduck.world.world import World

_KINDS: dict[str, Kind] = {
    **{c.name: c.type for c in TABLES["entities"].columns if c.type in ("double", "integer")},
    **dict.fromkeys(("name", "kind"), "string"),
    **dict.fromkeys(("enabled", "visible"), "boolean"),
}
_TABLES = frozenset((ALL_ENTITIES, MASSES, MARGINS, VELOCITIES, "shapes"))
_CONSTANT_NODES = (Name, Literal, Unary, Binary)
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
        planner: FormulaPlanner,
        program: CompiledProgram,
        names: Iterable[str],
        key: tuple[Any, ...],
    ) -> None:
        self._planner, self._program, self._names = planner, program, frozenset(names)
        self.key = key
        # The stamp of the names for which the key is known to be up to date.
        self.stamp: object = None
        self.rows: Any = None  # the key of the formula's rows at the last result; None if unknown
        # The numbers of the tables at the last evaluation; None if unknown.
        self.state: TableState | None = None

    @cached_property
    def _is_fixed(self) -> bool:
        """Whether only variables of fixed values and the language's functions are read."""
        names = self._planner.execution
        is_users = any(names.is_users(names.resolved_name(name)) for name in self._names)
        return are_fixed(self.key[1:]) and not is_users

    @cached_property
    def formula(self) -> Formula | None:
        """The formula of the program; None if it is none."""
        return self._planner.formula(self._program) if self._is_fixed else None

    @cached_property
    def tables(self) -> frozenset[str] | None:
        """The tables on which alone its result depends; None if these are not known."""
        is_fixed = self._is_fixed and not self._names.intersection(TIME_COLUMNS)
        return self._planner.tables(self._program) if is_fixed else None


def are_fixed(values: Sequence[Any]) -> bool:
    """Checks whether no value can change without being replaced."""
    return all(
        type(value) in ATOMS or type(value) is object or isinstance(value, World | Handle)
        for value in values
    )


class FormulaPlanner:
    """Makes formulas of programs."""

    def __init__(self, execution: Execution, query_of: Callable[[Query, Adapter], Query]) -> None:
        self.execution = execution
        self._query_of = query_of

    def formula(self, program: CompiledProgram) -> Formula | None:
        """Returns the formula that a program is; None if it is none."""
        with self.execution.lock, suppress(SelectScriptError, LeftToDuckDBError):
            planned = self._planned(program)
            return None if planned is None else self._of_plan(planned)
        return None  # evaluated by itself, it raises the error

    def tables(self, program: CompiledProgram) -> frozenset[str] | None:
        """Returns the tables on which alone a result depends; None if these are not known."""
        with self.execution.lock, suppress(SelectScriptError):
            planned = self._planned(program)
            if planned is None or not _is_of_tables(planned[1].plan):
                return None
            (query,) = self.execution.read(program.tree).statements
            is_nested = any(isinstance(part, Query) for part in query.walk() if part is not query)
            return None if is_nested else self.execution.tables_read(query) | {"entities"}
        return None

    def _planned(self, program: CompiledProgram) -> Planned | None:
        """Returns the query that a program is, planned; None if its result is no value of rows."""
        tree = self.execution.read(program.tree)
        match tree.statements:
            case [Query(recursion=None) as query] if not tree.explain:
                clause = query.adapter
                if clause is not None and (clause.arguments or clause.named):
                    return None
                frame = Frame(self.execution)
                form = as_clause_of(query, frame)
                adapted = self._query_of(query, form.adapter)
                planned = self.execution.planner.planned(adapted, frame)
                if planned is not None and form.adapter in VALUES:
                    return adapted, planned, form, frame
        return None

    def _of_plan(self, planned: Planned) -> Formula:
        """Returns the formula of a plan."""
        query, (_, planned_query, _, frame) = planned[0], planned
        plan, sources = planned_query.plan, query.sources
        is_left = plan.outputs is None or plan.may_fail or any(plan.deferred.values())
        value = sources[0].value if len(sources) == 1 else None
        world = frame.value(value) if isinstance(value, Name) else None
        tables = self.execution.tables_read(query)
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


def _is_constant(node: Node) -> bool:
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
