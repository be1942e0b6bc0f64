"""Users' statements: what is known of their texts, and the plans that DuckDB keeps of them.

The first runs of a text are DuckDB's own. After that, a query of the current tick is a prepared
statement, which is forgotten when anything that its plan depends on changes. A query with
relations of shapes is rewritten (`relation_rewriting`) from the first run on, if its columns remain
the same. A statement that cannot be rewritten or prepared runs as it is.
"""

from __future__ import annotations

import math
import re
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import pyarrow as pa
from sqlglot import exp

from ssduck.database.binding import BoundWorld
from ssduck.database.connection import Connection, Parameters, execution_of
from ssduck.database.fetched_rows import (
    MANY_ROWS,
    FetchedRows,
    Header,
    are_plain,
    is_short_and_plain,
)
from ssduck.database.functions import pair_rows
from ssduck.database.plans import (
    MARK,
    RUNS_BEFORE_PLAN,
    KeptQuery,
    NumberTypes,
    ParameterRow,
    PreparedPlans,
    RowSource,
    live_source,
    statement_name,
)
from ssduck.database.relation_rewriting import (
    lookup_of,
    mentions_relations,
    number_parameters,
    parsed,
    relation_calls,
    rewritten,
    start_of,
)
from ssduck.database.statement_names import (
    ReadData,
    WorldNames,
    may_read_unnamed,
    reads_only_live_tables,
    source_tables,
    unread_columns,
)
from ssduck.errors import SelectScriptError, SqlError
from ssduck.recording.stores.history_sql import quoted
from ssduck.sql.pair_lookup import PairLookup
from ssduck.sql.user_sql import Edit, edited, numbered, with_parameters

# The number of texts that are known at a time.
MAX_STATEMENTS = 256
# Functions whose values a kept plan would not follow.
_CHANGES = re.compile(
    r"\b(current_query\w*|current_transaction_id|txid_current|nextval|currval|setval|setseed)\b",
    re.IGNORECASE,
)
_WORD = re.compile(r"\w+")
# What tells of tables, not of their rows.
_DESCRIPTIONS = (exp.Describe, exp.Summarize, exp.Show, exp.Pivot)
# The aggregates whose results do not depend on the order of the rows, as a sum of doubles does; and
# those that do, of which sqlglot does not know that they are aggregates.
_ORDERLESS = (
    exp.ApproxDistinct,
    exp.BitwiseAndAgg,
    exp.BitwiseOrAgg,
    exp.BitwiseXorAgg,
    exp.Count,
    exp.CountIf,
    exp.LogicalAnd,
    exp.LogicalOr,
    exp.Max,
    exp.Median,
    exp.Min,
    exp.PercentileCont,
    exp.PercentileDisc,
    exp.Quantile,
)
_ORDERED = frozenset(
    (
        *("arbitrary", "arg_max_null", "arg_max_nulls_last", "arg_min_null", "arg_min_nulls_last"),
        *("combine_aggr", "entropy", "favg", "fsum", "kahan_sum", "kurtosis_pop", "lttb", "mean"),
        *("json_group_array", "json_group_object", "json_group_structure", "product"),
        *("reservoir_quantile", "sem", "sum_no_overflow", "sumkahan"),
        *("variant_group_array", "variant_group_object"),
    )
)


@dataclass(eq=False)
class UserStatement:
    """A user's statement that is a single query."""

    text: str  # the statement
    name: str  # the name of the prepared statement
    query: str | None = None  # the statement that runs in its place; None if it is not known yet
    # The names of its columns, if another query runs in its place.
    columns: tuple[str, ...] | None = None
    # The parameters that are distances of relations in that query.
    numbers: frozenset[str] = frozenset()
    # The look-up that has its rows without a statement, if there is one.
    lookup: PairLookup | None = None
    # Whether its rows are fetched as Python's values; None if unknown.
    as_tuples: bool | None = None
    may_be_kept: bool | None = None  # whether its plan may be kept; None if that is not known yet
    runs: int = 0  # the number of runs since it was not prepared
    # The names of its columns in Arrow, when it ran without being prepared.
    table_names: list[str] | None = None
    # The numbers that it is prepared with; None if it has no parameters.
    row: ParameterRow | None = None
    # The data of a simulator that its words refer to, and that it does not read.
    unread: frozenset[str] = frozenset()
    last_header: Header | None = None  # the columns of its last run
    # The data that it reads; None if it is not known to be the same at each run.
    reads: ReadData | None = None

    @cached_property
    def execute(self) -> str:
        """The statement that executes it once it is prepared."""
        return execution_of(self.name)


