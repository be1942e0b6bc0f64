"""Ctrl-C in a call of `export` or `write_record`: nothing is left, or the whole."""

import inspect
import math
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

import ssduck
from ssduck.database import database
from ssduck.interchange import record_writer
from ssduck.interpreter import recording
from ssduck.recording import folder_recording as exporting
from ssduck.recording.stores import parquet
from tests.support.cases import sampled
from tests.support.presser import Presser

POSES = {"cup": [[0, 0, 1], [0, 0, 2]]}
# The modules at lines of which Ctrl-C is pressed: those that begin and end an episode.
MODULES = (exporting, record_writer, recording)
# At so many lines, spread over a call, and at the last ones.
SPREAD, LAST = 6, 8
PLACES = tuple(inspect.getfile(module) for module in MODULES)


def write(place, **options):
    ssduck.write_record(place, ["cup"], POSES, [0.0, 0.1], **options)


@pytest.fixture
def record(tmp_path):
    write(tmp_path / "record", world="lab")
    return tmp_path / "record"


@pytest.fixture(autouse=True)
def handler():
    kept = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, kept)


def files_in(place):
    return {file: file.read_bytes() for file in place.rglob("*") if file.is_file()}


def _export(record, folder):
    with ssduck.open(record) as ss:
        ss.export(folder)


def _write(_, folder):
    write(folder, world="lab")


Call = Callable[[Path, Path], None]


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
