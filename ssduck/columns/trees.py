"""Makes functions of arrays of the parts of a tree that the translator leaves to Python."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from sqlglot import exp

from ssduck.columns.arrays import Array, ArrayOperations, ArrayValues
from ssduck.columns.compiler import (
    NUMBERS,
    Compiler,
    Compute,
    Expression,
    Kind,
    LeftToDuckDBError,
    applied,
    checked,
    double,
    joined,
)
from ssduck.language import ast
from ssduck.language.builtins import EXTREMES_OF_MARGINS, MARGIN_OF_TRUTH, UNIT_OF_SCALE

# The functions of numbers and the operators that `ArrayOperations.applied` has.
_NUMBER_FUNCTIONS = frozenset(
    ("exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "tanh", "sqrt", "abs")
)
_COMPARISONS = {"==": "=", "!=": "<>", **{sign: sign for sign in ("=", "<>", "<", "<=", ">", ">=")}}
_ARITHMETIC = {"^": "power", "**": "power", **{sign: sign for sign in "+-*"}}
_KINDS: dict[str, Kind] = {
    "f": "double",
    "i": "integer",
    "u": "integer",
    "b": "boolean",
    "U": "string",
    "O": "object",
}


def kind_of(value: Any) -> Kind:
    """Returns the type of the elements of an array of such values."""
    kind = _KINDS.get(np.asarray(value).dtype.kind)
    if kind is None or np.ndim(value):
        raise LeftToDuckDBError
    return kind


@dataclass(frozen=True)
class TreeCompiler:
    """Makes functions of the parts of a tree that the translator leaves to Python."""

    operations: ArrayOperations  # operations on arrays
    compiler: Compiler | None  # compiles the SQL of parts; None if there is no such part
    sql: Mapping[ast.Node, exp.Expr]  # the SQL of the parts that have some
    given: Callable[[ast.Placeholder], Expression]  # returns a placeholder as an expression
    variable: Callable[[ast.Name], Expression]  # returns a variable as an expression

    def of(self, node: ast.Node) -> Expression:
        """Returns an expression as a function."""
        if self.compiler is not None and node in self.sql:
            return self.compiler.expression(self.sql[node])
        match node:
            case ast.Placeholder():
                return self.given(node)
            case ast.Name():
                return self.variable(node)
            case ast.Literal(value=value):
                return Expression(kind_of(value), self.operations.constant(value))
            case ast.ListLiteral(items=items):
                parts = [self._double(item) for item in items]
                return joined("list", self.operations.listed(_computes(parts)), *parts)
            case ast.Index(base=base, indices=(ast.Literal(value=int() as index),)) if index >= 0:
                whole = self._of_kind(base, "list")
                return joined("double", self.operations.element(whole.compute, index), whole)
            case ast.Unary(operator=word, operand=operand) if word.lower() == "not":
                return applied(self.operations, "boolean", "not", self._of_kind(operand, "boolean"))
            case ast.Unary(operator="-", operand=operand):
                part = checked(self.of(operand), NUMBERS)
                return applied(self.operations, part.kind, "negative", part)
            case ast.Binary(operator=word, left=left, right=right):
                return self._binary(word.lower(), self.of(left), self.of(right))
            case ast.OperatorChain(operators=words, operands=operands):
                result = self.of(operands[0])
                for word, operand in zip(words, operands[1:], strict=True):
                    result = self._binary(word.lower(), result, self.of(operand))
                return result
            case ast.If(condition=condition, then=(then,), otherwise=(otherwise,), else_ifs=()):
                return self._if(condition, then, otherwise)
            case ast.Call(name=name, arguments=arguments):
                return self._call(name, arguments)
        raise LeftToDuckDBError

    def _of_kind(self, node: ast.Node, kind: Kind) -> Expression:
        return checked(self.of(node), (kind,))

    def _double(self, node: ast.Node) -> Expression:
        return double(self.operations, self.of(node))

    def _binary(self, word: str, left: Expression, right: Expression) -> Expression:
        operations, parts = self.operations, [left, right]
        if word in ("and", "or"):
            left, right = checked(left, ("boolean",)), checked(right, ("boolean",))
            combine = operations.both if word == "and" else operations.either
            return joined("boolean", combine(left, right), *parts)
        left, right = checked(left, NUMBERS), checked(right, NUMBERS)
        if word in _COMPARISONS:
            return applied(self.operations, "boolean", _COMPARISONS[word], left, right)
        if "double" not in (left.kind, right.kind):
            raise LeftToDuckDBError
        first, second = double(operations, left), double(operations, right)
        if word in _ARITHMETIC:
            return applied(self.operations, "double", _ARITHMETIC[word], first, second)
        if word != "/":
            raise LeftToDuckDBError
        return joined("double", operations.quotient(first.compute, second.compute), *parts)

    def _if(self, condition: ast.Node, then: ast.Node, otherwise: ast.Node) -> Expression:
        holds = self._of_kind(condition, "boolean")
        first, second = self.of(then), self.of(otherwise)
        if first.kind != second.kind:
            first, second = double(self.operations, first), double(self.operations, second)
        compute = self.operations.case([(holds.compute, first.compute)], second.compute)
        return replace(joined(first.kind, compute, holds, first, second), has_calls=True)

    def _call(self, name: str, arguments: Sequence[ast.Node]) -> Expression:
        """Returns a call of a function of numbers."""
        operations = self.operations
        name = EXTREMES_OF_MARGINS.get(name, name)
        if name in ("norm", "min", "max", "sum", "avg") and len(arguments) == 1:
            return self._of_list(name, arguments[0])
        if name == MARGIN_OF_TRUTH:
            infinity = ast.Literal(arguments[0].span, float("inf"))
            return self._if(arguments[0], infinity, ast.Unary(infinity.span, "-", infinity))
        if name == UNIT_OF_SCALE:  # what is not above 0 is left to others, as a quotient by 0 is
            unit = self._double(arguments[0])
            is_above = self._binary(">", unit, self.of(ast.Literal(arguments[0].span, 0)))
            divisor = applied(self.operations, "double", "double", is_above)
            compute = operations.quotient(unit.compute, divisor.compute)
            return joined("double", compute, unit, divisor)
        if name == "int" and self.of(arguments[0]).kind == "boolean":
            return applied(self.operations, "integer", "integer", self.of(arguments[0]))
        parts = [self._double(argument) for argument in arguments]
        if name in _NUMBER_FUNCTIONS and len(parts) == 1:
            return applied(self.operations, "double", name, *parts)
        if name in ("atan2", "pow"):
            return applied(self.operations, "double", "power" if name == "pow" else name, *parts)
        if name == "float":
            return parts[0]
        if name != "clip":
            raise LeftToDuckDBError
        number, low, high = _computes(parts)
        above = operations.extreme(operator.gt, [number, low])
        return joined("double", operations.extreme(operator.lt, [above, high]), *parts)

    def _of_list(self, name: str, argument: ast.Node) -> Expression:
        """Returns a function of the numbers in a list."""
        if isinstance(argument, ast.ListLiteral) and argument.items and name in ("min", "max"):
            parts = [self._double(item) for item in argument.items]
            compare = operator.lt if name == "min" else operator.gt
            compute = self.operations.extreme(compare, _computes(parts))
            return joined("double", compute, *parts)
        part = self._of_kind(argument, "list")

        def compute_list(values: ArrayValues) -> Array:
            numbers = part.compute(values)
            if numbers.shape[-1] == 0:
                raise LeftToDuckDBError
            match name:
                case "norm":
                    result = np.sqrt(_sum(numbers * numbers))
                case "min":
                    result = numbers.min(axis=-1)
                case "max":
                    result = numbers.max(axis=-1)
                case _:
                    result = _sum(numbers)
                    if name == "avg":
                        result = result / numbers.shape[-1]
            return np.asarray(result)

        return joined("double", compute_list, part)


def _computes(parts: Sequence[Expression]) -> list[Compute]:
    return [part.compute for part in parts]


def _sum(lists: Array) -> Array:
    """Returns the sums of short lists, (…, length): over such an axis, numpy's take far longer."""
    total: Array = lists[..., 0]
    for place in range(1, lists.shape[-1]):
        total = total + lists[..., place]
    return total
