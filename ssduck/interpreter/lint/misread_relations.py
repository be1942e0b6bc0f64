"""Finds relations that are valid where they stand, but read as something else."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np

from ssduck.errors import SourceSpan
from ssduck.formatting import name_path
from ssduck.interpreter.lint.swapped_roles import CARRIED, can_move, swapped
from ssduck.language.tree import (
    Binary,
    Branch,
    Call,
    If,
    Index,
    Literal,
    Name,
    Node,
    OperatorChain,
    QualifiedName,
    Query,
    Source,
    This,
    Unary,
)
from ssduck.sql.relations.registry import RELATIONS
from ssduck.world.entities import Entity

# What to write in place of a number that holds of nearly everything as a condition.
_AS_CONDITION = {
    "inside": "it is the share of b inside of a, a number from 0 to 1: write contains(a, b) for "
    "nearly all of b, or inside(a, b) > 0.5; a is the container, b is what is in it",
    "distance": "it is a number: write distance(a, b) < 0.1, say",
    "clearance": "it is a number: write near(a, b, 0.1), or clearance(a, b) < 0.1",
}
# The functions over time whose value is a list of two.
_EXTREMES = frozenset(("least", "greatest"))
_OF_EXTREMES = "{0}(…) is [time, value], and {1} is of such lists here: the value is {0}(…)[1]"
_CONDITIONS_OVER_TIME = frozenset(("since", "heldFor", "holds"))
VOLUME_NOTE = (
    "volume is an eighth of the volume of the box, as published; solidVolume is that of the "
    "shapes, aabbVolume that of the box (told once)"
)
_VOLUME_IN_SQL = re.compile(r"\bvolume\s*\(", re.IGNORECASE)


def misread_calls(statement: Node) -> Iterator[tuple[Call, str]]:
    """Yields the calls that read as something else, with what is told of them.

    These are conditions that are such a number and are not compared, and extremes in arithmetic.
    """
    for node in statement.walk():
        for part in _conditions(node):
            if isinstance(part, Call) and part.name in _AS_CONDITION:
                told = _AS_CONDITION[part.name]
                yield part, f"{part.name} as a condition holds of any number but 0; {told}"
        if isinstance(node, Binary) and node.operator in ("+", "-", "==", "!="):
            sides = node.left, node.right
            for side, other in (sides, sides[::-1]):
                is_number = isinstance(other, Literal) and not isinstance(other.value, str)
                is_number = is_number or node.operator in ("+", "-")
                if isinstance(side, Call) and side.name in _EXTREMES and is_number:
                    yield side, _OF_EXTREMES.format(side.name, node.operator)
                    break


# The relations of two whose answer needs the shapes of both, or a region that one of them is.
_OF_SHAPES = frozenset(
    name
    for name, relation in RELATIONS.items()
    if name == "within" or (relation.geometry is not None and relation.required_count > 1)
)


# The relations that compare a position, or a box, with the axis-aligned box of an entity.
_OF_BOXES = frozenset(("above", "below", "within", "overlaps"))


def of_entities(statement: Node) -> Iterator[Call]:
    """Yields the calls that ask for shapes or boxes."""
    for call in statement.walk():
        if isinstance(call, Call) and call.name in _OF_SHAPES | _OF_BOXES:
            yield call


def unfit(call: Call, entities: Sequence[Entity | None]) -> Iterator[tuple[str, SourceSpan]]:
    """Yields why a call tells nothing of entities, each with the place.

    Args:
        call: the call.
        entities: its arguments; None for what names no entity.
    """
    for i, (part, entity) in enumerate(zip(call.arguments, entities, strict=True)):
        told = "" if entity is None else _without_extent(call, entity, is_first=i == 0)
        if told:
            yield told, part.span
    match call.name, entities:
        case name, (Entity() as carrier, Entity() as carried, *_) if name in CARRIED:
            if can_move(carrier) and not can_move(carried):
                paths = (name_path(one.world.name, one.name) for one in (carrier, carried))
                yield swapped(name, *paths), call.span


def _without_extent(call: Call, entity: Entity, *, is_first: bool) -> str:
    """Returns why a call tells nothing of an entity, an argument; '' if it does."""
    name = name_path(entity.world.name, entity.name)
    body = entity.info.body
    if call.name in _OF_SHAPES and body is not None and not body.shapes:
        return (
            f"{call.name} asks for the shapes of {name}, which has none that collides: it touches "
            f"nothing, and is infinitely far from all; distance({name}, …) is that of positions"
        )
    has_box = call.name == "overlaps" or is_first
    if call.name in _OF_BOXES and has_box and np.isinf(entity.aabb).all():
        return (
            f"{call.name} compares the axis-aligned box of {name}, a tilted plane, which is "
            f"infinite: of what is over the plane, penetration({name}, …) is 0, and clearance is "
            "the height"
        )
    return ""


def as_conditions(statement: Node) -> Iterator[Node]:
    """Yields what stands as a condition, and may be an entity or a list, which always hold."""
    for node in statement.walk():
        for part in _conditions(node):
            if isinstance(part, Call | Name | QualifiedName | Index):
                yield part


def has_volume(statement: Node) -> bool:
    """Checks whether a statement names the relation `volume`."""
    return any(isinstance(part, Call | Name) and part.name == "volume" for part in statement.walk())


def has_volume_in_sql(sql: str) -> bool:
    """Checks whether a statement of raw SQL calls `volume`."""
    return _VOLUME_IN_SQL.search(sql) is not None


def same_rows(node: Node, outer: Query | None = None) -> Iterator[tuple[str, SourceSpan]]:
    """Yields what is told of `this` beside `b.this`, the same row if b is a query's only source.

    Args:
        node: a part of a statement.
        outer: the query around it.
    """
    if isinstance(node, Query) and outer is not None and len(node.sources) == 1:
        alias = node.sources[0].alias
        for call in _calls_of_query(node):
            aliases = {part.alias: part for part in call.arguments if isinstance(part, This)}
            if alias is not None and {alias, None} <= aliases.keys():
                advice = _outer_row(outer, alias)
                message = f"this is {alias}.this here, the row of the nested query; {advice}"
                yield message, aliases[None].span
    inside = node if isinstance(node, Query) else outer
    for child in node.children():
        yield from same_rows(child, outer if isinstance(child, Source) else inside)


def _calls_of_query(node: Node) -> Iterator[Call]:
    """Yields the calls in the clauses of a query, without those in its source and in others."""
    for child in node.children():
        if not isinstance(child, Query | Source):
            if isinstance(child, Call):
                yield child
            yield from _calls_of_query(child)


def _outer_row(outer: Query, inner: str) -> str:
    """Returns how the row of a query is written in a nested one, whose source is `inner`."""
    source = outer.sources[0]
    variable = source.value.name if isinstance(source.value, Name) else "…"
    if source.alias not in (None, variable, inner):
        return f"the row of the outer query is {source.alias}.this"
    alias = "a" if inner != "a" else "b"
    return f"name the outer source, FROM {alias}={variable}, and write {alias}.this"


def _conditions(node: Node) -> tuple[Node, ...]:
    """Returns the parts of a node that are conditions."""
    match node:
        case Query(where=where, having=having, recursion=recursion):
            stop = None if recursion is None else recursion.stop
            return tuple(part for part in (where, having, stop) if part is not None)
        case Unary(operator="NOT", operand=operand):
            return (operand,)
        case Binary(operator="AND" | "OR" | "XOR", left=left, right=right):
            return left, right
        case OperatorChain(operators=("AND" | "OR" | "XOR", *_), operands=operands):
            return tuple(operands)
        case If(condition=condition) | Branch(condition=condition):
            return (condition,)
        case Call(name=name, arguments=(condition, *_)) if name in _CONDITIONS_OVER_TIME:
            return (condition,)
    return ()
