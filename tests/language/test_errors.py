"""Everything that can be wrong with a program: one clear message, the place, the nearest name."""

import numpy as np
import pytest

import ssduck
from ssduck.errors import (
    MAX_LINE_LENGTH,
    ArgumentError,
    EvaluationError,
    FunctionError,
    ParseError,
    SelectScriptError,
    SimulatorError,
    SourceSpan,
    UnknownNameError,
    UnsupportedError,
)
from tests.support.marked import unmarked


def broken(value):
    raise KeyError(value)


@pytest.fixture(scope="module")
def ss(shared_kitchen):
    with ssduck.Interpreter() as interpreter:
        interpreter.add_variable("kitchen", shared_kitchen)
        interpreter.add_function("broken", broken, "Raises.")
        interpreter.add_variable("array", np.zeros(3))
        interpreter.add_variable("nothing", None)
        interpreter.eval("table = SELECT obj FROM kitchen WHERE id(this) == 'table' AS value;")
        yield interpreter


# (program with the offending text marked, kind, words of the message … and of its suggestions)
MISTAKES = [
    ("x = 1; y = «unknwn» + 1;", UnknownNameError, "no variable 'unknwn'"),
    ("clear(); «nothing_of_that_name»;", UnknownNameError, "no variable"),
    ("SELECT id FROM «kitchn»;", UnknownNameError, "no variable 'kitchn' … 'kitchen'"),
    ("«id» == 'can';", UnknownNameError, "write id(this)"),
    (
        "SELECT id(a.this) FROM a=kitchen, b=kitchen WHERE «id» == 'can';",
        UnknownNameError,
        "write id(this)",
    ),
    ("«tabel»;", UnknownNameError, "no variable 'tabel' … 'table'"),
    ("SELECT id FROM kitchen WHERE «isRobott»(this);", UnknownNameError, "no function … 'isRobot'"),
    ("SELECT «vollume» FROM kitchen;", UnknownNameError, "no function 'vollume' … 'volume'"),
    ("SELECT id FROM kitchen ORDER BY «hight»;", UnknownNameError, "no function 'hight'"),
    ("«ISROBOT»(table);", UnknownNameError, "no function … 'isRobot'"),
    ("SELECT id FROM kitchen AS «dcit»;", UnknownNameError, "no result form 'dcit' … 'dict'"),
    ("«help('volum')»;", UnknownNameError, "no function 'volum' … 'volume'"),
    ("«var('tabel')»;", UnknownNameError, "no variable 'tabel' … 'table'"),
    ("SELECT id FROM a=kitchen WHERE isRobot(«b.this»);", UnknownNameError, "no source 'b' … 'a'"),
    ("«this»;", UnknownNameError, "no 'this' here"),
    ("«above(table)»;", ArgumentError, "above takes 2 arguments, not 1"),
    ("SELECT id FROM kitchen WHERE «above(table, this, 3)»;", ArgumentError, "takes 2 arguments"),
    ("SELECT «position(this, 1)» FROM kitchen;", ArgumentError, "takes 1 to 3 arguments"),
    ("SELECT «isRobot()» FROM kitchen;", ArgumentError, "takes 1 argument, not 0"),
    ("«broken(1, 2)»;", ArgumentError, "takes 1 argument, not 2"),
    ("SELECT «to(id(this))» FROM kitchen;", ArgumentError, "to takes 2 arguments"),
    (
        "SELECT id(a.this) FROM a=kitchen, b=kitchen WHERE isRobot(«this»);",
        ArgumentError,
        "a.this, b.this",
    ),
    ("SELECT id FROM kitchen, «kitchen»;", ArgumentError, "two sources have the name 'kitchen'"),
    (
        "SELECT id(a.this), «id(b.this)» FROM a=kitchen, b=kitchen;",
        ArgumentError,
        "two columns have the name 'id'",
    ),
    ("SELECT id FROM kitchen AS «list(3)»;", ArgumentError, "too many positional arguments"),
    ("SELECT id FROM kitchen WHERE above(«3», this);", ArgumentError, "an entity, not a number"),
    (
        "SELECT id FROM kitchen WHERE distance(«[1, 2]», this) < 1;",
        ArgumentError,
        "not a list of another length",
    ),
    ("«'a' < 1»;", ArgumentError, "< does not take a text and a number"),
    ("SELECT id FROM kitchen WHERE «id(this) < 3»;", ArgumentError, "< does not take"),
    ("«-'a'»;", ArgumentError, "- does not take a text"),
    (
        "«near(table, table, nothing)»;",
        ArgumentError,
        "near does not take (KinBody, KinBody, nothing): near(a, b, d) -> bool",
    ),
    ("3[«0»];", ArgumentError, "a number has no element 0"),
    ("«1 / 0»;", EvaluationError, "division by zero"),
    ("«1 % 0»;", EvaluationError, "division by zero"),
    (
        "SELECT id FROM kitchen WHERE «1 / (z(this) - z(this))» > 2;",
        EvaluationError,
        "division by zero",
    ),
    ("«10.0 ^ 400»;", EvaluationError, "too large"),
    ("[1, 2][«2»];", EvaluationError, "no element 2: there are 2 elements"),
    ("SELECT id FROM kitchen LIMIT «-1»;", EvaluationError, "LIMIT takes a whole number"),
    ("SELECT id FROM kitchen LIMIT «'a'»;", EvaluationError, "LIMIT takes a whole number"),
    ("«broken(1)»;", FunctionError, "broken: KeyError: 1"),
    ("SELECT «broken(id(this))» FROM kitchen;", FunctionError, "broken: KeyError: 'fridge_webcam'"),
    ("«sqrt(-1)»;", ArgumentError, "sqrt does not take -1"),
    ("«2 ^ 99999999999»;", EvaluationError, "too large"),
    ("«'a' * 1000000000000»;", EvaluationError, "too large"),
    ("«(-8) ^ 0.5»;", EvaluationError, "no real value"),
    ("SELECT to(id, [1]) FROM kitchen;", ArgumentError, "cannot be the name of a column"),
    ("«print()»;", ArgumentError, "print takes"),
    ("«pow(2)»;", ArgumentError, "pow takes 2 arguments, not 1"),
    ("«min(1, 2)»;", ArgumentError, "it is min([a, b])"),
    ("2 ** 3;", ParseError, "a power is x ^ y, or pow(x, y)"),
    ("«help(3)»;", UnknownNameError, "no function 3"),
    ("IF(«array»; 1; 2);", EvaluationError, "ValueError"),
    ("SELECT id FROM «kitchen{2.0}»;", EvaluationError, "no tick at 2 s"),
    ("eval('1 +');", ParseError, "expected an expression"),
]


