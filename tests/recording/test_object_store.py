"""Records in an object store: a local S3 server, on the loopback."""

import json
import sys
from pathlib import Path

import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.errors import RecordError
from ssduck.interchange.lerobot import write_dataset
from ssduck.interchange.motion import motion_of
from ssduck.recording import folder_episodes
from ssduck.recording.folder_episodes import runs_in
from ssduck.recording.paths import expand_path, is_record
from ssduck.recording.stores import descriptions, object_store, parquet
from ssduck.recording.stores.object_store import ObjectPath, change_object, create_object
from ssduck.recording.stores.parquet import write_tags
from ssduck.recording.stores.parquet_layout import FolderRun
from tests.support.command_line import answer, ssduck_, write_scene
from tests.support.forged import flip_bit
from tests.support.recorded import ALL, PAST, end_part, lively, rows
from tests.support.s3_server import s3_server

pytest.importorskip("moto.server", reason="moto, a local S3 server, is missing")
for library in ("fsspec", "boto3"):
    pytest.importorskip(library, reason="the extra s3 is not installed")


@pytest.fixture(scope="module", autouse=True)
def server():
    with s3_server("lake") as address:
        yield address


@pytest.fixture(scope="module")
def places(server, tmp_path_factory):
    """The same run, recorded to the store and to a folder, in several parts and a log."""
    local, remote = tmp_path_factory.mktemp("store") / "run", "s3://lake/a b/run"
    client = pybullet.connect(pybullet.DIRECT)
    with ssduck.Interpreter(recording=None) as ss:
        world = ss.add_variable("lab", ssduck.World.attach(client, names=lively(client)))
        with (
            ss.record_to(remote, recording=ALL, tags={"task": "drop"}) as first,
            ss.record_to(local, recording=ALL, tags={"task": "drop"}) as second,
        ):
            for _ in range(3):
                world.step(16)
                end_part(first)
                end_part(second)
            world.step(3)
    pybullet.disconnect(client)
    return remote, local


def names(place):
    return {str(file)[len(str(place)) :] for file in _files(place)}


def _files(place):
    if isinstance(place, ObjectPath):
        from pyarrow.fs import FileSelector

        found = object_store.file_system().get_file_info(FileSelector(place.key, recursive=True))
        return [ObjectPath(f"s3://{one.path}") for one in found if one.is_file]
    return [file for file in place.rglob("*") if file.is_file()]


def test_the_same_files_are_there(places):
    remote, local = places
    assert names(expand_path(remote)) == names(local)
    assert "/ticks/world=lab/episode=0/part-000003.parquet" in names(local)


@pytest.mark.long
def test_the_same_rows_and_answers(places):
    remote, local = places
    programs = [
        "SELECT id, z, tick FROM lab{} AS list;",
        "SELECT tick(a.this), clearance(a.this, b.this) FROM a=lab{}, b=lab{} "
        "WHERE tick(a.this) == tick(b.this) AND id(a.this) == 'ball' AND id(b.this) == 'board' AS list;",
        "SELECT id FROM lab{0.1} WHERE above(lab{0.1}.board, this) AS list;",
        "SELECT tick FROM lab{} WHERE collides(this, lab.board) AS list;",
        "SELECT id(a.this), id(b.this) FROM a=lab, b=lab WHERE inContact(a.this, b.this) AS list;",
    ]
    with ssduck.open(remote) as there, ssduck.open(local) as here:
        for table in PAST:
            assert rows(there, table) == rows(here, table)
        for program in programs:
            assert there.eval(program) == here.eval(program) != []
    (episode,) = ssduck.episodes(remote)
    (other,) = ssduck.episodes(local)
    assert (episode.ticks, episode.tags, episode.complete) == (other.ticks, other.tags, True)
    assert str(episode.path) == remote
    assert ssduck.check(remote) == []


