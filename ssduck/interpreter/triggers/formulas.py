"""Finds the triggers whose programs are formulas over the rows of one world's entities.

A *formula* is a query whose condition and columns are SQL expressions over one row: no other
source, no function of a user, nothing left to Python. `ssduck.interpreter.triggers.
batch` evaluates the formulas of many triggers together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from operator import itemgetter
from typing import Any, Protocol

from sqlglot import exp

from ssduck.adapters.registry import Adapter
from ssduck.adapters.values import VALUES
from ssduck.columns.arrays import ArrayOperations
from ssduck.columns.compiler import Compiler, literal_of
from ssduck.columns.expressions import Expression, LeftToDuckDBError
from ssduck.database.values import to_sql
from ssduck.errors import SelectScriptError
from ssduck.interpreter.execution import Execution
from ssduck.interpreter.output import AsClause, as_clause_of
from ssduck.interpreter.program import CompiledProgram
from ssduck.interpreter.query_runner import PlannedQuery
from ssduck.interpreter.triggers.rows import (
    COLUMN_KINDS,
    FIXED_COLUMNS,
    NUMERIC_COLUMNS,
    Number,
    Slot,
)
from ssduck.interpreter.triggers.table_state import TIME_COLUMNS
from ssduck.language.clauses import Selected
from ssduck.language.evaluator import Frame
from ssduck.language.tree import Binary, Literal, Name, Node, Query, Unary
from ssduck.language.value_keys import node_key
from ssduck.schema import ALL_ENTITIES, MARGINS, MASSES
from ssduck.sql.from_clause import world_table
from ssduck.sql.plan import Plan
from ssduck.sql.sql_values import with_values
from ssduck.world.entities import Entity
from ssduck.world.world import World

# The alias of the rows in the expressions of all formulas.
ROWS = "entities"
# With the text of an expression, the key of the values that DuckDB evaluated.
FETCHED = "fetched"

# The parts of a SELECT that a formula may have.
_CLAUSES = frozenset(("expressions", "from_", "where", "order", "limit", "offset"))
# What one expression over a row does not contain.
_NO_FORMULA = (exp.AggFunc, exp.Window, exp.Select, exp.Subquery, exp.Unnest)
_CONSTANT_NODES = (Name, Literal, Unary, Binary)


@dataclass(frozen=True, eq=False)
class SqlExpression:
    """An expression that DuckDB evaluates.

    Attributes:
        sql: the expression.
        text: its text, which identifies it.
    """

    sql: exp.Expr
    text: str


class LastRows(Protocol):
    """The last rows of formulas; see `ssduck.interpreter.triggers.selection`."""

    @property
    def number(self) -> int:
        """The number of their tick."""

    def rows(self, place: int) -> list[tuple[Any, ...]]:
        """Returns the rows of a formula, before LIMIT and OFFSET."""

    def last(self, place: int) -> tuple[Any, ...] | None:
        """Returns the rows of a formula as arrays, to compare the next ones with."""


@dataclass(eq=False)
class Formula:
    """A query over the entities of one world, of which each row is decided by itself.

    Attributes:
        world: the world.
        schema: the schema of its tables.
        condition: the condition on a row; None if there is none.
        columns: the values of a row.
        texts: these expressions, with slots in place of constants.
        slots: the constants of these expressions.
        sql_parts: the expressions that DuckDB evaluates.
        types: the types of the parameters in them, by name.
        constants: the values of parameters that are the same at each tick.
        entity_columns: the entity and the column that are the value of the other parameters.
        tables: what is read from the simulator beside the entities.
        window: the rows that LIMIT and OFFSET leave.
        reads_time: whether its rows may differ though nothing has moved.
        version: a number that changes whenever the rows of the formula do.
        selection: the rows of the formulas that were last evaluated with it; None before that.
        place: its place among them.
    """

    world: World
    schema: str
    condition: Expression | None
    columns: list[Expression]
    texts: tuple[str, ...]
    slots: list[Slot]
    sql_parts: list[SqlExpression]
    types: dict[str, Number]
    constants: dict[str, float]
    entity_columns: dict[str, tuple[Entity, str]]
    tables: frozenset[str]
    window: slice
    reads_time: bool
    _query: Query
    _planned: PlannedQuery
    _form: AsClause
    _execution: Execution
    version: int = field(default=0, init=False)
    selection: LastRows | None = field(default=None, init=False)
    place: int = field(default=0, init=False)

    @property
    def changing(self) -> list[Expression]:
        """The columns that do not stay the same until the table is replaced."""
        return [part for part in self.columns if not part.is_fixed]

    @cached_property
    def shape(self) -> tuple[Any, ...]:
        """What formulas that are evaluated at once have in common."""
        signatures = (slot.signature for slot in self.slots)
        return self.condition is None, *self.texts, *signatures

    def is_evaluated_at(self, tick: int) -> bool:
        """Checks whether its rows are those of the tick of a number."""
        return self.selection is not None and self.selection.number == tick

    def rows(self) -> list[tuple[Any, ...]]:
        """Returns the rows of its last evaluation, as its SQL would return them."""
        assert self.selection is not None
        return self.selection.rows(self.place)[self.window]

    def value(self, rows: list[tuple[Any, ...]]) -> Any:
        """Returns the result of the program for the rows that its SQL would return.

        Raises:
            SelectScriptError: the program fails for these rows.
        """
        execution, planned = self._execution, self._planned

        def run(_: Query, __: Frame, check: Callable[[Any], None]) -> Selected:
            check(planned.columns)
            return planned.output_rows(rows)

        with execution.lock:
            execution.begin_program()
            execution.meter.check_rows(len(rows))
            return self._form.value(self._query, Frame(execution), run)


class FormulaPlanner:
    """Makes formulas of programs.

    Args:
        execution: runs programs.
        query_of: returns the query to run for a query and its result form.
    """

    def __init__(self, execution: Execution, query_of: Callable[[Query, Adapter], Query]) -> None:
        self._execution = execution
        self._query_of = query_of

    def formula(self, program: CompiledProgram) -> Formula | None:
        """Returns the formula that a program is; None if it is none."""
        execution = self._execution
        with execution.lock:
            try:
                query = _only_query(execution, program)
                if query is None:
                    return None
                frame = Frame(execution)
                form = as_clause_of(query, frame)
                if form.adapter not in VALUES:
                    return None
                adapted = self._query_of(query, form.adapter)
                planned = execution.planner.planned(adapted, frame)
                if planned is None or not _is_formula(planned.plan):
                    return None
                return self._of_plan(adapted, planned, form, frame)
            except (SelectScriptError, _NoFormulaError):
                return None  # evaluated by itself, it raises the error

    def tables(self, program: CompiledProgram) -> frozenset[str] | None:
        """Returns the tables on which alone a result depends; None if these are not known."""
        execution = self._execution
        with execution.lock:
            try:
                query = _only_query(execution, program)
                if query is None or any(part is not query for part in _queries(query)):
                    return None
                frame = Frame(execution)
                form = as_clause_of(query, frame)
                planned = execution.planner.planned(self._query_of(query, form.adapter), frame)
            except SelectScriptError:
                return None
            if planned is None or form.adapter not in VALUES or not _is_of_tables(planned.plan):
                return None
            return execution.tables_read(query) | {"entities"}

    def _of_plan(
        self, query: Query, planned: PlannedQuery, form: AsClause, frame: Frame
    ) -> Formula:
        """Returns the formula of a plan.

        Raises:
            _NoFormulaError: it is none.
        """
        plan = planned.plan
        (source,), (source_type,) = query.sources, plan.source_types
        world = frame.value(source.value) if isinstance(source.value, Name) else None
        if not isinstance(world, World):
            raise _NoFormulaError
        tables = self._execution.tables_read(query)
        if not tables <= {ALL_ENTITIES, MASSES, MARGINS, "shapes"}:
            raise _NoFormulaError
        names, texts = {}, {}
        types: dict[str, Number] = {}
        constants: dict[str, float] = {}
        entity_columns = {}
        for binding in plan.bindings:
            node = binding.node
            if node is None or not _is_constant(node):
                raise _NoFormulaError
            value = frame.value(node)
            key = f"{binding.sql_type.type} {node_key(node)} {binding.column or ''}"
            names[binding.name] = key
            if binding.column:
                is_live = isinstance(value, Entity) and value.world is world
                if not is_live or value.moment is not None or binding.column not in NUMERIC_COLUMNS:
                    raise _NoFormulaError
                entity_columns[key] = (value, binding.column)
            elif binding.name in plan.numbers:
                constants[key] = to_sql(value)
            else:
                texts[binding.name] = to_sql(value)
                continue
            types[key] = plan.numbers[binding.name]
        select = plan.select.transform(with_values(texts)) if texts else plan.select.copy()
        assert isinstance(select, exp.Select)
        for parameter in list(select.find_all(exp.Parameter)):
            parameter.set("this", exp.var(names[parameter.name]))
        for column in list(select.find_all(exp.Column)):
            column.set("table", exp.to_identifier(ROWS))
        slots = {key: Slot(types[key], value) for key, value in constants.items()}
        slots |= {key: Slot(types[key], *value) for key, value in entity_columns.items()}
        where = select.args.get("where")
        conditions = [] if where is None else [where.this]
        parts = _Parts(slots, str(source_type.schema), [*conditions, *select.expressions])
        condition = parts.expressions[0] if conditions else None
        columns = parts.expressions[len(conditions) :]
        return Formula(
            world,
            str(source_type.schema),
            condition,
            columns,
            parts.texts,
            parts.slots,
            parts.in_sql,
            types,
            constants,
            entity_columns,
            tables,
            _window(select),
            not parts.columns.isdisjoint(TIME_COLUMNS),
            query,
            planned,
            form,
            self._execution,
        )


class _Parts:
    """Makes the expressions of a formula: by numpy if it can, and else by DuckDB.

    Args:
        parameters: the parameters by name.
        schema: the schema of the world.
        parts: the expressions, the condition first if there is one.

    Attributes:
        slots: the constants, and the parameters; equal ones share their slot.
        columns: the columns that are read, also those of entities.
        in_sql: the expressions that DuckDB evaluates.
        expressions: all of them.
        texts: all of them as texts, with slots in place of constants.

    Raises:
        _NoFormulaError: one has a function that neither evaluates for many formulas.
    """

    def __init__(self, parameters: dict[str, Slot], schema: str, parts: Sequence[exp.Expr]) -> None:
        self._parameters = parameters
        self.slots: list[Slot] = []
        self.columns: set[str | None] = set()
        self.in_sql: list[SqlExpression] = []
        self._places: dict[tuple[Any, ...], int] = {}
        slotted = [self._slotted(part) for part in parts]
        compiler = Compiler(ArrayOperations(schema), self._leaf, slotted)
        made = [self._made(compiler, *pair) for pair in zip(parts, slotted, strict=True)]
        self.expressions = [expression for expression, _ in made]
        self.texts = tuple(text for _, text in made)

    def _slotted(self, sql: exp.Expr) -> exp.Expr:
        """Returns an expression with slots in place of parameters and constants."""
        whole = exp.Paren(this=sql.copy())
        self.columns.update(column.name for column in whole.find_all(exp.Column))
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

    def _leaf(self, sql: exp.Expr) -> Expression | None:
        """Returns a slot, or a column of the entities."""
        if isinstance(sql, exp.Column):
            kind = COLUMN_KINDS.get(sql.name)
            if kind is None:
                return None
            return Expression(kind, itemgetter(sql.name), is_fixed=sql.name in FIXED_COLUMNS)
        if not sql.name.isdecimal():
            return None
        slot, place = self.slots[int(sql.name)], int(sql.name)
        is_text = slot.kind == "string"
        return Expression(slot.kind, itemgetter(place), is_text) if slot.is_in_range else None

    def _made(self, compiler: Compiler, sql: exp.Expr, slotted: exp.Expr) -> tuple[Expression, str]:
        """Returns an expression, and its text."""
        try:
            return compiler.expression(slotted), slotted.sql("duckdb")
        except LeftToDuckDBError:
            if isinstance(sql, exp.Anonymous) or sql.find(exp.Anonymous):
                raise _NoFormulaError from None
            text = sql.sql("duckdb")
            self.in_sql.append(SqlExpression(sql, text))
            return Expression("object", itemgetter((FETCHED, text))), text


class _NoFormulaError(Exception):
    """A program that is no formula."""


def _only_query(execution: Execution, program: CompiledProgram) -> Query | None:
    """Returns the query that a program is, if its result form has no arguments."""
    tree = execution.read(program.tree)
    match tree.statements:
        case [Query(recursion=None) as query] if not tree.explain:
            clause = query.adapter
            return query if clause is None or not (clause.arguments or clause.named) else None
    return None


def _queries(query: Query) -> Iterator[Query]:
    """Yields a query and those in it."""
    return (part for part in query.walk() if isinstance(part, Query))


def _is_of_tables(plan: Plan) -> bool:
    """Checks whether SQL alone decides a result, by present rows of worlds."""
    if plan.outputs is None or plan.signatures or plan.tables or any(plan.deferred.values()):
        return False
    return all(
        source.schema is not None and source.sql_type is None and not source.past_kind
        for source in plan.source_types
    )


def _is_formula(plan: Plan) -> bool:
    """Checks whether the SQL of a plan decides each row of one world by itself."""
    if plan.outputs is None or plan.may_fail or plan.paths or plan.signatures:
        return False
    if any(plan.deferred.values()):
        return False
    if len(plan.source_types) != 1:
        return False
    (source,) = plan.source_types
    is_world = source.schema is not None and source.sql_type is None and source.has_values
    if not is_world or source.past_kind or source.table != "entities":
        return False
    select = plan.select
    if any(value for name, value in select.args.items() if name not in _CLAUSES):
        return False
    order = select.args.get("order")
    if order is not None:
        name = select.args["from_"].this.alias
        expected = exp.Order(expressions=list(world_table(str(source.schema), name).position))
        if order.sql() != expected.sql():
            return False
    return not any(isinstance(part, _NO_FORMULA) for part in _walked(select))


def _walked(select: exp.Select) -> Iterator[exp.Expr]:
    """Yields all parts of a SELECT, without itself."""
    parts: Iterable[exp.Expr] = select.walk()
    return (part for part in parts if part is not select)


def _is_constant(node: Node) -> bool:
    """Checks whether a part depends on the values of variables only."""
    return all(isinstance(part, _CONSTANT_NODES) for part in node.walk())


def _window(select: exp.Select) -> slice:
    """Returns the rows that LIMIT and OFFSET leave."""
    limit, offset = (select.args.get(name) for name in ("limit", "offset"))
    start = 0 if offset is None else int(offset.expression.name)
    return slice(start, None if limit is None else start + int(limit.expression.name))
