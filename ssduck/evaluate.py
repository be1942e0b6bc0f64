"""Values of expressions in Python: of what stands outside a query, and of what SQL cannot do.

An `Evaluator` walks a tree. Variables, functions and nested queries are looked up through the
`Scope` that it is given; parts whose values are known already (columns that a query has
fetched) are not walked into.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from ssduck.errors import (
    ArgumentError,
    EvaluationError,
    SelectScriptError,
    Span,
    UnknownNameError,
    UnsupportedError,
)
from ssduck.tree import (
    Aged,
    Assignment,
    Binary,
    Call,
    If,
    Index,
    ListOf,
    Literal,
    Name,
    Node,
    Query,
    This,
    Unary,
)

# Larger results of ^ and * are refused: they are mistakes, and nothing could stop them.
MOST_BITS = 1_000_000
MOST_ELEMENTS = 10_000_000


class Scope(Protocol):
    """What an evaluator needs of the interpreter."""

    def variable(self, name: str) -> Any:
        """A variable's value, or an UnknownNameError."""

    def has_variable(self, name: str) -> bool:
        """Whether there is a variable of that name."""

    def assign(self, name: str, value: Any) -> None:
        """Set a variable."""

    def call(self, node: Call, evaluator: Evaluator) -> Any:
        """The value of a function call; it evaluates the arguments itself."""

    def query(self, node: Query, outer: Evaluator) -> Any:
        """The value of a nested query, which sees the rows of the outer ones."""


class Evaluator:
    """Evaluates expressions.

    Args:
        scope: variables, functions, queries.
        known: values of parts that are known already.
        elements: the current element of each source, by alias; that of the only source
            also by None.
        once: parts that are the same for all rows: an empty list each until it is needed for
            the first time, then its value in a list.
    """

    def __init__(
        self,
        scope: Scope,
        known: Mapping[Node, Any] | None = None,
        elements: Mapping[str | None, Any] | None = None,
        once: Mapping[Node, list[Any]] | None = None,
    ) -> None:
        self.scope = scope
        self.known = known or {}
        self.elements = elements or {}
        self.once = once or {}

    def knowing(self, values: Mapping[Node, Any]) -> Evaluator:
        """An evaluator that knows the values of more parts."""
        return Evaluator(self.scope, {**self.known, **values}, self.elements, self.once)

    def value(self, node: Node) -> Any:
        """The value of an expression.

        Raises:
            SelectScriptError: with the offending node's place.
        """
        if node in self.known:
            return self.known[node]
        kept = self.once.get(node)
        if kept:
            return kept[0]
        try:
            value = self._value(node)
        except SelectScriptError as error:
            error.span = error.span or node.span
            raise
        except (ValueError, ArithmeticError, MemoryError) as error:
            # Of values that Python brought in, an array that is neither true nor false, say.
            raise EvaluationError(f"{type(error).__name__}: {error}", span=node.span) from error
        if kept is not None:
            kept.append(value)
        return value

    def _value(self, node: Node) -> Any:
        match node:
            case Literal(value=value):
                return value
            case ListOf(items=items):
                return [self.value(item) for item in items]
            case Name(name=name):
                return self.scope.variable(name)
            case This(alias=alias):
                return self._element(alias)
            case Call():
                return self.scope.call(node, self)
            case Index(base=base, indices=indices):
                return self._index(self.value(base), indices)
            case Unary(operator=sign, operand=operand):
                return apply_unary(sign, self.value(operand), node.span)
            case Binary(operator="AND", left=left, right=right):
                return bool(self.value(left)) and bool(self.value(right))
            case Binary(operator="OR", left=left, right=right):
                return bool(self.value(left)) or bool(self.value(right))
            case Binary(operator=sign, left=left, right=right):
                return apply(sign, self.value(left), self.value(right), node.span)
            case If():
                return self._choice(node)
            case Assignment(name=name, value=value, horizon=None):
                assigned = self.value(value)
                self.scope.assign(name, assigned)
                return assigned
            case Query():
                return self.scope.query(node, self)
            case Aged() | Assignment():
                raise UnsupportedError("variables with a history, name{…}, are not supported yet")
        raise UnsupportedError(f"{type(node).__name__} is not supported here")

    def _element(self, alias: str | None) -> Any:
        if alias in self.elements:
            return self.elements[alias]
        if alias is None:
            raise UnknownNameError(
                "there is no 'this' here: it is the element of a query's only source"
            )
        names = [name for name in self.elements if name is not None]
        raise UnknownNameError(f"there is no source {alias!r} here", suggestions=names[:3])

    def _index(self, value: Any, indices: tuple[Node, ...]) -> Any:
        for node in indices:
            index = self.value(node)
            try:
                value = value[index]
            except (IndexError, KeyError) as error:
                size = (
                    f"{len(value)} elements" if isinstance(value, list) else f"keys {list(value)}"
                )
                raise EvaluationError(
                    f"no element {index!r}: there are {size}", span=node.span
                ) from error
            except TypeError as error:
                message = f"{type(value).__name__} has no element {index!r}"
                raise ArgumentError(message, span=node.span) from error
        return value

    def _choice(self, node: If) -> Any:
        value: Any = False
        for part in node.then if self.value(node.condition) else node.otherwise:
            value = self.value(part)
        return value


_OPERATORS: dict[str, Callable[[Any, Any], Any]] = {
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
    "%": operator.mod,
    "^": operator.pow,
}


def apply(sign: str, left: Any, right: Any, span: Span | None = None) -> Any:
    """The value of a binary operator other than AND and OR.

    Raises:
        EvaluationError: a division by zero, or a number too large.
        ArgumentError: values that the operator does not take.
    """
    if _is_endless(sign, left, right):
        raise EvaluationError(f"the result of {sign} is too large", span=span)
    try:
        value = _OPERATORS[sign](left, right)
        if isinstance(value, complex):
            raise EvaluationError(f"{sign} of these has no real value", span=span)
    except ZeroDivisionError as error:
        raise EvaluationError("division by zero", span=span) from error
    except OverflowError as error:
        raise EvaluationError(f"the result of {sign} is too large", span=span) from error
    except TypeError as error:
        raise ArgumentError(
            f"{sign} does not take {_kind(left)} and {_kind(right)}", span=span
        ) from error
    return value


def _is_endless(sign: str, left: Any, right: Any) -> bool:
    """Whether a power or a repetition would take all time and memory there is."""
    if sign == "^":
        whole = isinstance(left, int) and isinstance(right, int)
        return whole and abs(left) > 1 and right * left.bit_length() > MOST_BITS
    if sign == "*":
        for sequence, times in ((left, right), (right, left)):
            if isinstance(sequence, str | list) and isinstance(times, int):
                return len(sequence) * times > MOST_ELEMENTS
    return False


def apply_unary(sign: str, value: Any, span: Span | None = None) -> Any:
    """The value of NOT, - or +.

    Raises:
        ArgumentError: a sign before what is no number.
    """
    if sign == "NOT":
        return not value
    try:
        return -value if sign == "-" else +value
    except TypeError as error:
        raise ArgumentError(f"{sign} does not take {_kind(value)}", span=span) from error


def _kind(value: Any) -> str:
    """What a value is, in words."""
    if value is None:
        return "nothing"
    words = {
        bool: "True or False",
        int: "a number",
        float: "a number",
        str: "a text",
        list: "a list",
    }
    return words.get(type(value), type(value).__name__)
