"""Finds relations that are valid where they stand, but read as something else."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from ssduck.errors import SourceSpan
from ssduck.formatting import name_path
from ssduck.language.operator_chains import conjuncts
from ssduck.language.tree import (
    AdapterClause,
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
    TimeIndex,
    Unary,
)
from ssduck.sql.relations.registry import RELATIONS
from ssduck.world.batches.batch_world import BatchWorld
from ssduck.world.entities import Entity
from ssduck.world.world import World

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
    """Yields what is told of `this` beside `b.this`, the same row if b is a query's only source."""
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


# What a relation asks of its second argument, which the first one carries or contains.
CARRIED = {
    **dict.fromkeys(("on", "onTop", "restsOn"), "is on"),
    "supports": "is carried by",
    **dict.fromkeys(("contains", "enclosed", "inside"), "is inside of"),
}
# What a relation asks of its second argument, which either side may be.
_PLACED = {"above": "is above", "below": "is below"}
_ASKED = CARRIED | _PLACED
# The keys that tell which entity a row is.
_NAMES = ("id", "name")


@dataclass(frozen=True, eq=False)
class RowRole:
    """A call of such a relation of each row of a query.

    Attributes:
        name: the relation.
        source: the source of the rows.
        row: how the row is written.
        other: how the second argument is written; "" for the entity itself.
        value: the second argument: an entity; or its name, of another row.
        span: the place of the call.
    """

    name: str
    source: Name | TimeIndex
    row: str
    other: str
    value: Node
    span: SourceSpan


def row_roles(statement: Node) -> Iterator[RowRole]:
    """Yields the calls of such relations of each row of a query in a statement."""
    return _row_roles(statement, {}, None)


def _row_roles(
    node: Node, sources: Mapping[str | None, Source], where: Node | None
) -> Iterator[RowRole]:
    inside: Mapping[str | None, Source] = sources
    if isinstance(node, Query):
        where = node.where
        inside = {alias: source for alias, source in sources.items() if alias is not None}
        inside.update((source.alias, source) for source in node.sources)
        inside.update((None, source) for source in node.sources if len(node.sources) == 1)
    match node:
        case Call(name=name, arguments=(This() as row, other, *_)) if name in _ASKED:
            source = inside[row.alias].value if row.alias in inside else None
            value = _named_by(other, where) if isinstance(other, This) else other
            if isinstance(source, Name | TimeIndex) and value is not None:
                written = _written(other) if isinstance(other, This) else ""
                yield RowRole(name, source, _written(row), written, value, node.span)
    for child in node.children():
        yield from _row_roles(child, sources if isinstance(child, Source) else inside, where)


def _written(row: This) -> str:
    return "this" if row.alias is None else f"{row.alias}.this"


def _named_by(row: This, where: Node | None) -> Node | None:
    """Returns the entity, or its name, that a condition takes for a row; None if it takes none."""
    for part in conjuncts(where):
        match part:
            case Binary(operator="==", left=left, right=right):
                for side, other in ((left, right), (right, left)):
                    match side:
                        case This(alias=alias) if alias == row.alias:
                            return other
                        case (
                            QualifiedName(alias=alias, key=name)
                            | Call(name=name, arguments=(This(alias=alias),))
                        ) if alias == row.alias and name in _NAMES:
                            return other
    return None


def spelled_relation(name: str) -> str:
    """Returns the name of such a relation, whose case does not matter in SQL; "" for others."""
    return next((known for known in _ASKED if known.lower() == name.lower()), "")


def can_move(entity: Entity) -> bool:
    """Checks whether the simulation can move any part of an entity."""
    body = entity.info.body
    return body is None or body.movable


def swapped(name: str, carrier: str, carried: str, entity: str = "") -> str:
    """Returns what is told of a call whose arguments are swapped."""
    asks = _ASKED[spelled_relation(name)]
    which = f"which is {entity}, immovable" if entity else "which is immovable"
    return (
        f"{name}({carrier}, {carried}) asks whether {carried}, {which}, {asks} {carrier}: "
        f"write {name}({carried}, {carrier}) to ask whether {carrier} {asks} {carried}"
    )


class SwappedRoles:
    """Tells which relations of the rows of queries have their arguments swapped.

    Args:
        finds: a function that checks whether a query has a row; None if it cannot run.
    """

    def __init__(self, finds: Callable[[Query], bool | None]) -> None:
        self._finds = finds
        # Whether the arguments are swapped, by relation and entity, as soon as that is known.
        self._verdicts: WeakKeyDictionary[World, dict[tuple[str, int], bool]] = WeakKeyDictionary()

    def are_swapped(self, name: str, entity: Entity, *, is_past: bool = False) -> bool:
        """Checks whether a relation of each row, and of an entity, has its arguments swapped.

        Nothing in the world carries the entity, which is immovable. It may be above or below
        something at other times: there, something has to be the other way round now.
        """
        is_placed = name in _PLACED
        if can_move(entity) or isinstance(entity.world, BatchWorld) or (is_past and is_placed):
            return False
        verdicts = self._verdicts.setdefault(entity.world, {})
        key = name, entity.id
        if key not in verdicts:
            has_row = self._finds(_of_rows(name, entity, is_first=False))
            is_meant = has_row is not False
            if (
                not is_meant
                and is_placed
                and not self._finds(_of_rows(name, entity, is_first=True))
            ):
                return False
            if has_row is not None:
                verdicts[key] = not is_meant
            return not is_meant
        return verdicts[key]


def _of_rows(name: str, entity: Entity, *, is_first: bool) -> Query:
    """Returns the query for a row for which a relation with an entity holds."""
    span = SourceSpan(0, 0)
    world = Name(span, entity.world.name)
    arguments = This(span, None), Index(span, world, (Literal(span, entity.name),))
    call = Call(span, name, arguments[::-1] if is_first else arguments, span)
    source = Source(span, entity.world.name, world)
    limit, form = Literal(span, 1), AdapterClause(span, "list")
    return Query(span, arguments[:1], (source,), where=call, limit=limit, adapter=form)
