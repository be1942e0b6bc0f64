"""What users of SQL write: understood, or an error that names what to write instead."""

from __future__ import annotations

import itertools
import math
import warnings
from collections import defaultdict

import pytest

import ssduck
from ssduck.errors import (
    ArgumentError,
    ParseError,
    ProgramWarning,
    SelectScriptError,
    SqlError,
    UnknownNameError,
)
from ssduck.interpreter import query_runner as queries
from ssduck.interpreter.linter import MAX_UNKNOWN
from tests.support.cases import sampled

PEOPLE = [
    {"name": "Ada", "age": 36, "group": "a"},
    {"name": "Bob", "age": None, "group": "b"},
    {"name": "Cy", "age": 24, "group": "a"},
]


@pytest.fixture(scope="module")
def world():
    loaded = ssduck.load("kitchen")
    yield loaded.call_variable("kitchen")
    loaded.close()


def _interpreter(world, **options):
    made = ssduck.Interpreter(recording=None, **options)
    made.add_variable("kitchen", world)
    made.add_variable("people", PEOPLE)
    made.add_variable("ints", [3, 1, 2, 1])
    made.add_function("pairs", lambda value: [value, value])
    return made


@pytest.fixture(scope="module")
def as_sql(world):
    few, queries.FEW_ROWS = queries.FEW_ROWS, 0
    with _interpreter(world) as made:
        yield made
    queries.FEW_ROWS = few


@pytest.fixture(scope="module")
def by_rows(world):
    with _interpreter(world, row_by_row=True) as made:
        yield made


@pytest.fixture(params=["as_sql", "by_rows"])
def ss(request):
    return request.getfixturevalue(request.param)


@pytest.fixture(scope="module")
def entities(world):
    """Name, type and height of each entity, in the order of queries."""
    found = [(e.name, e.kind, float(e.position[2])) for e in world]
    assert len({kind for _, kind, _ in found}) == 3
    return found


def by_kind(entities):
    groups = defaultdict(list)
    for name, kind, z in entities:
        groups[kind].append((name, z))
    return groups


# -- aggregates -------------------------------------------------------------------------------

OF_ROWS = {
    "count(*)": len,
    "COUNT(*)": len,
    "count(1)": len,
    "count(id)": len,
    "count(this)": len,
    "count(position)": len,
    "sum(1)": len,
    "sum(z)": lambda rows: sum(z for _, z in rows),
    "min(z)": lambda rows: min(z for _, z in rows),
    "max(z) - min(z) + 1": lambda rows: max(z for _, z in rows) - min(z for _, z in rows) + 1,
    "avg(z * 2)": lambda rows: sum(z * 2 for _, z in rows) / len(rows),
    "max(id)": lambda rows: max(name for name, _ in rows),
    "count(uniq(z))": lambda rows: len({z for _, z in rows}),
    "count(DISTINCT z)": lambda rows: len({z for _, z in rows}),
    "uniq(type)": lambda _: None,
    "IF(count(*) > 5; 'many'; 'few')": lambda rows: "many" if len(rows) > 5 else "few",
    "max([count(*), 10])": lambda rows: max(len(rows), 10),
    "count(ints)": lambda _: 4,
}


@pytest.mark.parametrize("text", OF_ROWS)
def test_aggregates_of_groups(ss, entities, text):
    """One row a group, whose value is that of the group's rows."""
    found = ss.eval(f"SELECT count(*) AS n, {text} AS v FROM kitchen GROUP BY type;")
    groups = by_kind(entities)
    assert list(found) == list(groups)
    for kind, rows in groups.items():
        wanted = [kind] if text == "uniq(type)" else OF_ROWS[text](rows)
        assert found[kind] == [{"n": len(rows), "v": pytest.approx(wanted)}]


@pytest.mark.parametrize("text", [t for t in OF_ROWS if t != "uniq(type)"])
def test_aggregates_of_all_rows(ss, entities, text):
    rows = [(name, z) for name, _, z in entities]
    found = ss.eval(f"SELECT count(*) AS n, {text} AS v FROM kitchen;")
    assert found == [{"n": len(rows), "v": pytest.approx(OF_ROWS[text](rows))}]


@pytest.mark.parametrize("text", ["count(*)", "count(1)", "count(id)", "sum(1)", "count(uniq(id))"])
@sampled("bound", [3, 4, 5, 8, 24, 25, 26], every=3)
def test_having_by_size(ss, entities, text, bound):
    """Groups of 8, 4 and 25: just inside and just outside."""
    wanted = [kind for kind, rows in by_kind(entities).items() if len(rows) > bound]
    found = ss.eval(f"SELECT id FROM kitchen GROUP BY type HAVING {text} > {bound} AS list;")
    assert list(found) == wanted
    sizes = ss.eval(
        f"SELECT type, {text} AS n FROM kitchen GROUP BY type HAVING n > {bound} ORDER BY n;"
    )
    rows = by_kind(entities)
    assert [group[0]["n"] for group in sizes.values()] == sorted(len(rows[k]) for k in wanted)


