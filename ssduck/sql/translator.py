"""Translates a query's tree to DuckDB SQL, through sqlglot.

`translate` takes a query and the types of its sources, and returns a `Plan`: one SELECT for the
parts that SQL can evaluate, and the clauses left to Python. A part becomes SQL if its types are
known and SQL has the same meaning. Python evaluates all other parts on the rows of the SELECT,
whose columns are the largest parts of them that are SQL.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial

from sqlglot import exp

from ssduck.language import ast
from ssduck.language.aggregates import (
    check_one_group,
    is_aggregated,
    is_grouped,
    is_one_group,
    over_rows,
)
from ssduck.language.analysis import OVER_TIME, changing, free_aliases, is_impure
from ssduck.language.clauses import PythonClauses
from ssduck.sql import subqueries
from ssduck.sql.expressions import Expressions
from ssduck.sql.from_clause import (
    FromItem,
    counted_rows,
    needed_joins,
    product_of,
    record_table,
    unnested,
    world_table,
)
from ssduck.sql.groups import Groups
from ssduck.sql.name_resolution import resolve
from ssduck.sql.pair_joins import PairJoin, implied_condition, pair_join, sides_of
from ssduck.sql.pair_lookup import pair_lookup
from ssduck.sql.plan import (
    OutputColumn,
    ParameterBinding,
    Plan,
    Purpose,
    SourceType,
    TypeEnvironment,
)
from ssduck.sql.recursive_cte import recursive_search
from ssduck.sql.relations.registry import RELATIONS
from ssduck.sql.sql_values import FloatDomain, NotSqlError, SqlValue, StatementContext
from ssduck.sql.types import SqlType

_MAX_ROWS = 2**62


class NotInlineError(Exception):
    """A nested query in FROM that has to be evaluated first."""


def translate(
    query: ast.Query,
    source_types: Sequence[SourceType],
    names: TypeEnvironment,
    purpose: Purpose = "run",
    *,
    step: Callable[[], object] = bool,
) -> Plan:
    """Plans a query.

    Raises:
        NotInlineError: a source in SQL must be evaluated first.
        NotSqlError: the query is hierarchical, and runs row by row.
    """
    types = tuple(source_types)
    return _Translator(query, types, names, step, purpose).plan()


class _Translator:
    def __init__(
        self,
        query: ast.Query,
        source_types: tuple[SourceType, ...],
        names: TypeEnvironment,
        step: Callable[[], object],
        purpose: Purpose,
    ) -> None:
        self.names, self._step = names, step
        self.result = Plan(query, source_types, purpose=purpose)
        self.context = StatementContext(names, self.result, changing(query))
        self.sql = Expressions(self.context)
        subqueries.check_sources(query)
        self.elements = self._sources(query, source_types)
        self.columns: list[exp.Expr] = []
        self.pairs: list[PairJoin] = []
        # The keys of the common order of a source and the next one, by the alias of the first.
        self.positions: dict[str, exp.Ordered] = {}
        self.texts: dict[str, int] = {}
        resolved = resolve(query, self._known_source_types(), names)
        self.query = self.result.query = resolved.query
        self.selected = resolved.columns
        self.result.bare |= resolved.bare

    def plan(self) -> Plan:
        plan = self.result
        plan.names = tuple(c.name for c in self.selected if isinstance(c.name, str))
        if self.query.recursion is not None:
            return self._recursive()
        self._note_single_entities()
        conditions = list(self._conditions())
        left = [
            n for n, c in zip(ast.conjuncts(self.query.where), conditions, strict=True) if not c
        ]
        if left and self._is_product_of_lists() and not any(conditions):
            raise NotSqlError  # Python can make the combinations faster than SQL
        selected = [column.node for column in self.selected]
        names = [column.name for column in self.selected if isinstance(column.name, ast.Node)]
        aggregated = is_aggregated(self.query, selected)
        check_one_group(self.query, selected)
        result = [condition for condition in conditions if condition is not None]
        result.extend(self.sql.ticks.joins())
        is_reduced = aggregated or (self.query.distinct and not is_grouped(self.query))
        if is_reduced and not left and self._has_groups(result):
            return plan
        for node in (*selected, *names):
            if aggregated:
                self._group_columns(node)
            else:
                self._add_column(node)
        for node in self.query.group:
            self._add_column(node)
        if self.query.having is not None:
            self._group_columns(self.query.having)
        order, keys = self._order(result)
        is_in_order_of_pairs = self._is_order_of_pairs(order)
        is_group = is_one_group(self.query)
        limit, offset = self._limits(
            left=bool(left or keys or is_group or self.query.group or self.query.distinct)
        )
        in_sql = limit is not None or offset is not None
        plan.python_clauses = PythonClauses(
            self.selected,
            tuple(left),
            keys,
            self.query.group,
            self.query.having,
            None if in_sql else self.query.limit,
            is_group,
            aggregated,
            self.query.distinct,
            None if in_sql else self.query.offset,
        )
        select = self._select(result, order)
        if len(self.elements) == 2 and is_in_order_of_pairs and not in_sql:
            tables = [source.table.alias for source in self.elements]
            plan.lookup = pair_lookup(self.pairs[0].pairs, tables, result, self.columns)
        self._finish(select, limit, offset)
        return plan

    # -- sources ----------------------------------------------------------------------------

    def _sources(self, query: ast.Query, source_types: Sequence[SourceType]) -> list[FromItem]:
        elements = [
            self._element(source_type, source.value)
            for source_type, source in zip(source_types, query.sources, strict=True)
        ]
        for source_type, element in zip(source_types, elements, strict=True):
            self.sql.rows[source_type.alias] = element.value
        self.sql.only_alias = source_types[0].alias if len(source_types) == 1 else None
        return elements

    def _element(self, source_type: SourceType, node: ast.Node) -> FromItem:
        """Returns a source as a table: the entities of a world, some of them, values, a query."""
        if not source_type.has_values:
            try:
                around = Expressions(self.context)
                return subqueries.element(around, source_type.alias, node, self.sql)
            except NotSqlError as error:
                raise NotInlineError(source_type.alias) from error
        if source_type.past_kind:
            of_source = ParameterBinding("", source=source_type.alias)
            return self.sql.ticks.past(source_type, of_source)
        name = self.context.alias(source_type.alias)
        if source_type.sql_type is None:
            assert source_type.schema is not None
            return world_table(source_type.schema, name, source_type.table)
        if source_type.sql_type.type == "record":
            table = self.result.tables[source_type.alias] = f"the rows of {name}"
            return record_table(name, table, source_type.sql_type)
        sql_type = SqlType("list", source_type.sql_type if source_type.sql_type.is_sql else None)
        binding = ParameterBinding("", source=source_type.alias, sql_type=sql_type)
        values_sql = exp.cast(
            self.context.parameter(source_type.alias, binding),
            sql_type.duckdb_type,
            dialect="duckdb",
        )
        if sql_type.element is None:
            return counted_rows(name, values_sql)
        return unnested(name, SqlValue(values_sql, sql_type))

    def _known_source_types(self) -> list[SourceType]:
        return [
            source_type
            if source_type.has_values
            else SourceType(source_type.alias, sql_type=self.sql.rows[source_type.alias].sql_type)
            for source_type in self.result.source_types
        ]

    # -- clauses ----------------------------------------------------------------------------

    def _conditions(self) -> Iterator[exp.Expr | None]:
        """Yields the conditions in SQL, up to the first one with side effects."""
        has_side_effects = False
        for node in ast.conjuncts(self.query.where):
            self._step()
            has_side_effects = has_side_effects or is_impure(node)
            if has_side_effects:
                self._leave_to_python(node)
                yield None
            else:
                yield self._pairs(node) or self._condition(node)

    def _is_product_of_lists(self) -> bool:
        """Checks whether the sources are several lists that Python has."""
        source_types = self.result.source_types
        return len(source_types) > 1 and all(
            s.has_values and s.sql_type is not None and s.sql_type.type != "record"
            for s in source_types
        )

    def _pairs(self, node: ast.Node) -> exp.Expr | None:
        """Returns a condition on two sources that are one world, with all of its pairs joined."""
        sides = sides_of(node)
        if sides is None:
            return None
        live = (
            s
            for s in self.result.source_types
            if s.has_values and s.sql_type is None and not s.past_kind
        )
        worlds = {source_type.alias: source_type.schema for source_type in live}
        schemas = {worlds.get(str(side.alias)) for side in sides}
        aliases = {side.alias for side in sides}
        # Where another condition is about one of the two alone, pairs are asked about one by one.
        others = [part for part in ast.conjuncts(self.query.where) if part is not node]
        alone = any(len(free_aliases(part) & aliases) == 1 for part in others)
        if alone or len(schemas) > 1 or None in schemas:
            return None
        assert isinstance(node, ast.Call)
        order = [source_type.alias for source_type in self.result.source_types]
        first, second = sorted(sides, key=lambda side: order.index(str(side.alias)))
        result = pair_join(self.sql, node, (first, second), str(schemas.pop()))
        if result is None or (self.result.purpose == "portable" and result.pairs.search.of_boxes):
            return None
        self.pairs.append(result)
        places = [order.index(str(side.alias)) for side in result.sides]
        if result.position is not None and places[1] == places[0] + 1:
            self.positions[str(result.sides[0].alias)] = result.position
        return result.pairs.condition

    def _note_single_entities(self) -> None:
        """Records the sources that `this == cup` or `id(this) == 'cup'` restricts to one entity."""
        for node in ast.conjuncts(self.query.where):
            match node:
                case ast.Binary(operator="==", left=ast.This() as row, right=other):
                    pass
                case ast.Binary(operator="==", left=other, right=ast.This() as row):
                    pass
                case ast.Binary(
                    operator="==",
                    left=ast.Call(name="id" | "name", arguments=(ast.This() as row,)),
                    right=other,
                ):
                    pass
                case _:
                    continue
            if self.sql.is_constant(other):
                alias = row.alias or self.sql.only_alias or ""
                self.sql.ticks.record_single_entity(alias, partial(self.sql.value, other))

    def _condition(self, node: ast.Node) -> exp.Expr | None:
        try:
            holds = self.sql.condition(node)
        except NotSqlError:
            self._leave_to_python(node)
            return None
        implied = implied_condition(self.sql, node)
        if implied is None:
            return holds
        # Once for the join, and once so that no other pair is compared.
        guarded = exp.case().when(implied.copy(), holds).else_(exp.false())
        return exp.and_(implied, guarded)

    def _add_column(self, node: ast.Node) -> None:
        """Adds the column of a selected value or a key, or else columns of its parts."""
        if self.sql.is_constant(node):
            self._leave_to_python(node)
            return
        try:
            self.result.known[node] = self._output(self.sql.value(node))
        except NotSqlError:
            self._leave_to_python(node)

    def _group_columns(self, node: ast.Node) -> None:
        """Adds columns for a part of a grouped query: the arguments of its aggregates."""
        calls = over_rows(node)
        for call in calls:
            self._add_column(call.arguments[0])
        if not calls:
            self._add_column(node)
        elif node not in calls:
            self._leave_to_python(node, but=calls)

    def _order(
        self, conditions: Sequence[exp.Expr]
    ) -> tuple[list[exp.Expr], tuple[ast.OrderKey, ...]]:
        """Returns ORDER BY in SQL and in Python: the query's keys, then the sources' order."""
        ordered: list[exp.Expr] = []
        left: tuple[ast.OrderKey, ...] = ()
        orders_groups = self.query.group and any(over_rows(k.value) for k in self.query.order)
        try:
            if orders_groups or is_impure(self.query):
                raise NotSqlError  # side effects occur in the order of the sources
            ordered.extend(subqueries.ordered(self.sql, self.query.order))
        except NotSqlError:
            left = self.query.order
            for key in left:
                if orders_groups:
                    self._group_columns(key.value)
                else:
                    self._add_column(key.value)
        # A scan preserves the order; a join may not, even one with the row of parameters or in a
        # nested query.
        inline = any(not source_type.has_values for source_type in self.result.source_types)
        nested = any(part.find(exp.Select) for part in (*self.columns, *conditions))
        may_mix = len(self.elements) > 1 or ordered or self.result.bindings or inline or nested
        if self.query.is_ordered and may_mix:
            is_ordered = False
            for source_type, element in zip(self.result.source_types, self.elements, strict=True):
                both = self.positions.get(source_type.alias)
                keys = element.position if both is None else (both,)
                # Sorting by the number of a pair is faster than by two ids.
                if both is not None or not is_ordered:
                    ordered.extend(key.copy() for key in keys)
                is_ordered = both is not None
        return ordered, left

    def _is_order_of_pairs(self, order: Sequence[exp.Expr]) -> bool:
        """Checks whether the order of the rows is that in which a search finds its pairs."""
        if len(self.pairs) != 1:
            return False
        (pair,) = self.pairs
        if pair.position is not None:
            return [key.this for key in order] == [pair.position.this]
        aliases = [source_type.alias for source_type in self.result.source_types]
        is_in_order = [side.alias for side in pair.sides] == aliases
        tables = [key for element in self.elements for key in element.position]
        return pair.pairs.search.of_boxes and is_in_order and [*order] == tables

    def _limits(self, *, left: bool) -> tuple[int | None, int | None]:
        """Returns the numbers of LIMIT and OFFSET if SQL can apply them, else None for both."""
        nodes = (self.query.limit, self.query.offset)
        given = [node for node in nodes if node is not None]
        if not left and all(map(_is_small_count, given)):
            limit, offset = (
                node.value if isinstance(node, ast.Literal) else None for node in nodes
            )
            return limit, offset  # type: ignore[return-value]  # they are whole numbers
        self.result.python_constants += [node for node in given if self.sql.is_constant(node)]
        return None, None

    # -- the statement ----------------------------------------------------------------------

    def _has_groups(self, conditions: Sequence[exp.Expr]) -> bool:
        """Completes the plan by groups in SQL; returns whether these are not left to Python."""
        plan, query = self.result, self.query
        given = [node for node in (query.limit, query.offset) if node is not None]
        if plan.purpose == "rows" or is_impure(query) or len(plan.names) < len(self.selected):
            return False
        if not all(map(_is_small_count, given)):
            plan.left_for = given[0]
            return False
        groups = Groups(self.sql, is_plain=plan.purpose == "portable")
        # The keys of other sources are ids, numbers of ticks and of elements, and truth values.
        are_numbers = all(source_type.has_values for source_type in plan.source_types)
        try:
            found = groups.grouped(query, self.selected, self.elements, are_numbers=are_numbers)
        except NotSqlError:
            plan.left_for = groups.part
            return False
        columns = [
            OutputColumn(place, value.sql_type)
            for place, value in enumerate((*found.items, *found.keys))
        ]
        plan.outputs, plan.keys = columns[: len(found.items)], columns[len(found.items) :]
        plan.known.update(zip((c.node for c in self.selected), plan.outputs, strict=True))
        plan.python_clauses = PythonClauses(self.selected)
        rows = self._rows(found.columns, conditions)
        select = found.select.from_(rows.subquery(found.alias), copy=False)
        self._finish(select, *self._limits(left=False))
        return True

    def _recursive(self) -> Plan:
        plan = self.result
        if is_impure(self.query) or any(source_type.past_kind for source_type in plan.source_types):
            raise NotSqlError
        result = recursive_search(self.sql, self.query, self.selected, self.elements)
        plan.paths = True
        plan.graph = result.graph
        plan.outputs = [
            OutputColumn(index, sql_type) for index, sql_type in enumerate(result.sql_types)
        ]
        plan.python_clauses = PythonClauses(self.selected)
        self._finish(result.select)
        return plan

    def _select(self, conditions: list[exp.Expr], order: list[exp.Expr]) -> exp.Select:
        plan = self.result
        dynamic = len(plan.names) < len(self.selected)
        python_clauses = plan.python_clauses
        sorts = PythonClauses(self.selected, group=self.query.group)
        in_python = python_clauses != sorts or not plan.known.keys() >= set(self.query.group)
        if plan.python_parts or plan.python_constants or in_python or dynamic:
            for source_type in plan.source_types:
                value = self.sql.rows[source_type.alias]
                try:
                    if source_type.has_values and value.sql_type.type in ("any", "record"):
                        plan.elements[source_type.alias] = self._column(value.sql, value.sql_type)
                    else:
                        plan.elements[source_type.alias] = self._output(value)
                except NotSqlError as error:
                    raise NotInlineError(source_type.alias) from error
        else:
            plan.outputs = [plan.known[column.node] for column in self.selected]
            plan.keys = [plan.known[node] for node in self.query.group]
        return self._rows(self.columns, conditions, order)

    def _rows(
        self,
        columns: Sequence[exp.Expr],
        conditions: Sequence[exp.Expr],
        order: Sequence[exp.Expr] = (),
    ) -> exp.Select:
        """Returns the rows of the sources, as a SELECT of these columns."""
        select = product_of(self.elements)
        for join in self.pairs:
            select.append("joins", exp.Join(this=join.table, kind="CROSS"))
        # The parts are copied once, instead of the whole tree by each call.
        select.set("expressions", [c.copy() for c in columns or [exp.Literal.number(1)]])
        if conditions:
            select.where(*(condition.copy() for condition in conditions), copy=False)
        if order:
            select.set("order", exp.Order(expressions=[key.copy() for key in order]))
        for needed in needed_joins(self.sql.ticks.joined_entities.values(), select):
            select.append("joins", needed)
        return select

    def _finish(
        self, select: exp.Select, limit: int | None = None, offset: int | None = None
    ) -> None:
        plan = self.result
        select = select if limit is None else select.limit(limit)
        select = select if offset is None else select.offset(offset)
        plan.select = select
        plan.may_fail = self.context.possible_failures > 0
        # Parts that turned out not to be SQL may have left parameters.
        used = {parameter.name for parameter in select.find_all(exp.Parameter)}
        plan.bindings = [binding for binding in plan.bindings if binding.name in used]

    def _output(self, value: SqlValue) -> OutputColumn:
        if not value.sql_type.comes_back:
            raise NotSqlError
        if (
            value.domain == FloatDomain.NAN
        ):  # in Python, NaN differs from itself, so that columns are not shared
            self.columns.append(value.sql)
            return OutputColumn(len(self.columns) - 1, value.sql_type)
        return self._column(value.sql, value.sql_type)

    def _column(self, sql: exp.Expr, sql_type: SqlType) -> OutputColumn:
        text = sql.sql(dialect="duckdb")
        if text not in self.texts:
            self.texts[text] = len(self.columns)
            self.columns.append(sql)
        return OutputColumn(self.texts[text], sql_type)

    def _leave_to_python(self, node: ast.Node, but: Sequence[ast.Node] = ()) -> None:
        """Leaves a node to Python, and fetches its largest parts that SQL can express."""
        if node in but:
            return
        if but:
            inside = set(node.walk())
            but = [part for part in but if part in inside]
        if not but and self.sql.is_constant(node):
            self.result.python_constants.append(node)
            return
        if isinstance(node, ast.Call) and node.name not in RELATIONS:
            self.names.check_call(node)
        if isinstance(node, ast.Call) and node.name in OVER_TIME:
            return  # its parts are evaluated at other ticks
        try:
            if but:
                raise NotSqlError
            self.result.known[node] = self._output(self.sql.value(node))
        except NotSqlError:
            # A nested query runs separately, over the elements.
            if not isinstance(node, ast.Query):
                for child in _parts(node):
                    self._leave_to_python(child, but)


def _is_small_count(node: ast.Node) -> bool:
    """Checks whether LIMIT or OFFSET is a number that SQL can take."""
    value = node.value if isinstance(node, ast.Literal) else None
    return type(value) is int and value < _MAX_ROWS


def _parts(node: ast.Node) -> Iterator[ast.Node]:
    """Yields the columns to fetch for a part left to Python; of a long comparison, its operands."""
    for child in node.children():
        if isinstance(node, ast.OperatorChain) and isinstance(child, ast.Binary):
            yield from child.children()
        else:
            yield child
