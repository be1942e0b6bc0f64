"""`Limits(select_only=True)`: SQL is one SELECT."""

import time

import pytest

import ssduck
from ssduck.errors import LimitError, SqlError
from tests.support.cases import sampled


@pytest.fixture(scope="module")
def strict():
    with ssduck.load("kitchen", limits=ssduck.Limits.strict(require=())) as ss:
        yield ss


PERMITTED = [
    "SELECT string_agg(name, ', ' ORDER BY name) FROM entities",
    "SELECT kind, group_concat(name), listagg(name, ';') FROM entities GROUP BY kind ORDER BY kind",
    "SELECT name FROM entities WHERE kind = 'robot'",
    "FROM entities SELECT max(z) GROUP BY kind HAVING count(*) > 1 ORDER BY 1 LIMIT 3",
    "SELECT count(*) FROM kitchen.entities_history",
    "SELECT count(*) FROM memory.kitchen.entities",
    "SELECT a.name FROM entities a, entities b WHERE near(a, b, 0.1) AND NOT kitchen.above(a, b)",
    "SELECT count(*) FROM colliding_pairs(depth := 0.01)",
    "SELECT count(*) FROM kitchen.pairs_within(0.05)",
    "WITH held AS (SELECT time, true AS holds FROM ticks) SELECT * FROM intervals('held')",
    'WITH "world 1: entities" AS (SELECT 1) FROM "world 1: entities"',
    "WITH RECURSIVE n AS (SELECT 1 AS i UNION ALL SELECT i + 1 FROM n WHERE i < 9) FROM n",
    "WITH a AS (SELECT 1), b AS (SELECT * FROM a) SELECT * FROM b, (SELECT * FROM a) AS c",
    "SELECT upper(name).lower(), z::INTEGER, CASE WHEN z > 1 THEN 'high' END FROM entities",
    "SELECT [x + 1 for x in [1, 2]], list_transform([1], lambda x: x + 1), {'a': 1}.a",
    "SELECT rank() OVER (PARTITION BY kind ORDER BY z), avg(z) OVER () FROM entities",
    "SELECT count(*) FILTER (WHERE z > 1) FROM entities WHERE EXISTS (SELECT 1 FROM links)",
    "SELECT COLUMNS('n.*') FROM (SELECT name, kind FROM entities)",
    "SELECT * EXCLUDE (name, run) REPLACE (z + 1 AS z) FROM entities",
    "DESCRIBE entities",
    "SUMMARIZE joints",
    "VALUES (1), (2)",
    "SELECT sum(range) FROM range(10)",
    "FROM (PIVOT (SELECT kind, z > 1 AS high FROM entities) ON kind IN ('robot') USING count(*))",
    "SELECT regexp_matches(name, '^c.*[0-9]$'), name SIMILAR TO 'c(a|u).*' FROM entities",
    f"SELECT regexp_extract(name, '{'a|' * 99}ab') FROM entities",
    r"SELECT regexp_matches(name, '^(cup|can)_[0-9]{1,3}(\pL{2}){3}[^]x]{20}\{900}[{901}]$') FROM entities",
    f"SELECT name FROM entities WHERE name LIKE '{'%a' * 100}' OR name NOT ILIKE 'C_p%' ESCAPE '!'",
    "SELECT unnest([1, 2]), extract(year FROM DATE '2026-01-01')",
    "SELECT list_has_any([1], l), l && [2] FROM (SELECT list(id) AS l FROM entities)",
    "SELECT MAP {'a': 1}['a'], json_extract('{\"a\": [1, 2]}', '$.a[*]'), '[3]'::JSON -> 0",
    "WITH a AS MATERIALIZED (SELECT 1 AS i), b AS (FROM a WHERE i > 0) FROM a UNION ALL FROM b",
    f"SELECT {'9' * 40}, {'1' * 900}.5",
    "SELECT COLUMNS('na.*'), COLUMNS(['z', 'x']), COLUMNS(lambda c: c = 'y') FROM entities",
    "SELECT strptime('2026-11-27', '%Y-%m-%d') - TIMESTAMP '2026-01-01', epoch_ms(0)",
]


@pytest.mark.parametrize("text", PERMITTED)
def test_queries_of_known_names_have_the_rows_that_they_have_without_limits(strict, ss, text):
    assert strict.sql(text).fetchall() == ss.sql(text).fetchall() != []