@pytest.mark.parametrize("order", ["", " DESC"])
@pytest.mark.parametrize("text", ["count(*)", "count(*) + 1", "-max(z)", "count(*), id"])
def test_order_of_groups(ss, entities, text, order):
    keys = {
        "count(*)": len,
        "count(*) + 1": len,
        "-max(z)": lambda rows: -max(z for _, z in rows),
        "count(*), id": len,
    }
    groups = by_kind(entities)
    wanted = sorted(groups, key=lambda kind: keys[text](groups[kind]), reverse=bool(order))
    if text.endswith("id"):
        text = f"count(*){order}, id"
        order = ""
    found = ss.eval(f"SELECT id FROM kitchen GROUP BY type ORDER BY {text}{order} LIMIT 2 AS list;")
    assert list(found) == wanted[:2]
    for kind, names in found.items():
        rows = [name for name, _ in groups[kind]]
        assert names == (sorted(rows) if text.endswith("id") else rows)


@pytest.mark.parametrize(
    ("having", "there"),
    [
        ("count(*) == 37", True),
        ("count(*) > 37", False),
        ("max(z) > 1 AND min(z) < 1", True),
        ("True", True),
    ],
)
def test_having_without_groups_is_about_all_rows(ss, entities, having, there):
    names = [name for name, _, _ in entities]
    program = f"SELECT id FROM kitchen HAVING {having} AS list;"
    assert ss.eval(program) == (names if there else [])
    assert ss.eval(program.replace("AS list", "LIMIT 2 AS list")) == (names[:2] if there else [])
    counted = ss.eval(f"SELECT count(id) AS n FROM kitchen HAVING {having};")
    assert counted == ([{"n": len(names)}] if there else [])


def test_groups_of_no_rows(ss):
    nothing = "FROM kitchen WHERE z(this) > 100"
    assert ss.eval(
        f"SELECT count(*), sum(z), uniq(z), min(z), max(z), avg(z) {nothing} AS list;"
    ) == [
        *(0, 0, []),
        *(None, None, None),
    ]
    assert ss.eval(f"SELECT type, count(*) {nothing} GROUP BY type;") == {}
    assert ss.eval(f"SELECT id {nothing} HAVING count(*) == 0 AS list;") == []


@pytest.mark.parametrize(
    ("program", "value"),
    [
        ("SELECT count(this) FROM [[1, 2], [3]] AS list;", [2, 1]),
        ("SELECT sum(this) FROM [[1, 2], [3]] WHERE count(this) > 1 AS list;", [3]),
        ("SELECT count(ints), max(ints) FROM [1, 2] AS list;", [4, 3, 4, 3]),
        ("SELECT id FROM kitchen WHERE count(ints) == 4 LIMIT 1 AS value;", "fridge_webcam"),
        ("SELECT this FROM [[2, 1], [3]] ORDER BY count(this) AS list;", [[3], [2, 1]]),
        (
            "SELECT this, count(ints) FROM [1, 2] GROUP BY this % 2 AS list;",
            {"1": [1, 4], "0": [2, 4]},
        ),
        ("SELECT max([this, 2]) FROM [1, 3] GROUP BY 'all' AS list;", {"all": [2, 3]}),
        (
            "SELECT this FROM [1, 2, 3, 4] GROUP BY this % 2 HAVING sum(this) > 4 AS list;",
            {"0": [2, 4]},
        ),
        ("count('abc');", 3),
        (
            "SELECT count(SELECT x.this FROM x=[1, 2, 3] WHERE x.this > y.this AS list) FROM y=[1, 2] AS list;",
            [2, 1],
        ),
    ],
)
def test_aggregates_of_lists_are_as_they_were(ss, program, value):
    assert ss.eval(program) == value


@pytest.mark.parametrize("name", ["count", "sum", "min", "max", "avg", "uniq"])
@pytest.mark.parametrize("argument", ["id", "id(this)", "a.id", "id(a.this)"])
def test_an_aggregate_of_a_text_shows_the_right_spelling(ss, name, argument):
    source = "a=kitchen" if "a." in argument else "kitchen"
    program = f"SELECT {name}({argument}) FROM {source} WHERE z(this) > 1;"
    with pytest.raises(ArgumentError) as caught:
        ss.eval(program)
    spelled = f"{name}(SELECT {argument} FROM {source} WHERE z(this) > 1 AS list)"
    assert f"write {spelled}" in caught.value.message
    assert program[caught.value.span.start : caught.value.span.end] == f"{name}({argument})"
    if name in ("count", "uniq", "min", "max"):
        ss.eval(f"{spelled};")


