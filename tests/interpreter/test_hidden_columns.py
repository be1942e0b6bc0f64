"""Numbers that make a condition say nothing: that hide a column, are of another kind or NaN, or degrees."""

import math
from contextlib import suppress

import pybullet
import pytest

import ssduck
from ssduck.errors import ArgumentError
from tests.support.warned import told


@pytest.fixture(scope="module")
def world(stage):
    """A light and a heavy box."""
    for mass, name in ((0.3, "light"), (2, "heavy")):
        stage.box(name, (mass, 0, 1), half=0.1, mass=mass)
    return stage.open()


@pytest.fixture(params=[False, True])
def ss(world, request):
    with ssduck.Interpreter(row_by_row=request.param) as ss:
        ss.add_variable("sim", world)
        yield ss


# (condition, parameters, the words of the messages)
TOLD = [
    ("mass > mass", {"mass": 1}, ["mass hides the function mass"]),
    ("speed <= speed AND z > 0", {"speed": 9}, ["speed hides"]),
    ("name = name", {"name": "light"}, ["name hides"]),
    ("NOT mass > limit", {"mass": 1, "limit": 2}, ["mass hides"]),
    ("mass IN masses", {"mass": 1, "masses": [1]}, ["mass hides"]),
    ("mass > 2 * limit + 1", {"mass": 1, "limit": 2}, ["mass hides"]),
    ("this = target", {"target": "light"}, ["this is an entity, and never equals 'light'"]),
    ("this != target", {"target": "light"}, ["compare its id"]),
    ("this IN names", {"names": ["light", "heavy"]}, ["this is an entity, and never equals"]),
    ("NOT this IN names", {"names": ["light"]}, ["this is an entity, and never equals"]),
    ("mass = label", {"label": "1"}, ["mass is a number, and never equals '1'"]),
    ("id = number", {"number": 1}, ["id is a text, and never equals 1"]),
    ("kind(this) IN numbers", {"numbers": [1, 2]}, ["kind is a text, and never equals"]),
    ("sim.light = target", {"target": "light"}, ["this is an entity, and never equals"]),
    ("mass > most", {"most": math.nan}, ["most is NaN, no number"]),
    ("most <= mass(this)", {"most": math.nan}, ["most is NaN, no number"]),
]
NOT_TOLD = [
    ("mass(this) > mass", {"mass": 1}),
    ("z > mass", {"mass": 1}),
    ("id = name", {"name": "light"}),
    ("name(this) = name", {"name": "light"}),
    ("this = target", {"target": None}),
    ("this IN some", {"some": []}),
    ("this IN some", {"some": ["light", None]}),
    ("id IN names", {"names": ["light"]}),
    ("mass = most", {"most": 2}),
    ("most != most", {"most": math.nan}),
    ("mass > limit", {"limit": 1.0}),
]


@pytest.mark.parametrize(("condition", "parameters", "expected"), TOLD)
def test_a_parameter_that_makes_a_condition_say_nothing_is_told_of(
    ss, condition, parameters, expected
):
    program = f"SELECT id FROM sim WHERE {condition} AS list;"
    messages = told(ss.eval, program, parameters)
    assert len(messages) == len(expected)
    assert all(words in message for words, message in zip(expected, messages, strict=True))
    ss.strict = True
    with pytest.raises(ArgumentError):
        ss.eval(program, parameters)


@pytest.mark.parametrize(("condition", "parameters"), NOT_TOLD)
def test_others_are_not(ss, condition, parameters):
    ss.strict = True
    assert told(ss.eval, f"SELECT id FROM sim WHERE {condition} AS list;", parameters) == []


def test_entities_among_the_values_are_found(ss):
    light = ss["sim"]["light"]
    ss.strict = True
    assert ss.eval("SELECT id FROM sim WHERE this IN some AS list;", {"some": [light]}) == ["light"]
    assert ss.eval("SELECT id FROM sim WHERE this = one AS list;", {"one": light}) == ["light"]


def test_the_columns_of_a_result_are_looked_at(ss):
    assert len(told(ss.eval, "SELECT id, mass > mass AS more FROM sim;", {"mass": 1})) == 1
    assert told(ss.eval, "SELECT id, x + y AS more FROM sim;", {"x": 1, "y": 2}) == []


