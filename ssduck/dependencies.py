"""What the parts of a program depend on: rows, names that change, things that happen."""

from __future__ import annotations

from collections.abc import Collection
from weakref import WeakKeyDictionary

from ssduck.tree import Assignment, Bare, Call, Name, Node, Query, Recursion, Source, This
from ssduck.udfs import RELATIONS

# Calls that do something, or see more than their arguments: made row by row, in order.
IMPURE = frozenset(("print", "eval", "clear"))


def free_aliases(node: Node) -> frozenset[str | None]:
    """The aliases whose `this` a part mentions, and that no query in it has as a source."""
    if isinstance(node, This):
        return frozenset((node.alias,))
    if isinstance(node, Bare):
        return frozenset((None,))
    found: set[str | None] = set()
    if not isinstance(node, Query):
        for child in node.children():
            found |= free_aliases(child)
        return frozenset(found)
    for child in node.children():
        if not isinstance(child, Source):
            found |= free_aliases(child)
    found -= {None, *(source.alias for source in node.sources)}
    for source in node.sources:  # a source sees what is around the query
        found |= free_aliases(source)
    return frozenset(found)


def sees_outside(query: Query) -> bool:
    """Whether a nested query sees rows of the queries around it."""
    return bool(free_aliases(query))


def is_impure(node: Node) -> bool:
    """Whether evaluating it does something, so that order and number matter."""
    match node:
        case Assignment():
            return True
        case Call(name=name) if name in IMPURE:
            return True
        case Recursion(start=start, step=step, stop=stop):
            # State variables are nothing that anything else sees.
            return is_impure(stop) or any(is_impure(a.value) for a in (*start, *step))
    return any(map(is_impure, node.children()))


_LOOKS_UP: WeakKeyDictionary[Node, tuple[frozenset[str], frozenset[str]]] = WeakKeyDictionary()


def looks_up(node: Node) -> tuple[frozenset[str], frozenset[str]]:
    """The tables that relations in a part look things up in, and the names of its variables."""
    if node not in _LOOKS_UP:
        parts = list(node.walk())
        calls = {part.name for part in parts if isinstance(part, Call)} & RELATIONS.keys()
        tables = frozenset(table for name in calls for table in RELATIONS[name].tables)
        names = frozenset(part.name for part in parts if isinstance(part, Name))
        _LOOKS_UP[node] = tables, names
    return _LOOKS_UP[node]


def states(query: Query) -> frozenset[str]:
    """The state variables of a hierarchical query."""
    if query.recursion is None:
        return frozenset()
    assignments = (*query.recursion.start, *query.recursion.step)
    return frozenset(assignment.name for assignment in assignments)


def changing(query: Query) -> frozenset[str]:
    """The variables that may differ from row to row of a query: those that it assigns."""
    return frozenset(part.name for part in query.walk() if isinstance(part, Assignment))


def mentions(node: Node, names: Collection[str]) -> bool:
    """Whether a part reads one of these variables."""
    return any(isinstance(part, Name) and part.name in names for part in node.walk())
