"""A failed export leaves nothing, and takes nothing of others away."""

import errno
from pathlib import Path

import pytest

import ssduck
from ssduck.database import database
from ssduck.errors import ArgumentError, RecordError
from ssduck.interpreter import recording
from ssduck.recording import folder_check, folder_episodes
from ssduck.recording.stores import parquet
from ssduck.recording.stores.parquet import ParquetStore


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
@pytest.mark.parametrize("method", ["add_members", "add", "finish"])
def test_an_export_that_fails_leaves_nothing(tmp_path, monkeypatch, method):
    other = recorded(tmp_path / "other")
    before = files_in(other)

    def fails(*_):
        raise RecordError("the disk is full")

    with ssduck.open(recorded(tmp_path / "record")) as ss, monkeypatch.context() as patch:
        patch.setattr(ParquetStore, method, fails)
        for place in (tmp_path / "a" / "new", other):
            with pytest.raises(RecordError, match="the disk is full"):
                ss.export(place)
    assert not (tmp_path / "a").exists()
    assert files_in(other) == before


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
@pytest.mark.parametrize("name", ["create_file", "change_description", "write_parquet"])
@pytest.mark.parametrize("new", ["out", "new/out"])
def test_a_full_disk_leaves_no_folder(tmp_path, monkeypatch, name, new):
    record = recorded(tmp_path / "record")
    monkeypatch.setattr(folder_episodes if name == "create_file" else parquet, name, no_room)
    with ssduck.open(record) as ss, pytest.raises(RecordError, match="No space left"):
        ss.export(tmp_path / new)
    with pytest.raises(RecordError, match="No space left"):
        recorded(tmp_path / new)
    assert list(tmp_path.iterdir()) == [record]


def test_a_full_disk_leaves_folders_of_others(tmp_path, monkeypatch):
    (tmp_path / "out").mkdir()
    monkeypatch.setattr(folder_episodes, "create_file", no_room)
    with pytest.raises(RecordError, match="No space left"):
        recorded(tmp_path / "out")
    assert (tmp_path / "out").is_dir()


def test_a_repair_on_a_full_disk_is_an_error(tmp_path, monkeypatch):
    record = recorded(tmp_path / "record", 2)
    (record / "entities/world=lab/episode=1/part-000000.parquet").write_bytes(b"torn")
    before = files_in(record)
    monkeypatch.setattr(folder_check, "write_json", no_room)
    with pytest.raises(RecordError, match="record cannot be repaired: No space left on device"):
        ssduck.check(record, repair=True)
    assert files_in(record) == before
