"""SQL for other engines: SQLite runs it as the oracle; what an engine lacks is named."""

import sqlite3

import pytest
import sqlglot

import ssduck
from ssduck.errors import ArgumentError, UnknownNameError, UnsupportedError


@pytest.fixture(scope="module")
def ss(shared_kitchen):
    with ssduck.Interpreter() as interpreter:
        interpreter.add_variable("kitchen", shared_kitchen)
        interpreter.eval("table = SELECT obj FROM kitchen WHERE id(this) == 'table' AS value;")
        interpreter.eval('low = 0.5; name = "it\'s a \\"can\\"";')
        interpreter.add_function("odd", lambda entity: entity.id % 2 == 1)
        yield interpreter


@pytest.fixture(scope="module")
def sqlite(ss):
    """The table of entities, in SQLite."""
    table = ss.sql("FROM entities")
    connection = sqlite3.connect(":memory:")
    connection.execute("ATTACH ':memory:' AS kitchen")
    connection.execute(f"CREATE TABLE kitchen.entities ({', '.join(table.columns)})")
    marks = ", ".join("?" * len(table.columns))
    connection.executemany(f"INSERT INTO kitchen.entities VALUES ({marks})", table.fetchall())
    yield connection
    connection.close()


PORTABLE = [
    "SELECT id FROM kitchen WHERE isRobot(this) AS list;",
    "SELECT id, z, volume FROM kitchen WHERE above(table, this) AND volume(this) < 0.001 AS list;",
    "SELECT id FROM kitchen WHERE within(table, this) AS list;",
    "SELECT id FROM kitchen WHERE below(table, this) AS list;",
    "SELECT id(a.this), id(b.this) FROM a=kitchen, b=kitchen WHERE below(a.this, b.this) AS list;",
    "SELECT id FROM kitchen WHERE distance(table, this) < 1.5 AND z(this) > low AS list;",
    "SELECT (z(this) + 1) * 2 - x(this) / 4 FROM kitchen AS list;",
    "SELECT id FROM kitchen WHERE isRobot(this) XOR z(this) > 1 AS list;",
    "SELECT IF(isRobot(this); 'robot'; 'other') FROM kitchen AS list;",
    "SELECT id FROM kitchen WHERE id(this) IN ['can', 'sink', 'none'] AS list;",
    "SELECT id FROM kitchen WHERE NOT (isKinbody(this) OR isSensor(this)) AS list;",
    "SELECT id FROM kitchen ORDER BY type DESC, z, id LIMIT 7 AS list;",
    "SELECT id(a.this), id(b.this) FROM a=kitchen, b=kitchen WHERE above(a.this, b.this) AS list;",
    "SELECT id FROM k=kitchen WHERE count(SELECT obj FROM o=kitchen WHERE above(k.this, o.this) AS list) > 1 AS list;",
    "SELECT id FROM k=kitchen WHERE [] == (SELECT obj FROM o=kitchen WHERE above(o.this, k.this) AS list) AS list;",
    "SELECT id FROM k=kitchen WHERE 'cup_905a' IN (SELECT id FROM o=kitchen WHERE above(k.this, o.this) AS list) AS list;",
    "SELECT id FROM kitchen WHERE id(this) == name AS list;",
]


@pytest.mark.parametrize("program", PORTABLE)
def test_sqlite_and_duckdb_give_the_same(ss, sqlite, program):
    compiled, expected = ss.compile(program), ss.eval(program)
    rows = sqlite.execute(compiled.sql(dialect="sqlite")).fetchall()
    assert [value for row in rows for value in row] == pytest.approx(expected)
    rows = ss.sql(compiled.sql()).fetchall()
    assert [value for row in rows for value in row] == expected


@pytest.mark.parametrize("dialect", ["postgres", "mysql", "snowflake", "bigquery", "tsql"])
@pytest.mark.parametrize("program", PORTABLE)
def test_other_engines_have_all_of_it(ss, program, dialect):
    """What comes out is that dialect's, and has no word that is DuckDB's alone."""
    try:
        text = ss.compile(program).sql(dialect=dialect)
    except UnsupportedError as error:
        pytest.fail(f"{error}")
    assert sqlglot.parse_one(text, dialect=dialect)
    words = ("list_", "unnest", "generate_subscripts", "error(", "left to python")
    assert not any(word in text.lower() for word in words)


@pytest.mark.parametrize(
    ("program", "offending", "words"),
    [
        ("SELECT id FROM kitchen WHERE odd(this);", "odd(this)", "left to Python"),
        (
            "SELECT id FROM kitchen WHERE round(z(this)) > 1;",
            "round(z(this)) > 1",
            "left to Python",
        ),
        (
            "SELECT DISTINCT [z] FROM kitchen GROUP BY type;",
            "SELECT DISTINCT [z] FROM kitchen GROUP BY type",
            "GROUP BY is left",
        ),
        (
            "SELECT z FROM kitchen GROUP BY type;",
            "SELECT z FROM kitchen GROUP BY type",
            "GROUP BY is",
        ),
        ("SELECT stddev(z) FROM kitchen;", "stddev(z)", "left to Python"),
        ("SELECT position FROM kitchen;", "SELECT position FROM kitchen", "has lists like"),
        ("SELECT 1 / z(this) FROM kitchen;", "SELECT 1 / z(this) FROM kitchen", "ERROR"),
        ("SELECT this FROM [1, 2];", "SELECT this FROM [1, 2]", "has lists like"),
        (
            "SELECT this FROM [1] START WITH n=1 CONNECT BY UNIQUE n=n+1 STOP WITH n == 2;",
            "SELECT this FROM [1] START WITH n=1 CONNECT BY UNIQUE n=n+1 STOP WITH n == 2",
            "row by row",
        ),
    ],
)
def test_what_an_engine_lacks_is_named(ss, program, offending, words):
    with pytest.raises(UnsupportedError, match=words) as caught:
        ss.compile(program).sql(dialect="postgres")
    error = caught.value
    assert error.text[error.span.start : error.span.end] == offending


def test_unknown_dialects_and_what_is_no_query(ss):
    with pytest.raises(UnknownNameError, match="no SQL dialect 'postgre'") as caught:
        ss.compile("SELECT id FROM kitchen;").sql(dialect="postgre")
    assert "postgres" in caught.value.suggestions
    with pytest.raises(ArgumentError, match="does not end with a query"):
        ss.compile("1 + 1;").sql()


def test_asking_for_sql_changes_no_variable(ss):
    ss.eval("kept = 1;")
    assert "2" in ss.compile("kept = 2; SELECT z(this) * kept FROM kitchen;").sql("sqlite")
    assert ss.eval("kept;") == 1
