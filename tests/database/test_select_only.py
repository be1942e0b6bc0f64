"""`Limits(select_only=True)`: SQL of strangers is one SELECT of known tables and functions."""

from __future__ import annotations

import time

import pytest

import ssduck
from ssduck.database.strict.permitted_functions import FUNCTIONS, OPERATORS
from ssduck.errors import LimitError, SqlError
from tests.support.cases import sampled


@pytest.fixture(scope="module")
def strict():
    with ssduck.load("kitchen", limits=ssduck.Limits.strict().in_process) as ss:
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


@pytest.fixture(scope="module")
def free():
    with ssduck.load("kitchen") as ss:
        yield ss


@pytest.mark.parametrize("text", PERMITTED)
def test_queries_of_known_names_have_the_rows_that_they_have_without_limits(strict, free, text):
    assert strict.sql(text).fetchall() == free.sql(text).fetchall() != []


# A text, and what its error says.
REFUSED = [
    ("DROP SCHEMA kitchen_record_0 CASCADE", "not DROP"),
    ("CREATE OR REPLACE VIEW kitchen.entities AS SELECT 1", "not CREATE"),
    ("CREATE TEMP MACRO near(a, b) AS true", "not CREATE"),
    ('PREPARE "ssduck statement 1" AS SELECT 1', "not PREPARE"),
    ("EXECUTE anything", "not EXECUTE"),
    ("DEALLOCATE anything", "not DEALLOCATE"),
    ("BEGIN", "not BEGIN"),
    ("COMMIT", "not COMMIT"),
    ("CHECKPOINT", "not CHECKPOINT"),
    ("SET threads = 8", "not SET"),
    ("SET VARIABLE a = 1", "not SET"),
    ("RESET threads", "not RESET"),
    ("RESET schema", "not RESET"),
    ("SET schema = DEFAULT", "not SET"),
    ("/* SET */ reset -- it\n search_path", "not RESET"),
    ("USE kitchen_record_0", "not USE"),
    ("PRAGMA version", "not PRAGMA"),
    ("CALL range(3)", "not CALL"),
    ("EXPLAIN SELECT 1", "not EXPLAIN"),
    ("INSERT INTO kitchen_record_0.entities SELECT * FROM entities", "not INSERT"),
    ("DELETE FROM kitchen_record_0.entities", "not DELETE"),
    ("UPDATE entities SET z = 0", "not UPDATE"),
    ("COPY (SELECT 1) TO 'file.csv'", "not COPY"),
    ("ATTACH 'other.db'", "not ATTACH"),
    ("EXPORT DATABASE 'folder'", "not EXPORT"),
    ("INSTALL httpfs", "not INSTALL"),
    ("PIVOT entities ON kind USING count(*)", "PIVOT needs its values"),
    ("WITH x AS (INSERT INTO mine VALUES (1) RETURNING *) FROM x", "without INSERT"),
    ("WITH x AS (UPDATE mine SET a = 1 RETURNING *) FROM x", "without UPDATE"),
    ("WITH x AS (DELETE FROM mine RETURNING *) FROM x", "without DELETE"),
    ("WITH x AS (COPY (SELECT 1) TO 'file.csv') FROM x", "without COPY"),
    ("WITH y AS (WITH x AS (DELETE FROM mine RETURNING *) FROM x) FROM y", "without DELETE"),
    ("SELECT (WITH x AS (DELETE FROM mine RETURNING *) SELECT 1)", "without DELETE"),
    ("FROM (WITH x AS (COPY (SELECT 1) TO 'file.csv') FROM x)", "without COPY"),
    ("DESCRIBE WITH x AS (DELETE FROM mine RETURNING *) FROM x", "without DELETE"),
    (f"SELECT {'9' * 1001}", "at most 1,000 digits"),
    (f"SELECT 1 + {'9' * 1001} -- a comment", "at most 1,000 digits"),
    ("SELECT '9'::BIGNUM", "no type BIGNUM"),
    ("SELECT NULL::STRUCT(a BIGNUM[])", "no type BIGNUM"),
    ("SELECT TRY_CAST(name AS VARINT) FROM entities", "no type VARINT"),
    ("SELECT '[1]'::JSON::VARIANT", "no type VARIANT here: use JSON"),
    ("SELECT TRY_CAST(name AS variant[]) FROM entities", "no type VARIANT"),
    ("SELECT NULL::STRUCT(a VARIANT)", "no type VARIANT"),
    ("SELECT NULL::MAP(VARCHAR, VARIANT)", "no type VARIANT"),
    (
        "SELECT name::TIMESTAMPTZ FROM entities",
        "no type TIMESTAMPTZ here: use TIMESTAMP",
    ),
    ("SELECT TRY_CAST(name AS TIMETZ[]) FROM entities", "here: use TIME"),
    (f"SELECT COLUMNS('{'(.*a)?' * 40}') FROM entities", "COLUMNS takes a text of at most 200"),
    (f"UNPIVOT entities ON COLUMNS('{'(.*a)?' * 40}')", "COLUMNS takes a text of at most 200"),
    ("SELECT parse_path(name) FROM entities", "parse_path is no function"),
    ("SELECT name::TIMESTAMPTZ_NS FROM entities", "here: use TIMESTAMP_NS"),
    ("SELECT name.strptime('%Z') FROM entities", "strptime is written as strptime"),
    ("SELECT entities.name.strptime('%Z') FROM entities", "is written as strptime"),
    ("SELECT strptime(format := '%Z', text := '2026') FROM entities", "without names of"),
    ("SELECT name.regexp_matches('(a+)+$') FROM entities", "is written as regexp_matches"),
    ("SELECT l.list_aggregate('mode') FROM (SELECT [1] AS l)", "is written as list_aggregate"),
    ("SELECT [name].list_transform(lambda v: v.strptime('%Z')) FROM entities", "is written as"),
    ("SELECT timezone(name, ticks.time) FROM entities, ticks", "timezone is no function"),
    ("SELECT DATE '2026-01-01' AT TIME ZONE name FROM entities", "timezone is no function"),
    ("SELECT now() IN (name) FROM entities", "now is no function"),
    ("SELECT current_timestamp IN (name) FROM entities", "may call: use localtimestamp"),
    ("SELECT nullif(to_timestamp(0), name) FROM entities", "to_timestamp is no function"),
    ("SELECT make_timestamptz(1, 1, 1, 1, 1, 1, name) FROM entities", "make_timestamptz is no"),
    ("SELECT strptime(name, '%Y %Z') FROM entities", "the format of strptime has no %Z here"),
    ("SELECT try_strptime(name, '%z') FROM entities", "has no %z here"),
    ("SELECT strptime(name, name) FROM entities", "a text of at most 200 letters"),
    ("SELECT json_contains('[1]', '1')", "json_contains is no function"),
    ("SELECT regexp_extract_all(name, 'a')", "regexp_extract_all is no function"),
    ("SELECT regexp_split_to_array(name, 'a')", "regexp_split_to_array is no function"),
    ("SELECT str_split_regex(name, 'a')", "str_split_regex is no function"),
    ("SELECT list_intersect([1], [1])", "list_intersect"),
    ("SELECT [1] <@ [1]", "<@ is no function"),
    ("SELECT list_aggregate([1], 'mode')", "list_aggregate takes the name"),
    ("SELECT map(l, l) FROM (SELECT list(z) AS l FROM entities)", "map takes lists"),
    ("SELECT l && l FROM (SELECT list(z) AS l FROM entities)", "one of the lists of &&"),
    ("SELECT list_has_any(l, l) FROM (SELECT list(z) AS l FROM entities)", "of list_has_any"),
    ("SELECT map_concat(MAP {'a': 1}, MAP {'a': 1})", "map_concat"),
    ("SELECT json_extract('[]', '$..*')", "at most one of"),
    ("SELECT '[]'::JSON -> '$[*][*]'", "at most one of"),
    ("SELECT json_extract('[]', '$' || '..*')", "a text or a column"),
    ("SELECT name::JSON -> ('$' || '..*') FROM entities", "a text or a column"),
    ("SELECT 1; SELECT 2", "2 statements"),
    ("SELECT 1; DROP SCHEMA kitchen CASCADE", "2 statements"),
    ("SHOW TABLES", "use DESCRIBE"),
    ("SHOW ALL TABLES", "use DESCRIBE"),
    ("SELECT * FROM kitchen_record_0.entities", "'kitchen_record_0.entities'"),
    ('SELECT * FROM "world 1: entities"', "'world 1: entities'"),
    (
        'WITH a AS (FROM "world 1: entities"), "world 1: entities" AS (SELECT 1) FROM a',
        "'world 1: entities'",
    ),
    ('WITH "world 1: entities" AS (FROM "world 1: entities") SELECT 1', "'world 1: entities'"),
    (
        'SELECT * FROM (WITH "world 1: ticks" AS (SELECT 1) SELECT 1), "world 1: ticks"',
        "'world 1: ticks'",
    ),
    ("SELECT * FROM duckdb_settings()", "duckdb_settings"),
    ("SELECT * FROM duckdb_views", "'duckdb_views'"),
    ("SELECT * FROM information_schema.tables", "'information_schema.tables'"),
    ("SELECT * FROM pg_catalog.pg_tables", "'pg_catalog.pg_tables'"),
    ("SELECT * FROM main.entities", "'main.entities'"),
    ("SELECT * FROM other.kitchen.entities", "'other.kitchen.entities'"),
    ("SELECT * FROM '/etc/passwd'", "'/etc/passwd'"),
    ("SELECT * FROM read_text('/etc/passwd')", "read_text"),
    ("SELECT * FROM glob('*')", "glob"),
    ("SELECT * FROM query('SELECT 1')", "query"),
    ("SELECT * FROM query_table('world 1: entities')", "query_table"),
    ("SELECT * FROM intervals('world 1: ticks')", "intervals takes"),
    ("SELECT * FROM intervals('kitchen_record_0.ticks')", "intervals takes"),
    ("SELECT * FROM intervals(concat('world 1', ': ticks'))", "intervals takes"),
    ("SELECT * FROM arrow_scan(1, 2, 3)", "arrow_scan"),
    ("SELECT * FROM json_execute_serialized_sql('{}')", "json_execute_serialized_sql"),
    # A sign that Python's `lower` takes for a k, and DuckDB does not.
    ('WITH "duc\u212adb_views" AS (SELECT 1) FROM duckdb_views', "'duckdb_views'"),
    ('WITH "world 1: tic\u212as" AS (SELECT 1) FROM "world 1: ticks"', "'world 1: ticks'"),
    (
        'WITH RECURSIVE "/\u212a.csv" AS (SELECT 1 UNION SELECT 1 FROM "/k.csv") SELECT 1',
        "'/k.csv'",
    ),
    ("SELECT count(*) FROM \u212aitchen.entities", "entities' that SQL may read"),
    ("SELECT json_serialize_sql('SELECT 1')", "json_serialize_sql"),
    ("SELECT system.main.repeat('a', 1000000000)", "repeat .*: write the text out, or join it"),
    ("SELECT name.repeat(1000000000) FROM entities", "repeat"),
    ("SELECT 1 ORDER BY lpad('a', 1000000000)", "lpad"),
    ("SELECT 1 LIMIT length(rpad('a', 1000000000, 'b'))", "rpad"),
    ("SELECT sum(length(printf('%1000000000d', 1))) OVER () FROM entities", "printf"),
    ("SELECT COLUMNS(c -> format('{:1000000000}', c) = 'a') FROM entities", "format"),
    ("SELECT list_transform([1], x -> sleep_ms(100000))", "sleep_ms"),
    ("SELECT current_setting('home_directory')", "current_setting"),
    ("SELECT getvariable('a')", "getvariable"),
    ("SELECT nextval('a')", "nextval"),
    ("SELECT setseed(0.5)", "setseed"),
    ("SELECT list_reduce(['a', 'b'], lambda a, b: a || a)", "list_reduce"),
    ("SELECT levenshtein(name, kind) FROM entities", "levenshtein"),
    ("SELECT regexp_matches(name, kind) FROM entities", "a text of at most 200 letters"),
    (
        f"SELECT quantile_cont(z, [{', '.join(['0.5'] * 101)}]) FROM entities",
        "quantile_cont takes a number, or a list of at most 100 that is written out",
    ),
    ("SELECT quantile(z, '[0.5]'::DOUBLE[]) FROM entities", "quantile takes a number, or a list"),
    ("SELECT quantile_disc(z, list_transform([1], x -> 0.5)) FROM entities", "quantile_disc takes"),
    (
        "SELECT list_aggregate([z], 'approx_quantile', '[0.5]') FROM entities",
        "approx_quantile takes",
    ),
    ("SELECT z.quantile_cont(0.5) FROM entities", "quantile_cont is written as"),
    ("SELECT fill(z) OVER (ORDER BY id) FROM entities", "fill is no function"),
    ("SELECT entropy(z) OVER (ORDER BY id) FROM entities", "entropy has no OVER here"),
    ("SELECT histogram(z) OVER w FROM entities WINDOW w AS (ORDER BY id)", "histogram has no OVER"),
    (
        "SELECT count(DISTINCT z) OVER (ORDER BY id ROWS BETWEEN 9 PRECEDING AND CURRENT ROW "
        "EXCLUDE TIES) FROM entities",
        "DISTINCT and EXCLUDE are not together in OVER",
    ),
    ("SELECT COLUMNS('(id|name){40}') FROM entities", "COLUMNS takes a text of at most 200"),
    (
        f"SELECT COLUMNS('[{'a' * 390}]id{'x' * 500}') FROM entities",
        "COLUMNS takes a text of at most 200",
    ),
    (f"SELECT name LIKE '{'%a' * 100}%' FROM entities", "the pattern of LIKE is a text of at most"),
    ("SELECT name FROM entities WHERE name NOT LIKE kind || '%'", "the pattern of NOT LIKE is"),
    ("SELECT name ILIKE kind ESCAPE '!' FROM entities", "the pattern of ILIKE is"),
    ("SELECT name ~~~ kind FROM entities", "the pattern of GLOB is"),
    (f"SELECT regexp_extract(name, '{'(a|b)*' * 50}') FROM entities", "at most 200 letters"),
    ("SELECT regexp_matches(name, '((a{1,10}){1,10}){1,10}b')", "when its repeats are written out"),
    ("SELECT name ~ '(a{0,100}){0,10}b' FROM entities", "when its repeats are written out"),
    ("SELECT name SIMILAR TO '(a?){300}' FROM entities", "when its repeats are written out"),
    (r"SELECT regexp_full_match(name, '(\pL?){60}') FROM entities", "when its repeats are"),
    (r"SELECT regexp_extract(name, '([\]\pL]x*){9}') FROM entities", "when its repeats are"),
    ("SELECT name !~ 'a{201,}' FROM entities", "when its repeats are written out"),
    (f"SELECT name SIMILAR TO '{'(a|b)*' * 50}' FROM entities", "at most 200 letters"),
    ("SELECT string_split_regex(name, 'a') FROM entities", "string_split_regex is no function"),
    ("SELECT editdist3(name, kind) FROM entities", "editdist3"),
    ("SELECT damerau_levenshtein(name, kind) FROM entities", "damerau_levenshtein"),
    ("SELECT jaro_winkler_similarity(name, kind) FROM entities", "jaro_winkler_similarity"),
    ("SELECT json_merge_patch(name, kind) FROM entities", "json_merge_patch"),
    ("SELECT json_deep_merge(name, kind) FROM entities", "json_deep_merge"),
    ("SELECT bit_position('1'::BIT, '01'::BIT)", "bit_position"),
    ("SELECT list_aggregate(['a'], 'string_agg', ',')", "the name of an aggregate"),
    ("SELECT ['a'].list_aggr('string_agg')", "the name of an aggregate"),
    ("SELECT list_aggregate([1], 'su' || 'm')", "the name of an aggregate"),
    ("SELECT getenv('HOME')", "getenv"),
    ("SELECT * FROM read_csv('/etc/passwd')", "read_csv"),
    ("SELECT * FROM 'https://example.com/a.csv'", "example"),
    ("SELECT * FROM read_parquet('s3://a/b')", "read_parquet"),
    ("SELECT * FROM pragma_database_size()", "pragma_database_size"),
    ("SELECT * FROM duckdb_secrets()", "duckdb_secrets"),
    ("SELECT list_transform(['/etc/passwd'], lambda f: read_text(f))", "read_text"),
    ("SELECT list_resize([1], 1000000000)", "list_resize"),
    ("SELECT range(1000000000)", "range"),
    ("CREATE SECRET a (TYPE s3)", "one SELECT"),
    ("COMMENT ON TABLE entities IS 'a'", "one SELECT"),
    ("COPY entities FROM '/etc/passwd'", "not COPY"),
    ("DETACH memory", "one SELECT"),
    ("VACUUM", "one SELECT"),
    ("FROM (PIVOT entities ON kind IN ('robot') USING getenv(name))", "getenv"),
]


