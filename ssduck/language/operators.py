"""The operators on Python values."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import islice
from typing import Any

from ssduck.errors import ArgumentError, EvaluationError, SelectScriptError, SourceSpan, nearest
from ssduck.formatting import (
    MAX_SHOWN_ELEMENTS,
    as_evaluation_error,
    error_text,
    short_repr,
    type_in_words,
)
from ssduck.language.tree import Node

# The limits of results: larger ones are mistakes, and their computation cannot be interrupted.
MAX_BITS = 1_000_000
MAX_ELEMENTS = 10_000_000


def _is_like(text: Any, pattern: Any) -> bool:
    """Checks whether a text matches a pattern: `%` for any characters, `_` for any one."""
    if not isinstance(text, str) or not isinstance(pattern, str):
        raise TypeError
    return _pattern(pattern).fullmatch(text) is not None


@lru_cache(maxsize=256)
def _pattern(pattern: str) -> re.Pattern[str]:
    parts = {"%": ".*", "_": "."}
    letters = "".join(parts.get(letter) or re.escape(letter) for letter in pattern)
    return re.compile(letters, re.DOTALL)


def _remainder(left: Any, right: Any) -> Any:
    """Returns a remainder: of a text, Python's % would be its formatting, of whatever length."""
    if isinstance(left, str | bytes | bytearray):
        raise TypeError("texts have no remainder")
    return left % right


OPERATORS: dict[str, Callable[[Any, Any], Any]] = {
    "LIKE": _is_like,
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
# The types of operands whose result is never too large.
SAFE_TYPES = {"+": frozenset((int, float)), "*": frozenset((float,)), "^": frozenset[type]()}
SHORT_CIRCUIT = frozenset(("AND", "OR"))


def apply(sign: str, left: Any, right: Any, span: SourceSpan | None = None) -> Any:
    """Returns the value of a binary operator other than AND and OR.

    Raises:
        EvaluationError: a division by zero, or a result that is too large.
        ArgumentError: values that the operator does not take.
    """
    if sign in GROWING and _is_too_large(sign, left, right):
        raise EvaluationError(f"the result of {sign} is too large", span=span)
    try:
        value = OPERATORS[sign](left, right)
    except ZeroDivisionError as error:
        raise EvaluationError("division by zero", span=span) from error
    except OverflowError as error:
        raise EvaluationError(f"the result of {sign} is too large", span=span) from error
    except TypeError as error:
        raise ArgumentError(
            f"{sign} does not take {type_in_words(left)} and {type_in_words(right)}", span=span
        ) from error
    except SelectScriptError:
        raise
    except Exception as error:
        raise as_evaluation_error(error, span) from error
    if isinstance(value, complex):
        raise EvaluationError(f"{sign} of these has no real value", span=span)
    return value


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


def check_size(value: Any, span: SourceSpan) -> None:
    """Checks the size of a nested list, which may be too large to print or to compare.

    Raises:
        EvaluationError: it and the lists in it have more than `MAX_ELEMENTS` elements.
    """
    if type(value) is list and _element_total(value, {}) > MAX_ELEMENTS:
        raise EvaluationError("the list is too large", span=span)


def _element_total(values: list[Any], counted: dict[int, int]) -> int:
    """Returns the number of elements of a list and of all lists in it."""
    count = len(values)
    for value in values:
        if type(value) is not list:
            continue
        if list not in map(type, value):
            count += len(value)
        elif id(value) in counted:
            count += counted[id(value)]
        else:
            total = counted[id(value)] = _element_total(value, counted)
            count += total
    return count


def apply_unary(sign: str, value: Any, span: SourceSpan | None = None) -> Any:
    """Returns the value of - or +.

    Raises:
        ArgumentError: the operand is not a number.
    """
    try:
        return _UNARY[sign](value)
    except TypeError as error:
        raise ArgumentError(f"{sign} does not take {type_in_words(value)}", span=span) from error
    except (SelectScriptError, RecursionError):
        raise
    except Exception as error:
        raise as_evaluation_error(error, span) from error


def truth(value: Any, node: Node) -> bool:
    """Checks whether a value holds.

    Raises:
        EvaluationError: it is neither true nor false.
    """
    try:
        return bool(value)
    except (SelectScriptError, RecursionError):
        raise
    except Exception as error:
        raise as_evaluation_error(error, node.span) from error


def indexed(value: Any, index: Any, span: SourceSpan) -> Any:
    """Returns an element of a value.

    Raises:
        EvaluationError: there is no such element.
        ArgumentError: the value has no elements, or none of that kind.
    """
    try:
        return value[index]
    except RecursionError:
        raise
    except SelectScriptError as error:  # a world's error lacks the place in the program
        error.span = error.span or span
        raise
    except (IndexError, KeyError) as error:
        raise _missing_element_error(value, index, span, error) from error
    except TypeError as error:
        message = f"{type_in_words(value)} has no element {short_repr(index)}"
        hint = getattr(type(value), "KEY_HINT", None)
        if hint is not None and isinstance(index, str):
            message += f"; {hint}"
        raise ArgumentError(message, span=span) from error
    except Exception as error:
        raise as_evaluation_error(error, span) from error


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
