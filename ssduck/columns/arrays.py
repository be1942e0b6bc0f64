"""Operations on arrays of numpy, for expressions of many rows.

Expressions that differ only in their constants have the same *shape*. The constants are *slots* of
the shape, and k expressions of one shape are evaluated at once: a slot is an array (k, 1), a column
of n rows is (n,), and the values are (k, n), or (1, n) where they are the same for all k.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from itertools import count
from typing import Any, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt
from sqlglot import exp

from ssduck.columns.compiler import (
    Compiler,
    Compute,
    Expression,
    Kind,
    LeftToDuckDBError,
    Parts,
)
from ssduck.geometry.arrays import Flags, Indices
from ssduck.language.operators import is_like
from ssduck.sql.relation_calls import PairCall
from ssduck.sql.relations.geometry_query import MARGINS_UDF, GeometryUdf
from ssduck.sql.relations.registry import GEOMETRY_UDFS, RELATIONS

# The values of an expression: (k, n), or what numpy broadcasts to that.
Array: TypeAlias = npt.NDArray[Any]


class Calls(Protocol):
    """The interface of the narrow phase to expressions."""

    def values(self, udf: GeometryUdf, arguments: Sequence[Array], places: Indices) -> Array:
        """Returns the values of a function of shapes, (m,).

        Args:
            udf: the function.
            arguments: the ids of entities, and the numbers, (m,) each.
            places: (m,), their places among the n rows of k expressions, one after the other.
        """

    @property
    def margins(self) -> float:
        """The largest distance, m, of shapes that touch by their margins."""


# Returns the values of a function from those of its arguments.
Kernel: TypeAlias = "Callable[[ArrayValues, Sequence[Array]], Array]"


class ArrayValues(dict[Any, Array]):
    """The values of leaves by key, each read when it is first needed.

    Args:
        left: (n,), becomes True where a value is not known that matters; None if that is an error.
        is_checked: whether numbers are checked; else the caller learns of NaN from numpy.
    """

    def __init__(
        self,
        read: Callable[[Any], Array],
        count: int,
        calls: Calls,
        left: Flags | None = None,
        *,
        is_checked: bool = True,
    ) -> None:
        super().__init__()
        self._read = read
        self.count, self.calls = count, calls
        self.left, self.is_checked = left, is_checked
        # The places at which values matter, (k, n) or (1, n); None for all.
        self.active: Flags | None = None
        # The values of common parts by key, with the places for which they were computed.
        self.computed: dict[str, tuple[Flags | None, Array]] = {}

    def __missing__(self, key: Any) -> Array:
        """Reads the values of a leaf."""
        values = self[key] = self._read(key)
        return values

    def narrowed(self, places: Flags, part: Compute) -> Array:
        """Returns the values of an expression that matter at some places only."""
        before = self.active
        self.active = places if before is None else before & places
        try:
            values: Array = part(self)
        finally:
            self.active = before
        return values

    def needs(self, places: Flags) -> bool:
        """Checks whether a value at one of some places matters."""
        return bool((places if self.active is None else places & self.active).any())

    def leave(self, places: Flags) -> None:
        """Leaves the values at some places to others, if any of them matters."""
        if not self.needs(places):
            return
        if self.left is None:
            raise LeftToDuckDBError
        matter = places if self.active is None else places & self.active
        self.left |= np.broadcast_to(matter, (len(np.atleast_2d(matter)), self.count)).any(axis=0)


_LIKE = np.frompyfunc(is_like, 2, 1)
# Functions that the C library and numpy have, by their names in the first one.
_REAL_FUNCTIONS: dict[str, Callable[..., Any]] = {
    **{name: getattr(np, name) for name in ("exp", "log", "sin", "cos", "tan", "tanh")},
    **{name: getattr(np, f"arc{name[1:]}") for name in ("asin", "acos", "atan", "atan2")},
    "pow": np.power,
}
_CHECKED = frozenset(("+", "-", "*", "power", "sqrt"))
_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "power": np.power,
    "%": np.fmod,
    "=": operator.eq,
    "<>": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "like": lambda a, b: np.asarray(_LIKE(a, b), dtype=np.bool_),
    "not": operator.invert,
    "double": lambda part: np.asarray(part, dtype=np.float64),
    "integer": lambda part: np.asarray(part, dtype=np.int64),
    "negative": operator.neg,
    "abs": np.abs,
    "isfinite": np.isfinite,
    "sqrt": np.sqrt,
}


class ArrayOperations:
    """Operations on arrays of the rows of a world's table.

    What is not a number, or DuckDB may take for an error, is left to it, where it matters.

    Args:
        is_exact: whether functions have the last bit of the C library, which DuckDB uses; numpy's
            are many times as fast, and may differ there.
    """

    def __init__(
        self, schema: str, kernels: Mapping[str, Kernel] | None = None, *, is_exact: bool = True
    ) -> None:
        self._schema, self._kernels = schema, kernels or {}
        self._apply = _by_c_library if is_exact else _by_numpy
        self._keys = (f"shared {number}" for number in count())

    def constant(self, value: Any) -> Compute:
        constant = np.array([[value]])
        return lambda _: constant

    def once(self, part: Expression) -> Compute:
        if part.has_calls:  # what matters of it differs from place to place
            return part.compute
        key, inner = next(self._keys), part.compute

        def compute(values: ArrayValues) -> Array:
            checked, known = values.computed.get(key, (None, None))
            # What is no number is found only where it matters.
            if known is None or not (checked is None or checked is values.active):
                known = inner(values)
                values.computed[key] = values.active, known
            return known

        return compute

    def applied(self, name: str, *parts: Compute) -> Compute:
        if name in _REAL_FUNCTIONS:
            apply = self._apply
            return lambda values: apply(values, name, *[part(values) for part in parts])
        function = _FUNCTIONS[name]
        is_checked = name in _CHECKED

        def compute(values: ArrayValues) -> Array:
            result = np.asarray(function(*[part(values) for part in parts]))
            return _known(result, values) if is_checked else result

        return compute

    def quotient(self, a: Compute, b: Compute) -> Compute:
        def compute(values: ArrayValues) -> Array:
            divisor = b(values)
            if values.is_checked:
                values.leave(divisor == 0.0)
            return _known(a(values) / divisor, values)

        return compute

    def extreme(self, compare: Callable[[Any, Any], Any], parts: Parts) -> Compute:
        def compute(values: ArrayValues) -> Array:
            result: Array = parts[0](values)
            for part in parts[1:]:
                other = part(values)
                result = np.where(compare(other, result), other, result)
            return result

        return compute

    def both(self, first: Expression, second: Expression) -> Compute:
        return self._combined(first, second, is_and=True)

    def either(self, first: Expression, second: Expression) -> Compute:
        return self._combined(first, second, is_and=False)

    def _combined(self, first: Expression, second: Expression, *, is_and: bool) -> Compute:
        if first.has_calls and not second.has_calls:  # the narrow phase has the last word
            first, second = second, first
        a, b = first.compute, second.compute

        def compute(values: ArrayValues) -> Array:
            known = np.atleast_2d(a(values))
            other = values.narrowed(known if is_and else ~known, b)
            result: Array = known & other if is_and else known | other
            return result

        return compute

    def case(self, branches: Sequence[tuple[Compute, Compute]], otherwise: Compute) -> Compute:
        def compute(values: ArrayValues) -> Array:
            left = np.ones((1, values.count), np.bool_)
            result: Array | None = None
            for condition, part in branches:
                holds = left & values.narrowed(left, condition)
                result = _chosen(holds, part, result, values)
                left = left & ~holds
            if values.needs(left):
                result = _chosen(left, otherwise, result, values)
            assert result is not None
            return result

        return compute

    def left(self) -> Compute:
        def compute(values: ArrayValues) -> Array:
            values.leave(np.ones((1, 1), np.bool_))
            return np.zeros((1, 1), np.bool_)

        return compute

    def listed(self, parts: Parts) -> Compute:
        """Returns lists, (k, n, length)."""

        def compute(values: ArrayValues) -> Array:
            columns = [np.atleast_2d(part(values)) for part in parts]
            columns.append(np.broadcast_to(0.0, (1, values.count)))
            return np.stack(np.broadcast_arrays(*columns)[:-1], axis=-1)

        return compute

    def element(self, whole: Compute, index: int) -> Compute:
        return lambda values: whole(values)[..., index]

    def knows(self, function: str, arguments: Sequence[exp.Expr]) -> bool:
        if function in self._kernels:
            return True
        world = arguments[0] if arguments else None
        if not (isinstance(world, exp.Literal) and world.name == self._schema):
            return False
        udf = GEOMETRY_UDFS.get(function)
        return function == MARGINS_UDF or (udf is not None and udf.entities > 0)

    def call(self, function: str, arguments: Parts) -> Compute:
        if function in self._kernels:
            kernel = self._kernels[function]
            return lambda values: kernel(values, [part(values) for part in arguments])
        if function == MARGINS_UDF:
            return lambda values: np.array([[values.calls.margins]])
        udf = GEOMETRY_UDFS[function]
        last = 2 + 2 * udf.entities  # each entity has its tick and its id
        read = (*arguments[2:last:2], *arguments[last - 1 :])

        kind = np.bool_ if udf.result == "BOOLEAN" else np.float64

        def compute(values: ArrayValues) -> Array:
            given = [np.asarray(part(values)) for part in read]
            needed = np.ones((1, values.count), np.bool_)
            if values.active is not None:
                needed = needed & values.active
            shape = np.broadcast_shapes(needed.shape, *(argument.shape for argument in given))
            places = np.flatnonzero(np.broadcast_to(needed, shape))
            result: Array = np.zeros(shape, kind)
            if len(places):
                chosen = [np.broadcast_to(argument, shape).ravel()[places] for argument in given]
                result.ravel()[places] = values.calls.values(udf, chosen, places)
            return result

        return compute

    def pair(self, pair: PairCall, compiler: Compiler) -> Expression | None:
        kernel = self._kernels.get(pair.relation)
        if kernel is None or pair.call is not None:
            return None  # of many pairs, the boxes in the formula leave out most
        ids = [compiler.integer(id) for id in pair.ids]
        kind: Kind = "boolean" if RELATIONS[pair.relation].result == "boolean" else "double"
        return Expression(kind, lambda values: kernel(values, [part(values) for part in ids]))


def _known(result: Array, values: ArrayValues) -> Array:
    """Returns numbers; DuckDB compares NaN in another way."""
    if values.is_checked:
        values.leave(np.isnan(result))
    return result


def _chosen(holds: Flags, part: Compute, others: Array | None, values: ArrayValues) -> Array:
    """Returns the values of a part where a condition holds, and others elsewhere."""
    own = values.narrowed(holds, part)
    if others is None:
        others = np.zeros_like(own)
    if own.ndim > 2 or others.ndim > 2:
        if own.shape[-1] != others.shape[-1]:
            raise LeftToDuckDBError
        holds = holds[..., None]
    return np.where(holds, own, others)


def _by_c_library(values: ArrayValues, name: str, *parts: Any) -> Array:
    """Returns the values of a function as the C library computes them: rarely, numpy's differ."""
    del values
    columns = np.broadcast_arrays(*(np.asarray(part, dtype=np.float64) for part in parts))
    try:
        function = getattr(math, name)
        numbers = list(map(function, *(column.ravel().tolist() for column in columns)))
    except (OverflowError, ValueError):
        raise LeftToDuckDBError from None
    return np.array(numbers).reshape(columns[0].shape)


def _by_numpy(values: ArrayValues, name: str, *parts: Any) -> Array:
    numbers = (np.asarray(part, dtype=np.float64) for part in parts)
    return _known(_REAL_FUNCTIONS[name](*numbers), values)
