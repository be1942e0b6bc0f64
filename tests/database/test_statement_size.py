"""SQL of strangers whose plan, types or values would be far larger than its text."""

from __future__ import annotations

import time

import pytest

import ssduck
from ssduck.database.strict import statement_size
from ssduck.database.strict.statement_size import MAX_SIZE
from ssduck.errors import LimitError, SqlError


@pytest.fixture(scope="module")
def strict(shared_kitchen):
    limits = ssduck.Limits.strict(seconds=20, memory=100_000_000)
    with ssduck.Interpreter(limits=limits) as ss:
        ss.add_variable("kitchen", shared_kitchen)
        yield ss


def nested(form, times, start):
    """Returns a text within itself: § is the place of the inner one."""
    for _ in range(times):
        start = form.replace("§", start)
    return start


def chain(first, form, times, *, is_inlined=False):
    """Returns a query of WITH in which each part, q1, q2, …, has a form of the one before, §."""
    kind = "NOT MATERIALIZED " if is_inlined else ""
    parts = [f"q0 AS {kind}({first})"]
    parts += [f"q{n} AS {kind}({form.replace('§', f'q{n - 1}')})" for n in range(1, times + 1)]
    return f"WITH {', '.join(parts)} SELECT count(*) FROM q{times}"


def aliases(first, times):
    return f"SELECT {first} AS a0, " + ", ".join(f"a{n}||a{n} AS a{n + 1}" for n in range(times))


def pivot(*counts, aggregates="count(*)"):
    """Returns a PIVOT of a column for each number, by as many values."""
    parts = ", ".join(f"n AS c{column}" for column, _ in enumerate(counts))
    values = (f"c{column} IN ({', '.join(map(str, range(n)))})" for column, n in enumerate(counts))
    return f"(SELECT {parts} FROM range(3) t(n)) PIVOT ({aggregates} FOR {' '.join(values)})"


def grouped(*counts, word="ROLLUP"):
    """Returns a SELECT that is grouped by a ROLLUP or CUBE for each number, of as many columns."""
    sets = (f"{word}({', '.join(f'n + {i}' for i in range(count))})" for count in counts)
    return f"SELECT count(*) FROM range(3) t(n) GROUP BY {', '.join(sets)}"


