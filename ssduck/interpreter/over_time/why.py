"""Finds why a condition holds or not, at the present tick or at the ticks that decide it.

Of a nested query it is the row that holds best, or comes nearest, that tells why.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from itertools import zip_longest
from typing import Any

import numpy as np

from ssduck.adapters.display import on_one_line
from ssduck.errors import ArgumentError, LimitError, SelectScriptError
from ssduck.geometry.arrays import Array
from ssduck.geometry.narrow_phase import PRECISION
from ssduck.interpreter.over_time.functions import TemporalFunction, expressions_of, operator_of
from ssduck.interpreter.over_time.nested import NestedExpressions, Ticks, window_of
from ssduck.language import ast
from ssduck.language.aggregates import over_rows
from ssduck.language.analysis import aliases_of
from ssduck.language.builtins import MARGIN_OF_TRUTH, UNIT_OF_SCALE
from ssduck.language.evaluator import Frame
from ssduck.logic.why import Move, Why
from ssduck.recording.replay.record import Record
from ssduck.schema import MARGINS
from ssduck.sql.name_resolution import ResolvedQuery
from ssduck.sql.relations.registry import RELATIONS
from ssduck.world.handles import Handle, RecordedTick

_COMPARISONS = ("<", "<=", ">", ">=", "==", "!=")
_AXES = {"x": 0, "y": 1, "z": 2}
# What a distance at a limit is, whose sign is negative where shapes are in each other.
_SIGNS = {
    "near": 1.0,
    "touching": 1.0,
    "clearance": 1.0,
    "distance": 1.0,
    "collides": -1.0,
    "penetration": -1.0,
}
# Those for which the points between which the distance is least tell more.
_OF_SHAPES = _SIGNS.keys() - {"distance"}


@dataclass(frozen=True)
class Explainer:
    """Explains the conditions of a program."""

    text: str  # the text of the program
    frame: Frame
    nested: NestedExpressions
    record_of: Callable[[ast.Call, Frame], Record]  # returns the record that an operator reads
    # Resolves the names in a query.
    resolved: Callable[[ast.Query, Frame], tuple[ResolvedQuery, Any]]
    # Puts expressions in place of `lifted`, `scale` and other functions that stand for them.
    expanded: Callable[[ast.Node], ast.Node]
    ticks: Ticks | None = None  # the recorded ticks; None for the present one
    place: int = 0  # the place of a tick among them

    def why(self, node: ast.Node) -> Why:
        """Returns why a condition has its value."""
        match node:
            case ast.Call() if (form := operator_of(node)) is not None:
                return self._of_operator(node, form)
            case ast.Unary(operator="NOT", operand=operand):
                return self._of_parts(node, (operand,))
            case (
                ast.Binary(operator="AND" | "OR" as sign)
                | ast.OperatorChain(operators=("AND" | "OR" as sign, *_))
            ):
                return self._of_parts(node, tuple(ast.joined(node, sign, math.inf)))
            case ast.Call(name="scale", arguments=(condition, unit)):
                self._value(
                    ast.Call(unit.span, UNIT_OF_SCALE, (unit,), unit.span)
                )  # may be an error
                return self._of_parts(node, (condition,))
            case ast.Binary(operator="IN", left=member, right=ast.Query() as query):
                return self._of_rows(node, query, member)
            case ast.Binary(
                operator="!=", left=ast.ListLiteral(items=()), right=ast.Query() as query
            ):
                return self._of_rows(node, query, None)  # EXISTS
            case ast.Query():
                unfit = _unfit(node, is_member=False) or ("" if node.where else "no WHERE")
                if unfit:
                    raise ArgumentError(
                        "WHY takes a condition, such as WHY on(table, cup); or a SELECT of at most "
                        f"two sources, with WHERE and without groups; this one has {unfit}",
                        span=node.span,
                    )
                rows = replace(node, adapter=ast.AdapterClause(node.span, "list"))
                return self._of_rows(rows, node, None)
        return self._of_leaf(node)

    def _of_parts(self, node: ast.Node, parts: tuple[ast.Node, ...]) -> Why:
        return self._made(node, parts=tuple(map(self.why, parts)))

    def _made(self, node: ast.Node, parts: tuple[Why, ...] = ()) -> Why:
        """Returns a condition with its value and its margin."""
        value = self._value(node)
        margin = self._margin(node)
        return Why(
            self._written(node),
            None if value is None else bool(value),
            margin,
            self._time,
            parts=parts,
        )

    @property
    def _time(self) -> float | None:
        """The time of the tick, s; None at present."""
        if self.ticks is not None:
            return float(self.ticks.times[self.place])
        rows = (row for row in self.frame.own_elements() if isinstance(row, Handle))
        return next((row.state.time for row in rows if row.moment is not None), None)

    def _written(self, node: ast.Node) -> str:
        """Returns the text of a part; that of the condition of IMPLIES has no NOT."""
        match node:
            case ast.Unary(operand=operand) if node.span == operand.span:
                text = self._written(operand)
                is_joined = isinstance(operand, ast.Binary) and operand.operator in ("AND", "OR")
                return f"NOT ({text})" if is_joined else f"NOT {text}"
            case ast.Binary(operator=sign, left=left, right=right) if self._is_rewritten(node):
                text = self._written(right)
                text = f"({text})" if isinstance(right, ast.Query) else text
                return f"{self._written(left)} {sign} {text}"
        return " ".join(self.text[node.span.start : node.span.end].split())

    def _is_rewritten(self, node: ast.Binary) -> bool:
        """Checks whether the text of a part is that of what is made of it: by NOT IN or BETWEEN."""
        between = self.text[node.left.span.end : node.right.span.start].upper().split()
        is_between = node.operator == "AND" and node.span == node.left.span
        return is_between or "NOT" in between or "BETWEEN" in between

    def _value(self, node: ast.Node) -> Any:
        """Returns the value of a part; None if it is unknown."""
        node = self.expanded(node)
        if self.ticks is None:
            return self.frame.value(node)
        column = self.ticks.column(node)
        (value,) = column.values[self.place : self.place + 1].tolist()
        return None if column.unknown[self.place] else value

    def _margin(self, condition: ast.Node) -> float | None:
        try:
            expression = self._margin_of(condition)
            margin: Any = None if _is_of_truth(expression) else self._value(expression)
        except LimitError:
            raise
        except SelectScriptError:  # it compares no numbers
            return None
        is_number = isinstance(margin, int | float) and math.isfinite(margin)
        return float(margin) if is_number else None

    def _margin_of(self, condition: ast.Node) -> ast.Node:
        """Returns the margin of a condition; an error if that has a value in place of one."""
        span = condition.span
        return self.expanded(ast.Call(span, "robustness", (condition,), span))

    # -- operators of time --------------------------------------------------------------------

    def _of_operator(self, call: ast.Call, form: TemporalFunction) -> Why:
        """Returns why an operator has its value: by its conditions at the ticks that decide it."""
        window = window_of(call, self.frame)
        ticks, place = self.ticks, self.place
        if ticks is None:
            ticks = self.nested.ticks(call, self.record_of(call, self.frame), self.frame)
            place = ticks.place_of(call, self.frame)
        if form.looks_ahead:
            ends = window.ahead(ticks.times, is_open=False)
        else:
            ends = window.back(ticks.times)
        first, last = (int(end[place]) for end in ends)
        conditions = expressions_of(call)
        # The last condition decides where it is best, or worst for those that take the least.
        decisive = self._extreme(ticks, conditions[-1], first, last, takes_least=form.takes_least)
        parts = []
        if len(conditions) == 2 and decisive is not None:
            start, end = (place, decisive - 1) if form.looks_ahead else (decisive + 1, place)
            other = self._extreme(ticks, conditions[0], start, end, takes_least=True)
            parts += [] if other is None else [self._at(ticks, other).why(conditions[0])]
        if decisive is not None:
            parts.append(self._at(ticks, decisive).why(conditions[-1]))
        whole = self._made(call, parts=tuple(parts))
        if whole.value is None or ticks.is_decided(self.expanded(call), place):
            return whole
        return replace(whole, complete=False, detail="so far: the record ends before it is decided")

    def _at(self, ticks: Ticks, place: int) -> Explainer:
        return replace(self, ticks=ticks, place=place)

    def _extreme(
        self, ticks: Ticks, condition: ast.Node, first: int, last: int, *, takes_least: bool
    ) -> int | None:
        """Returns the first of ticks from one to another with the extreme margin; None of none."""
        if last < first:
            return None
        trace = ticks.trace(self.expanded(condition))
        truth = np.where(trace.low[first : last + 1], 1.0, -1.0)
        try:
            margins = ticks.column(self._margin_of(condition))
            numbers = np.where(margins.unknown, np.nan, margins.values)[first : last + 1]
            numbers = numbers.astype(float)
            values = np.where(np.isfinite(numbers), numbers, truth * np.inf)
        except SelectScriptError:  # it compares no numbers
            values = truth
        return first + int(np.argmin(values) if takes_least else np.argmax(values))

    # -- nested queries -------------------------------------------------------------------------

    def _of_rows(self, node: ast.Node, query: ast.Query, member: ast.Node | None) -> Why:
        """Returns why a query has rows or a member: by the row that holds best or comes nearest."""
        whole = self._made(node)
        if unfit := _unfit(query, is_member=member is not None):
            return replace(whole, detail=f"WHY tells no more, as the SELECT has {unfit}")
        resolved, _ = self.resolved(query, self.frame)
        row = self._nearest_row(resolved, member, holds=whole.value is True)
        if row is None:
            is_lacking = "" if member is None else f" is {on_one_line(self._value(member))}"
            return replace(whole, detail=f"no row of FROM{is_lacking}")
        only = row.frame.elements.get(None)
        elements = row.frame.elements.items() if only is None else [("this", only)]
        names = [f"{alias} is {on_one_line(element)}" for alias, element in elements]
        if resolved.query.where is None:
            return replace(whole, detail="; ".join(names))
        part = row.why(resolved.query.where)
        details = [*names, *filter(None, [part.detail])]
        return replace(whole, parts=(replace(part, detail="; ".join(details)),))

    def _nearest_row(
        self, resolved: ResolvedQuery, member: ast.Node | None, *, holds: bool
    ) -> Explainer | None:
        """Returns what explains in the row that holds best, or comes nearest; None of no rows.

        Of rows that fail, these are the ones with the fewest failing conditions without a margin,
        and among them the one whose least margin is largest. Only rows with the member count, if
        there is one.
        """
        query, frame = resolved.query, self.frame
        span, names = query.span, aliases_of(query)
        wanted: list[ast.Node] = []
        if member is not None:
            members = {**frame.placeholders, "member": self._value(member)}
            frame = replace(frame, placeholders=members)
            one = ast.ListLiteral(span, (ast.Placeholder(span, "member"),))
            wanted.append(ast.Binary(span, "IN", resolved.columns[0].node, one))
        elements = [ast.This(span, name if len(names) > 1 else None) for name in names]
        conditions = list(ast.conjuncts(query.where))

        def rows(*parts: ast.Node, kept: Sequence[ast.Node] = ()) -> list[list[Any]]:
            values = enumerate([*elements, *parts])
            items = [
                ast.Call(span, "to", (item, ast.Literal(span, str(n))), span) for n, item in values
            ]
            filters = [*wanted, *kept]
            where = reduce(partial(ast.Binary, span, "AND"), filters) if filters else None
            plain = ast.Query(span, tuple(items), query.sources, where)
            return [list(row.values()) for row in frame.value(self.expanded(plain))]

        try:
            margins = list(map(self._margin_of, conditions))
            # One row in which these hold is nearer than all in which one does not; distances
            # between the others need not be known.
            sure = [
                part
                for part, m in zip(conditions, margins, strict=True)
                if holds or _is_of_truth(m)
            ]
            parts = [*conditions, *margins]
            found = (sure and rows(*parts, kept=sure)) or rows(*parts)
        except LimitError:
            raise
        except SelectScriptError:  # one compares no numbers, or is wrong where another fails
            conditions = [query.where] if query.where else []
            found = rows(*conditions)
        if not found:
            return None
        first, count = len(names), len(conditions)
        nearest = max(
            found, key=lambda row: _nearness(row[first : first + count], row[first + count :])
        )
        elements_of_row: dict[str | None, Any] = {
            a: e for a, e in self.frame.elements.items() if a is not None
        }
        elements_of_row.update(zip(names, nearest, strict=False))
        if first == 1:
            elements_of_row[None] = nearest[0]
        return replace(self, frame=self.frame.row(elements_of_row, {}))

    # -- comparisons and relations --------------------------------------------------------------

    def _of_leaf(self, node: ast.Node) -> Why:
        whole = replace(self._made(node), entities=tuple(self._entities(node)))
        match node:
            case ast.Binary(operator=sign, left=left, right=right) if sign in _COMPARISONS:
                sides = [side for side in (left, right) if not _is_number(side)]
                told = (f"{self._written(s)} is {on_one_line(self._value(s))}" for s in sides)
                return self._with_move(replace(whole, detail="; ".join(told)), node)
            case ast.Call(name="lifted", arguments=(entity, _)):
                return self._of_rise(whole, node, entity)
            case ast.Call(name=name, arguments=(ast.Node() as a, ast.Node() as b, *_)) if (
                name in _OF_SHAPES
            ):
                points, move = self._points(a, b), self._move_of_relation(node)
                return replace(whole, points=points, move=move)
        return whole

    def _of_rise(self, whole: Why, lifted: ast.Call, place: ast.Node) -> Why:
        """Returns `lifted` with how far an entity has risen, and how much higher it would hold."""
        comparison, entity = self.expanded(lifted), self._entity(place)
        assert isinstance(comparison, ast.Binary)
        rise, height = self._value(comparison.left), self._value(comparison.right)
        detail = f"{self._written(place)} has risen by {on_one_line(rise)} m"
        return self._along(replace(whole, detail=detail), entity, 2, rise, height)

    def _entities(self, node: ast.Node) -> dict[str, None]:
        """Returns the full names of the entities that a part without nested queries names."""
        names: dict[str, None] = {}
        if isinstance(node, ast.Name | ast.Index | ast.This):
            value = self.frame.value(node)
            return {value.full_name: None} if isinstance(value, Handle) else {}
        for part in () if isinstance(node, ast.Query) else self._called(node).children():
            names |= self._entities(part)
        return names

    def _points(self, a: ast.Node, b: ast.Node) -> tuple[tuple[float, ...], ...]:
        """Returns the nearest points of two entities at the tick; none if they have no shapes."""
        call = ast.Call(a.span, "nearestPoints", (a, b), a.span)
        if self.ticks is not None:  # only at that tick
            time = ast.Literal(a.span, float(self.ticks.times[self.place]))
            call = ast.Call(a.span, "at", (time, call), a.span)
        return tuple(map(tuple, self.frame.value(call) or ()))

    def _with_move(self, whole: Why, node: ast.Binary) -> Why:
        """Returns a comparison of a coordinate or a distance with the move that flips it."""
        match self._called(node.left), self._called(node.right):
            case (ast.Call() as call, number) if _is_constant(number):
                at_zero = (">", "<=")
            case (number, ast.Call() as call) if _is_constant(number):
                at_zero = ("<", ">=")
            case _:
                return whole
        limit = self.frame.value(number)
        if node.operator in ("==", "!=") or not isinstance(limit, int | float):
            return whole
        if call.name not in _AXES:  # no distance is less than 0
            is_free = limit or node.operator in at_zero
            move = self._move_to(call, limit) if is_free else None
            if move is None:
                return whole
            return replace(whole, move=move, points=self._points(*call.arguments[:2]))
        entity = self._entity(call.arguments[0])
        return self._along(whole, entity, _AXES[call.name], self._value(call), limit)

    def _along(
        self, whole: Why, entity: Handle | None, number: int, place: float | None, limit: float
    ) -> Why:
        """Returns a condition with the move of an entity along an axis from a place to a limit."""
        if place is None or entity is None:
            return whole
        axis, way = np.eye(3)[number], limit - place
        start = np.array(entity.position)
        points = (tuple(start.tolist()), tuple((start + axis * way).tolist()))
        return replace(whole, points=points, move=_move(entity, axis * _beyond(way)))

    def _move_of_relation(self, call: ast.Call) -> Move | None:
        """Returns the translation that flips a relation of the distance of two entities."""
        if len(call.arguments) > 2:
            return self._move_to(call, self._value(call.arguments[2]))
        defaults = [parameter.default for parameter in RELATIONS[call.name].parameters[2:]]
        return self._move_to(call, float(defaults[0])) if defaults else None

    def _move_to(self, call: ast.Call, limit: float) -> Move | None:
        """Returns the translation of the second of two entities just beyond a limit, m."""
        sign = _SIGNS.get(call.name)
        if sign is None or not limit >= 0.0:  # below it, none of them changes
            return None
        a, b = map(self._entity, call.arguments[:2])
        if a is None or b is None or a.id == b.id:
            return None
        if call.name == "distance":
            between = np.array(b.position) - np.array(a.position)
            length = float(np.linalg.norm(between))
            return _move(b, between / length * _beyond(limit - length)) if length else None
        with b.state.pinned(("shapes", MARGINS)):
            shapes = b.state.snapshot.shapes_and_sites().of((a.id, b.id))
        has_margins = call.name == "touching"
        return _move(b, shapes.way_to(a.id, b.id, sign * limit, has_margins=has_margins))

    def _entity(self, node: ast.Node) -> Handle | None:
        """Returns an entity at the tick; None for another value."""
        value = self.frame.value(node)
        if not isinstance(value, Handle):
            return None
        if self.ticks is None:
            return value
        tick = int(self.ticks.numbers[self.place])
        return value.pinned(RecordedTick(self.ticks.record, tick))

    def _called(self, node: ast.Node) -> ast.Node:
        """Returns a column of a source's entity, `a.z`, as the call that it is."""
        if isinstance(node, ast.QualifiedName) and node.alias in self.frame.elements:
            return node.call(node.key)
        return node


