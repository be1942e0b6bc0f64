"""Runs a query: its SQL on one tick and the rest in Python, or row by row."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import islice
from math import prod
from typing import Any

from sqlglot import exp

from ssduck.columns.compiler import LeftToDuckDBError
from ssduck.database.database import Database
from ssduck.database.functions import pair_rows
from ssduck.database.plans import Statement
from ssduck.database.values import to_sql
from ssduck.errors import ArgumentError, EvaluationError, SelectScriptError, SqlError, warn
from ssduck.interpreter.scalar_select import ScalarSelect
from ssduck.interpreter.sources import all_elements, arrow_table, elements_of
from ssduck.language import ast
from ssduck.language.aggregates import check_one_group, is_aggregated, is_one_group
from ssduck.language.analysis import (
    aliases_of,
    cached_by_node,
    changing,
    constant_parts,
    is_impure,
    mentions,
    states,
)
from ssduck.language.clauses import (
    MANY_COLUMNS,
    Clauses,
    Groups,
    Paths,
    PythonClauses,
    Rows,
    Selected,
    SelectedValue,
    combinations,
    printed,
    row_frames,
)
from ssduck.language.evaluator import EvaluationScope, ExpressionCompiler, Frame, Thunk
from ssduck.language.hierarchy import Hierarchy, Vertex, simple_paths
from ssduck.language.operators import ELEMENT_BYTES
from ssduck.language.value_keys import MEMOS
from ssduck.simulators.kinematics import JointError
from ssduck.sql.name_resolution import ResolvedQuery
from ssduck.sql.plan import OutputColumn, PathSearch, Plan, SourceType
from ssduck.sql.relations.registry import RELATIONS
from ssduck.sql.scope import history_windows
from ssduck.sql.sql_values import NotSqlError, with_values

# After MAX_FAILURES failures in SQL, only one run in RETRY_INTERVAL tries SQL; the others take the
# cautious plan at once.
MAX_FAILURES = 3
RETRY_INTERVAL = 64
# So many rows from SQL are converted between two looks at the clock.
_ROWS_AT_ONCE = 1024
# The largest number of rows at a state for which a search or a product of lists runs row by row.
FEW_ROWS = 64
# The largest number of combinations of sources that is reused from state to state.
MAX_COMBINATIONS = 10_000
# Longer lists do not become literals of a statement.
MAX_LITERALS = 1000


class SqlFailedError(Exception):
    """A statement met a case that only Python can decide."""


class PlannedQuery:
    """A query with its plan, ready to run.

    Attributes:
        scalars: the query as functions of Python, if it is a SELECT of one row that Python can
            evaluate as DuckDB does.
    """

    def __init__(self, plan: Plan, database: Database, scope: EvaluationScope) -> None:
        self.plan = plan
        self._failures = 0
        self._database = database
        self._statement: Statement | None = None
        # The tables of the past that it reads at known ticks only.
        self._windows = history_windows(plan.select, plan.bindings)
        try:
            self.scalars: ScalarSelect | None = ScalarSelect(plan, database.shape_functions)
        except LeftToDuckDBError:
            self.scalars = None
        # The parameters that are no numbers, at the last run.
        self._last_texts: dict[str, Any] | None = None
        self._converters = {
            output.sql_type: database.converter(output.sql_type)
            for output in (
                *plan.known.values(),
                *plan.elements.values(),
                *(plan.outputs or ()),
                *plan.keys,
            )
        }
        self._clauses: Clauses | None = None
        if plan.outputs is None:
            known = {node: self._column_reader(output) for node, output in plan.known.items()}
            compiler = ExpressionCompiler(
                scope,
                known,
                frozenset(plan.python_constants),
                memorize=not is_impure(plan.query),
                query=plan.query,
            )
            self._clauses = Clauses(plan.python_clauses, compiler)

    @property
    def columns(self) -> tuple[SelectedValue, ...]:
        """The selected columns."""
        return self.plan.python_clauses.columns

    def _column_reader(self, output: OutputColumn) -> Thunk:
        index, convert = output.index, self._converters[output.sql_type]
        if convert is None:
            return lambda frame: frame.columns[index]
        return lambda frame: convert(frame.columns[index])

    def skips_sql(self) -> bool:
        """Checks whether its SQL has failed so often that this run does not try it."""
        if self._failures < MAX_FAILURES:
            return False
        self._failures += 1
        return self._failures % RETRY_INTERVAL != 0

    def forget(self) -> None:
        """Drops its prepared statement."""
        if self._statement is not None:
            self._statement.forget()
            self._statement = None

    def parameters(self, outer: Frame, values: Sequence[Any]) -> dict[str, Any]:
        """Returns the values of the SQL's parameters."""
        return _parameter_values(self.plan, outer, self._by_alias(values))

    def _by_alias(self, values: Sequence[Any]) -> dict[str, Any]:
        aliases = [source_type.alias for source_type in self.plan.source_types]
        return dict(zip(aliases, values, strict=True))

    def run(self, outer: Frame, values: Sequence[Any]) -> Selected:
        """Returns the rows of the query; the caller pins the worlds."""
        sources = self._by_alias(values)
        try:
            fetched = self._fetch(outer, sources)
        except SqlError as error:
            if self.plan.purpose == "cautious" or error.is_final:
                raise _relation_error(error) from error
            if error.is_refused:  # a bug in the translation: Python gives the right result, slowly
                warn(f"DuckDB refused a query's SQL: {error.message}")
            self._failures += 1
            raise SqlFailedError from error
        except JointError as error:  # perhaps of a row that a condition excludes
            if self.plan.purpose == "cautious":
                raise
            self._failures += 1
            raise SqlFailedError from error
        self._failures = 0
        return self.selected(fetched, outer, sources)

    def selected(
        self, fetched: list[tuple[Any, ...]], outer: Frame, sources: Mapping[str, Any]
    ) -> Selected:
        """Returns the query's rows for the rows from SQL."""
        if self._clauses is None:
            return self.output_rows(fetched)
        return self._clauses.selected(self._frames(fetched, outer, sources), outer)

    def output_rows(self, fetched: list[tuple[Any, ...]]) -> Selected:
        """Returns the query's rows for the rows from SQL, if nothing is left to Python."""
        outputs, texts = self.plan.outputs or [], None
        if self.plan.keys:
            texts = self._key_texts(fetched)
        converters = [self._converters[output.sql_type] for output in outputs]
        indices = [output.index for output in outputs]
        if any(converters) or indices != list(range(len(fetched[0]) if fetched else 0)):
            if len(indices) > MANY_COLUMNS:
                size = ELEMENT_BYTES * len(indices) * len(fetched)
                self._database.connection.meter.charge(size)
            fetched = self._converted(fetched, list(zip(indices, converters, strict=True)))
        names = self.plan.names
        if not self.plan.paths:
            return Rows(fetched, names) if texts is None else Groups.of(texts, fetched, names)
        if self.plan.graph is not None:
            meter = self._database.connection.meter
            paths = _graph_paths(self.plan.graph, fetched, names, meter.step)
            meter.check_rows(len(paths.paths))
            return paths
        return Paths([Rows(list(zip(*path, strict=True)), names) for path in fetched])

    def _key_texts(self, fetched: list[tuple[Any, ...]]) -> list[str]:
        """Returns the printed keys of groups."""
        keys = [(key.index, self._converters[key.sql_type]) for key in self.plan.keys]
        columns = [
            [printed(value, node) for (value,) in self._converted(fetched, [key])]
            for key, node in zip(keys, self.plan.query.group, strict=True)
        ]
        texts = list(map(", ".join, zip(*columns, strict=True)))
        self._database.connection.meter.charge(sum(map(len, texts)))
        return texts

    def _converted(
        self,
        fetched: list[tuple[Any, ...]],
        columns: Sequence[tuple[int, Callable[[Any], Any] | None]],
    ) -> list[tuple[Any, ...]]:
        step = self._database.connection.meter.step
        rows: list[tuple[Any, ...]] = []
        for start in range(0, len(fetched), _ROWS_AT_ONCE):
            step()
            rows += [
                tuple(
                    [
                        row[index] if convert is None else convert(row[index])
                        for index, convert in columns
                    ]
                )
                for row in fetched[start : start + _ROWS_AT_ONCE]
            ]
        return rows

    def _fetch(self, outer: Frame, sources: Mapping[str, Any]) -> list[tuple[Any, ...]]:
        try:
            parameters = _parameter_values(self.plan, outer, sources)
        except (ArgumentError, EvaluationError) as error:  # perhaps of a part that is not reached
            raise NotSqlError from error
        windows = self._windows
        ticks = {(w.schema, w.view): (parameters[w.first], parameters[w.last]) for w in windows}
        if len(ticks) < len(windows):  # a table that is read twice
            ticks = {}
        if not ticks and not self._database.connection.on_demand.leaves_out:
            return self._rows(sources, parameters)
        with self._database.reading_ticks(ticks):
            return self._rows(sources, parameters)

    def _rows(
        self, sources: Mapping[str, Any], parameters: dict[str, Any]
    ) -> list[tuple[Any, ...]]:
        """Executes the SQL with some parameters and returns its rows."""
        plan, database = self.plan, self._database
        if plan.lookup is not None:
            bound, meter = database.bound_world(plan.lookup.schema), database.connection.meter
            rows = pair_rows(plan.lookup, bound, parameters, meter)
            if rows is not None:
                return rows
        one_row = None if self.scalars is None else self.scalars.rows(parameters)
        if one_row is not None:
            database.connection.meter.check_time()
            return one_row
        # A buffer of numbers cannot hold None.
        if not plan.tables and None not in parameters.values():
            numbers = {name: parameters[name] for name in plan.numbers}
            texts = {name: value for name, value in parameters.items() if name not in numbers}
            statement = self._prepared(texts)
            if statement is not None:
                return statement.rows(numbers)
        registered = []
        try:
            for alias, name in plan.tables.items():
                source_type = next(
                    source_type for source_type in plan.source_types if source_type.alias == alias
                )
                assert source_type.sql_type is not None
                database.connection.register(
                    name, arrow_table(elements_of(sources[alias]), source_type.sql_type)
                )
                registered.append(name)
            return database.connection.rows(plan.sql, parameters or None)
        finally:
            for name in registered:
                database.connection.unregister(name)

    def _prepared(self, texts: dict[str, Any]) -> Statement | None:
        """Returns the prepared statement for these values of parameters that are no numbers.

        They are part of its text, so that preparing it pays only while they stay the same.
        """
        if not _are_same(self._last_texts, texts):
            self.forget()
            self._last_texts = texts
            if texts:
                return None
        if self._statement is None and _element_count(texts) <= MAX_LITERALS:
            select = self.plan.select.transform(with_values(texts)) if texts else self.plan.select
            assert isinstance(select, exp.Select)
            self._statement = Statement(self._database.plans, select, self.plan.numbers)
        return self._statement

    def _frames(
        self, fetched: list[tuple[Any, ...]], outer: Frame, sources: Mapping[str, Any]
    ) -> Iterator[Frame]:
        plan = self.plan
        outer_elements: dict[str | None, Any] = dict(outer.elements)
        outer_elements.pop(None, None)
        getters = [
            (source_type.alias, self._element_reader(source_type, sources))
            for source_type in plan.source_types
        ]
        only = plan.source_types[0].alias if len(plan.source_types) == 1 else None
        cached = {MEMOS: {}, **outer.cached}
        step = outer.scope.meter.step
        for columns in fetched:
            step()
            elements = dict(outer_elements)
            for alias, getter in getters:
                elements[alias] = getter(columns)
            if only is not None:
                elements[None] = elements[only]
            yield outer.row(elements, cached, columns)

    def _element_reader(
        self, source_type: SourceType, sources: Mapping[str, Any]
    ) -> Callable[[tuple[Any, ...]], Any]:
        output = self.plan.elements[source_type.alias]
        index = output.index
        if output.sql_type.type in ("any", "record"):
            elements = elements_of(sources[source_type.alias])
            return lambda columns: elements[columns[index] - 1]
        convert = self._converters[output.sql_type]
        if convert is None:
            return lambda columns: columns[index]
        return lambda columns: convert(columns[index])


