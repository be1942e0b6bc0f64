"""Lets users' functions replace relations, functions and operators of the language.

Such a function has a marked name, which no text can contain. The calls of it are rewritten before
the program runs, so that all later stages see plain calls of a user's function.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from ssduck.language.tree import Binary, Call, Node, OperatorChain, Program, Unary

# The names of operators as functions: those of two operands, and those of one.
BINARY_NAMES: dict[str, str] = {
    "+": "add",
    "-": "sub",
    "*": "mul",
    "/": "div",
    "%": "mod",
    "^": "pow",
    "==": "eq",
    "!=": "ne",
    ">=": "ge",
    ">": "gt",
    "<=": "le",
    "<": "lt",
    "OR": "or",
    "XOR": "xor",
    "AND": "and",
    "IN": "in",
}
UNARY_NAMES: dict[str, str] = {"NOT": "not", "-": "neg"}
BINARY_SIGNS = {name: sign for sign, name in BINARY_NAMES.items()}
UNARY_SIGNS = {name: sign for sign, name in UNARY_NAMES.items()}
OPERATOR_NAMES = frozenset((*BINARY_SIGNS, *UNARY_SIGNS))
# Functions that name columns, have side effects, or read variables.
NOT_OVERRIDABLE = frozenset(("to", "print", "eval", "clear", "var", "help"))

_MARK = " of the user"


def marked_name(name: str) -> str:
    """Returns the marked name of a user's function that replaces a built-in one."""
    return name + _MARK


def written_name(name: str) -> str:
    """Returns a function's name as programs write it."""
    return name.removesuffix(_MARK)


def with_overrides(program: Program, names: Collection[str]) -> Program:
    """Returns a program in which calls of replaced functions are calls of users' functions.

    Args:
        program: the parsed program.
        names: the names of the functions that are replaced.
    """

    def change(part: Node) -> Node | None:
        match part:
            case Call(name=name, arguments=arguments) if name in names:
                return replace(part, name=marked_name(name), arguments=changed(arguments))
            case Unary(operator=sign, operand=operand) if UNARY_NAMES.get(sign) in names:
                return _call(part, UNARY_NAMES[sign], changed((operand,)))
            case Binary(operator=sign, left=left, right=right) if BINARY_NAMES.get(sign) in names:
                # The container comes first, as in Python's `operator.contains`.
                sides = (right, left) if sign == "IN" else (left, right)
                return _call(part, BINARY_NAMES[sign], changed(sides))
            case OperatorChain(operators=operators, operands=operands):
                signs = tuple(_sign(sign, names) for sign in operators)
                return replace(part, operators=signs, operands=changed(operands))
        return None

    def changed(parts: tuple[Node, ...]) -> tuple[Node, ...]:
        return tuple(part.replaced(change) for part in parts)

    return replace(program, statements=changed(program.statements))


def _sign(sign: str, names: Collection[str]) -> str:
    return marked_name(BINARY_NAMES[sign]) if BINARY_NAMES[sign] in names else sign


def _call(part: Node, name: str, arguments: tuple[Node, ...]) -> Call:
    return Call(part.span, marked_name(name), arguments, part.span)
