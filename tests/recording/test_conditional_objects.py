"""Several processes that write to one object of a store: nothing of theirs is lost."""

from __future__ import annotations

import sys

import pytest

import ssduck
from ssduck.errors import RecordError
from ssduck.recording import folder_episodes
from ssduck.recording.stores import descriptions, object_store
from ssduck.recording.stores.object_store import ObjectPath, change_object, create_object
from ssduck.recording.stores.parquet import write_tags
from ssduck.recording.stores.parquet_layout import FolderRun
from tests.support.s3_server import s3_server

pytest.importorskip("moto.server", reason="moto, a local S3 server, is missing")
pytest.importorskip("boto3", reason="the extra s3 is not installed")

POSES = {"cup": [[0.0, 0.0, 1.0]] * 3}


@pytest.fixture(scope="module", autouse=True)
def server():
    with s3_server("lake"):
        yield


@pytest.fixture(autouse=True)
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
def test_tags_of_two_processes(monkeypatch):
    run = episode("s3://lake/two")
    reads = others_write(monkeypatch, run, ["a", "b"])
    write_tags(run, {"own": 1.5})
    assert reads() == 3  # it was changed twice meanwhile
    (found,) = ssduck.episodes("s3://lake/two")
    assert found.tags == {"task": "pick", "a": True, "b": True, "own": 1.5}


@pytest.mark.slow
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
