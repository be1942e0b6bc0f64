"""Finds relations that are valid where they stand, but read as something else."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from functools import partial
from typing import Any

import numpy as np

from ssduck import validation
from ssduck.errors import ArgumentError, SelectScriptError, SourceSpan
from ssduck.formatting import name_path
from ssduck.interpreter.lint.scope import Check, Scope, entity_of, worlds_of
from ssduck.interpreter.lint.suspect_values import VECTORS, Sources, is_comparison, sources_in
from ssduck.language import ast
from ssduck.language.analysis import OVER_TIME, TEMPORAL_OPERATORS
from ssduck.recording.replay.past import Past
from ssduck.sql.relations.registry import RELATIONS
from ssduck.sql.user_sql import RelationOfRows
from ssduck.world.batches.batch_world import BatchWorld
from ssduck.world.entities import Entity
from ssduck.world.handles import Handle

# What to write in place of a number that holds of nearly everything as a condition.
_AS_CONDITION = {
    "inside": "it is the share of b inside of a, a number from 0 to 1: write contains(a, b) for "
    "nearly all of b, or inside(a, b) > 0.5; a is the container, b is what is in it",
    **{
        name: f"it is a number: write {name}(…) < 0.1, say"
        for name, relation in RELATIONS.items()
        if relation.result == "double" and relation.unit in ("m", "rad") and name != "penetration"
    },
    "clearance": "it is a number: write near(a, b, 0.1), or clearance(a, b) < 0.1",
}
# The functions over time whose value is a list of two.
_EXTREMES = frozenset(("least", "greatest"))
_OF_EXTREMES = "{0}(…) is [time, value], and {1} is of such lists here: the value is {0}(…)[1]"
# The calls of conditions, with the number of these.
_OF_CONDITIONS = TEMPORAL_OPERATORS | dict.fromkeys(
    ("since", "heldFor", "holds", "robustness", "scale"), 1
)
_NO_CONDITION = (
    "{0} takes a condition here, and a number always holds: how long a condition has held is "
    "compared, heldFor(condition) >= 0.2"
)
# The relations that hold as conditions whatever the world is like, with what they are.
_NO_CONDITIONS = {
    **dict.fromkeys(("id", "name", "type", "kind"), "a text"),
    **dict.fromkeys(VECTORS, "a list"),
}


def misread_relations(statement: ast.Node) -> Iterator[Check]:
    """Yields the checks of a statement's relations and conditions."""
    for node in statement.walk():
        for part in _conditions(node):
            if isinstance(part, ast.Call) and part.name in _AS_CONDITION:
                told = _AS_CONDITION[part.name]
                message = f"{part.name} as a condition holds of any number but 0; {told}"
                yield partial(_misread, part, message)
            if isinstance(part, ast.Call | ast.Name | ast.QualifiedName | ast.Index):
                yield partial(_always_true, part)
            match node, part:
                case ast.Call(name=name), ast.Literal(value=value) if name in TEMPORAL_OPERATORS:
                    if validation.is_number(value):
                        yield partial(_told, _NO_CONDITION.format(name), part.span)
        if isinstance(node, ast.Binary):
            yield from _extremes_in(node)
            names = [side for side in (node.left, node.right) if isinstance(side, ast.Name)]
            # x != x asks for what is no number.
            if is_comparison(node) and len({name.name for name in names}) == len(names):
                yield from (partial(_not_a_number, name) for name in names)
        if isinstance(node, ast.Call) and node.name in _OF_SHAPES | _OF_BOXES:
            yield partial(_unfit_entities, node)
    for message, span in _same_rows(statement, None):
        yield partial(_told, message, span)
    yield from _row_roles(statement, {}, None)


