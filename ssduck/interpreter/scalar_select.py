"""Evaluates SELECTs of one row in Python, where the values are DuckDB's bit for bit.

A condition on a few numbers takes DuckDB hundreds of microseconds, and Python some. Only operations
with one correct result are evaluated here: comparisons, logic, sums, differences, products,
quotients and roots of finite doubles, and whole powers by the platform's own mathematical library,
which DuckDB uses, too. All others are left to DuckDB, and so are overflows and NaN.
"""

from __future__ import annotations

import math
import operator
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from sqlglot import exp

from ssduck.sql.plan import Plan
from ssduck.sql.relation_calls import PAIR_CALL, PairCall
from ssduck.sql.relations.registry import GEOMETRY_UDFS, RELATIONS
from ssduck.sql.types import EXACT, SqlType

Kind: TypeAlias = Literal["double", "integer", "decimal", "boolean", "string", "list"]
# The values of parameters by name, and those of expressions that occur more than once.
Values: TypeAlias = dict[str, Any]
# A function from the values of parameters to that of an expression.
Compute: TypeAlias = Callable[[Values], Any]

# The clauses that such a SELECT may have; of one row, the order does not matter.
_CLAUSES = frozenset(("expressions", "from_", "order"))
_NUMBERS: tuple[Kind, ...] = ("double", "integer", "decimal")
_COMPARISONS: dict[type[exp.Expr], Callable[[Any, Any], bool]] = {
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
# The types of elements, by their names in the language.
_ELEMENTS: dict[str, Kind] = {"integer": "integer", "double": "double"}
# Expressions that are as fast to evaluate again as to look up.
_LEAVES = (exp.Parameter, exp.Column, exp.Literal, exp.Boolean)
# Literals of more digits may round in another way as a DECIMAL.
_MAX_DIGITS = 15


class _LeftToDuckDBError(Exception):
    """An expression, or a value, that DuckDB evaluates."""


@dataclass(frozen=True)
class _Scalar:
    """An expression that Python evaluates.

    Attributes:
        kind: the type of its value.
        compute: a function that returns its value.
    """

    kind: Kind
    compute: Compute


class ScalarSelect:
    """A SELECT of values that depend on parameters, without FROM or over a list of one element.

    Args:
        plan: its plan.
        functions: the functions of shapes that Python calls itself, by their names in SQL.

    Raises:
        ValueError: DuckDB has to evaluate it.
    """

    def __init__(self, plan: Plan, functions: Mapping[str, Callable[..., Any]]) -> None:
        try:
            kinds = _kinds_of(plan)
            self._list = _only_list(plan)
            compiler = _Compiler(plan, kinds, self._list, functions)
            self._columns = [compiler.scalar(part).compute for part in plan.select.expressions]
        except _LeftToDuckDBError:
            raise ValueError("DuckDB has to evaluate it") from None
        self._kinds = {name: kind for name, kind in kinds.items() if name in compiler.read}

    @property
    def parameters(self) -> Collection[str]:
        """The parameters that are read, besides the list."""
        return self._kinds.keys()

    def rows(self, parameters: Mapping[str, Any]) -> list[tuple[Any, ...]] | None:
        """Returns the rows that DuckDB would return; None if DuckDB has to evaluate them.

        Args:
            parameters: the values of the parameters.
        """
        values: dict[str, Any] = {}
        if self._list is not None:
            elements = parameters[self._list]
            if len(elements) != 1:
                return None
            values[self._list] = elements[0]
        try:
            for name, kind in self._kinds.items():
                value = parameters[name]
                # Most are doubles; a NaN differs from itself.
                is_number = kind == "double" and type(value) is float and value == value  # noqa: PLR0124
                values[name] = value if is_number else _checked(value, kind)
            return [tuple([column(values) for column in self._columns])]
        except Exception:  # noqa: BLE001  # DuckDB raises it, with its place in the program
            return None


def _only_list(plan: Plan) -> str | None:
    """Returns the parameter that is the list; None if there is no FROM.

    Raises:
        _LeftToDuckDBError: the SELECT reads something else.
    """
    select = plan.select
    lists = [binding for binding in plan.bindings if binding.source is not None]
    if (
        plan.paths
        or plan.tables
        or any(value for name, value in select.args.items() if name not in _CLAUSES)
        or len(lists) != len(plan.source_types)
    ):
        raise _LeftToDuckDBError
    if not lists:
        if select.args.get("from_") is not None:
            raise _LeftToDuckDBError
        return None
    source = plan.source_types[0].sql_type
    if len(lists) > 1 or lists[0].end or source is None or source.type not in _ELEMENTS:
        raise _LeftToDuckDBError
    return lists[0].name


def _kinds_of(plan: Plan) -> dict[str, Kind]:
    """Returns the types of the parameters by name, without the list.

    Raises:
        _LeftToDuckDBError: one of them has another type.
    """
    kinds: dict[str, Kind] = dict(plan.numbers)
    for binding in plan.bindings:
        if binding.source is None and binding.name not in kinds:
            kinds[binding.name] = _kind_of(binding.sql_type)
    return kinds


def _kind_of(sql_type: SqlType) -> Kind:
    """Returns the type of a parameter that is no number.

    Raises:
        _LeftToDuckDBError: it is no text, and no list of doubles.
    """
    element = sql_type.element
    if sql_type.type == "list" and element is not None and element.type == "double":
        return "list"
    if sql_type.type != "string":
        raise _LeftToDuckDBError
    return "string"


def _checked(value: Any, kind: Kind) -> Any:
    """Returns the value of a parameter."""
    if kind == "double" and type(value) in (float, int):
        return _number_of(float(value))
    if kind == "integer" and type(value) is int and abs(value) < EXACT:
        return value
    if kind == "string" and type(value) is str:
        return value
    if kind == "list" and set(map(type, value)) == {float}:
        return list(map(_number_of, value))
    raise _LeftToDuckDBError


def _number_of(value: float) -> float:
    """Returns a number; DuckDB compares NaN in its own way."""
    if math.isnan(value):
        raise _LeftToDuckDBError
    return value


def _finite(value: float) -> float:
    """Returns a finite number; whether an overflow is an error is left to DuckDB."""
    if not math.isfinite(value):
        raise _LeftToDuckDBError
    return value


class _Compiler:
    """Makes functions of the expressions of a SELECT.

    Args:
        plan: its plan.
        kinds: the types of the parameters by name.
        list_name: the parameter that is the list; None if there is none.
        functions: the functions that it calls, by their names in SQL.

    Attributes:
        read: the other parameters that the expressions read.
    """

    def __init__(
        self,
        plan: Plan,
        kinds: Mapping[str, Kind],
        list_name: str | None,
        functions: Mapping[str, Callable[..., Any]],
    ) -> None:
        self._kinds, self._functions = kinds, functions
        self.read: set[str] = set()
        # How often each expression occurs, and that around the one that is being compiled.
        self._counts = Counter(part for whole in plan.select.expressions for part in whole.walk())
        self._count = 1
        # The expressions that occur more than once; each is evaluated once.
        self._shared: dict[exp.Expr, _Scalar] = {}
        self._columns: dict[tuple[str, str], _Scalar] = {}
        if list_name is not None:
            (source,) = plan.source_types
            assert source.sql_type is not None
            element = _Scalar(_ELEMENTS[source.sql_type.type], operator.itemgetter(list_name))
            self._columns[source.alias, "value"] = element
            self._columns[source.alias, "n"] = _constant("integer", 1)

    def scalar(self, sql: exp.Expr) -> _Scalar:
        """Returns an expression that Python evaluates.

        Raises:
            _LeftToDuckDBError: DuckDB has to.
        """
        count = self._counts[sql]
        # The parts of one that occurs as often need no note of their own.
        if count <= self._count or isinstance(sql, _LEAVES):
            return self._compiled(sql)
        if sql not in self._shared:
            around, self._count = self._count, count
            self._shared[sql] = _once(self._compiled(sql), f"shared {len(self._shared)}")
            self._count = around
        return self._shared[sql]

    def _compiled(self, sql: exp.Expr) -> _Scalar:
        """Returns an expression that Python evaluates, whether or not it occurs again.

        Raises:
            _LeftToDuckDBError: DuckDB has to.
        """
        pair = sql.meta.get(PAIR_CALL)
        if isinstance(pair, PairCall) and pair.call is not None:
            return self._pair_of_shapes(pair.ids, pair.call)
        if isinstance(pair, PairCall) and pair.relation in self._functions:
            return self._pair(pair)
        match sql:
            case exp.Paren() | exp.Alias():
                return self.scalar(sql.this)
            case exp.Parameter() if sql.name in self._kinds:
                self.read.add(sql.name)
                return _Scalar(self._kinds[sql.name], operator.itemgetter(sql.name))
            case exp.Column() if (sql.table, sql.name) in self._columns:
                return self._columns[sql.table, sql.name]
            case exp.Boolean():
                return _constant("boolean", bool(sql.this))
            case exp.Literal():
                return _constant("string", sql.name) if sql.is_string else _number(sql.name)
            case exp.Cast() if sql.to.sql("duckdb") == "DOUBLE":
                if isinstance(sql.this, exp.Literal) and sql.this.name == "infinity":
                    return _constant("double", math.inf)
                return self._double(sql.this)
            case exp.Neg():
                return self._negated(sql)
            case exp.Abs():
                part = self._numeric(sql.this, ("double",))
                return _Scalar("double", lambda values: abs(part.compute(values)))
            case exp.Pow() | exp.Sqrt() | exp.Atan2():
                return self._function(sql)
            case exp.Between() if not sql.args.get("symmetric"):
                low = exp.GTE(this=sql.this.copy(), expression=sql.args["low"].copy())
                high = exp.LTE(this=sql.this.copy(), expression=sql.args["high"].copy())
                return self._logic(exp.And(this=low, expression=high))
            case exp.In() if sql.expressions and not sql.args.get("query"):
                return self._membership(sql)
            case exp.Array():
                return self._list_of(sql)
            case exp.Anonymous() if sql.name in self._functions:
                return self._call(sql)
            case exp.Anonymous() if sql.name.lower() == "list_extract":
                return self._element(sql)
            case exp.Div():
                return self._quotient(sql)
            case exp.And() | exp.Or() | exp.Not():
                return self._logic(sql)
            case exp.Case() if sql.this is None:
                return self._case(sql)
        if type(sql) in _ARITHMETIC:
            return self._arithmetic(sql)
        if type(sql) in _COMPARISONS:
            return self._comparison(sql)
        raise _LeftToDuckDBError

    def _numeric(self, sql: exp.Expr, kinds: tuple[Kind, ...] = _NUMBERS) -> _Scalar:
        part = self.scalar(sql)
        if part.kind not in kinds:
            raise _LeftToDuckDBError
        return part

    def _boolean(self, sql: exp.Expr) -> Compute:
        part = self.scalar(sql)
        if part.kind != "boolean":
            raise _LeftToDuckDBError
        return part.compute

    def _double(self, sql: exp.Expr) -> _Scalar:
        part = self._numeric(sql)
        if part.kind == "double":
            return part
        return _Scalar("double", lambda values: float(part.compute(values)))

    def _negated(self, sql: exp.Expr) -> _Scalar:
        kinds = _NUMBERS if isinstance(sql.this, exp.Literal) else ("double",)
        part = self._numeric(sql.this, kinds)
        return _Scalar(part.kind, lambda values: -part.compute(values))

    def _arithmetic(self, sql: exp.Expr) -> _Scalar:
        """Returns a sum, a difference or a product of which one operand is a double."""
        operate = _ARITHMETIC[type(sql)]
        left, right = self._numeric(sql.this), self._numeric(sql.expression)
        if "double" not in (left.kind, right.kind):
            raise _LeftToDuckDBError
        a, b = left.compute, right.compute

        def compute(values: Values) -> float:
            x, y = a(values), b(values)
            result: float = operate(x, y)  # an integer becomes a double without rounding
            if math.isfinite(result):
                return result
            # The box of a plane is infinite, and so are its sums with other numbers.
            is_infinite = math.isinf(x) or math.isinf(y)
            return _number_of(result) if is_infinite else _finite(result)

        return _Scalar("double", compute)

    def _quotient(self, sql: exp.Expr) -> _Scalar:
        """Returns a quotient of doubles; a division by zero is left to DuckDB."""
        a = self._numeric(sql.this, ("double",)).compute
        b = self._double(sql.expression).compute
        return _Scalar("double", lambda values: _finite(a(values) / b(values)))

    def _function(self, sql: exp.Expr) -> _Scalar:
        """Returns a root, an angle, or a power whose exponent is a whole literal."""
        part = self._numeric(sql.this, ("double",)).compute
        if isinstance(sql, exp.Atan2):
            other = self._numeric(sql.expression, ("double",)).compute
            return _Scalar("double", lambda values: math.atan2(part(values), other(values)))
        if isinstance(sql, exp.Sqrt):
            return _Scalar("double", lambda values: _finite(math.sqrt(part(values))))
        exponent = sql.expression
        if not (isinstance(exponent, exp.Literal) and exponent.name.isdecimal()):
            raise _LeftToDuckDBError
        power = float(exponent.name)
        return _Scalar("double", lambda values: _finite(math.pow(part(values), power)))

    def _comparison(self, sql: exp.Expr) -> _Scalar:
        """Returns a comparison of doubles or of integers, or whether texts are equal."""
        compare = _COMPARISONS[type(sql)]
        left, right = self.scalar(sql.this), self.scalar(sql.expression)
        are_texts = left.kind == right.kind == "string" and type(sql) in (exp.EQ, exp.NEQ)
        if not are_texts and not {left.kind, right.kind} <= set(_NUMBERS):
            raise _LeftToDuckDBError
        if "decimal" in (left.kind, right.kind) and "double" not in (left.kind, right.kind):
            raise _LeftToDuckDBError
        a, b = left.compute, right.compute
        return _Scalar("boolean", lambda values: compare(a(values), b(values)))

    def _logic(self, sql: exp.Expr) -> _Scalar:
        """Returns a negation, a conjunction or a disjunction of conditions, none of them NULL."""
        first = self._boolean(sql.this)
        if isinstance(sql, exp.Not):
            return _Scalar("boolean", lambda values: not first(values))
        second = _left if self._has_unknown(sql.expression) else self._boolean(sql.expression)
        if isinstance(sql, exp.And):
            return _Scalar("boolean", lambda values: first(values) and second(values))
        return _Scalar("boolean", lambda values: first(values) or second(values))

    def _membership(self, sql: exp.In) -> _Scalar:
        """Returns whether a text is one of some."""
        part, others = self.scalar(sql.this), [self.scalar(other) for other in sql.expressions]
        if any(other.kind != "string" for other in (part, *others)):
            raise _LeftToDuckDBError
        texts = [other.compute for other in others]

        def compute(values: Values) -> bool:
            return part.compute(values) in [text(values) for text in texts]

        return _Scalar("boolean", compute)

    def _list_of(self, sql: exp.Array) -> _Scalar:
        """Returns a list of doubles."""
        parts = [self._numeric(part, ("double",)).compute for part in sql.expressions]
        return _Scalar("list", lambda values: [part(values) for part in parts])

    def _case(self, sql: exp.Case) -> _Scalar:
        """Returns the value of the first condition that holds; without ELSE, one of them has to."""
        branches = [
            (self._boolean(part.this), self._result(part.args["true"])) for part in sql.args["ifs"]
        ]
        default = sql.args.get("default")
        otherwise = None if default is None else self._result(default)
        results = [result for _, result in branches] + [otherwise]
        kinds = {result.kind for result in results if result is not None}
        if len(kinds) != 1:
            raise _LeftToDuckDBError

        def compute(values: Values) -> Any:
            for holds, result in branches:
                if holds(values):
                    return _of(result, values)
            return _of(otherwise, values)

        return _Scalar(kinds.pop(), compute)

    def _element(self, sql: exp.Anonymous) -> _Scalar:
        """Returns an element of a parameter that is a list of doubles, counted from 1."""
        whole, place = sql.expressions
        if isinstance(whole, exp.Cast):
            whole = whole.this
        is_known = isinstance(whole, exp.Parameter) and self._kinds.get(whole.name) == "list"
        if not (is_known and isinstance(place, exp.Literal) and place.name.isdecimal()):
            raise _LeftToDuckDBError
        name, index = whole.name, int(place.name) - 1
        if index < 0:
            raise _LeftToDuckDBError
        self.read.add(name)
        return _Scalar("double", lambda values: values[name][index])

    def _call(self, sql: exp.Anonymous) -> _Scalar:
        """Returns a call of a function of shapes."""
        function, name = self._functions[sql.name], sql.name
        udf = GEOMETRY_UDFS.get(name)
        result = "DOUBLE" if udf is None else udf.result
        # Behind the keys of entities, a function of shapes has numbers.
        count = len(sql.expressions) if udf is None else 1 + 2 * udf.entities
        parts = [self.scalar(part) for part in sql.expressions[:count]]
        numbers = [self._double(part) for part in sql.expressions[count:]]
        if result not in ("BOOLEAN", "DOUBLE"):
            raise _LeftToDuckDBError
        arguments = [part.compute for part in (*parts, *numbers)]

        def compute(values: Values) -> Any:
            value = function(*[argument(values) for argument in arguments])
            if value is None:
                raise _LeftToDuckDBError
            return bool(value) if result == "BOOLEAN" else _finite(float(value))

        return _Scalar("boolean" if result == "BOOLEAN" else "double", compute)

    def _pair_of_shapes(self, ids: tuple[exp.Expr, ...], sql: exp.Anonymous) -> _Scalar:
        """Returns a relation of two entities by their shapes, whose boxes need not be read."""
        first, second = (self._numeric(id, ("integer",)).compute for id in ids)
        call = self._call(sql).compute
        return _Scalar("boolean", lambda values: first(values) != second(values) and call(values))

    def _pair(self, pair: PairCall) -> _Scalar:
        """Returns a relation of two entities by their contacts."""
        function, schema = self._functions[pair.relation], pair.schema
        first, second = (self._numeric(id, ("integer",)).compute for id in pair.ids)
        kind: Kind = "boolean" if RELATIONS[pair.relation].result == "boolean" else "double"
        if kind == "boolean":
            return _Scalar(kind, lambda values: function(schema, first(values), second(values)))
        return _Scalar(
            kind, lambda values: _finite(function(schema, first(values), second(values)))
        )

    def _has_unknown(self, sql: exp.Expr) -> bool:
        """Checks whether an expression calls a function that Python does not know, or fails."""
        calls: Iterable[exp.Anonymous] = sql.find_all(exp.Anonymous)
        return any(call.name not in self._functions for call in calls)

    def _result(self, sql: exp.Expr) -> _Scalar | None:
        """Returns the result of a branch; None for one that DuckDB has to evaluate."""
        return None if self._has_unknown(sql) else self.scalar(sql)


def _once(part: _Scalar, key: str) -> _Scalar:
    """Returns an expression that is evaluated once for the same parameters."""
    inner = part.compute

    def compute(values: Values) -> Any:
        if key not in values:
            values[key] = inner(values)
        return values[key]

    return _Scalar(part.kind, compute)


def _left(_: Values) -> bool:
    raise _LeftToDuckDBError


def _of(result: _Scalar | None, values: Values) -> Any:
    if result is None:
        raise _LeftToDuckDBError
    return result.compute(values)


def _constant(kind: Kind, value: Any) -> _Scalar:
    return _Scalar(kind, lambda _: value)


def _number(text: str) -> _Scalar:
    """Returns a literal: a double, a small integer, or a DECIMAL of few digits."""
    if text.isdecimal() and int(text) < EXACT:
        return _constant("integer", int(text))
    if "e" in text.lower():
        return _constant("double", _finite(float(text)))
    if text.isdecimal() or len(text) > _MAX_DIGITS:
        raise _LeftToDuckDBError
    return _constant("decimal", float(text))
