"""Translates hierarchical queries to WITH RECURSIVE.

Each row of the recursive table is a path: its state, the places of its rows in the sources, and
the values selected at each of them. Paths are ordered by their places, which is the depth-first
order of the sources. With MEMORIZE, the table has a row for each distinct selected row instead
(USING KEY), and the statement yields the edges between them. UNIQUE depends on the order of the
search itself, and runs row by row in `ssduck.language.hierarchy`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from sqlglot import exp

from ssduck.language import ast
from ssduck.language.clauses import SelectedValue
from ssduck.sql.expressions import Expressions
from ssduck.sql.from_clause import FromItem, world_table
from ssduck.sql.plan import PathSearch
from ssduck.sql.sql_values import FloatDomain, NotSqlError, SqlValue, failure
from ssduck.sql.types import BOOLEAN, INTEGER, SqlType, merged

# The largest number of open paths: a breadth-first search with more needs too much memory. A
# depth-first search in Python needs little.
MAX_OPEN_STATES = 1_000_000
_PATHS = "paths"
_STEPS = "steps"


@dataclass(frozen=True)
class RecursiveSearch:
    """A search in SQL."""

    # A row for each path, with a list of each item's values along the path; or a row for each edge
    # of a graph: the places of its ends, whether the second is a result, its items.
    select: exp.Select
    sql_types: tuple[SqlType, ...]  # the types of the columns
    graph: PathSearch | None = None  # the largest length and number of paths in a graph


def recursive_search(
    sql: Expressions,
    query: ast.Query,
    columns: Sequence[SelectedValue],
    elements: Sequence[FromItem],
) -> RecursiveSearch:
    """Returns a hierarchical query as SQL."""
    recursion = query.recursion
    assert recursion is not None
    if recursion.unique or query.group or query.order or query.having is not None:
        raise NotSqlError
    if recursion.memorizes and recursion.memorize is None:
        raise NotSqlError  # the number of levels is unknown until a path is found
    if not all(isinstance(column.name, str) for column in columns):
        raise NotSqlError
    search = _Search(sql, query, recursion, columns, elements)
    items = tuple(item.sql_type for item in search.items)
    if not recursion.memorizes:
        return RecursiveSearch(
            search.select(), tuple(SqlType("list", sql_type) for sql_type in items)
        )
    assert recursion.memorize is not None
    levels = _number(recursion.memorize)
    place = SqlType("list", INTEGER)
    return RecursiveSearch(
        search.edges(levels),
        (place, place, BOOLEAN, *items),
        PathSearch(levels, search.path_limit()),
    )


class _Search:
    def __init__(
        self,
        sql: Expressions,
        query: ast.Query,
        recursion: ast.Recursion,
        columns: Sequence[SelectedValue],
        elements: Sequence[FromItem],
    ) -> None:
        self.sql = sql
        self.query = query
        self.recursion = recursion
        self.elements = elements
        self.entities: dict[str, FromItem] = {}
        self.steps = _assigned_values(recursion.step)
        self.start = {
            name: self._initial_value(value)
            for name, value in _assigned_values(recursion.start).items()
        }
        self.sql_types = {name: value.sql_type for name, value in self.start.items()}
        self.names = _column_names(self.sql_types)
        self.next = self._states()
        self.items = [sql.context.nan_checked(sql.value(column.node)) for column in columns]
        if any(
            not i.sql_type.comes_back or i.sql_type.nullable or i.may_exceed_double
            for i in self.items
        ):
            raise NotSqlError
        self.stop = sql.condition(recursion.stop)
        where = query.where
        self.is_result = self.stop if where is None else sql.condition(where)
        sql.context.note_possible_failure()  # it may have too many open paths

    def _initial_value(self, value: ast.Node) -> SqlValue:
        if not self.sql.is_constant(value):
            raise NotSqlError
        return self.sql.value(value)

    def _states(self) -> dict[str, SqlValue]:
        """Returns the state variables after a step, once their types no longer change."""
        steps = self.steps
        if not steps.keys() <= self.sql_types.keys():
            raise NotSqlError
        for _ in range(3):
            self.sql.locals = {
                name: self._state(name, sql_type) for name, sql_type in self.sql_types.items()
            }
            values = {
                name: self.sql.context.nan_checked(self.sql.value(node))
                for name, node in steps.items()
            }
            sql_types = {
                name: merged((sql_type, values[name].sql_type)) or sql_type
                if name in values
                else sql_type
                for name, sql_type in self.sql_types.items()
            }
            if any(not sql_type.comes_back or sql_type.nullable for sql_type in sql_types.values()):
                raise NotSqlError
            if sql_types == self.sql_types:
                return {name: values.get(name, self.sql.locals[name]) for name in sql_types}
            self.sql_types = sql_types
        raise NotSqlError

    def _state(self, name: str, sql_type: SqlType) -> SqlValue:
        """Returns a state variable; an entity is looked up by its id."""
        if sql_type.type != "entity":
            return SqlValue(self._state_column(name), sql_type, domain=FloatDomain.INFINITE)
        if name not in self.entities:
            if sql_type.schema is None or sql_type.nullable or sql_type.past:
                raise NotSqlError
            alias = self.sql.context.alias(f"state {name}")
            self.entities[name] = world_table(sql_type.schema, alias, sql_type.table)
        return self.entities[name].value

    def _state_column(self, name: str) -> exp.Expr:
        return _column(_PATHS, self.names[name])

    # -- the statement ----------------------------------------------------------------------

    def select(self) -> exp.Select:
        """Returns the paths in depth-first order of the sources."""
        item_columns = [_column(_PATHS, f"item {index}") for index in range(len(self.items))]
        select = exp.select(*item_columns).from_(_table(_PATHS))
        select = select.where(_column(_PATHS, "found")).order_by(_column(_PATHS, "place"))
        union = exp.union(self._initial_path(), self._next_paths(), distinct=False)
        select = select.with_(exp.to_identifier(_PATHS), as_=union, recursive=True)
        path_limit = self.path_limit()
        return select if path_limit is None else select.limit(path_limit)

    def path_limit(self) -> int | None:
        limits = [n for n in (self.recursion.maximum, self.query.limit) if n is not None]
        return min(map(_number, limits), default=None)

    def _initial_path(self) -> exp.Select:
        return exp.select(
            *self._as_states(self.start),
            _named("place", _empty(INTEGER)),
            *(_named(key, _empty(item.sql_type)) for key, item in self.keyed_items()),
            _named("found", exp.false()),
        )

    def _as_states(self, values: Mapping[str, SqlValue]) -> list[exp.Expr]:
        """Values as the columns of the state variables."""
        return [
            _named(self.names[name], _cast(value.sql, self.sql_types[name]))
            for name, value in values.items()
        ]

    def keyed_items(self) -> Iterable[tuple[str, SqlValue]]:
        """Returns the selected values, each with the name of its column."""
        return [(f"item {index}", item) for index, item in enumerate(self.items)]

    def _next_paths(self) -> exp.Select:
        """Returns the open paths, each extended by a row."""
        result = _column(_STEPS, "found")
        states = []
        for column in self.names.values():
            stays = exp.case().when(result.copy(), _column(_STEPS, column))
            states.append(_named(column, stays.else_(_column(_STEPS, f"next {column}"))))
        items = [_named(key, _column(_STEPS, key)) for key, _ in self.keyed_items()]
        return exp.select(*states, _column(_STEPS, "place"), *items, result).from_(
            self._steps().subquery(_STEPS)
        )

    def _steps(self) -> exp.Select:
        ends = exp.paren(self.is_result.copy())
        states = [_named(name, _column(_PATHS, name)) for name in self.names.values()]
        following = []
        for name, value in self.next.items():
            stays = exp.case().when(ends.copy(), self._state_column(name))
            state = stays.else_(_cast(value.sql, self.sql_types[name]))
            following.append(_named(f"next {self.names[name]}", state))
        items = [
            _named(key, exp.func("list_append", _column(_PATHS, key), _cast(i.sql, i.sql_type)))
            for key, i in self.keyed_items()
        ]
        place, found = _named("place", self._next_place()), _named("found", ends)
        select = exp.select(*states, *following, place, *items, found)
        select = self._from(select, self._open_paths())
        return select.where(exp.Not(this=self._is_visited())) if self.recursion.no_cycle else select

    def _from(self, select: exp.Select, paths: exp.Expr) -> exp.Select:
        """Returns each open path with each row, without dead ends."""
        select = select.from_(paths)
        for element in (*self.entities.values(), *self.elements):
            select = select.join(element.table, join_type="cross")
        for name, element in self.entities.items():
            is_state = exp.EQ(this=element.value.sql, expression=self._state_column(name))
            select = select.where(is_state)
        goes_on = exp.or_(self.is_result.copy(), exp.Not(this=exp.paren(self.stop.copy())))
        return select.where(exp.Not(this=_column(_PATHS, "found")), goes_on)

    def _open_paths(self) -> exp.Expr:
        """Returns the paths of the last round; the statement fails if they are too many."""
        count = exp.Window(this=exp.Count(this=exp.Star()))
        too_many = exp.GT(this=count, expression=exp.Literal.number(MAX_OPEN_STATES))
        length = exp.func("len", _column(_PATHS, "item 0"))
        too_deep = exp.GTE(this=length, expression=exp.Literal.number(self.sql.names.max_depth))
        is_endless = exp.and_(exp.Not(this=_column(_PATHS, "found")), too_deep)
        return _failing_if(exp.or_(too_many, is_endless), _table(_PATHS))

    def _next_place(self) -> exp.Expr:
        """Returns the place of a path with a further row."""
        places = [_column(_PATHS, "place"), self._place_of_row()]
        return exp.Anonymous(this="list_concat", expressions=places)

    def _place_of_row(self) -> exp.Expr:
        keys = [key for element in self.elements for key in element.position]
        if any(key.args.get("desc") for key in keys):
            raise NotSqlError
        return exp.Array(expressions=[exp.cast(key.this.copy(), "BIGINT") for key in keys])

    def _is_visited(self) -> exp.Expr:
        """Checks whether the selected values occurred before on the path."""
        numbers = exp.func("generate_subscripts", _column(_PATHS, "item 0"), exp.Literal.number(1))
        steps = exp.select(exp.alias_(numbers, "i")).subquery("before")
        if len(self.items) == 1:
            (item,) = self.items
            return exp.func(
                "list_contains", _column(_PATHS, "item 0"), _cast(item.sql, item.sql_type)
            )
        alike = []
        for key, item in self.keyed_items():
            before = exp.func("list_extract", _column(_PATHS, key), exp.column("i", "before"))
            alike.append(exp.EQ(this=before, expression=exp.paren(item.sql.copy())))
        return exp.Exists(this=exp.select(exp.Literal.number(1)).from_(steps).where(*alike))

    # -- the graph of MEMORIZE ---------------------------------------------------------------

    def edges(self, levels: int) -> exp.Select:
        """Returns the edges of the graph of distinct selected rows, in breadth-first order.

        The first row of the recursive table is not a vertex; its successors are the roots.
        """
        keys = [key for key, _ in self.keyed_items()]
        first = exp.select(
            *self._as_states(self.start),
            *(_named(key, _cast(exp.Null(), item.sql_type)) for key, item in self.keyed_items()),
            _named("place", _empty(INTEGER)),
            _named("found", exp.false()),
        )
        # In parentheses, because it has its own order.
        union = exp.union(first, self._next_level(levels).subquery(), distinct=True)
        result = [_column("ends", name) for name in ("place", "found", *keys)]
        select = exp.select(_column(_PATHS, "place"), *result)
        select = self._from(select, self._within(levels))
        select = select.join(exp.table_(_PATHS, alias="ends"), join_type="cross")
        select = select.where(*self._are_items("ends"))
        places = exp.func("len", _column(_PATHS, "place"))
        select = select.order_by(places, _column(_PATHS, "place"), self._place_of_row())
        select = select.with_(exp.to_identifier(_PATHS), as_=union, recursive=True)
        (table,) = select.find_all(exp.CTE)
        table.set("key_expressions", [exp.to_identifier(key, quoted=True) for key in keys])
        return select

    def _next_level(self, levels: int) -> exp.Select:
        """Returns the successors of the last level's rows that occurred at no level."""
        items = [_named(key, _cast(item.sql, item.sql_type)) for key, item in self.keyed_items()]
        place = self._next_place()
        result = _named("found", exp.paren(self.is_result.copy()))
        states = self._as_states(self.next)
        select = exp.select(*states, *items, _named("place", place), result)
        visited = exp.select(exp.Literal.number(1)).from_(
            exp.table_(_PATHS, db="recurring", alias="known")
        )
        visited = visited.where(*self._are_items("known"))
        select = self._from(select, self._checked(levels))
        select = select.where(exp.Not(this=exp.Exists(this=visited)))
        # The first one of equal rows counts.
        return select.distinct(*(item.this.copy() for item in items)).order_by(place.copy())

    def _checked(self, levels: int) -> exp.Expr:
        """Returns the rows of the last level; the statement fails if there are too many levels."""
        max_depth = exp.Literal.number(self.sql.names.max_depth)
        deep = exp.GTE(this=self._level(), expression=max_depth)
        return _failing_if(deep, self._within(levels))

    def _within(self, levels: int) -> exp.Expr:
        """Returns the rows that may have successors."""
        is_within = exp.LT(this=self._level(), expression=exp.Literal.number(levels))
        rows = exp.select("*").from_(_table(_PATHS)).where(is_within)
        return rows.subquery(_PATHS)

    def _level(self) -> exp.Expr:
        """Returns the number of rows that a place has."""
        keys = sum(len(element.position) for element in self.elements)
        length = exp.func("len", _column(_PATHS, "place"))
        return exp.IntDiv(this=length, expression=exp.Literal.number(keys))

    def _are_items(self, table: str) -> list[exp.Expr]:
        return [
            exp.EQ(this=_column(table, key), expression=_cast(item.sql, item.sql_type))
            for key, item in self.keyed_items()
        ]


