"""A record of many parts: a tick is read from one part."""

import shutil

import pybullet
import pytest

import ssduck
from ssduck import Recording
from ssduck.database import worlds
from ssduck.errors import RecordError
from ssduck.recording.stores import parquet, parquet_archive, parquet_layout
from ssduck.recording.stores.descriptions import read_description
from ssduck.recording.stores.files import write_json
from tests.support.bodies import solid
from tests.support.forged import flip_bit

PARTS = 10
PLACE = "world=lab/episode={}"


@pytest.fixture
def run(tmp_path, monkeypatch, archive):
    """A record of two episodes of ten parts of two ticks."""
    for module in (parquet, worlds):
        monkeypatch.setattr(module, "PART_TICKS", 2)
    return archive.copy(write_parts, tmp_path / "run")


def add_ball(client):
    solid(client, pybullet.GEOM_SPHERE, 1, radius=0.1)
    pybullet.setGravity(0, 0, -9.81, physicsClientId=client)


def write_parts(place):
    client = pybullet.connect(pybullet.DIRECT)
    add_ball(client)
    recording = Recording(tables=("entities",), flush_every=None)
    for _ in range(2):
        world = ssduck.World.attach(client, name="lab")
        with ssduck.Interpreter(recording=None) as ss:
            ss.add_variable("lab", world)
            with ss.record_to(place, recording=recording):
                for _ in range(2 * PARTS - 1):
                    world.step()
    pybullet.disconnect(client)


class Reads:
    """Has the names of the files whose rows are read."""

    def __init__(self, monkeypatch):
        self.rows = []
        rows_of = parquet_archive._rows_of_ticks

        def rows(file, *arguments):
            self.rows.append(file.name)
            return rows_of(file, *arguments)  # type: ignore[arg-type]

        monkeypatch.setattr(parquet_archive, "_rows_of_ticks", rows)


def _ticks(run):
    with ssduck.open(run) as ss:
        ticks = ss.past("lab").ticks
        assert ss.past("lab").times == pytest.approx([(tick - 1) / 240 for tick in ticks])
        return ticks


ALL = list(range(1, 2 * PARTS + 1))


def test_parts_that_are_removed_do_not_count(run):
    for part in (8, 9):
        (run / "ticks" / PLACE.format(1) / f"part-{part:06d}.parquet").unlink()
    with pytest.raises(RecordError, match="was closed with 10 parts"):
        _ticks(run)
    about = run / "episodes" / "lab-1.json"  # as at a kill
    description = read_description(about)
    del description["parts"]
    write_json(description, about)
    assert _ticks(run) == ALL[:16]


@pytest.fixture
def checks(monkeypatch):
    """The files that are checked; a record has many parts if it has two."""
    monkeypatch.setattr(parquet_archive, "MANY_PARTS", 2)
    read = []
    check = parquet_layout.FolderRun.check_data

    def counted(run, table, numbers):
        for number in numbers:
            read.append(f"{table} {number}")
            check(run, table, [number])

    monkeypatch.setattr(parquet_layout.FolderRun, "check_data", counted)
    return read


def test_few_ticks_are_read_from_few_parts_which_are_checked_then(run, checks, monkeypatch):
    with ssduck.open(run) as ss:
        record = ss._database.records["lab"]
        reads = Reads(monkeypatch)
        assert checks == []
        assert record.fetch("entities", 7, 8)["tick"].to_pylist() == [7, 8]
        assert reads.rows == ["part-000003.parquet"]
        assert record.fetch("entities", 8, 9)["tick"].to_pylist() == [8, 9]
        assert reads.rows[1:] == ["part-000003.parquet", "part-000004.parquet"]
        assert checks == ["entities 3", "entities 4"]
        ss.eval("SELECT id FROM lab{} AS list;")
        assert sorted(checks) == sorted(f"entities {part}" for part in range(PARTS))


def _at(ss, time, selected="tick"):
    """Returns the rows of a tick, by a program that is the same for all ticks."""
    ss.add_variable("T", time)
    return ss.eval(f"SELECT {selected} FROM lab{{T}} AS list;")


@pytest.mark.slow
def test_a_question_about_a_tick_checks_the_group_of_its_part(run, checks):
    """Ten parts are groups of three; any other statement has all of them checked."""
    with ssduck.open(run) as ss:
        times = ss.past("lab").times
        assert _at(ss, times[6]) == [7]
        assert sorted(checks) == [f"entities {part}" for part in (3, 4, 5)]
        checks.clear()
        assert [_at(ss, time)[0] for time in times[6:12]] == list(range(7, 13))  # prepared, too
        assert checks == []
        assert _at(ss, times[-1]) == [20]
        assert checks == ["entities 9"]
        checks.clear()
        join = "body = lab.body_0; SELECT tick FROM lab{T} WHERE z(body) <= z(this) AS list;"
        assert ss.eval(join) == [20]
        rest = [f"entities {part}" for part in (0, 1, 2, 6, 7, 8)]
        assert sorted(name for name in checks if name.startswith("entities")) == rest
        checks.clear()
        assert ss.sql("SELECT count(*) FROM entities_history").fetchone() == (20,)
        assert checks == []


