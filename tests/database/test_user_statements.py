"""Raw SQL: its plans are kept, and every spelling of a relation has the rows of its macro."""

import math
from random import Random

import pybullet
import pytest

import ssduck
from ssduck.adapters.result import Result
from ssduck.database.plans import RUNS_BEFORE_PLAN
from ssduck.database.statement_names import words_of
from ssduck.errors import EvaluationError, LimitError, SqlError
from tests.support.cases import generated, sampled
from tests.support.stage import Stage

# As many that the plan of a statement is kept at the last ones.
RUNS = RUNS_BEFORE_PLAN + 3
# Relations of two entities, with their further arguments.
SEARCHED = {
    "collides": "",
    "touching": ", 0.02",
    "near": ", 0.05",
    "onTop": "",
    "supports": "",
    "restsOn": "",
    "contains": "",
    "enclosed": "",
    "above": "",
    "below": "",
    "within": "",
}
OTHERS = {"penetration": " > 0", "clearance": " < 0.05", "inside": " > 0", "nextTo": ""}
# The rows of a side from which DuckDB makes range joins; 5 by default.
RANGE_JOINS = "SELECT current_setting('nested_loop_join_threshold')"
# Statements over entities a and b; {r} is a call of the relation.
SPELLINGS = (
    "SELECT a.name, b.name FROM entities a, entities b WHERE {r}",
    "SELECT * FROM entities a, entities b WHERE a.id < b.id AND {r}",
    "SELECT *, a.z + 1 FROM entities AS a JOIN entities AS b ON {r} ORDER BY ALL",
    "SELECT a.name FROM sim.entities a JOIN entities b ON a.id <> b.id AND ({r}) WHERE b.z > 0",
    "FROM entities a, entities b SELECT a.name, b.z WHERE {r}",
    "FROM entities a, entities b WHERE {r}",
    "SELECT a.name, b.name FROM entities a LEFT JOIN entities b ON {r}",
    "SELECT * FROM entities a LEFT OUTER JOIN sim.entities AS b ON a.id <> b.id AND ({r})",
    "SELECT a.name, count(b.id) FROM entities a LEFT JOIN entities b ON b.z > 0.1 AND {r} GROUP BY ALL",
    "SELECT a.name, c.name FROM entities a LEFT JOIN entities b ON {r} LEFT JOIN entities c "
    "ON c.id = b.id",
    "SELECT b.name, a.name FROM entities b LEFT JOIN entities a ON {r}",
    "SELECT a.name FROM entities a LEFT JOIN entities b ON NOT {r}",
    "SELECT a.name, b.name FROM entities a FULL JOIN entities b ON {r}",
    "SELECT a.name, b.name FROM entities a RIGHT JOIN entities b ON b.z > 0.2 WHERE {r}",
    "SELECT a.name FROM entities a WHERE EXISTS (SELECT 1 FROM entities b WHERE {r})",
    "SELECT a.name FROM entities a WHERE NOT EXISTS (FROM entities b WHERE {r})",
    "SELECT a.name, (SELECT count(*) FROM entities b WHERE {r}) FROM entities a",
    "SELECT a.name, b.name FROM entities a, entities b WHERE NOT {r}",
    "SELECT a.name, b.name FROM entities a, entities b WHERE {r} IS NULL",
    "SELECT a.name, b.name FROM entities a, entities b WHERE {r} OR a.z > b.z + 0.1",
    "SELECT a.name, b.name, {r} FROM entities a, entities b",
    "SELECT a.name, {r} AS holds, count(*) FROM entities a, entities b GROUP BY ALL",
    "SELECT count(*) FILTER ({r}), sum(CASE WHEN {r} THEN a.z END) > 0 FROM entities a, entities b",
    "SELECT a.id, count(*), count(b.id) FILTER (WHERE {r}) FROM entities a, entities b GROUP BY a.id",
    "SELECT a.name, max(b.z) FROM entities a, entities b WHERE {r} GROUP BY a.name HAVING max(b.z) > 0",
    "SELECT DISTINCT a.name FROM entities a, entities b WHERE {r} AND b.name IN ('b1', 'b2')",
    "SELECT b.name FROM entities a, entities b WHERE a.name = 'b1' AND {r}",
    "WITH a AS (SELECT * FROM entities WHERE z > 0.05) SELECT a.name, b.id FROM a, entities b "
    "WHERE {r}",
    "WITH e AS (FROM entities) SELECT a.name FROM e a, e b WHERE {r}",
    "SELECT a.name FROM (SELECT * FROM entities WHERE kind = 'kinbody') a, (FROM entities) AS b "
    "WHERE {r}",
    "SELECT a.name FROM entities a, entities b, entities c WHERE {r} AND c.id = b.id",
    "SELECT a.name FROM entities a JOIN ticks t USING (tick) JOIN entities b ON {r}",
    "SELECT a.name FROM entities a, entities b WHERE {r} UNION ALL SELECT b.name FROM entities a, "
    "entities b WHERE NOT {r}",
    "SELECT x.* FROM (SELECT a.name AS n FROM entities a, entities b WHERE {r}) x",
    "SELECT a.name /* ( */ FROM entities a, entities b WHERE {r} -- ) comment",
    "SELECT a.id, row_number() OVER (ORDER BY a.id, b.id) FROM entities a, entities b WHERE {r}",
    'SELECT "a".name, B.name FROM Entities "a", SIM.entities b WHERE ({r}) LIMIT 1000',
    "SELECT COLUMNS('name') FROM entities a, entities b WHERE {r}",
    "SELECT a.name, b.z FROM entities a, entities b WHERE {r} AND a.z BETWEEN 0 AND 0.25 AND a.x < b.x",
    "SELECT a.name, b.z FROM entities a, entities b WHERE {r} AND b.z > (SELECT avg(z) FROM entities)",
    "SELECT b.name AS n, a.z, b.mass, b.vx FROM entities a JOIN sim.entities AS b ON a.id < b.id AND {r}",
    "SELECT a.name, b.name FROM entities a, entities b WHERE {r} AND b.name < a.kind ORDER BY b.z",
    "SELECT count(*) FROM entities a LEFT JOIN entities b ON true WHERE {r} AND near(a, b, 0)",
    # Rows that need not be those of the tick.
    "SELECT a.name FROM (SELECT * REPLACE (z + 0 AS z) FROM entities) a, entities b WHERE {r}",
    "SELECT a.name FROM entities_history a JOIN entities_history b USING (tick) WHERE {r}",
)