class UserStatements:
    """Runs users' queries, and keeps their plans by text."""

    def __init__(
        self,
        connection: Connection,
        plans: PreparedPlans,
        worlds: Mapping[str, BoundWorld],
        settle: Callable[[bool], None],
    ) -> None:
        self._settle = settle
        self._connection = connection
        self._worlds = worlds
        self._plans = plans
        self._statements: OrderedDict[str, UserStatement | None] = OrderedDict()

    def forget(self) -> None:
        """Forgets all statements, because a name may have another meaning now."""
        for statement in self._statements.values():
            if statement is not None:
                self._drop(statement)
        self._statements.clear()

    def known(self, sql: str) -> UserStatement | None:
        """Returns what is known of a text; None if it is not known, or not a single query."""
        return self._statements.get(sql)

    def ready(self, sql: str) -> UserStatement | None:
        """Returns a query whose rows are looked up, or whose plan is there; None for another."""
        statement = self._statements.get(sql)
        if statement is None or statement.reads is None:
            return None
        if not (statement.lookup or self._plans.has(statement.name)):
            return None
        self._statements.move_to_end(sql)
        return statement

    def statement(self, sql: str) -> UserStatement | None:
        """Returns what is known of a text; None if it is not a single query."""
        if sql in self._statements:
            self._statements.move_to_end(sql)
            return self._statements[sql]
        statement = None
        if self._connection.is_query(sql):
            statement = UserStatement(sql, statement_name())
        self._statements[sql] = statement
        if len(self._statements) > MAX_STATEMENTS:
            _, oldest = self._statements.popitem(last=False)
            if oldest is not None:
                self._drop(oldest)
        return statement

    def _drop(self, statement: UserStatement) -> None:
        self._plans.deallocate(statement.name)
        if statement.row is not None:
            statement.row.drop()
            statement.row = None

    def rows(
        self, statement: UserStatement, parameters: Parameters, names: WorldNames
    ) -> FetchedRows | pa.Table:
        """Returns the rows of a query; the caller pins the worlds, all columns written or not."""
        if statement.query is None:
            statement.query = self._query(statement, parameters, names)
        is_rewritten = statement.query != statement.text or statement.row is not None
        found = self._looked_up(statement, parameters)
        if found is not None:
            return found
        if statement.numbers and not _are_distances(statement.numbers, parameters):
            self._settle(True)
            return self._connection.table(statement.text, parameters)
        if is_rewritten or statement.as_tuples is not None:
            try:
                return self._run(statement, parameters, names)
            except SqlError as error:
                # Such a plan may compute what the user's own text never does, as of no row.
                was_kept = self._plans.has(statement.name)
                self._release(statement)
                if error.is_final or not (is_rewritten or was_kept or error.is_refused):
                    raise
                # DuckDB's message about the user's own text is the one that helps.
                statement.query, statement.may_be_kept = statement.text, False
                statement.columns, statement.numbers = None, frozenset()
            except SelectScriptError:
                self._release(statement)
                raise
        self._settle(True)
        table = self._connection.table(statement.text, parameters)
        statement.as_tuples = is_short_and_plain(table)
        return table

    def _release(self, statement: UserStatement) -> None:
        """Frees the memory that DuckDB keeps for a statement that failed."""
        with suppress(SelectScriptError):
            self._plans.deallocate(statement.name)

    def _query(self, statement: UserStatement, parameters: Parameters, names: WorldNames) -> str:
        """Returns the query that runs in place of a user's: rewritten, if the types agree."""
        text = statement.text
        if not mentions_relations(text):
            return text
        # A rewritten statement has its parameters in another order, and some of them twice.
        sql = numbered(text) if isinstance(parameters, Sequence) and parameters else text
        tree = parsed(sql)
        if tree is None:
            return text
        columns, calls = None, list(relation_calls(sql, tree, names))
        for only_joins in (False, True):
            query = rewritten(sql, calls, only_joins=only_joins)
            if query is None:
                return text
            try:
                columns = columns or self._connection.columns(text, parameters)
                types = [kind for _, kind in columns]
                if types == [kind for _, kind in self._connection.columns(query, parameters)]:
                    statement.as_tuples = are_plain(types)
                    statement.columns = tuple(name for name, _ in columns)
                    statement.numbers = number_parameters(calls)
                    if reads_only_live_tables(tree, names):
                        statement.unread = unread_columns(tree, sql)
                    if statement.as_tuples:
                        statement.lookup = lookup_of(tree, calls)
                        statement.last_header = Header(statement.columns, tuple(types))
                    return query
            except SqlError:
                if columns is None:
                    return text
        return text

    def _run(
        self, statement: UserStatement, parameters: Parameters, names: WorldNames
    ) -> FetchedRows | pa.Table:
        sql = statement.query
        assert sql is not None
        header = None
        if self._is_ready(statement, sql, parameters, names):
            sql, parameters, header = statement.execute, None, statement.last_header
        is_planned = sql == statement.execute
        self._settle(not is_planned)
        if statement.as_tuples:
            rows = self._connection.fetched(sql, parameters, header)
            statement.as_tuples = rows is not None and len(rows) < MANY_ROWS
            if rows is not None:
                if statement.columns is not None:
                    rows = rows.renamed(statement.columns)
                statement.last_header = rows.header
                return rows
        table = self._connection.table(sql, parameters)
        if statement.columns is not None:
            return table.rename_columns(statement.columns)
        if sql != statement.execute:
            statement.table_names = table.column_names
        elif statement.table_names is not None:  # DuckDB numbers equal names of prepared statements
            return table.rename_columns(statement.table_names)
        return table

    def _looked_up(self, statement: UserStatement, parameters: Parameters) -> FetchedRows | None:
        """Returns the rows of a statement that has a look-up; None if it has to run."""
        lookup, header, values = statement.lookup, statement.last_header, _by_name(parameters)
        if lookup is None or header is None:
            return None
        if list(values) != ([lookup.distance] if isinstance(lookup.distance, str) else []):
            return None
        bound = self._worlds[lookup.schema]
        found = pair_rows(lookup, bound, values, self._connection.meter)
        return None if found is None else FetchedRows(header, found)

    def _is_ready(
        self, statement: UserStatement, sql: str, parameters: Parameters, names: WorldNames
    ) -> bool:
        """Prepares a statement for these parameters, if that is possible and worth it."""
        if not parameters:
            return statement.row is None and self._is_prepared(statement, sql, names)
        numbers = _numbers_of(parameters)
        if numbers is None or sql != statement.text or statement.may_be_kept is False:
            return False
        kinds: NumberTypes = {
            name: "integer" if type(value) is int else "double" for name, value in numbers.items()
        }
        if statement.row is None or statement.row.types != kinds:
            self._drop(statement)
            statement.row = ParameterRow(self._connection, statement.name, kinds)
        statement.row.set(numbers)
        if self._plans.has(statement.name):
            return True
        if statement.runs < RUNS_BEFORE_PLAN:
            statement.runs += 1
            return False
        query = with_parameters(numbered(sql), statement.row.value)
        columns = self._connection.columns(sql, parameters)
        types = [kind for _, kind in columns]
        if types != [kind for _, kind in self._connection.columns(query, None)]:
            statement.may_be_kept = False
            return False
        statement.columns = tuple(name for name, _ in columns)
        return self._is_prepared(statement, query, names)

    def _is_prepared(self, statement: UserStatement, sql: str, names: WorldNames) -> bool:
        """Prepares a statement after some runs with the same tables."""
        if self._plans.has(statement.name):
            return True
        if statement.runs < RUNS_BEFORE_PLAN:
            statement.runs += 1
            return False
        if statement.may_be_kept is None:
            tree = None if _CHANGES.search(statement.text) else parsed(statement.text)
            statement.may_be_kept = tree is not None and reads_only_live_tables(tree, names)
            if tree is not None and statement.may_be_kept:
                statement.unread = unread_columns(tree, statement.text)
        if not statement.may_be_kept:
            return False
        query = self._kept_query(statement, sql, names)
        self._plans.prepare(statement.name, sql, query)
        statement.runs, statement.last_header = 0, None
        return True

    def _kept_query(
        self, statement: UserStatement, sql: str, names: WorldNames
    ) -> KeptQuery | None:
        """Returns a query as one whose plan may be kept; None if that is not known."""
        tree = parsed(sql)
        if tree is None or MARK in sql or any(tree.find_all(*_DESCRIPTIONS)):
            return None
        edits: list[Edit] = []
        sources: list[RowSource] = []
        for table in source_tables(tree):
            source, start = self._source(statement, table, names), start_of(table)
            alias = table.args.get("alias")
            if source is None or start is None or (alias is not None and alias.columns):
                return None
            mark = quoted(KeptQuery.mark(len(sources)))
            name = "" if table.alias else f" AS {quoted(table.name)}"
            edits.append(Edit(start, table.this.meta["end"] + 1, mark + name))
            sources.append(source)
        if len(sources) > 1 and (_depends_on_order(tree) or _calls_own(tree, sql, names)):
            return None
        is_pruned = not may_read_unnamed(tree, sql, names.hidden)
        is_pruned = is_pruned and not any(tree.find_all(exp.SetOperation))
        text = edited(sql, edits)
        # A column of a subquery has the name of its text.
        return KeptQuery(text, sources, has_known_columns=False, is_pruned=is_pruned)

    def _source(
        self, statement: UserStatement, table: exp.Table, names: WorldNames
    ) -> RowSource | None:
        """Returns what a name behind FROM stands for; None if that is not known."""
        if statement.row is not None and table.name == statement.name:
            return statement.row.source
        live, schema = names.live_table(table), names.schema(table)
        bound = None if schema is None else self._worlds.get(schema)
        return None if live is None or bound is None else live_source(bound, live)