def _extremes_in(node: ast.Binary) -> Iterator[Check]:
    """Yields the check of a function over time, whose value is a list of two, in arithmetic."""
    sides = node.left, node.right
    for side, other in (sides, sides[::-1]):
        is_number = isinstance(other, ast.Literal) and not isinstance(other.value, str)
        is_number = is_number or node.operator in ("+", "-")
        is_number = is_number and node.operator in ("+", "-", "==", "!=")
        if isinstance(side, ast.Call) and side.name in _EXTREMES and is_number:
            yield partial(_misread, side, _OF_EXTREMES.format(side.name, node.operator))
            return


def _told(message: str, span: SourceSpan, _: Scope) -> Iterator[SelectScriptError]:
    yield ArgumentError(message, span=span)


def _misread(call: ast.Call, message: str, scope: Scope) -> Iterator[SelectScriptError]:
    if call.name in OVER_TIME or scope.is_relation(call.name):
        yield ArgumentError(message, span=call.span)


def _not_a_number(name: ast.Name, scope: Scope) -> Iterator[SelectScriptError]:
    if is_nan(scope.variable(name.name)):
        message = f"{name.name} is NaN, no number: no comparison with it holds but !="
        yield ArgumentError(message, span=name.span)


def is_nan(value: Any) -> bool:
    """Checks whether a value is the number that is none."""
    return isinstance(value, float) and math.isnan(value)


def _always_true(node: ast.Node, scope: Scope) -> Iterator[SelectScriptError]:
    """Yields the mistake of a condition that is an entity, a text or a list with elements."""
    what = ""
    value = scope.variable(node.name) if isinstance(node, ast.Name) else None
    if isinstance(value, Handle):
        what = f"{node.name} is an entity"  # type: ignore[attr-defined]
    elif isinstance(node, ast.Call | ast.Name):
        if value is None and node.name in _NO_CONDITIONS and scope.is_relation(node.name):
            what = f"{node.name} is {_NO_CONDITIONS[node.name]}"
    elif (named := scope.entity(node)) is not None:
        what = f"{name_path(named.world.name, named.name)} is an entity"
    if what:
        advice = "compare it with something, as in z(this) > 1"
        message = f"{what}, which always holds as a condition: {advice}"
        yield ArgumentError(message, span=node.span)


# The relations of two whose answer needs the shapes of both, or a region that one of them is.
_OF_SHAPES = frozenset(
    name
    for name, relation in RELATIONS.items()
    if name == "within" or (relation.geometry is not None and relation.required_count > 1)
)


# The relations that compare a position, or a box, with the axis-aligned box of an entity.
_OF_BOXES = frozenset(("above", "below", "within", "overlaps"))


def _unfit_entities(call: ast.Call, scope: Scope) -> Iterator[SelectScriptError]:
    """Yields an error for each entity in a relation that tells nothing of it."""
    if not scope.is_relation(call.name):
        return
    entities = list(map(scope.entity, call.arguments))
    for i, (part, entity) in enumerate(zip(call.arguments, entities, strict=True)):
        told = "" if entity is None else _without_extent(call, entity, is_first=i == 0)
        if told:
            yield ArgumentError(told, span=part.span)
    match call.name, entities:
        case name, (Entity() as carrier, Entity() as carried, *_) if name in CARRIED:
            if can_move(carrier) and not can_move(carried):
                paths = (name_path(one.world.name, one.name) for one in (carrier, carried))
                yield ArgumentError(_swapped(name, *paths), span=call.span)


def _without_extent(call: ast.Call, entity: Entity, *, is_first: bool) -> str:
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


def _same_rows(node: ast.Node, outer: ast.Query | None) -> Iterator[tuple[str, SourceSpan]]:
    """Yields what is told of `this` beside `b.this`, the same row if b is a query's only source."""
    if isinstance(node, ast.Query) and outer is not None and len(node.sources) == 1:
        alias = node.sources[0].alias
        for call in _calls_of_query(node):
            aliases = {part.alias: part for part in call.arguments if isinstance(part, ast.This)}
            if alias is not None and {alias, None} <= aliases.keys():
                advice = _outer_row(outer, alias)
                message = f"this is {alias}.this here, the row of the nested query; {advice}"
                yield message, aliases[None].span
    inside = node if isinstance(node, ast.Query) else outer
    for child in node.children():
        yield from _same_rows(child, outer if isinstance(child, ast.Source) else inside)


