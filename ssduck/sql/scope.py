"""The scope of a query's expressions in SQL: elements of sources, variables, ticks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal, Self

from sqlglot import exp

from ssduck.errors import UnknownNameError, nearest
from ssduck.formatting import short_repr
from ssduck.language import ast
from ssduck.language.analysis import IMPURE, OVER_TIME, free_aliases, is_impure
from ssduck.language.builtins import BUILTINS
from ssduck.schema import HISTORIES
from ssduck.sql.from_clause import (
    FromItem,
    JoinedEntity,
    TickRange,
    column_of,
    joined_entity,
    pairs_over_ticks,
    past_table,
    present_table,
)
from ssduck.sql.operators import truth
from ssduck.sql.plan import ParameterBinding, SourceType
from ssduck.sql.relation_calls import expanded
from ssduck.sql.relations.registry import RELATIONS
from ssduck.sql.relations.relation import Relation
from ssduck.sql.sql_values import NotSqlError, SqlValue, StatementContext
from ssduck.sql.types import INTEGER, SqlType


class ExpressionScope(ABC):
    """The scope of the expressions of one query; `Expressions` translates them.

    Args:
        context: what all queries of the statement have in common.
        outer: the scope of the query around this one.

    Attributes:
        rows: the current element of each source, by alias.
        only_alias: the alias of the only source; None if there are several.
        locals: the state variables of a hierarchical query.
        ticks: the ticks of its entities.
    """

    def __init__(self, context: StatementContext, outer: ExpressionScope | None = None) -> None:
        self.context = context
        self.names = context.names
        self.outer = outer
        self.rows: dict[str, SqlValue] = {}
        self.only_alias: str | None = None
        self.locals: Mapping[str, SqlValue] = outer.locals if outer else {}
        self._are_constant: dict[ast.Node, bool] = {}
        self.ticks: QueryTicks = QueryTicks(context, self.rows, outer.ticks if outer else None)

    def inside(self) -> Self:
        """Returns the expressions of a query nested in this one."""
        return type(self)(self.context, self)

    # -- constants --------------------------------------------------------------------------

    def element(self, alias: str | None) -> SqlValue | None:
        """Returns the current element of a source of this query or of one around it in SQL."""
        name = self.only_alias if alias is None else alias
        if name is not None and name in self.rows:
            return self.rows[name]
        # `this` alone is never that of a query further out.
        return self.outer.element(alias) if self.outer and alias is not None else None

    def is_constant(self, node: ast.Node) -> bool:
        """Checks whether the node has the same value for all rows of the statement."""
        if node not in self._are_constant:  # all that contain a part ask for it
            self._are_constant[node] = self._is_constant(node)
        return self._are_constant[node]

    def _is_constant(self, node: ast.Node) -> bool:
        match node:
            case ast.This():
                return self._is_outside(node)
            case ast.UnresolvedName() | ast.Assignment():
                return False
            case ast.QualifiedName():
                return not self._is_variable(node) and self._is_outside(node.this)
            case ast.Name(name=name):
                deferred = self.context.list_in(name)
                if deferred is not None:
                    return self.is_constant(deferred)
                return name not in self.context.changing
            case ast.TimeIndex(name=name) if name in self.context.changing:
                return False
            case ast.Query():
                return not (
                    any(alias is None or self.element(alias) for alias in free_aliases(node))
                    or is_impure(node)
                    or any(self._is_changing(part) for part in node.walk())
                )
            case ast.Call(name=name) if name in RELATIONS or name in IMPURE or name in OVER_TIME:
                return False
            case ast.Call(name=name) if name not in BUILTINS and self.ticks.has_past:
                return False  # an entity that a user's function takes is that of the row's tick
        return all(self.is_constant(child) for child in node.children())

    def _is_variable(self, node: ast.QualifiedName) -> bool:
        """Checks whether the alias is a variable; the plan is of use as long as that is so."""
        is_variable = self.context.plan.bare[node.alias] = self.names.has_variable(node.alias)
        return is_variable

    def _is_outside(self, node: ast.This) -> bool:
        """Checks whether it is the element of a source further out than this SQL statement."""
        if node.alias is None or self.element(node.alias) is not None:
            return False
        if not self.names.has_source(node.alias):
            aliases = list(self.rows)
            raise UnknownNameError(
                f"there is no source {short_repr(node.alias)} here",
                span=node.span,
                suggestions=nearest(node.alias, aliases) or aliases[:3],
            )
        return True

    def _is_changing(self, node: ast.Node) -> bool:
        if not isinstance(node, ast.Name | ast.TimeIndex):
            return False
        return node.name in self.context.changing or self.context.list_in(node.name) is not None

    # -- values -----------------------------------------------------------------------------

    @abstractmethod
    def value(self, node: ast.Node) -> SqlValue:
        """Returns the node as SQL."""

    def condition(self, node: ast.Node) -> exp.Expr:
        """Returns the node as a condition."""
        return truth(self.value(node))

    def number(self, node: ast.Node) -> SqlValue:
        """Returns the node as SQL, if it is a number and never NULL; else NotSqlError."""
        value = self.value(node)
        if not value.sql_type.is_number or value.sql_type.nullable:
            raise NotSqlError
        return value


# -- the ticks of entities ----------------------------------------------------------------------


class QueryTicks:
    """The ticks of the sources of one query, and of handles in its expressions.

    Attributes:
        joined_entities: the joined rows of handles at ticks of other rows, and of pairs.
        tick_ranges: the ticks of sources with several ticks, by the tick of the current row.
        present: the ticks of sources that are a world at its current tick, beside its past.
    """

    def __init__(
        self, context: StatementContext, rows: Mapping[str, SqlValue], outer: QueryTicks | None
    ) -> None:
        self._context = context
        self._rows = rows
        self._outer = outer
        self.joined_entities: dict[tuple[str, ...], JoinedEntity] = {}
        self._parameters: dict[str, exp.Expr] = {}
        self.tick_ranges: dict[str, TickRange] = {}
        self.present: set[str] = set()

    def past(self, source_type: SourceType, binding: ParameterBinding) -> FromItem:
        """Returns the past of a world, under a name that no column can have.

        Args:
            source_type: its type.
            binding: the binding of its parameters, without their ends.
        """
        name = self._context.alias(f"{source_type.alias} then")
        schema, table = str(source_type.schema), source_type.table
        if source_type.past_kind == "now":
            self.present.add(column_of(name, "tick").sql())
            return present_table(schema, name, table)

        def end(kind: Literal["first", "last", "id"]) -> exp.Expr:
            return self._context.parameter(kind, replace(binding, end=kind, sql_type=INTEGER))

        first, last, id = end("first"), end("last"), None
        if source_type.is_one_entity:
            id = end("id")
        if source_type.past_kind == "window":
            tick = column_of(name, "tick")
            self.tick_ranges[tick.sql()] = TickRange(schema, first, last, tick, id)
        return past_table(schema, name, first, last, id, table)

    def joins(self) -> Iterator[exp.Expr]:
        """Joins sources that are several ticks of one world by their ticks."""
        before: dict[str, exp.Expr] = {}
        for span in self.tick_ranges.values():
            if span.schema in before:
                yield exp.EQ(this=before[span.schema].copy(), expression=span.tick.copy())
            before[span.schema] = span.tick

    def join_entities(self, values: dict[str, SqlValue], *, at_one_tick: bool) -> None:
        """Joins the rows of handles at the tick of the entities at recorded ticks.

        A handle stands for the entity at the current tick; beside rows of the past, at their tick.
        A handle that is fixed to a tick stays there.

        Raises:
            NotSqlError: Python finds the ticks.
        """
        entities = {
            name: value for name, value in values.items() if value.sql_type.type == "entity"
        }
        handles = {name: value for name, value in entities.items() if not value.sql_type.past}
        past = [value for value in entities.values() if value.sql_type.past]
        rows = [value for value in past if not _is_fixed(value)]
        if at_one_tick and len(rows) < len(past) and len(entities) > 1 and self._all_rows():
            raise NotSqlError
        if not handles:
            return
        if not rows:
            schemas = {handle.sql_type.schema for handle in handles.values()}
            result = [
                v for v in self._all_rows() if v.sql_type.past and v.sql_type.schema in schemas
            ]
            if past and len(result) > 1:
                raise NotSqlError  # the tick may be that of one of these rows
            rows = result[-1:]
        if not rows:
            return
        row = rows[0]
        if row.column is not None and row.column("tick").sql() in self.present:
            return  # they are at that tick
        for name, handle in handles.items():
            if handle.sql_type.schema != row.sql_type.schema:
                continue
            if row.column is None or handle.column is None or handle.sql_type.nullable:
                raise NotSqlError
            tick, id = row.column("tick"), handle.column("id")
            is_constant = isinstance(id, exp.Parameter)
            if not is_constant or not self._is_of_own_row(tick):
                raise NotSqlError
            values[name] = self._joined_entity(handle.sql_type, tick, id).value

    def of(self, values: Iterable[SqlValue]) -> list[exp.Expr]:
        """Returns the ticks of entities, one for those that are known to be equal.

        Sources of several ticks run together; without sources, Python has checked the entities.
        """
        ticks: dict[str, exp.Expr] = {}
        for value in values:
            if value.sql_type.past and value.column is not None:
                tick = value.column("tick")
                leader = self._leading_tick(tick)
                span = self.tick_ranges.get(leader)
                ticks.setdefault(leader if span is None else f"all of {span.schema}", tick)
        return list(ticks.values())[: None if self._all_rows() else 1]

    def over_all_ticks(
        self, relation: Relation, values: Mapping[str, SqlValue], count: int
    ) -> SqlValue | None:
        """Returns a relation of shapes at all ticks of a window; None if there is no window."""
        geometry = relation.geometry
        if geometry is None or geometry.over_ticks is None:
            return None
        if any(value.sql_type.table != "entities" for value in values.values()):
            return None
        a, b, *numbers = values.values()
        if not (a.sql_type.past and b.sql_type.past):
            return None
        if a.column is None or b.column is None or self._outer is not None:
            return None
        span = self.tick_ranges.get(self._leading_tick(a.column("tick")))
        other = self.tick_ranges.get(self._leading_tick(b.column("tick")))
        if span is None or other is None or span.schema != other.schema:
            return None
        if any(not isinstance(value.sql, exp.Parameter | exp.Literal) for value in numbers):
            return None
        ids = self._id_of(a), self._id_of(b)
        if geometry.needs_single_pair and any(isinstance(id, exp.Column) for id in ids):
            return None
        distance: exp.Expr = exp.Literal.number(0)
        if geometry.is_predicate:
            values_by_name = dict(zip(list(values)[2:], numbers, strict=True))
            distance = expanded(relation.candidate_distance(count), values_by_name)
        key = (relation.name, distance.sql(), span.tick.sql(), *(id.sql() for id in ids))
        if key not in self.joined_entities:
            name = self._context.alias("pairs then")
            columns = a.column("id"), b.column("id")
            self.joined_entities[key] = pairs_over_ticks(
                relation, distance, span, ids, columns, name
            )
        return self.joined_entities[key].value

    def record_single_entity(self, alias: str, other: Callable[[], SqlValue]) -> None:
        """Notes that a source's element is always one entity."""
        value = self._rows.get(alias)
        if value is None or value.column is None or not value.sql_type.past:
            return
        span = self.tick_ranges.get(value.column("tick").sql())
        value_of_id = other() if span is not None and span.id is None else None
        if span is None or value_of_id is None:
            return
        id: exp.Expr | None = None
        if (
            value_of_id.sql_type.type == "entity"
            and value_of_id.sql_type.schema == span.schema
            and value_of_id.sql_type.table == value.sql_type.table
            and value_of_id.column
        ):
            id = value_of_id.column("id")
        elif value_of_id.sql_type.type == "string" and value.sql_type.table == "entities":
            models = exp.table_("entities_model", db=span.schema)
            has_name = exp.EQ(this=exp.column("name"), expression=value_of_id.sql.copy())
            # Several entities may have had the name; 0 stands for any of them.
            id_case = exp.case(exp.Count(this=exp.Star())).when(
                "1", exp.func("any_value", exp.column("id"))
            )
            id_case = id_case.when("0", exp.Literal.number(-1)).else_(exp.Literal.number(0))
            id = exp.select(id_case).from_(models).where(has_name).subquery()
        if id is not None:
            self.tick_ranges[span.tick.sql()] = replace(span, id=id)

    def _leading_tick(self, tick: exp.Expr) -> str:
        """Returns the tick of a source, or of the source to whose tick a handle is joined."""
        for (row, *_), known in self.joined_entities.items():
            column = known.value.column
            if column is not None and column("tick").sql() == tick.sql():
                return row
        return tick.sql()

    def _id_of(self, value: SqlValue) -> exp.Expr:
        """Returns the id of an entity: a parameter where it is the same at each tick."""
        assert value.column is not None
        for (_, id, *_), known in self.joined_entities.items():
            if known.value is value:
                return self._parameters[id]
        span = self.tick_ranges.get(value.column("tick").sql())
        return value.column("id") if span is None or span.id is None else span.id

    @property
    def has_past(self) -> bool:
        """Whether a source has rows of recorded ticks."""
        return bool(self.past_worlds)

    @property
    def past_worlds(self) -> set[str | None]:
        """The schemas of the worlds of which a source has rows of recorded ticks."""
        return {value.sql_type.schema for value in self._all_rows() if value.sql_type.past}

    def _all_rows(self) -> list[SqlValue]:
        """Returns the current elements of all sources, those of outer queries first."""
        outer = self._outer._all_rows() if self._outer is not None else []  # noqa: SLF001
        return [*outer, *self._rows.values()]

    def _is_of_own_row(self, tick: exp.Expr) -> bool:
        """Checks whether a tick is that of a source of this query, and not of one around it."""
        ticks = {
            value.column("tick").sql()
            for value in self._rows.values()
            if value.sql_type.past and value.column
        }
        return self._outer is None and tick.sql() in ticks

    def _joined_entity(self, handle: SqlType, tick: exp.Expr, id: exp.Expr) -> JoinedEntity:
        key = tick.sql(), id.sql()
        if key not in self.joined_entities:
            name = self._context.alias("handle then")
            self.joined_entities[key] = joined_entity(
                str(handle.schema), name, tick, id, handle.table
            )
            self._parameters[id.sql()] = id
        return self.joined_entities[key]


