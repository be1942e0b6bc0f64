"""What SQL has and SelectScript lacks, and probable mistakes."""

import warnings

import pybullet
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
from ssduck.interpreter.lint.linter import MAX_UNKNOWN
from tests.support.cases import sampled
from tests.support.habits import _interpreter
from tests.support.marked import unmarked
from tests.support.warned import silent

# -- what is not there ---------------------------------------------------------------------------


K = "SELECT id FROM kitchen"

# (program, the offending text, what the message names)
REFUSED = [
    (f"{K} a JOIN kitchen b WHERE a.z > b.z;", "WHERE", "expected ON"),
    (f"{K} a NATURAL JOIN kitchen b;", "NATURAL", "FROM room a, room b WHERE"),
    (f"{K} OFFSET 2 ROWS;", "ROWS", "OFFSET n"),
    (f"{K} LIMIT 5 OFFSET 2 OFFSET 3;", "OFFSET", "once"),
    (f"{K} START WITH a=1 CONNECT BY a=2 STOP WITH a=2 OFFSET 1;", ";", "paths"),
    (f"{K} FETCH FIRST 5 ROWS ONLY;", "FETCH", "LIMIT"),
    (f"{K} ORDER BY z NULLS LAST;", "NULLS", "IS NOT NULL"),
    (f"{K} LIMIT 3 WHERE z > 1;", "WHERE", "WHERE, START WITH"),
    (f"{K} GROUP BY type WHERE z > 1;", "WHERE", "order of the clauses"),
    (f"{K} QUALIFY z > 1;", "QUALIFY", "ss.sql"),
    (f"{K} WHERE id(this) LIKE 'c%' ESCAPE '!';", "ESCAPE", "LIKE"),
    (f"{K} WHERE !isRobot(this);", "!", "NOT"),
    (f"{K} WHERE isRobot && isSensor;", "&&", "AND"),
    (f"{K} WHERE isRobot || isSensor;", "||", "OR"),
    ("SELECT `id` FROM kitchen;", "`", "without quotes"),
    ("SELECT z height FROM kitchen;", "height", "AS"),
    ("SELECT ALL id FROM kitchen;", "id", "leave ALL out"),
    ("SELECT SUM(*) FROM kitchen;", "*", "only count"),
    (f"{K} WHERE z IS 5;", "5", "=="),
    (f"{K} WHERE x = y = 0;", "x = y = 0", "x = y AND y = z"),
    (f"{K} WHERE x = 5 = True;", "x = 5 = True", "x = y AND y = z"),
    (f"{K} WHERE x + 1 = y = 0;", "x + 1 = y = 0", "x = y AND y = z"),
    (f"{K} WHERE z BETWEEN 1;", ";", "AND"),
    ("CASE WHEN 1 THEN 2 END;", "END", "ELSE"),
    ("CASE WHEN 1 THEN 2 ELSE 3;", ";", "END"),
    ("CASE 1 THEN 2 END;", "THEN", "WHEN"),
    ("WITH a AS (SELECT 1) SELECT id FROM a;", "a", "name the result of a query"),
    ("INSERT INTO kitchen VALUES (1);", "INTO", "ss.sql"),
    ("DELETE FROM kitchen;", "FROM", "ss.sql"),
    ("CREATE TABLE x (a int);", "TABLE", "ss.sql"),
    (f"{K} AS list WHERE z > 1;", "list", "behind all clauses"),
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
        (f"{K} WHERE z > ANY (SELECT z FROM kitchen AS list);", "x > min(SELECT …)"),
        ("NULL;", "IS NULL"),
        ("SELECT LEN(id) FROM kitchen;", "count(x)"),
        ("SELECT VARIANCE(z) FROM kitchen;", "no function 'VARIANCE'"),
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


# -- what is probably a mistake ------------------------------------------------------------------


DOUBTS = [
    (f"{K} WHERE id(this) == «'tabel'» AS list;", "'table'", []),
    (f"{K} WHERE «'tabel'» == id AS list;", "'table'", []),
    ("SELECT a.id FROM a=kitchen WHERE a.id = «'tabel'» AS list;", "'table'", []),
    ("t = 'tabel'; SELECT id FROM kitchen WHERE id(this) == «t» AS list;", "'table'", []),
    (f"{K} WHERE id(this) IN [«'sinck'», 'can'] AS list;", "'sink'", ["can"]),
    (f"{K} WHERE id IN («'sinck'», 'can') AS list;", "'sink'", ["can"]),
    ("t = ['sinck']; SELECT id FROM kitchen WHERE id IN «t» AS list;", "'sink'", []),
    ("count(SELECT id FROM kitchen WHERE id == «'tabel'» AS list);", "'table'", 0),
    (
        "SELECT k.id FROM k=kitchen WHERE [] != (SELECT o.obj FROM o=kitchen WHERE id(k.this) == «'tabel'» AS list) AS list;",
        "'table'",
        [],
    ),
    ("«id» = 5;", "hides the function id", 5),
    ("«id»{2} = 5;", "hides the function id", 5),
    ("«volume» = 1; SELECT this FROM [2] WHERE volume AS list;", "hides", [2]),
    ("z = 5; SELECT this FROM [2] WHERE «z» > 1 AS list;", "hides the function z", [2]),
    ("z = 5; SELECT this FROM [2] WHERE «z» >= .05-1e-3 AS list;", "hides the function z", [2]),
    ("z = 5; SELECT this FROM [2] WHERE 0.2 - 0.1 + 1 < «z» AS list;", "hides", [2]),
    ("z = 5; SELECT this FROM [2] WHERE NOT «z» <= -(2 * 3) AS list;", "hides", [2]),
    ("n = 9; SELECT this AS n FROM [2] ORDER BY «n» AS list;", "not the column", [2]),
    ("n = 9; SELECT count(*) AS n FROM [2] HAVING «n» > 5 AS list;", "not the column", [1]),
    ("x = 5; SELECT «x» FROM [2] AS list;", "hides the function x", [5]),
    ("x = 5; SELECT this FROM [2] ORDER BY «x» AS list;", "hides the function x", [2]),
    ("«count» = [1]; count(count);", "hides the function count", 1),
    (
        "SELECT this FROM [1] START WITH «mass»=1 CONNECT BY mass=mass+1 STOP WITH mass > 1 AS list;",
        "hides",
        [[1, 1]],
    ),
    ("SELECT «z» FROM z=kitchen WHERE id(this) == 'can' AS list;", "z.this", None),
    ("IF(«foo = 5»; 1; 2);", "==", 1),
    ("IF(False; 1; IF(NOT («foo = 5»); 2));", "==", False),
    (f"name = 'mug'; {K} WHERE «name» = 'can' AS list;", "hides the function name", []),
    ("x = 3; «-x^2»;", "this is (-x)^2; write it so, or -(x^2)", 9),
    (
        "c = [1, 2, 3]; SELECT id FROM kitchen WHERE count(«position + c») = 6 AND id = 'can' AS list;",
        "+ joins two lists",
        ["can"],
    ),
    (
        f"{K} WHERE count(«position(this) + [0, 0, 1]») = 6 AND id = 'can' AS list;",
        "- of two lists is their difference",
        ["can"],
    ),
    (
        "n = 2; SELECT id FROM kitchen WHERE count(«position * n») = 6 AND id = 'can' AS list;",
        "* of a whole number repeats a list; the multiple is [2 * x(a)",
        ["can"],
    ),
    ("count(«-2 * position(kitchen.can)»);", "repeats a list", 0),
    ("count(«2 * ([0, 0, 1] - position(kitchen.can))»);", "repeats a list", 6),
    (
        "«position(kitchen.can) < [100, -100, -100]»;",
        "write x(a) < x(b) AND y(a) < y(b) AND z(a) < z(b)",
        True,
    ),
    (
        "c = [-100, 100, 100]; SELECT id FROM kitchen WHERE «c < position» AND id = 'can' AS list;",
        "by the first numbers that differ",
        ["can"],
    ),
    (
        "SELECT «max(position)» > 9 FROM kitchen WHERE id = 'can' AS list;",
        "over the rows write SELECT max(x(this)) AS x",
        [False],
    ),
    ("«-2^2»;", "this is (-2)^2; write it so, or -(2^2)", 4),
    ("«2^3^2»;", "this is (2^3)^2; write it so, or 2^(3^2)", 64),
    ("x = 2; 1 + «x ^ (1+2) ^ 2» * 3;", "or x ^ ((1+2)^2)", 193),
    ("«2^1^3»^2;", "this is (2^1)^3; write it so, or 2^(1^3)", 64),
    ("x = 3; 2 * «-[x][0] ^ 2»;", "this is (-[x][0])^2; write it so", 18),
    ("x = 3; 2^«-x^2»;", "this is (2^-x)^2; write it so, or 2^-(x^2)", 0.015625),
    (f"{K} WHERE «-z^2» < 0 AS list;", "-(z^2)", []),
    (f"{K} WHERE id IN («3», 'can') AS list;", "id is a text", ["can"]),
    (f"{K} WHERE «type = kinbody» AS list;", "in quotes: 'kinbody'", []),
    (f"{K} WHERE obj = «'can'» AS list;", "obj is an entity", []),
    (f"{K} WHERE this = «'can'» AS list;", "this is an entity", []),
    (f"{K} WHERE this IN («'can'») AS list;", "compare its id: id", []),
    ("SELECT a.id FROM kitchen a, kitchen b WHERE «a.this = b.id»;", "never equal", []),
    ("kitchen.can == «'can'»;", "is an entity, and never equals 'can'", False),
    ("can = kitchen.can; can != «'can'»;", "is an entity, and never equals", True),
    ("id(kitchen.can) == «'Can'»;", "did you mean 'can'", False),
    ("«'Can'» != id(kitchen.can);", "did you mean 'can'", True),
    ("id(kitchen.can) IN ['can', «'Can'»];", "did you mean 'can'", True),
    ("c = kitchen.can; name(c) == «'Can'»;", "did you mean 'can'", False),
    ("n = 'Can'; IF(id(kitchen['can']) == «n»; 1; 0);", "did you mean 'can'", 0),
    ("kind(kitchen.fridge) == «'robto'»;", "did you mean 'robot'", False),
    ("type(kitchen.fridge) == «'robto'»;", "did you mean 'robot'", False),
    ("kind(kitchen.fridge.fridge) == «'lnik'»;", "did you mean 'link'", False),
    ("id(kitchen.fridge.fridge) == «'fridge'»;", "no link of kitchen", False),
    ("f = kitchen.fridge; name(f.fridge) == «'fridg'»;", "did you mean 'fridge'", False),
    (
        "SELECT id FROM links(kitchen) WHERE id(entity(this)) == «'Can'» AS list;",
        "no entity of kitchen",
        [],
    ),
    ("SELECT this FROM [1] WHERE id(kitchen.can) == «'Can'» AS list;", "did you mean 'can'", []),
    ("SELECT id FROM links(kitchen) WHERE entity(this) = «'can'» AS list;", "is an entity", []),
    ("SELECT IF(this = «'can'»; 1; 0) FROM kitchen LIMIT 1 AS value;", "is an entity", 0),
    ("SELECT this FROM [5] WHERE this «//» 2 = 2;", "floor(x / y)", [{"this": 5}]),
    (f"{K} WHERE id = 'can' AND «'cup'» AS list;", "IN (a, b)", ["can"]),
    (f"{K} WHERE id(this) = 'can' AND «7» AS list;", "IN (a, b)", ["can"]),
    (
        "SELECT name FROM people p WHERE «p.age NOT IN (SELECT z FROM kitchen)» AS list;",
        "nothing in some rows",
        ["Ada", "Bob", "Cy"],
    ),
    ("SELECT k.id FROM kitchen k WHERE k.z = «'a'» AS list;", "z is a number", []),
    ("SELECT name FROM people WHERE age = «'36'» AS list;", "age is a number", []),
    ("SELECT p.name FROM people p WHERE p.name = «5» AS list;", "name is a text", []),
    ("SELECT name FROM people WHERE «age <> 36» AS list;", "IS NOT NULL", ["Bob", "Cy"]),
    ("SELECT name FROM people WHERE NOT «age = 36» AS list;", "nothing", ["Bob", "Cy"]),
    ("SELECT name FROM people WHERE «age NOT IN (36)» AS list;", "nothing", ["Bob", "Cy"]),
    (f"SELECT («{K} LIMIT 1») AS v FROM [1];", "AS value", [{"v": [{"id": "fridge_webcam"}]}]),
    ("SELECT «least(z, 0)» FROM kitchen LIMIT 0;", "min([a, b])", []),
    ("SELECT «greatest(z(this), 5)» FROM kitchen LIMIT 0;", "max([a, b])", []),
    ("SELECT this FROM [3, 1, 2] ORDER BY «2» AS list;", "same for all rows", [3, 1, 2]),
    ("SELECT * FROM [3, 1] GROUP BY «1» AS list;", "same for all rows", {"1": [3, 1]}),
    (f"{K} WHERE this IN («SELECT obj FROM kitchen») AS list;", "AS list", []),
    (f"{K} WHERE 'can' <> «\"id\"» LIMIT 0 AS list;", "without quotes: id", []),
    (f"{K} WHERE «\"id\"» IN ('can', 'cup') AS list;", "without quotes: id", []),
    (f"{K} WHERE name = «'tabel'» AS list;", "'table'", []),
    (f"{K} WHERE «'tabel'» = name(this) AS list;", "'table'", []),
    ("SELECT a.id FROM kitchen a WHERE a.name IN («'tabel'», 'can') AS list;", "'table'", ["can"]),
    (f"{K} WHERE kitchen.name = «'tabel'» AS list;", "'table'", []),
    (f"{K} WHERE name <> «'tabel'» LIMIT 0 AS list;", "'table'", []),
    ("SELECT this FROM «'people'» AS list;", "the variable is people", ["people"]),
    (f"{K} WHERE id = «kitchen.can» AS list;", "write this = kitchen.can, or id = 'can'", []),
    (f"{K} WHERE «kitchen.can» = name AS list;", "or name = 'can'", []),
    (f"{K} WHERE id(this) != «kitchen.can» LIMIT 0 AS list;", "id is a text", []),
    (f"{K} WHERE id IN ('table', «kitchen.can») AS list;", "write this = kitchen.can", ["table"]),
    (
        "SELECT a.id FROM kitchen a WHERE a.id = «kitchen.can» AS list;",
        "write a.this = kitchen.can, or a.id = 'can'",
        [],
    ),
    (f"c = kitchen.can; {K} WHERE id = «c» AS list;", "this = c, or id = id(c)", []),
    (f"{K} WHERE z = «kitchen.can» AS list;", "that of the entity is z(kitchen.can)", []),
    ("id(kitchen.table) == «kitchen.can»;", "the entity kitchen.can; its id is 'can'", False),
    (f"{K} WHERE on(kitchen.can, this) = «'yes'» AS list;", "on is True or False", []),
    (f"{K} WHERE NOT on(this, kitchen.can) != «'no'» AS list;", "on is True or False", []),
    ("on(kitchen.table, kitchen.can) == «'true'»;", "on is True or False", False),
    (f"{K} WHERE distance(this, kitchen.can) = «'near'» AS list;", "distance is a number", []),
    (
        f"{K} WHERE on(this, kitchen.can) = «kitchen.can» AS list;",
        "on is True or False, and never equals the entity kitchen.can",
        [],
    ),
    (
        f"{K} WHERE EXISTS (SELECT b.this FROM b=kitchen WHERE on(«this», b.this)) AS list;",
        "this is b.this here, the row of the nested query; name the outer source, FROM a=kitchen, "
        "and write a.this",
        [],
    ),
    (
        "SELECT (SELECT count(*) FROM kitchen a WHERE distance(a.this, «this») > 0 AS value) FROM kitchen LIMIT 1 AS list;",
        "name the outer source, FROM b=kitchen, and write b.this",
        [0],
    ),
    (
        "SELECT k.id FROM kitchen k WHERE 0 < count(SELECT b.this FROM b=kitchen WHERE on(b.this, «this») AS list) AS list;",
        "the row of the outer query is k.this",
        [],
    ),
    (
        "SELECT name FROM people WHERE age = «kitchen.can» OR age = 36 AS list;",
        "age is a number, and never equals the entity kitchen.can\n",
        ["Ada"],
    ),
    (
        "SELECT age FROM people WHERE name = «kitchen.can» AS list;",
        "name is a text, and never equals the entity kitchen.can; its id is 'can'",
        [],
    ),
    ("z(kitchen.can) == «'high'»;", "z is a number", False),
    ("n = 2; «n == 2 == 2»;", "write a == b AND b == c, or (a == b) == c", False),
    (f"{K} WHERE «x == y != z» LIMIT 0 AS list;", "this compares True or False", []),
    ("n = 3; «n != 2 == n»;", "this compares True or False", False),
    (f"{K} WHERE id LIKE «'ca*'» AS list;", "% stands for any letters", []),
    (f"{K} ORDER BY «'z'» LIMIT 0 AS list;", "ORDER BY a text is the same", []),
    (f"{K} GROUP BY «'kind'» LIMIT 0;", "write the column", {}),
    ("«upright(kitchen.can, 45)»;", "45 degrees are 45 * 3.141592653589793 / 180", True),
    (f"{K} WHERE «tilt(this)» > 10 AS list;", "is in radians, from 0 to 3.14", []),
    ("7 «//» 2;", "an integer quotient is floor(x / y)", 7),
    ("n = 7; n «//» floor(n);", "an integer quotient is floor(x / y)", 7),
    ("«[1. -2.  -3e-1]»;", "a list of one number; an array of NumPy", [-1.3]),
]


@pytest.mark.slow
@sampled(("text", "told", "value"), DOUBTS, every=4)
def test_doubts_are_told_once_and_are_errors_in_strict_interpreters(world, text, told, value):
    program, offending = unmarked(text)
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
            with silent():
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
        "SELECT name FROM people WHERE this.name == 'tabel' AS list;",
        "t = 'tabel'; t == 'tabel';",
        "id(kitchen.can) == 'table'; kind(kitchen.can) != 'robot';",
        "id(kitchen.can) IN 'can and cup'; id(kitchen.fridge.fridge) == 'fridge.fridge';",
        "SELECT this FROM [1] START WITH c=kitchen.can CONNECT BY c=kitchen.table "
        "STOP WITH id(c) == 'table' AS list;",
        "found = 5; level = 3; x = 5; x + 1 > 5;",
        "scale = 2; once = 3; scale + once;",
        "(-2)^2; -(2^2); (2^3)^2; 2^(3^2); 2^-1; 2^2 + 3^2;",
        "x = 5; SELECT this FROM [2] WHERE this < x AS list;",
        "upright(kitchen.can, 0.8); 3 > tilt(kitchen.can); id(kitchen.can) LIKE '%*'; n = 9; n > 5;",
        "x = 5; (x == 5) == (5 == 5); x == 5 == True; x != (5 == x); x == 5 AND 6 != x;",
        "x = 5; // one = 2;\n [5 - 3, -2]; [5 - 3]; [5-3]; [x -3]; [-5]",
        "x = 5; SELECT this FROM [2] WHERE x > this - 1 AS list;",
        "(0 < 1) < 2; 1 < 2 == True; 3 IN (1, 2);",
        "n = 0; IF(n = n + 1; n); SELECT this FROM [1] WHERE NOT (n = n - this) AS list;",
        "SELECT x.this FROM x=[1, 2] WHERE x.this > 1 AS list;",
        "SELECT 'id' FROM kitchen LIMIT 1 AS list;",
        "SELECT this FROM [1] START WITH s=1 CONNECT BY s=s+1 STOP WITH s > 1 AS list;",
        "SELECT name FROM people WHERE age <> 36 AND age IS NOT NULL AS list;",
        "SELECT id FROM kitchen WHERE isRobot = 1 AND (0 < z) < 2 AND z IN (0.5, 1) AS list;",
        "SELECT kind, z > 1 AS high, 5 AS n, count(*) AS m FROM kitchen GROUP BY type, high;",
        "SELECT id, z, count(*) AS n FROM kitchen GROUP BY name;",
        "SELECT a.id, a.z, count(*) AS n FROM kitchen a, kitchen b WHERE a.z > b.z GROUP BY a.id;",
        "SELECT this, count(*) AS n FROM [1, 'a'] WHERE this = 'a' GROUP BY this;",
        f"{K} WHERE this = kitchen.can AND on(this, kitchen.can) = 0 AS list;",
        "SELECT a.id FROM a=kitchen WHERE EXISTS (SELECT this FROM b=kitchen "
        "WHERE on(a.this, b.this) AND z(this) > z(b.this));",
        "SELECT id FROM b=kitchen WHERE distance(this, b.this) = 0 LIMIT 1;",
        f"{K} WHERE on(this, kitchen.can) = True OR distance(this, kitchen.can) = 1 AS list;",
        "c = kitchen.can; SELECT obj FROM kitchen WHERE obj = c AND this IN (c, kitchen.table);",
        "c = kitchen.can; SELECT c FROM [1] START WITH c='can' CONNECT BY c=c STOP WITH c == 'can';",
    ],
)
def test_what_is_no_mistake_is_not_told(world, program):
    with _interpreter(world, strict=True) as ss, silent():
        ss.eval(program)


