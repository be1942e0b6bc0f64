"""Makes queries whose plans DuckDB keeps.

DuckDB plans a prepared statement anew at each run if its plan scans a table, because the table may
have got other rows (https://github.com/duckdb/duckdb/pull/23712, since 2.0.1); for a small table,
that takes several times as long as the run itself. A plan without a scan is kept. So the rows come
from a function without arguments of its own, whose value is the list of a world's rows at the
current tick, with the columns that the query reads. DuckDB tells which these are (EXPLAIN).
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from math import prod
from typing import Any, Literal, TypeAlias

import pyarrow as pa
from sqlglot import exp

from ssduck.database.binding import BoundWorld
from ssduck.database.connection import Connection, execution_of
from ssduck.database.schemas import part_rows
from ssduck.database.statement_names import may_read_unnamed
from ssduck.errors import SelectScriptError, SqlError
from ssduck.recording.stores.history_sql import quoted
from ssduck.schema import TABLES, Column, Table
from ssduck.world.live_tables import LiveTable

# Beyond this number of rows, or of combinations of rows, planning is cheap in comparison, and what
# DuckDB knows of the sizes of tables that it scans makes better plans.
MAX_ROWS = 4_096
MAX_COMBINATIONS = 2**17
_SQL_TYPES = {"double": "DOUBLE", "integer": "BIGINT", "string": "VARCHAR", "boolean": "BOOLEAN"}
_SCAN = "PYTHON_ARROW_SCAN"
_ROW = "ssduck row"
# The beginning of a mark, which no other part of a text may have.
MARK = "ssduck source"
# What the views of links and sites need of their own rows, and of those of the entities.
_OF_PARTS = frozenset(("tick", "entity", "link", "name", "region"))
_OF_ENTITIES = frozenset(("tick", "id", "name", "kind", "enabled", "visible", "run"))
_WORD = re.compile(r"\w+")

_numbers = count(1)


@dataclass(frozen=True)
class RowSource:
    """The rows that a name behind FROM stands for."""

    table: Callable[[], LiveTable]  # returns the table that has them at present
    columns: Sequence[Column]  # its columns
    # What its view makes of the rows; None if that has all of them as they are.
    view: PartView | None = None


@dataclass(frozen=True)
class PartView:
    """The view of links or of sites."""

    table: Table  # the table of links or of sites
    entities: RowSource  # the entities to which these belong


@dataclass(frozen=True)
class KeptQuery:
    """A query of small tables, whose plan may be kept."""

    text: str  # the query, with a `mark`, quoted, in place of each name behind FROM
    sources: Sequence[RowSource]  # what the marks stand for
    has_known_columns: bool  # whether the names of its columns are written out
    # Whether it depends on no columns but those that its plan reads, or its text names.
    is_pruned: bool

    @staticmethod
    def mark(number: int) -> str:
        """Returns what stands in the text in place of a source."""
        return f"{MARK} {number}"


def live_source(bound: BoundWorld, table: Table) -> RowSource | None:
    """Returns the rows of a world's table at the current tick; None if they are not there."""
    world = bound.reference()
    if world is None or world.is_final or table.source in world.snapshot.unavailable:
        return None

    def current() -> LiveTable:
        return bound.world.snapshot.tables[table.source]

    if not table.view_columns:
        return RowSource(current, table.columns)
    entities = live_source(bound, TABLES["entities"])
    return (
        None if entities is None else RowSource(current, table.columns, PartView(table, entities))
    )