@pytest.mark.parametrize(("text", "words"), REFUSED)
def test_other_texts_are_refused_and_change_nothing(strict, text, words):
    before = strict.sql("SELECT count(*), max(z) FROM entities").fetchall()
    with pytest.raises(LimitError, match=words):
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
    with ssduck.open(tmp_path / "run", limits=ssduck.Limits.strict().in_process) as ss:
        for name in (part, tmp_path / "run/new.csv"):
            with pytest.raises(LimitError, match="without COPY"):
                ss.sql(f"WITH x AS (COPY (SELECT 42 AS a) TO '{name}') FROM x")
    now = {file: file.read_bytes() for file in (tmp_path / "run").rglob("*") if file.is_file()}
    assert now == files


@pytest.mark.slow
def test_no_query_of_with_changes_a_table_of_a_file(tmp_path):
    with ssduck.Interpreter(str(tmp_path / "own.duckdb")) as ss:
        ss.sql("CREATE TABLE mine AS SELECT 1 AS a")
    with ssduck.Interpreter(
        str(tmp_path / "own.duckdb"), limits=ssduck.Limits.strict().in_process
    ) as ss:
        for change in ("DELETE FROM mine", "UPDATE mine SET a = 2", "INSERT INTO mine VALUES (3)"):
            with pytest.raises(LimitError, match=f"without {change.split()[0]}"):
                ss.sql(f"WITH x AS ({change} RETURNING *) FROM x")
        assert ss.sql("FROM mine").fetchall() == [(1,)]


