"""Names of folders and files mean what they say: no patterns, no addresses, no other file."""

import os
from pathlib import Path

import pybullet
import pytest

import ssduck
from ssduck.errors import RecordError, SqlError
from tests.support.bodies import solid
from tests.support.cases import sampled

POSIX = pytest.mark.skipif(os.name != "posix", reason="such names are for POSIX")
# `run1` is what `run[1]`, `run?` and `run*` would find as patterns.
NAMES = [
    *("run1", "run[1]", "run?", "run*", "**", "[!a]", "[*]", "{a,b}", "it's", 'a"b', "a%20#;b"),
    *("a\nb", "ünï", "$x", "~x", "world=lab", ":memory:x", "md:x"),
]


def ball(client):
    solid(client, pybullet.GEOM_SPHERE, 1, radius=0.1)
    return ssduck.World.attach(client)


def ticks(path):
    """How many ticks an opened record tells of, in SelectScript and in SQL."""
    with ssduck.open(path) as ss:
        (episode,) = ssduck.episodes(path)
        assert episode.path == path
        (told,) = ss.sql("SELECT count(*) FROM entities_history").fetchone()
        assert episode.ticks == told
        return len(ss.eval("SELECT id FROM lab{} AS list;")), told


@pytest.mark.slow
@POSIX
def test_a_folder_is_the_one_of_that_name(client, tmp_path):
    ss = ssduck.Interpreter()
    world = ss.add_variable("lab", ball(client))
    lengths = {}
    for name in NAMES:
        world.step()
        ss.export(tmp_path / name)
        lengths[name] = len(lengths) + 2
    assert len(set(lengths.values())) == len(NAMES)
    assert {name: ticks(tmp_path / name) for name in NAMES} == {
        name: (length, length) for name, length in lengths.items()
    }


@pytest.mark.slow
@POSIX
def test_a_folder_in_the_working_directory_is_no_address(client, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ss = ssduck.Interpreter()
    ss.add_variable("lab", ball(client)).step()
    names = ["run[1]", "~x", "~ x", "md:x", "C:x", "s3:/x", "file:x"]
    Path("s3:").mkdir()  # or else a path that begins so is an address
    for name in names:
        ss.export(name)
        assert ticks(Path(name)) == (2, 2)
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted({*names, "s3:"} - {"s3:/x"})


@pytest.mark.slow
def test_a_record_stays_where_it_began(client, tmp_path, monkeypatch):
    there = tmp_path / "there"
    there.mkdir()
    monkeypatch.chdir(tmp_path)
    ss = ssduck.Interpreter()
    world = ss.add_variable("lab", ball(client))
    with ss.record_to("run") as writing:
        world.step()
        ss.flush()
        monkeypatch.chdir(there)
        world.step()
        assert writing.episode.path == tmp_path / "run"
    assert list(there.iterdir()) == []
    assert ticks(tmp_path / "run") == (3, 3)
    monkeypatch.chdir(tmp_path)
    with ssduck.open("run") as opened:
        monkeypatch.chdir(there)
        assert len(opened.eval("SELECT id FROM lab{} AS list;")) == 3


@pytest.mark.slow
@POSIX
def test_a_tilde_is_the_home_folder_through_every_door(client, tmp_path, monkeypatch):
    home, here = tmp_path / "home", tmp_path / "here"
    home.mkdir()
    here.mkdir()
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.chdir(here)
    world = ball(client)
    for name, place in (("~/run", "run"), ("~/a/b", "a/b")):
        with ssduck.Interpreter() as ss:
            ss.add_variable("lab", world).step()
            assert home / place in ss.export(name)["lab"].parents
        with ssduck.open(name) as ss:
            assert ss.eval("SELECT id FROM lab AS list;")
        assert ssduck.episodes(name)[0].path == home / place
    with ssduck.Interpreter("~/run.duckdb") as ss:
        ss.add_variable("lab", world).step()
    with ssduck.open("~/run.duckdb") as ss:
        assert ss.eval("SELECT id FROM lab AS list;")
    assert list(here.iterdir()) == []


@pytest.mark.long
@POSIX
def test_a_file_is_the_one_of_that_name(client, tmp_path, monkeypatch):
    world = ball(client)
    monkeypatch.chdir(tmp_path)
    for length, name in enumerate(NAMES, 1):
        with ssduck.Interpreter(name) as ss:  # as it is, in the working directory
            ss.add_variable("lab", world)
            world.step(0)
            for _ in range(length - 1):
                world.step()
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted(NAMES)
    for length, name in enumerate(NAMES, 1):
        assert ticks(Path(name)) == (length + 1, length + 1)


@pytest.mark.slow
@POSIX
@sampled("name", ["a\\b", "a\\", "a\0b", "a\\*"], every=4)
def test_a_name_that_duckdb_does_not_take_is_an_error(client, tmp_path, name):
    with pytest.raises(SqlError, match="cannot be the path"):
        ssduck.Interpreter(tmp_path / name)
    assert list(tmp_path.iterdir()) == []
    ss = ssduck.Interpreter()
    ss.add_variable("lab", ball(client))
    if "\0" in name:
        with pytest.raises(RecordError, match="cannot be written"):
            ss.export(tmp_path / name)
    elif "*" in name:
        ss.export(tmp_path / name)
        with pytest.raises(RecordError, match="backslash"):
            ssduck.open(tmp_path / name)
    else:
        ss.export(tmp_path / name)
        assert ticks(tmp_path / name) == (1, 1)