class KeptPlans:
    """Prepares queries so that DuckDB keeps their plans."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        # The functions that prepared statements call, by the statement's name.
        self._functions: dict[str, list[str]] = {}

    def prepare(self, name: str, sql: str, query: KeptQuery) -> bool:
        """Prepares a query that has run before; returns whether its plan is kept."""
        self._functions[name] = []
        is_kept = False
        try:
            is_kept = self._prepare(name, sql, query)
        except SqlError:
            pass  # a plan without scans lacks a name, such as one that the text does not have
        finally:
            if not is_kept:
                self.drop(name)
        return is_kept

    def _prepare(self, name: str, sql: str, query: KeptQuery) -> bool:
        read = self._read_columns(sql, query)
        if read is None:
            return False
        text = self._without_scans(name, query, read)
        if not (query.has_known_columns or self._are_same(text, sql)):
            return False
        self._connection.prepare(name, text)
        if all(map(_is_kept, self._operators(execution_of(name)))):
            return True
        self._connection.deallocate(name)
        return False

    def drop(self, name: str) -> None:
        """Removes the functions of a statement, if it has any."""
        for function in self._functions.pop(name, ()):
            self._connection.remove_function(function)

    def _read_columns(self, sql: str, query: KeptQuery) -> set[str] | None:
        """Returns the columns that a query may need of a source; None if no plan is worth it."""
        sizes = [max(1, source.table().count) for source in query.sources]
        if max(sizes, default=1) > MAX_ROWS or prod(sizes) > MAX_COMBINATIONS:
            return None
        scans = [one["extra_info"] for one in self._operators(sql) if _is_scan(one)]
        if any(info["Function"] != _SCAN for info in scans):
            return None
        if not query.is_pruned:
            return {column.name for source in query.sources for column in source.columns}
        words = _WORD.findall(sql)  # a name may be needed, though no value is
        read = {*words, *map(str.lower, words)}
        for info in scans:
            columns = info.get("Projections", [])
            read.update([columns] if isinstance(columns, str) else columns)
        return read

    def _operators(self, sql: str) -> Iterator[dict[str, Any]]:
        ((_, text),) = self._connection.internal_rows(f"EXPLAIN (FORMAT json) {sql}")
        operators = json.loads(text)
        while operators:
            operator = operators.pop()
            operators.extend(operator["children"])
            yield operator

    def _without_scans(self, name: str, query: KeptQuery, read: set[str]) -> str:
        """Returns a query with lists of rows in place of its tables."""
        text = query.text
        for number, source in enumerate(query.sources):
            rows = self._rows(name, source, read)
            if (view := source.view) is not None:
                entities = f"({self._rows(name, view.entities, _OF_ENTITIES)})"
                shown = {column.name for column in view.table.shown_columns}
                listed = (c.name for c in _read_of(source, read) if c.name in shown)
                rows = part_rows(view.table, rows, entities, ", ".join(map(quoted, listed)))
            text = text.replace(quoted(query.mark(number)), f"({rows})")
        return text

    def _rows(self, name: str, source: RowSource, read: AbstractSet[str]) -> str:
        """Returns the query of the rows of a new function that has those of a source."""
        columns = _read_of(source, read)
        function = f"ssduck rows {next(_numbers)}"
        rows = _CurrentRows(source.table, [column.name for column in columns])
        self._connection.register_function(
            function, rows, ["INTEGER"], _list_type(columns), type="arrow", side_effects=True
        )
        self._functions[name].append(function)
        return _rows_of(function, columns)

    def _are_same(self, sql: str, other: str) -> bool:
        """Checks whether two queries have the same columns."""
        return self._connection.columns(sql, None) == self._connection.columns(other, None)


class _CurrentRows:
    """A function of SQL: the list of a table's rows, as one value that shares their memory."""

    def __init__(self, table: Callable[[], LiveTable], columns: Sequence[str]) -> None:
        self._table = table
        self._columns = columns
        self._version: int | None = None
        self._rows: pa.Array | None = None

    def __call__(self, calls: pa.Array) -> pa.Array:
        table = self._table()
        arrow = table.arrow
        if table.version != self._version or self._rows is None:
            columns = [arrow.column(name).chunk(0) for name in self._columns]
            rows = pa.StructArray.from_arrays(columns, self._columns)
            self._rows = pa.ListArray.from_arrays(pa.array([0, len(rows)], pa.int32()), rows)
            self._version = table.version
        return self._rows if len(calls) == 1 else pa.concat_arrays([self._rows] * len(calls))


def _is_scan(operator: Mapping[str, Any]) -> bool:
    return "Function" in operator["extra_info"]


def _is_kept(operator: Mapping[str, Any]) -> bool:
    """Checks whether an operator of a plan neither prevents that it is kept nor multiplies rows."""
    inner = operator["children"]
    while inner and inner[0]["name"] == "PROJECTION":
        inner = inner[0]["children"]
    is_single = operator["name"] != "UNNEST" or inner[0]["name"] == "DUMMY_SCAN"
    return is_single and not _is_scan(operator)


