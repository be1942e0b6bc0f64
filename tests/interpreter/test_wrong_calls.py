"""Calls of public functions with wrong arguments: the errors say what to write."""

import re

import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.errors import ArgumentError


@pytest.fixture(scope="module")
def simulation(stage):
    """A ball at the origin, and its client."""
    stage.sphere("cup", radius=0.1, mass=1)
    return stage.client, stage.open()


@pytest.fixture
def ss(simulation):
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", simulation[1])
        yield ss


QUESTION = "SELECT name FROM entities WHERE z < ?"
# (call, what its error says)
CALLS = [
    (lambda ss: ss.sql(QUESTION, 0.5), "parameters are a list: [0.5], or a dict by name"),
    (lambda ss: ss.sql(QUESTION, "cup"), "parameters are a list: ['cup']"),
    (lambda ss: ss.sql("SELECT $t", t=1), "parameters are a dict: sql(statement, {'t': 1})"),
    (lambda ss: ss.eval("z(sim.cup) > t;", t=1), "a dict: eval(program, {'t': 1})"),
    (lambda ss: ss.eval("z(sim.cup) > t;", 1), "eval: parameters are a dict by name"),
    (lambda ss: ss.eval("z(sim.cup) > t;", [1]), "not [1]"),
    (lambda ss: ss.eval("z(sim.cup) > t;", parameters=[1]), "not [1]"),
    (lambda ss: ss.export("x", format="mcap"), "ssduck export RECORD -o PATH --format mcap"),
    (lambda ss: ss.export("x", until=2), "the simulated times are start and end, s"),
    (lambda ss: ss.export("x", wrold="sim"), "did you mean 'world'"),
    (lambda ss: ss.add_trigger("t", "1;", print), "add_trigger: interval is missing"),
    (lambda ss: ss.add_trigger("t", "1;", 0.5), "add_trigger: callback is missing"),
]


@pytest.mark.parametrize(("call", "told"), CALLS)
def test_the_error_says_what_to_write(ss, call, told):
    with pytest.raises(ArgumentError, match=re.escape(told)):
        call(ss)


def test_what_it_says_to_write_is_right(ss):
    assert ss.sql(QUESTION, [0.5]).fetchall() == [("cup",)]
    assert ss.sql(QUESTION, np.array([0.5])).fetchall() == [("cup",)]
    assert ss.sql("SELECT $t", {"t": 1}).fetchall() == [(1,)]
    assert ss.eval("z(sim.cup) > t;", {"t": -1}) is True
    assert ss.eval("z(sim.cup) > t;", parameters={"t": -1}) is True


@pytest.mark.parametrize("name", ["attach", "eval", "batch"])
def test_a_name_of_the_package_that_is_elsewhere_says_where(name):
    with pytest.raises(AttributeError, match=r"World\.|an interpreter"):
        getattr(ssduck, name)
    with pytest.raises(AttributeError, match=r"no attribute 'qwerty'$"):
        _ = ssduck.qwerty


@pytest.mark.parametrize(
    ("condition", "told"),
    [
        ("kind=drop", "a text is in single quotes"),
        ('kind="drop"', "a text is in single quotes"),
        ("height='tall'", "Could not convert string 'tall' to DOUBLE"),
    ],
)
def test_a_condition_on_episodes_says_what_is_wrong(ss, simulation, tmp_path, condition, told):
    with ss.record_to(tmp_path / "run", tags={"kind": "drop", "height": 1.5}):
        pybullet.stepSimulation(simulation[0])
        simulation[1].tick()
    lake = ssduck.lake(tmp_path / "run")
    with pytest.raises(ArgumentError, match=re.escape(told)) as caught:
        lake.select(condition)
    assert "sqlglot" not in str(caught.value)
    assert '"row"' not in str(caught.value)
    assert len(lake.select("kind = 'drop' AND height = 1.5")) == 1
