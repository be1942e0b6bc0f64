"""A query in parts, as `Interpreter.evalAs` receives it in OpenRAVE's dialect.

There, a subclass goes through the rows itself. A column is a sequence of a kind, a name and the
arguments; `eval(part, elements, names)` returns the value of a part for the elements of a row.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import product
from typing import Any, overload

from ssduck.errors import ArgumentError
from ssduck.language import ast
from ssduck.language.analysis import written_name
from ssduck.language.clauses import SelectedValue
from ssduck.language.evaluator import Frame


class QueryPart:
    """A part of a query, to be evaluated for the elements of a row."""

    def __init__(self, node: ast.Node, frame: Frame) -> None:
        self.node = node
        self._frame = frame

    def value(self, elements: Sequence[Any], names: Sequence[str]) -> Any:
        """Returns its value for the elements of a row, one of each of the named sources."""
        if len(elements) != len(names):
            raise ArgumentError(f"{len(elements)} elements and {len(names)} names of sources")
        row: dict[str | None, Any] = {**self._frame.elements, **dict(zip(names, elements))}  # noqa: B905
        row.pop(None, None)
        if len(elements) == 1:
            row[None] = elements[0]
        return self._frame.row(row, dict(self._frame.cached)).value(self.node)


class Condition(QueryPart):
    """The condition behind WHERE."""


class SelectedColumn(QueryPart, Sequence[Any]):
    """A column: `["function", name, arguments]`; for `to`, the value and the name."""

    def __init__(self, column: SelectedValue, frame: Frame) -> None:
        super().__init__(column.node, frame)
        self._column = column

    @property
    def _is_renamed(self) -> bool:
        return self._column.name != _plain_name(self.node)

    def value(self, elements: Sequence[Any], names: Sequence[str]) -> Any:
        """Returns its value; for `to`, with the name."""
        value = self.plain_value(elements, names)
        return (value, self.column_name(elements, names)) if self._is_renamed else value

    def plain_value(self, elements: Sequence[Any], names: Sequence[str]) -> Any:
        """Returns its value; for `to`, without the name."""
        return super().value(elements, names)

    def column_name(self, elements: Sequence[Any], names: Sequence[str]) -> Any:
        """Returns its name in a row."""
        name = self._column.name
        return (
            name if isinstance(name, str) else QueryPart(name, self._frame).value(elements, names)
        )

    def _as_list(self) -> tuple[str, str, list[Any]]:
        if self._is_renamed:
            name = self._column.name
            column_name = ast.Literal(self.node.span, name) if isinstance(name, str) else name
            inner = SelectedColumn(SelectedValue(self.node, _plain_name(self.node)), self._frame)
            return "function", "to", [inner, QueryPart(column_name, self._frame)]
        match self.node:
            case ast.Call(arguments=arguments):
                pass
            case ast.UnresolvedName(span=span):
                arguments = (ast.This(span, None),)
            case _:
                arguments = (self.node,)
        name = _plain_name(self.node)
        return "function", name, [QueryPart(argument, self._frame) for argument in arguments]

    @overload
    def __getitem__(self, index: int) -> Any: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Any]: ...
    def __getitem__(self, index: int | slice) -> Any:
        return self._as_list()[index]

    def __len__(self) -> int:
        return 3


class SelectedColumns(Sequence[SelectedColumn]):
    """The columns behind SELECT; `eval` gives the value of the only column, or a list of all."""

    def __init__(self, query: ast.Query, columns: Sequence[SelectedValue], frame: Frame) -> None:
        self.query = query
        self.frame = frame
        self.form = "dict" if query.adapter is None else query.adapter.name
        self._columns = [SelectedColumn(column, frame) for column in columns]

    def value(self, elements: Sequence[Any], names: Sequence[str]) -> Any:
        """Returns the value of the only column, or a list of all."""
        values = [column.value(elements, names) for column in self._columns]
        return values[0] if len(values) == 1 else values

    @overload
    def __getitem__(self, index: int) -> SelectedColumn: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[SelectedColumn]: ...
    def __getitem__(self, index: int | slice) -> Any:
        return self._columns[index]

    def __len__(self) -> int:
        return len(self._columns)


class SourceElements(Iterator[tuple[Any, ...]]):
    """The combinations of the sources' elements: an iterator, also by Python 2's `next`."""

    def __init__(self, elements: Sequence[Sequence[Any]]) -> None:
        self._rows = product(*elements)

    def __next__(self) -> tuple[Any, ...]:
        return next(self._rows)

    next = __next__


def takes_results(call: Callable[..., Any]) -> bool:
    """Checks whether an `evalAs` has the parameters of the published interpreters."""
    return "RESULTS" in inspect.signature(call).parameters


# The three basic forms as methods, as in the published interpreters. A subclass passes on the
# arguments of its `evalAs(self, AS, PARAMS, SELECT, FROM_n, RESULTS)`: the form's arguments, the
# columns, the names of the sources, and a tuple of elements for each row.


def as_list(
    _: object,
    __: Sequence[Any],
    select: SelectedColumns,
    names: Sequence[str],
    rows: Iterable[Sequence[Any]],
) -> list[Any]:
    """`AS list`: returns the values row after row."""
    return [column.plain_value(row, names) for row in rows for column in select]


def as_dict(
    _: object,
    __: Sequence[Any],
    select: SelectedColumns,
    names: Sequence[str],
    rows: Iterable[Sequence[Any]],
) -> list[dict[Any, Any]]:
    """`AS dict`: returns a dict for each row."""
    return [
        {column.column_name(row, names): column.plain_value(row, names) for column in select}
        for row in rows
    ]


def as_value(
    _: object,
    __: Sequence[Any],
    select: SelectedColumns,
    names: Sequence[str],
    rows: Iterable[Sequence[Any]],
) -> Any:
    """`AS value`: returns the first value of the first row; `[]` if there is none."""
    for row in rows:
        return select[0].plain_value(row, names)
    return []


def _plain_name(node: ast.Node) -> str:
    """Returns the name of a column without `to`."""
    match node:
        case (
            ast.Call(name=name)
            | ast.UnresolvedName(name=name)
            | ast.Name(name=name)
            | ast.TimeIndex(name=name)
        ):
            return written_name(name)
        case ast.Index(indices=(*_, ast.Literal(value=str() as key))):
            return key
        case ast.This(alias=alias):
            return alias or "this"
    return "value"
