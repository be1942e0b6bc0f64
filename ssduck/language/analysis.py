"""Finds the dependencies of the parts of a program: rows, changing names, side effects."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import wraps
from typing import TypeVar
from weakref import WeakKeyDictionary

from ssduck.errors import ArgumentError
from ssduck.language.tree import (
    AdapterClause,
    Assignment,
    Call,
    Name,
    Node,
    OperatorChain,
    QualifiedName,
    Query,
    Recursion,
    Source,
    This,
    TimeIndex,
    UnresolvedName,
)

T = TypeVar("T")

# Calls that do something, or see more than their arguments: made row by row, in order.
IMPURE = frozenset(("print", "eval", "clear"))
# Calls whose argument is evaluated at each recorded tick (ssduck.interpreter.temporal_functions).
OVER_TIME = frozenset(("since", "heldFor", "holds", "changes", "least"))


def known(look: Callable[[Node], T]) -> Callable[[Node], T]:
    """Caches a function of nodes: a planner calls it for each node, and for each that contains it.

    Children are visited first, so that no call recurses.
    """
    result: WeakKeyDictionary[Node, T] = WeakKeyDictionary()

    @wraps(look)
    def once(node: Node) -> T:
        if node not in result:
            parts = [node]
            for part in parts:  # which grows meanwhile
                parts.extend(child for child in part.children() if child not in result)
            for part in reversed(parts):
                result[part] = look(part)
        return result[node]

    return once


@known
def free_aliases(node: Node) -> frozenset[str | None]:
    """Returns the aliases whose `this` a part mentions, and that no query in it has as a source."""
    if isinstance(node, This):
        return frozenset((node.alias,))
    if isinstance(node, UnresolvedName):
        return frozenset((None,))
    if isinstance(node, QualifiedName):
        return frozenset((node.alias,))
    result: set[str | None] = set()
    if not isinstance(node, Query):
        for child in node.children():
            result |= free_aliases(child)
        return frozenset(result)
    for child in node.children():
        if not isinstance(child, Source):
            result |= free_aliases(child)
    result -= {None, *(source.alias for source in node.sources)}
    for source in node.sources:  # a source sees what is around the query
        result |= free_aliases(source)
    return frozenset(result)


def sees_outside(query: Query) -> bool:
    """Checks whether a nested query sees rows of the queries around it."""
    return bool(free_aliases(query))


@known
def is_impure(node: Node) -> bool:
    """Checks whether evaluation has side effects, so that its order and number matter."""
    match node:
        case Assignment():
            return True
        case Call(name=name) if name in IMPURE:
            return True
        case Recursion(start=start, step=step, stop=stop):
            # State variables are nothing that anything else sees.
            parts = (
                part.value if isinstance(part, Assignment) else part for part in (*start, *step)
            )
            return is_impure(stop) or any(map(is_impure, parts))
    return any(map(is_impure, node.children()))


@known
def calls_of(node: Node) -> frozenset[str]:
    """Returns the functions that a part calls."""
    own: tuple[str, ...] = (node.name,) if isinstance(node, Call) else ()
    own = (node.key,) if isinstance(node, QualifiedName) else own
    own = (
        node.operators if isinstance(node, OperatorChain) else own
    )  # users' functions may be among them
    return frozenset(own).union(*map(calls_of, node.children()))


@known
def forms_of(node: Node) -> frozenset[str]:
    """Returns the result forms that a part names."""
    own = (node.name,) if isinstance(node, AdapterClause) else ()
    return frozenset(own).union(*map(forms_of, node.children()))


def states(query: Query) -> frozenset[str]:
    """Returns the state variables of a hierarchical query."""
    if query.recursion is None:
        return frozenset()
    parts = (*query.recursion.start, *query.recursion.step)
    return frozenset(part.name for part in parts if isinstance(part, Assignment))


def changing(query: Query) -> frozenset[str]:
    """Returns the variables that may differ from row to row of a query: those that it assigns."""
    return frozenset(part.name for part in query.walk() if isinstance(part, Assignment))


def mentions(node: Node, names: Collection[str]) -> bool:
    """Checks whether a part reads one of these variables."""
    return not variables_of(node).isdisjoint(names)


@known
def variables_of(node: Node) -> frozenset[str]:
    """Returns the variables that a node reads.

    >>> from ssduck.language.parser import parse
    >>> sorted(variables_of(parse("x = y + z{1.0};").statements[0]))
    ['y', 'z']
    """
    own = (node.name,) if isinstance(node, Name | TimeIndex) else ()
    own = (node.alias,) if isinstance(node, QualifiedName) else own
    return frozenset(own).union(*map(variables_of, node.children()))


def aliases_of(query: Query) -> list[str]:
    """Returns the aliases of a query's sources.

    Raises:
        ArgumentError: two have the same name.
    """
    aliases = [
        source.alias or (f"source_{index + 1}" if index else "this")
        for index, source in enumerate(query.sources)
    ]
    if len(set(aliases)) == len(aliases):
        return aliases
    for index, alias in enumerate(aliases):
        if alias in aliases[:index]:
            raise ArgumentError(
                f"two sources are called {alias!r}; write FROM a={alias}, b=…",
                span=query.sources[index].span,
            )
    return aliases
