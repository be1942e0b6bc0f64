"""Programs on the kitchen and their results; what is evaluated, how often and in which order."""

import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.language.parser import parse
from tests.support.bodies import solid


@pytest.fixture(scope="module")
def ss(shared_kitchen):
    with ssduck.Interpreter() as interpreter:
        interpreter.add_variable("kitchen", shared_kitchen)
        interpreter.add_function("double", lambda value: value * 2, "Doubles.")
        interpreter.add_function("tall", lambda e: e.aabb[1][2] - e.aabb[0][2] > 1.0, "Is tall.")
        interpreter.eval("table = SELECT obj FROM kitchen WHERE id(this) == 'table' AS value;")
        yield interpreter


ROBOTS = ["fridge", "cooker", "barrett_4918", "roomba_625x"]

# (program, result)
PROGRAMS = [
    # statements
    ("", None),
    ("1; 2;", 2),
    ("7 % 4;", 3),
    ("-7 % 4;", 1),
    ("2 ^ 10;", 1024),
    ("7 / 2;", 3.5),
    ("'a' + 'b';", "ab"),
    ("[1] + [2];", [1, 2]),
    ("[1, [2, 'x']] == [1, [2, 'x']];", True),
    ("1 == 1.0;", True),
    ("True xor True;", False),
    ("not 0;", True),
    ("[5, 6, [7, 8]][2, 1];", 8),
    ("(q = 3) + q;", 6),
    ("sum([1, 2.5]); ", 3.5),
    ("uniq([1, 2, 1]);", [1, 2]),
    ("avg([1, 2]);", 1.5),
    ("round(2.567, 1);", 2.6),
    ("eval('e1 = 4; e1 * 2;') + e1;", 12),
    ("var('table') == table;", True),
    ("v = 1; clear('v'); v = 2; v;", 2),
    ("getTime();", 0.0),
    ("z(table) < 1e-9;", True),
    ("id(table) + '!';", "table!"),
    ("distance([0, 0, 0], [3, 4, 0]);", 5.0),
    ("distance(table, position(table));", 0.0),
    ("double(21);", 42),
    # one source
    ("SELECT id FROM kitchen WHERE isRobot(this) AS list;", ROBOTS),
    ("SELECT id FROM k=kitchen WHERE isRobot(k.this) AS list;", ROBOTS),
    ("select id from kitchen where isRobot(kitchen.this) as LIST_;", ssduck.SelectScriptError),
    ("SELECT id FROM kitchen WHERE this == table AS list;", ["table"]),
    ("SELECT id FROM kitchen WHERE tall(this) AS list;", ["barrett_4918", "kitchen"]),
    ("SELECT id FROM kitchen WHERE tall(this) AND isRobot(this) AS value;", "barrett_4918"),
    (
        "SELECT id FROM kitchen WHERE tall(this) OR id(this) == 'can' AS list;",
        ["barrett_4918", "kitchen", "can"],
    ),
    ("SELECT id FROM kitchen WHERE z(this) * 2 - 1 == 0.5 AS list;", ["cooker"]),
    ("SELECT id FROM kitchen WHERE x(this) / 2 == 0.99 AND isRobot(this) AS list;", ["cooker"]),
    ("SELECT id FROM kitchen WHERE position(this)[2] == 0.75 AS list;", ["cooker"]),
    ("SELECT id FROM kitchen WHERE position(this) == [1.98, 1.72, 0.75] AS list;", ["cooker"]),
    (
        "SELECT id FROM kitchen WHERE position(this, 0, 2) == [1.98, 1.72] AND isRobot(this) AS list;",
        ["cooker"],
    ),
    ("SELECT position(this, -1, 3) FROM kitchen WHERE id(this) == 'cooker' AS value;", [0.75]),
    ("SELECT position(this, 1, -1) FROM kitchen WHERE id(this) == 'cooker' AS value;", [1.72]),
    (
        "SELECT id FROM kitchen WHERE z(this) % 2 > 1.66 AND z(this) > 1 AS list;",
        ["pin_a091", "pin_c671"],
    ),
    ("SELECT id FROM kitchen WHERE False AS value;", []),
    ("SELECT id FROM kitchen WHERE False;", []),
    ("SELECT double(z(this)) FROM kitchen WHERE id(this) == 'cooker' AS value;", 1.5),
    ("SELECT str(z(this)) + '!' FROM kitchen WHERE id(this) == 'cooker' AS value;", "0.75!"),
    ("SELECT robot(this) == obj(this) FROM kitchen WHERE id(this) == 'cooker' AS value;", True),
    ("r = SELECT robot FROM kitchen WHERE id(this) == 'can' AS value; r;", None),
    ("SELECT id FROM kitchen WHERE isRobot(this) LIMIT 0 AS list;", []),
    ("SELECT id FROM kitchen WHERE tall(this) LIMIT 1 AS list;", ["barrett_4918"]),
    (
        "SELECT id FROM kitchen WHERE 'cup' in id(this) ORDER BY kinbodyHeight(this) AS list;",
        ssduck.SelectScriptError,
    ),
    # variables that SQL sees as parameters
    ("yes = True; SELECT id FROM kitchen WHERE isRobot(this) == yes AS list;", ROBOTS),
    (
        "SELECT id FROM kitchen WHERE z(this) == z(table) AND isKinbody(this) AND id(this) != 'table' AS list;",
        ["kitchen", "chair_6b56", "chair_083c"],
    ),
    # several sources, lists, nested queries
    ("SELECT a.this + b.this FROM a=[1, 2], b=[10, 20] AS list;", [11, 21, 12, 22]),
    ("SELECT this FROM [] AS list;", []),
    ("robots = [table, table]; SELECT id(this) FROM robots AS list;", ["table", "table"]),
    ("SELECT e.this FROM e=kitchen WHERE id(e.this) == 'can' AS dict;", None),
    ("SELECT z * 2 + 1 FROM kitchen WHERE id(this) == 'cooker' AS value;", 2.5),
    ("SELECT str(z) + id FROM kitchen WHERE id(this) == 'cooker' AS value;", "0.75cooker"),
    ("SELECT id FROM kitchen WHERE isRobot(this) ORDER BY -z LIMIT 1 AS list;", ["fridge"]),
    ("SELECT a.this, A.this FROM a=[1], A=[2] AS list;", [1, 2]),
    (
        "SELECT id(parameters.this) FROM parameters=kitchen WHERE parameters.this == table AS list;",
        ["table"],
    ),
    ("SELECT x.this FROM x=[4, 5], y=kitchen WHERE x.this == 5 AND y.this == table AS list;", [5]),
    # numbers are Python's: integers without end, floats that are no decimals
    ("SELECT this * this FROM [50000, 3000000000] AS list;", [2500000000, 9000000000000000000]),
    ("SELECT this + 9223372036854775807 FROM [1] AS list;", [9223372036854775808]),
    ("SELECT -this FROM [-2147483648] AS list;", [2147483648]),
    ("SELECT this FROM [1, 2.5] AS list;", [1, 2.5]),
    ("SELECT this * 0.1 + 0.2 == 0.3 FROM [1] AS list;", [False]),
    ("f = 0.1; SELECT this * f + 0.2 == 0.3 FROM [1] AS list;", [False]),
    ("SELECT type(str(0.1)) FROM [1] AS list;", ssduck.SelectScriptError),
    ("SELECT 99999999999999999999 FROM [1] AS list;", [99999999999999999999]),
    ("SELECT this == 9007199254740993 FROM [9007199254740992.0] AS list;", [False]),
    # constants
    ("SELECT this FROM [3, 1, 2] ORDER BY 1.0 AS list;", [3, 1, 2]),
    ("o = 'a'; SELECT this FROM [3, 1, 2] ORDER BY o, this AS list;", [1, 2, 3]),
    ("k = 0; SELECT this FROM [1] WHERE k != 0 AND this > 1 / k AS list;", []),
    ("k = 0; k != 0 AND 1 / k > 2;", False),
    # what may be nothing
    (
        "SELECT id FROM kitchen WHERE NOT (robot(this) == obj(this)) LIMIT 1 AS list;",
        ["fridge_webcam"],
    ),
    ("SELECT id FROM kitchen WHERE robot(this) == sensor(this) LIMIT 1 AS list;", ["kitchen"]),
    ("SELECT volume(robot(this)) FROM kitchen;", ssduck.SelectScriptError),
    ("SELECT id FROM kitchen WHERE robot(this) AS list;", ROBOTS),
    # worlds as collections
    ("SELECT obj(this) IN kitchen FROM kitchen LIMIT 1 AS list;", [True]),
    ("'can' IN kitchen AND NOT 'cann' IN kitchen;", True),
    ("SELECT 1 FROM kitchen LIMIT 2 AS list;", [1, 1]),
    ("SELECT id(table) FROM kitchen LIMIT 1 AS list;", ["table"]),
]


