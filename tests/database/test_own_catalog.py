"""A mistake in a user's SQL leaves ssduck's own views, records and statements as they were."""

from pathlib import Path

import pytest

import ssduck
from ssduck.errors import SqlError
from tests.support.cases import sampled

ROOM = Path(__file__).parents[1] / "data" / "room.toml"


@pytest.fixture
def ss():
    with ssduck.load(ROOM) as ss:
        ss.call_variable("room").step(3)
        yield ss


def answers(ss):
    """The answers of both languages to questions of the present and the past."""
    return (
        ss.sql("SELECT id, z FROM room.entities").fetchall(),
        ss.sql("SELECT count(*) FROM entities_history WHERE tick <= 4").fetchall(),
        ss.sql(
            "SELECT a.id FROM entities a, entities b WHERE room.touching(a, b) ORDER BY ALL"
        ).fetchall(),
        ss.eval("SELECT id(this) FROM room WHERE z(this) > 0.5 AS list;"),
        ss.eval("SELECT id(this) FROM room{0} WHERE z(this) > 0.5 AS list;"),
    )


OWN = "is ssduck's own and was made anew"
RECORD = "holds what ssduck has recorded"
TRANSACTION = "a transaction begins and ends in one call"

MISTAKES = [
    ("DROP VIEW room.entities", OWN),
    ("drop view ROOM.Entities", OWN),
    ("DROP VIEW room.entities_history", OWN),
    ("DROP MACRO room.touching", OWN),
    ("DROP SCHEMA room CASCADE", OWN),
    ("ALTER VIEW room.entities RENAME TO things", OWN),
    ("CREATE OR REPLACE VIEW room.entities AS SELECT 1 AS id", OWN),
    ("CREATE OR REPLACE MACRO room.touching(a, b) AS true", OWN),
    ('DROP VIEW "world 1: entities"', OWN),
    ('CREATE OR REPLACE TEMP VIEW "world 1: entities" AS SELECT 1', OWN),
    ("CREATE TABLE mine (a INTEGER); DROP VIEW room.entities", OWN),
    ("BEGIN; DROP VIEW room.entities; COMMIT", OWN),
    ("ATTACH ':memory:' AS room", "is the name of a world"),
    ("DROP SCHEMA room_record_0 CASCADE", RECORD),
    ('DROP TABLE "ROOM_record_0"."entities model"', RECORD),
    ('DELETE FROM room_record_0."entities model"', RECORD),
    ('INSERT INTO room_record_0."entities model" SELECT * FROM range(3)', RECORD),
    ('UPDATE room_record_0."entities model" SET id = 1', RECORD),
    ('EXPLAIN ANALYZE DELETE FROM room_record_0."entities model"', RECORD),
    ('EXPLAIN (ANALYZE) UPDATE room_record_0."entities model" SET id = 1', RECORD),
    ('SELECT 1; explain analyze TRUNCATE room_record_0."entities model"', RECORD),
    ("EXPLAIN ANALYZE DROP VIEW room.entities", OWN),
    ('INSERT INTO /* mine */ room_record_0."ssduck record" DEFAULT VALUES', RECORD),
    ("WITH s AS (SELECT ' INTO mine') INSERT INTO room_record_0.\"ssduck record\" FROM s", RECORD),
    ('CREATE /* AS */ OR REPLACE TABLE room_record_0."ssduck record" AS SELECT 1', RECORD),
    ("COPY -- from\n room_record_0.\"entities model\" FROM 'entities.csv'", RECORD),
    ('CREATE INDEX "as it is" ON room_record_0."entities model" (id)', RECORD),
    (
        "CREATE TABLE mine (a INTEGER); CREATE TRIGGER more AFTER INSERT ON mine "
        'DELETE FROM room_record_0."entities model"',
        RECORD,
    ),
    (
        "CREATE TABLE mine AS "
        'WITH x AS (DELETE FROM room_record_0."entities model" RETURNING *) FROM x',
        RECORD,
    ),
    (
        'COPY (WITH x AS (DELETE FROM room_record_0."entities model" RETURNING *) FROM x) '
        "TO '/dev/null'",
        RECORD,
    ),
    (
        'WITH x AS (DELETE FROM room_record_0."entities model" RETURNING *) SELECT count(*) FROM x',
        RECORD,
    ),
    (
        'WITH x AS /**/ ( -- the model\n UPDATE room_record_0."entities model" SET id = 1) FROM x',
        RECORD,
    ),
    ("CREATE TABLE room_record_0.mine AS SELECT 1", RECORD),
    ("USE room_record_0", RECORD),
    ("SET schema = 'ROOM_record_0'; DELETE FROM \"ssduck record\"", RECORD),
    ("SET search_path TO $$room_record_0$$", RECORD),
    (
        "SET schema = concat('room_', 'record_0'); DELETE FROM \"ssduck record\"",
        "SET schema takes a name that is written out",
    ),
    ("SELECT 1; SET SESSION search_path TO 'room' || '_record_0'", "SET search_path takes a name"),
    ("SET schema = E'room\\x5frecord_0'", "SET schema takes a name"),
    ("SET \"Schema\" /* = 'main' */ = lower('ROOM_') || 'record_0'", "SET schema takes a name"),
    ("PRAGMA search_path = concat('room_', 'record_0')", "SET search_path takes a name"),
    ("SET VARIABLE x = 'room_'; SET schema = getvariable('x')", "SET schema takes a name"),
    ("UPDATE EXTENSIONS", "SQL has no such statement here: 'UPDATE EXTENSIONS'$"),
    ("ATTACH IF NOT EXISTS ':memory:' AS other; USE other", "name its tables in full"),
    ('PREPARE mine AS DELETE FROM room_record_0."entities model"', RECORD),
    ('PREPARE "ssduck statement 1 entities" AS SELECT 1', "are ssduck's own"),
    ('DEALLOCATE "ssduck statement 1 entities"', "are ssduck's own"),
    ("BEGIN", TRANSACTION),
    ("COMMIT", TRANSACTION),
    ("BEGIN; BEGIN; COMMIT", TRANSACTION),
    ("BEGIN; SELECT 1", TRANSACTION),
    ("BEGIN; CREATE TABLE mine (a INTEGER); SELECT error('no'); COMMIT", "no"),
]


