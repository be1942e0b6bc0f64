"""Records in DuckDB files."""

import json
import os
import subprocess
import sys

import duckdb
import pybullet
import pytest

import ssduck
from ssduck import Recording
from ssduck.errors import ArgumentError, RecordError
from tests.support.recorded import POSIX, ROOT, python, rows
from tests.support.timing import HANGS

RECORDER = """
import os, signal, sys
import ssduck
from ssduck.demos.kitchen import KITCHEN
ss = ssduck.load("kitchen", sys.argv[1])
kitchen = ss.call_variable("kitchen")
for _ in range(10):
    kitchen.step()
print(ss.flush()["kitchen"], flush=True)
kitchen.step()
if sys.argv[2] == "kill":
    os.kill(os.getpid(), signal.SIGKILL)
ss.close()
"""


def recorder(path, end):
    return subprocess.Popen(
        [sys.executable, "-c", RECORDER, str(path), end],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        text=True,
    )


@pytest.mark.long
@POSIX
def test_a_file_holds_what_was_flushed_and_the_next_run_is_an_episode(client, tmp_path):
    path = tmp_path / "run.duckdb"
    for end, number in (("kill", 0), ("close", 1), ("kill", 2)):
        told, _ = recorder(path, end).communicate(timeout=HANGS)
        last = ssduck.episodes(path)[-1]
        assert (last.number, last.first_tick) == (number, 1)
        assert last.last_tick == int(told) + (end == "close")
        with ssduck.open(path) as ss:
            assert "ticks 1 to 11" in repr(ss.call_variable("kitchen")) or end == "close"
            assert ss.past("kitchen").ticks == list(range(1, last.last_tick + 1))
    with ssduck.open(path, episode=0) as ss:
        count = len(rows(ss, "entities_history"))
    assert count == 11 * 37
    with ssduck.Interpreter(path) as ss:
        ss.add_variable("lab", ssduck.World.attach(client))
    pybullet.disconnect(client)
    with duckdb.connect(path) as plain:
        views = plain.sql(
            "SELECT schema_name, view_name FROM duckdb_views() WHERE NOT internal AND NOT temporary"
        ).fetchall()
        assert ("kitchen_record_0", "entities_history") in views
        assert ("lab", "entities_history") in views
        for schema, view in views:
            plain.sql(f"SELECT * FROM {schema}.{view}").fetchall()
        for episode in range(3):
            (found,) = plain.sql(
                f"SELECT count(*) FROM kitchen_record_{episode}.entities_history"
            ).fetchall()[0]
            assert found in (11 * 37, 12 * 37)
    assert [(e.world, e.number) for e in ssduck.episodes(path)] == [
        ("kitchen", 0), ("kitchen", 1), ("kitchen", 2), ("lab", 0),
    ]  # fmt: skip


@pytest.mark.slow
def test_a_file_can_be_opened_many_times_but_not_where_it_is_recorded_into(tmp_path, client):
    path = tmp_path / "run.duckdb"
    with ssduck.Interpreter(path) as ss:
        ss.add_variable("lab", ssduck.World.attach(client))
        ss.flush()
        with pytest.raises(RecordError, match="is open in this process: close it first"):
            ssduck.open(path)
    before = path.read_bytes()
    with ssduck.open(path) as one, ssduck.open(path) as two:
        assert rows(one, "ticks_history") == rows(two, "ticks_history")
        code = "import ssduck, sys; print(ssduck.open(sys.argv[1]).past('lab').ticks)"
        assert python(code, path) == "[1]\n"
    assert path.read_bytes() == before


def test_files_that_hold_no_record(tmp_path):
    (tmp_path / "empty.duckdb").touch()
    (tmp_path / "text.duckdb").write_text("x" * 5000)
    duckdb.connect(tmp_path / "other.duckdb").close()
    for name, told in (
        ("empty", "cannot be opened"),
        ("text", "not a valid DuckDB database file"),
        ("other", "nothing is recorded in the DuckDB file"),
        ("missing", "neither a folder nor a DuckDB file"),
    ):
        with pytest.raises(RecordError, match=told):
            ssduck.open(tmp_path / f"{name}.duckdb")
    assert not (tmp_path / "missing.duckdb").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("about", "told"),
    [
        ("{", "the description of lab_record_0 is damaged: Expecting"),
        ('{"version": 1}', "lab_record_0 is damaged: it lacks what is recorded: .*'world'"),
        (None, "lab_record_0 in .* is a record of version 9; .*install a newer one"),
        ("bad", "is damaged: it has no valid recording settings"),
    ],
)
def test_files_of_another_version_or_damaged(tmp_path, client, about, told):
    path = tmp_path / "run.duckdb"
    with ssduck.Interpreter(path) as ss:
        ss.add_variable("lab", ssduck.World.attach(client))
    with duckdb.connect(path) as plain:
        ((kept,),) = plain.sql('SELECT about FROM lab_record_0."ssduck record"').fetchall()
        if about is None:
            about = json.dumps(json.loads(kept) | {"version": 9})
        if about == "bad":
            about = json.dumps(json.loads(kept) | {"recording": {"tables": ["nothing"]}})
        plain.execute('UPDATE lab_record_0."ssduck record" SET about = ?', [about])
    with pytest.raises(RecordError, match=told):
        ssduck.open(path)


@pytest.mark.slow
def test_names_that_recorded_runs_have_are_taken(tmp_path, client):
    with ssduck.Interpreter(tmp_path / "run.duckdb") as ss:
        world = ss.add_variable("lab", ssduck.World.attach(client))
        with pytest.raises(ArgumentError, match="a recorded run has it in SQL"):
            ss.add_variable("lab_record_0", world)
        with pytest.raises(ArgumentError, match="no entity 'nobody'"):
            ss.record("lab", Recording(entities=("nobody",)))
        world.step()
        assert ss.past("lab").ticks == [1, 2]  # it was recorded on


@pytest.mark.slow
def test_what_was_never_closed_is_stored_when_the_interpreter_is(tmp_path, client):
    ss = ssduck.Interpreter()
    world = ss.add_variable("lab", ssduck.World.attach(client))
    ss.record_to(tmp_path / "run")
    world.step()
    ss.close()
    world.step()
    assert ssduck.episodes(tmp_path / "run")[0].last_tick == world.snapshot.number - 1
    with ssduck.open(tmp_path / "run") as opened:  # an empty world, then and now
        assert opened.eval("count(SELECT this FROM lab{} AS list);") == 0
