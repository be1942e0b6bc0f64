"""Ticks go on while those before them are stored in a thread: what is seen, and what may happen."""

import gc
import os
import subprocess
import sys
import threading
import weakref
from pathlib import Path

import pybullet
import pytest

import ssduck
from ssduck import Recording
from ssduck.database import worlds, writer
from ssduck.database.writer import WriterConnection
from ssduck.errors import SqlError
from tests.support.bodies import solid
from tests.support.cases import sampled
from tests.support.timing import HANGS

ROOT = Path(__file__).resolve().parents[2]
RING = 10
BALLS = 3
# Stores full buffers only.
FULL = Recording(flush_every=None)
POSIX = pytest.mark.skipif(os.name != "posix", reason="forks")


class Gate:
    """Holds up, or fails, what is run in a thread that stores.

    Attributes:
        reached: whether something is held up.
        opened: lets it go on.
        failures: so many times an insertion fails.
    """

    def __init__(self, monkeypatch):
        self.reached, self.opened = threading.Event(), threading.Event()
        self.failures = 0
        self._held = ""
        run = WriterConnection.run

        def told(own, sql):
            if threading.current_thread().name == "ssduck stores":
                self._pass(sql)
            run(own, sql)

        monkeypatch.setattr(WriterConnection, "run", told)

    def _pass(self, sql):
        if self._held and sql.startswith(self._held):
            self.reached.set()
            assert self.opened.wait(60)
        if sql.startswith("INSERT") and self.failures:
            self.failures -= 1
            raise SqlError("the disk is full")

    def hold(self, statement):
        """Hold up statements that begin so."""
        self._held = statement

    def hold_at(self, statement, world, tick):
        """Tick until so many ticks have been, of which the statement is held up."""
        self.hold(statement)
        _ticked(world, tick)
        assert self.reached.wait(60)

    def lets_go(self, call):
        """Check that a call waits for what is held up; returns what it gives then."""
        thread, found = _in_thread(call)
        thread.join(0.1)
        assert thread.is_alive()
        self.opened.set()
        thread.join(60)
        return found


@pytest.fixture
def gate(monkeypatch):
    gate = Gate(monkeypatch)
    yield gate
    gate.opened.set()


@pytest.fixture
def world(client, monkeypatch):
    """A world of falling balls; a file takes its ticks ten at a time, and each time a checkpoint."""
    monkeypatch.setattr(worlds, "BUFFERED_TICKS", RING)
    monkeypatch.setattr(writer, "LONG_LOG", 1)
    for place in range(BALLS):
        solid(client, pybullet.GEOM_SPHERE, 1, [place, 0, 1], radius=0.1)
    return ssduck.World.attach(client, name="lab")


@pytest.fixture
def recorded(world, tmp_path):
    with ssduck.Interpreter(str(tmp_path / "run.duckdb"), recording=FULL) as ss:
        ss.add_variable("lab", world)
        yield ss


def _recorder(ss):
    return ss._database._recorders.running[0]


def _ticked(world, until):
    while world.snapshot.number < until:
        world.tick()


def _counts(ss):
    query = "SELECT tick, count(*) FROM entities_history GROUP BY tick ORDER BY tick"
    return dict(ss.sql(query).fetchall())


def _whole(last, first=1):
    return dict.fromkeys(range(first, last + 1), BALLS)


def _in_thread(call):
    found = []
    thread = threading.Thread(target=lambda: found.append(call()))
    thread.start()
    return thread, found


def _storers():
    return [thread for thread in threading.enumerate() if thread.name == "ssduck stores"]


# -- what is seen -----------------------------------------------------------------------------


@pytest.mark.slow
def test_what_is_being_stored_is_seen_once(recorded, world, gate):
    gate.hold_at("INSERT", world, RING + 5)
    assert _counts(recorded) == _whole(RING + 5)
    assert recorded.past("lab").ticks == list(range(1, RING + 6))
    asked = recorded._database.record_of(world)
    ticks = asked.fetch("entities", RING - 1, RING + 2)["tick"].to_pylist()
    assert sorted(ticks) == [t for t in range(RING - 1, RING + 3) for _ in range(BALLS)]
    near = "SELECT tick(this) FROM lab{} WHERE this == ball AND near(this, other, 5) AS list;"
    balls = sorted(entity.name for entity in world)
    recorded.add_variable("ball", world[balls[0]])
    recorded.add_variable("other", world[balls[1]])
    found = recorded.eval(near)
    assert found == list(range(1, RING + 6))
    gate.opened.set()
    _recorder(recorded).wait()
    assert _counts(recorded) == _whole(RING + 5)
    assert recorded.eval(near) == found