@pytest.fixture(scope="module")
def lasting():
    with ssduck.load(ROOM) as ss:
        ss.call_variable("room").step(3)
        yield ss, answers(ss)


@pytest.mark.slow
@sampled(("text", "words"), MISTAKES, every=4)
def test_a_mistake_is_an_error_and_all_else_goes_on(lasting, text, words):
    ss, before = lasting
    with pytest.raises(SqlError, match=words):
        ss.sql(text)
    assert answers(ss) == before
    ss.call_variable("room").tick()
    assert answers(ss) == before
    ss.sql("DROP TABLE IF EXISTS mine")


@pytest.mark.slow
@pytest.mark.parametrize("text", ["SET schema = DEFAULT", "RESET schema", "RESET search_path"])
def test_the_schemas_of_duckdb_change_nothing_of_worlds(ss, text):
    """Only the schema that may be left out is another one, until `USE` names it again."""
    before = ss.sql("SELECT count(*) FROM entities").fetchall(), answers(ss)
    ss.sql(text)
    with pytest.raises(SqlError, match=r'Did you mean "room\.entities"'):
        ss.sql("SELECT count(*) FROM entities")
    assert ss.sql("SELECT count(*) FROM room.entities").fetchall() == before[0]
    ss.sql("USE room")
    assert (ss.sql("SELECT count(*) FROM entities").fetchall(), answers(ss)) == before


