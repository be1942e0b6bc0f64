"""Finds conditions that hold always, or never, whatever the world is like.

The constants that a quantity is compared with cut its range into points and the gaps between them.
In each of these its comparisons have one value. A condition that has the same value in all of them,
whatever other conditions it joins, is a foregone conclusion.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

from ssduck import validation
from ssduck.errors import ArgumentError, SelectScriptError
from ssduck.interpreter.lint.scope import Check, Scope
from ssduck.interpreter.lint.suspect_values import COMPARISONS
from ssduck.interpreter.over_time.functions import operator_of
from ssduck.language import ast
from ssduck.language.analysis import OVER_TIME, is_impure
from ssduck.language.builtins import BUILTINS
from ssduck.language.operators import apply
from ssduck.language.value_keys import node_key
from ssduck.sql.relations.registry import RELATIONS

# The least and the greatest value of functions, of those whose values are angles first.
ANGLES: Mapping[str, tuple[float, float]] = {
    **dict.fromkeys(("tilt", "acos"), (0, math.pi)),
    **dict.fromkeys(("asin", "atan"), (-math.pi / 2, math.pi / 2)),
    "atan2": (-math.pi, math.pi),
}
RANGES: Mapping[str, tuple[float, float]] = {
    **dict.fromkeys(
        ("distance", "clearance", "penetration", "speed", "angularSpeed"), (0, math.inf)
    ),
    **dict.fromkeys(("mass", "volume", "aabbVolume", "heldFor"), (0, math.inf)),
    **dict.fromkeys(("abs", "sqrt", "exp", "norm", "stddev", "count"), (0, math.inf)),
    **dict.fromkeys(("inside", "sensingAmount"), (0, 1)),
    **dict.fromkeys(("sin", "cos", "tanh"), (-1, 1)),
    **ANGLES,
}
# Results are beyond a bound other than 0 by as much, of the bound, at most.
_ROUNDING = 1e-6
# The relations that compare a function of their first arguments with the last one.
_BOUNDED = {"near": ("clearance", 2), "upright": ("tilt", 1)}
_FLIPPED = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}
_JOINING = frozenset(("AND", "OR", "XOR"))
# The functions whose value is the same wherever they are called at a tick.
_PURE = frozenset((*RELATIONS, *BUILTINS, *OVER_TIME, "getTime", "robustness", "scale", "lifted"))
# The range of a quantity of which nothing is known.
_ALL = (-math.inf, math.inf)
# Larger conditions are not looked at.
_MAX_COMPARISONS = 32
_ADVICE = {
    ("AND", False): "; write OR if one of the conditions is enough",
    ("OR", True): "; write AND if all of the conditions are to hold",
}

# Whether a condition holds; None where that is open.
_Truth: TypeAlias = bool | None


@dataclass(frozen=True, eq=False)
class _Comparison:
    """A comparison of a quantity with constants, or another condition, which has none."""

    key: str  # the same for comparisons of one quantity, with numbers or with texts
    sign: str  # the operator; "" of another condition
    constants: tuple[Any, ...]  # several of IN
    quantity: ast.Node
    # What it is compared with where that is no constant: their difference is compared with 0.
    other: ast.Node | None = None

    def truth(self, place: int | None, places: Mapping[Any, int]) -> _Truth:
        """Returns whether it holds for a quantity at a place among constants.

        A condition without constants is at 0 or 1. None is any place.
        """
        if place is None:
            return None
        if not self.sign:
            return bool(place)
        return any(bool(apply(self.sign, place, places[one])) for one in self.constants)


@dataclass(frozen=True)
class Foregone:
    """A condition that always holds, or never."""

    node: ast.Node
    holds: bool
    because: str | tuple[ast.Node, ...]  # the reason, or the quantities of which none changes that

    def told(self, text: str) -> str:
        """Returns what is told of it, of a program's text, for the end of a sentence."""
        holds = f"{'always' if self.holds else 'never'} holds"
        if isinstance(self.because, str):
            return f"{holds}: {self.because}"
        names = list(dict.fromkeys(_named(one, text) for one in self.because))
        told = f"{holds}, whatever {' and '.join(names)} {'is' if len(names) == 1 else 'are'}"
        match self.node:
            case ast.Binary(left=ast.Unary(operator="NOT", operand=operand) as left) if (
                left.span == operand.span  # of IMPLIES
            ):
                return told
            case ast.Binary(operator=sign) | ast.OperatorChain(operators=(sign, *_)):
                return told + _ADVICE.get((sign, self.holds), "")
        return told