def _read_of(source: RowSource, read: AbstractSet[str]) -> list[Column]:
    """Returns the columns of a source that a query reads, or one that is there to be counted."""
    needed = read if source.view is None else read | _OF_PARTS
    columns = [c for c in source.columns if c.name in needed or c.second_name in needed]
    return columns or [column for column in source.columns if column.type == "integer"][:1]


def _list_type(columns: Sequence[Column]) -> str:
    """Returns the type of a list of rows in SQL."""
    if not columns or any(column.type not in _SQL_TYPES for column in columns):
        raise SqlError("lists are read where they are")
    fields = (f"{quoted(column.name)} {_SQL_TYPES[column.type]}" for column in columns)
    return f"STRUCT({', '.join(fields)})[]"


def _rows_of(function: str, columns: Sequence[Column]) -> str:
    """Returns the query of the rows of a function's list."""
    shown = [(column.name, column.name) for column in columns]
    shown += [(column.name, column.second_name) for column in columns if column.second_name]
    fields = (f"{quoted(_ROW)}.{quoted(name)} AS {quoted(other)}" for name, other in shown)
    rows = f"SELECT unnest({quoted(function)}(1)) AS {quoted(_ROW)}"
    return f"SELECT {', '.join(fields)} FROM ({rows})"  # noqa: S608  # all names are quoted


# The names of ssduck's prepared statements: this prefix and a number.
NAME_PREFIX = "ssduck statement "
# The number of runs before a statement is prepared: to make a plan that is kept takes as long as
# four runs without one.
RUNS_BEFORE_PLAN = 3
# The types of the parameters of a statement, which are numbers, by name.
NumberTypes: TypeAlias = Mapping[str, Literal["double", "integer"]]
# No source can have this name, because it has a space.
_PARAMETERS = "the parameters"


class PreparedPlans:
    """The plans of ssduck's own prepared statements in DuckDB.

    DuckDB makes a plan anew where a table that it scans was replaced.
    """

    def __init__(self, connection: Connection, worlds: Mapping[str, BoundWorld]) -> None:
        self.connection = connection
        self.worlds = worlds
        self._kept = KeptPlans(connection)
        self._valid: set[str] = set()  # the names of the statements

    def has(self, name: str) -> bool:
        """Checks whether a statement is prepared and valid."""
        return name in self._valid

    def prepare(self, name: str, sql: str, query: KeptQuery | None) -> None:
        """Prepares a statement, which has run before."""
        if query is None or not self._kept.prepare(name, sql, query):
            self.connection.prepare(name, sql)
        self._valid.add(name)

    def deallocate(self, name: str) -> None:
        """Drops a statement, if DuckDB keeps it."""
        if name in self._valid:
            self._valid.remove(name)
            self._deallocate(name)

    def forget(self) -> None:
        """Drops all statements: a name, or what is a constant in their plans, means another."""
        names, self._valid = self._valid, set()  # all of them, even if a DEALLOCATE fails
        for name in names:
            self._deallocate(name)

    def _deallocate(self, name: str) -> None:
        self.connection.deallocate(name)
        self._kept.drop(name)


