"""Opening a record does little: views and functions are made when a statement names them."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import pybullet
import pytest

import ssduck
from ssduck import Recording
from ssduck.database import connection as connections
from ssduck.database.connection import Connection
from ssduck.database.instances import MAX_WAITING, InstancePool
from ssduck.database.on_demand import OnDemand
from ssduck.database.schemas import Schemas
from ssduck.errors import SqlError
from ssduck.limits import UsageMeter
from ssduck.recording.recorder import BUFFERED_TICKS
from ssduck.schema import HISTORIES, MODELS, TABLES
from tests.support.cases import sampled

BODIES = 5
TICKS = 20


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small record in a folder."""
    place = tmp_path_factory.mktemp("small") / "run"
    client = pybullet.connect(pybullet.DIRECT)
    box = pybullet.createCollisionShape(
        pybullet.GEOM_BOX, halfExtents=[0.1, 0.1, 0.1], physicsClientId=client
    )
    names = {
        pybullet.createMultiBody(
            1, box, basePosition=[0.3 * n, 0, 1 + n], physicsClientId=client
        ): f"box_{n}"
        for n in range(BODIES)
    }
    with ssduck.Interpreter(recording=None) as ss:
        world = ss.add_variable("lab", ssduck.World.attach(client, names=names))
        with ss.record_to(place, recording=Recording(tables=("entities", "contacts"))):
            for _ in range(TICKS - 1):
                world.step()
    pybullet.disconnect(client)
    return place


# Counts what a database has of its own.
LEFT = "SELECT count(*) FROM duckdb_{}() WHERE NOT internal"


@pytest.fixture
def pool(monkeypatch: pytest.MonkeyPatch) -> InstancePool:
    """A pool of databases of the test's own."""
    own = InstancePool()
    monkeypatch.setattr(connections, "POOL", own)
    return own