def test_raw_sql_tells_of_nan(ss):
    question = "SELECT name FROM entities WHERE z < ?"
    (message,) = told(ss.sql, question, [math.nan])
    assert "a parameter is NaN" in message
    assert len(ss.sql(question, [math.nan]).fetchall()) == 2  # DuckDB: NaN is the greatest
    assert told(ss.sql, "SELECT ? AS x", [math.nan]) == []
    assert told(ss.sql, "SELECT name FROM entities WHERE z < $most", {"most": 1.0}) == []


@pytest.mark.parametrize(
    ("program", "told_of"),
    [
        ("'lihgt' IN sim;", "no entity of sim has the name 'lihgt'; did you mean 'light'?"),
        ("NOT 'lihgt' IN sim;", "no entity of sim has the name 'lihgt'"),
        ("target IN sim;", "no entity of sim has the name 'lihgt'"),
        ("'light' IN sim;", ""),
        ("'lihgt' IN names;", ""),
        ("'lihgt' IN 'the lihgt';", ""),
        ("sim.light IN sim;", ""),
    ],
)
def test_a_name_that_a_world_lacks_is_told_of_and_may_come(ss, program, told_of):
    ss.strict = True
    ss.add_variable("target", "lihgt")
    ss.add_variable("names", ["light"])
    messages = told(ss.eval, program)
    assert [message[: len(told_of)] for message in messages] == [told_of] * bool(told_of)


@pytest.mark.parametrize(
    ("program", "value"),
    [
        ("greatest(z(sim.light)) - least(z(sim.light));", "greatest(…)[1]"),
        ("1 + least(z(sim.light));", "least(…)[1]"),
        ("greatest(z(sim.light)) == 2;", "greatest(…)[1]"),
        ("2 != least(z(sim.light));", "least(…)[1]"),
        ("greatest(z(sim.light))[1] - least(z(sim.light))[1];", ""),
        ("greatest(z(sim.light)) == least(z(sim.light));", ""),
    ],
)
def test_arithmetic_of_extremes_is_told_of(ss, program, value):
    messages = told(_value_or_error, ss, program)
    assert [message.splitlines()[0].endswith(value) for message in messages] == [True] * bool(value)


def _value_or_error(ss, program):
    with suppress(ArgumentError):  # a number and a list have no sum
        ss.eval(program)


def test_points_that_are_farther_apart_than_what_is_sampled_are_told_of(ss):
    (message,) = told(ss.eval, "SELECT this FROM sim AS points(20);")
    assert "a mean distance of 20 m is larger than what is sampled" in message
    assert told(ss.eval, "SELECT this FROM sim AS points(0.02);") == []
    assert told(ss.eval, "SELECT this FROM sim WHERE z > 9 AS points(20);") == []


@pytest.fixture(scope="module")
def ramp_world(stage):
    """A ramp that is tilted by 1.2 rad, 69 degrees."""
    turned = pybullet.getQuaternionFromEuler([0, 1.2, 0])
    stage.box("ramp", half=[0.5, 0.3, 0.1], turn=turned)
    return stage.open()


@pytest.fixture(params=[False, True])
def tilted(ramp_world, request):
    with ssduck.Interpreter(row_by_row=request.param) as tilted:
        tilted.add_variable("sim", ramp_world)
        tilted.add_variable("most", 45)
        tilted.add_variable("rows", [{"id": "ramp", "tilt": 69.0}])
        yield tilted


