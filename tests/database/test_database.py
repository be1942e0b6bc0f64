"""Raw SQL on live worlds, and how DuckDB is used: statements, plans, buffers, results."""

import datetime as dt
import decimal
import subprocess
import sys
import threading
from contextlib import contextmanager
from pathlib import Path

import duckdb
import pybullet
import pytest

import ssduck
from ssduck.database.connection import Connection
from ssduck.database.database import Database
from ssduck.database.schemas import TABLE_MACROS
from ssduck.schema import MODELS, TABLES
from ssduck.sql.relations.registry import RELATIONS
from tests.support.stage import Stage
from tests.support.timing import HANGS

NINE_PAIRS = (
    "SELECT a.name, b.name FROM entities a, entities b "
    "WHERE above(a, b) AND a.kind <> 'sensor' AND b.kind <> 'sensor'"
)


@pytest.fixture
def sim():
    """A PyBullet client of the user's with three boxes, bound as `sim`."""
    with Stage() as stage, ssduck.Interpreter() as interpreter:
        for place in range(3):
            stage.box(None, (place, 0, 1), half=0.1, mass=1)
        interpreter.add_variable("sim", ssduck.World.attach(stage.client))
        yield interpreter, stage.client


# -- tables -------------------------------------------------------------------------------------


@pytest.mark.parametrize("table", TABLES)
def test_every_table_is_there_with_its_columns(ss, table):
    for name in (table, f"kitchen.{table}"):
        shown = [column.name for column in TABLES[table].shown_columns]
        seconds = list(TABLES[table].second_names.values())
        assert ss.sql(f"FROM {name} LIMIT 0").columns == shown + seconds


@pytest.mark.parametrize("table", sorted(set(TABLES) - {"contacts", "sites"}))
def test_tables_are_filled_and_of_one_tick(ss, table):
    ss.call_variable("kitchen").step()
    rows = ss.sql(f"FROM {table}")
    assert len(rows) > 0
    if table != "geometries":
        assert (
            ss.sql(f"SELECT DISTINCT tick, time FROM {table}").fetchall()
            == ss.sql("SELECT tick, time FROM ticks").fetchall()
        )


@pytest.mark.slow
def test_contacts_join_entities(ss):
    ss.call_variable("kitchen").step(240)
    rows = ss.sql(
        "SELECT DISTINCT a.name, b.name FROM contacts c JOIN entities a ON a.id = c.a "
        "JOIN entities b ON b.id = c.b WHERE 'cup_905a' IN (a.name, b.name)"
    ).fetchall()
    assert rows == [("table", "cup_905a")]


def test_links_joints_and_shapes_join_entities(ss):
    joints = ss.sql(
        "SELECT j.name FROM joints j JOIN entities e ON e.id = j.entity "
        "WHERE e.name = 'barrett_4918' AND j.lower IS NOT NULL ORDER BY j.link"
    ).fetchall()
    assert [name for (name,) in joints][:7] == ["j1", "j2", "j3", "j4", "j5", "j6", "j7"]
    types = ss.sql(
        "SELECT DISTINCT g.type FROM shapes s JOIN geometries g ON g.id = s.geometry "
        "JOIN entities e ON e.id = s.entity WHERE e.name = 'fridge'"
    ).fetchall()
    assert types == [("sphere",)]


@pytest.mark.slow
def test_two_worlds_are_two_schemas(ss, sim):
    interpreter, _ = sim
    world = ssduck.load("kitchen").call_variable("kitchen")
    interpreter.add_variable("second", world)
    assert len(interpreter.sql("FROM entities")) == len(interpreter.sql("FROM sim.entities")) == 3
    assert len(interpreter.sql("FROM second.entities")) == len(world)
    names = interpreter.eval("SELECT id FROM second WHERE isRobot(this) LIMIT 1 AS list;")
    assert names == ["fridge"]
    far = "SELECT count(*) FROM sim.entities a, second.entities b WHERE distance(a, b) > 0"
    assert interpreter.sql(far).fetchone() == (3 * len(world),)
    world.close()


def test_a_world_bound_twice_has_two_schemas(sim):
    interpreter, client = sim
    interpreter.eval("other = sim;")
    assert interpreter.eval("SELECT count([1]) FROM other AS list;") == [1, 1, 1]
    interpreter.add_variable("third", interpreter.call_variable("sim"))
    Stage(client).box(None, half=0.1, mass=1)
    interpreter.call_variable("sim").tick()
    assert (
        len(interpreter.sql("FROM third.entities"))
        == len(interpreter.sql("FROM sim.entities"))
        == 4
    )


