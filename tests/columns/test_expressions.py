"""Expressions over numbers and over arrays have DuckDB's values to the last bit, or are left to it."""

import math
import struct
from operator import itemgetter

import duckdb
import numpy as np
import pyarrow as pa
import pytest
import sqlglot
from hypothesis import example, given
from hypothesis import strategies as st
from sqlglot import exp

from ssduck.columns.arrays import ArrayOperations, ArrayValues
from ssduck.columns.compiler import Compiler, Expression, LeftToDuckDBError
from ssduck.columns.numbers import NumberOperations

KINDS = {"a": "double", "b": "double", "c": "double", "n": "integer"}
DOUBLES = st.one_of(
    st.floats(allow_nan=False),
    st.sampled_from([0.0, -0.0, 1.0, 0.1, 5e-324, 1e308, math.inf, -math.inf, 2.0**53]),
)
ROWS = st.lists(st.tuples(DOUBLES, DOUBLES, DOUBLES, st.integers(-9, 9)), min_size=1, max_size=6)
LEAVES = st.sampled_from(["a", "b", "c", "0.5", "2.0e0", "1", "n"])


def grown(parts):
    """Larger numbers of SQL."""
    conditions = st.one_of(
        st.builds("({} {} {})".format, parts, st.sampled_from(["<", "<=", "=", "<>", ">"]), parts),
        st.builds("({} BETWEEN {} AND {})".format, parts, parts, parts),
        st.builds("({} IN ({}, {}))".format, parts, parts, parts),
        st.builds("isfinite({})".format, parts),
    )
    both = st.one_of(
        conditions,
        st.builds("({} {} {})".format, conditions, st.sampled_from(["AND", "OR"]), conditions),
        st.builds("(NOT {})".format, conditions),
    )
    return st.one_of(
        st.builds("({} {} {})".format, parts, st.sampled_from("+-*/"), parts),
        st.builds("(-{})".format, parts),
        st.builds("abs({})".format, parts),
        st.builds("sqrt({})".format, parts),
        st.builds("power({}, 2)".format, parts),
        st.builds("tanh({})".format, parts),
        st.builds("atan2({}, {})".format, parts, parts),
        st.builds("list_max([{}, {}])".format, parts, parts),
        st.builds("list_min([{}, {}])".format, parts, parts),
        st.builds("(CASE WHEN {} THEN {} ELSE {} END)".format, both, parts, parts),
        st.builds("(CASE WHEN {} THEN {} WHEN {} THEN {} END)".format, both, parts, both, parts),
    )


EXPRESSIONS = st.recursive(LEAVES, grown, max_leaves=8)


def leaf(sql):
    return Expression(KINDS[sql.name], itemgetter(sql.name)) if sql.name in KINDS else None


def bits(value):
    if isinstance(value, float):
        return struct.pack("d", value)
    return type(value), value


def of_duckdb(text, rows):
    """The values of an expression in each row; None if one is an error."""
    columns = dict(zip(KINDS, map(list, zip(*rows, strict=True)), strict=True))
    types = [pa.int64() if kind == "integer" else pa.float64() for kind in KINDS.values()]
    arrays = [pa.array(v, t) for v, t in zip(columns.values(), types, strict=True)]
    table = pa.table(dict(zip(KINDS, arrays, strict=True)))
    with duckdb.connect() as connection:
        connection.register("rows", table)
        try:
            return [row[0] for row in connection.sql(f"SELECT {text} FROM rows").fetchall()]
        except duckdb.Error:
            return None


def of_arrays(parsed, rows):
    expression = Compiler(ArrayOperations("sim"), leaf, [parsed]).expression(parsed)
    columns = {
        name: np.array(values, np.int64 if KINDS[name] == "integer" else np.float64)
        for name, values in zip(KINDS, zip(*rows, strict=True), strict=True)
    }
    values = ArrayValues(columns.__getitem__, len(rows), None)
    with np.errstate(all="ignore"):
        found = np.atleast_2d(expression.compute(values))
    return np.broadcast_to(found, (1, len(rows)))[0].tolist()


