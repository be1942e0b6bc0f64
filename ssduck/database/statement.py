"""Prepared statements, and which of them are valid."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from collections.abc import Set as AbstractSet
from contextlib import suppress
from itertools import count
from typing import Any, Literal

from sqlglot import exp

from ssduck.database.binding import BoundWorld
from ssduck.database.connection import Connection, execution_of
from ssduck.database.kept_plans import (
    KeptPlans,
    KeptQuery,
    RowSource,
    live_source,
    parameter_source,
)
from ssduck.database.statement_names import may_read_unnamed
from ssduck.errors import SelectScriptError, SqlError
from ssduck.schema import RECORDED, TABLES, Column
from ssduck.world.live_tables import LiveTable

# The names of ssduck's prepared statements: this prefix, a number and the tables that they read,
# for users who trace the statements.
NAME_PREFIX = "ssduck statement "
# The tables of a world whose buffers may be replaced.
_TABLES = frozenset((*TABLES, *(table.history_view for table in RECORDED.values())))
# The number of runs before a statement is prepared: to make a plan that is kept takes as long as
# four runs without one.
RUNS_BEFORE_PLAN = 3
# What a plan depends on that reads no buffer.
_LAYOUT = frozenset(("entities",))
# What a tick may write when it is read (`LiveTable.defer`): positions, velocities and boxes.
_DEFERRED = frozenset(TABLES["entities"].tick_columns.doubles) - {"time"}
# No source can have this name, because it has a space.
_PARAMETERS = "the parameters"


class PreparedPlans:
    """The plans of prepared statements in DuckDB.

    Args:
        connection: the connection on which they are prepared.
        user_tables: the tables in users' statements whose plans DuckDB keeps.
        worlds: the worlds of the database by name, up to date.
    """

    def __init__(
        self,
        connection: Connection,
        user_tables: AbstractSet[str],
        worlds: Mapping[str, BoundWorld],
    ) -> None:
        self.connection = connection
        self.worlds = worlds
        self._user_tables = user_tables
        self._kept = KeptPlans(connection)
        # The tables that ssduck's own valid statements read, by the statement's name.
        self._own: dict[str, frozenset[str]] = {}
        # The columns that a tick may write later which each of them may read without asking.
        self._deferred: dict[str, frozenset[str]] = {}

    def has(self, name: str) -> bool:
        """Checks whether one of ssduck's own statements is prepared and valid."""
        return name in self._own

    def prepare(self, name: str, sql: str, tables: frozenset[str], query: KeptQuery | None) -> None:
        """Prepares one of ssduck's own statements, which has run before.

        Args:
            name: its name.
            sql: the statement.
            tables: the tables that it reads.
            query: the statement as one whose plan may be kept; None if it is none.
        """
        if query is not None and self._kept.prepare(name, sql, query):
            tables = _LAYOUT  # it reads what the tables are at each run
            self._deferred[name] = frozenset()  # it asks
        else:
            self.connection.prepare(name, sql)
            self._deferred[name] = self._kept.readable(name, sql, _DEFERRED)
        self._own[name] = tables

    def deferred_columns(self, name: str) -> frozenset[str]:
        """Returns the columns of entities that have to be written before a statement runs."""
        return self._deferred[name]

    def deallocate(self, name: str) -> None:
        """Drops one of ssduck's own prepared statements, if DuckDB keeps it."""
        if self._own.pop(name, None) is not None:
            self._deallocate(name)

    def forget(self, *tables: str) -> None:
        """Drops prepared statements that would go on reading old buffers of one of these tables.

        What a single statement of a user reads is not known: all of them are dropped if any
        statement that DuckDB keeps reads such a table.
        """
        stale = frozenset(tables)
        invalid = [name for name, reads in self._own.items() if stale & reads]
        for name in invalid:  # all of them, even if a DEALLOCATE fails
            del self._own[name]
        for name in invalid:
            self._deallocate(name)
        if stale & self._user_tables:
            names = self.connection.internal_rows("SELECT name FROM duckdb_prepared_statements()")
            for (name,) in names:
                if name not in self._own:
                    self._deallocate(name)

    def _deallocate(self, name: str) -> None:
        self._deferred.pop(name, None)
        self.connection.deallocate(name)
        self._kept.drop(name)


class Statement:
    """A SELECT that DuckDB plans a few times and runs many times.

    Planning is most of the cost of a small query, so after some runs DuckDB keeps the plan
    (`KeptPlans`). It does so only if there are no parameters: these become the columns of a table
    of one row, which is written in place.

    Args:
        plans: the plans of the database.
        select: the SELECT, its parameters as `exp.Parameter`.
        types: the types of the parameters, by name; all of them are numbers.
    """

    def __init__(
        self,
        plans: PreparedPlans,
        select: exp.Select,
        types: Mapping[str, Literal["double", "integer"]],
    ) -> None:
        self._plans = plans
        self._connection = plans.connection
        # The entities' buffers are replaced whenever any other part of the worlds changes.
        self._reads = frozenset(("entities", *(t.name for t in select.find_all(exp.Table))))
        self._name = statement_name(self._reads)
        self._row = LiveTable(tuple(Column(name, type, "") for name, type in types.items()))
        self._row.fill(1, {})
        tree = select.copy()
        self._has_parameters = bool(types)
        if types:
            _read_parameters(tree, exp.table_(self._name, quoted=True, alias=_PARAMETERS))
        self._select = tree.sql("duckdb")
        self._execute = execution_of(self._name)
        self._is_registered = False
        self._tree = tree
        self._runs = 0
        self._may_be_kept = True

    def rows(self, values: Mapping[str, float]) -> list[tuple[Any, ...]]:
        """Returns all rows for these values of the parameters; the caller pins the worlds."""
        for name, value in values.items():
            self._row[name][0] = value
        if self._has_parameters and not self._is_registered:
            self._connection.register(self._name, self._row.arrow)
            self._is_registered = True
        if not self._plans.has(self._name):
            if self._runs < RUNS_BEFORE_PLAN:
                self._runs += 1
                return self._connection.rows(self._select)
            self._plans.prepare(self._name, self._select, self._reads, self._kept_query())
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
        if table.name == self._name:
            return parameter_source(self._row)
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
        if self._is_registered:
            self._connection.unregister(self._name)
            self._is_registered = False


class ParameterRow:
    """The numbers of a user's prepared statement: a table of one row, which is written in place.

    Args:
        connection: the connection that reads it.
        name: its name.
        values: the numbers by name.
    """

    def __init__(
        self, connection: Connection, name: str, values: Mapping[str, int | float]
    ) -> None:
        self._connection = connection
        self._name = name
        self._types = {key: type(value) for key, value in values.items()}
        kinds: dict[type, Literal["double", "integer"]] = {int: "integer", float: "double"}
        columns = (Column(key, kinds[kind], "") for key, kind in self._types.items())
        self._row = LiveTable(tuple(columns))
        self._row.fill(1, {})
        connection.register(name, self._row.arrow)

    def has_types_of(self, values: Mapping[str, int | float]) -> bool:
        """Checks whether other numbers have the same names and types."""
        return {key: type(value) for key, value in values.items()} == self._types

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
        return parameter_source(self._row)

    def drop(self) -> None:
        """Removes the table."""
        self._connection.unregister(self._name)


_numbers = count(1)


def statement_name(reads: Iterable[str]) -> str:
    """Returns a new name for one of ssduck's prepared statements, with the tables it reads."""
    return f"{NAME_PREFIX}{next(_numbers)} {' '.join(sorted(_TABLES & set(reads)))}"


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
