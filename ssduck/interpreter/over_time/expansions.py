"""Functions that stand for an expression of others; a program has that in their place."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass

from ssduck.errors import ArgumentError
from ssduck.interpreter.over_time.functions import never_called
from ssduck.language import ast
from ssduck.language.builtins import Function
from ssduck.logic.margins import check_margin, margin_of


@dataclass(frozen=True)
class Expansion:
    """A function that stands for an expression."""

    expand: Callable[[ast.Call], ast.Node]  # returns the expression of a call
    function: Function  # the entry for help; it is never called


def _lifted(call: ast.Call) -> ast.Node:
    """Returns z(entity) - initially(z(entity)) >= height for lifted(entity, height)."""
    span = call.span
    entity, height = call.arguments
    z = ast.Call(entity.span, "z", (entity,), entity.span)
    rise = ast.Binary(span, "-", z, ast.Call(span, "initially", (z,), span))
    return ast.Binary(span, ">=", rise, height)


def _robustness(call: ast.Call) -> ast.Node:
    margin = margin_of(call.arguments[0])
    check_margin(margin)
    return margin


def _expansion(
    name: str, expand: Callable[[ast.Call], ast.Node], about: str, usage: str, count: int
) -> Expansion:
    return Expansion(expand, never_called(name, about, usage, count, count))


def _scaled(call: ast.Call) -> ast.Node:
    """Returns the condition, whose unit is looked at if it is a number."""
    condition, unit = call.arguments
    match unit:
        case ast.Literal(value=0) | ast.Unary(operator="-", operand=ast.Literal()):
            raise ArgumentError("scale: the unit is a number above 0", span=unit.span)
    return condition


EXPANSIONS: dict[str, Expansion] = {
    form.function.name: form
    for form in (
        _expansion(
            "lifted",
            _lifted,
            "Checks if an entity is higher by so many metres than at the first recorded tick: "
            "z(entity) - initially(z(entity)) >= height.",
            "lifted(entity, height) -> bool",
            2,
        ),
        _expansion(
            "robustness",
            _robustness,
            "Returns the margin of a condition: more than 0 where it holds, less where it does "
            "not, in the unit of its comparisons; so much would have to change for it to flip. "
            "That of a < b is b - a, of AND the least one, of OR the largest; help has those of "
            "relations, and one without a margin, such as isRobot, is plus or minus infinity.",
            "robustness(condition) -> float",
            1,
        ),
        _expansion(
            "scale",
            _scaled,
            "Is the condition, whose margin is divided by a number: so margins in metres and in "
            "degrees are compared. robustness(scale(z(cup) > 0.9, 0.1) AND scale(tilt(cup) < 0.5, "
            "0.2)).",
            "scale(condition, unit) -> bool",
            2,
        ),
    )
}


def expanded(node: ast.Node, check: Callable[[ast.Call], None]) -> ast.Node:
    """Returns a part of a program with expressions in place of the functions that stand for them.

    Args:
        node: the part.
        check: checks the number of arguments of a call.
    """

    def changed(part: ast.Node, names: Collection[str]) -> ast.Node:
        def change(part: ast.Node) -> ast.Node | None:
            if not isinstance(part, ast.Call) or part.name not in names:
                return None
            check(part)
            return changed(EXPANSIONS[part.name].expand(part), names)

        return part.replaced(change)

    # A margin is that of what `lifted` stands for, but it sees `scale`.
    return changed(changed(node, ("lifted",)), ("robustness", "scale"))