def _column_names(states: Iterable[str]) -> dict[str, str]:
    """Returns the column names of state variables, which differ in more than case."""
    names: dict[str, str] = {}
    for name in states:
        alike = sum(name.casefold() == other.casefold() for other in names)
        names[name] = f"state {name}" if not alike else f"state {name} {alike + 1}"
    return names


def _assigned_values(parts: Iterable[ast.Node]) -> dict[str, ast.Node]:
    result: dict[str, ast.Node] = {}
    for part in parts:
        if not isinstance(part, ast.Assignment):
            raise NotSqlError  # Python evaluates other expressions
        result[part.name] = part.value
    return result


def _number(node: ast.Node) -> int:
    match node:
        case ast.Literal(value=number) if type(number) is int and 0 <= number < 2**31:
            return number
    raise NotSqlError


def _failing_if(condition: exp.Expr, paths: exp.Expr) -> exp.Expr:
    """Returns paths, of which a condition makes the statement fail."""
    checked = exp.case().when(condition, failure(BOOLEAN)).else_(exp.true())
    counted = exp.select("*", _named("counted", checked)).from_(paths)
    rows = exp.select("*").from_(counted.subquery(_PATHS)).where(_column(_PATHS, "counted"))
    return rows.subquery(_PATHS)


def _named(name: str, value: exp.Expr) -> exp.Expr:
    return exp.alias_(value, name, quoted=" " in name)


def _table(name: str) -> exp.Expr:
    return exp.to_table(name)


def _column(table: str, name: str) -> exp.Expr:
    return exp.column(exp.to_identifier(name, quoted=True), table=exp.to_identifier(table))


def _cast(value: exp.Expr, sql_type: SqlType) -> exp.Expr:
    return exp.cast(value.copy(), sql_type.duckdb_type, dialect="duckdb")


def _empty(element: SqlType) -> exp.Expr:
    return exp.cast(exp.Array(expressions=[]), f"{element.duckdb_type}[]", dialect="duckdb")
