"""Tests points that come from outside: tuples, as PyBullet returns them, and numpy arrays."""

import math
from collections import UserDict

import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.errors import SelectScriptError

PLACE = (0.25, 0.5, 1.0)
GOAL = (0.25, 0.5, 2.5)


@pytest.fixture(scope="module")
def ss(stage):
    ball = stage.sphere("ball", PLACE, radius=0.1, mass=1)
    place, turn = pybullet.getBasePositionAndOrientation(ball, physicsClientId=stage.client)
    with ssduck.Interpreter() as interpreter:
        interpreter.add_variable("sim", stage.open())
        interpreter.add_variable("place", place)
        interpreter.add_variable("pose", (place, turn))
        interpreter.add_variable("user", UserDict(place=place, many=[1, (place,)]))
        interpreter.add_variable("goal", np.array(GOAL))
        interpreter.add_variable("cells", {(0, 1): place})
        interpreter.add_function("toPlace", lambda _: place)
        interpreter.add_function("toGoal", lambda _: np.array(GOAL))
        interpreter.add_function("toCells", lambda: {(0, np.int64(1)): place})
        yield interpreter


@pytest.mark.parametrize(
    "value", ["place", "pose[0]", "user.place", "user.many[1][0]", "toPlace(sim.ball)"]
)
def test_tuples_of_numbers_are_lists(ss, value):
    found = f"SELECT id FROM sim WHERE position(this) == {value} AS list;"
    assert ss.eval(f"position(sim.ball) == {value};") is True
    assert ss.eval(found) == ["ball"]
    assert ss.eval(f"distance(sim.ball, {value});") == 0


def test_parameters_that_are_tuples_are_lists(ss):
    assert ss.eval("position(sim.ball) == here;", {"here": PLACE}) is True
    assert ss.eval("[position(sim.ball)] == here;", {"here": (PLACE,)}) is True
    assert ss.eval("mixed;", {"mixed": ("a", PLACE)}) == ("a", list(PLACE))


def test_keys_that_are_tuples_stay_tuples(ss):
    assert ss.eval("cells;") == {(0, 1): list(PLACE)}
    assert ss.eval("toCells();") == {(0, 1): list(PLACE)}


@pytest.mark.parametrize("goal", ["goal", "toGoal(sim.ball)"])
@pytest.mark.parametrize(
    ("relation", "value"),
    [
        ("distance({ball}, {goal})", 1.5),
        ("inSphere({ball}, {goal}, 1.4)", False),
        ("inBox({ball}, place, {goal})", True),
    ],
)
def test_relations_take_arrays_as_points(ss, goal, relation, value):
    alone = ss.eval(relation.format(ball="sim.ball", goal=goal))
    assert alone == value
    assert type(alone) is type(value)
    row = goal.replace("sim.ball", "this")
    query = f"SELECT {relation.format(ball='this', goal=row)} FROM sim AS list;"
    assert ss.eval(query) == [value]
    assert ("left to Python" in ss.explain(query)) is (goal != "goal")


def test_selected_arrays_stay_arrays(ss):
    (chosen,) = ss.eval("SELECT goal FROM sim WHERE distance(this, goal) > 1 AS list;")
    assert isinstance(chosen, np.ndarray)
    assert chosen.tolist() == list(GOAL)


@pytest.mark.parametrize("value", [np.zeros((2, 3)), np.array(["a"] * 3), np.zeros(2)])
def test_arrays_that_are_no_points_are_refused(ss, value):
    with pytest.raises(SelectScriptError, match="distance"):
        ss.eval("distance(sim.ball, wrong);", {"wrong": value})


def test_arrays_keep_their_arithmetic(ss):
    assert np.array_equal(ss.eval("goal * 2;"), 2 * np.array(GOAL))
    assert math.isclose(ss.eval("norm(goal * 2);"), 2 * math.hypot(*GOAL))
