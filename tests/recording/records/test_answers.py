"""Opened records answer as the live world did."""

from pathlib import Path

import duckdb
import pandas as pd
import polars as pl
import pytest

import ssduck
from ssduck import Recording
from ssduck.errors import RecordError, UnsupportedError
from ssduck.schema import RECORDABLE
from tests.support.cases import sampled
from tests.support.recorded import MODELS, PAST, PRESENT, PROGRAMS, answer, live_lab, python, rows

KINDS = ["folder", "live", "file"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@sampled("program", PROGRAMS["kitchen"], every=2)
def test_the_kitchen_answers_as_it_did(kitchen, program, kind):
    answers, _, opened = kitchen
    assert answer(opened[kind], program) == answers[program]
    assert "Error(" not in answers[program]
    assert answers[program] not in ("[]", "0")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("program", PROGRAMS["lab"])
def test_a_world_that_changed_answers_as_it_did(lab, program, kind):
    answers, _, opened = lab
    assert answer(opened[kind], program) == answers[program]
    assert "Error(" not in answers[program]
    assert answers[program] != "[]"


@pytest.mark.parametrize("kind", KINDS)
@sampled("table", [*PRESENT, *PAST, *MODELS], every=4)
@pytest.mark.parametrize("world", [pytest.param("kitchen", marks=pytest.mark.slow), "lab"])
def test_tables_are_the_same_row_for_row(request, world, table, kind):
    _, tables, opened = request.getfixturevalue(world)
    assert rows(opened[kind], table) == tables[table]
    assert tables[table]


@pytest.mark.slow
def test_handles_of_a_record_tell_and_cannot_be_moved(kitchen):
    opened = kitchen[2]["folder"]
    world = opened.call_variable("kitchen")
    assert repr(world) == (
        "<RecordedWorld 'kitchen': 37 entities, ticks 1 to 101, t=0 s to 0.416667 s>"
    )
    cup = world["cup_905a"]
    assert (cup.kind, len(cup.position), cup.mass > 0) == ("kinbody", 3, True)
    assert len(world["barrett_4918"].joints) == len(world["barrett_4918"].links) - 1
    with pytest.raises(UnsupportedError, match="recorded tick"):
        cup.move([0, 0, 1])
    with pytest.raises(UnsupportedError, match="is itself a record"):
        opened.record("kitchen", Recording())
    with pytest.raises(UnsupportedError, match="is itself a record"):
        opened.record_to("elsewhere", "kitchen")
    assert not Path("elsewhere").exists()


@pytest.mark.slow
@sampled("kind", ["folder", "file"], every=2)
def test_a_record_needs_no_simulator(tmp_path, client, kind):
    path = tmp_path / ("run.duckdb" if kind == "file" else "run")
    with ssduck.Interpreter(path if kind == "file" else ":memory:", recording=None) as ss:
        live_lab(ss, client)
        if kind == "folder":
            ss.export(path)
    code = """
import sys, ssduck
with ssduck.open(sys.argv[1]) as ss:
    print(ss.eval("SELECT id(a.this) FROM a=lab{-0.1}, b=lab{-0.1} WHERE collides(a.this, b.this) AS list;"))
    print(ss.sql("SELECT count(*) FROM links_history").fetchall(), ssduck.episodes(sys.argv[1])[0].ticks)
print("pybullet" in sys.modules)
"""
    assert python(code, path).splitlines()[-1] == "False"


@pytest.mark.slow
@sampled("table", [*RECORDABLE, "ticks"], every=7)
def test_others_read_the_folder_as_it_is(folder, table):
    place = folder / table
    scanned = duckdb.sql(f"SELECT * FROM '{str(place).replace(chr(39), chr(39) * 2)}/**/*.parquet'")
    columns = ssduck.schema.TABLES[table].names
    assert scanned.columns == [*columns, "episode", "world"]
    kept = {"double": "DOUBLE", "integer": "BIGINT", "string": "VARCHAR", "boolean": "BOOLEAN"}
    types = [kept[column.type] for column in ssduck.schema.TABLES[table].columns]
    assert [str(type) for type in scanned.types[:-2]] == types
    assert [str(type) for type in scanned.types[-2:]] == ["BIGINT", "VARCHAR"]
    counts = {}
    for world, episode in (("lab", 0), ("lab", 1), ("still", 0)):
        with ssduck.open(folder, world, episode) as ss:
            counts[world, episode] = len(rows(ss, f"{table}_history"))
    found = scanned.aggregate("world, episode, count(*)", "world, episode").fetchall()
    assert {tuple(row[:2]): row[2] for row in found} == {k: n for k, n in counts.items() if n}
    frame = pd.read_parquet(place)
    assert [*frame.columns] == [*columns, "world", "episode"]
    assert len(frame) == sum(counts.values())
    lazy = pl.scan_parquet(f"{place}/**/*.parquet", hive_partitioning=True).collect()
    assert lazy.columns == [*columns, "world", "episode"]
    assert lazy.height == sum(counts.values())


@pytest.mark.slow
def test_episodes_are_told_and_opened_by_world_and_number(folder):
    told = ssduck.episodes(folder)
    assert [(e.world, e.number, e.ticks) for e in told] == [
        ("lab", 0, 11),
        ("lab", 1, 12),
        ("still", 0, 1),
    ]
    assert told[0].tables == tuple(sorted(RECORDABLE))
    assert (told[1].first_tick, told[1].last_tick) == (2, 13)
    assert told[1].end == pytest.approx(11 / 240)
    with ssduck.open(folder) as ss:
        assert ss.call_variable("lab").snapshot.number == 13
        assert len(ss.call_variable("still")) == 1
        assert ss.sql("SELECT count(*) FROM still.entities_history").fetchall() == [(1,)]
    with ssduck.open(folder, episode=0) as ss:
        assert ss.call_variable("lab").snapshot.number == 12
    with ssduck.open(folder, episode=1) as ss:
        assert next(iter(ss)) == "lab"
        assert "still" not in ss


@pytest.mark.slow
def test_a_newer_episode_that_holds_nothing_does_not_hide_an_older_one(tmp_path, client):
    with ssduck.Interpreter(recording=None) as ss:
        live_lab(ss, client, ticks=3)
        ss.export(tmp_path / "run")
        full_buffers_only = ssduck.Recording(flush_every=None)
        writing = ss.record_to(tmp_path / "run", recording=full_buffers_only)
        assert writing.episode.ticks == 0
        assert writing.episode.last_tick is None
        (tmp_path / "run" / "episodes" / "lab-2.json").touch()  # about to begin
        with ssduck.open(tmp_path / "run") as opened:
            assert opened.past("lab").ticks[-1] == ss.past("lab").ticks[-1]
        with pytest.raises(RecordError, match="no episode 1 has ticks; episodes with ticks: 0 of"):
            ssduck.open(tmp_path / "run", episode=1)
        writing.close()
        assert writing.episode.ticks == 1