def _move(entity: Handle | None, way: Array | None) -> Move | None:
    """Returns the translation of an entity; None if there is none."""
    if entity is None or way is None:
        return None
    x, y, z = (way + 0.0).tolist()  # no -0.0
    return Move(entity.name, (x, y, z))


def _unfit(query: ast.Query, *, is_member: bool) -> str:
    """Returns what a query has for which no row tells why; empty if it has nothing of that."""
    if query.group or query.having is not None or any(map(over_rows, query.items)):
        return "groups or aggregates"
    if query.recursion is not None:
        return "CONNECT BY"
    if query.offset is not None or (is_member and query.limit is not None):
        return "LIMIT or OFFSET"
    if is_member and (query.adapter is None or query.adapter.name != "list"):
        return "dicts as rows: write AS list"
    return "more than two sources" if len(query.sources) > 2 else ""


def _nearness(values: list[Any], margins: list[float | None]) -> tuple[bool, int, float]:
    """Returns a key that is greater for a row that holds, or comes nearer to that.

    Args:
        values: the value of each condition of the row.
        margins: their margins; none if one of them has an error.
    """
    numbers = [
        margin
        if margin is not None and math.isfinite(margin) and (value or margin <= 0.0)
        else math.copysign(math.inf, 1 if value else -1)
        for value, margin in zip_longest(values, margins)
    ]
    least = min(filter(math.isfinite, numbers), default=math.inf)
    return all(values), -numbers.count(-math.inf), least


def _is_of_truth(margin: ast.Node) -> bool:
    """Checks whether a margin is no number: more or less than any."""
    while isinstance(margin, ast.Unary):
        margin = margin.operand
    return isinstance(margin, ast.Call) and margin.name == MARGIN_OF_TRUTH


def _beyond(way: float) -> float:
    """Returns a way that ends just beyond where it would end."""
    return way + math.copysign(PRECISION, way)


def _is_constant(node: ast.Node) -> bool:
    return _is_number(node) or isinstance(node, ast.Name)


def _is_number(node: ast.Node) -> bool:
    return isinstance(node.operand if isinstance(node, ast.Unary) else node, ast.Literal)
