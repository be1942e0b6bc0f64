"""Evaluates clauses on rows in Python: conditions, order, groups, paths, selected values.

A row is a `Frame`. `Clauses` are a query's clauses as functions of frames, for the rows from SQL,
or for all combinations of the sources' elements if a query runs row by row.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cmp_to_key, partial
from itertools import islice, product
from typing import Any, TypeAlias

from ssduck.errors import ArgumentError, EvaluationError, SelectScriptError
from ssduck.formatting import as_evaluation_error, short_repr
from ssduck.language import ast
from ssduck.language.aggregates import GroupFunction, over_rows
from ssduck.language.evaluator import ExpressionCompiler, Frame
from ssduck.language.operators import ELEMENT_BYTES, apply, truth
from ssduck.language.value_keys import equality_key

# Rows of more columns are counted by Python, too, since SQL may have fetched fewer.
MANY_COLUMNS = 16


@dataclass(frozen=True)
class Rows:
    """The rows of a query."""

    values: list[tuple[Any, ...]]  # a tuple for each row, in order, with a value for each column
    # The names of the columns; a tuple for each row if `to` names a column differently from row to
    # row.
    names: tuple[Any, ...] | list[tuple[Any, ...]]


@dataclass(frozen=True)
class Paths:
    """The result of a hierarchical query: the rows of each path, or of each of its steps."""

    paths: Sequence[Selected]


@dataclass(frozen=True)
class Groups:
    """The result of a query with GROUP BY: the rows, or the paths, of each group."""

    groups: dict[str, Selected]  # the result of each group, by its printed key
    empty: Rows  # no rows, with the names of the columns

    @classmethod
    def of(
        cls, keys: Sequence[str], rows: Sequence[tuple[Any, ...]], names: tuple[str, ...]
    ) -> Groups:
        """Returns the groups of rows by their printed keys."""
        groups: dict[str, list[tuple[Any, ...]]] = {}
        for key, row in zip(keys, rows, strict=True):
            groups.setdefault(key, []).append(row)
        return cls({key: Rows(own, names) for key, own in groups.items()}, Rows([], names))


Selected: TypeAlias = Rows | Paths | Groups


def formed(selected: Selected, make: Callable[[Rows], Any]) -> Any:
    """Applies a function to the rows, or to the rows of each path or group."""
    match selected:
        case Groups(groups=groups):
            return {key: formed(part, make) for key, part in groups.items()}
        case Paths(paths=paths):
            return [formed(path, make) for path in paths]
    return make(selected)


@dataclass(frozen=True)
class SelectedValue:
    """A selected value and its name: a text, or a part to be evaluated for each row."""

    node: ast.Node
    name: str | ast.Node


@dataclass(frozen=True)
class PythonClauses:
    """The clauses of a query that Python applies to its rows, in this order."""

    columns: tuple[SelectedValue, ...]  # the selected columns
    conditions: tuple[ast.Node, ...] = ()  # the conditions on rows
    order: tuple[ast.OrderKey, ...] = ()  # the keys to sort by
    group: tuple[ast.Node, ...] = ()  # the keys to group by
    having: ast.Node | None = None  # the condition on groups
    limit: ast.Node | None = None  # the largest number of rows or groups
    is_one_group: bool = False  # whether all rows are one group
    is_aggregated: bool = False  # whether each group becomes one row
    distinct: bool = False  # whether equal rows are selected once
    offset: ast.Node | None = None  # the number of rows or groups to skip first

    @property
    def clauses(self) -> list[str]:
        """The clauses that Python always evaluates."""
        clauses = (("GROUP BY", bool(self.group)), ("DISTINCT", self.distinct))
        return [clause for clause, is_present in clauses if is_present]


class Clauses:
    """The clauses of a query as functions of frames."""

    def __init__(self, clauses: PythonClauses, compiler: ExpressionCompiler) -> None:
        self._clauses, self._only_selects = clauses, clauses == PythonClauses(clauses.columns)
        self._conditions = [compiler.condition(node) for node in clauses.conditions]
        self.items = SelectedItems(clauses.columns, compiler.thunk)
        row_keys = [k for k in clauses.order if not clauses.group or not over_rows(k.value)]
        self._order = [(compiler.thunk(key.value), key) for key in row_keys]
        self._group = [(compiler.thunk(node), node) for node in clauses.group]
        of_group = partial(GroupFunction, compiler=compiler)
        self._group_order: list[tuple[GroupFunction, ast.OrderKey]] = []
        if len(row_keys) < len(clauses.order):
            self._group_order = [(of_group(key.value), key) for key in clauses.order]
        self._having = None if clauses.having is None else of_group(clauses.having)
        self._aggregated: SelectedItems | None = None
        if clauses.is_aggregated:
            self._aggregated = SelectedItems(clauses.columns, of_group)
        self._limit = None if clauses.limit is None else compiler.thunk(clauses.limit)
        self._offset = None if clauses.offset is None else compiler.thunk(clauses.offset)

    def fulfils_conditions(self, frame: Frame) -> bool:
        """Checks whether a row fulfils the conditions."""
        return all(condition(frame) for condition in self._conditions)

    def selected(self, rows: Iterable[Frame], outer: Frame) -> Selected:
        """Returns the selected values of rows."""
        if self._only_selects:
            return self.items.rows(list(rows))
        window = self.window(outer)
        filtered: Iterable[Frame] = (
            filter(self.fulfils_conditions, rows) if self._conditions else rows
        )
        clauses = self._clauses
        if window.stop is not None and not (
            clauses.order or clauses.group or clauses.is_one_group or clauses.distinct
        ):
            filtered = islice(filtered, window.stop)
        select = self._distinct if clauses.distinct else self.items.rows
        return self.arranged(list(filtered), lambda row: row, select, window, outer)

    def arranged(
        self,
        entries: list[Any],
        row: Callable[[Any], Frame],
        select: Callable[[list[Any]], Selected],
        window: slice,
        outer: Frame,
    ) -> Selected:
        """Returns the selected values of rows or paths, ordered, grouped and limited."""
        if self._order:
            entries = _sorted(
                entries,
                lambda entry: [key(row(entry)) for key, _ in self._order],
                self._order,
                outer.scope.meter.step,
            )
        if not self._group:
            return self._select_all(entries, row, select, window, outer)
        groups: dict[str, list[Any]] = {}
        meter = outer.scope.meter
        for entry in entries:
            meter.step()
            frame = row(entry)
            key = ", ".join(printed(thunk(frame), node) for thunk, node in self._group)
            if key not in groups:
                meter.charge(len(key))
                groups[key] = []
            groups[key].append(entry)
        frames = {key: [row(entry) for entry in group] for key, group in groups.items()}
        selected_keys = [key for key in groups if self._fulfils_having(frames[key], outer)]
        if self._group_order:
            order = self._group_order
            selected_keys = _sorted(
                selected_keys,
                lambda k: [key(frames[k], outer) for key, _ in order],
                order,
                outer.scope.meter.step,
            )
        aggregated, keys = self._aggregated, selected_keys[window]
        selected = {
            key: select(groups[key]) if aggregated is None else aggregated.group(frames[key], outer)
            for key in keys
        }
        return Groups(selected, self.items.rows([]))

    def _select_all(
        self,
        entries: list[Any],
        row: Callable[[Any], Frame],
        select: Callable[[list[Any]], Selected],
        window: slice,
        outer: Frame,
    ) -> Selected:
        """Returns the selected values of all rows or paths, if there are no groups, or one."""
        if self._clauses.is_one_group:
            frames = [row(entry) for entry in entries]
            fulfils_having = self._fulfils_having(frames, outer)
            if self._aggregated is not None:
                is_there = fulfils_having and bool([None][window])
                return self._aggregated.group(frames, outer, is_there=is_there)
            entries = entries if fulfils_having else []
        if not self._clauses.distinct:
            return select(entries[window])
        selected = select(entries)
        assert isinstance(selected, Rows)
        names = selected.names[window] if isinstance(selected.names, list) else selected.names
        return Rows(selected.values[window], names)

    def _fulfils_having(self, rows: list[Frame], outer: Frame) -> bool:
        if self._having is None or self._clauses.having is None:
            return True
        return truth(self._having(rows, outer), self._clauses.having)

    def _distinct(self, frames: list[Frame]) -> Rows:
        """Returns the distinct rows of these frames, in order of first appearance."""
        rows = self.items.rows(frames)
        names_by_row = rows.names if isinstance(rows.names, list) else [rows.names] * len(frames)
        first: dict[Any, tuple[Any, Any]] = {}
        for names, values in zip(names_by_row, rows.values, strict=True):
            first.setdefault(equality_key([*names, *values]), (names, values))
        distinct = list(first.values())
        return self.items.rows_of_values(
            [names for names, _ in distinct], [values for _, values in distinct]
        )

    def window(self, outer: Frame) -> slice:
        """Returns the rows, paths or groups that LIMIT and OFFSET leave."""
        clauses = self._clauses
        start, count = 0, None
        if clauses.offset is not None and self._offset is not None:
            start = checked_count(self._offset(outer), "OFFSET", clauses.offset)
        if clauses.limit is not None and self._limit is not None:
            count = checked_count(self._limit(outer), "LIMIT", clauses.limit)
        return slice(start, None if count is None else min(start + count, sys.maxsize))


class SelectedItems:
    """The selected columns as functions of frames, or of the rows of a group and those around it.

    Args:
        columns: the columns.
        compile: returns such a function of a part.
    """

    def __init__(
        self, columns: Sequence[SelectedValue], compile: Callable[[ast.Node], Callable[..., Any]]
    ) -> None:
        self._items = [compile(column.node) for column in columns]
        self._names = [
            column.name if isinstance(column.name, str) else compile(column.name)
            for column in columns
        ]
        self._fixed = tuple(name for name in self._names if isinstance(name, str))
        self._are_fixed = len(self._fixed) == len(columns)

    def values(self, frame: Frame) -> tuple[Any, ...]:
        """Returns the selected values of a row."""
        if len(self._items) > MANY_COLUMNS:
            frame.scope.meter.charge(ELEMENT_BYTES * len(self._items))
        frame.scope.meter.step()
        return tuple([item(frame) for item in self._items])

    def names(self, *row: Any) -> tuple[Any, ...]:
        """Returns the column names of a row."""
        if self._are_fixed:
            return self._fixed
        return tuple([name if isinstance(name, str) else name(*row) for name in self._names])

    def rows(self, frames: list[Frame]) -> Rows:
        """Returns the rows of these frames."""
        values = [self.values(frame) for frame in frames]
        names = [] if self._are_fixed else list(map(self.names, frames))
        return self.rows_of_values(names, values)

    def rows_of_values(self, names: list[tuple[Any, ...]], values: list[tuple[Any, ...]]) -> Rows:
        """Returns the rows of values that were selected before."""
        return Rows(values, self._fixed if self._are_fixed else names)

    def group(self, frames: list[Frame], outer: Frame, *, is_there: bool = True) -> Rows:
        """Returns the row of a group; no row where HAVING excludes it."""
        if not is_there:
            return Rows([], self._fixed)
        values = tuple(item(frames, outer) for item in self._items)
        return self.rows_of_values([self.names(frames, outer)], [values])


def _sorted(
    entries: list[Any],
    keys_of: Callable[[Any], list[Any]],
    order: Sequence[tuple[Any, ast.OrderKey]],
    step: Callable[[], None],
) -> list[Any]:
    """Sorts by keys; items with equal keys keep their order. Each comparison is a step."""
    keyed = [(keys_of(entry), entry) for entry in entries]

    def compare(left: tuple[Any, Any], right: tuple[Any, Any]) -> int:
        step()
        for (_, key), a, b in zip(order, left[0], right[0], strict=True):
            if truth(apply("!=", a, b, key.value.span), key.value):
                less = truth(apply("<", a, b, key.value.span), key.value)
                return -1 if less != key.descending else 1
        return 0

    return [entry for _, entry in sorted(keyed, key=cmp_to_key(compare))]


def checked_count(value: Any, clause: str, node: ast.Node) -> int:
    """Returns a number of rows, of levels or of results."""
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise EvaluationError(
            f"{clause} takes a whole number, not {short_repr(value)}", span=node.span
        )
    return min(value, sys.maxsize)  # no sequence is longer


def printed(value: Any, node: ast.Node) -> str:
    """Returns a value as a group's key: an entity by its name, a text without quotes."""
    try:
        name = getattr(value, "name", None)
        if isinstance(name, str) and not isinstance(value, str):
            return name
        return str(_unsigned(value))
    except (SelectScriptError, RecursionError):
        raise
    except Exception as error:
        raise as_evaluation_error(error, node.span) from error


