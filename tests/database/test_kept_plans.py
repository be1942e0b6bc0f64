"""Plans that DuckDB keeps: what they read, their results at each tick, and when they are dropped."""

import json
import math

import duckdb
import mujoco
import pybullet
import pytest

import ssduck
from ssduck.database import plans
from ssduck.database.plans import RUNS_BEFORE_PLAN
from ssduck.errors import SqlError
from ssduck.schema import TABLES
from tests.support.bodies import solid
from tests.support.cases import sampled
from tests.support.mjcf import simulated

RUNS = RUNS_BEFORE_PLAN + 3
CASES = [
    "SELECT name FROM entities WHERE kind = 'kinbody' ORDER BY id",
    "SELECT * FROM entities",
    "SELECT * EXCLUDE (mass) FROM entities WHERE z > 0.1",
    "SELECT COLUMNS('^z') FROM entities",
    "SELECT count(*) FROM entities",
    "SELECT count(*), max(force), min(depth) FROM contacts",
    "SELECT a, b, round(nz, 9) FROM contacts ORDER BY ALL",
    "SELECT e.name, c.force FROM contacts c JOIN entities e ON c.a = e.id",
    "SELECT a.name, b.name FROM entities a, entities b WHERE a.z > b.z AND a.x < b.x + 1",
    "SELECT a.name, b.name FROM entities a LEFT JOIN entities b ON a.z < b.z - 0.2",
    "SELECT id, name, mass FROM entities JOIN entities b USING (id, name, mass)",
    "SELECT kind, count(*) AS n, avg(z) FROM entities GROUP BY ALL ORDER BY n, kind",
    "FROM entities SELECT name, row_number() OVER (ORDER BY z, id) AS place",
    "WITH high AS (SELECT * FROM entities WHERE z > 0.2) SELECT name FROM high",
    "WITH entities AS (SELECT 1 AS one) SELECT * FROM entities, contacts LIMIT 1",
    "SELECT name FROM entities WHERE id IN (SELECT a FROM contacts)",
    "SELECT name, (SELECT max(z) FROM entities) - z AS below FROM entities",
    "SELECT name, (SELECT max(z) FROM entities) - z FROM entities",
    "SELECT id FROM entities UNION ALL SELECT a FROM contacts",
    "SELECT sim.entities.name FROM sim.entities",  # no alias has a schema
    "SELECT name FROM entities AS e(tick, seconds, id)",
    "SELECT #3 FROM entities",
    "SELECT * FROM entities LIMIT 0",  # there is no scan to replace
    "SELECT e FROM entities e",
    "SELECT name, full_name FROM links",
    "SELECT * FROM links ORDER BY id",
    "SELECT l.id, l.z, l.enabled, e.name FROM links l JOIN entities e ON e.id = l.entity",
    "SELECT count(*) FROM sites",
    "SELECT full_name, visible, region FROM sites",
    "SELECT a.name FROM entities a WHERE a.z > (SELECT avg(z) FROM entities WHERE id <> a.id)",
    "SELECT name FROM entities e, range(2) r(i)",
    # Columns that no plan reads decide what these mean.
    "WITH pose(k, x) AS (FROM entities) SELECT x FROM pose",
    "WITH pose(k, z) AS (FROM entities) SELECT max(z) AS z FROM pose",
    "WITH c(k, force) AS (FROM contacts) SELECT force FROM c",
    "SELECT t.b, 'mass' AS what FROM (FROM entities) t(a, b)",
    "SELECT name FROM entities e WHERE length(typeof(e)) > 200",
    "SELECT name FROM entities WHERE length(typeof(struct_pack(*COLUMNS(*)))) > 200",
    "SELECT count(*) FROM (DESCRIBE FROM entities)",  # it scans no table
    "SELECT 'a' AS Z, name FROM entities WHERE typeof(Z) = 'DOUBLE'",
    "SELECT name AS point_a_x, typeof(point_a_x) AS t FROM entities JOIN contacts ON id = a",
    "SELECT 'a' AS FORCE, (SELECT count(*) FROM contacts WHERE typeof(FORCE) = 'DOUBLE') AS n FROM entities",
    "SELECT e.name, c.b FROM entities e JOIN contacts c ON c.a = e.id LIMIT 2",
    "SELECT name FROM entities LIMIT 2",
    "SELECT id, z FROM entities UNION ALL BY NAME SELECT id, name FROM entities",
    "SELECT vertices FROM geometries",
    # The order of joined rows decides.
    "SELECT list(b.name) FROM entities a JOIN entities b ON a.id > b.id",
    "SELECT a.kind, sum(b.z) FROM entities a JOIN entities b ON a.id > b.id GROUP BY ALL",
    "SELECT DISTINCT ON (a.kind) a.name, b.z FROM entities a JOIN links b USING (time)",
    "SELECT a.name, row_number() OVER () AS n FROM entities a JOIN links b USING (time)",
    "SELECT fsum(b.z) FROM entities a JOIN links b USING (time)",
    "SELECT approx_quantile(b.z, 0.4) FROM entities a JOIN links b USING (time)",
    "SELECT max(b.z), count(*) FROM entities a JOIN entities b ON a.id > b.id",
    "SELECT [z], {'a': z}, DATE '2026-01-01', 1.5::DECIMAL(4, 1), NULL::INTEGER FROM entities",
    "SELECT max(id) OVER (), z FROM entities",
    # Boxes, and other columns without them.
    "SELECT count(*), max(z) FROM entities",
    "SELECT name FROM entities WHERE id IN (SELECT id FROM entities WHERE z > 0.2)",
    "SELECT * EXCLUDE (xmin, ymin, zmin, xmax, ymax, zmax) FROM entities",
    "SELECT max(zmax) FROM entities",
    "SELECT name FROM entities WHERE ZMIN > 0.1",
    "SELECT name FROM entities ORDER BY zmin DESC LIMIT 3",
    "FROM sim.entities",
    "SELECT COLUMNS('^zm') FROM entities",
    "SELECT max(e)::TEXT FROM entities e",
    "SELECT e.m.zmax FROM (SELECT e AS m FROM entities e) e",
    "SELECT #23 FROM entities",
]  # fmt: skip


