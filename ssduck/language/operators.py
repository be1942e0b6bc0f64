"""The operators on Python values, and as functions of the frames of their operands."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from itertools import islice
from typing import Any, Protocol, TypeAlias

from ssduck.errors import ArgumentError, EvaluationError, SelectScriptError, SourceSpan, nearest
from ssduck.formatting import (
    MAX_SHOWN_ELEMENTS,
    as_evaluation_error,
    error_text,
    short_repr,
    type_in_words,
)
from ssduck.language import ast
from ssduck.language.analysis import MARGIN, OF_MARGINS, TEMPORAL_OPERATORS, VERDICT, written_name
from ssduck.language.sql_suggestions import suggestion_for_name

# The limits of results: larger ones are mistakes, and their computation cannot be interrupted.
MAX_BITS = 1_000_000
# Larger integers count as the elements of a list that take as much.
_BITS_PER_ELEMENT = 64
_WIDE = 1 << _BITS_PER_ELEMENT
MAX_ELEMENTS = 10_000_000
# The size of an element of a list, bytes, and the largest size of a value that is not counted.
ELEMENT_BYTES, SMALL_BYTES = 8, 64


def is_like(text: Any, pattern: Any) -> bool:
    """Checks whether a text matches a pattern: `%` for any characters, `_` for any one."""
    if not isinstance(text, str) or not isinstance(pattern, str):
        raise TypeError
    return _like(pattern).fullmatch(text) is not None


@lru_cache(maxsize=256)
def _like(pattern: str) -> re.Pattern[str]:
    """Returns a pattern as a regular expression, which does not go back before a part it found.

    The first place of each part between two `%` leaves most to the next ones.
    """
    parts = pattern.split("%")
    first, *others = ("".join("." if c == "_" else re.escape(c) for c in p) for p in parts)
    middle = "".join(f"(?>.*?{part})" for part in others[:-1])
    return re.compile(first + middle + "".join(f".*{part}" for part in others[-1:]), re.DOTALL)


def _remainder(left: Any, right: Any) -> Any:
    """Returns a remainder: of a text, Python's % would be its formatting, of whatever length."""
    if isinstance(left, str | bytes | bytearray):
        raise TypeError("texts have no remainder")
    return left % right


OPERATORS: dict[str, Callable[[Any, Any], Any]] = {
    "LIKE": is_like,
    "XOR": lambda left, right: bool(left) != bool(right),
    "IN": lambda left, right: left in right,
    "==": operator.eq,
    "!=": operator.ne,
    ">=": operator.ge,
    ">": operator.gt,
    "<=": operator.le,
    "<": operator.lt,
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "%": _remainder,
    "^": operator.pow,
}
_UNARY: dict[str, Callable[[Any], Any]] = {
    "-": operator.neg,
    "+": operator.pos,
}
GROWING = frozenset("+*^")
# The operators whose time grows with their operands, though the result is small.
SLOW = frozenset(("LIKE", "IN", "%", "/"))
SHORT_CIRCUIT = frozenset(("AND", "OR"))
# The names of the elements of a position.
_AXES = ("x", "y", "z")
# What to write instead of an operator that does not take lists, or a thing on its right.
_OF_LISTS = {
    **dict.fromkeys(
        ("<", "<=", ">", ">="),
        "compare an element, list[2] > 0.1, or the length, norm(list) > 0.1; the time for which a "
        "condition has held is heldFor(condition) >= 0.2, the least value of a time least(…)[1]",
    ),
    "^": "the sum of squares is norm(list) ^ 2",
    "*": "the dot product is sum([a[0] * b[0], a[1] * b[1], a[2] * b[2]])",
}
_NOTHING = (
    "what was not there has no number: leave it out by x IS NOT NULL, or ask for a time at which "
    "it was there, at(0.5, z(cup))"
)
_NO_LIST = {"IN": "IN looks into a list or a text; what is in a thing or a region is within(a, b)"}


