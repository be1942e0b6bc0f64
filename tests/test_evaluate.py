"""Values of expressions in Python: what Python brings in, lists that wait, searches."""

from __future__ import annotations

import numpy as np
import pandas as pd
import polars as pl
import pytest

import ssduck
from ssduck import queries
from ssduck.errors import ArgumentError, EvaluationError, UnknownNameError
from ssduck.evaluate import Keys, exactly

EVALUATORS = {"SQL": {}, "row by row": {"row_by_row": True}}


@pytest.fixture(params=EVALUATORS)
def ss(request, monkeypatch):
    """Short lists become SQL, too."""
    monkeypatch.setattr(queries, "FEW_ROWS", 0)
    with ssduck.Interpreter(**EVALUATORS[request.param]) as interpreter:
        yield interpreter


def fails(ss, program, kind, offending, words):
    with pytest.raises(kind, match=words) as caught:
        ss.eval(program)
    error = caught.value
    assert type(error) is kind
    assert error.span is not None
    assert error.text[error.span.start : error.span.end] == offending
    assert len(error.message) < 400
    assert "\n" not in error.message
    return error


# -- values that Python brings in -------------------------------------------------------------

BROUGHT = {
    "grid": np.arange(4).reshape(2, 2),
    "array": np.arange(3),
    "series": pl.Series([1, 2, 3]),
    "frame": pl.DataFrame({"a": [1, 2]}),
    "pandas": pd.Series([1, 2, 3]),
    "long": {f"key {number}": number for number in range(10_000)},
}

# (program, offending text, words)
NO_ELEMENTS = [
    ("grid[0][0][0];", "0", "no element 0: invalid index to scalar variable"),
    ("grid[0, 0, 1];", "1", "no element 1: invalid index"),
    ("SELECT grid[0][0][7] FROM [1] AS list;", "7", "no element 7: invalid index"),
    ("grid[0][5];", "5", "no element 5: index 5 is out of bounds"),
    ("series[10];", "10", "no element 10: "),
    ("pandas[10];", "10", "no element 10: "),
    ("frame['nope'];", "'nope'", "ColumnNotFoundError: "),
    ("long['nope'];", "'nope'", "there are keys .*, …"),
    ("'abc'[3];", "3", "no element 3: there are 3 elements"),
]


@pytest.mark.parametrize(("program", "offending", "words"), NO_ELEMENTS)
def test_elements_that_are_not_there(ss, program, offending, words):
    for name, value in BROUGHT.items():
        ss.add_variable(name, value)
    error = fails(ss, program, EvaluationError, offending, words)
    assert error.__cause__ is not None


# Each with a value in place of {}.
CONDITIONS = [
    "SELECT this FROM [1, 2] WHERE {} AS list;",
    "SELECT this FROM [1, 2] GROUP BY this HAVING {} AS list;",
    "SELECT this FROM [1, 2] START WITH n=1 CONNECT BY n=n+1 STOP WITH {} AS list;",
    "SELECT this FROM [1, 2] WHERE {} START WITH n=1 CONNECT BY n=n+1 STOP WITH n==2 AS list;",
    "{} AND True;",
    "True AND {};",
    "{} OR True;",
    "False OR {};",
    "NOT {};",
    "IF({}; 1; 2);",
]


@pytest.mark.parametrize("value", ["array", "series", "frame", "pandas"])
@pytest.mark.parametrize("program", CONDITIONS)
def test_what_is_neither_true_nor_false(ss, program, value):
    ss.add_variable(value, BROUGHT[value])
    error = fails(ss, program.format(value), EvaluationError, value, "ambiguous")
    assert isinstance(error.__cause__, TypeError | ValueError)


@pytest.mark.parametrize("order", ["series", "this"])
def test_what_has_no_order(ss, order):
    ss.add_variable("series", BROUGHT["series"])
    program = f"SELECT this FROM [series, series] ORDER BY {order} AS list;"
    fails(ss, program, EvaluationError, order, "ambiguous")