@pytest.fixture
def traced(client):
    """An interpreter with falling boxes, and their client."""
    solid(client, pybullet.GEOM_PLANE, 0)
    pybullet.setGravity(0, 0, -9.81, physicsClientId=client)
    for number in range(6):
        position = [0.04 * number, 0, 0.06 + 0.11 * number]
        solid(client, pybullet.GEOM_BOX, 1, position, halfExtents=[0.05, 0.05, 0.05])
    with ssduck.Interpreter(recording=None) as ss:
        ss.add_variable("sim", ssduck.World.attach(client))
        ss.sql("SELECT force, mass FROM contacts, entities").fetchall()  # ticks have them now
        yield ss, client


def move(ss, client, steps=7):
    for _ in range(steps):
        pybullet.stepSimulation(physicsClientId=client)
    ss.call_variable("sim").tick()


def oracle(ss, sql):
    """The rows that DuckDB has of copies of the tables, without ssduck."""
    with duckdb.connect() as own, ss._database.pinned({"contacts", "masses"}):
        own.execute("CREATE SCHEMA sim; SET search_path = 'main,sim'")
        for table in TABLES:
            copy = ss._database.connection.table(f"FROM sim.{table}", None)
            own.register("copy", copy)
            own.execute(f"CREATE TABLE sim.{table} AS FROM copy")
            own.unregister("copy")
        return own.sql(sql).to_arrow_table()


def described(table):
    return table.column_names, sorted(map(repr, table.to_pylist()))