def _relation_error(error: SqlError) -> SelectScriptError:
    match = re.search(r"Invalid Input Error: ((\w+): .*)", error.message)
    if match is None or match[2] not in RELATIONS:
        return error
    return ArgumentError(match[1], span=error.span)


def _are_same(before: dict[str, Any] | None, now: dict[str, Any]) -> bool:
    """Checks whether values have the same text; 0.0 and -0.0 are equal, but differ in it."""
    return before == now and (_element_count(now) > MAX_LITERALS or repr(before) == repr(now))


def _element_count(value: Any) -> int:
    if isinstance(value, dict):
        return sum(map(_element_count, value.values()))
    if isinstance(value, list):
        return sum(map(_element_count, value))
    return 1


def _graph_paths(
    graph: PathSearch,
    edges: list[tuple[Any, ...]],
    names: tuple[str, ...],
    count: Callable[[], None],
) -> Paths:
    """Returns the paths through a graph whose edges SQL has found, breadth first."""
    root = Vertex[tuple[Any, ...]]((), is_result=False)
    vertices = {(): root}
    for start, end, is_result, *items in edges:
        if tuple(end) not in vertices:
            vertices[tuple(end)] = Vertex(tuple(items), is_result)
        successors = vertices[tuple(start)].next
        if vertices[tuple(end)] not in successors:
            successors.append(vertices[tuple(end)])
    paths = simple_paths(root.next, list(vertices.values())[1:], graph.max_length, count)
    limited = islice(paths, graph.max_paths)
    return Paths([Paths([Rows([step], names) for step in path]) for path in limited])


