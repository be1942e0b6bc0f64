"""What the page tells of sensors is what the live world tells."""

import json

import pytest

import ssduck
from ssduck import Recording
from ssduck.errors import UnsupportedError

pytest.importorskip("websockets", reason="the extra view is not installed")

from ssduck.interpreter.stopping import StopRequest
from ssduck.view.answers import Answers
from ssduck.view.live import LiveSource

LASER = "barrett_4918_laser_scaner"
ROOMBA = "roomba_625x"
SEEN = "SELECT id, sensingEnvIDs FROM kitchen WHERE count(sensingEnvIDs(this)) > 0;"
PROGRAMS = {
    "isSensing": (
        "SELECT to(id(s.this), 's'), to(id(e.this), 'e') FROM s=kitchen, e=kitchen "
        "WHERE isSensing(s.this, e.this);"
    ),
    "sensingAmount": (
        "SELECT to(id(s.this), 's'), to(sensingAmount(s.this, e.this), 'share') "
        "FROM s=kitchen, e=kitchen WHERE isSensing(s.this, e.this);"
    ),
    "sensingEnvIDs": SEEN,
}
TABLE = "SELECT sensor, entity, hits, rays, measured FROM sensings ORDER BY ALL"


@pytest.fixture
def ss():
    with ssduck.load("kitchen") as ss:
        yield ss


@pytest.fixture
def page(ss):
    source = LiveSource(ss, ss.worlds[0], "kitchen")
    yield Answers(source)
    source.close()


def asked(page, text, language="selectscript", **more):
    """Returns the rows of an answer as the page gets them; the error if there is one."""
    question = {"type": "ask", "text": text, "language": language, **more}
    answer = json.loads(json.dumps(page.answer(question, StopRequest())))
    return answer["error"] if "error" in answer else answer["rows"]


def rows(ss, program):
    shown = [list(row.values()) for row in ss.eval(program)]
    return [[str(cell) if isinstance(cell, list) else cell for cell in row] for row in shown]


def check_same(ss, page):
    """Asks the page first: it must not need a request of the live world's own user."""
    answers = {name: asked(page, program) for name, program in PROGRAMS.items()}
    table = asked(page, TABLE, "sql")
    assert table == [list(row) for row in ss.sql(TABLE).fetchall()]
    assert answers == {name: rows(ss, program) for name, program in PROGRAMS.items()}
    return table


@pytest.mark.slow
def test_the_page_tells_what_sensors_perceive(ss, page):
    world = ss.worlds[0]
    first = check_same(ss, page)
    assert first
    world[ROOMBA].move([0, 0, 5])
    second = check_same(ss, page)
    assert second != first
    world.step(60)
    assert check_same(ss, page) != second


@pytest.mark.slow
def test_a_switch_counts_at_once(ss, page):
    sensor = ss.worlds[0][LASER]
    seen = check_same(ss, page)
    sensor.power(False)
    unseen = check_same(ss, page)
    assert {row[0] for row in seen} - {row[0] for row in unseen} == {sensor.id}
    sensor.power(True)
    assert check_same(ss, page) == seen


@pytest.mark.slow
def test_a_field_of_view_is_the_same(ss, page):
    program = "SELECT obj FROM kitchen WHERE isSensor(this) AS sensorgrid(0.24, 0.05);"
    ss.worlds[0].step(2)
    answer = page.answer({"type": "ask", "text": program}, StopRequest())
    assert (page._result.cells == ss.eval(program).cells).all()
    assert page._result.cells.any()
    assert answer["picture"] is not None


@pytest.mark.slow
def test_a_page_that_asks_nothing_of_sensors_casts_no_rays(ss, page):
    world = ss.worlds[0]
    asked(page, "SELECT id FROM kitchen;")
    world.step()
    assert not world.snapshot.has("sensings")
    asked(page, SEEN)
    assert world.snapshot.has("sensings")


@pytest.mark.slow
def test_the_past_of_sensors_is_told_or_refused(ss, page):
    world = ss.worlds[0]
    ss.run(0.1)
    error = asked(page, SEEN, at=0.05)
    assert "sensings of 'kitchen' is not recorded" in error["message"]
    ss.record("kitchen", Recording(tables=("entities", "links", "sensings")))
    world.step(5)
    at, expected = world.time, rows(ss, SEEN)
    world.step()
    world[ROOMBA].move([0, 0, 5])
    world.step(60)
    assert rows(ss, SEEN) != expected
    assert asked(page, SEEN, at=at) == expected


@pytest.mark.slow
def test_a_copy_has_no_reading_of_a_sensor(ss, page):
    asked(page, SEEN)
    copy = page._source.mirror(None).world
    with pytest.raises(UnsupportedError, match="read it in the world itself"):
        _ = copy[LASER].reading
