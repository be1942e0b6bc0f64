"""What a check repairs, and what is written through no link; records that others use, too."""

import shutil
from pathlib import Path

import pytest

import ssduck
from ssduck.errors import ArgumentError, RecordError
from ssduck.interchange.conversion import write_runs
from ssduck.recording.folder_episodes import runs_in
from ssduck.recording.stores.files import write_atomically
from tests.support.cases import sampled
from tests.support.command_line import answer
from tests.support.forged import part
from tests.support.recorded import ROOT


@pytest.fixture
def record(small_records, tmp_path):
    return Path(shutil.copytree(small_records / "folder", tmp_path / "record"))


@pytest.mark.filterwarnings("ignore")
def test_nothing_is_written_through_links_with_the_names_of_unfinished_files(
    record, small_records, tmp_path
):
    outside = tmp_path / "mine"
    part(record, "ticks").write_bytes(b"torn")
    outside.write_text("mine")
    names = [record / "a.mcap", *(file for file in record.rglob("*") if file.is_file())]
    for file in names:
        file.with_name(f".{file.name}.unfinished").symlink_to(outside)
    ssduck.check(record, repair=True)
    ssduck.lake(record).set_tags({"mine": 1})
    assert outside.read_text() == "mine"
    run = runs_in(small_records / "folder")[0]
    pytest.importorskip("foxglove_schemas_protobuf", reason="the extra mcap is not installed")
    write_runs([run], record / "a.mcap", "mcap")
    assert outside.read_text() == "mine"
    assert (record / "a.mcap").is_file()


def test_a_link_to_nothing_is_set_aside(record):
    (record / "gym").mkdir()
    (record / "gym/lab-0.json").symlink_to(record / "nothing")
    (damage,) = ssduck.check(record, repair=True)
    assert damage.is_repaired
    assert not (record / "gym/lab-0.json").is_symlink()
    assert not ssduck.check(record)


def test_what_is_no_record_is_said_as_before(tmp_path):
    with pytest.raises(RecordError, match=f"^{tmp_path} is no record of ssduck"):
        ssduck.check(tmp_path)


def test_ctrl_c_leaves_no_unfinished_file(tmp_path):
    def write(place):
        place.write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_atomically(tmp_path / "a.json", write)
    assert not list(tmp_path.iterdir())


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


@pytest.mark.slow
def test_a_world_with_the_name_of_a_schema_of_duckdbs_is_refused_when_it_is_named(tmp_path):
    with (
        ssduck.load(ROOM, recording=None) as room,
        ssduck.Interpreter() as in_memory,
        ssduck.Interpreter(tmp_path / "run.duckdb") as on_file,
    ):
        for name in ("main", "MEMORY", "temp", "system", "information_schema", "pg_catalog"):
            for ss in (in_memory, on_file):
                with pytest.raises(ArgumentError, match=r"DuckDB has a schema .*; choose another"):
                    ss.add_variable(name, room["room"])
                ss.add_variable(f"{name}_2", room["room"])
                many = f"SELECT count(*) > 1 FROM {name}_2.entities"
                assert ss.sql(many).fetchall() == [(True,)]