@pytest.mark.parametrize(
    ("program", "offending", "told"),
    [
        ("SELECT max(z) FROM kitchen;", "max(z)", "max(SELECT z FROM kitchen AS list)"),
        (
            "SELECT id FROM kitchen WHERE count(*) > 3;",
            "count(*)",
            "count(SELECT * FROM kitchen AS list)",
        ),
        ("SELECT id FROM kitchen ORDER BY count(*);", "count(*)", "count(SELECT *"),
        ("SELECT sum(id) FROM kitchen GROUP BY type;", "sum(id)", "does not take a text"),
        ("SELECT sum(age) FROM people GROUP BY group;", "sum(age)", "IS NOT NULL"),
        ("SELECT min(this) FROM [1, 'a'] GROUP BY 'x';", "min(this)", "a number and a text"),
        ("SELECT max(obj) FROM kitchen GROUP BY type;", "max(obj)", "does not take"),
        ("SELECT id FROM kitchen HAVING z > 1;", "z", "WHERE"),
        ("SELECT id FROM kitchen HAVING count(*) > 3 AND id == 'can';", "id", "WHERE"),
        ("SELECT id, count(*) FROM kitchen;", "id", "GROUP BY"),
        ("SELECT this.z FROM kitchen;", "z", "z(this)"),
        ("SELECT k.this.z FROM kitchen k;", "z", "k.z"),
        ("kitchen.can.id;", "id", "functions tell of an entity"),
    ],
)
def test_what_aggregates_and_elements_cannot_mean(ss, program, offending, told):
    with pytest.raises(ArgumentError) as caught:
        ss.eval(program)
    assert program[caught.value.span.start : caught.value.span.end] == offending
    assert told in caught.value.message


def test_aggregates_of_missing_values_and_nan(ss):
    known = "SELECT sum(age) FROM people WHERE this.age IS NOT NULL GROUP BY group AS list;"
    assert ss.eval(known) == {"a": [60]}
    assert ss.eval("SELECT count(age) FROM people GROUP BY group AS list;") == {"a": [2], "b": [1]}
    ss.add_variable("reals", [1.0, math.nan])
    (total,) = ss.eval("SELECT sum(this) FROM reals HAVING count(*) == 2 AS list;")
    assert math.isnan(total)


# -- conditions and values ----------------------------------------------------------------------

CONDITIONS = {
    "z <> 0.75": lambda e: e[2] != 0.75,
    "z(this) = 0.75": lambda e: e[2] == 0.75,
    "(z(this) = 0.75)": lambda e: e[2] == 0.75,
    "isRobot": lambda e: e[1] == "robot",
    "NOT isRobot AND z > 1": lambda e: e[1] != "robot" and e[2] > 1,
    "z BETWEEN 0.75 AND 1.5": lambda e: 0.75 <= e[2] <= 1.5,
    "z + 0 NOT BETWEEN 0.5 + 0.25 AND 1.5 AND isRobot": (
        lambda e: not 0.75 <= e[2] <= 1.5 and e[1] == "robot"
    ),
    "id LIKE 'c%'": lambda e: e[0].startswith("c"),
    "id(this) LIKE 'c_n'": lambda e: e[0] == "can",
    "id LIKE 'c.n' OR id LIKE '%.%'": lambda _: False,
    "id NOT LIKE '%a%'": lambda e: "a" not in e[0],
    "id IN ('can', 'sink')": lambda e: e[0] in ("can", "sink"),
    "id(this) NOT IN ('can', 'sink')": lambda e: e[0] not in ("can", "sink"),
    "id IN ()": lambda _: False,
    "z IN (0.75)": lambda e: e[2] == 0.75,
    "z IS NULL": lambda _: False,
    "z(this) IS NOT NULL AND isRobot(this)": lambda e: e[1] == "robot",
    "NOT z IS NULL": lambda _: True,
    "CASE WHEN isRobot THEN z > 1 WHEN z > 1 THEN False ELSE True END": (
        lambda e: e[2] > 1 if e[1] == "robot" else not e[2] > 1
    ),
    "CASE type(this) WHEN 'robot' THEN 1 WHEN 'sensor' THEN 2 ELSE 3 END == 2": (
        lambda e: e[1] == "sensor"
    ),
}


@pytest.mark.parametrize("text", CONDITIONS)
def test_conditions(ss, entities, text):
    wanted = [entity[0] for entity in entities if CONDITIONS[text](entity)]
    assert ss.eval(f"SELECT id FROM kitchen WHERE {text} AS list;") == wanted
    other = text.replace("(this)", "(k.this)")
    if "this" in text:
        assert ss.eval(f"SELECT k.id FROM k=kitchen WHERE {other} AS list;") == wanted


