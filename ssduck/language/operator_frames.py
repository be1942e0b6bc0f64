"""Compiles the operators of a tree to functions of frames."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, TypeAlias

from ssduck.errors import SourceSpan
from ssduck.language.operators import (
    GROWING,
    OPERATORS,
    SAFE_TYPES,
    SHORT_CIRCUIT,
    SLOW,
    SMALL_BITS,
    SMALL_BYTES,
    apply,
    apply_unary,
    check_size,
    own_size_of,
    truth,
)
from ssduck.language.overrides import written_name
from ssduck.language.tree import Binary, Call, ListLiteral, Literal, Node, OperatorChain, Unary

# Frames are `ssduck.language.evaluator.Frame`.
Frame: TypeAlias = Any
Thunk: TypeAlias = Callable[[Frame], Any]


class OperandCompiler(Protocol):
    """Compiles operands to functions of frames."""

    def thunk(self, node: Node) -> Thunk:
        """Returns a part as a function of a frame."""

    def condition(self, node: Node) -> Callable[[Frame], bool]:
        """Returns a part as a condition."""

    def is_relation(self, node: Node) -> bool:
        """Checks whether a part is a call of a relation."""

    def constant_value(self, node: ListLiteral) -> Any:
        """Returns a list that is written out, made once."""


def unary(compiler: OperandCompiler, node: Unary) -> Thunk:
    """Compiles `-x`, `+x`, `NOT x` or `x IS NULL`."""
    if node.operator == "NOT" and compiler.is_relation(node.operand):
        relation = compiler.thunk(node.operand)

        def negated(frame: Frame) -> bool | None:
            value = relation(frame)
            return None if value is None else not truth(value, node.operand)  # of what is unknown

        return negated
    if node.operator == "NOT":
        holds = compiler.condition(node.operand)
        return lambda frame: not holds(frame)
    sign, inner = node.operator, compiler.thunk(node.operand)
    if sign == "IS NULL":
        return lambda frame: inner(frame) is None
    return lambda frame: apply_unary(sign, inner(frame), node.span)


def binary(compiler: OperandCompiler, node: Binary) -> Thunk:
    """Returns two sides with an operator between them."""
    sign = node.operator
    if sign in SHORT_CIRCUIT:
        return _short_circuit(compiler, sign, (node.left, node.right))
    operate = OPERATORS[sign]
    if sign in GROWING:
        left, right = compiler.thunk(node.left), compiler.thunk(node.right)
        quick = SAFE_TYPES[sign]

        def growing(frame: Frame) -> Any:
            a, b = left(frame), right(frame)
            if type(a) is type(b) and type(a) in quick:
                value = operate(a, b)
                if type(value) is float or value.bit_length() < SMALL_BITS:
                    return value
                return counted(frame, value)
            return counted(frame, apply(sign, a, b, node.span))

        return growing
    left, right = _operand(compiler, node.left), _operand(compiler, node.right)

    def operation(frame: Frame) -> Any:
        a, b = left(frame), right(frame)
        try:
            return operate(a, b)
        except Exception:  # noqa: BLE001  # `apply` raises the right error
            return apply(sign, a, b, node.span)

    if sign not in SLOW:
        return operation

    def timed(frame: Frame) -> Any:
        frame.scope.meter.step()
        return operation(frame)

    return timed


def counted(frame: Frame, value: Any) -> Any:
    """Checks and counts the size of a value that an operator or a function has made."""
    size = own_size_of(value)
    if size > SMALL_BYTES:
        check_size(value)
        frame.scope.meter.charge(size)
    return value


def chain(compiler: OperandCompiler, node: OperatorChain) -> Thunk:
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
    call, is_in = Call(span, sign, (), span), written_name(sign) == "in"
    return lambda frame, left, right: frame.scope.call(
        call, [right, left] if is_in else [left, right], frame
    )


def _operand(compiler: OperandCompiler, node: Node) -> Thunk:
    """Returns a side of an operator, which keeps nothing of it: a list is made once."""
    if not isinstance(node, ListLiteral) or not _is_written_out(node):
        return compiler.thunk(node)
    fixed = compiler.constant_value(node)
    return lambda _: fixed


def _is_written_out(node: Node) -> bool:
    if isinstance(node, ListLiteral):
        return all(map(_is_written_out, node.items))
    return isinstance(node, Literal)


def is_short_circuit(node: Node) -> bool:
    """Checks whether a part is True or False because operands are asked one after another."""
    match node:
        case Binary(operator=sign) | OperatorChain(operators=(sign, *_)):
            return sign in SHORT_CIRCUIT
    return False


def _short_circuit(
    compiler: OperandCompiler, sign: str, operands: tuple[Node, ...]
) -> Callable[[Frame], bool]:
    """Compiles AND or OR: evaluation stops at the first operand that decides."""
    decides = sign == "OR"
    parts = [(compiler.thunk(operand), operand) for operand in operands]

    def holds(frame: Frame) -> bool:
        for part, operand in parts:
            value = part(frame)
            if value is not True and value is not False:
                value = truth(value, operand)
            if value is decides:
                return decides
        return not decides

    return holds