@pytest.mark.parametrize(("program", "expected"), PROGRAMS)
def test_programs(ss, program, expected):
    if expected is ssduck.SelectScriptError:
        with pytest.raises(ssduck.SelectScriptError):
            ss.eval(program)
        return
    found = ss.eval(program)
    if program.startswith("SELECT e.this"):
        assert found == [{"e": ss.call_variable("kitchen")["can"]}]
    elif expected and all(isinstance(v, float) for v in np.atleast_1d(expected).tolist()):
        assert found == pytest.approx(expected)
    else:
        assert found == expected


def test_cheap_conditions_come_before_python(ss):
    """A function is called only for the rows that SQL leaves."""
    called = []
    ss.add_function("spy", lambda e: called.append(e.name) or True, "Spies.")
    ss.eval("SELECT id FROM kitchen WHERE spy(this) AND isRobot(this) AND z(this) < 0.5;")
    assert called == ["roomba_625x"]


def test_what_depends_on_no_row_is_evaluated_once(ss):
    called = []
    ss.add_function("spied", lambda value: called.append(value) or value, "Spies.")
    program = (
        "SELECT id FROM kitchen WHERE z(this) > spied(1.6) AND tall(this) == spied(False) AS list;"
    )
    assert ss.eval(program) == ["pin_a091", "pin_c671"]
    assert called == [1.6, False]
    called.clear()
    robots = "(SELECT spied(id(this)) FROM kitchen WHERE isRobot(this) LIMIT 1 AS list)"
    assert ss.eval(f"SELECT id FROM kitchen WHERE id(this) IN {robots} AS list;") == ["fridge"]
    assert called == ["fridge"]


