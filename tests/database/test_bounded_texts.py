"""Strict SQL looks for regular expressions in short texts only: DuckDB does not interrupt it."""

from __future__ import annotations

import time

import pytest

import ssduck
from ssduck.database.strict.bounded_texts import MAX_TEXT
from ssduck.errors import LimitError

# Calls, of a text and an expression.
LOOKING = (
    "regexp_matches({}, 'a+')",
    "regexp_matches({}, 'A+', 'i')",
    "regexp_full_match({}, 'a+')",
    "regexp_full_match({}, 'A+', 'i')",
    "regexp_extract({}, 'a+')",
    "regexp_extract({}, '(a)a+', 1)",
    "regexp_extract({}, '(A)A+', 1, 'i')",
    "regexp_extract({}, '(a)(a)', ['x', 'y'])",
    "{} ~ 'a+'",
    "{} !~ 'a+'",
    "{} ~* 'A+'",
    "{} !~* 'A+'",
    "{} SIMILAR TO 'a+'",
    "{} NOT SIMILAR TO 'a+'",
)


@pytest.fixture(scope="module")
def strict():
    with ssduck.load("kitchen", limits=ssduck.Limits.strict(seconds=2)) as ss:
        yield ss


@pytest.fixture(scope="module")
def free(shared_kitchen):
    with ssduck.Interpreter() as ss:
        ss.add_variable("kitchen", shared_kitchen)
        yield ss


@pytest.mark.parametrize("call", LOOKING)
def test_texts_up_to_the_bound_are_looked_through(strict, free, call):
    sql = f"SELECT {call.format('x')} FROM (SELECT string_agg(v, '') AS x FROM range({{}}) t(i), (SELECT 'a' AS v))"
    for size in (1, MAX_TEXT):
        assert strict.sql(sql.format(size)).fetchall() == free.sql(sql.format(size)).fetchall()
    with pytest.raises(
        LimitError, match=r"^regular expressions are looked for in texts of at most"
    ):
        strict.sql(sql.format(MAX_TEXT + 1))
    assert free.sql(sql.format(MAX_TEXT + 1)).fetchall()


@pytest.mark.parametrize("call", LOOKING)
def test_names_are_looked_through_as_without_limits(strict, free, call):
    sql = f"SELECT {call.format('name')}, {call.format('kind')} FROM entities ORDER BY id"
    assert strict.sql(sql).fetchall() == free.sql(sql).fetchall()
    assert strict.sql(f"SELECT {call.format('NULL')}").fetchall() == [(None,)]


def test_what_would_take_hours_ends_at_once(strict):
    started = time.process_time()
    with pytest.raises(LimitError, match="at most 1,000 bytes"):
        strict.sql(
            "SELECT count(*) FROM (SELECT string_agg(v, '') AS x FROM range(1_000_000), "
            "(SELECT 'a' AS v)), range(2_048) r(i) WHERE x ~ '.*a.{190}Q'"
        )
    assert time.process_time() - started < 5


def test_texts_within_others_count(strict):
    call = "name"
    for _ in range(17):
        call = f"regexp_extract({call}, 'a')"
    with pytest.raises(LimitError, match="too large"):
        strict.sql(f"SELECT {call} FROM entities")
