"""`=` in queries, and nested queries that stand for a value: old meanings, and errors."""

import warnings

import pytest

from ssduck.errors import EvaluationError, ProgramWarning, UnknownNameError
from tests.support.habits import _interpreter


@pytest.mark.parametrize(
    ("program", "value"),
    [
        # In a condition it compares, whatever variables there are.
        ("n = 1; SELECT this FROM [7] WHERE (n = 2) AND n > 1 AS list; n;", 1),
        ("n = 1; SELECT this FROM [7] WHERE n = 1 AND this = 7 AS list;", [7]),
        ("n = 1; SELECT this FROM [7] WHERE NOT [n = 2][0] AS list; n;", 1),
        ("n = 1; SELECT this FROM [7] WHERE str(n = 1) = 'True' AS list;", [7]),
        ("n = 1; SELECT this FROM [7] HAVING n = 2 OR (n = 1) AS list;", [7]),
        ("n = 1; SELECT a.this FROM [7] a JOIN [8] b ON n = 1 AND (n = 1) AS list;", [7]),
        ("cube = 1; SELECT this FROM [1, 2] WHERE cube = this AND this > 0 AS list; cube;", 1),
        ("cube = 1; SELECT this FROM [1, 2] WHERE cube = this AND this > 0 AS list;", [1]),
        ("name = 1; SELECT id FROM kitchen WHERE name = 'can' AND z > 0.1 AS list; name;", 1),
        ("z = 1; SELECT id FROM kitchen WHERE (z = 0) AS list;", []),
        (
            "s = 9; SELECT this FROM [1] START WITH s = 1 CONNECT BY s = s + 1 STOP WITH (s = 2) "
            "AND s = 2 AS list;",
            [[1, 1]],
        ),
        # A part of a branch of IF before the last sets it.
        ("n = 1; SELECT this FROM [7] WHERE IF(n = 1; n = 2, n = 2; False) AS list; n;", 2),
        ("n = 1; SELECT this FROM [7] WHERE IF(n = 1; n = 2; False) AS list;", []),
        ("n = 1; SELECT this FROM [7, 8] WHERE IF(n = 5; 1; n = n + this, n = 8) AS list; n;", 16),
        (
            "n = m = 1; SELECT this FROM [7] WHERE IF(True; n = m = 3, True) AS list; [n, m];",
            [3, 3],
        ),
        ("n = 1; SELECT this FROM [7] WHERE IF(True; n = [2, 3], n[0] = 2) AS list; n;", [2, 3]),
        # Elsewhere, a variable that is there is set.
        ("n = 0; SELECT n = n + this FROM [1, 2] AS list;", [1, 3]),
        ("SELECT (x = this) FROM [1, 2] AS list; x;", 2),
        ("SELECT (new = this) + 1 FROM [1, 2] AS list; new;", 2),
        ("SELECT [(new = this)] FROM [1, 2] AS list; new;", 2),
        # One that is not there is a column, or an error.
        ("SELECT (z = 0.75) AS v FROM kitchen WHERE id = 'cooker';", [{"v": True}]),
        ("SELECT z = 0.75 AS v FROM kitchen WHERE id = 'cooker';", [{"v": True}]),
        ("SELECT z = 0.75 FROM kitchen WHERE id = 'cooker' AS list;", [True]),
        ("SELECT IF(type = 'robot'; 1; 2) FROM kitchen WHERE id = 'cooker' AS list;", [1]),
        ("SELECT [(z = 0.75)] FROM kitchen k WHERE k.id = 'cooker' AS list;", [[True]]),
        ("SELECT (age = 36) AS v FROM (SELECT age FROM people LIMIT 1);", UnknownNameError),
        ("SELECT (age = 36) AS v FROM people;", UnknownNameError),
        ("SELECT age = 36 FROM people;", UnknownNameError),
        ("SELECT this FROM [1] WHERE (new = 1);", UnknownNameError),
        ("SELECT this FROM [1] WHERE NOT (1 > 2 OR (new = 1));", UnknownNameError),
        ("SELECT this FROM [1] HAVING (new = 1);", UnknownNameError),
        ("SELECT this FROM [5, 6] WHERE this = 5 AS list;", [5]),
        ("SELECT this FROM [5, 6] WHERE (this = 5) AS list;", [5]),
        ("SELECT this FROM [5, 6] ORDER BY this = 5 AS list;", [6, 5]),
        (
            "SELECT count(*) AS n FROM [5, 6, 7] GROUP BY this = 5 AS list;",
            {"True": [1], "False": [2]},
        ),
        (
            "SELECT this FROM [1, 2] WHERE CASE this WHEN 1 THEN this = 1 ELSE False END AS list;",
            [1],
        ),
    ],
)
def test_an_equals_sign_in_a_query(world, program, value):
    for by_rows in (False, True):
        with _interpreter(world, row_by_row=by_rows) as ss:
            before = set(ss)
            if value is UnknownNameError:
                with pytest.raises(UnknownNameError):
                    ss.eval(program)
                assert set(ss) == before
                continue
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ProgramWarning)
                assert ss.eval(program) == value


@pytest.mark.parametrize(
    ("program", "message"),
    [
        *(
            (f"SELECT id FROM kitchen WHERE z {sign} (SELECT z FROM kitchen);", "has 37 rows")
            for sign in ("=", "<>", "<", ">=", "+ 1 >")
        ),
        ("SELECT id FROM kitchen WHERE id <> (SELECT id FROM kitchen WHERE z > 100);", "no value"),
        (
            "SELECT id FROM kitchen WHERE NOT id = (SELECT id FROM kitchen WHERE z > 100);",
            "no value",
        ),
        ("SELECT name FROM people WHERE age NOT IN (SELECT age FROM people);", "without a value"),
        ("SELECT name FROM people WHERE NOT age IN (SELECT age FROM people);", "without a value"),
        (
            "SELECT a.id FROM kitchen a WHERE a.z = (SELECT b.z FROM kitchen b WHERE b.type = a.type);",
            "rows",
        ),
    ],
)
def test_nested_queries_that_have_no_one_value(ss, program, message):
    with pytest.raises(EvaluationError, match=message) as caught:
        ss.eval(program)
    assert program[caught.value.span.start :].startswith("SELECT")
    assert caught.value.span.start > 0


def test_nested_queries_with_a_form_are_as_they_were(ss):
    first = ss.eval("SELECT z FROM kitchen LIMIT 1 AS value;")
    program = "SELECT count(*) AS n FROM kitchen WHERE z = (SELECT z FROM kitchen AS value);"
    assert ss.eval(program)[0]["n"] >= 1
    assert ss.eval("SELECT this FROM [1] WHERE [] == (SELECT z FROM kitchen WHERE z > 100);")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ProgramWarning)
        program = "SELECT (SELECT z FROM kitchen LIMIT 1) AS v FROM [1];"
        assert ss.eval(program) == [{"v": [{"z": first}]}]