def _calls_of_query(node: ast.Node) -> Iterator[ast.Call]:
    """Yields the calls in the clauses of a query, without those in its source and in others."""
    for child in node.children():
        if not isinstance(child, ast.Query | ast.Source):
            if isinstance(child, ast.Call):
                yield child
            yield from _calls_of_query(child)


def _outer_row(outer: ast.Query, inner: str) -> str:
    """Returns how the row of a query is written in a nested one, whose source is `inner`."""
    source = outer.sources[0]
    variable = source.value.name if isinstance(source.value, ast.Name) else "…"
    if source.alias not in (None, variable, inner):
        return f"the row of the outer query is {source.alias}.this"
    alias = "a" if inner != "a" else "b"
    return f"name the outer source, FROM {alias}={variable}, and write {alias}.this"


def _conditions(node: ast.Node) -> tuple[ast.Node, ...]:
    match node:
        case ast.Query(where=where, having=having, recursion=recursion):
            stop = None if recursion is None else recursion.stop
            return tuple(part for part in (where, having, stop) if part is not None)
        case ast.Unary(operator="NOT", operand=operand):
            return (operand,)
        case ast.Binary(operator="AND" | "OR" | "XOR", left=left, right=right):
            return left, right
        case ast.OperatorChain(operators=("AND" | "OR" | "XOR", *_), operands=operands):
            return tuple(operands)
        case ast.If(condition=condition) | ast.Branch(condition=condition):
            return (condition,)
        case ast.Call(name=name, arguments=arguments) if name in _OF_CONDITIONS:
            return arguments[: _OF_CONDITIONS[name]]
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


def _row_roles(node: ast.Node, sources: Sources, where: ast.Node | None) -> Iterator[Check]:
    """Yields the checks of such relations of each row of a query, whose roles may be swapped."""
    inside = sources
    if isinstance(node, ast.Query):
        where, inside = node.where, sources_in(node, sources)
    match node:
        case ast.Call(name=name, arguments=(ast.This() as row, other, *_)) if name in _ASKED:
            source = inside[row.alias].value if row.alias in inside else None
            value = _named_by(other, where) if isinstance(other, ast.This) else other
            if isinstance(source, ast.Name | ast.TimeIndex) and value is not None:
                yield partial(_swapped_roles, node, source, value)
    for child in node.children():
        yield from _row_roles(child, sources if isinstance(child, ast.Source) else inside, where)


def _swapped_roles(
    call: ast.Call, source: ast.Name | ast.TimeIndex, value: ast.Node, scope: Scope
) -> Iterator[SelectScriptError]:
    """Yields the mistake of a relation of each row of a source and an entity that is swapped.

    Args:
        call: the call, of the row and the entity, or of another row that a condition takes for it.
        source: the source of the rows.
        value: the entity, or its name.
        scope: the variables; it warns of what is less sure.
    """
    row, other = call.arguments[:2]
    worlds = worlds_of(rows := scope.variable(source.name))
    if isinstance(rows, list) and isinstance(rows[0] if rows else None, Entity):
        worlds = [rows[0].world]
    named = value.value if isinstance(value, ast.Literal) else None
    for world in worlds:
        entity = scope.entity(value) if named is None else entity_of(world, named)
        if entity is None or entity.world is not world:
            continue
        is_past = isinstance(source, ast.TimeIndex) or isinstance(rows, Past)
        is_known = scope.variable(world.name) is world and scope.is_relation(call.name)
        if is_known and _are_swapped(call.name, entity, scope, is_past=is_past):
            path = name_path(world.name, entity.name)
            carried = (_written(other), path) if isinstance(other, ast.This) else (path,)
            error = ArgumentError(_swapped(call.name, _written(row), *carried), span=call.span)
            yield from _sure(call.name, error, scope)


