"""Evaluates SELECTs of one row in Python, where the values are DuckDB's bit for bit.

A condition on a few numbers takes DuckDB hundreds of microseconds, and Python some. Only operations
with one correct result are evaluated here: comparisons, logic, sums, differences, products,
quotients and roots of finite doubles, and whole powers by the platform's own mathematical library,
which DuckDB uses, too. All others are left to DuckDB, and so are overflows and NaN.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Collection, Mapping
from typing import Any

from sqlglot import exp

from ssduck.columns.compiler import Compiler
from ssduck.columns.expressions import Expression, Kind, LeftToDuckDBError
from ssduck.columns.numbers import NumberOperations, known
from ssduck.sql.plan import Plan
from ssduck.sql.types import EXACT, SqlType

# The clauses that such a SELECT may have; of one row, the order does not matter.
_CLAUSES = frozenset(("expressions", "from_", "order"))
# The types of elements, by their names in the language.
_ELEMENTS: dict[str, Kind] = {"integer": "integer", "double": "double"}


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
            leaves = _Leaves(plan, kinds, self._list)
            columns = plan.select.expressions
            compiler = Compiler(NumberOperations(functions), leaves.expression, columns)
            self._columns = [compiler.expression(part).compute for part in columns]
        except LeftToDuckDBError:
            raise ValueError("DuckDB has to evaluate it") from None
        self._kinds = {name: kind for name, kind in kinds.items() if name in leaves.read}

    @property
    def parameters(self) -> Collection[str]:
        """The parameters that are read, besides the list."""
        return self._kinds.keys()

    def rows(self, parameters: Mapping[str, Any]) -> list[tuple[Any, ...]] | None:
        """Returns the rows that DuckDB would return; None if DuckDB has to evaluate them."""
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
        LeftToDuckDBError: the SELECT reads something else.
    """
    select = plan.select
    lists = [binding for binding in plan.bindings if binding.source is not None]
    if (
        plan.paths
        or plan.tables
        or any(value for name, value in select.args.items() if name not in _CLAUSES)
        or len(lists) != len(plan.source_types)
    ):
        raise LeftToDuckDBError
    if not lists:
        if select.args.get("from_") is not None:
            raise LeftToDuckDBError
        return None
    source = plan.source_types[0].sql_type
    if len(lists) > 1 or lists[0].end or source is None or source.type not in _ELEMENTS:
        raise LeftToDuckDBError
    return lists[0].name


def _kinds_of(plan: Plan) -> dict[str, Kind]:
    """Returns the types of the parameters by name, without the list.

    Raises:
        LeftToDuckDBError: one of them has another type.
    """
    kinds: dict[str, Kind] = dict(plan.numbers)
    for binding in plan.bindings:
        if binding.source is None and binding.name not in kinds:
            kinds[binding.name] = _kind_of(binding.sql_type)
    return kinds


def _kind_of(sql_type: SqlType) -> Kind:
    """Returns the type of a parameter that is no number.

    Raises:
        LeftToDuckDBError: it is no text, and no list of doubles.
    """
    element = sql_type.element
    if sql_type.type == "list" and element is not None and element.type == "double":
        return "list"
    if sql_type.type != "string":
        raise LeftToDuckDBError
    return "string"


def _checked(value: Any, kind: Kind) -> Any:
    """Returns the value of a parameter."""
    if kind == "double" and type(value) in (float, int):
        return known(float(value))
    if kind == "integer" and type(value) is int and abs(value) < EXACT:
        return value
    if kind == "string" and type(value) is str:
        return value
    if kind == "list" and set(map(type, value)) == {float}:
        return list(map(known, value))
    raise LeftToDuckDBError


class _Leaves:
    """The parameters of a SELECT, and the element of its list."""

    def __init__(self, plan: Plan, kinds: Mapping[str, Kind], list_name: str | None) -> None:
        self._kinds = kinds
        self.read: set[str] = set()
        self._columns: dict[tuple[str, str], Expression] = {}
        if list_name is not None:
            (source,) = plan.source_types
            assert source.sql_type is not None
            element = Expression(_ELEMENTS[source.sql_type.type], operator.itemgetter(list_name))
            self._columns[source.alias, "value"] = element
            self._columns[source.alias, "n"] = Expression("integer", lambda _: 1)

    def expression(self, sql: exp.Expr) -> Expression | None:
        """Returns a parameter or a column; None for one that is not known."""
        if isinstance(sql, exp.Column):
            return self._columns.get((sql.table, sql.name))
        if sql.name not in self._kinds:
            return None
        self.read.add(sql.name)
        return Expression(self._kinds[sql.name], operator.itemgetter(sql.name))
