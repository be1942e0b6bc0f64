"""Finds relations whose arguments are swapped: what carries is asked for as what is carried.

Where both arguments are known, an immovable thing on a movable one tells. Where one is each row of
a query, a row for which the relation holds shows that the question is meant as it stands.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from weakref import WeakKeyDictionary

from ssduck.errors import SourceSpan
from ssduck.language.operator_chains import conjuncts
from ssduck.language.tree import (
    AdapterClause,
    Binary,
    Call,
    Index,
    Literal,
    Name,
    Node,
    QualifiedName,
    Query,
    Source,
    This,
    TimeIndex,
)
from ssduck.world.batches.batch_world import BatchWorld
from ssduck.world.entities import Entity
from ssduck.world.world import World

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
    """Returns what is told of a call whose arguments are swapped.

    Args:
        name: the relation.
        carrier: how the first argument is written.
        carried: how the second one is written, which is immovable.
        entity: the entity that the second one is; "" if it is written so.
    """
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

        Args:
            name: the relation.
            entity: its second argument.
            is_past: whether the rows are those of recorded ticks.
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
