"""Values of DuckDB's that Arrow or Python cannot hold are errors, never other values."""

import datetime as dt

import pytest

import ssduck
from ssduck.errors import EvaluationError, SqlError
from tests.support.cases import sampled
from tests.support.command_line import ssduck_

LARGEST = (1 << 128) - 1
U = f"'{LARGEST}'::UHUGEINT"


@pytest.fixture(params=["normal", "strict"])
def ss(request):
    limits = ssduck.Limits.strict() if request.param == "strict" else None
    with ssduck.Interpreter(limits=limits) as interpreter:
        yield interpreter


@pytest.mark.parametrize(
    "value",
    [
        U,
        f"'{1 << 127}'::UHUGEINT",
        f"[NULL, {U}]",
        f"[1::UHUGEINT, {U}]::UHUGEINT[2]",
        f"{{'a': [{U}]}}",
        f"row({U})",
        f"map{{1: {U}}}",
        f"map{{{U}: 1}}",
        f"union_value(k := {U})",
    ],
)
@pytest.mark.parametrize("rows", [1, 3000])
def test_integers_beyond_arrows(ss, value, rows):
    sql = f"SELECT i, CASE WHEN i = {rows - 1} THEN {value} END AS v FROM range({rows}) t(i)"
    with pytest.raises(SqlError, match=r"'v' has an integer of 2\^127 or more.* VARCHAR or DOUBLE"):
        ss.sql(sql)


def test_integers_that_arrow_holds(ss):
    largest, least = (1 << 127) - 1, -(1 << 127)
    sql = (
        f"SELECT '{largest}'::UHUGEINT, '{largest}'::HUGEINT, '{least}'::HUGEINT, NULL::UHUGEINT, "
        f"({U})::VARCHAR, [7::UHUGEINT]"
    )
    assert ss.sql(sql).fetchall() == [(largest, largest, least, None, str(LARGEST), [7])]


@pytest.mark.parametrize(
    "value",
    [
        "{'a': 1::UHUGEINT, 'b': (-1.5)::DECIMAL(5, 2)}",
        "[{'u': 1::UHUGEINT, 'h': (-1)::HUGEINT}, NULL]",
        "MAP {1::UHUGEINT: -1.5}",
        "MAP {-1.5: 1::UHUGEINT}",
        "(1::UHUGEINT, -1.5, [[-1::HUGEINT]])",
        "[1::UHUGEINT]::UHUGEINT[1]",
    ],
)
def test_negative_numbers_beside_large_ones(ss, value):
    assert ss.sql(f"SELECT {value} AS v").fetchall()
    with pytest.raises(SqlError, match=r"'v' has an integer of 2\^127 or more"):
        ss.sql(f"SELECT {value.replace('1::UHUGEINT', U)} AS v")


def test_times_of_day_with_a_zone():
    """Strict SQL has no such type."""
    ss = ssduck.Interpreter()
    with pytest.raises(SqlError, match=r"'v' has times of day with a zone.*: cast them to VARCHAR"):
        ss.sql("SELECT '12:00:00+15:00'::TIMETZ AS v")
    sql = "SELECT '12:00:00+15:00'::TIMETZ::VARCHAR, 1.5::DECIMAL(4, 2)::VARCHAR"
    assert ss.sql(sql).fetchall() == [("12:00:00+15", "1.50")]


@pytest.mark.parametrize(
    "value",
    [
        "DATE '5000000-01-01'",
        "DATE '0044-03-15 (BC)'",
        "DATE 'infinity'",
        "TIMESTAMP '290000-01-01'",
        "TIMESTAMP '-infinity'",
        "TIMESTAMP_S '290000-01-01'",
        "[DATE '5000000-01-01']",
        "{'a': TIMESTAMP '290000-01-01'}",
        "TIME '24:00:00'",
    ],
)
def test_dates_beyond_pythons(ss, value):
    result = ss.sql(f"SELECT {value} AS v, 1 AS n")
    ss.add_variable("dates", result)
    for door in (
        result.fetchall,
        lambda: result.part(0, 1),
        lambda: str(result),
        lambda: list(result),
        lambda: ss.eval("SELECT v FROM dates;"),
    ):
        with pytest.raises(EvaluationError, match=r"Python cannot hold: cast it to text"):
            door()
    assert result.arrow().num_rows == 1
    text = ss.sql(f"SELECT ({value})::VARCHAR").fetchall()[0][0]
    assert isinstance(text, str)


def test_the_last_dates_of_python(ss):
    sql = "SELECT DATE '9999-12-31', DATE '0001-01-01', TIME '23:59:59.999999', NULL::TIME"
    day = dt.time(23, 59, 59, 999999)
    assert ss.sql(sql).fetchall() == [(dt.date.max, dt.date.min, day, None)]


@pytest.mark.parametrize(
    "value", ["TIME '24:00'", "[TIME '24:00']", "{'t': TIME '24:00'}", "MAP {1: [TIME '24:00']}"]
)
def test_the_end_of_a_day(ss, value):
    result = ss.sql(f"SELECT {value} AS v")
    for door in (result.fetchall, result.df, result.pl):
        with pytest.raises(EvaluationError, match=r"or the time 24:00, which Python cannot hold"):
            door()
    assert ss.sql(f"SELECT {value.replace('24:00', '23:59')} AS v").fetchall()


@pytest.mark.slow
@sampled("ending", ["csv", "json", "md"], every=3)
def test_the_command_line_says_so(ending, tmp_path):
    file = tmp_path / f"x.{ending}"
    for value, text in ((U, "2^127"), ("DATE '5000000-01-01'", "cast it to text")):
        done = ssduck_("query", "kitchen", f"SELECT {value} AS v", "--sql", "-o", file)
        assert done.exit_code != 0
        assert text in done.stderr
        assert not file.exists()