class Count:
    """Counts the statements that run, and has their texts."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.statements: list[str] = []
        execute = Connection._execute

        def counted(own: Connection, sql: str, *arguments: object, **options: object) -> object:
            self.statements.append(sql)
            return execute(own, sql, *arguments, **options)  # type: ignore[arg-type]

        monkeypatch.setattr(Connection, "_execute", counted)

    def take(self) -> list[str]:
        """Returns the statements since the last call."""
        statements, self.statements = self.statements, []
        return statements


def _views(ss: ssduck.Interpreter) -> set[str]:
    sql = "SELECT view_name FROM duckdb_views() WHERE schema_name = 'lab'"
    return {name for (name,) in ss._database.connection.internal_rows(sql)}


def _functions(ss: ssduck.Interpreter) -> set[str]:
    return set(ss._database.connection._functions)


@pytest.mark.slow
def test_a_program_makes_what_it_names(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    count = Count(monkeypatch)
    with ssduck.open(run) as ss:
        # The schema, beside the settings.
        settings = ("SET ", "SELECT current_setting")
        assert len([sql for sql in count.take() if not sql.startswith(settings)]) == 1
        assert (_views(ss), _functions(ss)) == (set(), set())
        count.take()
        assert len(ss.eval("SELECT id FROM lab{} WHERE z > 2.5 AS list;")) == 3 * TICKS
        created = [sql for sql in count.take() if sql.startswith("CREATE")]
        assert len(created) == 1
        assert _views(ss) == {"entities_history"}
        count.take()
        ss.eval("SELECT id FROM lab{} WHERE z > 2.5 AS list;")
        assert not [sql for sql in count.take() if sql.startswith("CREATE")]
        ss.add_variable("box_0", ss.call_variable("lab")["box_0"])
        assert _functions(ss) == set()
        gaps = ss.eval("SELECT clearance(this, box_0) FROM lab AS list;")
        assert len([gap for gap in gaps if gap > 0.5]) == BODIES - 1
        assert "entities" in _views(ss)
        assert len(_functions(ss)) == 1
        assert not _views(ss) & {"links", "joints", "shapes", "links_history", "shapes_model"}


def _macros(ss: ssduck.Interpreter) -> set[tuple[str, str]]:
    sql = (
        "SELECT schema_name, function_name FROM duckdb_functions() "
        "WHERE NOT internal AND function_type IN ('macro', 'table_macro')"
    )
    return set(ss._database.connection.internal_rows(sql))


@pytest.mark.slow
def test_a_users_query_makes_what_it_names(run: Path) -> None:
    with ssduck.open(run) as ss:
        assert ss.sql("SELECT 1").fetchall() == [(1,)]
        assert (_views(ss), _functions(ss), _macros(ss)) == (set(), set(), set())
        pairs = "FROM entities a, entities b WHERE a.name = 'box_1' AND b.name = 'box_0'"
        assert ss.sql(f"SELECT ABOVE(a, b) {pairs}").fetchall() == [(False,)]
        assert (_views(ss), _functions(ss)) == ({"entities"}, set())
        named = {"above", "name"}  # a relation is called name
        assert _macros(ss) == {(schema, name) for schema in ("main", "lab") for name in named}
        (gaps,) = ss.sql(f'SELECT "Clearance"(a, b), lab.clearance(a, b) {pairs}').fetchall()
        assert gaps[0] == gaps[1] > 0
        assert {schema for schema, name in _macros(ss) if name == "clearance"} == {"main", "lab"}
        assert len(ss.sql("SELECT * FROM pairs_within(5)")) == BODIES * (BODIES - 1)
        assert {name for _, name in _macros(ss)} == {"name", "above", "clearance", "pairs_within"}


@pytest.fixture
def file(client: int, tmp_path: Path) -> Path:
    """A small record in a DuckDB file."""
    pybullet.createMultiBody(1, physicsClientId=client)
    with ssduck.Interpreter(tmp_path / "run.duckdb") as ss:
        ss.add_variable("lab", ssduck.World.attach(client, names={0: "box"})).step()
    return tmp_path / "run.duckdb"


@pytest.mark.slow
def test_a_query_of_a_file_makes_what_it_names(file: Path) -> None:
    with ssduck.open(file) as ss:
        assert ss.sql("SELECT count(*) FROM entities_history").fetchall() == [(2,)]
        assert not _macros(ss)
        pairs = "FROM entities_history a JOIN entities_history b USING (tick)"
        assert ss.sql(f"SELECT above(a, b) {pairs}").fetchall() == [(False,), (False,)]
        assert {name for _, name in _macros(ss)} == {"above", "tick"}  # relations, both


@pytest.mark.slow
def test_views_in_a_file_find_everything(file: Path) -> None:
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
def test_the_catalog_has_everything(run: Path, sql: str) -> None:
    with ssduck.open(run) as ss:
        names = {*TABLES, *(t.history_view for t in HISTORIES.values())}
        shown = {name for (name,) in ss.sql(sql).fetchall()}
        assert shown >= (names if "DESCRIBE" not in sql else set())
        assert _views(ss) == names | {table.model_view for table in MODELS.values()}
        assert _macros(ss) >= {("main", "above"), ("lab", "clearance"), ("main", "intervals")}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sql", "suggested"),
    [
        ("SELECT abovee(a, a) FROM entities a", '"above"'),
        ("SELECT * FROM pairs_withn(1)", '"pairs_within"'),
        ("SELECT * FROM contacts_histori", '"contacts_history"'),
    ],
)
def test_a_message_suggests_names_that_no_statement_had(
    run: Path, sql: str, suggested: str
) -> None:
    with ssduck.open(run) as ss, pytest.raises(SqlError, match=suggested):
        ss.sql(sql)


@pytest.mark.slow
def test_a_users_own_views_and_macros_find_everything(run: Path) -> None:
    with ssduck.open(run) as ss:
        ss.sql("SELECT 'entities'").fetchall()
        ss.sql("CREATE MACRO up(a, b) AS above(a, b)")
        ss.sql("CREATE VIEW first_two AS SELECT * FROM entities LIMIT 2")
        query = "SELECT count(*) FROM first_two a, first_two b WHERE up(a, b)"
        assert ss.sql(query).fetchall() == [(0,)]


@pytest.mark.slow
def test_macros_follow_the_worlds(run: Path) -> None:
    touching = "SELECT count(*) FROM lab.entities a, lab.entities b WHERE {}clearance(a, b) < 5"
    with ssduck.open(run) as ss:
        (alone,) = ss.sql(touching.format("")).fetchall()
        ss.sql("SELECT * FROM colliding_pairs()")
        ss.add_variable("other", ss.call_variable("lab").what_if())
        with pytest.raises(SqlError, match=r"world\.clearance"):
            ss.sql(touching.format("")).fetchall()
        assert ss.sql(touching.format("lab.")).fetchall() == [alone]
        assert ss.sql("SELECT * FROM lab.colliding_pairs()").fetchall() == []


@pytest.mark.slow
def test_a_users_statement_finds_everything(run: Path) -> None:
    with ssduck.open(run) as ss:
        ((count,),) = ss.sql("SELECT count(*) FROM entities_history").fetchall()
        assert count == BODIES * TICKS
        ((links,),) = ss.sql("SELECT count(*) FROM lab.links").fetchall()
        assert links == BODIES


@pytest.mark.slow
def test_a_program_and_a_statement_agree_in_any_order(run: Path) -> None:
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


@pytest.mark.slow
def test_a_recording_that_begins_anew_has_new_views(client: int) -> None:
    pybullet.createMultiBody(1, physicsClientId=client)
    with ssduck.Interpreter(recording=Recording(tables=("entities",))) as ss:
        world = ss.add_variable("lab", ssduck.World.attach(client))
        world.step()
        count = "SELECT tick(this) FROM lab{} AS list;"
        assert ss.eval(count) == [1, 2]
        ss.record("lab", Recording(tables=("entities",)))
        world.step()
        assert ss.eval(count) == [2, 3]
        assert ss.sql("SELECT tick FROM lab.entities_history ORDER BY 1").fetchall() == [(2,), (3,)]


# -- databases that are used again ----------------------------------------------------------------


@pytest.mark.slow
def test_a_database_is_used_again(run: Path, pool: InstancePool) -> None:
    instances = []
    for _ in range(3):
        with ssduck.open(run) as ss:
            instances.append(ss._database.connection._instance)
            assert _views(ss) == _functions(ss) == set()
            ss.add_function("twice", lambda value: 2 * value)
            found = ss.eval("SELECT twice(z) FROM lab{} WHERE id(this) == 'box_1' AS list;")
            assert len(found) == TICKS
        with pytest.raises(SqlError, match="the interpreter is closed"):
            ss.sql("SELECT 1")
    assert all(instance is instances[0] for instance in instances)
    pool.close()


@pytest.mark.slow
def test_a_database_that_a_user_wrote_to_is_not(run: Path, pool: InstancePool) -> None:
    with ssduck.open(run) as ss:
        ss.sql("CREATE TABLE main.mine AS SELECT 1")
        ss.sql("SET threads = 2")
    with ssduck.open(run) as ss:
        tables = ss.sql("SELECT table_name FROM information_schema.tables").fetchall()
        assert ("mine",) not in tables
        assert ss.sql("SELECT current_setting('threads')").fetchall() == [(1,)]
    assert not pool._waiting


@pytest.mark.slow
def test_a_database_whose_memory_was_limited_has_no_limit(run: Path, pool: InstancePool) -> None:
    """Opening a record and SelectScript do not seal it, as users' SQL does."""
    select = "SELECT name, value FROM duckdb_settings()"
    with ssduck.open(run) as ss:
        ss.eval("SELECT this FROM [1, 2] AS list;")
    (database,) = pool._waiting
    before = database.execute(select).fetchall()
    with ssduck.open(run, limits=ssduck.Limits.strict().in_process) as ss:
        ss.eval("SELECT this FROM [1, 2] AS list;")
        assert not pool._waiting
    assert pool._waiting == [database]
    assert database.execute(select).fetchall() == before
    pool.close()


