"""How what waits is stored: by a store that fails; and in memory."""

import pybullet
import pytest

import ssduck
from ssduck import Recording
from ssduck.errors import SqlError
from ssduck.recording.recorder import Recorder
from ssduck.recording.stores.base import TickStore
from ssduck.schema import recorded_tables


class Store(TickStore):
    """Stores the rows that it is given, when it may."""

    def __init__(self):
        self.recording = Recording()
        self.tables = recorded_tables(self.recording.tables)
        self.failures = 0
        self.rows = []

    def add_members(self, members, geometry_id):
        pass

    def add(self, rows, commit_lock):
        if self.failures:
            self.failures -= 1
            raise SqlError("the disk is full")
        with commit_lock:
            self.rows += [rows["entities"].select(["tick", "id", "z"]).to_pylist()]

    def drop_before(self, tick):
        return tick

    @property
    def stored(self):
        return [(row["tick"], row["id"]) for part in self.rows for row in part]


@pytest.fixture
def world(client):
    ball = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.1, physicsClientId=client)
    for place in range(3):
        pybullet.createMultiBody(1, ball, basePosition=[place, 0, 1], physicsClientId=client)
    return ssduck.World.attach(client)


def _recorded(world, store, **given):
    recorder = Recorder(Recording(**given), store, max_ticks=10)
    first = world.snapshot.number
    world.ticker.add_recorder(recorder)
    return recorder, first


@pytest.mark.slow
def test_a_tick_waits_while_those_before_it_are_stored(world):
    store = Store()
    recorder, first = _recorded(world, store)
    for ticks in range(1, 1000):
        world.tick()
        recorder.wait()
        assert len(store.stored) == 3 * (ticks // 10 * 10)
    recorder.flush()
    assert store.stored == [(tick, id) for tick in range(first, first + 1000) for id in (1, 2, 3)]


def test_what_a_store_does_not_take_is_given_again(world):
    store = Store()
    recorder, first = _recorded(world, store)
    store.failures = 2
    failures = 0
    for _ in range(100):
        try:
            world.tick()
        except SqlError:
            failures += 1
    recorder.flush()
    assert failures == 2
    assert store.stored == [(t, id) for t in range(first, first + 101) for id in (1, 2, 3)]


def test_entities_that_come_and_go_are_told_apart_in_a_ring(world, client):
    store = Store()
    recorder, first = _recorded(world, store)
    for _ in range(4):
        world.tick()
    pybullet.removeBody(1, client)
    for _ in range(20):
        world.tick()
    recorder.flush()
    before = [(tick, id) for tick in range(first, first + 5) for id in (1, 2, 3)]
    after = [(tick, id) for tick in range(first + 5, first + 25) for id in (1, 3)]
    assert store.stored == before + after


@pytest.mark.long
@pytest.mark.parametrize("flushed", [1, 7, 5000])
def test_what_is_flushed_often_is_put_together(world, flushed):
    with ssduck.Interpreter(recording=Recording()) as ss:
        ss.add_variable("lab", world)
        first = world.snapshot.number
        for number in range(1, 2500):
            world.tick()
            if number % flushed == 0:
                ss.flush()
        rows = ss.sql("SELECT tick, id FROM entities_history ORDER BY ALL").fetchall()
        assert rows == [(t, id) for t in range(first, first + 2500) for id in (1, 2, 3)]
        assert len(ss._database._recorders.running[0]._store._parts) < 5


@pytest.mark.long
def test_what_was_fetched_stays_as_it_was(world):
    with ssduck.Interpreter(recording=Recording(ticks=1600)) as ss:
        ss.add_variable("lab", world)
        kept = []
        for _ in range(12):
            for _ in range(800):
                world.step()
            kept.append(ss._database.record_of(world).fetch("entities", 0, 10**9))
            ((low, high, count),) = ss.sql(
                "SELECT min(tick), max(tick), count(*) FROM entities_history"
            ).fetchall()
            assert count == 3 * (high - low + 1)
        # What was fetched is as it was, whatever was written since.
        for rows in kept:
            ticks = rows["tick"].to_pylist()
            assert ticks == [tick for tick in range(ticks[0], ticks[-1] + 1) for _ in range(3)]
