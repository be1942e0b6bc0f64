"""Runs programs over a batch: an expression, or a query.

The rows of a query are those of each environment, one after the other.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeAlias
from weakref import WeakKeyDictionary

import numpy as np

from ssduck.columns.arrays import Array
from ssduck.columns.compiler import LeftToDuckDBError
from ssduck.errors import SelectScriptError, UnsupportedError
from ssduck.geometry.arrays import Flags
from ssduck.interpreter.batches.columns import ENV
from ssduck.interpreter.batches.evaluator import (
    BatchExpressions,
    answers_of,
    at_environment,
    plain,
    without_unknown,
)
from ssduck.interpreter.batches.expressions import Engine, meaning_of
from ssduck.interpreter.batches.rows import BatchRows
from ssduck.interpreter.execution import Execution
from ssduck.interpreter.output import AsClause, accept_columns, as_clause_of, joined_rows
from ssduck.language import ast
from ssduck.language.analysis import calls_of, variables_of
from ssduck.language.clauses import Groups, Paths, Rows, Selected
from ssduck.language.evaluator import Frame
from ssduck.world.batches.batch_world import BatchWorld
from ssduck.world.handles import Handle


class BatchQuery:
    """A query over all environments of a batch."""

    def __init__(self, execution: Execution, engine: Engine, query: ast.Query) -> None:
        self._execution, self._engine, self._world = execution, engine, engine.world
        # What is of time, of the past, and of variables with a value for each environment.
        named = replace(query, items=tuple(map(self._item, query.items)))
        self._outer = BatchExpressions(execution, engine, [named])
        (substituted,) = self._outer.substituted
        assert isinstance(substituted, ast.Query)
        self._query = substituted
        self._columns = BatchExpressions(execution, engine, query.items) if _is_row(query) else None
        self._over: tuple[object, BatchRows | None] = (None, None)
        self.has_same_arrays = self._outer.has_same_arrays

    def _item(self, item: ast.Node) -> ast.Node:
        """Returns a selected value; the number of the environment keeps its name."""
        if not (isinstance(item, ast.Name) and item.name == ENV):
            return item
        return ast.Call(item.span, "to", (item, ast.Literal(item.span, ENV)), item.span)

    def value(self) -> Any:
        """Returns the result of the query in its form; the caller has the lock of the batch."""
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
        values = []
        for own in self._selected(accept_columns):
            frame = Frame(self._execution)
            values.append(form.value(self._query, frame, lambda *_, own=own: own))
        return without_unknown(answers_of(values), "the query")

    def _run(self, query: ast.Query, frame: Frame, check: Any) -> Selected:
        """Returns the rows of all environments; see `QueryRunner`."""
        del query, frame
        return _together(self._selected(check))

    def _selected(self, check: Any) -> list[Rows | Groups]:
        """Returns the rows, or the groups, of each environment."""
        given, unknown = self._outer.given()
        over = self._over_entities(given)
        selected: list[Rows | Groups | None] = [None] * self._world.count
        if over is None:
            self._engine.warn_of([self._query])
        else:
            check(over.planned.columns)
            selected = self._of_arrays(over, given, unknown)

        def run(frame: Frame) -> Selected:
            return self._execution.planner.run(self._query, frame, check)

        return [
            self._one(number, given, unknown, run) if own is None else own
            for number, own in enumerate(selected)
        ]

    def _of_arrays(
        self, over: BatchRows, given: Mapping[str, Array], unknown: Mapping[str, Flags]
    ) -> list[Rows | Groups | None]:
        """Returns the rows, or the groups, of the environments whose rows arrays have."""
        meter = self._execution.meter
        found = over.found(given, unknown, meter.step)
        meter.check_rows(int(np.bincount(found.environments).max(initial=0)))
        meter.charge(sum(column.nbytes for column in found.columns))
        planned, numbers = over.planned, range(self._world.count)
        selected = over.selected(found, given, unknown)
        if selected is not None:
            return [None if found.left[number] else selected[number] for number in numbers]
        self._engine.warn_of([self._query])
        ends = np.searchsorted(found.environments, [*numbers, self._world.count]).tolist()
        fetched = list(zip(*(column.tolist() for column in found.columns), strict=True))

        def of(number: int) -> Rows | Groups:
            def run(frame: Frame) -> Selected:
                return planned.selected(fetched[ends[number] : ends[number + 1]], frame, {})

            return self._one(number, given, unknown, run)

        return [None if found.left[number] else of(number) for number in numbers]

    def _one(
        self,
        number: int,
        given: Mapping[str, Array],
        unknown: Mapping[str, Flags],
        run: Callable[[Frame], Selected],
    ) -> Rows | Groups:
        """Returns the rows, or the groups, of an environment, selected at its tick."""
        samples = at_environment(given, unknown, number)
        frame = Frame(self._execution, placeholders=samples)
        with self._world.at(number), self._execution.worlds_pinned(self._query):
            try:
                selected = run(frame)
            except SelectScriptError as error:
                error.message = f"environment {number}: {error.message}"
                raise
        for rows in selected.groups.values() if isinstance(selected, Groups) else (selected,):
            if not isinstance(rows, Rows):
                raise UnsupportedError(
                    "over a batch, a query has rows or groups, not paths", span=self._query.span
                )
            for row in rows.values:
                for value in row:
                    plain(value, self._query)
        assert not isinstance(selected, Paths)
        return selected

    def _over_entities(self, given: Mapping[str, Array]) -> BatchRows | None:
        """Returns the query as functions of arrays; None if it is none."""
        execution, (meaning, over) = self._execution, self._over
        is_same = meaning is meaning_of(execution, is_complete=over is not None)
        if is_same and (over is None or over.is_current(Frame(execution))):
            return over
        frame = Frame(execution, placeholders=at_environment(given, {}, 0))
        with self._world.at(0), execution.worlds_pinned(self._query):
            try:
                over = BatchRows(execution, self._engine, self._query, frame)
            except LeftToDuckDBError:
                over = None
        self._over = meaning_of(execution, is_complete=over is not None), over
        return over


def _together(parts: Sequence[Rows | Groups]) -> Rows | Groups:
    """Returns the rows of all environments, those of a group by its key."""
    if not isinstance(parts[0], Groups):
        return joined_rows([part for part in parts if isinstance(part, Rows)])
    groups: dict[str, list[Rows]] = {}
    for part in parts:
        assert isinstance(part, Groups)
        for key, rows in part.groups.items():
            assert isinstance(rows, Rows)
            groups.setdefault(key, []).append(rows)
    return Groups({key: joined_rows(rows) for key, rows in groups.items()}, parts[0].empty)


def _is_row(query: ast.Query) -> bool:
    """Checks whether a query selects values once, FROM [0] for example."""
    others = (query.where, query.recursion, query.having, query.limit, query.offset)
    is_plain = all(other is None for other in others) and not (query.group or query.order)
    if not is_plain or len(query.sources) != 1 or not query.items:
        return False
    (source,) = query.sources
    return isinstance(source.value, ast.ListLiteral) and len(source.value.items) == 1


_Compiled: TypeAlias = BatchExpressions | BatchQuery


class BatchPrograms:
    """Programs over batches, compiled when they are evaluated first."""

    def __init__(self, execution: Execution) -> None:
        self._execution = execution
        # By the schemas of their batches.
        self._engines: dict[str, Engine] = {}
        # Each with the object that is replaced when names get other meanings.
        self._compiled: WeakKeyDictionary[ast.Program, tuple[object, _Compiled]] = (
            WeakKeyDictionary()
        )

    def batch_of(self, program: ast.Program) -> BatchWorld | None:
        """Returns the batch that a program reads; None if it reads none."""
        names = frozenset().union(*map(variables_of, program.statements))
        values = [self._execution.variable_or_none(name) for name in names]
        if any("getTime" in calls_of(statement) for statement in program.statements):
            values += self._execution.worlds[:1]  # whose time it is
        values = [value.world if isinstance(value, Handle) else value for value in values]
        batches = list({id(v): v for v in values if isinstance(v, BatchWorld)}.values())
        if len(batches) > 1:
            raise UnsupportedError("a program reads one batch: evaluate one for each")
        return batches[0] if batches else None

    def value(self, program: ast.Program, world: BatchWorld) -> Any:
        """Returns the value of a program over a batch."""
        execution = self._execution
        with execution.transaction(program), world.lock:
            if program.explain:
                with world.at(0):
                    return execution.explanation(program)
            generation, compiled = self._compiled.get(program, (None, None))
            is_same = generation is execution.planner.generation
            if compiled is None or not (is_same and compiled.has_same_arrays()):
                compiled = self._made(program, world)
                self._compiled[program] = execution.planner.generation, compiled
            if isinstance(compiled, BatchQuery):
                return compiled.value()
            (answers,) = compiled.answers()
            return world.given_back(without_unknown(answers, repr(program.text.strip())))

    def terms(self, nodes: Sequence[ast.Node], world: BatchWorld) -> BatchExpressions:
        """Returns expressions over all environments of a batch, checked in one."""
        expressions = BatchExpressions(self._execution, self._engine_of(world), nodes)
        expressions.check()
        return expressions

    def report(self, program: ast.Program, world: BatchWorld) -> None:
        """Reports the probable mistakes in an expression or a query over a batch."""
        (node,) = self._execution.read(program).statements
        with world.at(0):
            self._execution.report(self._execution.mistakes(program.text, node))

    def forget(self) -> None:
        """Forgets compiled programs: a name means another batch."""
        self._engines.clear()
        self._compiled.clear()

    def _engine_of(self, world: BatchWorld) -> Engine:
        schema = self._execution.database.schema_of(world)
        engine = self._engines.get(schema)
        if engine is None or engine.world is not world:
            engine = self._engines[schema] = Engine(world, schema)
        return engine

    def _made(self, program: ast.Program, world: BatchWorld) -> _Compiled:
        """Compiles a program, which has to be one expression or query."""
        execution = self._execution
        read = execution.read(program)
        if len(read.statements) != 1:
            raise UnsupportedError(
                "over a batch, a program is one expression or query: set variables with "
                "add_variable"
            )
        (node,) = read.statements
        self.report(program, world)
        if isinstance(node, ast.Query):
            return BatchQuery(execution, self._engine_of(world), node)
        return self.terms([node], world)
