"""Queries over a batch: their rows are those of each environment, one after the other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from ssduck.columns.arrays import Array, ArrayValues
from ssduck.columns.compiler import Compiler
from ssduck.columns.expressions import LeftToDuckDBError
from ssduck.errors import SelectScriptError, SourceSpan, UnsupportedError
from ssduck.geometry.arrays import Flags, Indices
from ssduck.interpreter.batches.evaluator import (
    ENV,
    BatchExpressions,
    answers_of,
    at_environment,
    plain,
    without_unknown,
)
from ssduck.interpreter.batches.expressions import CHANGING, PLAIN, Engine, Leaves, value_of
from ssduck.interpreter.execution import Execution
from ssduck.interpreter.output import AsClause, as_clause_of
from ssduck.language.clauses import PythonClauses, Rows, Selected, SelectedValue
from ssduck.language.evaluator import Frame
from ssduck.language.tree import Call, ListLiteral, Literal, Name, Node, Placeholder, Query
from ssduck.schema import STORED_TABLES
from ssduck.sql.plan import Plan

# The rows of each environment, by its number.
_RowsByNumber: TypeAlias = dict[int, list[tuple[Any, ...]]]
_CLAUSES = frozenset(("expressions", "from_", "where", "order"))
# What is selected of a row if all selected values are those of its environment.
_ID = Name(SourceSpan(0, 0), "id")
_KINDS = {column.name: column.type for column in STORED_TABLES["entities"].columns}


class BatchQuery:
    """A query over all environments of a batch.

    Args:
        execution: has the variables.
        engine: reads the batch.
        query: the query.
    """

    def __init__(self, execution: Execution, engine: Engine, query: Query) -> None:
        self._execution, self._engine, self._world = execution, engine, engine.world
        # What is of time, of the past, and of variables with a value for each environment.
        named = replace(query, items=tuple(map(self._item, query.items)))
        self._outer = BatchExpressions(execution, engine, [named])
        (substituted,) = self._outer.substituted
        assert isinstance(substituted, Query)
        self._query = substituted
        self._columns = BatchExpressions(execution, engine, query.items) if _is_row(query) else None
        self._over: tuple[object, _OverEntities | None] | None = None
        self.has_same_arrays = self._outer.has_same_arrays

    def _item(self, item: Node) -> Node:
        """Returns a selected value; the number of the environment keeps its name."""
        if not (isinstance(item, Name) and item.name == ENV):
            return item
        return Call(item.span, "to", (item, Literal(item.span, ENV)), item.span)

    def value(self) -> Any:
        """Returns the result of the query in its form; the caller has the lock of the batch.

        Raises:
            UnsupportedError: the form is of a single world.
            SelectScriptError: the query fails in an environment, whose number the error has.
        """
        form = as_clause_of(self._query, Frame(self._execution))
        if form.adapter.needs not in ("rows", "columns"):
            raise UnsupportedError(
                f"AS {form.name} is of one world: ask environment(0)", span=self._query.span
            )
        if "tensor" in form.adapter.names and self._columns is not None:
            columns = [without_unknown(one, "a column") for one in self._columns.answers()]
            return self._world.given_back(np.column_stack(columns))
        if "value" in form.adapter.names:
            return self._world.given_back(self._value_of_each(form))
        value = form.value(self._query, Frame(self._execution), self._run)
        return self._world.given_back(value) if isinstance(value, np.ndarray) else value

    def _value_of_each(self, form: AsClause) -> Array:
        """Returns the result of a form for the rows of each environment, (n,)."""
        names, rows = self._rows(_accept_columns)
        values = []
        for number in range(self._world.count):
            own = Rows(rows[number], names)
            frame = Frame(self._execution)
            values.append(form.value(self._query, frame, lambda *_, own=own: own))
        return without_unknown(answers_of(values), "the query")

    def _run(self, query: Query, frame: Frame, check: Any) -> Selected:
        """Returns the rows of all environments; see `QueryRunner`."""
        del query, frame
        names, rows = self._rows(check)
        return Rows([row for number in sorted(rows) for row in rows[number]], names)

    def _rows(self, check: Any) -> tuple[Any, _RowsByNumber]:
        """Returns the names of the columns, and the rows of each environment."""
        given, unknown = self._outer.given()
        rows: _RowsByNumber = {}
        names: Any = ()
        over = None if unknown else self._over_entities(given)
        if over is not None:
            check(over.columns)
            rows, names = over.rows(given), tuple(column.name for column in over.columns)
        for number in range(self._world.count):
            if number not in rows:
                selected = self._one(number, given, unknown, check)
                rows[number], names = selected.values, selected.names
        return names, rows

    def _one(
        self, number: int, given: Mapping[str, Array], unknown: Mapping[str, Flags], check: Any
    ) -> Rows:
        """Returns the rows of an environment, for which the query runs by itself."""
        samples = at_environment(given, unknown, number)
        frame = Frame(self._execution, placeholders=samples)
        with self._world.at(number), self._execution.worlds_pinned(self._query):
            try:
                selected = self._execution.planner.run(self._query, frame, check)
            except SelectScriptError as error:
                error.message = f"environment {number}: {error.message}"
                raise
        if not isinstance(selected, Rows):
            raise UnsupportedError(
                "over a batch, a query has rows, not groups or paths", span=self._query.span
            )
        for row in selected.values:
            for value in row:
                plain(value, self._query)
        return selected

    def _over_entities(self, given: Mapping[str, Array]) -> _OverEntities | None:
        """Returns the query as functions of arrays; None if it is none."""
        generation = self._execution.planner.generation
        if self._over is None or self._over[0] is not generation:
            samples = at_environment(given, {}, 0)
            frame = Frame(self._execution, placeholders=samples)
            with self._world.at(0), self._execution.worlds_pinned(self._query):
                try:
                    over = _OverEntities(self._execution, self._engine, self._query, frame)
                except LeftToDuckDBError:
                    over = None
            self._over = self._execution.planner.generation, over
        over = self._over[1]
        if over is not None and not over.leaves.is_current(Frame(self._execution)):
            self._over = None
            return self._over_entities(given)
        return over


class _OverEntities:
    """A condition on, and values of, each entity of each environment.

    Args:
        execution: plans the query.
        engine: reads the batch.
        query: the query.
        frame: its placeholders in one environment.

    Attributes:
        columns: the selected values.
        leaves: what the expressions read.

    Raises:
        LeftToDuckDBError: it is another query.
    """

    def __init__(self, execution: Execution, engine: Engine, query: Query, frame: Frame) -> None:
        if query.order:
            raise LeftToDuckDBError
        whole = execution.planner.planned(query, frame)
        of_rows = replace(query, items=tuple(i for i in query.items if not _is_given(i)) or (_ID,))
        planned = execution.planner.planned(of_rows, frame)
        if whole is None or planned is None or not _is_of_entities(planned.plan, engine.schema):
            raise LeftToDuckDBError
        plan = planned.plan
        assert plan.outputs is not None
        self._engine, self.leaves = engine, Leaves(engine)
        self.columns: tuple[SelectedValue, ...] = whole.columns
        entities = engine.world.snapshot.entities
        count, size = engine.world.count, len(entities)
        self._size = size
        self._environments: Indices = np.repeat(np.arange(count), size)
        for name, kind in _KINDS.items():
            if name in CHANGING:
                self.leaves.note(f"column {name}", "double", self._changing(name))
            elif kind in ("double", "integer", "string", "boolean") and name != "run":
                own = engine.world.snapshot.tables["entities"].values(name)
                array = np.tile(np.array(own, object if kind == "string" else None), count)
                if array.dtype.kind != "O" or kind == "string":
                    self.leaves.note(f"column {name}", kind, lambda _, array=array: array)  # type: ignore[misc]
        self.leaves.note_given(query, frame)
        where = plan.select.args.get("where")
        parts = [plan.select.expressions[output.index] for output in plan.outputs]
        parts += [] if where is None else [where.this]
        parts = [self.leaves.renamed(part, plan.bindings, frame) for part in parts]
        compiler = Compiler(engine.operations, self.leaves.expression, parts)
        computes = iter([compiler.expression(part).compute for part in parts])
        tree = self.leaves.tree(frame)
        # The values of each row, then whether it is one.
        self._computes = [
            tree.of(_unnamed(item)).compute if _is_given(item) else next(computes)
            for item in query.items
        ]
        self._has_condition = where is not None
        if self._has_condition:
            self._computes.append([*computes][-1])

    def _changing(self, name: str) -> Any:
        columns, entities = self._engine.columns, self._engine.world.snapshot.entities

        def read(_: Mapping[str, Array]) -> Array:
            return np.stack([columns.column(one.id, name) for one in entities], axis=1).ravel()

        return read

    def rows(self, given: Mapping[str, Array]) -> _RowsByNumber:
        """Returns the rows of the environments of which arrays have all values."""
        of_rows = {name: values[self._environments] for name, values in given.items()}

        def evaluate(values: ArrayValues) -> list[Array | None]:
            return [value_of(compute, values) for compute in self._computes]

        with self._engine.shapes.with_rows(self._environments):
            count = len(self._environments)
            found, left = self.leaves.evaluated(evaluate, of_rows, {}, count)
        if any(values is None for values in found):
            return {}
        whole = left.reshape(-1, self._size).any(axis=1)
        known: list[Array] = [values for values in found if values is not None]
        is_known: Flags = ~np.repeat(whole, self._size)
        chosen = known.pop().astype(np.bool_) & is_known if self._has_condition else is_known
        rows: _RowsByNumber = {number: [] for number in np.flatnonzero(~whole).tolist()}
        places = np.flatnonzero(chosen)
        selected = zip(*(values[places].tolist() for values in known), strict=True)
        for number, row in zip(self._environments[places].tolist(), selected, strict=True):
            rows[number].append(row)
        return rows


def _accept_columns(_: object) -> None:
    """Accepts any columns."""


def _is_row(query: Query) -> bool:
    """Checks whether a query selects values once, FROM [0] for example."""
    others = (query.where, query.recursion, query.having, query.limit, query.offset)
    is_plain = all(other is None for other in others) and not (query.group or query.order)
    if not is_plain or len(query.sources) != 1 or not query.items:
        return False
    (source,) = query.sources
    return isinstance(source.value, ListLiteral) and len(source.value.items) == 1


def _unnamed(item: Node) -> Node:
    """Returns a selected value without its name."""
    is_named = isinstance(item, Call) and item.name == "to"
    return item.arguments[0] if is_named else item  # type: ignore[attr-defined]


def _is_given(item: Node) -> bool:
    """Checks whether a selected value is the same for all rows of an environment."""
    leaves = [part for part in _unnamed(item).walk() if not [*part.children()]]
    return all(isinstance(leaf, Placeholder | Literal) for leaf in leaves)


def _is_of_entities(plan: Plan, schema: str) -> bool:
    """Checks whether a plan is of conditions on, and values of, single entities of a world.

    An order is that of the table, as the query has none.
    """
    clauses = plan.python_clauses
    return (
        plan.outputs is not None
        and all(output.sql_type.type in PLAIN for output in plan.outputs)
        and clauses == PythonClauses(clauses.columns)
        and not plan.paths
        and not any(value for name, value in plan.select.args.items() if name not in _CLAUSES)
        and len(plan.source_types) == 1
        and plan.source_types[0].schema == schema
        and plan.source_types[0].table == "entities"
        and not plan.source_types[0].past_kind
    )