def test_limits_end_with_their_interpreter(run: Path, pool: InstancePool) -> None:
    strict = ssduck.Interpreter(limits=ssduck.Limits.strict().in_process)
    strict.eval("SELECT this FROM [1, 2] AS list;")
    strict.close()
    with ssduck.open(run) as ss:
        ((allowed,),) = ss.sql("SELECT current_setting('enable_external_access')").fetchall()
        assert allowed
    assert not pool._waiting


@pytest.mark.slow
@pytest.mark.parametrize("changed", [False, True])
def test_recorded_ticks_leave_nothing(client: int, pool: InstancePool, changed: bool) -> None:
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
def test_an_opened_record_leaves_nothing(run: Path, pool: InstancePool) -> None:
    """Schemas that ssduck made are known, those of other connections are asked for."""
    for _ in range(2):
        with ssduck.open(run) as ss:
            assert ss.eval("SELECT id FROM lab{} LIMIT 1 AS list;")
            assert "lab" in ss._database.connection._schemas
        (database,) = pool._waiting
        with closing(database.cursor()) as cursor:
            for kind in ("tables", "views", "functions", "types"):
                assert cursor.execute(LEFT.format(kind)).fetchall() == [(0,)], kind
            schemas = cursor.execute(LEFT.format("schemas") + " AND schema_name <> 'main'")
            assert schemas.fetchall() == [(0,)]
    pool.close()


