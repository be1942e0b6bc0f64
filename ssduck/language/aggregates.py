"""Aggregates over the rows of a group: `count(*)`, `max(z)` in SELECT, HAVING and ORDER BY.

A query has groups where it has GROUP BY. Without it, all of its rows are one group if it has
HAVING, or `count(*)` in SELECT. In any other query an aggregate is of a list.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

from ssduck.errors import ArgumentError, SelectScriptError
from ssduck.formatting import type_in_words
from ssduck.language import ast
from ssduck.language.analysis import aliases_of, cached_by_node, free_aliases
from ssduck.language.builtins import AGGREGATES, NUMBER_FUNCTIONS
from ssduck.language.evaluator import ExpressionCompiler, Frame, Thunk

# The values of aggregates over no rows; the other aggregates are None.
_EMPTY_RESULTS: dict[str, Callable[[], Any]] = {"count": int, "sum": int, "uniq": list}


def over_rows(node: ast.Node) -> list[ast.Call]:
    """Returns the aggregates in a part of a query with groups that are over the rows of a group.

    An aggregate of a nested query that is a list, or of a list literal, is over that list;
    `count(uniq(x))` is over the list that `uniq(x)` makes of the rows.
    """
    if isinstance(node, ast.Query):
        return []
    match node:
        case ast.Call(name=name, arguments=(argument,)) if name in AGGREGATES:
            is_list = isinstance(argument, ast.Query | ast.ListLiteral) and not _is_number(argument)
            if not is_list and not _is_uniq(argument):
                return [node]
    return [call for child in node.children() for call in over_rows(child)]


def _is_uniq(node: ast.Node) -> bool:
    return isinstance(node, ast.Call) and node.name == "uniq" and over_rows(node) == [node]


@cached_by_node
def _counts_rows(node: ast.Node) -> bool:
    """Checks whether the node contains an aggregate of a number; `*` counts as one."""
    match node:
        case ast.Query():
            return False
        case ast.Call(name=name, arguments=(argument,)) if name in AGGREGATES and _is_number(
            argument
        ):
            return True
    return any(map(_counts_rows, node.children()))


def _is_number(node: ast.Node) -> bool:
    """Checks whether a value is a number that is written out, or the value of a nested query."""
    match node:
        case ast.Literal(value=int() | float()):
            return True
        case ast.Unary(operator="-" | "+", operand=operand):
            return _is_number(operand)
        case ast.Binary(operator="+" | "-" | "*" | "/", left=left, right=right):
            return _is_number(left) and _is_number(right)
        case ast.Call(name=name, arguments=arguments) if name in NUMBER_FUNCTIONS:
            return all(map(_is_number, arguments))
        case ast.Query(adapter=ast.AdapterClause(name="value", of_sql=True)):
            return True
    return False


def is_one_group(query: ast.Query) -> bool:
    """Checks whether all rows of a query are one group."""
    if query.group:
        return False
    if query.having is not None:
        return True
    return query.recursion is None and any(map(_counts_rows, query.items))


def is_grouped(query: ast.Query) -> bool:
    """Checks whether a query has groups."""
    return bool(query.group) or is_one_group(query)


def is_aggregated(query: ast.Query, selected: Iterable[ast.Node]) -> bool:
    """Checks whether SELECT gives one row a group."""
    if query.recursion is not None or not is_grouped(query):
        return False
    calls = (call for node in selected for call in over_rows(node))
    return any(_is_of_rows(call.arguments[0]) for call in calls)


def _is_of_rows(argument: ast.Node) -> bool:
    """Checks whether an argument cannot be a list that is the same for all rows."""
    is_written_out = isinstance(argument, ast.Literal) or _is_number(argument)
    return is_written_out or bool(free_aliases(argument))


class GroupFunction:
    """A part of a query as a function of the rows of a group.

    An aggregate is over all rows of the group; everything else is that of its first row.
    """

    def __init__(self, node: ast.Node, compiler: ExpressionCompiler) -> None:
        self._aggregates: list[tuple[str, ast.Call, Thunk]] = []
        placeholders: dict[ast.Node, ast.Node] = {}
        for call in over_rows(node):
            name = f"aggregate {len(self._aggregates)}"
            self._aggregates.append((name, call, compiler.thunk(call.arguments[0])))
            placeholders[call] = ast.Placeholder(call.span, name)
        self._value = compiler.thunk(node.replaced(placeholders.get))

    def __call__(self, rows: Sequence[Frame], outer: Frame) -> Any:
        """Returns the value for a group."""
        first = rows[0] if rows else outer
        placeholders = dict(first.placeholders)
        for name, call, argument in self._aggregates:
            placeholders[name] = _aggregated(call, argument, rows, first)
        frame = Frame(
            first.scope, first.elements, first.local, placeholders, first.columns, first.cached
        )
        return self._value(frame)


def _aggregated(call: ast.Call, argument: Thunk, rows: Sequence[Frame], first: Frame) -> Any:
    (node,) = call.arguments
    if free_aliases(node):
        values = [argument(row) for row in rows]
    else:
        value = argument(first)
        # An aggregate of a list that is the same for all rows is over that list.
        values = list(value) if isinstance(value, list | tuple) else [value] * len(rows)
    values = [value for value in values if value is not None]
    if not values:
        return _EMPTY_RESULTS.get(call.name, lambda: None)()
    try:
        if call.name in ("sum", "avg") and all(type(value) is float for value in values):
            total = exact_sum(values)
            return total if call.name == "sum" else total / len(values)
        return AGGREGATES[call.name]([values])
    except ArgumentError as error:
        raise ArgumentError(_refusal_message(call.name, values), span=call.span) from error
    except SelectScriptError as error:
        error.span = error.span or call.span
        raise


def exact_sum(values: Sequence[float]) -> float:
    """Returns the sum of doubles, rounded once."""
    try:
        return math.fsum(values)
    except (OverflowError, ValueError):  # too large, or infinities of both signs
        return sum(values)


def _refusal_message(name: str, values: Sequence[Any]) -> str:
    kinds = list(dict.fromkeys(map(type_in_words, values)))
    message = f"{name} over the rows of a group does not take {' and '.join(kinds[:3])}"
    of_each = f"; of each number write {name}(x(this)) AS x, {name}(y(this)) AS y, …"
    return message + (of_each if "a list" in kinds else "")


def check_one_group(query: ast.Query, selected: Sequence[ast.Node]) -> None:
    """Checks that no value of a single row is used if all rows are one group."""
    if not is_one_group(query):
        return
    aliases = {None, *aliases_of(query)}
    if query.having is not None:
        for part in _row_dependent_parts(query.having, aliases):
            raise ArgumentError(
                "HAVING without GROUP BY applies to all rows together, but this is a value of "
                "one row; write conditions on rows in WHERE, or group the rows by GROUP BY",
                span=part.span,
            )
    if is_aggregated(query, selected):
        for node in selected:
            for part in _row_dependent_parts(node, aliases):
                raise ArgumentError(
                    "this is a value of one row, beside an aggregate of all rows; "
                    "write GROUP BY, or select it in a query of its own",
                    span=part.span,
                )


def _row_dependent_parts(node: ast.Node, aliases: set[str | None]) -> Iterator[ast.Node]:
    """Yields the parts outside of aggregates that depend on a row."""
    if not free_aliases(node) & aliases or node in over_rows(node):
        return
    if isinstance(node, ast.Binary | ast.Unary | ast.If | ast.ListLiteral) or over_rows(node):
        for child in node.children():
            yield from _row_dependent_parts(child, aliases)
    else:
        yield node