@pytest.mark.parametrize(("text", "kind", "words"), MISTAKES)
def test_mistakes(ss, text, kind, words):
    program, offending = unmarked(text)
    told, *suggestions = words.split(" … ")
    variables = dict(ss._execution.variables)
    with pytest.raises(kind) as caught:
        ss.eval(program)
    error = caught.value
    assert told in error.message
    for name in suggestions:
        assert name.strip("'") in error.suggestions
        assert name in str(error)
    if offending is not None:
        assert error.text == program
        assert program[error.span.start : error.span.end] == offending
        first, place, line, mark = str(error).splitlines()
        assert first.startswith(error.message)
        assert place == f"  line {error.line}, column {error.column}"
        assert line[mark.index("^") : mark.rindex("^") + 1] == offending
    # The session goes on, and no variable has changed.
    assert ss._execution.variables.keys() == variables.keys()
    assert all(ss._execution.variables[name] is value for name, value in variables.items())
    assert ss.eval("1 + 1;") == 2


def test_errors_are_the_builtin_ones_that_a_user_expects():
    assert issubclass(UnknownNameError, LookupError)
    assert issubclass(ParseError, ValueError)
    assert issubclass(ArgumentError, TypeError)
    assert issubclass(EvaluationError, ArithmeticError)
    assert issubclass(SimulatorError, RuntimeError)
    assert issubclass(UnsupportedError, NotImplementedError)


