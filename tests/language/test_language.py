"""Every construct of the language: a program, the SQL that it becomes, and its value."""

import pytest

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