@pytest.mark.long
def test_a_running_recording_is_read_with_its_log(client, server):
    place = "s3://lake/running"
    recording = ssduck.Recording(flush_every=0.02)
    with ssduck.Interpreter(recording=None) as ss:
        world = ss.add_variable("lab", ssduck.World.attach(client, names=lively(client)))
        with ss.record_to(place, recording=recording) as running:
            while not list(_logs(place)):
                world.step()
            with ssduck.open(place) as there:
                assert len(there.past("lab").ticks) >= 1
            last = running.flush()
            with ssduck.open(place) as there:
                assert there.past("lab").ticks[-1] == last
            assert end_part(running) == last
            assert not list(_logs(place))
            with ssduck.open(place) as there:
                assert there.past("lab").ticks[-1] == last
            assert ssduck.episodes(place)[0].complete is False


def _logs(place):
    return [file for file in _files(expand_path(place)) if "/log/" in str(file)]


@pytest.mark.slow
def test_exports_to_the_store_and_from_it(places, tmp_path):
    remote, local = places
    with ssduck.open(local) as ss:
        ss.export("s3://lake/exported", entities=["board", "ball"], start=0.05)
        query = "SELECT * FROM entities_history WHERE name IN ('board', 'ball') AND time > 0.049"
        expected = ss.sql(query).fetchall()
    with ssduck.open("s3://lake/exported") as ss:
        assert rows(ss, "entities_history") == sorted(expected)
        ss.export(tmp_path / "back")
    assert ssduck.episodes(tmp_path / "back")[0].tags == {"task": "drop"}
    with ssduck.open(remote) as ss, pytest.raises(ssduck.SelectScriptError, match="nobody"):
        ss.export("s3://lake/failed", entities=["nobody"])
    assert not expand_path("s3://lake/failed").exists()


@pytest.mark.slow
def test_an_export_that_fails_leaves_no_episode(places, monkeypatch):
    def fail(*_, **__):
        raise OSError(28, "no room")

    with ssduck.open(places[1]) as ss, monkeypatch.context() as patch:
        patch.setattr(parquet.ParquetStore, "complete", fail, raising=False)
        patch.setattr(parquet.ParquetStore, "add", fail)
        with pytest.raises(OSError, match="no room"):
            ss.export("s3://lake/broken")
    assert runs_in(expand_path("s3://lake/broken")) == []


@pytest.mark.long
@pytest.mark.filterwarnings("default")  # the commands write them
def test_the_commands_take_addresses(places, tmp_path):
    remote, _ = places
    assert "task=drop" in answer("episodes", remote)
    asked = ["query", remote, "SELECT id FROM lab WHERE isSphere(this) AS list;", "-F", "json"]
    assert json.loads(answer(*asked)) == ["ball", "other"]
    answer("export", remote, "-o", "s3://lake/by-command", "--entities", "ball")
    assert answer("check", "s3://lake/by-command") == "s3://lake/by-command is intact\n"
    scene = str(write_scene(tmp_path) / "two.toml")
    answer("record", scene, "--seconds", "0.02", "--tables", "entities", "-o", "s3://lake/k")
    assert ssduck.episodes("s3://lake/k")[0].ticks == 3
    poses = write_dataset(tmp_path / "d", [motion_of(runs_in(expand_path(remote))[0])])
    told = ssduck_("import", str(poses), "-o", "s3://lake/imported").stdout
    (imported,) = ssduck.episodes("s3://lake/imported")
    assert told == f"{imported.ticks} ticks of 'lab': episode 0 in s3://lake/imported\n"


