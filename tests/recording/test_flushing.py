"""Ticks are on the disk in time: the first at once, the others after `flush_every` at the latest."""

import shutil
import threading
from collections import Counter
from itertools import count
from pathlib import Path

import pybullet
import pytest

import ssduck
from ssduck import Recording
from ssduck.errors import ArgumentError, RecordError
from ssduck.recording import background_writer
from ssduck.recording import recorder as recorders
from ssduck.recording.stores import files, parquet, part_log
from ssduck.recording.stores.parquet_layout import FolderRun
from tests.support.bodies import create_linked_body
from tests.support.cases import sampled
from tests.support.recorded import end_part, sphere
from tests.support.timing import HANGS
from tests.support.triggering import until

BALLS = 3
# So long that no tick is stored by time in a test.
NEVER = 1e6
TABLES = ("entities", "links", "contacts")


@pytest.fixture
def world(client):
    """A world of an arm of two links and falling balls, one of which touches the arm."""
    ball = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.1, physicsClientId=client)
    for place in range(BALLS - 1):
        pybullet.createMultiBody(1, ball, basePosition=[place, 0, 1], physicsClientId=client)
    create_linked_body(
        client,
        1,
        ball,
        basePosition=[0, 0, 1.15],
        linkPositions=[[0, 0, 0.3]],
        linkJointTypes=[pybullet.JOINT_REVOLUTE],
        linkJointAxis=[[1, 0, 0]],
    )
    return ssduck.World.attach(client, name="lab")


class Clock:
    """The time that recorders see, which goes on when a test says so; the timer is off."""

    def __init__(self, monkeypatch):
        self.now = 1000.0
        monkeypatch.setattr(recorders, "monotonic", lambda: self.now)
        monkeypatch.setattr(background_writer, "start_watching", lambda _: None)


@pytest.fixture
def clock(monkeypatch):
    return Clock(monkeypatch)


def _log(run):
    return sorted(file.name for file in run.glob("log/world=lab/episode=0/*"))


def _parts(run):
    return sorted(file.name for file in run.glob("ticks/world=lab/episode=0/*"))


def _started(ss, world, run, **options):
    """Starts to record a world to a folder, and returns the recorder."""
    ss.add_variable("lab", world)
    ss.record_to(run, recording=Recording(tables=TABLES, **options))  # type: ignore[arg-type]
    (recorder,) = ss._database._recorders.running
    return recorder


def _tick(recorder, world, count=1):
    for _ in range(count):
        world.step()
        recorder.wait()


def _contents(ss):
    """Returns the rows of all tables."""
    tables = (*TABLES, "ticks")
    return {
        table: ss.sql(f"SELECT * FROM {table}_history ORDER BY ALL").fetchall() for table in tables
    }


@pytest.mark.slow
def test_ticks_of_a_folder_are_in_the_log_in_time(world, clock, tmp_path):
    run = tmp_path / "run"
    with ssduck.Interpreter(recording=None) as ss:
        recorder = _started(ss, world, run, flush_every=2.0)
        recorder.wait()
        assert _log(run) == ["part-000000-0000.arrow"]  # the first tick, at once
        _tick(recorder, world, 3)
        clock.now += 0.99
        _tick(recorder, world)
        assert len(_log(run)) == 1
        clock.now += 0.02  # half of the time after the first of these
        _tick(recorder, world)
        assert _log(run) == ["part-000000-0000.arrow", "part-000000-0001.arrow"]
        with ssduck.open(run) as copy:
            assert copy.past("lab").ticks == list(range(1, 7))
        _tick(recorder, world)
        with ssduck.open(run) as copy:
            assert copy.past("lab").ticks == list(range(1, 7))
        assert _parts(run) == []
    assert _log(run) == []
    with ssduck.open(run) as copy:
        assert copy.past("lab").ticks == list(range(1, 8))


@pytest.mark.slow
def test_ticks_of_a_file_are_committed_in_time(world, clock, tmp_path):
    recording = Recording(flush_every=2.0)
    with ssduck.Interpreter(str(tmp_path / "run.duckdb"), recording=recording) as ss:
        ss.add_variable("lab", world)
        (recorder,) = ss._database._recorders.running
        recorder.wait()
        counts = []
        for seconds in (0.0, 0.0, 1.01, 0.0, 0.99):
            clock.now += seconds
            _tick(recorder, world)
            counts.append(recorder._store.fetch("ticks", 0, 100).num_rows)  # type: ignore[attr-defined]
        assert counts == [1, 1, 4, 4, 4]
        assert ss.past("lab").ticks == list(range(1, 7))