def scene(client):
    """Boxes in a row, each penetrating or touching the next ones, on a floor, and a ball."""
    stage = Stage(client)
    stage.box("floor", (0, 0, -0.1), half=[2, 2, 0.1], mass=1)
    stage.sphere("ball", (0, 0, 0.1), radius=0.04, mass=1)
    x = 0.0
    for number, gap in enumerate((0.0, -0.05, 0.01, 0.04, 0.3, -0.001)):
        x += 0.2 + gap
        stage.box(f"b{number}", (x, 0, 0.1), half=0.1, mass=1)
    stage.box("upper", (x, 0, 0.3), half=0.1, mass=1)
    return stage.names


@pytest.fixture(scope="module")
def ss():
    """An interpreter with a world of boxes, one of whose poses is unknown."""
    client = pybullet.connect(pybullet.DIRECT)
    names = scene(client)
    lost = Stage(client).sphere("lost", (math.nan, 0, 0), radius=0.1, mass=1)
    with ssduck.Interpreter() as interpreter:
        with pytest.warns(UserWarning, match="lost"):
            world = ssduck.World.attach(client, names=names | {lost: "lost"})
        interpreter.add_variable("sim", world)
        world.tick()
        yield interpreter
    pybullet.disconnect(client)


def row_by_row(ss, sql):
    """The result of a statement as DuckDB runs it, with the macros of relations."""
    ss.sql("SELECT e.mass, s.margin FROM sim.entities e, sim.shapes s LIMIT 1")
    ss.sql("SELECT count(*) FROM duckdb_functions()")  # makes all macros
    with ss._database.pinned({"shapes"}):
        ss._database.raw_sql._describe(words_of(sql))
        return Result(ss._database.connection.table(sql, None))


