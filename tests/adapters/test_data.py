"""What Python brings in: tables, records, long lists, and what functions give."""

import enum
import time

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest

import ssduck
from ssduck.errors import (
    ArgumentError,
    EvaluationError,
    FunctionError,
    LimitError,
    ParseError,
    UnknownNameError,
)
from tests.support.timing import HANGS

# So many rows that queries over them are SQL where they can be.
MANY = 70


@pytest.fixture(scope="module")
def both():
    """SQL, and row by row."""
    with ssduck.Interpreter() as sql, ssduck.Interpreter(row_by_row=True) as rows:
        yield sql, rows


def same(both, program, **variables):
    """The value that both evaluators give: of the same types, too."""
    told = []
    for interpreter in both:
        for name, value in variables.items():
            interpreter.add_variable(name, value)
        told.append(interpreter.eval(program))
    assert repr(told[0]) == repr(told[1])
    return told[0]


# -- tables -------------------------------------------------------------------------------------

A_THING = object()

# (table, its rows)
TABLES = {
    "mixed": (pd.DataFrame({"a": [1, "a", None]}), [{"a": 1}, {"a": "a"}, {"a": None}]),
    "numbers of two kinds": (
        pd.DataFrame({"a": pd.Series([1, 2.5], dtype=object)}),
        [{"a": 1}, {"a": 2.5}],
    ),
    "lists and dicts": (pd.DataFrame({"a": [[1], {"x": 1}]}), [{"a": [1]}, {"a": {"x": 1}}]),
    "dicts of other keys": (
        pd.DataFrame({"a": [{"x": 1}, {"y": 2}]}),
        [{"a": {"x": 1}}, {"a": {"y": 2}}],
    ),
    "arrays": (pd.DataFrame({"a": [np.arange(2), np.ones(1)]}), [{"a": [0, 1]}, {"a": [1.0]}]),
    "numbers without end": (pd.DataFrame({"a": [10**30, 1]}), [{"a": 10**30}, {"a": 1}]),
    "objects": (pd.DataFrame({"a": [A_THING]}), [{"a": A_THING}]),
    "complex": (pd.DataFrame({"a": [1j]}), [{"a": 1j}]),
    "sparse": (pd.DataFrame({"a": pd.arrays.SparseArray([0, 1])}), [{"a": 0}, {"a": 1}]),
    "periods": (
        pd.DataFrame({"a": pd.period_range("2020", periods=1, freq="Y")}),
        [{"a": pd.Period("2020", "Y")}],
    ),
    "missing": (
        pd.DataFrame(
            {"a": [0.5, np.nan], "b": pd.array([1, None], "Int64"), "c": pd.Categorical(["x", None])}
        ),
        [{"a": 0.5, "b": 1, "c": "x"}, {"a": None, "b": None, "c": None}],
    ),
    "names that are numbers": (pd.DataFrame([[1, 2]]), [{"0": 1, "1": 2}]),
    "no rows": (pd.DataFrame({"a": []}), []),
    "objects of polars": (
        pl.DataFrame({"a": pl.Series([1, "a"], dtype=pl.Object)}),
        [{"a": 1}, {"a": "a"}],
    ),
    "whole numbers of 128 bits": (
        pl.DataFrame({"a": pl.Series([1, 2**100], dtype=pl.Int128)}),
        [{"a": 1}, {"a": 2**100}],
    ),
    "polars": (
        pl.DataFrame({"a": [{"x": 1}, None], "b": [[1], []], "c": [0.5, None]}),
        [{"a": {"x": 1}, "b": [1], "c": 0.5}, {"a": None, "b": [], "c": None}],
    ),
    "arrow": (pa.table({"a": [[1], None]}), [{"a": [1]}, {"a": None}]),
}  # fmt: skip


@pytest.mark.parametrize("name", TABLES)
def test_rows_of_tables(both, name):
    table, rows = TABLES[name]
    value = same(both, "SELECT this FROM t AS list;", t=table)
    assert value == rows
    assert list(map(type, value)) == list(map(type, rows))
    assert same(both, "SELECT t.this FROM t, m WHERE m.this == 0 AS list;", m=range_list()) == rows


def range_list():
    return list(range(MANY))