EXPRESSION = "(\\pL\\pN\\PL){3}"
TOO_LARGE = [
    f"SELECT {', '.join(f'name ~ {chr(39)}{EXPRESSION}{n}{chr(39)}' for n in range(120))} FROM entities",
    f"SELECT name ~ '{EXPRESSION}' AS a, [{', '.join('a' * 60)}] AS b, [b, b] FROM entities",
    f"SELECT {', '.join([f'max(COLUMNS({chr(39)}id|{EXPRESSION}{chr(39)}))'] * 200)} FROM entities",
    f"SELECT * SIMILAR TO '{EXPRESSION}' FROM (SELECT *, * , *, * FROM entities)",
    f"SELECT count(*) FROM {pivot(46, 46, 46)}",
    f"SELECT count(*) FROM {pivot(120, 120, aggregates='count(*), max(c0), min(c0)')}",
    f"SELECT 1 WHERE EXISTS (FROM {pivot(200, 200)})",
    " UNION ALL ".join([f"SELECT count(*) FROM {pivot(90, 90)}"] * 4),
    grouped(9, word="CUBE"),
    grouped(17, 17),
    f"SELECT 1 FROM ({grouped(16, 16)}), ({grouped(16)})",
    f"SELECT length({nested('hex(§)', 40, 'name')}) FROM entities",
    f"SELECT length({nested('bin(§)', 14, 'name')}) FROM entities",
    f"SELECT length({nested('to_base64(§::BLOB)', 30, 'name')}) FROM entities",
    f"SELECT length({nested('regexp_escape(§)', 40, 'name')}) FROM entities",
    f"SELECT length({nested('to_json(§)::VARCHAR', 40, 'name')}) FROM entities",
    f"SELECT length({nested('[§]::VARCHAR', 60, 'name')}) FROM entities",
    f"SELECT {nested('list_transform(§, lambda x: x || x)', 30, '[name]')} FROM entities",
    f"SELECT {nested('list_transform(§, lambda x, i: [x, x])', 30, '[name]')} FROM entities",
    "SELECT "
    + nested("list_filter(list_transform(§, lambda x: {a: x, b: x}), lambda y: true)", 25, "[z]")
    + " FROM entities",
    aliases("'a'", 30),
    f"{aliases('name', 30)} FROM entities",
    f"DESCRIBE {aliases('1', 30)}",
    f"SELECT 1 WHERE EXISTS ({aliases('name', 30)} FROM entities)",
    f"SELECT 1 ORDER BY ({aliases('name', 30)} FROM entities)",
    f"SELECT 1 UNION ALL ({aliases('name', 30)} FROM entities)",
    f"SELECT 1 FROM entities JOIN ({aliases('1', 30)}) ON true",
    f"VALUES ((SELECT a9 FROM ({aliases('1', 30)})))",
    f"FROM {nested('(SELECT s || s AS s FROM §)', 32, '(SELECT name AS s FROM entities)')}",
    f"FROM {nested('(SELECT [s, s] AS s FROM §)', 32, '(SELECT 1 AS s)')}",
    f"FROM {nested('(SELECT {a: s, b: s} AS s FROM §)', 32, '(SELECT 1 AS s)')}",
    f"FROM {nested('(SELECT {a: t, b: t} AS s FROM § AS t)', 32, '(SELECT 1 AS s)')}",
    f"FROM {nested('(SELECT (c || c) AS s FROM § AS t(c))', 32, '(SELECT name FROM entities)')}",
    f"SELECT 1 FROM {nested('(SELECT *, * FROM §)', 32, '(SELECT 1 AS s)')}",
    f"SELECT 1 FROM {nested('(SELECT *, COLUMNS(*) FROM §)', 20, 'entities')}",
    f"SELECT {', '.join('*' * 300)} FROM entities",
    f"SELECT {', '.join(['COLUMNS(*)'] * 300)} FROM entities",
    chain("SELECT 1 AS s", "SELECT {a: s, b: s} AS s FROM §", 40),
    chain("SELECT name AS s FROM entities", "SELECT concat(s, s, s) AS s FROM §", 30),
    chain("SELECT 1 AS s", "SELECT *, * FROM §", 40),
    chain("SELECT 1 AS s", "SELECT p.s FROM § p, § q", 40, is_inlined=True),
    chain("SELECT 1 AS s", "SELECT p.s FROM § p WHERE s IN (FROM §)", 40, is_inlined=True),
    f"SELECT {nested('list_transform([1], lambda x: §)', 20, '1')}",
    f"SELECT {nested('list_filter([1], lambda x: len(§) > 0)', 24, '[1]')}",
    f"SELECT {nested('[§ for x in [1] if x > 0]', 20, '1')}",
    "WITH RECURSIVE r AS (SELECT 1 AS s UNION ALL SELECT s FROM "
    f"{nested('(SELECT [s, s] AS s FROM §)', 32, 'r')}) SELECT 1 FROM r",
]


@pytest.mark.parametrize("text", TOO_LARGE)
def test_what_would_grow_beyond_bounds_is_refused_before_it_is_planned(strict, text):
    started = time.process_time()
    with pytest.raises(LimitError, match=r"would be too large|nested deeper|joins at most"):
        strict.sql(text)
    assert time.process_time() - started < 5


@pytest.mark.parametrize(
    "text",
    [
        grouped(250, 250),
        grouped(400),
        grouped(1, 1, 1, 1),
        grouped(1, 1, 1, 1).replace("(", " /* ( */ (").replace("ROLLUP", "rollup -- (\n"),
        "SELECT 1 GROUP BY " + ", ".join(["GROUPING /* of */ SETS (())"] * 4),
    ],
)
def test_grouping_sets_that_take_long_to_parse_are_refused_before(strict, text):
    started = time.process_time()
    with pytest.raises(LimitError, match="ROLLUP, CUBE or GROUPING SETS has at most 3 of them"):
        strict.sql(text)
    assert time.process_time() - started < 1


def test_names_that_are_equal_to_python_only_are_told_apart(strict):
    """A small query does not take the place of a large one: KELVIN SIGN is no k to DuckDB."""
    large = "k0 AS (SELECT 1 AS s), " + ", ".join(
        f'"\u212a{n}" AS (SELECT 1 AS s), k{n + 1} AS (SELECT [s, s] AS s FROM k{n})'
        for n in range(22)
    )
    with pytest.raises(LimitError, match="would be too large"):
        strict.sql(f"WITH {large} SELECT len(s) FROM k22")