def rows(result):
    """The rows in an order of their own."""
    return sorted(map(repr, result.fetchall()))


def check(ss, sql):
    """Compares a statement at its first, second and third run with the row-by-row macro."""
    expected = row_by_row(ss, sql)
    expected_rows = rows(expected)
    for _ in range(RUNS):
        found = ss.sql(sql)
        assert (found.columns, found.types) == (expected.columns, expected.types)
        assert found.arrow().schema == expected.arrow().schema
        assert rows(found) == expected_rows
    return expected_rows


CALLED = [*SEARCHED, *OTHERS]
# Every spelling with a third of the relations, and every relation with a third of the spellings.
SPELLED = [
    (relation, spelling)
    for r, relation in enumerate(CALLED)
    for s, spelling in enumerate(SPELLINGS)
    if (r + s) % 3 == 0 or generated(1) > 1
]


@pytest.mark.slow
@sampled(("relation", "spelling"), SPELLED, every=14)
def test_every_spelling_has_the_rows_of_the_macro(ss, relation, spelling):
    comparison = OTHERS.get(relation, "")
    arguments = f"(a, b{SEARCHED.get(relation, '')})"
    number = CALLED.index(relation) + SPELLINGS.index(spelling)
    schema = ("", "sim.")[number % 2]
    check(ss, spelling.format(r=f"({schema}{relation}{arguments}{comparison})"))


@pytest.mark.parametrize("relation", SEARCHED)
def test_selectscript_has_the_same_pairs(ss, relation):
    more = SEARCHED[relation]
    names = ss.eval(
        "SELECT id(a.this), id(b.this) FROM a = sim, b = sim "
        f"WHERE {relation}(a.this, b.this{more}) AS list;"
    )
    expected = list(zip(names[::2], names[1::2], strict=True))
    sql = f"SELECT a.name, b.name FROM entities a, entities b WHERE {relation}(a, b{more})"
    for _ in range(RUNS):
        assert sorted(ss.sql(sql).fetchall()) == sorted(expected)


@pytest.mark.slow
def test_unknown_pairs_are_unknown(ss):
    sql = "SELECT a.name, b.name FROM entities a, entities b WHERE collides(a, b) IS NULL"
    found = check(ss, sql)
    assert found
    assert all("lost" in row for row in found)


JOINS = ("SEMI JOIN entities b ON {r}", "ANTI JOIN sim.entities b ON {r}")


@pytest.mark.slow
@sampled("join", JOINS, every=2)
@pytest.mark.parametrize("relation", ["collides", "near", "supports", "onTop", "above"])
def test_semi_joins_take_the_pairs_of_the_tick(ss, relation, join):
    """With the rows of EXISTS, which DuckDB runs right with macros."""
    called = f'("{relation}"(a, b{SEARCHED[relation]}))'
    sql = f"SELECT * FROM entities a {join.format(r=called + ' AND b.z > 0.05')} WHERE a.z < 10"
    exists = f"EXISTS (FROM entities b WHERE {called} AND b.z > 0.05)"
    same = f"SELECT * FROM entities a WHERE {'NOT ' * ('ANTI' in join)}{exists} AND a.z < 10"
    expected = rows(row_by_row(ss, same))
    assert expected
    assert [rows(ss.sql(sql)) for _ in range(RUNS)] == [expected] * RUNS


@pytest.mark.slow
@pytest.mark.parametrize("relation", ["collides", "onTop", "supports"])
def test_a_semi_join_has_the_rows_of_the_join(ss, relation):
    # DuckDB 2.0.0 drops rows of a range join that is a semi join, or runs prepared once only.
    joined = f"SELECT DISTINCT a.name FROM entities a, entities b WHERE {relation}(a, b)"
    expected = rows(ss.sql(joined))
    assert expected
    for source in ("entities", "(FROM entities)"):
        sql = f"SELECT a.name FROM {source} a SEMI JOIN {source} b ON {relation}(a, b)"
        assert [rows(ss.sql(sql)) for _ in range(4)] == [expected] * 4
    assert ss.sql(RANGE_JOINS).fetchall() == [(5,)]


