"""Evaluates SQL expressions over one table with numpy, where the result is DuckDB's bit for bit.

For the few rows of a tick, this takes microseconds where a statement takes hundreds. Only
operations with one correct result are evaluated here: comparisons, logic, sums, differences,
products and roots of doubles, and the powers of the platform's own mathematical library. All
others are left to DuckDB.

Expressions that differ only in their constants have the same *shape*. The constants are *slots* of
the shape, and k expressions of one shape are evaluated at once: a slot is an array (k, 1), a column
of n rows is (n,), and the values are (k, n), or (1, n) where they are the same for all k.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any, Literal, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt
from sqlglot import exp

from ssduck.schema import TABLES
from ssduck.sql.relations.geometry_query import MARGINS_UDF, GeometryUdf
from ssduck.sql.relations.registry import GEOMETRY_UDFS
from ssduck.sql.types import EXACT
from ssduck.world.live_tables import LiveTable

Kind: TypeAlias = Literal["double", "integer", "decimal", "string", "boolean", "list", "object"]
Number: TypeAlias = Literal["double", "integer"]
# The values of an expression: (k, n), or what numpy broadcasts to that.
Values: TypeAlias = npt.NDArray[Any]

_COLUMN_KINDS: dict[str, Kind] = {
    **{column.name: "double" for column in TABLES["entities"].columns if column.type == "double"},
    **{column.name: "integer" for column in TABLES["entities"].columns if column.type == "integer"},
    **dict.fromkeys(("name", "kind"), "string"),
    **dict.fromkeys(("enabled", "visible"), "boolean"),
}
NUMERIC_COLUMNS = [c.name for c in TABLES["entities"].columns if c.type in ("double", "integer")]
_COMPARISONS: dict[type[exp.Expr], Callable[[Any, Any], Any]] = {
    exp.EQ: operator.eq,
    exp.NEQ: operator.ne,
    exp.LT: operator.lt,
    exp.LTE: operator.le,
    exp.GT: operator.gt,
    exp.GTE: operator.ge,
}
_ARITHMETIC: dict[type[exp.Expr], Callable[[Any, Any], Any]] = {
    exp.Add: operator.add,
    exp.Sub: operator.sub,
    exp.Mul: operator.mul,
}
_NUMBERS = ("double", "integer", "decimal")
_TYPES = {"double": np.float64, "decimal": np.float64, "integer": np.int64, "string": np.object_}
# Literals of more digits may round in another way as a DECIMAL.
_MAX_DIGITS = 15
_LARGEST = 1 << 63


class NotArraysError(Exception):
    """An expression that DuckDB evaluates."""


@dataclass(frozen=True)
class Slot:
    """A constant of a shape, or a number of an entity that is the value of a variable.

    Attributes:
        kind: the type of its values.
        value: the constant, or the entity.
        column: the column of the entity; None for a constant.
    """

    kind: Kind
    value: Any
    column: str | None = None

    @property
    def key(self) -> tuple[Any, ...]:
        """A key that slots of equal values share; 0.0 and -0.0 differ."""
        value = self.value.id if self.column else repr(self.value)
        return self.kind, self.column, value

    @property
    def signature(self) -> tuple[Kind, str | None]:
        """What expressions of one shape have in common."""
        return self.kind, self.column


class TickArrays:
    """The columns of the entities of a tick as arrays.

    Args:
        table: the table of entities.

    Attributes:
        numbers: the columns of numbers by name.
    """

    def __init__(self, table: LiveTable) -> None:
        self.table = table
        self.numbers: dict[str, Values] = {}
        self._texts: dict[str, Values] = {}
        self._booleans: dict[str, Values] = {}
        self._version = -1

    def update(self) -> None:
        """Reads the columns of the table anew if it was replaced."""
        if self._version != self.table.version:
            self._version = self.table.version
            self._texts.clear()
            self._booleans.clear()
            self.numbers = {name: self.table[name] for name in NUMERIC_COLUMNS}

    def texts(self, name: str) -> Values:
        """Returns a column of texts."""
        if name not in self._texts:
            self._texts[name] = np.array(self.table.arrow[name].to_pylist(), dtype=object)
        return self._texts[name]

    def booleans(self, name: str) -> Values:
        """Returns a column of booleans."""
        if name not in self._booleans:
            self._booleans[name] = self.table.booleans(name).astype(np.bool_)
        return self._booleans[name]


class Calls(Protocol):
    """The interface of the narrow phase to expressions."""

    def values(
        self, udf: GeometryUdf, arguments: Sequence[Values], active: Values | None, count: int
    ) -> Values:
        """Returns the values of a function of shapes at the places that are active."""

    @property
    def margins(self) -> float:
        """The largest distance, m, of shapes that touch by their margins."""


class Operands(Protocol):
    """The values that expressions of one shape are evaluated over.

    Attributes:
        tick: the columns.
        active: the places at which values matter, (k, n) or (1, n); None for all.
        known: the values of parts that were evaluated already at this tick.
        fixed: those that stay the same until the table is replaced.
    """

    tick: TickArrays
    active: Values | None
    known: dict[str, Any]
    fixed: dict[str, Any]

    @property
    def calls(self) -> Calls:
        """The narrow phase."""

    @property
    def slots(self) -> Sequence[Values]:
        """The values of the slots, each (k, 1), or (1, 1) where all k are equal."""

    @property
    def fetched(self) -> Mapping[str, Values]:
        """The columns that DuckDB evaluated, by their text."""


@dataclass(frozen=True)
class ArrayExpression:
    """An expression that numpy evaluates.

    Attributes:
        kind: the type of its values.
        key: a text that identifies its shape, given the slots.
        values: a function that returns its values at a tick.
        is_fixed: whether its values are the same until the table is replaced.
        has_calls: whether they are computed only where they matter, by the narrow phase.
    """

    kind: Kind
    key: str
    values: Callable[[Operands], Any]
    is_fixed: bool = False
    has_calls: bool = False


class ArrayCompiler:
    """Makes array expressions, and collects their slots.

    Args:
        parameters: the slots of the SQL's parameters, by name.

        schema: the schema of their world.

    Attributes:
        slots: the slots of all expressions.
        columns: the columns that they read, also those of entities.
    """

    def __init__(self, parameters: Mapping[str, Slot], schema: str) -> None:
        self._parameters = parameters
        self._schema = schema
        self.slots: list[Slot] = []
        self.columns: set[str | None] = set()
        self._places: dict[tuple[Any, ...], int] = {}

    def expression(self, sql: exp.Expr) -> ArrayExpression:
        """Returns an SQL expression over the columns of the entities as a function of arrays.

        The numbers of the table must all be known.

        Raises:
            NotArraysError: DuckDB has to evaluate it.
        """
        if type(sql) in _COMPARISONS:
            return self._comparison(sql)
        if type(sql) in _ARITHMETIC:
            return self._arithmetic(sql)
        match sql:
            case exp.Paren():
                return self.expression(sql.this)
            case exp.Column():
                self.columns.add(sql.name)
                return _column(sql.name)
            case exp.Literal() if not sql.is_string:
                return self._slot(_number(sql))
            case exp.Parameter() if sql.name in self._parameters:
                return self._slot(_in_range(self._parameters[sql.name]))
            case exp.Boolean():
                constant = np.array([[bool(sql.this)]])
                return ArrayExpression("boolean", str(sql.this), lambda _: constant, is_fixed=True)
            case exp.And() | exp.Or():
                return self._logic(sql)
            case exp.Not():
                inner = self._boolean(sql.this)
                return ArrayExpression(
                    "boolean",
                    f"not {inner.key}",
                    lambda o: np.logical_not(inner.values(o)),
                    has_calls=inner.has_calls,
                )
            case exp.Between() if not sql.args.get("symmetric"):
                low = exp.GTE(this=sql.this.copy(), expression=sql.args["low"].copy())
                high = exp.LTE(this=sql.this.copy(), expression=sql.args["high"].copy())
                return self._logic(exp.And(this=low, expression=high))
            case exp.In() if sql.expressions and not sql.args.get("query"):
                equal: list[exp.Expr] = [
                    exp.EQ(this=sql.this.copy(), expression=e.copy()) for e in sql.expressions
                ]
                return self.expression(reduce(_either, equal))
            case exp.Neg():
                negated = self.expression(sql.this)
                if negated.kind != "double" and not isinstance(sql.this, exp.Literal):
                    raise NotArraysError
                return ArrayExpression(
                    negated.kind,
                    f"(- {negated.key})",
                    lambda o: -negated.values(o),
                    has_calls=negated.has_calls,
                )
            case exp.Cast() if sql.to.sql("duckdb") == "DOUBLE":
                cast = self.expression(sql.this)
                if cast.kind not in ("double", "decimal"):
                    raise NotArraysError
                return replace(cast, kind="double")
            case exp.Case() if sql.this is None:
                return self._case(sql)
            case exp.Anonymous():
                return self._call(sql)
            case exp.Sqrt() | exp.Pow():
                return self._function(sql)
            case exp.Array():
                return self._list(sql)
        raise NotArraysError

    def _slot(self, slot: Slot) -> ArrayExpression:
        """Returns a constant; equal ones share their slot."""
        self.columns.add(slot.column)
        place = self._places.setdefault(slot.key, len(self.slots))
        if place == len(self.slots):
            self.slots.append(slot)
        return ArrayExpression(slot.kind, f"${place}", lambda o: o.slots[place])

    def _boolean(self, sql: exp.Expr) -> ArrayExpression:
        """Returns a condition."""
        condition = self.expression(sql)
        if condition.kind != "boolean":
            raise NotArraysError
        return condition

    def _logic(self, sql: exp.Expr) -> ArrayExpression:
        """Returns AND or OR of two conditions, neither of which is ever NULL."""
        left, right = self._boolean(sql.this), self._boolean(sql.expression)
        is_and = isinstance(sql, exp.And)
        combine = np.logical_and if is_and else np.logical_or
        key = f"({left.key} {sql.key} {right.key})"
        if left.has_calls and not right.has_calls:  # the narrow phase has the last word
            left, right = right, left
        if not right.has_calls:
            return _once("boolean", key, lambda o: combine(left.values(o), right.values(o)))

        def values(o: Operands) -> Values:
            known = np.atleast_2d(left.values(o))
            with _active(o, known if is_and else ~known):
                result: Values = combine(known, right.values(o))
                return result

        return ArrayExpression("boolean", key, values, has_calls=True)

    def _case(self, sql: exp.Case) -> ArrayExpression:
        """Returns the value of the first condition that holds; one of them has to, or ELSE."""
        branches = [
            (self._boolean(b.this), self.expression(b.args["true"])) for b in sql.args["ifs"]
        ]
        default = sql.args.get("default")
        otherwise = None if default is None else self.expression(default)
        parts = [part for _, part in branches] + ([] if otherwise is None else [otherwise])
        kind = parts[0].kind
        if any(part.kind != kind for part in parts) or any(c.has_calls for c, _ in branches):
            raise NotArraysError
        keys = [f"{condition.key}: {part.key}" for condition, part in branches]
        keys += [] if otherwise is None else [otherwise.key]

        def values(o: Operands) -> Values:
            shape = (1, o.tick.table.count)
            left = np.ones(shape, np.bool_) if o.active is None else o.active
            result: Values = np.zeros(shape, np.bool_ if kind == "boolean" else np.float64)
            for condition, part in branches:
                holds = left & condition.values(o)
                with _active(o, holds):
                    result = np.where(holds, part.values(o), result)
                left = left & ~holds
            if otherwise is not None:
                with _active(o, left):
                    return np.where(left, otherwise.values(o), result)
            if left.any():  # it is NULL there
                raise NotArraysError
            return result

        return ArrayExpression(kind, f"case {'; '.join(keys)}", values, has_calls=True)

    def _call(self, sql: exp.Anonymous) -> ArrayExpression:
        """Returns a function of shapes; the narrow phase computes it where it matters."""
        name, arguments = sql.name.lower(), sql.expressions
        if not arguments or not arguments[0].is_string or arguments[0].name != self._schema:
            raise NotArraysError
        if name == MARGINS_UDF:
            return ArrayExpression("double", name, lambda o: np.array([[o.calls.margins]]))
        udf = GEOMETRY_UDFS.get(name)
        if udf is None or not udf.entities or udf.result not in ("BOOLEAN", "DOUBLE"):
            raise NotArraysError
        last = 2 + 2 * udf.entities  # each entity has its tick and its id
        parts = [self.expression(part) for part in (*arguments[2:last:2], *arguments[last - 1 :])]
        if any(part.kind not in _NUMBERS for part in parts):
            raise NotArraysError

        def values(o: Operands) -> Values:
            numbers = [np.asarray(part.values(o)) for part in parts]
            return o.calls.values(udf, numbers, o.active, o.tick.table.count)

        kind: Kind = "boolean" if udf.result == "BOOLEAN" else "double"
        key = f"{name}({', '.join(part.key for part in parts)})"
        return ArrayExpression(kind, key, values, has_calls=True)

    def _comparison(self, sql: exp.Expr) -> ArrayExpression:
        """Returns a comparison of numbers, or of a column of texts with a text."""
        compare, left_sql, right_sql = _COMPARISONS[type(sql)], sql.this, sql.expression
        left = self.expression(left_sql)
        if isinstance(right_sql, exp.Literal) and right_sql.is_string:
            if left.kind != "string" or type(sql) not in (exp.EQ, exp.NEQ):
                raise NotArraysError
            text = self._slot(Slot("string", right_sql.name))
            key = f"({left.key} {sql.key} {text.key})"

            def fixed_values(o: Operands) -> Values:
                if key not in o.fixed:
                    o.fixed[key] = compare(left.values(o), text.values(o)).astype(np.bool_)
                values: Values = o.fixed[key]
                return values

            return ArrayExpression("boolean", key, fixed_values, is_fixed=True)
        right = self.expression(right_sql)
        if not _are_comparable(left, right):
            raise NotArraysError
        key = f"({left.key} {sql.key} {right.key})"
        return _once(
            "boolean", key, lambda o: compare(left.values(o), right.values(o)), left, right
        )

    def _arithmetic(self, sql: exp.Expr) -> ArrayExpression:
        """Returns a sum, a difference or a product of which one operand is a double."""
        operate = _ARITHMETIC[type(sql)]
        left, right = self.expression(sql.this), self.expression(sql.expression)
        kinds = {left.kind, right.kind}
        if "double" not in kinds or not kinds <= set(_NUMBERS):
            raise NotArraysError

        def values(o: Operands) -> Any:
            return _no_nan(operate(left.values(o), right.values(o)))

        return _once("double", f"({left.key} {sql.key} {right.key})", values, left, right)

    def _function(self, sql: exp.Expr) -> ArrayExpression:
        """Returns a root, or a square: the power of the C library, as in DuckDB."""
        argument = self.expression(sql.this)
        if argument.kind != "double":
            raise NotArraysError
        if isinstance(sql, exp.Sqrt):
            # Negative numbers, for which DuckDB fails, become NaN.
            return _once(
                "double",
                f"sqrt {argument.key}",
                lambda o: _no_nan(np.sqrt(argument.values(o))),
                argument,
            )
        exponent = sql.expression
        if not (isinstance(exponent, exp.Literal) and exponent.name == "2"):
            raise NotArraysError
        return _once(
            "double", f"square {argument.key}", lambda o: _squares(argument.values(o)), argument
        )

    def _list(self, sql: exp.Array) -> ArrayExpression:
        """Returns a list of doubles for each row, (k, n, length)."""
        parts = [self.expression(part) for part in sql.expressions]
        if not parts or any(part.kind != "double" or part.has_calls for part in parts):
            raise NotArraysError

        def values(o: Operands) -> Values:
            columns = [np.atleast_2d(part.values(o)) for part in parts]
            columns.append(np.broadcast_to(0.0, (1, o.tick.table.count)))
            return np.stack(np.broadcast_arrays(*columns)[:-1], axis=-1)

        return ArrayExpression("list", f"[{', '.join(part.key for part in parts)}]", values)


def fetched_expression(text: str, *, is_condition: bool) -> ArrayExpression:
    """Returns an expression whose values DuckDB evaluates.

    Args:
        text: its text.
        is_condition: whether it is a condition on a row.
    """
    if is_condition:  # one that is NULL does not hold
        return ArrayExpression("boolean", text, lambda o: o.fetched[text].astype(np.bool_))
    return ArrayExpression("object", text, lambda o: o.fetched[text])


def slot_values(slots: Sequence[Slot]) -> Values:
    """Returns the constants in a slot of k formulas, (k, 1), or (1, 1) where all are equal."""
    if len({slot.key for slot in slots}) == 1:
        slots = slots[:1]
    return np.array([[slot.value] for slot in slots], dtype=_TYPES[slots[0].kind])


def _either(left: exp.Expr, right: exp.Expr) -> exp.Expr:
    return exp.Or(this=left, expression=right)


def _once(
    kind: Kind, key: str, compute: Callable[[Operands], Any], *parts: ArrayExpression
) -> ArrayExpression:
    """Returns an expression that is evaluated once at a tick, however often it occurs.

    That is not possible if its parts have calls.
    """
    if any(part.has_calls for part in parts):
        return ArrayExpression(kind, key, compute, has_calls=True)

    def values(o: Operands) -> Any:
        if key not in o.known:
            o.known[key] = compute(o)
        return o.known[key]

    return ArrayExpression(kind, key, values)


@contextmanager
def _active(operands: Operands, places: Values) -> Iterator[None]:
    """Restricts the places at which values matter."""
    before = operands.active
    operands.active = places if before is None else before & places
    try:
        yield
    finally:
        operands.active = before


def _column(name: str) -> ArrayExpression:
    """Returns a column of the entities."""
    match _COLUMN_KINDS.get(name):
        case "string":
            return ArrayExpression("string", name, lambda o: o.tick.texts(name), is_fixed=True)
        case "boolean":
            return ArrayExpression("boolean", name, lambda o: o.tick.booleans(name), is_fixed=True)
        case "integer" | "double" as kind:
            return ArrayExpression(
                kind, name, lambda o: o.tick.numbers[name], is_fixed=name == "id"
            )
    raise NotArraysError


def _number(literal: exp.Literal) -> Slot:
    """Returns a literal: a double, a small integer, or a DECIMAL of few digits."""
    text = literal.name
    if text.isdecimal():
        if int(text) >= EXACT:
            raise NotArraysError
        return Slot("integer", int(text))
    if "e" in text.lower():
        return Slot("double", float(text))
    if len(text) > _MAX_DIGITS:
        raise NotArraysError
    return Slot("decimal", float(text))


def _in_range(slot: Slot) -> Slot:
    """Returns a slot.

    Raises:
        NotArraysError: it is an integer that arrays do not hold.
    """
    if slot.kind == "integer" and slot.column is None and not -_LARGEST <= slot.value < _LARGEST:
        raise NotArraysError
    return slot


def _are_comparable(left: ArrayExpression, right: ArrayExpression) -> bool:
    """Checks whether DuckDB compares two numbers as integers or doubles."""
    kinds = {left.kind, right.kind}
    return kinds <= set(_NUMBERS) and ("decimal" not in kinds or "double" in kinds)


def _no_nan(values: Any) -> Any:
    """Returns values; DuckDB compares NaN in another way.

    Raises:
        NotArraysError: one of them is NaN.
    """
    if np.isnan(values).any():
        raise NotArraysError
    return values


def _squares(values: Any) -> Values:
    """Returns the squares of numbers as the C library computes them: rarely, x * x differs."""
    array = np.asarray(values, dtype=np.float64)
    try:
        squares = [math.pow(value, 2.0) for value in array.ravel().tolist()]
    except OverflowError:
        raise NotArraysError from None
    return np.array(squares).reshape(array.shape)
