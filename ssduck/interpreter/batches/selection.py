"""The selected values of the rows of all environments, and aggregates over groups of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from ssduck.columns.arrays import Array
from ssduck.columns.expressions import LeftToDuckDBError
from ssduck.geometry.arrays import Indices
from ssduck.language.aggregates import exact_sum, over_rows
from ssduck.language.clauses import Groups, PythonClauses, Rows, printed
from ssduck.language.tree import Call, Literal, Node
from ssduck.sql.plan import Plan

# The values over no rows.
_EMPTY = {"count": 0, "sum": 0, "avg": None, "min": None, "max": None}


@dataclass(frozen=True)
class _Aggregate:
    """An aggregate over a column; over None it counts the rows."""

    name: str
    column: int | None


class Selection:
    """SELECT and GROUP BY of the rows of all environments; see `ssduck.language.aggregates`.

    Attributes:
        constants: the selected values and keys that are the same for all rows of an environment.
    """

    def __init__(self, plan: Plan) -> None:
        clauses = plan.python_clauses
        same = PythonClauses(clauses.columns)
        if clauses.is_aggregated:
            grouped = clauses.group, clauses.having, None, clauses.is_one_group, True
            same = PythonClauses(clauses.columns, (), (), *grouped)
        holds = clauses.having is None or getattr(clauses.having, "value", None) is True
        if clauses != same or not holds or len(plan.names) < len(clauses.columns):
            raise LeftToDuckDBError
        self.constants: list[Node] = []
        self._plan, self._clauses = plan, clauses
        self._items = [self._item(column.node) for column in clauses.columns]
        self._keys = [self._value(node) for node in clauses.group]

    def _item(self, node: Node) -> Node | int | _Aggregate:
        """Returns a selected value: an aggregate, or that of the first row of each group."""
        if not self._clauses.is_aggregated or not over_rows(node):
            return self._value(node)
        match node:
            case Call(name="count", arguments=(Literal(value=int()),)):
                return _Aggregate("count", None)
            case Call(name=name, arguments=(argument,)) if name in _EMPTY:
                column = self._value(argument)
                if isinstance(column, int):
                    return _Aggregate(name, column)
        raise LeftToDuckDBError

    def _value(self, node: Node) -> Node | int:
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
        constants: Mapping[Node, list[Any]],
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

        def values_of(item: Node | int | _Aggregate) -> list[Any]:
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

    def _empty(self, number: int, constants: Mapping[Node, list[Any]]) -> Rows:
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
