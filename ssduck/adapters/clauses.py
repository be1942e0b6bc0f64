"""Turns selected relations into logic clauses, by also selecting their arguments.

`SELECT above(a.this, b.this)` becomes `SELECT to([a.this, b.this, above(a.this, b.this)],
'above')`, so that one query returns all parts of a clause.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ssduck import validation
from ssduck.adapters.base import Selection
from ssduck.errors import ArgumentError
from ssduck.language.analysis import aliases_of, free_aliases
from ssduck.language.operators import size_of
from ssduck.language.tree import Call, ListLiteral, Literal, Name, Node, Query, This


@dataclass(frozen=True)
class Clause:
    """A relation, its arguments and its result.

    Attributes:
        relation: the name of the relation.
        arguments: the values of the arguments.
        result: the value of the relation.
    """

    relation: str
    arguments: Sequence[Any]
    result: Any


def with_arguments(query: Query) -> Query:
    """Returns the query with each column replaced by a list of arguments and result.

    Raises:
        ArgumentError: a column is not a relation and has no name by `to`.
    """
    if not query.items:
        raise ArgumentError(
            "SELECT * selects no relations; select isRobot(this), say", span=query.span
        )
    return replace(query, items=tuple(_item_with_arguments(item, query) for item in query.items))


def clauses(selection: Selection) -> Iterator[Clause]:
    """Yields the clauses of a query of `with_arguments`, also those that are false or unknown.

    Raises:
        ArgumentError: `to` gives a name that is not a string.
    """
    rows = selection.read()
    names = rows.names if isinstance(rows.names, list) else [rows.names] * len(rows.values)
    for row_names, row in zip(names, rows.values, strict=True):
        for name, (*arguments, result) in zip(row_names, row, strict=True):
            validation.text(name, "the name of a relation must be a text")
            selection.charge(len(name) + sum(map(size_of, (*arguments, result))))
            yield Clause(name, arguments, result)


def _item_with_arguments(item: Node, query: Query) -> Node:
    span = item.span
    match item:
        case Call(name="to", arguments=(value, name)):
            arguments = _arguments(value, query)
            if arguments is None:
                arguments = _mentioned_sources(value, query)
        case Call(name=relation) | Name(name=relation) if relation != "to":
            arguments, value, name = _arguments(item, query), item, Literal(span, relation)
            assert arguments is not None
        case _:
            raise ArgumentError(
                "this column is no relation, so the clause has no name; give it one by "
                "to(…, 'name')",
                span=span,
            )
    return Call(span, "to", (ListLiteral(span, (*arguments, value)), name), span)


def _arguments(value: Node, query: Query) -> tuple[Node, ...] | None:
    """Returns the arguments of a relation, None for other expressions; a bare name has `this`."""
    match value:
        case Call(arguments=arguments):
            return arguments
        case Name(span=span) if len(query.sources) <= 1:
            return (This(span, None),)
        case Name(span=span, name=name):
            raise ArgumentError(
                f"with several sources, name the argument: {name}(a.this)", span=span
            )
    return None


def _mentioned_sources(value: Node, query: Query) -> tuple[Node, ...]:
    """Returns the sources that an expression mentions, in order; a single source always."""
    if len(query.sources) == 1:
        return (This(value.span, None),)
    mentioned = free_aliases(value)
    return tuple(This(value.span, a) for a in aliases_of(query) if a in mentioned)