@pytest.mark.long
def test_order_holds_in_large_worlds(client):
    """Joins and the row of parameters may not disturb it, whatever plan DuckDB takes."""
    for number in range(3000):
        place = [number % 7, number % 11, number % 13]
        solid(client, pybullet.GEOM_SPHERE, 0, place, radius=0.1)
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", ssduck.World.attach(client))
        ss.add_variable("three", 3.0)
        for condition in (
            "x(this) > three",
            "x(this) == three",
            "x(this) == three AND y(this) < three",
        ):
            found = ss.eval(f"SELECT environmentID FROM sim WHERE {condition} AS list;")
            assert found == sorted(found)
            assert len(found) > 100
        found = ss.eval(
            "SELECT environmentID(a.this), environmentID(b.this) FROM a=sim, b=sim "
            "WHERE x(a.this) == three AND y(a.this) == 4 AND distance(a.this, b.this) < 0.5 AS list;"
        )
        pairs = list(zip(found[::2], found[1::2], strict=True))
        assert pairs == sorted(pairs)
        assert len(pairs) > 100


def test_functions_get_copies(ss):
    ss.add_function("spoil", lambda values: values.append(1), "Appends to what it is given.")
    assert ss.eval("numbers = [3]; spoil(numbers); numbers;") == [3]


@pytest.mark.slow
def test_a_function_cannot_step_the_world_under_a_query():
    with ssduck.load("kitchen") as ss:
        kitchen = ss.call_variable("kitchen")
        ss.add_function("hurry", lambda e: kitchen.step(), "Steps.")
        with pytest.raises(ssduck.SelectScriptError, match="tick cannot be replaced"):
            ss.eval("SELECT hurry(this) FROM kitchen;")
        kitchen.step()
        assert kitchen.time == pytest.approx(1 / 240)


def test_ordering_is_that_of_the_sources(ss):
    """Sensors first, then bodies, each in load order, in every combination."""
    names = [e.name for e in ss.call_variable("kitchen")]
    assert ss.eval("SELECT id FROM kitchen AS list;") == names
    pairs = ss.eval("SELECT id(a.this), id(b.this) FROM a=kitchen, b=kitchen AS list;")
    assert pairs == [name for first in names for second in names for name in (first, second)]


def test_compiled_programs_and_bindings(ss):
    """A compiled program takes the variables as they are when it runs, whatever their type."""
    program = ss.compile("SELECT id FROM kitchen WHERE distance(target, this) < 0.001 AS list;")
    assert program.tree is parse(program.text)
    kitchen = ss.call_variable("kitchen")
    ss.add_variable("target", kitchen["can"])
    assert ss.eval(program) == ["can"]
    ss.add_variable("target", kitchen["sink"])
    assert ss.eval(program) == ["sink"]
    ss.add_variable("target", kitchen["toaster"].position)
    assert ss.eval(program) == ["toaster"]
    ss.add_variable("target", 3)
    with pytest.raises(ssduck.SelectScriptError, match="a must be"):
        ss.eval(program)
    ss.add_variable("target", kitchen["can"])
    assert ss.eval(program) == ["can"]


def test_explain_is_a_statement_too(ss):
    text = ss.eval("EXPLAIN SELECT id FROM kitchen WHERE above(table, this);")
    assert "$table_xmin" in text
    assert "FROM kitchen.entities AS kitchen" in text
    assert (
        ss.eval("EXPLAIN x(kitchen.can) + 1;") == "-- no query, but an expression of single values"
    )


def test_names_cannot_inject_sql(ss):
    nasty = "x'; DROP VIEW kitchen.entities; --"
    ss.add_variable("wanted", nasty)
    assert ss.eval("SELECT id FROM kitchen WHERE id(this) == wanted AS list;") == []
    assert (
        ss.eval(
            'SELECT id FROM kitchen WHERE id(this) == "x\'; DROP VIEW kitchen.entities; --" AS list;'
        )
        == []
    )
    assert len(ss.sql("FROM entities")) == len(ss.call_variable("kitchen"))