MEMORY = 50_000_000
DOUBLED = ", ".join(f"a{i} AS (SELECT s || s AS s FROM a{i - 1})" for i in range(1, 31))
LARGE = "more memory than available|values of more than"
SLOW = f"took more than|{LARGE}"
ENDED = [
    (f"WITH a0 AS (SELECT 'aaaaaaaaaa' AS s), {DOUBLED} SELECT length(s) FROM a30", "too large"),
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
    ("SELECT 1 WHERE " + " OR ".join(f"{i} = 1" for i in range(9000)), "words"),
    ("SELECT " + ",".join("1" * 90_000), "words"),
    ("SELECT '" + "a" * 3_000_000 + "'", "letters"),
    ("/*" + "a" * 3_000_000 + "*/ SELECT 1", "letters"),
    ("SELECT " + "(" * 101 + "1" + ")" * 101, "nested deeper than 100"),
]


@pytest.mark.slow
@sampled(("text", "words"), ENDED, every=6)
def test_a_statement_ends_in_time_and_memory(text, words):
    limits = ssduck.Limits.strict(seconds=0.5, memory=MEMORY).in_process
    with ssduck.load("kitchen", limits=limits) as ss:
        started = time.process_time()
        with pytest.raises(LimitError, match=f"{words}|took more than"):
            ss.sql(text)
        assert time.process_time() - started < 5
        assert ss.sql("SELECT 42").fetchall() == [(42,)]