@pytest.mark.parametrize(
    ("program", "value"),
    [
        ("'it''s';", "it's"),
        ('"say ""hi""";', 'say "hi"'),
        ("'' + '''' + 'a''';", "'a'"),
        ("\"it''s\";", "it''s"),
        ("5--3;", 8),
        ("5 - -3;", 8),
        ("1 -- one\n + 2; -- 'and no text\n", 3),
        ("'-- no comment' + '//';", "-- no comment//"),
        ("1; --", 1),
        ("// a -- b\n 2; # -- c", 2),
        ("/* -- */ 3;", 3),
        ("2 IN (1, 2);", True),
        ("[-1 IN (-1), 1 IN (-1), -1 NOT IN (+1), 1 IN (NOT False)];", [True, False, True, True]),
        ("[1, 2] IN ([1, 2], [3]);", True),
        ("3 IN ((1), (2));", False),
        ("2 IN ([1, 2]);", True),
        ("'ca' IN 'can';", True),
        ("1 <> 2;", True),
        ("'a%b' LIKE 'a%b';", True),
        ("'a\nb' LIKE 'a%b';", True),
        ("'ab' LIKE 'a';", False),
        ("1 IS NULL;", False),
        ("CASE WHEN 1 > 2 THEN 'a' ELSE 'b' END;", "b"),
        ("CASE 1 + 1 WHEN 2 THEN 'two' ELSE 'other' END;", "two"),
        ("case = 3; case + 1;", 4),
        ("distinct = [1]; SELECT distinct FROM [1] AS list;", [[1]]),
        ("SELECT name FROM people WHERE this.age IS NULL AS list;", ["Bob"]),
        (
            "SELECT p.name FROM people p WHERE p.age IS NOT NULL ORDER BY p.age AS list;",
            ["Cy", "Ada"],
        ),
        ("SELECT DISTINCT group FROM people AS list;", ["a", "b"]),
        ("SELECT DISTINCT (group) FROM people AS list;", ["a", "b"]),
        ("SELECT DISTINCT group FROM people ORDER BY group DESC LIMIT 1;", [{"group": "b"}]),
        ("SELECT DISTINCT this FROM [2, 1, 2.0, [1], [1]] AS list;", [2, 1, [1]]),
        ("SELECT DISTINCT this FROM [1, 1, 2] GROUP BY this % 2 AS list;", {"1": [1], "0": [2]}),
        ("count(SELECT DISTINCT type FROM kitchen AS list);", 3),
        ("(SELECT count(*) FROM kitchen AS value) + 1;", 38),
        ("SELECT this + 1 AS next FROM [1, 2];", [{"next": 2}, {"next": 3}]),
        ("SELECT -this AS minus FROM [1, 2] ORDER BY minus AS LIST;", [-2, -1]),
        ("SELECT a.this + b.this FROM [1] AS a, [10, 20] AS b WHERE b.this > 10 AS LIST;", [21]),
        ("SELECT a.this FROM [1, 2] a, [3] b AS List;", [1, 2]),
        ("SELECT id FROM kitchen LIMIT 1 AS Val;", "fridge_webcam"),
        ("SELECT this FROM [1] AS DICTIONARY;", [{"this": 1}]),
        ("[SELECT this FROM [1] AS list, 3];", [[1], 3]),
        ("f = 2; SELECT f.this FROM f=[1] AS list;", [1]),
        ("r = people[0]; SELECT r.name, r.this FROM r=[1] AS list;", ["Ada", 1]),
    ],
)
def test_values(ss, program, value):
    found = ss.eval(program)
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize("keyword", ["select", "Select", "SELECT"])
@pytest.mark.parametrize("form", ["list", "List", "LIST", "val", "VALUE", "Dict", "dictionary"])
def test_forms_in_any_case(ss, keyword, form):
    program = f"{keyword} this From [1, 2] Where this > 1 {{}}"
    assert ss.eval(program.format(f"As {form};")) == ss.eval(program.format(f"AS {form.lower()};"))
    nested = f"count({keyword} this FROM [1, 2] AS {form})" if form.lower() == "list" else "2"
    assert ss.eval(f"{nested};") == 2


def test_forms_of_users_in_any_case(ss, monkeypatch):
    from ssduck.adapters import registry as adapters

    monkeypatch.setattr(adapters, "_ADAPTERS", dict(adapters._ADAPTERS))
    adapters.adapter("many")(lambda selection: len(selection.rows))
    program = "SELECT this FROM [1, 2] AS {};"
    assert ss.eval(program.format("MANY")) == 2
    adapters.adapter("Many")(lambda selection: -len(selection.rows))
    assert [ss.eval(program.format(name)) for name in ("many", "Many")] == [2, -2]
    with pytest.raises(ArgumentError, match="AS Many or many"):
        ss.eval(program.format("MANY"))
    with pytest.raises(ArgumentError, match="own forms"):
        adapters.adapter("LIST")