HARMLESS = [
    ("SELECT count(*) FROM entities WHERE name IN ('cube', 'cube (1)', 'a cube', 'rollup')", 0),
    (
        f"SELECT max(n) FROM (SELECT n AS cube, n AS sets, n AS rollup, {', '.join(['n'] * 300)} FROM range(3) t(n))",
        2,
    ),
    (
        "SELECT "
        + " OR ".join(f"bool_or(name ~ '^box_{n}$')" for n in range(300))
        + " FROM entities",
        False,
    ),
    ("SELECT mode(kind) OVER (ORDER BY id) = mode(kind) OVER () FROM entities LIMIT 1", None),
    ("SELECT count(DISTINCT kind) OVER () FROM entities LIMIT 1", None),
    ("SELECT max(z) OVER (ORDER BY id ROWS 3 PRECEDING EXCLUDE TIES) FROM entities LIMIT 1", None),
    (f"SELECT count(*) FROM {pivot(50, 50)}", 1),
    (f"SELECT count(*) FROM {pivot(3, 4, aggregates='count(*), max(c0)')}", 1),
    (f"SELECT count(*) FROM ({grouped(8, word='CUBE')})", 1 + 3 * 255),
    (f"SELECT count(*) FROM ({grouped(2, 3)})", 1 + 3 * 11),
    ("SELECT count(*) FROM (SELECT 1 FROM entities GROUP BY GROUPING SETS ((kind), ()))", None),
    ("SELECT count(*) FROM (SELECT *, upper(name) AS u FROM entities) WHERE u LIKE 'C%'", None),
    (f"SELECT length({nested('hex(§)', 6, chr(39) + 'ab' + chr(39))})", 128),
    (chain("SELECT 1 AS s", "SELECT s + 1 AS s, s AS before FROM §", 60), 1),
    (chain("SELECT 1 AS s", "SELECT p.s FROM § p, § q", 30), 1),
    (chain("FROM entities", "FROM § WHERE z > (SELECT min(z) FROM §)", 5, is_inlined=True), None),
    (f"SELECT max(a8) FROM ({aliases(chr(39) + 'a' + chr(39), 8)})", "a" * 256),
    (f"SELECT {nested('(SELECT max(z) + § FROM entities)', 40, '1')} > 1", True),
    ("SELECT sum(" + " + ".join(f"z * {n}" for n in range(300)) + ") > 0 FROM entities", True),
    ("SELECT count(*) FROM (SELECT a.*, b.* FROM entities a, entities b)", 37 * 37),
    (f"SELECT {nested('list_transform([1], lambda x: §)', 5, '1')}", [[[[[1]]]]]),
    (
        f"SELECT count(*) FROM entities {''.join(f' JOIN entities e{n} USING (id)' for n in range(20))}",
        37,
    ),
    ("SELECT count(*) FROM (FROM entities" + " UNION ALL FROM entities" * 200 + ")", 201 * 37),
]


@pytest.mark.parametrize(("text", "value"), HARMLESS)
def test_ordinary_queries_are_not_refused(strict, text, value):
    ((found,),) = strict.sql(text).fetchall()
    assert value is None or found == value