# Statements with a parameter as a distance, {d}, and others before and after it.
WITH_PARAMETERS = (
    "SELECT a.name, b.name FROM entities a, entities b WHERE b.z > {z} AND {r} AND a.z < {n}",
    "SELECT *, {z} + a.z AS more FROM entities a JOIN entities b ON {r} WHERE b.z < {n}",
    "SELECT a.name, b.z > {z} FROM entities a, entities b WHERE NOT {r} OR a.z > {n}",
    "SELECT a.name FROM entities a WHERE a.z > {z} AND EXISTS (FROM entities b WHERE {r}) LIMIT {n}",
    "SELECT count(*) FILTER ({r}), count(*) FILTER (a.z > {z}) FROM entities a, entities b LIMIT {n}",
)


def with_values(sql, style):
    """A statement with the parameters z, d and n of a style, and a function of their values."""
    names = sorted("zdn", key=lambda name: sql.index(f"<{name}>")) if style == "?" else list("zdn")
    places = {name: f"${place}" for place, name in enumerate(names, 1)}
    marks = {"?": dict.fromkeys(names, "?"), "$1": places, "$d": {n: f"${n}" for n in names}}[style]
    for name in names:
        sql = sql.replace(f"<{name}>", marks[name])
    if style == "$d":
        return sql, dict
    return sql, lambda values: [values[name] for name in names]


@pytest.mark.slow
@sampled(
    ("sql", "style", "relation"),
    [
        (sql, ("?", "$1", "$d")[n % 3], ("near", "touching")[n % 2])
        for n, sql in enumerate((*WITH_PARAMETERS, *WITH_PARAMETERS))
    ],
    every=2,
)
def test_a_distance_may_be_a_parameter(ss, sql, relation, style):
    sql = sql.format(r=f"{relation}(a, b, <d>)", z="<z>", n="<n>")
    text, arguments = with_values(sql, style)
    for distance in (0.011, 0, 1, -1.0, math.nan, None):
        values = {"z": 0.05, "d": distance, "n": 3}
        literals = sql
        for name, value in values.items():
            literal = "NULL" if value is None else f"'{value}'::DOUBLE"
            literals = literals.replace(f"<{name}>", "3" if name == "n" else literal)
        assert rows(ss.sql(text, arguments(values))) == rows(row_by_row(ss, literals)), distance
    for wrong in (arguments(values)[:2] if style != "$d" else {"z": 1}, None):
        with pytest.raises(SqlError):
            ss.sql(text, wrong)
    with pytest.raises(SqlError):
        ss.sql(text, arguments(values | {"d": True}))


@pytest.mark.slow
def test_views_of_an_earlier_session(client, tmp_path):
    """They need tables that the text of a later statement does not name."""
    joins = {"met": "a SEMI JOIN sim.entities b ON", "pairs": "a, sim.entities b WHERE"}
    found, names = {}, scene(client)
    for session in range(2):
        with ssduck.Interpreter(str(tmp_path / "views.duckdb")) as ss:
            ss.add_variable("sim", ssduck.World.attach(client, names=names))
            for name, join in joins.items():
                if session == 0:
                    sql = f"SELECT a.name FROM sim.entities {join} collides(a, b)"
                    ss.sql(f"CREATE VIEW {name} AS {sql}")
                    ss.sql(f"CREATE MACRO all_{name}() AS TABLE FROM {name}")
                    found[name] = rows(ss.sql(sql))
                for view in (name, f"all_{name}()") if session else ():
                    assert [rows(ss.sql(f"FROM {view}")) for _ in range(RUNS)] == [
                        found[name]
                    ] * RUNS
            if session:
                assert ss.sql(RANGE_JOINS).fetchall() != [(5,)]
    assert found["met"]
    with ssduck.Interpreter() as ss:
        assert ss.sql(RANGE_JOINS).fetchall() == [(5,)]
        ss.sql(f"ATTACH '{tmp_path / 'views.duckdb'}' AS earlier (READ_ONLY)")
        assert ss.sql(RANGE_JOINS).fetchall() != [(5,)]


