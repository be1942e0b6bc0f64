"""The rows of a query in all environments, their selected values, and aggregates over groups.

The sources of a query are combined within each environment alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from sqlglot import exp

from ssduck.columns.arrays import Array, ArrayValues
from ssduck.columns.compiler import Compute, LeftToDuckDBError
from ssduck.columns.selects import ArraySelect
from ssduck.geometry.arrays import Flags, Indices
from ssduck.interpreter.batches.columns import CHANGING
from ssduck.interpreter.batches.expressions import (
    CompiledExpressions,
    Engine,
    Leaves,
    value_of,
)
from ssduck.interpreter.execution import Execution
from ssduck.language import ast
from ssduck.language.aggregates import exact_sum, over_rows
from ssduck.language.clauses import Groups, PythonClauses, Rows, printed
from ssduck.language.evaluator import Frame
from ssduck.schema import STORED_TABLES
from ssduck.sql.pair_joins import sides_of
from ssduck.sql.plan import Plan

# The values over no rows.
_EMPTY = {"count": 0, "sum": 0, "avg": None, "min": None, "max": None}


@dataclass(frozen=True)
class _Aggregate:
    """An aggregate over a column; over None it counts the rows."""

    name: str
    column: int | None


class Selection:
    """SELECT and GROUP BY of the rows of all environments; see `ssduck.language.aggregates`."""

    def __init__(self, plan: Plan) -> None:
        clauses = plan.python_clauses
        same = PythonClauses(clauses.columns)
        if clauses.is_aggregated:
            grouped = clauses.group, clauses.having, None, clauses.is_one_group, True
            same = PythonClauses(clauses.columns, (), (), *grouped)
        holds = clauses.having is None or getattr(clauses.having, "value", None) is True
        if clauses != same or not holds or len(plan.names) < len(clauses.columns):
            raise LeftToDuckDBError
        # The selected values and keys that are the same for all rows of an environment.
        self.constants: list[ast.Node] = []
        self._plan, self._clauses = plan, clauses
        self._items = [self._item(column.node) for column in clauses.columns]
        self._keys = [self._value(node) for node in clauses.group]

    def _item(self, node: ast.Node) -> ast.Node | int | _Aggregate:
        """Returns a selected value: an aggregate, or that of the first row of each group."""
        if not self._clauses.is_aggregated or not over_rows(node):
            return self._value(node)
        match node:
            case ast.Call(name="count", arguments=(ast.Literal(value=int()),)):
                return _Aggregate("count", None)
            case ast.Call(name=name, arguments=(argument,)) if name in _EMPTY:
                column = self._value(argument)
                if isinstance(column, int):
                    return _Aggregate(name, column)
        raise LeftToDuckDBError

    def _value(self, node: ast.Node) -> ast.Node | int:
        """Returns the column of a value, or itself if it is the same for all rows."""
        output = self._plan.known.get(node)
        if output is not None and output.sql_type.type != "entity":
            return output.index
        if output is not None or node not in self._plan.python_constants:
            raise LeftToDuckDBError
        self.constants.append(node)
        return node

    def selected(
        self,
        environments: Indices,
        columns: Sequence[Array],
        constants: Mapping[ast.Node, list[Any]],
        count: int,
    ) -> list[Rows | Groups] | None:
        """Returns the rows, or the groups, of each environment; None if a column may lack values.

        Args:
            environments: (rows,), the environment of each row, ascending.
            columns: the columns of the rows, (rows,) or (rows, length).
            constants: the values of `constants` in each environment.
            count: the number of environments.
        """
        names, numbers = self._plan.names, environments
        groups: _GroupNumbers | None = None
        if self._clauses.is_aggregated:
            over = [item.column for item in self._items if isinstance(item, _Aggregate)]
            keys = [columns[key] for key in self._keys if isinstance(key, int)]
            used = [columns[place] for place in over if place is not None]
            is_number = all(column.dtype.kind in "fib" for column in used)
            if not is_number or any(column.ndim > 1 for column in (*used, *keys)):
                return None
            groups = _GroupNumbers(environments, keys)
            numbers = environments[groups.first]

        def values_of(item: ast.Node | int | _Aggregate) -> list[Any]:
            if isinstance(item, _Aggregate):
                assert groups is not None
                own = environments if item.column is None else columns[item.column]
                return groups.aggregated(item.name, own)
            if isinstance(item, int):
                first = slice(None) if groups is None else groups.first
                return list(columns[item][first].tolist())
            return [constants[item][number] for number in numbers.tolist()]

        rows = list(zip(*map(values_of, self._items), strict=True))
        ends = np.searchsorted(numbers, np.arange(count + 1)).tolist()
        if not self._clauses.group:
            of_each = [Rows(rows[start:end], names) for start, end in pairwise(ends)]
            if groups is None:
                return [*of_each]
            return [
                own if own.values else self._empty(n, constants) for n, own in enumerate(of_each)
            ]
        texts = [
            ", ".join(map(printed, values, self._clauses.group))
            for values in zip(*map(values_of, self._keys), strict=True)
        ]
        alone: list[Rows] = [Rows([row], names) for row in rows]
        return [
            Groups(dict(zip(texts[start:end], alone[start:end], strict=True)), Rows([], names))
            for start, end in pairwise(ends)
        ]

    def _empty(self, number: int, constants: Mapping[ast.Node, list[Any]]) -> Rows:
        """Returns the row of an environment without rows, which has no value of a row."""
        values = [
            _EMPTY[item.name] if isinstance(item, _Aggregate) else constants[item][number]
            for item in self._items
            if not isinstance(item, int)
        ]
        return Rows([tuple(values)], self._plan.names)


class _GroupNumbers:
    """The groups of rows by environment and keys, numbered as they appear; `first` rows of each."""

    def __init__(self, environments: Indices, keys: Sequence[Array]) -> None:
        codes = environments
        for key in keys:
            own = _codes(key)
            codes = _codes(codes * (own.max(initial=0) + 1) + own)
        _, first, of_rows, counts = np.unique(
            codes, return_index=True, return_inverse=True, return_counts=True
        )
        order = np.argsort(first)
        self.first, self._counts = first[order], counts[order]
        # The rows by group, and the first of each among these.
        self._rows = np.argsort(np.argsort(order)[of_rows], kind="stable")
        self._starts = np.cumsum(self._counts) - self._counts

    def aggregated(self, name: str, column: Array) -> list[Any]:
        """Returns an aggregate over a column in each group."""
        if name == "count" or not len(column):
            return list(self._counts.tolist())
        if name in ("min", "max"):
            extreme = np.minimum if name == "min" else np.maximum
            return list(extreme.reduceat(column[self._rows], self._starts).tolist())
        ordered = column[self._rows]
        if column.dtype.kind != "f":
            sums = np.add.reduceat(ordered.astype(np.int64), self._starts)
        else:
            values, ends = ordered.tolist(), (self._starts + self._counts).tolist()
            parts = zip(self._starts.tolist(), ends, strict=True)
            sums = np.array([exact_sum(values[start:end]) for start, end in parts])
        return list((sums / self._counts if name == "avg" else sums).tolist())


def _codes(key: Array) -> Indices:
    """Returns the number of each value among the different ones."""
    if key.dtype.kind in "fib":
        return np.unique(key, return_inverse=True)[1].astype(np.intp)
    known: dict[Any, int] = {}
    return np.array([known.setdefault(value, len(known)) for value in key.tolist()], np.intp)


# So many rows are computed at a time.
MAX_ROWS = 1 << 19
_KINDS = {column.name: column.type for column in STORED_TABLES["entities"].columns}


@dataclass(frozen=True, eq=False)
class FoundRows:
    """The rows that SQL would give in each environment."""

    environments: Indices  # (rows,), the environment of each, ascending
    columns: list[Array]  # the columns of the SELECT, (rows,) or (rows, length) each
    left: Flags  # (n,), the environments that have to be evaluated by themselves; they have no rows


class BatchRows:
    """The rows of a query of a batch's entities, or of combinations of them, as arrays.

    Attributes:
        planned: the query with its plan, whose clauses Python applies to the rows.
        leaves: what the expressions read.
    """

    def __init__(
        self, execution: Execution, engine: Engine, query: ast.Query, frame: Frame
    ) -> None:
        planned = execution.planner.planned(_without_searches(query), frame, "rows")
        if planned is None:
            raise LeftToDuckDBError
        self.planned, plan = planned, planned.plan
        self._engine, self.leaves = engine, Leaves(engine)
        joins = plan.select.args.get("joins") or ()
        tables = [plan.select.args["from_"].this, *(join.this for join in joins)]
        self._size, self._sources = len(engine.world.snapshot.entities), len(tables)
        # The environments and the entities of the rows that are computed, (1 + sources, rows).
        self._rows: npt.NDArray[np.intp] = np.zeros((1 + len(tables), 0), np.intp)
        for place, table in enumerate(tables, 1):
            self._note_columns(table.alias_or_name, place)
        self.leaves.note_given(query, frame)

        def renamed(part: exp.Expr) -> exp.Expr:
            return self.leaves.renamed(part, plan.bindings, frame)

        operations, leaf = engine.operations, self.leaves.expression
        self._select = ArraySelect(plan, engine.schema, operations, leaf, renamed, is_split=True)
        # What applies the clauses to all environments; None to apply them in each.
        self._selection: Selection | None = None
        with suppress(LeftToDuckDBError):
            self._selection = Selection(plan)
        self._constants = [] if self._selection is None else self._selection.constants
        self._constant_values = CompiledExpressions(
            engine, execution, self._constants, frame.placeholders
        )

    def _note_columns(self, table: str, place: int) -> None:
        """Notes the columns of a table in SQL, whose entities have a place in the rows."""
        entities = self._engine.world.snapshot.tables["entities"]
        for name, kind in _KINDS.items():
            key = f"column {table}.{name}"
            if name in CHANGING:
                self.leaves.note(key, "double", self._changing(name, place))
            elif kind in ("double", "integer", "string", "boolean") and name != "run":
                listed = entities.values(name)
                own = np.array(listed, object if kind == "string" else None)
                if not any(value is None for value in listed):
                    self.leaves.note(key, kind, self._constant(own, place))

    def _changing(self, name: str, place: int) -> Callable[[Mapping[str, Array]], Array]:
        columns, entities = self._engine.columns, self._engine.world.snapshot.entities

        def read(_: Mapping[str, Array]) -> Array:
            table: Array = np.stack([columns.column(one.id, name) for one in entities], axis=1)
            values: Array = table.ravel()[self._rows[0] * self._size + self._rows[place]]
            return values

        return read

    def _constant(self, own: Array, place: int) -> Callable[[Mapping[str, Array]], Array]:
        return lambda _: own[self._rows[place]]

    def is_current(self, frame: Frame) -> bool:
        """Takes the present values of variables; returns whether they have the same types."""
        return self.leaves.is_current(frame) and self._constant_values.is_current(frame)

    # -- evaluation -------------------------------------------------------------------------

    def found(
        self,
        given: Mapping[str, Array],
        unknown: Mapping[str, Flags],
        step: Callable[[], object],
    ) -> FoundRows:
        """Returns the rows of all environments.

        Args:
            given: the values of placeholders, (n,) or (n, length).
            unknown: where they are unknown.
            step: is called before each part of the environments.
        """
        nowhere = np.zeros(self._engine.world.count, np.bool_)
        left = np.any([nowhere, *unknown.values()], axis=0)
        asked, parts = np.flatnonzero(~left), []
        at_once = max(1, MAX_ROWS // self._size**self._sources)
        for start in range(0, len(asked), at_once):
            step()
            numbers = asked[start : start + at_once]
            part = self._part(numbers, given, left)
            if part is None:
                left[numbers] = True
            elif len(part[0]):
                parts.append(part)
        columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
        environments, *others = columns or [np.zeros(0, np.intp)] * (1 + self._select.width)
        known = ~left[environments]
        return FoundRows(environments[known], [column[known] for column in others], left)

    def selected(
        self, found: FoundRows, given: Mapping[str, Array], unknown: Mapping[str, Flags]
    ) -> list[Rows | Groups] | None:
        """Returns the selected rows, or their groups, of each environment.

        None if the clauses of the query are applied environment by environment.
        """
        count = self._engine.world.count
        values, unknowns = self._constant_values.values(given, unknown, count)
        constants = {
            node: own.tolist()
            for node, own in zip(self._constants, values, strict=True)
            if own is not None
        }
        if self._selection is None or len(constants) < len({*self._constants}):
            return None
        np.any([found.left, *unknowns], axis=0, out=found.left)
        return self._selection.selected(found.environments, found.columns, constants, count)

    def _part(
        self, numbers: Indices, given: Mapping[str, Array], left: Flags
    ) -> list[Array] | None:
        """Returns the environments and the columns of the rows in some; None if arrays cannot."""
        shape = (len(numbers), *[self._size] * self._sources)
        rows = np.array(np.unravel_index(np.arange(np.prod(shape)), shape))
        rows[0] = numbers[rows[0]]
        for condition in self._select.conditions:
            found = self._evaluated(rows, [condition], given, left)
            if found is None:
                return None
            rows = rows[:, found[0] & ~left[rows[0]]]
        values = self._evaluated(rows, self._select.columns, given, left)
        return None if values is None else self._select.arranged([rows[0], *values])

    def _evaluated(
        self,
        rows: npt.NDArray[np.intp],
        computes: Sequence[Compute],
        given: Mapping[str, Array],
        left: Flags,
    ) -> list[Array] | None:
        """Returns the values of expressions in some rows; None if arrays cannot have them."""
        self._rows, (environments, *_) = rows, rows
        if not len(environments):
            return [np.zeros(0, np.bool_) for _ in computes]
        of_rows = {name: values[environments] for name, values in given.items()}

        def evaluate(values: ArrayValues) -> list[Array | None]:
            return [value_of(compute, values) for compute in computes]

        with self._engine.shapes.with_rows(environments):
            found, unknown = self.leaves.evaluated(evaluate, of_rows, {}, len(environments))
        left[environments[unknown]] = True
        known = [values for values in found if values is not None]
        return known if len(known) == len(found) else None


def _without_searches(query: ast.Query) -> ast.Query:
    """Returns a query with conditions on pairs in place of searches, which are of one tick."""

    def asked(node: ast.Node) -> ast.Node | None:
        if not isinstance(node, ast.Call) or sides_of(node) is None:
            return None
        return ast.Binary(node.span, "OR", node, ast.Literal(node.span, value=False))

    return query if query.where is None else replace(query, where=query.where.replaced(asked))