def test_a_hidden_function_is_still_called(ss):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ProgramWarning)
        program = "id = 5; SELECT id, to(id(this), 'name') FROM kitchen WHERE id(this) == 'can';"
        assert ss.eval(program) == [{"id": 5, "name": "can"}]
        assert ss.eval("SELECT this FROM kitchen WHERE id == 5 LIMIT 1 AS list;") != []
    ss.eval("clear('id');")


@pytest.mark.slow
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
            with silent():
                assert set(ss.eval(program)) == {"can"}
        for source in ("kitchen{0}", "kitchen{}", "kitchen{-1}"):
            with pytest.warns(ProgramWarning, match="did you mean 'can'"):
                assert ss.eval(f"SELECT id FROM {source} WHERE id(this) == 'kan' AS list;") == []


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
        for text in (f"t = 'tabel'; {K} WHERE id == t;", f"{K} ORDER BY 7;"):
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
        if planned.plan.purpose != "cautious":
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
@pytest.mark.parametrize(
    ("program", "value"),
    [
        ("least(z(sim.ball), 0.0);", [0.0, 10.0]),
        ("greatest(z(sim.ball), t0)[1];", 10.0),
        ("SELECT id FROM sim WHERE greatest(z(this), 0.0)[1] > 9 AS list;", ["ball"]),
    ],
)
def test_a_second_argument_from_0_up_of_an_extreme_is_told_of_anywhere(client, program, value):
    with ssduck.Interpreter() as ss:
        falling_ball(ss, client)
        with pytest.warns(ProgramWarning, match=r"is an age: .* write (min|max)\(\[a, b\]\)"):
            assert ss.eval(program) == value


