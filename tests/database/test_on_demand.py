"""Opening a record does little: views and functions are made when a statement names them."""

from contextlib import closing

import pybullet
import pytest

import ssduck
from ssduck import Recording
from ssduck.database import connection as connections
from ssduck.database.connection import OnDemand
from ssduck.database.instances import InstancePool
from ssduck.database.schemas import Schemas
from ssduck.errors import SqlError
from ssduck.limits import UsageMeter
from ssduck.recording.recorder import BUFFERED_TICKS
from ssduck.schema import HISTORIES, MODELS, TABLES
from tests.support.cases import sampled
from tests.support.stage import Stage

BODIES = 5
TICKS = 20


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A small record in a folder."""
    place = tmp_path_factory.mktemp("small") / "run"
    with Stage() as stage, ssduck.Interpreter(recording=None) as ss:
        for n in range(BODIES):
            stage.box(f"box_{n}", (0.3 * n, 0, 1 + n), half=0.1, mass=1)
        world = ss.add_variable("lab", stage.open())
        with ss.record_to(place, recording=Recording(tables=("entities", "contacts"))):
            for _ in range(TICKS - 1):
                world.step()
    return place


# Counts what a database has of its own.
LEFT = "SELECT count(*) FROM duckdb_{}() WHERE NOT internal"


@pytest.fixture
def pool(monkeypatch):
    """A pool of databases of the test's own."""
    own = InstancePool()
    monkeypatch.setattr(connections, "POOL", own)
    return own


VIEWS = "SELECT view_name FROM duckdb_views() WHERE schema_name = 'lab'"
MACROS = """
    SELECT schema_name, function_name FROM duckdb_functions()
    WHERE NOT internal AND function_type IN ('macro', 'table_macro')
"""


@pytest.fixture
def file(client, tmp_path):
    """A small record in a DuckDB file."""
    pybullet.createMultiBody(1, physicsClientId=client)
    with ssduck.Interpreter(tmp_path / "run.duckdb") as ss:
        ss.add_variable("lab", ssduck.World.attach(client, names={0: "box"})).step()
    return tmp_path / "run.duckdb"


@pytest.mark.slow
def test_views_in_a_file_find_everything(file):
    names = ("mine", "contacts_history")  # the second is a name of ssduck's own
    with ssduck.Interpreter(file) as ss:
        for name in names:
            ss.sql(
                f"CREATE VIEW main.{name} AS SELECT a.tick FROM lab.entities_history a, "
                "lab.entities_history b WHERE above(a, b) OR a.tick = b.tick"
            )
    for name in names:
        with ssduck.Interpreter(file) as ss:
            assert len(ss.sql(f"SELECT * FROM main.{name}").fetchall()) == 2


CATALOG = [
    "SELECT table_name FROM information_schema.tables",
    "SELECT view_name FROM duckdb_views()",
    "SELECT viewname FROM pg_views",
    "SELECT name FROM (SHOW ALL TABLES)",
    "FROM (DESCRIBE) SELECT name",
    "SELECT * FROM query('FROM ' || 'duckdb_' || 'views() SELECT view_name')",
]


@pytest.mark.slow
@sampled("sql", CATALOG, every=3)
def test_the_catalog_has_everything(run, sql):
    with ssduck.open(run) as ss:
        names = {*TABLES, *(t.history_view for t in HISTORIES.values())}
        shown = {name for (name,) in ss.sql(sql).fetchall()}
        assert shown >= (names if "DESCRIBE" not in sql else set())
        views, macros = map(ss._database.connection.internal_rows, (VIEWS, MACROS))
        assert {name for (name,) in views} == names | {t.model_view for t in MODELS.values()}
        assert set(macros) >= {("main", "above"), ("lab", "clearance"), ("main", "intervals")}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sql", "suggested"),
    [
        ("SELECT abovee(a, a) FROM entities a", '"above"'),
        ("SELECT * FROM pairs_withn(1)", '"pairs_within"'),
        ("SELECT * FROM contacts_histori", '"contacts_history"'),
    ],
)
def test_a_message_suggests_names_that_no_statement_had(run, sql, suggested):
    with ssduck.open(run) as ss, pytest.raises(SqlError, match=suggested):
        ss.sql(sql)


@pytest.mark.slow
def test_a_users_own_views_and_macros_find_everything(run):
    with ssduck.open(run) as ss:
        ss.sql("SELECT 'entities'").fetchall()
        ss.sql("CREATE MACRO up(a, b) AS above(a, b)")
        ss.sql("CREATE VIEW first_two AS SELECT * FROM entities LIMIT 2")
        query = "SELECT count(*) FROM first_two a, first_two b WHERE up(a, b)"
        assert ss.sql(query).fetchall() == [(0,)]