@pytest.mark.slow
@pytest.mark.parametrize(
    "sql",
    [
        "SELECT collides(a, b, -1) FROM entities a, entities b",
        "SELECT a.name FROM entities a, entities b WHERE collides(a, b, -1)",
        "SELECT a.name FROM entities a, entities b WHERE collides(a)",
        "SELECT a.nam FROM entities a, entities b WHERE collides(a, b)",
        "SELECT a.name FROM entities p, entities b WHERE collides(p, b)",
        "SELECT error('no') FROM entities a, entities b WHERE collides(a, b)",
        "SELECT 1 FROM entities a, entities b WHERE other.collides(a, b)",
        "SELECT name FROM entities WHERE name::DOUBLE > 0",
    ],
)
def test_errors_are_those_of_the_macro(ss, sql):
    with pytest.raises(SqlError) as expected:
        row_by_row(ss, sql)
    for _ in range(RUNS):
        with pytest.raises(SqlError) as found:
            ss.sql(sql)
        assert found.value.message == expected.value.message


# -- EXISTS: it takes the pairs of the tick -------------------------------------------------------

# The sources and conditions of subqueries over b, around which is a.
INNER = (
    "entities b",
    "sim.entities AS b",
    '(FROM entities) "B"',
    "entities b JOIN entities c ON c.id = b.id",
    "entities c, entities b",
    "entities b LEFT JOIN entities c ON c.z > b.z",
)
CONDITIONS = (
    "b.z > 0.05",
    "a.id <> b.id",
    "a.id < b.id",
    "b.z < A.z OR b.x > 0.2",
    "b.name <> a.name",
    "b.kind = 'kinbody'",
    "z > 0.05",
    "b.z IS NOT NULL",
    "NOT (b.z > a.z)",
    "b.x + b.y > a.x",
    "b.id IN (SELECT id FROM entities WHERE z > 0)",
    "a.kind = b.kind",
    "b.vx IS NULL",
)
IN_EXISTS = ("collides", "near", "touching", "supports", "onTop", "contains", "above")
SELECTED = ("SELECT 1 ", "SELECT * ", "SELECT b.id, 'a' ", "SELECT a.name ", "", "SELECT count(*) ")
OUTER = (
    "SELECT a.name FROM entities a WHERE {e}",
    "SELECT * EXCLUDE (tick, time) FROM sim.entities AS a WHERE NOT {e}",
    "SELECT a.name, {e} AS found FROM entities a",
    "SELECT a.name FROM entities a WHERE a.z > 0.05 AND ({e} OR a.z > 0.2)",
    "SELECT CASE WHEN {e} THEN a.name ELSE 'none' END FROM entities a",
    "SELECT c.name, a.name FROM entities c LEFT JOIN entities a ON a.z > c.z + 0.1 WHERE NOT {e}",
    "SELECT c.name, a.name, {e} FROM entities c LEFT JOIN entities a ON a.z > c.z + 0.1",
    "WITH a AS (SELECT * FROM entities WHERE z > 0.05) SELECT name FROM a WHERE {e}",
    "SELECT name FROM (FROM entities WHERE z < 0.2) a WHERE NOT {e}",
    "SELECT count(*) FILTER (WHERE a.z > 0.1) FROM entities a WHERE {e}",
    "SELECT {e} AS found, count(*), sum(a.id) FROM entities a GROUP BY ALL",
    "FROM entities a SELECT a.name WHERE {e} AND EXISTS (FROM entities d WHERE d.z > a.z)",
)


def statement(choices):
    """Returns a random statement with an EXISTS."""
    name = choices.choice(IN_EXISTS)
    pair = choices.choice(["a, b", "b, a"])
    call = f'{choices.choice(["", "sim."])}"{name}"({pair}{SEARCHED[name]})'
    parts = [call, *choices.sample(CONDITIONS, choices.choice([0, 0, 1, 1, 2]))]
    choices.shuffle(parts)
    parts = [f"({part})" for part in parts]
    sources = choices.choice(INNER)
    if "entities c" in sources:  # a column without a table would be ambiguous
        parts = [part for part in parts if part != "(z > 0.05)"]
    selected = choices.choice(SELECTED)
    exists = f"exists( {selected}FROM {sources} WHERE {' AND '.join(parts)} )"
    return choices.choice(OUTER).format(e=exists)


