"""Lets users' functions replace relations, functions and operators of the language.

Such a function is called by a name that no text has. The parts of a program that mean it are
changed before the program runs, so that everything else sees plain calls of a user's function.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from ssduck.language.tree import Binary, Call, Node, OperatorChain, Program, Unary

# What operators are called as functions: those of two values, and those of one.
NAMES: dict[str, str] = {
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
NAMES_OF_ONE: dict[str, str] = {"NOT": "not", "-": "neg"}
SIGNS = {name: sign for sign, name in NAMES.items()}
SIGNS_OF_ONE = {name: sign for sign, name in NAMES_OF_ONE.items()}
NAMED = frozenset((*SIGNS, *SIGNS_OF_ONE))
# What is no function like others: it names columns, does something, or looks at other ticks.
FIXED = frozenset(("to", "print", "eval", "clear", "var", "help"))

_MARK = " of the user"


def marked_name(name: str) -> str:
    """Returns the marked name of a user's function that replaces a built-in one."""
    return name + _MARK


def written_name(name: str) -> str:
    """Returns a function's name as programs write it."""
    return name.removesuffix(_MARK)


def with_overrides(program: Program, names: Collection[str]) -> Program:
    """Returns a program in which users' functions stand where they replace something.

    Args:
        program: as it was parsed.
        names: the names of the functions that are replaced.
    """

    def change(part: Node) -> Node | None:
        match part:
            case Call(name=name, arguments=arguments) if name in names:
                return replace(part, name=marked_name(name), arguments=changed(arguments))
            case Unary(operator=sign, operand=operand) if NAMES_OF_ONE.get(sign) in names:
                return _call(part, NAMES_OF_ONE[sign], changed((operand,)))
            case Binary(operator=sign, left=left, right=right) if NAMES.get(sign) in names:
                # What contains comes first, as in Python's operator of that name.
                sides = (right, left) if sign == "IN" else (left, right)
                return _call(part, NAMES[sign], changed(sides))
            case OperatorChain(operators=operators, operands=operands):
                signs = tuple(_sign(sign, names) for sign in operators)
                return replace(part, operators=signs, operands=changed(operands))
        return None

    def changed(parts: tuple[Node, ...]) -> tuple[Node, ...]:
        return tuple(part.replaced(change) for part in parts)

    return replace(program, statements=changed(program.statements))


def _sign(sign: str, names: Collection[str]) -> str:
    return marked_name(NAMES[sign]) if NAMES[sign] in names else sign


def _call(part: Node, name: str, arguments: tuple[Node, ...]) -> Call:
    return Call(part.span, marked_name(name), arguments, part.span)
