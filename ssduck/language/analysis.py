"""Finds the dependencies of the parts of a program: rows, changing names, side effects."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace
from functools import wraps
from typing import TypeVar
from weakref import WeakKeyDictionary

from ssduck.errors import ArgumentError
from ssduck.language import ast

T = TypeVar("T")

# Calls with side effects or hidden inputs; they are evaluated row by row, in order.
IMPURE = frozenset(("print", "eval", "clear"))
# The operators of temporal logic, by the number of their conditions.
TEMPORAL_OPERATORS = {
    "always": 1,
    "eventually": 1,
    "until": 2,
    "historically": 1,
    "once": 1,
    "heldSince": 2,
}
# In front of the name of such an operator whose conditions are given by their margins.
OF_MARGINS = "robustness of "
# In front of the names of functions that make margins.
MARGIN = "margin of "
# In front of the name of a placeholder for the value of such an operator.
VERDICT = "verdict of "
# Calls whose argument is evaluated at each recorded tick (ssduck.interpreter.over_time.functions).
OVER_TIME = frozenset(
    (
        *("since", "heldFor", "holds", "changes", "initially", "least", "greatest"),
        *("previous", "rate", "at"),
        *TEMPORAL_OPERATORS,
        *(OF_MARGINS + name for name in TEMPORAL_OPERATORS),
    )
)


def cached_by_node(function: Callable[[ast.Node], T]) -> Callable[[ast.Node], T]:
    """Caches a function of nodes by node.

    Children are visited first, so that recursive calls in the function find cached results.
    """
    result: WeakKeyDictionary[ast.Node, T] = WeakKeyDictionary()

    @wraps(function)
    def cached(node: ast.Node) -> T:
        try:
            return result[node]
        except KeyError:
            pass
        parts = [node]
        for part in parts:  # the loop appends to the list
            parts.extend(child for child in part.children() if child not in result)
        for part in reversed(parts):
            result[part] = function(part)
        return result[node]

    return cached


@cached_by_node
def free_aliases(node: ast.Node) -> frozenset[str | None]:
    """Returns the aliases whose `this` a part mentions, and that no query in it has as a source."""
    if isinstance(node, ast.This | ast.QualifiedName):
        return frozenset((node.alias,))
    if isinstance(node, ast.UnresolvedName):
        return frozenset((None,))
    result: set[str | None] = set()
    if not isinstance(node, ast.Query):
        for child in node.children():
            result |= free_aliases(child)
        return frozenset(result)
    for child in node.children():
        if not isinstance(child, ast.Source):
            result |= free_aliases(child)
    result -= {None, *(source.alias for source in node.sources)}
    for source in node.sources:  # a source depends on outer queries, not on this one
        result |= free_aliases(source)
    return frozenset(result)


@cached_by_node
def nested_sources(node: ast.Node) -> tuple[ast.Node, ...]:
    """Returns the sources of the queries in a node that are names, perhaps of a past."""
    named = ast.Name | ast.TimeIndex
    result: list[ast.Node] = []
    for child in node.children():
        result += nested_sources(child)
        if isinstance(child, ast.Query):
            result += [source.value for source in child.sources if isinstance(source.value, named)]
    return tuple(result)


def sees_outside(query: ast.Query) -> bool:
    """Checks whether a nested query sees rows of the queries around it."""
    return bool(free_aliases(query))


@cached_by_node
def is_impure(node: ast.Node) -> bool:
    """Checks whether evaluation has side effects, so that its order and number matter."""
    match node:
        case ast.Assignment():
            return True
        case ast.Call(name=name) if name in IMPURE:
            return True
        case ast.Recursion(start=start, step=step, stop=stop):
            # State variables are visible only in the query.
            parts = (
                part.value if isinstance(part, ast.Assignment) else part for part in (*start, *step)
            )
            return is_impure(stop) or any(map(is_impure, parts))
    return any(map(is_impure, node.children()))


@cached_by_node
def calls_of(node: ast.Node) -> frozenset[str]:
    """Returns the functions that a part calls."""
    names: tuple[str, ...] = ()
    match node:
        case ast.Call(name=name) | ast.QualifiedName(key=name):
            names = (name,)
        case ast.OperatorChain(operators=names):  # users' functions may be among them
            pass
    return frozenset(names).union(*map(calls_of, node.children()))


@cached_by_node
def forms_of(node: ast.Node) -> frozenset[str]:
    """Returns the result forms that a part names."""
    names = (node.name,) if isinstance(node, ast.AdapterClause) else ()
    return frozenset(names).union(*map(forms_of, node.children()))


def states(query: ast.Query) -> frozenset[str]:
    """Returns the state variables of a hierarchical query."""
    if query.recursion is None:
        return frozenset()
    parts = (*query.recursion.start, *query.recursion.step)
    return frozenset(part.name for part in parts if isinstance(part, ast.Assignment))


def changing(query: ast.Query) -> frozenset[str]:
    """Returns the variables that may differ from row to row of a query: those that it assigns."""
    return frozenset(part.name for part in query.walk() if isinstance(part, ast.Assignment))


def mentions(node: ast.Node, names: Collection[str]) -> bool:
    """Checks whether a part reads one of these variables."""
    return not variables_of(node).isdisjoint(names)


@cached_by_node
def variables_of(node: ast.Node) -> frozenset[str]:
    """Returns the variables that a node reads.

    >>> from ssduck.language.parser import parse
    >>> sorted(variables_of(parse("x = y + z{1.0};").statements[0]))
    ['y', 'z']
    """
    names = (node.name,) if isinstance(node, ast.Name | ast.TimeIndex) else ()
    names = (node.alias,) if isinstance(node, ast.QualifiedName) else names
    return frozenset(names).union(*map(variables_of, node.children()))


def aliases_of(query: ast.Query) -> list[str]:
    """Returns the aliases of a query's sources."""
    aliases = [
        source.alias or (f"source_{index + 1}" if index else "this")
        for index, source in enumerate(query.sources)
    ]
    if len(set(aliases)) == len(aliases):
        return aliases
    for index, alias in enumerate(aliases):
        if alias in aliases[:index]:
            raise ArgumentError(
                f"two sources have the name {alias!r}; write FROM a={alias}, b=…",
                span=query.sources[index].span,
            )
    return aliases


