"""Finds the plan of a query, made once for the types of its sources and cached."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, Protocol

from ssduck.columns.compiler import LeftToDuckDBError
from ssduck.database.database import Database
from ssduck.database.values import sql_type_of
from ssduck.errors import ArgumentError, EvaluationError, FunctionError, SelectScriptError
from ssduck.formatting import short_repr, type_in_words
from ssduck.interpreter.query_runner import PlannedQuery, RowByRowQuery, SqlFailedError, is_small
from ssduck.interpreter.scalar_select import RepeatedSelect
from ssduck.interpreter.signatures import TypeHints
from ssduck.interpreter.sources import (
    INLINE,
    all_elements,
    source_type,
    source_types,
    with_present_ticks,
)
from ssduck.language import ast
from ssduck.language.analysis import (
    aliases_of,
    free_aliases,
    is_impure,
    mentions,
    nested_sources,
    states,
)
from ssduck.language.builtins import Function
from ssduck.language.clauses import Selected
from ssduck.language.evaluator import EvaluationScope, Frame
from ssduck.language.value_history import LazyList
from ssduck.limits import Limits
from ssduck.recording.replay.past import Past
from ssduck.sql.name_resolution import ResolvedQuery, resolve
from ssduck.sql.plan import Plan, Purpose, SourceType
from ssduck.sql.relation_calls import tables_of
from ssduck.sql.relations.registry import RELATIONS
from ssduck.sql.sql_values import NotSqlError
from ssduck.sql.subqueries import is_inline
from ssduck.sql.translator import NotInlineError, translate
from ssduck.sql.types import Signature, SqlType
from ssduck.world.handles import Handle, Links
from ssduck.world.world import World

# The largest number of cached plans; when it is reached, all are dropped.
MAX_PLANS = 500
# How a query is planned, one after the other where the SQL fails.
_RUNS: tuple[Purpose, ...] = ("run", "cautious")
_UNKNOWN = SqlType("any")


class _SmallQueryError(NotSqlError):
    """A query is faster row by row."""

    def __init__(self, values: list[Any], shapes: tuple[SourceType, ...]) -> None:
        super().__init__()
        self.values = values
        self.shapes = shapes


class FunctionScope(EvaluationScope, Protocol):
    """The interface of the interpreter to a planner: a scope that also knows users' functions."""

    def function(self, name: str) -> Function | None:
        """Returns the function of a name."""