@pytest.mark.slow
@pytest.mark.parametrize("columns", ["range, 'a' || range AS a", "range, DATE '2026-01-01' AS a"])
def test_many_rows_are_the_same_under_limits(columns):
    """They are fetched in parts, as tuples or as an Arrow table."""
    text = f"SELECT {columns} FROM range(10000)"
    with (
        ssduck.Interpreter() as free,
        ssduck.Interpreter(limits=ssduck.Limits.strict().in_process) as strict,
    ):
        assert strict.sql(text).fetchall() == free.sql(text).fetchall()
        assert strict.sql(text).arrow() == free.sql(text).arrow()
        with pytest.raises(LimitError, match="more than 1000000 rows"):
            strict.sql("SELECT range, 'a' AS a FROM range(1000001)")


def test_a_refusal_has_its_place_and_the_nearest_name(strict):
    with pytest.raises(LimitError) as caught:
        strict.sql("SELECT 'ü',\n  nme FROM entitees")
    assert (caught.value.line, caught.value.column) == (2, 12)
    assert caught.value.suggestions[0] == "entities"
    with pytest.raises(LimitError) as caught:
        strict.sql("SELECT rond(z) FROM entities")
    assert "round" in caught.value.suggestions


@pytest.mark.slow
def test_duckdb_tells_of_texts_that_it_cannot_parse(strict):
    with pytest.raises(SqlError, match="syntax error"):
        strict.sql("SELEC 1")
    with pytest.raises(SqlError, match="depth"):
        strict.sql("SELECT " + "+".join("1" * 5000))


