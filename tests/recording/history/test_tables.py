"""The tables of recorded ticks."""

import gc
import weakref

import pybullet
import pytest

import ssduck
from ssduck import Recording
from ssduck.errors import ArgumentError, EvaluationError, SqlError
from tests.support.bodies import solid
from tests.support.cases import sampled
from tests.support.pasts import ALL, _falling, _step, _stepped


@sampled("steps", [1, 239, 240, 241, 500], every=3, ids=str)
def test_each_tick_is_kept_stored_or_waiting(falling, steps):
    _step(falling, steps)
    rows = falling.sql(
        "SELECT tick, count(*), min(time), max(time) FROM entities_history GROUP BY tick ORDER BY 1"
    ).fetchall()
    assert [row[0] for row in rows] == list(range(1, steps + 2))
    assert {row[1] for row in rows} == {3}
    assert all(row[2] == row[3] for row in rows)
    assert falling.sql("SELECT count(*) FROM ticks_history").fetchall() == [(steps + 1,)]


@pytest.mark.slow
@sampled("changed", [False, True], every=2, ids=["all", "changed"])
def test_the_last_tick_of_the_history_is_the_present(changed):
    with ssduck.load("kitchen") as ss:
        ss.record("kitchen", Recording(tables=ALL, changed=changed))
        _step(ss, 30, "kitchen")
        ss.flush()
        _step(ss, 5, "kitchen")
        for table in (*ALL, "ticks"):
            live = ss.sql(f"SELECT * FROM {table} ORDER BY ALL").fetchall()
            past = ss.sql(
                f"SELECT * FROM {table}_history WHERE tick = (SELECT tick FROM ticks) ORDER BY ALL"
            ).fetchall()
            assert live, table
            assert past == live, table


@pytest.mark.slow
def test_what_changed_is_all_there_is_to_store(falling):
    falling.record("lab", Recording(changed=True))
    _step(falling, 50)
    falling.flush()
    _step(falling, 50)
    falling.flush()
    schema = falling.sql(
        "SELECT schema_name FROM duckdb_schemas() WHERE schema_name LIKE 'lab_record%'"
    ).fetchall()[-1][0]
    stored = falling.sql(f'SELECT count(*) FROM "{schema}"."entities 0" WHERE id = 1').fetchall()
    assert stored == [(2,)]  # the board, once each time
    rows = falling.sql("SELECT count(*), count(DISTINCT tick) FROM entities_history WHERE id = 1")
    assert rows.fetchall() == [(101, 101)]


@pytest.mark.slow
def test_changes_are_found_of_entities_that_come_and_go():
    client, bodies = _falling()
    world = ssduck.World.attach(client)
    with ssduck.Interpreter() as plain, ssduck.Interpreter() as sparse:
        plain.add_variable("lab", world)
        sparse.add_variable("lab", world)
        sparse.record("lab", Recording(changed=True))
        for tick in range(40):
            if tick == 10:
                pybullet.removeBody(bodies[0], client)
            if tick == 20:
                solid(client, pybullet.GEOM_SPHERE, 1, [0, 1, 1], radius=0.1)
            if tick == 30:
                sparse.flush()
            world.step()
        query = "SELECT * FROM entities_history WHERE tick > 1 ORDER BY tick, id"
        assert sparse.sql(query).fetchall() == plain.sql(query).fetchall()
        assert len(plain.sql(query).fetchall()) == 10 * 3 + 10 * 2 + 20 * 3 - 0
    pybullet.disconnect(client)


@sampled("every", [1, 2, 7], every=3)
def test_every_nth_tick_is_kept(falling, every):
    falling.record("lab", Recording(every=every))
    first = falling.call_variable("lab").snapshot.number
    _step(falling, 20)
    ticks = [row[0] for row in falling.sql("SELECT tick FROM ticks_history").fetchall()]
    assert ticks == list(range(first, first + 21, every))


@pytest.mark.slow
def test_some_entities_are_kept(falling):
    falling.record("lab", Recording(entities=("ball_1",), tables=("contacts", "shapes")))
    _step(falling, 100)
    assert falling.sql("SELECT DISTINCT name FROM entities_history").fetchall() == [("ball_1",)]
    assert falling.sql("SELECT count(*) FROM contacts_history").fetchall() == [(0,)]
    assert falling.sql("SELECT DISTINCT entity FROM shapes_history").fetchall() == [(3,)]


@pytest.mark.slow
def test_a_sensor_brings_what_it_sits_on():
    with ssduck.load("kitchen") as ss:
        ss.record("kitchen", Recording(entities=("fridge_webcam",)))
        _step(ss, 3, "kitchen")
        names = ss.sql("SELECT DISTINCT name FROM entities_history ORDER BY 1").fetchall()
        assert names == [("fridge",), ("fridge_webcam",)]


