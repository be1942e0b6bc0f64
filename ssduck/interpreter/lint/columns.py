"""Finds the columns of a query, and those beside an aggregate that are of a group's first row."""

from __future__ import annotations

from collections.abc import Iterator

from ssduck.errors import SourceSpan
from ssduck.language.aggregates import over_rows
from ssduck.language.analysis import free_aliases
from ssduck.language.tree import (
    Binary,
    Call,
    Index,
    Literal,
    Name,
    Node,
    QualifiedName,
    Query,
    This,
)

# The operators that compare two values.
COMPARISONS = frozenset(("<", "<=", ">", ">=", "==", "!=", "IN"))
# Two names of one relation.
_SYNONYMS = {"name": "id", "kind": "type"}
# Keys that only one entity has.
_UNIQUE = frozenset(("id", "obj", "this"))


def is_comparison(node: Node) -> bool:
    """Checks whether a part compares two values."""
    return isinstance(node, Binary) and node.operator in COMPARISONS


def column_of(node: Node) -> tuple[str | None, str, bool] | None:
    """Returns the alias and the name of a column, and whether a variable may hide it."""
    match node:
        case Name(name=name):
            return None, name, True
        case QualifiedName(alias=alias, key=name):
            return alias, name, False
        case Call(name=name, arguments=(This(alias=alias),)):
            return alias, name, False
        case Index(base=This(alias=alias), indices=(Literal(value=str() as name),)):
            return alias, name, False
    return None


def first_rows(query: Query) -> Iterator[tuple[str, SourceSpan]]:
    """Yields the columns beside an aggregate of a group that are of the group's first row."""
    if not query.group or query.recursion is not None or not any(map(over_rows, query.items)):
        return
    columns = [unnamed(item) for item in query.items]
    names = {name: value for name, value in map(_named, query.items) if name}
    keys = {_printed(key, query) for key in query.group}
    keys |= {_printed(value, query) for name, value in names.items() if name in keys}
    if keys & _UNIQUE:
        return
    for value in columns:
        is_of_row = isinstance(value, Name) or bool(free_aliases(value))
        if is_of_row and not over_rows(value) and not _is_of_keys(value, keys, query):
            yield value.name if isinstance(value, Name) else "", value.span


def unnamed(item: Node) -> Node:
    """Returns the value of a column that AS or `to` names."""
    is_named = isinstance(item, Call) and item.name == "to" and item.arguments
    return item.arguments[0] if is_named else item  # type: ignore[attr-defined]


def _named(item: Node) -> tuple[str, Node]:
    match item:
        case Call(name="to", arguments=(value, Literal(value=str() as name))):
            return name, value
    return "", item


def _is_of_keys(node: Node, keys: set[str], query: Query) -> bool:
    """Checks whether a value follows from the keys of its group."""
    if _printed(node, query) in keys:
        return True
    column = column_of(node)
    if column is not None:
        return not keys.isdisjoint((f"{column[0]}.id", f"{column[0]}.this"))
    if isinstance(node, Query | This):
        return False
    return all(_is_of_keys(child, keys, query) for child in node.children())


def _printed(node: Node, query: Query) -> str:
    """Returns a column as one word, `a.z`; another value as its outline."""
    is_only = len(query.sources) == 1
    if isinstance(node, This):
        return "this" if is_only or node.alias is None else f"{node.alias}.this"
    column = column_of(node)
    if column is None:
        return node.outline()
    alias, name, _ = column
    name = _SYNONYMS.get(name, name)
    return name if is_only or alias is None else f"{alias}.{name}"