@pytest.mark.slow
def test_damaged_and_missing_objects_are_errors(places):
    with ssduck.open(places[1]) as ss:
        ss.export("s3://lake/damaged")
    part = expand_path("s3://lake/damaged/entities/world=lab/episode=0/part-000000.parquet")
    flip_bit(part, 0.1)
    with (
        pytest.raises(RecordError, match=r"s3://lake/damaged/entities.*its checksum is wrong"),
        ssduck.open("s3://lake/damaged") as ss,
    ):
        ss.sql("SELECT sum(z) FROM entities_history")
    (damage,) = ssduck.check("s3://lake/damaged")
    assert str(damage.file) == str(part)
    part.unlink()
    with pytest.raises(RecordError, match=r"part-000000\.parquet is missing"):
        ssduck.open("s3://lake/damaged")
    with pytest.raises(RecordError, match="there is no record s3://lake/nothing"):
        ssduck.open("s3://lake/nothing")
    with pytest.raises(RecordError, match="cannot be written"):
        ssduck.write_record("s3://no-such-bucket/r", ["a"], np.zeros((1, 1, 3)), [0])


@pytest.mark.slow
def test_strict_limits_read_the_record_and_nothing_else(places):
    remote, _ = places
    with ssduck.open(remote, limits=ssduck.Limits.strict(require=())) as ss:
        assert ss.eval("SELECT id FROM lab{0.1} WHERE above(lab{0.1}.board, this) AS list;") != []
        assert ss.sql("SELECT count(*) FROM lab.entities_history").fetchone()[0] > 0
        for other in ("s3://lake/written/ticks/world=lab/episode=0/part-000000.parquet",):
            with pytest.raises(ssduck.SelectScriptError):
                ss.sql(f"SELECT * FROM read_parquet('{other}')")


@pytest.mark.slow
def test_without_fsspec_the_error_says_what_to_install(places, monkeypatch):
    monkeypatch.setitem(sys.modules, "fsspec.implementations.arrow", None)
    with pytest.raises(ssduck.SelectScriptError, match=r"pip install 'ssduck\[s3\]'"):
        ssduck.open(places[0])


# -- addresses as paths -------------------------------------------------------------------------


def test_an_address_is_a_path():
    path = expand_path("s3://bucket/a/run")
    assert isinstance(path, ObjectPath)
    assert str(path / "x" / "y.json") == "s3://bucket/a/run/x/y.json"
    assert str((path / "x").with_name("z").parent) == "s3://bucket/a/run"
    assert expand_path(Path("s3://bucket/a/run")) == path == expand_path(path)
    assert hash(path) == hash(expand_path("s3://bucket/a/run"))
    assert path != Path("s3:/bucket/a/run")
    assert path.absolute() == path.resolve() == path
    assert repr(path) == "ObjectPath('s3://bucket/a/run')"
    assert is_record("s3://bucket/a/run")
    assert not isinstance(expand_path("s3/bucket"), ObjectPath)
    assert not isinstance(expand_path("./s3:/x"), ObjectPath)


@pytest.mark.slow
def test_objects_are_listed_and_read(server):
    place = ObjectPath("s3://lake/plain")
    assert (place.exists(), place.is_dir(), place.is_file()) == (False, False, False)
    assert list(place.iterdir()) == []
    (place / "a.txt").write_bytes(b"one")
    (place / "deep" / "b.bin").write_bytes(b"two!")
    assert sorted(entry.name for entry in place.iterdir()) == ["a.txt", "deep"]
    assert [entry.name for entry in place.glob("*.txt")] == ["a.txt"]
    assert (place.is_dir(), (place / "a.txt").is_file(), (place / "deep").is_dir()) == (True,) * 3
    assert (place / "deep/b.bin").stat().st_size == 4
    (place / "a.txt").rename(place / "c.txt")
    assert (place / "c.txt").read_bytes() == b"one"
    with pytest.raises(FileNotFoundError):
        (place / "a.txt").read_bytes()
    with pytest.raises(FileNotFoundError):
        (place / "a.txt").stat()
    (place / "a.txt").unlink(missing_ok=True)
    object_store.remove_tree(place)
    assert not place.exists()


