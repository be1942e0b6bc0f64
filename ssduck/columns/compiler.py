"""Makes functions of expressions of SQL: the one place that knows which ones have one right result.

These are comparisons, logic, sums, differences, products, quotients and roots of doubles, and whole
powers and angles of the platform's own mathematical library, which DuckDB uses, too.
"""

from __future__ import annotations

import math
import operator
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any, Literal, Protocol, TypeAlias

from sqlglot import exp

from ssduck.sql.relation_calls import PAIR_CALL, PairCall
from ssduck.sql.relations.registry import GEOMETRY_UDFS
from ssduck.sql.types import EXACT

# `decimal` is a literal with a point, which SQL compares exactly with other literals; `object` is
# any value that only passes through.
Kind: TypeAlias = Literal["double", "integer", "decimal", "boolean", "string", "list", "object"]
NUMBERS: tuple[Kind, ...] = ("double", "integer", "decimal")
# The values of leaves, which are parameters and columns, and of parts that were computed, by key.
Values: TypeAlias = Mapping[Any, Any]
# Returns the value of an expression.
Compute: TypeAlias = Callable[[Any], Any]


class LeftToDuckDBError(Exception):
    """An expression, or a value, that DuckDB evaluates."""


@dataclass(frozen=True)
class Expression:
    """An expression as a function."""

    kind: Kind  # the type of its value
    compute: Compute  # a function of the values of leaves that returns its value
    # Whether it asks for shapes or contacts, which costs more than all else.
    has_calls: bool = False


# The functions of one value or two that `Operations.applied` has, by their forms in SQL.
_COMPARISONS: dict[type[exp.Expr], str] = {
    exp.EQ: "=",
    exp.NEQ: "<>",
    exp.LT: "<",
    exp.LTE: "<=",
    exp.GT: ">",
    exp.GTE: ">=",
    exp.Like: "like",  # of texts alone
}
_ARITHMETIC: dict[type[exp.Expr], str] = {exp.Add: "+", exp.Sub: "-", exp.Mul: "*"}
# Functions that SQL and Python take from C, with the same results to the last digit.
_REAL_FUNCTIONS = frozenset(("exp", "sin", "cos", "tan", "atan", "tanh"))
_EXTREMES = {
    **dict.fromkeys(("list_min", "arraymin"), operator.le),
    **dict.fromkeys(("list_max", "arraymax"), operator.ge),
}
# Expressions that are as fast to evaluate again as to look up.
_LEAVES = (exp.Parameter, exp.Column, exp.Literal, exp.Boolean)
# Literals of more digits may round in another way as a DECIMAL.
_MAX_DIGITS = 15

# Returns the expression of a parameter or a column; None for one that is not known.
Leaves: TypeAlias = Callable[[exp.Expr], Expression | None]
Parts: TypeAlias = Sequence[Compute]


class Operations(Protocol):
    """What the values of expressions are computed by: `numbers` or `arrays`."""

    def constant(self, value: Any) -> Compute:
        """Returns a value that is always the same."""

    def once(self, part: Expression) -> Compute:
        """Returns a value that is computed once for the same leaves."""

    def applied(self, name: str, *parts: Compute) -> Compute:
        """Returns the value of a function or an operator of one value or two, by its name.

        Of `+ - * power` one operand is a double; what is no number is left to DuckDB.
        """

    def quotient(self, a: Compute, b: Compute) -> Compute:
        """Returns a quotient of doubles; a division by zero is left to DuckDB."""

    def extreme(self, compare: Callable[[Any, Any], Any], parts: Parts) -> Compute:
        """Returns the least or the greatest of some numbers, the last one of several."""

    def both(self, first: Expression, second: Expression) -> Compute:
        """Returns whether both of two conditions hold; the second is computed where needed."""

    def either(self, first: Expression, second: Expression) -> Compute:
        """Returns whether one of two conditions holds; the second is computed where needed."""

    def case(self, branches: Sequence[tuple[Compute, Compute]], otherwise: Compute) -> Compute:
        """Returns the value of the first condition that holds, computed where it holds alone."""

    def left(self) -> Compute:
        """Returns what DuckDB has to evaluate wherever it is needed."""

    def listed(self, parts: Parts) -> Compute:
        """Returns a list of doubles."""

    def element(self, whole: Compute, index: int) -> Compute:
        """Returns an element of a list, counted from 0."""

    def knows(self, function: str, arguments: Sequence[exp.Expr]) -> bool:
        """Checks whether it can call a function of shapes or contacts, by its name in SQL."""

    def call(self, function: str, arguments: Parts) -> Compute:
        """Returns the value of a function of shapes or contacts."""

    def pair(self, pair: PairCall, compiler: Compiler) -> Expression | None:
        """Returns a relation of two rows of a tick by one call; None to evaluate its formula."""


