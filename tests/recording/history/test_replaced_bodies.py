"""Functions of time of a body that replaces another one, and functions of the user of past entities."""

import pybullet
import pytest

import ssduck
from ssduck.errors import ArgumentError, UnknownNameError
from tests.support.pasts import ALL, _step

# Of the new body alone, which is at 1 m; the old one was at 5 m. Nothing is what was not there.
ANSWERS = {
    "z(lab.body_0);": 1.0,
    "previous(z(lab.body_0));": 1.0,
    "rate(z(lab.body_0));": 0.0,
    "initially(z(lab.body_0));": None,
    "greatest(z(lab.body_0))[1];": 1.0,
    "heldFor(z(lab.body_0) > 0.5);": pytest.approx(1 / 240),
    "SELECT z(lab.body_0) FROM lab{0.0} AS list;": [None],
    "SELECT z(lab{0.0}.body_0) FROM lab{0.0} AS list;": [5.0],
}


@pytest.mark.slow
def test_it_is_another_entity(client, tmp_path):
    old = pybullet.createMultiBody(1, basePosition=[0, 0, 5], physicsClientId=client)
    with ssduck.Interpreter(recording=ssduck.Recording(tables=ALL)) as ss:
        lab = ss.add_variable("lab", ssduck.World.attach(client))
        for _ in range(3):
            lab.step()
        pybullet.removeBody(old, physicsClientId=client)
        new = pybullet.createMultiBody(1, basePosition=[0, 0, 1], physicsClientId=client)
        assert new == old
        lab.step()
        assert ss.eval("[rate(z(lab.body_0)), previous(z(lab.body_0))];") == [None, None]
        lab.step()
        ss.export(tmp_path / "run")
        with ssduck.open(tmp_path / "run") as opened:
            for one in (ss, opened):
                assert {program: one.eval(program) for program in ANSWERS} == ANSWERS
                with pytest.raises(ArgumentError, match=r"a number and nothing: .* at\(0\.5, z"):
                    one.eval("lifted(lab.body_0, 0.1);")


@pytest.mark.slow
def test_a_body_that_came_later_is_told_of(client, tmp_path):
    pybullet.createMultiBody(1, basePosition=[0, 0, 5], physicsClientId=client)
    with ssduck.Interpreter(recording=ssduck.Recording()) as ss:
        lab = ss.add_variable("lab", ssduck.World.attach(client))
        lab.step()
        pybullet.createMultiBody(1, basePosition=[0, 0, 1], physicsClientId=client)
        lab.step()
        ss.export(tmp_path / "run")
        with ssduck.open(tmp_path / "run") as opened:
            for one in (ss, opened):
                for past in ("lab{0.0}.body_1", "lab{0.0}['body_1']"):
                    with pytest.raises(UnknownNameError, match="was not there at 0 s") as caught:
                        one.eval(f"z({past});")
                    advice = caught.value.message.partition(": ")[2].partition(" has")[0]
                    assert one.eval(f"{advice}[1][0];") == lab.time
                with pytest.raises(UnknownNameError, match="only body_0"):
                    one.eval("z(lab{0.0}.cup);")
        assert repr(lab).endswith("; World.attach(…, names=…) names body_0>")
        named = ssduck.World.attach(client, names={0: "cup", 1: "box"})
        assert "names=" not in repr(named)


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