def apply(sign: str, left: Any, right: Any, span: SourceSpan | None = None) -> Any:
    """Returns the value of a binary operator other than AND and OR."""
    if sign in GROWING and _is_too_large(sign, left, right):
        raise EvaluationError(f"the result of {sign} is too large", span=span)
    try:
        value = OPERATORS[sign](left, right)
    except ZeroDivisionError as error:
        raise EvaluationError("division by zero", span=span) from error
    except OverflowError as error:
        raise EvaluationError(f"the result of {sign} is too large", span=span) from error
    except TypeError as error:
        if sign == "-" and type(left) is type(right) is list:
            return _difference(left, right, span)
        has_list = list in (type(left), type(right))
        instead = (_OF_LISTS if has_list else _NO_LIST).get(sign)
        if left is None or right is None:
            instead = _NOTHING
        raise ArgumentError(
            f"{sign} does not take {type_in_words(left)} and {type_in_words(right)}"
            + (f": {instead}" if instead else ""),
            span=span,
        ) from error
    except SelectScriptError:
        raise
    except Exception as error:
        raise as_evaluation_error(error, span) from error
    if isinstance(value, complex):
        raise EvaluationError(f"{sign} of these has no real value", span=span)
    return value


def _difference(left: list[Any], right: list[Any], span: SourceSpan | None) -> list[Any]:
    """Returns the difference of two lists of numbers, element by element."""
    if len(left) != len(right):
        raise ArgumentError(
            f"- takes lists of one length, not of {len(left)} and {len(right)} elements", span=span
        )
    if not {int, float}.issuperset(map(type, (*left, *right))):
        raise ArgumentError("- takes lists of numbers", span=span)
    return [apply("-", a, b, span) for a, b in zip(left, right, strict=True)]


def _is_too_large(sign: str, left: Any, right: Any) -> bool:
    """Checks whether a power, a product or a repetition would be too large."""
    if isinstance(left, int) and isinstance(right, int):
        if sign == "^":
            return abs(left) > 1 and right * left.bit_length() > MAX_BITS
        return sign == "*" and left.bit_length() + right.bit_length() > MAX_BITS
    if sign == "+" and isinstance(left, Sequence) and isinstance(right, Sequence):
        return len(left) + len(right) > MAX_ELEMENTS
    if sign == "*":
        for sequence, times in ((left, right), (right, left)):
            if isinstance(sequence, Sequence) and isinstance(times, int):
                return len(sequence) * times > MAX_ELEMENTS
    return False


def check_size(value: Any, span: SourceSpan | None = None) -> None:
    """Checks the size of a nested list, which may be too large to print or to compare."""
    if type(value) is list and _element_total(value, {}) > MAX_ELEMENTS:
        raise EvaluationError("the list is too large", span=span)


def _element_total(values: list[Any], counted: dict[int, int]) -> int:
    """Returns the number of elements of a list and of all lists in it."""
    count = len(values)
    for value in values:
        kind = type(value)
        if kind is list or kind is dict:
            if not value:
                continue
            total = counted.get(id(value))
            if total is None:
                parts = value if kind is list else list(value.values())
                total = counted[id(value)] = _element_total(parts, counted)
            count += total
        elif kind is int:
            if value > _WIDE or value < -_WIDE:
                count += value.bit_length() // _BITS_PER_ELEMENT
        elif kind is str:
            count += len(value)
    return count


