"""EXPLAIN: the SQL that the queries of a program become, and what is left to Python."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TypeAlias

from ssduck.plan import Plan
from ssduck.tree import Call, Node, Query
from ssduck.udfs import RELATIONS

PlanOf: TypeAlias = Callable[[Query], Plan | None]


def told(text: str, statement: Node, plan_of: PlanOf) -> str:
    """What becomes of the queries in a statement.

    Args:
        text: the program.
        statement: the statement.
        plan_of: the plan of a query; None for one that runs row by row.
    """
    return "\n\n".join(
        _told(text, query, plan) for query, plan in _plans(outermost([statement]), plan_of)
    )


def outermost(nodes: Iterable[Node]) -> list[Query]:
    """The queries in parts of a program that are in no other query."""
    found: list[Query] = []
    for node in nodes:
        found.extend([node] if isinstance(node, Query) else outermost(node.children()))
    return found


def _plans(queries: Iterable[Query], plan_of: PlanOf) -> Iterator[tuple[Query, Plan | None]]:
    """The queries with their plans, and those that are evaluated before them."""
    for query in queries:
        plan = plan_of(query)
        yield query, plan
        if plan is None:
            yield from _plans(outermost(query.children()), plan_of)
            continue
        given = [
            source.value
            for source, shape in zip(query.sources, plan.shapes, strict=True)
            if shape.given
        ]
        yield from _plans(outermost([*given, *plan.constants, *plan.once]), plan_of)


def _told(text: str, query: Query, plan: Plan | None) -> str:
    if plan is None:
        lines = [f"-- row by row in Python: {_source(text, query)}"]
    else:
        lines = [plan.select.sql(dialect="duckdb", pretty=True)]
        lines += [f"-- left to Python: {_source(text, node)}" for node in plan.left]
        if plan.rest.distinct:
            lines.append("-- left to Python: DISTINCT")
    return "\n".join([*lines, *_narrow(query)])


def _narrow(query: Query) -> list[str]:
    """What the shapes themselves are asked for, relation by relation."""
    names = dict.fromkeys(node.name for node in query.walk() if isinstance(node, Call))
    asked = {name: RELATIONS[name].asked for name in names if name in RELATIONS}
    return [f"-- the narrow phase: {name}, {pairs}" for name, pairs in asked.items() if pairs]


def _source(text: str, node: Node) -> str:
    return " ".join(text[node.span.start : node.span.end].split())