# -- what is not there --------------------------------------------------------------------------

K = "SELECT id FROM kitchen"
# (program, the offending text, what the message names)
REFUSED = [
    (f"{K} a JOIN kitchen b ON a.z > b.z;", "JOIN", "commas"),
    (f"{K} LEFT JOIN kitchen ON z;", "LEFT", "WHERE"),
    (f"{K} INNER JOIN kitchen USING (id);", "INNER", "WHERE"),
    (f"{K} CROSS JOIN kitchen;", "CROSS", "commas"),
    (f"{K} UNION {K};", "UNION", "AS list) +"),
    (f"{K} EXCEPT {K};", "EXCEPT", "AS list"),
    (f"{K} LIMIT 5 OFFSET 2;", "OFFSET", "LIMIT"),
    (f"{K} FETCH FIRST 5 ROWS ONLY;", "FETCH", "LIMIT"),
    ("SELECT TOP 5 id FROM kitchen;", "5", "LIMIT"),
    (f"{K} ORDER BY z NULLS LAST;", "NULLS", "IS NOT NULL"),
    (f"{K} LIMIT 3 WHERE z > 1;", "WHERE", "WHERE, START WITH"),
    (f"{K} GROUP BY type WHERE z > 1;", "WHERE", "order of the clauses"),
    (f"{K} QUALIFY z > 1;", "QUALIFY", "ss.sql"),
    (f"{K} WHERE id(this) ILIKE 'c%';", "ILIKE", "LIKE"),
    (f"{K} WHERE id(this) LIKE 'c%' ESCAPE '!';", "ESCAPE", "LIKE"),
    (f"{K} WHERE !isRobot(this);", "!", "NOT"),
    (f"{K} WHERE isRobot && isSensor;", "&&", "AND"),
    (f"{K} WHERE isRobot || isSensor;", "||", "OR"),
    ("SELECT id(this) || 'x' FROM kitchen;", "||", "+"),
    ("SELECT z(this)::int FROM kitchen;", "::", "int(x)"),
    ("SELECT `id` FROM kitchen;", "`", "without quotes"),
    ("SELECT CAST(z AS int) FROM kitchen;", "AS", "int(x)"),
    ("SELECT z height FROM kitchen;", "height", "AS"),
    ("SELECT ALL id FROM kitchen;", "id", "leave ALL out"),
    ("SELECT SUM(*) FROM kitchen;", "*", "only count"),
    (f"{K} WHERE z > 1 AND id = 'can';", "=", "'=='"),
    (f"{K} WHERE (z > 1 OR id = 'can');", "=", "'=='"),
    (f"{K} WHERE z IS 5;", "5", "=="),
    (f"{K} WHERE isRobot IS TRUE;", "TRUE", "NULL"),
    (f"{K} WHERE z BETWEEN 1;", ";", "AND"),
    ("CASE WHEN 1 THEN 2 END;", "END", "ELSE"),
    ("CASE WHEN 1 THEN 2 ELSE 3;", ";", "END"),
    ("CASE 1 THEN 2 END;", "THEN", "WHEN"),
    ("WITH a AS (SELECT 1) SELECT id FROM a;", "a", "name the result of a query"),
    ("INSERT INTO kitchen VALUES (1);", "INTO", "ss.sql"),
    ("UPDATE kitchen SET z = 1;", "kitchen", "ss.sql"),
    ("DELETE FROM kitchen;", "FROM", "ss.sql"),
    ("CREATE TABLE x (a int);", "TABLE", "ss.sql"),
    (f"{K} AS list WHERE z > 1;", "list", "behind all clauses"),
    ("SELECT row_number() OVER (ORDER BY z) FROM kitchen;", "OVER", "ss.sql"),
    ("this = 3;", "this", "this are words"),
    ("True = 5;", "True", "words of the language"),
    ("fALSE = 5;", "fALSE", "words of the language"),
    ("select = 5;", "=", "expression"),
    ("not = 5;", "not", "variable's name"),
    ("in = 5;", "in", "variable's name"),
    ("a.this = 3;", "=", "'=='"),
    ("SELECT this FROM this=[1];", "this", "source's name"),
    ("SELECT this FROM true=[1];", "true", "source's name"),
    ("SELECT this FROM [1] this;", "this", "words of the language"),
    ("SELECT this FROM [1] START WITH this=1 CONNECT BY a=1 STOP WITH True;", "this", "words"),
    ("SELECT DISTINCT this FROM [1] CONNECT BY a=1 STOP WITH 1;", "CONNECT", "UNIQUE"),
    ("SELECT this FROM [1] CONNECT BY false=1 STOP WITH True;", "false", "words"),
    ("'it''s;", "'it''s;", "never closed"),
]