class Planner:
    """Runs queries, and caches their plans.

    Args:
        row_by_row: whether every query runs row by row in Python.
    """

    def __init__(
        self, database: Database, scope: FunctionScope, limits: Limits, *, row_by_row: bool
    ) -> None:
        self._database = database
        self._scope = scope
        self._limits = limits
        self._row_by_row = row_by_row
        self.generation = object()  # an object that is replaced whenever all plans are dropped
        self._plans: dict[ast.Query, list[PlannedQuery]] = {}
        self._row_by_row_queries: dict[
            ast.Query, list[tuple[tuple[SourceType, ...], RowByRowQuery]]
        ] = {}
        # The SELECTs of one row that ran; None for those that have to be planned each time.
        self._repeated: dict[ast.Query, tuple[PlannedQuery, RepeatedSelect] | None] = {}
        # The nested queries in FROM, by the query around them, that must be evaluated before it.
        self._evaluated_aliases: dict[ast.Query, set[str]] = {}

    def forget(self) -> None:
        """Drops all plans, because a function or the name of a world has changed."""
        self.generation = object()
        for plans in self._plans.values():
            for planned in plans:
                planned.forget()
        self._plans.clear()
        self._repeated.clear()
        self._row_by_row_queries.clear()
        self._evaluated_aliases.clear()

    def run(self, query: ast.Query, frame: Frame, check: Callable[[Any], None]) -> Selected:
        """Returns the rows of a query; the caller pins the worlds.

        A plan is first optimistic: its SQL fails where only Python gives the right result, for
        example for a number out of range. Then the cautious plan runs, which leaves such parts to
        Python.
        """
        repeated = self._repeated.get(query) if frame.is_outermost else None
        if repeated is not None:
            planned, select = repeated
            if (rows := select.rows(frame)) is not None:
                check(planned.columns)
                return planned.selected(rows, frame, select.sources)
        if self.may_repeat(query):
            self._database.settle()
        if not self._row_by_row:
            for purpose in _RUNS:
                try:
                    return self._run_planned(query, frame, check, purpose)
                except SqlFailedError:
                    continue
                except _SmallQueryError as error:
                    return self._row_by_row_query(query, error.shapes, frame, check).run(
                        frame, error.values
                    )
                except NotSqlError:
                    break
        return self._run_row_by_row(query, frame, check)

    def resolved_parts(
        self, query: ast.Query, frame: Frame
    ) -> tuple[ResolvedQuery, list[Sequence[Any]]]:
        """Returns a query with its names resolved, and the elements of its sources."""
        values = [frame.value(source.value) for source in query.sources]
        values = self._with_present_ticks(query, frame, values)
        shapes = source_types(query, values, self._database.schema_of)
        return resolve(query, shapes, self._types_in(frame)), all_elements(values)

    def plan(self, query: ast.Query, frame: Frame) -> Plan | None:
        """Returns the plan of a query; None if it runs row by row."""
        planned = self.planned(query, frame)
        return None if planned is None else planned.plan

    def planned(
        self, query: ast.Query, frame: Frame, purpose: Purpose = "run"
    ) -> PlannedQuery | None:
        """Returns a query with its plan; None if it runs row by row."""
        if self._row_by_row:
            return None
        try:
            return self._plan_for(query, frame, self._types_in(frame), purpose)[0]
        except NotSqlError:
            return None

    def sql_plan(self, query: ast.Query, frame: Frame) -> tuple[Plan | None, dict[str, Any]]:
        """Returns the plan of a query for its SQL text, and the values of its parameters."""
        types = self._types_in(frame)
        try:
            planned, values = self._plan_for(query, frame, types, "portable")
        except NotSqlError:
            return None, {}
        return planned.plan, planned.parameters(types.frame(), values)

    def relation(self, query: ast.Query, frame: Frame) -> Any:
        """Returns the value of a relation outside a query, by a query of one row."""
        types = self._types_in(frame)
        planned, _ = self._plan_for(query, frame, types, "cautious")
        if planned.plan.python_parts:
            (call,) = query.items
            assert isinstance(call, ast.Call)
            values = [
                frame.placeholders[part.name]
                for part in call.arguments
                if isinstance(part, ast.Placeholder)
            ]
            types_text = ", ".join(
                short_repr(v) if isinstance(v, float) else type_in_words(v) for v in values
            )
            lacking = "; room.robot is the row's entity if it is a robot, else nothing: "
            lacking += "name an entity, as in room['panda']"
            whole = "; a world is no entity: of anything in it, EXISTS (SELECT this FROM room "
            whole += f"WHERE {call.name}(cup, this))"
            nan = "; a number of the list is NaN"
            raise ArgumentError(
                f"{call.name} does not take ({types_text}): {RELATIONS[call.name].usage}"
                + lacking * any(value is None for value in values)
                + whole * (len(values) > 1 and any(isinstance(v, World) for v in values))
                + nan * any(n != n for v in values if isinstance(v, list) for n in v),  # noqa: PLR0124
                span=query.span,
            )
        (row,) = planned.run(types.frame(), ()).values  # type: ignore[union-attr]
        return row[0]

    # -- as SQL -----------------------------------------------------------------------------

    def _run_planned(
        self, query: ast.Query, frame: Frame, check: Callable[[Any], None], purpose: Purpose
    ) -> Selected:
        types = self._types_in(frame)
        planned, values = self._plan_for(query, frame, types, purpose)
        worlds = planned.plan.worlds
        self._check_records(query, [types.value(node) for node in worlds if worlds[node]])
        if planned.skips_sql():
            raise SqlFailedError
        check(planned.columns)
        selected = planned.run(types.frame(), values)
        if query not in self._repeated and planned.scalars is not None:
            try:
                select = RepeatedSelect(planned.plan, planned.scalars, frame)
                self._repeated[query] = planned, select
            except LeftToDuckDBError:
                self._repeated[query] = None
        return selected

    def may_repeat(self, query: ast.Query) -> bool:
        """Checks whether a query is a SELECT of one row whose next run may need no DuckDB."""
        return self._repeated.get(query) is not None

    def _types_in(self, frame: Frame) -> InterpreterTypes:
        """Returns the types and names that a frame offers the translator."""
        return InterpreterTypes(self._scope, frame, self._database)

    def _plan_for(
        self,
        query: ast.Query,
        frame: Frame,
        types: InterpreterTypes,
        purpose: Purpose,
    ) -> tuple[PlannedQuery, list[Any]]:
        """Returns the plan for the types of a query's sources, and the values of these."""
        if any(mentions(source.value, states(query)) for source in query.sources):
            raise NotSqlError
        while True:
            elements = frame.own_elements()
            values = self._with_present_ticks(query, frame, self._values(query, frame))
            self._check_records(query, values)
            if any(isinstance(value, Handle) and value.moment is not None for value in elements):
                raise NotSqlError  # its handles depend on a row of an outer query
            shapes = source_types(query, values, self._database.schema_of)
            if purpose != "portable" and query.sources and is_small(query, shapes, values):
                raise _SmallQueryError(values, shapes)
            for planned in self._plans.get(query, ()):
                if planned.plan.purpose == purpose and types.fits(planned.plan, shapes):
                    return planned, values
            try:
                step = frame.scope.meter.step
                plan = translate(query, shapes, types, purpose, step=step)
            except NotInlineError as error:
                self._evaluated_aliases.setdefault(query, set()).add(str(error))
                continue
            return self._cache_plan(query, plan), values

    def _values(self, query: ast.Query, frame: Frame) -> list[Any]:
        """Returns the sources' values; `INLINE` for a nested query that is a part of the SQL."""
        evaluated = self._evaluated_aliases.get(query, set())
        return [
            INLINE
            if is_inline(source.value)
            and alias not in evaluated
            and not is_impure(source.value)
            and not free_aliases(source.value)  # of rows around it, which are in Python
            else frame.value(source.value)
            for alias, source in zip(aliases_of(query), query.sources, strict=True)
        ]

    def _with_present_ticks(
        self, query: ast.Query, frame: Frame, values: Sequence[Any]
    ) -> list[Any]:
        """Returns the values of sources; a world beside its past stays at its current tick.

        Its past may be a source of the query, of one in it, or of one around it.
        """
        inside: list[Any] = []
        if any(isinstance(value, World | Links) for value in values):
            for node in nested_sources(query):
                with suppress(SelectScriptError):  # it is an error where a row reaches it
                    inside.append(frame.value(node))
        return with_present_ticks(values, frame.own_elements(), inside)

    def _cache_plan(self, query: ast.Query, plan: Plan) -> PlannedQuery:
        """Caches a plan, and registers the users' functions in it with the database."""
        if sum(map(len, self._plans.values())) >= MAX_PLANS:
            self.forget()
        for signature in plan.signatures:
            function = self._scope.function(signature.function)
            assert function is not None
            self._database.add_function(signature, function)
        planned = PlannedQuery(plan, self._database, self._scope)
        self._plans.setdefault(query, []).append(planned)
        return planned

    def _check_records(self, query: ast.Query, values: Sequence[Any]) -> None:
        """Checks that pasts come from this interpreter's records.

        It also warns of masses and entities that a record does not have.
        """
        for value in values:
            if isinstance(value, Past):
                value.check()
                value.record.warn_of_missing(tables_of(query))
            is_bound = isinstance(value, Past) and value.world in self._database.worlds.values()
            if is_bound and self._database.record_of(value.world) is not value.record:
                raise EvaluationError(
                    f"this past of {value.world.name!r} is of another interpreter's record"
                )

    # -- row by row -------------------------------------------------------------------------

    def _run_row_by_row(
        self, query: ast.Query, frame: Frame, check: Callable[[Any], None]
    ) -> Selected:
        changed = states(query)
        values = [
            [] if mentions(source.value, changed) else frame.value(source.value)
            for source in query.sources
        ]
        values = self._with_present_ticks(query, frame, values)
        self._check_records(query, values)
        shapes = source_types(query, values, self._database.schema_of)
        return self._row_by_row_query(query, shapes, frame, check).run(frame, values)

    def _row_by_row_query(
        self,
        query: ast.Query,
        shapes: tuple[SourceType, ...],
        frame: Frame,
        check: Callable[[Any], None],
    ) -> RowByRowQuery:
        """Returns the query to run row by row, its columns checked; it is made once."""
        types = self._types_in(frame)
        for cached_shapes, rows in self._row_by_row_queries.get(query, ()):
            if (
                cached_shapes == shapes
                and types.has_same_names(rows.resolved.bare)
                and types.has_same_lists(rows.deferred)
            ):
                check(rows.columns)
                return rows
        if sum(map(len, self._row_by_row_queries.values())) >= MAX_PLANS:
            self.forget()
        resolved = resolve(query, shapes, types)
        names = {part.name for part in query.walk() if isinstance(part, ast.Name)}
        deferred = {name: types.deferred(name) for name in names}
        of_past = any(shape.past_kind for shape in shapes)
        rows = RowByRowQuery(
            query, resolved, self._scope, self._limits.depth, deferred, of_past=of_past
        )
        self._row_by_row_queries.setdefault(query, []).append((shapes, rows))
        check(rows.columns)
        return rows


