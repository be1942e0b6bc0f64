"""Finds why a condition holds or not, at the present tick or at the ticks that decide it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ssduck.errors import LimitError, SelectScriptError
from ssduck.interpreter.over_time.functions import TemporalFunction, expressions_of, operator_of
from ssduck.interpreter.over_time.nested import NestedExpressions, Ticks, window_of
from ssduck.language.evaluator import Frame
from ssduck.language.tree import Binary, Call, Literal, Node, OperatorChain, Unary
from ssduck.logic.margins import margin_of
from ssduck.logic.why import Move, Why
from ssduck.recording.replay.record import Record
from ssduck.world.handles import Handle

_COMPARISONS = ("<", "<=", ">", ">=", "==", "!=")
_AXES = {"x": 0, "y": 1, "z": 2}
# Relations of two entities for which the points between which the distance is least tell more.
_DISTANCES = ("near", "touching", "clearance", "collides", "penetration")


@dataclass(frozen=True)
class Explainer:
    """Explains the conditions of a program."""

    text: str  # the text of the program
    frame: Frame
    nested: NestedExpressions
    record_of: Callable[[Call], Record]  # returns the record that an operator reads
    ticks: Ticks | None = None  # the recorded ticks; None for the present one
    place: int = 0  # the place of a tick among them

    def why(self, node: Node) -> Why:
        """Returns why a condition has its value."""
        match node:
            case Call() if (form := operator_of(node)) is not None:
                return self._of_operator(node, form)
            case Unary(operator="NOT", operand=operand):
                return self._of_parts(node, (operand,))
            case Binary(operator="AND" | "OR", left=left, right=right):
                return self._of_parts(node, (left, right))
            case OperatorChain(operators=("AND" | "OR", *_), operands=operands):
                return self._of_parts(node, operands)
        return self._of_leaf(node)

    def _of_parts(self, node: Node, parts: tuple[Node, ...]) -> Why:
        return self._made(node, parts=tuple(map(self.why, parts)))

    def _made(self, node: Node, parts: tuple[Why, ...] = ()) -> Why:
        """Returns a condition with its value and its margin."""
        value = self._value(node)
        margin = self._margin(node)
        return Why(
            self._written(node),
            None if value is None else bool(value),
            margin,
            None if self.ticks is None else float(self.ticks.times[self.place]),
            parts=parts,
        )

    def _written(self, node: Node) -> str:
        """Returns the text of a part; that of the condition of IMPLIES has no NOT."""
        text = " ".join(self.text[node.span.start : node.span.end].split())
        is_denied = isinstance(node, Unary) and node.span == node.operand.span
        return f"NOT {text}" if is_denied else text

    def _value(self, node: Node) -> Any:
        """Returns the value of a part; None if it is unknown."""
        if self.ticks is None:
            return self.frame.value(node)
        column = self.ticks.column(node)
        (value,) = column.values[self.place : self.place + 1].tolist()
        return None if column.unknown[self.place] else value

    def _margin(self, condition: Node) -> float | None:
        try:
            margin = self._value(margin_of(condition))
        except LimitError:
            raise
        except SelectScriptError:  # it compares no numbers
            return None
        is_number = isinstance(margin, int | float) and math.isfinite(margin)
        return float(margin) if is_number else None

    # -- operators of time --------------------------------------------------------------------

    def _of_operator(self, call: Call, form: TemporalFunction) -> Why:
        """Returns why an operator has its value: by its conditions at the ticks that decide it."""
        window = window_of(call, self.frame)
        ticks, place = self.ticks, self.place
        if ticks is None:
            ticks = self.nested.ticks(call, self.record_of(call), self.frame)
            place = 0 if form.looks_ahead else len(ticks.times) - 1
        if form.looks_ahead:
            ends = window.ahead(ticks.times, is_open=False)
        else:
            ends = window.back(ticks.times)
        first, last = (int(end[place]) for end in ends)
        conditions = expressions_of(call)
        # The last condition decides where it is best, or worst for those that take the least.
        decisive = _extreme(ticks, conditions[-1], first, last, takes_least=form.takes_least)
        parts = []
        if len(conditions) == 2 and decisive is not None:
            start, end = (place, decisive - 1) if form.looks_ahead else (decisive + 1, place)
            other = _extreme(ticks, conditions[0], start, end, takes_least=True)
            parts += [] if other is None else [self._at(ticks, other).why(conditions[0])]
        if decisive is not None:
            parts.append(self._at(ticks, decisive).why(conditions[-1]))
        return self._made(call, parts=tuple(parts))

    def _at(self, ticks: Ticks, place: int) -> Explainer:
        return Explainer(self.text, self.frame, self.nested, self.record_of, ticks, place)

    # -- comparisons and relations --------------------------------------------------------------

    def _of_leaf(self, node: Node) -> Why:
        whole = self._made(node)
        match node:
            case Binary(operator=sign, left=left, right=right) if sign in _COMPARISONS:
                sides = [side for side in (left, right) if not _is_number(side)]
                told = (f"{self._written(side)} is {_shown(self._value(side))}" for side in sides)
                move = self._move_of_comparison(node, whole.margin)
                return replace(whole, detail="; ".join(told), move=move)
            case Call(name=name, arguments=(Node() as a, Node() as b, *_)) if name in _DISTANCES:
                points = self._points(a, b)
                return replace(whole, points=points, move=self._move_between(whole, b, points))
        return whole

    def _points(self, a: Node, b: Node) -> tuple[tuple[float, ...], ...]:
        """Returns the nearest points of two entities; none if they have no shapes."""
        points = Call(a.span, "nearestPoints", (a, b), a.span)
        if self.ticks is not None:  # only at that tick
            time = Literal(a.span, float(self.ticks.times[self.place]))
            points = Call(a.span, "at", (time, points), a.span)
        found = self.frame.value(points)
        return () if found is None else tuple(map(tuple, found))

    def _move_between(
        self, whole: Why, b: Node, points: tuple[tuple[float, ...], ...]
    ) -> Move | None:
        """Returns the translation of an entity along the line of the nearest points."""
        if whole.margin is None or not points:
            return None
        way = np.array(points[1]) - np.array(points[0])
        length = float(np.linalg.norm(way))
        if length == 0.0:
            return None
        return self._move(b, way / length * whole.margin)

    def _move_of_comparison(self, node: Binary, margin: float | None) -> Move | None:
        """Returns the translation that a comparison of a coordinate with a number lacks."""
        match node.left, node.right:
            case Call(name=axis, arguments=(entity,)), number if axis in _AXES:
                sign = -1.0 if node.operator in (">", ">=") else 1.0
            case number, Call(name=axis, arguments=(entity,)) if axis in _AXES:
                sign = 1.0 if node.operator in (">", ">=") else -1.0
            case _:
                return None
        if margin is None or not _is_number(number):
            return None
        return self._move(entity, np.eye(3)[_AXES[axis]] * sign * margin)

    def _move(self, entity: Node, translation: Any) -> Move | None:
        handle = self.frame.value(entity)
        if not isinstance(handle, Handle):
            return None
        x, y, z = (translation + 0.0).tolist()  # no -0.0
        return Move(handle.name, (x, y, z))


def _extreme(
    ticks: Ticks, condition: Node, first: int, last: int, *, takes_least: bool
) -> int | None:
    """Returns the first of the ticks from one to another with the extreme margin; None of none."""
    if last < first:
        return None
    trace = ticks.trace(condition)
    truth = np.where(trace.low[first : last + 1], 1.0, -1.0)
    try:
        margins = ticks.column(margin_of(condition))
        numbers = np.where(margins.unknown, np.nan, margins.values)[first : last + 1].astype(float)
        values = np.where(np.isfinite(numbers), numbers, truth * np.inf)
    except SelectScriptError:  # it compares no numbers
        values = truth
    return first + int(np.argmin(values) if takes_least else np.argmax(values))


def _is_number(node: Node) -> bool:
    return isinstance(node.operand if isinstance(node, Unary) else node, Literal)


def _shown(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