@pytest.mark.slow
def test_a_query_and_a_commit_wait_for_each_other(recorded, world, gate):
    gate.hold_at("COMMIT", world, RING + 1)
    # what it would see is neither here nor there
    assert gate.lets_go(lambda: _counts(recorded)) == [_whole(RING + 1)]


@pytest.mark.slow
def test_nothing_is_made_good_amid_a_query(recorded, world):
    _ticked(world, RING)
    recorder = _recorder(recorded)
    with recorded._database.pinned():
        recorder._start_storing()
        thread = _storers()[0]
        thread.join(0.2)
        assert thread.is_alive()
        stored = recorder._store.fetch("entities", 0, 100)  # type: ignore[attr-defined]
        assert stored.num_rows == 0
    thread.join(60)
    assert recorder._store.fetch("entities", 0, 100).num_rows == BALLS * RING


@pytest.mark.slow
def test_queries_see_whole_ticks_while_they_are_stored(recorded, world):
    ends = threading.Event()

    def stepping():
        while not ends.is_set():
            world.tick()

    thread, _ = _in_thread(stepping)
    try:
        for _ in range(20):
            with recorded._database.pinned():
                last = world.snapshot.number
                for _ in range(2):
                    assert _counts(recorded) == _whole(last)
            ticks = recorded.eval("SELECT tick(this) FROM lab{} AS list;")
            assert ticks == [t for t in range(1, ticks[-1] + 1) for _ in range(BALLS)]
    finally:
        ends.set()
        thread.join()
    assert world.snapshot.number > 3 * RING


@pytest.mark.slow
def test_entities_that_come_while_others_are_stored(recorded, world, client, gate):
    gate.hold_at("INSERT", world, RING + 1)
    solid(client, pybullet.GEOM_SPHERE, 1, [0, 5, 1], radius=0.1)
    gate.lets_go(world.tick)  # what it is waits for the same connection
    assert _counts(recorded) == _whole(RING + 1) | {RING + 2: BALLS + 1}


# -- waiting ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_tick_waits_when_both_are_full(recorded, world, gate):
    gate.hold("INSERT")
    thread, _ = _in_thread(lambda: _ticked(world, 10 * RING))
    assert gate.reached.wait(60)
    thread.join(0.3)
    assert thread.is_alive()
    recorder = _recorder(recorded)
    assert (len(recorder.ticks), recorder.buffers["ticks"].count) == (2 * RING, RING)
    assert len(recorder._writer) == 1
    gate.opened.set()
    thread.join(60)
    assert _counts(recorded) == _whole(10 * RING)


@pytest.mark.slow
def test_a_tick_that_waited_until_ctrl_c_is_kept(recorded, world, monkeypatch):
    _ticked(world, RING)
    recorder = _recorder(recorded)

    def interrupted():
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(recorder, "wait", interrupted)
        with pytest.raises(KeyboardInterrupt):
            world.tick()
    _ticked(world, 3 * RING)
    assert _counts(recorded) == _whole(3 * RING)


@pytest.mark.slow
@pytest.mark.parametrize("call", ["flush", "close"])
def test_flush_and_close_wait(recorded, world, gate, tmp_path, call):
    gate.hold_at("INSERT", world, RING + 4)
    gate.lets_go(getattr(recorded, call))
    assert not _storers()
    recorded.close()
    with ssduck.open(tmp_path / "run.duckdb") as then:
        assert _counts(then) == _whole(RING + 4)


@pytest.mark.slow
def test_a_world_that_is_recorded_anew_while_it_is_stored(world, gate):
    with ssduck.Interpreter(recording=Recording(changed=True)) as ss:  # in memory, yet in tables
        ss.add_variable("lab", world)
        gate.hold_at("INSERT", world, RING + 1)
        thread, _ = _in_thread(lambda: ss.record("lab", Recording()))
        gate.opened.set()
        thread.join(60)
        world.tick()
        assert _counts(ss) == _whole(RING + 2, first=RING + 1)


@pytest.mark.slow
def test_old_ticks_of_a_file_are_dropped(world, tmp_path):
    kept = Recording(ticks=8 * RING, flush_every=None)
    with ssduck.Interpreter(str(tmp_path / "run.duckdb"), recording=kept) as ss:
        ss.add_variable("lab", world)
        for last in range(7, 30 * RING, 17):
            _ticked(world, last)
            ticks = ss.past("lab").ticks
            assert ticks == list(range(ticks[0], last + 1))
            assert min(last, 8 * RING) <= len(ticks) <= 12 * RING + 1
            assert _counts(ss) == _whole(last, ticks[0])


# -- what fails -------------------------------------------------------------------------------