def test_an_error_in_eval_is_told_in_its_own_text(ss):
    with pytest.raises(EvaluationError) as caught:
        ss.eval("eval('c = 1; 1 / 0');")
    assert caught.value.text == "c = 1; 1 / 0"
    assert (caught.value.line, caught.value.column) == (1, 8)


@pytest.mark.parametrize("program", [5, None, ["1;"]])
def test_what_is_no_program(ss, program):
    with pytest.raises(ArgumentError, match="a program is a text"):
        ss.eval(program)


@pytest.mark.parametrize("name", ["not a name", "", "1a", "a;b"])
def test_bad_names_of_variables_and_functions(ss, name):
    with pytest.raises(ArgumentError, match="letters, digits and _ only"):
        ss.add_variable(name, 1)
    with pytest.raises(ArgumentError, match="letters, digits and _ only"):
        ss.add_function(name, len)


WORDS = ["select", "From", "this", "TRUE", "and"]
KEPT = ["help", "to", "print", "eval", "clear", "var"]


@pytest.mark.parametrize(
    ("add", "name", "value", "told"),
    [
        *(("add_variable", name, 1, "a word of the language") for name in WORDS),
        *(("add_function", name, len, "choose another name") for name in KEPT),
        ("add_function", "three", 3, "is no function"),
    ],
)
def test_what_cannot_be_added(ss, add, name, value, told):
    with pytest.raises(ArgumentError, match=told):
        getattr(ss, add)(name, value)


@pytest.mark.parametrize(
    "program",
    [
        "x" * 100_000 + ";",
        "f" * 100_000 + "(1);",
        "a = " + "9" * 5000 + "x;",
        "SELECT this FROM [1] AS " + "q" * 100_000 + ";",
        "SELECT " + "q" * 100_000 + ".this FROM a = [1], b = [2];",
        "[" + "1, " * 40 + "[1][7], " + "2, " * 1000 + "3];",
        "a = [" + "1, " * 2000 + "nope];",
        "[1, 2]['" + "k" * 100_000 + "'];",
    ],
)
def test_what_is_told_of_a_long_program_is_short(program):
    with ssduck.Interpreter() as ss, pytest.raises(SelectScriptError) as caught:
        ss.eval(program)
    told = str(caught.value)
    assert len(told) < 5000
    *_, line, mark = told.splitlines()
    place = mark.index("^")
    span = caught.value.span
    assert line[place : place + 5] == program[span.start : span.start + 5][: len(line) - place]
    assert max(len(line), len(mark)) <= 4 + 1 + MAX_LINE_LENGTH


def test_long_offending_text_over_several_lines_is_marked_on_its_first():
    error = SelectScriptError("wrong", text="a = [1,\n2];", span=SourceSpan(4, 10))
    assert str(error).splitlines() == ["wrong", "  line 1, column 5", "    a = [1,", "        ^^^"]


NO_TEXTS = [None, 1, 0.5, True, [1], {"a": 1}, b"id"]
NAMED = {
    "a statement": lambda ss, value: ss.sql(value),
    "a program": lambda ss, value: ss.eval(value),
    "a variable": lambda ss, value: ss.call_variable(value),
    "a history": lambda ss, value: ss.history(value),
    "a function": lambda ss, value: ss.help(value),
    "a function to remove": lambda ss, value: ss.del_function(value),
    "a dialect": lambda ss, value: ss.compile("SELECT this FROM [1];").sql(value),
}


@pytest.mark.parametrize("what", NAMED)
def test_what_is_no_text_names_nothing(what):
    with ssduck.Interpreter() as ss:
        for value in NO_TEXTS:
            if what == "a function" and value is None:
                continue
            with pytest.raises(ssduck.SelectScriptError):
                NAMED[what](ss, value)
