"""Random queries of SQL: SelectScript gives what DuckDB gives, or an error."""

import re
import warnings

import duckdb
import pytest

import ssduck
from ssduck.database.plans import RUNS_BEFORE_PLAN
from ssduck.errors import ProgramWarning, SelectScriptError
from ssduck.interpreter import query_runner
from tests.sql.habits.test_queries import DATA
from tests.support.cases import generated, sampled
from tests.support.choices import seeded
from tests.support.sql_grammar import COLUMNS, sql_query

# The number of queries of a case, and of those that have to be answered.
QUERIES = 20
ANSWERED = 10


@pytest.fixture(scope="module")
def world():
    with ssduck.load(DATA / "room.toml") as loaded:
        yield loaded.call_variable("room")


@pytest.fixture(scope="module")
def table(world):
    """A DuckDB database with the columns of the world, from PyBullet's poses and masses."""
    with duckdb.connect() as connection:
        types = ["TEXT"] * 4 + ["BOOLEAN"] * 2 + ["DOUBLE"] * 4
        columns = ", ".join(f"{name} {kind}" for name, kind in zip(COLUMNS, types, strict=True))
        connection.execute(f"CREATE TABLE room ({columns})")
        for entity in world:
            x, y, z = map(float, entity.position)
            texts = [entity.name, entity.kind, entity.name, entity.kind]
            flags = [entity.kind == "robot", entity.kind == "kinbody"]
            row = [*texts, *flags, z, x, y, entity.mass]
            connection.execute(f"INSERT INTO room VALUES ({', '.join('?' * len(row))})", row)
        # The sum over no rows is 0 in SelectScript.
        connection.execute("CREATE MACRO total(x) AS coalesce(sum(x), 0)")
        yield connection


@pytest.fixture(scope="module", params=["as SQL", "row by row"])
def ss(request, world):
    few, query_runner.FEW_ROWS = query_runner.FEW_ROWS, 0
    by_rows = request.param == "row by row"
    with ssduck.Interpreter(row_by_row=by_rows, recording=None) as interpreter:
        interpreter.add_variable("room", world)
        columns = ", ".join(COLUMNS)
        interpreter.add_variable("dicts", interpreter.eval(f"SELECT {columns} FROM room;"))
        yield interpreter
    query_runner.FEW_ROWS = few


def comparable(value):
    """Returns a value that equals another one up to rounding, and only one of its kind."""
    if value is None or isinstance(value, bool | str):
        return repr(value)
    return repr(round(float(value), 9) + 0.0)


def rows_of(ss, text):
    """Returns the rows of a query in SelectScript, those of groups one after another."""
    value = ss.eval(text)
    rows = [row for group in value.values() for row in group] if type(value) is dict else value
    return [tuple(map(comparable, row.values())) for row in rows]


def rows_of_sql(table, text):
    text = re.sub(r"(?i)\bsum\(", "total(", text)
    return [tuple(map(comparable, row)) for row in table.execute(text).fetchall()]


@pytest.mark.slow
def test_random_queries_give_the_same_at_each_run(world, monkeypatch):
    """The first runs are DuckDB's own, the last ones have plans that are kept."""
    monkeypatch.setattr(query_runner, "FEW_ROWS", 0)
    answered = 0
    with ssduck.Interpreter(recording=None) as ss:
        ss.add_variable("room", world)
        for seed in range(generated(QUERIES)):
            query = sql_query(seeded(5000 + seed))
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ProgramWarning)
                try:
                    runs = [rows_of(ss, query.text) for _ in range(RUNS_BEFORE_PLAN + 2)]
                except SelectScriptError:
                    continue
            answered += 1
            ordered = runs if query.is_ordered else [sorted(rows) for rows in runs]
            assert ordered == [ordered[0]] * len(runs), query.text
    assert answered >= ANSWERED


@pytest.mark.slow
@pytest.mark.parametrize("source", ["room", "dicts"])
@sampled("start", range(0, generated(100), QUERIES), every=5)
def test_random_queries_give_what_sql_gives_or_an_error(ss, table, start, source):
    answered, before = 0, set(ss)
    for seed in range(start, start + QUERIES):
        query = sql_query(seeded(seed + 1000 * (source == "dicts")))
        wanted = rows_of_sql(table, query.text)
        text = re.sub(r"(\bFROM|\bJOIN|,) room\b", rf"\1 {source}", query.text)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ProgramWarning)
            try:
                found = rows_of(ss, text)
            except SelectScriptError:
                continue
        answered += 1
        if query.is_ordered:
            assert found == wanted, text
        else:
            assert sorted(found) == sorted(wanted), text
    assert answered >= ANSWERED
    assert set(ss) == before  # no query sets a variable