@pytest.mark.slow
@sampled("seed", range(4), every=2)
def test_exists_has_the_rows_of_the_macro(ss, seed):
    choices = Random(seed)  # noqa: S311
    for _ in range(generated(12)):
        sql = statement(choices)
        expected = rows(row_by_row(ss, sql))
        assert rows(ss.sql(sql)) == expected, sql


@pytest.mark.slow
@pytest.mark.parametrize(
    "subquery",
    [
        "SELECT count(*) FROM entities b WHERE {r}",
        "SELECT 1 FROM entities b WHERE {r} LIMIT 0",
        "SELECT DISTINCT b.kind FROM entities b WHERE {r}",
        "SELECT b.kind FROM entities b WHERE {r} GROUP BY b.kind HAVING count(*) > 1",
        "SELECT unnest([]) FROM entities b WHERE {r}",
        "SELECT 1 FROM entities b WHERE {r} UNION ALL SELECT 1 WHERE false",
        "SELECT 1 FROM entities b WHERE z > 0.05 AND a.id < b.id AND {r}",
        "SELECT 1 FROM entities b WHERE {r} AND b.z > k.z",
        "SELECT 1 FROM entities b WHERE {r} AND (k.z, b.id) IN (SELECT z, id FROM entities)",
        "SELECT 1 FROM entities b WHERE {r} AND collides(b, a)",
        "SELECT 1 FROM entities b WHERE {r} OR b.z > 0.1",
        "SELECT 1 FROM entities b WHERE NOT {r}",
        "SELECT 1 FROM entities b JOIN entities a ON a.id = b.id WHERE {r}",
        "FROM entities b SELECT b.id WHERE {r}",
        "WITH n AS (SELECT 1) SELECT 1 FROM entities b, n WHERE {r}",
    ],
)
def test_other_subqueries_have_the_rows_of_the_macro(ss, subquery):
    exists = subquery.format(r="collides(a, b)")
    sql = f"SELECT a.name, k.name FROM entities a, entities k WHERE EXISTS ({exists})"
    expected = rows(row_by_row(ss, sql))
    assert [rows(ss.sql(sql)) for _ in range(RUNS)] == [expected] * RUNS


# -- plans that are kept -------------------------------------------------------------------------


@pytest.fixture
def traced(client):
    """An interpreter with the boxes, and their client."""
    with ssduck.Interpreter(recording=None) as ss:
        ss.add_variable("sim", ssduck.World.attach(client, names=scene(client)))
        yield ss, client


PAIRS = (
    "SELECT a.name, b.name || '' FROM entities a, entities b WHERE a.id < b.id AND collides(a, b)"
)
FILTER = "SELECT name FROM entities WHERE kind = 'kinbody'"


@pytest.mark.slow
def test_a_new_body_or_function_is_in_the_results(traced):
    ss, client = traced
    for _ in range(RUNS):
        ss.sql(PAIRS)
    Stage(client).sphere("new", (0.2, 0, 0.1), radius=0.1, mass=1)
    ss.call_variable("sim").tick()
    expected = rows(row_by_row(ss, PAIRS))
    assert [rows(ss.sql(PAIRS)) for _ in range(RUNS)] == [expected] * RUNS

    def double(x: float) -> float:
        return 2.0 * x

    ss.add_function("double", double)
    assert ss.eval("SELECT id FROM sim WHERE double(z(this)) > 0.5 AS list;") == ["upper"]
    assert [rows(ss.sql(PAIRS)) for _ in range(RUNS)] == [expected] * RUNS