TWICE = {
    "pandas": pd.DataFrame([[1, 2]], columns=["b", "b"]),
    "pandas, as texts": pd.DataFrame([[1, 2]], columns=[1, "1"]),
    "arrow": pa.Table.from_arrays([pa.array([1]), pa.array([2])], names=["b", "b"]),
}


@pytest.mark.parametrize("name", TWICE)
def test_two_columns_of_one_name_are_an_error_that_names_it(both, name):
    for interpreter in both:
        interpreter.add_variable("t", TWICE[name])
        with pytest.raises(ArgumentError, match=r"two columns of the name '(b|1)'"):
            interpreter.eval("SELECT this FROM t;")


def test_large_sums_of_sql_are_integers_here_too(both):
    total = both[0].sql("SELECT sum(range) AS total FROM range(3)")
    assert same(both, "SELECT this.total / 2 FROM t AS list;", t=total) == [1.5]
    assert same(both, "SELECT this.total FROM t AS list;", t=total) == [3]


# -- records ------------------------------------------------------------------------------------

RECORDS = {
    "other keys": [{"a": 1}, {"b": 2}],
    "more keys": [{"a": 1}, {"a": 1, "b": 2}],
    "another order": [{"a": 1, "b": 2}, {"b": 3, "a": 4}],
    "dicts in lists": [{"a": [{"x": 1}]}, {"a": [{"x": 2}]}],
    "dicts of other keys in lists": [{"a": [{"x": 1}]}, {"a": [{"y": 2}]}],
    "different dicts in one list": [{"a": [{"x": 1}, {"y": 2}]}],
    "dicts in dicts": [{"a": {"x": 1, "y": [{"z": 1}]}}],
    "dicts of other keys in dicts": [{"a": {"x": 1}}, {"a": {"y": 1}}],
    "lists of nothing": [{"a": []}, {"a": [1]}],
    "nothing": [{"a": None}, {"a": 1}],
    "numbers of two kinds": [{"a": 1}, {"a": 1.5}],
    "upper and lower case": [{"a": 1, "A": 2}],
    "a key that is no text": [{1: 1}],
    "whole numbers and others": [1, 2.5],
    "an infinity": [1.5, float("inf")],
    "a number and a text": [1, "a"],
    "texts that SQL has not": ["a", "a\0", "\ud800"],
    "a truth and a number": [True, 1],
    "lists of many lengths": [[1, 2, 3], [4, 5], []],
    "lists of unlike things": [[1], ["a"]],
    "lists in lists": [[[]], [[1]]],
}  # fmt: skip


# The last with a condition and a value that are left to Python.
OF_RECORDS = [
    "SELECT this FROM t AS list;",
    "SELECT t.this FROM t, m WHERE m.this == 0 AS list;",
    "SELECT IF(m.this == 0; t.this) FROM t, m WHERE m.this < 1 AND t.this != 3 AS list;",
]


@pytest.mark.parametrize("name", RECORDS)
@pytest.mark.parametrize("program", OF_RECORDS)
def test_records(both, name, program):
    assert same(both, program, t=RECORDS[name], m=range_list()) == RECORDS[name]


def test_lists_of_records_in_a_nested_query(both):
    program = "SELECT (SELECT b.this.x FROM b=parts WHERE b.this.x > a.this AS list) FROM a=m LIMIT 3 AS list;"
    value = same(both, program, parts=[{"x": 1}, {"x": 2}], m=range_list())
    assert value == [[1, 2], [2], []]


# -- long lists ---------------------------------------------------------------------------------


@pytest.mark.long
def test_long_lists_are_typed_and_told_apart_within_the_time():
    with ssduck.Interpreter(limits=ssduck.Limits(seconds=HANGS)) as ss:
        ss.add_variable("long", list(range(2_000_000)))
        ss.add_variable("nested", [[1, 2, 3]] * 1_000_000)
        ss.add_variable("records", [{"a": 1, "b": "x"}] * 500_000)
        started = time.process_time()
        program = "SELECT count(long), count(nested), count(records) FROM [1, 2] AS list;"
        assert ss.eval(program) == [2_000_000, 1_000_000, 500_000] * 2
        assert ss.eval("count(uniq(long));") == 2_000_000
        assert time.process_time() - started < 20