class Statement:
    """A SELECT that DuckDB plans a few times and runs many times.

    Planning is most of the cost of a small query, so after some runs DuckDB keeps the plan
    (`KeptPlans`). It does so only if there are no parameters: these become the columns of a table
    of one row, which is written in place.
    """

    def __init__(
        self,
        plans: PreparedPlans,
        select: exp.Select,
        types: NumberTypes,
    ) -> None:
        self._plans = plans
        self._connection = plans.connection
        self._name = statement_name()
        self._types = types
        self._row: ParameterRow | None = None
        tree = select.copy()
        if types:
            _read_parameters(tree, exp.table_(self._name, quoted=True, alias=_PARAMETERS))
        self._select = tree.sql("duckdb")
        self._execute = execution_of(self._name)
        self._tree = tree
        self._runs = 0
        self._may_be_kept = True

    def rows(self, values: Mapping[str, float]) -> list[tuple[Any, ...]]:
        """Returns all rows for these values of the parameters; the caller pins the worlds."""
        if self._types:
            self._row = self._row or ParameterRow(self._connection, self._name, self._types)
            self._row.set(values)
        if not self._plans.has(self._name):
            if self._runs < RUNS_BEFORE_PLAN:
                self._runs += 1
                return self._connection.rows(self._select)
            self._plans.prepare(self._name, self._select, self._kept_query())
            self._runs = 0
        try:
            return self._connection.rows(self._execute)
        except SqlError as error:
            self._release()
            if error.is_final or not self._may_be_kept:
                raise
            # Such a plan may compute what DuckDB's own never does, as of no row.
            self._may_be_kept = False
            return self._connection.rows(self._select)
        except SelectScriptError:
            self._release()
            raise

    def _kept_query(self) -> KeptQuery | None:
        """Returns the SELECT as a query whose plan may be kept; None if that is not known."""
        if not self._may_be_kept:
            return None
        tree = self._tree.copy()
        is_pruned = not may_read_unnamed(tree, "")
        expressions = {cte.alias for cte in tree.find_all(exp.CTE)}
        sources: list[RowSource] = []
        for table in tree.find_all(exp.Table):
            if not table.db and table.name in expressions:
                continue
            source = self._source(table)
            if source is None:
                return None
            alias = table.alias_or_name
            mark = KeptQuery.mark(len(sources))
            table.set("this", exp.to_identifier(mark, quoted=True))
            table.set("db", None)
            table.set("alias", exp.TableAlias(this=exp.to_identifier(alias, quoted=True)))
            sources.append(source)
        return KeptQuery(tree.sql("duckdb"), sources, has_known_columns=True, is_pruned=is_pruned)

    def _source(self, table: exp.Table) -> RowSource | None:
        """Returns what a name behind FROM stands for; None if that is not known."""
        if self._row is not None and table.name == self._name:
            return self._row.source
        if table.db not in self._plans.worlds or table.name not in TABLES:
            return None
        return live_source(self._plans.worlds[table.db], TABLES[table.name])

    def _release(self) -> None:
        """Frees the memory that DuckDB keeps for a statement that failed."""
        with suppress(SelectScriptError):
            self._plans.deallocate(self._name)

    def forget(self) -> None:
        """Drops the statement."""
        self._plans.deallocate(self._name)
        if self._row is not None:
            self._row.drop()
            self._row = None


class ParameterRow:
    """The numbers of a prepared statement: a table of one row, which is written in place."""

    def __init__(self, connection: Connection, name: str, types: NumberTypes) -> None:
        self._connection = connection
        self._name = name
        self.types = types
        self._row = LiveTable(tuple(Column(key, kind, "") for key, kind in types.items()))
        self._row.fill(1, {})
        connection.register(name, self._row.arrow)

    def set(self, values: Mapping[str, int | float]) -> None:
        """Sets the numbers; they have the types of the first ones."""
        for name, value in values.items():
            self._row[name][0] = value

    def value(self, name: str) -> str:
        """Returns the expression for one of the numbers."""
        column = exp.column(name, quoted=True)
        return f"({exp.select(column).from_(exp.table_(self._name, quoted=True)).sql('duckdb')})"

    @property
    def source(self) -> RowSource:
        """The table, as the rows that its name stands for."""
        return RowSource(lambda: self._row, self._row.columns)

    def drop(self) -> None:
        """Removes the table."""
        self._connection.unregister(self._name)


def statement_name() -> str:
    """Returns a new name for one of ssduck's prepared statements."""
    return f"{NAME_PREFIX}{next(_numbers)}"


def _read_parameters(tree: exp.Select, row: exp.Expr) -> None:
    """Turns parameters into columns of a table of one row, in each SELECT that has some."""
    reading: list[exp.Select] = []
    for parameter in list(tree.find_all(exp.Parameter)):
        select = parameter.find_ancestor(exp.Select)
        assert isinstance(select, exp.Select)
        if not any(select is other for other in reading):
            reading.append(select)
        parameter.replace(exp.column(parameter.name, table=_PARAMETERS, quoted=True))
    for select in reading:
        if select.args.get("from_"):
            # Before the joins whose conditions contain parameters.
            joins = select.args.get("joins") or []
            select.set("joins", [exp.Join(this=row.copy(), kind="CROSS"), *joins])
        else:
            select.from_(row.copy(), copy=False)