@pytest.mark.slow
def test_few_databases_wait(run: Path, pool: InstancePool) -> None:
    opened = [ssduck.open(run) for _ in range(MAX_WAITING + 2)]
    for ss in opened:
        ss.close()
    assert len(pool._waiting) == MAX_WAITING
    pool.close()


@pytest.mark.slow
def test_a_file_is_let_go(tmp_path: Path, pool: InstancePool, client: int) -> None:
    path = tmp_path / "run.duckdb"
    for _ in range(2):
        with ssduck.Interpreter(str(path)) as ss:
            ss.add_variable("lab", ssduck.World.attach(client))
        for _ in range(2):  # nothing keeps it from being recorded into again
            with ssduck.open(path) as ss:
                assert len(ss.eval("SELECT tick(this) FROM lab{} AS list;")) == 0
                assert ss.past("lab").ticks == [1]
    pool.close()


def test_what_is_left_out_is_made_for_another_statement() -> None:
    """Of statements within one another, each has its own names left out."""
    made: list[str] = []
    on_demand: OnDemand[None] = OnDemand()
    on_demand.offer(("lab", "entities_history"), lambda _: made.append("entities_history"))
    select = "SELECT * FROM lab.entities_history"
    with on_demand.without([("lab", "entities_history")]):
        on_demand.provide(select, None)
        assert (made, on_demand.leaves_out) == ([], True)
        with on_demand.without(()):
            on_demand.provide(select, None)
        assert made == ["entities_history"]
    on_demand.offer(("lab", "entities_history"), lambda _: made.append("again"))
    with on_demand.without([("lab", "entities_history")]):
        on_demand.provide(select, None)
    on_demand.provide(select, None)  # it is not taken for a statement that has all it needs
    assert made == ["entities_history", "again"]
    assert not on_demand.leaves_out


@pytest.mark.slow
@pytest.mark.parametrize("is_late", [False, True])
def test_a_refused_statement_is_told_also_if_its_time_ends_meanwhile(
    run: Path, monkeypatch: pytest.MonkeyPatch, is_late: bool
) -> None:
    """All views and macros are made for DuckDB's suggestions, which may take long."""
    provide = Schemas.provide
    described = []

    def slowly(schemas: Schemas, *arguments: Any) -> None:
        provide(schemas, *arguments)
        has_all = arguments[-1] is not None
        described.extend([arguments] * has_all)
        if is_late and has_all:
            late = UsageMeter(ssduck.Limits(seconds=1e-9))
            monkeypatch.setattr(ss._database.connection, "meter", late)

    monkeypatch.setattr(Schemas, "provide", slowly)
    with ssduck.open(run, limits=ssduck.Limits(seconds=600)) as ss:
        with pytest.raises(SqlError, match="clearanse") as caught:
            ss.sql("SELECT clearanse(a, b) FROM entities a, entities b")
        assert len(described) == 1
        assert ('"clearance"' in caught.value.message) != is_late
        assert ss.sql("SELECT 42").fetchall() == [(42,)]
