"""Angles that are compared with degrees are told of, however the angle is written."""

import math

import pybullet
import pytest

import ssduck
from ssduck.errors import ArgumentError
from tests.support.warned import told


@pytest.fixture(scope="module")
def world(stage):
    """A ramp that is tilted by 1.2 rad, 69 degrees."""
    turned = pybullet.getQuaternionFromEuler([0, 1.2, 0])
    stage.box("ramp", half=[0.5, 0.3, 0.1], turn=turned)
    return stage.open()


@pytest.fixture(params=[False, True])
def ss(world, request):
    with ssduck.Interpreter(row_by_row=request.param) as ss:
        ss.add_variable("sim", world)
        ss.add_variable("most", 45)
        ss.add_variable("rows", [{"id": "ramp", "tilt": 69.0}])
        yield ss


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
def test_degrees_are_told_of(ss, text):
    ask, rest = (ss.eval, []) if text.endswith(";") else (ss.sql, [[45]] if "?" in text else [])
    (message,) = told(ask, text, *rest)
    assert "is in radians, from " in message
    ss.strict = True
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
def test_radians_are_not(ss, text):
    ss.strict = True
    assert told(ss.eval if text.endswith(";") else ss.sql, text) == []


def test_what_it_says_to_write_is_right(ss):
    assert ss.eval("SELECT id FROM sim WHERE tilt > 45 * 3.141592653589793 / 180 AS list;")
    assert ss.eval("tilt(sim.ramp);") == pytest.approx(1.2)
    assert math.degrees(1.2) > 45


def test_a_variable_of_that_name_is_no_angle(ss):
    ss.add_variable("tilt", 60)
    assert not any("radians" in one for one in told(ss.eval, "SELECT id FROM sim WHERE tilt > 45;"))