# (program, words)
LIBRARIES = [
    ("series + 'a';", "InvalidOperationError: arithmetic on dtypes"),
    ("series < [1, 2, 3, 4];", "ShapeError: "),
    ("[1, 2] IN array;", "ValueError: operands could not be broadcast"),
]


@pytest.mark.parametrize(("program", "words"), LIBRARIES)
def test_errors_of_libraries(ss, program, words):
    for name in ("series", "array"):
        ss.add_variable(name, BROUGHT[name])
    error = fails(ss, program, EvaluationError, program[:-1], words)
    assert error.__cause__ is not None


class Odd:
    """Raises what nobody expects, at length."""

    def __bool__(self):
        raise LookupError("odd " * 1000)

    def __neg__(self):
        raise LookupError("odd " * 1000)

    __add__ = __eq__ = __getitem__ = lambda self, other: self.__neg__()
    __hash__ = None


@pytest.mark.parametrize("program", ["odd + 1;", "odd == 1;", "-odd;", "odd[0];", "NOT odd;"])
def test_what_others_raise_is_told_in_a_line(ss, program):
    ss.add_variable("odd", Odd())
    offending = {"odd[0];": "0", "NOT odd;": "odd"}.get(program, program[:-1])
    error = fails(ss, program, EvaluationError, offending, "LookupError: odd odd")
    assert isinstance(error.__cause__, LookupError)


# -- lists that wait for the query that uses them -----------------------------------------------

WAITING = "apart = [[a.this, 1]]; "
# (program, the nearest sources)
WITHOUT_THE_SOURCE = [
    ("SELECT apart FROM ab=[1, 2] AS list;", ("ab",)),
    ("SELECT c.this FROM c=[1, 2] WHERE apart == [[1, 1]] AS list;", ("c",)),
    ("SELECT apart[0] FROM ab=[1, 2] AS list;", ("ab",)),
    ("SELECT count(apart) FROM c=[1, 2] AS list;", ("c",)),
    ("SELECT c.this FROM c=[1, 2] GROUP BY apart AS list;", ("c",)),
    ("SELECT n FROM c=[1] START WITH n=apart CONNECT BY n=n STOP WITH True AS list;", None),
    (
        "SELECT c.this FROM c=[1] WHERE 1 == count(SELECT p.this FROM p=apart AS list) AS list;",
        ("c",),
    ),
]


@pytest.mark.parametrize(("program", "nearest"), WITHOUT_THE_SOURCE)
def test_a_list_that_no_query_has_the_source_of(ss, program, nearest):
    error = fails(ss, WAITING + program, UnknownNameError, "a.this", "no source 'a' here")
    if nearest is not None:
        assert error.suggestions == nearest


def test_a_list_that_waits_is_passed_on(ss):
    program = WAITING + "other = apart; SELECT other FROM a=[1, 2] AS list;"
    assert ss.eval(program) == [[[1, 1]], [[2, 1]]]
    program = WAITING + "SELECT (SELECT apart FROM b=[1] AS value) FROM a=[1, 2] AS list;"
    assert ss.eval(program) == [[[1, 1]], [[2, 1]]]


@pytest.mark.parametrize("program", ["apart[0];", "apart + [1];"])
def test_a_list_that_waits_is_no_list_yet(ss, program):
    with pytest.raises(ArgumentError, match="a list for the query that uses it"):
        ss.eval(WAITING + program)


# -- searches ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("start", "step", "expected"),
    [
        ("2", "x * 1.0", ["2", "2.0"]),
        ("True", "1", ["True", "1"]),
        ("0.0", "-x", ["0.0", "-0.0"]),
        ("[1, 'a']", "[True, 'a']", ["[1, 'a']", "[True, 'a']"]),
    ],
)
def test_equal_states_that_functions_tell_apart(ss, start, step, expected):
    program = (
        f"SELECT str(x) FROM [2, 1] START WITH x = {start} "
        f"CONNECT BY MAXIMUM 2 x = {step} STOP WITH this == 2 AS list;"
    )
    assert ss.eval(program) == [expected[:1], expected]