@pytest.mark.slow
@sampled("told", ["tick", "flush", "close"], every=3)
def test_what_fails_in_the_thread_is_told_and_waits(recorded, world, gate, tmp_path, told):
    gate.failures = 1
    gate.hold("INSERT")
    _ticked(world, RING + 1)
    gate.opened.set()
    _recorder(recorded).wait()
    assert _counts(recorded) == _whole(RING + 1)
    if told == "tick":
        with pytest.raises(SqlError, match="the disk is full"):
            world.tick()
        _ticked(world, 3 * RING)  # is told once, and tried again
        recorded.flush()
    else:  # they try at once
        getattr(recorded, told)()
    last = world.snapshot.number
    recorded.close()
    with ssduck.open(tmp_path / "run.duckdb") as then:
        assert _counts(then) == _whole(last)


@pytest.mark.slow
def test_what_fails_again_and_again(recorded, world, gate, tmp_path):
    gate.failures = 3
    failures = 0
    for _ in range(6 * RING):
        try:
            world.tick()
        except SqlError:
            failures += 1
        _recorder(recorded).wait()
        if world.snapshot.number % 4 == 0:
            assert _counts(recorded) == _whole(world.snapshot.number)
    assert failures == 3
    assert recorded.flush() == {"lab": 6 * RING + 1}
    recorded.close()
    with ssduck.open(tmp_path / "run.duckdb") as then:
        assert _counts(then) == _whole(6 * RING + 1)


def test_a_log_that_cannot_be_moved_is_told_at_flush(recorded, world, gate, monkeypatch):
    def fails(_):
        raise SqlError("no checkpoint")

    with monkeypatch.context() as patch:
        patch.setattr(WriterConnection, "checkpoint", fails)
        gate.hold("INSERT")  # the next tick would tell it, too
        _ticked(world, RING + 1)
        gate.opened.set()
        _recorder(recorded).wait()
    with pytest.raises(SqlError, match="no checkpoint"):
        recorded.flush()
    assert _counts(recorded) == _whole(RING + 1)


# -- the end ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_an_interpreter_that_is_forgotten_while_it_stores(world, gate, tmp_path):
    path = tmp_path / "run.duckdb"
    ss = ssduck.Interpreter(str(path), recording=FULL)
    ss.add_variable("lab", world)
    gate.hold_at("INSERT", world, RING + 3)
    gone = weakref.ref(ss._database)
    threading.Timer(0.1, gate.opened.set).start()
    del ss
    gc.collect()
    assert gone() is None
    assert not _storers()
    with ssduck.open(path) as then:
        assert _counts(then) == _whole(RING + 3)


@pytest.mark.slow
def test_garbage_is_collected_in_the_thread_that_stores(world, tmp_path, monkeypatch):
    path = tmp_path / "run.duckdb"
    ss = ssduck.Interpreter(str(path), recording=FULL)
    ss.add_variable("lab", world)
    finish = ss._database.connection._finalizer
    run, ended = WriterConnection.run, threading.Event()

    def told(own, sql):
        if threading.current_thread().name == "ssduck stores" and sql == "BEGIN":
            finish()  # as the collector of garbage would
            ended.set()
        run(own, sql)

    monkeypatch.setattr(WriterConnection, "run", told)
    _ticked(world, RING + 3)
    assert ended.wait(60)
    for thread in threading.enumerate():
        if thread is not threading.current_thread() and not thread.daemon:
            thread.join(60)
    with ssduck.open(path) as then:
        counts = _counts(then)
    assert counts == _whole(len(counts))
    assert len(counts) >= RING


SCRIPT = """
import os, sys, time, pybullet, ssduck
from ssduck.database import worlds
from ssduck.database.writer import WriterConnection
worlds.BUFFERED_TICKS = 10
client = pybullet.connect(pybullet.DIRECT)
ball = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.1)
for place in range(3):
    pybullet.createMultiBody(1, ball, basePosition=[place, 0, 1])
world = ssduck.World.attach(client, name="lab")
ss = ssduck.Interpreter(sys.argv[1], recording=ssduck.Recording(flush_every=None))
ss.add_variable("lab", world)
slow = WriterConnection.insert
def insert(*given):
    time.sleep(0.05)
    slow(*given)
WriterConnection.insert = insert
while world.snapshot.number < 24:
    world.tick()
"""
ENDS = {
    "the end": "",
    "an error": "raise SystemExit(0)",
    "a fork": "if not os.fork():\n    sys.exit()\nos.wait()\nworld.tick()",
}


@pytest.mark.slow
@POSIX
@sampled("end", ENDS, every=3)
def test_a_process_that_ends_while_it_stores(tmp_path, end):
    path = tmp_path / "run.duckdb"
    subprocess.run(
        [sys.executable, "-c", SCRIPT + ENDS[end], str(path)], check=True, timeout=HANGS, cwd=ROOT
    )
    with ssduck.open(path) as then:
        assert _counts(then) == _whole(25 if end == "a fork" else 24)
