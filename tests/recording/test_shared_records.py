"""Names that a file and a world share, and several recorders of one record."""

import pytest

import ssduck
from ssduck.errors import ArgumentError, RecordError, SqlError
from tests.support.cases import sampled
from tests.support.command_line import answer
from tests.support.recorded import ROOT

ROOM = ROOT / "tests/data/room.toml"


@pytest.mark.slow
@sampled("file", ["room.duckdb", "ROOM", "memory.db"], every=3)
def test_a_file_may_have_the_name_of_its_world(tmp_path, file):
    path = tmp_path / file
    for ticks in (2, 4):  # the second run adds an episode
        with ssduck.load(ROOM, path) as ss:
            ss.call_variable("room").step(ticks - 1)
            count = "SELECT count(DISTINCT tick) FROM room.entities_history"
            assert ss.sql(count).fetchall() == [(ticks,)]
            ss.sql("CREATE TABLE IF NOT EXISTS mine AS SELECT 7 AS seven")
            assert ss.sql("FROM main.mine").fetchall() == [(7,)]
    assert [episode.ticks for episode in ssduck.episodes(path)] == [2, 4]
    with ssduck.open(path) as ss:
        assert ss.sql(count).fetchall() == [(4,)]
        assert len(ss.eval("SELECT DISTINCT tick FROM room{} AS list;")) == 4
    assert ssduck.check(path) == []
    if file == "room.duckdb":
        assert "4" in answer("query", str(path), "--sql", count)


@pytest.fixture(scope="module")
def rooms(tmp_path_factory):
    """A world, and an interpreter in memory and one on a file."""
    path = tmp_path_factory.mktemp("rooms") / "run.duckdb"
    with (
        ssduck.load(ROOM, recording=None) as room,
        ssduck.Interpreter() as in_memory,
        ssduck.Interpreter(path) as on_file,
    ):
        yield room.call_variable("room"), (in_memory, on_file)


@pytest.mark.slow
@sampled("name", ["main", "MEMORY", "temp", "system", "information_schema", "pg_catalog"], every=3)
def test_a_world_with_the_name_of_a_schema_of_duckdbs_is_refused_when_it_is_named(rooms, name):
    room, places = rooms
    for ss in places:
        with pytest.raises(ArgumentError, match=r"DuckDB has a schema .*; choose another name"):
            ss.add_variable(name, room)
        ss.add_variable(f"{name}_2", room)
        assert ss.sql(f"SELECT count(*) > 1 FROM {name}_2.entities").fetchall() == [(True,)]


@pytest.mark.slow
def test_a_file_has_one_writer_in_a_process(tmp_path):
    path = tmp_path / "run.duckdb"
    with ssduck.Interpreter(path):
        for use, error in ((ssduck.Interpreter, SqlError), (ssduck.open, RecordError)):
            with pytest.raises(error, match="is open in this process: close it first"):
                use(path)
    ssduck.Interpreter(path).close()
