"""Aggregates of values that are the same for all rows are over these, however many there are."""

import pytest

import ssduck


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