class Compiler:
    """Makes functions of expressions of SQL."""

    def __init__(
        self, operations: Operations, leaves: Leaves, roots: Iterable[exp.Expr] = ()
    ) -> None:
        self._operations = operations
        self._leaf = leaves
        # How often each expression occurs, and that around the one that is being compiled.
        self._counts = Counter(part for whole in roots for part in whole.walk())
        self._count = 1
        self._shared: dict[exp.Expr, Expression] = {}
        self._left = Expression("boolean", operations.left())

    def expression(self, sql: exp.Expr) -> Expression:
        """Returns an expression as a function."""
        count = self._counts[sql]
        # The parts of one that occurs as often need no note of their own.
        if count <= self._count or isinstance(sql, _LEAVES):
            return self._compiled(sql)
        if sql not in self._shared:
            around, self._count = self._count, count
            try:
                part = self._compiled(sql)
            finally:
                self._count = around
            self._shared[sql] = replace(part, compute=self._operations.once(part))
        return self._shared[sql]

    def _compiled(self, sql: exp.Expr) -> Expression:
        """Returns an expression, whether or not it occurs again."""
        pair = sql.meta.get(PAIR_CALL)
        if isinstance(pair, PairCall):
            found = self._operations.pair(pair, self)
            if found is not None:
                return found
        match sql:
            case exp.Paren() | exp.Alias():
                return self.expression(sql.this)
            case exp.Parameter() | exp.Column():
                leaf = self._leaf(sql)
                if leaf is None:
                    raise LeftToDuckDBError
                return leaf
            case exp.Boolean():
                return self._constant("boolean", bool(sql.this))
            case exp.Literal():
                return self._literal(sql)
            case exp.Cast() if sql.to.sql("duckdb") == "DOUBLE":
                if isinstance(sql.this, exp.Literal) and sql.this.name == "infinity":
                    return self._constant("double", math.inf)
                return self._double(sql.this)
            case exp.Cast() if sql.to.sql("duckdb") == "BIGINT":
                return self.applied("integer", "integer", self._boolean(sql.this))
            case exp.Neg():
                part = self._number(sql.this)
                return self.applied(part.kind, "negative", part)
            case exp.Abs():
                return self.applied("double", "abs", self._number(sql.this, ("double",)))
            case exp.Pow() | exp.Sqrt() | exp.Atan2():
                return self._function(sql)
            case exp.Between() if not sql.args.get("symmetric"):
                low = exp.GTE(this=sql.this.copy(), expression=sql.args["low"].copy())
                high = exp.LTE(this=sql.this.copy(), expression=sql.args["high"].copy())
                return self._logic(exp.And(this=low, expression=high))
            case exp.In() if sql.expressions and not sql.args.get("query"):
                equal: list[exp.Expr] = [
                    exp.EQ(this=sql.this.copy(), expression=e.copy()) for e in sql.expressions
                ]
                return self._compiled(reduce(lambda a, b: exp.Or(this=a, expression=b), equal))
            case exp.Array():
                return self._list(sql)
            case exp.Anonymous() if self._operations.knows(sql.name, sql.expressions):
                return self._call(sql)
            case exp.Anonymous() if sql.name.lower() == "list_extract":
                return self._element(sql)
            case exp.Coalesce():  # nothing is NULL
                return self.expression(sql.this)
            case exp.IsNan() | exp.Is(expression=exp.Null()):  # so is no number NaN
                self.expression(sql.this)
                return self._constant("boolean", value=False)
            case exp.Div():
                a, b = self._number(sql.this, ("double",)), self._double(sql.expression)
                return joined("double", self._operations.quotient(a.compute, b.compute), a, b)
            case exp.Mod(expression=exp.Literal()) if sql.expression.name != "0":
                part, (kind, divisor) = (
                    self._number(sql.this, ("integer",)),
                    literal_of(sql.expression),
                )
                if kind != "integer":
                    raise LeftToDuckDBError
                return self.applied("integer", "%", part, self._constant(kind, divisor))
            case exp.And() | exp.Or() | exp.Not():
                return self._logic(sql)
            case exp.Case() if sql.this is None:
                return self._case(sql)
        if type(sql) in _ARITHMETIC:
            return self._arithmetic(sql)
        if type(sql) in _COMPARISONS:
            return self._comparison(sql)
        return self._named(sql)

    def _named(self, sql: exp.Expr) -> Expression:
        """Returns a call of one of DuckDB's own functions."""
        name = (sql.name if isinstance(sql, exp.Anonymous) else type(sql).__name__).lower()
        argument = sql.this if not isinstance(sql, exp.Anonymous) else sql.expressions[0]
        if name in _REAL_FUNCTIONS:
            return self.applied("double", name, self._double(argument))
        if name == "isfinite":
            return self.applied("boolean", "isfinite", self._number(argument, ("double",)))
        if name in _EXTREMES and isinstance(argument, exp.Array) and argument.expressions:
            parts = [self._number(part, ("double",)) for part in argument.expressions]
            computes = [part.compute for part in parts]
            compute = self._operations.extreme(_EXTREMES[name], computes)
            return joined("double", compute, *parts)
        raise LeftToDuckDBError

    def _constant(self, kind: Kind, value: Any) -> Expression:
        return Expression(kind, self._operations.constant(value))

    def _literal(self, sql: exp.Literal) -> Expression:
        return self._constant(*literal_of(sql))

    def _number(self, sql: exp.Expr, kinds: tuple[Kind, ...] = NUMBERS) -> Expression:
        return checked(self.expression(sql), kinds)

    def integer(self, sql: exp.Expr) -> Compute:
        """Returns an integer as a function."""
        return self._number(sql, ("integer",)).compute

    def _boolean(self, sql: exp.Expr) -> Expression:
        return checked(self.expression(sql), ("boolean",))

    def _double(self, sql: exp.Expr) -> Expression:
        return double(self._operations, self.expression(sql))

    def applied(self, kind: Kind, name: str, *parts: Expression) -> Expression:
        """Returns the value of a function or an operator, by its name."""
        return applied(self._operations, kind, name, *parts)

    def _arithmetic(self, sql: exp.Expr) -> Expression:
        """Returns a sum, a difference or a product of which one operand is a double."""
        left, right = self._number(sql.this), self._number(sql.expression)
        if "double" not in (left.kind, right.kind):
            raise LeftToDuckDBError
        return self.applied("double", _ARITHMETIC[type(sql)], left, right)

    def _function(self, sql: exp.Expr) -> Expression:
        """Returns a root, an angle, or a power whose exponent is a whole literal."""
        part = self._number(sql.this, ("double",))
        if isinstance(sql, exp.Atan2):
            other = self._number(sql.expression, ("double",))
            return self.applied("double", "atan2", part, other)
        if isinstance(sql, exp.Sqrt):
            return self.applied("double", "sqrt", part)
        exponent = sql.expression
        if not (isinstance(exponent, exp.Literal) and exponent.name.isdecimal()):
            raise LeftToDuckDBError
        return self.applied("double", "pow", part, self._constant("double", float(exponent.name)))

    def _comparison(self, sql: exp.Expr) -> Expression:
        """Returns a comparison of numbers, or of texts, by their code points or by LIKE."""
        left, right = self.expression(sql.this), self.expression(sql.expression)
        kinds = {left.kind, right.kind}
        are_texts, is_like = kinds == {"string"}, isinstance(sql, exp.Like)
        are_decimal = "decimal" in kinds and "double" not in kinds
        are_numbers = kinds <= set(NUMBERS) and not are_decimal and not is_like
        if not (are_texts or are_numbers):
            raise LeftToDuckDBError
        return self.applied("boolean", _COMPARISONS[type(sql)], left, right)

    def _logic(self, sql: exp.Expr) -> Expression:
        first, operations = self._boolean(sql.this), self._operations
        if isinstance(sql, exp.Not):
            return self.applied("boolean", "not", first)
        second = checked(self._unless_unknown(sql.expression), ("boolean",))
        combine = operations.both if isinstance(sql, exp.And) else operations.either
        return joined("boolean", combine(first, second), first, second)

    def _case(self, sql: exp.Case) -> Expression:
        """Returns the value of the first condition that holds; without ELSE, one of them has to."""
        conditions = [self._boolean(part.this) for part in sql.args["ifs"]]
        results = [self._unless_unknown(part.args["true"]) for part in sql.args["ifs"]]
        default = sql.args.get("default")
        otherwise = self._left if default is None else self._unless_unknown(default)
        kinds = {part.kind for part in (*results, otherwise) if part is not self._left}
        if len(kinds) != 1:
            raise LeftToDuckDBError
        branches = [
            (condition.compute, result.compute)
            for condition, result in zip(conditions, results, strict=True)
        ]
        compute = self._operations.case(branches, otherwise.compute)
        return replace(
            joined(kinds.pop(), compute, *conditions, *results, otherwise), has_calls=True
        )

    def _unless_unknown(self, sql: exp.Expr) -> Expression:
        """Returns an expression that may not be needed; where it is, DuckDB may have to decide."""
        try:
            return self.expression(sql)
        except LeftToDuckDBError:
            calls: Iterable[exp.Anonymous] = sql.find_all(exp.Anonymous)
            knows = self._operations.knows
            if all(knows(call.name, call.expressions) for call in calls):
                raise
            return self._left

    def _list(self, sql: exp.Array) -> Expression:
        """Returns a list of doubles."""
        parts = [self._number(part, ("double",)) for part in sql.expressions]
        if not parts:
            raise LeftToDuckDBError
        return joined("list", self._operations.listed([part.compute for part in parts]), *parts)

    def _element(self, sql: exp.Anonymous) -> Expression:
        """Returns an element of a parameter that is a list of doubles."""
        whole, place = sql.expressions
        if isinstance(whole, exp.Cast):
            whole = whole.this
        is_counted = isinstance(place, exp.Literal) and place.name.isdecimal() and place.name != "0"
        if not (isinstance(whole, exp.Parameter) and is_counted):
            raise LeftToDuckDBError
        part = checked(self.expression(whole), ("list",))
        return Expression("double", self._operations.element(part.compute, int(place.name) - 1))

    def _call(self, sql: exp.Anonymous) -> Expression:
        """Returns a call of a function of shapes."""
        udf = GEOMETRY_UDFS.get(sql.name)
        result = "DOUBLE" if udf is None else udf.result
        if result not in ("BOOLEAN", "DOUBLE"):
            raise LeftToDuckDBError
        # Behind the keys of entities, a function of shapes has numbers.
        count = len(sql.expressions) if udf is None else 1 + 2 * udf.entities
        parts = [self.expression(part) for part in sql.expressions[:count]]
        parts += [self._double(part) for part in sql.expressions[count:]]
        compute = self._operations.call(sql.name, [part.compute for part in parts])
        return Expression("boolean" if result == "BOOLEAN" else "double", compute, has_calls=True)


