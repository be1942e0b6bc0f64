"""Checks the arguments of list aggregates, and suggests an aggregate over all rows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from ssduck.errors import ArgumentError
from ssduck.formatting import type_in_words
from ssduck.language.analysis import free_aliases
from ssduck.language.builtins import AGGREGATES
from ssduck.language.tree import Call, Query


def argument_check(call: Call, query: Query | None) -> Callable[[Sequence[Any]], None]:
    """Returns a check that rejects arguments that a call would misunderstand.

    An aggregate takes a list; a text is not one.

    Args:
        call: the call.
        query: the query that contains it; None outside of queries.

    Returns:
        A function of the arguments' values, which raises an ArgumentError.
    """
    if call.name not in AGGREGATES or len(call.arguments) != 1:
        return _anything
    is_of_row = bool(free_aliases(call.arguments[0]))

    def check(arguments: Sequence[Any]) -> None:
        (value,) = arguments
        if isinstance(value, Iterable) and not (is_of_row and isinstance(value, str)):
            return
        raise ArgumentError(
            f"{call.name} takes a list, not {type_in_words(value)}",
            span=call.span,
            instead=None if query is None or not query.sources else _over_rows(call, query),
        )

    return check


def _anything(_: Sequence[Any]) -> None:
    """Accepts any arguments: other functions check their own."""


def _over_rows(call: Call, query: Query) -> Callable[[str], str]:
    """Returns the text of an aggregate over all rows, given the program's text."""

    def spelling(text: str) -> str:
        argument = call.arguments[0].span
        sources = text[query.sources[0].span.start : query.sources[-1].span.end]
        where = query.where
        if where is not None and call not in where.walk():
            sources += f" WHERE {text[where.span.start : where.span.end]}"
        words = ("SELECT", text[argument.start : argument.end], "FROM", *sources.split())
        return f"{call.name}({' '.join(words)} AS list)"

    return spelling