def test_an_age_before_now_is_not_told_of(client):
    with ssduck.Interpreter() as ss:
        falling_ball(ss, client)
        with silent():
            assert ss.eval("least(z(sim.ball), -9.0)[0] > 0;") is True
            assert ss.eval("greatest(z(sim.ball), before)[0];") == 0.0


@pytest.mark.parametrize("program", ["greatest(1, 2, 3);", "greatest(0.2, z(sim.ball), 1);"])
def test_the_extreme_of_several_values_is_named(client, program):
    with ssduck.Interpreter() as ss:
        falling_ball(ss, client)
        with pytest.raises(ArgumentError, match=r"of several values, it is max\(\[a, b\]\)"):
            ss.eval(program)
        with pytest.raises(ArgumentError, match=r"of several numbers write min\(\[a, b\]\)"):
            ss.eval("least([1, 2]);")


def falling_ball(ss, client):
    """A world with a ball that has fallen for a tenth of a second, and two ages."""
    pybullet.setGravity(0, 0, -10, physicsClientId=client)
    body = pybullet.createMultiBody(1, basePosition=[0, 0, 10], physicsClientId=client)
    ss.add_variable("sim", ssduck.World.attach(client, names={body: "ball"})).step(24)
    ss.add_variable("t0", 0.0)
    ss.add_variable("before", -9.0)