def foregone(statement: ast.Node) -> Iterator[Check]:
    """Yields the checks of a statement's conditions that always hold, or never."""
    yield from (partial(_told, one) for one in conclusions(statement))


def _told(one: Foregone, scope: Scope) -> Iterator[SelectScriptError]:
    yield ArgumentError(f"this {one.told(scope.text)}", span=one.node.span)


def beyond(statement: ast.Node, text: str, longest: float) -> Iterator[str]:
    """Yields what is told of conditions that ask, at a step, for more time than an episode has.

    Args:
        statement: the statement, as it is written, of which nothing else is told.
        text: its text.
        longest: the duration of an episode at most, s.
    """
    lasts = f", and an episode lasts {longest:g} s: ask for less, or give it more steps"
    negated = (p for p in statement.walk() if isinstance(p, ast.Unary) and p.operator == "NOT")
    # What is decided when it does not hold: NOT always(c, 0, 10) may hold in an episode of 5 s.
    denied = {id(inner) for part in negated for inner in part.walk()}
    for part in statement.walk():
        if not isinstance(part, ast.Call) or (form := operator_of(part)) is None:
            continue
        window = list(map(_constant, part.arguments[form.conditions :]))
        # Until its window is over, `always` is undecided, and does not hold.
        is_always = form.looks_ahead and form.takes_least
        if is_always and id(part) in denied:
            continue
        if is_always and len(window) < 2:
            told = "what is to come may end it: write historically in place of always"
            yield f"{_written(part, text)} holds at no step, as {told}"
        bounds = window if is_always else window[:1]
        most = longest + _slack(longest)
        far = [bound for bound in bounds if validation.is_number(bound) and bound > most]
        if far:
            word = "never" if form.looks_ahead or not form.takes_least else "always"
            when = "ahead" if form.looks_ahead else "ago"
            told = f"it asks for what is {far[0]:g} s {when}"
            yield f"{_written(part, text)} {word} holds: {told}{lasts}"
    for one in conclusions(statement, longest):
        yield f"{_written(one.node, text)} {one.told(text)}{lasts}"


def conclusions(statement: ast.Node, longest: float = math.inf) -> Iterator[Foregone]:
    """Yields the smallest conditions in a statement that always hold, or never.

    A comparison that always holds is one only where it is a whole condition: BETWEEN 0 AND 1 has
    one of distances.

    Args:
        statement: the statement, as it is written.
        longest: the duration of an episode at most, s.
    """
    for root in _roots(statement):
        if not is_impure(root):
            comparisons = {id(leaf): _comparison(leaf) for leaf in leaves(root)}
            if len(comparisons) <= _MAX_COMPARISONS:
                yield from _Condition(comparisons, longest).smallest(root, is_whole=True)


def _roots(node: ast.Node) -> Iterator[ast.Node]:
    """Yields the conditions in a part of a statement that are no parts of others."""
    if _parts(node) or _is_comparison(node):
        yield node
        inner = [child for leaf in leaves(node) for child in leaf.children()]
    else:
        inner = list(node.children())
    for child in inner:
        yield from _roots(child)


def _parts(node: ast.Node) -> tuple[ast.Node, ...]:
    """Returns the conditions that a condition joins; none of another part."""
    match node:
        case ast.Unary(operator="NOT", operand=operand):
            return (operand,)
        case ast.Binary(operator=sign) | ast.OperatorChain(operators=(sign, *_)) if (
            sign in _JOINING
        ):
            return tuple(ast.joined(node, sign, math.inf))
        case ast.Call(name="scale", arguments=(condition, _)):
            return (condition,)
    return ()


def _is_comparison(node: ast.Node) -> bool:
    is_bounded = isinstance(node, ast.Call) and node.name in _BOUNDED
    return is_bounded or (isinstance(node, ast.Binary) and node.operator in COMPARISONS)