@pytest.mark.parametrize(("program", "offending", "told"), REFUSED)
def test_what_is_not_there_is_named_with_what_to_write(as_sql, program, offending, told):
    with pytest.raises(ParseError) as caught:
        as_sql.eval(program)
    error = caught.value
    assert program[error.span.start : error.span.end] == offending
    assert told in error.message


@pytest.mark.parametrize(
    ("program", "told"),
    [
        (f"{K} WHERE EXISTS (SELECT id FROM kitchen);", "[] !="),
        (f"{K} WHERE z > ANY (SELECT z FROM kitchen AS list);", "AS list"),
        ("SELECT NULL FROM kitchen;", "IS NULL"),
        (f"{K} WHERE z(this) == NULL;", "IS NULL"),
        ("NULL;", "IS NULL"),
        ("SELECT COALESCE(z, 0) FROM kitchen;", "IF("),
        ("SELECT LEN(id) FROM kitchen;", "count(list)"),
        ("SELECT SUM(z) FROM kitchen;", "no function 'SUM'"),
        ("SELECT DISTINCT(type) FROM kitchen;", "without brackets"),
        (f"{K} LIMIT ALL;", "leave ALL out"),
        (f"{K} AS k;", "no result form 'k'"),
    ],
)
def test_names_of_sql_are_told(ss, program, told):
    with pytest.raises(UnknownNameError) as caught:
        ss.eval(program)
    assert told in caught.value.message
    assert caught.value.line == 1


@pytest.mark.parametrize("name", ["True", "false", "THIS", "select", "in", "1a", "a b"])
def test_python_names_variables_as_programs_do(as_sql, name):
    with pytest.raises(ArgumentError, match="cannot be a variable's name"):
        as_sql.add_variable(name, 1)


# -- what is probably a mistake -----------------------------------------------------------------

DOUBTS = [
    (f"{K} WHERE id(this) == 'tabel' AS list;", "'tabel'", "'table'", []),
    (f"{K} WHERE 'tabel' == id AS list;", "'tabel'", "'table'", []),
    ("SELECT a.id FROM a=kitchen WHERE a.id = 'tabel' AS list;", "'tabel'", "'table'", []),
    ("t = 'tabel'; SELECT id FROM kitchen WHERE id(this) == t AS list;", "t", "'table'", []),
    (f"{K} WHERE id(this) IN ['sinck', 'can'] AS list;", "'sinck'", "'sink'", ["can"]),
    (f"{K} WHERE id IN ('sinck', 'can') AS list;", "'sinck'", "'sink'", ["can"]),
    ("t = ['sinck']; SELECT id FROM kitchen WHERE id IN t AS list;", "t", "'sink'", []),
    ("count(SELECT id FROM kitchen WHERE id == 'tabel' AS list);", "'tabel'", "'table'", 0),
    (
        "SELECT k.id FROM k=kitchen WHERE [] != (SELECT o.obj FROM o=kitchen WHERE id(k.this) == 'tabel' AS list) AS list;",
        "'tabel'",
        "'table'",
        [],
    ),
    ("id = 5;", "id", "hides the function id", 5),
    ("id{2} = 5;", "id", "hides the function id", 5),
    ("volume = 1; SELECT this FROM [2] WHERE volume AS list;", "volume", "hides", [2]),
    ("z = 5; SELECT this FROM [2] WHERE z > 1 AS list;", "z", "hides the function z", [2]),
    ("n = 9; SELECT this AS n FROM [2] ORDER BY n AS list;", "n", "not the column", [2]),
    ("n = 9; SELECT count(*) AS n FROM [2] HAVING n > 5 AS list;", "n", "not the column", [1]),
    ("x = 5; SELECT x FROM [2] AS list;", "x", "hides the function x", [5]),
    ("x = 5; SELECT this FROM [2] ORDER BY x AS list;", "x", "hides the function x", [2]),
    ("count = [1]; count(count);", "count", "hides the function count", 1),
    (
        "SELECT this FROM [1] START WITH mass=1 CONNECT BY mass=mass+1 STOP WITH mass > 1 AS list;",
        "mass",
        "hides",
        [[1, 1]],
    ),
    ("SELECT z FROM z=kitchen WHERE id(this) == 'can' AS list;", "z", "z.this", None),
    (f"{K} WHERE (foo = 'can') LIMIT 0 AS list;", "foo = 'can'", "==", []),
    (f"{K} WHERE NOT (foo = 'can') AS list;", "foo = 'can'", "==", []),
    (f"{K} WHERE isRobot(this) XOR (foo = -5) LIMIT 0 AS list;", "foo = -5", "==", []),
    (f"{K} WHERE False AND NOT (False XOR (foo = [1])) AS list;", "foo = [1]", "==", []),
    ("SELECT this FROM [1] HAVING NOT (foo = 5) AS list;", "foo = 5", "==", []),
    ("IF(foo = 5; 1; 2);", "foo = 5", "==", 1),
    ("IF(False; 1; IF(NOT (foo = 5); 2));", "foo = 5", "==", False),
    (
        "SELECT this FROM [1] START WITH s=1 CONNECT BY s=s+1 STOP WITH (s = 2) AS list;",
        "s = 2",
        "==",
        [[1]],
    ),
    (f"{K} WHERE 0 < z(this) < 1 LIMIT 0 AS list;", "0 < z(this) < 1", "BETWEEN", []),
    (f"{K} WHERE 0 <= z(this) < 1 LIMIT 0 AS list;", "0 <= z(this) < 1", "BETWEEN", []),
    ("SELECT this FROM [3, 1, 2] ORDER BY 1 AS list;", "1", "same for all rows", [3, 1, 2]),
    ("SELECT this FROM [3, 1] GROUP BY 1 AS list;", "1", "same for all rows", {"1": [3, 1]}),
    ("'ca' IN ('can');", "'can'", "[ ]", True),
    (
        f"{K} WHERE id(this) IN (SELECT id FROM kitchen) AS list;",
        "SELECT id FROM kitchen",
        "AS list",
        [],
    ),
    ('SELECT "id" FROM kitchen LIMIT 1 AS list;', '"id"', "without quotes", ["id"]),
    ("SELECT this FROM 'people' AS list;", "'people'", "the variable is people", ["people"]),
]