@pytest.mark.slow
def test_a_permitted_text_is_checked_again_when_names_change():
    with ssduck.load("kitchen", limits=ssduck.Limits.strict().in_process) as ss:
        for _ in range(2):
            with pytest.raises(LimitError, match=r"there is no table 'lab\.entities'"):
                ss.sql("SELECT count(*) FROM lab.entities")
        ss.add_variable("lab", ss.call_variable("kitchen"))
        ((count,),) = ss.sql("SELECT count(*) FROM lab.entities").fetchall()
        assert count == len(ss.call_variable("kitchen"))


def test_the_tree_is_checked_once_a_text():
    statements = []
    limits = ssduck.Limits.strict().in_process
    with ssduck.Interpreter(limits=limits, tracer=statements.append) as ss:
        for _ in range(5):
            ss.sql("SELECT 1")
    assert sum("json_serialize_sql" in statement for statement in statements) == 1


@pytest.mark.slow
def test_records_open_under_limits(tmp_path):
    with ssduck.load("kitchen") as ss:
        ss.call_variable("kitchen").step(5)
        ss.export(tmp_path / "run")
    (tmp_path / "secret.csv").write_text("a\n1\n")
    text = "SELECT count(DISTINCT tick) FROM entities_history"
    for limits in (ssduck.Limits.strict().in_process, ssduck.Limits(files=False), None):
        with ssduck.open(tmp_path / "run", limits=limits) as ss:
            ((count,),) = ss.sql(text).fetchall()
            assert count == 6
            program = "SELECT id(this) FROM kitchen{0} WHERE isRobot(this) AS list;"
            assert ss.eval(program)
            if limits is not None:
                with pytest.raises(LimitError):
                    ss.sql(f"FROM read_csv('{tmp_path / 'secret.csv'}')")
                with pytest.raises(LimitError):
                    ss.sql(f"COPY (SELECT 1) TO '{tmp_path / 'run' / 'new.csv'}'")