def leaves(node: ast.Node) -> Iterator[ast.Node]:
    """Yields the conditions in a condition that join no others."""
    parts = _parts(node)
    for part in parts:
        yield from leaves(part)
    if not parts:
        yield node


def _comparison(node: ast.Node) -> _Comparison:
    """Returns what a condition that joins no others compares."""
    match node:
        case ast.Call(name=name, arguments=arguments) if name in _BOUNDED:
            function, count = _BOUNDED[name]
            bounds = tuple(map(_constant, arguments[count:]))
            if len(bounds) == 1 and None not in bounds:
                quantity = ast.Call(node.span, function, arguments[:count], node.span)
                return _compared(quantity, "<=", bounds)
        case ast.Binary(operator="IN", left=left, right=ast.ListLiteral(items=items)) if items:
            values = tuple(map(_constant, items))
            if None not in values and len(set(map(_is_text, values))) == 1 and _is_pure(left):
                return _compared(left, "==", values)
        case ast.Binary(operator=sign, left=left, right=right) if sign in COMPARISONS - {"IN"}:
            if _constant(left) is not None:
                left, right, sign = right, left, _FLIPPED.get(sign, sign)
            if _constant(left) is None and _is_pure(left) and _is_pure(right):
                value = _constant(right)
                if value is not None:
                    return _compared(left, sign, (value,))
                if (keys := (node_key(left), node_key(right)))[0] > keys[1]:
                    left, right, sign = right, left, _FLIPPED.get(sign, sign)
                if keys[0] != keys[1]:  # x != x asks for what is no number
                    return _Comparison(str(sorted(keys)), sign, (0,), left, right)
    is_same = _is_pure(node) and not isinstance(node, ast.Literal)
    return _Comparison(node_key(node) if is_same else str(id(node)), "", (), node)


def _compared(quantity: ast.Node, sign: str, constants: tuple[Any, ...]) -> _Comparison:
    kind = "text" if _is_text(constants[0]) else "number"
    return _Comparison(f"{kind} {node_key(quantity)}", sign, constants, quantity)


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _constant(node: ast.Node) -> Any:
    """Returns the number or the text that a part is; None if it is none."""
    match node:
        case ast.Literal(value=value):
            return None if isinstance(value, bool) else value
        case ast.Unary(operator="-", operand=operand):
            value = _constant(operand)
            return -value if validation.is_number(value) else None
        case ast.Binary(operator="+" | "-" | "*" | "/" as sign, left=left, right=right):
            sides = _constant(left), _constant(right)
            if all(map(validation.is_number, sides)):
                with suppress(SelectScriptError):  # a division by zero
                    return apply(sign, *sides)
    return None


def _is_pure(node: ast.Node) -> bool:
    """Checks whether a part has the same value wherever it is at a tick."""
    return not any(
        isinstance(part, ast.Query) or (isinstance(part, ast.Call) and part.name not in _PURE)
        for part in node.walk()
    )


