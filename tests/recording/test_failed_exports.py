"""An export that fails or that Ctrl-C ends leaves nothing, or the whole, and all of others."""

import errno
import inspect
import math
import signal
from pathlib import Path

import pytest

import ssduck
from ssduck.database import database
from ssduck.errors import ArgumentError, RecordError
from ssduck.interchange import record_writer
from ssduck.interpreter import recording
from ssduck.recording import folder_check, folder_episodes, folder_recording
from ssduck.recording.stores import parquet
from ssduck.recording.stores.parquet import ParquetStore
from tests.support.cases import sampled
from tests.support.presser import Presser


def recorded(place, episodes=1):
    for height in range(episodes):
        poses = {"cup": [0, 0, height], "pot": [1, 0, height]}
        ssduck.write_record(place, ["cup", "pot"], poses, [0.0, 0.1], world="lab")
    return place


def files_in(place):
    return {file: file.read_bytes() for file in place.rglob("*") if file.is_file()}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["run.mcap", "run.rrd"])
def test_the_name_of_a_file_of_another_format_is_an_error(tmp_path, name):
    with (
        ssduck.open(recorded(tmp_path / "record")) as ss,
        pytest.raises(ArgumentError, match=f"export RECORD --format {Path(name).suffix[1:]} "),
    ):
        ss.export(tmp_path / name)
    assert not (tmp_path / name).exists()


@pytest.mark.slow
def test_of_several_worlds_all_are_exported_or_none(tmp_path, monkeypatch):
    export, exported = database.export, []

    def second_fails(*arguments):
        if exported:
            raise RecordError("the disk is full")
        exported.append(export(*arguments))
        return exported[0]

    monkeypatch.setattr(database, "export", second_fails)
    with ssduck.load("hall") as ss:
        ss.add_variable("other", ssduck.load("hall").call_variable("hall"))
        ss.record("other", ssduck.Recording())
        with pytest.raises(RecordError, match="the disk is full"):
            ss.export(tmp_path / "new")
    assert exported
    assert not (tmp_path / "new").exists()


@pytest.mark.slow
def test_pairs_that_cannot_be_written_leave_no_episode(tmp_path, monkeypatch):
    def fails(*_):
        raise RecordError("the disk is full")

    monkeypatch.setattr(recording, "write_pairs", fails)
    with ssduck.load("hall") as ss, pytest.raises(RecordError, match="the disk is full"):
        ss.export(tmp_path / "new", pairs=0.1)
    assert not (tmp_path / "new").exists()


def no_room(*_, **__):
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "name"),
    [
        *((ParquetStore, name) for name in ("add_members", "add", "finish")),
        (folder_episodes, "create_file"),
        (parquet, "change_description"),
        (parquet, "write_parquet"),
    ],
)
def test_a_full_disk_leaves_no_folder_and_others_as_they_were(tmp_path, monkeypatch, place, name):
    record, other = (recorded(tmp_path / folder) for folder in ("record", "other"))
    before = files_in(other)

    def fails(*_):
        raise RecordError("No space left")

    monkeypatch.setattr(place, name, fails if place is ParquetStore else no_room)
    for folder in (tmp_path / "out", tmp_path / "new" / "out", other):
        with ssduck.open(record) as ss, pytest.raises(RecordError, match="No space left"):
            ss.export(folder)
        if place is not ParquetStore:
            with pytest.raises(RecordError, match="No space left"):
                recorded(folder)
    assert sorted(tmp_path.iterdir()) == [other, record]
    assert files_in(other) == before


def test_a_full_disk_leaves_folders_of_others(tmp_path, monkeypatch):
    (tmp_path / "out").mkdir()
    monkeypatch.setattr(folder_episodes, "create_file", no_room)
    with pytest.raises(RecordError, match="No space left"):
        recorded(tmp_path / "out")
    assert (tmp_path / "out").is_dir()