@pytest.mark.slow
@sampled("most", [plans.MAX_ROWS, 0], ids=["kept", "scanned"], every=2)
@sampled("sql", CASES, every=8)
def test_results_are_those_of_copied_tables(traced, monkeypatch, sql, most):
    ss, client = traced
    monkeypatch.setattr(plans, "MAX_ROWS", most)
    seen = set()
    for _ in range(RUNS):
        move(ss, client)
        found = described(ss.sql(sql).arrow())
        assert found == described(oracle(ss, sql))
        seen.add(json.dumps(found))
    assert len(seen) == RUNS or not sql.startswith("SELECT * EX")


PROGRAMS = [
    "SELECT id FROM sim WHERE z(this) > 0.3 AS list;",
    "SELECT id, z FROM sim WHERE above(sim.body_1, this) ORDER BY z;",
    "SELECT a.id, b.id FROM a=sim, b=sim WHERE above(a.this, b.this) AND z(b.this) > 0.2 AS list;",
    "SELECT max(z(this)), count(this) FROM sim AS list;",
]


@pytest.mark.slow
@pytest.mark.parametrize("text", PROGRAMS)
def test_programs_have_the_values_of_a_new_interpreter(traced, text):
    ss, client = traced
    program = ss.compile(text)
    for _ in range(RUNS):
        move(ss, client)
        value = ss.eval(program)
        with ssduck.Interpreter(recording=None) as other:
            other.add_variable("sim", ssduck.World.attach(client))
            assert str(value) == str(other.eval(text))


@pytest.mark.parametrize(
    "sql",
    [
        "SELECT a.name, b.name, [a.id] AS list FROM entities a, entities b",
        "SELECT kind, kind, list(name) AS list FROM entities GROUP BY ALL",
        "SELECT vertices, type, type FROM geometries",
        "SELECT name, name FROM entities",
    ],
)
def test_columns_of_one_name_keep_it(traced, sql):
    ss, _ = traced
    names = [ss.sql(sql).arrow().column_names for _ in range(RUNS)]
    assert names == [names[0]] * RUNS
    assert len(set(names[0])) < len(names[0])


@pytest.mark.slow
@pytest.mark.parametrize(
    "sql",
    [
        "SELECT a, z FROM contacts e LEFT JOIN sites s ON e.ax = s.name::DATE",
        "SELECT e.id FROM entities e WHERE e.name::INT NOT IN (SELECT id FROM sites)",
    ],
)
def test_a_cast_that_duckdb_never_makes_is_no_error(traced, sql):
    """The plan of an empty table skips it; that of a function makes it."""
    ss, client = traced
    for _ in range(RUNS):
        try:
            expected = oracle(ss, sql).to_pylist()
        except duckdb.ConversionException:
            with pytest.raises(ssduck.SelectScriptError, match="Could not convert"):
                ss.sql(sql).fetchall()
        else:
            assert sorted(map(repr, ss.sql(sql).arrow().to_pylist())) == sorted(map(repr, expected))
        move(ss, client)


@pytest.mark.slow
def test_a_users_macro_sees_whole_rows(traced):
    ss, _ = traced
    ss.sql("CREATE MACRO letters(e) AS length(typeof(e))")
    lengths = [ss.sql("SELECT letters(e) AS n FROM entities e").fetchall() for _ in range(RUNS)]
    assert lengths == [lengths[0]] * RUNS
    assert lengths[0][0][0] > 200


MACROS = [
    ("collected(v) AS list(v)", "collected(b.name)"),
    ("max(v) AS list(v)", "max(b.name)"),
    ("count(v) AS string_agg(v)", "count(b.name)"),
    ("COUNT_IF(v) AS string_agg(v)", "count_if(b.name)"),
    ('"all of"(v) AS list(v)', '"ALL of"(b.name)'),
    ("memory.main.collected(v) AS list(v)", "main.collected(b.name)"),
]


@pytest.mark.slow
@sampled(("macro", "call"), MACROS, every=2)
def test_joined_rows_that_a_macro_lists_keep_their_order(traced, macro, call):
    """Another plan might join them in another order."""
    ss, _ = traced
    ss.sql(f"CREATE MACRO {macro}")
    text = f"SELECT {call} FROM entities a JOIN entities b ON a.id > b.id"
    values = [ss.sql(text).fetchall() for _ in range(RUNS)]
    assert values == [values[0]] * RUNS