@pytest.mark.slow
def test_what_users_create_is_theirs(ss, tmp_path):
    ss.sql("BEGIN; CREATE TABLE mine AS SELECT 1 AS a; INSERT INTO mine VALUES (2); COMMIT")
    assert ss.sql("SELECT sum(a) FROM mine").fetchall() == [(3,)]
    ss.sql("CREATE TABLE room.notes AS SELECT name FROM entities")
    ss.sql("CREATE VIEW high AS SELECT name FROM room.entities WHERE z > 0.5")
    ss.sql("CREATE TABLE past AS SELECT * FROM room.entities_history")
    ss.sql(f"COPY (SELECT * FROM room.entities) TO '{tmp_path / 'rows.csv'}'")
    ss.sql("ALTER TABLE room.notes RENAME TO remarks")
    assert ss.sql("SELECT count(*) FROM high").fetchall()
    ss.sql("DROP TABLE room.remarks")
    ss.sql("DROP TABLE mine")


READING = [
    "COPY room.entities_history TO '{}'",
    "COPY room.entities_history (id, name) TO '{}' (FORMAT csv)",
    "COPY (FROM room.entities_history) TO '{}'",
]


@pytest.mark.slow
@pytest.mark.parametrize("text", READING)
def test_copies_of_a_record_may_be_written(lasting, tmp_path, text):
    ss, before = lasting
    ss.sql(text.format(tmp_path / "rows.csv"))
    assert len((tmp_path / "rows.csv").read_text().splitlines()) > 1
    assert answers(ss) == before


@pytest.mark.parametrize(
    "text",
    [
        "SELECT 'WITH x AS (DELETE FROM room_record_0.\"entities model\")'",
        "WITH x AS (SELECT 1) SELECT '(UPDATE room_record_0.a' FROM x -- (INSERT INTO room_record_0",
    ],
)
def test_a_text_that_looks_like_a_change_is_a_text(lasting, text):
    ss, _ = lasting
    assert len(ss.sql(text).fetchall()) == 1


@pytest.mark.slow
def test_the_schemas_that_may_be_omitted(ss):
    ss.sql("CREATE SCHEMA other; CREATE TABLE other.mine AS SELECT 7 AS a")
    for text in ("SET schema = other", "SET search_path TO 'room,other'", "SET SCHEMA 'other';"):
        ss.sql(text)
        assert ss.sql("FROM mine").fetchall() == [(7,)]
    ss.sql("SET VARIABLE schema = concat('a', 'b')")
    with pytest.raises(SqlError, match="SET schema takes a name"):
        ss.sql("SET schema = $1", ["room_record_0"])


@pytest.mark.slow
def test_a_failing_transaction_is_undone(ss):
    with pytest.raises(SqlError, match="no"):
        ss.sql("BEGIN; CREATE TABLE mine (a INTEGER); SELECT error('no'); COMMIT")
    with pytest.raises(SqlError, match="mine does not exist"):
        ss.sql("SELECT * FROM mine")


@pytest.mark.slow
def test_a_file_keeps_its_record(tmp_path):
    path = tmp_path / "run.db"
    with ssduck.load(ROOM, path) as ss:
        ss.call_variable("room").step(3)
        for text in (
            "DROP SCHEMA room_record_0 CASCADE",
            "DROP SCHEMA room CASCADE",
            "RESET search_path",
            'EXPLAIN ANALYZE DELETE FROM room_record_0."ssduck record"',
        ):
            with pytest.raises(SqlError):
                ss.sql(text)
        ss.sql("CREATE TABLE summary AS SELECT max(tick) AS t FROM room.entities_history")
        before = answers(ss)
    with ssduck.open(path) as ss:
        assert answers(ss) == before


@pytest.mark.slow
def test_a_query_that_changes_rows_runs_once(ss):
    ss.sql("CREATE TABLE mine (a INTEGER)")
    for count in range(1, 8):
        text = "WITH x AS (INSERT INTO mine VALUES (3) RETURNING a) SELECT a, x.a FROM x, ticks"
        assert ss.sql(text).fetchall() == [(3, 3)]
        assert ss.sql("SELECT count(*) FROM mine").fetchone() == (count,)
