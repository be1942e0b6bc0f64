"""The greatest size of an answer: it is known for plain products of tables, and never too small."""

from unittest.mock import patch

import duckdb
import hypothesis.strategies as st
import pytest
from hypothesis import given
from sqlglot import parse_one

import ssduck
from ssduck.database import fetched_rows
from ssduck.database.connection import execution_of
from ssduck.database.fetched_rows import RepeatedStatements, _measured_rows
from ssduck.database.kept_plans import answer_bound, parameter_source
from ssduck.errors import LimitError
from ssduck.schema import Column
from ssduck.world.live_tables import LiveTable

# The sizes of a row and a value, bytes, as the module has them.
ROW, VALUE = 64, 32
COLUMNS = (Column("id", "integer", ""), Column("name", "string", ""), Column("z", "double", ""))


def table_of(names):
    table = LiveTable(COLUMNS)
    table.fill(len(names), {"id": list(range(len(names))), "name": names})
    return table


def bound_of(sql, **tables):
    select = parse_one(sql, read="duckdb")
    return answer_bound(select, {name: parameter_source(table) for name, table in tables.items()})


@pytest.mark.parametrize(
    "sql",
    [
        "SELECT unnest([a.id, 1]) FROM a",
        "SELECT a.id FROM a, unnest([1, 2])",
        "SELECT a.id FROM a, LATERAL (SELECT 1)",
        "SELECT a.id FROM a FULL JOIN b ON a.id = b.id",
        "SELECT a.id FROM a WHERE a.id IN (SELECT b.id FROM b)",
        "SELECT a.id FROM (SELECT * FROM b) AS a",
        "SELECT a.id FROM a, c",
        "SELECT a.id FROM a, range(1000) AS r(n)",
    ],
)
def test_the_size_of_other_queries_is_not_known(sql):
    assert bound_of(sql, a=table_of(["x"]), b=table_of(["y"])) is None


@pytest.mark.parametrize(
    "column", ["repeat(a.name, 1000)", "'a text'", "name", "c.name", "a.other"]
)
def test_the_size_of_other_texts_is_not_known(column):
    bound = bound_of(f"SELECT {column} FROM a", a=table_of(["x"]))
    assert bound.size(["VARCHAR"], 100) is None
    assert bound.size(["DOUBLE"], 100) == 100


TEXTS = st.lists(st.none() | st.text(max_size=9), max_size=5)


@pytest.mark.slow
@given(TEXTS, TEXTS, st.sampled_from(["", " WHERE a.id <= b.id", " GROUP BY ALL", " LIMIT 3"]))
def test_no_answer_is_larger(first, second, rest):
    a, b = table_of(first), table_of(second)
    sql = f"SELECT a.name, b.name AS other, a.id + b.id FROM a CROSS JOIN b{rest}"
    with duckdb.connect() as plain:
        plain.register("a", a.arrow)
        plain.register("b", b.arrow)
        rows = plain.execute(sql).fetchall()
    letters = sum(len(value) for row in rows for value in row[:2] if value is not None)
    assert bound_of(sql, a=a, b=b).size(["VARCHAR", "VARCHAR", "BIGINT"], 100) >= (
        100 * len(rows) + letters
    )


def test_the_size_is_that_of_the_present_rows():
    table = table_of(["x"] * 3)
    bound = bound_of("SELECT a.id FROM a JOIN b ON a.id < b.id", a=table, b=table_of(["y"] * 2))
    assert bound.size(["BIGINT"], 10) == 60
    table.resize(2)
    assert bound.size(["BIGINT"], 10) == 40


PAIRS = "SELECT a.id, b.id, a.z FROM a=kitchen, b=kitchen AS list;"
JOINED = "SELECT a.id + b.id FROM a=kitchen, b=kitchen AS list;"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("program", "limits", "runs"),
    [
        (PAIRS, {}, 3),
        (PAIRS, {"rows": 2_000}, 3),
        (JOINED, {}, 0),
        # DuckDB makes the groups, and how many there are is not known before.
        ("SELECT id(a), max(z(b)) FROM a=kitchen, b=kitchen GROUP BY id(a), id(b) AS list;", {}, 0),
    ],
)
def test_answers_that_are_surely_small_are_fetched_by_column(program, limits, runs):
    fetched, measured = [], fetched_rows._measured_rows
    limits = ssduck.Limits.strict(progress=False, **limits)
    with ssduck.load("kitchen", limits=limits) as ss, ssduck.load("kitchen") as free:
        wanted, compiled = free.eval(program), ss.compile(program)
        with patch.object(
            fetched_rows, "_measured_rows", lambda *args: fetched.append(1) or measured(*args)
        ):
            for _ in range(7):
                assert ss.eval(compiled) == wanted
    assert len(fetched) >= runs if runs else not fetched


@pytest.mark.slow
def test_more_rows_than_allowed_are_an_error_when_fetched_by_column():
    program = "SELECT a.id, b.id, a.z FROM a=kitchen, b=kitchen WHERE a.z <= height AS list;"
    limits = ssduck.Limits.strict(progress=False, rows=1_000)
    with ssduck.load("kitchen", limits=limits) as ss:
        ss.add_variable("height", -1.0)
        compiled = ss.compile(program)
        for _ in range(6):
            assert ss.eval(compiled) == []
        for _ in range(3):
            ss.add_variable("height", 9.0)
            with pytest.raises(LimitError, match="more than 1000 rows"):
                ss.eval(compiled)
        ss.add_variable("height", -1.0)
        assert ss.eval(compiled) == []


def test_rows_that_are_fetched_by_column_are_measured_exactly():
    statements, execution, sizes = RepeatedStatements(), execution_of("texts"), []
    with duckdb.connect() as plain:
        text = "CASE WHEN n % 3 = 0 THEN 'wört ' || n END"
        plain.execute(f'PREPARE "texts" AS SELECT n, {text} FROM range(300) t(n)')
        wanted = plain.execute(execution).fetchall()
        for bound in (None, lambda *_: None, lambda *_: 10**9, lambda *_: 50_000):
            with patch.object(fetched_rows, "_measured_rows", wraps=_measured_rows) as measured:
                for _ in range(2):
                    sizes.clear()
                    rows = statements.rows(plain, execution, None, 10**6, sizes.append, bound)
                    assert rows == wanted
                    letters = sum(len(value) for _, value in wanted if value is not None)
                    assert sum(sizes) == 300 * (ROW + 2 * VALUE) + letters
            assert measured.called == (bound is not None and bound() == 50_000)