@pytest.mark.slow
@sampled(
    ("recording", "least", "most"),
    [
        (Recording(seconds=0.5), 121, 182),
        (Recording(ticks=100), 100, 151),
        (Recording(seconds=0.5, ticks=50), 50, 76),
        (Recording(ticks=1, max_bytes=10**9), 1, 3),
        (Recording(ticks=2000), 2000, 3001),
    ],
    every=2,
    ids=["seconds", "ticks", "both", "one", "many"],
)
def test_old_ticks_are_dropped(falling, recording, least, most):
    falling.record("lab", recording)
    for _ in range(10):
        _step(falling, 130)
        ((count, first, last),) = falling.sql(
            "SELECT count(*), min(tick), max(tick) FROM ticks_history"
        ).fetchall()
        assert count == last - first + 1
        assert count <= most
    assert count >= min(least, 1301)
    past = falling.past("lab")
    assert past.ticks == list(range(first, last + 1))
    assert falling.sql("SELECT min(tick) FROM entities_history").fetchall() == [(first,)]


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"tables": ("entitys",)}, "there is no table 'entitys'"),
        ({"tables": "entities"}, "tables is to be a list of names"),
        ({"tables": 3}, "tables is to be a list of names"),
        ({"every": 0}, "every is to be a whole number above 0"),
        ({"every": 1.5}, "every is to be a whole number above 0"),
        ({"ticks": 0}, "ticks is to be a whole number above 0"),
        ({"max_bytes": 0}, "max_bytes is to be a whole number above 0"),
        ({"seconds": 0.0}, "seconds is to be a number above 0"),
        ({"seconds": "1"}, "seconds is to be a number above 0"),
        ({"seconds": float("nan")}, "seconds is to be a number above 0"),
    ],
    ids=lambda value: str(value)[:30],
)
def test_recordings_that_are_none(given, told):
    with pytest.raises(ArgumentError, match=told):
        Recording(**given)


def test_entities_that_are_recorded_are_there(falling):
    with pytest.raises(ArgumentError, match="no entity 'bal_1'"):
        falling.record("lab", Recording(entities=("bal_1",)))


def test_nothing_is_kept_where_nothing_is_asked_for():
    client, _ = _falling()
    with ssduck.Interpreter(recording=None) as ss:
        ss.add_variable("lab", ssduck.World.attach(client))
        with pytest.raises(SqlError, match="not recorded"):
            ss.sql("SELECT * FROM entities_history")
        with pytest.raises(EvaluationError, match="the ticks of 'lab' are not recorded"):
            ss.past("lab")
        ss.record("lab", Recording())
        _step(ss, 2)
        assert ss.sql("SELECT count(*) FROM ticks_history").fetchall() == [(3,)]
        ss.record("lab", None)
        with pytest.raises(EvaluationError, match="not recorded"):
            ss.past("lab")
    pybullet.disconnect(client)


@pytest.mark.slow
def test_a_world_that_is_recorded_lets_its_interpreter_go():
    client, _ = _falling()
    world = ssduck.World.attach(client)
    ss = ssduck.Interpreter()
    ss.add_variable("lab", world)
    world.step()
    gone = weakref.ref(ss._database)
    del ss
    gc.collect()
    assert gone() is None
    world.step()
    pybullet.disconnect(client)


@pytest.mark.slow
def test_ticks_are_taken_while_another_thread_asks(falling):
    with _stepped(falling.call_variable("lab")):
        for _ in range(30):
            counts = falling.sql(
                "SELECT tick, count(*) AS n FROM entities_history GROUP BY tick HAVING n <> 3"
            ).fetchall()
            gaps = falling.sql(
                "SELECT max(tick) - min(tick) + 1 - count(*) FROM ticks_history"
            ).fetchall()
            assert (counts, gaps) == ([], [(0,)])
            past = falling.past("lab", -0.02)
            entities = list(past)
            assert len(entities) == 3 * len(past.ticks)
            assert all(len(entity.position) == 3 for entity in entities[::7])


@pytest.mark.long
@pytest.mark.parametrize("flushed", [1, 7, 5000])
def test_what_is_flushed_often_is_put_together(falling, flushed):
    first = falling.call_variable("lab").snapshot.number
    for number in range(1, 2500):
        _step(falling, 1)
        if number % flushed == 0:
            falling.flush()
    rows = falling.sql("SELECT tick, id FROM entities_history ORDER BY ALL").fetchall()
    assert rows == [(tick, id) for tick in range(first, first + 2500) for id in (1, 2, 3)]
    assert len(falling._database._recorders.running[0]._store._parts) < 5


@pytest.mark.long
def test_what_was_fetched_stays_as_it_was(falling):
    falling.record("lab", Recording(ticks=1600))
    record, kept = falling._database.record_of(falling.call_variable("lab")), []
    for _ in range(12):
        _step(falling, 800)
        kept.append(record.fetch("entities", 0, 10**9))
    # Whatever was written since.
    for rows in kept:
        ticks = rows["tick"].to_pylist()
        assert ticks == [tick for tick in range(ticks[0], ticks[-1] + 1) for _ in range(3)]
