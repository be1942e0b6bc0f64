"""Errors for names that there are not, and for what an aggregate of a list does not take."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from ssduck.errors import ArgumentError, SelectScriptError, SourceSpan, UnknownNameError, nearest
from ssduck.formatting import short_repr, type_in_words
from ssduck.language import ast
from ssduck.language.analysis import free_aliases
from ssduck.language.builtins import AGGREGATES
from ssduck.language.sql_suggestions import plain_names, suggestion_for_call


def missing_source_error(
    alias: str | None, elements: Mapping[str | None, Any], span: SourceSpan
) -> SelectScriptError:
    """Returns the error for `this`, or `alias.this`, where there is no such source."""
    names = [name for name in elements if name is not None]
    if alias is not None:
        return UnknownNameError(
            f"there is no source {short_repr(alias)} here",
            span=span,
            suggestions=nearest(alias, names) or names[:3],
        )
    if names:
        choices = ", ".join(f"{name}.this" for name in names)
        return ArgumentError(f"'this' alone is ambiguous here; write one of {choices}", span=span)
    return UnknownNameError(
        "there is no 'this' here: it is the element of a query's only source", span=span
    )


# The least similarity of a function that is suggested for another name.
_FUNCTION_LIKENESS = 0.7


def unknown_function(node: ast.Call, known: Sequence[str]) -> UnknownNameError:
    """Returns the error for an unknown function."""
    plain = plain_names(node.name)
    same = tuple(name for name in known if name.upper() in plain)
    instead = suggestion_for_call(node.name)
    near = same or nearest(node.name, known, least=_FUNCTION_LIKENESS)
    return UnknownNameError(
        f"there is no function {short_repr(node.name)}" + (f"; {instead}" if instead else ""),
        span=node.name_span,
        suggestions=near if same or not instead else (),
    )


def argument_check(call: ast.Call, query: ast.Query | None) -> Callable[[Sequence[Any]], None]:
    """Returns a check that rejects arguments that a call would misunderstand.

    An aggregate takes a list; a text is not one.

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


def _over_rows(call: ast.Call, query: ast.Query) -> Callable[[str], str]:
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