DEGREES = [
    "SELECT id FROM sim WHERE tilt(this) > 45;",
    "SELECT id FROM sim WHERE tilt > 45;",
    "SELECT s.id FROM sim s WHERE s.tilt > 45;",
    "SELECT id FROM sim WHERE tilt BETWEEN 45 AND 90;",
    "SELECT id FROM sim WHERE tilt(this) NOT BETWEEN 45 AND 90;",
    "SELECT id FROM sim{} WHERE 45 <= tilt;",
    "SELECT id, tilt > 45 AS over FROM sim;",
    "SELECT id FROM sim WHERE tilt IN (45, 90);",
    "SELECT id FROM sim WHERE tilt > most;",
    "SELECT kind, max(tilt) AS t FROM sim GROUP BY kind HAVING max(tilt) > 45;",
    "(SELECT max(tilt(this)) FROM sim AS value) > 45;",
    "greatest(tilt(sim.ramp))[1] > 45;",
    "abs(tilt(sim.ramp) - previous(tilt(sim.ramp))) > 45;",
    "acos(0.5) > 45;",
    "atan2(1, 2) == -90;",
    "tilt(sim.ramp) > most;",
    "upright(sim.ramp, 10);",
    "robustness(tilt(sim.ramp) < 45);",
    "robustness(scale(upright(sim.ramp, 10), 0.2) AND z(sim.ramp) > 0) > 0;",
    "robustness(always(tilt(sim.ramp) < 45, 0, 1));",
    "historically(z(sim.ramp) > 0 IMPLIES tilt(sim.ramp) < 45);",
    "heldFor(tilt(sim.ramp) < 45) >= 0.5;",
    "robustness(tilt(sim.ramp) < 0.5) > -30;",
    "least(robustness(once(tilt(sim.ramp) < 0.5)))[1] > -30;",
    "tilt(sim.ramp) - initially(tilt(sim.ramp)) > 30;",
]
DEGREES_IN_SQL = [
    "SELECT name FROM entities e WHERE tilt(e) > 45",
    "SELECT name, 45 <= tilt(e) AS t FROM entities e",
    "SELECT name FROM entities e WHERE tilt(e) BETWEEN 45 AND 90",
    "SELECT max(tilt(e)) > 45 FROM entities e",
    "SELECT name FROM entities e WHERE upright(e, 10)",
    "SELECT name FROM entities e WHERE tilt(e) > ?",
]


@pytest.mark.parametrize("text", [*DEGREES, *DEGREES_IN_SQL])
def test_degrees_are_told_of(tilted, text):
    ask, rest = (
        (tilted.eval, []) if text.endswith(";") else (tilted.sql, [[45]] if "?" in text else [])
    )
    (message,) = told(ask, text, *rest)
    assert "is in radians, from " in message
    tilted.strict = True
    with pytest.raises(ArgumentError, match=r"degrees are -?\d+ \* 3\.14159"):
        ask(text, *rest)


@pytest.mark.parametrize(
    "text",
    [
        "SELECT id FROM sim WHERE tilt > 1.1;",
        "SELECT id FROM rows WHERE tilt > 45;",  # a column of one's own
        "SELECT r.id FROM rows r WHERE r.tilt BETWEEN 45 AND 90;",
        "tilt(sim.ramp) * 180 / 3.141592653589793 > 45;",
        "greatest(tilt(sim.ramp))[0] > 45;",  # a time
        "tilt(sim.ramp) < 3.14159;",
        "robustness(tilt(sim.ramp) < 1.1) < 0.5;",
        "robustness(scale(tilt(sim.ramp) < 1.1, 0.2)) > -45;",
        "robustness(heldFor(tilt(sim.ramp) < 1.1) > 5) > -45;",
        "historically(tilt(sim.ramp) < 1.1, 0, 45);",
        "SELECT name FROM entities e WHERE degrees(tilt(e)) > 45",
        "SELECT name FROM entities e WHERE tilt(e) > 1.1 AND e.z < 45",
    ],
)
def test_radians_are_not(tilted, text):
    tilted.strict = True
    assert told(tilted.eval if text.endswith(";") else tilted.sql, text) == []


def test_what_it_says_to_write_is_right(tilted):
    assert tilted.eval("SELECT id FROM sim WHERE tilt > 45 * 3.141592653589793 / 180 AS list;")
    assert tilted.eval("tilt(sim.ramp);") == pytest.approx(1.2)
    assert math.degrees(1.2) > 45


def test_a_variable_of_that_name_is_no_angle(tilted):
    tilted.add_variable("tilt", 60)
    assert not any(
        "radians" in one for one in told(tilted.eval, "SELECT id FROM sim WHERE tilt > 45;")
    )