def test_the_time_of_a_statement_is_that_of_its_run(traced):
    ss, _ = traced
    times = [ss.sql("SELECT now() AS t FROM entities LIMIT 1").fetchall() for _ in range(RUNS)]
    assert sorted(times) == times
    assert len({time for ((time,),) in times}) == RUNS


@pytest.mark.slow
def test_a_users_table_takes_the_place_of_a_worlds(traced):
    ss, _ = traced
    sql = "SELECT count(*) FROM entities"
    for _ in range(RUNS):
        assert ss.sql(sql).fetchall() == [(7,)]
    ss.sql("CREATE TABLE entities AS SELECT 1 AS one")
    for _ in range(RUNS):
        assert ss.sql(sql).fetchall() == [(1,)]
    ss.sql("INSERT INTO entities VALUES (2)")
    assert ss.sql(sql).fetchall() == [(2,)]


MODEL = """<mujoco><worldbody>
  <body name="arm" pos="0 0 1" euler="0 30 0"><joint name="hinge" axis="0 1 0" ref="20"/>
    <geom type="capsule" size="0.02 0.2"/><site name="tip" pos="0 0 0.2" size="0.01"/>
    <body name="hand" pos="0 0 0.4"><joint name="slide" type="slide" axis="1 0 0"/>
      <geom type="box" size="0.05 0.05 0.05"/><site name="palm" size="0.02"/></body></body>
  <body name="ball" pos="1 0 2"><freejoint/><geom type="sphere" size="0.1"/></body>
  </worldbody></mujoco>"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "sql",
    [
        "SELECT name, full_name, round(x, 6) AS x FROM sites ORDER BY id",
        "SELECT * FROM sites",
        "SELECT s.name, l.name, l.kind, s.enabled FROM sites s JOIN links l USING (entity)",
        "SELECT max(z) - min(z) AS height, count(*) AS n FROM links WHERE visible",
    ],
)
def test_links_and_sites_are_those_of_the_view(tmp_path, sql):
    (tmp_path / "scene.xml").write_text(MODEL)
    with ssduck.load(tmp_path / "scene.xml") as ss:
        world = ss["scene"]
        seen = set()
        for _ in range(RUNS):
            world.step(5)
            found = ss.sql(sql).arrow()
            with ss._database.pinned({"links"}):
                plain = ss._database.connection.table(sql, None)
            assert described(found) == described(plain)
            seen.add(str(found))
        assert len(found)
        assert len(seen) > 1 or "JOIN" in sql


# -- statements with numbers as parameters ----------------------------------------------------

# Statements, and the values of their parameters in turn.
WITH_NUMBERS = [
    ("SELECT name FROM entities WHERE z > $low", [{"low": 0.05}, {"low": 0.15}, {"low": 9.0}]),
    ("SELECT name FROM entities WHERE z > ? AND x < ?", [[0.0, 0.5], [0.0, 0.3], [1.0, 0.3]]),
    ("SELECT *, z > $low FROM entities WHERE x > $low", [{"low": 0.1}, {"low": 0.2}]),
    ("SELECT name, $k * z FROM entities WHERE z > $k", [{"k": 0.01}, {"k": 0.02}]),
    ("SELECT name FROM entities WHERE id = $id", [{"id": 1}, {"id": 2}, {"id": 2.0}]),
    ("SELECT name FROM entities WHERE z < $1 OR z > $1", [[0.1], [math.inf], [math.nan]]),
    (
        "SELECT count(*) FROM entities WHERE z > $z GROUP BY kind HAVING count(*) > $n",
        [{"z": 0.0, "n": 1}, {"z": 0.0, "n": 3}],
    ),
    ("SELECT name FROM entities ORDER BY id LIMIT $n", [{"n": 2}, {"n": 1}]),
    ("SELECT a.name FROM entities a JOIN entities b ON a.x > b.x + $d", [{"d": 0.1}, {"d": 0.2}]),
    (
        "SELECT '$low' AS text, name FROM entities WHERE z > $low -- $low",
        [{"low": 0.05}, {"low": 9.0}],
    ),
    ("SELECT quantile_cont(z, $q) FROM entities", [{"q": 0.5}, {"q": 0.1}]),
    ("SELECT $n, name FROM entities", [{"n": 1}, {"n": 2}]),  # INTEGER, and not BIGINT
    ("SELECT name FROM entities WHERE kind = $kind", [{"kind": "kinbody"}, {"kind": "robot"}]),
    ("SELECT name FROM entities WHERE (z > $low) = $yes", [{"low": 0.0, "yes": True}]),
    ("SELECT name FROM entities WHERE id < $id", [{"id": 2**40}, {"id": 3 * 2**40}]),
]


@pytest.mark.parametrize(("sql", "values"), WITH_NUMBERS, ids=[case[0] for case in WITH_NUMBERS])
def test_results_with_numbers_are_those_of_duckdb(traced, sql, values):
    ss, _ = traced
    for parameters in values:
        with ss._database.pinned(set()):
            expected = ss._database.connection.table(sql, parameters)
        for _ in range(RUNS):
            found = ss.sql(sql, parameters).arrow()
            assert described(found) == described(expected)
            assert found.schema.types == expected.schema.types


@pytest.mark.parametrize("parameters", [{}, {"high": 0.1}, {"low": 0.1, "high": 0.1}, [0.1, 0.2]])
def test_missing_and_further_parameters_are_errors(traced, parameters):
    ss, _ = traced
    sql = WITH_NUMBERS[0][0]
    for _ in range(RUNS):
        expected = ss.sql(sql, {"low": 0.05}).fetchall()
    for _ in range(RUNS):
        with pytest.raises(SqlError):
            ss.sql(sql, parameters)
    assert ss.sql(sql, {"low": 0.05}).fetchall() == expected


def test_names_of_parameters_that_differ_by_case_are_not_confused(traced):
    ss, _ = traced
    sql = "SELECT name FROM entities WHERE z > $low"
    for _ in range(RUNS):
        with ss._database.pinned(set()):
            expected = ss._database.connection.table(sql, {"LOW": 0.15}).to_pylist()
        assert ss.sql(sql, {"LOW": 0.15}).arrow().to_pylist() == expected


# -- what a tick leaves for later: nothing else reads it here, as nothing is recorded ----------

TICKS = RUNS_BEFORE_PLAN + 8
# Balls that fall one after the other: the number of contacts grows while the statement is prepared.
BALLS = "".join(
    f"<body name='b{n}' pos='{n} 0 {0.11 + 0.04 * n}'><freejoint/><geom size='.1'/></body>"
    for n in range(8)
)
FALLING = f"<mujoco><worldbody><geom type='plane' size='9 9 1'/>{BALLS}</worldbody></mujoco>"
# The plans of these are not kept: they have two sources, and the order of rows might matter.
STATEMENTS = {
    "SELECT sum(a.z) FROM entities a, entities b WHERE a.name = 'b7' AND b.name = 'b7'": (
        lambda data: data.body("b7").xpos[2]
    ),
    "SELECT sum(a.vz) FROM entities a, entities b WHERE a.name = 'b7' AND b.name = 'b7'": (
        lambda data: data.joint(7).qvel[2]
    ),
    "SELECT sum(a.zmax) FROM entities a, entities b WHERE a.name = 'b7' AND b.name = 'b7'": (
        lambda data: data.body("b7").xpos[2] + 0.1
    ),
    "SELECT count(*) + 0 * sum(c.force) FROM contacts c, entities e WHERE e.id = c.b": (
        lambda data: data.ncon
    ),
    "SELECT count(*) + 0 * sum(e.zmax) FROM contacts c, entities e WHERE e.id = c.b": (
        lambda data: data.ncon
    ),
}


@pytest.mark.slow
@sampled("sql", STATEMENTS, every=2)
@pytest.mark.parametrize(
    "recording",
    [None, ssduck.Recording(every=4), ssduck.Recording(tables=("entities",))],
    ids=["unrecorded", "each fourth tick", "entities"],
)
def test_a_prepared_statement_reads_the_present_tick(sql, recording):
    model, data = simulated(FALLING)
    expected = []
    with ssduck.Interpreter(recording=recording) as ss:
        ss.add_variable("sim", ssduck.World.attach(model, data))
        world = ss.call_variable("sim")
        for _ in range(TICKS):
            for _ in range(12):
                mujoco.mj_step(model, data)
            mujoco.mj_forward(model, data)
            world.tick()
            ((value,),) = ss.sql(sql).fetchall()
            expected.append(STATEMENTS[sql](data))
            assert (value or 0) == pytest.approx(expected[-1], rel=1e-12), f"tick {len(expected)}"
    assert len(set(expected)) > TICKS // 2  # it changed meanwhile


@pytest.mark.filterwarnings("ignore:b0. the simulator gives a pose")
def test_a_plan_is_made_anew_after_numbers_were_unknown():
    model = mujoco.MjModel.from_xml_string(FALLING)
    data = mujoco.MjData(model)
    counts = {0.5: 81, float("nan"): 72, 0.7: 81}
    with ssduck.Interpreter(recording=None) as ss:
        world = ss.add_variable("sim", ssduck.World.attach(model, data))
        for height, wanted in counts.items():
            data.qpos[2] = height
            mujoco.mj_kinematics(model, data)
            world.tick()
            for _ in range(RUNS_BEFORE_PLAN + 3):
                ((count,),) = ss.sql("SELECT count(a.z) FROM entities a, entities b").fetchall()
                assert count == wanted


def test_a_users_prepared_statement_reads_what_has_replaced_its_tables():
    client = pybullet.connect(pybullet.DIRECT)
    ball = {"radius": 0.1}
    solid(client, pybullet.GEOM_SPHERE, 1, [0, 0, 2], **ball)
    texts = {
        "SELECT count(*), max(x) FROM entities": lambda last: (last + 1, 10.0 * last),
        "SELECT count(*), max(x) FROM links": lambda last: (last + 1, 10.0 * last),
    }
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("sim", ssduck.World.attach(client))
        for number, text in enumerate(texts):
            ss.sql(f"PREPARE mine{number} AS {text}")
        last = 0
        for count in (1, 40, 200):
            for _ in range(count):
                last += 1
                solid(client, pybullet.GEOM_SPHERE, 1, [10 * last, 0, 2], **ball)
            world.tick()
            for number, (text, expected) in enumerate(texts.items()):
                for _ in range(RUNS):
                    assert ss.sql(f"EXECUTE mine{number}").fetchall() == [expected(last)]
                    assert ss.sql(text).fetchall() == [expected(last)]
        ss.sql("DEALLOCATE mine0")


def test_a_prepared_statement_has_the_margins_of_the_tick():
    model, data = simulated(
        "<mujoco><worldbody><body name='a' pos='0 0 1'><freejoint/><geom size='.05'/></body>"
        "<body name='b' pos='0.12 0 1'><freejoint/><geom size='.05'/></body></worldbody></mujoco>"
    )
    query = "SELECT count(*) FROM entities a, entities b WHERE a.id < b.id AND touching(a, b)"
    program = "SELECT id FROM sim WHERE touching(this, sim.a) AS list;"
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("sim", ssduck.World.attach(model, data))
        ss.sql(f"PREPARE mine AS {query}")
        for margin in (0.0, 0.03, 0.0):  # m, of each shape; they are 0.02 m apart
            model.geom_margin[:] = margin
            world.tick()
            for _ in range(RUNS):
                assert ss.sql("EXECUTE mine").fetchall() == [(int(margin > 0),)]
                assert ss.sql(query).fetchall() == [(int(margin > 0),)]
                assert ss.eval(program) == (["b"] if margin else [])
