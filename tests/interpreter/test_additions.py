"""What users add to an interpreter: parameters of a run, functions in raw SQL, frames that they hold."""

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest

import ssduck
from ssduck.errors import ArgumentError, SqlError, UnknownNameError

PRICES = {"name": ["cup", "table", "sink"], "price": [1.5, 80.0, None]}


@pytest.fixture
def empty():
    with ssduck.Interpreter() as ss:
        yield ss


# -- parameters -----------------------------------------------------------------------------------


@pytest.mark.parametrize("is_compiled", [False, True])
def test_parameters_are_variables_of_one_run(ss, is_compiled):
    text = "SELECT name FROM kitchen WHERE z > high AND kind == what AS list;"
    program = ss.compile(text) if is_compiled else text
    for high in (1.0, np.float64(1.5), 1.0):
        found = ss.eval(program, {"high": high, "what": "robot"})
        expected = "SELECT name FROM entities WHERE z > ? AND kind = 'robot' ORDER BY id"
        assert found == [name for (name,) in ss.sql(expected, [float(high)]).fetchall()] != []
    assert "high" not in ss
    with pytest.raises(UnknownNameError, match="high"):
        ss.eval(text, parameters={"what": "robot"})
    assert "what" not in ss


def test_variables_are_as_before(empty):
    empty["a"] = 1
    assert empty.eval("a + b;", parameters={"a": 2, "b": 3}) == 5
    assert empty.eval("a = a + 1; a;", {"a": 5}) == 6
    with pytest.raises(ArgumentError):
        empty.eval("a + 'x';", {"a": [1]})
    assert empty["a"] == 1
    assert "b" not in empty


@pytest.mark.parametrize("name", ["kitchen", "two words", "select"])
def test_names_that_no_parameter_has(ss, name):
    with pytest.raises(ArgumentError, match=name):
        ss.eval("1;", {name: 2})
    assert ss.eval("count(SELECT this FROM kitchen AS list);") == 37


# -- functions in raw SQL -------------------------------------------------------------------------


def twice(x: float) -> float:
    return 2 * x


def test_a_function_is_callable_by_its_name(empty):
    empty.add_function("twice", twice)
    assert empty.sql("SELECT twice(x) FROM (VALUES (1.5), (NULL), (4)) t(x)").fetchall() == [
        (3.0,),
        (None,),
        (8.0,),
    ]
    assert empty.sql("SELECT TWICE(2)").fetchone() == (4.0,)  # SQL ignores case
    assert empty.eval("SELECT twice(this) FROM [1.0] AS list;") == [2.0]

    def joined(texts: list[str], count: int, is_loud: bool) -> str:
        return "-".join(texts * count) + "!" * is_loud

    empty.add_function("joined", joined)
    assert empty.sql("SELECT joined(['a', 'b'], 2, true)").fetchone() == ("a-b-a-b!",)


@pytest.mark.slow
def test_it_is_replaced_and_removed(empty):
    empty.add_function("f", twice)
    assert empty.sql("SELECT f(1)").fetchone() == (2.0,)

    def half(x: float) -> float:
        return x / 2

    empty.add_function("f", half)
    assert empty.sql("SELECT f(1)").fetchone() == (0.5,)
    empty.del_function("f")
    with pytest.raises(SqlError, match="f does not exist"):
        empty.sql("SELECT f(1)")


def test_its_errors_are_its_own(empty):
    def fail(x: int) -> int:
        raise KeyError(x)

    empty.add_function("fail", fail)
    with pytest.raises(SqlError, match="fail: KeyError: 7"):
        empty.sql("SELECT fail(7)")


def test_a_function_of_sql_stays(empty):
    def greatest_digit(x: int) -> int:
        return 0

    empty.add_function("bit_count", greatest_digit)
    assert empty.sql("SELECT bit_count(7)").fetchone() == (3,)
    assert empty.eval("bit_count(7);") == 0


@pytest.mark.parametrize("function", [lambda x: x, abs, np.sin])
def test_without_type_hints_the_error_says_so(empty, function):
    empty.add_function("mine", function)
    with pytest.raises(SqlError, match=r"mine is a function of yours.*type hints.*def mine\(x: fl"):
        empty.sql("SELECT mine(1)")