def size_of(value: Any) -> int:
    """Returns the size of a text, a list or a large integer in bytes, roughly; else 0."""
    kind = type(value)
    if kind is str:
        return len(value)
    if kind is list:
        return ELEMENT_BYTES * _element_total(value, {})
    return int(value.bit_length() // 8) if kind is int else 0


def own_size_of(value: Any) -> int:
    """Returns the same without the values in a list."""
    return ELEMENT_BYTES * len(value) if type(value) is list else size_of(value)


def apply_unary(sign: str, value: Any, span: SourceSpan | None = None) -> Any:
    """Returns the value of - or +."""
    try:
        return _UNARY[sign](value)
    except TypeError as error:
        raise ArgumentError(f"{sign} does not take {type_in_words(value)}", span=span) from error
    except (SelectScriptError, RecursionError):
        raise
    except Exception as error:
        raise as_evaluation_error(error, span) from error


def truth(value: Any, node: ast.Node) -> bool:
    """Checks whether a value holds."""
    try:
        return bool(value)
    except (SelectScriptError, RecursionError):
        raise
    except Exception as error:
        raise as_evaluation_error(error, node.span) from error


def indexed(value: Any, index: Any, span: SourceSpan) -> Any:
    """Returns an element of a value."""
    try:
        return value[index]
    except RecursionError:
        raise
    except SelectScriptError as error:  # a world's error lacks the place in the program
        error.span = error.span or span
        if isinstance(index, str) and not error.suggestions and ";" not in error.message:
            error.message += instead_of(index)
        raise
    except (IndexError, KeyError) as error:
        raise _missing_element_error(value, index, span, error) from error
    except TypeError as error:
        message = f"{type_in_words(value)} has no element {short_repr(index)}"
        if isinstance(index, str) and hasattr(type(value), "key_hint"):
            part = value.part_hint(index)
            instead = f"; {part}" if part else instead_of(index)
            message += instead or f"; {value.key_hint(index)}"
        elif type(value) is list and index in _AXES:
            message += f"; write [{_AXES.index(index)}], or {index}(e) of an entity e"
        raise ArgumentError(message, span=span) from error
    except Exception as error:
        raise as_evaluation_error(error, span) from error


def instead_of(name: str) -> str:
    """Returns what to write for a name of SQL or of a library, as the end of a message; or ''."""
    instead = suggestion_for_name(name)
    return f"; {instead}" if instead else ""


def _missing_element_error(
    value: Any, index: Any, span: SourceSpan, error: Exception
) -> EvaluationError:
    """Returns the error for a missing element, with the elements that there are."""
    missing = f"no element {short_repr(index)}"
    if isinstance(value, dict):
        keys = list(islice(value, MAX_SHOWN_ELEMENTS))
        more = ", …" if len(value) > MAX_SHOWN_ELEMENTS else ""
        message = ", ".join(map(short_repr, keys))
        near = nearest(index, map(str, keys))
        return EvaluationError(
            f"{missing}: there are keys [{message}{more}]", span=span, suggestions=near
        )
    if isinstance(value, list | tuple | str):
        return EvaluationError(f"{missing}: there are {len(value)} elements", span=span)
    return EvaluationError(f"{missing}: {error_text(error)}", span=span)


# Frames are `ssduck.language.evaluator.Frame`.
Frame: TypeAlias = Any
Thunk: TypeAlias = Callable[[Frame], Any]


class OperandCompiler(Protocol):
    """Compiles operands to functions of frames."""

    def thunk(self, node: ast.Node) -> Thunk:
        """Returns a part as a function of a frame."""

    def condition(self, node: ast.Node) -> Callable[[Frame], bool]:
        """Returns a part as a condition."""

    def is_relation(self, node: ast.Node) -> bool:
        """Checks whether a part is a call of a relation."""


def unary(compiler: OperandCompiler, node: ast.Unary) -> Thunk:
    """Compiles `-x`, `+x`, `NOT x` or `x IS NULL`."""
    if node.operator == "NOT" and (compiler.is_relation(node.operand) or is_verdict(node.operand)):
        operand = compiler.thunk(node.operand)

        def negated(frame: Frame) -> bool | None:
            value = operand(frame)
            return None if value is None else not truth(value, node.operand)  # of what is unknown

        return negated
    if node.operator == "NOT":
        holds = compiler.condition(node.operand)
        return lambda frame: not holds(frame)
    sign, inner = node.operator, compiler.thunk(node.operand)
    if sign == "IS NULL":
        return lambda frame: inner(frame) is None
    if is_verdict(node):
        return lambda frame: (
            None if (value := inner(frame)) is None else apply_unary(sign, value, node.span)
        )
    return lambda frame: apply_unary(sign, inner(frame), node.span)


def binary(compiler: OperandCompiler, node: ast.Binary) -> Thunk:
    """Returns two sides with an operator between them."""
    sign = node.operator
    if sign in SHORT_CIRCUIT:
        return _short_circuit(compiler, sign, (node.left, node.right))
    operand = compiler.thunk if sign in GROWING else partial(_operand, compiler)
    left, right = operand(node.left), operand(node.right)
    is_growing, is_slow, may_be_unknown = sign in GROWING, sign in SLOW, is_verdict(node)

    def operation(frame: Frame) -> Any:
        if is_slow:
            frame.scope.meter.step()
        a, b = left(frame), right(frame)
        if may_be_unknown and (a is None or b is None):
            return None
        value = apply(sign, a, b, node.span)
        return counted(frame, value) if is_growing else value

    return operation


def counted(frame: Frame, value: Any) -> Any:
    """Checks and counts the size of a value that an operator or a function has made."""
    size = own_size_of(value)
    if size > SMALL_BYTES:
        check_size(value)
        frame.scope.meter.charge(size)
    return value


def chain(compiler: OperandCompiler, node: ast.OperatorChain) -> Thunk:
    """Returns many operands of one level, from the left."""
    if node.operators[0] in SHORT_CIRCUIT:
        return _short_circuit(compiler, node.operators[0], node.operands)
    first, *others = map(compiler.thunk, node.operands)
    steps = [
        (_step(sign, node.until(index)), operand)
        for index, (sign, operand) in enumerate(zip(node.operators, others, strict=True), 1)
    ]

    def operation(frame: Frame) -> Any:
        value = first(frame)
        for step, operand in steps:
            value = step(frame, value, operand(frame))
        return value

    return operation


def _step(sign: str, span: SourceSpan) -> Callable[[Frame, Any, Any], Any]:
    """Returns one operator of a chain: one of the language, or a user's function in its place."""
    if sign in OPERATORS:
        return lambda frame, left, right: counted(frame, apply(sign, left, right, span))
    call, is_in = ast.Call(span, sign, (), span), written_name(sign) == "in"
    return lambda frame, left, right: frame.scope.call(
        call, [right, left] if is_in else [left, right], frame
    )


def _operand(compiler: OperandCompiler, node: ast.Node) -> Thunk:
    """Returns a side of an operator, which keeps nothing of it: a list is made once."""
    if not isinstance(node, ast.ListLiteral) or not _is_written_out(node):
        return compiler.thunk(node)
    fixed = _written_out(node)
    return lambda _: fixed


def _is_written_out(node: ast.Node) -> bool:
    if isinstance(node, ast.ListLiteral):
        return all(map(_is_written_out, node.items))
    return isinstance(node, ast.Literal)


def _written_out(node: ast.Node) -> Any:
    if isinstance(node, ast.ListLiteral):
        return list(map(_written_out, node.items))
    return node.value  # type: ignore[attr-defined]  # a literal


def is_verdict(node: ast.Node) -> bool:
    """Checks whether a part is made of operators of temporal logic, or of margins.

    It is nothing where these are: a condition that is not decided holds no more than its opposite.
    """
    match node:
        case ast.Call(name=name):
            return name in TEMPORAL_OPERATORS or name.startswith((OF_MARGINS, MARGIN))
        case ast.Placeholder(name=name):
            return name.startswith(VERDICT)
        case (
            ast.Unary(operator="NOT" | "-", operand=operand)
            | ast.Binary(operator="/", left=operand)
        ):
            return is_verdict(operand)
        case ast.Binary(operator="<" | "<=" | ">" | ">=" | "-", left=left, right=right):
            return is_verdict(left) or is_verdict(right)
        case ast.Binary(operator=sign) | ast.OperatorChain(operators=(sign, *_)) if (
            sign in SHORT_CIRCUIT
        ):
            return any(map(is_verdict, node.children()))
    return False


def _short_circuit(
    compiler: OperandCompiler, sign: str, operands: tuple[ast.Node, ...]
) -> Callable[[Frame], bool | None]:
    """Compiles AND or OR: evaluation stops at the first operand that decides."""
    decides = sign == "OR"
    parts = [(compiler.thunk(one), one, is_verdict(one)) for one in operands]

    def holds(frame: Frame) -> bool | None:
        is_known = True
        for part, operand, may_be_unknown in parts:
            value = part(frame)
            if value is None and may_be_unknown:
                is_known = False
                continue
            if value is not True and value is not False:
                value = truth(value, operand)
            if value is decides:
                return decides
        return not decides if is_known else None

    return holds