@pytest.mark.slow
def test_a_log_has_what_parts_have(world, clock, tmp_path):
    """The rows of the log, those of parts, and those in memory are the same."""
    run = tmp_path / "run"
    with ssduck.Interpreter(recording=Recording(tables=TABLES)) as ss:
        ss.add_variable("lab", world)
        writing = ss.record_to(run, recording=Recording(tables=TABLES))
        recorder = ss._database._recorders.running[-1]
        _tick(recorder, world, 2)
        end_part(writing)
        for _ in range(4):
            clock.now += 0.6
            _tick(recorder, world, 2)
        assert (_parts(run), len(_log(run))) == (["part-000000.parquet"], 3)
        live = _contents(ss)
        stored = shutil.copytree(run, tmp_path / "copy")
        with ssduck.open(stored) as copy:
            # The last tick waits for a flush.
            rows = _contents(copy)
            last = copy.past("lab").ticks[-1]
            for one in (ss, copy):
                one.add_variable("other", one.call_variable("lab")["body_1"])
            near = "SELECT tick(this) FROM lab{} WHERE touching(this, other) AS list;"
            assert copy.eval(near) == [tick for tick in ss.eval(near) if tick <= last]
        assert last == world.snapshot.number - 1
        for table, expected in live.items():
            place = 0 if table == "ticks" else [*ssduck.schema.TABLES[table].names].index("tick")
            assert rows[table] == [row for row in expected if row[place] <= last]
        writing.close()
        assert _contents(ssduck.open(run)) == _contents(ss) == live


@pytest.mark.slow
def test_a_world_that_stands_still_is_stored(world, tmp_path):
    run = tmp_path / "run"
    with ssduck.Interpreter(recording=None) as ss:
        recorder = _started(ss, world, run, flush_every=0.1)
        _tick(recorder, world)
        until(lambda: recorder.flush_at is None and not recorder._writer.is_busy)
        with ssduck.open(run) as copy:
            assert copy.past("lab").ticks == [1, 2]


def test_the_timer_leaves_a_recorder_that_is_in_use(world, clock, tmp_path):
    with ssduck.Interpreter(recording=None) as ss:
        recorder = _started(ss, world, tmp_path / "run", flush_every=NEVER)
        _tick(recorder, world)
        clock.now += NEVER
        results = []

        def try_in_thread():
            thread = threading.Thread(target=lambda: results.append(recorder.try_to_flush()))
            thread.start()
            thread.join(HANGS)

        with recorder.read_lock:
            try_in_thread()
        with recorder._lock:
            try_in_thread()
        assert results == [False, False]
        assert recorder.buffers["ticks"].count == 1
        try_in_thread()
        recorder.wait()
        assert results[-1]
        assert recorder.buffers["ticks"].count == 0


@pytest.mark.slow
def test_flushes_make_no_small_parts(world, clock, tmp_path, monkeypatch):
    """A flush at each tick: the record has full parts, and each row is written twice at most."""
    monkeypatch.setattr(parquet, "PART_TICKS", 10)
    run = tmp_path / "run"
    written = Counter()
    write_parquet, append = parquet.write_parquet, parquet.PartLog.append

    def counted(rows, place, **options):
        written[place.relative_to(run).parts[0]] += rows.num_rows
        return write_parquet(rows, place, **options)

    def logged(log, part, rows):
        written["log"] += rows["ticks"].num_rows
        append(log, part, rows)

    monkeypatch.setattr(parquet, "write_parquet", counted)
    monkeypatch.setattr(parquet.PartLog, "append", logged)
    with ssduck.Interpreter(recording=None) as ss:
        ss.add_variable("lab", world)
        with ss.record_to(run, recording=Recording(tables=TABLES, flush_every=None)) as writing:
            assert writing.flush() == 1
            for tick in range(2, 26):
                world.step()
                assert writing.flush() == tick
                with ssduck.open(run) as copy:
                    assert copy.past("lab").ticks == list(range(1, tick + 1))
            assert (len(_parts(run)), len(_log(run))) == (2, 5)
    assert (len(_parts(run)), len(_log(run))) == (3, 0)
    assert (written["ticks"], written["log"]) == (25, 23)  # the last ticks of parts are not logged
    assert written["entities"] == 25 * BALLS
    assert ssduck.check(run) == []


class Killed(BaseException):
    """Ends a recorder in the middle of its work."""


