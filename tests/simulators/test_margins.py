"""Collision margins that change in a simulation: `changeDynamics`, seen at the next tick."""

import warnings

import pybullet
import pytest

import ssduck
from tests.support.bodies import solid
from tests.support.cases import sampled

pytestmark = pytest.mark.slow

CUBE = [[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1)]
WIDE = 0.01
# What the margins of both decide, of what is 2 cm apart.
RELATIONS = ("on", "touching", "supports", "restsOn")


def hull(client, mass, height):
    return solid(client, pybullet.GEOM_MESH, mass, [0, 0, height], vertices=CUBE)


@pytest.fixture
def sim(client):
    """A hull at rest on a hull, attached."""
    pybullet.setGravity(0, 0, -9.81, physicsClientId=client)
    names = {hull(client, 0, 0.1): "low", hull(client, 1, 0.3021): "high"}
    return ssduck.World.attach(client, names=names).step(60)


def widen(client, sim, apart=0.02):
    """Give both another margin, and put one so far above the other as they come to rest."""
    for body in (0, 1):
        pybullet.changeDynamics(body, -1, collisionMargin=WIDE, physicsClientId=client)
    pose = [0, 0, 0.3 + apart], [0, 0, 0, 1]
    pybullet.resetBasePositionAndOrientation(1, *pose, client)
    sim.tick()


def selected(ss, relation):
    (row,) = ss.eval(
        f"SELECT {relation}(a.this, b.this) FROM a=sim, b=sim "
        "WHERE id(a.this) == 'low' AND id(b.this) == 'high';"
    )
    return row[relation]


def found(ss, relation):
    pairs = ss.eval(
        "SELECT to(id(a.this), 'a'), to(id(b.this), 'b') FROM a=sim, b=sim "
        f"WHERE {relation}(a.this, b.this);"
    )
    return {"a": "low", "b": "high"} in pairs


def raw(ss, relation):
    ((answer,),) = ss.sql(
        f'SELECT sim."{relation}"(a, b) FROM sim.entities a, sim.entities b '
        "WHERE a.name = 'low' AND b.name = 'high'"
    ).fetchall()
    return answer


WAYS = {
    "selected": selected,
    "found": found,
    "raw": raw,
    "called": lambda ss, relation: ss.eval(f"{relation}(sim.low, sim.high);"),
}


@pytest.mark.parametrize("row_by_row", [False, True])
@sampled("way", WAYS, every=4)
def test_changed_margins_count_from_the_next_tick(sim, client, way, row_by_row):
    with ssduck.Interpreter(row_by_row=row_by_row) as ss:
        ss.add_variable("sim", sim)
        # Asked before: plans that go by the old margins are made anew.
        assert [WAYS[way](ss, relation) for relation in RELATIONS] == [True] * 4
        widen(client, sim)
        assert [WAYS[way](ss, relation) for relation in RELATIONS] == [True] * 4
        widen(client, sim, 0.0215)  # by 1 mm and both margins they touch
        assert [WAYS[way](ss, relation) for relation in RELATIONS] == [False] * 4


def test_they_are_in_the_table_and_in_what_if_worlds_and_decide_what_can_be_held(sim, client):
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", sim)
        assert ss.sql("SELECT margin FROM sim.shapes").fetchall() == [(0.001,)] * 2
        widen(client, sim)
        assert ss.sql("SELECT margin FROM sim.shapes").fetchall() == [(WIDE,)] * 2
        ss.add_variable("there", sim.what_if({}))
        assert ss.eval("on(there.low, there.high);") is True
        sim["low"].hold(sim["high"])


def test_recorded_ticks_go_by_those_that_a_body_came_with_and_tell(sim, client):
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", sim)
        sim.step()
        before = sim.time
        ask = "on(sim{{{0!r}}}.low, sim{{{0!r}}}.high);"
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            widen(client, sim)
            after = sim.time
            sim.step()
            assert ss.eval(ask.format(after).replace("on(", "clearance(")) > 0.0
            assert ss.eval("on(sim.low, sim.high);") is True
        with pytest.warns(UserWarning, match="margins of low, high were changed") as caught:
            assert ss.eval(ask.format(after)) is False
        assert [w.filename for w in caught] == [__file__]
        assert ss.eval(ask.format(before)) is True  # told once


def test_margins_of_a_body_that_is_gone(sim, client):
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", sim)
        assert raw(ss, "clearance") > 0.0
        pybullet.removeBody(1, client)
        assert raw(ss, "on") is True  # nobody has taken a tick yet
        sim.tick()
        assert ss.sql("SELECT margin FROM sim.shapes").fetchall() == [(0.001,)]


def test_a_row_of_no_entity_is_an_error(sim):
    other = "(SELECT * REPLACE (id + 1000 AS id) FROM entities)"
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", sim)
        for relation in ("collides", "clearance", "on", "restsOn", "enclosed"):
            with pytest.raises(
                ssduck.SelectScriptError, match="belongs to no entity: 'sim' has none"
            ):
                ss.sql(f'SELECT "{relation}"(a, b) FROM entities a, {other} b').fetchall()