@pytest.mark.slow
def test_worlds_whose_names_differ_in_case_only_are_refused(sim):
    interpreter, _ = sim
    with ssduck.load("kitchen") as ss:
        kitchen = ss.call_variable("kitchen")
        with pytest.raises(ssduck.SelectScriptError, match="SQL ignores case"):
            interpreter.add_variable("Sim", kitchen)
    assert len(interpreter.eval("SELECT id FROM sim;")) == 3


@pytest.mark.slow
def test_a_world_in_two_interpreters(sim):
    first, _ = sim
    world = first.call_variable("sim")
    with ssduck.Interpreter() as second:
        second.add_variable("other", world)
        for ss, name in ((first, "sim"), (second, "other")):
            assert len(ss.eval(f"SELECT obj FROM {name} AS list;")) == 3
            assert len(ss.sql(f"FROM {name}.entities")) == 3
    world.tick()
    assert len(first.eval("SELECT obj FROM sim AS list;")) == 3


@pytest.mark.slow
def test_interpreters_with_the_same_worlds_do_not_wait_for_each_other(sim):
    one, _ = sim
    with ssduck.load("kitchen") as two:
        kitchen, boxes = two.call_variable("kitchen"), one.call_variable("sim")
        one.add_variable("kitchen", kitchen)
        with ssduck.Interpreter() as other:
            other.add_variable("kitchen", kitchen)
            other.add_variable("sim", boxes)

            def ask(ss):
                for _ in range(100):
                    ss.eval("SELECT id FROM sim;")

            threads = [threading.Thread(target=ask, args=(ss,), daemon=True) for ss in (one, other)]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join(HANGS)
            assert not any(thread.is_alive() for thread in threads)


@pytest.mark.slow
def test_a_world_that_takes_anothers_name(sim):
    interpreter, _ = sim
    old = interpreter.call_variable("sim")
    client = pybullet.connect(pybullet.DIRECT)
    interpreter.add_variable("old", old)
    interpreter.add_variable("sim", ssduck.World.attach(client))
    assert interpreter.eval("SELECT id FROM sim AS list;") == []
    assert len(interpreter.eval("SELECT id FROM old AS list;")) == 3
    assert len(interpreter.sql("FROM sim.entities")) == 0
    pybullet.disconnect(client)


# -- plans and statements -----------------------------------------------------------------------


@pytest.mark.slow
def test_the_nine_pairs_are_a_range_join_without_python(ss):
    plan = ss.sql(f"EXPLAIN {NINE_PAIRS}").fetchall()[0][1].upper()
    assert any(join in plan for join in ("IE JOIN", "PIECEWISE MERGE JOIN"))
    assert "UDF" not in plan
    functions = ss.sql(
        "SELECT count(*) FROM duckdb_functions() WHERE function_type = 'scalar' AND function_name = 'above'"
    )
    assert functions.fetchone() == (0,)
    assert len(ss.sql(NINE_PAIRS)) == 9


def test_selectscript_pairs_are_a_range_join_too(ss):
    sql = ss.explain(
        "SELECT to(id(a.this), 'a'), to(id(b.this), 'b') FROM a=kitchen, b=kitchen WHERE overlaps(a.this, b.this);"
    )
    plan = ss.sql(f"EXPLAIN {sql}").fetchall()[0][1].upper()
    assert any(join in plan for join in ("IE JOIN", "PIECEWISE MERGE JOIN"))


def test_what_fails_behind_many_rows_is_told():
    database = Database(":memory:", None).connection
    with pytest.raises(ssduck.SelectScriptError, match="late"):
        database.rows("SELECT if(i = 90000, error('late'), 'a') FROM range(100000) numbers(i)")
    assert database.rows("SELECT 1") == [(1,)]
    database.close()


def test_plans_follow_bodies_that_come_and_go(sim):
    """A prepared statement would go on reading the buffers that it was made for."""
    interpreter, client = sim
    program = interpreter.compile("SELECT x FROM sim WHERE x(this) > low AS list;")
    interpreter.add_variable("low", 0.5)
    world = interpreter.call_variable("sim")
    assert interpreter.eval(program) == [1.0, 2.0]
    Stage(client).box(None, (7, 0, 0), half=0.1, mass=1)
    assert interpreter.eval(program) == [1.0, 2.0]  # until the next tick
    world.tick()
    assert interpreter.eval(program) == [1.0, 2.0, 7.0]
    interpreter.add_variable("low", 1.5)
    assert interpreter.eval(program) == [2.0, 7.0]
    pybullet.removeBody(2, client)
    world.tick()
    assert interpreter.eval(program) == [7.0]