REFUSED = [
    'PREPARE "ssduck statement 1" AS SELECT 1',
    "DROP SCHEMA kitchen_record_0 CASCADE",
    "CREATE OR REPLACE VIEW kitchen.entities AS SELECT 1",
    "CREATE TEMP MACRO near(a, b) AS true",
    "EXECUTE anything",
    "DEALLOCATE anything",
    "BEGIN",
    "COMMIT",
    "CHECKPOINT",
    "SET threads = 8",
    "SET VARIABLE a = 1",
    "RESET threads",
    "RESET schema",
    "SET schema = DEFAULT",
    "/* SET */ reset -- it\n search_path",
    "USE kitchen_record_0",
    "PRAGMA version",
    "CALL range(3)",
    "EXPLAIN SELECT 1",
    "INSERT INTO kitchen_record_0.entities SELECT * FROM entities",
    "DELETE FROM kitchen_record_0.entities",
    "UPDATE entities SET z = 0",
    "COPY (SELECT 1) TO 'file.csv'",
    "ATTACH 'other.db'",
    "EXPORT DATABASE 'folder'",
    "INSTALL httpfs",
    "PIVOT entities ON kind USING count(*)",
    "WITH x AS (INSERT INTO mine VALUES (1) RETURNING *) FROM x",
    "WITH x AS (UPDATE mine SET a = 1 RETURNING *) FROM x",
    "WITH x AS (DELETE FROM mine RETURNING *) FROM x",
    "WITH x AS (COPY (SELECT 1) TO 'file.csv') FROM x",
    "WITH y AS (WITH x AS (DELETE FROM mine RETURNING *) FROM x) FROM y",
    "SELECT (WITH x AS (DELETE FROM mine RETURNING *) SELECT 1)",
    "FROM (WITH x AS (COPY (SELECT 1) TO 'file.csv') FROM x)",
    "DESCRIBE WITH x AS (DELETE FROM mine RETURNING *) FROM x",
    "CREATE SECRET a (TYPE s3)",
    "COMMENT ON TABLE entities IS 'a'",
    "COPY entities FROM '/etc/passwd'",
    "DETACH memory",
    "VACUUM",
]


@pytest.mark.parametrize("text", REFUSED)
def test_other_texts_are_refused_and_change_nothing(strict, text):
    before = strict.sql("SELECT count(*), max(z) FROM entities").fetchall()
    with pytest.raises(LimitError, match="SQL is one SELECT here"):
        strict.sql(text)
    assert strict.sql("SELECT count(*), max(z) FROM entities").fetchall() == before
    assert strict.eval("SELECT id(this) FROM kitchen WHERE isRobot(this) AS list;")


@pytest.mark.slow
def test_no_query_of_with_writes_a_file_into_a_record(tmp_path):
    with ssduck.load("kitchen") as ss:
        ss.call_variable("kitchen").step()
        ss.export(tmp_path / "run")
    files = {file: file.read_bytes() for file in (tmp_path / "run").rglob("*") if file.is_file()}
    (part,) = (tmp_path / "run/entities").rglob("*.parquet")
    with ssduck.open(tmp_path / "run", limits=ssduck.Limits.strict(require=())) as ss:
        for name in (part, tmp_path / "run/new.csv"):
            with pytest.raises(LimitError, match="one SELECT"):
                ss.sql(f"WITH x AS (COPY (SELECT 42 AS a) TO '{name}') FROM x")
    now = {file: file.read_bytes() for file in (tmp_path / "run").rglob("*") if file.is_file()}
    assert now == files


@pytest.mark.slow
def test_no_query_of_with_changes_a_table_of_a_file(tmp_path):
    with ssduck.Interpreter(str(tmp_path / "own.duckdb")) as ss:
        ss.sql("CREATE TABLE mine AS SELECT 1 AS a")
    with ssduck.Interpreter(
        str(tmp_path / "own.duckdb"), limits=ssduck.Limits.strict(require=())
    ) as ss:
        for change in ("DELETE FROM mine", "UPDATE mine SET a = 2", "INSERT INTO mine VALUES (3)"):
            with pytest.raises(LimitError, match="one SELECT"):
                ss.sql(f"WITH x AS ({change} RETURNING *) FROM x")
        assert ss.sql("FROM mine").fetchall() == [(1,)]