def _parameter_values(plan: Plan, outer: Frame, sources: Mapping[str, Any]) -> dict[str, Any]:
    bound = {}
    for binding in plan.bindings:
        if binding.end:
            node, source = binding.node, binding.source
            past = sources[str(source)] if node is None else _value_in(outer, node)
            bound[binding.name] = getattr(past, binding.end)
        elif binding.source is not None:
            elements = elements_of(sources[binding.source])
            # Zeros stand for values for which SQL has no type.
            has_type = binding.sql_type.element is not None
            bound[binding.name] = list(map(to_sql, elements)) if has_type else [0] * len(elements)
        elif binding.node is not None:
            bound[binding.name] = _bound_value(outer, binding.node, binding.column)
    return bound


def _value_in(outer: Frame, node: ast.Node) -> Any:
    return outer.cached[node] if node in outer.cached else outer.value(node)


def _bound_value(outer: Frame, node: ast.Node, column: str | None) -> Any:
    try:
        value = _value_in(outer, node)
        return value.column(column) if column else to_sql(value)
    except SelectScriptError as error:  # an entity that was removed
        error.span = error.span or node.span
        raise


class RowByRowQuery:
    """A query that runs row by row over all combinations of its sources.

    Args:
        of_past: whether a source is the past of a world, so that handles depend on the row's tick.
    """

    def __init__(
        self,
        query: ast.Query,
        resolved: ResolvedQuery,
        scope: EvaluationScope,
        max_depth: int,
        deferred: Mapping[str, ast.Node | None],
        *,
        of_past: bool = False,
    ) -> None:
        self.resolved = resolved  # the query with its names resolved
        # The variables in it that hold lists which the query itself evaluates.
        self.deferred = deferred
        query = resolved.query
        self._query = query
        self._aliases = aliases_of(query)
        lazy_lists = {name for name, node in deferred.items() if node}
        compiler = ExpressionCompiler(
            scope,
            None,
            constant_parts(query, changing(query) | lazy_lists, of_past=of_past),
            constant_parts(query, (changing(query) - states(query)) | lazy_lists, of_past=of_past),
            memorize=not is_impure(query),
            query=query,
        )
        hierarchical = query.recursion is not None
        conditions = () if query.where is None or hierarchical else (query.where,)
        selected = [column.node for column in resolved.columns]
        check_one_group(query, selected)
        clauses = PythonClauses(
            resolved.columns,
            conditions,
            query.order,
            query.group,
            query.having,
            query.limit,
            is_one_group(query),
            is_aggregated(query, selected),
            query.distinct,
            query.offset,
        )
        self._clauses = Clauses(clauses, compiler)
        self._search: Hierarchy | None = None
        if hierarchical:
            self._search = Hierarchy(query, self._clauses, compiler, max_depth)
        self._sources_change = any(mentions(s.value, states(query)) for s in query.sources)

    @property
    def columns(self) -> tuple[SelectedValue, ...]:
        """The selected columns."""
        return self.resolved.columns

    def run(self, outer: Frame, values: Sequence[Any]) -> Selected:
        """Returns the rows of the query; the caller pins the worlds."""
        elements = all_elements(values)
        cached = {MEMOS: {}, **outer.cached}
        if self._search is None:
            return self._clauses.selected(row_frames(self._aliases, elements, outer, cached), outer)
        return self._search.selected(outer, self._rows_of_states(outer, elements, cached), cached)

    def _rows_of_states(
        self, outer: Frame, elements: list[Sequence[Any]], cached: dict[ast.Node, Any]
    ) -> Callable[[dict[str, Any]], Iterable[dict[str | None, Any]]]:
        """Returns a function that gives the combinations of elements at a state of the search."""
        if self._sources_change or prod(map(len, elements)) > MAX_COMBINATIONS:
            # `product` copies lists, so each open state would have a copy; tuples are shared.
            elements = [tuple(part) if type(part) is list else part for part in elements]
            return lambda state: self._combinations(outer, state, elements, cached)
        rows = list(combinations(self._aliases, elements, outer))
        return lambda _: rows

    def _combinations(
        self,
        outer: Frame,
        state: dict[str, Any],
        elements: list[Sequence[Any]],
        cached: dict[ast.Node, Any],
    ) -> Iterator[dict[str | None, Any]]:
        """Yields the combinations of elements at a state, where they differ between states."""
        frame = Frame(outer.scope, outer.elements, state, outer.placeholders, (), cached)
        if self._sources_change:
            elements = [elements_of(frame.value(s.value)) for s in self._query.sources]
        return combinations(self._aliases, elements, frame)


def is_small(query: ast.Query, source_types: Sequence[SourceType], values: Sequence[Any]) -> bool:
    """Checks whether a query is faster row by row than as a statement.

    This is so for a search through short lists, and for a product of short lists: DuckDB takes
    half a millisecond and more to plan a statement, Python microseconds for a row.
    """
    if any(
        not source_type.has_values or source_type.sql_type is None for source_type in source_types
    ):
        return False
    if prod(len(elements_of(value)) for value in values) > FEW_ROWS:
        return False
    return not any(map(_needs_sql, query.children()))


@cached_by_node
def _needs_sql(node: ast.Node) -> bool:
    """Checks whether a part is or contains a relation or a query."""
    if isinstance(node, ast.Query) or (isinstance(node, ast.Call) and node.name in RELATIONS):
        return True
    return any(map(_needs_sql, node.children()))
