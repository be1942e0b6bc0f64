"""Values that Python computes in place of DuckDB are DuckDB's to the last bit."""

import math
import struct
from itertools import cycle

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from ssduck.errors import SelectScriptError
from ssduck.interpreter.scalar_select import ScalarSelect
from ssduck.sql.relations.registry import RELATIONS

EXPRESSIONS = [
    "a + b * c",
    "a - b - c",
    "a * b / c",
    "(a + 1) * (b - 2) / 3.5",
    "-a",
    "abs(a - b)",
    "a ^ 2 + b ^ 3",
    "sqrt(a * a + b * b)",
    "sqrt((a - b) ^ 2 + (b - c) ^ 2 + (c - a) ^ 2)",
    "a < b",
    "a <= b AND b <= c",
    "a == b OR NOT b != c",
    "a BETWEEN b AND c",
    "IF(a < b; b; c)",
    "IF(a < 0; -1.5; IF(a == 0; 0.25; a * 2))",
    "a * 0.1 + 0.2 - 0.3",
    "norm([a, b, c])",
    "[a, a + b, c * 2.0]",
    "abs(a) < 0.05",
    "n + 1 < 3",
    "n * a",
    "n == 3 AND a > n",
    "text == 'cup'",
    "text != 'cup' AND a > 0",
    "sqrt(a * a + b * b) < c OR sqrt(a * a + b * b) > 2 * c",
    "IF(a * b < c; a * b; c - a * b)",
    "max([a, b, c])",
    "min([a, -b, 0.5])",
    "max([-1.0, -norm([a, b, c])])",
    "tanh(a)",
    "1 - tanh(5.0 * abs(b))",
    "sin(a) + cos(b) * atan(c)",
    "exp(-abs(a)) + norm([a - b, c])",
    "clip(a, -0.5, 1) * clip(b, c, 2.0)",
    "int(a < b) * c + int(NOT b == c)",
]
# Those that neither computes as doubles.
OTHERS = ["n * n", "text + 'x' == 'cupx'", "round(a, 2)", "[1, 2]", "min([n, 2])", "log(a)"]
NUMBERS = st.one_of(
    st.floats(), st.sampled_from([0.0, -0.0, 1.0, 0.1, 0.3, 5e-324, 1e308, -1e308, 1e154, 2.0**53])
)


# A column that is a relation: without one, queries of a few rows run row by row.
RELATION = "z(kitchen.table)"


def bits(value):
    """A value such that only equal bits are equal."""
    if isinstance(value, list):
        return [bits(part) for part in value]
    return struct.pack("d", value) if isinstance(value, float) else (type(value), value)


def outcome(ss, program):
    try:
        return bits(ss.eval(program))
    except SelectScriptError as error:
        return str(error)


def both(ss, program):
    """The outcomes with and without Python's arithmetic."""
    ours = outcome(ss, program)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ScalarSelect, "rows", lambda *_: None)
        return ours, outcome(ss, program)


def set_variables(ss, a, b, c, n, text):
    for name, value in zip("abc", (a, b, c), strict=True):
        ss.add_variable(name, value)
    ss.add_variable("n", n)
    ss.add_variable("text", text)


@pytest.mark.slow
@given(NUMBERS, NUMBERS, NUMBERS, st.integers(-5, 5), st.sampled_from(["cup", "Cup", ""]))
@example(0.1, 0.2, 0.3, 3, "cup")
@example(1e308, -1e308, 1e308, 3, "cup")
@example(0.0, -0.0, 0.0, 0, "")
@example(math.inf, 1.0, -math.inf, 0, "")
@example(math.inf, math.inf, -1.0, 0, "")
@example(3e-170, -4e-170, 0.0, 0, "")
@example(math.nan, 1.0, 2.0, 0, "")
def test_values_are_those_of_duckdb(ss, a, b, c, n, text):
    set_variables(ss, a, b, c, n, text)
    columns = ", ".join(f"({expression})" for expression in EXPRESSIONS)
    for program in (*EXPRESSIONS, columns):
        query = f"SELECT {program}, {RELATION} FROM [0.5] AS list;"
        ours, theirs = both(ss, query)
        assert ours == theirs, query


CLAUSES = [
    "FROM [7] AS list",
    "FROM [7] AS dict",
    "FROM [7] ORDER BY this AS list",
    "FROM [7, 8] AS list",
    "FROM [] AS list",
    "FROM [7] WHERE this > 7 AS list",
    "FROM [7] LIMIT 0 AS list",
    "FROM [7], b=[8] AS list",
    "FROM ['7'] AS list",
]


@pytest.mark.parametrize(
    "query",
    [
        *(f"SELECT {expression}, {RELATION} FROM [0.5] AS list;" for expression in OTHERS),
        *(f"SELECT this, a + c, {RELATION} {clauses};" for clauses in CLAUSES),
    ],
)
def test_others_are_the_same(ss, query):
    set_variables(ss, 0.1, 0.2, 0.3, 3, "cup")
    ours, theirs = both(ss, query)
    assert ours == theirs


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan, None, True, "1", 2**60])
def test_so_are_those_of_values_that_are_no_finite_numbers(ss, value):
    set_variables(ss, value, 0.2, 0.3, 3, "cup")
    for expression in ("a < b", "a == a", "a + b", "abs(a)", "IF(a > b; 1.5; 2.5)"):
        query = f"SELECT {expression}, {RELATION} FROM [0] AS list;"
        ours, theirs = both(ss, query)
        assert ours == theirs


ARGUMENTS = {"double": "0.3", "place": "[0.5, 0, 1]", "integer": "0", "string": "'x'"}
PAIRS = [
    ("table", "plate_835a"),
    ("roomba_625x", "table"),
    ("fridge", "cooker"),
    ("table", "table"),
]


@pytest.mark.parametrize("name", RELATIONS)
def test_relations_are_the_same(ss, name):
    relation = RELATIONS[name]
    required = relation.parameters[: relation.required_count]
    for pair in PAIRS:
        entities = cycle(f"kitchen.{entity}" for entity in pair)
        given = [next(entities) if p.type == "entity" else ARGUMENTS[p.type] for p in required]
        ours, theirs = both(ss, f"{name}({', '.join(given)});")
        assert ours == theirs
