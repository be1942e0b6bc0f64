"""Links beside a DuckDB file, of the names that DuckDB writes to: nothing goes through them."""

import os
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

import ssduck
from ssduck.database import writer
from ssduck.database.instances import log_of
from ssduck.errors import RecordError, SelectScriptError, SqlError

LOGS = (".wal", ".wal.checkpoint", ".wal.recovery")
# A program that records, and ends as by a crash: what it has stored is in the log.
CRASH = """
import os, sys, ssduck
ss = ssduck.load("chaos", sys.argv[1])
ss["chaos"].step(3)
ss.flush()
os._exit(0)
"""


@pytest.fixture
def file(small_records, tmp_path):
    return Path(shutil.copy(small_records / "file.duckdb", tmp_path / "run.duckdb"))


def crash(folder):
    subprocess.run([sys.executable, "-c", CRASH, folder / "other.duckdb"], check=True)


@pytest.fixture(params=["a text", "a log", "nothing"])
def victim(request, tmp_path, archive):
    """A file of the user; the log that a crash has left of another file, or nothing."""
    place = tmp_path / "victim"
    if request.param == "a text":
        place.write_text("my thesis")
    elif request.param == "a log":
        shutil.copy(archive.copy(crash, tmp_path / "crashed") / "other.duckdb.wal", place)
    return place


def content(place):
    return place.read_bytes() if place.exists() else None


def _record(file):
    with ssduck.load("chaos", file) as ss:
        ss["chaos"].step(5)


def _open(file):
    ssduck.open(file).close()


DOORS = (_record, _open, ssduck.episodes, ssduck.check, partial(ssduck.check, repair=True))


@pytest.mark.parametrize("ending", LOGS)
def test_no_log_is_reached_by_a_link(file, victim, ending):
    link = Path(f"{file}{ending}")
    link.symlink_to(victim)
    before = content(victim), file.read_bytes()
    for door in DOORS:
        with pytest.raises(SelectScriptError, match="is a symbolic link, but DuckDB") as caught:
            door(file)
        assert isinstance(caught.value, SqlError if door is _record else RecordError)
        assert str(link) in caught.value.message
        assert (content(victim), file.read_bytes()) == before
        assert link.is_symlink()
    new = file.with_name("new.duckdb")
    link = Path(f"{new}{ending}")
    link.symlink_to(victim)
    with pytest.raises(SqlError, match="is a symbolic link, but DuckDB"):
        _record(new)
    assert content(victim) == before[0]
    assert link.is_symlink()
    assert not new.exists()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no pipes")
@pytest.mark.parametrize(
    "make", [getattr(os, "mkfifo", None), Path.mkdir], ids=["a pipe", "a folder"]
)
@pytest.mark.parametrize("ending", ["", *LOGS])
def test_what_is_no_file_is_not_waited_for(file, tmp_path, make, ending):
    new = tmp_path / "new.duckdb"
    make(Path(f"{new}{ending}"))
    with pytest.raises(SqlError, match=r"new\.duckdb.* is no file"):
        _record(new)
    if ending:
        make(Path(f"{file}{ending}"))
        with pytest.raises(RecordError, match=rf"{ending} is no file, but"):
            _open(file)


@pytest.mark.parametrize(
    "place", ["run.duckdb.tmp", "run.duckdb.tmp/duckdb_temp_1_0_storage_DEFAULT-0"]
)
def test_queries_leave_nothing_where_a_link_leads(file, tmp_path, place):
    link, target = tmp_path / place, tmp_path / "target"
    target.mkdir()
    link.parent.mkdir(exist_ok=True)
    link.symlink_to(target)
    with pytest.raises(SqlError, match="is a symbolic link, but DuckDB puts there"):
        _record(file)
    assert not list(target.iterdir())


@pytest.mark.long
def test_what_a_crash_has_left_is_no_harm(tmp_path):
    """A log, and files of queries that had no room in memory."""
    file = tmp_path / "run.duckdb"
    subprocess.run([sys.executable, "-c", CRASH, file], check=True)
    assert log_of(file).stat().st_size
    left = tmp_path / "run.duckdb.tmp"
    left.mkdir()
    (left / "duckdb_temp_1_0_storage_DEFAULT-0.tmp").touch()
    _record(file)
    assert [episode.ticks for episode in ssduck.episodes(file)] == [4, 6]


@pytest.fixture
def linked(file, tmp_path):
    """A link of the user's to the file on another disk."""
    (tmp_path / "here").mkdir()
    link = tmp_path / "here" / "run.duckdb"
    link.symlink_to(file)
    return link


@pytest.mark.slow
def test_a_link_to_the_file_itself_is_followed(linked, file):
    count = len(ssduck.episodes(file))
    _record(linked)
    assert linked.is_symlink()
    assert len(ssduck.episodes(file)) == len(ssduck.episodes(linked)) == count + 1
    assert list(linked.parent.iterdir()) == [linked]


def test_the_log_is_then_beside_the_file(linked, file, tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("my thesis")
    log = Path(f"{file}.wal")
    log.symlink_to(victim)
    for door in DOORS:
        with pytest.raises(SelectScriptError, match="is a symbolic link, but DuckDB") as caught:
            door(linked)
        assert str(log) in caught.value.message
    assert victim.read_text() == "my thesis"


@pytest.mark.slow
def test_the_log_of_a_linked_file_does_not_grow_without_end(linked, monkeypatch):
    monkeypatch.setattr(writer, "LONG_LOG", 0)
    with ssduck.load("chaos", linked) as ss:
        ss["chaos"].step(5)
        ss.flush()
        log = log_of(linked)
        assert not log.exists() or not log.stat().st_size


def test_a_link_to_nothing_makes_no_file(tmp_path):
    link, target = tmp_path / "run.duckdb", tmp_path / "target"
    link.symlink_to(target)
    with pytest.raises(SqlError, match="a symbolic link to what is not there: give the path"):
        _record(link)
    assert not target.exists()
