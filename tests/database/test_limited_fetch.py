"""Rows under limits: their sizes are counted, and the types of kept statements read once."""

from unittest.mock import patch

import duckdb
import pytest

import ssduck
from ssduck.database import limited_fetch
from ssduck.database.limited_fetch import limited_rows, types_of
from ssduck.errors import LimitError

ROWS = 5_000
# The sizes of a row, a value and a text, bytes, as the module has them.
ROW, VALUE, TEXT = 64, 32, 56


def fetched(select, max_rows=None):
    with duckdb.connect() as plain:
        result, sizes = plain.execute(select), []
        rows = limited_rows(result, types_of(result), max_rows, sizes.append)
        return rows, sizes, plain.execute(select).fetchall()


@pytest.mark.parametrize(
    "text", ["'row ' || n", "CASE WHEN n % 3 = 0 THEN 'row ' || n END", "NULL"]
)
def test_all_texts_are_counted(text):
    rows, sizes, wanted = fetched(f"SELECT n, ({text})::VARCHAR FROM range({ROWS}) t(n)")
    assert rows == wanted
    letters = sum(len(value) for _, value in wanted if value is not None)
    assert sum(sizes) == ROWS * (ROW + 2 * VALUE) + letters


def test_values_of_other_types_are_counted():
    rows, sizes, wanted = fetched("SELECT n::VARCHAR::BLOB FROM range(100) t(n)")
    assert rows == wanted
    assert sum(sizes) == 100 * (ROW + VALUE + TEXT) + sum(len(value) for (value,) in wanted)


def test_no_more_rows_are_fetched_than_asked():
    rows, _, wanted = fetched(f"SELECT n || '' FROM range({ROWS}) t(n)", max_rows=7)
    assert rows == wanted[:7]


def test_long_rows_are_fetched_in_small_batches():
    _, sizes, _ = fetched("SELECT repeat('x', 1_000_000) || n FROM range(50) t(n)")
    assert max(sizes) < 15_000_000


PAIRS = "SELECT a.id, b.id, a.z FROM a=kitchen, b=kitchen AS list;"


def test_the_types_of_a_kept_statement_are_read_once():
    limits = ssduck.Limits.strict(progress=False)
    with ssduck.load("kitchen", limits=limits) as ss, ssduck.load("kitchen") as free:
        program, read = ss.compile(PAIRS), []
        for _ in range(5):
            ss.eval(program)
        with patch.object(limited_fetch, "types_of", lambda r: read.append(r) or types_of(r)):
            for _ in range(5):
                found = ss.eval(program)
        assert not read
        assert found == free.eval(PAIRS)


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


def test_texts_beyond_the_memory_are_an_error():
    limits = ssduck.Limits.strict(memory=20_000_000, progress=False)
    with ssduck.Interpreter(limits=limits) as ss, pytest.raises(LimitError, match="20,000,000"):
        ss.sql(f"SELECT n, 'a text of some length ' || n FROM range({ROWS * 150}) t(n)")