MEMORY = 50_000_000
LARGE = "more memory than available|values of more than"
SLOW = f"took more than|{LARGE}"
ENDED = [
    ("WITH RECURSIVE a AS (SELECT 'a' AS s UNION ALL SELECT s || s FROM a) FROM a", LARGE),
    (
        "WITH RECURSIVE a AS (SELECT 1 AS i UNION ALL SELECT i + 1 FROM a) SELECT max(i) FROM a",
        SLOW,
    ),
    ("SELECT " + ", ".join(f"range + {i}" for i in range(1000)) + " FROM range(1000000)", LARGE),
    ("SELECT " + ", ".join(f"'{'a' * 1000}{i}'" for i in range(50)) + " FROM range(99999)", LARGE),
    (f"SELECT '{'a' * 100_000}' FROM range(1000000)", LARGE),
    (f"SELECT '{'a' * 100_000}', uuid() FROM range(1000000)", LARGE),
    (f"SELECT concat('{'a' * 100_000}', range) FROM range(1000000)", LARGE),
    ("SELECT list(range) FROM range(1000000000)", LARGE),
    ("SELECT json_group_array(range) FROM range(1000000000)", LARGE),
    ("SELECT histogram(range) FROM range(1000000000)", LARGE),
    (f"SELECT length(string_agg('{'a' * 100_000}', ',')) FROM range(1000000)", LARGE),
    (f"SELECT length(group_concat('a', '{'a' * 100_000}')) FROM range(1000000)", LARGE),
    (
        f"SELECT max(a) FROM (SELECT listagg('{'a' * 9_000}') OVER (ORDER BY range) AS a "
        "FROM range(9000))",
        LARGE,
    ),
    ("SELECT count(*) FROM range(10000000) a, range(10000000) b WHERE a.range*b.range=-7", SLOW),
    (
        "SELECT a.range FROM range(100000) a, range(100000) b ORDER BY hash(b.range + a.range)",
        LARGE,
    ),
    ("SELECT sum(clearance(a, b)) FROM entities a, entities b, range(1000)", SLOW),
]


@pytest.mark.slow
@sampled(("text", "words"), ENDED, every=6)
def test_a_statement_ends_in_time_and_memory(text, words):
    limits = ssduck.Limits.strict(seconds=0.5, memory=MEMORY, require=())
    with ssduck.load("kitchen", limits=limits) as ss:
        started = time.process_time()
        with pytest.raises(LimitError, match=f"{words}|took more than"):
            ss.sql(text)
        assert time.process_time() - started < 5
        assert ss.sql("SELECT 42").fetchall() == [(42,)]


@pytest.mark.slow
def test_duckdb_tells_of_texts_that_it_cannot_parse(strict):
    with pytest.raises(SqlError, match="syntax error"):
        strict.sql("SELEC 1")
    with pytest.raises(SqlError, match="depth"):
        strict.sql("SELECT " + "+".join("1" * 5000))


@pytest.mark.slow
def test_records_open_under_limits(tmp_path):
    with ssduck.load("kitchen") as ss:
        ss.call_variable("kitchen").step(5)
        ss.export(tmp_path / "run")
    (tmp_path / "secret.csv").write_text("a\n1\n")
    text = "SELECT count(DISTINCT tick) FROM entities_history"
    for limits in (ssduck.Limits.strict(require=()), ssduck.Limits(files=False), None):
        with ssduck.open(tmp_path / "run", limits=limits) as ss:
            ((count,),) = ss.sql(text).fetchall()
            assert count == 6
            program = "SELECT id(this) FROM kitchen{0} WHERE isRobot(this) AS list;"
            assert ss.eval(program)
            if limits is not None:
                with pytest.raises(SqlError, match="file system operations are disabled"):
                    ss.sql(f"FROM read_csv('{tmp_path / 'secret.csv'}')")
                with pytest.raises(LimitError):
                    ss.sql(f"COPY (SELECT 1) TO '{tmp_path / 'run' / 'new.csv'}'")


def test_strict_limits_are_select_only():
    assert ssduck.Limits.strict(require=()).select_only
    assert not ssduck.Limits.strict(select_only=False, require=()).select_only
    assert not ssduck.Limits().select_only


def test_a_missing_extension_is_named_and_no_folder():
    with ssduck.Interpreter(limits=ssduck.Limits.strict(require=())) as ss:
        with pytest.raises(LimitError, match="needs DuckDB's extension 'inet'") as caught:
            ss.sql("SELECT '1.1.1.1'::INET")
        assert "/" not in caught.value.message
        assert ss.sql("SELECT 1").fetchall() == [(1,)]