def test_the_bound_of_values(strict):
    """Lists of two lists have twice the size, and a part more, at each level."""
    form, start = "(SELECT [s, s] AS s FROM §)", "(SELECT 1 AS s)"
    levels = (MAX_SIZE // 2).bit_length() - 1
    ((length,),) = strict.sql(f"SELECT len(s) FROM {nested(form, levels - 1, start)}").fetchall()
    assert length == 2
    with pytest.raises(LimitError, match="too large"):
        strict.sql(f"SELECT len(s) FROM {nested(form, levels + 1, start)}")


def test_the_bound_of_tables(strict, monkeypatch):
    monkeypatch.setattr(statement_size, "MAX_TABLES", 20)
    query = "WITH q AS NOT MATERIALIZED (SELECT 1 AS s FROM entities LIMIT 1) SELECT count(*) FROM "
    assert strict.sql(query + ", ".join(f"q q{n}" for n in range(20))).fetchall() == [(1,)]
    with pytest.raises(LimitError, match="too large"):
        strict.sql(query + ", ".join(f"q q{n}" for n in range(21)))


MANY = range(101)
JOINS = {
    "commas": f"SELECT 1 FROM {', '.join(f'entities t{n}' for n in MANY)}",
    "USING": f"FROM entities {' '.join(f'JOIN entities t{n} USING (id)' for n in MANY)}",
    "values": f"SELECT {', '.join(['(SELECT max(id) FROM entities)'] * 101)}",
    "conditions": f"FROM entities WHERE {' AND '.join(['id IN (SELECT id FROM entities)'] * 101)}",
}


@pytest.mark.slow
@pytest.mark.parametrize("text", JOINS.values(), ids=JOINS)
def test_the_bound_of_a_join(strict, text):
    """DuckDB looks for the order of 600 tables for half a minute, and nothing interrupts it."""
    with pytest.raises(LimitError, match="joins at most 100 tables and nested queries"):
        strict.sql(text)


# What a SELECT of the greatest size joins, and one of the next.
EDGES = {
    "tables": lambda n: f"SELECT 1 FROM {', '.join(f'ticks t{i}' for i in range(n))}",
    "values": lambda n: f"SELECT {', '.join(['(SELECT max(id) FROM entities)'] * n)}",
    "values without FROM": lambda n: f"SELECT {', '.join(['(SELECT 1)'] * n)}",
    "values of a table": lambda n: f"SELECT {', '.join(['(SELECT 1)'] * (n - 1))} FROM ticks",
    "a union": lambda n: (
        f"SELECT {', '.join(['(SELECT 1)'] * n)} UNION {'SELECT 1' + ', 1' * (n - 1)}"
    ),
    "a nested query": lambda n: f"FROM (SELECT {', '.join(['(SELECT 1)'] * (n - 1))})",
}


@pytest.mark.slow
@pytest.mark.parametrize("text", EDGES.values(), ids=EDGES)
def test_a_select_joins_as_many_tables_as_the_message_says(strict, text):
    assert strict.sql(text(100)).fetchall()
    with pytest.raises(LimitError, match="joins at most 100 tables and nested queries"):
        strict.sql(text(101))


@pytest.mark.slow
def test_many_relations_are_not_rewritten():
    """The time to rewrite them grew with the square of their number, and was not limited."""
    count = 25
    tables = ", ".join(f"entities e{i}" for i in range(count))
    calls = " AND ".join(f"near(e{i}, e{j}, 1)" for i in range(count) for j in range(i))
    with ssduck.load("kitchen", limits=ssduck.Limits.strict(seconds=0.5)) as ss:
        started = time.process_time()
        with pytest.raises(LimitError):
            ss.sql(f"SELECT count(*) FROM {tables} WHERE {calls}")
        assert time.process_time() - started < 8


@pytest.mark.parametrize(
    "function", ["reservoir_quantile(z, 0.5, 2000000000)", "approx_top_k(z, 9)"]
)
def test_functions_that_allocate_by_a_number_are_not_there(strict, function):
    with pytest.raises(LimitError, match="no function that SQL may call"):
        strict.sql(f"SELECT {function} FROM entities")


@pytest.mark.parametrize("is_strict", [False, True])
def test_a_type_that_arrow_cannot_nest_is_an_error(strict, is_strict):
    text = f"SELECT '{'[' * 90}{']' * 90}'::INTEGER{'[]' * 90}"
    with ssduck.Interpreter() as free, pytest.raises(SqlError, match="Recursion level"):
        (strict if is_strict else free).sql(text)
    assert strict.sql("SELECT 42").fetchall() == [(42,)]


@pytest.mark.parametrize("text", ["", "  ", "\n"])
def test_a_text_without_a_word_is_no_select(strict, text):
    with pytest.raises(LimitError, match="the text has 0 statements"):
        strict.sql(text)


@pytest.mark.slow
@pytest.mark.parametrize(("text", "place"), [("\ud800", 1), ("SELECT '\udc00\ud800'", 9)])
def test_half_a_surrogate_pair_is_refused_before_anything_is_done(text, place):
    words = f"half of a surrogate pair as its letter {place}:"
    with (
        ssduck.load("hall", limits=ssduck.Limits.strict()) as ss,
        pytest.raises(SqlError, match=words),
    ):
        ss.sql(text)
