"""Worlds that programs make are let go when no variable has them any more."""

import gc
import weakref

import pybullet
import pytest

import ssduck
from ssduck.errors import UnknownNameError
from tests.support.bodies import solid
from tests.support.cases import sampled


@pytest.fixture(params=["memory", pytest.param("file", marks=pytest.mark.long)])
def lab(request, client, tmp_path):
    """An interpreter on a world of three boxes, in memory or in a file that is called so, too."""
    for x in range(3):
        solid(client, pybullet.GEOM_BOX, 1, [x, 0, 0], halfExtents=[0.1, 0.1, 0.1])
    place = ":memory:" if request.param == "memory" else tmp_path / "world.duckdb"
    with ssduck.Interpreter(place) as ss:
        ss.add_variable("lab", ssduck.World.attach(client))
        yield ss


def held(ss):
    """How many clients, worlds, schemas and views of buffers there are."""
    clients = sum(pybullet.isConnected(number) for number in range(64))
    schemas = ss.sql(
        "SELECT count(*) FROM duckdb_schemas() WHERE NOT internal AND schema_name NOT LIKE '%record%'"
    )
    views = ss.sql("SELECT count(*) FROM duckdb_views() WHERE temporary")
    worlds = len(ss._database._worlds.bound)
    return clients, worlds, schemas.fetchone()[0], views.fetchone()[0]


ROUNDS = {
    "a variable": "e = SELECT this FROM lab AS environment; SELECT id FROM e AS list;",
    "the past of it": "e = SELECT this FROM lab AS environment; SELECT id FROM e{} AS list;",
    "no variable": "SELECT id FROM (SELECT this FROM lab AS environment) AS list;",
    "a relation": (
        "e = SELECT this FROM lab AS environment; "
        "SELECT id(a.this) FROM a=e, b=e WHERE near(a.this, b.this, 1) AS list;"
    ),
    "cleared": "e = SELECT this FROM lab AS environment; x = SELECT id FROM e AS list; clear('e');",
}


@pytest.mark.slow
@sampled("program", ROUNDS.values(), every=5, ids=ROUNDS)
def test_a_loop_of_programs_keeps_the_last_world_at_most(lab, program):
    lab.eval(program)
    lab.eval(program)
    gc.collect()  # clients that other tests left
    before = held(lab)
    gc.disable()  # what is let go is let go at once
    try:
        for _ in range(3):
            lab.eval(program)
    finally:
        gc.enable()
    assert held(lab) == before
    lab.eval("e = 1;")
    assert held(lab)[1] == 1


@pytest.mark.long
def test_what_fails_keeps_no_world(lab):
    def fails():
        with pytest.raises(UnknownNameError):
            lab.eval("e = SELECT this FROM lab AS environment; SELECT id FROM e AS list; nobody;")

    fails()
    before = held(lab)
    for _ in range(5):
        fails()
    gc.collect()  # an error knows where it was raised
    assert held(lab)[:3] <= before[:3]


@pytest.mark.slow
@sampled("how", ["environment", "what_if", "excerpt"], every=3)
def test_a_world_of_the_users_name_goes_with_its_name(lab, how):
    world = lab.call_variable("lab")

    def made():
        match how:
            case "environment":
                return lab.eval("SELECT this FROM lab AS environment;")
            case "what_if":
                return world.what_if({"body_0": [1, 0, 0, 0, 0, 0, 5]})
            case _:
                return world.excerpt(["body_0"])

    gone = []
    for _ in range(6):
        other = lab.add_variable("other", made())
        gone.append(weakref.ref(other))
        assert lab.eval("SELECT id FROM other AS list;")[0] == "body_0"
        del other
    gc.collect()
    assert [reference() is None for reference in gone] == [True] * 5 + [False]
    assert len(lab._database._worlds.bound) == 2


@pytest.mark.slow
def test_what_somebody_has_stays(lab):
    kept = lab.eval("e = SELECT this FROM lab AS environment; SELECT this FROM e AS list;")
    past = lab.eval("e{};")
    lab.eval("e = 1;")
    assert [entity.name for entity in kept] == ["body_0", "body_1", "body_2"]
    assert len(past.times) == 1
    lab.add_variable("entity", kept[0])
    assert lab.eval("id(entity);") == "body_0"


@pytest.mark.slow
def test_closing_lets_go_what_programs_have_bound(lab):
    lab.eval("e = SELECT this FROM lab AS environment; f = e; mine = 1;")
    lab.add_variable("kept", lab.eval("SELECT this FROM lab AS environment;"))
    bound = weakref.ref(lab.call_variable("e"))
    lab.close()
    gc.collect()
    assert bound() is None
    assert lab.call_variable("kept").simulator
    assert lab.call_variable("mine") == 1
