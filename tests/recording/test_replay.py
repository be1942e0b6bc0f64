"""A record answers as the live world did, tick by tick, and its triggers fire as they did."""

import re

import pybullet
import pytest

import ssduck
from ssduck.errors import EvaluationError, UnsupportedError
from ssduck.schema import RECORDABLE
from tests.support.bodies import solid
from tools import replay


@pytest.mark.long
def test_a_record_answers_as_the_live_world_did(tmp_path):
    live = replay.recorded(tmp_path / "run", 0.5, 12, seed=3)
    again = replay.replayed(tmp_path / "run", list(live.results))
    assert len(live.results) == 10
    assert all(any(answer != "[]" for answer in told) for told in live.results.values())
    assert replay.differences(live, again) == []


def test_what_differs_is_found():
    live = replay.RunResults({1.0: ["[1]", "[2]"], 2.0: ["[]"]}, [(1.0, "[]")])
    again = replay.RunResults({1.0: ["[1]", "[3]"]}, [])
    assert len(replay.differences(live, again)) == 3


def write_a_second(place):
    with ssduck.load("kitchen") as ss:
        kitchen = ss.call_variable("kitchen")
        with ss.record_to(place):
            for _ in range(10):
                kitchen.step(24, every=24)


@pytest.fixture
def opened(tmp_path, archive):
    """A second of the kitchen, a tick each 24 steps, and the record of it, opened."""
    archive.copy(write_a_second, tmp_path / "run")
    with ssduck.open(tmp_path / "run") as record:
        yield record, record.call_variable("kitchen")


def test_a_record_is_gone_through(opened):
    ss, kitchen = opened
    assert kitchen.time == pytest.approx(1.0)
    assert kitchen.timestep == pytest.approx(0.1)
    assert kitchen.seek(0.55).time == pytest.approx(0.5)
    kitchen.step(2)
    assert kitchen.time == pytest.approx(0.7)
    kitchen.run(0.2)
    assert kitchen.time == pytest.approx(0.9)
    assert ss.eval("getTime();") == pytest.approx(0.9)
    assert ss.past("kitchen", -0.25).times == pytest.approx([0.7, 0.8, 0.9])
    assert ss.eval("SELECT time(this) FROM kitchen{} WHERE id(this) == 'table' AS list;")[-1] < 0.95
    with pytest.raises(EvaluationError, match="what is recorded of 'kitchen' ends at 1 s"):
        kitchen.step(2)
    assert kitchen.time == pytest.approx(0.9)
    with pytest.raises(UnsupportedError, match="a recorded tick does not change"):
        kitchen["table"].move([0, 0, 0])


@pytest.mark.slow
def test_a_query_holds_the_record_at_its_tick(opened):
    ss, kitchen = opened
    ss.add_function("goes_on", lambda _: kitchen.seek(0.0) is not None, "")
    with pytest.raises(ssduck.SelectScriptError, match="a query on 'kitchen' is running"):
        ss.eval("SELECT goes_on(this) FROM kitchen;")
    assert kitchen.time == pytest.approx(1.0)


RELATIONS = ("collides(a.this, b.this)", "near(a.this, b.this, 1)", "inContact(a.this, b.this)")
SOURCES = (
    "a=lab, b=lab{0.04}",
    "a=lab{0.04}, b=lab",
    "a=lab{0.02}, b=lab{0.04}",
    "a=lab{-0.02}, b=lab{0.04}",
    "a=lab, b=lab{-0.02}",
    "a=lab{0.095}, b=lab",
    "a=lab{-0.01}, b=lab{-0.02}",
)
OF_TWO_TICKS = (
    *(
        f"SELECT id(a.this), id(b.this) FROM {sources} WHERE {relation} AS list;"
        for relation in RELATIONS
        for sources in SOURCES
    ),
    *(
        f"SELECT {name}(a.this, b.this) FROM a=lab{{0.02}}, b=lab{{0.04}} AS list;"
        for name in ("clearance", "touching", "on", "distance")
    ),
    "SELECT id(this) FROM lab{0.04} WHERE collides(this, low) AS list;",
    "x = SELECT this FROM lab{0.04} AS list; SELECT id(this) FROM lab WHERE near(this, x[0], 1) AS list;",
    "x = SELECT this FROM lab{0.04} AS list; collides(x[0], low);",
    "x = SELECT this FROM lab{0.04} AS list; y = SELECT this FROM lab{0.02} AS list; "
    "clearance(x[0], y[1]);",
    "SELECT id(a.this) FROM a=lab{0.04}, b=lab WHERE a.this == b.this AS list;",
    "SELECT id(a.this) FROM a=lab, b=(SELECT this FROM lab{0.04} AS list) "
    "WHERE near(a.this, b.this, 1) AS list;",
)


def outcome(ss, program):
    """What a program gives, or the kind of its error and what it says, but for numbers of ticks."""
    try:
        return re.sub(r"\w*World ", "World ", repr(ss.eval(program)))
    except ssduck.SelectScriptError as error:
        return re.sub(r"ticks \d+ and \d+", "ticks", f"{type(error).__name__}: {error.message}")


@pytest.mark.slow
def test_programs_of_two_ticks_end_alike_live_and_opened(tmp_path, client):
    pybullet.setGravity(0, 0, -9.81, client)
    bodies = [
        solid(client, pybullet.GEOM_BOX, mass, [0, 0, z], halfExtents=[0.5, 0.5, 0.1])
        for mass, z in ((0, 0.0), (1, 0.3), (1, 0.8))
    ]
    names = dict(zip(bodies, ("board", "low", "high"), strict=True))
    world = ssduck.World.attach(client, names=names)
    everything = ssduck.Recording(tables=RECORDABLE)
    outcomes = []
    with (
        ssduck.Interpreter(recording=everything) as live,
        ssduck.Interpreter(recording=everything, row_by_row=True) as rows,
    ):
        for ss in (live, rows):
            ss.add_variable("lab", world)
            ss.add_variable("low", world["low"])
        with live.record_to(tmp_path / "run"):
            for _ in range(24):
                world.step()
        live.export(tmp_path / "copy")
        outcomes += [[outcome(ss, program) for program in OF_TWO_TICKS] for ss in (live, rows)]
    for name in ("run", "copy"):
        with ssduck.open(tmp_path / name) as ss:
            ss.add_variable("low", ss.call_variable("lab")["low"])
            outcomes.append([outcome(ss, program) for program in OF_TWO_TICKS])
    for program, *ends in zip(OF_TWO_TICKS, *outcomes, strict=True):
        assert len(set(ends)) == 1, (program, ends)
        if "a=lab{0.02}, b=lab{0.04}" in program:
            assert ("is of entities at one tick" in ends[0]) is ("distance" not in program)