def swapped_rows(
    relations: Iterable[RelationOfRows], entity: Entity, scope: Scope
) -> Iterator[SelectScriptError]:
    """Yields an error for each relation in raw SQL of rows and an entity that is swapped."""
    for call in relations:
        name = next((known for known in _ASKED if known.lower() == call.name.lower()), "")
        if name and _are_swapped(name, entity, scope, is_past=call.is_past):
            path = name_path(entity.world.name, entity.name)
            error = ArgumentError(_swapped(call.name, *call.rows, path), span=call.span)
            yield from _sure(name, error, scope)


def _sure(name: str, error: SelectScriptError, scope: Scope) -> Iterator[SelectScriptError]:
    """Yields the error of a relation if it is one for sure, and else warns of it."""
    if name in CARRIED:
        yield error
    else:
        scope.warn(error)


def _written(row: ast.Node) -> str:
    alias = row.alias if isinstance(row, ast.This) else None
    return "this" if alias is None else f"{alias}.this"


def _named_by(row: ast.This, where: ast.Node | None) -> ast.Node | None:
    """Returns the entity, or its name, that a condition takes for a row; None if it takes none."""
    for part in ast.conjuncts(where):
        match part:
            case ast.Binary(operator="==", left=left, right=right):
                for side, other in ((left, right), (right, left)):
                    match side:
                        case ast.This(alias=alias) if alias == row.alias:
                            return other
                        case (
                            ast.QualifiedName(alias=alias, key=name)
                            | ast.Call(name=name, arguments=(ast.This(alias=alias),))
                        ) if alias == row.alias and name in _NAMES:
                            return other
    return None


def can_move(entity: Entity) -> bool:
    """Checks whether the simulation can move any part of an entity."""
    body = entity.info.body
    return body is None or body.movable


def _swapped(name: str, carrier: str, carried: str, entity: str = "") -> str:
    asks = next(asks for known, asks in _ASKED.items() if known.lower() == name.lower())
    which = f"which is {entity}, immovable" if entity else "which is immovable"
    return (
        f"{name}({carrier}, {carried}) asks whether {carried}, {which}, {asks} {carrier}: "
        f"write {name}({carried}, {carrier}) to ask whether {carrier} {asks} {carried}"
    )


def _are_swapped(name: str, entity: Entity, scope: Scope, *, is_past: bool) -> bool:
    """Checks whether a relation of each row, and of an entity, has its arguments swapped.

    Nothing in the world carries the entity, which is immovable. It may be above or below something
    at other times: there, something has to be the other way round now.
    """
    is_placed = name in _PLACED
    if can_move(entity) or isinstance(entity.world, BatchWorld) or (is_past and is_placed):
        return False
    verdicts = scope.verdicts.setdefault(entity.world, {})
    key = name, entity.id
    if key in verdicts:
        return verdicts[key]
    has_row = scope.finds(_of_rows(name, entity, is_first=False))
    is_meant = has_row is not False
    if not is_meant and is_placed and not scope.finds(_of_rows(name, entity, is_first=True)):
        return False
    if has_row is not None:
        verdicts[key] = not is_meant
    return not is_meant


def _of_rows(name: str, entity: Entity, *, is_first: bool) -> ast.Query:
    """Returns the query for a row for which a relation with an entity holds."""
    span = SourceSpan(0, 0)
    world = ast.Name(span, entity.world.name)
    arguments = ast.This(span, None), ast.Index(span, world, (ast.Literal(span, entity.name),))
    call = ast.Call(span, name, arguments[::-1] if is_first else arguments, span)
    source = ast.Source(span, entity.world.name, world)
    limit, form = ast.Literal(span, 1), ast.AdapterClause(span, "list")
    return ast.Query(span, arguments[:1], (source,), where=call, limit=limit, adapter=form)