# -- frames ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [dict, pd.DataFrame, pl.DataFrame, pa.table])
def test_a_frame_is_a_table_and_a_source(ss, make):
    ss.register("prices", make(PRICES))
    joined = "SELECT name, price FROM entities JOIN prices USING (name) ORDER BY price"
    assert ss.sql(joined).fetchall() == [("table", 80.0), ("sink", None)]
    ((heights, prices),) = ss.sql(
        "SELECT sum(z), sum(price) FROM kitchen.entities e, prices p WHERE e.name = p.name"
    ).fetchall()
    assert prices == 80.0
    assert heights == pytest.approx(-0.1)  # of the sink
    program = (
        "SELECT e.name, p.price FROM e=kitchen, p=prices WHERE e.name == p.name AND p.price == 80"
    )
    assert ss.eval(f"{program};") == [{"name": "table", "price": 80.0}]


def test_a_frame_is_copied_and_replaced(empty):
    frame = pd.DataFrame({"a": [1, 2]}, index=[7, 8])
    empty.register("t", frame)
    frame.loc[7, "a"] = 100
    query = "SELECT sum(a) FROM t"
    assert empty.sql(query).fetchone() == (3,)
    empty.register("t", empty.sql("SELECT 5 AS a"))
    assert empty.sql(query).fetchone() == (5,)
    assert empty.sql("SELECT * FROM t").columns == ["a"]
    assert "t" in [name for (name,) in empty.sql("SHOW TABLES").fetchall()]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "frame", "message"),
    [
        ("kitchen", PRICES, "'kitchen' is the name of a world"),
        ("entities", PRICES, "there is a table 'entities' already"),
        ("Joints_History", PRICES, "there is a table 'Joints_History' already"),
        ("own", PRICES, "there is a table 'own' already"),
        ("two words", PRICES, "two words"),
        ("t", [1, 2], "give a data frame of pandas"),
        ("t", {}, "give a data frame of pandas"),
        ("t", {"a": [1, "x"]}, "is no table"),
        ("t", {"a": [1], "b": [1, 2]}, "is no table"),
    ],
)
def test_what_is_no_frame_or_no_name(ss, name, frame, message):
    ss.sql("CREATE TABLE IF NOT EXISTS own(a INT)")
    with pytest.raises(ArgumentError, match=message):
        ss.register(name, frame)
    assert name == "kitchen" or name not in ss


@pytest.mark.parametrize("text", [
    "SHOW TABLES", "-- all\nSHOW TABLES;", "SELECT name FROM (SHOW TABLES)", "SHOW", "describe;",
    "SHOW ALL TABLES", "SELECT name FROM (SHOW ALL TABLES)", "SHOW TABLES FROM kitchen",
])  # fmt: skip
def test_what_ssduck_keeps_is_not_shown(ss, text):
    """There are views on a world's buffers, and the tables of its record."""
    ss.register("shown", {"a": [1]})
    found = ss.sql(text)
    names = [row[found.columns.index("name")] for row in found]
    assert ("shown" in names) == ("FROM kitchen" not in text)
    assert {"entities", "entities_history", "links_model"} <= set(names)
    assert [name for name in names if " " in name] == []
    assert all("_record_" not in schema for _, schema, _ in ss.sql("SHOW SCHEMAS"))


def test_a_text_is_no_statement(ss):
    assert ss.sql("SELECT '(SHOW TABLES)'").fetchone() == ("(SHOW TABLES)",)


def test_a_function_is_asked_anew_by_each_query():
    offset = 0.0

    def raised(height: float) -> float:
        return height + offset

    with ssduck.load("kitchen") as ss:
        ss.add_function("raised", raised)
        for offset in (0.0, 1.0, 2.0):
            values = ss.eval("SELECT raised(0.0 * z(this)) FROM kitchen LIMIT 2 AS list;")
            assert values == [offset, offset]
            assert ss.sql("SELECT raised(0.0) FROM entities LIMIT 1").fetchone() == (offset,)