def test_lists_within_themselves_have_no_type():
    """And need no more memory than they have."""
    endless = [1]
    endless += [endless, [endless, endless]]
    with ssduck.Interpreter() as ss:
        ss.add_variable("endless", endless)
        with pytest.raises(ssduck.SelectScriptError):
            ss.eval("SELECT this FROM endless AS list;")


# -- functions ----------------------------------------------------------------------------------


class Level(enum.IntEnum):
    """An integer that is more than that."""

    LOW = 1


# (the hint, what the function gives, what it is then)
GIVEN = [
    (float, 3, 3),
    (float, True, True),
    (float, "a", "a"),
    (float, np.float64(2.5), 2.5),
    (float, np.float32(0.1), float(np.float32(0.1))),
    (float, np.int64(3), 3),
    (float, 2.5, 2.5),
    (float, -0.0, -0.0),
    (float, float("inf"), float("inf")),
    (float, None, None),
    (int, 2.0, 2.0),
    (int, 2.5, 2.5),
    (int, True, True),
    (int, "3", "3"),
    (int, np.int64(3), 3),
    (int, 2**60, 2**60),
    (int, 10**30, 10**30),
    (int, Level.LOW, Level.LOW),
    (bool, 1, 1),
    (bool, np.bool_(True), True),
    (bool, "", ""),
    (str, 3, 3),
    (str, None, None),
    (str, np.str_("a"), "a"),
    (str, "a\0b", "a\0b"),
    (str, "\ud800", "\ud800"),
    (list[int], (1, 2), [1, 2]),
    (list[int], [1, 2.0], [1, 2.0]),
    (list[int], [True], [True]),
    (list[int], [], []),
    (list[float], [1, 2], [1, 2]),
    (list[float], [None], [None]),
    (list[float], [np.float64(0.5)], [0.5]),
    (list[list[float]], [[0.5], [1]], [[0.5], [1]]),
    (list[str], "ab", "ab"),
]


@pytest.mark.parametrize(("hint", "given", "value"), GIVEN)
def test_what_a_function_gives_stays_what_it_is(both, hint, given, value):
    """Whatever its hint says."""

    def told(number):
        return given if number == 1 else None

    told.__annotations__ = {"number": int, "return": hint}
    for interpreter in both:
        interpreter.add_function("told", told)
    program = "SELECT told(this) FROM m WHERE this == 1 OR told(this) == 'no' AS list;"
    result = same(both, program, m=range_list())
    assert repr(result) == repr([value])


HINTED = {"number": int, "return": int}


@pytest.mark.parametrize("hints", [{}, HINTED], ids=["no hints", "hints"])
@pytest.mark.parametrize("program", ["asks(2);", "SELECT asks(this) FROM m WHERE asks(this) > 0;"])
@pytest.mark.parametrize(
    ("inner", "kind"),
    [("nothin;", UnknownNameError), ("1 / 0;", EvaluationError), ("1 +;", ParseError)],
)
def test_a_function_whose_own_program_fails(both, hints, program, inner, kind):
    """The error is of the function; that of its program is its cause."""
    for interpreter in both:

        def asks(number, interpreter=interpreter):
            return interpreter.eval(inner)

        def asked(number):
            return asks(number)

        asked.__annotations__ = hints
        interpreter.add_function("asks", asked)
        interpreter.add_variable("m", range_list())
        with pytest.raises(FunctionError) as caught:
            interpreter.eval(program)
        error = caught.value
        assert error.message.startswith(f"asks: {kind.__name__}: ")
        assert "\n" not in error.message
        assert program[error.span.start : error.span.end].startswith("asks(")
        assert isinstance(error.__cause__, kind)
        assert error.__cause__.text == inner


def test_a_limit_within_a_functions_program_is_that_of_the_program_around_it():
    with ssduck.Interpreter(limits=ssduck.Limits(rows=100)) as ss:
        ss.add_variable("m", range_list())
        ss.add_function("asks", lambda: ss.eval("SELECT a.this FROM a=m, b=m AS list;"))
        with pytest.raises(LimitError, match="more than 100 rows"):
            ss.eval("asks();")