def of_numbers(parsed, row):
    expression = Compiler(NumberOperations({}), leaf, [parsed]).expression(parsed)
    return expression.compute(dict(zip(KINDS, row, strict=True)))


def value_or_left(compute, *arguments):
    """The value as a list of one; None if it is left to DuckDB, which meets its own errors."""
    try:
        return [compute(*arguments)]
    except (LeftToDuckDBError, ArithmeticError, ValueError):
        return None


@pytest.mark.slow
@given(EXPRESSIONS, ROWS)
@example("((a > 1 AND (b + c > 0)) OR (b + c > 5))", [(0.0, math.inf, -math.inf, 0)])
@example("(CASE WHEN (a > 0) THEN (b + c) ELSE abs(b + c) END)", [(0.0, math.inf, -math.inf, 1)])
@example("(CASE WHEN (a = 0) THEN 0.5 ELSE (b / a) END)", [(0.0, 1.0, 0.0, 0), (2.0, 1.0, 0.0, 0)])
@example("list_max([a, b])", [(0.0, -0.0, 0.0, 0), (-0.0, 0.0, 0.0, 0)])
@example("(a * b)", [(1e308, 1e308, 0.0, 0)])
def test_values_are_those_of_duckdb(text, rows):
    parsed = sqlglot.parse_one(text, dialect="duckdb")
    expected = of_duckdb(text, rows)
    if expected is None:
        return
    together = value_or_left(of_arrays, parsed, rows)
    if together is not None:
        assert list(map(bits, together[0])) == list(map(bits, map(plain, expected)))
    for row, value in zip(rows, expected, strict=True):
        alone = value_or_left(of_numbers, parsed, row)
        if alone is not None:
            assert bits(plain(alone[0])) == bits(plain(value))


def plain(value):
    """A number as numpy and Python have it: a DECIMAL is a double there."""
    return value if isinstance(value, bool | int | float) or value is None else float(value)


@pytest.mark.parametrize(
    "text",
    [
        "a + b * c",
        "sqrt(a * a + b * b) < c OR sqrt(a * a + b * b) > 2e0",
        "CASE WHEN a < b THEN a WHEN n = 3 THEN tanh(b) ELSE list_max([a, b, c]) END",
        "a BETWEEN b AND c AND NOT n IN (1, 2)",
        "atan2(abs(a), power(b, 3)) / c",
        "n % 2 = 1 OR n % 524288 <> n",
    ],
)
def test_common_ones_are_computed_by_both(text):
    parsed = sqlglot.parse_one(text, dialect="duckdb")
    rows = [(0.3, 0.7, 1.5, 3), (2.5, -0.7, 0.25, 1)]
    expected = of_duckdb(text, rows)
    assert list(map(bits, of_arrays(parsed, rows))) == list(map(bits, expected))
    assert [bits(of_numbers(parsed, row)) for row in rows] == list(map(bits, expected))


@pytest.mark.parametrize(
    "text", ["ln(a)", "a % b", "a || 'x'", "power(a, 0.5)", "unknown(a)", "n * n", "d + 1"]
)
def test_others_are_left_to_duckdb(text):
    parsed = sqlglot.parse_one(text, dialect="duckdb")
    for operations in (ArrayOperations("sim"), NumberOperations({})):
        with pytest.raises(LeftToDuckDBError):
            Compiler(operations, leaf, [parsed]).expression(parsed)


def test_a_common_part_is_computed_once():
    parsed = sqlglot.parse_one("tanh(a) + tanh(a) * tanh(a)", dialect="duckdb")
    calls = []

    class Counted(NumberOperations):
        def applied(self, name, *parts):
            if name == "tanh":
                return lambda values: calls.append(1) or parts[0](values)
            return super().applied(name, *parts)

    assert len(list(parsed.find_all(exp.Tanh))) == 3
    Compiler(Counted({}), leaf, [parsed]).expression(parsed).compute({"a": 0.5})
    assert calls == [1]
