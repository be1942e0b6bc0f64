"""Every construct of the language: a program, the SQL that it becomes, and its value."""

import pytest

import ssduck
from ssduck.interpreter import query_runner as queries
from tests.support.cases import sampled
from tools.write_cases import cases, prepared, sql_of

CASES = cases()


@pytest.fixture(scope="module")
def ss():
    with prepared() as interpreter:
        yield interpreter


@pytest.fixture(scope="module")
def row_by_row():
    with prepared() as interpreter:
        interpreter._planner._row_by_row = True
        yield interpreter


@pytest.fixture
def as_sql(monkeypatch):
    """Short lists, too, become SQL."""
    monkeypatch.setattr(queries, "FEW_ROWS", 0)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["of"])
def test_constructs(ss, as_sql, case):
    assert sql_of(ss, case["program"]) == case["sql"]
    assert repr(ss.eval(case["program"])) == case["value"]


@sampled("case", CASES, every=3, ids=lambda case: case["of"])
def test_row_by_row_gives_the_same(row_by_row, case):
    assert repr(row_by_row.eval(case["program"])) == case["value"]


@pytest.mark.parametrize("row_by_row", [False, True])
@pytest.mark.parametrize("value", ["0.5", "-0.5", "abs(-0.5)", "1 + sqrt(0.25)", "clip(2, 0, 0.5)"])
def test_an_aggregate_of_a_number_has_a_row_of_none(value, row_by_row):
    with ssduck.Interpreter(row_by_row=row_by_row) as ss:
        ss.add_variable("n", [1, 2])
        for condition, count in (("this > 5", 0), ("this > 1", 1)):
            rows = f"FROM n WHERE {condition};"
            assert ss.eval(f"SELECT count({value}) AS c {rows}") == [{"c": count}]
            (average,) = ss.eval(f"SELECT avg({value}) AS c {rows}")
            assert (average["c"] is None) == (count == 0)