@pytest.mark.long
def test_a_repair_renames_what_is_damaged(server):
    place = "s3://lake/torn"
    for height in (1.0, 2.0):
        ssduck.write_record(place, ["cup"], {"cup": [[0, 0, height]]}, [0.0], world="lab")
    about = ObjectPath(f"{place}/ssduck.json")
    with about._store.open_output_stream(about.key) as stream:
        stream.write(b'{"x":')
    (damage,) = ssduck.check(place, repair=True)
    assert damage.is_repaired
    assert not ssduck.check(place)
    assert "ssduck.json.damaged" in {file.name for file in ObjectPath(place).iterdir()}


# -- several processes that write to one object ---------------------------------------------------

POSES = {"cup": [[0.0, 0.0, 1.0]] * 3}


@pytest.fixture
def _no_pauses(monkeypatch):
    monkeypatch.setattr(object_store, "_PAUSE", 0.0)


def episode(place):
    ssduck.write_record(place, ["cup"], POSES, [0, 1, 2], world="lab", tags={"task": "pick"})
    return FolderRun(ObjectPath(place), "lab", 0)


def others_write(monkeypatch, run, names):
    """Lets others tag an episode between our reading and our writing; returns how often we read."""
    original, reads = descriptions.checked_description, [0]

    def read(content, source):
        reads[0] += 1
        if names:
            name = names.pop(0)
            left, names[:] = list(names), []  # the other one is not disturbed
            write_tags(run, {name: True})
            names[:] = left
            reads[0] -= 1
        return original(content, source)

    monkeypatch.setattr(descriptions, "checked_description", read)
    return lambda: reads[0]


@pytest.mark.slow
@pytest.mark.usefixtures("_no_pauses")
def test_tags_of_two_processes(monkeypatch):
    run = episode("s3://lake/two")
    reads = others_write(monkeypatch, run, ["a", "b"])
    write_tags(run, {"own": 1.5})
    assert reads() == 3  # it was changed twice meanwhile
    (found,) = ssduck.episodes("s3://lake/two")
    assert found.tags == {"task": "pick", "a": True, "b": True, "own": 1.5}


@pytest.mark.slow
@pytest.mark.usefixtures("_no_pauses")
def test_an_object_that_others_change_each_time_is_an_error(monkeypatch):
    run = episode("s3://lake/busy")
    monkeypatch.setattr(object_store, "ATTEMPTS", 3)
    others_write(monkeypatch, run, ["a", "b", "c"])
    with pytest.raises(RecordError, match="was changed by others 3 times"):
        write_tags(run, {"own": 1.5})
    (found,) = ssduck.episodes("s3://lake/busy")
    assert found.tags == {"task": "pick", "a": True, "b": True, "c": True}


@pytest.mark.long
def test_two_recordings_begin_at_the_same_time(monkeypatch):
    # Both find that number 0 is free.
    monkeypatch.setattr(folder_episodes, "_free_number", lambda *_: 0)
    for number in range(3):
        written = ssduck.write_record("s3://lake/both", ["cup"], POSES, [0, 1, 2], world="lab")
        assert written.number == number
    assert [one.number for one in ssduck.episodes("s3://lake/both")] == [0, 1, 2]


@pytest.mark.slow
def test_objects_are_created_once_and_changed():
    place = ObjectPath("s3://lake/a b/one[1]%20.txt")
    with pytest.raises(FileNotFoundError, match="the store says"):
        change_object(place, bytes.upper)
    assert create_object(place, b"first")
    assert not create_object(place, b"second")
    change_object(place, bytes.upper)
    assert place.read_bytes() == b"FIRST"
    with pytest.raises(OSError, match="the store says"):
        create_object(ObjectPath("s3://no-such-bucket/one"), b"first")


def test_without_boto3(monkeypatch):
    monkeypatch.setitem(sys.modules, "botocore.exceptions", None)
    with pytest.raises(RecordError, match=r"needs boto3: pip install 'ssduck\[s3\]'"):
        ssduck.write_record("s3://lake/none", ["cup"], POSES, [0, 1, 2], world="lab")
    assert not ObjectPath("s3://lake/none").exists()
