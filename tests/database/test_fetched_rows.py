"""Rows of statements: all values as DuckDB has them, and their sizes counted under limits."""

import duckdb
import pytest

import ssduck
from ssduck.database.fetched_rows import RowLimits, all_rows, arrow_table, columns_of
from ssduck.errors import LimitError

ROWS = 5_000
# The sizes of a row, a value and a text, bytes, as the module has them.
ROW, VALUE, TEXT = 64, 32, 56


def test_no_more_rows_are_fetched_than_asked():
    select = f"SELECT n || '' FROM range({ROWS}) t(n)"
    with duckdb.connect() as plain:
        rows = RowLimits(7, lambda _: None).rows(plain.execute(select))
        assert rows == plain.execute(select).fetchall()[:7]


PAIRS = "SELECT a.id, b.id, a.z FROM a=kitchen, b=kitchen AS list;"


@pytest.mark.slow
def test_a_statement_that_is_prepared_anew_has_its_own_types():
    with ssduck.load("kitchen", limits=ssduck.Limits.strict(progress=False)) as ss:
        program = ss.compile(PAIRS)
        for _ in range(6):
            ss.eval(program)
        ss.call_variable("kitchen").step(1)
        texts = ss.compile("SELECT name(this), kind FROM kitchen AS list;")
        for _ in range(6):
            assert all(isinstance(value, str) for row in ss.eval(texts) for value in row)
        assert len(ss.eval(program)) == 3 * len(ss.eval("SELECT id FROM kitchen AS list;")) ** 2


@pytest.mark.slow
def test_more_rows_than_allowed_are_an_error_of_a_kept_statement():
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


def test_texts_beyond_the_memory_are_an_error():
    limits = ssduck.Limits(memory=20_000_000, progress=False)
    with ssduck.Interpreter(limits=limits) as ss, pytest.raises(LimitError, match="20,000,000"):
        ss.sql(f"SELECT n, 'a text of some length ' || n FROM range({ROWS * 150}) t(n)")


# Statements of many rows, of all types whose columns become Python's values by way of NumPy, and others.
MANY = {
    "numbers": "SELECT n, n / 3, n % 2 = 0 FROM range(5000) t(n)",
    "texts": "SELECT 'ä' || n, n FROM range(5000) t(n)",
    "nulls": (
        "SELECT CASE WHEN n % 3 > 0 THEN n END, CASE WHEN n % 5 > 0 THEN n / 7 END, "
        "CASE WHEN n % 2 > 0 THEN n > 9 END, CASE WHEN n % 7 > 0 THEN n::VARCHAR END "
        "FROM range(5000) t(n)"
    ),
    "NaN": "SELECT CASE WHEN n % 3 > 0 THEN 'inf'::DOUBLE END FROM range(500) t(n)",
    "integers": "SELECT n::INTEGER, NULL::BOOLEAN FROM range(500) t(n)",
    "dates": "SELECT DATE '2026-01-01' + n::INTEGER, n FROM range(500) t(n)",
    "lists": "SELECT [n, n + 1], {'a': n} FROM range(500) t(n)",
    "large": "SELECT n::HUGEINT * 100_000::HUGEINT, n::HUGEINT << 64 FROM range(500) t(n)",
    "odd": (
        "SELECT chr(0) || n, -0.0::DOUBLE, 0.1::DECIMAL(5, 2), NULL::VARCHAR, "
        "CASE WHEN n = 400 THEN true END FROM range(500) t(n)"
    ),
}
BY_COLUMN = ("numbers", "texts", "nulls", "NaN", "integers")


@pytest.mark.parametrize("name", MANY)
@pytest.mark.parametrize("is_limited", [True, False])
def test_rows_are_those_of_duckdb(name, is_limited):
    sizes, sql = [], MANY[name]
    with duckdb.connect() as plain:
        wanted = plain.execute(sql).fetchall()
        result = plain.execute(sql)
        rows = RowLimits(10**6, sizes.append).rows(result) if is_limited else all_rows(result)
    assert repr(rows) == repr(wanted)
    if is_limited:
        letters = sum(len(v) for row in wanted for v in row if isinstance(v, str))
        least = len(wanted) * (ROW + VALUE * len(wanted[0])) + letters
        assert sum(sizes) == least if name in BY_COLUMN else sum(sizes) >= least
    elif name in BY_COLUMN:
        columns = columns_of(rows)
        assert list(zip(*(column.tolist() for column in columns), strict=True)) == wanted
        assert any(column.dtype != object for column in columns)


@pytest.mark.parametrize("fetch", ["rows", "table"])
def test_limits_end_an_answer_without_end(fetch):
    endless = "SELECT n || ' words' FROM range(10_000_000_000) t(n)"

    def charge(size):
        if size > 300_000:
            raise LimitError("too large")

    def found(limits):
        if fetch == "rows":
            return len(limits.rows(plain.execute(endless)))
        return arrow_table(plain.sql(endless), limits).num_rows

    with duckdb.connect() as plain:
        with pytest.raises(LimitError, match="too large"):
            found(RowLimits(10**6, lambda size: charge(10 * size)))
        assert 5_001 <= found(RowLimits(5_001, lambda _: None)) < 20_000
        assert plain.execute("SELECT 1").fetchall() == [(1,)]


@pytest.mark.slow
@pytest.mark.parametrize("limits", [None, ssduck.Limits.strict(progress=False)])
def test_pairs_of_a_world_that_moves_are_those_of_now(limits):
    with ssduck.load("kitchen", limits=limits) as ss:
        columns = "to(a.id, 'a'), to(b.id, 'b'), to(a.z - b.z, 'apart')"
        program, seen = ss.compile(f"SELECT {columns} FROM a=kitchen, b=kitchen;"), []
        for _ in range(8):
            ss.call_variable("kitchen").step(3)
            z = {row["id"]: row["z"] for row in ss.eval("SELECT id, z(this) FROM kitchen;")}
            found = [tuple(row.values()) for row in ss.eval(program)]
            assert len(found) == len(z) ** 2
            assert all(apart == pytest.approx(z[a] - z[b], abs=1e-12) for a, b, apart in found)
            seen.append(z)
    assert seen[0] != seen[-1]