@dataclass(frozen=True)
class _Condition:
    """A condition whose parts are looked at."""

    comparisons: Mapping[int, _Comparison]  # what its leaves compare, by their identity
    longest: float  # the duration of an episode at most, s

    def smallest(self, node: ast.Node, *, is_whole: bool) -> Iterator[Foregone]:
        """Yields the smallest parts that always hold, or never."""
        parts = _parts(node)
        found = [one for part in parts for one in self.smallest(part, is_whole=False)]
        if not found:
            decided = self._decided(node)
            if decided is not None and (parts or is_whole or not decided.holds):
                found = [decided]
        yield from found

    def _decided(self, node: ast.Node) -> Foregone | None:
        """Returns what is told of a condition whose value one of its quantities cannot change."""
        compared: dict[str, list[_Comparison]] = {}
        for leaf in leaves(node):
            comparison = self.comparisons[id(leaf)]
            compared.setdefault(comparison.key, []).append(comparison)
        places = {key: _places(own) for key, own in compared.items()}
        cases = {key: self._cases(own, places[key]) for key, own in compared.items()}
        known = {key: own[0] if len(own) == 1 else None for key, own in cases.items()}
        for key in [key for key, own in cases.items() if len(own) > 1] or list(cases)[:1]:
            values = {self._value(node, known | {key: place}, places) for place in cases[key]}
            if values in ({True}, {False}):
                return Foregone(node, True in values, self._because(compared, key, known))
        return None

    def _cases(
        self, compared: list[_Comparison], places: Mapping[Any, int]
    ) -> list[int] | list[None]:
        """Returns the places of a quantity.

        Of one that is compared once, that is any place, or the only one if all are the same.
        """
        cases = [0, 1]
        if places:
            low, high = self._range(compared[0])
            cases = list(range(2 * len(places) + 1))
            if (low, high) != _ALL:
                ends = [-math.inf, *places, math.inf]
                cases = [place for place in cases if _meets(ends, place, low, high)]
        if len(compared) > 1:
            return cases
        is_open = len({compared[0].truth(place, places) for place in cases}) > 1
        return [None] if is_open else cases[:1]

    def _value(
        self,
        node: ast.Node,
        case: Mapping[str, int | None],
        places: Mapping[str, Mapping[Any, int]],
    ) -> _Truth:
        values = [self._value(part, case, places) for part in _parts(node)]
        match node:
            case _ if not values:
                compared = self.comparisons[id(node)]
                return compared.truth(case[compared.key], places[compared.key])
            case ast.Unary():
                return None if values[0] is None else not values[0]
            case ast.Binary(operator=sign) | ast.OperatorChain(operators=(sign, *_)) if (
                sign != "XOR"
            ):
                is_enough = sign == "OR"
                open_or_not = None if None in values else not is_enough
                return is_enough if is_enough in values else open_or_not
        # XOR, and `scale`, which is its condition.
        return None if None in values else sum(map(bool, values)) % 2 == 1

    def _range(self, compared: _Comparison) -> tuple[float, float]:
        """Returns the least and the greatest value of a quantity."""
        constants, name = compared.constants, _function(compared)
        are_degrees = name in ANGLES and any(abs(value) > math.pi for value in constants)
        if name not in RANGES or are_degrees or not constants or _is_text(constants[0]):
            return _ALL  # of degrees, `angles` tells
        low, high = (0, self.longest) if name == "heldFor" else RANGES[name]
        return low - _slack(low), high + _slack(high)

    def _because(
        self,
        compared: Mapping[str, list[_Comparison]],
        key: str,
        known: Mapping[str, int | None],
    ) -> str | tuple[ast.Node, ...]:
        """Returns the reason: a quantity that is compared more than once, or a range."""
        if len(compared[key]) == 1:
            (one,) = next(own for key, own in compared.items() if known[key] is not None)
            low, high = self._range(one)
            is_finite = math.isfinite(high)
            bounds = f"from {low:.3g} to {high:.3g}" if is_finite else "never negative"
            return f"{_function(one)} is {bounds}"
        sides = (side for one in compared[key] for side in (one.quantity, one.other))
        return tuple(side for side in sides if side is not None)


def _function(compared: _Comparison) -> str:
    """Returns the function whose value is compared; "" of another quantity."""
    is_call = isinstance(compared.quantity, ast.Call) and compared.other is None
    return compared.quantity.name if is_call else ""  # type: ignore[attr-defined]


def _named(node: ast.Node, text: str) -> str:
    if isinstance(node, ast.Call):  # near(a, b, 0.1) is about clearance(a, b)
        return f"{node.name}({', '.join(_named(one, text) for one in node.arguments)})"
    return _written(node, text)


def _written(node: ast.Node, text: str) -> str:
    return " ".join(text[node.span.start : node.span.end].split())


def _slack(bound: float) -> float:
    return abs(bound) * _ROUNDING if math.isfinite(bound) else 0.0


def _places(compared: list[_Comparison]) -> dict[Any, int]:
    """Returns the places of the constants of a quantity, between which there are others."""
    constants = {value for one in compared for value in one.constants}
    return {value: 2 * number + 1 for number, value in enumerate(sorted(constants))}


def _meets(ends: list[float], place: int, low: float, high: float) -> bool:
    """Checks whether a range has a value at a place among constants."""
    if place % 2:
        return low <= ends[(place + 1) // 2] <= high
    return ends[place // 2] < high and ends[place // 2 + 1] > low
