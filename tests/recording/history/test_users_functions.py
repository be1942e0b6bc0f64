"""A user's function of an entity, beside rows of the past, is of their ticks, as a relation is."""

import pybullet
import pytest

import ssduck
from tests.support.pasts import _step

# `z` is the relation; in its place comes a user's function that returns the height.
PROGRAMS = [
    "SELECT z(lab.ball_0) FROM lab{0.1} AS list;",
    "SELECT z(lab.ball_0), tick FROM lab{} WHERE id(this) == 'board' AS list;",
    "SELECT tick FROM lab{} WHERE id(this) == 'board' AND z(lab.ball_0) < 0.8 AS list;",
    "SELECT tick FROM lab{} WHERE id(this) == 'board' ORDER BY z(lab.ball_0), tick LIMIT 5 AS list;",
    "count(SELECT this FROM lab{-0.2} WHERE z(lab.ball_0) < 0.8 AS list);",
    "SELECT z(lab.ball_0) - z(a.this) FROM a=lab{0.2}, b=lab WHERE id(a.this) == id(b.this) AS list;",
    "SELECT (SELECT z(lab.ball_0) FROM b=lab{0.1} WHERE id(b.this) == 'board' AS value) "
    "FROM lab{0.2} AS list;",
    "SELECT z(lab.ball_0) FROM lab{0.05} GROUP BY id(this) AS list;",
    "SELECT z(lab.ball_0) FROM lab AS list;",
    "SELECT z(lab{0.3}.ball_0) FROM lab{0.1} AS list;",
    "at(0.1, z(lab.ball_0));",
]


@pytest.fixture(params=[False, True], ids=["sql", "row by row"])
def fallen(request, falling):
    with ssduck.Interpreter(row_by_row=request.param) as ss:
        ss.add_variable("lab", falling.call_variable("lab"))
        ss.add_function("h", lambda entity: entity.position[2])
        ss.add_function("highest", lambda entities: max(e.position[2] for e in entities))
        _step(ss, 100)
        yield ss


@pytest.mark.slow
def test_it_is_of_the_tick_of_the_row(fallen):
    for program in PROGRAMS:
        expected = fallen.eval(program)
        assert fallen.eval(program.replace("z(", "h(")) == expected, program
    [then] = fallen.eval("SELECT z(lab.ball_0) FROM lab{0.1} WHERE id(this) == 'board' AS list;")
    assert then == pytest.approx(1 - 9.81 / 2 * 0.1**2, abs=0.01)


def test_in_a_list_too(fallen):
    ask = "SELECT {} FROM lab{{0.1}} WHERE id(this) == 'board' AS value;"
    expected = fallen.eval(ask.format("z(lab.ball_0)"))
    assert fallen.eval(ask.format("highest([lab.ball_0, lab.ball_1])")) == expected


@pytest.mark.slow
def test_of_an_entity_that_was_not_there_it_is_nothing(fallen):
    lab = fallen.call_variable("lab")
    pybullet.createMultiBody(1, -1, basePosition=[0, 0, 3], physicsClientId=lab.simulator.client)
    _step(fallen, 1)
    [twin] = {entity.name for entity in lab} - {"board", "ball_0", "ball_1"}
    ask = f"SELECT {{}}(lab.{twin}) FROM lab{{{{0.1}}}} WHERE id(this) == 'board' AS list;"
    assert fallen.eval(ask.format("h")) == fallen.eval(ask.format("z")) == [None]
