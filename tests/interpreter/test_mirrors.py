"""Copies of live worlds answer as the worlds do, also of contacts and of the past."""

import pytest

import ssduck
from ssduck import Recording
from ssduck.errors import SelectScriptError, UnknownNameError, UnsupportedError
from ssduck.interpreter.mirrors import Mirror
from ssduck.limits import Limits
from tests.support.environments import by_name

PROGRAMS = [
    "always(z(kitchen.cup_905a) > 0);",
    "robustness(historically(z(kitchen.cup_905a) > 0.5));",
    "SELECT id, z FROM kitchen;",
    "SELECT id FROM kitchen WHERE on(kitchen.table, this);",
    "SELECT a.this, b.this FROM a=kitchen, b=kitchen WHERE near(a.this, b.this, 0.02);",
    "SELECT count(*) FROM kitchen{} AS value;",
    "z(kitchen{0.05}.cup_905a);",
    "holds(on(kitchen.table, kitchen.cup_905a));",
]
STATEMENTS = [
    "SELECT a, b, force FROM contacts ORDER BY ALL",
    "SELECT tick, time FROM ticks_history ORDER BY tick",
    "SELECT a.name FROM entities a, entities b WHERE b.name = 'table' AND touching(a, b) ORDER BY ALL",
    "SELECT tick, id, x, z, vz FROM entities_history ORDER BY ALL",
    "SELECT count(*), fsum(force) FROM contacts_history",
    "SELECT name, position, effort FROM joints ORDER BY ALL",
    "SELECT name, kind FROM entities_model ORDER BY ALL",
]


@pytest.fixture(scope="module")
def pair():
    """An interpreter of a world, and a mirror that is updated now and then."""
    with ssduck.load("kitchen") as ss:
        ss.run(0.05)
        mirror = Mirror(ss, ss["kitchen"], "kitchen", Limits())
        for _ in range(3):
            ss.run(0.02)
            mirror.update()
        x, y, z = ss["kitchen"]["cup_905a"].position
        ss["kitchen"]["cup_905a"].move([x, y, z + 0.3])
        ss.run(0.02)
        mirror.update()
        yield ss, mirror
        mirror.close()


@pytest.mark.slow
@pytest.mark.parametrize("program", PROGRAMS)
def test_a_mirror_answers_programs_as_the_world(pair, program):
    ss, mirror = pair
    assert by_name(mirror.interpreter.eval(program)) == by_name(ss.eval(program))


@pytest.mark.parametrize("statement", STATEMENTS)
def test_a_mirror_answers_sql_as_the_world(pair, statement):
    ss, mirror = pair
    rows = mirror.interpreter.sql(statement).fetchall()
    assert rows == ss.sql(statement).fetchall()
    assert rows


@pytest.mark.slow
def test_a_mirror_of_the_past_goes_to_each_tick(pair):
    ss, _ = pair
    past = Mirror(ss, ss["kitchen"], "kitchen", Limits(), is_past=True)
    times = sorted(set(ss.past("kitchen").times))
    for time in times[:: len(times) // 4]:
        past.world.seek(time)
        ss.add_variable("T", time)
        for program in ("z({}.cup_905a);", "SELECT id FROM {} WHERE on(kitchen.table, this);"):
            expected = ss.eval(program.format("kitchen{T}"))
            assert past.interpreter.eval(program.format("kitchen")) == expected
    past.close()


@pytest.mark.parametrize("is_past", [False, True])
def test_what_later_ticks_may_change_is_nothing_in_a_mirror(pair, is_past):
    ss, _ = pair
    mirror = Mirror(ss, ss["kitchen"], "kitchen", Limits(), is_past=is_past)
    try:
        for program, value in (
            ("always(z(kitchen.cup_905a) > 0);", None),
            ("eventually(z(kitchen.cup_905a) > 99);", None),
            ("historically(z(kitchen.cup_905a) > 0);", True),
        ):
            assert ss.eval(program) is value
            assert mirror.interpreter.eval(program) is value
    finally:
        mirror.close()


@pytest.mark.slow
def test_the_steps_of_the_world_do_not_change_a_mirror():
    with ssduck.load("kitchen") as ss:
        mirror = Mirror(ss, ss["kitchen"], "kitchen", Limits())
        query = "SELECT tick, time FROM ticks_history"
        before = mirror.interpreter.sql(query).fetchall()
        ss.run(0.1)
        assert mirror.interpreter.sql(query).fetchall() == before
        mirror.update()
        assert mirror.interpreter.sql(query).fetchall() == ss.sql(query).fetchall() != before
        mirror.close()


@pytest.mark.slow
def test_dropped_and_moved_parts_are_followed():
    with ssduck.load("kitchen", recording=Recording(tables=("entities",), ticks=40)) as ss:
        mirror = Mirror(ss, ss["kitchen"], "kitchen", Limits())
        query = "SELECT tick, id, z FROM entities_history ORDER BY ALL"
        for _ in range(12):
            ss["kitchen"].step(1)
            ss.run(9 / 240)
            mirror.update()
            assert mirror.interpreter.sql(query).fetchall() == ss.sql(query).fetchall()
        assert ss.past("kitchen").ticks[0] > 1
        mirror.close()


@pytest.mark.slow
def test_entities_come_and_go():
    with ssduck.load("kitchen") as ss:
        mirror = Mirror(ss, ss["kitchen"], "kitchen", Limits())
        ss["kitchen"].remove("cup_905a")
        ss["kitchen"].add_sensor("range_finder", "table", "eye", max_range=1.0)
        ss.run(0.01)
        mirror.update()
        query = "SELECT id FROM kitchen;"
        assert mirror.interpreter.eval(query) == ss.eval(query)
        with pytest.raises(UnknownNameError):
            mirror.interpreter.eval("kitchen.cup_905a;")
        mirror.close()


@pytest.mark.slow
def test_a_recording_that_began_anew_is_another_one():
    with ssduck.load("kitchen") as ss:
        mirror = Mirror(ss, ss["kitchen"], "kitchen", Limits())
        assert mirror.is_up_to_date
        ss.record("kitchen", Recording(tables=("entities",)))
        assert not mirror.is_up_to_date
        mirror.close()


@pytest.mark.slow
@pytest.mark.parametrize("recording", [None, "file"])
def test_the_past_of_a_file_or_of_nothing_is_not_mirrored(tmp_path, recording):
    database = tmp_path / "run.duckdb" if recording else ":memory:"
    with ssduck.load("kitchen", database, recording=None if recording is None else "default") as ss:
        mirror = Mirror(ss, ss["kitchen"], "kitchen", Limits())
        assert mirror.interpreter.sql("SELECT count(*) FROM contacts").fetchall()
        with pytest.raises(SelectScriptError):
            mirror.interpreter.eval("SELECT id FROM kitchen{};")
        with pytest.raises(
            UnsupportedError, match="is in a database file" if recording else "is not in memory"
        ):
            Mirror(ss, ss["kitchen"], "kitchen", Limits(), is_past=True)
        mirror.close()
