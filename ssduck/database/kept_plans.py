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
from dataclasses import dataclass
from itertools import count
from math import prod
from typing import Any

import pyarrow as pa

from ssduck.database.binding import BoundWorld
from ssduck.database.connection import Connection, execution_of
from ssduck.database.schemas import part_rows
from ssduck.errors import SqlError
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
    """The rows that a name behind FROM stands for.

    Attributes:
        table: returns the table that has them at present.
        columns: its columns.
        view: what its view makes of the rows; None if that has all of them as they are.
    """

    table: Callable[[], LiveTable]
    columns: Sequence[Column]
    view: PartView | None = None


@dataclass(frozen=True)
class PartView:
    """The view of links or of sites.

    Attributes:
        table: the table of links or of sites.
        entities: the entities to which these belong.
    """

    table: Table
    entities: RowSource


@dataclass(frozen=True)
class KeptQuery:
    """A query of small tables, whose plan may be kept.

    Attributes:
        text: the query, with a `mark`, quoted, in place of each name behind FROM.
        sources: what the marks stand for.
        has_known_columns: whether the names of its columns are written out.
        is_pruned: whether it depends on no columns but those that its plan reads, or its text
            names.
    """

    text: str
    sources: Sequence[RowSource]
    has_known_columns: bool
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


def parameter_source(row: LiveTable) -> RowSource:
    """Returns the rows of a table of parameters, which is one."""
    return RowSource(lambda: row, row.columns)


class KeptPlans:
    """Prepares queries so that DuckDB keeps their plans.

    Args:
        connection: the connection on which they are prepared.
    """

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

    def readable(self, name: str, sql: str, columns: frozenset[str]) -> frozenset[str]:
        """Returns those of some columns that a prepared statement may read of any table."""
        scans = [one["extra_info"] for one in self._operators(execution_of(name)) if _is_scan(one)]
        if any(info["Function"] != _SCAN for info in scans):
            return columns
        words = {*map(str.lower, _WORD.findall(sql)), *_WORD.findall(json.dumps(scans))}
        return columns & words

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
        """Yields the operators of a statement's plan."""
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
        arrow = table.arrow_with(self._columns)
        if table.version != self._version or self._rows is None:
            columns = [_array_of(arrow.column(name)) for name in self._columns]
            rows = pa.StructArray.from_arrays(columns, self._columns)
            self._rows = pa.ListArray.from_arrays(pa.array([0, len(rows)], pa.int32()), rows)
            self._version = table.version
        return self._rows if len(calls) == 1 else pa.concat_arrays([self._rows] * len(calls))


def _is_scan(operator: Mapping[str, Any]) -> bool:
    """Checks whether an operator of a plan scans a table."""
    return "Function" in operator["extra_info"]


def _is_kept(operator: Mapping[str, Any]) -> bool:
    """Checks whether an operator of a plan neither prevents that it is kept nor multiplies rows."""
    inner = operator["children"]
    while inner and inner[0]["name"] == "PROJECTION":
        inner = inner[0]["children"]
    is_single = operator["name"] != "UNNEST" or inner[0]["name"] == "DUMMY_SCAN"
    return is_single and not _is_scan(operator)


def _array_of(column: pa.ChunkedArray) -> pa.Array:
    """Returns a column as one array, without a copy if it is one."""
    return column.chunk(0) if column.num_chunks == 1 else column.combine_chunks()


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