@pytest.mark.slow
def test_views_of_on_demand_tables_stay_up_to_date(sim):
    interpreter, client = sim
    world = interpreter.call_variable("sim")
    interpreter.sql("CREATE VIEW fastest AS SELECT max(abs(vz)) AS v FROM links")
    pybullet.setGravity(0, 0, -10, physicsClientId=client)
    world.step(24)
    assert interpreter.sql("FROM fastest").fetchone()[0] == pytest.approx(1.0, rel=0.01)
    world.step(24)
    assert interpreter.sql("FROM fastest").fetchone()[0] == pytest.approx(2.0, rel=0.01)


@contextmanager
def stepping(world):
    """Another thread steps the world all the time."""
    running = threading.Event()
    running.set()

    def step():
        while running.is_set():
            world.step()

    stepper = threading.Thread(target=step)
    stepper.start()
    try:
        yield
    finally:
        running.clear()
        stepper.join()


def test_a_query_and_what_is_nested_in_it_are_of_one_tick(sim):
    interpreter, client = sim
    world = interpreter.call_variable("sim")
    pybullet.setGravity(0, 0, -10, physicsClientId=client)
    own = "(SELECT z FROM sim LIMIT 1 AS value)"
    answers = interpreter.compile(f"SELECT z(this) == {own} FROM sim AS list;")
    with stepping(world):
        while world.time < 0.1:  # as slow as the machine may be
            assert all(interpreter.eval(answers))


@pytest.mark.slow
def test_a_forgotten_plan_is_made_anew(sim):
    """Here while it runs: the function that it calls makes another world known."""
    interpreter, _ = sim
    with ssduck.load("kitchen") as ss:
        kitchen = ss.call_variable("kitchen")
        interpreter.add_function("low", lambda: interpreter.add_variable("more", kitchen) and 0.5)
        for _ in range(3):
            assert interpreter.eval("SELECT x FROM sim WHERE x(this) > low() AS list;") == [
                1.0,
                2.0,
            ]


@pytest.mark.slow
def test_a_function_may_look_at_links_and_joints():
    with ssduck.load("kitchen") as ss:
        ss.add_function("axes", lambda e: len(e.joints))
        assert ss.eval("SELECT axes FROM kitchen WHERE id(this) == 'barrett_4918' AS value;") > 10


@pytest.mark.long
def test_nothing_is_printed_when_python_ends(tmp_path):
    """Not even if nothing is closed, and an interpreter is still held by the module."""
    program = (
        "import ssduck\n"
        "ss = ssduck.load('kitchen')\n"
        "ss.add_function('f', lambda e: ss is not None)\n"
        "assert ss.eval('SELECT id FROM kitchen WHERE f(this) AS list;')\n"
        "rows = ss.sql('FROM links')\n"
        "rows.fetchone()\n"
    )
    root = str(Path(ssduck.__file__).parent.parent)
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=root, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


# -- results ------------------------------------------------------------------------------------


def test_results_fetch_like_duckdbs(ss):
    result = ss.sql("SELECT i, i * 2 AS twice FROM range(5) t(i)")
    assert result.columns == ["i", "twice"]
    assert result.shape == (5, 2)
    assert len(result) == 5
    assert result.fetchone() == (0, 0)
    assert result.fetchmany(2) == [(1, 2), (2, 4)]
    assert result.fetchall() == [(3, 6), (4, 8)]
    assert result.fetchone() is None
    assert result.fetchall() == []
    assert list(result) == [(i, 2 * i) for i in range(5)]
    assert repr(result) == "<Result: 5 rows of i, twice>"


def test_results_of_every_type(ss):
    row = ss.sql(
        "SELECT 1::HUGEINT, sum(1), 'ü', NULL, [1, 2], {'a': 1}, 1.5::DECIMAL(4, 2), "
        "DATE '2020-01-02', true, 'infinity'::DOUBLE, 'x'::BLOB"
    ).fetchone()
    assert row == (
        1, 1, "ü", None, [1, 2], {"a": 1}, decimal.Decimal("1.50"),
        dt.date(2020, 1, 2), True, float("inf"), b"x",
    )  # fmt: skip


def test_results_as_frames(ss):
    result = ss.sql("SELECT name, z FROM entities ORDER BY z DESC, name LIMIT 3")
    assert result.df()["name"].tolist() == result.pl()["name"].to_list()
    assert result.arrow().column("name").to_pylist() == [name for name, _ in result]


def test_results_stay_as_they_were(sim):
    interpreter, client = sim
    world = interpreter.call_variable("sim")
    pybullet.setGravity(0, 0, -10, physicsClientId=client)
    result = interpreter.sql("SELECT z FROM entities")
    world.step(100)
    assert result.fetchall() == [(1.0,)] * 3