def _depends_on_order(tree: exp.Expr) -> bool:
    """Checks whether the order in which rows are joined decides on the values of a result."""
    for part in tree.walk():
        match part:
            case exp.Query() if part.args.get("limit") is not None:
                depends = part.args.get("order") is None
            case exp.Distinct():
                depends = part.args.get("on") is not None
            case exp.Window():
                depends = part.args.get("order") is None
            case exp.AggFunc():
                depends = type(part) not in _ORDERLESS  # a subclass may be approximate
            case exp.Anonymous():
                depends = part.name.lower() in _ORDERED
            case _:
                depends = False
        if depends:
            return True
    return False


def _calls_own(tree: exp.Expr, sql: str, names: WorldNames) -> bool:
    """Checks whether a query may call a macro of the user's, which may make lists of rows."""
    letters = sql.lower()
    words = set(_WORD.findall(letters))
    if any(name in words if name.isidentifier() else name in letters for name in names.own):
        return True
    calls = (part for part in tree.find_all(exp.Dot) if isinstance(part.expression, exp.Anonymous))
    return any(part.this.name.lower() not in names.schemas for part in calls)


def _by_name(parameters: Parameters) -> dict[str, Any]:
    """Returns the parameters by name or place."""
    if isinstance(parameters, Mapping):
        return dict(parameters)
    return {str(place): value for place, value in enumerate(parameters or (), 1)}


def _are_distances(names: AbstractSet[str], parameters: Parameters) -> bool:
    """Checks whether parameters are numbers that are finite and not negative."""
    values = _by_name(parameters)
    given: list[Any] = [values.get(name) for name in names]
    are_numbers = all(isinstance(one, int | float) and not isinstance(one, bool) for one in given)
    return are_numbers and all(0 <= one < math.inf for one in given)


def _numbers_of(parameters: Parameters) -> dict[str, int | float] | None:
    """Returns the parameters by name or place; None if they are not all numbers."""
    values = _by_name(parameters)
    is_numeric = all(
        type(value) is float or (type(value) is int and abs(value) < 2**31)
        for value in values.values()
    )
    # DuckDB does not distinguish names by case.
    has_names = len({name.lower() for name in values}) == len(values)
    return values if is_numeric and has_names else None