def _unsigned(value: Any) -> Any:
    """Replaces -0.0 by 0.0: they are equal, and SQL may return either."""
    if type(value) is float:
        return value + 0.0
    return [_unsigned(part) for part in value] if type(value) is list else value


class LockstepSource(Sequence[Any]):
    """Entities at recorded ticks, which go through their ticks together with another source."""

    def __init__(self, elements: Sequence[Any], leader: int) -> None:
        self.leader = leader
        self._elements = elements
        self._by_tick: dict[int, list[Any]] = {}
        for element in elements:
            self._by_tick.setdefault(element.moment.tick, []).append(element)

    def __len__(self) -> int:
        return len(self._elements)

    def __getitem__(self, place: Any) -> Any:
        return self._elements[place]

    def elements_at_tick_of(self, other: Any) -> Sequence[Any]:
        """Returns the entities at the tick of another one."""
        return self._by_tick.get(other.moment.tick, ())


def _products(values: Sequence[Iterable[Any]]) -> Iterator[tuple[Any, ...]]:
    if not any(isinstance(elements, LockstepSource) for elements in values):
        yield from product(*values)
        return
    sources = [
        elements if isinstance(elements, LockstepSource) else list(elements) for elements in values
    ]

    def following(row: tuple[Any, ...]) -> Iterator[tuple[Any, ...]]:
        if len(row) == len(sources):
            yield row
            return
        elements = sources[len(row)]
        chosen = (
            elements.elements_at_tick_of(row[elements.leader])
            if isinstance(elements, LockstepSource)
            else elements
        )
        for element in chosen:
            yield from following((*row, element))

    yield from following(())