def test_results_in_a_notebook(ss):
    page = ss.sql("SELECT '<b>' AS tag, i FROM range(30) t(i)")._repr_html_()
    assert "&lt;b&gt;" in page
    assert "30 rows (20 shown), 2 columns" in page
    assert page.count("<tr>") == 22


@pytest.mark.slow
def test_a_file_keeps_nothing_of_worlds_that_are_gone(tmp_path, sim):
    path = tmp_path / "own.duckdb"
    world = sim[0].call_variable("sim")
    with ssduck.Interpreter(path, recording=None) as ss:
        ss.add_variable("sim", world)
        assert ss.sql("SELECT sim.collides(e, e) FROM sim.entities e").fetchall() == [(False,)] * 3
        ss.sql("CREATE TABLE sim.own AS SELECT name FROM sim.entities")
        ss.sql("CREATE VIEW sim.kept AS SELECT sim.isRobot(e) AS r FROM sim.entities e")
    with ssduck.Interpreter(path, recording=None) as ss:
        kept = "SELECT function_name FROM duckdb_functions() WHERE schema_name = 'sim'"
        assert ss.sql(kept).fetchall() == []
        assert ss.sql("SELECT table_name FROM duckdb_tables()").fetchall() == [("own",)]
        ss.add_variable("sim", world)
        assert ss.sql("SELECT sim.collides(e, e) FROM sim.entities e").fetchall() == [(False,)] * 3


@pytest.mark.slow
def test_tables_columns_and_functions_are_commented(sim):
    sim, *_ = sim
    assert sim.sql(
        "SELECT count(*) FROM duckdb_columns() WHERE schema_name = 'sim' AND comment IS NULL"
    ).fetchall() == [(0,)]
    columns = (
        "SELECT comment FROM duckdb_columns() WHERE schema_name = 'sim' AND column_name = 'mass'"
    )
    assert ("kg; 0 for a sensor and for a body that cannot move",) in sim.sql(columns).fetchall()
    views = dict(
        sim.sql(
            "SELECT view_name, comment FROM duckdb_views() WHERE schema_name = 'sim'"
        ).fetchall()
    )
    for name, table in TABLES.items():
        row = table.row
        assert views.pop(name) == f"A row is {row}."
        if name != "geometries":
            assert views.pop(f"{name}_history") == f"A row is {row}, at each recorded tick."
        if name in MODELS:
            told = f"Values that are the same at all recorded ticks. A row is {row}."
            assert views.pop(f"{name}_model") == told
    assert views == {}
    for place in ("temp", "sim"):
        said = sim.sql(
            "SELECT DISTINCT comment FROM duckdb_functions() "
            "WHERE function_name = 'collides' AND $place IN (database_name, schema_name)",
            {"place": place},
        )
        assert said.fetchall() == [(RELATIONS["collides"].help,)]
    said = sim.sql(
        "SELECT function_name, comment FROM duckdb_functions() "
        "WHERE function_type = 'table_macro' AND schema_name = 'sim' ORDER BY ALL"
    )
    assert said.fetchall() == sorted((macro.name, macro.about) for macro in TABLE_MACROS)
    # A name that is given to another world keeps them.
    sim.add_variable("sim", sim.call_variable("sim").what_if({}))
    views = sim.sql("SELECT comment FROM duckdb_views() WHERE schema_name = 'sim'")
    assert (None,) not in views.fetchall()


def test_a_file_that_is_no_database(tmp_path):
    path = tmp_path / "text.duckdb"
    path.write_text("no database at all, but long enough to be looked at" * 10)
    with pytest.raises(ssduck.SelectScriptError, match=r"text\.duckdb cannot be opened"):
        ssduck.Interpreter(str(path))


def test_a_letter_that_is_another_in_upper_case_only(ss):
    with pytest.raises(ssduck.SelectScriptError, match="entitie\u017f"):
        ss.sql("SELECT * FROM entitie\u017f")


@pytest.mark.slow
def test_a_closed_interpreter_says_so(tmp_path):
    ss = ssduck.load("kitchen")
    ss.close()
    ss.close()
    with pytest.raises(ssduck.SelectScriptError, match=r"[Cc]losed"):
        ss.sql("SELECT 1")


class Failing:
    """A recorder whose ticks cannot be stored, for a reason that nobody thought of."""

    is_writer_thread = False

    def finish(self):
        raise RuntimeError("nobody thought of it")


def test_what_cannot_be_stored_leaves_no_database_open():
    connection = Connection(":memory:", None, ssduck.Limits(), [Failing()])
    with pytest.raises(RuntimeError, match="nobody thought of it"):
        connection.close()
    with pytest.raises(duckdb.ConnectionException, match="closed"):
        connection._connection.execute("SELECT 1")
