"""Translates groups and their aggregates, and DISTINCT, over a SELECT of the rows.

Each group is one row of the result. Its aggregates are those of `ssduck.language.aggregates`: sums
of doubles are exact, and rounded once. Everything else is that of the first row of the group, and
the groups are in the order of their first rows, which have numbers for that.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import sqlglot
from sqlglot import exp

from ssduck.language import ast
from ssduck.language.aggregates import over_rows
from ssduck.language.analysis import free_aliases
from ssduck.language.clauses import SelectedValue
from ssduck.sql import subqueries
from ssduck.sql.expressions import Expressions
from ssduck.sql.from_clause import FromItem, ascending, column_of
from ssduck.sql.operators import truth
from ssduck.sql.relations.registry import RELATIONS
from ssduck.sql.sql_values import FloatDomain, NotSqlError, SqlValue, failure, or_failure
from ssduck.sql.types import DOUBLE, EXACT, IDS, INTEGER, SqlType

# The column of the number of a row, in the order of the rows.
_NUMBER = "n"
# What may contain an aggregate.
_OF_PARTS = (ast.Call, ast.Unary, ast.Binary, ast.OperatorChain, ast.If, ast.ListLiteral, ast.Index)
# The bits of the integers that number rows.
_BITS = {"BIGINT": 63, "HUGEINT": 127}
_SCALARS = ("double", "integer", "boolean", "string")
# The sum of doubles x, rounded once: in units of 2^-80, that of their whole parts is exact in any
# order; what the nearest double of it lacks, and the sum of the other parts, is added at the end.
_UNITS = 2.0**80
_WHOLE = f"trunc(x * {_UNITS!r})"
_TOTAL = f"sum(CAST({_WHOLE} AS HUGEINT))"
_NEAREST = f"CAST({_TOTAL} AS DOUBLE)"
_EXACT_SUM = sqlglot.parse_one(
    f"({_NEAREST} + (CAST({_TOTAL} - CAST({_NEAREST} AS HUGEINT) AS DOUBLE) + "
    f"kahan_sum(x * {_UNITS!r} - {_WHOLE}))) * {1 / _UNITS!r}",
    dialect="duckdb",
)


@dataclass(frozen=True)
class GroupedRows:
    """A query with groups in SQL: the types of its columns, and how to select from its rows."""

    items: tuple[SqlValue, ...]  # the selected values of each group
    keys: tuple[SqlValue, ...]  # the keys of GROUP BY, as they are printed
    columns: tuple[exp.Expr, ...]  # the columns of the rows
    select: exp.Select  # the groups, FROM nothing yet
    alias: str  # the alias of the rows


class Groups(Expressions):
    """The expressions of a query with groups, over columns of its rows.

    Attributes:
        part: the part of the query that was translated last.
    """

    def __init__(self, rows: Expressions, *, is_plain: bool) -> None:
        super().__init__(rows.context)
        self.part: ast.Node | None = None
        self._of_rows, self._is_plain = rows, is_plain
        self._number: exp.Expr = exp.null()
        self._alias = rows.context.alias("grouped")
        # The names of columns of the rows by their SQL, the columns, and those that are keys.
        self._names: dict[str, str] = {}
        self._columns: dict[str, exp.Expr] = {}
        self._keys: dict[str, exp.Expr] = {}

    def grouped(
        self,
        query: ast.Query,
        columns: Sequence[SelectedValue],
        elements: Sequence[FromItem],
        *,
        are_numbers: bool,
    ) -> GroupedRows:
        """Returns the groups of a query, each with one row, or the distinct rows.

        Raises:
            NotSqlError: they are left to Python, for the sake of `part`.
        """
        by_row = [key for key in query.order if not over_rows(key.value)]
        self.part = by_row[0].value if by_row else None
        order = subqueries.ordered(self._of_rows, by_row)
        self._number = _row_number(order, elements, are_numbers=are_numbers)
        keys: list[SqlValue] = []
        if query.group:
            keys = [self._key(node) for node in query.group]
        elif query.distinct:
            for column in columns:
                self._distinct_key(column.node)
        if (query.group or query.distinct) and not self._keys:
            raise NotSqlError  # without a key, there would be a group of no rows
        items = tuple(self._item(column.node) for column in columns)
        select = exp.Select().group_by(*self._keys.values()) if self._keys else exp.Select()
        for condition in self._conditions(query.having, keys):
            select.having(condition, copy=False)
        self._order(select, query)
        select.select(*(item.sql.copy() for item in (*items, *keys)), copy=False)
        inner = (exp.alias_(sql.copy(), name) for name, sql in self._columns.items())
        return GroupedRows(items, tuple(keys), tuple(inner), select, self._alias)

    # -- clauses ----------------------------------------------------------------------------

    def _key(self, node: ast.Node) -> SqlValue:
        """Adds a key of GROUP BY; returns it as it is printed."""
        self.part = node
        value = self._of_rows.value(node)
        if value.sql_type.type == "entity" and value.column is not None:
            value = SqlValue(value.column("name"), SqlType("string"))
        if value.sql_type.type not in _SCALARS:
            raise NotSqlError
        if self._of_rows.is_constant(node):
            return _constant(value)
        column = self._column(value.sql)
        self._keys[column.name] = column
        return replace(value, expression=column)

    def _distinct_key(self, node: ast.Node) -> None:
        self.part = node
        value = self.context.nan_checked(self._of_rows.value(node))
        if not value.sql_type.comes_back:
            raise NotSqlError
        if not self._of_rows.is_constant(node):
            column = self._column(value.identity)
            self._keys[column.name] = column

    def _item(self, node: ast.Node) -> SqlValue:
        self.part = node
        if over_rows(node) == [node]:
            assert isinstance(node, ast.Call)
            value = self._aggregate(node)
        else:
            value = self._first(node) if not over_rows(node) else self.value(node)
        if not value.sql_type.comes_back:
            raise NotSqlError
        return value

    def _conditions(self, having: ast.Node | None, keys: Sequence[SqlValue]) -> Iterable[exp.Expr]:
        """Yields what holds of each group: that its printed key is of no other, and HAVING."""
        texts = (
            key.sql for key in keys if key.sql_type.type == "string" and key.sql.name in self._keys
        )
        for place, text in enumerate(texts):
            others: list[exp.Expr] = []
            if not self._is_there(self._columns[text.name]):
                others.append(exp.EQ(this=text.copy(), expression=exp.Literal.string("None")))
            if place:
                others.append(exp.func("contains", text.copy(), exp.Literal.string(", ")))
            if others:
                self.context.note_possible_failure()
                checked = exp.case().when(exp.or_(*others), failure(INTEGER))
                yield exp.Is(this=checked, expression=exp.null())
        self.part = having
        if having is not None and not (isinstance(having, ast.Literal) and having.value is True):
            yield truth(self.value(having))

    def _order(self, select: exp.Select, query: ast.Query) -> None:
        """Orders the groups: by keys with aggregates, then by their first rows."""
        order: list[exp.Ordered] = []
        if any(over_rows(key.value) for key in query.order):
            self.part = query.order[0].value
            if not query.group:
                raise NotSqlError  # it is an error
            order.extend(subqueries.ordered(self, query.order))
        if self._keys:
            order.append(ascending(exp.Min(this=self._row_number())))
            select.order_by(*order, copy=False)

    # -- values -----------------------------------------------------------------------------

    def is_constant(self, node: ast.Node) -> bool:
        """Checks whether the node has the same value for all rows, and is no aggregate of them."""
        return not over_rows(node) and self._of_rows.is_constant(node)

    def value(self, node: ast.Node) -> SqlValue:
        """Returns the value of a part for a group; SQL fails where Python has nothing."""
        aggregates = over_rows(node)
        if aggregates == [node]:
            assert isinstance(node, ast.Call)
            value = self._aggregate(node)
            if node.name in ("count", "sum"):
                return value
            self.context.note_possible_failure()
            return replace(value, expression=or_failure(value.sql, value.sql_type))
        if not aggregates:
            value = self._first(node)
            if value.sql_type.type not in _SCALARS:
                raise NotSqlError
            return value
        match node:
            case ast.Call(name="count", arguments=(ast.Call(name="uniq") as values,)) if (
                values in aggregates
            ):
                return self._distinct_count(values)
        if not isinstance(node, _OF_PARTS) or (
            isinstance(node, ast.Call) and node.name in RELATIONS
        ):
            raise NotSqlError
        return super().value(node)

    def _first(self, node: ast.Node) -> SqlValue:
        """Returns the value of the first row of each group."""
        value = self._of_rows.value(node)
        if self._of_rows.is_constant(node):
            return _constant(value)
        column = self._column(value.sql)
        sql: exp.Expr = column
        if column.name not in self._keys:
            ordered = exp.Order(this=column, expressions=[ascending(self._row_number())])
            sql = exp.Anonymous(this="first", expressions=[ordered])
        return replace(value, expression=sql, column=None, elements=None, fields={})

    def _aggregate(self, call: ast.Call) -> SqlValue:
        """Returns an aggregate over the rows of each group; NULL where Python has nothing."""
        (node,) = call.arguments
        value = self._of_rows.value(node)
        kind = value.sql_type.type
        if kind == "list" and not free_aliases(node):
            raise NotSqlError  # it is over that list
        if call.name == "count" and isinstance(value.sql, exp.Literal):
            return SqlValue(exp.Count(this=exp.Star()), INTEGER)
        column = self._column(value.sql)
        if call.name == "count" and (kind in _SCALARS or value.sql_type.comes_back):
            return SqlValue(exp.Count(this=column), INTEGER)
        value = replace(self.context.nan_checked(replace(value, expression=column)), elements=None)
        total: exp.Expr
        match call.name, kind:
            case "min" | "max", "double" | "integer" | "boolean" | "string":
                aggregate = exp.Min if call.name == "min" else exp.Max
                return replace(value, expression=aggregate(this=value.sql))
            case "sum", "integer" | "boolean":
                self.context.note_possible_failure()
                total = exp.cast(exp.Sum(this=_whole(value)), "BIGINT")
                total = exp.Coalesce(this=total, expressions=[exp.Literal.number(0)])
                return SqlValue(total, INTEGER, may_exceed_double=True)
            case "sum", "double":
                self.context.note_possible_failure()  # the sum of nothing is an integer
                total = or_failure(self._sum(value.sql), DOUBLE)
                return SqlValue(total, DOUBLE, domain=value.domain)
            case "avg", "integer" | "boolean":
                self.context.note_possible_failure()
                whole = exp.Sum(this=_whole(value))
                large = exp.GTE(this=exp.Abs(this=whole.copy()), expression=exp.convert(EXACT))
                mean = exp.Div(this=exp.cast(whole, "DOUBLE"), expression=exp.Count(this=column))
                return SqlValue(exp.case().when(large, failure(DOUBLE)).else_(mean), DOUBLE)
            case "avg", "double":
                mean = exp.Div(this=self._sum(value.sql), expression=exp.Count(this=column))
                return SqlValue(mean, DOUBLE, domain=value.domain)
            case "median", "double":
                # The mean of the two in the middle, which may be one.
                low, high = _middle(value.sql), _middle(exp.Neg(this=value.sql.copy()))
                half = exp.Div(
                    this=exp.paren(exp.Sub(this=low, expression=high)),
                    expression=exp.convert(2),
                )
                domain = FloatDomain.NAN if value.domain else FloatDomain.FINITE
                return SqlValue(half, DOUBLE, domain=domain)
        raise NotSqlError

    def _distinct_count(self, values: ast.Call) -> SqlValue:
        (node,) = values.arguments
        value = self.context.nan_checked(self._of_rows.value(node))
        if value.sql_type.type not in (*_SCALARS, "entity"):
            raise NotSqlError
        column = self._column(value.identity)
        return SqlValue(exp.Count(this=exp.Distinct(expressions=[column])), INTEGER)

    def _sum(self, column: exp.Expr) -> exp.Expr:
        """Returns the sum of doubles, rounded once."""
        if self._is_plain:
            return exp.Sum(this=column)
        self.context.note_possible_failure()  # they may be too large, or infinite
        return exp.paren(
            _EXACT_SUM.transform(
                lambda part: column.copy() if isinstance(part, exp.Column) else part
            )
        )

    # -- the rows ---------------------------------------------------------------------------

    def _column(self, sql: exp.Expr) -> exp.Expr:
        """Returns the column of the rows with a value."""
        name = self._names.setdefault(sql.sql("duckdb"), f"c{len(self._names)}")
        self._columns.setdefault(name, sql)
        return column_of(self._alias, name)

    def _row_number(self) -> exp.Expr:
        self._columns.setdefault(_NUMBER, self._number)
        return column_of(self._alias, _NUMBER)

    def _is_there(self, sql: exp.Expr) -> bool:
        """Checks whether a text is a column that each row of a source has."""
        sources = (value.column for value in self._of_rows.rows.values())
        return any(of and sql in (of("name"), of("kind")) for of in sources)


def _constant(value: SqlValue) -> SqlValue:
    """Returns a value that is the same for all rows, which is no column of a group."""
    if value.sql.find(exp.Parameter) is None:
        return value
    return replace(value, expression=exp.select(value.sql).subquery(), elements=None)


def _whole(value: SqlValue) -> exp.Expr:
    """Returns an integer, or True as 1 and False as 0."""
    return value.sql if value.sql_type.type == "integer" else exp.cast(value.sql, "BIGINT")


def _middle(sql: exp.Expr) -> exp.Expr:
    """Returns the value in the middle; of an even number of them, the lower one of two."""
    half = exp.Literal.number("0.5e0")
    return exp.Anonymous(this="quantile_disc", expressions=[sql, half])


def _row_number(
    order: Sequence[exp.Ordered], elements: Sequence[FromItem], *, are_numbers: bool
) -> exp.Expr:
    """Returns the number of a row in the order of the query's keys, then of the sources."""
    keys = [key.this for element in elements for key in element.position]
    widths = [1 if isinstance(key, exp.NEQ) else IDS.bit_length() - 1 for key in keys]
    if order or not are_numbers or sum(widths) > _BITS["HUGEINT"]:
        ordered = [*order, *(ascending(key) for key in keys)]
        if any(part.name == "error" for key in order for part in key.find_all(exp.Anonymous)):
            raise NotSqlError  # DuckDB orders no window by what may fail
        copies = exp.Order(expressions=[key.copy() for key in ordered])
        return exp.Window(this=exp.RowNumber(), order=copies)
    kind: str = next(kind for kind, bits in _BITS.items() if sum(widths) <= bits)
    first, *others = (exp.cast(key.copy(), kind) for key in keys)
    number: exp.Expr = first
    for key, width in zip(others, widths[1:], strict=True):
        shifted = exp.Mul(this=number, expression=exp.Literal.number(2**width))
        number = exp.paren(exp.Add(this=shifted, expression=key))
    return number