@pytest.mark.slow
def test_a_damaged_part_is_in_no_answer(run, checks):
    """An error at the ticks of its group, and of whatever reads all ticks."""
    file = run / "entities" / PLACE.format(1) / "part-000007.parquet"
    flip_bit(file, 1 / 3)
    with ssduck.open(run) as ss:
        times = ss.past("lab").times
        for _ in range(2):
            assert [_at(ss, times[n]) for n in (0, 1, 8, 19)] == [[1], [2], [9], [20]]
            for n in (13, 14, 15):
                with pytest.raises(RecordError, match=r"part-000007.parquet .*checksum is wrong"):
                    _at(ss, times[n])
            with pytest.raises(RecordError, match=r"part-000007.parquet .*checksum is wrong"):
                ss.sql("SELECT count(*) FROM entities_history")
            with pytest.raises(RecordError, match=r"part-000007.parquet .*checksum is wrong"):
                ss.eval("SELECT tick FROM lab{} AS list;")


@pytest.mark.slow
def test_answers_about_a_tick_are_those_of_all(run, checks):
    with ssduck.open(run) as ss:
        found = [_at(ss, time, "z(this)") for time in ss.past("lab").times]
        whole = ss.sql("SELECT z FROM entities_history ORDER BY tick").fetchall()
    assert found == [[z] for (z,) in whole]


@pytest.mark.slow
def test_the_log_of_a_record_of_many_parts_is_read(run, checks, client):
    place, copy = run / "running", run / "copy"
    add_ball(client)
    world = ssduck.World.attach(client, name="lab")
    recording = Recording(tables=("entities",), flush_every=None)
    with ssduck.Interpreter(recording=None) as ss:
        ss.add_variable("lab", world)
        with ss.record_to(place, recording=recording) as writing:
            world.step(2 * PARTS)
            writing.flush()
            shutil.copytree(place, copy)
    assert len(list((copy / "log").rglob("*.arrow"))) == 1
    checks.clear()
    with ssduck.open(copy) as ss:
        times = ss.past("lab").times
        assert [_at(ss, times[n]) for n in (4, 20, 5)] == [[5], [21], [6]]
        assert set(checks) == {f"entities {part}" for part in (0, 1, 2)}


@pytest.mark.slow
def test_parts_of_other_ticks_are_not_read(run, checks):
    """Of another group DuckDB reads the first file, for its columns; the others may be anything."""
    other = run / "entities" / PLACE.format(1) / "part-000007.parquet"
    with ssduck.open(run) as ss:
        assert ss.eval("SELECT tick FROM lab{} AS list;") == ALL
        other.write_bytes(b"no Parquet file")
        times = [time for time in ss.past("lab").times if time < 0.03]
        for tick, time in enumerate(times, 1):
            ss.add_variable("T", time)
            assert ss.eval("SELECT tick FROM lab{T} AS value;") == tick
        assert len(times) > 5
        with pytest.raises(RecordError, match=other.name):
            ss.eval("SELECT tick FROM lab{} AS list;")


def test_missing_parts_are_noticed_at_once(run, checks):
    (run / "entities" / PLACE.format(1) / "part-000004.parquet").unlink()
    with pytest.raises(RecordError, match=r"part-000004.parquet is missing"):
        ssduck.open(run)
    assert checks == []


def test_swapped_parts_are_noticed_when_they_are_read(run, checks):
    parts = [run / "entities" / PLACE.format(1) / f"part-00000{n}.parquet" for n in (2, 5)]
    shutil.move(parts[0], run / "other")
    shutil.move(parts[1], parts[0])
    shutil.move(run / "other", parts[1])
    with ssduck.open(run) as ss:
        record = ss._database.records["lab"]
        assert record.fetch("entities", 1, 2)["tick"].to_pylist() == [1, 2]
        assert checks == ["entities 0"]
        with pytest.raises(RecordError, match=r"part-000002.parquet is another part"):
            record.fetch("entities", 5, 6)
        with pytest.raises(RecordError, match=r"part-000002.parquet is another part"):
            ss.sql("SELECT count(*) FROM lab.entities_history")
