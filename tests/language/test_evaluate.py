"""Values of expressions in Python: what Python brings in, lists that wait, searches."""

from decimal import Decimal

import numpy as np
import pandas as pd
import polars as pl
import pytest

import ssduck
from ssduck.errors import (
    ArgumentError,
    EvaluationError,
    FunctionError,
    UnknownNameError,
)
from ssduck.interpreter import query_runner as queries
from ssduck.language.value_keys import ValueKeys, exact_key
from tests.support.cases import sampled

EVALUATORS = {"SQL": {}, "row by row": {"row_by_row": True}}


@pytest.fixture(params=EVALUATORS)
def ss(request, monkeypatch):
    """Short lists become SQL, too."""
    monkeypatch.setattr(queries, "FEW_ROWS", 0)
    with ssduck.Interpreter(**EVALUATORS[request.param]) as interpreter:
        yield interpreter


@pytest.fixture(scope="module", params=EVALUATORS)
def shared(request):
    """The same for programs that leave no trace."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(queries, "FEW_ROWS", 0)
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
    ("grid[0, 0, 1];", "1", "no element 1: invalid index"),
    ("SELECT grid[0, 0, 7] FROM [1] AS list;", "7", "no element 7: invalid index"),
    ("grid[0][5];", "5", "no element 5: index 5 is out of bounds"),
    ("series[10];", "10", "no element 10: "),
    ("pandas[10];", "10", "no element 10: "),
    ("frame['nope'];", "'nope'", "ColumnNotFoundError: "),
    ("long['nope'];", "'nope'", "there are keys .*, …"),
    ("'abc'[3];", "3", "no element 3: there are 3 elements"),
]


@pytest.mark.parametrize(("program", "offending", "words"), NO_ELEMENTS)
def test_elements_that_are_not_there(shared, program, offending, words):
    for name, value in BROUGHT.items():
        shared.add_variable(name, value)
    error = fails(shared, program, EvaluationError, offending, words)
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
def test_what_is_neither_true_nor_false(shared, program, value):
    shared.add_variable(value, BROUGHT[value])
    error = fails(shared, program.format(value), EvaluationError, value, "ambiguous")
    assert isinstance(error.__cause__, TypeError | ValueError)


@pytest.mark.parametrize("order", ["series", "this"])
def test_what_has_no_order(shared, order):
    shared.add_variable("series", BROUGHT["series"])
    program = f"SELECT this FROM [series, series] ORDER BY {order} AS list;"
    fails(shared, program, EvaluationError, order, "ambiguous")


# (program, words)
LIBRARIES = [
    ("series + 'a';", "InvalidOperationError: arithmetic on dtypes"),
    ("series < [1, 2, 3, 4];", "ShapeError: "),
    ("[1, 2] IN array;", "ValueError: operands could not be broadcast"),
]


@pytest.mark.parametrize(("program", "words"), LIBRARIES)
def test_errors_of_libraries(shared, program, words):
    for name in ("series", "array"):
        shared.add_variable(name, BROUGHT[name])
    error = fails(shared, program, EvaluationError, program[:-1], words)
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
    "values",
    [
        (1, 1.0, True),
        (0.0, -0.0),
        ([1], [1.0], [True]),
        ((1,), [1]),
        ({1: 2}, {1: 2.0}),
        (Decimal("1.0"), Decimal("1.00")),
    ],
)
def test_what_functions_tell_apart_is_no_state_twice(values):
    assert len({exact_key(value) for value in values}) == len(values)
    keys = ValueKeys()
    assert len({keys.exact([value]) for value in values}) == len(values)
    assert keys.exact([values[0]]) == keys.exact([values[0]])


class Mute:
    """Nobody knows what it tells apart."""

    def __repr__(self):
        raise LookupError


def test_what_cannot_be_told_apart_is_no_state():
    with pytest.raises(ArgumentError, match="Mute cannot be compared"):
        exact_key(Mute())


def test_a_state_of_what_functions_tell_apart(ss):
    ss.add_variable("ones", [Decimal("1.00")])
    ss.add_variable("one", Decimal("1.0"))
    program = (
        "SELECT str(x) FROM ones START WITH x = one "
        "CONNECT BY x = this STOP WITH str(x) == '1.00' AS list;"
    )
    assert ss.eval(program) == [["1.0", "1.00"]]


def test_a_function_may_give_the_same_list_each_time(ss):
    buffer, within = [0], [[0]]

    def following(state):
        buffer[0] = state[0] + 1
        return buffer

    def inner(state):
        within[0][0] = state[0][0] + 1
        return within

    ss.add_function("following", following)
    ss.add_function("inner", inner)
    program = (
        "SELECT s[0] FROM [1] START WITH s = [0] CONNECT BY s = following(s) "
        "STOP WITH s[0] >= 3 AS list;"
    )
    assert ss.eval(program) == [[0, 1, 2, 3]]
    program = (
        "SELECT s[0][0] FROM [1] START WITH s = [[0]] CONNECT BY s = inner(s) "
        "STOP WITH s[0][0] >= 3 AS list;"
    )
    assert ss.eval(program) == [[0, 1, 2, 3]]


def test_where_is_asked_before_stop(ss):
    """At a row that WHERE finds nobody asks whether the path ends in vain."""
    program = (
        "SELECT this FROM [0, 1, 2] WHERE this == 0 START WITH n=0 "
        "CONNECT BY n = n + 1 STOP WITH 2 / this > 1 OR n == 1 AS list;"
    )
    assert ss.eval(program) == [[0], [2, 0]]
    assert ss.eval(program.replace("BY n", "BY NO CYCLE n")) == [[0], [2, 0]]
    assert ss.eval(program.replace("BY n", "BY MEMORIZE 9 n")) == [[[0]], [[2], [0]]]
    assert ss.eval(program.replace("BY n", "BY MEMORIZE n")) == [[[0]]]


def test_unique_does_not_count_a_row_that_is_found_and_stops(ss):
    program = (
        "SELECT this FROM [1, 2, 1] WHERE this == 1 START WITH n=0 "
        "CONNECT BY UNIQUE n = n + 1 STOP WITH {} AS list;"
    )
    assert ss.eval(program.format("True")) == [[1], [1]]
    assert ss.eval(program.format("n > 0")) == [[1]]


# -- what is written alike --------------------------------------------------------------------

# (program, value)
ALIKE = [
    ("SELECT f(IF(this>1; 1, 2)), to(f(IF(this>1; 1; 2)), 'b') FROM [2] AS list;", [2, 1]),
    ("SELECT f(IF(this>1; 1; 2, 3)), to(f(IF(this>1; 1, 2; 3)), 'b') FROM [1] AS list;", [3, 3]),
    ("SELECT f(IF(this>1; 1; 2, 3)), to(f(IF(this>1; 1, 2; 3)), 'b') FROM [2] AS list;", [1, 2]),
    ("SELECT f(x) FROM t WHERE f(x) > 3 AS list;", [1, 2]),
    ("SELECT f(x), to(f('x'), 'b') FROM [1] AS list;", [5, "x"]),
    (
        "SELECT f([1, 2]), to(f([[1, 2]]), 'b'), to(f(['1, 2']), 'c') FROM [1] AS list;",
        [[1, 2], [[1, 2]], ["1, 2"]],
    ),
    ("SELECT f(nest[0, 1]), to(f(nest[0][1]), 'b') FROM [1] AS list;", [2, 2]),
    (
        "SELECT f(count(SELECT this FROM [1] AS list)), to(f(count(SELECT this FROM [1] AS dict) + 1),"
        " 'b') FROM [1] AS list;",
        [1, 2],
    ),
    (
        "SELECT f(SELECT this FROM [1] AS list), to(f(SELECT this FROM [1] AS dict), 'b')"
        " FROM [1] AS list;",
        [[1], [{"this": 1}]],
    ),
]


@pytest.mark.parametrize(("program", "value"), ALIKE)
def test_different_calls_are_not_one(ss, program, value):
    ss.add_variable("t", [{"x": 1}, {"x": 2, "y": 3}])
    ss.add_variable("x", 5)
    ss.add_variable("nest", [[1, 2]])
    ss.add_function("f", lambda value: value)
    assert ss.eval(program) == value


# -- numpy's numbers ----------------------------------------------------------------------------

# (program, value)
NUMBERS = [
    ("SELECT this^100 FROM threes AS list;", [3**100]),
    ("threes[0]^100;", 3**100),
    ("sum(threes)^100;", 3**100),
    ("SELECT this.a - 10 FROM dicts AS list;", [-7]),
    ("SELECT this.b[0] - 10 FROM dicts AS list;", [-7]),
    ("three - 10;", -7),
    ("array[0]^100;", 3**100),
    ("sum(array)^100;", 3**100),
    ("pairs[0][1] - 10;", -7),
    ("given()[0] - 10;", -7),
    ("SELECT given()[1].a[0] - 10 FROM [1] AS list;", [-7]),
]


@pytest.mark.parametrize(("program", "value"), NUMBERS)
def test_numbers_of_numpy_are_pythons(ss, program, value):
    small = np.uint8(3)
    threes = [np.int64(3)]
    ss.add_variable("threes", threes)
    ss.add_variable("dicts", [{"a": small, "b": (small,)}])
    ss.add_variable("three", small)
    ss.add_variable("array", np.array([3]))
    ss.add_variable("pairs", [("a", small)])
    ss.add_function("given", lambda: [small, {"a": (small,)}])
    assert repr(ss.eval(program)) == repr(value)
    assert type(threes[0]) is np.int64


def test_variables_without_numbers_of_numpy_stay_what_they_are(ss):
    nested = [1, [2.0, {"a": (True, None)}], "b"]
    ss.add_variable("nested", nested)
    assert ss.eval("nested;") is nested
    nested.append(nested)
    ss.add_variable("nested", nested)
    assert ss.eval("nested;") is nested


# -- what errors tell ---------------------------------------------------------------------------

HUGE = "10^5000"
# (program, kind, offending text, words)
LARGE = [
    (f"[1, 2][{HUGE}];", EvaluationError, HUGE, "no element a number of some 5000 digits"),
    (f"'abc'[{HUGE}];", EvaluationError, HUGE, "no element a number of some 5000 digits"),
    (
        f"SELECT this FROM [1] LIMIT -({HUGE}) AS list;",
        EvaluationError,
        f"-({HUGE})",
        "LIMIT takes a whole number, not a negative number of some 5000 digits",
    ),
    (f"SELECT this FROM [1] GROUP BY {HUGE} AS list;", EvaluationError, HUGE, "digits"),
    (f"eval({HUGE});", ArgumentError, f"eval({HUGE})", "takes a text, not a number of some"),
    ("eval(ones);", ArgumentError, "eval(ones)", r"not \[1, 1, .*\.\.\.\]"),
    ("SELECT this FROM [1] LIMIT long AS list;", EvaluationError, "long", "not 'aaa"),
    (
        "SELECT this FROM [1] START WITH n=1 CONNECT BY MAXIMUM long n=n STOP WITH True AS list;",
        EvaluationError,
        "long",
        "not 'aaa",
    ),
    ("var(long);", UnknownNameError, "var(long)", "no variable 'aaa"),
    ("help(long);", UnknownNameError, "help(long)", "no function 'aaa"),
    ("float(long);", ArgumentError, "float(long)", "float does not take"),
    ("fail(1);", FunctionError, "fail(1)", "fail: ValueError: yyy"),
    ("odd(1);", FunctionError, "odd(1)", "odd: UntoldError: it gives no reason"),
]


class UntoldError(Exception):
    def __str__(self):
        raise LookupError


def fail(_):
    raise ValueError("y" * 10**6)


def odd(_):
    raise UntoldError


@sampled(("program", "kind", "offending", "words"), LARGE, every=3)
def test_large_values_are_told_in_few_words(ss, program, kind, offending, words):
    ss.add_variable("long", "a" * 10**6)
    ss.add_variable("ones", [1] * 10**6)
    ss.add_function("fail", fail)
    ss.add_function("odd", odd)
    fails(ss, program, kind, offending, words)


@pytest.mark.parametrize("clause", ["LIMIT (10^30)", "LIMIT (10^5000)"])
def test_more_than_there_is(ss, clause):
    assert ss.eval(f"SELECT this FROM [1, 2] {clause} AS list;") == [1, 2]
    assert ss.eval(f"SELECT this FROM [1, 2] GROUP BY 'all' {clause} AS list;") == {"all": [1, 2]}
    search = "SELECT this FROM [1, 2] START WITH n=1 CONNECT BY {} n=n STOP WITH True AS list;"
    assert ss.eval(search.format(clause.replace("LIMIT", "MAXIMUM"))) == [[1], [2]]


# -- groups ------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", ["this", "[this]", "this % (-2)", "-this"])
def test_zeros_are_one_group(ss, key):
    """They are equal; only SQL and Python do not agree which one a remainder is."""
    printed = "[0.0]" if key == "[this]" else "0.0"
    program = f"SELECT this == 0 FROM [0.0, -0.0] GROUP BY {key} AS list;"
    assert ss.eval(program) == {printed: [True, True]}