@pytest.mark.slow
@sampled("step", range(16), every=3)
def test_a_recorder_that_is_killed_at_any_file(world, clock, tmp_path, monkeypatch, step):
    """While a log becomes a part: before and after each file is there, or gone."""
    monkeypatch.setattr(parquet, "PART_TICKS", 4)
    run, left = tmp_path / "run", tmp_path / "left"
    steps = count()

    def dying(work):
        def step_of(*arguments, **options):
            if next(steps) == step:
                raise Killed
            work(*arguments, **options)
            if next(steps) == step:
                raise Killed

        return step_of

    with ssduck.Interpreter(recording=Recording(tables=TABLES)) as ss:
        ss.add_variable("lab", world)
        writing = ss.record_to(run, recording=Recording(tables=TABLES, flush_every=None))
        for _ in range(3):
            writing.flush()
            world.step()
        with monkeypatch.context() as patch:
            for module in (files, part_log):
                patch.setattr(module, "write_atomically", dying(module.write_atomically))
            patch.setattr(parquet.PartLog, "clear", dying(parquet.PartLog.clear))
            patch.setattr(Path, "unlink", dying(Path.unlink))
            with pytest.raises(Killed):
                writing.flush()
        shutil.copytree(run, left)
        expected = _contents(ss)
        with ssduck.open(left) as copy:
            found = _contents(copy)
            ticks = copy.past("lab").ticks
        is_part = bool(_parts(left))
        assert ticks == list(range(1, 5 if is_part else 4))
        for table, rows in expected.items():
            place = 0 if table == "ticks" else [*ssduck.schema.TABLES[table].names].index("tick")
            assert found[table] == [row for row in rows if row[place] <= ticks[-1]]


@pytest.mark.slow
def test_what_the_disk_does_not_take_waits(world, clock, tmp_path, monkeypatch):
    run = tmp_path / "run"
    with ssduck.Interpreter(recording=None) as ss:
        recorder = _started(ss, world, run)
        _tick(recorder, world)

        def fail(*_):
            raise OSError(28, "No space left on device")

        with monkeypatch.context() as patch:
            patch.setattr(parquet.PartLog, "append", fail)
            clock.now += 1
            _tick(recorder, world)
            with pytest.raises(RecordError, match="No space left on device"):
                world.step()
        clock.now += 1
        _tick(recorder, world)
        with ssduck.open(run) as copy:
            assert copy.past("lab").ticks == list(range(1, 6))


def _cut_off(log):
    file = log / "part-000000-0001.arrow"
    file.write_bytes(file.read_bytes()[:-100])


def _swap(log):
    one, other = log / "part-000000-0000.arrow", log / "part-000000-0001.arrow"
    one.rename(log / "between")
    other.rename(one)
    (log / "between").rename(other)


@pytest.mark.slow
@sampled(
    ("damage", "told"),
    [
        (
            lambda log: (log / "part-000000-0001.arrow").unlink(),
            "part-000000-0001.arrow is missing, and files after it are there",
        ),
        (_cut_off, "part-000000-0001.arrow cannot be read: it is damaged"),
        (_swap, "part-000000-0000.arrow is another file of a log"),
    ],
    every=1,
)
def test_a_damaged_log_is_noticed(world, clock, tmp_path, damage, told):
    with ssduck.Interpreter(recording=None) as ss:
        recorder = _started(ss, world, tmp_path / "run")
        for _ in range(3):
            clock.now += 0.6
            _tick(recorder, world, 2)
        run = Path(shutil.copytree(tmp_path / "run", tmp_path / "copy"))
        assert len(_log(run)) == 3
    damage(run / "log" / "world=lab" / "episode=0")
    with pytest.raises(RecordError, match=told):
        ssduck.open(run)


@pytest.mark.slow
def test_full_buffers_only(world, clock, tmp_path):
    with ssduck.Interpreter(recording=None) as ss:
        recorder = _started(ss, world, tmp_path / "run", flush_every=None)
        for _ in range(5):
            clock.now += 1e6
            _tick(recorder, world)
        assert recorder.buffers["ticks"].count == 6
        assert _log(tmp_path / "run") == []


@pytest.mark.parametrize("value", [0, -1.0, float("nan"), True, "1"])
def test_an_invalid_time(value):
    with pytest.raises((ArgumentError, TypeError, ValueError), match="flush_every"):
        Recording(flush_every=value)  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_record_opens_while_bodies_come(world, client, tmp_path, monkeypatch):
    """A body that comes while the models are read is in none of them."""
    run, read = tmp_path / "run", FolderRun.read
    with ssduck.Interpreter(recording=None) as ss:
        recorder = _started(ss, world, run, flush_every=NEVER)
        _tick(recorder, world)
        recorder.flush()
        before = {entity.name for entity in world}

        def while_bodies_come(opened, table):
            rows = read(opened, table)
            if table == "models/entities":
                sphere(client, [0, 0, 5])
                _tick(recorder, world)
                recorder.flush()
            return rows

        monkeypatch.setattr(FolderRun, "read", while_bodies_come)
        with ssduck.open(run) as copy:
            assert {entity.name for entity in copy.call_variable("lab")} == before
            models = copy.sql("SELECT name FROM entities_model").fetchall()
            assert {name for (name,) in models} == before
        assert len({entity.name for entity in world}) == len(before) + 1
