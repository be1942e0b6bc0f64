"""Operations on Python's numbers, for expressions of one row.

The values of leaves are a dict. Nothing is NULL: what may be, and overflows and NaN, which DuckDB
compares in its own way, is left to DuckDB.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from itertools import count
from typing import Any

from sqlglot import exp

from ssduck.columns.compiler import (
    Compiler,
    Compute,
    Expression,
    Kind,
    LeftToDuckDBError,
    Parts,
    Values,
)
from ssduck.language.operators import is_like
from ssduck.sql.relation_calls import PairCall
from ssduck.sql.relations.registry import GEOMETRY_UDFS, RELATIONS


def known(value: float) -> float:
    """Returns a number; DuckDB compares NaN in its own way."""
    if math.isnan(value):
        raise LeftToDuckDBError
    return value


def finite(value: float) -> float:
    """Returns a finite number; whether an overflow is an error is left to DuckDB."""
    if not math.isfinite(value):
        raise LeftToDuckDBError
    return value


def _checked(operate: Callable[[Any, Any], Any]) -> Callable[[Any, Any], float]:
    """Returns a sum, a difference or a product: an integer becomes a double without rounding."""

    def compute(x: Any, y: Any) -> float:
        result: float = operate(x, y)
        if math.isfinite(result):
            return result
        # The box of a plane is infinite, and so are its sums with other numbers.
        is_infinite = math.isinf(x) or math.isinf(y)
        return known(result) if is_infinite else finite(result)

    return compute


_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "+": _checked(operator.add),
    "-": _checked(operator.sub),
    "*": _checked(operator.mul),
    # The remainder has the sign of the number.
    "%": lambda number, divisor: number % divisor if number >= 0 else -(-number % divisor),
    "=": operator.eq,
    "<>": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "like": is_like,
    "not": operator.not_,
    "double": float,
    "integer": int,
    "negative": operator.neg,
    "abs": abs,
    "isfinite": math.isfinite,
    "sqrt": lambda number: finite(math.sqrt(number)),
    "pow": lambda number, exponent: finite(math.pow(number, exponent)),
    "atan2": math.atan2,
    "exp": math.exp,
    "sin": math.sin,
    "cos": math.cos,
    "tan": math.tan,
    "atan": math.atan,
    "tanh": math.tanh,
}


class NumberOperations:
    """Operations on Python's numbers."""

    def __init__(self, functions: Mapping[str, Callable[..., Any]]) -> None:
        self._functions = functions
        self._keys = (f"shared {number}" for number in count())

    def constant(self, value: Any) -> Compute:
        return lambda _: value

    def once(self, part: Expression) -> Compute:
        key, inner = next(self._keys), part.compute

        def compute(values: dict[Any, Any]) -> Any:
            if key not in values:
                values[key] = inner(values)
            return values[key]

        return compute

    def applied(self, name: str, *parts: Compute) -> Compute:
        function = _FUNCTIONS[name]
        if len(parts) == 1:
            (part,) = parts
            return lambda values: function(part(values))
        a, b = parts
        return lambda values: function(a(values), b(values))

    def quotient(self, a: Compute, b: Compute) -> Compute:
        return lambda values: finite(a(values) / b(values))

    def extreme(self, compare: Callable[[Any, Any], Any], parts: Parts) -> Compute:
        def compute(values: Values) -> float:
            result: float = parts[0](values)
            for part in parts[1:]:
                other = part(values)
                if compare(other, result):
                    result = other
            return result

        return compute

    def both(self, first: Expression, second: Expression) -> Compute:
        a, b = first.compute, second.compute
        return lambda values: a(values) and b(values)

    def either(self, first: Expression, second: Expression) -> Compute:
        a, b = first.compute, second.compute
        return lambda values: a(values) or b(values)

    def case(self, branches: Sequence[tuple[Compute, Compute]], otherwise: Compute) -> Compute:
        def compute(values: Values) -> Any:
            for holds, result in branches:
                if holds(values):
                    return result(values)
            return otherwise(values)

        return compute

    def left(self) -> Compute:
        def compute(_: Values) -> Any:
            raise LeftToDuckDBError

        return compute

    def listed(self, parts: Parts) -> Compute:
        return lambda values: [part(values) for part in parts]

    def element(self, whole: Compute, index: int) -> Compute:
        return lambda values: whole(values)[index]

    def knows(self, function: str, arguments: Sequence[exp.Expr]) -> bool:
        del arguments
        return function in self._functions

    def call(self, function: str, arguments: Parts) -> Compute:
        called, udf = self._functions[function], GEOMETRY_UDFS.get(function)
        is_condition = udf is not None and udf.result == "BOOLEAN"

        def compute(values: Values) -> Any:
            value = called(*[argument(values) for argument in arguments])
            if value is None:
                raise LeftToDuckDBError
            return bool(value) if is_condition else finite(float(value))

        return compute

    def pair(self, pair: PairCall, compiler: Compiler) -> Expression | None:
        if pair.call is None and pair.relation not in self._functions:
            return None
        first, second = (compiler.integer(id) for id in pair.ids)
        if pair.call is not None:  # the boxes of two entities need not be read
            call = compiler.expression(pair.call).compute
            return Expression(
                "boolean", lambda values: first(values) != second(values) and call(values)
            )
        function, schema = self._functions[pair.relation], pair.schema
        kind: Kind = "boolean" if RELATIONS[pair.relation].result == "boolean" else "double"

        def compute(values: Values) -> Any:
            value = function(schema, first(values), second(values))
            return value if kind == "boolean" else finite(value)

        return Expression(kind, compute)
