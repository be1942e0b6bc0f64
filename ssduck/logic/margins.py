"""The margin of a condition, as an expression of the language.

More than 0 where the condition holds, less where it does not, in the unit of its comparisons: how
much these would have to change for the condition to flip. The margin of `a < b` is b - a, that of
AND the least of its parts, of OR the largest, and of NOT the negative one. Relations state theirs;
what has none is plus or minus infinity.
"""

from __future__ import annotations

from functools import lru_cache

from ssduck.errors import ArgumentError
from ssduck.language import ast
from ssduck.language.analysis import OF_MARGINS, TEMPORAL_OPERATORS
from ssduck.language.builtins import MARGIN_OF_TRUTH, UNIT_OF_SCALE
from ssduck.language.parser import parse
from ssduck.sql.relations.registry import RELATIONS


def margin_of(condition: ast.Node) -> ast.Node:
    """Returns the margin of a condition."""
    span = condition.span
    match condition:
        case ast.Unary(operator="NOT", operand=operand):
            return ast.Unary(span, "-", margin_of(operand))
        case ast.Binary(operator="AND" | "OR" as sign, left=left, right=right):
            return _extreme(condition, sign, (left, right))
        case ast.OperatorChain(operators=("AND" | "OR" as sign, *_), operands=operands):
            return _extreme(condition, sign, operands)
        case ast.Binary(operator="<" | "<=", left=left, right=right):
            return ast.Binary(span, "-", right, left)
        case ast.Binary(operator=">" | ">=", left=left, right=right):
            return ast.Binary(span, "-", left, right)
        case ast.Call(name="scale", arguments=(inner, unit)):
            checked = ast.Call(unit.span, UNIT_OF_SCALE, (unit,), unit.span)
            return ast.Binary(span, "/", margin_of(inner), checked)
        case ast.Call(name=name, arguments=arguments) if name in TEMPORAL_OPERATORS:
            count = TEMPORAL_OPERATORS[name]
            margins = (*map(margin_of, arguments[:count]), *arguments[count:])
            return ast.Call(span, OF_MARGINS + name, margins, condition.name_span)
        case ast.Call(name=name) if (margin := _margin_of_relation(condition)) is not None:
            return margin
    return ast.Call(span, MARGIN_OF_TRUTH, (condition,), span)


def check_margin(margin: ast.Node) -> None:
    """Checks that a margin is of conditions: that of a number or a text would be infinite."""
    for part in margin.walk():
        if (
            isinstance(part, ast.Call)
            and part.name == MARGIN_OF_TRUTH
            and is_value(part.arguments[0])
        ):
            raise ArgumentError(
                "robustness takes a condition, and this is a value: compare it, as in "
                "robustness(z(cup) > 0.9)",
                span=part.span,
            )


def is_value(node: ast.Node) -> bool:
    """Checks whether a part is a number, a text or a list, and no condition."""
    match node:
        case ast.Literal(value=value):
            return not isinstance(value, bool)
        case (
            ast.Unary(operator=sign)
            | ast.Binary(operator=sign)
            | ast.OperatorChain(operators=(sign, *_))
        ):
            return sign in ("+", "-", "*", "/", "%")
        case ast.Call(name=name):
            result = RELATIONS[name].result if name in RELATIONS else "boolean"
            is_number = name in ("robustness", "heldFor", "rate")
            return is_number or result not in ("boolean", "entity")
    return isinstance(node, ast.ListLiteral)


def _extreme(condition: ast.Node, sign: str, operands: tuple[ast.Node, ...]) -> ast.Node:
    """Returns the least margin in an AND, or the largest in an OR; nothing where one of them is."""
    margins = ast.ListLiteral(condition.span, tuple(map(margin_of, operands)))
    return ast.Call(condition.span, f"margin of {sign}", (margins,), condition.span)


def _margin_of_relation(call: ast.Call) -> ast.Node | None:
    relation = RELATIONS.get(call.name)
    if relation is None or len(call.arguments) not in relation.expressions:
        return None  # evaluated, the call tells of missing arguments
    if not (text := relation.margin_of(len(call.arguments))):
        return None
    values = {p.name: _parsed(p.default) for p in relation.parameters if p.default}
    values |= zip((p.name for p in relation.parameters), call.arguments, strict=False)

    def argument(part: ast.Node) -> ast.Node | None:
        return values.get(part.name) if isinstance(part, ast.Name) else None

    margin = _parsed(text).replaced(argument)
    if [p.type for p in relation.parameters[:2]] != ["entity", "entity"]:
        return margin
    # None is of an entity with itself.
    differ = _parsed("CASE WHEN a != b THEN 1e999 ELSE -1e999 END").replaced(argument)
    both = ast.ListLiteral(call.span, (differ, margin))
    return ast.Call(call.span, "margin of AND", (both,), call.span)


@lru_cache(maxsize=256)
def _parsed(text: str) -> ast.Node:
    return parse(f"{text};").statements[0]