def combinations(
    aliases: Sequence[str], values: Sequence[Iterable[Any]], outer: Frame
) -> Iterator[dict[str | None, Any]]:
    """Yields each combination of the sources' elements by alias; the last source varies fastest."""
    outer_elements: dict[str | None, Any] = dict(outer.elements)
    outer_elements.pop(None, None)
    for elements in _products(values):
        row: dict[str | None, Any] = {**outer_elements, **dict(zip(aliases, elements, strict=True))}
        if len(aliases) == 1:
            row[None] = elements[0]
        yield row


def row_frames(
    aliases: Sequence[str],
    values: Sequence[Iterable[Any]],
    outer: Frame,
    cached: dict[ast.Node, Any],
) -> Iterator[Frame]:
    """Yields the frames of all rows of a query, in order; each counts as one evaluation step."""
    count = outer.scope.meter.combination_counter()
    for elements in combinations(aliases, values, outer):
        count()
        yield outer.row(elements, cached)


def check_columns(columns: Sequence[SelectedValue]) -> None:
    """Checks that no two columns have the same name: a dict would lose one of them."""
    names = [column.name for column in columns]
    for index, column in enumerate(columns):
        if isinstance(column.name, str) and column.name in names[:index]:
            raise ArgumentError(
                f"two columns have the name {column.name!r}; name them with to(…, 'name')",
                span=column.node.span,
            )
