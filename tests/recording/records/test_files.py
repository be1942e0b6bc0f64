"""Records in DuckDB files."""

import duckdb
import pytest

import ssduck
from ssduck import Recording
from ssduck.errors import ArgumentError, RecordError, SqlError
from tests.support.recorded import python, rows


@pytest.mark.slow
def test_a_file_can_be_opened_many_times_but_not_where_it_is_recorded_into(tmp_path, client):
    path = tmp_path / "run.duckdb"
    with ssduck.Interpreter(path) as ss:
        ss.add_variable("lab", ssduck.World.attach(client))
        ss.flush()
        for use, error in ((ssduck.Interpreter, SqlError), (ssduck.open, RecordError)):
            with pytest.raises(error, match="is open in this process: close it first"):
                use(path)
    before = path.read_bytes()
    with ssduck.open(path) as one, ssduck.open(path) as two:
        assert rows(one, "ticks_history") == rows(two, "ticks_history")
        code = "import ssduck, sys; print(ssduck.open(sys.argv[1]).past('lab').ticks)"
        assert python(code, path) == "[1]\n"
    assert path.read_bytes() == before
    with duckdb.connect(path, read_only=True) as plain:
        views = plain.sql("SELECT schema_name, view_name FROM duckdb_views() WHERE NOT internal")
        views = views.fetchall()
        assert {("lab", "entities_history"), ("lab_record_0", "entities_history")} <= {*views}
        for schema, view in views:
            plain.sql(f"SELECT * FROM {schema}.{view}").fetchall()


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