@pytest.mark.slow
def test_a_second_world_requires_its_name(traced):
    ss, _ = traced
    for _ in range(RUNS):
        ss.sql(PAIRS)
    ss.add_variable("other", ss.call_variable("sim").what_if({}))
    for _ in range(RUNS):
        with pytest.raises(SqlError, match="needs one world"):
            ss.sql(PAIRS)
    for name in ("sim", "other"):
        sql = PAIRS.replace("collides", f"{name}.collides").replace("entities", f"{name}.entities")
        expected = rows(row_by_row(ss, sql))
        assert expected
        assert [rows(ss.sql(sql)) for _ in range(RUNS)] == [expected] * RUNS
    mixed = PAIRS.replace("collides", "other.collides")
    for _ in range(RUNS):
        with pytest.raises(EvaluationError, match="belongs to the run"):
            ss.sql(mixed)


@pytest.mark.slow
def test_what_users_define_comes_first(traced):
    ss, _ = traced
    for _ in range(RUNS):
        assert len(ss.sql(FILTER)) > 1
        assert len(ss.sql(PAIRS)) > 0
    ss.sql("CREATE MACRO main.collides(a, b) AS a.id + b.id = 0")
    ss.sql("CREATE OR REPLACE TEMP MACRO collides(a, b) AS a.id + 1 = b.id")
    count = len(ss.sql("SELECT * FROM entities")) - 1
    assert [len(ss.sql(PAIRS)) for _ in range(RUNS)] == [count] * RUNS
    ss.sql("CREATE VIEW main.entities AS SELECT * FROM sim.entities WHERE name = 'b1'")
    assert [ss.sql(FILTER).fetchall() for _ in range(RUNS)] == [[("b1",)]] * RUNS


@pytest.mark.slow
def test_what_a_simulator_is_asked_for(traced):
    ss, client = traced
    whole = "SELECT sum(e.m.mass) FROM (SELECT e AS m FROM entities e) e"
    columns = ss.sql("SELECT * FROM entities").columns
    place = columns.index("mass")
    renamed = ", ".join(f"c{number}" for number in range(len(columns)))
    for sql in (
        "SELECT sum(mass) FROM entities",
        whole,
        "SELECT * FROM entities",
        f"SELECT #{place + 1} FROM entities",
        f"SELECT e.c{place} FROM entities AS e({renamed})",
    ):
        for mass in (2.0, 3.0, 4.0, 5.0):
            pybullet.changeDynamics(0, -1, mass=mass, physicsClientId=client)
            ss.call_variable("sim").tick()
            assert rows(ss.sql(sql)) == rows(row_by_row(ss, sql))


@pytest.mark.slow
@pytest.mark.parametrize("setting", ["SET merge_join_threshold = 1", "RESET merge_join_threshold"])
def test_merge_joins_which_crash_prepared_statements_stay_off(traced, setting):
    ss, _ = traced
    ss.sql(setting)
    value = "SELECT current_setting('merge_join_threshold')::BIGINT"
    assert ss.sql(value).fetchall() == [(10**9,)]


def test_a_limit_of_rows_holds_for_kept_plans(client):
    limits = ssduck.Limits(rows=5)
    with ssduck.Interpreter(limits=limits, recording=None) as ss:
        ss.add_variable("sim", ssduck.World.attach(client, names=scene(client)))
        for _ in range(RUNS):
            assert len(ss.sql("SELECT name FROM entities LIMIT 5")) == 5
            with pytest.raises(LimitError, match="more than 5 rows"):
                ss.sql("SELECT name FROM entities")
        ss.call_variable("sim").tick()
        assert len(ss.sql("SELECT name FROM entities LIMIT 5")) == 5


@pytest.mark.slow
def test_limits_of_many_texts_hold_at_each_run():
    limits = ssduck.Limits(rows=2000, memory=1_000_000)
    with ssduck.Interpreter(limits=limits, recording=None) as ss:
        text = "SELECT range, 'row ' || range AS name FROM range(2000)"
        expected = [(number, f"row {number}") for number in range(2000)]
        for _ in range(RUNS):
            assert ss.sql(text).fetchall() == expected
        text = "SELECT repeat('x', $size) AS x FROM range(1500)"
        for size, error in ((10, None), (10, None), (10_000, "values of more than"), (10, None)):
            if error is None:
                assert ss.sql(text, {"size": size}).fetchall() == [("x" * size,)] * 1500
            else:
                with pytest.raises(LimitError, match=error):
                    ss.sql(text, {"size": size})