def _is_fixed(value: SqlValue) -> bool:
    """Checks whether an entity at a recorded tick is that of a variable, not that of a row."""
    return value.column is not None and isinstance(value.column("tick"), exp.Parameter)


_VIEWS = frozenset(table.history_view for table in HISTORIES.values())


@dataclass(frozen=True)
class HistoryWindow:
    """A table of the past that a query reads at some ticks only."""

    schema: str  # the schema of its world
    view: str  # the name of its view
    first: str  # the parameter of the first tick
    last: str  # the parameter of the last tick


def history_windows(
    select: exp.Query, bindings: Collection[ParameterBinding]
) -> list[HistoryWindow]:
    """Returns the tables of the past that a query reads, each with its ticks.

    Returns:
        Nothing if the query may read one of them at other ticks, as joins do.
    """
    ends = {binding.name: binding.end for binding in bindings}
    if not {"first", "last"} <= set(ends.values()):
        return []
    tables = [table for table in select.find_all(exp.Table) if table.name in _VIEWS]
    windows = [_window_of(table, ends) for table in tables]
    return [] if None in windows else [window for window in windows if window is not None]


def _window_of(table: exp.Table, ends: Mapping[str, str]) -> HistoryWindow | None:
    """Returns the ticks of a table that is read as `SELECT … WHERE tick BETWEEN $a AND $b`."""
    clause = table.parent
    select = None if clause is None else clause.parent
    if not (isinstance(clause, exp.From) and isinstance(select, exp.Select)):
        return None
    where = select.args.get("where")
    if where is None or select.args.get("joins"):
        return None
    for condition in where.this.flatten() if isinstance(where.this, exp.And) else [where.this]:
        if isinstance(condition, exp.Between) and condition.this == exp.column("tick"):
            first, last = condition.args["low"], condition.args["high"]
            if (ends.get(first.name), ends.get(last.name)) == ("first", "last"):
                return HistoryWindow(table.db, table.name, first.name, last.name)
    return None
