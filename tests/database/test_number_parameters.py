"""Raw SQL with numbers as parameters: a plan that is kept has the results of DuckDB's own."""

import math

import pybullet
import pytest

import ssduck
from ssduck.adapters.result import Result
from ssduck.database.plans import RUNS_BEFORE_PLAN
from ssduck.errors import SqlError
from tests.support.bodies import solid

# Statements, and the values of their parameters in turn.
CASES = [
    ("SELECT name FROM entities WHERE z > $low", [{"low": 0.05}, {"low": 0.15}, {"low": 9.0}]),
    ("SELECT name FROM entities WHERE z > ? AND x < ?", [[0.0, 0.5], [0.0, 0.3], [1.0, 0.3]]),
    ("SELECT *, z > $low FROM entities WHERE x > $low", [{"low": 0.1}, {"low": 0.2}]),
    ("SELECT name, $k * z FROM entities WHERE z > $k", [{"k": 0.01}, {"k": 0.02}]),
    ("SELECT name FROM entities WHERE id = $id", [{"id": 1}, {"id": 2}, {"id": 2.0}]),
    ("SELECT name FROM entities WHERE z < $1 OR z > $1", [[0.1], [math.inf], [math.nan]]),
    (
        "SELECT count(*) FROM entities WHERE z > $z GROUP BY kind HAVING count(*) > $n",
        [{"z": 0.0, "n": 1}, {"z": 0.0, "n": 3}],
    ),
    ("SELECT name FROM entities ORDER BY id LIMIT $n", [{"n": 2}, {"n": 1}]),
    ("SELECT a.name FROM entities a JOIN entities b ON a.x > b.x + $d", [{"d": 0.1}, {"d": 0.2}]),
    (
        "SELECT '$low' AS text, name FROM entities WHERE z > $low -- $low",
        [{"low": 0.05}, {"low": 9.0}],
    ),
    ("SELECT quantile_cont(z, $q) FROM entities", [{"q": 0.5}, {"q": 0.1}]),
    ("SELECT $n, name FROM entities", [{"n": 1}, {"n": 2}]),  # INTEGER, and not BIGINT
    ("SELECT name FROM entities WHERE kind = $kind", [{"kind": "kinbody"}, {"kind": "robot"}]),
    ("SELECT name FROM entities WHERE (z > $low) = $yes", [{"low": 0.0, "yes": True}]),
    ("SELECT name FROM entities WHERE id < $id", [{"id": 2**40}, {"id": 3 * 2**40}]),
]


def boxes(client, numbers):
    """Adds boxes, each higher than the one before, and returns their names."""
    return {
        solid(
            client,
            pybullet.GEOM_BOX,
            1,
            [0.1 * i, 0, 0.05 * i + 0.02],
            halfExtents=[0.02, 0.02, 0.02],
        ): f"b{i}"
        for i in numbers
    }


@pytest.fixture
def ss(client):
    """An interpreter with five boxes."""
    with ssduck.Interpreter(recording=None) as ss:
        ss.add_variable("sim", ssduck.World.attach(client, names=boxes(client, range(5))))
        ss.sql("FROM entities LIMIT 0")  # makes the view
        yield ss


def described(result):
    """A result with its columns and types."""
    return result.columns, result.types, sorted(map(repr, result.fetchall()))


@pytest.mark.parametrize(("sql", "values"), CASES, ids=[case[0] for case in CASES])
def test_results_are_those_of_duckdb(ss, sql, values):
    for parameters in values:
        with ss._database.pinned(set()):
            expected = described(Result(ss._database.connection.table(sql, parameters)))
        for _ in range(RUNS_BEFORE_PLAN + 2):
            assert described(ss.sql(sql, parameters)) == expected


@pytest.mark.parametrize("parameters", [{}, {"high": 0.1}, {"low": 0.1, "high": 0.1}, [0.1, 0.2]])
def test_missing_and_further_parameters_are_errors(ss, parameters):
    sql = CASES[0][0]
    for _ in range(RUNS_BEFORE_PLAN + 2):
        expected = ss.sql(sql, {"low": 0.05}).fetchall()
    for _ in range(RUNS_BEFORE_PLAN + 2):
        with pytest.raises(SqlError):
            ss.sql(sql, parameters)
    assert ss.sql(sql, {"low": 0.05}).fetchall() == expected


def test_names_that_differ_by_case_are_not_confused(ss):
    sql = "SELECT name FROM entities WHERE z > $low"
    for _ in range(RUNS_BEFORE_PLAN + 2):
        with ss._database.pinned(set()):
            expected = ss._database.connection.table(sql, {"LOW": 0.15}).to_pylist()
        assert ss.sql(sql, {"LOW": 0.15}).arrow().to_pylist() == expected


def test_a_new_body_is_in_the_results(ss, client):
    sql = CASES[0][0]
    for _ in range(RUNS_BEFORE_PLAN + 2):
        before = ss.sql(sql, {"low": 0.0}).fetchall()
    boxes(client, [7])
    ss.call_variable("sim").tick()
    for _ in range(RUNS_BEFORE_PLAN + 2):
        assert len(ss.sql(sql, {"low": 0.0}).fetchall()) == len(before) + 1