@sampled(("program", "offending", "told", "value"), DOUBTS, every=4)
def test_doubts_are_told_once_and_are_errors_in_strict_interpreters(
    world, program, offending, told, value
):
    for by_rows in (False, True):
        with _interpreter(world, row_by_row=by_rows) as ss:
            with pytest.warns(ProgramWarning) as caught:
                found = ss.eval(program)
            assert value is None or found == value
            assert len(caught) == 1
            message = str(caught[0].message)
            assert told in message
            line, mark = message.splitlines()[-2:]
            assert line[mark.index("^") :].startswith(offending.split("\n")[0])
            assert mark.count("^") == len(offending)
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                ss.eval(program)
            ss.strict = True
            with pytest.raises(SelectScriptError) as refused:
                ss.eval(program)
            assert program[refused.value.span.start : refused.value.span.end] == offending


def test_of_many_names_that_nothing_bears_some_are_told(world):
    with _interpreter(world, row_by_row=False) as ss:
        ss.add_variable("names", ["can", *(f"no {number}" for number in range(1000))])
        with pytest.warns(ProgramWarning) as caught:
            assert ss.eval(f"{K} WHERE id IN names AS list;") == ["can"]
    assert len(caught) == MAX_UNKNOWN


@pytest.mark.parametrize(
    "program",
    [
        f"{K} WHERE id(this) == 'table' AS list;",
        f"{K} WHERE 'cam' IN id(this) AND id(this) LIKE 'nothing' AS list;",
        f"{K} WHERE id(this) IN 'table and chair' AS list;",
        f"{K} WHERE type(this) == 'tabel' AS list;",
        "SELECT name FROM people WHERE this.name == 'tabel' AS list;",
        "t = 'tabel'; t == 'tabel';",
        "found = 5; level = 3; x = 5; x + 1 > 5;",
        "x = 5; SELECT this FROM [2] WHERE this < x AS list;",
        "(0 < 1) < 2; 1 < 2 == True; 3 IN (1, 2);",
        "n = 0; IF(n = n + 1; n); SELECT this FROM [1] WHERE NOT (n = n - this) AS list;",
        "SELECT x.this FROM x=[1, 2] WHERE x.this > 1 AS list;",
        "SELECT 'id' FROM kitchen LIMIT 1 AS list;",
        "SELECT this FROM [1] START WITH s=1 CONNECT BY s=s+1 STOP WITH s > 1 AS list;",
    ],
)
def test_what_is_no_mistake_is_not_told(world, program):
    with _interpreter(world, strict=True) as ss, warnings.catch_warnings():
        warnings.simplefilter("error")
        ss.eval(program)


def test_a_hidden_function_is_still_called(ss):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ProgramWarning)
        program = "id = 5; SELECT id, to(id(this), 'name') FROM kitchen WHERE id(this) == 'can';"
        assert ss.eval(program) == [{"id": 5, "name": "can"}]
        assert ss.eval("SELECT this FROM kitchen WHERE id == 5 LIMIT 1 AS list;") != []
    ss.eval("clear('id');")