@pytest.mark.slow
def test_a_program_and_a_statement_agree_in_any_order(run):
    program = "SELECT id FROM lab{} WHERE above(box_0, this) AS list;"
    sql = "SELECT b.name FROM entities_history a, entities_history b WHERE above(a, b) "
    sql += "AND a.tick = b.tick AND a.name = 'box_0' ORDER BY b.tick, b.id"
    answers = []
    for first in (program, sql):
        with ssduck.open(run) as ss:
            ss.add_variable("box_0", ss.call_variable("lab")["box_0"])
            other = sql if first is program else program
            for text in (first, other):
                values = ss.eval(text) if text is program else ss.sql(text).fetchall()
                answers.append([v if text is program else v[0] for v in values])
    assert all(answer == answers[0] for answer in answers)


# -- databases that are used again ----------------------------------------------------------------


@pytest.mark.slow
def test_a_database_that_a_user_wrote_to_is_not(run, pool):
    with ssduck.open(run) as ss:
        ss.sql("CREATE TABLE main.mine AS SELECT 1")
        ss.sql("SET threads = 2")
    with ssduck.open(run) as ss:
        tables = ss.sql("SELECT table_name FROM information_schema.tables").fetchall()
        assert ("mine",) not in tables
        assert ss.sql("SELECT current_setting('threads')").fetchall() == [(1,)]
    assert not pool._waiting


@pytest.mark.slow
def test_a_database_whose_memory_was_limited_has_no_limit(run, pool):
    """Opening a record and SelectScript do not seal it, as users' SQL does."""
    select = "SELECT name, value FROM duckdb_settings()"
    with ssduck.open(run) as ss:
        ss.eval("SELECT this FROM [1, 2] AS list;")
    (database,) = pool._waiting
    before = database.execute(select).fetchall()
    with ssduck.open(run, limits=ssduck.Limits.strict(require=())) as ss:
        ss.eval("SELECT this FROM [1, 2] AS list;")
        assert not pool._waiting
    assert pool._waiting == [database]
    assert database.execute(select).fetchall() == before
    pool.close()


def test_limits_end_with_their_interpreter(run, pool):
    strict = ssduck.Interpreter(limits=ssduck.Limits.strict(require=()))
    strict.eval("SELECT this FROM [1, 2] AS list;")
    strict.close()
    with ssduck.open(run) as ss:
        ((allowed,),) = ss.sql("SELECT current_setting('enable_external_access')").fetchall()
        assert allowed
    assert not pool._waiting


@pytest.mark.slow
@pytest.mark.parametrize("changed", [False, True])
def test_recorded_ticks_leave_nothing(client, pool, changed):
    pybullet.createMultiBody(1, physicsClientId=client)
    for _ in range(3):
        with ssduck.Interpreter(recording=Recording(changed=changed)) as ss:
            world = ss.add_variable("lab", ssduck.World.attach(client))
            assert ss.past("lab").ticks == [world.snapshot.number]
            world.step(BUFFERED_TICKS + 3)
            ss.flush()
            assert len(ss.eval("SELECT z FROM lab{} AS list;")) == BUFFERED_TICKS + 4
        (database,) = pool._waiting
        with closing(database.cursor()) as cursor:
            for kind in ("tables", "views", "functions", "types"):
                assert cursor.execute(LEFT.format(kind)).fetchall() == [(0,)], kind
            schemas = cursor.execute(LEFT.format("schemas") + " AND schema_name <> 'main'")
            assert schemas.fetchall() == [(0,)]
    pool.close()


@pytest.mark.slow
def test_a_file_is_let_go(tmp_path, pool, client):
    path = tmp_path / "run.duckdb"
    for _ in range(2):
        with ssduck.Interpreter(str(path)) as ss:
            ss.add_variable("lab", ssduck.World.attach(client))
        for _ in range(2):  # nothing keeps it from being recorded into again
            with ssduck.open(path) as ss:
                assert len(ss.eval("SELECT tick(this) FROM lab{} AS list;")) == 0
                assert ss.past("lab").ticks == [1]
    pool.close()


def test_what_is_left_out_is_made_for_another_statement():
    """Of statements within one another, each has its own names left out."""
    made = []
    on_demand = OnDemand()
    on_demand.offer(("lab", "entities_history"), lambda _: made.append("rows"))
    select = "SELECT * FROM lab.entities_history"
    with on_demand.without([("lab", "entities_history")]):
        on_demand.provide(select, None)
        assert made == []
        with on_demand.without(()):
            on_demand.provide(select, None)
        assert made == ["rows"]


@pytest.mark.slow
def test_a_refused_statement_is_told_also_if_its_time_ends_meanwhile(run, monkeypatch):
    """All views and macros are made for DuckDB's suggestions, which may take long."""
    provide = Schemas.provide

    def slowly(schemas, *arguments):
        provide(schemas, *arguments)
        if arguments[-1] is not None:
            late = UsageMeter(ssduck.Limits(seconds=1e-9))
            monkeypatch.setattr(ss._database.connection, "meter", late)

    monkeypatch.setattr(Schemas, "provide", slowly)
    with ssduck.open(run, limits=ssduck.Limits(seconds=600)) as ss:
        with pytest.raises(SqlError, match="clearanse"):
            ss.sql("SELECT clearanse(a, b) FROM entities a, entities b")
        assert ss.sql("SELECT 42").fetchall() == [(42,)]