def constant_parts(query: ast.Query, changed: Collection[str], *, of_past: bool) -> set[ast.Node]:
    """Returns the largest parts of a query that are constant for all rows, and worth caching."""
    aliases = {None, *aliases_of(query)}
    constants: set[ast.Node] = set()

    def collect(node: ast.Node) -> None:
        is_constant = (
            not free_aliases(node) & aliases and not is_impure(node) and not mentions(node, changed)
        )
        if of_past and not isinstance(node, ast.Query) and calls_of(node):
            is_constant = False
        if is_constant:
            if not isinstance(node, ast.This | ast.Name | ast.Placeholder | ast.Literal):
                constants.add(node)
            return
        if not isinstance(node, ast.Query):
            for child in node.children():
                collect(child)

    for part in query.children():
        collect(part)
    return constants


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


def with_overrides(program: ast.Program, names: Collection[str]) -> ast.Program:
    """Returns a program in which calls of replaced functions are calls of users' functions."""

    def change(part: ast.Node) -> ast.Node | None:
        match part:
            case ast.Call(name=name, arguments=arguments) if name in names:
                return replace(part, name=marked_name(name), arguments=changed(arguments))
            case ast.Unary(operator=sign, operand=operand) if UNARY_NAMES.get(sign) in names:
                return _call(part, UNARY_NAMES[sign], changed((operand,)))
            case ast.Binary(operator=sign, left=left, right=right) if (
                BINARY_NAMES.get(sign) in names
            ):
                # The container comes first, as in Python's `operator.contains`.
                sides = (right, left) if sign == "IN" else (left, right)
                return _call(part, BINARY_NAMES[sign], changed(sides))
            case ast.OperatorChain(operators=operators, operands=operands):
                signs = tuple(_sign(sign, names) for sign in operators)
                return replace(part, operators=signs, operands=changed(operands))
        return None

    def changed(parts: tuple[ast.Node, ...]) -> tuple[ast.Node, ...]:
        return tuple(part.replaced(change) for part in parts)

    return replace(program, statements=changed(program.statements))


def _sign(sign: str, names: Collection[str]) -> str:
    return marked_name(BINARY_NAMES[sign]) if BINARY_NAMES[sign] in names else sign


def _call(part: ast.Node, name: str, arguments: tuple[ast.Node, ...]) -> ast.Call:
    return ast.Call(part.span, marked_name(name), arguments, part.span)