@pytest.mark.slow
def test_no_permitted_function_is_another_name_of_one_that_is_not():
    with ssduck.Interpreter() as ss:
        rows = ss.sql("SELECT DISTINCT function_name, alias_of FROM duckdb_functions()").fetchall()
    names = FUNCTIONS | OPERATORS
    others = [(name, of) for name, of in rows if of is not None and name in FUNCTIONS]
    assert ("editdist3", "levenshtein") in {(name, of) for name, of in rows}
    assert [(name, of) for name, of in others if of not in names] == []


@pytest.mark.slow
def test_permitted_functions_are_those_of_this_duckdb():
    with ssduck.Interpreter() as ss:
        rows = ss.sql("SELECT function_name FROM duckdb_functions()").fetchall()
        known = {name for (name,) in rows}
    assert sorted(FUNCTIONS - known) == []
    assert not FUNCTIONS & OPERATORS


def test_strict_limits_are_select_only():
    assert ssduck.Limits.strict().in_process.select_only
    assert not ssduck.Limits.strict(select_only=False).in_process.select_only
    assert not ssduck.Limits().select_only


def test_a_missing_extension_is_named_and_no_folder():
    with ssduck.Interpreter(limits=ssduck.Limits.strict().in_process) as ss:
        with pytest.raises(LimitError, match="needs DuckDB's extension 'inet'") as caught:
            ss.sql("SELECT '1.1.1.1'::INET")
        assert "/" not in caught.value.message
        assert ss.sql("SELECT 1").fetchall() == [(1,)]