@pytest.mark.parametrize("name", ["set_aside", "write_json"])
def test_a_repair_on_a_full_disk_is_an_error(tmp_path, monkeypatch, name):
    record = recorded(tmp_path / "record", 2)
    (record / "entities/world=lab/episode=1/part-000000.parquet").write_bytes(b"torn")
    before = files_in(record)
    monkeypatch.setattr(folder_check, name, no_room)
    with pytest.raises(RecordError, match="record cannot be repaired: No space left on device"):
        ssduck.check(record, repair=True)
    if name == "write_json":  # it comes first
        assert files_in(record) == before


# -- Ctrl-C ----------------------------------------------------------------------------------------

POSES = {"cup": [[0, 0, 1], [0, 0, 2]]}
# The modules at lines of which Ctrl-C is pressed: those that begin and end an episode.
MODULES = (folder_recording, record_writer, recording)
# At so many lines, spread over a call, and at the last ones.
SPREAD, LAST = 6, 8
PLACES = tuple(inspect.getfile(module) for module in MODULES)


def write(place, **options):
    ssduck.write_record(place, ["cup"], POSES, [0.0, 0.1], **options)


@pytest.fixture
def record(tmp_path):
    write(tmp_path / "record", world="lab")
    return tmp_path / "record"


def _export(record, folder):
    with ssduck.open(record) as ss:
        ss.export(folder)


def _write(_, folder):
    write(folder, world="lab")


def pressed(call, record, folder, line):
    """Presses Ctrl-C at a line of a call; returns the number of lines until it came."""
    with Presser(line, places=PLACES) as presser:
        try:
            call(record, folder)
        except KeyboardInterrupt:
            pass
        else:
            assert presser.count < line
    return presser.count


@pytest.mark.slow
@pytest.mark.parametrize("call", [_export, _write])
@sampled("has_others", [False, True], ids=["a new folder", "a record"], every=2)
def test_nothing_is_left_or_the_whole(record, tmp_path, call, has_others):
    count = pressed(call, record, tmp_path / "whole", math.inf)
    whole = ssduck.episodes(tmp_path / "whole")
    assert count > 50
    last = range(count - LAST, count + 1)
    for line in (*range(1, last.start, count // SPREAD), *last):
        folder = tmp_path / "a" / str(line)
        if has_others:
            write(folder, world="other")
        before = files_in(folder)
        pressed(call, record, folder, line)
        if files_in(folder) == before:
            assert has_others or not folder.exists()
        else:
            made = [one for one in ssduck.episodes(folder) if one.world == "lab"]
            assert [(e.ticks, e.complete) for e in made] == [(e.ticks, e.complete) for e in whole]
            assert ssduck.check(folder) == []
            assert not [place for place in folder.rglob("*") if place.name.startswith(".")]
        assert not list(folder.parent.glob(".*"))


def then_pressed(function):
    """Returns the function, after which Ctrl-C comes before its caller has the value."""

    def called(*arguments, **options):
        value = function(*arguments, **options)
        signal.raise_signal(signal.SIGINT)
        return value

    return called


@pytest.mark.parametrize("call", [_export, _write])
def test_an_episode_that_has_just_begun_is_removed(record, tmp_path, monkeypatch, call):
    monkeypatch.setattr(parquet, "begin_episode", then_pressed(parquet.begin_episode))
    before = files_in(tmp_path)
    for folder in (tmp_path / "new", tmp_path / "record"):
        with pytest.raises(KeyboardInterrupt):
            call(record, folder)
        assert files_in(tmp_path) == before
        assert {place.name for place in tmp_path.iterdir()} == {"record"}


@pytest.mark.slow
def test_an_episode_is_not_left_without_its_pairs(record, tmp_path, monkeypatch):
    """Nor the first one of several worlds."""
    monkeypatch.setattr(database, "export", then_pressed(database.export))
    before = files_in(record)
    with ssduck.open(record) as ss:
        for folder in (tmp_path / "new", record):
            with pytest.raises(KeyboardInterrupt):
                ss.export(folder, pairs=0.1)
    assert files_in(record) == before
    assert not (tmp_path / "new").exists()