def test_names_of_bodies_that_were_there_are_known():
    """At past ticks, and of bodies that were removed since, and in worlds of any name."""
    with ssduck.load("kitchen") as ss:
        world = ss.call_variable("kitchen")
        world.step(2)
        world.remove("can")
        for program in (
            f"{K}{{0}} WHERE id(this) == 'can' AS list;",
            f"{K}{{}} WHERE id == 'can' AS list;",
        ):
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                assert set(ss.eval(program)) == {"can"}
        for source in ("kitchen{0}", "kitchen{}", "kitchen{-1}"):
            with pytest.warns(ProgramWarning, match="did you mean 'can'"):
                assert ss.eval(f"SELECT id FROM {source} WHERE id(this) == 'kan' AS list;") == []


def test_all_doors_tell(world, tmp_path):
    """What-if worlds, records, texts of eval, compiled programs."""
    program = "SELECT id FROM kitchen WHERE id(this) == 'tabel' AS list;"
    with ssduck.load("kitchen") as ss:
        ss.export(tmp_path / "run")
        compiled = ss.compile(program)
        with pytest.warns(ProgramWarning, match="'table'"):
            ss.eval(compiled)
        with pytest.warns(ProgramWarning, match="'table'"):
            ss.eval("eval('SELECT id FROM kitchen WHERE id == \\'tabel\\'');")
    with ssduck.open(tmp_path / "run") as ss, pytest.warns(ProgramWarning, match="'table'"):
        assert ss.eval(program) == []


LOOKS = {
    "eval": lambda ss, text: ss.eval(text),
    "compiled": lambda ss, text: ss.eval(ss.compile(text)),
    "show": lambda ss, text: ss.show(text),
    "explain": lambda ss, text: ss.explain(text),
    "EXPLAIN": lambda ss, text: ss.eval(f"EXPLAIN {text}"),
    "sql": lambda ss, text: ss.compile(text).sql(),
    "a text": lambda ss, text: ss.eval("eval('" + text.replace("'", "\\'") + "');"),
}


@pytest.mark.parametrize("door", LOOKS)
def test_warnings_are_of_the_users_line(world, door):
    with _interpreter(world, row_by_row=False) as ss:
        for text in (f"t = 'tabel'; {K} WHERE id == t;", f"{K} WHERE id IN ('can');"):
            with pytest.warns(ProgramWarning) as caught:
                LOOKS[door](ss, text)
            assert [warning.filename for warning in caught] == [__file__]
            ss.strict = True
            with pytest.raises(SelectScriptError):
                LOOKS[door](ss, text)
            ss.strict = False
        with pytest.warns(UserWarning, match="replaces") as caught:
            ss.add_function("count", lambda _: 3)
        assert [warning.filename for warning in caught] == [__file__]


def test_a_warning_of_refused_sql_is_of_the_users_line(world, monkeypatch):
    fetched = queries.PlannedQuery._fetch

    def refused(planned, *args):
        if not planned.plan.cautious:
            raise SqlError("no such thing", is_refused=True)
        return fetched(planned, *args)

    text = "SELECT id FROM kitchen WHERE 10 / (1 + mass(this)) > 5 AS list;"
    with _interpreter(world, row_by_row=False) as ss:
        expected = ss.eval(text)
    monkeypatch.setattr(queries.PlannedQuery, "_fetch", refused)
    with _interpreter(world, row_by_row=False) as ss:
        with pytest.warns(UserWarning, match="DuckDB refused a query's SQL: no such") as caught:
            assert ss.eval(text) == expected
        assert [warning.filename for warning in caught] == [__file__]


@pytest.mark.slow
def test_combinations_agree(as_sql, by_rows):
    """Clauses with each other, in both evaluators."""
    items = ("type, count(*) AS n", "id", "DISTINCT type", "max(z) - min(z) AS d, count(id) AS n")
    wheres = ("", "WHERE isRobot OR z > 1", "WHERE z > 100", "WHERE id LIKE 'c%'")
    groups = (
        "",
        "GROUP BY type",
        "GROUP BY z > 0.5, type HAVING count(*) > 2",
        "HAVING count(*) > 9",
    )
    orders = ("", "ORDER BY count(*) DESC", "ORDER BY type, id DESC LIMIT 3")
    for parts in itertools.product(items, wheres, groups, orders):
        item, *clauses = parts
        program = f"SELECT {item} FROM kitchen {' '.join(clauses)};"
        found = []
        for ss in (as_sql, by_rows):
            try:
                found.append(repr(ss.eval(program)))
            except SelectScriptError as error:
                found.append(type(error).__name__)
        assert found[0] == found[1], program