def calls_of(evaluator, program):
    """The value of a program, and how a function `f` was called."""
    calls = []

    def f(*arguments):
        calls.append(arguments)
        return sum(arguments)

    with ssduck.Interpreter(**EVALUATORS[evaluator]) as ss:
        ss.add_function("f", f)
        return ss.eval(program), calls


@pytest.mark.parametrize("evaluator", EVALUATORS)
def test_states_that_a_function_does_not_see_share_its_calls(evaluator):
    program = (
        "SELECT this, n FROM [1, 2] WHERE f(this, x) == 3 START WITH x=0, n=1 "
        "CONNECT BY x = 1, n = n + 1 STOP WITH n == 3 AS list;"
    )
    value, calls = calls_of(evaluator, program)
    assert value == [[1, 1, 1, 2, 2, 3], [1, 1, 2, 2], [2, 1, 1, 2, 2, 3], [2, 1, 2, 2]]
    assert sorted(calls) == [(1, 0), (1, 1), (2, 0), (2, 1)]


@pytest.mark.parametrize("evaluator", EVALUATORS)
def test_states_that_a_function_sees_through_a_list_share_nothing(evaluator):
    """A list in a variable may mention what the call does not."""
    program = (
        "pair = [[a.this, 1]]; "
        "SELECT a.this FROM a=[1, 2] WHERE f(a.this, pair[0][0], x) == 7 START WITH x=0 "
        "CONNECT BY x = x + 1 STOP WITH x == 3 AS list;"
    )
    value, _ = calls_of(evaluator, program)
    assert value[0] == [1, 1, 1, 2]


@pytest.mark.parametrize("evaluator", EVALUATORS)
def test_what_is_selected_is_worked_out_for_rows_of_paths_only(evaluator):
    program = (
        "SELECT 6 / (this - 2) FROM [1, 2, 3] WHERE this == 3 START WITH n=0 "
        "CONNECT BY n = n + 1 STOP WITH n == 1 OR this == 2 AS list;"
    )
    value, _ = calls_of(evaluator, program)
    assert value == [[-6.0, 6.0], [6.0]]


# how: paths, where a row comes after an equal one that is another list, and a state by then
EQUAL_LISTS = {
    "NO CYCLE": [[[1], [3]], [[1], [3]], [[3]]],
    "UNIQUE": [[[1], [3]], [[3]]],
    "MEMORIZE 3": [[[[3]]], [[[1]], [[3]]]],
}


@pytest.mark.parametrize("how", EQUAL_LISTS)
def test_lists_are_told_apart_by_value(ss, how):
    program = (
        "SELECT this FROM [[1], [1], [3]] START WITH at = [2] "
        f"CONNECT BY {how} at = this STOP WITH this == [3] AS list;"
    )
    assert ss.eval(program) == EQUAL_LISTS[how]


def test_print_in_a_search_happens_at_each_row(ss, capsys):
    program = (
        "SELECT print(this) FROM [1, 2] WHERE this == 2 START WITH n=0 "
        "CONNECT BY n=n+1 STOP WITH n == 1 AS list;"
    )
    assert ss.eval(program) == [[1, 2], [2]]
    assert capsys.readouterr().out.split() == ["1", "1", "2", "2"]


@pytest.mark.parametrize(
    "values", [(1, 1.0, True), (0.0, -0.0), ([1], [1.0], [True]), ((1,), [1]), ({1: 2}, {1: 2.0})]
)
def test_what_functions_tell_apart_is_no_state_twice(values):
    assert len({exactly(value) for value in values}) == len(values)
    keys = Keys()
    assert len({keys.exact([value]) for value in values}) == len(values)
    assert keys.exact([values[0]]) == keys.exact([values[0]])


def test_equal_values_have_one_key():
    keys = Keys()
    state, other = [[1, 2], []], [[1, 2.0], []]
    keys.exact([state])
    assert keys.of((state,), ("a",)) == keys.of((other,), ("a",)) == keys.of(([*state],), ("a",))
    assert keys.of((state,), ("a",)) != keys.of((state,), ("b",))
    assert keys.of((state, 1), ("a", "b")) == keys.of((other, True), ("a", "b"))