class InterpreterTypes:
    """The names and types of a frame, for the translator (`ssduck.sql.plan.TypeEnvironment`)."""

    def __init__(self, scope: FunctionScope, frame: Frame, database: Database) -> None:
        self.max_depth = database.connection.meter.limits.depth
        self._scope = scope
        self._frame = frame
        self._database = database
        self._values: dict[ast.Node, Any] = dict(frame.cached)
        self._failed: set[ast.Node] = set()
        self.check_call = scope.check_call
        self.resolved_name = scope.resolved_name

    def frame(self) -> Frame:
        """Returns the frame with the values computed so far, so that a run computes each once."""
        return replace(self._frame, cached=self._values, state={}, outer_elements={})

    def has_variable(self, name: str) -> bool:
        """Checks whether a variable has that name."""
        return name in self._frame.local or self._scope.has_variable(name)

    def has_source(self, alias: str) -> bool:
        """Checks whether a query around this one has a source of that name."""
        return alias in self._frame.elements

    def sql_type(self, node: ast.Node) -> SqlType:
        """Returns the type of a constant part."""
        if node in self._failed:
            return _UNKNOWN
        if node not in self._values:
            try:
                self._values[node] = self._frame.value(node)
            except (ArgumentError, EvaluationError, FunctionError):
                self._failed.add(node)
                return _UNKNOWN  # becomes an error only if a row reaches it
        return sql_type_of(self._values[node], self._database.schema_of)

    def world(self, node: ast.Node) -> SourceType | None:
        """Returns the type of the world, or its past, that a constant part is; None for others."""
        if not isinstance(node, ast.Name | ast.TimeIndex):
            return None
        self.sql_type(node)
        value = self._values.get(node)
        is_world = isinstance(value, World | Links | Past)
        return source_type("", value, self._database.schema_of) if is_world else None

    def value(self, node: ast.Node) -> Any:
        """Returns the value of a constant part that has one."""
        return self._values[node]

    def deferred(self, name: str) -> ast.Node | None:
        """Returns the list in a variable that the query evaluates; None for other values."""
        if name in self._frame.local or not self._scope.has_variable(name):
            return None
        value = self._scope.variable(name)
        return value.node if isinstance(value, LazyList) else None

    def signature(self, name: str, arguments: tuple[SqlType, ...]) -> Signature | None:
        """Returns the SQL signature of a user's function; None if SQL cannot call it."""
        function = self._scope.function(name)
        if function is None or function.builtin or not isinstance(function.hints, TypeHints):
            return None
        return function.hints.signature(name, arguments)

    def has_same_names(self, bare: dict[str, bool]) -> bool:
        """Checks whether names still are variables, or still are none."""
        return all(self.has_variable(name) == is_variable for name, is_variable in bare.items())

    def has_same_lists(self, deferred: Mapping[str, ast.Node | None]) -> bool:
        """Checks whether variables still hold the same deferred lists."""
        return all(self.deferred(name) is node for name, node in deferred.items())

    def fits(self, plan: Plan, shapes: Sequence[SourceType]) -> bool:
        """Checks whether a plan is right for these sources and the present variables."""
        return (
            plan.source_types == shapes
            and self.has_same_names(plan.bare)
            and self.has_same_lists(plan.deferred)
            and all(self.sql_type(node) == sql_type for node, sql_type in plan.constants.items())
            and all(self.world(node) == schema for node, schema in plan.worlds.items())
        )