def joined(kind: Kind, compute: Compute, *parts: Expression) -> Expression:
    """Returns an expression of some parts."""
    return Expression(kind, compute, has_calls=any(part.has_calls for part in parts))


def checked(part: Expression, kinds: tuple[Kind, ...]) -> Expression:
    """Returns an expression whose type has to be one of some."""
    if part.kind not in kinds:
        raise LeftToDuckDBError
    return part


def applied(operations: Operations, kind: Kind, name: str, *parts: Expression) -> Expression:
    """Returns the value of a function or an operator, by its name."""
    return joined(kind, operations.applied(name, *[part.compute for part in parts]), *parts)


def double(operations: Operations, part: Expression) -> Expression:
    """Returns a number as a double."""
    is_double = checked(part, NUMBERS).kind == "double"
    return part if is_double else applied(operations, "double", "double", part)


def literal_of(sql: exp.Literal) -> tuple[Kind, Any]:
    """Returns a literal: a text, a double, a small integer, or a DECIMAL of few digits."""
    text = sql.name
    if sql.is_string:
        return "string", text
    if text.isdecimal() and int(text) < EXACT:
        return "integer", int(text)
    if "e" in text.lower():
        number = float(text)
        if not math.isfinite(number):
            raise LeftToDuckDBError
        return "double", number
    if text.isdecimal() or len(text) > _MAX_DIGITS:
        raise LeftToDuckDBError
    return "decimal", float(text)
